"""Triangles of a frame, each with its thing, and what a LiDAR reports of them.

Rays are cast in single precision: a frame's mesh has its origin at the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, QhullError

from geometry.actors import Actor, PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import (
    LidarModel,
    beam_directions,
    load_lidar_detection,
    load_surface_reflectivity,
    noisy_ranges,
    return_probability,
)
from geometry.poses import Pose, body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster, build_caster
from geometry.scene import Scene, join
from geometry.terrain import on_ground
from geometry.weather import Weather
from scenarios.runs import Run

from ..detectors import vru_class

Index = NDArray[np.int32]

# Classes whose faces are shaded as if they were curved.
ROUND = ("pedestrian", "cyclist", "motorcyclist")
# People's faces that meet at less than about 50 degrees are shaded as one.
_CREASE_COS = 0.6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PictureThing:
    """One thing in a picture.

    Attributes
    ----------
    name : str
        The scene's instance, "parked-1" .., "driving-1" .., "vut" or "vru".
    class_name : str
        Class of the scene's instance, or of the road user.
    pose : Pose
        Body frame: on the road under the middle.
    size_m : (3,) float
        Length, width, height. [m]
    actor : Actor, optional
        None for what only the scene knows.
    """

    name: str
    class_name: str
    pose: Pose
    size_m: FloatArray
    actor: Actor | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """Triangles of things, in the world frame.

    Attributes
    ----------
    vertices_m : (n, 3) float
        [m]
    triangles : (m, 3) int32
        Into the vertices.
    triangle_thing : (m,) int32
        Into `things`.
    normals : (m, 3, 3) float32
        Unit normals at the corners of each triangle; equal where shaded flat.
    things : tuple of PictureThing
        All things.
    """

    vertices_m: FloatArray
    triangles: Index
    triangle_thing: Index
    normals: FloatRays
    things: tuple[PictureThing, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameMesh:
    """Triangles of one frame, ready for rays.

    The origin is at the camera, the axes are those of the world.

    Attributes
    ----------
    origin_m : (3,) float
        World frame. [m]
    corners_m : (m, 3, 3) float32
        Corners of the triangles. [m]
    normals : (m, 3, 3) float32
        As in :class:`Mesh`.
    triangle_thing : (m,) int32
        Into `things`.
    things : tuple of PictureThing
        All things.
    caster : RayCaster
        For rays against the triangles.
    """

    origin_m: FloatArray
    corners_m: FloatRays
    normals: FloatRays
    triangle_thing: Index
    things: tuple[PictureThing, ...]
    caster: RayCaster


def build_static_mesh(scene: Scene, obstruction: Sequence[PlacedActor]) -> Mesh:
    """Triangles of what stands still in a run.

    Parameters
    ----------
    scene : Scene
        Its instances are the first things, in their order.
    obstruction : sequence of PlacedActor
        Parked bodies: things "parked-1" and so on.
    """
    parked = [
        _body_mesh(
            f"parked-{number}", placed.actor, placed.actor.shapes[0], placed.pose
        )
        for number, placed in enumerate(obstruction, start=1)
    ]
    return _join([build_scene_mesh(scene), *parked])


# Cached, since pictures of a scene differ only in what parks there.
@lru_cache(maxsize=1)
def build_scene_mesh(scene: Scene) -> Mesh:
    """Triangles of a scene, whose things are its instances in their order."""
    return Mesh(
        vertices_m=scene.vertices_m,
        triangles=scene.triangles,
        triangle_thing=scene.triangle_instance,
        normals=_flat_normals(scene.vertices_m, scene.triangles),
        things=tuple(
            _scene_thing(scene, index) for index in range(len(scene.instances))
        ),
    )


def build_frame_mesh(
    static: Mesh, run: Run, frame_index: int, origin_m: FloatArray, *, with_vut: bool
) -> FrameMesh:
    """Triangles of one frame, ready for rays.

    Parameters
    ----------
    static : Mesh
        What stands still; see :func:`build_static_mesh`.
    run, frame_index : Run, int
        The frame.
    origin_m : (3,) float
        New origin, world frame. [m]
    with_vut : bool
        The VUT is seen.

    Returns
    -------
    mesh : FrameMesh
        Vehicles that drive by are "driving-1" and so on; the last things are "vut", if
        it is seen, and "vru".
    """
    moving = build_moving_meshes(run, frame_index, with_vut=with_vut)
    return place_mesh(_join([static, *moving]), origin_m)


def build_moving_meshes(
    run: Run, frame_index: int, *, with_vut: bool
) -> tuple[Mesh, ...]:
    """Moving things of a frame, each in a mesh of its own.

    Their order and names are those of :func:`build_frame_mesh`.
    """
    bodies = [
        (
            f"driving-{n}",
            body.actor,
            0,
            body.position_m[frame_index],
            body.yaw_deg[frame_index],
        )
        for n, body in enumerate(run.traffic, start=1)
        if body.is_there[frame_index]
    ]
    vut = run.encounter.vut
    vru = run.encounter.vru
    # The VUT, then the VRU come last.
    if with_vut:
        where = run.vut_position_m[frame_index], run.vut_yaw_deg[frame_index]
        bodies.append(("vut", vut, 0, *where))
    where = run.vru_position_m[frame_index], run.vru_yaw_deg[frame_index]
    bodies.append(("vru", vru, int(run.vru_shape[frame_index]), *where))
    return tuple(
        _body_mesh(
            name, actor, actor.shapes[shape], _road_pose(run, position_m, yaw_deg)
        )
        for name, actor, shape, position_m, yaw_deg in bodies
    )


def place_mesh(mesh: Mesh, origin_m: FloatArray) -> FrameMesh:
    """A mesh relative to an origin (3,), ready for rays."""
    vertices = (mesh.vertices_m - origin_m).astype(np.float32)
    return FrameMesh(
        origin_m=origin_m,
        corners_m=vertices[mesh.triangles],
        normals=mesh.normals,
        triangle_thing=mesh.triangle_thing,
        things=mesh.things,
        caster=build_caster(vertices, mesh.triangles),
    )


def move_origin(mesh: FrameMesh, origin_m: FloatArray) -> FrameMesh:
    """Triangles that are ready for rays, relative to another origin (3,).

    The caster is used again.
    """
    shift = (origin_m - mesh.origin_m).astype(np.float32)
    return replace(
        mesh,
        origin_m=origin_m,
        corners_m=mesh.corners_m - shift,
        caster=_MovedCaster(mesh.caster, shift),
    )


def add_moving_meshes(still: FrameMesh, moving: Sequence[Mesh]) -> FrameMesh:
    """Standing and moving triangles together, ready for rays.

    Only the moving ones are prepared anew.
    """
    bodies = place_mesh(_join(moving), still.origin_m)
    return FrameMesh(
        origin_m=still.origin_m,
        corners_m=np.concatenate([still.corners_m, bodies.corners_m]),
        normals=np.concatenate([still.normals, bodies.normals]),
        triangle_thing=np.concatenate(
            [still.triangle_thing, bodies.triangle_thing + np.int32(len(still.things))]
        ),
        things=still.things + bodies.things,
        caster=_TwoCasters(still.caster, bodies.caster, len(still.corners_m)),
    )


class _MovedCaster:
    """Caster of rays whose origins are relative to another origin, (3,)."""

    def __init__(self, caster: RayCaster, shift: FloatRays) -> None:
        self._caster = caster
        self._shift = shift

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """Mask of rays that meet a triangle; see :class:`RayCaster`."""
        return self._caster.is_blocked(origins_m + self._shift, vectors_m)

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """Share of each ray up to its first hit, and the triangle."""
        return self._caster.first_triangle(origins_m + self._shift, vectors_m)


class _TwoCasters:
    """Caster of rays against two sets of triangles, numbered one after the other."""

    def __init__(self, first: RayCaster, second: RayCaster, n_first: int) -> None:
        self._first = first
        self._second = second
        self._n_first = n_first

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """Mask of rays that meet a triangle of either set."""
        blocked = self._first.is_blocked(origins_m, vectors_m)
        free = np.flatnonzero(~blocked)
        blocked[free] = self._second.is_blocked(origins_m[free], vectors_m[free])
        return blocked

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """Share of each ray up to its first hit in either set, and the triangle."""
        share, triangle = self._first.first_triangle(origins_m, vectors_m)
        other_share, other = self._second.first_triangle(origins_m, vectors_m)
        is_nearer = other_share < share
        return (
            np.where(is_nearer, other_share, share),
            np.where(is_nearer, other + self._n_first, triangle),
        )


def vut_pose(run: Run, frame_index: int) -> Pose:
    """Body frame of the VUT in a frame."""
    return _road_pose(
        run, run.vut_position_m[frame_index], run.vut_yaw_deg[frame_index]
    )


def _road_pose(run: Run, position_m: FloatArray, yaw_deg: float) -> Pose:
    """Pose of a body on the ground of a run."""
    return Pose(position_m=on_ground(position_m, run.terrain), yaw_deg=float(yaw_deg))


def _scene_thing(scene: Scene, index: int) -> PictureThing:
    """An instance of the scene as a thing, in the smallest rectangle around it."""
    instance = scene.instances[index]
    used = np.unique(scene.triangles[scene.triangle_instance == index])
    if len(used):
        points = scene.vertices_m[used]
    else:
        points = np.zeros((1, 3))
    middle, yaw_rad, length_m, width_m = _smallest_rectangle(points[:, :2])
    low = points[:, 2].min()
    high = points[:, 2].max()
    return PictureThing(
        name=instance.id,
        class_name=instance.class_name,
        pose=Pose(
            position_m=np.append(middle, low), yaw_deg=float(np.degrees(yaw_rad))
        ),
        size_m=np.array([length_m, width_m, high - low]),
    )


def _smallest_rectangle(points_m: FloatArray) -> tuple[FloatArray, float, float, float]:
    """The oriented rectangle of least area around points.

    Parameters
    ----------
    points_m : (n, 2) float
        [m]

    Returns
    -------
    middle : (2,) float
        [m]
    yaw_rad : float
        Of the longer side, counter-clockwise from east. [rad]
    length_m, width_m : float
        [m]

    References
    ----------
    H. Freeman, R. Shapira, "Determining the minimum-area encasing rectangle", 1975: one
    side lies along an edge of the convex hull.
    """
    try:
        hull = points_m[ConvexHull(points_m).vertices]
    except (QhullError, ValueError):
        # All on a line, or a single point.
        hull = points_m
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.arctan2(edges[:, 1], edges[:, 0]).round(9))
    ahead = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    left = ahead[:, ::-1] * [-1.0, 1.0]
    along = hull @ ahead.T
    across = hull @ left.T
    spans = np.stack([np.ptp(along, axis=0), np.ptp(across, axis=0)])
    best = int(np.argmin(spans.prod(axis=0)))
    middle = 0.5 * (
        (along[:, best].min() + along[:, best].max()) * ahead[best]
        + (across[:, best].min() + across[:, best].max()) * left[best]
    )
    length, width = spans[:, best].tolist()
    if length >= width:
        return middle, float(angles[best]), length, width
    return middle, float(angles[best] + 0.5 * np.pi), width, length


def _body_mesh(name: str, actor: Actor, shape: Shape, pose: Pose) -> Mesh:
    """Mesh of one body at a pose."""
    size_m = np.array([actor.length_m, actor.width_m, actor.height_m])
    normals = _body_normals(shape, is_round=actor.class_name in ROUND)
    R_world_body = body_rotation(pose.yaw_deg, pose.pitch_deg).astype(np.float32)
    return Mesh(
        vertices_m=to_world(shape.vertices_m, pose),
        triangles=shape.triangles,
        triangle_thing=np.zeros(len(shape.triangles), dtype=np.int32),
        normals=normals @ R_world_body.T,
        things=(
            PictureThing(
                name=name,
                class_name=actor.class_name,
                pose=pose,
                size_m=size_m,
                actor=actor,
            ),
        ),
    )


# Cached, since the steps of a gait repeat; some 100 kB each.
@lru_cache(maxsize=128)
def _body_normals(shape: Shape, *, is_round: bool) -> FloatRays:
    """Normals of a body's triangles in its own frame, (m, 3, 3)."""
    if is_round:
        shade = _round_normals
    else:
        shade = _flat_normals
    return shade(shape.vertices_m, shape.triangles)


