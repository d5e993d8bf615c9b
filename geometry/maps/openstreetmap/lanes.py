"""Lanes of a road from its tags: number, widths, strips next to them, and speed limits."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from ...scene import Turn
from .elements import DEFAULTS, OPPOSITE, Tags, is_yes, parse_count, parse_length_m, side_value

Note = Callable[[str], None]  # says that a tag of the way at hand is not followed, and why
Part = tuple[str, float, bool]  # kind, width [m], whether it runs as the way does
_ON_CARRIAGEWAY = ("lane", "half_on_kerb", "shoulder", "yes")
_BESIDE_CARRIAGEWAY = ("street_side", "on_kerb")
_OLD_ORIENTATIONS = ("parallel", "diagonal", "perpendicular")
_OLD_POSITIONS = {"street_side": "street_side", "on_kerb": "on_kerb", "lay_by": "street_side"}
_CYCLE_LANES = ("lane", "opposite_lane")
_CYCLE_TRACKS = ("track", "opposite_track")
# Strips next to the driving lanes, outwards: on the carriageway, and behind the kerb.
Roadside = tuple[list[Part], list[Part]]
_KMH_PER_MPH = 1.609344
_SPEED = re.compile(r"(\d{1,3}(?:[.,]\d{1,3})?)\s*(mph|km/h|kmh|kph)?")
_ZONE = re.compile(r"[a-z]{2}:(?:zone:?)?(\d{1,3})")
_Widths = tuple[Sequence[float], Sequence[float], float]
"""Widths [m] of lanes forward and backward, from left to right there, and of the centre lane."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneCounts:
    """Lanes of a road in each direction, as the way's nodes run and against them."""

    n_forward: int
    n_backward: int
    is_shared: bool = False  # the only lane serves both directions; both counts are 1
    has_centre: bool = False  # a lane in the middle is for turning from both directions
    is_counted: bool = False  # tags give the number of lanes


def is_oneway(tags: Tags) -> bool:
    """A road on which cars drive one way only, in the order of its nodes or against it."""
    text = tags.get("oneway", "").strip().lower()
    if text in ("yes", "true", "1", "-1", "reverse"):
        return True
    if text:  # no, alternating, reversible
        return False
    return tags.get("junction") in ("roundabout", "circular") or tags["highway"] == "motorway"


def runs_backward(tags: Tags) -> bool:
    """A one-way road on which cars drive against the order of its nodes."""
    return tags.get("oneway", "").strip().lower() in ("-1", "reverse")


def count_lanes(tags: Tags, note: Note) -> LaneCounts:
    """Lanes of a road in each direction, a one-way one along its nodes; odd tags are noted."""
    highest = int(DEFAULTS["cross_section"]["max_lanes"])
    usual = DEFAULTS["roads"][tags["highway"]]

    def number(key: str, at_most: int = highest) -> int | None:
        if key not in tags:
            return None
        count = parse_count(tags[key], highest=at_most)
        if count is None and tags[key].strip() != "0":
            note(f"{key} makes no sense; the usual number of lanes taken")
        return count

    def listed(key: str) -> int | None:
        text = tags.get(key)
        return min(text.count("|") + 1, highest) if text and "|" in text else None

    total = number("lanes", 2 * highest)
    if is_oneway(tags):
        count = total or listed("turn:lanes") or listed("turn:lanes:forward")
        n_forward = min(count or usual["oneway_lanes"], highest)
        return LaneCounts(n_forward=n_forward, n_backward=0, is_counted=count is not None)
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
        # An odd lane is a turning lane of an unknown direction.
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


# ---------- strips next to the driving lanes


