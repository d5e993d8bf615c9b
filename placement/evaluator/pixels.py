"""Which pixels of an image show the VRU: triangles drawn at pixel centres, by compiled code.

A pixel is a direction from the lens, one metre deep: the ray through its centre. A triangle with
corners a, b, c (camera frame) covers it where the direction lies on the same side of the three
planes through the lens and an edge; the depth there is a . (b x c) / (sum of the three products).
That needs no clipping, and neighbours that share an edge leave no gap [1]_. Only the rows and
columns in which it is looked for are found by projecting and clipping.

Nothing can hide the VRU but what reaches into its beam: the pyramid from the lens through the box
of the VRU in the image, as deep as the VRU. Trees of boxes find it; where they find nothing, the
visible box is the amodal one, and nothing is drawn but the VRU's outline.

References
----------
.. [1] M. Olano, T. Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates",
   Graphics Hardware 1997.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

from .sights import Seen, Sights
from .solids import Tree
from .trees import MAX_OPEN

_MIN_DEPTH_M = 1.0e-6
_TOUCH_M = 1.0e-6  # what the VRU stands on does not hide it
_SLACK_PX = 1.0e-6  # more than rounding moves an edge
_PAST_CENTRE_PX = 0.5 + _SLACK_PX
_N_PLANES = 6


class Image(NamedTuple):
    """What pixels are: of a camera at its place."""

    focal_px: float
    width_px: int
    height_px: int
    near_m: float  # distance from the lens at which drawing starts
    up_m: float  # height of the lens


# ---------- the image


@kernel
def _least_depth(image: Image, window: IntArray) -> float:
    """Depth before which nothing is drawn in any pixel of a window."""
    half_width, half_height = 0.5 * image.width_px, 0.5 * image.height_px
    across = max(half_width - window[0], window[2] - half_width) / image.focal_px
    down = max(half_height - window[1], window[3] - half_height) / image.focal_px
    depth: float = image.near_m / np.sqrt(1.0 + across * across + down * down)
    return depth


@kernel
def _to_camera(turn: FloatArray, shift: FloatArray, points: FloatArray, out: FloatArray) -> None:
    """Points (n, 3) in the camera frame: columns right, down, ahead."""
    for row in range(len(points)):
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        for axis in range(3):
            out[row, axis] = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z + shift[axis]


@kernel
def find_crop(
    image: Image, hull: FloatArray, min_height_px: float, crop: IntArray
) -> float:
    """Part of the image that holds a body, a pixel larger than its hull (camera frame).

    Writes x_min, y_min, x_max, y_max to `crop`: zeros where the body is outside the field of view
    or the part is not `min_height_px` high, the whole image where it reaches behind the lens. Gives
    the share of the body's box that the image's edges do not cut off: 0 where it reaches behind.
    """
    for side in range(4):
        crop[side] = 0
    n = len(hull)
    half_width, half_height = 0.5 * image.width_px, 0.5 * image.height_px
    n_left, n_right, n_above, n_below, n_behind = 0, 0, 0, 0, 0
    nearest = np.inf
    for row in range(n):
        # The planes through the lens and the image's edges: they also hold behind the lens.
        across, down, depth = hull[row, 0], hull[row, 1], hull[row, 2]
        n_left += -image.focal_px * across > half_width * depth
        n_right += image.focal_px * across > half_width * depth
        n_above += -image.focal_px * down > half_height * depth
        n_below += image.focal_px * down > half_height * depth
        n_behind += depth <= 0.0
        nearest = min(nearest, depth)
    is_outside = n_left == n or n_right == n or n_above == n or n_below == n or n_behind == n
    if nearest <= _MIN_DEPTH_M:
        if not is_outside and image.height_px >= min_height_px:
            crop[2], crop[3] = image.width_px, image.height_px
        return 0.0
    x_min, x_max, y_min, y_max = np.inf, -np.inf, np.inf, -np.inf
    for row in range(n):
        scale = image.focal_px / hull[row, 2]
        x, y = half_width + scale * hull[row, 0], half_height + scale * hull[row, 1]
        x_min, x_max = min(x_min, x), max(x_max, x)
        y_min, y_max = min(y_min, y), max(y_max, y)
    left, right = max(x_min, 0.0), min(x_max, float(image.width_px))
    top, bottom = max(y_min, 0.0), min(y_max, float(image.height_px))
    inside = max(right - left, 0.0) / max(x_max - x_min, 1.0e-9)
    inside *= max(bottom - top, 0.0) / max(y_max - y_min, 1.0e-9)
    if not is_outside:
        low_x, high_x = max(np.floor(x_min) - 1.0, 0.0), min(np.ceil(x_max) + 1.0, image.width_px)
        low_y, high_y = max(np.floor(y_min) - 1.0, 0.0), min(np.ceil(y_max) + 1.0, image.height_px)
        if low_x < high_x and low_y < high_y and high_y - low_y >= min_height_px:
            crop[0], crop[1], crop[2], crop[3] = int(low_x), int(low_y), int(high_x), int(high_y)
    return inside


# ---------- triangles


@kernel
def _find_span(
    image: Image, least_depth: float, corners: FloatArray, box: IntArray, span: IntArray
) -> bool:
    """Columns and rows of a box in which a triangle can cover pixel centres; whether any."""
    half_width, half_height = 0.5 * image.width_px, 0.5 * image.height_px
    x_min, x_max, y_min, y_max = np.inf, -np.inf, np.inf, -np.inf
    for side in range(3):
        x, y, depth = corners[side, 0], corners[side, 1], corners[side, 2]
        other = (side + 1) % 3
        if depth >= least_depth:
            scale = image.focal_px / depth
            x_min, x_max = min(x_min, scale * x), max(x_max, scale * x)
            y_min, y_max = min(y_min, scale * y), max(y_max, scale * y)
        if (depth >= least_depth) != (corners[other, 2] >= least_depth):
            part = (least_depth - depth) / (corners[other, 2] - depth)
            scale = image.focal_px / least_depth
            x += part * (corners[other, 0] - x)
            y += part * (corners[other, 1] - y)
            x_min, x_max = min(x_min, scale * x), max(x_max, scale * x)
            y_min, y_max = min(y_min, scale * y), max(y_max, scale * y)
    return _set_span(
        x_min + half_width, y_min + half_height, x_max + half_width, y_max + half_height, box, span
    )


@kernel
def _set_span(
    x_min: float, y_min: float, x_max: float, y_max: float, box: IntArray, span: IntArray
) -> bool:
    """Pixels of a box whose centres lie within bounds; whether there are any."""
    left, right = max(x_min - _PAST_CENTRE_PX, box[0]), min(x_max + _PAST_CENTRE_PX, box[2])
    top, bottom = max(y_min - _PAST_CENTRE_PX, box[1]), min(y_max + _PAST_CENTRE_PX, box[3])
    if not (left < right and top < bottom):
        return False
    span[0], span[2] = int(np.ceil(left)), int(np.floor(right))
    span[1], span[3] = int(np.ceil(top)), int(np.floor(bottom))
    return bool(span[0] < span[2] and span[1] < span[3])


@kernel
def _set_edges(corners: FloatArray, edges: FloatArray) -> float:
    """Normals of the planes through the lens and the edges, (3, 3); gives a . (b x c).

    Both have the same sign: a direction that the triangle covers ahead of the lens is on the
    positive side of all three planes.
    """
    for side in range(3):
        p, q = (side + 1) % 3, (side + 2) % 3
        edges[side, 0] = corners[p, 1] * corners[q, 2] - corners[p, 2] * corners[q, 1]
        edges[side, 1] = corners[p, 2] * corners[q, 0] - corners[p, 0] * corners[q, 2]
        edges[side, 2] = corners[p, 0] * corners[q, 1] - corners[p, 1] * corners[q, 0]
    volume = 0.0
    for axis in range(3):
        volume += corners[0, axis] * edges[0, axis]
    sign = 1.0 if volume > 0.0 else -1.0
    for side in range(3):
        for axis in range(3):
            edges[side, axis] *= sign
    return sign * volume


@kernel
def _depth_at(image: Image, edges: FloatArray, volume: float, column: int, row: int) -> float:
    """Depth of a triangle in a pixel; infinite where it does not cover it, or is too near."""
    across = (column + 0.5 - 0.5 * image.width_px) / image.focal_px
    down = (row + 0.5 - 0.5 * image.height_px) / image.focal_px
    total = 0.0
    for side in range(3):
        value = edges[side, 0] * across + edges[side, 1] * down + edges[side, 2]
        if not value >= 0.0:
            return np.inf
        total += value
    if total == 0.0:
        return np.inf
    depth: float = volume / total
    if depth * np.sqrt(1.0 + across * across + down * down) < image.near_m:
        return np.inf
    return depth


@kernel
def _passes_by(
    image: Image, edges: FloatArray, volume: float, box: IntArray, farthest_m: float
) -> bool:
    """Whether a plane through a triangle, or through its edge and the lens, keeps off a beam."""
    n_before = 0
    outside = 0
    for corner in range(4):
        across = (box[2 * (corner % 2)] - 0.5 * image.width_px) / image.focal_px
        down = (box[1 + 2 * (corner // 2)] - 0.5 * image.height_px) / image.focal_px
        total = 0.0
        for side in range(3):
            value = edges[side, 0] * across + edges[side, 1] * down + edges[side, 2]
            total += value
            if value < 0.0:
                outside += 1 << (4 * side)  # counted in four bits each
        n_before += total * farthest_m < volume
    if n_before == 4:
        return True
    return outside & 15 == 4 or (outside >> 4) & 15 == 4 or outside >> 8 == 4


# ---------- the VRU


@kernel
def _project(image: Image, points: FloatArray, least_depth: float, pixels: FloatArray) -> bool:
    """Columns and rows of points (camera frame); whether all are ahead, otherwise unfinished."""
    for row in range(len(points)):
        if points[row, 2] < least_depth:
            return False
        scale = image.focal_px / points[row, 2]
        pixels[row, 0] = 0.5 * image.width_px + scale * points[row, 0]
        pixels[row, 1] = 0.5 * image.height_px + scale * points[row, 1]
    return True


@kernel
def _draw(
    image: Image,
    points: FloatArray,
    triangles: IntArray,
    window: IntArray,
    box: IntArray,
    depth_m: FloatArray,
) -> None:
    """Draw a body's `points` (camera frame) and `triangles` in a window of the image.

    With depths in the pixels of the window, row by row, they become those of the body where it is
    nearer. Without (an empty array), `box` becomes the box around the pixels that the body covers,
    zeros if there are none; then a triangle that cannot make the box larger is not drawn: few are,
    in an order without order.
    """
    is_outline = len(depth_m) == 0
    least_depth = _least_depth(image, window)
    pixels = np.empty((len(points), 2))
    is_ahead = _project(image, points, least_depth, pixels)
    width = window[2] - window[0]
    span = np.empty(4, dtype=np.int64)
    corners, edges = np.empty((3, 3)), np.empty((3, 3))
    x_low, y_low, x_high, y_high = image.width_px, image.height_px, 0, 0
    # What lies within these bounds lies in the box already.
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for row in range(len(triangles)):
        i, j, k = triangles[row, 0], triangles[row, 1], triangles[row, 2]
        if is_ahead:
            x_min = min(min(pixels[i, 0], pixels[j, 0]), pixels[k, 0])
            x_max = max(max(pixels[i, 0], pixels[j, 0]), pixels[k, 0])
            y_min = min(min(pixels[i, 1], pixels[j, 1]), pixels[k, 1])
            y_max = max(max(pixels[i, 1], pixels[j, 1]), pixels[k, 1])
            if x_min > left and x_max < right and y_min > top and y_max < bottom:
                continue
            if not _set_span(x_min, y_min, x_max, y_max, window, span):
                continue
        for axis in range(3):
            corners[0, axis] = points[i, axis]
            corners[1, axis] = points[j, axis]
            corners[2, axis] = points[k, axis]
        if not is_ahead and not _find_span(image, least_depth, corners, window, span):
            continue
        volume = _set_edges(corners, edges)
        for y in range(span[1], span[3]):
            start = (y - window[1]) * width - window[0]
            for x in range(span[0], span[2]):
                if is_outline and x_low <= x < x_high and y_low <= y < y_high:
                    continue
                depth = _depth_at(image, edges, volume, x, y)
                if not depth < np.inf:
                    continue
                if is_outline:
                    x_low, x_high = min(x_low, x), max(x_high, x + 1)
                    y_low, y_high = min(y_low, y), max(y_high, y + 1)
                else:
                    depth_m[start + x] = min(depth_m[start + x], depth)
        if is_outline and x_low < x_high:
            left = x_low - 0.5 + _SLACK_PX if x_low > window[0] else -np.inf
            right = x_high + 0.5 - _SLACK_PX if x_high < window[2] else np.inf
            top = y_low - 0.5 + _SLACK_PX if y_low > window[1] else -np.inf
            bottom = y_high + 0.5 - _SLACK_PX if y_high < window[3] else np.inf
    if is_outline:
        if x_low >= x_high:
            x_low, y_low, x_high, y_high = 0, 0, 0, 0
        box[0], box[1], box[2], box[3] = x_low, y_low, x_high, y_high


@kernel
def _measure(depth_m: FloatArray, window: IntArray, found: FloatArray, row: int) -> int:
    """Number of pixels of a window that show the VRU; the box around them becomes a row."""
    width, height = window[2] - window[0], window[3] - window[1]
    x_min, y_min, x_max, y_max = width, height, 0, 0
    n_pixels = 0
    for y in range(height):
        for x in range(width):
            if depth_m[y * width + x] < np.inf:
                n_pixels += 1
                x_min, x_max = min(x_min, x), max(x_max, x + 1)
                y_min, y_max = min(y_min, y), max(y_max, y + 1)
    has_any = n_pixels > 0
    found[row, 0] = window[0] + x_min if has_any else 0
    found[row, 1] = window[1] + y_min if has_any else 0
    found[row, 2] = window[0] + x_max if has_any else 0
    found[row, 3] = window[1] + y_max if has_any else 0
    return n_pixels


# ---------- what hides it


@kernel
def _set_beam(
    image: Image,
    box: IntArray,
    farthest_m: float,
    turn: FloatArray,
    shift: FloatArray,
    planes: FloatArray,
) -> None:
    """Planes of the beam through a box, in a body's frame: outside is where one is positive."""
    half_width, half_height = 0.5 * image.width_px, 0.5 * image.height_px
    normal = np.zeros((_N_PLANES, 4))  # and a constant; camera frame
    normal[0, 0], normal[0, 2] = -1.0, (box[0] - half_width) / image.focal_px
    normal[1, 0], normal[1, 2] = 1.0, (half_width - box[2]) / image.focal_px
    normal[2, 1], normal[2, 2] = -1.0, (box[1] - half_height) / image.focal_px
    normal[3, 1], normal[3, 2] = 1.0, (half_height - box[3]) / image.focal_px
    normal[4, 2], normal[4, 3] = 1.0, -farthest_m
    normal[5, 2], normal[5, 3] = -1.0, _least_depth(image, box)
    for plane in range(_N_PLANES):
        constant = normal[plane, 3]
        for axis in range(3):
            planes[plane, axis] = 0.0
            for side in range(3):
                planes[plane, axis] += normal[plane, side] * turn[side, axis]
            constant += normal[plane, axis] * shift[axis]
        planes[plane, 3] = constant


