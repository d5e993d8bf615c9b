"""``place-rsus latency``, and latency budgets in other commands."""

import csv
import io
import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import click
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from experiments import main
from experiments.cli.latency import latency, latency_text
from experiments.cli.options import JUDGED, question_options
from experiments.parts import latency as latency_job
from experiments.parts.latency import (
    LatencyResult,
    latency_table,
    plot_latency,
    summarise_curve,
)
from experiments.results.record import to_plain
from geometry.errors import InputError
from placement.latency import LatencyCurve, load_latency_budget
from placement.question import Question
from placement.setting import build_rule

UNIT = {
    "site": "",
    "x_m": -115.0,
    "y_m": 8.6,
    "z_m": 8.0,
    "yaw_deg": -135.0,
    "pitch_deg": -25.0,
    "camera": "carla-ncap-rgb",
}
HEAVY = ("numpy", "scipy", "open3d", "trimesh", "matplotlib", "pandas", "rich")
PARTIES = ["vut", "A", "B", "rsu_all", "vut_and_rsus"]


@pytest.fixture
def layout_file(tmp_path):
    """Two units at one pose; the second one takes 1.5 s, whatever the others take."""
    units = [{"id": "A", **UNIT}, {"id": "B", **UNIT, "latency_s": 1.5}]
    path = tmp_path / "mine.json"
    path.write_text(json.dumps({"layout": units}), encoding="utf-8")
    return path


@pytest.fixture
def run_latency(run, small_study, monkeypatch, layout_file):
    """Runs the command on a few runs."""
    monkeypatch.setattr(
        latency_job, "build_setting", lambda question, scene, **options: small_study
    )
    main.cli.add_command(latency)

    def run_command(*arguments):
        return run("latency", "--layout", layout_file, "--quiet", *arguments)

    return run_command


@pytest.fixture
def run_refused(run, layout_file):
    """Runs the command with what it refuses before it computes anything."""
    main.cli.add_command(latency)

    def run_command(*arguments):
        return run("latency", "--layout", layout_file, "--quiet", *arguments)

    return run_command


def _mean_s(summary) -> float:
    """Mean of a result's budget."""
    parts = summary["budget"]["parts"]
    return sum(0.5 * (part["low_s"] + part["high_s"]) for part in parts)


def _curve(*last_latency_s) -> LatencyCurve:
    n_runs = len(last_latency_s)
    return LatencyCurve(
        first_latency_s=np.full(n_runs, -np.inf),
        last_latency_s=np.array(last_latency_s),
        run_index=np.arange(n_runs),
        weight=np.full(n_runs, 1.0 / n_runs),
    )


@pytest.fixture
def curves():
    return {
        "vut": _curve(0.0, -1.0, -np.inf, -np.inf),
        "A": _curve(0.1, 0.3, -0.1, -np.inf),
        "rsu_all": _curve(0.1, 0.3, 0.7, 0.7),
        "vut_and_rsus": _curve(0.1, 0.3, 0.7, np.inf),
    }


# The whole command


def test_the_curve_at_the_studys_latency_is_what_evaluate_finds(run, run_latency, layout_file):
    code, out, err = run_latency("--json")
    assert (code, err) == (0, "")
    summary = json.loads(out)
    assert (summary["budget"]["name"], _mean_s(summary)) == ("study", 0.025)
    parties = summary["parties"]
    assert list(parties) == PARTIES

    code, out, _ = run("evaluate", "--layout", layout_file, "--json", "--quiet")
    assert code == 0
    evaluated = json.loads(out)["evaluation"]
    evaluated |= evaluated["units"]
    for name, party in parties.items():
        for key in ("expected", "at_mean", "at_worst"):
            assert party[key] == pytest.approx(evaluated[name]["all"])
        ratios = [step["apr"] for step in party["steps"]]
        assert all(high > low for high, low in pairwise(ratios))
    assert parties["rsu_all"]["expected"] > 0.0
    assert len(parties["A"]["steps"]) > 2
    assert len(parties["B"]["steps"]) == 1  # flat: it keeps its latency


