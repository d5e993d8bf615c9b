"""Everything that can be seen in the frames of some runs.

Ready for pixels and for LiDAR beams. A *road pose* is a row of four numbers: east and
north in metres, yaw in degrees, and height of the ground in metres. It places the frame
of a :class:`Solid` in the frame in which a sensor stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, lru_cache
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor, PlacedActor, Shape
from geometry.arrays import FloatArray, IntArray
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.lidar import LidarModel, load_lidars
from geometry.poses import Pose, body_rotation, to_world, wrap_deg
from geometry.raycast import RayCaster, build_caster
from geometry.scene import Scene, join
from geometry.sensors import CameraModel
from geometry.tables import pick, take_number, take_text
from geometry.terrain import Terrain, on_ground, pitch_on_ground_deg, terrain_of
from geometry.text_formats import load_data
from geometry.weather import Weather, pick_weather
from scenarios.runs import Run

from ..detectors import VRU_CLASSES, vru_class

if TYPE_CHECKING:
    from .pixels import Skin, Tree, Vehicles

_WHERE = "vut_camera.toml"
# Poses that agree to a micrometre are the same.
_POSE_DECIMALS = 6


# ---------- triangles
@dataclass(frozen=True, kw_only=True, eq=False)
class BodyMesh:
    """Triangles and their vertices.

    Tree and skin are built when they are first asked for: LiDARs do without.

    Attributes
    ----------
    vertices_m : (n_vertices, 3) float
        [m]
    triangles : (n_triangles, 3) int
        Rows of vertices.
    """

    vertices_m: FloatArray
    triangles: IntArray
    _lock: RLock = field(default_factory=RLock, repr=False)

    @cached_property
    def corners_m(self) -> FloatArray:
        """Corners of the triangles, (n_triangles, 3, 3)."""
        return np.ascontiguousarray(self.vertices_m[self.triangles])

    @cached_property
    def skin(self) -> "Skin":
        """Triangles, shuffled for drawing."""
        # Loads the compiler.
        from .pixels import Skin

        rng = np.random.default_rng(0)
        n_vertices = len(self.vertices_m)
        order = rng.permutation(n_vertices)
        place = np.empty(n_vertices, dtype=np.int64)
        place[order] = np.arange(n_vertices)
        triangles = place[rng.permutation(self.triangles)]
        corners = triangles.ravel()
        return Skin(
            vertices_m=np.ascontiguousarray(self.vertices_m[order].T),
            triangles=triangles,
            fan_start=np.append(
                0, np.cumsum(np.bincount(corners, minlength=n_vertices))
            ),
            fans=np.argsort(corners, kind="stable") // 3,
        )

    @property
    def tree(self) -> "Tree":
        """Boxes around the triangles; several threads may ask for it."""
        with self._lock:
            return self._tree

    @cached_property
    def _tree(self) -> "Tree":
        # Loads the compiler.
        from .pixels import build_tree

        return build_tree(self.corners_m)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """Triangles that keep together, in their own frame.

    Attributes
    ----------
    meshes : tuple of BodyMesh
        One of a road user; of the static world, what always stands there and what is
        parked in a run. A mesh may belong to several solids.
    hull_m : (n, 3) float
        Vertices of the convex hull; none for the static world. [m]
    """

    meshes: tuple[BodyMesh, ...]
    hull_m: FloatArray
    _lock: RLock = field(default_factory=RLock, repr=False)

    @property
    def caster(self) -> RayCaster:
        """Caster of rays against the triangles, mesh after mesh.

        Several threads may ask for it.
        """
        with self._lock:
            return self._caster

    @cached_property
    def _caster(self) -> RayCaster:
        """Built when a LiDAR asks for it: a camera's pixels need no rays."""
        return build_caster(
            *join([(mesh.vertices_m, mesh.triangles) for mesh in self.meshes])
        )

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals of the triangles, (n_triangles, 3), mesh after mesh."""
        corners = np.concatenate([mesh.corners_m for mesh in self.meshes])
        a, b, c = np.moveaxis(corners, 1, 0)
        across = np.cross(b - a, c - a)
        return np.asarray(
            across / np.linalg.norm(across, axis=1, keepdims=True).clip(1.0e-12)
        )


@lru_cache(maxsize=256)
def build_body(shape: Shape) -> Solid:
    """A road user at one instant of its gait, in its body frame.

    Cached: every evaluation has the same bodies.
    """
    # Loaded when something is drawn.
    from scipy.spatial import ConvexHull

    hull = ConvexHull(shape.vertices_m).vertices
    mesh = BodyMesh(
        vertices_m=np.array(shape.vertices_m),
        triangles=shape.triangles.astype(np.int64),
    )
    return Solid(meshes=(mesh,), hull_m=shape.vertices_m[hull])


def build_scene_mesh(scene: Scene, *, middle_m: FloatArray) -> BodyMesh:
    r"""Triangles of the scene, with the origin near the VRUs.

    Coordinates are small then, where rays are cast in single precision: the road
    pose of the mesh in the world is (\*middle_m, 0, 0).

    Parameters
    ----------
    scene : Scene
        The scene.
    middle_m : (2,) float
        New origin, world frame. [m]
    """
    return BodyMesh(
        vertices_m=scene.vertices_m - [*middle_m, 0.0],
        triangles=np.asarray(scene.triangles, dtype=np.int64),
    )


def build_static(
    standing: BodyMesh, obstruction: Sequence[PlacedActor], *, middle_m: FloatArray
) -> Solid:
    """Everything that stands still in a run.

    Parameters
    ----------
    standing : BodyMesh
        The scene, with its origin at `middle_m`.
    obstruction : sequence of PlacedActor
        Parked bodies.
    middle_m : (2,) float
        Origin, world frame. [m]
    """
    parked = _build_parked(tuple(obstruction), tuple(middle_m.tolist()))
    return Solid(meshes=(standing, parked), hull_m=np.empty((0, 3)))


@lru_cache(maxsize=8)
def _build_parked(
    obstruction: tuple[PlacedActor, ...], middle_m: tuple[float, float]
) -> BodyMesh:
    """Mesh of parked bodies, relative to an origin.

    Cached: layouts that are judged one after the other meet the same ones.
    """
    nothing = np.empty((0, 3)), np.empty((0, 3), dtype=np.int32)
    placed = [(body.actor.shapes[0], body.pose) for body in obstruction]
    bodies = [
        (to_world(one.vertices_m, at) - [*middle_m, 0.0], one.triangles)
        for one, at in placed
    ]
    vertices, triangles = join([nothing, *bodies])
    return BodyMesh(vertices_m=vertices, triangles=triangles.astype(np.int64))


# ---------- surroundings of runs
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """Everything that can be seen in the frames of some runs, laid end to end.

    Attributes
    ----------
    statics : tuple of Solid
        Distinct static worlds, one per obstruction.
    vrus : tuple of Solid
        Distinct shapes of VRUs.
    vehicles : tuple of Solid
        Distinct bodies that move, the VUT first.
    vehicle_trees : Vehicles
        The same for drawing.
    vut_actor : Actor
        The VUT.
    static_index, vru_index : (n_frames,) int
        Which static world and which shape is there.
    sight_index : (n_frames,) int
        See :func:`find_sights`.
    static_poses, vru_poses, vut_poses : (n_frames, 4) float
        Road poses: east, north, yaw, height. World frame. [m], [m], [deg], [m]
    vut_pitch_deg : (n_frames,) float
        Pitch along the road below its axles. [deg]
    traffic_index : (n_frames, n) int
        Which of the vehicles drive by; -1 for none.
    traffic_poses : (n_frames, n, 4) float
        Their road poses.
    draw_index : (n_frames,) int
        See :class:`placement.detectors.Evidence`.
    vru_class : (n_frames,) int
        Into ``VRU_CLASSES``.
    weathers : tuple of Weather
        Distinct weathers.
    weather_index : (n_frames,) int
        Weather of each frame.
    """

    statics: tuple[Solid, ...]
    vrus: tuple[Solid, ...]
    vehicles: tuple[Solid, ...]
    vehicle_trees: "Vehicles"
    vut_actor: Actor
    static_index: IntArray
    vru_index: IntArray
    sight_index: IntArray
    static_poses: FloatArray
    vru_poses: FloatArray
    vut_poses: FloatArray
    vut_pitch_deg: FloatArray
    traffic_index: IntArray
    traffic_poses: FloatArray
    draw_index: IntArray
    vru_class: IntArray
    weathers: tuple[Weather, ...]
    weather_index: IntArray

    def take(self, frames: IntArray) -> "Surroundings":
        """Keep some frames, by index."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        per_frame: dict[str, Any] = {
            name: one[frames]
            for name, one in values.items()
            if isinstance(one, np.ndarray)
        }
        return replace(self, **per_frame)

    def contrast(self, distance_m: FloatArray) -> FloatArray:
        """Contrast of the VRU in the weather of every frame.

        Parameters
        ----------
        distance_m : (n_frames,) float
            To the VRU. [m]

        Returns
        -------
        contrast : (n_frames,) float
        """
        contrast = np.empty(len(distance_m))
        for index, weather in enumerate(self.weathers):
            frames = self.weather_index == index
            contrast[frames] = weather.contrast * weather.transmission(
                distance_m[frames]
            )
        return contrast


