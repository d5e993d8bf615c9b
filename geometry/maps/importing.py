"""Import map files as a scene.

The steps are to read the files, choose a junction, cut it out, and decide
on sites.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from functools import cache
from pathlib import Path

import numpy as np
import shapely

from ..archives import unpacked
from ..arrays import FloatArray
from ..errors import InputError, check_one_of, refuse
from ..frames import WGS84, check_crs, transform
from ..junction import CARRIAGEWAY_KINDS, build_junction
from ..notes import Note
from ..opening import check_file, open_file, read_text
from ..phrases import Phrase
from ..progress import Progress, silent
from ..registry import load_entry
from ..scene import (
    Instance,
    Lane,
    Scene,
    Site,
    area_of,
    is_lane_width,
    join_bodies,
)
from ..scene_checks import arms_that_end
from ..scene_sources import CLOUDS, FOOTPRINTS, MAP_SUFFIXES, MESHES, STREETS
from ..sensors import load_limits
from ..terrain import GROUND
from ..text_formats import load_data, parse_json
from ..xml_files import local_name, read_xml_root
from .cut import LANES_BEYOND_M, build_scene, cut_out
from .elsewhere import check_maps_lie_here
from .place_lists import SUFFIXES as LISTS
from .relief import read_elevation
from .sites import choose_sites, settle_poles
from .source_map import NOTHING, MapJunction, MapLane, Pole, SourceMap, Thing

_MAX_LISTED = 12
_NEAR_M = 100.0
# From the outline: signals and crosswalks of the arms.
_BESIDE_M = 15.0
SORTS = ("arms", "lanes", "signals", "crossings", "name")
_LAT_LON = re.compile(r"\s*([-+]?\d{1,2}(?:\.\d+)?)\s*,\s*([-+]?\d{1,3}(?:\.\d+)?)\s*")
_BETWEEN = re.compile(r"\s*[/&+;]\s*|\s+(?:and|und|at|x|@)\s+", re.IGNORECASE)
# Readers of maps by the ending of a file, and the options that each asks for.
READERS = {
    ".xodr": "geometry.maps.opendrive:read_opendrive",
    "lanelets": "geometry.maps.lanelets:read_lanelet2",
    "commonroad": "geometry.maps.lanelets:read_commonroad",
    **dict.fromkeys(STREETS, "geometry.maps.openstreetmap:read_openstreetmap"),
    **dict.fromkeys(FOOTPRINTS, "geometry.maps.gis_files:read_footprints"),
    ".city.json": "geometry.maps.city_models:read_cityjson",
    ".citygml": "geometry.maps.city_models:read_citygml",
    **dict.fromkeys(MESHES, "geometry.maps.mesh_files:read_mesh"),
    **dict.fromkeys(CLOUDS, "geometry.maps.point_clouds:read_point_cloud"),
}
"""Registry of the readers of maps, by the ending of a file or the kind of its content.

