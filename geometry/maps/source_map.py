"""Content of a map file in any format: lanes, junctions, things, poles.

Also here are the meshes of things, their kinds, and numbers as people write
them.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, Literal

import mapbox_earcut
import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import Polygon, make_valid
from shapely.geometry.base import BaseGeometry

from ..arrays import FloatArray, float_array, freeze, set_arrays
from ..errors import InputError, check_one_of, clean_name, refuse
from ..notes import Note
from ..scene import LeadingRoad, Mesh, RoadUser, Turn, checked_islands, join
from ..tables import pick
from ..text_formats import load_data

# Outer ring, then holes; (n, 3) each.
Polygon3D = Sequence[FloatArray]
# Corners closer than this are one.
_SAME_M = 1e-3
# Of a polygon in space.
_MIN_AREA_M2 = 1e-6
_MIN_FOOTPRINT_M2 = 0.01
NOTHING = (np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
LANE_KINDS = ("driving", "bus", "parking", "cycling", "walking")
POLE_KINDS = ("lamp post", "traffic light", "sign", "pole")
Heights = Literal["above ground", "absolute"]
# Of the things of a file.
MAX_TRIANGLES = 5_000_000
# Characters.
_MAX_ID = 120
# Entries.
_MAX_SKIPPED = 100
# Characters of a name that are looked at.
_MAX_NAME = 200
# That are read as one.
_MAX_WORDS = 3
_WORD = re.compile(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+(?![a-zäöüß])")
# Collections within collections.
_MAX_NESTED = 50
# Of a pole's cylinder.
_SECTIONS = 10
_NUMBER = r"([0-9]{1,7}(?:[.,][0-9]{1,9})?)"
_LENGTH = re.compile(rf"{_NUMBER}\s*([a-z]*|'|\")\.?")
_FEET_AND_INCHES = re.compile(
    rf"([0-9]{{1,6}})\s*(?:'|ft|feet)\s*{_NUMBER}\s*(?:\"|''|in|inches)?"
)
_RANGE = re.compile(rf"{_NUMBER}\s*(?:-|\.\.|;|to)\s*{_NUMBER}\s*([a-z]*)")
_SPEED = re.compile(r"([0-9]{1,3}(?:[.,][0-9]{1,9})?)\s*([a-z/]*)")
_UNITS = load_data("geometry.maps", "words.toml")
UNITS_M: dict[str, float] = _UNITS["units_m"]
MIN_POLE_M = 2.5
"""A lower pole is a bollard: sensors on it could be reached from the pavement."""


def triangulate(rings_m: Polygon3D) -> Mesh:
    """Triangles of a flat polygon in space.

    The polygon is projected onto the plane across Newell's normal, cut by ear
    clipping there, and keeps its own corners, so that a polygon that is not
    quite flat still meets its neighbours.

    Parameters
    ----------
    rings_m : sequence of (n, 3) float
        Outer ring, then holes, open or closed. The outer ring runs
        counter-clockwise seen from the polygon's front; holes run in either
        direction. [m]

    Returns
    -------
    vertices_m : (k, 3) float
        Corners without repetitions; none if the polygon has no area. [m]
    triangles : (m, 3) int32
        They face as the polygon does.

    References
    ----------
    .. [1] I. E. Sutherland, R. F. Sproull, R. A. Schumacker, "A characterization
       of ten hidden-surface algorithms", 1974: Newell's normal, the sum of the
       cross products of neighbouring corners.
    """
    open_rings = [_without_repeats(ring) for ring in rings_m]
    rings = [ring for ring in open_rings if len(ring) >= 3]
    if not rings or len(open_rings[0]) < 3:
        return NOTHING
    vertices: FloatArray = np.concatenate(rings)
    middle = vertices.mean(axis=0)
    outer = rings[0] - middle
    # Newell's normal of the outer ring.
    products = outer.T @ outer[[*range(1, len(outer)), 0]]
    normal = np.array(
        [products[at] - products[at[::-1]] for at in ((1, 2), (2, 0), (0, 1))]
    )
    length = float(np.sqrt(normal @ normal))
    if not length > 2.0 * _MIN_AREA_M2:
        return NOTHING
    normal /= length
    if len(vertices) == 3:
        return vertices, np.array([[0, 1, 2]], dtype=np.int32)
    # To the normal: the axis least like it, less what lies along the normal.
    across = np.zeros(3)
    across[np.argmin(np.abs(normal))] = 1.0
    across -= (across @ normal) * normal
    across /= np.sqrt(across @ across)
    (a_x, a_y, a_z) = across
    (n_x, n_y, n_z) = normal
    onwards = (n_y * a_z - n_z * a_y, n_z * a_x - n_x * a_z, n_x * a_y - n_y * a_x)
    flat = (vertices - middle) @ np.array([across, onwards]).T
    return vertices, clip_ears(flat, np.cumsum([len(ring) for ring in rings]))


def clip_ears(flat_m: FloatArray, ends: ArrayLike) -> NDArray[np.int32]:
    """Triangles of rings in a plane, counter-clockwise, (m, 3).

    Parameters
    ----------
    flat_m : (n, 2) float
        Corners of the outer ring, then of the holes. [m]
    ends : (k,) int
        Index after the last corner of each ring.

    Returns
    -------
    triangles : (m, 3) int32
        Indices of corners.
    """
    corners = np.asarray(ends, dtype=np.uint32)
    found = mapbox_earcut.triangulate_float64(flat_m, corners)
    triangles: NDArray[np.int32] = np.asarray(found, dtype=np.int32).reshape(-1, 3)
    a, b, c = np.moveaxis(flat_m[triangles], 1, 0)
    ab = b - a
    ac = c - a
    turns_right = ab[:, 0] * ac[:, 1] < ab[:, 1] * ac[:, 0]
    triangles[turns_right] = triangles[turns_right, ::-1]
    return triangles


def surface_mesh(polygons: Sequence[Polygon3D]) -> Mesh:
    """One mesh of many polygons with shared corners.

    Vertices closer than about a millimetre along every axis are merged. A
    closed mesh faces outwards.

    Parameters
    ----------
    polygons : sequence of Polygon3D
        Outer ring and holes of each.

    Returns
    -------
    mesh : Mesh
        Empty if no polygon has an area.
    """
    # Triangles of every polygon that has an area.
    pieces = [triangulate(rings) for rings in polygons]
    pieces = [piece for piece in pieces if len(piece[1])]
    if not pieces:
        return NOTHING
    corners, triangles = join(pieces)
    rounded = np.round(corners / _SAME_M).astype(np.int64)
    _, taken, merged = np.unique(
        rounded,
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    vertices = corners[taken]
    triangles = merged.reshape(-1)[triangles].astype(np.int32)
    has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[has_area]
    if is_closed(triangles) and volume_m3(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return vertices, np.ascontiguousarray(triangles)


def is_closed(triangles: NDArray[np.int32]) -> bool:
    """True if every edge is used as often in one direction as in the other."""
    edges = np.concatenate(
        [triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]
    )
    n_vertices = 0
    if len(triangles):
        n_vertices = int(triangles.max()) + 1
    # One number for each directed edge, sorted in both directions.
    forth = np.sort(edges[:, 0].astype(np.int64) * n_vertices + edges[:, 1])
    back = np.sort(edges[:, 1].astype(np.int64) * n_vertices + edges[:, 0])
    return bool(len(triangles)) and bool((forth == back).all())


def volume_m3(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> float:
    """Volume inside a closed mesh; negative if it faces inwards."""
    if not len(triangles):
        return 0.0
    a, b, c = np.swapaxes(vertices_m[triangles] - vertices_m[triangles[0, 0]], 0, 1)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _without_repeats(ring: FloatArray) -> FloatArray:
    """An open ring without corners that repeat the one before."""
    points = np.asarray(ring, dtype=np.float64).reshape(-1, 3)
    if not len(points):
        return points
    before = points[[-1, *range(len(points) - 1)]]
    is_new = (points != before).any(axis=1)
    return np.asarray(points[is_new])


def extrude(
    outer_m: ArrayLike,
    *,
    bottom_m: float,
    top_m: float,
    holes_m: Sequence[ArrayLike] = (),
    where: str = "footprint",
) -> Mesh:
    """Closed solid over a footprint: an outline and holes.

    Outlines that cross themselves are mended first.

    Parameters
    ----------
    outer_m : (n, 2) float
        Outline, open or closed, in either direction. [m]
    bottom_m : float
        Height of the floor. [m]
    top_m : float
        Height of the roof. [m]
    holes_m : sequence of (k, 2) float
        Outlines of holes. [m]
    where : str
        File and element at hand, for messages.

    Returns
    -------
    vertices_m : (k, 3) float
        Corners of floor and roof. [m]
    triangles : (m, 3) int32
        Counter-clockwise seen from outside.

    Raises
    ------
    InputError
        No area is left, or the roof is not above the floor.
    """
    outer = float_array(outer_m, (-1, 2), where)
    if len(np.unique(outer, axis=0)) < 3:
        refuse(where, f"{len(outer)} points", "at least three different points")
    polygon = Polygon(outer, [float_array(hole, (-1, 2), where) for hole in holes_m])
    return extrude_polygon(polygon, bottom_m=bottom_m, top_m=top_m, where=where)


def extrude_polygon(
    polygon: Polygon,
    *,
    bottom_m: float,
    top_m: float,
    where: str = "footprint",
) -> Mesh:
    """Closed solid over a polygon with its holes.

    A polygon that crosses itself is mended first.

    Parameters
    ----------
    polygon : Polygon
        Footprint. [m]
    bottom_m : float
        Height of the floor. [m]
    top_m : float
        Height of the roof. [m]
    where : str
        File and element at hand, for messages.

    Returns
    -------
    vertices_m : (k, 3) float
        Corners of floor and roof. [m]
    triangles : (m, 3) int32
        Counter-clockwise seen from outside.

    Raises
    ------
    InputError
        No area is left, or the roof is not above the floor.
    """
    import trimesh

    if not top_m > bottom_m:
        raise InputError(f"{where}: height", top_m - bottom_m, "metres, > 0")
    parts = polygons_of(make_valid(polygon), above_m2=_MIN_FOOTPRINT_M2)
    if not parts:
        refuse(where, "an outline without area", "a footprint")
    extruded = trimesh.creation.extrude_polygon
    solids = [extruded(part, top_m - bottom_m, engine="earcut") for part in parts]
    vertices, triangles = join([(solid.vertices, solid.faces) for solid in solids])
    return vertices + [0.0, 0.0, bottom_m], triangles


def parts_of(shape: BaseGeometry, depth: int = 0) -> list[BaseGeometry]:
    """Points, lines and polygons of a geometry, or of collections of such."""
    pieces = getattr(shape, "geoms", None)
    if pieces is None or depth > _MAX_NESTED:
        return [shape]
    return [part for piece in pieces for part in parts_of(piece, depth + 1)]


def polygons_of(shape: BaseGeometry, *, above_m2: float = 0.0) -> list[Polygon]:
    """Polygons of a geometry that have more than an area.

    Parameters
    ----------
    shape : BaseGeometry
        A geometry, or a collection of such.
    above_m2 : float
        Area that a polygon must exceed. [m^2]

    Returns
    -------
    polygons : list of Polygon
        In the order of the geometry.
    """
    return [
        p for p in parts_of(shape) if p.geom_type == "Polygon" and p.area > above_m2
    ]


@cache
def unit_ball() -> Mesh:
    """A ball of radius 1 from 80 triangles, for the crowns of trees."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices, dtype=np.float64), np.asarray(
        ball.faces,
        dtype=np.int32,
    )


