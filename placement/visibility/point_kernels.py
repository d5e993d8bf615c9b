"""Numba kernels: points of bodies in pinhole cameras and in LiDARs.

Most bodies are seen whole, and inside the image: the corners of their convex hulls
say all. Many cameras are projected into at once, side by side in lanes. The others
are looked at one by one, point by point, many points at once.

Whatever is handled side by side lies in a structured array: each field holds that
number of all lanes, ``(LANES,)``, one after the other in memory, so that loops over
lanes become vector instructions. It is one array, not one for each number: the
compiler would have to prove that many arrays do not overlap, and gives up.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel

Array = NDArray[Any]
# Left, top, right and bottom, in single precision. [px]
Box = tuple[Any, Any, Any, Any]

# How many cameras, or points, are handled at once.
LANES = 16


def _in_lanes(*names: str) -> Any:
    """Structured type with a number of each name in every lane, in single precision."""
    return np.dtype([(name, np.float32, LANES) for name in names])


LENSES = _in_lanes(
    # Rotation: how far along each axis of a camera a way along each axis of the world
    # leads.
    "x_right",
    "x_down",
    "x_ahead",
    "y_right",
    "y_down",
    "y_ahead",
    "z_right",
    "z_down",
    "z_ahead",
    "focal",
    "half_width",
    "half_height",
    "cos_across",
    "sin_across",
    "cos_up",
    "sin_up",
)
"""Cameras side by side."""
OFFSETS = _in_lanes("x", "y", "z")
"""Points side by side, from the eye, in the world's axes. [m]"""
LIMITS = _in_lanes("left", "top", "right", "bottom", "depth")
"""Least and greatest columns and rows side by side [px], and least depths [m]."""

_FAR = np.float32(3.0e38)
# Factor that allows for the rounding of single precision.
_NEARLY = 0.999
_SLACK_PX = 0.01
# Added to a sphere in single precision, so that no body is left out.
_SLACK_M = np.float32(1.0e-3)


class BodyPoints(NamedTuple):
    """Bodies to be looked at; one view is one body at one place.

    Attributes
    ----------
    points : (n_views, 3, n_points) float32
        Points spread over each body. [m]
    hull : (n_views, 3, n_corners) float32
        Corners of its convex hull. [m]
    middle : (n_views, 3) float
        Centre of a sphere around it. [m]
    radius : (n_views,) float
        Radius of that sphere. [m]
    """

    points: Array
    hull: Array
    middle: FloatArray
    radius: FloatArray


class Seen(NamedTuple):
    """What is seen from a mount; an entry is one body.

    Attributes
    ----------
    view_index : (n_entries,) int
        View of each entry.
    is_visible : (n_entries, n_points) bool
        Points that nothing occludes.
    is_whole : (n_entries,) bool
        Nothing else occludes any point of the body.
    """

    view_index: IntArray
    is_visible: BoolArray
    is_whole: BoolArray


class Cameras(NamedTuple):
    """Cameras at one mount.

    Attributes
    ----------
    lenses : (n_blocks,) `LENSES`
        The cameras in lanes; the unused lanes of the last block are zero.
    n : int
        Number of cameras.
    """

    lenses: Array
    n: int


class Least(NamedTuple):
    """Limits from which on a body counts.

    Attributes
    ----------
    depth : float
        Distance ahead of a lens; nearer points are projected as if they were
        there. In single precision for pinholes. [m]
    height_px : float
        Height of the box of what is visible. [px]
    """

    depth: Any
    height_px: float


class Found(NamedTuple):
    """Room for all boxes that there may be; a pair is a camera and an entry.

    Attributes
    ----------
    plain : (n, 2) int
        Pairs where a whole body is inside the image.
    plain_px : (n, 4) float32
        Box of that body. [px]
    part : (n, 2) int
        All other pairs.
    part_px : (n, 8) float32
        Box of the visible points, then of all points. [px]
    inside_share : (n,) float
        How much of the latter box is inside the image.
    """

    plain: IntArray
    plain_px: Array
    part: IntArray
    part_px: Array
    inside_share: FloatArray


