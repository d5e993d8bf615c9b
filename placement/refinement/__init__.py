"""Poses between those of the grid: a layout refined around its units and towards what it misses.

The search keeps the best set so far and the poses at hand, tries new ones around the chosen poses
and aimed at weak spots, and at last turns the chosen ones step by step.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product, starmap
from typing import NamedTuple

import numpy as np

from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.sensors import CameraModel

from ..candidates import CandidatePose, is_turn_useless
from ..compute import DEFAULT_COMPUTE, Compute, Progress, check_whole
from ..layout import Certificate
from ..live import LiveTable
from ..optimiser import (
    Effort,
    PlacementProblem,
    ReducedProblem,
    Solution,
    is_feasible,
    presolve,
    solve_placement,
)
from ..optimiser.bitsets import no_values
from ..optimiser.greedy import improve, to_full
from ..optimiser.problem import Objective, objective_values
from ..optimiser.solve import build_stage
from ..pipeline import Placement
from ..setting import Setting
from .poses import (
    Move,
    Places,
    RowBuilder,
    add_poses,
    aimed,
    around,
    build_places,
    find_weak_spots,
    grid_bench,
    moved,
    promising_rows,
    rename,
)


class StageValue(NamedTuple):
    """One objective of a set of poses, and its value in that objective's unit."""

    name: Objective
    value: float


def stage_values(problem: PlacementProblem, pose_index: Sequence[int]) -> tuple[StageValue, ...]:
    """Objectives of a set of poses, rows of the problem's table, in the problem's order."""
    return tuple(starmap(StageValue, objective_values(problem, pose_index).items()))


def improves(values: Sequence[StageValue], others: Sequence[StageValue]) -> bool:
    """True if the first difference that exceeds rounding noise favours `values`.

    Examples
    --------
    >>> improves([StageValue(Objective.UNITS, 2.0)], [StageValue(Objective.UNITS, 3.0)])
    True
    """
    for mine, theirs in zip(values, others, strict=True):
        excess = mine.name.excess(mine.value, theirs.value)
        if abs(excess) > mine.name.tolerance:
            return excess > 0.0
    return False


def certify(values: Sequence[StageValue], certificate: Certificate, solver: str) -> Certificate:
    """The bounds of a certificate for a set of poses that is as good as its layout or better.

    `values` are those of a set within the certificate's problem. A bound holds for all sets that
    are as good in the stages before as the certificate's layout, and so for those that are as good
    as this one. `solver` is the text about the solver that the new certificate gets.
    """
    return Certificate(
        stages=tuple(
            build_stage(own.name, own.value, proven.bound, proven.seconds)
            for own, proven in zip(values, certificate.stages, strict=True)
        ),
        solver=solver,
    )


# ---------- turning and zooming


STEPS_DEG = (8.0, 4.0, 2.0, 1.0, 0.5)
"""Of yaw and pitch; and, in per cent, of the field of view of a varifocal lens."""


def _steps(unit: CandidatePose, origin: int, places: Places) -> list[CandidatePose]:
    """Neighbours of a pose, each id once."""
    sensor = unit.sensor
    has_zoom = isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None
    poses = []
    for step_deg, turn_sign, tilt_sign, zoom_sign in product(STEPS_DEG, *[(-1, 0, 1)] * 3):
        if zoom_sign and (turn_sign or tilt_sign or not has_zoom):
            continue
        pitch_deg = unit.pose.pitch_deg + tilt_sign * step_deg
        if turn_sign and is_turn_useless(sensor, pitch_deg=pitch_deg):
            continue
        zoom = (1.0 + 0.01 * step_deg) ** zoom_sign
        pose = moved(
            places,
            origin,
            height_m=float(unit.pose.position_m[2]),
            yaw_deg=unit.pose.yaw_deg + turn_sign * step_deg,
            pitch_deg=pitch_deg,
            fov_deg=zoom * sensor.horizontal_fov_deg,
        )
        if pose is not None and pose.id != unit.id:
            poses.append(pose)
    return list({pose.id: pose for pose in poses}.values())


# ---------- the search


