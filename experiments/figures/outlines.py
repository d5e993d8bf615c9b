"""Outlines of the ground that units look at, and their directions in words."""

import math

import numpy as np

from geometry.arrays import FloatArray
from geometry.junction import COMPASS
from geometry.lidar import LidarModel
from geometry.poses import camera_rotation
from geometry.sensors import CameraModel
from placement.candidates import CandidatePose, is_in_view, is_ring

from ..language import tr

_N_BEARINGS = 180
_STEP_M = 0.1


def compass_word(unit: CandidatePose) -> str:
    """Point of the compass to which a unit looks.

    "all round" of one that looks to none.
    """
    if is_ring(unit.sensor):
        return tr("all round")
    return tr(COMPASS[round(unit.pose.yaw_deg / 45.0) % 8])


def looking_words(unit: CandidatePose) -> str:
    """Direction of a unit's view, for a sentence.

    "looking to the east" or "scanning all round".
    """
    if is_ring(unit.sensor):
        return tr("scanning all round")
    return tr("looking to the {compass}", compass=compass_word(unit))


def ground_footprint(
    unit: CandidatePose, *, max_range_m: float, max_depth_m: float = math.inf
) -> FloatArray:
    """Footprint of a unit's image on the road plane, if nothing stood on it.

    A convex polygon, (n, 2), counter-clockwise, up to `max_range_m` from the foot of
    the camera and up to `max_depth_m` along its axis; empty if it sees no ground there.
    Through a lens it need not be convex, and both limits are of the distance from the
    foot. Of a LiDAR that opens half a turn or more it is the outer one of
    :func:`.sensors.ground_rings`. World frame. [m]
    """
    if is_wide(unit):
        return ground_rings(unit, max_range_m=max_range_m)[0]
    if isinstance(unit.sensor, CameraModel) and not unit.sensor.is_pinhole:
        return _lens_footprint(unit, max_range_m=min(max_range_m, max_depth_m))
    position = unit.pose.position_m
    # A circle around the foot, cut by planes through the lens and the image's sides.
    angles = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    corners = position[:2] + max_range_m * np.stack(
        [np.cos(angles), np.sin(angles)], axis=1
    )
    half_width, half_height = np.tan(
        np.radians(
            [0.5 * unit.sensor.horizontal_fov_deg, 0.5 * unit.sensor.vertical_fov_deg]
        )
    )
    # Inward normals of these planes, in the camera frame.
    across = [[side, 0.0, half_width] for side in (1.0, -1.0)]
    normals_camera = np.array(
        [*across, *([0.0, side, half_height] for side in (1.0, -1.0))]
    )
    R_world_camera = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg)
    # The farthest depth is one more plane, across the optical axis.
    if np.isfinite(max_depth_m):
        axis = R_world_camera[:, 2]
        depth_m = (corners - position[:2]) @ axis[:2] - position[2] * axis[2]
        corners = _clip(corners, max_depth_m - depth_m)
    for normal in normals_camera @ R_world_camera.T:
        inside = (corners - position[:2]) @ normal[:2] - position[2] * normal[2]
        corners = _clip(corners, inside)
    return corners


def _lens_footprint(unit: CandidatePose, *, max_range_m: float) -> FloatArray:
    """Ground that a lens shows, from the nearest to the farthest point.

    Found bearing by bearing.
    """
    # A grid of points on the road around the foot, by bearing and distance.
    away_m = np.arange(0.25, max_range_m + 0.25, 0.25)
    bearing = np.radians(unit.pose.yaw_deg + np.arange(-180.0, 180.0))
    ways = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    ground = unit.pose.position_m[:2] + away_m[None, :, None] * ways[:, None]
    points = np.concatenate([ground, np.zeros((*ground.shape[:2], 1))], axis=2)
    is_seen = is_in_view(unit, points.reshape(-1, 3)).reshape(ground.shape[:2])
    # The outline runs along the far ends, and back along the near ones.
    rows = np.flatnonzero(is_seen.any(axis=1))
    near = is_seen.argmax(axis=1)[rows]
    far = is_seen.shape[1] - 1 - is_seen[:, ::-1].argmax(axis=1)[rows]
    return np.concatenate([ground[rows, far], ground[rows, near][::-1]])


def _clip(corners: FloatArray, inside: FloatArray) -> FloatArray:
    """Part of a convex polygon where `inside` is positive.

    `inside` has the values of a linear function at the corners.
    """
    kept: list[FloatArray] = []
    for index in range(len(corners)):
        here = inside[index - 1]
        there = inside[index]
        # An edge that leads across the border gets a corner there.
        if (here > 0.0) != (there > 0.0):
            share = here / (here - there)
            kept.append(
                corners[index - 1] + share * (corners[index] - corners[index - 1])
            )
        if there > 0.0:
            kept.append(corners[index])
    return np.array(kept).reshape(-1, 2)


def is_wide(unit: CandidatePose) -> bool:
    """True for a LiDAR that opens half a turn or more.

    No picture plane holds its view.
    """
    return (
        isinstance(unit.sensor, LidarModel) and unit.sensor.horizontal_fov_deg >= 180.0
    )


def ground_rings(
    unit: CandidatePose, *, max_range_m: float
) -> tuple[FloatArray, FloatArray]:
    """Outlines of the road that a wide LiDAR's beams meet.

    As if nothing stood on it.

    Where the ground that it meets ends and begins, each (n, 2), counter-clockwise
    around the foot; empty where there is none. To the sides where no ground is met the
    inner one is the foot. [m]
    """
    foot = unit.pose.position_m[:2]
    angles = np.linspace(0.0, 2.0 * np.pi, _N_BEARINGS, endpoint=False)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radii = np.linspace(0.0, max_range_m, round(max_range_m / _STEP_M) + 1)
    points = np.zeros((_N_BEARINGS, len(radii), 3))
    points[..., :2] = foot + radii[:, None] * ways[:, None, :]
    is_met = is_in_view(unit, points.reshape(-1, 3)).reshape(_N_BEARINGS, len(radii))
    has_any = is_met.any(axis=1)
    far = np.where(has_any, radii[len(radii) - 1 - is_met[:, ::-1].argmax(axis=1)], 0.0)
    near = np.where(has_any, radii[is_met.argmax(axis=1)], 0.0)
    empty = np.empty((0, 2))
    return (
        foot + far[:, None] * ways if has_any.any() else empty,
        foot + near[:, None] * ways if near.any() else empty,
    )


def blind_footprint(unit: CandidatePose, *, max_range_m: float) -> FloatArray:
    """Ground around the foot of a wide LiDAR that its lowest beams pass over.

    Shape (n, 2). Empty if there is none, and of every other sensor: its outline says
    where it sees. [m]
    """
    if not is_wide(unit):
        return np.empty((0, 2))
    return ground_rings(unit, max_range_m=max_range_m)[1]
