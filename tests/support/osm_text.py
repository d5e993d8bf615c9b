"""Small OpenStreetMap files, drawn in metres around a point."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from pyproj import Transformer

from geometry.junction import CARRIAGEWAY_KINDS, Junction, build_junction
from geometry.maps.source_map import MapJunction, MapLane, SourceMap
from geometry.scene import Lane, Scene

LAT_DEG = 52.5
LON_DEG = 13.4
_TO_DEG = Transformer.from_crs(
    f"+proj=tmerc +lat_0={LAT_DEG} +lon_0={LON_DEG} +k=1 +datum=WGS84 +units=m"
    " +no_defs",
    "EPSG:4326",
    always_xy=True,
)


class OsmText:
    """A file in the making; ids count from 1."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.n_parts = 0

    def node(self, east_m: float, north_m: float, **tags: str) -> int:
        lon_deg, lat_deg = _TO_DEG.transform(east_m, north_m)
        return self._add("node", f' lat="{lat_deg:.7f}" lon="{lon_deg:.7f}"', "", tags)

    def way(
        self,
        points: Sequence[int | tuple[float, float]],
        tags: dict[str, str] | None = None,
    ) -> int:
        """Points are ids of nodes, or places of new ones; the last may be the first
        one's place.
        """
        ids: list[int] = []
        at: dict[tuple[float, float], int] = {}

        for point in points:
            if isinstance(point, tuple):
                if point not in at:
                    at[point] = self.node(*point)
                ids.append(at[point])
            else:
                ids.append(point)

        return self._add(
            "way", "", "".join(f'<nd ref="{one}"/>' for one in ids), tags or {}
        )

    def road(self, points: Sequence[int | tuple[float, float]], **tags: str) -> int:
        return self.way(
            points,
            {"highway": "residential"}
            | {key.replace("__", ":"): one for key, one in tags.items()},
        )

    def relation(self, members: Sequence[tuple[int, str]], tags: dict[str, str]) -> int:
        inside = "".join(
            f'<member type="way" ref="{one}" role="{role}"/>' for one, role in members
        )
        return self._add("relation", "", inside, tags)

    def _add(
        self, kind: str, attributes: str, inside: str, tags: dict[str, str]
    ) -> int:
        self.n_parts += 1
        inside += "".join(
            f"<tag k={quoteattr(key.replace('__', ':'))} v={quoteattr(value)}/>"
            for key, value in tags.items()
        )
        self.parts.append(f'<{kind} id="{self.n_parts}"{attributes}>{inside}</{kind}>')
        return self.n_parts

    def text(self) -> str:
        return (
            '<?xml version="1.0"?>\n<osm version="0.6">\n'
            + "\n".join(self.parts)
            + "\n</osm>\n"
        )

    def write(self, folder: Path, name: str = "map.osm") -> Path:
        path = folder / name
        path.write_text(self.text())
        return path


def crossing(
    osm: OsmText,
    *,
    length_m: float = 100.0,
    bearings: Sequence[tuple[float, float]],
    **tags: str,
) -> int:
    """Roads that all end in one node, (0, 0), and lead to unit vectors; returns the
    node.
    """
    middle = osm.node(0.0, 0.0)
    for index, (east, north) in enumerate(bearings):
        osm.road(
            [middle, (length_m * east, length_m * north)],
            name=f"Street {index}",
            **tags,
        )

    return middle


def as_drawn(source: SourceMap) -> SourceMap:
    """A map that was read from a drawing, in the coordinates in which it was drawn."""
    to_map = Transformer.from_crs("EPSG:4326", source.crs, always_xy=True)
    shift = np.array([*to_map.transform(LON_DEG, LAT_DEG), 0.0])

    def moved(thing, name, by_m=shift):
        return replace(thing, **{name: getattr(thing, name) - by_m})

    junctions = []
    for junction in source.junctions:
        roads = [moved(road, "point_m", shift[:2]) for road in junction.roads]
        there = moved(junction, "outline_m", shift[:2])
        junctions.append(replace(there, roads=tuple(roads)))
    return replace(
        source,
        lanes=tuple(moved(lane, "centreline_m") for lane in source.lanes),
        junctions=tuple(junctions),
        things=tuple(moved(thing, "vertices_m") for thing in source.things),
        poles=tuple(moved(pole, "position_m") for pole in source.poles),
        crosswalks_m=source.crosswalks_m - shift[:2],
    )


def arms_of(source: SourceMap, junction: MapJunction) -> Junction:
    """Arms as the study's code finds them, from the junction's own lanes alone."""
    own = [
        lane
        for lane in source.lanes
        if junction.id in (lane.from_junction, lane.to_junction)
    ]
    return build_junction(scene_of(source, junction, own))


def scene_of(
    source: SourceMap, junction: MapJunction, lanes: Sequence[MapLane]
) -> Scene:
    """A scene of lanes of a map alone, around one of its junctions."""
    return Scene(
        name=junction.id,
        vertices_m=np.empty((0, 3)),
        triangles=np.empty((0, 3), dtype=np.int32),
        triangle_instance=np.empty(0, dtype=np.int32),
        instances=(),
        sites=(),
        outline_m=junction.outline_m,
        lanes=tuple(
            Lane(
                id=lane.id,
                kind=lane.kind,
                width_m=lane.width_m,
                centreline_m=lane.centreline_m[:, :2],
                speed_limit_kmh=lane.speed_limit_kmh,
                turns=lane.turns,
            )
            for lane in lanes
            if lane.kind in CARRIAGEWAY_KINDS
        ),
        crs=source.crs,
        crosswalks_m=source.crosswalks_m,
        keeps_left=source.keeps_left,
    )


def arm_lanes(source: SourceMap, junction: MapJunction) -> dict[str, tuple[int, int]]:
    """How many lanes lead into a junction and out of it, by arm."""
    arms = arms_of(source, junction).arms
    return {
        name: (len(arm.entry_lanes), len(arm.exit_lanes)) for name, arm in arms.items()
    }
