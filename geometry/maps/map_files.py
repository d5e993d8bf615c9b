"""Map files of any kind, by what they are: the one place that knows all readers."""

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..errors import InputError, Unquoted
from .archives import unpacked
from .model import SourceMap
from .xml_files import local_name, read_xml_root

_MESHES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".off")
_CLOUDS = (".las", ".laz", ".pcd")
_FOOTPRINTS = (".geojson", ".gpkg", ".shp")
_STREETS = (".osm", ".pbf", ".osm.gz", ".osm.bz2")
SUFFIXES = (
    *(".xodr", *_STREETS, *_FOOTPRINTS, ".json", ".jsonl", ".gml", ".citygml", ".xml"),
    *(*_MESHES, *_CLOUDS, ".zip"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """What files do not say of themselves.

    Attributes
    ----------
    unit, up : str, optional
        Of meshes, see :func:`geometry.maps.mesh_files.read_mesh`.
    class_name : str
        Of meshes, point clouds and footprints that do not say what they are.
    keeps_left : bool, optional
        On which side traffic keeps; by default what the map says.
    crs : str
        Of files that do not say where they lie; empty: none.
    layer : str
        Of a GeoPackage that has several; empty: the only one.
    offset_m : (2,) float, optional
        Moves what has no roads: buildings, meshes, point clouds. These then lie in the coordinates
        of the map that has the junction, whatever they say. [m]
    """

    unit: str | None = None
    up: str | None = None
    class_name: str = "building"
    keeps_left: bool | None = None
    crs: str = ""
    layer: str = ""
    offset_m: tuple[float, float] | None = None


def read_map(path: Path, options: ReadingOptions | None = None) -> SourceMap:
    """Read a map file.

    Parameters
    ----------
    path : Path
        Its suffix says what it is; .json, .gml and .xml are looked into, .zip is opened.
    options : ReadingOptions, optional
        What it does not say of itself.

    Returns
    -------
    source : SourceMap
        What it says.

    Raises
    ------
    InputError
        There is no such file, it is of no kind that is known, or it is damaged.
    """
    options = options or ReadingOptions()
    crs = _projected(options.crs) if options.crs else ""
    if not path.exists():
        raise InputError(str(path), Unquoted("no such file"), "a map file")
    if path.is_dir():
        raise InputError(str(path), Unquoted("a folder"), "a map file")
    with ExitStack() as stack:
        inside = path
        if path.suffix.lower() == ".zip":
            inside = stack.enter_context(unpacked(path, SUFFIXES[:-1]))
        source = _reader(inside, options)(inside)
    if options.offset_m is not None and not source.lanes:
        return _moved(source, np.array([*options.offset_m, 0.0]))
    if crs and not source.crs:
        source = replace(source, crs=crs, source_crs=crs)
    return source


def _reader(path: Path, options: ReadingOptions) -> Callable[[Path], SourceMap]:
    """What reads a file; what is heavy is imported only where it is needed."""
    name = path.name.lower()
    kind = next((suffix for suffix in SUFFIXES if name.endswith(suffix)), "")
    if kind == ".json":
        kind = ".city.json" if _is_city_json(path) else ".geojson"
    if kind == ".jsonl":
        kind = ".city.json"
    if kind in (".xml", ".gml", ".citygml"):
        kind = _kind_of_xml(path)
    if kind == ".xodr":
        from .opendrive import read_opendrive

        return read_opendrive
    if kind in _STREETS:
        from .openstreetmap import read_openstreetmap

        return lambda file: read_openstreetmap(file, keeps_left=options.keeps_left)
    if kind in _FOOTPRINTS:
        from .footprint_files import read_footprints

        return lambda file: read_footprints(
            file, class_name=options.class_name, layer=options.layer or None
        )
    if kind == ".city.json":
        from .city_json import read_cityjson

        return read_cityjson
    if kind == ".gml":
        from .city_gml import read_citygml

        return read_citygml
    if kind in _MESHES:
        from .mesh_files import read_mesh

        return lambda file: read_mesh(
            file, unit=options.unit, up=options.up, class_name=options.class_name
        )
    if kind in _CLOUDS:
        from .point_clouds import read_point_cloud

        return lambda file: read_point_cloud(file, class_name=options.class_name)
    raise InputError(str(path), Unquoted("another kind of file"), ", ".join(SUFFIXES))


def _moved(source: SourceMap, offset_m: FloatArray) -> SourceMap:
    return replace(
        source,
        crs="",
        source_crs="",
        things=tuple(
            replace(thing, vertices_m=thing.vertices_m + offset_m) for thing in source.things
        ),
        poles=tuple(replace(pole, position_m=pole.position_m + offset_m) for pole in source.poles),
        crosswalks_m=source.crosswalks_m + offset_m[:2],
    )


def _is_city_json(path: Path) -> bool:
    """Whether a JSON file says that it is CityJSON, near its beginning or its end."""
    with path.open("rb") as file:
        head = file.read(4096)
        if b'"CityJSON"' in head:
            return True
        if b'"FeatureCollection"' in head or b'"Feature"' in head:
            return False
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return False  # the reader of GeoJSON says what is wrong
    return isinstance(document, dict) and document.get("type") == "CityJSON"


def _kind_of_xml(path: Path) -> str:
    root = local_name(read_xml_root(path))
    kinds = {"OpenDRIVE": ".xodr", "osm": ".osm", "CityModel": ".gml"}
    if root not in kinds:
        raise InputError(str(path), Unquoted(f"<{root}>"), "OpenDRIVE, OpenStreetMap or CityGML")
    return kinds[root]


def _projected(crs: str) -> str:
    """A coordinate reference system by a user's words, checked: projected, in metres."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(crs)
    except CRSError:
        raise InputError("--crs", crs, "one that pyproj knows, such as EPSG:25832") from None
    if not system.is_projected or any(axis.unit_name != "metre" for axis in system.axis_info[:2]):
        raise InputError("--crs", crs, "a projected one in metres")
    return crs
