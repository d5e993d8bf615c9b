"""Draw and describe sensors that look to no particular side: LiDARs that scan all round."""

import numpy as np
from matplotlib.path import Path

from geometry.arrays import FloatArray
from geometry.junction import COMPASS
from geometry.lidar import LidarModel
from placement.candidates import CandidatePose, is_in_view, is_ring

_N_BEARINGS = 180
_STEP_M = 0.1

ALL_ROUND = "all round"


def compass_word(unit: CandidatePose) -> str:
    """Point of the compass to which a unit looks; "all round" of one that looks to none."""
    return ALL_ROUND if is_ring(unit.sensor) else COMPASS[round(unit.pose.yaw_deg / 45.0) % 8]


def looking_words(unit: CandidatePose) -> str:
    """Direction of a unit's view, for a sentence: "looking to the east" or "scanning all round"."""
    word = compass_word(unit)
    return f"scanning {word}" if word == ALL_ROUND else f"looking to the {word}"


def is_wide(unit: CandidatePose) -> bool:
    """True for a LiDAR that opens half a turn or more: no picture plane holds its view."""
    return isinstance(unit.sensor, LidarModel) and unit.sensor.horizontal_fov_deg >= 180.0


def ground_rings(unit: CandidatePose, *, max_range_m: float) -> tuple[FloatArray, FloatArray]:
    """Outlines of the road plane that a wide LiDAR's beams meet, if nothing stood on it.

    Where the ground ends that it meets, and where that begins, each (n, 2): below lies what the
    lowest beams pass over. Both counter-clockwise around the foot, to a tenth of a metre; empty
    where there is none, and the inner one is the foot itself to the sides where no ground is met.
    World frame. [m]
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

    Shape (n, 2). Empty if there is none, and of every other sensor: its outline says where it sees.
    [m]
    """
    if not is_wide(unit):
        return np.empty((0, 2))
    return ground_rings(unit, max_range_m=max_range_m)[1]


def ring_path(*outlines_m: FloatArray) -> Path:
    """Outlines as one shape to draw: what is inside the second one is a hole in the first.

    Outlines are (n, 2), counter-clockwise, not closed. [m]
    """
    rings = [
        Path(np.vstack([corners, corners[:1]])[:: -1 if index else 1], closed=True)
        for index, corners in enumerate(outlines_m)
        if len(corners)
    ]
    return Path.make_compound_path(*rings)
