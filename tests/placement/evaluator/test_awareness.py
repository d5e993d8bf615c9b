"""When road users announce themselves, and in which frames they are known."""

from dataclasses import replace

import numpy as np
import pytest

from geometry.actors import pick_actor
from placement.evaluator.evaluate import (
    known_frames,
    load_vam_rule,
    sent_frames,
)
from placement.setting import Radio

RULE = load_vam_rule()


@pytest.fixture
def walk(build_run):
    """A run in which the VRU covers a distance per frame, straight east; 10 frames per
    second.
    """

    def build(steps_m, yaw_deg=None, vru="adult"):
        east_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        if yaw_deg is None:
            yaws = np.zeros(len(east_m))
        else:
            yaws = yaw_deg
        return build_run(
            pick_actor(vru, "test"),
            np.column_stack([east_m, np.zeros(len(east_m)), yaws]),
        )

    return build


def _sent(run):
    """Numbers of the frames in which a message is sent."""
    return np.flatnonzero(sent_frames(run, RULE)).tolist()


def _known(runs, seed=0, **links):
    """Frames of runs in which the road user is known."""
    return known_frames(runs, Radio(**links), np.random.default_rng(seed))


# Sent


def test_a_walker_sends_every_29th_frame(walk):
    """At 1.4 m/s more than 4 m are covered after 29 frames (4.06 m): every 2.9 s."""
    assert _sent(walk([0.14] * 99)) == [0, 29, 58, 87]


def test_one_who_stands_sends_every_five_seconds(walk):
    assert _sent(walk([0.0] * 120)) == [0, 50, 100]


def test_setting_off_and_stopping_are_told_at_once(walk):
    """Stands for 20 frames, walks for 15, stands again."""
    assert _sent(walk([0.0] * 20 + [0.14] * 15 + [0.0] * 10)) == [0, 20, 35]


def test_a_slow_change_of_speed_is_no_news_until_it_has_added_up(walk):
    """0.1 m/s faster in every frame: more than 0.5 m/s since the last message after
    six.
    """
    speeds_mps = 1.0 + 0.1 * np.arange(20)
    assert _sent(walk(speeds_mps / 10.0))[:3] == [0, 6, 12]


@pytest.mark.parametrize("start_deg", [0.0, 177.0, -178.5])
def test_a_turn_is_told_once_it_exceeds_four_degrees(walk, start_deg):
    """1.5 degrees per frame, over the turn of the compass too: after three frames
    4.5.
    """
    yaw_deg = (start_deg + 1.5 * np.arange(13) + 180.0) % 360.0 - 180.0
    assert _sent(walk([0.0] * 12, yaw_deg)) == [0, 3, 6, 9, 12]


def test_no_more_than_one_message_per_interval(walk):
    rule = replace(RULE, min_interval_s=0.3)
    run = walk([4.5] * 12)  # every frame would be news
    expected = list(range(13))

    assert np.flatnonzero(sent_frames(run, rule)).tolist() == [0, 3, 6, 9, 12]
    assert _sent(run) == expected


# Known


def test_without_devices_nothing_is_known_and_with_them_everything(walk):
    runs = [walk([0.14] * 99), walk([0.42] * 45, vru="cyclist"), walk([0.0] * 120)]
    n_frames = [100, 46, 121]

    assert not _known(runs, vam_rate=0.0).any()

    known = _known(runs, vam_rate=1.0)

    assert known.shape == (sum(n_frames),)
    assert known.all()
    assert not _known(runs, vam_rate=1.0, packet_loss=1.0).any()


def test_a_lost_message_leaves_what_was_known_until_the_next_must_come(walk):
    """One who stands sends in frames 0, 50 and 100; each message counts for 5 s."""
    run = walk([0.0] * 140)
    seen = set()

    for seed in range(60):
        known = _known([run], seed, vam_rate=1.0, packet_loss=0.5)
        received = [bool(known[frame + 25]) for frame in (0, 50, 100)]
        expected = np.zeros(141, dtype=bool)
        for frame, is_received in zip((0, 50, 100), received, strict=True):
            if is_received:
                expected[frame : frame + 51] = True

        assert np.array_equal(known, expected)

        seen.add(tuple(received))

    assert len(seen) == 8


@pytest.mark.long
def test_vrus_carry_devices_as_often_as_said_and_keep_them_for_a_run(walk):
    n_runs = 2000
    known = _known([walk([0.14] * 3) for _ in range(n_runs)], vam_rate=0.3).reshape(
        n_runs, 4
    )

    assert (known == known[:, :1]).all()

    # Five standard deviations of a binomial distribution.
    tolerance = 5.0 * np.sqrt(0.3 * 0.7 / n_runs)

    assert known[:, 0].mean() == pytest.approx(0.3, abs=tolerance)


def test_the_same_road_user_has_the_same_luck_in_all_weathers(walk):
    drives = [walk([0.14] * 30) for _ in range(20)]
    runs = [
        replace(run, weather=weather) for weather in ("day", "fog") for run in drives
    ]

    by_day, in_fog = _known(runs, vam_rate=0.5, packet_loss=0.5).reshape(2, -1)

    assert np.array_equal(by_day, in_fog)
    assert by_day.any()
    assert not by_day.all()
