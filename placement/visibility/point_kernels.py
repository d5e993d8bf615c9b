"""Numba kernels: points of bodies, spread over them, projected into cameras, counted by LiDARs.

Most bodies are seen whole, and inside the image: the corners of their convex hulls say all. Many
cameras are projected into at once, side by side in lanes. The others are looked at one by one,
point by point, many points at once.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray
from geometry.kernels import kernel

Array = NDArray[Any]

LANES = 16  # cameras, or points, that are handled at once
# Where each number of the cameras in the lanes begins: the rotation's, by rows, and the others.
_FOCAL, _HALF_WIDTH, _HALF_HEIGHT = (LANES * number for number in range(9, 12))
_N_NUMBERS = 12  # of a camera that projecting takes
_COS_ACROSS, _SIN_ACROSS, _COS_UP, _SIN_UP = (LANES * number for number in range(12, 16))
_X0, _X1, _X2, _Y0, _Y1, _Y2, _Z0, _Z1, _Z2 = (LANES * number for number in range(9))
_LEFT, _TOP, _RIGHT, _BOTTOM, _DEPTH = (LANES * number for number in range(5))
_SEEN, _ALL = 0, 4  # where the box of what is visible and that of all begin
_FAR = np.float32(3.0e38)
_NEARLY = 0.999  # for the rounding of single precision
_SLACK_PX = 0.01
_SLACK_M = np.float32(1.0e-3)  # of a sphere in single precision: nobody at the edge is left out


def pack_lenses(rotation: FloatArray, focal_px: FloatArray, size_px: FloatArray) -> Array:
    """Cameras side by side for :func:`box_bodies`, (n_blocks, 16 * LANES), in single precision.

    `rotation` (k, 3, 3) takes offsets into the cameras; `focal_px` (k,), `size_px` (k, 2).
    """
    half = 0.5 * size_px
    numbers = np.zeros((-(-len(focal_px) // LANES) * LANES, 16), dtype=np.float32)
    numbers[: len(focal_px), :9] = rotation.reshape(-1, 9)
    numbers[: len(focal_px), 9] = focal_px
    numbers[: len(focal_px), 10:12] = half
    angle = np.arctan2(half, focal_px[:, None])
    numbers[: len(focal_px), 12::2] = np.cos(angle)
    numbers[: len(focal_px), 13::2] = np.sin(angle)
    return np.ascontiguousarray(numbers.reshape(-1, LANES, 16).swapaxes(1, 2)).reshape(
        -1, 16 * LANES
    )


@kernel
def _is_any_near(
    x: Any, y: Any, z: Any, radius: Any, lens: Array, n: int, least_px: Any, is_near: Array
) -> bool:
    """Set `is_near` (LANES,) where a sphere may be so high in a camera's image.

    The rows that it reaches lie between the tangents from the eye; next to and behind the lens it
    may reach any.
    """
    for j in range(LANES):  # cameras in the lanes
        right = x * lens[_X0 + j] + y * lens[_Y0 + j] + z * lens[_Z0 + j]
        down = x * lens[_X1 + j] + y * lens[_Y1 + j] + z * lens[_Z1 + j]
        ahead = x * lens[_X2 + j] + y * lens[_Y2 + j] + z * lens[_Z2 + j]
        across = abs(right) * lens[_COS_ACROSS + j] - ahead * lens[_SIN_ACROSS + j]
        up = abs(down) * lens[_COS_UP + j] - ahead * lens[_SIN_UP + j]
        half = radius / np.sqrt(down * down + ahead * ahead - radius * radius)  # tangents
        middle = down / ahead
        focal, half_height = lens[_FOCAL + j], lens[_HALF_HEIGHT + j]
        top = focal * (middle - half) / (np.float32(1.0) + middle * half)
        bottom = focal * (middle + half) / (np.float32(1.0) - middle * half)
        top = top if top > -half_height else -half_height
        bottom = bottom if bottom < half_height else half_height
        is_low = (ahead > radius) & (bottom - top < least_px)
        is_near[j] = (across <= radius) & (up <= radius) & (not is_low)
    found = False
    for j in range(n):
        found |= is_near[j]
    return found


@kernel
def _least(min_height_px: float) -> Any:
    """Height in single precision below which nothing is near `min_height_px`."""
    return np.float32(_NEARLY * min_height_px - _SLACK_PX)


@kernel
def find_views(
    middle: Array,
    radius: Array,
    eye: Array,
    lenses: Array,
    n_cameras: int,
    min_height_px: float,
    found: Array,
) -> None:
    """Set `found` (n_views,) where a body may be `min_height_px` high in a camera's image.

    The others are as for :func:`box_bodies`.
    """
    is_near, least_px = np.empty(LANES, np.bool_), _least(min_height_px)
    for view in range(len(middle)):  # views, and blocks of cameras until one is near
        x = np.float32(middle[view, 0] - eye[0])
        y = np.float32(middle[view, 1] - eye[1])
        z = np.float32(middle[view, 2] - eye[2])
        reach = np.float32(radius[view]) + _SLACK_M
        for block in range(len(lenses)):
            n = min(LANES, n_cameras - block * LANES)
            if _is_any_near(x, y, z, reach, lenses[block], n, least_px, is_near):
                found[view] = True
                break


@kernel
def _project_into_all(
    points: Array, view: int, eye: Array, lens: Array, min_depth: Any, limits: Array
) -> None:
    """Least and greatest column and row of a view's points in every camera, and the least depth.

    Into `limits` (5 * LANES,). Each number is computed as in :func:`_box_points`.
    """
    ex, ey, ez = eye[0], eye[1], eye[2]
    for j in range(LANES):
        limits[_LEFT + j] = limits[_TOP + j] = limits[_DEPTH + j] = _FAR
        limits[_RIGHT + j] = limits[_BOTTOM + j] = -_FAR
    for point in range(0, points.shape[2], 2):  # points, two at a time, in all cameras at once
        other_point = min(point + 1, points.shape[2] - 1)
        x, a = points[view, 0, point] - ex, points[view, 0, other_point] - ex
        y, b = points[view, 1, point] - ey, points[view, 1, other_point] - ey
        z, c = points[view, 2, point] - ez, points[view, 2, other_point] - ez
        for j in range(LANES):
            x2, y2, z2 = lens[_X2 + j], lens[_Y2 + j], lens[_Z2 + j]
            depth, other = x * x2 + y * y2 + z * z2, a * x2 + b * y2 + c * z2
            focal = lens[_FOCAL + j]
            scale = focal / (depth if depth > min_depth else min_depth)
            other_scale = focal / (other if other > min_depth else min_depth)
            low, least = (other if other < depth else depth), limits[_DEPTH + j]
            limits[_DEPTH + j] = low if low < least else least
            x0, y0, z0 = lens[_X0 + j], lens[_Y0 + j], lens[_Z0 + j]
            one, two = (x * x0 + y * y0 + z * z0) * scale, (a * x0 + b * y0 + c * z0) * other_scale
            low, high = (one if one < two else two), (two if one < two else one)
            left, right = limits[_LEFT + j], limits[_RIGHT + j]
            limits[_LEFT + j] = low if low < left else left
            limits[_RIGHT + j] = high if high > right else right
            x1, y1, z1 = lens[_X1 + j], lens[_Y1 + j], lens[_Z1 + j]
            one, two = (x * x1 + y * y1 + z * z1) * scale, (a * x1 + b * y1 + c * z1) * other_scale
            low, high = (one if one < two else two), (two if one < two else one)
            top, bottom = limits[_TOP + j], limits[_BOTTOM + j]
            limits[_TOP + j] = low if low < top else top
            limits[_BOTTOM + j] = high if high > bottom else bottom
    for j in range(LANES):  # rounding leaves the order of numbers as it is
        limits[_LEFT + j] += lens[_HALF_WIDTH + j]
        limits[_RIGHT + j] += lens[_HALF_WIDTH + j]
        limits[_TOP + j] += lens[_HALF_HEIGHT + j]
        limits[_BOTTOM + j] += lens[_HALF_HEIGHT + j]


@kernel
def _set_out(points: Array, view: int, eye: Array, shown: Array, offsets: Array) -> int:
    """Offsets of a view's points from the eye, by axis, into lanes, (n_blocks, 3 * LANES).

    Of those that are `shown` (n_points,); returns how many blocks they fill.
    """
    count = 0
    for point in range(points.shape[2]):  # points that are shown go to the next free lane
        if shown[point]:
            for axis in range(3):
                offset = points[view, axis, point] - eye[axis]
                offsets[count // LANES, axis * LANES + count % LANES] = offset
            count += 1
    n_blocks = -(-count // LANES)
    for lane in range(count, n_blocks * LANES):  # the last one fills what is left of the lanes
        for axis in range(3):
            last = offsets[(count - 1) // LANES, axis * LANES + (count - 1) % LANES]
            offsets[n_blocks - 1, axis * LANES + lane % LANES] = last
    return n_blocks


@kernel
def _box_points(
    offsets: Array,
    lens: Array,
    camera: int,
    min_depth: Any,
    is_cut: bool,
    limits: Array,
    box: Array,
    side: int,
) -> None:
    """Box of points, (n_blocks, 3 * LANES), in one camera of the lanes.

    Into `box` (8,), from `side` on; zeros if no point counts. If the image cuts the body off, only
    points inside the image count.
    """
    x0, x1, x2 = lens[_X0 + camera], lens[_X1 + camera], lens[_X2 + camera]
    y0, y1, y2 = lens[_Y0 + camera], lens[_Y1 + camera], lens[_Y2 + camera]
    z0, z1, z2 = lens[_Z0 + camera], lens[_Z1 + camera], lens[_Z2 + camera]
    focal = lens[_FOCAL + camera]
    half_width, half_height = lens[_HALF_WIDTH + camera], lens[_HALF_HEIGHT + camera]
    widest = half_width if is_cut else _FAR
    highest = half_height if is_cut else _FAR
    nearest = min_depth if is_cut else -_FAR
    for j in range(LANES):
        limits[_LEFT + j] = limits[_TOP + j] = _FAR
        limits[_RIGHT + j] = limits[_BOTTOM + j] = -_FAR
    for block in range(len(offsets)):  # points, as many at a time as there are lanes
        offset = offsets[block]
        for j in range(LANES):
            x, y, z = offset[j], offset[LANES + j], offset[2 * LANES + j]
            depth = x * x2 + y * y2 + z * z2
            scale = focal / (depth if depth > min_depth else min_depth)
            column = (x * x0 + y * y0 + z * z0) * scale + half_width
            row = (x * x1 + y * y1 + z * z1) * scale + half_height
            counts = (
                (depth > nearest)
                & (abs(column - half_width) <= widest)
                & (abs(row - half_height) <= highest)
            )
            low, high = (column if counts else _FAR), (column if counts else -_FAR)
            left, right = limits[_LEFT + j], limits[_RIGHT + j]
            limits[_LEFT + j] = low if low < left else left
            limits[_RIGHT + j] = high if high > right else right
            low, high = (row if counts else _FAR), (row if counts else -_FAR)
            top, bottom = limits[_TOP + j], limits[_BOTTOM + j]
            limits[_TOP + j] = low if low < top else top
            limits[_BOTTOM + j] = high if high > bottom else bottom
    left, top, right, bottom = _FAR, _FAR, -_FAR, -_FAR
    for j in range(LANES):
        left = limits[_LEFT + j] if limits[_LEFT + j] < left else left
        top = limits[_TOP + j] if limits[_TOP + j] < top else top
        right = limits[_RIGHT + j] if limits[_RIGHT + j] > right else right
        bottom = limits[_BOTTOM + j] if limits[_BOTTOM + j] > bottom else bottom
    is_there = left <= right
    zero = np.float32(0.0)
    box[side], box[side + 1] = left if is_there else zero, top if is_there else zero
    box[side + 2], box[side + 3] = right if is_there else zero, bottom if is_there else zero


@kernel
def _find_near(
    middle: Array, reach: Any, eye: Array, cameras: tuple[Array, int], least_px: Any, near: Array
) -> int:
    """Cameras in whose images a view's body may be high enough, into `near`; their number."""
    lenses, n_cameras = cameras
    x, y = np.float32(middle[0] - eye[0]), np.float32(middle[1] - eye[1])
    z = np.float32(middle[2] - eye[2])
    is_near, n_near = np.empty(LANES, np.bool_), 0
    for block in range(len(lenses)):
        n = min(LANES, n_cameras - block * LANES)
        if _is_any_near(x, y, z, reach, lenses[block], n, least_px, is_near):
            for j in range(n):
                near[n_near] = block * LANES + j
                n_near += is_near[j]
    return n_near


