"""Metrics of detectors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.perception_lab.training.metrics import (
    average_precision,
    log_average_miss_rate,
    match_boxes,
)

BOX = np.array([[10.0, 10.0, 30.0, 50.0]])
NOTHING = np.zeros((0, 4))


def _scored(found, *, counts=True, n_pictures=1.0):
    """One picture with one label, and boxes (box, confidence)."""
    boxes = np.array([box for box, _ in found]).reshape(-1, 4)
    sure = np.array([confidence for _, confidence in found])
    return match_boxes(
        [boxes], [sure], [BOX], [np.array([counts])], min_iou=0.5, n_pictures=n_pictures
    )


def test_a_sure_box_on_the_label_is_perfect():
    scored = _scored([(BOX[0], 0.9)])
    assert average_precision(scored) == 1.0
    assert log_average_miss_rate(scored) == pytest.approx(1e-10)


def test_a_second_box_on_a_label_and_a_box_elsewhere_are_false_alarms():
    scored = _scored(
        [
            (BOX[0], 0.5),
            (BOX[0] + 1.0, 0.9),
            (BOX[0] + 100.0, 0.7),
        ]
    )
    assert scored.is_true.tolist() == [True, False, False]
    assert scored.confidence.tolist() == [0.9, 0.7, 0.5]


def test_boxes_on_labels_that_do_not_count_are_neither_right_nor_wrong():
    scored = _scored(
        [
            (BOX[0], 0.9),
            (BOX[0] + 100.0, 0.2),
        ],
        counts=False,
    )
    assert scored.n_labels == 0
    assert scored.is_true.tolist() == [False]
    assert np.isnan(average_precision(scored))


def test_average_precision_by_hand():
    # Two labels; boxes in descending confidence: right, wrong, right.
    other = BOX + 200.0
    scored = match_boxes(
        [np.concatenate([BOX, BOX + 500.0, other])],
        [np.array([0.9, 0.8, 0.7])],
        [np.concatenate([BOX, other])],
        [np.array([True, True])],
        min_iou=0.5,
        n_pictures=1.0,
    )

    assert average_precision(scored) == pytest.approx(0.5 * 1.0 + 0.5 * 2.0 / 3.0)
    # One miss of two until there is a false alarm per picture, none from there on.
    assert log_average_miss_rate(scored) == pytest.approx(
        (0.5**8 * 1e-10) ** (1 / 9), rel=1e-6
    )


def test_a_network_that_finds_nothing_misses_all():
    scored = match_boxes(
        [NOTHING], [np.zeros(0)], [BOX], [np.array([True])], min_iou=0.5, n_pictures=1.0
    )
    assert average_precision(scored) == 0.0
    assert log_average_miss_rate(scored) == 1.0


@given(
    st.lists(st.tuples(st.booleans(), st.floats(0.0, 1.0)), max_size=12),
    st.floats(0.1, 9.0),
)
def test_metrics_are_shares(rows, n_pictures):
    found = [
        (BOX[0] if near else BOX[0] + 90.0, confidence) for near, confidence in rows
    ]
    scored = _scored(found, n_pictures=n_pictures)

    assert 0.0 <= average_precision(scored) <= 1.0
    assert 0.0 <= log_average_miss_rate(scored) <= 1.0
