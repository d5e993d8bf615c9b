"""Numba kernels: boxes of bodies in pictures through lenses that distort.

Point by point and camera by camera: what the fast loops of :mod:`.point_kernels` do for
pinholes.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.kernels import kernel
from geometry.lenses import BrownConrady
from geometry.poses import camera_rotation
from geometry.sensors import SEEN_RAD, CameraModel, rolled

from ..candidates import CandidatePose
from .point_kernels import Array, BodyPoints, Found, Least, Seen
from .sensing import MIN_DEPTH_M

# Slack of a cosine.
_SLACK = 1.0e-6
# By so much of its size and so many pixels a body may reach beyond its corners.
_BULGE = 0.1
_MARGIN_PX = 2.0
_N_SHARES = 2048
LENS = np.dtype(
    [
        # In columns and rows. [px]
        ("focal", float, 2),
        # Where the lens looks straight ahead.
        ("middle", float, 2),
        # Width and height of the picture.
        ("size", float, 2),
        # Coefficients p1 and p2 of Brown and Conrady.
        ("tangential", float, 2),
        # The radial part: tangent of the farthest angle that is shown, 1 / square of
        # its sine, and how far out a point is shown over how far out it lies, in even
        # steps (`_pack_model`).
        ("limit", float),
        ("per_most", float),
        ("shares", float, _N_SHARES + 1),
        # Half angle of the cone that holds the picture.
        ("cone_cos", float),
        ("cone_sin", float),
        # Right, down and ahead, in the world's axes.
        ("axes", float, (3, 3)),
    ]
)
"""One camera with a lens."""


class _LensBoxes(NamedTuple):
    """Boxes of some of a body's points: left, top, right and bottom.

    Attributes
    ----------
    every : (4,) float
        Around all points. [px]
    seen : (4,) float
        Around the points that nothing occludes. [px]
    shown : (4,) float
        Around the points inside the image. [px]
    seen_shown : (4,) float
        Around the points inside the image that nothing occludes. [px]
    """

    every: FloatArray
    seen: FloatArray
    shown: FloatArray
    seen_shown: FloatArray


def pack_lens(camera: CameraModel, rotation: FloatArray) -> Array:
    """A camera in the form that :func:`box_through_lenses` takes.

    Parameters
    ----------
    camera : CameraModel
        Its lens may distort.
    rotation : (3, 3) float
        Takes offsets, as rows, into the camera's frame, the roll aside.

    Returns
    -------
    lens : () `LENS`
        One structured value.
    """
    lens = _pack_model(camera).copy()
    lens["axes"] = rolled(rotation, camera).T
    return lens


@lru_cache(maxsize=64)
def _pack_model(camera: CameraModel) -> Array:
    """A camera that looks along z, as a read-only `LENS`.

    The radial part of the lens is a table: how far out a point is shown over how far
    out it lies, in even steps of sqrt(1 - sin^2(angle) / sin^2(largest angle)). In
    these steps it is smooth up to the fold of the lens.
    """
    lens = camera.lens or BrownConrady()
    tangential = (0.0, 0.0)
    reach = min(math.tan(SEEN_RAD), lens.reach * (1.0 - 1.0e-12))
    if isinstance(lens, BrownConrady):
        tangential = (lens.p1, lens.p2)
    most = reach**2 / (1.0 + reach**2)
    square = most * (1.0 - np.linspace(0.0, 1.0, _N_SHARES) ** 2)
    radius = np.sqrt(square / (1.0 - square)).clip(1.0e-9, reach)
    shares = lens.shown_radius(radius) / radius
    focal_px = camera.focal_length_px
    half_rad = math.radians(0.5 * camera.diagonal_fov_deg)
    packed = np.zeros((), LENS)
    packed["focal"] = (focal_px, focal_px * (camera.pixel_aspect or 1.0))
    packed["middle"] = camera.middle_px
    packed["size"] = (camera.width_px, camera.height_px)
    packed["tangential"] = tangential
    packed["limit"] = reach
    packed["per_most"] = 1.0 / most
    # One value more, to interpolate at the last one.
    packed["shares"] = np.append(shares, shares[-1])
    packed["cone_cos"] = math.cos(half_rad)
    packed["cone_sin"] = math.sin(half_rad)
    packed["axes"] = np.eye(3)
    return freeze(packed)


@kernel
def _project(
    lens: Any, x: float, y: float, z: float, min_depth_m: float
) -> tuple[float, float, bool, bool]:
    """Project an offset through a lens.

    Parameters
    ----------
    lens : `LENS`
        The camera.
    x, y, z : float
        Offset of the point from the eye, in the world's axes. [m]
    min_depth_m : float
        Points nearer than this ahead of the lens are projected as if they were
        there. [m]

    Returns
    -------
    column, row : float
        Where the image would show it. [px]
    is_ahead : bool
        The point is ahead of the lens.
    is_shown : bool
        The point is ahead, within the lens' reach and inside the image.

    Notes
    -----
    The same as :func:`geometry.sensors.shown_points`. Beyond the farthest angle that
    the lens shows, the projection goes on in a straight line.
    """
    axes = lens.axes
    limit = lens.limit
    depth = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
    is_ahead = depth > min_depth_m
    per_depth = 1.0 / max(depth, min_depth_m)
    right = (x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) * per_depth
    down = (x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) * per_depth
    square = right * right + down * down
    beyond = 1.0
    is_shown = is_ahead
    # Beyond the farthest angle that is shown: straight on from there.
    if square > limit * limit:
        beyond = math.sqrt(square) / limit
        right = right / beyond
        down = down / beyond
        square = limit * limit
        is_shown = False
    # Radial part, interpolated between the values of the table.
    place = 1.0 - square / (1.0 + square) * lens.per_most
    place = math.sqrt(max(place, 0.0)) * (_N_SHARES - 1)
    step = int(place)
    first = lens.shares[step]
    second = lens.shares[step + 1]
    share = first + (place - step) * (second - first)
    # Tangential part, after Brown and Conrady.
    p1 = lens.tangential[0]
    p2 = lens.tangential[1]
    across = 2.0 * right * down
    column = right * share + p1 * across + p2 * (square + 2.0 * right * right)
    row = down * share + p2 * across + p1 * (square + 2.0 * down * down)
    column = lens.middle[0] + lens.focal[0] * column * beyond
    row = lens.middle[1] + lens.focal[1] * row * beyond
    is_shown = is_shown and 0.0 <= column <= lens.size[0] and 0.0 <= row <= lens.size[1]
    return column, row, is_ahead, is_shown


@kernel
def _widen(box: FloatArray, column: float, row: float) -> None:
    """Stretch a box (4,) so that it holds a point."""
    box[0] = min(box[0], column)
    box[1] = min(box[1], row)
    box[2] = max(box[2], column)
    box[3] = max(box[3], row)


@kernel
def _empty(box: FloatArray) -> None:
    """Make a box (4,) hold no point."""
    box[0] = np.inf
    box[1] = np.inf
    box[2] = -np.inf
    box[3] = -np.inf


@kernel
def _box_points(
    lens: Any,
    axes: Array,
    eye: FloatArray,
    is_seen: BoolArray,
    is_whole: bool,
    min_depth_m: float,
    boxes: _LensBoxes,
) -> tuple[bool, bool, bool]:
    """Compute the boxes around a body's points in one image.

    Parameters
    ----------
    lens : `LENS`
        The camera.
    axes : (3, n) float32
        Points of the body, by axis. [m]
    eye : (3,) float
        The mount. [m]
    is_seen : (n,) bool
        Points that nothing occludes.
    is_whole : bool
        Nothing occludes any point; `is_seen` is not read.
    min_depth_m : float
        As in :func:`_project`. [m]
    boxes : _LensBoxes
        Written.

    Returns
    -------
    is_all_ahead : bool
        All points are ahead of the lens.
    is_cut : bool
        Some point lies outside the image.
    is_folded : bool
        Some point ahead lands inside the image only because the lens folds there.
    """
    _empty(boxes.every)
    _empty(boxes.seen)
    _empty(boxes.shown)
    _empty(boxes.seen_shown)
    is_all_ahead = True
    is_cut = False
    is_folded = False
    for point in range(axes.shape[1]):
        x = axes[0, point] - eye[0]
        y = axes[1, point] - eye[1]
        z = axes[2, point] - eye[2]
        column, row, is_ahead, is_shown = _project(lens, x, y, z, min_depth_m)
        is_all_ahead &= is_ahead
        _widen(boxes.every, column, row)
        if is_whole or is_seen[point]:
            _widen(boxes.seen, column, row)
            if is_shown:
                _widen(boxes.seen_shown, column, row)
        if is_shown:
            _widen(boxes.shown, column, row)
            continue
        is_cut = True
        is_in_frame = 0.0 <= column <= lens.size[0] and 0.0 <= row <= lens.size[1]
        is_folded |= is_ahead and is_in_frame
    return is_all_ahead, is_cut, is_folded


@kernel
def _is_out(lens: Any, box: FloatArray, min_height_px: float) -> bool:
    """True if a body is outside the image, or not high enough in it.

    Parameters
    ----------
    lens : `LENS`
        The camera.
    box : (4,) float
        Box around the corners of the body's hull, all ahead of the lens. [px]
    min_height_px : float
        Least height that counts. [px]
    """
    # Its edges are bent: it may reach a little farther than its corners.
    beyond = _BULGE * max(box[2] - box[0], box[3] - box[1]) + _MARGIN_PX
    high = min(box[3], lens.size[1]) - max(box[1], 0.0) + 2.0 * beyond
    is_beside = box[2] + beyond < 0.0 or box[0] - beyond > lens.size[0]
    return bool(is_beside or high < min_height_px)


@kernel
def _share_inside(lens: Any, is_folded: bool, boxes: _LensBoxes) -> float:
    """Share of a body's box that is inside the image, 0 to 1.

    Parameters
    ----------
    lens : `LENS`
        The camera.
    is_folded : bool
        As :func:`_box_points` returns it.
    boxes : _LensBoxes
        As :func:`_box_points` fills them; `shown` is overwritten unless the lens
        folds.
    """
    every = boxes.every
    shown = boxes.shown
    # Only the picture's edges cut the box off.
    if not is_folded:
        shown[0] = max(every[0], 0.0)
        shown[1] = max(every[1], 0.0)
        shown[2] = min(every[2], lens.size[0])
        shown[3] = min(every[3], lens.size[1])
    inside = max(shown[2] - shown[0], 0.0) * max(shown[3] - shown[1], 0.0)
    area = (every[2] - every[0]) * (every[3] - every[1])
    return float(min(inside / max(area, 1.0e-9), 1.0))


@kernel
def _is_near(lens: Any, middle: FloatArray, eye: FloatArray, radius: float) -> bool:
    """True if a sphere reaches into the cone around a camera's image.

    Parameters
    ----------
    lens : `LENS`
        The camera.
    middle : (3,) float
        Centre of the sphere. [m]
    eye : (3,) float
        The mount. [m]
    radius : float
        Radius of the sphere. [m]

    Notes
    -----
    Compares cosines: the angle off the axis is at most the half angle of the cone
    plus that of the sphere.
    """
    x = middle[0] - eye[0]
    y = middle[1] - eye[1]
    z = middle[2] - eye[2]
    away = math.sqrt(x * x + y * y + z * z)
    if away <= radius:
        return True
    sine = radius / away
    cosine = math.sqrt(1.0 - sine * sine)
    # Cone and sphere together are wider than half a turn.
    if lens.cone_sin * cosine + lens.cone_cos * sine < 0.0:
        return True
    along = x * lens.axes[2, 0] + y * lens.axes[2, 1] + z * lens.axes[2, 2]
    cos_of_both = lens.cone_cos * cosine - lens.cone_sin * sine
    return bool(along >= (cos_of_both - _SLACK) * away)


@kernel
def box_through_lenses(
    bodies: BodyPoints,
    eye: FloatArray,
    sight: Seen,
    lenses: Array,
    least: Least,
    found: Found,
) -> tuple[int, int]:
    """Compute the boxes of bodies in cameras whose lenses distort.

    Parameters
    ----------
    bodies : BodyPoints
        All bodies.
    eye : (3,) float
        The mount. [m]
    sight : Seen
        Which bodies are seen from there, and which points of each.
    lenses : (k,) `LENS`
        The cameras.
    least : Least
        From where on a body counts.
    found : Found
        Written: bodies seen whole in `plain`, all others in `part`.

    Returns
    -------
    n_plain, n_part : int
        Number of pairs of either kind, as :func:`.point_kernels.box_bodies` counts
        them.
    """
    min_depth = least.depth
    min_height_px = least.height_px
    boxes = _LensBoxes(np.empty(4), np.empty(4), np.empty(4), np.empty(4))
    n_plain = 0
    n_part = 0
    # Loop over the bodies, and the cameras that may see each.
    for entry in range(len(sight.view_index)):
        view = sight.view_index[entry]
        is_seen = sight.is_visible[entry]
        is_whole = sight.is_whole[entry]
        for camera in range(len(lenses)):
            lens = lenses[camera]
            if not _is_near(lens, bodies.middle[view], eye, bodies.radius[view]):
                continue
            # Its corners alone, first.
            is_ahead, is_cut, _ = _box_points(
                lens, bodies.hull[view], eye, is_seen, True, min_depth, boxes
            )
            if is_ahead and _is_out(lens, boxes.every, min_height_px):
                continue
            high = boxes.every[3] - boxes.every[1]
            if is_whole and not is_cut:
                if high >= min_height_px and high > 0.0:
                    found.plain[n_plain, 0] = camera
                    found.plain[n_plain, 1] = entry
                    found.plain_px[n_plain] = boxes.every
                    n_plain += 1
                continue
            _, is_cut, is_folded = _box_points(
                lens, bodies.points[view], eye, is_seen, is_whole, min_depth, boxes
            )
            # Of a body that the image cuts off, only points inside the image count.
            seen = boxes.seen
            whole = boxes.every
            if is_cut:
                seen = boxes.seen_shown
                whole = boxes.shown
            high = seen[3] - seen[1]
            if not (high >= min_height_px and high > 0.0):
                continue
            found.part[n_part, 0] = camera
            found.part[n_part, 1] = entry
            found.part_px[n_part, :4] = seen
            found.part_px[n_part, 4:] = whole
            share = 1.0
            if is_cut:
                share = _share_inside(lens, is_folded, boxes)
            found.inside_share[n_part] = share
            n_part += 1
    return n_plain, n_part


def box_in_lenses(
    bodies: BodyPoints,
    eye_m: FloatArray,
    seen: Seen,
    units: Sequence[CandidatePose],
    *,
    min_height_px: float,
    found: Found,
) -> tuple[int, int]:
    """Boxes of bodies in cameras whose lenses distort, as a :class:`.BoxFinder`."""
    cameras = [one.sensor for one in units if isinstance(one.sensor, CameraModel)]
    turns = [camera_rotation(one.pose.yaw_deg, one.pose.pitch_deg) for one in units]
    lenses = np.stack([pack_lens(*one) for one in zip(cameras, turns, strict=True)])
    least = Least(MIN_DEPTH_M, min_height_px)
    n_boxes: tuple[int, int] = box_through_lenses(
        bodies, eye_m, seen, lenses, least, found
    )
    return n_boxes
