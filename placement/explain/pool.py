"""Other sets of poses that are as good as the best one, or nearly: the planner's room to choose."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.errors import InputError

from ..optimiser import (
    PlacementProblem,
    PlacementValue,
    ReducedProblem,
    is_feasible,
    placement_value,
)
from ..optimiser.bitsets import set_values
from ..optimiser.limits import COST_TOLERANCE_EUR
from .every_set import Listed, list_every_set
from .exchange import list_by_exchange
from .rows import exceeds_clearly, first_column, threshold_of
from .undominated import presolve_undominated

Scope = Literal["all", "found"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PooledSet:
    """A set of poses.

    Attributes
    ----------
    pose_index : tuple of int
        Rows of the table, ascending.
    value : PlacementValue
        What it is worth.
    objective : float
        Its value in the first stage.
    """

    pose_index: tuple[int, ...]
    value: PlacementValue
    objective: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pool:
    """Sets of poses that are the best one's equals in the first stage, or nearly.

    Attributes
    ----------
    stage : str
        Name of the first stage, as in the certificate.
    tolerance : float
        How much worse a set may be in it: a share of the runs; of the number of units or the cost
        where these come first.
    scope : {"all", "found"}
        "all": every set was gone through, and no set of the table that is better than the last one
        listed is missing. "found": what exchanging units one for one has led to; there may be more.
    sets : tuple of PooledSet
        The best first, by all stages in order.
    n_within : int
        Sets within the tolerance: all that there are, or those listed if scope is "found".
    pose_share : (n_poses,) float
        Share of the `n_within` sets that have each pose.
    site_share : (n_sites,) float
        Share of them that have a unit at each site of the problem's limits.
    """

    stage: str
    tolerance: float
    scope: Scope
    sets: tuple[PooledSet, ...]
    n_within: int
    pose_share: FloatArray
    site_share: FloatArray

    def __post_init__(self) -> None:
        for name in ("pose_share", "site_share"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    def __repr__(self) -> str:
        return f"Pool({len(self.sets)} of {self.n_within} sets, {self.scope})"


def find_pool(
    problem: PlacementProblem,
    pose_index: Sequence[int],
    *,
    n_sets: int = 20,
    tolerance: float = 0.0,
    max_prefixes: int = 5000,
    max_looks: int = 120,
) -> Pool:
    """The best sets of poses, of those within a tolerance of the first stage.

    Parameters
    ----------
    problem : PlacementProblem
        What was solved.
    pose_index : sequence of int
        Its solution: within the limits, and reaching the floors.
    n_sets : int
        How many to list.
    tolerance : float
        See :class:`Pool`.
    max_prefixes : int
        All sets of K units are gone through if there are no more sets of K - 1 units than this:
        each of them is looked at together with every pose at once.
    max_looks : int
        Else: of sets with one unit taken away, together with every pose, while exchanging.

    Returns
    -------
    pool : Pool
        No two sets are equal. Poses that are dominated, or detect the same as others, are poses
        like all others here: to a planner another pole is another answer. Only poses that detect
        nothing that could save a run any sooner are left out, unless they are asked for: a set is
        listed without such needless units.

    Raises
    ------
    InputError
        The poses are no solution, or a number cannot be.
    """
    if n_sets < 1:
        raise InputError("--pool", n_sets, "a number of layouts, at least 1")
    if not 0.0 <= tolerance <= 1.0:
        raise InputError("--pool-tolerance", tolerance, "a share, 0 to 1")
    if not is_feasible(problem, pose_index):
        raise InputError("pose_index", list(pose_index), "a set that meets limits and floors")
    reduced = presolve_undominated(problem)
    start = np.flatnonzero(np.isin(reduced.pose_index, list(pose_index)))
    column = first_column(reduced)
    best = float(set_values(reduced, start[None, :])[0, column])
    reduced = _bounded(reduced, best, tolerance)
    listed = list_every_set(
        reduced,
        threshold_of(reduced, best, tolerance),
        n_sets=n_sets,
        max_prefixes=max_prefixes,
    )
    if listed is not None and exceeds_clearly(listed.best, best):  # not quite a solution: again
        listed = list_every_set(
            reduced,
            threshold_of(reduced, listed.best, tolerance),
            n_sets=n_sets,
            max_prefixes=max_prefixes,
        )
    scope: Scope = "found" if listed is None else "all"
    if listed is None:
        listed = list_by_exchange(
            reduced, start, tolerance=tolerance, n_sets=n_sets, max_looks=max_looks
        )
    return _build_pool(problem, reduced, listed, scope=scope, tolerance=tolerance)


def _bounded(reduced: ReducedProblem, best: float, tolerance: float) -> ReducedProblem:
    """Where few units or little money come first: no set has more than is within the tolerance."""
    limits, most = reduced.limits, -best * (1.0 + tolerance)
    if reduced.goal == "fewest":
        n_units = int(np.floor(most + 1.0e-6))
        n_units = min(n_units, limits.max_units)
        limits = replace(limits, budget_units=max(n_units, 1))
    elif reduced.goal == "cheapest":
        allowed = most if limits.budget_eur is None else min(most, limits.budget_eur)
        limits = replace(limits, budget_eur=allowed + COST_TOLERANCE_EUR)
    return replace(reduced, limits=limits)


def _build_pool(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    listed: Listed,
    *,
    scope: Scope,
    tolerance: float,
) -> Pool:
    limits = problem.limits
    sets = []
    for units, row in zip(listed.sets, listed.rows, strict=True):
        poses = tuple(sorted(reduced.pose_index[units].tolist()))
        sign = 1.0 if problem.goal == "best" else -1.0
        sets.append(
            PooledSet(
                pose_index=poses,
                value=placement_value(problem, poses),
                objective=sign * float(row[first_column(reduced)]),
            )
        )
    pose_share = np.zeros(limits.n_poses)
    pose_share[reduced.pose_index] = listed.pose_count / listed.n_within
    return Pool(
        stage=_stage_name(problem),
        tolerance=tolerance,
        scope=scope,
        sets=tuple(sets),
        n_within=listed.n_within,
        pose_share=pose_share,
        site_share=listed.site_count / listed.n_within,
    )


def _stage_name(problem: PlacementProblem) -> str:
    if problem.goal != "best":
        return "units" if problem.goal == "fewest" else "cost_eur"
    if problem.survive:
        return "apr_survived"
    return "apr" if problem.stage_weights is None else "weighted"


def sites_in_order(pool: Pool) -> IntArray:
    """Sites of the problem's limits that carry a unit in some set, the most frequent one first."""
    order = np.argsort(-pool.site_share, kind="stable")
    used: IntArray = order[pool.site_share[order] > 0.0]
    return used
