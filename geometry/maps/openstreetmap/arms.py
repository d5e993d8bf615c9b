"""Where streets end at a junction: how far from its nodes, and which of them are one arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from .defaults import DEFAULTS
from .network import Street
from .strips import axis_points, surface

_STEP_M = 0.5
_SAME_ARM_COSINE = np.cos(np.radians(25.0))  # as geometry.junction groups lanes
_SAME_ARM_GAP_M = 12.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A street that leaves a junction.

    Attributes
    ----------
    street : Street
        Away from the junction, from its node.
    index : int
        Of the street, among all.
    is_begin : bool
        The street as it is listed begins here; otherwise it ends here and is turned round.
    mouth_m : float
        How far from its node lanes begin. [m]
    """

    street: Street
    index: int
    is_begin: bool
    mouth_m: float = 0.0

    @property
    def direction(self) -> FloatArray:
        """Unit vector away from the junction where the arm begins, (2,)."""
        begin_m = min(self.mouth_m, max(self.street.length_m - 5.0, 0.0))
        (near, far), _ = axis_points(self.street, [begin_m, begin_m + 10.0])
        unit: FloatArray = (far - near) / max(float(np.hypot(*(far - near))), 1e-9)
        return unit

    @property
    def mouth_point_m(self) -> FloatArray:
        """Where the street crosses the outline, (2,)."""
        (point,), _ = axis_points(self.street, [self.mouth_m])
        return np.asarray(point)

    @property
    def half_width_m(self) -> float:
        """Of its carriageway at the mouth, in metres."""
        return 0.5 * self.street.sections[self.street.part_at(self.mouth_m)].width_m


def place_mouths(arms: Sequence[Arm], inside: Sequence[Street]) -> list[Arm]:
    """Find how far from a junction's nodes its arms begin.

    Parameters
    ----------
    arms : sequence of Arm
        Of one junction.
    inside : sequence of Street
        Those between its nodes.

    Returns
    -------
    arms : list of Arm
        They begin where their carriageways have left those of the others, and a corner farther;
        the carriageways of one arm side by side.
    """
    limits = DEFAULTS["junction"]
    directions = [arm.direction for arm in arms]
    surfaces = [
        surface(arm.street, 0.0, min(arm.street.length_m, limits["max_mouth_m"] + 5.0))
        for arm in arms
    ]
    middle = [surface(street, 0.0, street.length_m) for street in inside]
    placed = []
    for index, arm in enumerate(arms):
        others = [
            other_surface
            for other, other_surface in enumerate(surfaces)
            if other != index
            and not (
                directions[index] @ directions[other] >= _SAME_ARM_COSINE
                and _is_one_road(arm, arms[other])
            )
        ]
        clear_m = _clear_from_m(arm.street, shapely.union_all([*middle, *others]))
        mouth_m = min(clear_m + limits["corner_m"], limits["max_mouth_m"])
        placed.append(replace(arm, mouth_m=mouth_m))
    aligned = list(placed)
    for group in group_arms(placed):
        if len(group) > 1:
            mean = np.mean([placed[index].direction for index in group], axis=0)
            ahead = {index: float(placed[index].mouth_point_m @ mean) for index in group}
            for index in group:
                mouth_m = placed[index].mouth_m + max(ahead.values()) - ahead[index]
                aligned[index] = replace(
                    placed[index], mouth_m=min(mouth_m, limits["max_mouth_m"] + 10.0)
                )
    return aligned


def group_arms(arms: Sequence[Arm]) -> list[list[int]]:
    """Indices of streets that lead the same way side by side, and so are one arm."""
    directions = [arm.direction for arm in arms]
    points = [arm.mouth_point_m for arm in arms]
    group = list(range(len(arms)))
    for index, arm in enumerate(arms):
        for other in range(index):
            mean = directions[index] + directions[other]
            across_m = abs(float((points[other] - points[index]) @ [-mean[1], mean[0]]))
            reach_m = arm.half_width_m + arms[other].half_width_m + _SAME_ARM_GAP_M
            if (
                group[other] != group[index]
                and directions[index] @ directions[other] >= _SAME_ARM_COSINE
                and across_m <= reach_m * np.hypot(*mean)
            ):
                group = [group[other] if number == group[index] else number for number in group]
    return [
        [index for index, number in enumerate(group) if number == wanted]
        for wanted in dict.fromkeys(group)
    ]


def _is_one_road(one: Arm, other: Arm) -> bool:
    """Leading the same way they are the carriageways of a road, which may overlap."""
    edges = [one.street.parts[0], other.street.parts[0]]
    is_pair = all(edge.is_oneway for edge, _ in edges) and edges[0][1] != edges[1][1]
    return is_pair or (edges[0][0].name != "" and edges[0][0].name == edges[1][0].name)


def _clear_from_m(street: Street, others: BaseGeometry) -> float:
    """How far along a street its cross-section first touches no other surface, in metres."""
    limit_m = DEFAULTS["junction"]["max_mouth_m"]
    stations = np.arange(0.0, limit_m, _STEP_M)
    half = np.array([0.5 * street.sections[street.part_at(one)].width_m for one in stations])
    half -= 0.05  # neighbours may touch
    middle, across = axis_points(street, stations)
    ends = [middle + sign * half[:, None] * across for sign in (1.0, -1.0)]
    shapely.prepare(others)
    is_touching = shapely.intersects(shapely.linestrings(np.stack(ends, axis=1)), others)
    is_touching[0] = True  # where the streets meet
    clear = np.flatnonzero(~is_touching)
    return float(stations[clear[0]]) if len(clear) else limit_m
