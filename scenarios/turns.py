"""Turning paths of the VUT: clothoid, arc, clothoid; from ``data/turning_paths.toml``."""

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.files import load_toml, pick, read_tables

LEFT, RIGHT = 1, -1
_SIDES = {"far": LEFT, "near": RIGHT}  # right-hand traffic
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
        By how much each clothoid turns: its curvature grows linearly with its length. [deg]
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
        if not 0.0 < self.radius_m < np.inf:
            raise InputError("turn.radius_m", self.radius_m, "> 0 metres")
        if not self.first_radius_m > self.radius_m:
            raise InputError("turn.first_radius_m", self.first_radius_m, "more than radius_m")
        if not 0.0 < self.clothoid_deg < 90.0:
            raise InputError("turn.clothoid_deg", self.clothoid_deg, "0 < degrees < 90")
        if not 0.0 <= self.arc_deg < 180.0 - 2.0 * self.clothoid_deg:
            raise InputError(
                "turn.arc_deg", self.arc_deg, "degrees >= 0, less than 180 with both clothoids"
            )
        if self.side not in (LEFT, RIGHT):
            raise InputError("turn.side", self.side, "1 (left) or -1 (right)")

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
        """From either end of the curve to where the straights before and after it would meet."""
        half = 0.5 * np.radians(self.angle_deg)
        return float((self._half_way() * np.exp(-1j * half)).real / np.cos(half))

    def at(self, distance_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position (..., 2), ahead and left of the start, and angle turned after a distance.

        Before the curve and behind its end the path is straight. The angle counts in degrees,
        counter-clockwise.

        Notes
        -----
        A clothoid that begins with a curvature is a piece of one that begins without; the points
        of that one are Fresnel's integrals.
        """
        distance = np.asarray(distance_m, dtype=np.float64)
        total = np.radians(self.angle_deg)
        from_start = np.clip(distance, 0.0, self.length_m)
        is_second_half = from_start > 0.5 * self.length_m
        # Seen from its end, backwards, the curve is its own mirror image.
        from_nearer_end = np.where(is_second_half, self.length_m - from_start, from_start)
        point, angle = self._first_half(from_nearer_end)
        half_way, turned = self._half_way(), np.exp(1j * total)
        end = half_way + turned * np.conj(half_way)
        point = np.where(is_second_half, end - turned * np.conj(point), point)
        angle = np.where(is_second_half, total - angle, angle)
        point = point + np.minimum(distance, 0.0)
        point = point + np.maximum(distance - self.length_m, 0.0) * turned
        position = np.stack([point.real, self.side * point.imag], axis=-1)
        return position, self.side * np.degrees(angle)

    def turned_by(self, angle_deg: float) -> "Turn":
        """The same turn with another arc, for lanes that meet at another angle.

        Where the clothoids alone would turn further, they are shorter and there is no arc.

        Raises
        ------
        InputError
            The angle is not between 0 and 180 degrees.
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
        point, _ = self._first_half(np.array(0.5 * self.length_m))
        return complex(point)

    def _first_half(self, distance: FloatArray) -> tuple[NDArray[np.complex128], FloatArray]:
        """Points as complex numbers and angles in radians, as if turning left."""
        from scipy.special import fresnel

        first, curvature = 1.0 / self.first_radius_m, 1.0 / self.radius_m
        length = self.clothoid_length_m
        growth = (curvature - first) / length  # of the curvature, per metre
        skipped = first / growth  # of the clothoid that begins straight
        scale = np.sqrt(np.pi / growth)

        on_clothoid = np.minimum(distance, length)
        sines, cosines = fresnel((on_clothoid + skipped) / scale)
        skipped_sine, skipped_cosine = fresnel(skipped / scale)
        point = (cosines - skipped_cosine) + 1j * (sines - skipped_sine)
        point = point * scale * np.exp(-0.5j * growth * skipped**2)
        angle = (first + 0.5 * growth * on_clothoid) * on_clothoid

        on_arc = np.maximum(distance - length, 0.0) * curvature
        point = point + 1j * self.radius_m * np.exp(1j * angle) * (1.0 - np.exp(1j * on_arc))
        return point, angle + on_arc


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnAtSpeed:
    """A turn and how fast the VUT drives it, in km/h."""

    turn: Turn
    speed_kmh: float


class _TurnEntry(Struct, frozen=True, kw_only=True):
    """A turn in ``data/turning_paths.toml``."""

    turn: Literal["far", "near"]
    speed_kmh: float
    first_radius_m: float
    radius_m: float
    clothoid_deg: float
    arc_deg: float


@cache
def load_turns() -> dict[str, TurnAtSpeed]:
    """The protocol's turns by name, such as "far_10", from ``data/turning_paths.toml``."""
    table = load_toml(files(__package__) / "data" / "turning_paths.toml")
    turns = {}
    for name, entry in read_tables(table, _TurnEntry, "turning_paths.toml").items():
        turn = Turn(
            first_radius_m=entry.first_radius_m,
            radius_m=entry.radius_m,
            clothoid_deg=entry.clothoid_deg,
            arc_deg=entry.arc_deg,
            side=_SIDES[entry.turn],
        )
        turns[name] = TurnAtSpeed(turn=turn, speed_kmh=entry.speed_kmh)
    return turns


def pick_turn(side: str, speed_kmh: float) -> Turn:
    """Turn to a side, "far" (left) or "near" (right), on which the VUT drives at a speed.

    Faster than all tabulated speeds: that of the fastest, as the protocol rules for 25 km/h; slower
    than all: that of the slowest.

    Raises
    ------
    InputError
        The side is unknown, the speed not positive, or between two tabulated ones.
    """
    sign = pick(_SIDES, side, "turn")
    by_speed = {
        entry.speed_kmh: entry.turn for entry in load_turns().values() if entry.turn.side == sign
    }
    slowest, fastest = min(by_speed), max(by_speed)
    nearest_kmh = min(max(speed_kmh, slowest), fastest)
    if not 0.0 < speed_kmh < np.inf or nearest_kmh not in by_speed:
        known = ", ".join(f"{known_kmh:g}" for known_kmh in sorted(by_speed))
        raise InputError(
            f"speed of a {side} turn", speed_kmh, f"{known} km/h, or beyond the first or the last"
        )
    turn: Turn = by_speed[nearest_kmh]
    return turn
