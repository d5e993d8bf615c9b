"""Rays from a mount position to the VRU's points, once per distinct VRU pose.

A ray does not depend on where the camera looks, and the VRU's pose and gait depend on
the time to impact only, not on the VUT's speed. Few kinds of bodies stand or drive in
many places: rays are taken into the frame of each body that they may meet, and cast
against its shape there, so that what is prepared for a shape serves wherever it is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import TYPE_CHECKING, Literal

import numpy as np

from geometry.actors import Actor, MovingActor, PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.poses import body_rotation
from geometry.raycast import FloatRays, RayCaster, build_caster
from geometry.scene import Scene
from geometry.terrain import Terrain, on_ground, terrain_of
from scenarios.runs import Run

from .views import (
    HiddenPoints,
    Places,
    Surface,
    VruViews,
    build_places,
    build_views,
    look,
)

if TYPE_CHECKING:
    from .ray_kernels import OwnPoints

# Rays that pass a body this near are cast.
AROUND_BODY_M = 2.0e-3
_OFF_SURFACE_M = 1.0e-3
# Rows of bodies whose rays are cast at once.
_ROWS_TOGETHER = 4096


# ---------- bodies
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """Bodies that are there in some runs or in some frames, in groups.

    A group of standing bodies is an obstruction, as some of the runs have it. A group
    of driving bodies, the VUT among them, is a frame of the frame axis.

    Attributes
    ----------
    actors : tuple of Actor
        Distinct kinds of bodies. Among driving bodies the VUT comes first.
    casters : tuple of RayCaster
        One for each kind, in its own frame.
    kind : (n,) int
        Into `actors`.
    position_m : (n, 3) float
        On the ground, relative to the origin of `World`. [m]
    rotation : (n, 3, 3) float
        From the frame of each body to the world's.
    members : (m,) int
        Bodies, one group after the other.
    first : (n_groups + 1,) int
        Where each group begins in `members`.
    """

    actors: tuple[Actor, ...]
    casters: tuple[RayCaster, ...]
    kind: IntArray
    position_m: FloatArray
    rotation: FloatArray
    members: IntArray
    first: IntArray

    def first_hits(
        self, group: int, origins_m: FloatRays, vectors_m: FloatRays
    ) -> Iterator[tuple[int, FloatRays]]:
        """Cast rays at every body of a group.

        Parameters
        ----------
        group : int
            Index of the group.
        origins_m, vectors_m : (n_rays, 3) float
            Rays, relative to the origin of `World`. [m]

        Yields
        ------
        body : int
            A body of the group.
        share : (n_rays,) float32
            Share of each ray up to its first hit on that body.
        """
        for body in self.members[self.first[group] : self.first[group + 1]].tolist():
            # Row vectors times the rotation are coordinates in the body's frame.
            rotation = self.rotation[body]
            origins = ((origins_m - self.position_m[body]) @ rotation).astype(
                np.float32
            )
            vectors = (vectors_m @ rotation).astype(np.float32)
            caster = self.casters[self.kind[body]]
            share, _ = caster.first_triangle(origins, vectors)
            yield body, share


@lru_cache(maxsize=256)
def shape_caster(shape: Shape, rays: str) -> RayCaster:
    """Caster of a body in its own frame; cached, since many worlds share it.

    Parameters
    ----------
    shape : Shape
        Triangles of the body.
    rays : str
        Library that casts the rays; see :func:`geometry.raycast.build_caster`.
    """
    return build_caster(shape.vertices_m, shape.triangles, library=rays)


@lru_cache(maxsize=256)
def _shape_box_m(shape: Shape) -> FloatArray:
    """Lowest and highest coordinates of a shape, (2, 3), in metres."""
    return freeze(
        np.array([shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)])
    )


def _box_m(shape: Shape) -> FloatArray:
    """Box around a shape within which rays are cast against it, (2, 3).

    Lowest and highest coordinates in the frame of the shape, in metres.
    """
    return _shape_box_m(shape) + [[-AROUND_BODY_M], [AROUND_BODY_M]]


def find_obstructions(
    runs: Sequence[Run],
) -> tuple[list[tuple[PlacedActor, ...]], IntArray]:
    """Distinct obstructions, and which of them each run has.

    Obstructions are equal if they have the same bodies at the same places.

    Returns
    -------
    obstructions : list of tuple of PlacedActor
        In the order of their groups.
    index : (n_runs,) int
        Obstruction of each run.
    """
    # The key of each body once: bodies are in many runs.
    bodies = {body for run in runs for body in run.obstruction}
    keys = {body: body.key for body in bodies}
    of_runs = [tuple(keys[body] for body in run.obstruction) for run in runs]
    found: dict[tuple[object, ...], tuple[PlacedActor, ...]] = {}
    for key, run in zip(of_runs, runs, strict=True):
        found.setdefault(key, run.obstruction)
    numbers = {key: number for number, key in enumerate(found)}
    return [*found.values()], np.array([numbers[key] for key in of_runs])


def _build_standing(
    obstructions: Sequence[tuple[PlacedActor, ...]], origin_m: FloatArray, rays: str
) -> Bodies:
    """Standing bodies, a group for each obstruction.

    Parameters
    ----------
    obstructions : sequence of tuple of PlacedActor
        As :func:`find_obstructions` returns them.
    origin_m : (3,) float
        Subtracted from all coordinates. [m]
    rays : str
        Library that casts the rays.
    """
    found: dict[tuple[object, ...], PlacedActor] = {}
    for body in chain(*obstructions):
        found.setdefault(body.key, body)
    placed = [*found.values()]
    numbers = {key: number for number, key in enumerate(found)}
    groups = [
        [numbers[body.key] for body in obstruction] for obstruction in obstructions
    ]
    actors = {body.actor.shapes[0]: body.actor for body in placed}
    kinds = {shape: kind for kind, shape in enumerate(actors)}
    poses = [body.pose for body in placed]
    kind = [kinds[body.actor.shapes[0]] for body in placed]
    positions_m = [pose.position_m - origin_m for pose in poses]
    yaw_deg = [pose.yaw_deg for pose in poses]
    pitch_deg = [pose.pitch_deg for pose in poses]
    return Bodies(
        actors=tuple(actors.values()),
        casters=tuple(shape_caster(shape, rays) for shape in actors),
        kind=np.array(kind, dtype=np.int64),
        position_m=np.array(positions_m).reshape(-1, 3),
        rotation=body_rotation(yaw_deg, pitch_deg),
        members=np.array([body for group in groups for body in group], dtype=np.int64),
        first=np.cumsum([0, *map(len, groups)]),
    )


def _build_vehicles(
    runs: Sequence[Run], origin_m: FloatArray, rays: str, terrain: Terrain | None
) -> Bodies:
    """Driving bodies, a group for each frame of the frame axis.

    Parameters
    ----------
    runs : sequence of Run
        All have the same VUT.
    origin_m : (3,) float
        Subtracted from all coordinates. [m]
    rays : str
        Library that casts the rays.
    terrain : Terrain, optional
        Ground that bodies stand on; without one it is level.
    """
    actors = {runs[0].encounter.vut: 0}
    kind = []
    frame = []
    position = []
    yaw = []
    n_frames = 0
    for run in runs:
        vut = MovingActor(
            actor=run.encounter.vut,
            position_m=run.vut_position_m,
            yaw_deg=run.vut_yaw_deg,
        )
        for body in (vut, *run.traffic):
            there = np.flatnonzero(body.is_there)
            kind.append(np.full(len(there), actors.setdefault(body.actor, len(actors))))
            frame.append(n_frames + there)
            position.append(on_ground(body.position_m[there], terrain) - origin_m)
            yaw.append(body.yaw_deg[there])
        n_frames += len(run.time_s)
    members = np.argsort(np.concatenate(frame), kind="stable")
    counts = np.bincount(np.concatenate(frame), minlength=n_frames)
    return Bodies(
        actors=tuple(actors),
        casters=tuple(shape_caster(actor.shapes[0], rays) for actor in actors),
        kind=np.concatenate(kind),
        position_m=np.concatenate(position),
        rotation=body_rotation(np.concatenate(yaw)),
        members=members,
        first=np.concatenate([[0], np.cumsum(counts)]),
    )


# ---------- all that rays meet
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedScene:
    """Everything that all sampled worlds of a scene have in common.

    Attributes
    ----------
    origin_m : (3,) float
        Subtracted from all coordinates, since rays have single precision. [m]
    caster : RayCaster
        What stands there in all runs.
    triangles_m : (n, 3, 3) float
        Corners of its triangles, relative to `origin_m`. [m]
    places : Places
        Where VRUs are looked at.
    bodies : tuple of RayCaster
        Shape of each surface of `places`, in its own frame.
    vehicles : Bodies, optional
        What drives, if it is the same in all worlds.
    hidden_by_scene : HiddenPoints, optional
        Cache of points of places that the scene occludes.
    hidden_by_itself : HiddenPoints, optional
        Cache of points of places that the VRU's own body occludes.
    hidden_by_vehicles : HiddenPoints, optional
        Cache of points that `vehicles` occlude in each frame.
    """

    origin_m: FloatArray
    caster: RayCaster
    triangles_m: FloatArray
    places: Places
    bodies: tuple[RayCaster, ...]
    vehicles: Bodies | None = None
    hidden_by_scene: HiddenPoints | None = None
    hidden_by_itself: HiddenPoints | None = None
    hidden_by_vehicles: HiddenPoints | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """All that rays are cast against, and all that they are cast to.

    Attributes
    ----------
    shared : SharedScene
        What other worlds of the same scene have, too.
    standing : Bodies
        What stands there in some runs.
    vehicles : Bodies
        What drives.
    views : VruViews
        What is looked at.
    """

    shared: SharedScene
    standing: Bodies
    vehicles: Bodies
    views: VruViews

    @property
    def origin_m(self) -> FloatArray:
        """Point subtracted from every coordinate, (3,), in metres."""
        return self.shared.origin_m

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Distinct shapes of the VRUs."""
        return self.shared.places.surfaces

    @property
    def radius_m(self) -> float:
        """Distance from their mean within which all points of any VRU lie.

        In metres.
        """
        return max(surface.radius_m for surface in self.surfaces)

    @property
    def height_limits_m(self) -> tuple[float, float]:
        """Bounds on the height of all points of any VRU, low and high.

        In metres; each bound adds the extremes of the bodies and of the ground.
        """
        heights = [surface.points_m[:, 2] for surface in self.surfaces]
        ground = self.views.up_m
        low = float(np.min(heights) + ground.min())
        high = float(np.max(heights) + ground.max())
        return low, high


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Visible points of the VRU from one mount position, in any direction.

    Attributes
    ----------
    view_index : (n,) int
        View of each entry.
    is_visible : (n, n_points) bool
        Points that the rays reach. Of a whole VRU it may be all points; see
        :func:`cast_sight`.
    is_whole : (n,) bool
        Nothing but the VRU itself occludes any of its points.
    visible_share : (n,) float
        Of the points that the VRU itself does not occlude, the share that nothing
        occludes.
    entry_of_frame : (n_frames,) int
        Entry that each frame shows; -1 where nothing of the VRU is seen.
    """

    view_index: IntArray
    is_visible: BoolArray
    is_whole: BoolArray
    visible_share: FloatArray
    entry_of_frame: IntArray


def build_world(
    scene: Scene,
    runs: Sequence[Run],
    *,
    n_points: int,
    seed: int,
    rays: str = "auto",
    shared: SharedScene | None = None,
) -> World:
    """Prepare scene, bodies and views for :func:`cast_sight`.

    The result may be used from any thread.

    Parameters
    ----------
    scene : Scene
        What stands there in all runs.
    runs : sequence of Run
        All have the same VUT.
    n_points : int
        Points on each VRU.
    seed : int
        Of the random samples among which the points are chosen.
    rays : str
        Library that casts the rays.
    shared : SharedScene, optional
        What another world of the same scene and VRUs was built from.
    """
    if shared is None:
        shared = build_shared_scene(
            scene, runs, n_points=n_points, seed=seed, rays=rays
        )
    origin = shared.origin_m
    obstructions, obstruction_index = find_obstructions(runs)
    return World(
        shared=shared,
        standing=_build_standing(obstructions, origin, rays),
        vehicles=shared.vehicles
        or _build_vehicles(runs, origin, rays, terrain_of(scene)),
        views=build_views(shared.places, runs, obstruction_index),
    )


def build_shared_scene(
    scene: Scene,
    runs: Sequence[Run],
    *,
    n_points: int,
    seed: int,
    rays: str = "auto",
    caches: Literal["nothing", "still", "all"] = "nothing",
) -> SharedScene:
    """Prepare everything that worlds of one scene share.

    Parameters
    ----------
    scene : Scene
        What stands there in all runs.
    runs : sequence of Run
        VRUs walk in all worlds as they do in these.
    n_points, seed, rays
        As in :func:`build_world`.
    caches : {"nothing", "still", "all"}
        What to cache, for mounts that come up again: the points that standing
        things occlude ("still"), or also those behind vehicles, which then drive
        the same way in all worlds ("all").
    """
    origin = np.append(scene.outline_m.mean(axis=0), 0.0)
    places = build_places(scene, runs, origin, n_points=n_points, seed=seed)
    vertices_m = scene.vertices_m - origin
    shapes = [one.actor.shapes[one.shape_index] for one in places.surfaces]
    vehicles = None
    hidden_by_scene = None
    hidden_by_itself = None
    hidden_by_vehicles = None
    if caches != "nothing":
        n_places = len(places.yaw_deg)
        hidden_by_scene = HiddenPoints(n_places, n_points)
        hidden_by_itself = HiddenPoints(n_places, n_points)
    if caches == "all":
        vehicles = _build_vehicles(runs, origin, rays, terrain_of(scene))
        hidden_by_vehicles = HiddenPoints(len(places.place_of_frame), n_points)
    return SharedScene(
        origin_m=origin,
        caster=build_caster(vertices_m, scene.triangles, library=rays),
        triangles_m=vertices_m[scene.triangles],
        places=places,
        bodies=tuple(shape_caster(shape, rays) for shape in shapes),
        vehicles=vehicles,
        hidden_by_scene=hidden_by_scene,
        hidden_by_itself=hidden_by_itself,
        hidden_by_vehicles=hidden_by_vehicles,
    )


def cast_sight(
    world: World,
    position_m: FloatArray,
    *,
    near_m: float,
    max_distance_m: float = np.inf,
    is_asked: BoolArray | None = None,
    is_foreseen: BoolArray | None = None,
    for_lidar: bool = True,
) -> Sight:
    """Find the visible points of all VRUs from a mount position.

    Parameters
    ----------
    world : World
        What rays are cast against and to.
    position_m : (3,) float
        The mount, world frame. [m]
    near_m : float
        Things nearer to the lens occlude nothing. [m]
    max_distance_m : float
        VRUs farther away are not looked at. [m]
    is_asked : (n_views,) bool, optional
        Views to look at; by default all.
    is_foreseen : (n_views,) bool, optional
        Views that may be asked for later from the same eye. Where hidden points are
        cached, it costs less to find them now.
    for_lidar : bool
        Points that a body itself occludes do not matter to a camera as long as
        nothing else occludes anything. If False, no rays are cast for them, and all
        points of such a body count as visible.

    Returns
    -------
    sight : Sight
        Without the views of which nothing is seen.

    Notes
    -----
    Rays are cast only where something may stand in their way. First come things that
    occlude a view in every frame: the scene, then standing bodies. Then come the
    vehicles of each frame; a frame in which they occlude something more gets an entry
    of its own.
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    ground_distance = np.hypot(*(views.position_m - eye[:2]).T)
    distance = np.hypot(ground_distance, eye[2] - views.up_m)
    is_near = distance <= max_distance_m
    if is_asked is not None:
        is_near = is_near & is_asked
    near_views = np.flatnonzero(is_near)
    foreseen = None
    if is_foreseen is not None:
        foreseen = np.flatnonzero(is_foreseen)
    # Points that the scene occludes, and bodies that stand in some of the runs.
    blocked = _hidden_by_scene(world, eye, near_views, foreseen, near_m=near_m)
    obstruction = views.obstruction_index[near_views]
    row, body = _find_between(world, eye, world.standing, near_views, obstruction)
    _add_hidden_by_bodies(
        world, eye, world.standing, body, near_views[row], row, blocked, near_m=near_m
    )
    # Rows of which something is left, and what vehicles occlude of them in each frame.
    n_blocked = _count_points(blocked)
    row_of_view = np.full(len(views.yaw_deg), -1)
    is_left = n_blocked < blocked.shape[1]
    row_of_view[near_views[is_left]] = np.flatnonzero(is_left)
    row_of_frame = row_of_view[views.view_of_frame]
    frames, behind = _hidden_by_vehicles(
        world, eye, row_of_frame, blocked, near_m=near_m
    )
    rows = row_of_frame[frames]

    # In or right next to a body the body may hide all of itself.
    away_m = np.linalg.norm(views.middle_m[near_views] - eye, axis=1)
    is_close = away_m < 2.0 * views.radius_m[near_views]
    is_cast = is_left & (for_lidar | (n_blocked > 0) | is_close)
    is_cast[rows] = True
    faces_eye = np.ones(blocked.shape, dtype=bool)
    asked = np.flatnonzero(is_cast)
    faces_eye[asked] = _is_self_visible(world, eye, near_views[asked])

    # Entries: first a row each, as it is seen where no vehicle is in the way.
    is_visible = faces_eye & ~blocked
    n_visible = _count_points(is_visible)
    n_facing = _count_points(faces_eye)
    is_seen = n_visible > 0
    # One entry more, for frames without a row.
    entry_of_row: IntArray = np.full(len(near_views) + 1, -1)
    entry_of_row[np.flatnonzero(is_seen)] = np.arange(int(is_seen.sum()))
    entry_of_frame: IntArray = entry_of_row[row_of_frame]
    # A vehicle hides a part only if it is one that would be seen.
    left_visible = is_visible[rows] & ~behind
    is_less = is_seen[rows] & (left_visible != is_visible[rows]).any(axis=1)
    frames = frames[is_less]
    rows = rows[is_less]
    left_visible = left_visible[is_less]
    # More entries: frames of which vehicles leave something; the others show nothing.
    is_more = left_visible.any(axis=1)
    n_seen = int(is_seen.sum())
    entry_of_frame[frames] = -1
    entry_of_frame[frames[is_more]] = n_seen + np.arange(int(is_more.sum()))
    shown_rows = np.concatenate([np.flatnonzero(is_seen), rows[is_more]])
    shown = np.concatenate([is_visible[is_seen], left_visible[is_more]])
    is_whole = n_visible[is_seen] == n_facing[is_seen]
    n_shown = np.concatenate([n_visible[is_seen], _count_points(left_visible[is_more])])
    return Sight(
        view_index=near_views[shown_rows],
        is_visible=shown,
        is_whole=np.concatenate([is_whole, np.zeros(int(is_more.sum()), dtype=bool)]),
        visible_share=n_shown / n_facing[shown_rows],
        entry_of_frame=entry_of_frame,
    )


