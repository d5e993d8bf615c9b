"""Candidate poses and runs to a detection table, one mount position at a time."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from geometry.scene import Scene
from scenarios.runs import FrameAxis, Run

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..detection_table import DetectionTable
from ..detectors import PlanningDetector
from ..setting import Setting
from .casting import World, build_world, cast_sight
from .sensing import Sensing, build_sensing, max_distance_m, reach_m

N_POINTS = 160  # per VRU: neighbouring points are about 10 cm apart

STAGE = "detection table"


def build_detection_table(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    detector: PlanningDetector,
    compute: Compute = DEFAULT_COMPUTE,
) -> DetectionTable:
    """Detections V[c, f] of every candidate pose in every frame; all runs have the same VUT.

    The detector says what counts as a detection of a camera; a LiDAR counts points. Progress is
    told the mount positions.
    """
    world = build_world(scene, runs, n_points=N_POINTS, seed=compute.seed)
    mounts = _group_by_mount(candidates)
    packed = np.zeros((len(candidates), -(-axis.n_frames // 8)), dtype=np.uint8)

    def fill(rows: IntArray) -> None:
        packed[rows] = _mount_rows(world, [candidates[row] for row in rows], detector)

    # One BLAS thread per worker: the matrices are small, and idle BLAS threads spin.
    with threadpool_limits(1), ThreadPoolExecutor(compute.workers) as pool:
        pending = [pool.submit(fill, rows) for rows in mounts]
        try:
            for done, future in enumerate(as_completed(pending), start=1):
                future.result()
                compute.progress(STAGE, done, len(mounts))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return DetectionTable(
        pose_ids=tuple(candidate.id for candidate in candidates), axis=axis, packed=packed
    )


def _group_by_mount(candidates: Sequence[CandidatePose]) -> list[IntArray]:
    """Rows that share all rays: same position, same near limit."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for row, candidate in enumerate(candidates):
        key = (*candidate.pose.position_m.tolist(), candidate.sensor.near_m)
        groups.setdefault(key, []).append(row)
    return [np.array(rows) for rows in groups.values()]


def _mount_rows(
    world: World, candidates: Sequence[CandidatePose], detector: PlanningDetector
) -> NDArray[np.uint8]:
    """Packed rows of all candidates of one mount position."""
    position_m, near_m = candidates[0].pose.position_m, candidates[0].sensor.near_m
    # To the nearest point; to the middle of the footprint it is at most a body's extent more.
    reach_m = 2.0 * world.radius_m + max(
        _reach_m(candidate.sensor, detector, world) for candidate in candidates
    )
    sight = cast_sight(world, position_m, near_m=near_m, max_distance_m=reach_m)
    sensing: Sensing = build_sensing(world, sight, position_m, detector)
    # One more entry, never detected, for frames in which nothing is seen (index -1).
    detected = np.zeros(
        (len(candidates), len(world.views.weathers), len(sight.view_index) + 1), bool
    )
    for row, candidate in enumerate(candidates):
        detected[row, :, :-1] = sensing.detected(candidate)
    frames = detected[:, world.views.weather_of_frame, sight.entry_of_frame]
    return np.packbits(frames, axis=1, bitorder="little")


def _reach_m(sensor: Sensor, detector: PlanningDetector, world: World) -> float:
    if isinstance(sensor, LidarModel):
        return sensor.range_m
    return max_distance_m(sensor, detector, vru_height_m=2.0 * world.radius_m)


# ---------- a few poses, each with a detector of its own


_MARGIN_RAD = 1.0e-3  # for the rounding of single precision
Look = tuple[CandidatePose, PlanningDetector]


def detected_frames(
    setting: Setting,
    looks: Sequence[Look],
    *,
    pool: ThreadPoolExecutor,
    compute: Compute,
) -> BoolArray:
    """Frames in which units detect, each with a detector of its own, (n_looks, n_frames) bool.

    These are the rows that :func:`build_detection_table` has for each. Rays are cast once for all
    from one place, and only to what any of them has in its view.
    """
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=compute.seed)
    places: dict[tuple[float, ...], list[int]] = {}
    for row, (unit, _) in enumerate(looks):
        key = (*unit.pose.position_m.tolist(), unit.sensor.near_m)
        places.setdefault(key, []).append(row)
    frames = np.zeros((len(looks), setting.axis.n_frames), dtype=bool)
    middle_m = world.views.points_m.mean(axis=1, dtype=np.float64)
    pending = [pool.submit(_fill, frames, world, middle_m, looks, rows) for rows in places.values()]
    for done, future in enumerate(as_completed(pending), start=1):
        future.result()
        compute.progress(STAGE, done, len(places))
    return frames


def _fill(
    frames: BoolArray,
    world: World,
    middle_m: FloatArray,
    looks: Sequence[Look],
    rows: Sequence[int],
) -> None:
    """Rows of all looks from one place."""
    here = [looks[row] for row in rows]
    first, detector = here[0]
    position_m = first.pose.position_m
    farthest_m = max(reach_m(unit.sensor, detector, world) for unit, detector in here)
    seen = _in_view(world, middle_m - (position_m - world.origin_m), [unit for unit, _ in here])
    # What is nowhere is not near: no ray is cast to what no look from here has in its view.
    views = replace(world.views, position_m=np.where(seen[:, None], world.views.position_m, np.nan))
    sight = cast_sight(
        replace(world, views=views),
        position_m,
        near_m=first.sensor.near_m,
        max_distance_m=farthest_m,
    )
    sensing = build_sensing(world, sight, position_m, detector)
    for row, (unit, detector) in zip(rows, here, strict=True):
        frames[row] = replace(sensing, detector=detector).frames(unit)


def _in_view(world: World, offset_m: FloatArray, units: Sequence[CandidatePose]) -> BoolArray:
    """Road users, by their middles relative to a mount, that any unit there has in its view."""
    distance_m = np.maximum(np.linalg.norm(offset_m, axis=1), 1.0e-6)
    half_angle = np.arcsin(np.minimum(1.0, world.radius_m / distance_m)) + _MARGIN_RAD
    is_seen = np.zeros(len(offset_m), dtype=bool)
    for unit in units:
        ahead = body_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg)[:, 0]
        off_axis = np.arccos(np.clip(offset_m @ ahead / distance_m, -1.0, 1.0))
        is_seen |= off_axis <= np.radians(0.5 * unit.sensor.diagonal_fov_deg) + half_angle
    return is_seen
