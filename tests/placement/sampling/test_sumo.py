"""SUMO on a scene's own lanes; skipped where it is not installed, but for what is told
then.
"""

import importlib.util
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
from junctions import protocol_scene
from placed_bodies import ahead_of
from short_runs import cut_run

from geometry.errors import MissingExtraError
from geometry.scene import Lane
from geometry.study_scene import load_study_scene
from placement.sampling.driving import load_traffic
from placement.sampling.moving.demand import load_demand
from placement.sampling.moving.sumo import build_network, missing_sumo, simulate_windows


def _loads_sumo():
    """Whether SUMO is installed, and finds the libraries of the system that it
    needs.
    """
    if importlib.util.find_spec("libsumo") is None:
        return False

    command = [sys.executable, "-c", "import libsumo"]
    done = subprocess.run(command, capture_output=True)
    return done.returncode == 0


needs_sumo = pytest.mark.skipif(
    not _loads_sumo(),
    reason="SUMO is not installed (extra traffic), or a library of the system",
)
LANE_REACH_M = 2.0


@cache
def network_of(scene, demand):
    """SUMO's network of a scene."""
    return build_network(
        scene,
        speed_limit_mps=demand.speed_limit_mps,
        approach_m=demand.approach_m,
    )


@pytest.fixture(scope="module")
def cyclist_ahead(runs):
    """A run of the study in which a cyclist is ahead, from the east."""
    (run,) = [run for run in runs if run.id == "CBLA/east/50"]
    return run


def lasting(run, seconds):
    """The run with frames of its last position for so long: a window of that length."""
    n = round(10 * seconds)
    last_frames = np.full(n, -1)
    last = cut_run(run, last_frames)
    tenths = np.arange(1 - n, 1)
    return replace(last, time_s=tenths / 10.0)


def along(lane):
    """Unit vectors of a lane, ahead at its end and to its left."""
    ahead = lane.centreline_m[-1] - lane.centreline_m[-2]
    ahead /= np.hypot(*ahead)
    left = np.array([-ahead[1], ahead[0]])
    return ahead, left


def drive(scene, demand, runs, seed=0):
    """SUMO's traffic in the windows of runs."""
    groups = {run.id: (run,) for run in runs}
    return simulate_windows(
        network_of(scene, load_demand()),
        demand,
        groups,
        reach_m=100.0,
        step_s=0.1,
        rng=np.random.default_rng(seed),
    )


def test_without_sumo_one_line_says_what_is_missing(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)

    with pytest.raises(MissingExtraError) as caught:
        load_traffic("sumo", protocol_scene())

    message = str(caught.value)

    assert message == str(missing_sumo())
    assert "pip install place-rsus[traffic]" in message
    assert "\n" not in message


@needs_sumo
def test_every_arm_of_the_studys_junction_has_its_three_turns():
    network = network_of(load_study_scene(), load_demand())
    arms = {"north", "east", "south", "west"}
    arms_met = ["east", "north", "west", "south"]
    expected = dict.fromkeys(arms_met, 2)

    assert network.n_entry_lanes == expected

    for arm in arms:
        ways = network.ways[arm].items()
        exits = {turn: set(found) for turn, found in ways}
        all_exits = set.union(*exits.values())

        assert set(exits) == {"left", "straight", "right"}
        assert all_exits == arms - {arm}

    assert 'type="traffic_light"' in network.xml


