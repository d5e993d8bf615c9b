"""A junction as traffic sees it: arms, lanes and crosswalks.

The module also says in words where things stand at the junction.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from .arrays import FloatArray, float_array, freeze, set_arrays
from .errors import InputError
from .lines import along_m, apart, length_m, points_at, unit
from .phrases import Phrase
from .scene import Lane, LeadingRoad, RoadUser, Scene, Turn

ARM_NAMES = (
    *("east", "east-north-east", "north-east", "north-north-east"),
    *("north", "north-north-west", "north-west", "west-north-west"),
    *("west", "west-south-west", "south-west", "south-south-west"),
    *("south", "south-south-east", "south-east", "east-south-east"),
)
"""Names of arms: points of the compass, counter-clockwise."""
COMPASS = ARM_NAMES[::2]
# Kinds of lanes that are part of a road's carriageway.
CARRIAGEWAY_KINDS = ("driving", "bus", "parking")
_RIDDEN = ("driving", "bus")
# Kind of a lane through the junction.
CONNECTING = "connecting"
# Kind of a lane that leads on where the map ends.
ASSUMED = "assumed"
# A lane at the junction, and whether it leads into it.
_End = tuple[bool, Lane]
# Lanes end at the junction's outline but for the rounding of the map.
_AT_OUTLINE_M = 1.5
# Cycleways run next to it, behind a shoulder or a strip of grass.
_CYCLES_AT_OUTLINE_M = 6.0
# Between one piece of a lane and the next.
_SAME_POINT_M = 0.5
# A crosswalk leads across the arm within this.
_ARM_SPREAD_DEG = 40.0
# Between a lane and the next one of the same arm.
_SAME_ARM_DEG = 25.0
# Between their edges: a median, or tracks.
_SAME_ARM_GAP_M = 12.0
# Between their mouths, along the arm.
_SAME_ARM_AHEAD_M = 15.0
# between two carriageways of one arm, from lane to lane: tracks, a row of trees
_MEDIAN_M = 25.0
# A lane that is shorter, with all that leads to it, is no road.
_STUB_M = 2.0
_CROSSWALK_INSIDE_MOUTH_M = 2.0
# From the middle of a road to a lane of it.
_SAME_ROAD_M = 20.0
# Cosine of the angle between them.
_SAME_WAY = 0.5
_LANES_OF_ARM = ("lanes_in", "lanes_out", "cycleways_in", "cycleways_out")
_MIRRORED: dict[Turn, Turn] = {"left": "right", "right": "left"}
# From the outline of the junction's road surface.
_CORNER_M = 15.0
# From the edge of a lane to that of the one beside whose begin it lies.
_BESIDE_M = 1.0
# Over which cars change from one lane to the next, and what there is of it at least.
_CHANGE_M = 25.0
_LEAST_BEFORE_M = 10.0
# Length of the sum of two arms' directions: an angle of 140 degrees and more.
_STRAIGHT = 0.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """Straight line on the road through a point, with a direction.

    Both are (2,); the direction is a unit vector.
    """

    point_m: FloatArray
    direction: FloatArray

    def __post_init__(self) -> None:
        set_arrays(self, "", point_m=(2,), direction=(2,))
        object.__setattr__(
            self, "direction", freeze(self.direction / np.hypot(*self.direction))
        )

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
        return self.point_m + distance_m * self.direction + left_m * self.left

    def coordinates(self, point_m: ArrayLike) -> FloatArray:
        """Distances of points (..., 2) ahead and to the left, in metres.

        They count from the line's point.
        """
        offset = np.asarray(point_m, dtype=np.float64) - self.point_m
        return np.stack([offset @ self.direction, offset @ self.left], axis=-1)

    def crossing_with(self, other: "Line") -> FloatArray:
        """Where two lines meet, (2,); they must not be parallel."""
        matrix = np.stack([self.direction, -other.direction], axis=1)
        return self.at(float(np.linalg.solve(matrix, other.point_m - self.point_m)[0]))

    def turned(self, angle_deg: float) -> "Line":
        """The line through the same point, turned counter-clockwise."""
        (east, north), angle = self.direction, np.radians(angle_deg)
        cosine = np.cos(angle)
        sine = np.sin(angle)
        direction = np.array(
            [east * cosine - north * sine, east * sine + north * cosine]
        )
        return replace(self, direction=direction)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A road that ends at a junction.

    Attributes
    ----------
    name : str
        Where it lies, seen from the junction: "north", "east", ...
    lanes_in, lanes_out : tuple of Lane
        Into the junction and out of it, whole as far as the map goes; from the kerb to
        the road's axis, lanes for buses and for parking too.
    crosswalk : Line
        Where pedestrians cross the arm.
    cycleways_in, cycleways_out : tuple of Lane
        Where cyclists ride into the junction and out of it, beside or between the
        lanes; from the kerb to the road's axis.
    has_own_crosswalk : bool
        The map has the crosswalk; else it is assumed.
    """

    name: str
    lanes_in: tuple[Lane, ...]
    lanes_out: tuple[Lane, ...]
    crosswalk: Line
    cycleways_in: tuple[Lane, ...] = ()
    cycleways_out: tuple[Lane, ...] = ()
    has_own_crosswalk: bool = False

    @property
    def closed_to(self) -> frozenset[RoadUser]:
        """Road users to which all lanes of the arm are closed.

        They may use its cycleways.
        """
        closed = [frozenset(lane.closed_to) for lane in self.ridden_in]
        closed += [frozenset(lane.closed_to) for lane in self.ridden_out]
        if not closed:
            return frozenset()
        users = frozenset.intersection(*closed)
        if self.cycleways_in or self.cycleways_out:
            return users - {"bicycle"}
        return users

    @property
    def entry_lanes(self) -> tuple[Lane, ...]:
        """Lanes that are driven into the junction, from the kerb to the axis."""
        return tuple(lane for lane in self.lanes_in if lane.kind == "driving")

    @property
    def ridden_in(self) -> tuple[Lane, ...]:
        """Lanes into the junction that cyclists use, too: for cars and for buses."""
        return tuple(lane for lane in self.lanes_in if lane.kind in _RIDDEN)

    @property
    def ridden_out(self) -> tuple[Lane, ...]:
        """Lanes out of the junction that cyclists use, too: for cars and for buses."""
        return tuple(lane for lane in self.lanes_out if lane.kind in _RIDDEN)

    @property
    def speed_limit_kmh(self) -> float | None:
        """The highest speed limit of the entry lanes, in km/h.

        None: the map gives none.
        """
        limits = [lane.speed_limit_kmh for lane in self.entry_lanes]
        return max((limit for limit in limits if limit is not None), default=None)

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
        By name, counter-clockwise from the east.
    keeps_left : bool
        Traffic keeps left.
    connections : tuple of Lane
        Lanes through the junction, each from the end of an entry lane to the begin of
        an exit lane, and through others around it.
    beyond : tuple of Lane
        Lanes that are assumed, from beyond the map to the begin of an entry lane:
        straight ones of two points, or bent past buildings.
    islands_m : tuple of (n, 2) float
        Outlines of the islands that a roundabout leads around; empty: it is none. [m]
    """

    name: str
    arms: dict[str, Arm]
    keeps_left: bool = False
    connections: tuple[Lane, ...] = ()
    beyond: tuple[Lane, ...] = ()
    islands_m: tuple[FloatArray, ...] = ()

    def is_led_on(self, entry: Lane) -> bool:
        """True if a lane is assumed to lead to the start of an entry lane.

        That is the case where the map ends.
        """
        return bool(self._before(entry))

    def followed(self, entry: Lane) -> Lane:
        """An entry lane with the lane that is assumed before it, if that one bends."""
        bent = [lane for lane in self._before(entry) if len(lane.centreline_m) > 2]
        if bent:
            return _led_on(bent[0], entry)
        return entry

    def _before(self, entry: Lane) -> list[Lane]:
        """Lanes that are assumed to lead to the start of an entry lane."""
        begin = entry.centreline_m[0]
        gaps_m = [np.hypot(*(lane.centreline_m[-1] - begin)) for lane in self.beyond]
        return [
            one
            for one, m in zip(self.beyond, gaps_m, strict=True)
            if m <= _SAME_POINT_M
        ]

    def connection(self, entry: Lane, leaving: Lane) -> Lane | None:
        """The lane through the junction from one lane into another.

        None: the map has no such lane.
        """
        for lane in self.connections:
            begins = np.hypot(*(lane.centreline_m[0] - entry.centreline_m[-1]))
            ends = np.hypot(*(lane.centreline_m[-1] - leaving.centreline_m[0]))
            if max(begins, ends) <= _SAME_POINT_M:
                return lane
        return None

    def __repr__(self) -> str:
        return f"Junction({self.name!r}, arms {', '.join(self.arms)})"


# One and the same lane, by which ways along it are known.
@lru_cache(maxsize=64)
def _led_on(before: Lane, entry: Lane) -> Lane:
    """The entry lane, lengthened by the one that is assumed before it."""
    chain = np.concatenate([before.centreline_m[:-1], entry.centreline_m])
    return replace(entry, centreline_m=chain)


# Many ask for the junction of the scene at hand.
@lru_cache(maxsize=4)
def build_junction(scene: Scene) -> Junction:
    """Find the arms of a scene's junction in its lanes.

    Lanes belong to one arm that lie side by side and lead the same way, and so do two
    carriageways, one into the junction and one out of it, with a median of up to 25 m
    between. An arm is named after one of four points of the compass, or of eight or
    sixteen where two arms would share a name; if even these do, numbers tell them
    apart. Where it has no crosswalk of its own, pedestrians cross 2 m inside the mouth,
    as at Euro NCAP's junction.

    Raises
    ------
    InputError
        No lane begins or ends at the outline of the junction's road surface.
    """
    ends = _ends_at_outline(scene, CARRIAGEWAY_KINDS, _AT_OUTLINE_M)
    if not ends:
        got = len(scene.lanes)
        raise InputError(
            f"{scene.name}: lanes", got, "lanes that begin or end at the outline"
        )
    groups = _group_by_arm(ends, keeps_left=scene.keeps_left)
    cycleways = _beside_arms(
        _ends_at_outline(scene, ("cycling",), _CYCLES_AT_OUTLINE_M), groups
    )
    # Arms are in the order of their bearings, counter-clockwise from the east.
    ways = [
        np.mean([_mouth(*end).direction for end in group], axis=0) for group in groups
    ]
    bearings = np.degrees(np.arctan2(*np.transpose(ways)[::-1]))
    order = np.argsort(np.round(np.mod(bearings, 360.0), 6) % 360.0, kind="stable")
    names = _arm_names(bearings[order])
    arms = {
        name: _build_arm(name, groups[index], cycleways[index], scene)
        for name, index in zip(names, order, strict=True)
    }
    return Junction(
        name=scene.name,
        arms=arms,
        keeps_left=scene.keeps_left,
        connections=tuple(lane for lane in scene.lanes if lane.kind == CONNECTING),
        beyond=tuple(lane for lane in scene.lanes if lane.kind == ASSUMED),
        islands_m=scene.islands_m,
    )


def arm_of_road(road: LeadingRoad, junction: Junction) -> str | None:
    """The arm of whose lanes one begins or ends next to a road; None: there is none."""
    nearest = None
    least_m = _SAME_ROAD_M
    for name, arm in junction.arms.items():
        lines = [lane.centreline_m[::-1] for lane in arm.entry_lanes]
        for line in [*lines, *(lane.centreline_m for lane in arm.exit_lanes)]:
            tip = line[0]
            way = line[1] - line[0]
            distance_m = float(np.hypot(*(tip - road.point_m)))
            if (
                way @ road.direction / np.hypot(*way) > _SAME_WAY
                and distance_m < least_m
            ):
                nearest = name
                least_m = distance_m
    return nearest


def mirrored(junction: Junction) -> Junction:
    """The arm with a lane that begins or ends next to a road.

    None: no arm has one.
    """

    def turn_over(lanes: Sequence[Lane]) -> tuple[Lane, ...]:
        return tuple(
            replace(
                lane,
                centreline_m=lane.centreline_m * [1.0, -1.0],
                turns=tuple(_MIRRORED.get(turn, turn) for turn in lane.turns),
            )
            for lane in lanes
        )

    arms = {}
    for name, arm in junction.arms.items():
        line = arm.crosswalk
        # From the kerb where the VUT drives to the other one, in the mirror too.
        crosswalk = Line(
            point_m=line.point_m * [1.0, -1.0], direction=line.direction * [-1.0, 1.0]
        )
        lanes: dict[str, Any] = {
            field: turn_over(getattr(arm, field)) for field in _LANES_OF_ARM
        }
        arms[name] = replace(arm, crosswalk=crosswalk, **lanes)
    return replace(
        junction,
        arms=arms,
        keeps_left=not junction.keeps_left,
        connections=turn_over(junction.connections),
        beyond=turn_over(junction.beyond),
        islands_m=tuple(one * [1.0, -1.0] for one in junction.islands_m),
    )


# Cached, since every run of an arm asks for the same lanes.
@lru_cache(maxsize=1024)
def lane_line(lane: Lane, *, is_in: bool, length_m: float) -> tuple[Line, float]:
    """Line along a lane next to the junction, and the lane's deviation.

    The line runs through the lane's mouth in driving direction. At most `length_m` of
    the lane count, and no more than it has; the largest distance from the line is in
    metres.
    """
    # the mouth comes last
    if is_in:
        points = lane.centreline_m
    else:
        points = lane.centreline_m[::-1]
    # Distance of each point to the mouth along the lane.
    to_mouth = np.append(
        np.cumsum(np.hypot(*np.diff(points, axis=0).T)[::-1])[::-1], 0.0
    )
    # Where the part that counts begins, between two points of the lane.
    begin_m = min(length_m, float(to_mouth[0]))
    start = np.array(
        [np.interp(-begin_m, -to_mouth, points[:, axis]) for axis in (0, 1)]
    )
    if is_in:
        direction = points[-1] - start
    else:
        direction = start - points[-1]
    line = Line(point_m=points[-1], direction=direction)
    return line, float(
        np.abs(line.coordinates(points[to_mouth <= begin_m])[:, 1]).max()
    )


def lane_length_m(lane: Lane) -> float:
    """Length of a lane's centreline, in metres."""
    return length_m(lane.centreline_m)


