"""Limits on what may be mounted together: units, money, sites and wishes.

What poses detect does not matter here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, check_one_of, refuse

from .constants import COST_TOLERANCE_EUR, ROUNDING

CENTS = 100.0
# Of which float64 knows each.
_MAX_CENTS = 2.0**53

Failing = Literal["unit", "site"]
"""Fails at once: a unit, or a site (a pole) with everything that it carries."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Limits:
    """Sets of poses that may be mounted.

    Attributes
    ----------
    site_index : (n_poses,) int
        Site of every pose; a pose that belongs to no site has one of its own.
    site_capacity : (n_sites,) int
        Units that each site can carry.
    budget_units : int, optional
        At most so many units; by default as many as the sites can carry.
    budget_eur : float, optional
        At most so much money; by default any. [EUR]
    unit_cost_eur : (n_poses,) float
        Price of each unit; by default nothing. [EUR]
    site_cost_eur : (n_sites,) float
        Paid once if a site carries anything; by default nothing. [EUR]
    is_forced, is_forbidden : (n_poses,) bool
        Poses that must, or must not, be chosen; by default none.
    is_forced_site : (n_sites,) bool
        Sites that must carry at least one unit; by default none.
    rivals : (n_pairs, 2) int
        Pairs of sites that must not both carry units, such as those too near to each
        other; by default none.
    failing : {"unit", "site"}
        What fails at once, wherever failures are asked about: a unit, or a site with
        everything that it carries.
    """

    site_index: IntArray
    site_capacity: IntArray
    budget_units: int | None = None
    budget_eur: float | None = None
    # What is None below is filled in: no prices, and no such poses, sites or pairs.
    unit_cost_eur: FloatArray = None  # type: ignore[assignment]
    site_cost_eur: FloatArray = None  # type: ignore[assignment]
    is_forced: BoolArray = None  # type: ignore[assignment]
    is_forbidden: BoolArray = None  # type: ignore[assignment]
    is_forced_site: BoolArray = None  # type: ignore[assignment]
    rivals: IntArray = None  # type: ignore[assignment]
    failing: Failing = "unit"

    def __post_init__(self) -> None:
        for field in ("site_index", "site_capacity"):
            array = np.array(getattr(self, field))
            if array.ndim != 1 or (
                array.size and not np.issubdtype(array.dtype, np.integer)
            ):
                raise InputError(field, array.tolist(), "whole numbers in one row")
            object.__setattr__(self, field, freeze(array.astype(np.int64)))
        n_sites = self.n_sites
        if (
            self.n_poses
            and not 0 <= self.site_index.min() <= self.site_index.max() < n_sites
        ):
            raise InputError(
                "site_index", self.site_index.tolist(), f"sites 0..{n_sites - 1}"
            )
        if (self.site_capacity < 0).any():
            raise InputError(
                "site_capacity", self.site_capacity.tolist(), "units, at least 0"
            )
        for field, size in (
            ("unit_cost_eur", self.n_poses),
            ("site_cost_eur", n_sites),
        ):
            cost = self._filled(field, size, np.float64)
            if not (np.isfinite(cost) & (cost >= 0.0)).all():
                raise InputError(field, cost.tolist(), "euros, at least 0")
        self._filled("is_forced", self.n_poses, bool)
        self._filled("is_forbidden", self.n_poses, bool)
        self._filled("is_forced_site", n_sites, bool)
        rivals = np.zeros((0, 2))
        if self.rivals is not None:
            rivals = np.array(self.rivals)
        rivals = rivals.reshape(-1, 2).astype(np.int64)
        if len(rivals) and not (
            0 <= rivals.min() <= rivals.max() < n_sites
            and (rivals[:, 0] != rivals[:, 1]).all()
        ):
            raise InputError(
                "rivals", rivals.tolist(), f"pairs of two sites, 0..{n_sites - 1}"
            )
        object.__setattr__(self, "rivals", freeze(rivals))
        check_one_of("failing", self.failing, get_args(Failing))
        units = self.budget_units
        money = self.budget_eur
        if units is not None and (type(units) is not int or units < 1):
            raise InputError("budget", units, "a whole number of units, at least 1")
        if money is not None and not 0.0 <= money < np.inf:
            raise InputError("budget_cost", money, "euros, at least 0")

    def _filled(self, field: str, size: int, kind: Any) -> Any:
        """Set a field to a checked, frozen array of its values, by default zeros."""
        value = getattr(self, field)
        if value is None:
            array = np.zeros(size, dtype=kind)
        else:
            array = np.array(value, dtype=kind)
        if array.shape != (size,):
            refuse(field, f"shape {array.shape}", f"shape ({size},)")
        object.__setattr__(self, field, freeze(array))
        return array

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.site_index)

    @property
    def n_sites(self) -> int:
        """Number of sites."""
        return len(self.site_capacity)

    @property
    def budget_new_units(self) -> int | None:
        """Units that may be added to the forced ones; None: any number."""
        if self.budget_units is None:
            return None
        return self.budget_units - int(self.is_forced.sum())

    @property
    def max_units(self) -> int:
        """No set has more units: by budgets, prices and what the sites can carry."""
        usable = self.site_index[~self.is_forbidden]
        per_site = np.bincount(usable, minlength=self.n_sites)
        most = int(np.minimum(per_site, self.site_capacity).sum())
        if self.budget_units is not None:
            most = min(most, self.budget_units)
        if self.budget_eur is not None:
            prices = np.cumsum(np.sort(self.unit_cost_eur[~self.is_forbidden]))
            affordable = np.searchsorted(
                prices, self.budget_eur + COST_TOLERANCE_EUR, "right"
            )
            most = min(most, int(affordable))
        return most

    def of_poses(self, poses: IntArray) -> "Limits":
        """Limits on some of the poses; all forced ones must be among them."""
        return replace(
            self,
            site_index=self.site_index[poses],
            unit_cost_eur=self.unit_cost_eur[poses],
            is_forced=self.is_forced[poses],
            is_forbidden=self.is_forbidden[poses],
        )

    def __repr__(self) -> str:
        budgets = f"{self.budget_units} units, {self.budget_eur} EUR"
        return f"Limits({budgets}, {self.n_poses} poses at {self.n_sites} sites)"


