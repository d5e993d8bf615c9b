"""The search of a placement: from a question to the layout, before anybody judges it.

Loads nothing that judges, draws or reports: the first lines of an answer wait for no
more than what they need.
"""

from dataclasses import dataclass, replace

from geometry.scene import Scene
from geometry.scene_sources import load_scene
from placement.candidates import CandidatePose
from placement.compute import Compute, Progress
from placement.evaluator import with_sight
from placement.growth import Grown, Growth, grow
from placement.pipeline import Assembly, Placement, assemble, place
from placement.question import AUTO, Question
from placement.refinement import Refinement, refine
from placement.setting import Setting, build_setting

from ..language import mark
from ..progress import StageProgress

_TABLE_IS_KEPT = "; the detection table is cached for the next call"


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """Values that all steps of a job need."""

    question: Question
    scene: Scene
    setting: Setting
    compute: Compute
    progress: StageProgress


def begin_job(
    question: Question, scene: Scene, *, compute: Compute, progress: StageProgress
) -> Job:
    """Lay what is driven at a scene, for layouts that are given.

    Raises InputError where nothing can be driven.
    """
    progress(mark("setting"), 0, 0)
    setting = build_setting(question, scene, compute=compute)
    return Job(
        question=question,
        scene=scene,
        setting=with_sight(setting, compute=compute),
        compute=compute,
        progress=progress,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundLayout:
    """The layout that was asked for, and how it was found.

    Attributes
    ----------
    job : Job
        Question with its number of sampled worlds, scene and setting.
    plan : Assembly
        The question made ready.
    placement : Placement
        Layout, proof and greedy layout, refined where that was asked for.
    on_grid : Placement
        The placement before it was refined.
    refinement : Refinement, optional
        How it was refined.
    poses : tuple of CandidatePose
        Rows of the placement's table.
    growth : Growth, optional
        Where the number of sampled worlds was to be found out.
    """

    job: Job
    plan: Assembly
    placement: Placement
    on_grid: Placement
    refinement: Refinement | None
    poses: tuple[CandidatePose, ...]
    growth: Growth | None


def search(
    question: Question, *, compute: Compute, progress: StageProgress
) -> FoundLayout:
    """Find a layout and prove it; refine it if that is asked for.

    Parameters
    ----------
    question : Question
        With its map imported.
    compute : Compute
        How to compute.
    progress : StageProgress
        Is told the stages.

    Returns
    -------
    found : FoundLayout
        The layout, not judged by the evaluator yet.

    Raises
    ------
    InputError
        A wish cannot be met.
    """
    scene = load_scene(question.scene)
    grown: Grown | None = None
    if question.samples == AUTO:
        grown = grow(question, scene=scene, compute=compute)
        question = replace(question, samples=grown.growth.taken)
        plan = grown.assembly
    else:
        plan = assemble(question, scene=scene, compute=compute)
    job = Job(
        question=question,
        scene=scene,
        setting=plan.setting,
        compute=compute,
        progress=progress,
    )
    reporting = replace(compute, progress=_saying_what_is_cached(job))
    if grown is not None:
        on_grid = grown.placement
        growth = grown.growth
    else:
        # Poses that are still to be turned are not compared in sampled worlds.
        on_grid = place(
            replace(plan, compute=reporting), asks_worlds=not question.refine
        )
        growth = None
    placement = on_grid
    poses = tuple(plan.candidates)
    refinement = None
    if question.refine:
        refinement = refine(
            job.setting, on_grid, plan.candidates, solver=plan.effort, compute=reporting
        )
        placement = refinement.placement
        poses = tuple(refinement.candidates)
    return FoundLayout(
        job=job,
        plan=plan,
        placement=placement,
        on_grid=on_grid,
        refinement=refinement,
        poses=poses,
        growth=growth,
    )


def _saying_what_is_cached(job: Job) -> Progress:
    """Progress of a job that says, from the optimiser on, that the table is cached."""

    def is_cached() -> bool:
        folder = job.compute.cache_folder
        return folder is not None and any(folder.glob("table-*"))

    def report(stage: str, done: int, total: int) -> None:
        is_told = _TABLE_IS_KEPT in job.progress.kept
        # The folder is looked into once, not at each step of the progress.
        if stage == "optimise" and not is_told and is_cached():
            job.progress.kept += _TABLE_IS_KEPT
        job.progress(stage, done, total)

    return report
