"""Roads of a file with all that runs along them, the header, and checked attributes of XML."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from scipy.special import fresnel

from ...arrays import FloatArray
from ...errors import InputError, refuse
from ...text_formats import load_data
from ..georeferences import why_no_plane
from ..source_map import Omissions

MAX_MAGNITUDE = 1.0e12  # beyond it cubes of arc lengths leave what floats can hold
MAX_SIZE_M = 1.0e4
_UNSET = ("", "none", "undefined", "nan")  # written by exporters for unknown values
# They speak of heights, and name grids that need not be at hand.
_VERTICAL_PARAMETERS = ("+geoidgrids=", "+vunits=", "+vto_meter=", "+geoid_crs=")
_ARC_BELOW_RAD = (
    1.0e-9  # a clothoid that turns by so much more or less than an arc is one
)
_N_ARC_LENGTH = 2049
SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
_CURVES = SHAPES[:3]  # the first two are spirals whose curvature does not change
MAX_COORDINATE_M = 1.0e8
_N_CURVATURES = 33  # samples of a polynomial's curvature
_ROUNDED_M = 1.0e-6
_MAX_GAP_M = 1.0  # by which lengths of a file may miss one another
NO_JUNCTION = "-1"
_MAX_LENGTH_M = 100_000.0
_MAX_SECTION_GAP_M = 1.0e-3
_MAX_LANES = 200  # on one side of a section
SpeedLimits = tuple[tuple[float, float | None], ...]
"""Stations from which speed limits hold, ascending, in metres, and these in km/h; None: none."""
_KMH = {"m/s": 3.6, "km/h": 1.0, "mph": 1.609344}


def take_number(element: Element, key: str, where: str) -> float:
    """Finite number of an attribute that must be there, at most ``MAX_MAGNITUDE`` in size.

    `where` is file and element, for messages: "Town.xodr: road 5 geometry[2]". Raises
    InputError if the attribute is missing, no number, or not finite.
    """
    text = element.get(key)
    if text is None:
        refuse(f"{where}.{key}", "nothing", "a number")
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where}.{key}", text, "a number") from None
    if not (math.isfinite(value) and abs(value) <= MAX_MAGNITUDE):
        expected = f"a finite number, at most {MAX_MAGNITUDE:g} in size"
        raise InputError(f"{where}.{key}", value, expected)
    return value


def take_number_or(element: Element, key: str, where: str, default: float) -> float:
    """Finite number of an attribute, or the default if it is missing or left open."""
    is_open = element.get(key, "").strip().lower() in _UNSET
    if is_open:
        return default
    return take_number(element, key, where)


def take_size(element: Element, key: str, where: str) -> float | None:
    """A length, width, height or radius; None if it is missing, left open or not above 0.

    Raises InputError if it is not finite, or larger than anything beside a road.
    """
    value = take_number_or(element, key, where, 0.0)
    if value > MAX_SIZE_M:
        raise InputError(f"{where}.{key}", value, f"metres, at most {MAX_SIZE_M:g}")
    if value > 0.0:
        return value
    return None


def take_id(element: Element, where: str) -> str:
    """Attribute id; raises InputError if it is missing or empty."""
    text = element.get("id", "").strip()
    if not text:
        refuse(f"{where}.id", "nothing", "an id")
    return text


def numbered(
    parent: Element | None, tag: str, where: str
) -> Iterator[tuple[Element, str]]:
    """Children with a tag, and their names for messages: "Town.xodr: road 5 geometry[2]"."""
    for index, child in enumerate([] if parent is None else parent.findall(tag)):
        yield child, f"{where} {tag}[{index}]"


# ---------- the header
@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Offset from the coordinates of a file to those of its projection; rotation is applied first.

    References
    ----------
    .. [1] ASAM OpenDRIVE 1.8, "Georeferencing": x' = x cos(hdg) - y sin(hdg) + xOffset,
       y' = x sin(hdg) + y cos(hdg) + yOffset, z' = z + zOffset.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    heading_rad: float = 0.0

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Points (n, 2) in the projection."""
        cos = math.cos(self.heading_rad)
        sin = math.sin(self.heading_rad)
        return np.asarray(
            points_m @ np.array([[cos, sin], [-sin, cos]]) + [self.x_m, self.y_m]
        )


