"""What may be chosen together where each pose has a worth of its own: the easy half of bounds."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze

_MONEY_TOLERANCE_EUR = 1.0e-6
_MAX_LINES = 60  # of the search for the price of money: it ends long before


class Pick(NamedTuple):
    """The most that a choice can be worth, and what it consists of.

    Attributes
    ----------
    limit : float
        No feasible set is worth more.
    poses : (n,) int
        Poses that are chosen, in whole or in part.
    shares : (n,) float
        How much of each, 0..1; all 1 without a budget of money.
    """

    limit: float
    poses: IntArray
    shares: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Supply:
    """Units, room at the sites, and money.

    Attributes
    ----------
    max_units : int
        At most so many poses.
    site_index : (n_poses,) int
        Site of every pose.
    site_capacity : (n_sites,) int
        Units that each site can carry.
    unit_cost_eur : (n_poses,) float, optional
        Of each pose. [EUR]
    site_cost_eur : (n_sites,) float, optional
        Once for each site that carries units. [EUR]
    budget_eur : float
        All units and sites together; by default as much as one wants. [EUR]
    groups : tuple of (n,) int
        At least one pose of each must be chosen. They are disjoint, and each stands at one site.
    """

    max_units: int
    site_index: IntArray
    site_capacity: IntArray
    unit_cost_eur: FloatArray = None  # type: ignore[assignment]  # filled in below
    site_cost_eur: FloatArray = None  # type: ignore[assignment]
    budget_eur: float = np.inf
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
        """Most that a set can be worth if the worth of its poses adds up.

        Parameters
        ----------
        worth : (n_poses,) float
            Those that are not positive are left out, unless a group needs them.

        Returns
        -------
        pick : Pick
            Without money the best set itself (greedy choice is best in a matroid). With money the
            value of the relaxation in which poses may be had in parts and a site costs each of its
            units ``cost / capacity``. Minus infinity if a group is empty or units are fewer than
            groups.

        Notes
        -----
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
