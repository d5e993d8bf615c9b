"""Bodies that stand in the scene in some of the runs: obstructions, parked and waiting vehicles.

Few kinds of bodies stand in many places. Rays are taken into the frame of each body that they may
meet, and cast against its shape there: what is prepared for a shape serves wherever it stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from geometry.actors import PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.poses import body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster, build_caster
from scenarios.runs import Run

AROUND_BODY_M = 2.0e-3  # rays that pass a body this near are cast


def obstruction_key(run: Run) -> tuple[object, ...]:
    """Equal for runs with the same bodies at the same places."""
    return tuple(parked.key for parked in run.obstruction)


def find_obstructions(runs: Sequence[Run]) -> dict[tuple[object, ...], tuple[PlacedActor, ...]]:
    """Distinct obstructions in the order of `World.obstructions`, by their content."""
    return {obstruction_key(run): run.obstruction for run in runs}


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
def _box_m(shape: Shape) -> FloatArray:
    """Lowest and highest coordinates of a shape, (2, 3)."""
    return np.array([shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Boxes:
    """Boxes around placed bodies, each in the body's own frame."""

    position_m: FloatArray  # (n, 3): relative to the origin of `World`. [m]
    rotation: FloatArray  # (n, 3, 3): from the frame of each into the world's
    low_m: FloatArray  # (n, 3): where the box begins. [m]
    high_m: FloatArray  # (n, 3): where it ends. [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Obstruction:
    """Bodies that stand in the scene in some of the runs."""

    caster: RayCaster  # of all of them, relative to the origin of `World`
    boxes: Boxes  # around each of them


def build_obstruction(
    bodies: tuple[PlacedActor, ...], origin_m: FloatArray, rays: str
) -> Obstruction:
    """Prepare placed bodies for rays relative to an origin."""
    limits = np.array([_box_m(body.actor.shapes[0]) for body in bodies]).reshape(-1, 2, 3)
    poses = [body.pose for body in bodies]
    boxes = Boxes(
        position_m=np.array([pose.position_m - origin_m for pose in poses]).reshape(-1, 3),
        rotation=body_rotation([p.yaw_deg for p in poses], [p.pitch_deg for p in poses]),
        low_m=limits[:, 0] - AROUND_BODY_M,
        high_m=limits[:, 1] + AROUND_BODY_M,
    )
    return Obstruction(
        caster=BodiesCaster([b.actor.shapes[0] for b in bodies], boxes, rays), boxes=boxes
    )


class BodiesCaster:
    """Rays against bodies that stand somewhere; see :class:`.RayCaster`."""

    def __init__(self, shapes: Sequence[Shape], boxes: Boxes, rays: str) -> None:
        kinds = {shape: number for number, shape in enumerate(dict.fromkeys(shapes))}
        self._casters = [shape_caster(shape, rays) for shape in kinds]
        self._kind = np.array([kinds[shape] for shape in shapes], dtype=np.int64)
        n_triangles = [len(shape.triangles) for shape in shapes]
        self._first_triangle = np.cumsum([0, *n_triangles])
        self._boxes = boxes

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """See :class:`.RayCaster`."""
        blocked = np.zeros(len(origins_m), dtype=bool)
        for caster, ray, _, starts, vectors in self._in_body_frames(origins_m, vectors_m):
            blocked[ray[caster.is_blocked(starts, vectors)]] = True
        return blocked

    def first_hit(self, origins_m: FloatRays, vectors_m: FloatRays) -> FloatRays:
        """See :class:`.RayCaster`."""
        return self.first_triangle(origins_m, vectors_m)[0]

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """See :class:`.RayCaster`: triangles are numbered body after body, as they were given."""
        share = np.full(len(origins_m), np.inf, dtype=np.float32)
        index = np.full(len(origins_m), -1, dtype=np.int64)
        for caster, ray, body, starts, vectors in self._in_body_frames(
            origins_m, vectors_m, is_endless=True
        ):
            hit, triangle = caster.first_triangle(starts, vectors)
            order = np.argsort(-hit, kind="stable")  # the nearest is written last
            order = order[hit[order] < share[ray[order]]]
            share[ray[order]] = hit[order]
            index[ray[order]] = self._first_triangle[body[order]] + triangle[order]
        return share, index

    def _in_body_frames(
        self, origins_m: FloatRays, vectors_m: FloatRays, *, is_endless: bool = False
    ) -> list[tuple[RayCaster, IntArray, IntArray, FloatRays, FloatRays]]:
        """Rays that meet the box around a body, in its frame, kind by kind.

        Of each kind its caster, the rays' numbers, the bodies', starts and vectors. Rays end where
        their vectors do, or never.
        """
        from .ray_kernels import find_rays_at_boxes

        boxes = self._boxes
        n_most = len(origins_m) * len(self._kind)
        if n_most == 0:
            return []
        pairs = np.empty((n_most, 2), dtype=np.int32)
        n_pairs = find_rays_at_boxes(
            np.ascontiguousarray(origins_m, dtype=np.float32),
            np.ascontiguousarray(vectors_m, dtype=np.float32),
            *(boxes.position_m, boxes.rotation, boxes.low_m, boxes.high_m),
            np.inf if is_endless else 1.0,
            pairs,
        )
        ray, body = pairs[:n_pairs].T.astype(np.int64)
        parts = []
        for kind in np.unique(self._kind[body]).tolist():
            mine = np.flatnonzero(self._kind[body] == kind)
            there, turn = body[mine], boxes.rotation[body[mine]]
            starts = np.einsum("ni,nij->nj", origins_m[ray[mine]] - boxes.position_m[there], turn)
            vectors = np.einsum("ni,nij->nj", vectors_m[ray[mine]].astype(np.float64), turn)
            parts.append(
                (
                    self._casters[kind],
                    ray[mine],
                    there,
                    starts.astype(np.float32),
                    vectors.astype(np.float32),
                )
            )
        return parts
