"""What to change about units that hang already: remove one, re-aim one, add one, or all for money.

Removals, re-aims and additions are gone through one by one; a combination is a placement problem in
which the units stand already. All values are those of the detection table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError
from geometry.files import (
    load_toml,
    pick,
    take_number,
    take_text,
)

from .candidates import CandidateGrid, CandidatePose, is_turn_useless
from .explain.outcomes import best_joining
from .layout import Certificate, Layout
from .optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    PlacementValue,
    is_better,
    placement_value,
    run_margins_s,
    solve_placement,
)
from .optimiser.limits import are_allowed, costs_eur

# ---------- what can hang at a junction that has units already


_SAME_DEG = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RetrofitPoses:
    """Everything that can hang in the end.

    Attributes
    ----------
    candidates : tuple of CandidatePose
        The units as they hang, in the layout's order; then their re-aims; then what can be added.
    unit_index : (n_poses,) int
        Which unit each of them is; -1: a new one.
    """

    candidates: tuple[CandidatePose, ...]
    unit_index: IntArray

    @property
    def n_units(self) -> int:
        """Units that hang already."""
        return int(self.unit_index.max()) + 1

    def aims_of(self, unit: int) -> IntArray:
        """Rows of the re-aims of a unit."""
        rows: IntArray = np.flatnonzero(self.unit_index == unit)
        return rows[rows >= self.n_units]


def build_retrofit_poses(
    layout: Layout, grid: CandidateGrid, additions: Sequence[CandidatePose]
) -> RetrofitPoses:
    """The units, their re-aims (same place and sensor, directions of a grid), and new poses.

    Parameters
    ----------
    layout : Layout
        What hangs.
    grid : CandidateGrid
        Only its directions.
    additions : sequence of CandidatePose
        What can be added; poses with the id of a unit are left out.

    Raises
    ------
    InputError
        Two ids are equal.
    """
    aims = [
        (number, _aimed(unit, yaw_deg=yaw_deg, pitch_deg=pitch_deg))
        for number, unit in enumerate(layout.units)
        for yaw_deg, pitch_deg in grid.directions_deg(unit.sensor)
        if not _looks_there(unit, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    ]
    taken = {unit.id for unit in layout.units}
    new = [candidate for candidate in additions if candidate.id not in taken]
    candidates = (*layout.units, *(aim for _, aim in aims), *new)
    ids = [candidate.id for candidate in candidates]
    if len(set(ids)) < len(ids):
        repeated = next(name for name in ids if ids.count(name) > 1)
        raise InputError(f"layout {layout.name}: id", repeated, "ids unlike those of candidates")
    numbers = [*range(len(layout.units)), *(number for number, _ in aims), *([-1] * len(new))]
    return RetrofitPoses(candidates=candidates, unit_index=np.array(numbers, dtype=np.int64))


def _aimed(unit: CandidatePose, *, yaw_deg: float, pitch_deg: float) -> CandidatePose:
    pose = replace(unit.pose, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    return replace(unit, id=f"{unit.id}/aim/{yaw_deg:g}/{pitch_deg:g}", pose=pose)


def _looks_there(unit: CandidatePose, *, yaw_deg: float, pitch_deg: float) -> bool:
    turn_deg = (unit.pose.yaw_deg - yaw_deg + 180.0) % 360.0 - 180.0
    if is_turn_useless(unit.sensor, pitch_deg=pitch_deg):
        turn_deg = 0.0
    return max(abs(turn_deg), abs(unit.pose.pitch_deg - pitch_deg)) <= _SAME_DEG


# ---------- what it costs to re-aim or to remove a unit that hangs already


_FILE = "labour.toml"
_NUMBERS = ("people", "wage_eur_per_h", "travel_h", "lift_eur", "re_aim_h", "remove_h")


@dataclass(frozen=True, slots=True, kw_only=True)
class Labour:
    """People and a lift: prices without hardware.

    Attributes
    ----------
    people : float
        At work together.
    wage_eur_per_h : float
        Of each, on the way, too. [EUR/h]
    travel_h : float
        There and back. [h]
    lift_eur : float
        For the visit. [EUR]
    re_aim_h, remove_h : float
        At the pole. [h]
    source : str
        Where the numbers come from.
    """

    people: float
    wage_eur_per_h: float
    travel_h: float
    lift_eur: float
    re_aim_h: float
    remove_h: float
    source: str

    def __post_init__(self) -> None:
        for field in _NUMBERS:
            if not getattr(self, field) >= 0.0:
                raise InputError(f"labour.{field}", getattr(self, field), "at least 0")

    @property
    def re_aim_eur(self) -> float:
        """To turn a unit on its pole, in euros."""
        return self._visit_eur(self.re_aim_h)

    @property
    def remove_eur(self) -> float:
        """To take a unit down, in euros."""
        return self._visit_eur(self.remove_h)

    def _visit_eur(self, at_pole_h: float) -> float:
        return self.people * self.wage_eur_per_h * (self.travel_h + at_pole_h) + self.lift_eur


def load_labour(name: str = "default") -> Labour:
    """Labour prices by name, from ``data/labour.toml``.

    Examples
    --------
    >>> load_labour().re_aim_eur
    505.0
    """
    table = pick(load_toml(files(__package__) / "data" / _FILE), name, _FILE)
    where = f"{_FILE}: {name}"
    return Labour(
        **{key: take_number(table, key, where) for key in _NUMBERS},
        source=take_text(table, "source", where),
    )


# ---------- what to change about units that hang already


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Something that can be done, and what it brings.

    Attributes
    ----------
    removed, added : tuple of int
        Poses that are gone and that are new, as rows of the table; a unit that is re-aimed is in
        both.
    price_eur : float
        Labour, units and sites. [EUR]
    pose_index : tuple of int
        What hangs afterwards, ascending.
    value : PlacementValue
        Of what hangs afterwards.
    gained, lost : tuple of str
        Ids of runs that are avoided only afterwards, and only before.
    n_compared : int
        Alternatives of its kind that were gone through, itself among them; 0 for a combination.
    certificate : Certificate, optional
        Of a combination.
    """

    removed: tuple[int, ...]
    added: tuple[int, ...]
    price_eur: float
    pose_index: tuple[int, ...]
    value: PlacementValue
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    n_compared: int = 0
    certificate: Certificate | None = None

    @property
    def is_proven(self) -> bool:
        """Whether no other change of its kind brings more."""
        return self.n_compared > 0 or (self.certificate is not None and self.certificate.is_proven)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Retrofit:
    """What can be done about a layout.

    Attributes
    ----------
    before : PlacementValue
        Of what hangs now.
    removals : tuple of Change
        Of every unit, the one that loses least first.
    re_aims : tuple of Change
        The best of every unit, the best first; they may be worse than to leave all as it is.
    addition : Change or None
        The best new unit. None: nothing that can be added is better than nothing.
    combination : Change or None
        The best re-aims and additions together for the money, if there is a limit to it.
    """

    before: PlacementValue
    removals: tuple[Change, ...]
    re_aims: tuple[Change, ...]
    addition: Change | None
    combination: Change | None


