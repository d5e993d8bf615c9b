"""A junction as traffic sees it: arms, the lanes that lead in and out, where pedestrians cross."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray, float_array, freeze
from .errors import InputError
from .scene import Lane, Scene

COMPASS = (
    "east",
    "north-east",
    "north",
    "north-west",
    "west",
    "south-west",
    "south",
    "south-east",
)
_AT_OUTLINE_M = 1.5  # lanes end at the junction's outline but for the rounding of the map
_SAME_POINT_M = 0.5  # between one piece of a lane and the next
_ARM_SPREAD_DEG = 40.0  # lanes of one arm agree within this
_CROSSWALK_INSIDE_MOUTH_M = 2.0
# Euro NCAP's junction: arms begin 11.5 m from the centre, pedestrians cross 9.5 m from it.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A straight line on the road, with a direction.

    Attributes
    ----------
    point_m : (2,) float
        A point of it: east, north. [m]
    direction : (2,) float
        Unit vector.
    """

    point_m: FloatArray
    direction: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_m", float_array(self.point_m, (2,), "point_m"))
        direction = float_array(self.direction, (2,), "direction")
        object.__setattr__(self, "direction", freeze(direction / np.hypot(*direction)))

    @property
    def left(self) -> FloatArray:
        """Unit vector to the left of the direction, (2,)."""
        return np.array([-self.direction[1], self.direction[0]])

    @property
    def yaw_deg(self) -> float:
        """Direction in degrees, counter-clockwise from east."""
        return float(np.degrees(np.arctan2(self.direction[1], self.direction[0])))

    def at(self, distance_m: float, left_m: float = 0.0) -> FloatArray:
        """Point some metres ahead of the line's point and to the left of it, (2,)."""
        point: FloatArray = self.point_m + distance_m * self.direction + left_m * self.left
        return point

    def coordinates(self, point_m: ArrayLike) -> FloatArray:
        """Metres ahead of the line's point and to the left of it at which points lie, (..., 2)."""
        offset = np.asarray(point_m, dtype=np.float64) - self.point_m
        return np.stack([offset @ self.direction, offset @ self.left], axis=-1)

    def crossing_with(self, other: "Line") -> FloatArray:
        """Where two lines meet, (2,); they must not be parallel."""
        matrix = np.stack([self.direction, -other.direction], axis=1)
        return self.at(float(np.linalg.solve(matrix, other.point_m - self.point_m)[0]))

    def turned(self, angle_deg: float) -> "Line":
        """The line through the same point, turned counter-clockwise."""
        angle = np.radians(angle_deg)
        east, north = self.direction
        return replace(
            self,
            direction=np.array(
                [
                    east * np.cos(angle) - north * np.sin(angle),
                    east * np.sin(angle) + north * np.cos(angle),
                ]
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A road that ends at a junction. Traffic keeps right.

    Attributes
    ----------
    name : str
        Where it lies, seen from the junction: "north", "east", ...
    lanes_in, lanes_out : tuple of Lane
        Into the junction and out of it, whole as far as the map goes; from the kerb to the road's
        axis, parking lanes too.
    crosswalk : Line
        Where pedestrians cross the arm.
    """

    name: str
    lanes_in: tuple[Lane, ...]
    lanes_out: tuple[Lane, ...]
    crosswalk: Line

    @property
    def entry_lanes(self) -> tuple[Lane, ...]:
        """Lanes that are driven into the junction, from the kerb to the axis."""
        return tuple(lane for lane in self.lanes_in if lane.kind == "driving")

    @property
    def exit_lanes(self) -> tuple[Lane, ...]:
        """Lanes that are driven out of the junction, from the kerb to the axis."""
        return tuple(lane for lane in self.lanes_out if lane.kind == "driving")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Junction:
    """Arms of a scene's junction.

    Attributes
    ----------
    name : str
        Of the scene.
    arms : mapping of str to Arm
        By name.
    """

    name: str
    arms: dict[str, Arm]

    def __repr__(self) -> str:
        return f"Junction({self.name!r}, arms {', '.join(self.arms)})"


def build_junction(scene: Scene) -> Junction:
    """Find the arms of a scene's junction in its lanes.

    Parameters
    ----------
    scene : Scene
        Its lanes and the outline of the junction's road surface. Where an arm has no crosswalk of
        its own, pedestrians cross 2 m inside the mouth, as at Euro NCAP's junction.

    Returns
    -------
    junction : Junction
        Named after the compass: four points, or eight where two arms share one of the four.

    Raises
    ------
    InputError
        No lane begins or ends at the outline.
    """
    ends = [
        (is_in, lane)
        for lane in scene.lanes
        for is_in, tip in ((True, lane.centreline_m[-1]), (False, lane.centreline_m[0]))
        if _distance_to_outline(tip, scene.outline_m) <= _AT_OUTLINE_M
    ]
    if not ends:
        raise InputError(
            f"{scene.name}: lanes", len(scene.lanes), "lanes that begin or end at the outline"
        )
    bearings = np.array([_outward_bearing_deg(lane, is_in=is_in) for is_in, lane in ends])
    names = _arm_names(bearings)
    arms = {}
    for name in sorted(set(names), key=COMPASS.index):
        members = [end for end, other in zip(ends, names, strict=True) if other == name]
        arms[name] = _build_arm(name, members, scene)
    return Junction(name=scene.name, arms=arms)


def lane_line(lane: Lane, *, is_in: bool, length_m: float) -> tuple[Line, float]:
    """Straight line along the part of a lane that is next to the junction.

    Parameters
    ----------
    lane : Lane
        Into the junction or out of it.
    is_in : bool
        Which of the two.
    length_m : float
        How much of the lane counts; no more than it has. [m]

    Returns
    -------
    line : Line
        Through the lane's mouth, in driving direction.
    off_line_m : float
        How far the lane leaves that line, at most. [m]
    """
    points = lane.centreline_m if is_in else lane.centreline_m[::-1]  # the mouth comes last
    steps = np.hypot(*np.diff(points, axis=0).T)
    to_mouth = np.append(np.cumsum(steps[::-1])[::-1], 0.0)
    begin_m = min(length_m, float(to_mouth[0]))
    start = np.array([np.interp(-begin_m, -to_mouth, points[:, axis]) for axis in (0, 1)])
    direction = points[-1] - start if is_in else start - points[-1]
    line = Line(point_m=points[-1], direction=direction)
    near = points[to_mouth <= begin_m]
    return line, float(np.abs(line.coordinates(near)[:, 1]).max())


def lane_length_m(lane: Lane) -> float:
    """Length of a lane's centreline, in metres."""
    return float(np.hypot(*np.diff(lane.centreline_m, axis=0).T).sum())


def _build_arm(name: str, members: Sequence[tuple[bool, Lane]], scene: Scene) -> Arm:
    sides = {}
    for wanted in (True, False):
        lanes = [
            _whole(lane, scene.lanes, is_in=wanted) for is_in, lane in members if is_in == wanted
        ]
        lines = [lane_line(lane, is_in=wanted, length_m=10.0)[0] for lane in lanes]
        # The kerb is on the right: smaller to the left of the first lane means nearer to it.
        order = np.argsort([lines[0].coordinates(line.point_m)[1] for line in lines])
        sides[wanted] = tuple(lanes[index] for index in order)
    return Arm(
        name=name,
        lanes_in=sides[True],
        lanes_out=sides[False],
        crosswalk=_crosswalk(sides[True], sides[False], scene),
    )


def _crosswalk(lanes_in: tuple[Lane, ...], lanes_out: tuple[Lane, ...], scene: Scene) -> Line:
    """The scene's crosswalk that leads over the arm's mouth, or a line inside the mouth."""
    mouths = np.array(
        [lane.centreline_m[-1] for lane in lanes_in] + [lane.centreline_m[0] for lane in lanes_out]
    )
    is_in = bool(lanes_in)
    inward, _ = lane_line((lanes_in or lanes_out)[0], is_in=is_in, length_m=10.0)
    if not is_in:
        inward = inward.turned(180.0)
    middle = mouths.mean(axis=0)
    half_width = 0.5 * float(np.ptp(inward.coordinates(mouths)[:, 1])) + 2.0
    for ends in scene.crosswalks_m:
        ahead_m, left_m = inward.coordinates(ends.mean(axis=0)) - inward.coordinates(middle)
        if abs(ahead_m) <= 2.0 * half_width and abs(left_m) <= half_width:
            along = Line(point_m=ends[0], direction=ends[1] - ends[0])
            if abs(along.direction @ inward.direction) < np.sin(np.radians(_ARM_SPREAD_DEG)):
                return along if along.direction @ inward.left > 0.0 else along.turned(180.0)
    inside = replace(inward, point_m=middle).at(_CROSSWALK_INSIDE_MOUTH_M)
    return replace(inward, point_m=inside).turned(90.0)


def _whole(lane: Lane, lanes: Sequence[Lane], *, is_in: bool) -> Lane:
    """The lane with the pieces that lead to its begin, or on from its end."""
    pieces = [lane]
    while True:
        tip = pieces[0].centreline_m[0] if is_in else pieces[-1].centreline_m[-1]
        following = [
            other
            for other in lanes
            if other not in pieces
            and other.kind == lane.kind
            and np.hypot(*(other.centreline_m[-1 if is_in else 0] - tip)) <= _SAME_POINT_M
        ]
        if not following:
            break
        pieces = [following[0], *pieces] if is_in else [*pieces, following[0]]
    points = np.concatenate([piece.centreline_m for piece in pieces])
    is_new = np.append(True, np.hypot(*np.diff(points, axis=0).T) > 1.0e-6)
    return replace(lane, centreline_m=points[is_new])


def _outward_bearing_deg(lane: Lane, *, is_in: bool) -> float:
    line, _ = lane_line(lane, is_in=is_in, length_m=10.0)
    return line.yaw_deg + (180.0 if is_in else 0.0)


def _arm_names(bearings_deg: FloatArray) -> list[str]:
    for step in (2, 1):  # four points of the compass, then eight
        spacing_deg = 45.0 * step
        index = np.round(bearings_deg / spacing_deg).astype(int) % (8 // step) * step
        spreads = [_spread_deg(bearings_deg[index == one]) for one in np.unique(index)]
        if step == 1 or max(spreads) <= _ARM_SPREAD_DEG:
            break
    return [COMPASS[one] for one in index]


def _spread_deg(bearings_deg: FloatArray) -> float:
    apart = (bearings_deg - bearings_deg[0] + 180.0) % 360.0 - 180.0
    return float(np.ptp(apart))


def _distance_to_outline(point_m: FloatArray, outline_m: FloatArray) -> float:
    """Distance of a point to the nearest side of a closed polygon, in metres."""
    starts, sides = outline_m, np.roll(outline_m, -1, axis=0) - outline_m
    share = np.einsum("ij,ij->i", point_m - starts, sides) / np.maximum(
        (sides**2).sum(axis=1), 1e-12
    )
    nearest = starts + np.clip(share, 0.0, 1.0)[:, None] * sides
    return float(np.hypot(*(nearest - point_m).T).min())