def curve_between(before: Line, after: Line) -> FloatArray:
    """Points (n, 2) from one line's point to another's: a cubic Hermite curve.

    At its ends it has the lines' directions.

    Raises
    ------
    ValueError
        The other line's point does not lie ahead: more than 60 degrees aside of a
        direction.
    """
    begin = before.point_m
    end = after.point_m
    length_m = float(np.hypot(*(end - begin)))
    if (
        min((end - begin) @ before.direction, (end - begin) @ after.direction)
        <= 0.5 * length_m
    ):
        raise ValueError(
            f"line at {end.tolist()}: got one aside; expected one ahead of the other"
        )
    share = np.linspace(0.0, 1.0, max(8, int(length_m)))[:, None]
    return np.asarray(
        (2.0 * share**3 - 3.0 * share**2 + 1.0) * begin
        + (share**3 - 2.0 * share**2 + share) * length_m * before.direction
        + (3.0 * share**2 - 2.0 * share**3) * end
        + (share**3 - share**2) * length_m * after.direction
    )


def _ends_at_outline(scene: Scene, kinds: Sequence[str], within_m: float) -> list[_End]:
    """Lanes of some kinds that lead into the junction (True) or out of it.

    Of a piece so short that both its ends are at the outline the nearer end counts;
    stubs that end nowhere are left out.
    """
    ends = []
    for lane in (lane for lane in scene.lanes if lane.kind in kinds):
        tips = {True: lane.centreline_m[-1], False: lane.centreline_m[0]}
        off_m = {
            at: distance_to_outline_m(tip, scene.outline_m) for at, tip in tips.items()
        }
        # An end counts that is next to the outline.
        near = [is_in for is_in, off in off_m.items() if off <= within_m]
        if len(near) == 2 and lane_length_m(lane) <= 2.0 * within_m:
            near = [min(near, key=lambda is_in: off_m[is_in])]
        ends += [
            (is_in, lane)
            for is_in in near
            if lane_length_m(lane) >= _STUB_M
            or lane_length_m(_whole(lane, scene.lanes, is_in=is_in)) >= _STUB_M
        ]
    return ends


