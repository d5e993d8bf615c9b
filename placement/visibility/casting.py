"""Rays from a mount position to the VRU's points: once per position and unique VRU pose.

A ray does not depend on where the camera looks, and the VRU's pose and gait depend on the time to
impact only, not on the VUT's speed. What moves needs no scene of its own: the rays are taken into
the frame of the VRU, or of the VUT, and cast against one fixed scene each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geometry.actors import Actor, MovingActor, PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.poses import body_rotation
from geometry.raycast import FloatRays, RayCaster, build_caster
from geometry.scene import Scene
from geometry.terrain import Terrain, on_ground, terrain_of
from scenarios.runs import Run

from .standing import (
    AROUND_BODY_M,
    Standing,
    bodies_mesh,
    box_m,
    build_standing,
    find_obstructions,
    shape_caster,
)
from .surfaces import Surface
from .views import HiddenPoints, Places, VruViews, build_places, build_views, count_in_rows


def build_static_mesh(
    scene: Scene, obstruction: tuple[PlacedActor, ...], origin_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices (n, 3) from an origin, and triangles (m, 3), of a scene with an obstruction."""
    vertices, triangles = bodies_mesh(obstruction, origin_m)
    return (
        np.concatenate([scene.vertices_m - origin_m, vertices]),
        np.concatenate([scene.triangles, triangles + np.int32(len(scene.vertices_m))]),
    )


def _corners(vertices_m: FloatArray, triangles: NDArray[np.int32]) -> FloatArray:
    corners: FloatArray = np.asarray(vertices_m, dtype=np.float64)[triangles]
    return corners.reshape(-1, 3, 3)


# ---------- rays


_OFF_SURFACE_M = 1.0e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Vehicles:
    """Bodies that move: the VUT, and what else drives by; one row for each and each frame."""

    actors: tuple[Actor, ...]  # distinct bodies, the VUT first
    casters: tuple[RayCaster, ...]  # of each, in its own frame
    actor_index: IntArray  # (n,): into `actors`
    frame: IntArray  # (n,): of the frame axis
    position_m: FloatArray  # (n, 3): on the ground, relative to the origin of `World`. [m]
    yaw_deg: FloatArray  # (n,): heading. [deg]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastingScene:
    """What does not change from one sampled world to the next."""

    # (3,): subtracted from every coordinate: rays are cast in single precision. [m]
    origin_m: FloatArray
    caster: RayCaster  # what stands there in all runs
    triangles_m: FloatArray  # (n, 3, 3): corners of its triangles, relative to `origin_m`. [m]
    places: Places  # where VRUs are looked at
    bodies: tuple[RayCaster, ...]  # their shapes in their own frame, of each of the surfaces
    vehicles: Vehicles | None = None  # what moves, if that is the same in all of them
    # what the scene hides of places, what bodies hide of themselves, and what `vehicles` hide in
    # each frame; where that is kept
    hidden_by_scene: HiddenPoints | None = None
    hidden_by_itself: HiddenPoints | None = None
    hidden_by_vehicles: HiddenPoints | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """All that rays are cast against, and all that they are cast to."""

    lasting: LastingScene
    standing: Standing  # what stands there in some runs
    vehicles: Vehicles  # what moves
    views: VruViews  # what is looked at

    @property
    def origin_m(self) -> FloatArray:
        """What is subtracted from every coordinate, (3,), in metres."""
        return self.lasting.origin_m

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Each distinct shape of a VRU."""
        return self.lasting.places.surfaces

    @property
    def radius_m(self) -> float:
        """All points of any VRU lie this near to their mean, in metres."""
        return max(surface.radius_m for surface in self.surfaces)

    @property
    def height_limits_m(self) -> tuple[float, float]:
        """Heights of the lowest and the highest point of any VRU, in metres."""
        heights = [surface.points_m[:, 2] for surface in self.surfaces]
        ground = self.views.up_m
        return float(np.min(heights) + ground.min()), float(np.max(heights) + ground.max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Visible points of the VRU from one mount position, whatever the camera's direction."""

    view_index: IntArray  # (n,): view of each entry
    # (n, n_points): points that the rays reach; of a whole VRU maybe all, see :func:`cast_sight`
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
    lasting: LastingScene | None = None,
) -> World:
    """Prepare scene, bodies and views for :func:`cast_sight`, from any thread.

    All runs have the same VUT. `rays` names the library that casts them. `lasting` is what another
    world of the same scene and VRUs was built from, where there is one.
    """
    if lasting is None:
        lasting = build_lasting_scene(scene, runs, n_points=n_points, seed=seed, rays=rays)
    origin = lasting.origin_m
    obstructions, obstruction_index = find_obstructions(runs)
    return World(
        lasting=lasting,
        standing=build_standing(obstructions, origin, rays),
        vehicles=lasting.vehicles or _build_vehicles(runs, origin, rays, terrain_of(scene)),
        views=build_views(lasting.places, runs, obstruction_index),
    )


