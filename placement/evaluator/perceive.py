"""Boxes of the VRU in every frame, derived from pixels.

Each unit is a camera that is fixed to something: an RSU to the world, the VUT's camera to the
VUT. Seen from there many instants look the same but for the VUT: such a sight is rendered once.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.image_boxes import mask_box
from geometry.poses import Pose
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel

from ..detectors import Evidence, aspects_deg
from .render import Lens, Solid, build_lens, cast_crops, crop_boxes, inside_shares
from .surroundings import Surroundings, VutCamera, relative_road_poses

_MAX_RAYS = 1 << 16  # per cast: large enough for numpy's overhead, small enough for the cache
_LARGE_PX = 1 << 13  # from this area on, only the edges of a crop are looked at first
_EDGE_PX = 4  # the VRU begins one to two pixels inside its crop
_POSE_DECIMALS = 6  # poses that agree to a micrometre are the same


def perceive_from_roadside(
    surroundings: Surroundings,
    pose: Pose,
    camera: CameraModel,
    *,
    min_height_px: float = 0.0,
    with_shares: bool = False,
) -> Evidence:
    """Evidence of a fixed camera, one row for each frame.

    Where the VRU's box cannot be `min_height_px` high, nothing is cast and boxes are zeros.
    Visible share and cut-off share are found `with_shares` only; else they are 1, which saves many
    rays.
    """
    return _perceive(
        surroundings,
        build_lens(pose, camera),
        static_poses=surroundings.static_poses,
        vru_poses=surroundings.vru_poses,
        vut_poses=surroundings.vut_poses,
        min_height_px=min_height_px,
        with_shares=with_shares,
    )


def perceive_from_vut(
    surroundings: Surroundings,
    vut_camera: VutCamera,
    *,
    min_height_px: float = 0.0,
    with_shares: bool = False,
) -> Evidence:
    """Evidence of the VUT's own camera; the VUT itself is not drawn."""
    vut_poses = surroundings.vut_poses
    return _perceive(
        surroundings,
        build_lens(vut_camera.pose_on(surroundings.vut_actor), vut_camera.camera),
        static_poses=relative_road_poses(surroundings.static_poses, vut_poses),
        vru_poses=relative_road_poses(surroundings.vru_poses, vut_poses),
        vut_poses=None,
        min_height_px=min_height_px,
        with_shares=with_shares,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sights:
    """Frames that differ in more than the VUT, of one static world and one VRU's body."""

    lens: Lens
    static: Solid
    vru: Solid
    static_poses: FloatArray  # (n, 3)
    vru_poses: FloatArray  # (n, 3)
    crops: IntArray  # (n, 4): where to look for the VRU; zeros: nowhere
    farthest_m: FloatArray  # (n,): depth of the VRU's farthest vertex

    def take(self, indices: IntArray, crops: IntArray) -> "_Sights":
        return replace(
            self,
            static_poses=self.static_poses[indices],
            vru_poses=self.vru_poses[indices],
            crops=crops,
            farthest_m=self.farthest_m[indices],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Glimpse:
    """The VRU in one sight."""

    amodal_mask: BoolArray  # (h, w)
    visible_mask: BoolArray  # (h, w)
    depth_m: FloatRays  # of the visible pixels

    @property
    def visible_share(self) -> float:
        return _share(self.visible_mask, self.amodal_mask)


def _perceive(
    surroundings: Surroundings,
    lens: Lens,
    *,
    static_poses: FloatArray,
    vru_poses: FloatArray,
    vut_poses: FloatArray | None,
    min_height_px: float,
    with_shares: bool,
) -> Evidence:
    """Evidence from poses relative to the frame in which the lens stands."""
    n_frames = len(vru_poses)
    amodal, visible = np.zeros((n_frames, 4)), np.zeros((n_frames, 4))
    shares = np.ones(n_frames)
    inside, distance = np.ones(n_frames), np.empty(n_frames)
    kinds = np.stack([surroundings.static_index, surroundings.vru_index], axis=1)
    for static_index, vru_index in np.unique(kinds, axis=0):
        frames = np.flatnonzero((kinds == [static_index, vru_index]).all(axis=1))
        poses = np.concatenate([static_poses[frames], vru_poses[frames]], axis=1)
        _, first, sight_of_frame = np.unique(
            poses.round(_POSE_DECIMALS) + 0.0, axis=0, return_index=True, return_inverse=True
        )
        sights = _find_sights(
            lens,
            surroundings.statics[static_index],
            surroundings.vrus[vru_index],
            poses[first],
            min_height_px,
        )
        vut = None if vut_poses is None else (surroundings.vut, vut_poses[frames])
        amodal[frames], visible[frames], shares[frames] = _boxes(
            sights, sight_of_frame, vut, with_shares=with_shares
        )
        hull_m = surroundings.vrus[vru_index].hull_m
        distance[frames] = distances_m(lens.pose, vru_poses[frames], hull_m)
        if with_shares:
            inside[frames] = inside_shares(lens, hull_m, poses[first][:, 3:])[sight_of_frame]
    return Evidence(
        visible_px=freeze(visible),
        amodal_px=freeze(amodal),
        contrast=surroundings.contrast(distance),
        visible_share=shares,
        inside_share=inside,
        aspect_deg=aspects_deg(vru_poses[:, :2] - lens.pose.position_m[:2], vru_poses[:, 2]),
        vru_class=surroundings.vru_class,
        draw_index=surroundings.draw_index,
    )


def distances_m(pose: Pose, vru_poses: FloatArray, hull_m: FloatArray) -> FloatArray:
    """From a sensor to the middle of the VRU, (n,), in metres."""
    offsets = np.empty((len(vru_poses), 3))
    offsets[:, :2] = vru_poses[:, :2] - pose.position_m[:2]
    offsets[:, 2] = 0.5 * hull_m[:, 2].max() - pose.position_m[2]
    distance: FloatArray = np.linalg.norm(offsets, axis=1)
    return distance


def _find_sights(
    lens: Lens, static: Solid, vru: Solid, poses: FloatArray, min_height_px: float
) -> _Sights:
    crops, depths_m = crop_boxes(lens, vru.hull_m, poses[:, 3:])
    crops[crops[:, 3] - crops[:, 1] < min_height_px] = 0
    return _Sights(
        lens=lens,
        static=static,
        vru=vru,
        static_poses=poses[:, :3],
        vru_poses=poses[:, 3:],
        crops=crops,
        farthest_m=depths_m[:, 1],
    )


def _boxes(
    sights: _Sights,
    sight_of_frame: IntArray,
    vut: tuple[Solid, FloatArray] | None,
    *,
    with_shares: bool,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Amodal and visible box, and visible share, per frame."""
    n_sights = len(sights.crops)
    amodal, visible = np.zeros((n_sights, 4)), np.zeros((n_sights, 4))
    shares = np.ones(n_sights)
    before = (
        np.empty(0, dtype=np.int64)
        if vut is None
        else _frames_with_vut_before(sights, sight_of_frame, *vut)
    )
    is_behind_vut = np.zeros(n_sights, dtype=bool)
    is_behind_vut[sight_of_frame[before]] = True
    areas = _areas(sights.crops)

    is_open = areas > 0
    large = np.flatnonzero((areas >= _LARGE_PX) & ~is_behind_vut & (not with_shares))
    for batch in _batches(large, np.full(n_sights, _LARGE_PX)):
        boxes, is_settled = _boxes_from_edges(sights.take(batch, sights.crops[batch]))
        amodal[batch[is_settled]] = visible[batch[is_settled]] = boxes[is_settled]
        is_open[batch[is_settled]] = False

    glimpses: dict[int, _Glimpse] = {}
    for batch in _batches(np.flatnonzero(is_open), areas):
        taken = sights.take(batch, sights.crops[batch])
        for sight, crop, glimpse in zip(batch.tolist(), taken.crops, _look(taken), strict=True):
            amodal[sight] = _box(glimpse.amodal_mask, crop)
            visible[sight] = _box(glimpse.visible_mask, crop)
            shares[sight] = glimpse.visible_share if with_shares else 1.0
            if is_behind_vut[sight]:
                glimpses[sight] = glimpse

    visible, shares = visible[sight_of_frame], shares[sight_of_frame]
    if vut is not None:
        _hide_behind_vut(visible, shares, sights, sight_of_frame, before, vut, glimpses)
    return amodal[sight_of_frame], visible, shares


def _look(sights: _Sights) -> Iterator[_Glimpse]:
    """Cast every pixel of every crop."""
    lens, crops = sights.lens, sights.crops
    vru_depths = cast_crops(lens, sights.vru, sights.vru_poses, crops)
    masks = [
        np.isfinite(depth).reshape(y_max - y_min, x_max - x_min)
        for depth, (x_min, y_min, x_max, y_max) in zip(vru_depths, crops.tolist(), strict=True)
    ]
    static_depths = cast_crops(lens, sights.static, sights.static_poses, crops, masks)
    for mask, vru_depth, static_depth in zip(masks, vru_depths, static_depths, strict=True):
        depth = vru_depth[mask.ravel()]
        is_nearer = depth < static_depth
        yield _Glimpse(
            amodal_mask=mask, visible_mask=_thin(mask, is_nearer), depth_m=depth[is_nearer]
        )


def _boxes_from_edges(sights: _Sights) -> tuple[FloatArray, BoolArray]:
    """Boxes of VRUs that are seen on all four sides: only the edges of the crops are cast.

    Where a pixel of the VRU's outermost row or column is seen on each side, the visible box is the
    amodal one, whatever is between: a large part of all rays is saved. Gives (n, 4) boxes [px]
    where that settles them, and (n,) whether it does: otherwise the whole crop must be looked at.
    """
    n_sights = len(sights.crops)
    x_min, y_min, x_max, y_max = sights.crops.T
    edges = np.stack(  # in the order of a box's numbers: left, top, right, bottom
        [
            np.stack([x_min, y_min, np.minimum(x_min + _EDGE_PX, x_max), y_max], axis=1),
            np.stack([x_min, y_min, x_max, np.minimum(y_min + _EDGE_PX, y_max)], axis=1),
            np.stack([np.maximum(x_max - _EDGE_PX, x_min), y_min, x_max, y_max], axis=1),
            np.stack([x_min, np.maximum(y_max - _EDGE_PX, y_min), x_max, y_max], axis=1),
        ],
        axis=1,
    ).reshape(-1, 4)
    strips = sights.take(np.repeat(np.arange(n_sights), 4), edges)
    amodal, visible = np.empty((len(edges), 4)), np.empty((len(edges), 4))
    for index, glimpse in enumerate(_look(strips)):
        amodal[index] = _box(glimpse.amodal_mask, edges[index])
        visible[index] = _box(glimpse.visible_mask, edges[index])
    # Of each strip's box the number on the strip's own side.
    boxes = np.diagonal(amodal.reshape(-1, 4, 4), axis1=1, axis2=2)
    is_equal = boxes == np.diagonal(visible.reshape(-1, 4, 4), axis1=1, axis2=2)
    is_seen = (visible[:, 2] > visible[:, 0]).reshape(-1, 4)
    return boxes, (is_seen & is_equal).all(axis=1)


def _frames_with_vut_before(
    sights: _Sights, sight_of_frame: IntArray, vut: Solid, vut_poses: FloatArray
) -> IntArray:
    """Frames in which the VUT may hide a part of the VRU."""
    vut_crops, vut_depth = crop_boxes(sights.lens, vut.hull_m, vut_poses)
    crops = sights.crops[sight_of_frame]
    low = np.maximum(crops[:, :2], vut_crops[:, :2])
    high = np.minimum(crops[:, 2:], vut_crops[:, 2:])
    is_before = vut_depth[:, 0] < sights.farthest_m[sight_of_frame]
    return np.flatnonzero((low < high).all(axis=1) & is_before)


def _hide_behind_vut(
    visible: FloatArray,
    shares: FloatArray,
    sights: _Sights,
    sight_of_frame: IntArray,
    frames: IntArray,
    vut: tuple[Solid, FloatArray],
    glimpses: dict[int, _Glimpse],
) -> None:
    """Shrink the visible boxes of the frames in which the VUT may stand before the VRU."""
    n_rays = np.zeros(len(sights.crops), dtype=np.int64)
    for sight, glimpse in glimpses.items():
        n_rays[sight] = len(glimpse.depth_m)
    frames = frames[n_rays[sight_of_frame[frames]] > 0]
    for batch in _batches(frames, n_rays[sight_of_frame]):
        shown = sight_of_frame[batch].tolist()
        masks = [glimpses[sight].visible_mask for sight in shown]
        depths = cast_crops(sights.lens, vut[0], vut[1][batch], sights.crops[shown], masks)
        for frame, sight, depth in zip(batch.tolist(), shown, depths, strict=True):
            glimpse = glimpses[sight]
            seen = _thin(glimpse.visible_mask, glimpse.depth_m < depth)
            visible[frame] = _box(seen, sights.crops[sight])
            shares[frame] = _share(seen, glimpse.amodal_mask)


def _thin(mask: BoolArray, keep: BoolArray) -> BoolArray:
    """Keep some of the pixels of a mask."""
    left = mask.copy()
    left[mask] = keep
    return left


def _share(part: BoolArray, whole: BoolArray) -> float:
    """Pixels of a part by those of the whole; 1 where there are none."""
    n_whole = np.count_nonzero(whole)
    return np.count_nonzero(part) / n_whole if n_whole else 1.0


def _box(mask: BoolArray, crop: IntArray) -> FloatArray:
    return mask_box(mask, x_min_px=int(crop[0]), y_min_px=int(crop[1]))


def _areas(crops: IntArray) -> IntArray:
    areas: IntArray = (crops[:, 2] - crops[:, 0]) * (crops[:, 3] - crops[:, 1])
    return areas


def _batches(indices: IntArray, areas: IntArray) -> Iterator[IntArray]:
    """Split `indices` so that the areas of a batch sum to about `_MAX_RAYS` at most."""
    if len(indices):
        which = np.cumsum(areas[indices]) // _MAX_RAYS
        yield from np.split(indices, np.flatnonzero(np.diff(which)) + 1)