def cost_eur(limits: Limits, pose_index: Sequence[int] | IntArray) -> float:
    """Cost of a set of poses: its units, and each of their sites once, in euros."""
    poses = np.asarray(pose_index, dtype=np.int64)
    sites = np.unique(limits.site_index[poses])
    return float(limits.unit_cost_eur[poses].sum() + limits.site_cost_eur[sites].sum())


def whole_cents(prices_eur: FloatArray) -> IntArray | None:
    """Prices in cents; None where some are not whole, or too high to be exact."""
    cents = np.rint(prices_eur * CENTS)
    is_off = np.abs(cents / CENTS - prices_eur) > ROUNDING
    if is_off.any() or cents.max(initial=0.0) > _MAX_CENTS:
        return None
    return cents.astype(np.int64)


def price_step_eur(limits: Limits) -> float:
    """Largest amount that divides the cost of every set; 0 where there is none."""
    cents = whole_cents(np.concatenate([limits.unit_cost_eur, limits.site_cost_eur]))
    if cents is None:
        return 0.0
    return float(np.gcd.reduce(cents, initial=0)) / CENTS


def costs_eur(limits: Limits, sets: IntArray) -> FloatArray:
    """Cost of many sets of poses: (n_sets, n_units) -> (n_sets,), in euros."""
    cost = limits.unit_cost_eur[sets].sum(axis=1)
    sites = np.sort(limits.site_index[sets], axis=1)
    # A site is paid with its first unit.
    is_first = np.ones(sites.shape, dtype=bool)
    is_first[:, 1:] = sites[:, 1:] != sites[:, :-1]
    of_sites = np.where(is_first, limits.site_cost_eur[sites], 0.0).sum(axis=1)
    return np.asarray(cost + of_sites)


def are_allowed(limits: Limits, sets: IntArray) -> BoolArray:
    """Which sets of distinct poses are within all limits.

    Parameters
    ----------
    limits : Limits
        What may be mounted together.
    sets : (n_sets, n_units) int
        Sets of at least one pose.

    Returns
    -------
    allowed : (n_sets,) bool
        True for those within all limits, with all that is forced.
    """
    most: float = np.inf
    if limits.budget_units is not None:
        most = limits.budget_units
    sites = limits.site_index[sets]
    allowed: BoolArray = may_grow(limits, sets) & (1 <= sets.shape[1] <= most)
    allowed &= ~limits.is_forbidden[sets].any(axis=1)
    for pose in np.flatnonzero(limits.is_forced):
        allowed &= (sets == pose).any(axis=1)
    for site in np.flatnonzero(limits.is_forced_site):
        allowed &= (sites == site).any(axis=1)
    for one, other in limits.rivals:
        allowed &= ~((sites == one).any(axis=1) & (sites == other).any(axis=1))
    return allowed


def may_grow(limits: Limits, sets: IntArray) -> BoolArray:
    """Which sets, (n_sets, n_units), fit into sites and money.

    All parts of an allowed set do: a set that does not fit need not be grown.
    """
    sites = limits.site_index[sets]
    n_there = (sites[:, :, None] == sites[:, None, :]).sum(axis=2)
    fits: BoolArray = (n_there <= limits.site_capacity[sites]).all(axis=1)
    if limits.budget_eur is not None:
        fits &= costs_eur(limits, sets) <= limits.budget_eur + COST_TOLERANCE_EUR
    return fits


