"""Places of objects: once, or repeated along a road, with their outlines."""

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from ...errors import InputError
from .attributes import MAX_SIZE_M, numbered, take_number, take_number_or, take_size
from .roads import Road

_SIZES = ("length", "width", "height", "radius")
_MAX_COPIES = 20_000  # of one <repeat>
_STEP_M = 2.0  # along what is swept
_BEYOND_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Copy:
    """One place of an object, or one end of a sweep; sizes of its body where given."""

    s_m: float
    t_m: float
    z_m: float
    length_m: float | None
    width_m: float | None
    height_m: float | None
    radius_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A <repeat> without distance: one body, interpolated between two cross-sections."""

    start: Copy
    end: Copy


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """An outline of an object at one place."""

    points_m: FloatArray  # (n, 2), open
    road_m: FloatArray  # (n, 2), the same as s and t; in bends only near the object
    bottom_m: FloatArray  # (n,)
    height_m: FloatArray  # (n,), above the bottom; 0: not given
    is_closed: bool  # it surrounds an area
    is_outer: bool  # that area is part of the object, not cut out of it


def read_places(element: Element, road: Road, where: str) -> Iterator[Copy | Sweep]:
    """All places of an object on its road; raises InputError if a <repeat> asks for too much."""
    own = Copy(
        s_m=take_number(element, "s", where),
        t_m=take_number(element, "t", where),
        z_m=take_number_or(element, "zOffset", where, 0.0),
        **{f"{size}_m": take_size(element, size, where) for size in _SIZES},
    )
    _check_reach(own, where)
    repeats = list(numbered(element, "repeat", where))
    if not repeats:
        if is_on(road, own.s_m):
            yield own
        return
    for repeat, here in repeats:
        start_m = take_number(repeat, "s", here)
        length_m = take_number(repeat, "length", here)
        distance_m = take_number(repeat, "distance", here)
        if length_m < 0.0 or distance_m < 0.0:
            key, value = ("length", length_m) if length_m < 0.0 else ("distance", distance_m)
            raise InputError(f"{here}.{key}", value, "metres, at least 0")
        start, end = (
            Copy(
                s_m=s_m,
                t_m=take_number_or(repeat, f"t{side}", here, own.t_m),
                z_m=take_number_or(repeat, f"zOffset{side}", here, own.z_m),
                **{
                    f"{size}_m": take_size(repeat, f"{size}{side}", here)
                    or getattr(own, f"{size}_m")
                    for size in _SIZES
                },
            )
            for side, s_m in (("Start", start_m), ("End", start_m + length_m))
        )
        _check_reach(start, here)
        _check_reach(end, here)
        if distance_m == 0.0 and length_m > 0.0:
            if is_on(road, start_m):
                end_m = min(end.s_m, road.length_m)
                yield Sweep(
                    start=start, end=_between(start, end, (end_m - start_m) / length_m, end_m)
                )
            continue
        n_copies = 1 if distance_m == 0.0 else int(length_m / distance_m + 1.0e-6) + 1
        if n_copies > _MAX_COPIES:
            raise InputError(f"{here}.distance", distance_m, f"at most {_MAX_COPIES:,} copies")
        for index in range(n_copies):
            s_m = start_m + index * distance_m
            if is_on(road, s_m):
                yield _between(start, end, index * distance_m / max(length_m, 1.0e-9), s_m)


def _check_reach(copy: Copy, where: str) -> None:
    for key, value in (("t", copy.t_m), ("zOffset", copy.z_m)):
        if abs(value) > MAX_SIZE_M:
            raise InputError(f"{where}.{key}", value, f"at most {MAX_SIZE_M:g} m off the road")


def is_on(road: Road, s_m: float) -> bool:
    """A station is on the road, with some tolerance for rounding."""
    return -_BEYOND_M <= s_m <= road.length_m + _BEYOND_M


def _between(start: Copy, end: Copy, share: float, s_m: float) -> Copy:
    def mix(name: str) -> float | None:
        one, other = getattr(start, name), getattr(end, name)
        return None if one is None or other is None else one + share * (other - one)

    return Copy(
        s_m=s_m,
        t_m=start.t_m + share * (end.t_m - start.t_m),
        z_m=start.z_m + share * (end.z_m - start.z_m),
        **{f"{size}_m": mix(f"{size}_m") for size in _SIZES},
    )


def place(road: Road, copy: Copy) -> tuple[FloatArray, float]:
    """Point (3,) of the road's plane below or above a copy, and heading of the road there."""
    points, heading = road.place(np.array([copy.s_m]), np.array([copy.t_m]))
    return points[0], float(heading[0])


