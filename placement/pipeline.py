"""Candidates -> detection table -> optimiser -> layout, in one call."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import count

from geometry.errors import InputError, Unquoted

from .cache import cached_value
from .candidates import CandidatePose
from .compute import DEFAULT_COMPUTE, Compute
from .detection_table import DetectionTable
from .explain import NextUnit, find_next_unit, find_refusal
from .layout import Certificate, Layout
from .memory import check_memory
from .optimiser import (
    Effort,
    PlacementProblem,
    PresolveStatistics,
    ReducedProblem,
    Solution,
    UnmetError,
    presolve,
    solve_greedy,
    solve_placement,
)
from .optimiser.problem import Fusion
from .sampling import Uncertainty, sampled_table
from .setting import Setting
from .visibility import build_detection_table, load_table, save_table, table_fingerprint
from .wishes import Wishes, build_problem, check_wishes

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """What the optimiser found, and what it was found in.

    Attributes
    ----------
    layout : Layout
        The best layout.
    greedy : Layout
        The layout that plain greedy search finds within the same limits.
    greedy_index : tuple of int
        Rows of the table that make `greedy`, where it was found; a refinement has its own table.
    certificate : Certificate
        Proof of `layout`.
    presolve : PresolveStatistics
        What was left of the problem before any solver started.
    problem : PlacementProblem
        The problem, with the detection table.
    presolved : function, optional
        What presolve left of it, found when first asked for; None: layouts were moved since.
    pose_index : tuple of int
        Rows of the table that make `layout`.
    nominal : PlacementProblem
        The layout alone in the world as planned: `problem` itself unless worlds were sampled.
    nominal_index : tuple of int
        Rows of its table that make `layout`.
    next_unit : NextUnit, optional
        What greedy choice would add to `layout`, budgets aside; None: nothing fits, or not known.
    seconds : mapping of str to float
        Time per stage. [s]
    """

    layout: Layout
    greedy: Layout
    greedy_index: tuple[int, ...]
    certificate: Certificate
    presolve: PresolveStatistics
    problem: PlacementProblem
    pose_index: tuple[int, ...]
    nominal: PlacementProblem
    nominal_index: tuple[int, ...]
    seconds: Mapping[str, float]
    presolved: Callable[[], ReducedProblem] | None = None
    next_unit: NextUnit | None = None

    def __repr__(self) -> str:
        proof = "proven" if self.certificate.is_proven else "not proven"
        return f"Placement({self.layout!r}, {proof})"

    def __str__(self) -> str:
        return f"{self.layout}\n\n{self.certificate}"

    def _repr_html_(self) -> str:
        return self.layout._repr_html_() + self.certificate._repr_html_()


def place(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    *,
    wishes: Wishes,
    fusion: Fusion = "any",
    effort: Effort | None = None,
    uncertainty: Uncertainty | None = None,
    n_samples: int = 0,
    compute: Compute = DEFAULT_COMPUTE,
) -> Placement:
    """Find the best layout that meets wishes.

    Parameters
    ----------
    setting : Setting
        Scene, runs, braking rule, detector.
    candidates : sequence of CandidatePose
        Poses to choose from.
    wishes : Wishes
        What is asked.
    fusion : str
        "any": a frame counts if any unit detects; "single": one unit must confirm alone.
    effort : Effort, optional
        How hard the optimiser tries.
    uncertainty : Uncertainty, optional
        What is drawn in sampled worlds.
    n_samples : int
        Worlds to choose in; 0: the one as planned.
    compute : Compute
        Seed, threads, where detection tables are kept, and who is told the progress.

    Returns
    -------
    placement : Placement
        With its certificate.

    Raises
    ------
    InputError
        There is no candidate, or wishes cannot be met; the message says which, and how little has
        to give way. Or the question does not fit into the memory of this machine.
    """
    if not candidates:
        raise InputError("candidates", Unquoted("none"), "at least one pose")
    check_wishes(wishes, setting.scene)
    started = time.perf_counter()
    sample_index = None
    if uncertainty is not None and n_samples:
        check_memory(len(candidates), setting.axis.n_frames, n_worlds=n_samples)
        sampled = sampled_table(
            setting, candidates, uncertainty, n_samples=n_samples, compute=compute
        )
        table, sample_index = sampled.table, sampled.sample_index
    else:
        table = obtain_table(setting, candidates, compute=compute)
    table_done = time.perf_counter()
    _log.info("detection table: %d poses, %d frames", table.n_poses, table.axis.n_frames)
    problem = build_problem(
        setting, candidates, table, wishes=wishes, fusion=fusion, sample_index=sample_index
    )
    presolved = cache(partial(_presolve, problem))  # once, where anybody asks for it
    optimised = table_done

    def answer() -> tuple[Solution, tuple[int, ...], NextUnit | None]:
        nonlocal optimised
        reduced = presolved()
        solution = solve_placement(
            problem,
            reduced,
            effort=effort,
            on_stage=lambda stage: compute.progress(f"optimise: {stage}", 0, 0),
        )
        optimised = time.perf_counter()
        compute.progress("greedy", 0, 0)
        greedy_index = solve_greedy(problem, reduced)
        return solution, greedy_index, find_next_unit(problem, reduced, solution.pose_index)

    compute.progress("optimise", 0, 0)
    try:
        solution, greedy_index, next_unit = cached_value(
            compute.cache_folder,
            "answer",
            answer,
            kind=tuple[Solution, tuple[int, ...], NextUnit | None],
            made_from=(problem, effort),
            is_worth_it=lambda found: found[0].certificate.is_proven,
        )
    except UnmetError as error:
        compute.progress("what has to give way", 0, 0)
        effort = effort or Effort()
        refusal = find_refusal(
            problem, wishes, setting.scene, candidates, time_limit_s=effort.time_limit_s
        )
        raise refusal or error from None
    nominal, nominal_index = problem, solution.pose_index
    if sample_index is not None:
        nominal = _alone(setting, candidates, solution.pose_index, fusion, compute.within("greedy"))
        nominal_index = tuple(range(nominal.table.n_poses))
    return Placement(
        layout=pick_layout(candidates, solution.pose_index, f"best-{len(solution.pose_index)}"),
        greedy=pick_layout(candidates, greedy_index, f"greedy-{len(greedy_index)}"),
        greedy_index=greedy_index,
        certificate=solution.certificate,
        presolve=solution.presolve,
        problem=problem,
        presolved=presolved,
        pose_index=solution.pose_index,
        nominal=nominal,
        nominal_index=nominal_index,
        next_unit=next_unit,
        seconds={
            "detection_table": table_done - started,
            "optimise": optimised - table_done,
            "greedy": time.perf_counter() - optimised,
        },
    )


def _presolve(problem: PlacementProblem) -> ReducedProblem:
    """Presolve a problem, and tell what is left."""
    reduced = presolve(problem)
    _log.info("presolve: %s", reduced.statistics)
    return reduced


def obtain_table(
    setting: Setting, candidates: Sequence[CandidatePose], *, compute: Compute
) -> DetectionTable:
    """Detection table of a setting, from the cache or built anew.

    Raises
    ------
    InputError
        What is asked of the table does not fit into the memory of this machine.
    """
    check_memory(len(candidates), setting.axis.n_frames)
    if compute.cache_folder is not None:
        fingerprint = table_fingerprint(
            setting.scene, candidates, setting.runs, setting.planner, seed=compute.seed
        )
        path = compute.cache_folder / f"table-{fingerprint}.npz"
        cached = load_table(path, fingerprint=fingerprint, candidates=candidates, axis=setting.axis)
        if cached is not None:
            _log.info("detection table read from %s", path)
            compute.progress("detection table (cached)", 0, 0)
            return cached
    compute.progress("detection table", 0, 0)
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.planner,
        compute=compute,
    )
    if compute.cache_folder is not None:
        save_table(path, table, fingerprint=fingerprint)
    return table


def _alone(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    pose_index: Sequence[int],
    fusion: Fusion,
    compute: Compute,
) -> PlacementProblem:
    """A layout in the world as planned."""
    units = [candidates[index] for index in pose_index]
    table = build_detection_table(
        setting.scene, units, setting.runs, setting.axis, detector=setting.planner, compute=compute
    )
    wishes = Wishes(budget_units=1, kept=tuple(unit.id for unit in units[1:]))
    return build_problem(setting, units, table, wishes=wishes, fusion=fusion)


def pick_layout(
    candidates: Sequence[CandidatePose], pose_index: Sequence[int], name: str
) -> Layout:
    """Layout of some candidates by their rows; poses of the grid get short names.

    A name that a unit of another layout brings along is not given again.
    """
    chosen = [candidates[index] for index in pose_index]
    taken = {candidate.id for candidate in chosen}
    free = (name for name in (f"U{number}" for number in count(1)) if name not in taken)
    return Layout(
        name=name,
        units=tuple(
            replace(candidate, id=next(free)) if "/" in candidate.id else candidate
            for candidate in chosen
        ),
    )
