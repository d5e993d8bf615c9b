"""What a result says, in plain sentences; every number in them comes from the result."""

import math
from collections.abc import Mapping, Sequence, Sized
from typing import Any

import numpy as np

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation, Verdict, apr
from placement.setting import Setting

from .figures import percent

NOTHING = "\N{EN DASH}"
STAGES = {
    "apr": "APR",
    "apr_one_failed": "APR if the most needed camera fails",
    "smallest_margin_s": "smallest time to spare",
    "mean_margin_s": "mean time to spare",
}
"""Names of the optimiser's objectives."""


def title(
    summary: Mapping[str, Any], setting: Setting, evaluations: Mapping[str, Evaluation]
) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    place = setting.scene.name
    if "stages" in summary:
        subject = next(iter(evaluations.values()))
        return f"Where to mount {count_cameras(subject.units)} at {place}"
    if len(evaluations) > 1:
        return f"Roadside cameras at {place}: {' and '.join(evaluations)} compared"
    return f"Roadside cameras at {place}: {next(iter(evaluations))}"


def answer(summary: Mapping[str, Any], shown: Mapping[str, Evaluation]) -> list[str]:
    """The headline, in sentences.

    Parameters
    ----------
    summary : mapping
        As :mod:`experiments.summary` builds it.
    shown : mapping of str to Evaluation
        By display name; the first one is the subject.
    """
    is_placement = "stages" in summary
    (subject_name, subject), *others = shown.items()
    score = _score(_together(subject, summary), subject)
    if is_placement:
        verb = "avoids" if len(subject.units) == 1 else "avoid"
        how = ", each by itself," if summary.get("fusion") == "single" else ""
        sentences = [
            f"{count_cameras(subject.units)}{how} {verb} {score}",
            _proof_in_short(summary),
        ]
    else:
        sentences = [f"{subject_name} ({count_cameras(subject.units)}) avoids {score}"]
    sentences += [
        f"{name} ({count_cameras(item.units)}) avoids {_score(item.rsu_all, item)}"
        for name, item in others
    ]
    if not is_placement:
        sentences += [_difference(subject_name, subject, name, item) for name, item in others]
    sentences.append(f"The car's own camera alone avoids {_score(subject.vut, subject)}")
    left = summary.get("evaluation", {}).get("apr_without_worst_unit")
    if left is not None:
        sentences.append(_one_failed(left, subject))
    return [f"{sentence}." for sentence in sentences]


