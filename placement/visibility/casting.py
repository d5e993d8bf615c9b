"""Rays from a mount position to the VRU's points: once per position and unique VRU pose.

A ray does not depend on where the camera looks, and the VRU's pose and gait depend on
the time to impact only, not on the VUT's speed. Few kinds of bodies stand or drive in
many places: rays are taken into the frame of each body that they may meet, and cast
against its shape there, so that what is prepared for a shape serves wherever it is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Literal

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

AROUND_BODY_M = 2.0e-3  # rays that pass a body this near are cast
_OFF_SURFACE_M = 1.0e-3
_ROWS_TOGETHER = 4096  # of bodies, whose rays are cast in one go


# ---------- bodies
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bodies:
    """Bodies that are there in some of the runs, or in some frames; in groups.

    Of what stands, a group is an obstruction, as some of the runs have it; of what
    drives, the VUT among it, a group is a frame of the frame axis.
    """

    actors: tuple[
        Actor, ...
    ]  # distinct kinds of bodies; of what drives the VUT comes first
    casters: tuple[RayCaster, ...]  # of each kind, in its own frame
    kind: IntArray  # (n,): into `actors`
    position_m: (
        FloatArray  # (n, 3): on the ground, relative to the origin of `World`. [m]
    )
    rotation: FloatArray  # (n, 3, 3): from the frame of each into the world's
    members: IntArray  # (m,): bodies, group by group
    first: IntArray  # (n_groups + 1,): where each group begins in `members`

    def first_hits(
        self, group: int, origins_m: FloatRays, vectors_m: FloatRays
    ) -> Iterator[tuple[int, FloatRays]]:
        """Bodies of a group, each with the share of every ray up to its first hit on it."""
        for body in self.members[self.first[group] : self.first[group + 1]].tolist():
            rotation = self.rotation[body]
            yield (
                body,
                self.casters[self.kind[body]].first_triangle(
                    ((origins_m - self.position_m[body]) @ rotation).astype(np.float32),
                    (vectors_m @ rotation).astype(np.float32),
                )[0],
            )


@lru_cache(maxsize=256)
def shape_caster(shape: Shape, rays: str) -> RayCaster:
    """Caster of a body in its own frame; tables of many worlds ask for the same ones."""
    return build_caster(shape.vertices_m, shape.triangles, library=rays)


@lru_cache(maxsize=256)
def _shape_box_m(shape: Shape) -> FloatArray:
    return freeze(
        np.array([shape.vertices_m.min(axis=0), shape.vertices_m.max(axis=0)])
    )


def _box_m(shape: Shape) -> FloatArray:
    """Lowest and highest coordinates, (2, 3), of all ways that are cast against a shape."""
    return _shape_box_m(shape) + [[-AROUND_BODY_M], [AROUND_BODY_M]]


def find_obstructions(
    runs: Sequence[Run],
) -> tuple[list[tuple[PlacedActor, ...]], IntArray]:
    """Distinct obstructions in the order of their groups, and which each run has, (n_runs,).

    Those are equal that have the same bodies at the same places.
    """
    keys = {
        body: body.key for body in {body for run in runs for body in run.obstruction}
    }
    of_runs = [tuple(keys[body] for body in run.obstruction) for run in runs]
    found: dict[tuple[object, ...], tuple[PlacedActor, ...]] = {}
    for key, run in zip(of_runs, runs, strict=True):
        found.setdefault(key, run.obstruction)
    numbers = {key: number for number, key in enumerate(found)}
    return [*found.values()], np.array([numbers[key] for key in of_runs])


def _build_standing(
    obstructions: Sequence[tuple[PlacedActor, ...]], origin_m: FloatArray, rays: str
) -> Bodies:
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
    return Bodies(
        actors=tuple(actors.values()),
        casters=tuple(shape_caster(shape, rays) for shape in actors),
        kind=np.array([kinds[body.actor.shapes[0]] for body in placed], dtype=np.int64),
        position_m=np.array([pose.position_m - origin_m for pose in poses]).reshape(
            -1, 3
        ),
        rotation=body_rotation(
            [p.yaw_deg for p in poses], [p.pitch_deg for p in poses]
        ),
        members=np.array([body for group in groups for body in group], dtype=np.int64),
        first=np.cumsum([0, *map(len, groups)]),
    )


def _build_vehicles(
    runs: Sequence[Run], origin_m: FloatArray, rays: str, terrain: Terrain | None
) -> Bodies:
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
    """Everything that all sampled worlds of a scene have in common."""

    # (3,): subtracted from all coordinates: rays have single precision. [m]
    origin_m: FloatArray
    caster: RayCaster  # what stands there in all runs
    triangles_m: (
        FloatArray  # (n, 3, 3): corners of its triangles, relative to `origin_m`. [m]
    )
    places: Places  # where VRUs are looked at
    bodies: tuple[
        RayCaster, ...
    ]  # their shapes in their own frame, of each of the surfaces
    vehicles: Bodies | None = None  # what drives, if that is the same in all of them
    # Caches: points of places that the scene hides, or the body itself; and points that
    # `vehicles` hide in each frame.
    hidden_by_scene: HiddenPoints | None = None
    hidden_by_itself: HiddenPoints | None = None
    hidden_by_vehicles: HiddenPoints | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """All that rays are cast against, and all that they are cast to."""

    shared: SharedScene
    standing: Bodies  # what stands there in some runs
    vehicles: Bodies  # what drives
    views: VruViews  # what is looked at

    @property
    def origin_m(self) -> FloatArray:
        """Subtracted from every coordinate, (3,), in metres."""
        return self.shared.origin_m

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Each distinct shape of a VRU."""
        return self.shared.places.surfaces

    @property
    def radius_m(self) -> float:
        """All points of any VRU lie this near to their mean, in metres."""
        return max(surface.radius_m for surface in self.surfaces)

    @property
    def height_limits_m(self) -> tuple[float, float]:
        """Heights of the lowest and the highest point of any VRU, in metres."""
        heights = [surface.points_m[:, 2] for surface in self.surfaces]
        ground = self.views.up_m
        return float(np.min(heights) + ground.min()), float(
            np.max(heights) + ground.max()
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Visible points of the VRU from one mount position, whatever the camera's direction."""

    view_index: IntArray  # (n,): view of each entry
    # (n, n_points): points that the rays reach; of a whole VRU maybe all, see
    # :func:`cast_sight`
    is_visible: BoolArray
    is_whole: BoolArray  # (n,): nothing but the VRU itself hides any of its points
    # (n,): of the points that the VRU itself does not hide, those that nothing hides
    visible_share: FloatArray
    # (n_frames,): entry that a frame shows; -1 where nothing of the VRU is seen
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
    """Prepare scene, bodies and views for :func:`cast_sight`, from any thread.

    All runs have the same VUT. `rays` names the library that casts them. `shared` is
    what another world of the same scene and VRUs was built from, where there is one.
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
    """Prepare everything that worlds of one scene share whose VRUs walk as in these runs.

    It caches the points that are hidden in all of them, where mounts come up again: by
    what stands "still", or by "all" if vehicles drive the same way, too.
    """
    origin = np.append(scene.outline_m.mean(axis=0), 0.0)
    places = build_places(scene, runs, origin, n_points=n_points, seed=seed)
    n_places, n_frames = len(places.yaw_deg), len(places.place_of_frame)

    def of_places() -> HiddenPoints | None:
        if caches == "nothing":
            return None
        return HiddenPoints(n_places, n_points)

    return SharedScene(
        origin_m=origin,
        caster=build_caster(scene.vertices_m - origin, scene.triangles, library=rays),
        triangles_m=(scene.vertices_m - origin)[scene.triangles],
        places=places,
        bodies=tuple(
            shape_caster(surface.actor.shapes[surface.shape_index], rays)
            for surface in places.surfaces
        ),
        vehicles=(
            _build_vehicles(runs, origin, rays, terrain_of(scene))
            if caches == "all"
            else None
        ),
        hidden_by_scene=of_places(),
        hidden_by_itself=of_places(),
        hidden_by_vehicles=(
            HiddenPoints(n_frames, n_points) if caches == "all" else None
        ),
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
    """Find the visible points from a mount position; entries without any are left out.

    Things nearer than `near_m` to the lens hide nothing; VRUs farther than
    `max_distance_m`, and views that are not asked for, (n_views,), are not looked at.
    Rays are cast where something may stand in their way. Points that a body itself
    hides are of no account for a camera as long as nothing else hides anything: with
    `for_lidar` false, no rays are cast for it, and all points of such a body are taken
    to be visible. Views that are foreseen, (n_views,), may be asked for later, from the
    same eye: it costs less to find out about them now, where that is cached.
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    ground_distance = np.hypot(*(views.position_m - eye[:2]).T)
    distance = np.hypot(ground_distance, eye[2] - views.up_m)
    is_near = distance <= max_distance_m
    near_views = np.flatnonzero(is_near if is_asked is None else is_near & is_asked)
    if is_foreseen is None:
        foreseen = None
    else:
        foreseen = np.flatnonzero(is_foreseen)
    blocked = _hidden_by_scene(world, eye, near_views, foreseen, near_m=near_m)
    obstruction = views.obstruction_index[near_views]
    row, body = _find_between(world, eye, world.standing, near_views, obstruction)
    _add_hidden_by_bodies(
        world, eye, world.standing, body, near_views[row], row, blocked, near_m=near_m
    )
    n_blocked = blocked.sum(axis=1)
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

    is_visible = faces_eye & ~blocked
    n_visible = is_visible.sum(axis=1)
    n_facing = faces_eye.sum(axis=1)
    is_seen = n_visible > 0
    entry_of_row: IntArray = np.full(
        len(near_views) + 1, -1
    )  # one more, for frames without a row
    entry_of_row[np.flatnonzero(is_seen)] = np.arange(int(is_seen.sum()))
    entry_of_frame: IntArray = entry_of_row[row_of_frame]
    # A vehicle hides a part only if it is one that would be seen.
    left_visible = is_visible[rows] & ~behind
    is_less = is_seen[rows] & (left_visible != is_visible[rows]).any(axis=1)
    frames = frames[is_less]
    rows = rows[is_less]
    left_visible = left_visible[is_less]
    is_more = left_visible.any(axis=1)
    n_seen = int(is_seen.sum())
    entry_of_frame[frames] = -1
    entry_of_frame[frames[is_more]] = n_seen + np.arange(int(is_more.sum()))
    shown_rows = np.concatenate([np.flatnonzero(is_seen), rows[is_more]])
    shown = np.concatenate([is_visible[is_seen], left_visible[is_more]])
    is_whole = n_visible[is_seen] == n_facing[is_seen]
    n_shown = np.concatenate([n_visible[is_seen], left_visible[is_more].sum(axis=1)])
    return Sight(
        view_index=near_views[shown_rows],
        is_visible=shown,
        is_whole=np.concatenate([is_whole, np.zeros(int(is_more.sum()), dtype=bool)]),
        visible_share=n_shown / n_facing[shown_rows],
        entry_of_frame=entry_of_frame,
    )


def _is_self_visible(
    world: World, eye_m: FloatArray, view_index: IntArray
) -> BoolArray:
    """Points that the VRU's own body does not hide, (n, n_points)."""
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
            starts, vectors = _rays_to_own_points(places.surfaces[number], eyes_m[rows])
            hidden[rows] = (
                shared.bodies[number].is_blocked(starts, vectors).reshape(len(rows), -1)
            )
        return hidden

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    return ~look(shared.hidden_by_itself, eye_m.tobytes(), asked, find)[row]


def _rays_to_own_points(
    surface: Surface, eyes_m: FloatArray
) -> tuple[FloatRays, FloatRays]:
    """Rays (n * n_points, 3) from eyes (n, 3) to just before a body's points, in its frame."""
    distance_m = np.sqrt((eyes_m**2).sum(axis=1))  # to the body's origin
    share = (1.0 - _OFF_SURFACE_M / np.maximum(distance_m, 1.0e-9)).astype(np.float32)
    eyes = eyes_m.astype(np.float32)[:, None]
    vectors: FloatRays = (surface.points_m.astype(np.float32) - eyes) * share[
        :, None, None
    ]
    return np.broadcast_to(eyes, vectors.shape).reshape(-1, 3), vectors.reshape(-1, 3)


def _hidden_by_scene(
    world: World,
    eye_m: FloatArray,
    view_index: IntArray,
    foreseen: IntArray | None,
    *,
    near_m: float,
) -> BoolArray:
    """Points hidden by what stands there in all runs, (n, n_points); `foreseen`: more views."""
    from .ray_kernels import (
        N_AROUND,
        N_UP,
        Rays,
        Views,
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
        views = Views(places.axes_m, places.middle_m, places.radius_m)
        find_unclear_points(nearest, views, eye_m, index, unclear)
        room = (np.count_nonzero(unclear), 3)
        starts = np.empty(room, np.float32)
        vectors = np.empty(room, np.float32)
        rays = Rays(near_m, _OFF_SURFACE_M, starts, vectors)
        fill_rays(places.axes_m, index, unclear, eye_m, rays)
        unclear[unclear] = shared.caster.is_blocked(starts, vectors)
        return unclear

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    if foreseen is None:
        later = None
    else:
        later = world.views.place_index[foreseen]
    return look(
        shared.hidden_by_scene, (near_m, eye_m.tobytes()), asked, find, foreseen=later
    )[row]


def _find_between(
    world: World,
    eye_m: FloatArray,
    bodies: Bodies,
    view_index: IntArray,
    group: IntArray,
) -> tuple[IntArray, IntArray]:
    """Rows and bodies (n_pairs,): body m of group `group[n]` may hide points of view n."""
    from .ray_kernels import Occluders, Views, find_bodies_between

    if not len(bodies.kind):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    boxes = np.array([_box_m(actor.shapes[0]) for actor in bodies.actors])[bodies.kind]
    pairs = np.empty((int(np.diff(bodies.first)[group].sum()), 2), dtype=np.int32)
    seen = world.views
    views = Views(seen.axes_m, seen.middle_m, seen.radius_m)
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
    """Add the points that bodies hide to rows of `hidden`, (n_rows, n_points).

    Body `body_index[n]` is there while view `view_index[n]` is looked at, whose points
    have row `row_index[n]`.
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
    """Frames (n,) in which vehicles hide points, and all that is hidden then, (n, n_points).

    Points of a view that are `hidden` (n_rows, n_points) in any case are among these;
    frames whose row is -1 are left out.
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

    if cache is None:
        behind = add_behind(frames, before.copy())
    else:
        behind = before | cache.look(
            (near_m, eye_m.tobytes()),
            frames,
            lambda asked: add_behind(
                asked, np.zeros((len(asked), hidden.shape[1]), dtype=bool)
            ),
        )
    is_hit = (behind != before).any(axis=1)
    return frames[is_hit], behind[is_hit]