def stations(sweep: Sweep) -> tuple[FloatArray, FloatArray, FloatArray]:
    """S and t (n,) along a sweep, and the share of the way (0 .. 1)."""
    n_points = max(2, int(np.ceil((sweep.end.s_m - sweep.start.s_m) / _STEP_M)) + 1)
    share = np.linspace(0.0, 1.0, n_points)
    s_m, t_m = (
        getattr(sweep.start, key) + share * (getattr(sweep.end, key) - getattr(sweep.start, key))
        for key in ("s_m", "t_m")
    )
    return s_m, t_m, share


def read_outlines(element: Element, road: Road, copy: Copy, where: str) -> list[Outline]:
    """Outlines of an object at one of its places."""
    found = [*numbered(element, "outline", where)]
    for group, here in numbered(element, "outlines", where):
        found += numbered(group, "outline", here)
    outlines = []
    for outline, here in found:
        rows = _read_corners(outline, element, road, copy, here)
        if not len(rows):
            continue
        reach_m = float(np.abs(rows[:, 2:] - [*place(road, copy)[0][2:], 0, copy.s_m, 0]).max())
        if reach_m > MAX_SIZE_M:
            raise InputError(f"{here}: corner", reach_m, f"at most {MAX_SIZE_M:g} m off")
        is_new = np.append(True, np.hypot(*np.diff(rows[:, :2], axis=0).T) > 1.0e-3)
        if len(rows) > 1 and np.hypot(*(rows[-1, :2] - rows[0, :2])) <= 1.0e-3:
            is_new[-1] = False  # closed by naming its first corner again
            is_new[0] = True
        rows = rows[is_new]
        outlines.append(
            Outline(
                points_m=rows[:, :2],
                road_m=rows[:, 4:6],
                bottom_m=rows[:, 2],
                height_m=np.maximum(rows[:, 3], 0.0),
                is_closed=_flag(outline, "closed"),
                is_outer=_flag(outline, "outer"),
            )
        )
    return outlines


def _flag(outline: Element, key: str) -> bool:
    return outline.get(key, "true").strip().lower() not in ("false", "0")


def _read_corners(
    outline: Element, element: Element, road: Road, copy: Copy, where: str
) -> FloatArray:
    """x, y, z, height, s, t of corners: (n, 6)."""
    foot, road_heading = place(road, copy)
    turn = take_number_or(element, "hdg", where, 0.0)
    corners = [
        tuple(take_number(corner, key, here) for key in "uv")
        + (take_number_or(corner, "z", here, 0.0), take_number_or(corner, "height", here, 0.0))
        for corner, here in numbered(outline, "cornerLocal", where)
    ]
    if corners:
        u, v, z, height = np.array(corners).T
        along, across = _turned(u, v, turn)
        x, y = _turned(along, across, road_heading)
        return np.column_stack(
            [
                *(foot[0] + x, foot[1] + y, foot[2] + copy.z_m + z, height),
                *(copy.s_m + along, copy.t_m + across),
            ]
        )
    corners = [
        tuple(take_number(corner, key, here) for key in "st")
        + (take_number_or(corner, "dz", here, 0.0), take_number_or(corner, "height", here, 0.0))
        for corner, here in numbered(outline, "cornerRoad", where)
    ]
    if not corners:
        return np.empty((0, 6))
    s, t, dz, height = np.array(corners).T
    s = s + copy.s_m - take_number(element, "s", where)
    t = t + copy.t_m - take_number(element, "t", where)
    points, _ = road.place(s, t)
    return np.column_stack([points[:, :2], points[:, 2] + dz, height, s, t])


def _turned(x: FloatArray, y: FloatArray, angle_rad: float) -> tuple[FloatArray, FloatArray]:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return x * cos - y * sin, x * sin + y * cos


def box_corners(copy: Copy, turn_rad: float) -> FloatArray | None:
    """Corners (4, 2) of a copy's box as s and t, or None if it has no length or width."""
    if copy.length_m is None or copy.width_m is None:
        return None
    u = 0.5 * copy.length_m * np.array([-1.0, 1.0, 1.0, -1.0])
    v = 0.5 * copy.width_m * np.array([-1.0, -1.0, 1.0, 1.0])
    along, across = _turned(u, v, turn_rad)
    return np.stack([copy.s_m + along, copy.t_m + across], axis=1)
