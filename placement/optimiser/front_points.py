"""One point of a front: a good layout, then its proof, from the layout of the point before."""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..layout import Certificate
from .affordable import best_affordable
from .bitsets import exceeds, set_values
from .effort import Effort
from .feasibility import check_limits
from .front import FIRST_STAGES, FrontPoint, StageChoice
from .greedy import improve, to_full
from .limits import COST_TOLERANCE_EUR
from .presolve import ReducedProblem
from .problem import TOLERANCE, PlacementProblem, placement_value
from .search import Search
from .solve import _objective, _stage
from .stages import Stages

_SETS_PER_SECOND = 50_000  # measured: several times as many


def look_around(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    *,
    effort: Effort,
    stages: StageChoice,
    start: Sequence[int] = (),
) -> Search:
    """A good layout for one point, found quickly and without proof.

    Parameters
    ----------
    problem : PlacementProblem
        With the limits of this point.
    reduced : ReducedProblem
        Presolved with these limits or wider ones of units and money; with the limits, floors and
        goal of this point.
    effort : Effort
        For this point.
    stages : {"first", "all"}
        See :class:`Front`.
    start : sequence of int
        Rows of the detection table within the limits: what was found for less; none by default.

    Returns
    -------
    search : Search
        At least as good as the start. It may lack something to the floors.

    Raises
    ------
    InputError
        The limits contradict each other.
    """
    check_limits(problem.limits, problem.table.pose_ids)
    search = Search(
        reduced if stages == "all" else without_margins(reduced),
        end_s=time.monotonic() + effort.time_limit_s,
        milp_solver=effort.milp_solver,
        uses_models=effort.solver in ("auto", "exact"),
    )
    if len(start):
        search.offer(_to_reduced(reduced, start))
    if search.units is None or exceeds(search.limit, search.row):
        search.start()
    return search


def prove_point(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    search: Search,
    *,
    effort: Effort,
    stages: StageChoice,
    fewer: FrontPoint | None = None,
    is_cheapest: bool = False,
) -> FrontPoint:
    """One point of a front: the best layout and its proof.

    Parameters
    ----------
    problem, reduced, effort, stages
        As for :func:`look_around`. With the first stages alone, the layout's margins and cost are
        what a local search leaves of them: good, not proven, and in no certificate.
    search : Search
        With a layout that meets all limits and floors.
    fewer : FrontPoint, optional
        The point of one unit less, all else being equal.
    is_cheapest : bool
        The money is known to be the least: no stage asks for less.

    Returns
    -------
    point : FrontPoint
        Proven as far as the time goes.
    """
    solver = Stages(problem, search, effort)
    if problem.limits.budget_eur is not None and exceeds(search.limit, search.row):
        solver.is_complete = _look_through(search) or None
    records = []
    for name, find_bound in solver.plan():
        if name == "cost_eur" and is_cheapest:
            break
        began_s = time.monotonic()
        least_eur = _least_cost_eur(search, fewer) if name == "cost_eur" else -np.inf
        if search.value.cost_eur <= least_eur + COST_TOLERANCE_EUR:
            bound = search.value.cost_eur
        else:
            bound = find_bound()
        records.append((name, bound, time.monotonic() - began_s))
        if stages == "first" and name == FIRST_STAGES[-1]:
            break
    units = search.units
    assert units is not None  # the caller has seen to it
    if stages == "first" and search.left_s() > 0.0:
        full = replace(reduced, limits=search.reduced.limits, goal="best")
        units = _polished(full, units, end_s=search.end_s)
    pose_index = to_full(reduced, units)
    value = placement_value(problem, pose_index)
    return FrontPoint(
        units=len(pose_index),
        pose_index=pose_index,
        value=value,
        certificate=Certificate(
            stages=tuple(
                _stage(name, _objective(problem, pose_index, value, name), bound, seconds)
                for name, bound, seconds in records
            ),
            solver=" and ".join(search.proofs) or "simple bounds, no solver",
        ),
    )


def without_margins(reduced: ReducedProblem) -> ReducedProblem:
    """The same problem where all margins are alike: a set that is best in APR cannot be improved.

    Prices go, too, unless money is limited or looked for.
    """
    limits = reduced.limits
    if limits.budget_eur is None and reduced.goal != "cheapest":
        limits = replace(
            limits,
            unit_cost_eur=np.zeros_like(limits.unit_cost_eur),
            site_cost_eur=np.zeros_like(limits.site_cost_eur),
        )
    margin_s = np.where(reduced.margin_s > -np.inf, 0.0, -np.inf)
    return replace(reduced, limits=limits, margin_s=margin_s)


def _to_reduced(reduced: ReducedProblem, pose_index: Sequence[int]) -> IntArray:
    """Poses of the reduced problem from rows of the detection table, all of which are left."""
    return np.searchsorted(reduced.pose_index, np.sort(np.array(pose_index, dtype=np.int64)))


def _look_through(search: Search) -> bool:
    """Go through all sets within the money, if they are few; whether that was done."""
    if not search.uses_models:
        return False
    max_sets = int(_SETS_PER_SECOND * max(search.left_s(), 0.0))
    # Where the best set lacks something to a floor, others with a lower APR may do.
    least_apr = search.value.apr if search.shortfall == 0.0 else 0.0
    units, is_complete = best_affordable(search.reduced, least_apr=least_apr, max_sets=max_sets)
    if units is not None:
        search.keep(units)
    if is_complete:
        search.proofs["exhaustive enumeration"] = None
    return is_complete


def _least_cost_eur(search: Search, fewer: FrontPoint | None) -> float:
    """No layout that is as good in all other stages costs less, given the best with fewer units.

    Those with fewer units are not as good, or cost what the best of them costs; all others have
    one unit more at least.
    """
    limits = search.reduced.limits
    if fewer is None or not fewer.is_proven or search.reduced.goal != "best":
        return -np.inf
    prices = np.sort(limits.unit_cost_eur[~limits.is_forbidden])
    more_eur = float(prices[: fewer.units + 1].sum())
    differs = np.abs(np.subtract(search.value[:-1], fewer.value[:-1])) > TOLERANCE
    return more_eur if differs.any() else min(more_eur, fewer.value.cost_eur)


def _polished(reduced: ReducedProblem, units: IntArray, *, end_s: float) -> IntArray:
    """A set after a local search for better margins and lower cost; no worse in any stage."""
    limit: FloatArray = Search(reduced, end_s=0.0).limit
    better = improve(reduced, units, limit, end_s=end_s)
    rows = [set_values(reduced, sets[None, :])[0] for sets in (better, units)]
    return better if exceeds(rows[0], rows[1]) else units
