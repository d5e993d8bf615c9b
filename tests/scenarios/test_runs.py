"""Runs of every case, and what is made of their frames."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from dragged import has_contact
from hypothesis import given
from hypothesis import strategies as st
from junctions import ARMS, build_scene, protocol_scene
from oracles import separation_m, simulated_track_s
from refusals import refused_with
from strategies import frame_axes, numbers

from geometry.study_scene import load_study_scene
from scenarios.cases import load_cases
from scenarios.positions import build_positions
from scenarios.runs import (
    build_frame_axis,
    find_onsets,
    live_confirmation_times_s,
)
from scenarios.weights import weight_per_run


def asked_of(approach, *, is_thorough):
    """What is driven from an arm: a case of every family from one arm, at its lowest
    and highest speed by turns; thoroughly: every case from all of them, at both.
    """
    cases = load_cases()
    if not is_thorough:
        names = {case.family: name for name, case in cases.items()}.values()
        cases = {name: cases[name] for name in names}
    arms = list(ARMS)

    for number, (name, case) in enumerate(cases.items()):
        lap, turn = divmod(number, len(arms))
        low_kmh, high_kmh = case.speed_limits_kmh
        if is_thorough:
            yield name, sorted({low_kmh, high_kmh})
        elif arms[turn] == approach:
            yield name, [(high_kmh, low_kmh)[lap % 2]]


@pytest.fixture(
    scope="module",
    params=[False, pytest.param(True, marks=pytest.mark.long)],
    ids=["quick", "thorough"],
)
def asked(request):
    """Case, approach and speed of all that is asked for."""
    every = set()
    for approach in ARMS:
        for name, speeds in asked_of(approach, is_thorough=request.param):
            every |= {(name, approach, speed) for speed in speeds}
    return every


@pytest.fixture(scope="module")
def all_runs(lay, asked):
    """All that is asked for on the study's junction: runs, and what is refused."""
    runs = []
    refusals = []
    for approach in ARMS:
        speeds = {}
        for name, arm, speed in sorted(asked):
            if arm == approach:
                speeds.setdefault(name, []).append(speed)

        cases = []
        for name, driven in speeds.items():
            case = load_cases()[name]
            cases.append(replace(case, vut_speeds_kmh=tuple(driven)))

        laid, refused = lay(load_study_scene(), cases, approaches=[approach])
        runs += laid
        refusals += refused

    return runs, refusals


def test_the_study_junction_has_104_runs_of_the_studys_own_cases_with_unique_ids(runs):
    by_case = Counter(run.case.name for run in runs)
    ids = {run.id for run in runs}

    assert by_case == {"CPNC-50": 36, "CBNA": 36, "CBLA": 32}
    assert len(ids) == len(runs) == 104
    assert "CPNC-50/east/20" in ids


# Every case, by the study's own starts or laid by the protocol


@pytest.mark.long
def test_every_case_is_carried_or_refused_with_a_reason(all_runs, asked):
    """Nothing that is asked for gets lost, and nothing else comes along."""
    runs, refusals = all_runs
    told = {(run.case.name, run.approach, run.vut_speed_kmh) for run in runs}

    for refusal in refusals:
        assert refusal.reason
        for speed in refusal.speeds_kmh:
            told.add((refusal.case.name, refusal.approach, speed))

    assert told == asked


@pytest.mark.long
def test_without_braking_every_run_of_every_case_first_touches_at_its_impact(all_runs):
    """Seen from 25 s before in steps of 10 ms, and 5 ms behind it."""
    runs, _ = all_runs
    before_s = np.linspace(-25.0, -1e-3, 2501)
    from_s = np.array([0.0, 5e-3])

    for run in runs:
        before = separation_m(run.encounter, before_s)
        at, after = separation_m(run.encounter, from_s)
        assert (before > 0.0).all(), run.id
        assert at == pytest.approx(0.0, abs=1e-5), run.id
        assert after < 0.0, run.id


