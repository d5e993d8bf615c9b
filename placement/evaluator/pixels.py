"""Numba kernels: pixels of an image that show the VRU.

Triangles are drawn at the centres of pixels. A pixel is a direction from the lens, one
metre deep: the ray through its centre. A triangle with corners a, b, c (camera frame)
covers it where the direction lies on the same side of the three planes through the lens
and an edge; the depth there is a . (b x c) / (sum of the three products). That needs no
clipping, and neighbours that share an edge leave no gap [1]_. Only the rows and columns
in which it is looked for are found by projecting and clipping.

Nothing can occlude the VRU but what reaches into its beam: the pyramid from the lens
through the box of the VRU in the image, as deep as the VRU. Trees of boxes find it;
where they find nothing, the visible box is the amodal one, and nothing is drawn but the
VRU's outline.

References
----------
.. [1] M. Olano, T. Greer, "Triangle Scan Conversion using 2D Homogeneous Coordinates",
   Graphics Hardware 1997.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.kernels import kernel

# Few numbers are tuples, which need no memory: passing arrays costs more than the
# arithmetic.
# Right, down and ahead, in the camera frame. [m]
Point = tuple[float, float, float]
# Normals of three planes through the lens.
Edges = tuple[Point, Point, Point]
# First column and row, and those after the last.
Window = tuple[int, int, int, int]
# x_min, y_min, x_max, y_max. [px]
Bounds = tuple[float, float, float, float]

# More than rounding moves an edge in the image.
_SLACK_PX = 1.0e-6
# More than rounding changes an area in the image.
_SURE_PX2 = 1.0e-6
# More than rounding changes a volume.
_SURE_M3 = 1.0e-6
_MIN_DEPTH_M = 1.0e-6
# What the VRU stands on does not occlude it.
_TOUCH_M = 1.0e-6
_N_PLANES = 6
_LEAF_SIZE = 4
# A part of the VRU's box is drawn first if it is smaller than the box by this factor.
_WORTH_A_LOOK = 2
# Room for the nodes that wait to be handled: about one per level of a tree.
_MAX_OPEN = 512


class Image(NamedTuple):
    """The pixels of a camera at its place.

    Attributes
    ----------
    focal_px : float
        Focal length. [px]
    width_px, height_px : int
        Size of the image. [px]
    near_m : float
        Distance from the lens at which drawing starts. [m]
    up_m : float
        Height of the lens. [m]
    """

    focal_px: float
    width_px: int
    height_px: int
    near_m: float
    up_m: float


# ---------- inputs and outputs of many frames, as tuples for compiled code
class Tree(NamedTuple):
    """Boxes around ever fewer triangles: a parent is followed by its first child.

    Attributes
    ----------
    corners_m : (n_triangles, 3, 3) float
        Corners, leaf by leaf.
    low_m, high_m : (n_nodes, 3) float
        Box of each node. Without triangles there is no node.
    second : (n_nodes,) int
        The second child; -1 for a leaf.
    start, end : (n_nodes,) int
        Triangles of a node.
    """

    corners_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    second: IntArray
    start: IntArray
    end: IntArray


class Vehicles(NamedTuple):
    """Trees of all kinds of bodies that move.

    Attributes
    ----------
    tree : Tree
        The trees, one after the other.
    roots : (n_kinds,) int
        Node at which each begins.
    """

    tree: Tree
    roots: IntArray


class Skin(NamedTuple):
    """Triangles to draw, shuffled: neighbours do not follow one another.

    Attributes
    ----------
    vertices_m : (3, n_vertices) float
        In the body frame, shuffled, too, axis by axis. [m]
    triangles : (n_triangles, 3) int
        Columns of `vertices_m`.
    fan_start, fans : (n_vertices + 1,), (3 * n_triangles,) int
        Rows of the triangles at each vertex, one vertex after the other.
    """

    vertices_m: FloatArray
    triangles: IntArray
    fan_start: IntArray
    fans: IntArray


class Placed(NamedTuple):
    """Places of bodies, seen from a camera.

    ``turn @ point + shift`` is right, down, ahead.

    Attributes
    ----------
    turn : (n, 3, 3) float
        From the frame of each body to the camera's.
    shift : (n, 3) float
        Origin of each body. [m]
    up_m : (n,) float
        Height of the origins in the frame in which the camera stands. [m]
    """

    turn: FloatArray
    shift: FloatArray
    up_m: FloatArray

    def take(self, rows: slice) -> "Placed":
        """The bodies in a range of rows."""
        return Placed(self.turn[rows], self.shift[rows], self.up_m[rows])


class Sights(NamedTuple):
    """Places of everything, sight by sight and frame by frame.

    Frames of one sight differ only by the vehicles that move.

    Attributes
    ----------
    vru, static : Placed
        The VRU and the static world of each of n sights.
    frame_start : (n + 1,) int
        Where the frames of each sight begin.
    vehicles : Placed
        Vehicles that move, one frame after the other.
    vehicle_kind : (n_vehicles,) int
        Which body each of them is.
    vehicle_start : (n_frames + 1,) int
        Where the vehicles of each frame begin.
    """

    vru: Placed
    static: Placed
    frame_start: IntArray
    vehicles: Placed
    vehicle_kind: IntArray
    vehicle_start: IntArray


class SeenBoxes(NamedTuple):
    """Boxes in pixels, zeros where there is none, and shares.

    Attributes
    ----------
    amodal_px : (n, 4) float
        Box of the whole VRU in each sight. [px]
    inside_share : (n,) float
        Share of the VRU's box that the image's edges do not cut off.
    visible_px : (n, 4) float
        Box of what is visible in each sight, were no vehicles there. [px]
    visible_share : (n,) float
        Share of the VRU's pixels that are visible then; 1 where it covers none.
    frame_visible_px : (n_frames, 4) float
        Box of what is visible with vehicles. [px]
    frame_visible_share : (n_frames,) float
        Share of the VRU's pixels that are visible with vehicles.
    """

    amodal_px: FloatArray
    inside_share: FloatArray
    visible_px: FloatArray
    visible_share: FloatArray
    frame_visible_px: FloatArray
    frame_visible_share: FloatArray

    def take(self, sights: slice, frames: slice) -> "SeenBoxes":
        """Views of the arrays for ranges of sights and frames."""
        of_sights = [part[sights] for part in self[:4]]
        of_frames = [part[frames] for part in self[4:]]
        return SeenBoxes(*of_sights, *of_frames)


def blank_sights(n_sights: int, n_frames: int) -> SeenBoxes:
    """Boxes and shares before anything is drawn.

    Boxes are zeros, `inside_share` is 0, the other shares are 1.
    """
    return SeenBoxes(
        np.zeros((n_sights, 4)),
        np.zeros(n_sights),
        np.zeros((n_sights, 4)),
        np.ones(n_sights),
        np.zeros((n_frames, 4)),
        np.ones(n_frames),
    )


# ---------- triangles: their bounds in the image, and their depths
@kernel
def corner(axes: FloatArray, column: int) -> Point:
    """One of many points (3, n) as a tuple."""
    return axes[0, column], axes[1, column], axes[2, column]


@kernel
def find_span(image: Image, least_depth: float, a: Point, b: Point, c: Point) -> Bounds:
    """Bounds in the image of the part of a triangle that is deep enough.

    Parameters
    ----------
    image : Image
        The camera.
    least_depth : float
        Only what is at least so deep counts. [m]
    a, b, c : Point
        Corners of the triangle. [m]

    Returns
    -------
    bounds : Bounds
        Empty (infinite, reversed) if no part is deep enough. [px]
    """
    bounds = (np.inf, np.inf, -np.inf, -np.inf)
    bounds = _with_edge(image, least_depth, a, b, bounds)
    bounds = _with_edge(image, least_depth, b, c, bounds)
    return _with_edge(image, least_depth, c, a, bounds)


@kernel
def _with_edge(
    image: Image, least_depth: float, p: Point, q: Point, bounds: Bounds
) -> Bounds:
    """Bounds stretched by an edge from p to just before q.

    Only the part that is at least `least_depth` deep counts.
    """
    if p[2] >= least_depth:
        bounds = _with_point(image, p[0], p[1], p[2], bounds)
    if (p[2] >= least_depth) != (q[2] >= least_depth):
        part = (least_depth - p[2]) / (q[2] - p[2])
        x = p[0] + part * (q[0] - p[0])
        y = p[1] + part * (q[1] - p[1])
        bounds = _with_point(image, x, y, least_depth, bounds)
    return bounds


@kernel
def _with_point(
    image: Image, right: float, down: float, ahead: float, bounds: Bounds
) -> Bounds:
    """Bounds stretched by the projection of a point."""
    scale = image.focal_px / ahead
    x = 0.5 * image.width_px + scale * right
    y = 0.5 * image.height_px + scale * down
    return min(bounds[0], x), min(bounds[1], y), max(bounds[2], x), max(bounds[3], y)


@kernel
def _edges_within(bounds: Bounds, window: Window) -> Bounds:
    """Bounds of the pixels of a window whose centres lie within bounds."""
    return (
        max(bounds[0] - 0.5 - _SLACK_PX, float(window[0])),
        max(bounds[1] - 0.5 - _SLACK_PX, float(window[1])),
        min(bounds[2] + 0.5 + _SLACK_PX, float(window[2])),
        min(bounds[3] + 0.5 + _SLACK_PX, float(window[3])),
    )


@kernel
def pixels_within(bounds: Bounds, window: Window) -> Window:
    """Pixels of a window whose centres lie within bounds.

    Zeros if there are none.
    """
    left, top, right, bottom = _edges_within(bounds, window)
    if not (left < right and top < bottom):
        return 0, 0, 0, 0
    # No number is negative: cutting off rounds down.
    return int(np.ceil(left)), int(np.ceil(top)), int(right), int(bottom)


@kernel
def cross(p: Point, q: Point) -> Point:
    """Vector product."""
    return (
        p[1] * q[2] - p[2] * q[1],
        p[2] * q[0] - p[0] * q[2],
        p[0] * q[1] - p[1] * q[0],
    )


@kernel
def dot(p: Point, q: Point) -> float:
    """Scalar product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@kernel
