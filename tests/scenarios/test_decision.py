"""Tracks and the decision to brake, against closed forms and a plain filter."""

import math
from dataclasses import replace
from math import erf

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from geometry.errors import InputError
from scenarios.aeb import load_aeb_rule
from scenarios.decision import (
    CarWays,
    frames_in_time,
    largest_of_runs,
    load_decision_rule,
    located_sd_m,
    overlap_probability,
    track,
)
from scenarios.runs import FrameAxis

AEB = replace(load_aeb_rule(), track_memory_s=1.0)
RULE = load_decision_rule()
RESERVES_S = (0.0, 0.33, 1.0)


def axis_of(times, last_brake_s=None):
    """Frame axis of runs with these times; by default they must brake by 0 s."""
    n_runs = len(times)
    n_frames = [len(time_s) for time_s in times]
    if last_brake_s is None:
        last_brake_s = np.zeros(n_runs)

    return FrameAxis(
        run_ids=tuple(map(str, range(n_runs))),
        cases=("c",) * n_runs,
        approaches=("east",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 36.0),
        weight=np.full(n_runs, 1.0 / n_runs),
        last_brake_time_s=np.asarray(last_brake_s),
        run_start=np.cumsum([0, *n_frames]),
        time_s=np.concatenate(times),
    )


# ---------- a plain filter and decision: one run, matrices, no shortcuts


def plain_track(time_s, detected, position_m, covariance_m2):
    """State, covariance and whether a confirmed track lives, after each frame."""
    found = []
    state = cov = None
    streak = 0
    seen_s = -math.inf

    is_confirmed = False
    for frame, now_s in enumerate(time_s):
        if now_s - seen_s > AEB.track_memory_s + 1e-9:
            state = None
            is_confirmed = False
        if state is not None:
            dt = now_s - time_s[frame - 1]
            step = [
                [1.0, dt],
                [0.0, 1.0],
            ]
            noise = [
                [dt**3 / 3, dt**2 / 2],
                [dt**2 / 2, dt],
            ]
            F = np.kron(step, np.eye(2))
            Q = np.kron(noise, np.eye(2))

            state = F @ state
            cov = F @ cov @ F.T + RULE.acceleration_noise_m2ps3 * Q
        for unit in np.flatnonzero(detected[:, frame]):
            z = position_m[unit, frame]
            ee, en, nn = covariance_m2[unit, frame]
            R = np.array(
                [
                    [ee, en],
                    [en, nn],
                ]
            )
            H = np.eye(2, 4)
            if state is None:
                state = np.concatenate([z, [0.0, 0.0]])
                cov = np.zeros((4, 4))
                cov[:2, :2] = R
                cov[2:, 2:] = np.eye(2) * RULE.first_speed_sd_mps**2
                continue
            # Kalman's gain: how much of the surprise is believed.
            surprise = z - H @ state
            S = H @ cov @ H.T + R
            K = cov @ H.T @ np.linalg.inv(S)
            state = state + K @ surprise
            cov = (np.eye(4) - K @ H) @ cov

        if detected[:, frame].any():
            streak += 1
            seen_s = now_s
        else:
            streak = 0
        is_confirmed = is_confirmed or streak >= AEB.n_confirmations
        is_live = state is not None and is_confirmed
        found.append((state, cov, is_live))

    return found


def plain_probability(time_s, found, ways, run, reserve_s):
    """Largest probability of an overlap within the time to stop, frame by frame."""
    begin, end = ways.start[run : run + 2]
    places = ways.place[begin:end]
    place_s = time_s[0] + 0.1 * np.arange(len(places))
    end_s = ways.time_to_stop_s[run] + reserve_s
    steps = 0.1 * np.arange(100)
    taus = [*steps[steps < end_s], end_s]

    probabilities = []
    for now_s, (state, cov, is_live) in zip(time_s, found, strict=True):
        largest = 0.0
        if is_live:
            for tau in taus:
                then_s = now_s + tau
                at = [np.interp(then_s, place_s, column) for column in places.T]
                here = plain_overlap(
                    state,
                    cov,
                    tau,
                    at,
                    ways,
                    run,
                )
                largest = max(largest, here)
        probabilities.append(largest)

    return np.array(probabilities)


