"""Many pictures by one fixed camera, and parts of them.

What stands still is drawn once. In each frame only those pixels are drawn anew that
moving things can change: they are seen there, throw a shadow there, are mirrored there,
or their headlights shine there. Boxes around the bodies find these pixels, and hold
more than the bodies do; the picture is the one that
:func:`placement.imaging.draw_picture` draws. A crop is a part of it around what
matters, to train networks with and to show to them, but for its sensor noise, its
raindrops, and an exposure that is set by fewer pixels of the whole image.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import LidarModel
from geometry.poses import Pose
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel
from geometry.weather import Weather
from scenarios.runs import Run

from ..compute import DEFAULT_COMPUTE, Compute
from .exposure import develop, find_edges, load_imager, white_luminance
from .light import HeadLamp, add_headlights
from .materials import Hits, Materials
from .mesh import (
    FrameMesh,
    Mesh,
    PointCloud,
    add_moving_meshes,
    build_moving_meshes,
    move_origin,
    place_mesh,
    scan_mesh,
)
from .picture import (
    Backdrop,
    Each,
    RenderedPicture,
    Shades,
    Shot,
    Surfaces,
    Window,
    add_glare_and_rain,
    blank_surfaces,
    build_shot,
    expose_image,
    ground_albedo,
    names_of,
    pixel_rays,
    shade_image,
    shade_rays,
    smooth_image,
    start_pool,
    tile_rays,
    whole_image,
)

# Added to boxes: more than a pixel's smoothing reaches at 150 m.
_MARGIN_M = 0.15
# Pixels drawn at a time: fit into a cache.
_CHUNK = 40_000
# Sides of the blocks of pixels that are tried as a whole.
_BLOCK_PX = 12
# Distance at which the sun is put: its rays are as good as parallel.
_SUN_M = 1.0e6
_FAR_M = 1.0e9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Still:
    """Image of what stands still, in one weather; drawn by :func:`draw_still`.

    Attributes
    ----------
    backdrop : Backdrop
        Scene and obstruction.
    shot : Shot
        What the image is made from.
    rays : (h * w, 3) float32
        Through the middles of the pixels, one metre deep.
    raw : Shades
        What they see, (h, w).
    surfaces : Surfaces or None
        (h, w, 3), where headlights may shine.
    is_edge : (h, w) bool
        Pixels that are smoothed.
    smooth : (h, w, 3) float32
        Radiance with smooth edges. [cd/m^2]
    mirrors : (n,) int
        Pixels with a mirrored ray, row * w + column, ascending.
    mirror_m : (n, 3) float32
        Where the mirrored ray begins, from the camera. [m]
    mirrored : (n, 3) float32
        Where it goes.
    ways : _Spheres
        Around the rays of blocks of pixels, one metre deep.
    things : _Spheres
        Around what they see, but for the sky.
    """

    backdrop: Backdrop
    shot: Shot
    rays: FloatRays
    raw: Shades
    surfaces: Surfaces | None
    is_edge: BoolArray
    smooth: FloatRays
    mirrors: IntArray
    mirror_m: FloatRays
    mirrored: FloatRays
    ways: "_Spheres"
    things: "_Spheres"


def draw_still(
    backdrop: Backdrop,
    pose: Pose,
    camera: CameraModel,
    *,
    weather: Weather,
    materials: Materials | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Still:
    """Draw what stands still, for many frames by :func:`draw_onto`.

    Parameters
    ----------
    backdrop : Backdrop
        Scene and obstruction.
    pose, camera : Pose, CameraModel
        The fixed camera.
    weather : Weather
        Light and air.
    materials : Materials, optional
        By default those of ``data/materials.toml``.
    compute : Compute
        Threads.
    """
    window = whole_image(camera)
    mesh = place_mesh(backdrop.mesh, pose.position_m)
    shot = build_shot(backdrop, mesh, pose, camera, weather, materials=materials)
    with start_pool(compute) as pool:
        surfaces = blank_surfaces(window.height, window.width)
        raw = shade_image(shot, window, pool, surfaces)
        is_edge = find_edges(raw.radiance)
        smooth = raw.radiance.copy()
        smooth_image(shot, window, smooth, np.flatnonzero(is_edge), pool.map)
    # Headlights shine only where lamps are on.
    lit_surfaces = None
    if weather.has_lamps:
        lit_surfaces = surfaces
    mirrored = surfaces.mirrored.reshape(-1, 3)
    mirrors = np.flatnonzero(mirrored.any(axis=1))
    rays = tile_rays(pose, camera, window.rows, window.columns)
    mirrored = mirrored[mirrors]
    depth_m = np.where(np.isinf(raw.depth_m), np.float32(0.0), raw.depth_m).reshape(
        -1, 1
    )
    return Still(
        backdrop=backdrop,
        shot=shot,
        rays=rays,
        raw=raw,
        surfaces=lit_surfaces,
        is_edge=is_edge,
        smooth=smooth,
        mirrors=mirrors,
        mirror_m=rays[mirrors] * depth_m[mirrors],
        mirrored=mirrored,
        ways=_bound(rays.reshape(raw.radiance.shape), np.ones_like(is_edge)),
        things=_bound(
            (rays * depth_m).reshape(raw.radiance.shape), np.isfinite(raw.depth_m)
        ),
    )


def scan_onto(
    still: Still, run: Run, frame_index: int, lidar: LidarModel, *, seed: int
) -> PointCloud:
    """Scan a frame of a run by a LiDAR at the place of a still's camera."""
    moving = build_moving_meshes(run, frame_index, with_vut=True)
    mesh = add_moving_meshes(still.shot.mesh, moving)
    shot = still.shot
    return scan_mesh(
        mesh, run, shot.pose, lidar, weather=shot.weather, seed=[seed, frame_index]
    )


