"""Paths on the road plane and motion along them."""

from dataclasses import dataclass, field
from functools import lru_cache, partial
from math import sin
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, freeze, set_arrays
from geometry.errors import InputError, check_field

from .courses import Course, Turn

MPS_PER_KMH = 1000.0 / 3600.0
"""Metres per second in a kilometre per hour.

scipy.constants has it, too, but takes long to load.
"""

# Chords of an arc of 8 m come within half a micrometre of it.
_TABLE_STEP_M = 0.005
# Points of a course that one step of the integration passes.
_TOW_STEPS = 10

# A path says where a body is after a distance. The middle of its footprint never moves
# further than the distance, and its line is never bent more than three times as much as
# the heading turns at most.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StraightPath:
    """A straight line, driven in one direction.

    Attributes
    ----------
    start_m : (2,) float
        East, north at distance 0. [m]
    yaw_deg : float
        Direction, counter-clockwise from east. [deg]
    direction : (2,) float
        The same as a unit vector.
    max_turn_rad_per_m : float
        Most that the heading changes in a metre. [rad/m]
    max_turn_change_rad_per_m2 : float
        Most that this change itself changes in a metre. [rad/m^2]
    """

    start_m: FloatArray
    yaw_deg: float
    direction: FloatArray = field(init=False, repr=False)
    max_turn_rad_per_m: ClassVar[float] = 0.0
    max_turn_change_rad_per_m2: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        set_arrays(self, "", start_m=(2,))
        object.__setattr__(self, "direction", _unit_vector(self.yaw_deg))

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Middle of the footprint (..., 2) and heading after a distance.

        They are given beyond the ends, too.
        """
        distance = np.asarray(distance_m, dtype=np.float64)
        position: FloatArray = self.start_m + distance[..., None] * self.direction
        return position, np.full(distance.shape, self.yaw_deg)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnPath:
    """A vehicle's way: straight on, round a turn, and straight on without end.

    Distances are those of the front axle's centre, which follows the line: the
    protocol's control point. The rear axle is dragged behind it and never slips
    sideways.

    Attributes
    ----------
    start_m : (2,) float
        East, north of the front axle's centre at distance 0. [m]
    yaw_deg : float
        Direction there, counter-clockwise from east. [deg]
    straight_m : float
        From there to the start of the turn. [m]
    turn : Turn
        The curve.
    wheelbase_m : float
        Front axle to rear axle. [m]
    front_axle_ahead_m : float
        Front axle ahead of the middle of the footprint. [m]
    """

    start_m: FloatArray
    yaw_deg: float
    straight_m: float
    turn: Turn
    wheelbase_m: float
    front_axle_ahead_m: float
    _direction: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        set_arrays(self, "", start_m=(2,))
        object.__setattr__(self, "_direction", _unit_vector(self.yaw_deg))
        if not 0.0 <= self.straight_m < np.inf:
            raise InputError("straight_m", self.straight_m, "metres, at least 0")
        _check_axles(self.wheelbase_m, self.front_axle_ahead_m)

    @property
    def max_turn_rad_per_m(self) -> float:
        """Curvature of the arc, in rad/m.

        A car turns no faster than the path that it is dragged along.
        """
        return 1.0 / max(self.turn.radius_m, self.wheelbase_m)

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """Bound of the change of curvature, in rad/m^2.

        The car turns by sin(lag) / wheelbase per metre, and its lag grows by
        the curvature.
        """
        return 1.0 / (self.turn.radius_m * self.wheelbase_m)

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Middle of the footprint and heading after a distance.

        See :meth:`StraightPath.at`.
        """
        # Built here, not with the path: who reads a cached path may never drive it.
        table = _build_table(self.turn, float(self.wheelbase_m))
        on_turn = np.asarray(distance_m, dtype=np.float64) - self.straight_m
        # On the turn by the table, before it and after it in closed form.
        inside = np.minimum(np.maximum(on_turn, 0.0), table.distance_m[-1])
        # Negative before the turn.
        beyond = on_turn - inside
        after = np.maximum(beyond, 0.0)
        exit_rad = table.exit_rad
        on_curve = np.interp(inside, table.distance_m, table.body_rad)
        lengths = after / self.wheelbase_m
        body = _aligned_rad(on_curve, exit_rad, table.exit_half_lag_tan, lengths)
        ahead = (
            np.interp(inside, table.distance_m, table.ahead_m)
            + np.minimum(beyond, 0.0)
            + after * np.cos(exit_rad)
            - self.front_axle_ahead_m * np.cos(body)
            + self.straight_m
        )
        on_left = np.interp(inside, table.distance_m, table.left_m)
        left = (
            on_left + after * np.sin(exit_rad) - self.front_axle_ahead_m * np.sin(body)
        )
        cosine, sine = self._direction
        east = self.start_m[0] + cosine * ahead - sine * left
        north = self.start_m[1] + sine * ahead + cosine * left
        return np.stack([east, north], axis=-1), self.yaw_deg + np.degrees(body)


