"""Pictures of a frame: colours, instances and depths, one ray per pixel."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray, IntArray
from geometry.poses import Pose, camera_rotation
from geometry.raycast import FloatRays
from geometry.scene import Scene
from geometry.sensors import CameraModel, picture_rays, pixel_grid
from geometry.tables import take_number
from geometry.weather import Weather
from scenarios.runs import Run

from ..compute import DEFAULT_COMPUTE, Compute, one_blas_thread
from . import exposure
from .ground import GroundMap, build_ground_map
from .light import (
    Lamp,
    Sky,
    StreetLamp,
    build_headlights,
    build_sky,
    build_street_lamps,
    illuminance,
    load_lamp_table,
)
from .materials import (
    Coat,
    Hits,
    Materials,
    Things,
    build_things,
    coat_cyclist,
    coat_facade,
    coat_ground,
    coat_motorcyclist,
    coat_pedestrian,
    coat_plain,
    coat_vehicle,
    coat_wall,
    load_materials,
)
from .mesh import (
    ROUND,
    FrameMesh,
    Index,
    Mesh,
    build_frame_mesh,
    build_static_mesh,
    vut_pose,
)

# How far off a surface mirrored rays start.
_OFF_SURFACE_M = 4.0e-3
# Surfaces that mirror a smaller share are not worth a ray.
_LEAST_MIRROR = 0.012
# Least cosine: limits how long a pixel is on a surface.
_GRAZING = np.float32(0.02)
# Schlick: towards grazing angles everything is mirrored; of glass, 24 times what is
# head-on.
_GRAZING_GAIN = np.float32(24.0)
_CLASSES = (
    "ground",
    "building",
    "wall",
    "vegetation",
    "lamp post",
    "traffic light",
    "parked vehicle",
    "vehicle",
    "pedestrian",
    "cyclist",
    "motorcyclist",
    "car",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """Everything that a picture is made from.

    Attributes
    ----------
    pose : Pose
        Of the camera.
    camera : CameraModel
        Its lens and image.
    mesh : FrameMesh
        Its origin is at the camera.
    things : Things
        Things of the mesh, as arrays.
    materials : Materials
        Colours and patterns.
    ground : GroundMap
        The road plane.
    sky : Sky
        Sky, sun and air.
    lamps : tuple of Lamp
        Those that are on.
    weather : Weather
        Wetness, rain, and whether lamps are on.
    """

    pose: Pose
    camera: CameraModel
    mesh: FrameMesh
    things: Things
    materials: Materials
    ground: GroundMap
    sky: Sky
    lamps: tuple[Lamp, ...]
    weather: Weather


Each = Callable[[Callable[[IntArray], None], Sequence[IntArray]], Iterable[None]]
"""Does something with each part: ``map``, or a pool's."""


class Window(NamedTuple):
    """A part of an image, in whole pixels.

    Attributes
    ----------
    left, top : int
        First column and row. [px]
    width, height : int
        [px]
    """

    left: int
    top: int
    width: int
    height: int

    @property
    def rows(self) -> slice:
        """Rows of the whole image."""
        return slice(self.top, self.top + self.height)

    @property
    def columns(self) -> slice:
        """Columns of the whole image."""
        return slice(self.left, self.left + self.width)

    def in_whole(self, pixels: IntArray, camera: CameraModel) -> IntArray:
        """Numbers of pixels in the whole image, from those in the window.

        Parameters
        ----------
        pixels : (n,) int
            Row * width + column, in the window.
        camera : CameraModel
            Its whole image.

        Returns
        -------
        pixels : (n,) int
            Row * width + column, in the whole image.
        """
        down, across = np.divmod(pixels, self.width)
        return (down + self.top) * camera.width_px + across + self.left


def whole_image(camera: CameraModel) -> Window:
    """The window that holds all of a camera's image."""
    return Window(0, 0, camera.width_px, camera.height_px)


