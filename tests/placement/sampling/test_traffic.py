"""Standing traffic: where it parks and waits, and in whose way it never stands."""

from collections import Counter
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from junctions import ARMS, MOUTH_M, build_scene, lanes_of, protocol_scene
from sampled_worlds import first_world
from shapely import Polygon

from geometry.actors import load_actors, read_body
from geometry.errors import InputError
from geometry.footprints import footprint_corners, footprint_separation
from geometry.junction import Line, build_junction
from geometry.scene import strips_of
from geometry.study_scene import load_study_scene
from placement.sampling.traffic import (
    build_street,
    build_ways,
    clear_of_ways,
    group_key,
    stop_line_m,
)
from placement.sampling.uncertainty import StandingTraffic, VehicleKind
from placement.sampling.worlds import RandomStreams
from scenarios.cases import load_cases
from scenarios.runs import build_runs


def _rng(index=0, seed=3):
    """Generator of a world."""
    streams = RandomStreams(seed=seed, purpose="choose", index=index)
    return streams.rng


def _traffic(*, body="parked-van", **fields):
    """Traffic of one kind of vehicle."""
    kind = VehicleKind(actor=load_actors()[body], parked_share=1.0, waiting_share=1.0)
    values = {"vehicles": (kind,), **fields}
    return StandingTraffic(**values)


def _corners(placed):
    """Corners of a vehicle's footprint, (4, 2). [m]"""
    return footprint_corners(
        placed.pose.position_m[:2],
        placed.pose.yaw_deg,
        length_m=placed.actor.length_m,
        width_m=placed.actor.width_m,
    )


# Where they stand


def _bus_scene():
    """The protocol's junction with a second lane at every kerb, for buses."""
    lanes = []
    for arm, bearing in ARMS.items():
        for lane in lanes_of(arm, bearing, n_lanes=2, arm_m=80.0):
            if lane.id.endswith("-0"):
                lane = replace(lane, kind="bus")
            lanes.append(lane)
    return build_scene(lanes)


def _bus(waiting_share=1.0):
    """The kind of vehicle that waits in bus lanes."""
    size = {
        "length_m": 12.0,
        "width_m": 2.55,
        "height_m": 3.1,
    }
    table = {"name": "bus", **size}
    actor = read_body(table, "bus")
    return VehicleKind(actor=actor, parked_share=1.0, waiting_share=waiting_share)


def test_a_bus_waits_in_each_bus_lane_if_asked_for():
    scene = _bus_scene()
    traffic = StandingTraffic(bus_lane_share=1.0, vehicles=(_bus(),))
    street = build_street(scene, traffic)
    vehicles = street.draw(_rng())

    strips = strips_of(
        lane for lane in scene.lanes if lane.kind == "bus" and "-in-" in lane.id
    )

    assert len(vehicles) == len(strips) == 4

    for strip in strips:
        inside = [strip.contains(Polygon(body.footprint_m)) for body in vehicles]
        assert sum(inside) == 1


def test_no_bus_waits_in_a_bus_lane_by_default():
    traffic = StandingTraffic(vehicles=(_bus(),))
    street = build_street(_bus_scene(), traffic)
    vehicles = street.draw(_rng())

    assert traffic.is_empty
    assert not vehicles


def test_nobody_but_a_bus_waits_or_parks_in_a_bus_lane():
    scene = _bus_scene()
    traffic = _traffic(taken_share=1.0, waiting_share=1.0, following_share=1.0)
    buses = strips_of(lane for lane in scene.lanes if lane.kind == "bus")

    street = build_street(scene, traffic)
    vehicles = street.draw(_rng())

    assert vehicles

    for body in vehicles:
        footprint = Polygon(body.footprint_m)
        for strip in buses:
            assert not strip.intersects(footprint)


def test_a_bus_lane_share_needs_a_bus():
    with pytest.raises(
        InputError, match="vehicles: got no bus; expected one named bus"
    ):
        _traffic(bus_lane_share=0.5)


