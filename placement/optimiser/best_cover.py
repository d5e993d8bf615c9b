"""From a value matrix of any size to a set with a proven gap: the steps in order."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import IntArray

from .bounds import (
    Coverage,
    ValueArray,
    can_matter,
    gains,
)
from .branch_and_bound import branch_and_bound
from .greedy import lazy_greedy, round_shares, search_around
from .multipliers import Columns, generate_columns, worthiest
from .relaxation import polish

_LOCAL_POSES = 2000  # that exchanges choose from
_N_RESTARTS = 60
_MAX_BRANCH_VALUES = 1 << 26  # 256 MB in float32: more is not branched on
_ROUNDING = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cover:
    """A set of poses and how good it is proven to be.

    Attributes
    ----------
    poses : (n_units,) int
        Ascending.
    value : float
        f of it.
    limit : float
        No feasible set is worth more.
    multipliers : (n_rows,) float
        Which prove a limit by themselves, that of the root: see
        :func:`placement.optimiser.bounds.prove`.
    root_limit : float
        That limit; `limit` is lower if branching has proven more.
    n_poses_left : int
        Poses that reduced costs do not rule out of a better set.
    n_nodes : int
        Of branch and bound.
    seconds : float
        Spent. [s]
    """

    poses: IntArray
    value: float
    limit: float
    multipliers: ValueArray
    root_limit: float
    n_poses_left: int
    n_nodes: int
    seconds: float

    @property
    def gap(self) -> float:
        """How much better a set could be, as a share of the value."""
        if self.limit <= self.value:
            return 0.0
        return (self.limit - self.value) / self.value if self.value > 0.0 else np.inf


def find_best_cover(
    coverage: Coverage,
    *,
    gap: float = 0.0,
    time_limit_s: float = 300.0,
    like: Cover | None = None,
    seed: int = 0,
    workers: int = 1,
    on_step: Callable[[str], None] | None = None,
) -> Cover:
    """Find a set that is proven to be within a gap of the best.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    gap : float
        Good enough, as a share of the value.
    time_limit_s : float
        The step under way is finished, then what is proven is returned. [s]
    like : Cover, optional
        For a similar question on the same values, such as one unit less: where to begin.
    seed : int
        Of restarts.
    workers : int
        Threads.
    on_step : callable, optional
        Called with the name of every step when it begins.

    Returns
    -------
    cover : Cover
        The gap it reached may be larger than what was asked for.

    Notes
    -----
    Lazy greedy; multipliers with column generation, OSQP's relaxation at the end of it; rounding
    and exchanges among the worthiest poses; reduced costs; branch and bound on the poses left.
    """
    began_s = time.monotonic()
    with threadpool_limits(1):  # products are too small for BLAS's threads
        cover = _find(
            coverage, gap, began_s + time_limit_s, like, seed, workers, on_step or _ignore
        )
    return replace(cover, seconds=time.monotonic() - began_s)


def _find(
    coverage: Coverage,
    gap: float,
    end_s: float,
    like: Cover | None,
    seed: int,
    workers: int,
    report: Callable[[str], None],
) -> Cover:
    report("greedy")
    best = choose_greedily(coverage, workers=workers)
    if like is not None and coverage.supply.allows(like.poses):
        gained = gains(coverage.values, coverage.level(like.poses), workers=workers)
        extended = lazy_greedy(coverage, like.poses, worth=gained)
        best = max((best, extended), key=coverage.value)
    report("bound")
    columns = generate_columns(
        coverage,
        best,
        multipliers=None if like is None else like.multipliers,
        improve=polish,
        tolerance=min(2.0e-4, max(0.1 * gap, 1.0e-6)),
        end_s=end_s,
        workers=workers,
    )
    bound = columns.bound
    n_nodes, limit, left = 0, columns.limit, np.empty(0, dtype=np.int64)

    def is_enough() -> bool:
        return limit <= coverage.value(best) * (1.0 + max(gap, _ROUNDING))

    if not is_enough() and time.monotonic() < end_s:
        report("exchange")
        best = search_near(coverage, columns, best, seed=seed)
    if not is_enough():
        enough = coverage.value(best) * (1.0 + gap)
        left = np.flatnonzero(can_matter(coverage, bound, enough))
        if time.monotonic() < end_s and len(left) * coverage.n_rows <= _MAX_BRANCH_VALUES:
            report("branch")
            left = np.union1d(left, best)
            search = branch_and_bound(
                coverage.of_poses(left),
                np.searchsorted(left, best),
                bound.multipliers,
                gap=gap,
                time_limit_s=end_s - time.monotonic(),
                workers=workers,
            )
            best, n_nodes = left[search.poses], search.n_nodes
            limit = min(limit, max(search.limit, enough))
    value = coverage.value(best)
    return Cover(
        poses=np.sort(best),
        value=value,
        limit=max(limit, value),
        multipliers=bound.multipliers,
        root_limit=columns.limit,
        n_poses_left=len(left),
        n_nodes=n_nodes,
        seconds=0.0,
    )


def sweep_covers(
    coverage: Coverage,
    units: Sequence[int],
    *,
    gap: float = 0.0,
    time_limit_s: float = 300.0,
    seed: int = 0,
    workers: int = 1,
) -> Iterator[Cover]:
    """Best covers for one number of units after the other, each begun where the last one ended.

    Parameters
    ----------
    coverage : Coverage
        Its own number of units does not matter.
    units : sequence of int
        Best in ascending order.
    gap, seed, workers
        As for :func:`find_best_cover`.
    time_limit_s : float
        For each. [s]

    Yields
    ------
    cover : Cover
        For each number of units.
    """
    last: Cover | None = None
    for max_units in units:
        last = find_best_cover(
            coverage.with_units(max_units),
            gap=gap,
            time_limit_s=time_limit_s,
            like=last,
            seed=seed,
            workers=workers,
        )
        yield last


def choose_greedily(coverage: Coverage, *, workers: int = 1) -> IntArray:
    """Greedy by gain; where money is short, the better of that and of greedy by gain per euro."""
    worth = gains(coverage.values, coverage.floor, workers=workers)
    chosen = lazy_greedy(coverage, worth=worth)
    if np.isfinite(coverage.supply.budget_eur):
        per_euro = lazy_greedy(coverage, worth=worth, per_euro=True)
        chosen = max((chosen, per_euro), key=coverage.value)
    return chosen


def search_near(
    coverage: Coverage,
    columns: Columns,
    best: IntArray,
    *,
    n_restarts: int = _N_RESTARTS,
    seed: int = 0,
) -> IntArray:
    """Round the relaxed solution, exchange, and leave local bests again and again."""
    pool = np.union1d(best, worthiest(columns.bound.worth, _LOCAL_POSES))
    pool = np.union1d(pool, columns.pool[columns.shares > 0.0])
    shares = np.zeros(len(pool))
    known = np.isin(columns.pool, pool)
    shares[np.searchsorted(pool, columns.pool[known])] = columns.shares[known]
    part = coverage.of_poses(pool)
    every = np.arange(len(pool))
    rounded = round_shares(part, every, shares)
    start = max((np.searchsorted(pool, best), rounded), key=part.value)
    found = search_around(part, start, every, n_restarts=n_restarts, seed=seed)
    return pool[found]


def _ignore(step: str) -> None:
    """Take no notice."""
