"""Retrofit of mounted units: remove, re-aim, add, or combine.

Removals, re-aims and additions are tried one by one; a combination is a placement
problem with the units already in place. All values are those of the detection table.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cmp_to_key

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError, refuse
from geometry.phrases import Phrase
from geometry.tables import read_table
from geometry.text_formats import load_data

from .candidates import CandidateGrid, CandidatePose, is_turn_useless
from .compute import check_distinct
from .detection_table import DetectionTable, plain_run
from .layout import Certificate, Layout
from .live import LiveTable
from .optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    PlacementValue,
    ReducedProblem,
    Solution,
    apr,
    cost_eur,
    is_better,
    placement_value,
    run_margins_s,
    solve_placement,
)
from .optimiser.allowed_sets import are_allowed, fitting
from .optimiser.bitsets import best_with_each
from .optimiser.presolve import presolve_freely
from .optimiser.solve import units_of
from .pipeline import Assembly
from .wishes import Wishes

# ---------- poses: the units, their re-aims, and what can be added
_SAME_DEG = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RetrofitPoses:
    """All poses that may be mounted in the end.

    Attributes
    ----------
    candidates : tuple of CandidatePose
        The units as they are, in the layout's order; then their re-aims; then
        what can be added.
    unit_index : (n_poses,) int
        Which unit each of them is; -1: a new one.
    """

    candidates: tuple[CandidatePose, ...]
    unit_index: IntArray

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
    """Poses of a retrofit: units, their re-aims, and new poses.

    A re-aim has the same place and sensor, and a direction of the grid. Additions
    with the id of a unit are left out. Raises InputError if two ids are equal.
    """
    aims = []
    numbers = [*range(len(layout.units))]
    # Every direction of the grid that differs from the unit's own.
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
    # New poses come last.
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
    """Prices of work without hardware: people and a lift.

    Attributes
    ----------
    people : float
        At work together.
    wage_eur_per_h : float
        Of each, also on the way.
    travel_h : float
        There and back.
    lift_eur : float
        For the visit.
    re_aim_h : float
        At the pole.
    remove_h : float
        At the pole.
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

    @property
    def re_aim_eur(self) -> float:
        """To turn a unit on its pole, in euros."""
        return self._visit_eur(self.re_aim_h)

    @property
    def remove_eur(self) -> float:
        """To take a unit down, in euros."""
        return self._visit_eur(self.remove_h)

    def _visit_eur(self, at_pole_h: float) -> float:
        return (
            self.people * self.wage_eur_per_h * (self.travel_h + at_pole_h)
            + self.lift_eur
        )


def load_labour() -> Labour:
    """Labour prices, from ``data/labour.toml``.

    >>> load_labour().re_aim_eur
    505.0
    """
    table = load_data(__package__, "labour.toml")["default"]
    return read_table(table, Labour, "labour.toml: default")