def plain_overlap(state, cov, tau, at, ways, run):
    """Probability that a body and the car, at a place with a yaw, overlap after tau."""
    east, north, yaw = at
    F = np.kron([[1.0, tau]], np.eye(2))
    mean = F @ state - [east, north]
    spread = F @ cov @ F.T
    spread += np.eye(2) * RULE.acceleration_noise_m2ps3 * tau**3 / 3
    turn = np.array(
        [
            [np.cos(yaw), np.sin(yaw)],
            [-np.sin(yaw), np.cos(yaw)],
        ]
    )
    mean = turn @ mean
    spread = np.diag(turn @ spread @ turn.T)
    car_sd_m = np.array([RULE.car_along_sd_m, RULE.car_across_sd_m])
    sd = np.sqrt(spread + car_sd_m**2)

    angle = math.atan2(state[3], state[2]) - yaw
    c = abs(math.cos(angle))
    s = abs(math.sin(angle))
    length, width = ways.half_vru_m[run]
    along = c * length + s * width
    across = s * length + c * width
    half = ways.half_vut_m + [along, across]

    probability = 1.0
    for h, m, one_sd in zip(half, mean, sd, strict=True):
        scale = one_sd * math.sqrt(2.0)
        above = erf((h - m) / scale)
        below = erf((-h - m) / scale)
        probability *= (above - below) / 2

    return probability


@pytest.fixture(scope="module")
def drawn():
    """200 random runs with three units, gaps longer than the memory among them."""
    rng = np.random.default_rng(7)
    times = []
    places = []
    for _ in range(200):
        n_frames = int(rng.integers(1, 40))
        times.append(np.arange(-n_frames + 1, 1) / 10.0)
        way_s = 0.1 * np.arange(n_frames + 40)
        first_yaw = rng.uniform(-3, 3)
        turning = rng.uniform(-0.3, 0.3)
        yaw = first_yaw + turning * way_s
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        steps = 0.1 * rng.uniform(3, 15) * ahead
        # Half of the way is before the middle of the junction.
        position = np.cumsum(steps, axis=0)
        position -= 0.5 * position[-1]
        places.append(np.column_stack([position, yaw]))

    axis = axis_of(times)
    n_frames = axis.n_frames
    chance = rng.choice([0.05, 0.5, 0.9], n_frames)
    seen = rng.random((3, n_frames)) < chance
    position_m = rng.normal(0.0, 8.0, (3, n_frames, 2))

    # Random covariances, none of them near to zero: east, between both, north.
    root = rng.normal(0.0, 0.7, (3, n_frames, 2, 2))
    square = root @ np.swapaxes(root, -1, -2)
    error = square + 0.01 * np.eye(2)
    covariance_m2 = error.reshape(3, -1, 4)[..., [0, 1, 3]]
    n_places = [len(place) for place in places]
    time_to_stop_s = rng.uniform(0.1, 1.5, 200)
    half_vru_m = rng.uniform(0.2, 1.0, (200, 2))
    ways = CarWays(
        place=np.concatenate(places),
        start=np.cumsum([0, *n_places]),
        time_to_stop_s=time_to_stop_s,
        half_vut_m=np.array([2.2, 0.9]),
        half_vru_m=half_vru_m,
    )
    return axis, seen, position_m, covariance_m2, ways


