"""City models: CityJSON 1.0 to 2.0 and CityGML 1.0 to 3.0."""

import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree.ElementTree import Element

import msgspec
import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted, refuse
from ..notes import Note
from ..opening import read_text
from ..scene import join
from ..tables import read_table, says
from ..text_formats import load_data, parse_object
from ..xml_files import local_name, read_xml
from .georeferences import crs_name, georeference, horizontal_crs
from .source_map import (
    MAX_TRIANGLES,
    UNITS_M,
    Polygon3D,
    SourceMap,
    Thing,
    counted,
    extrude,
    kind_from_name,
    kind_of_class,
    shortened,
    surface_mesh,
    thing_defaults,
    unique_id,
)

# Rings of indices of vertices.
_Surfaces = list[list[list[Annotated[int, msgspec.Meta(ge=0)]]]]
_BOUNDARIES: dict[str, Any] = {
    **dict.fromkeys(("MultiSurface", "CompositeSurface"), _Surfaces),
    "Solid": list[_Surfaces],
    **dict.fromkeys(("MultiSolid", "CompositeSolid"), list[list[_Surfaces]]),
}
# Characters.
_MAX_NAME = 80
_TYPES: dict[str, Any] = load_data("geometry.maps", "words.toml")["city"]
CLASS_OF_TYPE: dict[str, str] = _TYPES["class_of_type"]
"""Class of thing by the type of an object."""
_Table = Mapping[str, Any]
_GML = "CityGML"
_GEOMETRY = re.compile(r"lod([0-4])(\w+)")
# Of elements, and of references to references.
_MAX_DEPTH = 100
# Per element: references to references could make more of few.
_MAX_VISITS = 20
_GML_ID = "{http://www.opengis.net/gml}id", "{http://www.opengis.net/gml/3.2}id"
_HREF = "{http://www.w3.org/1999/xlink}href"
# Level of detail; rank: 2 solid, 1 surfaces, 0 footprint; the polygons under a geometry
# property.
_Shape = tuple[int, int, list[Polygon3D]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CityObject:
    """One object of a city model, in the file's coordinates.

    Attributes
    ----------
    id : str
        Id in the file.
    type_name : str
        One of CLASS_OF_TYPE.
    polygons : tuple of Polygon3D
        Its surfaces, or its footprint.
    words : str
        Its name and function.
    is_footprint : bool
        Level of detail 0: the polygons are to be raised by height_m.
    height_m : float or None
        Of the top above the footprint, if the file gives it. [m]
    """

    id: str
    type_name: str
    polygons: tuple[Polygon3D, ...]
    words: str = ""
    is_footprint: bool = False
    height_m: float | None = None


class _CityTransform(msgspec.Struct, frozen=True, kw_only=True):
    """From the integers of a file to its coordinates."""

    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    translate: tuple[float, float, float] = (0.0, 0.0, 0.0)


class _CityGeometry(msgspec.Struct, frozen=True, kw_only=True):
    """A geometry of an object, in one level of detail."""

    type: str
    lod: Annotated[str, says("0 to 3.3", pattern=r"^[0-9](\.[0-9])?$")] | float = 1.0
    boundaries: Any = None


class _CityEntry(msgspec.Struct, frozen=True, kw_only=True):
    """An object of a city."""

    type: str
    geometry: tuple[_CityGeometry, ...] = ()
    children: tuple[str, ...] = ()
    attributes: dict[str, Any] | None = None


class _CityDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A document."""

    type: Literal["CityJSON"]
    version: Literal["1.0", "1.1", "2.0"]
    transform: _CityTransform = _CityTransform()
    metadata: dict[str, Any] | None = None
    vertices: tuple[tuple[float, float, float], ...] = ()
    CityObjects: dict[str, dict[str, Any]] = {}


def read_cityjson(path: Path) -> SourceMap:
    """Read a CityJSON file.

    Each object is read in its highest level of detail below 3, or else in level 3;
    if there is only level 0, its footprint is raised by the measured height.
    Buildings and their parts become buildings, plants become vegetation, other
    constructions walls; furniture becomes a wall too, unless its name says lamp
    or tree. Bridges are left out with tunnels and ground: the scene's road is
    one plane, and a bridge deck would lie on it. So are objects that are copies of a
    template.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    source : SourceMap
        Heights are absolute.

    Raises
    ------
    InputError
        The file cannot be read, is no CityJSON, or has nothing solid.
    """
    where = str(path)
    document = parse_object(read_text(path, "CityJSON"), where, "CityJSON")
    city = read_table(document, _CityDocument, where)
    crs = (city.metadata or {}).get("referenceSystem")
    if not isinstance(crs, str):
        crs = ""
    left_out: Counter[str] = Counter()
    empty: Counter[str] = Counter()
    corners = np.array(city.vertices, dtype=np.float64).reshape(-1, 3)
    # _city_map refuses what is not finite.
    with np.errstate(over="ignore"):
        vertices = corners * city.transform.scale + city.transform.translate
    objects = [*_objects(city, vertices, where, left_out, empty)]
    skipped = counted(left_out, "no building, plant, wall or furniture")
    skipped += counted(empty, "without a surface of level of detail 0 to 3")
    # Easting comes first, whatever the reference system says.
    return _city_map(
        path,
        objects,
        skipped,
        crs,
        by_axes=False,
    )


def _objects(
    city: _CityDocument,
    vertices: FloatArray,
    where: str,
    left_out: Counter[str],
    empty: Counter[str],
) -> Iterator[CityObject]:
    """Objects of a known type that have surfaces; the others are counted.

    Parameters
    ----------
    city : _CityDocument
        The document.
    vertices : (n, 3) float
        Its vertices, in the file's coordinates.
    where : str
        File at hand, for messages.
    left_out : Counter[str]
        Counts of objects of other types; extended.
    empty : Counter[str]
        Counts of objects without surfaces; extended.

    Yields
    ------
    item : CityObject
        An object whose parts have the surfaces is left out.
    """
    for name, table in city.CityObjects.items():
        here = f"{where}: {name}"
        entry = read_table(table, _CityEntry, here)
        if entry.type not in CLASS_OF_TYPE:
            left_out[entry.type[:_MAX_NAME]] += 1
            continue
        polygons, level = _best(entry.geometry, vertices, here)
        # Objects whose parts have the surfaces are left to those.
        parts = [city.CityObjects.get(one, {}) for one in entry.children]
        has_parts = any(part.get("geometry") for part in parts)
        if level < 1.0 and has_parts:
            continue
        if not polygons:
            if not entry.children:
                empty[entry.type] += 1
            continue
        attributes = entry.attributes or {}
        words = [
            str(attributes[key])[:_MAX_NAME]
            for key in _TYPES["words"]
            if key in attributes
        ]
        yield CityObject(
            id=name,
            type_name=entry.type,
            polygons=tuple(polygons),
            words=" ".join(words),
            is_footprint=level < 1.0,
            height_m=_height_m(attributes),
        )


def _height_m(attributes: _Table) -> float | None:
    """Height in the first of the known attributes; None: there is no number."""
    value = next(
        (attributes[key] for key in _TYPES["heights"] if key in attributes), None
    )
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if abs(value) <= sys.float_info.max:
        return float(value)
    return None


def _best(
    geometries: Sequence[_CityGeometry], vertices: FloatArray, where: str
) -> tuple[list[Polygon3D], float]:
    """Surfaces of the most useful level of detail, and that level."""
    # The most useful geometry that has surfaces.
    best: tuple[list[Polygon3D], float] = ([], -1.0)
    for index, geometry in enumerate(geometries):
        polygons = _polygons(geometry, vertices, f"{where}.geometry[{index}]")
        level = float(geometry.lod)
        if polygons and _rank(level) > _rank(best[1]):
            best = (polygons, level)
    return best


def _rank(level: float) -> float:
    """Usefulness of a level of detail: highest below 3, then 3, then 0."""
    if level < 3.0:
        return level
    return 0.99


def _polygons(
    geometry: _CityGeometry, vertices: FloatArray, where: str
) -> list[Polygon3D]:
    """Surfaces of a geometry; points, lines and copies of templates have none.

    Of solids these are the surfaces of the outer shells.

    Parameters
    ----------
    geometry : _CityGeometry
        Geometry of an object.
    vertices : (n, 3) float
        Vertices of the document.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    polygons : list of Polygon3D
        Outer ring, then holes.

    Raises
    ------
    InputError
        An index is no vertex, or the nesting does not fit the type.
    """
    kind = geometry.type
    here = f"{where}.boundaries"
    if kind not in _BOUNDARIES:
        return []
    nested: Any = read_table(geometry.boundaries, _BOUNDARIES[kind], here)
    if kind.endswith("Solid"):
        solids = nested
        if kind == "Solid":
            solids = [nested]
        nested = chain.from_iterable(shells[0] for shells in solids if shells)
    surfaces = [rings for rings in nested if rings]
    highest = max(
        (index for rings in surfaces for ring in rings for index in ring),
        default=-1,
    )
    if highest >= len(vertices):
        raise InputError(here, highest, f"vertices 0 to {len(vertices) - 1}")
    return [
        [vertices[np.array(ring, dtype=np.int64)] for ring in rings]
        for rings in surfaces
    ]


def _city_map(
    path: Path,
    objects: Sequence[CityObject],
    skipped: Sequence[Note],
    declared_crs: str,
    *,
    by_axes: bool,
) -> SourceMap:
    """Map of the objects of a city model.

    Parameters
    ----------
    path : Path
        File, for names and messages.
    objects : sequence of CityObject
        Objects in the file's coordinates.
    skipped : sequence of Note
        Notes on what was left out.
    declared_crs : str
        Reference system that the file declares; empty: none.
    by_axes : bool
        Coordinates come in the order of axes of the reference system.

    Returns
    -------
    source : SourceMap
        One thing for each object that has an area.

    Raises
    ------
    InputError
        There is nothing solid, or too much.
    """
    where = str(path)
    objects = [item for item in objects if item.polygons]
    if not objects:
        expected = "objects of level of detail 0 to 3" + _said(skipped)
        refuse(where, "no building, plant or furniture with surfaces", expected)
    # Project all rings at once, and hand them back in order.
    rings = [ring for item in objects for polygon in item.polygons for ring in polygon]
    points: FloatArray = np.concatenate(rings)
    if not np.isfinite(points).all():
        refuse(where, "a coordinate that is not finite", "finite numbers")
    place = georeference(
        points[:, :2],
        declared_crs,
        where=where,
        follows_authority=by_axes,
    )
    points = place.to_metres(points, where)
    in_metres = iter(np.split(points, np.cumsum([len(ring) for ring in rings])[:-1]))
    things: list[Thing] = []
    flat: list[Note] = []
    ids: Counter[str] = Counter()
    n_triangles = 0
    for item in objects:
        polygons = tuple(
            tuple(next(in_metres) for _ in polygon) for polygon in item.polygons
        )
        try:
            thing = _thing(replace(item, polygons=polygons), unique_id(item.id, ids))
        except InputError as error:
            flat.append(Note(f"{item.type_name} {item.id}", str(error)))
            continue
        things.append(thing)
        n_triangles += len(thing.triangles)
        if n_triangles > MAX_TRIANGLES:
            refuse(
                where,
                f"more than {MAX_TRIANGLES:,} triangles",
                "a part of the city",
            )
    if not things:
        refuse(where, "no surface with an area", "buildings" + _said(flat))
    return SourceMap(
        name=path.name,
        crs=place.crs,
        source_crs=place.source_crs,
        heights="absolute",
        things=tuple(things),
        skipped=(*place.notes, *skipped, *shortened(flat)),
    )


def _thing(item: CityObject, thing_id: str) -> Thing:
    """One object as triangles; InputError: it has no area."""
    # Furniture says in its name what it is.
    class_name = CLASS_OF_TYPE[item.type_name]
    if item.type_name == "CityFurniture":
        kind = kind_from_name(item.words)
        if kind and kind.class_name != "ground":
            class_name = kind.class_name
    if not item.is_footprint:
        mesh = surface_mesh(item.polygons)
        if not len(mesh[1]):
            refuse(item.id, "surfaces without area", "polygons")
        return Thing.of(thing_id, class_name, mesh)
    # A footprint is raised by its height, or by the usual one.
    height = item.height_m
    is_assumed = height is None or not 0.0 < height <= thing_defaults().max_height_m
    if height is None or is_assumed:
        raised_m = kind_of_class(class_name).height_m
    else:
        raised_m = height
    pieces = []
    for outer, *holes in item.polygons:
        bottom_m = float(outer[:, 2].min())
        rings = [hole[:, :2] for hole in holes if len(hole) >= 4]
        heights = {"bottom_m": bottom_m, "top_m": bottom_m + raised_m}
        pieces.append(extrude(outer[:, :2], **heights, holes_m=rings, where=item.id))
    return Thing.of(thing_id, class_name, join(pieces), is_height_assumed=is_assumed)


def _said(skipped: Sequence[Note]) -> str:
    """Reasons why things were left out, for the end of a message."""
    words = ", ".join(f"{item.what} ({item.why})" for item in skipped[:5])
    if words:
        return f"; skipped: {words}"
    return ""


# ---------- CityGML
def read_citygml(path: Path) -> SourceMap:
    """Read a CityGML file.

    :func:`read_cityjson` says which types and levels of detail count: it reads the same
    model in its other encoding. Of one level of detail a solid counts
    more than surfaces; references to polygons of the same file are followed, others are
    not. Heights are absolute. Raises InputError if the file cannot be read, is no
    CityGML, or has nothing solid.
    """
    where = str(path)
    root = read_xml(path, expected=_GML)
    namespace = root.tag.rpartition("}")[0]
    if local_name(root) != "CityModel" or "citygml" not in namespace.lower():
        raise InputError(
            where,
            root.tag,
            "CityGML: a CityModel in a namespace of CityGML",
        )
    document = _Document(where, root)
    left_out: Counter[str] = Counter()
    empty: Counter[str] = Counter()
    found = (
        document.city_object(feature, empty) for feature in document.features(left_out)
    )
    objects = [item for item in found if item is not None]
    skipped = counted(left_out, "no building, plant, wall or furniture")
    skipped += counted(
        empty, "without a surface of level of detail 0 to 3 in this file"
    )
    declared, follows_authority = _reference_system(root, where)
    return _city_map(path, objects, skipped, declared, by_axes=follows_authority)


class _Document:
    """Elements of a file, and an index of those that others refer to."""

    def __init__(self, where: str, root: Element) -> None:
        self.where = where
        self.root = root
        self.by_id: dict[str, Element] = {}
        self.n_visits_left = 1000
        for element in root.iter():
            self.n_visits_left += _MAX_VISITS
            if name := _gml_id(element):
                self.by_id.setdefault(name, element)

    def features(self, left_out: Counter[str]) -> Iterator[Element]:
        """Elements of a known type; those of other known types are counted."""
        stack = [self.root]
        while stack:
            for child in reversed(stack.pop()):
                name = local_name(child)
                if name in CLASS_OF_TYPE:
                    yield child
                elif name in _TYPES["left_out"]:
                    left_out[name] += 1
                    continue
                stack.append(child)

    def city_object(self, feature: Element, empty: Counter[str]) -> CityObject | None:
        """Object with its own surfaces, without those of its parts.

        Parameters
        ----------
        feature : Element
            Element of the object.
        empty : Counter[str]
            Counts of objects without surfaces; extended.

        Returns
        -------
        item : CityObject or None
            None: it has no surface of its own.
        """
        type_name = local_name(feature)
        # The best level of detail, and at that the best kind of geometry.
        shapes = [shape for shape in self._shapes(feature, 0) if shape[2]]
        ranks = [(level, rank) for level, rank, _ in shapes]
        level, kind = max(
            ranks,
            key=lambda one: (_rank(one[0]), one[1]),
            default=(-1, -1),
        )
        parts = (part for part in feature.iter() if part is not feature)
        has_parts = any(local_name(part) in CLASS_OF_TYPE for part in parts)
        if level < 0 or (level == 0 and has_parts):
            if not has_parts:
                empty[type_name] += 1
            return None
        alike = [polygons for *at, polygons in shapes if at == [level, kind]]
        texts = {local_name(child): (child.text or "").strip() for child in feature}
        return CityObject(
            id=_gml_id(feature) or type_name,
            type_name=type_name,
            polygons=tuple(chain.from_iterable(alike)),
            words=" ".join(texts[name] for name in _TYPES["names"] if texts.get(name)),
            is_footprint=level == 0,
            height_m=_measured_height_m(feature),
        )

    def _shapes(self, element: Element, depth: int) -> Iterator[_Shape]:
        """Geometries of an object and of the surfaces that bound it."""
        if depth > _MAX_DEPTH:
            refuse(self.where, "elements nested too deeply", _GML)
        for child in element:
            name = local_name(child)
            match = _GEOMETRY.fullmatch(name)
            if match:
                level = int(match[1])
                is_flat = match[2] in _TYPES["footprints"]
                if level == 0 and (
                    not is_flat or local_name(element) in _TYPES["surfaces"][1:]
                ):
                    continue
                rank = int(match[2] != "RoofEdge")
                if "Solid" in match[2]:
                    rank = 2
                yield level, rank, list(self._polygons(child, depth + 1, 0))
            elif name in ("boundedBy", "boundary") or name in _TYPES["surfaces"]:
                yield from self._shapes(child, depth + 1)

    def _polygons(
        self,
        element: Element,
        depth: int,
        n_dimensions: int,
    ) -> Iterator[Polygon3D]:
        """Polygons of an element and of those in it, or to which it refers.

        Parameters
        ----------
        element : Element
            XML element.
        depth : int
            How deeply the element is nested, references included.
        n_dimensions : int
            Coordinates per point as the elements around it declare; 0: they do not.

        Yields
        ------
        polygon : Polygon3D
            Reversed where an OrientableSurface says so.

        Raises
        ------
        InputError
            Elements or references are nested too deeply.
        """
        self.n_visits_left -= 1
        if depth > _MAX_DEPTH or self.n_visits_left < 0:
            refuse(self.where, "elements or references nested too deeply", _GML)
        name = local_name(element)
        n_dimensions = _n_dimensions(element) or n_dimensions
        if name in ("Polygon", "PolygonPatch", "Triangle", "Rectangle"):
            rings = [
                self._ring(ring, n_dimensions)
                for kinds in (
                    ("exterior", "outerBoundaryIs"),
                    ("interior", "innerBoundaryIs"),
                )
                for boundary in element
                if local_name(boundary) in kinds
                for ring in boundary
            ]
            if rings and len(rings[0]):
                yield rings
        elif name not in ("ImplicitGeometry", "MultiCurve", "MultiPoint"):
            reference = element.attrib.get(_HREF, "")
            # What the element refers to, then what it contains.
            inside: list[Element | None] = []
            if reference.startswith("#"):
                inside = [self.by_id.get(reference[1:])]
            inside += [
                one
                for one in element
                if name != "Solid" or local_name(one) == "exterior"
            ]
            is_turned = (
                name == "OrientableSurface" and element.attrib.get("orientation") == "-"
            )
            for child in (one for one in inside if one is not None):
                for polygon in self._polygons(child, depth + 1, n_dimensions):
                    if is_turned:
                        yield [ring[::-1] for ring in polygon]
                    else:
                        yield polygon

    def _ring(self, ring: Element, n_dimensions: int) -> FloatArray:
        """Points of a ring in the file's coordinates, (n, 3).

        Parameters
        ----------
        ring : Element
            Element with the coordinates.
        n_dimensions : int
            Coordinates per point as the elements around it declare; 0: they do not.

        Returns
        -------
        points : (n, 3) float
            Heights are 0 where points have two coordinates.

        Raises
        ------
        InputError
            A coordinate is no number, or one is missing.
        """
        words: list[str] = []
        for element in ring.iter():
            name = local_name(element)
            text = element.text or ""
            if name in ("posList", "pos"):
                words += text.split()
            elif name == "coordinates":
                words += text.replace(element.attrib.get("cs") or ",", " ").split()
            n_dimensions = _n_dimensions(element) or n_dimensions
        where = f"{self.where}: {local_name(ring)} {_gml_id(ring)}".strip()
        try:
            numbers: FloatArray = np.array(words, dtype=np.float64)
        except ValueError as error:
            raise InputError(where, Unquoted(error), "numbers") from None
        n_dimensions = n_dimensions or 3
        if len(numbers) % n_dimensions:
            refuse(where, f"{len(numbers)} numbers", f"{n_dimensions} for every point")
        points = numbers.reshape(-1, n_dimensions)
        if n_dimensions == 2:
            points = np.column_stack([points, np.zeros(len(points))])
        return points


def _gml_id(element: Element) -> str:
    """Id of an element, in either version of GML; empty: none."""
    return next((element.attrib[key] for key in _GML_ID if key in element.attrib), "")


def _n_dimensions(element: Element) -> int:
    """Coordinates per point as an element declares them; 0: it does not."""
    text = element.attrib.get("srsDimension", "")
    if text in ("2", "3"):
        return int(text)
    return 0


def _measured_height_m(feature: Element) -> float | None:
    """Height that an object declares in metres; None: none in a known unit."""
    for child in feature:
        if local_name(child) == "measuredHeight":
            values = [child]
        else:
            values = []
        # CityGML 3.0: con:height/con:Height/con:value.
        if local_name(child) == "height":
            values = [value for value in child.iter() if local_name(value) == "value"]
        for value in values:
            # Units may be written as "urn:ogc:def:uom:UCUM::m" or "...#m".
            _, _, unit = value.attrib.get("uom", "m").rpartition("#")
            _, _, unit = unit.rpartition(":")
            unit = unit.lower()
            with suppress(ValueError, KeyError):
                return float((value.text or "").strip()) * UNITS_M[unit]
    return None


def _reference_system(root: Element, where: str) -> tuple[str, bool]:
    """Declared reference system, and whether its order of axes counts.

    Parameters
    ----------
    root : Element
        Root element of the document.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    declared : str
        Empty: none.
    follows_authority : bool
        Coordinates come in its own order of axes.

    Raises
    ------
    InputError
        Several different ones are declared.
    """
    from pyproj.exceptions import ProjError

    # Several spellings may mean the same reference system.
    texts = (element.attrib.get("srsName", "").strip() for element in root.iter())
    declared = dict.fromkeys(
        text for text in texts if text and not text.startswith("#")
    )
    planes: dict[str, str] = {}
    for text in list(declared)[:_MAX_DEPTH]:
        with suppress(ProjError):
            if (crs := horizontal_crs(text)) is not None:
                planes.setdefault(crs_name(crs), text)
    if len(planes) > 1:
        got = "several coordinate reference systems: " + ", ".join(list(planes)[:5])
        refuse(where, got, "one in a file")
    text = next(iter(planes.values()), next(iter(declared), ""))
    return text, text.lower().startswith(("urn:", "http")) and "epsg.xml#" not in text
