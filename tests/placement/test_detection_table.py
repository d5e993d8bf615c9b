"""Bits of detection tables: packed, read back, and never changed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with
from strategies import detection_tables

from placement.detection_table import DetectionTable, pack_table


@given(detection_tables(), st.data())
def test_a_table_gives_back_what_was_packed(packed, data):
    table, detected = packed
    unpacked = table.detected(slice(None))

    assert table.n_poses == len(detected)
    assert np.array_equal(unpacked, detected)

    rows = data.draw(st.lists(st.integers(0, table.n_poses - 1), max_size=4))
    some = table.detected(rows)

    assert np.array_equal(some, detected[rows])
    assert table.detected(rows).dtype == np.bool_


@pytest.mark.parametrize("n_frames", [1, 7, 8, 9, 16, 17])
def test_a_table_takes_one_bit_per_frame(frame_axis, n_frames):
    axis = type(frame_axis)(
        run_ids=("r",),
        cases=("A",),
        approaches=("north",),
        weathers=("day",),
        vut_speed_kmh=np.array([20.0]),
        weight=np.array([1.0]),
        last_brake_time_s=np.array([-0.5]),
        run_start=np.array([0, n_frames]),
        time_s=np.arange(1 - n_frames, 1) / 10.0,
    )

    all_detected = np.ones((2, n_frames), dtype=bool)
    table = pack_table(("p", "q"), axis, all_detected)
    unpacked = table.detected(slice(None))

    assert table.packed.shape == (2, (n_frames + 7) // 8)
    assert unpacked.all()
    assert repr(table) == f"DetectionTable(2 poses, {n_frames} frames)"


def test_the_lowest_bit_comes_first(frame_axis):
    detected = np.zeros((1, 10), dtype=bool)
    detected[0, [0, 9]] = True
    table = pack_table(("p",), frame_axis, detected)

    assert table.packed.tolist() == [[1, 2]]


def test_a_table_of_the_wrong_size_is_refused(frame_axis):
    packed = np.zeros((2, 1), np.uint8)
    with refused_with("packed: got shape (2, 1); expected shape (2, 2)"):
        DetectionTable(
            pose_ids=("p", "q"),
            axis=frame_axis,
            packed=packed,
        )


def test_the_bits_of_a_table_are_read_only_and_its_own(frame_axis):
    packed = np.zeros((1, 2), dtype=np.uint8)
    table = DetectionTable(pose_ids=("p",), axis=frame_axis, packed=packed)
    packed[:] = 255
    first_row = table.detected([0]).any()

    assert not first_row
    with pytest.raises(ValueError, match="read-only"):
        table.packed[0, 0] = 1