_MAX_MOUNTS = 16  # whose rays are cached, some ten megabytes each at the study's junction
_SHRINK = 0.5  # of the spread of new poses after a round without improvement
_MAX_IDLE_ROUNDS = 3
_SOLVER_SHARE = 0.5  # of the time left, before the units are turned
_N_PER_SITE = 1
_LEAST_SOLVER_S = 1.0
_PROOF_SHARE = 0.4  # of the time: for the whole grid, when the search is over


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementEffort:
    """How hard to try."""

    # at most so many rounds of new poses; fewer if three in a row improve nothing, nor does an
    # exact solution then
    n_rounds: int = 10
    # poses of the grid that stay in the race for each unit's place, beside the best ones of every
    # site
    n_pool: int = 24
    # six tenths of it for rounds and steps, the rest for the proof at the end. Results are the same
    # again only where it is not reached. [s]
    time_limit_s: float = 60.0

    def __post_init__(self) -> None:
        check_whole("n_rounds", self.n_rounds, least=0)
        check_whole("n_pool", self.n_pool, least=1)
        if not self.time_limit_s > 0.0:
            raise InputError("time_limit_s", self.time_limit_s, "seconds, more than 0")


class Search:
    """Looks for a better set of poses than that of a placement, with which it begins."""

    def __init__(
        self,
        setting: Setting,
        placement: Placement,
        candidates: Sequence[CandidatePose],
        *,
        build_rows: RowBuilder,
        solver: Effort,
        effort: RefinementEffort,
        rng: np.random.Generator,
        started_s: float,
    ) -> None:
        self.setting = setting
        self.grid = placement.problem
        self.places = build_places(setting.scene, candidates, self.grid.limits)
        self.build_rows = build_rows
        self.solver = solver
        self.effort = effort
        self.rng = rng
        self.end_s = started_s + effort.time_limit_s
        self.search_end_s = started_s + (1.0 - _PROOF_SHARE) * effort.time_limit_s
        self.before = self.values = stage_values(self.grid, placement.pose_index)
        pool = promising_rows(
            presolve(self.grid), placement.pose_index, n_best=effort.n_pool, n_per_site=_N_PER_SITE
        )
        self.bench = grid_bench(self.grid, candidates, pool)
        self.rows = tuple(int(np.searchsorted(pool, pose)) for pose in placement.pose_index)
        self.certificate: Certificate | None = None  # of the last exact solution

    @property
    def n_tried(self) -> int:
        """New poses so far."""
        return int(self.bench.is_new.sum())

    def explore(self, report: Progress) -> int:
        """Rounds of new poses; how many there were.

        A round exchanges units for better ones, which is quick; when that finds nothing any more,
        units are turned, and the problem is solved exactly; if one of these finds something, the
        rounds go on.
        """
        spread, n_idle, n_rounds = 1.0, 0, self.effort.n_rounds
        for done in range(n_rounds):
            if now_s() >= self.search_end_s:
                return done
            report("refine: rounds", done, n_rounds)
            self._add_proposals(spread)
            if self._exchange():
                n_idle = 0
                continue
            n_idle += 1
            spread *= _SHRINK
            if n_idle == _MAX_IDLE_ROUNDS:
                report("refine: directions", 0, 0)
                if not self.turn():
                    report("refine: solve", 0, 0)
                    here_s = now_s()
                    if not self.solve(here_s + _SOLVER_SHARE * (self.search_end_s - here_s)):
                        return done + 1
                spread, n_idle = 1.0, 0
        return n_rounds

    def turn(self) -> bool:
        """Compass search over yaw, pitch and field of view, unit by unit; whether that improves.

        In the end no step of any unit alone improves the set, unless time was up.

        Compass search shrinks its step where none improves (Kolda, Lewis, Torczon, "Optimization by
        direct search", SIAM Review 45, 2003, section 3). What a set is worth is a step function
        here - runs are avoided or not, frames come every tenth of a second -, so that a larger step
        may improve where smaller ones change nothing: all steps are tried at once.
        """
        rows, values = list(self.rows), self.values
        position, n_settled = 0, 0
        while n_settled < len(rows) and now_s() < self.search_end_s:
            found = self._best_step(rows, position, values)
            if found is not None:
                rows[position], values = found
                n_settled = 0
            else:
                n_settled += 1
                position = (position + 1) % len(rows)
        return self._take(rows)

    def _best_step(
        self, rows: Sequence[int], position: int, values: Sequence[StageValue]
    ) -> tuple[int, tuple[StageValue, ...]] | None:
        """Try the steps of one unit each way; row and values of the best, if that improves."""
        row = rows[position]
        unit, origin = self.bench.candidates[row], int(self.bench.origin[row])
        if not self.places.is_free[origin]:
            return None
        steps = _steps(unit, origin, self.places)
        self._add([(origin, pose) for pose in steps])
        known = {candidate.id: row for row, candidate in enumerate(self.bench.candidates)}
        # Only those in question: a problem on the whole bench takes longer to put together.
        others = [row for index, row in enumerate(rows) if index != position]
        tried = [known[pose.id] for pose in steps if known[pose.id] not in others]
        part = self.bench.only(np.array([*others, *tried], dtype=np.int64))
        problem = part.problem(self.grid)
        best: tuple[int, tuple[StageValue, ...]] | None = None
        for index, row in enumerate(tried):
            units = [*range(len(others)), len(others) + index]
            own = stage_values(problem, units)
            if improves(own, values if best is None else best[1]) and is_feasible(problem, units):
                best = row, own
        return best

    def solve(self, end_s: float) -> bool:
        """Solve on all poses at hand; whether that improves."""
        limit_s = max(end_s - now_s(), _LEAST_SOLVER_S)
        limit_s = min(limit_s, self.solver.time_limit_s)
        solution = self._solved(replace(self.solver, time_limit_s=limit_s))
        self.certificate = None if solution is None else solution.certificate
        return solution is not None and self._take(solution.pose_index)

    def prove(self) -> None:
        """Bound the best set among the whole grid and all new poses; a better one is taken."""
        n_grid, bench = self.grid.table.n_poses, self.bench
        row_of = np.where(bench.is_new, n_grid + np.cumsum(bench.is_new) - 1, bench.origin)
        everything = grid_bench(self.grid, self.places.candidates, np.arange(n_grid))
        self.bench = everything.plus(bench.only(np.flatnonzero(bench.is_new)))
        self.rows = tuple(int(row_of[row]) for row in self.rows)
        if improves(self.values, self.before):
            self.solve(self.end_s)

    def result(
        self, placement: Placement
    ) -> tuple[Placement, tuple[CandidatePose, ...], tuple[Move, ...]] | None:
        """The refined placement, its grid and all new poses, and what became of each unit.

        None where nothing better was found, or nothing could be said in time of how good it is.
        """
        if self.certificate is None or not improves(self.values, self.before):
            return None
        pose_index = tuple(sorted(self.rows))
        layout, moves = rename(
            placement.layout,
            [self.bench.candidates[row] for row in pose_index],
            named=[candidate.id for candidate in self.places.candidates],
            name=f"refined-{len(pose_index)}",
        )
        problem = self._problem()
        certificate = certify(
            self.values,
            self.certificate,
            f"{self.certificate.solver}, over {self.grid.table.n_poses} candidates of the grid and "
            f"{self.n_tried} tried beside them",
        )
        refined = replace(
            placement,
            layout=layout,
            certificate=certificate,
            presolve=presolve(problem).statistics,
            problem=problem,
            presolved=None,
            pose_index=pose_index,
            nominal=problem,
            nominal_index=pose_index,
            next_unit=None,  # between the poses of the grid there are ever more
        )
        return refined, self.bench.candidates, moves

    def _exchange(self) -> bool:
        """Exchange units one by one as long as that helps; whether it did."""
        reduced = presolve(self._problem())
        units = np.flatnonzero(np.isin(reduced.pose_index, self.rows))
        if len(units) < len(self.rows):  # a unit sees no more than another pose of its site
            solution = self._solved(replace(self.solver, solver="greedy"), reduced)
            return solution is not None and self._take(solution.pose_index)
        unlimited = no_values(reduced, np.inf)
        return self._take(to_full(reduced, improve(reduced, units, unlimited)))

    def _add_proposals(self, spread: float) -> None:
        chosen = [(int(self.bench.origin[row]), self.bench.candidates[row]) for row in self.rows]
        spots = find_weak_spots(self._problem(), self.rows, self.setting.runs)
        proposals = around(self.places, chosen, self.rng, spread=spread)
        self._add([*proposals, *aimed(self.places, self.grid.table, spots, self.rng)])

    def _add(self, proposals: Sequence[tuple[int, CandidatePose]]) -> None:
        """Put poses, with the rows of the grid that they stand for, on the bench."""
        self.bench = add_poses(
            self.bench, self.grid, proposals, places=self.places, build_rows=self.build_rows
        )

    def _solved(self, effort: Effort, reduced: ReducedProblem | None = None) -> Solution | None:
        try:
            return solve_placement(self._problem(), reduced, effort=effort)
        except InputError:
            return None  # the set at hand meets all wishes, but time was too short to find one

    def _take(self, rows: Sequence[int]) -> bool:
        """Take a set of the bench if it is better; whether it was."""
        problem = self._problem()
        values = stage_values(problem, rows)
        if not (improves(values, self.values) and is_feasible(problem, rows)):
            return False
        self.rows, self.values = tuple(rows), values
        return True

    def _problem(self) -> PlacementProblem:
        return self.bench.problem(self.grid)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refinement:
    """A layout, and what it was before."""

    unrefined: Placement  # the one given: its certificate is about the grid alone
    # the refined one: its problem's table has the poses tried behind those of the grid, and
    # the bounds of its certificate are about these, not about all poses in between. The one
    # given, where nothing better was found.
    placement: Placement
    candidates: tuple[CandidatePose, ...]  # the rows of that table
    # before, after: in the order of the problem's stages; `after` is `before` or better
    before: tuple[StageValue, ...]
    after: tuple[StageValue, ...]
    moves: tuple[Move, ...]  # what became of each unit; empty where nothing better was found
    n_tried: int  # new poses whose detections were computed
    n_rounds: int  # rounds of new poses
    seconds: float  # time spent. [s]

    @property
    def is_improved(self) -> bool:
        """True if a better layout was found."""
        return bool(self.moves)

    def __repr__(self) -> str:
        return f"Refinement({self.placement.layout!r}, {self.n_tried} poses tried)"


