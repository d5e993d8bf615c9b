"""Maps of lanelets: Lanelet2 and CommonRoad.

A lanelet is a piece of a lane between a left and a right bound.
"""

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
from ..frames import WGS84, transform
from ..lines import along_m, apart, cross, length_m, points_at
from ..notes import Note
from ..phrases import Phrase
from ..text_formats import float_of, load_data
from ..xml_files import local_name, read_xml
from .circles import with_roundabouts
from .georeferences import local_crs
from .opendrive.junctions import (
    fit_outline,
    lanes_by_junction,
    largest_polygon,
    with_known_junctions,
)
from .openstreetmap.elements import Elements, Relation, read_loose_elements
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
# Kinds of lanelets that belong to roads.
_ROADS = ("driving", "bus")
# How tags begin that say who may use a lanelet.
_USERS = "participant:"
_KINDS = {word: kind for kind, words in _WORDS.items() for word in words}
# between the end of a lanelet and the beginning of the next one, at both bounds
_JOINED_M = 0.5
# Between points of a centreline.
_STEP_M = 2.0
# Points nearer than this are one.
_SAME_M = 0.01
# Lanelets that cross, merge or part share more ground.
_MIN_OVERLAP_M2 = 2.0
# Narrower or shorter lanelets are no lanes.
_MIN_SIZE_M = 0.1
# Longer lanelets are no lanes: a coordinate is wrong.
_MAX_LENGTH_M = 100_000.0
# Latitudes and longitudes fit local coordinates within this, and this share of the
# map's size: a projection's scale.
_FITS_M = 1.0
_FITS_SHARE = 2e-3
# Around latitude 0, longitude 0, where maps without a place are drawn.
_NOWHERE_DEG = 0.5
# Between lanelets of both directions of a road.
_BESIDE_M = 25.0
# Cosine between their directions.
_AGAINST = -0.95
# Through one junction from one lane.
_MAX_WAYS = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lanelet:
    """Piece of a lane; both bounds run in its direction.

    Attributes
    ----------
    id : str
        Id in the file; "r" is added for the other direction.
    kind : str
        Of MapLane, or "crosswalk".
    left_m : (n, 3) float
        Left bound. [m]
    right_m : (k, 3) float
        Right bound. [m]
    is_oneway : bool
        Cars drive in its direction only.
    speed_limit_kmh : float or None
        None: the file gives none. [km/h]
    is_in_junction : bool
        The file says so.
    """

    id: str
    kind: str
    left_m: FloatArray
    right_m: FloatArray
    is_oneway: bool = True
    speed_limit_kmh: float | None = None
    is_in_junction: bool = False

    @property
    def polygon(self) -> Any:
        """Ground of the lanelet, a valid shapely geometry."""
        ring_m = np.concatenate([self.left_m[:, :2], self.right_m[::-1, :2]])
        return shapely.make_valid(shapely.Polygon(ring_m))

    @property
    def edges_m(self) -> FloatArray:
        """Points of both bounds side by side, (2, m, 3)."""
        bounds = (self.left_m, self.right_m)
        longest_m = max(length_m(bound) for bound in bounds)
        n_points = max(2, round(longest_m / _STEP_M) + 1)
        edges = []
        for bound in bounds:
            stations_m = np.linspace(0.0, along_m(bound)[-1], n_points)
            edges.append(points_at(bound, stations_m))
        return np.array(edges)

    def turned(self) -> "Lanelet":
        """The same lanelet in the other direction."""
        return replace(
            self, id=f"{self.id}r", left_m=self.right_m[::-1], right_m=self.left_m[::-1]
        )


def _lanelet(
    name: str, left_m: FloatArray, right_m: FloatArray, **known: Any
) -> Lanelet:
    """Lanelet whose bounds are turned so that the left one is on the left.

    Parameters
    ----------
    name : str
        Id of the lanelet.
    left_m : (n, 3) float
        Left bound, in any direction. [m]
    right_m : (k, 3) float
        Right bound, in any direction. [m]

    Returns
    -------
    lanelet : Lanelet
        Both bounds run in the same direction.
    """
    # Both bounds must run the same way: their ends are then nearest to each other.
    along = np.hypot(*(left_m[[0, -1], :2] - right_m[[0, -1], :2]).T).sum()
    across = np.hypot(*(left_m[[0, -1], :2] - right_m[[-1, 0], :2]).T).sum()
    if across < along:
        right_m = right_m[::-1]
    ring = shapely.LinearRing(np.concatenate([right_m[:, :2], left_m[::-1, :2]]))
    if not ring.is_ccw:
        left_m = left_m[::-1]
        right_m = right_m[::-1]
    return Lanelet(id=name, left_m=left_m, right_m=right_m, **known)