@pytest.mark.long
def test_tracks_and_decisions_equal_a_plain_filter_on_200_random_runs(drawn):
    axis, seen, position_m, covariance_m2, ways = drawn
    worlds_m = np.stack([position_m + 1.0, position_m])
    tracks = track(
        seen,
        worlds_m,
        covariance_m2,
        axis,
        aeb=AEB,
        rule=RULE,
    )
    ours = overlap_probability(
        tracks,
        axis,
        ways,
        RESERVES_S,
        rule=RULE,
        world=1,
    )

    n_live = 0
    for run in range(axis.n_runs):
        frames = axis.frames_of(run)
        time_s = axis.time_s[frames]
        found = plain_track(
            time_s,
            seen[:, frames],
            position_m[:, frames],
            covariance_m2[:, frames],
        )
        is_live = [lives for _, _, lives in found]

        assert_array_equal(tracks.is_live[frames], is_live)

        for offset, (state, cov, lives) in enumerate(found):
            if lives:
                n_live += 1
                at = frames.start + offset
                assert_allclose(tracks.state[1, at], state, atol=1e-9)
                assert_allclose(tracks.covariance[at], cov, atol=1e-9)
        for row, reserve_s in enumerate(RESERVES_S):
            plain = plain_probability(
                time_s,
                found,
                ways,
                run,
                reserve_s,
            )
            assert_allclose(ours[row, frames], plain, atol=1e-9)

    assert n_live > 500


def test_a_longer_reserve_never_lowers_the_probability(drawn):
    """More time to stop means more moments at which both may overlap."""
    axis, seen, position_m, covariance_m2, ways = drawn
    tracks = track(
        seen,
        position_m[None],
        covariance_m2,
        axis,
        aeb=AEB,
        rule=RULE,
    )
    # Ends that are steps, too.
    ways = replace(ways, time_to_stop_s=ways.time_to_stop_s.round(1))
    ours = overlap_probability(
        tracks,
        axis,
        ways,
        (0.0, 0.3, 1.0),
        rule=RULE,
    )

    more = np.diff(ours, axis=0)
    without_track = ours[:, ~tracks.is_live]

    assert (more >= -1e-6).all()
    assert (more > 0.1).any()
    assert ours.max() > 0.5
    assert (without_track == 0.0).all()


# ---------- closed forms: a car drives east at v, somebody crosses from the south
SPEED_MPS = 10.0
WALK_MPS = 1.5
SURE = replace(
    RULE,
    car_along_sd_m=1e-9,
    car_across_sd_m=1e-9,
    acceleration_noise_m2ps3=0.0,
    first_speed_sd_mps=1e3,
)


def crossing(noise_m2):
    """Axis, tracks and car of a straight crossing seen by one sensor from 3 s on."""
    time_s = np.arange(-300, 1) / 100.0
    stop_s = SPEED_MPS / (2.0 * AEB.deceleration_mps2)
    axis = axis_of([time_s], [-stop_s])
    # The car's front meets the edge of a body that is far from both its corners.
    east_m = np.full(301, 2.25)
    north_m = WALK_MPS * time_s
    place_m = np.column_stack([east_m, north_m])
    always = np.ones((1, 301), dtype=bool)
    noise = np.tile([noise_m2, 0.0, noise_m2], (1, 301, 1))
    tracks = track(
        always,
        place_m[None, None],
        noise,
        axis,
        aeb=AEB,
        rule=SURE,
    )
    # Its middle is at 0 at the impact.
    car_s = -3.0 + 0.1 * np.arange(60)
    place = np.zeros((60, 3))
    place[:, 0] = SPEED_MPS * car_s
    ways = CarWays(
        place=place,
        start=np.array([0, 60]),
        time_to_stop_s=np.array([stop_s + AEB.latency_s]),
        half_vut_m=np.array([2.0, 0.9]),
        half_vru_m=np.array([[0.25, 0.25]]),
    )
    return axis, tracks, ways


