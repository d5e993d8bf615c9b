"""Loops that spare rays: which points of a body anything may stand in front of, seen from a mount.

All directions from the eye are sorted into cells: azimuth by the diamond angle, elevation by its
sine, so that no trigonometric function is needed. Each cell knows how near the nearest thing in it
may be. Triangles are cut into pieces of some degrees, and each piece counts in all cells between
its least and greatest azimuth and elevation: a cell never knows too little, and where it knows
nothing nearer than a point, the ray to that point would meet nothing. Where one triangle fills a
whole cell, its ray to any point behind would meet that triangle.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.kernels import kernel

Array = NDArray[Any]

N_AROUND = 1024  # cells of azimuth
N_UP = 512  # cells of elevation
_PIECE_SIN = 0.04  # sine of the angle within which a piece lies around its middle
_SMALLEST_M = 0.005  # pieces are not cut any smaller
_SLACK_M = 1.0e-3  # for rays in single precision
_SLACK_SIN = 1.0e-5
_MOST_CUTS = 64
_BLOCK = 8  # cells along either side of a block whose nearest thing is looked at first
_FLATTEST = 0.01  # sine between a triangle and the directions that it surely stops
_BEHIND_M = 0.01  # what is farther behind a triangle than this is surely behind it


@kernel
def _diamond(x: float, y: float) -> float:
    """Azimuth as a number from 0 to 4 that grows with the angle."""
    size = abs(x) + abs(y)
    if size == 0.0:
        return 0.0
    share = y / size
    if x < 0.0:
        return 2.0 - share
    return share if share >= 0.0 else 4.0 + share


@kernel
def cell_around(x: float, y: float, n_around: int) -> int:
    """Column of cells of an azimuth."""
    return min(int(_diamond(x, y) * (0.25 * n_around)), n_around - 1)


@kernel
def cell_up(sine: float, n_up: int) -> int:
    """Row of cells of an elevation."""
    return max(0, min(int((sine + 1.0) * (0.5 * n_up)), n_up - 1))


@kernel
def _window(
    x: float, y: float, z: float, radius: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Cells that a sphere touches, the eye outside of it: rows, columns; the end may be > N."""
    n_up, n_around = shape
    level = np.sqrt(x * x + y * y)
    distance = np.sqrt(x * x + y * y + z * z)
    sine = radius / distance
    cosine = np.sqrt(max(0.0, 1.0 - sine * sine))
    up, flat = z / distance, level / distance
    low, high = up * cosine - flat * sine, up * cosine + flat * sine
    if level <= radius:  # straight above or below: all azimuths
        if z < 0.0:
            low = -1.0
        else:
            high = 1.0
        return cell_up(low, n_up), cell_up(high, n_up), 0, n_around - 1
    turn = radius / level
    keep = np.sqrt(1.0 - turn * turn)
    first = cell_around(x * keep + y * turn, y * keep - x * turn, n_around)
    last = cell_around(x * keep - y * turn, y * keep + x * turn, n_around)
    if last < first:
        last += n_around
    return cell_up(low, n_up), cell_up(high, n_up), first, last


