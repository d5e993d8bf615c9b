"""City models in XML: CityGML 1.0, 2.0 and 3.0, levels of detail 0 to 3."""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from ..untrusted_files import local_name, read_xml
from .city_json import CLASS_OF_TYPE, CityObject, city_map
from .georeferences import crs_name, horizontal_crs
from .solids import Polygon3D
from .source_map import SourceMap, counted

_EXPECTED = "CityGML"
_OTHER_TYPES = (
    *("Bridge", "BridgePart", "Tunnel", "TunnelPart", "HollowSpace", "Road", "Railway", "Track"),
    *("Square", "Waterway", "WaterBody", "LandUse", "ReliefFeature", "TINRelief", "RasterRelief"),
    *("GenericCityObject", "GenericOccupiedSpace", "TransportationComplex", "CityObjectGroup"),
    *("Room", "BuildingRoom", "BuildingFurniture", "BuildingUnit", "Storey"),
)
_SURFACE_TYPES = (
    *("GroundSurface", "WallSurface", "RoofSurface", "ClosureSurface", "OuterCeilingSurface"),
    *("OuterFloorSurface", "GenericThematicSurface"),
)
_GEOMETRY = re.compile(r"lod([0-4])(\w+)")
_FOOTPRINTS = ("FootPrint", "RoofEdge", "MultiSurface")
_WORDS = ("name", "class", "function", "usage")
_MAX_DEPTH = 100  # of elements, and of references to references
_MAX_VISITS = 20  # per element: references to references could make more of few
_GML_ID = "{http://www.opengis.net/gml}id", "{http://www.opengis.net/gml/3.2}id"
_HREF = "{http://www.w3.org/1999/xlink}href"


def read_citygml(path: Path) -> SourceMap:
    """Read a CityGML file.

    Types and levels of detail: see :func:`geometry.maps.city_json.read_cityjson`, which reads the
    same model in its other encoding. Of one level of detail a solid counts more than surfaces;
    references to polygons of the same file are followed, others are not. Heights are absolute.
    Raises InputError if the file cannot be read, is no CityGML, or has nothing solid.
    """
    where = str(path)
    root = read_xml(path, expected=_EXPECTED)
    namespace = root.tag.rpartition("}")[0]
    if local_name(root) != "CityModel" or "citygml" not in namespace.lower():
        raise InputError(where, root.tag, "CityGML: a CityModel in a namespace of CityGML")
    document = _Document(where, root)
    left_out: Counter[str] = Counter()
    empty: Counter[str] = Counter()
    objects = [
        item
        for feature in document.features(left_out)
        if (item := document.city_object(feature, empty)) is not None
    ]
    skipped = counted(left_out, "no building, plant, wall or furniture")
    skipped += counted(empty, "without a surface of level of detail 0 to 3 in this file")
    declared, follows_authority = _reference_system(root, where)
    return city_map(
        objects,
        name=path.name,
        where=where,
        declared_crs=declared,
        follows_authority=follows_authority,
        skipped=skipped,
    )


@dataclass(frozen=True, slots=True)
class _Shape:
    """Polygons under a geometry property."""

    level: int
    rank: int  # 2: solid, 1: surfaces, 0: footprint
    polygons: list[Polygon3D]