def read_offset(root: Element, where: str) -> Offset:
    """Offset of a document's header; all zero without one."""
    element = root.find("header/offset")
    keys = {"x_m": "x", "y_m": "y", "z_m": "z", "heading_rad": "hdg"}
    if element is None:
        return Offset()
    here = f"{where}: header offset"
    return Offset(
        **{name: take_number_or(element, key, here, 0.0) for name, key in keys.items()}
    )


def read_crs(root: Element, omissions: Omissions) -> tuple[str, str]:
    """Coordinate reference system of a document: one for pyproj, and the declared one.

    The first is projected, in metres and without parameters of heights; it is empty if
    the file names none, or one that does not fit (noted in `omissions`).
    """
    element = root.find("header/geoReference")
    if element is None:
        source = ""
    else:
        source = " ".join("".join(element.itertext()).split())
    if not source:
        return "", ""
    if {word.partition("=")[0] for word in source.split()} == {"+lat_0", "+lon_0"}:
        # CARLA's short form: a transverse Mercator there.
        source = (
            f"+proj=tmerc {source} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
        )
    crs = source
    if source.startswith("+"):
        words = [
            word for word in source.split() if not word.startswith(_VERTICAL_PARAMETERS)
        ]
        crs = " ".join(words)
    if why := why_no_plane(crs):
        omissions.add("geoReferences", f"geoReference {source[:120]}", why)
        return "", source
    return crs, source


# ---------- facts of the format
@cache
def load_facts() -> dict[str, Any]:
    """Lane kinds, words, types and assumed numbers from ``geometry/maps/data/opendrive.toml``."""
    return load_data("geometry.maps", "opendrive.toml")


@cache
def lane_kinds() -> dict[str, str]:
    """Kind of lane by the standard's type in lower case."""
    kinds: dict[str, list[str]] = load_facts()["lane_kinds"]
    return {name.lower(): kind for kind, names in kinds.items() for name in names}


def assumed(key: str) -> float:
    """A number of the section of assumptions."""
    return float(load_facts()["assumed"][key])


