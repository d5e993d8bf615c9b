"""Roundabouts made up, as files of OpenStreetMap."""

import math
from collections.abc import Sequence

from .osm_text import OsmText

FOUR_ARMS_DEG = (0.0, 90.0, 180.0, 270.0)


def roundabout(
    *,
    radius_m: float = 15.0,
    arms_deg: Sequence[float] = FOUR_ARMS_DEG,
    ring_lanes: int = 1,
    arm_lanes: int = 2,
    keeps_left: bool = False,
    n_nodes: int = 16,
    stretched: float = 1.0,
    is_split: bool = False,
    gap: int = 0,
    arm_m: float = 160.0,
    **tags: str,
) -> OsmText:
    """A ring of OpenStreetMap around the origin, with arms.

    Parameters
    ----------
    radius_m : float
        Of the line through the ring's nodes. [m]
    arms_deg : sequence of float
        Where arms leave, counter-clockwise from east. [deg]
    ring_lanes, arm_lanes : int
        Lanes of the ring, and of each arm in both directions.
    keeps_left : bool
        Traffic keeps left.
    n_nodes : int
        Of the ring, next to those of the arms.
    stretched : float
        East to west the ring is so many times as wide.
    is_split : bool
        Arms fork around splitter islands before the ring.
    gap : int
        So many pieces of the ring are missing.
    arm_m : float
        Length of the arms. [m]
    **tags : str
        Further tags of the ring.
    """
    osm = OsmText()
    turn = -1.0 if keeps_left else 1.0
    half_deg = math.degrees(5.0 / radius_m)
    # Angles in driving direction, and what begins there.
    angles = {_whole(360.0 * index / n_nodes) for index in range(n_nodes)}
    angles |= {_whole(turn * angle) for angle in arms_deg}
    if is_split:
        for angle in arms_deg:
            angles |= {_whole(turn * angle + off) for off in (-half_deg, half_deg)}
    ordered = sorted(angles)

    def place(angle_deg: float, far_m: float) -> tuple[float, float]:
        angle = math.radians(turn * angle_deg)
        return stretched * far_m * math.cos(angle), far_m * math.sin(angle)

    ring = {angle: osm.node(*place(angle, radius_m)) for angle in ordered}
    street = {"highway": "tertiary", "maxspeed": "50"}
    nodes = [*ring.values(), ring[ordered[0]]]
    closed = {"junction": "roundabout", "lanes": str(ring_lanes)}
    osm.way(nodes[: len(nodes) - gap], street | closed | tags)
    for number, arm_deg in enumerate(arms_deg):
        angle = _whole(turn * arm_deg)
        own = street | {"lanes": str(arm_lanes), "name": f"Road {number}"}
        far = osm.node(*place(angle, radius_m + arm_m))
        if not is_split:
            osm.way([far, ring[angle]], own)
            continue
        fork = osm.node(*place(angle, radius_m + 25.0))
        osm.way([far, fork], own)
        link = own | {"oneway": "yes", "lanes": str(arm_lanes // 2)}
        osm.way([fork, ring[_whole(angle + half_deg)]], link)
        osm.way([ring[_whole(angle - half_deg)], fork], link)
    return osm


def _whole(angle_deg: float) -> float:
    """An angle from 0 to 360 degrees, rounded so that equal ones are the same."""
    return round(angle_deg % 360.0, 6)
