"""Roads of a map: cross-sections from tags, edges, and streets along them.

An edge is the part of a way between two nodes where ways begin, end or
meet. A street is a chain of edges along which a road goes straight on.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import chain, pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely import Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from ...arrays import BoolArray, FloatArray, IntArray
from ...lines import points_at, steps_m, true_runs
from ...scene import RoadUser, Turn
from ..source_map import parse_length_m, parse_speed_kmh
from .elements import (
    DEFAULTS,
    OPPOSITE,
    WORDS,
    Elements,
    TagNote,
    Tags,
    Way,
    is_yes,
    numbered,
    reversed_tags,
    side_value,
    tagged_length_m,
)
from .lane_counts import (
    LaneCounts,
    LaneKinds,
    count_lanes,
    find_reserved,
    is_closed_to_cars,
    is_oneway,
    runs_backward,
)
from .placement import DrivingLane, carriageway_left_m

# Kind, width [m], whether it runs as the way does.
Part = tuple[str, float, bool]
# Strips next to the driving lanes, outwards: on the carriageway, and behind the kerb.
Roadside = tuple[list[Part], list[Part]]
_ZONE = re.compile(r"[a-z]{2}:(?:zone:?)?(\d{1,3})")
# [m] forward, backward; from left to right there.
_Widths = tuple[Sequence[float], Sequence[float]]
# A road goes on into another one that turns off by less.
_MAX_STRAIGHT_ON_DEG = 60.0
# An edge and whether its first node is meant.
End = tuple[int, bool]
# At sharp bends lines next to a street are cut off.
_MAX_MITRE = 2.0


# ---------- strips next to the driving lanes
def roadside_strips(
    tags: Tags,
    note: TagNote,
    *,
    side: str,
    keeps_left: bool,
) -> Roadside:
    """Parked cars, cyclists and pedestrians on one side of a road.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    note : TagNote
        Called with the reason where a tag is not followed.
    side : {"left", "right"}
        Side along the way.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    inner : list of Part
        On the carriageway, outwards.
    outer : list of Part
        Behind the kerb, outwards.
    """
    # The side of traffic along the way.
    near_side = "right"
    if keeps_left:
        near_side = "left"
    is_near = side == near_side
    is_forward = is_near or is_oneway(tags)
    inner: list[Part] = []
    outer: list[Part] = []

    def width(key: str, usual_m: float) -> float:
        """Tagged width of a strip in metres, or the usual one."""
        keys = (f"{key}:{side}:width", f"{key}:both:width", f"{key}:width")
        width_m = tagged_length_m(tags, keys, (0.5, 15.0), note)
        if width_m is None:
            return usual_m
        return width_m

    usual = DEFAULTS["cross_section"]
    plain = tags.get("cycleway", "")
    if is_oneway(tags) and plain.startswith("opposite") == is_near:
        # Of a one-way road the plain tag means the side of its traffic.
        plain = ""
    cycleway = side_value(tags, "cycleway", side)
    if cycleway is None:
        cycleway = plain
    is_against = cycleway in ("opposite_lane", "opposite_track") or (
        tags.get(f"cycleway:{side}:oneway") == "-1"
    )
    cycles_forward = is_forward and not (is_against and is_oneway(tags))
    if cycleway in WORDS["cycle_lanes"]:
        inner.append(
            ("cycling", width("cycleway", usual["cycle_lane_width_m"]), cycles_forward)
        )
    position, orientation = _parking(tags, side)
    if position in (*WORDS["on_carriageway"], *WORDS["beside_carriageway"]):
        usual_m = usual.get(
            f"{orientation}_parking_width_m", usual["parallel_parking_width_m"]
        )
        part = ("parking", width("parking", usual_m), is_forward)
        if position in WORDS["on_carriageway"]:
            inner.append(part)
        else:
            outer.append(part)
    if cycleway in WORDS["cycle_tracks"]:
        outer.append(
            ("cycling", width("cycleway", usual["cycle_track_width_m"]), cycles_forward)
        )
    sidewalk = side_value(tags, "sidewalk", side)
    is_plain = sidewalk is None and tags.get("sidewalk") in ("both", "yes", side)
    if sidewalk == "yes" or is_plain:
        sidewalk_m = width("sidewalk", usual["sidewalk_width_m"])
        outer.append(("walking", sidewalk_m, is_forward))
    return inner, outer


def _parking(tags: Tags, side: str) -> tuple[str, str]:
    """Position and orientation of parked cars on a side.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    side : {"left", "right"}
        Side along the way.

    Returns
    -------
    position : str
        Where cars stand, as OpenStreetMap says it; "no": nowhere.
    orientation : str
        "parallel", "diagonal" or "perpendicular"; empty: no cars.
    """
    position = side_value(tags, "parking", side)
    if position is not None:

        def detail(key: str, otherwise: str) -> str:
            """Value for this side, or else for both sides."""
            both = tags.get(f"parking:both:{key}", otherwise)
            return tags.get(f"parking:{side}:{key}", both)

        restriction = detail("restriction", "")
        orientation = detail("orientation", "parallel")
        if restriction in ("no_stopping", "no_parking", "no_standing"):
            return "no", ""
        return position, orientation
    old = side_value(tags, "parking:lane", side) or ""
    if old in WORDS["old_orientations"]:
        where = tags.get(
            f"parking:lane:{side}:{old}", tags.get(f"parking:lane:both:{old}", "")
        )
        return WORDS["old_positions"].get(where, "lane"), old
    return "no", ""


# ---------- cross-sections
@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """One lane in a cross-section.

    Attributes
    ----------
    kind : str
        One of geometry.maps.source_map.LANE_KINDS.
    place : str
        "forward" or "backward" for lanes that are driven, "left" or "right" for
        others.
    number : int
        Among those of its place, and of its kind where that is "left" or "right";
        0: next to the kerb.
    width_m : float
        Full width. [m]
    left_m : float
        Of its middle, to the left of the way. [m]
    is_forward : bool
        Traffic runs in the direction of the way.
    turns : tuple of Turn
        By its markings; empty: it bears none.
    """

    kind: str
    place: str
    number: int
    width_m: float
    left_m: float
    is_forward: bool
    turns: tuple[Turn, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossSection:
    """Strips side by side along a way.

    Attributes
    ----------
    strips : tuple of Strip
        From left to right; `left_m` of each is to the left of the carriageway's
        middle.
    width_m : float
        From kerb to kerb, with parked cars and cycle lanes on the carriageway.
        [m]
    begin_left_m, end_left_m : float
        The carriageway's middle at both ends, to the left of the way. [m]
    """

    strips: tuple[Strip, ...]
    width_m: float
    begin_left_m: float = 0.0
    end_left_m: float = 0.0

    @property
    def is_centred(self) -> bool:
        """True if the way is the carriageway's middle."""
        return self.begin_left_m == self.end_left_m == 0.0

    def lanes(self, *, is_forward: bool) -> tuple[Strip, ...]:
        """Driving lanes of one direction, from the kerb to the axis."""
        lanes = [
            s for s in self.strips if s.kind == "driving" and s.is_forward == is_forward
        ]
        return tuple(sorted(lanes, key=lambda strip: strip.number))

    @property
    def directions(self) -> frozenset[bool]:
        """Directions in which cars drive: True is that of the way."""
        return frozenset(
            strip.is_forward for strip in self.strips if strip.kind == "driving"
        )

    def reversed(self) -> "CrossSection":
        """Cross-section along the way in the opposite order of nodes."""

        def turned(strip: Strip) -> Strip:
            place = OPPOSITE[strip.place]
            left_m = -strip.left_m
            return replace(
                strip,
                place=place,
                left_m=left_m,
                is_forward=not strip.is_forward,
            )

        strips = [turned(strip) for strip in self.strips[::-1]]
        return replace(
            self,
            strips=tuple(strips),
            begin_left_m=-self.end_left_m,
            end_left_m=-self.begin_left_m,
        )


