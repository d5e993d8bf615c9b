"""Boxes of the VRU in every frame, derived from pixels.

Each unit is a camera that is fixed to something: an RSU to the world, the VUT's camera to the
VUT. Seen from there many instants look the same but for the VUT and other vehicles that drive: such
a sight is drawn once.
"""

import itertools

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.poses import Pose, body_rotation, camera_rotation
from geometry.sensors import CameraModel

from ..detectors import Evidence, aspects_deg
from .sights import Placed, Seen, Sights
from .surroundings import (
    Surroundings,
    VutCamera,
    find_sights,
    level_carriers,
    relative_road_poses,
)


def perceive_from_roadside(
    surroundings: Surroundings, pose: Pose, camera: CameraModel, *, min_height_px: float = 0.0
) -> Evidence:
    """Evidence of a fixed camera, one row for each frame.

    Where the VRU's box cannot be `min_height_px` high, nothing is drawn and boxes are zeros.
    """
    return _perceive(
        surroundings,
        pose,
        camera,
        tilt_deg=np.zeros(len(surroundings.vru_poses)),
        static_poses=surroundings.static_poses,
        vru_poses=surroundings.vru_poses,
        vehicle_index=np.insert(surroundings.traffic_index, 0, 0, axis=1),
        vehicle_poses=np.insert(surroundings.traffic_poses, 0, surroundings.vut_poses, axis=1),
        sight_of_frame=surroundings.sight_index,
        min_height_px=min_height_px,
    )


def perceive_from_vut(
    surroundings: Surroundings, vut_camera: VutCamera, *, min_height_px: float = 0.0
) -> Evidence:
    """Evidence of the VUT's own camera; the VUT itself is not drawn."""
    mount = vut_camera.pose_on(surroundings.vut_actor)
    vut_poses = level_carriers(surroundings, mount)
    static_poses = relative_road_poses(surroundings.static_poses, vut_poses)
    vru_poses = relative_road_poses(surroundings.vru_poses, vut_poses)
    return _perceive(
        surroundings,
        mount,
        vut_camera.camera,
        tilt_deg=surroundings.vut_pitch_deg,
        static_poses=static_poses,
        vru_poses=vru_poses,
        vehicle_index=surroundings.traffic_index,
        vehicle_poses=relative_road_poses(surroundings.traffic_poses, vut_poses),
        sight_of_frame=find_sights(
            surroundings.static_index, surroundings.vru_index, static_poses, vru_poses
        ),
        min_height_px=min_height_px,
    )