def find_edges(a: Point, b: Point, c: Point) -> tuple[Edges, float]:
    """Edge planes of a triangle, and its volume with the lens.

    Parameters
    ----------
    a, b, c : Point
        Corners. [m]

    Returns
    -------
    edges : Edges
        Normals of the planes through the lens and each edge. A direction that the
        triangle covers ahead of the lens is on the positive side of all three.
    volume : float
        a . (b x c), made positive. [m^3]
    """
    volume = dot(a, cross(b, c))
    if volume < 0.0:
        return (cross(c, b), cross(a, c), cross(b, a)), -volume
    return (cross(b, c), cross(c, a), cross(a, b)), volume


@kernel
def depth_at(
    image: Image, edges: Edges, volume: float, is_near: bool, across: float, down: float
) -> float:
    """Depth of a triangle in a direction.

    Parameters
    ----------
    image : Image
        Its near limit counts.
    edges, volume : Edges, float
        As :func:`find_edges` returns them.
    is_near : bool
        Some part of the triangle is not as deep as the near limit.
    across, down : float
        The direction, at depth 1.

    Returns
    -------
    depth : float
        Infinite where the triangle does not cover the direction, or is too near. [m]
    """
    direction = (across, down, 1.0)
    first = dot(edges[0], direction)
    second = dot(edges[1], direction)
    third = dot(edges[2], direction)
    total = first + second + third
    if first < 0.0 or second < 0.0 or third < 0.0 or total <= 0.0:
        return np.inf
    depth: float = volume / total
    if is_near and depth * np.sqrt(1.0 + across * across + down * down) < image.near_m:
        return np.inf
    return depth


@kernel
def _passes_by(
    image: Image, edges: Edges, volume: float, window: Window, farthest_m: float
) -> bool:
    """True if a triangle misses a beam, by one plane that separates them.

    The planes are that of the triangle, and those through the lens and each edge.

    Parameters
    ----------
    image : Image
        The camera.
    edges, volume : Edges, float
        As :func:`find_edges` returns them.
    window : Window
        Section of the beam in the image.
    farthest_m : float
        Depth of the beam. [m]
    """
    n_before = 0
    n_first = 0
    n_second = 0
    n_third = 0
    # Count on which side of each plane the corners of the window lie.
    for corner in range(4):
        if corner < 2:
            x = window[0]
        else:
            x = window[2]
        if corner % 2 == 0:
            y = window[1]
        else:
            y = window[3]
        direction = (
            (x - 0.5 * image.width_px) / image.focal_px,
            (y - 0.5 * image.height_px) / image.focal_px,
            1.0,
        )
        first = dot(edges[0], direction)
        second = dot(edges[1], direction)
        third = dot(edges[2], direction)
        n_first += first < 0.0
        n_second += second < 0.0
        n_third += third < 0.0
        n_before += (first + second + third) * farthest_m < volume
    return n_before == 4 or n_first == 4 or n_second == 4 or n_third == 4


