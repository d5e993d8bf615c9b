"""Doubts about a placement.

Heavy runs, other priorities, the evaluator, mounting, failures.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Literal, NamedTuple

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

from ..language import mark, tr, trn
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
    """Runs that count more than others and more than 2 %, to a tenth.

    The heaviest first.
    """
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
    """The layout that is best if all runs count the same.

    None if weights were asked for.
    """
    progress(STAGE, 0, 0)
    if question.weights not in ("", "case"):
        return None
    chosen = placement.pose_index
    cache = compute.cache_folder
    return find_by_runs(
        placement.problem, chosen, effort=plan.effort, cache_folder=cache
    )


def leading_layouts(on_grid: Placement, placement: Placement) -> list[Layout]:
    """Layouts that lead on the table behind the one found: the greedy one.

    None where something else than the highest APR was asked for, or the evaluator's is
    another measure: of sampled worlds. `on_grid` is the placement before it
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
    setting: Setting,
    question: Question,
    *,
    compute: Compute,
    progress: StageProgress,
) -> tuple[FrontRunners | None, Standing | None, Layout | None]:
    """Leading layouts by the evaluator, the layout found first.

    Also what mounting errors cost that one.

    Mounting errors of the layout found are not asked for where it has too many units;
    those of others only where they are its equals. The last value is the layout to
    recommend; None: the one found.
    """
    runners = [
        build_front_runner(one, setting.rule, fusion=question.fusion)
        for one in evaluations
    ]
    first: Standing | None = None
    known: dict[int, Standing] = {}
    units = evaluations[0].layout.units
    if len(units) <= MAX_UNITS:
        progress(TOLERANCES, 0, 0)
        first = find_standing(setting, units, fusion=question.fusion, compute=compute)
        known[0] = first

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
    recommended = mark(
        "Recommended: {best}, in {file}. The evaluator prefers it to "
        "{first}: {why}. All else here is about {first}, which is the "
        "best found."
    )
    if is_proven:
        recommended = mark(
            "Recommended: {best}, in {file}. The evaluator prefers it to "
            "{first}: {why}. All else here is about {first}, which is proven "
            "best on the detection table."
        )
    why = _why_better(best, first, found.decided_by)
    return [
        tr(
            recommended,
            best=best.name,
            first=first.name,
            file=RECOMMENDED_FILE,
            why=why,
        )
    ]


def _why_better(best: LeadingLayout, first: LeadingLayout, decided_by: Deciding) -> str:
    """What the layout recommended has more of than the first one."""
    apr = percent(best.apr)
    other_apr = percent(first.apr)
    left = percent(best.apr_one_failed)
    other_left = percent(first.apr_one_failed)
    if decided_by == "apr" and len(first.layout) == 1:
        return tr("APR {apr} against {other_apr}", apr=apr, other_apr=other_apr)
    if decided_by == "apr":
        return tr(
            "APR {apr} against {other_apr}, and {left} against {other_left} if any one"
            " unit fails",
            apr=apr,
            other_apr=other_apr,
            left=left,
            other_left=other_left,
        )
    if decided_by == "apr_one_failed":
        return tr(
            "the same APR, {other_apr}, and {left} against {other_left} if any one unit"
            " fails",
            other_apr=other_apr,
            left=left,
            other_left=other_left,
        )
    worst = [percent(one.mounting.worst.apr) for one in (best, first) if one.mounting]
    return tr(
        "the same APR, and {leaves} if a unit is mounted 1 degree or 5 cm off",
        leaves=tr(" against ").join(worst),
    )


def doubt_sentences(
    heavy_runs: Sequence[HeavyRun],
    by_runs: ByRuns | None = None,
    mounting: Standing | None = None,
    *,
    n_runs: int,
) -> list[str]:
    """Sentences about what would change the answer.

    Nothing where nobody looked.
    """
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
    return trn(
        "One run alone counts {shares} of the APR: {names}.",
        "{n} runs count {shares} of the APR each: {names}.",
        len(runs),
        shares=shares,
        names=first_of([one.run for one in runs], _MAX_HEAVY),
    )


