"""Buildings, from the ground or above those who pass below; and bridges over roads."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely import LineString, Polygon, STRtree, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import FloatArray
from ...errors import InputError
from ..source_map import Omissions, Thing, extrude, extrude_polygon, polygons_of
from .elements import (
    DEFAULTS,
    Area,
    Tags,
    find_areas,
    is_yes,
    numbered,
    parse_length_m,
    parse_number,
)
from .junctions import Reach
from .network import Network, level, lines_of

_NOT_THERE = ("no", "construction", "proposed", "demolished", "razed", "collapsed")
_COVERED = ("yes", "arcade", "colonnade")
_LEAST_M2 = 1.0  # of what is left of a building
_GATES = ("gate", "gatehouse", "city_gate")
_Span = tuple[float, float, bool]  # bottom and top above the ground [m], whether they are assumed


def find_buildings(network: Network) -> Iterator[Thing]:
    """Buildings as prisms from the ground, or from their tagged bottom.

    A building with parts is its parts, and the rest of it unless they cover it. Roofs on stilts
    begin above those who pass below, buildings over ways that lead through them above the passage.
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
    for area, rest in zip(outlines, _without_parts(outlines, parts), strict=True):
        pieces = [area] if rest is None else _pieces(area, rest, f"{area.id} beside its parts")
        for piece in pieces:
            yield from _solid(piece, passages, omissions)


def _element(area: Area) -> str:
    kind = "relation" if area.id.startswith("r") else "way"
    return f"{kind} {area.id[1:].partition('.')[0]}"


def _stands(area: Area, omissions: Omissions) -> bool:
    """It exists, above the ground, and can be seen."""
    tags = area.tags
    kinds = [tags[key] for key in ("building", "building:part") if key in tags]
    if all(kind == "no" for kind in kinds):
        return False
    if any(kind in _NOT_THERE for kind in kinds):
        omissions.add("buildings", _element(area), "not built yet, or no longer there")
        return False
    if tags.get("location") == "underground" or tags.get("layer", "0").startswith("-"):
        omissions.add("buildings", _element(area), "below the ground")
        return False
    return True


def _without_parts(outlines: Sequence[Area], parts: Sequence[Area]) -> list[list[Polygon] | None]:
    """The rest of each outline that no part covers; None: it has no parts."""
    rests: list[list[Polygon] | None] = [None] * len(outlines)
    if not outlines or not parts:
        return rests
    shapes = [make_valid(area.polygon) for area in outlines]
    part_shapes = [make_valid(area.polygon) for area in parts]
    tree = STRtree(shapes)
    inside = tree.query(
        [shapely.point_on_surface(shape) for shape in part_shapes], predicate="within"
    )
    by_outline: dict[int, list[BaseGeometry]] = defaultdict(list)
    for part, outline in inside.T.tolist():
        by_outline[outline].append(part_shapes[part])
    least = DEFAULTS["building"]["parts_cover"]
    for outline, members in by_outline.items():
        rest = shapes[outline].difference(shapely.union_all(members))
        is_covered = rest.area <= (1.0 - least) * shapes[outline].area
        rests[outline] = [] if is_covered else polygons_of(rest, above_m2=_LEAST_M2)
    return rests


def _pieces(area: Area, shapes: Sequence[Polygon], name: str) -> Iterator[Area]:
    for number, shape in enumerate(shapes):
        outer_m, *holes_m = (np.asarray(r.coords) for r in (shape.exterior, *shape.interiors))
        piece_id = numbered(name, number, " ")
        yield replace(area, id=piece_id, outer_m=outer_m, holes_m=tuple(holes_m))


def _solid(area: Area, passages: "_Passages", omissions: Omissions) -> Iterator[Thing]:
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
    over = polygons_of(whole.intersection(ways), above_m2=_LEAST_M2) if clear_m < top_m else []
    for piece in _pieces(area, beside, area.id):
        yield from _prism(piece, span, omissions)
    for piece in _pieces(area, over, f"{area.id} over a passage"):
        yield from _prism(piece, (clear_m, *span[1:]), omissions)


