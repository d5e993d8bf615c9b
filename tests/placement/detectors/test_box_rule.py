"""The rule by boxes: limits of IoU, height and contrast, and how frames are matched."""

import math

import numpy as np
import pytest
from evidences import build_evidence
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import boxes_px

from geometry.image_boxes import iou
from geometry.weather import CONTRAST_AT_VISIBILITY
from placement.detectors import (
    Detections,
    aspects_deg,
    is_matched,
    load_min_iou,
    load_planning_detector,
    vru_class,
)
from placement.detectors.geometric import GeometricDetector


def _detected(detector, visible_px, amodal_px=None, **looks):
    """Rows that the detector detects, by its boxes and as a plan expects them."""
    evidence = build_evidence(visible_px, amodal_px, **looks)
    rng = np.random.default_rng(0)
    found = detector.detect(evidence, rng)
    matched = is_matched(found, evidence.visible_px, min_iou=0.99)
    is_expected = detector.is_expected(evidence)

    assert np.array_equal(is_expected, matched)

    return matched.tolist()


def test_the_default_detector_asks_for_the_iou_of_the_study_and_some_height():
    # CarlaNCAP study: a detection counts above IoU 0.5. The height is this project's
    # assumption.
    detector = load_planning_detector()

    assert isinstance(detector, GeometricDetector)
    assert detector.min_iou == load_min_iou() == 0.5
    assert detector.min_box_height_px > 0.0
    # WMO-No. 8, chapter 9: what is left of the contrast at the visibility.
    assert detector.min_contrast == CONTRAST_AT_VISIBILITY


def test_the_iou_must_be_above_its_limit():
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=0.0)
    whole = [0.0, 0.0, 10.0, 100.0]
    half = [0.0, 0.0, 10.0, 50.0]
    more = [0.0, 0.0, 10.0, 50.0 + 1e-9]
    found = _detected(detector, [half, more], whole)

    assert found == [False, True]


def test_the_height_may_be_at_its_limit():
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=25.0)
    high = [0.0, 0.0, 10.0, 25.0]
    low = [0.0, 0.0, 10.0, 25.0 - 1e-9]
    found = _detected(detector, [high, low])

    assert found == [True, False]


def test_the_contrast_may_be_at_its_limit():
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=25.0, min_contrast=0.05)
    box = [0.0, 0.0, 10.0, 25.0]

    assert _detected(detector, [box, box], contrast=[0.05, 0.05 - 1e-9]) == [
        True,
        False,
    ]


def test_the_height_is_that_of_the_visible_box():
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=25.0)
    whole = [0.0, 0.0, 10.0, 30.0]
    seen = [0.0, 6.0, 10.0, 30.0]
    found = _detected(detector, seen, whole)

    assert iou(seen, whole) > 0.5
    assert found == [False]


@given(boxes_px(), boxes_px(), st.integers(0, 20))
def test_an_empty_box_is_never_detected(visible, amodal, height_px):
    detector = GeometricDetector(min_iou=0.0, min_box_height_px=float(height_px))
    common = np.clip(
        np.minimum(visible[2:], amodal[2:]) - np.maximum(visible[:2], amodal[:2]),
        0,
        None,
    )
    area = common.prod()
    expected = bool(area > 0.0 and visible[3] - visible[1] >= height_px)

    assert _detected(detector, visible, amodal) == [expected]


def test_only_the_boxes_the_contrast_and_nothing_else_decide():
    detector = GeometricDetector(min_iou=0.5, min_box_height_px=25.0)
    looks = {
        "visible_share": 0.1,
        "inside_share": 0.1,
        "aspect_deg": 0.0,
        "vru_class": "cyclist",
    }
    found = _detected(detector, [0.0, 0.0, 10.0, 30.0], **looks)

    assert found == [True]
    assert not detector.needs_pictures


@given(
    st.lists(boxes_px(), min_size=1, max_size=4),
    st.lists(st.tuples(st.integers(0, 3), boxes_px()), max_size=6),
)
def test_a_row_is_matched_by_a_box_in_its_own_image_that_overlaps_by_more_than_half(
    truth, found
):
    inside = [(row, box) for row, box in found if row < len(truth)]
    rows_inside = [row for row, _ in inside]
    boxes_inside = [box for _, box in inside]
    detections = Detections(
        row_index=np.array(rows_inside, dtype=np.int64),
        boxes_px=np.array(boxes_inside).reshape(-1, 4),
        confidence=np.ones(len(inside)),
    )

    expected = [
        any(row == index and float(iou(box, here)) > 0.5 for row, box in inside)
        for index, here in enumerate(truth)
    ]
    true_boxes = np.array(truth)
    matched = is_matched(detections, true_boxes, min_iou=0.5)

    assert matched.tolist() == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("adult", "pedestrian"),
        ("child", "child"),
        ("cyclist", "cyclist"),
    ],
)
def test_road_users_have_the_class_of_their_name(actors, name, expected):
    assert vru_class(actors[name]) == expected


@given(st.integers(-180, 180), st.integers(-720, 720), st.floats(0.1, 99.0))
def test_the_aspect_is_the_acute_angle_between_sightline_and_heading(
    towards, turn_deg, far_m
):
    towards_rad = math.radians(towards)
    east = math.cos(towards_rad)
    north = math.sin(towards_rad)
    sightline = far_m * np.array([[east, north]])

    heading_deg = np.array([towards + turn_deg], dtype=float)
    (aspect_deg,) = aspects_deg(sightline, heading_deg)
    heading = math.radians(towards + turn_deg)
    sine = math.sin(heading)
    cosine = math.cos(heading)
    apart = abs(sightline[0] @ [-sine, cosine])
    across = apart / far_m
    aspect_rad = math.radians(aspect_deg)

    assert 0.0 <= aspect_deg <= 90.0
    assert math.sin(aspect_rad) == pytest.approx(across, abs=1e-7)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"min_iou": 1.0}, "detector.min_iou: got 1.0; expected 0 <= IoU < 1"),
        ({"min_iou": math.nan}, "detector.min_iou: got nan; expected 0 <= IoU < 1"),
        (
            {"min_box_height_px": -1.0},
            "detector.min_box_height_px: got -1.0; expected pixels, at least 0",
        ),
        ({"min_contrast": 1.1}, "detector.min_contrast: got 1.1; expected 0 .. 1"),
    ],
)
def test_a_detector_says_what_is_wrong(fields, message):
    with refused_with(message):
        GeometricDetector(
            **{
                "min_iou": 0.5,
                "min_box_height_px": 25.0,
                **fields,
            }
        )