def find_retrofit(
    problem: PlacementProblem,
    poses: RetrofitPoses,
    *,
    labour: Labour,
    budget_eur: float | None = None,
    effort: Effort | None = None,
) -> Retrofit:
    """Look for the best change of every kind.

    Parameters
    ----------
    problem : PlacementProblem
        On the table of all poses. Its limits are those of units to be added, with those that hang
        as forced ones that cost nothing, see :func:`placement.wishes.build_limits`; budgets and
        forced sites do not matter.
    poses : RetrofitPoses
        The rows of the table.
    labour : Labour
        Prices of removals and re-aims.
    budget_eur : float, optional
        For the combination; an addition must not cost more, either. [EUR]
    effort : Effort, optional
        For the combination; all others are gone through one by one.

    Returns
    -------
    retrofit : Retrofit
        Best by APR, then APR when one unit fails, smallest and mean margin, then price.
    """
    effort = Effort() if effort is None else effort
    standing = tuple(range(poses.n_units))
    removals = [
        _change(
            problem,
            poses,
            [unit for unit in standing if unit != number],
            price_eur=labour.remove_eur,
            n_compared=poses.n_units,
        )
        for number in standing
    ]
    re_aims = []
    n_aims = sum(len(poses.aims_of(number)) for number in standing)
    for number in standing:
        aims = poses.aims_of(number)
        if not len(aims):
            continue
        others = [unit for unit in standing if unit != number]
        best = aims[best_joining(problem, others, aims)]
        re_aims.append(
            _change(
                problem,
                poses,
                [*others, int(best)],
                price_eur=labour.re_aim_eur,
                n_compared=n_aims,
            )
        )
    return Retrofit(
        before=placement_value(problem, standing),
        removals=_best_first(removals),
        re_aims=_best_first(re_aims),
        addition=_add(problem, poses, budget_eur=budget_eur),
        combination=None
        if budget_eur is None
        else _combine(problem, poses, labour=labour, budget_eur=budget_eur, effort=effort),
    )


