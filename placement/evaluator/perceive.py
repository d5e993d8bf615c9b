"""Boxes of the VRU in every frame, by pixels, and LiDAR points on it.

Each unit is a sensor that is fixed to something: an RSU to the world, the VUT's sensors
to the VUT. Seen from there many instants look the same but for the VUT and other
vehicles that drive: such a sight is drawn, or scanned, once.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, pairwise
from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial import cKDTree

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.lidar import (
    LidarModel,
    beam_directions,
    load_lidar_detection,
    return_probability,
)
from geometry.poses import Pose, body_rotation, camera_rotation
from geometry.registry import load_entry
from geometry.sensors import CameraModel
from geometry.weather import Weather

from ..detectors import VRU_CLASSES, Evidence, aspects_deg
from .pixels import Image, Placed, SeenBoxes, Sights, blank_sights, see
from .surroundings import (
    FrameCamera,
    Solid,
    Surroundings,
    VutCamera,
    find_sights,
    level_carriers,
    relative_road_poses,
)

_SIGHTS_AT_ONCE = 256
# Added to a chord, so that no beam at the edge is left out.
_SLACK = 1.0e-9


# ---------- frames as a sensor has them before it
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Station:
    """A sensor's place, and road poses relative to the frame in which it stands.

    Attributes
    ----------
    pose : Pose
        Of the sensor.
    tilt_deg : (n_frames,) float
        How much farther up it looks than its pose says. [deg]
    static_poses, vru_poses : (n_frames, 4) float
        Road poses of the static world and of the VRU.
    vehicle_index : (n_frames, n) int
        Kinds of the vehicles; -1 for none.
    vehicle_poses : (n_frames, n, 4) float
        Road poses of the vehicles.
    order : (n_frames,) int
        Frames, sight by sight; sights that show the same bodies follow one another.
    start : (n_sights + 1,) int
        Where each sight begins in `order`.
    """

    pose: Pose
    tilt_deg: FloatArray
    static_poses: FloatArray
    vru_poses: FloatArray
    vehicle_index: IntArray
    vehicle_poses: FloatArray
    order: IntArray
    start: IntArray

    @property
    def first(self) -> IntArray:
        """First frame of each sight, (n_sights,)."""
        return self.order[self.start[:-1]]

    @property
    def sight_of_frame(self) -> IntArray:
        """Sight that each frame shows, (n_frames,)."""
        numbers = np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))
        return numbers[np.argsort(self.order)]


def _stand(surroundings: Surroundings, at: Pose | VutCamera) -> _Station:
    """Arrange the frames as a sensor sees them.

    Parameters
    ----------
    surroundings : Surroundings
        Everything that can be seen.
    at : Pose or VutCamera
        A fixed sensor's pose, world frame, or the place of a sensor on the VUT, which
        then is not seen.
    """
    static_poses = surroundings.static_poses
    vru_poses = surroundings.vru_poses
    vehicle_index = surroundings.traffic_index
    vehicle_poses = surroundings.traffic_poses
    if isinstance(at, Pose):
        pose = at
        tilt_deg = np.zeros(len(vru_poses))
        vehicle_index = np.insert(vehicle_index, 0, 0, axis=1)
        vehicle_poses = np.insert(vehicle_poses, 0, surroundings.vut_poses, axis=1)
        sight_index = surroundings.sight_index
    else:
        pose = at.pose_on(surroundings.vut_actor)
        tilt_deg = surroundings.vut_pitch_deg
        vut_poses = level_carriers(surroundings, pose)
        static_poses, vru_poses, vehicle_poses = (
            relative_road_poses(poses, vut_poses)
            for poses in (static_poses, vru_poses, vehicle_poses)
        )
        kinds = surroundings.static_index, surroundings.vru_index
        sight_index = find_sights(*kinds, static_poses, vru_poses)
    order = np.argsort(sight_index, kind="stable")
    start = np.flatnonzero(np.diff(sight_index[order], prepend=-1))
    return _Station(
        pose=pose,
        tilt_deg=tilt_deg,
        static_poses=static_poses,
        vru_poses=vru_poses,
        vehicle_index=vehicle_index,
        vehicle_poses=vehicle_poses,
        order=order,
        start=np.append(start, len(order)),
    )


def _same_bodies(
    surroundings: Surroundings, station: _Station
) -> Iterator[tuple[slice, int, int]]:
    """Ranges of sights that show the same static world and the same body.

    Yields
    ------
    sights : slice
        Range of sights.
    static_index, vru_index : int
        Numbers of the static world and of the VRU's shape.
    """
    kinds = np.stack([surroundings.static_index, surroundings.vru_index], axis=1)[
        station.first
    ]
    changes = np.flatnonzero(
        (np.diff(kinds, axis=0, prepend=-1) != 0).any(axis=1)
    ).tolist()
    for begin, end in pairwise([*changes, len(kinds)]):
        yield slice(begin, end), *kinds[begin].tolist()


def _distances_m(pose: Pose, vru_poses: FloatArray, hull_m: FloatArray) -> FloatArray:
    """Distance from a sensor to the middle of the VRU, (n,), in metres."""
    offsets = np.empty((len(vru_poses), 3))
    offsets[:, :2] = vru_poses[:, :2] - pose.position_m[:2]
    offsets[:, 2] = 0.5 * hull_m[:, 2].max() + vru_poses[:, 3] - pose.position_m[2]
    return np.asarray(np.linalg.norm(offsets, axis=1))


# ---------- cameras
PROJECTIONS = {
    "pinhole": "placement.evaluator.perceive:draw_in_pinhole",
    "lens": "placement.evaluator.lens_pixels:draw_in_lens",
}
"""Registry of what draws bodies into pictures, by how cameras project.

