"""Numba kernels: boxes of bodies in pictures through lenses that distort.

Point by point and camera by camera: what the fast loops of :mod:`.point_kernels` do for pinholes.
"""

import math

import numpy as np

from geometry.arrays import FloatArray
from geometry.kernels import kernel
from geometry.sensors import SEEN_RAD, CameraModel, roll_axes

from .point_kernels import Array

_NEWTON_STEPS = 50
_TERMS, _FOCAL, _MIDDLE, _SIZE, _LIMIT, _AXES = 0, 6, 8, 10, 12, 13
N_NUMBERS = 22


def pack_lens(camera: CameraModel, rotation: FloatArray) -> FloatArray:
    """Numbers of a camera for :func:`box_through_lenses`, (22,).

    `rotation` (3, 3) takes offsets, as rows, into the camera's frame, the roll aside.
    """
    lens = camera.lens
    axes = np.column_stack([rotation[:, :2] @ roll_axes(camera), rotation[:, 2]])
    focal_px = camera.focal_length_px
    reach = min(math.tan(SEEN_RAD), math.inf if lens is None else lens.reach)
    return np.array(
        [
            *((0.0,) * 6 if lens is None else lens.terms),
            *(focal_px, focal_px * (camera.pixel_aspect or 1.0)),
            *camera.middle_px,
            *(camera.width_px, camera.height_px),
            reach,
            *axes.T.ravel(),
        ]
    )


@kernel
def _bend(lens: FloatArray, x: float, y: float) -> tuple[float, float]:
    """A point at depth 1 as a lens shows it; it is one that the lens shows."""
    kind, square = lens[0], x * x + y * y
    if kind == 0.0:  # Brown and Conrady
        radial = 1.0 + square * (lens[1] + square * (lens[2] + square * lens[5]))
        across, p1, p2 = 2.0 * x * y, lens[3], lens[4]
        return (
            x * radial + p1 * across + p2 * (square + 2.0 * x * x),
            y * radial + p2 * across + p1 * (square + 2.0 * y * y),
        )
    radius = math.sqrt(square)
    if radius == 0.0:
        return x, y
    if kind == 2.0:  # a fisheye
        angle = math.atan(radius)
        bent = angle * angle
        shown = angle * (
            1.0 + bent * (lens[1] + bent * (lens[2] + bent * (lens[3] + bent * lens[4])))
        )
        return x * shown / radius, y * shown / radius
    kappa, turn = lens[1], lens[2]
    shown = min(radius, turn)  # Tsai: a cubic
    for _ in range(_NEWTON_STEPS):
        slope = max(1.0 + 3.0 * kappa * shown * shown, 1.0e-6)
        step = (shown * (1.0 + kappa * shown * shown) - radius) / slope
        shown = min(max(shown - step, 0.0), turn)
        if not abs(step) > 1.0e-14 * (1.0 + shown):
            break
    return x * shown / radius, y * shown / radius


@kernel
def _project(
    lens: FloatArray, x: float, y: float, z: float, min_depth_m: float
) -> tuple[float, float, bool, bool]:
    """Column and row of an offset; if it is ahead of the lens, and if the picture shows it.

    As :func:`geometry.sensors.shown_points`; what is not ahead is taken to be a little.
    """
    axes = lens[_AXES:]
    depth = x * axes[6] + y * axes[7] + z * axes[8]
    is_ahead = depth > min_depth_m
    depth = max(depth, min_depth_m)
    right = (x * axes[0] + y * axes[1] + z * axes[2]) / depth
    down = (x * axes[3] + y * axes[4] + z * axes[5]) / depth
    beyond = math.sqrt(right * right + down * down) / lens[_LIMIT]
    is_shown = is_ahead and beyond <= 1.0
    beyond = max(beyond, 1.0)
    right, down = _bend(lens, right / beyond, down / beyond)
    column = lens[_MIDDLE] + lens[_FOCAL] * right * beyond
    row = lens[_MIDDLE + 1] + lens[_FOCAL + 1] * down * beyond
    width, height = lens[_SIZE], lens[_SIZE + 1]
    is_shown = is_shown and 0.0 <= column <= width and 0.0 <= row <= height
    return column, row, is_ahead, is_shown