def _aligned_rad(
    body_rad: FloatArray, exit_rad: float, half_lag_tan: float, after: FloatArray
) -> FloatArray:
    """Headings of a dragged body on a straight that follows a path.

    The body is `after` wheelbases along the straight; 0: before it.

    Dragged along a straight, the tangent of half the angle to it decays exponentially.
    """
    lag = 2.0 * np.arctan(half_lag_tan * np.exp(-after))
    return np.where(after > 0.0, exit_rad - lag, body_rad)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoursePath:
    """A road user's way along a course.

    The middle of the footprint stays on the course, and the body heads along
    it.

    Attributes
    ----------
    course : Course
        The line.
    start_m : float
        Station of the middle of the footprint at distance 0. [m]
    """

    course: Course
    start_m: float

    @property
    def max_turn_rad_per_m(self) -> float:
        """Largest curvature of the course, in rad/m."""
        return self.course.max_bend_per_m

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """Most that the curvature of the course changes in a metre."""
        return self.course.max_bend_change_per_m2

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position and heading after a distance; see :meth:`StraightPath.at`."""
        distance = np.asarray(distance_m, dtype=np.float64)
        position, yaw_rad = self.course.at(self.start_m + distance)
        return position, np.degrees(yaw_rad)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TowedPath:
    """A vehicle's way along a course, which the centre of its front axle follows.

    The rear axle is dragged behind it and never slips sideways, as on a
    :class:`TurnPath`. Far behind, where the course is straight, the body is aligned
    with it.

    Attributes
    ----------
    course : Course
        The line.
    start_m : float
        Station of the front axle's centre at distance 0. [m]
    wheelbase_m, front_axle_ahead_m : float
        As of a :class:`TurnPath`. [m]
    """

    course: Course
    start_m: float
    wheelbase_m: float
    front_axle_ahead_m: float
    _body_rad: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _check_axles(self.wheelbase_m, self.front_axle_ahead_m)
        object.__setattr__(
            self, "_body_rad", _tow(self.course, float(self.wheelbase_m))
        )

    @property
    def max_turn_rad_per_m(self) -> float:
        """Largest curvature, also as a bound for the middle of the body.

        It is that of the course, or so large that a third of it bounds the bend
        of the middle's line.

        That bend is at most the course's, and that of the body around the front axle:
        the second derivative of the heading b is |curvature - b'| / wheelbase, its
        first the sine of the lag.
        """
        bend = self.course.max_bend_per_m
        return bend * max(
            1.0, (1.0 + 3.0 * self.front_axle_ahead_m / self.wheelbase_m) / 3.0
        )

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """Bound of the change of curvature, in rad/m^2.

        The body turns by sin(lag) / wheelbase per metre, and its lag changes by
        both curvatures at most.
        """
        return 2.0 * self.course.max_bend_per_m / self.wheelbase_m

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Middle of the footprint and heading after a distance.

        See :meth:`StraightPath.at`.
        """
        station = self.start_m + np.asarray(distance_m, dtype=np.float64)
        front, _ = self.course.at(station)
        exit_rad = self.course.yaw_rad[-1]
        on_course = self.course.interpolate(station, self._body_rad)
        half_lag_tan = np.tan(0.5 * (exit_rad - self._body_rad[-1]))
        lengths = np.maximum(station - self.course.end_m, 0.0) / self.wheelbase_m
        body = _aligned_rad(on_course, exit_rad, half_lag_tan, lengths)
        ahead = np.stack([np.cos(body), np.sin(body)], axis=-1)
        return front - self.front_axle_ahead_m * ahead, np.degrees(body)