Each takes a path and the options of ``_ASKED``, and returns a :class:`SourceMap`.
"""
_ASKED = {
    "lanelets": ("keeps_left",),
    "commonroad": ("keeps_left",),
    **dict.fromkeys(STREETS, ("keeps_left", "staggered_m", "progress")),
    **dict.fromkeys(FOOTPRINTS, ("class_name",)),
    **dict.fromkeys(MESHES, ("unit", "up", "class_name")),
    **dict.fromkeys(CLOUDS, ("class_name",)),
}
_ROOTS = {
    "OpenDRIVE": ".xodr",
    "osm": ".osm",
    "CityModel": ".citygml",
    "commonRoad": "commonroad",
}
DEFAULT_RADIUS_M = 80.0
_RADIUS_LIMITS_M = (20.0, 500.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surveyed:
    """Junction of a map and the lanes that lead to it.

    Attributes
    ----------
    junction : MapJunction
        The junction itself.
    arms : tuple of str
        Names of its arms; empty if no lane ends at its outline.
    n_lanes : int
        Driving lanes into it and out of it.
    n_driven : int
        Arms from which a driving lane leads into it.
    position : (2,) float
        Its middle in the file's coordinate reference system: longitude and
        latitude, or metres.
    n_signals : int
        Poles with traffic lights inside it, or at most 15 m from its outline.
    n_crossings : int
        Crosswalks whose middle lies inside it, or at most 15 m from its
        outline.
    roads : tuple[tuple[str, int], ...]
        Of each arm: class, and driving lanes in and out.
    """

    junction: MapJunction
    arms: tuple[str, ...]
    n_lanes: int
    n_driven: int
    position: FloatArray
    n_signals: int = 0
    n_crossings: int = 0
    roads: tuple[tuple[str, int], ...] = ()


def survey_junctions(source: SourceMap) -> tuple[Surveyed, ...]:
    """All junctions of a map, the largest first.

    They are sorted by arms, driven arms, lanes, and nearness to the middle of
    the map; those through which cars cannot be led come last.

    Parameters
    ----------
    source : SourceMap
        The map.

    Returns
    -------
    surveyed : tuple of Surveyed
        One for each junction.
    """
    # Lanes, signals and crosswalks of each junction.
    by_junction: dict[str, list[MapLane]] = defaultdict(list)
    for lane in source.lanes:
        for name in {lane.from_junction, lane.to_junction}:
            by_junction[name].append(lane)
    lights = [
        pole.position_m[:2] for pole in source.poles if pole.kind == "traffic light"
    ]
    signals = _count_near(source.junctions, np.array(lights).reshape(-1, 2))
    crossings = _count_near(source.junctions, source.crosswalks_m.mean(axis=1))
    found = [
        replace(
            _survey(source, one, by_junction[one.id]),
            n_signals=lit,
            n_crossings=crossed,
        )
        for one, lit, crossed in zip(source.junctions, signals, crossings, strict=True)
    ]
    middle = np.median(
        [one.junction.position_m for one in found] or [np.zeros(2)],
        axis=0,
    )

    def rank(one: Surveyed) -> tuple[float, ...]:
        """Key for sorting, the largest junction first."""
        off_m = float(np.hypot(*(one.junction.position_m - middle)))
        has_fault = bool(one.junction.fault)
        return (has_fault, -len(one.arms), -one.n_driven, -one.n_lanes, off_m)

    return tuple(sorted(found, key=rank))


def _count_near(junctions: Sequence[MapJunction], points_m: FloatArray) -> list[int]:
    """Number of points inside each junction or next to it."""
    areas = shapely.STRtree([area_of(one.outline_m) for one in junctions])
    _, hit = areas.query(
        shapely.points(points_m),
        predicate="dwithin",
        distance=_BESIDE_M,
    )
    return [*np.bincount(hit, minlength=len(junctions)).tolist()]


def sort_junctions(surveyed: Sequence[Surveyed], sort: str) -> tuple[Surveyed, ...]:
    """Surveyed junctions in another order.

    Parameters
    ----------
    surveyed : sequence of Surveyed
        Junctions of the map with their arms and lanes.
    sort : str
        One of ``SORTS``: the most first, or names by the alphabet; "arms" is
        the order that they come in.

    Returns
    -------
    sorted : tuple of Surveyed
        Equal ones stay in their order.

    Raises
    ------
    InputError
        `sort` is none of them.
    """
    check_one_of("sort", sort, SORTS)
    if sort == "name":
        return tuple(sorted(surveyed, key=lambda one: one.junction.name.casefold()))
    # The order that they come in.
    if sort == "arms":
        return tuple(surveyed)
    return tuple(sorted(surveyed, key=lambda one: -int(getattr(one, f"n_{sort}"))))


def choose_junction(
    source: SourceMap,
    surveyed: Sequence[Surveyed],
    *,
    name: str = "",
    at: tuple[float, float] | None = None,
) -> Surveyed:
    """Choose a junction by name or point; by default the first.

    Parameters
    ----------
    source : SourceMap
        The map.
    surveyed : sequence of Surveyed
        Its junctions, as :func:`survey_junctions` returns them.
    name : str
        Id; or name, streets in any order: "Mannerheimintie / Kaivokatu", or some of
        them; or a part of the name that no other junction has; empty: any.
    at : (float, float), optional
        A point within 100 m, in the file's coordinate reference system: longitude and
        latitude, or metres.

    Raises
    ------
    InputError
        The map has no junction, or none or several match.
    """
    if not surveyed:
        refuse(source.name, "no junction", "a map in which roads meet")
    where = "at"
    if name:
        place = _LAT_LON.fullmatch(name)
        if place is None or any(one.junction.id == name for one in surveyed):
            return _by_name(surveyed, name)
        if not source.crs:
            expected = "an id or a name: the map does not say where it lies"
            raise InputError("junction", name, expected)
        lon_lat = np.array([float(place[2]), float(place[1])])
        x, y = transform(lon_lat, WGS84, source.source_crs or source.crs)
        where = "junction"
        at = (float(x), float(y))
    if at is None:
        return surveyed[0]
    # The nearest junction, if it is near enough.
    point = _in_map(source, at)
    if not np.isfinite(point).all():
        refuse(where, f"{at[0]:g},{at[1]:g}", f"a point in {source.source_crs}")

    def away_m(one: Surveyed, place: FloatArray) -> float:
        return float(np.hypot(*(one.junction.position_m - place)))

    nearest = min(surveyed, key=lambda one: away_m(one, point))
    if away_m(nearest, point) <= _NEAR_M:
        return nearest
    got = name or f"{at[0]:.8g},{at[1]:.8g}"
    # Say so if the coordinates are only in the wrong order.
    exchanged = _in_map(source, (at[1], at[0]))
    if min(away_m(one, exchanged) for one in surveyed) <= _NEAR_M:
        order = "X,Y"
        if name:
            order = "latitude,longitude"
        elif source.source_crs == "EPSG:4326":
            order = "longitude,latitude"
        refuse(where, got, f"{order}: it is the other way round")
    place_of = ", ".join(f"{value:.8g}" for value in nearest.position)
    expected = f"a point within {_NEAR_M:g} m of a junction; the nearest one, "
    refuse(where, got, f"{expected}{nearest.junction.id}, is at {place_of}")


def _by_name(surveyed: Sequence[Surveyed], name: str) -> Surveyed:
    """Junction with an id or name; InputError: none or several match.

    An exact match counts most, then the same streets, then some of them, then a
    part of the name.
    """
    wanted = name.casefold()
    for matches in (
        [one for one in surveyed if one.junction.id == name],
        [one for one in surveyed if one.junction.name.casefold() == wanted],
        [one for one in surveyed if _streets(one.junction.name) == _streets(name)],
        [one for one in surveyed if _streets(one.junction.name) >= _streets(name)],
        [
            one
            for one in surveyed
            if _streets(one.junction.name) >= _streets(name, _BETWEEN)
        ],
        [one for one in surveyed if wanted in one.junction.name.casefold()],
    ):
        if len(matches) == 1:
            return matches[0]
        if matches:
            raise InputError("junction", name, f"one of {_listed(matches)}")

    def closeness(one: Surveyed) -> float:
        return SequenceMatcher(None, wanted, one.junction.name.casefold()).ratio()

    nearest = sorted(surveyed, key=closeness, reverse=True)
    raise InputError("junction", name, f"one of {_listed(nearest)}")


def _streets(name: str, between: re.Pattern[str] = re.compile("/")) -> frozenset[str]:
    """Names of streets that meet, in any order and case, words shortened."""
    words, endings = _short_forms()
    streets = []
    for street in between.split(name):
        found = []
        for word in re.findall(r"[^\W_]+", street.casefold()):
            for long, short in endings.items():
                if word.endswith(long) and word != long:
                    word = word.removesuffix(long) + short
            found.append(words.get(word, word))
        streets.append(" ".join(found))
    return frozenset(streets)


@cache
def _short_forms() -> tuple[dict[str, str], dict[str, str]]:
    """Words of street names, and their endings, to how they are shortened."""
    table = load_data(__package__, "streets.toml")

    def short_of(key: str) -> dict[str, str]:
        """Short form of each long one."""
        found: dict[str, str] = {}
        for short, longs in table[key].items():
            for long in longs:
                found[long] = short
        return found

    return short_of("words"), short_of("endings")


def _listed(surveyed: Sequence[Surveyed]) -> str:
    """Ids and names of junctions, for a message."""
    # Names tell nothing apart.
    many = len({one.junction.name for one in surveyed}) < len(surveyed)
    words = []
    for one in surveyed[:_MAX_LISTED]:
        label = one.junction.name
        if many:
            if label:
                label += " at "
            label += ",".join(f"{value:.8g}" for value in one.position)
        word = one.junction.id
        if label:
            word = f"{word} ({label})"
        words.append(word)
    text = ", ".join(words)
    left = len(surveyed) - len(words)
    if left:
        text += f" and {left} more"
    return text


def _in_map(source: SourceMap, at: tuple[float, float]) -> FloatArray:
    """A point in the map's coordinates; infinite if it is nowhere on earth."""
    is_same = not source.crs or source.source_crs in ("", source.crs)
    if is_same:
        return np.array(at)
    return transform(np.array(at), source.source_crs, source.crs)


