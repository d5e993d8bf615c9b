"""What stands still in some runs only: parked bodies and walls, told apart by their content."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.poses import to_world
from geometry.scene import Scene
from scenarios.runs import Run


def obstruction_key(run: Run) -> tuple[object, ...]:
    """Equal for runs with the same bodies at the same places."""
    return tuple(parked.key for parked in run.obstruction)


def find_obstructions(
    runs: Sequence[Run],
) -> dict[tuple[object, ...], tuple[PlacedActor, ...]]:
    """Distinct obstructions in the order of `World.static`, by their content."""
    return {obstruction_key(run): run.obstruction for run in runs}


def build_static_mesh(
    scene: Scene, obstruction: tuple[PlacedActor, ...], origin_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices and triangles of a scene with an obstruction, relative to an origin.

    Parameters
    ----------
    scene : Scene
        What stands still in all runs.
    obstruction : tuple of PlacedActor
        What stands still in some.
    origin_m : (3,) float
        Of `World`. [m]

    Returns
    -------
    vertices_m : (n, 3) float
        Relative to the origin. [m]
    triangles : (m, 3) int32
        Vertex indices.
    """
    vertices, triangles = [scene.vertices_m], [scene.triangles]
    for parked in obstruction:
        shape = parked.actor.shapes[0]
        triangles.append((shape.triangles + sum(map(len, vertices))).astype(np.int32))
        vertices.append(to_world(shape.vertices_m, parked.pose))
    return np.concatenate(vertices) - origin_m, np.concatenate(triangles)
