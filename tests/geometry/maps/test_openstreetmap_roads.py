"""Lanes, junctions and what lies beside roads, from small hand-made files."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from osm_drawing import (
    COMPASS,
    FOUR,
    assert_lanes_end_at_outlines,
    drawn,
    drawn_crossing,
    read_drawing,
)
from osm_text import arm_lanes, arms_of, scene_of

from geometry.maps.importing import ReadingOptions, read_map, survey_junctions
from geometry.scene_checks import lanes_that_cross


def lane_counts(source):
    """Lanes in and out of the only junction, by arm."""
    (junction,) = source.junctions
    return arm_lanes(source, junction)


def only_arms(source):
    """Arms of the only junction, by name."""
    (junction,) = source.junctions
    return arms_of(source, junction).arms


def reasons(source):
    """What a reading tells, in one text."""
    return "; ".join(skipped.why for skipped in source.skipped)


def east_west(tags):
    """A drawing of one road of 100 m that leads east."""
    return drawn(f"road -50 0, 50 0: {tags}")


def strips_of_road(tags, folder, *, keeps_left=False):
    """Kind, width and place to the left of each strip of a road that leads east.

    They come from left to right; widths are negative westwards: ("driving", 3.0, -1.5)
    is driven east, 3 m wide and 1.5 m to the right. [m]
    """
    source = read_drawing(east_west(tags), folder, keeps_left=keeps_left)
    strips = []
    for lane in source.lanes:
        middle_m = lane.centreline_m[:, 1].mean()
        length_m = lane.centreline_m[-1, 0] - lane.centreline_m[0, 0]
        width_m = float(np.sign(length_m) * lane.width_m)
        strips.append((lane.kind, round(width_m, 3), round(float(middle_m), 2)))

    return sorted(strips, key=lambda strip: -strip[2])


# ---------------------------------------------------------------- cross-sections


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        (
            "",
            [
                ("driving", -2.75, 1.4),
                ("driving", 2.75, -1.4),
            ],
        ),
        (
            "width=7",
            [
                ("driving", -3.5, 1.8),
                ("driving", 3.5, -1.8),
            ],
        ),
        (
            "est_width=6",
            [
                ("driving", -3.0, 1.5),
                ("driving", 3.0, -1.5),
            ],
        ),
        ("oneway=yes", [("driving", 2.75, 0.0)]),
        ("oneway=-1", [("driving", -2.75, 0.0)]),
        (
            "oneway=yes; lanes=2",
            [
                ("driving", 2.75, 1.4),
                ("driving", 2.75, -1.4),
            ],
        ),
        (
            "lanes=3; lanes:forward=1; width=9",
            [
                ("driving", -3.0, 3.0),
                ("driving", -3.0, 0.0),
                ("driving", 3.0, -3.0),
            ],
        ),
        (
            "turn:lanes:forward=left|through; lanes=3; width=9",
            [
                ("driving", -3.0, 3.0),
                ("driving", 3.0, 0.0),
                ("driving", 3.0, -3.0),
            ],
        ),
        (
            "lanes=3; lanes:both_ways=1; width=9",
            [
                ("driving", -3.0, 3.0),
                ("driving", 3.0, -3.0),
            ],
        ),
        (
            "oneway=yes; lanes=2; width:lanes=3.5|2.5",
            [
                ("driving", 3.5, 1.2),
                ("driving", 2.5, -1.8),
            ],
        ),
        (
            (
                "width:lanes:forward=3; width:lanes:backward=2.5|3.5; lanes=3; "
                "lanes:backward=2"
            ),
            [
                ("driving", -3.5, 2.8),
                ("driving", -2.5, -0.2),
                ("driving", 3.0, -3.0),
            ],
        ),
        (
            "width=3.6",
            [
                ("driving", -3.0, 0.3),
                ("driving", 3.0, -0.3),
            ],
        ),
        (
            "lanes=1; width=4",
            [
                ("driving", -3.4, 0.3),
                ("driving", 3.4, -0.3),
            ],
        ),
        (
            "highway=service",
            [
                ("driving", -2.9, 0.3),
                ("driving", 2.9, -0.3),
            ],
        ),
        (
            "width=10; parking:right=lane; parking:right:width=2",
            [
                ("driving", -4.0, 3.0),
                ("driving", 4.0, -1.0),
                ("parking", 2.0, -4.0),
            ],
        ),
        (
            (
                "width=6; parking:left=street_side; "
                "parking:left:orientation=perpendicular"
            ),
            [
                ("parking", -5.0, 5.5),
                ("driving", -3.0, 1.5),
                ("driving", 3.0, -1.5),
            ],
        ),
        (
            ("width=10; parking:lane:left=parallel; parking:lane:right=no_parking"),
            [
                ("parking", -2.0, 4.0),
                ("driving", -4.0, 1.0),
                ("driving", 4.0, -3.0),
            ],
        ),
        (
            "width=6; parking:both=lane; parking:both:restriction=no_stopping",
            [
                ("driving", -3.0, 1.5),
                ("driving", 3.0, -1.5),
            ],
        ),
        (
            "width=9; cycleway=lane",
            [
                ("cycling", -1.5, 3.8),
                ("driving", -3.0, 1.5),
                ("driving", 3.0, -1.5),
                ("cycling", 1.5, -3.8),
            ],
        ),
        (
            "width=6; cycleway:right=track; sidewalk=right",
            [
                ("driving", -3.0, 1.5),
                ("driving", 3.0, -1.5),
                ("cycling", 2.0, -4.0),
                ("walking", 2.5, -6.2),
            ],
        ),
        (
            "width=6; oneway=yes; cycleway=opposite_lane; cycleway:width=1",
            [
                ("cycling", -1.0, 2.5),
                ("driving", 5.0, -0.5),
            ],
        ),
        (
            "width=6; oneway=-1; sidewalk=left",
            [
                ("walking", -2.5, 4.2),
                ("driving", -6.0, 0.0),
            ],
        ),
    ],
)
def test_tags_say_what_lies_side_by_side(tags, expected, tmp_path):
    found = strips_of_road(tags, tmp_path)
    wanted = expected

    assert [strip[:2] for strip in found] == [strip[:2] for strip in wanted]

    places_m = [strip[2] for strip in found]
    assert_allclose(places_m, [strip[2] for strip in wanted], atol=0.11)


def test_where_traffic_keeps_left_lanes_lie_as_in_a_mirror(tmp_path):
    tags = "lanes=3; lanes:forward=2"
    left = strips_of_road(tags, tmp_path, keeps_left=True)
    mirrored = strips_of_road(tags, tmp_path)[::-1]

    assert [strip[:2] for strip in left] == [strip[:2] for strip in mirrored]

    places_m = [-strip[2] for strip in mirrored]
    assert_allclose([strip[2] for strip in left], places_m, atol=0.03)


@pytest.mark.parametrize(
    "tags", ["width=wide", "width=900", "lanes=2;3", "lanes=99", "lanes:forward=many"]
)
def test_what_makes_no_sense_is_told_and_usual_sizes_stand_in(tags, tmp_path):
    osm = east_west(tags)
    source = read_drawing(osm, tmp_path, keeps_left=False)

    assert [lane.width_m for lane in source.lanes] == [2.75, 2.75]

    (skipped,) = source.skipped
    assert skipped.what == f"way {osm.ids[0]}"
    assert "makes no sense" in skipped.why


@pytest.mark.parametrize(
    "tags",
    [
        "highway=footway",
        "highway=residential; area=yes",
        "highway=service; service=driveway",
        "highway=residential; motor_vehicle=no",
        "highway=service; access=no",
        "railway=tram",
    ],
)
def test_what_is_no_road_for_cars_has_no_lanes(tags, tmp_path):
    osm = east_west("").draw(f"way -50 30, 50 30: {tags}")
    assert len(read_drawing(osm, tmp_path).lanes) == 2


# ---------------------------------------------------------------- junctions


def test_four_roads_of_two_lanes_meet(tmp_path):
    osm = drawn_crossing("width=6")
    source = read_drawing(osm, tmp_path)
    (junction,) = source.junctions

    assert junction.id == f"n{osm.nodes[0, 0]}"
    assert junction.name == "Street 0 / Street 1 / Street 2 / Street 3"
    assert lane_counts(source) == dict.fromkeys(COMPASS, (1, 1))
    assert_lanes_end_at_outlines(source)

    # Half the crossing road and a corner of 5 m from the middle; lanes 1.5 m beside the
    # axis.
    for lane in source.lanes:
        line = lane.centreline_m[:, :2]
        assert lane.width_m == pytest.approx(3.0)
        if lane.from_junction:
            tip = line[0]
        else:
            tip = line[-1]
        assert np.abs(tip).max() == pytest.approx(8.0, abs=0.55)
        assert_allclose(np.abs(line).min(axis=1), 1.5, atol=0.03)

    # Traffic keeps right: what leads east lies south of the axis.
    leaving = [lane for lane in source.lanes if lane.from_junction]
    (east,) = (lane for lane in leaving if lane.centreline_m[-1, 0] > 50.0)

    assert east.centreline_m[:, 1].max() < 0.0
    assert east.from_junction == junction.id
    assert not east.to_junction


def bearings_of(*angles_deg):
    """Unit vectors at angles, counter-clockwise from east."""
    angles = np.radians(angles_deg)
    return [(math.cos(angle), math.sin(angle)) for angle in angles]


@pytest.mark.parametrize(
    ("angles_deg", "names"),
    [
        ((0, 180, 270), ["east", "west", "south"]),
        (
            (0, 72, 144, 216, 288),
            ["east", "north", "north-west", "south-west", "south"],
        ),
        ((0, 180, 40, 220), ["east", "south-west", "west", "north-east"]),
    ],
)
def test_roads_meet_under_any_angle(angles_deg, names, tmp_path):
    osm = drawn_crossing(bearings=bearings_of(*angles_deg))
    source = read_drawing(osm, tmp_path)

    assert lane_counts(source) == dict.fromkeys(names, (1, 1))
    assert_lanes_end_at_outlines(source)

    outline = source.junctions[0].outline_m
    assert np.linalg.norm(outline, axis=-1).max() <= 31.0


def test_one_way_arms_have_lanes_in_one_direction(tmp_path):
    osm = drawn("""
        road -80 0, 0 0, 80 0: oneway=yes; lanes=2
        road 0 -80, 0 0, 0 80
    """)
    counts = lane_counts(read_drawing(osm, tmp_path))
    assert counts == {"east": (0, 2), "north": (1, 1), "west": (2, 0), "south": (1, 1)}


def test_dual_carriageways_cross_in_one_junction(tmp_path):
    avenue = "highway=primary; oneway=yes; lanes=2; name=Long Avenue"
    street = "highway=primary; oneway=yes; lanes=2; name=Wide Street"
    # Eastwards in the south, as traffic that keeps right does.
    osm = drawn(f"""
        way -120 -8, -8 -8, 8 -8, 120 -8: {avenue}
        way 120 8, 8 8, -8 8, -120 8: {avenue}
        way -8 120, -8 8, -8 -8, -8 -120: {street}
        way 8 -120, 8 -8, 8 8, 8 120: {street}
    """)
    source = read_drawing(osm, tmp_path)

    assert not source.keeps_left
    # The carriageways show it.
    assert not any("side" in skipped.what for skipped in source.skipped)

    (junction,) = source.junctions
    met = [osm.nodes[x, y] for x in (-8, 8) for y in (-8, 8)]

    assert junction.id == f"n{min(met)}"
    assert junction.name == "Long Avenue / Wide Street"
    assert lane_counts(source) == dict.fromkeys(COMPASS, (2, 2))
    assert_lanes_end_at_outlines(source)


@pytest.mark.parametrize(
    ("offset_m", "n_arms"),
    [
        (15, [4]),
        (60, [3, 3]),
    ],
)
def test_offset_side_streets_are_one_junction_and_distant_ones_two(
    offset_m, n_arms, tmp_path
):
    osm = drawn(f"""
        road -90 0, 0 0, {offset_m} 0, 150 0: name=Main Street
        road 0 0, 0 90
        road {offset_m} 0, {offset_m} -90
    """)
    source = read_drawing(osm, tmp_path)

    assert_lanes_end_at_outlines(source)

    found = [len(arms_of(source, one).arms) for one in source.junctions]
    assert found == n_arms


@pytest.mark.parametrize(
    ("sides", "staggered_m", "n_arms"),
    [
        (["north", "south"], 0.0, [3, 3]),
        (["north", "south"], 40.0, [4]),
        (["south", "north"], 40.0, [4]),
        (["north", "south"], 34.0, [3, 3]),
        (["north", "north"], 40.0, [3, 3]),  # on one side: two junctions of their own
        (["north", "both"], 40.0, [4, 3]),
    ],
)
def test_side_roads_35_m_apart_on_either_side_are_one_junction_if_asked_for(
    sides, staggered_m, n_arms, tmp_path
):
    osm = drawn("road -90 0, 0 0, 35 0, 150 0: name=Main Street")
    ends_m = {"north": [90], "south": [-90], "both": [90, -90]}
    for east_m, side in zip((0, 35), sides, strict=True):
        for north_m in ends_m[side]:
            osm.draw(f"road {east_m} 0, {east_m} {north_m}: name=Lane {east_m}")

    path = osm.write(tmp_path, "staggered.osm")
    source = read_map(path, ReadingOptions(staggered_m=staggered_m))
    found = [len(one.arms) for one in survey_junctions(source)]

    assert sorted(found, reverse=True) == n_arms


def test_driving_side_tag_goes_before_everything(tmp_path):
    osm = east_west("driving_side=left")
    assert read_drawing(osm, tmp_path).keeps_left
    assert not read_drawing(osm, tmp_path, keeps_left=False).keeps_left


def test_an_assumed_driving_side_is_told(tmp_path):
    osm = east_west("")
    (skipped,) = read_drawing(osm, tmp_path).skipped

    assert skipped.what == "side of the road"
    assert "right-hand traffic" in skipped.why
    assert not read_drawing(osm, tmp_path, keeps_left=False).skipped


@pytest.mark.parametrize("tag", ["", "highway=traffic_signals"])
def test_yards_make_no_junction_unless_signals_stand_there(tag, tmp_path):
    osm = drawn(f"""
        node 0 0: {tag}
        road -80 0, 0 0, 80 0
        road 0 0, 0 80: highway=service
    """)
    source = read_drawing(osm, tmp_path)

    assert len(source.junctions) == bool(tag)
    if not tag:  # the road goes on as if nothing were there
        lengths = sorted(np.ptp(lane.centreline_m[:, 0]) for lane in source.lanes)
        assert lengths[-2:] == pytest.approx([160.0, 160.0], abs=0.1)


def test_roads_that_only_cross_do_not_meet(tmp_path):
    osm = drawn("""
        road -80 0, 80 0
        road 0 -80, 0 80: bridge=yes; layer=1
    """)
    source = read_drawing(osm, tmp_path)

    assert not source.junctions

    heights = {float(lane.centreline_m[:, 2].max()) for lane in source.lanes}
    assert heights == {0.0, 5.0}


def test_roads_that_meet_on_a_bridge_are_no_junction_on_the_ground(tmp_path):
    osm = drawn_crossing("bridge=yes; layer=1")
    assert not read_drawing(osm, tmp_path).junctions


def test_a_street_is_followed_over_nodes_where_only_tags_change(tmp_path):
    # The second road is mapped the other way round.
    osm = drawn("""
        road 0 0, 60 0: width=6; parking:right=street_side
        road 140 0, 60 0: width=8
        road -80 0, 0 0, 0 80
    """)
    source = read_drawing(osm, tmp_path)
    east = [lane for lane in source.lanes if lane.centreline_m[:, 0].max() > 130.0]

    assert [lane.kind for lane in east] == ["driving", "driving"]
    for lane in east:
        assert 3.0 < lane.width_m < 4.0
        order = np.argsort(lane.centreline_m[:, 0])
        x, y, _ = lane.centreline_m[order].T
        aside_m = np.abs(np.interp([30.0, 120.0], x, y))
        assert_allclose(aside_m, [1.5, 2.0], atol=0.03)


def test_turning_lanes_begin_where_the_lane_before_them_ends(tmp_path):
    osm = drawn("""
        road -150 0, -50 0: width=6
        road -50 0, 0 0: turn:lanes:forward=left|through; lanes=3; width=9
        road 0 0, 100 0
        road 0 100, 0 0, 0 -100
    """)
    source = read_drawing(osm, tmp_path)
    (junction,) = source.junctions

    # Lanes before those of the junction are its own, too.
    lanes = []
    for lane in source.lanes:
        if not lane.from_junction and not lane.to_junction:
            lane = replace(lane, to_junction=junction.id)
        lanes.append(lane)

    changed = replace(source, lanes=tuple(lanes))
    west = only_arms(changed)["west"]

    assert len(west.entry_lanes) == 2
    assert len(west.exit_lanes) == 1
    for lane in west.entry_lanes:
        assert lane.centreline_m[0, 0] == pytest.approx(-150.0, abs=0.1)


def test_carriageways_lead_on_into_the_road_they_become(tmp_path):
    osm = drawn("""
        road 0 0, 60 0: name=A; width=7
        road 60 0, 80 -6, 160 -6: name=A; oneway=yes
        road 160 6, 80 6, 60 0: name=A; oneway=yes
        road -80 0, 0 0, 0 80
    """)
    source = read_drawing(osm, tmp_path)

    assert len(source.junctions) == 1  # a fork is none

    driving = [lane.centreline_m[:, :2] for lane in source.lanes]
    west_bound = next(line for line in driving if line[0, 0] > 150.0)
    gaps_m = [np.linalg.norm(line[0] - west_bound[-1]) for line in driving]

    assert min(gaps_m) < 0.01


def test_where_one_lane_becomes_three_at_a_fork_all_stay_on_their_side(tmp_path):
    primary = "highway=primary; name=A"
    osm = drawn(f"""
        way -160 0, -60 0: {primary}; lanes=2
        way -60 0, -45 -7, 0 -7: {primary}; oneway=yes; lanes=3
        way 0 7, -45 7, -60 0: {primary}; oneway=yes; lanes=2
        road 0 -80, 0 -7, 0 7, 0 80
    """)
    source = read_drawing(osm, tmp_path, keeps_left=False)
    scene = scene_of(source, source.junctions[0], source.lanes)

    assert not list(lanes_that_cross(scene))

    (one,) = (lane for lane in scene.lanes if lane.centreline_m[0, 0] < -150.0)
    end = one.centreline_m[-1]

    assert end[1] < -1.0  # to the right of the axis

    gaps_m = [np.linalg.norm(lane.centreline_m[0] - end) for lane in scene.lanes]
    assert sum(gap_m < 0.01 for gap_m in gaps_m) == 3


@pytest.mark.parametrize("keeps_left", [False, True])
def test_turn_lanes_are_those_of_the_lanes_from_the_left(keeps_left, tmp_path):
    of_west = "turn:lanes:forward=left;slight_left|none|through;right; lanes=4"
    of_north = "turn:lanes:forward=left|through|right|; lanes=3"
    osm = drawn(f"""
        road -100 0, 0 0: lanes:forward=3; {of_west}
        road 0 100, 0 0: lanes:forward=2; {of_north}
        road 0 0, 100 0: oneway=-1; turn:lanes=reverse|odd; lanes=2
    """)
    source = read_drawing(osm, tmp_path, keeps_left=keeps_left)

    left_first = {}
    for name, arm in only_arms(source).items():
        turns = [lane.turns for lane in arm.entry_lanes]
        if not keeps_left:
            turns = turns[::-1]
        left_first[name] = turns

    assert left_first == {
        "west": [("left", "through"), (), ("through", "right")],
        "north": [(), ()],  # four markings for two lanes
        "east": [("reverse",), ()],
    }
    assert "turn:lanes has another number" in reasons(source)


def test_two_meetings_too_near_to_be_two_but_too_far_to_be_one_share_the_road(tmp_path):
    osm = drawn("road -90 0, 0 0, 26 0, 52 0, 78 0, 180 0: width=14; lanes=4")
    for east_m in (0, 26, 52, 78):
        osm.draw(f"road {east_m} 0, {east_m} 90: width=14; lanes=4")

    source = read_drawing(osm, tmp_path)

    assert len(source.junctions) == 4
    assert_lanes_end_at_outlines(source)
    for junction in source.junctions:
        assert len(arms_of(source, junction).arms) == 3


def test_a_road_that_only_bends_back_is_no_junction(tmp_path):
    osm = drawn("""
        road -80 0, 0 0
        road 0 0, 80 3
        road 0 0, 80 -3
    """)
    source = read_drawing(osm, tmp_path)

    assert not source.junctions
    assert "fewer than three arms" in reasons(source)


def test_nodes_that_the_file_does_not_have_cut_roads_short(tmp_path):
    osm = drawn("")
    osm.road([(0.0, 0.0), (50.0, 0.0), 999, (90.0, 0.0)])
    source = read_drawing(osm, tmp_path)
    length_m = np.ptp(source.lanes[0].centreline_m[:, 0])

    assert length_m == pytest.approx(50.0, abs=0.05)
    assert "nodes are missing" in reasons(source)


# ---------------------------------------------------------------- speed limits


@pytest.mark.parametrize(
    ("tags", "limit_kmh"),
    [
        ("maxspeed=50", 50.0),
        ("maxspeed=20 mph", 32.2),
        ("maxspeed=DE:zone:30", 30.0),
        ("maxspeed=walk", 7.0),
        ("maxspeed=none; source:maxspeed=DE:urban", None),
        ("source:maxspeed=DE:urban", 50.0),
        ("maxspeed=50; maxspeed:conditional=30 @ (22:00-06:00)", 50.0),
        ("", None),
        ("maxspeed:forward=50; maxspeed:backward=30", 30.0),
        ("maxspeed=60; maxspeed:backward=40", 40.0),
        ("maxspeed:forward=50", None),
        ("oneway=-1; maxspeed:backward=30", 30.0),
    ],
)
def test_an_arm_has_the_speed_limit_of_those_who_come(tags, limit_kmh, tmp_path):
    osm = drawn_crossing(bearings=FOUR[1:]).draw(f"road 0 0, 90 0: {tags}")
    arms = only_arms(read_drawing(osm, tmp_path))
    limits = {name: arm.speed_limit_kmh for name, arm in arms.items()}

    assert limits == dict.fromkeys(COMPASS) | {"east": limit_kmh}


def test_the_speed_limit_next_to_the_junction_counts(tmp_path):
    osm = drawn_crossing(bearings=FOUR[1:]).draw("""
        road 0 0, 60 0: maxspeed=30
        road 60 0, 200 0: maxspeed=70
    """)
    arms = only_arms(read_drawing(osm, tmp_path))
    assert arms["east"].speed_limit_kmh == 30.0


# ---------------------------------------------------------------- merges


@pytest.mark.parametrize(
    ("tags", "node", "is_junction"),
    [
        ("highway=motorway_link", "", False),
        ("highway=motorway", "", False),
        ("highway=trunk; motorroad=yes", "", False),
        ("highway=motorway_link", "highway=traffic_signals", True),
        ("highway=motorway_link; sidewalk=right", "", True),
        ("highway=trunk", "", True),
        ("highway=primary", "", True),
    ],
)
def test_where_motorways_merge_and_part_is_no_junction(
    tags, node, is_junction, tmp_path
):
    osm = drawn(f"""
        node 0 0: {node}
        road -150 0, 0 0: oneway=yes; {tags}
        road -100 -90, 0 0: oneway=yes; {tags}
        road 0 0, 150 0: oneway=yes; {tags}
        road 0 0, 90 120: oneway=yes; {tags}
    """)
    source = read_drawing(osm, tmp_path)

    assert bool(source.junctions) == is_junction

    told = [note.why for note in source.skipped]
    assert ("motorways merge or part where nobody walks" in told) == (not is_junction)


PARTS = ("-90 0, 0 0", "0 0, 60 80", "0 0, 60 -80")
CROSSES = ("-90 0, 0 0", "0 0, 90 0", "0 0, 0 90", "0 -90, 0 0")


@pytest.mark.parametrize(
    ("kind", "roads", "is_junction"),
    [
        ("trunk", PARTS, False),
        ("trunk", CROSSES, True),
        ("primary", PARTS, True),
    ],
)
def test_trunk_roads_merge_only_where_no_ways_cross(kind, roads, is_junction, tmp_path):
    osm = drawn("")
    for road in roads:
        osm.draw(f"road {road}: highway={kind}; oneway=yes")
    assert bool(read_drawing(osm, tmp_path).junctions) == is_junction