@kernel
def _is_beside(edges: Edges, hull: FloatArray) -> bool:
    """True if a triangle and a convex hull share no direction from the lens.

    That is so if all corners of the hull (3, n) are beyond one of the planes through
    the lens and an edge.
    """
    for edge in edges:
        is_beyond = True
        for column in range(hull.shape[1]):
            if dot(edge, corner(hull, column)) >= -_SURE_M3:
                is_beyond = False
                break
        if is_beyond:
            return True
    return False


# ---------- the image
@kernel
def _least_depth(image: Image, window: Window) -> float:
    """Depth before which nothing is drawn in any pixel of a window."""
    half_width = 0.5 * image.width_px
    half_height = 0.5 * image.height_px
    across = max(half_width - window[0], window[2] - half_width) / image.focal_px
    down = max(half_height - window[1], window[3] - half_height) / image.focal_px
    depth: float = image.near_m / np.sqrt(1.0 + across * across + down * down)
    return depth


@kernel
def _to_camera(
    turn: FloatArray, shift: FloatArray, points: FloatArray, axes: FloatArray
) -> None:
    """Write points (3, n) in the camera frame: rows right, down, ahead.

    Axis by axis, so that many points at once become vector instructions.
    """
    for axis in range(3):
        x_share = turn[axis, 0]
        y_share = turn[axis, 1]
        z_share = turn[axis, 2]
        offset = shift[axis]
        for place in range(points.shape[1]):
            x = points[0, place]
            y = points[1, place]
            z = points[2, place]
            axes[axis, place] = x_share * x + y_share * y + z_share * z + offset


@kernel
def _find_extremes(values: FloatArray) -> tuple[float, float]:
    """Least and greatest value; numpy's own take numba long to compile."""
    least = np.inf
    most = -np.inf
    for value in values:
        least = min(least, value)
        most = max(most, value)
    return least, most


@kernel
def find_crop(
    image: Image, hull: FloatArray, min_height_px: float
) -> tuple[Window, float]:
    """Find the part of the image that holds a body.

    Parameters
    ----------
    image : Image
        The camera.
    hull : (3, n) float
        Corners of the body's convex hull, camera frame. [m]
    min_height_px : float
        Least height of the part. [px]

    Returns
    -------
    crop : Window
        A pixel larger than the hull; zeros where the body is outside the field of view
        or the part is not so high; the whole image where the body reaches behind the
        lens.
    inside : float
        Share of the body's box that the image's edges do not cut off; 0 where the body
        reaches behind the lens.
    """
    n = hull.shape[1]
    half_width = 0.5 * image.width_px
    half_height = 0.5 * image.height_px
    n_left = 0
    n_right = 0
    n_above = 0
    n_below = 0
    n_behind = 0
    nearest = np.inf
    # Count the corners of the hull beyond each edge of the image.
    for row in range(n):
        # The planes through the lens and the image's edges: they also hold behind the
        # lens.
        across = hull[0, row]
        down = hull[1, row]
        depth = hull[2, row]
        n_left += -image.focal_px * across > half_width * depth
        n_right += image.focal_px * across > half_width * depth
        n_above += -image.focal_px * down > half_height * depth
        n_below += image.focal_px * down > half_height * depth
        n_behind += depth <= 0.0
        nearest = min(nearest, depth)
    is_outside = (
        n_left == n or n_right == n or n_above == n or n_below == n or n_behind == n
    )
    if nearest <= _MIN_DEPTH_M:
        if is_outside or image.height_px < min_height_px:
            return (0, 0, 0, 0), 0.0
        return (0, 0, image.width_px, image.height_px), 0.0
    x_min = np.inf
    x_max = -np.inf
    y_min = np.inf
    y_max = -np.inf
    # All corners are ahead: bound their projections.
    for row in range(n):
        scale = image.focal_px / hull[2, row]
        x = half_width + scale * hull[0, row]
        y = half_height + scale * hull[1, row]
        x_min = min(x_min, x)
        x_max = max(x_max, x)
        y_min = min(y_min, y)
        y_max = max(y_max, y)
    left = max(x_min, 0.0)
    right = min(x_max, float(image.width_px))
    top = max(y_min, 0.0)
    bottom = min(y_max, float(image.height_px))
    inside = max(right - left, 0.0) / max(x_max - x_min, 1.0e-9)
    inside *= max(bottom - top, 0.0) / max(y_max - y_min, 1.0e-9)
    if is_outside:
        return (0, 0, 0, 0), inside
    # A pixel larger on every side, as far as the image goes.
    x_low = 0
    y_low = 0
    if left >= 1.0:
        x_low = int(np.floor(left)) - 1
    if top >= 1.0:
        y_low = int(np.floor(top)) - 1
    x_high = min(int(np.ceil(right)) + 1, image.width_px)
    y_high = min(int(np.ceil(bottom)) + 1, image.height_px)
    if x_low >= x_high or y_low >= y_high or y_high - y_low < min_height_px:
        return (0, 0, 0, 0), inside
    return (x_low, y_low, x_high, y_high), inside


# ---------- the VRU
class _Vru(NamedTuple):
    """The VRU as a camera has it before it.

    Attributes
    ----------
    points : (3, n_vertices) float
        Vertices, camera frame. [m]
    triangles : (n_triangles, 3) int
        Columns of `points`.
    """

    points: FloatArray
    triangles: IntArray


@kernel
def _project(
    image: Image, points: FloatArray, least_depth: float, pixels: FloatArray
) -> bool:
    """Project points (3, n) to columns and rows (2, n).

    Returns True if all are ahead; otherwise not all that is written makes sense.
    """
    half_width = 0.5 * image.width_px
    half_height = 0.5 * image.height_px
    n_behind = 0
    for place in range(points.shape[1]):
        depth = points[2, place]
        scale = image.focal_px / depth
        pixels[0, place] = half_width + scale * points[0, place]
        pixels[1, place] = half_height + scale * points[1, place]
        n_behind += depth < least_depth
    return n_behind == 0