@kernel
def _piece_window(
    corners: Any, x: float, y: float, sine: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Cells that a triangle touches, as `_window`: `sine` is that of its half angle at least.

    Azimuth on a triangle is between those of its corners. Of a point p = sum of shares t of the
    corners c, height / |p| is at most the greatest such ratio of a corner times sum t |c| / |p|,
    which is 1 .. 1 / cos(the triangle's angle); and at least the least one likewise.
    """
    middle = _diamond(x, y)
    left = right = 0.0
    bottom, top = 1.0, -1.0
    for cx, cy, cz in corners:
        turn = _diamond(cx, cy) - middle
        if turn > 2.0:
            turn -= 4.0
        elif turn < -2.0:
            turn += 4.0
        left, right = min(left, turn), max(right, turn)
        ratio = cz / np.sqrt(cx * cx + cy * cy + cz * cz)
        bottom, top = min(bottom, ratio), max(top, ratio)
    bulge = 1.0 / (1.0 - 2.0 * sine * sine)
    bottom = bottom * bulge if bottom < 0.0 else bottom
    top = top * bulge if top > 0.0 else top
    distance = np.sqrt(x * x + y * y)
    slack = _SLACK_M / distance + _SLACK_SIN
    n_up, n_around = shape
    first = int(np.floor((middle + left - slack) * (0.25 * n_around)))
    last = int(np.floor((middle + right + slack) * (0.25 * n_around)))
    if first < 0:
        first, last = first + n_around, last + n_around
    return cell_up(bottom - slack, n_up), cell_up(top + slack, n_up), first, last


@kernel
def mark_nearest(
    nearest: Array,
    triangles: Array,
    eye: Array,
    near_m: float,
    far_m: float,
    low_m: float,
    high_m: float,
) -> None:
    """Enter triangles (n, 3, 3) into cells (n_up, n_around) of distances from the eye.

    Left out is what is nearer than `near_m`, farther than `far_m`, and what no way from the eye to
    a point whose height is `low_m` .. `high_m` can meet.
    """
    floor, ceiling = min(eye[2], low_m), max(eye[2], high_m)
    shape = nearest.shape
    n_around = shape[1]
    stack = np.empty((_MOST_CUTS + 1, 9))
    for number in range(len(triangles)):
        for corner in range(3):
            for axis in range(3):
                stack[0, 3 * corner + axis] = triangles[number, corner, axis] - eye[axis]
        height = 1
        while height > 0:
            height -= 1
            ax, ay, az, bx, by, bz, cx, cy, cz = stack[height]
            if max(az, bz, cz) + eye[2] <= floor or min(az, bz, cz) + eye[2] >= ceiling:
                continue
            x, y, z = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0, (az + bz + cz) / 3.0
            radius2 = max(
                (ax - x) ** 2 + (ay - y) ** 2 + (az - z) ** 2,
                (bx - x) ** 2 + (by - y) ** 2 + (bz - z) ** 2,
                (cx - x) ** 2 + (cy - y) ** 2 + (cz - z) ** 2,
            )
            distance2 = x * x + y * y + z * z
            radius, distance = np.sqrt(radius2), np.sqrt(distance2)
            if distance + radius < near_m - _SLACK_M or distance - radius > far_m:
                continue
            is_piece = radius <= _PIECE_SIN * distance or radius <= _SMALLEST_M
            if not is_piece and height + 2 <= _MOST_CUTS:
                ab = (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
                bc = (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
                ca = (cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2
                # Turned so that the longest side leads from a to b.
                if bc >= ab and bc >= ca:
                    ax, ay, az, bx, by, bz, cx, cy, cz = bx, by, bz, cx, cy, cz, ax, ay, az
                elif ca >= ab and ca >= bc:
                    ax, ay, az, bx, by, bz, cx, cy, cz = cx, cy, cz, ax, ay, az, bx, by, bz
                mx, my, mz = 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)
                for first, (px, py, pz) in enumerate(((ax, ay, az), (bx, by, bz))):
                    part = stack[height + first]
                    part[0], part[1], part[2] = px, py, pz
                    part[3], part[4], part[5] = mx, my, mz
                    part[6], part[7], part[8] = cx, cy, cz
                height += 2
                continue
            wide = radius + _SLACK_M + _SLACK_SIN * distance
            if distance <= wide:
                nearest[:] = 0.0
                return
            least = np.float32(max(0.0, distance - wide))
            if np.sqrt(x * x + y * y) <= wide:  # straight above or below
                low, high, begin, end = _window(x, y, z, wide, shape)
            else:
                corners = ((ax, ay, az), (bx, by, bz), (cx, cy, cz))
                low, high, begin, end = _piece_window(corners, x, y, wide / distance, shape)
            for up in range(low, high + 1):
                row = nearest[up]
                for column in range(begin, min(end, n_around - 1) + 1):
                    row[column] = min(row[column], least)
                for column in range(0, end - n_around + 1):
                    row[column] = min(row[column], least)


@kernel
def _lattice() -> tuple[Array, Array]:
    """Unit vectors (2, n): (east, north) to where columns of cells begin, (level, up) for rows."""
    around, up = np.empty((2, N_AROUND + 1)), np.empty((2, N_UP + 1))
    for column in range(N_AROUND + 1):
        turn = 4.0 * column / N_AROUND
        x = 1.0 - turn if turn < 2.0 else turn - 3.0
        y = turn if turn < 1.0 else (2.0 - turn if turn < 3.0 else turn - 4.0)
        size = np.sqrt(x * x + y * y)
        around[0, column], around[1, column] = x / size, y / size
    for row in range(N_UP + 1):
        up[1, row] = 2.0 * row / N_UP - 1.0
        up[0, row] = np.sqrt(max(0.0, 1.0 - up[1, row] ** 2))
    return around, up


@kernel
def _cross(a: Any, b: Any, sign: float, normal: Array) -> None:
    """Unit normal (3,) of the plane through the eye and two points, turned by a sign."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size = sign * max(np.sqrt(x * x + y * y + z * z), 1.0e-300)
    normal[0], normal[1], normal[2] = x / size, y / size, z / size


@kernel
def _columns(a: Any, b: Any, c: Any) -> tuple[int, int]:
    """First and last column of cells that a triangle touches; all, if it is above or below."""
    ab, bc, ca = a[0] * b[1] - a[1] * b[0], b[0] * c[1] - b[1] * c[0], c[0] * a[1] - c[1] * a[0]
    if min(ab, bc, ca) >= 0.0 or max(ab, bc, ca) <= 0.0:
        return 0, N_AROUND - 1
    middle = _diamond(a[0] + b[0] + c[0], a[1] + b[1] + c[1])
    left = right = 0.0
    for corner in (a, b, c):
        turn = _diamond(corner[0], corner[1]) - middle
        if turn > 2.0:
            turn -= 4.0
        elif turn < -2.0:
            turn += 4.0
        left, right = min(left, turn), max(right, turn)
    first = int(np.floor((middle + left) * (0.25 * N_AROUND)))
    last = int(np.floor((middle + right) * (0.25 * N_AROUND)))
    return (first + N_AROUND, last + N_AROUND) if first < 0 else (first, last)


@kernel
def find_blocks(middle: Array, radius: Array, eye: Array, views: Array) -> Array:
    """Blocks of cells (N_UP / 8, N_AROUND / 8) in which points of views may be, seen from the eye.

    `views` (n,) are looked at: each lies within `radius` (n_views,) of its `middle` (n_views, 3).
    """
    blocks = np.zeros((N_UP // _BLOCK, N_AROUND // _BLOCK), dtype=np.bool_)
    for view in views:
        x, y, z = middle[view, 0] - eye[0], middle[view, 1] - eye[1], middle[view, 2] - eye[2]
        wide = radius[view] + _SLACK_M
        if np.sqrt(x * x + y * y + z * z) <= wide:  # its points may be anywhere
            blocks[:] = True
            break
        low, high, begin, end = _window(x, y, z, wide, (N_UP, N_AROUND))
        for row in range(low // _BLOCK, high // _BLOCK + 1):
            for wide_column in range(begin // _BLOCK, end // _BLOCK + 1):
                blocks[row, wide_column % (N_AROUND // _BLOCK)] = True
    return blocks


@kernel
def mark_covered(
    covered: Array,
    triangles: Array,
    eye: Array,
    near_m: float,
    low_m: float,
    high_m: float,
    is_asked: Array,
) -> None:
    """Enter triangles (n, 3, 3) that fill whole cells (N_UP, N_AROUND), by distance from the eye.

    All directions of a cell meet the triangle no farther away than it says, beyond `near_m`. The
    heights are as for :func:`mark_nearest`; of blocks of cells that are not asked for, see
    :func:`find_blocks`, nothing is said.

    On a cell, the sine between a direction and a plane through the eye is as at its four corners,
    or between, but for a bulge of an eighth of the squared angle from corner to corner.
    """
    floor, ceiling = min(eye[2], low_m), max(eye[2], high_m)
    around, up = _lattice()
    n_rows, n_columns = N_UP // _BLOCK, N_AROUND // _BLOCK
    planes, sines = np.empty((4, 3)), np.empty((4, _BLOCK + 1, _BLOCK + 1))
    farthest = np.empty((n_rows, n_columns), dtype=np.float32)
    for row in range(n_rows):
        for column in range(n_columns):  # nothing is nearer than -1 m: what nobody asks is left out
            farthest[row, column] = np.inf if is_asked[row, column] else -1.0
    for number in range(len(triangles)):
        one, two, three = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        if max(one[2], two[2], three[2]) <= floor or min(one[2], two[2], three[2]) >= ceiling:
            continue
        a = (one[0] - eye[0], one[1] - eye[1], one[2] - eye[2])
        b = (two[0] - eye[0], two[1] - eye[1], two[2] - eye[2])
        c = (three[0] - eye[0], three[1] - eye[1], three[2] - eye[2])
        u = (b[0] - a[0], b[1] - a[1], b[2] - a[2])
        v = (c[0] - a[0], c[1] - a[1], c[2] - a[2])
        size = max(
            np.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2), np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        )
        least = np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2)
        if size < 1.5 / N_AROUND * (least - size):  # smaller than half of any cell
            continue
        own = planes[3]
        _cross(u, v, 1.0, own)
        height = own[0] * a[0] + own[1] * a[1] + own[2] * a[2]
        sign = 1.0 if height > 0.0 else -1.0
        height = abs(height)
        _cross(a, b, sign, planes[0])
        _cross(b, c, sign, planes[1])
        _cross(c, a, sign, planes[2])
        _cross(u, v, sign, own)
        first, last = _columns(a, b, c)
        for row in range(n_rows):
            i, k = row * _BLOCK, (row + 1) * _BLOCK
            bulge = 1.0e-3 + 0.125 * (np.arcsin(up[1, k]) - np.arcsin(up[1, i])) ** 2
            for wide in range(first // _BLOCK, last // _BLOCK + 1):
                column = wide if wide < n_columns else wide - n_columns
                if farthest[row, column] <= height:
                    continue
                j, m = column * _BLOCK, (column + 1) * _BLOCK
                is_outside = False
                for plane in range(4):
                    x, y, z = planes[plane, 0], planes[plane, 1], planes[plane, 2]
                    left = x * around[0, j] + y * around[1, j]
                    right = x * around[0, m] + y * around[1, m]
                    most = max(left, right)
                    greatest = max(up[0, i] * most + up[1, i] * z, up[0, k] * most + up[1, k] * z)
                    if greatest + bulge < (_FLATTEST if plane == 3 else 0.0):
                        is_outside = True
                        break
                if not is_outside:
                    farthest[row, column] = _mark_block(
                        covered, i, j, planes, height, near_m, sines, around, up
                    )


@kernel
def _mark_block(
    covered: Array,
    row: int,
    column: int,
    planes: Array,
    height: float,
    near_m: float,
    sines: Array,
    around: Array,
    up: Array,
) -> Any:
    """Enter a triangle into a block of cells: three planes through the eye, and its own.

    The block begins at a row and a column; returns what is farthest in it.
    """
    farthest = np.float32(0.0)
    for plane in range(4):
        px, py, pz = planes[plane, 0], planes[plane, 1], planes[plane, 2]
        for i in range(_BLOCK + 1):
            level, z = up[0, row + i], up[1, row + i] * pz
            for j in range(_BLOCK + 1):
                sines[plane, i, j] = (
                    level * (around[0, column + j] * px + around[1, column + j] * py) + z
                )
    low, high = sines[0], sines[1]
    for i in range(_BLOCK + 1):  # the least of the three
        for j in range(_BLOCK + 1):
            least = low[i, j] if low[i, j] < high[i, j] else high[i, j]
            low[i, j] = least if least < sines[2, i, j] else sines[2, i, j]
    least_height = near_m + _SLACK_M
    for i in range(_BLOCK):
        tall = np.arcsin(up[1, row + i + 1]) - np.arcsin(up[1, row + i])
        slack = 1.2e-4 + 0.125 * tall * tall
        for j in range(_BLOCK):
            inside = min(low[i, j], low[i, j + 1], low[i + 1, j], low[i + 1, j + 1])
            one, two = sines[3, i, j], sines[3, i, j + 1]
            three, four = sines[3, i + 1, j], sines[3, i + 1, j + 1]
            flat, steep = min(one, two, three, four) - slack, max(one, two, three, four) + slack
            is_filled = (inside >= slack) & (flat >= _FLATTEST) & (height > least_height * steep)
            far = np.float32(height / flat) if is_filled else np.float32(np.inf)
            before = covered[row + i, column + j]
            nearer = far if far < before else before
            covered[row + i, column + j] = nearer
            farthest = nearer if nearer > farthest else farthest
    return farthest


@kernel
def _is_clear(nearest: Array, size: int, window: tuple[int, int, int, int], far: Any) -> bool:
    """Whether all blocks of `size` x `size` cells in a window know of nothing as near as `far`."""
    low, high, begin, end = window
    for up in range(low // size, high // size + 1):
        for around in range(begin // size, end // size + 1):
            column = around if around < N_AROUND // size else around - N_AROUND // size
            if nearest[up, column] <= far:
                return False
    return True


@kernel
def _is_covered(covered: Array, window: tuple[int, int, int, int], near: Any) -> bool:
    """Whether all cells of a window are filled nearer than `near`."""
    low, high, begin, end = window
    for up in range(low, high + 1):
        for around in range(begin, end + 1):
            if covered[up, around if around < N_AROUND else around - N_AROUND] > near:
                return False
    return True


@kernel
def find_unclear_points(
    nearest: Array,
    covered: Array,
    points: Array,
    middle: Array,
    radius: Array,
    eye: Array,
    views: Array,
    hidden: Array,
    unclear: Array,
) -> None:
    """Set `hidden` (n, n_points) where something stands before a point of a view.

    And set `unclear` (n, n_points) where something may. `points` (n_views, 3, n_points), `middle`
    (n_views, 3), `radius` (n_views,): each body's points, and a sphere around them; `views` (n,):
    which of them are asked for.
    """
    ex, ey, ez = eye[0], eye[1], eye[2]
    blocks = np.empty((N_UP // _BLOCK, N_AROUND // _BLOCK), np.float32)
    for up in range(N_UP // _BLOCK):
        for column in range(N_AROUND // _BLOCK):
            blocks[up, column] = np.inf
    for up in range(N_UP):
        for column in range(N_AROUND):
            block = blocks[up // _BLOCK, column // _BLOCK]
            blocks[up // _BLOCK, column // _BLOCK] = min(block, nearest[up, column])
    for row in range(len(views)):
        view = views[row]
        x, y, z = middle[view, 0] - ex, middle[view, 1] - ey, middle[view, 2] - ez
        distance = np.sqrt(x * x + y * y + z * z)
        wide = radius[view] + _SLACK_M
        if distance > wide:
            window = _window(x, y, z, wide, nearest.shape)
            far = np.float32(distance + wide)
            if _is_clear(blocks, _BLOCK, window, far) or _is_clear(nearest, 1, window, far):
                continue
            if _is_covered(covered, window, np.float32(distance - wide - _BEHIND_M)):
                hidden[row] = True
                continue
        for point in range(points.shape[2]):
            x = points[view, 0, point] - ex
            y = points[view, 1, point] - ey
            z = points[view, 2, point] - ez
            distance = np.sqrt(x * x + y * y + z * z)
            if distance == 0.0:
                unclear[row, point] = True
                continue
            up, column = cell_up(z / distance, N_UP), cell_around(x, y, N_AROUND)
            if covered[up, column] <= distance - _BEHIND_M:
                hidden[row, point] = True
            else:
                unclear[row, point] = nearest[up, column] <= distance


@kernel
def misses(
    ex: float,
    ey: float,
    ez: float,
    x: float,
    y: float,
    z: float,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
) -> bool:
    """Whether the way from one place to another passes by a box along the axes."""
    first, last = 0.0, 1.0
    for origin, target, least, most in (
        (ex, x, low[0], high[0]),
        (ey, y, low[1], high[1]),
        (ez, z, low[2], high[2]),
    ):
        way = target - origin
        if abs(way) < 1.0e-9:
            if origin < least or origin > most:
                return True
            continue
        enter, leave = (least - origin) / way, (most - origin) / way
        if enter > leave:
            enter, leave = leave, enter
        first, last = max(first, enter), min(last, leave)
    return first > last