def _beside_arms(
    ends: Sequence[_End], groups: Sequence[Sequence[_End]]
) -> list[list[_End]]:
    """Lane ends by the arm next to whose lanes they lie; others are left out."""
    beside: list[list[_End]] = [[] for _ in groups]
    mouths = [[_mouth(*end) for end in group] for group in groups]
    for is_in, lane in ends:
        mouth = _mouth(is_in, lane)
        reach_m = 0.5 * lane.width_m + _SAME_ARM_GAP_M
        # A cycleway belongs to the first arm that it runs beside.
        for found, others in zip(beside, mouths, strict=True):
            if any(_is_beside(mouth, other, reach_m) for other in others):
                found.append((is_in, lane))
                break
    return beside


def _build_arm(
    name: str, members: Sequence[_End], cycleways: Sequence[_End], scene: Scene
) -> Arm:
    """An arm of its lane ends and those of its cycleways.

    Lanes come from the kerb to the road's axis.
    """

    def from_kerb(ends: Sequence[_End], *, is_in: bool) -> tuple[Lane, ...]:
        own = [lane for leads_in, lane in ends if leads_in == is_in]
        lanes = [_whole(lane, scene.lanes, is_in=is_in) for lane in own]
        lines = [lane_line(lane, is_in=is_in, length_m=10.0)[0] for lane in lanes]
        # The kerb is on the right, or where traffic keeps left on the left: smaller to
        # the other side of the first lane means nearer to it.
        if scene.keeps_left:
            inwards = -1.0
        else:
            inwards = 1.0
        order = np.argsort(
            [inwards * lines[0].coordinates(line.point_m)[1] for line in lines]
        )
        return tuple(lanes[index] for index in order)

    lanes_in, lanes_out = (from_kerb(members, is_in=is_in) for is_in in (True, False))
    crosswalk, has_own_crosswalk = _crosswalk(lanes_in, lanes_out, scene)
    return Arm(
        name=name,
        lanes_in=lanes_in,
        lanes_out=lanes_out,
        crosswalk=crosswalk,
        has_own_crosswalk=has_own_crosswalk,
        cycleways_in=from_kerb(cycleways, is_in=True),
        cycleways_out=from_kerb(cycleways, is_in=False),
    )


