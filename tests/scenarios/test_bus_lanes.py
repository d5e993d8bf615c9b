"""Bus lanes at the kerb: whose way they are, and what stands beside them."""

from dataclasses import replace

import pytest
import shapely
from case_speeds import at_first_speed
from junctions import LANE_M, build_scene
from scenario_lanes import arm_lanes

from geometry.scene import strips_of
from scenarios.cases import load_cases
from scenarios.positions import build_positions


@pytest.fixture(scope="module")
def scene():
    """Two lanes per direction on every arm, the one at the kerb for buses."""
    lanes = []
    for lane in arm_lanes(n_lanes=2, arm_m=120.0):
        if lane.id.endswith("-0"):
            lane = replace(lane, kind="bus")
        lanes.append(lane)
    return build_scene(lanes)


@pytest.fixture(scope="module")
def runs(scene, lay):
    """A case of each family from the west, at two places."""
    families = {case.family: at_first_speed(case) for case in load_cases().values()}
    positions = build_positions([0.0, 15.0])
    cases = families.values()
    laid, _ = lay(scene, cases, approaches=["west"], positions=positions)
    assert {run.case.kind for run in laid} == {"crossing", "longitudinal", "turning"}
    return laid


def test_no_run_comes_by_the_bus_lane(scene, runs):
    buses = bus_lanes(scene)
    for run in runs:
        start = shapely.Point(run.vut_position_m[0])
        assert not buses.contains(start), run.id


def bus_lanes(scene):
    """Surface of all bus lanes."""
    lanes = [lane for lane in scene.lanes if lane.kind == "bus"]
    return shapely.union_all(strips_of(lanes))


def test_nobody_parks_on_the_bus_lane(scene, runs):
    lanes = shapely.union_all(strips_of(scene.lanes, less_m=0.11))
    parked = [body for run in runs for body in run.obstruction]

    assert {"parked-car-large"} <= {body.actor.name for body in parked}

    for body in parked:
        assert not lanes.intersects(shapely.Polygon(body.footprint_m))


@pytest.fixture
def lay_slowest(scene, lay):
    """A function that lays a case at its lowest speed, from the west."""

    def build(name):
        case = at_first_speed(load_cases()[name])
        (run,), _ = lay(scene, [case], approaches=["west"])
        return run

    return build


def test_a_child_sets_off_at_the_kerb_behind_the_bus_lane(lay_slowest):
    """4 m from the middle of the VUT's lane, as in the protocol, and a bus lane."""
    run = lay_slowest("CPNCO-50")
    start, _ = run.encounter.vru_motion.path.at(0.0)
    # The VUT drives in the second lane from the kerb.
    from_vut_m = abs(float(start[1]) + 0.5 * LANE_M)
    reference_m = abs(run.case.vru_reference_m)
    expected_m = run.case.start_distance_m + LANE_M

    assert from_vut_m == pytest.approx(expected_m, abs=reference_m + 0.01)


def test_cyclists_ride_on_the_bus_lane(scene, lay_slowest):
    """They come by the kerb of the road that crosses."""
    start = shapely.Point(lay_slowest("CBNA-50").vru_position_m[0])
    assert bus_lanes(scene).contains(start)
