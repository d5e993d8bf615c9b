"""All sets of poses of small problems, one by one: what brute force goes through."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import combinations

import numpy as np
import pytest

from geometry.arrays import IntArray
from placement.optimiser import (
    PlacementProblem,
    PlacementValue,
    is_better,
    is_feasible,
    placement_value,
)
from placement.optimiser.allowed_sets import are_allowed
from placement.optimiser.presolve import ReducedProblem

MINIMISED = ("units", "cost_eur")
"""Stages of which less is better."""


def sign_of(stage: str) -> float:
    """1 for a stage of which more is better, -1 for one of which less is."""
    return -1.0 if stage in MINIMISED else 1.0


def sets_of_size(n_poses: int, size: int) -> IntArray:
    """All sets of so many of the first poses, (n_sets, size)."""
    sets = np.array(list(combinations(range(n_poses), size)), dtype=np.int64)
    return sets.reshape(-1, size)


def allowed_sets(reduced: ReducedProblem, size: int) -> IntArray:
    """Allowed sets of so many poses of a presolved problem, (n_sets, size)."""
    sets = sets_of_size(reduced.n_poses, size)
    return sets[are_allowed(reduced.limits, sets)]


def feasible_layouts(
    problem: PlacementProblem, poses: Iterable[int] | None = None
) -> list[tuple[int, ...]]:
    """Layouts of any size that meet all limits and floors, among all or some poses."""
    choice = list(range(problem.table.n_poses) if poses is None else poses)
    layouts = []
    for size in range(1, len(choice) + 1):
        for layout in combinations(choice, size):
            if is_feasible(problem, layout):
                layouts.append(layout)

    return layouts


def best_value(
    problem: PlacementProblem, poses: Iterable[int] | None = None
) -> PlacementValue | None:
    """Best value of all feasible layouts, among all or some poses; None without any."""
    best = None
    for layout in feasible_layouts(problem, poses):
        value = placement_value(problem, layout)
        if best is None or is_better(value, best):
            best = value

    return best


def first_units(reduced: ReducedProblem, _: object, **__: object) -> IntArray:
    """In place of the search for a first set: one pose, whatever it is worth."""
    return np.arange(min(reduced.n_poses, 1))


@contextmanager
def solved_by_models(*, is_poorly_begun: bool = False) -> Iterator[None]:
    """Prove everything by models, as for problems too large to be gone through.

    Where ``is_poorly_begun``, no search helps the models with a good first set.
    """
    proof = "placement.optimiser.proof"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{proof}.can_walk", lambda _: False)
        for name in ("least", "site_walk"):
            place = f"placement.optimiser.{name}.find_site_sets"
            patch.setattr(place, lambda *_, **__: None)
        patch.setattr(f"{proof}.best_of_few", lambda *_, **__: (None, False))
        if is_poorly_begun:
            patch.setattr(f"{proof}.search_from_many_starts", first_units)
            patch.setattr(f"{proof}.improve", lambda _, units, *__, **___: units)
        yield
