"""Triangle meshes from polygons in space, and solids raised from footprints."""

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, float_array
from ..errors import InputError, Unquoted

if TYPE_CHECKING:
    from shapely import Polygon
    from shapely.geometry.base import BaseGeometry

Polygon3D = Sequence[FloatArray]  # outer ring, then holes; (n, 3) each
Mesh = tuple[FloatArray, NDArray[np.int32]]  # vertices (n, 3) and triangles (m, 3)

_SAME_M = 1e-3  # corners closer than this are one
_MIN_AREA_M2 = 1e-6  # of a polygon in space
_MIN_FOOTPRINT_M2 = 0.01
_NOTHING = (np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))


def triangulate(rings_m: Polygon3D) -> Mesh:
    """Triangles of a flat polygon in space: an outer ring and holes, (n, 3) each, open or closed.

    The polygon is projected onto the plane across Newell's normal, cut by ear clipping there, and
    keeps its own corners, so that a polygon that is not quite flat still meets its neighbours. The
    outer ring runs counter-clockwise seen from the polygon's front; holes run in either direction.
    Returns vertices and triangles that face as the polygon does, none if it has no area.

    References
    ----------
    .. [1] I. E. Sutherland, R. F. Sproull, R. A. Schumacker, "A characterization of ten
       hidden-surface algorithms", 1974: Newell's normal, the sum of the cross products of
       neighbouring corners.
    """
    import mapbox_earcut

    rings = [ring for ring in (_without_repeats(ring) for ring in rings_m) if len(ring) >= 3]
    if not rings or len(_without_repeats(rings_m[0])) < 3:
        return _NOTHING
    vertices: FloatArray = np.concatenate(rings)
    middle = vertices.mean(axis=0)
    outer = rings[0] - middle
    products = outer.T @ outer[[*range(1, len(outer)), 0]]
    normal = np.array([products[at] - products[at[::-1]] for at in ((1, 2), (2, 0), (0, 1))])
    length = float(np.sqrt(normal @ normal))
    if not length > 2.0 * _MIN_AREA_M2:
        return _NOTHING
    normal /= length
    if len(vertices) == 3:
        return vertices, np.array([[0, 1, 2]], dtype=np.int32)
    across = np.zeros(3)  # to the normal: the axis least like it, less what lies along the normal
    across[np.argmin(np.abs(normal))] = 1.0
    across -= (across @ normal) * normal
    across /= np.sqrt(across @ across)
    (a_x, a_y, a_z), (n_x, n_y, n_z) = across, normal
    onwards = (n_y * a_z - n_z * a_y, n_z * a_x - n_x * a_z, n_x * a_y - n_y * a_x)
    flat = (vertices - middle) @ np.array([across, onwards]).T
    ends = np.cumsum([len(ring) for ring in rings]).astype(np.uint32)
    triangles = mapbox_earcut.triangulate_float64(flat, ends).reshape(-1, 3).astype(np.int32)
    a, b, c = flat[triangles[:, 0]], flat[triangles[:, 1]], flat[triangles[:, 2]]
    ab, ac = b - a, c - a
    signed = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    triangles[signed < 0.0] = triangles[signed < 0.0, ::-1]
    return vertices, triangles