def _crosswalk(
    lanes_in: tuple[Lane, ...], lanes_out: tuple[Lane, ...], scene: Scene
) -> tuple[Line, bool]:
    """The scene's crosswalk over the arm's mouth, and True; or an assumed one.

    Where there is none, it is a line 2 m inside the mouth, as at Euro NCAP's
    junction. The line leads from the kerb of the entry lanes to the other one.
    """
    tips = [lane.centreline_m[-1] for lane in lanes_in]
    mouths = np.array([*tips, *(lane.centreline_m[0] for lane in lanes_out)])
    is_in = bool(lanes_in)
    inward, _ = lane_line((lanes_in or lanes_out)[0], is_in=is_in, length_m=10.0)
    if not is_in:
        inward = inward.turned(180.0)
    middle = mouths.mean(axis=0)
    half_width = 0.5 * float(np.ptp(inward.coordinates(mouths)[:, 1])) + 2.0
    # A crosswalk counts that lies near the mouth and leads across the arm.
    for ends in scene.crosswalks_m:
        ahead_m, left_m = inward.coordinates(ends.mean(axis=0)) - inward.coordinates(
            middle
        )
        if abs(ahead_m) <= 2.0 * half_width and abs(left_m) <= half_width:
            along = Line(point_m=ends[0], direction=ends[1] - ends[0])
            if abs(along.direction @ inward.direction) < np.sin(
                np.radians(_ARM_SPREAD_DEG)
            ):
                if along.direction @ inward.left > 0.0:
                    return along, True
                return along.turned(180.0), True
    inside = replace(inward, point_m=middle).at(_CROSSWALK_INSIDE_MOUTH_M)
    return replace(inward, point_m=inside).turned(90.0), False


