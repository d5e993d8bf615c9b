"""Instances too large for models: few promising poses are solved, all poses are bounded.

The table is gone through once, to see what each pose alone promises in every run (window_cover.py).
On these promises, prices for poses (multipliers.py) bound every layout there is, and tell which
poses can matter. Among those the layout is sought on the real windows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import FloatArray, IntArray

from ..detection_table import DetectionTable
from .bounds import Coverage, Supply
from .greedy import lazy_greedy, swap
from .limits import Limits
from .multipliers import Columns, generate_columns
from .problem import PlacementProblem, run_margins_s
from .relaxation import polish
from .window_cover import TimelyWindows, first_seen_values, timely_windows

MAX_BITS = 1_000_000_000
"""Detections in a table that is still solved as a whole."""
_POOL = 400
_WORKERS = 2
_BLOCK_POSES = 1 << 14


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outlook:
    """What can be known of a large instance without solving it."""

    pool: IntArray  # (n,): promising poses, forced ones among them
    sets: tuple[IntArray, ...]  # sets that promise most, of the whole problem
    apr: float  # no layout within units, sites and money has a higher APR
    # Nor a larger sum of weights times margins; infinite where that was not asked [s].
    margins_s: float


def is_large(problem: PlacementProblem) -> bool:
    """Whether a problem is better not solved as a whole."""
    return problem.table.n_poses * problem.table.axis.n_frames > MAX_BITS


def look_out(
    problem: PlacementProblem,
    *,
    has_margins: bool = True,
    on_step: Callable[[str], None] | None = None,
) -> Outlook:
    """Bound all poses, and pick the promising ones.

    The problem's measure is a mean. Wishes are left out, which only makes bounds higher. To bound
    margins, too, takes another pass through the table.
    """
    windows = timely_windows(problem.table.axis, problem.rule)
    weight = problem.table.axis.weight[windows.run_index]
    last = np.arange(windows.margin_s.shape[1]) < windows.n_windows[:, None]
    worths: list[FloatArray] = [np.where(last, weight[:, None], 0.0)]
    if has_margins:
        worths.append(np.where(last, np.maximum(windows.margin_s, 0.0), 0.0) * weight[:, None])
    limits, sets = [], []
    pools = [np.flatnonzero(problem.limits.is_forced)]
    for number, worth in enumerate(worths):
        if on_step is not None:
            on_step("margins of all poses" if number else "all poses")
        chosen, columns = _promise(_coverage(problem, windows, worth))
        limits.append(columns.bound.limit)
        best_first = np.argsort(-columns.bound.worth[columns.pool], kind="stable")
        pools += [chosen, columns.pool[best_first[:_POOL]]]
        sets.append(chosen)
    pool = np.unique(np.concatenate(pools))
    return Outlook(
        pool=pool[~problem.limits.is_forbidden[pool]],
        sets=tuple(sets),
        apr=min(limits[0], 1.0),
        margins_s=limits[1] if has_margins else np.inf,
    )


def of_pool(problem: PlacementProblem, pool: IntArray) -> PlacementProblem:
    """The same problem on some of the poses."""
    table = problem.table
    return replace(
        problem,
        table=DetectionTable(
            pose_ids=tuple(table.pose_ids[pose] for pose in pool),
            axis=table.axis,
            packed=table.packed[pool],
        ),
        limits=problem.limits.of_poses(pool),
    )


def _coverage(problem: PlacementProblem, windows: TimelyWindows, worth: FloatArray) -> Coverage:
    limits = problem.limits
    frames = slice(0, 1) if problem.fusion == "any" else slice(None)
    values = first_seen_values(
        problem.table.packed, windows, worth, frames=frames, workers=_WORKERS
    )
    values[limits.is_forbidden] = 0.0
    return Coverage(
        values=values,
        supply=Supply(
            max_units=limits.max_units,
            site_index=limits.site_index,
            site_capacity=limits.site_capacity,
            unit_cost_eur=limits.unit_cost_eur,
            site_cost_eur=limits.site_cost_eur,
            budget_eur=np.inf if limits.budget_eur is None else limits.budget_eur,
        ),
    )


def _promise(coverage: Coverage) -> tuple[IntArray, Columns]:
    """A set that promises much, and the bound of all."""
    chosen = lazy_greedy(coverage, workers=_WORKERS)
    columns = generate_columns(coverage, chosen, improve=polish, workers=_WORKERS)
    better = swap(coverage, chosen, pool=columns.pool)
    if coverage.value(better) <= coverage.value(chosen) + 1.0e-9:
        return chosen, columns
    columns = generate_columns(
        coverage,
        better,
        multipliers=columns.bound.multipliers.astype(np.float64),
        improve=polish,
        workers=_WORKERS,
    )
    return better, columns


def margin_limits_s(problem: PlacementProblem) -> FloatArray:
    """Margins of all runs with every allowed pose mounted, (n_runs,); minus infinity: not avoided.

    With fusion "single", no less than what any one pose reaches.
    """
    table, limits = problem.table, problem.limits
    everything = np.zeros(table.packed.shape[1], dtype=np.uint8)
    for start in range(0, table.n_poses, _BLOCK_POSES):
        rows = slice(start, start + _BLOCK_POSES)
        allowed = table.packed[rows][~limits.is_forbidden[rows]]
        everything |= np.bitwise_or.reduce(allowed, axis=0)
    one = DetectionTable(pose_ids=("all",), axis=table.axis, packed=everything[None, :])
    alone = replace(
        problem,
        table=one,
        limits=Limits(site_index=np.array([0]), site_capacity=np.array([1])),
    )
    return run_margins_s(alone, [0])
