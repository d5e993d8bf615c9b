"""Sites along kerbs, and lists of sites made tidy."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import BoolArray, FloatArray, float_array
from ..errors import InputError
from .model import MapLane, Skipped, Thing
from .site_files import SiteWish

if TYPE_CHECKING:
    from shapely import Polygon

SETBACK_M = (
    0.5  # of a pole's middle from the kerb; assumption: the usual clearance of a carriageway
)
REACH_M = 60.0
_AT_OUTLINE_M = 1.5
_JOINED_M = 0.5
_MEDIAN_M = 8.0  # between carriageways: a narrower gap is a median, no roadside
_PARALLEL = np.cos(np.deg2rad(20.0))
_STEP_M = 0.25
_LONGER_M = 1.0  # the outline is not square to every lane
_KINDS = ("driving", "parking")


def kerb_sites(
    lanes: Sequence[MapLane],
    outline_m: ArrayLike,
    spacing_m: float,
    *,
    reach_m: float = REACH_M,
) -> tuple[SiteWish, ...]:
    """Sites along both kerbs of a junction's arms, from its corners outwards.

    A kerb is the outer edge of a lane for driving or parking that no other such lane borders on;
    medians have none.

    Parameters
    ----------
    lanes : sequence of MapLane
        Those that begin or end at the outline are arms, with what they are continued by.
    outline_m : (n, 2) float
        Of the junction's road surface. [m]
    spacing_m : float
        Between sites along a kerb. [m]
    reach_m : float
        How far from the outline. [m]

    Returns
    -------
    sites : tuple of SiteWish
        Of kind "kerb"; their ids are those of the lane, the side and the distance: the first on a
        kerb, at the outline, is a corner of the junction.

    Raises
    ------
    InputError
        The spacing is not positive, or the outline is none.
    """
    import shapely

    if not (np.isfinite(spacing_m) and spacing_m >= 0.5):
        raise InputError("spacing_m", spacing_m, "metres, at least 0.5")
    outline = float_array(outline_m, (-1, 2), "outline_m")
    if len(outline) < 3:
        raise InputError("outline_m", len(outline), "at least three points")
    inside = shapely.make_valid(shapely.Polygon(outline))
    roads = [lane for lane in lanes if lane.kind in _KINDS]
    arms = [(lane, line) for lane in roads for line in _outward(lane, roads, outline, reach_m)]
    strips = shapely.STRtree([_strip(lane, line, beside_m=SETBACK_M - 0.05) for lane, line in arms])
    sites: dict[str, SiteWish] = {}
    for lane, line in arms:
        for side, sign in (("left", 1.0), ("right", -1.0)):
            along_m, points, outwards = _offset(line, sign * (0.5 * lane.width_m + SETBACK_M))
            shapes = shapely.points(points[:, :2])
            free = shapely.distance(shapes, inside) > 0.5 * SETBACK_M
            free &= shapely.distance(shapes, shapely.LinearRing(outline)) <= reach_m
            free[np.unique(strips.query(shapes, predicate="within")[0])] = False
            free[free] = ~_is_median(points[free], outwards[free], arms)
            places = np.flatnonzero(free)
            next_m = -np.inf
            for place in places:
                if along_m[place] < next_m - 1e-9:
                    continue
                next_m = along_m[place] + spacing_m
                name = f"kerb {lane.id} {side} {along_m[place]:.0f} m"
                sites.setdefault(
                    name,
                    SiteWish(
                        id=name,
                        kind="kerb",
                        position_m=np.round(points[place, :2], 3),
                        z_m=round(float(points[place, 2]), 3),
                    ),
                )
    return tuple(sites.values())


def _outward(
    lane: MapLane, lanes: Sequence[MapLane], outline: FloatArray, reach_m: float
) -> list[FloatArray]:
    """Centrelines from the outline outwards, (n, 3): of a lane that touches it, continued."""
    import shapely

    ring = shapely.LinearRing(outline)
    lines = []
    for line in (lane.centreline_m, lane.centreline_m[::-1]):
        start_m, end_m = shapely.distance(shapely.points(line[[0, -1], :2]), ring)
        is_stub = _length_m(line) < 2.0 * _AT_OUTLINE_M  # its far end is at the outline, too
        if start_m > _AT_OUTLINE_M or (is_stub and end_m < start_m):
            continue
        joined, used = [line], {lane.id}
        while _length_m(np.concatenate(joined)) < reach_m + 10.0:
            end = joined[-1][-1, :2]
            after = next(
                (
                    (other, points)
                    for other in lanes
                    if other.id not in used and other.kind == lane.kind
                    for points in (other.centreline_m, other.centreline_m[::-1])
                    if np.hypot(*(points[0, :2] - end)) <= _JOINED_M
                ),
                None,
            )
            if after is None:
                break
            used.add(after[0].id)
            joined.append(after[1][1:] if len(after[1]) > 2 else after[1])
        whole = np.concatenate(joined)
        is_new = np.r_[True, np.hypot(*np.diff(whole[:, :2], axis=0).T) > 1e-6]
        if is_new.sum() >= 2:
            lines.append(whole[is_new])
    return lines


def _strip(lane: MapLane, line: FloatArray, *, beside_m: float) -> "Polygon":
    """A lane's surface, with a strip on either side, and a metre longer at both ends."""
    import shapely

    ends = line[[0, -1], :2]
    ways = ends - line[[1, -2], :2]
    ends = ends + _LONGER_M * ways / np.hypot(*ways.T)[:, None]
    longer = shapely.LineString(np.concatenate([ends[:1], line[:, :2], ends[1:]]))
    strip: Polygon = longer.buffer(0.5 * lane.width_m + beside_m, cap_style="flat")
    return strip


