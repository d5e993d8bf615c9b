"""Pictures of a frame: colours, instances and depths, one ray per pixel."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.actors import PlacedActor
from geometry.arrays import IntArray
from geometry.poses import Pose, camera_rotation
from geometry.raycast import FloatRays
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.weather import Weather
from scenarios.runs import Run

from .air import add_glare, add_rain
from .edges import find_edges, smooth_pixels
from .ground import GroundMap, build_ground_map
from .imager import develop, load_imager, white_luminance
from .lamps import Lamp, StreetLamp, build_headlights, build_street_lamps
from .materials import build_things, load_materials
from .mesh import Mesh, build_frame_mesh, build_static_mesh, vut_pose
from .shading import Shot, shade_rays, tile_rays
from .sky import build_sky

_EDGES = 12_000  # pixels that are smoothed at a time
_TILE_PX = (90, 480)  # rows, columns drawn at a time: fit into a cache, and are near few lamps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """What a camera sees.

    Attributes
    ----------
    rgb : (h, w, 3) uint8
        sRGB.
    instance : (h, w) int32
        Index into `names`; -1 where there is sky.
    depth_m : (h, w) float32
        Along the optical axis; infinite where there is sky. [m]
    names : tuple of str
        The scene's instances, "parked-1" .. for what parks in the run, "vut" if it is drawn, "vru".
    """

    rgb: NDArray[np.uint8]
    instance: NDArray[np.int32]
    depth_m: FloatRays
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Backdrop:
    """What stands still in all frames of a run, ready to be drawn many times.

    Attributes
    ----------
    mesh : Mesh
        Scene and obstruction.
    ground : GroundMap
        The road plane.
    street_lamps : tuple of StreetLamp
        On the scene's lamp posts.
    """

    mesh: Mesh
    ground: GroundMap
    street_lamps: tuple[StreetLamp, ...]


def build_backdrop(scene: Scene, obstruction: Sequence[PlacedActor]) -> Backdrop:
    """Prepare a scene for pictures.

    Parameters
    ----------
    scene : Scene
        The junction.
    obstruction : sequence of PlacedActor
        What parks in the run.

    Returns
    -------
    backdrop : Backdrop
        For all runs with this obstruction.
    """
    mesh = build_static_mesh(scene, obstruction)
    return Backdrop(
        mesh=mesh,
        ground=build_ground_map(scene, mesh.things, load_materials().markings),
        street_lamps=build_street_lamps(scene),
    )


def render_picture(
    scene: Scene,
    run: Run,
    frame_index: int,
    pose: Pose,
    camera: CameraModel,
    *,
    weather: Weather,
    with_vut: bool = True,
    seed: int = 0,
    workers: int = 1,
) -> Picture:
    """Render one frame of a run; for many frames see :func:`draw_picture`.

    Parameters
    ----------
    scene : Scene
        The junction.
    run, frame_index, pose, camera, weather, with_vut, seed, workers
        As for :func:`draw_picture`.

    Returns
    -------
    picture : Picture
        At the camera's resolution.
    """
    return draw_picture(
        build_backdrop(scene, run.obstruction),
        run,
        frame_index,
        pose,
        camera,
        weather=weather,
        with_vut=with_vut,
        seed=seed,
        workers=workers,
    )


def draw_picture(
    backdrop: Backdrop,
    run: Run,
    frame_index: int,
    pose: Pose,
    camera: CameraModel,
    *,
    weather: Weather,
    with_vut: bool = True,
    seed: int = 0,
    workers: int = 1,
) -> Picture:
    """Render one frame of a run.

    Parameters
    ----------
    backdrop : Backdrop
        Of the run's scene and obstruction.
    run : Run
        What drives.
    frame_index : int
        When: 0 .. number of frames - 1.
    pose : Pose
        Of the camera, world frame.
    camera : CameraModel
        Resolution, field of view, nearest distance that is drawn.
    weather : Weather
        Light and air.
    with_vut : bool
        Whether the VUT is drawn; its own camera does not see it. Its headlights shine in any case.
    seed : int
        Of sensor noise and drops.
    workers : int
        Threads; the picture does not depend on them.

    Returns
    -------
    picture : Picture
        At the camera's resolution.
    """
    mesh = build_frame_mesh(backdrop.mesh, run, frame_index, pose.position_m, with_vut=with_vut)
    lamps: tuple[Lamp, ...] = ()
    if weather.has_lamps:
        headlights = build_headlights(run.encounter.vut, vut_pose(run, frame_index))
        lamps = (*backdrop.street_lamps, *headlights)
    materials = load_materials()
    shot = Shot(
        R_world_camera=camera_rotation(pose.yaw_deg, pose.pitch_deg),
        camera=camera,
        mesh=mesh,
        things=build_things(mesh.things, materials),
        materials=materials,
        ground=backdrop.ground,
        sky=build_sky(weather),
        lamps=lamps,
        weather=weather,
    )
    height, width = camera.height_px, camera.width_px
    radiance = np.empty((height, width, 3), dtype=np.float32)
    instance = np.empty((height, width), dtype=np.int32)
    depth_m = np.empty((height, width), dtype=np.float32)
    rgb = np.empty((height, width, 3), dtype=np.uint8)
    tiles = [
        (
            slice(row, min(row + _TILE_PX[0], height)),
            slice(column, min(column + _TILE_PX[1], width)),
        )
        for row in range(0, height, _TILE_PX[0])
        for column in range(0, width, _TILE_PX[1])
    ]

    def shade(tile: tuple[slice, slice]) -> None:
        for image, values in zip(
            (radiance, instance, depth_m), shade_rays(shot, tile_rays(shot, *tile)), strict=True
        ):
            image[tile] = values.reshape(image[tile].shape)

    def smooth(part: IntArray) -> None:
        flat = radiance.reshape(-1, 3)
        flat[part] = smooth_pixels(shot, part, flat[part])

    def expose(white_cdpm2: float, tile: tuple[slice, slice]) -> None:
        rng = np.random.default_rng([seed, frame_index, tile[0].start, tile[1].start])
        rgb[tile] = develop(radiance[tile].copy(), white_cdpm2, load_imager(), rng)

    # One BLAS thread each: the matrices are small.
    with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
        list(pool.map(shade, tiles))
        edges = find_edges(radiance, _TILE_PX)
        list(pool.map(smooth, np.array_split(edges, 1 + len(edges) // _EDGES)))
        add_glare(radiance, pose, camera, lamps, mesh.caster)
        rng = np.random.default_rng([seed, frame_index, height, width])
        add_rain(radiance, camera, weather, shot.sky, pose.pitch_deg, rng)
        white_cdpm2 = white_luminance(radiance, load_imager())
        list(pool.map(partial(expose, white_cdpm2), tiles))
    return Picture(
        rgb=rgb,
        instance=instance,
        depth_m=depth_m,
        names=tuple(thing.name for thing in mesh.things),
    )
