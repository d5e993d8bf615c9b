"""OpenDRIVE roads with all that runs along them, and the header.

The file is read through functions that check each attribute, so that
messages say where a number is wrong.
"""

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

# Beyond it cubes of arc lengths leave what floats can hold.
MAX_MAGNITUDE = 1.0e12
MAX_SIZE_M = 1.0e4
# Written by exporters for unknown values.
_UNSET = ("", "none", "undefined", "nan")
# They speak of heights, and name grids that need not be at hand.
_VERTICAL_PARAMETERS = ("+geoidgrids=", "+vunits=", "+vto_meter=", "+geoid_crs=")
# A clothoid that turns by so much more or less than an arc is one.
_ARC_BELOW_RAD = 1.0e-9
_N_ARC_LENGTH = 2049
SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
# The first two are spirals whose curvature does not change.
_CURVES = SHAPES[:3]
MAX_COORDINATE_M = 1.0e8
# Samples of a polynomial's curvature.
_N_CURVATURES = 33
_ROUNDED_M = 1.0e-6
# By which lengths of a file may miss one another.
_MAX_GAP_M = 1.0
NO_JUNCTION = "-1"
_MAX_LENGTH_M = 100_000.0
_MAX_SECTION_GAP_M = 1.0e-3
# On one side of a section.
_MAX_LANES = 200
SpeedLimits = tuple[tuple[float, float | None], ...]
"""Stations [m] from which limits hold, ascending, and these [km/h]; None: none."""
_KMH = {"m/s": 3.6, "km/h": 1.0, "mph": 1.609344}


def take_number(element: Element, key: str, where: str) -> float:
    """Finite number of an attribute that must be there.

    Parameters
    ----------
    element : Element
        Element that has the attribute.
    key : str
        Name of the attribute.
    where : str
        File and element, for messages: "Town.xodr: road 5 geometry[2]".

    Returns
    -------
    value : float
        At most ``MAX_MAGNITUDE`` in size.

    Raises
    ------
    InputError
        The attribute is missing, no number, or not finite.
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
    """Finite number of an attribute, or the default if it is left open.

    Parameters
    ----------
    element : Element
        Element that has the attribute.
    key : str
        Name of the attribute.
    where : str
        File and element at hand, for messages.
    default : float
        Value if the attribute is missing, empty or "none".

    Returns
    -------
    value : float
        At most ``MAX_MAGNITUDE`` in size.

    Raises
    ------
    InputError
        The attribute is no number, or not finite.
    """
    is_open = element.get(key, "").strip().lower() in _UNSET
    if is_open:
        return default
    return take_number(element, key, where)


def take_size(element: Element, key: str, where: str) -> float | None:
    """Length, width, height or radius; None: not given, or not above 0.

    Parameters
    ----------
    element : Element
        Element that has the attribute.
    key : str
        Name of the attribute.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    size_m : float or None
        In metres.

    Raises
    ------
    InputError
        It is not finite, or larger than anything beside a road.
    """
    value = take_number_or(element, key, where, 0.0)
    if value > MAX_SIZE_M:
        raise InputError(f"{where}.{key}", value, f"metres, at most {MAX_SIZE_M:g}")
    if value > 0.0:
        return value
    return None


def take_id(element: Element, where: str) -> str:
    """Attribute ``id``, without spaces around it.

    Parameters
    ----------
    element : Element
        Element that has the attribute.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    id : str
        Not empty.

    Raises
    ------
    InputError
        It is missing or empty.
    """
    text = element.get("id", "").strip()
    if not text:
        refuse(f"{where}.id", "nothing", "an id")
    return text


def numbered(
    parent: Element | None,
    tag: str,
    where: str,
) -> Iterator[tuple[Element, str]]:
    """Children with a tag, and their names for messages.

    Parameters
    ----------
    parent : Element or None
        Parent of the children; None: there are none.
    tag : str
        Their tag.
    where : str
        File and element at hand, for messages.

    Yields
    ------
    child : (Element, str)
        The name is such as "Town.xodr: road 5 geometry[2]".
    """
    if parent is None:
        return
    for index, child in enumerate(parent.findall(tag)):
        yield child, f"{where} {tag}[{index}]"


# ---------- the header
@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Offset from the coordinates of a file to those of its projection.

    The rotation is applied first.

    Attributes
    ----------
    x_m : float
        Eastwards. [m]
    y_m : float
        Northwards. [m]
    z_m : float
        Upwards. [m]
    heading_rad : float
        Rotation, counter-clockwise. [rad]

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
        """Points in the projection, (n, 2)."""
        cos = math.cos(self.heading_rad)
        sin = math.sin(self.heading_rad)
        return np.asarray(
            points_m @ np.array([[cos, sin], [-sin, cos]]) + [self.x_m, self.y_m]
        )


def read_offset(root: Element, where: str) -> Offset:
    """Offset of a document's header; all zero without one.

    Parameters
    ----------
    root : Element
        Root element of the document.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    offset : Offset
        From the element ``header/offset``.
    """
    element = root.find("header/offset")
    keys = {"x_m": "x", "y_m": "y", "z_m": "z", "heading_rad": "hdg"}
    if element is None:
        return Offset()
    here = f"{where}: header offset"
    return Offset(
        **{name: take_number_or(element, key, here, 0.0) for name, key in keys.items()}
    )


def read_crs(root: Element, omissions: Omissions) -> tuple[str, str]:
    """Reference system of a document: one for pyproj, and the declared one.

    Parameters
    ----------
    root : Element
        Root element of the document.
    omissions : Omissions
        Record of what is left out, and why; entries are added.

    Returns
    -------
    crs : str
        Projected, in metres and without parameters of heights; empty if the
        file names none, or one that does not fit, which is noted.
    source : str
        As the file declares it; empty: it does not.
    """
    element = root.find("header/geoReference")
    source = ""
    if element is not None:
        text = "".join(element.itertext())
        source = " ".join(text.split())
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
    """Lane kinds, words, types and assumed numbers of the format.

    They are those of ``geometry/maps/data/opendrive.toml``.
    """
    return load_data("geometry.maps", "opendrive.toml")


@cache
def lane_kinds() -> dict[str, str]:
    """Kind of lane by the standard's type in lower case."""
    kinds: dict[str, list[str]] = load_facts()["lane_kinds"]
    return {name.lower(): kind for kind, names in kinds.items() for name in names}


