"""A scene's roads as ASAM OpenDRIVE, with the poles of a layout as objects beside them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from xml.etree import ElementTree as ET

import numpy as np

from geometry.arrays import FloatArray
from geometry.junction import (
    ASSUMED,
    CONNECTING,
    Junction,
    build_junction,
    curve_between,
    lane_line,
)
from geometry.scene import Lane, Scene
from geometry.terrain import on_ground, terrain_of
from placement.candidates import CandidatePose
from placement.layout import Layout

from . import ExportFormat

_TYPES = {
    "driving": "driving",
    CONNECTING: "driving",
    "parking": "parking",
    "cycling": "biking",
    "walking": "sidewalk",
}
_JUNCTION = "1"
_MOUTH_M = 10.0  # of a lane, of which its direction is taken
_SAME_M = 0.5  # between the ends of lanes that lead into each other
_SAME_SLOPE = 1.0e-9
_DIGITS = 6
_LENGTH_NODES = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Road:
    """A lane as a road of its own, whose reference line is the lane's middle."""

    id: str
    lane: Lane
    points_m: FloatArray  # (n, 2)
    tangent: FloatArray  # (n, 2), unit vectors
    width_m: tuple[float, float]  # at both ends

    def pieces(self) -> Iterator[tuple[float, FloatArray, FloatArray]]:
        """Of each piece its length, and its coefficients along and across its first tangent.

        They are cubics of a parameter from 0 to 1: Hermite's, through both ends along their
        tangents, so that the line has no corners.
        """
        for begin, end, out, into in zip(
            self.points_m, self.points_m[1:], self.tangent, self.tangent[1:], strict=False
        ):
            frame = np.array([out, [-out[1], out[0]]])
            way, turn = frame @ (end - begin), frame @ into
            chord_m = float(np.hypot(*way))
            first, last = np.array([chord_m, 0.0]), chord_m * turn
            cubic = np.array(
                [np.zeros(2), first, 3.0 * way - 2.0 * first - last, first + last - 2.0 * way]
            )
            nodes, weights = _LENGTH_NODES
            at = 0.5 * (nodes + 1.0)
            rate = cubic[1] + 2.0 * at[:, None] * cubic[2] + 3.0 * at[:, None] ** 2 * cubic[3]
            yield float(0.5 * weights @ np.hypot(*rate.T)), *cubic.T


def to_opendrive(layout: Layout | None, scene: Scene) -> str:
    """The scene's roads as an OpenDRIVE 1.7 file, in the world frame of the scene.

    Each lane is a road of its own that ends at the junction, each lane through it a connecting one;
    where the map has none, those are assumed that lead from each lane to each other arm. Heights
    are those of the ground. Poles with the units of the layout are objects of the nearest road. Not
    in it: markings, signals, lanes that are only assumed to lead on beyond the map.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.7.0: 7.6 (parametric cubic curves), 10.3 (junctions), 11.1 (objects).
    """
    junction = build_junction(scene)
    lanes = [lane for lane in scene.lanes if lane.kind in _TYPES and lane.kind != ASSUMED]
    if not any(lane.kind == CONNECTING for lane in lanes):
        lanes += _assumed(junction)
    roads = {str(number): _road(str(number), lane) for number, lane in enumerate(lanes, 1)}
    outside = [road for road in roads.values() if road.lane.kind == "driving"]
    ways = {}
    for road in [*roads.values()]:
        if road.lane.kind != CONNECTING:
            continue
        before = _end_at(outside, road.points_m[0], -1)
        after = _end_at(outside, road.points_m[-1], 0)
        if before is None or after is None:  # through another junction: it leads nowhere here
            del roads[road.id]
            continue
        ways[road.id] = before.id, after.id
        roads[road.id] = _fitted(road, before, after)
    root = ET.Element("OpenDRIVE")
    header = ET.SubElement(root, "header", revMajor="1", revMinor="7", name=scene.name)
    corners = np.concatenate([road.points_m for road in roads.values()])
    for name, value in zip(
        ("west", "south", "east", "north"),
        [*corners.min(axis=0), *corners.max(axis=0)],
        strict=True,
    ):
        header.set(name, _text(value))
    if scene.crs:
        ET.SubElement(header, "geoReference").text = scene.crs
    elements = {}
    for road in roads.values():
        meets = [any(ends[at] == road.id for ends in ways.values()) for at in (1, 0)]
        elements[road.id] = _road_element(root, road, scene, ways.get(road.id), meets)
    if layout is not None:
        _add_objects(elements, [*roads.values()], layout)
    if ways:
        crossing = ET.SubElement(root, "junction", id=_JUNCTION, name=scene.name)
        for number, (road_id, (incoming, _)) in enumerate(ways.items(), 1):
            connection = ET.SubElement(
                crossing,
                "connection",
                id=str(number),
                incomingRoad=incoming,
                connectingRoad=road_id,
                contactPoint="start",
            )
            lane = _lane_id(scene)
            ET.SubElement(connection, "laneLink", {"from": lane, "to": lane})
    ET.indent(root, space="  ")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _text(value: float) -> str:
    return repr(round(float(value), _DIGITS) + 0.0)