def _count_points(mask: BoolArray) -> IntArray:
    """How many points of each row of a mask (n, n_points) are True, (n,).

    As bytes, which numpy adds four times as fast as booleans.
    """
    counts: IntArray = mask.view(np.uint8).sum(axis=1, dtype=np.uint16).astype(np.int64)
    return counts


def _is_self_visible(
    world: World, eye_m: FloatArray, view_index: IntArray
) -> BoolArray:
    """Mask of points that the VRU's own body does not occlude.

    Parameters
    ----------
    world : World
        All bodies.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    view_index : (n,) int
        Views to look at.

    Returns
    -------
    is_visible : (n, n_points) bool
    """
    shared = world.shared
    places = shared.places

    def find(index: IntArray) -> BoolArray:
        offset = np.column_stack(
            [eye_m[:2] - places.position_m[index], eye_m[2] - places.up_m[index]]
        )
        # Row vectors times R_world_body = coordinates in the body frame.
        eyes_m = np.einsum("ni,nij->nj", offset, body_rotation(places.yaw_deg[index]))
        hidden = np.empty((len(index), places.axes_m.shape[2]), dtype=bool)
        for number in np.unique(places.surface_index[index]).tolist():
            rows = np.flatnonzero(places.surface_index[index] == number)
            hidden[rows] = _find_self_hidden(
                places.surfaces[number], shared.bodies[number], eyes_m[rows]
            )
        return hidden

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    return ~look(shared.hidden_by_itself, eye_m.tobytes(), asked, find)[row]