def build_surroundings(scene: Scene, runs: Sequence[Run]) -> Surroundings:
    """Prepare a scene and runs for all sensors.

    Raises
    ------
    InputError
        The runs have more than one VUT.
    """
    vuts = {run.encounter.vut.name: run.encounter.vut for run in runs}
    if len(vuts) != 1:
        raise InputError("runs: VUT", sorted(vuts), "the same vehicle in all runs")
    # Loads the compiler.
    from .pixels import join_vehicles

    vut_actor = next(iter(vuts.values()))
    vru_of_frame = [
        (run.encounter.vru, int(index)) for run in runs for index in run.vru_shape
    ]
    vrus = {key: number for number, key in enumerate(dict.fromkeys(vru_of_frame))}
    obstructions = {obstruction_key(run): run.obstruction for run in runs}
    terrain = terrain_of(scene)
    vru_poses = np.concatenate(
        [_road_poses(run.vru_position_m, run.vru_yaw_deg, terrain) for run in runs]
    )
    middle_m = 0.5 * (vru_poses[:, :2].min(axis=0) + vru_poses[:, :2].max(axis=0))
    n_frames = [len(run.time_s) for run in runs]
    weathers = list(dict.fromkeys(run.weather for run in runs))
    classes = [VRU_CLASSES.index(vru_class(run.encounter.vru)) for run in runs]
    # The scene once; each obstruction is added to it.
    standing = build_scene_mesh(scene, middle_m=middle_m)
    static_index = np.repeat(
        [list(obstructions).index(obstruction_key(run)) for run in runs], n_frames
    )
    vru_index = np.array([vrus[key] for key in vru_of_frame])
    static_poses = np.tile([*middle_m, 0.0, 0.0], (sum(n_frames), 1))
    # Distinct vehicles, the VUT first.
    driving = [body.actor for run in runs for body in run.traffic]
    vehicles = list(dict.fromkeys([vut_actor, *driving]))
    solids = tuple(build_body(actor.shapes[0]) for actor in vehicles)
    traffic_index, traffic_poses = _lay_traffic(runs, vehicles, terrain)
    return Surroundings(
        statics=tuple(
            build_static(standing, obstruction, middle_m=middle_m)
            for obstruction in obstructions.values()
        ),
        vrus=tuple(build_body(vru.shapes[index]) for vru, index in vrus),
        vehicles=solids,
        vehicle_trees=join_vehicles([solid.meshes[0].tree for solid in solids]),
        vut_actor=vut_actor,
        static_index=static_index,
        vru_index=vru_index,
        sight_index=find_sights(static_index, vru_index, static_poses, vru_poses),
        static_poses=static_poses,
        vru_poses=vru_poses,
        vut_poses=np.concatenate(
            [_road_poses(run.vut_position_m, run.vut_yaw_deg, terrain) for run in runs]
        ),
        vut_pitch_deg=np.concatenate(
            [
                vut_pitch_deg(vut_actor, run.vut_position_m, run.vut_yaw_deg, terrain)
                for run in runs
            ]
        ),
        traffic_index=traffic_index,
        traffic_poses=traffic_poses,
        draw_index=draw_index(runs),
        vru_class=np.repeat(classes, n_frames),
        weathers=tuple(pick_weather(name, "runs: weather") for name in weathers),
        weather_index=np.repeat(
            [weathers.index(run.weather) for run in runs], n_frames
        ),
    )