Each entry is a :class:`BodyDrawer`.
"""


class BodyDrawer(Protocol):
    """What draws one VRU's body in one static world, and finds its boxes."""

    def __call__(
        self,
        image: Image,
        camera: CameraModel,
        min_height_px: float,
        vru: Solid,
        static: Solid,
        surroundings: Surroundings,
        sights: Sights,
        seen: SeenBoxes,
    ) -> None:
        """Fill `seen`: boxes and shares of the body in all sights.

        Where the VRU's part of the image is lower than `min_height_px`, boxes stay
        zeros.
        """


def draw_in_pinhole(
    image: Image,
    _camera: CameraModel,
    min_height_px: float,
    vru: Solid,
    static: Solid,
    surroundings: Surroundings,
    sights: Sights,
    seen: SeenBoxes,
) -> None:
    """Draw without distortion, as a :class:`BodyDrawer`."""
    standing, parked = static.meshes
    see(
        image,
        min_height_px,
        vru.meshes[0].skin,
        np.ascontiguousarray(vru.hull_m.T),
        standing.tree,
        parked.tree,
        surroundings.vehicle_trees,
        sights,
        seen,
    )


def perceive_frames(
    surroundings: Surroundings, by: FrameCamera, *, min_height_px: float = 0.0
) -> Evidence:
    """Evidence of a camera, one row for each frame.

    Parameters
    ----------
    surroundings : Surroundings
        Everything that can be seen.
    by : VutCamera or (Pose, CameraModel)
        The camera; the VUT's own does not see the VUT.
    min_height_px : float
        Where the VRU's box cannot be so high, nothing is drawn and boxes are zeros.
        [px]

    Returns
    -------
    evidence : Evidence
    """
    at: Pose | VutCamera
    if isinstance(by, VutCamera):
        at = by
        camera = by.camera
    else:
        at, camera = by
    station = _stand(surroundings, at)
    pose = station.pose
    order = station.order
    start = station.start
    first = station.first
    n_frames = len(order)
    vru = _place(pose, station.vru_poses[first], station.tilt_deg[first])
    static = _place(pose, station.static_poses[first], station.tilt_deg[first])
    # Vehicles that are there, one frame after the other.
    is_there = station.vehicle_index[order] >= 0
    tilts = np.broadcast_to(station.tilt_deg[order, None], is_there.shape)[is_there]
    vehicles = _place(pose, station.vehicle_poses[order][is_there], tilts)
    vehicle_kind = station.vehicle_index[order][is_there]
    vehicle_start = np.concatenate([[0], np.cumsum(is_there.sum(axis=1))])
    seen = blank_sights(len(first), n_frames)
    image = Image(
        focal_px=camera.focal_length_px,
        width_px=camera.width_px,
        height_px=camera.height_px,
        near_m=camera.near_m,
        up_m=float(pose.position_m[2]),
    )
    if camera.is_pinhole:
        draw: BodyDrawer = load_entry(PROJECTIONS["pinhole"])
    else:
        draw = load_entry(PROJECTIONS["lens"])
    # Draw all sights with the same bodies at once.
    distance_m = np.empty(n_frames)
    for sights, static_index, vru_index in _same_bodies(surroundings, station):
        body = surroundings.vrus[vru_index]
        static_solid = surroundings.statics[static_index]
        frames = slice(start[sights.start], start[sights.stop])
        driving = slice(vehicle_start[frames.start], vehicle_start[frames.stop])
        placed = Sights(
            vru=vru.take(sights),
            static=static.take(sights),
            frame_start=start[sights.start : sights.stop + 1] - start[sights.start],
            vehicles=vehicles.take(driving),
            vehicle_kind=vehicle_kind[driving],
            vehicle_start=vehicle_start[frames.start : frames.stop + 1] - driving.start,
        )
        draw(
            image,
            camera,
            min_height_px,
            body,
            static_solid,
            surroundings,
            placed,
            seen.take(sights, frames),
        )
        of_kind = order[frames]
        distance_m[of_kind] = _distances_m(
            pose, station.vru_poses[of_kind], body.hull_m
        )
    sight = station.sight_of_frame
    visible = np.empty((n_frames, 4))
    shares = np.empty(n_frames)
    # Back from the order of the sights to that of the frames.
    visible[order] = seen.frame_visible_px
    shares[order] = seen.frame_visible_share
    sightline_m = station.vru_poses[:, :2] - pose.position_m[:2]
    return Evidence(
        visible_px=freeze(visible),
        amodal_px=freeze(seen.amodal_px[sight]),
        contrast=surroundings.contrast(distance_m),
        visible_share=shares,
        inside_share=seen.inside_share[sight],
        aspect_deg=aspects_deg(sightline_m, station.vru_poses[:, 2]),
        vru_class=surroundings.vru_class,
        draw_index=surroundings.draw_index,
    )


