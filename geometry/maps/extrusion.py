"""Solids from footprints: walls, floor and a flat roof."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, float_array
from ..errors import InputError, Unquoted


def extrude(
    outer_m: ArrayLike,
    *,
    bottom_m: float,
    top_m: float,
    holes_m: Sequence[ArrayLike] = (),
    where: str = "footprint",
) -> tuple[FloatArray, NDArray[np.int32]]:
    """A closed solid over a footprint.

    Parameters
    ----------
    outer_m : (n, 2) float
        Outline, open or closed, in either direction. [m]
    bottom_m, top_m : float
        Heights of floor and roof. [m]
    holes_m : sequence of (k, 2) float
        Courtyards. [m]
    where : str
        For messages.

    Returns
    -------
    vertices_m : (n_vertices, 3) float
        [m]
    triangles : (n_triangles, 3) int32
        Counter-clockwise seen from outside.

    Raises
    ------
    InputError
        The outline crosses itself in a way that leaves nothing, has no area, or the roof is not
        above the floor. What crosses itself otherwise is mended first.
    """
    import trimesh
    from shapely import MultiPolygon, Polygon, make_valid

    if not top_m > bottom_m:
        raise InputError(f"{where}: height", top_m - bottom_m, "metres, > 0")
    outer = float_array(outer_m, (-1, 2), where)
    if len(np.unique(outer, axis=0)) < 3:
        raise InputError(where, Unquoted(f"{len(outer)} points"), "three different ones or more")
    shape = make_valid(Polygon(outer, [float_array(hole, (-1, 2), where) for hole in holes_m]))
    parts = [
        part
        for geometry in getattr(shape, "geoms", [shape])
        for part in (geometry.geoms if isinstance(geometry, MultiPolygon) else [geometry])
        if isinstance(part, Polygon) and part.area > _MIN_AREA_M2
    ]
    if not parts:
        raise InputError(where, Unquoted("an outline without area"), "a footprint")
    solids = [
        trimesh.creation.extrude_polygon(part, top_m - bottom_m, engine="earcut") for part in parts
    ]
    first = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    vertices: FloatArray = np.concatenate([solid.vertices for solid in solids])
    triangles = np.concatenate(
        [solid.faces + offset for solid, offset in zip(solids, first[:-1], strict=True)]
    )
    return vertices + [0.0, 0.0, bottom_m], triangles.astype(np.int32)


_MIN_AREA_M2 = 0.01