# Middle of the carriageway to the left of a way at its begin and end [m]; None: as
# the road that it continues there has it.
_Ends = tuple[float | None, float | None]


def build_cross_section(
    tags: Tags, note: TagNote, *, keeps_left: bool
) -> tuple[CrossSection, _Ends]:
    """Cross-section of a road from its tags; senseless ones are noted.

    A one-way road must have its tags turned so that cars drive along its nodes.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    note : TagNote
        Called with the reason where a tag is not followed.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    section : CrossSection
        Strips from left to right.
    ends_left_m : (float or None, float or None)
        The carriageway's middle at the begin and end of the whole way, to the left of
        it; None: as the road that it continues there has it. [m]
    """
    left = roadside_strips(tags, note, side="left", keeps_left=keeps_left)
    right = roadside_strips(tags, note, side="right", keeps_left=keeps_left)
    counts = count_lanes(tags, note)
    counts, kinds = find_reserved(tags, counts, note, keeps_left=keeps_left)
    beside_m = sum(width for _, width, _ in (*left[0], *right[0]))
    widths, counts = _lane_widths(tags, counts, beside_m, note)
    driving = _driving(widths, counts, keeps_left=keeps_left)
    carriageway_m = sum(width for _, _, width in driving) + beside_m
    strips: list[Strip] = []
    # Strips beside the driving lanes, on the left and then on the right.
    for side, sign, (inner, outer) in (("left", 1.0, left), ("right", -1.0, right)):
        numbers: Counter[str] = Counter()
        # From the kerb inwards, then from the kerb outwards.
        for step, found in ((-1.0, inner[::-1]), (1.0, outer)):
            edge_m = 0.5 * carriageway_m
            for kind, width_m, is_forward in found:
                strips.append(
                    Strip(
                        kind=kind,
                        place=side,
                        number=numbers[kind],
                        width_m=width_m,
                        left_m=sign * (edge_m + step * 0.5 * width_m),
                        is_forward=is_forward,
                    )
                )
                numbers[kind] += 1
                edge_m += step * width_m
    left_m = 0.5 * carriageway_m - sum(width for _, width, _ in left[0])
    strips += _driving_strips(
        tags,
        driving,
        counts,
        kinds,
        left_m,
        note,
        keeps_left=keeps_left,
    )
    strips.sort(key=lambda strip: -strip.left_m)
    ends_left_m = carriageway_left_m(tags, driving, left_m, note)
    return CrossSection(strips=tuple(strips), width_m=carriageway_m), ends_left_m


