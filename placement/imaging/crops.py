"""Parts of pictures around what matters: to train networks with, and to show to them.

A crop is what :func:`placement.imaging.draw_picture` draws there, but for its sensor noise, its
raindrops, and an exposure that is set by fewer pixels of the whole image.
"""

import math
from dataclasses import replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.poses import Pose, camera_rotation
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel
from geometry.weather import Weather
from scenarios.runs import Run

from .exposure import (
    add_glare,
    add_rain,
    develop,
    find_edges,
    load_imager,
    white_luminance,
)
from .materials import Materials
from .mesh import FrameMesh, add_moving_meshes, build_moving_meshes, move_origin, place_mesh
from .picture import (
    Backdrop,
    Picture,
    Shades,
    Shot,
    Window,
    build_shot,
    names_of,
    pixel_rays,
    shade_rays,
    smooth_image,
    tile_rays,
)
from .stills import Still, add_moving

_METERED_PX = (48, 27)  # columns and rows of the whole image that set the exposure


def window_around(box_px: FloatArray, camera: CameraModel, *, side_px: int) -> Window:
    """The square with a box (4,) in its middle, as far as it lies in the image.

    Where the image ends it is moved inwards, so that it keeps its side.
    """
    width, height = min(side_px, camera.width_px), min(side_px, camera.height_px)
    middle = 0.5 * (box_px[:2] + box_px[2:])
    left = int(np.clip(middle[0] - 0.5 * width, 0, camera.width_px - width))
    top = int(np.clip(middle[1] - 0.5 * height, 0, camera.height_px - height))
    return Window(left, top, width, height)


def draw_crop(
    backdrop: Backdrop,
    still: FrameMesh,
    run: Run,
    frame_index: int,
    pose: Pose,
    camera: CameraModel,
    window: Window,
    *,
    weather: Weather,
    with_vut: bool = True,
    materials: Materials | None = None,
    white_cd_m2: float | None = None,
    seed: int = 0,
) -> Picture:
    """Render a window of one frame of a run, as large as the window.

    `still` has the backdrop's triangles ready for rays, ``place_mesh(backdrop.mesh, np.zeros(3))``;
    pose and camera are those of the whole image. `with_vut` says if the VUT is seen: its headlights
    shine in any case. `white_cd_m2` is the luminance that becomes white, by default what
    :func:`meter` finds in the frame; the seed is that of noise and drops.
    """
    still = move_origin(still, pose.position_m)
    mesh = add_moving_meshes(still, build_moving_meshes(run, frame_index, with_vut=with_vut))
    shot = build_shot(
        *(backdrop, mesh, pose, camera, weather),
        run=run,
        frame_index=frame_index,
        materials=materials,
    )
    size = (window.height, window.width)
    shades, _ = shade_rays(shot, tile_rays(shot, window.rows, window.columns))
    image = Shades(
        shades.radiance.reshape(*size, 3),
        shades.instance.reshape(size),
        shades.depth_m.reshape(size),
    )
    edges = np.flatnonzero(find_edges(image.radiance))
    smooth_image(shot, window, image.radiance, edges, map)
    return _expose(shot, image, image.radiance, pose, window, white_cd_m2, [seed, frame_index])


def crop_onto(
    still: Still,
    run: Run,
    frame_index: int,
    *,
    with_vut: bool = True,
    white_cd_m2: float | None = None,
    seed: int = 0,
) -> Picture:
    """Draw what :func:`draw_crop` draws in a still's window, for many frames of one camera.

    Only what moves changes is drawn anew; see :func:`placement.imaging.stills.draw_onto`.
    """
    shot, image, smooth = add_moving(still, run, frame_index, with_vut=with_vut)
    seeds = [seed, frame_index]
    return _expose(shot, image, smooth, still.pose, still.window, white_cd_m2, seeds)


def _expose(
    shot: Shot,
    image: Shades,
    radiance: FloatRays,
    pose: Pose,
    window: Window,
    white_cd_m2: float | None,
    seeds: list[int],
) -> Picture:
    """A picture of radiances (h, w, 3) that are written over: glare, rain, exposure and noise."""
    rng = np.random.default_rng([*seeds, *window])
    corner = (window.left, window.top)
    add_glare(radiance, pose, shot.camera, shot.lamps, shot.mesh.caster, corner_px=corner)
    add_rain(
        radiance,
        _window_camera(shot.camera, window),
        shot.weather,
        shot.sky,
        pitch_deg=pose.pitch_deg,
        exposure_s=load_imager()["rain_exposure_s"],
        rng=rng,
    )
    white = _meter(shot) if white_cd_m2 is None else white_cd_m2
    return Picture(
        rgb=develop(radiance, white, load_imager(), rng),
        instance=image.instance,
        depth_m=image.depth_m,
        names=names_of(shot.mesh),
    )


def silhouette(
    run: Run, frame_index: int, pose: Pose, camera: CameraModel, window: Window
) -> BoolArray:
    """Pixels (h, w) of a window that the VRU covers where nothing hides it."""
    vru = place_mesh(build_moving_meshes(run, frame_index, with_vut=False)[-1], pose.position_m)
    right, down, ahead = camera_rotation(pose.yaw_deg, pose.pitch_deg).T.astype(np.float32)
    focal = camera.focal_length_px
    across = np.arange(window.width) + (window.left + 0.5 - 0.5 * camera.width_px)
    below = np.arange(window.height) + (window.top + 0.5 - 0.5 * camera.height_px)
    columns = (across / focal).astype(np.float32)[None, :, None] * right
    rows = (below / focal).astype(np.float32)[:, None, None] * down
    ways = np.ascontiguousarray((ahead + rows + columns).reshape(-1, 3))
    _, triangle = vru.caster.first_triangle(np.zeros_like(ways), ways)
    covered: BoolArray = (triangle >= 0).reshape(window.height, window.width)
    return covered


def meter(
    backdrop: Backdrop, still: FrameMesh, pose: Pose, camera: CameraModel, weather: Weather
) -> float:
    """Luminance that is white in a picture of what stands still, in cd/m^2."""
    mesh = move_origin(still, pose.position_m)
    return _meter(build_shot(backdrop, mesh, pose, camera, weather))


def _meter(shot: Shot) -> float:
    """Luminance that is white, from a coarse grid over the whole image."""
    camera, (n_columns, n_rows) = shot.camera, _METERED_PX
    across = (np.arange(n_columns, dtype=np.float32) + 0.5) * (camera.width_px / n_columns)
    down = (np.arange(n_rows, dtype=np.float32) + 0.5) * (camera.height_px / n_rows)
    grid = np.stack(np.meshgrid(across, down), axis=-1).astype(np.float32).reshape(-1, 2)
    seen: FloatRays = shade_rays(shot, pixel_rays(shot, grid[:, 0], grid[:, 1]))[0].radiance
    return white_luminance(seen.reshape(n_rows, n_columns, 3), load_imager(), every=1)


def _window_camera(camera: CameraModel, window: Window) -> CameraModel:
    """A camera with the same focal length whose whole image has the window's size."""
    half = math.atan(0.5 * window.width / camera.focal_length_px)
    return replace(
        camera,
        width_px=window.width,
        height_px=window.height,
        horizontal_fov_deg=math.degrees(2.0 * half),
        fov_range_deg=None,
    )
