"""Solids of objects: prisms over outlines, boxes, cylinders, walls swept along the road, trees."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ...errors import InputError
from ..solids import extrude
from .attributes import assumed, load_facts
from .object_places import Copy, Outline, Sweep, place, stations
from .roads import Road

# ---------- solids of things: prisms over outlines, walls along a line, trees, posts of hedges


Solid = tuple[FloatArray, NDArray[np.int32]]
_FLAT_M = 0.05  # slopes that nobody sees round
_STRAIGHT_M = 0.02
_N_ROUND = 12  # corners of what is round


def build_prism(
    outline_m: FloatArray,
    *,
    bottom_m: FloatArray,
    top_m: FloatArray,
    holes_m: Sequence[FloatArray] = (),
    where: str,
) -> Solid:
    """A closed solid over an open outline (n, 2) with floor and roof heights (n,) at its corners.

    With holes, or if the outline crosses itself, floor and roof are level at the lowest and highest
    corner. Raises InputError if the outline has no area, or the solid no height.
    """
    import shapely

    is_flat = max(np.ptp(bottom_m), np.ptp(top_m)) < _FLAT_M or len(outline_m) < 3
    if is_flat or len(holes_m) or not shapely.Polygon(outline_m).is_valid:
        return extrude(
            outline_m,
            bottom_m=float(bottom_m.min()),
            top_m=float(top_m.max()),
            holes_m=holes_m,
            where=where,
        )
    import mapbox_earcut

    if not (top_m > bottom_m).any():
        raise InputError(f"{where}: height", float((top_m - bottom_m).max()), "metres, > 0")
    if shapely.LinearRing(outline_m).is_ccw:
        corners, bottom, top = outline_m, bottom_m, np.maximum(top_m, bottom_m)
    else:
        corners, bottom, top = (outline_m[::-1], bottom_m[::-1], np.maximum(top_m, bottom_m)[::-1])
    n = len(corners)
    roof = np.asarray(
        mapbox_earcut.triangulate_float64(corners, np.array([n], dtype=np.uint32)), dtype=np.int64
    ).reshape(-1, 3)
    a, b, c = np.moveaxis(corners[roof], 1, 0)
    turns_right = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    roof[turns_right] = roof[turns_right][:, ::-1]
    here = np.arange(n)
    following = (here + 1) % n
    sides = np.concatenate(
        [
            np.stack([here, following, following + n], axis=1),
            np.stack([here, following + n, here + n], axis=1),
        ]
    )
    vertices = np.concatenate([np.column_stack([corners, bottom]), np.column_stack([corners, top])])
    return vertices, np.concatenate([roof[:, ::-1], roof + n, sides]).astype(np.int32)


def build_band(
    line_m: FloatArray,
    left: FloatArray,
    *,
    width_m: FloatArray,
    bottom_m: FloatArray,
    top_m: FloatArray,
) -> Solid:
    """A wall along a line (n, 2), with unit vectors to its left (n, 2); other arrays are (n,)."""
    table = np.column_stack([line_m, left, width_m, bottom_m, top_m])
    share = np.linspace(0.0, 1.0, len(table))[:, None]
    if np.abs(table - (table[0] + share * (table[-1] - table[0]))).max() < _STRAIGHT_M:
        table = table[[0, -1]]
    line, normal = table[:, :2], table[:, 2:4]
    half, bottom, top = 0.5 * table[:, 4:5], table[:, 5], table[:, 6]
    ring = np.stack(
        [
            np.column_stack([line - half * normal, bottom]),
            np.column_stack([line + half * normal, bottom]),
            np.column_stack([line + half * normal, top]),
            np.column_stack([line - half * normal, top]),
        ],
        axis=1,
    )  # (n, 4, 3): right, left, left above, right above; seen from its end they run clockwise
    n = len(line)
    first = 4 * np.arange(n - 1)[:, None]
    corner = np.arange(4)
    following = (corner + 1) % 4
    sides = np.concatenate(
        [
            np.stack([first + corner, first + following, first + following + 4], axis=-1).reshape(
                -1, 3
            ),
            np.stack([first + corner, first + following + 4, first + corner + 4], axis=-1).reshape(
                -1, 3
            ),
        ]
    )
    end = 4 * (n - 1)
    caps = np.array([[0, 2, 1], [0, 3, 2], [end, end + 1, end + 2], [end, end + 2, end + 3]])
    triangles = np.concatenate([sides, caps])
    return ring.reshape(-1, 3), triangles.astype(np.int32)


def build_box(
    middle_m: FloatArray, heading_rad: float, *, length_m: float, width_m: float, height_m: float
) -> Solid:
    """A box above the middle of its base (3,), its length along the heading."""
    along = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    left = np.array([-along[1], along[0]])
    ends = middle_m[:2] + 0.5 * length_m * np.array([[-1.0], [1.0]]) * along
    two = np.ones(2)
    return build_band(
        ends,
        np.array([left, left]),
        width_m=width_m * two,
        bottom_m=middle_m[2] * two,
        top_m=(middle_m[2] + height_m) * two,
    )


def build_cylinder(foot_m: FloatArray, *, radius_m: float, height_m: float) -> Solid:
    """An upright cylinder above the middle of its base (3,)."""
    vertices, triangles = _unit_cylinder()
    return vertices * [radius_m, radius_m, height_m] + foot_m, triangles


def build_tree(foot_m: FloatArray, *, crown_radius_m: float, height_m: float) -> Solid:
    """A trunk and an ellipsoid of leaves above a foot (3,)."""
    shares = load_facts()["tree"]
    stem_m = shares["stem_share"] * height_m
    radius_m = min(shares["trunk_radius_share"] * height_m, crown_radius_m)
    half_m = 0.5 * (height_m - stem_m)
    trunk, trunk_triangles = build_cylinder(foot_m, radius_m=radius_m, height_m=stem_m + half_m)
    crown, crown_triangles = _unit_ball()
    crown = crown * [crown_radius_m, crown_radius_m, half_m] + foot_m + [0.0, 0.0, stem_m + half_m]
    return join([(trunk, trunk_triangles), (crown, crown_triangles)])


def join(solids: Sequence[Solid]) -> Solid:
    """Several solids as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in solids)])
    return (
        np.concatenate([vertices for vertices, _ in solids]),
        np.concatenate(
            [triangles + start for (_, triangles), start in zip(solids, first[:-1], strict=True)]
        ).astype(np.int32),
    )


