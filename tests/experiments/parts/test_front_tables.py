"""Tables and figures of fronts: rows, proofs, gains."""

import math
from dataclasses import replace

import msgspec
import pytest
from json_files import as_json
from small_tables import avoiding_problem
from tiny_worlds import unit_at

from experiments.parts.front import (
    FrontRecord,
    describe_front,
    notes,
)
from experiments.parts.front import table as front_table
from experiments.parts.front_curves import plot_front
from experiments.results.record import to_plain
from placement.optimiser import solve_placement
from placement.optimiser.front import front_below, pareto_front


def record_of(summary):
    """Read back from JSON."""
    return msgspec.convert(as_json(summary), FrontRecord)


@pytest.fixture
def candidates():
    return [unit_at(f"p<{index}>") for index in range(8)]


def front_of(n_units):
    """Every unit of n avoids a run of its own."""
    rows = [f"{1 << unit:08b}" for unit in range(8)]
    problem = avoiding_problem(rows, budget_units=n_units)
    solution = solve_placement(problem)
    return problem, front_below(problem, solution.pose_index, solution.certificate)


@pytest.mark.long
@pytest.mark.parametrize("n_units", [1, 8])
def test_any_number_of_points_is_shown_with_its_proof(n_units, candidates):
    problem, front = front_of(n_units)
    summary = to_plain(describe_front(front, problem, candidates))
    record = record_of(summary)
    table = front_table(record)
    expected = [[str(n), f"{12.5 * n:.1f} %"] for n in range(1, n_units + 1)]

    assert [row[:2] for row in table.rows] == expected
    assert {row[-1] for row in table.rows} == {"proven"}
    assert len(plot_front(record).get_lines()) > 0


def test_a_row_with_fewer_units_than_it_allows_says_so(candidates):
    enough = avoiding_problem(["11", "11", "11"], budget_units=3)
    front = describe_front(pareto_front(enough, max_units=3), enough, candidates)
    assert [len(point.layout) for point in front.points] == [1, 2, 2]

    note = "A layout has fewer units than its row allows if more would add nothing."
    assert notes(front)[1:] == [note]

    problem, full = front_of(3)
    assert len(notes(describe_front(full, problem, candidates))) == 1


def test_a_front_survives_its_plain_object(candidates):
    problem, front = front_of(3)
    record = describe_front(front, problem, candidates)
    back = record_of(record)

    assert back == record

    drawn, again = (
        [line.get_ydata().tolist() for line in plot_front(one).get_lines()]
        for one in (record, back)
    )
    assert drawn == again


def loosened(front, index, stage_index, bound):
    """A front of which an objective of a point has another bound."""
    point = front.points[index]
    stages = list(point.certificate.stages)
    stages[stage_index] = replace(stages[stage_index], bound=bound, gap=math.inf)
    certificate = replace(point.certificate, stages=tuple(stages))
    points = list(front.points)
    points[index] = replace(point, certificate=certificate)
    return replace(front, points=tuple(points))


@pytest.mark.long
def test_what_is_open_is_said_and_never_called_proven(candidates):
    problem, front = front_of(2)
    half = loosened(front, 1, 0, 0.875)
    record = describe_front(half, problem, candidates)

    assert record.sentences[0].startswith("1 of 2 points are proven")
    assert [row[-1] for row in front_table(record).rows] == ["proven", "APR <= 87.50 %"]

    none = describe_front(loosened(half, 0, 4, 10.0), problem, candidates)
    assert none.sentences[0].startswith("0 of 2 points are proven")
    assert front_table(none).rows[0][-1] == "EUR >= 10.000"

    unknown = loosened(front, 1, 1, math.inf)
    table = front_table(record_of(describe_front(unknown, problem, candidates)))
    assert table.rows[1][-1] == "one fails open"


def test_gains_are_points_over_the_row_above(candidates):
    problem, front = front_of(3)
    shown = front_table(describe_front(front, problem, candidates))
    assert [row[shown.columns.index("gain")] for row in shown.rows] == ["12.5"] * 3


def test_the_first_gain_is_over_what_cars_avoid_by_themselves(candidates):
    blind, _ = front_of(2)
    # Cars see what the last pose sees, which nobody mounts: one run of eight.
    problem = replace(blind, seen_by_vut=blind.table.detected(slice(7, 8))[0])
    front = pareto_front(problem, max_units=2)
    record = describe_front(front, problem, candidates)

    assert record.cars_alone == pytest.approx(0.125)

    rows = [row[:3] for row in front_table(record).rows]
    assert rows[0][:2] == ["0", "12.5 %"]
    assert rows[1:] == [
        ["1", "25.0 %", "12.5"],
        ["2", "37.5 %", "12.5"],
    ]


def test_a_settled_front_and_sizes_that_cannot_be_are_said(candidates):
    problem = avoiding_problem(["11", "11", "10"])
    found = pareto_front(problem, max_units=4)
    refused = replace(found, refused=((1, "a reason"),))
    proof, settled, reason = describe_front(refused, problem, candidates).sentences

    assert proof.startswith("Proven: for each number of units no other choice")
    assert settled.startswith("From 2 units on, nothing improves")
    assert reason == "With 1, the requirements cannot be met: a reason."
