"""Doubts about a placement: heavy runs, other priorities, the evaluator, mounting, failures."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Literal

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
from placement.explain.contributions import (
    MAX_PAIR_UNITS,
    Failure,
    Failures,
    find_failures,
)
from placement.explain.tolerances import MAX_UNITS, TOLERANCES, Standing, find_standing
from placement.layout import Layout
from placement.optimiser import is_feasible
from placement.pipeline import Assembly, Placement
from placement.question import Question
from placement.setting import Setting
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis
from scenarios.scores import AVOIDED

from ..language import mark, say, tr, trn
from ..progress import StageProgress
from ..results.folders import RECOMMENDED_FILE
from ..results.numbers import (
    NOTHING,
    count_runs,
    first_of,
    milliseconds,
    number,
    percent,
)
from ..results.record import Record, UnitRecord, build_unit_records, says
from ..side_process import SideProcess, Task
from .section import Section, Table, tabulate

HEAVY_SHARE = 0.02
"""A run that counts more is named."""
MAX_ROWS = 12
"""Rows of a table of failures: beyond, only the worst are shown."""
_MAX_HEAVY = 8
_MAX_RUNS = 4


class HeavyRun(Record, frozen=True, kw_only=True):
    """A run that counts much."""

    run: Annotated[str, says("Name of the run, as in runs.parquet.")]
    share: Annotated[float, says("Its part of the weight of all runs, 0..1.")]


class LeadingLayout(Record, frozen=True, kw_only=True):
    """A layout that leads on the detection table, by the evaluator."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.")]
    apr: Annotated[float, says("By the evaluator.")]
    apr_one_failed: Annotated[
        float, says("APR when the most needed unit fails; of one unit: 0.")
    ]
    mounting: Annotated[
        Standing | None, says("Cost of mounting errors; null: not asked.")
    ] = None


class FrontRunners(Record, frozen=True, kw_only=True):
    """The layout found and others that lead, judged by the evaluator."""

    recommended: Annotated[
        str, says("One of them; if another one, it is in recommended.json.")
    ]
    decided_by: Annotated[
        Deciding, says("What speaks for another layout; order: nothing does.")
    ]
    equal_within: Annotated[float, says("Shares that differ by no more are equal.")] = (
        EQUAL_APR
    )
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
    chosen = placement.pose_index
    cache = compute.cache_folder
    return find_by_runs(
        placement.problem, chosen, effort=plan.effort, cache_folder=cache
    )


def begin_standing(
    side: SideProcess,
    setting: Setting,
    layout: Layout,
    question: Question,
    compute: Compute,
) -> Task[Standing] | None:
    """Begin to find what errors of mounting cost a layout; None where it has too many units."""
    if len(layout.units) > MAX_UNITS:
        return None
    fusion = question.fusion
    units = layout.units
    return side.begin(
        TOLERANCES, find_standing, setting, units, fusion=fusion, compute=compute
    )


