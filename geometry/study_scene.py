"""The study's junction, and others that are described like it.

They consist of boxes, walls, poles and rows of parked cars.

Such a scene is one TOML file in CARLA's frame, laid out as ``data/town05.toml``.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from .actors import PlacedActor, park_row, pick_actor
from .arrays import FloatArray, Point2, Points2, Segment2
from .errors import InputError
from .frames import from_carla_points, from_carla_yaw
from .poses import Pose, to_world
from .scene import Body, Instance, Lane, Scene, Site, join_bodies
from .scene_sources import STUDY
from .solids import box_mesh, cylinder_mesh
from .tables import Text, read_table
from .text_formats import load_toml

_POLE_SIDES = 10
_Positive = Annotated[float, Meta(gt=0.0)]


class _Building(Struct, frozen=True, kw_only=True):
    """A box, in CARLA's frame; its position is the middle of the ground."""

    id: Text
    position_m: Point2
    yaw_deg: float
    length_m: _Positive
    width_m: _Positive
    height_m: _Positive


class _BoxWall(Struct, frozen=True, kw_only=True):
    """A straight wall between two points, in CARLA's frame."""

    id: Text
    from_m: Point2
    to_m: Point2
    thickness_m: _Positive
    height_m: _Positive


class ParkedRow(Struct, frozen=True, kw_only=True):
    """Bodies parked nose to tail, in CARLA's frame."""

    first_m: Point2
    yaw_deg: float
    gap_m: Annotated[float, Meta(ge=0.0)]
    actors: list[str]

    def bodies(self, where: str) -> tuple[PlacedActor, ...]:
        """The bodies in their places; raises InputError for an unknown one."""
        names = enumerate(self.actors)
        return park_row(
            [pick_actor(name, f"{where}.actors[{index}]") for index, name in names],
            first_bumper_m=from_carla_points(self.first_m),
            yaw_deg=float(from_carla_yaw(self.yaw_deg)),
            gap_m=self.gap_m,
        )


class _NamedRow(ParkedRow, frozen=True, kw_only=True):
    id: Text


class _Mount(Struct, frozen=True, kw_only=True):
    """What poles and mast arms have in common: a cylinder and a site."""

    id: Text
    radius_m: _Positive
    height_m: _Positive
    height_range_m: Point2
    capacity_units: int
    cost_eur: float = 0.0
    use: str = "free"


class _Pole(_Mount, frozen=True, kw_only=True):
    """A vertical pole; its position is the foot, in CARLA's frame."""

    kind: Text
    position_m: Point2


class _MastArm(_Mount, frozen=True, kw_only=True):
    """A level arm between two points, in CARLA's frame; the site is its end."""

    from_m: Point2
    to_m: Point2


class CrosswalkEntry(Struct, frozen=True, kw_only=True):
    """A crosswalk in a scene's file: the ends of its middle line."""

    ends_m: Segment2


class _Ground(Struct, frozen=True, kw_only=True):
    """A square of ground, in CARLA's frame."""

    position_m: Point2
    half_size_m: _Positive


class _BoxScene(Struct, frozen=True, kw_only=True):
    """A whole file, laid out as ``data/town05.toml``."""

    frame: Literal["carla-left-handed"]
    name: Text
    crs: Text
    road_network: str = ""
    outline_m: Points2
    ground: _Ground
    buildings: tuple[_Building, ...] = ()
    walls: tuple[_BoxWall, ...] = ()
    parked_rows: tuple[_NamedRow, ...] = ()
    poles: tuple[_Pole, ...] = ()
    mast_arms: tuple[_MastArm, ...] = ()
    lanes: tuple[Lane, ...] = ()
    crosswalks: tuple[CrosswalkEntry, ...] = ()


@cache
def load_study_scene() -> Scene:
    """The junction of the CarlaNCAP study, from ``data/town05.toml``."""
    return load_box_scene(files(__package__) / "data" / f"{STUDY}.toml")


def read_study_scene(_: Path, **_options: object) -> Scene:
    """Scene of :func:`load_study_scene`, as a :class:`.scene_sources.SceneReader`."""
    return load_study_scene()