def _find_self_hidden(
    surface: Surface, caster: RayCaster, eyes_m: FloatArray
) -> BoolArray:
    """Mask of a body's points that the body itself hides from eyes.

    Parameters
    ----------
    surface : Surface
        The body.
    caster : RayCaster
        Its shape, in its own frame.
    eyes_m : (n, 3) float
        Frame of the body. [m]

    Returns
    -------
    is_hidden : (n, n_points) bool

    Notes
    -----
    Rays end just before a point. Where the point's face is seen from behind, that is
    inside of the closed body: the body hides it from any eye outside. All other points
    need rays.
    """
    from .ray_kernels import EyesOnBody, fill_own_rays

    own, reach_m = _own_points(surface)
    distance_m = np.sqrt((eyes_m**2).sum(axis=1))
    share = 1.0 - _OFF_SURFACE_M / np.maximum(distance_m, 1.0e-9)
    # Next to the body, or in it, every point gets a ray.
    longest_m = np.where(distance_m > 2.0 * reach_m, distance_m + reach_m, np.inf)
    eyes = EyesOnBody(eyes_m, share.astype(np.float32), longest_m)
    is_hidden = np.zeros((len(eyes_m), len(own.points)), dtype=bool)
    starts = np.empty((is_hidden.size, 3), np.float32)
    vectors = np.empty((is_hidden.size, 3), np.float32)
    n_rays = fill_own_rays(own, eyes, starts, vectors, is_hidden)
    is_asked = ~is_hidden
    is_hidden[is_asked] = caster.is_blocked(starts[:n_rays], vectors[:n_rays])
    return is_hidden


