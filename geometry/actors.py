"""Bodies that move or park, and the catalogue they come from.

Boxes and other sizes are in ``data/actors.toml``, shapes in
``data/actors.npz``.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

import numpy as np
from msgspec import Struct, structs
from numpy.typing import ArrayLike, NDArray

from .arrays import BoolArray, FloatArray, IntArray, freeze, set_arrays
from .errors import InputError, Unquoted, check_one_of, located, refuse
from .footprints import FootprintSizes, footprint_corners
from .poses import Pose
from .solids import box_mesh
from .tables import Table, Text, pick, read_tables, take_number, take_text
from .text_formats import load_toml

# Of a shape: distances that differ in the last bits give the same one.
_SHAPE_DECIMALS = 6
LOOK_AT_M = 1.0
"""Height above the road of the middle of a road user. [m]"""
_REMEDY = "shapes built from it: python -m geometry.body_shapes"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shape:
    """A body at one instant of its gait: one closed mesh.

    `vertices_m` (n_vertices, 3) are in the body frame: origin on the road under the
    middle of the box, x ahead, y left. Normals of the `triangles` (n_triangles, 3)
    point outwards.
    """

    vertices_m: FloatArray
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        set_arrays(self, "shape: ", vertices_m=(-1, 3))
        object.__setattr__(
            self, "triangles", freeze(np.array(self.triangles, dtype=np.int32))
        )

    def __repr__(self) -> str:
        return f"Shape({len(self.triangles)} triangles)"


def box_shape(length_m: float, width_m: float, height_m: float) -> Shape:
    """A box that stands on the ground, its middle above the origin."""
    corners, triangles = box_mesh((length_m, width_m, height_m))
    return Shape(
        vertices_m=corners + [0.0, 0.0, 0.5 * height_m],
        triangles=triangles.astype(np.int32),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actor:
    """A body with its bounding box.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    class_name : str
        "vehicle", "parked vehicle", "pedestrian", "cyclist", "motorcyclist" or
        "car".
    length_m, width_m, height_m : float
        Bounding box of all shapes together, along x, y, z of the body frame. [m]
    shapes : tuple of Shape
        Evenly spaced over one cycle of the gait; the first is how the body stands at
        rest. One where nothing moves.
    cycle_m : float
        Distance covered in one cycle of the gait; 0 where nothing moves. [m]
    reference_ahead_m : float
        Hip, crank shaft, or the flank's point of a car that crosses, ahead of
        the middle of the box (negative: behind it). [m]
    wheelbase_m, front_axle_ahead_m : float
        Of a vehicle or motorcycle; the front axle ahead of the middle of the
        box. 0 for all others. [m]
    """

    name: str
    class_name: str
    length_m: float
    width_m: float
    height_m: float
    shapes: tuple[Shape, ...]
    cycle_m: float = 0.0
    reference_ahead_m: float = 0.0
    wheelbase_m: float = 0.0
    front_axle_ahead_m: float = 0.0

    def __post_init__(self) -> None:
        where = f"actor {self.name}"
        for field in ("length_m", "width_m", "height_m"):
            if not getattr(self, field) > 0.0:
                raise InputError(f"{where}.{field}", getattr(self, field), "> 0 metres")
        if not self.shapes:
            refuse(f"{where}.shapes", "none", "at least one shape")
        if not 0.0 <= self.cycle_m < np.inf or (len(self.shapes) > 1) != (
            self.cycle_m > 0.0
        ):
            got = self.cycle_m
            raise InputError(
                f"{where}.cycle_m", got, "> 0 metres for several shapes, 0 for one"
            )

    def __repr__(self) -> str:
        return f"Actor({self.name!r}, {len(self.shapes)} shapes)"

    def shape_index(self, distance_m: ArrayLike) -> IntArray:
        """Index of the shape that the body has, a distance after it stood at rest."""
        distance = np.asarray(distance_m, dtype=np.float64)
        if self.cycle_m == 0.0:
            return np.zeros(distance.shape, dtype=np.int64)
        # The gait goes on in a circle: the nearest of the evenly spaced shapes
        # counts.
        steps = (distance / self.cycle_m * len(self.shapes)).round(_SHAPE_DECIMALS)
        return np.floor(steps + 0.5).astype(np.int64) % len(self.shapes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedActor:
    """A body that stands somewhere, as at rest; its pose has no pitch."""

    actor: Actor
    pose: Pose

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for the same body at the same pose, whoever placed it."""
        return (
            self.actor,
            *self.pose.position_m.tolist(),
            self.pose.yaw_deg,
            self.pose.pitch_deg,
        )

    @property
    def footprint_m(self) -> FloatArray:
        """Corners on the road, (4, 2)."""
        size = {"length_m": self.actor.length_m, "width_m": self.actor.width_m}
        return footprint_corners(self.pose.position_m[:2], self.pose.yaw_deg, **size)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingActor:
    """A body that moves on the road, frame by frame.

    Attributes
    ----------
    actor : Actor
        The body.
    position_m : (n_frames, 2) float
        Middle of the footprint; not a number in frames in which it is not there. World
        frame. [m]
    yaw_deg : (n_frames,) float
        Heading. [deg]
    """

    actor: Actor
    position_m: FloatArray
    yaw_deg: FloatArray

    def __post_init__(self) -> None:
        position = np.array(self.position_m, dtype=np.float64)
        yaw = np.array(self.yaw_deg, dtype=np.float64)
        where = f"moving {self.actor.name}"
        if position.ndim != 2 or position.shape != (len(yaw), 2):
            refuse(where, f"shape {position.shape}", f"({len(yaw)}, 2)")
        is_there = ~np.isnan(position).any(axis=1)
        if not (
            np.isfinite(position[is_there]).all() and np.isfinite(yaw[is_there]).all()
        ):
            refuse(where, "infinite", "positions and headings, or no number")
        object.__setattr__(self, "position_m", freeze(position))
        object.__setattr__(self, "yaw_deg", freeze(yaw))

    @property
    def is_there(self) -> BoolArray:
        """Frames in which it is there, (n_frames,)."""
        return ~np.asarray(np.isnan(self.position_m).any(axis=1), dtype=bool)