def _survey(
    source: SourceMap,
    junction: MapJunction,
    lanes: Sequence[MapLane],
) -> Surveyed:
    """A junction with its arms and the lanes that lead to it.

    Parameters
    ----------
    source : SourceMap
        The map.
    junction : MapJunction
        The junction.
    lanes : sequence of MapLane
        Lanes that name the junction.

    Returns
    -------
    surveyed : Surveyed
        Without the counts of signals and crossings.
    """
    position = junction.position_m
    middle = junction.position_m
    if source.crs and source.source_crs not in ("", source.crs):
        position = transform(position, source.crs, source.source_crs)
    # Near the origin, as build_junction's other users have it; nothing but the lanes
    # counts.
    near = []
    limits = load_limits()
    for lane in (lane for lane in lanes if lane.kind in CARRIAGEWAY_KINDS):
        whole_m = lane.centreline_m[:, :2] - middle
        is_near = (np.abs(whole_m) <= limits.coordinate_m).all(axis=1)
        line_m = whole_m[is_near][: limits.line_points]
        if len(line_m) < 2 or not is_lane_width(lane.width_m):
            continue
        near.append(
            Lane(id=lane.id, kind=lane.kind, width_m=lane.width_m, centreline_m=line_m)
        )
    scene = Scene(
        name=junction.id,
        **join_bodies([(Instance(id=GROUND, class_name=GROUND), *NOTHING)]),
        sites=(),
        outline_m=junction.outline_m - middle,
        lanes=tuple(near),
        crs="",
        keeps_left=source.keeps_left,
    )
    try:
        arms = build_junction(scene).arms
    except InputError:
        # No lane ends at the outline.
        arms = {}
    # Class of the road, and the number of lanes, of each arm.
    classes = {lane.id: lane.road_class for lane in lanes}
    lanes_of = [(*arm.entry_lanes, *arm.exit_lanes) for arm in arms.values()]
    roads: list[tuple[str, int]] = []
    for here in lanes_of:
        road_class = ""
        if here:
            road_class = classes[here[0].id]
        roads.append((road_class, len(here)))
    return Surveyed(
        junction=junction,
        arms=tuple(arms),
        n_lanes=sum(map(len, lanes_of)),
        roads=tuple(roads),
        n_driven=sum(bool(arm.entry_lanes) for arm in arms.values()),
        position=position,
    )


