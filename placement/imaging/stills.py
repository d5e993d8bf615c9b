"""Many pictures by one fixed camera, and parts of them: what stands still is drawn once.

In each frame only those pixels are drawn anew that what moves can change: it is seen there, throws
a shadow there, is mirrored there, or its headlights shine there. What can be changed is found by
boxes around the bodies, which hold more than the bodies do; the picture is the one that
:func:`placement.imaging.draw_picture` draws. A crop is a part of it around what matters, to train
networks with and to show to them, but for its sensor noise, its raindrops, and an exposure that is
set by fewer pixels of the whole image.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel
from geometry.lidar import LidarModel
from geometry.poses import Pose, camera_rotation
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel, pixel_grid
from geometry.weather import Weather
from scenarios.runs import Run

from ..compute import DEFAULT_COMPUTE, Compute
from .exposure import add_glare, add_rain, develop, find_edges, load_imager, white_luminance
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
    Picture,
    Shades,
    Shot,
    Surfaces,
    Window,
    blank_surfaces,
    build_shot,
    expose_image,
    ground_albedo,
    lens_rays,
    names_of,
    pixel_rays,
    ray_parts,
    shade_image,
    shade_rays,
    smooth_image,
    start_pool,
    tile_rays,
    whole_image,
)

_MARGIN_M = 0.15  # added to boxes: more than a pixel's smoothing reaches at 150 m
_CHUNK = 40_000  # pixels drawn at a time: fit into a cache
_BLOCK_PX = 12  # sides of the blocks of pixels that are tried as a whole


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Still:
    """Image of what stands still, in one weather; drawn by :func:`draw_still`."""

    backdrop: Backdrop
    shot: Shot
    raw: Shades  # (h, w): through the middles of the pixels
    surfaces: Surfaces | None  # (h, w, 3), where headlights may shine
    is_edge: BoolArray  # (h, w): pixels that are smoothed
    smooth: FloatRays  # (h, w, 3): radiance with smooth edges, cd/m^2
    mirrors: IntArray  # (n,): pixels with a mirrored ray, row * w + column, ascending
    mirrored: FloatRays  # (n, 3): where it goes


def draw_still(
    backdrop: Backdrop,
    pose: Pose,
    camera: CameraModel,
    *,
    weather: Weather,
    materials: Materials | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Still:
    """Draw what stands still, for many frames by :func:`draw_onto`."""
    window, mesh = whole_image(camera), place_mesh(backdrop.mesh, pose.position_m)
    shot = build_shot(backdrop, mesh, pose, camera, weather, materials=materials)
    with start_pool(compute) as pool:
        surfaces = blank_surfaces(window.height, window.width)
        raw = shade_image(shot, window, pool, surfaces)
        is_edge = find_edges(raw.radiance)
        smooth = raw.radiance.copy()
        smooth_image(shot, window, smooth, np.flatnonzero(is_edge), pool.map)
    mirrored = surfaces.mirrored.reshape(-1, 3)
    mirrors = np.flatnonzero(mirrored.any(axis=1))
    return Still(
        backdrop=backdrop,
        shot=shot,
        raw=raw,
        surfaces=surfaces if weather.has_lamps else None,
        is_edge=is_edge,
        smooth=smooth,
        mirrors=mirrors,
        mirrored=mirrored[mirrors],
    )


def scan_onto(
    still: Still, run: Run, frame_index: int, lidar: LidarModel, *, seed: int
) -> PointCloud:
    """Scan a frame of a run by a LiDAR at the place of a still's camera."""
    moving = build_moving_meshes(run, frame_index, with_vut=True)
    mesh, shot = add_moving_meshes(still.shot.mesh, moving), still.shot
    return scan_mesh(mesh, run, shot.pose, lidar, weather=shot.weather, seed=[seed, frame_index])


def draw_onto(
    still: Still, run: Run, frame_index: int, *, compute: Compute = DEFAULT_COMPUTE
) -> Picture:
    """Draw what moves in a frame of a run onto a still, whose obstruction must be the run's.

    Where headlights shine on an edge of what stands still, their light is that on the pixel's
    middle; all else is as in :func:`placement.imaging.draw_picture`.
    """
    with start_pool(compute) as pool:
        shot, image, smooth = _add_moving(still, run, frame_index, pool.map)
        rgb = expose_image(shot, smooth, [compute.seed, frame_index], pool)
    return Picture(
        rgb=rgb, instance=image.instance, depth_m=image.depth_m, names=names_of(shot.mesh)
    )