def _has_ground(one: Lanelet, name: str, omissions: Omissions) -> bool:
    """True if a lanelet has the length and width of a lane; others are noted."""
    longest_m = max(length_m(bound) for bound in (one.left_m, one.right_m))
    if longest_m > _MAX_LENGTH_M:
        why = f"no lane: a bound is {longest_m / 1000.0:.3g} km long"
        omissions.add("lanelets without ground", name, why)
        return False
    edges_m = one.edges_m
    width_m = np.hypot(*(edges_m[0] - edges_m[1])[:, :2].T).mean()
    long_m = length_m(edges_m.mean(axis=0)[:, :2])
    if width_m >= _MIN_SIZE_M and long_m >= _MIN_SIZE_M:
        return True
    why = f"no lane: it is {width_m:.2g} m wide and {long_m:.2g} m long"
    omissions.add("lanelets without ground", name, why)
    return False


# ---------- from lanelets to lanes and junctions
def _build(
    lanelets: Sequence[Lanelet], omissions: Omissions
) -> tuple[list[MapLane], list[MapLane], list[MapJunction]]:
    """Lanes between junctions, lanes through them, and the junctions.

    A junction is where lanelets of roads share ground, or what the file says:
    those that touch each other, and those between them.

    Parameters
    ----------
    lanelets : sequence of Lanelet
        Lanelets of the file.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    lanes : list of MapLane
        Outside junctions.
    connections : list of MapLane
        Through junctions.
    junctions : list of MapJunction
        Those that lanes lead to; the others are noted.
    """
    roads = _with_right_sides(
        [one for one in lanelets if one.kind in _ROADS], omissions
    )
    roads += [one.turned() for one in roads if not one.is_oneway]
    # Lanelets that follow each other, and those whose ground meets.
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
    junction_of: dict[int, str] = {}
    for number, group in enumerate(members, start=1):
        for index in group:
            junction_of[index] = f"j{number}"
    paths = [
        _map_lane([one], one.id)
        for one in lanelets
        if one.kind in ("walking", "cycling")
    ]
    lanes = [*_lanes(roads, follows, junction_of), *paths]
    # Outlines of the junctions, fitted to the ends of lanes, and the ways through them.
    tips_of = lanes_by_junction(lanes)
    junctions = []
    connections = []
    for group in members:
        name = junction_of[group[0]]
        # Lanelets that only touch in rounded numbers would stay apart.
        wider = [ground[one].buffer(0.05) for one in group]
        surface = largest_polygon(shapely.union_all(wider))
        tips = tips_of[name]
        if surface is None or not tips:
            omissions.add("junctions", f"junction {name}", "no lane leads to it")
            continue
        surface, _ = fit_outline(surface, tips)
        heights_m = [roads[one].left_m[:, 2].mean() for one in group]
        height_m = float(np.mean(heights_m))
        outline_m = np.asarray(surface.exterior.coords)[:-1]
        junctions.append(
            MapJunction(id=name, name="", outline_m=outline_m, height_m=height_m)
        )
        connections += _connections(roads, follows, group, name)
    return with_known_junctions(lanes, junctions), connections, junctions


def _with_right_sides(roads: Sequence[Lanelet], omissions: Omissions) -> list[Lanelet]:
    """Lanelets, with left and right exchanged where a map has them wrong.

    A lanelet is turned if it then meets others and does not as it is.

    Parameters
    ----------
    roads : sequence of Lanelet
        Lanelets of cars.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    roads : list of Lanelet
        In the same order; those turned are noted.
    """
    # Try every lanelet in both directions.
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
    right = list(roads)
    for index in np.flatnonzero(is_wrong).tolist():
        right[index] = turned[index]
    return right


