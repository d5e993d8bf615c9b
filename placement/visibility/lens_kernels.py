"""Numba kernels: boxes of bodies in pictures through lenses that distort.

Point by point and camera by camera: what the fast loops of :mod:`.point_kernels` do for pinholes.
"""

import math
from functools import lru_cache

import numpy as np

from geometry.arrays import FloatArray, freeze
from geometry.kernels import kernel
from geometry.lenses import BrownConrady
from geometry.sensors import SEEN_RAD, CameraModel, rolled

from .point_kernels import Array

_SLACK = 1.0e-6  # of a cosine
# By so much of its size and so many pixels a body may reach beyond its corners.
_BULGE, _MARGIN_PX = 0.1, 2.0
_FOCAL, _MIDDLE, _SIZE, _TANGENTIAL, _LIMIT, _CONE, _AXES, _SHARES = 0, 2, 4, 6, 8, 10, 12, 21
_N_SHARES = 2048


def pack_lens(camera: CameraModel, rotation: FloatArray) -> FloatArray:
    """Numbers of a camera for :func:`box_through_lenses`, (n,).

    `rotation` (3, 3) takes offsets, as rows, into the camera's frame, the roll aside.
    """
    numbers = _pack_model(camera).copy()
    numbers[_AXES:_SHARES] = rolled(rotation, camera).T.ravel()
    return numbers


@lru_cache(maxsize=64)
def _pack_model(camera: CameraModel) -> FloatArray:
    """Numbers of a camera that looks along z.

    The radial part of the lens is a table: how far out a point is shown over how far out it lies,
    by even steps of sqrt(1 - sin^2(angle) / sin^2(largest angle)). There it is smooth up to the
    fold.
    """
    lens = camera.lens or BrownConrady()
    tangential = 0.0, 0.0
    reach = min(math.tan(SEEN_RAD), lens.reach * (1.0 - 1.0e-12))
    if isinstance(lens, BrownConrady):
        tangential = lens.p1, lens.p2
    most = reach**2 / (1.0 + reach**2)
    square = most * (1.0 - np.linspace(0.0, 1.0, _N_SHARES) ** 2)
    radius = np.sqrt(square / (1.0 - square)).clip(1.0e-9, reach)
    shares = lens.shown_radius(radius) / radius
    focal_px, half_rad = camera.focal_length_px, math.radians(0.5 * camera.diagonal_fov_deg)
    return freeze(
        np.array(
            [
                *(focal_px, focal_px * (camera.pixel_aspect or 1.0)),
                *camera.middle_px,
                *(camera.width_px, camera.height_px),
                *tangential,
                *(reach, 1.0 / most),
                *(math.cos(half_rad), math.sin(half_rad)),  # of the cone that holds the picture
                *np.eye(3).ravel(),
                *shares,
                shares[-1],  # to interpolate at the last one
            ]
        )
    )


@kernel
def _project(
    lens: FloatArray, x: float, y: float, z: float, min_depth_m: float
) -> tuple[float, float, bool, bool]:
    """Column and row of an offset; if it is ahead of the lens, and if the picture shows it.

    As :func:`geometry.sensors.shown_points`; what is not ahead is taken to be a little.
    """
    depth = x * lens[_AXES + 6] + y * lens[_AXES + 7] + z * lens[_AXES + 8]
    is_ahead = depth > min_depth_m
    per_depth = 1.0 / max(depth, min_depth_m)
    right = (x * lens[_AXES] + y * lens[_AXES + 1] + z * lens[_AXES + 2]) * per_depth
    down = (x * lens[_AXES + 3] + y * lens[_AXES + 4] + z * lens[_AXES + 5]) * per_depth
    square, beyond = right * right + down * down, 1.0
    is_shown = is_ahead
    if square > lens[_LIMIT] * lens[_LIMIT]:  # straight on from the farthest that is shown
        beyond = math.sqrt(square) / lens[_LIMIT]
        right, down, square = right / beyond, down / beyond, lens[_LIMIT] * lens[_LIMIT]
        is_shown = False
    place = 1.0 - square / (1.0 + square) * lens[_LIMIT + 1]
    place = math.sqrt(max(place, 0.0)) * (_N_SHARES - 1)
    step = int(place)
    first, second = lens[_SHARES + step], lens[_SHARES + step + 1]
    share = first + (place - step) * (second - first)
    p1, p2, across = lens[_TANGENTIAL], lens[_TANGENTIAL + 1], 2.0 * right * down
    column = right * share + p1 * across + p2 * (square + 2.0 * right * right)
    row = down * share + p2 * across + p1 * (square + 2.0 * down * down)
    column = lens[_MIDDLE] + lens[_FOCAL] * column * beyond
    row = lens[_MIDDLE + 1] + lens[_FOCAL + 1] * row * beyond
    width, height = lens[_SIZE], lens[_SIZE + 1]
    is_shown = is_shown and 0.0 <= column <= width and 0.0 <= row <= height
    return column, row, is_ahead, is_shown


@kernel
def _widen(box: FloatArray, first: int, column: float, row: float) -> None:
    """Stretch a box of four numbers so that it holds a point."""
    box[first], box[first + 1] = min(box[first], column), min(box[first + 1], row)
    box[first + 2], box[first + 3] = max(box[first + 2], column), max(box[first + 3], row)


