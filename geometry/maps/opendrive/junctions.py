"""OpenDRIVE junctions: records, roads that lead there, and outlines."""

from collections import defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely

from ...arrays import FloatArray
from ...errors import InputError, clean_name, refuse
from ...junction import CARRIAGEWAY_KINDS
from ...lines import along_m, unit
from ...scene import LeadingRoad
from ..source_map import MapJunction, MapLane, Omissions
from .lanes import RoadEnds, SampledSection, lane_kind
from .roads import NO_JUNCTION, Road, RoadLink, load_facts, numbered, take_id

# Over which the direction of a road is taken.
_AHEAD_M = 10.0
# A lane that begins or ends is narrower.
_MIN_LANE_M = 1.0
# A car parked at the corner hides who crosses.
_ARM_KINDS = CARRIAGEWAY_KINDS
# Lanes end within 1.5 m of it; later steps may move it slightly.
_AT_OUTLINE_M = 1.0
# A lane that ends farther off does not end at the junction.
_MAX_REACH_M = 50.0
# Of a lane, which is no part of the junction.
_MOUTH_M = 15.0
# To a lane's end outside: other ends that it passes stay at the outline.
_WAY_WIDTH_M = 1.0
# Hairlines between strips that touch.
_CLOSE_GAPS_M = 0.05
_SIMPLIFY_M = 0.02
# On a grid, overlays of nearly equal edges cannot fail.
_GRID_M = 0.001
_MIN_WIDTH_M = 0.05
_PIECE_POINTS = 40
# Of the surface of one junction.
_MAX_POINTS = 200_000
_MIN_AREA_M2 = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpendriveJunction:
    """Junction as the file has it.

    Attributes
    ----------
    id : str
        Id in the file.
    name : str
        Name in the file; may be empty.
    has_surface : bool
        By its type it has connecting roads.
    incoming : tuple of str
        Ids of the roads that lead to it.
    """

    id: str
    name: str
    has_surface: bool
    incoming: tuple[str, ...]


def read_junction_records(
    root: Element,
    where: str,
    omissions: Omissions,
) -> dict[str, OpendriveJunction]:
    """Junctions of a document, by id; those without surface are noted.

    Parameters
    ----------
    root : Element
        Root element of the document.
    where : str
        File and element at hand, for messages.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    records : dict of str to OpendriveJunction
        In the order of the file.

    Raises
    ------
    InputError
        An id is missing or comes twice.
    """
    found: dict[str, OpendriveJunction] = {}
    without_surface = load_facts()["without_surface"]
    for element, here in numbered(root, "junction", where):
        junction_id = take_id(element, here)
        if junction_id in found:
            raise InputError(f"{here}.id", junction_id, "every id once")
        kind = element.get("type", "default")
        if kind in without_surface:
            name = f"junction {junction_id} ({kind})"
            omissions.add(f"{kind} junctions", name, without_surface[kind])
        roads = [
            connection.get("incomingRoad", "")
            for connection in element.iter("connection")
        ]
        found[junction_id] = OpendriveJunction(
            id=junction_id,
            name=element.get("name", "").strip(),
            has_surface=kind not in without_surface,
            incoming=tuple(dict.fromkeys(road for road in roads if road)),
        )
    return found


def find_road_ends(
    roads: Mapping[str, Road],
    junctions: Mapping[str, OpendriveJunction],
    omissions: Omissions,
) -> dict[str, RoadEnds]:
    """Junctions at both ends of the roads outside junctions, by road.

    They come from the roads' own links, or else from the connecting roads that
    lead to them. Links to missing roads and junctions are noted in `omissions`.

    Parameters
    ----------
    roads : Mapping[str, Road]
        Roads of the file, by id.
    junctions : Mapping[str, OpendriveJunction]
        Junctions of the file, by id.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    ends : dict of str to (str, str)
        Junctions at the start and at the end; empty: none.
    """
    led_to: dict[tuple[str, str], str] = {}
    for road in roads.values():
        if road.junction in junctions:
            for link in (road.before, road.after):
                led_to.setdefault((link.id, link.contact), road.junction)

    def junction_at(road: Road, link: RoadLink, end: str) -> str:
        """Junction that a link leads to, directly or through a road; empty: none."""
        known = {"junction": junctions, "road": roads}.get(link.kind, {})
        if link.kind and link.id not in known:
            name = f"road {road.id}, link to {link.kind[:20]} {link.id[:40]}"
            why = "the file has no such road or junction"
            omissions.add("links to missing roads or junctions", name, why)
        found = led_to.get((road.id, end), "")
        if link.kind == "junction" and link.id in junctions:
            found = link.id
        elif link.kind == "road" and link.id in roads:
            found = roads[link.id].junction
        if found in junctions and junctions[found].has_surface:
            return found
        return ""

    ends: dict[str, RoadEnds] = {}
    for road in roads.values():
        if road.junction == NO_JUNCTION:
            at_start = junction_at(road, road.before, "start")
            at_end = junction_at(road, road.after, "end")
            ends[road.id] = (at_start, at_end)
    return ends