def _driving_strips(
    tags: Tags,
    driving: Sequence[DrivingLane],
    counts: LaneCounts,
    kinds: LaneKinds,
    left_m: float,
    note: TagNote,
    *,
    keeps_left: bool,
) -> Iterator[Strip]:
    """Lanes that are driven from left to right; the centre lane is left out.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    driving : sequence of DrivingLane
        Driving lanes from left to right.
    counts : LaneCounts
        Numbers of lanes.
    kinds : LaneKinds
        Who may use them.
    left_m : float
        Left edge of the leftmost lane, to the left of the way. [m]
    note : TagNote
        Called with the reason where a tag is not followed.
    keeps_left : bool
        Traffic keeps left.

    Yields
    ------
    strip : Strip
        A shared lane yields one for each direction.
    """
    limits = DEFAULTS["cross_section"]
    turns = {
        "forward": _listed_turns(
            tags,
            "forward",
            counts.n_forward,
            note,
            is_alone=is_oneway(tags),
        ),
        "backward": _listed_turns(
            tags,
            "backward",
            counts.n_backward,
            note,
            is_alone=False,
        ),
    }
    kinds_of = {"forward": kinds.forward, "backward": kinds.backward}
    for place, number, width_m in driving:
        middle_m = left_m - 0.5 * width_m
        left_m -= width_m
        directions: tuple[str, ...] = (place,)
        if place == "both":
            directions = ("forward", "backward")
        elif place == "centre":
            directions = ()
        for direction in directions:
            is_forward = direction == "forward"
            aside_m = 0.0
            free_m = width_m
            if place == "both":
                # Cars of both directions keep to their side even there; so ends of
                # lanes differ.
                aside_m = 0.5 * limits["shared_apart_m"]
                free_m = max(width_m - 2.0 * aside_m, limits["min_lane_width_m"])
            if is_forward != keeps_left:
                aside_m = -aside_m
            # Turns are listed from left to right, lanes are counted from the kerb.
            place_in_list = -1 - number
            if keeps_left:
                place_in_list = number
            yield Strip(
                kind=kinds_of[direction][place_in_list],
                place=direction,
                number=number,
                width_m=free_m,
                left_m=middle_m + aside_m,
                is_forward=is_forward,
                turns=turns[direction][place_in_list],
            )


def _driving(
    widths: _Widths,
    counts: LaneCounts,
    *,
    keeps_left: bool,
) -> list[DrivingLane]:
    """Driving lanes from left to right.

    Parameters
    ----------
    widths : _Widths
        Widths in each direction. [m]
    counts : LaneCounts
        Numbers of lanes.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    lanes : list of DrivingLane
        From left to right.
    """
    if counts.is_shared:
        return [("both", 0, widths[0][0])]

    def listed(place: str, lanes: Sequence[float]) -> list[DrivingLane]:
        """Lanes of one direction from left to right, numbered from the kerb."""
        numbers = range(len(lanes))
        if not keeps_left:
            numbers = numbers[::-1]
        every = zip(numbers, lanes, strict=True)
        return [(place, number, lane_m) for number, lane_m in every]

    forward = listed("forward", widths[0])
    backward = listed("backward", widths[1])
    centre: list[DrivingLane] = []
    if counts.has_centre:
        centre_m = DEFAULTS["cross_section"]["centre_lane_width_m"]
        centre = [("centre", 0, centre_m)]
    if keeps_left:
        return [*forward, *centre, *backward[::-1]]
    return [*backward[::-1], *centre, *forward]


def _lane_widths(
    tags: Tags,
    counts: LaneCounts,
    beside_m: float,
    note: TagNote,
) -> tuple[_Widths, LaneCounts]:
    """Widths of the lanes in each direction, and the counts that fit.

    Listed widths of lanes count first, then the width of the carriageway, then
    usual widths.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    counts : LaneCounts
        Numbers of lanes.
    beside_m : float
        Width of parked cars and cycle lanes on the carriageway. [m]
    note : TagNote
        Called with the reason where a tag is not followed.

    Returns
    -------
    widths : (sequence of float, sequence of float)
        Forward and backward, from left to right there. [m]
    counts : LaneCounts
        Shared if the road is too narrow for two lanes.
    """
    limits = DEFAULTS["cross_section"]
    narrow_m = limits["min_lane_width_m"]
    wide_m = limits["max_lane_width_m"]
    usual_m = DEFAULTS["roads"][tags["highway"]]["lane_width_m"]
    centre_m = 0.0
    if counts.has_centre:
        centre_m = limits["centre_lane_width_m"]
    forward = _listed_widths(
        tags,
        "forward",
        counts.n_forward,
        is_alone=not counts.n_backward,
    )
    backward = _listed_widths(tags, "backward", counts.n_backward, is_alone=False)
    if not counts.is_shared and forward is not None and backward is not None:
        return (forward, backward), counts
    keys = ("width:carriageway", "width", "est_width")
    total_m = tagged_length_m(tags, keys, (1.0, 100.0), note, "usual widths")
    if total_m is not None:
        free_m = total_m - beside_m - centre_m
        fitting = counts
        if not counts.is_counted and counts.n_forward == counts.n_backward == 1:
            # Nothing says how many lanes there are: one where two cars could not pass.
            fitting = replace(counts, is_shared=free_m < 2.0 * narrow_m)
        n_lanes = counts.n_forward + counts.n_backward
        if fitting.is_shared:
            n_lanes = 1
        if narrow_m <= free_m / n_lanes <= wide_m:
            usual_m = free_m / n_lanes
            counts = fitting
        else:
            note("its width does not fit its lanes; usual widths taken")
    return ([usual_m] * counts.n_forward, [usual_m] * counts.n_backward), counts