@kernel
def _bounds(pixels: FloatArray, i: int, j: int, k: int) -> Bounds:
    """Bounds of a triangle whose corners are all ahead.

    The same as those of :func:`find_span`, from corners that are projected already.
    """
    return (
        min(pixels[0, i], pixels[0, j], pixels[0, k]),
        min(pixels[1, i], pixels[1, j], pixels[1, k]),
        max(pixels[0, i], pixels[0, j], pixels[0, k]),
        max(pixels[1, i], pixels[1, j], pixels[1, k]),
    )


@kernel
def _area_px2(pixels: FloatArray, i: int, j: int, k: int) -> float:
    """Twice the area of a triangle in the image; negative where its front is seen."""
    x = pixels[0, i]
    y = pixels[1, i]
    first = (pixels[0, j] - x) * (pixels[1, k] - y)
    second = (pixels[0, k] - x) * (pixels[1, j] - y)
    area: float = first - second
    return area


@kernel
def _find_shown(
    pixels: FloatArray,
    triangles: IntArray,
    window: Window,
    has_backs: bool,
    shown: IntArray,
) -> int:
    """Find the triangles that may cover a pixel of a window; return how many.

    Most of a distant body's triangles do not: they are backs, or lie between the
    centres of pixels. The loop has no branch, since processors predict this one badly.

    Parameters
    ----------
    pixels : (2, n_vertices) float
        Vertices in the image, all ahead. [px]
    triangles : (n_triangles, 3) int
        Columns of `pixels`.
    window : Window
        Where to look.
    has_backs : bool
        True if triangles whose back is seen count, too.
    shown : (n_triangles,) int
        Written: the triangles, first in it.
    """
    n_shown = 0
    for row in range(len(triangles)):
        i = triangles[row, 0]
        j = triangles[row, 1]
        k = triangles[row, 2]
        bounds = _bounds(pixels, i, j, k)
        left, top, right, bottom = _edges_within(bounds, window)
        is_wide = np.ceil(left) < np.floor(right)
        is_high = np.ceil(top) < np.floor(bottom)
        # Most backs are told by their corners in the image.
        is_back = _area_px2(pixels, i, j, k) > _SURE_PX2
        shown[n_shown] = row
        n_shown += is_wide & is_high & (has_backs | (not is_back))
    return n_shown


@kernel
def find_box(image: Image, points: FloatArray, skin: Skin, window: Window) -> Window:
    """Box around the pixels of a window that a body covers.

    Parameters
    ----------
    image : Image
        The camera.
    points : (3, n_vertices) float
        Vertices of the body's skin, camera frame. [m]
    skin : Skin
        The body.
    window : Window
        Where to look.

    Returns
    -------
    box : Window
        Zeros if the body covers no pixel.

    Notes
    -----
    A triangle that makes the box larger has a corner outside of it: since the corners
    are shuffled, few triangles are drawn.
    """
    least_depth = _least_depth(image, window)
    pixels = np.empty((2, points.shape[1]))
    is_ahead = _project(image, points, least_depth, pixels)
    middle_x = 0.5 * image.width_px - 0.5
    middle_y = 0.5 * image.height_px - 0.5
    per_px = 1.0 / image.focal_px
    x_low = image.width_px
    y_low = image.height_px
    x_high = 0
    y_high = 0
    # Vertices within these bounds lie in the box already.
    left = np.inf
    top = np.inf
    right = -np.inf
    bottom = -np.inf
    # Loop over the vertices of the skin, and the triangles at each.
    for vertex in range(points.shape[1]):
        if is_ahead:
            column = pixels[0, vertex]
            line = pixels[1, vertex]
            if left < column < right and top < line < bottom:
                continue
        for place in range(skin.fan_start[vertex], skin.fan_start[vertex + 1]):
            row = skin.fans[place]
            i = skin.triangles[row, 0]
            j = skin.triangles[row, 1]
            k = skin.triangles[row, 2]
            a = corner(points, i)
            b = corner(points, j)
            c = corner(points, k)
            if is_ahead:
                bounds = _bounds(pixels, i, j, k)
            else:
                bounds = find_span(image, least_depth, a, b, c)
            x_min, y_min, x_max, y_max = pixels_within(bounds, window)
            if x_min >= x_max or y_min >= y_max:
                continue
            if (
                x_min >= x_low
                and x_max <= x_high
                and y_min >= y_low
                and y_max <= y_high
            ):
                continue
            edges, volume = find_edges(a, b, c)
            is_near = min(min(a[2], b[2]), c[2]) < image.near_m
            for y in range(y_min, y_max):
                down = (y - middle_y) * per_px
                # From both ends to the first that is covered: what is between them is
                # in the box.
                stop = x_max
                if y_low <= y < y_high:
                    stop = min(x_max, x_low)
                x = x_min
                while x < stop:
                    across = (x - middle_x) * per_px
                    if depth_at(image, edges, volume, is_near, across, down) < np.inf:
                        x_low = min(x_low, x)
                        x_high = max(x_high, x + 1)
                        y_low = min(y_low, y)
                        y_high = max(y_high, y + 1)
                        break
                    x += 1
                if x >= x_max:
                    continue
                x = x_max - 1
                while x >= max(x_min, x_high):
                    across = (x - middle_x) * per_px
                    if depth_at(image, edges, volume, is_near, across, down) < np.inf:
                        x_high = x + 1
                        break
                    x -= 1
        # Where the box touches the edge of the window, nothing can make it larger.
        if x_low < x_high:
            left = -np.inf
            top = -np.inf
            right = np.inf
            bottom = np.inf
            if x_low > window[0]:
                left = x_low - 0.5 + _SLACK_PX
            if x_high < window[2]:
                right = x_high + 0.5 - _SLACK_PX
            if y_low > window[1]:
                top = y_low - 0.5 + _SLACK_PX
            if y_high < window[3]:
                bottom = y_high + 0.5 - _SLACK_PX
    if x_low >= x_high:
        return 0, 0, 0, 0
    return x_low, y_low, x_high, y_high


