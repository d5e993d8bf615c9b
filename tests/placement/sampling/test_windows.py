"""Windows of traffic against hand-made tracks, and who is left out of a run."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import protocol_scene
from short_runs import cut_run

from geometry.actors import MovingActor, PlacedActor, load_actors
from geometry.footprints import footprint_corners, footprint_separation
from geometry.poses import Pose
from placement.sampling.moving import sumo
from placement.sampling.moving.demand import load_demand
from placement.sampling.moving.sumo import SimulatedWindows, SumoTraffic
from placement.sampling.moving.trajectories import (
    Trajectories,
    cut_window,
    frames_in_parked,
    last_frames,
    meets_road_users,
)
from placement.sampling.uncertainty import Uncertainty, with_moving_traffic
from placement.sampling.worlds import draw_samples

VAN = load_actors()["parked-van"]
MIDDLE_M = np.zeros(2)


def tracks(*columns, step_s=0.1):
    """Trajectories of vans, each (first time, positions (n, 2), yaw)."""
    positions_m = [points for _, points, _ in columns]
    n_points = list(map(len, positions_m))
    times_s = [first + step_s * np.arange(len(points)) for first, points, _ in columns]
    return Trajectories(
        bodies=(VAN,) * len(columns),
        row_start=np.cumsum([0, *n_points]),
        time_s=np.concatenate(times_s),
        position_m=np.concatenate(positions_m),
        yaw_deg=np.repeat([yaw for _, _, yaw in columns], n_points),
        step_s=step_s,
        first_s=min(time_s[0] for time_s in times_s),
        last_s=max(time_s[-1] for time_s in times_s),
    )


def straight(first_m, last_m, n, *, left_m=0.0):
    """Evenly spaced points from west to east, (n, 2). [m]"""
    along_m = np.linspace(first_m, last_m, n)
    across_m = np.full(n, left_m)
    return np.column_stack([along_m, across_m])


def standing(position_m, n_frames, *, yaw_deg=0.0):
    """A van that stands."""
    return MovingActor(
        actor=VAN,
        position_m=np.tile(position_m, (n_frames, 1)),
        yaw_deg=np.full(n_frames, yaw_deg),
    )


def test_a_window_has_the_frames_that_the_tracks_have():
    found = tracks(
        (0.0, straight(-10.0, 10.0, 201), 0.0), (15.0, straight(5.0, 5.0, 101), 90.0)
    )
    steps = np.arange(51)
    time_s = 12.0 + 0.1 * steps

    one, other = cut_window(found, time_s, middle_m=MIDDLE_M)
    expected = (time_s > 14.95).tolist()
    east_m = one.position_m[:, 0]
    last_m = other.position_m[-1].tolist()

    assert east_m == pytest.approx(-10.0 + time_s)
    assert one.yaw_deg == pytest.approx(0.0)
    assert other.is_there.tolist() == expected
    assert last_m == [5.0, 0.0]


def test_nobody_farther_than_the_reach_is_in_a_window():
    found = tracks(
        (0.0, straight(-150.0, 150.0, 301), 0.0),
        (0.0, straight(130.0, 140.0, 301), 0.0),
    )

    steps = np.arange(301)
    (one,) = cut_window(found, 0.1 * steps, middle_m=MIDDLE_M)
    nearest_m = np.nanmin(one.position_m[:, 0])
    farthest_m = np.nanmax(one.position_m[:, 0])
    n_there = int(one.is_there.sum())

    assert nearest_m == pytest.approx(-100.0)
    assert farthest_m == pytest.approx(100.0)
    assert n_there == 201

    near = cut_window(
        found,
        0.1 * np.arange(301),
        middle_m=MIDDLE_M,
        reach_m=200.0,
    )

    assert [int(body.is_there.sum()) for body in near] == [301, 301]


def test_a_shorter_run_has_the_last_frames_of_the_window():
    (body,) = cut_window(
        tracks((0.0, straight(0.0, 20.0, 21), 0.0)),
        0.1 * np.arange(41),
        middle_m=MIDDLE_M,
    )

    tail = last_frames(body, 30)
    last_m = body.position_m[-30:]

    assert np.array_equal(tail.position_m, last_m, equal_nan=True)
    assert last_frames(body, 20) is None  # it has left by then
    assert last_frames(body, 41) is body


def brute_force_meets(run, body, clearance_m):
    """Footprints of all frames, one by one."""

    def corners(actor, position_m, yaw_deg):
        return footprint_corners(
            position_m,
            yaw_deg,
            length_m=actor.length_m,
            width_m=actor.width_m,
        )

    for actor, position_m, yaw_deg in (
        (run.encounter.vut, run.vut_position_m, run.vut_yaw_deg),
        (run.encounter.vru, run.vru_position_m, run.vru_yaw_deg),
    ):
        for frame in np.flatnonzero(body.is_there).tolist():
            one = corners(actor, position_m[frame], yaw_deg[frame])
            other = corners(body.actor, body.position_m[frame], body.yaw_deg[frame])
            if footprint_separation(one, other) <= clearance_m:
                return True

    return False


@pytest.mark.long
@pytest.mark.parametrize("clearance_m", [0.0, 0.5])
def test_who_meets_a_road_user_is_found_as_frame_by_frame(junction_runs, clearance_m):
    run = junction_runs["west"]
    n = len(run.time_s)
    rng = np.random.default_rng(0)
    bodies = []
    for _ in range(200):
        frame = rng.integers(n)
        scatter_m = rng.normal(scale=4.0, size=2)
        around = run.vut_position_m[frame] + scatter_m
        yaw_deg = float(rng.uniform(0.0, 360.0))
        body = standing(around, n, yaw_deg=yaw_deg)
        position = np.array(body.position_m)
        position[: rng.integers(n)] = np.nan
        body_there = replace(body, position_m=position)
        bodies.append(body_there)

    meets = meets_road_users(run, bodies, clearance_m=clearance_m)
    found = np.array(meets)
    meets_by_frame = [brute_force_meets(run, one, clearance_m) for one in bodies]
    expected = np.array(meets_by_frame)

    # Standing bodies meet no one between frames alone but by less than a step.
    assert not (expected & ~found).any()
    assert (found & ~expected).sum() <= 0.1 * len(bodies)
    assert 20 < found.sum() < 180


def test_who_passes_between_two_frames_is_found(standing_still):
    """A van jumps over the VRU from one frame to the next."""
    run = standing_still([20.0, 0.0])
    n = len(run.time_s)
    position = np.full((n, 2), np.nan)
    position[4], position[5] = (
        [14.0, 0.0],
        [26.0, 0.0],
    )

    yaw_deg = np.zeros(n)
    body = MovingActor(actor=VAN, position_m=position, yaw_deg=yaw_deg)
    found = meets_road_users(run, [body], clearance_m=0.5)

    assert not brute_force_meets(run, body, 0.5)
    assert found == (True,)


def test_a_clearance_keeps_vehicles_away_and_no_farther(standing_still):
    run = standing_still([20.0, 0.0])
    n = len(run.time_s)
    # The VRU looks north: its own half length is 0.3 m along north, half its width 0.25
    # m east.
    vru = run.encounter.vru
    edge_m = 20.0 + 0.5 * vru.width_m + 0.5 * VAN.length_m

    near = standing([edge_m + 0.49, 0.0], n)
    far = standing([edge_m + 0.51, 0.0], n)
    found = meets_road_users(run, [near, far], clearance_m=0.5)

    assert found == (True, False)


def test_who_stands_in_a_parked_car_is_found_and_who_passes_it_is_not():
    pose = Pose(position_m=[0.0, 3.0, 0.0], yaw_deg=0.0)
    parked = PlacedActor(actor=VAN, pose=pose)
    inside = standing([1.0, 2.0], 4)
    beside = standing([0.0, 3.0 - VAN.width_m - 0.01], 4)
    position = np.array(inside.position_m)
    position[[0, 3]] = np.nan
    gone = replace(inside, position_m=position)

    found = frames_in_parked([inside, beside, gone], [parked])

    expected = [
        [True] * 4,
        [False] * 4,
        [False, True, True, False],
    ]
    indices = [frames.tolist() for frames in found]

    assert indices == expected


# Worlds


@pytest.fixture(autouse=True)
def drives(monkeypatch):
    """In place of SUMO: vans that drive west, most of them far enough from
    everybody.
    """
    lanes = [
        (3.0 * k, straight(99.0, -99.0, 200, left_m=8.0 if k % 2 else -1.75), 180.0)
        for k in range(200)
    ]
    driven = tracks(*lanes)

    def simulate(network, demand, groups, *, reach_m, step_s, rng):
        steps = rng.integers(200, 5000, size=len(groups))
        impact = steps * step_s
        impact_s_of_group = impact.tolist()
        impact_s = dict(zip(groups, impact_s_of_group, strict=True))
        return SimulatedWindows(
            trajectories=driven,
            impact_s=impact_s,
            n_departed=200,
            n_waiting=0,
        )

    monkeypatch.setattr(sumo, "simulate_windows", simulate)


@pytest.fixture(scope="module")
def recorded():
    """Vans in place of SUMO's demand."""
    middle_m = protocol_scene().outline_m.mean(axis=0)
    return SumoTraffic(
        name="vans",
        middle_m=middle_m,
        demand=load_demand(),
        network=None,
    )


