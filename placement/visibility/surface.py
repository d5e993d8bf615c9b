"""Points spread over a body: what rays are sent to."""

from dataclasses import dataclass

import numpy as np

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.raycast import build_caster

_SAMPLES_PER_POINT = 30
_N_DIRECTIONS = 96
_FAR_M = 50.0
_OFF_SURFACE_M = 2.0e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body.

    Attributes
    ----------
    actor : Actor
        The body.
    points_m : (n, 3) float
        Body frame; the body's extremes are among them. [m]
    """

    actor: Actor
    points_m: FloatArray


def build_surface(actor: Actor, *, n_points: int, seed: int) -> Surface:
    """Spread points evenly over the outside of a body.

    Parameters
    ----------
    actor : Actor
        The body; its parts may overlap, points inside another part are left out.
    n_points : int
        How many.
    seed : int
        Of the random samples that the points are picked from.

    Returns
    -------
    surface : Surface
        The extremes along 26 directions first, so that boxes around the points are boxes around
        the body; then, one by one, the sample farthest from all points so far.

    References
    ----------
    .. [1] Y. Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
    """
    import trimesh

    mesh = trimesh.Trimesh(actor.vertices_m, actor.triangles, process=False)
    samples, _ = trimesh.sample.sample_surface(mesh, _SAMPLES_PER_POINT * n_points, seed=seed)
    samples = samples[_is_outside(actor, samples)]
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    extremes = np.unique(np.argmax(actor.vertices_m @ signs[signs.any(axis=1)].T, axis=0))
    chosen = [actor.vertices_m[index] for index in extremes[:n_points]]
    distance = np.min([np.linalg.norm(samples - point, axis=1) for point in chosen], axis=0)
    while len(chosen) < n_points:
        farthest = samples[np.argmax(distance)]
        chosen.append(farthest)
        distance = np.minimum(distance, np.linalg.norm(samples - farthest, axis=1))
    return Surface(actor=actor, points_m=freeze(np.array(chosen)))


def _is_outside(actor: Actor, points_m: FloatArray) -> BoolArray:
    """Whether a point can be seen from any of many directions, evenly spread over the sphere."""
    caster = build_caster(actor.vertices_m, actor.triangles)
    step = np.arange(_N_DIRECTIONS) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * step / _N_DIRECTIONS), np.pi * (1.0 + 5.0**0.5) * step
    directions = np.stack(
        [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1
    )
    is_seen = np.zeros(len(points_m), dtype=bool)
    for direction in directions:
        origins = points_m + _FAR_M * direction
        vectors = (points_m - origins) * (1.0 - _OFF_SURFACE_M / _FAR_M)
        is_seen |= ~caster.is_blocked(origins.astype(np.float32), vectors.astype(np.float32))
    return is_seen