@kernel
def _draw_line(
    edges: Edges,
    volume: float,
    first_px: float,
    per_px: float,
    down: float,
    line: FloatArray,
) -> None:
    """Draw a row of pixels as :func:`depth_at` does, without a branch."""
    ax, ay, az = edges[0]
    bx, by, bz = edges[1]
    cx, cy, cz = edges[2]
    a_down = ay * down
    b_down = by * down
    c_down = cy * down
    for place in range(len(line)):
        across = (first_px + place) * per_px
        first = ax * across + a_down + az
        second = bx * across + b_down + bz
        third = cx * across + c_down + cz
        total = first + second + third
        is_covered = (first >= 0.0) & (second >= 0.0) & (third >= 0.0) & (total > 0.0)
        depth = volume / total
        before = line[place]
        is_nearer = is_covered & (depth < before)
        line[place] = depth if is_nearer else before


@kernel
def draw(
    image: Image,
    points: FloatArray,
    triangles: IntArray,
    window: Window,
    depth_m: FloatArray,
) -> None:
    """Draw a closed body in a window of the image.

    Parameters
    ----------
    image : Image
        The camera.
    points : (3, n_vertices) float
        Vertices, camera frame. [m]
    triangles : (n_triangles, 3) int
        Columns of `points`.
    window : Window
        Where to draw.
    depth_m : (n_pixels,) float
        Depths in the pixels of the window, row by row; lowered where the body is
        nearer. [m]

    Notes
    -----
    Triangles whose back is seen lie behind others, unless those are too near to be
    drawn.
    """
    least_depth = _least_depth(image, window)
    pixels = np.empty((2, points.shape[1]))
    is_ahead = _project(image, points, least_depth, pixels)
    nearest_m, _ = _find_extremes(points[2])
    has_backs = nearest_m < image.near_m
    width = window[2] - window[0]
    middle_x = 0.5 * image.width_px - 0.5
    middle_y = 0.5 * image.height_px - 0.5
    per_px = 1.0 / image.focal_px
    shown = np.empty(len(triangles), dtype=np.int64)
    if is_ahead:
        n_shown = _find_shown(pixels, triangles, window, has_backs, shown)
    else:
        n_shown = len(triangles)
        for row in range(n_shown):
            shown[row] = row
    # Loop over the triangles, and the pixels that each may cover.
    for row in shown[:n_shown]:
        i = triangles[row, 0]
        j = triangles[row, 1]
        k = triangles[row, 2]
        a = corner(points, i)
        b = corner(points, j)
        c = corner(points, k)
        if is_ahead:
            bounds = _bounds(pixels, i, j, k)
        else:
            bounds = find_span(image, least_depth, a, b, c)
        x_min, y_min, x_max, y_max = pixels_within(bounds, window)
        if x_min >= x_max or y_min >= y_max:
            continue
        if not has_backs and dot(a, cross(b, c)) > 0.0:
            continue
        edges, volume = find_edges(a, b, c)
        is_near = min(min(a[2], b[2]), c[2]) < image.near_m
        first_px = x_min - middle_x
        for y in range(y_min, y_max):
            down = (y - middle_y) * per_px
            start = (y - window[1]) * width + x_min - window[0]
            line = depth_m[start : start + x_max - x_min]
            if is_near:
                for place in range(len(line)):
                    across = (first_px + place) * per_px
                    depth = depth_at(image, edges, volume, is_near, across, down)
                    line[place] = min(line[place], depth)
            else:
                _draw_line(edges, volume, first_px, per_px, down, line)


@kernel
def _draw_in(image: Image, vru: _Vru, window: Window) -> FloatArray:
    """Depths of the VRU in a window, (n_pixels,): infinite where it is not."""
    depth_m = np.full((window[2] - window[0]) * (window[3] - window[1]), np.inf)
    draw(image, vru.points, vru.triangles, window, depth_m)
    return depth_m


@kernel
def _count_pixels(depth_m: FloatArray) -> int:
    """How many pixels show the VRU."""
    n_pixels = 0
    for pixel in range(len(depth_m)):
        n_pixels += depth_m[pixel] < np.inf
    return n_pixels


@kernel
def _box_around(depth_m: FloatArray, window: Window) -> Window:
    """Box around the pixels of a window that show the VRU; zeros if none does.

    Parameters
    ----------
    depth_m : (n_pixels,) float
        Depths in the window, row by row; infinite where the VRU is not seen. [m]
    window : Window
        The window.
    """
    width = window[2] - window[0]
    height = window[3] - window[1]
    x_min = width
    y_min = height
    x_max = 0
    y_max = 0
    # Loop over the pixels of the window.
    for y in range(height):
        for x in range(width):
            if depth_m[y * width + x] < np.inf:
                x_min = min(x_min, x)
                x_max = max(x_max, x + 1)
                y_min = min(y_min, y)
                y_max = max(y_max, y + 1)
    if x_max == 0:
        return 0, 0, 0, 0
    return window[0] + x_min, window[1] + y_min, window[0] + x_max, window[1] + y_max


# ---------- what hides it
@kernel
def _set_beam(
    image: Image,
    box: Window,
    farthest_m: float,
    turn: FloatArray,
    shift: FloatArray,
    planes: FloatArray,
) -> None:
    """Write the planes of the beam through a box, in a body's frame.

    Parameters
    ----------
    image : Image
        The camera.
    box : Window
        Section of the beam in the image.
    farthest_m : float
        Depth of the beam. [m]
    turn, shift : (3, 3), (3,) float
        From the body's frame to the camera's.
    planes : (6, 4) float
        Written: normal and constant of each plane. A point is outside where one of
        normal . point + constant is positive.
    """
    half_width = 0.5 * image.width_px
    half_height = 0.5 * image.height_px
    # Normal and constant of each plane, camera frame.
    normal = np.zeros((_N_PLANES, 4))
    # Left of the box, right of it, above, and below.
    normal[0, 0] = -1.0
    normal[0, 2] = (box[0] - half_width) / image.focal_px
    normal[1, 0] = 1.0
    normal[1, 2] = (half_width - box[2]) / image.focal_px
    normal[2, 1] = -1.0
    normal[2, 2] = (box[1] - half_height) / image.focal_px
    normal[3, 1] = 1.0
    normal[3, 2] = (half_height - box[3]) / image.focal_px
    # Behind the beam, and before it.
    normal[4, 2] = 1.0
    normal[4, 3] = -farthest_m
    normal[5, 2] = -1.0
    normal[5, 3] = _least_depth(image, box)
    # Take the planes into the body's frame.
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
    planes: FloatArray,
    low_m: float,
    high_m: float,
    low: FloatArray,
    high: FloatArray,
    node: int,
) -> bool:
    """True if a node's box lies outside of a beam.

    Outside is beyond one of the planes, or not between two heights.

    Parameters
    ----------
    planes : (6, 4) float
        As :func:`_set_beam` writes them.
    low_m, high_m : float
        Heights in the body's frame. [m]
    low, high : (n_nodes, 3) float
        Boxes of all nodes. [m]
    node : int
        The node.
    """
    if high[node, 2] <= low_m or low[node, 2] >= high_m:
        return True
    # Of each plane, look at the corner of the box that is least outside.
    for plane in range(_N_PLANES):
        value = planes[plane, 3]
        for axis in range(3):
            normal = planes[plane, axis]
            if normal > 0.0:
                value += normal * low[node, axis]
            else:
                value += normal * high[node, axis]
        if value > 0.0:
            return True
    return False