@kernel
def _is_outside(
    planes: FloatArray, low_m: float, high_m: float, low: FloatArray, high: FloatArray, node: int
) -> bool:
    """Whether a node's box lies outside of one of the planes, or of the heights of a beam."""
    if high[node, 2] <= low_m or low[node, 2] >= high_m:
        return True
    for plane in range(_N_PLANES):
        value = planes[plane, 3]
        for axis in range(3):
            normal = planes[plane, axis]
            value += normal * (low[node, axis] if normal > 0.0 else high[node, axis])
        if value > 0.0:
            return True
    return False


@kernel
def hide(
    image: Image,
    tree: Tree,
    turn: FloatArray,
    shift: FloatArray,
    box: IntArray,
    farthest_m: float,
    low_m: float,
    high_m: float,
    depth_m: FloatArray,
) -> int:
    """Number of a body's triangles that may reach into the beam through a box.

    With depths in the pixels of the box, those of pixels that the body hides become infinite;
    without (an empty array), it stops at the first triangle. The beam ends at `farthest_m` [m of
    depth] and between two heights, in the body's frame.
    """
    if len(tree.second) == 0:
        return 0
    planes = np.empty((_N_PLANES, 4))
    _set_beam(image, box, farthest_m, turn, shift, planes)
    least_depth = _least_depth(image, box)
    n_reaching = 0
    width = box[2] - box[0]
    waiting = np.empty(MAX_OPEN, dtype=np.int64)
    corners, edges = np.empty((3, 3)), np.empty((3, 3))
    span = np.empty(4, dtype=np.int64)
    waiting[0] = 0
    n_waiting = 1
    while n_waiting:
        n_waiting -= 1
        node = waiting[n_waiting]
        if _is_outside(planes, low_m, high_m, tree.low_m, tree.high_m, node):
            continue
        if tree.second[node] >= 0:
            waiting[n_waiting], waiting[n_waiting + 1] = tree.second[node], node + 1
            n_waiting += 2
            continue
        for row in range(tree.start[node], tree.end[node]):
            _to_camera(turn, shift, tree.corners_m[row], corners)
            if not _find_span(image, least_depth, corners, box, span):
                continue
            volume = _set_edges(corners, edges)
            if volume == 0.0 or _passes_by(image, edges, volume, box, farthest_m):
                continue
            n_reaching += 1
            if len(depth_m) == 0:
                return n_reaching
            for y in range(span[1], span[3]):
                start = (y - box[1]) * width - box[0]
                for x in range(span[0], span[2]):
                    if depth_m[start + x] < np.inf:
                        if _depth_at(image, edges, volume, x, y) <= depth_m[start + x]:
                            depth_m[start + x] = np.inf
    return n_reaching