def _perceive(
    surroundings: Surroundings,
    pose: Pose,
    camera: CameraModel,
    *,
    tilt_deg: FloatArray,
    static_poses: FloatArray,
    vru_poses: FloatArray,
    vehicle_index: IntArray,
    vehicle_poses: FloatArray,
    sight_of_frame: IntArray,
    min_height_px: float,
) -> Evidence:
    """Evidence from poses relative to the frame in which the camera stands.

    It looks up by `tilt_deg`, (n_frames,), more than its pose says.
    """
    from .pixels import see  # loads the compiler
    from .triangle_kernels import Image

    n_frames = len(vru_poses)
    order = np.argsort(sight_of_frame, kind="stable")
    start = np.flatnonzero(np.diff(sight_of_frame[order], prepend=-1))
    first = order[start]  # a frame of each sight
    start = np.append(start, n_frames)
    vru = _place(pose, vru_poses[first], tilt_deg[first])
    static = _place(pose, static_poses[first], tilt_deg[first])
    is_there = vehicle_index[order] >= 0
    tilts = np.broadcast_to(tilt_deg[order, None], is_there.shape)[is_there]
    vehicles = _place(pose, vehicle_poses[order][is_there], tilts)
    vehicle_kind = vehicle_index[order][is_there]
    vehicle_start = np.concatenate([[0], np.cumsum(is_there.sum(axis=1))])
    seen = _blank(len(first), n_frames)
    image = Image(
        focal_px=camera.focal_length_px,
        width_px=camera.width_px,
        height_px=camera.height_px,
        near_m=camera.near_m,
        up_m=float(pose.position_m[2]),
    )
    kinds = np.stack([surroundings.static_index, surroundings.vru_index], axis=1)[first]
    changes = np.flatnonzero((np.diff(kinds, axis=0, prepend=-1) != 0).any(axis=1)).tolist()
    distance_m = np.empty(n_frames)
    for begin, end in itertools.pairwise([*changes, len(first)]):
        static_index, vru_index = kinds[begin]
        body = surroundings.vrus[vru_index]
        standing, parked = surroundings.statics[static_index].meshes
        sights, frames = slice(begin, end), slice(start[begin], start[end])
        driving = slice(vehicle_start[frames.start], vehicle_start[frames.stop])
        see(
            image,
            min_height_px,
            body.meshes[0].skin,
            body.hull_m,
            standing.tree,
            parked.tree,
            surroundings.vehicle_trees,
            Sights(
                vru=vru.take(sights),
                static=static.take(sights),
                frame_start=start[begin : end + 1] - start[begin],
                vehicles=vehicles.take(driving),
                vehicle_kind=vehicle_kind[driving],
                vehicle_start=vehicle_start[frames.start : frames.stop + 1] - driving.start,
            ),
            seen.take(sights, frames),
        )
        of_kind = order[frames]
        distance_m[of_kind] = distances_m(pose, vru_poses[of_kind], body.hull_m)
    sight = np.empty(n_frames, dtype=np.int64)  # of each frame
    sight[order] = np.repeat(np.arange(len(first)), np.diff(start))
    visible, shares = np.empty((n_frames, 4)), np.empty(n_frames)
    visible[order], shares[order] = seen.frame_visible_px, seen.frame_visible_share
    return Evidence(
        visible_px=freeze(visible),
        amodal_px=freeze(seen.amodal_px[sight]),
        contrast=surroundings.contrast(distance_m),
        visible_share=shares,
        inside_share=seen.inside_share[sight],
        aspect_deg=aspects_deg(vru_poses[:, :2] - pose.position_m[:2], vru_poses[:, 2]),
        vru_class=surroundings.vru_class,
        draw_index=surroundings.draw_index,
    )


def _place(pose: Pose, road_poses: FloatArray, tilt_deg: FloatArray) -> Placed:
    """Bodies at road poses (n, 4), in the frame of a camera at a pose that is tilted, (n,)."""
    offsets = road_poses[:, [0, 1, 3]] - pose.position_m
    if tilt_deg.any():
        from_camera = camera_rotation(pose.yaw_deg, pose.pitch_deg + tilt_deg)
        shift = np.einsum("ni,nij->nj", offsets, from_camera)
    else:
        from_camera = camera_rotation(pose.yaw_deg, pose.pitch_deg)
        shift = offsets @ from_camera
    return Placed(
        turn=np.ascontiguousarray(
            np.swapaxes(from_camera, -1, -2) @ body_rotation(road_poses[:, 2])
        ),
        shift=np.ascontiguousarray(shift),
        up_m=np.ascontiguousarray(road_poses[:, 3]),
    )


def _blank(n_sights: int, n_frames: int) -> Seen:
    """Nothing seen yet."""
    return Seen(
        amodal_px=np.zeros((n_sights, 4)),
        inside_share=np.zeros(n_sights),
        visible_px=np.zeros((n_sights, 4)),
        visible_share=np.ones(n_sights),
        frame_visible_px=np.zeros((n_frames, 4)),
        frame_visible_share=np.ones(n_frames),
    )


def distances_m(pose: Pose, vru_poses: FloatArray, hull_m: FloatArray) -> FloatArray:
    """From a sensor to the middle of the VRU, (n,), in metres."""
    offsets = np.empty((len(vru_poses), 3))
    offsets[:, :2] = vru_poses[:, :2] - pose.position_m[:2]
    offsets[:, 2] = 0.5 * hull_m[:, 2].max() + vru_poses[:, 3] - pose.position_m[2]
    distance: FloatArray = np.linalg.norm(offsets, axis=1)
    return distance
