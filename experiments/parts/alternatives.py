"""Doubts about a placement: heavy runs, other priorities, the evaluator, mounting errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np

from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.explain.alternatives import (
    EQUAL_APR,
    STAGE,
    ByRuns,
    Deciding,
    build_front_runner,
    find_by_runs,
    recommend,
)
from placement.explain.tolerances import MAX_UNITS, TOLERANCES, Standing, find_standing
from placement.layout import Layout
from placement.optimiser import is_feasible
from placement.pipeline import Assembly, Placement
from placement.question import Question
from placement.setting import Setting
from scenarios.runs import FrameAxis
from scenarios.scores import AVOIDED

from ..progress import StageProgress
from ..results.folders import RECOMMENDED_FILE
from ..results.numbers import count_runs, first_of, percent
from ..results.record import UnitRecord, build_unit_records, says
from ..side_process import SideProcess, Task

HEAVY_SHARE = 0.02
"""A run that counts more is named."""
_MAX_HEAVY = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class HeavyRun:
    """A run that counts much."""

    run: Annotated[str, says("Name of the run, as in runs.parquet.")]
    share: Annotated[float, says("Its part of the weight of all runs, 0..1.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class LeadingLayout:
    """A layout that leads on the detection table, by the evaluator."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.")]
    apr: Annotated[float, says("By the evaluator.")]
    apr_one_failed: Annotated[float, says("APR when the most needed unit fails; of one unit: 0.")]
    mounting: Annotated[Standing | None, says("Cost of mounting errors; null: not asked.")] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRunners:
    """The layout found and others that lead, judged by the evaluator."""

    recommended: Annotated[str, says("One of them; if another one, it is in recommended.json.")]
    decided_by: Annotated[Deciding, says("What speaks for another layout; order: nothing does.")]
    equal_within: Annotated[float, says("Shares that differ by no more are equal.")] = EQUAL_APR
    layouts: Annotated[tuple[LeadingLayout, ...], says("The layout found comes first.")]


def find_heavy_runs(axis: FrameAxis) -> tuple[HeavyRun, ...]:
    """Runs that count more than others and more than 2 %, to a tenth; the heaviest first."""
    share = axis.weight / axis.weight.sum()
    is_heavy = (np.round(share, 3) > HEAVY_SHARE) & (np.ptp(share) > 1.0e-9)
    rows = np.flatnonzero(is_heavy)
    return tuple(
        HeavyRun(run=axis.run_ids[row], share=float(share[row]))
        for row in rows[np.argsort(-share[rows], kind="stable")]
    )


def find_other_weights(
    placement: Placement,
    question: Question,
    plan: Assembly,
    *,
    compute: Compute,
    progress: StageProgress,
) -> ByRuns | None:
    """The layout that is best if all runs count the same; None if weights were asked for."""
    progress(STAGE, 0, 0)
    if question.weights not in ("", "case") or question.score != AVOIDED:
        return None
    chosen, cache = placement.pose_index, compute.cache_folder
    return find_by_runs(placement.problem, chosen, effort=plan.effort, cache_folder=cache)


def begin_standing(
    side: SideProcess, setting: Setting, layout: Layout, question: Question, compute: Compute
) -> Task[Standing] | None:
    """Begin to find what errors of mounting cost a layout; None where it has too many units."""
    if len(layout.units) > MAX_UNITS:
        return None
    return side.begin(
        TOLERANCES, find_standing, setting, layout.units, fusion=question.fusion, compute=compute
    )


def leading_layouts(on_grid: Placement, placement: Placement) -> list[Layout]:
    """Layouts that lead on the table behind the one found: the greedy one.

    None where something else than the highest APR was asked for, or the evaluator's is another
    measure: of sampled worlds, of a score. `on_grid` is the placement before it was refined.
    """
    problem = placement.problem
    if problem.goal != "best" or problem.survive or placement.nominal is not problem:
        return []
    greedy = frozenset(on_grid.greedy_index)
    if greedy != frozenset(on_grid.pose_index) and is_feasible(on_grid.problem, [*greedy]):
        return [on_grid.greedy]
    return []