# Mounts look at the same few bodies.
@lru_cache(maxsize=256)
def _own_points(surface: Surface) -> tuple["OwnPoints", float]:
    """Points of a body for rays, and how far they are from its origin, in metres."""
    from .ray_kernels import OwnPoints

    points_m = surface.points_m
    own = OwnPoints(
        points=points_m.astype(np.float32),
        outward=surface.outward,
        face_m=(points_m * surface.outward).sum(axis=1),
        least_sine=surface.least_sine,
    )
    return own, float(np.linalg.norm(points_m, axis=1).max())


def _hidden_by_scene(
    world: World,
    eye_m: FloatArray,
    view_index: IntArray,
    foreseen: IntArray | None,
    *,
    near_m: float,
) -> BoolArray:
    """Mask of points that the scene occludes in all runs.

    Parameters
    ----------
    world : World
        Scene and views.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    view_index : (n,) int
        Views to look at.
    foreseen : (k,) int, optional
        More views whose hidden points are cached.
    near_m : float
        Things nearer to the eye occlude nothing. [m]

    Returns
    -------
    hidden : (n, n_points) bool
    """
    from .ray_kernels import (
        N_AROUND,
        N_UP,
        BodyViews,
        Rays,
        fill_rays,
        find_unclear_points,
        mark_nearest,
    )

    shared = world.shared
    places = shared.places

    def find(index: IntArray) -> BoolArray:
        unclear = np.zeros((len(index), places.axes_m.shape[2]), dtype=bool)
        if len(index) == 0:
            return unclear
        # Things farther than this are behind all bodies.
        away_m = np.hypot(*(places.position_m[index] - eye_m[:2]).T)
        farthest_m = float(np.hypot(away_m, eye_m[2] - places.up_m[index]).max())
        far_m = farthest_m + 2.0 * world.radius_m + 1.0
        nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
        mark_nearest(
            nearest, shared.triangles_m, eye_m, near_m, far_m, *world.height_limits_m
        )
        views = BodyViews(places.axes_m, places.middle_m, places.radius_m)
        find_unclear_points(nearest, views, eye_m, index, unclear)
        is_unclear = unclear.any(axis=1)
        is_behind = np.zeros(len(index), dtype=bool)
        is_behind[is_unclear] = _is_behind_one_triangle(
            shared, eye_m, index[is_unclear], near_m=near_m
        )
        unclear[is_behind] = False
        room = (np.count_nonzero(unclear), 3)
        starts = np.empty(room, np.float32)
        vectors = np.empty(room, np.float32)
        rays = Rays(near_m, _OFF_SURFACE_M, starts, vectors)
        fill_rays(places.axes_m, index, unclear, eye_m, rays)
        # Rays are in the order of the points that are unclear.
        unclear[unclear] = shared.caster.is_blocked(starts, vectors)
        unclear[is_behind] = True
        return unclear

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    later = None
    if foreseen is not None:
        later = world.views.place_index[foreseen]
    eye = (near_m, eye_m.tobytes())
    return look(shared.hidden_by_scene, eye, asked, find, foreseen=later)[row]


