"""Runs as the player's script reads them: whole centimetres and milliseconds, packed bits."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.footprints import footprint_corners
from placement.evaluation import Evaluation, Verdict
from scenarios.runs import Run

from ..figures import describe_run, unit_labels
from .script_text import pack_bits

_PARTY_NAMES = {
    "vut": "VUT",
    "rsu_all": "all RSUs",
    "vut_and_rsus": "VUT and RSUs",
    "vam": "VAM",
    "all_sources": "all sources",
}


def party_records(evaluations: Mapping[str, Evaluation]) -> list[dict[str, str]]:
    """Who may detect, in the order of the bits of :func:`run_record`.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject, of the others only all units together count.

    Returns
    -------
    records : list of dict
        name, kind: "vut", "unit", "rsu_all" (the subject's) or "other".
    """
    subject_name, subject = next(iter(evaluations.items()))
    labels = unit_labels(subject.layout)
    return [
        {"name": _PARTY_NAMES["vut"], "kind": "vut"},
        *({"name": labels[unit_id], "kind": "unit"} for unit_id in subject.units),
        {"name": _PARTY_NAMES["rsu_all"], "kind": "rsu_all"},
        {"name": _PARTY_NAMES["vut_and_rsus"], "kind": "other"},
        *({"name": _PARTY_NAMES.get(name, name), "kind": "other"} for name in subject.others),
        *(
            {"name": f"{name}: all RSUs", "kind": "other"}
            for name in evaluations
            if name != subject_name
        ),
    ]


def run_record(run: Run, evaluations: Mapping[str, Evaluation], *, group: str) -> dict[str, Any]:
    """A run with what every party detects.

    Parameters
    ----------
    run : Run
        One that all evaluations have.
    evaluations : mapping of str to Evaluation
        As for :func:`party_records`.
    group : str
        Why the run is shown.

    Returns
    -------
    record : dict
        Times in milliseconds (None: never), positions in centimetres, headings in tenths of a
        degree. "bits": see :func:`.script_text.pack_bits`, a row per party.
    """
    subject, *others = evaluations.values()
    axis = subject.axis
    index = axis.run_ids.index(run.id)
    parties: list[tuple[Evaluation, Verdict]] = [
        (subject, subject.vut),
        *((subject, verdict) for verdict in subject.units.values()),
        (subject, subject.rsu_all),
        (subject, subject.vut_and_rsus),
        *((subject, verdict) for verdict in subject.others.values()),
        *((other, other.rsu_all) for other in others),
    ]
    at = [item.axis.run_ids.index(run.id) for item, _ in parties]
    detected = np.array(
        [
            verdict.detected[item.axis.frames_of(position)]
            for (item, verdict), position in zip(parties, at, strict=True)
        ]
    )
    verdicts = [verdict for _, verdict in parties]
    return {
        "id": run.id,
        "group": group,
        "title": describe_run(axis, index),
        "case": run.case.title,
        "user": run.case.vru.class_name,
        "time": _milliseconds(run.time_s),
        "last": _milliseconds(run.last_brake_time_s),
        "lastPlace": _last_place(run),
        "car": _motion(run.vut_position_m, run.vut_yaw_deg),
        "road": _motion(run.vru_position_m, run.vru_yaw_deg),
        "carSize": _centimetres([run.encounter.vut.length_m, run.encounter.vut.width_m]),
        "roadSize": _centimetres([run.encounter.vru.length_m, run.encounter.vru.width_m]),
        "parked": [
            {
                "name": body.actor.name,
                "corners": _centimetres(
                    footprint_corners(
                        body.pose.position_m[:2],
                        body.pose.yaw_deg,
                        length_m=body.actor.length_m,
                        width_m=body.actor.width_m,
                    )
                ),
                "height": _centimetres(body.actor.height_m),
            }
            for body in run.obstruction
        ],
        "bits": pack_bits(detected),
        "confirmed": [
            _milliseconds(verdict.confirmation_time_s[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
        "onset": [
            _milliseconds(verdict.onset_time_s[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
        "avoided": [
            bool(verdict.is_avoided[position])
            for verdict, position in zip(verdicts, at, strict=True)
        ],
    }


def is_playable(run: Run, evaluation: Evaluation) -> bool:
    """Whether an evaluation has the run on the very frames on which it is driven."""
    axis = evaluation.axis
    if run.id not in axis.run_ids:
        return False
    times_s = axis.time_s[axis.frames_of(axis.run_ids.index(run.id))]
    return len(times_s) == len(run.time_s) and bool(np.allclose(times_s, run.time_s, atol=1.0e-6))


def _last_place(run: Run) -> list[int] | None:
    """Where the car is at the last moment to brake; None where no braking helps."""
    if not np.isfinite(run.last_brake_time_s):
        return None
    motion = run.encounter.vut_motion
    (place,) = motion.path.at(motion.distance_m([run.last_brake_time_s]))[0]
    cm: list[int] = _centimetres(place)
    return cm


def _motion(position_m: FloatArray, yaw_deg: FloatArray) -> dict[str, list[int]]:
    return {
        "x": _centimetres(position_m[:, 0]),
        "y": _centimetres(position_m[:, 1]),
        "yaw": np.rint(10.0 * yaw_deg).astype(int).tolist(),
    }


def _centimetres(values_m: ArrayLike) -> Any:
    return np.rint(100.0 * np.asarray(values_m)).astype(int).tolist()


def _milliseconds(values_s: ArrayLike) -> Any:
    """Whole milliseconds; None in place of an infinity (of single values only)."""
    values = np.asarray(values_s, dtype=np.float64)
    if values.ndim == 0 and not np.isfinite(values):
        return None
    return np.rint(1000.0 * values).astype(int).tolist()