class _Beam(NamedTuple):
    """The pyramid from the lens through pixels that may show the VRU.

    Attributes
    ----------
    section : Window
        The pixels.
    farthest_m : float
        Nothing deeper is looked at: the VRU ends there. [m]
    lowest_m, highest_m : float
        Heights between which everything lies that may hide the VRU, in the frame in
        which the camera stands. [m]
    hull : (3, n) float
        Corners of the VRU's convex hull, camera frame. [m]
    """

    section: Window
    farthest_m: float
    lowest_m: float
    highest_m: float
    hull: FloatArray


class _Occluder(NamedTuple):
    """A body that may hide the VRU, at its place.

    Attributes
    ----------
    tree : Tree
        Triangles of one body, or of several.
    root : int
        Node at which the tree of the body begins.
    turn, shift : (3, 3), (3,) float
        From the body's frame to the camera's.
    up_m : float
        Height of the body's origin. [m]
    """

    tree: Tree
    # A number that numba takes for a constant would have kernels compiled twice.
    root: int | np.int64
    turn: FloatArray
    shift: FloatArray
    up_m: float


@kernel
def _corner_of(body: _Occluder, row: int, place: int) -> Point:
    """A corner of a triangle in the camera frame."""
    turn = body.turn
    shift = body.shift
    x = body.tree.corners_m[row, place, 0]
    y = body.tree.corners_m[row, place, 1]
    z = body.tree.corners_m[row, place, 2]
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0],
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1],
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2],
    )


@kernel
def _find_in_front(
    image: Image, body: _Occluder, beam: _Beam, rows: IntArray
) -> tuple[int, Window]:
    """Find the triangles of a body that may hide a pixel of the VRU.

    They cover a pixel of the beam before the VRU ends, and not just beside it.

    Parameters
    ----------
    image : Image
        The camera.
    body : _Occluder
        The body.
    beam : _Beam
        Where to look.
    rows : (n_triangles,) int
        Written: the triangles.

    Returns
    -------
    n_found : int
        How many they are.
    window : Window
        Outside of it they cover no pixel of the beam; zeros if there are none.
    """
    if len(body.tree.second) == 0:
        return 0, (0, 0, 0, 0)
    section = beam.section
    planes = np.empty((_N_PLANES, 4))
    _set_beam(image, section, beam.farthest_m, body.turn, body.shift, planes)
    low_m = beam.lowest_m - body.up_m + _TOUCH_M
    high_m = beam.highest_m - body.up_m
    least_depth = _least_depth(image, section)
    middle_x = 0.5 * image.width_px - 0.5
    middle_y = 0.5 * image.height_px - 0.5
    per_px = 1.0 / image.focal_px
    n_found = 0
    left = section[2]
    top = section[3]
    right = section[0]
    bottom = section[1]
    waiting = np.empty(_MAX_OPEN, dtype=np.int64)
    waiting[0] = body.root
    n_waiting = 1
    # Loop over the nodes whose boxes may reach into the beam.
    while n_waiting:
        n_waiting -= 1
        node = waiting[n_waiting]
        if _is_outside(planes, low_m, high_m, body.tree.low_m, body.tree.high_m, node):
            continue
        if body.tree.second[node] >= 0:
            # The first child comes on top, and is looked at next.
            waiting[n_waiting] = body.tree.second[node]
            waiting[n_waiting + 1] = node + 1
            n_waiting += 2
            continue
        # Loop over the triangles of a leaf.
        for row in range(body.tree.start[node], body.tree.end[node]):
            a = _corner_of(body, row, 0)
            b = _corner_of(body, row, 1)
            c = _corner_of(body, row, 2)
            bounds = find_span(image, least_depth, a, b, c)
            x_min, y_min, x_max, y_max = pixels_within(bounds, section)
            if x_min >= x_max or y_min >= y_max:
                continue
            edges, volume = find_edges(a, b, c)
            if volume == 0.0 or _passes_by(
                image, edges, volume, section, beam.farthest_m
            ):
                continue
            is_near = min(min(a[2], b[2]), c[2]) < image.near_m
            is_found = False
            # Loop over the pixels within the triangle's bounds, up to the first hit.
            for y in range(y_min, y_max):
                down = (y - middle_y) * per_px
                for x in range(x_min, x_max):
                    across = (x - middle_x) * per_px
                    depth = depth_at(image, edges, volume, is_near, across, down)
                    if depth <= beam.farthest_m:
                        is_found = True
                        break
                if is_found:
                    break
            if is_found and not _is_beside(edges, beam.hull):
                rows[n_found] = row
                n_found += 1
                left = min(left, x_min)
                top = min(top, y_min)
                right = max(right, x_max)
                bottom = max(bottom, y_max)
    if n_found == 0:
        return 0, (0, 0, 0, 0)
    return n_found, (left, top, right, bottom)