def _add_moving(
    still: Still, run: Run, frame_index: int, each: Each
) -> tuple[Shot, Shades, FloatRays]:
    """Image of a frame before lens and noise, with what moves.

    Gives the frame's shot, shades through the middles of the pixels, (h, w), and radiance with
    smooth edges, (h, w, 3), in cd/m^2.
    """
    base, window = still.shot, whole_image(still.shot.camera)
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
    right, ahead = ray_parts(shot, window.rows, window.columns)
    view = still.raw.depth_m, right, ahead
    changed = _find_changed(still, shot, moving, view)
    raw = still.raw
    image = Shades(raw.radiance.copy(), raw.instance.copy(), raw.depth_m.copy())
    radiance, smooth = image.radiance.reshape(-1, 3), still.smooth.copy()

    def rays(part: IntArray) -> FloatRays:
        rows, columns = np.divmod(part, window.width)
        if ahead.ndim == 3:
            return ahead[rows, columns]
        return ahead[rows] + right[columns]

    def shade(part: IntArray) -> None:
        shades, _ = shade_rays(shot, rays(part))
        for whole, values in zip(image, shades, strict=True):
            whole.reshape(-1, *whole.shape[2:])[part] = values

    def shine(part: IntArray) -> None:
        more = _headlight_radiance(still, shot, part, rays(part))
        radiance[part] += more
        smooth.reshape(-1, 3)[part] += more

    _in_parts(each, shade, np.flatnonzero(changed))
    lit = _find_lit(shot, changed, view)
    _in_parts(each, shine, np.flatnonzero(lit))
    around = _grown(changed)
    smooth[around] = image.radiance[around]
    unlike = around | (lit & ~still.is_edge)  # what the still says nothing of
    edges = np.flatnonzero(unlike & find_edges(image.radiance))
    smooth_image(shot, window, smooth, edges, each)
    return shot, image, smooth