def draw_onto(
    still: Still, run: Run, frame_index: int, *, compute: Compute = DEFAULT_COMPUTE
) -> RenderedPicture:
    """Draw what moves in a frame of a run onto a still.

    Where headlights shine on an edge of what stands still, their light is that on the
    pixel's middle; all else is as in :func:`placement.imaging.draw_picture`.

    Parameters
    ----------
    still : Still
        Its obstruction must be the run's.
    run, frame_index : Run, int
        The frame.
    compute : Compute
        Threads, and the seed of sensor noise and drops.
    """
    with start_pool(compute) as pool:
        shot, image, smooth = _add_moving(still, run, frame_index, pool.map)
        rgb = expose_image(shot, smooth, [compute.seed, frame_index], pool)
    return RenderedPicture(
        rgb=rgb,
        instance=image.instance,
        depth_m=image.depth_m,
        names=names_of(shot.mesh),
    )


def _add_moving(
    still: Still, run: Run, frame_index: int, each: Each
) -> tuple[Shot, Shades, FloatRays]:
    """Image of a frame before lens and noise, with what moves.

    Parameters
    ----------
    still : Still
        What stands still.
    run, frame_index : Run, int
        The frame.
    each : callable
        ``map``, or that of a pool.

    Returns
    -------
    shot : Shot
        Of the frame.
    image : Shades
        Through the middles of the pixels, (h, w).
    smooth : (h, w, 3) float32
        Radiance with smooth edges. [cd/m^2]
    """
    base = still.shot
    window = whole_image(still.shot.camera)
    moving = build_moving_meshes(run, frame_index, with_vut=True)
    shot = build_shot(
        still.backdrop,
        add_moving_meshes(base.mesh, moving),
        base.pose,
        base.camera,
        base.weather,
        run=run,
        frame_index=frame_index,
        materials=base.materials,
    )
    rays = still.rays
    raw = still.raw
    image = Shades(raw.radiance.copy(), raw.instance.copy(), raw.depth_m.copy())
    radiance = image.radiance.reshape(-1, 3)
    smooth = still.smooth.copy()

    def shade(part: IntArray) -> None:
        shades, _ = shade_rays(shot, rays[part])
        for whole, values in zip(image, shades, strict=True):
            whole.reshape(-1, *whole.shape[2:])[part] = values

    def shine(part: IntArray) -> None:
        local = rays[part] * raw.depth_m.reshape(-1, 1)[part]
        lit.reshape(-1)[part] = _find_lit(shot, local, 0.0)
        more = _headlight_radiance(still, shot, part, local)
        radiance[part] += more
        smooth.reshape(-1, 3)[part] += more

    changed = _find_changed(still, shot, moving, each)
    _in_parts(each, shade, np.flatnonzero(changed))
    lit = np.zeros(changed.shape, dtype=np.bool_)
    may_be_lit = _of_blocks(_find_lit(shot, *still.things), changed)
    _in_parts(
        each, shine, np.flatnonzero(may_be_lit & ~changed & np.isfinite(raw.depth_m))
    )
    around = _grown(changed)
    smooth[around] = image.radiance[around]
    # Pixels that the still says nothing about.
    unlike = around | (lit & ~still.is_edge)
    edges = np.flatnonzero(unlike & find_edges(image.radiance))
    smooth_image(shot, window, smooth, edges, each)
    return shot, image, smooth


