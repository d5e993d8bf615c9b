"""What a result says, in plain sentences; every number in them comes from the result."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from geometry.arrays import BoolArray
from geometry.catalogue import sensor_kind
from placement.evaluation import Evaluation, Verdict, apr
from placement.layout import Layout
from placement.setting import Links, Setting
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

from ..results.numbers import count_runs, joined, number, percent, several

STAGES = {
    "apr": "APR",
    "apr_one_failed": "APR if the most needed unit fails",
    "smallest_margin_s": "smallest time to spare",
    "mean_margin_s": "mean time to spare",
    "cost_eur": "cost",
    "units": "units",
    "apr_survived": "APR if the most needed units fail",
    "weighted": "weighted sum",
}
"""Names of the optimiser's objectives."""


def title(
    summary: Mapping[str, Any], setting: Setting, evaluations: Mapping[str, Evaluation]
) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    place = setting.scene.name
    if "stages" in summary:
        subject = next(iter(evaluations.values()))
        return f"Where to mount {count_sensors(subject.layout)} at {place}"
    if len(evaluations) > 1:
        return f"Roadside sensors at {place}: {' and '.join(evaluations)} compared"
    return f"Roadside sensors at {place}: {next(iter(evaluations))}"


def answer(summary: Mapping[str, Any], shown: Mapping[str, Evaluation]) -> list[str]:
    """The headline, in sentences.

    Parameters
    ----------
    summary : mapping
        As :mod:`experiments.results.summary` builds it.
    shown : mapping of str to Evaluation
        By display name; the first one is the subject.
    """
    (subject_name, subject), *others = shown.items()
    score = _score(_together(subject, summary), subject)
    car = f"the car by itself avoids {_score(subject.vut, subject)}"
    scores = [
        f"{name} ({count_sensors(item.layout)}) avoids {_score(item.rsu_all, item)}"
        for name, item in others
    ]
    left = summary.get("evaluation", {}).get("apr_without_worst_unit")
    failed = [] if left is None else [_one_failed(left, subject)]
    if "stages" in summary:
        verb = "avoids" if len(subject.units) == 1 else "avoid"
        how = ", each by itself," if summary.get("fusion") == "single" else ""
        sentences = [
            f"{count_sensors(subject.layout)}{how} {verb} {score}; {car}",
            _proof_in_short(summary),
            "; ".join([*failed, *scores]),
        ]
    else:
        sentences = [
            f"{subject_name} ({count_sensors(subject.layout)}) avoids {score}; {car}",
            "; ".join(scores),
            *_differences(subject_name, subject, others),
            *failed,
        ]
    return [f"{sentence}." for sentence in sentences if sentence]


def _proof_in_short(summary: Mapping[str, Any]) -> str:
    n_candidates = summary.get("candidates")
    among = f"{n_candidates} candidate poses" if n_candidates else "the candidate poses"
    stage = next((one for one in summary["stages"] if one["name"] == "apr"), summary["stages"][0])
    if stage["name"] != "apr":
        proof = "proven" if stage["gap"] == 0.0 else f"bound {stage['bound']:.4g}"
        return f"Chosen among {among} by a weighted sum: {stage['objective']:.4g}, {proof}"
    first = summary["stages"][0]
    within = ""
    if first["name"] in ("units", "cost_eur"):
        what = "units" if first["name"] == "units" else "EUR"
        least = (
            "the least"
            if first["gap"] == 0.0
            else f"no choice needs less than {first['bound']:,.0f}"
        )
        within = f" With {first['objective']:,.0f} {what} for what was asked, {least}:"
    if stage["gap"] == 0.0:
        text = f"no choice among {among} has a higher APR"
        return f"Proven on the detection table:{within} {text}"
    return (
        f"The best choice among {among} found in the time given:{within} on the detection table, "
        f"no other can exceed an APR of {percent(stage['bound'])}"
    )


