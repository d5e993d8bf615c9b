"""Memory that a question needs, and the limits that it meets."""

import resource

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with

from geometry.errors import InputError
from placement import memory
from placement.detection_table import DetectionTable
from placement.memory import check_memory, machine_bytes, needed_bytes

counts = st.integers(1, 10_000)


@given(counts, counts, counts)
def test_worlds_count_like_frames_and_frames_like_poses(poses, frames, worlds):
    need = needed_bytes(poses, frames, n_worlds=worlds)

    assert need == needed_bytes(frames, poses, n_worlds=worlds)
    assert need == needed_bytes(poses, frames * worlds)
    assert need > needed_bytes(poses, frames - 1, n_worlds=worlds)


def test_the_table_itself_is_part_of_what_is_needed(frame_axis):
    pose_ids = tuple(map(str, range(1000)))
    packed = np.zeros((1000, 2), dtype=np.uint8)
    table = DetectionTable(
        pose_ids=pose_ids,
        axis=frame_axis,
        packed=packed,
    )
    grown = needed_bytes(1000, frame_axis.n_frames) - needed_bytes(0, 0)

    assert grown >= table.packed.nbytes


def test_what_fits_is_let_through_to_the_last_byte(monkeypatch):
    monkeypatch.setattr(memory, "machine_bytes", lambda: needed_bytes(5000, 20_000))

    check_memory(5000, 20_000)

    with pytest.raises(InputError):
        check_memory(5000, 20_001)

    monkeypatch.setattr(memory, "machine_bytes", lambda: None)

    check_memory(10**9, 10**9)  # nothing is known: nothing is refused


def test_the_message_says_what_is_needed_and_how_to_shrink_it(monkeypatch):
    monkeypatch.setattr(memory, "machine_bytes", lambda: 2**30)
    with refused_with(
        "memory: got 5,772 poses x 18,311 frames in 64 sampled worlds, which need"
        " 7.5 GiB, where there are 1.0 GiB; expected a smaller question: fewer"
        " `samples`, fewer `cases`, `speeds`, `approaches` or `weather`, fewer"
        " `sensors`, or only the poles of `within`"
    ):
        check_memory(5772, 18_311, n_worlds=64)
    with pytest.raises(
        InputError, match=r"^memory: got 99,999 poses x 99,999 frames, which need"
    ):
        check_memory(99_999, 99_999)


@pytest.mark.parametrize(
    ("text", "is_less"),
    [
        ("12345678", True),
        ("max", False),
        ("", False),
    ],
)
def test_the_limit_of_a_container_counts(monkeypatch, tmp_path, text, is_less):
    file = tmp_path / "memory.max"
    file.write_text(text)

    whole = machine_bytes()
    monkeypatch.setattr(memory, "_LIMIT_FILES", (str(tmp_path / "missing"), str(file)))

    assert machine_bytes() == (12345678 if is_less else whole)


def test_the_limit_of_the_shell_counts(monkeypatch):
    limit = (7 * 2**20, resource.RLIM_INFINITY)
    monkeypatch.setattr(resource, "getrlimit", lambda which: limit)

    assert machine_bytes() == 7 * 2**20
