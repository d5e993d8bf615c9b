"""Candidate poses and runs to a detection table, one mount position at a time."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import IntArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel
from geometry.scene import Scene
from scenarios.runs import FrameAxis, Run

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..detectors import PlanningDetector
from .casting import World, build_world, cast_sight
from .sensing import Sensing, build_sensing, max_distance_m

N_POINTS = 160  # per VRU: neighbouring points are about 10 cm apart

Progress = Callable[[int, int], None]


def build_detection_table(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    detector: PlanningDetector,
    seed: int = 0,
    workers: int = 1,
    on_progress: Progress | None = None,
) -> DetectionTable:
    """Detections of every candidate pose in every frame.

    Parameters
    ----------
    scene : Scene
        What stands still.
    candidates : sequence of CandidatePose
        The rows of the table.
    runs : sequence of Run
        All with the same VUT.
    axis : FrameAxis
        Of `runs`: the columns of the table.
    detector : PlanningDetector
        What counts as a detection of a camera; a LiDAR counts points.
    seed : int
        Of the points on the VRUs.
    workers : int
        Threads.
    on_progress : callable, optional
        Called with mount positions done and their number.

    Returns
    -------
    table : DetectionTable
        V[c, f].
    """
    world = build_world(scene, runs, n_points=N_POINTS, seed=seed)
    mounts = _group_by_mount(candidates)
    packed = np.zeros((len(candidates), -(-axis.n_frames // 8)), dtype=np.uint8)

    def fill(rows: IntArray) -> None:
        packed[rows] = _mount_rows(world, [candidates[row] for row in rows], detector)

    # One BLAS thread per worker: the matrices are small, and idle BLAS threads spin.
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        pending = [pool.submit(fill, rows) for rows in mounts]
        try:
            for done, future in enumerate(as_completed(pending), start=1):
                future.result()
                if on_progress is not None:
                    on_progress(done, len(mounts))
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