def proof(summary: Mapping[str, Any]) -> str:
    """Whether every objective is proven; empty where nothing was optimised."""
    if "stages" not in summary:
        return ""
    is_open = [STAGES.get(s["name"], s["name"]) for s in summary["stages"] if s["gap"] != 0.0]
    if not is_open:
        return "Yes: every objective's gap is closed."
    return f"Not in full: proven are all objectives but {', '.join(is_open)}."


def _one_failed(left: float, subject: Evaluation) -> str:
    if len(subject.units) == 1:
        return "If this one unit fails, only the car itself is left"
    reach = "still avoid every run" if left > 1.0 - 1.0e-9 else f"reach at least {percent(left)}"
    return f"If any one unit fails, the others {reach}"


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


def disagreement(summary: Mapping[str, Any]) -> str | None:
    """How far detection table and evaluator differ, or None where there is no table."""
    share = summary.get("surrogate_disagreement")
    if share is None:
        return None
    return (
        "The layout was chosen on a detection table, which looks at sample points on the road "
        "user's surface. The evaluator renders every image instead. "
        + (
            "For this layout both say the same of every run."
            if share == 0.0
            else f"They disagree on {percent(share)} of the runs whether this layout avoids it."
        )
    )


def assumptions(
    summary: Mapping[str, Any], setting: Setting, layouts: Mapping[str, Layout]
) -> list[tuple[str, str]]:
    """What the numbers rest on: pairs of term and text.

    Parameters
    ----------
    summary : mapping
        As :mod:`experiments.results.summary` builds it.
    setting : Setting
        What was evaluated in.
    layouts : mapping of str to Layout
        By display name.
    """
    rule, axis = setting.rule, setting.axis
    frame_s = 1.0 / rule.frame_rate_hz
    terms = [
        (
            "Runs",
            f"{axis.n_runs} runs, {axis.n_frames} frames at {rule.frame_rate_hz:g} Hz. Every run "
            f"ends in an impact unless the car brakes. One frame falls on the "
            "moment of the impact.",
        ),
        ("Weights", _weights(setting)),
        (
            "Detection",
            f"{setting.detector.description} The car itself looks with: "
            f"{' and '.join(setting.vut_sensors)}.",
        ),
        (
            "Confirmation",
            f"{rule.n_confirmations} detected frames in a row, {frame_s:g} s apart.",
        ),
        ("Latency", _latency(rule, layouts)),
        (
            "Braking",
            f"{rule.deceleration_mps2:g} m/s\N{SUPERSCRIPT TWO}, {_onset(rule.build_up_s)}, along "
            "the car's path. The road user keeps going.",
        ),
        ("Avoided", "The outlines of car and road user on the road never touch."),
        ("Weather", _weather(setting)),
    ]
    if setting.links != Links():
        terms.append(("Radio", _radio(setting.links)))
    if "fusion" in summary:
        terms.append(("Units together", _FUSIONS.get(summary["fusion"], summary["fusion"])))
    if summary.get("budget") is not None:
        terms.append(("Budget", several(summary["budget"], "unit", "units") + "."))
    return terms


def latency_in_short(rule: AebRule, layouts: Sequence[Layout]) -> str:
    """How long after a confirmation braking sets in.

    Examples
    --------
    "25 ms"; with units of their own latency: "25 ms to 120 ms, by the unit's own latency,".
    """
    own_s = sorted(
        {rule.latency_s, *(unit.latency(rule) for layout in layouts for unit in layout.units)}
    )
    if len(own_s) == 1:
        return f"{1000.0 * own_s[0]:g} ms"
    low_ms, high_ms = 1000.0 * own_s[0], 1000.0 * own_s[-1]
    return f"{low_ms:g} ms to {high_ms:g} ms, by the unit's own latency,"


def _latency(rule: AebRule, layouts: Mapping[str, Layout]) -> str:
    """The rule's latency, then the units that have another of their own, equal ones together."""
    own = []
    for name, layout in layouts.items():
        unit_ids: dict[float, list[str]] = {}
        for unit in layout.units:
            if unit.latency(rule) != rule.latency_s:
                unit_ids.setdefault(unit.latency(rule), []).append(unit.id)
        of = f" of {name}" if len(layouts) > 1 else ""
        own += [
            f"{_all_or(ids, len(layout.units))}{of} {1000.0 * latency_s:g} ms"
            for latency_s, ids in sorted(unit_ids.items())
        ]
    text = f"{1000.0 * rule.latency_s:g} ms for processing and communication"
    return f"{text}; units with a latency of their own: {'; '.join(own)}." if own else f"{text}."


