"""Where drives of a recording begin and end, and what is left out."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from placement.recordings.evaluate import is_same_direction
from placement.recordings.files import FrameKey, RecordedWorld, load_format
from placement.recordings.read import (
    MISFITS,
    NO_APPROACH,
    RESETS,
    TOO_SHORT,
    UNSEEN,
    cut_drives,
    with_class,
)

FORM = load_format()


def _world(*parts, scenario=0, first=0):
    """Frames from (distances, VUT speed, VRU speed), numbered on."""
    rows = [RecordedWorld(d, v, u) for distances, v, u in parts for d in distances]
    return {FrameKey(scenario, first + index): row for index, row in enumerate(rows)}


def _falling(n_frames, closing_mps=10.0, last_m=2.0):
    """Distances that fall to the last one, at 10 Hz. [m]"""
    return [
        last_m + closing_mps * (n_frames - 1 - index) / 10.0
        for index in range(n_frames)
    ]


def _cut(world):
    """Drives as (scenario, first, last), what is left out, and the drives."""
    drives, left_out = cut_drives(world, FORM)
    spans = [(d.scenario, d.first_number, d.frames[-1].number) for d in drives]
    return spans, dict(left_out), drives


def test_a_drive_goes_to_the_smallest_distance_and_the_resets_behind_it_are_left_out():
    distances = _falling(12) + [13.0] * 30
    world = _world((distances, 10.0, 1.5))
    spans, left_out, (drive,) = _cut(world)
    distances_m = drive.distance_m.tolist()

    assert spans == [(0, 0, 11)]
    assert left_out == {RESETS: 30}
    assert distances_m == _falling(12)
    assert drive.closing_speed_mps == pytest.approx(10.0)
    assert drive.vru_class == UNSEEN
    assert drive.n_missing == 0


def test_another_speed_is_another_drive_in_the_same_numbering():
    spans, left_out, drives = _cut(
        _world(
            (_falling(12) + [13.0] * 30, 10.0, 1.5),
            (_falling(15, 15.0) + [23.0] * 30, 15.0, 1.5),
        )
    )
    speeds_mps = [drive.vut_speed_mps for drive in drives]

    assert spans == [
        (0, 0, 11),
        (0, 42, 56),
    ]
    assert left_out == {RESETS: 60}
    assert speeds_mps == [10.0, 15.0]


def test_the_same_speed_again_is_another_drive_where_the_distance_jumps_up():
    # Frames 12..41: resets; the last of them is where the second drive begins.
    distances = _falling(12) + [13.0] * 30 + _falling(12)[1:]
    world = _world((distances, 10.0, 1.5))
    expected = ([(0, 0, 11), (0, 41, 52)], {RESETS: 29})

    assert _cut(world)[:2] == expected


def test_the_first_reset_frame_may_still_show_the_bodies_where_they_met():
    # The generator tells the positions of the tick before.
    spans, left_out, (drive,) = _cut(
        _world((_falling(12) + [1.8] + [13.0] * 29, 10.0, 1.5))
    )

    assert spans == [(0, 0, 12)]
    assert left_out == {RESETS: 29}
    assert drive.distance_m[-1] == 1.8


def test_a_body_that_stands_and_waits_is_part_of_the_drive():
    # Only the VRU moves at first, with 1.5 m/s.
    waiting = [13.0 + 0.15 * index for index in range(20, 0, -1)]
    distances = waiting + _falling(12)
    world = _world((distances, 10.0, 1.5))
    spans = _cut(world)[0]

    assert spans == [(0, 0, 31)]


def test_missing_frames_are_nan_and_time_goes_on():
    drive_given = (_falling(12), 10.0, 1.5)
    world = _world(drive_given, first=100)
    for number in (104, 109):
        del world[FrameKey(0, number)]

    spans, left_out, (drive,) = _cut(world)
    is_missing = np.isnan(drive.distance_m)

    assert spans == [(0, 100, 111)]
    assert left_out == {}
    assert np.flatnonzero(is_missing).tolist() == [4, 9]
    assert drive.n_frames == 12
    assert drive.n_missing == 2
    assert drive.closing_speed_mps == pytest.approx(10.0)


def test_drives_do_not_reach_over_more_than_ten_missing_seconds():
    drive_given = (_falling(12), 10.0, 1.5)
    near = _world(drive_given)
    far = _world(drive_given, first=10**8)

    expected = [
        (0, 0, 11),
        (0, 10**8, 10**8 + 11),
    ]

    assert _cut(near | far)[0] == expected


@pytest.mark.parametrize(
    ("distances", "reason"),
    [
        ([13.0] * 30, NO_APPROACH),
        ([13.0, 14.0, 15.0], NO_APPROACH),
        ([13.0, 14.0], TOO_SHORT),
        ([3.0, 2.0], TOO_SHORT),
        ([4.0, 3.0, 2.0, 2.0], None),
        (_falling(12, 40.0), MISFITS),  # as if speeds stood there in other units
        (_falling(12, 4.0), MISFITS),
    ],
)
def test_what_is_no_drive_is_left_out_with_its_reason(distances, reason):
    world = _world((distances, 10.0, 1.5))
    spans, left_out, _ = _cut(world)
    if reason is None:
        assert spans == [(0, 0, 2)]
        assert left_out == {RESETS: 1}
    else:
        assert spans == []
        assert left_out == {reason: len(distances)}


def test_all_runs_of_the_study_in_one_numbering_are_found_again_with_their_directions(
    runs,
):
    # Positions as the generator tells them, 30 frames of reset behind each drive.
    world = {}
    numbers = []
    for run in runs:
        distance = np.linalg.norm(run.vut_position_m - run.vru_position_m, axis=1)
        numbers.append(len(world))
        speeds = run.encounter.vut_motion.speed_mps, run.encounter.vru_motion.speed_mps
        for distance_m in [*distance, *[distance[0]] * 30]:
            world[FrameKey(0, len(world))] = RecordedWorld(float(distance_m), *speeds)

    drives, left_out = cut_drives(world, FORM)
    found_frames = [drive.n_frames for drive in drives]
    n_frames = [len(run.time_s) for run in runs]

    assert [drive.first_number for drive in drives] == numbers
    assert found_frames == n_frames
    assert dict(left_out) == {RESETS: 30 * len(runs)}

    told = [
        is_same_direction(
            vut_speed_mps=drive.vut_speed_mps,
            vru_speed_mps=drive.vru_speed_mps,
            closing_speed_mps=drive.closing_speed_mps,
            form=FORM,
        )
        for drive in drives
    ]
    is_longitudinal = [run.case.name == "CBLA" for run in runs]

    assert told == is_longitudinal


@given(
    st.lists(
        st.tuples(
            st.floats(0.0, 60.0), st.sampled_from([5.0, 10.0]), st.integers(0, 1)
        ),
        min_size=1,
        max_size=40,
    ),
    st.integers(0, 2**40),
)
def test_every_frame_is_in_one_drive_or_left_out(rows, gaps):
    world = {}
    number = 0
    for index, (distance, vut_speed, scenario) in enumerate(rows):
        number += 1 + (gaps >> index & 1)
        world[FrameKey(scenario, number)] = RecordedWorld(distance, vut_speed, 1.5)

    drives, left_out = cut_drives(world, FORM)
    inside = [key for drive in drives for key in drive.frames if key in world]
    distinct = len(set(inside))
    n_counted = len(inside) + left_out.total()

    assert distinct == len(inside)
    assert n_counted == len(world)

    for drive in drives:
        is_missing = np.isnan(drive.distance_m)
        known = drive.distance_m[~is_missing]
        smallest_m = known.min()

        assert drive.distance_m[-1] == smallest_m
        assert not np.isnan(drive.distance_m[0])

        for key, distance in zip(drive.frames, drive.distance_m, strict=True):
            is_missing = np.isnan(distance)
            assert is_missing == (key not in world)


@pytest.mark.parametrize(
    ("votes", "name"),
    [
        ({}, UNSEEN),
        ({"pedestrian": 3}, "pedestrian"),
        ({"pedestrian": 3, "bicycle": 2}, "pedestrian"),
        ({"pedestrian": 3, "bicycle": 3}, "bicycle"),  # a rider who is labelled, too
    ],
)
def test_the_class_of_a_drive_is_that_of_most_labels(votes, name):
    world = _world((_falling(12), 10.0, 1.5))
    _, _, (drive,) = _cut(world)
    counted = with_class(drive, Counter(votes))

    assert counted.vru_class == name
