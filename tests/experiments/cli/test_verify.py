"""``place-rsus verify``: what an optimisation has written, checked without the optimiser."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_results import lay_runs_of

from experiments.jobs import placement
from experiments.progress import StageProgress
from placement.compute import Compute
from placement.question import Question
from placement.verification.instances import load_problem, save_problem


@pytest.fixture(scope="module")
def written(small_setting, tmp_path_factory):
    """The result folder of a small optimisation, without its figures."""
    folder = tmp_path_factory.mktemp("placed") / "results"
    with pytest.MonkeyPatch.context() as patch:
        lay_runs_of(patch, small_setting)
        patch.setattr(placement, "write_report", lambda *given, **options: None)
        placement.run_placement(
            Question(budget=2, within="carlancap-12", give_up=0.0, time_limit_s=60.0),
            out=folder,
            compute=Compute(workers=2),
            command="place-rsus",
            progress=StageProgress(),
        )
    return folder


@pytest.fixture
def results(written, tmp_path):
    """A copy of it to spoil."""
    return Path(shutil.copytree(written, tmp_path / "results"))


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def test_what_was_written_is_verified_in_a_line_per_check(run, results):
    code, out, err = run("verify", results, "--quiet")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80 + len(str(results))
    checks = [line for line in out.splitlines() if line.startswith("  OK ")]
    assert out.splitlines()[-1] == f"{len(checks)} checks: all OK."
    assert "FAILED" not in out
    for words in ("instance: SHA-256", "apr: recomputed", "layout file: it shows the same 2 units"):
        assert f"  OK     {words}" in out
    assert "Proven again, without a solver:\n  apr: " in out
    assert "Not checked here:\n  whether the detection table is right" in out


def test_json_says_the_same(run, results):
    code, out, err = run("verify", results, "--json", "--quiet")
    assert (code, err) == (0, "")
    summary = json.loads(out, parse_constant=pytest.fail)
    assert summary["is_verified"]
    assert all(check["passed"] for check in summary["checks"])
    assert [stage["name"] for stage in summary["stages"]] == [
        "apr",
        "apr_one_failed",
        "smallest_margin_s",
        "mean_margin_s",
        "cost_eur",
    ]
    assert all(stage["is_proven_again"] for stage in summary["stages"])
    assert not any("rests on" in line for line in summary["not_checked"])
    written = json.loads((results / "summary.json").read_text())
    assert summary["solver"] == written["solver"]
    assert [stage["objective"] for stage in summary["stages"]] == [
        stage["objective"] for stage in written["stages"]
    ]


def test_what_was_changed_fails_with_exit_code_1(run, results):
    def move(document):
        document["layout"][0]["yaw_deg"] += 1.0

    edit(results / "layout.json", move)
    code, out, err = run("verify", results, "--quiet")
    assert (code, err) == (1, "")
    assert "  FAILED layout file: it does not show the certificate's units" in out
    assert "  FAILED file layout.json: changed, says SHA256SUMS" in out
    assert "  FAILED layout.csv: another layout than layout.json" in out
    assert out.splitlines()[-1].endswith(" checks: 5 FAILED.")
    code, out, err = run("verify", results, "--quiet", "--json")
    assert (code, err) == (1, "")
    assert not json.loads(out)["is_verified"]


def test_a_solver_that_lied_is_told(run, results):
    def lie(document):
        for stage in document["stages"]:
            stage |= {"objective": stage["objective"] / 2, "bound": stage["bound"] / 2}

    edit(results / "certificate.json", lie)
    code, out, _ = run("verify", results, "--quiet")
    assert code == 1
    assert "  FAILED apr: recomputed 1, claimed 0.5" in out
    assert "disproved" not in out.partition("Not checked here")[2]


def test_another_instance_is_told(run, results):
    problem = load_problem(results / "instance.npz")
    packed = problem.table.packed.copy()
    packed[0, 0] ^= np.uint8(1)
    table = replace(problem.table, packed=packed)
    save_problem(results / "instance.npz", replace(problem, table=table))
    code, out, _ = run("verify", results, "--quiet")
    assert code == 1
    assert "  FAILED instance: SHA-256 " in out


def test_proofs_that_rest_on_the_solver_are_said_to(run, results, monkeypatch):
    monkeypatch.setattr("placement.verification.verify._MAX_LOOKS", 0)
    code, out, _ = run("verify", results, "--quiet")
    assert code == 0
    assert "that no layout is better in mean_margin_s: this rests on" in out


@pytest.mark.parametrize("name", ["certificate.json", "instance.npz", "layout.json"])
def test_a_file_that_is_missing_or_damaged_is_named(run, results, name):
    path = results / name
    path.write_bytes(path.read_bytes()[:100])
    code, out, err = run("verify", results, "--quiet")
    assert (code, out) == (2, "")
    assert err.startswith(f"place-rsus: {path}: got ")
    path.unlink()
    code, out, err = run("verify", results, "--quiet")
    assert (code, out) == (2, "")
    assert err.startswith(f"place-rsus: {path}: got No such file or directory; expected ")


def test_a_folder_that_is_none_is_refused(run, tmp_path):
    for folder in (tmp_path / "none", __file__):
        code, out, err = run("verify", folder)
        assert (code, out) == (2, "")
        assert err.endswith(f"{folder}: got no folder; expected a folder with results\n")


def test_help_names_the_exit_codes_and_imports_nothing_heavy(run):
    code, out, _ = run("verify", "--help")
    assert code == 0
    assert "Exit codes: 0 all checks hold, 1 a check has failed, 2 the input is wrong." in out
    assert max(map(len, out.splitlines())) <= 80
    names = "numpy scipy cvxpy pandas"
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys, experiments.cli.verify; "
            f"print([name for name in {names!r}.split() if name in sys.modules])",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[]\n"
