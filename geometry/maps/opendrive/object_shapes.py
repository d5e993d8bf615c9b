"""Places of OpenDRIVE objects along a road, their outlines and solids."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from ...arrays import FloatArray
from ...errors import InputError
from ...lines import steps_m
from ...scene import Mesh, join
from ..source_map import clip_ears, extrude, unit_ball
from .roads import (
    MAX_SIZE_M,
    Road,
    assumed,
    load_facts,
    numbered,
    take_number,
    take_number_or,
    take_size,
    turned,
)

_SIZES = ("length", "width", "height", "radius")
# Of one <repeat>.
_MAX_COPIES = 20_000
# Along a sweep.
_STEP_M = 2.0
_BEYOND_M = 1.0
# Lower slopes are levelled.
_FLAT_M = 0.05
_STRAIGHT_M = 0.02
# Corners of a cylinder.
_N_ROUND = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Spot:
    """One place of an object; sizes of its body where given.

    Attributes
    ----------
    s_m : float
        Along the road. [m]
    t_m : float
        To the left of the reference line. [m]
    z_m : float
        Above the road. [m]
    length_m : float or None
        Size along the object; None: not given. [m]
    width_m : float or None
        Size across the object; None: not given. [m]
    height_m : float or None
        Size upwards; None: not given. [m]
    radius_m : float or None
        Radius of a round object; None: not given. [m]
    end : 'Spot or None'
        Of a <repeat> without distance: one body from here to there.
    """

    s_m: float
    t_m: float
    z_m: float
    length_m: float | None
    width_m: float | None
    height_m: float | None
    radius_m: float | None
    end: "Spot | None" = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """An outline of an object at one place."""

    # (n, 2), open.
    points_m: FloatArray
    # (n, 2), the same as s and t; in bends only near the object.
    road_m: FloatArray
    # (n,).
    bottom_m: FloatArray
    # (n,), above the bottom; 0: not given.
    height_m: FloatArray
    # It surrounds an area.
    is_closed: bool


def read_places(element: Element, road: Road, where: str) -> Iterator[Spot]:
    """All places of an object on its road.

    An object has one place, or those of its <repeat> elements.

    Parameters
    ----------
    element : Element
        XML element.
    road : Road
        The road.
    where : str
        File and element at hand, for messages.

    Yields
    ------
    spot : Spot
        Places beyond the ends of the road are left out.

    Raises
    ------
    InputError
        A <repeat> asks for too many copies, or a number is missing or out of
        range.
    """
    own = _read_spot(element, "", where, take_number(element, "s", where), None)
    repeats = list(numbered(element, "repeat", where))
    if not repeats and is_on(road, own.s_m):
        yield own
    for repeat, here in repeats:
        keys = ("s", "length", "distance")
        start_m, length_m, distance_m = (take_number(repeat, key, here) for key in keys)
        for key, value in (("length", length_m), ("distance", distance_m)):
            if value < 0.0:
                raise InputError(f"{here}.{key}", value, "metres, at least 0")
        start = _read_spot(repeat, "Start", here, start_m, own)
        end = _read_spot(repeat, "End", here, start_m + length_m, own)
        if distance_m == 0.0 and length_m > 0.0:
            if is_on(road, start_m):
                end_m = min(end.s_m, road.length_m)
                yield replace(
                    start,
                    end=_between(start, end, (end_m - start_m) / length_m, end_m),
                )
            continue
        if distance_m == 0.0:
            n_copies = 1
        else:
            n_copies = int(length_m / distance_m + 1.0e-6) + 1
        if n_copies > _MAX_COPIES:
            raise InputError(
                f"{here}.distance",
                distance_m,
                f"at most {_MAX_COPIES:,} copies",
            )
        for index in range(n_copies):
            s_m = start_m + index * distance_m
            if is_on(road, s_m):
                yield _between(
                    start,
                    end,
                    index * distance_m / max(length_m, 1.0e-9),
                    s_m,
                )


def _read_spot(
    element: Element,
    side: str,
    where: str,
    s_m: float,
    own: Spot | None,
) -> Spot:
    """Place and sizes of an object, or of one side of a <repeat>.

    Parameters
    ----------
    element : Element
        XML element.
    side : {"", "Start", "End"}
        Ending of the attributes.
    where : str
        File and element at hand, for messages.
    s_m : float
        Where it lies along the road. [m]
    own : Spot or None
        The object's own place, whose values a <repeat> may leave out; None: the
        object itself is read.

    Returns
    -------
    spot : Spot
        Without an end.

    Raises
    ------
    InputError
        It lies too far off the road, or a number is not finite.
    """
    if own is None:
        t_m = take_number(element, "t", where)
    else:
        t_m = take_number_or(element, f"t{side}", where, own.t_m)
    usual_z_m = 0.0
    if own:
        usual_z_m = own.z_m
    z_m = take_number_or(element, f"zOffset{side}", where, usual_z_m)
    for key, value in (("t", t_m), ("zOffset", z_m)):
        if abs(value) > MAX_SIZE_M:
            raise InputError(
                f"{where}.{key}",
                value,
                f"at most {MAX_SIZE_M:g} m off the road",
            )
    sizes: dict[str, Any] = {}
    for size in _SIZES:
        given_m = take_size(element, f"{size}{side}", where)
        sizes[f"{size}_m"] = given_m or getattr(own, f"{size}_m", None)
    return Spot(s_m=s_m, t_m=t_m, z_m=z_m, **sizes)


def is_on(road: Road, s_m: float) -> bool:
    """True if a station lies on the road, within a tolerance for rounding."""
    return -_BEYOND_M <= s_m <= road.length_m + _BEYOND_M


def _between(start: Spot, end: Spot, share: float, s_m: float) -> Spot:
    """Place between two others, as copies of a <repeat> have it.

    Parameters
    ----------
    start : Spot
        First place.
    end : Spot
        Last place.
    share : float
        How far it lies from the first towards the last, 0 to 1.
    s_m : float
        Where it lies along the road. [m]

    Returns
    -------
    spot : Spot
        Sizes are None where one side has none.
    """

    def mix(name: str) -> float | None:
        one = getattr(start, name)
        other = getattr(end, name)
        if one is None or other is None:
            return None
        return float(one + share * (other - one))

    names = ("t_m", "z_m", *(f"{size}_m" for size in _SIZES))
    mixed: dict[str, Any] = {name: mix(name) for name in names}
    return Spot(s_m=s_m, **mixed)


def place(road: Road, spot: Spot) -> tuple[FloatArray, float]:
    """Point of the road below or above a place, and the heading there.

    Parameters
    ----------
    road : Road
        The road.
    spot : Spot
        Place of the object.

    Returns
    -------
    point_m : (3,) float
        In the coordinates of the map. [m]
    heading_rad : float
        Of the road's reference line. [rad]
    """
    points, heading = road.place(np.array([spot.s_m]), np.array([spot.t_m]))
    return points[0], float(heading[0])


def read_outlines(
    element: Element,
    road: Road,
    spot: Spot,
    where: str,
) -> Iterator[Outline]:
    """Outlines of an object at one of its places.

    Parameters
    ----------
    element : Element
        XML element.
    road : Road
        The road.
    spot : Spot
        Place of the object.
    where : str
        File and element at hand, for messages.

    Yields
    ------
    outline : Outline
        Without corners that repeat the one before; those of courtyards are left out.

    Raises
    ------
    InputError
        A corner lies too far away, or a number is missing or not finite.
    """
    found = [*numbered(element, "outline", where)]
    for group, here in numbered(element, "outlines", where):
        found += numbered(group, "outline", here)
    for outline, here in found:
        rows = _read_corners(outline, element, road, spot, here)
        is_courtyard = not _is_true(outline, "outer")
        if is_courtyard or not len(rows):
            continue
        # How far its corners lie from the place, in height, along and across the road.
        foot, _ = place(road, spot)
        off_m = rows[:, 2:] - [foot[2], 0, spot.s_m, 0]
        reach_m = float(np.abs(off_m).max())
        if reach_m > MAX_SIZE_M:
            raise InputError(
                f"{here}: corner",
                reach_m,
                f"at most {MAX_SIZE_M:g} m off",
            )
        is_new = np.append(True, steps_m(rows) > 1.0e-3)
        if len(rows) > 1 and np.hypot(*(rows[-1, :2] - rows[0, :2])) <= 1.0e-3:
            is_new[-1] = False
            # Closed by naming its first corner again.
            is_new[0] = True
        rows = rows[is_new]
        yield Outline(
            points_m=rows[:, :2],
            road_m=rows[:, 4:6],
            bottom_m=rows[:, 2],
            height_m=np.maximum(rows[:, 3], 0.0),
            is_closed=_is_true(outline, "closed"),
        )


def _is_true(element: Element, key: str) -> bool:
    """Value of a yes-or-no attribute; True if it is missing."""
    text = element.get(key, "true").strip().lower()
    return text not in ("false", "0")


def _read_corners(
    outline: Element,
    element: Element,
    road: Road,
    spot: Spot,
    where: str,
) -> FloatArray:
    """Corners of an outline as x, y, z, height, s and t: (n, 6).

    Parameters
    ----------
    outline : Element
        Element with <cornerLocal> or <cornerRoad> children.
    element : Element
        XML element.
    road : Road
        The road.
    spot : Spot
        Place of the object.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    corners : (n, 6) float
        Empty if it has no corner. [m]
    """
    foot, road_heading = place(road, spot)
    turn = take_number_or(element, "hdg", where, 0.0)

    def read(tag: str, keys: str, height_key: str) -> list[tuple[float, ...]]:
        """Values of all corners with a tag: the keys, then two heights."""
        rows = []
        for corner, here in numbered(outline, tag, where):
            row = [take_number(corner, key, here) for key in keys]
            row.append(take_number_or(corner, height_key, here, 0.0))
            row.append(take_number_or(corner, "height", here, 0.0))
            rows.append(tuple(row))
        return rows

    corners = read("cornerLocal", "uv", "z")
    if corners:
        u, v, z, height = np.array(corners).T
        along, across = turned(u, v, turn)
        x, y = turned(along, across, road_heading)
        on_map = (foot[0] + x, foot[1] + y, foot[2] + spot.z_m + z, height)
        return np.column_stack([*on_map, spot.s_m + along, spot.t_m + across])
    corners = read("cornerRoad", "st", "dz")
    if not corners:
        return np.empty((0, 6))
    s, t, dz, height = np.array(corners).T
    s = s + spot.s_m - take_number(element, "s", where)
    t = t + spot.t_m - take_number(element, "t", where)
    points, _ = road.place(s, t)
    return np.column_stack([points[:, :2], points[:, 2] + dz, height, s, t])


def box_corners(
    spot: Spot,
    length_m: float,
    width_m: float,
    turn_rad: float,
) -> FloatArray:
    """Corners of a place's box as s and t, (4, 2).

    Parameters
    ----------
    spot : Spot
        Place of the object.
    length_m : float
        Along the object. [m]
    width_m : float
        Across the object. [m]
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]

    Returns
    -------
    corners_m : (4, 2) float
        Counter-clockwise. [m]
    """
    u = 0.5 * length_m * np.array([-1.0, 1.0, 1.0, -1.0])
    v = 0.5 * width_m * np.array([-1.0, -1.0, 1.0, 1.0])
    along, across = turned(u, v, turn_rad)
    return np.stack([spot.s_m + along, spot.t_m + across], axis=1)


# ---------- solids
def build_prism(
    outline_m: FloatArray,
    *,
    bottom_m: FloatArray,
    top_m: FloatArray,
    where: str,
) -> Mesh:
    """Closed solid over an outline, with its own heights at each corner.

    If the outline crosses itself, floor and roof are level at the lowest and highest
    corner.

    Parameters
    ----------
    outline_m : (n, 2) float
        Open outline. [m]
    bottom_m : (n,) float
        Height of the floor at each corner. [m]
    top_m : (n,) float
        Height of the roof at each corner. [m]
    where : str
        File and element at hand, for messages.

    Returns
    -------
    mesh : Mesh
        Vertices, and triangles counter-clockwise seen from outside.

    Raises
    ------
    InputError
        The outline has no area, or the solid no height.
    """
    is_flat = max(np.ptp(bottom_m), np.ptp(top_m)) < _FLAT_M or len(outline_m) < 3
    if is_flat or not shapely.Polygon(outline_m).is_valid:
        low_m = float(bottom_m.min())
        high_m = float(top_m.max())
        return extrude(
            outline_m,
            bottom_m=low_m,
            top_m=high_m,
            where=where,
        )
    if not (top_m > bottom_m).any():
        raise InputError(
            f"{where}: height",
            float((top_m - bottom_m).max()),
            "metres, > 0",
        )
    way = slice(None, None, -1)
    if shapely.LinearRing(outline_m).is_ccw:
        way = slice(None)
    corners = outline_m[way]
    bottom = bottom_m[way]
    top = np.maximum(top_m, bottom_m)[way]
    # Roof and floor by ear clipping, and two triangles for each side.
    n = len(corners)
    roof = clip_ears(corners, [n])
    here = np.arange(n)
    following = (here + 1) % n
    sides = np.stack(
        [[here, following, following + n], [here, following + n, here + n]]
    )
    sides = np.moveaxis(sides, 1, 2).reshape(-1, 3)
    vertices = np.concatenate(
        [np.column_stack([corners, bottom]), np.column_stack([corners, top])]
    )
    return vertices, np.concatenate([roof[:, ::-1], roof + n, sides]).astype(np.int32)


def build_band(
    line_m: FloatArray,
    left: FloatArray,
    *,
    width_m: Any,
    bottom_m: Any,
    top_m: Any,
) -> Mesh:
    """Wall along a line, closed at both ends.

    Parameters
    ----------
    line_m : (n, 2) float
        Middle of the wall. [m]
    left : (n, 2) float
        Unit vectors to its left.
    width_m : (n,) float
        Thickness. [m]
    bottom_m : (n,) float
        Height of its foot. [m]
    top_m : (n,) float
        Height of its top. [m]

    Returns
    -------
    mesh : Mesh
        Vertices, and triangles counter-clockwise seen from outside.
    """
    table = np.column_stack([line_m, left, width_m, bottom_m, top_m])
    share = np.linspace(0.0, 1.0, len(table))[:, None]
    if np.abs(table - (table[0] + share * (table[-1] - table[0]))).max() < _STRAIGHT_M:
        table = table[[0, -1]]
    line = table[:, :2]
    normal = table[:, 2:4]
    half = 0.5 * table[:, 4:5]
    bottom = table[:, 5]
    top = table[:, 6]
    # (n, 4, 3): right, left, left above, right above; seen from its end they run
    # clockwise
    corners = ((-half, bottom), (half, bottom), (half, top), (-half, top))
    ring = np.stack(
        [np.column_stack([line + by * normal, z]) for by, z in corners],
        axis=1,
    )
    # Two triangles for each side of each stretch, then both ends.
    first = 4 * np.arange(len(line) - 1)[:, None]
    corner = np.arange(4)
    here = first + corner
    next_one = first + (corner + 1) % 4
    sides = np.stack([[here, next_one, next_one + 4], [here, next_one + 4, here + 4]])
    sides = np.moveaxis(sides, 1, -1).reshape(-1, 3)
    end = 4 * (len(line) - 1)
    caps = np.array(
        [[0, 2, 1], [0, 3, 2], [end, end + 1, end + 2], [end, end + 2, end + 3]]
    )
    return ring.reshape(-1, 3), np.concatenate([sides, caps]).astype(np.int32)


def build_cylinder(foot_m: FloatArray, *, radius_m: float, height_m: float) -> Mesh:
    """Upright cylinder.

    Parameters
    ----------
    foot_m : (3,) float
        Middle of its base. [m]
    radius_m : float
        Radius. [m]
    height_m : float
        Height. [m]

    Returns
    -------
    mesh : Mesh
        Twelve sides.
    """
    angle = 2.0 * np.pi * np.arange(_N_ROUND) / _N_ROUND
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices, triangles = extrude(ring, bottom_m=0.0, top_m=1.0)
    return vertices * [radius_m, radius_m, height_m] + foot_m, triangles


def build_tree(foot_m: FloatArray, *, crown_radius_m: float, height_m: float) -> Mesh:
    """Trunk and an ellipsoid of leaves.

    Parameters
    ----------
    foot_m : (3,) float
        Middle of the trunk's base. [m]
    crown_radius_m : float
        Radius of the crown. [m]
    height_m : float
        Height of the tree's top above its foot. [m]

    Returns
    -------
    mesh : Mesh
        Two closed solids.
    """
    shares = load_facts()["tree"]
    stem_m = shares["stem_share"] * height_m
    radius_m = min(shares["trunk_radius_share"] * height_m, crown_radius_m)
    half_m = 0.5 * (height_m - stem_m)
    trunk = build_cylinder(foot_m, radius_m=radius_m, height_m=stem_m + half_m)
    ball, triangles = unit_ball()
    crown = (
        ball * [crown_radius_m, crown_radius_m, half_m]
        + foot_m
        + [0.0, 0.0, stem_m + half_m]
    )
    return join([trunk, (crown, triangles)])


# ---------- bodies of objects
def build_body(
    road: Road,
    kind: str,
    spot: Spot,
    outlines: Sequence[Outline],
    *,
    turn_rad: float,
    where: str,
) -> tuple[Mesh, bool] | None:
    """Body of an object at a place, and whether its height is assumed.

    Parameters
    ----------
    road : Road
        The road.
    kind : str
        See :func:`~.objects.object_kind`.
    spot : Spot
        Place of the object.
    outlines : sequence of Outline
        Outlines of the object at this place; empty: its sizes count.
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]
    where : str
        File and element at hand, for messages.

    Returns
    -------
    body : (Mesh, bool) or None
        None: the object has no extent.
    """
    height_m = spot.height_m
    has_corner_heights = any(outline.height_m.any() for outline in outlines)
    says_height = height_m is not None or has_corner_heights
    if kind == "obstacle" and not says_height:
        return None
    if height_m is None:
        thing = kind.replace(" ", "_")
        if kind == "obstacle":
            thing = "wall"
        height_m = assumed(f"{thing}_height_m")
    solid: Mesh | None
    if spot.end is not None:
        solid = _sweep(road, spot, spot.end, height_m)
    elif outlines:
        solid = _from_outlines(outlines, height_m, where)
    else:
        solid = _simple(road, kind, spot, height_m, turn_rad)
    if solid is None:
        return None
    return (solid, not says_height)


def _from_outlines(outlines: Sequence[Outline], height_m: float, where: str) -> Mesh:
    """Solids over all outlines of an object; open ones become walls.

    Parameters
    ----------
    outlines : sequence of Outline
        Outlines of the object at this place; empty: its sizes count.
    height_m : float
        Height where the corners have none. [m]
    where : str
        File and element at hand, for messages.

    Returns
    -------
    mesh : Mesh
        One mesh of all of them.
    """
    solids = []
    for outline in outlines:
        points = outline.points_m
        bottom_m = outline.bottom_m
        heights = outline.height_m
        if not heights.any():
            heights = np.full(len(points), height_m)
        top_m = bottom_m + heights
        if not outline.is_closed and len(points) > 1:
            left = _left_of(points)
            width_m = np.full(len(points), assumed("thickness_m"))
            solid = build_band(
                points,
                left,
                width_m=width_m,
                bottom_m=bottom_m,
                top_m=top_m,
            )
        else:
            solid = build_prism(
                points,
                bottom_m=bottom_m,
                top_m=top_m,
                where=where,
            )
        solids.append(solid)
    return join(solids)


def _left_of(line_m: FloatArray) -> FloatArray:
    """Unit vectors to the left of a line, (n, 2); at corners the bisector."""
    steps = np.diff(line_m, axis=0)
    steps = steps / np.maximum(np.hypot(*steps.T), 1.0e-9)[:, None]
    before = np.concatenate([steps[:1], steps])
    after = np.concatenate([steps, steps[-1:]])
    along = before + after
    turns_back = np.hypot(*along.T) < 1.0e-6
    along[turns_back] = before[turns_back]
    along /= np.maximum(np.hypot(*along.T), 1.0e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _sweep(road: Road, start: Spot, end: Spot, height_m: float) -> Mesh:
    """Body from one place to another along the road, as a wall.

    Parameters
    ----------
    road : Road
        The road.
    start : Spot
        Where it begins.
    end : Spot
        Where it ends.
    height_m : float
        Height where the places have none. [m]

    Returns
    -------
    mesh : Mesh
        It follows the road in steps of 2 m.
    """
    n_points = max(2, int(np.ceil((end.s_m - start.s_m) / _STEP_M)) + 1)
    share = np.linspace(0.0, 1.0, n_points)

    def mix(name: str, fallback: float) -> FloatArray:
        """Values from start to end, (n,); `fallback` where the start has none."""
        one = getattr(start, name)
        other = getattr(end, name)
        if one is None:
            one = fallback
        if other is None:
            other = one
        mixed: FloatArray = one + share * (other - one)
        return mixed

    points, heading = road.place(mix("s_m", 0.0), mix("t_m", 0.0))
    diameter_m = 2.0 * (start.radius_m or 0.0)
    bottom_m = points[:, 2] + mix("z_m", 0.0)
    return build_band(
        points[:, :2],
        np.stack([-np.sin(heading), np.cos(heading)], axis=1),
        width_m=mix("width_m", diameter_m or assumed("thickness_m")),
        bottom_m=bottom_m,
        top_m=bottom_m + mix("height_m", height_m),
    )


def _simple(
    road: Road,
    kind: str,
    spot: Spot,
    height_m: float,
    turn_rad: float,
) -> Mesh | None:
    """Tree, cylinder or box at a place, or None if it has no extent.

    Parameters
    ----------
    road : Road
        The road.
    kind : str
        See :func:`~.objects.object_kind`.
    spot : Spot
        Place of the object.
    height_m : float
        Height of the body. [m]
    turn_rad : float
        Turn of the object against the road, counter-clockwise. [rad]

    Returns
    -------
    mesh : Mesh or None
        None: not enough sizes are given.
    """
    foot, heading = place(road, spot)
    foot[2] += spot.z_m
    radius_m = spot.radius_m
    sides = [side for side in (spot.length_m, spot.width_m) if side is not None]
    is_tall = (
        spot.height_m is not None and height_m >= load_facts()["tree"]["min_height_m"]
    )
    is_round = radius_m is not None or (
        len(sides) == 2 and max(sides) < 2.0 * min(sides)
    )
    if kind == "tree" or (kind == "vegetation" and is_tall and is_round):
        if radius_m is None:
            if sides:
                diameter_m = max(sides)
            else:
                diameter_m = assumed("tree_crown_diameter_m")
            radius_m = 0.5 * diameter_m
        return build_tree(foot, crown_radius_m=radius_m, height_m=height_m)
    if radius_m is not None:
        return build_cylinder(foot, radius_m=radius_m, height_m=height_m)
    if not sides or (len(sides) == 1 and kind != "wall"):
        return None
    thickness_m = assumed("thickness_m")
    two = np.ones(2)
    along = np.array([np.cos(heading + turn_rad), np.sin(heading + turn_rad)])
    left = np.array([-along[1], along[0]])
    length_m = spot.length_m or thickness_m
    width_m = spot.width_m or thickness_m
    return build_band(
        foot[:2] + 0.5 * length_m * np.array([[-1.0], [1.0]]) * along,
        np.array([left, left]),
        width_m=width_m * two,
        bottom_m=foot[2] * two,
        top_m=(foot[2] + height_m) * two,
    )
