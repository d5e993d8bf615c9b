"""The answer: what a result says in a few sentences, its proof, and how far two models agree."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from msgspec import UNSET

from geometry.arrays import BoolArray
from geometry.catalogue import sensor_kind
from geometry.whereabouts import street_names
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.optimiser.objectives import Objective
from placement.setting import Setting
from scenarios.positions import AT_ZERO, read_position
from scenarios.runs import FrameAxis
from scenarios.weights import weight_share

from ..parts.private_ground import private_ground_sentences
from ..parts.refinement import refinement_sentences
from ..parts.sampled_worlds import overtaken_sentences, uncertainty_sentences
from ..parts.section import Block, Section, Table
from ..results.dangers import DangerGroupRecord, DangersRecord, avoided_runs
from ..results.numbers import NOTHING, count_runs, joined, number, or_nan, percent, several
from ..results.record import StageRecord
from ..results.result import Result
from .alternatives import doubt_sentences, recommended_sentences
from .next_unit import next_unit_sentence


def title(result: Result, setting: Setting, evaluations: Mapping[str, Evaluation]) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    named = " / ".join(street_names(setting.scene).values())
    streets = dict.fromkeys(filter(None, named.split(" / ")))
    place = " / ".join(streets) or setting.scene.name
    if result.stages:
        subject = next(iter(evaluations.values()))
        return f"Where to mount {count_sensors(subject.layout)} at {place}"
    if len(evaluations) > 1:
        return f"Roadside sensors at {place}: {' and '.join(evaluations)} compared"
    return f"Roadside sensors at {place}: {next(iter(evaluations))}"


def answer(result: Result, shown: Mapping[str, Evaluation]) -> list[str]:
    """The headline, in sentences; evaluations by display name, the first one is the subject."""
    (subject_name, subject), *others = shown.items()
    score = _score(avoided_runs(subject, result.fusion), subject)
    car = f"the car by itself avoids {_score(subject.vut.is_avoided, subject)}"
    scores = [
        f"{name} ({count_sensors(item.layout)}) avoids {_score(item.rsu_all.is_avoided, item)}"
        for name, item in others
    ]
    left = result.evaluation.apr_without_worst_unit
    failed = [] if left is None else [_one_failed(left, subject)]
    if result.evaluation.apr_without_worst_site is not UNSET:
        left = result.evaluation.apr_without_worst_site
        failed.append(
            f"If any one pole fails with all that hangs on it, {_reach(left, 'the others')}"
        )
    if result.stages:
        verb = "avoids" if len(subject.units) == 1 else "avoid"
        how = ", each by itself," if result.fusion == "single" else ""
        sentences = [
            f"{count_sensors(subject.layout)}{how} {verb} {score}; "
            + "; ".join([car, *scores, *_baselines(result)]),
            ". ".join(
                part
                for part in (
                    next_unit_sentence(result),
                    _proof_in_short(result.stages, result.candidates or 0),
                    *failed,
                )
                if part
            ),
        ]
    else:
        sentences = [
            f"{subject_name} ({count_sensors(subject.layout)}) avoids {score}; {car}",
            "; ".join([*scores, *_baselines(result)]),
            *_differences(subject_name, subject, others),
            *failed,
        ]
    return [
        *result.driven[:1],
        *result.without_effect,
        *danger_sentences(result),
        *recommended_sentences(result),
        *(overtaken_sentences(result.sampled) if result.sampled else []),
        *(f"{sentence}." for sentence in sentences if sentence),
        *doubt_sentences(result),
        *private_ground_sentences(result),
        *(refinement_sentences(result.refinement) if result.refinement else []),
        *(uncertainty_sentences(result.sampled) if result.sampled else []),
    ]


_MAX_GROUPS = 3


def danger_sentences(result: Result) -> list[str]:
    """How many runs are not avoided, and which: what an answer begins with."""
    if not result.dangers:
        return []
    dangers = result.dangers
    if not dangers.not_avoided:
        return [f"No run is left: all {result.runs} are avoided."]
    are = "is" if dangers.not_avoided == 1 else "are"
    return [
        f"{dangers.not_avoided} of {count_runs(result.runs)} {are} not avoided: "
        f"{_most_left(dangers.by_case, 'in {}'.format, 'in other cases')}{_at_positions(dangers)}."
    ]


def _at_positions(dangers: DangersRecord) -> str:
    """Where along the arms most are left; nothing where there is but one place."""
    if not dangers.by_position:
        return ""
    return f". By place: {_most_left(dangers.by_position, position_words, 'elsewhere')}"


def position_words(name: str) -> str:
    """A position along the arms in words: "15 m before the junction" and the like."""
    position = read_position(name, "position")
    if position == AT_ZERO:
        return "at the junction"
    if position.distance_m == 0.0:
        return "at the crosswalk ahead"
    side = "beyond the crosswalk ahead" if position.is_behind else "before the junction"
    return f"{position.distance_m:g} m {side}"


def _most_left(
    groups: Sequence[DangerGroupRecord], words_of: Callable[[str], str], others: str
) -> str:
    """The groups with the largest share that is left, and how many are left in all others."""
    left = [group for group in groups if group.not_avoided]
    words = [
        f"{words_of(group.name)} {group.not_avoided} of {group.runs}"
        for group in left[:_MAX_GROUPS]
    ]
    n_others = sum(group.not_avoided for group in left[_MAX_GROUPS:])
    return joined([*words, *([f"{others} {n_others}"] if n_others else [])])


def _baselines(result: Result) -> list[str]:
    """What an expert's rule and random layouts prevent, in short."""
    if not result.baselines:
        return []
    clauses = []
    expert, random = result.baselines.expert, result.baselines.random
    if expert is not None:
        clauses.append(
            f"an expert's rule ({several(len(expert.layout), 'unit', 'units')} at corners, "
            f"looking at the middle) {percent(expert.score.all)}"
        )
    if random is not None:
        clauses.append(
            f"random layouts {percent(random.mean)} on average (of {random.layouts}, on the "
            "detection table)"
        )
    return clauses


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


