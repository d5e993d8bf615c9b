"""Bus lanes at the kerb: whose way they are, and what stands beside them."""

from dataclasses import replace

import pytest
import shapely
from case_speeds import at_first_speed
from junctions import ARMS, LANE_M, build_scene, lanes_of

from geometry.scene import strips_of
from scenarios.cases import load_cases
from scenarios.positions import build_positions
from scenarios.runs import build_runs


@pytest.fixture(scope="module")
def scene():
    """Two lanes per direction on every arm, the one at the kerb for buses."""
    lanes = []
    for arm, bearing in ARMS.items():
        for lane in lanes_of(arm, bearing, n_lanes=2, arm_m=120.0):
            if lane.id.endswith("-0"):
                lane = replace(lane, kind="bus")
            lanes.append(lane)
    return build_scene(lanes)


@pytest.fixture(scope="module")
def runs(scene, actors, rule):
    laid, _ = build_runs(
        scene,
        {case.family: at_first_speed(case) for case in load_cases().values()}.values(),
        vut=actors["vut"],
        rule=rule,
        approaches=["west"],
        positions=build_positions([0.0, 15.0]),
    )
    assert {run.case.kind for run in laid} == {"crossing", "longitudinal", "turning"}
    return laid


def test_no_run_comes_by_the_bus_lane(scene, runs):
    buses = shapely.union_all(
        strips_of(lane for lane in scene.lanes if lane.kind == "bus")
    )
    for run in runs:
        start = shapely.Point(run.vut_position_m[0])
        assert not buses.contains(start), run.id


def test_nobody_parks_on_the_bus_lane(scene, runs):
    lanes = shapely.union_all(strips_of(scene.lanes, less_m=0.11))
    parked = [body for run in runs for body in run.obstruction]
    assert {"parked-car-large"} <= {body.actor.name for body in parked}
    for body in parked:
        assert not lanes.intersects(shapely.Polygon(body.footprint_m))


def test_a_child_sets_off_at_the_kerb_behind_the_bus_lane(scene, actors, rule):
    """4 m from the middle of the VUT's lane, as in the protocol, and a bus lane."""
    (case,) = (one for one in load_cases().values() if one.name == "CPNCO-50")
    case = replace(case, vut_speeds_kmh=case.vut_speeds_kmh[:1])
    (run,), _ = build_runs(
        scene, [case], vut=actors["vut"], rule=rule, approaches=["west"]
    )
    path = run.encounter.vru_motion.path
    start, _ = path.at(0.0)
    # The VUT drives in the second lane from the kerb.
    from_vut_m = abs(float(start[1]) + 0.5 * LANE_M)
    reference_m = abs(case.vru_reference_m)
    expected_m = case.start_distance_m + LANE_M
    assert from_vut_m == pytest.approx(expected_m, abs=reference_m + 0.01)


def test_cyclists_ride_on_the_bus_lane(scene, actors, rule):
    """They come by the kerb of the road that crosses."""
    (case,) = (one for one in load_cases().values() if one.name == "CBNA-50")
    case = replace(case, vut_speeds_kmh=case.vut_speeds_kmh[:1])
    (run,), _ = build_runs(
        scene, [case], vut=actors["vut"], rule=rule, approaches=["west"]
    )
    buses = strips_of(lane for lane in scene.lanes if lane.kind == "bus")
    start = shapely.Point(run.vru_position_m[0])
    assert any(strip.contains(start) for strip in buses)