def roadside_strips(tags: Tags, note: Note, *, side: str, keeps_left: bool) -> Roadside:
    """Parked cars, cyclists and pedestrians on a side of a road, "left" or "right"."""
    is_near = side == ("left" if keeps_left else "right")  # the side of traffic along the way
    is_forward = is_near or is_oneway(tags)
    inner: list[Part] = []
    outer: list[Part] = []

    def width(key: str, usual_m: float) -> float:
        keys = (f"{key}:{side}:width", f"{key}:both:width", f"{key}:width")
        text = next((tags[one] for one in keys if one in tags), None)
        if text is None:
            return usual_m
        width_m = parse_length_m(text)
        if width_m is None or not 0.5 <= width_m <= 15.0:
            note(f"{key} width makes no sense; the usual one taken")
            return usual_m
        return width_m

    usual = DEFAULTS["cross_section"]
    cycleway = _cycleway(tags, side, is_near=is_near)
    is_against = cycleway in ("opposite_lane", "opposite_track") or (
        tags.get(f"cycleway:{side}:oneway") == "-1"
    )
    cycles_forward = is_forward and not (is_against and is_oneway(tags))
    if cycleway in _CYCLE_LANES:
        inner.append(("cycling", width("cycleway", usual["cycle_lane_width_m"]), cycles_forward))
    position, orientation = _parking(tags, side)
    if position in (*_ON_CARRIAGEWAY, *_BESIDE_CARRIAGEWAY):
        usual_m = usual.get(f"{orientation}_parking_width_m", usual["parallel_parking_width_m"])
        part = ("parking", width("parking", usual_m), is_forward)
        (inner if position in _ON_CARRIAGEWAY else outer).append(part)
    if cycleway in _CYCLE_TRACKS:
        outer.append(("cycling", width("cycleway", usual["cycle_track_width_m"]), cycles_forward))
    sidewalk = side_value(tags, "sidewalk", side)
    if sidewalk == "yes" or (sidewalk is None and tags.get("sidewalk") in ("both", "yes", side)):
        outer.append(("walking", width("sidewalk", usual["sidewalk_width_m"]), is_forward))
    return inner, outer


def _cycleway(tags: Tags, side: str, *, is_near: bool) -> str:
    named = side_value(tags, "cycleway", side)
    plain = tags.get("cycleway", "")
    if named is None and is_oneway(tags) and plain.startswith("opposite") == is_near:
        return ""  # of a one-way road the plain tag means the side of its traffic
    return plain if named is None else named


def _parking(tags: Tags, side: str) -> tuple[str, str]:
    """Position and orientation of parked cars on a side."""
    position = side_value(tags, "parking", side)
    if position is not None:
        restriction, orientation = (
            tags.get(f"parking:{side}:{key}", tags.get(f"parking:both:{key}", default))
            for key, default in (("restriction", ""), ("orientation", "parallel"))
        )
        if restriction in ("no_stopping", "no_parking", "no_standing"):
            return "no", ""
        return position, orientation
    old = side_value(tags, "parking:lane", side) or ""
    if old in _OLD_ORIENTATIONS:
        where = tags.get(f"parking:lane:{side}:{old}", tags.get(f"parking:lane:both:{old}", ""))
        return _OLD_POSITIONS.get(where, "lane"), old
    return "no", ""


# ---------- cross-sections
@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """One lane in a cross-section."""

    kind: str  # one of geometry.maps.source_map.LANE_KINDS
    place: str  # "forward" or "backward" for driving lanes, "left" or "right" for others
    number: int  # among those of its kind and place; 0: next to the kerb
    width_m: float
    left_m: float  # of its middle, to the left of the way
    is_forward: bool  # traffic runs in the direction of the way
    turns: tuple[Turn, ...] = ()  # by its markings; empty: it bears none


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossSection:
    """Strips side by side along a way, which runs in the middle of the carriageway."""

    strips: tuple[Strip, ...]  # from left to right
    width_m: float  # from kerb to kerb, with parked cars and cycle lanes on the carriageway

    def lanes(self, *, is_forward: bool) -> tuple[Strip, ...]:
        """Driving lanes of one direction, from the kerb to the axis."""
        lanes = [s for s in self.strips if s.kind == "driving" and s.is_forward == is_forward]
        return tuple(sorted(lanes, key=lambda strip: strip.number))

    @property
    def directions(self) -> frozenset[bool]:
        """Directions in which cars drive: True is that of the way."""
        return frozenset(strip.is_forward for strip in self.strips if strip.kind == "driving")

    def reversed(self) -> "CrossSection":
        """Cross-section along the way in the opposite order of nodes."""
        strips = tuple(
            replace(
                strip,
                place=OPPOSITE[strip.place],
                left_m=-strip.left_m,
                is_forward=not strip.is_forward,
            )
            for strip in self.strips[::-1]
        )
        return replace(self, strips=strips)


