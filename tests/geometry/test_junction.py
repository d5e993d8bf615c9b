from dataclasses import replace

import numpy as np
import pytest
from junctions import (
    ARMS,
    LANE_M,
    MOUTH_M,
    SQUARE_M,
    build_scene,
    lanes_of,
    protocol_scene,
    turned,
)

from geometry.errors import InputError
from geometry.junction import Line, build_junction, lane_length_m, lane_line
from geometry.scene import Lane
from geometry.study_scene import load_study_scene


def test_the_protocols_junction_has_four_arms_with_a_lane_each_way():
    junction = build_junction(protocol_scene())
    assert sorted(junction.arms) == sorted(ARMS)
    for name, arm in junction.arms.items():
        assert [lane.id for lane in arm.entry_lanes] == [f"{name}-in-0"]
        assert [lane.id for lane in arm.exit_lanes] == [f"{name}-out-0"]


def test_pedestrians_of_the_protocols_junction_cross_9_5_m_from_its_axes():
    for name, arm in build_junction(protocol_scene()).arms.items():
        outward = turned([1.0, 0.0], ARMS[name])
        assert arm.crosswalk.point_m @ outward == pytest.approx(9.5)
        assert arm.crosswalk.direction @ outward == pytest.approx(0.0, abs=1e-12)


def test_a_crosswalk_of_the_scene_is_taken_by_the_arm_that_it_crosses():
    scene = protocol_scene(crosswalks_m=[[[-4.0, 13.0], [4.0, 13.0]]])
    arms = build_junction(scene).arms
    assert arms["north"].crosswalk.point_m[1] == 13.0
    assert arms["east"].crosswalk.point_m[0] == pytest.approx(9.5)


@pytest.mark.parametrize("angle_deg", [-30.0, 15.0, 40.0, 90.0, 200.0])
def test_lanes_are_ordered_from_the_kerb_to_the_axis_however_the_junction_lies(
    angle_deg,
):
    lanes = [
        lane
        for arm, bearing in ARMS.items()
        for lane in lanes_of(arm, bearing + angle_deg, n_lanes=3)
    ]
    scene = build_scene(lanes[::-1], outline_m=turned(SQUARE_M, angle_deg))
    for arm in build_junction(scene).arms.values():
        for ordered in (arm.lanes_in, arm.lanes_out):
            assert [lane.id[-1] for lane in ordered] == ["0", "1", "2"]


def test_the_studys_junction_has_two_lanes_each_way_and_parks_north_and_south():
    arms = build_junction(load_study_scene()).arms
    assert sorted(arms) == ["east", "north", "south", "west"]
    for name, arm in arms.items():
        assert len(arm.entry_lanes) == len(arm.exit_lanes) == 2
        assert arm.lanes_in[0].kind == (
            "parking" if name in ("north", "south") else "driving"
        )
    # Pieces of one lane are put together: 13 m in the junction's own road, 51 m behind
    # it.
    assert lane_length_m(arms["north"].entry_lanes[0]) == pytest.approx(64.2, abs=0.1)
    # The lines on which the study's generator lets pedestrians walk.
    assert arms["east"].crosswalk.point_m[0] == -114.93057617
    assert arms["south"].crosswalk.point_m[1] == -10.64744873


def test_arms_that_share_a_point_of_the_compass_are_told_apart_by_eight():
    bearings = {"east": 0.0, "north-east": 44.0, "west": 180.0}
    lanes = [
        lane for arm, bearing in bearings.items() for lane in lanes_of(arm, bearing)
    ]
    octagon = MOUTH_M * np.array(
        [turned([1.0, 0.0], angle) for angle in range(0, 360, 4)]
    )
    junction = build_junction(build_scene(lanes, outline_m=octagon))
    assert list(junction.arms) == ["east", "north-east", "west"]


def test_a_one_way_arm_has_lanes_of_one_kind_only():
    lanes = [
        *lanes_of("east", 0.0, has_out=False),
        *lanes_of("west", 180.0, has_in=False),
    ]
    arms = build_junction(build_scene(lanes)).arms
    assert not arms["east"].exit_lanes
    assert not arms["west"].entry_lanes