@pytest.mark.long
def test_last_brake_times_of_every_case_are_the_last_ones(all_runs, rule):
    """Braking then or earlier avoids contact; a millisecond later it does not."""
    runs, _ = all_runs

    for run in runs:
        last_s = run.last_brake_time_s
        assert run.time_s[0] < last_s < 0.0, run.id

        for earlier_s in (0.0, 1e-3, 0.05, 0.3):
            onset_s = last_s - earlier_s
            assert not has_contact(run.encounter, onset_s, rule), run.id

        late_s = last_s + 1e-3
        assert has_contact(run.encounter, late_s, rule), run.id


def test_frames_hold_the_motions_and_the_gait(all_runs):
    """Shapes follow the way that has been walked, not the time."""
    runs, _ = all_runs
    for run in runs:
        encounter = run.encounter
        for motion, position, yaw_deg in (
            (encounter.vut_motion, run.vut_position_m, run.vut_yaw_deg),
            (encounter.vru_motion, run.vru_position_m, run.vru_yaw_deg),
        ):
            wanted, wanted_yaw_deg = motion.path.at(motion.distance_m(run.time_s))
            assert np.array_equal(position, wanted)
            assert np.array_equal(yaw_deg, wanted_yaw_deg)

        walked_m = encounter.vru_motion.distance_m(run.time_s)
        shapes = encounter.vru.shape_index(walked_m)

        assert np.array_equal(run.vru_shape, shapes)

        # People on foot and on bicycles move their limbs.
        is_moving = len(set(shapes.tolist())) > 1
        assert is_moving == (encounter.vru.cycle_m > 0.0)

        standing = run.time_s <= encounter.vru_motion.start_time_s
        assert (run.vru_shape[standing] == 0).all()


# Weather, approaches


def test_each_weather_is_a_run_of_its_own(lay):
    """The same motion, another name."""
    weathers = ("day", "rain")
    scene = load_study_scene()
    (dry, wet, *_), _ = lay(scene, ["CPTAns-50"], weathers=weathers)

    assert dry.id == "CPTAns-50/east/10"
    assert wet.id == "CPTAns-50/east/10/rain"
    assert dry.weather == "day"
    assert wet.weather == "rain"
    assert dry.time_s is wet.time_s


def test_runs_that_are_known_are_taken_and_the_others_laid(lay):
    """What is known is the same object, not an equal one."""
    scene = load_study_scene()
    case = load_cases()["CPTAns-50"]
    laid, _ = lay(scene, [case])
    known, _ = lay(scene, [case], known=laid[:1])

    assert [run.id for run in known] == [run.id for run in laid]
    assert known[0] is laid[0]
    assert known[1] is not laid[1]

    # A case of the same name that says something else is another one.
    changed = replace(case, vru_reference_m=0.1)
    others, _ = lay(scene, [changed], known=laid)

    assert not set(others) & set(laid)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"approaches": ["up"]},
            "approach: got 'up'; expected one of east, north, west, south",
        ),
        (
            {"weathers": ["snow"]},
            "weather: got 'snow'; expected one of day, night, rain, fog",
        ),
    ],
)
def test_unknown_words_list_the_known_ones(lay, options, message):
    with refused_with(message):
        lay(load_study_scene(), ["CBLA"], **options)


def test_things_in_the_way_are_named(lay):
    """Every speed is refused for the same reason."""
    wall = ("shed", -9.5, -4.0, 3.0, 1.0, 2.0)  # across the near side's start
    scene = protocol_scene(boxes=[wall])
    runs, refusals = lay(scene, ["CPNA-25"], approaches=["west"])

    assert not runs
    assert {refusal.reason for refusal in refusals} == {"shed stands in the VRU's way"}
    assert len(refusals[0].speeds_kmh) == 11


# Speed limits


def limited(scene, limits_kmh):
    """A scene whose lanes into the junction have speed limits, by the begin of their
    ids.
    """
    lanes = []
    for lane in scene.lanes:
        limit_kmh = limits_kmh.get(lane.id.partition("-in")[0])
        lanes.append(replace(lane, speed_limit_kmh=limit_kmh))
    return replace(scene, lanes=tuple(lanes))