def _lane_id(scene: Scene) -> str:
    """The lane that is driven along the reference line; with traffic on the left its left one."""
    return "1" if scene.keeps_left else "-1"


def _road(road_id: str, lane: Lane) -> _Road:
    points_m = lane.centreline_m
    steps = np.diff(points_m, axis=0)
    steps /= np.hypot(*steps.T)[:, None]
    tangent = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    length = np.hypot(*tangent.T)
    follows = np.concatenate([steps, steps[-1:]])  # where a line turns back
    tangent = np.where(length[:, None] > 1e-6, tangent, follows)
    tangent /= np.hypot(*tangent.T)[:, None]
    widths_m = lane.width_m, lane.width_m
    return _Road(id=road_id, lane=lane, points_m=points_m, tangent=tangent, width_m=widths_m)


def _assumed(junction: Junction) -> Iterator[Lane]:
    """From each lane into the junction one lane to each other arm, counted from the kerb."""
    for before, after in product(junction.arms.values(), repeat=2):
        if before is after or not after.exit_lanes:
            continue
        for index, lane in enumerate(before.entry_lanes):
            leaving = after.exit_lanes[min(index, len(after.exit_lanes) - 1)]
            ends = [
                lane_line(one, is_in=is_in, length_m=_MOUTH_M)[0]
                for one, is_in in ((lane, True), (leaving, False))
            ]
            try:
                line_m = curve_between(*ends)
            except ValueError:  # too sharp a turn
                continue
            yield Lane(
                id=f"{lane.id} to {leaving.id}",
                kind=CONNECTING,
                width_m=min(lane.width_m, leaving.width_m),
                centreline_m=line_m,
            )


def _end_at(roads: Sequence[_Road], point_m: FloatArray, end: int) -> _Road | None:
    """The road that ends (-1) or begins (0) nearest to a point; None where none does."""
    gaps_m = [float(np.hypot(*(road.points_m[end] - point_m))) for road in roads]
    nearest = int(np.argmin(gaps_m)) if gaps_m else 0
    return roads[nearest] if gaps_m and gaps_m[nearest] <= _SAME_M else None


def _fitted(road: _Road, before: _Road, after: _Road) -> _Road:
    """A way that leaves one road and enters another without a corner, a gap, or a jump in width."""
    points_m, tangent = road.points_m.copy(), road.tangent.copy()
    points_m[[0, -1]] = before.points_m[-1], after.points_m[0]
    tangent[[0, -1]] = before.tangent[-1], after.tangent[0]
    widths_m = before.width_m[1], after.width_m[0]
    return replace(road, points_m=points_m, tangent=tangent, width_m=widths_m)


def _road_element(
    root: ET.Element,
    road: _Road,
    scene: Scene,
    way: tuple[str, str] | None,
    meets: Sequence[bool],
) -> ET.Element:
    """A road; a way through the junction leads from one road to another, others may meet it."""
    pieces = list(road.pieces())
    length_m = sum(piece[0] for piece in pieces)
    element = ET.SubElement(
        root,
        "road",
        name=road.lane.id,
        length=_text(length_m),
        id=road.id,
        junction="-1" if way is None else _JUNCTION,
        rule="LHT" if scene.keeps_left else "RHT",
    )
    link = ET.SubElement(element, "link")
    for index, word in enumerate(("predecessor", "successor")):
        if way is not None:
            ends = {"elementType": "road", "elementId": way[index]}
            ET.SubElement(link, word, ends, contactPoint="start" if index else "end")
        elif meets[index]:
            ET.SubElement(link, word, elementType="junction", elementId=_JUNCTION)
    if road.lane.speed_limit_kmh is not None:
        kind = ET.SubElement(element, "type", s="0.0", type="town")
        ET.SubElement(kind, "speed", max=_text(road.lane.speed_limit_kmh), unit="km/h")
    starts_m = np.cumsum([0.0, *(piece[0] for piece in pieces)])
    view = ET.SubElement(element, "planView")
    for s_m, point_m, ahead, (piece_m, along, across) in zip(
        starts_m, road.points_m, road.tangent, pieces, strict=False
    ):
        geometry = ET.SubElement(
            view,
            "geometry",
            s=_text(s_m),
            x=_text(point_m[0]),
            y=_text(point_m[1]),
            hdg=repr(math.atan2(ahead[1], ahead[0])),
            length=_text(piece_m),
        )
        cubic = {
            f"{letter}{axis}": repr(float(value))
            for axis, values in (("U", along), ("V", across))
            for letter, value in zip("abcd", values, strict=True)
        }
        ET.SubElement(geometry, "paramPoly3", cubic, pRange="normalized")
    profile = ET.SubElement(element, "elevationProfile")
    height_m = on_ground(road.points_m, terrain_of(scene))[:, 2]
    slope = np.diff(height_m) / np.diff(starts_m)
    is_new = np.append(True, np.abs(np.diff(slope)) > _SAME_SLOPE)
    for s_m, low_m, rise in zip(
        starts_m[:-1][is_new], height_m[:-1][is_new], slope[is_new], strict=True
    ):
        line = {"a": _text(low_m), "b": repr(float(rise)), "c": "0.0", "d": "0.0"}
        ET.SubElement(profile, "elevation", line, s=_text(s_m))
    _add_lanes(element, road, scene, length_m=length_m, is_way=way is not None)
    return element


