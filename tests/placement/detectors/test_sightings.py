"""Boxes beside labels: what is found, what is a false alarm, which false tracks are
confirmed.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import poisson as poisson_law

from geometry.errors import InputError
from placement.detectors.fitting import (
    LabelledPicture,
    Sightings,
    gather_sightings,
    poisson,
    wilson,
)

PERSON = (100.0, 100.0, 140.0, 200.0)
BESIDE = (400.0, 100.0, 440.0, 200.0)


def picture(frame=0, *, labels=(PERSON,), found=(), track=0, finds=None, alone=None):
    """A labelled picture with boxes that were found in it."""
    n = len(labels)
    labels_given = np.array(labels)
    label_px = labels_given.reshape(-1, 4)
    found_given = np.array(found)
    found_px = found_given.reshape(-1, 4)
    return LabelledPicture(
        track=track,
        frame=frame,
        label_px=label_px,
        label_class=np.zeros(n, dtype=int),
        seen_share=np.ones(n),
        contrast=np.ones(n),
        aspect_deg=np.full(n, 90.0),
        found_px=found_px,
        finds=None if finds is None else np.array(finds),
        alone_px=None if alone is None else np.array(alone).reshape(-1, 4),
    )


def moved(box, right):
    """A box so far to the right. [px]"""
    return (box[0] + right, box[1], box[2] + right, box[3])


def gather(*pictures):
    """Sightings of pictures at 10 Hz, confirmed by three."""
    return gather_sightings(pictures, n_confirmations=3, frame_rate_hz=10.0)


def test_a_box_that_overlaps_enough_is_found_and_its_sides_are_compared():
    seen, alarms = gather(
        picture(found=[moved(PERSON, 4.0)]), picture(1, found=[BESIDE])
    )
    is_unknown = np.isnan(seen.box_error[1])

    assert seen.is_found.tolist() == [True, False]
    assert_allclose(seen.box_error[0], [0.1, 0.0, 0.1, 0.0])
    assert is_unknown.all()
    assert_array_equal(seen.height_px, [100.0, 100.0])
    assert alarms.pictures == 2
    assert alarms.alarms == 1


def test_a_box_that_overlaps_too_little_is_neither_found_nor_a_false_alarm():
    too_far = moved(PERSON, 30.0)
    shown = picture(found=[too_far])
    seen, alarms = gather(shown)

    assert not seen.is_found.any()
    assert alarms.alarms == 0


def test_a_box_of_another_class_does_not_find():
    shown = picture(found=[PERSON], finds=[[False]])
    seen, _ = gather(shown)
    assert not seen.is_found.any()


def test_each_label_is_a_row():
    shown = picture(labels=[PERSON, BESIDE], found=[BESIDE])
    seen, _ = gather(shown)
    assert seen.is_found.tolist() == [False, True]


def test_boxes_that_others_make_up_are_no_alarms():
    copy = moved(BESIDE, 2.0)
    shown = picture(found=[BESIDE, copy], alone=[BESIDE])
    _, alarms = gather(shown)

    assert alarms.alarms == 1


@pytest.mark.parametrize(
    ("rights", "n_confirmed"),
    [
        ([0.0, 2.0, 4.0], 1),
        ([0.0, 2.0, 4.0, 6.0, 8.0], 1),  # one track, counted once
        ([0.0, 2.0], 0),
        ([0.0, 100.0, 200.0], 0),  # a box elsewhere in each picture
        ([0.0, 2.0, None, 4.0, 6.0], 0),  # interrupted
        ([0.0, 2.0, 4.0, None, 6.0, 8.0, 10.0], 2),
    ],
)
def test_false_tracks_are_confirmed_by_frames_in_a_row(rights, n_confirmed):
    _, alarms = gather(
        *(
            picture(frame, found=[] if right is None else [moved(BESIDE, right)])
            for frame, right in enumerate(rights)
        )
    )
    expected = max(0, len(rights) - 2)

    assert alarms.confirmed == n_confirmed
    assert alarms.chances == expected


def test_a_frame_that_is_missing_breaks_a_false_track():
    _, alarms = gather(*(picture(frame, found=[BESIDE]) for frame in (0, 1, 3, 4)))

    assert alarms.confirmed == 0
    assert alarms.chances == 0
    assert alarms.per_hour is None


def test_two_alarms_side_by_side_do_not_swap():
    near = moved(BESIDE, 10.0)
    _, alarms = gather(*(picture(frame, found=[BESIDE, near]) for frame in range(3)))

    assert alarms.confirmed == 2


def test_tracks_of_two_cameras_are_apart():
    _, alarms = gather(
        *(picture(frame, found=[BESIDE], track=frame % 2) for frame in range(6))
    )
    assert alarms.confirmed == 0


def test_false_tracks_per_hour_follow_from_the_frame_rate():
    _, alarms = gather(*(picture(frame, found=[BESIDE]) for frame in range(12)))
    assert alarms.per_hour.value == pytest.approx(3600.0 * 10.0 / 10.0)


@pytest.mark.parametrize("n_events", [0, 1, 7])
def test_the_poisson_interval_is_exact(n_events):
    interval = poisson(n_events, 2.0)
    share_below = poisson_law.cdf(n_events, 2.0 * interval.high)

    assert interval.value == n_events / 2.0
    assert share_below == pytest.approx(0.025)

    if n_events:
        share_above = poisson_law.sf(n_events - 1, 2.0 * interval.low)
        assert share_above == pytest.approx(0.025)


@pytest.mark.parametrize(
    ("found", "frames"),
    [
        (0, 5),
        (5, 5),
        (3, 20),
    ],
)
def test_the_wilson_interval_solves_its_equation(found, frames):
    interval = wilson(found, frames)
    for end in (interval.low, interval.high):
        off = abs(found / frames - end)
        deviation = end * (1.0 - end) / frames
        expected = 1.959964 * np.sqrt(deviation)

        assert off == pytest.approx(expected, abs=1e-9)


def test_impossible_values_are_refused():
    ones = np.ones(1)
    columns = dict.fromkeys(("height_px", "contrast", "aspect_deg"), ones)
    box_error = np.full((1, 4), np.nan)

    with pytest.raises(InputError, match=r"seen_share: got 1\.5; expected 0 \.\. 1"):
        Sightings(
            **columns,
            seen_share=np.array([1.5]),
            vru_class=np.zeros(1, dtype=int),
            is_found=np.zeros(1, dtype=bool),
            box_error=box_error,
            track=np.zeros(1, dtype=int),
            frame=np.zeros(1, dtype=int),
        )