@pytest.mark.long
def test_nothing_is_driven_faster_than_the_speed_limit(lay):
    """Limits of lanes into the junction, by the arm from which the VUT comes."""
    limits_kmh = {"east": 42.0, "north": 15.0}
    free = protocol_scene()
    scene = limited(free, limits_kmh)
    cases = ["CPNA-25", "CPLA-25"]
    options = {
        "speeds_kmh": (10.0, 20.0, 40.0, 50.0),
        "positions": build_positions([0.0, 15.0]),
    }
    every, _ = lay(free, cases, **options)
    runs, refusals = lay(scene, cases, **options)

    slow = []
    for run in every:
        if run.vut_speed_kmh <= limits_kmh.get(run.approach, np.inf):
            slow.append(run.id)

    assert [run.id for run in runs] == slow

    approaches = {run.approach for run in runs if run.case.name == "CPNA-25"}
    assert approaches >= {"west", "south", "east"}

    fast = [one for one in refusals if one.limit_kmh is not None]
    n_refused = sum(len(one.speeds_kmh) for one in fast)

    reasons = {(one.approach, one.reason) for one in fast}

    assert n_refused == len(every) - len(slow)
    assert reasons == {
        ("east", "faster than the speed limit of 42 km/h"),
        ("north", "faster than the speed limit of 15 km/h"),
    }
    assert not any(one.is_possible for one in fast)

    unlimited, _ = lay(
        scene,
        cases,
        keeps_limits=False,
        **options,
    )
    assert [run.id for run in unlimited] == [run.id for run in every]


def test_a_road_that_is_missing_is_missing_at_every_speed(lay):
    """The reason is the road, also where the limit forbids the speed."""
    lanes = protocol_scene().lanes
    lanes = [lane for lane in lanes if not lane.id.startswith("south-out")]
    scene = limited(build_scene(lanes), {"east": 12.0})
    _, (refusal,) = lay(scene, ["CPTAfs-50"], approaches=["east"])

    assert refusal.limit_kmh is None
    assert refusal.speeds_kmh == load_cases()["CPTAfs-50"].vut_speeds_kmh


# The study's own runs


def test_frames_lie_on_the_10_hz_grid_and_end_at_the_impact(runs):
    """The first frame is the first in which anybody moves."""
    for run in runs:
        n_frames = len(run.time_s)
        on_grid_s = np.arange(1 - n_frames, 1) / 10.0

        assert run.time_s.tolist() == on_grid_s.tolist()
        assert run.time_s[-1] == 0.0

        # All of the drive: one frame more would be before anybody sets off.
        motions = (run.encounter.vut_motion, run.encounter.vru_motion)
        first_s = min(motion.start_time_s for motion in motions)

        assert run.time_s[0] >= first_s - 1e-6
        assert run.time_s[0] - 0.1 < first_s


def test_arrays_of_a_run_are_read_only(runs):
    fields = [
        "time_s",
        "vut_position_m",
        "vut_yaw_deg",
        "vru_position_m",
        "vru_yaw_deg",
    ]
    for field in fields:
        with pytest.raises(ValueError, match="read-only"):
            getattr(runs[0], field)[0] = 0.0


# Frames of all runs


def test_frame_axis_lays_the_frames_of_runs_end_to_end(runs):
    """Slices of the axis are the runs' own frames."""
    some = runs[::20]
    axis = build_frame_axis(some, weight_per_run(some))

    assert axis.n_runs == len(some)
    assert axis.n_frames == sum(len(run.time_s) for run in some)

    for index, run in enumerate(some):
        frames = axis.frames_of(index)
        assert axis.time_s[frames].tolist() == run.time_s.tolist()
        assert axis.run_ids[index] == run.id
        assert axis.cases[index] == run.case.name
        assert axis.approaches[index] == run.approach
        assert axis.vut_speed_kmh[index] == run.vut_speed_kmh
        assert axis.last_brake_time_s[index] == run.last_brake_time_s