def _place(pose: Pose, road_poses: FloatArray, tilt_deg: FloatArray) -> Placed:
    """Bodies in the frame of a camera.

    Parameters
    ----------
    pose : Pose
        Of the camera.
    road_poses : (n, 4) float
        Of the bodies, in the frame in which the camera stands.
    tilt_deg : (n,) float
        How much farther up the camera looks than its pose says. [deg]
    """
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


# ---------- LiDARs
class _Echoes(NamedTuple):
    """Beams that reach the VRU in one sight.

    Attributes
    ----------
    directions : (n, 3) float
        Unit vectors in the frame in which the LiDAR stands.
    distance_m : (n,) float
        To the VRU. [m]
    incidence_cos : (n,) float
        Cosine of the angle of incidence.
    """

    directions: FloatArray
    distance_m: FloatArray
    incidence_cos: FloatArray

    def take(self, keep: BoolArray) -> "_Echoes":
        """The beams in a mask (n,)."""
        return _Echoes(
            self.directions[keep], self.distance_m[keep], self.incidence_cos[keep]
        )


def scan_frames(
    surroundings: Surroundings,
    at: Pose | VutCamera,
    lidar: LidarModel,
    rng: np.random.Generator,
) -> BoolArray:
    """Frames in which a LiDAR gets enough points on the VRU.

    Parameters
    ----------
    surroundings : Surroundings
        Everything that can be seen.
    at : Pose or VutCamera
        A fixed LiDAR's pose, or the place of the VUT's camera for its own LiDAR.
    lidar : LidarModel
        The LiDAR.
    rng : Generator
        Says which pulses come back: the same numbers in all weathers.

    Returns
    -------
    detected : (n_frames,) bool
    """
    station = _stand(surroundings, at)
    pose = station.pose
    first = station.first
    detected = np.zeros(len(station.order), dtype=bool)
    # By draw: all weathers share them, so that only the weather differs.
    random: dict[int, FloatArray] = {}
    beams = beam_directions(lidar).reshape(-1, 3)
    poses = np.concatenate([station.static_poses, station.vru_poses], axis=1)
    sight_of_frame = station.sight_of_frame
    for sights, static_index, vru_index in _same_bodies(surroundings, station):
        static = surroundings.statics[static_index]
        vru = surroundings.vrus[vru_index]
        # Scan the sights, some at a time.
        n_parts = -(-len(first[sights]) // _SIGHTS_AT_ONCE)
        in_parts = np.array_split(first[sights], n_parts)
        of_sights = [
            echoes
            for part in in_parts
            for echoes in _look(
                pose, lidar, beams, static, vru, poses[part], station.tilt_deg[part]
            )
        ]
        frames = station.order[station.start[sights.start] : station.start[sights.stop]]
        # Loop over the frames: vehicles and weather differ among those of a sight.
        for frame in np.sort(frames).tolist():
            draw = int(surroundings.draw_index[frame])
            echoes = of_sights[sight_of_frame[frame] - sights.start]
            for place in np.flatnonzero(station.vehicle_index[frame] >= 0).tolist():
                if len(echoes.distance_m):
                    vehicle = surroundings.vehicles[station.vehicle_index[frame, place]]
                    there = station.vehicle_poses[frame, place]
                    echoes = _before(echoes, pose, lidar, vehicle, there)
            weather = surroundings.weathers[surroundings.weather_index[frame]]
            vru_class = VRU_CLASSES[surroundings.vru_class[frame]]
            if draw not in random:
                random[draw] = rng.random(len(echoes.distance_m))
            detected[frame] = _is_enough(
                echoes, lidar, weather, vru_class, random[draw]
            )
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
    """Beams that reach the VRU before anything that stands still.

    Parameters
    ----------
    pose : Pose
        Of the LiDAR.
    lidar : LidarModel
        Its range and near limit.
    beams : (n_beams, 3) float
        Unit vectors, frame of the LiDAR.
    static, vru : Solid
        What stands still, and the VRU.
    poses : (n, 8) float
        Road poses of both in each sight.
    tilt_deg : (n,) float
        How much farther up the LiDAR looks than its pose says. [deg]

    Yields
    ------
    echoes : _Echoes
        Of one sight after the other.
    """
    vru_poses = poses[:, 4:]
    # Rotations from the LiDAR's own frame.
    turns = body_rotation(pose.yaw_deg, pose.pitch_deg + tilt_deg)
    # The sphere around the VRU, in each sight.
    distance = _distances_m(pose, vru_poses, vru.hull_m)
    half_height_m = 0.5 * vru.hull_m[:, 2].max()
    from_middle = vru.hull_m - [0.0, 0.0, half_height_m]
    radius_m = float(np.linalg.norm(from_middle, axis=1).max())
    middle = np.column_stack([vru_poses[:, :2], half_height_m + vru_poses[:, 3]])
    towards = (middle - pose.position_m) / distance[:, None]
    half_angle = np.arcsin(np.minimum(1.0, radius_m / distance))
    # Beams in the cone around the sphere.
    near = np.flatnonzero(distance - radius_m <= lidar.range_m)
    towards_lidar = np.einsum("ni,nij->nj", towards, turns)
    cone, beam = _beams_around(lidar, towards_lidar[near], half_angle[near])
    sight = near[cone]
    cosine = np.einsum("ni,ni->n", towards_lidar[sight], beams[beam])
    is_close = cosine >= np.cos(half_angle[sight])
    sight = sight[is_close]
    beam = beam[is_close]
    directions = np.einsum("nij,nj->ni", turns[sight], beams[beam])
    # Beams that hit the VRU.
    depth, triangle = _cast(pose, lidar, vru, vru_poses[sight], directions)
    hits = np.isfinite(depth)
    sight = sight[hits]
    directions = directions[hits]
    depth = depth[hits]
    triangle = triangle[hits]
    # Those that nothing static stops before.
    before, _ = _cast(pose, lidar, static, poses[sight, :4], directions)
    free = depth < before
    sight = sight[free]
    directions = directions[free]
    depth = depth[free]
    triangle = triangle[free]
    normals = np.einsum(
        "nij,nj->ni", body_rotation(vru_poses[sight, 2]), vru.normals[triangle]
    )
    cosine = np.abs(np.einsum("ni,ni->n", normals, directions))
    ends = np.searchsorted(sight, np.arange(len(poses) + 1))
    for start, end in pairwise(ends):
        yield _Echoes(directions[start:end], depth[start:end], cosine[start:end])


@lru_cache(maxsize=8)
def _beam_tree(lidar: LidarModel) -> cKDTree:
    """Beams of a frame as unit vectors, to look up those around a direction."""
    return cKDTree(beam_directions(lidar).reshape(-1, 3))


def _beams_around(
    lidar: LidarModel, towards: FloatArray, half_angle_rad: FloatArray
) -> tuple[IntArray, IntArray]:
    """Beams inside cones.

    Parameters
    ----------
    lidar : LidarModel
        Its scan pattern.
    towards : (n_cones, 3) float
        Axes of the cones, unit vectors in the LiDAR's frame.
    half_angle_rad : (n_cones,) float
        Their half angles. [rad]

    Returns
    -------
    cone, beam : (n,) int
        Cone, and beam in it: cone by cone, line by line, each from right to left. Beams
        are indices into the flattened scan pattern.

    Notes
    -----
    Beams go on over the seam of a LiDAR that scans all round: a cone has the same beams
    in the same order however the LiDAR is turned.
    """
    chord = 2.0 * np.sin(0.5 * half_angle_rad) + _SLACK
    found = _beam_tree(lidar).query_ball_point(towards, chord)
    cone = np.repeat(np.arange(len(towards)), [len(beams) for beams in found])
    beam = np.fromiter(chain.from_iterable(found), np.int64, len(cone))
    # Columns count from straight behind each cone.
    if lidar.scans_all_round:
        ahead = np.arctan2(towards[:, 1], towards[:, 0]) / (2.0 * np.pi)
        behind = np.ceil(ahead * lidar.n_columns - 0.5).astype(np.int64)
        line, column = np.divmod(beam, lidar.n_columns)
        beam = beam[np.lexsort([(column - behind[cone]) % lidar.n_columns, line, cone])]
    return cone, beam


def _cast(
    pose: Pose,
    lidar: LidarModel,
    solid: Solid,
    road_poses: FloatArray,
    directions: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Distance to a solid along each beam, and the triangle hit.

    Parameters
    ----------
    pose : Pose
        Of the LiDAR.
    lidar : LidarModel
        Its near limit counts.
    solid : Solid
        The body.
    road_poses : (n, 4) float
        Where the body is, for each beam.
    directions : (n, 3) float
        Unit vectors.

    Returns
    -------
    distance_m : (n,) float
        Infinite where nothing is hit. [m]
    triangle : (n,) int
        -1 where nothing is hit.
    """
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
    echoes: _Echoes,
    pose: Pose,
    lidar: LidarModel,
    vehicle: Solid,
    road_pose: FloatArray,
) -> _Echoes:
    """Beams that a vehicle at a road pose (4,) does not stop on their way."""
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
    echoes: _Echoes,
    lidar: LidarModel,
    weather: Weather,
    vru_class: str,
    random: FloatArray,
) -> bool:
    """True if enough pulses come back from the VRU.

    Parameters
    ----------
    echoes : _Echoes
        Beams that reach it.
    lidar : LidarModel
        Gives the probability that a pulse comes back.
    weather : Weather
        Extinction in the air.
    vru_class : str
        One of ``VRU_CLASSES``: its reflectivity, and how many points are needed.
    random : (n,) float
        A number for each beam, 0 to 1.
    """
    detection = load_lidar_detection()
    probability = return_probability(
        lidar,
        echoes.distance_m,
        reflectivity=detection.reflectivity[vru_class],
        incidence_cos=echoes.incidence_cos,
        extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
    )
    n_points = int((random < probability).sum())
    return n_points >= detection.min_points[vru_class]