def _is_behind_one_triangle(
    shared: SharedScene, eye_m: FloatArray, place_index: IntArray, *, near_m: float
) -> BoolArray:
    """Mask of bodies of which one triangle of the scene hides every point.

    Walls are large and bodies small: one ray tells of most hidden bodies what
    otherwise each of their points needs a ray for.

    Parameters
    ----------
    shared : SharedScene
        Scene and places.
    eye_m : (3,) float
        The mount, relative to the origin of `shared`. [m]
    place_index : (n,) int
        Places of the bodies.
    near_m : float
        Things nearer to the eye hide nothing. [m]

    Returns
    -------
    is_behind : (n,) bool
        False also says that it is not known.

    Notes
    -----
    The first triangle on the way to a body's middle is looked at. Its shadow is bounded
    by the triangle, and by three planes through the eye and each of its sides. A body
    is hidden if the sphere around its points lies within the shadow.
    """
    places = shared.places
    middle_m = places.middle_m[place_index] - eye_m
    wide_m = places.radius_m[place_index] + _OFF_SURFACE_M
    away_m = np.linalg.norm(middle_m, axis=1)
    begin_m = middle_m * (near_m / np.maximum(away_m, near_m))[:, None]
    starts = (begin_m + eye_m).astype(np.float32)
    vectors = (middle_m - begin_m).astype(np.float32)
    share, number = shared.caster.first_triangle(starts, vectors)
    is_behind: BoolArray = share < 1.0
    corners_m = shared.triangles_m[number] - eye_m
    normal = np.cross(
        corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1.0e-12)[:, None]
    # Distances from the eye along the normal: of the triangle, and of the body.
    triangle_m = np.einsum("ni,ni->n", normal, corners_m[:, 0])
    body_m = np.einsum("ni,ni->n", normal, middle_m) * np.sign(triangle_m)
    triangle_m = np.abs(triangle_m)
    is_behind &= triangle_m >= near_m + _OFF_SURFACE_M
    is_behind &= body_m >= triangle_m + wide_m
    # The planes through the eye and a side; the third corner is within.
    for side in range(3):
        plane = np.cross(corners_m[:, side], corners_m[:, (side + 1) % 3])
        plane /= np.maximum(np.linalg.norm(plane, axis=1), 1.0e-12)[:, None]
        within_m = np.einsum("ni,ni->n", plane, corners_m[:, (side + 2) % 3])
        inside_m = np.einsum("ni,ni->n", plane, middle_m) * np.sign(within_m)
        is_behind &= inside_m >= wide_m
    return is_behind


