"""Objects beside and on the roads: what hides things, what could carry sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from ...errors import InputError, Unquoted
from ..model import POLE_KINDS, Pole, Thing
from .attributes import numbered, take_number_or
from .bodies import build_body
from .copies import Copy, Sweep, place, read_outlines, read_places
from .crosswalks import crosswalk_line
from .kinds import object_kind
from .omissions import Omissions
from .parking import Space, read_space
from .roads import Road

_MAX_PLACES = 100_000  # of all objects of a file
_MAX_VERTICES = 5_000_000
_CLASSES = {"tree": "vegetation", "obstacle": "wall"}
_NOT_TAKEN = {
    "tunnel": "nothing is known of its walls",
    "bridge": "nothing is known of its parapets and piers",
    "objectReference": "the object itself is taken on the road that has it",
}
_NO_SIZE = "it has no outline, length, width or radius"


@dataclass(frozen=True, slots=True)
class Found:
    """What stands and lies along the roads.

    Attributes
    ----------
    things, poles : list
        As the map has them.
    crosswalks_m : list of (2, 2) float
        Lines on which pedestrians cross. [m]
    spaces : dict of str to list of Space
        Parking spaces by id of the road.
    """

    things: list[Thing] = field(default_factory=list)
    poles: list[Pole] = field(default_factory=list)
    crosswalks_m: list[FloatArray] = field(default_factory=list)
    spaces: dict[str, list[Space]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Object:
    element: Element
    road: Road
    kind: str
    name: str
    where: str


def read_objects(roads: Mapping[str, Road], omissions: Omissions) -> Found:
    """Objects of all roads.

    Parameters
    ----------
    roads : mapping of str to Road
        By id.
    omissions : Omissions
        Where to note what is left out.

    Raises
    ------
    InputError
        A number is missing or not finite, or there is more than can be.
    """
    found = Found()
    n_places = n_vertices = n_counted = 0
    for one in _taken_objects(roads, omissions):
        places = list(islice(read_places(one.element, one.road, one.where), _MAX_PLACES + 1))
        n_places += len(places)
        if not places:
            omissions.add("objects beyond their road's end", one.name, "beyond its road's end")
        if n_places > _MAX_PLACES:
            got = Unquoted(f"more than {_MAX_PLACES:,} objects up to here")
            raise InputError(one.where, got, "a smaller file: cut it out first")
        for index, spot in enumerate(places):
            name = one.name if len(places) == 1 else f"{one.name}/{index}"
            if not _take(one, spot, name, found):
                omissions.add(f"objects ({one.kind}) without size", name, _NO_SIZE)
            n_vertices += sum(len(thing.vertices_m) for thing in found.things[n_counted:])
            n_counted = len(found.things)
            if n_vertices > _MAX_VERTICES:
                got = Unquoted(f"more than {_MAX_VERTICES:,} corners up to here")
                raise InputError(one.where, got, "a smaller file: cut it out first")
    return found


def _taken_objects(roads: Mapping[str, Road], omissions: Omissions) -> "list[_Object]":
    """Objects of a kind that matters; the others are noted."""
    objects = []
    names: dict[str, int] = {}
    for road in roads.values():
        parent = road.element.find("objects")
        for tag, why in _NOT_TAKEN.items():
            for element in () if parent is None else parent.findall(tag):
                name = f"road {road.id} {tag} {element.get('id', '')[:60]}".strip()
                omissions.add(f"{tag}s", name, why)
        if road.element.find("railroad/switch") is not None:
            omissions.add("railroads", f"road {road.id} railroad", "no road users go there")
        for index, (element, _) in enumerate(numbered(parent, "object", road.where)):
            label = f"object {element.get('id', f'[{index}]')[:60]}"
            name = f"road {road.id} {label}"
            names[name] = names.get(name, 0) + 1  # ids need not be unique in what people write
            name = name if names[name] == 1 else f"{name} #{names[name]}"
            kind = object_kind(element)
            if kind is None:
                said = element.get("type", "") or element.get("name", "") or "no type"
                why = "its kind hides nothing and carries nothing"
                omissions.add(f"objects ({said[:40]})", name, why)
                continue
            where = f"{road.where} {label}"
            objects.append(_Object(element=element, road=road, kind=kind, name=name, where=where))
    return objects


def _take(one: _Object, spot: Copy | Sweep, name: str, found: Found) -> bool:
    """Take an object at one of its places; False: it has no size."""
    if one.kind in POLE_KINDS:
        found.poles.append(_build_pole(one, spot, name))
        return True
    outlines = (
        [] if isinstance(spot, Sweep) else read_outlines(one.element, one.road, spot, one.where)
    )
    turn_rad = take_number_or(one.element, "hdg", one.where, 0.0)
    if one.kind == "crosswalk":
        line = crosswalk_line(one.road, spot, outlines, turn_rad)
        if line is not None:
            found.crosswalks_m.append(line)
        return line is not None
    if one.kind == "parking space":
        space = read_space(spot, outlines, turn_rad)
        if space is not None:
            found.spaces.setdefault(one.road.id, []).append(space)
        return space is not None
    try:
        with np.errstate(divide="ignore", invalid="ignore"):  # flags that GEOS leaves behind
            body = build_body(
                one.road, one.kind, spot, outlines, turn_rad=turn_rad, where=one.where
            )
    except InputError:  # its outline surrounds nothing
        return False
    if body is None:
        return False
    (vertices_m, triangles), is_assumed = body
    found.things.append(
        Thing(
            id=name,
            class_name=_CLASSES.get(one.kind, one.kind),
            vertices_m=vertices_m,
            triangles=triangles,
            is_height_assumed=is_assumed,
        )
    )
    return True


def _build_pole(one: _Object, spot: Copy | Sweep, name: str) -> Pole:
    copy = spot.start if isinstance(spot, Sweep) else spot
    foot, _ = place(one.road, copy)
    top_m = 0.0 if copy.height_m is None else copy.z_m + copy.height_m
    return Pole(id=name, kind=one.kind, position_m=foot, height_m=top_m if top_m > 0.0 else None)
