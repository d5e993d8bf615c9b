"""Numba kernels: rays from an eye to points of bodies, and which bodies they may meet."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]
Point = tuple[float, float, float]


@kernel
def misses(eye: Point, target: Point, low: Point, high: Point) -> bool:
    """True if the way from one place to another passes a box along the axes."""
    first, last = 0.0, 1.0
    for axis in range(3):
        origin, least, most = eye[axis], low[axis], high[axis]
        way = target[axis] - origin
        if abs(way) < 1.0e-9:
            if origin < least or origin > most:
                return True
            continue
        enter, leave = (least - origin) / way, (most - origin) / way
        if enter > leave:
            enter, leave = leave, enter
        first, last = max(first, enter), min(last, leave)
    return first > last


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
    eye: Array,
    near_m: float,
    off_surface_m: float,
    starts: Array,
    vectors: Array,
) -> None:
    """Rays from the eye to all points of some views, row by row, in single precision.

    `points` (n_views, 3, n_points), `views` (n,). They start `near_m` from the eye and end
    `off_surface_m` before the point.
    """
    near, cut = np.float32(near_m), np.float32(near_m + off_surface_m)
    ex, ey, ez = np.float32(eye[0]), np.float32(eye[1]), np.float32(eye[2])
    ray = 0
    for row in range(len(views)):  # views, and the points of each
        view = views[row]
        for point in range(points.shape[2]):
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
    each at its `position` (n_bodies, 3), with its `rotation` (n_bodies, 3, 3), within its
    `boxes` (n_bodies, 2, 3) in its own frame. The way to the middle passes all others at a
    greater distance than any way to a point has from it.
    """
    n_pairs = 0
    centre, reach, eyes = np.empty_like(position), np.empty(len(boxes)), np.empty_like(position)
    for body in range(len(boxes)):  # each body's middle, its reach, and the eye in its frame
        low, high, r, reach2 = boxes[body, 0], boxes[body, 1], rotation[body], 0.0
        for i in range(3):
            centre[body, i], eyes[body, i] = position[body, i], 0.0
            reach2 += 0.25 * (high[i] - low[i]) ** 2
            for j in range(3):
                centre[body, i] += 0.5 * r[i, j] * (low[j] + high[j])
                eyes[body, i] += r[j, i] * (eye[j] - position[body, j])
        reach[body] = np.sqrt(reach2)
    for row in range(len(views)):  # views, and the bodies of the group of each
        view, group = views[row], obstruction[row]
        mx, my, mz = middle[view, 0] - eye[0], middle[view, 1] - eye[1], middle[view, 2] - eye[2]
        length2 = max(mx * mx + my * my + mz * mz, 1.0e-12)
        for place in range(first[group], first[group + 1]):
            body = bodies[place]
            cx, cy = centre[body, 0] - eye[0], centre[body, 1] - eye[1]
            cz = centre[body, 2] - eye[2]
            share = min(max((cx * mx + cy * my + cz * mz) / length2, 0.0), 1.0)
            away2 = (cx - share * mx) ** 2 + (cy - share * my) ** 2 + (cz - share * mz) ** 2
            if away2 > (reach[body] + radius[view]) ** 2:
                continue
            r, low, high, wide = rotation[body], boxes[body, 0], boxes[body, 1], radius[view]
            ex, ey, ez = eyes[body, 0], eyes[body, 1], eyes[body, 2]
            target = (
                ex + r[0, 0] * mx + r[1, 0] * my + r[2, 0] * mz,
                ey + r[0, 1] * mx + r[1, 1] * my + r[2, 1] * mz,
                ez + r[0, 2] * mx + r[1, 2] * my + r[2, 2] * mz,
            )
            least = (low[0] - wide, low[1] - wide, low[2] - wide)
            most = (high[0] + wide, high[1] + wide, high[2] + wide)
            if misses((ex, ey, ez), target, least, most):
                continue
            pairs[n_pairs, 0], pairs[n_pairs, 1] = row, body
            n_pairs += 1
    return n_pairs


@kernel
def _into_body(rotation: Array, x: float, y: float, z: float) -> Point:
    """A way in the world's axes, in a body's."""
    r = rotation
    return (
        r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
        r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
        r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
    )


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
    `position[n]` (3,), with `rotation[n]` (3, 3); its box reaches from `lowest` (3,) to
    `highest` (3,) in its own frame. Sets `asked` (n, n_points) and returns the number of rays;
    `starts` and `vectors` have room for all points of all rows.
    """
    near, cut = np.float32(near_m), np.float32(near_m + off_surface_m)
    least, most = (lowest[0], lowest[1], lowest[2]), (highest[0], highest[1], highest[2])
    ray = 0
    for row in range(len(views)):  # views with a body each; the eye goes into the body's frame
        view = views[row]
        r = rotation[row]
        px, py, pz = position[row, 0], position[row, 1], position[row, 2]
        origin = _into_body(r, eye[0] - px, eye[1] - py, eye[2] - pz)
        start = np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2])
        for point in range(points.shape[2]):  # points that nothing hides yet
            if hidden[row, point]:
                continue
            x, y, z = points[view, 0, point], points[view, 1, point], points[view, 2, point]
            target = _into_body(r, x - px, y - py, z - pz)
            if misses(origin, target, least, most):
                continue
            asked[row, point] = True
            vx, vy = np.float32(target[0]) - start[0], np.float32(target[1]) - start[1]
            way = (vx, vy, np.float32(target[2]) - start[2])
            shorten(start, way, near, cut, starts[ray], vectors[ray])
            ray += 1
    return ray
