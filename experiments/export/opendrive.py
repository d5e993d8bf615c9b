"""A scene's roads, and a layout's poles, as ASAM OpenDRIVE."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

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
from .xml import xml_text

_TYPES = {
    "driving": "driving",
    "bus": "bus",
    CONNECTING: "driving",
    "parking": "parking",
    "cycling": "biking",
    "walking": "sidewalk",
}
# Of a lane, of which its direction is taken.
_MOUTH_M = 10.0
# Between the ends of lanes that lead into each other.
_SAME_M = 0.5
_SAME_SLOPE = 1.0e-9
_DIGITS = 6
_LENGTH_NODES = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Road:
    """A lane as a road of its own, whose reference line is the lane's middle."""

    id: str
    lane: Lane
    # (n, 2).
    points_m: FloatArray
    # (n, 2), unit vectors.
    tangent: FloatArray
    # At both ends.
    width_m: tuple[float, float]

    def pieces(self) -> Iterator[tuple[float, FloatArray, FloatArray]]:
        """Length of each piece, and its coefficients.

        The coefficients are those along and across its first tangent.

        They are cubics of a parameter from 0 to 1: Hermite's, through both ends along
        their tangents, so that the line has no corners.
        """
        for begin, end, out, into in zip(
            self.points_m,
            self.points_m[1:],
            self.tangent,
            self.tangent[1:],
            strict=False,
        ):
            frame = np.array([out, [-out[1], out[0]]])
            way = frame @ (end - begin)
            turn = frame @ into
            chord_m = float(np.hypot(*way))
            first = np.array([chord_m, 0.0])
            last = chord_m * turn
            cubic = np.array(
                [
                    np.zeros(2),
                    first,
                    3.0 * way - 2.0 * first - last,
                    first + last - 2.0 * way,
                ]
            )
            nodes, weights = _LENGTH_NODES
            at = 0.5 * (nodes + 1.0)
            rate = (
                cubic[1]
                + 2.0 * at[:, None] * cubic[2]
                + 3.0 * at[:, None] ** 2 * cubic[3]
            )
            yield float(0.5 * weights @ np.hypot(*rate.T)), *cubic.T


def to_opendrive(layout: Layout | None, scene: Scene) -> str:
    """The scene's roads as OpenDRIVE 1.7, in the scene's world frame.

    Each lane is a road of its own that ends at the junction, each lane through it a
    connecting one; where the map has none, those are assumed that lead from each lane
    to each other arm. Heights are those of the ground. Poles with the units of the
    layout are objects of the nearest road. Not in it: markings, signals, lanes that are
    only assumed to lead on beyond the map.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.7.0: 7.6 (parametric cubic curves), 10.3 (junctions), 11.1
       (objects).
    """
    junction = build_junction(scene)
    lanes = [
        lane for lane in scene.lanes if lane.kind in _TYPES and lane.kind != ASSUMED
    ]
    if not any(lane.kind == CONNECTING for lane in lanes):
        lanes += _assumed(junction)
    roads = {
        str(number): _road(str(number), lane) for number, lane in enumerate(lanes, 1)
    }
    outside = [road for road in roads.values() if road.lane.kind == "driving"]
    ways = {}
    for road in [*roads.values()]:
        if road.lane.kind != CONNECTING:
            continue
        before = _end_at(outside, road.points_m[0], -1)
        after = _end_at(outside, road.points_m[-1], 0)
        # Through another junction: it leads nowhere here.
        if before is None or after is None:
            del roads[road.id]
            continue
        ways[road.id] = before.id, after.id
        roads[road.id] = _fitted(road, before, after)
    corners = np.concatenate([road.points_m for road in roads.values()])
    drawn = [(road, _line(road, scene)) for road in roads.values()]
    return xml_text(
        "opendrive.xml.j2",
        m=lambda value: repr(round(float(value), _DIGITS) + 0.0),
        full=lambda value: repr(float(value)),
        scene=scene,
        low=corners.min(axis=0),
        high=corners.max(axis=0),
        roads=drawn,
        ways=ways,
        entered_from={before for before, _ in ways.values()},
        left_into={after for _, after in ways.values()},
        types=_TYPES,
        poles=_poles(drawn, () if layout is None else layout.units),
    )


def _road(road_id: str, lane: Lane) -> _Road:
    points_m = lane.centreline_m
    steps = np.diff(points_m, axis=0)
    steps /= np.hypot(*steps.T)[:, None]
    tangent = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    length = np.hypot(*tangent.T)
    # Where a line turns back.
    follows = np.concatenate([steps, steps[-1:]])
    tangent = np.where(length[:, None] > 1e-6, tangent, follows)
    tangent /= np.hypot(*tangent.T)[:, None]
    widths_m = lane.width_m, lane.width_m
    return _Road(
        id=road_id, lane=lane, points_m=points_m, tangent=tangent, width_m=widths_m
    )


