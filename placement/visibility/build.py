"""Candidate poses and runs to a detection table: project the points that the rays reach."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.poses import camera_rotation
from geometry.raycast import FloatRays
from geometry.scene import Scene
from geometry.sensors import CameraModel
from scenarios.runs import FrameAxis, Run

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..detector import Detector
from .casting import Sight, World, build_world, cast_sight

N_POINTS = 160  # per VRU: neighbouring points are about 10 cm apart
_MIN_DEPTH_M = 0.01  # points beside or behind the lens are projected far outside the image

Progress = Callable[[int, int], None]


def build_detection_table(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    detector: Detector,
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
    detector : Detector
        What counts as a detection.
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


def max_distance_m(camera: CameraModel, detector: Detector, *, vru_height_m: float) -> float:
    """Distance beyond which no VRU is high enough in the image to be detected.

    A body of extent h whose nearest point is at distance d from the lens spans at most
    h / d * f / cos^2(e) pixels, where e is the largest angle off the optical axis.

    Parameters
    ----------
    camera : CameraModel
        Intrinsics.
    detector : Detector
        Its smallest box.
    vru_height_m : float
        Largest extent of a body. [m]

    Returns
    -------
    distance_m : float
        Infinite if the detector takes boxes of any height. [m]
    """
    if detector.min_box_height_px == 0.0:
        return np.inf
    stretch = 1.0 / np.cos(np.radians(0.5 * camera.diagonal_fov_deg)) ** 2
    return float(vru_height_m * camera.focal_length_px * stretch / detector.min_box_height_px)


def _group_by_mount(candidates: Sequence[CandidatePose]) -> list[IntArray]:
    """Rows that share all rays: same position, same near limit."""
    groups: dict[tuple[float, ...], list[int]] = {}
    for row, candidate in enumerate(candidates):
        key = (*candidate.pose.position_m.tolist(), candidate.camera.near_m)
        groups.setdefault(key, []).append(row)
    return [np.array(rows) for rows in groups.values()]


def _mount_rows(
    world: World, candidates: Sequence[CandidatePose], detector: Detector
) -> NDArray[np.uint8]:
    """Packed rows of all candidates of one mount position."""
    position_m, near_m = candidates[0].pose.position_m, candidates[0].camera.near_m
    radius_m = max(
        float(np.linalg.norm(surface.points_m - surface.points_m.mean(axis=0), axis=1).max())
        for surface in world.surfaces
    )
    # To the nearest point; to the middle of the footprint it is at most a body's extent more.
    reach_m = 2.0 * radius_m + max(
        max_distance_m(candidate.camera, detector, vru_height_m=2.0 * radius_m)
        for candidate in candidates
    )
    sight = cast_sight(world, position_m, near_m=near_m, max_distance_m=reach_m)
    offsets = world.views.points_m[sight.view_index] - (position_m - world.origin_m).astype(
        np.float32
    )
    middle = offsets.mean(axis=1)
    distance = np.linalg.norm(middle, axis=1)
    half_angle = np.arcsin(np.minimum(1.0, radius_m / np.maximum(distance, 1e-6)))
    # One more entry, never detected, for frames in which nothing is seen (index -1).
    detected = np.zeros((len(candidates), len(sight.view_index) + 1), dtype=bool)
    for row, candidate in enumerate(candidates):
        rotation = camera_rotation(candidate.pose.yaw_deg, candidate.pose.pitch_deg)
        off_axis = np.arccos(np.clip(middle @ rotation[:, 2] / np.maximum(distance, 1e-6), -1, 1))
        limit = np.radians(0.5 * candidate.camera.diagonal_fov_deg) + half_angle
        entries = np.flatnonzero(off_axis <= limit)
        detected[row, entries] = _detect(
            offsets[entries], sight, entries, rotation, candidate.camera, detector
        )
    return np.packbits(detected[:, sight.entry_of_frame], axis=1, bitorder="little")


def _detect(
    offsets_m: FloatRays,
    sight: Sight,
    entries: IntArray,
    rotation: FloatArray,
    camera: CameraModel,
    detector: Detector,
) -> BoolArray:
    """Whether each entry is detected by one camera, (n,)."""
    in_camera = offsets_m.reshape(-1, 3) @ rotation.astype(np.float32)
    shape = offsets_m.shape[:2]
    depth = in_camera[:, 2]
    per_depth = np.float32(camera.focal_length_px) / np.maximum(depth, _MIN_DEPTH_M)
    columns = (in_camera[:, 0] * per_depth + np.float32(0.5 * camera.width_px)).reshape(shape)
    rows = (in_camera[:, 1] * per_depth + np.float32(0.5 * camera.height_px)).reshape(shape)
    amodal = _boxes(columns, rows)
    # Of a body that the image cuts off, only the points inside the image count.
    limits = np.array([camera.width_px, camera.height_px] * 2)
    is_cut = (amodal < 0.0).any(axis=1) | (amodal > limits).any(axis=1)
    is_cut |= depth.reshape(shape).min(axis=1, initial=np.float32(np.inf)) <= _MIN_DEPTH_M
    is_outside = np.zeros(shape, dtype=bool)
    cut = np.flatnonzero(is_cut)
    is_outside[cut] = (
        (depth.reshape(shape)[cut] <= _MIN_DEPTH_M)
        | (np.abs(columns[cut] - 0.5 * camera.width_px) > 0.5 * camera.width_px)
        | (np.abs(rows[cut] - 0.5 * camera.height_px) > 0.5 * camera.height_px)
    )
    amodal[cut] = _boxes(columns[cut], rows[cut], is_outside[cut])
    # The visible part of a body that nothing else hides has the body's own box.
    visible = amodal.copy()
    part = np.flatnonzero(~sight.is_whole[entries])
    hidden = ~sight.is_visible[entries[part]] | is_outside[part]
    visible[part] = _boxes(columns[part], rows[part], hidden)
    return detector.is_detected(visible, amodal)


def _boxes(
    columns: NDArray[np.floating[Any]],
    rows: NDArray[np.floating[Any]],
    hidden: BoolArray | None = None,
) -> FloatArray:
    """Boxes around the points of each entry that are not hidden, (n, 4); zeros where all are."""
    boxes = np.empty((len(columns), 4))
    for axis, values in enumerate((columns, rows)):
        low = values if hidden is None else np.where(hidden, np.float32(np.inf), values)
        high = values if hidden is None else np.where(hidden, np.float32(-np.inf), values)
        boxes[:, axis] = low.min(axis=1, initial=np.float32(np.inf))
        boxes[:, axis + 2] = high.max(axis=1, initial=np.float32(-np.inf))
    boxes[boxes[:, 0] > boxes[:, 2]] = 0.0
    return boxes
