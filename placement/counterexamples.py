"""Sets of poses that would disprove a certificate: looked for among all, or near the layout.

A bound of a stage says: no set that is as good in all stages before is better than this. One that
is disproves it. Like :mod:`placement.recomputation`, this shares nothing with the optimiser.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .layout import Stage
from .reach import most_units, usable_poses
from .recomputation import (
    EPSILON,
    EPSILON_EUR,
    LEAST_IS_BEST,
    floor_values,
    limit_checks,
    stage_values,
)

if TYPE_CHECKING:
    from .optimiser import PlacementProblem


class BestOther(NamedTuple):
    """The best of the sets that were compared in a stage.

    Attributes
    ----------
    name : str
        The stage.
    value : float
        Of the best set that is as good as the layout in all stages before; NaN if none is.
    poses : tuple of int
        The set.
    """

    name: str
    value: float
    poses: tuple[int, ...]


def noise(name: str) -> float:
    """Difference up to which two values of a stage are equal."""
    return EPSILON_EUR if name == "cost_eur" else EPSILON


def excess(name: str, value: float, other: float) -> float:
    """How much better a value of a stage is than another."""
    return other - value if name in LEAST_IS_BEST else value - other


def n_sets_of_all(problem: "PlacementProblem") -> int:
    """How many sets :func:`all_sets` goes through."""
    n_usable = len(usable_poses(problem))
    return sum(math.comb(n_usable, size) for size in range(1, most_units(problem) + 1))


def all_sets(problem: "PlacementProblem") -> Iterator[IntArray]:
    """All sets of usable poses that are not too large, (n_sets, n_units) for each size."""
    usable = usable_poses(problem)
    for size in range(1, most_units(problem) + 1):
        yield np.array(list(combinations(usable.tolist(), size)), dtype=np.int64)


def neighbours(problem: "PlacementProblem", rows: Sequence[int]) -> Iterator[IntArray]:
    """The layout, and all sets with one unit left out, exchanged or added, size by size."""
    layout = np.array(rows, dtype=np.int64)
    others = np.setdiff1d(usable_poses(problem), layout)
    fewer = [np.delete(layout, index) for index in range(len(layout))]
    if len(layout) > 1:
        yield np.array(fewer)
    exchanged = [_with_each(left, others) for left in fewer]
    yield np.concatenate([layout[None, :], *exchanged])
    yield _with_each(layout, others)


def n_neighbours(problem: "PlacementProblem", rows: Sequence[int]) -> int:
    """How many sets :func:`neighbours` goes through."""
    n_others = len(np.setdiff1d(usable_poses(problem), rows))
    n_fewer = len(rows) if len(rows) > 1 else 0
    return n_fewer + 1 + (len(rows) + 1) * n_others


def best_others(
    problem: "PlacementProblem", stages: Sequence[Stage], families: Iterator[IntArray]
) -> list[BestOther]:
    """Best value of each stage among sets of poses.

    Parameters
    ----------
    problem : PlacementProblem
        Table, rule, limits.
    stages : sequence of Stage
        As claimed; what a layout must be as good as.
    families : iterator of (n_sets, n_units) int
        Sets to compare; those that are not allowed, or miss a floor, are left out.

    Returns
    -------
    best : list of BestOther
        One per stage.
    """
    alive = [kept for sets in families if len(kept := _allowed(problem, sets))]
    best = []
    for stage in stages:
        found = BestOther(stage.name, math.nan, ())
        still_alive = []
        for sets in alive:
            value = stage_values(problem, stage.name, sets)
            first = int(np.argmin(value) if stage.name in LEAST_IS_BEST else np.argmax(value))
            if not found.poses or excess(stage.name, float(value[first]), found.value) > 0.0:
                found = BestOther(stage.name, float(value[first]), tuple(sets[first].tolist()))
            kept = sets[_as_good(stage, value)]
            if len(kept):
                still_alive.append(kept)
        best.append(found)
        alive = still_alive
    return best


def _allowed(problem: "PlacementProblem", sets: IntArray) -> IntArray:
    """Those of the sets that are within all limits and reach all floors."""
    kept = sets[np.logical_and.reduce(list(limit_checks(problem, sets).values()))]
    for floor in problem.floors:
        kept = kept[floor_values(problem, floor, kept) >= floor.share - EPSILON]
    return kept


def _as_good(stage: Stage, value: FloatArray) -> BoolArray:
    if stage.name in LEAST_IS_BEST:
        return value <= stage.objective + noise(stage.name)
    return value >= stage.objective - noise(stage.name)


def _with_each(units: IntArray, others: IntArray) -> IntArray:
    """Some units together with each of other poses in turn, (n_others, n_units + 1)."""
    return np.column_stack([np.tile(units, (len(others), 1)), others])