def _join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of several; triangles and things keep their order."""
    vertices, triangles = join([(mesh.vertices_m, mesh.triangles) for mesh in meshes])
    n_things = np.cumsum([0, *(len(mesh.things) for mesh in meshes)])
    return Mesh(
        vertices_m=vertices,
        triangles=triangles,
        triangle_thing=np.concatenate(
            [
                mesh.triangle_thing + n
                for mesh, n in zip(meshes, n_things[:-1], strict=True)
            ]
        ).astype(np.int32),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        things=tuple(thing for mesh in meshes for thing in mesh.things),
    )


def _flat_normals(vertices_m: FloatArray, triangles: Index) -> FloatRays:
    """The face's unit normal at each corner, (m, 3, 3)."""
    return np.repeat(_unit(_face_normals(vertices_m, triangles))[:, None], 3, axis=1)


def _round_normals(vertices_m: FloatArray, triangles: Index) -> FloatRays:
    """Smooth unit normals at each corner, (m, 3, 3).

    The mean of the faces around the corner that turn away little, weighted by area.
    """
    by_area = _face_normals(vertices_m, triangles)
    faces = _unit(by_area)
    corner_vertex = triangles.ravel()
    n_corners = len(corner_vertex)
    at_vertex = csr_array(
        (np.ones(n_corners, dtype=np.int8), (corner_vertex, np.arange(n_corners))),
        shape=(len(vertices_m), n_corners),
    )
    # Corners that share a vertex.
    pairs = (at_vertex.T @ at_vertex).tocoo()
    own = pairs.row // 3
    other = pairs.col // 3
    is_one = np.einsum("ij,ij->i", faces[own], faces[other]) > _CREASE_COS
    blend = csr_array(
        (
            np.ones(int(is_one.sum()), dtype=np.float32),
            (pairs.row[is_one], other[is_one]),
        ),
        shape=(n_corners, len(triangles)),
    )
    return _unit(np.asarray(blend @ by_area)).reshape(-1, 3, 3)


