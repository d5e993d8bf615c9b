"""Bridges over roads: slabs that hide what is behind them and are passed below."""

from collections.abc import Iterator, Sequence

import numpy as np
from shapely import LineString, Polygon, STRtree

from ...arrays import FloatArray
from ..solids import extrude
from ..source_map import Omissions, Thing
from .elements import DEFAULTS, Elements, Tags, is_yes
from .junctions import Reach
from .network import Network, known_runs, level


def find_bridges(
    network: Network, reaches: Sequence[Reach], elements: Elements, omissions: Omissions
) -> Iterator[Thing]:
    """Decks of roads, footways and railways over roads on the ground.

    Road users on a bridge are not lifted to its deck: where a road on a bridge leads to a junction
    nearby, its deck would be above them, and is left out, which is noted.
    """
    usual = DEFAULTS["bridge"]
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
                omissions.add("bridges", f"way {edge.way_id}", why)
            else:
                yield from _deck(edge.id, edge.points_m, edge.section.width_m, edge.level)
    for way in elements.ways:
        is_rail = way.tags.get("railway") in usual["railways"]
        if not is_rail and way.tags.get("highway") not in DEFAULTS["building"]["foot_ways"]:
            continue
        width_m = usual["track_width_m" if is_rail else "foot_width_m"]
        for number, rows in enumerate(known_runs(way.rows, network.positions_m)):
            line_m = network.positions_m[rows]
            if is_over_road(line_m, way.tags):
                name = f"w{way.id}.{number}" if number else f"w{way.id}"
                yield from _deck(name, line_m, width_m, level(way.tags))


def _deck(name: str, line_m: FloatArray, width_m: float, layer: int) -> Iterator[Thing]:
    bottom_m = DEFAULTS["building"]["clear_height_m"] * layer
    area = LineString(line_m).buffer(0.5 * width_m, cap_style="flat")
    for number, part in enumerate(getattr(area, "geoms", [area])):
        if not isinstance(part, Polygon) or part.is_empty:
            continue
        vertices, triangles = extrude(
            np.asarray(part.exterior.coords),
            bottom_m=bottom_m,
            top_m=bottom_m + DEFAULTS["bridge"]["thickness_m"],
            holes_m=[np.asarray(ring.coords) for ring in part.interiors],
            where=name,
        )
        yield Thing(
            id=f"{name} bridge" + (f" {number}" if number else ""),
            class_name="building",
            vertices_m=vertices,
            triangles=triangles,
            is_height_assumed=True,
        )