def _followers(lanelets: Sequence[Lanelet]) -> list[list[int]]:
    """Indices of the lanelets that begin where each one ends."""
    if not lanelets:
        return []

    def tips(at: int) -> FloatArray:
        """Ends of both bounds as one point in four dimensions, (n, 4)."""
        return np.array(
            [[*one.left_m[at, :2], *one.right_m[at, :2]] for one in lanelets]
        )

    begins = cKDTree(tips(0))
    found: Any = begins.query_ball_point(tips(-1), _JOINED_M)
    return [[one for one in here if one != index] for index, here in enumerate(found)]


def _inside(
    roads: Sequence[Lanelet], ground: Sequence[Any], pairs: IntArray
) -> BoolArray:
    """Lanelets that lie in a junction, (n,).

    They are those that the file says, or else those that share ground.

    Parameters
    ----------
    roads : sequence of Lanelet
        Lanelets of cars.
    ground : sequence of Any
        Polygon of each.
    pairs : (k, 2) int
        Those whose ground meets.

    Returns
    -------
    is_inside : (n,) bool
        True for lanelets in a junction.
    """
    inside = np.array([one.is_in_junction for one in roads], dtype=bool)
    if inside.any():
        return inside
    for one, other in pairs[pairs[:, 0] < pairs[:, 1]].tolist():
        if f"{roads[one].id}r" == roads[other].id:
            # The same ground, in both directions.
            continue
        if shapely.intersection(ground[one], ground[other]).area > _MIN_OVERLAP_M2:
            inside[[one, other]] = True
    return inside


def _lanes(
    roads: Sequence[Lanelet],
    follows: Sequence[Sequence[int]],
    junction_of: Mapping[int, str],
) -> Iterator[MapLane]:
    """Lanes outside junctions: lanelets that follow without a choice.

    Parameters
    ----------
    roads : sequence of Lanelet
        Lanelets of cars.
    follows : Sequence[Sequence[int]]
        Indices of the lanelets after each one.
    junction_of : Mapping[int, str]
        Junction of the lanelets that lie in one.

    Yields
    ------
    lane : MapLane
        Rings come last.
    """
    before: dict[int, list[int]] = {index: [] for index in range(len(roads))}
    for index, others in enumerate(follows):
        for other in others:
            before[other].append(index)

    # Joints: pairs where one lanelet follows another without a choice on either side.
    outside = [index for index in range(len(roads)) if index not in junction_of]
    joints: dict[int, int] = {}
    for one in outside:
        if len(follows[one]) != 1:
            continue
        other = follows[one][0]
        is_alike = roads[one].kind == roads[other].kind
        if before[other] == [one] and other not in junction_of and is_alike:
            joints[one] = other
    # Chains from lanelets that no joint leads to.
    done: set[int] = set()
    starts = [one for one in outside if one not in joints.values()]
    # Then what is left: rings.
    for start in [*starts, *outside]:
        if start in done:
            continue
        chain = [start]
        while (following := joints.get(chain[-1], start)) != start:
            chain.append(following)
        done.update(chain)
        leading_in = [junction_of[one] for one in before[start] if one in junction_of]
        leading_out = [
            junction_of[one] for one in follows[chain[-1]] if one in junction_of
        ]
        begin = next(iter(leading_in), "")
        end = next(iter(leading_out), "")
        pieces = [roads[one] for one in chain]
        yield _map_lane(pieces, roads[start].id, from_junction=begin, to_junction=end)