def surface_mesh(polygons: Sequence[Polygon3D]) -> Mesh:
    """One mesh of many polygons with shared corners; a closed mesh faces outwards.

    Vertices closer than about a millimetre along every axis are merged. The mesh is empty if no
    polygon has an area.
    """
    pieces = [triangulate(rings) for rings in polygons]
    pieces = [piece for piece in pieces if len(piece[1])]
    if not pieces:
        return _NOTHING
    corners, triangles = join(pieces)
    _, taken, merged = np.unique(
        np.round(corners / _SAME_M).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    vertices, triangles = corners[taken], merged.reshape(-1)[triangles].astype(np.int32)
    has_area = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    triangles = triangles[has_area]
    if is_closed(triangles) and volume_m3(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return vertices, np.ascontiguousarray(triangles)


def is_closed(triangles: NDArray[np.int32]) -> bool:
    """Every edge is used as often in one direction as in the other."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    n_vertices = int(triangles.max()) + 1 if len(triangles) else 0
    forth = np.sort(edges[:, 0].astype(np.int64) * n_vertices + edges[:, 1])
    back = np.sort(edges[:, 1].astype(np.int64) * n_vertices + edges[:, 0])
    return bool(len(triangles)) and bool((forth == back).all())


def volume_m3(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> float:
    """Volume inside a closed mesh; negative if it faces inwards."""
    if not len(triangles):
        return 0.0
    a, b, c = np.swapaxes(vertices_m[triangles] - vertices_m[triangles[0, 0]], 0, 1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _without_repeats(ring: FloatArray) -> FloatArray:
    points = np.asarray(ring, dtype=np.float64).reshape(-1, 3)
    if not len(points):
        return points
    kept: FloatArray = points[(points != points[[-1, *range(len(points) - 1)]]).any(axis=1)]
    return kept


def extrude(
    outer_m: ArrayLike,
    *,
    bottom_m: float,
    top_m: float,
    holes_m: Sequence[ArrayLike] = (),
    where: str = "footprint",
) -> Mesh:
    """A closed solid over a footprint: an outline (n, 2) and holes.

    Rings are open or closed, in either direction. Returns vertices (k, 3) and triangles that run
    counter-clockwise seen from outside. Outlines that cross themselves are mended first. Raises
    InputError, with `where` in its message, if no area is left or the roof is not above the floor.
    """
    import trimesh
    from shapely import Polygon, make_valid

    if not top_m > bottom_m:
        raise InputError(f"{where}: height", top_m - bottom_m, "metres, > 0")
    outer = float_array(outer_m, (-1, 2), where)
    if len(np.unique(outer, axis=0)) < 3:
        raise InputError(where, Unquoted(f"{len(outer)} points"), "at least three different points")
    shape = make_valid(Polygon(outer, [float_array(hole, (-1, 2), where) for hole in holes_m]))
    parts = polygons_of(shape, above_m2=_MIN_FOOTPRINT_M2)
    if not parts:
        raise InputError(where, Unquoted("an outline without area"), "a footprint")
    solids = [
        trimesh.creation.extrude_polygon(part, top_m - bottom_m, engine="earcut") for part in parts
    ]
    vertices, triangles = join([(solid.vertices, solid.faces) for solid in solids])
    return vertices + [0.0, 0.0, bottom_m], triangles


def extrude_polygon(
    polygon: "Polygon", *, bottom_m: float, top_m: float, where: str = "footprint"
) -> Mesh:
    """Closed solid over a shapely polygon with its holes; raises as :func:`extrude`."""
    holes = [np.asarray(ring.coords)[:, :2] for ring in polygon.interiors]
    outer = np.asarray(polygon.exterior.coords)[:, :2]
    return extrude(outer, bottom_m=bottom_m, top_m=top_m, holes_m=holes, where=where)


def polygons_of(shape: "BaseGeometry", *, above_m2: float = 0.0) -> list["Polygon"]:
    """Polygons of a geometry, or of a collection of such, that have more than an area."""
    pieces = getattr(shape, "geoms", None)
    if pieces is not None:
        return [part for piece in pieces for part in polygons_of(piece, above_m2=above_m2)]
    return [shape] if shape.geom_type == "Polygon" and shape.area > above_m2 else []


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    triangles = [faces + start for (_, faces), start in zip(meshes, first[:-1], strict=True)]
    vertices: FloatArray = np.concatenate([vertices for vertices, _ in meshes])
    return vertices, np.concatenate(triangles).astype(np.int32)


@cache
def unit_ball() -> Mesh:
    """A ball of radius 1 from 80 triangles, for the crowns of trees."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices, dtype=np.float64), np.asarray(ball.faces, dtype=np.int32)