def _listed_widths(
    tags: Tags,
    direction: str,
    count: int,
    *,
    is_alone: bool,
) -> list[float] | None:
    """Listed widths of lanes in metres; None: they do not fit the count.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    direction : {"forward", "backward"}
        Along the way or against it.
    count : int
        Number of lanes in that direction.
    is_alone : bool
        The other direction has no lanes: the plain tag counts, too.

    Returns
    -------
    widths : list of float or None
        From left to right. [m]
    """
    if not count:
        return []
    text = tags.get(f"width:lanes:{direction}")
    if not text and is_alone:
        text = tags.get("width:lanes")
    widths = [parse_length_m(part) for part in (text or "").split("|")]
    limits = DEFAULTS["cross_section"]
    low_m = limits["min_lane_width_m"]
    high_m = limits["max_lane_width_m"]
    known = [width for width in widths if width and low_m <= width <= high_m]
    if len(known) == len(widths) == count:
        return known
    return None


def _listed_turns(
    tags: Tags,
    direction: str,
    count: int,
    note: TagNote,
    *,
    is_alone: bool,
) -> list[tuple[Turn, ...]]:
    """Where cars may drive from each lane by its markings.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    direction : {"forward", "backward"}
        Along the way or against it.
    count : int
        Number of lanes in that direction.
    note : TagNote
        Called with the reason where a tag is not followed.
    is_alone : bool
        The other direction has no lanes: the plain tag counts, too.

    Returns
    -------
    turns : list of tuple of Turn
        From left to right; empty tuples where the lane bears no markings.
    """
    text = tags.get(f"turn:lanes:{direction}") or None
    if text is None and is_alone:
        text = tags.get("turn:lanes")
    lanes: list[str] = []
    if text is not None:
        lanes = text.split("|")
    words = DEFAULTS["turns"]
    listed: list[tuple[Turn, ...]] = []
    for lane in lanes:
        turns: list[Turn] = []
        for word in lane.split(";"):
            turns += words.get(word.strip(), ())
        listed.append(tuple(dict.fromkeys(turns)))
    if len(listed) == count:
        return listed
    if text is not None:
        note("turn:lanes has another number of lanes: markings not followed")
    return [()] * count


# ---------- who may not use a road
_CLOSED = DEFAULTS["closed_roads"]


def closed_to(tags: Tags) -> tuple[RoadUser, ...]:
    """Road users to which a road is closed, by its tags and its class.

    A road with a sidewalk or a cycle track of its own is not closed to those who
    use that.

    >>> closed_to({"highway": "motorway_link"})
    ('on foot', 'bicycle')
    >>> closed_to({"highway": "primary", "foot": "no", "sidewalk": "separate"})
    ()
    """
    is_fast = tags["highway"] in _CLOSED["fast"] or tags.get("motorroad") == "yes"
    found: list[RoadUser] = []
    users: tuple[tuple[RoadUser, str, str], ...] = (
        ("on foot", "foot", "sidewalk"),
        ("bicycle", "bicycle", "cycleway"),
    )
    for user, key, beside in users:
        sides = ("", ":left", ":right", ":both")
        ways = [tags.get(f"{beside}{side}") for side in sides]
        has_place = any(way in _CLOSED["beside"] for way in ways)
        is_named = key in tags
        is_closed = tags.get(key) in _CLOSED["no"] or (is_fast and not is_named)
        if is_closed and not has_place:
            found.append(user)
    if tags.get("motorcycle") in _CLOSED["no"]:
        found.append("motorcycle")
    return tuple(found)


# ---------- speed limits
def speed_limit_kmh(tags: Tags, *, is_forward: bool) -> float | None:
    """Speed limit of one direction of a road in km/h.

    Limits that hold only at times, for some vehicles or for some lanes are
    ignored.

    Limits that hold at times, for some vehicles or lanes are not looked at.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    is_forward : bool
        Along the nodes of the way.

    Returns
    -------
    limit_kmh : float or None
        None: the tags give none, or no number.

    >>> texts = ("50", "30 mph", "none")
    >>> [speed_limit_kmh({"maxspeed": text}, is_forward=True) for text in texts]
    [50.0, 48.3, None]
    >>> tags = {"maxspeed": "50", "maxspeed:backward": "FR:zone30"}
    >>> speed_limit_kmh(tags, is_forward=False)
    30.0
    """
    side = "backward"
    if is_forward:
        side = "forward"
    for key in (f"maxspeed:{side}", "maxspeed", *DEFAULTS["speed_limits"]["type_keys"]):
        text = tags.get(key, "").strip().lower()
        speed_kmh = _speed_kmh(text)
        if speed_kmh is not None or text == "none":
            return speed_kmh
    return None