def _assumed(junction: Junction) -> Iterator[Lane]:
    """Pairs of lanes: each one in, and one out by each other arm.

    Lanes are counted from the kerb.
    """
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
            except ValueError:
                # Too sharp a turn.
                continue
            yield Lane(
                id=f"{lane.id} to {leaving.id}",
                kind=CONNECTING,
                width_m=min(lane.width_m, leaving.width_m),
                centreline_m=line_m,
            )


def _end_at(roads: Sequence[_Road], point_m: FloatArray, end: int) -> _Road | None:
    """The road that ends (-1) or begins (0) nearest to a point.

    None where none does.
    """
    gaps_m = [float(np.hypot(*(road.points_m[end] - point_m))) for road in roads]
    if gaps_m:
        nearest = int(np.argmin(gaps_m))
    else:
        nearest = 0
    if gaps_m and gaps_m[nearest] <= _SAME_M:
        return roads[nearest]
    return None


def _fitted(road: _Road, before: _Road, after: _Road) -> _Road:
    """A smooth way from one road into another.

    It has no corner, no gap and no jump in width.
    """
    points_m = road.points_m.copy()
    tangent = road.tangent.copy()
    points_m[[0, -1]] = before.points_m[-1], after.points_m[0]
    tangent[[0, -1]] = before.tangent[-1], after.tangent[0]
    widths_m = before.width_m[1], after.width_m[0]
    return replace(road, points_m=points_m, tangent=tangent, width_m=widths_m)


def _line(road: _Road, scene: Scene) -> dict[str, Any]:
    """A road's reference line, its heights, and the width of its lane.

    All of them piece by piece.
    """
    pieces = list(road.pieces())
    starts_m = np.cumsum([0.0, *(piece[0] for piece in pieces)])
    headings_rad = [math.atan2(ahead[1], ahead[0]) for ahead in road.tangent]
    height_m = on_ground(road.points_m, terrain_of(scene))[:, 2]
    slope = np.diff(height_m) / np.diff(starts_m)
    is_new = np.append(True, np.abs(np.diff(slope)) > _SAME_SLOPE)
    begin_m, end_m = road.width_m
    return {
        "starts_m": starts_m,
        "pieces": list(
            zip(starts_m, road.points_m, headings_rad, pieces, strict=False)
        ),
        "profile": list(
            zip(
                starts_m[:-1][is_new], height_m[:-1][is_new], slope[is_new], strict=True
            )
        ),
        "width_m": round(begin_m, _DIGITS) + 0.0,
        "widens": (end_m - begin_m) / starts_m[-1],
    }


def _poles(
    roads: Sequence[tuple[_Road, dict[str, Any]]], units: Sequence[CandidatePose]
) -> dict[str, list[dict[str, Any]]]:
    """Poles with units by the road that is nearest to each."""
    at_pole: dict[tuple[float, float], list[CandidatePose]] = {}
    for unit in units:
        east_m, north_m, _ = np.asarray(unit.pose.position_m).tolist()
        at_pole.setdefault((east_m, north_m), []).append(unit)
    beside: dict[str, list[dict[str, Any]]] = {road.id: [] for road, _ in roads}
    for number, (place_m, there) in enumerate(at_pole.items(), 1):
        (*_, s_m, t_m), road_id = min(
            (_beside(road, line["starts_m"], place_m), road.id) for road, line in roads
        )
        names = ", ".join(unit.id for unit in there)
        pole = there[0].site_id
        beside[road_id].append(
            {
                **{"number": number, "name": f"{pole}: {names}" if pole else names},
                **{"s_m": s_m, "t_m": t_m},
                "height_m": max(float(unit.pose.position_m[2]) for unit in there),
            }
        )
    return beside


def _beside(
    road: _Road, starts_m: FloatArray, place_m: tuple[float, float]
) -> tuple[float, float, float, float]:
    """How far a place lies beyond a road's ends, and from its line.

    Its s, and its t to the left.

    `starts_m`, (n,), has the s of each of its points.
    Nothing but a place beside the line, not beyond its ends, can be told by s and t.
    """
    begin = road.points_m[:-1]
    step = np.diff(road.points_m, axis=0)
    length_m = np.hypot(*step.T)
    ahead = step / length_m[:, None]
    off = np.array(place_m) - begin
    along = (off * ahead).sum(axis=1)
    left = ahead[:, 0] * off[:, 1] - ahead[:, 1] * off[:, 0]
    beyond = np.maximum(np.maximum(-along, along - length_m), 0.0)
    at = int(np.argmin(np.hypot(beyond, left)))
    s_m = (
        starts_m[at]
        + np.clip(along[at] / length_m[at], 0.0, 1.0) * np.diff(starts_m)[at]
    )
    return round(beyond[at], 1), abs(left[at]), s_m, left[at]


FORMAT = ExportFormat(
    write=to_opendrive,
)
