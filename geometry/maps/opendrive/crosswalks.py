"""Crosswalks as lines: from kerb to kerb."""

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from .attributes import take_number_or
from .copies import Copy, Outline, Sweep, box_corners, place
from .junctions import JunctionRecord
from .roads import Road

_CLEARLY_LONGER = 1.3  # of two sides: below it, people cross more nearly across the road
_MIN_LENGTH_M = 0.5


def crosswalk_line(
    road: Road, one: Copy | Sweep, outlines: Sequence[Outline], turn_rad: float
) -> FloatArray | None:
    """Line on which pedestrians cross.

    Parameters
    ----------
    road : Road
        That the object belongs to.
    one : Copy or Sweep
        Where.
    outlines : sequence of Outline
        What it has there.
    turn_rad : float
        Of its length against the road. [rad]

    Returns
    -------
    line_m : (2, 2) float or None
        Through the middle of its smallest box, the long way; where that is nearly a square, across
        the road. Two corners are the line itself. None: it has no extent. [m]
    """
    copy = one.start if isinstance(one, Sweep) else one
    _, heading = place(road, copy)
    outer = next((outline for outline in outlines if outline.is_outer), None)
    if outer is not None:
        corners = outer.points_m
    else:
        box = box_corners(copy, turn_rad)
        if box is None:
            return None
        corners = road.place(box[:, 0], box[:, 1])[0][:, :2]
    if len(corners) == 2:
        return corners if np.hypot(*(corners[1] - corners[0])) > _MIN_LENGTH_M else None
    return _long_way(corners, np.array([-np.sin(heading), np.cos(heading)]))


def signal_crosswalk(
    element: Element, road: Road, s_m: float, t_m: float, length_m: float, where: str
) -> FloatArray:
    """Line (2, 2) across the road of a crosswalk that is written as a painted signal."""
    points, heading = road.place(np.array([s_m]), np.array([t_m]))
    # Around the other way is the same line: whole and half turns are of no matter.
    angle = heading[0] + take_number_or(element, "hOffset", where, 0.0) + 0.5 * np.pi
    across = np.array([np.cos(angle), np.sin(angle)])
    line: FloatArray = points[0, :2] + 0.5 * length_m * np.array([[-1.0], [1.0]]) * across
    return line


def cross_paths(
    records: Mapping[str, JunctionRecord], roads: Mapping[str, Road]
) -> list[FloatArray]:
    """Lines of the paths on which pedestrians cross junctions (OpenDRIVE 1.8, <crossPath>)."""
    lines = []
    for record in records.values():
        for path in record.element.findall("crossPath"):
            road = roads.get(path.get("crossingRoad", ""))
            if road is not None:
                ends, _ = road.place(np.array([0.0, road.length_m]), np.zeros(2))
                if np.hypot(*(ends[1] - ends[0])[:2]) > _MIN_LENGTH_M:
                    lines.append(ends[:, :2])
    return lines


def _long_way(corners_m: FloatArray, across_road: FloatArray) -> FloatArray | None:
    import shapely

    with np.errstate(divide="ignore", invalid="ignore"):  # flags that GEOS leaves behind
        box = shapely.MultiPoint(corners_m).minimum_rotated_rectangle
    if box.geom_type != "Polygon":
        return None
    ring = np.asarray(box.exterior.coords)[:4]
    sides = np.array([ring[1] - ring[0], ring[2] - ring[1]])
    lengths = np.hypot(*sides.T)
    longer = int(lengths.argmax())
    if lengths[longer] < _CLEARLY_LONGER * lengths[1 - longer]:
        longer = int(np.abs(sides @ across_road / lengths).argmax())
    if lengths[longer] < _MIN_LENGTH_M:
        return None
    middle = ring.mean(axis=0)
    line: FloatArray = middle + 0.5 * np.array([[-1.0], [1.0]]) * sides[longer]
    return line
