"""Triangles in an image: which pixels they may cover, how deep they are there, what they keep off.

Corners a, b, c are points of the camera's frame; see :mod:`.pixels` for the method.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import FloatArray
from geometry.kernels import kernel

# Few numbers are tuples, which need no memory: passing arrays costs more than the arithmetic.
Point = tuple[float, float, float]  # right, down, ahead: camera frame. [m]
Edges = tuple[Point, Point, Point]  # normals of planes through the lens
Window = tuple[int, int, int, int]  # first column and row, and those after the last
Bounds = tuple[float, float, float, float]  # x_min, y_min, x_max, y_max. [px]
# Which side of a column is left (1: right of it, -1: left of it, 0: all or nothing), the column in
# the middle row, and how much further to the left it is per unit of `down`.
Cut = tuple[int, float, float]
Cuts = tuple[Cut, Cut, Cut]  # of a triangle's edges

SLACK_PX = 1.0e-6
"""More than rounding moves an edge."""

_ROUNDING = 1.0e-12  # more than such a product is wrong by, as a share of its terms


class Image(NamedTuple):
    """What pixels are: of a camera at its place."""

    focal_px: float
    width_px: int
    height_px: int
    near_m: float  # distance from the lens at which drawing starts
    up_m: float  # height of the lens


@kernel
def corner(points: FloatArray, row: int) -> Point:
    """A row of points (n, 3)."""
    return points[row, 0], points[row, 1], points[row, 2]


@kernel
def find_span(image: Image, least_depth: float, a: Point, b: Point, c: Point) -> Bounds:
    """Bounds of the part of a triangle that is at least so deep; empty if there is none."""
    bounds = (np.inf, np.inf, -np.inf, -np.inf)
    bounds = _with_edge(image, least_depth, a, b, bounds)
    bounds = _with_edge(image, least_depth, b, c, bounds)
    return _with_edge(image, least_depth, c, a, bounds)


@kernel
def _with_edge(image: Image, least_depth: float, p: Point, q: Point, bounds: Bounds) -> Bounds:
    """Bounds stretched by an edge from p to just before q, as far as it is deep enough."""
    if p[2] >= least_depth:
        bounds = _with_point(image, p[0], p[1], p[2], bounds)
    if (p[2] >= least_depth) != (q[2] >= least_depth):
        part = (least_depth - p[2]) / (q[2] - p[2])
        x, y = p[0] + part * (q[0] - p[0]), p[1] + part * (q[1] - p[1])
        bounds = _with_point(image, x, y, least_depth, bounds)
    return bounds


@kernel
def _with_point(image: Image, right: float, down: float, ahead: float, bounds: Bounds) -> Bounds:
    scale = image.focal_px / ahead
    x, y = 0.5 * image.width_px + scale * right, 0.5 * image.height_px + scale * down
    return min(bounds[0], x), min(bounds[1], y), max(bounds[2], x), max(bounds[3], y)


@kernel
def pixels_within(bounds: Bounds, window: Window) -> Window:
    """Pixels of a window whose centres lie within bounds; zeros if there are none."""
    left = max(bounds[0] - 0.5 - SLACK_PX, float(window[0]))
    top = max(bounds[1] - 0.5 - SLACK_PX, float(window[1]))
    right = min(bounds[2] + 0.5 + SLACK_PX, float(window[2]))
    bottom = min(bounds[3] + 0.5 + SLACK_PX, float(window[3]))
    if not (left < right and top < bottom):
        return 0, 0, 0, 0
    # No number is negative: cutting off rounds down.
    return int(np.ceil(left)), int(np.ceil(top)), int(right), int(bottom)


@kernel
def cross(p: Point, q: Point) -> Point:
    """Vector product."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@kernel