class _Document:
    """The elements of a file, and an index of those that others refer to."""

    def __init__(self, where: str, root: Element) -> None:
        self.where = where
        self.root = root
        self.by_id: dict[str, Element] = {}
        self.n_visits_left = 1000
        for element in root.iter():
            self.n_visits_left += _MAX_VISITS
            for key in _GML_ID:
                if key in element.attrib:
                    self.by_id.setdefault(element.attrib[key], element)

    def features(self, left_out: Counter[str]) -> Iterator[Element]:
        """Elements of a known type; those of other known types are counted."""
        stack = [self.root]
        while stack:
            for child in reversed(stack.pop()):
                name = local_name(child)
                if name in CLASS_OF_TYPE:
                    yield child
                elif name in _OTHER_TYPES:
                    left_out[name] += 1
                    continue  # with its content: rooms, bridge parts
                stack.append(child)

    def city_object(self, feature: Element, empty: Counter[str]) -> CityObject | None:
        """An object with its own surfaces, without those of its parts."""
        type_name = local_name(feature)
        shapes = list(self._shapes(feature, 0))
        best = max(
            (shape for shape in shapes if shape.polygons),
            key=lambda shape: (shape.level if shape.level < 3 else 0.99, shape.rank),
            default=None,
        )
        has_parts = any(
            local_name(part) in CLASS_OF_TYPE and part is not feature for part in feature.iter()
        )
        if best is None or (best.level == 0 and has_parts):
            if not has_parts:
                empty[type_name] += 1
            return None
        alike = [
            polygon
            for shape in shapes
            if (shape.level, shape.rank) == (best.level, best.rank)
            for polygon in shape.polygons
        ]
        texts = {local_name(child): (child.text or "").strip() for child in feature}
        return CityObject(
            id=next((feature.attrib[key] for key in _GML_ID if key in feature.attrib), type_name),
            type_name=type_name,
            polygons=tuple(alike),
            words=" ".join(texts[name] for name in _WORDS if texts.get(name)),
            is_footprint=best.level == 0,
            height_m=_measured_height_m(feature),
        )

    def _shapes(self, element: Element, depth: int) -> Iterator[_Shape]:
        """Geometries of an object and of the surfaces that bound it."""
        if depth > _MAX_DEPTH:
            raise InputError(self.where, Unquoted("elements nested too deeply"), _EXPECTED)
        for child in element:
            name = local_name(child)
            match = _GEOMETRY.fullmatch(name)
            if match:
                level = int(match[1])
                is_flat = match[2] in _FOOTPRINTS
                if level == 0 and (not is_flat or local_name(element) in _SURFACE_TYPES[1:]):
                    continue
                rank = 2 if "Solid" in match[2] else 1 if level else is_flat + 0
                rank = 0 if match[2] == "RoofEdge" else rank
                yield _Shape(level, rank, list(self._polygons(child, depth + 1, 0)))
            elif name in ("boundedBy", "boundary") or name in _SURFACE_TYPES:
                yield from self._shapes(child, depth + 1)

    def _polygons(self, element: Element, depth: int, n_dimensions: int) -> Iterator[Polygon3D]:
        """Polygons of a geometry, following references; of solids only those of the outer shell."""
        self.n_visits_left -= 1
        if depth > _MAX_DEPTH or self.n_visits_left < 0:
            raise InputError(
                self.where, Unquoted("elements or references nested too deeply"), _EXPECTED
            )
        n_dimensions = _n_dimensions(element) or n_dimensions
        reference = element.attrib.get(_HREF, "")
        if reference.startswith("#") and reference[1:] in self.by_id:
            yield from self._polygons_of(self.by_id[reference[1:]], depth + 1, n_dimensions)
        for child in element:
            yield from self._polygons_of(child, depth + 1, n_dimensions)

    def _polygons_of(self, element: Element, depth: int, n_dimensions: int) -> Iterator[Polygon3D]:
        name = local_name(element)
        n_dimensions = _n_dimensions(element) or n_dimensions
        if name in ("Polygon", "PolygonPatch", "Triangle", "Rectangle"):
            rings = [
                self._ring(ring, n_dimensions)
                for kinds in (("exterior", "outerBoundaryIs"), ("interior", "innerBoundaryIs"))
                for boundary in element
                if local_name(boundary) in kinds
                for ring in boundary
            ]
            if rings and len(rings[0]):
                yield rings
        elif name == "OrientableSurface":
            is_turned = element.attrib.get("orientation") == "-"
            for polygon in self._polygons(element, depth, n_dimensions):
                yield [ring[::-1] for ring in polygon] if is_turned else polygon
        elif name == "Solid":
            for child in element:
                if local_name(child) == "exterior":
                    yield from self._polygons(child, depth, n_dimensions)
        elif name not in ("ImplicitGeometry", "MultiCurve", "MultiPoint"):
            yield from self._polygons(element, depth, n_dimensions)

    def _ring(self, ring: Element, n_dimensions: int) -> FloatArray:
        """Points of a ring, (n, 3), in the file's coordinates."""
        texts = []
        for element in ring.iter():
            name = local_name(element)
            if name in ("posList", "pos"):
                texts.append(element.text or "")
            elif name == "coordinates":
                texts.append((element.text or "").replace(element.attrib.get("cs") or ",", " "))
            n_dimensions = _n_dimensions(element) or n_dimensions
        words = " ".join(texts).split()
        try:
            numbers: FloatArray = np.array(words, dtype=np.float64)
        except ValueError as error:
            raise InputError(
                f"{self.where}: {self._name(ring)}", Unquoted(error), "numbers"
            ) from None
        n_dimensions = n_dimensions or 3
        if len(numbers) % n_dimensions:
            raise InputError(
                f"{self.where}: {self._name(ring)}",
                Unquoted(f"{len(numbers)} numbers"),
                f"{n_dimensions} for every point",
            )
        points = numbers.reshape(-1, n_dimensions)
        if n_dimensions == 2:
            points = np.column_stack([points, np.zeros(len(points))])
        return points

    def _name(self, element: Element) -> str:
        name = next((element.attrib[key] for key in _GML_ID if key in element.attrib), "")
        return f"{local_name(element)} {name}".strip()


def _n_dimensions(element: Element) -> int:
    """Coordinates per point as an element declares them; 0: it does not."""
    text = element.attrib.get("srsDimension", "")
    return int(text) if text in ("2", "3") else 0


_UNITS_M = {"m": 1.0, "metre": 1.0, "meter": 1.0, "ft": 0.3048, "cm": 0.01, "km": 1000.0}


def _measured_height_m(feature: Element) -> float | None:
    """Height that an object declares; None if it declares none, or one in an unknown unit."""
    for child in feature:
        name = local_name(child)
        values = [child] if name == "measuredHeight" else []
        if name == "height":  # CityGML 3.0: con:height/con:Height/con:value
            values = [value for value in child.iter() if local_name(value) == "value"]
        for value in values:
            unit = value.attrib.get("uom", "m").rpartition("#")[2].rpartition(":")[2].lower()
            try:
                return float((value.text or "").strip()) * _UNITS_M[unit]
            except (ValueError, KeyError):
                continue
    return None


def _reference_system(root: Element, where: str) -> tuple[str, bool]:
    """The declared reference system, and whether coordinates follow its order of axes.

    Raises InputError if a file declares several.
    """
    from pyproj.exceptions import ProjError

    declared: dict[str, None] = {}
    for element in root.iter():
        text = element.attrib.get("srsName", "").strip()
        if text and not text.startswith("#"):
            declared.setdefault(text)
    planes: dict[str, str] = {}
    for text in list(declared)[:_MAX_DEPTH]:
        try:
            crs = horizontal_crs(text)
        except ProjError:
            continue
        if crs is not None:
            planes.setdefault(crs_name(crs), text)
    if len(planes) > 1:
        raise InputError(
            where,
            Unquoted("several coordinate reference systems: " + ", ".join(list(planes)[:5])),
            "one in a file",
        )
    text = next(iter(planes.values()), next(iter(declared), ""))
    return text, text.lower().startswith(("urn:", "http")) and "epsg.xml#" not in text