@needs_sumo
def test_a_minute_of_traffic_stays_on_the_lanes_of_the_scene(cyclist_ahead):
    """Front bumpers, which SUMO moves along its lanes, against lanes straight on from
    the map.
    """
    scene = load_study_scene()
    demand = load_demand()
    longer = lasting(cyclist_ahead, 60.0)
    away = replace(longer, approach="nowhere")  # no VUT

    driven = drive(scene, demand, [away])
    found = driven.trajectories
    lengths_m = [body.length_m for body in found.bodies]
    half_m = 0.5 * np.array(lengths_m)
    n_bodies = len(found.bodies)
    numbers = np.arange(n_bodies)
    n_rows = np.diff(found.row_start)
    vehicle = np.repeat(numbers, n_rows)
    ahead = ahead_of(found.yaw_deg)
    to_front = half_m[vehicle, None] * ahead
    front = found.position_m + to_front
    lines = []
    for lane in scene.lanes:
        if lane.kind == "driving":
            points = lane.centreline_m
            first = points[0] - points[1]
            last = points[-1] - points[-2]
            first_m = np.hypot(*first)
            before_m = 150.0 * first / first_m
            before = points[0] + before_m
            last_m = np.hypot(*last)
            behind_m = 150.0 * last / last_m
            behind = points[-1] + behind_m
            line = shapely.LineString([before, *points, behind])
            lines.append(line)

    lanes = shapely.MultiLineString(lines)
    fronts = shapely.points(front)
    to_lane_m = shapely.distance(lanes, fronts)
    junction = shapely.Polygon(scene.outline_m)
    in_junction = shapely.contains_xy(junction, *front.T)

    assert len(found.bodies) > 20
    assert in_junction.any()
    assert to_lane_m[~in_junction].max() <= LANE_REACH_M

    # They drive the right way: beside the axis on the right, and as fast as they may.
    goes_on = np.diff(vehicle) == 0
    all_steps = np.diff(found.position_m, axis=0)
    steps = all_steps[goes_on]
    step_m = np.hypot(*steps.T)
    speed = step_m / 0.1
    ways = ahead[:-1][goes_on]
    along_m = steps * ways
    forwards_m = along_m.sum(axis=1)

    assert speed.max() < 1.5 * demand.speed_limit_mps
    assert (forwards_m > -0.05).all()


@needs_sumo
def test_the_same_seed_drives_the_same_traffic_and_another_one_another(runs):
    scene = load_study_scene()
    demand = replace(load_demand(), warm_up_s=10.0)
    ids = ("CBLA/east/50", "CBNA/east/60")
    chosen = [lasting(run, 2.0) for run in runs if run.id in ids]

    first = drive(scene, demand, chosen, 1)
    again = drive(scene, demand, chosen, 1)
    other = drive(scene, demand, chosen, 2)

    assert first.impact_s == again.impact_s
    assert np.array_equal(first.trajectories.position_m, again.trajectories.position_m)
    assert len(first.trajectories.bodies) > 0
    assert first.trajectories.position_m.shape != other.trajectories.position_m.shape


@needs_sumo
def test_vehicles_behind_the_vut_react_to_it(cyclist_ahead):
    """The VUT stands still in the lanes' middle: who comes from behind stops behind
    it.
    """
    scene = load_study_scene()
    lane = next(lane for lane in scene.lanes if lane.id == "-1_0")
    ahead, left = along(lane)
    place = lane.centreline_m[-1] - 30.0 * ahead
    standing = lasting(cyclist_ahead, 90.0)
    n = len(standing.time_s)
    vut_position_m = np.tile(place, (n, 1))
    standing = replace(
        standing,
        vut_speed_kmh=0.001,
        vut_position_m=vut_position_m,
        vut_yaw_deg=np.full(n, np.degrees(np.arctan2(ahead[1], ahead[0]))),
    )
    busy = replace(load_demand(), arms={"east": 1200.0})

    driven = drive(scene, busy, [standing])
    found = driven.trajectories
    offset_m = found.position_m - place
    along_m = offset_m @ ahead
    aside_m = np.abs(offset_m @ left)
    is_closest = aside_m < 1.0
    is_closest &= found.time_s > found.last_s - 60.0
    is_closest &= (along_m < 0.0) & (along_m > -12.0)

    assert is_closest.any()  # somebody stands there

    lengths = [body.length_m for body in found.bodies]
    lengths_m = np.array(lengths)
    n_bodies = len(found.bodies)
    numbers = np.arange(n_bodies)
    n_rows = np.diff(found.row_start)
    vehicle = np.repeat(numbers, n_rows)
    both_m = cyclist_ahead.encounter.vut.length_m + lengths_m[vehicle[is_closest]]
    gap_m = -along_m[is_closest] - 0.5 * both_m

    assert gap_m.min() > 0.0