def _in_parts(each: Each, work: Callable[[IntArray], None], pixels: IntArray) -> None:
    if len(pixels):
        list(each(work, np.array_split(pixels, 1 + len(pixels) // _CHUNK)))


def _headlight_radiance(still: Still, shot: Shot, pixels: IntArray, ways: FloatRays) -> FloatRays:
    """Radiance (n, 3) that headlights add to pixels (n,) of a still."""
    assert still.surfaces is not None
    surfaces = Surfaces(*(array.reshape(-1, 3)[pixels] for array in still.surfaces))
    local = ways * still.raw.depth_m.reshape(-1)[pixels, None]
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
        *(lux, of_light, [lamp for lamp in shot.lamps if isinstance(lamp, HeadLamp)]),
        caster=shot.mesh.caster,
        origin_m=origin,
        ground_albedo=ground_albedo(),
    )
    lux -= surfaces.lux
    lux *= surfaces.albedo
    lux *= (np.exp(np.float32(-shot.sky.extinction_per_m) * distance) / np.float32(np.pi))[:, None]
    return lux


def _grown(mask: BoolArray) -> BoolArray:
    """A mask (h, w) and the pixels next to it, above and below."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown


def _find_changed(still: Still, shot: Shot, moving: Sequence[Mesh], view: "View") -> BoolArray:
    """Pixels (h, w) that what moves may change, but for the light of its headlights."""
    origin_m = shot.mesh.origin_m
    boxes = np.stack([_box(mesh, origin_m) for mesh in moving])
    lamps = [
        [*(lamp.position_m - origin_m), lamp.reach_m]
        for lamp in shot.lamps
        if not isinstance(lamp, HeadLamp)
    ]
    x, y, z = shot.sky.to_sun.tolist()
    to_sun = (x, y, z) if shot.sky.sun_lux.any() and z > 0.0 else (0.0, 0.0, 0.0)
    changed = np.zeros(still.raw.depth_m.shape, dtype=np.bool_)
    _mark(changed, view, boxes, to_sun, np.array(lamps).reshape(-1, 4))
    _mark_mirrored(changed, view, boxes, still.mirrors, still.mirrored)
    return changed


def _find_lit(shot: Shot, changed: BoolArray, view: "View") -> BoolArray:
    """Pixels (h, w) of a still on which headlights may shine."""
    lit = np.zeros(changed.shape, dtype=np.bool_)
    heads = [
        [*(lamp.position_m - shot.mesh.origin_m), lamp.reach_m, *lamp.R_world_lamp[:, 0]]
        for lamp in shot.lamps
        if isinstance(lamp, HeadLamp)
    ]
    if heads:
        _mark_lit(lit, changed, view, np.array(heads))
    return lit


def _box(mesh: Mesh, origin_m: FloatArray) -> FloatArray:
    """The box around a body, (9,): middle, cosine and sine of its yaw, half sizes, radius."""
    yaw = math.radians(mesh.things[0].pose.yaw_deg)
    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    local = (mesh.vertices_m - origin_m) @ turn
    low, high = local.min(axis=0) - _MARGIN_M, local.max(axis=0) + _MARGIN_M
    middle, half = turn @ (0.5 * (low + high)), 0.5 * (high - low)
    return np.concatenate([middle, turn[:2, 0], half, [math.sqrt(half @ half)]])


# ---------- crops
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
    image = Shades._make(part.reshape(*size, *part.shape[1:]) for part in shades)
    edges = np.flatnonzero(find_edges(image.radiance))
    smooth_image(shot, window, image.radiance, edges, map)
    return _expose(shot, image, window, white_cd_m2, [seed, frame_index])


def _expose(
    shot: Shot, image: Shades, window: Window, white_cd_m2: float | None, seeds: list[int]
) -> Picture:
    """A picture of radiances (h, w, 3) that are written over: glare, rain, exposure and noise."""
    rng, radiance = np.random.default_rng([*seeds, *window]), image.radiance
    corner = (window.left, window.top)
    add_glare(radiance, shot.pose, shot.camera, shot.lamps, shot.mesh.caster, corner_px=corner)
    imager = load_imager()
    add_rain(
        *(radiance, _window_camera(shot.camera, window), shot.weather, shot.sky),
        pitch_deg=shot.pose.pitch_deg,
        exposure_s=imager["rain_exposure_s"],
        rng=rng,
    )
    white = _meter(shot) if white_cd_m2 is None else white_cd_m2
    return Picture(
        rgb=develop(radiance, white, imager, rng),
        instance=image.instance,
        depth_m=image.depth_m,
        names=names_of(shot.mesh),
    )


def silhouette(
    run: Run, frame_index: int, pose: Pose, camera: CameraModel, window: Window
) -> BoolArray:
    """Pixels (h, w) of a window that the VRU covers where nothing hides it."""
    vru = place_mesh(build_moving_meshes(run, frame_index, with_vut=False)[-1], pose.position_m)
    if camera.is_pinhole:
        right, down, ahead = camera_rotation(pose.yaw_deg, pose.pitch_deg).T.astype(np.float32)
        focal = camera.focal_length_px
        across = np.arange(window.width) + (window.left + 0.5 - 0.5 * camera.width_px)
        below = np.arange(window.height) + (window.top + 0.5 - 0.5 * camera.height_px)
        columns = (across / focal).astype(np.float32)[None, :, None] * right
        rows = (below / focal).astype(np.float32)[:, None, None] * down
        ways = np.ascontiguousarray((ahead + rows + columns).reshape(-1, 3))
    else:
        ways = lens_rays(pose, pixel_grid(camera)[window.rows, window.columns].reshape(-1, 2))
    _, triangle = vru.caster.first_triangle(np.zeros_like(ways), ways)
    return (triangle >= 0).reshape(window.height, window.width)


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
    ways = pixel_rays(shot, grid[:, 0], grid[:, 1])
    seen: FloatRays = shade_rays(shot, ways)[0].radiance
    seen = seen[ways.any(axis=1)]  # what a lens leaves dark does not count
    n_rows = n_rows if len(seen) == len(ways) else 1
    return white_luminance(seen.reshape(n_rows, -1, 3), load_imager(), every=1)


def _window_camera(camera: CameraModel, window: Window) -> CameraModel:
    """A camera with the same focal length whose whole image has the window's size."""
    half = math.atan(0.5 * window.width / camera.focal_length_px)
    return replace(
        camera,
        width_px=window.width,
        height_px=window.height,
        horizontal_fov_deg=math.degrees(2.0 * half),
        fov_range_deg=None,
        lens=None,
    )


# ---------- kernels
Point = tuple[float, float, float]  # or a way: in the axes of the world, from the camera
# Depths in pixels (h, w), and the parts of their rays by column (w, 3) and by row (h, 3); through a
# lens nothing, and the rays (h, w, 3).
View = tuple[FloatRays, FloatRays, FloatRays]


@kernel
def _ray(view: View, row: int, column: int) -> Point:
    """The ray through the middle of a pixel, one metre deep."""
    return _sum_ray(view[1], view[2], row, column)


@kernel
def _sum_ray(right: FloatRays, ahead: FloatRays, row: int, column: int) -> Point:
    """As :func:`_ray`; only arguments tell the compiler how many axes they have."""
    if ahead.ndim == 3:
        return (
            float(ahead[row, column, 0]),
            float(ahead[row, column, 1]),
            float(ahead[row, column, 2]),
        )
    return (
        float(ahead[row, 0]) + right[column, 0],
        float(ahead[row, 1]) + right[column, 1],
        float(ahead[row, 2]) + right[column, 2],
    )


@kernel
def _times(p: Point, factor: float) -> Point:
    return p[0] * factor, p[1] * factor, p[2] * factor


@kernel
def _away(row: FloatArray, p: Point) -> Point:
    """From a point to the one whose coordinates a row of numbers begins with."""
    return row[0] - p[0], row[1] - p[1], row[2] - p[2]


@kernel
def _dot(p: Point, q: Point) -> float:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@kernel
def _may_meet(box: FloatArray, p: Point, v: Point, radius: float) -> bool:
    """True if rays along v from within a radius of p may meet the sphere around a box.

    All rays are parallel, or all end where p + v is: then they come nearer to one another.
    """
    d = _away(box, p)
    along, away = _dot(d, v), _dot(d, d) - (box[8] + radius) ** 2
    return bool(away <= 0.0 or (along >= 0.0 and away * _dot(v, v) <= along * along))


@kernel
def _meets(box: FloatArray, p: Point, v: Point, most: float) -> bool:
    """True if a ray from p along v meets a box before `most` times v."""
    if not _may_meet(box, p, v, 0.0):
        return False
    d, cos, sin = _away(box, p), box[3], box[4]
    near, far = 0.0, most
    for middle, way, half in (  # the two faces of the box across each of its axes
        (cos * d[0] + sin * d[1], cos * v[0] + sin * v[1], box[5]),
        (cos * d[1] - sin * d[0], cos * v[1] - sin * v[0], box[6]),
        (d[2], np.float64(v[2]), box[7]),
    ):
        if abs(way) < 1e-12:
            if abs(middle) > half:
                return False
            continue
        first, second = (middle - half) / way, (middle + half) / way
        near, far = max(near, min(first, second)), min(far, max(first, second))
        if near > far:
            return False
    return True


@kernel
def _around(view: View, block: tuple[int, int, int, int], sky_m: float) -> tuple[Point, float]:
    """Middle and radius of a sphere around what a block of pixels sees; the sky is at `sky_m`."""
    top, bottom, first, last = block
    low, high = (math.inf, math.inf, math.inf), (-math.inf, -math.inf, -math.inf)
    for row in range(top, bottom):  # pixels of the block
        for column in range(first, last):
            depth = float(view[0][row, column])
            x, y, z = _times(_ray(view, row, column), sky_m if math.isinf(depth) else depth)
            low = min(low[0], x), min(low[1], y), min(low[2], z)
            high = max(high[0], x), max(high[1], y), max(high[2], z)
    size = math.sqrt((high[0] - low[0]) ** 2 + (high[1] - low[1]) ** 2 + (high[2] - low[2]) ** 2)
    middle = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])
    return middle, 0.5 * size + 1e-3


