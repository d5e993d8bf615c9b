"""Roundabouts made up, as OpenStreetMap, OpenDRIVE and Lanelet2 have them."""

import math
from collections.abc import Sequence

from .opendrive_text import (
    document,
    geometry,
    lane,
    road,
    section,
    to_junction,
    to_road,
)
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


# ---------- the same with lanes that are drawn
WIDTH_M = 3.0
# Of the kerbs between ring and arms, as the reader of OpenStreetMap assumes them.
CORNER_M = 12.0
HALF_M = 0.5 * WIDTH_M


class _Shape:
    """Arcs of a roundabout with four arms of two lanes.

    Attributes
    ----------
    radius_m : float
        Of the middle of the ring's lane. [m]
    bend_m : float
        Of the middles of the lanes into it and out of it. [m]
    mouth_m : float
        From the middle to where the arms begin. [m]
    meets_rad : float
        To both sides of an arm, where its lanes meet the ring. [rad]
    """

    def __init__(self, radius_m: float) -> None:
        self.radius_m = radius_m
        self.bend_m = CORNER_M + HALF_M
        across_m = HALF_M + self.bend_m
        self.mouth_m = math.sqrt((radius_m + self.bend_m) ** 2 - across_m**2)
        self.meets_rad = math.atan2(across_m, self.mouth_m)


def lanelet_roundabout(
    radius_m: float = 15.0, arm_m: float = 160.0
) -> dict[str, tuple[list, list]]:
    """Bounds of the lanelets of a roundabout with four arms, by name."""
    shape = _Shape(radius_m)
    begin = shape.mouth_m
    across = HALF_M + shape.bend_m
    meets = shape.meets_rad
    quarter = 0.5 * math.pi
    found = {}
    for number in range(4):

        def line(
            points: list[tuple[float, float]], ways: list[float], turn: float
        ) -> tuple[list, list]:
            """Bounds beside points with directions, turned to the arm."""
            cosine = math.cos(turn)
            sine = math.sin(turn)
            bounds: tuple[list, list] = ([], [])
            for (x, y), way in zip(points, ways, strict=True):
                for bound, side in zip(bounds, (HALF_M, -HALF_M), strict=True):
                    east = x - side * math.sin(way)
                    north = y + side * math.cos(way)
                    bound.append(
                        (cosine * east - sine * north, sine * east + cosine * north)
                    )
            return bounds

        def arc(
            middle: tuple[float, float], radius: float, first: float, last: float
        ) -> tuple[list, list]:
            angles = [first + (last - first) * at / 12 for at in range(13)]
            sign = math.copysign(quarter, last - first)
            points = [
                (
                    middle[0] + radius * math.cos(angle),
                    middle[1] + radius * math.sin(angle),
                )
                for angle in angles
            ]
            return points, [angle + sign for angle in angles]

        turn = number * quarter
        far = begin + arm_m
        into = [
            (far, HALF_M),
            (begin, HALF_M),
        ]
        out = [
            (begin, -HALF_M),
            (far, -HALF_M),
        ]
        found[f"in{number}"] = line(into, [math.pi, math.pi], turn)
        found[f"out{number}"] = line(out, [0.0, 0.0], turn)
        entry = arc((begin, across), shape.bend_m, -quarter, -math.pi + meets)
        found[f"entry{number}"] = line(*entry, turn)
        leaving = arc((begin, -across), shape.bend_m, math.pi - meets, quarter)
        found[f"exit{number}"] = line(*leaving, turn)
        middle = (0.0, 0.0)
        past = arc(middle, radius_m, -meets, meets)
        found[f"past{number}"] = line(*past, turn)
        between = arc(middle, radius_m, meets, quarter - meets)
        found[f"ring{number}"] = line(*between, turn)
    return found


_ONE_LANE = section(right=[lane(-1, width=WIDTH_M)])


