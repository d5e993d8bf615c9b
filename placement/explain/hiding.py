"""Why a unit does not detect a road user in a frame: what is in the way, or what else it is.

One question after the other, each on the rays and boxes that the detection table rests on: would
it be detected if nothing stood in the way? Is it in the image at all? Would it be by full contrast?
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from geometry.raycast import FloatRays, build_caster, ray_lengths_m
from geometry.scene import Scene
from geometry.sensors import project_points
from scenarios.runs import Run

from ..candidates import CandidatePose
from ..setting import Setting
from ..visibility.build import N_POINTS
from ..visibility.casting import Sight, World, build_world, cast_sight
from ..visibility.obstructions import find_obstructions
from ..visibility.sensing import build_sensing

Cause = Literal["hidden", "out of view", "cut off", "too dark", "too far", "otherwise"]

THE_VUT = "the VUT"
_OFF_SURFACE_M = 1.0e-3  # rays end this much before the point they are cast to


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """A unit, a run, and the frames in which the unit should have detected the road user.

    Attributes
    ----------
    unit : CandidatePose
        Who looks.
    run_index : int
        Of the setting's runs.
    frame_index : (n,) int
        Frames of that run, from 0.
    """

    unit: CandidatePose
    run_index: int
    frame_index: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Why the road user is not detected in some frames.

    Attributes
    ----------
    cause : str
        "hidden": detected if nothing stood in the way; "out of view", "cut off": not in the image,
        or only a part of it; "too dark": light and air leave too little contrast; "too far": too
        small, or too few points; "otherwise": nothing of all this, the table says so.
    thing : str
        What hides it, by name: most of the rays that are blocked end there. Empty for all other
        causes.
    n_frames : int
        In how many frames.
    """

    cause: Cause
    thing: str
    n_frames: int


def find_reasons(
    setting: Setting, looks: Sequence[Look], *, seed: int = 0
) -> list[tuple[Reason, ...]]:
    """Why units do not detect road users.

    Parameters
    ----------
    setting : Setting
        Scene, runs, planning detector.
    looks : sequence of Look
        Who should have detected whom.
    seed : int
        Of the points on the VRUs: that of the detection table.

    Returns
    -------
    reasons : list of tuple of Reason
        Of each look, the most frequent one first.
    """
    if not looks:
        return []
    run_index = list(dict.fromkeys(look.run_index for look in looks))
    runs = [setting.runs[index] for index in run_index]
    ends = np.cumsum([0, *(len(run.time_s) for run in runs)])
    world = build_world(setting.scene, runs, n_points=N_POINTS, seed=seed)
    names = _triangle_names(setting.scene, runs)
    reasons: list[tuple[Reason, ...]] = [()] * len(looks)
    units = {id(look.unit): look.unit for look in looks}
    for key, unit in units.items():
        mine = [number for number, look in enumerate(looks) if id(look.unit) == key]
        frames = [
            ends[run_index.index(looks[number].run_index)] + looks[number].frame_index
            for number in mine
        ]
        causes = _causes(setting, world, names, unit, np.concatenate(frames))
        parts = np.split(np.arange(len(causes)), np.cumsum([len(part) for part in frames])[:-1])
        for number, part in zip(mine, parts, strict=True):
            tally = Counter(causes[frame] for frame in part)
            reasons[number] = tuple(
                Reason(cause=cause, thing=thing, n_frames=n_frames)
                for (cause, thing), n_frames in tally.most_common()
            )
    return reasons


