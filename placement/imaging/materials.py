"""What surfaces send back, from ``data/materials.toml``, and the parts of a picture they fill."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from geometry.arrays import float_array
from geometry.errors import InputError
from geometry.raycast import FloatRays
from geometry.toml_files import Table, load_toml, take, take_number

from .mesh import Index, Thing

_WHERE = "materials.toml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Materials:
    """Albedos, paints and patterns.

    Attributes
    ----------
    albedo : mapping of (3,) float32
        Share of light sent back, by surface; linear red, green, blue.
    clothes : mapping of (2, 3) float32
        Albedo of top and legs, by body.
    vut_paint, parked_paints : (3,) and (n, 3) float32
        Albedo of vehicles.
    markings, pattern, gloss : mapping of float
        See the file.
    lit_window_colour : (3,) float32
        Linear red, green, blue.
    """

    albedo: Mapping[str, FloatRays]
    clothes: Mapping[str, FloatRays]
    vut_paint: FloatRays
    parked_paints: FloatRays
    markings: Mapping[str, float]
    pattern: Mapping[str, float]
    gloss: Mapping[str, float]
    lit_window_colour: FloatRays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hits:
    """Where rays have met triangles.

    Attributes
    ----------
    points_m : (n, 3) float32
        World frame. [m]
    normals : (n, 3) float32
        Unit, on the side from which the ray came.
    thing : (n,) int32
        Index of the thing.
    distance_m : (n,) float32
        From the camera. [m]
    pixel_m : (n,) float32
        Size of a pixel on the surface, the mean of its two sides. [m]
    """

    points_m: FloatRays
    normals: FloatRays
    thing: Index
    distance_m: FloatRays
    pixel_m: FloatRays

    def take(self, index: Any) -> "Hits":
        """Keep some, by index."""
        return Hits(
            points_m=self.points_m.take(index, axis=0),
            normals=self.normals.take(index, axis=0),
            thing=self.thing.take(index),
            distance_m=self.distance_m.take(index),
            pixel_m=self.pixel_m.take(index),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coat:
    """What surfaces do with light; written to in parts.

    Attributes
    ----------
    albedo : (n, 3) float32
        Share sent back evenly into all directions.
    mirror : (n,) float32
        Share mirrored head-on; 0: dull.
    rough : (n,) float32
        By how much a mirrored ray of unit length is bent up or down.
    glow : (n, 3) float32
        Luminance of its own. [cd/m^2]
    """

    albedo: FloatRays
    mirror: FloatRays
    rough: FloatRays
    glow: FloatRays


def blank_coat(n_hits: int) -> Coat:
    """A black, dull, dark coat."""
    return Coat(
        albedo=np.zeros((n_hits, 3), dtype=np.float32),
        mirror=np.zeros(n_hits, dtype=np.float32),
        rough=np.zeros(n_hits, dtype=np.float32),
        glow=np.zeros((n_hits, 3), dtype=np.float32),
    )


def cover(distance_m: FloatRays, pixel_m: FloatRays) -> FloatRays:
    """Share of each pixel that lies inside an edge.

    Parameters
    ----------
    distance_m : (n,) float32
        From the edge, negative inside. [m]
    pixel_m : (n,) float32
        Size of a pixel. [m]

    Returns
    -------
    share : (n,) float32
        0 .. 1.
    """
    share: FloatRays = np.clip(np.float32(0.5) - distance_m / pixel_m, 0.0, 1.0)
    return share


def blend(under: FloatRays, over: FloatRays, share: FloatRays) -> None:
    """Lay a colour over others, in place: ``under`` (n, 3), ``over`` (3,) or (n, 3)."""
    under += share[:, None] * (over - under)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Things:
    """Things as arrays, one row each.

    Attributes
    ----------
    middle_m, size_m : (n, 3) float32
        Foot of the middle, world frame; length, width, height. [m]
    ahead : (n, 2) float32
        Cosine and sine of the yaw.
    axles_m : (n, 2) float32
        Front and rear axle ahead of the middle, of vehicles. [m]
    colours : (n, 2, 3) float32
        Albedo of top and legs, or twice the paint.
    mean_albedo : (n, 3) float32
        What a thing looks like in a blurred mirror.
    """

    middle_m: FloatRays
    size_m: FloatRays
    ahead: FloatRays
    axles_m: FloatRays
    colours: FloatRays
    mean_albedo: FloatRays


def build_things(things: tuple[Thing, ...], materials: Materials) -> Things:
    """Lay things out as arrays; parked vehicles take the paints in turn."""
    yaw = np.radians([thing.pose.yaw_deg for thing in things])
    colours = np.stack([_colours(n, thing, materials) for n, thing in enumerate(things)])
    return Things(
        middle_m=np.array([thing.pose.position_m for thing in things], dtype=np.float32),
        size_m=np.array([thing.size_m for thing in things], dtype=np.float32),
        ahead=np.stack([np.cos(yaw), np.sin(yaw)], axis=1).astype(np.float32),
        axles_m=np.array([_axles(thing) for thing in things], dtype=np.float32),
        colours=colours,
        mean_albedo=colours.mean(axis=1),
    )


def _axles(thing: Thing) -> tuple[float, float]:
    if thing.actor is not None and thing.actor.wheelbase_m > 0.0:
        front_m = thing.actor.front_axle_ahead_m
        return front_m, front_m - thing.actor.wheelbase_m
    return 0.3 * float(thing.size_m[0]), -0.3 * float(thing.size_m[0])


def _colours(number: int, thing: Thing, materials: Materials) -> FloatRays:
    if thing.name == "vut":
        return np.stack([materials.vut_paint] * 2)
    if thing.class_name in ("parked vehicle", "vehicle"):
        return np.stack([materials.parked_paints[number % len(materials.parked_paints)]] * 2)
    if thing.class_name in ("pedestrian", "cyclist"):
        name = thing.actor.name if thing.actor is not None else ""
        fallback = "cyclist" if thing.class_name == "cyclist" else "adult"
        return materials.clothes.get(name, materials.clothes[fallback])
    surface = {"ground": "asphalt", "building": "facade"}.get(thing.class_name, thing.class_name)
    return np.stack([materials.albedo[surface.replace(" ", "-")]] * 2)


@cache
def load_materials() -> Materials:
    """All materials, from ``data/materials.toml``."""
    table = load_toml(files(__package__) / "data" / _WHERE)
    surfaces = take(table, "surfaces", _WHERE)
    paints = take(table, "paints", _WHERE)
    pattern = dict(take(table, "pattern", _WHERE))
    colour = pattern.pop("lit_window_colour", None)
    return Materials(
        albedo={
            name: _albedo(take(entry, "albedo", f"{_WHERE}: {name}"), (3,), name)
            for name, entry in surfaces.items()
        },
        clothes={
            name: _albedo([entry["top"], entry["legs"]], (2, 3), f"clothes.{name}")
            for name, entry in take(table, "clothes", _WHERE).items()
        },
        vut_paint=_albedo(take(paints, "vut", _WHERE), (3,), "paints.vut"),
        parked_paints=_albedo(take(paints, "parked", _WHERE), (-1, 3), "paints.parked"),
        markings=_numbers(take(table, "markings", _WHERE), "markings"),
        pattern=_numbers(pattern, "pattern"),
        gloss=_numbers(take(table, "gloss", _WHERE), "gloss"),
        lit_window_colour=_albedo(colour, (3,), "pattern.lit_window_colour"),
    )


def _albedo(values: Any, shape: tuple[int, ...], name: str) -> FloatRays:
    where = f"{_WHERE}: {name}"
    array = float_array(values, shape, where).astype(np.float32)
    if not ((array >= 0.0) & (array <= 1.0)).all():
        raise InputError(where, values, "shares, 0 .. 1")
    return array


def _numbers(table: Table, name: str) -> dict[str, float]:
    return {key: take_number(table, key, f"{_WHERE}: {name}") for key in table}