@needs_sumo
def test_more_vehicles_than_the_lanes_can_take_are_told(cyclist_ahead):
    demand = replace(load_demand(), vehicles_per_hour_per_lane=10_000.0, warm_up_s=20.0)
    short = lasting(cyclist_ahead, 2.0)
    found = drive(load_study_scene(), demand, [short])

    assert found.n_departed > 20
    assert found.n_waiting > found.n_departed


@needs_sumo
def test_a_junction_without_lights_and_with_three_arms_is_driven(actors, rule):
    scene = protocol_scene()
    lanes = tuple(lane for lane in scene.lanes if not lane.id.startswith("north"))

    three_armed = replace(scene, lanes=lanes)
    network = network_of(three_armed, load_demand())
    arms = set(network.ways)
    from_east = set(network.ways["east"])

    assert arms == {"east", "south", "west"}
    assert from_east == {"straight", "left"}
    assert 'type="traffic_light"' not in network.xml


@needs_sumo
def test_a_pocket_for_turning_is_an_edge_of_its_own():
    """A second lane of 30 m beside one of 80 m: two edges, the near one with two
    lanes.
    """
    scene = protocol_scene()
    entry = next(lane for lane in scene.lanes if lane.id == "west-in-0")
    ahead, left = along(entry)
    end = entry.centreline_m[-1] - entry.width_m * left
    pocket_line = [end - 30.0 * ahead, end]
    pocket = replace(entry, id="west-pocket", centreline_m=pocket_line)

    network = network_of(replace(scene, lanes=(*scene.lanes, pocket)), load_demand())
    ways = network.ways["west"]

    assert set(ways) == {"straight", "left", "right"}

    for exits in ways.values():
        for edges in exits.values():
            assert edges.startswith("west-in-edge-1 west-in-edge-0 ")

    assert network.n_entry_lanes["west"] == 2
    assert 'id="west-in-edge-0_1"' in network.xml
    assert 'id="west-in-edge-1_1"' not in network.xml


@needs_sumo
def test_lanes_through_the_junction_are_driven_where_the_map_has_them():
    """From the west the map has one lane through: SUMO turns nobody there, but
    elsewhere.
    """
    scene = protocol_scene()
    ends = {lane.id: lane.centreline_m for lane in scene.lanes}
    through = Lane(
        id="through",
        kind="connecting",
        width_m=3.5,
        centreline_m=[ends["west-in-0"][-1], [0.0, -1.5], ends["east-out-0"][0]],
    )

    network = network_of(replace(scene, lanes=(*scene.lanes, through)), load_demand())
    ways = network.ways["west"].items()
    from_west = {turn: set(exits) for turn, exits in ways}
    from_east = set(network.ways["east"])

    assert from_west == {"straight": {"east"}}
    assert from_east == {"left", "straight", "right"}
    assert "0.00,-1.50" in network.xml


@needs_sumo
def test_lanes_that_keep_left_are_driven_on_the_left():
    scene = protocol_scene()
    mirrored = tuple(
        replace(lane, centreline_m=lane.centreline_m * [1.0, -1.0])
        for lane in scene.lanes
    )

    mirrored_scene = replace(scene, lanes=mirrored, keeps_left=True)
    network = network_of(mirrored_scene, load_demand())
    right = network_of(scene, load_demand())
    right_exits = set(right.ways["west"]["left"])
    left_exits = set(network.ways["west"]["left"])

    # In the mirror, north and south change places, and so do left and right.
    assert right_exits == {"north"}
    assert left_exits == {"north"}
    assert 'lefthand="true"' in network.xml


@needs_sumo
def test_a_vut_that_comes_from_beyond_the_network_joins_in_when_it_is_there(
    cyclist_ahead,
):
    """For the first second it is a kilometre away, where no lane is."""
    run = lasting(cyclist_ahead, 2.0)
    position = np.array(run.vut_position_m)
    position[:10] += [1000.0, 0.0]
    demand = replace(load_demand(), warm_up_s=10.0)

    away = replace(run, vut_position_m=position)

    found = drive(load_study_scene(), demand, [away])

    assert len(found.trajectories.bodies) > 0
