"""Annotated boxes next to found ones, made up so that every number is known."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng

from geometry.errors import InputError
from placement.detectors.fitting import gather_sightings, share_by_track, wilson
from placement.recordings.formats import IGNORE, BoxRow, gather_boxes
from placement.recordings.pairs import frames_to_confirm, pair_boxes, seen_shares

PERSON = {"pedestrian": "pedestrian"}


def boxes(rows, name="a.txt"):
    """Boxes of rows: frame, class, box, and fields; line by line of a file."""
    made = []
    for line, (frame, class_name, box, fields) in enumerate(rows):
        row = BoxRow(
            f"{name}:{line}",
            frame,
            class_name,
            box,
            **fields,
        )
        made.append(row)

    return gather_boxes(Path(name), made)


def annotated(*rows):
    """Boxes of rows: frame, track, box, and more fields."""
    made = []
    for frame, track, box, *more in rows:
        further = dict(*more)
        fields = {"track": track} | further
        name = fields.pop("name", "pedestrian")
        annotation = (frame, name, box, fields)
        made.append(annotation)

    return boxes(made)


def found(*rows):
    """Detected pedestrians: frame, box and score."""
    made = [(frame, "pedestrian", box, {"score": score}) for frame, box, score in rows]
    return boxes(made, name="d")


A = (0.0, 0.0, 40.0, 100.0)
B = (30.0, 10.0, 70.0, 110.0)


def test_what_one_nearer_box_covers_is_hidden():
    given_ = annotated((0, 1, A), (0, 2, B), (1, 1, A))
    shares = seen_shares(given_).tolist()

    # B is nearer: it covers 10 x 90 of A's 40 x 100 px.
    assert shares == pytest.approx([1 - 900 / 4000, 1.0, 1.0])


def test_what_is_annotated_counts_more_than_what_boxes_cover():
    rows = [
        (0, 1, A, {"hidden_level": 2}),
        (0, 2, B, {"seen_share": 0.4}),
    ]
    given_ = annotated(*rows)
    shares = seen_shares(given_).tolist()

    assert shares == [0.25, 0.4]


def test_each_box_finds_one_person_and_weak_ones_none():
    between = (5.0, 0.0, 45.0, 100.0)
    given_ = annotated((0, 7, A), (0, 9, between), (2, 9, B))

    pairs = pair_boxes(
        given_,
        found((0, A, 0.9), (2, B, 0.4)),
        classes=PERSON,
        min_score=0.5,
    )
    n_found = [len(one.found_px) for one in pairs.pictures]

    assert n_found == [1, 0, 0]
    assert pairs.label_index.tolist() == [0, 1, 2]

    seen, alarms = gather_sightings(
        pairs.pictures,
        n_confirmations=3,
        frame_rate_hz=7.0,
    )

    assert seen.is_found.tolist() == [True, False, False]
    assert seen.track.tolist() == [0, 1, 1]
    assert seen.frame.tolist() == [0, 0, 2]
    assert alarms.pictures == 3
    assert alarms.alarms == 0


def test_boxes_in_regions_to_ignore_are_no_false_alarms():
    far = (500.0, 0.0, 540.0, 100.0)
    ignored = (0, -1, far, {"name": IGNORE})
    given_ = annotated((0, 1, A), ignored)
    far_right = (0, (800.0, 0.0, 840.0, 100.0), 0.9)
    detected = found((0, far, 0.9), far_right)
    pairs = pair_boxes(given_, detected, classes=PERSON, min_score=0.5)

    _, alarms = gather_sightings(pairs.pictures, n_confirmations=3, frame_rate_hz=7.0)

    assert alarms.alarms == 1


def test_files_that_do_not_belong_together_are_told():
    given_ = annotated((0, 1, A))

    with pytest.raises(
        InputError, match=r"d: got frames up to 50; expected up to 0, as in a\.txt"
    ):
        pair_boxes(
            given_,
            found((50, A, 0.9)),
            classes=PERSON,
            min_score=0.5,
        )

    frames = range(0, 100, 5)
    many = annotated(*((frame, 1, A) for frame in frames))
    every = found(*((frame, A, 0.9) for frame in range(100)))

    with pytest.raises(
        InputError, match=r"d: got a frame in 1; expected one in 5, as in a\.txt"
    ):
        pair_boxes(many, every, classes=PERSON, min_score=0.5)

    with pytest.raises(
        InputError, match=r"a\.txt: got nobody; expected boxes with an id of cycl"
    ):
        pair_boxes(
            given_,
            found(),
            classes={"cyclist": "cyclist"},
            min_score=0.5,
        )


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.booleans(), st.booleans()),
        min_size=1,
        max_size=30,
    ),
    st.integers(1, 3),
)
def test_frames_to_confirm_are_those_that_a_search_counts(rows, n):
    rows = sorted(rows, key=lambda row: row[0])
    tracks = [row[0] for row in rows]
    track = np.array(tracks)
    finds = [row[1] for row in rows]
    is_found = np.array(finds)
    steps = [1 + row[2] for row in rows]
    frame = np.cumsum(steps)  # some frames are missing

    waits = frames_to_confirm(
        is_found,
        track,
        frame,
        n_confirmations=n,
    )

    for start, wait in enumerate(waits.tolist()):
        on = {
            int(f)
            for f, t, hit in zip(frame, track, is_found, strict=True)
            if hit and t == track[start] and f >= frame[start]
        }
        ends = [f for f in sorted(on) if all(f - back in on for back in range(n))]
        assert wait == (ends[0] - frame[start] + 1 if ends else 0)


def test_a_share_counts_tracks_and_is_never_surer_than_wilson():
    tracks = np.arange(20)
    track = np.repeat(tracks, 50)
    drawn = default_rng(1).random(1000)
    independent = drawn < 0.8
    drawn_once = default_rng(2).random(20)
    is_track_found = drawn_once < 0.8
    whole = np.repeat(is_track_found, 50)  # all frames alike

    wide = share_by_track(whole, track)
    narrow = share_by_track(independent, track)

    n_found = independent.sum()
    plain = wilson(int(n_found), 1000)
    first_track = share_by_track(whole[:50], track[:50])

    assert narrow.low <= plain.low
    assert narrow.high >= plain.high
    assert narrow.high - narrow.low < 0.08 < 0.2 < wide.high - wide.low
    # One track tells nothing of others.
    assert first_track.low == 0.0
