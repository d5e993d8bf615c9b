"""The response of a detector: probability by hand, and draws that follow it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from evidences import build_evidence
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng

from geometry.errors import InputError
from geometry.image_boxes import iou
from placement.detectors import is_matched, load_planning_detector
from placement.detectors.response import ResponseDetector

DETECTOR = load_planning_detector("response")
assert isinstance(DETECTOR, ResponseDetector)
PLAIN = ResponseDetector(
    name="by hand",
    seen_share=[0.0, 0.5, 1.0],
    recall=[0.0, 0.6, 0.9],
    height_half_px=20.0,
    height_steepness=2.0,
    min_box_height_px=10.0,
    class_factor=[1.0, 0.9, 0.8, 0.7, 0.6],
    cyclist_end_on=0.5,
    contrast_half=0.5,
    contrast_steepness=1.0,
    box_noise_share=0.05,
    frame_correlation=0.7,
    plan_probability=0.3,
)
shares = st.floats(0.0, 1.0)


def _box(height_px, n_rows=1):
    """Equal boxes of a height, (n_rows, 4). [px]"""
    return np.tile(
        [100.0, 50.0, 100.0 + 0.4 * height_px, 50.0 + height_px], (n_rows, 1)
    )


def _probability(detector, height_px, **looks):
    """Probability that one box of a height is found."""
    evidence = build_evidence(_box(height_px), **looks)
    (probability,) = detector.probability(evidence)
    return probability


# Probability


def test_probability_is_the_product_that_one_works_out_by_hand():
    # Seen: 0.75 of what is inside, 0.8 of it inside: 0.6, on the line from 0.6 to 0.9:
    # 0.66. Height 40 px: 1 / (1 + (20 / 40)^2) = 0.8. A cyclist: 0.8. Seen at 60
    # degrees to its way: 1 - (1 - 0.5) cos^2 60 = 0.875. Contrast 0.25: (0.25 / 0.75) /
    # (1 / 1.5) = 0.5.
    looks = {
        "visible_share": 0.75,
        "inside_share": 0.8,
        "contrast": 0.25,
        "aspect_deg": 60.0,
    }
    expected = {
        "cyclist": 0.66 * 0.8 * 0.8 * 0.875 * 0.5,
        "child": 0.66 * 0.8 * 0.9 * 0.5,
        "motorcyclist": 0.66 * 0.8 * 0.7 * 0.5,
        "car": 0.66 * 0.8 * 0.6 * 0.5,
    }

    for name, probability in expected.items():
        found = _probability(PLAIN, 40.0, vru_class=name, **looks)
        assert found == pytest.approx(probability, rel=1e-12)


@given(
    height_px=st.floats(0.0, 300.0),
    key=st.sampled_from(["visible_share", "inside_share", "contrast"]),
    values=st.tuples(shares, shares).map(sorted),
    other=shares,
)
def test_probability_never_falls_with_any_share_or_contrast(
    height_px, key, values, other
):
    looks = dict.fromkeys(("visible_share", "inside_share", "contrast"), other)
    for detector in (DETECTOR, PLAIN):
        less, more = (
            _probability(detector, height_px, **looks | {key: v}) for v in values
        )
        assert less <= more + 1e-12


@pytest.mark.parametrize(
    ("seen", "miss_rate"),
    [
        (0.95, 0.076),  # bare: more than 0.9 seen
        (0.775, 0.168),  # partial: 0.65 to 0.9
        (0.425, 0.569),  # heavy: 0.2 to 0.65
    ],
)
def test_a_tall_vru_at_full_contrast_is_found_as_often_as_published(seen, miss_rate):
    """X. Wang et al., "Repulsion Loss", CVPR 2018, CityPersons."""
    assert _probability(DETECTOR, 1.0e6, visible_share=seen) == pytest.approx(
        1.0 - miss_rate
    )


def test_nothing_is_found_below_the_least_height_or_where_nothing_is_seen():
    least_px = DETECTOR.min_box_height_px
    when_hidden = _probability(DETECTOR, 100.0, visible_share=0.0)
    without_contrast = _probability(DETECTOR, 100.0, contrast=0.0)

    assert _probability(DETECTOR, least_px) > 0.0
    assert _probability(DETECTOR, least_px - 1e-9) == 0.0
    assert when_hidden == 0.0
    assert without_contrast == 0.0

    anything = replace(PLAIN, min_box_height_px=1.0e-12)
    no_boxes = np.zeros((50, 4))
    evidence = build_evidence(no_boxes)
    detections = anything.detect(evidence, default_rng(0))

    assert not anything.probability(evidence).any()
    assert not len(detections.row_index)


def test_a_plan_counts_on_rows_from_its_probability_on():
    heights_px = np.linspace(12.0, 200.0, 400)
    boxes_of_heights = [_box(height) for height in heights_px]
    boxes = np.concatenate(boxes_of_heights)
    evidence = build_evidence(boxes, visible_share=0.5)
    probability = DETECTOR.probability(evidence)
    expected = DETECTOR.is_expected(evidence)

    assert np.array_equal(expected, probability >= DETECTOR.plan_probability)

    plan_probability = float(probability[200])
    at_limit = replace(DETECTOR, plan_probability=plan_probability)
    is_expected = at_limit.is_expected(evidence)

    assert is_expected[200:].all()
    assert not is_expected[:200].any()
    assert 0 < expected.sum() < 400


# Draws


def _hits(detector, evidence, seed):
    """Rows that are found with a seed, (n_rows,) bool."""
    found = detector.detect(evidence, default_rng(seed))
    hits = np.zeros(len(evidence), dtype=bool)
    hits[found.row_index] = True
    return hits


def _runs_of(n_runs, n_frames):
    """Numbers of frames that follow one another within a run."""
    run = np.arange(n_runs)[:, None]
    frame = np.arange(n_frames)
    return run * (n_frames + 1) + frame


def test_the_same_seed_finds_the_same_boxes_and_another_others():
    boxes_shown = _box(40.0, 500)
    evidence = build_evidence(boxes_shown, visible_share=0.7)
    one = DETECTOR.detect(evidence, default_rng(3))
    same = DETECTOR.detect(evidence, default_rng(3))
    other = DETECTOR.detect(evidence, default_rng(4))
    expected = _probability(DETECTOR, 40.0, visible_share=0.7)
    is_same = np.array_equal(one.row_index, other.row_index)

    assert np.array_equal(one.row_index, same.row_index)
    assert np.array_equal(one.boxes_px, same.boxes_px)
    assert np.array_equal(one.confidence, same.confidence)
    assert not is_same
    assert one.confidence == pytest.approx(expected)


@pytest.mark.parametrize(
    ("correlation", "height_px"),
    [
        (0.0, 40.0),
        (0.7, 20.0),
        (0.7, 120.0),
        (1.0, 40.0),
    ],
)
def test_the_share_of_detections_is_the_probability(correlation, height_px):
    """Of runs of five frames the first and the last: five standard deviations of a
    binomial.
    """
    n_runs = 20_000
    detector = replace(DETECTOR, frame_correlation=correlation)
    evidence = build_evidence(
        _box(height_px, 5 * n_runs),
        draw_index=_runs_of(n_runs, 5).ravel(),
        visible_share=0.8,
    )
    is_hit = _hits(detector, evidence, 1)
    hits = is_hit.reshape(n_runs, 5)
    probability = _probability(detector, height_px, visible_share=0.8)
    variance = probability * (1.0 - probability) / n_runs
    tolerance = 5.0 * math.sqrt(variance)

    for frame in (0, 4):
        share = hits[:, frame].mean()
        assert share == pytest.approx(probability, abs=tolerance)


def test_frames_are_independent_without_correlation_and_alike_with_all_of_it():
    frames = _runs_of(20_000, 4)
    n_runs = 20_000
    index = frames.ravel()
    evidence = build_evidence(
        _box(40.0, 4 * n_runs),
        draw_index=index,
        visible_share=0.7,
    )
    probability = _probability(DETECTOR, 40.0, visible_share=0.7)

    def hits(correlation):
        detector = replace(DETECTOR, frame_correlation=correlation)
        is_hit = _hits(detector, evidence, 2)
        return is_hit.reshape(n_runs, 4)

    free = hits(0.0)
    some = hits(0.7)
    bound = hits(1.0)
    both = probability**2
    variance = both * (1.0 - both) / n_runs
    tolerance = 5.0 * math.sqrt(variance)
    both_free = free[:, 0] & free[:, 1]
    next_some = some[:, 0] & some[:, 1]
    later_some = some[:, 0] & some[:, 3]
    is_bound = bound == bound[:, :1]
    linked = bound[:-1, 3] & bound[1:, 0]

    assert both_free.mean() == pytest.approx(both, abs=tolerance)
    assert next_some.mean() > both + tolerance
    assert next_some.mean() > later_some.mean() + tolerance
    assert is_bound.all()
    assert 0.0 < bound.mean() < 1.0
    # One run says nothing about the next.
    assert linked.mean() == pytest.approx(both, abs=tolerance)


def test_rows_of_the_same_number_share_their_luck():
    """A frame by day and at night: what is found at night is found by day, in the same
    place.
    """
    index = np.tile(np.arange(3000), 2)
    contrast = np.repeat([1.0, 0.3], 3000)
    evidence = build_evidence(_box(30.0, 6000), draw_index=index, contrast=contrast)
    found = DETECTOR.detect(evidence, default_rng(5))
    hits = np.zeros(6000, dtype=bool)
    hits[found.row_index] = True
    by_day, at_night = hits.reshape(2, -1)
    n_by_day = by_day.sum()
    n_at_night = at_night.sum()

    assert (by_day >= at_night).all()
    assert n_by_day > n_at_night > 0

    boxes = np.full((6000, 4), np.nan)
    boxes[found.row_index] = found.boxes_px
    by_day_px = boxes[:3000][at_night]
    at_night_px = boxes[3000:][at_night]

    assert np.array_equal(by_day_px, at_night_px)


def test_luck_does_not_depend_on_what_the_rows_show():
    boxes = _box(30.0, 2000)
    poor = build_evidence(boxes, visible_share=0.5)
    rich = build_evidence(boxes, visible_share=1.0)
    rich_hits = _hits(DETECTOR, rich, 6)
    poor_hits = _hits(DETECTOR, poor, 6)

    assert (rich_hits >= poor_hits).all()


def test_boxes_are_off_by_the_noise_asked_for_and_are_still_correct():
    truth = _box(100.0, 20_000)
    evidence = build_evidence(truth)
    found = DETECTOR.detect(evidence, default_rng(7))
    error_px = found.boxes_px - truth[found.row_index]
    off = error_px / [40.0, 100.0, 40.0, 100.0]
    bias = off.mean(axis=0)
    spread = off.std(axis=0)
    overlap = iou(found.boxes_px, truth[found.row_index])

    assert np.abs(bias).max() < 0.002
    assert spread == pytest.approx(DETECTOR.box_noise_share, rel=0.03)
    assert (overlap > 0.5).all()

    exact_detector = replace(DETECTOR, box_noise_share=0.0)
    exact = exact_detector.detect(evidence, default_rng(7))
    is_exact = is_matched(exact, truth, min_iou=0.99)

    assert np.array_equal(exact.row_index, found.row_index)
    assert np.array_equal(exact.boxes_px, truth[exact.row_index])
    assert is_exact.sum() == len(exact.row_index)

    wild_detector = replace(DETECTOR, box_noise_share=1.0)
    wild = wild_detector.detect(evidence, default_rng(7))
    is_wild = is_matched(wild, truth, min_iou=0.5)
    wild_overlap = iou(wild.boxes_px, truth[wild.row_index])

    # The probability is that of correct boxes: however wild, they find as many.
    assert np.array_equal(wild.row_index, found.row_index)
    assert is_wild.sum() == len(wild.row_index)
    assert wild_overlap.mean() < 0.8


# The model itself


def test_the_response_looks_at_shares_and_at_no_picture():
    assert not DETECTOR.needs_pictures
    assert DETECTOR.name == "response"
    assert "probability is at least 0.5" in DETECTOR.description


def test_every_number_but_the_name_changes_the_fingerprint():
    changes = {
        "seen_share": np.array([0.0, 0.51, 1.0]),
        "recall": np.array([0.0, 0.61, 0.9]),
        "class_factor": np.array([1.0, 0.9, 0.81, 0.7, 0.6]),
        **{
            field: getattr(PLAIN, field) * 1.01
            for field in (
                "height_half_px",
                "height_steepness",
                "min_box_height_px",
                "cyclist_end_on",
                "contrast_half",
                "contrast_steepness",
                "plan_probability",
            )
        },
    }
    found = [
        replace(PLAIN, **{field: value}).fingerprint()
        for field, value in changes.items()
    ]
    renamed = replace(PLAIN, name="other")

    assert len({PLAIN.fingerprint(), *found}) == len(changes) + 1
    assert renamed.fingerprint() == PLAIN.fingerprint()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recall": [0.0, 1.2, 0.9]}, "recall: got 1.2; expected 0 .. 1"),
        ({"recall": [0.0, 0.9]}, "recall: got shape (2,); expected shape (3,)"),
        (
            {"recall": [0.0, math.nan, 0.9]},
            "recall: got [0.0, nan, 0.9]; expected finite numbers",
        ),
        (
            {"seen_share": [0.1, 0.7, 1.0]},
            "seen_share: got [0.1, 0.7, 1.0]; expected shares that ascend from 0 to 1",
        ),
        ({"height_half_px": 0.0}, "height_half_px: got 0.0; expected a number, > 0"),
        ({"contrast_half": math.inf}, "contrast_half: got inf; expected a number, > 0"),
    ],
)
def test_a_response_says_what_is_wrong(change, message):
    with pytest.raises(InputError) as caught:
        replace(PLAIN, **change)
    assert str(caught.value).startswith(message)