class _Work(NamedTuple):
    """Room for one body at a time.

    Attributes
    ----------
    lens : (1,) `LENSES`
        Cameras that are near the body.
    hull_limits : (1,) `LIMITS`
        Limits of its hull in each of these.
    limits : (1,) `LIMITS`
        Limits of anything else.
    every : (n_blocks,) `OFFSETS`
        All of its points.
    seen : (n_blocks,) `OFFSETS`
        Its visible points.
    """

    lens: Array
    hull_limits: Array
    limits: Array
    every: Array
    seen: Array


def pack_lenses(
    rotation: FloatArray, focal_px: FloatArray, size_px: FloatArray
) -> Array:
    """Pinhole cameras side by side in lanes, for :func:`box_bodies`.

    Parameters
    ----------
    rotation : (k, 3, 3) float
        Takes offsets, as rows, into the frame of each camera.
    focal_px : (k,) float
        Focal lengths. [px]
    size_px : (k, 2) float
        Width and height of the images. [px]

    Returns
    -------
    lenses : (n_blocks,) `LENSES`
    """
    half = 0.5 * size_px
    angle = np.arctan2(half, focal_px[:, None])
    cosine = np.cos(angle)
    sine = np.sin(angle)
    # A column for each field of `LENSES`, in their order.
    numbers = np.column_stack([rotation.reshape(-1, 9), focal_px, half])
    across = [cosine[:, 0], sine[:, 0]]
    up = [cosine[:, 1], sine[:, 1]]
    numbers = np.column_stack([numbers, *across, *up])
    lenses = np.zeros(-(-len(focal_px) // LANES), LENSES)
    for name, values in zip(LENSES.names or (), numbers.T, strict=True):
        in_lanes = np.zeros(len(lenses) * LANES, np.float32)
        in_lanes[: len(values)] = values
        lenses[name] = in_lanes.reshape(-1, LANES)
    return lenses


@kernel
def _is_any_near(
    x: Any,
    y: Any,
    z: Any,
    radius: Any,
    lens: Any,
    n: int,
    least_px: Any,
    is_near: Array,
) -> bool:
    """Find the cameras of one block in which a sphere may be high enough.

    Parameters
    ----------
    x, y, z : float32
        Middle of the sphere, from the eye. [m]
    radius : float32
        Its radius. [m]
    lens : block of `LENSES`
        The cameras.
    n : int
        How many of the lanes are cameras.
    least_px : float32
        Least height in the image. [px]
    is_near : (LANES,) bool
        Written: the sphere may be so high in the image of each camera.

    Returns
    -------
    found : bool
        Any of the first `n` is near.

    Notes
    -----
    The rows that the sphere reaches lie between the tangents from the eye; next to and
    behind the lens it may reach any.
    """
    # Loop over the cameras in the lanes.
    for j in range(LANES):
        right = x * lens.x_right[j] + y * lens.y_right[j] + z * lens.z_right[j]
        down = x * lens.x_down[j] + y * lens.y_down[j] + z * lens.z_down[j]
        ahead = x * lens.x_ahead[j] + y * lens.y_ahead[j] + z * lens.z_ahead[j]
        across = abs(right) * lens.cos_across[j] - ahead * lens.sin_across[j]
        up = abs(down) * lens.cos_up[j] - ahead * lens.sin_up[j]
        # Tangents from the eye to the sphere, in the plane of its middle.
        half = radius / np.sqrt(down * down + ahead * ahead - radius * radius)
        middle = down / ahead
        focal = lens.focal[j]
        half_height = lens.half_height[j]
        top = focal * (middle - half) / (np.float32(1.0) + middle * half)
        bottom = focal * (middle + half) / (np.float32(1.0) - middle * half)
        if not (top > -half_height):
            top = -half_height
        if not (bottom < half_height):
            bottom = half_height
        is_low = (ahead > radius) & (bottom - top < least_px)
        is_near[j] = (across <= radius) & (up <= radius) & (not is_low)
    found = False
    for j in range(n):
        found |= is_near[j]
    return found


@kernel
def _least(min_height_px: float) -> Any:
    """Height in single precision that no box of `min_height_px` falls below."""
    return np.float32(_NEARLY * min_height_px - _SLACK_PX)


@kernel
def find_views(
    middle: FloatArray,
    radius: FloatArray,
    eye: Array,
    cameras: Cameras,
    min_height_px: float,
    found: BoolArray,
) -> None:
    """Mark the views whose body may be high enough in a camera's image.

    Parameters
    ----------
    middle : (n_views, 3) float
        Centres of spheres around the bodies. [m]
    radius : (n_views,) float
        Their radii. [m]
    eye : (3,) float32
        The mount. [m]
    cameras : Cameras
        Cameras at the mount.
    min_height_px : float
        Least height. [px]
    found : (n_views,) bool
        Set to True for those views.
    """
    is_near = np.empty(LANES, np.bool_)
    least_px = _least(min_height_px)
    # Loop over the views, and blocks of cameras until one is near.
    for view in range(len(middle)):
        x = np.float32(middle[view, 0] - eye[0])
        y = np.float32(middle[view, 1] - eye[1])
        z = np.float32(middle[view, 2] - eye[2])
        reach = np.float32(radius[view]) + _SLACK_M
        for block in range(len(cameras.lenses)):
            n = min(LANES, cameras.n - block * LANES)
            if _is_any_near(
                x, y, z, reach, cameras.lenses[block], n, least_px, is_near
            ):
                found[view] = True
                break


@kernel
def _project_into_all(
    points: Array, view: int, eye: Array, lens: Any, min_depth: Any, limits: Any
) -> None:
    """Compute the limits of a view's points in every camera of a block.

    Parameters
    ----------
    points : (n_views, 3, n) float32
        Points of all views. [m]
    view : int
        The view.
    eye : (3,) float32
        The mount. [m]
    lens : block of `LENSES`
        The cameras.
    min_depth : float32
        Nearer points are projected as if they were there. [m]
    limits : block of `LIMITS`
        Written: least and greatest column and row, and the least depth.

    Notes
    -----
    Each number is computed as in :func:`_box_points`.
    """
    ex = eye[0]
    ey = eye[1]
    ez = eye[2]
    for j in range(LANES):
        limits.left[j] = _FAR
        limits.top[j] = _FAR
        limits.depth[j] = _FAR
        limits.right[j] = -_FAR
        limits.bottom[j] = -_FAR
    # Loop over the points, two at a time, in all cameras at once.
    for point in range(0, points.shape[2], 2):
        other_point = min(point + 1, points.shape[2] - 1)
        x = points[view, 0, point] - ex
        y = points[view, 1, point] - ey
        z = points[view, 2, point] - ez
        a = points[view, 0, other_point] - ex
        b = points[view, 1, other_point] - ey
        c = points[view, 2, other_point] - ez
        for j in range(LANES):
            x_ahead = lens.x_ahead[j]
            y_ahead = lens.y_ahead[j]
            z_ahead = lens.z_ahead[j]
            depth = x * x_ahead + y * y_ahead + z * z_ahead
            other = a * x_ahead + b * y_ahead + c * z_ahead
            focal = lens.focal[j]
            scale = focal / (depth if depth > min_depth else min_depth)
            other_scale = focal / (other if other > min_depth else min_depth)
            if other < depth:
                low = other
            else:
                low = depth
            least = limits.depth[j]
            if low < least:
                limits.depth[j] = low
            else:
                limits.depth[j] = least

            x_right = lens.x_right[j]
            y_right = lens.y_right[j]
            z_right = lens.z_right[j]
            # Columns of both points. Two branches, for the compiler turns only
            # branches that choose a single number into vector instructions.
            one = (x * x_right + y * y_right + z * z_right) * scale
            two = (a * x_right + b * y_right + c * z_right) * other_scale
            if one < two:
                low = one
            else:
                low = two
            if one < two:
                high = two
            else:
                high = one
            left = limits.left[j]
            right = limits.right[j]
            if low < left:
                limits.left[j] = low
            else:
                limits.left[j] = left
            if high > right:
                limits.right[j] = high
            else:
                limits.right[j] = right

            x_down = lens.x_down[j]
            y_down = lens.y_down[j]
            z_down = lens.z_down[j]
            # Rows of both points.
            one = (x * x_down + y * y_down + z * z_down) * scale
            two = (a * x_down + b * y_down + c * z_down) * other_scale
            if one < two:
                low = one
            else:
                low = two
            if one < two:
                high = two
            else:
                high = one
            top = limits.top[j]
            bottom = limits.bottom[j]
            if low < top:
                limits.top[j] = low
            else:
                limits.top[j] = top
            if high > bottom:
                limits.bottom[j] = high
            else:
                limits.bottom[j] = bottom
    # Shift only now: rounding leaves the order of numbers as it is.
    for j in range(LANES):
        limits.left[j] += lens.half_width[j]
        limits.right[j] += lens.half_width[j]
        limits.top[j] += lens.half_height[j]
        limits.bottom[j] += lens.half_height[j]


@kernel
def _set_out(
    points: Array, view: int, eye: Array, shown: BoolArray, offsets: Array
) -> int:
    """Put some of a view's points into lanes.

    Parameters
    ----------
    points : (n_views, 3, n_points) float32
        Points of all views. [m]
    view : int
        The view.
    eye : (3,) float32
        Offsets are from here. [m]
    shown : (n_points,) bool
        Points to put into lanes.
    offsets : (n_blocks,) `OFFSETS`
        Written.

    Returns
    -------
    n_blocks : int
        How many blocks the points fill. The last point is repeated to the end of the
        last block.
    """
    count = 0
    # Points that are shown go to the next free lane.
    for point in range(points.shape[2]):
        if shown[point]:
            block = offsets[count // LANES]
            block.x[count % LANES] = points[view, 0, point] - eye[0]
            block.y[count % LANES] = points[view, 1, point] - eye[1]
            block.z[count % LANES] = points[view, 2, point] - eye[2]
            count += 1
    n_blocks = -(-count // LANES)
    # The last point fills the rest of the lanes.
    for place in range(count, n_blocks * LANES):
        block = offsets[n_blocks - 1]
        last = (count - 1) % LANES
        block.x[place % LANES] = block.x[last]
        block.y[place % LANES] = block.y[last]
        block.z[place % LANES] = block.z[last]
    return n_blocks


@kernel
def _box_points(
    offsets: Array, lens: Any, camera: int, min_depth: Any, is_cut: bool, limits: Any
) -> Box:
    """Box of points in one camera of the lanes.

    Parameters
    ----------
    offsets : (n_blocks,) `OFFSETS`
        The points.
    lens : block of `LENSES`
        Cameras.
    camera : int
        Lane of the camera.
    min_depth : float32
        Nearer points are projected as if they were there. [m]
    is_cut : bool
        The image cuts the body off: only points inside the image count.
    limits : block of `LIMITS`
        Room to work in.

    Returns
    -------
    left, top, right, bottom : float32
        Zeros if no point counts. [px]
    """
    x_right = lens.x_right[camera]
    y_right = lens.y_right[camera]
    z_right = lens.z_right[camera]
    x_down = lens.x_down[camera]
    y_down = lens.y_down[camera]
    z_down = lens.z_down[camera]
    x_ahead = lens.x_ahead[camera]
    y_ahead = lens.y_ahead[camera]
    z_ahead = lens.z_ahead[camera]
    focal = lens.focal[camera]
    half_width = lens.half_width[camera]
    half_height = lens.half_height[camera]
    # Points count that are at most so far from the middle of the image, and deeper.
    widest = _FAR
    highest = _FAR
    nearest = -_FAR
    if is_cut:
        widest = half_width
        highest = half_height
        nearest = min_depth
    for j in range(LANES):
        limits.left[j] = _FAR
        limits.top[j] = _FAR
        limits.right[j] = -_FAR
        limits.bottom[j] = -_FAR
    # Loop over the points, as many at a time as there are lanes.
    for block in range(len(offsets)):
        offset = offsets[block]
        for j in range(LANES):
            x = offset.x[j]
            y = offset.y[j]
            z = offset.z[j]
            depth = x * x_ahead + y * y_ahead + z * z_ahead
            scale = focal / (depth if depth > min_depth else min_depth)
            column = (x * x_right + y * y_right + z * z_right) * scale + half_width
            row = (x * x_down + y * y_down + z * z_down) * scale + half_height
            counts = (
                (depth > nearest)
                & (abs(column - half_width) <= widest)
                & (abs(row - half_height) <= highest)
            )
            # A point that does not count changes no limit. Here, too, each branch
            # chooses a single number.
            if counts:
                low = column
            else:
                low = _FAR
            if counts:
                high = column
            else:
                high = -_FAR
            left = limits.left[j]
            right = limits.right[j]
            if low < left:
                limits.left[j] = low
            else:
                limits.left[j] = left
            if high > right:
                limits.right[j] = high
            else:
                limits.right[j] = right
            if counts:
                low = row
            else:
                low = _FAR
            if counts:
                high = row
            else:
                high = -_FAR
            top = limits.top[j]
            bottom = limits.bottom[j]
            if low < top:
                limits.top[j] = low
            else:
                limits.top[j] = top
            if high > bottom:
                limits.bottom[j] = high
            else:
                limits.bottom[j] = bottom
    # Loop over the lanes: the extremes of all of them.
    left = _FAR
    top = _FAR
    right = -_FAR
    bottom = -_FAR
    for j in range(LANES):
        if limits.left[j] < left:
            left = limits.left[j]
        if limits.top[j] < top:
            top = limits.top[j]
        if limits.right[j] > right:
            right = limits.right[j]
        if limits.bottom[j] > bottom:
            bottom = limits.bottom[j]
    if left <= right:
        return left, top, right, bottom
    zero = np.float32(0.0)
    return zero, zero, zero, zero


@kernel
def _find_near(
    middle: FloatArray,
    reach: Any,
    eye: Array,
    cameras: Cameras,
    least_px: Any,
    near: IntArray,
) -> int:
    """Find the cameras in whose images a view's body may be high enough.

    Parameters
    ----------
    middle : (3,) float
        Centre of a sphere around the body. [m]
    reach : float32
        Its radius. [m]
    eye : (3,) float32
        The mount. [m]
    cameras : Cameras
        Cameras at the mount.
    least_px : float32
        Least height. [px]
    near : (n + 1,) int
        Written: indices of those cameras.

    Returns
    -------
    n_near : int
        How many they are.
    """
    x = np.float32(middle[0] - eye[0])
    y = np.float32(middle[1] - eye[1])
    z = np.float32(middle[2] - eye[2])
    is_near = np.empty(LANES, np.bool_)
    n_near = 0
    for block in range(len(cameras.lenses)):
        n = min(LANES, cameras.n - block * LANES)
        if _is_any_near(x, y, z, reach, cameras.lenses[block], n, least_px, is_near):
            for j in range(n):
                near[n_near] = block * LANES + j
                n_near += is_near[j]
    return n_near


@kernel
def _is_high(box: Box, min_height_px: float) -> bool:
    """True if a visible box has at least the height that is asked for."""
    high = np.float64(box[3]) - np.float64(box[1])
    return bool(high >= min_height_px and high > 0.0)


@kernel
def _share_inside(box: Box, width: Any, height: Any) -> float:
    """Share of a box that is inside an image of some width and height."""
    left, top, right, bottom = box
    zero = np.float32(0.0)
    area = (np.float64(right) - left) * (np.float64(bottom) - top)
    across = np.float64(max(zero, min(right, width))) - max(zero, min(left, width))
    up = np.float64(max(zero, min(bottom, height))) - max(zero, min(top, height))
    # An empty box has no area to divide by.
    return float(across * up / max(area, 1.0e-9))


@kernel
def _gather_lanes(lenses: Array, cameras: IntArray, lens: Any) -> None:
    """Put some cameras side by side into the lanes of one block of `LENSES`."""
    for j in range(len(cameras)):
        block = lenses[cameras[j] // LANES]
        lane = cameras[j] % LANES
        lens.x_right[j] = block.x_right[lane]
        lens.x_down[j] = block.x_down[lane]
        lens.x_ahead[j] = block.x_ahead[lane]
        lens.y_right[j] = block.y_right[lane]
        lens.y_down[j] = block.y_down[lane]
        lens.y_ahead[j] = block.y_ahead[lane]
        lens.z_right[j] = block.z_right[lane]
        lens.z_down[j] = block.z_down[lane]
        lens.z_ahead[j] = block.z_ahead[lane]
        lens.focal[j] = block.focal[lane]
        lens.half_width[j] = block.half_width[lane]
        lens.half_height[j] = block.half_height[lane]


@kernel
def _box_of(limits: Any, camera: int) -> Box:
    """Box of what one camera of the lanes shows."""
    return (
        limits.left[camera],
        limits.top[camera],
        limits.right[camera],
        limits.bottom[camera],
    )


@kernel
def _put(boxes: Array, row: int, first: int, box: Box) -> None:
    """Write a box into a row of boxes, (n, 4 or 8), from a column on."""
    boxes[row, first] = box[0]
    boxes[row, first + 1] = box[1]
    boxes[row, first + 2] = box[2]
    boxes[row, first + 3] = box[3]


@kernel
def box_bodies(
    bodies: BodyPoints,
    eye: Array,
    sight: Seen,
    cameras: Cameras,
    least: Least,
    found: Found,
) -> tuple[int, int]:
    """Compute the boxes of bodies in pinhole cameras.

    Parameters
    ----------
    bodies : BodyPoints
        All bodies.
    eye : (3,) float32
        The mount. [m]
    sight : Seen
        Which bodies are seen from there, and which points of each.
    cameras : Cameras
        Cameras at the mount.
    least : Least
        From where on a body counts: pairs whose visible box is lower are left out.
    found : Found
        Written: whole bodies inside the image in `plain`, all others in `part`.

    Returns
    -------
    n_plain, n_part : int
        Number of pairs of either kind.

    Notes
    -----
    For each entry, the cameras that may show it are gathered into lanes, and its hull
    is projected into all of them at once. That is enough for a whole body inside the
    image. For the others the visible points, or all of them, are put into lanes, and
    projected into one camera after another.
    """
    points = bodies.points
    n_blocks = -(-points.shape[2] // LANES)
    work = _Work(
        np.zeros(1, LENSES),
        np.empty(1, LIMITS),
        np.empty(1, LIMITS),
        np.empty(n_blocks, OFFSETS),
        np.empty(n_blocks, OFFSETS),
    )
    lens = work.lens[0]
    limits = work.hull_limits[0]
    near = np.empty(cameras.n + 1, np.int64)
    every_point = np.ones(points.shape[2], np.bool_)
    zero = np.float32(0.0)
    least_px = _least(least.height_px)
    n_plain = 0
    n_part = 0
    # Loop over the bodies that are seen from the mount.
    for entry in range(len(sight.view_index)):
        view = sight.view_index[entry]
        is_whole = sight.is_whole[entry]
        # Blocks of points in lanes; -1: not yet put there.
        n_every = -1
        n_seen = -1
        reach = np.float32(bodies.radius[view]) + _SLACK_M
        n_near = _find_near(bodies.middle[view], reach, eye, cameras, least_px, near)
        # Loop over the near cameras, as many at a time as there are lanes.
        for first in range(0, n_near, LANES):
            n = min(LANES, n_near - first)
            _gather_lanes(cameras.lenses, near[first : first + n], lens)
            _project_into_all(bodies.hull, view, eye, lens, least.depth, limits)
            for j in range(n):
                camera = near[first + j]
                hull_box = _box_of(limits, j)
                left, top, right, bottom = hull_box
                width = lens.half_width[j] + lens.half_width[j]
                height = lens.half_height[j] + lens.half_height[j]
                # Leave out what the image does not show, or not high enough.
                is_behind = limits.depth[j] <= least.depth
                high = np.float64(min(bottom, height)) - np.float64(max(top, zero))
                is_out = high < _NEARLY * least.height_px or high < 0.0
                if not is_behind and (is_out or right < zero or left > width):
                    continue
                is_cut = (
                    is_behind
                    or left < zero
                    or top < zero
                    or right > width
                    or bottom > height
                )
                # A whole body inside the image: its hull says everything.
                if is_whole and not is_cut:
                    if high >= least.height_px and high > 0.0:
                        found.plain[n_plain, 0] = camera
                        found.plain[n_plain, 1] = entry
                        _put(found.plain_px, n_plain, 0, hull_box)
                        n_plain += 1
                    continue
                # Visible points, unless all are.
                seen_box = hull_box
                if not is_whole:
                    if n_seen < 0:
                        n_seen = _set_out(
                            points, view, eye, sight.is_visible[entry], work.seen
                        )
                    seen = work.seen[:n_seen]
                    seen_box = _box_points(
                        seen, lens, j, least.depth, is_cut, work.limits[0]
                    )
                    if not _is_high(seen_box, least.height_px):
                        continue
                # All points, where the hull is not enough.
                whole_box = hull_box
                if is_cut:
                    if n_every < 0:
                        n_every = _set_out(points, view, eye, every_point, work.every)
                    every = work.every[:n_every]
                    whole_box = _box_points(
                        every, lens, j, least.depth, is_cut, work.limits[0]
                    )
                if is_whole:
                    seen_box = whole_box
                    if not _is_high(seen_box, least.height_px):
                        continue
                found.part[n_part, 0] = camera
                found.part[n_part, 1] = entry
                _put(found.part_px, n_part, 0, seen_box)
                _put(found.part_px, n_part, 4, whole_box)
                # Next to and behind the lens the hull does not bound all points.
                if is_behind:
                    _project_into_all(
                        points, view, eye, lens, least.depth, work.limits[0]
                    )
                    hull_box = _box_of(work.limits[0], j)
                share = _share_inside(hull_box, width, height)
                if is_cut:
                    found.inside_share[n_part] = share
                else:
                    found.inside_share[n_part] = 1.0
                n_part += 1
    return n_plain, n_part


# ---------- LiDARs
class Echoes(NamedTuple):
    """Visible points of entries, as a LiDAR at the mount sees them; k in all.

    Attributes
    ----------
    first : (n_entries + 1,) int
        Where the points of each entry begin.
    directions : (k, 3) float
        Unit vectors from the mount.
    expected : (n_weathers, k) float
        Number of points that come back, if beams were as dense as on the level.
    needed : (n_entries,) float
        Number of points that a detection takes.
    """

    first: IntArray
    directions: FloatArray
    expected: FloatArray
    needed: FloatArray


class LidarView(NamedTuple):
    """Limits of a LiDAR's field of view, which belong to it.

    Attributes
    ----------
    cos_across : float
        Cosine of half the horizontal field of view.
    sin_up : float
        Sine of half the vertical field of view.
    """

    cos_across: float
    sin_up: float


@kernel
def count_echoes(
    rotations: FloatArray,
    is_near: BoolArray,
    echoes: Echoes,
    limits: LidarView,
    detected: Array,
) -> None:
    """Mark the entries from which enough points come back.

    Parameters
    ----------
    rotations : (m, 3, 3) float
        Axes ahead, left and up of each LiDAR, as columns.
    is_near : (m, n_entries) bool
        Entries that may be in view.
    echoes : Echoes
        Visible points of the entries.
    limits : LidarView
        Field of view of all LiDARs.
    detected : (m, n_weathers, n_entries) bool
        Written.

    Notes
    -----
    Beams grow denser as the circles of latitude shrink.
    """
    n_weathers = len(echoes.expected)
    directions = echoes.directions
    total = np.zeros(n_weathers)
    # Loop over the LiDARs, the entries, and the points on each.
    for row in range(len(rotations)):
        r = rotations[row]
        for entry in range(len(echoes.needed)):
            if not is_near[row, entry]:
                continue
            total[:] = 0.0
            for point in range(echoes.first[entry], echoes.first[entry + 1]):
                x = directions[point, 0]
                y = directions[point, 1]
                z = directions[point, 2]
                up = x * r[0, 2] + y * r[1, 2] + z * r[2, 2]
                if abs(up) > limits.sin_up:
                    continue
                ahead = x * r[0, 0] + y * r[1, 0] + z * r[2, 0]
                left = x * r[0, 1] + y * r[1, 1] + z * r[2, 1]
                level = np.sqrt(ahead * ahead + left * left)
                if ahead < limits.cos_across * level:
                    continue
                for weather in range(n_weathers):
                    total[weather] += echoes.expected[weather, point] / level
            for weather in range(n_weathers):
                detected[row, weather, entry] = total[weather] >= echoes.needed[entry]