def dot(p: Point, q: Point) -> float:
    """Scalar product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@kernel
def find_edges(a: Point, b: Point, c: Point) -> tuple[Edges, float]:
    """Normals of the planes through the lens and the edges, and a . (b x c), which is positive.

    A direction that the triangle covers ahead of the lens is on the positive side of all three.
    """
    volume = dot(a, cross(b, c))
    if volume < 0.0:
        return (cross(c, b), cross(a, c), cross(b, a)), -volume
    return (cross(b, c), cross(c, a), cross(a, b)), volume


@kernel
def depth_at(
    image: Image, edges: Edges, volume: float, is_near: bool, across: float, down: float
) -> float:
    """Depth of a triangle in a direction; infinite where it does not cover it, or is too near."""
    direction = (across, down, 1.0)
    first, second = dot(edges[0], direction), dot(edges[1], direction)
    third = dot(edges[2], direction)
    total = first + second + third
    if first < 0.0 or second < 0.0 or third < 0.0 or total <= 0.0:
        return np.inf
    depth: float = volume / total
    if is_near and depth * np.sqrt(1.0 + across * across + down * down) < image.near_m:
        return np.inf
    return depth


@kernel
def find_cut(image: Image, normal: Point, least: float) -> Cut:
    """Where the product of a direction and a normal may be at least so large, with slack.

    To be found once for a triangle and asked in each row that it may cover: in large ones most
    pixels around them are not covered, nor are they in small ones.
    """
    slope = normal[0] / image.focal_px
    steepest = 0.5 * image.height_px / image.focal_px
    size = abs(slope) * image.width_px + abs(normal[1]) * steepest + abs(normal[2]) + abs(least)
    at_middle = normal[2] - least + _ROUNDING * size
    if abs(slope) * image.width_px <= _ROUNDING * size:  # all along a row it is as good as the same
        return 0, at_middle + _ROUNDING * size, -normal[1]
    middle_x = 0.5 * image.width_px - 0.5
    return (1 if slope > 0.0 else -1), middle_x - at_middle / slope, normal[1] / slope


@kernel
def find_cuts(image: Image, edges: Edges) -> Cuts:
    """Where directions are on the positive side of all three edges."""
    return (
        find_cut(image, edges[0], 0.0),
        find_cut(image, edges[1], 0.0),
        find_cut(image, edges[2], 0.0),
    )


@kernel
def cut_row(cut: Cut, down: float, low: float, high: float) -> tuple[float, float]:
    """Part of a row from `low` to `high` that a cut leaves; nothing: it ends before it begins."""
    side, at_middle, per_down = cut
    column = at_middle - per_down * down
    if side > 0:
        return max(low, column), high
    if side < 0:
        return low, min(high, column)
    return (low, high) if column >= 0.0 else (1.0, 0.0)


@kernel
def find_columns(cuts: Cuts, down: float, x_min: int, x_max: int) -> tuple[int, int]:
    """The first column of a row that a triangle may cover, and that after the last."""
    low, high = cut_row(cuts[0], down, float(x_min), float(x_max - 1))
    low, high = cut_row(cuts[1], down, low, high)
    return columns_left(cuts[2], down, low, high)


@kernel
def columns_left(cut: Cut, down: float, low: float, high: float) -> tuple[int, int]:
    """The first column of a row that a cut leaves, and that after the last; zeros: nothing."""
    low, high = cut_row(cut, down, low, high)
    if low > high:
        return 0, 0
    first = int(low)  # no number is negative: cutting off rounds down
    return first + (first < low), int(high) + 1


@kernel
def passes_by(image: Image, edges: Edges, volume: float, window: Window, farthest_m: float) -> bool:
    """Whether a plane through a triangle, or through its edge and the lens, keeps off a beam."""
    n_before, n_first, n_second, n_third = 0, 0, 0, 0
    for corner in range(4):
        x = window[0] if corner < 2 else window[2]
        y = window[1] if corner % 2 == 0 else window[3]
        direction = (
            (x - 0.5 * image.width_px) / image.focal_px,
            (y - 0.5 * image.height_px) / image.focal_px,
            1.0,
        )
        first, second = dot(edges[0], direction), dot(edges[1], direction)
        third = dot(edges[2], direction)
        n_first += first < 0.0
        n_second += second < 0.0
        n_third += third < 0.0
        n_before += (first + second + third) * farthest_m < volume
    return n_before == 4 or n_first == 4 or n_second == 4 or n_third == 4
