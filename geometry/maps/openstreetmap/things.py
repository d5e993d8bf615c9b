"""Walls, hedges, trees, poles and crosswalks."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain

import numpy as np
import shapely
from shapely import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import InputError
from ...lines import along_m, points_at, unit
from ..source_map import (
    Pole,
    Thing,
    extrude_polygon,
    join,
    polygons_of,
    unit_ball,
    unit_cylinder,
)
from .elements import DEFAULTS, Elements, Relation, Tags, Way, numbered, parse_length_m
from .junctions import Reach
from .lanes import Note
from .network import Edge, Network, axis_points, known_runs, level, lines_of

# ---------- walls and hedges
_KINDS = ("wall", "city_wall", "retaining_wall", "fence", "hedge")
_WOODS = (("natural", "wood"), ("natural", "scrub"), ("landuse", "forest"))
_TRUNK_SIDES = 8
_POLES = ("mast", "utility_pole", "pole")
_NEAR_JUNCTION_M = 40.0  # a signal farther from any junction is one for both directions
_NO_POLE = ("wall", "wall_mounted", "building", "ceiling", "suspended", "wire", "ground", "bridge")
_Place = tuple[Reach, float]  # a street and how far along it [m]
_FOOTWAYS = ("footway", "path", "pedestrian")
_PARALLEL = 0.8  # cosine: two lines that differ more are not one crosswalk
_LEAST_M = 0.5  # of a footway on a carriageway


def find_barriers(elements: Elements) -> Iterator[Thing]:
    """Walls, hedges and boarded fences; transparent fences and damaged outlines are noted."""
    for way in elements.ways:
        kind = way.tags.get("barrier", "")
        if kind not in _KINDS:
            continue
        note = partial(elements.omissions.add, "barriers", f"way {way.id}")
        fence = way.tags.get("fence_type", way.tags.get("material", ""))
        if kind == "fence" and fence not in DEFAULTS["barrier"]["opaque_fences"]:
            why = "seen through: no fence_type that says otherwise"
            elements.omissions.add("fences", f"way {way.id}", why)
            continue
        limits = DEFAULTS["barrier"]
        tagged_m = _tagged_m(
            way.tags, ("height", "est_height"), (0.01, limits["max_height_m"]), note
        )
        thick_m = _tagged_m(
            way.tags, ("thickness", "width"), (0.01, limits["max_thickness_m"]), note
        )
        top_m = float(limits[kind]["height_m"]) if tagged_m is None else tagged_m
        thick_m = float(limits[kind]["thickness_m"]) if thick_m is None else thick_m
        for number, footprint in enumerate(_footprints(way, elements, thick_m)):
            try:
                mesh = extrude_polygon(footprint, bottom_m=0.0, top_m=top_m, where=f"way {way.id}")
            except InputError as error:
                note(f"its outline has {error.got}")
                continue
            name = numbered(f"w{way.id} {kind}", number, " ")
            class_name = "vegetation" if kind == "hedge" else "wall"
            yield Thing.of(name, class_name, mesh, is_height_assumed=tagged_m is None)


def _footprints(way: Way, elements: Elements, thickness_m: float) -> Iterator[Polygon]:
    if way.tags.get("area") == "yes" and way.is_closed and (way.rows >= 0).all():
        yield from polygons_of(Polygon(elements.positions_m[way.rows]).buffer(0.0))
        return
    for line_m in lines_of(way, elements):
        strip = LineString(line_m).buffer(0.5 * thickness_m, cap_style="flat", join_style="mitre")
        yield from polygons_of(strip)


def _tagged_m(
    tags: Tags, keys: Sequence[str], bounds_m: tuple[float, float], note: Note
) -> float | None:
    """First length of some tags within bounds; the others are noted."""
    for key in keys:
        if key in tags:
            size_m = parse_length_m(tags[key])
            if size_m is not None and bounds_m[0] <= size_m <= bounds_m[1]:
                return size_m
            note(f"{key} makes no sense; the usual one taken")
    return None


# ---------- trees


def find_trees(elements: Elements) -> Iterator[Thing]:
    """Trees as an upright trunk and an ellipsoid crown, each closed; woods are noted."""
    add = elements.omissions.add
    for row, tags in elements.node_tags.items():
        if tags.get("natural") == "tree":
            node_id = int(elements.node_ids[row])
            note = partial(add, "trees", f"node {node_id}")
            yield _tree(f"n{node_id}", elements.positions_m[row], tags, note)
    tagged: tuple[Way | Relation, ...] = (*elements.ways, *elements.relations)
    for one in tagged:
        element = f"{'way' if isinstance(one, Way) else 'relation'} {one.id}"
        if isinstance(one, Way) and one.tags.get("natural") == "tree_row":
            feet = chain.from_iterable(_along(line_m) for line_m in lines_of(one, elements))
            for number, foot in enumerate(feet):
                note = partial(add, "trees", element)
                yield _tree(f"w{one.id} tree {number}", foot, one.tags, note)
        if any(one.tags.get(key) == value for key, value in _WOODS):
            add("woods", element, "the positions of its trees and bushes are unknown")


def _along(line_m: FloatArray) -> FloatArray:
    """Positions of the trees of a row, evenly from its start to its end, (n, 2)."""
    usual, along = DEFAULTS["tree"], along_m(line_m)
    n_trees = min(round(float(along[-1]) / usual["row_spacing_m"]) + 1, usual["max_in_row"])
    return points_at(line_m, np.linspace(0.0, along[-1], max(n_trees, 2)))


def _tree(name: str, foot_m: FloatArray, tags: Tags, note: Note) -> Thing:
    usual = DEFAULTS["tree"]

    def size_m(keys: Sequence[str], highest_m: float) -> float | None:
        return _tagged_m(tags, keys, (0.05, highest_m), note)

    tagged_m = size_m(("height", "est_height"), usual["max_height_m"])
    height_m = usual["height_m"] if tagged_m is None else tagged_m
    crown_m = size_m(("diameter_crown",), usual["max_crown_m"]) or usual["crown_diameter_m"]
    girth_m = size_m(("circumference",), np.pi * usual["max_trunk_m"])
    trunk_m = usual["trunk_diameter_m"] if girth_m is None else girth_m / np.pi
    trunk_m = min(trunk_m, crown_m)
    base_m = min(usual["crown_base_m"], usual["crown_base_share"] * height_m)
    ball, ball_faces = unit_ball()
    middle_m = 0.5 * (base_m + height_m)
    crown = ball * [0.5 * crown_m, 0.5 * crown_m, height_m - middle_m] + [0.0, 0.0, middle_m]
    trunk, trunk_faces = unit_cylinder(_TRUNK_SIDES)
    trunk = trunk * [0.5 * trunk_m, 0.5 * trunk_m, middle_m]
    vertices, triangles = join([(trunk, trunk_faces), (crown, ball_faces)])
    mesh = vertices + np.append(foot_m, 0.0), triangles
    return Thing.of(name, "vegetation", mesh, is_height_assumed=tagged_m is None)


# ---------- poles


def find_poles(network: Network, reaches: Sequence[Reach]) -> tuple[Pole, ...]:
    """Poles next to roads that could carry sensors; lamps without a pole are noted.

    Signals and signs that are mapped on a road stand at the kerb on the side of traffic: at the
    stop line, or where an arm begins if that is farther out; those where roads meet at every arm.
    """
    places: dict[int, list[_Place]] = defaultdict(list)  # nodes of junctions lie on all arms
    for reach in reaches:
        for row, station_m in zip(reach.street.rows, reach.street.stations_m, strict=True):
            places[int(row)].append((reach, float(station_m)))
    elements, poles = network.elements, []
    for row, tags in elements.node_tags.items():
        kind = _kind(tags)
        if not kind:
            continue
        node_id = int(elements.node_ids[row])
        support = tags.get("support") or tags.get("lamp_mount") or tags.get("camera:mount", "")
        if support in _NO_POLE:
            why = "on a wall or a wire, without a pole"
            elements.omissions.add(f"{kind}s", f"node {node_id}", why)
            continue
        feet, assumed = [elements.positions_m[row]], ""
        if kind in ("traffic light", "sign") and (row in network.ends or row in places):
            feet = _at_kerbs(places.get(row, ()), tags, keeps_left=network.keeps_left)
            assumed = "mapped on the road: a pole at the kerb is assumed"
            if len(feet) > 1:
                poles_there = f"{len(feet)} poles at the kerbs are assumed"
                assumed = f"node {node_id} is mapped on the road: {poles_there}"
            if not feet:
                why = "inside a junction, where nobody stops"
                elements.omissions.add(f"{kind}s", f"node {node_id}", why)
        height_m = parse_length_m(tags.get("height", ""))
        if not height_m or height_m > DEFAULTS["pole"]["max_height_m"]:
            height_m = None
        for number, foot in enumerate(feet):
            name, position = numbered(f"n{node_id}", number), np.append(foot, 0.0)
            poles.append(
                Pole(id=name, kind=kind, position_m=position, height_m=height_m, assumed=assumed)
            )
    return tuple(poles)


def _kind(tags: Tags) -> str:
    if tags.get("highway") == "street_lamp":
        return "lamp post"
    if tags.get("highway") == "traffic_signals":
        return "traffic light"
    if "traffic_sign" in tags or tags.get("highway") == "traffic_sign":
        return "sign"
    if tags.get("man_made") in _POLES or tags.get("power") == "pole":
        return "pole"
    if tags.get("man_made") == "surveillance" and tags.get("camera:mount") == "pole":
        return "pole"
    return ""


def _at_kerbs(places: Sequence[_Place], tags: Tags, *, keeps_left: bool) -> list[FloatArray]:
    """Feet of the poles of one mapped signal or sign."""
    feet: list[FloatArray] = []
    for reach, station_m in places:
        for is_forward in _directions(reach, station_m, tags):
            # Beside the stop line, or where the arm begins if the stop line lies inside.
            at_m = float(np.clip(station_m, min(reach.begin_m, reach.end_m), reach.end_m))
            section = reach.street.section_at(at_m)
            sign = 1.0 if is_forward == keeps_left else -1.0  # left of the street
            beside_m = 0.5 * section.width_m + DEFAULTS["pole"]["beyond_kerb_m"]
            (middle,), (across,) = axis_points(reach.street, [at_m])
            foot = middle + sign * beside_m * across
            if all(np.hypot(*(foot - other)) > 1.0 for other in feet):
                feet.append(foot)
    return feet


def _directions(reach: Reach, station_m: float, tags: Tags) -> list[bool]:
    """Directions along a street in which cars see a signal: True is from its start to its end."""
    street = reach.street
    index = street.part_at(station_m)
    edge, is_along = street.parts[index]
    driven = [
        is_forward
        for is_forward in (True, False)
        if street.sections[index].lanes(is_forward=is_forward)
    ]
    if station_m <= 0.0 and reach.from_junction:
        return [one for one in driven if not one]
    if station_m >= street.length_m and reach.to_junction:
        return [one for one in driven if one]
    text = tags.get("traffic_signals:direction") or tags.get("traffic_sign:direction")
    text = text or tags.get("direction", "")
    if text in ("forward", "backward"):
        # Along the way as mapped; one-way roads that run against it have been turned round.
        is_way = (text == "forward") == (edge.tags.get("oneway:turned") != "yes")
        return [one for one in driven if one == (is_way == is_along)]
    if text == "both" or len(driven) < 2:
        return driven
    to_begin = station_m if reach.from_junction else np.inf
    to_end = street.length_m - station_m if reach.to_junction else np.inf
    if min(to_begin, to_end) > _NEAR_JUNCTION_M:
        return driven
    return [bool(to_end <= to_begin)]


# ---------- crosswalks


def find_crosswalks(network: Network) -> FloatArray:
    """Lines (n, 2, 2) on which pedestrians cross carriageways, a little beyond the kerbs.

    Where a mapped footway leads over roads it is a straight line along it over each of them;
    otherwise it runs across the road at the mapped point. Crossings without a road are noted.
    """
    limits, elements = DEFAULTS["crosswalk"], network.elements
    lines: list[FloatArray] = []
    covered: set[int] = set()  # nodes that lie on a mapped footway over a road
    tree = shapely.STRtree([shapely.linestrings(edge.points_m) for edge in network.edges])
    for way in elements.ways:
        if way.tags.get("footway") != "crossing" or way.tags.get("highway") not in _FOOTWAYS:
            continue
        for rows in known_runs(way, elements):
            walk = LineString(elements.positions_m[rows])
            edges = [
                network.edges[index]
                for index in tree.query(walk, predicate="intersects").tolist()
                if network.edges[index].level == level(way.tags)
            ]
            found = [
                line
                for line in _over_roads(walk, edges)
                if 1.0 < np.hypot(*(line[1] - line[0])) <= limits["max_length_m"]
            ]
            if not found:
                why = "no road for cars below it"
                elements.omissions.add("crossings", f"way {way.id}", why)
                continue
            covered.update(rows.tolist())
            lines += found
    at_row: dict[int, tuple[int, int]] = {}  # an edge through each node, and the node's place in it
    for index, edge in enumerate(network.edges):
        for at, row in enumerate(edge.rows.tolist()):
            if row not in at_row or network.edges[at_row[row][0]].is_service:
                at_row[row] = (index, at)
    for row, tags in elements.node_tags.items():
        if tags.get("highway") != "crossing" or tags.get("crossing") == "no":
            continue
        if row in covered or row not in at_row:
            continue
        lines.append(_across(network, row, at_row[row], limits["beyond_kerb_m"]))
    taken: list[FloatArray] = []
    for line in lines:
        if not any(_is_same(line, other) for other in taken):
            taken.append(line)
    return np.array(taken).reshape(-1, 2, 2)


def _over_roads(walk: LineString, edges: Sequence[Edge]) -> Iterator[FloatArray]:
    """A line (2, 2) over each road that a footway crosses, with all its carriageways."""
    limits = DEFAULTS["crosswalk"]
    joined: list[tuple[LineString, BaseGeometry]] = []  # parts of the footway, and carriageways
    crossed = [
        (part, area)
        for edge in edges
        for area in [LineString(edge.points_m).buffer(0.5 * edge.section.width_m, cap_style="flat")]
        for part in _parts_over(walk, edge, area)
    ]
    crossed.sort(key=lambda pair: walk.project(shapely.Point(pair[0].coords[0])))
    for part, carriageway in crossed:
        if joined and (
            part.distance(joined[-1][0]) <= limits["median_m"]
            and abs(_direction(part) @ _direction(joined[-1][0])) > _PARALLEL
        ):
            before, area = joined.pop()
            whole = LineString([before.coords[0], part.coords[-1]])
            part, carriageway = whole, area.union(carriageway)
        joined.append((part, carriageway))
    for part, carriageway in joined:
        yield _from_kerb_to_kerb(part, carriageway, limits["beyond_kerb_m"])


def _parts_over(walk: LineString, edge: Edge, carriageway: BaseGeometry) -> Iterator[LineString]:
    """Stretches of a footway on a carriageway that meet the road's axis."""
    axis = LineString(edge.points_m)
    on_road = shapely.line_merge(shapely.intersection(walk, carriageway))
    for part in shapely.get_parts(on_road):
        if isinstance(part, LineString) and part.length > _LEAST_M and part.distance(axis) < 1e-6:
            is_along = walk.project(shapely.Point(part.coords[0])) <= walk.project(
                shapely.Point(part.coords[-1])
            )
            yield part if is_along else part.reverse()