def _prism(area: Area, span: "_Span", omissions: Omissions) -> Iterator[Thing]:
    bottom_m, top_m, is_assumed = span
    heights, where = {"bottom_m": bottom_m, "top_m": top_m}, _element(area)
    try:
        mesh = extrude(area.outer_m, **heights, holes_m=area.holes_m, where=where)
    except InputError as error:
        omissions.add("buildings", where, f"its outline has {error.got}")
        return
    yield Thing.of(area.id, "building", mesh, is_height_assumed=is_assumed)


# ---------- heights


def _span(area: Area, omissions: Omissions) -> _Span | None:
    """Heights of a building; None: they make no sense, which is noted."""
    usual, kind = DEFAULTS["building"], _kind(area.tags)
    is_roof = kind in usual["clear_heights_m"]
    least_m = usual["roof_thickness_m" if is_roof else "storey_height_m"]
    top_m, bottom_m, clear_m = _top_m(area, omissions), _bottom_m(area.tags), 0.0
    if bottom_m is None:
        bottom_m = clear_m = _clear_height_m(kind, area.tags)
        if clear_m > 0.0 and top_m is not None:
            below_m = max(top_m - least_m, 0.0)
            bottom_m = below_m if is_roof else min(clear_m, below_m)
    is_assumed = top_m is None or clear_m > 0.0
    if top_m is None:
        default_m = usual["default_heights_m"].get(kind, usual["default_height_m"])
        top_m = default_m if default_m > bottom_m and not is_roof else bottom_m + least_m
    if bottom_m >= top_m:
        omissions.add("buildings", _element(area), "its roof is not above its floor")
        return None
    return bottom_m, top_m, is_assumed


def _kind(tags: Tags) -> str:
    kind = tags.get("building:part", "yes")
    return tags.get("building", "yes") if kind == "yes" else kind


def _clear_height_m(kind: str, tags: Tags) -> float:
    """How high what stands on stilts or above the ground begins; 0: it stands on the ground."""
    usual = DEFAULTS["building"]
    clear_m = float(usual["clear_heights_m"].get(kind, usual["clear_height_m"]))
    return clear_m * max(level(tags), int(kind == "bridge" or kind in usual["clear_heights_m"]))


def _top_m(area: Area, omissions: Omissions) -> float | None:
    tags, usual = area.tags, DEFAULTS["building"]
    for key in ("height", "building:height", "est_height"):
        if key in tags:
            height_m = parse_length_m(tags[key])
            if height_m is not None and 0.0 < height_m <= usual["max_height_m"]:
                return height_m
            omissions.add("buildings", _element(area), f"{key} makes no sense; the next best taken")
    storey_m = usual["storey_height_m"]
    levels = _levels(tags, "building:levels")
    roof_m = parse_length_m(tags.get("roof:height", ""))
    if roof_m is None or roof_m > usual["max_height_m"]:
        roof_m = storey_m * (_levels(tags, "roof:levels") or 0.0)
    if levels is not None and storey_m * levels + roof_m > 0.0:
        return float(storey_m * levels + roof_m)
    return None


def _bottom_m(tags: Tags) -> float | None:
    usual = DEFAULTS["building"]
    for key in ("min_height", "building:min_height"):
        height_m = parse_length_m(tags.get(key, ""))
        if height_m is not None and height_m <= usual["max_height_m"]:
            return height_m
    storeys = [_levels(tags, key) for key in ("building:min_level", "min_level")]
    known = [float(usual["storey_height_m"] * n) for n in storeys if n is not None]
    return known[0] if known else None


def _levels(tags: Tags, key: str) -> float | None:
    return parse_number(tags.get(key, ""), highest=DEFAULTS["building"]["max_levels"])