def _face_normals(vertices_m: FloatArray, triangles: Index) -> FloatRays:
    """Normals of triangles, (m, 3), as long as twice their area."""
    a, b, c = np.swapaxes(vertices_m[triangles], 0, 1)
    return np.cross(b - a, c - a).astype(np.float32)


def _unit(vectors: FloatRays) -> FloatRays:
    """Vectors (n, 3) at unit length; zeros stay zeros."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.float32(1e-20)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointCloud:
    """Pulses that came back.

    Attributes
    ----------
    points_m : (n, 3) float32
        Frame of the LiDAR: x ahead, y left, z up. [m]
    intensity : (n,) float32
        Reflectivity times the cosine of incidence, 0 .. 1.
    instance : (n,) int32
        Index into `names`.
    names : tuple of str
        The scene's instances, "parked-1" .., "vut" if it is there, "vru".
    """

    points_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    instance: NDArray[np.int32]
    names: tuple[str, ...]


def scan_mesh(
    mesh: FrameMesh,
    run: Run,
    pose: Pose,
    lidar: LidarModel,
    *,
    weather: Weather,
    seed: int | Sequence[int] = 0,
) -> PointCloud:
    """Scan a frame's mesh by a LiDAR: one point for each pulse that comes back.

    Parameters
    ----------
    mesh : FrameMesh
        Its origin is at the LiDAR.
    run : Run
        Its VRU has a reflectivity of its own.
    pose : Pose
        Of the LiDAR.
    lidar : LidarModel
        Its beams, range and noise.
    weather : Weather
        Extinction in the air.
    seed : int or sequence of int
        Of noise, and of which pulses come back.
    """
    beams = beam_directions(lidar).reshape(-1, 3)
    ways = beams @ body_rotation(pose.yaw_deg, pose.pitch_deg).T
    starts = lidar.near_m * ways
    share, triangle = mesh.caster.first_triangle(
        starts.astype(np.float32), ways.astype(np.float32)
    )
    hits = triangle >= 0
    triangle = triangle[hits]
    distance = share[hits].astype(np.float64) + lidar.near_m
    instance = mesh.triangle_thing[triangle]
    by_class = load_surface_reflectivity()
    of_vru = load_lidar_detection().reflectivity[vru_class(run.encounter.vru)]
    of_things = []
    for thing in mesh.things:
        if thing.name == "vru":
            of_things.append(of_vru)
        else:
            of_things.append(by_class[thing.class_name])
    reflectivity = np.array(of_things)[instance]
    # Cosine of incidence on each triangle that is hit.
    a, b, c = np.moveaxis(mesh.corners_m[triangle].astype(np.float64), 1, 0)
    across = np.cross(b - a, c - a)
    normals = across / np.linalg.norm(across, axis=1, keepdims=True).clip(1.0e-12)
    cosine = np.abs(np.einsum("ni,ni->n", normals, ways[hits]))
    # Which pulses come back, and what they report.
    rng = np.random.default_rng(seed)
    probability = return_probability(
        lidar,
        distance,
        reflectivity=reflectivity,
        incidence_cos=cosine,
        extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
    )
    returns = rng.random(len(distance)) < probability
    reported_m = noisy_ranges(lidar, distance[returns], rng)
    return PointCloud(
        points_m=(beams[hits][returns] * reported_m[:, None]).astype(np.float32),
        intensity=(reflectivity * cosine)[returns].astype(np.float32),
        instance=instance[returns].astype(np.int32),
        names=tuple(thing.name for thing in mesh.things),
    )
