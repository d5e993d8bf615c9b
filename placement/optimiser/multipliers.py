"""Better multipliers: deflected subgradient steps, and prices for poses that were left aside."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from geometry.arrays import FloatArray, IntArray

from .bounds import (
    Bound,
    Coverage,
    ValueArray,
    prove,
)

_DEFLECTION = 0.7  # of the last direction that is kept
_CUT = 0.7
_SMALLEST_STEP = 1.0e-4
_MEMORY = 0.95  # of the shares: the last 20 steps or so
_LEAST = 1.0e-7  # relative; a bound that is better by less is no better
_COARSE_STEPS, _FINE_STEPS = 50, 200
_WAY_BACK = (0.6, 0.3)  # to the best multipliers so far, where new ones are no better

_limit = attrgetter("limit")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoolSizes:
    """How many poses column generation works with."""

    n_first: int = 1500  # to begin with
    n_more: int = 1000  # at most so many join in a round
    n_most: int = 3000  # no more are kept when others join
    n_rounds: int = 25  # at most


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tightened:
    """Multipliers after some steps."""

    bound: Bound  # the best
    # (n_poses,): how often each pose was picked of late: close to a relaxed solution.
    shares: FloatArray


def tighten(
    coverage: Coverage,
    multipliers: ValueArray,
    *,
    target: float,
    n_steps: int = 300,
    stop_below: float = -np.inf,
    first_length: float = 1.0,
    patience: int = 15,
    workers: int = 1,
) -> Tightened:
    """Lower the bound by subgradient steps that begin at `multipliers`, (n_rows,).

    The steps aim at `target`, such as the value of the best known set; the first one takes the
    share `first_length` of the way, which should be small where the multipliers are nearly right.
    They end below `stop_below`, and are cut after `patience` steps without a better bound.

    Steps of Polyak (1969) towards the target, along subgradients of which a share is carried over
    (Camerini, Fratta, Maffioli 1975); back to the best point with a shorter step when nothing gets
    better. Averages of the picked sets tend to a relaxed solution (Barahona, Anbil 2000).
    """
    best = bound = prove(coverage, multipliers, workers=workers)
    shares = np.zeros(coverage.n_poses)
    direction = np.zeros(coverage.n_rows)
    length, n_idle = first_length, 0
    for step in range(n_steps):
        shares *= _MEMORY
        shares[bound.pick.poses] += (1.0 - _MEMORY) * bound.pick.shares
        if bound.limit < best.limit - _LEAST * abs(best.limit):
            best, n_idle = bound, 0
        elif step:
            n_idle += 1
        if best.limit < stop_below or length < _SMALLEST_STEP:
            break
        if n_idle > patience:
            bound, direction[:] = best, 0.0
            length, n_idle = length * _CUT, 0
        direction = _slope(coverage, bound) + _DEFLECTION * direction
        steepness = float(direction @ direction)
        if steepness < 1e-12:
            break
        move = length * max(bound.limit - target, 1e-6 * abs(target)) / steepness
        bound = prove(coverage, bound.multipliers - move * direction, workers=workers)
    if bound.limit < best.limit:
        best = bound
    total = shares.sum()
    if total > 0.0:
        shares = np.minimum(shares * (best.pick.shares.sum() / total), 1.0)
    return Tightened(bound=best, shares=shares)


def _slope(coverage: Coverage, bound: Bound) -> FloatArray:
    """A subgradient: by how much the limit changes with each multiplier, (n_rows,)."""
    picked = coverage.values[bound.pick.poses] > bound.multipliers
    slope: FloatArray = 1.0 - bound.pick.shares @ picked
    return slope


def first_multipliers(coverage: Coverage, chosen: IntArray) -> FloatArray:
    """Multipliers to begin with: a little below what a good set reaches."""
    start: FloatArray = 0.7 * coverage.level(chosen).astype(np.float64)
    return start


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """A bound over all poses, and the few poses that it rests on."""

    limit: float  # no feasible set is worth more: that of `bound`, or what all poses together reach
    bound: Bound  # for all poses
    pool: IntArray  # (n,): poses that were worked with at last, ascending
    shares: FloatArray  # (n,): their shares in a relaxed solution, roughly


def generate_columns(
    coverage: Coverage,
    incumbent: IntArray,
    *,
    multipliers: ValueArray | None = None,
    improve: Callable[[Coverage, Tightened], Tightened] | None = None,
    sizes: PoolSizes | None = None,
    tolerance: float = 2.0e-4,
    end_s: float = np.inf,
    workers: int = 1,
) -> Columns:
    """Bound all poses by working with few: price the others, add those that are too good.

    `incumbent` is a good set, and `multipliers`, (n_rows,), are those to begin with. `improve` is
    called with the pool and its multipliers once few poses are left to join. The rounds end when
    one brings less than the relative `tolerance` and no pose outside the pool is too good, or when
    `end_s` has passed on the monotonic clock.

    Multipliers that suit a poor pool too well are worth nothing outside it: few steps while many
    poses still join, more in the end. Where new multipliers are no better for all poses than the
    best so far, points between the two are tried (in-out separation, Ben-Ameur, Neto 2007).
    """
    sizes = PoolSizes() if sizes is None else sizes
    slack = tolerance * max(coverage.value(incumbent), 1e-300)
    start = first_multipliers(coverage, incumbent) if multipliers is None else multipliers
    ceiling = np.maximum(coverage.values.max(axis=0, initial=0.0), coverage.floor)
    best = origin = prove(coverage, np.minimum(start, ceiling), workers=workers)
    pool = np.union1d(incumbent, worthiest(best.worth, sizes.n_first))
    shares = np.zeros(len(pool))
    n_new = coverage.n_poses
    for number in range(sizes.n_rounds):
        is_coarse = n_new > sizes.n_more // 4 and len(pool) < coverage.n_poses
        part = coverage.of_poses(pool)
        tightened = tighten(
            part,
            origin.multipliers,
            target=coverage.value(incumbent),
            n_steps=_COARSE_STEPS if is_coarse else _FINE_STEPS,
            workers=workers,
        )
        if improve is not None and not is_coarse:
            tightened = improve(part, tightened)
        shares = tightened.shares
        goal = tightened.bound.multipliers
        before, tried = best, [prove(coverage, goal, workers=workers)]
        for share in _WAY_BACK:
            if number == 0 or min(tried, key=_limit).limit <= before.limit - slack:
                break
            between = share * goal + (1.0 - share) * before.multipliers
            tried.append(prove(coverage, between, workers=workers))
        best = min([before, *tried], key=_limit)
        is_complete = tried[0].limit <= tightened.bound.limit + slack
        is_complete |= number > 0 and n_new == 0
        is_settled = not is_coarse and is_complete and before.limit - best.limit < slack
        if is_settled or number == sizes.n_rounds - 1 or time.monotonic() > end_s:
            break
        origin = tried[0] if is_coarse else best
        inside = pool[tightened.bound.pick.poses]
        joining = np.union1d(
            _too_good(coverage, tried[0], inside, pool, sizes.n_more),
            _too_good(coverage, best, best.pick.poses, pool, sizes.n_more),
        )
        n_new = len(joining)
        kept = pool[worthiest(best.worth[pool], sizes.n_most)]
        pool = np.union1d(np.union1d(kept, joining), incumbent)
    limit = min(best.limit, float(ceiling.sum(dtype=np.float64)))
    return Columns(limit=limit, bound=best, pool=pool, shares=shares)


def _too_good(
    coverage: Coverage, bound: Bound, picked: IntArray, pool: IntArray, n_poses: int
) -> IntArray:
    """Poses outside a pool that are worth more than one that is picked: the worthiest of them.

    Where money is short, that is worth for money.
    """
    score = bound.worth
    if np.isfinite(coverage.supply.budget_eur):
        score = score / np.maximum(coverage.supply.prices_eur, 1e-9)
    least = score[picked].min(initial=np.inf)
    outside = score.copy()
    outside[pool] = -np.inf
    top = worthiest(outside, n_poses)
    joining: IntArray = top[outside[top] >= max(least, 1e-300)]
    return joining


def worthiest(worth: FloatArray, n_poses: int) -> IntArray:
    """Poses with the most worth, ascending."""
    if n_poses >= len(worth):
        return np.arange(len(worth))
    top: IntArray = np.sort(np.argpartition(-worth, n_poses)[:n_poses])
    return top