@cache
def _unit_cylinder() -> Solid:
    angle = 2.0 * np.pi * np.arange(_N_ROUND) / _N_ROUND
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return extrude(ring, bottom_m=0.0, top_m=1.0)


@cache
def _unit_ball() -> Solid:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices), np.asarray(ball.faces, dtype=np.int32)


# ---------- bodies of objects: from outlines, boxes, radii, or swept along the road


def build_body(
    road: Road,
    kind: str,
    one: Copy | Sweep,
    outlines: Sequence[Outline],
    *,
    turn_rad: float,
    where: str,
) -> tuple[Solid, bool] | None:
    """Body of an object at one of its places, and whether its height is assumed; None: no extent.

    `kind` is "building", "wall", "vegetation", "tree", "parked vehicle" or "obstacle", which is a
    wall if the file gives its height. `turn_rad` is the heading against the road. Raises InputError
    if an outline surrounds nothing, or there is no height.
    """
    copy = one.start if isinstance(one, Sweep) else one
    height_m = copy.height_m
    has_outline = any(outline.is_outer for outline in outlines)
    says_height = height_m is not None or (
        has_outline and any(outline.height_m.any() for outline in outlines)
    )
    if kind == "obstacle" and not says_height:
        return None
    if height_m is None:
        thing = "wall" if kind == "obstacle" else kind.replace(" ", "_")
        height_m = assumed(f"{thing}_height_m")
    solid: Solid | None
    if isinstance(one, Sweep):
        solid = _sweep(road, one, height_m)
    elif has_outline:
        solid = _from_outlines(outlines, height_m, where)
    else:
        solid = _simple(road, kind, copy, height_m, turn_rad)
    return None if solid is None else (solid, not says_height)