def test_without_noise_the_car_brakes_at_the_last_brake_time_less_the_latency():
    """All is sure, so that the decision comes when the closed form says."""
    axis, tracks, ways = crossing(1e-16)
    (probability,) = overlap_probability(
        tracks,
        axis,
        ways,
        [0.0],
        rule=SURE,
    )
    first = np.argmax(probability >= 0.5)
    brakes_s = axis.time_s[first]
    last_s = axis.last_brake_time_s[0] - AEB.latency_s

    assert probability[-1] == pytest.approx(1.0)
    # To a frame, which are 10 ms apart.
    assert abs(brakes_s - last_s) <= 0.0101


def test_the_place_of_the_impact_is_located_as_least_squares_say():
    """The filter's error equals that of a line fitted to all places seen."""
    # Without noise of accelerations the filter is a line fitted to all places.
    noise_m = 0.3
    axis, _, _ = crossing(noise_m**2)
    always = np.ones((2, 1, 301), dtype=bool)
    always[1, 0, 200:] = False
    covariance_m2 = [noise_m**2, 0.0, noise_m**2]
    error = np.tile(covariance_m2, (2, 1, 301, 1))
    found_m = located_sd_m(
        always,
        error,
        axis,
        np.zeros(1),
        aeb=AEB,
        rule=SURE,
    )
    in_time = frames_in_time(axis, latency_s=AEB.latency_s)

    for row, seen in enumerate(always):
        used_s = axis.time_s[in_time & seen[0]]
        design = np.column_stack([np.ones(len(used_s)), used_s])
        spread = np.linalg.inv(design.T @ design)
        expected_m = noise_m * math.sqrt(spread[0, 0])
        assert found_m[row, 0] == pytest.approx(expected_m, rel=1e-3)

    assert found_m[1, 0] > found_m[0, 0]


def test_nothing_is_located_where_no_track_lives():
    """What is never detected may be anywhere."""
    axis = axis_of([np.arange(-9, 1) / 10.0], [-0.2])
    never = np.zeros((1, 1, 10), dtype=bool)
    error = np.ones((1, 1, 10, 3))
    found_m = located_sd_m(
        never,
        error,
        axis,
        np.zeros(1),
        aeb=AEB,
        rule=RULE,
    )

    assert found_m[0, 0] == np.inf


def test_largest_of_runs_is_that_of_each_run():
    axis = axis_of([np.arange(3.0), np.arange(2.0)])
    values = np.array([[0.1, 0.5, 0.2, 0.0, 0.3]])
    largest = largest_of_runs(values, axis)

    assert_array_equal(largest, [[0.5, 0.3]])


# ---------- rules of one's own


@pytest.mark.parametrize(
    ("text", "where", "expected"),
    [
        ("body_sd_m = 0", "body_sd_m", "a finite number, more than 0"),
        ("body_sd_m = inf", "body_sd_m", "a finite number"),
        ("threshold = 1.5", "threshold", "at least 0 and at most 1"),
        ("threshold = -0.1", "threshold", "at least 0 and at most 1"),
        ("box_noise_share = 0.0", "box_noise_share", "more than 0 and at most 1"),
        ("draws = 0", "draws", "more than 0"),
        ("drawz = 3", "drawz", "one of"),
    ],
)
def test_a_rule_that_cannot_be_is_refused_in_a_line(tmp_path, text, where, expected):
    """The line names the file, the field and what is expected there."""
    path = tmp_path / "rule.toml"
    path.write_text(text)

    with pytest.raises(InputError) as caught:
        load_decision_rule(str(path))

    told = str(caught.value)
    assert where in told
    assert expected in told
    assert str(path) in told


def test_a_rule_of_ones_own_keeps_what_it_does_not_say(tmp_path):
    path = tmp_path / "rule.toml"
    path.write_text("threshold = 0.25\n")
    assert load_decision_rule(str(path)) == replace(RULE, threshold=0.25)


def test_an_unknown_rule_is_refused():
    with pytest.raises(InputError, match="decision: got 'careful'; expected default"):
        load_decision_rule("careful")
