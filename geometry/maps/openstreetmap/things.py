"""Buildings, bridges over roads, walls, hedges, trees, poles and crosswalks."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import shapely
from shapely import LineString, Polygon, STRtree, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import InputError
from ...lines import along_m, points_at, unit
from ...phrases import Phrase
from ...scene import join
from ..source_map import (
    Omissions,
    Pole,
    Thing,
    extrude_polygon,
    parse_length_m,
    polygons_of,
    unit_ball,
    unit_cylinder,
)
from .elements import (
    DEFAULTS,
    WORDS,
    Elements,
    MappedArea,
    Relation,
    TagNote,
    Tags,
    Way,
    find_areas,
    is_yes,
    numbered,
    parse_number,
    tagged_length_m,
)
from .junctions import Reach
from .network import Edge, Network, carriageway_points, known_runs, level, lines_of
from .paths import is_path

# ---------- walls and hedges
_TRUNK_SIDES = 8
# A signal farther from any junction is one for both directions.
_NEAR_JUNCTION_M = 40.0
# A street and how far along it [m].
_Place = tuple[Reach, float]
# Cosine: two lines that differ more are not one crosswalk.
_PARALLEL = 0.8
# Of a footway on a carriageway.
_LEAST_M = 0.5
# Of what is left of a building.
_LEAST_M2 = 1.0
# Bottom and top above the ground [m], whether they are assumed.
_Span = tuple[float, float, bool]


def find_barriers(elements: Elements) -> Iterator[Thing]:
    """Walls, hedges and boarded fences as solids.

    Fences that one can see through and damaged outlines are noted.

    Parameters
    ----------
    elements : Elements
        Elements of the file.

    Yields
    ------
    thing : Thing
        From the ground up to the tagged or the usual height.
    """
    limits = DEFAULTS["barrier"]
    for way in elements.ways:
        tags = way.tags
        kind = tags.get("barrier", "")
        if kind not in WORDS["barriers"]:
            continue
        note = partial(elements.omissions.add, "barriers", f"way {way.id}")
        fence = tags.get("fence_type", tags.get("material", ""))
        if kind == "fence" and fence not in limits["opaque_fences"]:
            why = "seen through: no fence_type that says otherwise"
            elements.omissions.add("fences", f"way {way.id}", why)
            continue
        tagged_m = tagged_length_m(
            tags,
            ("height", "est_height"),
            (0.01, limits["max_height_m"]),
            note,
        )
        thick_m = tagged_length_m(
            tags,
            ("thickness", "width"),
            (0.01, limits["max_thickness_m"]),
            note,
        )
        top_m = tagged_m
        if top_m is None:
            top_m = float(limits[kind]["height_m"])
        if thick_m is None:
            thick_m = float(limits[kind]["thickness_m"])
        for number, footprint in enumerate(_footprints(way, elements, thick_m)):
            try:
                mesh = extrude_polygon(
                    footprint,
                    bottom_m=0.0,
                    top_m=top_m,
                    where=f"way {way.id}",
                )
            except InputError as error:
                note(f"its outline has {error.got}")
                continue
            name = numbered(f"w{way.id} {kind}", number, " ")
            class_name = "wall"
            if kind == "hedge":
                class_name = "vegetation"
            yield Thing.of(name, class_name, mesh, is_height_assumed=tagged_m is None)


def _footprints(way: Way, elements: Elements, thickness_m: float) -> Iterator[Polygon]:
    """Footprints of a barrier: its area, or strips along its lines.

    Parameters
    ----------
    way : Way
        The barrier.
    elements : Elements
        Elements of the file.
    thickness_m : float
        Width of the strips. [m]

    Yields
    ------
    footprint : Polygon
        In metres.
    """
    is_area = way.tags.get("area") == "yes" and way.is_closed
    if is_area and (way.rows >= 0).all():
        yield from polygons_of(Polygon(elements.positions_m[way.rows]).buffer(0.0))
        return
    for line_m in lines_of(way, elements):
        strip = LineString(line_m).buffer(
            0.5 * thickness_m,
            cap_style="flat",
            join_style="mitre",
        )
        yield from polygons_of(strip)


# ---------- trees
def find_trees(elements: Elements) -> Iterator[Thing]:
    """Trees as an upright trunk and an ellipsoid crown, each closed.

    Rows of trees are filled at the usual spacing. Woods are noted: the
    positions of their trees are unknown.

    Parameters
    ----------
    elements : Elements
        Elements of the file.

    Yields
    ------
    thing : Thing
        Of the class "vegetation".
    """
    add = elements.omissions.add
    for row, tags in elements.node_tags.items():
        if tags.get("natural") == "tree":
            node_id = int(elements.node_ids[row])
            note = partial(add, "trees", f"node {node_id}")
            yield _tree(f"n{node_id}", elements.positions_m[row], tags, note)
    # Rows of trees are ways; woods are ways or relations.
    tagged: tuple[Way | Relation, ...] = (*elements.ways, *elements.relations)
    for one in tagged:
        element = f"relation {one.id}"
        if isinstance(one, Way):
            element = f"way {one.id}"
        if isinstance(one, Way) and one.tags.get("natural") == "tree_row":
            usual = DEFAULTS["tree"]
            feet = list[FloatArray]()
            for line_m in lines_of(one, elements):
                long_m = float(along_m(line_m)[-1])
                n_trees = min(
                    round(long_m / usual["row_spacing_m"]) + 1, usual["max_in_row"]
                )
                stations_m = np.linspace(0.0, long_m, max(n_trees, 2))
                feet += [*points_at(line_m, stations_m)]
            for number, foot in enumerate(feet):
                note = partial(add, "trees", element)
                yield _tree(f"w{one.id} tree {number}", foot, one.tags, note)
        if any(one.tags.get(key) == value for key, value in WORDS["woods"]):
            add("woods", element, "the positions of its trees and bushes are unknown")


def _tree(name: str, foot_m: FloatArray, tags: Tags, note: TagNote) -> Thing:
    """One tree with the sizes of its tags, or usual ones.

    Parameters
    ----------
    name : str
        Id of the thing.
    foot_m : (2,) float
        Where it stands. [m]
    tags : Tags
        Tags of the element, by key.
    note : TagNote
        Called with the reason where a tag is not followed.

    Returns
    -------
    tree : Thing
        Trunk and crown in one mesh.
    """
    usual = DEFAULTS["tree"]

    def size_m(keys: Sequence[str], highest_m: float) -> float | None:
        """Tagged size in metres; None: there is none that makes sense."""
        return tagged_length_m(tags, keys, (0.05, highest_m), note)

    tagged_m = size_m(("height", "est_height"), usual["max_height_m"])
    height_m = usual["height_m"]
    if tagged_m is not None:
        height_m = tagged_m
    crown_m = size_m(("diameter_crown",), usual["max_crown_m"])
    crown_m = crown_m or usual["crown_diameter_m"]
    girth_m = size_m(("circumference",), np.pi * usual["max_trunk_m"])
    trunk_m = usual["trunk_diameter_m"]
    if girth_m is not None:
        trunk_m = girth_m / np.pi
    trunk_m = min(trunk_m, crown_m)
    base_m = min(usual["crown_base_m"], usual["crown_base_share"] * height_m)
    # The crown is an ellipsoid from its base to the top, the trunk reaches its middle.
    ball, ball_faces = unit_ball()
    middle_m = 0.5 * (base_m + height_m)
    crown = ball * [0.5 * crown_m, 0.5 * crown_m, height_m - middle_m] + [
        0.0,
        0.0,
        middle_m,
    ]
    trunk, trunk_faces = unit_cylinder(_TRUNK_SIDES)
    trunk = trunk * [0.5 * trunk_m, 0.5 * trunk_m, middle_m]
    vertices, triangles = join([(trunk, trunk_faces), (crown, ball_faces)])
    mesh = vertices + np.append(foot_m, 0.0), triangles
    return Thing.of(name, "vegetation", mesh, is_height_assumed=tagged_m is None)


# ---------- poles
def find_poles(network: Network, reaches: Sequence[Reach]) -> Iterator[Pole]:
    """Poles next to roads that could carry sensors.

    Signals and signs that are mapped on a road stand at the kerb on the side of
    traffic: at the stop line, or where an arm begins if that is farther out;
    those where roads meet at every arm. Places of poles that are nodes of other
    ways are assumed, too.

    Parameters
    ----------
    network : Network
        Roads for cars.
    reaches : sequence of Reach
        Parts of streets that have lanes.

    Yields
    ------
    pole : Pole
        Lamps and signals without a pole are noted instead.
    """
    # Nodes of junctions lie on all arms.
    places: dict[int, list[_Place]] = defaultdict(list)
    for reach in reaches:
        for row, station_m in zip(
            reach.street.rows,
            reach.street.stations_m,
            strict=True,
        ):
            places[int(row)].append((reach, float(station_m)))
    elements = network.elements
    # Nodes of other ways, such as footways: poles stand beside these.
    path_rows: set[int] = set()
    for way in elements.ways:
        if is_path(way):
            path_rows.update(way.rows.tolist())
    # One pole for each node at the roadside, or several where it lies on a road.
    for row, tags in elements.node_tags.items():
        kind = _kind(tags)
        if not kind:
            continue
        node_id = int(elements.node_ids[row])
        support = (
            tags.get("support")
            or tags.get("lamp_mount")
            or tags.get("camera:mount", "")
        )
        if support in WORDS["no_pole"]:
            why = "on a wall or a wire, without a pole"
            elements.omissions.add(f"{kind}s", f"node {node_id}", why)
            continue
        feet = [elements.positions_m[row]]
        assumed = ""
        is_on_road = row in network.ends or row in places
        if row in path_rows and not is_on_road:
            assumed = Phrase("mapped on a way: a pole beside it is assumed")
        if kind in ("traffic light", "sign") and is_on_road:
            feet = _at_kerbs(places.get(row, ()), tags, keeps_left=network.keeps_left)
            assumed = Phrase("mapped on the road: a pole at the kerb is assumed")
            if len(feet) > 1:
                assumed = Phrase(
                    "node {name} is mapped on the road: {n} poles at the kerbs are"
                    " assumed",
                    name=node_id,
                    n=len(feet),
                )
            if not feet:
                why = "inside a junction, where nobody stops"
                elements.omissions.add(f"{kind}s", f"node {node_id}", why)
        height_m = parse_length_m(tags.get("height", ""))
        if not height_m or height_m > DEFAULTS["pole"]["max_height_m"]:
            height_m = None
        for number, foot in enumerate(feet):
            name = numbered(f"n{node_id}", number)
            position = np.append(foot, 0.0)
            yield Pole(
                id=name,
                kind=kind,
                position_m=position,
                height_m=height_m,
                assumed=assumed,
            )


def _kind(tags: Tags) -> str:
    """Kind of pole that the tags of a node describe; empty: none."""
    otherwise = ""
    if "traffic_sign" in tags:
        otherwise = "sign"
    kind: str = WORDS["roadside"].get(tags.get("highway", ""), otherwise)
    if kind:
        return kind
    has_camera = (
        tags.get("man_made") == "surveillance" and tags.get("camera:mount") == "pole"
    )
    is_mast = tags.get("man_made") in WORDS["poles"] or tags.get("power") == "pole"
    if has_camera or is_mast:
        return "pole"
    return ""


def _at_kerbs(
    places: Sequence[_Place],
    tags: Tags,
    *,
    keeps_left: bool,
) -> list[FloatArray]:
    """Feet of the poles of one mapped signal or sign, (2,) each.

    Parameters
    ----------
    places : sequence of _Place
        Streets through the node, and where it lies along them.
    tags : Tags
        Tags of the element, by key.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    feet : list of (2,) float
        At the kerb, each at least 1 m from the others. [m]
    """
    feet: list[FloatArray] = []
    for reach, station_m in places:
        for is_forward in _directions(reach, station_m, tags):
            # Beside the stop line, or where the arm begins if the stop line lies
            # inside.
            first_m = min(reach.begin_m, reach.end_m)
            at_m = float(np.clip(station_m, first_m, reach.end_m))
            section = reach.street.section_at(at_m)
            # To the left of the street, or to the right.
            sign = -1.0
            if is_forward == keeps_left:
                sign = 1.0
            beside_m = 0.5 * section.width_m + DEFAULTS["pole"]["beyond_kerb_m"]
            (middle,), (across,) = carriageway_points(reach.street, [at_m])
            foot = middle + sign * beside_m * across
            if all(np.hypot(*(foot - other)) > 1.0 for other in feet):
                feet.append(foot)
    return feet


def _directions(reach: Reach, station_m: float, tags: Tags) -> list[bool]:
    """Directions along a street in which cars see a signal.

    Parameters
    ----------
    reach : Reach
        The street's part with lanes.
    station_m : float
        Where the signal lies along the street. [m]
    tags : Tags
        Tags of the element, by key.

    Returns
    -------
    directions : list of bool
        True is from the street's start to its end.
    """
    street = reach.street
    index = street.part_at(station_m)
    edge, is_along = street.parts[index]
    section = street.sections[index]
    driven = [one for one in (True, False) if section.lanes(is_forward=one)]
    if station_m <= 0.0 and reach.from_junction:
        return [one for one in driven if not one]
    if station_m >= street.length_m and reach.to_junction:
        return [one for one in driven if one]
    text = tags.get("traffic_signals:direction") or tags.get("traffic_sign:direction")
    text = text or tags.get("direction", "")
    if text in ("forward", "backward"):
        # Along the way as mapped; one-way roads that run against it have been turned
        # round.
        is_way = (text == "forward") == (edge.tags.get("oneway:turned") != "yes")
        return [one for one in driven if one == (is_way == is_along)]
    if text == "both" or len(driven) < 2:
        return driven
    # Without a direction it is for cars on their way to the nearer junction.
    to_begin = np.inf
    if reach.from_junction:
        to_begin = station_m
    to_end = np.inf
    if reach.to_junction:
        to_end = street.length_m - station_m
    if min(to_begin, to_end) > _NEAR_JUNCTION_M:
        return driven
    return [bool(to_end <= to_begin)]


# ---------- crosswalks
def find_crosswalks(network: Network) -> FloatArray:
    """Lines on which pedestrians cross carriageways.

    Where a mapped footway leads over roads it is a straight line along it over
    each of them; otherwise it runs across the road at the mapped point.
    Crossings without a road are noted.

    Parameters
    ----------
    network : Network
        Roads for cars, with the elements of the file.

    Returns
    -------
    lines_m : (n, 2, 2) float
        From a little beyond one kerb to a little beyond the other. [m]
    """
    limits = DEFAULTS["crosswalk"]
    elements = network.elements
    lines: list[FloatArray] = []
    # Nodes that lie on a mapped footway over a road.
    covered: set[int] = set()
    tree = shapely.STRtree(
        [shapely.linestrings(edge.points_m) for edge in network.edges]
    )
    for way in elements.ways:
        if way.tags.get("footway") != "crossing":
            continue
        if way.tags.get("highway") not in WORDS["footways"]:
            continue
        for rows in known_runs(way, elements):
            walk = LineString(elements.positions_m[rows])
            hits = tree.query(walk, predicate="intersects").tolist()
            near = [network.edges[at] for at in hits]
            edges = [edge for edge in near if edge.level == level(way.tags)]
            found = []
            for line in _over_roads(walk, edges):
                long_m = np.hypot(*(line[1] - line[0]))
                if 1.0 < long_m <= limits["max_length_m"]:
                    found.append(line)
            if not found:
                why = "no road for cars below it"
                elements.omissions.add("crossings", f"way {way.id}", why)
                continue
            covered.update(rows.tolist())
            lines += found
    # An edge through each node, and the node's place in it.
    at_row: dict[int, tuple[int, int]] = {}
    for index, edge in enumerate(network.edges):
        for at, row in enumerate(edge.rows.tolist()):
            if row not in at_row or network.edges[at_row[row][0]].is_service:
                at_row[row] = (index, at)
    # Mapped points on a road, unless a mapped footway leads over it there.
    for row, tags in elements.node_tags.items():
        if tags.get("highway") != "crossing" or tags.get("crossing") == "no":
            continue
        if row in covered or row not in at_row:
            continue
        lines.append(_across(network, row, at_row[row], limits["beyond_kerb_m"]))
    taken: list[FloatArray] = []
    for line in lines:
        middle = line.mean(axis=0)
        along = unit(line[1] - line[0])
        # One crosswalk may be mapped in two ways.
        is_known = any(
            np.hypot(*(middle - other.mean(axis=0))) <= limits["same_m"]
            and abs(along @ unit(other[1] - other[0])) > _PARALLEL
            for other in taken
        )
        if not is_known:
            taken.append(line)
    return np.array(taken).reshape(-1, 2, 2)


def _over_roads(walk: LineString, edges: Sequence[Edge]) -> Iterator[FloatArray]:
    """Lines over the roads that a footway crosses.

    Carriageways of one road on either side of a median are crossed on one line.

    Parameters
    ----------
    walk : LineString
        The footway.
    edges : sequence of Edge
        Roads on its level that it meets.

    Yields
    ------
    line_m : (2, 2) float
        One for each road. [m]
    """
    limits = DEFAULTS["crosswalk"]
    # Parts of the footway, and carriageways.
    joined: list[tuple[LineString, BaseGeometry]] = []
    # The carriageways in the order in which the footway crosses them.
    crossed: list[tuple[LineString, BaseGeometry]] = []
    for edge in edges:
        axis = LineString(edge.middle_m)
        surface = axis.buffer(0.5 * edge.section.width_m, cap_style="flat")
        for part in _parts_over(walk, edge, surface):
            crossed.append((part, surface))
    crossed.sort(key=lambda pair: walk.project(shapely.Point(pair[0].coords[0])))
    for part, carriageway in crossed:
        if joined:
            before, area = joined[-1]
            is_close = part.distance(before) <= limits["median_m"]
            if is_close and abs(_direction(part) @ _direction(before)) > _PARALLEL:
                joined.pop()
                part = LineString([before.coords[0], part.coords[-1]])
                carriageway = area.union(carriageway)
        joined.append((part, carriageway))
    for part, carriageway in joined:
        yield _from_kerb_to_kerb(part, carriageway, limits["beyond_kerb_m"])


def _parts_over(
    walk: LineString,
    edge: Edge,
    carriageway: BaseGeometry,
) -> Iterator[LineString]:
    """Stretches of a footway on a carriageway that meet the road's axis.

    Parameters
    ----------
    walk : LineString
        The footway.
    edge : Edge
        The road.
    carriageway : BaseGeometry
        Its surface.

    Yields
    ------
    part : LineString
        In the direction of the footway.
    """
    axis = LineString(edge.middle_m)
    on_road = shapely.line_merge(shapely.intersection(walk, carriageway))
    for part in shapely.get_parts(on_road):
        if not isinstance(part, LineString) or part.length <= _LEAST_M:
            continue
        if not part.distance(axis) < 1e-6:
            continue
        begin_m = walk.project(shapely.Point(part.coords[0]))
        end_m = walk.project(shapely.Point(part.coords[-1]))
        if begin_m <= end_m:
            yield part
        else:
            yield part.reverse()


def _direction(line: LineString) -> FloatArray:
    """Unit vector from the begin of a line to its end, (2,)."""
    begin, end = np.asarray(line.coords)[[0, -1], :2]
    return unit(end - begin)


def _from_kerb_to_kerb(
    part: LineString,
    carriageway: BaseGeometry,
    beyond_m: float,
) -> FloatArray:
    """Straight line along a footway over a carriageway, beyond both kerbs.

    Parameters
    ----------
    part : LineString
        Stretch of the footway on the carriageway.
    carriageway : BaseGeometry
        Road surface, perhaps of several carriageways.
    beyond_m : float
        How far the line leads beyond the kerbs. [m]

    Returns
    -------
    line_m : (2, 2) float
        Begin and end. [m]
    """
    begin = np.asarray(part.coords)[0, :2]
    along = _direction(part)
    reach_m = 2.0 * DEFAULTS["crosswalk"]["max_length_m"]
    ray = LineString([begin - reach_m * along, begin + reach_m * along])
    pieces = shapely.get_parts(shapely.intersection(ray, carriageway))
    stations = [
        np.sort((shapely.get_coordinates(piece) - begin) @ along) for piece in pieces
    ]
    own = [ends for ends in stations if ends[0] < part.length and ends[-1] > 0.0]
    low = min(ends[0] for ends in own)
    high = max(ends[-1] for ends in own)
    return begin + np.array([[low - beyond_m], [high + beyond_m]]) * along


def _across(
    network: Network,
    row: int,
    place: tuple[int, int],
    beyond_m: float,
) -> FloatArray:
    """Line across a road at one of its nodes, beyond both kerbs.

    Parameters
    ----------
    network : Network
        Roads for cars.
    row : int
        Row of the node.
    place : tuple[int, int]
        An edge through the node, and the node's place in it.
    beyond_m : float
        How far the line leads beyond the kerbs. [m]

    Returns
    -------
    line_m : (2, 2) float
        Square to the road, or to the bisector where it bends. [m]
    """
    index, at = place
    edge = network.edges[index]
    points = edge.points_m
    before = points[max(at - 1, 0)]
    after = points[min(at + 1, len(points) - 1)]
    ends = network.ends.get(row, ())
    if len(ends) == 2 and {one for one, _ in ends} != {index}:
        # The way ends here and another goes on: the road bends between them.
        other, is_start = next(end for end in ends if end[0] != index)
        if is_start:
            beyond = network.edges[other].points_m[1]
        else:
            beyond = network.edges[other].points_m[-2]
        if at == 0:
            before = beyond
        else:
            after = beyond
    steps = (points[at] - before, after - points[at])
    ways = [unit(step) for step in steps if np.hypot(*step) > 1e-6]
    # The bisector of the road on both sides of the node, unless it turns back there.
    along = np.sum(ways, axis=0)
    if np.hypot(*along) < 1e-6:
        along = ways[0]
    else:
        along = unit(along)
    half_m = 0.5 * edge.section.width_m + beyond_m
    left = np.array([-along[1], along[0]])
    return np.asarray(edge.middle_m[at] + half_m * np.stack([-left, left]))


# ---------- buildings, from the ground or above those who pass below
def find_buildings(network: Network) -> Iterator[Thing]:
    """Buildings as prisms from the ground, or from their tagged bottom.

    A building with parts is its parts, and the rest of it unless they cover it.
    Roofs on stilts begin above those who pass below, buildings over ways that
    lead through them above the passage.

    Parameters
    ----------
    network : Network
        Roads for cars, with the elements of the file.

    Yields
    ------
    thing : Thing
        Of the class "building".
    """
    omissions = network.elements.omissions
    every = find_areas(network.elements, ("building", "building:part"))
    areas = [area for area in every if _stands(area, omissions)]
    parts = [area for area in areas if is_yes(area.tags.get("building:part"))]
    part_ids = {area.id for area in parts}
    outlines = [area for area in areas if area.id not in part_ids]
    passages = _Passages(network)
    for area in parts:
        yield from _solid(area, passages, omissions)
    rests = _without_parts(outlines, parts)
    for area, rest in zip(outlines, rests, strict=True):
        pieces = [area]
        if rest is not None:
            pieces = list(_pieces(area, rest, f"{area.id} beside its parts"))
        for piece in pieces:
            yield from _solid(piece, passages, omissions)


def _element(area: MappedArea) -> str:
    """Kind and id of the element of an area, for notes: "way 5"."""
    kind = "way"
    if area.id.startswith("r"):
        kind = "relation"
    number, _, _ = area.id[1:].partition(".")
    return f"{kind} {number}"


def _stands(area: MappedArea, omissions: Omissions) -> bool:
    """True if a building exists, above the ground, and can be seen."""
    tags = area.tags
    kinds = [tags[key] for key in ("building", "building:part") if key in tags]
    if all(kind == "no" for kind in kinds):
        return False
    if any(kind in WORDS["not_there"] for kind in kinds):
        omissions.add("buildings", _element(area), "not built yet, or no longer there")
        return False
    if tags.get("location") == "underground" or tags.get("layer", "0").startswith("-"):
        omissions.add("buildings", _element(area), "below the ground")
        return False
    return True


def _without_parts(
    outlines: Sequence[MappedArea],
    parts: Sequence[MappedArea],
) -> list[list[Polygon] | None]:
    """The rest of each outline that no building part covers.

    Parameters
    ----------
    outlines : sequence of MappedArea
        Buildings.
    parts : sequence of MappedArea
        Building parts, each belonging to the outline in which it lies.

    Returns
    -------
    rests : list of (list of Polygon or None)
        None: the outline has no parts; empty: they cover it.
    """
    rests: list[list[Polygon] | None] = [None] * len(outlines)
    if not outlines or not parts:
        return rests
    shapes = [make_valid(area.polygon) for area in outlines]
    part_shapes = [make_valid(area.polygon) for area in parts]
    tree = STRtree(shapes)
    inside = tree.query(shapely.point_on_surface(part_shapes), predicate="within")
    by_outline: dict[int, list[BaseGeometry]] = defaultdict(list)
    for part, outline in inside.T.tolist():
        by_outline[outline].append(part_shapes[part])
    least = DEFAULTS["building"]["parts_cover"]
    for outline, members in by_outline.items():
        rest = shapes[outline].difference(shapely.union_all(members))
        is_covered = rest.area <= (1.0 - least) * shapes[outline].area
        if is_covered:
            rests[outline] = []
        else:
            rests[outline] = polygons_of(rest, above_m2=_LEAST_M2)
    return rests


def _pieces(
    area: MappedArea, shapes: Sequence[Polygon], name: str
) -> Iterator[MappedArea]:
    """Areas with the shapes that are left of one area."""
    for number, shape in enumerate(shapes):
        yield replace(area, id=numbered(name, number, " "), polygon=shape)


def _solid(
    area: MappedArea, passages: "_Passages", omissions: Omissions
) -> Iterator[Thing]:
    """Solids of a building: around a passage through it, and above that.

    Parameters
    ----------
    area : MappedArea
        The building.
    passages : '_Passages'
        Ways that lead through buildings.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Yields
    ------
    thing : Thing
        One prism for each piece.
    """
    span = _span(area, omissions)
    if span is None:
        return
    ways, clear_m = passages.through(area)
    bottom_m, top_m, _ = span
    if ways is None or clear_m <= bottom_m:
        yield from _prism(area, span, omissions)
        return
    whole = make_valid(area.polygon)
    beside = polygons_of(whole.difference(ways), above_m2=_LEAST_M2)
    over: list[Polygon] = []
    if clear_m < top_m:
        over = polygons_of(whole.intersection(ways), above_m2=_LEAST_M2)
    for piece in _pieces(area, beside, area.id):
        yield from _prism(piece, span, omissions)
    for piece in _pieces(area, over, f"{area.id} over a passage"):
        yield from _prism(piece, (clear_m, *span[1:]), omissions)


def _prism(area: MappedArea, span: "_Span", omissions: Omissions) -> Iterator[Thing]:
    """Prism over an area; an outline without area is noted.

    Parameters
    ----------
    area : MappedArea
        Footprint.
    span : '_Span'
        Bottom and top, and whether they are assumed. [m]
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Yields
    ------
    thing : Thing
        None if the outline cannot be extruded.
    """
    bottom_m, top_m, is_assumed = span
    where = _element(area)
    try:
        mesh = extrude_polygon(
            area.polygon,
            bottom_m=bottom_m,
            top_m=top_m,
            where=where,
        )
    except InputError as error:
        omissions.add("buildings", where, f"its outline has {error.got}")
        return
    yield Thing.of(area.id, "building", mesh, is_height_assumed=is_assumed)


# ---------- heights
def _span(area: MappedArea, omissions: Omissions) -> _Span | None:
    """Bottom and top of a building, and whether they are assumed.

    Parameters
    ----------
    area : MappedArea
        The building.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    span : (float, float, bool) or None
        None: the heights make no sense, which is noted. [m]
    """
    usual = DEFAULTS["building"]
    kind = _building_kind(area.tags)
    is_roof = kind in usual["clear_heights_m"]
    if is_roof:
        least_m = usual["roof_thickness_m"]
    else:
        least_m = usual["storey_height_m"]
    top_m = _top_m(area, omissions)
    bottom_m = _bottom_m(area.tags)
    clear_m = 0.0
    # Without a tagged bottom, what stands on stilts begins at its clear height.
    if bottom_m is None:
        clear_m = _clear_height_m(kind, area.tags)
        bottom_m = clear_m
        if clear_m > 0.0 and top_m is not None:
            below_m = max(top_m - least_m, 0.0)
            if is_roof:
                bottom_m = below_m
            else:
                bottom_m = min(clear_m, below_m)
    is_assumed = top_m is None or clear_m > 0.0
    if top_m is None:
        default_m = usual["default_heights_m"].get(kind, usual["default_height_m"])
        if default_m > bottom_m and not is_roof:
            top_m = default_m
        else:
            top_m = bottom_m + least_m
    if bottom_m >= top_m:
        omissions.add("buildings", _element(area), "its roof is not above its floor")
        return None
    return bottom_m, top_m, is_assumed


def _building_kind(tags: Tags) -> str:
    """Kind of a building or building part; "yes": not known."""
    kind = tags.get("building:part", "yes")
    if kind == "yes":
        return tags.get("building", "yes")
    return kind


def _clear_height_m(kind: str, tags: Tags) -> float:
    """Height at which a building on stilts begins; 0: on the ground.

    Parameters
    ----------
    kind : str
        Kind of the building.
    tags : Tags
        Tags of the element, by key.

    Returns
    -------
    clear_m : float
        Above the ground. [m]
    """
    usual = DEFAULTS["building"]
    clear_m = float(usual["clear_heights_m"].get(kind, usual["clear_height_m"]))
    is_on_stilts = kind == "bridge" or kind in usual["clear_heights_m"]
    return clear_m * max(level(tags), int(is_on_stilts))


def _top_m(area: MappedArea, omissions: Omissions) -> float | None:
    """Height of a roof in metres; None: the tags give none.

    A height counts first, then storeys and the height of the roof.

    Parameters
    ----------
    area : MappedArea
        The building.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    top_m : float or None
        Above the ground. [m]
    """
    tags = area.tags
    usual = DEFAULTS["building"]
    note = partial(omissions.add, "buildings", _element(area))
    keys = ("height", "building:height", "est_height")
    bounds_m = (1e-9, usual["max_height_m"])
    height_m = tagged_length_m(tags, keys, bounds_m, note, "the next best")
    if height_m is not None:
        return height_m
    storey_m = usual["storey_height_m"]
    levels = _levels(tags, "building:levels")
    roof_m = parse_length_m(tags.get("roof:height", ""))
    if roof_m is None or roof_m > usual["max_height_m"]:
        roof_m = storey_m * (_levels(tags, "roof:levels") or 0.0)
    if levels is not None and storey_m * levels + roof_m > 0.0:
        return float(storey_m * levels + roof_m)
    return None


def _bottom_m(tags: Tags) -> float | None:
    """Tagged height of a building's bottom in metres; None: none is given."""
    usual = DEFAULTS["building"]
    for key in ("min_height", "building:min_height"):
        height_m = parse_length_m(tags.get(key, ""))
        if height_m is not None and height_m <= usual["max_height_m"]:
            return height_m
    storeys = [_levels(tags, key) for key in ("building:min_level", "min_level")]
    known = [float(usual["storey_height_m"] * n) for n in storeys if n is not None]
    if known:
        return known[0]
    return None


