"""Money: walks behind sets of sites against the enumeration of ``oracle``."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from oracle import Oracle
from problems import random_problem

from placement.optimiser import Effort, UnmetError, presolve, solve_placement
from placement.optimiser.allowed_sets import are_allowed
from placement.optimiser.constants import NEVER
from placement.optimiser.problem import Objective
from placement.optimiser.site_walk import find_site_sets
from placement.optimiser.walk import allowed_sets
from placement.pipeline import assemble, place
from placement.question import Question


def money_problems(n_problems, *, goal):
    """Random problems with prices of units and sites, by their seeds."""
    found = []
    seed = 0
    while len(found) < n_problems:
        rng = np.random.default_rng([52, seed])
        seed += 1
        problem = random_problem(rng)
        limits = replace(
            problem.limits,
            unit_cost_eur=rng.integers(1, rng.choice([2, 4]), problem.limits.n_poses),
            site_cost_eur=rng.integers(0, 4, problem.limits.n_sites),
            budget_eur=float(rng.integers(4, 12)),
        )
        if goal == "best":
            floors = ()
        else:
            floors = problem.floors
        if goal == "best" or floors:
            problem = replace(
                problem,
                limits=limits,
                floors=floors,
                goal=goal,
                survive=0,
                sample_index=None,
                tail=1.0,
            )
            found.append((seed, problem))

    return found


@pytest.fixture
def by_walks(monkeypatch):
    """Neither few sets nor models prove anything."""
    monkeypatch.setattr("placement.optimiser.constants.MAX_FEW_SETS", 0)
    monkeypatch.setattr("placement.optimiser.constants.MAX_SETS_OF_MONEY", 0)
    monkeypatch.setattr("placement.optimiser.constants.MAX_CELLS", -1)


def answers(goal, n_problems):
    """Solutions of random problems, and what the enumeration says of them."""
    for seed, problem in money_problems(n_problems, goal=goal):
        oracle = Oracle(problem)
        try:
            solution = solve_placement(problem, effort=Effort(workers=1))
        except UnmetError:
            continue  # the search found no set to begin with

        oracle.check(solution.pose_index, solution.certificate.stages, largest_gap=inf)
        yield seed, problem, oracle, solution


@pytest.mark.long
def test_the_best_for_the_money_is_proven_without_a_model(by_walks):
    n_proven = 0
    n_answers = 0
    for seed, _, _, solution in answers("best", 150):
        n_answers += 1
        first = solution.certificate.stages[0]

        assert first.name == Objective.APR
        assert first.gap == 0.0, seed

        # Where all poses together are no better, nothing is walked.
        if solution.certificate.solver == "branch and bound":
            assert solution.certificate.is_proven, seed
            n_proven += 1

    assert n_answers > 100
    assert n_proven > 10


@pytest.mark.long
def test_the_least_cost_is_proven_without_a_model(by_walks):
    n_answers = 0
    for seed, problem, oracle, solution in answers("cheapest", 150):
        # Where nothing can be avoided, nothing is walked.
        if "branch and bound" not in str(solution.certificate.solver):
            continue
        n_answers += 1
        first = solution.certificate.stages[0]
        least = min(
            float(problem.limits.unit_cost_eur[list(poses)].sum())
            + float(
                problem.limits.site_cost_eur[
                    np.unique(problem.limits.site_index[list(poses)])
                ].sum()
            )
            for poses in oracle.layouts
        )

        assert first.name == Objective.COST
        assert first.objective == pytest.approx(least), seed
        assert first.gap == 0.0, seed

    assert n_answers > 20


def test_every_set_within_the_money_is_part_of_one_behind_its_sites():
    for seed, problem in money_problems(60, goal="best"):
        reduced = presolve(problem)
        sites = find_site_sets(reduced, least=-inf, deadline=NEVER)

        sizes = allowed_sets(reduced.limits, max_sets=10**6)

        assert sites is not None
        assert sizes is not None

        for sets in sizes:
            for units in sets[are_allowed(reduced.limits, sets)]:
                is_used = np.zeros(reduced.limits.n_sites, dtype=bool)
                is_used[reduced.limits.site_index[units]] = True
                mine = (sites.is_used == is_used).all(axis=1)

                assert mine.sum() == 1, seed
                assert len(units) <= sites.most[mine], seed


@pytest.mark.long
@pytest.mark.parametrize(
    ("question", "expected"),
    [
        (
            Question(budget_cost=9000.0, site_cost_eur=2000.0, time_limit_s=600.0),
            {Objective.APR_SURVIVED: 0.731312, Objective.COST: 8500.0},
        ),
        (
            Question(target="0.99", least="cost", time_limit_s=600.0),
            {Objective.COST: 19700.0},
        ),
    ],
)
def test_both_questions_of_the_help_about_money_are_proven(question, expected):
    placement = place(assemble(question))
    stages = {stage.name: stage for stage in placement.certificate.stages}

    assert placement.is_proven
    for objective, value in expected.items():
        assert stages[objective].objective == pytest.approx(value, abs=1e-6)

    assert "HiGHS" not in str(placement.certificate.solver)