def _length_m(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


def _offset(line: FloatArray, offset_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points beside a line every quarter of a metre: distance along it, place, way outwards."""
    pieces = np.hypot(*np.diff(line[:, :2], axis=0).T)
    at = np.r_[0.0, np.cumsum(pieces)]
    along_m: FloatArray = np.arange(0.0, min(at[-1], 500.0), _STEP_M)
    points = np.stack([np.interp(along_m, at, line[:, axis]) for axis in range(3)], axis=1)
    piece = np.clip(np.searchsorted(at, along_m, side="right") - 1, 0, len(pieces) - 1)
    ahead = np.diff(line[:, :2], axis=0)[piece] / pieces[piece, None]
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    points[:, :2] += offset_m * left
    return along_m, points, np.sign(offset_m) * left


def _is_median(
    points: FloatArray, outwards: FloatArray, arms: Sequence[tuple[MapLane, FloatArray]]
) -> BoolArray:
    """Points from which another lane runs alongside, a few metres further outwards."""
    import shapely

    is_median: BoolArray = np.zeros(len(points), dtype=np.bool_)
    if not len(points):
        return is_median
    starts = points[:, :2]
    rays = shapely.linestrings(np.stack([starts, starts + _MEDIAN_M * outwards], axis=1))
    for lane, line in arms:
        strip = _strip(lane, line, beside_m=0.0)
        for index in np.flatnonzero(shapely.intersects(rays, strip) & ~is_median):
            nearest = int(np.argmin(np.hypot(*(line[:-1, :2] - starts[index]).T)))
            ahead = line[nearest + 1, :2] - line[nearest, :2]
            across = abs(float(ahead @ outwards[index])) / float(np.hypot(*ahead))
            is_median[index] = across < np.sqrt(1.0 - _PARALLEL**2)
    return is_median


def tidy_sites(
    sites: Sequence[SiteWish], *, things: Sequence[Thing] = (), snap_m: float = 1.0
) -> tuple[tuple[SiteWish, ...], tuple[Skipped, ...]]:
    """Sites without those that are there twice, or stand in a building.

    Parameters
    ----------
    sites : sequence of SiteWish
        Those said more of win over others at the same place, then the earlier ones.
    things : sequence of Thing
        In the same coordinates; a site in the footprint of a building is dropped.
    snap_m : float
        Sites closer than this are one. [m]

    Returns
    -------
    kept : tuple of SiteWish
        In their order.
    skipped : tuple of Skipped
        Every other one, with the reason.
    """
    from scipy.spatial import KDTree

    if not (np.isfinite(snap_m) and snap_m >= 0.0):
        raise InputError("snap_m", snap_m, "metres, at least 0")
    reasons: dict[int, str] = {}
    positions = np.array([site.position_m for site in sites]).reshape(-1, 2)
    for thing in things:
        if thing.class_name == "building" and len(thing.triangles) and len(positions):
            for hit in np.flatnonzero(_is_under(positions, thing)):
                reasons.setdefault(int(hit), f"inside {thing.class_name} {thing.id}")
    left = [index for index in range(len(sites)) if index not in reasons]
    order = sorted(left, key=lambda index: (-sites[index].n_said, index))
    if left and snap_m > 0.0:
        tree = KDTree(positions)
        kept: set[int] = set()
        for index in order:
            near = [
                int(other)
                for other in tree.query_ball_point(positions[index], snap_m)
                if int(other) in kept
            ]
            if near:
                distance_m = np.hypot(*(positions[near] - positions[index]).T)
                nearest = near[int(np.argmin(distance_m))]
                reasons[index] = f"{distance_m.min():.1f} m beside {sites[nearest].id}"
            else:
                kept.add(index)
    return (
        tuple(site for index, site in enumerate(sites) if index not in reasons),
        tuple(
            Skipped(what=f"site {sites[index].id}", why=reasons[index]) for index in sorted(reasons)
        ),
    )


def _is_under(positions_m: FloatArray, thing: Thing) -> BoolArray:
    """Which points lie in the footprint of a thing: under or over one of its triangles."""
    corners = thing.vertices_m[thing.triangles][:, :, :2]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    is_under: BoolArray = np.zeros(len(positions_m), dtype=np.bool_)
    for index in np.flatnonzero(((positions_m > low) & (positions_m < high)).all(axis=1)):
        a, b, c = np.swapaxes(corners - positions_m[index], 0, 1)
        turns = np.stack([_turn(a, b), _turn(b, c), _turn(c, a)])
        is_under[index] = ((turns > 0.0).all(axis=0) | (turns < 0.0).all(axis=0)).any()
        if not is_under[index]:  # on the edge between two triangles
            area = turns.sum(axis=0)
            inside = ((turns >= 0.0).all(axis=0) & (area > 0.0)) | (
                (turns <= 0.0).all(axis=0) & (area < 0.0)
            )
            is_under[index] = inside.sum() > 2  # roof and floor, on both sides of the edge
    return is_under


def _turn(a: FloatArray, b: FloatArray) -> FloatArray:
    """Twice the signed area between two vectors, (n,)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