@kernel
def _hide(
    image: Image, body: _Occluder, rows: IntArray, window: Window, depth_m: FloatArray
) -> None:
    """Hide what triangles of a body are in front of.

    Parameters
    ----------
    image : Image
        The camera.
    body : _Occluder
        The body.
    rows : (n,) int
        Its triangles.
    window : Window
        Pixels to look at.
    depth_m : (n_pixels,) float
        Depths of the VRU in these pixels, row by row. Those of pixels that the
        triangles cover at no greater depth become infinite. [m]
    """
    least_depth = _least_depth(image, window)
    middle_x = 0.5 * image.width_px - 0.5
    middle_y = 0.5 * image.height_px - 0.5
    per_px = 1.0 / image.focal_px
    width = window[2] - window[0]
    for row in rows:
        a = _corner_of(body, row, 0)
        b = _corner_of(body, row, 1)
        c = _corner_of(body, row, 2)
        bounds = find_span(image, least_depth, a, b, c)
        x_min, y_min, x_max, y_max = pixels_within(bounds, window)
        edges, volume = find_edges(a, b, c)
        is_near = min(min(a[2], b[2]), c[2]) < image.near_m
        # Loop over the pixels of the window within the triangle's bounds.
        for y in range(y_min, y_max):
            down = (y - middle_y) * per_px
            start = (y - window[1]) * width - window[0]
            for x in range(x_min, x_max):
                before_m = depth_m[start + x]
                if before_m == np.inf:
                    continue
                across = (x - middle_x) * per_px
                depth = depth_at(image, edges, volume, is_near, across, down)
                if depth <= before_m:
                    depth_m[start + x] = np.inf


# ---------- many sights
class _Drawn(NamedTuple):
    """The whole VRU, drawn in its box when it is first needed.

    Attributes
    ----------
    depth_m : (n_pixels,) or (0,) float
        Depths in the box; empty: not drawn so far. [m]
    n_pixels : int
        Pixels of the whole VRU, whatever is hidden since.
    """

    depth_m: FloatArray
    n_pixels: int | np.int64


@kernel
def _find_hiding(
    image: Image,
    vru: _Vru,
    body: _Occluder,
    beam: _Beam,
    drawn: _Drawn,
    rows: IntArray,
) -> tuple[int, _Drawn]:
    """Find the triangles of a body that may hide a part of the VRU, and draw it then.

    Parameters
    ----------
    image : Image
        The camera.
    vru : _Vru
        The VRU.
    body : _Occluder
        What may hide it.
    beam : _Beam
        Its section is the box of the whole VRU.
    drawn : _Drawn
        The VRU as far as it is drawn.
    rows : (n_triangles,) int
        Written: the triangles.

    Returns
    -------
    n_found : int
        How many they are.
    drawn : _Drawn
        The VRU, drawn if any are found.

    Notes
    -----
    Drawing takes longest. If a body covers only a corner of the box, where the VRU
    mostly is not, just that corner is drawn, to see if anything is hidden there.
    """
    box = beam.section
    n_found, window = _find_in_front(image, body, beam, rows)
    if n_found == 0 or len(drawn.depth_m):
        return n_found, drawn
    area = (window[2] - window[0]) * (window[3] - window[1])
    whole_area = (box[2] - box[0]) * (box[3] - box[1])
    if _WORTH_A_LOOK * area <= whole_area:
        part_m = _draw_in(image, vru, window)
        n_before = _count_pixels(part_m)
        _hide(image, body, rows[:n_found], window, part_m)
        if _count_pixels(part_m) == n_before:
            return 0, drawn
    depth_m = _draw_in(image, vru, box)
    return n_found, _Drawn(depth_m, _count_pixels(depth_m))


@kernel
def _set_box(boxes: FloatArray, row: int, box: Window) -> None:
    """Write a box into a row of boxes, (n, 4)."""
    for side, edge_px in enumerate(box):
        boxes[row, side] = edge_px


@kernel
def see(
    image: Image,
    min_height_px: float,
    skin: Skin,
    hull_m: FloatArray,
    standing: Tree,
    parked: Tree,
    vehicles: Vehicles,
    sights: Sights,
    seen: SeenBoxes,
) -> None:
    """Fill boxes and shares of one VRU's body in one static world.

    Parameters
    ----------
    image : Image
        The camera.
    min_height_px : float
        Where the VRU's part of the image is lower, boxes stay zeros. [px]
    skin : Skin
        Triangles of the VRU, body frame.
    hull_m : (3, n) float
        Corners of its convex hull, body frame. [m]
    standing, parked : Tree
        The scene, and what is parked in it.
    vehicles : Vehicles
        All kinds of vehicles that move.
    sights : Sights
        Where everything is.
    seen : SeenBoxes
        Blank; written.
    """
    hull = np.empty(hull_m.shape)
    points = np.empty(skin.vertices_m.shape)
    vru = _Vru(points, skin.triangles)
    n_rows = max(
        len(standing.corners_m), len(parked.corners_m), len(vehicles.tree.corners_m)
    )
    rows = np.empty(n_rows, dtype=np.int64)
    foot_m, top_m = _find_extremes(hull_m[2])
    # Loop over the sights: places of the VRU among what stands still.
    for sight in range(len(sights.vru.shift)):
        turn = sights.vru.turn[sight]
        shift = sights.vru.shift[sight]
        _to_camera(turn, shift, hull_m, hull)
        crop, inside_share = find_crop(image, hull, min_height_px)
        seen.inside_share[sight] = inside_share
        if crop[2] == 0:
            continue
        _to_camera(turn, shift, skin.vertices_m, points)
        box = find_box(image, points, skin, crop)
        if box[2] == 0:
            continue
        _set_box(seen.amodal_px, sight, box)
        vru_m = sights.vru.up_m[sight]
        # Between these heights is all that may hide it.
        lowest_m = min(image.up_m, foot_m + vru_m)
        highest_m = max(image.up_m, top_m + vru_m)
        _, farthest_m = _find_extremes(hull[2])
        beam = _Beam(box, max(0.0, farthest_m), lowest_m, highest_m, hull)
        _see_sight(
            image,
            vru,
            beam,
            (standing, parked),
            vehicles,
            sights,
            sight,
            rows,
            seen,
        )


