"""Point clouds: what a LiDAR reports of a frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray
from geometry.lidar import (
    LidarModel,
    beam_directions,
    load_lidar_detection,
    load_surface_reflectivity,
    noisy_ranges,
    return_probability,
)
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.weather import Weather
from scenarios.runs import Run

from ..detectors import vru_class
from .mesh import FrameMesh, build_frame_mesh, build_static_mesh


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


def scan_cloud(
    scene: Scene,
    run: Run,
    frame_index: int,
    pose: Pose,
    lidar: LidarModel,
    *,
    weather: Weather,
    with_vut: bool = True,
    seed: int = 0,
) -> PointCloud:
    """Scan one frame of a run: one point for each pulse that comes back.

    The VUT's own LiDAR does not see the VUT (`with_vut`). The seed is that of noise, and of which
    pulses come back.
    """
    static = build_static_mesh(scene, run.obstruction)
    mesh = build_frame_mesh(static, run, frame_index, pose.position_m, with_vut=with_vut)
    beams = beam_directions(lidar).reshape(-1, 3)
    ways = beams @ body_rotation(pose.yaw_deg, pose.pitch_deg).T
    starts = lidar.near_m * ways
    share, triangle = mesh.caster.first_triangle(starts.astype(np.float32), ways.astype(np.float32))
    hits = triangle >= 0
    triangle, distance = triangle[hits], share[hits].astype(np.float64) + lidar.near_m
    instance = mesh.triangle_thing[triangle]
    reflectivity = _reflectivity(mesh, run)[instance]
    cosine = np.abs(np.einsum("ni,ni->n", _normals(mesh)[triangle], ways[hits]))
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


def _reflectivity(mesh: FrameMesh, run: Run) -> FloatArray:
    """Reflectivity of each thing, (n_things,)."""
    by_class = load_surface_reflectivity()
    of_vru = load_lidar_detection().reflectivity[vru_class(run.encounter.vru)]
    return np.array(
        [of_vru if thing.name == "vru" else by_class[thing.class_name] for thing in mesh.things]
    )


def _normals(mesh: FrameMesh) -> FloatArray:
    """Flat unit normals of the triangles, (m, 3)."""
    a, b, c = np.moveaxis(mesh.corners_m.astype(np.float64), 1, 0)
    across = np.cross(b - a, c - a)
    normals: FloatArray = across / np.linalg.norm(across, axis=1, keepdims=True).clip(1.0e-12)
    return normals