def _speed_kmh(text: str) -> float | None:
    """Speed that a text states in km/h, such as "50" or "FR:zone30"."""
    words: dict[str, float] = DEFAULTS["speed_limits"]["words_kmh"]
    if text in words:
        return words[text]
    zone = _ZONE.fullmatch(text)
    if zone:
        text = zone[1]
    speed_kmh = parse_speed_kmh(text)
    if speed_kmh:
        return round(speed_kmh, 1)
    return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """Part of a way for cars between two nodes where ways begin, end or meet.

    Attributes
    ----------
    id : str
        Way and part: "w5", "w5.1".
    way_id : int
        Id of the way.
    rows : (n,) int
        Nodes; in a one-way road cars drive in their order.
    points_m : (n, 2) float
        Positions of the nodes. [m]
    tags : Tags
        Of the way, in the order of nodes here.
    section : CrossSection
        Lanes across it, in the order of nodes here.
    """

    id: str
    way_id: int
    rows: IntArray
    points_m: FloatArray
    tags: Tags
    section: CrossSection

    @property
    def is_service(self) -> bool:
        """True if it leads to a yard and is no road of the network."""
        return self.tags["highway"] == "service"

    @property
    def is_oneway(self) -> bool:
        """True if cars drive it one way only."""
        return is_oneway(self.tags)

    @property
    def is_roundabout(self) -> bool:
        """True if it is part of a roundabout's ring."""
        return self.tags.get("junction") in ("roundabout", "circular")

    @property
    def name(self) -> str:
        """Name or number of its street; empty: none."""
        return self.tags.get("name") or self.tags.get("ref", "")

    @property
    def level(self) -> int:
        """Its layer; 0: on the ground."""
        return level(self.tags)

    @property
    def middle_m(self) -> FloatArray:
        """Middle of its carriageway beside each node, (n, 2) in m."""
        if self.section.is_centred:
            return self.points_m
        street = Street(parts=((self, True),))
        return carriageway_points(street, street.stations_m)[0]


def level(tags: Tags) -> int:
    """Layer of a way; 0: on the ground.

    Bridges and tunnels that name no layer lie one above and one below the
    ground.
    """
    try:
        layer = int(tags.get("layer", "0"))
    except ValueError:
        layer = 0
    if layer:
        return int(np.clip(layer, -5, 5))
    tunnel = tags.get("tunnel")
    if is_yes(tunnel) and tunnel not in ("building_passage", "culvert"):
        return -1
    if is_yes(tags.get("bridge")):
        return 1
    return 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Network:
    """Edges, and the ends of edges that meet at each node.

    Attributes
    ----------
    edges : tuple of Edge
        Roads for cars, cut where ways begin, end or meet.
    ends : dict of int to tuple of End
        Ends of edges, by row of the node.
    elements : Elements
        Elements of the file.
    keeps_left : bool
        Traffic keeps left.
    """

    edges: tuple[Edge, ...]
    ends: Mapping[int, tuple[End, ...]]
    elements: Elements
    keeps_left: bool

    def bearing_deg(self, end: End) -> float:
        """Direction in which an edge leaves its node, over its first ten metres.

        Parameters
        ----------
        end : End
            An edge, and whether its first node is meant.

        Returns
        -------
        bearing_deg : float
            Counter-clockwise from east. [deg]
        """
        points = self.points_from(end)
        east, north = points_at(points, np.array(10.0)) - points[0]
        return float(np.degrees(np.arctan2(north, east)))

    def points_from(self, end: End) -> FloatArray:
        """Nodes of an edge from one of its ends, (n, 2)."""
        points = self.edges[end[0]].points_m
        if end[1]:
            return points
        return points[::-1]


def is_for_cars(tags: Tags) -> bool:
    """True if cars drive on a way: a road of the network, or to a yard."""
    if tags.get("highway") not in DEFAULTS["roads"] or tags.get("area") == "yes":
        return False
    # The most telling of the tags on access counts.
    access = next((tags[key] for key in WORDS["access"] if key in tags), "yes")
    if is_closed_to_cars(access):
        return False
    no_roads = ("parking_aisle", "driveway", "drive-through", "slipway")
    return tags.get("service") not in no_roads


def build_network(elements: Elements, *, keeps_left: bool) -> Network:
    """Network of the roads for cars.

    Ways with missing nodes and senseless tags are noted.

    Parameters
    ----------
    elements : Elements
        Elements of the file.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    network : Network
        Edges end where ways begin, end or meet.
    """
    runs: list[tuple[Way, list[IntArray]]] = []
    for way in elements.ways:
        if is_for_cars(way.tags):
            runs.append((way, list(known_runs(way, elements))))
            if (way.rows < 0).any() or not runs[-1][1]:
                why = (
                    "partly left out: nodes are missing in the file, as at the edge of"
                    " a cut-out"
                )
                elements.omissions.add("roads", f"way {way.id}", why)
    # Count how often ways pass each node: edges are cut where it is more than once.
    n_uses = np.zeros(len(elements.positions_m), dtype=np.int64)
    for rows in chain.from_iterable(found for _, found in runs):
        np.add.at(n_uses, rows[1:-1], 1)
        # Edges end where ways do.
        np.add.at(n_uses, rows[[0, -1]], 2)
    edges: list[Edge] = []
    # Edges of each way, and its carriageway's middle where that is not the way.
    placed: list[tuple[range, _Ends]] = []
    for way, found in runs:
        if not found:
            continue
        tags = dict(way.tags)
        step = 1
        if runs_backward(way.tags):
            tags = reversed_tags(tags) | {"oneway": "yes", "oneway:turned": "yes"}
            step = -1
        note = partial(elements.omissions.add, "ways", f"way {way.id}")
        section, ends_left_m = build_cross_section(tags, note, keeps_left=keeps_left)
        parts = []
        for run in found:
            rows = run[::step]
            for begin, end in pairwise(np.flatnonzero(n_uses[rows] > 1)):
                parts.append(rows[begin : end + 1])
        edges += [
            Edge(
                id=numbered(f"w{way.id}", number),
                way_id=way.id,
                rows=rows,
                points_m=elements.positions_m[rows],
                tags=tags,
                section=section,
            )
            for number, rows in enumerate(parts)
        ]
        if ends_left_m != (0.0, 0.0):
            own = range(len(edges) - len(parts), len(edges))
            placed.append((own, ends_left_m))
    network = network_of(edges, elements, keeps_left=keeps_left)
    if not placed:
        return network
    return replace(network, edges=tuple(_place_edges(network, placed)))


