"""Lamp posts, signals, signs and other poles."""

from collections.abc import Sequence

import numpy as np

from ...arrays import FloatArray
from ..model import Pole
from .defaults import DEFAULTS
from .elements import Elements, Tags
from .junctions import Reach
from .network import Network
from .notes import Notes
from .strips import points_beside
from .tags import parse_length_m

_POLES = ("mast", "utility_pole", "pole")
_NO_POLE = ("wall", "wall_mounted", "building", "ceiling", "suspended", "wire", "ground", "bridge")


def find_poles(
    network: Network,
    reaches: Sequence[Reach],
    elements: Elements,
    *,
    keeps_left: bool,
    notes: Notes,
) -> tuple[Pole, ...]:
    """What stands beside roads and could carry sensors.

    Parameters
    ----------
    network : Network
        The roads.
    reaches : sequence of Reach
        Streets, and where junctions begin on them.
    elements : Elements
        What the file has.
    keeps_left : bool
        Traffic keeps left.
    notes : Notes
        Told of lamps without a pole.

    Returns
    -------
    poles : tuple of Pole
        Signals and signs that are mapped on a road, as part of it, stand at the kerb on the side of
        traffic: beside the stop line, or where an arm begins if that is farther out; those mapped
        where roads meet stand at every arm by which cars come.
    """
    places = _places(network, reaches)
    poles = []
    for row, tags in elements.node_tags.items():
        kind = _kind(tags)
        if not kind:
            continue
        node_id = int(elements.node_ids[row])
        support = tags.get("support") or tags.get("lamp_mount") or tags.get("camera:mount", "")
        if support in _NO_POLE:
            notes.add(f"{kind}s", f"node {node_id}", "on a wall or a wire, without a pole")
            continue
        is_on_road = row in network.ends or row in places
        if is_on_road and kind in ("traffic light", "sign"):
            feet = _at_kerbs(places.get(row, ()), tags, keeps_left=keeps_left)
            if not feet:
                notes.add(f"{kind}s", f"node {node_id}", "inside a junction, where nobody stops")
        else:
            feet = [network.positions_m[row]]
        for number, foot in enumerate(feet):
            poles.append(
                Pole(
                    id=f"n{node_id}.{number}" if number else f"n{node_id}",
                    kind=kind,
                    position_m=np.append(foot, 0.0),
                    height_m=_height_m(tags),
                )
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


def _height_m(tags: Tags) -> float | None:
    height_m = parse_length_m(tags["height"]) if "height" in tags else None
    return height_m if height_m and height_m <= DEFAULTS["pole"]["max_height_m"] else None


_Place = tuple[Reach, float]  # a street and how far along it [m]


def _places(network: Network, reaches: Sequence[Reach]) -> dict[int, list[_Place]]:
    """Where nodes lie on streets; nodes of junctions lie on all arms."""
    places: dict[int, list[_Place]] = {}
    for reach in reaches:
        for row, station_m in zip(reach.street.rows, reach.street.stations_m, strict=True):
            places.setdefault(int(row), []).append((reach, float(station_m)))
    return places


def _at_kerbs(places: Sequence[_Place], tags: Tags, *, keeps_left: bool) -> list[FloatArray]:
    """Feet of the poles of one mapped signal or sign."""
    feet: list[FloatArray] = []
    for reach, station_m in places:
        for is_forward in _directions(reach, station_m, tags):
            # Beside the stop line, or where the arm begins if the stop line lies inside.
            at_m = float(np.clip(station_m, min(reach.begin_m, reach.end_m), reach.end_m))
            section = reach.street.sections[reach.street.part_at(at_m)]
            sign = 1.0 if is_forward == keeps_left else -1.0  # left of the street
            beside_m = 0.5 * section.width_m + DEFAULTS["pole"]["beyond_kerb_m"]
            foot = points_beside(reach.street, [at_m], [sign * beside_m])[0]
            if all(np.hypot(*(foot - other)) > 1.0 for other in feet):
                feet.append(foot)
    return feet


def _directions(reach: Reach, station_m: float, tags: Tags) -> list[bool]:
    """Directions along a street in which cars see a signal: True is from its begin to its end."""
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
        is_way = (text == "forward") == (edge.tags.get(_TURNED) != "yes")
        return [one for one in driven if one == (is_way == is_along)]
    if text == "both" or len(driven) < 2:
        return driven
    to_begin = station_m if reach.from_junction else np.inf
    to_end = street.length_m - station_m if reach.to_junction else np.inf
    if min(to_begin, to_end) > _NEAR_JUNCTION_M:
        return driven
    return [bool(to_end <= to_begin)]


_NEAR_JUNCTION_M = 40.0  # a signal farther from any junction is one for both directions
_TURNED = "oneway:turned"
