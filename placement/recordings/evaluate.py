"""Evaluation of recorded detections: match them with labels, confirm, and brake in time."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray
from geometry.errors import InputError
from geometry.image_boxes import iou
from scenarios.aeb import AebRule, braking_distance_m
from scenarios.runs import FrameAxis, find_onsets

from ..detection_table import DetectionTable, pack_table
from ..detectors import load_min_iou
from ..evaluation import Verdict, earliest_arrival_s
from .files import Detection, Label, RecordingFormat, load_format
from .read import Drive, Recording

RECORDED = "recorded"
"""Approach and weather of every drive: a recording does not contain them."""

_FINDS = {"pedestrian": ("pedestrian",), "bicycle": ("bicycle", "pedestrian")}
"""By class of VRU, which detections may match its label: a detector may find the rider."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedEvaluation:
    """Verdicts of the units of a recording."""

    axis: FrameAxis  # A run per drive, all of equal weight
    vut: Verdict | None  # the VUT's own camera alone; None where it is not recorded
    units: Mapping[str, Verdict]  # each roadside unit alone, by the name of its folder
    rsu_all: Verdict  # all of them fused: in each frame any of them may be the detector
    vut_and_rsus: (
        Verdict | None
    )  # the same with the VUT's camera; None where that is not recorded
    # frames of a roadside unit with several VRUs of the drive's class in view: it is
    # not known which one the VUT is about to hit, so that they count only if each of
    # them is detected
    n_ambiguous: int


def evaluate_recording(
    recording: Recording, rule: AebRule, *, min_confidence: float = 0.0
) -> RecordedEvaluation:
    """Evaluate the units of a recording; its drives are runs, in order.

    A unit detects the VRU of a drive in a frame if a detection of at least
    `min_confidence` overlaps its label by more than
    :func:`placement.detectors.load_min_iou`. Where several VRUs of the drive's class
    are labelled, the VUT's is the one whose distance comes nearest to that of
    WorldData; of a roadside unit each of them must be detected. A frame that is missing
    is not detected.
    """
    if not 0.0 <= min_confidence <= 1.0:
        raise InputError("min_confidence", min_confidence, "a confidence, 0 .. 1")
    form = load_format()
    detected = {}
    n_ambiguous = 0
    for unit in recording.units:
        detected[unit], n_several = _detected(recording, unit, form, min_confidence)
        n_ambiguous += n_several
    by_vut = None
    if recording.has_vut:
        by_vut, _ = _detected(recording, form.vut_folder, form, min_confidence)
    axis = build_recorded_axis(recording, rule)
    return _evaluate(axis, detected, by_vut, rule, n_ambiguous)


def take_units(
    evaluation: RecordedEvaluation, units: Sequence[str], rule: AebRule
) -> RecordedEvaluation:
    """The evaluation of some of the units only, at least one."""
    return _evaluate(
        evaluation.axis,
        {unit: evaluation.units[unit].detected for unit in units},
        None if evaluation.vut is None else evaluation.vut.detected,
        rule,
        evaluation.n_ambiguous,
    )


def recorded_table(evaluation: RecordedEvaluation) -> DetectionTable:
    """Detection table whose rows are the roadside units, by the names of their folders."""
    return pack_table(
        tuple(evaluation.units),
        evaluation.axis,
        np.stack([verdict.detected for verdict in evaluation.units.values()]),
    )


def build_recorded_axis(recording: Recording, rule: AebRule) -> FrameAxis:
    """Frames of the drives, laid end to end; runs are called "recording/SCENARIO/KMH".

    Cases are "scenario-3-pedestrian" and so on.
    """
    form = load_format()
    drives = recording.drives
    last_s = [
        last_brake_time_s(
            vut_speed_mps=drive.vut_speed_mps,
            vru_speed_mps=drive.vru_speed_mps,
            is_same_direction=is_longitudinal(drive),
            rule=rule,
        )
        for drive in drives
    ]
    return FrameAxis(
        run_ids=_run_ids(drives),
        cases=tuple(f"scenario-{drive.scenario}-{drive.vru_class}" for drive in drives),
        approaches=(RECORDED,) * len(drives),
        weathers=(RECORDED,) * len(drives),
        vut_speed_kmh=np.array([drive.vut_speed_mps * 3.6 for drive in drives]),
        weight=np.full(len(drives), 1.0 / len(drives)),
        last_brake_time_s=np.array(last_s),
        run_start=np.cumsum([0, *(drive.n_frames for drive in drives)]),
        time_s=np.concatenate(
            [np.arange(1 - drive.n_frames, 1) / form.frame_rate_hz for drive in drives]
        ),
    )


def is_longitudinal(drive: Drive) -> bool:
    """True if the VUT catches up with a VRU that goes its way."""
    names = "vut_speed_mps", "vru_speed_mps", "closing_speed_mps"
    return is_same_direction(
        **{name: getattr(drive, name) for name in names}, form=load_format()
    )


