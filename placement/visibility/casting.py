"""Rays from a mount position to the VRU's points: once per position and unique VRU pose.

A ray does not depend on where the camera looks, and the VRU's pose and gait depend on the time to
impact only, not on the VUT's speed. What moves needs no scene of its own: the rays are taken into
the frame of the VRU, or of the VUT, and cast against one fixed scene each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.actors import Actor, PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.poses import body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster, build_caster, ray_lengths_m
from geometry.scene import Scene
from geometry.weather import Weather, pick_weather
from scenarios.runs import Run

# ---------- obstructions


def obstruction_key(run: Run) -> tuple[object, ...]:
    """Equal for runs with the same bodies at the same places."""
    return tuple(parked.key for parked in run.obstruction)


def find_obstructions(runs: Sequence[Run]) -> dict[tuple[object, ...], tuple[PlacedActor, ...]]:
    """Distinct obstructions in the order of `World.static`, by their content."""
    return {obstruction_key(run): run.obstruction for run in runs}


def build_static_mesh(
    scene: Scene, obstruction: tuple[PlacedActor, ...], origin_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices (n, 3) from an origin, and triangles (m, 3), of a scene with an obstruction."""
    vertices, triangles = [scene.vertices_m], [scene.triangles]
    for parked in obstruction:
        shape = parked.actor.shapes[0]
        triangles.append((shape.triangles + sum(map(len, vertices))).astype(np.int32))
        vertices.append(to_world(shape.vertices_m, parked.pose))
    return np.concatenate(vertices) - origin_m, np.concatenate(triangles)


# ---------- points on a body


_SAMPLES_PER_POINT = 30
_TURN_M = 0.3  # a normal turned by a radian counts as much as a way of this length


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """Points on the outside of a body at one instant of its gait."""

    actor: Actor
    shape_index: int  # which of its shapes
    points_m: FloatArray  # (n, 3): body frame; the shape's extremes are among them. [m]
    # (n, 3): the part of the surface around each point: its area along its mean outward normal.
    # [m^2]
    area_m2: FloatArray


@cache  # tables of variants ask for the same bodies again
def build_surface(actor: Actor, shape_index: int, *, n_points: int, seed: int) -> Surface:
    """Spread points evenly over the outside of a body's shape, a closed mesh.

    The extremes along 26 directions come first, so that boxes around the points are boxes around
    the shape; then, one by one, the random sample farthest from all points so far.

    References
    ----------
    .. [1] Y. Eldar et al., "The farthest point strategy for progressive image sampling", 1997.
    """
    import trimesh

    shape = actor.shapes[shape_index]
    mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
    samples, faces = trimesh.sample.sample_surface(mesh, _SAMPLES_PER_POINT * n_points, seed=seed)
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    extremes = np.unique(np.argmax(shape.vertices_m @ signs[signs.any(axis=1)].T, axis=0))
    chosen = [shape.vertices_m[index] for index in extremes[:n_points]]
    normals = [mesh.vertex_normals[index] for index in extremes[:n_points]]
    distance = np.min([np.linalg.norm(samples - point, axis=1) for point in chosen], axis=0)
    while len(chosen) < n_points:
        farthest = int(np.argmax(distance))
        chosen.append(samples[farthest])
        normals.append(mesh.face_normals[faces[farthest]])
        distance = np.minimum(distance, np.linalg.norm(samples - samples[farthest], axis=1))
    points = np.array(chosen)
    # A sample belongs to the nearest point that faces the same way: not to one around the corner.
    tree = cKDTree(np.hstack([points, _TURN_M * np.array(normals)]))
    sample_normals = mesh.face_normals[faces]
    _, nearest = tree.query(np.hstack([samples, _TURN_M * sample_normals]))
    area = np.zeros_like(points)
    np.add.at(area, nearest, sample_normals)
    return Surface(
        actor=actor,
        shape_index=shape_index,
        points_m=freeze(points),
        area_m2=freeze(area * (mesh.area / len(samples))),
    )


# ---------- rays


