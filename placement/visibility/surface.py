"""Points spread over a body: what rays are sent to."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from geometry.actors import Actor
from geometry.arrays import FloatArray, freeze

_SAMPLES_PER_POINT = 30
_TURN_M = 0.3  # a normal turned by a radian counts as much as a way of this length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body at one instant of its gait.

    Attributes
    ----------
    actor : Actor
        The body.
    shape_index : int
        Which of its shapes.
    points_m : (n, 3) float
        Body frame; the shape's extremes are among them. [m]
    area_m2 : (n, 3) float
        The part of the surface around each point: its area along its mean outward normal. [m^2]
    """

    actor: Actor
    shape_index: int
    points_m: FloatArray
    area_m2: FloatArray


@cache  # tables of variants ask for the same bodies again
def build_surface(actor: Actor, shape_index: int, *, n_points: int, seed: int) -> Surface:
    """Spread points evenly over the outside of a body.

    Parameters
    ----------
    actor : Actor
        The body.
    shape_index : int
        Which of its shapes: a closed mesh.
    n_points : int
        How many.
    seed : int
        Of the random samples that the points are picked from.

    Returns
    -------
    surface : Surface
        The extremes along 26 directions first, so that boxes around the points are boxes around
        the shape; then, one by one, the sample farthest from all points so far.

    References
    ----------
    .. [1] Y. Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
    """
    import trimesh

    shape = actor.shapes[shape_index]
    mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES_PER_POINT * n_points, seed=seed)
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    extremes = np.unique(np.argmax(shape.vertices_m @ signs[signs.any(axis=1)].T, axis=0))
    chosen = [shape.vertices_m[index] for index in extremes[:n_points]]
    normals = [mesh.vertex_normals[index] for index in extremes[:n_points]]
    distance = np.min([np.linalg.norm(samples - point, axis=1) for point in chosen], axis=0)
    while len(chosen) < n_points:
        farthest = int(np.argmax(distance))
        chosen.append(samples[farthest])
        normals.append(mesh.face_normals[faces[farthest]])
        distance = np.minimum(distance, np.linalg.norm(samples - samples[farthest], axis=1))
    points = np.array(chosen)
    # A sample belongs to the nearest point that faces the same way: not to one around the corner.
    tree = cKDTree(np.hstack([points, _TURN_M * np.array(normals)]))
    sample_normals = mesh.face_normals[faces]
    _, nearest = tree.query(np.hstack([samples, _TURN_M * sample_normals]))
    area = np.zeros_like(points)
    np.add.at(area, nearest, sample_normals)
    return Surface(
        actor=actor,
        shape_index=shape_index,
        points_m=freeze(points),
        area_m2=freeze(area * (mesh.area / len(samples))),
    )
