"""Buildings and their parts as solids."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np
import shapely
from shapely import Polygon, STRtree, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import InputError
from ..extrusion import extrude
from ..model import Thing
from .defaults import DEFAULTS
from .elements import Elements, Tags
from .notes import Notes
from .rings import Area, find_areas
from .tags import is_yes, parse_length_m, parse_number

_ON_STILTS = ("roof", "carport", "canopy")
_NOT_THERE = ("no", "construction", "proposed", "demolished", "razed", "collapsed")


def find_buildings(elements: Elements, positions_m: FloatArray, notes: Notes) -> Iterator[Thing]:
    """Buildings of a file.

    Parameters
    ----------
    elements : Elements
        What the file has.
    positions_m : (n, 2) float
        Of its nodes. [m]
    notes : Notes
        Told of buildings that are left out, and why.

    Yields
    ------
    building : Thing
        A prism from the ground, or from where the map says that it begins. A building with parts
        that cover it is its parts; where they do not, the rest of it stands too.
    """
    areas = [
        area
        for area in find_areas(elements, positions_m, ("building", "building:part"), notes)
        if _stands(area, notes)
    ]
    parts = [area for area in areas if is_yes(area.tags.get("building:part"))]
    part_ids = {area.id for area in parts}
    outlines = [area for area in areas if area.id not in part_ids]
    rests = _without_parts(outlines, parts)
    for area in parts:
        if not _is_on_stilts(area.tags) or _bottom_m(area.tags) > 0.0:
            yield from _solid(area, notes)
        else:
            notes.add("roofs", _element(area), "a roof on stilts of unknown height")
    for area, rest in zip(outlines, rests, strict=True):
        if _is_on_stilts(area.tags) and _bottom_m(area.tags) <= 0.0:
            notes.add("roofs", _element(area), "a roof on stilts of unknown height")
        elif rest is None:
            yield from _solid(area, notes)
        else:
            for number, piece in enumerate(rest):
                name = f"{area.id} beside its parts" + (f" {number}" if number else "")
                yield from _solid(
                    Area(
                        id=name,
                        tags=area.tags,
                        outer_m=np.asarray(piece.exterior.coords),
                        holes_m=tuple(np.asarray(hole.coords) for hole in piece.interiors),
                    ),
                    notes,
                )


def _element(area: Area) -> str:
    kind = "relation" if area.id.startswith("r") else "way"
    return f"{kind} {area.id[1:].partition('.')[0]}"


def _stands(area: Area, notes: Notes) -> bool:
    """It is there, above the ground, and something to look at."""
    tags = area.tags
    kinds = [tags[key] for key in ("building", "building:part") if key in tags]
    if all(kind == "no" for kind in kinds):
        return False
    if any(kind in _NOT_THERE for kind in kinds):
        notes.add("buildings", _element(area), "not built yet, or no longer there")
        return False
    if tags.get("location") == "underground" or tags.get("layer", "0").startswith("-"):
        notes.add("buildings", _element(area), "below the ground")
        return False
    return True


def _is_on_stilts(tags: Tags) -> bool:
    return tags.get("building:part", tags.get("building")) in _ON_STILTS


def _without_parts(outlines: Sequence[Area], parts: Sequence[Area]) -> list[list[Polygon] | None]:
    """What of each outline no part covers; None: it has none."""
    rests: list[list[Polygon] | None] = [None] * len(outlines)
    if not outlines or not parts:
        return rests
    shapes = [make_valid(area.polygon) for area in outlines]
    part_shapes = [make_valid(area.polygon) for area in parts]
    tree = STRtree(shapes)
    inside = tree.query(
        [shapely.point_on_surface(shape) for shape in part_shapes], predicate="within"
    )
    by_outline: dict[int, list[int]] = defaultdict(list)
    for part, outline in inside.T.tolist():
        by_outline[outline].append(part)
    least = DEFAULTS["building"]["parts_cover"]
    for outline, members in by_outline.items():
        covered = shapely.union_all([part_shapes[member] for member in members])
        rest = shapes[outline].difference(covered)
        is_covered = rest.area <= (1.0 - least) * shapes[outline].area
        rests[outline] = [] if is_covered else list(_polygons(rest))
    return rests


def _polygons(shape: BaseGeometry) -> Iterator[Polygon]:
    for part in getattr(shape, "geoms", [shape]):
        if isinstance(part, Polygon) and part.area > 1.0:
            yield part


def _solid(area: Area, notes: Notes) -> Iterator[Thing]:
    top_m, is_assumed = _top_m(area, notes)
    bottom_m = _bottom_m(area.tags)
    if bottom_m >= top_m:
        if not is_assumed:
            notes.add("buildings", _element(area), "its roof is not above its floor")
            return
        top_m = bottom_m + DEFAULTS["building"]["storey_height_m"]
    try:
        vertices, triangles = extrude(
            area.outer_m,
            bottom_m=bottom_m,
            top_m=top_m,
            holes_m=area.holes_m,
            where=_element(area),
        )
    except InputError as error:
        notes.add("buildings", _element(area), f"its outline has {error.got}")
        return
    yield Thing(
        id=area.id,
        class_name="building",
        vertices_m=vertices,
        triangles=triangles,
        is_height_assumed=is_assumed,
    )


def _top_m(area: Area, notes: Notes) -> tuple[float, bool]:
    """Height of the roof, and whether nothing says so; in metres."""
    tags, usual = area.tags, DEFAULTS["building"]
    for key in ("height", "building:height", "est_height"):
        if key in tags:
            height_m = parse_length_m(tags[key])
            if height_m is not None and 0.0 < height_m <= usual["max_height_m"]:
                return height_m, False
            notes.add("buildings", _element(area), f"{key} makes no sense; the next best taken")
    storey_m = usual["storey_height_m"]
    levels = _levels(tags, "building:levels")
    roof_m = parse_length_m(tags["roof:height"]) if "roof:height" in tags else None
    if roof_m is None or roof_m > usual["max_height_m"]:
        roof_m = storey_m * (_levels(tags, "roof:levels") or 0.0)
    if levels is not None and storey_m * levels + roof_m > 0.0:
        return storey_m * levels + roof_m, False
    kind = tags.get("building:part", "yes")
    kind = tags.get("building", "yes") if kind == "yes" else kind
    return usual["default_heights_m"].get(kind, usual["default_height_m"]), True


def _bottom_m(tags: Tags) -> float:
    """Height of the floor, in metres."""
    usual = DEFAULTS["building"]
    for key in ("min_height", "building:min_height"):
        height_m = parse_length_m(tags[key]) if key in tags else None
        if height_m is not None and height_m <= usual["max_height_m"]:
            return height_m
    for key in ("building:min_level", "min_level"):
        level = _levels(tags, key)
        if level is not None:
            return float(usual["storey_height_m"] * level)
    return 0.0


def _levels(tags: Tags, key: str) -> float | None:
    return (
        parse_number(tags[key], highest=DEFAULTS["building"]["max_levels"]) if key in tags else None
    )