def _connections(
    roads: Sequence[Lanelet],
    follows: Sequence[Sequence[int]],
    group: Sequence[int],
    name: str,
) -> list[MapLane]:
    """Ways of cars through a junction, from each lanelet that nothing leads to.

    Parameters
    ----------
    roads : sequence of Lanelet
        Lanelets of cars.
    follows : Sequence[Sequence[int]]
        Indices of the lanelets after each one.
    group : sequence of int
        Indices of the junction's lanelets.
    name : str
        Id of the junction.

    Returns
    -------
    lanes : list of MapLane
        At most 200.
    """
    members = {one for one in group if roads[one].kind == "driving"}
    onwards = {
        one: [other for other in follows[one] if other in members] for one in members
    }
    led_to = {other for others in onwards.values() for other in others}
    found: list[MapLane] = []
    # Extend each way until nothing of the junction follows.
    ways = [[one] for one in group if one in members and one not in led_to]
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
    """Lane along lanelets that follow each other.

    Parameters
    ----------
    chain : sequence of Lanelet
        Lanelets, one after the other.
    lane_id : str
        Id of the lane.
    from_junction : str
        Junction at its begin; empty: none.
    to_junction : str
        Junction at its end; empty: none.

    Returns
    -------
    lane : MapLane
        With the speed limit of the last lanelet that has one.
    """
    edges_m = np.concatenate([one.edges_m for one in chain], axis=1)
    middle_m = edges_m.mean(axis=0)
    width_m = np.hypot(*(edges_m[0] - edges_m[1])[:, :2].T).mean()
    limits = [one.speed_limit_kmh for one in chain if one.speed_limit_kmh is not None]
    speed_limit_kmh = None
    if limits:
        speed_limit_kmh = limits[-1]
    return MapLane(
        id=lane_id,
        kind=chain[0].kind,
        width_m=float(width_m),
        centreline_m=apart(middle_m, _SAME_M),
        speed_limit_kmh=speed_limit_kmh,
        from_junction=from_junction,
        to_junction=to_junction,
    )