def _whole(lane: Lane, lanes: Sequence[Lane], *, is_in: bool) -> Lane:
    """The lane with the pieces that lead to its begin, or on from its end.

    Through other junctions it is followed along their connecting lanes, as straight on
    as they go.
    """
    pieces = [lane]
    while True:
        last = pieces[0 if is_in else -1]
        tip = last.centreline_m[0 if is_in else -1]
        # Pieces that begin where this one ends, of the same kind or through a
        # junction.
        following = [
            other
            for other in lanes
            if other not in pieces
            and other.kind in (lane.kind, CONNECTING)
            and np.hypot(*(other.centreline_m[-1 if is_in else 0] - tip))
            <= _SAME_POINT_M
        ]
        same = [other for other in following if other.kind == lane.kind]
        following = same[:1] or sorted(
            following, key=lambda other: _turn(last, other, is_in=is_in)
        )
        if not following:
            break
        if is_in:
            pieces = [following[0], *pieces]
        else:
            pieces = [*pieces, following[0]]
    if pieces[0 if is_in else -1].kind == CONNECTING:
        # No lane of the map begins behind it.
        del pieces[0 if is_in else -1]
    points = np.concatenate([piece.centreline_m for piece in pieces])
    return replace(lane, centreline_m=apart(points, 1.0e-6))


