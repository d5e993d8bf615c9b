"""Scenes from disk: a TOML file with boxes, walls, poles and rows of parked cars."""

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from .actors import park_row, pick_actor
from .arrays import FloatArray, float_array
from .errors import InputError
from .files import (
    Table,
    load_toml,
    take,
    take_list,
    take_number,
    take_text,
)
from .frames import from_carla_points, from_carla_yaw
from .poses import Pose, to_world
from .scene import (
    Instance,
    Lane,
    Scene,
    Site,
)

_FRAMES = ("carla-left-handed",)
_POLE_SECTIONS = 10

# One thing of the scene: instance, vertices (world frame) and triangles.
_Body = tuple[Instance, FloatArray, Any]


@cache
def load_study_scene() -> Scene:
    """The junction of the CarlaNCAP study, from ``data/town05.toml``."""
    return load_scene(files(__package__) / "data" / "town05.toml")


def load_scene(source: Path | Traversable) -> Scene:
    """Read a scene and build its mesh.

    Parameters
    ----------
    source : Path or Traversable
        A TOML file, laid out as ``geometry/data/town05.toml``.

    Returns
    -------
    scene : Scene
        World frame: right-handed east-north-up.

    Raises
    ------
    InputError
        The file cannot be read, or a field is missing or not of its kind.
    """
    table = load_toml(source)
    where = source.name
    frame = take_text(table, "frame", where)
    if frame not in _FRAMES:
        raise InputError(f"{where}: frame", frame, "one of " + ", ".join(_FRAMES))
    bodies = [
        body
        for key, build in _BUILDERS.items()
        for entry, here in _entries(table, key, where)
        for body in build(entry, here)
    ]
    n_vertices = np.cumsum([0, *(len(vertices) for _, vertices, _ in bodies)])
    return Scene(
        name=take_text(table, "name", where),
        vertices_m=np.concatenate([vertices for _, vertices, _ in bodies]),
        triangles=np.concatenate(
            [
                triangles + first
                for (_, _, triangles), first in zip(bodies, n_vertices[:-1], strict=True)
            ]
        ),
        triangle_instance=np.repeat(
            np.arange(len(bodies)), [len(triangles) for _, _, triangles in bodies]
        ),
        instances=tuple(instance for instance, _, _ in bodies),
        sites=tuple(
            _build_site(entry, here, end)
            for key, end in (("poles", "position_m"), ("mast_arms", "to_m"))
            for entry, here in _entries(table, key, where)
        ),
        outline_m=_points(table, "outline_m", where),
        lanes=tuple(_build_lane(entry, here) for entry, here in _entries(table, "lanes", where)),
        crs=take_text(table, "crs", where),
        crosswalks_m=np.array(
            [_ends(entry, here) for entry, here in _entries(table, "crosswalks", where)]
        ).reshape(-1, 2, 2),
        road_network=take_text(table, "road_network", where) if "road_network" in table else "",
    )


def _entries(table: Table, key: str, where: str) -> Iterator[tuple[Table, str]]:
    if key == "ground":
        entries = [(take(table, key, where), f"{where}: {key}")]
    else:
        listed = take_list(table, key, where) if key in table else []
        entries = [(entry, f"{where}: {key}[{index}]") for index, entry in enumerate(listed)]
    for entry, here in entries:
        if not isinstance(entry, Mapping):
            raise InputError(here, entry, "a table")
        yield entry, here


def _build_lane(entry: Table, where: str) -> Lane:
    return Lane(
        id=take_text(entry, "id", where),
        kind=take_text(entry, "kind", where),
        width_m=_positive(entry, "width_m", where),
        centreline_m=_points(entry, "centreline_m", where),
    )


def _build_site(entry: Table, where: str, end: str) -> Site:
    return Site(
        id=take_text(entry, "id", where),
        position_m=np.append(_point(entry, end, where), 0.0),
        kind=entry.get("kind", "mast arm"),
        height_range_m=float_array(
            take_list(entry, "height_range_m", where), (2,), f"{where}.height_range_m"
        ),
        capacity_units=take(entry, "capacity_units", where),
        cost_eur=entry.get("cost_eur", 0.0),
        use=entry.get("use", "free"),
    )


def _build_box(entry: Table, where: str) -> Iterator[_Body]:
    yield _box(
        Instance(id=take_text(entry, "id", where), class_name="building"),
        middle_m=_point(entry, "position_m", where),
        yaw_deg=float(from_carla_yaw(take_number(entry, "yaw_deg", where))),
        size_m=[_positive(entry, f"{side}_m", where) for side in ("length", "width", "height")],
    )