class Shades(NamedTuple):
    """Light, things and depths that rays meet.

    Attributes
    ----------
    radiance : (n, 3) float32
        [cd/m^2]
    instance : (n,) int32
        Index of the thing; -1 where there is sky.
    depth_m : (n,) float32
        Along the optical axis; infinite where there is sky. [m]
    """

    radiance: FloatRays
    instance: Index
    depth_m: FloatRays


class Surfaces(NamedTuple):
    """Surfaces that rays meet, to add light to later; zeros where there is sky.

    Attributes
    ----------
    albedo : (n, 3) float32
        Of the surface.
    lux : (n, 3) float32
        Light that falls on it. [lx]
    normals : (n, 3) float32
        Unit normals.
    mirrored : (n, 3) float32
        Where the mirrored ray goes; zeros where none is cast.
    """

    albedo: FloatRays
    lux: FloatRays
    normals: FloatRays
    mirrored: FloatRays


def blank_surfaces(*size: int) -> Surfaces:
    r"""Surfaces of which nothing is known yet, (\*size, 3) each."""
    return Surfaces(*(np.zeros((*size, 3), dtype=np.float32) for _ in Surfaces._fields))


def shade_rays(shot: Shot, ways: FloatRays) -> tuple[Shades, Surfaces]:
    """Shades and surfaces that rays from the camera meet.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    ways : (n, 3) float32
        Rays one metre deep, in the world's axes. Where a lens shows nothing they are
        zeros, and it is dark.

    Returns
    -------
    shades : Shades
    surfaces : Surfaces
    """
    dark = np.flatnonzero(~ways.any(axis=1))
    if len(dark):
        ways = ways.copy()
        # Up, for now: their light is removed below.
        ways[dark, 2] = 1.0
    camera = shot.camera
    mesh = shot.mesh
    sky = shot.sky
    length = np.sqrt(np.einsum("ij,ij->i", ways, ways))
    # Rays start where drawing starts.
    near = np.float32(camera.near_m) / length
    depth, triangle = mesh.caster.first_triangle(near[:, None] * ways, ways)
    depth = depth + near
    is_hit = triangle >= 0
    instance = np.full(len(ways), -1, dtype=np.int32)
    radiance = np.empty((len(ways), 3), dtype=np.float32)
    surfaces = blank_surfaces(len(ways))
    nothing = np.flatnonzero(~is_hit)
    radiance[nothing] = sky.luminance(ways[nothing, 2] / length[nothing])
    met = np.flatnonzero(is_hit)
    instance[met] = mesh.triangle_thing.take(triangle[met])
    classes = [_CLASSES.index(thing.class_name) for thing in mesh.things]
    kinds = np.array(classes, dtype=np.int8)[instance]
    # Surfaces of one class at a time: each class has a coat of its own.
    for kind in np.unique(kinds[met]).tolist():
        index = np.flatnonzero(is_hit & (kinds == kind))
        ahead = ways[index] / length[index, None]
        distance = depth[index] * length[index]
        hits = _find_hits(
            shot, ahead, distance, triangle[index], is_round=_CLASSES[kind] in ROUND
        )
        light, met_there = _shade(shot, _CLASSES[kind], hits, ahead)
        for whole, part in zip(surfaces, met_there, strict=True):
            whole[index] = part
        sky.fade(light, distance)
        radiance[index] = light
    radiance[dark] = 0.0
    instance[dark] = -1
    depth[dark] = np.inf
    for whole in surfaces:
        whole[dark] = 0.0
    return Shades(radiance, instance, depth), surfaces