def refine(
    setting: Setting,
    placement: Placement,
    candidates: Sequence[CandidatePose],
    *,
    effort: RefinementEffort | None = None,
    solver: Effort | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Refinement:
    """Look for a better layout between the poses of a grid.

    Parameters
    ----------
    setting : Setting
        What the layout was found in.
    placement : Placement
        The layout, and its problem: limits, floors, goal and stages stay as they are. Units that
        are forced do not move.
    candidates : sequence of CandidatePose
        The grid: the rows of the placement's table.
    effort : RefinementEffort, optional
        How hard to try.
    solver : Effort, optional
        Of the optimiser; its time limit is shortened where that of `effort` leaves less.
    compute : Compute
        Threads, progress, and the seed of the new poses and of the points on the
        VRUs: that of the table.

    Returns
    -------
    refinement : Refinement
        Never worse, in the order of the problem's stages. Poses around the chosen ones and poses
        aimed at what is seen too late are added to the promising ones of the grid, and the problem
        is solved again on these, until that improves nothing; then the units are turned in small
        steps where they are.

    Raises
    ------
    InputError
        The table is not that of the candidates, or of sampled worlds.
    """
    started_s = now_s()
    effort = RefinementEffort() if effort is None else effort
    problem = placement.problem
    _check_table(problem, setting, candidates)
    search = Search(
        setting,
        placement,
        candidates,
        build_rows=LiveTable(setting, compute=compute, max_mounts=_MAX_MOUNTS).packed,
        solver=Effort() if solver is None else solver,
        rng=np.random.default_rng(compute.seed),
        effort=effort,
        started_s=started_s,
    )
    n_rounds = search.explore(compute.progress)
    compute.progress("refine: directions", 0, 0)
    search.turn()
    compute.progress("refine: proof", 0, 0)
    search.prove()
    result = search.result(placement)
    refined, all_candidates, moves = result or (placement, tuple(candidates), ())
    return Refinement(
        unrefined=placement,
        placement=refined,
        candidates=all_candidates,
        before=search.before,
        after=search.before if result is None else search.values,
        moves=moves,
        n_tried=search.n_tried,
        n_rounds=n_rounds,
        seconds=now_s() - started_s,
    )


def _check_table(
    problem: PlacementProblem, setting: Setting, candidates: Sequence[CandidatePose]
) -> None:
    if problem.table.pose_ids != tuple(candidate.id for candidate in candidates):
        raise InputError("candidates", Unquoted("other poses"), "the rows of the placement's table")
    if problem.table.axis.run_ids != setting.axis.run_ids:
        raise InputError(
            "refine", Unquoted("a table of sampled worlds"), "a table of the runs as planned"
        )