@kernel
def _is_high(box: Array, min_height_px: float) -> bool:
    """True if the box of what is visible has the height that is asked for."""
    high = np.float64(box[_SEEN + 3]) - np.float64(box[_SEEN + 1])
    return bool(high >= min_height_px and high > 0.0)


@kernel
def _share_inside(left: Any, top: Any, right: Any, bottom: Any, width: Any, height: Any) -> float:
    """Share of a box inside an image."""
    zero = np.float32(0.0)
    area = (np.float64(right) - left) * (np.float64(bottom) - top)
    across = np.float64(max(zero, min(right, width))) - max(zero, min(left, width))
    up = np.float64(max(zero, min(bottom, height))) - max(zero, min(top, height))
    return float(across * up / max(area, 1.0e-9))


@kernel
def _gather_lanes(lenses: Array, cameras: Array, lens: Array) -> None:
    """Put some cameras side by side into the lanes of one block."""
    for j in range(len(cameras)):
        block, lane = cameras[j] // LANES, cameras[j] % LANES
        for number in range(_N_NUMBERS):
            lens[number * LANES + j] = lenses[block, number * LANES + lane]


@kernel
def _box_part(
    blocks: tuple[Array, Array],
    state: tuple[bool, bool, Any, float],
    lens: Array,
    camera: int,
    limits: Array,
    some: Array,
    box: Array,
) -> bool:
    """Boxes of the visible points and of all, in one camera, into `box` (8,); True if high enough.

    Blocks of visible and of all points are of :func:`_set_out`. The state says if nothing hides the
    body, if the image cuts it off, and the least depth and height. `limits` are those of all.
    """
    (seen, every), (is_whole, is_cut, min_depth, min_height_px) = blocks, state
    if not is_whole:
        _box_points(seen, lens, camera, min_depth, is_cut, some, box, _SEEN)
        if not _is_high(box, min_height_px):
            return False
    if is_cut:
        _box_points(every, lens, camera, min_depth, is_cut, some, box, _ALL)
    if is_whole:
        for k in range(4):
            box[_SEEN + k] = box[_ALL + k]
    if not _is_high(box, min_height_px):
        return False
    for k in range(4 if not is_cut else 0):
        box[_ALL + k] = limits[k * LANES + camera]
    return True


