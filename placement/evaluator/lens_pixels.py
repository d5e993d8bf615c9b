"""Pixels of a picture through a lens that show the VRU, a ray for each.

Straight edges are bent there, so that :mod:`.pixels`, which draws triangles between
straight edges, is of no use. A pixel's ray is that of its middle, undistorted.
"""

from typing import NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.sensors import SEEN_RAD, CameraModel, is_shown, pixel_grid, shown_points

from .pixels import Image, Placed, SeenBoxes, Sights
from .surroundings import Solid, Surroundings

_MIN_DEPTH_M = 1.0e-6
# What the VRU stands on does not occlude it. More than rays are rounded.
_TOUCH_M = 1.0e-3
# By so much of its size and so many pixels a body may reach beyond its corners as the
# lens bends its edges; of one that takes up more of the picture all pixels are looked
# at.
_FAR_OUT = 2.0 * np.tan(SEEN_RAD)
_BULGE = 0.1
_MARGIN_PX = 2.0
_LARGE = 0.4
Window = tuple[int, int, int, int]


class _Rays(NamedTuple):
    """Rays of pixels, and the depths at which they meet the VRU.

    Attributes
    ----------
    columns, rows : (n,) int
        The pixels.
    ways : (n, 3) float
        Camera frame, one metre deep. [m]
    depth_m : (n,) float
        [m]
    """

    columns: IntArray
    rows: IntArray
    ways: FloatArray
    depth_m: FloatArray

    def take(self, some: BoolArray) -> "_Rays":
        """The rays in a mask (n,)."""
        return _Rays(
            self.columns[some], self.rows[some], self.ways[some], self.depth_m[some]
        )


def draw_in_lens(
    _image: Image,
    camera: CameraModel,
    min_height_px: float,
    vru: Solid,
    static: Solid,
    surroundings: Surroundings,
    sights: Sights,
    seen: SeenBoxes,
) -> None:
    """Draw through a lens that distorts, as a :class:`.perceive.BodyDrawer`."""
    see_through_lens(
        camera, min_height_px, vru, static, surroundings.vehicles, sights, seen
    )


def see_through_lens(
    camera: CameraModel,
    min_height_px: float,
    vru: Solid,
    static: Solid,
    vehicles: tuple[Solid, ...],
    sights: Sights,
    seen: SeenBoxes,
) -> None:
    """Fill boxes and shares of a VRU's body, seen through a lens that distorts.

    What :func:`.pixels.see` does for pinholes.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    min_height_px : float
        Where the VRU's part of the image is lower, boxes stay zeros. [px]
    vru : Solid
        The VRU's body.
    static : Solid
        What stands still.
    vehicles : tuple of Solid
        Kinds of vehicles that move.
    sights : Sights
        Where everything is.
    seen : SeenBoxes
        Blank; written.
    """
    vertices = vru.meshes[0].vertices_m
    for sight in range(len(sights.vru.shift)):
        turn = sights.vru.turn[sight]
        shift = sights.vru.shift[sight]
        window, seen.inside_share[sight] = _find_window(
            camera, vertices @ turn.T + shift, min_height_px
        )
        rays = _meet(camera, vru, sights.vru, sight, window)
        if not len(rays.columns):
            continue
        seen.amodal_px[sight] = _box(rays)
        # What stands still, in all frames of the sight.
        is_hidden = _is_hidden(camera, static, sights.static, sight, rays)
        free = rays.take(~is_hidden)
        box_px = _box(free)
        share = len(free.columns) / len(rays.columns)
        frames = slice(sights.frame_start[sight], sights.frame_start[sight + 1])
        seen.visible_px[sight] = box_px
        seen.frame_visible_px[frames] = box_px
        seen.visible_share[sight] = share
        seen.frame_visible_share[frames] = share
        if not len(free.columns):
            continue
        # Then the vehicles of each frame, one after the other.
        for frame in range(frames.start, frames.stop):
            left = free
            for row in range(
                sights.vehicle_start[frame], sights.vehicle_start[frame + 1]
            ):
                vehicle = vehicles[sights.vehicle_kind[row]]
                if len(left.columns):
                    is_hidden = _is_hidden(camera, vehicle, sights.vehicles, row, left)
                    left = left.take(~is_hidden)
            if len(left.columns) < len(free.columns):
                seen.frame_visible_px[frame] = _box(left)
                seen.frame_visible_share[frame] = len(left.columns) / len(rays.columns)