def _from_outlines(outlines: Sequence[Outline], height_m: float, where: str) -> Solid:
    holes = [outline.points_m for outline in outlines if not outline.is_outer]
    solids = []
    for outline in outlines:
        if not outline.is_outer:
            continue
        n_corners = len(outline.points_m)
        heights = outline.height_m if outline.height_m.any() else np.full(n_corners, height_m)
        bottom_m, top_m = outline.bottom_m, outline.bottom_m + heights
        if not outline.is_closed and n_corners > 1:
            solids.append(
                build_band(
                    outline.points_m,
                    _left_of(outline.points_m),
                    width_m=np.full(n_corners, assumed("thickness_m")),
                    bottom_m=bottom_m,
                    top_m=top_m,
                )
            )
        else:
            inside = _holes_inside(outline.points_m, holes)
            solids.append(
                build_prism(
                    outline.points_m, bottom_m=bottom_m, top_m=top_m, holes_m=inside, where=where
                )
            )
    return join(solids)


def _holes_inside(outline_m: FloatArray, holes: Sequence[FloatArray]) -> list[FloatArray]:
    """The holes of this outline, if an object has several outlines."""
    import shapely

    if not holes or len(outline_m) < 3:
        return []
    shape = shapely.Polygon(outline_m).buffer(0.0)
    return [
        hole
        for hole in holes
        if len(hole) > 2 and shape.intersects(shapely.Polygon(hole).representative_point())
    ]


def _left_of(line_m: FloatArray) -> FloatArray:
    """Unit vectors (n, 2) to the left of a line; at its corners halfway between both sides."""
    steps = np.diff(line_m, axis=0)
    steps = steps / np.maximum(np.hypot(*steps.T), 1.0e-9)[:, None]
    before, after = np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]])
    along = before + after
    turns_back = np.hypot(*along.T) < 1.0e-6
    along[turns_back] = before[turns_back]
    along /= np.maximum(np.hypot(*along.T), 1.0e-9)[:, None]
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _sweep(road: Road, sweep: Sweep, height_m: float) -> Solid:
    s_m, t_m, share = stations(sweep)
    points, heading = road.place(s_m, t_m)

    def mix(name: str, fallback: float) -> FloatArray:
        one, other = getattr(sweep.start, name), getattr(sweep.end, name)
        one = fallback if one is None else one
        other = one if other is None else other
        mixed: FloatArray = one + share * (other - one)
        return mixed

    diameter_m = 2.0 * (sweep.start.radius_m or 0.0)
    bottom_m = points[:, 2] + mix("z_m", 0.0)
    return build_band(
        points[:, :2],
        np.stack([-np.sin(heading), np.cos(heading)], axis=1),
        width_m=mix("width_m", diameter_m or assumed("thickness_m")),
        bottom_m=bottom_m,
        top_m=bottom_m + mix("height_m", height_m),
    )


def _simple(road: Road, kind: str, copy: Copy, height_m: float, turn_rad: float) -> Solid | None:
    """A tree, a cylinder or a box, or None if it has no extent."""
    foot, heading = place(road, copy)
    foot[2] += copy.z_m
    radius_m = copy.radius_m
    sides = [side for side in (copy.length_m, copy.width_m) if side is not None]
    is_tall = copy.height_m is not None and height_m >= load_facts()["tree"]["min_height_m"]
    is_round = radius_m is not None or (len(sides) == 2 and max(sides) < 2.0 * min(sides))
    if kind == "tree" or (kind == "vegetation" and is_tall and is_round):
        if radius_m is None:
            radius_m = 0.5 * (max(sides) if sides else assumed("tree_crown_diameter_m"))
        return build_tree(foot, crown_radius_m=radius_m, height_m=height_m)
    if radius_m is not None:
        return build_cylinder(foot, radius_m=radius_m, height_m=height_m)
    if not sides or (len(sides) == 1 and kind != "wall"):
        return None
    thickness_m = assumed("thickness_m")
    return build_box(
        foot,
        heading + turn_rad,
        length_m=copy.length_m or thickness_m,
        width_m=copy.width_m or thickness_m,
        height_m=height_m,
    )
