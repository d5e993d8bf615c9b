"""Layouts found quickly, without proof: greedy choice, then exchanges one for one."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.clock import now_s

from .bitsets import BestSet, SetValues, set_values, values_with_each
from .bounds import Coverage, ValueArray, gains
from .limits import are_allowed, fitting, is_allowed
from .presolve import ReducedProblem, presolve
from .problem import PlacementProblem
from .tolerances import COST_TOLERANCE_EUR, ROUNDING

# ---------- on the reduced problem


_N_RESTARTS = 4
_SEED = 1


def solve_greedy(
    problem: PlacementProblem, reduced: ReducedProblem | None = None
) -> tuple[int, ...]:
    """Add, one by one, the pose with the highest APR; ties go to the later objectives.

    Returns rows of the detection table, ascending, within the limits if those leave greedy choice a
    way. No guarantee of quality holds with fusion "any": three units may be needed to complete one
    window.
    """
    reduced = presolve(problem) if reduced is None else reduced
    return to_full(reduced, extend_greedily(reduced, forced_units(reduced)))


def to_full(reduced: ReducedProblem, units: IntArray) -> tuple[int, ...]:
    """Rows of the detection table of poses of the reduced problem, ascending."""
    return tuple(sorted(int(pose) for pose in reduced.pose_index[units]))


def forced_units(reduced: ReducedProblem) -> IntArray:
    """Poses that every set must have."""
    return np.flatnonzero(reduced.limits.is_forced)


def extend_greedily(reduced: ReducedProblem, units: IntArray) -> IntArray:
    """Add poses to `units` one by one, the best first, as long as there is room.

    With few or cheap units as the goal it stops when the floors are reached. Otherwise it may add
    needless units, which exchanges and removals take away again.
    """
    max_units = reduced.limits.max_units
    while len(units) < max_units:
        is_enough = reduced.objectives[0].is_minimised
        if is_enough and set_values(reduced, units[None, :]).lacking[0] == 0.0:
            break
        free = np.flatnonzero(fitting(reduced.limits, units))
        if len(free) == 0:
            break
        values = values_with_each(reduced, units)[free]
        units = np.append(units, free[values.best_row()])
    return units


def improve(
    reduced: ReducedProblem, units: IntArray, limit: SetValues, *, end_s: float = np.inf
) -> IntArray:
    """Exchange one unit for another, or leave one out, as long as that makes the set better.

    No set is better than `limit`: the search ends at a set that is as good, or at `end_s` of
    `geometry.clock`. The result is at least as good as `units`.
    """
    value = set_values(reduced, units[None, :])[0]
    while limit.exceeds(value) and now_s() < end_s:
        best = units, value
        positions = np.flatnonzero(~reduced.limits.is_forced[units])
        for change in (_exchanged, _without):  # to leave one out is only cheaper: tried last
            for position in positions:
                sets, values = change(reduced, np.delete(units, position), units[position])
                if len(sets):
                    row = values.best_row()
                    if values[row].exceeds(best[1]):
                        best = sets[row], values[row]
            if best[1].exceeds(value):
                break
        if not best[1].exceeds(value):
            break
        units, value = best
    return units


def solve_heuristically(
    reduced: ReducedProblem,
    limit: SetValues,
    *,
    starts: Sequence[IntArray] = (),
    end_s: float = np.inf,
) -> IntArray | None:
    """Best of several local optima: of `starts`, of the greedy set, and of random first units.

    It ends when a set is as good as `limit`, which none exceeds, or at `end_s` of
    `geometry.clock`, but completes the first start. The result is within the limits and lacks as
    little to the floors as was found; None if no set within the limits was found.
    """
    rng = np.random.default_rng(_SEED)
    forced = forced_units(reduced)
    begin = [*starts, forced]
    first = np.flatnonzero(fitting(reduced.limits, forced))
    if len(first) and reduced.limits.max_units > 1:  # greedy choice of one looks at all
        begin += [np.append(forced, pose) for pose in rng.choice(first, size=_N_RESTARTS)]
    best = BestSet()
    for start in begin:
        if best.units is not None and now_s() >= end_s:
            break
        units = extend_greedily(reduced, start)
        if not is_allowed(reduced.limits, units):
            continue
        units = improve(reduced, units, limit, end_s=end_s)
        best.offer(units[None, :], set_values(reduced, units[None, :]))
        if best.values is not None and not limit.exceeds(best.values):
            break
    return best.units


def _without(reduced: ReducedProblem, left: IntArray, removed: int) -> tuple[IntArray, SetValues]:
    """The set itself, if it is allowed, and its value."""
    sets = left[None, :]
    if not are_allowed(reduced.limits, sets)[0]:
        sets = sets[:0]
    return sets, set_values(reduced, sets)


def _exchanged(reduced: ReducedProblem, left: IntArray, removed: int) -> tuple[IntArray, SetValues]:
    """Allowed sets with another pose in place of the one removed, and their values."""
    free = np.flatnonzero(fitting(reduced.limits, left))
    free = free[free != removed]
    sets = np.column_stack([np.tile(left, (len(free), 1)), free])
    free, sets = free[are_allowed(reduced.limits, sets)], sets[are_allowed(reduced.limits, sets)]
    return sets, values_with_each(reduced, left)[free] if len(free) else set_values(reduced, sets)


# ---------- on a best-of coverage


_LAZY_BLOCK = 64
_SWAP_BLOCK = 1 << 18  # values at a time
_SLACK = 1.0e-5  # of exchanges that are summed in float32: looked at closely


def lazy_greedy(
    coverage: Coverage,
    start: IntArray | None = None,
    *,
    per_euro: bool = False,
    worth: FloatArray | None = None,
    workers: int = 1,
) -> IntArray:
    """Add the pose that gains most, again and again, as long as there is room and a gain.

    It begins with the feasible set `start` and keeps the order of choice; among equal gains the
    lowest index comes first. With `per_euro` it takes what gains most for its money, with the site
    where that is not paid yet. `worth`, (n_poses,), are gains beyond `start`, or more, where they
    are at hand.

    A gain never grows when the set grows, so that an old one is a limit of the new one, and most
    need not be computed again (Minoux 1978). The choice is that of plain greedy. With at most K
    units it is worth at least 1 - 1/e = 63 % of the best set (Nemhauser, Wolsey, Fisher 1978), with
    room for fewer units at some sites (a matroid) at least 1/2 (Fisher, Nemhauser, Wolsey 1978),
    both beyond what is reached already. With money there is no such guarantee for one run; the
    better one of by gain and by gain per euro has (1 - 1/e) / 2 if neither sites cost anything nor
    units are limited (Leskovec et al. 2007).
    """
    chosen = [] if start is None else [int(pose) for pose in start]
    values, level = coverage.values, coverage.level(np.array(chosen, dtype=np.int64))
    limit = gains(values, level, workers=workers) if worth is None else worth.copy()
    is_fresh = np.full(len(limit), worth is None)
    while True:
        room = coverage.supply.has_room(np.array(chosen, dtype=np.int64))
        price = coverage.supply.extra_cost_eur(np.array(chosen, dtype=np.int64))
        price = np.maximum(price, COST_TOLERANCE_EUR) if per_euro else np.ones(len(limit))
        candidates = np.flatnonzero(room & (limit > 0.0))
        candidates = candidates[np.argsort(-limit[candidates] / price[candidates], kind="stable")]
        best, best_ratio = -1, 0.0
        for first in range(0, len(candidates), _LAZY_BLOCK):
            block = candidates[first : first + _LAZY_BLOCK]
            if limit[block[0]] / price[block[0]] < best_ratio:
                break
            stale = block[~is_fresh[block]]
            limit[stale] = gains(values, level, stale)
            is_fresh[stale] = True
            ratio = limit[block] / price[block]
            top = int(block[ratio == ratio.max()].min())
            if (limit[top] / price[top], -top) > (best_ratio, -best) and limit[top] > 0.0:
                best, best_ratio = top, float(limit[top] / price[top])
        if best < 0:
            return np.array(chosen, dtype=np.int64)
        chosen.append(best)
        level = np.maximum(level, values[best])
        is_fresh[:] = False


def swap(coverage: Coverage, chosen: IntArray, pool: IntArray | None = None) -> IntArray:
    """Exchange one pose of a feasible set for another one while that helps.

    Poses come in from `pool`, by default from all. In the end no such exchange makes the set better
    by more than rounding noise.
    """
    pool = np.arange(coverage.n_poses) if pool is None else pool
    poses, value = chosen.copy(), coverage.value(chosen)
    while len(poses):
        change = swap_gains(coverage, poses, pool)
        for unit in range(len(poses)):
            rest = np.delete(poses, unit)
            change[~coverage.supply.has_room(rest)[pool], unit] = -np.inf
            change[pool == poses[unit], unit] = -np.inf
        for place in _largest(change):
            newcomer, unit = np.unravel_index(place, change.shape)
            if change[newcomer, unit] < -_SLACK * value:
                return poses
            trial = poses.copy()
            trial[unit] = pool[newcomer]
            better = coverage.value(trial)
            if better > value * (1.0 + ROUNDING):
                poses, value = trial, better
                break
        else:
            break
    return poses


def swap_gains(coverage: Coverage, chosen: IntArray, pool: IntArray) -> FloatArray:
    """What every exchange of one pose for another brings, (n_pool, n_units).

    Entry i, j is the gain of pool pose i in the place of chosen pose j, in the arithmetic of the
    values, whether the exchange is feasible or not. A row that loses its best pose falls back to
    its second best: one matrix product sorts these losses by the pose that is lost (as in the fast
    interchange of Whitaker 1983).
    """
    values, floor = coverage.values, coverage.floor
    mine = values[chosen]
    owner = mine.argmax(axis=0)
    best = np.maximum(mine.max(axis=0), floor)
    others = mine.copy()
    others[owner, np.arange(coverage.n_rows)] = 0.0
    second = np.maximum(others.max(axis=0), floor)
    owned = np.zeros((coverage.n_rows, len(chosen)), dtype=values.dtype)
    owned[np.arange(coverage.n_rows), owner] = 1.0
    result = np.empty((len(pool), len(chosen)))
    step = max(1, _SWAP_BLOCK // max(1, coverage.n_rows))
    for first in range(0, len(pool), step):
        part = slice(first, first + step)
        newcomers: ValueArray = values[pool[part]]
        with_best = np.maximum(newcomers, best)
        with_second = np.maximum(newcomers, second)
        with_second -= with_best
        with_best -= best
        result[part] = with_second @ owned + with_best.sum(axis=1)[:, None]
    return result


def round_shares(
    coverage: Coverage, poses: IntArray, shares: FloatArray, pool: IntArray | None = None
) -> IntArray:
    """Make a feasible set of a relaxed solution that has `poses` in `shares`, 0..1.

    The largest shares come first as long as they fit; then the set is filled up greedily, and poses
    are exchanged for others of `pool`, by default of `poses`.
    """
    chosen = np.empty(0, dtype=np.int64)
    for pose in poses[np.argsort(-shares, kind="stable")]:
        if coverage.supply.has_room(chosen)[pose]:
            chosen = np.append(chosen, pose)
    filled = fill(coverage, chosen, poses)
    return swap(coverage, filled, poses if pool is None else pool)


def fill(coverage: Coverage, chosen: IntArray, pool: IntArray) -> IntArray:
    """Add poses of a pool greedily while there is room and a gain."""
    while True:
        can: BoolArray = coverage.supply.has_room(chosen)[pool]
        gain = np.where(can, gains(coverage.values, coverage.level(chosen), pool), 0.0)
        if not (gain > 0.0).any():
            return chosen
        chosen = np.append(chosen, pool[int(gain.argmax())])


def search_around(
    coverage: Coverage,
    chosen: IntArray,
    pool: IntArray,
    *,
    n_restarts: int,
    seed: int = 0,
    preference: FloatArray | None = None,
) -> IntArray:
    """Leave a local best: throw out some poses, fill up with others, exchange; keep the best.

    `preference`, (n_pool,), says how likely each pose of the pool is to come in, such as its share
    in a relaxed solution. The result is at least as good as `chosen`.
    """
    random = np.random.default_rng(seed)
    best, value = swap(coverage, chosen, pool), 0.0
    value = coverage.value(best)
    chance = np.ones(len(pool)) if preference is None else preference + 1e-12
    for _ in range(n_restarts):
        n_out = int(random.integers(1, max(2, len(best) // 2 + 1)))
        trial = random.permutation(best)[n_out:]
        for pose in random.choice(pool, size=n_out, p=chance / chance.sum()):
            if coverage.supply.has_room(trial)[pose]:
                trial = np.append(trial, pose)
        trial = swap(coverage, fill(coverage, trial, pool), pool)
        if coverage.value(trial) > value * (1.0 + ROUNDING):
            best, value = trial, coverage.value(trial)
    return best


def _largest(change: FloatArray) -> IntArray:
    """Places of the largest entries of a table, largest first."""
    n_look = min(change.size, 32)
    flat = change.ravel()
    top = np.argpartition(-flat, n_look - 1)[:n_look]
    places: IntArray = top[np.argsort(-flat[top], kind="stable")]
    return places