def _place_edges(network: Network, placed: Sequence[tuple[range, _Ends]]) -> list[Edge]:
    """Edges of a network, with the middles of their carriageways beside the ways.

    Along a way the middle goes straight from one end's place to the other's.

    Parameters
    ----------
    network : Network
        Its edges lie in the middle of the carriageway.
    placed : sequence of (range, _Ends)
        Edges of a way, and the carriageway's middle at the way's ends.
    """
    edges = list(network.edges)

    def put(own: range, begin_m: float, end_m: float) -> None:
        lengths_m = [steps_m(edges[at].points_m).sum() for at in own]
        stations_m = np.append(0.0, np.cumsum(lengths_m))
        lefts_m = np.interp(stations_m, [0.0, stations_m[-1]], [begin_m, end_m])
        for at, (begin, end) in zip(own, pairwise(lefts_m.tolist()), strict=True):
            section = replace(edges[at].section, begin_left_m=begin, end_left_m=end)
            edges[at] = replace(edges[at], section=section)

    # Ways without a place of their own come last: they take that of others.
    for own, (begin_m, end_m) in sorted(placed, key=lambda way: None in way[1]):
        if begin_m is None:
            begin_m = _continued_left_m(network, edges, (own[0], True))
        if end_m is None:
            end_m = _continued_left_m(network, edges, (own[-1], False))
        put(own, begin_m, end_m)
    return edges


def _continued_left_m(network: Network, edges: Sequence[Edge], tip: End) -> float:
    """Carriageway's middle of the road that an edge continues, left of that edge.

    Parameters
    ----------
    network : Network
        Which edges meet.
    edges : sequence of Edge
        The same edges, with the places of their carriageways.
    tip : End
        End of the edge.

    Returns
    -------
    left_m : float
        0 where it continues none. [m]
    """
    index, is_start = tip
    at = -1
    if is_start:
        at = 0
    row = int(edges[index].rows[at])
    for pair in pair_ends(network, network.ends[row]):
        if tip not in pair:
            continue
        other = pair[1 - pair.index(tip)]
        section = edges[other[0]].section
        left_m = section.end_left_m
        if other[1]:
            left_m = section.begin_left_m
        # Two that both begin here, or both end, run against each other.
        if other[1] == is_start:
            return -left_m
        return left_m
    return 0.0


def network_of(
    edges: Sequence[Edge], elements: Elements, *, keeps_left: bool
) -> Network:
    """Network of edges.

    Parameters
    ----------
    edges : sequence of Edge
        Roads for cars.
    elements : Elements
        What they are made of.
    keeps_left : bool
        Traffic keeps left.
    """
    ends: dict[int, tuple[End, ...]] = defaultdict(tuple)
    for index, edge in enumerate(edges):
        ends[int(edge.rows[0])] += ((index, True),)
        ends[int(edge.rows[-1])] += ((index, False),)
    return Network(
        edges=tuple(edges),
        ends=dict(ends),
        elements=elements,
        keeps_left=keeps_left,
    )


def known_runs(way: Way, elements: Elements) -> Iterator[IntArray]:
    """Parts of a way whose nodes the file has.

    Nodes that lie where the last one did are left out.

    Parameters
    ----------
    way : Way
        The way.
    elements : Elements
        Elements of the file.

    Yields
    ------
    rows : (n,) int
        At least two rows of `elements`.
    """
    for begin, end in true_runs(way.rows >= 0):
        part = way.rows[begin:end]
        part = part[np.append(True, steps_m(elements.positions_m[part]) > 0.01)]
        if len(part) >= 2:
            yield part