def test_lanes_that_do_not_reach_the_outline_are_told():
    lane = Lane(
        id="far", kind="driving", width_m=3.5, centreline_m=[[100.0, 0.0], [50.0, 0.0]]
    )
    with pytest.raises(
        InputError, match=r"protocol: lanes: got 1; expected lanes that begin"
    ):
        build_junction(build_scene([lane]))


def test_a_bent_lane_tells_how_far_it_leaves_its_line():
    centreline = [[60.0, 6.0], [40.0, 0.0], [10.0, 0.0]]
    lane = Lane(id="bent", kind="driving", width_m=LANE_M, centreline_m=centreline)
    near, off_near_m = lane_line(lane, is_in=True, length_m=30.0)
    assert near.yaw_deg == pytest.approx(180.0)
    assert off_near_m == pytest.approx(0.0, abs=1e-12)
    _, off_m = lane_line(lane, is_in=True, length_m=100.0)
    chord = np.array(
        [50.0, 6.0]
    )  # from mouth to begin; the bend lies 30 m out on the axis
    assert off_m == pytest.approx(30.0 * chord[1] / np.hypot(*chord))


def test_lines_cross_where_both_are():
    a = Line(point_m=[0.0, 1.0], direction=[2.0, 0.0])
    b = Line(point_m=[3.0, -5.0], direction=[1.0, 1.0])
    assert a.crossing_with(b) == pytest.approx([9.0, 1.0])
    assert a.coordinates([4.0, 3.0]) == pytest.approx([4.0, 2.0])
    assert a.turned(90.0).direction == pytest.approx([0.0, 1.0])
    assert a.at(2.0, 1.0) == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize(
    "angles_deg", [(0, 72, 144, 216, 288), (5, 40, 80, 180, 260, 300)]
)
def test_any_number_of_arms_at_any_angle_have_names_of_their_own(angles_deg):
    outline = 25.0 * np.array(
        [
            [np.cos(angle), np.sin(angle)]
            for angle in np.linspace(0, 2 * np.pi, 72, endpoint=False)
        ]
    )
    lanes = []
    for angle in angles_deg:
        for is_in, side_m in ((True, 1.75), (False, -1.75)):
            reach_m = np.sqrt(25.0**2 - side_m**2)
            way = [[reach_m + 80.0, side_m], [reach_m, side_m]][:: 1 if is_in else -1]
            lanes.append(
                Lane(
                    id=f"{angle}-{is_in}",
                    kind="driving",
                    width_m=3.5,
                    centreline_m=turned(way, float(angle)),
                )
            )
    junction = build_junction(build_scene(lanes, outline_m=outline))
    assert len(junction.arms) == len(angles_deg)
    for arm, angle in zip(junction.arms.values(), sorted(angles_deg), strict=True):
        assert [lane.id for lane in arm.lanes_in] == [f"{angle}-True"]
        assert [lane.id for lane in arm.lanes_out] == [f"{angle}-False"]


def test_a_median_does_not_split_an_arm_but_a_block_does():
    for median_m, n_arms in ((8.0, 1), (30.0, 2)):
        lanes = [
            Lane(
                id=name,
                kind="driving",
                width_m=3.5,
                centreline_m=np.array([[61.5, y], [11.5, y]])[::step],
            )
            for name, y, step in (
                ("in", 0.5 * median_m + 1.75, 1),
                ("out", -0.5 * median_m - 1.75, -1),
            )
        ]
        outline = np.array([[11.5, -40.0], [11.5, 40.0], [-11.5, 40.0], [-11.5, -40.0]])
        assert len(build_junction(build_scene(lanes, outline_m=outline)).arms) == n_arms


def test_where_traffic_keeps_left_the_kerb_is_on_the_left():
    scene = protocol_scene()
    lanes = tuple(
        replace(lane, centreline_m=lane.centreline_m[::-1])
        for arm, bearing in ARMS.items()
        for lane in lanes_of(arm, bearing, n_lanes=2)
    )
    junction = build_junction(replace(scene, lanes=lanes, keeps_left=True))
    for name, arm in junction.arms.items():
        assert [lane.id for lane in arm.entry_lanes] == [
            f"{name}-out-0",
            f"{name}-out-1",
        ]
        assert [lane.id for lane in arm.exit_lanes] == [f"{name}-in-0", f"{name}-in-1"]