def _find_between(
    world: World,
    eye_m: FloatArray,
    bodies: Bodies,
    view_index: IntArray,
    group: IntArray,
) -> tuple[IntArray, IntArray]:
    """Find the bodies that may occlude points of views.

    Parameters
    ----------
    world : World
        All views.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    bodies : Bodies
        Bodies in groups.
    view_index : (n,) int
        View of each row.
    group : (n,) int
        Group of bodies that are there in each row.

    Returns
    -------
    row, body : (n_pairs,) int
        The body may occlude points of the view of the row.
    """
    from .ray_kernels import BodyViews, Occluders, find_bodies_between

    if not len(bodies.kind):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    boxes = np.array([_box_m(actor.shapes[0]) for actor in bodies.actors])[bodies.kind]
    pairs = np.empty((int(np.diff(bodies.first)[group].sum()), 2), dtype=np.int32)
    seen = world.views
    views = BodyViews(seen.axes_m, seen.middle_m, seen.radius_m)
    occluders = Occluders(
        members=bodies.members,
        first=bodies.first,
        position=bodies.position_m,
        rotation=bodies.rotation,
        boxes=boxes,
    )
    n_pairs = find_bodies_between(views, eye_m, view_index, group, occluders, pairs)
    row, body = pairs[:n_pairs].T.astype(np.int64)
    return row, body