def build_cross_section(tags: Tags, note: Note, *, keeps_left: bool) -> CrossSection:
    """Strips side by side along a road, a one-way one along its nodes; senseless tags are noted."""
    left, right = (
        roadside_strips(tags, note, side=side, keeps_left=keeps_left) for side in ("left", "right")
    )
    counts = count_lanes(tags, note)
    beside_m = sum(width for _, width, _ in (*left[0], *right[0]))
    widths, counts = _lane_widths(tags, counts, beside_m, note)
    driving = _driving(widths, counts, keeps_left=keeps_left)
    carriageway_m = sum(width for _, _, width in driving) + beside_m
    strips: list[Strip] = []
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
    strips += _driving_strips(tags, driving, counts, left_m, note, keeps_left=keeps_left)
    strips.sort(key=lambda strip: -strip.left_m)
    return CrossSection(strips=tuple(strips), width_m=carriageway_m)


def _driving_strips(
    tags: Tags,
    driving: Sequence[tuple[str, int, float]],
    counts: LaneCounts,
    left_m: float,
    note: Note,
    *,
    keeps_left: bool,
) -> Iterator[Strip]:
    """Driving lanes from left to right, from their left edge on; the centre lane is none."""
    limits = DEFAULTS["cross_section"]
    turns = {
        "forward": _listed_turns(tags, "forward", counts.n_forward, note, is_alone=is_oneway(tags)),
        "backward": _listed_turns(tags, "backward", counts.n_backward, note, is_alone=False),
    }
    for place, number, width_m in driving:
        middle_m = left_m - 0.5 * width_m
        left_m -= width_m
        for direction in {"both": ("forward", "backward"), "centre": ()}.get(place, (place,)):
            is_forward = direction == "forward"
            aside_m, free_m = 0.0, width_m
            if place == "both":
                # Cars of both directions keep to their side even there; so ends of lanes differ.
                aside_m = 0.5 * limits["shared_apart_m"]
                free_m = max(width_m - 2.0 * aside_m, limits["min_lane_width_m"])
            yield Strip(
                kind="driving",
                place=direction,
                number=number,
                width_m=free_m,
                left_m=middle_m + (aside_m if is_forward == keeps_left else -aside_m),
                is_forward=is_forward,
                turns=turns[direction][number if keeps_left else -1 - number],
            )


def _driving(
    widths: _Widths, counts: LaneCounts, *, keeps_left: bool
) -> list[tuple[str, int, float]]:
    """Driving lanes from left to right: direction, number from the kerb, width."""
    if counts.is_shared:
        return [("both", 0, widths[0][0])]
    forward, backward = (
        [(place, n if keeps_left else len(lanes) - 1 - n, lane_m) for n, lane_m in enumerate(lanes)]
        for place, lanes in (("forward", widths[0]), ("backward", widths[1]))
    )
    centre = [("centre", 0, widths[2])] if counts.has_centre else []
    if keeps_left:
        return [*forward, *centre, *backward[::-1]]
    return [*backward[::-1], *centre, *forward]