def test_frame_axis_of_no_run_is_refused():
    with refused_with("runs: got none; expected at least one run"):
        build_frame_axis([], np.zeros(0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weight": [0.5, 0.5]}, "weight: got shape (2,); expected shape (3,)"),
        (
            {"weight": [0.5, 0.5, 0.5]},
            "weight: got [0.5, 0.5, 0.5]; expected shares >= 0 that sum to 1",
        ),
        (
            {"weight": [1.5, -0.5, 0.0]},
            "weight: got [1.5, -0.5, 0.0]; expected shares >= 0 that sum to 1",
        ),
        (
            {"last_brake_time_s": [0.0, math.nan, 0.0]},
            "last_brake_time_s: got [0.0, nan, 0.0]; expected one time per run",
        ),
        (
            {"last_brake_time_s": [0.0]},
            "last_brake_time_s: got [0.0]; expected one time per run",
        ),
        (
            {"run_start": [0, 3, 3, 10]},
            (
                "run_start: got [0, 3, 3, 10]; expected 0 and ascending, one "
                "more than runs"
            ),
        ),
        (
            {"run_start": [1, 3, 8, 10]},
            (
                "run_start: got [1, 3, 8, 10]; expected 0 and ascending, one "
                "more than runs"
            ),
        ),
        (
            {"run_start": [0, 3, 10]},
            ("run_start: got [0, 3, 10]; expected 0 and ascending, one more than runs"),
        ),
        ({"run_start": [0, 3, 8, 11]}, "time_s: got 10 frames; expected 11"),
        (
            {"time_s": [-0.2, -0.1, 0.0, -0.4, -0.2, -0.3, -0.1, 0.0, -0.1, 0.0]},
            ("time_s: got -0.2 before -0.3; expected times that ascend within a run"),
        ),
        (
            {"time_s": [-0.2, -0.1, 0.0, -0.4, -0.3, -0.2, -0.1, 0.0, 0.0, 0.0]},
            ("time_s: got 0.0 before 0.0; expected times that ascend within a run"),
        ),
        (
            {"run_start": [0, 4, 8, 10]},
            ("time_s: got 0.0 before -0.4; expected times that ascend within a run"),
        ),
        (
            {"vut_speed_kmh": [1.0, math.inf, 2.0]},
            "vut_speed_kmh: got [1.0, inf, 2.0]; expected finite numbers",
        ),
    ],
)
def test_frame_axis_says_what_is_wrong(frame_axis, change, message):
    with refused_with(message):
        replace(frame_axis, **change)


# From detected frames to the onset of braking


def rule_with(rule, n, memory_s=math.inf, latency_s=0.025):
    """A rule with so many confirmations."""
    return replace(
        rule,
        n_confirmations=n,
        track_memory_s=memory_s,
        latency_s=latency_s,
    )


def drawn(data, elements, axis):
    """An element for each frame of an axis."""
    n = axis.n_frames
    values = data.draw(st.lists(elements, min_size=n, max_size=n))
    return np.array(values)


memories_s = st.sampled_from([0.1, 0.2, 0.3, 0.5, 1.0, math.inf])


@given(
    frame_axes(),
    st.integers(1, 4),
    memories_s,
    numbers(0.0, 1.0),
    st.data(),
)
def test_live_confirmations_are_those_of_each_run(
    rule, axis, n, memory_s, latency_s, data
):
    """By a plain simulation of tracks, frame by frame."""
    first = drawn(data, st.booleans(), axis)
    second = drawn(data, st.booleans(), axis)
    rows = np.stack([first, second])
    rule = rule_with(rule, n, memory_s, latency_s)
    found_s = live_confirmation_times_s(rows, axis, rule=rule)
    alone_s = live_confirmation_times_s(rows[1], axis, rule=rule)

    assert np.array_equal(alone_s, found_s[1])

    for run in range(axis.n_runs):
        frames = axis.frames_of(run)
        until_s = float(axis.last_brake_time_s[run]) - latency_s
        for row, times_s in zip(rows, found_s, strict=True):
            expected_s = simulated_track_s(
                row[frames],
                axis.time_s[frames],
                until_s=until_s,
                memory_s=memory_s,
                n=n,
            )
            assert times_s[run] == expected_s


