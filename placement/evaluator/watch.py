"""Frames in which the VRU is detected, by every unit and by the VUT itself."""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ThreadPoolExecutor,
    as_completed,
    wait,
)
from contextlib import closing, contextmanager
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.arrays import BoolArray, IntArray
from geometry.image_boxes import box_height_px
from geometry.lidar import LidarModel, load_lidar_detection
from geometry.poses import Pose
from geometry.sensors import CameraModel
from geometry.weather import pick_weather

from ..cache import CachedArrays, Fingerprints
from ..candidates import CandidatePose
from ..compute import Compute
from ..detectors import Evidence, is_matched, load_min_iou
from ..setting import Setting
from .surroundings import build_surroundings, draw_index, load_vut_camera, load_vut_lidar

if TYPE_CHECKING:
    from .pictures import PictureSource

# ---------- detections


UnitKey = tuple[object, ...]
VUT_KEY: UnitKey = ("vut",)
STAGE = "evaluate"

_VUT_JOBS = 4  # nothing repeats in the VUT's images: they take longer than those of an RSU
_POLL_S = 0.5


def unit_key(unit: CandidatePose) -> UnitKey:
    """Equal for units that see the same."""
    pose = unit.pose
    return (*pose.position_m.tolist(), pose.yaw_deg, pose.pitch_deg, unit.sensor)


def build_rng(seed: int, *key: object) -> np.random.Generator:
    """Luck of its own for each thing, whatever else there is."""
    return np.random.default_rng([seed, zlib.crc32(repr(key).encode())])


def watch(
    setting: Setting, units: Mapping[UnitKey, CandidatePose], *, compute: Compute
) -> dict[UnitKey, BoolArray]:
    """Frames in which each unit, and the VUT under ``VUT_KEY``, detects the VRU, (n_frames,) each.

    No message is lost yet. Progress is called from the calling thread: first with poses looked
    from, a quarter of the VUT's frames counting as one; then, where the detector looks at
    pictures, with pictures. What is kept of an earlier call is not looked at again.
    """
    names = _names(setting, units)
    kept = _open_cache(setting, compute)
    new = {key: unit for key, unit in units.items() if names[key] not in kept.arrays}
    nothing = np.zeros(setting.axis.n_frames, dtype=bool)
    if new or names[VUT_KEY] not in kept.arrays:
        watcher = _Watcher(setting, compute)
        with_vut = names[VUT_KEY] not in kept.arrays
        looks, by_lidar = watcher.look(new, with_vut=with_vut)
        by_camera = watcher.find(looks, new)
        kept.add(
            {
                names[key]: by_camera.get(key, nothing) | by_lidar.get(key, nothing)
                for key in ((VUT_KEY,) if with_vut else ()) + tuple(new)
            }
        )
    return {key: kept.arrays[name] for key, name in names.items()}


# ---------- what is kept for the next call


_KIND = "place-rsus/views/2"  # raise it whenever the same inputs give other detections


def _names(setting: Setting, units: Mapping[UnitKey, CandidatePose]) -> dict[UnitKey, str]:
    """Under what the frames are kept in which each unit and the VUT detect."""
    hashes = Fingerprints()
    vut = hashes.of(setting.vut_sensors, setting.vut_camera, load_vut_camera(), load_vut_lidar())
    return {VUT_KEY: f"vut-{vut}"} | {
        key: f"unit-{hashes.of(unit.pose, unit.sensor)}" for key, unit in units.items()
    }


def _open_cache(setting: Setting, compute: Compute) -> CachedArrays:
    """Frames that are known already; none where a network looks at pictures."""
    is_kept = compute.cache_folder is not None and not setting.detector.needs_pictures
    return CachedArrays(
        compute.cache_folder if is_kept else None,
        "views",
        kind=_KIND,
        fingerprint=_fingerprint(setting, compute.seed) if is_kept else "",
    )


def _fingerprint(setting: Setting, seed: int) -> str:
    """Hash of all that detections depend on, but for the units and what the VUT looks with."""
    scene, runs = setting.scene, setting.runs
    weathers = dict.fromkeys(run.weather for run in runs)
    return Fingerprints().of(
        *(_KIND, seed, setting.detector, load_min_iou(), load_lidar_detection()),
        *(scene.vertices_m, scene.triangles, scene.triangle_instance),
        [instance.class_name for instance in scene.instances],
        [pick_weather(name, "runs: weather") for name in weathers],
        draw_index(runs),
        [
            (
                *(run.weather, run.encounter.vut, run.encounter.vru, run.obstruction, run.traffic),
                *(run.terrain, run.time_s, run.vut_position_m, run.vut_yaw_deg),
                *(run.vru_position_m, run.vru_yaw_deg, run.vru_shape),
            )
            for run in runs
        ],
    )


