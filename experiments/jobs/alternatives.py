"""What puts a placement in doubt: other priorities, other front-runners, errors of mounting."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from msgspec import UNSET

from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.explain import Pool
from placement.explain.alternatives import STAGE, find_by_runs, find_sturdier
from placement.explain.front_runners import build_front_runner, recommend
from placement.explain.tolerances import MAX_UNITS, Standing, find_standing
from placement.explain.tolerances import STAGE as TOLERANCES
from placement.layout import Layout
from placement.optimiser import is_feasible
from placement.pipeline import Assembly, Placement, pick_layout
from placement.question import Question
from placement.setting import Setting

from ..progress import StageProgress
from ..report.beside import Beside, Part
from ..results.alternatives import (
    FrontRunnersRecord,
    build_by_runs_record,
    build_front_runners_record,
    build_standing_record,
    build_sturdier_record,
)

_MAX_POOLED = 5


def other_priorities(
    placement: Placement,
    question: Question,
    plan: Assembly,
    *,
    compute: Compute,
    progress: StageProgress,
) -> dict[str, Any]:
    """Fields of a result about layouts that other priorities choose from the same poses.

    Weights that somebody gave are meant: runs that count the same are not compared with them.
    """
    problem, chosen = placement.problem, placement.pose_index
    progress(STAGE, 0, 0)
    effort, cache = plan.effort, compute.cache_folder
    by_runs = None
    if question.weights in ("", "case"):
        by_runs = find_by_runs(problem, chosen, effort=effort, cache_folder=cache)
    sturdier = find_sturdier(problem, chosen, effort=effort, cache_folder=cache)
    return {
        "by_runs": (UNSET if by_runs is None else build_by_runs_record(by_runs, plan.candidates)),
        "sturdier": (
            UNSET if sturdier is None else build_sturdier_record(sturdier, plan.candidates)
        ),
    }


def begin_standing(
    beside: Beside, setting: Setting, layout: Layout, question: Question, compute: Compute
) -> Part[Standing] | None:
    """Begin to find what errors of mounting cost a layout; None where it has too many units."""
    if len(layout.units) > MAX_UNITS:
        return None
    return beside.begin(
        TOLERANCES,
        find_standing,
        setting,
        layout.units,
        fusion=question.fusion,
        compute=compute,
    )


def leading_layouts(
    on_grid: Placement,
    placement: Placement,
    poses: Sequence[CandidatePose],
    pool: Pool | None,
) -> list[Layout]:
    """Layouts that lead on the table behind the one found, the greedy one first.

    None where it is not the highest APR that was asked for, or worlds were sampled: the evaluator's
    world is the one as planned. `on_grid` is the placement before it was refined.
    """
    problem = placement.problem
    if problem.goal != "best" or problem.survive or problem.sample_index is not None:
        return []
    layouts, known = [], {frozenset(placement.pose_index)}
    greedy = frozenset(on_grid.greedy_index)
    if greedy != frozenset(on_grid.pose_index) and is_feasible(on_grid.problem, [*greedy]):
        layouts.append(on_grid.greedy)
        known |= {greedy} if on_grid is placement else set()
    for one in [] if pool is None else pool.sets:
        if frozenset(one.pose_index) not in known and len(layouts) <= _MAX_POOLED:
            layouts.append(pick_layout(poses, one.pose_index, f"pool-{len(layouts) + 1}"))
    return layouts


@dataclass(frozen=True, slots=True, kw_only=True)
class Recommendation:
    """Fields of a result about front-runners and mounting, and the layout to recommend."""

    fields: dict[str, Any]
    layout: Layout | None  # None: the one found


def build_recommendation(
    evaluations: Sequence[Evaluation],
    standing: Part[Standing] | None,
    setting: Setting,
    question: Question,
    *,
    compute: Compute,
    progress: StageProgress,
) -> Recommendation:
    """Front-runners by the evaluator, the layout found first, and what errors of mounting cost.

    `standing` is that of the layout found; of others it is asked only where they are its equals.
    """
    runners = [build_front_runner(one, setting.rule, fusion=question.fusion) for one in evaluations]
    first = None if standing is None else standing.result(partial(progress, TOLERANCES, 0, 0))
    known: list[Standing | None] = [first, *[None] * (len(runners) - 1)]

    def mounted_wrongly(number: int) -> float:
        if first is None:
            return 0.0
        if known[number] is None:
            units = runners[number].layout.units
            known[number] = find_standing(setting, units, fusion=question.fusion, compute=compute)
        found = known[number]
        assert found is not None
        return found.worst.apr

    number, decided_by = recommend(runners, mounted_wrongly)
    record: FrontRunnersRecord | None = None
    if len(runners) > 1:
        record = build_front_runners_record(
            runners, known, recommended=number, decided_by=decided_by
        )
    return Recommendation(
        fields={
            "mounting": UNSET if first is None else build_standing_record(first),
            "front_runners": UNSET if record is None else record,
        },
        layout=runners[number].layout if number else None,
    )
