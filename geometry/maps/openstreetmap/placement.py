"""Where in its carriageway a way was drawn: the tag ``placement``.

Without the tag a way is taken for the middle of the carriageway. Its values and
keys: https://wiki.openstreetmap.org/wiki/Key:placement. A value names a lane of one
direction, counted from the left as seen in that direction, and which line of it the
way is: "middle_of:2" is the middle of the second lane.
"""

import re
from collections.abc import Sequence

from .elements import TagNote, Tags
from .lane_counts import is_oneway

_PLACE = re.compile(r"(left_of|middle_of|right_of):(\d+)")
# Share of the lane's width from its left edge to the way.
_SHARES = {"left_of": 0.0, "middle_of": 0.5, "right_of": 1.0}
_TRANSITION = "transition"
# Direction ("both": shared, "centre": for turning), number from the kerb, width [m].
DrivingLane = tuple[str, int, float]


def carriageway_left_m(
    tags: Tags, driving: Sequence[DrivingLane], left_edge_m: float, note: TagNote
) -> tuple[float | None, float | None]:
    """Middle of the carriageway, to the left of a way, at the way's begin and end.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key; a one-way road's are turned so that cars drive
        along its nodes.
    driving : sequence of DrivingLane
        Driving lanes from left to right.
    left_edge_m : float
        Left edge of the leftmost one, to the left of the carriageway's middle. [m]
    note : TagNote
        Called with the reason where a tag is not followed.

    Returns
    -------
    begin_m, end_m : float or None
        None: as the road that the way continues there has it. [m]
    """
    if not any(key.partition(":")[0] == "placement" for key in tags):
        return 0.0, 0.0
    if tags.get("junction") in ("roundabout", "circular"):
        note("placement is not followed on a roundabout")
        return 0.0, 0.0
    begin, end = "start", "end"
    if tags.get("oneway:turned") == "yes":
        begin, end = end, begin
    found: list[float | None] = []
    for tip in (begin, end):
        direction, value = _value(tags, tip)
        if value in ("", _TRANSITION):
            found.append(None)
            continue
        way_m = _way_left_m(value, _lanes(driving, direction, left_edge_m))
        if way_m is None:
            note(
                f"placement={value} names no lane of the road: the way is taken for the"
                " middle of the carriageway"
            )
            return 0.0, 0.0
        found.append(-way_m)
    is_transition = _TRANSITION in [tags.get(key, "").strip() for key in _keys(tags)]
    if found == [None, None] and not is_transition:
        note(
            "placement of a road of two directions must be placement:forward or"
            " placement:backward: it is not followed"
        )
        return 0.0, 0.0
    return found[0], found[1]


def _keys(tags: Tags) -> list[str]:
    """Keys for whole ways that are followed, those that name a direction first."""
    keys = ["placement:forward", "placement:backward"]
    if is_oneway(tags):
        keys.append("placement")
    return keys


def _value(tags: Tags, tip: str) -> tuple[str, str]:
    """Direction and value that hold at one end of a way.

    Parameters
    ----------
    tags : Tags
        Tags of the element, by key.
    tip : {"start", "end"}
        The end, by the order in which the way was drawn.

    Returns
    -------
    direction : {"forward", "backward"}
        Whose lanes are counted.
    value : str
        Empty: none.
    """
    # What is said of one end goes before what is said of the whole way.
    for suffix in (f":{tip}", ""):
        for key in _keys(tags):
            value = tags.get(f"{key}{suffix}", "").strip()
            if value:
                direction = "forward"
                if key.endswith("backward"):
                    direction = "backward"
                return direction, value
    return "forward", ""


def _lanes(
    driving: Sequence[DrivingLane], direction: str, left_edge_m: float
) -> list[tuple[float, float]]:
    """Edges of the lanes of one direction, in the order in which they are counted.

    Returns
    -------
    edges : list of (float, float)
        The left and the right one as seen in that direction, each to the left of the
        carriageway's middle as seen along the way. [m]
    """
    found = []
    for place, _, width_m in driving:
        right_edge_m = left_edge_m - width_m
        if place in (direction, "both"):
            found.append((left_edge_m, right_edge_m))
        left_edge_m = right_edge_m
    if direction == "backward":
        return [(right_m, left_m) for left_m, right_m in reversed(found)]
    return found


def _way_left_m(value: str, lanes: Sequence[tuple[float, float]]) -> float | None:
    """The way, to the left of the carriageway's middle, in metres; None: senseless."""
    match = _PLACE.fullmatch(value)
    if match is None:
        return None
    index = int(match[2]) - 1
    if not 0 <= index < len(lanes):
        return None
    near_m, far_m = lanes[index]
    return near_m + _SHARES[match[1]] * (far_m - near_m)