def _by_runs(found: ByRuns, n_runs: int) -> str:
    if found.runs_avoided > found.runs_avoided_here:
        better = mark(
            "If every run counted the same (--weights run), another layout "
            "would be better: it avoids {avoided} of {runs}, this one "
            "{avoided_here} (on the detection table)."
        )
        if found.is_proven:
            better = mark(
                "If every run counted the same (--weights run), another layout "
                "would be best: it avoids {avoided} of {runs}, this one "
                "{avoided_here} (on the detection table)."
            )
        return tr(
            better,
            runs=count_runs(n_runs),
            avoided=found.runs_avoided,
            avoided_here=found.runs_avoided_here,
        )
    if found.is_proven:
        return tr(
            "If every run counted the same, no layout would be better than this one."
        )
    return tr(
        "No layout was found that would be better if every run counted the same. "
        "The search ran out of time, so one may exist."
    )


_OFF = {
    "yaw": (
        mark("turned {step:g} degree to the right"),
        mark("turned {step:g} degree to the left"),
    ),
    "pitch": (mark("tilted {step:g} degree down"), mark("tilted {step:g} degree up")),
    "height": (mark("5 cm too low"), mark("5 cm too high")),
}
"""How a unit is mounted wrongly, in less and in more of an angle or the height."""


def _mounting(found: Standing) -> str:
    aim = trn(
        "{deg:g} degree",
        "{deg:g} degrees",
        int(found.aim_deg != 1.0) + 1,
        deg=found.aim_deg,
    )
    if found.aim_deg and found.height_m:
        text = tr(
            "No run is lost if a unit is {aim} off its aim, or 5 cm too high or too "
            "low.",
            aim=aim,
        )
    elif found.aim_deg:
        text = tr(
            "No run is lost if a unit is {aim} off its aim, but a height error of 5 "
            "cm already loses one.",
            aim=aim,
        )
    elif found.height_m:
        text = tr(
            "Mount exactly: an aiming error of half a degree already loses a run; a "
            "height error of 5 cm loses none."
        )
    else:
        text = tr(
            "Mount exactly: an aiming error of half a degree or a height error of 5 "
            "cm already loses a run."
        )
    worst = found.worst
    if not worst.lost_run_ids:
        return text
    runs = count_runs(len(worst.lost_run_ids))
    apr = percent(worst.apr)
    less, more = _OFF[worst.kind]
    off = tr(more if worst.step > 0.0 else less, step=abs(worst.step))
    at_worst = mark(
        "In the worst case, an error of 1 degree or 5 cm loses {runs}: with "
        "{unit} {off}, the APR is {apr}."
    )
    at_worst = tr(at_worst, runs=runs, unit=worst.unit_id, off=off, apr=apr)
    return f"{text} {at_worst}"


def failure_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    """APR that remains if one unit, two, or a pole fail.

    `labels` are names by id.
    """
    whole = failures.none_failed
    n_units = len(failures.one_failed)
    if n_units == 1:
        return [
            tr(
                "There is only one unit; it prevents {apr}. If it fails, only what the "
                "car prevents by itself remains.",
                apr=percent(whole.apr),
            )
        ]
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
        # There is no such run.
        if math.isnan(least_s):
            return tr(
                "If any one unit fails, the others still avoid every run that all "
                "units avoid together."
            )
        return tr(
            "If any one unit fails, the others still avoid every run that all units "
            "avoid together. The smallest time to spare is then {time}.",
            time=milliseconds(least_s),
        )
    values = {
        "unit": _names(worst, labels),
        "apr": percent(worst.apr),
        "lost": _runs_lost(worst),
    }
    text = tr(
        "If {unit} fails, the others still prevent {apr}; {lost}. No other "
        "single failure is worse.",
        **values,
    )
    harmless = mark("{n} of the {n_units} units can fail alone without losing a run.")
    if n_harmless:
        return f"{text} {tr(harmless, n=n_harmless, n_units=n_units)}"
    return text


