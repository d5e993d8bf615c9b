import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.optimiser.bounds import (
    TimelyWindows,
    first_seen_index,
    first_seen_values,
    hardest_frames,
    timely_windows,
)
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis, live_confirmation_times_s

SEED = st.integers(0, 2**32 - 1)
EVERY = slice(None)


def draw_axis(random: np.random.Generator) -> FrameAxis:
    """Runs of up to 150 frames, some without weight, some that end before any window."""
    n_runs = int(random.integers(1, 6))
    lengths = random.integers(1, random.choice([8, 70, 150]), n_runs)
    weight = random.integers(0, 3, n_runs) + np.eye(n_runs)[0]
    return FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("case",) * n_runs,
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=weight / weight.sum(),
        last_brake_time_s=random.choice([-0.05, -0.5, -3.0, -np.inf], n_runs),
        run_start=np.concatenate([[0], np.cumsum(lengths)]),
        time_s=np.concatenate([0.1 * np.arange(1 - length, 1) for length in lengths]),
    )


def draw_rule(random: np.random.Generator) -> AebRule:
    return AebRule(
        deceleration_mps2=7.72,
        latency_s=0.025,
        n_confirmations=int(random.integers(1, 5)),
        frame_rate_hz=10.0,
        track_memory_s=float(random.choice([0.1, 0.3, 1.0, 8.0, np.inf])),
    )


def draw_bits(
    random: np.random.Generator, axis: FrameAxis, n_poses: int
) -> tuple[BoolArray, NDArray[np.uint8]]:
    seen = random.random((n_poses, axis.n_frames)) < random.choice([0.05, 0.5, 0.9])
    return seen, np.packbits(seen, axis=1, bitorder="little")


def margins_of(windows: TimelyWindows, index: IntArray) -> FloatArray:
    return windows.margin_s[np.arange(len(windows.run_index)), index]


@given(SEED)
def test_all_frames_give_the_margins_of_the_rule_for_live_tracks(seed: int) -> None:
    random = np.random.default_rng(seed)
    axis, rule = draw_axis(random), draw_rule(random)
    windows = timely_windows(axis, rule)
    seen, packed = draw_bits(random, axis, n_poses=70)
    index = first_seen_index(packed, windows, frames=EVERY, workers=2).astype(np.int64)
    times = live_confirmation_times_s(seen, axis, rule=rule)
    with np.errstate(invalid="ignore"):  # no time before no moment
        margin = axis.last_brake_time_s - (times + rule.latency_s)
    expected = np.where(margin >= -1e-9, margin, 0.0)[:, windows.run_index]
    np.testing.assert_allclose(margins_of(windows, index), expected, atol=1e-9)
    is_timely = (np.where(margin >= -1e-9, margin, -1.0) > -1.0) & (axis.weight > 0.0)
    assert set(np.flatnonzero(is_timely.any(axis=0))) <= set(windows.run_index.tolist())
    assert ((index < windows.n_windows) == is_timely[:, windows.run_index]).all()


@given(SEED)
def test_one_frame_of_each_window_is_looked_up_there(seed: int) -> None:
    random = np.random.default_rng(seed)
    axis, rule = draw_axis(random), draw_rule(random)
    windows = timely_windows(axis, rule)
    seen, packed = draw_bits(random, axis, n_poses=3)
    shape = (len(windows.run_index), windows.margin_s.shape[1] - 1)
    frames = random.integers(0, rule.n_confirmations, shape)
    index = first_seen_index(packed, windows, frames=frames)
    for pose, row in np.ndindex(index.shape):
        n_windows = int(windows.n_windows[row])
        asked = windows.first_frame[row] + np.arange(n_windows) + frames[row, :n_windows]
        hits = np.flatnonzero(seen[pose, asked])
        assert index[pose, row] == (hits[0] if len(hits) else n_windows)


@given(SEED)
def test_whatever_frame_is_asked_for_the_best_pose_promises_no_less_than_all_together(
    seed: int,
) -> None:
    random = np.random.default_rng(seed)
    axis, rule = draw_axis(random), draw_rule(random)
    windows = timely_windows(axis, rule)
    worth = windows.margin_s
    seen, packed = draw_bits(random, axis, n_poses=4)
    union = np.packbits(seen.any(axis=0), bitorder="little")[None, :]
    together = first_seen_values(union, windows, worth, frames=EVERY)[0]
    shape = (len(windows.run_index), windows.margin_s.shape[1] - 1)
    asked = random.integers(0, rule.n_confirmations, shape)
    last = slice(rule.n_confirmations - 1, None)
    hardest = hardest_frames(seen.any(axis=0).astype(np.float64), windows)
    for frames in (slice(0, 1), last, asked, hardest):
        promised = first_seen_values(packed, windows, worth, frames=frames).max(axis=0)
        assert (promised >= together).all()
        if frames is hardest and rule.track_memory_s == np.inf:
            np.testing.assert_array_equal(promised, together)


def test_values_are_rounded_up_and_written_where_asked(frame_axis: FrameAxis) -> None:
    rule = AebRule(deceleration_mps2=7.72, latency_s=0.025, n_confirmations=2, frame_rate_hz=10.0)
    windows = timely_windows(frame_axis, rule)
    assert windows.run_index.tolist() == [1]
    packed = np.packbits(np.ones((1, 10), dtype=bool), axis=1, bitorder="little")
    out = np.zeros((1, 1), dtype=np.float32)
    worth = np.full((1, 2), 0.1)
    values = first_seen_values(packed, windows, worth, frames=EVERY, out=out)
    assert values is out
    assert 0.1 <= float(out[0, 0]) < 0.1 + 1e-8


def test_wrong_frames_and_shapes_are_refused(frame_axis: FrameAxis) -> None:
    rule = AebRule(deceleration_mps2=7.72, latency_s=0.025, n_confirmations=2, frame_rate_hz=10.0)
    windows = timely_windows(frame_axis, rule)
    packed = np.zeros((1, 2), dtype=np.uint8)
    with pytest.raises(ValueError, match="frames"):
        first_seen_index(packed, windows, frames=slice(2, 3))
    with pytest.raises(ValueError, match="frames"):
        first_seen_index(packed, windows, frames=np.full((1, 1), 2))
    with pytest.raises(ValueError, match="worth"):
        first_seen_values(packed, windows, np.zeros((1, 7)), frames=EVERY)
