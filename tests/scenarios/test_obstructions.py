"""Where parked cars find room."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import LANE_M, protocol_scene
from scenario_lanes import build_lane

SCENE = protocol_scene()


def with_lane(scene, line_m, **about):
    """The scene with another lane beside the arm from which the car comes."""
    beside = build_lane("beside", line_m, **about)
    return replace(scene, lanes=(*scene.lanes, beside))


@pytest.fixture
def parked(lay):
    """Cars beside the car's way from the west, and why there are none."""

    def find(scene):
        runs, refusals = lay(
            scene,
            ["CPNCO-50"],
            speeds_kmh=(30.0,),
            approaches=["west"],
        )
        bodies = []
        for run in runs:
            bodies += [body for body in run.obstruction if "car" in body.actor.name]

        return bodies, [refusal.reason for refusal in refusals]

    return find


def places(bodies):
    """Where bodies stand."""
    return [body.pose.position_m.tolist() for body in bodies]


def flank_m(bodies):
    """The far flank of a row of parked cars."""
    return min(body.pose.position_m[1] - 0.5 * body.actor.width_m for body in bodies)


def test_nobody_parks_on_an_island_between_two_carriageways(parked):
    bodies, refusals = parked(SCENE)
    assert not refusals

    # The kerb is to the south of the car from the west.
    beyond_m = flank_m(bodies) - 0.5 * LANE_M
    near_m = beyond_m - 1.0
    near = with_lane(SCENE, [[-15.0, near_m], [-80.0, near_m]])
    none, (reason,) = parked(near)

    assert not none
    assert reason.endswith("parked-car-large would stand on a traffic island")

    far_m = beyond_m - 6.0
    far = with_lane(SCENE, [[-15.0, far_m], [-80.0, far_m]])
    there, _ = parked(far)

    assert places(there) == places(bodies)


@pytest.mark.parametrize(
    ("skew_deg", "is_island"),
    [
        (0.0, True),
        (50.0, True),
        (80.0, False),
    ],
)
def test_behind_a_corner_lies_the_road_that_crosses_and_no_island(
    parked, skew_deg, is_island
):
    bodies, _ = parked(SCENE)
    fronts = [body.pose.position_m[0] + 0.5 * body.actor.length_m for body in bodies]
    corner = np.array([max(fronts) - 3.0, flank_m(bodies) - 1.0])
    # A lane whose nearer edge begins behind the cars and leads away, to the south and
    # west.
    away = np.radians(180.0 + skew_deg)
    ahead = np.array([np.cos(away), np.sin(away)])
    left = np.array([-ahead[1], ahead[0]])
    begin = corner + 0.5 * LANE_M * left
    there, refusals = parked(with_lane(SCENE, [begin, begin + 40.0 * ahead]))

    assert all(reason.endswith("on a traffic island") for reason in refusals)

    # Farther back, where that lane has led away, there may be room again.
    is_same = places(there) == places(bodies)
    assert is_same == (not is_island)


def test_where_the_map_has_a_parking_lane_people_park_whatever_is_behind(parked):
    bodies, _ = parked(SCENE)
    near_m = flank_m(bodies) - 1.0 - 0.5 * LANE_M
    bay_m = near_m + 1.0 + LANE_M
    near = with_lane(SCENE, [[-15.0, near_m], [-80.0, near_m]])
    bay = with_lane(near, [[-15.0, bay_m], [-80.0, bay_m]], kind="parking")
    bodies, refusals = parked(bay)

    assert bodies
    assert not refusals


@pytest.mark.parametrize(
    ("bottom_m", "is_free"),
    [
        (4.5, True),
        (0.0, False),
    ],
)
def test_cars_park_and_people_walk_below_what_is_raised(parked, bottom_m, is_free):
    roof = ("roof", -30.0, 0.0, 40.0, 40.0, 3.0)
    scene = protocol_scene(boxes=[roof])
    is_roof = scene.vertices_m[:, 0] > -100.0
    is_roof &= np.linalg.norm(scene.vertices_m[:, :2], axis=-1) < 100.0
    up = np.outer(is_roof, [0.0, 0.0, bottom_m])
    bodies, refusals = parked(replace(scene, vertices_m=scene.vertices_m + up))

    assert bool(bodies) == is_free == (not refusals)

    if is_free:
        free, _ = parked(SCENE)
        assert places(bodies) == places(free)
