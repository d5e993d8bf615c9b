"""Numba kernels: occlusion culling, and rays from an eye to points of bodies.

All directions from the eye are sorted into cells: azimuth by the diamond angle,
elevation by its sine, so that no trigonometric function is needed. Each cell knows how
near the nearest thing in it may be. Triangles are cut into pieces of some degrees, and
each piece counts in all cells between its least and greatest azimuth and elevation: a
cell never knows too little, and where it knows nothing nearer than a point, the ray to
that point would meet nothing.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

Array = NDArray[Any]
Point = tuple[float, float, float]

# Number of cells around, by azimuth.
N_AROUND = 1024
# Number of cells up, by elevation.
N_UP = 512
# Sine of the angle within which a piece lies around its middle.
_PIECE_SIN = 0.04
# Pieces are not cut any smaller.
_SMALLEST_M = 0.005
# Allow for rays in single precision.
_SLACK_M = 1.0e-3
_SLACK_SIN = 1.0e-5
_MOST_CUTS = 64
# Cells along either side of a block whose nearest thing is looked at first.
_BLOCK = 8


class BodyViews(NamedTuple):
    """Bodies to be looked at; one view is one body at one place.

    Attributes
    ----------
    points : (n_views, 3, n_points) float32
        Points spread over each body. [m]
    middle : (n_views, 3) float
        Centre of a sphere around the points. [m]
    radius : (n_views,) float
        Radius of that sphere. [m]
    """

    points: Array
    middle: FloatArray
    radius: FloatArray


class Occluders(NamedTuple):
    """Bodies that may occlude a view, in groups; each has its own frame.

    Attributes
    ----------
    members : (m,) int
        Bodies, one group after the other.
    first : (n_groups + 1,) int
        Where each group begins in `members`.
    position : (n_bodies, 3) float
        Origin of each body's frame. [m]
    rotation : (n_bodies, 3, 3) float
        From the frame of each body to the world's.
    boxes : (n_bodies, 2, 3) float
        Lowest and highest coordinates in the body's frame. [m]
    """

    members: IntArray
    first: IntArray
    position: FloatArray
    rotation: FloatArray
    boxes: FloatArray


class OneKind(NamedTuple):
    """Bodies of one shape, a row for each view that one may occlude.

    Attributes
    ----------
    position : (n, 3) float
        Origin of each body's frame. [m]
    rotation : (n, 3, 3) float
        From the frame of each body to the world's.
    lowest, highest : (3,) float
        Corners of the box around the shape, in its frame. [m]
    """

    position: FloatArray
    rotation: FloatArray
    lowest: FloatArray
    highest: FloatArray


class Rays(NamedTuple):
    """Rays to points of bodies, and the arrays that they are written to.

    Attributes
    ----------
    near_m : float
        Distance from the eye to the start of every ray. [m]
    off_surface_m : float
        Distance from the end of every ray to its point. [m]
    starts : (n, 3) float32
        Where each ray starts. [m]
    vectors : (n, 3) float32
        From the start of each ray to its end. [m]
    """

    near_m: float
    off_surface_m: float
    starts: Array
    vectors: Array


class OwnPoints(NamedTuple):
    """Points on a body, in its own frame.

    Attributes
    ----------
    points : (n, 3) float32
        The points. [m]
    outward : (n, 3) float
        Normal of the face around each.
    face_m : (n,) float
        Where each face is along its normal. [m]
    least_sine : (n,) float
        Seen from so far behind its face, the body hides the point; a sine.
    """

    points: Array
    outward: FloatArray
    face_m: FloatArray
    least_sine: FloatArray


class EyesOnBody(NamedTuple):
    """Places from which a body is looked at, in its own frame.

    Attributes
    ----------
    position : (n, 3) float
        The places. [m]
    share : (n,) float32
        Part of the way to each point that its ray takes.
    longest_m : (n,) float
        No way to a point is longer; infinite: every point gets a ray. [m]
    """

    position: FloatArray
    share: Array
    longest_m: FloatArray


@kernel
def _diamond(x: float, y: float) -> float:
    """Diamond angle of a direction: 0 to 4, growing with the azimuth.

    The position along the square |x| + |y| = 1, which orders directions as the
    azimuth does and needs no trigonometric function. 0 where x = y = 0.
    """
    size = abs(x) + abs(y)
    if size == 0.0:
        return 0.0
    share = y / size
    if x < 0.0:
        return 2.0 - share
    if share >= 0.0:
        return share
    return 4.0 + share


@kernel
def cell_around(x: float, y: float, n_around: int) -> int:
    """Column of cells that holds an azimuth.

    Parameters
    ----------
    x, y : float
        Horizontal direction, of any length.
    n_around : int
        Number of columns.
    """
    return min(int(_diamond(x, y) * (0.25 * n_around)), n_around - 1)


@kernel
def cell_up(sine: float, n_up: int) -> int:
    """Row of cells that holds an elevation.

    Parameters
    ----------
    sine : float
        Sine of the elevation, -1 to 1.
    n_up : int
        Number of rows; the first one looks straight down.
    """
    return max(0, min(int((sine + 1.0) * (0.5 * n_up)), n_up - 1))


@kernel
def _window(
    x: float, y: float, z: float, radius: float, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Window of cells that a sphere around a point touches.

    Parameters
    ----------
    x, y, z : float
        Middle of the sphere, from the eye. [m]
    radius : float
        Its radius; the eye is outside. [m]
    shape : (n_up, n_around)
        Number of rows and columns of cells.

    Returns
    -------
    low, high, first, last : int
        First and last row, first and last column, all inclusive. `last` may exceed
        the number of columns: the window then wraps round.

    Notes
    -----
    A sphere of sine s = radius / distance reaches from the sine of (elevation -
    asin s) to that of (elevation + asin s): sin(a -+ b) = sin a cos b -+ cos a sin b.
    """
    n_up, n_around = shape
    level = np.sqrt(x * x + y * y)
    distance = np.sqrt(x * x + y * y + z * z)
    sine = radius / distance
    cosine = np.sqrt(max(0.0, 1.0 - sine * sine))
    up = z / distance
    flat = level / distance
    low = up * cosine - flat * sine
    high = up * cosine + flat * sine
    # Straight above or below: all azimuths.
    if level <= radius:
        if z < 0.0:
            low = -1.0
        else:
            high = 1.0
        return cell_up(low, n_up), cell_up(high, n_up), 0, n_around - 1
    # Turn the direction by the half angle of the sphere, seen from above, either way.
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
    """Window of cells that a triangle touches, in the form of `_window`.

    Parameters
    ----------
    corners : 3 tuples of 3 floats
        Corners of the triangle, from the eye. [m]
    x, y : float
        Its middle. [m]
    sine : float
        At least the sine of the triangle's half angle, seen from the eye.
    shape : (n_up, n_around)
        Number of rows and columns of cells.

    Returns
    -------
    low, high, first, last : int
        As `_window` returns them.

    Notes
    -----
    The azimuth on a triangle lies between those of its corners. Let p be the sum of
    shares t of the corners c. The ratio height / |p| is at most the greatest such
    ratio of a corner times sum t |c| / |p|, which lies between 1 and 1 / cos(the
    triangle's angle); and it is at least the least ratio likewise.
    """
    # Extremes of the corners: azimuth from the middle, and sine of the elevation.
    middle = _diamond(x, y)
    left = 0.0
    right = 0.0
    bottom = 1.0
    top = -1.0
    for cx, cy, cz in corners:
        turn = _diamond(cx, cy) - middle
        if turn > 2.0:
            turn -= 4.0
        elif turn < -2.0:
            turn += 4.0
        left = min(left, turn)
        right = max(right, turn)
        ratio = cz / np.sqrt(cx * cx + cy * cy + cz * cz)
        bottom = min(bottom, ratio)
        top = max(top, ratio)
    # Between corners the ratio may exceed theirs by 1 / cos(2 a) = 1 / (1 - 2 sin^2 a).
    bulge = 1.0 / (1.0 - 2.0 * sine * sine)
    if bottom < 0.0:
        bottom = bottom * bulge
    if top > 0.0:
        top = top * bulge
    distance = np.sqrt(x * x + y * y)
    slack = _SLACK_M / distance + _SLACK_SIN
    n_up, n_around = shape
    first = int(np.floor((middle + left - slack) * (0.25 * n_around)))
    last = int(np.floor((middle + right + slack) * (0.25 * n_around)))
    if first < 0:
        first = first + n_around
        last = last + n_around
    return cell_up(bottom - slack, n_up), cell_up(top + slack, n_up), first, last