# ---------- reading maps
@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOptions:
    """Answers to questions that map files leave open.

    Attributes
    ----------
    unit : str or None
        Unit of meshes, see :func:`geometry.maps.mesh_files.read_mesh`.
    up : str or None
        Up axis of meshes.
    class_name : str
        Of meshes, point clouds and footprints that do not state theirs.
    keeps_left : bool or None
        Whether traffic keeps left; by default what the map says.
    staggered_m : float
        Side roads that meet a road of OpenStreetMap from either side, no
        farther apart than this, are one junction. [m]
    """

    unit: str | None = None
    up: str | None = None
    class_name: str = "building"
    keeps_left: bool | None = None
    staggered_m: float = 0.0


def read_map(
    path: Path,
    options: ReadingOptions | None = None,
    *,
    progress: Progress = silent,
) -> SourceMap:
    """Read a map file of any known format.

    Parameters
    ----------
    path : Path
        The suffix gives the format; .json, .gml and .xml are told apart by
        content, .zip is opened.
    options : ReadingOptions or None
        Answers to what the file leaves open.
    progress : Progress
        Called with what is being done, and how far it is.

    Returns
    -------
    source : SourceMap
        Content of the file.

    Raises
    ------
    InputError
        The file does not exist, is of no known format, or is damaged.
    """
    options = options or ReadingOptions()
    if not path.exists() or path.is_dir():
        got = "no such file"
        if path.is_dir():
            got = "a folder"
        refuse(str(path), got, "a map file")
    check_file(path)
    is_packed = path.suffix.lower() == ".zip"
    with (
        unpacked(path, MAP_SUFFIXES[:-1]) if is_packed else nullcontext(path) as inside
    ):
        return _read(inside, options, progress)


