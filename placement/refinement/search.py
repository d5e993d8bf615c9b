"""The best set so far, the poses at hand, and the steps that look for better ones."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.errors import InputError

from ..candidates import CandidatePose
from ..layout import Certificate
from ..optimiser import (
    Effort,
    PlacementProblem,
    ReducedProblem,
    Solution,
    is_feasible,
    presolve,
    solve_placement,
)
from ..optimiser.bitsets import N_COLUMNS
from ..optimiser.greedy import improve, to_full
from ..pipeline import Placement
from ..setting import Setting
from .bench import add_poses, grid_bench, promising_rows
from .directions import turn
from .moves import Move, rename
from .proposals import aimed, around, build_places
from .rows import RowBuilder
from .stage_values import certify, improves, stage_values
from .weak_spots import find_weak_spots

# Called with the stage, and how much of how much is done; 0 of 0 where that is not known.
StageProgress = Callable[[str, int, int], None]

_SHRINK = 0.5  # of the spread of new poses after a round without improvement
_MAX_IDLE_ROUNDS = 3
_SOLVER_SHARE = 0.5  # of the time left, before the units are turned
_N_PER_SITE = 1
_LEAST_SOLVER_S = 1.0
_PROOF_SHARE = 0.4  # of the time: for the whole grid, when the search is over


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementEffort:
    """How hard to try.

    Attributes
    ----------
    n_rounds : int
        At most so many rounds of new poses; fewer if three in a row improve nothing,
        nor does an exact solution then.
    n_pool : int
        Poses of the grid that stay in the race for each unit's place, beside the best ones of
        every site.
    time_limit_s : float
        Six tenths of it for rounds and steps, the rest for the proof at the end. Results are the
        same again only where it is not reached. [s]
    """

    n_rounds: int = 10
    n_pool: int = 24
    time_limit_s: float = 60.0

    def __post_init__(self) -> None:
        if self.n_rounds < 0:
            raise InputError("n_rounds", self.n_rounds, "a whole number, at least 0")
        if self.n_pool < 1:
            raise InputError("n_pool", self.n_pool, "a whole number, at least 1")
        if not self.time_limit_s > 0.0:
            raise InputError("time_limit_s", self.time_limit_s, "seconds, more than 0")


class Search:
    """Looks for a better set of poses than a placement's.

    Parameters
    ----------
    setting : Setting
        Scene and runs.
    placement : Placement
        What to begin with.
    candidates : sequence of CandidatePose
        The rows of its table.
    build_rows : RowBuilder
        Makes detection rows.
    solver : Effort
        Of the optimiser.
    effort : RefinementEffort
        How hard to try.
    rng : numpy.random.Generator
        Of the new poses.
    started_s : float
        When the time began, on the monotonic clock. [s]
    """

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
            presolve(self.grid),
            placement.pose_index,
            n_best=effort.n_pool,
            n_per_site=_N_PER_SITE,
        )
        self.bench = grid_bench(self.grid, candidates, pool)
        self.rows = tuple(int(np.searchsorted(pool, pose)) for pose in placement.pose_index)
        self.certificate: Certificate | None = None  # of the last exact solution

    @property
    def n_tried(self) -> int:
        """New poses so far."""
        return int(self.bench.is_new.sum())

    def explore(self, report: StageProgress) -> int:
        """Rounds of new poses; how many there were.

        A round exchanges units for better ones, which is quick; when that finds nothing any more,
        units are turned, and the problem is solved exactly; if one of these finds something, the
        rounds go on.
        """
        spread, n_idle, n_rounds = 1.0, 0, self.effort.n_rounds
        for done in range(n_rounds):
            if time.monotonic() >= self.search_end_s:
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
                    now_s = time.monotonic()
                    if not self.solve(now_s + _SOLVER_SHARE * (self.search_end_s - now_s)):
                        return done + 1
                spread, n_idle = 1.0, 0
        return n_rounds

    def turn(self) -> bool:
        """Turn and zoom the units where they hang; whether that improves."""
        turned = turn(
            self.grid,
            self.bench,
            self.rows,
            places=self.places,
            build_rows=self.build_rows,
            end_s=self.search_end_s,
        )
        self.bench = turned.bench
        return self._take(turned.rows)

    def solve(self, end_s: float) -> bool:
        """Solve on all poses at hand; whether that improves."""
        limit_s = max(end_s - time.monotonic(), _LEAST_SOLVER_S)
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
            pose_index=pose_index,
            nominal=problem,
            nominal_index=pose_index,
        )
        return refined, self.bench.candidates, moves

    def _exchange(self) -> bool:
        """Exchange units one by one as long as that helps; whether it did."""
        reduced = presolve(self._problem())
        units = np.flatnonzero(np.isin(reduced.pose_index, self.rows))
        if len(units) < len(self.rows):  # a unit sees no more than another pose of its site
            solution = self._solved(replace(self.solver, solver="greedy"), reduced)
            return solution is not None and self._take(solution.pose_index)
        unlimited = np.full(N_COLUMNS, np.inf)
        return self._take(to_full(reduced, improve(reduced, units, unlimited)))

    def _add_proposals(self, spread: float) -> None:
        chosen = [(int(self.bench.origin[row]), self.bench.candidates[row]) for row in self.rows]
        spots = find_weak_spots(self._problem(), self.rows, self.setting.runs)
        proposals = around(self.places, chosen, self.rng, spread=spread)
        proposals += aimed(self.places, self.grid.table, spots, self.rng)
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