def assumed(key: str) -> float:
    """Number that is assumed where a file gives none."""
    return float(load_facts()["assumed"][key])


def arc(s_m: FloatArray, curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points and headings of circular arcs that start along x.

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths. [m]
    curvature : (n,) float
        To the left. [1/m]

    Returns
    -------
    points_m : (n, 2) float
        From the start of the arc. [m]
    heading_rad : (n,) float
        Counter-clockwise from x. [rad]
    """
    half = 0.5 * curvature * s_m
    chord = s_m * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=1), 2.0 * half


def spiral(
    s_m: FloatArray,
    start_curvature: FloatArray,
    curvature_slope: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Points and headings of clothoids that start along x.

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths. [m]
    start_curvature : (n,) float
        At the start, to the left. [1/m]
    curvature_slope : (n,) float
        Change of the curvature per metre. [1/m^2]

    Returns
    -------
    points_m : (n, 2) float
        From the start of the clothoid. [m]
    heading_rad : (n,) float
        Counter-clockwise from x. [rad]

    Notes
    -----
    Completing the square in the heading k0 s + k' s^2 / 2 leaves the Fresnel
    integrals C and S. Clothoids that hardly bend more than an arc are computed
    as one.

    References
    ----------
    .. [1] M. Abramowitz, I. A. Stegun, "Handbook of Mathematical Functions",
       section 7.3.
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
    x: FloatArray,
    y: FloatArray,
    angle_rad: Any,
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of vectors that are turned counter-clockwise.

    Parameters
    ----------
    x : FloatArray
        First coordinates.
    y : FloatArray
        Second coordinates.
    angle_rad : float or array
        Angle. [rad]

    Returns
    -------
    x : FloatArray
        First coordinates of the turned vectors.
    y : FloatArray
        Their second coordinates.
    """
    cos = np.cos(angle_rad)
    sin = np.sin(angle_rad)
    return x * cos - y * sin, x * sin + y * cos


def polynomial(
    p: FloatArray,
    u: FloatArray,
    v: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Points and headings of two cubics in u and v.

    Parameters
    ----------
    p : (n,) float
        Parameter of the curve.
    u : (n, 4) float
        Coefficients a, b, c, d of u.
    v : (n, 4) float
        Coefficients a, b, c, d of v.

    Returns
    -------
    points_m : (n, 2) float
        U and v. [m]
    heading_rad : (n,) float
        Counter-clockwise from u. [rad]
    """
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
    """The u at which a curve v(u) has a given arc length, (n,).

    Parameters
    ----------
    s_m : (n,) float
        Arc lengths. [m]
    v : (4,) float
        Coefficients a, b, c, d of v.
    length_m : float
        Largest u that is searched. [m]

    Returns
    -------
    u : (n,) float
        By the trapezoidal rule on a fine grid. [m]
    """
    grid = np.linspace(0.0, length_m, _N_ARC_LENGTH)
    speed = np.hypot(1.0, slope(grid, v))
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(grid)
    return np.interp(s_m, np.append(0.0, np.cumsum(steps)), grid)


def evaluate(p: FloatArray, k: FloatArray) -> FloatArray:
    """Values of cubics with coefficients k (..., 4) at p (...)."""
    return np.asarray(k[..., 0] + p * (k[..., 1] + p * (k[..., 2] + p * k[..., 3])))


def slope(p: FloatArray, k: FloatArray) -> FloatArray:
    """First derivatives of cubics with coefficients k (..., 4) at p (...)."""
    return k[..., 1] + p * (2.0 * k[..., 2] + 3.0 * p * k[..., 3])


# ---------- the reference line
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceLine:
    """Reference line of a road: pieces one after the other.

    Attributes
    ----------
    starts_m : (n,) float
        Begin of each piece along the road. [m]
    lengths_m : (n,) float
        Length of each piece. [m]
    origins_m : (n, 2) float
        First point of each piece. [m]
    headings_rad : (n,) float
        Heading at the first point, counter-clockwise from east. [rad]
    shapes : (n,) int
        Indices into ``SHAPES``.
    parameters : (n, 9) float
        Curvature (of a line: 0), or curvature at the start and its slope; or
        coefficients a, b, c, d of u and of v, and the factor from arc length to
        parameter.
    wheres : tuple of str
        Where each piece stands in the file, for messages.
    """

    starts_m: FloatArray
    lengths_m: FloatArray
    origins_m: FloatArray
    headings_rad: FloatArray
    shapes: NDArray[np.int64]
    parameters: FloatArray
    wheres: tuple[str, ...]

    def at(
        self,
        s_m: FloatArray,
        inside_m: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Points and headings at arc lengths.

        Parameters
        ----------
        s_m : (k,) float
            Arc lengths along the road. [m]
        inside_m : (k,) float, optional
            Arc lengths that select the piece where two meet. [m]

        Returns
        -------
        points_m : (k, 2) float
            In the coordinates of the map. [m]
        heading_rad : (k,) float
            Counter-clockwise from east. [rad]
        """
        lookup = s_m
        if inside_m is not None:
            lookup = inside_m
        piece = np.maximum(np.searchsorted(self.starts_m, lookup, side="right") - 1, 0)
        ds = np.clip(s_m - self.starts_m[piece], 0.0, self.lengths_m[piece])
        points = np.empty((len(ds), 2))
        turns = np.empty(len(ds))
        shape = self.shapes[piece]
        for wanted in np.unique(shape):
            mask = shape == wanted
            points[mask], turns[mask] = self._local(
                SHAPES[wanted],
                piece[mask],
                ds[mask],
            )
        heading = self.headings_rad[piece]
        along = np.stack(turned(points[:, 0], points[:, 1], heading), axis=1)
        return self.origins_m[piece] + along, heading + turns

    def _local(
        self,
        shape: str,
        piece: NDArray[np.int64],
        s: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Points and headings of pieces of one shape, in their own frames.

        Parameters
        ----------
        shape : str
            One of ``SHAPES``.
        piece : (k,) int
            Index of the piece of each point.
        s : (k,) float
            Arc length from the begin of the piece. [m]

        Returns
        -------
        points_m : (k, 2) float
            From the begin of the piece. [m]
        heading_rad : (k,) float
            Against that of the begin. [rad]
        """
        parameters = self.parameters[piece]
        if shape in _CURVES:
            return spiral(s, parameters[:, 0], parameters[:, 1])
        p = s * parameters[:, 8]
        if shape == "poly3":
            # The parameter of v(u) is u itself: found for each piece from arc length.
            for one in np.unique(piece):
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

        Returns
        -------
        bends : (n, 3) float
            One row for each piece.
        """
        rows = np.ones((len(self.starts_m), 3))
        for index, shape in enumerate(self.shapes):
            length_m = self.lengths_m[index]
            k = self.parameters[index]
            if SHAPES[shape] in _CURVES:
                end_curvature = k[0] + k[1] * length_m
                rows[index, 0] = max(abs(k[0]), abs(end_curvature))
                rows[index, 1] = abs(k[1])
            else:
                rows[index] = _polynomial_bends(k, float(length_m))
        return rows


def _polynomial_bends(k: FloatArray, length_m: float) -> tuple[float, float, float]:
    """Largest curvature, its change and the stride of a polynomial piece.

    Parameters
    ----------
    k : (9,) float
        Parameters of the piece.
    length_m : float
        Its length. [m]

    Returns
    -------
    bends : (float, float, float)
        See :meth:`ReferenceLine.bends`.
    """
    s = np.linspace(0.0, length_m, _N_CURVATURES)
    p = s * k[8]
    du = slope(p, k[:4])
    dv = slope(p, k[4:8])
    ddu = 2.0 * k[2] + 6.0 * p * k[3]
    ddv = 2.0 * k[6] + 6.0 * p * k[7]
    speed = np.maximum(np.hypot(du, dv), 1.0e-6)
    curvature = (du * ddv - dv * ddu) / speed**3
    # A curve that stands still at its start has no curvature there: it is taken next to
    # it.
    curvature[speed <= 1.0e-5] = 0.0
    change = np.abs(np.diff(curvature)) / np.maximum(np.diff(s), 1.0e-9)
    stride = 1.0
    if k[8] != 0.0:
        stride = float(speed.max() * k[8])
    return float(np.abs(curvature).max()), float(change.max()), stride


def read_reference_line(
    road: Element,
    where: str,
    *,
    length_m: float,
    offset: Offset,
) -> ReferenceLine:
    """Read a road's planView.

    Parameters
    ----------
    road : Element
        The <road>.
    where : str
        File and element at hand, for messages.
    length_m : float
        Length of the road. [m]
    offset : Offset
        Offset of the file's header.

    Returns
    -------
    line : ReferenceLine
        Pieces ascending along the road.

    Raises
    ------
    InputError
        There is no piece of a length above 0, a number is missing or not
        finite, a piece begins outside the road or far from its begin, or has an
        unknown shape.
    """
    rows = []
    for element, here in numbered(road.find("planView"), "geometry", where):
        row = _read_piece(element, here)
        if not -_MAX_GAP_M <= row[0] <= length_m + _MAX_GAP_M:
            raise InputError(
                f"{here}.s",
                row[0],
                f"0 .. {length_m:g}, the road's length",
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
            f"{rows[0][1]}.s",
            float(starts_m[0]),
            "0: a road begins there",
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
    """Row of a piece of the reference line.

    Parameters
    ----------
    element : Element
        The <geometry>.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    row : tuple of float
        S, x, y, hdg, length, index of the shape, nine parameters.

    Raises
    ------
    InputError
        A number is missing or out of range, or the shape is unknown.
    """
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
    """Nine parameters of a shape, see :class:`ReferenceLine`.

    Parameters
    ----------
    shape : Element
        The <line>, <arc>, <spiral>, <poly3> or <paramPoly3>.
    where : str
        File and element at hand, for messages.
    length_m : float
        Length of the piece. [m]

    Returns
    -------
    parameters : tuple of float
        Nine; unused ones are 0.
    """
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
    # OpenDRIVE 1.4: the default.
    p_range = shape.get("pRange", "normalized")
    if p_range not in ("normalized", "arcLength"):
        raise InputError(f"{where}.pRange", p_range, "normalized or arcLength")
    per_metre = 1.0
    if p_range == "normalized":
        per_metre = 1.0 / length_m
    coefficients = [take_number(shape, key, where) for key in keys]
    return (*coefficients, per_metre)


# ---------- cubics along a road
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PiecewiseCubic:
    """Cubics a + b ds + c ds^2 + d ds^3, one for each piece along a road.

    ds counts from the start of a piece; before the first one the value is 0.

    Attributes
    ----------
    starts_m : (n,) float
        Begins of the pieces, ascending. [m]
    coefficients : (n, 4) float
        A, b, c, d.
    """

    starts_m: FloatArray
    coefficients: FloatArray

    def rebased(self, starts_m: FloatArray, inside_m: FloatArray) -> FloatArray:
        """Coefficients of the same cubics counted from other stations (k, 4).

        This is Taylor's shift.

        Parameters
        ----------
        starts_m : (k,) float
            Stations to count from. [m]
        inside_m : (k,) float
            Stations that select the piece where two meet. [m]

        Returns
        -------
        coefficients : (k, 4) float
            A, b, c, d.
        """
        if not len(self.starts_m):
            return np.zeros((len(starts_m), 4))
        piece = np.searchsorted(self.starts_m, inside_m, side="right") - 1
        a, b, c, d = self.coefficients[np.maximum(piece, 0)].T
        h = starts_m - self.starts_m[np.maximum(piece, 0)]
        first = b + h * (2.0 * c + 3.0 * h * d)
        shifted = np.stack(
            [a + h * (b + h * (c + h * d)), first, c + 3.0 * h * d, d],
            axis=1,
        )
        return np.where((piece >= 0)[:, None], shifted, 0.0)

    def at(self, s_m: FloatArray) -> FloatArray:
        """Values at stations, (k,)."""
        return self.rebased(s_m, s_m)[:, 0]


def read_cubics(
    parent: Element | None,
    tag: str,
    where: str,
    *,
    start_key: str = "s",
    first_m: float = 0.0,
) -> PiecewiseCubic:
    """Read cubics: children with a tag and attributes a, b, c, d.

    Of several that begin at one station the last one holds.

    Parameters
    ----------
    parent : Element or None
        Parent of the elements; None: there are none.
    tag : str
        Tag of the elements.
    where : str
        File and element at hand, for messages.
    start_key : str
        Attribute of the begin.
    first_m : float
        Station from which that attribute counts. [m]

    Returns
    -------
    cubics : PiecewiseCubic
        Sorted by begin.
    """
    rows = [
        tuple(take_number(element, key, here) for key in (start_key, *"abcd"))
        for element, here in numbered(parent, tag, where)
    ]
    return _build_cubics([(first_m + start_m, *cubic) for start_m, *cubic in rows])


def _build_cubics(rows: Sequence[tuple[float, ...]]) -> PiecewiseCubic:
    """Cubics from rows of start, a, b, c, d."""
    table = np.array(sorted(rows, key=lambda row: row[0]), dtype=np.float64).reshape(
        -1, 5
    )
    is_last = np.append(np.diff(table[:, 0]) > 0.0, True)[: len(table)]
    return PiecewiseCubic(starts_m=table[is_last, 0], coefficients=table[is_last, 1:])


# ---------- roads
@dataclass(frozen=True, slots=True, kw_only=True)
class RoadLink:
    """Road or junction at an end of a road.

    Attributes
    ----------
    kind : str
        "road", "junction"; empty: nothing.
    id : str
        Id of that road or junction.
    contact : str
        End of the other road: "start" or "end".
    """

    kind: str = ""
    id: str = ""
    contact: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneRecord:
    """Lane of one lane section.

    Attributes
    ----------
    number : int
        Id of the lane: negative to the right of the reference line, counted
        outwards.
    type : str
        Type of the standard: "driving", "sidewalk", ...
    is_reversed : bool
        Driven against the direction of its side (OpenDRIVE 1.7 and later).
    predecessors : tuple of int
        Numbers of the lanes before it, in the section before.
    successors : tuple of int
        Numbers of the lanes after it, in the section after.
    width : PiecewiseCubic
        Width along the road; without pieces: not given.
    border : PiecewiseCubic
        Lateral position of its outer edge; without pieces: not given.
    limits : SpeedLimits
        Speed limits of the lane's own.
    """

    number: int
    type: str
    is_reversed: bool
    predecessors: tuple[int, ...]
    successors: tuple[int, ...]
    width: PiecewiseCubic
    border: PiecewiseCubic
    limits: SpeedLimits = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneSection:
    """Stretch of a road with the same lanes.

    Attributes
    ----------
    start_m : float
        First station. [m]
    end_m : float
        Last station. [m]
    left : tuple of LaneRecord
        Lanes to the left, listed from the reference line outwards.
    right : tuple of LaneRecord
        Lanes to the right, listed from the reference line outwards.
    """

    start_m: float
    end_m: float
    left: tuple[LaneRecord, ...]
    right: tuple[LaneRecord, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Road:
    """One road with its lanes and links.

    Attributes
    ----------
    id : str
        Id in the file.
    name : str
        Name in the file; may be empty.
    where : str
        File and road, for messages.
    junction : str
        Junction of which it is a connecting road; NO_JUNCTION: none.
    length_m : float
        Length along the reference line. [m]
    keeps_left : bool
        Traffic keeps left.
    line : ReferenceLine
        Reference line.
    elevation : PiecewiseCubic
        Height of the reference line, without the header's offset.
    base_m : float
        The header's offset in height. [m]
    offset : PiecewiseCubic
        Shift of the lanes to the left of the reference line.
    sections : tuple of LaneSection
        Lane sections, one after the other.
    before : RoadLink
        Link at its start.
    after : RoadLink
        Link at its end.
    bank : PiecewiseCubic
        Roll around the reference line, its left side upwards. [rad]
    element : Element
        XML element, for objects and signals.
    limits : SpeedLimits
        Speed limits of the road.
    """

    id: str
    name: str
    where: str
    junction: str
    length_m: float
    keeps_left: bool
    line: ReferenceLine
    elevation: PiecewiseCubic
    base_m: float
    offset: PiecewiseCubic
    sections: tuple[LaneSection, ...]
    before: RoadLink
    after: RoadLink
    bank: PiecewiseCubic
    element: Element
    limits: SpeedLimits = ()

    @property
    def is_motorway(self) -> bool:
        """True if the road says so all along, and has no sidewalk."""
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
        """Speed limit of a lane at a station in km/h; None: there is none.

        The lane's own limit counts first, then the road's.

        Parameters
        ----------
        s_m : float
            Station. [m]
        lane : LaneRecord
            The lane.

        Returns
        -------
        limit_kmh : float or None
            Of the last limit that begins at or before the station.
        """
        for limits in (lane.limits, self.limits):
            here = [limit_kmh for start_m, limit_kmh in limits if start_m <= s_m + 1e-6]
            if here:
                return here[-1]
        return None

    def place(self, s_m: FloatArray, t_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points on the road's surface, and headings of its reference line.

        Parameters
        ----------
        s_m : (n,) float
            Stations; clipped to the road. [m]
        t_m : (n,) float
            To the left of the reference line. [m]

        Returns
        -------
        points_m : (n, 3) float
            In the coordinates of the map. [m]
        heading_rad : (n,) float
            Counter-clockwise from east. [rad]
        """
        s_m = np.clip(s_m, 0.0, self.length_m)
        points, heading = self.line.at(s_m)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        bank_m = t_m * np.sin(self.bank.at(s_m))
        height_m = self.elevation.at(s_m) + self.base_m + bank_m
        return np.column_stack([points + t_m[:, None] * left, height_m]), heading

    def listed(self, tag: str, names: Counter[str]) -> Iterator["RoadElement"]:
        """Objects or signals of the road.

        Parameters
        ----------
        tag : {"object", "signal"}
            Tag of the elements.
        names : Counter[str]
            Counts of names over all roads, to make them unique; extended.

        Yields
        ------
        element : RoadElement
            In the order of the file.
        """
        parent = self.element.find(f"{tag}s")
        for index, (element, _) in enumerate(numbered(parent, tag, self.where)):
            label = f"{tag} {element.get('id', f'[{index}]')[:60]}"
            name = f"road {self.id} {label}"
            # Ids are not unique in some files.
            names[name] += 1
            where = f"{self.where} {label}"
            number = names[name]
            unique = name
            if number > 1:
                unique = f"{name} #{number}"
            yield RoadElement(element=element, road=self, name=unique, where=where)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadElement:
    """Object or signal of a road.

    Attributes
    ----------
    element : Element
        XML element.
    road : Road
        Road that it belongs to.
    name : str
        Unique in the file.
    where : str
        For messages.
    """

    element: Element
    road: Road
    name: str
    where: str


def read_road(element: Element, where: str, offset: Offset) -> Road:
    """Read a road element.

    Parameters
    ----------
    element : Element
        The <road>.
    where : str
        File and element at hand, for messages.
    offset : Offset
        Offset of the file's header.

    Returns
    -------
    road : Road
        With its line, lanes and links.

    Raises
    ------
    InputError
        A necessary value is missing or out of range.
    """
    road_id = take_id(element, f"{where}: road")
    where = f"{where}: road {road_id}"
    length_m = take_number(element, "length", where)
    if not 0.0 < length_m <= _MAX_LENGTH_M:
        raise InputError(
            f"{where}.length",
            length_m,
            f"metres, > 0, at most {_MAX_LENGTH_M:g}",
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
    """Speed limits of a road's types, or of a lane.

    Limits that are no numbers are none.

    Parameters
    ----------
    elements : sequence of Element
        Elements with a speed, or that are one.
    where : str
        File and element at hand, for messages.
    start_key : str
        Attribute of the begin.
    first_m : float
        Station from which that attribute counts. [m]

    Returns
    -------
    limits : SpeedLimits
        Ascending by station.
    """
    limits = []
    for element in elements:
        start_m = first_m + take_number_or(element, start_key, where, 0.0)
        speed: Element | None = element
        if element.tag != "speed":
            speed = element.find("speed")
        limit_kmh = None
        if speed is not None:
            limit_kmh = _speed_kmh(speed)
        limits.append((start_m, limit_kmh))
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
        """Link of one side; empty if the road has none."""
        words = road.find(f"link/{side}")
        if words is None:
            return RoadLink()
        found = {name: words.get(key, "").strip() for name, key in keys.items()}
        return RoadLink(**found)

    return link("predecessor"), link("successor")


def _read_sections(
    lanes: Element | None,
    where: str,
    length_m: float,
) -> tuple[LaneSection, ...]:
    """Lane sections of a road, each ending where the next one begins.

    Parameters
    ----------
    lanes : Element or None
        The <lanes>; None: the road has none.
    where : str
        File and element at hand, for messages.
    length_m : float
        Length of the road. [m]

    Returns
    -------
    sections : tuple of LaneSection
        Ascending along the road.

    Raises
    ------
    InputError
        There is no section, or one begins outside the road or has no lane 0.
    """
    found = []
    for element, here in numbered(lanes, "laneSection", where):
        start_m = take_number(element, "s", here)
        if not -_MAX_SECTION_GAP_M <= start_m <= length_m + _MAX_SECTION_GAP_M:
            raise InputError(
                f"{here}.s",
                start_m,
                f"0 .. {length_m:g}, the road's length",
            )
        if element.find("center/lane") is None:
            refuse(f"{here} center", "no lane", "a lane section's lane 0")
        found.append((start_m, element, here))
    if not found:
        refuse(f"{where} lanes", "no laneSection", "at least one")
    found.sort(key=lambda item: item[0])
    sections = []
    for at, (start_m, element, here) in enumerate(found):
        left = _read_side(element, "left", here, start_m)
        right = _read_side(element, "right", here, start_m)
        begin_m = min(max(start_m, 0.0), length_m)
        end_m = length_m
        if at + 1 < len(found):
            end_m = found[at + 1][0]
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
    section: Element,
    side: str,
    where: str,
    start_m: float,
) -> tuple[LaneRecord, ...]:
    """Lanes of one side of a section, from the reference line outwards.

    Parameters
    ----------
    section : Element
        The <laneSection>.
    side : {"left", "right"}
        Side of the reference line.
    where : str
        File and element at hand, for messages.
    start_m : float
        Where the section begins. [m]

    Returns
    -------
    lanes : tuple of LaneRecord
        Numbered outwards.

    Raises
    ------
    InputError
        A number is missing, comes twice or has the wrong sign.
    """
    sign = -1
    if side == "left":
        sign = 1
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
    """Numbers of the lanes that continue this one.

    A link that is no number is ignored.
    """
    ids = [link.get("id", "").strip() for link in lane.findall(f"link/{side}")]
    return tuple(
        int(text) for text in ids if text.lstrip("+-").isdecimal() and len(text) < 10
    )
