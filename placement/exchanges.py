"""Many layouts that differ by one pose, on the detection table itself."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from scenarios.aeb import is_in_time
from scenarios.runs import confirmation_times_s

from .optimiser import PlacementProblem, run_margins_s
from .optimiser.bitsets import best_row
from .optimiser.problem import TOLERANCE

_BLOCK_POSES = 512  # tens of megabytes of frames


def best_joining(
    problem: PlacementProblem,
    kept: Sequence[int],
    each: IntArray,
    *,
    price_eur: FloatArray | None = None,
) -> int:
    """Which of some poses is the best to join those that are kept.

    Parameters
    ----------
    problem : PlacementProblem
        Table, rule and measure; limits and floors do not matter.
    kept : sequence of int
        Rows of the table; there may be none.
    each : (n_each,) int
        Rows of the table, of which one joins.
    price_eur : (n_each,) float, optional
        Of each; by default all cost the same. [EUR]

    Returns
    -------
    index : int
        Into `each`: best by APR, then APR when one unit fails, smallest and mean margin, price.
    """
    measure, weight = problem.measure(), problem.table.axis.weight
    margin = margins_joined_s(problem, kept, each)
    is_avoided = (margin > -np.inf) & (weight > 0.0)
    apr = measure.of(is_avoided)
    # Failures are costly to go through: only poses with the best APR need it.
    rows = np.flatnonzero(apr >= apr.max() - TOLERANCE)
    left = np.full(len(rows), float(measure.of(run_margins_s(problem, kept) > -np.inf)))
    for failed in kept:
        others = [pose for pose in kept if pose != failed]
        left_then = margins_joined_s(problem, others, each[rows]) > -np.inf
        left = np.minimum(left, measure.of(left_then))
    margin, is_avoided = margin[rows], is_avoided[rows]
    share = is_avoided @ weight
    values = np.zeros((len(rows), 5))
    values[:, 0] = apr[rows]
    values[:, 1] = left
    some = share > 0.0
    values[some, 2] = np.where(is_avoided, margin, np.inf).min(axis=1)[some]
    values[some, 3] = (np.where(is_avoided, margin, 0.0) @ weight)[some] / share[some]
    if price_eur is not None:
        values[:, 4] = -price_eur[rows]
    return int(rows[best_row(values)])


def margins_joined_s(problem: PlacementProblem, kept: Sequence[int], each: IntArray) -> FloatArray:
    """Margins of all runs for what is kept together with each pose, (n_each, n_runs).

    As :func:`placement.optimiser.run_margins_s` of each such set. [s]
    """
    axis, rule = problem.table.axis, problem.rule
    beside = problem.table.detected(list(kept))
    together: BoolArray = np.logical_or.reduce(beside, axis=0)
    confirmed = np.empty((len(each), axis.n_runs))
    for start in range(0, len(each), _BLOCK_POSES):
        block = slice(start, start + _BLOCK_POSES)
        detected = problem.table.detected(each[block])
        if problem.fusion == "any":
            detected |= together
        confirmed[block] = confirmation_times_s(
            detected, axis, n_confirmations=rule.n_confirmations
        )
    if problem.fusion == "single" and len(kept):
        alone = confirmation_times_s(beside, axis, n_confirmations=rule.n_confirmations)
        confirmed = np.minimum(confirmed, alone.min(axis=0))
    last_brake = axis.last_brake_time_s
    in_time = np.isfinite(confirmed) & is_in_time(confirmed, last_brake, latency_s=rule.latency_s)
    return np.where(in_time, last_brake - (confirmed + rule.latency_s), -np.inf)