@kernel
def _is_changed(
    ray: Point,
    depth: float,
    boxes: FloatArray,
    to_sun: Point,
    lamps: FloatArray,
    possible: BoolArray,
) -> bool:
    """True if one of the possible boxes is seen in a pixel, or throws a shadow there."""
    for index in range(len(boxes)):  # boxes that may be seen there
        if possible[index, 0] and _meets(boxes[index], (0.0, 0.0, 0.0), ray, depth):
            return True
    if math.isinf(depth):
        return False
    at = _times(ray, depth)
    for index in range(len(boxes)):  # boxes that may hide the sun, or a lamp
        if possible[index, 1] and _meets(boxes[index], at, to_sun, math.inf):
            return True
        for lamp in range(len(lamps)):
            if possible[index, 2 + lamp]:
                way = _away(lamps[lamp], at)
                is_lit = _dot(way, way) <= lamps[lamp, 3] ** 2
                if is_lit and _meets(boxes[index], at, way, 1.0):
                    return True
    return False


@kernel
def _mark(
    changed: BoolArray, view: View, boxes: FloatArray, to_sun: Point, lamps: FloatArray
) -> None:
    """Mark pixels where a box is seen, or throws a shadow of sun or lamp.

    Blocks of pixels are tried as a whole first: what moves changes few of them.
    """
    n_boxes, n_lamps = len(boxes), len(lamps)
    sky_m = 1.0  # beyond all boxes
    for index in range(n_boxes):
        box = boxes[index]
        away = math.sqrt(box[0] ** 2 + box[1] ** 2 + box[2] ** 2) + box[8]
        sky_m = max(sky_m, 1.01 * away)
    # Of each box: may it be seen, hide the sun, hide each lamp?
    possible = np.empty((n_boxes, 2 + n_lamps), dtype=np.bool_)
    for top in range(0, changed.shape[0], _BLOCK_PX):  # blocks of pixels
        bottom = min(top + _BLOCK_PX, changed.shape[0])
        for first in range(0, changed.shape[1], _BLOCK_PX):
            last = min(first + _BLOCK_PX, changed.shape[1])
            at, radius = _around(view, (top, bottom, first, last), sky_m)
            for index in range(n_boxes):  # as a whole, by spheres around block and box
                box = boxes[index]
                possible[index, 0] = _may_meet(box, at, _times(at, -1.0), radius)
                possible[index, 1] = to_sun[2] > 0.0 and _may_meet(box, at, to_sun, radius)
                for lamp in range(n_lamps):
                    way = _away(lamps[lamp], at)
                    is_near = _dot(way, way) <= (lamps[lamp, 3] + radius) ** 2
                    possible[index, 2 + lamp] = is_near and _may_meet(box, at, way, radius)
            if not possible.any():
                continue
            for row in range(top, bottom):  # then pixel by pixel
                for column in range(first, last):
                    ray, depth = _ray(view, row, column), float(view[0][row, column])
                    changed[row, column] = _is_changed(ray, depth, boxes, to_sun, lamps, possible)