def lines_of(way: Way, elements: Elements) -> Iterator[FloatArray]:
    """Lines of the parts of a way whose nodes the file has, (n, 2) each."""
    for rows in known_runs(way, elements):
        yield elements.positions_m[rows]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Street:
    """Edges one after the other, between two nodes where they stop.

    Attributes
    ----------
    parts : tuple[tuple[Edge, bool], ...]
        Edges, and whether they are followed in the order of their nodes.
    points_m : (n, 2) float
        Points of the axis. [m]
    rows : (n,) int
        Rows of the nodes.
    stations_m : (n,) float
        Distance of each point along the street. [m]
    normals : (n - 1, 2) float
        Unit vectors to the left between points.
    breaks_m : (n_parts + 1,) float
        Begins and ends of the parts along the street. [m]
    sections : tuple of CrossSection
        Cross-section of each part, in the direction of the street.
    """

    parts: tuple[tuple[Edge, bool], ...]
    points_m: FloatArray = field(init=False)
    rows: IntArray = field(init=False)
    stations_m: FloatArray = field(init=False)
    normals: FloatArray = field(init=False)
    breaks_m: FloatArray = field(init=False)
    sections: tuple[CrossSection, ...] = field(init=False)

    def __post_init__(self) -> None:
        points: list[FloatArray] = []
        rows: list[IntArray] = []
        for at, (edge, is_along) in enumerate(self.parts):
            step = -1
            if is_along:
                step = 1
            # The first node of an edge is the last one of the edge before.
            skip = min(at, 1)
            points.append(edge.points_m[::step][skip:])
            rows.append(edge.rows[::step][skip:])
        joined = np.concatenate(points)
        steps = np.diff(joined, axis=0)
        lengths = np.hypot(*steps.T)
        stations = np.append(0.0, np.cumsum(lengths))
        last = np.cumsum([len(part) for part in points]) - 1
        sections = tuple(
            edge.section if is_along else edge.section.reversed()
            for edge, is_along in self.parts
        )
        for name, value in (
            ("points_m", joined),
            ("rows", np.concatenate(rows)),
            ("stations_m", stations),
            (
                "normals",
                np.column_stack([-steps[:, 1], steps[:, 0]]) / lengths[:, None],
            ),
            ("breaks_m", np.append(0.0, stations[last])),
            ("sections", sections),
        ):
            object.__setattr__(self, name, value)

    @property
    def length_m(self) -> float:
        """Length from end to end, in metres."""
        return float(self.stations_m[-1])

    def reversed(self) -> "Street":
        """Street from its end to its start."""
        turned = ((edge, not is_along) for edge, is_along in self.parts[::-1])
        return replace(self, parts=tuple(turned))

    def part_at(self, station_m: float) -> int:
        """Index of the part at a distance along the street."""
        if len(self.parts) == 1:
            return 0
        index = int(np.searchsorted(self.breaks_m, station_m, side="right")) - 1
        return min(max(index, 0), len(self.parts) - 1)

    def section_at(self, station_m: float) -> CrossSection:
        """Cross-section at a distance along the street."""
        return self.sections[self.part_at(station_m)]

    def left_m(self, part: int, stations_m: ArrayLike) -> FloatArray:
        """Middle of a part's carriageway to the left of the street, in metres.

        Parameters
        ----------
        part : int
            Index of the part.
        stations_m : (n,) float
            Along the street; before the part it is as at its begin, behind it as at
            its end. [m]
        """
        section = self.sections[part]
        lefts_m = [section.begin_left_m, section.end_left_m]
        stations = np.asarray(stations_m, dtype=np.float64)
        return np.interp(stations, self.breaks_m[part : part + 2], lefts_m)

    def strips_at(self, part: int, station_m: float) -> tuple[Strip, ...]:
        """Strips of a part; `left_m` of each is to the left of the street here."""
        strips = self.sections[part].strips
        left_m = float(self.left_m(part, station_m))
        if left_m == 0.0:
            return strips
        return tuple(replace(strip, left_m=strip.left_m + left_m) for strip in strips)

    def lanes_at(self, station_m: float, *, is_forward: bool) -> tuple[Strip, ...]:
        """Driving lanes of one direction here, from the kerb, as `strips_at` has them.

        Parameters
        ----------
        station_m : float
            Distance along the street. [m]
        is_forward : bool
            Those along the street.
        """
        part = self.part_at(station_m)
        strips = self.strips_at(part, station_m)
        section = replace(self.sections[part], strips=strips)
        return section.lanes(is_forward=is_forward)


def trace_streets(network: Network, stops: Callable[[int], bool]) -> list[Street]:
    """Streets along the roads; every edge is part of exactly one.

    At other nodes a road goes straight on if it can, and roads that join from
    the side end there.

    Parameters
    ----------
    network : Network
        Roads for cars.
    stops : Callable[[int], bool]
        True for the row of a node where every street ends.

    Returns
    -------
    streets : list of Street
        Rings without an end come last.
    """
    partner: dict[End, End] = {}
    for row, ends in network.ends.items():
        if not stops(row):
            for one, other in pair_ends(network, ends):
                partner[one] = other
                partner[other] = one
    # Start where nothing leads on, and then on what is left.
    is_done = np.zeros(len(network.edges), dtype=bool)
    streets = []
    starts = [
        end for ends in network.ends.values() for end in ends if end not in partner
    ]
    # Rings without an end.
    rest = [(index, True) for index in range(len(network.edges))]
    for begin in starts + rest:
        if is_done[begin[0]]:
            continue
        parts = []
        end: End | None = begin
        while end is not None and not is_done[end[0]]:
            index, is_start = end
            is_done[index] = True
            parts.append((network.edges[index], is_start))
            end = partner.get((index, not is_start))
        streets.append(Street(parts=tuple(parts)))
    return streets


def pair_ends(network: Network, ends: tuple[End, ...]) -> Iterator[tuple[End, End]]:
    """Pairs of roads that continue each other at a node without a junction.

    Parameters
    ----------
    network : Network
        Roads for cars.
    ends : tuple of End
        Ends of the edges that meet at the node.

    Yields
    ------
    pair : (End, End)
        The straightest ones first; each end is in one pair at most.
    """
    edges = network.edges
    bearings = {end: network.bearing_deg(end) for end in ends}
    # Every pair that may go on: no yards first, no ramps first, the straightest first.
    choices = []
    for index, one in enumerate(ends):
        for other in ends[:index]:
            turn = abs((bearings[one] - bearings[other]) % 360.0 - 180.0)
            pair = [edges[one[0]], edges[other[0]]]
            n_service = sum(edge.is_service for edge in pair)
            n_links = sum(edge.tags["highway"].endswith("_link") for edge in pair)
            n_full = sum(not edges[end[0]].is_service for end in ends)
            # Where nothing else meets, a road goes on round any bend.
            is_bend = len(ends) == 2 or (n_full == 2 and n_service == 0)
            is_bend = is_bend and n_links != 1
            is_allowed = turn <= _MAX_STRAIGHT_ON_DEG or is_bend
            # Two one-way roads that both lead here, or both away, do not follow each
            # other.
            leads_on = not all(edge.is_oneway for edge in pair) or one[1] != other[1]
            is_alike = n_service != 1 or len(ends) == 2
            if is_allowed and is_alike and leads_on:
                choices.append((n_service, n_links, turn, one, other))
    used: set[End] = set()
    for *_, one, other in sorted(choices):
        if one not in used and other not in used:
            used |= {one, other}
            yield one, other


