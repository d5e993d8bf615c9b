"""Why runs are not avoided: named things in tiny worlds, and everything else by brute
force.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from hypothesis import given
from hypothesis import strategies as st
from junctions import build_scene
from numpy.random import default_rng
from placed_bodies import parked_at
from tiny_worlds import run_of_frames, setting_of, table_of, unit_at

from geometry.catalogue import pick_sensor
from placement.detection_table import pack_table
from placement.explain.unavoided import Look, find_reasons, find_unavoided
from placement.optimiser import Limits, PlacementProblem, run_margins_s
from scenarios.runs import build_frame_axis

N_FRAMES = 20


def run_of(vru_m, *, vut_m=(-390.0, -390.0), last_brake_s=-0.5, **options):
    """An adult that stands somewhere for two seconds; nothing moves."""
    return run_of_frames(
        np.tile([*vru_m, 0.0], (N_FRAMES, 1)),
        [*vut_m, 90.0],
        shapes=0,
        last_brake_time_s=last_brake_s,
        **options,
    )


def setting_with(*runs, boxes=(), **fields):
    """A setting of runs and boxes."""
    scene = build_scene([], boxes=boxes)
    return setting_of(scene, runs, **fields)


def unit(
    x,
    y,
    z=5.0,
    *,
    yaw_deg=0.0,
    pitch_deg=-15.0,
    sensor="carla-ncap-rgb",
    fov_deg=None,
    name="unit",
):
    """A camera at a place."""
    model = pick_sensor(sensor, "test")
    return unit_at(
        name,
        [x, y, z],
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
        sensor=model if fov_deg is None else replace(model, horizontal_fov_deg=fov_deg),
    )


def reasons_of(setting, candidate, run_index=0):
    """Causes for which a unit does not see all of a run."""
    every_frame = np.arange(N_FRAMES)
    look = Look(unit=candidate, run_index=run_index, frame_index=every_frame)
    looks = [look]
    reasons = find_reasons(setting, looks)
    return [(r.cause, r.thing, r.frames) for r in reasons[0]]


def is_detected(setting, candidate):
    """Frames in which a unit detects, (n_frames,)."""
    table = table_of(setting, [candidate])
    return table.detected([0])[0]


WALL = ("wall-a", -8.0, 0.0, 0.5, 6.0, 4.0)
BEHIND = ("wall-b", 8.0, 0.0, 0.5, 6.0, 4.0)
PARKED = [parked_at("parked-van", east_m, 0.0, 90.0) for east_m in (-5.0, -9.0)]


@pytest.mark.parametrize("sensor", ["carla-ncap-rgb", "carla-ncap-lidar"])
@pytest.mark.parametrize(
    ("boxes", "run", "expected"),
    [
        ([WALL, BEHIND], run_of((0.0, 0.0)), ("hidden", "wall-a")),
        (
            [BEHIND],
            run_of((0.0, 0.0), obstruction=PARKED[:1]),
            ("hidden", "parked-van"),
        ),
        ([BEHIND], run_of((0.0, 0.0), vut_m=(-2.0, 0.0)), ("hidden", "the VUT")),
        (
            [BEHIND],
            run_of((0.0, 0.0), obstruction=PARKED),
            ("hidden", "parked-van (2)"),
        ),
    ],
    ids=["wall", "parked", "VUT", "two alike"],
)
def test_what_is_in_the_way_is_named(sensor, boxes, run, expected):
    setting = setting_with(run, boxes=boxes)
    low = unit(-20.0, 0.0, 1.2, pitch_deg=0.0, sensor=sensor)
    reasons = reasons_of(setting, low)

    assert not is_detected(setting, low).any()
    assert reasons == [(*expected, N_FRAMES)]

    # Without the thing it is detected: that is what "hidden" says.
    cleared = setting_with(run_of((0.0, 0.0)), boxes=[BEHIND])

    assert is_detected(cleared, low).all()


@pytest.mark.parametrize(
    ("candidate", "run", "expected"),
    [
        (unit(-20.0, 0.0, yaw_deg=180.0), run_of((0.0, 0.0)), "out of view"),
        (unit(-20.0, 0.0, pitch_deg=28.5), run_of((0.0, 0.0)), "cut off"),
        (unit(-20.0, 0.0), run_of((250.0, 0.0)), "too far"),
        (
            unit(-60.0, 0.0, pitch_deg=-4.0, fov_deg=30.0),
            run_of((0.0, 0.0), weather="fog"),
            "too dark",
        ),
        (
            unit(-20.0, 0.0, yaw_deg=180.0, sensor="carla-ncap-lidar"),
            run_of((0.0, 0.0)),
            "out of view",
        ),
        (unit(-20.0, 0.0, sensor="carla-ncap-lidar"), run_of((350.0, 0.0)), "too far"),
    ],
)
def test_what_else_it_may_be_is_told_apart(candidate, run, expected):
    setting = setting_with(run)
    reasons = reasons_of(setting, candidate)

    assert not is_detected(setting, candidate).any()
    assert reasons == [(expected, "", N_FRAMES)]


def test_a_frame_that_only_the_table_misses_is_said_to_be_so():
    assert reasons_of(setting_with(run_of((0.0, 0.0))), unit(-20.0, 0.0)) == [
        ("otherwise", "", N_FRAMES)
    ]


def problem_of(setting, candidates, detected, *, fusion="any", **limits):
    """A problem of candidates with these detections."""
    n_poses = len(candidates)
    site_index = np.arange(n_poses)
    site_capacity = np.ones(n_poses, int)
    apart = {"site_index": site_index, "site_capacity": site_capacity}
    pose_ids = tuple(c.id for c in candidates)
    table = pack_table(pose_ids, setting.axis, detected)
    return PlacementProblem(
        table=table,
        limits=Limits(**apart | limits),
        fusion=fusion,
        rule=setting.rule,
    )


def test_the_unit_that_looks_there_is_asked_before_one_that_is_nearer():
    run = run_of((0.0, 0.0))
    setting = setting_with(run, boxes=[WALL])
    candidates = [
        unit(-3.0, 0.0, yaw_deg=180.0, name="near"),
        unit(-20.0, 0.0, 1.2, pitch_deg=0.0, name="far"),
        unit(-3.0, 0.5, name="helper"),
    ]
    table = table_of(setting, candidates)

    detected = table.detected(slice(None))
    problem = problem_of(setting, candidates, detected)

    (missed,) = find_unavoided(setting, problem, candidates, [0, 1])
    causes = [(r.cause, r.thing) for r in missed.reasons]

    assert missed.outcome == "never seen"
    assert missed.unit == "far"
    assert missed.frames_seen == 0
    assert causes == [("hidden", "wall-a")]
    # Until 0.525 s before the impact.
    assert missed.frames_in_time == missed.reasons[0].frames == 14

    (missed,) = find_unavoided(setting, problem, candidates, [0])

    assert missed.unit == "near"
    assert missed.reasons[0].cause == "out of view"
    assert missed.rescue is not None
    assert missed.rescue.unit == "helper" or not table.detected([2]).any()


@st.composite
def tables(draw):
    """Three runs with any deadlines, seven poses anywhere, any detections."""
    seeds = st.integers(0, 2**32 - 1)
    seed = draw(seeds)
    rng = default_rng(seed)
    last = rng.choice([-0.3, -0.9, -1.5, -1.85, -np.inf], size=3)
    weight = np.array(
        draw(
            st.sampled_from(
                [
                    (1, 1, 1),
                    (0, 1, 3),
                    (2, 0, 0),
                ]
            )
        )
    )
    runs = [
        run_of((0.0, 0.0), name=f"run-{number}", last_brake_s=last_s)
        for number, last_s in enumerate(last)
    ]
    axis = build_frame_axis(runs, weight / weight.sum())
    setting = setting_with(*runs, axis=axis)
    n_poses = 7
    cells = rng.integers(0, 4, size=(n_poses, 2))
    places = cells * 10.0
    candidates = [unit(x, y, name=f"unit-{i}") for i, (x, y) in enumerate(places)]
    memories_s = st.sampled_from([0.1, 0.3, math.inf])
    memory_s = draw(memories_s)
    setting = changed(setting, "rule.track_memory_s", memory_s)
    shares = st.sampled_from([0.1, 0.3, 0.6])
    share = draw(shares)
    drawn = rng.random((n_poses, setting.axis.n_frames))
    detected = drawn < share
    problem = problem_of(
        setting,
        candidates,
        detected,
        fusion=draw(st.sampled_from(["any", "single"])),
        site_index=rng.integers(0, 4, n_poses),
        site_capacity=rng.integers(1, 4, 4),
        budget_units=2,
        is_forbidden=rng.random(n_poses) < 0.2,
        rivals=[[0, 1]] if draw(st.booleans()) else None,
    )
    chosen = rng.choice(n_poses, size=2, replace=False).tolist()
    return setting, problem, candidates, chosen


@given(given_=tables())
def test_outcome_and_rescue_match_brute_force(given_):
    setting, problem, candidates, chosen = given_
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "placement.explain.unavoided.find_reasons",
            lambda setting, looks, compute: [()] * len(looks),
        )
        entries = find_unavoided(setting, problem, candidates, chosen)

    run_ids = problem.table.axis.run_ids
    found = {run_ids.index(entry.run): entry for entry in entries}
    margin = run_margins_s(problem, chosen)
    has_weight = problem.table.axis.weight > 0.0

    is_lost = (margin == -np.inf) & has_weight
    expected = np.flatnonzero(is_lost).tolist()

    assert sorted(found) == expected

    for run, entry in found.items():
        check_outcome(problem, chosen, run, entry)

        helping = {}
        for pose in range(len(candidates)):
            if pose not in chosen and may_join(problem.limits, chosen, pose):
                margins_s = run_margins_s(problem, [*chosen, pose])
                left_s = margins_s[run]
                if left_s > -np.inf:
                    helping[pose] = left_s

        if not helping:
            assert entry.rescue is None
            continue

        feet = [one.pose.position_m for one in candidates]
        places = np.array(feet)
        away_m = {
            pose: np.linalg.norm(places[chosen] - places[pose], axis=1).min()
            for pose in helping
        }
        nearest_m = min(away_m.values())

        assert entry.rescue.distance_m == pytest.approx(nearest_m)

        helper = problem.table.pose_ids.index(entry.rescue.unit)

        assert helper in helping

        best = max(
            left_s
            for pose, left_s in helping.items()
            if away_m[pose] == pytest.approx(nearest_m)
        )

        assert entry.rescue.margin_s == pytest.approx(best)
        assert entry.rescue.margin_s == pytest.approx(helping[helper])


def check_outcome(problem, chosen, run, entry):
    """A run's outcome is what its frames and deadline say."""
    axis = problem.table.axis
    rule = problem.rule
    frames = axis.frames_of(run)
    time_s = axis.time_s[frames]
    last_s = axis.last_brake_time_s[run]
    counts = time_s + rule.latency_s <= last_s + 1e-9
    detected = problem.table.detected(chosen)
    seen = detected[:, frames]
    by_any = seen.any(axis=0)

    assert entry.frames_in_time == counts.sum()
    assert entry.frames_seen == (by_any & counts).sum()

    if problem.fusion == "any":
        together = [seen.any(axis=0)]
    else:
        together = list(seen)

    n = rule.n_confirmations
    confirmed = [
        time_s[end]
        for party in together
        for end in range(n - 1, len(time_s))
        if party[end + 1 - n : end + 1].all()
    ]
    late = [time for time in confirmed if time + rule.latency_s > last_s + 1e-9]
    if counts.sum() < n:
        assert entry.outcome == "hopeless"
        assert entry.rescue is None
        assert entry.unit == ""
    elif not seen.any():
        assert entry.outcome == "never seen"
    elif not confirmed:
        assert entry.outcome == "never confirmed"
    elif not late:
        assert entry.outcome == "lost again"
        assert rule.track_memory_s < math.inf
    else:
        assert entry.outcome == "too late"

    if late and np.isfinite(last_s):
        expected_s = min(late) + rule.latency_s - last_s
        assert entry.late_s == pytest.approx(expected_s)
    else:
        assert entry.late_s is None


