"""What lies beside the driving lanes of a road: parked cars, cyclists, pedestrians."""

from dataclasses import dataclass

from .defaults import DEFAULTS
from .elements import Tags
from .lane_counts import is_oneway
from .notes import Notes
from .tags import parse_length_m, side_value

Part = tuple[str, float, bool]  # kind, width [m], whether it runs as the way does

_ON_CARRIAGEWAY = ("lane", "half_on_kerb", "shoulder", "yes")
_BESIDE_CARRIAGEWAY = ("street_side", "on_kerb")
_OLD_ORIENTATIONS = ("parallel", "diagonal", "perpendicular")
_CYCLE_LANES = ("lane", "opposite_lane")
_CYCLE_TRACKS = ("track", "opposite_track")


@dataclass(frozen=True, slots=True, kw_only=True)
class Roadside:
    """Beside one side of the driving lanes, from these outwards.

    Attributes
    ----------
    inner : tuple of (str, float, bool)
        On the carriageway: kind, width [m], whether it runs as the way does.
    outer : tuple of (str, float, bool)
        Behind the kerb.
    """

    inner: tuple[Part, ...]
    outer: tuple[Part, ...]


def roadside_strips(
    tags: Tags, *, side: str, keeps_left: bool, element: str, notes: Notes
) -> Roadside:
    """Parked cars, cyclists and pedestrians on one side of a road.

    Parameters
    ----------
    tags : dict
        Of a way for cars; if it is a one-way road, cars drive along it as its nodes run.
    side : {"left", "right"}
        Seen along the way.
    keeps_left : bool
        Traffic keeps left.
    element : str
        For notes: "way 5".
    notes : Notes
        Told of widths that make no sense.
    """
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
            notes.add("ways", element, f"{key} width makes no sense; the usual one taken")
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
    if _has_sidewalk(tags, side):
        outer.append(("walking", width("sidewalk", usual["sidewalk_width_m"]), is_forward))
    return Roadside(inner=tuple(inner), outer=tuple(outer))


def _cycleway(tags: Tags, side: str, *, is_near: bool) -> str:
    named = side_value(tags, "cycleway", side)
    if named is not None:
        return named
    plain = tags.get("cycleway", "")
    if is_oneway(tags):
        # Along a one-way road the plain tag means the side of its traffic, "opposite" the other.
        return plain if plain.startswith("opposite") != is_near else ""
    return plain


def _parking(tags: Tags, side: str) -> tuple[str, str]:
    """Where cars park on a side, and how."""
    position = side_value(tags, "parking", side)
    if position is not None:
        restriction = tags.get(
            f"parking:{side}:restriction", tags.get("parking:both:restriction", "")
        )
        if restriction in ("no_stopping", "no_parking", "no_standing"):
            return "no", ""
        orientation = tags.get(
            f"parking:{side}:orientation", tags.get("parking:both:orientation", "parallel")
        )
        return position, orientation
    old = side_value(tags, "parking:lane", side) or ""
    if old in _OLD_ORIENTATIONS:
        where = tags.get(f"parking:lane:{side}:{old}", tags.get(f"parking:lane:both:{old}", ""))
        old_positions = {
            "street_side": "street_side",
            "on_kerb": "on_kerb",
            "lay_by": "street_side",
        }
        return old_positions.get(where, "lane"), old
    return "no", ""


def _has_sidewalk(tags: Tags, side: str) -> bool:
    named = side_value(tags, "sidewalk", side)
    if named is not None:
        return named == "yes"
    return tags.get("sidewalk") in ("both", "yes", side)