def _add_hidden_by_bodies(
    world: World,
    eye_m: FloatArray,
    bodies: Bodies,
    body_index: IntArray,
    view_index: IntArray,
    row_index: IntArray,
    hidden: BoolArray,
    *,
    near_m: float,
) -> None:
    """Mark the points that bodies occlude, in place.

    Parameters
    ----------
    world : World
        All views.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    bodies : Bodies
        What occludes.
    body_index : (n_pairs,) int
        Body that is there ...
    view_index : (n_pairs,) int
        ... while this view is looked at,
    row_index : (n_pairs,) int
        whose points have this row of `hidden`.
    hidden : (n_rows, n_points) bool
        Points that are occluded; True is added. Points that are True need no ray.
    near_m : float
        Things nearer to the eye occlude nothing. [m]
    """
    from .ray_kernels import OneKind, Rays, find_rays_at_body

    for kind, (actor, caster) in enumerate(
        zip(bodies.actors, bodies.casters, strict=True)
    ):
        of_kind = np.flatnonzero(bodies.kind[body_index] == kind)
        of_kind = of_kind[np.argsort(row_index[of_kind], kind="stable")]
        low_m, high_m = _box_m(actor.shapes[0])
        for start in range(0, len(of_kind), _ROWS_TOGETHER):
            chosen = of_kind[start : start + _ROWS_TOGETHER]
            row = row_index[chosen]
            body = body_index[chosen]
            blocked = np.zeros((len(chosen), hidden.shape[1]), dtype=bool)
            starts = np.empty((blocked.size, 3), np.float32)
            vectors = np.empty((blocked.size, 3), np.float32)
            n_rays = find_rays_at_body(
                world.views.axes_m,
                view_index[chosen],
                hidden[row],
                eye_m,
                OneKind(bodies.position_m[body], bodies.rotation[body], low_m, high_m),
                Rays(near_m, _OFF_SURFACE_M, starts, vectors),
                blocked,
            )
            # So far `blocked` says which points got a ray, in the order of the rays.
            blocked[blocked] = caster.is_blocked(starts[:n_rays], vectors[:n_rays])
            shown, first = np.unique(row, return_index=True)
            hidden[shown] |= np.logical_or.reduceat(blocked, first, axis=0)


