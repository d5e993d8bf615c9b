"""Frame by frame to a verdict for every run."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene
from scenarios.aeb import AebRule, has_contact
from scenarios.runs import FrameAxis, Run, confirmation_times_s

from ..candidates import CandidatePose
from ..detector import Detector
from ..evaluation import Evaluation, Verdict
from ..layout import Layout
from .perceive import Boxes, perceive_from_roadside, perceive_from_vut
from .surroundings import Surroundings, build_surroundings
from .vut_camera import load_vut_camera

_UnitKey = tuple[object, ...]


def evaluate_layout(
    layout: Layout,
    scene: Scene,
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    rule: AebRule,
    detector: Detector,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Evaluate one layout; see :func:`evaluate_layouts`."""
    evaluations = evaluate_layouts(
        [layout],
        scene,
        runs,
        axis,
        rule=rule,
        detector=detector,
        workers=workers,
        on_progress=on_progress,
    )
    return evaluations[0]


def evaluate_layouts(
    layouts: Sequence[Layout],
    scene: Scene,
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    rule: AebRule,
    detector: Detector,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Evaluation]:
    """Verdicts of layouts by rendering every frame, detecting, confirming and braking.

    Parameters
    ----------
    layouts : sequence of Layout
        Units at the same pose in several layouts are rendered once.
    scene : Scene
        The junction.
    runs : sequence of Run
        What is driven.
    axis : FrameAxis
        The frames of `runs` and their weights.
    rule : AebRule
        Confirmation, latency, deceleration.
    detector : Detector
        What counts as detected.
    workers : int
        Threads.
    on_progress : callable, optional
        Called from the calling thread with the number of jobs done and of all jobs. A job is
        one pose, or a quarter of the VUT's frames.

    Returns
    -------
    evaluations : list of Evaluation
        One per layout.

    Raises
    ------
    InputError
        `axis` does not belong to `runs`, or `workers` is less than 1.
    """
    _check(runs, axis, workers)
    surroundings = build_surroundings(scene, runs)
    units = {_unit_key(unit): unit for layout in layouts for unit in layout.units}
    with threadpool_limits(1):  # one BLAS thread per worker: idle ones spin
        detected = _detect(units, surroundings, detector, workers, on_progress)
    judge = _Judge(runs, axis, rule)
    return [_evaluate(layout, detected, judge) for layout in layouts]


_VUT_KEY: _UnitKey = ("vut",)
_VUT_JOBS = 4  # nothing repeats in the VUT's images: they take longer than those of an RSU


def _check(runs: Sequence[Run], axis: FrameAxis, workers: int) -> None:
    if tuple(run.id for run in runs) != axis.run_ids or not np.array_equal(
        np.concatenate([run.time_s for run in runs]), axis.time_s
    ):
        raise InputError("axis", Unquoted("frames of other runs"), "the frame axis of these runs")
    if workers < 1:
        raise InputError("workers", workers, "a whole number, at least 1")


def _unit_key(unit: CandidatePose) -> _UnitKey:
    pose = unit.pose
    return (pose.position_m.tobytes(), pose.yaw_deg, pose.pitch_deg, unit.camera)


def _detect(
    units: Mapping[_UnitKey, CandidatePose],
    surroundings: Surroundings,
    detector: Detector,
    workers: int,
    on_progress: Callable[[int, int], None] | None,
) -> dict[_UnitKey, BoolArray]:
    """Frames in which each unit, and the VUT, detects the VRU."""
    n_frames = len(surroundings.vru_poses)
    detected = {key: np.zeros(n_frames, dtype=bool) for key in (_VUT_KEY, *units)}
    executor = ThreadPoolExecutor(workers)
    jobs: dict[Future[Boxes], BoolArray] = {}  # and where their detections belong
    try:
        for frames in np.array_split(np.arange(n_frames), min(_VUT_JOBS, n_frames)):
            future = executor.submit(
                perceive_from_vut,
                surroundings.take(frames),
                load_vut_camera(),
                min_height_px=detector.min_box_height_px,
            )
            jobs[future] = detected[_VUT_KEY][frames[0] : frames[-1] + 1]
        for key, unit in units.items():
            future = executor.submit(
                perceive_from_roadside,
                surroundings,
                unit.pose,
                unit.camera,
                min_height_px=detector.min_box_height_px,
            )
            jobs[future] = detected[key]
        for n_done, future in enumerate(as_completed(jobs), start=1):
            boxes = future.result()
            jobs[future][:] = detector.is_detected(boxes.visible_px, boxes.amodal_px)
            if on_progress is not None:
                on_progress(n_done, len(jobs))
    finally:  # after an error or an interruption: what has not begun never will
        executor.shutdown(cancel_futures=True)
    return detected


class _Judge:
    """From detected frames to verdicts; remembers which onsets of braking end in contact."""

    def __init__(self, runs: Sequence[Run], axis: FrameAxis, rule: AebRule) -> None:
        self.axis, self._runs, self._rule = axis, runs, rule
        self._has_contact: dict[tuple[int, float], bool] = {}

    def verdict(self, detected: BoolArray) -> Verdict:
        rule = self._rule
        confirmation = confirmation_times_s(
            detected, self.axis, n_confirmations=rule.n_confirmations
        )
        return Verdict(
            detected=detected,
            confirmation_time_s=confirmation,
            is_avoided=np.array(
                [
                    not self._touches(index, float(onset_s))
                    for index, onset_s in enumerate(confirmation + rule.latency_s)
                ]
            ),
        )

    def _touches(self, run_index: int, onset_s: float) -> bool:
        key = (run_index, onset_s)
        if key not in self._has_contact:
            self._has_contact[key] = has_contact(
                self._runs[run_index].encounter, onset_s, self._rule
            )
        return self._has_contact[key]


def _evaluate(layout: Layout, detected: Mapping[_UnitKey, BoolArray], judge: _Judge) -> Evaluation:
    by_unit = {unit.id: detected[_unit_key(unit)] for unit in layout.units}
    any_unit = np.logical_or.reduce(list(by_unit.values()))
    by_vut = detected[_VUT_KEY]
    return Evaluation(
        layout=layout,
        axis=judge.axis,
        vut=judge.verdict(by_vut),
        units={unit_id: judge.verdict(frames) for unit_id, frames in by_unit.items()},
        rsu_all=judge.verdict(any_unit),
        vut_and_rsus=judge.verdict(any_unit | by_vut),
    )