@kernel
def _put_piece(piece: Array, a: Point, b: Point, c: Point) -> None:
    """Write the corners of a triangle into nine numbers, corner by corner."""
    piece[0] = a[0]
    piece[1] = a[1]
    piece[2] = a[2]
    piece[3] = b[0]
    piece[4] = b[1]
    piece[5] = b[2]
    piece[6] = c[0]
    piece[7] = c[1]
    piece[8] = c[2]


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
    """Enter triangles into cells that hold the nearest distance from the eye.

    Parameters
    ----------
    nearest : (n_up, n_around) float32
        Distance of the nearest thing in each cell; lowered in place. [m]
    triangles : (n, 3, 3) float
        Corners of the scene's triangles. [m]
    eye : (3,) float
        Where they are seen from. [m]
    near_m, far_m : float
        Triangles nearer or farther than these are left out. [m]
    low_m, high_m : float
        Lowest and highest point that is looked at. Triangles that no way from the
        eye to such a height can meet are left out. [m]

    Notes
    -----
    Triangles are cut in two across their longest side until each piece is small as
    seen from the eye. Pieces that are still to be handled lie on a stack, nine
    coordinates each.
    """
    floor = min(eye[2], low_m)
    ceiling = max(eye[2], high_m)
    shape = nearest.shape
    n_around = shape[1]
    stack = np.empty((_MOST_CUTS + 1, 9))
    # Loop over the triangles of the scene.
    for number in range(len(triangles)):
        for corner in range(3):
            for axis in range(3):
                stack[0, 3 * corner + axis] = (
                    triangles[number, corner, axis] - eye[axis]
                )
        height = 1
        # Loop over its pieces that are still to be cut or entered.
        while height > 0:
            height -= 1
            ax, ay, az, bx, by, bz, cx, cy, cz = stack[height]
            is_below = max(az, bz, cz) + eye[2] <= floor
            if is_below or min(az, bz, cz) + eye[2] >= ceiling:
                continue
            # The sphere around the piece, and how far away it is.
            x = (ax + bx + cx) / 3.0
            y = (ay + by + cy) / 3.0
            z = (az + bz + cz) / 3.0
            radius2 = max(
                (ax - x) ** 2 + (ay - y) ** 2 + (az - z) ** 2,
                (bx - x) ** 2 + (by - y) ** 2 + (bz - z) ** 2,
                (cx - x) ** 2 + (cy - y) ** 2 + (cz - z) ** 2,
            )
            distance2 = x * x + y * y + z * z
            radius = np.sqrt(radius2)
            distance = np.sqrt(distance2)
            if distance + radius < near_m - _SLACK_M or distance - radius > far_m:
                continue
            is_piece = radius <= _PIECE_SIN * distance or radius <= _SMALLEST_M
            if not is_piece and height + 2 <= _MOST_CUTS:
                # Cut the piece in two across its longest side, from `begin` to `end`.
                ab = (ax - bx) ** 2 + (ay - by) ** 2 + (az - bz) ** 2
                bc = (bx - cx) ** 2 + (by - cy) ** 2 + (bz - cz) ** 2
                ca = (cx - ax) ** 2 + (cy - ay) ** 2 + (cz - az) ** 2
                if bc >= ab and bc >= ca:
                    begin_corner = (bx, by, bz)
                    end_corner = (cx, cy, cz)
                    other_corner = (ax, ay, az)
                elif ca >= ab and ca >= bc:
                    begin_corner = (cx, cy, cz)
                    end_corner = (ax, ay, az)
                    other_corner = (bx, by, bz)
                else:
                    begin_corner = (ax, ay, az)
                    end_corner = (bx, by, bz)
                    other_corner = (cx, cy, cz)
                # Both halves share the middle of that side and the other corner.
                middle = (
                    0.5 * (begin_corner[0] + end_corner[0]),
                    0.5 * (begin_corner[1] + end_corner[1]),
                    0.5 * (begin_corner[2] + end_corner[2]),
                )
                _put_piece(stack[height], begin_corner, middle, other_corner)
                _put_piece(stack[height + 1], end_corner, middle, other_corner)
                height += 2
                continue
            # The piece is small enough: enter it into the cells that it touches.
            wide = radius + _SLACK_M + _SLACK_SIN * distance
            # The eye is as good as in the piece, which then may be in every cell.
            if distance <= wide:
                nearest[:] = 0.0
                return
            least = np.float32(max(0.0, distance - wide))
            # Straight above or below.
            if np.sqrt(x * x + y * y) <= wide:
                low, high, begin, end = _window(x, y, z, wide, shape)
            else:
                corners = ((ax, ay, az), (bx, by, bz), (cx, cy, cz))
                sine = wide / distance
                low, high, begin, end = _piece_window(corners, x, y, sine, shape)
            # Loop over the cells that the piece touches.
            for up in range(low, high + 1):
                row = nearest[up]
                for column in range(begin, min(end, n_around - 1) + 1):
                    row[column] = min(row[column], least)
                # Columns beyond the last go on from the first.
                for column in range(0, end - n_around + 1):
                    row[column] = min(row[column], least)


