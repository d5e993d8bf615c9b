"""Bodies that move or park: bounding box and mesh, from ``data/actors.toml``."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import FloatArray, float_array, freeze
from .errors import InputError
from .poses import Pose
from .toml_files import Table, load_toml, pick, take_list, take_number, take_text

_SPHERE_SUBDIVISIONS = 1  # 42 vertices: the outline of a limb stays within 4 % of its radius


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actor:
    """A body with its bounding box.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    class_name : str
        "vehicle", "parked vehicle", "pedestrian" or "cyclist".
    length_m, width_m, height_m : float
        Bounding box along x, y, z of the body frame. [m]
    vertices_m : (n_vertices, 3) float
        Body frame: origin on the road under the middle of the box, x ahead, y left. [m]
    triangles : (n_triangles, 3) int32
        Vertex indices; normals point outwards.
    """

    name: str
    class_name: str
    length_m: float
    width_m: float
    height_m: float
    vertices_m: FloatArray
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        for field in ("length_m", "width_m", "height_m"):
            if not getattr(self, field) > 0.0:
                raise InputError(f"actor {self.name}.{field}", getattr(self, field), "> 0 metres")
        object.__setattr__(
            self, "vertices_m", float_array(self.vertices_m, (-1, 3), f"actor {self.name}")
        )
        object.__setattr__(self, "triangles", freeze(np.array(self.triangles, dtype=np.int32)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedActor:
    """A body that stands somewhere.

    Attributes
    ----------
    actor : Actor
        The body.
    pose : Pose
        Its body frame in the world; no pitch.
    """

    actor: Actor
    pose: Pose


@cache
def load_actors() -> dict[str, Actor]:
    """All bodies of the catalogue, by name."""
    table = load_toml(files(__package__) / "data" / "actors.toml")
    return {name: _build_actor(name, entry) for name, entry in table.items()}


def pick_actor(name: str, where: str) -> Actor:
    """Body by name.

    Raises
    ------
    InputError
        The name is unknown.
    """
    actor: Actor = pick(load_actors(), name, where)
    return actor


def _build_actor(name: str, entry: Table) -> Actor:
    import trimesh

    where = f"actors.toml: {name}"
    size_m = np.array([take_number(entry, f"{axis}_m", where) for axis in _AXES])
    parts = [
        mesh
        for index, part in enumerate(take_list(entry, "parts", where))
        for mesh in _build_part(part, f"{where}.parts[{index}]")
    ]
    body = trimesh.util.concatenate(parts)
    low, high = body.bounds
    vertices = (body.vertices - low) / (high - low) * size_m
    vertices -= [0.5 * size_m[0], 0.5 * size_m[1], 0.0]
    return Actor(
        name=name,
        class_name=take_text(entry, "class_name", where),
        length_m=float(size_m[0]),
        width_m=float(size_m[1]),
        height_m=float(size_m[2]),
        vertices_m=vertices,
        triangles=body.faces,
    )


_AXES = ("length", "width", "height")


def _build_part(part: Table, where: str) -> list[Any]:
    import trimesh

    if "ring" in part:
        ring = part["ring"]
        mesh = trimesh.creation.torus(
            major_radius=take_number(ring, "radius", where),
            minor_radius=take_number(ring, "tyre_radius", where),
            major_sections=20,
            minor_sections=8,
        )
        # trimesh lays the ring flat; a wheel stands, axle along y.
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, [1.0, 0.0, 0.0]))
        mesh.apply_translation(float_array(ring["centre"], (3,), f"{where}.centre"))
    else:
        spheres = float_array(take_list(part, "spheres", where), (-1, 4), f"{where}.spheres")
        ball = trimesh.creation.icosphere(subdivisions=_SPHERE_SUBDIVISIONS).vertices
        points = spheres[:, None, :3] + spheres[:, None, 3:] * ball
        mesh = trimesh.convex.convex_hull(points.reshape(-1, 3))
    if not part.get("mirror", False):
        return [mesh]
    mirrored = mesh.copy()
    mirrored.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    return [mesh, mirrored]