def test_table_figure_and_csv(run_latency):
    folder = Path("there/mine")
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("kept")
    code, out, err = run_latency("--budget", "cpm-100ms", "--out", folder, "--vut-latency", "0.02")
    assert (code, err) == (0, "")
    assert out.startswith("mine on 6 runs:\n")
    assert max(map(len, out.splitlines())) <= 80
    assert re.search(r"^ +25 ms( +[<>]?[\d.]+ %){3}$", out, re.MULTILINE)
    assert re.search(r"^ +all together +42 ms +113.5 ms +185 ms$", out, re.MULTILINE)
    assert "Kept at every latency, as their own: B 1500 ms, the VUT 20 ms." in " ".join(out.split())
    assert out.endswith(f"Written to {folder}: latency.csv and latency.png.\n")
    assert {path.name for path in folder.iterdir()} == {"notes.txt", "latency.csv", "latency.png"}
    with Image.open(folder / "latency.png") as picture:
        assert picture.width == 1088
    text = (folder / "latency.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == ["party", "above_s", "until_s", "apr"]
    assert list(dict.fromkeys(row["party"] for row in rows)) == PARTIES

    code, _, _ = run_latency("--budget", "cpm-100ms", "--out", folder, "--vut-latency", "0.02")
    assert code == 0
    assert (folder / "latency.csv").read_text() == text


def test_one_number_is_a_budget_too(run_latency):
    code, out, _ = run_latency("--latency", "0.04", "--max", "0.1", "--json")
    assert code == 0
    summary = json.loads(out)
    assert (summary["budget"]["name"], _mean_s(summary)) == ("40 ms", 0.04)
    assert [entry["latency_s"] for entry in summary["parties"]["A"]["at"]] == [0, 0.025, 0.05, 0.1]
    assert summary["max_latency_s"] == 0.1


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--budget", "wifi"),
            "--budget: got 'wifi'; expected study, cpm-100ms, cpm-50ms, or a .toml file with a "
            "latency budget",
        ),
        (
            ("--budget", "study", "--latency", "0.1"),
            "--latency: got it beside --budget; expected one of them",
        ),
        (("--latency", "25"), "--latency: got 25.0; expected at most 10 seconds"),
        (("--max", "0"), "--max: got '0'; expected seconds, more than 0"),
        (("--vut-latency", "-1"), "--vut-latency: got '-1'; expected seconds, at least 0"),
        (("--layout", "carlancap-12"), "--layout: got 2 layouts; expected it once"),
        (
            ("--out", "mine.txt"),
            "--out: got mine.txt: Not a directory; expected a folder that can be written to",
        ),
        (
            ("--out", "mine.txt/deep"),
            "--out: got mine.txt/deep: Not a directory; expected a folder that can be written to",
        ),
    ],
)
def test_what_cannot_be_is_one_line(run_refused, arguments, message):
    Path("mine.txt").write_text("a file")
    assert run_refused(*arguments) == (2, "", f"place-rsus: {message}\n")
    assert [path.name for path in Path().iterdir()] == ["mine.txt"]


def test_a_budget_file_that_is_wrong_is_told_by_part_and_field(run_refused):
    Path("mine.toml").write_text("[[mine.parts]]\nname = 'radio'\nfixed_s = -1\nsource = 'x'\n")
    assert run_refused("--budget", "mine.toml") == (
        2,
        "",
        "place-rsus: mine.toml: mine.radio.fixed_s: got -1.0; expected 0 to 10 seconds\n",
    )


def test_help_has_an_example_and_is_narrow(run_refused):
    code, out, err = run_refused("--help")
    assert (code, err) == (0, "")
    assert re.search(r"^ +place-rsus latency .* --budget cpm-100ms", out, re.MULTILINE)
    assert max(map(len, out.splitlines())) <= 80


def test_nothing_heavy_is_imported_before_it_is_used():
    code = f"import sys, experiments.cli.latency; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


# Table, text, figure


def test_the_csv_has_every_step_up_to_the_longest_latency(curves):
    table = latency_table(curves, max_latency_s=0.5)
    steps = {name: rows[["above_s", "until_s", "apr"]] for name, rows in table.groupby("party")}
    assert steps["rsu_all"].to_numpy().tolist() == [[0, 0.1, 1], [0.1, 0.3, 0.75], [0.3, 0.5, 0.5]]
    assert steps["A"].to_numpy().tolist() == [[0, 0.1, 0.5], [0.1, 0.3, 0.25], [0.3, 0.5, 0]]
    assert steps["vut"].to_numpy().tolist() == [[0, 0, 0.25], [0, 0.5, 0]]
    ends = latency_table(curves, max_latency_s=0.3).groupby("party")["until_s"].max()
    assert ends.tolist() == [0.3] * 4


@pytest.mark.parametrize(("max_s", "n_steps"), [(0.05, 1), (0.3, 2), (0.5, 3), (2.0, 4)])
def test_curves_are_drawn_as_steps_that_end_at_the_right_edge(curves, max_s, n_steps):
    budget = load_latency_budget("cpm-100ms")
    upper, lower = plot_latency(curves, budget, max_latency_s=max_s)
    lines = {line.get_gid(): line for line in upper.get_lines()}
    assert set(lines) == {*curves, "mean"}
    x_ms, apr = lines["rsu_all"].get_data()
    assert lines["rsu_all"].get_drawstyle() == "steps-pre"
    assert np.asarray(x_ms) == pytest.approx(
        [0, *[100, 300, 700, 1e9][: n_steps - 1], 1000 * max_s]
    )
    assert list(apr) == [1.0, *[1.0, 0.75, 0.5, 0.0][:n_steps]]
    assert upper.get_xlim() == (0.0, 1000.0 * max_s)
    assert lines["mean"].get_xdata()[0] == pytest.approx(113.5)
    looks = [(lines[name].get_linestyle(), lines[name].get_linewidth()) for name in curves]
    assert len(set(looks)) == len(curves)  # not by colour alone
    assert len({bar.get_gid() for bar in lower.patches}) == 10
    ends = [bar.get_x() + bar.get_width() for bar in lower.patches]
    assert (ends[4], ends[9]) == (pytest.approx(113.5), pytest.approx(185.0))