def test_a_full_parking_lane_is_a_row_of_bumpers(junction_scene):
    traffic = _traffic(
        taken_share=1.0,
        parked_gap_m=0.8,
        clear_of_mouth_m=5.0,
        along_arm_m=40.0,
    )
    van = traffic.vehicles[0].actor

    street = build_street(junction_scene, traffic)
    vehicles = street.draw(_rng())
    poses = [vehicle.pose for vehicle in vehicles]
    on_east_arm = sorted(
        (pose.position_m[1], pose.position_m[0], pose.yaw_deg)
        for pose in poses
        if pose.position_m[0] > MOUTH_M
    )
    # From 5 m to 40 m behind the mouth: 4.9 m and 0.8 m, six times.
    index = np.arange(6)
    ahead = 5.0 + 0.5 * van.length_m + 5.7 * index
    beside = 3.5 + 0.5 * 2.6
    # Out of the junction: eastwards.
    expected = [(-beside, MOUTH_M + x, 0.0) for x in ahead]
    expected += [(beside, MOUTH_M + x, 180.0) for x in ahead]
    found = np.array(on_east_arm)
    expected_poses = np.array(expected)
    levels = {(pose.position_m[2], pose.pitch_deg) for pose in poses}

    assert len(vehicles) == 4 * 12
    assert found == pytest.approx(expected_poses, abs=1e-9)
    assert levels == {(0.0, 0.0)}


def test_an_empty_street_is_empty(junction_scene):
    street = build_street(junction_scene, _traffic())
    vehicles = street.draw(_rng())
    assert vehicles == ()


@pytest.mark.long
def test_the_share_of_places_taken_is_as_asked(junction_scene):
    # Places and vehicles are equally long here: every place is a coin of its own.
    traffic = _traffic(
        taken_share=0.3,
        free_place_m=5.7,
        parked_gap_m=0.8,
        along_arm_m=62.0,
    )

    street = build_street(junction_scene, traffic)
    n_places = 8 * 10
    counts = [len(street.draw(_rng(index))) for index in range(60)]
    variance = 0.3 * 0.7 / (60 * n_places)
    error = np.sqrt(variance)
    mean = np.mean(counts)

    assert mean / n_places == pytest.approx(0.3, abs=4.0 * error)
    assert len(set(counts)) > 5


def test_a_queue_begins_at_the_stop_line_and_goes_on_behind(junction_scene):
    traffic = _traffic(
        waiting_share=1.0,
        following_share=1.0,
        waiting_gap_m=2.0,
        crosswalk_gap_m=3.0,
        along_arm_m=30.0,
    )

    street = build_street(junction_scene, traffic)
    vehicles = street.draw(_rng())
    index = np.arange(4)
    # Pedestrians cross 2 m inside the mouth: the first bumper is 1 m behind it.
    middles = MOUTH_M + 1.0 + 2.45 + 6.9 * index
    found = sorted(
        v.pose.position_m[0] for v in vehicles if v.pose.position_m[0] > MOUTH_M
    )
    expected = middles.tolist()

    assert found == pytest.approx(expected)
    assert {
        round(v.pose.position_m[1], 9) for v in vehicles if v.pose.yaw_deg == 180.0
    } == {1.75}


@pytest.mark.long
def test_queues_are_as_long_as_the_shares_say(junction_scene):
    traffic = _traffic(waiting_share=0.4, following_share=0.5, along_arm_m=80.0)
    street = build_street(junction_scene, traffic)
    lengths = Counter()
    for index in range(150):
        arms = Counter()
        for vehicle in street.draw(_rng(index)):
            x, y, _ = vehicle.pose.position_m
            arms[int(np.argmax([x, y, -x, -y]))] += 1

        lengths.update(arms[arm] for arm in range(4))

    total = 4 * 150

    for n_vehicles, share in (
        (0, 0.6),
        (1, 0.4 * 0.5),
        (2, 0.4 * 0.25),
    ):
        variance = share * (1.0 - share) / total
        error = np.sqrt(variance)
        assert lengths[n_vehicles] / total == pytest.approx(share, abs=4.0 * error)


def test_the_stop_line_is_at_the_mouth_or_before_the_crosswalk(junction_scene):
    arm = build_junction(junction_scene).arms["east"]
    (lane,) = arm.entry_lanes

    def stop_m(direction):
        """Where one stops for a crosswalk 20 m east, 3 m before it."""
        crosswalk = Line(point_m=[20.0, 0.0], direction=direction)
        with_crosswalk = replace(arm, crosswalk=crosswalk)
        return stop_line_m(with_crosswalk, lane, 3.0)

    plain_m = stop_line_m(arm, lane, 3.0)
    behind_crosswalk_m = stop_m([0.0, 1.0])

    assert plain_m == pytest.approx(1.0)
    assert stop_line_m(arm, lane, 1.5) == 0.0
    assert behind_crosswalk_m == pytest.approx(8.5 + 3.0)
    assert stop_m([1.0, 0.0]) == 0.0  # along the lane


