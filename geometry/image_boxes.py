"""Boxes in pixels: x_min, y_min, x_max, y_max. A box without area is empty."""

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray


def box_height_px(boxes_px: ArrayLike) -> FloatArray:
    """Height of boxes, (..., 4) -> (...,), in pixels."""
    boxes = np.asarray(boxes_px, dtype=np.float64)
    return boxes[..., 3] - boxes[..., 1]


def clip_boxes(boxes_px: ArrayLike, *, width_px: int, height_px: int) -> FloatArray:
    """Parts of boxes (..., 4) that are inside the image.

    A box that is wholly outside has no area left.
    """
    boxes = np.asarray(boxes_px, dtype=np.float64)
    limit = np.array([width_px, height_px, width_px, height_px], dtype=np.float64)
    return np.clip(boxes, 0.0, limit)


def iou(boxes_a_px: ArrayLike, boxes_b_px: ArrayLike) -> FloatArray:
    """Intersection over union of boxes (..., 4), pairwise; 0 where either is empty.

    >>> float(iou([0, 0, 2, 2], [1, 0, 3, 2]).round(4))
    0.3333
    """
    a = np.asarray(boxes_a_px, dtype=np.float64)
    b = np.asarray(boxes_b_px, dtype=np.float64)
    low = np.maximum(a[..., :2], b[..., :2])
    high = np.minimum(a[..., 2:], b[..., 2:])
    intersection = _area(high - low)
    area_a, area_b = (_area(box[..., 2:] - box[..., :2]) for box in (a, b))
    # What is in both counts once.
    union = area_a + area_b - intersection
    return np.divide(
        intersection, union, out=np.zeros_like(intersection), where=union > 0.0
    )


def _area(size_px: FloatArray) -> FloatArray:
    """Width times height, (..., 2) -> (...,); 0 where either is negative."""
    size = np.maximum(size_px, 0.0)
    return size[..., 0] * size[..., 1]


def mask_box(mask: ArrayLike) -> FloatArray:
    """Smallest box (4,) around the set pixels of a mask (h, w).

    Pixels are unit squares. An empty mask gives zeros.
    """
    rows, columns = np.nonzero(np.asarray(mask, dtype=bool))
    if not len(rows):
        return np.zeros(4)
    return np.array(
        [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], dtype=float
    )
