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
def find_bodies_between(
    middle: Array,
    radius: Array,
    eye: Array,
    views: Array,
    obstruction: Array,
    bodies: Array,
    first: Array,
    position: Array,
    rotation: Array,
    boxes: Array,
    pairs: Array,
) -> int:
    """Pairs (row, body) of views and bodies that may hide something of them; their number.

    Row n is view `views[n]`, of points around `middle` (n_views, 3) as far as `radius` (n_views,);
    in it stand the bodies from `first[g]` to `first[g + 1]` of `bodies`, g being `obstruction[n]`:
    each at its `position` (n_bodies, 3), turned by its `rotation` (n_bodies, 3, 3), within its
    `boxes` (n_bodies, 2, 3) in its own frame. The way to the middle passes by all others farther
    than any way to a point is from it.
    """
    n_pairs = 0
    centre, reach, eyes = np.empty_like(position), np.empty(len(boxes)), np.empty_like(position)
    for body in range(len(boxes)):
        low, high, r, reach2 = boxes[body, 0], boxes[body, 1], rotation[body], 0.0
        for i in range(3):
            centre[body, i], eyes[body, i] = position[body, i], 0.0
            reach2 += 0.25 * (high[i] - low[i]) ** 2
            for j in range(3):
                centre[body, i] += 0.5 * r[i, j] * (low[j] + high[j])
                eyes[body, i] += r[j, i] * (eye[j] - position[body, j])
        reach[body] = np.sqrt(reach2)
    for row in range(len(views)):
        view, group = views[row], obstruction[row]
        mx, my, mz = middle[view, 0] - eye[0], middle[view, 1] - eye[1], middle[view, 2] - eye[2]
        length2 = max(mx * mx + my * my + mz * mz, 1.0e-12)
        for place in range(first[group], first[group + 1]):
            body = bodies[place]
            cx, cy, cz = (
                centre[body, 0] - eye[0],
                centre[body, 1] - eye[1],
                centre[body, 2] - eye[2],
            )
            share = min(max((cx * mx + cy * my + cz * mz) / length2, 0.0), 1.0)
            away2 = (cx - share * mx) ** 2 + (cy - share * my) ** 2 + (cz - share * mz) ** 2
            if away2 > (reach[body] + radius[view]) ** 2:
                continue
            r, low, high, wide = rotation[body], boxes[body, 0], boxes[body, 1], radius[view]
            ex, ey, ez = eyes[body, 0], eyes[body, 1], eyes[body, 2]
            if misses(
                *(ex, ey, ez),
                ex + r[0, 0] * mx + r[1, 0] * my + r[2, 0] * mz,
                ey + r[0, 1] * mx + r[1, 1] * my + r[2, 1] * mz,
                ez + r[0, 2] * mx + r[1, 2] * my + r[2, 2] * mz,
                (low[0] - wide, low[1] - wide, low[2] - wide),
                (high[0] + wide, high[1] + wide, high[2] + wide),
            ):
                continue
            pairs[n_pairs, 0], pairs[n_pairs, 1] = row, body
            n_pairs += 1
    return n_pairs


@kernel
def find_rays_at_body(
    points: Array,
    views: Array,
    hidden: Array,
    eye: Array,
    position: Array,
    rotation: Array,
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
    `position[n]` (3,), turned by `rotation[n]` (3, 3); its box reaches from `lowest` (3,) to
    `highest` (3,) in its own frame. Sets `asked` (n, n_points) and returns the number of rays;
    `starts` and `vectors` have room for all points of all rows.
    """
    near, cut = np.float32(near_m), np.float32(near_m + off_surface_m)
    least, most = (lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2])
    ray = 0
    for row in range(len(views)):
        view = views[row]
        r = rotation[row]
        px, py, pz = position[row, 0], position[row, 1], position[row, 2]
        wx, wy, wz = eye[0] - px, eye[1] - py, eye[2] - pz
        ex = r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz
        ey = r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz
        ez = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz
        for point in range(points.shape[2]):
            if hidden[row, point]:
                continue
            wx, wy = points[view, 0, point] - px, points[view, 1, point] - py
            wz = points[view, 2, point] - pz
            x = r[0, 0] * wx + r[1, 0] * wy + r[2, 0] * wz
            y = r[0, 1] * wx + r[1, 1] * wy + r[2, 1] * wz
            z = r[0, 2] * wx + r[1, 2] * wy + r[2, 2] * wz
            if misses(ex, ey, ez, x, y, z, least, most):
                continue
            asked[row, point] = True
            ox, oy, oz = np.float32(ex), np.float32(ey), np.float32(ez)
            vx, vy, vz = np.float32(x) - ox, np.float32(y) - oy, np.float32(z) - oz
            shorten((ox, oy, oz), (vx, vy, vz), near, cut, starts[ray], vectors[ray])
            ray += 1
    return ray