def _lay_traffic(
    runs: Sequence[Run], vehicles: list[Actor], terrain: Terrain | None
) -> tuple[IntArray, FloatArray]:
    """Vehicles that drive by in each frame.

    Parameters
    ----------
    runs : sequence of Run
        All runs, n_frames in all.
    vehicles : list of Actor
        Kinds of vehicles.
    terrain : Terrain or None
        The ground.

    Returns
    -------
    index : (n_frames, n) int
        Into `vehicles`; -1 for none.
    poses : (n_frames, n, 4) float
        Road poses.
    """
    n_most = max(len(run.traffic) for run in runs)
    indices = []
    poses = []
    for run in runs:
        index = np.full((len(run.time_s), n_most), -1)
        pose = np.zeros((len(run.time_s), n_most, 4))
        for place, body in enumerate(run.traffic):
            there = body.is_there
            index[there, place] = vehicles.index(body.actor)
            pose[there, place] = _road_poses(
                body.position_m[there], body.yaw_deg[there], terrain
            )
        indices.append(index)
        poses.append(pose)
    return np.concatenate(indices), np.concatenate(poses)


def find_sights(
    static_index: IntArray,
    vru_index: IntArray,
    static_poses: FloatArray,
    vru_poses: FloatArray,
) -> IntArray:
    """Numbers of sights: equal where all but the vehicles is at the same place.

    Parameters
    ----------
    static_index, vru_index : (n_frames,) int
        Which static world and which shape of the VRU is there.
    static_poses, vru_poses : (n_frames, 4) float
        Their road poses. Bodies at the same place are at the same height.

    Returns
    -------
    sight_index : (n_frames,) int
        They grow with `static_index`, then with `vru_index`.
    """
    poses = np.concatenate([static_poses[:, :3], vru_poses[:, :3]], axis=1)
    columns = [
        static_index,
        vru_index,
        *(poses * 10**_POSE_DECIMALS).round().astype(np.int64).T,
    ]
    # Frames sorted by all columns: a sight ends where any of them changes.
    order = np.lexsort(columns[::-1])
    is_new = np.any(
        [np.diff(column[order], prepend=0) != 0 for column in columns], axis=0
    )
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(is_new)
    return number


