"""Maps in ASAM OpenDRIVE 1.4 to 1.8."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import InputError, refuse
from ...xml_files import local_name, read_xml
from ..circles import with_roundabouts
from ..source_map import MapJunction, MapLane, Omissions, SourceMap
from .junctions import (
    build_junctions,
    find_road_ends,
    leading_roads,
    read_junction_records,
)
from .lanes import (
    MAX_POINTS,
    SampledSection,
    build_lanes,
    connecting_lanes,
    join_stubs,
    sample_road,
)
from .objects import build_rows, merge_poles, read_objects, read_signals
from .roads import (
    NO_JUNCTION,
    Offset,
    Road,
    RoadLink,
    numbered,
    read_crs,
    read_links,
    read_offset,
    read_road,
    take_id,
    take_number,
)

__all__ = ["read_opendrive"]
# A road that is shorter is but a joint between its neighbours.
_JOINED_M = 1.0e-3


def read_opendrive(path: Path) -> SourceMap:
    """Read a file in ASAM OpenDRIVE 1.4 to 1.8.

    Roads outside junctions become lanes in driving direction, connecting roads
    lanes through their junctions, whose outlines are those of these roads'
    surface; objects and signals become things, poles, crosswalks and parking
    lanes. Heights are absolute; across, roads have their superelevation and
    shape.

    Raises
    ------
    InputError
        The file cannot be read, is no OpenDRIVE, has no roads, lacks a number
        or has one out of range, or needs too many points.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.8.1, and 1.4 to 1.7 for features that were dropped.
    """
    where = path.name
    root = read_xml(path, expected="OpenDRIVE")
    for element in root.iter():
        element.tag = local_name(element)
    if root.tag != "OpenDRIVE":
        refuse(where, f"a document <{root.tag[:40]}>", "<OpenDRIVE>")
    omissions = Omissions()
    crs, source_crs = read_crs(root, omissions)
    offset = read_offset(root, where)
    roads = _read_roads(root, where, offset, omissions)
    sampled = _sample(roads)
    records = read_junction_records(root, where, omissions)
    ends = find_road_ends(roads, records, omissions)
    outside = [road for road in roads.values() if road.junction == NO_JUNCTION]
    pieces = (build_lanes(road, sampled[road.id], ends[road.id]) for road in outside)
    lanes = join_stubs([*chain.from_iterable(pieces)])
    junctions, lanes = build_junctions(records, roads, sampled, lanes, omissions, where)
    leading = leading_roads(roads, ends, sampled)
    junctions = [replace(one, roads=leading.get(one.id, ())) for one in junctions]
    connections = _connections(roads, junctions, where)
    for one in junctions:
        arms = [roads[name] for name, at in ends.items() if one.id in at]
        # Cars are led on through it.
        if arms and all(road.is_motorway for road in arms):
            why = "motorways merge or part where nobody walks"
            omissions.add("junctions", f"junction {one.id}", why)
            junctions = [other for other in junctions if other is not one]
    found = read_objects(roads, omissions)
    for road_id, spaces in found.spaces.items():
        lanes += build_rows(roads[road_id], spaces)
    poles, painted = read_signals(roads, sampled, omissions)
    crosswalks = [*found.crosswalks_m, *painted]
    for element in root.iter("include"):
        name = f"include {element.get('file', '')[:80]}"
        omissions.add("included files", name, "other files are not read")
    surfaces_m = []
    for sections in sampled.values():
        surfaces_m += [section.surface_m() for section in sections]
    n_left = sum(road.keeps_left for road in roads.values())
    if 0 < n_left < len(roads):
        name = f"rule of {min(n_left, len(roads) - n_left)} of {len(roads)} roads"
        omissions.add(
            "rules",
            name,
            "traffic in a map keeps one side: that of most roads",
        )
    source = SourceMap(
        name=where,
        crs=crs,
        source_crs=source_crs,
        heights="absolute",
        lanes=tuple(lanes),
        connections=connections,
        junctions=tuple(junctions),
        things=tuple(found.things),
        poles=tuple(merge_poles([*found.poles, *poles])),
        crosswalks_m=np.array(crosswalks).reshape(-1, 2, 2),
        keeps_left=2 * n_left > len(roads),
        ground_m=np.concatenate(surfaces_m),
        skipped=omissions.listed(),
    )
    return with_roundabouts(source)


def _read_roads(
    root: Element,
    where: str,
    offset: Offset,
    omissions: Omissions,
) -> dict[str, Road]:
    """All roads by id; neighbours of roads without a length are joined.

    Parameters
    ----------
    root : Element
        Root element of the document.
    where : str
        File and element at hand, for messages.
    offset : Offset
        Offset of the file's header.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    roads : dict of str to Road
        Without those that are shorter than a millimetre, which are noted.

    Raises
    ------
    InputError
        There is no road, or an id comes twice.
    """
    roads: dict[str, Road] = {}
    joints: dict[str, tuple[RoadLink, RoadLink]] = {}
    for element, _ in numbered(root, "road", where):
        road_id = take_id(element, f"{where}: road")
        if road_id in roads or road_id in joints:
            raise InputError(f"{where}: road {road_id}.id", road_id, "every id once")
        length_m = take_number(element, "length", f"{where}: road {road_id}")
        if 0.0 < length_m < _JOINED_M:
            joints[road_id] = read_links(element)
            why = f"shorter than {_JOINED_M * 1e3:g} mm: its neighbours are joined"
            omissions.add("roads", f"road {road_id}", why)
        else:
            roads[road_id] = read_road(element, where, offset)
            if element.find("lateralProfile/shape") is not None:
                why = (
                    "roads are taken to be straight across, but for their"
                    " superelevation"
                )
                omissions.add("shapes of cross sections", f"road {road_id} shape", why)
    if not roads:
        refuse(where, "no road", "a document with roads")
    for road_id, road in roads.items():
        before = _beyond(road.before, joints)
        after = _beyond(road.after, joints)
        roads[road_id] = replace(road, before=before, after=after)
    return roads


def _beyond(
    link: RoadLink,
    joints: Mapping[str, tuple[RoadLink, RoadLink]],
) -> RoadLink:
    """What a link leads to, roads without a length passed over.

    Parameters
    ----------
    link : RoadLink
        Link of a road.
    joints : Mapping[str, tuple[RoadLink, RoadLink]]
        Links of the roads without a length, by their ids.

    Returns
    -------
    link : RoadLink
        It leads to a road with a length, a junction or nothing.
    """
    for _ in range(len(joints)):
        if link.kind != "road" or link.id not in joints:
            break
        before, after = joints[link.id]
        # On through the road without a length, to its other end.
        is_at_end = link.contact == "end"
        link = after
        if is_at_end:
            link = before
    return link


def _sample(roads: Mapping[str, Road]) -> dict[str, tuple[SampledSection, ...]]:
    """Sampled sections of all roads, by id; too many points are refused."""
    sampled: dict[str, tuple[SampledSection, ...]] = {}
    n_points = 0
    for road in roads.values():
        sampled[road.id] = sample_road(road)
        n_points += sum(
            len(section.s_m) * (1 + len(section.lanes)) for section in sampled[road.id]
        )
        if n_points > MAX_POINTS:
            got = f"more than {MAX_POINTS:,} points up to here"
            refuse(road.where, got, "a smaller file: cut it out first")
    return sampled


def _connections(
    roads: Mapping[str, Road],
    junctions: Sequence[MapJunction],
    where: str,
) -> tuple[MapLane, ...]:
    """Lanes through the given junctions; too many points are refused."""
    there = {junction.id for junction in junctions}
    found: list[MapLane] = []
    n_points = 0
    for road in roads.values():
        if road.junction not in there:
            continue
        here = connecting_lanes(road)
        found += here
        n_points += sum(len(lane.centreline_m) for lane in here)
        if n_points > MAX_POINTS:
            got = f"more than {n_points:,} points of lanes through junctions"
            refuse(where, got, f"at most {MAX_POINTS:,}")
    return tuple(found)