def opendrive_roundabout(
    radius_m: float = 15.0, arm_m: float = 160.0, *, is_one_junction: bool
) -> str:
    """A roundabout with four arms, as one junction or as four with a ring between."""
    shape = _Shape(radius_m)
    meets = shape.meets_rad
    quarter = 0.5 * math.pi
    inner_m = radius_m - HALF_M
    bend_m = shape.bend_m + HALF_M
    bend_length_m = bend_m * (quarter - meets)
    arm_lanes = section(left=[lane(1, width=WIDTH_M)], right=[lane(-1, width=WIDTH_M)])

    def curve(
        s: float, far: float, angle: float, way: float, bend: float, length: float
    ) -> str:
        """An arc that begins at a distance and angle from the middle."""
        return geometry(
            f'<arc curvature="{bend}"/>',
            s=s,
            x=far * math.cos(angle),
            y=far * math.sin(angle),
            hdg=way,
            length=length,
        )

    def entry(number: int, s: float = 0.0) -> str:
        turn = number * quarter
        way = turn + math.pi
        return curve(s, shape.mouth_m, turn, way, -1.0 / bend_m, bend_length_m)

    def ring(first: float, last: float, s: float = 0.0) -> str:
        length = inner_m * (last - first)
        return curve(s, inner_m, first, first + quarter, 1.0 / inner_m, length)

    def leaving(number: int, s: float = 0.0) -> str:
        angle = number * quarter - meets
        return curve(s, inner_m, angle, angle + quarter, -1.0 / bend_m, bend_length_m)

    def connecting(
        name: str, plan: str, length: float, junction: str, *ends: tuple[str, str]
    ) -> str:
        links = "".join(
            to_road(side, *end)
            for side, end in zip(("predecessor", "successor"), ends, strict=True)
        )
        return road(
            name,
            plan=plan,
            length=length,
            junction=junction,
            link=links,
            sections=_ONE_LANE,
        )

    parts = []
    links: dict[str, list[str]] = {}

    def connect(junction: str, incoming: str, name: str) -> None:
        link = f'<connection incomingRoad="{incoming}" connectingRoad="{name}"/>'
        links.setdefault(junction, []).append(link)

    for number in range(4):
        own = "900" if is_one_junction else f"90{number}"
        turn = number * quarter
        parts.append(
            road(
                f"{number}",
                plan=geometry(
                    x=shape.mouth_m * math.cos(turn),
                    y=shape.mouth_m * math.sin(turn),
                    hdg=turn,
                    length=arm_m,
                ),
                length=arm_m,
                link=to_junction("predecessor", own),
                sections=arm_lanes,
                street=f"Road {number}",
            )
        )
        if is_one_junction:
            for steps in (1, 2, 3):
                other = (number + steps) % 4
                first = turn + meets
                last = turn + steps * quarter - meets
                s = bend_length_m + inner_m * (last - first)
                plan = entry(number) + ring(first, last, bend_length_m)
                plan += leaving(number + steps, s)
                name = f"1{number}{other}"
                parts.append(
                    connecting(
                        name,
                        plan,
                        s + bend_length_m,
                        own,
                        (f"{number}", "start"),
                        (f"{other}", "start"),
                    )
                )
                connect(own, f"{number}", name)
            continue
        before = f"2{(number - 1) % 4}"
        after = f"2{number}"
        first = turn + meets
        last = turn + quarter - meets
        parts.append(
            road(
                after,
                plan=ring(first, last),
                length=inner_m * (last - first),
                link=to_junction("predecessor", own)
                + to_junction("successor", f"90{(number + 1) % 4}"),
                sections=_ONE_LANE,
            )
        )
        past_m = inner_m * 2.0 * meets
        past = ring(turn - meets, turn + meets)
        arm = (f"{number}", "start")
        parts.append(
            connecting(
                f"3{number}", past, past_m, own, (before, "end"), (after, "start")
            )
        )
        parts.append(
            connecting(
                f"4{number}", entry(number), bend_length_m, own, arm, (after, "start")
            )
        )
        parts.append(
            connecting(
                f"5{number}", leaving(number), bend_length_m, own, (before, "end"), arm
            )
        )
        connect(own, before, f"3{number}")
        connect(own, f"{number}", f"4{number}")
        connect(own, before, f"5{number}")
    junctions = [
        f'<junction id="{name}" name="">{"".join(found)}</junction>'
        for name, found in links.items()
    ]
    return document(*parts, *junctions)
