"""Answers of every solver to random problems, checked against the enumeration of ``oracle``."""

import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from oracle import Oracle
from problems import random_problem

from geometry.errors import InputError
from placement.optimiser import Effort, PlacementProblem, solve_placement

SOLVERS = ("auto", "relax", "exact", "greedy")
EVERY_WAY = (*SOLVERS, "models", "walk")
"""Besides the solvers, the exact one where small problems are not gone through set by set."""


def check(problem: PlacementProblem, solver: str) -> None:
    """Check one way to solve a problem, by every stage's value, bound and gap."""
    oracle = Oracle(problem)
    is_exact = solver in ("auto", "exact") or (solver in ("models", "walk") and problem.tail == 1.0)
    with pytest.MonkeyPatch.context() as patch:
        if solver not in SOLVERS:
            patch.setattr("placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False))
        if solver == "models":
            patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
        effort = Effort(solver=solver if solver in SOLVERS else "exact", time_limit_s=600.0)
        try:
            solution = solve_placement(problem, effort=effort)
        except InputError:
            assert not (oracle.layouts and is_exact), "a layout that meets all wishes was not found"
            return
    oracle.check(solution.pose_index, solution.certificate.stages, proves=is_exact)


ROTATION = ("auto", "relax", "auto", "greedy", "auto", "relax", "exact", "walk", "auto", "models")


def faults(numbers: range) -> list[str]:
    """What is wrong with the answers to the random problems of some numbers."""
    warnings.simplefilter("error")
    found = []
    for number in numbers:
        way = ROTATION[number % len(ROTATION)]
        try:
            check(random_problem(np.random.default_rng([0, number])), way)
        except Exception as error:
            found.append(f"problem {number} by {way}: {error!r}")
    return found


def main() -> None:
    """Problems from one number to another, 500 at a time; faults are printed as they come."""
    first, end = (int(word) for word in sys.argv[1:3])
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        parts = [range(one, min(one + 500, end)) for one in range(first, end, 500)]
        for part, found in zip(parts, pool.map(faults, parts), strict=True):
            print(part.stop, *found, sep="\n  ", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