def find_front_runners(
    evaluations: Sequence[Evaluation],
    standing: Task[Standing] | None,
    setting: Setting,
    question: Question,
    *,
    compute: Compute,
    progress: StageProgress,
) -> tuple[FrontRunners | None, Standing | None, Layout | None]:
    """Leading layouts by the evaluator, the layout found first, with what mounting errors cost it.

    `standing` is that of the layout found; of others it is asked only where they are its equals.
    The last value is the layout to recommend; None: the one found.
    """
    runners = [build_front_runner(one, setting.rule, fusion=question.fusion) for one in evaluations]
    first = None if standing is None else standing.result(partial(progress, TOLERANCES, 0, 0))
    known: dict[int, Standing] = {} if first is None else {0: first}

    def mounted_wrongly(number: int) -> float:
        if first is None:
            return 0.0
        if number not in known:
            units = runners[number].layout.units
            found = find_standing(setting, units, fusion=question.fusion, compute=compute)
            known[number] = found
        return known[number].worst.apr

    number, decided_by = recommend(runners, mounted_wrongly)
    if len(runners) == 1:
        return None, first, None
    found = FrontRunners(
        recommended=runners[number].layout.name,
        decided_by=decided_by,
        layouts=tuple(
            LeadingLayout(
                name=one.layout.name,
                layout=build_unit_records(one.layout),
                apr=one.apr,
                apr_one_failed=one.apr_one_failed,
                mounting=known.get(order),
            )
            for order, one in enumerate(runners)
        ),
    )
    return found, first, runners[number].layout if number else None


def recommended_sentences(found: FrontRunners | None, *, is_proven: bool) -> list[str]:
    """Which layout the evaluator prefers; nothing where that is the one found."""
    if found is None or found.decided_by == "order":
        return []
    first = found.layouts[0]
    best = next(one for one in found.layouts if one.name == found.recommended)
    left = f"{percent(best.apr_one_failed)} against {percent(first.apr_one_failed)}"
    if found.decided_by == "apr":
        why = f"APR {percent(best.apr)} against {percent(first.apr)}"
        if len(first.layout) > 1:
            why += f", and {left} if any one unit fails"
    elif found.decided_by == "apr_one_failed":
        why = f"the same APR, {percent(first.apr)}, and {left} if any one unit fails"
    else:
        worst = [percent(one.mounting.worst.apr) for one in (best, first) if one.mounting]
        leaves = " against ".join(worst)
        why = f"the same APR, and a unit mounted 1 degree or 5 cm off leaves {leaves}"
    proof = "is proven best on the detection table" if is_proven else "is the best found"
    return [
        f"Recommended: {best.name}, in {RECOMMENDED_FILE}. The evaluator prefers it to "
        f"{first.name}: {why}. All else here is about {first.name}, which {proof}."
    ]


def doubt_sentences(
    heavy_runs: Sequence[HeavyRun],
    by_runs: ByRuns | None = None,
    mounting: Standing | None = None,
    *,
    n_runs: int,
) -> list[str]:
    """Sentences about what would change the answer; nothing where nobody looked."""
    return [
        *([_heavy(heavy_runs)] if heavy_runs else []),
        *([_by_runs(by_runs, n_runs)] if by_runs else []),
        *([_mounting(mounting)] if mounting else []),
    ]


def _heavy(runs: Sequence[HeavyRun]) -> str:
    low, high = percent(runs[-1].share), percent(runs[0].share)
    shares = high if low == high else f"{low} to {high}"
    names = first_of([one.run for one in runs], _MAX_HEAVY)
    if len(runs) == 1:
        return f"One run alone counts {shares} of the APR: {names}."
    return f"{len(runs)} runs count {shares} of the APR each: {names}."


def _by_runs(found: ByRuns, n_runs: int) -> str:
    if found.runs_avoided > found.runs_avoided_here:
        best = "best" if found.is_proven else "better"
        return (
            f"If every run counted the same (--weights run), another layout would be {best}: it "
            f"avoids {found.runs_avoided} of {count_runs(n_runs)}, this one "
            f"{found.runs_avoided_here} (on the detection table)."
        )
    if found.is_proven:
        return "If every run counted the same, no layout would be better than this one."
    return (
        "If every run counted the same, no better layout was found in the time for it; that "
        "there is none is not proven."
    )


def _mounting(found: Standing) -> str:
    aim = f"{found.aim_deg:g} {'degree' if found.aim_deg == 1.0 else 'degrees'}"
    exactly = "Mount exactly: half a degree off the aim of a unit"
    text = {
        (
            True,
            True,
        ): f"A unit may be {aim} off its aim or 5 cm too high or low, and no run is lost.",
        (True, False): f"A unit may be {aim} off its aim and no run is lost; 5 cm too high or low "
        "already loses one.",
        (False, True): f"{exactly} already loses a run; 5 cm too high or low loses none.",
        (False, False): f"{exactly}, or 5 cm too high or low, already loses a run.",
    }[bool(found.aim_deg), bool(found.height_m)]
    worst = found.worst
    if not worst.lost_run_ids:
        return text
    size, is_more = f"{abs(worst.step):g} degree", worst.step > 0.0
    off = {
        "yaw": f"turned {size} to the {'left' if is_more else 'right'}",
        "pitch": f"tilted {size} {'up' if is_more else 'down'}",
        "height": f"5 cm too {'high' if is_more else 'low'}",
    }[worst.kind]
    return (
        f"{text} At worst, 1 degree or 5 cm cost {count_runs(len(worst.lost_run_ids))}: with "
        f"{worst.unit_id} {off} the APR is {percent(worst.apr)}."
    )
