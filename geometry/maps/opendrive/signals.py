"""Signals beside the roads: traffic lights, signs, painted crosswalks, and poles below signals."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...arrays import FloatArray
from ..source_map import Omissions, Pole
from .attributes import (
    Offset,
    load_facts,
    take_number,
    take_number_or,
    take_size,
)
from .lanes import SampledSection, lane_kind
from .object_shapes import is_on
from .objects import signal_crosswalk, signal_kind
from .roads import Road, RoadElement

_PAINT = "paint on the road, or nothing above it"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Position:
    """Foot below a signal, its top above that, and its place on a road (empty: unknown)."""

    foot_m: FloatArray
    top_m: float
    road: str
    s_m: float
    t_m: float


def read_signals(
    roads: Mapping[str, Road],
    sampled: Mapping[str, Sequence[SampledSection]],
    offset: Offset,
    omissions: Omissions,
) -> tuple[list[Pole], list[FloatArray]]:
    """Poles, one per signal, and crosswalk lines (2, 2) that are written as signals.

    A signal that hangs over a driving lane has no pole there. Raises InputError if a number is
    missing or not finite.
    """
    poles: list[Pole] = []
    crosswalks: list[FloatArray] = []
    names: Counter[str] = Counter()
    for one in (one for road in roads.values() for one in road.listed("signal", names)):
        s_m, t_m = (take_number(one.element, key, one.where) for key in "st")
        kind = signal_kind(one.element)
        if not is_on(one.road, s_m):
            omissions.add("signals beyond their road's end", one.name, "beyond its road's end")
        elif kind == "crosswalk":
            across_m = take_size(one.element, "width", one.where)
            length_m = across_m or _road_width_m(sampled[one.road.id], s_m)
            if length_m:
                crosswalks.append(
                    signal_crosswalk(one.element, one.road, s_m, t_m, length_m, one.where)
                )
        elif kind is None:
            omissions.add("painted signals", one.name, _PAINT)
        else:
            position = _find_position(one, s_m, t_m, roads, offset)
            why = _why_no_pole(kind, position, sampled)
            if why:
                omissions.add(f"signals ({kind})", one.name, why)
            else:
                poles.append(_build_pole(one.name, kind, position))
    return poles, crosswalks


def _find_position(
    one: RoadElement, s_m: float, t_m: float, roads: Mapping[str, Road], offset: Offset
) -> _Position:
    """Position of a signal, which may be given apart from the place where it applies."""
    height_m = take_size(one.element, "height", one.where) or 0.0
    road = one.road
    z_m = take_number_or(one.element, "zOffset", one.where, 0.0)
    on_road = one.element.find("positionRoad")
    if on_road is not None and on_road.get("roadId", "") in roads:
        here = f"{one.where} positionRoad"
        road = roads[on_road.get("roadId", "")]
        s_m, t_m = (take_number(on_road, key, here) for key in "st")
        z_m = take_number_or(on_road, "zOffset", here, z_m)
    foot = road.place(np.array([s_m]), np.array([t_m]))[0][0]
    inertial = one.element.find("positionInertial")
    if inertial is None:
        return _Position(foot_m=foot, top_m=z_m + height_m, road=road.id, s_m=s_m, t_m=t_m)
    x, y, z = (take_number(inertial, key, f"{one.where} positionInertial") for key in "xyz")
    foot[:2] = offset.apply(np.array([[x, y]]))[0]
    top_m = z + offset.z_m - float(foot[2]) + height_m
    return _Position(foot_m=foot, top_m=top_m, road="", s_m=0.0, t_m=0.0)


def _why_no_pole(
    kind: str, position: _Position, sampled: Mapping[str, Sequence[SampledSection]]
) -> str:
    """Why a signal has no pole below it; empty: it has."""
    if kind != "traffic light" and position.top_m < load_facts()["signals"]["min_sign_top_m"]:
        return _PAINT
    if position.road and any(
        right < position.t_m < left
        for right, left in _driving_edges(sampled[position.road], position.s_m)
    ):
        return "it hangs over a lane: there is no pole below it"
    return ""


def _build_pole(name: str, kind: str, position: _Position) -> Pole:
    is_light = kind == "traffic light"
    least_m = load_facts()["signals"]["min_light_top_m" if is_light else "min_sign_top_m"]
    return Pole(
        id=name,
        kind=kind,
        position_m=position.foot_m,
        height_m=position.top_m if position.top_m >= least_m else None,
    )


def _driving_edges(sections: Sequence[SampledSection], s_m: float) -> list[tuple[float, float]]:
    """Edges (right, left) of the driving lanes at a station."""
    index = bisect_left(sections, s_m, key=lambda one: float(one.s_m[-1]))
    section = sections[min(index, len(sections) - 1)]
    edges = []
    for lane in section.lanes.values():
        if lane_kind(lane.record.type) == "driving":
            inner, outer = (
                float(np.interp(s_m, section.s_m, edge)) for edge in (lane.inner_m, lane.outer_m)
            )
            edges.append((min(inner, outer), max(inner, outer)))
    return edges


def _road_width_m(sections: Sequence[SampledSection], s_m: float) -> float:
    edges = _driving_edges(sections, s_m)
    return max(left for _, left in edges) - min(right for right, _ in edges) if edges else 0.0


# ---------- poles
_CELL_M = 0.05
_KIND_ORDER = (
    "traffic light",
    "lamp post",
    "sign",
    "pole",
)  # the kind of a pole with several signals is the first of these


def merge_poles(poles: Sequence[Pole]) -> list[Pole]:
    """Join poles within half a metre of one another.

    A joined pole is as high as the highest and of the most telling kind; it stands where the file
    has the pole itself, or else where the first signal hangs.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(poles) < 2:
        return list(poles)
    positions = np.array([pole.position_m[:2] for pole in poles])
    # First those at the very same place: of thousands there, every pair would count.
    _, first, cell = np.unique(
        np.round(positions / _CELL_M), axis=0, return_index=True, return_inverse=True
    )
    tree = cKDTree(positions[first])
    pairs = tree.query_pairs(load_facts()["signals"]["same_pole_m"], output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(first),) * 2)
    _, labels = connected_components(links, directed=False)
    groups: dict[int, list[Pole]] = {}
    for pole, label in zip(poles, labels[cell.reshape(-1)], strict=True):
        groups.setdefault(int(label), []).append(pole)
    return [_merge(group) for group in groups.values()]


def _merge(group: Sequence[Pole]) -> Pole:
    kind = min((pole.kind for pole in group), key=_KIND_ORDER.index)
    stands = next((pole for pole in group if pole.kind in ("pole", "lamp post")), group[0])
    heights = [pole.height_m for pole in group if pole.height_m is not None]
    return Pole(
        id=stands.id, kind=kind, position_m=stands.position_m, height_m=max(heights, default=None)
    )