@kernel
def _mark_lit(lit: BoolArray, changed: BoolArray, view: View, heads: FloatArray) -> None:
    """Mark pixels that are not changed and lie before a headlight, in its reach."""
    for row in range(lit.shape[0]):  # pixels, and the headlights that may reach each
        for column in range(lit.shape[1]):
            depth = float(view[0][row, column])
            if changed[row, column] or math.isinf(depth):
                continue
            at = _times(_ray(view, row, column), depth)
            for lamp in range(len(heads)):
                way, head = _away(heads[lamp], at), heads[lamp]
                is_ahead = _dot(way, (head[4], head[5], head[6])) < 0.0
                if is_ahead and _dot(way, way) < head[3] ** 2:
                    lit[row, column] = True


@kernel
def _mark_mirrored(
    changed: BoolArray, view: View, boxes: FloatArray, mirrors: IntArray, mirrored: FloatRays
) -> None:
    """Mark pixels whose mirrored ray meets a box."""
    width = changed.shape[1]
    for number in range(len(mirrors)):  # pixels with a mirrored ray, and the boxes
        row, column = mirrors[number] // width, mirrors[number] % width
        at = _times(_ray(view, row, column), float(view[0][row, column]))
        way = mirrored[number]
        to = float(way[0]), float(way[1]), float(way[2])
        for index in range(len(boxes)):
            if not changed[row, column]:
                changed[row, column] = _meets(boxes[index], at, to, math.inf)