def worlds(setting, recorded, *, n_samples=2, seed=1, **options):
    """Worlds in which the vans drive."""
    uncertainty = with_moving_traffic(Uncertainty(), recorded)
    found = draw_samples(
        setting,
        (),
        uncertainty,
        n_samples=n_samples,
        seed=seed,
        **options,
    )
    return list(found)


@pytest.fixture(scope="module")
def driven(build_setting, junction_scene, junction_runs):
    """Runs from all approaches of the tiny junction."""
    runs = [*junction_runs.values()]
    return build_setting(junction_scene, runs)


def records(*options, **named):
    """Traffic of worlds, in a form that can be compared."""
    return [
        [
            (body.actor.name, body.position_m.tobytes())
            for run in sample.setting.runs
            for body in run.traffic
        ]
        for sample in worlds(*options, **named)
    ]


def test_the_same_seed_draws_the_same_traffic_and_another_one_another(driven, recorded):
    first = records(driven, recorded)
    expected = records(driven, recorded, n_samples=1)
    other = records(driven, recorded, seed=2)
    judged = records(driven, recorded, purpose="judge")

    assert first == records(driven, recorded)
    assert first[:1] == expected
    assert first[0] != first[1]
    assert first[0] != other[0]
    assert first[0] != judged[0]


def test_who_would_be_in_the_way_is_left_out_and_counted(driven, recorded):
    (sample,) = worlds(driven, recorded, n_samples=1)
    runs = sample.setting.runs
    count = sample.driving
    n_driving = sum(len(run.traffic) for run in runs)
    expected = n_driving + count.n_left_out

    assert not sample.looks_as_planned
    assert count.n_runs == len(runs)
    assert count.n_vehicles == expected
    assert 0 < count.n_left_out < count.n_vehicles
    assert f"{count.n_left_out} of {count.n_vehicles} vehicles" in str(count)

    for run in runs:
        is_met = any(meets_road_users(run, run.traffic, clearance_m=0.5))
        assert not is_met


def test_runs_of_one_group_see_the_same_moment_of_the_same_traffic(
    build_setting, junction_scene, junction_runs, recorded
):
    whole = junction_runs["west"]
    last = slice(-15, None)
    short = cut_run(whole, last, id="short")
    (sample,) = worlds(
        build_setting(junction_scene, [whole, short]), recorded, n_samples=1
    )
    long_traffic, short_traffic = (run.traffic for run in sample.setting.runs)
    tails = {body.position_m[-15:].tobytes() for body in long_traffic}
    short_tails = {body.position_m.tobytes() for body in short_traffic}

    assert short_traffic
    assert tails & short_tails


def test_waiting_vehicles_are_not_drawn_beside_those_that_drive(default, recorded):
    changed = with_moving_traffic(default, recorded)

    assert changed.traffic.waiting_share == 0.0
    assert changed.traffic.taken_share == default.traffic.taken_share > 0.0
    assert default.traffic.waiting_share > 0.0
