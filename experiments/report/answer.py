"""The answer: what a result says in a few sentences, its proof, and how far two models agree."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import UNSET

from geometry.arrays import BoolArray
from geometry.catalogue import sensor_kind
from placement.evaluation import Evaluation, Verdict, apr
from placement.layout import Layout
from placement.optimiser.objectives import Objective
from placement.setting import Setting
from scenarios.runs import FrameAxis

from ..results.numbers import NOTHING, number, or_nan, percent, several
from ..results.record import StageRecord
from ..results.result import Result
from .private_ground import private_ground_sentences
from .refinement import refinement_sentences
from .sampled_worlds import uncertainty_sentences
from .section import Block, Section, Table


def title(result: Result, setting: Setting, evaluations: Mapping[str, Evaluation]) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    place = setting.scene.name
    if result.stages:
        subject = next(iter(evaluations.values()))
        return f"Where to mount {count_sensors(subject.layout)} at {place}"
    if len(evaluations) > 1:
        return f"Roadside sensors at {place}: {' and '.join(evaluations)} compared"
    return f"Roadside sensors at {place}: {next(iter(evaluations))}"


def answer(result: Result, shown: Mapping[str, Evaluation]) -> list[str]:
    """The headline, in sentences; evaluations by display name, the first one is the subject."""
    (subject_name, subject), *others = shown.items()
    score = _score(_together(subject, result.fusion), subject)
    car = f"the car by itself avoids {_score(subject.vut, subject)}"
    scores = [
        f"{name} ({count_sensors(item.layout)}) avoids {_score(item.rsu_all, item)}"
        for name, item in others
    ]
    left = result.evaluation.apr_without_worst_unit
    failed = [] if left is None else [_one_failed(left, subject)]
    if result.evaluation.apr_without_worst_site is not UNSET:
        left = result.evaluation.apr_without_worst_site
        failed.append(
            f"if any one pole fails with all that hangs on it, {_reach(left, 'the others')}"
        )
    if result.stages:
        verb = "avoids" if len(subject.units) == 1 else "avoid"
        how = ", each by itself," if result.fusion == "single" else ""
        sentences = [
            f"{count_sensors(subject.layout)}{how} {verb} {score}; {car}",
            _proof_in_short(result.stages, result.candidates or 0),
            "; ".join([*failed, *scores]),
        ]
    else:
        sentences = [
            f"{subject_name} ({count_sensors(subject.layout)}) avoids {score}; {car}",
            "; ".join(scores),
            *_differences(subject_name, subject, others),
            *failed,
        ]
    return [
        *result.driven[:1],
        *(f"{sentence}." for sentence in sentences if sentence),
        *private_ground_sentences(result),
        *(refinement_sentences(result.refinement) if result.refinement else []),
        *(uncertainty_sentences(result.sampled) if result.sampled else []),
    ]


def _proof_in_short(stages: Sequence[StageRecord], n_candidates: int) -> str:
    among = f"{n_candidates} candidate poses" if n_candidates else "the candidate poses"
    first = stages[0]
    of_apr = next(stage for stage in stages if stage.name == "apr")
    within = ""
    if first.name in ("units", "cost_eur"):
        what = "units" if first.name == "units" else "EUR"
        least = (
            "the least"
            if first.gap == 0.0
            else f"no choice needs less than {or_nan(first.bound):,.0f}"
        )
        within = f" With {first.objective:,.0f} {what} for what was asked, {least}:"
    if of_apr.gap == 0.0:
        return f"Proven on the detection table:{within} no choice among {among} has a higher APR"
    return (
        f"The best choice among {among} found in the time given:{within} on the detection table, "
        f"no other can exceed an APR of {percent(of_apr.bound)}"
    )


def _one_failed(left: float, subject: Evaluation) -> str:
    if len(subject.units) == 1:
        return "If this one unit fails, only the car itself is left"
    return f"If any one unit fails, {_reach(left, 'the others')}"


def _reach(left: float, who: str) -> str:
    if left > 1.0 - 1.0e-9:
        return f"{who} still avoid every run"
    return f"{who} reach at least {percent(left)}"


def _differences(
    name: str, ours: Evaluation, others: Sequence[tuple[str, Evaluation]]
) -> list[str]:
    """The first layout against each of the others; those that are alike in one sentence."""
    alike, sentences = [name], []
    for other_name, theirs in others:
        gained = int((ours.rsu_all.is_avoided & ~theirs.rsu_all.is_avoided).sum())
        lost = int((theirs.rsu_all.is_avoided & ~ours.rsu_all.is_avoided).sum())
        if not gained and not lost:
            alike.append(other_name)
            continue
        sentences.append(
            f"{name} avoids {gained} that {other_name} does not, "
            f"and {other_name} avoids {lost} that {name} does not"
        )
    if len(alike) > 1:
        names = f"{', '.join(alike[:-1])} and {alike[-1]}"
        sentences.append(f"{names} avoid the same runs")
    return sentences


def is_weighted(axis: FrameAxis) -> bool:
    """Whether some runs count more than others."""
    return not np.allclose(axis.weight, axis.weight[0], rtol=1.0e-9, atol=0.0)


def count_sensors(layout: Layout) -> str:
    """'1 camera', '2 cameras and 1 LiDAR' and so on."""
    kinds = [sensor_kind(unit.sensor) for unit in layout.units]
    return " and ".join(
        several(kinds.count(kind), one, many)
        for kind, one, many in (("camera", "camera", "cameras"), ("lidar", "LiDAR", "LiDARs"))
        if kind in kinds
    )


def _score(verdict: Verdict, evaluation: Evaluation) -> str:
    by_weight = " by weight" if is_weighted(evaluation.axis) else ""
    return (
        f"{int(verdict.is_avoided.sum())} of {evaluation.axis.n_runs} runs "
        f"(APR{by_weight} {percent(apr(verdict, evaluation.axis))})"
    )


def _together(evaluation: Evaluation, fusion: str) -> Verdict:
    """All units together, as the layout was optimised."""
    if fusion != "single":
        return evaluation.rsu_all
    any_alone: BoolArray = np.any([unit.is_avoided for unit in evaluation.units.values()], axis=0)
    return Verdict(
        detected=evaluation.rsu_all.detected,
        confirmation_time_s=np.min(
            [unit.confirmation_time_s for unit in evaluation.units.values()], axis=0
        ),
        onset_time_s=np.min([unit.onset_time_s for unit in evaluation.units.values()], axis=0),
        is_avoided=any_alone,
    )


# ---------- how good it is, and whether that is proven


def proof_section(result: Result) -> Section | None:
    """The optimiser's objectives with their proof; None where nothing was optimised."""
    if not result.stages:
        return None
    is_open = [Objective(stage.name).label for stage in result.stages if stage.gap != 0.0]
    proof = "Yes: every objective's gap is closed."
    if is_open:
        proof = f"Not in full: proven are all objectives but {', '.join(is_open)}."
    table = Table(
        caption="Objectives in order: each is optimised without giving up any before it",
        columns=["objective", "this layout", "no layout can exceed", "gap", "time (s)"],
        rows=[_stage_row(stage) for stage in result.stages],
        numeric=range(1, 5),
    )
    note = (
        f"Solver: {result.solver or NOTHING}. The proof holds for the detection table: for the "
        "candidate poses that were tried, on the runs listed below. A gap of 0 % means that no "
        "other choice among them is better."
    )
    return Section("proof", "How good is it, and is that proven?", [proof, table, note])


