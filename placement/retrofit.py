"""Retrofit of mounted units: remove one, re-aim one, add one, or the best changes for a budget.

Removals, re-aims and additions are tried one by one; a combination is a placement problem with
the units already in place. All values are those of the detection table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cmp_to_key
from importlib.resources import files

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.files import load_toml, read_table
from scenarios.runs import live_confirmation_times_s

from .candidates import CandidateGrid, CandidatePose, is_turn_useless
from .compute import check_distinct
from .detection_table import run_of_level
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
from .optimiser.bitsets import SetValues
from .optimiser.limits import are_allowed, costs_eur
from .optimiser.problem import VALUE_OBJECTIVES, Objective
from .optimiser.steering import TOLERANCE

# ---------- poses: the units, their re-aims, and what can be added


_SAME_DEG = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RetrofitPoses:
    """All poses that may be mounted in the end."""

    # the units as they are, in the layout's order; then their re-aims; then what can be added
    candidates: tuple[CandidatePose, ...]
    unit_index: IntArray  # (n_poses,): which unit each of them is; -1: a new one

    @property
    def n_units(self) -> int:
        """Number of units that are mounted already."""
        return int(self.unit_index.max()) + 1

    def aims_of(self, unit: int) -> IntArray:
        """Rows of the re-aims of a unit."""
        rows: IntArray = np.flatnonzero(self.unit_index == unit)
        return rows[rows >= self.n_units]


def build_retrofit_poses(
    layout: Layout, grid: CandidateGrid, additions: Sequence[CandidatePose]
) -> RetrofitPoses:
    """The units, their re-aims (same place and sensor, directions of a grid), and new poses.

    Additions with the id of a unit are left out. Raises InputError if two ids are equal.
    """
    aims, numbers = [], [*range(len(layout.units))]
    for number, unit in enumerate(layout.units):
        for yaw_deg, pitch_deg in grid.directions_deg(unit.sensor):
            turn_deg = (unit.pose.yaw_deg - yaw_deg + 180.0) % 360.0 - 180.0
            if is_turn_useless(unit.sensor, pitch_deg=pitch_deg):
                turn_deg = 0.0
            if max(abs(turn_deg), abs(unit.pose.pitch_deg - pitch_deg)) > _SAME_DEG:
                pose = replace(unit.pose, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
                name = f"{unit.id}/aim/{yaw_deg:g}/{pitch_deg:g}"
                aims.append(replace(unit, id=name, pose=pose))
                numbers.append(number)
    taken = {unit.id for unit in layout.units}
    new = [candidate for candidate in additions if candidate.id not in taken]
    candidates = (*layout.units, *aims, *new)
    ids = [candidate.id for candidate in candidates]
    check_distinct(f"layout {layout.name}: id", ids, "ids unlike those of candidates")
    unit_index = np.array([*numbers, *([-1] * len(new))], dtype=np.int64)
    return RetrofitPoses(candidates=candidates, unit_index=unit_index)


# ---------- labour: what it costs to re-aim or to remove a unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Labour:
    """Prices of work without hardware: people and a lift."""

    people: float  # at work together
    wage_eur_per_h: float  # of each, also on the way
    travel_h: float  # there and back
    lift_eur: float  # for the visit
    re_aim_h: float  # at the pole
    remove_h: float  # at the pole
    source: str  # where the numbers come from

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


def load_labour() -> Labour:
    """Labour prices, from ``data/labour.toml``.

    Examples
    --------
    >>> load_labour().re_aim_eur
    505.0
    """
    table = load_toml(files(__package__) / "data" / "labour.toml")["default"]
    return read_table(table, Labour, "labour.toml: default")


# ---------- changes


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change, and what it brings."""

    # removed, added: poses that go and that come, as rows of the table; a unit that is re-aimed is
    # in both
    removed: tuple[int, ...]
    added: tuple[int, ...]
    price_eur: float  # labour, units and sites. [EUR]
    pose_index: tuple[int, ...]  # what is mounted afterwards, ascending
    value: PlacementValue  # of what is mounted afterwards
    # gained, lost: ids of runs that are avoided only afterwards, and only before
    gained: tuple[str, ...]
    lost: tuple[str, ...]
    # number of alternatives of its kind that were tried, including itself; 0 for a combination
    n_compared: int = 0
    certificate: Certificate | None = None  # of a combination

    @property
    def is_proven(self) -> bool:
        """True if no other change of its kind brings more."""
        return self.n_compared > 0 or (self.certificate is not None and self.certificate.is_proven)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Retrofit:
    """The best changes of a layout, by kind."""

    before: PlacementValue  # of what is mounted now
    removals: tuple[Change, ...]  # of every unit, the one that loses least first
    # the best of every unit, the best first; they may be worse than no change
    re_aims: tuple[Change, ...]
    addition: Change | None  # the best new unit; None if no addition is an improvement
    # the best re-aims and additions together within the budget, if there is one
    combination: Change | None