@kernel
def _box_points(
    lens: FloatArray,
    axes: Array,
    eye: FloatArray,
    is_seen: Array,
    is_whole: bool,
    min_depth_m: float,
    box: FloatArray,
) -> tuple[bool, bool, bool]:
    """If a body is ahead, if the picture cuts it off, and if the lens folds where it would show it.

    Four boxes of its points (3, n) go to `box`: of all, of those that are seen and in the picture,
    of those in the picture, and of those that are seen.
    """
    box[0::4] = box[1::4] = np.inf
    box[2::4] = box[3::4] = -np.inf
    is_all_ahead, is_cut, is_folded = True, False, False
    for point in range(axes.shape[1]):
        x, y, z = axes[0, point] - eye[0], axes[1, point] - eye[1], axes[2, point] - eye[2]
        column, row, is_ahead, is_shown = _project(lens, x, y, z, min_depth_m)
        is_all_ahead &= is_ahead
        _widen(box, 0, column, row)
        if is_whole or is_seen[point]:
            _widen(box, 12, column, row)
            if is_shown:
                _widen(box, 4, column, row)
        if is_shown:
            _widen(box, 8, column, row)
            continue
        is_cut = True
        is_in_frame = 0.0 <= column <= lens[_SIZE] and 0.0 <= row <= lens[_SIZE + 1]
        is_folded |= is_ahead and is_in_frame
    return is_all_ahead, is_cut, is_folded


@kernel
def _is_out(lens: FloatArray, box: FloatArray, min_height_px: float) -> bool:
    """True if a body ahead, with its corners in a box, is not so high in the picture."""
    # Its edges are bent: it may reach a little farther than its corners.
    beyond = _BULGE * max(box[2] - box[0], box[3] - box[1]) + _MARGIN_PX
    high = min(box[3], lens[_SIZE + 1]) - max(box[1], 0.0) + 2.0 * beyond
    return bool(box[2] + beyond < 0.0 or box[0] - beyond > lens[_SIZE] or high < min_height_px)


@kernel
def _share_inside(lens: FloatArray, is_folded: bool, box: FloatArray) -> float:
    """Share of a body's box in the picture, of the boxes of :func:`_box_points`."""
    if not is_folded:  # cut off by the picture's edges alone
        box[8], box[9] = max(box[0], 0.0), max(box[1], 0.0)
        box[10], box[11] = min(box[2], lens[_SIZE]), min(box[3], lens[_SIZE + 1])
    shown = max(box[10] - box[8], 0.0) * max(box[11] - box[9], 0.0)
    return float(min(shown / max((box[2] - box[0]) * (box[3] - box[1]), 1.0e-9), 1.0))


@kernel
def _is_near(lens: FloatArray, middle: Array, eye: FloatArray, radius: float) -> bool:
    """True if a sphere around a middle, seen from the lens, reaches into the picture's cone."""
    x, y, z = middle[0] - eye[0], middle[1] - eye[1], middle[2] - eye[2]
    wide_cos, wide_sin = lens[_CONE], lens[_CONE + 1]
    away = math.sqrt(x * x + y * y + z * z)
    if away <= radius:
        return True
    sine = radius / away
    cosine = math.sqrt(1.0 - sine * sine)
    if wide_sin * cosine + wide_cos * sine < 0.0:  # wider than half a turn
        return True
    along = x * lens[_AXES + 6] + y * lens[_AXES + 7] + z * lens[_AXES + 8]
    return bool(along >= (wide_cos * cosine - wide_sin * sine - _SLACK) * away)


@kernel
def box_through_lenses(
    bodies: tuple[Array, Array, Array, Array],
    eye: Array,
    sight: tuple[Array, Array, Array],
    lenses: Array,
    least: tuple[float, float],
    found: tuple[Array, Array, Array, Array, Array],
) -> tuple[int, int]:
    """Boxes of bodies through lenses, of those that are seen whole apart from the others.

    Bodies, sight and what is found are as for :func:`.point_kernels.box_bodies`; lenses are (k, n),
    of :func:`pack_lens`.
    """
    (points, hull, middle, radius), (min_depth_m, min_height_px) = bodies, least
    view_of_entry, is_visible, is_whole = sight
    plain, plain_px, part, part_px, inside_share = found
    box = np.empty(16)
    n_plain = n_part = 0
    for entry in range(len(view_of_entry)):  # bodies, and the cameras that may see each
        view = view_of_entry[entry]
        for camera in range(len(lenses)):
            lens = lenses[camera]
            if not _is_near(lens, middle[view], eye, radius[view]):
                continue
            # Its corners alone, first.
            is_ahead, is_cut, _ = _box_points(
                lens, hull[view], eye, is_visible[entry], True, min_depth_m, box
            )
            if is_ahead and _is_out(lens, box, min_height_px):
                continue
            high = box[3] - box[1]
            if is_whole[entry] and not is_cut:
                if high >= min_height_px and high > 0.0:
                    plain[n_plain, 0], plain[n_plain, 1] = camera, entry
                    plain_px[n_plain] = box[:4]
                    n_plain += 1
                continue
            _, is_cut, is_folded = _box_points(
                lens, points[view], eye, is_visible[entry], is_whole[entry], min_depth_m, box
            )
            seen, whole = (4, 8) if is_cut else (12, 0)
            high = box[seen + 3] - box[seen + 1]
            if not (high >= min_height_px and high > 0.0):
                continue
            part[n_part, 0], part[n_part, 1] = camera, entry
            part_px[n_part, :4], part_px[n_part, 4:] = box[seen : seen + 4], box[whole : whole + 4]
            inside_share[n_part] = _share_inside(lens, is_folded, box) if is_cut else 1.0
            n_part += 1
    return n_plain, n_part