@pytest.mark.long
def test_kinds_come_as_often_as_their_shares_say(junction_scene):
    actors = load_actors()
    kinds = (
        VehicleKind(actor=actors["parked-van"], parked_share=0.25, waiting_share=0.0),
        VehicleKind(
            actor=actors["parked-car-small"],
            parked_share=0.75,
            waiting_share=1.0,
        ),
    )
    traffic = _traffic(vehicles=kinds, taken_share=1.0, waiting_share=1.0)
    street = build_street(junction_scene, traffic)
    parked = Counter()
    waiting = Counter()
    for index in range(12):
        for placed in street.draw(_rng(index)):
            place_m = placed.pose.position_m[:2]
            off_axes_m = np.abs(place_m)
            beside_m = off_axes_m.min()
            if beside_m < 3.5:
                waiting[placed.actor.name] += 1
            else:
                parked[placed.actor.name] += 1

    n = parked.total()
    error = np.sqrt(0.25 * 0.75 / n)

    assert parked["parked-van"] / n == pytest.approx(0.25, abs=4.0 * error)
    assert set(waiting) == {"parked-car-small"}


def test_nobody_stands_in_a_wall_or_in_another_one(default):
    wall = ("wall", 40.0, 1.75, 0.3, 6.0, 2.0)
    scene = protocol_scene(boxes=[wall])
    traffic = _traffic(
        waiting_share=1.0,
        following_share=1.0,
        waiting_gap_m=0.1,
        along_arm_m=60.0,
    )

    vehicles = build_street(scene, traffic).draw(_rng())
    east = [_corners(v)[:, 0] for v in vehicles if v.pose.position_m[0] > MOUTH_M]

    assert len(east) == 10  # eleven would fit

    for x_m in east:
        farthest_m = x_m.max()
        assert farthest_m < 39.85 or x_m.min() > 40.15

    full = replace(default.traffic, taken_share=1.0)
    street = build_street(load_study_scene(), full)
    corners = [_corners(v) for v in street.draw(_rng())]

    for one, other in combinations(corners, 2):
        assert footprint_separation(one, other) > 0.0


def test_a_bridge_above_the_roofs_is_in_nobodys_way():
    """A box on the ground stands in the way, one at 3 m above a van does not."""
    wall = ("wall", 14.0, 1.75, 0.3, 6.0, 2.0)
    scene = protocol_scene(boxes=[wall])
    vertices_m = scene.vertices_m.copy()
    vertices_m[3:, 2] += 3.0
    lifted = replace(scene, vertices_m=vertices_m)
    traffic = _traffic(waiting_share=1.0)

    counts = [len(build_street(s, traffic).draw(_rng())) for s in (scene, lifted)]

    assert counts == [3, 4]


def test_what_stands_in_one_lane_does_not_depend_on_the_others(default, junction_scene):
    lanes = [lane for lane in junction_scene.lanes if "north" not in lane.id]
    fewer = replace(junction_scene, lanes=tuple(lanes))

    def drawn(scene):
        street = build_street(scene, default.traffic)
        vehicles = street.draw(_rng())
        return {vehicle.key for vehicle in vehicles}

    assert drawn(fewer) < drawn(junction_scene)


# Whose way they stand in


@pytest.fixture(scope="module")
def many_ways(actors, rule):
    """Crossing, turning, longitudinal and obstructed cases at the study's junction."""
    cases = []
    for name in ("CPNCO-50", "CPTAfs-50", "CBTAns-0", "CPLA-25", "CBNA", "CPFA-50"):
        case = load_cases()[name]
        slowest_kmh = min(case.vut_speeds_kmh)
        speeds_kmh = {slowest_kmh, case.vut_speeds_kmh[-1]}
        vut_speeds_kmh = tuple(sorted(speeds_kmh))
        slow_and_fast = replace(case, vut_speeds_kmh=vut_speeds_kmh)
        cases.append(slow_and_fast)

    runs, _ = build_runs(
        load_study_scene(),
        cases,
        vut=actors["vut"],
        rule=rule,
    )
    return runs