# ---------- passages
class _Passages:
    """Ways on the ground that lead through buildings."""

    def __init__(self, network: Network) -> None:
        usual = DEFAULTS["building"]
        self._strips: list[BaseGeometry] = []
        self._clear_m: list[float] = []
        self._is_marked: list[bool] = []  # by itself; else only gates are open there
        for edge in network.edges:
            if edge.level == 0:
                self._add(edge.points_m, edge.section.width_m, edge.tags, usual["clear_height_m"])
        for way in network.elements.ways:
            if way.tags.get("highway") in usual["foot_ways"] and _leads_through(way.tags):
                for line_m in lines_of(way, network.elements):
                    width_m = usual["foot_way_width_m"]
                    self._add(line_m, width_m, way.tags, usual["foot_clear_height_m"])
        self._tree = STRtree(self._strips)

    def _add(self, line_m: FloatArray, width_m: float, tags: Tags, clear_m: float) -> None:
        tagged_m = parse_length_m(tags.get("maxheight", ""))
        self._strips.append(LineString(line_m).buffer(0.5 * width_m, cap_style="flat"))
        self._clear_m.append(tagged_m or clear_m)
        self._is_marked.append(_leads_through(tags))

    def through(self, area: Area) -> tuple[BaseGeometry | None, float]:
        """Area of the ways that lead through a building, and their clear height."""
        is_gate = area.tags.get("historic") in _GATES or _kind(area.tags) in _GATES
        whole = make_valid(area.polygon)
        found = [
            index
            for index in self._tree.query(area.polygon).tolist()
            if (is_gate or self._is_marked[index])
            and whole.intersection(self._strips[index]).area > 1.0
        ]
        if not found:
            return None, 0.0
        ways = shapely.union_all([self._strips[index] for index in found])
        return ways, max(self._clear_m[index] for index in found)


def _leads_through(tags: Tags) -> bool:
    return tags.get("tunnel") == "building_passage" or tags.get("covered") in _COVERED


# ---------- bridges over roads
def find_bridges(network: Network, reaches: Sequence[Reach]) -> Iterator[Thing]:
    """Decks of roads, footways and railways over roads on the ground.

    Where a road on a bridge leads to a junction nearby, its deck would be above its road users, and
    is left out, which is noted.
    """
    usual, elements = DEFAULTS["bridge"], network.elements
    below = STRtree([LineString(edge.points_m) for edge in network.edges if edge.level == 0])

    def is_over_road(line_m: FloatArray, tags: Tags) -> bool:
        is_bridge = level(tags) > 0 and is_yes(tags.get("bridge"))
        return is_bridge and len(below.query(LineString(line_m), predicate="crosses")) > 0

    for reach in reaches:
        breaks_m = reach.street.breaks_m
        for index, (edge, _) in enumerate(reach.street.parts):
            if not is_over_road(edge.points_m, edge.tags):
                continue
            from_m, to_m = breaks_m[index] - reach.begin_m, reach.end_m - breaks_m[index + 1]
            if (reach.from_junction and from_m < usual["junction_m"]) or (
                reach.to_junction and to_m < usual["junction_m"]
            ):
                why = "a junction is near on it: its deck is left out"
                elements.omissions.add("bridges", f"way {edge.way_id}", why)
            else:
                yield from _deck(edge.id, edge.points_m, edge.section.width_m, edge.level)
    for way in elements.ways:
        is_rail = way.tags.get("railway") in usual["railways"]
        if is_rail or way.tags.get("highway") in DEFAULTS["building"]["foot_ways"]:
            width_m = usual["track_width_m" if is_rail else "foot_width_m"]
            for number, line_m in enumerate(lines_of(way, elements)):
                if is_over_road(line_m, way.tags):
                    name = numbered(f"w{way.id}", number)
                    yield from _deck(name, line_m, width_m, level(way.tags))


def _deck(name: str, line_m: FloatArray, width_m: float, layer: int) -> Iterator[Thing]:
    bottom_m = DEFAULTS["building"]["clear_height_m"] * layer
    area = LineString(line_m).buffer(0.5 * width_m, cap_style="flat")
    top_m = bottom_m + DEFAULTS["bridge"]["thickness_m"]
    for number, part in enumerate(polygons_of(area)):
        mesh = extrude_polygon(part, bottom_m=bottom_m, top_m=top_m, where=name)
        deck_id = numbered(f"{name} bridge", number, " ")
        yield Thing.of(deck_id, "building", mesh, is_height_assumed=True)
