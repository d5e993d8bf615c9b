"""Bodies that stand in the scene in some of the runs: obstructions, parked and waiting vehicles.

Few kinds of bodies stand in many places. Rays are taken into the frame of each body that they may
meet, and cast against its shape there: what is prepared for a shape serves wherever it stands.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from geometry.actors import PlacedActor, Shape
from geometry.arrays import FloatArray, IntArray
from geometry.poses import body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster, build_caster
from scenarios.runs import Run

AROUND_BODY_M = 2.0e-3  # rays that pass a body this near are cast


def find_obstructions(runs: Sequence[Run]) -> tuple[list[tuple[PlacedActor, ...]], IntArray]:
    """Distinct obstructions in the order of `Standing.bodies`, and which each run has, (n_runs,).

    Those are the same that have the same bodies at the same places.
    """
    keys = {body: body.key for body in {body for run in runs for body in run.obstruction}}
    numbers: dict[tuple[object, ...], int] = {}
    found: list[tuple[PlacedActor, ...]] = []
    index = []
    for run in runs:
        key = tuple(keys[body] for body in run.obstruction)
        if numbers.setdefault(key, len(found)) == len(found):
            found.append(run.obstruction)
        index.append(numbers[key])
    return found, np.array(index)


def bodies_mesh(
    bodies: tuple[PlacedActor, ...], origin_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices (n, 3) from an origin, and triangles (m, 3), of placed bodies."""
    vertices, triangles = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int32)]
    for body in bodies:
        shape = body.actor.shapes[0]
        triangles.append((shape.triangles + sum(map(len, vertices))).astype(np.int32))
        vertices.append(to_world(shape.vertices_m, body.pose) - origin_m)
    return np.concatenate(vertices), np.concatenate(triangles)


@lru_cache(maxsize=256)
def shape_caster(shape: Shape, rays: str) -> RayCaster:
    """Caster of a body in its own frame; tables of many worlds ask for the same ones."""
    return build_caster(shape.vertices_m, shape.triangles, library=rays)


@lru_cache(maxsize=256)
def box_m(shape: Shape) -> FloatArray:
    """Lowest and highest coordinates of a shape, (2, 3)."""
    return np.array([shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standing:
    """Bodies that stand in the scene in some of the runs: each distinct one once."""

    shapes: tuple[Shape, ...]  # each distinct shape
    casters: tuple[RayCaster, ...]  # of each shape, in its own frame
    shape_index: IntArray  # (n,): into `shapes`
    position_m: FloatArray  # (n, 3): relative to the origin of `World`. [m]
    rotation: FloatArray  # (n, 3, 3): from the frame of each into the world's
    # of each obstruction the bodies that it has, as its runs have them; maybe none
    bodies: tuple[IntArray, ...]

    def first_triangle(
        self, obstruction: int, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """First hits of rays on the bodies of an obstruction; see :class:`.RayCaster`.

        Their triangles are numbered body after body.
        """
        share = np.full(len(origins_m), np.inf, dtype=np.float32)
        index = np.full(len(origins_m), -1, dtype=np.int64)
        n_before = 0
        for body in self.bodies[obstruction].tolist():
            turn, number = self.rotation[body], self.shape_index[body]
            hit, triangle = self.casters[number].first_triangle(
                ((origins_m - self.position_m[body]) @ turn).astype(np.float32),
                (vectors_m @ turn).astype(np.float32),
            )
            is_nearer = hit < share
            share[is_nearer] = hit[is_nearer]
            index[is_nearer] = n_before + triangle[is_nearer]
            n_before += len(self.shapes[number].triangles)
        return share, index


def build_standing(
    obstructions: Iterable[tuple[PlacedActor, ...]], origin_m: FloatArray, rays: str
) -> Standing:
    """Prepare the bodies of obstructions for rays relative to an origin."""
    numbers: dict[tuple[object, ...], int] = {}
    placed: list[PlacedActor] = []
    bodies = []
    for obstruction in obstructions:
        for body in obstruction:
            if numbers.setdefault(body.key, len(placed)) == len(placed):
                placed.append(body)
        bodies.append(np.array([numbers[body.key] for body in obstruction], dtype=np.int64))
    shapes = {body.actor.shapes[0]: None for body in placed}
    number_of = {shape: number for number, shape in enumerate(shapes)}
    poses = [body.pose for body in placed]
    return Standing(
        shapes=tuple(shapes),
        casters=tuple(shape_caster(shape, rays) for shape in shapes),
        shape_index=np.array([number_of[body.actor.shapes[0]] for body in placed], dtype=np.int64),
        position_m=np.array([pose.position_m - origin_m for pose in poses]).reshape(-1, 3),
        rotation=body_rotation([p.yaw_deg for p in poses], [p.pitch_deg for p in poses]),
        bodies=tuple(bodies),
    )
