"""Walls and hedges as solids."""

from collections.abc import Iterator

import numpy as np
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import InputError
from ..extrusion import extrude
from ..model import Thing
from .defaults import DEFAULTS
from .elements import Elements, Tags, Way
from .network import known_runs
from .notes import Notes
from .tags import parse_length_m

_KINDS = ("wall", "city_wall", "retaining_wall", "fence", "hedge")


def find_barriers(elements: Elements, positions_m: FloatArray, notes: Notes) -> Iterator[Thing]:
    """Walls, hedges and boarded fences of a file.

    Parameters
    ----------
    elements : Elements
        What the file has.
    positions_m : (n, 2) float
        Of its nodes. [m]
    notes : Notes
        Told of fences, which are seen through, and of what is damaged.

    Yields
    ------
    barrier : Thing
        As high and thick as the map says, or as is usual.
    """
    for way in elements.ways:
        kind = way.tags.get("barrier", "")
        if kind not in _KINDS:
            continue
        element = f"way {way.id}"
        fence = way.tags.get("fence_type", way.tags.get("material", ""))
        if kind == "fence" and fence not in DEFAULTS["barrier"]["opaque_fences"]:
            notes.add("fences", element, "seen through: no fence_type that says otherwise")
            continue
        height_m, is_assumed = _size_m(way.tags, kind, "height", notes, element)
        thickness_m, _ = _size_m(way.tags, kind, "thickness", notes, element)
        for number, footprint in enumerate(_footprints(way, positions_m, thickness_m)):
            try:
                vertices, triangles = extrude(
                    np.asarray(footprint.exterior.coords),
                    bottom_m=0.0,
                    top_m=height_m,
                    holes_m=[np.asarray(ring.coords) for ring in footprint.interiors],
                    where=element,
                )
            except InputError as error:
                notes.add("barriers", element, f"its outline has {error.got}")
                continue
            yield Thing(
                id=f"w{way.id} {kind}" + (f" {number}" if number else ""),
                class_name="vegetation" if kind == "hedge" else "wall",
                vertices_m=vertices,
                triangles=triangles,
                is_height_assumed=is_assumed,
            )


def _footprints(way: Way, positions_m: FloatArray, thickness_m: float) -> Iterator[Polygon]:
    is_area = way.tags.get("area") == "yes" and way.is_closed and (way.rows >= 0).all()
    shapes: list[BaseGeometry] = (
        [Polygon(positions_m[way.rows]).buffer(0.0)]
        if is_area
        else [
            LineString(positions_m[rows]).buffer(
                0.5 * thickness_m, cap_style="flat", join_style="mitre"
            )
            for rows in known_runs(way.rows, positions_m)
        ]
    )
    for shape in shapes:
        for part in getattr(shape, "geoms", [shape]):
            if isinstance(part, Polygon) and not part.is_empty:
                yield part


def _size_m(tags: Tags, kind: str, name: str, notes: Notes, element: str) -> tuple[float, bool]:
    """Height or thickness, and whether nothing says so; in metres."""
    limits = DEFAULTS["barrier"]
    for key in (name, "width") if name == "thickness" else (name, "est_height"):
        if key in tags:
            size_m = parse_length_m(tags[key])
            if size_m is not None and 0.01 <= size_m <= limits[f"max_{name}_m"]:
                return size_m, False
            notes.add("barriers", element, f"{key} makes no sense; the usual one taken")
    return float(limits[kind][f"{name}_m"]), True