def combined_limits(
    limits: Limits, poses: RetrofitPoses, *, re_aim_eur: float, budget_eur: float
) -> Limits:
    """Limits in which every unit stays or is re-aimed, and others may be added.

    Parameters
    ----------
    limits : Limits
        See :func:`find_retrofit`.
    poses : RetrofitPoses
        Rows.
    re_aim_eur : float
        Price of every re-aim. [EUR]
    budget_eur : float
        For all together. [EUR]

    Returns
    -------
    limits : Limits
        Every unit is a site of its own with room for one of its poses, of which one must be
        chosen. What the units' real sites have left is there for new ones; their rivals are
        forbidden, since what hangs there stays.
    """
    n_units, n_sites = poses.n_units, limits.n_sites
    is_new = poses.unit_index < 0
    at_site = np.bincount(limits.site_index[:n_units], minlength=n_sites)
    one, other = limits.rivals[:, 0], limits.rivals[:, 1]
    is_blocked = np.zeros(n_sites, dtype=bool)
    is_blocked[other[at_site[one] > 0]] = True
    is_blocked[one[at_site[other] > 0]] = True
    price = np.where(is_new, limits.unit_cost_eur, re_aim_eur)
    price[:n_units] = 0.0
    is_open = is_new & ~limits.is_forbidden & ~is_blocked[limits.site_index]
    cheapest = float(price[is_open].min(initial=np.inf))
    n_affordable = budget_eur // cheapest if 0.0 < cheapest < np.inf else float(is_open.sum())
    n_new = int(min(n_affordable, is_open.sum()))
    return Limits(
        site_index=np.where(is_new, limits.site_index, n_sites + poses.unit_index),
        site_capacity=np.append(
            np.maximum(limits.site_capacity - at_site, 0), np.ones(n_units, dtype=np.int64)
        ),
        budget_units=n_units + n_new,
        budget_eur=budget_eur,
        unit_cost_eur=price,
        site_cost_eur=np.append(limits.site_cost_eur, np.zeros(n_units)),
        is_forbidden=is_new & ~is_open,
        is_forced_site=np.arange(n_sites + n_units) >= n_sites,
        rivals=limits.rivals[(at_site[one] == 0) & (at_site[other] == 0)],
    )


def _add(
    problem: PlacementProblem, poses: RetrofitPoses, *, budget_eur: float | None
) -> Change | None:
    """The best new unit beside all that hang; None if none may be added, or none is better."""
    standing = np.arange(poses.n_units)
    new = np.flatnonzero(poses.unit_index < 0)
    sets = np.column_stack([np.tile(standing, (len(new), 1)), new])
    limits = replace(
        problem.limits,
        budget_units=poses.n_units + 1,
        budget_eur=budget_eur,
        is_forced_site=np.zeros_like(problem.limits.is_forced_site),
    )
    is_possible = are_allowed(limits, sets)
    new, price_eur = new[is_possible], costs_eur(limits, sets[is_possible])
    if not len(new):
        return None
    best = best_joining(problem, standing.tolist(), new, price_eur=price_eur)
    change = _change(
        problem,
        poses,
        [*standing.tolist(), int(new[best])],
        price_eur=float(price_eur[best]),
        n_compared=len(new),
    )
    before = placement_value(problem, standing.tolist())
    return change if is_better(_without_cost(change.value), _without_cost(before)) else None


def _combine(
    problem: PlacementProblem,
    poses: RetrofitPoses,
    *,
    labour: Labour,
    budget_eur: float,
    effort: Effort,
) -> Change | None:
    """The best re-aims and additions for the money; None if that is to leave all as it is."""
    limits = combined_limits(
        problem.limits, poses, re_aim_eur=labour.re_aim_eur, budget_eur=budget_eur
    )
    problem = replace(problem, limits=limits)
    solution = solve_placement(problem, effort=effort, starts=[np.arange(poses.n_units)])
    change = _change(problem, poses, solution.pose_index)
    if not change.added:
        return None
    return replace(change, price_eur=change.value.cost_eur, certificate=solution.certificate)


def _change(
    problem: PlacementProblem,
    poses: RetrofitPoses,
    after: Sequence[int],
    *,
    price_eur: float = 0.0,
    n_compared: int = 0,
) -> Change:
    standing = range(poses.n_units)
    run_ids = np.array(problem.table.axis.run_ids)
    was = run_margins_s(problem, standing) > -np.inf
    now = run_margins_s(problem, after) > -np.inf
    return Change(
        removed=tuple(sorted(set(standing) - set(after))),
        added=tuple(sorted(set(after) - set(standing))),
        price_eur=price_eur,
        pose_index=tuple(sorted(after)),
        value=placement_value(problem, after),
        gained=tuple(run_ids[now & ~was].tolist()),
        lost=tuple(run_ids[was & ~now].tolist()),
        n_compared=n_compared,
    )


def _best_first(changes: Sequence[Change]) -> tuple[Change, ...]:
    """Changes by what hangs afterwards; equal ones keep their order."""
    ordered: list[Change] = []
    for change in changes:
        place = next(
            (
                index
                for index, other in enumerate(ordered)
                if is_better(_without_cost(change.value), _without_cost(other.value))
            ),
            len(ordered),
        )
        ordered.insert(place, change)
    return tuple(ordered)


def _without_cost(value: PlacementValue) -> PlacementValue:
    """A value whose cost does not count: prices of what hangs are spent."""
    return value._replace(cost_eur=0.0)