def load_box_scene(source: Path | Traversable) -> Scene:
    """Read a TOML file laid out as ``geometry/data/town05.toml`` and build its mesh."""
    where = source.name
    table = read_table(load_toml(source), _BoxScene, where)
    for index, crosswalk in enumerate(table.crosswalks):
        if (crosswalk.ends_m[0] == crosswalk.ends_m[1]).all():
            got = crosswalk.ends_m.tolist()
            raise InputError(
                f"{where}: crosswalks[{index}].ends_m", got, "two different points"
            )
    return Scene(
        name=table.name,
        **join_bodies([*_bodies(table, where)]),
        sites=(
            *(_site(pole, pole.position_m, pole.kind) for pole in table.poles),
            *(_site(arm, arm.to_m, "mast arm") for arm in table.mast_arms),
        ),
        outline_m=from_carla_points(table.outline_m),
        lanes=tuple(
            replace(lane, centreline_m=from_carla_points(lane.centreline_m))
            for lane in table.lanes
        ),
        crs=table.crs,
        crosswalks_m=crosswalk_lines(
            from_carla_points(line.ends_m) for line in table.crosswalks
        ),
        road_network=table.road_network,
    )


def crosswalk_lines(lines: Iterable[FloatArray]) -> FloatArray:
    """Middle lines of crosswalks as an array, (n, 2, 2)."""
    return np.array(list(lines)).reshape(-1, 2, 2)


def _site(mount: _Mount, below_m: FloatArray, kind: str) -> Site:
    """Site of a pole or a mast arm, above a point in CARLA's frame."""
    same = ("id", "height_range_m", "capacity_units", "cost_eur", "use")
    fields: dict[str, Any] = {name: getattr(mount, name) for name in same}
    return Site(position_m=_on_road(below_m), kind=kind, **fields)


def _on_road(point_carla_m: FloatArray, height_m: float = 0.0) -> FloatArray:
    """A point (2,) of CARLA's frame, in the world frame, at a height, (3,)."""
    return np.append(from_carla_points(point_carla_m), height_m)


def _bodies(table: _BoxScene, where: str) -> Iterator[Body]:
    """All things of a file, in its order: ground, buildings, walls, the rest."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    # The ground is a flat square of two triangles.
    corners = (
        from_carla_points(table.ground.position_m) + table.ground.half_size_m * square
    )
    ground = np.column_stack([corners, np.zeros(4)])
    yield (
        Instance(id="ground", class_name="ground"),
        ground,
        np.array([[0, 1, 2], [0, 2, 3]]),
    )
    for building in table.buildings:
        yield _box(
            Instance(id=building.id, class_name="building"),
            middle_m=from_carla_points(building.position_m),
            yaw_deg=float(from_carla_yaw(building.yaw_deg)),
            size_m=[building.length_m, building.width_m, building.height_m],
        )
    for wall in table.walls:
        start = from_carla_points(wall.from_m)
        end = from_carla_points(wall.to_m)
        east, north = end - start
        # Half a thickness longer at both ends: walls that meet at a corner close it.
        length_m = float(np.hypot(east, north)) + wall.thickness_m
        yield _box(
            Instance(id=wall.id, class_name="wall"),
            middle_m=0.5 * (start + end),
            yaw_deg=float(np.degrees(np.arctan2(north, east))),
            size_m=[length_m, wall.thickness_m, wall.height_m],
        )
    for index, row in enumerate(table.parked_rows):
        parked = row.bodies(f"{where}: parked_rows[{index}]")
        for number, body in enumerate(parked, start=1):
            shape = body.actor.shapes[0]
            instance = Instance(id=f"{row.id}-{number}", class_name="parked vehicle")
            yield instance, to_world(shape.vertices_m, body.pose), shape.triangles
    for pole in table.poles:
        foot = _on_road(pole.position_m)
        top = _on_road(pole.position_m, pole.height_m)
        yield _cylinder(
            Instance(id=pole.id, class_name=pole.kind), [foot, top], pole.radius_m
        )
    for arm in table.mast_arms:
        ends = [_on_road(point, arm.height_m) for point in (arm.from_m, arm.to_m)]
        yield _cylinder(
            Instance(id=arm.id, class_name="traffic light"), ends, arm.radius_m
        )


def _box(
    instance: Instance, *, middle_m: FloatArray, yaw_deg: float, size_m: list[float]
) -> Body:
    """A box that stands on the plane z = 0."""
    corners, triangles = box_mesh(size_m)
    pose = Pose(position_m=np.append(middle_m, 0.5 * size_m[2]), yaw_deg=yaw_deg)
    return instance, to_world(corners, pose), triangles


def _cylinder(instance: Instance, ends_m: list[FloatArray], radius_m: float) -> Body:
    """A cylinder between two points."""
    corners, triangles = cylinder_mesh(ends_m, radius_m=radius_m, n_sides=_POLE_SIDES)
    return instance, corners, triangles
