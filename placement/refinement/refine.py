"""Poses between those of the grid: a layout refined around its units and towards what it misses."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.errors import InputError, Unquoted

from ..candidates import CandidatePose
from ..optimiser import Effort, PlacementProblem
from ..pipeline import Placement
from ..setting import Setting
from .poses import Move, RayRows
from .search import RefinementEffort, Search, StageProgress, StageValue

__all__ = ["Refinement", "RefinementEffort", "StageProgress", "refine"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refinement:
    """A layout, and what it was before.

    Attributes
    ----------
    unrefined : Placement
        The one given: its certificate is about the grid alone.
    placement : Placement
        The refined one: its problem's table has the poses tried behind those of the grid, and the
        bounds of its certificate are about these, not about all poses in between. The one given,
        where nothing better was found.
    candidates : tuple of CandidatePose
        The rows of that table.
    before, after : tuple of StageValue
        In the order of the problem's stages; `after` is `before` or better.
    moves : tuple of Move
        What became of each unit; empty where nothing better was found.
    n_tried : int
        New poses whose detections were computed.
    n_rounds : int
        Rounds of new poses.
    seconds : float
        Time spent. [s]
    """

    unrefined: Placement
    placement: Placement
    candidates: tuple[CandidatePose, ...]
    before: tuple[StageValue, ...]
    after: tuple[StageValue, ...]
    moves: tuple[Move, ...]
    n_tried: int
    n_rounds: int
    seconds: float

    @property
    def is_improved(self) -> bool:
        """Whether a better layout was found."""
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
    seed: int = 0,
    workers: int = 1,
    on_progress: StageProgress | None = None,
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
    seed : int
        Of the new poses, and of the points on the VRUs: that of the table.
    workers : int
        Threads.
    on_progress : callable, optional
        See ``StageProgress``.

    Returns
    -------
    refinement : Refinement
        Never worse, in the order of the problem's stages. Poses around the chosen ones and poses
        aimed at what is seen too late are added to the promising ones of the grid, and the problem
        is solved again on these, until that improves nothing; then the units are turned in small
        steps where they hang.

    Raises
    ------
    InputError
        The table is not that of the candidates, or of sampled worlds.
    """
    started_s = time.monotonic()
    effort = RefinementEffort() if effort is None else effort
    problem = placement.problem
    _check_table(problem, setting, candidates)
    search = Search(
        setting,
        placement,
        candidates,
        build_rows=RayRows(setting, seed=seed, workers=workers),
        solver=Effort() if solver is None else solver,
        rng=np.random.default_rng(seed),
        effort=effort,
        started_s=started_s,
    )
    report = on_progress or _ignore
    n_rounds = search.explore(report)
    report("refine: directions", 0, 0)
    search.turn()
    report("refine: proof", 0, 0)
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
        seconds=time.monotonic() - started_s,
    )


def _check_table(
    problem: PlacementProblem,
    setting: Setting,
    candidates: Sequence[CandidatePose],
) -> None:
    if problem.table.pose_ids != tuple(candidate.id for candidate in candidates):
        raise InputError("candidates", Unquoted("other poses"), "the rows of the placement's table")
    if problem.table.axis.run_ids != setting.axis.run_ids:
        raise InputError(
            "--refine", Unquoted("a table of sampled worlds"), "a table of the runs as planned"
        )


def _ignore(stage: str, done: int, total: int) -> None:
    """Take no notice of progress."""
