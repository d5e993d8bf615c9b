"""Bodies of objects: from outlines, boxes, radii, or swept along the road."""

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from .copies import Copy, Outline, Sweep, place, stations
from .roads import Road
from .solids import (
    Solid,
    build_band,
    build_box,
    build_cylinder,
    build_prism,
    build_tree,
    join,
)
from .tables import assumed, load_facts


def build_body(
    road: Road,
    kind: str,
    one: Copy | Sweep,
    outlines: Sequence[Outline],
    *,
    turn_rad: float,
    where: str,
) -> tuple[Solid, bool] | None:
    """Body of an object at one of its places.

    Parameters
    ----------
    road : Road
        That it belongs to.
    kind : str
        "building", "wall", "vegetation", "tree", "parked vehicle"; "obstacle": a wall if the file
        says how high it is.
    one : Copy or Sweep
        Where.
    outlines : sequence of Outline
        What it has there.
    turn_rad : float
        Against the road. [rad]
    where : str
        For messages.

    Returns
    -------
    body : tuple of Solid and bool, or None
        Vertices and triangles, closed, and whether its height is assumed, as the file does not
        say it. None: it has no extent.

    Raises
    ------
    InputError
        Its outline surrounds nothing, or it has no height.
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
                    outline.points_m,
                    bottom_m=bottom_m,
                    top_m=top_m,
                    holes_m=inside,
                    where=where,
                )
            )
    return join(solids)


def _holes_inside(outline_m: FloatArray, holes: Sequence[FloatArray]) -> list[FloatArray]:
    """Holes that are those of this outline, where an object has several."""
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
    """Unit vectors to the left of a line; at its corners between those of both sides, (n, 2)."""
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
    """A tree, a cylinder or a box; None: it has no extent."""
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
