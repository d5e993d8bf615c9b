"""Lanes: kinds, directions, joints."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from opendrive_text import cubic, document, geometry, lane, read_text, road, section


def _lanes(tmp_path, *roads):
    return {one.id: one for one in read_text(tmp_path, document(*roads)).lanes}


def test_right_lanes_follow_the_road_and_left_ones_come_back(tmp_path):
    lanes = _lanes(tmp_path, road())
    assert_allclose(
        lanes["1/-1"].centreline_m[[0, -1]], [[0, -1.75, 0], [100, -1.75, 0]]
    )
    assert_allclose(lanes["1/1"].centreline_m[[0, -1]], [[100, 1.75, 0], [0, 1.75, 0]])
    assert lanes["1/1"].width_m == pytest.approx(3.5)


def test_left_hand_traffic_is_right_hand_traffic_turned_round(tmp_path):
    plan = geometry('<spiral curvStart="0" curvEnd="0.03"/>')
    right = _lanes(tmp_path, road(plan=plan, rule="RHT"))
    left = read_text(tmp_path, document(road(plan=plan, rule="LHT")))

    assert left.keeps_left

    for one in left.lanes:
        assert_allclose(one.centreline_m, right[one.id].centreline_m[::-1])


def test_a_reversed_lane_is_driven_the_other_way(tmp_path):
    lanes = _lanes(
        tmp_path, road(sections=section(right=[lane(-1, extra='direction="reversed"')]))
    )
    assert_allclose(lanes["1/-1"].centreline_m[0], [100, -1.75, 0])


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        *(
            (name, "driving")
            for name in ("driving", "entry", "exit", "onRamp", "offRamp")
        ),
        *((name, "driving") for name in ("connectingRamp", "bidirectional", "HOV")),
        ("bus", "bus"),
        ("taxi", "bus"),
        ("parking", "parking"),
        ("biking", "cycling"),
        ("sidewalk", "walking"),
        ("walking", "walking"),
        *(
            (name, None)
            for name in ("none", "border", "shoulder", "stop", "median", "rail", "curb")
        ),
        ("something new", None),
    ],
)
def test_types_of_lanes(tmp_path, written, kind):
    lanes = _lanes(tmp_path, road(sections=section(right=[lane(-1, written)])))
    assert [one.kind for one in lanes.values()] == ([] if kind is None else [kind])


def test_linked_pieces_are_one_lane_also_under_new_numbers(tmp_path):
    sections = section(
        right=[lane(-1, after=-2), lane(-2, "sidewalk", after=-3)]
    ) + section(
        s=40.0, right=[lane(-1), lane(-2, before=-1), lane(-3, "sidewalk", before=-2)]
    )
    offset = cubic("laneOffset", 0.0) + cubic("laneOffset", 40.0, 3.5)
    lanes = _lanes(tmp_path, road(sections=sections, offset=offset))

    assert set(lanes) == {"1/-1", "1/-2", "1/-1/1"}

    through = lanes["1/-1"].centreline_m
    assert_allclose(through[:, 1], -1.75)
    assert_allclose(through[[0, -1], 0], [0.0, 100.0])
    assert (np.diff(through[:, 0]) > 0.0).all()
    assert_allclose(
        lanes["1/-1/1"].centreline_m[[0, -1], :2], [[40, 1.75], [100, 1.75]]
    )


def test_pieces_that_only_the_later_one_links_are_joined_too(tmp_path):
    sections = section(right=[lane(-1)]) + section(s=40.0, right=[lane(-1, before=-1)])
    assert set(_lanes(tmp_path, road(sections=sections))) == {"1/-1"}


def test_pieces_without_links_stay_apart(tmp_path):
    sections = section(right=[lane(-1)]) + section(s=40.0, right=[lane(-1)])
    lanes = _lanes(tmp_path, road(sections=sections))
    assert set(lanes) == {"1/-1", "1/-1/1"}


def test_links_to_lanes_that_are_not_there_end_a_lane(tmp_path):
    sections = section(right=[lane(-1, after=-7)]) + section(
        s=40.0, right=[lane(-1, before=9)]
    )
    assert len(_lanes(tmp_path, road(sections=sections))) == 2


def test_a_lane_is_there_only_where_it_has_a_width(tmp_path):
    widths = (
        cubic("width", 0.0, 0.0)
        + cubic("width", 20.0, 0.0, 0.1)
        + cubic("width", 50.0, 3.0)
        + cubic("width", 80.0, 0.0)
    )
    (one,) = _lanes(
        tmp_path, road(sections=section(right=[lane(-1, width=widths)]))
    ).values()

    assert 20.0 <= one.centreline_m[0, 0] <= 26.0
    assert 75.0 <= one.centreline_m[-1, 0] <= 80.0
    assert not one.from_junction
    assert 2.0 < one.width_m < 3.0


def test_heights_follow_the_elevation(tmp_path):
    elevation = cubic("elevation", 0.0, 10.0, 0.05) + cubic(
        "elevation", 50.0, 12.5, 0.0, 0.01
    )
    one = _lanes(tmp_path, road(elevation=elevation))["1/-1"]
    x, _, z = one.centreline_m.T
    expected = np.where(x < 50.0, 10.0 + 0.05 * x, 12.5 + 0.01 * (x - 50.0) ** 2)

    assert_allclose(z, expected, atol=1e-9)


def test_superelevation_raises_the_left_side_and_lowers_the_right(tmp_path):
    roll = cubic("superelevation", 0.0, 0.02, 0.0005) + cubic(
        "superelevation", 60.0, 0.05
    )
    climb = cubic("elevation", 0.0, 10.0, 0.05)
    sides = section(left=[lane(1, width=3.0)], right=[lane(-1, width=3.5)])
    read = read_text(
        tmp_path, document(road("1", sections=sides, lateral=roll, elevation=climb))
    )
    lines = [
        (one.centreline_m, {"1/1": 1.5, "1/-1": -1.75}[one.id]) for one in read.lanes
    ]
    edge = read.ground_m[np.abs(read.ground_m[:, 1] + 3.5) < 1e-9]

    for (x, y, z), t_m in ((points.T, t_m) for points, t_m in [*lines, (edge, -3.5)]):
        assert len(x) > 10
        assert_allclose(y, t_m, atol=1e-9)
        angle = np.where(x < 60.0, 0.02 + 0.0005 * x, 0.05)
        assert_allclose(z, 10.0 + 0.05 * x + t_m * np.sin(angle), atol=1e-9)


def test_shapes_of_cross_sections_are_left_out_and_noted(tmp_path):
    crown = '<shape s="0" t="-9" a="0.18" b="-0.02" c="0" d="0"/>'
    read = read_text(tmp_path, document(road("1", lateral=crown)))

    assert [note.what for note in read.skipped] == ["road 1 shape"]
    assert not read.ground_m[:, 2].any()


def test_a_last_section_without_length_does_not_hide_the_end(tmp_path):
    sections = section(right=[lane(-1, after=-1)]) + section(
        s=100.0, right=[lane(-1, before=-1)]
    )
    lanes = _lanes(tmp_path, road(sections=sections))
    assert set(lanes) == {"1/-1"}


def test_a_namespace_makes_no_difference(tmp_path):
    root = 'OpenDRIVE xmlns="http://code.asam.net/simulation/standard/opendrive_schema"'
    assert len(read_text(tmp_path, document(road(), root=root)).lanes) == 2


def test_most_roads_say_which_side_traffic_keeps(tmp_path):
    read = read_text(
        tmp_path,
        document(road("1", rule="LHT"), road("2", rule="LHT"), road("3", rule="RHT")),
    )
    assert read.keeps_left
    assert [note.what for note in read.skipped] == ["rule of 1 of 3 roads"]