def is_allowed(limits: Limits, pose_index: Sequence[int] | IntArray) -> bool:
    """True if poses are distinct and within all limits."""
    poses = np.asarray(pose_index, dtype=np.int64)
    is_distinct = len(np.unique(poses)) == len(poses)
    return is_distinct and bool(are_allowed(limits, poses[None, :])[0])


def fitting(limits: Limits, units: IntArray) -> BoolArray:
    """Which poses can join a set that is within the limits so far.

    What is forced may still be missing: room and money for it are kept back. With
    rival sites or few places that need not suffice to complete every set: check the
    end with :func:`is_allowed`.

    Parameters
    ----------
    limits : Limits
        What may be mounted together.
    units : (n,) int
        Poses of the set.

    Returns
    -------
    fits : (n_poses,) bool
        Poses that can join.
    """
    sites = limits.site_index
    at_site = np.bincount(sites[units], minlength=limits.n_sites)
    fits = (at_site < limits.site_capacity)[sites] & ~limits.is_forbidden
    fits[units] = False
    # Rivals of sites that carry units already.
    if len(limits.rivals):
        blocked = np.zeros(limits.n_sites, dtype=bool)
        for one, other in (limits.rivals.T, limits.rivals.T[::-1]):
            blocked[other[at_site[one] > 0]] = True
        fits &= ~blocked[sites]
    # Poses and sites that are forced, but not there yet.
    missing = limits.is_forced.copy()
    missing[units] = False
    missing_sites = limits.is_forced_site & (at_site == 0)
    missing_sites[sites[missing]] = False
    helps = missing | missing_sites[sites]
    n_missing = int(missing.sum() + missing_sites.sum())
    if limits.budget_units is not None:
        n_left = limits.budget_units - len(units)
        if n_left <= n_missing:
            fits &= helps
    if limits.budget_eur is not None:
        # Money that is left, and what has to be kept back for what is missing.
        left = limits.budget_eur + COST_TOLERANCE_EUR - cost_eur(limits, units)
        to_pay = np.where(at_site > 0, 0.0, limits.site_cost_eur)
        price = limits.unit_cost_eur + to_pay[sites]
        to_open = np.unique(sites[missing & (at_site[sites] == 0)])
        for_poses = limits.unit_cost_eur[missing].sum()
        reserve = float(for_poses + limits.site_cost_eur[to_open].sum())
        cheapest = np.full(limits.n_sites, np.inf)
        may = ~limits.is_forbidden
        np.minimum.at(cheapest, sites[may], limits.unit_cost_eur[may])
        at_missing = np.where(missing_sites, cheapest + limits.site_cost_eur, 0.0)
        reserve += float(at_missing.sum())
        # A site that must be used has no pose that may be.
        if reserve == np.inf:
            return np.zeros(limits.n_poses, dtype=bool)
        # What a pose itself provides of what is missing need not be kept back for it.
        own = np.where(missing_sites[sites], at_missing[sites], 0.0)
        own = np.where(missing, limits.unit_cost_eur, own)
        opens = missing & np.isin(sites, to_open)
        own = own + np.where(opens, limits.site_cost_eur[sites], 0.0)
        fits &= price + reserve - own <= left
    return fits


class Choice(NamedTuple):
    """How many poses may join those that are forced, and where, for kernels.

    Attributes
    ----------
    n_units : int
        At most so many.
    room : (n_sites,) int
        Places left at each site.
    is_open : (n_poses,) int
        1 if the pose may join.
    cost : (n_poses,) float
        Share of the money left that a pose takes, at least; empty if money is no
        limit.
    site : (n_poses,) int
        Site of each pose.
    """

    n_units: int
    room: IntArray
    is_open: IntArray
    cost: FloatArray
    site: IntArray


def build_choice(limits: Limits, n_units: int) -> Choice:
    """Poses that may join the forced ones in sets of so many units."""
    forced = np.flatnonzero(limits.is_forced)
    at_site = np.bincount(limits.site_index[forced], minlength=limits.n_sites)
    cost = np.empty(0)
    if limits.budget_eur is not None:
        of_units = limits.unit_cost_eur[forced].sum()
        spent = of_units + limits.site_cost_eur[at_site > 0].sum()
        left = max(limits.budget_eur - float(spent), 0.0) + COST_TOLERANCE_EUR
        # A site is paid once: full, each of its units pays a share.
        of_site = np.where(at_site > 0, 0.0, limits.site_cost_eur)
        of_site = of_site / np.maximum(limits.site_capacity, 1)
        cost = (limits.unit_cost_eur + of_site[limits.site_index]) / left
    return Choice(
        n_units=max(n_units - len(forced), 0),
        room=np.maximum(limits.site_capacity - at_site, 0),
        is_open=(~limits.is_forced & ~limits.is_forbidden).astype(np.int64),
        cost=cost,
        site=limits.site_index,
    )
