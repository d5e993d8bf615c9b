"""``place-rsus latency``, and latency budgets in other commands."""

import csv
import io
import json
import math
import re
from functools import partial
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner
from command_results import answer
from json_files import UNIT, write_json
from PIL import Image

from experiments import main
from experiments.cli.latency import latency
from experiments.cli.options import JUDGED, question_options
from experiments.parts import latency as latency_job
from experiments.parts.latency import PartyLatency, plot_latency
from geometry.errors import InputError
from placement.latency import load_latency_budget
from placement.question import Question
from placement.setting import build_rule

PARTIES = ["vut", "A", "B", "rsu_all", "vut_and_rsus"]


@pytest.fixture
def layout_file(tmp_path):
    """Two units at one pose; the second one takes 1.5 s, whatever the others take."""
    path = tmp_path / "mine.json"
    write_json(path, {"layout": [UNIT, UNIT | {"id": "B", "latency_s": 1.5}]})
    return path


@pytest.fixture
def run_refused(run, layout_file):
    """Runs the command with what it refuses before it computes anything."""
    main.cli.add_command(latency)

    return partial(run, "latency --layout", layout_file, "--quiet")


@pytest.fixture
def run_latency(run_refused, small_study, monkeypatch):
    """Runs the command on a few runs."""
    monkeypatch.setattr(
        latency_job, "build_setting", lambda question, scene, **options: small_study
    )
    return run_refused


def _mean_s(summary) -> float:
    """Mean of a result's budget."""
    parts = summary["budget"]["parts"]
    return sum(0.5 * (part["low_s"] + part["high_s"]) for part in parts)


# The whole command


@pytest.mark.long
def test_the_curve_at_the_studys_latency_is_what_evaluate_finds(
    run, run_latency, layout_file
):
    summary = json.loads(answer(run_latency("--json")))
    assert summary["budget"]["name"] == "study"
    assert _mean_s(summary) == 0.025

    parties = summary["parties"]
    assert list(parties) == PARTIES

    out = answer(run("evaluate --layout", layout_file, "--json --quiet"))
    evaluated = json.loads(out)["evaluation"]
    evaluated |= evaluated["units"]

    for name, party in parties.items():
        for key in ("at_best", "at_mean", "at_worst"):
            assert party[key] == pytest.approx(evaluated[name]["all"])
        assert party["apr"][5] == party["at_mean"]
    assert summary["latencies_s"][5] == 0.025
    assert parties["rsu_all"]["at_mean"] > 0.0
    assert len(set(parties["B"]["apr"])) == 1  # flat: it keeps its latency


@pytest.mark.long
def test_table_figure_and_csv(run_latency):
    folder = Path("there/mine")
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("kept")
    out = answer(run_latency("--budget cpm-100ms --out", folder, "--vut-latency 0.02"))

    assert out.startswith("mine on 6 runs:\n")
    assert max(map(len, out.splitlines())) <= 80
    assert re.search(r"^ +25 ms( +[<>]?[\d.]+ %){3}$", out, re.MULTILINE)
    assert re.search(r"^ +all together +42 ms +113.5 ms +185 ms$", out, re.MULTILINE)
    assert (
        "Units with a latency of their own keep it: B 1500 ms, the VUT 20 ms."
        in " ".join(out.split())
    )
    assert out.endswith(f"Written to {folder}: latency.csv and latency.png.\n")
    assert {path.name for path in folder.iterdir()} == {
        "notes.txt",
        "latency.csv",
        "latency.png",
    }

    with Image.open(folder / "latency.png") as picture:
        assert picture.width == 1088
    text = (folder / "latency.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))

    assert list(rows[0]) == ["latency_s", *PARTIES]
    assert len(rows) == 101

    answer(run_latency("--budget cpm-100ms --out", folder, "--vut-latency 0.02"))
    assert (folder / "latency.csv").read_text() == text


def test_one_number_is_a_budget_too(run_latency):
    out = answer(run_latency("--latency 0.04 --max 0.1 --json"))
    summary = json.loads(out)

    assert summary["budget"]["name"] == "40 ms"
    assert _mean_s(summary) == 0.04
    assert summary["latencies_s"] == pytest.approx(np.linspace(0.0, 0.1, 21))
    assert len(summary["parties"]["A"]["apr"]) == 21


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--budget", "wifi"),
            (
                "--budget: got 'wifi'; expected study, cpm-100ms, cpm-50ms, or a .toml"
                " file with a latency budget"
            ),
        ),
        (
            ("--budget", "study", "--latency", "0.1"),
            "--latency: got it beside --budget; expected one of them",
        ),
        (("--latency", "25"), "--latency: got 25.0; expected at most 10 seconds"),
        (
            ("--vut-latency", "-1"),
            "--vut-latency: got '-1'; expected seconds, at least 0",
        ),
        (
            ("--out", "mine.txt"),
            (
                "--out: got mine.txt: Not a directory; expected a folder that can be"
                " written to"
            ),
        ),
    ],
)
def test_what_cannot_be_is_one_line(run_refused, arguments, message):
    Path("mine.txt").write_text("a file")
    assert run_refused(*arguments) == (2, "", f"place-rsus: {message}\n")
    assert [path.name for path in Path().iterdir()] == ["mine.txt"]


