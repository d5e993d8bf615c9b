"""Good sets quickly: lazy greedy choice, exchanges one for one, rounding of relaxed solutions."""

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .coverage import Coverage, ValueArray, gains

_LAZY_BLOCK = 64
_SWAP_BLOCK = 1 << 18  # values at a time
_SLACK = 1.0e-5  # of exchanges that are summed in float32: looked at closely
_LEAST_GAIN = 1.0e-9  # relative; what is smaller is rounding


def lazy_greedy(
    coverage: Coverage,
    start: IntArray | None = None,
    *,
    per_euro: bool = False,
    worth: FloatArray | None = None,
    workers: int = 1,
) -> IntArray:
    """Add the pose that gains most, again and again, as long as there is room and a gain.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    start : (n,) int, optional
        Poses that are chosen already; a feasible set.
    per_euro : bool
        Take what gains most for its money, with the site where that is not paid yet.
    worth : (n_poses,) float, optional
        Gains beyond `start`, or more, where they are at hand.
    workers : int
        Threads.

    Returns
    -------
    poses : (n_units,) int
        In the order of choice, `start` first; among equal gains the lowest index.

    Notes
    -----
    A gain never grows when the set grows, so that an old one is a limit of the new one, and most
    need not be computed again (Minoux 1978). The choice is that of plain greedy. With at most K
    units it is worth at least 1 - 1/e = 63 % of the best set (Nemhauser, Wolsey, Fisher 1978),
    with room for fewer units at some sites (a matroid) at least 1/2 (Fisher, Nemhauser, Wolsey
    1978), both beyond what is reached already. With money there is no such guarantee for one run;
    the better one of by gain and by gain per euro has (1 - 1/e) / 2 if neither sites cost anything
    nor units are limited (Leskovec et al. 2007).
    """
    chosen = [] if start is None else [int(pose) for pose in start]
    values, level = coverage.values, coverage.level(np.array(chosen, dtype=np.int64))
    limit = gains(values, level, workers=workers) if worth is None else worth.copy()
    is_fresh = np.full(len(limit), worth is None)
    while True:
        room = coverage.supply.has_room(np.array(chosen, dtype=np.int64))
        price = coverage.supply.extra_cost_eur(np.array(chosen, dtype=np.int64))
        price = np.maximum(price, 1e-9) if per_euro else np.ones(len(limit))
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
    """Exchange one pose for another while that helps.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    chosen : (n_units,) int
        A feasible set.
    pool : (n,) int, optional
        Poses that may come in; by default all.

    Returns
    -------
    poses : (n_units,) int
        Feasible; no exchange within `pool` makes it better by more than rounding noise.
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
            if better > value * (1.0 + _LEAST_GAIN):
                poses, value = trial, better
                break
        else:
            break
    return poses


def swap_gains(coverage: Coverage, chosen: IntArray, pool: IntArray) -> FloatArray:
    """What every exchange of one pose for another brings.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    chosen : (n_units,) int
        At least one pose.
    pool : (n,) int
        Poses that may come in.

    Returns
    -------
    gain : (n, n_units) float
        Of pool pose i in the place of chosen pose j, in the arithmetic of the values; feasible or
        not.

    Notes
    -----
    A row that loses its best pose falls back to its second best: one matrix product sorts these
    losses by the pose that is lost (as in the fast interchange of Whitaker 1983).
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
    """Make a feasible set of a relaxed solution.

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    poses : (n,) int
        Those with a share.
    shares : (n,) float
        x, 0..1.
    pool : (m,) int, optional
        Poses that may come in by exchange; by default `poses`.

    Returns
    -------
    chosen : (n_units,) int
        Largest shares first as long as they fit, then filled up greedily, then exchanged.
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

    Parameters
    ----------
    coverage : Coverage
        What to choose from.
    chosen : (n_units,) int
        A feasible set.
    pool : (n,) int
        Poses that may come in.
    n_restarts : int
        How often.
    seed : int
        Of what is thrown out and comes in.
    preference : (n,) float, optional
        How likely each pose of the pool is to come in, such as its share in a relaxed solution.

    Returns
    -------
    best : (n_units,) int
        At least as good as `chosen`.
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
        if coverage.value(trial) > value * (1.0 + _LEAST_GAIN):
            best, value = trial, coverage.value(trial)
    return best


def _largest(change: FloatArray) -> IntArray:
    """Places of the largest entries of a table, largest first."""
    n_look = min(change.size, 32)
    flat = change.ravel()
    top = np.argpartition(-flat, n_look - 1)[:n_look]
    places: IntArray = top[np.argsort(-flat[top], kind="stable")]
    return places