def _build_wall(entry: Table, where: str) -> Iterator[_Body]:
    start, end = _point(entry, "from_m", where), _point(entry, "to_m", where)
    east, north = end - start
    thickness_m = _positive(entry, "thickness_m", where)
    yield _box(
        Instance(id=take_text(entry, "id", where), class_name="wall"),
        middle_m=0.5 * (start + end),
        yaw_deg=float(np.degrees(np.arctan2(north, east))),
        # Half a thickness longer at both ends: walls that meet at a corner close it.
        size_m=[
            float(np.hypot(east, north)) + thickness_m,
            thickness_m,
            _positive(entry, "height_m", where),
        ],
    )


def _build_row(entry: Table, where: str) -> Iterator[_Body]:
    name = take_text(entry, "id", where)
    yaw_deg = float(from_carla_yaw(take_number(entry, "yaw_deg", where)))
    gap_m = take_number(entry, "gap_m", where)
    if gap_m < 0.0:
        raise InputError(f"{where}.gap_m", gap_m, "a number, at least 0")
    row = park_row(
        [
            pick_actor(actor_name, f"{where}.actors[{index}]")
            for index, actor_name in enumerate(take_list(entry, "actors", where))
        ],
        first_bumper_m=_point(entry, "first_m", where),
        yaw_deg=yaw_deg,
        gap_m=gap_m,
    )
    for index, parked in enumerate(row):
        instance = Instance(id=f"{name}-{index + 1}", class_name="parked vehicle")
        shape = parked.actor.shapes[0]
        yield instance, to_world(shape.vertices_m, parked.pose), shape.triangles


def _build_pole(entry: Table, where: str) -> Iterator[_Body]:
    foot = np.append(_point(entry, "position_m", where), 0.0)
    yield _cylinder(
        Instance(id=take_text(entry, "id", where), class_name=take_text(entry, "kind", where)),
        start_m=foot,
        end_m=foot + [0.0, 0.0, _positive(entry, "height_m", where)],
        radius_m=_positive(entry, "radius_m", where),
    )


def _build_arm(entry: Table, where: str) -> Iterator[_Body]:
    height_m = _positive(entry, "height_m", where)
    yield _cylinder(
        Instance(id=take_text(entry, "id", where), class_name="traffic light"),
        start_m=np.append(_point(entry, "from_m", where), height_m),
        end_m=np.append(_point(entry, "to_m", where), height_m),
        radius_m=_positive(entry, "radius_m", where),
    )


def _build_ground(entry: Table, where: str) -> Iterator[_Body]:
    half = _positive(entry, "half_size_m", where)
    middle = _point(entry, "position_m", where)
    corners = middle + half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    yield (
        Instance(id="ground", class_name="ground"),
        np.column_stack([corners, np.zeros(4)]),
        np.array([[0, 1, 2], [0, 2, 3]]),
    )


_BUILDERS = {
    "ground": _build_ground,
    "buildings": _build_box,
    "walls": _build_wall,
    "parked_rows": _build_row,
    "poles": _build_pole,
    "mast_arms": _build_arm,
}


def _box(instance: Instance, *, middle_m: FloatArray, yaw_deg: float, size_m: list[float]) -> _Body:
    import trimesh

    box = trimesh.creation.box(extents=size_m)
    pose = Pose(position_m=np.append(middle_m, 0.5 * size_m[2]), yaw_deg=yaw_deg)
    return instance, to_world(box.vertices, pose), box.faces


def _cylinder(
    instance: Instance, *, start_m: FloatArray, end_m: FloatArray, radius_m: float
) -> _Body:
    import trimesh

    cylinder = trimesh.creation.cylinder(
        radius=radius_m, segment=[start_m, end_m], sections=_POLE_SECTIONS
    )
    return instance, cylinder.vertices, cylinder.faces


def _point(entry: Table, key: str, where: str) -> FloatArray:
    return from_carla_points(float_array(take_list(entry, key, where), (2,), f"{where}.{key}"))


def _points(entry: Table, key: str, where: str) -> FloatArray:
    return from_carla_points(float_array(take_list(entry, key, where), (-1, 2), f"{where}.{key}"))


def _ends(entry: Table, where: str) -> FloatArray:
    ends = float_array(take_list(entry, "ends_m", where), (2, 2), f"{where}.ends_m")
    if (ends[0] == ends[1]).all():
        raise InputError(f"{where}.ends_m", ends.tolist(), "two different points")
    return from_carla_points(ends)


def _positive(entry: Table, key: str, where: str) -> float:
    value = take_number(entry, key, where)
    if value <= 0.0:
        raise InputError(f"{where}.{key}", value, "a number > 0")
    return value
