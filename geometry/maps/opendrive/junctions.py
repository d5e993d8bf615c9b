"""Junctions: which a file has, and which roads begin and end at them."""

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from ...errors import InputError
from .attributes import numbered, take_id
from .lanes import RoadEnds
from .omissions import Omissions
from .roads import NO_JUNCTION, Road, RoadLink

_WITHOUT_SURFACE = {
    "direct": "its roads join without connecting roads: it has no surface of its own",
    "virtual": "it lies on a road that goes on: no lane ends at it",
    "crossing": "its roads cross without a way from one to the other",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JunctionRecord:
    """A junction as the file has it.

    Attributes
    ----------
    id, name : str
        Of the file.
    has_surface : bool
        It has connecting roads, by its type.
    incoming : tuple of str
        Ids of the roads that lead to it.
    element : Element
        For what else it has.
    """

    id: str
    name: str
    has_surface: bool
    incoming: tuple[str, ...]
    element: Element


def read_junction_records(
    root: Element, where: str, omissions: Omissions
) -> dict[str, JunctionRecord]:
    """Junctions of a document, by id.

    Raises
    ------
    InputError
        One has no id, or that of another.
    """
    found: dict[str, JunctionRecord] = {}
    for element, here in numbered(root, "junction", where):
        junction_id = take_id(element, here)
        if junction_id in found:
            raise InputError(f"{here}.id", junction_id, "every id once")
        kind = element.get("type", "default")
        if kind in _WITHOUT_SURFACE:
            omissions.add(
                f"{kind} junctions", f"junction {junction_id} ({kind})", _WITHOUT_SURFACE[kind]
            )
        roads = [connection.get("incomingRoad", "") for connection in element.iter("connection")]
        found[junction_id] = JunctionRecord(
            id=junction_id,
            name=element.get("name", "").strip(),
            has_surface=kind not in _WITHOUT_SURFACE,
            incoming=tuple(dict.fromkeys(road for road in roads if road)),
            element=element,
        )
    return found


def find_road_ends(
    roads: Mapping[str, Road], junctions: Mapping[str, JunctionRecord], omissions: Omissions
) -> dict[str, RoadEnds]:
    """Junctions at both ends of the roads that are no connecting ones, by id of the road.

    From the roads' own links; where one has none, from the connecting roads that lead to it. Links
    to what there is not are noted in `omissions`.
    """
    led_to: dict[tuple[str, str], str] = {}
    for road in roads.values():
        if road.junction in junctions:
            for link in (road.before, road.after):
                led_to.setdefault((link.id, link.contact), road.junction)

    def junction_at(road: Road, link: RoadLink, end: str) -> str:
        known = {"junction": junctions, "road": roads}.get(link.kind, {})
        if link.kind and link.id not in known:
            omissions.add(
                "links to what there is not",
                f"road {road.id}, link to {link.kind[:20]} {link.id[:40]}",
                "the file has no such road or junction",
            )
        found = led_to.get((road.id, end), "")
        if link.kind == "junction" and link.id in junctions:
            found = link.id
        elif link.kind == "road" and link.id in roads:
            found = roads[link.id].junction
        return found if found in junctions and junctions[found].has_surface else ""

    return {
        road.id: RoadEnds(
            start=junction_at(road, road.before, "start"), end=junction_at(road, road.after, "end")
        )
        for road in roads.values()
        if road.junction == NO_JUNCTION
    }


def junction_name(record: JunctionRecord, roads: Mapping[str, Road]) -> str:
    """Its own name, or those of the streets that meet there."""
    if record.name:
        return record.name
    names = [roads[road].name for road in record.incoming if road in roads]
    return " / ".join(dict.fromkeys(name for name in names if name))
