"""Where things stand at a junction, in words: a corner, or a street and how far out."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, float_array
from .errors import InputError
from .junction import COMPASS, Arm, arm_of_road, build_junction, distance_to_outline_m
from .scene import Scene

_CORNER_M = 15.0  # from the outline of the junction's road surface
_STRAIGHT = 0.7  # length of the sum of two arms' directions: an angle of 140 degrees and more


def compass_point(way_m: FloatArray) -> str:
    """The nearest of eight points of the compass."""
    return COMPASS[round(np.degrees(np.arctan2(way_m[1], way_m[0])) / 45.0) % 8]


def compass_bearing_deg(yaw_deg: float) -> float:
    """A direction clockwise from north, at least 0 and below 360, as installers read it.

    Examples
    --------
    >>> compass_bearing_deg(0.0), compass_bearing_deg(135.0)
    (90.0, 315.0)
    """
    return (90.0 - yaw_deg) % 360.0


def street_names(scene: Scene) -> dict[str, str]:
    """Names of the streets of a junction's arms, by the arm; arms without a name are left out."""
    junction = build_junction(scene)
    names: dict[str, dict[str, None]] = {}
    for road in scene.roads:
        arm = arm_of_road(road, junction)
        if arm is not None and not re.fullmatch(r"(way|road) \S+", road.name):
            names.setdefault(arm, {})[road.name] = None
    return {arm: " / ".join(found) for arm, found in names.items()}


def whereabouts(scene: Scene, positions_m: ArrayLike) -> list[str]:
    """Places at a junction in words, such as "north-west corner, Mill Lane and High Street".

    `scene`: the junction. `positions_m` (n, 2): places in the world frame. Returns `words`: within
    15 m of the junction's outline a corner, with the streets of the arms on either side; farther
    out the nearest arm, with its street. Empty where the scene has no arms.
    """
    import shapely

    positions = float_array(positions_m, (-1, 2), "positions_m")
    try:
        arms = build_junction(scene).arms
    except InputError:
        return [""] * len(positions)
    streets = street_names(scene)
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    lines = {name: _lanes(arm) for name, arm in arms.items()}
    bearings = {name: _bearing(arm_mouth(arm) - middle) for name, arm in arms.items()}
    found = []
    for position in positions:
        away_m = distance_to_outline_m(position, scene.outline_m)
        if away_m <= _CORNER_M:
            way = position - middle
            beside = _beside(_bearing(way), bearings)
            known = [streets[name] for name in beside if name in streets]
            corner = _between([bearings[name] for name in beside])
            words = [
                f"{compass_point(way if corner is None else corner)} corner",
                " and ".join(dict.fromkeys(known)),
            ]
        else:
            point = shapely.Point(position)
            name = min(lines, key=lambda one: lines[one].distance(point))
            words = [f"{name} arm", streets.get(name, ""), f"{away_m:.0f} m out"]
        found.append(", ".join(word for word in words if word))
    return found


def _lanes(arm: Arm) -> Any:
    import shapely

    lanes = (*arm.lanes_in, *arm.lanes_out)
    return shapely.MultiLineString([lane.centreline_m for lane in lanes])


def arm_mouth(arm: Arm) -> FloatArray:
    """Middle of an arm's lanes where they meet the junction, (2,)."""
    ends = [lane.centreline_m[-1] for lane in arm.lanes_in]
    middle: FloatArray = np.mean([*ends, *(lane.centreline_m[0] for lane in arm.lanes_out)], axis=0)
    return middle


def _bearing(way_m: FloatArray) -> float:
    return float(np.arctan2(way_m[1], way_m[0]))


def _between(bearings: Sequence[float]) -> FloatArray | None:
    """Way halfway between two arms, (2,); None where they lead nearly straight on."""
    way: FloatArray = np.sum([[np.cos(one), np.sin(one)] for one in bearings], axis=0)
    return way if float(np.hypot(*way)) > _STRAIGHT else None


def _beside(bearing: float, arms: dict[str, float]) -> Sequence[str]:
    turns = {name: (angle - bearing) % (2.0 * np.pi) for name, angle in arms.items()}
    return [max(turns, key=turns.__getitem__), min(turns, key=turns.__getitem__)]