def tile_rays(
    pose: Pose, camera: CameraModel, rows: slice, columns: slice
) -> FloatRays:
    """Rays through the middles of a tile's pixels.

    Parameters
    ----------
    pose : Pose
        Of the camera.
    camera : CameraModel
        Its lens and image.
    rows, columns : slice
        The tile, in the whole image.

    Returns
    -------
    rays : (n_rows * n_columns, 3) float32
        One metre deep, in the world's axes.
    """
    if not camera.is_pinhole:
        return _lens_rays(pose, pixel_grid(camera)[rows, columns].reshape(-1, 2))
    focal = camera.focal_length_px
    across = (
        np.arange(columns.start, columns.stop) + 0.5 - 0.5 * camera.width_px
    ) / focal
    down = (np.arange(rows.start, rows.stop) + 0.5 - 0.5 * camera.height_px) / focal
    rotation = camera_rotation(pose.yaw_deg, pose.pitch_deg)
    right = (across[:, None] * rotation[:, 0]).astype(np.float32)
    ahead = (down[:, None] * rotation[:, 1] + rotation[:, 2]).astype(np.float32)
    return (ahead[:, None] + right).reshape(-1, 3)


def pixel_rays(shot: Shot, columns_px: FloatRays, rows_px: FloatRays) -> FloatRays:
    """Rays through points of the image.

    Parameters
    ----------
    shot : Shot
        Its camera counts.
    columns_px, rows_px : (n,) float32
        Points of the image. [px]

    Returns
    -------
    rays : (n, 3) float32
        One metre deep, in the world's axes.
    """
    camera = shot.camera
    if not camera.is_pinhole:
        return _lens_rays(shot.pose, picture_rays(columns_px, rows_px, camera))
    in_camera = np.empty((len(columns_px), 3), dtype=np.float32)
    in_camera[:, 0] = (columns_px - 0.5 * camera.width_px) / camera.focal_length_px
    in_camera[:, 1] = (rows_px - 0.5 * camera.height_px) / camera.focal_length_px
    in_camera[:, 2] = 1.0
    rotation = camera_rotation(shot.pose.yaw_deg, shot.pose.pitch_deg)
    return in_camera @ rotation.T.astype(np.float32)


def _lens_rays(pose: Pose, at_depth_1: FloatArray) -> FloatRays:
    """Rays (n, 3) of points (n, 2) at depth 1; zeros where a lens shows nothing."""
    in_camera = np.column_stack([at_depth_1, np.ones(len(at_depth_1))])
    in_camera[np.isnan(at_depth_1).any(axis=1)] = 0.0
    rotation = camera_rotation(pose.yaw_deg, pose.pitch_deg)
    return np.asarray((in_camera @ rotation.T).astype(np.float32))


def _find_hits(
    shot: Shot,
    ahead: FloatRays,
    distance: FloatRays,
    triangle: IntArray,
    *,
    is_round: bool,
) -> Hits:
    """Points and normals where rays have hit, and the size of pixels there.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    ahead : (n, 3) float32
        Unit vectors along the rays.
    distance : (n,) float32
        From the camera to the hits. [m]
    triangle : (n,) int
        Triangles that are hit.
    is_round : bool
        Normals are interpolated between corners.
    """
    mesh = shot.mesh
    local = ahead * distance[:, None]
    flat = mesh.normals[:, 0].take(triangle, axis=0)
    if is_round:
        normals = _interpolated_normals(mesh, triangle, local)
    else:
        normals = flat
    cosine = np.einsum("ij,ij->i", normals, ahead)
    normals[cosine > 0.0] *= -1.0
    pixel = distance * np.float32(1.0 / shot.camera.focal_length_px)
    pixel /= np.sqrt(np.maximum(np.abs(cosine), _GRAZING))
    return Hits(
        points_m=local + mesh.origin_m.astype(np.float32),
        normals=normals,
        thing=mesh.triangle_thing.take(triangle),
        pixel_m=pixel,
    )


def _interpolated_normals(
    mesh: FrameMesh, triangle: IntArray, points: FloatRays
) -> FloatRays:
    """Normals at points in triangles, between those of the corners, (n, 3).

    Barycentric shares weight the corners.
    """
    corners = mesh.corners_m.take(triangle, axis=0)
    normals = mesh.normals.take(triangle, axis=0)
    a, b, c = np.swapaxes(corners, 0, 1)
    whole = np.cross(b - a, c - a)
    area = np.maximum(np.einsum("ij,ij->i", whole, whole), np.float32(1e-20))
    offset = points - a
    share_b = np.einsum("ij,ij->i", np.cross(offset, c - a), whole) / area
    share_c = np.einsum("ij,ij->i", np.cross(b - a, offset), whole) / area
    shares = np.clip(
        np.stack([1.0 - share_b - share_c, share_b, share_c], axis=1), 0.0, 1.0
    )
    mean = np.einsum("ij,ijk->ik", shares, normals)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    return np.where(
        length > 1e-3, mean / np.maximum(length, np.float32(1e-3)), normals[:, 0]
    )