def _keeps_left(roads: Sequence[Lanelet]) -> bool | None:
    """True if traffic keeps left; None: no lanelets side by side show it."""
    edges_m = [one.edges_m.mean(axis=0)[:, :2] for one in roads]
    # Middle and direction of each lanelet.
    middle_m = np.array([line[len(line) // 2] for line in edges_m]).reshape(-1, 2)
    ahead = np.array([line[-1] - line[0] for line in edges_m]).reshape(-1, 2)
    ahead /= np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    votes = 0
    for one, other in cKDTree(middle_m).query_pairs(_BESIDE_M):
        apart_m = middle_m[other] - middle_m[one]
        aside_m = cross(ahead[one], apart_m)
        is_beside = abs(apart_m @ ahead[one]) < abs(aside_m)
        if is_beside and ahead[one] @ ahead[other] < _AGAINST:
            # Traffic keeps left if the other direction lies on the right.
            if aside_m < 0.0:
                votes += 1
            else:
                votes -= 1
    if votes:
        return votes > 0
    return None


def _source_map(
    path: Path,
    lanelets: Sequence[Lanelet],
    omissions: Omissions,
    *,
    keeps_left: bool | None,
    **known: Any,
) -> SourceMap:
    """Map of lanelets; InputError: none of them is for cars."""
    if not any(one.kind == "driving" for one in lanelets):
        raise InputError(str(path), Unquoted("no lanelet for cars"), "a map with roads")
    lanes, connections, junctions = _build(lanelets, omissions)
    notes = omissions.listed()
    if keeps_left is None:
        keeps_left = _keeps_left([one for one in lanelets if one.kind == "driving"])
    if keeps_left is None:
        what = Phrase("side of the road")
        why = Phrase("no lanelets side by side show it: right-hand traffic is assumed")
        notes = (Note(what=what, why=why, kind="side of the road"), *notes)
    walks = [one for one in lanelets if one.kind == "crosswalk"]
    crossings = [one.edges_m.mean(axis=0)[[0, -1], :2] for one in walks]
    source = SourceMap(
        name=path.name,
        lanes=tuple(lanes),
        connections=tuple(connections),
        junctions=tuple(junctions),
        crosswalks_m=np.array(crossings).reshape(-1, 2, 2),
        keeps_left=bool(keeps_left),
        skipped=notes,
        **known,
    )
    return with_roundabouts(source)


# ---------- Lanelet2
def read_lanelet2(path: Path, *, keeps_left: bool | None = None) -> SourceMap:
    """Read a Lanelet2 map: OpenStreetMap XML with relations of type lanelet.

    Lanelets of roads become lanes and junctions, crosswalks, walkways and
    bicycle lanes theirs, traffic lights and signs poles, areas of buildings
    things. Distances are those of ``local_x`` and ``local_y`` where nodes have
    them, and latitude and longitude say where on earth they lie; a map around
    0, 0, or one in which they do not fit, has no place on earth. Files of
    Autoware are read, too: without a version, and with empty latitudes.

    Parameters
    ----------
    path : Path
        File to read.
    keeps_left : bool or None
        Traffic keeps left; None: what neighbours show.

    Returns
    -------
    source : SourceMap
        Lanes, junctions, poles and things.

    Raises
    ------
    InputError
        The file cannot be read, or has no lanelet for cars.

    References
    ----------
    .. [1] F. Poggenhans et al., "Lanelet2: A high-definition map framework", ITSC
       2018, and ``lanelet2_core/doc/LaneletPrimitives.md`` in its repository.
    """
    elements = read_loose_elements(path)
    omissions = Omissions()
    points_m, crs, has_heights = _positions(elements, path, omissions)
    has_place = np.asarray(np.isfinite(points_m).all(axis=1))
    ways = {}
    for way in elements.ways:
        rows = way.rows[way.rows >= 0]
        ways[way.id] = points_m[rows[has_place[rows]]]
    lanelets = []
    # Each relation of type lanelet, unless it lacks a bound or is of another kind.
    for relation in elements.relations:
        if relation.tags.get("type") == "lanelet":
            name = f"lanelet {relation.id} of {path.name}"
            bounds = [_bound(relation, side, ways) for side in ("left", "right")]
            kind = _kind_of(relation.tags)
            if not kind:
                why = "no lane of cars, bicycles or people on the ground"
                omissions.add("lanelets of other kinds", name, why)
            elif any(len(bound) < 2 for bound in bounds):
                omissions.add(
                    "lanelets without bounds", name, "a bound is missing, or in pieces"
                )
            else:
                lanelet = _lanelet(
                    str(relation.id),
                    *bounds,
                    kind=kind,
                    is_oneway=relation.tags.get("one_way", "yes") != "no",
                    speed_limit_kmh=parse_speed_kmh(
                        relation.tags.get("speed_limit", "")
                    ),
                    is_in_junction="turn_direction" in relation.tags,
                )
                if _has_ground(lanelet, name, omissions):
                    lanelets.append(lanelet)
    source_crs = ""
    if crs:
        source_crs = WGS84
    heights = "above ground"
    ground_m = np.empty((0, 3))
    if has_heights:
        heights = "absolute"
    if has_heights and lanelets:
        ground_m = np.concatenate([one.edges_m.reshape(-1, 3) for one in lanelets])
    return _source_map(
        path,
        lanelets,
        omissions,
        keeps_left=keeps_left,
        crs=crs,
        source_crs=source_crs,
        heights=heights,
        poles=tuple(_poles(elements, ways)),
        things=tuple(_buildings(elements, ways, omissions)),
        ground_m=ground_m,
    )


def _kind_of(tags: Mapping[str, str]) -> str:
    """Kind of a lanelet by its subtype and by who may use it; empty: of others."""
    kind = _KINDS.get(tags.get("subtype", ""), "")
    if kind not in _ROADS:
        return kind
    of_vehicles = tags.get(f"{_USERS}vehicle")
    of_cars = tags.get(f"{_USERS}vehicle:car", of_vehicles)
    allowed = {
        key.removeprefix(_USERS) for key, value in tags.items() if value == "yes"
    }
    if of_cars == "yes":
        return kind
    # Who is named is meant alone.
    for users, theirs in (
        ({"vehicle", "vehicle:bus", "vehicle:taxi"}, "bus"),
        ({"bicycle"}, "cycling"),
        ({"pedestrian"}, "walking"),
    ):
        if users & allowed:
            return theirs
    if of_cars == "no":
        return ""
    return kind


def _positions(
    elements: Elements, path: Path, omissions: Omissions
) -> tuple[FloatArray, str, bool]:
    """Positions of all nodes, their CRS, and whether they have heights.

    Distances are those of ``local_x`` and ``local_y``, the place on earth and the
    direction of north are those of latitude and longitude.

    Parameters
    ----------
    elements : Elements
        Elements of the file.
    path : Path
        File, for messages.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    points_m : (n, 3) float
        Heights are 0 where nodes have none; NaN: a node has no position. [m]
    crs : str
        Empty: the map has no place on earth.
    has_heights : bool
        Any node has a height.

    Raises
    ------
    InputError
        No node has a position.
    """
    tags = [elements.node_tags.get(row, {}) for row in range(len(elements.node_ids))]
    if not tags:
        raise InputError(str(path), Unquoted("no nodes"), "a map with lanelets")
    heights = np.array([float_of(some.get("ele", "")) for some in tags])
    has_heights = bool(np.isfinite(heights).any())
    height_m = np.nan_to_num(heights)
    local_m = np.array(
        [[float_of(some.get(f"local_{axis}", "")) for axis in "xy"] for some in tags]
    )
    is_local = np.isfinite(local_m).all(axis=1)
    is_geographic = np.isfinite(elements.lon_lat_deg).all(axis=1)
    for row in np.flatnonzero(~is_local & ~is_geographic).tolist():
        name = f"node {elements.node_ids[row]} of {path.name}"
        why = "neither latitude and longitude nor local_x and local_y"
        omissions.add("nodes", name, why)
    plane_m, crs = _projected(elements.lon_lat_deg, path)
    is_both = is_local & is_geographic
    if not is_local.any() and not is_geographic.any():
        raise InputError(str(path), Unquoted("no positions"), "a map with lanelets")
    if not is_local.any():
        return np.column_stack([plane_m, height_m]), crs, has_heights
    moved_m = None
    if crs and is_both.sum() >= 2:
        moved_m = _laid_over(local_m, plane_m, is_both)
        if moved_m is None:
            why = "latitude and longitude do not fit local_x and local_y: not followed"
            omissions.add("places on earth", f"place of {path.name}", why)
    if moved_m is None:
        # Nodes without local coordinates are of another frame.
        return np.column_stack([local_m, height_m]), "", has_heights
    points_m = np.where(is_local[:, None], moved_m, plane_m)
    return np.column_stack([points_m, height_m]), crs, has_heights


def _projected(lon_lat_deg: FloatArray, path: Path) -> tuple[FloatArray, str]:
    """Places in metres around their middle, (n, 2), and the projection's name.

    Places are NaN where longitude and latitude are. The name is empty around
    latitude 0, longitude 0, and where there is no place at all.
    """
    plane_m = np.full(lon_lat_deg.shape, np.nan)
    is_there = np.isfinite(lon_lat_deg).all(axis=1)
    if not is_there.any():
        return plane_m, ""
    middle_deg = np.median(lon_lat_deg[is_there], axis=0)
    crs = local_crs(middle_deg, WGS84, where=str(path))
    plane_m[is_there] = transform(lon_lat_deg[is_there], WGS84, crs)
    is_nowhere = bool((np.abs(middle_deg) < _NOWHERE_DEG).all())
    if is_nowhere:
        crs = ""
    return plane_m, crs


def _laid_over(
    local_m: FloatArray, plane_m: FloatArray, is_both: BoolArray
) -> FloatArray | None:
    """Local coordinates turned and moved to where they lie on earth.

    Parameters
    ----------
    local_m : (n, 2) float
        Local coordinates. [m]
    plane_m : (n, 2) float
        Projected latitudes and longitudes. [m]
    is_both : (n,) bool
        Which nodes have both.

    Returns
    -------
    moved_m : (n, 2) float or None
        None: they do not fit one another. [m]

    References
    ----------
    .. [1] W. Kabsch, "A solution for the best rotation to relate two sets of
       vectors", Acta Crystallographica A32, 1976.
    """
    local_middle_m = local_m[is_both].mean(axis=0)
    plane_middle_m = plane_m[is_both].mean(axis=0)
    from_m = local_m[is_both] - local_middle_m
    onto_m = plane_m[is_both] - plane_middle_m
    left, _, right = np.linalg.svd(from_m.T @ onto_m)
    # Turned, never mirrored.
    signs = np.array([1.0, np.linalg.det(left @ right)])
    rotation = left @ np.diag(signs) @ right
    off_m = np.hypot(*(from_m @ rotation - onto_m).T)
    size_m = float(np.hypot(*np.ptp(from_m, axis=0)))
    if np.median(off_m) > _FITS_M + _FITS_SHARE * size_m:
        return None
    return np.asarray((local_m - local_middle_m) @ rotation + plane_middle_m)


def _bound(relation: Relation, side: str, ways: Mapping[int, FloatArray]) -> FloatArray:
    """Line of a lanelet's side, joined of its ways, (n, 3).

    Parameters
    ----------
    relation : Relation
        The lanelet.
    side : str
        Role of the ways: "left", "right" or "outer".
    ways : Mapping[int, FloatArray]
        Points of each way, by its id. [m]

    Returns
    -------
    line_m : (n, 3) float
        Empty where the ways do not meet. [m]
    """
    parts = [
        ways[ref] for ref, role in relation.members if role == side and ref in ways
    ]
    line = np.empty((0, 3))
    if parts:
        line = parts.pop(0)
    # Each way is turned or put in front so that it meets the line.
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
    """Traffic lights and signs of a Lanelet2 map."""
    kinds = {"traffic_light": "traffic light", "traffic_sign": "sign"}
    for way in elements.ways:
        kind = kinds.get(way.tags.get("type", ""))
        if kind and len(ways[way.id]):
            yield Pole(id=f"w{way.id}", kind=kind, position_m=ways[way.id].mean(axis=0))


def _buildings(
    elements: Elements, ways: Mapping[int, FloatArray], omissions: Omissions
) -> Iterator[Thing]:
    """Areas of buildings as solids; other areas are noted."""
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
    """Read the lanelets of a CommonRoad scenario, in its own metres.

    The format is XML of version 2018b or 2020a. Traffic lights and signs become
    poles; obstacles are left out: they drive in one scenario.

    Parameters
    ----------
    path : Path
        File to read.
    keeps_left : bool or None
        Traffic keeps left; None: what neighbours show.

    Returns
    -------
    source : SourceMap
        Lanes, junctions and poles.

    Raises
    ------
    InputError
        The file cannot be read, or has no lanelet for cars.

    References
    ----------
    .. [1] M. Althoff, M. Koschi, S. Manzinger, "CommonRoad: Composable benchmarks
       for motion planning on roads", IV 2017, and the documentation of its XML
       format, 2020a.
    """
    root = read_xml(path, expected="CommonRoad")
    for element in root.iter():
        element.tag = local_name(element)
    omissions = Omissions()
    # Ids of the lanelets that cross an intersection or lead through it.
    crossing = {one.get("ref") for one in root.iter("crossingLanelet")}
    for incoming in root.iter("incoming"):
        for tag in ("successorsRight", "successorsStraight", "successorsLeft"):
            crossing |= {ref.get("ref") for ref in incoming.iter(tag)}
    lanelets = []
    for element in root.iter("lanelet"):
        bounds = [_points(element.find(f"{side}Bound")) for side in ("left", "right")]
        name = element.get("id", "")
        if not name:
            # A reference to one.
            continue
        types = [one.text or "" for one in element.iter("laneletType")]
        kinds = [_KINDS[text] for text in types if text in _KINDS]
        kind = next(iter(kinds), "driving")
        if "bus" in kinds:
            kind = "bus"
        if any(len(bound) < 2 for bound in bounds):
            omissions.add(
                "lanelets without bounds",
                f"lanelet {name} of {path.name}",
                "a bound has no points",
            )
            continue
        one_way = element.find("userBidirectional") is None
        inside = name in crossing and kind == "driving"
        one = _lanelet(
            name, *bounds, kind=kind, is_oneway=one_way, is_in_junction=inside
        )
        if _has_ground(one, f"lanelet {name} of {path.name}", omissions):
            lanelets.append(one)
    poles = []
    for tag, kind in (("trafficLight", "traffic light"), ("trafficSign", "sign")):
        for element in root.iter(tag):
            if not element.get("id"):
                continue
            places = _points(element.find("position"))
            if len(places):
                pole_id = f"{kind}-{element.get('id')}".replace(" ", "-")
                poles.append(Pole(id=pole_id, kind=kind, position_m=places[0]))
    return _source_map(
        path,
        lanelets,
        omissions,
        keeps_left=keeps_left,
        crs="",
        heights="above ground",
        poles=tuple(poles),
    )


def _points(element: Element | None) -> FloatArray:
    """Points under an element, (n, 3)."""
    # A point may leave out its height, but not x and y.
    otherwise = {"x": "", "y": "", "z": "0"}
    found = []
    if element is not None:
        for point in element.iter("point"):
            texts = [point.findtext(axis) or otherwise[axis] for axis in "xyz"]
            found.append([float_of(text) for text in texts])
    points = np.array(found).reshape(-1, 3)
    return np.asarray(points[np.isfinite(points).all(axis=1)])