def _levels(tags: Tags, key: str) -> float | None:
    """Number of storeys in a tag, or None if it makes no sense."""
    return parse_number(tags.get(key, ""), highest=DEFAULTS["building"]["max_levels"])


# ---------- passages
class _Passages:
    """Ways that lead through buildings: streets and paths on the ground."""

    def __init__(self, network: Network) -> None:
        usual = DEFAULTS["building"]
        # Area of each way, its clear height, and whether it is marked; else only gates
        # are open.
        self._ways: list[tuple[BaseGeometry, float, bool]] = []
        for edge in network.edges:
            if edge.level == 0:
                self._add(
                    edge.middle_m,
                    edge.section.width_m,
                    edge.tags,
                    usual["clear_height_m"],
                )
        for way in network.elements.ways:
            if way.tags.get("highway") in usual["foot_ways"] and _leads_through(
                way.tags
            ):
                for line_m in lines_of(way, network.elements):
                    width_m = usual["foot_way_width_m"]
                    self._add(line_m, width_m, way.tags, usual["foot_clear_height_m"])
        self._tree = STRtree([strip for strip, *_ in self._ways])

    def _add(
        self,
        line_m: FloatArray,
        width_m: float,
        tags: Tags,
        clear_m: float,
    ) -> None:
        """Add a way of a given width and the clear height above it."""
        strip = LineString(line_m).buffer(0.5 * width_m, cap_style="flat")
        tagged_m = parse_length_m(tags.get("maxheight", ""))
        self._ways.append((strip, tagged_m or clear_m, _leads_through(tags)))

    def through(self, area: MappedArea) -> tuple[BaseGeometry | None, float]:
        """Area of the ways that lead through a building, and their clear height.

        Parameters
        ----------
        area : MappedArea
            The building.

        Returns
        -------
        ways : BaseGeometry or None
            None: nothing leads through it.
        clear_m : float
            Height that must stay free above the ways. [m]
        """
        is_gate = (
            area.tags.get("historic") in WORDS["gates"]
            or _building_kind(area.tags) in WORDS["gates"]
        )
        whole = make_valid(area.polygon)
        near = (self._ways[index] for index in self._tree.query(area.polygon).tolist())
        found = []
        for strip, clear_m, is_marked in near:
            if not (is_gate or is_marked):
                continue
            if whole.intersection(strip).area > 1.0:
                found.append((strip, clear_m))
        if not found:
            return None, 0.0
        ways = shapely.union_all([strip for strip, _ in found])
        return ways, max(clear_m for _, clear_m in found)


