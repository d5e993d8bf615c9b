"""Weighted best-of coverage: what is proven about many poses when each run counts its best one.

Rows r are demands (runs, their weight multiplied in), v[c, r] >= 0 is what pose c alone is worth
in row r, and a set S is worth

    f(S) = sum over r of max(reached[r], max of v[c, r] over c in S),

the p-median problem turned round (Cornuejols, Fisher, Nemhauser 1977); with v of 0 and 1 the MCLP.
f is monotone and submodular. Where runs are confirmed by several units together, v from the
first frame of each window (:func:`first_seen_values`) makes f a limit of the true value.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

from .limits import Limits
from .problem import WordArray, tails_behind, timely_windows_end
from .tolerances import COST_TOLERANCE_EUR, ROUNDING

# ---------- supply


_MAX_LINES = 60  # of the search for the price of money: it ends long before


class Pick(NamedTuple):
    """The most that a choice can be worth, and what it consists of."""

    limit: float  # no feasible set is worth more
    poses: IntArray  # (n,): poses that are chosen, in whole or in part
    shares: FloatArray  # (n,): how much of each, 0..1; all 1 without a budget of money


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Supply:
    """Units, room at the sites, and money."""

    max_units: int  # at most so many poses
    site_index: IntArray  # (n_poses,): site of every pose
    site_capacity: IntArray  # (n_sites,): units that each site can carry
    # (n_poses,): of each pose [EUR].
    unit_cost_eur: FloatArray = None  # type: ignore[assignment]  # filled in below
    # (n_sites,): once for each site that carries units [EUR].
    site_cost_eur: FloatArray = None  # type: ignore[assignment]
    # All units and sites together; by default as much as one wants [EUR].
    budget_eur: float = np.inf
    # Each (n,): one pose of each at least must be chosen. They are disjoint, and each stands at
    # one site.
    groups: tuple[IntArray, ...] = ()

    def __post_init__(self) -> None:
        for field, size in (
            ("unit_cost_eur", len(self.site_index)),
            ("site_cost_eur", len(self.site_capacity)),
        ):
            cost = getattr(self, field)
            cost = np.zeros(size) if cost is None else np.array(cost, dtype=np.float64)
            if cost.shape != (size,) or not (cost >= 0.0).all():
                raise ValueError(f"{field}: got {cost}; expected {size} costs, at least 0")
            object.__setattr__(self, field, freeze(cost))

    @property
    def money_eur(self) -> float:
        """The budget and what sums of prices may err by."""
        return self.budget_eur + COST_TOLERANCE_EUR

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.site_index)

    @property
    def prices_eur(self) -> FloatArray:
        """Of each pose, with its share of a site that is full, (n_poses,): no set costs less."""
        room = np.maximum(self.site_capacity, 1)
        prices: FloatArray = self.unit_cost_eur + (self.site_cost_eur / room)[self.site_index]
        return prices

    def of_poses(self, poses: IntArray) -> "Supply":
        """The same for some of the poses; groups lose those that are not among them."""
        place = np.full(self.n_poses, -1)
        place[poses] = np.arange(len(poses))
        groups = [place[group] for group in self.groups]
        return replace(
            self,
            site_index=self.site_index[poses],
            unit_cost_eur=self.unit_cost_eur[poses],
            groups=tuple(group[group >= 0] for group in groups),
        )

    def with_units(self, max_units: int) -> "Supply":
        """The same for another number of units."""
        return replace(self, max_units=max_units)

    def with_groups(self, groups: tuple[IntArray, ...]) -> "Supply":
        """The same with other groups."""
        return replace(self, groups=groups)

    def cost_eur(self, poses: IntArray) -> float:
        """What a set costs."""
        sites = np.unique(self.site_index[poses])
        return float(self.unit_cost_eur[poses].sum() + self.site_cost_eur[sites].sum())

    def allows(self, poses: IntArray) -> bool:
        """Whether a set is feasible."""
        at_site = np.bincount(self.site_index[poses], minlength=len(self.site_capacity))
        return (
            len(np.unique(poses)) == len(poses) <= self.max_units
            and bool((at_site <= self.site_capacity).all())
            and self.cost_eur(poses) <= self.money_eur
            and all(np.isin(group, poses).any() for group in self.groups)
        )

    def allows_each(self, sets: IntArray) -> BoolArray:
        """Which sets of distinct poses are feasible: (n_sets, n_units) -> (n_sets,)."""
        sites = self.site_index[sets]
        same = sites[:, :, None] == sites[:, None, :]
        can = (same.sum(axis=2) <= self.site_capacity[sites]).all(axis=1)
        is_first = ~np.tril(same, k=-1).any(axis=2)
        cost = self.unit_cost_eur[sets].sum(axis=1)
        cost += np.where(is_first, self.site_cost_eur[sites], 0.0).sum(axis=1)
        can_each: BoolArray = can & (cost <= self.money_eur) & (sets.shape[1] <= self.max_units)
        return can_each

    def extra_cost_eur(self, poses: IntArray) -> FloatArray:
        """What each pose would cost on top of a set, (n_poses,)."""
        due = self.site_cost_eur.copy()
        due[self.site_index[poses]] = 0.0
        cost: FloatArray = self.unit_cost_eur + due[self.site_index]
        return cost

    def has_room(self, poses: IntArray) -> BoolArray:
        """Which poses can join a feasible set, (n_poses,)."""
        if len(poses) >= self.max_units:
            return np.zeros(self.n_poses, dtype=bool)
        at_site = np.bincount(self.site_index[poses], minlength=len(self.site_capacity))
        can: BoolArray = (at_site < self.site_capacity)[self.site_index]
        if np.isfinite(self.budget_eur):
            can &= self.extra_cost_eur(poses) <= self.money_eur - self.cost_eur(poses)
        can[poses] = False
        return can

    def pick(self, worth: FloatArray) -> Pick:
        """Most that a set can be worth if the worth of its poses, (n_poses,), adds up.

        Poses without positive worth are left out, unless a group needs them. Without money this is
        the best set itself (greedy choice is best in a matroid). With money it is the value of the
        relaxation in which poses may be had in parts and a site costs each of its units ``cost /
        capacity``. It is minus infinity if a group is empty or units are fewer than groups.

        Money has a price mu: whatever it is, ``mu budget + max sum of (worth - mu price)`` is a
        limit, convex in mu and made of straight lines. The lowest point is found by meeting the
        line that falls there and the one that rises, which ends at the point itself.
        """
        if len(self.groups) > self.max_units or not all(map(len, self.groups)):
            return Pick(-np.inf, np.empty(0, dtype=np.int64), np.empty(0))
        free = self._pick_units(worth)
        if not np.isfinite(self.budget_eur):
            return Pick(float(worth[free].sum()), free, np.ones(len(free)))
        prices = self.prices_eur

        def line(mu: float) -> tuple[IntArray, float, float]:
            """Best set at a price of money, its worth, the money it leaves."""
            poses = self._pick_units(worth - mu * prices) if mu > 0.0 else free
            return poses, float(worth[poses].sum()), self.money_eur - float(prices[poses].sum())

        falling = line(0.0)
        if falling[2] >= 0.0:
            return Pick(falling[1], falling[0], np.ones(len(falling[0])))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where((prices > 0.0) & (worth > 0.0), worth / prices, 0.0)
        highest = float(ratio.max(initial=0.0))
        rising = line(highest * (1.0 + ROUNDING))
        if rising[2] < 0.0:  # rounding: nothing that costs is worth it
            return Pick(falling[1], falling[0], np.ones(len(falling[0])))
        limit = np.inf
        for _ in range(_MAX_LINES):
            mu = (rising[1] - falling[1]) / (falling[2] - rising[2])
            meeting = falling[1] + mu * falling[2]
            newest = line(mu)
            limit = min(limit, newest[1] + mu * newest[2])
            if limit <= meeting + 1e-12 * abs(meeting):
                break
            if newest[2] < 0.0:
                falling = newest
            else:
                rising = newest
        part = rising[2] / (rising[2] - falling[2])
        poses, where = np.unique(np.concatenate([falling[0], rising[0]]), return_inverse=True)
        weights = np.repeat([part, 1.0 - part], [len(falling[0]), len(rising[0])])
        shares: FloatArray = np.bincount(where, weights=weights, minlength=len(poses)).astype(float)
        return Pick(limit, poses, shares)

    def _pick_units(self, worth: FloatArray) -> IntArray:
        """Best set by units, sites and groups alone: of each group the best, then the worthiest.

        Where groups take part it may need more than the sites can carry: worth more than it can.
        """
        first = [int(group[worth[group].argmax()]) for group in self.groups]
        room = self.site_capacity.copy()
        room[self.site_index[first]] -= 1
        n_look, n_poses = 4 * self.max_units + 16, len(worth)
        while True:
            if n_look < n_poses:
                look = np.argpartition(-worth, n_look)[:n_look]
            else:
                look = np.arange(n_poses)
            look = look[np.argsort(-worth[look], kind="stable")]
            left, chosen = room.copy(), first.copy()
            for pose, site in zip(look.tolist(), self.site_index[look].tolist(), strict=True):
                if len(chosen) >= self.max_units or not worth[pose] > 0.0:
                    return np.array(chosen, dtype=np.int64)
                if left[site] > 0 and pose not in first:
                    left[site] -= 1
                    chosen.append(pose)
            if n_look >= n_poses or len(chosen) >= self.max_units:
                return np.array(chosen, dtype=np.int64)
            n_look *= 8


def build_supply(limits: Limits) -> Supply:
    """Supply by the limits of units, sites and money; wishes and rivals are left out."""
    return Supply(
        max_units=limits.max_units,
        site_index=limits.site_index,
        site_capacity=limits.site_capacity,
        unit_cost_eur=limits.unit_cost_eur,
        site_cost_eur=limits.site_cost_eur,
        budget_eur=np.inf if limits.budget_eur is None else limits.budget_eur,
    )


# ---------- coverage


ValueArray = NDArray[np.float32] | NDArray[np.float64]

_BLOCK_VALUES = 1 << 18  # differences of so many values at a time stay in the cache
_WORTH_THREADS = 1 << 21  # values: with fewer, threads take longer to start than to work


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """Poses to choose from, and what each is worth in every row."""

    values: ValueArray  # (n_poses, n_rows): v[c, r], at least 0; never copied
    supply: Supply  # which sets are feasible
    # (n_rows,): what units that stand already are worth; by default 0.
    reached: FloatArray | None = None

    def __post_init__(self) -> None:
        reached = np.zeros(self.n_rows) if self.reached is None else self.reached
        if self.supply.n_poses != self.n_poses:
            raise ValueError(f"supply: {self.supply.n_poses} poses; expected {self.n_poses}")
        object.__setattr__(self, "reached", reached.astype(self.values.dtype))

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.values)

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.values.shape[1])

    @property
    def floor(self) -> ValueArray:
        """`reached`, of the same kind as the values, (n_rows,)."""
        assert self.reached is not None
        return self.reached

    def of_poses(self, poses: IntArray) -> "Coverage":
        """The same for some of the poses: copies their values."""
        return Coverage(
            values=self.values[poses], supply=self.supply.of_poses(poses), reached=self.reached
        )

    def with_units(self, max_units: int) -> "Coverage":
        """The same for another number of units, on the same values."""
        return Coverage(
            values=self.values, supply=self.supply.with_units(max_units), reached=self.reached
        )

    def level(self, poses: IntArray) -> ValueArray:
        """What a set reaches in every row, (n_rows,)."""
        level: ValueArray = self.values[poses].max(axis=0, initial=0.0)
        return np.maximum(level, self.floor)

    def value(self, poses: IntArray) -> float:
        """What a set is worth, f(S)."""
        return float(self.level(poses).sum(dtype=np.float64))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bound:
    """A limit that multipliers prove."""

    limit: float  # no feasible set is worth more
    multipliers: ValueArray  # (n_rows,): lambda, as it was used: at least what is reached already
    worth: FloatArray  # (n_poses,): rho: what each pose has beyond lambda, summed over the rows
    pick: Pick  # the poses whose worth makes the limit


def gains(
    values: ValueArray, level: ValueArray, poses: IntArray | None = None, *, workers: int = 1
) -> FloatArray:
    """What poses have beyond a level: sum over r of max(0, v[c, r] - level[r]), (n,).

    By default of all poses. The sum is taken in float64 and is exact but for the rounding of
    differences. It never grows with the level, not even by rounding.
    """
    n_poses = len(values) if poses is None else len(poses)
    result = np.empty(n_poses)
    step = max(1, _BLOCK_VALUES // max(1, values.shape[1]))

    def work(start: int) -> None:
        part = slice(start, start + step)
        over = (values[part] if poses is None else values[poses[part]]) - level
        np.maximum(over, 0.0, out=over)
        over.sum(axis=1, dtype=np.float64, out=result[part])

    starts = range(0, n_poses, step)
    if workers == 1 or n_poses * values.shape[1] < _WORTH_THREADS:
        for start in starts:
            work(start)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, starts))
    return result


def prove(coverage: Coverage, multipliers: ValueArray, *, workers: int = 1) -> Bound:
    """Limit of the value of all feasible sets, from any multipliers lambda, (n_rows,).

    ``sum of lambda + max over feasible S of the sum of rho in S`` holds whatever lambda is: for
    every row ``max over S of v[c, r] <= lambda[r] + sum over S of max(0, v[c, r] - lambda[r])``,
    and the second part separates by poses. The Lagrangian dual of the p-median problem (Cornuejols,
    Fisher, Nemhauser 1977); its lowest value is that of the LP relaxation. Rounding errs towards a
    higher limit.
    """
    level = np.maximum(multipliers.astype(coverage.values.dtype), coverage.floor)
    worth = gains(coverage.values, level, workers=workers)
    worth *= 1.0 + 2.0 * np.finfo(coverage.values.dtype).eps  # more than differences err by
    pick = coverage.supply.pick(worth)
    return Bound(
        limit=float(level.sum(dtype=np.float64)) + pick.limit,
        multipliers=level,
        worth=worth,
        pick=pick,
    )


def can_matter(coverage: Coverage, bound: Bound, need: float) -> BoolArray:
    """Poses that a set worth more than `need` may contain, (n_poses,): reduced-cost fixing.

    A set with pose c is worth at most ``sum of lambda + rho[c]`` and the best K - 1 others, in
    which the room that c takes and the money that it costs are neglected.
    """
    supply = coverage.supply
    fixed = float(bound.multipliers.sum(dtype=np.float64))
    fewer = supply.with_units(supply.max_units - 1)
    limit = np.full(coverage.n_poses, fewer.pick(bound.worth).limit)
    for number, group in enumerate(supply.groups):
        others = supply.groups[:number] + supply.groups[number + 1 :]
        limit[group] = fewer.with_groups(others).pick(bound.worth).limit
    mask: BoolArray = fixed + limit + bound.worth > need
    return mask


_BLOCK_WORDS = 1 << 18  # 2 MB: what is worked on stays in the cache
_SHARE_DIGITS = 3  # shares that differ by less are equal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimelyWindows:
    """Windows of consecutive frames that end in time, for runs where there are any."""

    run_index: IntArray  # (n_rows,): runs of the axis with weight and at least one such window
    first_frame: IntArray  # (n_rows,): frame of the axis at which the run's first window begins
    n_windows: IntArray  # (n_rows,): windows of each run; window k begins at first_frame + k
    # (n_rows, largest n_windows + 1): margin if window k is the first one seen; 0 from k =
    # n_windows on: none [s].
    margin_s: FloatArray
    n_confirmations: int  # frames of a window
    # (n_rows, largest n_windows): of how many frames behind a window one must be seen, lest the
    # track is lost; -1: of none, since it lives until the last moment.
    tail_frames: IntArray


def timely_windows(axis: FrameAxis, rule: AebRule) -> TimelyWindows:
    """Find the windows of a frame axis that end in time."""
    ends, run, margin = timely_windows_end(axis, rule)
    run_index, first, n_windows = np.unique(run, return_index=True, return_counts=True)
    margin_s = np.zeros((len(run_index), n_windows.max(initial=0) + 1))
    row = np.repeat(np.arange(len(run_index)), n_windows)
    window = np.arange(len(ends)) - first[row]
    margin_s[row, window] = margin
    tail_frames = np.full((len(run_index), margin_s.shape[1] - 1), -1)
    behind, last = tails_behind(axis, rule, ends, run)
    of_tails = np.searchsorted(ends, behind)
    tail_frames[row[of_tails], window[of_tails]] = last - behind
    return TimelyWindows(
        run_index=run_index,
        first_frame=ends[first] - (rule.n_confirmations - 1),
        n_windows=n_windows,
        margin_s=margin_s,
        n_confirmations=rule.n_confirmations,
        tail_frames=tail_frames,
    )


def first_seen_index(
    packed: NDArray[np.uint8], windows: TimelyWindows, *, frames: slice | IntArray, workers: int = 1
) -> NDArray[np.uint16]:
    """First window of each run of which each pose sees certain frames, (n_poses, n_rows).

    It is the window's number within the run, n_windows if there is none. `packed` has V[c, f], the
    lowest bit first. `frames` says which frames of a window must be seen: a slice stands for the
    same ones of every window, an array has one for each, see :func:`hardest_frames`. With all of
    them, ``slice(None)``, the track must live until the last moment, too: of the tails behind this
    window and all later ones a frame must be seen. Raises ValueError if no frame counts, or one
    that no window has.
    """
    index = np.empty((len(packed), len(windows.run_index)), dtype=np.uint16)

    def keep(rows: slice, found: IntArray) -> None:
        index[rows] = found.T

    _go_through(packed, windows, frames, keep, workers)
    return index


def first_seen_values(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    worth: FloatArray,
    *,
    frames: slice | IntArray,
    out: NDArray[np.float32] | None = None,
    workers: int = 1,
) -> NDArray[np.float32]:
    """What each pose alone is worth in each run, v[c, r] rounded up, (n_poses, n_rows).

    `worth`, (n_rows, largest n_windows + 1), is that of a run if window k is the first one seen; it
    must not grow with k, and the last entry is for runs that are not seen. With all frames the
    values are exact where one unit must confirm alone. With one frame of each window the largest
    value of the chosen poses is a limit of what they reach together: where a window is seen as a
    whole, one of them sees that frame of it. For the rest see :func:`first_seen_index`.
    """
    if worth.shape != windows.margin_s.shape:
        raise ValueError(f"worth: got {worth.shape}; expected {windows.margin_s.shape}")
    values = np.empty((len(packed), len(worth)), dtype=np.float32) if out is None else out
    table = worth.astype(np.float32)
    is_less = table < worth  # rounded up instead: a limit stays one
    table[is_less] = np.nextafter(table[is_less], np.float32(np.inf))
    start = (np.arange(len(worth)) * worth.shape[1])[:, None]

    def keep(rows: slice, found: IntArray) -> None:
        values[rows] = table.ravel()[start + found].T

    _go_through(packed, windows, frames, keep, workers)
    return values


def hardest_frames(seen_share: FloatArray, windows: TimelyWindows) -> IntArray:
    """Of each window the frame that is seen least, for :func:`first_seen_values`.

    `seen_share`, (n_frames,), is how much of each frame a relaxed solution sees, 0..1. Values are
    limits whichever frame is asked for; the one that is seen least promises least.
    """
    window = np.minimum(np.arange(windows.margin_s.shape[1] - 1), windows.n_windows[:, None] - 1)
    frame = windows.first_frame[:, None] + window
    shares = [seen_share[frame + offset] for offset in range(windows.n_confirmations)]
    frames: IntArray = np.argmin(np.round(np.stack(shares), _SHARE_DIGITS), axis=0)
    return frames


def _go_through(
    packed: NDArray[np.uint8],
    windows: TimelyWindows,
    frames: slice | IntArray,
    keep: Callable[[slice, IntArray], None],
    workers: int,
) -> None:
    """Call `keep` with the indices, (n_rows, n_poses), of a few poses at a time."""
    every = range(windows.n_confirmations)
    if isinstance(frames, slice):
        is_possible = len(every[frames]) > 0
    else:
        shape = (len(windows.run_index), windows.margin_s.shape[1] - 1)
        is_possible = frames.shape == shape and bool(np.isin(frames, every).all())
    if not is_possible:
        raise ValueError(f"frames: got {frames}; expected some of {windows.n_confirmations}")
    n_poses = max(64, _BLOCK_WORDS // max(1, len(windows.run_index)))

    def work(start: int) -> None:
        rows = slice(start, start + n_poses)
        keep(rows, _first_seen(_by_word(packed[rows]), windows, frames))

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(0, len(packed), n_poses)))


def _by_word(packed: NDArray[np.uint8]) -> WordArray:
    """Words of 64 frames, an empty one at the end: (n_words + 1, n_poses) uint64."""
    n_words = -(-packed.shape[1] // 8)
    padded = np.zeros((len(packed), 8 * (n_words + 1)), dtype=np.uint8)
    padded[:, : packed.shape[1]] = packed
    return np.ascontiguousarray(padded.view("<u8").T)


def _first_seen(words: WordArray, windows: TimelyWindows, frames: slice | IntArray) -> IntArray:
    """Index of the first window of each run, (n_rows, n_poses)."""
    index = np.repeat(windows.n_windows[:, None], words.shape[1], axis=1)
    n_rounds = -(-int(windows.n_windows.max(initial=0)) // 64)
    asks_for_tails = frames == slice(None) if isinstance(frames, slice) else False
    asks_for_tails &= bool((windows.tail_frames >= 0).any())
    is_held = np.full(index.shape if asks_for_tails else (0, 0), ~np.uint64(0))
    for first_window in range(64 * (n_rounds - 1), -1, -64):
        longer = np.flatnonzero(windows.n_windows > first_window)
        begin = windows.first_frame[longer] + first_window
        if isinstance(frames, slice):
            offsets = range(windows.n_confirmations)[frames]
            seen = _words_from(words, begin + offsets[0])
            for offset in offsets[1:]:
                seen &= _words_from(words, begin + offset)
        else:
            asked = frames[longer, first_window : first_window + 64]
            seen = np.zeros((len(longer), words.shape[1]), dtype=np.uint64)
            for offset in range(windows.n_confirmations):
                of_window = _by_word(np.packbits(asked == offset, axis=1, bitorder="little"))[0]
                seen |= _words_from(words, begin + offset) & of_window[:, None]
        if asks_for_tails:
            part = windows.tail_frames[longer, first_window : first_window + 64]
            lost = _lost_windows(words, begin + windows.n_confirmations, part)
            seen &= ~lost & is_held[longer]
            is_held[longer] &= np.where(lost != 0, np.uint64(0), ~np.uint64(0))
        n_left = np.minimum(windows.n_windows[longer] - first_window, 64).astype(np.uint64)
        seen &= (~np.uint64(0) >> (np.uint64(64) - n_left))[:, None]
        lowest = np.bitwise_count(~seen & (seen - np.uint64(1)))  # 64 if no bit is set
        index[longer] = np.where(lowest < 64, first_window + lowest.astype(np.int64), index[longer])
    return index


def _lost_windows(words: WordArray, behind: IntArray, tail_frames: IntArray) -> WordArray:
    """Which of some 64 windows of each run are no later than one whose tail is not seen.

    `behind` is the frame behind the first of them, (n,), `tail_frames`, (n, up to 64), is as in
    :class:`TimelyWindows`: (n, n_poses) uint64.
    """
    seen = np.zeros((len(behind), words.shape[1]), dtype=np.uint64)
    last = 64 * (len(words) - 1) - 1  # nothing behind it counts
    for offset in range(int(tail_frames.max(initial=0))):
        counts = _by_word(np.packbits(tail_frames > offset, axis=1, bitorder="little"))[0]
        seen |= _words_from(words, np.minimum(behind + offset, last)) & counts[:, None]
    lost: WordArray
    lost = _by_word(np.packbits(tail_frames >= 0, axis=1, bitorder="little"))[0][:, None] & ~seen
    for shift in (1, 2, 4, 8, 16, 32):  # the highest bit that is set, and all below
        lost |= lost >> np.uint64(shift)
    return lost


def _words_from(words: WordArray, first_frame: IntArray) -> WordArray:
    """The 64 frames from some frame on, a row for each: (n, n_poses) uint64."""
    word, bit = np.divmod(first_frame, 64)
    bit = bit.astype(np.uint64)[:, None]
    # numpy shifts everything out where the shift is 64.
    result: WordArray = (words[word] >> bit) | (words[word + 1] << (np.uint64(64) - bit))
    return result