def _if_two_fail(failures: Failures, labels: Mapping[str, str]) -> str:
    n_units = len(failures.one_failed)
    pairs = failures.two_failed
    n_harmless = sum(not item.lost_run_ids for item in pairs)
    if not pairs:
        pairs_up_to = mark(
            "Failures of two units are analysed for layouts of up to {most} units; "
            "this layout has {n}."
        )
        return tr(pairs_up_to, most=MAX_PAIR_UNITS, n=n_units)
    if n_units == 2:
        return tr("If both fail, only the car itself is left.")
    if n_harmless == len(pairs):
        return tr("Any two units can fail at once without losing a run.")
    worst = tr(
        "If two units fail at once, {units} matter most: {apr} remain.",
        units=_names(pairs[0], labels),
        apr=percent(pairs[0].apr),
    )
    harmless = mark("Any two failures together lose runs.")
    if n_harmless:
        harmless = mark(
            "{n} of the {n_pairs} pairs of units can fail without losing a run."
        )
    return f"{worst} {tr(harmless, n=n_harmless, n_pairs=len(pairs))}"


def _if_a_pole_fails(failures: Failures, labels: Mapping[str, str]) -> str:
    worst = failures.site_failed[0]
    if all(len(item.unit_ids) == 1 for item in failures.site_failed):
        return tr(
            "No two units share a pole, so the failure of a pole affects only one unit."
        )
    if not worst.lost_run_ids:
        return tr(
            "A pole fails with all its units (power cut, crash). Any one pole can "
            "fail without losing a run."
        )
    values = {
        "units": _names(worst, labels),
        "apr": percent(worst.apr),
        "lost": _runs_lost(worst),
    }
    return tr(
        "A pole fails with all its units (power cut, crash). If the pole of "
        "{units} fails, {apr} remain and {lost}. No other pole failure is worse.",
        **values,
    )


class _FailureWords(NamedTuple):
    """What a table of failures says.

    `worst` is its caption where it has only the worst.
    """

    caption: str
    worst: str
    head: str


_FAILURES = {
    "unit": _FailureWords(
        caption=mark("If one unit fails"),
        worst=mark("{if_fails}: the {n} worst of {n_all} units"),
        head=mark("fails"),
    ),
    "pair": _FailureWords(
        caption=mark("If two units fail"),
        worst=mark("{if_fails}: the {n} worst of {n_all} pairs"),
        head=mark("fail"),
    ),
    "pole": _FailureWords(
        caption=mark("If one pole fails"),
        worst=mark("{if_fails}: the {n} worst of {n_all}"),
        head=mark("its units"),
    ),
}


def failure_table(
    failures: Sequence[Failure],
    labels: Mapping[str, str],
    *,
    of: Literal["unit", "pair", "pole"],
) -> Table:
    """A row per failure of a unit, of two, or of a pole, the worst first.

    At most ``MAX_ROWS``.
    """
    words = _FAILURES[of]
    caption = tr(words.caption)
    head = tr(words.head)
    if len(failures) > MAX_ROWS:
        caption = tr(words.worst, if_fails=caption, n=MAX_ROWS, n_all=len(failures))
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
    """What is left if a unit fails, or two, or a pole with all its units.

    There is no table of pairs where it says nothing new, or where pairs are not looked
    at. `labels` are short names of the units, by id.
    """
    failures = find_failures(evaluation, rule)
    tables = [failure_table(failures.one_failed, labels, of="unit")]
    if len(failures.two_failed) > 1:
        pairs = failure_table(failures.two_failed, labels, of="pair")
        tables.append(replace(pairs, summary=pairs.caption))
    if any(len(item.unit_ids) > 1 for item in failures.site_failed):
        tables.append(failure_table(failures.site_failed, labels, of="pole"))
    whose = tr(
        "Roadside units only, computed from what the evaluator detects with "
        "each. What the car detects by itself is additional."
    )
    if evaluation.cars == 1.0:
        whose = tr(
            "Computed from what the evaluator detects with each unit and with the "
            "car's own sensors, which never fail."
        )
    sentences = " ".join(failure_sentences(failures, labels))
    lost = tr(
        "A run is lost if all units together avoid it but the remaining units do "
        "not. The fastest runs are listed first."
    )
    note = f"{whose} {lost}"
    return Section(
        "failures", tr("If a unit or a pole fails"), [sentences, *tables, note]
    )


def _names(failure: Failure, labels: Mapping[str, str]) -> str:
    return tr(" and ").join(
        labels.get(unit_id, unit_id) for unit_id in failure.unit_ids
    )


def _runs_lost(failure: Failure) -> str:
    return trn("{n} run is lost", "{n} runs are lost", len(failure.lost_run_ids))