def _causes(
    setting: Setting,
    world: World,
    names: Sequence[NDArray[np.object_]],
    unit: CandidatePose,
    frames: IntArray,
) -> list[tuple[Cause, str]]:
    """Cause, and the thing in the way, of each frame of a world."""
    nothing = build_caster(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    empty = replace(world, static=(nothing,) * len(world.static), vut_body=nothing)
    position_m, near_m = unit.pose.position_m, unit.sensor.near_m
    open_sight = cast_sight(empty, position_m, near_m=near_m, max_distance_m=np.inf)
    sensing = build_sensing(empty, open_sight, position_m, setting.planner)
    entries = open_sight.entry_of_frame[frames]
    weathers = world.views.weather_of_frame[frames]
    in_the_open = sensing.detected(unit)[weathers, entries]
    bright = replace(sensing, contrast=np.ones_like(sensing.contrast))
    in_full_light = bright.detected(unit)[weathers, entries]
    inside = _inside_shares(world, unit, frames)
    things = iter(_things_between(world, names, unit, frames[in_the_open], open_sight))
    causes: list[tuple[Cause, str]] = []
    for frame in range(len(frames)):
        if in_the_open[frame]:
            thing = next(things)
            causes.append(("hidden", thing) if thing else ("otherwise", ""))
        elif inside[frame] < 1.0:
            causes.append(("out of view" if inside[frame] == 0.0 else "cut off", ""))
        else:
            causes.append(("too dark" if in_full_light[frame] else "too far", ""))
    return causes


def _inside_shares(world: World, unit: CandidatePose, frames: IntArray) -> FloatArray:
    """Share of the body's points in the field of view of a unit, (n_frames,)."""
    views = world.views
    points = views.points_m[views.view_of_frame[frames]].astype(np.float64) + world.origin_m
    share: FloatArray = is_in_view(unit, points.reshape(-1, 3)).reshape(points.shape[:2]).mean(1)
    return share


def is_in_view(unit: CandidatePose, points_m: FloatArray) -> BoolArray:
    """Whether points lie in a unit's field of view, at any distance.

    Parameters
    ----------
    unit : CandidatePose
        Who looks.
    points_m : (n, 3) float
        World frame. [m]

    Returns
    -------
    is_in_view : (n,) bool
        Nothing is looked for that might stand in the way.
    """
    sensor, pose = unit.sensor, unit.pose
    is_inside: BoolArray
    if isinstance(sensor, LidarModel):
        offsets = points_m - pose.position_m
        ahead, left, up = np.moveaxis(offsets @ body_rotation(pose.yaw_deg, pose.pitch_deg), -1, 0)
        azimuth_deg = np.degrees(np.arctan2(left, ahead))
        elevation_deg = np.degrees(np.arctan2(up, np.hypot(ahead, left)))
        is_inside = np.abs(azimuth_deg) <= 0.5 * sensor.horizontal_fov_deg
        is_inside &= np.abs(elevation_deg) <= 0.5 * sensor.vertical_fov_deg
    else:
        column, row, _ = project_points(points_m, pose, sensor).T
        # NaN, behind the lens, is inside nothing.
        is_inside = (column >= 0.0) & (column <= sensor.width_px)
        is_inside &= (row >= 0.0) & (row <= sensor.height_px)
    return is_inside


def _things_between(
    world: World,
    names: Sequence[NDArray[np.object_]],
    unit: CandidatePose,
    frames: IntArray,
    open_sight: Sight,
) -> list[str]:
    """What blocks most of the rays to the road user in each frame; empty where nothing does."""
    views = world.views
    eye = unit.pose.position_m - world.origin_m
    things = []
    for frame in frames.tolist():
        view = int(views.view_of_frame[frame])
        faces_eye = open_sight.is_visible[open_sight.entry_of_frame[frame]]
        rays = _rays(eye, views.points_m[view][faces_eye], unit.sensor.near_m)
        static = int(views.static_index[view])
        share, triangle = world.static[static].first_triangle(*rays)
        thing = names[static][np.where(share < 1.0, triangle, -1)]
        thing[_vut_shares(world, frame, rays) < np.minimum(share, 1.0)] = THE_VUT
        blockers = Counter(thing[thing != ""].tolist()).most_common(1)
        things.append(blockers[0][0] if blockers else "")
    return things


def _rays(eye_m: FloatArray, points_m: FloatRays, near_m: float) -> tuple[FloatRays, FloatRays]:
    """Starts, beyond what is too near to the lens to hide anything, and the ways to the points."""
    vectors = points_m - eye_m.astype(np.float32)
    unit_vectors = vectors / ray_lengths_m(vectors)[:, None]
    starts = (eye_m + near_m * unit_vectors).astype(np.float32)
    ways = vectors - np.float32(near_m + _OFF_SURFACE_M) * unit_vectors
    return starts, ways.astype(np.float32)


def _vut_shares(world: World, frame: int, rays: tuple[FloatRays, FloatRays]) -> FloatRays:
    """How far along each ray the VUT is first hit, in the VUT's own frame."""
    rotation = body_rotation(world.vut_yaw_deg[frame])
    position = np.append(world.vut_position_m[frame], 0.0)
    starts, ways = rays
    return world.vut_body.first_hit(
        ((starts - position) @ rotation).astype(np.float32), (ways @ rotation).astype(np.float32)
    )


def _triangle_names(scene: Scene, runs: Sequence[Run]) -> list[NDArray[np.object_]]:
    """Name of what each triangle of each static world belongs to, as they are put together."""
    instances = [scene.instances[index].id for index in scene.triangle_instance]
    names = []
    for parked in find_obstructions(runs).values():
        bodies = [body.actor.name for body in parked]
        labels = [
            name if bodies.count(name) == 1 else f"{name} ({bodies[: number + 1].count(name)})"
            for number, name in enumerate(bodies)
        ]
        of_bodies = [
            label
            for label, body in zip(labels, parked, strict=True)
            for _ in range(len(body.actor.shapes[0].triangles))
        ]
        # One more at the end: nothing is hit (index -1).
        names.append(np.array([*instances, *of_bodies, ""], dtype=object))
    return names