def lane_beside(lane: Lane, lanes: Sequence[Lane]) -> FloatArray | None:
    """The way to the begin of a lane along the lane that runs beside it.

    Parameters
    ----------
    lane : Lane
        No lane ends where it begins.
    lanes : sequence of Lane
        All lanes of the scene.

    Returns
    -------
    line_m : (n, 2) float or None
        From where that lane begins, over to this one on its last metres. None: no lane
        that leads the same way comes past its begin. [m]
    """
    begin = lane.centreline_m[0]
    ahead = lane_line(lane, is_in=False, length_m=5.0)[0].direction
    nearest: FloatArray | None = None
    least_m = np.inf
    for other in lanes:
        reach_m = 0.5 * (lane.width_m + other.width_m) + _BESIDE_M
        line = other.centreline_m
        if other.kind != lane.kind or other.id == lane.id:
            continue
        away_m = float(shapely.LineString(line).distance(shapely.Point(begin)))
        if away_m > min(reach_m, least_m):
            continue
        whole = _whole(other, lanes, is_in=True).centreline_m
        path = shapely.LineString(whole)
        at_m = float(path.project(shapely.Point(begin)))
        before_m = max(at_m - _CHANGE_M, 0.0)
        ends = shapely.line_interpolate_point(path, [max(at_m - 5.0, 0.0), at_m])
        near, far = shapely.get_coordinates(ends)
        way = unit(far - near)
        if at_m < _LEAST_BEFORE_M or way @ ahead < np.cos(np.radians(_SAME_ARM_DEG)):
            continue
        along = along_m(whole)
        (turn_off,) = points_at(whole, np.array([before_m]))
        nearest = np.vstack([whole[along < before_m - 1.0], turn_off, begin])
        least_m = away_m
    return nearest


def _turn(lane: Lane, other: Lane, *, is_in: bool) -> float:
    """Change of direction from one piece of a lane to the next.

    It is minus the cosine of the angle: -1 for straight on.
    """
    if is_in:
        before, after = (other, lane)
    else:
        before, after = (lane, other)
    ahead = lane_line(before, is_in=True, length_m=5.0)[0].direction
    return -float(ahead @ lane_line(after, is_in=False, length_m=5.0)[0].direction)