NORTH_TO_SOUTH = np.array([1.0, -1.0])
"""Mirrors east and north, for traffic that keeps left."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovedPath:
    """A path that is mirrored, then turned about the origin, then shifted.

    Attributes
    ----------
    path : Path
        The path as it was.
    ahead_m : float
        The new path begins so much farther on. [m]
    is_mirrored : bool
        North and south are swapped.
    turn_deg : float
        Counter-clockwise. [deg]
    shift_m : tuple[float, float]
        East, north. [m]
    """

    path: "Path"
    ahead_m: float = 0.0
    is_mirrored: bool = False
    turn_deg: float = 0.0
    shift_m: tuple[float, float] = (0.0, 0.0)

    @property
    def max_turn_rad_per_m(self) -> float:
        """As of the path itself, in rad/m."""
        return self.path.max_turn_rad_per_m

    @property
    def max_turn_change_rad_per_m2(self) -> float:
        """As of the path itself, in rad/m^2."""
        return self.path.max_turn_change_rad_per_m2

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """See :meth:`StraightPath.at`."""
        position_m, yaw_deg = self.path.at(
            np.asarray(distance_m, dtype=np.float64) + self.ahead_m
        )
        if self.is_mirrored:
            position_m = position_m * NORTH_TO_SOUTH
            yaw_deg = -yaw_deg
        if self.turn_deg or any(self.shift_m):
            position_m = rotated(position_m, self.turn_deg) + self.shift_m
            yaw_deg = yaw_deg + self.turn_deg
        return position_m, yaw_deg


Path = StraightPath | TurnPath | CoursePath | TowedPath | MovedPath


def rotated(vectors_m: ArrayLike, angle_deg: float) -> FloatArray:
    """Vectors (..., 2) turned about the origin, counter-clockwise."""
    cos = np.cos(np.radians(angle_deg))
    sin_ = np.sin(np.radians(angle_deg))
    turned: FloatArray = np.asarray(vectors_m, dtype=np.float64) @ [
        [cos, sin_],
        [-sin_, cos],
    ]
    return turned


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """How a body moves along its path over time.

    It stands at the path's start, sets off at `start_time_s`, and then keeps
    its speed, or brakes.

    Attributes
    ----------
    path : Path
        The path along which it moves.
    speed_mps : float
        Steady speed, which is the highest; 0: it stands at the path's start.
        [m/s]
    start_time_s : float
        When it sets off; the impact is at 0. [s]
    acceleration_distance_m : float
        Distance from rest to its speed, at constant acceleration; 0: it has its
        speed at once. [m]
    brake_time_s : float
        When it begins to brake, which is not before it is up to speed;
        infinite: it does not. [s]
    deceleration_mps2 : float
        How it brakes. [m/s^2]
    final_speed_mps : float
        Speed that it keeps after braking. [m/s]
    """

    path: Path
    speed_mps: float
    start_time_s: float
    acceleration_distance_m: float = 0.0
    brake_time_s: float = np.inf
    deceleration_mps2: float = 0.0
    final_speed_mps: float = 0.0

    def __post_init__(self) -> None:
        if self.speed_mps != 0.0 or self.acceleration_distance_m != 0.0:
            _check_speed(self.speed_mps, self.acceleration_distance_m, "motion.")
        check = partial(check_field, self, "motion")
        check("start_time_s", bool(np.isfinite(self.start_time_s)), "a finite time")
        if self.brake_time_s == np.inf:
            return
        check("deceleration_mps2", 0.0 < self.deceleration_mps2 < np.inf, "> 0 m/s^2")
        is_slower = 0.0 <= self.final_speed_mps < self.speed_mps
        check("final_speed_mps", is_slower, "0 <= it < speed_mps")
        begin_s = (
            self.start_time_s + 2.0 * self.acceleration_distance_m / self.speed_mps
        )
        # Nor NaN.
        check("brake_time_s", begin_s <= self.brake_time_s, f"from {begin_s:g} on")

    @property
    def acceleration_mps2(self) -> float:
        """Most that its speed changes in a second, in m/s^2.

        While it gains speed that is v^2 / (2 a) over the acceleration distance
        a.
        """
        if self.acceleration_distance_m == 0.0:
            return self.deceleration_mps2
        gained = self.speed_mps**2 / (2.0 * self.acceleration_distance_m)
        return max(gained, self.deceleration_mps2)

    def distance_m(self, time_s: ArrayLike) -> FloatArray:
        """Distance from the path's start at each time, in metres."""
        steady = self._steady_distance_m(time_s)
        if self.brake_time_s == np.inf:
            return steady
        return steady - self._braked_m(time_s)

    def _braked_m(self, time_s: ArrayLike) -> FloatArray:
        """Distance that it is behind where it would be if it did not brake."""
        braking_s = np.maximum(
            0.0, np.asarray(time_s, dtype=np.float64) - self.brake_time_s
        )
        lost_mps = self.speed_mps - self.final_speed_mps
        slowing_s = np.minimum(braking_s, lost_mps / self.deceleration_mps2)
        slowed_m: FloatArray = 0.5 * self.deceleration_mps2 * slowing_s**2
        return slowed_m + lost_mps * (braking_s - slowing_s)

    def _steady_distance_m(self, time_s: ArrayLike) -> FloatArray:
        """Distance covered at times if it does not brake, in metres."""
        moving_s = np.maximum(
            0.0, np.asarray(time_s, dtype=np.float64) - self.start_time_s
        )
        if self.acceleration_distance_m == 0.0:
            return self.speed_mps * moving_s
        up_to_speed_s = 2.0 * self.acceleration_distance_m / self.speed_mps
        gaining_s = np.minimum(moving_s, up_to_speed_s)
        gained_m = self.acceleration_distance_m * (gaining_s / up_to_speed_s) ** 2
        return gained_m + self.speed_mps * (moving_s - gaining_s)