def _hidden_by_vehicles(
    world: World,
    eye_m: FloatArray,
    row_of_frame: IntArray,
    hidden: BoolArray,
    *,
    near_m: float,
) -> tuple[IntArray, BoolArray]:
    """Frames in which vehicles occlude points, and all points hidden then.

    Parameters
    ----------
    world : World
        Vehicles and views.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    row_of_frame : (n_frames,) int
        Row of `hidden` that each frame shows; frames with -1 are left out.
    hidden : (n_rows, n_points) bool
        Points that are occluded in any case.
    near_m : float
        Things nearer to the eye occlude nothing. [m]

    Returns
    -------
    frames : (n,) int
        Frames in which vehicles occlude at least one more point.
    behind : (n, n_points) bool
        Points occluded in those frames, by anything.
    """
    vehicles = world.vehicles
    cache = world.shared.hidden_by_vehicles
    view_of_frame = world.views.view_of_frame
    shown = np.flatnonzero(row_of_frame >= 0)
    row, body = _find_between(world, eye_m, vehicles, view_of_frame[shown], shown)
    frame = shown[row]
    frames = np.unique(frame)
    before = hidden[row_of_frame[frames]]

    def add_behind(asked: IntArray, behind: BoolArray) -> BoolArray:
        """Add the points behind vehicles in frames, all of them among those above."""
        row_of = np.full(len(row_of_frame), -1)
        row_of[asked] = np.arange(len(asked))
        chosen = np.flatnonzero(row_of[frame] >= 0)
        at = frame[chosen]
        _add_hidden_by_bodies(
            world,
            eye_m,
            vehicles,
            body[chosen],
            view_of_frame[at],
            row_of[at],
            behind,
            near_m=near_m,
        )
        return behind

    def find(asked: IntArray) -> BoolArray:
        """Points behind vehicles alone: what else hides a point differs by world."""
        return add_behind(asked, np.zeros((len(asked), hidden.shape[1]), dtype=bool))

    if cache is None:
        behind = add_behind(frames, before.copy())
    else:
        behind = before | cache.look((near_m, eye_m.tobytes()), frames, find)
    is_hit = (behind != before).any(axis=1)
    return frames[is_hit], behind[is_hit]
