"""Loops over views and cameras: who is in the field of view, and the boxes around what is seen."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]

_SLACK = 1.0e-6  # of a cosine: nobody at the edge is left out


@kernel
def pairs_in_cones(
    middle: Array, distance: Array, half_angle: Array, ahead: Array, half_fov: Array
) -> tuple[Array, Array]:
    """Sensors and bodies of which some part may be in the sensor's field of view, as index pairs.

    `middle` (n, 3), `distance` (n,), `half_angle` (n,): spheres around bodies from the mount;
    `ahead` (k, 3), `half_fov` (k,): axes of the sensors' cones, and their half angles in radians.
    """
    n, k = len(middle), len(ahead)
    cos_body, sin_body = np.cos(half_angle), np.sin(half_angle)
    cos_fov, sin_fov = np.cos(half_fov), np.sin(half_fov)
    row = np.empty(n * k, np.int32)
    entry = np.empty(n * k, np.int32)
    count = 0
    for sensor in range(k):
        ax, ay, az = ahead[sensor]
        for body in range(n):
            along = middle[body, 0] * ax + middle[body, 1] * ay + middle[body, 2] * az
            least = cos_fov[sensor] * cos_body[body] - sin_fov[sensor] * sin_body[body] - _SLACK
            is_all_round = half_fov[sensor] + half_angle[body] >= np.pi
            row[count] = sensor
            entry[count] = body
            count += is_all_round or along >= least * distance[body]
    return row[:count].copy(), entry[:count].copy()


_SEEN, _ALL = 0, 4  # where the box of what is visible and that of all begin
_LOWEST, _HIGHEST = np.int32(-(2**31)), np.int32(2**31 - 1)
_SIGN, _REST = np.int32(31), np.int32(0x7FFFFFFF)


@kernel
def _limits(bits: Array, n: int, limits: Array) -> None:
    """Least and greatest of `n` numbers in single precision, all by their bits; limits (2,).

    Bits are in the order of the numbers but for negative ones, where they are turned round: the
    least and greatest of whole numbers are found for many at once.
    """
    low, high = _HIGHEST, _LOWEST
    for j in range(n):
        key = np.int32(bits[j] ^ np.int32(np.int32(bits[j] >> _SIGN) & _REST))
        low = key if key < low else low
        high = key if key > high else high
    limits[0] = np.int32(low ^ np.int32(np.int32(low >> _SIGN) & _REST))
    limits[1] = np.int32(high ^ np.int32(np.int32(high >> _SIGN) & _REST))


@kernel
def _project(
    axes: Array,
    view: int,
    eye: Array,
    rotation: Array,
    camera: int,
    focal: Any,
    half_width: Any,
    half_height: Any,
    min_depth: Any,
    columns: Array,
    rows: Array,
    depths: Array,
    scale: Array,
) -> None:
    """Columns, rows and depths of a view's points (n_views, 3, n) in a camera.

    One number after the other: a loop that writes one array does many at once. Nor are parts of
    arrays handed about, which would take as long as some ten points.
    """
    ex, ey, ez = eye[0], eye[1], eye[2]
    x0, x1, x2 = rotation[camera, 0, 0], rotation[camera, 0, 1], rotation[camera, 0, 2]
    y0, y1, y2 = rotation[camera, 1, 0], rotation[camera, 1, 1], rotation[camera, 1, 2]
    z0, z1, z2 = rotation[camera, 2, 0], rotation[camera, 2, 1], rotation[camera, 2, 2]
    n = axes.shape[2]
    for j in range(n):
        x, y, z = axes[view, 0, j] - ex, axes[view, 1, j] - ey, axes[view, 2, j] - ez
        depths[j] = x * x2 + y * y2 + z * z2
    for j in range(n):
        depth = depths[j]
        scale[j] = focal / (depth if depth > min_depth else min_depth)
    for j in range(n):
        x, y, z = axes[view, 0, j] - ex, axes[view, 1, j] - ey, axes[view, 2, j] - ez
        columns[j] = (x * x0 + y * y0 + z * z0) * scale[j] + half_width
    for j in range(n):
        x, y, z = axes[view, 0, j] - ex, axes[view, 1, j] - ey, axes[view, 2, j] - ez
        rows[j] = (x * x1 + y * y1 + z * z1) * scale[j] + half_height


@kernel
def box_pairs(
    points: Array,
    hull: Array,
    eye: Array,
    view_of_entry: Array,
    is_visible: Array,
    is_whole: Array,
    rotation: Array,
    focal_px: Array,
    size_px: Array,
    min_depth_m: Any,
    min_height_px: Any,
    row: Array,
    entry: Array,
    boxes_px: Array,
    inside_share: Array,
) -> None:
    """Boxes of the visible points and of all, (n, 8), and the share of the body inside the image.

    For each pair of a camera `row` (n,) and an `entry` (n,). `points` (n_views, 3, n_points) and
    `hull` (n_views, 3, n_hull), the corners of their convex hull, are in single precision, and so
    is `eye` (3,). `rotation` (k, 3, 3) takes offsets into the cameras, `focal_px` (k,), `size_px`
    (k, 2). Of a body that the image cuts off, only the points inside the image count; boxes are
    zeros where there are none, or where no box would be `min_height_px` high.
    """
    n_points, n_hull = points.shape[2], hull.shape[2]
    columns = np.empty(n_points, np.float32)
    rows, depths = np.empty_like(columns), np.empty_like(columns)
    scale, some = np.empty_like(columns), np.empty_like(columns)
    column_bits, row_bits = columns.view(np.int32), rows.view(np.int32)
    depth_bits, some_bits = depths.view(np.int32), some.view(np.int32)
    limits = np.empty(2, np.float32)
    limit_bits = limits.view(np.int32)
    is_counted = np.empty(n_points, np.bool_)
    zero, half = np.float32(0.0), np.float32(0.5)
    for pair in range(len(row)):
        camera, item = row[pair], entry[pair]
        view = view_of_entry[item]
        width, height, focal = size_px[camera, 0], size_px[camera, 1], focal_px[camera]
        half_width, half_height = half * width, half * height
        _project(
            *(hull, view, eye, rotation, camera, focal, half_width, half_height, min_depth_m),
            *(columns, rows, depths, scale),
        )
        _limits(depth_bits, n_hull, limit_bits)
        is_behind = limits[0] <= min_depth_m
        _limits(column_bits, n_hull, limit_bits)
        left, right = limits[0], limits[1]
        _limits(row_bits, n_hull, limit_bits)
        top, bottom = limits[0], limits[1]
        is_low = min(bottom, height) - max(top, zero) < min_height_px
        if not is_behind and (
            is_low
            or right - half_width < -half_width
            or left - half_width > half_width
            or bottom - half_height < -half_height
            or top - half_height > half_height
        ):
            for k in range(8):
                boxes_px[pair, k] = zero
            inside_share[pair] = 0.0
            continue
        is_cut = is_behind or left < zero or top < zero or right > width or bottom > height
        if is_cut or not is_whole[item]:
            _project(
                *(points, view, eye, rotation, camera, focal, half_width, half_height, min_depth_m),
                *(columns, rows, depths, scale),
            )
        if is_behind:  # beside and behind the lens points are not projected as bodies are
            _limits(column_bits, n_points, limit_bits)
            left, right = limits[0], limits[1]
            _limits(row_bits, n_points, limit_bits)
            top, bottom = limits[0], limits[1]
        inside_share[pair] = 1.0
        if is_cut:
            area = (np.float64(right) - left) * (np.float64(bottom) - top)
            wide = np.float64(max(zero, min(right, width))) - max(zero, min(left, width))
            high = np.float64(max(zero, min(bottom, height))) - max(zero, min(top, height))
            inside_share[pair] = wide * high / max(area, 1.0e-9)
        boxes_px[pair, _ALL], boxes_px[pair, _ALL + 1] = left, top
        boxes_px[pair, _ALL + 2], boxes_px[pair, _ALL + 3] = right, bottom
        for j in range(n_points if is_cut else 0):
            is_counted[j] = (
                (depths[j] > min_depth_m)
                & (abs(columns[j] - half_width) <= half_width)
                & (abs(rows[j] - half_height) <= half_height)
            )
        # First the box of all that is in the image, then that of what is visible of it.
        for side in (_ALL, _SEEN):
            if side == _ALL and not is_cut:
                continue
            if side == _SEEN and is_whole[item]:
                for k in range(4):
                    boxes_px[pair, _SEEN + k] = boxes_px[pair, _ALL + k]
                continue
            if side == _SEEN and is_cut:
                for j in range(n_points):
                    is_counted[j] &= is_visible[item, j]
            elif side == _SEEN:
                for j in range(n_points):
                    is_counted[j] = is_visible[item, j]
            first = 0
            while first < n_points and not is_counted[first]:
                first += 1
            if first == n_points:
                for k in range(4):
                    boxes_px[pair, side + k] = zero
                continue
            one = columns[first]  # the first one stands in for those that do not count
            for j in range(n_points):
                some[j] = columns[j] if is_counted[j] else one
            _limits(some_bits, n_points, limit_bits)
            boxes_px[pair, side], boxes_px[pair, side + 2] = limits[0], limits[1]
            one = rows[first]
            for j in range(n_points):
                some[j] = rows[j] if is_counted[j] else one
            _limits(some_bits, n_points, limit_bits)
            boxes_px[pair, side + 1], boxes_px[pair, side + 3] = limits[0], limits[1]


@kernel
def pack_frames(
    detected: Array, weather_of_frame: Array, entry_of_frame: Array, packed: Array
) -> None:
    """Bits of the frames (k, n_bytes), lowest first, from `detected` (k, n_weathers, n_entries).

    A frame whose entry is -1 shows nothing.
    """
    for row in range(len(packed)):
        for frame in range(len(entry_of_frame)):
            entry = entry_of_frame[frame]
            if entry >= 0 and detected[row, weather_of_frame[frame], entry]:
                packed[row, frame >> 3] |= np.uint8(1 << (frame & 7))
