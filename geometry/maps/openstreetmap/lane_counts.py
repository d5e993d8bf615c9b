"""How many lanes a road has in each direction, from its tags."""

from dataclasses import dataclass

from .defaults import DEFAULTS
from .elements import Tags
from .notes import Notes
from .tags import is_yes, parse_count


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneCounts:
    """Lanes of a road.

    Attributes
    ----------
    n_forward, n_backward : int
        In each direction, as the way's nodes run and against them.
    is_shared : bool
        The only lane is for both directions: both counts are 1 and mean the same lane.
    has_centre : bool
        There is a lane in the middle for turning from both directions.
    is_counted : bool
        Tags say how many lanes there are.
    """

    n_forward: int
    n_backward: int
    is_shared: bool = False
    has_centre: bool = False
    is_counted: bool = False


def is_oneway(tags: Tags) -> bool:
    """A road on which cars drive one way only, as its nodes run or against them."""
    text = tags.get("oneway", "").strip().lower()
    if text in ("yes", "true", "1", "-1", "reverse"):
        return True
    if text:  # no, alternating, reversible
        return False
    return tags.get("junction") in ("roundabout", "circular") or tags["highway"] == "motorway"


def runs_backward(tags: Tags) -> bool:
    """A one-way road on which cars drive against the order of its nodes."""
    return tags.get("oneway", "").strip().lower() in ("-1", "reverse")


def count_lanes(tags: Tags, *, element: str, notes: Notes) -> LaneCounts:
    """Lanes of a road in each direction.

    Parameters
    ----------
    tags : dict
        Of a way for cars; if it is a one-way road, cars drive along it as its nodes run.
    element : str
        For notes: "way 5".
    notes : Notes
        Told of what makes no sense.
    """
    highest = int(DEFAULTS["cross_section"]["max_lanes"])
    usual = DEFAULTS["roads"][tags["highway"]]

    def number(key: str, at_most: int = highest) -> int | None:
        if key not in tags:
            return None
        count = parse_count(tags[key], highest=at_most)
        if count is None and tags[key].strip() != "0":
            notes.add("ways", element, f"{key} makes no sense; the usual number of lanes taken")
        return count

    def listed(key: str) -> int | None:
        text = tags.get(key)
        return min(text.count("|") + 1, highest) if text and "|" in text else None

    total = number("lanes", 2 * highest)
    if is_oneway(tags):
        count = total or listed("turn:lanes") or listed("turn:lanes:forward")
        is_counted = count is not None
        return LaneCounts(
            n_forward=min(count or usual["oneway_lanes"], highest),
            n_backward=0,
            is_counted=is_counted,
        )
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
        forward, backward = forward or rest, backward or rest
    elif total is not None and forward is None:
        # An odd lane is somebody's turning lane; nothing says whose.
        forward, backward = total - total // 2, total // 2
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