def _shade(
    shot: Shot, class_name: str, hits: Hits, ahead: FloatRays
) -> tuple[FloatRays, Surfaces]:
    """Luminance of surfaces of one class towards the camera.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    class_name : str
        Class of all things that are hit.
    hits : Hits
        n points on them.
    ahead : (n, 3) float32
        Unit vectors along the rays.

    Returns
    -------
    light : (n, 3) float32
        [cd/m^2]
    surfaces : Surfaces
        The surfaces there.
    """
    coat, sky_share = _coat(shot, class_name, hits)
    lux = illuminance(
        hits,
        caster=shot.mesh.caster,
        origin_m=shot.mesh.origin_m.astype(np.float32),
        sky=shot.sky,
        lamps=shot.lamps,
        sky_share=sky_share,
        ground_albedo=ground_albedo(),
    )
    light: FloatRays = lux * coat.albedo * np.float32(1.0 / np.pi) + coat.glow
    mirrored = _add_mirrored(shot, light, coat, hits, ahead)
    return light, Surfaces(coat.albedo, lux, hits.normals, mirrored)


def _coat(shot: Shot, class_name: str, hits: Hits) -> tuple[Coat, FloatRays | None]:
    """Coat of surfaces of one class, and the share of skylight there.

    Returns
    -------
    coat : Coat
    sky_share : (n,) float32 or None
        None where all of the skylight reaches them.
    """
    materials = shot.materials
    ground = shot.ground
    if class_name == "ground":
        return coat_ground(hits, ground, materials, wetness=shot.weather.wetness)
    if class_name == "building":
        return (
            coat_facade(hits, ground, materials, has_lamps=shot.weather.has_lamps),
            None,
        )
    if class_name == "wall":
        return coat_wall(hits, ground, materials), None
    if class_name in _BODY_COATS:
        return _BODY_COATS[class_name](hits, shot.things, materials), None
    return (
        coat_plain(hits, ground, materials.albedo[class_name.replace(" ", "-")]),
        None,
    )


_BODY_COATS = {
    "pedestrian": coat_pedestrian,
    "cyclist": coat_cyclist,
    "motorcyclist": coat_motorcyclist,
} | dict.fromkeys(("vehicle", "parked vehicle", "car"), coat_vehicle)


def _add_mirrored(
    shot: Shot, light: FloatRays, coat: Coat, hits: Hits, ahead: FloatRays
) -> FloatRays:
    """Add the light that glass, lacquer and water mirror, in place.

    They mirror the sky, or things without their own shadows.

    Returns
    -------
    mirrored : (n, 3) float32
        Rays that were cast; zeros where there is none.
    """
    mirrored = np.zeros_like(light)
    # Cosine of the angle of incidence, negative.
    cosine = np.einsum("ij,ij->i", hits.normals, ahead)
    away = 1.0 + cosine
    share = coat.mirror * (1.0 + _GRAZING_GAIN * away**5)
    mirrors = np.flatnonzero(share > _LEAST_MIRROR)
    if not len(mirrors):
        return mirrored
    normals = hits.normals[mirrors]
    ways = ahead[mirrors] - 2.0 * cosine[mirrors, None] * normals
    ways[:, 2] += coat.rough[mirrors]
    mirrored[mirrors] = ways
    starts = hits.points_m[mirrors] - shot.mesh.origin_m.astype(np.float32)
    starts += np.float32(_OFF_SURFACE_M) * normals
    distance, triangle = shot.mesh.caster.first_triangle(starts, ways)
    seen = shot.sky.luminance(ways[:, 2])
    things = np.flatnonzero(triangle >= 0)
    met = triangle[things]
    facing = shot.mesh.normals[met, 0]
    upness = facing[:, 2:]
    sun = np.maximum(facing @ shot.sky.to_sun.astype(np.float32), 0.0)[:, None]
    sky_lux = shot.sky.sky_lux.astype(np.float32)
    from_above = (0.5 + 0.5 * upness) * sky_lux
    from_below = ground_albedo() * (0.5 - 0.5 * upness) * sky_lux
    lux = from_above + from_below
    lux += sun * shot.sky.sun_lux.astype(np.float32)
    mean_albedo = shot.things.mean_albedo[shot.mesh.triangle_thing[met]]
    lux *= mean_albedo * np.float32(1.0 / np.pi)
    shot.sky.fade(lux, distance[things])
    seen[things] = lux
    light[mirrors] += np.minimum(share[mirrors], 0.9)[:, None] * seen
    return mirrored


