"""Loops that write rays: from an eye to points of bodies, and in the frame of what they meet."""

import numpy as np

from geometry.kernels import kernel

from .shadow_kernels import Array, misses


@kernel
def shorten(
    eye: tuple[np.float32, np.float32, np.float32],
    way: tuple[np.float32, np.float32, np.float32],
    near: np.float32,
    cut: np.float32,
    start: Array,
    vector: Array,
) -> None:
    """The ray along the way from the eye to a point: it starts `near` and is `cut` shorter."""
    x, y, z = way
    one = np.float32(1.0)
    per_length = one / np.sqrt(x * x + y * y + z * z)
    begin, share = near * per_length, one - cut * per_length
    start[0], start[1], start[2] = x * begin + eye[0], y * begin + eye[1], z * begin + eye[2]
    vector[0], vector[1], vector[2] = x * share, y * share, z * share


@kernel
def fill_rays(
    points: Array,
    views: Array,
    asked: Array,
    eye: Array,
    near_m: float,
    off_surface_m: float,
    starts: Array,
    vectors: Array,
) -> None:
    """Rays from the eye to the points asked for (n, n_points), row by row, in single precision.

    They start `near_m` from the eye and end `off_surface_m` before the point.
    """
    near, cut = np.float32(near_m), np.float32(near_m + off_surface_m)
    ex, ey, ez = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2])
    ray = 0
    for row in range(len(views)):
        view = views[row]
        for point in range(points.shape[2]):
            if not asked[row, point]:
                continue
            x = points[view, 0, point] - ex
            y = points[view, 1, point] - ey
            z = points[view, 2, point] - ez
            shorten((ex, ey, ez), (x, y, z), near, cut, starts[ray], vectors[ray])
            ray += 1


@kernel
def find_rays_at_boxes(
    starts: Array,
    vectors: Array,
    position: Array,
    rotation: Array,
    low: Array,
    high: Array,
    end: float,
    pairs: Array,
) -> int:
    """Pairs (ray, box) of rays that meet one of some boxes, in the order of rays; their number.

    Boxes are as for :func:`.shadow_kernels.find_points_behind`. Rays, (n, 3) each, end at `end`
    times their vector.
    """
    n_pairs = 0
    for ray in range(len(starts)):
        for box in range(len(position)):
            px, py, pz = position[box]
            r = rotation[box]
            wx, wy, wz = starts[ray, 0] - px, starts[ray, 1] - py, starts[ray, 2] - pz
            vx = np.float64(vectors[ray, 0])
            vy = np.float64(vectors[ray, 1])
            vz = np.float64(vectors[ray, 2])
            first, last = 0.0, end
            for axis in range(3):
                origin = r[0, axis] * wx + r[1, axis] * wy + r[2, axis] * wz
                way = r[0, axis] * vx + r[1, axis] * vy + r[2, axis] * vz
                if abs(way) < 1.0e-9:
                    if origin < low[box, axis] or origin > high[box, axis]:
                        last = -1.0
                        break
                    continue
                enter, leave = (low[box, axis] - origin) / way, (high[box, axis] - origin) / way
                first, last = max(first, min(enter, leave)), min(last, max(enter, leave))
                if first > last:
                    break
            if first <= last:
                pairs[n_pairs, 0], pairs[n_pairs, 1] = ray, box
                n_pairs += 1
    return n_pairs


@kernel
def find_rays_at_body(
    points: Array,
    views: Array,
    hidden: Array,
    eye: Array,
    position: Array,
    cosine: Array,
    sine: Array,
    lowest: Array,
    highest: Array,
    near_m: float,
    off_surface_m: float,
    starts: Array,
    vectors: Array,
    asked: Array,
) -> int:
    """Rays to points of some views that meet the box around a body, in the body's frame.

    Row n asks for the points of view `views[n]` that are not `hidden[n]`, while the body is at
    `position[n]` (3,) with its heading's `cosine[n]` and `sine[n]`; its box reaches from `lowest`
    (3,) to `highest` (3,). Sets `asked` (n, n_points) and returns the number of rays; `starts` and
    `vectors` have room for all points of all rows.
    """
    near, cut = np.float32(near_m), np.float32(near_m + off_surface_m)
    least, most = (lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2])
    ray = 0
    for row in range(len(views)):
        view = views[row]
        c, s = cosine[row], sine[row]
        px, py, pz = position[row, 0], position[row, 1], position[row, 2]
        wx, wy = eye[0] - px, eye[1] - py
        ex, ey, ez = wx * c + wy * s, wy * c - wx * s, eye[2] - pz
        for point in range(points.shape[2]):
            if hidden[row, point]:
                continue
            wx, wy = points[view, 0, point] - px, points[view, 1, point] - py
            x, y = wx * c + wy * s, wy * c - wx * s
            z = points[view, 2, point] - pz
            if misses(ex, ey, ez, x, y, z, least, most):
                continue
            asked[row, point] = True
            ox, oy, oz = np.float32(ex), np.float32(ey), np.float32(ez)
            vx, vy, vz = np.float32(x) - ox, np.float32(y) - oy, np.float32(z) - oz
            shorten((ox, oy, oz), (vx, vy, vz), near, cut, starts[ray], vectors[ray])
            ray += 1
    return ray
