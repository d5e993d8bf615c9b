"""Runs on which detection table and evaluator differ, and why."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated

import numpy as np

from geometry.arrays import BoolArray, IntArray
from geometry.image_boxes import box_height_px, iou
from geometry.lidar import LidarModel
from geometry.phrases import Phrase
from geometry.tables import says

from ..cache import cached_value
from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..detection_table import DetectionTable
from ..evaluation import Evaluation, Verdict
from ..live import table_verdict
from ..setting import Setting
from ..visibility import table_fingerprint

FUSED = "all, fused"


@dataclass(frozen=True, slots=True, kw_only=True)
class Disagreement:
    """A run that either detection table or evaluator calls avoided."""

    party: Annotated[str, says('Id of a unit by itself, or "all, fused".')]
    run_id: Annotated[str, says("Which run.")]
    on_table: Annotated[
        bool,
        says(
            "The detection table calls it avoided, and the evaluator does not; false:"
            " the opposite."
        ),
    ]
    n_frames: Annotated[
        int, says("Frames before the last moment to brake in which they differ.")
    ]
    cause: Annotated[
        str,
        says("How the evaluator sees the road user in the first of them, in words."),
    ]


def find_disagreements(
    setting: Setting,
    table: DetectionTable,
    evaluation: Evaluation,
    pose_index: Sequence[int],
    *,
    compute: Compute = DEFAULT_COMPUTE,
) -> tuple[Disagreement, ...]:
    """Runs on which table and evaluator disagree.

    Each unit is compared alone, then all fused. `pose_index` are the table's rows
    of the layout's units, in their order.
    """
    units = evaluation.layout.units
    axis = setting.axis
    detected = table.detected(list(pose_index))
    if setting.detector.needs_pictures:
        folder = None
    else:
        folder = compute.cache_folder
    # The cache's key covers the table, the detector and the evaluation.
    seen = ""
    if folder is not None:
        runs = setting.runs
        planner = setting.table_detector
        seen = table_fingerprint(setting.scene, units, runs, planner, seed=compute.seed)
    on_table = dict(zip((unit.id for unit in units), detected, strict=True))

    def differing_frames(unit: CandidatePose, run: int) -> IntArray:
        """Frames of a run, before its last moment, in which a unit differs."""
        frames = np.arange(axis.n_frames)[axis.frames_of(run)]
        counts = axis.time_s[frames] <= axis.last_brake_time_s[run]
        differs = (
            on_table[unit.id][frames] != evaluation.units[unit.id].detected[frames]
        )
        return np.asarray(frames[counts & differs])

    def compare(
        parties: Sequence[CandidatePose], verdict: Verdict
    ) -> Iterator[Disagreement]:
        """Disagreements of a unit, or of all units fused."""
        is_fused = verdict is evaluation.headline
        with_vut = is_fused and evaluation.cars == 1.0
        # Runs on which both verdicts differ, with the frames that explain it.
        rows = np.array([on_table[unit.id] for unit in parties])
        avoided = table_verdict(parties, rows, setting, with_vut=with_vut).is_avoided
        for run in np.flatnonzero(avoided != verdict.is_avoided).tolist():
            differing = [(unit, differing_frames(unit, run)) for unit in parties]
            frames = np.concatenate([frames for _, frames in differing])
            party = parties[0].id
            if is_fused:
                party = FUSED
            yield Disagreement(
                party=party,
                run_id=axis.run_ids[run],
                on_table=bool(avoided[run]),
                n_frames=len(np.unique(frames)),
                cause=_cause(setting, differing, on_table),
            )

    def find() -> tuple[Disagreement, ...]:
        alone = (compare([unit], evaluation.units[unit.id]) for unit in units)
        return tuple(chain(*alone, compare(units, evaluation.headline)))

    return cached_value(
        folder,
        "disagreements",
        find,
        kind=tuple[Disagreement, ...],
        made_from=(
            *(seen, setting.detector, setting.rule, detected, evaluation),
            *(() if setting.seen_by_vut is None else [setting.seen_by_vut]),
        ),
    )


def _cause(
    setting: Setting,
    differing: Sequence[tuple[CandidatePose, IntArray]],
    on_table: dict[str, BoolArray],
) -> Phrase:
    """Description of the first frame that differs."""
    somewhere = [(int(frames[0]), unit) for unit, frames in differing if len(frames)]
    if not somewhere:
        return Phrase("messages: latency or packets lost")
    frame, unit = min(somewhere, key=lambda pair: pair[0])
    time_s = float(setting.axis.time_s[frame])
    if isinstance(unit.sensor, LidarModel):
        return Phrase(
            "{unit} at {time:.1f} s: about as many points as needed",
            unit=unit.id,
            time=time_s,
        )
    run = int(np.searchsorted(setting.axis.run_start, frame, side="right")) - 1
    # Loads the compiler.
    from ..evaluator import build_surroundings, perceive_frames

    surroundings = build_surroundings(setting.scene, [setting.runs[run]])
    frames = np.array([frame - int(setting.axis.run_start[run])])
    evidence = perceive_frames(surroundings.take(frames), (unit.pose, unit.sensor))
    seen = {
        "unit": unit.id,
        "time": time_s,
        "height": float(box_height_px(evidence.visible_px)[0]),
        "share": 100.0 * float(evidence.visible_share[0]),
        "iou": float(iou(evidence.visible_px, evidence.amodal_px)[0]),
    }
    if setting.detector.needs_pictures:
        return Phrase(
            "{unit} at {time:.1f} s: {detector} judges the image differently from"
            " the box model ({height:.1f} px high, {share:.0f} % seen, IoU"
            " {iou:.2f})",
            detector=setting.detector.name,
            **seen,
        )
    is_expected = bool(setting.table_detector.is_expected(evidence)[0])
    if is_expected == bool(on_table[unit.id][frame]):
        return Phrase(
            "{unit} at {time:.1f} s: chance or a lost message ({height:.1f} px high, "
            "{share:.0f} % seen, IoU {iou:.2f})",
            **seen,
        )
    return Phrase(
        "{unit} at {time:.1f} s: sample points and pixels differ at the limit "
        "({height:.1f} px high, {share:.0f} % seen, IoU {iou:.2f})",
        **seen,
    )