@cache
def ground_albedo() -> float:
    """Share of the light that comes back from below."""
    return take_number(load_lamp_table()["sky"], "ground_albedo", "lamps.toml: sky")


# ---------- whole pictures
# Pixels that are smoothed at once.
_EDGES = 12_000
# Rows, columns drawn at a time: fit into a cache, and are near few lamps.
_TILE_PX = (
    90,
    480,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedPicture:
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
        The scene's instances, "parked-1" .. for what parks in the run, "vut" if it is
        drawn, "vru".
    """

    rgb: NDArray[np.uint8]
    instance: NDArray[np.int32]
    depth_m: FloatRays
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Backdrop:
    """Standing things of all frames of a run, ready to be drawn many times.

    Attributes
    ----------
    mesh : Mesh
        Scene and obstruction.
    ground : GroundMap
        The road plane.
    street_lamps : tuple of StreetLamp
        All of the scene.
    keeps_left : bool
        Traffic keeps left.
    """

    mesh: Mesh
    ground: GroundMap
    street_lamps: tuple[StreetLamp, ...]
    keeps_left: bool


def build_backdrop(scene: Scene, obstruction: Sequence[PlacedActor]) -> Backdrop:
    """Prepare a scene, with what parks in a run, for pictures.

    The result serves all runs with this obstruction.
    """
    mesh = build_static_mesh(scene, obstruction)
    parked = mesh.things[len(scene.instances) :]
    return Backdrop(
        mesh=mesh,
        ground=build_ground_map(scene, parked, load_materials().markings),
        street_lamps=build_street_lamps(scene),
        keeps_left=scene.keeps_left,
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
    is_smooth: bool = True,
    materials: Materials | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> RenderedPicture:
    """Render one frame of a run, at the camera's resolution.

    Parameters
    ----------
    backdrop : Backdrop
        Scene and obstruction of the run.
    run, frame_index : Run, int
        The frame.
    pose : Pose
        Of the camera.
    camera : CameraModel
        Its lens and image.
    weather : Weather
        Light and air.
    with_vut : bool
        The VUT is seen; its own camera does not see it. Its headlights shine in any
        case.
    is_smooth : bool
        Several rays are cast for pixels at edges; without, one ray for each pixel, in
        about half the time.
    materials : Materials, optional
        By default those of ``data/materials.toml``.
    compute : Compute
        Threads, and the seed of sensor noise and drops.
    """
    mesh = build_frame_mesh(
        backdrop.mesh, run, frame_index, pose.position_m, with_vut=with_vut
    )
    shot = build_shot(
        backdrop,
        mesh,
        pose,
        camera,
        weather,
        run=run,
        frame_index=frame_index,
        materials=materials,
    )
    with start_pool(compute) as pool:
        image = shade_image(shot, whole_image(camera), pool)
        if is_smooth:
            edges = np.flatnonzero(exposure.find_edges(image.radiance))
            smooth_image(shot, whole_image(camera), image.radiance, edges, pool.map)
        rgb = expose_image(shot, image.radiance, [compute.seed, frame_index], pool)
    return RenderedPicture(
        rgb=rgb, instance=image.instance, depth_m=image.depth_m, names=names_of(mesh)
    )


def names_of(mesh: FrameMesh) -> tuple[str, ...]:
    """Names of a mesh's things, in their order."""
    return tuple(thing.name for thing in mesh.things)


def build_shot(
    backdrop: Backdrop,
    mesh: FrameMesh,
    pose: Pose,
    camera: CameraModel,
    weather: Weather,
    *,
    run: Run | None = None,
    frame_index: int = 0,
    materials: Materials | None = None,
) -> Shot:
    """Gather the inputs of a picture of a mesh.

    Parameters
    ----------
    backdrop : Backdrop
        Ground and street lamps.
    mesh : FrameMesh
        Its origin is at the camera.
    pose, camera : Pose, CameraModel
        The camera.
    weather : Weather
        Light and air.
    run, frame_index : Run, int, optional
        The frame whose VUT has its headlights on; by default there are none.
    materials : Materials, optional
        By default those of ``data/materials.toml``.
    """
    lamps: tuple[Lamp, ...] = ()
    if weather.has_lamps:
        lamps = backdrop.street_lamps
        if run is not None:
            pose_vut = vut_pose(run, frame_index)
            lamps += build_headlights(
                run.encounter.vut, pose_vut, keeps_left=backdrop.keeps_left
            )
    materials = materials or load_materials()
    return Shot(
        pose=pose,
        camera=camera,
        mesh=mesh,
        things=build_things(mesh.things, materials),
        materials=materials,
        ground=backdrop.ground,
        sky=build_sky(weather),
        lamps=lamps,
        weather=weather,
    )


@contextmanager
def start_pool(compute: Compute) -> Iterator[ThreadPoolExecutor]:
    """Threads for the parts of a picture, one BLAS thread each.

    The matrices are small.
    """
    with one_blas_thread(), ThreadPoolExecutor(compute.workers) as pool:
        yield pool


def shade_image(
    shot: Shot,
    window: Window,
    pool: ThreadPoolExecutor,
    surfaces: Surfaces | None = None,
) -> Shades:
    """Shades through the middles of a window's pixels, before lens and noise.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    window : Window
        The part of the image, h x w.
    pool : ThreadPoolExecutor
        Draws tiles side by side.
    surfaces : Surfaces, optional
        (h, w, 3) each; written.

    Returns
    -------
    image : Shades
        (h, w)
    """
    size = (window.height, window.width)
    image = Shades(
        np.empty((*size, 3), dtype=np.float32),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.float32),
    )

    def shade(tile: tuple[slice, slice]) -> None:
        down, across = tile
        rows = slice(down.start + window.top, down.stop + window.top)
        columns = slice(across.start + window.left, across.stop + window.left)
        shades, met = shade_rays(shot, tile_rays(shot.pose, shot.camera, rows, columns))
        wholes: tuple[NDArray[Any], ...] = image
        parts: tuple[NDArray[Any], ...] = shades
        if surfaces is not None:
            wholes = (*image, *surfaces)
            parts = (*shades, *met)
        for whole, part in zip(wholes, parts, strict=True):
            whole[tile] = part.reshape(whole[tile].shape)

    list(pool.map(shade, _tiles(size)))
    return image


