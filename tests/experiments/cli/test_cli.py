"""Commands as a whole: what they print, refuse, write, and leave when interrupted."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from command_results import answer, output, refusal
from json_files import UNIT, read_json, write_json

from experiments.progress import StageProgress
from geometry.catalogue import load_cameras

KEYS = {
    "layout",
    "fusion",
    "runs",
    "apr",
    "evaluation",
    "dangers",
    "seconds",
    "versions",
}
STAGES = (
    "setting",
    "detection table",
    "optimise",
    "greedy",
    "evaluate",
    "write results",
)


@pytest.fixture
def layout_file(tmp_path):
    """Writes a layout file of one unit with some fields replaced, or removed (...)."""

    def write(name: str = "mine.json", **fields: object) -> Path:
        unit = {
            key: value for key, value in (UNIT | fields).items() if value is not ...
        }
        path: Path = tmp_path / name
        write_json(path, {"layout": [unit]})
        return path

    return write


def assert_refused(result: tuple[int, str, str], message: str) -> None:
    """Nothing but this line is said."""
    assert result == (2, "", f"place-rsus: {message}\n")


# Start-up and help


def test_version_is_told(run):
    out = answer(run("--version"))
    assert re.fullmatch(r"place-rsus, version \d+\.\d+\.\d+\n", out)


# Bad input


@pytest.mark.parametrize("value", ["0", "1.5", "x", "٣"])
def test_a_budget_that_is_no_whole_number_is_refused(run, value):
    assert_refused(
        run("--budget", value),
        f"--budget: got {value!r}; expected a whole number of units, at least 1",
    )


@pytest.mark.parametrize("value", ["57", "1" + 30 * "0"])
def test_a_budget_beyond_what_the_sites_can_carry_is_refused(run, value):
    code, out, err = run("--budget", value)
    assert code == 2
    assert out == ""
    assert re.fullmatch(
        rf"place-rsus: --budget: got {value}; expected a whole number of units, 1 to"
        r" \d+ "
        r"\(what town05's sites can carry\)\n",
        err,
    )
    assert os.listdir() == []  # noqa: PTH208


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "",
            (
                "--budget: got nothing; expected a whole number of units, at least 1"
                " (or --target, or --budget-cost)"
            ),
        ),
        ("--budget", "Option '--budget' requires an argument."),
        ("--budget 1 --fusion all", "--fusion: got 'all'; expected one of any, single"),
        (
            "--budget 1 --workers 0",
            "--workers: got '0'; expected a number of threads, 1 to 1024",
        ),
        (
            "--budget 1 --seed -1",
            "--seed: got '-1'; expected a whole number, at least 0",
        ),
        (
            "--budget 1 --time-limit nan",
            (
                "--time-limit: got 'nan'; expected seconds, more than 0, at most"
                " 10,000,000"
            ),
        ),
        (
            "--budget 1 --packet-loss 1.2",
            "--packet-loss: got '1.2'; expected a share of lost messages, 0 to 1",
        ),
        ("--budget 1 --xyzzy 2", "No such option '--xyzzy'."),
        ("place", "No such command 'place'. Did you mean 'plan'?"),
        (
            "--budget 1 evaluate --layout carlancap-12",
            "--budget: options of evaluate go behind its name",
        ),
        ("evaluate", "--layout: got nothing; expected it once"),
        ("evaluate --layout a --layout b", "--layout: got 2 layouts; expected it once"),
        (
            "compare carlancap-12",
            "LAYOUT: got one layout; expected two layouts or more",
        ),
        (
            "export --layout carlancap-12 --format xml",
            (
                "--format: got 'xml'; expected one of json, csv, geojson,"
                " gpkg, kml, dxf, carla, opencv, ros, cpm, cpm-uper, mcap, opendrive"
            ),
        ),
        (
            "evaluate --layout carlancap-13",
            (
                "--layout: got 'carlancap-13'; expected carlancap-12, or a layout file"
                " that exists"
            ),
        ),
    ],
)
def test_wrong_arguments_are_one_line(run, arguments, message):
    assert_refused(run(arguments), message)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Expecting value: line 1 column 1 (char 0); expected JSON in UTF-8"),
        (b"\xff\x00", "'utf-8' codec can't decode byte 0xff"),
        (b"[]", "no list 'layout'; expected an object"),
    ],
)
def test_a_file_that_is_no_layout_is_refused(run, tmp_path, content, message):
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    assert refusal(run("evaluate --layout", path)).startswith(f"{path}: got {message}")


def test_an_empty_layout_and_repeated_ids_are_refused(run, tmp_path):
    path = tmp_path / "mine.json"
    write_json(path, {"layout": []})
    assert_refused(
        run("evaluate --layout", path),
        "layout mine: got no unit; expected at least one unit",
    )

    write_json(path, {"layout": [UNIT, UNIT]})
    assert_refused(
        run("evaluate --layout", path),
        "layout mine: id: got 'A'; expected every id once",
    )


def test_a_folder_is_no_layout_file(run, tmp_path):
    assert_refused(
        run("evaluate --layout", tmp_path),
        f"{tmp_path}: got Is a directory; expected a readable file",
    )


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"x_m": ...}, "layout[0].x_m: got nothing; expected a value"),
        (
            {"camera": "x"},
            "layout[0].camera: got 'x'; expected one of "
            + ", ".join(sorted(load_cameras())),
        ),
    ],
)
def test_a_wrong_field_of_a_layout_file_is_named(run, layout_file, fields, message):
    path = layout_file(**fields)
    assert_refused(run("evaluate --layout", path), f"{path}: {message}")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"z_m": -1},
            "layout mine: A.z_m: got -1.0; expected a height above the road, > 0 m",
        ),
        (
            {"site": "x"},
            "layout mine: A.site: got 'x'; expected a site of town05, or an empty text",
        ),
        (
            {"id": "vut"},
            (
                "layout mine: id: got 'vut'; expected another name: vut, rsu_all,"
                " vut_and_rsus, vam, all_sources mean other sensing parties"
            ),
        ),
        (
            {"id": "\ud800"},
            "layout: name or id: got '\\ud800'; expected printable text",
        ),
    ],
)
def test_a_unit_that_cannot_be_is_refused(run, layout_file, fields, message):
    path = layout_file(**fields)
    assert_refused(run("export --layout", path, "--format csv"), message)


def test_a_unit_inside_a_building_or_far_away_is_refused(
    run, layout_file, small_setting
):
    scene = small_setting.scene
    building = next(
        i for i, it in enumerate(scene.instances) if it.class_name == "building"
    )
    corners = scene.vertices_m[
        scene.triangles[scene.triangle_instance == building].ravel()
    ]
    x_m, y_m, z_m = (0.5 * (corners.min(axis=0) + corners.max(axis=0))).tolist()
    code, _, err = run(
        "export --format csv --layout", layout_file(x_m=x_m, y_m=y_m, z_m=z_m)
    )

    assert code == 2
    assert (
        err == "place-rsus: layout mine: A: got a pose inside building"
        f" {scene.instances[building].id}; expected a pose in the open air\n"
    )

    code, _, err = run("export --format csv --layout", layout_file(x_m=1e300))
    assert code == 2
    assert (
        err
        == "place-rsus: layout mine: A: got a pose 1e+300 m from the middle of town05; "
        "expected at most 1000 m\n"
    )


def test_a_bad_out_is_refused_before_anything_is_computed(run, small_study, tmp_path):
    (tmp_path / "file").write_text("mine")
    message = "got '{0}/file'; expected a folder, not a file"

    for command in (
        ["--budget", 1],
        ["evaluate", "--layout", "carlancap-12"],
    ):
        assert (
            refusal(run(*command, "--quiet --out", tmp_path / "file"))
            == f"--out: {message.format(tmp_path)}"
        )
    assert refusal(
        run("export --layout carlancap-12 --format csv --out", tmp_path / "file/x")
    ) == (
        f"--out: got {tmp_path}/file/x: Not a directory; "
        "expected a file that can be written"
    )
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("command", "worlds"),
    [
        (["--budget", 1], ""),
        (["--budget", 1, "--samples", 3], " in 3 sampled worlds"),
        (["pareto", "--max", 1], ""),
    ],
)
def test_what_does_not_fit_into_memory_is_refused_before_it_starts(
    run, small_study, monkeypatch, command, worlds
):
    monkeypatch.setattr("placement.memory.machine_bytes", lambda: 2**20)
    code, out, err = run(*command, "--quiet")

    assert code == 2
    assert out == ""
    assert re.fullmatch(
        rf"place-rsus: memory: got [\d,]+ poses x [\d,]+ frames{worlds}, which need 0.4"
        r" GiB, where "
        r"there are 0.0 GiB; expected a smaller question: .*\n",
        err,
    )
    assert os.listdir() == []  # noqa: PTH208


# Results


def test_placement_prints_one_object_and_writes_a_report(
    ask, few_runs, whole_placement
):
    assert (whole_placement / "err").read_text().splitlines()[0] == "setting ..."

    out = (whole_placement / "out").read_text()
    summary = json.loads(out, parse_constant=pytest.fail)

    assert set(summary) >= KEYS
    assert [list(unit) for unit in summary["layout"]] == [[*UNIT, "kind", "place"]] * 2
    assert summary["budget"] == 2
    assert summary["fusion"] == "any"
    assert summary["runs"] == len(few_runs.runs)
    assert set(summary["evaluation"]) == {
        "vut",
        "rsu_all",
        "vut_and_rsus",
        "units",
        "apr_without_worst_unit",
        "apr_without_worst_site",
        "vam",
        "all_sources",
        "headline",
    }
    assert set(summary["evaluation"]["units"]) == {
        unit["id"] for unit in summary["layout"]
    }

    study = summary["baseline"]["evaluation"]
    assert set(study["units"]) == {f"RSU{number}" for number in range(12)}

    for evaluation in (summary["evaluation"], study):
        for party in ("vut", "rsu_all", "vut_and_rsus"):
            ratios = evaluation[party]
            assert set(ratios["by_case"]) == {"CPNC-50", "CBNA", "CBLA"}
            assert all(
                0.0 <= ratio <= 1.0
                for ratio in (ratios["all"], *ratios["by_case"].values())
            )
    assert (
        0.0
        <= summary["apr_without_worst_unit"]
        <= summary["apr"]
        <= summary["bound"]
        <= 1.0
    )
    assert {path.name for path in (whole_placement / "results/latest").iterdir()} == {
        "report.html",
        "certificate.json",
        "instance.npz",
        "layout.json",
        "layout.csv",
        "layout.geojson",
        "apr.csv",
        "bill_of_materials.csv",
        "runs.parquet",
        "summary.json",
        "SHA256SUMS",
        "plan.png",
    }

    results = whole_placement / "results"
    assert read_json(results / "latest/summary.json") == summary
    assert list(results.iterdir()) == [results / "latest"]

    # What was written is read again.
    layout = results / "latest/layout.json"
    again = ask("evaluate --layout", layout)

    assert set(again) >= KEYS
    assert again["layout"] == summary["layout"]
    assert again["evaluation"] == summary["evaluation"]


# Quickly: tests/placement/visibility/test_build.py and optimiser/test_solve.py
@pytest.mark.long
def test_two_calls_give_the_same_but_for_the_time(ask, small_study, without_figures):
    results = []
    for workers in (1, 2):
        summary = ask("--budget 1 --workers", workers, "--no-cache")
        for point in (summary, *summary["front"]["points"]):
            for stage in point["stages"]:
                del stage["seconds"]
        del summary["seconds"]
        results.append(summary)
    assert results[0] == results[1]


# Quickly, with made-up results: test_texts.py
@pytest.mark.long
def test_printed_tables_fit_80_columns(run, small_study, layout_file, without_figures):
    path = layout_file(
        "a rather long name for a layout, and still longer.json", id="B" * 40
    )
    for arguments in (
        ["--budget", 2, "--fusion", "single", "--out", "o"],
        ["evaluate", "--layout", path],
        ["compare", path, "carlancap-12", path],
    ):
        short = answer(run(*arguments, "--quiet"))
        assert max(map(len, short.splitlines())) <= 100
        assert len(short.splitlines()) <= 40

        out = output(run(*arguments, "--verbose"))
        # The first line holds the name.
        assert max(map(len, out.splitlines()[1:])) <= 80
        assert len(out) > len(short)
        assert "100.0 %" in out


@pytest.mark.long
def test_layouts_of_one_name_are_named_by_their_folders(ask, small_study, layout_file):
    path = layout_file()
    other = Path("other/mine.json")
    other.parent.mkdir()
    other.write_bytes(Path(path).read_bytes())
    summary = ask("compare", path, other)
    home = Path(path).resolve().parent.name

    assert [summary["name"], summary["compared"][0]["name"]] == [
        f"mine of {home}",
        "mine of other",
    ]


def test_export_writes_to_stdout_or_to_a_file(run):
    text = answer(run("export --layout carlancap-12 --format carla"))
    assert len(json.loads(text)) == 12

    arguments = ["export --layout carlancap-12 --format carla --out rsus.json"]
    assert run(*arguments) == (0, "", "")
    assert Path("rsus.json").read_text() == text


def test_a_full_disk_is_one_line(run, monkeypatch):
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        code, _, err = run("export --layout carlancap-12 --format csv")
        with suppress(OSError):
            full.close()
    assert code == 2
    assert err == "place-rsus: No space left on device\n"


def test_a_reader_that_goes_away_gets_no_traceback():
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "experiments.main", "--help"],
        stdout=writer,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writer)

    assert done.returncode == 1
    assert done.stderr == b""


# Rays


def test_open3d_is_asked_for_where_it_cannot_load_in_one_line(
    run, small_study, monkeypatch
):
    problem = (
        "Open3D cannot load (libX11.so.6 is missing); to use it: apt-get install"
        " libx11-6"
    )
    monkeypatch.setattr("geometry.raycast.open3d_problem", lambda: problem)
    assert f"--rays: got 'open3d'; expected a library that loads: {problem}" in refusal(
        run("evaluate --layout carlancap-12 --rays open3d")
    )


# Interruptions


@pytest.fixture
def interrupt_at(monkeypatch):
    """Sends a signal as soon as a stage begins."""
    call = StageProgress.__call__

    def arm(stage: str, signum: int = signal.SIGINT) -> None:
        def call_interrupted(
            progress: StageProgress, name: str, done: int, total: int
        ) -> None:
            call(progress, name, done, total)
            if name == stage:
                signal.raise_signal(signum)

        monkeypatch.setattr(StageProgress, "__call__", call_interrupted)

    return arm


@pytest.mark.long
def test_a_damaged_cache_file_is_made_anew(
    run, small_study, own_cache, caplog, interrupt_at
):
    interrupt_at("optimise")
    run("--budget 1")
    (table,) = own_cache.iterdir()
    good = np.load(table)["packed"]
    table.write_bytes(b"no table")
    code, _, err = run("--budget 1")

    assert code == 130
    assert err.splitlines()[:3] == [
        "setting ...",
        "detection table ...",
        "optimise ...",
    ]

    (record,) = [r for r in caplog.records if r.name.startswith("placement")]
    assert "\n" not in record.getMessage()
    assert record.getMessage().startswith(
        f"cached detection table not used, made anew: {table}"
    )
    assert np.array_equal(np.load(table)["packed"], good)


@pytest.mark.long
def test_a_cache_that_cannot_be_written_to_is_done_without(
    run, small_study, monkeypatch, caplog, interrupt_at
):
    Path("file").write_text("mine")
    monkeypatch.setenv("PLACE_RSUS_CACHE", "file")
    interrupt_at("optimise")
    code, out, err = run("--budget 1 --out out")  # --quiet also hides warnings

    assert code == 130
    assert out == ""
    assert (
        err.splitlines()[-1]
        == "place-rsus: interrupted in stage 'optimise': nothing was written to out"
    )
    assert all("\n" not in record.getMessage() for record in caplog.records)
    assert (
        caplog.messages.count("nothing is cached: file cannot be made (File exists)")
        == 1
    )


@pytest.mark.parametrize("stage", STAGES)
def test_an_interruption_says_what_was_kept_and_leaves_nothing(
    run, small_study, interrupt_at, stage, request
):
    if stage in STAGES[:2]:
        request.getfixturevalue("own_cache")
    interrupt_at(stage)
    code, out, err = run("--budget 1")

    assert code == 130
    assert out == ""

    kept = "nothing was written to results/latest"
    if stage not in STAGES[:2]:
        kept += "; the detection table is cached for the next call"

    assert err.splitlines()[-1] == f"place-rsus: interrupted in stage '{stage}': {kept}"
    assert os.listdir() == []  # noqa: PTH208


def test_an_interruption_leaves_earlier_results_as_they_were(
    run, small_study, interrupt_at
):
    out = Path("out")
    run("evaluate --layout carlancap-12 --out", out, "--quiet")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    for stage, signum, code in (
        ("evaluate", signal.SIGINT, 130),
        ("write results", signal.SIGTERM, 143),
    ):
        interrupt_at(stage, signum)
        arguments = ["evaluate --layout carlancap-12 --out", out, "--quiet"]

        assert run(*arguments) == (
            code,
            "",
            (
                f"place-rsus: interrupted in stage '{stage}': the earlier results in"
                " out are unchanged\n"
            ),
        )
        assert {path.name: path.read_bytes() for path in out.iterdir()} == before

    assert list(Path().iterdir()) == [out]


def test_an_interruption_of_an_evaluation_needs_no_folder(
    run, small_study, interrupt_at
):
    interrupt_at("evaluate")
    code, _, err = run("evaluate --layout carlancap-12 --quiet")

    assert code == 130
    assert err == "place-rsus: interrupted in stage 'evaluate': nothing was written\n"
