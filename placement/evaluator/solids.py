"""Triangles of everything that can be seen, ready for pixels and for LiDAR beams.

A *road pose* is a row of four numbers: east and north in metres, yaw in degrees, and height of the
ground in metres. It places the frame of a :class:`Solid` in the frame in which a sensor stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from geometry.actors import PlacedActor, Shape
from geometry.arrays import FloatArray, IntArray
from geometry.poses import to_world
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Scene

if TYPE_CHECKING:
    from .pixels import Skin, Tree


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles (n_triangles, 3), rows of vertices (n_vertices, 3) in metres.

    Tree and skin are built when they are first asked for: only LiDARs do without.
    """

    vertices_m: FloatArray
    triangles: IntArray
    _lock: RLock = field(default_factory=RLock, repr=False)

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the triangles, (n_triangles, 3, 3)."""
        corners: FloatArray = np.ascontiguousarray(self.vertices_m[self.triangles])
        return corners

    @cached_property
    def skin(self) -> "Skin":
        """Its triangles, shuffled for drawing."""
        from .pixels import Skin  # loads the compiler

        rng, n_vertices = np.random.default_rng(0), len(self.vertices_m)
        order = rng.permutation(n_vertices)
        place = np.empty(n_vertices, dtype=np.int64)
        place[order] = np.arange(n_vertices)
        triangles = place[rng.permutation(self.triangles)]
        corners = triangles.ravel()
        return Skin(
            vertices_m=np.ascontiguousarray(self.vertices_m[order]),
            triangles=triangles,
            fan_start=np.append(0, np.cumsum(np.bincount(corners, minlength=n_vertices))),
            fans=np.argsort(corners, kind="stable") // 3,
        )

    @property
    def tree(self) -> "Tree":
        """Boxes around its triangles; safe to ask for from several threads."""
        with self._lock:
            return self._tree

    @cached_property
    def _tree(self) -> "Tree":
        from .pixels import build_tree  # loads the compiler

        return build_tree(self.corners_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """Triangles that keep together, in their own frame."""

    # One of a road user; of the static world, what always stands there and what is parked in a run.
    # A mesh may belong to several solids.
    meshes: tuple[Mesh, ...]
    hull_m: FloatArray  # (n, 3): vertices of the convex hull; none for the static world. [m]
    library: str | None = None  # casts rays; see geometry.raycast.build_caster
    _lock: RLock = field(default_factory=RLock, repr=False)

    @property
    def caster(self) -> RayCaster:
        """For rays against its triangles, mesh after mesh; safe to ask for from several threads."""
        with self._lock:
            return self._caster

    @cached_property
    def _caster(self) -> RayCaster:
        """Built when a LiDAR asks for it: a camera's pixels need no rays."""
        starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in self.meshes)])
        triangles = [
            mesh.triangles + start for mesh, start in zip(self.meshes, starts, strict=False)
        ]
        vertices = [mesh.vertices_m for mesh in self.meshes]
        return build_caster(
            np.concatenate(vertices), np.concatenate(triangles), library=self.library
        )

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals of the triangles, (n_triangles, 3), mesh after mesh."""
        corners = np.concatenate([mesh.corners_m for mesh in self.meshes])
        a, b, c = np.moveaxis(corners, 1, 0)
        across = np.cross(b - a, c - a)
        normals: FloatArray = across / np.linalg.norm(across, axis=1, keepdims=True).clip(1.0e-12)
        return normals


def build_body(shape: Shape, *, library: str | None = None) -> Solid:
    """A road user at one instant of its gait, in its body frame."""
    from scipy.spatial import ConvexHull  # loaded when something is drawn

    hull = ConvexHull(shape.vertices_m).vertices
    mesh = Mesh(vertices_m=np.array(shape.vertices_m), triangles=shape.triangles.astype(np.int64))
    return Solid(meshes=(mesh,), hull_m=shape.vertices_m[hull], library=library)


def build_scene_mesh(scene: Scene, *, middle_m: FloatArray) -> Mesh:
    """The scene's triangles, with the origin at `middle_m`, (2,) in the world frame [m].

    So coordinates are small where rays are cast in single precision: its road pose in the world is
    (*middle_m, 0, 0).
    """
    return Mesh(
        vertices_m=scene.vertices_m - [*middle_m, 0.0],
        triangles=np.asarray(scene.triangles, dtype=np.int64),
    )


def build_static(
    standing: Mesh,
    obstruction: Sequence[PlacedActor],
    *,
    middle_m: FloatArray,
    library: str | None = None,
) -> Solid:
    """Everything that stands still: a scene's mesh with the same origin, and parked bodies."""
    vertices, triangles = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)]
    for body in obstruction:
        shape = body.actor.shapes[0]
        triangles.append(shape.triangles.astype(np.int64) + sum(map(len, vertices)))
        vertices.append(to_world(shape.vertices_m, body.pose) - [*middle_m, 0.0])
    parked = Mesh(vertices_m=np.concatenate(vertices), triangles=np.concatenate(triangles))
    return Solid(meshes=(standing, parked), hull_m=np.empty((0, 3)), library=library)