def may_join(limits, chosen, pose):
    """May a pose join the chosen ones, by the limits?"""
    sites = limits.site_index
    shares_site = sites[chosen] == sites[pose]
    n_there = int(shares_site.sum())
    is_rival = any(
        {one, other} <= {sites[pose], *sites[chosen]} and sites[pose] in (one, other)
        for one, other in limits.rivals.tolist()
    )
    return (
        not limits.is_forbidden[pose]
        and n_there < limits.site_capacity[sites[pose]]
        and not is_rival
    )


def test_each_look_gets_its_own_reasons():
    runs = [
        run_of((0.0, 0.0), name="a"),
        run_of((0.0, 40.0), name="b"),
    ]
    setting = setting_with(*runs, boxes=[WALL])
    low = unit(-20.0, 0.0, 1.2, pitch_deg=0.0)
    away = unit(-20.0, 40.0, yaw_deg=180.0)
    looks = [
        Look(unit=away, run_index=1, frame_index=np.array([3, 4])),
        Look(unit=low, run_index=0, frame_index=np.array([5])),
        Look(unit=away, run_index=0, frame_index=np.array([0, 1, 2])),
        Look(unit=low, run_index=1, frame_index=np.array([], dtype=np.int64)),
    ]

    found = [
        [(r.cause, r.thing, r.frames) for r in reasons]
        for reasons in find_reasons(setting, looks)
    ]

    assert found == [
        [("out of view", "", 2)],
        [("hidden", "wall-a", 1)],
        [("out of view", "", 3)],
        [],
    ]
    assert find_reasons(setting, []) == []


def test_weather_and_speed_share_no_reason():
    clear = run_of((0.0, 0.0))
    foggy = run_of((0.0, 0.0), weather="fog", name="fog")
    in_fog = replace(foggy, encounter=clear.encounter)
    setting = setting_with(clear, in_fog, boxes=[])
    candidate = unit(-60.0, 0.0, pitch_deg=-4.0, fov_deg=30.0)
    by_day = reasons_of(setting, candidate, 0)
    in_fog_reasons = reasons_of(setting, candidate, 1)

    assert by_day == [("otherwise", "", N_FRAMES)]
    assert in_fog_reasons == [("too dark", "", N_FRAMES)]
