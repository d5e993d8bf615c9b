"""Courses: smooth lines along the lanes of a map, and turns.

A course is measured by its own length.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from typing import Any, Literal

import numpy as np
from msgspec import Struct, field
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import FloatArray, freeze
from geometry.errors import InputError, check_field, check_one_of
from geometry.junction import Line
from geometry.lines import along_m, apart, cross, points_at
from geometry.tables import read_tables
from geometry.text_formats import load_data

# Between the points of a lane that are smoothed.
_SAMPLE_M = 0.5
# Bends much shorter than six times this are evened out.
_SMOOTHING_M = 2.0
_CLOSE_SAMPLE_M = 0.25
# Weight of points that are smoothed over 0.4 m.
_CLOSE = (_SMOOTHING_M / 0.4) ** 4
# Of the lanes next to one that is followed closely.
_CLOSE_BESIDE_M = 6.0
# Straight on beyond both ends of a lane.
_BEYOND_M = 60.0
# Of a lane's end, which tells its direction there.
_END_CHORD_M = 4.0
_MAX_END_BEND_RAD = np.radians(20.0)
# Chords of an arc of 8 m come within two micrometres of it.
_STEP_M = 0.01
_SAME_POINT_M = 1.0e-6
_MEETS_M = 1.0e-3
_MAX_STEPS = 60
# Smoothing of a course that leaves the lanes' middles where it may.
_GENTLE_M = 16.0
# To both sides of where it must come nearer to them.
_EASED_M = 5.0
# Where lanes bend, full steps may swing to and fro.
_DAMPING = 0.6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """A smooth line on the road, and straight on beyond both its ends.

    Stations are metres along it from its origin: the mouth of the lane that it follows.

    Attributes
    ----------
    begin_m : float
        Station of the first point. [m]
    points_m : (n, 2) float
        Every centimetre. World frame. [m]
    yaw_rad : (n,) float
        Direction there, without jumps by full turns. [rad]
    max_bend_per_m : float
        Largest curvature. [1/m]
    max_bend_change_per_m2 : float
        Most that the curvature changes in a metre; infinite where it jumps. [1/m^2]
    """

    begin_m: float
    points_m: FloatArray
    yaw_rad: FloatArray
    max_bend_per_m: float
    max_bend_change_per_m2: float

    @property
    def end_m(self) -> float:
        """Station of the last point, in metres."""
        return self.begin_m + _STEP_M * (len(self.points_m) - 1)

    def at(self, station_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Points (..., 2) and directions (...,) in radians at stations."""
        station = np.asarray(station_m, dtype=np.float64)
        inside = np.clip(station, self.begin_m, self.end_m)
        beyond = (station - inside)[..., None]
        index, share = self._place(inside)
        before = self.points_m[index]
        after = self.points_m[index + 1]
        point = before + share[..., None] * (after - before)
        yaw = self.interpolate(station, self.yaw_rad)
        return point + beyond * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1), yaw

    def interpolate(self, station_m: ArrayLike, values: FloatArray) -> FloatArray:
        """Values of its points, (n,), at stations (...,); beyond the ends they stay."""
        station = np.asarray(station_m, dtype=np.float64)
        index, share = self._place(np.clip(station, self.begin_m, self.end_m))
        between: FloatArray = values[index] + share * (
            values[index + 1] - values[index]
        )
        return between

    def tangent(self, station_m: float) -> Line:
        """The straight line that touches it at a station; its point is there."""
        point, yaw = self.at(station_m)
        return Line(point_m=point, direction=np.array([np.cos(yaw), np.sin(yaw)]))

    def offset(self, left_m: float) -> "Course":
        """The line some metres to the left, with its origin.

        Raises
        ------
        InputError
            The course bends too sharply.
        """
        if left_m == 0.0:
            return self
        if self.max_bend_per_m * abs(left_m) >= 1.0:
            raise InputError(
                "left_m", left_m, f"less than {1.0 / self.max_bend_per_m:.1f} m"
            )
        left = np.stack([-np.sin(self.yaw_rad), np.cos(self.yaw_rad)], axis=-1)
        return _course_of(self.points_m + left_m * left, self.yaw_rad, self._index(0.0))

    def reversed(self) -> "Course":
        """Course driven the other way; the origin stays."""
        points_m = freeze(self.points_m[::-1].copy())
        yaw_rad = freeze(self.yaw_rad[::-1] + np.pi)
        return replace(self, begin_m=-self.end_m, points_m=points_m, yaw_rad=yaw_rad)

    def crossings_m(self, line: Line) -> FloatArray:
        """Stations at which it crosses a straight line, ascending, (n,)."""
        left = line.coordinates(self.points_m)[:, 1]
        index = np.flatnonzero((left[:-1] == 0.0) | (left[:-1] * left[1:] < 0.0))
        share = left[index] / (left[index] - left[index + 1])
        return self.begin_m + _STEP_M * (index + share)

    def station_of(self, point_m: ArrayLike) -> float:
        """Station of its point that is nearest to a point."""
        distance = np.hypot(*(self.points_m - np.asarray(point_m, dtype=np.float64)).T)
        return self.begin_m + _STEP_M * int(np.argmin(distance))

    def between(self, begin_m: float, end_m: float) -> "Course":
        """The part between two stations; it goes straight on from there."""
        first = self._index(begin_m)
        part = slice(first, self._index(end_m) + 2)
        return _course(
            self.begin_m + _STEP_M * first, self.points_m[part], self.yaw_rad[part]
        )

    def _index(self, station_m: float) -> int:
        """Index of the point before a station."""
        last = len(self.points_m) - 2
        return int(np.clip(np.floor((station_m - self.begin_m) / _STEP_M), 0, last))

    def _place(self, inside_m: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Points before stations, and the share of the way to the next one."""
        steps = (inside_m - self.begin_m) / _STEP_M
        index = np.minimum(steps.astype(np.int64), len(self.points_m) - 2)
        return index, steps - index


def follow_lane(centreline_m: FloatArray, *, is_in: bool) -> Course:
    """The smooth course along a lane.

    `centreline_m` (n, 2): points of the lane in driving direction. World frame.
    `is_in`: it leads into the junction: its mouth, the origin of stations, is its end.
    Else its start. Raises InputError: the line has no length.

    A map's lane is a chain of chords; driven as it is, a body would jump in yaw at
    every point. The course is the cubic smoothing spline [1]_ of the chain's points,
    taken every half metre, which minimises the sum of (distance to the chain)^2 + L^4
    (second derivative)^2 along the line with L = 2 m. It has continuous curvature;
    circles of radius R shrink by L^4 / R^3 (16 mm for 10 m), and a corner of the chain
    is cut by 0.35 L times its angle (0.25 m for 20 degrees). Beyond both ends it goes
    straight on, in the direction that the lane has there.

    References
    ----------
    .. [1] C. H. Reinsch, "Smoothing by spline functions", 1967; scipy's
       make_smoothing_spline.
    """
    points = np.asarray(centreline_m, dtype=np.float64).reshape(-1, 2).tolist()
    origin = points[-1 if is_in else 0] if points else ()
    return _follow(tuple(map(tuple, points)), tuple(origin))


def follow_way(points_m: Sequence[tuple[float, float]], yaw_deg: float) -> Course:
    """The smooth course along a way, and on in a direction.

    The way's last point is the origin.
    """
    end = np.array(points_m[-1])
    ahead = np.radians(yaw_deg)
    beyond = end + 2.0 * _END_CHORD_M * np.array([np.cos(ahead), np.sin(ahead)])
    return _follow((*map(tuple, points_m), tuple(beyond.tolist())), tuple(points_m[-1]))


# Every case and speed follows the same few lanes.
@lru_cache(maxsize=256)
def _follow(
    points: tuple[tuple[float, ...], ...],
    origin_m: tuple[float, ...],
    close: tuple[int, int] | None = None,
) -> Course:
    """The course along points.

    Those from one to another, `close`, are followed closely.
    """
    chain = np.array(points, dtype=np.float64).reshape(-1, 2)
    close_m = None
    if close is not None:
        ends_m = _BEYOND_M + along_m(chain)[list(close)]
        close_m = ends_m + [-_CLOSE_BESIDE_M, _CLOSE_BESIDE_M]
    if len(chain):
        chain = apart(chain, _SAME_POINT_M)
    if len(chain) < 2:
        raise InputError("centreline_m", len(chain), "at least two different points")
    chain = _led_on(chain)
    along = along_m(chain)
    if close_m is None:
        step_m = _SAMPLE_M
    else:
        step_m = _CLOSE_SAMPLE_M
    at = np.linspace(0.0, along[-1], int(along[-1] / step_m) + 2)
    weight = None
    if close_m is not None:
        weight = np.where((at >= close_m[0]) & (at <= close_m[1]), _CLOSE, 1.0)
    samples = points_at(chain, at)
    return _smoothed(samples, at, origin_m, smoothing_m=_SMOOTHING_M, weight=weight)


def _led_on(chain_m: FloatArray) -> FloatArray:
    """A chain that goes straight on beyond both its ends."""
    ahead = _end_direction(chain_m)
    behind = _end_direction(chain_m[::-1])
    begin = chain_m[:1] + _BEYOND_M * behind
    end = chain_m[-1:] + _BEYOND_M * ahead
    return np.concatenate([begin, chain_m, end])


def _smoothed(
    samples_m: FloatArray,
    at_m: FloatArray,
    origin_m: ArrayLike,
    *,
    smoothing_m: float,
    weight: FloatArray | None = None,
) -> Course:
    """The smoothing spline of points at even stations.

    Its origin is the place nearest to `origin_m`.
    """
    origin = samples_m.mean(axis=0)
    spline = _spline(at_m, samples_m - origin, smoothing_m=smoothing_m, weight=weight)
    # The spline's own length, in steps of a centimetre.
    fine = np.linspace(0.0, at_m[-1], int(at_m[-1] / _STEP_M) + 2)
    derivative = spline.derivative()
    speed = np.hypot(*derivative(fine).T)
    length = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(fine)))
    even = np.interp(np.arange(0.0, length[-1], _STEP_M), length, fine)
    place = spline(even) + origin
    direction = derivative(even)
    yaw_rad = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
    nearest = int(np.hypot(*(place - np.asarray(origin_m)).T).argmin())
    return _course_of(place, yaw_rad, nearest)


def _spline(
    at_m: FloatArray,
    points_m: FloatArray,
    *,
    smoothing_m: float,
    weight: FloatArray | None,
) -> Any:
    """The smoothing spline of points (n, 2) at stations (n,)."""
    # Takes a third of a second to import.
    from scipy.interpolate import (
        make_smoothing_spline,
    )

    # The sum over samples stands for an integral over the length.
    stiffness = smoothing_m**4 / (at_m[1] - at_m[0])
    return make_smoothing_spline(at_m, points_m, w=weight, lam=stiffness)


def _end_direction(chain_m: FloatArray) -> FloatArray:
    """Unit vector in which a chain leads at its last point.

    Chords of the last metres point where the lane led in their middles; what it turned
    between them it turns once more by half up to its end.
    """
    back = chain_m[::-1]
    along = along_m(back)
    reach = min(_END_CHORD_M, 0.5 * float(along[-1]))
    end, middle, begin = points_at(back, np.array([0.0, reach, 2.0 * reach]))
    last = end - middle
    before = middle - begin
    turned = np.arctan2(cross(before, last), float(before @ last))
    more = np.clip(0.5 * turned, -_MAX_END_BEND_RAD, _MAX_END_BEND_RAD)
    yaw = np.arctan2(last[1], last[0]) + more
    return np.array([np.cos(yaw), np.sin(yaw)])


def _course_of(points_m: FloatArray, yaw_rad: FloatArray, origin: int) -> Course:
    """A course through points that lie about evenly, with its origin at one of them."""
    length = along_m(points_m)
    even = np.arange(0.0, length[-1], _STEP_M)
    places = points_at(points_m, even)
    return _course(-float(length[origin]), places, np.interp(even, length, yaw_rad))


def _course(begin_m: float, points_m: FloatArray, yaw_rad: FloatArray) -> Course:
    """A course of points that are a step apart, with its bends measured."""
    bend = np.diff(yaw_rad) / _STEP_M
    # Over a tenth of a metre: shorter, rounded numbers would count as changes.
    stride = 10
    change = (bend[stride:] - bend[:-stride]) / (stride * _STEP_M)
    return Course(
        begin_m=begin_m,
        points_m=freeze(np.ascontiguousarray(points_m)),
        yaw_rad=freeze(np.ascontiguousarray(yaw_rad)),
        max_bend_per_m=float(np.abs(bend).max(initial=0.0)),
        max_bend_change_per_m2=float(np.abs(change).max(initial=0.0)),
    )


# ---------- turns
LEFT = 1
RIGHT = -1
# Right-hand traffic.
_SIDES = {"far": LEFT, "near": RIGHT}
_ANGLE_TOLERANCE_DEG = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """A curve between two straights, the same from both ends.

    Attributes
    ----------
    first_radius_m : float
        Where the curve begins and ends; infinite: as straight as what comes before. [m]
    radius_m : float
        Of the arc in the middle; smaller than the first. [m]
    clothoid_deg : float
        By how much each clothoid turns: its curvature grows linearly with its length.
        [deg]
    arc_deg : float
        By how much the arc turns. [deg]
    side : int
        ``LEFT`` = +1, ``RIGHT`` = -1.
    """

    first_radius_m: float
    radius_m: float
    clothoid_deg: float
    arc_deg: float
    side: int

    def __post_init__(self) -> None:
        check = partial(check_field, self, "turn")
        check("radius_m", 0.0 < self.radius_m < np.inf, "> 0 metres")
        check(
            "first_radius_m", self.first_radius_m > self.radius_m, "more than radius_m"
        )
        check("clothoid_deg", 0.0 < self.clothoid_deg < 90.0, "0 < degrees < 90")
        is_short = 0.0 <= self.arc_deg < 180.0 - 2.0 * self.clothoid_deg
        check("arc_deg", is_short, "degrees >= 0, less than 180 with both clothoids")
        check("side", self.side in (LEFT, RIGHT), "1 (left) or -1 (right)")

    @property
    def angle_deg(self) -> float:
        """By how much the whole curve turns, whichever side, in degrees."""
        return 2.0 * self.clothoid_deg + self.arc_deg

    @property
    def clothoid_length_m(self) -> float:
        """Length of each clothoid: 2 alpha / (1 / R1 + 1 / R2), in metres."""
        alpha = np.radians(self.clothoid_deg)
        return float(2.0 * alpha / (1.0 / self.first_radius_m + 1.0 / self.radius_m))

    @property
    def arc_length_m(self) -> float:
        """Length of the arc, in metres."""
        return float(np.radians(self.arc_deg) * self.radius_m)

    @property
    def length_m(self) -> float:
        """Length of the whole curve, in metres."""
        return 2.0 * self.clothoid_length_m + self.arc_length_m

    @property
    def tangent_m(self) -> float:
        """Distance from either end to where the straights would meet.

        These are the straights before and after the curve.
        """
        half = 0.5 * np.radians(self.angle_deg)
        return float((self._half_way() * np.exp(-1j * half)).real / np.cos(half))

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 2) and angle turned after a distance.

        The position is ahead and left of the start.

        Before the curve and behind its end the path is straight. The angle counts in
        degrees, counter-clockwise.

        A clothoid that begins with a curvature is a piece of one that begins without;
        the points of that one are Fresnel's integrals.
        """
        distance = np.asarray(distance_m, dtype=np.float64)
        total = np.radians(self.angle_deg)
        from_start = np.clip(distance, 0.0, self.length_m)
        is_second_half = from_start > 0.5 * self.length_m
        # Seen from its end, backwards, the curve is its own mirror image.
        from_nearer_end = np.where(
            is_second_half, self.length_m - from_start, from_start
        )
        point, angle = self._first_half(from_nearer_end)
        half_way = self._half_way()
        turned = np.exp(1j * total)
        end = half_way + turned * np.conj(half_way)
        point = np.where(is_second_half, end - turned * np.conj(point), point)
        angle = np.where(is_second_half, total - angle, angle)
        point = point + np.minimum(distance, 0.0)
        point = point + np.maximum(distance - self.length_m, 0.0) * turned
        position = np.stack([point.real, self.side * point.imag], axis=-1)
        return position, self.side * np.degrees(angle)

    def turned_by(self, angle_deg: float) -> "Turn":
        """Turn with the arc for lanes that meet at another angle.

        Raises
        ------
        InputError
            The angle is not between 0 and 180 degrees.

        Where the clothoids alone would turn further, they are shorter and there is no
        arc.
        """
        if not 0.0 < angle_deg < 180.0:
            raise InputError("angle_deg", angle_deg, "0 < degrees < 180")
        arc_deg = angle_deg - 2.0 * self.clothoid_deg
        if abs(arc_deg) < _ANGLE_TOLERANCE_DEG:
            arc_deg = 0.0
        if arc_deg < 0.0:
            return replace(self, clothoid_deg=0.5 * angle_deg, arc_deg=0.0)
        return replace(self, arc_deg=arc_deg)

    def _half_way(self) -> complex:
        """Middle of the curve as a complex number: ahead, left."""
        point, _ = self._first_half(np.array(0.5 * self.length_m))
        return complex(point)

    def _first_half(
        self, distance: FloatArray
    ) -> tuple[NDArray[np.complex128], FloatArray]:
        """Points as complex numbers and angles in radians, as if turning left."""
        from scipy.special import fresnel

        first = 1.0 / self.first_radius_m
        curvature = 1.0 / self.radius_m
        length = self.clothoid_length_m
        # Of the curvature, per metre.
        growth = (curvature - first) / length
        # Of the clothoid that begins straight.
        skipped = first / growth
        scale = np.sqrt(np.pi / growth)

        on_clothoid = np.minimum(distance, length)
        sines, cosines = fresnel((on_clothoid + skipped) / scale)
        skipped_sine, skipped_cosine = fresnel(skipped / scale)
        point = (cosines - skipped_cosine) + 1j * (sines - skipped_sine)
        point = point * scale * np.exp(-0.5j * growth * skipped**2)
        angle = (first + 0.5 * growth * on_clothoid) * on_clothoid

        on_arc = np.maximum(distance - length, 0.0) * curvature
        point = point + 1j * self.radius_m * np.exp(1j * angle) * (
            1.0 - np.exp(1j * on_arc)
        )
        return point, angle + on_arc


class TurnAtSpeed(Struct, frozen=True, kw_only=True):
    """A turn, and how fast the VUT drives it.

    It is an entry of ``data/turning_paths.toml``.
    """

    side: Literal["far", "near"] = field(name="turn")
    speed_kmh: float
    first_radius_m: float
    radius_m: float
    clothoid_deg: float
    arc_deg: float

    @property
    def turn(self) -> Turn:
        """The curve."""
        same = ("first_radius_m", "radius_m", "clothoid_deg", "arc_deg")
        return Turn(
            side=_SIDES[self.side], **{name: getattr(self, name) for name in same}
        )


@cache
def load_turns() -> dict[str, TurnAtSpeed]:
    """The protocol's turns by name, such as "far_10".

    They are read from ``data/turning_paths.toml``.
    """
    table = load_data(__package__, "turning_paths.toml")
    return read_tables(table, TurnAtSpeed, "turning_paths.toml")


def pick_turn(side: str, speed_kmh: float) -> Turn:
    """Turn to a side on which the VUT drives at a speed.

    The side is "far" (left) or "near" (right).

    Beyond the tabulated speeds that of the nearest one, as the protocol rules for
    25 km/h.

    Raises
    ------
    InputError
        The side is unknown, the speed not positive, or between two tabulated
        ones.
    """
    check_one_of("turn", side, _SIDES)
    by_speed = {
        one.speed_kmh: one.turn for one in load_turns().values() if one.side == side
    }
    slowest = min(by_speed)
    fastest = max(by_speed)
    nearest_kmh = min(max(speed_kmh, slowest), fastest)
    if not 0.0 < speed_kmh < np.inf or nearest_kmh not in by_speed:
        known = ", ".join(f"{known_kmh:g}" for known_kmh in sorted(by_speed))
        expected = f"{known} km/h, or beyond the first or the last"
        raise InputError(f"speed of a {side} turn", speed_kmh, expected)
    return by_speed[nearest_kmh]


# ---------- from one lane into another
def join_by_turn(entry: Course, exit_course: Course, turn: Turn) -> tuple[Course, Turn]:
    """The course along a lane, round a turn into another lane, and along that one.

    Its origin is where the turn begins. The turn has the arc that the lanes'
    directions at its ends ask for, and is returned with it; it begins and ends on
    the lanes, wherever these bend.

    Raises
    ------
    InputError
        The lanes do not lie so that the turn joins them.
    """
    begin_m = end_m = 0.0
    for _ in range(_MAX_STEPS):
        # Both ends move along their lanes until the curve meets them.
        before = entry.tangent(begin_m)
        after = exit_course.tangent(end_m)
        angle_deg = turn.side * (
            (after.yaw_deg - before.yaw_deg + 180.0) % 360.0 - 180.0
        )
        fitted = turn.turned_by(angle_deg)
        corner = before.crossing_with(after)
        early_m = float(before.coordinates(corner)[0]) - fitted.tangent_m
        late_m = fitted.tangent_m + float(after.coordinates(corner)[0])
        if max(abs(early_m), abs(late_m)) < _MEETS_M:
            break
        begin_m += _DAMPING * early_m
        end_m += _DAMPING * late_m
    else:
        raise InputError(
            "turn", turn.radius_m, "lanes that a curve of this radius joins"
        )
    begin_m = begin_m + early_m
    end_m = end_m + late_m
    along = np.arange(0.0, fitted.length_m, _STEP_M)
    ahead_left, turned_deg = fitted.at(along)
    start = entry.tangent(begin_m)
    ahead = ahead_left[:, :1]
    left = ahead_left[:, 1:]
    round_turn = start.point_m + ahead * start.direction + left * start.left
    yaw = np.radians(start.yaw_deg + turned_deg)
    exit_yaw = exit_course.yaw_rad
    before_part = slice(0, max(entry._index(begin_m), 0))
    after_part = slice(exit_course._index(end_m) + 2, None)
    yaws = np.unwrap(
        np.concatenate([entry.yaw_rad[before_part], yaw, exit_yaw[after_part]])
    )
    points = np.concatenate(
        [entry.points_m[before_part], round_turn, exit_course.points_m[after_part]]
    )
    return _course_of(points, yaws, before_part.stop), fitted


def follow_lanes(chains_m: Sequence[FloatArray]) -> Course:
    """The smooth course along lanes one after the other.

    Its origin is where the first lane ends.
    """
    points = np.concatenate(chains_m)
    return _follow(tuple(map(tuple, points.tolist())), tuple(chains_m[0][-1].tolist()))


def follow_connection(
    before_m: FloatArray,
    connection_m: FloatArray,
    after_m: FloatArray,
    *,
    is_origin_behind: bool,
) -> Course:
    """The course along a lane, through a junction and along another lane.

    Lines are (n, 2); the junction's own lane is the connection.

    The lane through the junction is smoothed over 0.4 m, the others over 2 m, see
    :func:`follow_lane`: where a straight line becomes a circle of radius R, the course
    leaves it by 0.2 L^2 / R, 5 mm for 6 m. Its origin is where that lane begins, or
    ends.
    """
    chains = before_m, connection_m, after_m
    points = tuple(map(tuple, np.concatenate(chains).tolist()))
    close = len(before_m), len(before_m) + len(connection_m) - 1
    return _follow(points, points[close[is_origin_behind]], close)


def follow_gently(
    chains_m: Sequence[FloatArray], free_m: Sequence[float], *, origin: int
) -> Course:
    """The gentlest course along lanes that leaves their middles a little.

    The lanes follow one after the other.

    `chains_m`: points of the lanes in driving direction. World frame. `free_m`: how far
    it may leave each of them, > 0. `origin`: the lane at whose start its origin is;
    their number: where the last one ends.

    The smoothing spline of :func:`follow_lane` with L = 16 m, whose points weigh more
    from round to round where it leaves the lanes farther than it may, and 5 m to both
    sides of there.
    """
    if origin < len(chains_m):
        at_origin = chains_m[origin][0]
    else:
        at_origin = chains_m[-1][-1]
    free = np.repeat(free_m, [len(chain) for chain in chains_m])
    points = tuple(map(tuple, np.concatenate(chains_m).tolist()))
    return _gentle(points, tuple(free.tolist()), tuple(at_origin.tolist()))


# As _follow.
@lru_cache(maxsize=256)
def _gentle(
    points: tuple[tuple[float, ...], ...],
    free_m: tuple[float, ...],
    origin_m: tuple[float, ...],
) -> Course:
    """The course of :func:`follow_gently`, from values that can be hashed."""
    chain = np.array(points)
    is_new = np.append(True, np.hypot(*np.diff(chain, axis=0).T) > _SAME_POINT_M)
    free = np.array(free_m)[is_new]
    chain = _led_on(chain[is_new])
    along = along_m(chain)
    at = np.linspace(0.0, along[-1], int(along[-1] / _SAMPLE_M) + 2)
    samples = points_at(chain, at)
    near = int(_EASED_M / _SAMPLE_M)
    free_at = np.interp(at, along[1:-1], free)
    weight = np.ones(len(at))
    for _ in range(_MAX_STEPS):
        spline = _spline(at, samples - samples[0], smoothing_m=_GENTLE_M, weight=weight)
        excess = np.hypot(*(spline(at) - samples + samples[0]).T) / free_at
        if excess.max() <= 1.0:
            break
        # Where the course leaves the lanes too far, its points weigh more.
        heavier = np.maximum(1.03 * excess, 1.0) ** 2
        beside = sliding_window_view(np.pad(heavier, near), 2 * near + 1)
        weight *= beside.max(axis=1)
    return _smoothed(samples, at, origin_m, smoothing_m=_GENTLE_M, weight=weight)
