"""Numbers of a road's lanes in each direction, and who may use each of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from .elements import (
    DEFAULTS,
    WORDS,
    TagNote,
    Tags,
    is_yes,
    parse_count,
    side_value,
)

_RESERVED = DEFAULTS["reserved_lanes"]
_CLOSED_TO_CARS = frozenset(_RESERVED["closed_to_cars"])


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneCounts:
    """Numbers of lanes in each direction of a road.

    Attributes
    ----------
    n_forward : int
        Lanes along the nodes of the way.
    n_backward : int
        Lanes against them.
    is_shared : bool
        The only lane serves both directions; both counts are 1.
    has_centre : bool
        A lane in the middle is for turning from both directions.
    is_counted : bool
        Tags give the number of lanes.
    """

    n_forward: int
    n_backward: int
    is_shared: bool = False
    has_centre: bool = False
    is_counted: bool = False


def is_oneway(tags: Tags) -> bool:
    """True if cars drive one way only, along the nodes or against them."""
    text = tags.get("oneway", "").strip().lower()
    if text in ("yes", "true", "1", "-1", "reverse"):
        return True
    # No, alternating, reversible.
    if text:
        return False
    return (
        tags.get("junction") in ("roundabout", "circular")
        or tags["highway"] == "motorway"
    )


def runs_backward(tags: Tags) -> bool:
    """True if a one-way road is driven against the order of its nodes."""
    return tags.get("oneway", "").strip().lower() in ("-1", "reverse")


def count_lanes(tags: Tags, note: TagNote) -> LaneCounts:
    """Numbers of lanes of a road; senseless tags are noted.

    If it is a one-way road, its tags must be turned so that cars drive in the
    order of its nodes.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    note : TagNote
        Called with the reason where a tag is not followed.

    Returns
    -------
    counts : LaneCounts
        From tags, or the usual numbers of the road's class.
    """
    highest = int(DEFAULTS["cross_section"]["max_lanes"])
    usual = DEFAULTS["roads"][tags["highway"]]

    def number(key: str, at_most: int = highest) -> int | None:
        """Number in a tag; None if it is missing or makes no sense."""
        if key not in tags:
            return None
        count = parse_count(tags[key], highest=at_most)
        if count is None and tags[key].strip() != "0":
            note(f"{key} makes no sense; the usual number of lanes taken")
        return count

    def listed(key: str) -> int | None:
        """Number of lanes in a list such as "left|through"; None: no list."""
        text = tags.get(key)

        if text and "|" in text:
            return min(text.count("|") + 1, highest)
        return None

    total = number("lanes", 2 * highest)
    if is_oneway(tags):
        count = total or listed("turn:lanes") or listed("turn:lanes:forward")
        n_forward = min(count or usual["oneway_lanes"], highest)
        return LaneCounts(
            n_forward=n_forward,
            n_backward=0,
            is_counted=count is not None,
        )
    # Both directions: take the lane in the middle off the total first.
    has_centre = is_yes(tags.get("lanes:both_ways")) or "turn:lanes:both_ways" in tags
    if has_centre and total is not None:
        total = max(total - 1, 0) or None
    forward = number("lanes:forward") or listed("turn:lanes:forward")
    backward = number("lanes:backward") or listed("turn:lanes:backward")
    if total == 1 and forward is None and backward is None:
        return LaneCounts(n_forward=1, n_backward=1, is_shared=True, is_counted=True)
    is_counted = any(count is not None for count in (total, forward, backward))
    if total is not None and (forward is None) != (backward is None):
        rest = max(total - (forward or backward or 0), 1)
        forward = forward or rest
        backward = backward or rest
    elif total is not None and forward is None:
        # An odd lane is a turning lane of an unknown direction.
        forward = total - total // 2
        backward = total // 2
    if not is_counted and tags.get("lane_markings") == "no":
        forward = backward = 1
    is_shared = not is_counted and usual["is_shared"]
    return LaneCounts(
        n_forward=min(forward or usual["lanes"], highest),
        n_backward=min(backward or usual["lanes"], highest),
        is_shared=is_shared,
        has_centre=has_centre and not is_shared,
        is_counted=is_counted,
    )


# ---------- lanes that cars may not use
def is_closed_to_cars(access: str) -> bool:
    """True if a value of a tag on access names others than cars alone, or nobody.

    >>> [is_closed_to_cars(value) for value in ("no", "bus;taxi", "destination")]
    [True, True, False]
    """
    return {value.strip() for value in access.split(";")} <= _CLOSED_TO_CARS


class LaneKinds(NamedTuple):
    """Kinds of a road's lanes: "driving", "bus" or "cycling".

    Attributes
    ----------
    forward, backward : tuple of str
        Of the lanes in each direction, from left to right there.
    """

    forward: tuple[str, ...]
    backward: tuple[str, ...]


def find_reserved(
    tags: Tags,
    counts: LaneCounts,
    note: TagNote,
    *,
    keeps_left: bool,
) -> tuple[LaneCounts, LaneKinds]:
    """Who may use the lanes of a road, and their numbers with bus lanes.

    Lists of who may use each lane (``bus:lanes``, ``vehicle:lanes`` ..) say more
    than numbers (``lanes:bus``, ``lanes:psv``), and these more than ``busway``.
    What names no place is next to the kerb. Bus lanes are among those that
    ``lanes`` counts, unless no lane for cars would be left.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key. Those of a one-way road must be turned so
        that cars drive in the order of its nodes.
    counts : LaneCounts
        Numbers of lanes by :func:`count_lanes`.
    note : TagNote
        Called with the reason where a tag is not followed.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    counts : LaneCounts
        With lanes for buses against a one-way road, and those beside the lanes
        that are counted.
    kinds : LaneKinds
        Of all lanes.

    References
    ----------
    .. [1] OpenStreetMap Wiki: "Bus lanes", "Lanes", "Key:busway".
    """
    if counts.is_shared:
        return counts, LaneKinds(("driving",), ("driving",))
    is_alone = is_oneway(tags)
    if is_alone:
        counts = _with_lanes_against(tags, counts, note)
    forward = _kinds(
        tags, "forward", counts, note, is_alone=is_alone, keeps_left=keeps_left
    )
    backward: tuple[str, ...] = ()
    if counts.n_backward and is_alone:
        backward = ("bus",) * counts.n_backward
    elif counts.n_backward:
        backward = _kinds(
            tags, "backward", counts, note, is_alone=False, keeps_left=keeps_left
        )
    counts = replace(counts, n_forward=len(forward), n_backward=len(backward))
    return counts, LaneKinds(forward, backward)


def _with_lanes_against(tags: Tags, counts: LaneCounts, note: TagNote) -> LaneCounts:
    """Counts of a one-way road with the lanes on which buses come against it."""
    n_against = max(
        _listed_kinds(tags, "backward", is_alone=False).count("bus"),
        _counted_buses(tags, "backward", note, is_alone=False),
        int(_busway_side(tags, "backward", keeps_left=False) != ""),
    )
    if not n_against:
        return counts
    n_forward = counts.n_forward
    tagged = parse_count(tags.get("lanes:forward", ""), highest=n_forward)
    if tagged is not None:
        n_forward = tagged
    elif "lanes" in tags and counts.is_counted:
        n_forward = max(n_forward - n_against, 1)
    return replace(counts, n_forward=n_forward, n_backward=n_against)


def _kinds(
    tags: Tags,
    direction: str,
    counts: LaneCounts,
    note: TagNote,
    *,
    is_alone: bool,
    keeps_left: bool,
) -> tuple[str, ...]:
    """Kinds of the lanes of one direction in which cars drive.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    direction : {"forward", "backward"}
        Along the way or against it.
    counts : LaneCounts
        Numbers of lanes.
    note : TagNote
        Called with the reason where a tag is not followed.
    is_alone : bool
        The road is one-way: tags that name no direction count, too.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    kinds : tuple of str
        From left to right.
    """
    count = counts.n_forward
    if direction == "backward":
        count = counts.n_backward
    listed = _listed_kinds(tags, direction, is_alone=is_alone)
    on_road = tuple(kind for kind in listed if kind != "cycling")
    for kinds in (listed, on_road):
        if kinds and (len(kinds) == count or not counts.is_counted):
            return kinds
    # What is only counted lies next to the kerb, or on the side that busway names.
    side = "right"
    if keeps_left:
        side = "left"
    n_buses = listed.count("bus")
    if n_buses:
        note("lists of who may use its lanes do not fit their number: kerb taken")
    else:
        n_buses = _counted_buses(tags, direction, note, is_alone=is_alone)
    if not n_buses:
        busway = _busway_side(tags, direction, keeps_left=keeps_left)
        n_buses = int(busway != "")
        side = busway or side
    n_cars = count - n_buses
    if n_cars < 1:
        n_cars = count
        if counts.is_counted:
            note("buses have all its lanes: taken for lanes beside those of cars")
    cars = ("driving",) * n_cars
    buses = ("bus",) * n_buses
    if side == "left":
        return buses + cars
    return cars + buses


def _listed_kinds(tags: Tags, direction: str, *, is_alone: bool) -> tuple[str, ...]:
    """Kinds of lanes by lists of who may use each of them.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    direction : {"forward", "backward"}
        Along the way or against it.
    is_alone : bool
        The road is one-way: lists that name no direction count, too.

    Returns
    -------
    kinds : tuple of str
        From left to right; empty: no list says that cars may not use a lane.
    """

    def listed(user: str) -> list[str]:
        """Values of one user, lane by lane; empty: no list."""
        text = tags.get(f"{user}:lanes:{direction}")
        if text is None and is_alone:
            text = tags.get(f"{user}:lanes")
        if text is None:
            return []
        return [value.strip() for value in text.split("|")]

    # The most specific of the tags on cars comes first.
    of_cars = [listed(user) for user in WORDS["access"]]
    of_buses = [listed(user) for user in _RESERVED["buses"]]
    of_cyclists = listed("bicycle")
    n_lanes = max(map(len, [*of_cars, *of_buses]), default=0)

    def values(lists: Sequence[Sequence[str]], lane: int) -> list[str]:
        """What lists as long as the longest one say of a lane."""
        return [one[lane] for one in lists if len(one) == n_lanes and one[lane]]

    kinds = []
    for lane in range(n_lanes):
        cars = (values(of_cars, lane) or [""])[0]
        buses = values(of_buses, lane)
        cyclists = values([of_cyclists], lane)
        is_closed = is_closed_to_cars(cars)
        is_for_buses = not cars and any(one in _RESERVED["only"] for one in buses)
        is_for_cyclists = any(one in _RESERVED["only"] for one in cyclists)
        kind = "driving"
        if is_closed and is_for_cyclists and not any(map(is_yes, buses)):
            kind = "cycling"
        elif is_closed or is_for_buses:
            kind = "bus"
        kinds.append(kind)
    if set(kinds) <= {"driving"}:
        return ()
    return tuple(kinds)


def _counted_buses(tags: Tags, direction: str, note: TagNote, *, is_alone: bool) -> int:
    """Number of bus lanes of one direction, by tags such as ``lanes:psv``."""
    most = int(DEFAULTS["cross_section"]["max_lanes"])
    counted = [0]
    for user in _RESERVED["buses"]:
        own = parse_count(tags.get(f"lanes:{user}:{direction}", ""), highest=most)
        if own is not None:
            counted.append(own)
            continue
        names_direction = any(
            f"lanes:{user}:{one}" in tags for one in ("forward", "backward")
        )
        total = parse_count(tags.get(f"lanes:{user}", ""), highest=most)
        if total is None or names_direction:
            continue
        if is_alone:
            counted.append(total)
        elif not is_oneway(tags):
            if total % 2:
                note(f"lanes:{user} names no direction: the odd lane taken forward")
            is_forward = direction == "forward"
            counted.append((total + is_forward) // 2)
    return max(counted)


def _busway_side(tags: Tags, direction: str, *, keeps_left: bool) -> str:
    """Side of a direction's lanes on which ``busway`` has a lane; empty: none.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    direction : {"forward", "backward"}
        Along the way or against it.
    keeps_left : bool
        Traffic keeps left.

    Returns
    -------
    side : {"left", "right", ""}
        As traffic of that direction sees it.
    """
    near = "right"
    far = "left"
    if keeps_left:
        near = "left"
        far = "right"
    plain = tags.get("busway")
    sides = {side: side_value(tags, "busway", side) or "" for side in (near, far)}
    if is_oneway(tags):
        wanted = "lane"
        if direction == "backward":
            wanted = "opposite_lane"
        if plain == wanted:
            return near
        return next((side for side in sides if sides[side] == wanted), "")
    # Each direction has its own side of the road.
    own = near
    if direction == "backward":
        own = far
    if "lane" in (sides[own], plain):
        return near
    return ""