def _all_or(unit_ids: Sequence[str], n_units: int) -> str:
    return "every unit" if len(unit_ids) == n_units > 1 else joined(unit_ids)


def _onset(build_up_s: float) -> str:
    if build_up_s == 0.0:
        return "constant from the onset"
    return f"reached linearly {build_up_s:g} s after the onset"


def is_weighted(axis: FrameAxis) -> bool:
    """Whether some runs count more than others."""
    return not np.allclose(axis.weight, axis.weight[0], rtol=1.0e-9, atol=0.0)


def _weights(setting: Setting) -> str:
    axis = setting.axis
    if not is_weighted(axis):
        return "Every run counts the same."
    counted = axis.weight[axis.weight > 0.0]
    low, high = (percent(float(share)) for share in (counted.min(), counted.max()))
    text = f"Runs count differently: from {low} to {high} of the whole each."
    n_without = axis.n_runs - len(counted)
    if n_without:
        text += f" {count_runs(n_without)} of weight 0 {_verb(n_without)} driven, but not counted."
    return text


def _weather(setting: Setting) -> str:
    weathers = list(dict.fromkeys(run.weather for run in setting.runs))
    text = f"{', '.join(weathers)}."
    if weathers == ["day"]:
        return text
    return f"{text} It takes contrast from cameras and pulses from LiDARs."


def _radio(links: Links) -> str:
    lost = f"{percent(links.packet_loss)} of all messages are lost, frame by frame."
    if links.vam_rate == 0.0:
        return lost
    return (
        f"{lost} {percent(links.vam_rate)} of the road users announce themselves (VRU awareness "
        "messages), and the car trusts the position that they send."
    )


_FUSIONS = {
    "any": "A frame counts if any unit detects the road user in it.",
    "single": "One unit must confirm the road user by itself.",
}


def describe_hopeless(setting: Setting) -> list[str]:
    """Which cases have runs that no braking avoids, in sentences."""
    sentences = []
    for name, indices in runs_by_case(setting).items():
        n_runs = sum(not math.isfinite(setting.runs[index].last_brake_time_s) for index in indices)
        if n_runs:
            sentences.append(f"In {count_runs(n_runs)} of {name} no braking avoids the impact.")
    return sentences


def describe_refusals(setting: Setting) -> list[str]:
    """What was asked for and cannot be driven, in sentences; approaches share one with a reason."""
    approaches: dict[tuple[str, tuple[float, ...], str], list[str]] = {}
    for refusal in setting.refusals:
        key = (refusal.case.name, refusal.speeds_kmh, refusal.reason)
        approaches.setdefault(key, []).append(refusal.approach)
    return [
        f"{case} from the {joined(arms)} at {', '.join(f'{speed:g}' for speed in speeds)} km/h: "
        f"{reason.removesuffix('.')}."
        for (case, speeds, reason), arms in approaches.items()
    ]


def runs_by_case(setting: Setting) -> dict[str, list[int]]:
    """Indices of the runs of each case, in the order in which the cases first appear."""
    indices: dict[str, list[int]] = {}
    for index, run in enumerate(setting.runs):
        indices.setdefault(run.case.name, []).append(index)
    return indices


def _verb(count: int) -> str:
    return "is" if count == 1 else "are"


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


def _together(evaluation: Evaluation, summary: Mapping[str, Any]) -> Verdict:
    """All units together, as the layout was optimised."""
    if summary.get("fusion") != "single":
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


def outcome(is_avoided: bool, margin_s: float) -> str:
    """How a run ends, with the time to spare or the time by which braking comes too late."""
    if is_avoided:
        return f"avoided, {number(margin_s)} s"
    return f"HIT, {number(-margin_s)} s late" if math.isfinite(margin_s) else "HIT, not confirmed"
