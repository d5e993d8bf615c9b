"""Points spread over a body: what rays are sent to."""

from dataclasses import dataclass

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, freeze

_SAMPLES_PER_POINT = 30


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
    """

    actor: Actor
    shape_index: int
    points_m: FloatArray


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
    samples, _ = trimesh.sample.sample_surface(mesh, _SAMPLES_PER_POINT * n_points, seed=seed)
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    extremes = np.unique(np.argmax(shape.vertices_m @ signs[signs.any(axis=1)].T, axis=0))
    chosen = [shape.vertices_m[index] for index in extremes[:n_points]]
    distance = np.min([np.linalg.norm(samples - point, axis=1) for point in chosen], axis=0)
    while len(chosen) < n_points:
        farthest = samples[np.argmax(distance)]
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(samples - farthest, axis=1))
    return Surface(actor=actor, shape_index=shape_index, points_m=freeze(np.array(chosen)))
