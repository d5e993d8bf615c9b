"""A junction as it stands: triangles that hide things, and sites that carry sensors."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Annotated, Any, Literal

import numpy as np
import shapely
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from .arrays import FloatArray, Point2, Point3, Points2, float_array, freeze, set_arrays
from .errors import InputError, check_field, check_name, check_one_of, refuse
from .lines import length_m
from .notes import Note
from .sensors import load_limits

HANGING_KINDS = ("mast arm", "gantry", "bridge", "wire")
"""Kinds of sites that hang over the road; all others stand next to it."""
CLASS_NAMES = (
    "ground",
    "building",
    "wall",
    "vegetation",
    "parked vehicle",
    "lamp post",
    "traffic light",
)
Turn = Literal["left", "through", "right", "reverse"]
RoadUser = Literal["on foot", "bicycle", "motorcycle"]
"""Road users to which a map may close a road."""
_SOLID_CLASSES = ("building", "wall", "vegetation", "parked vehicle")
_MIN_AREA_M2 = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Site:
    """A place where sensors can be mounted.

    Attributes
    ----------
    id : str
        Name.
    position_m : (3,) float
        Foot of the pole, or the point of the road below the mount. World frame. [m]
    kind : str
        "lamp post", "traffic light" or "mast arm".
    height_range_m : (2,) float
        Lowest and highest mount above the road. [m]
    capacity_units : int
        How many units it can carry.
    cost_eur : float
        Of making it ready - power, network, bracket -, paid once if it carries
        anything. [EUR]
    use : {"free", "forced", "forbidden"}
        Whether it may carry units, must, or must not.
    surveyed_m : (2,) float or None
        Where it stands by its owner's survey, if that is inside a wall of the map and
        the site was moved out of it. [m]
    """

    id: str
    position_m: Point3
    kind: str
    height_range_m: Point2
    capacity_units: int
    cost_eur: float = 0.0
    use: str = "free"
    surveyed_m: Point2 | None = None

    def __post_init__(self) -> None:
        where = f"site {self.id}"
        check_name(self.id, f"{where}.id")
        check_name(self.kind, f"{where}.kind")
        check = partial(check_field, self, where)
        set_arrays(self, f"{where}.", position_m=(3,), height_range_m=(2,))
        _check_near(self.position_m, f"{where}.position_m")
        if self.surveyed_m is not None:
            set_arrays(self, f"{where}.", surveyed_m=(2,))
            _check_near(self.surveyed_m, f"{where}.surveyed_m")
        limits = load_limits()
        low, high = self.height_range_m.tolist()
        if not 0.0 < low <= high <= limits.coordinate_m:
            expected = "[low, high] in metres, 0 < low <= high"
            if low > 0.0 and high > limits.coordinate_m:
                expected += f" <= {limits.coordinate_m:,.0f}"
            raise InputError(f"{where}.height_range_m", [low, high], expected)
        capacity = self.capacity_units
        is_whole = isinstance(capacity, int) and not isinstance(capacity, bool)
        is_count = is_whole and 1 <= capacity <= limits.capacity_units
        check(
            "capacity_units",
            is_count,
            f"a whole number, 1 to {limits.capacity_units:,}",
        )
        cost_eur = float(float_array(self.cost_eur, (), f"{where}.cost_eur"))
        if not 0.0 <= cost_eur <= limits.price_eur:
            expected = f"euros, 0 to {limits.price_eur:,.0f}"
            raise InputError(f"{where}.cost_eur", cost_eur, expected)
        check_one_of(f"{where}.use", self.use, ("free", "forced", "forbidden"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """One thing of a scene.

    Its id is unique there; its class is one of ``CLASS_NAMES``.

    Attributes
    ----------
    id, class_name : str
        Its name, and its kind.
    is_height_assumed : bool
        The sources do not tell its height.
    """

    id: str
    class_name: str
    is_height_assumed: bool = False

    def __post_init__(self) -> None:
        check_name(self.id, f"instance {self.id}.id")
        check_one_of(f"instance {self.id}.class_name", self.class_name, CLASS_NAMES)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeadingRoad:
    """A road of the map that leads to a junction.

    It is counted without looking at the lines of its lanes.

    Attributes
    ----------
    name : str
        Of the street, or else the id that the map gives it.
    point_m : (2,) float
        Where it meets the junction's outline, or a little farther out. [m]
    direction : (2,) float
        Unit vector away from the junction.
    lanes_in, lanes_out : int
        Driving lanes into the junction and out of it, by the map's own words.
    """

    name: str
    point_m: Point2
    direction: Point2
    lanes_in: int
    lanes_out: int

    def __post_init__(self) -> None:
        check_name(self.name, f"road {self.name}.name")
        set_arrays(self, "", point_m=(2,), direction=(2,))


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class Scene:
    """Everything that stands still. World frame, metres.

    Attributes
    ----------
    name : str
        Name of the junction.
    vertices_m : (n_vertices, 3) float
        Corners of all triangles. [m]
    triangles : (n_triangles, 3) int32
        Vertex indices.
    triangle_instance : (n_triangles,) int32
        Index into `instances`.
    instances : tuple of Instance
        Things of the scene.
    sites : tuple of Site
        Where sensors can be mounted.
    outline_m : (n, 2) float
        Outline of the junction's road surface. [m]
    lanes : tuple of Lane
        Lanes of the junction's arms.
    crs : str
        Coordinate reference system of the world frame, for pyproj; empty:
        unknown.
    crosswalks_m : (n, 2, 2) float
        Lines on which pedestrians cross an arm, from end to end. [m]
    road_network : str
        OpenDRIVE file with the same roads in the same frame; empty: none.
    keeps_left : bool
        Traffic keeps left.
    source_crs : str
        Coordinate reference system of the map it was made from, for results;
        empty: `crs`.
    source_origin_m : (2,) float
        The world frame's origin in the coordinates of a map that names no place
        on earth. [m]
    zero_height_m : float or None
        Height of z = 0, such as above the sea; None: unknown. [m]
    notes : tuple of Note
        What was assumed or left out when it was made of maps.
    roads : tuple of LeadingRoad
        Roads that lead to the junction; empty: the map does not say.
    islands_m : tuple of (n, 2) float
        Outlines of the islands that a roundabout leads around; empty: the junction
        is none. [m]
    """

    name: str
    vertices_m: FloatArray
    triangles: NDArray[np.int32]
    triangle_instance: NDArray[np.int32]
    instances: tuple[Instance, ...]
    sites: tuple[Site, ...]
    outline_m: FloatArray
    lanes: "tuple[Lane, ...]"
    crs: str
    crosswalks_m: FloatArray = field(default_factory=lambda: np.empty((0, 2, 2)))
    road_network: str = ""
    keeps_left: bool = False
    source_crs: str = ""
    source_origin_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    zero_height_m: float | None = None
    notes: tuple[Note, ...] = ()
    roads: tuple[LeadingRoad, ...] = ()
    islands_m: tuple[FloatArray, ...] = ()

    def __post_init__(self) -> None:
        check_name(self.name, "scene: name")
        shapes = {
            "vertices_m": (-1, 3),
            "outline_m": (-1, 2),
            "crosswalks_m": (-1, 2, 2),
        }
        set_arrays(self, f"{self.name}: ", **shapes, source_origin_m=(2,))
        for name in shapes:
            _check_near(getattr(self, name), f"{self.name}: {name}")
        for road in self.roads:
            _check_near(road.point_m, f"{self.name}: road {road.name}.point_m")
        islands = checked_islands(self.islands_m, f"{self.name}: islands_m")
        object.__setattr__(self, "islands_m", islands)
        for index, island_m in enumerate(self.islands_m):
            _check_near(island_m, f"{self.name}: islands_m[{index}]")
        self._check_sizes()
        for name in ("triangles", "triangle_instance"):
            array = np.array(getattr(self, name), dtype=np.int32)
            object.__setattr__(self, name, freeze(array))
        n_triangles = len(self.triangles)
        for name, shape, limit in (
            ("triangles", (n_triangles, 3), len(self.vertices_m)),
            ("triangle_instance", (n_triangles,), len(self.instances)),
        ):
            array = getattr(self, name)
            where = f"{self.name}: {name}"
            if array.shape != shape:
                refuse(where, f"shape {array.shape}", f"shape {shape}")
            outside = array[(array < 0) | (array >= limit)]
            if len(outside):
                raise InputError(
                    where, int(outside[0]), f"indices from 0 to {limit - 1}"
                )
        # An id stands for one thing in results.
        for kind, ids in (
            ("site", [site.id for site in self.sites]),
            ("instance", [instance.id for instance in self.instances]),
        ):
            repeated = sorted(name for name, count in Counter(ids).items() if count > 1)
            if repeated:
                raise InputError(f"{self.name}: {kind}s", repeated[0], "every id once")

    def _check_sizes(self) -> None:
        """Raise InputError if there is more of something than any junction has."""
        limits = load_limits()
        for name, most in (
            ("outline_m", limits.line_points),
            ("crosswalks_m", limits.crosswalks),
            ("lanes", limits.lanes),
        ):
            _check_count(len(getattr(self, name)), most, f"{self.name}: {name}")
        lengths_m = np.linalg.norm(np.diff(self.crosswalks_m, axis=1), axis=2).ravel()
        for index in np.flatnonzero(lengths_m > limits.crosswalk_length_m)[:1]:
            where = f"{self.name}: crosswalks_m[{index}]"
            got = f"{lengths_m[index]:,.0f} metres from end to end"
            refuse(where, got, f"at most {limits.crosswalk_length_m:,.0f}")
        lanes_m = sum(length_m(lane.centreline_m) for lane in self.lanes)
        if lanes_m > limits.lanes_length_m:
            got = f"{lanes_m:,.0f} metres of them"
            refuse(f"{self.name}: lanes", got, f"at most {limits.lanes_length_m:,.0f}")

    def __repr__(self) -> str:
        return (
            f"Scene({self.name!r}, {len(self.triangles)} triangles, "
            f"{len(self.instances)} instances, {len(self.sites)} sites)"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lane:
    """One lane of an arm.

    Attributes
    ----------
    id : str
        Name in the source.
    kind : str
        "driving", "parking", "cycling"; "bus": for buses, taxis and others, not
        for cars; "connecting": through a junction, from the end of one lane to
        the start of another; or "assumed": straight on from beyond the map to
        the start of one.
    width_m : float
        Full width, within ``LANE_WIDTH_M``. [m]
    centreline_m : (n, 2) float
        Points of its middle in driving direction. World frame. [m]
    speed_limit_kmh : float or None
        Speed limit where it leads into the junction; None: unknown, or there
        is none. [km/h]
    turns : tuple of Turn
        Movements from its end, by its markings; empty: it bears none.
    closed_to : tuple of RoadUser
        Who may not use its road, nor cross it between junctions.
    """

    id: str
    kind: Annotated[str, Meta(min_length=1)]
    # Full width, see :func:`is_lane_width`.
    width_m: Annotated[float, Meta(gt=0.0)]
    # (n, 2); in driving direction. World frame.
    centreline_m: Points2
    # where it leads into the junction; None: unknown, or there is none
    speed_limit_kmh: Annotated[float, Meta(gt=0.0)] | None = None
    turns: tuple[Turn, ...] = ()
    closed_to: tuple[RoadUser, ...] = ()

    def __post_init__(self) -> None:
        where = f"lane {self.id}"
        check_name(self.id, f"{where}.id")
        check_name(self.kind, f"{where}.kind")
        set_arrays(self, f"{where}.", centreline_m=(-1, 2))
        _check_near(self.centreline_m, f"{where}.centreline_m")
        most = load_limits().line_points
        _check_count(len(self.centreline_m), most, f"{where}.centreline_m")
        if not is_lane_width(self.width_m):
            low_m, high_m = load_limits().lane_width_m
            raise InputError(
                f"{where}.width_m", self.width_m, f"{low_m:g} to {high_m:g} metres"
            )


def checked_islands(islands_m: Any, where: str) -> tuple[FloatArray, ...]:
    """Outlines of islands as arrays (n, 2) that nothing changes.

    Raises
    ------
    InputError
        One of them has less than three points, or is no line of points.
    """
    islands = []
    for index, island_m in enumerate(islands_m):
        here = f"{where}[{index}]"
        points = float_array(island_m, (-1, 2), here)
        if len(points) < 3:
            raise InputError(here, len(points), "at least three points")
        islands.append(freeze(points))
    return tuple(islands)


def is_lane_width(width_m: float) -> bool:
    """True if a lane of a scene may be so wide."""
    low_m, high_m = load_limits().lane_width_m
    return low_m <= width_m <= high_m


def _check_near(points_m: FloatArray, where: str) -> None:
    """Raise InputError if points (.., d) lie beyond what a scene may reach."""
    most_m = load_limits().coordinate_m
    is_far = (np.abs(points_m) > most_m).any(axis=-1)
    if is_far.any():
        # [] if it is but one point.
        first = np.argwhere(is_far)[0].tolist()
        place = "".join(f"[{index}]" for index in first)
        got = points_m[tuple(first)].tolist()
        raise InputError(
            f"{where}{place}", got, f"metres within {most_m:,.0f} of the origin"
        )


def _check_count(count: int, most: int, where: str) -> None:
    """Raise InputError if a list of a scene is longer than any junction has it."""
    if count > most:
        refuse(where, f"{count:,} of them", f"at most {most:,}")


# One thing of a scene: instance, vertices (world frame) and triangles.
Body = tuple[Instance, FloatArray, Any]
# Vertices (n, 3) and triangles (m, 3).
Mesh = tuple[FloatArray, NDArray[np.int32]]


def join(meshes: Sequence[tuple[FloatArray, NDArray[Any]]]) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    triangles = [
        faces + start for (_, faces), start in zip(meshes, first[:-1], strict=True)
    ]
    vertices: FloatArray = np.concatenate([vertices for vertices, _ in meshes])
    return vertices, np.concatenate(triangles).astype(np.int32)


def join_bodies(bodies: Sequence[Body]) -> dict[str, Any]:
    """One mesh of several bodies, as the fields of a scene."""
    vertices, triangles = join([(vertices, faces) for _, vertices, faces in bodies])
    counts = [len(faces) for _, _, faces in bodies]
    return {
        "instances": tuple(instance for instance, _, _ in bodies),
        "vertices_m": vertices,
        "triangles": triangles,
        "triangle_instance": np.repeat(np.arange(len(bodies)), counts),
    }


def containing_instance(scene: Scene, position_m: ArrayLike) -> Instance | None:
    """The building, wall, plant or parked vehicle that a point lies in.

    None in the open air.

    Posts and masts carry sensors and are not looked at.

    References
    ----------
    .. [1] A. van Oosterom, J. Strackee, "The solid angle of a plane triangle", 1983:
       the triangles
       of a closed mesh that surrounds a point fill the whole sphere around it.
    """
    point = float_array(position_m, (3,), "position_m")
    for index, instance in enumerate(scene.instances):
        if instance.class_name not in _SOLID_CLASSES:
            continue
        corners = (
            scene.vertices_m[scene.triangles[scene.triangle_instance == index]] - point
        )
        # The point is outside of the thing's box.
        if (corners.min(axis=(0, 1)) > 0.0).any() or (
            corners.max(axis=(0, 1)) < 0.0
        ).any():
            continue
        # The solid angle of each triangle, as seen from the point.
        a, b, c = np.swapaxes(corners, 0, 1)
        length_a, length_b, length_c = (
            np.linalg.norm(side, axis=1) for side in (a, b, c)
        )
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        product = (
            length_a * length_b * length_c
            + np.einsum("ij,ij->i", a, b) * length_c
            + np.einsum("ij,ij->i", b, c) * length_a
            + np.einsum("ij,ij->i", c, a) * length_b
        )
        solid_angle = 2.0 * np.arctan2(volume, product).sum()
        if abs(solid_angle) > 2.0 * np.pi:
            return instance
    return None


def road_area(scene: Scene) -> Any:
    """Area of a scene's lanes and its junction.

    It is a shapely geometry in the world frame, in metres.
    """
    return covered_area(scene.outline_m, scene.lanes, scene.islands_m)


def covered_area(
    outline_m: FloatArray,
    lanes: Sequence[Lane],
    islands_m: Sequence[FloatArray] = (),
) -> Any:
    """Area of lanes and of a junction's outline (n, 2) without its islands.

    It is a shapely geometry in metres.
    """
    junction = paved_area(outline_m, islands_m)
    return shapely.union_all([junction, *strips_of(lanes)])


def paved_area(outline_m: FloatArray, islands_m: Sequence[FloatArray]) -> Any:
    """Area within a junction's outline (n, 2), without its islands (n, 2).

    It is a shapely geometry in metres.
    """
    islands = [area_of(island_m) for island_m in islands_m]
    return shapely.difference(area_of(outline_m), shapely.union_all(islands))


def area_of(outline_m: FloatArray) -> Any:
    """Area within an outline (n, 2), which may cross itself.

    It is a shapely geometry in metres.
    """
    return shapely.make_valid(shapely.Polygon(outline_m))


def strips_of(lanes: Iterable[Lane], *, less_m: float = 0.0) -> list[Any]:
    """Surfaces of lanes as polygons, `less_m` metres inside their edges.

    A lane of a single point has none.
    """
    return [
        shapely.LineString(lane.centreline_m).buffer(
            max(0.5 * lane.width_m - less_m, 0.0), cap_style="flat"
        )
        for lane in lanes
        if len(lane.centreline_m) > 1
    ]


@lru_cache(maxsize=4096)
def thing_footprint(scene: Scene, index: int) -> Any:
    """A thing's triangles seen from above, put together.

    The result is a shapely polygon or several, with holes.

    It is empty where the thing is but a line from above. World frame, metres.
    """
    return flat_union(
        scene.vertices_m[scene.triangles[scene.triangle_instance == index]]
    )


def flat_union(corners_m: FloatArray) -> Any:
    """Triangles (n, 3, 3) seen from above, put together: a shapely geometry."""
    flat = corners_m[..., :2]
    one = flat[:, 1] - flat[:, 0]
    other = flat[:, 2] - flat[:, 0]
    # Upright triangles have no area from above.
    double_area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    return shapely.union_all(shapely.polygons(flat[double_area > _MIN_AREA_M2]))
