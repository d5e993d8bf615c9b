"""Where parked cars find room."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import LANE_M, protocol_scene

from geometry.scene import Lane, Scene
from scenarios.cases import load_cases
from scenarios.runs import build_runs


def with_lane(scene: Scene, y_m: float, *, kind: str = "driving") -> Scene:
    """The scene with another lane beside the arm from which the car comes."""
    lane = Lane(
        id="beside",
        kind=kind,
        width_m=LANE_M,
        centreline_m=np.array([[-15.0, y_m], [-80.0, y_m]]),
    )
    return replace(scene, lanes=(*scene.lanes, lane))


@pytest.fixture
def parked(actors, rule):
    """Cars beside the car's way from the west, and why there are none."""

    def find(scene: Scene):
        case = replace(load_cases()["CPNCO-50"], vut_speeds_kmh=(30.0,))
        runs, refusals = build_runs(
            scene, [case], vut=actors["vut"], rule=rule, approaches=["west"]
        )
        bodies = [
            body for run in runs for body in run.obstruction if "car" in body.actor.name
        ]
        return bodies, [refusal.reason for refusal in refusals]

    return find


def flank_m(bodies):
    """The far flank of a row of parked cars."""
    return min(body.pose.position_m[1] - 0.5 * body.actor.width_m for body in bodies)


def test_nobody_parks_on_an_island_between_two_carriageways(parked):
    scene = protocol_scene()
    bodies, refusals = parked(scene)
    assert not refusals
    beyond_m = flank_m(bodies)  # the kerb is to the south of the car from the west
    near = with_lane(scene, beyond_m - 1.0 - 0.5 * LANE_M)
    none, (reason,) = parked(near)
    assert not none
    assert reason.endswith("parked-car-large would stand on a traffic island")
    far = with_lane(scene, beyond_m - 6.0 - 0.5 * LANE_M)
    assert [body.pose.position_m.tolist() for body in parked(far)[0]] == [
        body.pose.position_m.tolist() for body in bodies
    ]


@pytest.mark.parametrize(
    ("skew_deg", "is_island"), [(0.0, True), (50.0, True), (80.0, False)]
)
def test_behind_a_corner_lies_the_road_that_crosses_and_no_island(
    parked, skew_deg, is_island
):
    scene = protocol_scene()
    bodies, _ = parked(scene)
    foremost = max(
        body.pose.position_m[0] + 0.5 * body.actor.length_m for body in bodies
    )
    corner = np.array([foremost - 3.0, flank_m(bodies) - 1.0])
    # A lane whose nearer edge begins behind the cars and leads away, to the south and
    # west.
    away = np.radians(180.0 + skew_deg)
    ahead = np.array([np.cos(away), np.sin(away)])
    begin = corner + 0.5 * LANE_M * np.array([-ahead[1], ahead[0]])
    beside = Lane(
        id="beside",
        kind="driving",
        width_m=LANE_M,
        centreline_m=np.array([begin, begin + 40.0 * ahead]),
    )
    there, refusals = parked(replace(scene, lanes=(*scene.lanes, beside)))
    assert all(reason.endswith("on a traffic island") for reason in refusals)
    # Farther back, where that lane has led away, there may be room again.
    is_same = [body.pose.position_m.tolist() for body in there] == [
        body.pose.position_m.tolist() for body in bodies
    ]
    assert is_same == (not is_island)


def test_where_the_map_has_a_parking_lane_people_park_whatever_is_behind(parked):
    scene = protocol_scene()
    beyond_m = flank_m(parked(scene)[0])
    near = with_lane(scene, beyond_m - 1.0 - 0.5 * LANE_M)
    bay = replace(near.lanes[-1], id="bay", kind="parking")
    bay = replace(bay, centreline_m=bay.centreline_m + [0.0, 1.0 + LANE_M])
    bodies, refusals = parked(replace(near, lanes=(*near.lanes, bay)))
    assert bodies
    assert not refusals


@pytest.mark.parametrize(("bottom_m", "is_free"), [(4.5, True), (0.0, False)])
def test_cars_park_and_people_walk_below_what_is_raised(parked, bottom_m, is_free):
    free = protocol_scene()
    scene = protocol_scene(boxes=[("roof", -30.0, 0.0, 40.0, 40.0, 3.0)])
    is_roof = scene.vertices_m[:, 0] > -100.0
    is_roof &= np.hypot(*scene.vertices_m[:, :2].T) < 100.0
    raised = replace(
        scene, vertices_m=scene.vertices_m + np.outer(is_roof, [0.0, 0.0, bottom_m])
    )
    bodies, refusals = parked(raised)
    assert bool(bodies) == is_free == (not refusals)
    if is_free:
        places = [body.pose.position_m.tolist() for body in bodies]
        assert places == [body.pose.position_m.tolist() for body in parked(free)[0]]
