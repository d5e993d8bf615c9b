"""Checked attributes of XML elements, the header, facts of the format, and a list of omissions."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from ...arrays import FloatArray
from ...errors import InputError, refuse
from ...files import load_toml
from ...frames import parse_crs
from ..source_map import Omissions

MAX_MAGNITUDE = 1.0e12  # beyond it cubes of arc lengths leave what floats can hold
MAX_SIZE_M = 1.0e4
_UNSET = ("", "none", "undefined", "nan")  # written by exporters for unknown values
_MAX_CRS_CHARACTERS = 20_000
# They speak of heights, and name grids that need not be at hand.
_VERTICAL_PARAMETERS = ("+geoidgrids=", "+vunits=", "+vto_meter=", "+geoid_crs=")


def take_number(element: Element, key: str, where: str) -> float:
    """Finite number of an attribute that must be there; `where` is file and element."""
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
    return default if is_open else take_number(element, key, where)


def take_size(element: Element, key: str, where: str) -> float | None:
    """A length above 0, or None; InputError: not finite, or larger than anything near a road."""
    value = take_number_or(element, key, where, 0.0)
    if value > MAX_SIZE_M:
        raise InputError(f"{where}.{key}", value, f"metres, at most {MAX_SIZE_M:g}")
    return value if value > 0.0 else None


def take_id(element: Element, where: str) -> str:
    """Attribute id; raises InputError if it is missing or empty."""
    text = element.get("id", "").strip()
    if not text:
        refuse(f"{where}.id", "nothing", "an id")
    return text


def numbered(parent: Element | None, tag: str, where: str) -> Iterator[tuple[Element, str]]:
    """Children with a tag, and their names for messages: "Town.xodr: road 5 geometry[2]"."""
    for index, child in enumerate([] if parent is None else parent.findall(tag)):
        yield child, f"{where} {tag}[{index}]"


# ---------- the header


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Offset from a file's coordinates to those of its projection; rotation is applied first."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    heading_rad: float = 0.0

    def apply(self, points_m: FloatArray) -> FloatArray:
        """Points (n, 2) in the projection."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return np.asarray(points_m @ np.array([[cos, sin], [-sin, cos]]) + [self.x_m, self.y_m])


def read_offset(root: Element, where: str) -> Offset:
    """Offset of a document's header; all zero without one."""
    element = root.find("header/offset")
    if element is None:
        return Offset()
    x_m, y_m, z_m, heading = (
        take_number_or(element, key, f"{where}: header offset", 0.0)
        for key in ("x", "y", "z", "hdg")
    )
    return Offset(x_m=x_m, y_m=y_m, z_m=z_m, heading_rad=heading)


def read_crs(root: Element, omissions: Omissions) -> tuple[str, str]:
    """Coordinate reference system for pyproj, in metres without heights, and the declared one."""
    element = root.find("header/geoReference")
    source = "" if element is None else " ".join("".join(element.itertext()).split())
    if not source:
        return "", ""
    if {word.partition("=")[0] for word in source.split()} == {"+lat_0", "+lon_0"}:
        # CARLA's short form: a transverse Mercator there.
        source = f"+proj=tmerc {source} +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    crs = source
    if source.startswith("+"):
        words = [word for word in source.split() if not word.startswith(_VERTICAL_PARAMETERS)]
        crs = " ".join(words)
    if why := _why_not(crs):
        omissions.add("geoReferences", f"geoReference {source[:120]}", why)
        return "", source
    return crs, source


def _why_not(crs: str) -> str:
    """Why pyproj cannot take it as metres on a plane; empty: it can."""
    from pyproj.exceptions import CRSError

    if len(crs) > _MAX_CRS_CHARACTERS:
        return f"longer than {_MAX_CRS_CHARACTERS} characters"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # +init=epsg:.. is old, not wrong
            system = parse_crs(crs)
            if system.is_geographic or system.is_geocentric:
                return "degrees or geocentric, while roads are in metres on a plane"
            if not system.is_projected:
                return "no projection"
            units = {round(axis.unit_conversion_factor, 9) for axis in system.axis_info[:2]}
    except (CRSError, ValueError, TypeError):
        return "not a coordinate reference system that pyproj knows"
    return "" if units == {1.0} else "not in metres"


# ---------- facts of the format
@cache
def load_facts() -> dict[str, Any]:
    """Lane kinds, words, types and assumed numbers from ``geometry/maps/data/opendrive.toml``."""
    return load_toml(files("geometry.maps") / "data" / "opendrive.toml")


@cache
def lane_kinds() -> dict[str, str]:
    """Kind of lane by the standard's type in lower case."""
    kinds: dict[str, list[str]] = load_facts()["lane_kinds"]
    return {name.lower(): kind for kind, names in kinds.items() for name in names}


def assumed(key: str) -> float:
    """A number of the section of assumptions."""
    return float(load_facts()["assumed"][key])