# ---------- many sights


@kernel
def see(
    image: Image,
    min_height_px: float,
    vertices_m: FloatArray,
    triangles: IntArray,
    hull_m: FloatArray,
    standing: Tree,
    parked: Tree,
    vut: Tree,
    sights: Sights,
    seen: Seen,
) -> None:
    """Fill `seen`, which is blank: boxes and shares of one VRU's body in one static world.

    The VRU's `vertices_m`, `triangles` and `hull_m` are in its body frame; what may hide it are the
    `standing` scene, what is `parked` in it, and the `vut`. Where the VRU's part of the image is
    not `min_height_px` high, boxes are zeros.
    """
    crop, box = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    hull, points = np.empty((len(hull_m), 3)), np.empty((len(vertices_m), 3))
    nothing = np.empty(0)
    depth_m, left_m = nothing, nothing  # in the pixels of the box; infinite where it is not seen
    low_m, high_m = image.up_m, image.up_m
    for row in range(len(hull_m)):
        low_m, high_m = min(low_m, hull_m[row, 2]), max(high_m, hull_m[row, 2])
    low_m += _TOUCH_M
    has_vut = len(sights.vut.shift) > 0
    for sight in range(len(sights.vru.shift)):
        turn, shift = sights.vru.turn[sight], sights.vru.shift[sight]
        _to_camera(turn, shift, hull_m, hull)
        seen.inside_share[sight] = find_crop(image, hull, min_height_px, crop)
        if crop[2] == 0:
            continue
        _to_camera(turn, shift, vertices_m, points)
        _draw(image, points, triangles, crop, box, nothing)
        if box[2] == 0:
            continue
        for side in range(4):
            seen.amodal_px[sight, side] = box[side]
            seen.visible_px[sight, side] = box[side]
        farthest_m = 0.0
        for row in range(len(hull)):
            farthest_m = max(farthest_m, hull[row, 2])
        area = (box[2] - box[0]) * (box[3] - box[1])
        if len(depth_m) < area:
            depth_m, left_m = np.empty(area), np.empty(area)
        n_pixels, n_left = 0, -1  # not counted: the VRU's, and those that nothing static hides
        at, there = sights.static.turn[sight], sights.static.shift[sight]
        for tree in (standing, parked):
            if hide(image, tree, at, there, box, farthest_m, low_m, high_m, nothing) == 0:
                continue
            if n_pixels == 0:
                n_pixels = _draw_all(image, points, triangles, box, depth_m[:area])
            hide(image, tree, at, there, box, farthest_m, low_m, high_m, depth_m[:area])
            n_left = _measure(depth_m, box, seen.visible_px, sight)
            seen.visible_share[sight] = n_left / n_pixels
        if not has_vut:
            continue
        for frame in range(sights.frame_start[sight], sights.frame_start[sight + 1]):
            for side in range(4):
                seen.frame_visible_px[frame, side] = seen.visible_px[sight, side]
            seen.frame_visible_share[frame] = seen.visible_share[sight]
            at, there = sights.vut.turn[frame], sights.vut.shift[frame]
            if n_left == 0 or (
                hide(image, vut, at, there, box, farthest_m, low_m, high_m, nothing) == 0
            ):
                continue
            if n_pixels == 0:
                n_pixels = _draw_all(image, points, triangles, box, depth_m[:area])
            for pixel in range(area):
                left_m[pixel] = depth_m[pixel]
            hide(image, vut, at, there, box, farthest_m, low_m, high_m, left_m[:area])
            n_seen = _measure(left_m, box, seen.frame_visible_px, frame)
            seen.frame_visible_share[frame] = n_seen / n_pixels


@kernel
def _draw_all(
    image: Image, points: FloatArray, triangles: IntArray, box: IntArray, depth_m: FloatArray
) -> int:
    """Depths of the whole VRU in the pixels of its box; gives the number of pixels."""
    for pixel in range(len(depth_m)):
        depth_m[pixel] = np.inf
    _draw(image, points, triangles, box, box, depth_m)
    n_pixels = 0
    for pixel in range(len(depth_m)):
        n_pixels += depth_m[pixel] < np.inf
    return n_pixels