def _leads_through(tags: Tags) -> bool:
    """True if a way is tagged as a passage through a building."""
    return (
        tags.get("tunnel") == "building_passage"
        or tags.get("covered") in WORDS["covered"]
    )


# ---------- bridges over roads
def find_bridges(network: Network, reaches: Sequence[Reach]) -> Iterator[Thing]:
    """Decks of bridges over roads on the ground.

    A deck is left out where a junction on the bridge is near: it would hide
    that.

    Parameters
    ----------
    network : Network
        Roads for cars.
    reaches : sequence of Reach
        Parts of streets that have lanes.

    Yields
    ------
    thing : Thing
        Of the class "building".
    """
    usual = DEFAULTS["bridge"]
    elements = network.elements
    below = STRtree(
        [LineString(edge.points_m) for edge in network.edges if edge.level == 0]
    )

    def is_over_road(line_m: FloatArray, tags: Tags) -> bool:
        """True if a way is a bridge that crosses a road on the ground."""
        is_bridge = level(tags) > 0 and is_yes(tags.get("bridge"))
        if not is_bridge:
            return False
        crossed = below.query(LineString(line_m), predicate="crosses")
        return len(crossed) > 0

    # Bridges of streets.
    for reach in reaches:
        breaks_m = reach.street.breaks_m
        for index, (edge, _) in enumerate(reach.street.parts):
            if not is_over_road(edge.points_m, edge.tags):
                continue
            from_m = breaks_m[index] - reach.begin_m
            to_m = reach.end_m - breaks_m[index + 1]
            is_near_begin = reach.from_junction and from_m < usual["junction_m"]
            is_near_end = reach.to_junction and to_m < usual["junction_m"]
            if is_near_begin or is_near_end:
                why = "a junction is near on it: its deck is left out"
                elements.omissions.add("bridges", f"way {edge.way_id}", why)
            else:
                yield from _deck(
                    edge.id,
                    edge.middle_m,
                    edge.section.width_m,
                    edge.level,
                )
    # Bridges of railways and footways.
    for way in elements.ways:
        is_rail = way.tags.get("railway") in usual["railways"]
        if is_rail or way.tags.get("highway") in DEFAULTS["building"]["foot_ways"]:
            width_m = usual["foot_width_m"]
            if is_rail:
                width_m = usual["track_width_m"]
            for number, line_m in enumerate(lines_of(way, elements)):
                if is_over_road(line_m, way.tags):
                    name = numbered(f"w{way.id}", number)
                    yield from _deck(name, line_m, width_m, level(way.tags))


def _deck(name: str, line_m: FloatArray, width_m: float, layer: int) -> Iterator[Thing]:
    """Deck of a bridge along a line.

    Parameters
    ----------
    name : str
        Id of the way.
    line_m : (n, 2) float
        Its axis. [m]
    width_m : float
        Full width. [m]
    layer : int
        Its layer, 1 or more.

    Yields
    ------
    thing : Thing
        As high above the ground as its layer.
    """
    bottom_m = DEFAULTS["building"]["clear_height_m"] * layer
    area = LineString(line_m).buffer(0.5 * width_m, cap_style="flat")
    top_m = bottom_m + DEFAULTS["bridge"]["thickness_m"]
    for number, part in enumerate(polygons_of(area)):
        mesh = extrude_polygon(part, bottom_m=bottom_m, top_m=top_m, where=name)
        deck_id = numbered(f"{name} bridge", number, " ")
        yield Thing.of(deck_id, "building", mesh, is_height_assumed=True)