def _stage_row(stage: StageRecord) -> list[str]:
    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        if stage.name in ("units", "cost_eur"):
            return number(value, 2)
        return f"{number(value, 3)} s" if stage.name.endswith("_s") else percent(value)

    gap = stage.gap
    return [
        Objective(stage.name).label,
        shown(stage.objective),
        shown(stage.bound),
        NOTHING if gap is None or not math.isfinite(gap) else percent(gap),
        number(stage.seconds, 1),
    ]


def models_section(result: Result) -> Section | None:
    """How far detection table and evaluator differ; None where there is no table."""
    share = result.surrogate_disagreement
    if share is None:
        return None
    text = (
        "The layout was chosen on a detection table, which looks at sample points on the road "
        "user's surface. The evaluator renders every image instead. "
    )
    text += (
        "For this layout both say the same of every run."
        if share == 0.0
        else f"They disagree on {percent(share)} of the runs whether this layout avoids it."
    )
    runs: Block = "Nor do they differ on any run for any unit by itself."
    if result.disagreements:
        runs = Table(
            caption="Runs that only one of them calls avoided, for each unit by itself and for all "
            "fused",
            columns=[
                "run",
                "unit",
                "avoided by the",
                "frames that differ",
                "what the evaluator sees in the first of them",
            ],
            rows=[
                [
                    entry.run_id,
                    entry.party,
                    "table" if entry.on_table else "evaluator",
                    entry.n_frames,
                    entry.cause,
                ]
                for entry in result.disagreements
            ],
            numeric=[3],
        )
    return Section("models", "Do the two models agree?", [text, runs])
