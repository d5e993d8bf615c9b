"""What a few poses detect, each under a detector of its own: rays only to what is in view."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.poses import body_rotation

from .candidates import CandidatePose
from .detectors import PlanningDetector
from .setting import Setting
from .visibility.build import N_POINTS
from .visibility.casting import World, build_world, cast_sight
from .visibility.sensing import build_sensing, reach_m

_MARGIN_RAD = 1.0e-3  # for the rounding of single precision

Progress = Callable[[int, int], None]
Look = tuple[CandidatePose, PlanningDetector]


def detected_frames(
    setting: Setting,
    looks: Sequence[Look],
    *,
    seed: int,
    pool: ThreadPoolExecutor,
    on_progress: Progress | None,
) -> BoolArray:
    """Frames in which units detect, each with a detector of its own.

    Parameters
    ----------
    setting : Setting
        Scene and runs.
    looks : sequence of (CandidatePose, PlanningDetector)
        Rays are cast once for all from one place, and only to what any of them has in its view.
    seed : int
        Of the points on the VRUs.
    pool : ThreadPoolExecutor
        Works on the places.
    on_progress : callable, optional
        Called with the number of places done, and of all.

    Returns
    -------
    detected : (n_looks, n_frames) bool
        The rows that :func:`placement.visibility.build_detection_table` has for each.
    """
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=seed)
    places: dict[tuple[float, ...], list[int]] = {}
    for row, (unit, _) in enumerate(looks):
        key = (*unit.pose.position_m.tolist(), unit.sensor.near_m)
        places.setdefault(key, []).append(row)
    frames = np.zeros((len(looks), setting.axis.n_frames), dtype=bool)
    middle_m = world.views.points_m.mean(axis=1, dtype=np.float64)
    pending = [pool.submit(_fill, frames, world, middle_m, looks, rows) for rows in places.values()]
    for done, future in enumerate(as_completed(pending), start=1):
        future.result()
        if on_progress is not None:
            on_progress(done, len(places))
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
