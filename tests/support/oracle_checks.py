"""Answers of every solver to random problems, checked against the enumeration of
``oracle``.
"""

import sys
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from math import inf
from multiprocessing import get_context

import numpy as np
import pytest
from oracle import Oracle
from problems import kinds_of, random_problem

from geometry.errors import InputError
from placement.optimiser import Effort, PlacementProblem, Solution, solve_placement

SOLVERS = ("auto", "relax", "exact", "greedy")
EVERY_WAY = (*SOLVERS, "models", "walk", "large")
"""Besides the solvers, the exact one where small problems are not gone through set by
set,
and the usual one where every table is too large to be solved as a whole."""


def check(problem: PlacementProblem, way: str) -> None:
    """Check one way to solve a problem, by every stage's value, bound and gap."""
    oracle = Oracle(problem)
    is_by_model = way in ("models", "walk") and problem.tail == 1.0
    is_exact = way in ("auto", "exact") or is_by_model
    effort = Effort(solver=_solver_of(way), time_limit_s=600.0, workers=1)
    with pytest.MonkeyPatch.context() as patch:
        if way in ("models", "walk"):
            patch.setattr(
                "placement.optimiser.proof.best_of_few", lambda *_, **__: (None, False)
            )
        if way == "models":
            patch.setattr("placement.optimiser.proof.can_walk", lambda _: False)
            for name in ("least", "site_walk"):
                place = f"placement.optimiser.{name}.find_site_sets"
                patch.setattr(place, lambda *_, **__: None)
        if way == "large":
            patch.setattr("placement.optimiser.constants.MAX_BITS", 1)
            patch.setattr("placement.optimiser.constants.POOL_POSES", 4)
        solution, refusal = _answer(problem, effort)

    if solution is None:
        says_none = not any(words in refusal for words in NOT_FOUND)
        is_false = (is_exact or says_none) and oracle.is_clearly_met()
        assert not is_false, f"a layout meets all wishes, but: {refusal}"
        return
    largest_gap = inf
    if is_exact and not oracle.is_ambiguous(solution.pose_index):
        largest_gap = 0.0
        if is_by_model:
            if oracle.least_weight >= TELLS_APART:
                largest_gap = GAP_OF_TIES
            else:
                largest_gap = inf
    stages = solution.certificate.stages
    oracle.check(solution.pose_index, stages, largest_gap=largest_gap)


TELLS_APART = 8.0e-9
"""Runs that weigh less are avoided, or not, at the same APR as far as models tell."""
GAP_OF_TIES = 1.0e-6
"""Models bound a mean margin for all APRs that tie; only sets that are compared close
it.
"""
NOT_FOUND = ("none was found", "more time than the limit")
"""Refusals that say so do not claim that no layout meets the wishes."""


def _answer(problem: PlacementProblem, effort: Effort) -> tuple[Solution | None, str]:
    """The solution, or None and why there is none."""
    try:
        return solve_placement(problem, effort=effort), ""
    except InputError as error:
        return None, str(error)


def _solver_of(way: str) -> str:
    """Name of the solver behind a way of solving."""
    if way in SOLVERS:
        return way
    if way == "large":
        return "auto"
    return "exact"


ROTATION = (
    *(
        "auto",
        "large",
        "relax",
        "auto",
        "greedy",
        "auto",
        "exact",
        "walk",
        "auto",
        "large",
    ),
    *(
        "auto",
        "large",
        "relax",
        "auto",
        "greedy",
        "auto",
        "exact",
        "walk",
        "auto",
        "models",
    ),
)


def faults(numbers: range) -> tuple[list[str], Counter[str]]:
    """What is wrong with the answers to random problems, and how many of each kind."""
    warnings.simplefilter("error")
    found = []
    kinds: Counter[str] = Counter()

    for number in numbers:
        way = ROTATION[number % len(ROTATION)]
        problem = random_problem(np.random.default_rng([0, number]))
        kinds.update([*kinds_of(problem), f"by {way}"])
        try:
            check(problem, way)
        except Exception as error:
            found.append(f"problem {number} by {way}: {error!r}")

    return found, kinds


def rates(kinds: Counter[str], n_problems: int) -> str:
    """A line for each kind of problem drawn: its rate, the rarest first."""
    rarest_first = sorted(kinds.items(), key=lambda kind: kind[1])
    return "\n".join(
        f"{count / n_problems:7.1%}  {kind}" for kind, count in rarest_first
    )


def main() -> None:
    """Problems from one number to another, 500 at a time; faults are printed as they
    come.
    """
    first, end = (int(word) for word in sys.argv[1:3])
    kinds: Counter[str] = Counter()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        parts = [range(one, min(one + 500, end)) for one in range(first, end, 500)]
        for part, (found, of_part) in zip(parts, pool.map(faults, parts), strict=True):
            kinds.update(of_part)
            print(part.stop, *found, sep="\n  ", flush=True)  # noqa: T201

    print(rates(kinds, end - first))  # noqa: T201


if __name__ == "__main__":
    main()