def _direction(line: LineString) -> FloatArray:
    begin, end = np.asarray(line.coords)[[0, -1], :2]
    return unit(end - begin)


def _from_kerb_to_kerb(part: LineString, carriageway: BaseGeometry, beyond_m: float) -> FloatArray:
    """The straight line (2, 2) through a footway's ends on a carriageway, beyond both kerbs."""
    begin, along = np.asarray(part.coords)[0, :2], _direction(part)
    reach_m = 2.0 * DEFAULTS["crosswalk"]["max_length_m"]
    ray = LineString([begin - reach_m * along, begin + reach_m * along])
    stations = [
        np.sort((shapely.get_coordinates(piece) - begin) @ along)
        for piece in shapely.get_parts(shapely.intersection(ray, carriageway))
    ]
    own = [ends for ends in stations if ends[0] < part.length and ends[-1] > 0.0]
    low, high = min(ends[0] for ends in own), max(ends[-1] for ends in own)
    return begin + np.array([[low - beyond_m], [high + beyond_m]]) * along


def _across(network: Network, row: int, place: tuple[int, int], beyond_m: float) -> FloatArray:
    """A line from kerb to kerb and a little farther, square to the road at one of its nodes."""
    index, at = place
    edge = network.edges[index]
    points = edge.points_m
    before, after = points[max(at - 1, 0)], points[min(at + 1, len(points) - 1)]
    ends = network.ends.get(row, ())
    if len(ends) == 2 and {one for one, _ in ends} != {index}:
        # The way ends here and another goes on: the road bends between them.
        other, is_start = next(end for end in ends if end[0] != index)
        beyond = network.edges[other].points_m[1 if is_start else -2]
        before, after = (beyond, after) if at == 0 else (before, beyond)
    steps = [
        step / np.hypot(*step)
        for step in (points[at] - before, after - points[at])
        if np.hypot(*step) > 1e-6
    ]
    along = np.sum(steps, axis=0)
    along = steps[0] if np.hypot(*along) < 1e-6 else along / np.hypot(*along)
    half_m = 0.5 * edge.section.width_m + beyond_m
    left = np.array([-along[1], along[0]])
    return np.asarray(points[at] + half_m * np.stack([-left, left]))


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    """True if two lines are one crosswalk that is mapped in two ways."""
    apart_m = np.hypot(*(one.mean(axis=0) - other.mean(axis=0)))
    if apart_m > DEFAULTS["crosswalk"]["same_m"]:
        return False
    step, other_step = one[1] - one[0], other[1] - other[0]
    cosine = abs(step @ other_step) / (np.hypot(*step) * np.hypot(*other_step))
    return bool(cosine > _PARALLEL)
