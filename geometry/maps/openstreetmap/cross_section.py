"""Lanes of a road side by side, from its tags."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .defaults import DEFAULTS
from .elements import Tags
from .lane_counts import LaneCounts, count_lanes
from .notes import Notes
from .roadside import roadside_strips
from .tags import parse_length_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """One lane in a cross-section.

    Attributes
    ----------
    kind : str
        One of :data:`geometry.maps.model.LANE_KINDS`.
    place : str
        Tells strips of a kind apart: "forward", "backward" for driving lanes, "left", "right" for
        others.
    number : int
        Among those of its kind and place; 0: next to the kerb.
    width_m : float
        [m]
    left_m : float
        Of its middle, to the left of the way. [m]
    is_forward : bool
        Traffic runs as the way does.
    """

    kind: str
    place: str
    number: int
    width_m: float
    left_m: float
    is_forward: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossSection:
    """What lies side by side along a way; its carriageway's middle is the way.

    Attributes
    ----------
    strips : tuple of Strip
        From left to right.
    width_m : float
        From kerb to kerb, parked cars and cycle lanes on the carriageway included. [m]
    """

    strips: tuple[Strip, ...]
    width_m: float

    def lanes(self, *, is_forward: bool) -> tuple[Strip, ...]:
        """Driving lanes of one direction, from the kerb to the axis."""
        lanes = [s for s in self.strips if s.kind == "driving" and s.is_forward == is_forward]
        return tuple(sorted(lanes, key=lambda strip: strip.number))

    def turned_round(self) -> "CrossSection":
        """The same, along the way in the opposite order of nodes."""
        strips = tuple(
            replace(
                strip,
                place=_OPPOSITE[strip.place],
                left_m=-strip.left_m,
                is_forward=not strip.is_forward,
            )
            for strip in self.strips[::-1]
        )
        return replace(self, strips=strips)


_OPPOSITE = {"forward": "backward", "backward": "forward", "left": "right", "right": "left"}


def build_cross_section(
    tags: Tags, *, element: str, keeps_left: bool, notes: Notes
) -> CrossSection:
    """What lies side by side along a road.

    Parameters
    ----------
    tags : dict
        Of a way for cars; if it is a one-way road, cars drive along it as its nodes run.
    element : str
        For notes: "way 5".
    keeps_left : bool
        Traffic keeps left.
    notes : Notes
        Told of what makes no sense in the tags; defaults stand in for it.
    """
    limits = DEFAULTS["cross_section"]
    left, right = (
        roadside_strips(tags, side=side, keeps_left=keeps_left, element=element, notes=notes)
        for side in ("left", "right")
    )
    counts = count_lanes(tags, element=element, notes=notes)
    beside_m = sum(width for _, width, _ in (*left.inner, *right.inner))
    widths, counts = _lane_widths(tags, counts, beside_m, element=element, notes=notes)
    driving = _driving(widths, counts, keeps_left=keeps_left)
    # From the left kerb to the right one, then what lies behind the kerbs.
    driving_m = sum(width for _, _, width in driving)
    carriageway_m = driving_m + beside_m
    strips: list[Strip] = []
    for side, parts in (("left", left), ("right", right)):
        sign = 1.0 if side == "left" else -1.0
        edge_m = 0.5 * carriageway_m
        numbers: dict[str, int] = {}
        # The kerb first, then inwards; then from the kerb outwards.
        inwards = edge_m
        for kind, width_m, is_forward in reversed(parts.inner):
            strips.append(
                _strip(kind, side, numbers, width_m, sign * (inwards - 0.5 * width_m), is_forward)
            )
            inwards -= width_m
        for kind, width_m, is_forward in parts.outer:
            strips.append(
                _strip(kind, side, numbers, width_m, sign * (edge_m + 0.5 * width_m), is_forward)
            )
            edge_m += width_m
    at_m = 0.5 * carriageway_m - sum(width for _, width, _ in left.inner)
    for place, number, width_m in driving:
        middle_m = at_m - 0.5 * width_m
        at_m -= width_m
        for direction in {"both": ("forward", "backward"), "centre": ()}.get(place, (place,)):
            is_forward = direction == "forward"
            aside_m, free_m = 0.0, width_m
            if place == "both":
                # Cars of both directions keep to their side even there; so ends of lanes differ.
                aside_m = 0.5 * limits["shared_apart_m"]
                free_m = max(width_m - 2.0 * aside_m, limits["min_lane_width_m"])
            strips.append(
                Strip(
                    kind="driving",
                    place=direction,
                    number=number,
                    width_m=free_m,
                    left_m=middle_m + (aside_m if is_forward == keeps_left else -aside_m),
                    is_forward=is_forward,
                )
            )
    strips.sort(key=lambda strip: -strip.left_m)
    return CrossSection(strips=tuple(strips), width_m=carriageway_m)


def _strip(
    kind: str,
    side: str,
    numbers: dict[str, int],
    width_m: float,
    left_m: float,
    is_forward: bool,
) -> Strip:
    numbers[kind] = numbers.get(kind, -1) + 1
    return Strip(
        kind=kind,
        place=side,
        number=numbers[kind],
        width_m=width_m,
        left_m=left_m,
        is_forward=is_forward,
    )


@dataclass(frozen=True, slots=True)
class _Widths:
    """Widths of lanes in metres, each from left to right in its driving direction."""

    forward: Sequence[float]
    backward: Sequence[float]
    centre_m: float


def _driving(
    widths: _Widths, counts: LaneCounts, *, keeps_left: bool
) -> list[tuple[str, int, float]]:
    """Driving lanes from left to right: direction, number from the kerb, width."""
    if counts.is_shared:
        return [("both", 0, widths.forward[0])]
    n_forward, n_backward = len(widths.forward), len(widths.backward)
    centre = [("centre", 0, widths.centre_m)] if counts.has_centre else []
    if keeps_left:
        forward = [("forward", i, widths.forward[i]) for i in range(n_forward)]
        backward = [("backward", i, widths.backward[i]) for i in range(n_backward)]
        return [*forward, *centre, *reversed(backward)]
    forward = [("forward", n_forward - 1 - i, widths.forward[i]) for i in range(n_forward)]
    backward = [("backward", n_backward - 1 - i, widths.backward[i]) for i in range(n_backward)]
    return [*reversed(backward), *centre, *forward]


def _lane_widths(
    tags: Tags, counts: LaneCounts, beside_m: float, *, element: str, notes: Notes
) -> tuple[_Widths, LaneCounts]:
    limits = DEFAULTS["cross_section"]
    narrow_m, wide_m = limits["min_lane_width_m"], limits["max_lane_width_m"]
    usual_m = DEFAULTS["roads"][tags["highway"]]["lane_width_m"]
    centre_m = limits["centre_lane_width_m"] if counts.has_centre else 0.0
    forward = _listed_widths(tags, "forward", counts.n_forward, is_alone=not counts.n_backward)
    backward = _listed_widths(tags, "backward", counts.n_backward, is_alone=False)
    if not counts.is_shared and forward is not None and backward is not None:
        return _Widths(forward, backward, centre_m), counts
    total_m = _total_width_m(tags, element=element, notes=notes)
    if total_m is not None:
        free_m = total_m - beside_m - centre_m
        fitting = counts
        if not counts.is_counted and counts.n_forward == counts.n_backward == 1:
            # Nothing says how many lanes there are: one where two cars could not pass.
            fitting = replace(counts, is_shared=free_m < 2.0 * narrow_m)
        n_lanes = 1 if fitting.is_shared else counts.n_forward + counts.n_backward
        if narrow_m <= free_m / n_lanes <= wide_m:
            return _even(free_m / n_lanes, centre_m, fitting), fitting
        notes.add("ways", element, "its width does not fit its lanes; usual widths taken")
    return _even(usual_m, centre_m, counts), counts


def _even(width_m: float, centre_m: float, counts: LaneCounts) -> _Widths:
    return _Widths([width_m] * counts.n_forward, [width_m] * counts.n_backward, centre_m)


def _listed_widths(tags: Tags, direction: str, count: int, *, is_alone: bool) -> list[float] | None:
    """Widths of each lane in metres, where they are listed and as many as there are lanes."""
    if not count:
        return []
    text = tags.get(f"width:lanes:{direction}") or (tags.get("width:lanes") if is_alone else None)
    if text is None:
        return None
    limits = DEFAULTS["cross_section"]
    widths = [parse_length_m(part) for part in text.split("|")]
    known = [
        width
        for width in widths
        if width and limits["min_lane_width_m"] <= width <= limits["max_lane_width_m"]
    ]
    return known if len(known) == len(widths) == count else None


def _total_width_m(tags: Tags, *, element: str, notes: Notes) -> float | None:
    for key in ("width:carriageway", "width", "est_width"):
        if key in tags:
            width_m = parse_length_m(tags[key])
            if width_m is not None and 1.0 < width_m < 100.0:
                return width_m
            notes.add("ways", element, f"{key} makes no sense; usual widths taken")
    return None