@kernel
def _sides(limits: Array, camera: int) -> tuple[Any, Any, Any, Any]:
    """Left, top, right and bottom of what one camera of the lanes shows."""
    return (
        limits[_LEFT + camera],
        limits[_TOP + camera],
        limits[_RIGHT + camera],
        limits[_BOTTOM + camera],
    )


@kernel
def box_bodies(
    bodies: tuple[Array, Array, Array, Array],
    eye: Array,
    sight: tuple[Array, Array, Array],
    cameras: tuple[Array, int],
    least: tuple[Any, float],
    found: tuple[Array, Array, Array, Array, Array],
) -> tuple[int, int]:
    """Boxes of bodies in cameras, those of whole bodies inside the image apart from the others.

    Bodies: `points` (n_views, 3, n_points), `hull` (n_views, 3, n_corners), the corners of their
    convex hull, both and `eye` (3,) in single precision; `middle` (n_views, 3) and `radius`
    (n_views,) of spheres around them. The sight: view of each entry, its visible points, if it is
    whole. Cameras: `lenses` of :func:`pack_lenses`, and their number. Found are, of each kind, as
    many as are returned: pairs of a camera and an entry go to `plain` and `part` (n, 2); of plain
    ones, the one box of all that is visible goes to `plain_px` (n, 4), of the others those of the
    visible points and of all go to `part_px` (n, 8), and the share of the body inside the image to
    `inside_share` (n,). Pairs whose visible box is not `min_height_px` high are left out.
    """
    (points, hull, middle, radius), (min_depth_m, min_height_px) = bodies, least
    (view_of_entry, is_visible, is_whole), (lenses, n_cameras) = sight, cameras
    plain, plain_px, part, part_px, inside_share = found
    limits, some = np.empty(5 * LANES, np.float32), np.empty(5 * LANES, np.float32)
    box = np.empty(8, np.float32)
    near, lens = np.empty(n_cameras + 1, np.int64), np.zeros(_N_NUMBERS * LANES, np.float32)
    every_point = np.ones(points.shape[2], np.bool_)
    every = np.empty((-(-points.shape[2] // LANES), 3 * LANES), np.float32)
    seen = np.empty_like(every)
    zero, least_px = np.float32(0.0), _least(min_height_px)
    n_plain = n_part = 0
    for entry in range(len(view_of_entry)):  # bodies that are seen from the mount
        view = view_of_entry[entry]
        n_every = n_seen = -1  # blocks of points; not yet set out
        reach = np.float32(radius[view]) + _SLACK_M
        n_near = _find_near(middle[view], reach, eye, cameras, least_px, near)
        for first in range(0, n_near, LANES):  # near cameras, as many as there are lanes
            n = min(LANES, n_near - first)
            _gather_lanes(lenses, near[first : first + n], lens)
            _project_into_all(hull, view, eye, lens, min_depth_m, limits)
            for j in range(n):
                camera = near[first + j]
                left, top, right, bottom = _sides(limits, j)
                width = lens[_HALF_WIDTH + j] + lens[_HALF_WIDTH + j]
                height = lens[_HALF_HEIGHT + j] + lens[_HALF_HEIGHT + j]
                is_behind = limits[_DEPTH + j] <= min_depth_m
                high = np.float64(min(bottom, height)) - np.float64(max(top, zero))
                is_out = high < _NEARLY * min_height_px or high < 0.0
                if not is_behind and (is_out or right < zero or left > width):
                    continue
                is_cut = is_behind or left < zero or top < zero or right > width or bottom > height
                if is_whole[entry] and not is_cut:
                    if high >= min_height_px and high > 0.0:
                        plain[n_plain, 0], plain[n_plain, 1] = camera, entry
                        plain_px[n_plain, 0], plain_px[n_plain, 1] = left, top
                        plain_px[n_plain, 2], plain_px[n_plain, 3] = right, bottom
                        n_plain += 1
                    continue
                if not is_whole[entry] and n_seen < 0:
                    n_seen = _set_out(points, view, eye, is_visible[entry], seen)
                if is_cut and n_every < 0:
                    n_every = _set_out(points, view, eye, every_point, every)
                blocks = (seen[: max(n_seen, 0)], every[: max(n_every, 0)])
                state = (is_whole[entry], is_cut, min_depth_m, min_height_px)
                if not _box_part(blocks, state, lens, j, limits, some, box):
                    continue
                part[n_part, 0], part[n_part, 1] = camera, entry
                part_px[n_part] = box
                if is_behind:  # next to and behind the lens points are not projected as bodies are
                    _project_into_all(points, view, eye, lens, min_depth_m, some)
                    left, top, right, bottom = _sides(some, j)
                share = _share_inside(left, top, right, bottom, width, height)
                inside_share[n_part] = share if is_cut else 1.0
                n_part += 1
    return n_plain, n_part


@kernel
def count_echoes(
    rotations: Array,
    is_near: Array,
    first: Array,
    directions: Array,
    expected: Array,
    needed: Array,
    cos_across: float,
    sin_up: float,
    detected: Array,
) -> None:
    """Set `detected` (m, n_weathers, n_entries) where points that come back are as many as needed.

    Points from ``first[i]`` on belong to entry i. `directions` (k, 3) are unit vectors from the
    mount, `expected` (n_weathers, k) what comes back of each where beams are as dense as at the
    horizon: their density grows as the circles of latitude shrink. `rotations` (m, 3, 3) have the
    axes ahead, left and up as columns; `is_near` (m, n_entries): entries that may be in view. The
    field of view has half angles with this cosine across and this sine up, limits included.
    """
    n_weathers = len(expected)
    total = np.zeros(n_weathers)
    for row in range(len(rotations)):  # LiDARs, entries, and the points on each
        r = rotations[row]
        for entry in range(len(needed)):
            if not is_near[row, entry]:
                continue
            total[:] = 0.0
            for point in range(first[entry], first[entry + 1]):
                x, y, z = directions[point, 0], directions[point, 1], directions[point, 2]
                up = x * r[0, 2] + y * r[1, 2] + z * r[2, 2]
                if abs(up) > sin_up:
                    continue
                ahead = x * r[0, 0] + y * r[1, 0] + z * r[2, 0]
                left = x * r[0, 1] + y * r[1, 1] + z * r[2, 1]
                level = np.sqrt(ahead * ahead + left * left)
                if ahead < cos_across * level:
                    continue
                for weather in range(n_weathers):
                    total[weather] += expected[weather, point] / level
            for weather in range(n_weathers):
                detected[row, weather, entry] = total[weather] >= needed[entry]
