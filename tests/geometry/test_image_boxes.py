"""Boxes in pictures, against sets of pixels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import boxes_px

from geometry.image_boxes import box_height_px, clip_boxes, iou, mask_box

SIZE_PX = 40


def _pixels(box, margin_px=10):
    """Set of unit squares that a box with whole coordinates covers."""
    grid = np.zeros((SIZE_PX + 2 * margin_px,) * 2, dtype=bool)
    x_min, y_min, x_max, y_max = (int(value) + margin_px for value in box)
    grid[y_min:y_max, x_min:x_max] = True
    return grid


@given(boxes_px(), boxes_px())
def test_iou_is_the_share_of_common_pixels(a, b):
    in_a = _pixels(a)
    in_b = _pixels(b)
    n_union = (in_a | in_b).sum()
    n_common = (in_a & in_b).sum()
    share = n_common / max(n_union, 1)

    assert iou(a, b) == pytest.approx(share, abs=1e-15)


def test_iou_broadcasts_and_is_zero_for_empty_or_touching_boxes():
    """Touching, without width, and with swapped corners."""
    a = np.array(
        [
            [0.0, 0.0, 2.0, 2.0],
            [2.0, 0.0, 4.0, 2.0],
            [5.0, 5.0, 5.0, 9.0],
            [3.0, 3.0, 1.0, 1.0],
        ]
    )
    with_first = iou(a, [0, 0, 2, 2])
    in_pairs = iou(a[:, None], a[None])

    assert with_first.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert in_pairs.shape == (4, 4)


@given(boxes_px(margin_px=10))
def test_clipping_keeps_exactly_the_pixels_inside_the_image(box):
    pixels = _pixels(box)
    in_image = _pixels([0, 0, SIZE_PX, SIZE_PX])
    clipped = clip_boxes(box, width_px=SIZE_PX, height_px=SIZE_PX)

    assert np.array_equal(_pixels(clipped), pixels & in_image)


@given(arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7))))
def test_mask_box_is_the_smallest_box_around_the_set_pixels(mask):
    rows, columns = np.nonzero(mask)
    expected = [0.0] * 4
    if mask.any():
        expected = [
            columns.min(),
            rows.min(),
            columns.max() + 1,
            rows.max() + 1,
        ]

    assert mask_box(mask).tolist() == expected


def test_box_height_is_the_vertical_extent():
    boxes = [
        [1.0, 2.0, 30.0, 44.5],
        [0.0, 0.0, 0.0, 0.0],
    ]
    assert box_height_px(boxes).tolist() == [42.5, 0.0]