def travel_time_s(
    distance_m: float, *, speed_mps: float, acceleration_distance_m: float = 0.0
) -> float:
    """Time from rest to a distance; the inverse of :meth:`Motion.distance_m`.

    With the speed v it is 2 a / v for the acceleration distance a, then 1 / v per
    metre.

    Raises
    ------
    InputError
        The speed is not positive, or a distance is negative.

    Examples
    --------
    >>> travel_time_s(10.0, speed_mps=2.0, acceleration_distance_m=1.0)
    5.5
    """
    _check_speed(speed_mps, acceleration_distance_m, "")
    if not 0.0 <= distance_m < np.inf:
        raise InputError("distance_m", distance_m, "metres, at least 0")
    if distance_m < acceleration_distance_m:
        return float(2.0 * np.sqrt(acceleration_distance_m * distance_m) / speed_mps)
    return float((distance_m + acceleration_distance_m) / speed_mps)


class _TurnTable(NamedTuple):
    """A vehicle on a turn, ahead and left of the turn's start, whose direction is 0.

    Attributes
    ----------
    distance_m : (n,) float
        From its start to its end. [m]
    ahead_m, left_m : (n,) float
        Of the front axle. [m]
    body_rad : (n,) float
        Heading of the body. [rad]
    exit_rad : float
        Direction of the path after the turn. [rad]
    exit_half_lag_tan : float
        Tangent of half the angle by which the body lags behind there.
    """

    distance_m: FloatArray
    ahead_m: FloatArray
    left_m: FloatArray
    body_rad: FloatArray
    exit_rad: float
    exit_half_lag_tan: float


# The same few turns are driven again and again.
@lru_cache(maxsize=64)
def _build_table(turn: Turn, wheelbase_m: float) -> _TurnTable:
    """Places and headings of a vehicle on a turn, a step apart."""
    # Two points to a step of the integration, which ends where the turn does.
    n_steps = int(turn.length_m / (2.0 * _TABLE_STEP_M)) + 1
    distance = np.linspace(0.0, turn.length_m, 2 * n_steps + 1)
    point, angle_deg = turn.at(distance)
    path_rad = np.radians(angle_deg)
    body_rad = _drag(path_rad, float(distance[1]), wheelbase_m, stride=2)
    ahead, left = (freeze(axis.copy()) for axis in point.T)
    exit_rad = float(path_rad[-1])
    half_lag_tan = float(np.tan(0.5 * (exit_rad - body_rad[-1])))
    return _TurnTable(
        freeze(distance), ahead, left, freeze(body_rad), exit_rad, half_lag_tan
    )