def is_same_direction(
    *,
    vut_speed_mps: float,
    vru_speed_mps: float,
    closing_speed_mps: float,
    form: RecordingFormat,
) -> bool:
    """True if the VUT catches up with a VRU that goes its way, by the law of cosines.

    False for a VRU that stands, or is as fast as the VUT. The format says up to which
    angle the ways count as the same.
    """
    v = vut_speed_mps
    u = vru_speed_mps
    if not 0.0 < u < v:
        return False
    cosine = (v**2 + u**2 - closing_speed_mps**2) / (2.0 * u * v)
    return cosine > math.cos(math.radians(form.max_same_direction_deg))


def last_brake_time_s(
    *,
    vut_speed_mps: float,
    vru_speed_mps: float,
    is_same_direction: bool,
    rule: AebRule,
) -> float:
    """Latest onset of braking that avoids, in seconds relative to the impact.

    -(v - u) / (2 a) without build-up if both go the same way: the VUT must only shed v
    - u before the gap to the VRU is closed. Otherwise -v / (2 a): it must stop before
    the place of the impact.

    >>> from dataclasses import replace
    >>> from scenarios.aeb import load_aeb_rule
    >>> rule = replace(load_aeb_rule(), deceleration_mps2=8.0)
    >>> last_brake_time_s(
    ...     vut_speed_mps=16.0, vru_speed_mps=4.0, is_same_direction=True, rule=rule
    ... )
    -0.75
    """
    if is_same_direction:
        shed_mps = vut_speed_mps - vru_speed_mps
    else:
        shed_mps = vut_speed_mps
    # The VUT needs this distance to shed that speed; unbraked it would take distance /
    # speed.
    distance_m = float(braking_distance_m(np.inf, speed_mps=shed_mps, rule=rule))
    return -distance_m / shed_mps


def _run_ids(drives: Sequence[Drive]) -> tuple[str, ...]:
    """Ids of the drives; a speed that is driven again gets a number."""
    ids: list[str] = []
    n_times: Counter[str] = Counter()
    for drive in drives:
        name = f"recording/{drive.scenario}/{round(drive.vut_speed_mps * 3.6)}"
        n_times[name] += 1
        ids.append(name if n_times[name] == 1 else f"{name}/{n_times[name]}")
    return tuple(ids)


def _detected(
    recording: Recording, unit: str, form: RecordingFormat, min_confidence: float
) -> tuple[BoolArray, int]:
    """Frames in which a unit detects the VRU, and the number of those with several in view."""
    all_labels = recording.labels[unit]
    all_found = recording.detections[unit]
    detected = []
    n_several = 0
    for drive in recording.drives:
        for key, distance_m in zip(
            drive.frames, drive.distance_m.tolist(), strict=True
        ):
            labels = [
                label
                for label in all_labels.get(key, ())
                if label.class_name == drive.vru_class
            ]
            if unit == form.vut_folder and len(labels) > 1:
                labels = [
                    min(labels, key=lambda label: abs(label.distance_m - distance_m))
                ]
            n_several += len(labels) > 1 and not np.isnan(distance_m)
            found = [
                one
                for one in (all_found.get(key, ()) if labels else ())
                if one.confidence >= min_confidence
                and one.class_name in _FINDS[drive.vru_class]
            ]
            detected.append(not np.isnan(distance_m) and _is_match(labels, found))
    return np.array(detected), n_several


def _is_match(labels: Sequence[Label], found: Sequence[Detection]) -> bool:
    """True if there is a label, and each one overlaps a detection."""
    if not labels or not found:
        return False
    overlap = iou(
        np.array([label.box_px for label in labels])[:, None],
        np.array([one.box_px for one in found])[None],
    )
    return bool((overlap.max(axis=1) > load_min_iou()).all())


def _evaluate(
    axis: FrameAxis,
    detected: Mapping[str, BoolArray],
    by_vut: BoolArray | None,
    rule: AebRule,
    n_ambiguous: int,
) -> RecordedEvaluation:
    any_unit = np.logical_or.reduce(list(detected.values()))
    return RecordedEvaluation(
        axis=axis,
        vut=None if by_vut is None else _verdict(by_vut, axis, rule),
        units={unit: _verdict(frames, axis, rule) for unit, frames in detected.items()},
        rsu_all=_verdict(any_unit, axis, rule),
        vut_and_rsus=(
            None if by_vut is None else _verdict(any_unit | by_vut, axis, rule)
        ),
        n_ambiguous=n_ambiguous,
    )


def _verdict(detected: BoolArray, axis: FrameAxis, rule: AebRule) -> Verdict:
    arrival_s = earliest_arrival_s([(detected, rule.latency_s)], axis)
    onsets = find_onsets(arrival_s, axis, rule=rule)
    return Verdict(
        detected=detected,
        confirmation_time_s=onsets.confirmation_s,
        onset_time_s=onsets.onset_s,
        is_avoided=onsets.is_in_time,
    )
