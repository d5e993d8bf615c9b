"""Answers to somebody who plans by hand: what to do next from the mounted units, with a bound.

Each is one of the optimiser's, with the mounted units as further rows of the grid's table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError, Unquoted

from .candidates import CandidateGrid, CandidatePose
from .detection_table import DetectionTable
from .layout import Certificate, Layout
from .live import LiveTable
from .optimiser import PlacementProblem, PlacementValue, apr, placement_value, solve_placement
from .optimiser.limits import fitting
from .pipeline import Assembly
from .retrofit import (
    RetrofitPoses,
    best_joining,
    build_retrofit_poses,
    combined_limits,
    find_addition,
)
from .wishes import Wishes

LEAST_GAIN = 1.0e-9
"""An APR that is higher by less is the same."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Advice:
    """A layout that answers a question, and how good it is proven to be."""

    # all that would be mounted then; those that stay keep their ids
    units: tuple[CandidatePose, ...]
    # before, after: worth of the present and the new layout on the detection table; `before`
    # is None where nothing is mounted. Costs are of the same kind: of what is new, or of
    # everything.
    before: PlacementValue | None
    after: PlacementValue
    # of a search; None where all alternatives were tried one by one
    certificate: Certificate | None = None
    n_compared: int = 0  # how many were tried so; 0 of a search

    @property
    def is_proven(self) -> bool:
        """True if nothing of its kind is better by what is asked for, the first objective."""
        if self.certificate is None:
            return self.n_compared > 0
        return self.certificate.stages[0].gap == 0.0

    @property
    def is_all_proven(self) -> bool:
        """True if nothing of its kind is better by any objective."""
        return self.n_compared > 0 or (self.certificate is not None and self.certificate.is_proven)

    @property
    def bound(self) -> float:
        """The APR that no answer of its kind exceeds, 0..1."""
        if self.certificate is None:
            return self.after.apr
        stages = {stage.name: stage for stage in self.certificate.stages}
        return stages["apr"].bound if "apr" in stages else 1.0