class _Watcher:
    """Looks from every unit, then lets the detector find the VRU in what is seen.

    What looks is loaded then: not where all is known from an earlier call.
    """

    def __init__(self, setting: Setting, compute: Compute) -> None:
        self._setting, self._compute, self._seed = setting, compute, compute.seed
        self._surroundings = build_surroundings(setting.scene, setting.runs)
        mount = load_vut_camera()
        self._mount = replace(mount, camera=setting.vut_camera or mount.camera)

    def look(
        self, units: Mapping[UnitKey, CandidatePose], *, with_vut: bool
    ) -> tuple[dict[UnitKey, Evidence], dict[UnitKey, BoolArray]]:
        """Evidence of cameras, and the frames in which LiDARs detect."""
        n_frames = self._setting.axis.n_frames
        parts = np.array_split(np.arange(n_frames), min(_VUT_JOBS, n_frames))
        looks: dict[UnitKey, Future[Evidence]] = {}
        scans: dict[UnitKey, Future[BoolArray]] = {}
        by_vut: list[Future[Evidence]] = []
        with _pool(self._compute.workers) as pool:
            if with_vut and "camera" in self._setting.vut_sensors:
                by_vut = [pool.submit(self._look_from_vut, frames) for frames in parts]
            if with_vut and "lidar" in self._setting.vut_sensors:
                scans[VUT_KEY] = pool.submit(self._scan_from_vut)
            for key, unit in units.items():
                if isinstance(unit.sensor, LidarModel):
                    scans[key] = pool.submit(self._scan, key, unit.pose, unit.sensor)
                else:
                    looks[key] = pool.submit(self._look, unit.pose, unit.sensor)
            jobs: list[Future[Any]] = [*by_vut, *looks.values(), *scans.values()]
            for n_done, future in enumerate(as_completed(jobs), start=1):
                future.result()
                self._compute.progress(STAGE, n_done, len(jobs))
        seen = {key: future.result() for key, future in looks.items()}
        if by_vut:
            seen[VUT_KEY] = _join([future.result() for future in by_vut])
        return seen, {key: future.result() for key, future in scans.items()}

    def find(
        self, looks: Mapping[UnitKey, Evidence], units: Mapping[UnitKey, CandidatePose]
    ) -> dict[UnitKey, BoolArray]:
        """Frames in which the detector finds the VRU in what each camera shows."""
        detector = self._setting.detector
        if not detector.needs_pictures:
            return {key: self._detect(key, evidence) for key, evidence in looks.items()}
        heights = [box_height_px(evidence.visible_px) for evidence in looks.values()]
        least_px = max(detector.min_box_height_px, np.finfo(float).tiny)
        n_pictures = sum(int((height >= least_px).sum()) for height in heights)
        from .pictures import PictureSource

        source = PictureSource(self._setting.scene, self._setting.runs, seed=self._seed)
        # The VUT's pictures take longest, for nothing stands still in them: they are drawn first.
        longest_first = sorted(looks.items(), key=lambda item: item[0] != VUT_KEY)
        with _pool(self._compute.workers) as pool, closing(source):
            found = {
                key: pool.submit(
                    self._detect,
                    key,
                    self._with_pictures(evidence, source, units.get(key)),
                )
                for key, evidence in longest_first
            }
            pending = set(found.values())
            while pending:
                done, pending = wait(pending, timeout=_POLL_S, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
                self._compute.progress(STAGE, source.n_drawn, n_pictures)
        return {key: found[key].result() for key in looks}

    def _detect(self, key: UnitKey, evidence: Evidence) -> BoolArray:
        found = self._setting.detector.detect(evidence, build_rng(self._seed, key))
        return is_matched(found, evidence.visible_px, min_iou=load_min_iou())

    def _with_pictures(
        self, evidence: Evidence, source: "PictureSource", unit: CandidatePose | None
    ) -> Evidence:
        """What is shown to the detector: whole pictures, or crops around the road user."""
        if unit is None:
            crops = source.crops(self._mount, evidence.amodal_px)
            return replace(evidence, picture=source.from_vut(self._mount), crops=crops)
        assert isinstance(unit.sensor, CameraModel)
        crops = source.crops((unit.pose, unit.sensor), evidence.amodal_px)
        picture = source.from_roadside(unit.pose, unit.sensor)
        return replace(evidence, picture=picture, crops=crops)

    def _look(self, pose: Pose, camera: CameraModel) -> Evidence:
        from .perceive import perceive_from_roadside

        least_px = self._setting.detector.min_box_height_px
        return perceive_from_roadside(self._surroundings, pose, camera, min_height_px=least_px)

    def _look_from_vut(self, frames: IntArray) -> Evidence:
        from .perceive import perceive_from_vut

        least_px = self._setting.detector.min_box_height_px
        return perceive_from_vut(
            self._surroundings.take(frames), self._mount, min_height_px=least_px
        )

    def _scan(self, key: UnitKey, pose: Pose, lidar: LidarModel) -> BoolArray:
        from .scan import scan_from_roadside

        return scan_from_roadside(self._surroundings, pose, lidar, build_rng(self._seed, key))

    def _scan_from_vut(self) -> BoolArray:
        from .scan import scan_from_vut

        rng = build_rng(self._seed, VUT_KEY, "lidar")
        return scan_from_vut(self._surroundings, self._mount, load_vut_lidar(), rng)


@contextmanager
def _pool(workers: int) -> Iterator[ThreadPoolExecutor]:
    """Threads; after an error or an interruption, what has not begun never will."""
    executor = ThreadPoolExecutor(workers)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def _join(parts: Sequence[Evidence]) -> Evidence:
    """Evidence of consecutive frames in one."""
    names = [field.name for field in fields(Evidence) if field.name not in ("picture", "crops")]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in names
    }
    return Evidence(**joined)
