"""``place-rsus pareto`` on a few runs and poses; its table, figure and CSV."""

import csv
import io
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from command_results import answer, refusal
from json_files import read_json
from msgspec.structs import asdict as fields_of
from PIL import Image
from small_tables import avoiding_problem
from tiny_worlds import unit_at

from experiments import main
from experiments.cli.pareto import front_text, pareto
from experiments.jobs.pareto import FrontResult, front_rows
from experiments.parts.front import describe_front
from experiments.parts.front_curves import plot_front
from experiments.results.drives import build_drives_record
from placement.layout import layout_from_records
from placement.optimiser.cost_front import cost_front
from placement.optimiser.front import pareto_front, tightened


@pytest.fixture
def run_pareto(run, small_study):
    """Runs the command on a few runs."""
    main.cli.add_command(pareto)
    return lambda *arguments: run("pareto --quiet", *arguments)


@pytest.fixture
def loosened_front():
    """A front of two units whose second point is not proven."""
    front = pareto_front(avoiding_problem(["1100", "0110", "0011"]), max_units=2)
    first, second = front.points
    stage = replace(second.certificate.stages[1], bound=0.75, gap=0.5)
    certificate = replace(
        second.certificate, stages=(second.certificate.stages[0], stage)
    )
    return replace(
        front, points=(first, replace(second, certificate=certificate)), settled=None
    )


# The whole command


@pytest.mark.long
def test_every_number_of_units_has_a_proven_layout(run_pareto):
    folder = Path("there/front")
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("kept")
    summary = json.loads(answer(run_pareto("--max 3 --out", folder, "--json")))

    assert summary["by"] == "units"
    assert summary["optimised"] == "first"
    assert summary["is_proven"]

    points = summary["points"]
    assert [point["units"] for point in points] == [1, 2, 3]

    values = [(point["apr"], point["apr_one_failed"]) for point in points]
    assert all(fewer <= more for fewer, more in pairwise(values))

    for point in points:
        assert [stage["gap"] for stage in point["stages"]] == [0.0] * 2

        layout = layout_from_records("any", point["layout"], "pareto.json")
        assert len(layout.units) == len(point["pose_ids"]) <= point["units"]
        assert point["cost_eur"] == sum(unit.sensor.price_eur for unit in layout.units)
    assert summary["sentences"][0].startswith("Proven: for each number of units ")
    assert {path.name for path in folder.iterdir()} == {
        "notes.txt",
        "pareto.csv",
        "pareto.json",
        "pareto.png",
    }
    assert read_json(folder / "pareto.json") == summary

    rows = list(csv.DictReader(io.StringIO((folder / "pareto.csv").read_text())))
    assert [float(row["apr_bound"]) for row in rows] == [
        point["apr"] for point in points
    ]

    with Image.open(folder / "pareto.png") as picture:
        assert picture.width == 1088


# Quickly: what is written, below, and placement/optimiser/test_cost_front.py
@pytest.mark.long
def test_money_and_kept_units_and_the_text(run_pareto):
    out = answer(run_pareto("--by cost --site-cost 1000 --max 2 --json"))
    summary = json.loads(out)
    costs = [point["cost_eur"] for point in summary["points"]]

    assert costs[0] == 2500.0
    assert all(cheaper < dearer for cheaper, dearer in pairwise(costs))
    assert summary["sentences"][0].startswith("Proven: for each sum of money ")

    out = answer(run_pareto("--keep carlancap-12 --max 1"))
    rows = [line.split() for line in out.splitlines()]

    assert [row[0] for row in rows if row[-1:] == ["proven"]] == ["12", "13"]
    assert max(map(len, out.splitlines())) <= 80


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--max", "0"),
            "--max: got '0'; expected a whole number of units, at least 1",
        ),
        (("--by", "luck"), "--by: got 'luck'; expected one of units, cost"),
        (("--budget", "3"), "No such option '--budget'"),
    ],
)
def test_what_cannot_be_is_one_line(run_pareto, arguments, message):
    Path("mine.txt").write_text("a file")
    assert refusal(run_pareto(*arguments)).startswith(f"{message}")
    assert [path.name for path in Path().iterdir()] == ["mine.txt"]