def test_a_budget_file_that_is_wrong_is_told_by_part_and_field(run_refused):
    Path("mine.toml").write_text(
        "[[mine.parts]]\nname = 'radio'\nfixed_s = -1\nsource = 'x'\n"
    )
    assert run_refused("--budget mine.toml") == (
        2,
        "",
        "place-rsus: mine.toml: mine.radio.fixed_s: got -1; expected 0 to 10 seconds\n",
    )


# Levels, figure


@pytest.mark.parametrize(
    ("level", "longest_s"),
    [
        (0.4, math.inf),
        (0.5, 0.01),
        (0.9, 0.0),
        (1.0, -math.inf),
    ],
)
def test_the_longest_latency_is_the_last_before_the_apr_falls(level, longest_s):
    party = PartyLatency(
        at_best=0.9,
        at_mean=0.5,
        at_worst=0.4,
        apr=(0.9, 0.5, 0.5, 0.4, 0.6),
    )
    assert party.longest_s((0.0, 0.005, 0.01, 0.015, 0.02), level) == longest_s


def test_curves_and_the_budgets_range_are_drawn():
    apr = {
        "vut": (0.5, 0.25),
        "A": (0.75, 0.5),
        "rsu_all": (1.0, 0.5),
        "vut_and_rsus": (1.0, 0.5),
    }
    parties = {
        name: PartyLatency(
            at_best=high,
            at_mean=high,
            at_worst=low,
            apr=(high, low),
        )
        for name, (high, low) in apr.items()
    }
    axes = plot_latency((0.0, 0.5), parties, load_latency_budget("cpm-50ms"))
    lines = {line.get_gid(): line for line in axes.get_lines()}

    assert set(lines) == {*parties, "mean"}
    assert np.array(lines["rsu_all"].get_data()).tolist() == [
        [0.0, 500.0],
        [100.0, 50.0],
    ]

    looks = [
        (lines[name].get_linestyle(), lines[name].get_linewidth()) for name in parties
    ]
    assert len(set(looks)) == len(parties)  # not by colour alone

    (shade,) = axes.patches
    assert shade.get_x() == pytest.approx(42.0)
    assert shade.get_width() == pytest.approx(93.0)


# Budgets in other commands


def _short(latency_s):
    """A latency in few digits. [s]"""
    if latency_s is None:
        return None
    return f"{latency_s:.9g}"


@click.command()
@question_options(*JUDGED)
def _plain(*, question):
    """A command that says what it was asked."""
    click.echo(f"{_short(build_rule(question).latency_s)} {question.speeds}")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("--speeds 30", "0.025 30"),
        ("--latency 0.05", "0.05 "),
        ("--latency-budget cpm-100ms --speeds 30", "0.1135 30"),
    ],
)
def test_a_command_gets_the_latency_of_the_budget(arguments, expected):
    done = CliRunner().invoke(_plain, arguments.split(), catch_exceptions=False)
    assert done.exit_code == 0
    assert done.output == expected + "\n"


def test_a_budget_that_a_command_cannot_take_is_told():
    done = CliRunner().invoke(_plain, ["--latency-budget=study", "--latency=0.05"])
    assert isinstance(done.exception, InputError)

    message = "latency_s: got it beside `latency_budget`; expected one of them"
    assert str(done.exception) == message


def test_without_a_budget_a_question_brakes_as_it_says():
    assert build_rule(Question(latency_s=0.3)).latency_s == 0.3