def leading_layouts(on_grid: Placement, placement: Placement) -> list[Layout]:
    """Layouts that lead on the table behind the one found: the greedy one.

    None where something else than the highest APR was asked for, or the evaluator's is
    another measure: of sampled worlds, of a score. `on_grid` is the placement before it
    was refined.
    """
    problem = placement.problem
    if problem.goal != "best" or problem.survive or placement.nominal is not problem:
        return []
    greedy = frozenset(on_grid.greedy_index)
    if greedy != frozenset(on_grid.pose_index) and is_feasible(
        on_grid.problem, [*greedy]
    ):
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

    `standing` is that of the layout found; of others it is asked only where they are
    its equals. The last value is the layout to recommend; None: the one found.
    """
    runners = [
        build_front_runner(one, setting.rule, fusion=question.fusion)
        for one in evaluations
    ]
    if standing is None:
        first = None
    else:
        first = standing.result(partial(progress, TOLERANCES, 0, 0))
    known: dict[int, Standing] = {} if first is None else {0: first}

    def mounted_wrongly(number: int) -> float:
        if first is None:
            return 0.0
        if number not in known:
            units = runners[number].layout.units
            found = find_standing(
                setting, units, fusion=question.fusion, compute=compute
            )
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
    values = {"apr": percent(best.apr), "other_apr": percent(first.apr)}
    values |= {
        "left": percent(best.apr_one_failed),
        "other_left": percent(first.apr_one_failed),
    }
    why = f"better_{found.decided_by}"
    if found.decided_by == "apr" and len(first.layout) == 1:
        why = "better_apr_alone"
    elif found.decided_by not in ("apr", "apr_one_failed"):
        worst = [
            percent(one.mounting.worst.apr) for one in (best, first) if one.mounting
        ]
        values["leaves"] = tr(" against ").join(worst)
        why = "better_mounted"
    values = {"why": say(f"alternatives.{why}", **values), "file": RECOMMENDED_FILE}
    values |= {"best": best.name, "first": first.name}
    if is_proven:
        key = "recommended_to_proven"
    else:
        key = "recommended_to_found"
    return [say(f"alternatives.{key}", **values)]


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
    low = percent(runs[-1].share)
    high = percent(runs[0].share)
    if low == high:
        shares = high
    else:
        shares = tr("{first} to {last}", first=low, last=high)
    return say(
        "alternatives.heavy_runs",
        len(runs),
        shares=shares,
        names=first_of([one.run for one in runs], _MAX_HEAVY),
    )


def _by_runs(found: ByRuns, n_runs: int) -> str:
    if found.runs_avoided > found.runs_avoided_here:
        values = {
            "avoided": found.runs_avoided,
            "avoided_here": found.runs_avoided_here,
        }
        if found.is_proven:
            key = "by_runs_best"
        else:
            key = "by_runs_better"
        return say(f"alternatives.{key}", runs=count_runs(n_runs), **values)
    if found.is_proven:
        return tr(
            "If every run counted the same, no layout would be better than this one."
        )
    return say("alternatives.by_runs_open")


def _mounting(found: Standing) -> str:
    aim = trn(
        "{deg:g} degree",
        "{deg:g} degrees",
        int(found.aim_deg != 1.0) + 1,
        deg=found.aim_deg,
    )
    if found.aim_deg:
        key = "aim"
    else:
        key = "exactly"
    text = say(
        f"alternatives.{key}_{'and' if found.height_m else 'not'}_height", aim=aim
    )
    worst = found.worst
    if not worst.lost_run_ids:
        return text
    runs = count_runs(len(worst.lost_run_ids))
    apr = percent(worst.apr)
    if worst.step > 0.0:
        way = "more"
    else:
        way = "less"
    off = say(f"off.{worst.kind}_{way}", step=abs(worst.step))
    at_worst = mark(
        "At worst, 1 degree or 5 cm cost {runs}: with {unit} {off} the APR is {apr}."
    )
    at_worst = tr(at_worst, runs=runs, unit=worst.unit_id, off=off, apr=apr)
    return f"{text} {at_worst}"


def failure_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    """APR that remains if one unit, two, or a pole fail; `labels` are names by id."""
    whole = failures.none_failed
    n_units = len(failures.one_failed)
    if n_units == 1:
        return [say("alternatives.one_unit", apr=percent(whole.apr))]
    return [
        tr("All {n} units together prevent {apr}.", n=n_units, apr=percent(whole.apr)),
        _if_one_fails(failures, labels),
        _if_two_fail(failures, labels),
        *([_if_a_pole_fails(failures, labels)] if failures.site_failed else []),
    ]


def _if_one_fails(failures: Failures, labels: Mapping[str, str]) -> str:
    worst = failures.one_failed[0]
    n_units = len(failures.one_failed)
    n_harmless = sum(not item.lost_run_ids for item in failures.one_failed)
    if n_harmless == n_units:
        least_s = min(item.smallest_margin_s for item in failures.one_failed)
        if math.isnan(least_s):  # there is no such run
            return tr(
                "Whichever one fails, the others avoid every run that all avoid"
                " together."
            )
        return say("alternatives.none_needed", time=milliseconds(least_s))
    values = {
        "unit": _names(worst, labels),
        "apr": percent(worst.apr),
        "lost": _runs_lost(worst),
    }
    text = say("alternatives.worst_unit", **values)
    harmless = mark(
        "{n} of the {n_units} units can fail by themselves and no run is lost."
    )
    if n_harmless:
        return f"{text} {tr(harmless, n=n_harmless, n_units=n_units)}"
    return text


def _if_two_fail(failures: Failures, labels: Mapping[str, str]) -> str:
    n_units = len(failures.one_failed)
    pairs = failures.two_failed
    n_harmless = sum(not item.lost_run_ids for item in pairs)
    if not pairs:
        pairs_up_to = mark("Pairs are looked at for up to {most} units; there are {n}.")
        return tr(pairs_up_to, most=MAX_PAIR_UNITS, n=n_units)
    if n_units == 2:
        return tr("If both fail, only the car itself is left.")
    if n_harmless == len(pairs):
        return tr("Any two may fail at once, and no run is lost.")
    values = {
        "units": _names(pairs[0], labels),
        "apr": percent(pairs[0].apr),
        "n": n_harmless,
    }
    return say("alternatives.worst_pair", n_pairs=len(pairs), **values)


def _if_a_pole_fails(failures: Failures, labels: Mapping[str, str]) -> str:
    worst = failures.site_failed[0]
    if all(len(item.unit_ids) == 1 for item in failures.site_failed):
        return tr(
            "No two units share a pole: a pole that fails takes one unit with it."
        )
    if not worst.lost_run_ids:
        return say("alternatives.no_pole_needed")
    values = {
        "units": _names(worst, labels),
        "apr": percent(worst.apr),
        "lost": _runs_lost(worst),
    }
    return say("alternatives.worst_pole", **values)


def failure_table(
    failures: Sequence[Failure],
    labels: Mapping[str, str],
    *,
    of: Literal["unit", "pair", "pole"],
) -> Table:
    """A row per failure of a unit, of two, or of a pole, the worst first, ``MAX_ROWS`` at most."""
    caption = say(f"failures.{of}")
    head = say(f"failures.{of}_head")
    if len(failures) > MAX_ROWS:
        counts = {"n": MAX_ROWS, "n_all": len(failures)}
        caption = say(f"failures.{of}_worst", if_fails=caption, **counts)
    least = tr("smallest margin of the rest (ms)")
    pole: dict[str, Callable[[Failure], str]] = {tr("pole"): lambda item: item.site_id}
    columns: dict[str, Callable[[Failure], str]] = (pole if of == "pole" else {}) | {
        head: lambda item: _names(item, labels),
        tr("APR of the rest"): lambda item: percent(item.apr),
        least: lambda item: number(1000.0 * item.smallest_margin_s, 0),
        tr("runs lost"): lambda item: str(len(item.lost_run_ids)),
        tr("which"): lambda item: first_of(item.lost_run_ids, _MAX_RUNS) or NOTHING,
    }
    numeric = range(len(columns) - 4, len(columns) - 1)
    return tabulate(caption, failures[:MAX_ROWS], columns, numeric=numeric)


def failures_section(
    evaluation: Evaluation, rule: AebRule, labels: Mapping[str, str]
) -> Section:
    """What remains if a unit fails, or two, or a pole; `labels` are short names of units by id."""
    failures = find_failures(evaluation, rule)
    tables = [failure_table(failures.one_failed, labels, of="unit")]
    if len(failures.two_failed) > 1:
        tables.append(failure_table(failures.two_failed, labels, of="pair"))
    if any(len(item.unit_ids) > 1 for item in failures.site_failed):
        tables.append(failure_table(failures.site_failed, labels, of="pole"))
    whose = say(
        f"alternatives.seen_{'with' if evaluation.cars == 1.0 else 'without'}_car"
    )
    sentences = " ".join(failure_sentences(failures, labels))
    note = f"{whose} {say('alternatives.lost_runs')}"
    return Section(
        "failures", tr("If a unit or a pole fails"), [sentences, *tables, note]
    )


def _names(failure: Failure, labels: Mapping[str, str]) -> str:
    return tr(" and ").join(
        labels.get(unit_id, unit_id) for unit_id in failure.unit_ids
    )


def _runs_lost(failure: Failure) -> str:
    return trn("{n} run is lost", "{n} runs are lost", len(failure.lost_run_ids))
