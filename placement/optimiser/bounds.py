"""Weighted best-of coverage: what is proven about many poses when each run counts its best one.

Rows r are demands (runs, their weight multiplied in), v[c, r] >= 0 is what pose c alone is worth
in row r, and a set S is worth

    f(S) = sum over r of max(reached[r], max of v[c, r] over c in S),

the p-median problem turned round (Cornuejols, Fisher, Nemhauser 1977); with v of 0 and 1 the MCLP.
f is monotone and submodular. Where runs are confirmed by several units together, v from the
first frame of each window (first_seen.py) makes f a limit of the true value.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    freeze,
)

# ---------- supply


_MONEY_TOLERANCE_EUR = 1.0e-6
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
    # Each (n,): at least one pose of each must be chosen. They are disjoint, and each stands at one site.
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
        return self.budget_eur + _MONEY_TOLERANCE_EUR

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
        rising = line(highest * (1.0 + 1e-9))
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

    The limit is ``sum of lambda + max over feasible S of the sum of rho in S``. It holds whatever
    lambda is: an approximate dual solution becomes a proof. For every row
    ``max over S of v[c, r] <= lambda[r] + sum over S of max(0, v[c, r] - lambda[r])``;
    summed, the second part separates by poses. This is the Lagrangian dual of the p-median
    problem (Cornuejols, Fisher, Nemhauser 1977); its lowest value is that of the LP relaxation.
    Rounding errs towards a higher limit.
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

    `need` is such as what the best known set is worth; no feasible set with one of the other poses
    is worth more. A set with pose c is worth at most ``sum of lambda + rho[c]`` and the best K - 1
    others, in which the room that c takes and the money that it costs are neglected.
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