def smooth_image(
    shot: Shot, window: Window, radiance: FloatRays, pixels: IntArray, each: Each
) -> None:
    """Replace pixels of a window by means over several rays, in place.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    window : Window
        The part of the image, h x w.
    radiance : (h, w, 3) float32
        What the rays through the middles of all pixels saw; written. [cd/m^2]
    pixels : (n,) int
        Row * w + column in the window.
    each : callable
        ``map``, or that of a pool.
    """
    flat = radiance.reshape(-1, 3)

    def smooth(part: IntArray) -> None:
        flat[part] = smooth_pixels(shot, window.in_whole(part, shot.camera), flat[part])

    if len(pixels):
        list(each(smooth, np.array_split(pixels, 1 + len(pixels) // _EDGES)))


def add_glare_and_rain(
    shot: Shot,
    radiance: FloatRays,
    rng: np.random.Generator,
    *,
    corner_px: tuple[int, int] = (0, 0),
) -> None:
    """Add glare and rain to an image, in place.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    radiance : (h, w, 3) float32
        The image, or a part of it; written. [cd/m^2]
    rng : Generator
        Of the drops.
    corner_px : (int, int)
        Column and row at which the part begins.
    """
    camera = shot.camera
    pose = shot.pose
    exposure.add_glare(
        radiance, pose, camera, shot.lamps, shot.mesh.caster, corner_px=corner_px
    )
    exposure.add_rain(
        radiance,
        shot.weather,
        shot.sky,
        focal_px=camera.focal_length_px,
        pitch_deg=pose.pitch_deg,
        exposure_s=exposure.load_imager()["rain_exposure_s"],
        rng=rng,
    )


def expose_image(
    shot: Shot, radiance: FloatRays, seed: list[int], pool: ThreadPoolExecutor
) -> NDArray[np.uint8]:
    """Colours of an image: glare, rain, exposure and noise.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    radiance : (h, w, 3) float32
        Of the whole image; written over. [cd/m^2]
    seed : list of int
        Of drops and noise.
    pool : ThreadPoolExecutor
        Exposes tiles side by side.

    Returns
    -------
    rgb : (h, w, 3) uint8
    """
    size = radiance.shape[:2]
    imager = exposure.load_imager()
    add_glare_and_rain(shot, radiance, np.random.default_rng([*seed, *size]))
    metered = radiance
    # What the lens leaves dark does not count.
    if not shot.camera.is_pinhole:
        metered = radiance[None, np.isfinite(pixel_grid(shot.camera)[..., 0])]
    white_cdpm2 = exposure.white_luminance(metered, imager)
    rgb = np.empty((*size, 3), dtype=np.uint8)

    def expose(tile: tuple[slice, slice]) -> None:
        rng = np.random.default_rng([*seed, tile[0].start, tile[1].start])
        rgb[tile] = exposure.develop(radiance[tile], white_cdpm2, imager, rng)

    list(pool.map(expose, _tiles(size)))
    return rgb


def _tiles(size: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Rows and columns of the tiles of an image (h, w)."""
    height, width = size
    return [
        (
            slice(row, min(row + _TILE_PX[0], height)),
            slice(column, min(column + _TILE_PX[1], width)),
        )
        for row in range(0, height, _TILE_PX[0])
        for column in range(0, width, _TILE_PX[1])
    ]


# ---------- smooth edges: several rays for pixels along kerbs, roofs and shadows
# Four points of a square, turned so that no two share a row or a column.
_OFFSETS_PX = ((0.125, 0.375), (-0.375, 0.125), (0.375, -0.125), (-0.125, -0.375))


def smooth_pixels(shot: Shot, pixels: IntArray, radiance: FloatRays) -> FloatRays:
    """Luminance of pixels as the mean over five rays.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    pixels : (n,) int
        Row * w + column in the whole image.
    radiance : (n, 3) float32
        What the rays through their middles saw. [cd/m^2]

    Returns
    -------
    radiance : (n, 3) float32
        Mean over these rays and four more of each pixel. [cd/m^2]
    """
    rows, columns = np.divmod(pixels, shot.camera.width_px)
    ways = [
        pixel_rays(
            shot,
            (columns + (0.5 + across)).astype(np.float32),
            (rows + (0.5 + down)).astype(np.float32),
        )
        for across, down in _OFFSETS_PX
    ]
    more = shade_rays(shot, np.concatenate(ways))[0].radiance
    return np.asarray(
        (radiance + more.reshape(len(ways), -1, 3).sum(axis=0)) / (1.0 + len(ways))
    )