def test_a_fixed_budget_has_one_bar_and_no_range(curves):
    upper, lower = plot_latency(curves, load_latency_budget(), max_latency_s=0.5)
    assert [bar.get_gid() for bar in lower.patches] == ["always: processing and communication"]
    assert len(upper.patches) == 0
    (shade,) = plot_latency(curves, load_latency_budget("cpm-50ms"), max_latency_s=0.5)[0].patches
    assert (shade.get_x(), shade.get_width()) == (pytest.approx(42.0), pytest.approx(93.0))


def test_the_text_says_how_long_each_level_holds(curves):
    budget = load_latency_budget()
    parties = {
        name: to_plain(summarise_curve(curve, budget, 0.5)) for name, curve in curves.items()
    }
    summary = {
        "name": "mine",
        "layout": [{"id": "A", **UNIT}],
        "runs": 4,
        "budget": to_plain(budget),
        "max_latency_s": 0.5,
        "parties": parties,
        "vut_latency_s": None,
        "cases": [],
        "weathers": [],
        "detector": "surrogate",
        "vut_sensors": [],
        "packet_loss": 0.0,
        "vam_rate": 0.0,
        "track_memory_s": None,
        "not_driven": [],
        "possible_runs": 1,
        "driven": [],
        "seconds": {},
        "versions": {},
    }
    text = latency_text(msgspec.convert(summary, LatencyResult), None)
    rows = [line.split() for line in text.splitlines()]
    assert ["100", "%", "100.0", "ms", "100.0", "ms", "none"] in rows
    assert ["95", "%", "100.0", "ms", "100.0", "ms", "none"] in rows
    assert ["200", "ms", "75.0", "%", "75.0", "%", "0.0", "%"] in rows
    assert ["A", "50.0", "%", "50.0", "%", "50.0", "%"] in rows
    assert "The VUT's own sensors take as long; see --vut-latency." in " ".join(text.split())


@pytest.mark.parametrize(
    ("last_s", "budget", "expected_s"),
    [
        ((0.1, 0.2), "study", 0.5),
        ((0.9, 0.92), "study", 1.0),
        ((-1.0, 0.1), "cpm-100ms", 0.5),
        ((np.inf, np.inf), "study", 3.0),
        ((7.0, 7.0), "study", 3.0),
    ],
)
def test_by_default_the_figure_shows_where_the_apr_falls(last_s, budget, expected_s):
    curves = {"rsu_all": _curve(*last_s)}
    shown_s = latency_job._default_max_s(curves, load_latency_budget(budget))
    assert shown_s == pytest.approx(expected_s)


# Budgets in other commands


def _short(latency_s):
    return None if latency_s is None else f"{latency_s:.9g}"


@click.command()
@question_options(*JUDGED)
def _plain(*, question):
    click.echo(f"{_short(build_rule(question).latency_s)} {question.speeds}")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("--speeds 30", "0.025 30"),
        ("--latency 0.05", "0.05 "),
        ("--latency-budget study", "0.025 "),
        ("--latency-budget cpm-100ms --speeds 30", "0.1135 30"),
        ("--latency-budget cpm-50ms", "0.0885 "),
    ],
)
def test_a_command_gets_the_latency_of_the_budget(arguments, expected):
    done = CliRunner().invoke(_plain, arguments.split(), catch_exceptions=False)
    assert (done.exit_code, done.output) == (0, expected + "\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "--latency-budget study --latency 0.05",
            "latency_s: got it beside `latency_budget`; expected one of them",
        ),
        (
            "--latency-budget 25ms",
            "latency_budget: got '25ms'; expected study, cpm-100ms, cpm-50ms, or a .toml file "
            "with a latency budget",
        ),
    ],
)
def test_a_budget_that_a_command_cannot_take_is_told(arguments, message):
    done = CliRunner().invoke(_plain, arguments.split())
    assert isinstance(done.exception, InputError)
    assert str(done.exception) == message


def test_without_a_budget_a_question_brakes_as_it_says():
    assert build_rule(Question(latency_s=0.3)).latency_s == 0.3