def relative_road_poses(
    road_poses: FloatArray, carrier_poses: FloatArray
) -> FloatArray:
    """Road poses relative to carriers.

    Parameters
    ----------
    road_poses : (n, ..., 4) float
        East, north, yaw, height.
    carrier_poses : (n, 4) float
        Road pose of the carrier of each row.

    Returns
    -------
    relative : (n, ..., 4) float
        Ahead, left, yaw and up, in metres and degrees.

    Examples
    --------
    >>> road = np.array([[0.0, 5.0, 90.0, 0.5]])
    >>> vut = np.array([[0.0, 2.0, 90.0, 0.0]])
    >>> relative_road_poses(road, vut).round(9)
    array([[3. , 0. , 0. , 0.5]])
    """
    rotations = body_rotation(carrier_poses[:, 2])[:, :2, :2]
    if road_poses.ndim == 3:
        bodies = road_poses
    else:
        bodies = road_poses[:, None]
    relative = np.empty_like(bodies)
    relative[..., :2] = (bodies[..., :2] - carrier_poses[:, None, :2]) @ rotations
    relative[..., 2] = wrap_deg(bodies[..., 2] - carrier_poses[:, None, 2])
    relative[..., 3] = bodies[..., 3] - carrier_poses[:, None, 3]
    return relative.reshape(road_poses.shape)


def draw_index(runs: Sequence[Run]) -> IntArray:
    """Number of each frame for random draws, (n_frames,).

    The same in all weathers, with a gap between two runs.
    """
    # Numbers of the encounters, which all weathers share.
    known: dict[int, int] = {}
    encounters = []
    for run in runs:
        number = known.setdefault(id(run.encounter), len(known))
        encounters.append((number, len(run.time_s)))
    # A copy, since the cached array is shared.
    return _numbered(tuple(encounters)).copy()