@kernel
def _widen(box: FloatArray, first: int, column: float, row: float) -> None:
    """Stretch a box of four numbers so that it holds a point."""
    box[first], box[first + 1] = min(box[first], column), min(box[first + 1], row)
    box[first + 2], box[first + 3] = max(box[first + 2], column), max(box[first + 3], row)


@kernel
def _area(box: FloatArray, first: int) -> float:
    """Area of a box of four numbers; 0 if it holds nothing."""
    across, up = box[first + 2] - box[first], box[first + 3] - box[first + 1]
    return float(max(across, 0.0) * max(up, 0.0))


@kernel
def box_through_lenses(
    bodies: tuple[Array, Array, Array],
    eye: Array,
    sight: tuple[Array, Array, Array],
    lenses: Array,
    cosines: Array,
    least: tuple[float, float],
    found: tuple[Array, Array, Array, Array, Array],
) -> tuple[int, int]:
    """Boxes of bodies through lenses, of those that are seen whole apart from the others.

    Bodies, sight and what is found are as for :func:`.point_kernels.box_bodies`, of bodies without
    hulls; `lenses` (k, 22) are of :func:`pack_lens`, `cosines` (k, 2) cosine and sine of half of
    the cone that holds each picture.
    """
    (points, middle, radius), (min_depth_m, min_height_px) = bodies, least
    view_of_entry, is_visible, is_whole = sight
    plain, plain_px, part, part_px, inside_share = found
    # Of all points; of those that are seen and in the picture; of those in the picture.
    box = np.empty(16)
    n_plain = n_part = 0
    for entry in range(len(view_of_entry)):  # bodies, cameras, and the points of each body
        view = view_of_entry[entry]
        x, y, z = middle[view, 0] - eye[0], middle[view, 1] - eye[1], middle[view, 2] - eye[2]
        away = math.sqrt(x * x + y * y + z * z)
        for camera in range(len(lenses)):
            lens = lenses[camera]
            along = x * lens[_AXES + 6] + y * lens[_AXES + 7] + z * lens[_AXES + 8]
            if away > radius[view]:
                # The cone around the picture's, wider by what the body takes up.
                sine = radius[view] / away
                cosine = math.sqrt(1.0 - sine * sine)
                wide = cosines[camera, 0] * cosine - cosines[camera, 1] * sine
                is_all = cosines[camera, 1] * cosine + cosines[camera, 0] * sine < 0.0
                if not is_all and along < (wide - 1.0e-6) * away:
                    continue
            box[0::4] = box[1::4] = np.inf
            box[2::4] = box[3::4] = -np.inf
            is_cut = False
            is_folded = False
            for point in range(points.shape[2]):
                px = points[view, 0, point] - eye[0]
                py = points[view, 1, point] - eye[1]
                pz = points[view, 2, point] - eye[2]
                column, row, is_ahead, is_shown = _project(lens, px, py, pz, min_depth_m)
                is_seen = is_whole[entry] or is_visible[entry, point]
                _widen(box, 0, column, row)
                is_cut |= not is_shown
                if is_seen:
                    _widen(box, 12, column, row)
                if is_shown:
                    _widen(box, 8, column, row)
                    if is_seen:
                        _widen(box, 4, column, row)
                elif is_ahead:
                    is_folded |= 0.0 <= column <= lens[_SIZE] and 0.0 <= row <= lens[_SIZE + 1]
            seen, every = (4, 8) if is_cut else (12, 0)
            high = box[seen + 3] - box[seen + 1]
            if not (high >= min_height_px and high > 0.0):
                continue
            if is_whole[entry] and not is_cut:
                plain[n_plain, 0], plain[n_plain, 1] = camera, entry
                plain_px[n_plain] = box[:4]
                n_plain += 1
                continue
            part[n_part, 0], part[n_part, 1] = camera, entry
            part_px[n_part, :4], part_px[n_part, 4:] = box[seen : seen + 4], box[every : every + 4]
            inside_share[n_part] = 1.0
            if is_cut:
                whole = max(_area(box, 0), 1.0e-9)
                if not is_folded:  # cut off by the picture's edges alone
                    box[8], box[9] = max(box[0], 0.0), max(box[1], 0.0)
                    box[10] = min(box[2], lens[_SIZE])
                    box[11] = min(box[3], lens[_SIZE + 1])
                inside_share[n_part] = min(_area(box, 8) / whole, 1.0)
            n_part += 1
    return n_plain, n_part
