"""Arms of junctions, and the lines of lanes."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import (
    ARMS,
    MOUTH_M,
    SQUARE_M,
    build_scene,
    lanes_of,
    protocol_scene,
    turned,
)
from scenario_lanes import arm_lanes, build_lane

from geometry.errors import InputError
from geometry.junction import Line, build_junction, lane_length_m, lane_line
from geometry.study_scene import load_study_scene


def ids(lanes):
    """Ids of lanes."""
    return [lane.id for lane in lanes]


def arms_of(lanes, **scene_fields):
    """Arms of a junction of lanes."""
    return build_junction(build_scene(lanes, **scene_fields)).arms


def test_the_protocols_junction_has_four_arms_with_a_lane_each_way():
    junction = build_junction(protocol_scene())
    assert sorted(junction.arms) == sorted(ARMS)
    for name, arm in junction.arms.items():
        assert ids(arm.entry_lanes) == [f"{name}-in-0"]
        assert ids(arm.exit_lanes) == [f"{name}-out-0"]


def test_pedestrians_of_the_protocols_junction_cross_9_5_m_from_its_axes():
    arms = build_junction(protocol_scene()).arms

    for name, arm in arms.items():
        outward = turned([1.0, 0.0], ARMS[name])
        away_m = arm.crosswalk.point_m @ outward
        along = arm.crosswalk.direction @ outward
        assert away_m == pytest.approx(9.5)
        assert along == pytest.approx(0.0, abs=1e-12)


def test_a_crosswalk_of_the_scene_is_taken_by_the_arm_that_it_crosses():
    """Other arms keep the one that is assumed."""
    ends = [
        [-4.0, 13.0],
        [4.0, 13.0],
    ]
    scene = protocol_scene(crosswalks_m=[ends])
    arms = build_junction(scene).arms

    assert arms["north"].crosswalk.point_m[1] == 13.0
    assert arms["east"].crosswalk.point_m[0] == pytest.approx(9.5)


@pytest.mark.parametrize("angle_deg", [-30.0, 15.0, 40.0, 90.0, 200.0])
def test_lanes_are_ordered_from_the_kerb_to_the_axis_however_the_junction_lies(
    angle_deg,
):
    """Also when the map lists them in another order."""
    lanes = []
    for arm, bearing in ARMS.items():
        lanes += lanes_of(arm, bearing + angle_deg, n_lanes=3)

    arms = arms_of(lanes[::-1], outline_m=turned(SQUARE_M, angle_deg))

    for arm in arms.values():
        for ordered in (arm.lanes_in, arm.lanes_out):
            assert [lane.id[-1] for lane in ordered] == ["0", "1", "2"]


def test_the_studys_junction_has_two_lanes_each_way_and_parks_north_and_south():
    arms = build_junction(load_study_scene()).arms
    assert sorted(arms) == ["east", "north", "south", "west"]

    for name, arm in arms.items():
        assert len(arm.entry_lanes) == len(arm.exit_lanes) == 2
        is_parking = arm.lanes_in[0].kind == "parking"
        assert is_parking == (name in ("north", "south"))

    # Pieces of one lane are put together: 13 m in the junction's own road, 51 m behind
    # it.
    first = arms["north"].entry_lanes[0]
    assert lane_length_m(first) == pytest.approx(64.2, abs=0.1)

    # The lines on which the study's generator lets pedestrians walk.
    assert arms["east"].crosswalk.point_m[0] == -114.93057617
    assert arms["south"].crosswalk.point_m[1] == -10.64744873


def test_arms_that_share_a_point_of_the_compass_are_told_apart_by_eight():
    """Four names where they do, eight where they would be ambiguous."""
    bearings = {"east": 0.0, "north-east": 44.0, "west": 180.0}
    lanes = []
    for arm, bearing in bearings.items():
        lanes += lanes_of(arm, bearing)

    rim = [turned([MOUTH_M, 0.0], angle) for angle in range(0, 360, 4)]
    arms = arms_of(lanes, outline_m=np.array(rim))

    assert list(arms) == ["east", "north-east", "west"]


def test_a_one_way_arm_has_lanes_of_one_kind_only():
    lanes = lanes_of("east", 0.0, has_out=False)
    lanes += lanes_of("west", 180.0, has_in=False)
    arms = arms_of(lanes)

    assert not arms["east"].exit_lanes
    assert not arms["west"].entry_lanes


def test_lanes_that_do_not_reach_the_outline_are_told():
    line = np.array(
        [
            [100.0, 0.0],
            [50.0, 0.0],
        ]
    )
    far = build_lane("far", line)
    told = "protocol: lanes: got 1; expected lanes that begin"
    with pytest.raises(InputError, match=told):
        arms_of([far])


def test_a_bent_lane_tells_how_far_it_leaves_its_line():
    """The line is fitted to the part asked for, counted from the mouth."""
    line = np.array(
        [
            [60.0, 6.0],
            [40.0, 0.0],
            [10.0, 0.0],
        ]
    )
    lane = build_lane("bent", line)
    near, off_near_m = lane_line(lane, is_in=True, length_m=30.0)

    assert near.yaw_deg == pytest.approx(180.0)
    assert off_near_m == pytest.approx(0.0, abs=1e-12)

    _, off_m = lane_line(lane, is_in=True, length_m=100.0)
    # The chord leads from mouth to begin; the bend lies 30 m out on the axis.
    assert off_m == pytest.approx(30.0 * 6.0 / np.hypot(50.0, 6.0))


def test_lines_cross_where_both_are():
    """Coordinates count along a line, and to its left."""
    a = Line(point_m=[0.0, 1.0], direction=[2.0, 0.0])
    b = Line(point_m=[3.0, -5.0], direction=[1.0, 1.0])

    crossing = a.crossing_with(b)
    beside = a.coordinates([4.0, 3.0])
    across = a.turned(90.0)
    place = a.at(2.0, 1.0)

    assert crossing == pytest.approx([9.0, 1.0])
    assert beside == pytest.approx([4.0, 2.0])
    assert across.direction == pytest.approx([0.0, 1.0])
    assert place == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize(
    "angles_deg",
    [
        (0, 72, 144, 216, 288),
        (5, 40, 80, 180, 260, 300),
    ],
)
def test_any_number_of_arms_at_any_angle_have_names_of_their_own(angles_deg):
    rim = [turned([25.0, 0.0], float(angle)) for angle in range(0, 360, 5)]
    lanes = []
    for angle in angles_deg:
        for name, side_m in (("in", 1.75), ("out", -1.75)):
            reach_m = np.sqrt(25.0**2 - side_m**2)
            way = [
                [reach_m + 80.0, side_m],
                [reach_m, side_m],
            ]
            if name == "out":
                way = way[::-1]
            line = turned(way, float(angle))
            lanes.append(build_lane(f"{angle}-{name}", line))

    arms = arms_of(lanes, outline_m=np.array(rim))

    for arm, angle in zip(arms.values(), sorted(angles_deg), strict=True):
        assert ids(arm.lanes_in) == [f"{angle}-in"]
        assert ids(arm.lanes_out) == [f"{angle}-out"]


@pytest.mark.parametrize(
    ("median_m", "n_arms"),
    [
        (8.0, 1),
        (30.0, 2),
    ],
)
def test_a_median_does_not_split_an_arm_but_a_block_does(median_m, n_arms):
    """Lanes in and out lie so far apart."""
    y = 0.5 * median_m + 1.75
    lanes = [
        build_lane("in", [[61.5, y], [11.5, y]]),
        build_lane("out", [[11.5, -y], [61.5, -y]]),
    ]
    outline = np.array(
        [
            [11.5, -40.0],
            [11.5, 40.0],
            [-11.5, 40.0],
            [-11.5, -40.0],
        ]
    )

    arms = arms_of(lanes, outline_m=outline)

    assert len(arms) == n_arms


def test_where_traffic_keeps_left_the_kerb_is_on_the_left():
    """All lanes are driven the other way."""
    scene = protocol_scene()
    lanes = []
    for lane in arm_lanes(n_lanes=2):
        lanes.append(replace(lane, centreline_m=lane.centreline_m[::-1]))

    left = replace(scene, lanes=tuple(lanes), keeps_left=True)

    for name, arm in build_junction(left).arms.items():
        assert ids(arm.entry_lanes) == [f"{name}-out-0", f"{name}-out-1"]
        assert ids(arm.exit_lanes) == [f"{name}-in-0", f"{name}-in-1"]