def _read(path: Path, options: ReadingOptions, progress: Progress) -> SourceMap:
    """Read a file; heavy modules are imported only when they are needed."""
    # The ending tells the format, or else the content.
    name = path.name.lower()
    kind = next((suffix for suffix in MAP_SUFFIXES if name.endswith(suffix)), "")
    if kind == ".json" and _is_city_json(path):
        kind = ".city.json"
    elif kind == ".json":
        kind = ".geojson"
    elif kind in (".xml", ".gml", ".citygml"):
        root = local_name(read_xml_root(path))
        if root not in _ROOTS:
            expected = "OpenDRIVE, OpenStreetMap, Lanelet2, CommonRoad or CityGML"
            refuse(str(path), f"<{root}>", expected)
        kind = _ROOTS[root]
    if kind == ".osm" and _has_lanelets(path):
        kind = "lanelets"
    if kind not in READERS:
        refuse(str(path), "another kind of file", ", ".join(MAP_SUFFIXES))
    # Hand over only the options that the reader takes.
    read: Callable[..., SourceMap] = load_entry(READERS[kind])
    given = {name: getattr(options, name, progress) for name in _ASKED.get(kind, ())}
    return read(path, **given)


def _is_city_json(path: Path) -> bool:
    """True if a JSON file is CityJSON.

    Its first bytes show it, or else its member ``type``.
    """
    with open_file(path) as file:
        head = file.read(4096)
    if b'"CityJSON"' in head or b'"FeatureCollection"' in head or b'"Feature"' in head:
        return b'"CityJSON"' in head
    try:
        document = parse_json(read_text(path, "JSON"), str(path), "a map")
    except InputError:
        # The reader of GeoJSON says what is wrong.
        return False
    return isinstance(document, dict) and document.get("type") == "CityJSON"


def _has_lanelets(path: Path) -> bool:
    """True if a file of OpenStreetMap's elements is a Lanelet2 map."""
    with open_file(path) as file:
        before = b""
        while chunk := file.read(1 << 20):
            if _LANELET.search(before + chunk):
                return True
            before = chunk[-100:]
    return False


_LANELET = re.compile(rb"""k=["']type["']\s+v=["']lanelet["']""")


# ---------- scenes
@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """Which part of the maps becomes the scene.

    Attributes
    ----------
    junction : str
        Name or id, see :func:`choose_junction`; empty: the first one.
    at : tuple[float, float] or None
        A point near the junction instead of its name.
    radius_m : float
        Radius around the middle of the junction within which things are kept.
        [m]
    sites : str
        Where sites come from, see :func:`geometry.maps.sites.choose_sites`.
    sites_crs : str
        Reference system of x and y in a list of sites that does not say; empty: see
        :func:`geometry.maps.site_crs.find_sites_crs`.
    terrain : Path, optional
        Raster with the heights of the ground, see
        :func:`geometry.maps.relief.read_elevation`; by default heights are those of
        the maps.
    name : str
        Name of the scene; empty: after the file and the junction.
    reading : ReadingOptions
        Answers to what the files leave open.
    """

    junction: str = ""
    at: tuple[float, float] | None = None
    radius_m: float = DEFAULT_RADIUS_M
    sites: str = "auto"
    sites_crs: str = ""
    terrain: Path | None = None
    name: str = ""
    reading: ReadingOptions = field(default_factory=ReadingOptions)

    def __post_init__(self) -> None:
        low, high = _RADIUS_LIMITS_M
        if not low <= self.radius_m <= high:
            raise InputError("radius_m", self.radius_m, f"metres, {low:g} to {high:g}")
        if self.junction and self.at is not None:
            refuse("at", "it beside `junction`", "one of them")
        check_crs(self.sites_crs, "sites_crs")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImportedScene:
    """Scene and how it was made.

    Attributes
    ----------
    scene : Scene
        The part that was cut out.
    junctions : tuple of Surveyed
        All junctions of the map, the largest first.
    chosen : Surveyed
        The junction of the scene.
    sources : tuple of str
        Names of the files.
    """

    scene: Scene
    junctions: tuple[Surveyed, ...]
    chosen: Surveyed
    sources: tuple[str, ...]