class Adviser:
    """Answers to questions about layouts in one setting.

    The assembly has the candidates, and the wishes that always hold, without a budget; units are
    re-aimed in the directions of the grid.
    """

    def __init__(self, assembly: Assembly, grid: CandidateGrid) -> None:
        self._assembly, self._grid, self._compute = assembly, grid, assembly.compute
        self._wishes, self._setting = assembly.wishes, assembly.setting
        self._live = LiveTable(assembly.setting, compute=assembly.compute)

    def best_next(self, units: Sequence[CandidatePose]) -> Advice:
        """The unit that gains most next to the mounted ones; costs are its own and its site's.

        Raises InputError if none is allowed, or none is an improvement.
        """
        if not units:
            return self.complete(units, n_units=1)
        problem, poses = self._beside(units)
        change = find_addition(problem, poses, budget_eur=None)
        if change is None:
            got = Unquoted("no candidate that is an improvement")
            raise InputError("the best next unit", got, "one")
        return Advice(
            units=self._named(units, poses.candidates, change.added),
            before=placement_value(problem, range(len(units))),
            after=change.value,
            n_compared=change.n_compared,
        )

    def complete(self, units: Sequence[CandidatePose], *, n_units: int) -> Advice:
        """The best layout of `n_units` that has the mounted units; costs are of what is new.

        One more unit is found by trying all. Raises InputError if so many are mounted already, the
        sites cannot carry them, or one unit more is no improvement.
        """
        if n_units <= len(units):
            expected = f"more than the {len(units)} that are mounted already"
            raise InputError("units in all", n_units, expected)
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
        """The best directions of all units, each at its place with its sensor; nothing is bought.

        Raises InputError if nothing is mounted, or no unit can look elsewhere.
        """
        if not units:
            raise InputError("re-aim", Unquoted("no unit"), "at least one unit")
        layout = Layout(name="now", units=tuple(units))
        poses = build_retrofit_poses(layout, self._grid, ())
        may_look = self._assembly.may_look
        if may_look is not None:
            n = len(units)
            aims = np.flatnonzero(may_look(poses.candidates[n:])) + n
            kept = [*range(n), *aims.tolist()]
            poses = RetrofitPoses(
                candidates=tuple(poses.candidates[row] for row in kept),
                unit_index=poses.unit_index[kept],
            )
        if len(poses.candidates) == len(units):
            raise InputError("re-aim", Unquoted("units that see all round"), "one that can turn")
        self._compute.progress("look from the units", 0, 0)
        table = self._rows(poses.candidates)
        wishes = replace(self._one_more(units), site_capacity=len(units) + 1)
        problem = replace(
            self._assembly, candidates=poses.candidates, wishes=wishes, known_table=table
        ).problem
        limits = combined_limits(problem.limits, poses, re_aim_eur=0.0, budget_eur=0.0)
        problem = replace(problem, limits=limits)
        solution = solve_placement(
            problem,
            effort=self._assembly.effort,
            starts=[np.arange(len(units))],
            on_stage=self._tell,
        )
        aimed = {int(poses.unit_index[row]): poses.candidates[row] for row in solution.pose_index}
        return Advice(
            units=tuple(
                replace(aimed[index], id=unit.id, site_id=unit.site_id)
                for index, unit in enumerate(units)
            ),
            before=placement_value(problem, range(len(units))),
            after=placement_value(problem, solution.pose_index),
            certificate=solution.certificate,
        )

    def cheapest(self, units: Sequence[CandidatePose]) -> Advice:
        """The layout of least cost whose APR is that of the mounted one; costs are of everything.

        Raises InputError if nothing is mounted, or it avoids nothing.
        """
        if not units:
            raise InputError("the cheapest that keeps this", Unquoted("no unit"), "a unit")
        share = apr(self._problem(units, self._wishes), range(len(units)))
        if share <= 0.0:
            raise InputError("the cheapest that keeps this", Unquoted("an APR of 0"), "more")
        wishes = replace(self._wishes, target=share, saves="cost", forced_sites=())
        return self._search(units, wishes)

    def why_not(self, units: Sequence[CandidatePose], site_id: str) -> tuple[Advice, Advice]:
        """Worth of a site: beside the mounted units, and in a layout of as many units.

        The first has the best unit there next to all others; the second is the best layout of as
        many units that uses the site, costs of everything. Raises InputError if nothing is
        mounted, or nothing may be mounted at the site.
        """
        where = f"why not {site_id}"
        if not units:
            raise InputError(where, Unquoted("no unit"), "a layout to compare it with")
        problem, poses = self._beside(units)
        standing = np.arange(len(units))
        free = fitting(replace(problem.limits, budget_units=None), standing)
        here = np.array([candidate.site_id == site_id for candidate in poses.candidates])
        rows: IntArray = np.flatnonzero(free & here)
        rows = rows[rows >= len(units)]
        if not len(rows):
            expected = "a site with room, that is not forbidden"
            raise InputError(where, Unquoted("no pose of the grid that is allowed there"), expected)
        best = int(rows[best_joining(problem, standing.tolist(), rows)])
        beside = Advice(
            units=self._named(units, poses.candidates, [best]),
            before=placement_value(problem, range(len(units))),
            after=placement_value(problem, [*range(len(units)), best]),
            n_compared=len(rows),
        )
        wishes = replace(self._wishes, budget_units=len(units), forced_sites=(site_id,))
        return beside, self._search(units, wishes)

    # ---------- problems

    def _search(self, units: Sequence[CandidatePose], wishes: Wishes) -> Advice:
        """The optimiser's answer, started from the mounted units where that is allowed."""
        problem = self._problem(units, wishes)
        standing = np.arange(len(units))
        has_start = bool(len(units)) and wishes.budget_units is None
        solution = solve_placement(
            problem,
            effort=self._assembly.effort,
            starts=[standing] if has_start else (),
            on_stage=self._tell,
        )
        candidates = self._candidates(units)
        stay = [row for row in solution.pose_index if row < len(units)]
        new = [row for row in solution.pose_index if row >= len(units)]
        return Advice(
            units=self._named([units[row] for row in stay], candidates, new, taken=units),
            before=placement_value(problem, range(len(units))) if units else None,
            after=placement_value(problem, solution.pose_index),
            certificate=solution.certificate,
        )

    def _beside(self, units: Sequence[CandidatePose]) -> tuple[PlacementProblem, RetrofitPoses]:
        """The problem of one more unit next to the mounted ones."""
        candidates = self._candidates(units)
        unit_index = np.full(len(candidates), -1)
        unit_index[: len(units)] = np.arange(len(units))
        poses = RetrofitPoses(candidates=candidates, unit_index=unit_index)
        return self._problem(units, self._one_more(units)), poses

    def _one_more(self, units: Sequence[CandidatePose]) -> Wishes:
        """One more row than the mounted units: a further unit, or another direction of one."""
        return replace(
            self._wishes,
            budget_units=len(units) + 1,
            existing=tuple(unit.id for unit in units),
            forced_sites=(),
        )

    def _problem(self, units: Sequence[CandidatePose], wishes: Wishes) -> PlacementProblem:
        """The problem on the rows of the units, then those of the grid."""
        candidates = self._candidates(units)
        table = DetectionTable(
            pose_ids=tuple(candidate.id for candidate in candidates),
            axis=self._setting.axis,
            packed=np.concatenate([self._rows(units).packed, self._assembly.table.packed]),
        )
        return replace(
            self._assembly, candidates=candidates, wishes=wishes, known_table=table
        ).problem

    def _candidates(self, units: Sequence[CandidatePose]) -> tuple[CandidatePose, ...]:
        """The units, then the grid's poses, under ids that no other row has."""
        taken = {unit.id for unit in units}
        grid = (
            replace(one, id=free_name(taken, f"{one.id}/")) if one.id in taken else one
            for one in self._assembly.candidates
        )
        return (*units, *grid)

    def _rows(self, units: Sequence[CandidatePose]) -> DetectionTable:
        names, axis = tuple(unit.id for unit in units), self._setting.axis
        return DetectionTable(pose_ids=names, axis=axis, packed=self._live.packed(units))

    def _tell(self, stage: str) -> None:
        self._compute.progress(f"optimise: {stage}", 0, 0)

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

    Examples
    --------
    >>> free_name({"U1", "U3"})
    'U2'
    """
    number = 1
    while f"{word}{number}" in taken:
        number += 1
    return f"{word}{number}"
