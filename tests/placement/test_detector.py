import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import boxes_px

from geometry.errors import InputError
from geometry.image_boxes import iou
from placement.detector import Detector, load_detector


def test_the_default_detector_asks_for_the_iou_of_the_study_and_some_height():
    # CarlaNCAP study: a detection counts above IoU 0.5. The height is this project's assumption.
    detector = load_detector()
    assert detector.min_iou == 0.5
    assert detector.min_box_height_px > 0.0


def test_the_iou_must_be_above_its_limit():
    detector = Detector(min_iou=0.5, min_box_height_px=0.0)
    whole = [0.0, 0.0, 10.0, 100.0]
    half, more = [0.0, 0.0, 10.0, 50.0], [0.0, 0.0, 10.0, 50.0 + 1e-9]
    assert detector.is_detected([half, more], whole).tolist() == [False, True]


def test_the_height_may_be_at_its_limit():
    detector = Detector(min_iou=0.5, min_box_height_px=25.0)
    high, low = [0.0, 0.0, 10.0, 25.0], [0.0, 0.0, 10.0, 25.0 - 1e-9]
    assert detector.is_detected([high, low], [high, low]).tolist() == [True, False]


def test_the_height_is_that_of_the_visible_box():
    detector = Detector(min_iou=0.5, min_box_height_px=25.0)
    whole, seen = [0.0, 0.0, 10.0, 30.0], [0.0, 6.0, 10.0, 30.0]
    assert iou(seen, whole) > 0.5
    assert not detector.is_detected(seen, whole)


@given(boxes_px(), boxes_px(), st.integers(0, 20))
def test_an_empty_box_is_never_detected(visible, amodal, height_px):
    detector = Detector(min_iou=0.0, min_box_height_px=float(height_px))
    detected = bool(detector.is_detected(visible, amodal))
    common = np.clip(
        np.minimum(visible[2:], amodal[2:]) - np.maximum(visible[:2], amodal[:2]), 0, None
    )
    assert detected == (common.prod() > 0.0 and visible[3] - visible[1] >= height_px)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"min_iou": 1.0}, "detector.min_iou: got 1.0; expected 0 <= IoU < 1"),
        ({"min_iou": -0.1}, "detector.min_iou: got -0.1; expected 0 <= IoU < 1"),
        ({"min_iou": math.nan}, "detector.min_iou: got nan; expected 0 <= IoU < 1"),
        (
            {"min_box_height_px": -1.0},
            "detector.min_box_height_px: got -1.0; expected pixels, at least 0",
        ),
        (
            {"min_box_height_px": math.inf},
            "detector.min_box_height_px: got inf; expected pixels, at least 0",
        ),
    ],
)
def test_a_detector_says_what_is_wrong(fields, message):
    with pytest.raises(InputError) as caught:
        Detector(**{"min_iou": 0.5, "min_box_height_px": 25.0, **fields})
    assert str(caught.value) == message