def _score(is_avoided: BoolArray, evaluation: Evaluation) -> str:
    axis = evaluation.axis
    by_weight = " by weight" if is_weighted(axis) else ""
    share = percent(weight_share(is_avoided, axis.weight))
    return f"{int(is_avoided.sum())} of {axis.n_runs} runs (APR{by_weight} {share})"


# ---------- how good it is, and whether that is proven


def proof_section(result: Result) -> Section | None:
    """The optimiser's objectives with their proof; None where nothing was optimised."""
    if not result.stages:
        return None
    is_open = [_label(stage.name, result) for stage in result.stages if stage.gap != 0.0]
    proof = "Yes: every objective's gap is closed."
    if is_open:
        proof = f"Not in full: proven are all objectives but {', '.join(is_open)}."
    table = Table(
        caption="Objectives in order: each is optimised without giving up any before it",
        columns=["objective", "this layout", "no layout can exceed", "gap", "time (s)"],
        rows=[[_label(stage.name, result), *_stage_row(stage)] for stage in result.stages],
        numeric=range(1, 5),
    )
    note = (
        f"Solver: {result.solver or NOTHING}. The proof holds for the detection table: for the "
        "candidate poses that were tried, on the runs listed below. A gap of 0 % means that no "
        "other choice among them is better."
    )
    return Section("proof", "How good is it, and is that proven?", [proof, table, note])


def _label(name: str, result: Result) -> str:
    """Name of an objective; what fails is a pole where that was asked."""
    label = Objective(name).label
    return label if result.failing is UNSET else label.replace(" unit", " pole")


def _stage_row(stage: StageRecord) -> list[str]:
    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        if stage.name in ("units", "cost_eur"):
            return number(value, 2)
        return f"{number(value, 3)} s" if stage.name.endswith("_s") else percent(value)

    gap = stage.gap
    return [
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