def leading_roads(
    roads: Mapping[str, Road],
    ends: Mapping[str, RoadEnds],
    sampled: Mapping[str, Sequence[SampledSection]],
) -> dict[str, tuple[LeadingRoad, ...]]:
    """Roads that lead to each junction, by its id.

    Parameters
    ----------
    roads : Mapping[str, Road]
        Roads of the file, by id.
    ends : Mapping[str, RoadEnds]
        Junctions at both ends of each road.
    sampled : Mapping[str, Sequence[SampledSection]]
        Sampled lane sections of each road, by its id.

    Returns
    -------
    leading : dict of str to tuple of LeadingRoad
        With the driving lanes recorded at that end.
    """
    found: dict[str, tuple[LeadingRoad, ...]] = defaultdict(tuple)
    for road_id, at in ends.items():
        for junction, is_start in zip(at, (True, False), strict=True):
            section = sampled[road_id][0 if is_start else -1]
            if not junction:
                continue
            lead = _leading_road(roads[road_id], section, is_start)
            if lead is not None:
                found[junction] += (lead,)
    return found


def _leading_road(
    road: Road,
    section: SampledSection,
    is_start: bool,
) -> LeadingRoad | None:
    """Road at one of its ends; None: no driving lane is there.

    Parameters
    ----------
    road : Road
        The road.
    section : SampledSection
        Section at that end.
    is_start : bool
        The road's start is meant.

    Returns
    -------
    lead : LeadingRoad or None
        Its direction is away from the junction to the road.
    """
    # First or last station of the section.
    index = -1
    if is_start:
        index = 0
    driving = [
        lane
        for lane in section.lanes.values()
        if lane_kind(lane.record.type) == "driving"
    ]
    lanes = [lane for lane in driving if float(lane.width_m[index]) >= _MIN_LANE_M]
    if not lanes:
        return None
    records = [lane.record for lane in lanes]
    n_following = sum(
        ((one.number < 0) != road.keeps_left) != one.is_reversed for one in records
    )
    edges_m: list[float] = []
    for lane in lanes:
        edges_m += (float(lane.inner_m[index]), float(lane.outer_m[index]))
    middle_m = 0.5 * (min(edges_m) + max(edges_m))
    ahead_m = min(_AHEAD_M, road.length_m)
    if is_start:
        ends_m = (ahead_m, 0.0)
    else:
        ends_m = (road.length_m - ahead_m, road.length_m)
    away = road.line.at(np.array(ends_m))[0]
    # Along the road, against it.
    n_lanes = (n_following, len(lanes) - n_following)
    return LeadingRoad(
        name=clean_name(road.name or f"road {road.id}"),
        point_m=section.points_m[index, :2] + middle_m * section.left[index],
        direction=unit(away[0] - away[1]),
        lanes_in=n_lanes[is_start],
        lanes_out=n_lanes[not is_start],
    )