def arc(s_m: FloatArray, curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of circular arcs; curvatures, in 1/m, turn to the left."""
    half = 0.5 * curvature * s_m
    chord = s_m * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=1), 2.0 * half


def spiral(
    s_m: FloatArray, start_curvature: FloatArray, curvature_slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of clothoids; the slope is the change of curvature per metre.

    Abramowitz, Stegun, section 7.3: completing the square in the heading k0 s + k' s^2
    / 2 leaves the Fresnel integrals C and S.
    """
    points, heading = arc(s_m, start_curvature + 0.5 * curvature_slope * s_m)
    bent = np.abs(curvature_slope) * s_m**2 > _ARC_BELOW_RAD
    if bent.any():
        s = s_m[bent]
        k0 = start_curvature[bent]
        growth = curvature_slope[bent]
        scale = np.sqrt(np.abs(growth) / np.pi)
        begin = scale * k0 / growth
        end = scale * (s + k0 / growth)
        (sine_0, cosine_0), (sine_1, cosine_1) = fresnel(begin), fresnel(end)
        along = (cosine_1 - cosine_0) / scale
        across = np.sign(growth) * (sine_1 - sine_0) / scale
        points[bent] = np.stack(turned(along, across, -0.5 * k0**2 / growth), axis=1)
    return points, heading


def turned(
    x: FloatArray, y: FloatArray, angle_rad: Any
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of vectors that are turned counter-clockwise."""
    cos = np.cos(angle_rad)
    sin = np.sin(angle_rad)
    return x * cos - y * sin, x * sin + y * cos


def polynomial(
    p: FloatArray, u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (n, 2) and headings (n,) of two cubics with coefficients a, b, c, d in u and v."""
    points = np.stack([evaluate(p, u), evaluate(p, v)], axis=1)
    du = slope(p, u)
    dv = slope(p, v)
    # Where the curve starts with a standstill its second derivative says where it
    # leads.
    stands = du**2 + dv**2 < 1.0e-18
    du = np.where(stands, 2.0 * u[..., 2] + 6.0 * u[..., 3] * p, du)
    dv = np.where(stands, 2.0 * v[..., 2] + 6.0 * v[..., 3] * p, dv)
    return points, np.arctan2(dv, du)


def graph_parameter(s_m: FloatArray, v: FloatArray, length_m: float) -> FloatArray:
    """The u, (n,), at which a curve v(u) has a given arc length from 0 to `length_m`."""
    grid = np.linspace(0.0, length_m, _N_ARC_LENGTH)
    speed = np.hypot(1.0, slope(grid, v))
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(grid)
    return np.interp(s_m, np.append(0.0, np.cumsum(steps)), grid)


def evaluate(p: FloatArray, k: FloatArray) -> FloatArray:
    """Values of cubics with coefficients k (..., 4) at p (...)."""
    return np.asarray(k[..., 0] + p * (k[..., 1] + p * (k[..., 2] + p * k[..., 3])))


def slope(p: FloatArray, k: FloatArray) -> FloatArray:
    """Their first derivatives."""
    return k[..., 1] + p * (2.0 * k[..., 2] + 3.0 * p * k[..., 3])


# ---------- the reference line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceLine:
    """Pieces one after the other.

    `parameters` has nine columns: curvature (of a line: 0), or that of the start and
    its slope; or coefficients a, b, c, d of u and of v, and the factor from arc length
    to parameter.
    """

    starts_m: FloatArray  # (n,), along the road
    lengths_m: FloatArray  # (n,)
    origins_m: FloatArray  # (n, 2), begins of the pieces
    headings_rad: FloatArray  # (n,)
    shapes: NDArray[np.int64]  # (n,), indices into SHAPES
    parameters: FloatArray  # (n, 9)
    wheres: tuple[str, ...]  # for messages

    def at(
        self, s_m: FloatArray, inside_m: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Points (k, 2) and headings (k,) at arc lengths; `inside_m` selects where two meet."""
        if inside_m is None:
            lookup = s_m
        else:
            lookup = inside_m
        piece = np.maximum(np.searchsorted(self.starts_m, lookup, side="right") - 1, 0)
        ds = np.clip(s_m - self.starts_m[piece], 0.0, self.lengths_m[piece])
        points = np.empty((len(ds), 2))
        turns = np.empty(len(ds))
        shape = self.shapes[piece]
        for wanted in np.unique(shape):
            mask = shape == wanted
            points[mask], turns[mask] = self._local(
                SHAPES[wanted], piece[mask], ds[mask]
            )
        heading = self.headings_rad[piece]
        along = np.stack(turned(points[:, 0], points[:, 1], heading), axis=1)
        return self.origins_m[piece] + along, heading + turns

    def _local(
        self, shape: str, piece: NDArray[np.int64], s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        parameters = self.parameters[piece]
        if shape in _CURVES:
            return spiral(s, parameters[:, 0], parameters[:, 1])
        p = s * parameters[:, 8]
        for one in np.unique(piece) if shape == "poly3" else ():
            here = piece == one
            v = self.parameters[one, 4:8]
            length_m = float(self.lengths_m[one])
            p[here] = graph_parameter(s[here], v, length_m)
        return polynomial(p, parameters[:, :4], parameters[:, 4:8])

    def bends(self) -> FloatArray:
        """How fast each piece turns, (n, 3).

        The largest curvature [1/m], its largest change per metre [1/m^2], and the
        largest distance that the line takes per metre of s (1 except for parametric
        polynomials).
        """
        rows = np.ones((len(self.starts_m), 3))
        for index, shape in enumerate(self.shapes):
            length_m = self.lengths_m[index]
            k = self.parameters[index]
            if SHAPES[shape] in _CURVES:
                rows[index, :2] = max(abs(k[0]), abs(k[0] + k[1] * length_m)), abs(k[1])
            else:
                rows[index] = _polynomial_bends(k, float(length_m))
        return rows


def _polynomial_bends(k: FloatArray, length_m: float) -> tuple[float, float, float]:
    s = np.linspace(0.0, length_m, _N_CURVATURES)
    p = s * k[8]
    du = slope(p, k[:4])
    dv = slope(p, k[4:8])
    ddu, ddv = (2.0 * k[i + 2] + 6.0 * p * k[i + 3] for i in (0, 4))
    speed = np.maximum(np.hypot(du, dv), 1.0e-6)
    curvature = (du * ddv - dv * ddu) / speed**3
    # A curve that stands still at its start has no curvature there: it is taken next to
    # it.
    curvature[speed <= 1.0e-5] = 0.0
    change = np.abs(np.diff(curvature)) / np.maximum(np.diff(s), 1.0e-9)
    if k[8] == 0.0:
        stride = 1.0
    else:
        stride = float(speed.max() * k[8])
    return float(np.abs(curvature).max()), float(change.max()), stride


def read_reference_line(
    road: Element, where: str, *, length_m: float, offset: Offset
) -> ReferenceLine:
    """Read a road's planView.

    Raises InputError if there is no piece of a length above 0, a number is missing or
    not finite, a piece begins outside the road or far from its begin, or has an unknown
    shape.
    """
    rows = []
    for element, here in numbered(road.find("planView"), "geometry", where):
        row = _read_piece(element, here)
        if not -_MAX_GAP_M <= row[0] <= length_m + _MAX_GAP_M:
            raise InputError(
                f"{here}.s", row[0], f"0 .. {length_m:g}, the road's length"
            )
        if row[4] > _ROUNDED_M:
            rows.append((row, here))
    if not rows:
        refuse(f"{where} planView", "no geometry", "pieces of a length above 0")
    rows.sort(key=lambda pair: pair[0][0])
    table = np.array([row for row, _ in rows])
    starts_m = table[:, 0].copy()
    if starts_m[0] > _MAX_GAP_M:
        raise InputError(
            f"{rows[0][1]}.s", float(starts_m[0]), "0: a road begins there"
        )
    starts_m[0] = 0.0
    return ReferenceLine(
        starts_m=starts_m,
        lengths_m=table[:, 4],
        origins_m=offset.apply(table[:, 1:3]),
        headings_rad=table[:, 3] + offset.heading_rad,
        shapes=table[:, 5].astype(np.int64),
        parameters=table[:, 6:],
        wheres=tuple(here for _, here in rows),
    )


def _read_piece(element: Element, where: str) -> tuple[float, ...]:
    """s, x, y, hdg, length, index of the shape, nine parameters."""
    keys = ("s", "x", "y", "hdg", "length")
    s, x, y, heading, length_m = (take_number(element, key, where) for key in keys)
    for key, value in (("x", x), ("y", y)):
        if abs(value) > MAX_COORDINATE_M:
            raise InputError(f"{where}.{key}", value, f"at most {MAX_COORDINATE_M:g} m")
    if length_m < -_ROUNDED_M:
        raise InputError(f"{where}.length", length_m, "metres, at least 0")
    shape = next((child for child in element if child.tag in SHAPES), None)
    if shape is None:
        tags = ", ".join(str(child.tag) for child in element)[:80]
        refuse(where, tags or "no shape", "one of " + ", ".join(SHAPES))
    parameters = _read_shape(shape, f"{where} {shape.tag}", length_m)
    return (s, x, y, heading, length_m, SHAPES.index(str(shape.tag)), *parameters)


def _read_shape(shape: Element, where: str, length_m: float) -> tuple[float, ...]:
    if shape.tag == "line" or length_m <= _ROUNDED_M:
        return (0.0,) * 9
    if shape.tag == "arc":
        return (take_number(shape, "curvature", where), *(0.0,) * 8)
    if shape.tag == "spiral":
        start, end = (
            take_number(shape, key, where) for key in ("curvStart", "curvEnd")
        )
        return (start, (end - start) / length_m, *(0.0,) * 7)
    if shape.tag == "poly3":
        v = tuple(take_number(shape, key, where) for key in "abcd")
        return (0.0, 1.0, 0.0, 0.0, *v, 1.0)
    keys = [f"{key}{axis}" for axis in "UV" for key in "abcd"]
    p_range = shape.get("pRange", "normalized")  # OpenDRIVE 1.4: the default
    if p_range not in ("normalized", "arcLength"):
        raise InputError(f"{where}.pRange", p_range, "normalized or arcLength")
    if p_range == "normalized":
        per_metre = 1.0 / length_m
    else:
        per_metre = 1.0
    return (*(take_number(shape, key, where) for key in keys), per_metre)


# ---------- cubics along a road
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseCubic:
    """a + b ds + c ds^2 + d ds^3 with ds counted from the start of a piece; 0 before the first."""

    starts_m: FloatArray  # (n,), begins of the pieces, ascending
    coefficients: FloatArray  # (n, 4): a, b, c, d

    def rebased(self, starts_m: FloatArray, inside_m: FloatArray) -> FloatArray:
        """Coefficients (k, 4) of the same polynomials counted from other stations (Taylor's shift).

        `inside_m` (k,) are stations that select the piece where two meet.
        """
        if not len(self.starts_m):
            return np.zeros((len(starts_m), 4))
        piece = np.searchsorted(self.starts_m, inside_m, side="right") - 1
        a, b, c, d = self.coefficients[np.maximum(piece, 0)].T
        h = starts_m - self.starts_m[np.maximum(piece, 0)]
        first = b + h * (2.0 * c + 3.0 * h * d)
        shifted = np.stack(
            [a + h * (b + h * (c + h * d)), first, c + 3.0 * h * d, d], axis=1
        )
        return np.where((piece >= 0)[:, None], shifted, 0.0)

    def at(self, s_m: FloatArray) -> FloatArray:
        """Values, (k,)."""
        return self.rebased(s_m, s_m)[:, 0]


def read_cubics(
    parent: Element | None,
    tag: str,
    where: str,
    *,
    start_key: str = "s",
    first_m: float = 0.0,
) -> PiecewiseCubic:
    """Read the children of `parent` with a tag and attributes a, b, c, d, sorted by begin.

    `first_m` is the zero of the attribute `start_key`. Of several that begin at one
    station the last one holds.
    """
    rows = [
        tuple(take_number(element, key, here) for key in (start_key, *"abcd"))
        for element, here in numbered(parent, tag, where)
    ]
    return _build_cubics([(first_m + start_m, *cubic) for start_m, *cubic in rows])


def _build_cubics(rows: Sequence[tuple[float, ...]]) -> PiecewiseCubic:
    """From rows of start, a, b, c, d."""
    table = np.array(sorted(rows, key=lambda row: row[0]), dtype=np.float64).reshape(
        -1, 5
    )
    is_last = np.append(np.diff(table[:, 0]) > 0.0, True)[: len(table)]
    return PiecewiseCubic(starts_m=table[is_last, 0], coefficients=table[is_last, 1:])


# ---------- roads
@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLink:
    """The road or junction at an end of a road."""

    kind: str = ""  # "road", "junction"; empty: nothing
    id: str = ""
    contact: str = ""  # end of the other road: "start" or "end"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneRecord:
    """A lane of one lane section."""

    number: int  # its id: negative to the right of the reference line, counted outwards
    type: str  # of the standard: "driving", "sidewalk", ...
    is_reversed: (
        bool  # driven against the direction of its side (OpenDRIVE 1.7 and later)
    )
    predecessors: tuple[
        int, ...
    ]  # numbers in the section before; successors: in the one after
    successors: tuple[int, ...]
    width: PiecewiseCubic  # along the road; without pieces: not given
    border: (
        PiecewiseCubic  # lateral position of its outer edge; without pieces: not given
    )
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
    element: Element  # for objects and signals
    limits: SpeedLimits = ()

    @property
    def is_motorway(self) -> bool:
        """True if it says so all along, and has no sidewalk."""
        types = [element.get("type", "") for element in self.element.findall("type")]
        lanes = [lane for one in self.sections for lane in (*one.left, *one.right)]
        has_walkers = any(
            lane_kinds().get(lane.type.lower()) == "walking" for lane in lanes
        )
        return (
            bool(types)
            and not has_walkers
            and all(one.startswith("motorway") for one in types)
        )

    def speed_limit_kmh(self, s_m: float, lane: LaneRecord) -> float | None:
        """Limit of a lane at a station in km/h, the lane's own or else the road's; None: none."""
        for limits in (lane.limits, self.limits):
            here = [limit_kmh for start_m, limit_kmh in limits if start_m <= s_m + 1e-6]
            if here:
                return here[-1]
        return None

    def place(self, s_m: FloatArray, t_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3) on the road's surface, and headings (n,) of its reference line there."""
        s_m = np.clip(s_m, 0.0, self.length_m)
        points, heading = self.line.at(s_m)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        bank_m = t_m * np.sin(self.bank.at(s_m))
        height_m = self.elevation.at(s_m) + self.base_m + bank_m
        return np.column_stack([points + t_m[:, None] * left, height_m]), heading

    def listed(self, tag: str, names: Counter[str]) -> Iterator["RoadElement"]:
        """Its objects or signals; `names` counts names over all roads, to make them unique."""
        parent = self.element.find(f"{tag}s")
        for index, (element, _) in enumerate(numbered(parent, tag, self.where)):
            label = f"{tag} {element.get('id', f'[{index}]')[:60]}"
            name = f"road {self.id} {label}"
            names[name] += 1  # ids are not unique in some files
            where = f"{self.where} {label}"
            number = names[name]
            if number == 1:
                unique = name
            else:
                unique = f"{name} #{number}"
            yield RoadElement(element=element, road=self, name=unique, where=where)


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
        raise InputError(
            f"{where}.length", length_m, f"metres, > 0, at most {_MAX_LENGTH_M:g}"
        )
    rule = element.get("rule", "RHT").upper()
    if rule not in ("RHT", "LHT"):
        raise InputError(f"{where}.rule", rule, "RHT or LHT")
    lanes = element.find("lanes")
    before, after = read_links(element)
    return Road(
        id=road_id,
        name=element.get("name", "").strip(),
        where=where,
        junction=element.get("junction", "").strip() or NO_JUNCTION,
        length_m=length_m,
        keeps_left=rule == "LHT",
        line=read_reference_line(element, where, length_m=length_m, offset=offset),
        elevation=read_cubics(element.find("elevationProfile"), "elevation", where),
        base_m=offset.z_m,
        offset=read_cubics(lanes, "laneOffset", where),
        sections=_read_sections(lanes, where, length_m),
        before=before,
        after=after,
        bank=read_cubics(element.find("lateralProfile"), "superelevation", where),
        element=element,
        limits=_read_limits(element.findall("type"), where),
    )


def _read_limits(
    elements: Sequence[Element],
    where: str,
    *,
    start_key: str = "s",
    first_m: float = 0.0,
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
    if math.isfinite(speed_kmh) and speed_kmh > 0.0:
        return round(speed_kmh, 1)
    return None


def read_links(road: Element) -> tuple[RoadLink, RoadLink]:
    """Links to what lies before and after a road."""
    keys = {"kind": "elementType", "id": "elementId", "contact": "contactPoint"}

    def link(side: str) -> RoadLink:
        words = road.find(f"link/{side}")
        if words is None:
            found = {}
        else:
            found = {k: words.get(v, "").strip() for k, v in keys.items()}
        return RoadLink(**found)

    return link("predecessor"), link("successor")


def _read_sections(
    lanes: Element | None, where: str, length_m: float
) -> tuple[LaneSection, ...]:
    found = []
    for element, here in numbered(lanes, "laneSection", where):
        start_m = take_number(element, "s", here)
        if not -_MAX_SECTION_GAP_M <= start_m <= length_m + _MAX_SECTION_GAP_M:
            raise InputError(
                f"{here}.s", start_m, f"0 .. {length_m:g}, the road's length"
            )
        if element.find("center/lane") is None:
            refuse(f"{here} center", "no lane", "a lane section's lane 0")
        found.append((start_m, element, here))
    if not found:
        refuse(f"{where} lanes", "no laneSection", "at least one")
    found.sort(key=lambda item: item[0])
    sections = []
    for at, (start_m, element, here) in enumerate(found):
        left, right = (
            _read_side(element, side, here, start_m) for side in ("left", "right")
        )
        begin_m = min(max(start_m, 0.0), length_m)
        if at + 1 < len(found):
            end_m = found[at + 1][0]
        else:
            end_m = length_m
        sections.append(
            LaneSection(start_m=begin_m, end_m=end_m, left=left, right=right)
        )
    # A last section without length would hide that lanes reach the road's end.
    if (
        len(sections) > 1
        and sections[-1].end_m - sections[-1].start_m < _MAX_SECTION_GAP_M
    ):
        sections.pop()
    return tuple(sections)


def _read_side(
    section: Element, side: str, where: str, start_m: float
) -> tuple[LaneRecord, ...]:
    if side == "left":
        sign = 1
    else:
        sign = -1
    from_here: Any = {"start_key": "sOffset", "first_m": start_m}
    records: dict[int, LaneRecord] = {}
    for element, here in numbered(section.find(side), "lane", f"{where} {side}"):
        value = take_number(element, "id", here)
        number = int(value)
        if value != number:
            raise InputError(f"{here}.id", value, "a whole number")
        if number * sign <= 0 or number in records:
            expected = (
                f"{'positive' if sign > 0 else 'negative'} on the {side}, every one"
                " once"
            )
            raise InputError(f"{here}.id", number, expected)
        records[number] = LaneRecord(
            number=number,
            type=element.get("type", "none").strip(),
            is_reversed=element.get("direction", "standard") == "reversed",
            predecessors=_linked_lanes(element, "predecessor"),
            successors=_linked_lanes(element, "successor"),
            width=read_cubics(element, "width", here, **from_here),
            border=read_cubics(element, "border", here, **from_here),
            limits=_read_limits(element.findall("speed"), here, **from_here),
        )
    if len(records) > _MAX_LANES:
        raise InputError(f"{where} {side}", len(records), f"at most {_MAX_LANES} lanes")
    return tuple(records[number] for number in sorted(records, key=abs))


def _linked_lanes(lane: Element, side: str) -> tuple[int, ...]:
    """Numbers of the lanes that continue this one; a link that is no number is ignored."""
    ids = [link.get("id", "").strip() for link in lane.findall(f"link/{side}")]
    return tuple(
        int(text) for text in ids if text.lstrip("+-").isdecimal() and len(text) < 10
    )