def _add_lanes(
    element: ET.Element, road: _Road, scene: Scene, *, length_m: float, is_way: bool
) -> None:
    """The one lane, moved so that its middle is the reference line."""
    begin_m, end_m = road.width_m
    width = {"a": _text(begin_m), "b": repr((end_m - begin_m) / length_m), "c": "0.0", "d": "0.0"}
    half = -0.5 if scene.keeps_left else 0.5
    offset = {key: repr(half * float(value)) for key, value in width.items()}
    lanes = ET.SubElement(element, "lanes")
    ET.SubElement(lanes, "laneOffset", {"s": "0.0"} | offset)
    section = ET.SubElement(lanes, "laneSection", s="0.0")
    own = ET.Element("left" if scene.keeps_left else "right")
    centre = ET.Element("center")
    ET.SubElement(centre, "lane", id="0", type="none", level="false")
    section.extend([own, centre] if scene.keeps_left else [centre, own])
    lane_id = _lane_id(scene)
    lane = ET.SubElement(own, "lane", id=lane_id, type=_TYPES[road.lane.kind], level="false")
    if is_way:
        link = ET.SubElement(lane, "link")
        for word in ("predecessor", "successor"):
            ET.SubElement(link, word, id=lane_id)
    ET.SubElement(lane, "width", {"sOffset": "0.0"} | width)


def _add_objects(elements: dict[str, ET.Element], roads: Sequence[_Road], layout: Layout) -> None:
    """Poles with units, each beside the nearest road."""
    at_pole: dict[tuple[float, float], list[CandidatePose]] = {}
    for unit in layout.units:
        east_m, north_m, _ = np.asarray(unit.pose.position_m).tolist()
        at_pole.setdefault((east_m, north_m), []).append(unit)
    starts_m = [np.cumsum([0.0, *(piece[0] for piece in road.pieces())]) for road in roads]
    for number, (place_m, units) in enumerate(at_pole.items(), 1):
        (*_, s_m, t_m), road_id = min(
            (_beside(road, starts, place_m), road.id)
            for road, starts in zip(roads, starts_m, strict=True)
        )
        objects = elements[road_id].find("objects")
        if objects is None:
            objects = ET.SubElement(elements[road_id], "objects")
        names, pole = ", ".join(unit.id for unit in units), units[0].site_id
        ET.SubElement(
            objects,
            "object",
            {"type": "pole", "id": str(number), "name": f"{pole}: {names}" if pole else names},
            s=_text(s_m),
            t=_text(t_m),
            zOffset="0.0",
            orientation="none",
            height=_text(max(float(unit.pose.position_m[2]) for unit in units)),
            radius="0.1",
        )


def _beside(
    road: _Road, starts_m: FloatArray, place_m: tuple[float, float]
) -> tuple[float, float, float, float]:
    """How far a place lies beyond a road's ends, and from its line; its s, and its t to the left.

    `starts_m`, (n,), has the s of each of its points.
    Nothing but a place beside the line, not beyond its ends, can be told by s and t.
    """
    begin, step = road.points_m[:-1], np.diff(road.points_m, axis=0)
    length_m = np.hypot(*step.T)
    ahead = step / length_m[:, None]
    off = np.array(place_m) - begin
    along = (off * ahead).sum(axis=1)
    left = ahead[:, 0] * off[:, 1] - ahead[:, 1] * off[:, 0]
    beyond = np.maximum(np.maximum(-along, along - length_m), 0.0)
    at = int(np.argmin(np.hypot(beyond, left)))
    s_m = starts_m[at] + np.clip(along[at] / length_m[at], 0.0, 1.0) * np.diff(starts_m)[at]
    return round(beyond[at], 1), abs(left[at]), s_m, left[at]


FORMAT = ExportFormat(
    write=to_opendrive,
    content="the scene's roads, OpenDRIVE 1.7; the layout's poles beside them",
)