def _in_parts(each: Each, work: Callable[[IntArray], None], pixels: IntArray) -> None:
    """Do some work on pixels (n,), part by part."""
    if len(pixels):
        list(each(work, np.array_split(pixels, 1 + len(pixels) // _CHUNK)))


def _headlight_radiance(
    still: Still, shot: Shot, pixels: IntArray, local: FloatRays
) -> FloatRays:
    """Radiance that headlights add to pixels of a still.

    Parameters
    ----------
    still : Still
        Its surfaces count.
    shot : Shot
        Of the frame, with the headlights.
    pixels : (n,) int
        Row * w + column.
    local : (n, 3) float32
        What the pixels show, from the camera. [m]

    Returns
    -------
    radiance : (n, 3) float32
        [cd/m^2]
    """
    assert still.surfaces is not None
    surfaces = Surfaces(*(array.reshape(-1, 3)[pixels] for array in still.surfaces))
    origin = shot.mesh.origin_m.astype(np.float32)
    distance = np.sqrt(np.einsum("ij,ij->i", local, local))
    lux = surfaces.lux.copy()
    of_light = Hits(
        points_m=local + origin,
        normals=surfaces.normals,
        thing=np.zeros(len(local), dtype=np.int32),
        pixel_m=distance,
    )
    add_headlights(
        lux,
        of_light,
        [lamp for lamp in shot.lamps if isinstance(lamp, HeadLamp)],
        caster=shot.mesh.caster,
        origin_m=origin,
        ground_albedo=ground_albedo(),
    )
    lux -= surfaces.lux
    lux *= surfaces.albedo
    lux *= (
        np.exp(np.float32(-shot.sky.extinction_per_m) * distance) / np.float32(np.pi)
    )[:, None]
    return lux


def _grown(mask: BoolArray) -> BoolArray:
    """A mask (h, w), widened by one pixel to all four sides."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown


# ---------- pixels that what moves may change
class _Box(NamedTuple):
    """The box around a body; it holds more than the body does.

    Attributes
    ----------
    middle_m : (3,) float32
        From the camera, in the axes of the world. [m]
    turn : (3, 3) float32
        Columns ahead, left, up.
    half_m : (3,) float32
        Half its length, width and height. [m]
    radius_m : () float32
        Of the sphere around the box. [m]
    """

    middle_m: FloatRays
    turn: FloatRays
    half_m: FloatRays
    radius_m: FloatRays


class _Spheres(NamedTuple):
    """Spheres around points that belong to the pixels of blocks, row by row.

    Attributes
    ----------
    middle_m : (n, 3) float32
        From the camera. [m]
    radius_m : (n,) float32
        [m]
    """

    middle_m: FloatRays
    radius_m: FloatRays


def _bound(points_m: FloatRays, is_there: BoolArray) -> _Spheres:
    """Spheres around the points of each block of pixels.

    Parameters
    ----------
    points_m : (h, w, 3) float32
        From the camera. [m]
    is_there : (h, w) bool
        Points that count. Where none does, the sphere is far away.
    """
    rows, columns = (np.arange(0, side, _BLOCK_PX) for side in is_there.shape)
    low, high = (
        bound.reduceat(bound.reduceat(values, rows, axis=0), columns, axis=1).reshape(
            -1, 3
        )
        for bound, none in ((np.minimum, _FAR_M), (np.maximum, -_FAR_M))
        for values in [np.where(is_there[..., None], points_m, np.float32(none))]
    )
    half: FloatRays = np.float32(0.5) * np.maximum(high - low, np.float32(0.0))
    return _Spheres(low + half, np.sqrt(_dot(half, half)) + np.float32(1e-3))


def _box(mesh: Mesh, origin_m: FloatArray) -> _Box:
    """The box around a body, a little larger than it.

    Parameters
    ----------
    mesh : Mesh
        Of the body alone.
    origin_m : (3,) float
        The camera, world frame. [m]
    """
    yaw = math.radians(mesh.things[0].pose.yaw_deg)
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    local = (mesh.vertices_m - origin_m) @ turn
    low = local.min(axis=0) - _MARGIN_M
    high = local.max(axis=0) + _MARGIN_M
    middle = turn @ (0.5 * (low + high))
    half = 0.5 * (high - low)
    radius = np.array(np.linalg.norm(half))
    return _Box(*(one.astype(np.float32) for one in (middle, turn, half, radius)))


def _dot(one: FloatRays, other: FloatRays) -> FloatRays:
    """Scalar products (...,) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", one, other))


def _may_meet(
    box: _Box, points_m: FloatRays, ways: FloatRays, radius_m: FloatRays | float
) -> BoolArray:
    """Mask of rays that may meet the sphere around a box.

    Parameters
    ----------
    box : _Box
        The box.
    points_m : (..., 3) float32
        Rays begin within `radius_m` of these points. [m]
    ways : (..., 3) float32
        Along the rays. All rays of a point are parallel, or all end where point + way
        is: then they come nearer to one another.
    radius_m : (...,) float32 or float
        [m]

    Returns
    -------
    may_meet : (...,) bool
    """
    to_box = box.middle_m - points_m
    along = _dot(to_box, ways)
    away = _dot(to_box, to_box) - (box.radius_m + radius_m) ** 2
    return (away <= 0.0) | ((along >= 0.0) & (away * _dot(ways, ways) <= along * along))


def _meets(
    box: _Box, points_m: FloatRays, ways: FloatRays, most: FloatRays | float
) -> BoolArray:
    """Mask of rays that meet a box.

    Parameters
    ----------
    box : _Box
        The box.
    points_m : (3,) or (n, 3) float32
        Where the rays begin. [m]
    ways : (n, 3) float32
        Along the rays. [m]
    most : (n,) float32 or float
        Only hits before this many times the way count.

    Returns
    -------
    meets : (n,) bool
    """
    found = _may_meet(box, points_m, ways, 0.0)
    some = np.flatnonzero(found)
    to_box = (box.middle_m - np.broadcast_to(points_m, ways.shape)[some]) @ box.turn
    turned = ways[some] @ box.turn
    # A ray along a face divides by zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (to_box - box.half_m) / turned
        other = (to_box + box.half_m) / turned
    near = np.minimum(one, other).max(axis=1)
    far = np.maximum(one, other).min(axis=1)
    far = np.minimum(far, np.broadcast_to(most, found.shape)[some])
    found[some] = np.maximum(near, 0.0) <= far
    return found


def _lights(shot: Shot) -> list[tuple[FloatRays, float]]:
    """Places of standing lamps and of the sun, and how far their light goes.

    Returns
    -------
    lights : list of ((3,) float32, float)
        Place, from the camera, and reach. [m]
    """
    lamps = [lamp for lamp in shot.lamps if not isinstance(lamp, HeadLamp)]
    lights = [(lamp.position_m - shot.mesh.origin_m, lamp.reach_m) for lamp in lamps]
    if shot.sky.sun_lux.any() and shot.sky.to_sun[2] > 0.0:
        lights.append((_SUN_M * shot.sky.to_sun, np.inf))
    return [(place.astype(np.float32), reach_m) for place, reach_m in lights]


def _find_changed(
    still: Still, shot: Shot, moving: Sequence[Mesh], each: Each
) -> BoolArray:
    """Mask of pixels that moving things may change.

    That is where a box around one is seen, throws a shadow, or is mirrored; the
    light of headlights is left out. Blocks of pixels are tried as a whole first:
    moving things change few of them.

    Parameters
    ----------
    still : Still
        What stands still.
    shot : Shot
        Of the frame.
    moving : sequence of Mesh
        What moves.
    each : callable
        ``map``, or that of a pool.

    Returns
    -------
    changed : (h, w) bool
    """
    boxes = [_box(mesh, shot.mesh.origin_m) for mesh in moving]
    (middle, radius) = still.things
    far_m = max(1.0, *(float(np.linalg.norm(b.middle_m) + b.radius_m) for b in boxes))
    # Points on the rays beyond all boxes.
    ahead, spread = (np.float32(1.01 * far_m) * one for one in still.ways)
    may_show = np.array([_may_meet(box, ahead, -ahead, spread) for box in boxes])
    # Lights, and the blocks of pixels that each box may shade from them.
    shades = []
    for place, reach_m in _lights(shot):
        ways = place - middle
        may_shade = np.zeros(may_show.shape, dtype=np.bool_)
        near = np.flatnonzero(_dot(ways, ways) <= (reach_m + radius) ** 2)
        for box, mask in zip(boxes, may_shade, strict=True):
            mask[near] = _may_meet(box, middle[near], ways[near], radius[near])
        if may_shade.any():
            shades.append((place, reach_m, may_shade))
    depth_m = still.raw.depth_m
    changed = np.zeros(depth_m.shape, dtype=np.bool_)
    flat = changed.reshape(-1)
    width = depth_m.shape[1]

    def mark(part: IntArray) -> None:
        rows, columns = np.divmod(part, width)
        block = rows // _BLOCK_PX * -(-width // _BLOCK_PX) + columns // _BLOCK_PX
        depth: FloatRays = depth_m.take(part)
        found = np.zeros(len(part), dtype=np.bool_)
        ways = still.rays[part]
        for box, possible in zip(boxes, may_show, strict=True):
            some = np.flatnonzero(possible[block])
            found[some] |= _meets(box, np.zeros(3, np.float32), ways[some], depth[some])
        # Nothing is shaded in the sky.
        left = np.flatnonzero(~found & np.isfinite(depth))
        at = ways[left] * depth[left, None]
        block = block[left]
        for place, reach_m, may_shade in shades:
            for box, possible in zip(boxes, may_shade, strict=True):
                some = np.flatnonzero(possible[block])
                to_light = place - at[some]
                is_lit = _dot(to_light, to_light) <= reach_m**2
                found[left[some]] |= is_lit & _meets(box, at[some], to_light, 1.0)
        flat[part] = found

    possible = np.any([may_show, *(one for _, _, one in shades)], axis=(0, 1))
    _in_parts(each, mark, np.flatnonzero(_of_blocks(possible, changed)))
    for first in range(0, len(still.mirrors), _CHUNK):
        part = slice(first, first + _CHUNK)
        for box in boxes:
            hit = _meets(box, still.mirror_m[part], still.mirrored[part], np.inf)
            flat[still.mirrors[part][hit]] = True
    return changed


def _of_blocks(mask: BoolArray, like: BoolArray) -> BoolArray:
    """Pixels (h, w) of the blocks in a mask (n,), of an image like another."""
    height, width = like.shape
    whole = mask.reshape(-1, -(-width // _BLOCK_PX)).repeat(_BLOCK_PX, axis=0)
    return whole.repeat(_BLOCK_PX, axis=1)[:height, :width]


def _find_lit(
    shot: Shot, points_m: FloatRays, radius_m: FloatRays | float
) -> BoolArray:
    """Mask of points on which a headlight may shine.

    Parameters
    ----------
    shot : Shot
        Its headlights count.
    points_m : (..., 3) float32
        From the camera. [m]
    radius_m : (...,) float32 or float
        Light within this distance of a point counts. [m]

    Returns
    -------
    lit : (...,) bool
    """
    lit = np.zeros(points_m.shape[:-1], dtype=np.bool_)
    for lamp in shot.lamps:
        if isinstance(lamp, HeadLamp):
            ways = points_m - (lamp.position_m - shot.mesh.origin_m).astype(np.float32)
            is_ahead = ways @ lamp.R_world_lamp[:, 0].astype(np.float32) > -radius_m
            lit |= is_ahead & (_dot(ways, ways) < (lamp.reach_m + radius_m) ** 2)
    return lit


# ---------- crops
# Columns and rows of the whole image that set the exposure.
_METERED_PX = (48, 27)


def window_around(box_px: FloatArray, camera: CameraModel, *, side_px: int) -> Window:
    """The square with a box in its middle, as far as it lies in the image.

    Where the image ends the square is moved inwards, so that it keeps its side.

    Parameters
    ----------
    box_px : (4,) float
        [px]
    camera : CameraModel
        Its whole image.
    side_px : int
        Side of the square. [px]
    """
    width = min(side_px, camera.width_px)
    height = min(side_px, camera.height_px)
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
) -> RenderedPicture:
    """Render a part of one frame of a run.

    Parameters
    ----------
    backdrop : Backdrop
        The scene, with what parks in the run.
    still : FrameMesh
        Its triangles, ready for rays: ``place_mesh(backdrop.mesh, np.zeros(3))``.
    run, frame_index : Run, int
        What moves.
    pose : Pose
        The camera's.
    camera : CameraModel
        Its lens and the size of its whole image.
    window : Window
        What is drawn of the image.
    weather : Weather
        Light, air and drops.
    with_vut : bool
        Whether the VUT is seen; its headlights shine in any case.
    materials : Materials, optional
        Colours; by default those of ``data/materials.toml``.
    white_cd_m2 : float, optional
        Luminance that is white; by default what :func:`meter` says of the frame.
    seed : int
        Of noise and drops.

    Returns
    -------
    picture : RenderedPicture
        Of the window's size.
    """
    still = move_origin(still, pose.position_m)
    mesh = add_moving_meshes(
        still, build_moving_meshes(run, frame_index, with_vut=with_vut)
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
    size = (window.height, window.width)
    shades, _ = shade_rays(shot, tile_rays(pose, camera, window.rows, window.columns))
    image = Shades._make(part.reshape(*size, *part.shape[1:]) for part in shades)
    edges = np.flatnonzero(find_edges(image.radiance))
    smooth_image(shot, window, image.radiance, edges, map)
    return _expose(shot, image, window, white_cd_m2, [seed, frame_index])


def _expose(
    shot: Shot,
    image: Shades,
    window: Window,
    white_cd_m2: float | None,
    seeds: list[int],
) -> RenderedPicture:
    """A picture of a window: glare, rain, exposure and noise.

    Parameters
    ----------
    shot : Shot
        What the picture is made from.
    image : Shades
        (h, w); its radiance is written over.
    window : Window
        Where it lies in the whole image.
    white_cd_m2 : float or None
        Luminance that is white; None measures it. [cd/m^2]
    seeds : list of int
        Of drops and noise.
    """
    rng = np.random.default_rng([*seeds, *window])
    radiance = image.radiance
    add_glare_and_rain(shot, radiance, rng, corner_px=(window.left, window.top))
    if white_cd_m2 is None:
        white = _meter(shot)
    else:
        white = white_cd_m2
    return RenderedPicture(
        rgb=develop(radiance, white, load_imager(), rng),
        instance=image.instance,
        depth_m=image.depth_m,
        names=names_of(shot.mesh),
    )


def silhouette(
    run: Run, frame_index: int, pose: Pose, camera: CameraModel, window: Window
) -> BoolArray:
    """Mask of a window's pixels that the VRU would cover without occluders.

    Returns
    -------
    covered : (h, w) bool
    """
    vru = place_mesh(
        build_moving_meshes(run, frame_index, with_vut=False)[-1], pose.position_m
    )
    ways = tile_rays(pose, camera, window.rows, window.columns)
    _, triangle = vru.caster.first_triangle(np.zeros_like(ways), ways)
    return (triangle >= 0).reshape(window.height, window.width)


def meter(
    backdrop: Backdrop,
    still: FrameMesh,
    pose: Pose,
    camera: CameraModel,
    weather: Weather,
) -> float:
    """Luminance that is white in a picture of what stands still, in cd/m^2."""
    mesh = move_origin(still, pose.position_m)
    return _meter(build_shot(backdrop, mesh, pose, camera, weather))


def _meter(shot: Shot) -> float:
    """Luminance that is white, from a coarse grid over the whole image.

    In cd/m^2.
    """
    camera = shot.camera
    (n_columns, n_rows) = _METERED_PX
    across = (np.arange(n_columns, dtype=np.float32) + 0.5) * (
        camera.width_px / n_columns
    )
    down = (np.arange(n_rows, dtype=np.float32) + 0.5) * (camera.height_px / n_rows)
    grid = (
        np.stack(np.meshgrid(across, down), axis=-1).astype(np.float32).reshape(-1, 2)
    )
    ways = pixel_rays(shot, grid[:, 0], grid[:, 1])
    seen: FloatRays = shade_rays(shot, ways)[0].radiance
    # What a lens leaves dark does not count.
    seen = seen[ways.any(axis=1)]
    if len(seen) != len(ways):
        n_rows = 1
    return white_luminance(seen.reshape(n_rows, -1, 3), load_imager(), every=1)
