"""LiDAR points on the VRU in every frame: counted, and thinned by distance and weather."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import (
    LidarModel,
    beam_directions,
    beam_window,
    load_lidar_detection,
    return_probability,
)
from geometry.poses import Pose, body_rotation
from geometry.weather import Weather

from ..detectors import VRU_CLASSES
from .perceive import distances_m
from .solids import Solid
from .surroundings import Surroundings, VutCamera, level_carriers, relative_road_poses

_POSE_DECIMALS = 6  # poses that agree to a micrometre are the same
_SIGHTS_AT_ONCE = 256
_PLAN = [0, 1, 2, 4, 5, 6]  # of two road poses: who is at the same place is at the same height


def scan_from_roadside(
    surroundings: Surroundings, pose: Pose, lidar: LidarModel, rng: np.random.Generator
) -> BoolArray:
    """Frames in which a fixed LiDAR gets enough points on the VRU, (n_frames,) bool.

    The random numbers say which pulses come back.
    """
    return _scan(
        surroundings,
        pose,
        lidar,
        tilt_deg=np.zeros(len(surroundings.vru_poses)),
        static_poses=surroundings.static_poses,
        vru_poses=surroundings.vru_poses,
        vehicle_index=np.insert(surroundings.traffic_index, 0, 0, axis=1),
        vehicle_poses=np.insert(surroundings.traffic_poses, 0, surroundings.vut_poses, axis=1),
        rng=rng,
    )


def scan_from_vut(
    surroundings: Surroundings, mount: VutCamera, lidar: LidarModel, rng: np.random.Generator
) -> BoolArray:
    """Frames in which the VUT's own LiDAR detects the VRU; see :func:`scan_from_roadside`."""
    pose = mount.pose_on(surroundings.vut_actor)
    vut_poses = level_carriers(surroundings, pose)
    return _scan(
        surroundings,
        pose,
        lidar,
        tilt_deg=surroundings.vut_pitch_deg,
        static_poses=relative_road_poses(surroundings.static_poses, vut_poses),
        vru_poses=relative_road_poses(surroundings.vru_poses, vut_poses),
        vehicle_index=surroundings.traffic_index,
        vehicle_poses=relative_road_poses(surroundings.traffic_poses, vut_poses),
        rng=rng,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Echoes:
    """Beams that reach the VRU in one sight."""

    directions: FloatArray  # (n, 3), unit vectors, in the frame in which the LiDAR stands
    distance_m: FloatArray  # (n,)
    incidence_cos: FloatArray  # (n,)

    def take(self, keep: BoolArray) -> "_Echoes":
        return _Echoes(
            directions=self.directions[keep],
            distance_m=self.distance_m[keep],
            incidence_cos=self.incidence_cos[keep],
        )


def _scan(
    surroundings: Surroundings,
    pose: Pose,
    lidar: LidarModel,
    *,
    tilt_deg: FloatArray,
    static_poses: FloatArray,
    vru_poses: FloatArray,
    vehicle_index: IntArray,
    vehicle_poses: FloatArray,
    rng: np.random.Generator,
) -> BoolArray:
    detected = np.zeros(len(vru_poses), dtype=bool)
    luck: dict[int, FloatArray] = {}  # the same in all weathers: what differs is the weather's
    beams = beam_directions(lidar).reshape(-1, 3)
    kinds = np.stack([surroundings.static_index, surroundings.vru_index], axis=1)
    for static_index, vru_index in np.unique(kinds, axis=0):
        frames = np.flatnonzero((kinds == [static_index, vru_index]).all(axis=1))
        poses = np.concatenate([static_poses[frames], vru_poses[frames]], axis=1)
        _, first, sight_of_frame = np.unique(
            poses[:, _PLAN].round(_POSE_DECIMALS) + 0.0,
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        static = surroundings.statics[static_index]
        vru = surroundings.vrus[vru_index]
        sights = [
            echoes
            for part in np.array_split(first, -(-len(first) // _SIGHTS_AT_ONCE))
            for echoes in _look(
                pose, lidar, beams, static, vru, poses[part], tilt_deg[frames[part]]
            )
        ]
        for frame, sight in zip(frames.tolist(), sight_of_frame.tolist(), strict=True):
            draw = int(surroundings.draw_index[frame])
            echoes = sights[sight]
            for place in np.flatnonzero(vehicle_index[frame] >= 0).tolist():
                if len(echoes.distance_m):
                    vehicle = surroundings.vehicles[vehicle_index[frame, place]]
                    echoes = _before(echoes, pose, lidar, vehicle, vehicle_poses[frame, place])
            weather = surroundings.weathers[surroundings.weather_index[frame]]
            vru_class = VRU_CLASSES[surroundings.vru_class[frame]]
            if draw not in luck:
                luck[draw] = rng.random(len(echoes.distance_m))
            detected[frame] = _is_enough(echoes, lidar, weather, vru_class, luck[draw])
    return detected


def _look(
    pose: Pose,
    lidar: LidarModel,
    beams: FloatArray,
    static: Solid,
    vru: Solid,
    poses: FloatArray,
    tilt_deg: FloatArray,
) -> Iterator[_Echoes]:
    """Beams that reach the VRU before anything that stands still, sight by sight."""
    vru_poses = poses[:, 4:]
    turns = body_rotation(pose.yaw_deg, pose.pitch_deg + tilt_deg)  # from the LiDAR's own frame
    distance = distances_m(pose, vru_poses, vru.hull_m)
    radius_m = float(
        np.linalg.norm(vru.hull_m - [0.0, 0.0, 0.5 * vru.hull_m[:, 2].max()], axis=1).max()
    )
    middle = np.column_stack([vru_poses[:, :2], 0.5 * vru.hull_m[:, 2].max() + vru_poses[:, 3]])
    towards = (middle - pose.position_m) / distance[:, None]
    half_angle = np.arcsin(np.minimum(1.0, radius_m / distance))
    near = np.flatnonzero(distance - radius_m <= lidar.range_m)
    towards_lidar = np.einsum("ni,nij->nj", towards, turns)
    windows = list(_beams_around(lidar, towards_lidar[near], half_angle[near]))
    sight = np.repeat(near, [len(window) for window in windows])
    beam = np.concatenate([*windows, np.empty(0, dtype=np.int64)])
    cosine = np.einsum("ni,ni->n", towards_lidar[sight], beams[beam])
    is_close = cosine >= np.cos(half_angle[sight])
    sight, beam = sight[is_close], beam[is_close]
    directions = np.einsum("nij,nj->ni", turns[sight], beams[beam])
    depth, triangle = _cast(pose, lidar, vru, vru_poses[sight], directions)
    hits = np.isfinite(depth)
    sight, directions, depth, triangle = sight[hits], directions[hits], depth[hits], triangle[hits]
    before, _ = _cast(pose, lidar, static, poses[sight, :4], directions)
    free = depth < before
    sight, directions, depth, triangle = sight[free], directions[free], depth[free], triangle[free]
    normals = np.einsum("nij,nj->ni", body_rotation(vru_poses[sight, 2]), vru.normals[triangle])
    cosine = np.abs(np.einsum("ni,ni->n", normals, directions))
    ends = np.searchsorted(sight, np.arange(len(poses) + 1))
    for start, end in itertools.pairwise(ends):
        yield _Echoes(
            directions=directions[start:end],
            distance_m=depth[start:end],
            incidence_cos=cosine[start:end],
        )


def _beams_around(
    lidar: LidarModel, towards: FloatArray, half_angle_rad: FloatArray
) -> Iterator[IntArray]:
    """Beams in boxes of angles around cones, cone by cone: line by line, each from right to left.

    Cones have axes (n, 3), unit vectors in the LiDAR's frame. Beams are indices into the flattened
    scan pattern. Over the seam of a LiDAR that scans all round they go on: a cone has the same
    beams in the same order however the LiDAR is turned.
    """
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    elevation = np.arcsin(np.clip(towards[:, 2], -1.0, 1.0))
    # A cone around the pole has every azimuth; another one is widest where a meridian touches it.
    has_pole = np.abs(elevation) + half_angle_rad >= 0.5 * np.pi
    ratio = np.sin(half_angle_rad) / np.where(has_pole, 1.0, np.cos(elevation))
    half_width = np.where(has_pole, np.pi, np.arcsin(np.minimum(ratio, 1.0)))
    middle = np.degrees(np.stack([azimuth, elevation], axis=1))
    half = np.degrees(np.stack([half_width, half_angle_rad], axis=1))
    # What ends at an edge may come in again at the other one, if it is wide enough.
    turns_deg = (0.0,) if lidar.scans_all_round else (-360.0, 0.0, 360.0)
    windows = [
        beam_window(lidar, middle - half + [turn_deg, 0.0], middle + half + [turn_deg, 0.0])
        for turn_deg in turns_deg
    ]
    for parts in zip(*windows, strict=True):
        columns = np.concatenate([np.arange(first, end) for _, first, _, end in parts])
        if lidar.scans_all_round:
            columns %= lidar.n_columns
        else:
            columns = np.unique(columns)
        lines = np.arange(parts[0][0], parts[0][2])
        yield (lines[:, None] * lidar.n_columns + columns).ravel()


def _cast(
    pose: Pose, lidar: LidarModel, solid: Solid, road_poses: FloatArray, directions: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Distance to a solid along each beam, and the triangle hit; infinite and -1 where none is."""
    rotations = body_rotation(road_poses[:, 2])
    offsets = np.repeat(pose.position_m[None], len(road_poses), axis=0)
    offsets -= road_poses[:, [0, 1, 3]]
    origins = np.einsum("ni,nij->nj", offsets, rotations)
    turned = np.einsum("ni,nij->nj", directions, rotations)
    starts = origins + lidar.near_m * turned
    share, triangle = solid.caster.first_triangle(
        starts.astype(np.float32), turned.astype(np.float32)
    )
    return share.astype(np.float64) + lidar.near_m, triangle


def _before(
    echoes: _Echoes, pose: Pose, lidar: LidarModel, vehicle: Solid, road_pose: FloatArray
) -> _Echoes:
    """Beams that a vehicle does not stop on their way."""
    up_m = 0.5 * vehicle.hull_m[:, 2].max() + road_pose[3]
    middle = np.array([*road_pose[:2], up_m]) - pose.position_m
    radius_m = float(np.linalg.norm(vehicle.hull_m, axis=1).max())
    along = echoes.directions @ middle
    aside_m = np.sqrt(np.maximum(middle @ middle - along**2, 0.0))
    if not ((aside_m <= radius_m) & (along - radius_m <= echoes.distance_m)).any():
        return echoes
    poses = np.repeat(road_pose[None], len(echoes.distance_m), axis=0)
    depth, _ = _cast(pose, lidar, vehicle, poses, echoes.directions)
    return echoes.take(echoes.distance_m < depth)


def _is_enough(
    echoes: _Echoes, lidar: LidarModel, weather: Weather, vru_class: str, luck: FloatArray
) -> bool:
    """Whether enough pulses come back from the VRU."""
    detection = load_lidar_detection()
    probability = return_probability(
        lidar,
        echoes.distance_m,
        reflectivity=detection.reflectivity[vru_class],
        incidence_cos=echoes.incidence_cos,
        extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
    )
    n_points = int((luck < probability).sum())
    return n_points >= detection.min_points[vru_class]
