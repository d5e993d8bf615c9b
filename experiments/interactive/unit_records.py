"""Units as the scripts draw them: where, which way, what they look at, in which style."""

import math
from typing import Any

import numpy as np

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor, sensor_kind
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from placement.candidates import CandidatePose, is_ring
from placement.layout import Layout

from ..figures import BLUE, GREEN, ORANGE, PINK, SKY, VERMILION, unit_labels
from ..plan import ground_footprint
from ..round_views import blind_footprint, ground_rings

COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
DASHES = ("", "7 4", "7 3 1.5 3", "1.5 3")
RANGE_M = 35.0
_POINTS_PER_SIDE = 8
_ABOVE_ROAD_M = 0.1  # or the road would hide parts of lines that lie on it


def unit_records(layout: Layout) -> list[dict[str, Any]]:
    """Units of a layout for the player: centimetres, tenths of a degree."""
    labels = unit_labels(layout)
    return [
        {
            "name": labels[unit.id],
            "title": describe_unit(labels[unit.id], unit),
            "kind": "ring" if is_ring(unit.sensor) else sensor_kind(unit.sensor),
            "place": np.rint(100.0 * unit.pose.position_m[:2]).astype(int).tolist(),
            "yaw": round(10.0 * unit.pose.yaw_deg),
            "colour": COLOURS[index % len(COLOURS)],
            "dash": DASHES[index % len(DASHES)],
            "sees": _outline_cm(ground_footprint(unit, max_range_m=RANGE_M)),
            "blind": _outline_cm(blind_footprint(unit, max_range_m=RANGE_M)),
        }
        for index, unit in enumerate(layout.units)
    ]


def describe_unit(label: str, unit: CandidatePose) -> str:
    """A unit in words, for hovering."""
    name = label if label == unit.id else f"{label}, {unit.id}"
    return (
        f"{name}: {sensor_kind(unit.sensor)} {unit.sensor.name}, "
        f"{unit.pose.position_m[2]:.1f} m high" + (", scans all round" * is_ring(unit.sensor))
    )


def field_lines(unit: CandidatePose, *, max_range_m: float) -> list[FloatArray]:
    """Lines that show a unit's field of view.

    Parameters
    ----------
    unit : CandidatePose
        Sensor and pose.
    max_range_m : float
        How far. [m]

    Returns
    -------
    lines : list of (n, 3) float
        The border, and the edges from the sensor to its corners. Of a LiDAR that scans all round:
        where on the road its scan ends and begins, and four of its lowest beams. World frame. [m]
    """
    rings = ground_rings(unit, max_range_m=max_range_m) if is_ring(unit.sensor) else ()
    borders = [np.insert(ring, 2, _ABOVE_ROAD_M, axis=1) for ring in rings if len(ring)]
    borders = borders or [view_border(unit, max_range_m=max_range_m)]
    corners = borders[-1][:: len(borders[-1]) // 4]
    return [
        *(np.vstack([border, border[:1]]) for border in borders),
        *(np.stack([unit.pose.position_m, corner]) for corner in corners),
    ]


def view_border(unit: CandidatePose, *, max_range_m: float) -> FloatArray:
    """Where the rays through the border of a sensor's field of view end.

    Parameters
    ----------
    unit : CandidatePose
        Sensor and pose.
    max_range_m : float
        Rays end here, or on the road plane. [m]

    Returns
    -------
    ends_m : (32, 3) float
        In order around the border; every eighth is a corner. World frame. [m]
    """
    directions = _border_directions(unit.sensor) @ (
        body_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg).T
    )
    length = np.full(len(directions), max_range_m)
    falls = directions[:, 2] < -1.0e-9
    to_ground = -unit.pose.position_m[2] / directions[falls, 2]
    length[falls] = np.minimum(length[falls], np.maximum(to_ground, 0.0))
    ends: FloatArray = unit.pose.position_m + length[:, None] * directions
    return ends


def _border_directions(sensor: Sensor) -> FloatArray:
    """Unit vectors around the border, from the upper left corner on, (32, 3). Body frame."""
    step = np.linspace(-1.0, 1.0, _POINTS_PER_SIDE, endpoint=False)
    one = np.ones_like(step)
    across = np.concatenate([step, one, -step, -one])
    down = np.concatenate([-one, step, one, -step])
    half_width = math.radians(0.5 * sensor.horizontal_fov_deg)
    half_height = math.radians(0.5 * sensor.vertical_fov_deg)
    if isinstance(sensor, LidarModel):  # equal steps of angle
        azimuth, elevation = -across * half_width, -down * half_height
        directions: FloatArray = np.stack(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ],
            axis=1,
        )
        return directions
    directions = np.stack(
        [np.ones_like(across), -across * math.tan(half_width), -down * math.tan(half_height)],
        axis=1,
    )
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions


def _outline_cm(corners_m: FloatArray) -> list[list[int]]:
    """Corners without those that nobody would miss."""
    import shapely

    if len(corners_m) < 3:
        return []
    simple = shapely.Polygon(corners_m).simplify(0.1)
    outline: list[list[int]] = (
        np.rint(100.0 * np.asarray(simple.exterior.coords)[:-1]).astype(int).tolist()
    )
    return outline