def _group_by_arm(ends: Sequence[_End], *, keeps_left: bool) -> list[list[_End]]:
    """Lane ends grouped by arm.

    An arm has lanes side by side that lead the same way, or the two
    carriageways of one road.
    """
    mouths = [_mouth(*end) for end in ends]

    def is_pair(one: int, other: int) -> bool:
        reach_m = (
            0.5 * (ends[one][1].width_m + ends[other][1].width_m) + _SAME_ARM_GAP_M
        )
        return _is_beside(mouths[one], mouths[other], reach_m)

    groups = [[ends[index] for index in group] for group in chained(len(ends), is_pair)]
    # Carriageways into the junction with those out of it, the narrowest median first.
    pairs = []
    for one, group in enumerate(groups):
        for other, leaving in enumerate(groups):
            if all(is_in for is_in, _ in group) and not any(
                is_in for is_in, _ in leaving
            ):
                gap_m = _median_m(group, leaving, keeps_left=keeps_left)
                if gap_m is not None:
                    pairs.append((gap_m, one, other))
    used: set[int] = set()
    joined = []
    for _, one, other in sorted(pairs):
        if not used & {one, other}:
            used |= {one, other}
            joined.append([*groups[one], *groups[other]])
    return joined + [group for index, group in enumerate(groups) if index not in used]


def chained(n: int, is_pair: Callable[[int, int], bool]) -> list[list[int]]:
    """Groups of 0 to n - 1 whose members are linked by pairs.

    Groups come in the order of their first members.
    """
    group = list(range(n))
    for one in range(n):
        for other in range(one):
            if group[one] != group[other] and is_pair(one, other):
                old = group[one]
                new = group[other]
                group = [new if number == old else number for number in group]
    numbers = dict.fromkeys(group)
    return [[at for at, number in enumerate(group) if number == one] for one in numbers]


def _median_m(
    entering: Sequence[_End], leaving: Sequence[_End], *, keeps_left: bool
) -> float | None:
    """Width of the median between two carriageways of one arm, in metres.

    None: they are not of one arm.
    """
    least_m = np.inf
    for is_in, lane in entering:
        mouth = _mouth(is_in, lane)
        for other_is_in, other_lane in leaving:
            other = _mouth(other_is_in, other_lane)
            if mouth.direction @ other.direction < np.cos(np.radians(_SAME_ARM_DEG)):
                return None
            # Along the mean of both directions.
            between = replace(mouth, direction=mouth.direction + other.direction)
            ahead_m, left_m = between.coordinates(other.point_m)
            # Seen from the junction, cars come in on the left, or where traffic keeps
            # left on the right.
            if keeps_left:
                across_m = left_m
            else:
                across_m = -left_m
            gap_m = across_m - 0.5 * (lane.width_m + other_lane.width_m)
            if abs(ahead_m) > _MEDIAN_M or across_m <= 0.0:
                return None
            least_m = min(least_m, float(gap_m))
    if least_m <= _MEDIAN_M:
        return least_m
    return None


def _mouth(is_in: bool, lane: Lane) -> Line:
    """Line through the end of a lane at the junction, away from that."""
    line, _ = lane_line(lane, is_in=is_in, length_m=10.0)
    if is_in:
        return line.turned(180.0)
    return line


def _is_beside(one: Line, other: Line, reach_m: float) -> bool:
    """True if two mouths lead the same way, side by side.

    `reach_m` is the largest distance between them, across the arm.
    """
    if one.direction @ other.direction < np.cos(np.radians(_SAME_ARM_DEG)):
        return False
    between = replace(one, direction=one.direction + other.direction)
    ahead_m, left_m = np.abs(between.coordinates(other.point_m))
    return bool(ahead_m <= _SAME_ARM_AHEAD_M and left_m <= reach_m)


