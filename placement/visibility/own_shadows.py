"""What bodies hide of themselves: most of it is behind the body, and needs no ray.

A way that enters a closed body at a point of its surface has to leave it somewhere else: from an
eye outside, that point is hidden.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel
from geometry.raycast import RayCaster

from .surfaces import Surface

Array = NDArray[Any]

_OFF_SURFACE_M = 1.0e-3  # where rays end before a point
_FAR = 4.0  # an eye is far if it is this many times as far from the origin as the body's points
_APART_M = 2.5e-3  # rays to a point of a body from such an eye end less than this before it
_ON_M = 1.0e-5  # a point is on what is nearer
_SLACK_SIN = 0.03  # between a ray and a plane, so that it is on the same side in single precision
_MOST_PLANES = 12  # around a point


def find_own_visible(
    surfaces: Sequence[Surface],
    casters: Sequence[RayCaster],
    *,
    surface_index: IntArray,
    eye_m: FloatArray,
) -> BoolArray:
    """Points that bodies do not hide of themselves, (n, n_points).

    Row n looks at `surfaces[surface_index[n]]`, for which rays are cast by the caster of the same
    number, from `eye_m` (n, 3), in the body's frame.
    """
    visible = np.zeros((len(eye_m), len(surfaces[0].points_m)), dtype=bool)
    for index in np.unique(surface_index).tolist():
        surface, rows = surfaces[index], np.flatnonzero(surface_index == index)
        points, eyes = surface.points_m.astype(np.float32), eye_m[rows]
        least_m = _FAR * float(np.linalg.norm(points, axis=1).max())
        seen = np.empty((len(rows), len(points)), dtype=bool)
        _find_outside(points, planes_around(surface), eyes, least_m, seen)
        starts, vectors = (np.empty((np.count_nonzero(seen), 3), np.float32) for _ in range(2))
        _fill_rays(points, eyes, seen, _OFF_SURFACE_M, starts, vectors)
        seen[seen] = ~casters[index].is_blocked(starts, vectors)
        visible[rows] = seen
    return visible


@cache
def planes_around(surface: Surface) -> FloatArray:
    """Outward normals (n_points, `_MOST_PLANES`, 3) of the planes that bound a body at its points.

    A way from a point that goes inward through all of them enters the body there, and leaves it no
    nearer than `_APART_M`. Zero where this cannot be said, as of meshes that are not closed.
    """
    shape = surface.actor.shapes[surface.shape_index]
    planes = np.zeros((len(surface.points_m), _MOST_PLANES, 3))
    corners = np.asarray(shape.vertices_m, dtype=np.float64)[shape.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume_m3 = (normals * corners[:, 0]).sum() / 6.0
    sides = np.stack([shape.triangles, np.roll(shape.triangles, -1, axis=1)], axis=-1)
    there = np.unique(sides.reshape(-1, 2), axis=0)
    back = np.unique(there[:, ::-1], axis=0)
    if len(there) == sides.size // 2 and np.array_equal(there, back) and volume_m3 > 0.0:
        size = np.linalg.norm(normals, axis=1)
        is_flat = size > 0.0
        normals = normals[is_flat] / size[is_flat, None]
        _find_planes(surface.points_m, corners[is_flat], normals, planes)
    return planes


@kernel
def _find_planes(points: Array, triangles: Array, normals: Array, planes: Array) -> None:
    """Set `planes` as in :func:`planes_around`, of `triangles` (m, 3, 3) with `normals` (m, 3)."""
    for point in range(len(points)):
        p = points[point]
        n_planes = n_on = 0
        for number in range(len(triangles)):
            normal, first = normals[number], triangles[number, 0]
            height = (
                normal[0] * (p[0] - first[0])
                + normal[1] * (p[1] - first[1])
                + normal[2] * (p[2] - first[2])
            )
            if abs(height) >= _APART_M:
                continue
            away = _distance_to_triangle(p, triangles[number])
            if away >= _APART_M:
                continue
            is_on = away < _ON_M
            if n_planes == _MOST_PLANES or (height >= 0.0 and not is_on):
                n_on = 0  # too many, or the way might soon leave the body
                break
            for axis in range(3):
                planes[point, n_planes, axis] = normal[axis]
            n_planes += 1
            n_on += is_on
        # What is not used says nothing new.
        for plane in range(n_planes if n_on else 0, _MOST_PLANES):
            for axis in range(3):
                planes[point, plane, axis] = planes[point, 0, axis] if n_on else 0.0


@kernel
def _distance_to_triangle(p: Array, corners: Array) -> float:
    """Distance of a point from a triangle."""
    inside = 0
    least2 = np.inf
    a, b, c = corners
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    for side in range(3):
        q, r = corners[side], corners[(side + 1) % 3]
        ex, ey, ez = r[0] - q[0], r[1] - q[1], r[2] - q[2]
        wx, wy, wz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
        # Towards the inside of the side, in the triangle's plane.
        sx, sy, sz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
        inside += 1 if sx * wx + sy * wy + sz * wz >= 0.0 else 0
        share = (wx * ex + wy * ey + wz * ez) / max(ex * ex + ey * ey + ez * ez, 1.0e-30)
        share = min(max(share, 0.0), 1.0)
        dx, dy, dz = wx - share * ex, wy - share * ey, wz - share * ez
        least2 = min(least2, dx * dx + dy * dy + dz * dz)
    if inside == 3:
        size2 = max(nx * nx + ny * ny + nz * nz, 1.0e-30)
        height = nx * (p[0] - a[0]) + ny * (p[1] - a[1]) + nz * (p[2] - a[2])
        least2 = min(least2, height * height / size2)
    return float(np.sqrt(least2))


@kernel
def _find_outside(points: Array, planes: Array, eyes: Array, least_m: float, asked: Array) -> None:
    """Unset `asked` (n, n_points) where the way to the eye surely enters the body at the point.

    Of `points` (n_points, 3) and their `planes`, seen from `eyes` (n, 3), all in the body's frame.
    Nothing is known of eyes that are nearer to the origin than `least_m`.
    """
    for row in range(len(eyes)):
        ex, ey, ez = eyes[row, 0], eyes[row, 1], eyes[row, 2]
        is_far = ex * ex + ey * ey + ez * ez >= least_m**2
        for point in range(len(points)):
            x, y, z = ex - points[point, 0], ey - points[point, 1], ez - points[point, 2]
            limit = -_SLACK_SIN * np.sqrt(x * x + y * y + z * z)
            is_behind = is_far
            for plane in planes[point]:
                if not x * plane[0] + y * plane[1] + z * plane[2] < limit:
                    is_behind = False
                    break
            asked[row, point] = not is_behind


@kernel
def _fill_rays(
    points: Array, eyes: Array, asked: Array, off_surface_m: float, starts: Array, vectors: Array
) -> None:
    """Rays to points (n_points, 3) that are asked for (n, n_points), row by row.

    From `eyes` (n, 3), all in the body's frame; they end `off_surface_m` before the point, as seen
    from the body's origin.
    """
    ray = 0
    for row in range(len(eyes)):
        x, y, z = eyes[row, 0], eyes[row, 1], eyes[row, 2]
        share = np.float32(1.0 - off_surface_m / np.sqrt(x * x + y * y + z * z))
        ex, ey, ez = np.float32(x), np.float32(y), np.float32(z)
        for point in range(asked.shape[1]):
            if not asked[row, point]:
                continue
            starts[ray, 0], starts[ray, 1], starts[ray, 2] = ex, ey, ez
            vectors[ray, 0] = (points[point, 0] - ex) * share
            vectors[ray, 1] = (points[point, 1] - ey) * share
            vectors[ray, 2] = (points[point, 2] - ez) * share
            ray += 1