def _lane_widths(
    tags: Tags, counts: LaneCounts, beside_m: float, note: Note
) -> tuple[_Widths, LaneCounts]:
    limits = DEFAULTS["cross_section"]
    narrow_m, wide_m = limits["min_lane_width_m"], limits["max_lane_width_m"]
    usual_m = DEFAULTS["roads"][tags["highway"]]["lane_width_m"]
    centre_m = limits["centre_lane_width_m"] if counts.has_centre else 0.0
    forward = _listed_widths(tags, "forward", counts.n_forward, is_alone=not counts.n_backward)
    backward = _listed_widths(tags, "backward", counts.n_backward, is_alone=False)
    if not counts.is_shared and forward is not None and backward is not None:
        return (forward, backward, centre_m), counts
    total_m = None
    for key in (key for key in ("width:carriageway", "width", "est_width") if key in tags):
        total_m = parse_length_m(tags[key])
        if total_m is not None and 1.0 < total_m < 100.0:
            break
        note(f"{key} makes no sense; usual widths taken")
        total_m = None
    if total_m is not None:
        free_m = total_m - beside_m - centre_m
        fitting = counts
        if not counts.is_counted and counts.n_forward == counts.n_backward == 1:
            # Nothing says how many lanes there are: one where two cars could not pass.
            fitting = replace(counts, is_shared=free_m < 2.0 * narrow_m)
        n_lanes = 1 if fitting.is_shared else counts.n_forward + counts.n_backward
        if narrow_m <= free_m / n_lanes <= wide_m:
            return _even(free_m / n_lanes, centre_m, fitting), fitting
        note("its width does not fit its lanes; usual widths taken")
    return _even(usual_m, centre_m, counts), counts


def _even(width_m: float, centre_m: float, counts: LaneCounts) -> _Widths:
    return [width_m] * counts.n_forward, [width_m] * counts.n_backward, centre_m


def _listed_widths(tags: Tags, direction: str, count: int, *, is_alone: bool) -> list[float] | None:
    """Widths of each lane in metres, if they are listed for the right number of lanes."""
    if not count:
        return []
    text = tags.get(f"width:lanes:{direction}") or (tags.get("width:lanes") if is_alone else None)
    widths = [parse_length_m(part) for part in (text or "").split("|")]
    limits = DEFAULTS["cross_section"]
    low_m, high_m = limits["min_lane_width_m"], limits["max_lane_width_m"]
    known = [width for width in widths if width and low_m <= width <= high_m]
    return known if len(known) == len(widths) == count else None


def _listed_turns(
    tags: Tags, direction: str, count: int, note: Note, *, is_alone: bool
) -> list[tuple[Turn, ...]]:
    """Where cars may drive from each lane by its markings, from left to right."""
    text = tags.get(f"turn:lanes:{direction}") or (tags.get("turn:lanes") if is_alone else None)
    words = DEFAULTS["turns"]
    listed: list[tuple[Turn, ...]] = []
    for lane in [] if text is None else text.split("|"):
        turns = [turn for word in lane.split(";") for turn in words.get(word.strip(), ())]
        listed.append(tuple(dict.fromkeys(turns)))
    if len(listed) == count:
        return listed
    if text is not None:
        note("turn:lanes has another number of lanes: markings not followed")
    return [()] * count


# ---------- speed limits


def speed_limit_kmh(tags: Tags, *, is_forward: bool) -> float | None:
    """Speed limit of a direction of a road in km/h; None: the tags give none, or no number.

    Limits that hold at times, for some vehicles or lanes are not looked at.

    >>> [speed_limit_kmh({"maxspeed": text}, is_forward=True) for text in ("50", "30 mph", "none")]
    [50.0, 48.3, None]
    >>> speed_limit_kmh({"maxspeed": "50", "maxspeed:backward": "FR:zone30"}, is_forward=False)
    30.0
    """
    side = "forward" if is_forward else "backward"
    for key in (f"maxspeed:{side}", "maxspeed", *DEFAULTS["speed_limits"]["type_keys"]):
        text = tags.get(key, "").strip().lower()
        speed_kmh = _speed_kmh(text)
        if speed_kmh is not None or text == "none":
            return speed_kmh
    return None


def _speed_kmh(text: str) -> float | None:
    words: dict[str, float] = DEFAULTS["speed_limits"]["words_kmh"]
    if text in words:
        return words[text]
    if match := _ZONE.fullmatch(text):
        speed_kmh = float(match[1])
    elif match := _SPEED.fullmatch(text):
        speed_kmh = float(match[1].replace(",", ".")) * (_KMH_PER_MPH if match[2] == "mph" else 1.0)
    else:
        return None
    return round(speed_kmh, 1) if speed_kmh > 0.0 else None