# ---------- outlines
def build_junctions(
    records: Mapping[str, OpendriveJunction],
    roads: Mapping[str, Road],
    sampled: Mapping[str, Sequence[SampledSection]],
    lanes: Sequence[MapLane],
    omissions: Omissions,
    where: str,
) -> tuple[list[MapJunction], list[MapLane]]:
    """Junctions with their outlines, and lanes without links to others.

    An outline is that of the union of the driving lanes of the connecting
    roads, without holes; the ends of driving and parking lanes that lead there
    lie on it. Junctions without surface, and lanes that end far from theirs,
    are noted.

    Parameters
    ----------
    records : Mapping[str, OpendriveJunction]
        Junctions of the file, by id.
    roads : Mapping[str, Road]
        Roads of the file, by id.
    sampled : Mapping[str, Sequence[SampledSection]]
        Sampled lane sections of each road, by its id.
    lanes : sequence of MapLane
        Lanes outside junctions.
    omissions : Omissions
        Record of what is left out, and why; entries are added.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    junctions : list of MapJunction
        Those that have a surface.
    lanes : list of MapLane
        Without links to junctions that are left out.

    Raises
    ------
    InputError
        A junction needs too many points.
    """
    members: dict[str, list[str]] = {}
    for road in roads.values():
        members.setdefault(road.junction, []).append(road.id)
    tips = lanes_by_junction(lane for lane in lanes if lane.kind in _ARM_KINDS)
    junctions = []
    apart: set[tuple[str, str]] = set()
    for record in records.values():
        if not record.has_surface:
            continue
        pieces = [
            section for road in members.get(record.id, []) for section in sampled[road]
        ]
        n_points = sum(len(section.s_m) * len(section.lanes) for section in pieces)
        if n_points > _MAX_POINTS:
            got = f"roads of {n_points:,} points"
            refuse(f"{where}: junction {record.id}", got, f"at most {_MAX_POINTS:,}")
        own_tips = tips[record.id]
        # Flags that GEOS leaves behind.
        with np.errstate(divide="ignore", invalid="ignore"):
            surface = _surface(pieces)
            fitted = None
            far: list[MapLane] = []
            if surface is not None:
                fitted, far = fit_outline(surface, own_tips)
        if fitted is None:
            why = "it has no connecting road with a driving lane"
            omissions.add("junctions without surface", f"junction {record.id}", why)
            apart |= {(record.id, lane.id) for lane, _ in own_tips}
            continue
        for lane in far:
            why = (
                f"its outline is more than {_MAX_REACH_M:g} m away: it does not end"
                " there"
            )
            name = f"lane {lane.id} at junction {record.id}"
            omissions.add("lanes that end far from their junction", name, why)
        apart |= {(record.id, lane.id) for lane in far}
        outline = np.asarray(fitted.simplify(_SIMPLIFY_M).exterior.coords)[:-1]
        middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
        points = np.concatenate([section.points_m for section in pieces])
        nearest = np.hypot(*(points[:, :2] - middle).T).argmin()
        streets = [roads[road].name for road in record.incoming if road in roads]
        name = record.name or " / ".join(dict.fromkeys(filter(None, streets)))
        height_m = float(points[nearest, 2])
        junctions.append(
            MapJunction(id=record.id, name=name, outline_m=outline, height_m=height_m)
        )
    return junctions, with_known_junctions(lanes, junctions, apart)


def with_known_junctions(
    lanes: Iterable[MapLane],
    junctions: Sequence[MapJunction],
    apart: Container[tuple[str, str]] = (),
) -> list[MapLane]:
    """Lanes that name no other junctions than the given ones.

    Parameters
    ----------
    lanes : iterable of MapLane
        Lanes of the map.
    junctions : sequence of MapJunction
        Junctions of the map.
    apart : Container[tuple[str, str]]
        Ids of junctions and lanes that lie too far from each other.

    Returns
    -------
    lanes : list of MapLane
        With empty names in place of other junctions.
    """
    there = {junction.id for junction in junctions}

    def known(lane: MapLane, name: str) -> str:
        if name in there and (name, lane.id) not in apart:
            return name
        return ""

    return [
        replace(
            lane,
            from_junction=known(lane, lane.from_junction),
            to_junction=known(lane, lane.to_junction),
        )
        for lane in lanes
    ]


def lanes_by_junction(
    lanes: Iterable[MapLane],
) -> dict[str, list[tuple[MapLane, FloatArray]]]:
    """Lanes at each junction, as lines away from it.

    Parameters
    ----------
    lanes : iterable of MapLane
        Lanes of the map.

    Returns
    -------
    tips : dict of str to list of (MapLane, (n, 2) float)
        By id of the junction. [m]
    """
    tips: dict[str, list[tuple[MapLane, FloatArray]]] = defaultdict(list)
    for lane in lanes:
        line = lane.centreline_m[:, :2]
        tips[lane.from_junction].append((lane, line))
        tips[lane.to_junction].append((lane, line[::-1]))
    return tips