def build_lasting_scene(
    scene: Scene,
    runs: Sequence[Run],
    *,
    n_points: int,
    seed: int,
    rays: str = "auto",
    keeps: Literal["nothing", "still", "all"] = "nothing",
) -> LastingScene:
    """Prepare what worlds of one scene share, in which the VRUs of runs walk as they do here.

    It keeps what is hidden in all of them, where mounts come up again: by what stands "still", or
    by "all" if vehicles drive the same way, too.
    """
    origin = np.append(scene.outline_m.mean(axis=0), 0.0)
    places = build_places(scene, runs, origin, n_points=n_points, seed=seed)
    n_places = len(places.yaw_deg)
    return LastingScene(
        origin_m=origin,
        caster=build_caster(scene.vertices_m - origin, scene.triangles, library=rays),
        triangles_m=_corners(scene.vertices_m - origin, scene.triangles),
        places=places,
        bodies=tuple(
            shape_caster(surface.actor.shapes[surface.shape_index], rays)
            for surface in places.surfaces
        ),
        vehicles=(
            _build_vehicles(runs, origin, rays, terrain_of(scene)) if keeps == "all" else None
        ),
        hidden_by_scene=None if keeps == "nothing" else HiddenPoints(n_places, n_points),
        hidden_by_itself=None if keeps == "nothing" else HiddenPoints(n_places, n_points),
        hidden_by_vehicles=(
            HiddenPoints(len(places.place_of_frame), n_points) if keeps == "all" else None
        ),
    )


