"""Points on the outside of bodies."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, IntArray, freeze

_SAMPLES_PER_POINT = 30
_TURN_M = 0.3  # a normal turned by a radian counts as much as a way of this length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body at one instant of its gait."""

    actor: Actor
    shape_index: int  # which of its shapes
    points_m: FloatArray  # (n, 3): body frame; the shape's extremes are among them. [m]
    # (n, 3): the part of the surface around each point: its area along its mean outward normal.
    # [m^2]
    area_m2: FloatArray
    hull_index: IntArray  # (n_corners,): points at the corners of the convex hull of all
    radius_m: float  # all points lie this near to their mean. [m]


@cache  # tables of variants ask for the same bodies again
def build_surface(actor: Actor, shape_index: int, *, n_points: int, seed: int) -> Surface:
    """Spread points evenly over the outside of a body's shape, a closed mesh.

    The extremes along 26 directions come first, so that boxes around the points are boxes around
    the shape; then, one by one, the random sample farthest from all points so far.

    References
    ----------
    .. [1] Y. Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
    """
    import trimesh
    from scipy.spatial import cKDTree

    from .spreading import farthest_samples

    shape = actor.shapes[shape_index]
    mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES_PER_POINT * n_points, seed=seed)
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    extremes = np.unique(np.argmax(shape.vertices_m @ signs[signs.any(axis=1)].T, axis=0))
    corners = extremes[:n_points]
    spread = farthest_samples(samples, shape.vertices_m[corners], n_points - len(corners))
    points = np.concatenate([shape.vertices_m[corners], samples[spread]])
    normals = np.concatenate([mesh.vertex_normals[corners], mesh.face_normals[faces[spread]]])
    # A sample belongs to the nearest point that faces the same way: not to one around the corner.
    tree = cKDTree(np.hstack([points, _TURN_M * normals]))
    sample_normals = mesh.face_normals[faces]
    _, nearest = tree.query(np.hstack([samples, _TURN_M * sample_normals]))
    area = np.zeros_like(points)
    np.add.at(area, nearest, sample_normals)
    return Surface(
        actor=actor,
        shape_index=shape_index,
        points_m=freeze(points),
        area_m2=freeze(area * (mesh.area / len(samples))),
        hull_index=freeze(_hull_corners(points)),
        radius_m=float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()),
    )


def _hull_corners(points_m: FloatArray) -> IntArray:
    """Points at the corners of the convex hull; all of them if they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return ConvexHull(points_m).vertices.astype(np.int64)
    except (QhullError, ValueError):  # fewer than four points, or a flat body
        return np.arange(len(points_m))