# The same few courses are driven again and again.
@lru_cache(maxsize=64)
def _tow(course: Course, wheelbase_m: float) -> FloatArray:
    """Heading of a body dragged along a course, at its points, (n,)."""
    step_m = (course.end_m - course.begin_m) / (len(course.yaw_rad) - 1)
    return freeze(_drag(course.yaw_rad, step_m, wheelbase_m, stride=_TOW_STEPS))


def _drag(
    path_rad: FloatArray, step_m: float, wheelbase_m: float, *, stride: int
) -> FloatArray:
    """Heading of a body whose front axle follows a path, (n,), in radians.

    At first it is aligned with the path. The rate at which it turns is the sine of its
    angle to the path by the wheelbase; Runge and Kutta's classical method integrates
    it.

    Parameters
    ----------
    path_rad : (n,) float
        Direction of the path at even steps. [rad]
    step_m : float
        From one point of the path to the next. [m]
    wheelbase_m : float
        Front axle to rear axle. [m]
    stride : int
        Points that one step of the integration passes; even.
    """
    # Two points to a step: its start, its middle.
    yaw = path_rad[:: stride // 2]
    n_steps = (len(yaw) - 1) // 2
    path = yaw[: 2 * n_steps + 1].tolist()
    gain = stride * step_m / wheelbase_m
    body = path[0]
    nodes = [body]
    for step in range(n_steps):
        begin, middle, end = path[2 * step : 2 * step + 3]
        # The classical Runge-Kutta step of order four.
        first = gain * sin(begin - body)
        second = gain * sin(middle - body - 0.5 * first)
        third = gain * sin(middle - body - 0.5 * second)
        fourth = gain * sin(end - body - third)
        body += (first + 2.0 * (second + third) + fourth) / 6.0
        nodes.append(body)
    slope = np.sin(yaw[: 2 * n_steps + 1 : 2] - nodes) * gain / stride
    return _hermite(np.array(nodes), slope, stride, len(path_rad))


def _hermite(
    nodes: FloatArray, slope: FloatArray, stride: int, n_points: int
) -> FloatArray:
    """Cubics through nodes that are a stride apart, at 0, 1, 2 .., (n_points,).

    With slopes (n_nodes,) at the nodes; constant behind the last one. It is SciPy's
    CubicHermiteSpline, which takes longer to load than the whole question to read.
    """
    every = np.minimum(np.arange(n_points), stride * (len(nodes) - 1))
    piece = np.minimum(every // stride, len(nodes) - 2)
    offset = (every - stride * piece).astype(np.float64)
    mean_slope = np.diff(nodes) / stride
    twist = (slope[:-1] + slope[1:] - 2.0 * mean_slope) / stride
    quadratic = (mean_slope - slope[:-1]) / stride - twist
    cubic = twist / stride
    found: FloatArray = (
        nodes[piece]
        + slope[piece] * offset
        + quadratic[piece] * offset**2
        + cubic[piece] * (offset**2 * offset)
    )
    return found


def _check_axles(wheelbase_m: float, front_axle_ahead_m: float) -> None:
    """Raise InputError unless the front axle is ahead and not too far."""
    if not 0.0 < wheelbase_m < np.inf:
        raise InputError("wheelbase_m", wheelbase_m, "> 0 metres")
    if not 0.0 <= front_axle_ahead_m <= wheelbase_m:
        raise InputError(
            "front_axle_ahead_m", front_axle_ahead_m, "0 <= metres <= wheelbase"
        )


def _unit_vector(yaw_deg: float) -> FloatArray:
    """Unit vector in a direction, (2,), counter-clockwise from east."""
    if not np.isfinite(yaw_deg):
        raise InputError("yaw_deg", yaw_deg, "finite degrees")
    yaw = np.radians(yaw_deg)
    return freeze(np.array([np.cos(yaw), np.sin(yaw)]))


def _check_speed(speed_mps: float, acceleration_distance_m: float, where: str) -> None:
    """Raise InputError unless a speed and its run-up are possible."""
    if not 0.0 < speed_mps < np.inf:
        raise InputError(f"{where}speed_mps", speed_mps, "> 0 metres per second")
    if not 0.0 <= acceleration_distance_m < np.inf:
        got = acceleration_distance_m
        raise InputError(f"{where}acceleration_distance_m", got, "metres, at least 0")