@kernel
def _is_clear(
    nearest: Array, size: int, window: tuple[int, int, int, int], far: Any
) -> bool:
    """True if nothing in a window of blocks is as near as `far`.

    Parameters
    ----------
    nearest : (n_rows, n_columns) float32
        Distance of the nearest thing in each block of cells. [m]
    size : int
        Cells along one side of a block.
    window : tuple of 4 int
        Cells, as :func:`_window` returns them.
    far : float32
        Distance up to which things count. [m]
    """
    low, high, begin, end = window
    for up in range(low // size, high // size + 1):
        for around in range(begin // size, end // size + 1):
            if around < N_AROUND // size:
                column = around
            else:
                column = around - N_AROUND // size
            if nearest[up, column] <= far:
                return False
    return True


@kernel
def find_unclear_points(
    nearest: Array,
    views: BodyViews,
    eye: FloatArray,
    view_index: IntArray,
    unclear: BoolArray,
) -> None:
    """Mark the points of views that something may occlude.

    Parameters
    ----------
    nearest : (n_up, n_around) float32
        Cells filled by :func:`mark_nearest`. [m]
    views : BodyViews
        All bodies.
    eye : (3,) float
        Where they are seen from; the same as for `nearest`. [m]
    view_index : (n,) int
        Views that are asked for.
    unclear : (n, n_points) bool
        Set to True where something may stand in front of a point.
    """
    points = views.points
    middle = views.middle
    ex = eye[0]
    ey = eye[1]
    ez = eye[2]
    blocks = np.empty((N_UP // _BLOCK, N_AROUND // _BLOCK), np.float32)
    blocks[:] = np.inf
    # Find the nearest thing of each block of cells.
    for up in range(N_UP):
        for column in range(N_AROUND):
            block = blocks[up // _BLOCK, column // _BLOCK]
            blocks[up // _BLOCK, column // _BLOCK] = min(block, nearest[up, column])
    # Look at each view as a whole first, by the sphere around it.
    for row in range(len(view_index)):
        view = view_index[row]
        x = middle[view, 0] - ex
        y = middle[view, 1] - ey
        z = middle[view, 2] - ez
        distance = np.sqrt(x * x + y * y + z * z)
        wide = views.radius[view] + _SLACK_M
        if distance > wide:
            window = _window(x, y, z, wide, nearest.shape)
            far = np.float32(distance + wide)
            # Blocks of cells first: fewer of them answer most views.
            if _is_clear(blocks, _BLOCK, window, far):
                continue
            if _is_clear(nearest, 1, window, far):
                continue
        # Then look at the cell of each point.
        for point in range(points.shape[2]):
            x = points[view, 0, point] - ex
            y = points[view, 1, point] - ey
            z = points[view, 2, point] - ez
            distance = np.sqrt(x * x + y * y + z * z)
            if distance == 0.0:
                unclear[row, point] = True
                continue
            up = cell_up(z / distance, N_UP)
            column = cell_around(x, y, N_AROUND)
            unclear[row, point] = nearest[up, column] <= distance


@kernel
def misses(eye: Point, target: Point, low: Point, high: Point) -> bool:
    """True if the way from one place to another passes a box along the axes.

    Clips the way to the three pairs of planes of the box, one axis after another.

    Parameters
    ----------
    eye, target : tuple of 3 floats
        Both ends of the way. [m]
    low, high : tuple of 3 floats
        Lowest and highest corner of the box. [m]

    References
    ----------
    T. Kay, J. Kajiya, "Ray tracing complex scenes", SIGGRAPH 1986 (slabs).
    """
    first = 0.0
    last = 1.0
    for axis in range(3):
        origin = eye[axis]
        least = low[axis]
        most = high[axis]
        way = target[axis] - origin
        if abs(way) < 1.0e-9:
            if origin < least or origin > most:
                return True
            continue
        enter = (least - origin) / way
        leave = (most - origin) / way
        if enter > leave:
            enter, leave = leave, enter
        first = max(first, enter)
        last = min(last, leave)
    return first > last


# ---------- rays
@kernel
def shorten(
    eye: tuple[np.float32, np.float32, np.float32],
    way: tuple[np.float32, np.float32, np.float32],
    near: np.float32,
    cut: np.float32,
    start: Array,
    vector: Array,
) -> None:
    """Write the ray from an eye to a point, shortened at both ends.

    Parameters
    ----------
    eye : tuple of 3 float32
        Where the way begins. [m]
    way : tuple of 3 float32
        From the eye to the point. [m]
    near : float32
        How far from the eye the ray starts. [m]
    cut : float32
        How much shorter than the way the ray is. [m]
    start, vector : (3,) float32
        Written: start of the ray, and the vector from there to its end. [m]
    """
    x, y, z = way
    one = np.float32(1.0)
    per_length = one / np.sqrt(x * x + y * y + z * z)
    begin = near * per_length
    share = one - cut * per_length
    start[0] = x * begin + eye[0]
    start[1] = y * begin + eye[1]
    start[2] = z * begin + eye[2]
    vector[0] = x * share
    vector[1] = y * share
    vector[2] = z * share


@kernel
def fill_rays(
    points: Array, view_index: IntArray, asked: BoolArray, eye: FloatArray, rays: Rays
) -> None:
    """Write the rays from an eye to the points that are asked for.

    Parameters
    ----------
    points : (n_views, 3, n_points) float32
        Points of all bodies. [m]
    view_index : (n,) int
        View of each row of `asked`.
    asked : (n, n_points) bool
        Points that get a ray, row by row.
    eye : (3,) float
        Where all rays come from. [m]
    rays : Rays
        Written to; it has room for all points that are asked for.
    """
    near = np.float32(rays.near_m)
    cut = np.float32(rays.near_m + rays.off_surface_m)
    ex = np.float32(eye[0])
    ey = np.float32(eye[1])
    ez = np.float32(eye[2])
    ray = 0
    # Loop over the views, and the points of each that are asked for.
    for row in range(len(view_index)):
        view = view_index[row]
        for point in range(points.shape[2]):
            if not asked[row, point]:
                continue
            x = points[view, 0, point] - ex
            y = points[view, 1, point] - ey
            z = points[view, 2, point] - ez
            start = rays.starts[ray]
            vector = rays.vectors[ray]
            shorten((ex, ey, ez), (x, y, z), near, cut, start, vector)
            ray += 1


@kernel
def fill_own_rays(
    own: OwnPoints, eyes: EyesOnBody, starts: Array, vectors: Array, hidden: BoolArray
) -> int:
    """Write the rays to the points of a body that are not seen from behind their face.

    Parameters
    ----------
    own : OwnPoints
        The points.
    eyes : EyesOnBody
        Where rays come from.
    starts, vectors : (n_rays, 3) float32
        Written; they have room for all points of all eyes. [m]
    hidden : (n_eyes, n_points) bool
        Set to True where a point gets no ray: its own face hides it.

    Returns
    -------
    n_rays : int
        Number of rays written, eye by eye.
    """
    ray = 0
    for row in range(len(eyes.position)):
        x = eyes.position[row, 0]
        y = eyes.position[row, 1]
        z = eyes.position[row, 2]
        start_x = np.float32(x)
        start_y = np.float32(y)
        start_z = np.float32(z)
        share = eyes.share[row]
        for point in range(len(own.points)):
            outward = own.outward[point]
            along_m = outward[0] * x + outward[1] * y + outward[2] * z
            behind_m = own.face_m[point] - along_m
            if behind_m > own.least_sine[point] * eyes.longest_m[row]:
                hidden[row, point] = True
                continue
            starts[ray, 0] = start_x
            starts[ray, 1] = start_y
            starts[ray, 2] = start_z
            vectors[ray, 0] = (own.points[point, 0] - start_x) * share
            vectors[ray, 1] = (own.points[point, 1] - start_y) * share
            vectors[ray, 2] = (own.points[point, 2] - start_z) * share
            ray += 1
    return ray


@kernel
def find_bodies_between(
    views: BodyViews,
    eye: FloatArray,
    view_index: IntArray,
    group_index: IntArray,
    bodies: Occluders,
    pairs: Array,
) -> int:
    """Find the pairs of views and bodies that may occlude part of them.

    Parameters
    ----------
    views : BodyViews
        All bodies to be looked at.
    eye : (3,) float
        Where they are seen from. [m]
    view_index : (n,) int
        View of each row.
    group_index : (n,) int
        Group of bodies that are there in each row.
    bodies : Occluders
        All bodies that may be in the way.
    pairs : (n_pairs, 2) int
        Written: row and body of each pair.

    Returns
    -------
    n_pairs : int
        Number of pairs written.

    Notes
    -----
    All other bodies are farther from the way to the middle of the view than any way
    to one of its points is. Two tests say so, the cheaper first: the sphere around
    the body's box, then the box itself, widened by the radius of the view.
    """
    position = bodies.position
    n_bodies = len(bodies.boxes)
    n_pairs = 0
    # Middle of each body's box, in the world's frame.
    centre = np.empty_like(position)
    # Distance of the box's corners from its middle.
    reach = np.empty(n_bodies)
    # The eye in each body's frame.
    eyes = np.empty_like(position)
    # Loop over all bodies: middle and size of their boxes, and the eye in their frames.
    for body in range(n_bodies):
        low = bodies.boxes[body, 0]
        high = bodies.boxes[body, 1]
        r = bodies.rotation[body]
        reach2 = 0.0
        for i in range(3):
            centre[body, i] = position[body, i]
            eyes[body, i] = 0.0
            reach2 += 0.25 * (high[i] - low[i]) ** 2
            for j in range(3):
                centre[body, i] += 0.5 * r[i, j] * (low[j] + high[j])
                eyes[body, i] += r[j, i] * (eye[j] - position[body, j])
        reach[body] = np.sqrt(reach2)
    # Loop over the views, and the bodies of the group of each.
    for row in range(len(view_index)):
        view = view_index[row]
        group = group_index[row]
        wide = views.radius[view]
        mx = views.middle[view, 0] - eye[0]
        my = views.middle[view, 1] - eye[1]
        mz = views.middle[view, 2] - eye[2]
        length2 = max(mx * mx + my * my + mz * mz, 1.0e-12)
        for place in range(bodies.first[group], bodies.first[group + 1]):
            body = bodies.members[place]
            cx = centre[body, 0] - eye[0]
            cy = centre[body, 1] - eye[1]
            cz = centre[body, 2] - eye[2]
            # The point of the way that is nearest to the middle of the body's box.
            share = min(max((cx * mx + cy * my + cz * mz) / length2, 0.0), 1.0)
            away2 = (
                (cx - share * mx) ** 2 + (cy - share * my) ** 2 + (cz - share * mz) ** 2
            )
            if away2 > (reach[body] + wide) ** 2:
                continue
            # The way in the body's frame, against the box widened by the view's radius.
            r = bodies.rotation[body]
            low = bodies.boxes[body, 0]
            high = bodies.boxes[body, 1]
            ex = eyes[body, 0]
            ey = eyes[body, 1]
            ez = eyes[body, 2]
            target = (
                ex + r[0, 0] * mx + r[1, 0] * my + r[2, 0] * mz,
                ey + r[0, 1] * mx + r[1, 1] * my + r[2, 1] * mz,
                ez + r[0, 2] * mx + r[1, 2] * my + r[2, 2] * mz,
            )
            least = (low[0] - wide, low[1] - wide, low[2] - wide)
            most = (high[0] + wide, high[1] + wide, high[2] + wide)
            if misses((ex, ey, ez), target, least, most):
                continue
            pairs[n_pairs, 0] = row
            pairs[n_pairs, 1] = body
            n_pairs += 1
    return n_pairs


@kernel
def _into_body(rotation: Array, x: float, y: float, z: float) -> Point:
    """A vector of the world's axes in those of a body, by R transposed."""
    r = rotation
    return (
        r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
        r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
        r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
    )


@kernel
def find_rays_at_body(
    points: Array,
    view_index: IntArray,
    hidden: BoolArray,
    eye: FloatArray,
    bodies: OneKind,
    rays: Rays,
    asked: BoolArray,
) -> int:
    """Write the rays that meet the box around a body, in the body's frame.

    Parameters
    ----------
    points : (n_views, 3, n_points) float32
        Points of all views. [m]
    view_index : (n,) int
        View of each row.
    hidden : (n, n_points) bool
        Points that need no ray: something else occludes them.
    eye : (3,) float
        Where all rays come from, world frame. [m]
    bodies : OneKind
        The body in the way of each row.
    rays : Rays
        Written to; it has room for all points of all rows.
    asked : (n, n_points) bool
        Set to True for the points that get a ray.

    Returns
    -------
    n_rays : int
        Number of rays written.
    """
    near = np.float32(rays.near_m)
    cut = np.float32(rays.near_m + rays.off_surface_m)
    least = (bodies.lowest[0], bodies.lowest[1], bodies.lowest[2])
    most = (bodies.highest[0], bodies.highest[1], bodies.highest[2])
    ray = 0
    # Loop over the views with a body each, and take the eye into its frame.
    for row in range(len(view_index)):
        view = view_index[row]
        r = bodies.rotation[row]
        px = bodies.position[row, 0]
        py = bodies.position[row, 1]
        pz = bodies.position[row, 2]
        origin = _into_body(r, eye[0] - px, eye[1] - py, eye[2] - pz)
        start = (np.float32(origin[0]), np.float32(origin[1]), np.float32(origin[2]))
        # Loop over the points that nothing occludes yet.
        for point in range(points.shape[2]):
            if hidden[row, point]:
                continue
            x = points[view, 0, point]
            y = points[view, 1, point]
            z = points[view, 2, point]
            target = _into_body(r, x - px, y - py, z - pz)
            if misses(origin, target, least, most):
                continue
            asked[row, point] = True
            vx = np.float32(target[0]) - start[0]
            vy = np.float32(target[1]) - start[1]
            vz = np.float32(target[2]) - start[2]
            shorten(start, (vx, vy, vz), near, cut, rays.starts[ray], rays.vectors[ray])
            ray += 1
    return ray
