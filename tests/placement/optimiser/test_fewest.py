"""The fewest units that reach the floors: by walks through all sets of a size."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from oracle import Oracle
from problems import random_problem

from placement.optimiser import (
    Effort,
    Floor,
    UnmetError,
    is_feasible,
    presolve,
    proof,
    solve_placement,
)
from placement.optimiser.constants import NEVER
from placement.optimiser.least import find_of_size
from placement.optimiser.problem import Objective
from placement.verification.instances import load_problem

ARMS = Path(__file__).parents[4] / "shared/inputs/placement/arms-388.npz"
TARGET = Floor(name="--target", share=0.96)


def no_model(*_, **__):
    """What a solver that finds out nothing says."""
    raise AssertionError("a model was handed to the solver")


def problems_with_floors(n_problems):
    """Random problems with floors, by their seeds."""
    found = []
    seed = 0
    while len(found) < n_problems:
        problem = random_problem(np.random.default_rng([46, seed]))
        if problem.floors:
            found.append((seed, replace(problem, goal="fewest", survive=0)))
        seed += 1

    return found


def test_all_sets_of_a_size_are_gone_through_for_one_that_reaches_the_floors():
    for seed, problem in problems_with_floors(60):
        reduced = presolve(problem)
        limits = problem.limits
        n_forced = int(limits.is_forced.sum())
        if not len(reduced.weight):
            continue

        for size in range(max(n_forced, 1), limits.max_units + 1):
            units, is_finished = find_of_size(reduced, size, deadline=NEVER)
            poses = reduced.pose_index.tolist()
            will_do = {
                one for one in combinations(poses, size) if is_feasible(problem, one)
            }
            where = f"seed {seed}, {size} units"
            if units is None:
                assert is_finished, where
                assert not will_do, where
            else:
                assert tuple(reduced.pose_index[units].tolist()) in will_do, where


def test_the_fewest_units_are_proven_without_a_model(monkeypatch):
    monkeypatch.setattr("placement.optimiser.constants.MAX_FEW_SETS", 0)
    monkeypatch.setattr("placement.optimiser.constants.MAX_SETS_OF_MONEY", 0)
    for seed, problem in problems_with_floors(40):
        layouts = Oracle(problem).layouts
        if not layouts:
            continue
        try:
            with pytest.MonkeyPatch.context() as patch:
                # None is stated.
                patch.setattr("placement.optimiser.constants.MAX_CELLS", -1)
                solution = solve_placement(
                    problem,
                    effort=Effort(workers=1),
                    n_stages=1,
                )
        except UnmetError:
            continue  # the search found no set to begin with, and nothing is proven

        stage = solution.certificate.stages[0]
        expected = min(len(poses) for poses in layouts)

        assert stage.name == Objective.UNITS
        assert stage.objective == expected, seed
        assert stage.gap == 0.0, seed


@pytest.mark.long
@pytest.mark.skipif(not ARMS.exists(), reason="the instance is not at hand")
def test_three_units_are_ruled_out_on_a_junction_with_arms(monkeypatch):
    monkeypatch.setattr(proof, "solve_window_model", no_model)
    problem = load_problem(ARMS)
    limits = replace(problem.limits, budget_units=None)
    asked = replace(
        problem,
        limits=limits,
        goal="fewest",
        floors=(TARGET,),
    )

    solution = solve_placement(asked, effort=Effort(time_limit_s=600.0))

    assert solution.certificate.is_proven
    assert [stage.objective for stage in solution.certificate.stages][:1] == [4.0]
    assert solution.certificate.solver == "branch and bound"