def find_retrofit(
    problem: PlacementProblem,
    poses: RetrofitPoses,
    *,
    labour: Labour,
    budget_eur: float | None = None,
    effort: Effort | None = None,
) -> Retrofit:
    """Find the best change of every kind: by APR, APR when one unit fails, margins, then price.

    The problem is on the table of all poses, with those mounted as forced ones that cost nothing;
    its budgets and forced sites do not matter. `budget_eur` and `effort` are for the combination;
    an addition must not cost more, either. All other changes are tried one by one.
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
                problem, poses, [*others, int(best)], price_eur=labour.re_aim_eur, n_compared=n_aims
            )
        )
    return Retrofit(
        before=placement_value(problem, standing),
        removals=_best_first(removals),
        re_aims=_best_first(re_aims),
        addition=find_addition(problem, poses, budget_eur=budget_eur),
        combination=None
        if budget_eur is None
        else _combine(problem, poses, labour=labour, budget_eur=budget_eur, effort=effort),
    )


def combined_limits(
    limits: Limits, poses: RetrofitPoses, *, re_aim_eur: float, budget_eur: float
) -> Limits:
    """Limits in which every unit stays or is re-aimed, and others are added within the budget.

    Every unit becomes a site of its own, on which one of its poses must be chosen. What room the
    real sites have left is for new ones; rivals of units are forbidden.
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


def find_addition(
    problem: PlacementProblem, poses: RetrofitPoses, *, budget_eur: float | None
) -> Change | None:
    """The best new unit next to the existing ones; None if none is allowed or an improvement.

    All that are allowed are tried; a budget is for the new unit and its site alone.
    """
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
    """The best re-aims and additions within the budget; None if that is no change."""
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
        gained=tuple(dict.fromkeys(map(run_of_level, run_ids[now & ~was].tolist()))),
        lost=tuple(dict.fromkeys(map(run_of_level, run_ids[was & ~now].tolist()))),
        n_compared=n_compared,
    )


def _best_first(changes: Sequence[Change]) -> tuple[Change, ...]:
    """Changes by the value of what is mounted afterwards; equal ones keep their order."""

    def compare(one: Change, other: Change) -> int:
        values = _without_cost(one.value), _without_cost(other.value)
        return is_better(*values[::-1]) - is_better(*values)

    return tuple(sorted(changes, key=cmp_to_key(compare)))


def _without_cost(value: PlacementValue) -> PlacementValue:
    """A value whose cost does not count: existing units are paid for."""
    return value._replace(cost_eur=0.0)


# ---------- which pose is the best to join a set


_BLOCK_POSES = 512  # tens of megabytes of frames


def best_joining(
    problem: PlacementProblem,
    mounted: Sequence[int],
    each: IntArray,
    *,
    price_eur: FloatArray | None = None,
) -> int:
    """The pose of `each` (n_each,) that joins those `mounted` best: an index into `each`.

    Best by APR, then APR when one unit fails, smallest and mean margin, and price (by default
    equal). Limits and floors do not matter.
    """
    measure, weight = problem.measure(), problem.table.axis.weight
    margin = margins_joined_s(problem, mounted, each)
    is_avoided = (margin > -np.inf) & (weight > 0.0)
    apr = measure.of(is_avoided)
    # Failures are costly to go through: only poses with the best APR need it.
    rows = np.flatnonzero(apr >= apr.max() - TOLERANCE)
    left = np.full(len(rows), float(measure.of(run_margins_s(problem, mounted) > -np.inf)))
    for failed in mounted:
        others = [pose for pose in mounted if pose != failed]
        left_then = margins_joined_s(problem, others, each[rows]) > -np.inf
        left = np.minimum(left, measure.of(left_then))
    margin, is_avoided = margin[rows], is_avoided[rows]
    share = is_avoided @ weight
    some = share > 0.0
    smallest, mean = np.zeros(len(rows)), np.zeros(len(rows))
    smallest[some] = np.where(is_avoided, margin, np.inf).min(axis=1)[some]
    mean[some] = (np.where(is_avoided, margin, 0.0) @ weight)[some] / share[some]
    nothing = np.zeros(len(rows))
    gain = {
        Objective.APR: apr[rows],
        Objective.APR_ONE_FAILED: left,
        Objective.SMALLEST_MARGIN: smallest,
        Objective.MEAN_MARGIN: mean,
        Objective.COST: nothing if price_eur is None else -price_eur[rows],
    }
    gains = np.column_stack([nothing, *(gain[objective] for objective in VALUE_OBJECTIVES)])
    return int(rows[SetValues(VALUE_OBJECTIVES, gains).best_row()])


def margins_joined_s(
    problem: PlacementProblem, mounted: Sequence[int], each: IntArray
) -> FloatArray:
    """Margins of all runs for `mounted` together with each pose, (n_each, n_runs), in seconds.

    As :func:`placement.optimiser.run_margins_s` of each such set.
    """
    axis, rule = problem.table.axis, problem.rule
    alone_each = problem.detected(mounted)
    together: BoolArray = np.logical_or.reduce(alone_each, axis=0)
    confirmed = np.empty((len(each), axis.n_runs))
    for start in range(0, len(each), _BLOCK_POSES):
        block = slice(start, start + _BLOCK_POSES)
        detected = problem.table.detected(each[block])
        if problem.fusion == "any":
            detected |= together
        confirmed[block] = live_confirmation_times_s(detected, axis, rule=rule)
    if problem.fusion == "single" and len(alone_each):
        alone = live_confirmation_times_s(alone_each, axis, rule=rule)
        confirmed = np.minimum(confirmed, alone.min(axis=0))
    onset_s = confirmed + rule.latency_s
    return np.where(np.isfinite(onset_s), axis.last_brake_time_s - onset_s, -np.inf)
