"""Roads of a file: reference line, elevation, superelevation and shape, lane sections, links."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from ...errors import InputError, Unquoted
from .attributes import Offset, lane_kinds, numbered, take_id, take_number, take_number_or
from .reference_line import (
    PiecewiseCubic,
    ReferenceLine,
    build_cubics,
    read_cubics,
    read_reference_line,
)

NO_JUNCTION = "-1"
_MAX_LENGTH_M = 100_000.0
_MAX_SECTION_GAP_M = 1.0e-3
_MAX_LANES = 200  # on one side of a section


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLink:
    """The road or junction at an end of a road."""

    kind: str = ""  # "road", "junction"; empty: nothing
    id: str = ""
    contact: str = ""  # end of the other road: "start" or "end"


SpeedLimits = tuple[tuple[float, float | None], ...]
"""Stations from which speed limits hold, ascending, in metres, and these in km/h; None: none."""
_KMH = {"m/s": 3.6, "km/h": 1.0, "mph": 1.609344}


# ---------- how the surface rises and falls across
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrossSections:
    """Heights across a road at some stations; between two of them in proportion."""

    stations_m: FloatArray  # (n,); ascending; none: the road is a line across
    # height over the distance t to the left of the reference line, one for each station
    profiles: tuple[PiecewiseCubic, ...]

    def at(self, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """Heights at stations, some metres to the left of the reference line, (k,)."""
        height = np.zeros(len(s_m))
        if not len(self.stations_m):
            return height
        place = np.interp(s_m, self.stations_m, np.arange(len(self.stations_m)))
        for index, profile in enumerate(self.profiles):
            share = np.maximum(1.0 - np.abs(place - index), 0.0)
            near = share > 0.0
            height[near] += share[near] * profile.at(np.maximum(t_m[near], profile.starts_m[0]))
        return height


def read_cross_sections(lateral: Element | None, where: str) -> CrossSections:
    """The shapes of a road's lateral profile; none if all of them are flat.

    Raises InputError if a number is missing or out of range.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.8, section on lateral profiles: road shape.
    """
    rows: dict[float, list[tuple[float, ...]]] = defaultdict(list)
    for piece, here in numbered(lateral, "shape", where):
        row = tuple(take_number(piece, key, here) for key in ("t", *"abcd"))
        rows[take_number(piece, "s", here)].append(row)
    if not any(value for pieces in rows.values() for row in pieces for value in row[1:]):
        rows.clear()
    stations = sorted(rows)
    return CrossSections(
        stations_m=np.array(stations, dtype=np.float64),
        profiles=tuple(build_cubics(rows[station]) for station in stations),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneRecord:
    """A lane of one lane section."""

    number: int  # its id: negative to the right of the reference line, counted outwards
    type: str  # of the standard: "driving", "sidewalk", ...
    is_reversed: bool  # driven against the direction of its side (OpenDRIVE 1.7 and later)
    predecessors: tuple[int, ...]  # numbers in the section before; successors: in the one after
    successors: tuple[int, ...]
    width: PiecewiseCubic  # along the road; without pieces: not given
    border: PiecewiseCubic  # lateral position of its outer edge; without pieces: not given
    limits: SpeedLimits = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneSection:
    """A stretch of a road with the same lanes, listed from the reference line outwards."""

    start_m: float
    end_m: float
    left: tuple[LaneRecord, ...]
    right: tuple[LaneRecord, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """One road."""

    id: str
    name: str
    where: str  # for messages
    junction: str  # of which it is a connecting road; NO_JUNCTION: none
    length_m: float
    keeps_left: bool
    line: ReferenceLine
    elevation: PiecewiseCubic  # of the reference line, without the header's offset
    base_m: float  # the header's offset in height
    offset: PiecewiseCubic  # of the lanes to the left of the reference line
    sections: tuple[LaneSection, ...]
    before: RoadLink  # at its start
    after: RoadLink  # at its end
    bank: PiecewiseCubic  # roll around the reference line, its left side upwards. [rad]
    shape: CrossSections  # above the line across that the bank makes
    element: Element  # for objects and signals
    limits: SpeedLimits = ()

    @property
    def is_motorway(self) -> bool:
        """True if it says so all along, and has no sidewalk."""
        types = [element.get("type", "") for element in self.element.findall("type")]
        lanes = [lane for one in self.sections for lane in (*one.left, *one.right)]
        has_walkers = any(lane_kinds().get(lane.type.lower()) == "walking" for lane in lanes)
        return bool(types) and not has_walkers and all(one.startswith("motorway") for one in types)

    def speed_limit_kmh(self, s_m: float, lane: LaneRecord) -> float | None:
        """Limit of a lane at a station in km/h, the lane's own or else the road's; None: none."""
        for limits in (lane.limits, self.limits):
            here = [limit_kmh for start_m, limit_kmh in limits if start_m <= s_m + 1e-6]
            if here:
                return here[-1]
        return None

    def height_at(self, s_m: FloatArray) -> FloatArray:
        """Height of the reference line, (n,)."""
        return self.elevation.at(np.clip(s_m, 0.0, self.length_m)) + self.base_m

    def place(self, s_m: FloatArray, t_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3) on the road's surface, and headings (n,) of its reference line there."""
        s_m = np.clip(s_m, 0.0, self.length_m)
        points, heading = self.line.at(s_m)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        height_m = self.height_at(s_m) + t_m * np.sin(self.bank.at(s_m)) + self.shape.at(s_m, t_m)
        return np.column_stack([points + t_m[:, None] * left, height_m]), heading

    def listed(self, tag: str, names: Counter[str]) -> Iterator["RoadElement"]:
        """Its objects or signals; `names` counts names over all roads, to make them unique."""
        parent = self.element.find(f"{tag}s")
        for index, (element, _) in enumerate(numbered(parent, tag, self.where)):
            label = f"{tag} {element.get('id', f'[{index}]')[:60]}"
            name = f"road {self.id} {label}"
            names[name] += 1  # ids are not unique in some files
            yield RoadElement(
                element=element,
                road=self,
                name=name if names[name] == 1 else f"{name} #{names[name]}",
                where=f"{self.where} {label}",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadElement:
    """An object or signal of a road."""

    element: Element
    road: Road
    name: str  # unique in the file
    where: str  # for messages


def read_road(element: Element, where: str, offset: Offset) -> Road:
    """Read a road element; raises InputError if a necessary value is missing or out of range."""
    road_id = take_id(element, f"{where}: road")
    where = f"{where}: road {road_id}"
    length_m = take_number(element, "length", where)
    if not 0.0 < length_m <= _MAX_LENGTH_M:
        raise InputError(f"{where}.length", length_m, f"metres, > 0, at most {_MAX_LENGTH_M:g}")
    rule = element.get("rule", "RHT").upper()
    if rule not in ("RHT", "LHT"):
        raise InputError(f"{where}.rule", rule, "RHT or LHT")
    lanes = element.find("lanes")
    elevation = read_cubics(element.find("elevationProfile"), "elevation", where)
    lateral = element.find("lateralProfile")
    before, after = read_links(element)
    return Road(
        id=road_id,
        name=element.get("name", "").strip(),
        where=where,
        junction=element.get("junction", "").strip() or NO_JUNCTION,
        length_m=length_m,
        keeps_left=rule == "LHT",
        line=read_reference_line(element, where, length_m=length_m, offset=offset),
        elevation=elevation,
        base_m=offset.z_m,
        offset=read_cubics(lanes, "laneOffset", where),
        sections=_read_sections(lanes, where, length_m),
        before=before,
        after=after,
        bank=read_cubics(lateral, "superelevation", where),
        shape=read_cross_sections(lateral, where),
        element=element,
        limits=_read_limits(element.findall("type"), where),
    )


def _read_limits(
    elements: Sequence[Element], where: str, *, start_key: str = "s", first_m: float = 0.0
) -> SpeedLimits:
    """Speed limits of a road's types, or of a lane; those that are no numbers are none."""
    limits = []
    for element in elements:
        start_m = first_m + take_number_or(element, start_key, where, 0.0)
        speed = element if element.tag == "speed" else element.find("speed")
        limits.append((start_m, None if speed is None else _speed_kmh(speed)))
    return tuple(sorted(limits, key=lambda limit: limit[0]))


def _speed_kmh(speed: Element) -> float | None:
    """Speed of an element in km/h; None: "no limit", or no number."""
    try:
        speed_kmh = float(speed.get("max", "")) * _KMH[speed.get("unit", "m/s")]
    except (ValueError, KeyError):
        return None
    return round(speed_kmh, 1) if math.isfinite(speed_kmh) and speed_kmh > 0.0 else None


def read_links(road: Element) -> tuple[RoadLink, RoadLink]:
    """Links to what lies before and after a road."""
    return _read_link(road, "predecessor"), _read_link(road, "successor")


def _read_link(road: Element, side: str) -> RoadLink:
    element = road.find(f"link/{side}")
    if element is None:
        return RoadLink()
    return RoadLink(
        kind=element.get("elementType", ""),
        id=element.get("elementId", "").strip(),
        contact=element.get("contactPoint", ""),
    )


def _read_sections(lanes: Element | None, where: str, length_m: float) -> tuple[LaneSection, ...]:
    found = []
    for element, here in numbered(lanes, "laneSection", where):
        start_m = take_number(element, "s", here)
        if not -_MAX_SECTION_GAP_M <= start_m <= length_m + _MAX_SECTION_GAP_M:
            raise InputError(f"{here}.s", start_m, f"0 .. {length_m:g}, the road's length")
        if element.find("center/lane") is None:
            raise InputError(f"{here} center", Unquoted("no lane"), "a lane section's lane 0")
        found.append((start_m, element, here))
    if not found:
        raise InputError(f"{where} lanes", Unquoted("no laneSection"), "at least one")
    found.sort(key=lambda item: item[0])
    ends_m = [start_m for start_m, _, _ in found[1:]] + [length_m]
    sections = tuple(
        LaneSection(
            start_m=min(max(start_m, 0.0), length_m),
            end_m=end_m,
            left=_read_side(element, "left", here, start_m),
            right=_read_side(element, "right", here, start_m),
        )
        for (start_m, element, here), end_m in zip(found, ends_m, strict=True)
    )
    # A last section without length would hide that lanes reach the road's end.
    is_empty = len(sections) > 1 and sections[-1].end_m - sections[-1].start_m < _MAX_SECTION_GAP_M
    return sections[:-1] if is_empty else sections


def _read_side(section: Element, side: str, where: str, start_m: float) -> tuple[LaneRecord, ...]:
    sign = 1 if side == "left" else -1
    records: dict[int, LaneRecord] = {}
    for element, here in numbered(section.find(side), "lane", f"{where} {side}"):
        number = _take_lane_number(element, here)
        if number * sign <= 0 or number in records:
            expected = f"{'positive' if sign > 0 else 'negative'} on the {side}, every one once"
            raise InputError(f"{here}.id", number, expected)
        records[number] = LaneRecord(
            number=number,
            type=element.get("type", "none").strip(),
            is_reversed=element.get("direction", "standard") == "reversed",
            predecessors=_linked_lanes(element, "predecessor"),
            successors=_linked_lanes(element, "successor"),
            width=read_cubics(element, "width", here, start_key="sOffset", first_m=start_m),
            border=read_cubics(element, "border", here, start_key="sOffset", first_m=start_m),
            limits=_read_limits(
                element.findall("speed"), here, start_key="sOffset", first_m=start_m
            ),
        )
    if len(records) > _MAX_LANES:
        raise InputError(f"{where} {side}", len(records), f"at most {_MAX_LANES} lanes")
    return tuple(records[number] for number in sorted(records, key=abs))


def _take_lane_number(element: Element, where: str) -> int:
    value = take_number(element, "id", where)
    if value != int(value):
        raise InputError(f"{where}.id", value, "a whole number")
    return int(value)


def _linked_lanes(lane: Element, side: str) -> tuple[int, ...]:
    """Numbers of the lanes that continue this one; a link that is no number is ignored."""
    ids = [link.get("id", "").strip() for link in lane.findall(f"link/{side}")]
    return tuple(int(text) for text in ids if text.lstrip("+-").isdecimal() and len(text) < 10)