def _build_vehicles(
    runs: Sequence[Run], origin_m: FloatArray, rays: str, terrain: Terrain | None
) -> Vehicles:
    actors = {runs[0].encounter.vut: 0}
    index, frame, position, yaw = [], [], [], []
    first = 0
    for run in runs:
        vut = MovingActor(
            actor=run.encounter.vut, position_m=run.vut_position_m, yaw_deg=run.vut_yaw_deg
        )
        for body in (vut, *run.traffic):
            there = np.flatnonzero(body.is_there)
            index.append(np.full(len(there), actors.setdefault(body.actor, len(actors))))
            frame.append(first + there)
            position.append(on_ground(body.position_m[there], terrain) - origin_m)
            yaw.append(body.yaw_deg[there])
        first += len(run.time_s)
    return Vehicles(
        actors=tuple(actors),
        casters=tuple(shape_caster(actor.shapes[0], rays) for actor in actors),
        actor_index=np.concatenate(index),
        frame=np.concatenate(frame),
        position_m=np.concatenate(position),
        yaw_deg=np.concatenate(yaw),
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
    """Find what is seen from a mount position; entries without any visible point are left out.

    What is nearer than `near_m` to the lens hides nothing; VRUs farther than `max_distance_m`, and
    views that are not asked for, (n_views,), are not looked at. Rays are cast where something may
    stand in their way. What a body hides of itself is of no account for a camera as long as nothing
    else hides anything: with `for_lidar` false, no rays are cast for it, and all points of such a
    body are taken to be visible. Views that are foreseen, (n_views,), may be asked for later, from
    the same eye: it costs less to find out about them now, where that is kept.
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    ground_distance = np.hypot(*(views.position_m - eye[:2]).T)
    distance = np.hypot(ground_distance, eye[2] - views.up_m)
    is_near = distance <= max_distance_m
    near_views = np.flatnonzero(is_near if is_asked is None else is_near & is_asked)
    foreseen = None if is_foreseen is None else np.flatnonzero(is_foreseen)
    blocked = _hidden_by_scene(world, eye, near_views, foreseen, near_m=near_m)
    _add_hidden_by_standing(world, eye, near_views, blocked, near_m=near_m)
    n_blocked = count_in_rows(blocked)
    row_of_view = np.full(len(views.yaw_deg), -1)
    is_left = n_blocked < blocked.shape[1]
    row_of_view[near_views[is_left]] = np.flatnonzero(is_left)
    row_of_frame = row_of_view[views.view_of_frame]
    frames, behind = _hidden_by_vehicles(
        world, eye, row_of_frame, near_views, blocked, near_m=near_m
    )
    rows = row_of_frame[frames]

    is_cast = is_left & (for_lidar | (n_blocked > 0) | _is_close(world, eye, near_views))
    is_cast[rows] = True
    faces_eye = np.ones(blocked.shape, dtype=bool)
    asked = np.flatnonzero(is_cast)
    faces_eye[asked] = _is_self_visible(world, eye, near_views[asked])

    is_visible = faces_eye & ~blocked
    n_visible, n_facing = count_in_rows(is_visible), count_in_rows(faces_eye)
    is_seen = n_visible > 0
    entry_of_row: IntArray = np.full(len(near_views) + 1, -1)  # one more, for frames without a row
    entry_of_row[np.flatnonzero(is_seen)] = np.arange(int(is_seen.sum()))
    entry_of_frame: IntArray = entry_of_row[row_of_frame]
    # A vehicle hides a part only if it is one that would be seen.
    left_visible = is_visible[rows] & ~behind
    is_less = is_seen[rows] & (left_visible != is_visible[rows]).any(axis=1)
    frames, rows, left_visible = frames[is_less], rows[is_less], left_visible[is_less]
    is_more = left_visible.any(axis=1)
    n_seen = int(is_seen.sum())
    entry_of_frame[frames] = -1
    entry_of_frame[frames[is_more]] = n_seen + np.arange(int(is_more.sum()))
    shown_rows = np.concatenate([np.flatnonzero(is_seen), rows[is_more]])
    shown = np.concatenate([is_visible[is_seen], left_visible[is_more]])
    is_whole = n_visible[is_seen] == n_facing[is_seen]
    n_shown = np.concatenate([n_visible[is_seen], count_in_rows(left_visible[is_more])])
    return Sight(
        view_index=near_views[shown_rows],
        is_visible=shown,
        is_whole=np.concatenate([is_whole, np.zeros(int(is_more.sum()), dtype=bool)]),
        visible_share=n_shown / n_facing[shown_rows],
        entry_of_frame=entry_of_frame,
    )


def _is_close(world: World, eye_m: FloatArray, view_index: IntArray) -> BoolArray:
    """Views from in or just beside the body: it may hide all of itself."""
    distance = np.linalg.norm(world.views.middle_m[view_index] - eye_m, axis=1)
    is_close: BoolArray = distance < 2.0 * world.views.radius_m[view_index]
    return is_close


def _is_self_visible(world: World, eye_m: FloatArray, view_index: IntArray) -> BoolArray:
    """Points that the VRU's own body does not hide, (n, n_points)."""
    from .own_shadows import find_own_visible

    lasting = world.lasting
    places = lasting.places

    def find(index: IntArray) -> BoolArray:
        offset = np.column_stack(
            [eye_m[:2] - places.position_m[index], eye_m[2] - places.up_m[index]]
        )
        return ~find_own_visible(
            places.surfaces,
            lasting.bodies,
            surface_index=places.surface_index[index],
            # Row vectors times R_world_body = coordinates in the body frame.
            eye_m=np.einsum("ni,nij->nj", offset, body_rotation(places.yaw_deg[index])),
        )

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    if lasting.hidden_by_itself is None:
        hidden = find(asked)
    else:
        hidden = lasting.hidden_by_itself.look(eye_m.tobytes(), asked, find)
    return ~hidden[row]


def _hidden_by_scene(
    world: World,
    eye_m: FloatArray,
    view_index: IntArray,
    foreseen: IntArray | None,
    *,
    near_m: float,
) -> BoolArray:
    """Points hidden by what stands there in all runs, (n, n_points); some more may be foreseen."""
    from .shadow_kernels import (
        N_AROUND,
        N_UP,
        find_blocks,
        find_unclear_points,
        mark_covered,
        mark_nearest,
    )

    lasting = world.lasting
    places, triangles = lasting.places, lasting.triangles_m

    def find(index: IntArray) -> BoolArray:
        hidden = np.zeros((len(index), places.axes_m.shape[2]), dtype=bool)
        if len(index) == 0:
            return hidden
        # Things farther than this are behind all bodies.
        away_m = np.hypot(*(places.position_m[index] - eye_m[:2]).T)
        farthest_m = float(np.hypot(away_m, eye_m[2] - places.up_m[index]).max())
        far_m = farthest_m + 2.0 * world.radius_m + 1.0
        nearest = np.full((N_UP, N_AROUND), np.inf, dtype=np.float32)
        heights = world.height_limits_m
        mark_nearest(nearest, triangles, eye_m, near_m, far_m, *heights)
        covered = np.full_like(nearest, np.inf)
        is_asked = find_blocks(places.middle_m, places.radius_m, eye_m, index)
        mark_covered(covered, triangles, eye_m, near_m, *heights, is_asked)
        bodies = (places.axes_m, places.middle_m, places.radius_m, eye_m)
        unclear = np.zeros_like(hidden)
        find_unclear_points(nearest, covered, *bodies, index, hidden, unclear)
        _cast_to_points(lasting.caster, places.axes_m, eye_m, index, unclear, near_m=near_m)
        return hidden | unclear

    asked, row = np.unique(world.views.place_index[view_index], return_inverse=True)
    if lasting.hidden_by_scene is None:
        return find(asked)[row]
    if foreseen is not None:
        foreseen = world.views.place_index[foreseen]
    eye = near_m, eye_m.tobytes()
    return lasting.hidden_by_scene.look(eye, asked, find, foreseen=foreseen)[row]


def _add_hidden_by_standing(
    world: World, eye_m: FloatArray, view_index: IntArray, blocked: BoolArray, *, near_m: float
) -> None:
    """Add the points that standing bodies hide to `blocked`, (n, n_points)."""
    from .ray_kernels import find_bodies_between

    views, standing = world.views, world.standing
    if not len(standing.shape_index):
        return
    boxes = np.array([_box_m(shape) for shape in standing.shapes])[standing.shape_index]
    n_bodies = np.array([len(bodies) for bodies in standing.bodies])
    obstruction = views.obstruction_index[view_index]
    pairs = np.empty((int(n_bodies[obstruction].sum()), 2), dtype=np.int32)
    n_pairs = find_bodies_between(
        *(views.middle_m, views.radius_m, eye_m, view_index, obstruction),
        *(np.concatenate(standing.bodies), np.cumsum([0, *n_bodies])),
        *(standing.position_m, standing.rotation, boxes),
        pairs,
    )
    rows, bodies = pairs[:n_pairs].T.astype(np.int64)
    _add_hidden_by_bodies(
        *(world, eye_m, standing.shapes, standing.casters, standing.shape_index[bodies]),
        *(standing.position_m[bodies], standing.rotation[bodies]),
        view_index[rows],
        rows,
        blocked,
        near_m=near_m,
    )


def _box_m(shape: Shape) -> FloatArray:
    """Lowest and highest coordinates, (2, 3), of all ways that are cast against a shape."""
    box: FloatArray = box_m(shape) + [[-AROUND_BODY_M], [AROUND_BODY_M]]
    return box


_ROWS_TOGETHER = 4096  # of bodies, whose rays are cast in one go


def _add_hidden_by_bodies(
    world: World,
    eye_m: FloatArray,
    shapes: Sequence[Shape],
    casters: Sequence[RayCaster],
    shape_index: IntArray,
    position_m: FloatArray,
    rotation: FloatArray,
    view_index: IntArray,
    place: IntArray,
    hidden: BoolArray,
    *,
    near_m: float,
) -> None:
    """Add the points that bodies hide to rows of `hidden`, (n_rows, n_points).

    Body n, of `shapes[shape_index[n]]`, is where `position_m` (n, 3) and `rotation` (n, 3, 3) say,
    while view `view_index[n]` is looked at, whose points have row `place[n]`.
    """
    from .ray_kernels import find_rays_at_body

    for number, (shape, caster) in enumerate(zip(shapes, casters, strict=True)):
        of_shape = np.flatnonzero(shape_index == number)
        of_shape = of_shape[np.argsort(place[of_shape], kind="stable")]
        low_m, high_m = _box_m(shape)
        for start in range(0, len(of_shape), _ROWS_TOGETHER):
            chosen = of_shape[start : start + _ROWS_TOGETHER]
            row = place[chosen]
            blocked = np.zeros((len(chosen), hidden.shape[1]), dtype=bool)
            starts, vectors = (np.empty((blocked.size, 3), np.float32) for _ in range(2))
            n_rays = find_rays_at_body(
                world.views.axes_m,
                view_index[chosen],
                hidden[row],
                eye_m,
                position_m[chosen],
                rotation[chosen],
                low_m,
                high_m,
                near_m,
                _OFF_SURFACE_M,
                starts,
                vectors,
                blocked,
            )
            blocked[blocked] = caster.is_blocked(starts[:n_rays], vectors[:n_rays])
            shown, first = np.unique(row, return_index=True)
            hidden[shown] |= np.logical_or.reduceat(blocked, first, axis=0)


def _cast_to_points(
    caster: RayCaster,
    axes_m: FloatRays,
    eye_m: FloatArray,
    index: IntArray,
    asked: BoolArray,
    *,
    near_m: float,
) -> None:
    """Of the points asked for, (n, n_points), of places, leave those that something hides."""
    from .ray_kernels import fill_rays

    starts, vectors = (np.empty((np.count_nonzero(asked), 3), np.float32) for _ in range(2))
    fill_rays(axes_m, index, asked, eye_m, near_m, _OFF_SURFACE_M, starts, vectors)
    asked[asked] = caster.is_blocked(starts, vectors)


def _rows_between(world: World, eye_m: FloatArray, row_of_frame: IntArray) -> IntArray:
    """Rows of vehicles that may stand between eye and VRU: a conservative sieve.

    Those in frames whose row is -1 are left out.
    """
    vehicles, views = world.vehicles, world.views
    rows = np.flatnonzero(row_of_frame[vehicles.frame] >= 0)
    actor = vehicles.actor_index[rows]
    view = views.view_of_frame[vehicles.frame[rows]]
    way = views.position_m[view] - eye_m[:2]
    to_vehicle = vehicles.position_m[rows, :2] - eye_m[:2]
    share = np.clip(
        (to_vehicle * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-9), 0.0, 1.0
    )
    beside_m = np.hypot(*(to_vehicle - share[:, None] * way).T)
    half_diagonal_m = [0.5 * np.hypot(body.length_m, body.width_m) for body in vehicles.actors]
    reach_m = np.array(half_diagonal_m)[actor] + max(
        0.5 * np.hypot(surface.actor.length_m, surface.actor.width_m) for surface in world.surfaces
    )
    # Lowest ray over the far end of the vehicle: from the eye down to the road below the VRU.
    reach_share = reach_m / np.maximum(np.hypot(*way.T), 1e-9)
    drop_m = eye_m[2] - views.up_m[view]
    low_end = np.clip(share + np.copysign(reach_share, drop_m), 0.0, 1.0)
    lowest_m = views.up_m[view] + drop_m * (1.0 - low_end)
    height_m = np.array([body.height_m for body in vehicles.actors])[actor]
    height_m = height_m + vehicles.position_m[rows, 2]
    kept: IntArray = rows[(beside_m <= reach_m) & (lowest_m <= height_m)]
    return kept


def _hidden_by_vehicles(
    world: World,
    eye_m: FloatArray,
    row_of_frame: IntArray,
    view_of_row: IntArray,
    hidden: BoolArray,
    *,
    near_m: float,
) -> tuple[IntArray, BoolArray]:
    """Frames (n,) in which vehicles hide points, and all that is hidden then, (n, n_points).

    Points of a view that are `hidden` (n_rows, n_points) in any case are among these.
    """
    vehicles, kept = world.vehicles, world.lasting.hidden_by_vehicles
    between = _rows_between(world, eye_m, row_of_frame)
    frames = np.unique(vehicles.frame[between])
    before = hidden[row_of_frame[frames]]

    def find(asked: IntArray, behind: BoolArray) -> BoolArray:
        """Add what is behind vehicles in frames, all of them among those above."""
        place_of_frame = np.full(len(row_of_frame), -1)
        place_of_frame[asked] = np.arange(len(asked))
        rows = between[place_of_frame[vehicles.frame[between]] >= 0]
        _add_hidden_by_bodies(
            *(world, eye_m, [actor.shapes[0] for actor in vehicles.actors], vehicles.casters),
            *(vehicles.actor_index[rows], vehicles.position_m[rows]),
            body_rotation(vehicles.yaw_deg[rows]),
            view_of_row[row_of_frame[vehicles.frame[rows]]],
            place_of_frame[vehicles.frame[rows]],
            behind,
            near_m=near_m,
        )
        return behind

    if kept is None:
        behind = find(frames, before.copy())
    else:
        behind = before | kept.look(
            (near_m, eye_m.tobytes()),
            frames,
            lambda asked: find(asked, np.zeros((len(asked), hidden.shape[1]), dtype=bool)),
        )
    is_hit = (behind != before).any(axis=1)
    return frames[is_hit], behind[is_hit]