def _surface(sections: Sequence[SampledSection]) -> Any:
    """Largest part of the union of driving lanes, without holes, or None.

    Parameters
    ----------
    sections : sequence of SampledSection
        Sections of the connecting roads.

    Returns
    -------
    surface : Polygon or None
        In metres.
    """
    rings = []
    for section in sections:
        for lane in section.lanes.values():
            if lane_kind(lane.record.type) not in ("driving", "bus"):
                continue
            if not lane.width_m.max() > _MIN_WIDTH_M:
                continue
            inner = section.points_at(lane.inner_m)[:, :2]
            outer = section.points_at(lane.outer_m)[:, :2]
            # In short pieces, so that self-intersections stay cheap to mend.
            for begin in range(0, len(section.s_m) - 1, _PIECE_POINTS):
                end = begin + _PIECE_POINTS + 1
                ring = np.concatenate([inner[begin:end], outer[begin:end][::-1]])
                rings.append(ring)
    if not rings:
        return None
    strips = shapely.make_valid(np.array([shapely.Polygon(ring) for ring in rings]))
    # Strips that only touch in rounded numbers would stay apart.
    wide = shapely.buffer(strips, _CLOSE_GAPS_M, join_style="mitre", cap_style="flat")
    union = shapely.union_all(wide, grid_size=_GRID_M)
    return largest_polygon(union.buffer(-_CLOSE_GAPS_M, join_style="mitre"))


def largest_polygon(shape: Any) -> Any:
    """Largest polygon of a shape with its holes filled; None: it is tiny."""
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    filled = [shapely.Polygon(part.exterior) for part in parts if not part.is_empty]
    largest = max(filled, key=lambda part: part.area, default=None)
    if largest is not None and largest.area > _MIN_AREA_M2:
        return largest
    return None


def fit_outline(
    surface: Any,
    tips: Sequence[tuple[MapLane, FloatArray]],
) -> tuple[Any, list[MapLane]]:
    """Surface whose outline meets the ends of lanes, and lanes too far off.

    Lanes that end inside cut their mouths out of the surface; those that end
    outside extend it by a narrow way.

    Parameters
    ----------
    surface : Any
        Polygon of the junction. [m]
    tips : Sequence[tuple[MapLane, FloatArray]]
        Lanes and their lines away from the junction. [m]

    Returns
    -------
    surface : Polygon
        With the mouths of lanes fitted.
    far : list of MapLane
        Lanes that do not end at the junction.
    """
    # Lanes that end inside: their mouths are no part of the junction.
    inside = []
    for lane, line in tips:
        tip = shapely.Point(line[0])
        if surface.exterior.distance(tip) > _AT_OUTLINE_M and surface.contains(tip):
            n_points = max(
                int(np.searchsorted(along_m(line), _MOUTH_M, side="right")), 2
            )
            mouth = shapely.LineString(line[:n_points])
            inside.append(mouth.buffer(0.5 * lane.width_m, cap_style="flat"))
    if inside:
        mouths = shapely.union_all(inside, grid_size=_GRID_M)
        rest = largest_polygon(shapely.difference(surface, mouths, grid_size=_GRID_M))
        if rest is not None:
            surface = rest
    # Lanes that end outside: a narrow way leads to each of them.
    far = []
    ways = []
    for lane, line in tips:
        tip = shapely.Point(line[0])
        distance_m = surface.exterior.distance(tip)
        if distance_m > _MAX_REACH_M:
            far.append(lane)
        elif distance_m > _AT_OUTLINE_M and not surface.contains(tip):
            way = np.asarray(shapely.shortest_line(tip, surface).coords)
            way[1] += (way[1] - way[0]) / np.hypot(*(way[1] - way[0])) * _WAY_WIDTH_M
            ways.append(
                shapely.LineString(way).buffer(0.5 * _WAY_WIDTH_M, cap_style="flat")
            )
    if ways:
        surface = largest_polygon(
            shapely.union_all([surface, *ways], grid_size=_GRID_M)
        )
    return surface, far
