"""Frame by frame to a verdict for every run."""

import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import fields, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, IntArray
from geometry.errors import InputError, Unquoted
from geometry.lidar import LidarModel

from ..candidates import CandidatePose
from ..detectors import Evidence, is_matched, load_min_iou
from ..evaluation import Evaluation
from ..layout import Layout
from ..setting import Setting
from .awareness import known_frames
from .judge import Judge
from .perceive import perceive_from_roadside, perceive_from_vut
from .pictures import PictureOfFrame, PictureSource
from .scan import scan_from_roadside, scan_from_vut
from .surroundings import Surroundings, build_surroundings, draw_index
from .vut_camera import load_vut_camera, load_vut_lidar

_UnitKey = tuple[object, ...]


def evaluate_layout(
    layout: Layout,
    setting: Setting,
    *,
    seed: int = 0,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Evaluate one layout; see :func:`evaluate_layouts`."""
    evaluations = evaluate_layouts(
        [layout], setting, seed=seed, workers=workers, on_progress=on_progress
    )
    return evaluations[0]


def evaluate_layouts(
    layouts: Sequence[Layout],
    setting: Setting,
    *,
    seed: int = 0,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Evaluation]:
    """Verdicts of layouts by rendering every frame, detecting, confirming and braking.

    Parameters
    ----------
    layouts : sequence of Layout
        Units at the same pose in several layouts are rendered once.
    setting : Setting
        Scene, runs, braking rule, detector, radio.
    seed : int
        Of what is left to chance: misses, lost messages, who carries a device. A unit's luck
        depends on its pose, not on the layout that it is part of.
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
        The setting's axis does not belong to its runs, or `workers` is less than 1.
    """
    _check(setting, workers)
    surroundings = build_surroundings(setting.scene, setting.runs)
    units = {_unit_key(unit): unit for layout in layouts for unit in layout.units}
    with threadpool_limits(1):  # one BLAS thread per worker: idle ones spin
        detected = _Watch(setting, surroundings, seed).detect(units, workers, on_progress)
    judge = Judge(setting.runs, setting.axis, setting.rule)
    return [_evaluate(layout, setting, detected, judge, seed) for layout in layouts]


_VUT_KEY: _UnitKey = ("vut",)
_VUT_JOBS = 4  # nothing repeats in the VUT's images: they take longer than those of an RSU


def _check(setting: Setting, workers: int) -> None:
    runs, axis = setting.runs, setting.axis
    if tuple(run.id for run in runs) != axis.run_ids or not np.array_equal(
        np.concatenate([run.time_s for run in runs]), axis.time_s
    ):
        raise InputError("axis", Unquoted("frames of other runs"), "the frame axis of these runs")
    if workers < 1:
        raise InputError("workers", workers, "a whole number, at least 1")


def _unit_key(unit: CandidatePose) -> _UnitKey:
    pose = unit.pose
    return (*pose.position_m.tolist(), pose.yaw_deg, pose.pitch_deg, unit.sensor)


def _rng(seed: int, *key: object) -> np.random.Generator:
    """Luck of its own for each thing, whatever else there is."""
    return np.random.default_rng([seed, zlib.crc32(repr(key).encode())])


class _Watch:
    """Frames in which the VRU is detected, by every unit and by the VUT."""

    def __init__(self, setting: Setting, surroundings: Surroundings, seed: int) -> None:
        self._setting, self._surroundings, self._seed = setting, surroundings, seed
        self._pictures = PictureSource(setting.scene, setting.runs, seed=seed)
        mount = load_vut_camera()
        self._vut_camera = replace(mount, camera=setting.vut_camera or mount.camera)

    def detect(
        self,
        units: Mapping[_UnitKey, CandidatePose],
        workers: int,
        on_progress: Callable[[int, int], None] | None,
    ) -> dict[_UnitKey, BoolArray]:
        """Frames by unit, and by the VUT under its own key."""
        n_frames = len(self._surroundings.vru_poses)
        quarters = np.array_split(np.arange(n_frames), min(_VUT_JOBS, n_frames))
        sensors = self._setting.vut_sensors
        executor = ThreadPoolExecutor(workers)
        try:
            looks = [
                executor.submit(self._look_from_vut, frames)
                for frames in quarters * ("camera" in sensors)
            ]
            scans = [
                executor.submit(self._scan_from_vut, frames)
                for frames in quarters * ("lidar" in sensors)
            ]
            by_unit = {
                key: executor.submit(self._detect_by_unit, key, unit) for key, unit in units.items()
            }
            jobs: list[Future[Any]] = [*looks, *scans, *by_unit.values()]
            for n_done, future in enumerate(as_completed(jobs), start=1):
                future.result()
                if on_progress is not None:
                    on_progress(n_done, len(jobs))
        finally:  # after an error or an interruption: what has not begun never will
            executor.shutdown(cancel_futures=True)
        by_vut = np.zeros(n_frames, dtype=bool)
        if looks:
            evidence = _join([look.result() for look in looks])
            by_vut |= self._find(evidence, _VUT_KEY, self._pictures.from_vut(self._vut_camera))
        if scans:
            by_vut |= np.concatenate([scan.result() for scan in scans])
        return {_VUT_KEY: by_vut} | {key: future.result() for key, future in by_unit.items()}

    def _look_from_vut(self, frames: IntArray) -> Evidence:
        detector = self._setting.detector
        return perceive_from_vut(
            self._surroundings.take(frames),
            self._vut_camera,
            min_height_px=detector.min_box_height_px,
            with_shares=detector.needs_shares,
        )

    def _scan_from_vut(self, frames: IntArray) -> BoolArray:
        rng = _rng(self._seed, _VUT_KEY, "lidar", int(frames[0]))
        return scan_from_vut(
            self._surroundings.take(frames), self._vut_camera, load_vut_lidar(), rng
        )

    def _detect_by_unit(self, key: _UnitKey, unit: CandidatePose) -> BoolArray:
        if isinstance(unit.sensor, LidarModel):
            rng = _rng(self._seed, key)
            return scan_from_roadside(self._surroundings, unit.pose, unit.sensor, rng)
        detector = self._setting.detector
        evidence = perceive_from_roadside(
            self._surroundings,
            unit.pose,
            unit.sensor,
            min_height_px=detector.min_box_height_px,
            with_shares=detector.needs_shares,
        )
        return self._find(evidence, key, self._pictures.from_roadside(unit.pose, unit.sensor))

    def _find(self, evidence: Evidence, key: _UnitKey, picture: PictureOfFrame) -> BoolArray:
        seen = replace(evidence, picture=picture)
        found = self._setting.detector.detect(seen, _rng(self._seed, key))
        return is_matched(found, evidence.visible_px, min_iou=load_min_iou())


def _join(parts: Sequence[Evidence]) -> Evidence:
    """Evidence of consecutive frames in one."""
    names = [field.name for field in fields(Evidence) if field.name != "picture"]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return Evidence(**joined)


def _evaluate(
    layout: Layout,
    setting: Setting,
    detected: Mapping[_UnitKey, BoolArray],
    judge: Judge,
    seed: int,
) -> Evaluation:
    links, rule = setting.links, setting.rule
    draws, frame_draw = np.unique(draw_index(setting.runs), return_inverse=True)
    units = {}
    for unit in layout.units:
        key = _unit_key(unit)
        arrives = (_rng(seed, key, "cpm").random(len(draws)) >= links.packet_loss)[frame_draw]
        units[unit.id] = (detected[key] & arrives, unit.latency(rule))
    vut = (detected[_VUT_KEY], rule.latency_s)
    others = {}
    if links.vam_rate > 0.0:
        vam = (known_frames(setting.runs, links, _rng(seed, "vam")), rule.latency_s)
        others = {
            "vam": judge.verdict([vam]),
            "all_sources": judge.verdict([*units.values(), vut, vam]),
        }
    return Evaluation(
        layout=layout,
        axis=setting.axis,
        vut=judge.verdict([vut]),
        units={name: judge.verdict([party]) for name, party in units.items()},
        rsu_all=judge.verdict(list(units.values())),
        vut_and_rsus=judge.verdict([*units.values(), vut]),
        others=others,
    )