def _arm_names(bearings_deg: FloatArray) -> list[str]:
    """Names of arms by their bearings, (n_arms,), each name once."""
    for n_points in (4, 8, 16):
        index = np.round(bearings_deg * n_points / 360.0).astype(int) % n_points
        names = [ARM_NAMES[one * (16 // n_points)] for one in index]
        if len(set(names)) == len(names):
            return names
    return [
        f"{name}-{names[: index + 1].count(name)}" if names.count(name) > 1 else name
        for index, name in enumerate(names)
    ]


def distance_to_outline_m(point_m: FloatArray, outline_m: FloatArray) -> float:
    """Distance of a point to the nearest side of a closed polygon, in metres."""
    return float(shapely.LinearRing(outline_m).distance(shapely.Point(point_m)))


# ---------- where things stand, in words
def compass_point(way_m: FloatArray) -> str:
    """The nearest of eight points of the compass."""
    return COMPASS[round(np.degrees(np.arctan2(way_m[1], way_m[0])) / 45.0) % 8]


def compass_bearing_deg(yaw_deg: float) -> float:
    """A direction clockwise from north, in degrees, as installers read it.

    It is at least 0 and below 360.

    >>> compass_bearing_deg(0.0), compass_bearing_deg(135.0)
    (90.0, 315.0)
    """
    return (90.0 - yaw_deg) % 360.0


def street_names(scene: Scene) -> dict[str, str]:
    """Names of the streets of a junction's arms, by arm.

    Arms without a name are left out.
    """
    junction = build_junction(scene)
    names: dict[str, dict[str, None]] = {}
    for road in scene.roads:
        arm = arm_of_road(road, junction)
        if arm is not None and not re.fullmatch(r"(way|road) \S+", road.name):
            names.setdefault(arm, {})[road.name] = None
    return {arm: " / ".join(found) for arm, found in names.items()}


def whereabouts(scene: Scene, positions_m: ArrayLike) -> list[Phrase]:
    """Places (n, 2) at a junction in words.

    Such as "north-west corner, Mill Lane / High Street".

    Within 15 m of the junction's outline a corner, with the streets of the arms on
    either side; farther out the nearest arm, with its street. Empty where the scene has
    no arms.
    """
    positions = float_array(positions_m, (-1, 2), "positions_m")
    try:
        arms = build_junction(scene).arms
    except InputError:
        return [Phrase("")] * len(positions)
    streets = street_names(scene)
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    # The nearest arm is the one with the nearest lane.
    lines = {
        name: shapely.MultiLineString(
            [one.centreline_m for one in (*arm.lanes_in, *arm.lanes_out)]
        )
        for name, arm in arms.items()
    }
    bearings = {name: _bearing(arm_mouth(arm) - middle) for name, arm in arms.items()}
    found = []
    for position in positions:
        away_m = distance_to_outline_m(position, scene.outline_m)
        if away_m <= _CORNER_M:
            way = position - middle
            turns = {
                name: (at - _bearing(way)) % (2.0 * np.pi)
                for name, at in bearings.items()
            }
            beside = [
                max(turns, key=turns.__getitem__),
                min(turns, key=turns.__getitem__),
            ]
            known = [streets[name] for name in beside if name in streets]
            # Halfway between two arms, unless they lead nearly straight on.
            sides = [bearings[name] for name in beside]
            corner = np.array([np.cos(sides).sum(), np.sin(sides).sum()])
            side = compass_point(corner if np.hypot(*corner) > _STRAIGHT else way)
            here = Phrase("{point} corner", point=Phrase(side))
            if known:
                here = Phrase(
                    "{point} corner, {streets}",
                    point=Phrase(side),
                    streets=" / ".join(dict.fromkeys(known)),
                )
        else:
            point = shapely.Point(position)
            name = min(lines, key=lambda one: lines[one].distance(point))
            here = Phrase(
                "{arm} arm, {distance:.0f} m out", arm=Phrase(name), distance=away_m
            )
            if name in streets:
                here = Phrase(
                    "{arm} arm, {street}, {distance:.0f} m out",
                    arm=Phrase(name),
                    street=streets[name],
                    distance=away_m,
                )
        found.append(here)
    return found


def arm_mouth(arm: Arm) -> FloatArray:
    """Middle of an arm's lanes where they meet the junction, (2,)."""
    ends = [lane.centreline_m[-1] for lane in arm.lanes_in]
    return np.asarray(
        np.mean([*ends, *(lane.centreline_m[0] for lane in arm.lanes_out)], axis=0)
    )


def _bearing(way_m: FloatArray) -> float:
    """Direction of a vector (2,), counter-clockwise from east, in rad."""
    return float(np.arctan2(way_m[1], way_m[0]))