def read_maps(
    paths: Sequence[Path],
    reading: ReadingOptions,
    *,
    progress: Progress = silent,
) -> tuple[list[SourceMap], tuple[Surveyed, ...]]:
    """Read map files and list the junctions of the one with roads.

    Parameters
    ----------
    paths : sequence of Path
        Exactly one has roads; the others have buildings and more.
    reading : ReadingOptions
        Answers to what the files leave open.
    progress : Progress
        Called with what is being done, and how far it is.

    Returns
    -------
    maps : list of SourceMap
        The map with the roads first, then the others in the given order.
    junctions : tuple of Surveyed
        See :func:`survey_junctions`.

    Raises
    ------
    InputError
        A file cannot be read, or none or several have roads.
    """
    if not paths:
        refuse("FILE", "nothing", "a map: OpenDRIVE or OpenStreetMap")
    maps = [read_map(path, reading, progress=progress) for path in paths]
    # Exactly one file must have roads.
    with_roads = [source for source in maps if source.lanes]
    if len(with_roads) != 1:
        names = " and ".join(source.name for source in with_roads) or "none"
        where = ", ".join(source.name for source in maps)
        refuse(where, f"roads in {names}", "roads in one of the files")
    roads = with_roads[0]
    check_maps_lie_here(maps)
    progress(Phrase("find junctions"), 0, 0)
    return [roads, *(s for s in maps if s is not roads)], survey_junctions(roads)


def import_scene(
    paths: Sequence[Path],
    options: ImportOptions,
    *,
    progress: Progress = silent,
) -> ImportedScene:
    """Make a scene from map files.

    Parameters
    ----------
    paths : sequence of Path
        See :func:`read_maps`.
    options : ImportOptions
        Which junction, how far around it, and which sites.
    progress : Progress
        Called with what is being done, and how far it is.

    Returns
    -------
    imported : ImportedScene
        At least one arm leads into its junction, and it has at least one site.

    Raises
    ------
    InputError
        A file cannot be read, there is no such junction, no lane leads into it,
        or there is no place for a sensor.
    """
    maps, junctions = read_maps(paths, options.reading, progress=progress)
    chosen = choose_junction(maps[0], junctions, name=options.junction, at=options.at)
    imported = cut_scene(maps, chosen, options, progress=progress)
    if len(junctions) > 1 and not options.junction and options.at is None:
        what = Phrase(
            "{n} other junctions of {name}", n=len(junctions) - 1, name=maps[0].name
        )
        why = Phrase("none was named: the one with the most arms and lanes was taken")
        notes = (Note(what, why, kind="junction"), *imported.scene.notes)
        imported = replace(imported, scene=replace(imported.scene, notes=notes))
    return replace(imported, junctions=junctions)


def load_map_scene(
    path: Path,
    *,
    junction: str,
    at: tuple[float, float] | None,
    sites: str,
    sites_crs: str,
    keeps_left: bool | None,
) -> Scene:
    """Scene of one junction of a map, as a :class:`geometry.scene_sources.SceneReader`.

    Parameters
    ----------
    path : Path
        The map.
    junction, at, sites, sites_crs, keeps_left
        As :func:`geometry.scene_sources.load_scene` takes them.

    Returns
    -------
    scene : Scene
        The junction with its surroundings.

    Raises
    ------
    InputError
        As :func:`import_scene`.
    """
    reading = ReadingOptions(keeps_left=keeps_left)
    options = ImportOptions(
        junction=junction, at=at, sites=sites, sites_crs=sites_crs, reading=reading
    )
    return import_scene([path], options).scene