def _swept(run, rule):
    """Footprints of VUT and VRU every two centimetres, until the VUT stands if it
    brakes at 0.
    """
    encounter = run.encounter
    speed = encounter.vut_motion.speed_mps
    stop_s = speed / rule.deceleration_mps2
    stop_m = 0.5 * speed**2 / rule.deceleration_mps2
    vut_way_m = float(encounter.vut_motion.distance_m(0.0))
    vut_m = vut_way_m + stop_m
    vru_way_m = encounter.vru_motion.distance_m(stop_s)
    vru_m = float(vru_way_m)

    for body, motion, end_m in (
        (encounter.vut, encounter.vut_motion, vut_m),
        (encounter.vru, encounter.vru_motion, vru_m),
    ):
        steps_m = np.arange(0.0, end_m, 0.02)
        position, yaw = motion.path.at(steps_m)
        yield footprint_corners(
            position,
            yaw,
            length_m=body.length_m,
            width_m=body.width_m,
        )


@pytest.mark.long
def test_no_sampled_vehicle_stands_in_a_swept_path(
    many_ways, build_setting, default, rule
):
    assert rule.build_up_s == 0.0

    setting = build_setting(load_study_scene(), many_ways)
    crowded = replace(
        default.traffic,
        taken_share=0.9,
        waiting_share=0.9,
        clear_of_mouth_m=0.0,
    )
    sample = first_world(
        setting,
        (),
        replace(default, traffic=crowded),
        seed=4,
    )
    n_standing = 0
    n_left_out = 0

    pairs = zip(sample.setting.runs, many_ways, strict=True)
    for run, planned in list(pairs)[::2]:
        n_planned = len(planned.obstruction)
        added = run.obstruction[n_planned:]
        n_standing += len(added)
        n_vehicles = len(sample.vehicles)
        n_left_out += n_vehicles - len(added)

        assert run.obstruction[:n_planned] == planned.obstruction

        for swept, placed in product(_swept(run, rule), added):
            middle_m = swept.mean(axis=1)
            away_m = middle_m - placed.pose.position_m[:2]
            distance_m = np.hypot(*away_m.T)
            near = distance_m < 12.0

            apart_m = footprint_separation(swept[near], _corners(placed))
            nearest_m = apart_m.min(initial=np.inf)

            assert nearest_m > crowded.clearance_m - 1e-9

        for placed, other in product(added, planned.obstruction):
            gap_m = footprint_separation(_corners(placed), _corners(other))
            assert gap_m > 0.0

    assert n_standing > 2 * n_left_out > 50


def test_only_what_is_in_the_way_is_left_out(junction_scene, junction_runs, rule):
    """Queues on all arms: gone is the one in whose lane the VUT comes."""
    traffic = _traffic(waiting_share=1.0)

    street = build_street(junction_scene, traffic)
    vehicles = street.draw(_rng())

    assert len(vehicles) == 4

    runs = list(junction_runs.values())
    ways = build_ways(runs, rule)

    clear = clear_of_ways(vehicles, ways, clearance_m=0.5)
    directions = {
        "east": (1, 0),
        "north": (0, 1),
        "west": (-1, 0),
        "south": (0, -1),
    }

    for approach, run in junction_runs.items():
        still_there = set(clear[group_key(run)])
        gone = set(vehicles) - still_there
        (one,) = gone
        place_m = one.pose.position_m[:2]
        along_m = place_m @ directions[approach]

        assert along_m > MOUTH_M


def test_all_speeds_of_a_case_see_the_same_street(runs, build_setting, default):
    setting = build_setting(load_study_scene(), runs)
    sample = first_world(setting, (), default)
    streets = {}
    for run in sample.setting.runs:
        street = tuple(placed.key for placed in run.obstruction)
        key = (run.case.name, run.approach)
        streets.setdefault(key, set()).add(street)

    sizes = {len(street) for street in streets.values()}

    assert sizes == {1}


def test_a_scene_without_a_junction_has_no_street(default):
    empty = build_scene(())
    with pytest.raises(InputError, match="lanes that begin or end at the outline"):
        build_street(empty, default.traffic)