# Cached, since all sampled worlds ask for the same.
@lru_cache(maxsize=4)
def _numbered(runs: tuple[tuple[int, int], ...]) -> IntArray:
    """Numbers of the frames of runs, each an encounter and its number of frames."""
    start: dict[int, int] = {}
    numbers = []
    free = 0
    for which, n_frames in runs:
        if which not in start:
            start[which] = free
            free += n_frames + 1
        numbers.append(start[which] + np.arange(n_frames))
    return np.concatenate(numbers)


def _road_poses(
    position_m: FloatArray, yaw_deg: FloatArray, terrain: Terrain | None
) -> FloatArray:
    """Road poses (n, 4) of bodies on the ground."""
    return np.insert(on_ground(position_m, terrain), 2, yaw_deg, axis=1)


def vut_pitch_deg(
    vut: Actor, position_m: FloatArray, yaw_deg: ArrayLike, terrain: Terrain | None
) -> FloatArray:
    """Pitch of a VUT on its way, (n,), in degrees.

    See :func:`geometry.terrain.pitch_on_ground_deg`.
    """
    return pitch_on_ground_deg(
        position_m,
        yaw_deg,
        terrain,
        front_m=vut.front_axle_ahead_m,
        wheelbase_m=vut.wheelbase_m,
    )


def level_carriers(surroundings: Surroundings, mount: Pose) -> FloatArray:
    """Road poses of level carriers that hold the VUT's mount where it is.

    Then the sensor's direction alone tilts with the VUT.

    Parameters
    ----------
    surroundings : Surroundings
        Poses and pitch of the VUT.
    mount : Pose
        Of the sensor, body frame of the VUT.

    Returns
    -------
    carriers : (n_frames, 4) float
    """
    tilted = (
        body_rotation(0.0, surroundings.vut_pitch_deg) @ mount.position_m
        - mount.position_m
    )
    carriers = surroundings.vut_poses.copy()
    yaw = np.radians(carriers[:, 2])
    carriers[:, 0] += tilted[:, 0] * np.cos(yaw)
    carriers[:, 1] += tilted[:, 0] * np.sin(yaw)
    carriers[:, 3] += tilted[:, 2]
    return carriers


def obstruction_key(run: Run) -> tuple[object, ...]:
    """Key that is equal for runs with the same bodies parked at the same places."""
    return tuple(parked.key for parked in run.obstruction)


# ---------- the VUT's own camera
@dataclass(frozen=True, slots=True, kw_only=True)
class VutCamera:
    """A camera on the VUT, facing ahead: level where the road is.

    On a grade it looks along the road.

    Attributes
    ----------
    camera : CameraModel
        What is mounted.
    ahead_per_half_length : float
        Distance ahead of the VUT's middle, as a share of half its length.
    up_per_half_height : float
        Height above the road, as a share of half the VUT's height.
    """

    camera: CameraModel
    ahead_per_half_length: float
    up_per_half_height: float

    def pose_on(self, vut: Actor) -> Pose:
        """Pose in the body frame of a vehicle."""
        ahead_m = self.ahead_per_half_length * 0.5 * vut.length_m
        up_m = self.up_per_half_height * 0.5 * vut.height_m
        return Pose(position_m=np.array([ahead_m, 0.0, up_m]), yaw_deg=0.0)


# The VUT's own camera, or a fixed one.
FrameCamera = VutCamera | tuple[Pose, CameraModel]


@cache
def load_vut_camera() -> VutCamera:
    """The study's camera, from ``data/vut_camera.toml``."""
    table = load_data("placement", _WHERE)
    return VutCamera(
        camera=pick_camera(take_text(table, "camera", _WHERE), f"{_WHERE}: camera"),
        ahead_per_half_length=take_number(table, "ahead_per_half_length", _WHERE),
        up_per_half_height=take_number(table, "up_per_half_height", _WHERE),
    )


@cache
def load_vut_lidar() -> LidarModel:
    """The study's LiDAR, at the camera's place, from ``data/vut_camera.toml``."""
    name = take_text(load_data("placement", _WHERE), "lidar", _WHERE)
    return pick(load_lidars(), name, f"{_WHERE}: lidar")
