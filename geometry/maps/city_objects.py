"""Objects of city models, whatever their encoding."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from .georeferences import georeference
from .solids import Polygon3D, extrude, surface_mesh
from .source_map import Skipped, SourceMap, Thing
from .thing_kinds import kind_from_name, kind_of_class, thing_defaults

MAX_TRIANGLES = 5_000_000
_MAX_SKIPPED = 100

# Of city models: what kind of object is what class of thing.
CLASS_OF_TYPE = {
    "Building": "building",
    "BuildingPart": "building",
    "BuildingInstallation": "building",  # balconies, outer stairs, chimneys
    "BuildingConstructiveElement": "building",
    "OtherConstruction": "wall",  # city walls, sheds, tanks
    "CityFurniture": "wall",  # opaque like one, unless its name says lamp or tree
    "SolitaryVegetationObject": "vegetation",
    "PlantCover": "vegetation",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityObject:
    """One object of a city model, in the file's coordinates."""

    id: str
    type_name: str  # one of CLASS_OF_TYPE
    polygons: tuple[Polygon3D, ...]  # its surfaces, or its footprint
    words: str = ""  # its name and function
    is_footprint: bool = False  # level of detail 0: the polygons are to be raised by height_m
    height_m: float | None = None  # of the top above the footprint, if the file gives it


def city_map(
    objects: Sequence[CityObject],
    *,
    name: str,
    where: str,
    declared_crs: str,
    follows_authority: bool,
    skipped: Sequence[Skipped],
) -> SourceMap:
    """Build a map from the objects of a city model; `skipped` is what the reader has left out.

    Raises InputError if there is no surface, there are more than five million triangles, or
    coordinates are impossible.
    """
    if not any(city_object.polygons for city_object in objects):
        raise InputError(
            where,
            Unquoted("no building, plant or furniture with surfaces"),
            "objects of level of detail 0 to 3" + _said(skipped),
        )
    rings = [ring for item in objects for polygon in item.polygons for ring in polygon]
    points: FloatArray = np.concatenate(rings)
    if not np.isfinite(points).all():
        raise InputError(where, Unquoted("a coordinate that is not finite"), "finite numbers")
    place = georeference(
        points[:, :2], declared_crs, where=where, follows_authority=follows_authority
    )
    points = place.to_metres(points, where)
    starts = np.cumsum([len(ring) for ring in rings])[:-1]
    in_metres = iter(np.split(points, starts))
    things: list[Thing] = []
    flat: list[Skipped] = []
    ids: Counter[str] = Counter()
    n_triangles = 0
    for item in objects:
        polygons = tuple(tuple(next(in_metres) for _ in polygon) for polygon in item.polygons)
        if not polygons:
            continue
        try:
            thing = _thing(replace(item, polygons=polygons), unique_id(item.id, ids))
        except InputError as error:
            flat.append(Skipped(what=f"{item.type_name} {item.id}", why=str(error)))
            continue
        things.append(thing)
        n_triangles += len(thing.triangles)
        if n_triangles > MAX_TRIANGLES:
            raise InputError(
                where, Unquoted(f"more than {MAX_TRIANGLES:,} triangles"), "a part of the city"
            )
    notes = [] if place.note is None else [place.note]
    if not things:
        raise InputError(where, Unquoted("no surface with an area"), "buildings" + _said(flat))
    return SourceMap(
        name=name,
        crs=place.crs,
        source_crs=place.source_crs,
        heights="absolute",
        things=tuple(things),
        skipped=(*notes, *skipped, *shortened(flat)),
    )


def unique_id(wanted: str, taken: Counter[str]) -> str:
    """The wanted id, with a number if it is taken; `taken` then contains it."""
    wanted = wanted[:_MAX_ID] or "unnamed"
    candidate = wanted
    while candidate in taken:
        taken[wanted] += 1
        candidate = f"{wanted}-{taken[wanted]}"
    taken[candidate] += 1
    return candidate


def shortened(skipped: Sequence[Skipped], most: int = _MAX_SKIPPED) -> tuple[Skipped, ...]:
    """The first of many entries, and one that counts the rest."""
    if len(skipped) <= most:
        return tuple(skipped)
    n_more = len(skipped) - most
    return (*skipped[:most], Skipped(what=f"{n_more} more", why="for reasons like these"))


def counted(counts: Counter[str], why: str) -> list[Skipped]:
    """One entry per kind of thing: "3 Bridge"."""
    return [Skipped(what=f"{n} {kind}", why=why) for kind, n in sorted(counts.items())]


_MAX_ID = 120


def _thing(item: CityObject, thing_id: str) -> Thing:
    """One object as triangles; raises InputError if it has no area."""
    class_name = CLASS_OF_TYPE[item.type_name]
    if item.type_name == "CityFurniture":
        kind = kind_from_name(item.words)
        class_name = kind.class_name if kind and kind.class_name != "ground" else class_name
    if not item.is_footprint:
        vertices, triangles = surface_mesh(item.polygons)
        if not len(triangles):
            raise InputError(item.id, Unquoted("surfaces without area"), "polygons")
        return Thing(id=thing_id, class_name=class_name, vertices_m=vertices, triangles=triangles)
    height = item.height_m
    is_assumed = height is None or not 0.0 < height <= thing_defaults().max_height_m
    raised_m = kind_of_class(class_name).height_m if height is None or is_assumed else height
    pieces = []
    for polygon in item.polygons:
        bottom_m = float(polygon[0][:, 2].min())
        pieces.append(
            extrude(
                polygon[0][:, :2],
                bottom_m=bottom_m,
                top_m=bottom_m + raised_m,
                holes_m=[hole[:, :2] for hole in polygon[1:] if len(hole) >= 4],
                where=item.id,
            )
        )
    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    return Thing(
        id=thing_id,
        class_name=class_name,
        vertices_m=np.concatenate([vertices for vertices, _ in pieces]),
        triangles=np.concatenate(
            [triangles + offset for (_, triangles), offset in zip(pieces, first, strict=False)]
        ),
        is_height_assumed=is_assumed,
    )


def _said(skipped: Sequence[Skipped]) -> str:
    """What was left out, for the end of a message."""
    if not skipped:
        return ""
    return "; skipped: " + ", ".join(f"{item.what} ({item.why})" for item in skipped[:5])
