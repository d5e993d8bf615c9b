"""Arms that a map closes to road users: nothing of theirs is driven there."""

from dataclasses import replace

import pytest
import shapely
from case_speeds import at_first_speed
from junctions import MOUTH_M, build_scene
from scenario_lanes import arm_lanes

from geometry.junction import build_junction
from geometry.scene import strips_of
from scenarios.cases import load_cases
from scenarios.positions import build_positions

pytestmark = pytest.mark.long
# Across the arm to the south, 2 m inside its mouth.
CROSSWALK_M = [
    [-6.0, 1.0 - MOUTH_M],
    [6.0, 1.0 - MOUTH_M],
]


def scene_with(closed_to, *, crosswalks_m=()):
    """The protocol's junction whose arm to the south is closed to some."""
    lanes = []
    for lane in arm_lanes(arm_m=120.0):
        if lane.id.startswith("south"):
            lane = replace(lane, closed_to=closed_to)
        lanes.append(lane)
    return build_scene(lanes, crosswalks_m=crosswalks_m)


@pytest.fixture(scope="module")
def lay_all(lay):
    """A function that lays every case at its first speed, at two places."""
    cases = [at_first_speed(case) for case in load_cases().values()]
    positions = build_positions([0.0, 15.0])

    def build(scene):
        return lay(scene, cases, positions=positions)

    return build


def area_of_arm(scene):
    """Lanes of the arm to the south, beyond its mouth."""
    arm = build_junction(scene).arms["south"]
    return shapely.union_all(strips_of([*arm.lanes_in, *arm.lanes_out]))


def met_there(runs, scene):
    """Groups of road users that are met, or come, on the arm to the south."""
    area = area_of_arm(scene)
    met = set()
    for run in runs:
        if shapely.LineString(run.vru_position_m).intersects(area):
            met.add(run.road_user)

    return met


def test_on_an_open_arm_everybody_is_met(lay_all):
    scene = scene_with(())
    runs, _ = lay_all(scene)
    assert met_there(runs, scene) == {"on foot", "bicycle", "motorcycle", "car"}


@pytest.mark.parametrize(
    "closed_to",
    [
        ("on foot",),
        ("bicycle",),
        ("motorcycle",),
        ("on foot", "bicycle", "motorcycle"),
    ],
)
def test_nobody_is_met_on_an_arm_that_is_closed_to_them(closed_to, lay_all):
    scene = scene_with(closed_to)
    runs, refused = lay_all(scene)
    everybody = {"on foot", "bicycle", "motorcycle", "car"}

    assert met_there(runs, scene) == everybody - set(closed_to)

    closed = [one for one in refused if "arm as closed to" in str(one.reason)]
    assert {one.case.road_user for one in closed} == set(closed_to)
    # Counted as not possible, not as lacking room.
    assert not any(one.is_possible for one in closed)


def test_nobody_parks_where_nobody_may_walk(lay_all):
    scene = scene_with(("on foot",))
    runs, refused = lay_all(scene)
    road = area_of_arm(scene).buffer(4.0)
    bodies = [body for run in runs for body in run.obstruction]
    cars = [body for body in bodies if body.actor.class_name == "parked vehicle"]

    assert cars
    for body in cars:
        place = shapely.Polygon(body.footprint_m)
        assert place.centroid.y > -MOUTH_M or not road.intersects(place)

    whys = {str(one.reason) for one in refused if not one.is_possible}
    assert "no cars park on the south arm because nobody may walk there" in whys


def test_people_cross_a_closed_arm_on_the_maps_own_crosswalk_alone(lay_all):
    scene = scene_with(("on foot",), crosswalks_m=[CROSSWALK_M])
    runs, _ = lay_all(scene)
    for position, is_met in (("0", True), ("-15", False)):
        users = {
            run.road_user
            for run in runs
            if run.approach == "south" and run.position == position
        }
        assert ("on foot" in users) == is_met