def cut_scene(
    maps: Sequence[SourceMap],
    chosen: Surveyed,
    options: ImportOptions,
    *,
    progress: Progress = silent,
) -> ImportedScene:
    """Make a scene of one junction of maps that are read already.

    Parameters
    ----------
    maps : sequence of SourceMap
        Maps, the one with the roads first.
    chosen : Surveyed
        A junction of the first map.
    options : ImportOptions
        How far around it, and which sites.
    progress : Progress
        Called with what is being done, and how far it is.

    Returns
    -------
    imported : ImportedScene
        Of the junctions of the map, it knows the chosen one.

    Raises
    ------
    InputError
        No lane leads into the junction, or there is no place for a sensor.
    """
    roads = maps[0]
    junction = chosen.junction
    where = f"{roads.name}: junction {junction.id}"
    if junction.fault:
        refuse(where, junction.fault, "a junction that cars can be led through")
    if not chosen.n_driven:
        refuse(where, "no lane that leads into it", "a junction that cars drive into")
    names = tuple(source.name for source in maps)
    radius_m = options.radius_m
    if options.terrain is not None:
        progress(Phrase("read terrain"), 0, 0)
        half_m = radius_m + LANES_BEYOND_M
        middle_m = junction.position_m
        terrain = read_elevation(
            options.terrain,
            crs=roads.crs,
            middle_m=middle_m,
            half_m=half_m,
        )
        # Before others: its heights count.
        maps = [roads, terrain, *maps[1:]]
    progress(Phrase("cut the junction out"), 0, 0)
    surroundings = cut_out(maps, junction, radius_m=radius_m)
    progress(Phrase("find sites"), 0, 0)
    surroundings, settled = settle_poles(surroundings)
    sites, site_notes = choose_sites(
        options.sites,
        surroundings,
        roads,
        radius_m=radius_m,
        sites_crs=options.sites_crs,
    )
    source_crs = ""
    if roads.crs:
        source_crs = roads.source_crs or roads.crs
    scene = build_scene(
        surroundings,
        name=options.name or f"{Path(roads.name).stem}/{junction.id}",
        source_crs=source_crs,
        sites=sites,
        radius_m=radius_m,
    )
    notes = (
        *surroundings.skipped,
        *settled,
        *site_notes,
        *(
            Note(Phrase("arm {name}", name=Phrase(name)), why, kind="roads")
            for name, why in arms_that_end(scene)
        ),
        *_site_notes(surroundings.poles, sites, options.sites),
        *_building_notes(surroundings.things, radius_m),
    )
    scene = replace(scene, notes=notes)
    return ImportedScene(scene=scene, junctions=(chosen,), chosen=chosen, sources=names)


def _site_notes(
    poles: Sequence[Pole],
    sites: Sequence[Site],
    where: str,
) -> Iterator[Note]:
    """Notes on sites whose poles are assumed."""
    known = {site.id for site in sites}
    same: dict[tuple[str, str], list[str]] = defaultdict(list)
    for pole in poles:
        if pole.assumed and pole.id in known:
            same[pole.kind, pole.assumed].append(pole.id)
    for (kind, why), ids in same.items():
        what = Phrase("{n} x {kind}", n=len(ids), kind=Phrase(kind))
        if len(ids) == 1:
            what = Phrase("{kind} {name}", kind=Phrase(kind), name=ids[0])
        yield Note(what, why, kind="sites", site_ids=tuple(ids))
    # Masts at the kerb are assumed, unless a list asked for them.
    masts = tuple(site.id for site in sites if site.kind == "kerb")
    if masts and Path(where).suffix.lower() not in LISTS:
        what = Phrase("{n} sites at the kerb", n=len(masts))
        why = Phrase("no mast stands there in the map: each is assumed")
        yield Note(what, why, kind="sites", site_ids=masts)


def _building_notes(things: Sequence[Thing], radius_m: float) -> Iterator[Note]:
    """Notes on missing buildings, and on heights that are assumed."""
    every = Counter(thing.class_name for thing in things)
    if not every["building"]:
        why = Phrase(
            "the map has none within {radius:g} m: none is assumed to hide anybody",
            radius=radius_m,
        )
        yield Note(Phrase("buildings"), why, kind="buildings")
    assumed = Counter(thing.class_name for thing in things if thing.is_height_assumed)
    for class_name, number in assumed.most_common():
        what = Phrase(
            "heights of {n} of {all} x {kind}",
            n=number,
            all=every[class_name],
            kind=Phrase(class_name),
        )
        why = Phrase("not in the map: the usual ones of their kinds are assumed")
        yield Note(what, why, kind="heights")
