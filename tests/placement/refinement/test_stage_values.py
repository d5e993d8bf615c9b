"""Values by which refined layouts are compared, stage by stage."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems, questions

from geometry.errors import InputError
from placement.layout import Certificate, Stage
from placement.optimiser import Effort, is_better, placement_value, solve_placement
from placement.optimiser.problem import Objective, objective_values
from placement.refinement import certify, improves


@given(questions())
def test_stages_are_those_of_the_certificate_with_the_same_values(problem):
    try:
        effort = Effort(solver="greedy")
        solution = solve_placement(problem, effort=effort)
    except InputError:
        return

    values = objective_values(problem, solution.pose_index)
    stages = solution.certificate.stages
    names = [stage.name for stage in stages]

    assert [*values] == names

    expected = [stage.objective for stage in stages]

    assert [*values.values()] == pytest.approx(expected, abs=1e-12)


@given(problems(), st.data())
def test_without_further_wishes_a_set_improves_where_its_value_is_better(problem, data):
    n_poses = problem.table.n_poses
    pose = st.integers(0, n_poses - 1)
    poses_drawn = st.sets(pose, min_size=1, max_size=3)
    sets = poses_drawn.map(sorted)
    one = data.draw(sets)
    other = data.draw(sets)

    values = [placement_value(problem, units) for units in (one, other)]

    assert improves(
        objective_values(problem, one), objective_values(problem, other)
    ) == is_better(*values)


def test_units_and_cost_are_the_better_the_smaller():
    few = {Objective.UNITS: 2.0, Objective.APR: 0.5}
    many = {Objective.UNITS: 3.0, Objective.APR: 0.9}

    assert improves(few, many)
    assert not improves(many, few)
    assert not improves(few, few)

    dear = {Objective.COST: 1500.0}
    cheap = {Objective.COST: 1499.0}
    cheaper = {Objective.COST: 1500.0 - 1e-9}

    assert improves(cheap, dear)
    assert not improves(dear, cheap)
    assert not improves(cheaper, dear)


def test_bounds_are_kept_and_gaps_are_those_of_the_better_set():
    def stage(name, objective, bound):
        return Stage(
            name=name,
            objective=objective,
            bound=bound,
            gap=9.0,
            seconds=1.5,
        )

    certificate = Certificate(
        stages=(
            stage("units", 3.0, 2.0),
            stage("apr", 0.5, 0.75),
            stage("mean_margin_s", 1.0, 1.5),
            stage("cost_eur", 4000.0, 2000.0),
        ),
        solver="some",
    )
    values = {
        Objective.UNITS: 2.0,
        Objective.APR: 0.6,
        Objective.MEAN_MARGIN: 2.0,
        Objective.COST: 2500.0,
    }

    made = certify(values, certificate, "any")
    gaps = [s.gap for s in made.stages]
    seconds = {s.seconds for s in made.stages}

    assert made.solver == "any"
    assert [(s.objective, s.bound) for s in made.stages] == [
        (2.0, 2.0),
        (0.6, 0.75),
        # A bound below what is at hand held for sets worse in the stages before.
        (2.0, 2.0),
        (2500.0, 2000.0),
    ]
    assert gaps == pytest.approx([0.0, 0.25, 0.0, 0.2])
    assert seconds == {1.5}