# ---------- changes
@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A change, and what it brings.

    Attributes
    ----------
    removed, added : tuple of int
        Poses that go and that come, as rows of the table; a unit that is
        re-aimed is in both.
    price_eur : float
        Labour, units and sites. [EUR]
    pose_index : tuple of int
        What is mounted afterwards, ascending.
    value : PlacementValue
        Of what is mounted afterwards.
    gained, lost : tuple of str
        Ids of runs that are avoided only afterwards, and only before.
    n_compared : int
        Number of alternatives of its kind that were tried, including itself; 0
        for a combination.
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
        """True if no other change of its kind brings more."""
        return self.n_compared > 0 or (
            self.certificate is not None and self.certificate.is_proven
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Retrofit:
    """The best changes of a layout, by kind.

    Attributes
    ----------
    before : PlacementValue
        Of what is mounted now.
    removals : tuple of Change
        Of every unit, the one that loses least first.
    re_aims : tuple of Change
        The best of every unit, the best first; they may be worse than no change.
    addition : Change or None
        The best new unit; None if no addition is an improvement.
    combination : Change or None
        The best re-aims and additions together within the budget, if there is one.
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
    """Find the best change of every kind.

    Changes are compared by APR, APR when one unit fails, margins, then price. The
    problem is on the table of all poses, with those mounted as forced ones that
    cost nothing; its budgets and forced sites do not matter. `budget_eur` and
    `effort` are for the combination; an addition must not cost more, either. All
    other changes are tried one by one.
    """
    if effort is None:
        effort = Effort()
    reduced = presolve_freely(problem)
    standing = tuple(range(poses.n_units))
    n_aims = sum(len(poses.aims_of(number)) for number in standing)
    removals = []
    re_aims = []
    # Remove each unit in turn, and re-aim it as well as possible.
    for number in standing:
        others = [unit for unit in standing if unit != number]
        price_eur = labour.remove_eur
        n = poses.n_units
        removals.append(
            _change(problem, poses, others, price_eur=price_eur, n_compared=n)
        )
        aims = poses.aims_of(number)
        if len(aims):
            after = [*others, best_joining(reduced, others, aims)]
            price_eur = labour.re_aim_eur
            re_aims.append(
                _change(problem, poses, after, price_eur=price_eur, n_compared=n_aims)
            )
    combination = None
    # Combine re-aims and additions within the budget.
    if budget_eur is not None:
        prices = {"re_aim_eur": labour.re_aim_eur, "budget_eur": budget_eur}
        within = replace(
            problem, limits=combined_limits(problem.limits, poses, **prices)
        )
        solution = solve_placement(within, effort=effort, starts=[np.array(standing)])
        change = _change(within, poses, solution.pose_index)
        price_eur = change.value.cost_eur
        certificate = solution.certificate
        if change.added:
            combination = replace(change, price_eur=price_eur, certificate=certificate)
    return Retrofit(
        before=placement_value(problem, standing),
        removals=_best_first(removals),
        re_aims=_best_first(re_aims),
        addition=find_addition(problem, reduced, poses, budget_eur=budget_eur),
        combination=combination,
    )


def combined_limits(
    limits: Limits, poses: RetrofitPoses, *, re_aim_eur: float, budget_eur: float
) -> Limits:
    """Limits in which units stay or are re-aimed, and others are added.

    Changes are paid from the budget. Every unit becomes a site of its own, on which
    one of its poses must be chosen. What room the real sites have left is for new
    ones; rivals of units are forbidden.
    """
    n_units = poses.n_units
    n_sites = limits.n_sites
    is_new = poses.unit_index < 0
    # Room that is left at the real sites, and sites that are rivals of units.
    at_site = np.bincount(limits.site_index[:n_units], minlength=n_sites)
    one = limits.rivals[:, 0]
    other = limits.rivals[:, 1]
    is_blocked = np.zeros(n_sites, dtype=bool)
    is_blocked[other[at_site[one] > 0]] = True
    is_blocked[one[at_site[other] > 0]] = True
    # Units that stay cost nothing, re-aims cost labour.
    price = np.where(is_new, limits.unit_cost_eur, re_aim_eur)
    price[:n_units] = 0.0
    is_open = is_new & ~limits.is_forbidden & ~is_blocked[limits.site_index]
    # No more new units than money can buy.
    cheapest = float(price[is_open].min(initial=np.inf))
    if 0.0 < cheapest < np.inf:
        n_affordable = budget_eur // cheapest
    else:
        n_affordable = float(is_open.sum())
    n_new = int(min(n_affordable, is_open.sum()))
    return Limits(
        site_index=np.where(is_new, limits.site_index, n_sites + poses.unit_index),
        site_capacity=np.append(
            np.maximum(limits.site_capacity - at_site, 0),
            np.ones(n_units, dtype=np.int64),
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
    problem: PlacementProblem,
    reduced: ReducedProblem,
    poses: RetrofitPoses,
    *,
    budget_eur: float | None,
) -> Change | None:
    """Best new unit next to the existing ones.

    None if no unit is allowed, or none is an improvement. All that are allowed are
    tried; a budget is for the new unit and its site alone.
    """
    standing = np.arange(poses.n_units)
    new = np.flatnonzero(poses.unit_index < 0)
    # One set for each new pose: all existing units and that pose.
    sets = np.column_stack([np.tile(standing, (len(new), 1)), new])
    limits = replace(
        problem.limits,
        budget_units=poses.n_units + 1,
        budget_eur=budget_eur,
        is_forced_site=np.zeros_like(problem.limits.is_forced_site),
    )
    new = new[are_allowed(limits, sets)]
    if not len(new):
        return None
    # The best of them counts only if it is an improvement.
    after = [*standing.tolist(), best_joining(reduced, standing.tolist(), new)]
    price_eur = cost_eur(limits, after)
    n = len(new)
    change = _change(problem, poses, after, price_eur=price_eur, n_compared=n)
    before = placement_value(problem, standing.tolist())
    if is_better(_without_cost(change.value), _without_cost(before)):
        return change
    return None


def _change(
    problem: PlacementProblem,
    poses: RetrofitPoses,
    after: Sequence[int],
    *,
    price_eur: float = 0.0,
    n_compared: int = 0,
) -> Change:
    """A change to the poses `after`, with its value and its runs."""
    standing = range(poses.n_units)
    run_ids = np.array(problem.table.axis.run_ids)
    # Runs that are avoided before and afterwards.
    was = run_margins_s(problem, standing) > -np.inf
    now = run_margins_s(problem, after) > -np.inf
    return Change(
        removed=tuple(sorted(set(standing) - set(after))),
        added=tuple(sorted(set(after) - set(standing))),
        price_eur=price_eur,
        pose_index=tuple(sorted(after)),
        value=placement_value(problem, after),
        gained=tuple(dict.fromkeys(map(plain_run, run_ids[now & ~was].tolist()))),
        lost=tuple(dict.fromkeys(map(plain_run, run_ids[was & ~now].tolist()))),
        n_compared=n_compared,
    )


def _best_first(changes: Sequence[Change]) -> tuple[Change, ...]:
    """Changes by the value of what is mounted afterwards, best first.

    Equal ones keep their order.
    """

    def compare(one: Change, other: Change) -> int:
        values = _without_cost(one.value), _without_cost(other.value)
        return is_better(*values[::-1]) - is_better(*values)

    return tuple(sorted(changes, key=cmp_to_key(compare)))


def _without_cost(value: PlacementValue) -> PlacementValue:
    """A value whose cost does not count: existing units are paid for."""
    return value._replace(cost_eur=0.0)


def best_joining(
    reduced: ReducedProblem, mounted: Sequence[int], each: IntArray
) -> int:
    """The pose of `each` that joins the mounted ones best.

    `each` and `mounted` are rows of the table; of equals the first is taken. Best
    by APR, then APR when one unit fails, smallest and mean margin, and price.
    Limits and floors do not matter; `reduced` is by
    :func:`placement.optimiser.presolve.presolve_freely`.
    """
    poses = units_of(reduced, each)
    # None detects anything that counts.
    if not len(poses):
        return int(each[0])
    best = best_with_each(
        reduced, units_of(reduced, np.array(mounted, dtype=np.int64)), poses
    )
    return int(reduced.pose_index[best[-1]])


# ---------- answers to somebody who plans by hand
# An APR that is higher by less is the same.
LEAST_GAIN = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Advice:
    """A layout that answers a question, and how good it is proven to be.

    Attributes
    ----------
    units : tuple of CandidatePose
        All that would be mounted then; those that stay keep their ids.
    before, after : PlacementValue
        Worth of the present and of the new layout on the detection table; `before` is
        None where nothing is mounted. Costs of both are of the same kind: of what is
        new, or of everything, as the question says.
    certificate : Certificate, optional
        Of a search; None where all alternatives were tried one by one.
    n_compared : int
        How many were tried so; 0 of a search.
    """

    units: tuple[CandidatePose, ...]
    before: PlacementValue | None
    after: PlacementValue
    certificate: Certificate | None = None
    n_compared: int = 0

    @property
    def is_proven(self) -> bool:
        """True if nothing of its kind is better in the first objective."""
        if self.certificate is None:
            return self.n_compared > 0
        return self.certificate.stages[0].gap == 0.0

    @property
    def is_all_proven(self) -> bool:
        """True if nothing of its kind is better by any objective."""
        return self.n_compared > 0 or (
            self.certificate is not None and self.certificate.is_proven
        )

    @property
    def bound(self) -> float:
        """The APR that no answer of its kind exceeds, 0..1."""
        if self.certificate is None:
            return self.after.apr
        stages = {stage.name: stage for stage in self.certificate.stages}
        if "apr" in stages:
            return stages["apr"].bound
        return 1.0


class Adviser:
    """Answers to questions about layouts in one setting.

    The assembly has the candidates, and the wishes that always hold, without a budget;
    units are re-aimed in the directions of the grid.
    """

    def __init__(self, assembly: Assembly, grid: CandidateGrid) -> None:
        self._assembly = assembly
        self._grid = grid
        self._compute = assembly.compute
        self._wishes = assembly.wishes
        self._setting = assembly.setting
        self._live = LiveTable(assembly.setting, compute=assembly.compute)

    def best_next(self, units: Sequence[CandidatePose]) -> Advice:
        """The unit that gains most next to the mounted ones.

        Costs are its own and its site's. Raises InputError if none is allowed, or
        none is an improvement.
        """
        if not units:
            return self.complete(units, n_units=1)
        problem, poses = self._beside(units)
        change = find_addition(
            problem, presolve_freely(problem), poses, budget_eur=None
        )
        if change is None:
            refuse(
                Phrase("the best next unit"),
                Phrase("no candidate that is an improvement"),
                "one",
            )
        return Advice(
            units=self._named(units, poses.candidates, change.added),
            before=placement_value(problem, range(len(units))),
            after=change.value,
            n_compared=change.n_compared,
        )

    def complete(self, units: Sequence[CandidatePose], *, n_units: int) -> Advice:
        """The best layout of `n_units` that keeps the mounted units.

        Costs are those of what is new. One more unit is found by trying all. Raises
        InputError if so many are mounted already, the sites cannot carry them, or
        one unit more is no improvement.
        """
        if n_units <= len(units):
            expected = Phrase(
                "more than the {n} that are mounted already", n=len(units)
            )
            raise InputError(Phrase("units in all"), n_units, expected)
        is_forced = self._wishes.forced_sites or any(
            site.use == "forced" for site in self._setting.scene.sites
        )
        if units and n_units == len(units) + 1 and not is_forced:
            return self.best_next(units)
        wishes = replace(
            self._wishes,
            budget_units=n_units,
            existing=tuple(unit.id for unit in units),
        )
        return self._search(units, wishes)

    def re_aim(self, units: Sequence[CandidatePose]) -> Advice:
        """The best directions of all mounted units.

        Each keeps its place and sensor; nothing is bought. Raises InputError if
        nothing is mounted, or no unit can look elsewhere.
        """
        if not units:
            refuse(Phrase("re-aim"), Phrase("no unit"), Phrase("at least one unit"))
        n = len(units)
        may_look = self._assembly.may_look
        # Directions that respect private ground.
        poses = build_retrofit_poses(
            Layout(name="now", units=tuple(units)), self._grid, ()
        )
        if may_look is not None:
            aims = np.flatnonzero(may_look(poses.candidates[n:])) + n
            kept = [*range(n), *aims.tolist()]
            poses = RetrofitPoses(
                candidates=tuple(poses.candidates[row] for row in kept),
                unit_index=poses.unit_index[kept],
            )
        if len(poses.candidates) == n:
            refuse(
                Phrase("re-aim"),
                Phrase("units that see all round"),
                Phrase("one that can turn"),
            )
        self._compute.progress(Phrase("look from the units"), 0, 0)
        problem = replace(
            self._assembly,
            candidates=poses.candidates,
            wishes=replace(self._one_more(units), site_capacity=n + 1),
            known_table=self._rows(poses.candidates),
        ).problem
        limits = combined_limits(problem.limits, poses, re_aim_eur=0.0, budget_eur=0.0)
        problem = replace(problem, limits=limits)
        solution = self._solve(problem, [np.arange(n)])
        aimed = {
            int(poses.unit_index[row]): poses.candidates[row]
            for row in solution.pose_index
        }
        return Advice(
            units=tuple(
                replace(aimed[index], id=unit.id, site_id=unit.site_id)
                for index, unit in enumerate(units)
            ),
            before=placement_value(problem, range(n)),
            after=placement_value(problem, solution.pose_index),
            certificate=solution.certificate,
        )

    def _solve(self, problem: PlacementProblem, starts: Sequence[IntArray]) -> Solution:
        """Solve a problem, and report its stages."""
        return solve_placement(
            problem,
            effort=self._assembly.effort,
            starts=starts,
            on_stage=lambda stage: self._compute.progress(
                Phrase("optimise: {goal}", goal=stage), 0, 0
            ),
        )

    def cheapest(
        self, units: Sequence[CandidatePose], *, paid: Collection[str] = ()
    ) -> Advice:
        """The cheapest layout with the APR of the mounted one.

        Costs are those of everything but the units `paid` (ids), which are mounted
        already. Raises InputError if nothing is mounted, or it avoids nothing.
        """
        if not units:
            refuse(
                Phrase("the cheapest with at least this APR"),
                Phrase("no unit"),
                Phrase("a unit"),
            )
        share = apr(self._problem(units, self._wishes), range(len(units)))
        if share <= 0.0:
            refuse(
                Phrase("the cheapest with at least this APR"),
                Phrase("an APR of {apr}", apr=0),
                Phrase("more"),
            )
        wishes = replace(
            self._wishes,
            target=share,
            saves="cost",
            forced_sites=(),
            paid=tuple(paid),
        )
        return self._search(units, wishes)

    def why_not(
        self,
        units: Sequence[CandidatePose],
        site_id: str,
        *,
        paid: Collection[str] = (),
    ) -> tuple[Advice, Advice]:
        """Worth of a site, with the mounted units and in a layout of as many units.

        The first has the best unit there next to all others; the second is the best
        layout of as many units that uses the site, with costs of everything but the
        units `paid` (ids), which are mounted already. Raises InputError if nothing is
        mounted, or nothing may be mounted at the site.
        """
        where = Phrase("why not {site}", site=site_id)
        if not units:
            refuse(where, Phrase("no unit"), Phrase("a layout to compare it with"))
        problem, poses = self._beside(units)
        standing = np.arange(len(units))
        free = fitting(problem.limits, standing)
        here = np.array(
            [candidate.site_id == site_id for candidate in poses.candidates]
        )
        rows: IntArray = np.flatnonzero(free & here)
        rows = rows[rows >= len(units)]
        if not len(rows):
            expected = Phrase("a site with room, that is not forbidden")
            refuse(where, Phrase("no pose of the grid that is allowed there"), expected)
        best = best_joining(presolve_freely(problem), standing.tolist(), rows)
        beside = Advice(
            units=self._named(units, poses.candidates, [best]),
            before=placement_value(problem, range(len(units))),
            after=placement_value(problem, [*range(len(units)), best]),
            n_compared=len(rows),
        )
        # ... and the best layout of as many units that uses the site.
        wishes = replace(
            self._wishes,
            budget_units=len(units),
            forced_sites=(site_id,),
            paid=tuple(paid),
        )
        return beside, self._search(units, wishes)

    # ---------- problems
    def _search(self, units: Sequence[CandidatePose], wishes: Wishes) -> Advice:
        """The optimiser's answer, as advice.

        It starts from the mounted units where that is allowed.
        """
        problem = self._problem(units, wishes)
        starts = []
        if len(units) and wishes.budget_units is None:
            starts.append(np.arange(len(units)))
        solution = self._solve(problem, starts)
        # Rows before the grid's are mounted units.
        stay = [units[row] for row in solution.pose_index if row < len(units)]
        new = [row for row in solution.pose_index if row >= len(units)]
        before = None
        if units:
            before = placement_value(problem, range(len(units)))
        return Advice(
            units=self._named(stay, self._candidates(units), new, taken=units),
            before=before,
            after=placement_value(problem, solution.pose_index),
            certificate=solution.certificate,
        )

    def _beside(
        self, units: Sequence[CandidatePose]
    ) -> tuple[PlacementProblem, RetrofitPoses]:
        """The problem of one more unit next to the mounted ones."""
        candidates = self._candidates(units)
        unit_index = np.full(len(candidates), -1)
        unit_index[: len(units)] = np.arange(len(units))
        poses = RetrofitPoses(candidates=candidates, unit_index=unit_index)
        return self._problem(units, self._one_more(units)), poses

    def _one_more(self, units: Sequence[CandidatePose]) -> Wishes:
        """Wishes for one more row than the mounted units.

        It is a further unit, or another direction of one.
        """
        return replace(
            self._wishes,
            existing=tuple(unit.id for unit in units),
            forced_sites=(),
        )

    def _problem(
        self, units: Sequence[CandidatePose], wishes: Wishes
    ) -> PlacementProblem:
        """The problem on the rows of the units, then those of the grid."""
        candidates = self._candidates(units)
        table = DetectionTable(
            pose_ids=tuple(candidate.id for candidate in candidates),
            axis=self._setting.axis,
            packed=np.concatenate(
                [self._rows(units).packed, self._assembly.table.packed]
            ),
        )
        return replace(
            self._assembly, candidates=candidates, wishes=wishes, known_table=table
        ).problem

    def _candidates(self, units: Sequence[CandidatePose]) -> tuple[CandidatePose, ...]:
        """The units, then the grid's poses, under ids that no other row has."""
        taken = {unit.id for unit in units}
        # A pose of the grid may be called as a unit is.
        grid = (
            replace(one, id=free_name(taken, f"{one.id}/")) if one.id in taken else one
            for one in self._assembly.candidates
        )
        return (*units, *grid)

    def _rows(self, units: Sequence[CandidatePose]) -> DetectionTable:
        """Detection table of some units."""
        names = tuple(unit.id for unit in units)
        axis = self._setting.axis
        return DetectionTable(
            pose_ids=names, axis=axis, packed=self._live.packed(units)
        )

    @staticmethod
    def _named(
        stay: Sequence[CandidatePose],
        candidates: Sequence[CandidatePose],
        new: Sequence[int],
        *,
        taken: Sequence[CandidatePose] = (),
    ) -> tuple[CandidatePose, ...]:
        """Units that stay, then new ones under names that are free."""
        names = {unit.id for unit in (*stay, *taken)}
        named = list(stay)
        for row in new:
            name = free_name(names)
            names.add(name)
            named.append(replace(candidates[row], id=name))
        return tuple(named)


def free_name(taken: set[str], word: str = "U") -> str:
    """The first of U1, U2, ... that is not taken.

    >>> free_name({"U1", "U3"})
    'U2'
    """
    number = 1
    while f"{word}{number}" in taken:
        number += 1
    return f"{word}{number}"
