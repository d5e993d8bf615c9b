"""Maps of lanelets, pieces of lanes between a left and a right bound: Lanelet2 and CommonRoad."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..arrays import BoolArray, FloatArray, IntArray
from ..errors import InputError, Unquoted
from ..lines import along_m, apart, length_m, points_at
from ..notes import Note
from ..text_formats import float_of, load_data
from ..xml_files import local_name, read_xml
from .georeferences import WGS84, local_crs, transform
from .opendrive.junctions import (
    fit_outline,
    lanes_by_junction,
    largest_polygon,
    with_known_junctions,
)
from .openstreetmap.elements import Elements, Relation, read_elements
from .source_map import (
    MapJunction,
    MapLane,
    Omissions,
    Pole,
    SourceMap,
    Thing,
    extrude,
    kind_of_class,
    parse_speed_kmh,
)

_WORDS: dict[str, list[str]] = load_data("geometry.maps", "words.toml")["lanelets"]
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words}
# between the end of a lanelet and the beginning of the next one, at both bounds
_JOINED_M = 0.5
_STEP_M = 2.0  # between points of a centreline
_SAME_M = 0.01  # points nearer than this are one
_MIN_OVERLAP_M2 = 2.0  # lanelets that cross, merge or part share more ground
_NOWHERE_DEG = (
    0.5  # around latitude 0, longitude 0, where maps without a place are drawn
)
_BESIDE_M = 25.0  # between lanelets of both directions of a road
_AGAINST = -0.95  # cosine between their directions
_MAX_WAYS = 200  # through one junction from one lane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lanelet:
    """A piece of a lane; both bounds run in its direction."""

    id: str
    kind: str  # of MapLane, or "crosswalk"
    left_m: FloatArray  # (n, 3)
    right_m: FloatArray  # (k, 3)
    is_oneway: bool = True
    speed_limit_kmh: float | None = None
    is_in_junction: bool = False  # the file says so

    @property
    def polygon(self) -> Any:
        """Its ground."""
        ring_m = np.concatenate([self.left_m[:, :2], self.right_m[::-1, :2]])
        return shapely.make_valid(shapely.Polygon(ring_m))

    @property
    def edges_m(self) -> FloatArray:
        """Points of both bounds side by side, (2, m, 3)."""
        bounds = self.left_m, self.right_m
        n_points = max(2, round(max(map(length_m, bounds)) / _STEP_M) + 1)
        ends_m = [along_m(bound)[-1] for bound in bounds]
        at = [np.linspace(0.0, end_m, n_points) for end_m in ends_m]
        return np.array([points_at(*pair) for pair in zip(bounds, at, strict=True)])

    def turned(self) -> "Lanelet":
        """The other way."""
        return replace(
            self, id=f"{self.id}r", left_m=self.right_m[::-1], right_m=self.left_m[::-1]
        )


def _lanelet(
    name: str, left_m: FloatArray, right_m: FloatArray, **known: Any
) -> Lanelet:
    """A lanelet whose bounds are turned so that the left one lies on the left."""
    along = np.hypot(*(left_m[[0, -1], :2] - right_m[[0, -1], :2]).T).sum()
    across = np.hypot(*(left_m[[0, -1], :2] - right_m[[-1, 0], :2]).T).sum()
    if across < along:
        right_m = right_m[::-1]
    ring = shapely.LinearRing(np.concatenate([right_m[:, :2], left_m[::-1, :2]]))
    if not ring.is_ccw:
        left_m = left_m[::-1]
        right_m = right_m[::-1]
    return Lanelet(id=name, left_m=left_m, right_m=right_m, **known)


# ---------- from lanelets to lanes and junctions
def _build(
    lanelets: Sequence[Lanelet], omissions: Omissions
) -> tuple[list[MapLane], list[MapLane], list[MapJunction]]:
    """Lanes between junctions, lanes through them, and the junctions.

    A junction is where lanelets of roads share ground, or what the file says: those
    that touch each other, and those between them.
    """
    roads = _with_right_sides(
        [one for one in lanelets if one.kind == "driving"], omissions
    )
    roads += [one.turned() for one in roads if not one.is_oneway]
    follows = _followers(roads)
    ground = [one.polygon for one in roads]
    one, other = shapely.STRtree(ground).query(ground, predicate="intersects")
    inside = _inside(roads, ground, np.column_stack([one, other]))
    meets = inside[one] & inside[other]
    links = coo_array(
        (np.ones(meets.sum()), (one[meets], other[meets])), shape=(len(roads),) * 2
    )
    label = connected_components(links, directed=False)[1]
    members = [
        np.flatnonzero(inside & (label == at)).tolist()
        for at in np.unique(label[inside])
    ]
    junction_of = {
        one: f"j{number}" for number, some in enumerate(members, 1) for one in some
    }
    paths = [
        _map_lane([one], one.id)
        for one in lanelets
        if one.kind in ("walking", "cycling")
    ]
    lanes = [*_lanes(roads, follows, junction_of), *paths]
    tips_of = lanes_by_junction(lanes)
    junctions = []
    connections = []
    for group in members:
        name = junction_of[group[0]]
        surface = largest_polygon(
            shapely.union_all([ground[one].buffer(0.05) for one in group])
        )
        tips = tips_of[name]
        if surface is None or not tips:
            omissions.add("junctions", f"junction {name}", "no lane leads to it")
            continue
        surface, _ = fit_outline(surface, tips)
        height_m = float(np.mean([roads[one].left_m[:, 2].mean() for one in group]))
        outline_m = np.asarray(surface.exterior.coords)[:-1]
        junctions.append(
            MapJunction(id=name, name="", outline_m=outline_m, height_m=height_m)
        )
        connections += _connections(roads, follows, group, name)
    return with_known_junctions(lanes, junctions), connections, junctions


def _with_right_sides(roads: Sequence[Lanelet], omissions: Omissions) -> list[Lanelet]:
    """Lanelets, turned where they then meet others and do not as they are: a mistake of maps."""
    turned = [replace(one.turned(), id=one.id) for one in roads]
    follows = _followers([*roads, *turned])
    n_roads = len(roads)
    meets = np.zeros(2 * n_roads, dtype=bool)
    for before, others in enumerate(follows):
        for after in others:
            meets[before] |= after < n_roads
            meets[after] |= before < n_roads
    is_wrong = meets[n_roads:] & ~meets[:n_roads]
    for index in np.flatnonzero(is_wrong).tolist():
        why = (
            "its left and right are exchanged: only so it leads from others, or to"
            " others"
        )
        omissions.add(
            "lanelets with exchanged sides", f"lanelet {roads[index].id}", why
        )
    every = zip(roads, turned, is_wrong, strict=True)
    return [other if wrong else one for one, other, wrong in every]


def _followers(lanelets: Sequence[Lanelet]) -> list[list[int]]:
    """Lanelets that begin where each one ends, at both bounds."""
    if not lanelets:
        return []
    begins, ends = (
        np.array([[*one.left_m[at, :2], *one.right_m[at, :2]] for one in lanelets])
        for at in (0, -1)
    )
    found = cKDTree(begins).query_ball_point(ends, _JOINED_M)
    return [[one for one in here if one != index] for index, here in enumerate(found)]


def _inside(
    roads: Sequence[Lanelet], ground: Sequence[Any], pairs: IntArray
) -> BoolArray:
    """Which lanelets lie in a junction, (n,): those that the file says, or that share ground.

    `pairs`, (k, 2), are those whose ground meets.
    """
    inside = np.array([one.is_in_junction for one in roads], dtype=bool)
    if inside.any():
        return inside
    for one, other in pairs[pairs[:, 0] < pairs[:, 1]].tolist():
        if f"{roads[one].id}r" == roads[other].id:
            continue  # the same ground, in both directions
        if shapely.intersection(ground[one], ground[other]).area > _MIN_OVERLAP_M2:
            inside[[one, other]] = True
    return inside


def _lanes(
    roads: Sequence[Lanelet],
    follows: Sequence[Sequence[int]],
    junction_of: Mapping[int, str],
) -> Iterator[MapLane]:
    """Lanes outside junctions: lanelets that follow each other without a choice are one."""
    before: dict[int, list[int]] = {index: [] for index in range(len(roads))}
    for index, others in enumerate(follows):
        for other in others:
            before[other].append(index)

    outside = [index for index in range(len(roads)) if index not in junction_of]
    joints = {
        one: other
        for one in outside
        for other in follows[one]
        if follows[one] == [other]
        and before[other] == [one]
        and other not in junction_of
    }
    done: set[int] = set()
    starts = [one for one in outside if one not in joints.values()]
    for start in [*starts, *outside]:  # then what is left: rings
        if start in done:
            continue
        chain = [start]
        while (following := joints.get(chain[-1], start)) != start:
            chain.append(following)
        done.update(chain)
        ends = (before[start], follows[chain[-1]])
        begin, end = (
            next((junction_of[one] for one in some if one in junction_of), "")
            for some in ends
        )
        pieces = [roads[one] for one in chain]
        yield _map_lane(pieces, roads[start].id, from_junction=begin, to_junction=end)


def _connections(
    roads: Sequence[Lanelet],
    follows: Sequence[Sequence[int]],
    group: Sequence[int],
    name: str,
) -> list[MapLane]:
    """Ways through a junction: from each lanelet that nothing of it leads to, to where it ends."""
    members = set(group)
    onwards = {
        one: [other for other in follows[one] if other in members] for one in group
    }
    led_to = {other for others in onwards.values() for other in others}
    found: list[MapLane] = []
    ways = [[one] for one in group if one not in led_to]
    while ways and len(found) < _MAX_WAYS:
        way = ways.pop()
        further = [other for other in onwards[way[-1]] if other not in way]
        ways += [[*way, other] for other in further]
        if not further:
            chain = [roads[one] for one in way]
            lane_id = "-".join(one.id for one in chain)
            found.append(
                _map_lane(chain, lane_id, from_junction=name, to_junction=name)
            )
    return found


def _map_lane(
    chain: Sequence[Lanelet],
    lane_id: str,
    *,
    from_junction: str = "",
    to_junction: str = "",
) -> MapLane:
    edges_m = np.concatenate([one.edges_m for one in chain], axis=1)
    middle_m = edges_m.mean(axis=0)
    limits = [one.speed_limit_kmh for one in chain if one.speed_limit_kmh is not None]
    return MapLane(
        id=lane_id,
        kind=chain[0].kind,
        width_m=float(np.hypot(*(edges_m[0] - edges_m[1])[:, :2].T).mean()),
        centreline_m=apart(middle_m, _SAME_M),
        speed_limit_kmh=limits[-1] if limits else None,
        from_junction=from_junction,
        to_junction=to_junction,
    )


def _keeps_left(roads: Sequence[Lanelet]) -> bool | None:
    """The side, by lanelets beside others that run against them; None: none do."""
    edges_m = [one.edges_m.mean(axis=0)[:, :2] for one in roads]
    middle_m = np.array([line[len(line) // 2] for line in edges_m]).reshape(-1, 2)
    ahead = np.array([line[-1] - line[0] for line in edges_m]).reshape(-1, 2)
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    votes = 0
    for one, other in cKDTree(middle_m).query_pairs(_BESIDE_M):
        apart_m = middle_m[other] - middle_m[one]
        is_beside = abs(apart_m @ ahead[one]) < abs(_cross(ahead[one], apart_m))
        if is_beside and ahead[one] @ ahead[other] < _AGAINST:
            if _cross(ahead[one], apart_m) < 0.0:
                votes += 1
            else:
                votes += -1
    if votes:
        return votes > 0
    return None


def _cross(one: FloatArray, other: FloatArray) -> float:
    return float(one[0] * other[1] - one[1] * other[0])


def _source_map(
    path: Path,
    lanelets: Sequence[Lanelet],
    omissions: Omissions,
    *,
    keeps_left: bool | None,
    **known: Any,
) -> SourceMap:
    if not any(one.kind == "driving" for one in lanelets):
        raise InputError(str(path), Unquoted("no lanelet for cars"), "a map with roads")
    lanes, connections, junctions = _build(lanelets, omissions)
    notes = omissions.listed()
    if keeps_left is None:
        keeps_left = _keeps_left([one for one in lanelets if one.kind == "driving"])
    if keeps_left is None:
        why = "no lanelets side by side show it: taken to keep right"
        notes = (
            Note(what="side of the road", why=why, kind="side of the road"),
            *notes,
        )
    walks = [one for one in lanelets if one.kind == "crosswalk"]
    crossings = [one.edges_m.mean(axis=0)[[0, -1], :2] for one in walks]
    return SourceMap(
        name=path.name,
        lanes=tuple(lanes),
        connections=tuple(connections),
        junctions=tuple(junctions),
        crosswalks_m=np.array(crossings).reshape(-1, 2, 2),
        keeps_left=bool(keeps_left),
        skipped=notes,
        **known,
    )


# ---------- Lanelet2
def read_lanelet2(path: Path, *, keeps_left: bool | None = None) -> SourceMap:
    """Read a Lanelet2 map: OpenStreetMap XML with relations of type lanelet.

    Lanelets of roads become lanes and junctions, crosswalks, walkways and bicycle lanes
    theirs, traffic lights and signs poles, areas of buildings things. Positions are
    those of ``local_x`` and ``local_y`` where nodes have them, else latitude and
    longitude, in metres around the middle; a map around 0, 0 has no place on earth.
    `keeps_left`: by default what neighbours show.

    Raises InputError if the file cannot be read, or has no lanelet for cars.

    References
    ----------
    .. [1] F. Poggenhans et al., "Lanelet2: A high-definition map framework", ITSC 2018,
       and
       ``lanelet2_core/doc/LaneletPrimitives.md`` in its repository.
    """
    elements = read_elements(path)
    omissions = Omissions()
    points_m, crs, has_heights = _positions(elements, path)
    ways = {way.id: points_m[way.rows[way.rows >= 0]] for way in elements.ways}
    lanelets = []
    for relation in elements.relations:
        if relation.tags.get("type") == "lanelet":
            name = f"lanelet {relation.id}"
            bounds = [_bound(relation, side, ways) for side in ("left", "right")]
            kind = _KINDS.get(relation.tags.get("subtype", ""), "")
            if not kind:
                why = "no lane of cars, bicycles or people on the ground"
                omissions.add("lanelets of other kinds", name, why)
            elif any(len(bound) < 2 for bound in bounds):
                omissions.add(
                    "lanelets without bounds", name, "a bound is missing, or in pieces"
                )
            else:
                lanelets.append(
                    _lanelet(
                        str(relation.id),
                        *bounds,
                        kind=kind,
                        is_oneway=relation.tags.get("one_way", "yes") != "no",
                        speed_limit_kmh=parse_speed_kmh(
                            relation.tags.get("speed_limit", "")
                        ),
                        is_in_junction="turn_direction" in relation.tags,
                    )
                )
    return _source_map(
        path,
        lanelets,
        omissions,
        keeps_left=keeps_left,
        crs=crs,
        source_crs=WGS84 if crs else "",
        heights="absolute" if has_heights else "above ground",
        poles=tuple(_poles(elements, ways)),
        things=tuple(_buildings(elements, ways, omissions)),
        ground_m=(
            np.concatenate([one.edges_m.reshape(-1, 3) for one in lanelets])
            if has_heights and lanelets
            else np.empty((0, 3))
        ),
    )


def _positions(elements: Elements, path: Path) -> tuple[FloatArray, str, bool]:
    """Places of all nodes in metres, (n, 3), their CRS, and whether they have heights."""
    tags = [elements.node_tags.get(row, {}) for row in range(len(elements.node_ids))]
    if not tags:
        raise InputError(str(path), Unquoted("no nodes"), "a map with lanelets")
    heights = np.array([float_of(some.get("ele", "")) for some in tags])
    height_m = np.nan_to_num(heights)
    local = np.array(
        [[float_of(some.get(f"local_{axis}", "")) for axis in "xy"] for some in tags]
    )
    if np.isfinite(local).all():
        return np.column_stack([local, height_m]), "", bool(np.isfinite(heights).any())
    middle_deg = np.median(elements.lon_lat_deg, axis=0)
    crs = local_crs(middle_deg, WGS84, where=str(path))
    plane_m = transform(elements.lon_lat_deg, WGS84, crs)
    is_nowhere = bool((np.abs(middle_deg) < _NOWHERE_DEG).all())
    found = np.column_stack([plane_m, height_m])
    return found, "" if is_nowhere else crs, bool(np.isfinite(heights).any())


def _bound(relation: Relation, side: str, ways: Mapping[int, FloatArray]) -> FloatArray:
    """The lines of a side one after the other; empty where they do not meet."""
    parts = [
        ways[ref] for ref, role in relation.members if role == side and ref in ways
    ]
    if parts:
        line = parts.pop(0)
    else:
        line = np.empty((0, 3))
    for part in parts:
        for first, second in (
            (line, part),
            (line, part[::-1]),
            (line[::-1], part),
            (part, line),
        ):
            if len(first) and len(second) and np.array_equal(first[-1], second[0]):
                line = np.concatenate([first, second[1:]])
                break
        else:
            return np.empty((0, 3))
    return line


def _poles(elements: Elements, ways: Mapping[int, FloatArray]) -> Iterator[Pole]:
    kinds = {"traffic_light": "traffic light", "traffic_sign": "sign"}
    for way in elements.ways:
        kind = kinds.get(way.tags.get("type", ""))
        if kind and len(ways[way.id]):
            yield Pole(id=f"w{way.id}", kind=kind, position_m=ways[way.id].mean(axis=0))


def _buildings(
    elements: Elements, ways: Mapping[int, FloatArray], omissions: Omissions
) -> Iterator[Thing]:
    for relation in elements.relations:
        subtype = relation.tags.get("subtype", "")
        if relation.tags.get("type") != "multipolygon":
            continue
        outline_m = _bound(relation, "outer", ways)
        name = f"area {relation.id}"
        if subtype != "building":
            kind = f"areas of {subtype or 'other kinds'}"
            omissions.add(kind, name, "nothing that hides anybody")
        elif len(outline_m) < 3:
            omissions.add("outlines", name, "it is not closed, or misses nodes")
        else:
            bottom_m = float(outline_m[:, 2].min())
            top_m = bottom_m + kind_of_class("building").height_m
            mesh = extrude(outline_m[:, :2], bottom_m=bottom_m, top_m=top_m, where=name)
            yield Thing.of(f"r{relation.id}", "building", mesh, is_height_assumed=True)


# ---------- CommonRoad
def read_commonroad(path: Path, *, keeps_left: bool | None = None) -> SourceMap:
    """Read the lanelets of a CommonRoad scenario, XML of version 2018b or 2020a, in its own metres.

    Its traffic lights and signs become poles; its obstacles are left out: they drive in
    one scenario. Raises InputError if the file cannot be read, or has no lanelet for
    cars.

    References
    ----------
    .. [1] M. Althoff, M. Koschi, S. Manzinger, "CommonRoad: Composable benchmarks for
       motion
       planning on roads", IV 2017, and the documentation of its XML format, 2020a.
    """
    root = read_xml(path, expected="CommonRoad")
    for element in root.iter():
        element.tag = local_name(element)
    omissions = Omissions()
    crossing = {one.get("ref") for one in root.iter("crossingLanelet")} | {
        ref.get("ref")
        for incoming in root.iter("incoming")
        for tag in ("successorsRight", "successorsStraight", "successorsLeft")
        for ref in incoming.iter(tag)
    }
    lanelets = []
    for element in root.iter("lanelet"):
        bounds = [_points(element.find(f"{side}Bound")) for side in ("left", "right")]
        name = element.get("id", "")
        if not name:
            continue  # a reference to one
        types = [one.text or "" for one in element.iter("laneletType")]
        kind = next((_KINDS[text] for text in types if text in _KINDS), "driving")
        if any(len(bound) < 2 for bound in bounds):
            omissions.add(
                "lanelets without bounds", f"lanelet {name}", "a bound has no points"
            )
            continue
        one_way = element.find("userBidirectional") is None
        inside = name in crossing and kind == "driving"
        one = _lanelet(
            name, *bounds, kind=kind, is_oneway=one_way, is_in_junction=inside
        )
        lanelets.append(one)
    poles = [
        Pole(
            id=f"{kind}-{one.get('id')}".replace(" ", "-"),
            kind=kind,
            position_m=place[0],
        )
        for tag, kind in (("trafficLight", "traffic light"), ("trafficSign", "sign"))
        for one in root.iter(tag)
        if one.get("id") and len(place := _points(one.find("position")))
    ]
    return _source_map(
        path, lanelets, omissions, keeps_left=keeps_left, crs="", heights="above ground",
        poles=tuple(poles),
    )  # fmt: skip


def _points(element: Element | None) -> FloatArray:
    """Points under an element, (n, 3)."""
    found = [
        [
            float_of(point.findtext(axis) or ("0" if axis == "z" else ""))
            for axis in "xyz"
        ]
        for point in ([] if element is None else element.iter("point"))
    ]
    points = np.array(found).reshape(-1, 3)
    return np.asarray(points[np.isfinite(points).all(axis=1)])
