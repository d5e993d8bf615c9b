"""What things of a scene cover on the ground."""

from functools import lru_cache
from typing import Any

import numpy as np

from .arrays import FloatArray
from .scene import Scene

_MIN_AREA_M2 = 1.0e-6


def road_area(scene: Scene) -> Any:
    """What a scene's lanes and its junction cover: a shapely geometry, world frame, metres."""
    import shapely

    lanes = [
        shapely.LineString(lane.centreline_m).buffer(0.5 * lane.width_m, cap_style="flat")
        for lane in scene.lanes
        if len(lane.centreline_m) > 1
    ]
    return shapely.union_all([shapely.make_valid(shapely.Polygon(scene.outline_m)), *lanes])


@lru_cache(maxsize=4096)
def thing_footprint(scene: Scene, index: int) -> Any:
    """A thing's triangles seen from above, put together.

    Parameters
    ----------
    scene : Scene
        Where it is.
    index : int
        Of the thing in ``scene.instances``.

    Returns
    -------
    footprint : shapely geometry
        A polygon or several, with holes; empty where it is but a line from above. World frame,
        metres.
    """
    import shapely

    corners: FloatArray = scene.vertices_m[scene.triangles[scene.triangle_instance == index]]
    flat = corners[..., :2]
    one, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    double_area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    return shapely.union_all(shapely.polygons(flat[double_area > _MIN_AREA_M2]))