_OFF_SURFACE_M = 1.0e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VruViews:
    """Every distinct (body, shape, pose, static world) in which a VRU is looked at."""

    # (n_views, 2): middle of the footprint, relative to the origin of `World`. [m]
    position_m: FloatArray
    yaw_deg: FloatArray  # (n_views,): heading. [deg]
    # surface_index, static_index: (n_views,): into the surfaces and static casters of `World`
    surface_index: IntArray
    static_index: IntArray
    # (n_views, n_points, 3): the body's points, relative to the origin of `World`. [m]
    points_m: FloatRays
    view_of_frame: IntArray  # (n_frames,): which view each frame of the frame axis shows
    weathers: tuple[Weather, ...]  # distinct weathers
    weather_of_frame: IntArray  # (n_frames,): which of them it is


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """All that rays are cast against, and all that they are cast to."""

    # (3,): subtracted from every coordinate: rays are cast in single precision. [m]
    origin_m: FloatArray
    static: tuple[RayCaster, ...]  # the scene with each distinct obstruction
    surfaces: tuple[Surface, ...]  # each distinct shape of a VRU, and its caster in `bodies`
    bodies: tuple[RayCaster, ...]  # VRUs in their own frame
    vut: Actor  # the vehicle under test, and its caster in its own frame
    vut_body: RayCaster  # see `vut`
    # vut_position_m, vut_yaw_deg: (n_frames, 2), (n_frames,): relative to `origin_m`. [m], [deg]
    vut_position_m: FloatArray
    vut_yaw_deg: FloatArray
    views: VruViews  # what is looked at

    @property
    def radius_m(self) -> float:
        """All points of any VRU lie this near to their mean, in metres."""
        return max(
            float(np.linalg.norm(surface.points_m - surface.points_m.mean(axis=0), axis=1).max())
            for surface in self.surfaces
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """Visible points of the VRU from one mount position, whatever the camera's direction."""

    view_index: IntArray  # (n,): view of each entry
    is_visible: BoolArray  # (n, n_points): points that the rays reach
    is_whole: BoolArray  # (n,): nothing but the VRU itself hides any of its points
    # (n,): of the points that the VRU itself does not hide, those that nothing hides
    visible_share: FloatArray
    # (n_frames,): entry that a frame shows; -1 where nothing of the VRU is seen
    entry_of_frame: IntArray


def build_world(scene: Scene, runs: Sequence[Run], *, n_points: int, seed: int) -> World:
    """Prepare scene, bodies and views for :func:`cast_sight`, from any thread.

    All runs have the same VUT.
    """
    origin = np.append(scene.outline_m.mean(axis=0), 0.0)
    shapes = _find_shapes(runs)
    obstructions = find_obstructions(runs)
    vut = runs[0].encounter.vut
    surfaces = tuple(
        build_surface(actor, index, n_points=n_points, seed=seed) for actor, index in shapes
    )
    return World(
        origin_m=origin,
        static=tuple(
            build_caster(*build_static_mesh(scene, parked, origin))
            for parked in obstructions.values()
        ),
        surfaces=surfaces,
        bodies=tuple(_shape_caster(actor.shapes[index]) for actor, index in shapes),
        vut=vut,
        vut_body=_shape_caster(vut.shapes[0]),
        vut_position_m=np.concatenate([run.vut_position_m for run in runs]) - origin[:2],
        vut_yaw_deg=np.concatenate([run.vut_yaw_deg for run in runs]),
        views=_build_views(runs, surfaces, list(obstructions), origin),
    )


def _find_shapes(runs: Sequence[Run]) -> list[tuple[Actor, int]]:
    """Every shape in which a VRU is seen."""
    found = {(run.encounter.vru, index): None for run in runs for index in np.unique(run.vru_shape)}
    return [(actor, int(index)) for actor, index in found]


def _shape_caster(shape: Shape) -> RayCaster:
    return build_caster(shape.vertices_m, shape.triangles)


def _build_views(
    runs: Sequence[Run],
    surfaces: tuple[Surface, ...],
    obstructions: list[tuple[object, ...]],
    origin_m: FloatArray,
) -> VruViews:
    numbers = {
        (surface.actor, surface.shape_index): number for number, surface in enumerate(surfaces)
    }
    rows = np.concatenate(
        [
            np.column_stack(
                [
                    run.vru_position_m - origin_m[:2],
                    run.vru_yaw_deg,
                    [numbers[run.encounter.vru, int(index)] for index in run.vru_shape],
                    np.full(len(run.time_s), obstructions.index(obstruction_key(run))),
                ]
            )
            for run in runs
        ]
    )
    weathers = list(dict.fromkeys(run.weather for run in runs))
    # Rounded to a tenth of a millimetre: the same pose at another speed differs in the last bits.
    _, first, view_of_frame = np.unique(
        rows.round(4), axis=0, return_index=True, return_inverse=True
    )
    unique = rows[first]
    surface_index = unique[:, 3].astype(np.int64)
    body_points = np.stack([surface.points_m for surface in surfaces])[surface_index]
    points = body_points @ np.swapaxes(body_rotation(unique[:, 2]), 1, 2)
    points[..., :2] += unique[:, None, :2]
    return VruViews(
        position_m=unique[:, :2],
        yaw_deg=unique[:, 2],
        surface_index=surface_index,
        static_index=unique[:, 4].astype(np.int64),
        points_m=points.astype(np.float32),
        view_of_frame=view_of_frame.ravel(),
        weathers=tuple(pick_weather(name, "runs: weather") for name in weathers),
        weather_of_frame=np.repeat(
            [weathers.index(run.weather) for run in runs], [len(run.time_s) for run in runs]
        ),
    )


def cast_sight(
    world: World, position_m: FloatArray, *, near_m: float, max_distance_m: float
) -> Sight:
    """Cast all rays of one mount position; entries without any visible point are left out.

    What is nearer than `near_m` to the lens hides nothing; VRUs farther than `max_distance_m` are
    not looked at.
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    ground_distance = np.hypot(*(views.position_m - eye[:2]).T)
    near_views = np.flatnonzero(np.hypot(ground_distance, eye[2]) <= max_distance_m)
    faces_eye = _is_self_visible(world, eye, near_views)
    is_visible = faces_eye & ~_is_blocked_by_static(
        world, eye, near_views, faces_eye, near_m=near_m
    )

    entry_of_view = np.full(len(views.yaw_deg), -1)
    is_seen = is_visible.any(axis=1)
    entry_of_view[near_views[is_seen]] = np.arange(int(is_seen.sum()))
    near_views, is_visible, faces_eye = (
        near_views[is_seen],
        is_visible[is_seen],
        faces_eye[is_seen],
    )
    entry_of_frame = entry_of_view[views.view_of_frame]

    frames = _frames_behind_vut(world, eye, entry_of_frame)
    entries = entry_of_frame[frames]
    behind_vut = _is_blocked_by_vut(
        world, eye, frames, near_views[entries], is_visible[entries], near_m=near_m
    )
    is_hit = behind_vut.any(axis=1)
    frames, entries, behind_vut = frames[is_hit], entries[is_hit], behind_vut[is_hit]
    left_visible = is_visible[entries] & ~behind_vut
    is_left = left_visible.any(axis=1)
    entry_of_frame[frames] = -1
    entry_of_frame[frames[is_left]] = len(near_views) + np.arange(int(is_left.sum()))
    n_facing = faces_eye.sum(axis=1)
    shown = np.concatenate([is_visible, left_visible[is_left]])
    return Sight(
        view_index=np.concatenate([near_views, near_views[entries[is_left]]]),
        is_visible=shown,
        is_whole=np.concatenate(
            [(is_visible == faces_eye).all(axis=1), np.zeros(int(is_left.sum()), dtype=bool)]
        ),
        visible_share=shown.sum(axis=1) / np.concatenate([n_facing, n_facing[entries[is_left]]]),
        entry_of_frame=entry_of_frame,
    )


def _is_self_visible(world: World, eye_m: FloatArray, view_index: IntArray) -> BoolArray:
    """Points that the VRU's own body does not hide, (n, n_points)."""
    views = world.views
    n_points = views.points_m.shape[1]
    visible = np.empty((len(view_index), n_points), dtype=bool)
    offset = np.column_stack(
        [eye_m[:2] - views.position_m[view_index], np.full(len(view_index), eye_m[2])]
    )
    # Row vectors times R_world_body = coordinates in the body frame.
    eye_body = np.einsum("ni,nij->nj", offset, body_rotation(views.yaw_deg[view_index]))
    for index, (surface, body) in enumerate(zip(world.surfaces, world.bodies, strict=True)):
        rows = np.flatnonzero(views.surface_index[view_index] == index)
        eyes = eye_body[rows].astype(np.float32)[:, None, :]
        end = (1.0 - _OFF_SURFACE_M / np.linalg.norm(eye_body[rows], axis=1)).astype(np.float32)
        vectors = surface.points_m.astype(np.float32) - eyes
        vectors *= end[:, None, None]
        origins = np.broadcast_to(eyes, vectors.shape)
        blocked = body.is_blocked(origins.reshape(-1, 3), vectors.reshape(-1, 3))
        visible[rows] = ~blocked.reshape(len(rows), n_points)
    return visible


def _is_blocked_by_static(
    world: World, eye_m: FloatArray, view_index: IntArray, is_asked: BoolArray, *, near_m: float
) -> BoolArray:
    """Points hidden by the scene or the case's obstruction, (n, n_points)."""
    views = world.views
    blocked = np.zeros(is_asked.shape, dtype=bool)
    for index, caster in enumerate(world.static):
        rows = np.flatnonzero(views.static_index[view_index] == index)
        asked = np.flatnonzero(is_asked[rows])
        vectors = views.points_m[view_index[rows]].reshape(-1, 3).take(asked, axis=0)
        vectors -= eye_m.astype(np.float32)
        part = np.zeros(is_asked[rows].shape, dtype=bool)
        part.reshape(-1)[asked] = caster.is_blocked(
            *_shorten(eye_m.astype(np.float32), vectors, near_m)
        )
        blocked[rows] = part
    return blocked


def _frames_behind_vut(world: World, eye_m: FloatArray, entry_of_frame: IntArray) -> IntArray:
    """Frames in which the VUT may stand between eye and VRU: a conservative sieve."""
    frames = np.flatnonzero(entry_of_frame >= 0)
    target = world.views.position_m[world.views.view_of_frame[frames]]
    way = target - eye_m[:2]
    to_vut = world.vut_position_m[frames] - eye_m[:2]
    share = np.clip((to_vut * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-9), 0.0, 1.0)
    beside_m = np.hypot(*(to_vut - share[:, None] * way).T)
    reach_m = 0.5 * np.hypot(world.vut.length_m, world.vut.width_m) + max(
        0.5 * np.hypot(surface.actor.length_m, surface.actor.width_m) for surface in world.surfaces
    )
    # Lowest ray over the far end of the VUT: from the eye down to the road below the VRU.
    reach_share = reach_m / np.maximum(np.hypot(*way.T), 1e-9)
    lowest_m = eye_m[2] * (1.0 - np.minimum(share + reach_share, 1.0))
    kept: IntArray = frames[(beside_m <= reach_m) & (lowest_m <= world.vut.height_m)]
    return kept


def _is_blocked_by_vut(
    world: World,
    eye_m: FloatArray,
    frames: IntArray,
    view_index: IntArray,
    is_asked: BoolArray,
    *,
    near_m: float,
) -> BoolArray:
    """Points hidden by the VUT, by rays in its frame, (n, n_points)."""
    blocked = np.zeros(is_asked.shape, dtype=bool)
    if len(frames) == 0:
        return blocked
    rotation = body_rotation(world.vut_yaw_deg[frames])
    vut_position = np.column_stack([world.vut_position_m[frames], np.zeros(len(frames))])
    eye_vut = np.einsum("ni,nij->nj", eye_m - vut_position, rotation)
    points = world.views.points_m[view_index] - vut_position[:, None, :]
    points_vut = (points @ rotation).astype(np.float32)
    row = np.repeat(np.arange(len(frames)), is_asked.sum(axis=1))
    origins = eye_vut.astype(np.float32)[row]
    vectors = points_vut[is_asked] - origins
    blocked[is_asked] = world.vut_body.is_blocked(*_shorten(origins, vectors, near_m))
    return blocked


def _shorten(
    origins_m: NDArray[np.float32], vectors_m: NDArray[np.float32], near_m: float
) -> tuple[FloatRays, FloatRays]:
    """Rays that start `near_m` from the eye and end a millimetre before the point.

    `vectors_m` is changed in place.
    """
    per_length = np.float32(1.0) / ray_lengths_m(vectors_m)
    starts = vectors_m * (np.float32(near_m) * per_length)[:, None]
    starts += origins_m
    vectors_m *= (1.0 - np.float32(near_m + _OFF_SURFACE_M) * per_length)[:, None]
    return starts, vectors_m