@cache
def load_actors() -> dict[str, Actor]:
    """All bodies of the catalogue, by name."""
    data = files(__package__) / "data"
    return read_actors(load_toml(data / "actors.toml"), data / "actors.npz")


def read_actors(table: Table, source: Traversable) -> dict[str, Actor]:
    """Bodies of a catalogue laid out as ``data/actors.toml``, by name.

    `source` has the shapes that ``geometry.body_shapes`` has built from it.

    Raises
    ------
    InputError
        A field is missing, or the shapes were built from another description.
    """
    try:
        with source.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
    except FileNotFoundError:
        raise InputError(str(source), Unquoted("no such file"), _REMEDY) from None
    # Shapes of another description would not fit the boxes of this one.
    if str(arrays.get("fingerprint")) != fingerprint(table):
        refuse(str(source), "shapes of another actors.toml", _REMEDY)
    entries = read_tables(table, _ActorEntry, "actors.toml")
    return {
        name: Actor(
            name=name,
            shapes=tuple(
                Shape(
                    vertices_m=arrays[f"{name}/{index}/vertices_m"],
                    triangles=arrays[f"{name}/{index}/triangles"],
                )
                for index in range(int(arrays[f"{name}/n_shapes"]))
            ),
            **structs.asdict(entry),
        )
        for name, entry in entries.items()
    }


def fingerprint(table: Table) -> str:
    """Hash of a catalogue's content, whatever its layout and comments."""
    text = json.dumps(table, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def footprint_sizes(one: Actor, other: Actor) -> FootprintSizes:
    """Footprints of two bodies, a and b."""
    return FootprintSizes(
        length_a_m=one.length_m,
        width_a_m=one.width_m,
        length_b_m=other.length_m,
        width_b_m=other.width_m,
    )


def pick_actor(name: str, where: str) -> Actor:
    """Body by name; the error about an unknown one lists the known ones."""
    return pick(load_actors(), name, where)


class _ActorEntry(Struct, frozen=True, kw_only=True):
    """A body in ``data/actors.toml`` without its parts.

    Only ``geometry.body_shapes`` reads the parts.
    """

    class_name: Text
    length_m: float
    width_m: float
    height_m: float
    cycle_m: float = 0.0
    reference_ahead_m: float = 0.0
    wheelbase_m: float = 0.0
    front_axle_ahead_m: float = 0.0


def park_row(
    actors: Sequence[Actor], *, first_bumper_m: FloatArray, yaw_deg: float, gap_m: float
) -> tuple[PlacedActor, ...]:
    """Place bodies nose to tail, from the first to the last, all looking the same way.

    `first_bumper_m` (2,) is the middle of the first one's front bumper in the world
    frame; `gap_m` leads from bumper to bumper.
    """
    yaw = np.radians(yaw_deg)
    backwards = -np.array([np.cos(yaw), np.sin(yaw)])
    bumper = np.asarray(first_bumper_m, dtype=np.float64)
    row = []
    for actor in actors:
        # From the front bumper to the middle of the box, then on to the next bumper.
        middle = np.append(bumper + 0.5 * actor.length_m * backwards, 0.0)
        row.append(
            PlacedActor(actor=actor, pose=Pose(position_m=middle, yaw_deg=yaw_deg))
        )
        bumper = bumper + (actor.length_m + gap_m) * backwards
    return tuple(row)


# ---------- bodies of vehicles in files of traffic
_SIZES = ("length_m", "width_m", "height_m")


def read_body(entry: Table, where: str) -> Actor:
    """Body of a vehicle, from the catalogue or as a box.

    A table has `actor`, or `name`, `length_m`, `width_m` and `height_m`. A box
    reaches down to the road. Raises InputError for any other key, or a body of the
    catalogue that is no vehicle.
    """
    known = ("actor",) if "actor" in entry else ("name", *_SIZES)
    for key in entry:
        check_one_of(where, key, known)
    if "actor" in entry:
        actor = pick_actor(take_text(entry, "actor", where), f"{where}.actor")
        if actor.class_name != "parked vehicle":
            raise InputError(f"{where}.actor", actor.name, "a parked vehicle")
        return actor
    sizes_m = {key: take_number(entry, key, where) for key in _SIZES}
    name = take_text(entry, "name", where)
    with located(f"{where}: "):
        shapes = (box_shape(**sizes_m),)
        return Actor(name=name, class_name="parked vehicle", **sizes_m, shapes=shapes)