def _find_window(
    camera: CameraModel, corners: FloatArray, min_height_px: float
) -> tuple[Window, float]:
    """Find the pixels that may show a body, and the share of it inside.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    corners : (n, 3) float
        Points of the body, camera frame. [m]
    min_height_px : float
        Least height of the window. [px]

    Returns
    -------
    window : tuple of 4 int
        First column and row, and those after the last: zeros if no pixel may show the
        body or the part is not so high; the whole image where the body reaches behind
        the lens.
    inside_share : float
        Share of the body's box inside the image; 0 where it reaches behind the lens.

    Notes
    -----
    Where the lens shows nothing, points lie straight on, so that the box around them
    holds what the lens shows.
    """
    nothing = (0, 0, 0, 0)
    everything = (0, 0, camera.width_px, camera.height_px)
    depth = corners[:, 2]
    if (depth <= _MIN_DEPTH_M).all() or camera.height_px < min_height_px:
        return nothing, 0.0
    at_depth_1 = corners[:, :2] / np.maximum(depth, _MIN_DEPTH_M)[:, None]
    # What lies beside the lens or behind it is far out of the picture, in its
    # direction.
    radius = np.linalg.norm(at_depth_1, axis=1, keepdims=True)
    at_depth_1 *= np.minimum(1.0, _FAR_OUT / np.maximum(radius, _MIN_DEPTH_M))
    is_behind = bool((depth <= _MIN_DEPTH_M).any())
    middle = corners.mean(axis=0)
    radius_m = np.linalg.norm(corners - middle, axis=1).max()
    is_far = np.linalg.norm(middle) > 2.0 * radius_m
    if is_behind and not is_far:
        return everything, 0.0
    if is_far and not is_shown(at_depth_1, camera).any():
        return nothing, 0.0
    shown = shown_points(at_depth_1, camera)
    low = shown.min(axis=0)
    high = shown.max(axis=0)
    size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    inside = np.clip(np.minimum(high, size) - np.maximum(low, 0.0), 0.0, None)
    share = float(np.prod(inside / np.maximum(high - low, 1.0e-9)))
    if is_behind:
        share = 0.0
    if is_behind and not inside.all():
        return nothing, 0.0
    if (high - low > _LARGE * size).any():
        return everything, share
    beyond = _BULGE * float((high - low).max()) + _MARGIN_PX
    first = np.floor(np.clip(low - beyond, 0.0, size)).astype(int).tolist()
    last = np.ceil(np.clip(high + beyond, 0.0, size)).astype(int).tolist()
    if first[0] >= last[0] or last[1] - first[1] < min_height_px:
        return nothing, share
    return (*first, *last), share


def _meet(
    camera: CameraModel, vru: Solid, placed: Placed, row: int, window: Window
) -> _Rays:
    """Rays of a window's pixels that meet the VRU."""
    x_low, y_low, x_high, y_high = window
    across = pixel_grid(camera)[y_low:y_high, x_low:x_high]
    rows, columns = np.nonzero(np.isfinite(across[..., 0]))
    at_depth_1 = across[rows, columns]
    ways = np.column_stack([at_depth_1, np.ones(len(at_depth_1))])
    rays = _Rays(columns + x_low, rows + y_low, ways, np.zeros(len(ways)))
    depth_m = _cast(camera, vru, placed, row, ways)
    return rays._replace(depth_m=depth_m).take(np.isfinite(depth_m))


def _cast(
    camera: CameraModel, solid: Solid, placed: Placed, row: int, ways: FloatArray
) -> FloatArray:
    """Depths at which rays first meet a body, from the near limit on.

    Parameters
    ----------
    camera : CameraModel
        Its near limit counts.
    solid : Solid
        The body.
    placed : Placed
        Where bodies are.
    row : int
        Row of the body in `placed`.
    ways : (n, 3) float
        Camera frame, one metre deep. [m]

    Returns
    -------
    depth_m : (n,) float
        Infinite where the body is not met. [m]
    """
    turn = placed.turn[row]
    shift = placed.shift[row]
    near = camera.near_m / np.linalg.norm(ways, axis=1)
    starts = (near[:, None] * ways - shift) @ turn
    turned = (ways @ turn).astype(np.float32)
    depth, _ = solid.caster.first_triangle(starts.astype(np.float32), turned)
    return np.asarray(depth.astype(np.float64) + near)


def _is_hidden(
    camera: CameraModel, solid: Solid, placed: Placed, row: int, rays: _Rays
) -> BoolArray:
    """Mask of rays that meet a body before they meet the VRU, (n,)."""
    return _cast(camera, solid, placed, row, rays.ways) < rays.depth_m - _TOUCH_M


def _box(rays: _Rays) -> FloatArray:
    """Box around the rays' pixels, (4,); zeros if there are none."""
    if not len(rays.columns):
        return np.zeros(4)
    columns = rays.columns
    rows = rays.rows
    return np.array([columns.min(), rows.min(), columns.max() + 1.0, rows.max() + 1.0])