# ---------- lines and areas next to a street
def axis_points(street: Street, stations_m: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Points of a street's axis, and the step for each metre to the left.

    At bends the step is longer than 1, so that offset lines stay parallel to
    both sides, but at most twice as long.

    Parameters
    ----------
    street : Street
        The street.
    stations_m : (n,) float
        Distances along the street. [m]

    Returns
    -------
    middle : (n, 2) float
        Points of the axis. [m]
    across : (n, 2) float
        Step to the left per metre of offset.
    """
    stations = np.asarray(stations_m, dtype=np.float64)
    stations = np.minimum(np.maximum(stations, 0.0), street.length_m)
    points = street.points_m
    along = street.stations_m
    normals = street.normals
    last = len(normals) - 1
    before = np.searchsorted(along, stations - 1e-6, side="right") - 1
    after = np.searchsorted(along, stations + 1e-6, side="right") - 1
    before = np.minimum(np.maximum(before, 0), last)
    after = np.minimum(np.maximum(after, 0), last)
    normal = normals[before] + normals[after]
    squared = np.maximum((normal * normal).sum(axis=1), 1e-9)
    # As long as the offsets of both sides need.
    across = normal * (2.0 / squared)[:, None]
    length = 2.0 / np.sqrt(squared)
    across *= np.minimum(1.0, _MAX_MITRE / length)[:, None]
    # Left of a segment is its normal: the segment itself is the normal turned back.
    steps_m = stations - along[before]
    middle = points[before] + steps_m[:, None] * normals[before][:, ::-1] * [1.0, -1.0]
    return middle, across


def carriageway_points(
    street: Street, stations_m: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Points in the middle of a street's carriageway, and the step to the left.

    As `axis_points`, which are those of the way.
    """
    middle, across = axis_points(street, stations_m)
    if all(one.is_centred for one in street.sections):
        return middle, across
    stations = np.asarray(stations_m, dtype=np.float64)
    lefts_m = [float(street.left_m(street.part_at(one), one)) for one in stations]
    return middle + np.array(lefts_m)[:, None] * across, across


def has_no_knot(line_m: FloatArray, middle: FloatArray) -> BoolArray:
    """Points of a line beside a street that run as the street does.

    At sharp bends a line on the inner side would run backwards for a while;
    `middle` are the points of the street's axis beside those of the line.

    Parameters
    ----------
    line_m : (n, 2) float
        The line. [m]
    middle : (n, 2) float
        Points of the axis beside it. [m]

    Returns
    -------
    is_kept : (n,) bool
        False for points to leave out.
    """
    is_kept = np.ones(len(line_m), dtype=bool)
    steps = np.einsum("ij,ij->i", np.diff(line_m, axis=0), np.diff(middle, axis=0))
    if (steps > 0.0).all():
        return is_kept
    last = 0
    # Drop points that do not lead on from the last one kept; the end always stays.
    for index in range(1, len(line_m)):
        step = line_m[index] - line_m[last]
        along = middle[index] - middle[last]
        if step @ along <= 1e-3 * np.hypot(*along):
            if index < len(line_m) - 1:
                is_kept[index] = False
                continue
            is_kept[last] = last == 0
        last = index
    return is_kept


def stations_between(
    street: Street,
    begin_m: float,
    end_m: float,
    extra: Sequence[float] = (),
) -> FloatArray:
    """Stations where a line next to a street needs points.

    Parameters
    ----------
    street : Street
        The street.
    begin_m : float
        First station. [m]
    end_m : float
        Last station. [m]
    extra : sequence of float
        Further stations, kept if they lie between. [m]

    Returns
    -------
    stations_m : (n,) float
        Begin, bends and extra ones, end. [m]
    """
    every = np.concatenate([street.stations_m, np.asarray(extra, dtype=np.float64)])
    inside = np.unique(every[(every > begin_m + 0.05) & (every < end_m - 0.05)])
    return np.concatenate([[begin_m], inside, [end_m]])


def surface(street: Street, begin_m: float, end_m: float) -> BaseGeometry:
    """Carriageway of a street between two stations, from kerb to kerb.

    Parameters
    ----------
    street : Street
        The street.
    begin_m : float
        First station. [m]
    end_m : float
        Last station. [m]

    Returns
    -------
    area : BaseGeometry
        In metres; empty if the stations are not apart.
    """
    pieces: list[BaseGeometry] = []
    for index, section in enumerate(street.sections):
        low = max(begin_m, float(street.breaks_m[index]))
        high = min(end_m, float(street.breaks_m[index + 1]))
        if high - low < 1e-3:
            continue
        stations = stations_between(street, low, high)
        middle, across = axis_points(street, stations)
        if not section.is_centred:
            middle = middle + street.left_m(index, stations)[:, None] * across
        edges = [middle + sign * 0.5 * section.width_m * across for sign in (1.0, -1.0)]
        edges = [edge[has_no_knot(edge, middle)] for edge in edges]
        pieces.append(make_valid(Polygon(np.concatenate([edges[0], edges[1][::-1]]))))
    if pieces:
        return reduce(shapely.union, pieces)
    return Polygon()