def _proof_in_short(summary: Mapping[str, Any]) -> str:
    gap, bound = summary["stages"][0]["gap"], summary["stages"][0]["bound"]
    n_candidates = summary.get("candidates")
    among = f"{n_candidates} candidate poses" if n_candidates else "the candidate poses"
    if gap == 0.0:
        return f"Proven on the detection table: no choice among {among} has a higher APR"
    return (
        f"The best choice among {among} found in the time given: on the detection table, no other "
        f"can exceed an APR of {percent(bound)}"
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
        return "If this one camera fails, only the car's own is left"
    return f"If any one camera fails, the others still reach an APR of {percent(left)} or more"


def _difference(name: str, ours: Evaluation, other_name: str, theirs: Evaluation) -> str:
    gained = int((ours.rsu_all.is_avoided & ~theirs.rsu_all.is_avoided).sum())
    lost = int((theirs.rsu_all.is_avoided & ~ours.rsu_all.is_avoided).sum())
    if not gained and not lost:
        return f"{name} and {other_name} avoid the same runs"
    return (
        f"{name} avoids {gained} that {other_name} does not, "
        f"and {other_name} avoids {lost} that {name} does not"
    )


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


def assumptions(summary: Mapping[str, Any], setting: Setting) -> list[tuple[str, str]]:
    """What the numbers rest on: pairs of term and text."""
    rule, detector, axis = setting.rule, setting.detector, setting.axis
    frame_s = 1.0 / rule.frame_rate_hz
    terms = [
        (
            "Runs",
            f"{axis.n_runs} runs, {axis.n_frames} frames at {rule.frame_rate_hz:g} Hz. Every run "
            "ends in an impact unless the car brakes.",
        ),
        (
            "Detection",
            f"A road user counts as detected in a frame if the box around its visible part "
            f"overlaps the box around all of it by more than {detector.min_iou:g} (intersection "
            f"over union) and is at least {detector.min_box_height_px:g} pixels high.",
        ),
        (
            "Confirmation",
            f"{rule.n_confirmations} detected frames in a row, {frame_s:g} s apart.",
        ),
        ("Latency", f"{1000.0 * rule.latency_s:g} ms for processing and communication."),
        (
            "Braking",
            f"{rule.deceleration_mps2:g} m/s\N{SUPERSCRIPT TWO}, {_onset(rule.build_up_s)}, along "
            "the car's path. The road user keeps going.",
        ),
        ("Avoided", "The outlines of car and road user on the road never touch."),
        *_weather_terms(setting),
    ]
    if "fusion" in summary:
        terms.append(("Cameras together", _FUSIONS.get(summary["fusion"], summary["fusion"])))
    if "budget" in summary:
        terms.append(("Budget", count_cameras(range(summary["budget"])) + "."))
    return terms


def _onset(build_up_s: float) -> str:
    if build_up_s == 0.0:
        return "constant from the onset"
    return f"reached linearly {build_up_s:g} s after the onset"


def _weather_terms(setting: Setting) -> list[tuple[str, str]]:
    weathers = list(dict.fromkeys(run.weather for run in setting.runs))
    if weathers == ["day"]:
        return []
    return [
        (
            "Weather",
            f"{', '.join(weathers)}. It does not change what is detected: the detector looks at "
            "boxes only.",
        )
    ]


_FUSIONS = {
    "any": "A frame counts if any camera detects the road user in it.",
    "single": "One camera must confirm the road user by itself.",
}


def describe_cases(setting: Setting) -> list[dict[str, str]]:
    """The cases that are driven: what, how fast, from where, how late braking may begin."""
    described = []
    for name in dict.fromkeys(run.case.name for run in setting.runs):
        runs = [run for run in setting.runs if run.case.name == name]
        case = runs[0].case
        last = sorted(-run.last_brake_time_s for run in runs if np.isfinite(run.last_brake_time_s))
        described.append(
            {
                "name": name,
                "title": case.title,
                "speeds": _span(sorted({run.vut_speed_kmh for run in runs})),
                "vru": case.vru.class_name,
                "vru_speed": f"{case.vru_speed_kmh:g}",
                "approaches": ", ".join(dict.fromkeys(run.approach for run in runs)),
                "n_runs": str(len(runs)),
                "last_moments": _span([round(time_s, 2) for time_s in last]) if last else NOTHING,
            }
        )
    return described


def describe_refusals(setting: Setting) -> list[str]:
    """What was asked for and cannot be driven, in sentences."""
    return [
        f"{refusal.case.name} from the {refusal.approach} at "
        f"{', '.join(f'{speed:g}' for speed in refusal.speeds_kmh)} km/h: {refusal.reason}."
        for refusal in setting.refusals
    ]


def _span(values: Sequence[float]) -> str:
    low, high = f"{values[0]:g}", f"{values[-1]:g}"
    return low if low == high else f"{low} to {high}"


def count_cameras(units: Sized) -> str:
    """'1 camera', '2 cameras' and so on."""
    n_units = len(units)
    return "1 camera" if n_units == 1 else f"{n_units} cameras"


def _score(verdict: Verdict, evaluation: Evaluation) -> str:
    return (
        f"{int(verdict.is_avoided.sum())} of {evaluation.axis.n_runs} runs "
        f"(APR {percent(apr(verdict, evaluation.axis))})"
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
        is_avoided=any_alone,
    )


def number(value: float | None, digits: int = 2) -> str:
    """A number with a typographic minus; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return NOTHING
    # Adding zero turns -0.0 into 0.0.
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