def test_many_rows_are_looked_at_in_parts(rule, frame_axis):
    """More rows than fit into one part give the same as each by itself."""
    rng = np.random.default_rng(0)
    rows = rng.random((3, 150, frame_axis.n_frames)) < 0.6
    rule = rule_with(rule, 2, 0.1)
    found_s = live_confirmation_times_s(rows, frame_axis, rule=rule)

    assert found_s.shape == (3, 150, frame_axis.n_runs)

    for place in ((0, 0), (1, 63), (2, 149)):
        one_s = live_confirmation_times_s(rows[place], frame_axis, rule=rule)
        assert np.array_equal(found_s[place], one_s)


# What messages of frames take; infinite: there is none.
DELAYS_S = st.one_of(st.just(math.inf), numbers(0.0, 1.0))


def windows_of(axis, run, arrival_s, n):
    """When each window of a run is known, the time of its last frame, and that
    frame.
    """
    frames = axis.frames_of(run)
    time_s = axis.time_s[frames].tolist()
    known_s = arrival_s[frames].tolist()

    windows = []
    for last in range(n - 1, len(time_s)):
        all_known_s = max(known_s[last - n + 1 : last + 1])
        windows.append((all_known_s, time_s[last], last))

    return windows


@given(
    frame_axes(),
    st.integers(1, 3),
    memories_s,
    st.data(),
)
def test_the_vut_brakes_for_the_live_window_that_it_knows_first(
    rule, axis, n, memory_s, data
):
    """Window by window: known by the last brake time, and no gap until the last
    moment.
    """
    arrival_s = axis.time_s + drawn(data, DELAYS_S, axis)
    rule = rule_with(rule, n, memory_s)
    onsets = find_onsets(arrival_s, axis, rule=rule)

    for run in range(axis.n_runs):
        last_brake_s = axis.last_brake_time_s[run]
        frames = axis.frames_of(run)
        time_s = axis.time_s[frames]
        seen = arrival_s[frames] <= last_brake_s + 1e-9
        windows = windows_of(axis, run, arrival_s, n)
        windows = [one for one in windows if one[0] < math.inf]
        in_time = [one for one in windows if one[0] <= last_brake_s + 1e-9]

        def lives(frame, time_s=time_s, seen=seen, last_brake_s=last_brake_s):
            is_later = np.arange(len(time_s)) >= frame
            stops = time_s[seen & is_later]
            end_s = max(last_brake_s - rule.latency_s, stops[-1])
            gaps = np.diff([*stops, end_s])
            return (gaps <= memory_s + 1e-9).all()

        live = [one for one in in_time if lives(one[2])]
        late = [one for one in windows if one not in in_time]

        assert onsets.is_in_time[run] == bool(live)
        for group, has_onset in (
            (live, True),
            (late, True),
            (in_time, False),
            ([], False),
        ):
            if group or not (live or late or in_time):
                known_s = min((one[0] for one in group), default=math.inf)
                assert onsets.onset_s[run] == (known_s if has_onset else math.inf)
                first = [t for k, t, _ in group if not has_onset or k == known_s]
                assert onsets.confirmation_s[run] == min(first, default=math.inf)
                break


def test_a_track_that_is_lost_again_sets_nothing_in_motion(rule, frame_axis):
    """Second run, frames at -0.4 .. 0 s, seen at -0.4 and -0.3 s; last moment at -0.025
    s.
    """
    last_s = np.array([0.0, 0.0, -np.inf])
    axis = replace(frame_axis, last_brake_time_s=last_s)
    arrival_s = np.full(10, np.inf)
    arrival_s[3:5] = axis.time_s[3:5] + 0.025

    for memory_s, onset_s in (
        (0.2, math.inf),
        (0.275, -0.275),
        (math.inf, -0.275),
    ):
        onsets = find_onsets(arrival_s, axis, rule=rule_with(rule, 2, memory_s))
        assert onsets.confirmation_s == pytest.approx([math.inf, -0.3, math.inf])
        assert onsets.onset_s == pytest.approx([math.inf, onset_s, math.inf])
        assert onsets.is_in_time.tolist() == [False, onset_s < 0.0, False]