@kernel
def _see_sight(
    image: Image,
    vru: _Vru,
    beam: _Beam,
    still: tuple[Tree, Tree],
    vehicles: Vehicles,
    sights: Sights,
    sight: int,
    rows: IntArray,
    seen: SeenBoxes,
) -> None:
    """Fill what is visible in one sight, and in its frames.

    Parameters
    ----------
    image : Image
        The camera.
    vru : _Vru
        The VRU.
    beam : _Beam
        Its section is the box of the whole VRU.
    still : (Tree, Tree)
        The scene, and what is parked in it.
    vehicles : Vehicles
        All kinds of vehicles that move.
    sights : Sights
        Where everything is.
    sight : int
        The sight.
    rows : (n_triangles,) int
        Room for the triangles of any body.
    seen : SeenBoxes
        Written.
    """
    box = beam.section
    # The VRU, less what stands still hides.
    drawn = _Drawn(np.empty(0), np.int64(0))
    turn = sights.static.turn[sight]
    shift = sights.static.shift[sight]
    up_m = sights.static.up_m[sight]
    for tree in still:
        body = _Occluder(tree, np.int64(0), turn, shift, up_m)
        n_found, drawn = _find_hiding(image, vru, body, beam, drawn, rows)
        if n_found:
            _hide(image, body, rows[:n_found], box, drawn.depth_m)
    visible = box
    share = 1.0
    if len(drawn.depth_m):
        visible = _box_around(drawn.depth_m, box)
        share = _count_pixels(drawn.depth_m) / drawn.n_pixels
    _set_box(seen.visible_px, sight, visible)
    seen.visible_share[sight] = share
    # Loop over the frames of the sight, which differ by the vehicles that move.
    for frame in range(sights.frame_start[sight], sights.frame_start[sight + 1]):
        _set_box(seen.frame_visible_px, frame, visible)
        seen.frame_visible_share[frame] = share
        if visible[2] == 0:
            continue
        left_m = drawn.depth_m
        is_hidden = False
        for row in range(sights.vehicle_start[frame], sights.vehicle_start[frame + 1]):
            vehicle = _Occluder(
                vehicles.tree,
                vehicles.roots[sights.vehicle_kind[row]],
                sights.vehicles.turn[row],
                sights.vehicles.shift[row],
                sights.vehicles.up_m[row],
            )
            n_found, drawn = _find_hiding(image, vru, vehicle, beam, drawn, rows)
            if n_found == 0:
                continue
            if not is_hidden:
                left_m = drawn.depth_m.copy()
            is_hidden = True
            _hide(image, vehicle, rows[:n_found], box, left_m)
        if is_hidden:
            _set_box(seen.frame_visible_px, frame, _box_around(left_m, box))
            seen.frame_visible_share[frame] = _count_pixels(left_m) / drawn.n_pixels


# ---------- trees of boxes around triangles
def build_tree(corners_m: FloatArray) -> Tree:
    """Build the tree of boxes around triangles (n, 3, 3)."""
    n = len(corners_m)
    n_nodes = max(0, 2 * n - 1)
    tree = Tree(
        corners_m,
        np.full((n_nodes, 3), np.inf),
        np.full((n_nodes, 3), -np.inf),
        second=np.full(n_nodes, -1, dtype=np.int64),
        start=np.zeros(n_nodes, dtype=np.int64),
        end=np.zeros(n_nodes, dtype=np.int64),
    )
    order = np.arange(n)
    centres_m = 0.5 * (corners_m.min(axis=1) + corners_m.max(axis=1))
    n_used = _fill(tree, order, centres_m)
    # Leaves hold several triangles: not all nodes are needed.
    used: list[Any] = [numbers[:n_used].copy() for numbers in tree[1:]]
    return Tree(corners_m[order], *used)


def join_vehicles(trees: Sequence[Tree]) -> Vehicles:
    """Put the trees of bodies one after the other."""
    roots = np.cumsum([0, *(len(tree.second) for tree in trees)])[:-1]
    firsts = np.cumsum([0, *(len(tree.corners_m) for tree in trees)])[:-1]
    moved = [
        tree._replace(
            second=np.where(tree.second < 0, -1, tree.second + root),
            start=tree.start + first,
            end=tree.end + first,
        )
        for tree, root, first in zip(trees, roots, firsts, strict=True)
    ]
    joined = [np.concatenate(parts) for parts in zip(*moved, strict=True)]
    return Vehicles(tree=Tree(*joined), roots=roots)


@kernel
def _fill(tree: Tree, order: IntArray, centres_m: FloatArray) -> int:
    """Fill a tree and sort the triangles; return the number of nodes.

    A node is split in the middle of its triangles' centres along their largest
    extent; in number where that would leave a side empty, or the tree grow too
    deep.

    Parameters
    ----------
    tree : Tree
        Its corners are given; everything else is written, with room for all nodes.
    order : (n,) int
        Triangles, leaf by leaf; sorted in place.
    centres_m : (n, 3) float
        Middles of the triangles' boxes. [m]
    """
    begins = np.empty(_MAX_OPEN, dtype=np.int64)
    ends = np.empty(_MAX_OPEN, dtype=np.int64)
    # The node whose second child each is; -1 for a first child.
    parents = np.empty(_MAX_OPEN, dtype=np.int64)
    begins[0] = 0
    ends[0] = len(order)
    parents[0] = -1
    n_open = 0
    if len(order):
        n_open = 1
    n_used = 0
    # Loop over the nodes, parents before their children.
    while n_open:
        n_open -= 1
        begin = begins[n_open]
        stop = ends[n_open]
        parent = parents[n_open]
        node = n_used
        n_used += 1
        if parent >= 0:
            tree.second[parent] = node
        tree.start[node] = begin
        tree.end[node] = stop
        # Bound the node, and find the axis along which its centres extend farthest.
        along = 0
        largest_m = -1.0
        middle_m = 0.0
        for axis in range(3):
            least = np.inf
            most = -np.inf
            for place in range(begin, stop):
                row = order[place]
                for corner in range(3):
                    value = tree.corners_m[row, corner, axis]
                    tree.low_m[node, axis] = min(tree.low_m[node, axis], value)
                    tree.high_m[node, axis] = max(tree.high_m[node, axis], value)
                least = min(least, centres_m[row, axis])
                most = max(most, centres_m[row, axis])
            if most - least > largest_m:
                along = axis
                largest_m = most - least
                middle_m = 0.5 * (least + most)
        if stop - begin <= _LEAF_SIZE:
            continue
        # Sort the triangles by the side of the middle on which their centres lie.
        split = begin
        for place in range(begin, stop):
            row = order[place]
            if centres_m[row, along] < middle_m:
                order[place] = order[split]
                order[split] = row
                split += 1
        if split in (begin, stop) or n_open > _MAX_OPEN // 2:
            split = (begin + stop) // 2
        # The first child comes on top, so that it follows its parent.
        begins[n_open] = split
        ends[n_open] = stop
        parents[n_open] = node
        begins[n_open + 1] = begin
        ends[n_open + 1] = split
        parents[n_open + 1] = -1
        n_open += 2
    return n_used
