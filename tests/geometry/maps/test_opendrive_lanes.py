"""Lanes: kinds, directions, joints."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, geometry, lane, read_text, road, section


@pytest.fixture
def lanes_of(tmp_path):
    """A function that reads a road: its lanes by id."""

    def read(**about):
        source = read_text(tmp_path, document(road(**about)))
        return {one.id: one for one in source.lanes}

    return read


def ends(lane_read):
    """Begin and end of a lane, (2, 3)."""
    return lane_read.centreline_m[[0, -1]]


def test_right_lanes_follow_the_road_and_left_ones_come_back(lanes_of):
    lanes = lanes_of()
    assert_allclose(
        ends(lanes["1/-1"]), np.array([[0.0, -1.75, 0.0], [100.0, -1.75, 0.0]])
    )
    assert_allclose(
        ends(lanes["1/1"]), np.array([[100.0, 1.75, 0.0], [0.0, 1.75, 0.0]])
    )
    assert lanes["1/1"].width_m == pytest.approx(3.5)


def test_left_hand_traffic_is_right_hand_traffic_turned_round(lanes_of, tmp_path):
    plan = geometry('<spiral curvStart="0" curvEnd="0.03"/>')
    right = lanes_of(plan=plan, rule="RHT")
    left = read_text(tmp_path, document(road(plan=plan, rule="LHT")))

    assert left.keeps_left

    for one in left.lanes:
        assert_allclose(one.centreline_m, right[one.id].centreline_m[::-1])


def test_a_reversed_lane_is_driven_the_other_way(lanes_of):
    reversed_lane = lane(-1, extra='direction="reversed"')
    lanes = lanes_of(sections=section(right=[reversed_lane]))
    begin, _ = ends(lanes["1/-1"])

    assert_allclose(begin, [100, -1.75, 0])


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        ("driving", "driving"),
        ("entry", "driving"),
        ("exit", "driving"),
        ("onRamp", "driving"),
        ("offRamp", "driving"),
        ("connectingRamp", "driving"),
        ("bidirectional", "driving"),
        ("HOV", "driving"),
        ("bus", "bus"),
        ("taxi", "bus"),
        ("parking", "parking"),
        ("biking", "cycling"),
        ("sidewalk", "walking"),
        ("walking", "walking"),
    ],
)
def test_types_of_lanes(lanes_of, written, kind):
    sections = section(right=[lane(-1, written)])
    (found,) = lanes_of(sections=sections).values()
    assert found.kind == kind


@pytest.mark.parametrize(
    "written",
    ["none", "border", "shoulder", "stop", "median", "rail", "curb", "something-new"],
)
def test_types_that_are_no_lanes(lanes_of, written):
    assert not lanes_of(sections=section(right=[lane(-1, written)]))


def test_linked_pieces_are_one_lane_also_under_new_numbers(lanes_of):
    before = section(right=[lane(-1, after=-2), lane(-2, "sidewalk", after=-3)])
    after = section(
        right=[lane(-1), lane(-2, before=-1), lane(-3, "sidewalk", before=-2)], s=40.0
    )
    offset = cubic("laneOffset", 0.0) + cubic("laneOffset", 40.0, 3.5)
    lanes = lanes_of(sections=before + after, offset=offset)

    assert set(lanes) == {"1/-1", "1/-2", "1/-1/1"}

    through = lanes["1/-1"].centreline_m
    assert_allclose(through[:, 1], -1.75)
    assert_allclose(through[[0, -1], 0], [0.0, 100.0])
    assert (np.diff(through[:, 0]) > 0.0).all()
    assert_allclose(
        ends(lanes["1/-1/1"]), np.array([[40.0, 1.75, 0.0], [100.0, 1.75, 0.0]])
    )


@pytest.mark.parametrize(
    ("before", "after", "begin_m", "ids"),
    [
        # Only the later one links them.
        ({}, {"before": -1}, 40.0, {"1/-1"}),
        ({}, {}, 40.0, {"1/-1", "1/-1/1"}),
        # Links to lanes that are not there.
        ({"after": -7}, {"before": 9}, 40.0, {"1/-1", "1/-1/1"}),
        # The later one names another one.
        ({"after": -1}, {"before": 9}, 40.0, {"1/-1", "1/-1/1"}),
        # A last section without length does not hide the end.
        ({"after": -1}, {"before": -1}, 100.0, {"1/-1"}),
    ],
)
def test_pieces_are_joined_where_one_of_them_links_the_other(
    lanes_of, before, after, begin_m, ids
):
    first = section(right=[lane(-1, **before)])
    second = section(right=[lane(-1, **after)], s=begin_m)
    sections = first + second

    assert set(lanes_of(sections=sections)) == ids


def test_a_lane_is_there_only_where_it_has_a_width(lanes_of):
    widths = (
        cubic("width", 0.0, 0.0)
        + cubic("width", 20.0, 0.0, 0.1)
        + cubic("width", 50.0, 3.0)
        + cubic("width", 80.0, 0.0)
    )
    sections = section(right=[lane(-1, width=widths)])
    (one,) = lanes_of(sections=sections).values()
    begin, end = ends(one)

    assert 20.0 <= begin[0] <= 26.0
    assert 75.0 <= end[0] <= 80.0
    assert not one.from_junction
    assert 2.0 < one.width_m < 3.0


def test_heights_follow_the_elevation(lanes_of):
    elevation = cubic("elevation", 0.0, 10.0, 0.05) + cubic(
        "elevation", 50.0, 12.5, 0.0, 0.01
    )
    x, _, z = lanes_of(elevation=elevation)["1/-1"].centreline_m.T
    expected = np.where(x < 50.0, 10.0 + 0.05 * x, 12.5 + 0.01 * (x - 50.0) ** 2)

    assert_allclose(z, expected, atol=1e-9)


def test_superelevation_raises_the_left_side_and_lowers_the_right(tmp_path):
    text = road(
        sections=section(left=[lane(1, width=3.0)], right=[lane(-1)]),
        lateral=(
            cubic("superelevation", 0.0, 0.02, 0.0005)
            + cubic("superelevation", 60.0, 0.05)
        ),
        elevation=cubic("elevation", 0.0, 10.0, 0.05),
    )
    read = read_text(tmp_path, document(text))
    lines = {one.id: one.centreline_m for one in read.lanes}
    edge = read.ground_m[np.abs(read.ground_m[:, 1] + 3.5) < 1e-9]

    for points, t_m in ((lines["1/1"], 1.5), (lines["1/-1"], -1.75), (edge, -3.5)):
        x, y, z = points.T
        assert len(x) > 10
        assert_allclose(y, t_m, atol=1e-9)
        angle = np.where(x < 60.0, 0.02 + 0.0005 * x, 0.05)
        assert_allclose(z, 10.0 + 0.05 * x + t_m * np.sin(angle), atol=1e-9)


def test_shapes_of_cross_sections_are_left_out_and_noted(tmp_path):
    crown = '<shape s="0" t="-9" a="0.18" b="-0.02" c="0" d="0"/>'
    read = read_text(tmp_path, document(road("1", lateral=crown)))

    assert [note.what for note in read.skipped] == ["road 1 shape"]
    assert not read.ground_m[:, 2].any()


def test_a_namespace_makes_no_difference(tmp_path):
    root = 'OpenDRIVE xmlns="http://code.asam.net/simulation/standard/opendrive_schema"'
    text = document(road(), root=root)
    assert len(read_text(tmp_path, text).lanes) == 2


def test_most_roads_say_which_side_traffic_keeps(tmp_path):
    roads = [road("1", rule="LHT"), road("2", rule="LHT"), road("3", rule="RHT")]
    read = read_text(tmp_path, document(*roads))

    assert read.keeps_left
    assert [note.what for note in read.skipped] == ["rule of 1 of 3 roads"]