def test_a_wish_that_cannot_be_met_is_told(run_pareto):
    assert refusal(run_pareto("--budget-cost 100 --max 2")).startswith(
        "--budget-cost: got 100.0; expected at least 1500.00 EUR"
    )


def test_options_that_are_left_out_do_not_reach_other_commands():
    from experiments.cli.pareto import retrofit

    names = {param.name for param in main.cli.params}
    assert {"budget", "target", "survive", "keep"} <= names

    (limit,) = (param for param in main.cli.params if param.name == "time_limit_s")
    assert limit.default == 60.0
    assert "keep" in {param.name for param in pareto.params}
    assert "keep" not in {param.name for param in retrofit.params}


# Text, table, figure


def described(front, problem):
    """Record of a front whose poses are called p0, p1 and so on."""
    candidates = [unit_at(f"p{name}") for name in problem.table.pose_ids]
    return describe_front(front, problem, candidates)


def drawn(front, problem):
    """The figure of a front."""
    return plot_front(described(front, problem))


def test_the_text_says_what_is_not_proven(loosened_front, small_study):
    problem = avoiding_problem(["1100", "0110", "0011"])
    summary = FrontResult(
        **fields_of(described(loosened_front, problem)),
        command="place-rsus pareto",
        **fields_of(build_drives_record(small_study)),
        seconds={},
        versions={},
    )
    text = front_text(summary, None)
    rows = [line.split() for line in text.splitlines()]
    first = ("1", "50.0", "%", "50.0", "0.0", "%", "0.065", "0.065", "1,000", "proven")

    assert [*first] in rows
    assert ["one", "fails", "<=", "75.00", "%"] in [row[-5:] for row in rows]
    assert summary.is_proven is False
    assert max(map(len, text.splitlines())) <= 80

    rows = front_rows(summary)
    assert [row["apr_one_failed_bound"] for row in rows] == [0.0, 0.75]
    assert [row["mean_margin_s_bound"] for row in rows] == [None, None]
    assert [row["poses"] for row in rows] == ["p0", "p0 p2"]


def test_open_bounds_are_drawn_apart_and_kinds_differ_by_more_than_colour(
    loosened_front,
):
    axes = drawn(loosened_front, avoiding_problem(["1100", "0110", "0011"]))
    lines = {line.get_gid(): line for line in axes.get_lines() if line.get_gid()}

    assert lines["apr"].get_ydata().tolist() == [50.0, 100.0]
    assert lines["apr_one_failed"].get_ydata().tolist() == [0.0, 50.0]
    assert lines["apr_one_failed bound"].get_xdata().tolist() == [2.0]
    assert lines["apr_one_failed bound"].get_ydata().tolist() == [75.0]
    assert lines["apr_one_failed bound"].get_markerfacecolor() == "none"
    assert "apr bound" not in lines
    assert lines["apr"].get_marker() != lines["apr_one_failed"].get_marker()
    assert not [patch for patch in axes.patches if patch.get_gid() == "settled"]


def test_where_nothing_grows_the_ground_is_grey():
    problem = avoiding_problem(["11", "11", "10"])
    front = pareto_front(problem, max_units=4)
    axes = drawn(front, problem)
    (shade,) = (patch for patch in axes.patches if patch.get_gid() == "settled")

    assert shade.get_x() == front.settled == 2.0
    assert shade.get_x() + shade.get_width() == pytest.approx(axes.get_xlim()[1])


def test_costs_are_drawn_as_steps_to_the_right_edge():
    problem = avoiding_problem(["1100", "0011"], price_eur=[1000.0, 2000.0])
    axes = drawn(cost_front(problem), problem)
    steps = [line for line in axes.get_lines() if line.get_drawstyle() == "steps-post"]

    assert steps[0].get_xdata().tolist() == [1000.0, 3000.0, axes.get_xlim()[1]]
    assert steps[0].get_ydata().tolist() == [50.0, 100.0, 100.0]
    assert axes.get_xlabel() == "cost (EUR)"


def test_a_bound_is_only_ever_tightened():
    stage = (
        pareto_front(avoiding_problem(["1100"]), max_units=1)
        .points[0]
        .certificate.stages[0]
    )
    loose = replace(stage, bound=0.9, gap=0.8)

    assert tightened(loose, 0.7).bound == 0.7
    assert tightened(loose, 0.95).bound == 0.9
    assert tightened(loose, 0.5).gap == 0.0