@cache
def unit_cylinder(n_sides: int) -> Mesh:
    """An upright prism of radius and height 1 on the origin, for trunks."""
    import trimesh

    segment = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    prism = trimesh.creation.cylinder(radius=1.0, segment=segment, sections=n_sides)
    return np.asarray(prism.vertices, dtype=np.float64), np.asarray(
        prism.faces,
        dtype=np.int32,
    )


# ---------- content of a map file
def _clean_names(value: object, *fields: str) -> None:
    """Replace names of a frozen value by what is seen of them.

    No user can mend a map's own names.
    """
    for name in fields:
        object.__setattr__(value, name, clean_name(getattr(value, name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapLane:
    """Lane between two junctions, or from one to where it ends.

    Attributes
    ----------
    id : str
        From the source; unique in the map.
    kind : str
        One of ``LANE_KINDS``.
    width_m : float
        Mean full width; of a lane that leads to a junction along the last 30 m.
        [m]
    centreline_m : (n, 3) float
        In driving direction, or that of the next driving lane. [m]
    from_junction : str
        Id of the junction at whose outline it begins; empty: none.
    to_junction : str
        Id of the junction at its end; empty: none.
    speed_limit_kmh : float or None
        Where it leads into a junction, or else out of one. [km/h]
    turns : tuple of Turn
        By its markings, see :class:`geometry.scene.Lane`.
    road_class : str
        There, as OpenStreetMap calls it ("primary"); empty: not known.
    closed_to : tuple of RoadUser
        There, see :class:`geometry.scene.Lane`.
    """

    id: str
    kind: str
    width_m: float
    centreline_m: FloatArray
    from_junction: str = ""
    to_junction: str = ""
    speed_limit_kmh: float | None = None
    turns: tuple[Turn, ...] = ()
    road_class: str = ""
    closed_to: tuple[RoadUser, ...] = ()

    def __post_init__(self) -> None:
        _clean_names(self, "id", "from_junction", "to_junction")
        where = f"lane {self.id}"
        check_one_of(f"{where}.kind", self.kind, LANE_KINDS)
        if not (np.isfinite(self.width_m) and self.width_m > 0.0):
            raise InputError(f"{where}.width_m", self.width_m, "metres, > 0")
        set_arrays(self, f"{where}.", centreline_m=(-1, 3))
        if len(self.centreline_m) < 2:
            raise InputError(
                f"{where}.centreline_m",
                len(self.centreline_m),
                "at least two points",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapJunction:
    """A junction of roads.

    Attributes
    ----------
    id : str
        From the source; unique in the map.
    name : str
        For people, such as the streets that meet; may be empty.
    outline_m : (n, 2) float
        Outline of its road surface, where the lanes of its arms begin and end. [m]
    height_m : float
        Height of the road in its middle, as the map counts heights. [m]
    roads : tuple of LeadingRoad
        Roads that lead to it, as the map's network has them: what its arms are compared
        with.
    islands_m : tuple of (n, 2) float
        Outlines of the islands that a roundabout leads around. [m]
    fault : str
        Why cars cannot be led through it, in words; empty: they can.
    """

    id: str
    name: str
    outline_m: FloatArray
    height_m: float = 0.0
    roads: tuple[LeadingRoad, ...] = ()
    islands_m: tuple[FloatArray, ...] = ()
    fault: str = ""

    def __post_init__(self) -> None:
        _clean_names(self, "id", "name")
        where = f"junction {self.id}."
        set_arrays(self, where, outline_m=(-1, 2))
        if len(self.outline_m) < 3:
            raise InputError(
                f"{where}outline_m",
                len(self.outline_m),
                "at least three points",
            )
        islands = checked_islands(self.islands_m, f"{where}islands_m")
        object.__setattr__(self, "islands_m", islands)

    @property
    def position_m(self) -> FloatArray:
        """Its middle, (2,): that of the box around the outline."""
        return np.asarray(
            0.5 * (self.outline_m.min(axis=0) + self.outline_m.max(axis=0))
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A solid object.

    Attributes
    ----------
    id : str
        From the source; unique in the map.
    class_name : str
        One of :data:`geometry.scene.CLASS_NAMES`.
    vertices_m : (n, 3) float
        Heights as the map counts them. [m]
    triangles : (m, 3) int32
        Vertex indices, counter-clockwise seen from outside.
    is_height_assumed : bool
        The source does not give its height.
    """

    id: str
    class_name: str
    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    is_height_assumed: bool = False

    def __post_init__(self) -> None:
        _clean_names(self, "id")
        where = f"{self.class_name} {self.id}"
        set_arrays(self, f"{where}.", vertices_m=(-1, 3))
        n_vertices = len(self.vertices_m)
        triangles = freeze(np.array(self.triangles, dtype=np.int32).reshape(-1, 3))
        if len(triangles) and not (
            triangles.min() >= 0 and triangles.max() < n_vertices
        ):
            expected = f"indices below {n_vertices}"
            raise InputError(f"{where}.triangles", int(triangles.max()), expected)
        object.__setattr__(self, "triangles", triangles)

    @classmethod
    def of(
        cls,
        thing_id: str,
        class_name: str,
        mesh: Mesh,
        *,
        is_height_assumed: bool = False,
    ) -> "Thing":
        """Thing with the vertices and triangles of a mesh."""
        fields: dict[str, Any] = {"vertices_m": mesh[0], "triangles": mesh[1]}
        return cls(
            id=thing_id,
            class_name=class_name,
            is_height_assumed=is_height_assumed,
            **fields,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pole:
    """Pole that could carry sensors.

    Attributes
    ----------
    id : str
        From the source; unique in the map.
    kind : str
        One of ``POLE_KINDS``.
    position_m : (3,) float
        Position of its foot. [m]
    height_m : float or None
        Height of its top above its foot, if the source gives it. [m]
    assumed : str
        Why its position is not that of the source, in words; empty: it is.
    """

    id: str
    kind: str
    position_m: FloatArray
    height_m: float | None = None
    assumed: str = ""

    def __post_init__(self) -> None:
        _clean_names(self, "id")
        check_one_of(f"pole {self.id}.kind", self.kind, POLE_KINDS)
        set_arrays(self, f"pole {self.id}.", position_m=(3,))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapPath:
    """Way beside the lanes on which nothing may stand, such as a footway.

    Attributes
    ----------
    id : str
        From the source; unique in the map.
    line_m : (n, 2) float
        Its middle. [m]
    width_m : float
        Full width. [m]
    """

    id: str
    line_m: FloatArray
    width_m: float

    def __post_init__(self) -> None:
        _clean_names(self, "id")
        set_arrays(self, f"path {self.id}.", line_m=(-1, 2))


@dataclass(frozen=True, slots=True)
class Omissions:
    """Names of parts of a file that are left out, by kind and reason.

    Attributes
    ----------
    found : dict[tuple[str, str], list[str]]
        Names, by kind and reason.
    """

    found: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str, why: str) -> None:
        """Note that a thing was left out, or changed.

        Repetitions in a row count once.

        Parameters
        ----------
        kind : str
            Kind of the thing in the plural, "signals of other kinds".
        name : str
            Thing at hand, "road 5 signal 12".
        why : str
            Reason.
        """
        names = self.found.setdefault((kind, why), [])
        if name not in names[-1:]:
            names.append(name)

    def listed(self) -> tuple[Note, ...]:
        """One entry per kind and reason; of many, the first."""
        entries = []
        for (kind, why), names in self.found.items():
            what = names[0]
            if len(names) > 1:
                what = f"{len(names)} {kind}, such as {' and '.join(names[:2])}"
            entries.append(Note(what, why))
        return shortened(entries)


def plain_id(name: str) -> str:
    """A name without characters that separate ids on a command line."""
    return "-".join(name.replace(",", " ").replace("/", " ").split())


def unique_id(wanted: str, taken: Counter[str]) -> str:
    """The wanted id, with a number if it is taken; `taken` then contains it."""
    wanted = wanted[:_MAX_ID] or "unnamed"
    candidate = wanted
    while candidate in taken:
        taken[wanted] += 1
        candidate = f"{wanted}-{taken[wanted]}"
    taken[candidate] += 1
    return candidate


def shortened(skipped: Sequence[Note]) -> tuple[Note, ...]:
    """The first of many entries, and one that counts the rest."""
    if len(skipped) <= _MAX_SKIPPED:
        return tuple(skipped)
    more = Note(f"{len(skipped) - _MAX_SKIPPED} more", "for reasons like these")
    return (*skipped[:_MAX_SKIPPED], more)


def counted(counts: Counter[str], why: str) -> list[Note]:
    """One entry per kind of thing: "3 Bridge"."""
    return [Note(f"{n} {kind}", why) for kind, n in sorted(counts.items())]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SourceMap:
    """The content of one map file.

    Attributes
    ----------
    name : str
        Name of the file.
    crs : str
        Projected coordinate reference system of all coordinates here, in metres, for
        pyproj; empty: the file does not say where on earth it lies.
    source_crs : str
        The one that the file itself uses, such as "EPSG:4326".
    heights : {"above ground", "absolute"}
        Zero of the z axis.
    lanes, junctions, things, poles, paths : tuple
        The objects of the map.
    connections : tuple of MapLane
        Lanes through junctions, each from the end of a lane to the begin of another;
        both their junctions are the one through which they lead. None: the map does not
        have them.
    crosswalks_m : (n, 2, 2) float
        Lines on which pedestrians cross, from end to end. [m]
    ground_m : (n, 3) float
        Points of the ground: of roads' surfaces, nodes with a height, a scan's ground.
        Their heights are absolute, whatever those of things are. [m]
    keeps_left : bool
        Traffic keeps left.
    skipped : tuple of Skipped
        What was left out, and why.
    """

    name: str
    crs: str
    source_crs: str = ""
    heights: Heights = "above ground"
    lanes: tuple[MapLane, ...] = ()
    connections: tuple[MapLane, ...] = ()
    junctions: tuple[MapJunction, ...] = ()
    things: tuple[Thing, ...] = ()
    poles: tuple[Pole, ...] = ()
    paths: tuple[MapPath, ...] = ()
    crosswalks_m: FloatArray = field(default_factory=lambda: np.empty((0, 2, 2)))
    ground_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    keeps_left: bool = False
    skipped: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        set_arrays(self, f"{self.name}: ", ground_m=(-1, 3), crosswalks_m=(-1, 2, 2))

    def __repr__(self) -> str:
        return (
            f"SourceMap({self.name!r}, {len(self.lanes)} lanes,"
            f" {len(self.junctions)} junctions, {len(self.things)} things,"
            f" {len(self.poles)} poles)"
        )


# ---------- kinds of things and poles
@dataclass(frozen=True, slots=True, kw_only=True)
class ThingKind:
    """Kind of thing.

    Attributes
    ----------
    kind : str
        Name of the kind.
    class_name : str
        One of geometry.scene.CLASS_NAMES.
    words : tuple of str
        In names of such things, in lower case; see :func:`has_word`.
    height_m : float
        Height that is assumed where nothing is stated. [m]
    thickness_m : float
        Thickness that is assumed where nothing is stated. [m]
    """

    kind: str
    class_name: str
    words: tuple[str, ...]
    height_m: float
    thickness_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ThingDefaults:
    """Content of ``data/things.toml``.

    Attributes
    ----------
    storey_height_m : float
        Height of a storey. [m]
    max_height_m : float
        Larger values are not taken for heights. [m]
    max_storeys : int
        Larger values are not taken for numbers of storeys.
    kinds : tuple of ThingKind
        In the order in which names are searched for their words.
    """

    storey_height_m: float
    max_height_m: float
    max_storeys: int
    kinds: tuple[ThingKind, ...]


@cache
def thing_defaults() -> ThingDefaults:
    """Read ``data/things.toml``."""
    return msgspec.convert(load_data(__package__, "things.toml"), ThingDefaults)


def kind_from_name(name: str) -> ThingKind | None:
    """First kind in ``data/things.toml`` that a name has a word of, or None.

    >>> kind_from_name("StreetLamp.003").class_name
    'lamp post'
    >>> kind_from_name("Wallace") is None
    True
    """
    kinds = thing_defaults().kinds
    return next((kind for kind in kinds if has_word((name,), kind.words)), None)


def words_of(name: str) -> list[str]:
    """Words of a name in lower case: "streetLamp_3" has street and lamp."""
    return [word.lower() for word in _WORD.findall(name[:_MAX_NAME])]


def has_word(names: Iterable[str], wanted: Collection[str]) -> bool:
    """True if a name has a word of the list, or words that together are one."""
    return any(phrase in wanted for name in names for phrase in _phrases(name))


@lru_cache(maxsize=4096)
def _phrases(name: str) -> frozenset[str]:
    """Words of a name, and up to three in a row as one, without plural s."""
    found = words_of(name)
    return frozenset(
        "".join(found[begin:end]).removesuffix(plural)
        for begin in range(len(found))
        for end in range(begin + 1, min(begin + _MAX_WORDS, len(found)) + 1)
        for plural in ("", "s")
    )


def kind_of_class(class_name: str) -> ThingKind:
    """The defaults of a class: its last kind in ``data/things.toml``."""
    known = {kind.class_name: kind for kind in thing_defaults().kinds}
    return pick(known, class_name, "class_name")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoleKind:
    """Kind of pole, for poles of which the map gives no more.

    Attributes
    ----------
    kind : str
        One of ``POLE_KINDS``.
    height_m : float
        Height of its top. [m]
    radius_m : float
        Radius of its cylinder. [m]
    height_range_m : tuple[float, float]
        Lowest and highest mount above the road. [m]
    capacity_units : int
        Sensors that it can carry.
    """

    kind: str
    height_m: float
    radius_m: float
    height_range_m: tuple[float, float]
    capacity_units: int


@cache
def load_pole_kinds() -> dict[str, PoleKind]:
    """All kinds of poles by name, from ``data/sites.toml``."""
    table = load_data(__package__, "sites.toml")
    return {one.kind: one for one in msgspec.convert(table["kinds"], list[PoleKind])}


def build_pole_body(pole: Pole) -> tuple[str, Mesh]:
    """Class and mesh of a pole that stands on the road plane."""
    import trimesh

    kind = load_pole_kinds()[pole.kind]
    height_m = pole.height_m or kind.height_m
    foot = np.append(pole.position_m[:2], 0.0)
    ends = [foot, foot + [0.0, 0.0, height_m]]
    body = trimesh.creation.cylinder(
        radius=kind.radius_m,
        segment=ends,
        sections=_SECTIONS,
    )
    mesh = (np.asarray(body.vertices), np.asarray(body.faces, dtype=np.int32))
    if pole.kind == "traffic light":
        return "traffic light", mesh
    return "lamp post", mesh


def mount_range_m(pole: Pole) -> tuple[float, float]:
    """Lowest and highest mount on a pole in metres.

    A low pole carries sensors at its top.
    """
    low, high = load_pole_kinds()[pole.kind].height_range_m
    if pole.height_m is None:
        return low, high
    top = min(max(high, low), max(pole.height_m, 1.0))
    return min(low, top), top


# ---------- numbers as people write them
def parse_length_m(text: str) -> float | None:
    r"""Length as people write it, in metres, or None.

    There may be decimal commas, units or ranges, of which the middle counts.

    >>> [parse_length_m(text) for text in ("3,5", "12 ft", "3-4 m", "wide")]
    [3.5, 3.6576000000000004, 3.5, None]
    >>> round(parse_length_m("6'7\""), 4)
    2.0066
    """
    text = text.strip().lower().removeprefix("~").strip()
    if match := _FEET_AND_INCHES.fullmatch(text):
        return _number(match[1]) * UNITS_M["ft"] + _number(match[2]) * UNITS_M["in"]
    match = _LENGTH.fullmatch(text) or _RANGE.fullmatch(text)
    if match is None:
        return None
    # One number, or the two of a range, and the unit.
    *texts, unit = match.groups()
    if unit not in UNITS_M:
        return None
    numbers = [_number(text) for text in texts]
    return sum(numbers) / len(numbers) * UNITS_M[unit]


def parse_speed_kmh(text: str) -> float | None:
    """Speed above 0 as people write it, in km/h, or None.

    Texts are such as "50", "50 km/h" or "30 mph".

    >>> [parse_speed_kmh(text) for text in ("50 km/h", "30 mph", "0", "fast")]
    [50.0, 48.28032, None, None]
    """
    match = _SPEED.fullmatch(text.strip().lower())
    if match is None:
        return None
    unit_kmh: float = _UNITS["units_kmh"].get(match[2], 0.0)
    return _number(match[1]) * unit_kmh or None


def _number(text: str) -> float:
    return float(text.replace(",", "."))
