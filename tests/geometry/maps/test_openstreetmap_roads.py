"""Lanes, junctions and what lies beside roads, from small hand-made files."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from osm_tags import tags_of
from osm_text import OsmText, arm_lanes, arms_of, as_drawn, crossing, scene_of

from geometry.junction import distance_to_outline_m
from geometry.maps.importing import ReadingOptions, read_map, survey_junctions
from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.source_map import MapLane, SourceMap
from geometry.scene_checks import lanes_that_cross

EAST = (1.0, 0.0)
NORTH = (0.0, 1.0)
WEST = (-1.0, 0.0)
SOUTH = (0.0, -1.0)
FOUR = (EAST, NORTH, WEST, SOUTH)


def read(osm: OsmText, folder: Path, **options: bool) -> SourceMap:
    return as_drawn(read_openstreetmap(osm.write(folder), **options))


def lane_counts(source: SourceMap) -> dict[str, tuple[int, int]]:
    (junction,) = source.junctions
    return arm_lanes(source, junction)


def check_ends(source: SourceMap) -> None:
    """Lanes of junctions end where these begin."""
    outlines = {junction.id: junction.outline_m for junction in source.junctions}
    for lane in source.lanes:
        if lane.kind == "driving":
            for tip, name in ((0, lane.from_junction), (-1, lane.to_junction)):
                if name:
                    distance = distance_to_outline_m(
                        lane.centreline_m[tip, :2], outlines[name]
                    )
                    assert distance <= 1.0, lane.id


def one_road(
    tags: dict[str, str], folder: Path, **options: bool
) -> list[tuple[str, float, float]]:
    """Kind, width and place to the left of a road that leads east; those that run west:
    minus.
    """
    osm = OsmText()
    osm.way([(-50.0, 0.0), (50.0, 0.0)], tags_of("highway=residential") | tags)
    source = read(osm, folder, **({"keeps_left": False} | options))
    strips = []
    for lane in source.lanes:
        middle = lane.centreline_m[:, 1].mean()
        sign = np.sign(lane.centreline_m[-1, 0] - lane.centreline_m[0, 0])
        strips.append(
            (lane.kind, round(float(sign * lane.width_m), 3), round(float(middle), 2))
        )
    return sorted(strips, key=lambda strip: -strip[2])


# ---------------------------------------------------------------- cross-sections


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ("", [("driving", -2.75, 1.4), ("driving", 2.75, -1.4)]),
        ("width=7", [("driving", -3.5, 1.8), ("driving", 3.5, -1.8)]),
        ("est_width=6", [("driving", -3.0, 1.5), ("driving", 3.0, -1.5)]),
        ("oneway=yes", [("driving", 2.75, 0.0)]),
        ("oneway=-1", [("driving", -2.75, 0.0)]),
        ("oneway=yes; lanes=2", [("driving", 2.75, 1.4), ("driving", 2.75, -1.4)]),
        (
            "lanes=3; lanes:forward=1; width=9",
            [("driving", -3.0, 3.0), ("driving", -3.0, 0.0), ("driving", 3.0, -3.0)],
        ),
        (
            "turn:lanes:forward=left|through; lanes=3; width=9",
            [("driving", -3.0, 3.0), ("driving", 3.0, 0.0), ("driving", 3.0, -3.0)],
        ),
        (
            "lanes=3; lanes:both_ways=1; width=9",
            [("driving", -3.0, 3.0), ("driving", 3.0, -3.0)],
        ),
        (  # from left to right in driving direction: the widest is the innermost
            "oneway=yes; lanes=2; width:lanes=3.5|2.5",
            [("driving", 3.5, 1.2), ("driving", 2.5, -1.8)],
        ),
        (
            "width:lanes:forward=3; width:lanes:backward=2.5|3.5; lanes=3;"
            " lanes:backward=2",
            [("driving", -3.5, 2.8), ("driving", -2.5, -0.2), ("driving", 3.0, -3.0)],
        ),
        # one for both
        ("width=3.6", [("driving", -3.0, 0.3), ("driving", 3.0, -0.3)]),
        ("lanes=1; width=4", [("driving", -3.4, 0.3), ("driving", 3.4, -0.3)]),
        ("highway=service", [("driving", -2.9, 0.3), ("driving", 2.9, -0.3)]),
        (
            "width=10; parking:right=lane; parking:right:width=2",
            [("driving", -4.0, 3.0), ("driving", 4.0, -1.0), ("parking", 2.0, -4.0)],
        ),
        (
            "width=6; parking:left=street_side; parking:left:orientation=perpendicular",
            [("parking", -5.0, 5.5), ("driving", -3.0, 1.5), ("driving", 3.0, -1.5)],
        ),
        (
            "width=10; parking:lane:left=parallel; parking:lane:right=no_parking",
            [("parking", -2.0, 4.0), ("driving", -4.0, 1.0), ("driving", 4.0, -3.0)],
        ),
        (
            "width=6; parking:both=lane; parking:both:restriction=no_stopping",
            [("driving", -3.0, 1.5), ("driving", 3.0, -1.5)],
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
            [("cycling", -1.0, 2.5), ("driving", 5.0, -0.5)],
        ),
        (
            # left as the way is mapped
            "width=6; oneway=-1; sidewalk=left",
            [("walking", -2.5, 4.2), ("driving", -6.0, 0.0)],
        ),
    ],
)
def test_tags_say_what_lies_side_by_side(tags, expected, tmp_path):
    found = one_road(tags_of(tags), tmp_path)
    assert [strip[:2] for strip in found] == [strip[:2] for strip in expected]
    places = [strip[2] for strip in found]
    assert_allclose(places, [strip[2] for strip in expected], atol=0.11)


@pytest.mark.parametrize("tags", ["lanes=3; lanes:forward=2"])
def test_where_traffic_keeps_left_lanes_lie_as_in_a_mirror(tags, tmp_path):
    right = one_road(tags_of(tags), tmp_path)
    left = one_road(tags_of(tags), tmp_path, keeps_left=True)
    assert [strip[:2] for strip in left] == [strip[:2] for strip in right[::-1]]
    places = [-strip[2] for strip in right[::-1]]
    assert_allclose([strip[2] for strip in left], places, atol=0.03)


@pytest.mark.parametrize(
    "tags", ["width=wide", "width=900", "lanes=2;3", "lanes=99", "lanes:forward=many"]
)
def test_what_makes_no_sense_is_told_and_usual_sizes_stand_in(tags, tmp_path):
    osm = OsmText()
    way = osm.way([(-50.0, 0.0), (50.0, 0.0)], tags_of("highway=residential", tags))
    source = read(osm, tmp_path, keeps_left=False)
    assert [lane.width_m for lane in source.lanes] == [2.75, 2.75]
    (skipped,) = source.skipped
    assert skipped.what == f"way {way}"
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
    osm = OsmText()
    osm.road([(-50.0, 0.0), (50.0, 0.0)])
    osm.way([(-50.0, 30.0), (50.0, 30.0)], tags_of(tags))
    assert len(read(osm, tmp_path).lanes) == 2


# ---------------------------------------------------------------- junctions


def test_four_roads_of_two_lanes_meet(tmp_path):
    osm = OsmText()
    middle = crossing(osm, bearings=FOUR, width="6")
    source = read(osm, tmp_path)
    (junction,) = source.junctions
    assert junction.id == f"n{middle}"
    assert junction.name == "Street 0 / Street 1 / Street 2 / Street 3"
    assert lane_counts(source) == dict.fromkeys(
        ("east", "north", "west", "south"), (1, 1)
    )
    assert all(lane.width_m == pytest.approx(3.0) for lane in source.lanes)
    check_ends(source)
    # Half the crossing road and a corner of 5 m from the middle; lanes 1.5 m beside the
    # axis.
    for lane in source.lanes:
        tip = lane.centreline_m[0 if lane.from_junction else -1, :2]
        assert np.abs(tip).max() == pytest.approx(8.0, abs=0.55)
        assert_allclose(np.abs(lane.centreline_m[:, :2]).min(axis=1), 1.5, atol=0.03)
    # Traffic keeps right: what leads east lies south of the axis.
    east = next(
        lane
        for lane in source.lanes
        if lane.from_junction and lane.centreline_m[-1, 0] > 50.0
    )
    assert east.centreline_m[:, 1].max() < 0.0
    assert east.from_junction == junction.id
    assert not east.to_junction


@pytest.mark.parametrize(
    ("bearings", "names"),
    [
        ((EAST, WEST, SOUTH), {"east", "west", "south"}),
        (
            [
                (math.cos(angle), math.sin(angle))
                for angle in np.radians([0, 72, 144, 216, 288])
            ],
            {"east", "north", "north-west", "south-west", "south"},
        ),
        (  # skewed by 40 degrees
            (
                EAST,
                WEST,
                (math.cos(0.7), math.sin(0.7)),
                (-math.cos(0.7), -math.sin(0.7)),
            ),
            {"east", "west", "north-east", "south-west"},
        ),
    ],
)
def test_roads_meet_under_any_angle(bearings, names, tmp_path):
    osm = OsmText()
    crossing(osm, bearings=bearings)
    source = read(osm, tmp_path)
    assert lane_counts(source) == dict.fromkeys(names, (1, 1))
    check_ends(source)
    outline = source.junctions[0].outline_m
    assert np.hypot(*outline.T).max() <= 31.0


def test_one_way_arms_have_lanes_in_one_direction(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    osm.road([(-80.0, 0.0), middle, (80.0, 0.0)], oneway="yes", lanes="2")
    osm.road([(0.0, -80.0), middle, (0.0, 80.0)])
    source = read(osm, tmp_path)
    assert lane_counts(source) == {
        "east": (0, 2),
        "north": (1, 1),
        "west": (2, 0),
        "south": (1, 1),
    }


def test_dual_carriageways_cross_in_one_junction(tmp_path):
    osm = OsmText()
    at = {(x, y): osm.node(x, y) for x in (-8.0, 8.0) for y in (-8.0, 8.0)}
    tags = tags_of("highway=primary; oneway=yes; lanes=2")
    for y in (-8.0, 8.0):  # eastwards in the south, as traffic that keeps right does
        line: list[int | tuple[float, float]] = [
            (-120.0, y),
            at[-8.0, y],
            at[8.0, y],
            (120.0, y),
        ]
        osm.way(line[:: 1 if y < 0 else -1], tags | tags_of("name=Long Avenue"))
    for x in (-8.0, 8.0):
        line = [(x, -120.0), at[x, -8.0], at[x, 8.0], (x, 120.0)]
        osm.way(line[:: 1 if x > 0 else -1], tags | tags_of("name=Wide Street"))
    source = read(osm, tmp_path)
    assert not source.keeps_left
    assert not any(
        "side" in skipped.what for skipped in source.skipped
    )  # the carriageways show it
    (junction,) = source.junctions
    assert junction.id == f"n{min(at.values())}"
    assert junction.name == "Long Avenue / Wide Street"
    assert lane_counts(source) == dict.fromkeys(
        ("east", "north", "west", "south"), (2, 2)
    )
    check_ends(source)


def test_offset_side_streets_are_one_junction_and_distant_ones_two(tmp_path):
    counts = []
    for offset in (15.0, 60.0):
        osm = OsmText()
        one = osm.node(0.0, 0.0)
        other = osm.node(offset, 0.0)
        osm.road([(-90.0, 0.0), one, other, (150.0, 0.0)], name="Main Street")
        osm.road([one, (0.0, 90.0)])
        osm.road([other, (offset, -90.0)])
        source = read(osm, tmp_path)
        check_ends(source)
        counts.append(
            [len(arms_of(source, junction).arms) for junction in source.junctions]
        )
    assert counts == [[4], [3, 3]]


@pytest.mark.parametrize(
    ("sides", "staggered_m", "n_arms"),
    [
        ((1, -1), 0.0, [3, 3]),
        ((1, -1), 40.0, [4]),
        ((-1, 1), 40.0, [4]),
        ((1, -1), 34.0, [3, 3]),
        ((1, 1), 40.0, [3, 3]),  # on one side: two junctions of their own
        ((1, 0), 40.0, [4, 3]),  # 0: on both sides, a crossing
    ],
)
def test_side_roads_35_m_apart_on_either_side_are_one_junction_if_asked_for(
    sides, staggered_m, n_arms, tmp_path
):
    osm = OsmText()
    nodes = [osm.node(east, 0.0) for east in (0.0, 35.0)]
    osm.road([(-90.0, 0.0), *nodes, (150.0, 0.0)], name="Main Street")
    for node, east, side in zip(nodes, (0.0, 35.0), sides, strict=True):
        for way in (side,) if side else (1, -1):
            osm.road([node, (east, 90.0 * way)], name=f"Lane {node}")
    path = osm.write(tmp_path, "staggered.osm")
    source = read_map(path, ReadingOptions(staggered_m=staggered_m))
    found = [len(one.arms) for one in survey_junctions(source)]
    assert sorted(found, reverse=True) == n_arms


def test_driving_side_tag_goes_before_everything(tmp_path):
    osm = OsmText()
    osm.road([(-50.0, 0.0), (50.0, 0.0)], driving_side="left")
    assert read(osm, tmp_path).keeps_left
    assert not read(osm, tmp_path, keeps_left=False).keeps_left


def test_an_assumed_driving_side_is_told(tmp_path):
    osm = OsmText()
    osm.road([(-50.0, 0.0), (50.0, 0.0)])
    (skipped,) = read(osm, tmp_path).skipped
    assert skipped.what == "side of the road"
    assert "right-hand traffic" in skipped.why
    assert not read(osm, tmp_path, keeps_left=False).skipped


def test_yards_make_no_junction_unless_signals_stand_there(tmp_path):
    for tags, n_junctions in (({}, 0), (tags_of("highway=traffic_signals"), 1)):
        osm = OsmText()
        middle = osm.node(0.0, 0.0, **tags)
        osm.road([(-80.0, 0.0), middle, (80.0, 0.0)])
        osm.road([middle, (0.0, 80.0)], highway="service")
        source = read(osm, tmp_path)
        assert len(source.junctions) == n_junctions
        if not n_junctions:  # the road goes on as if nothing were there
            lengths = sorted(np.ptp(lane.centreline_m[:, 0]) for lane in source.lanes)
            assert lengths[-2:] == pytest.approx([160.0, 160.0], abs=0.1)


def test_roads_that_only_cross_do_not_meet(tmp_path):
    osm = OsmText()
    osm.road([(-80.0, 0.0), (80.0, 0.0)])
    osm.road([(0.0, -80.0), (0.0, 80.0)], bridge="yes", layer="1")
    source = read(osm, tmp_path)
    assert not source.junctions
    heights = sorted({float(lane.centreline_m[:, 2].max()) for lane in source.lanes})
    assert heights == [0.0, 5.0]


def test_roads_that_meet_on_a_bridge_are_no_junction_on_the_ground(tmp_path):
    osm = OsmText()
    crossing(osm, bearings=FOUR, bridge="yes", layer="1")
    assert not read(osm, tmp_path).junctions


def test_a_street_is_followed_over_nodes_where_only_tags_change(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    bend = osm.node(60.0, 0.0)
    osm.road([middle, bend], width="6", parking__right="street_side")
    osm.road([(140.0, 0.0), bend], width="8")  # mapped the other way round
    osm.road([(-80.0, 0.0), middle, (0.0, 80.0)])
    source = read(osm, tmp_path)
    east = [lane for lane in source.lanes if lane.centreline_m[:, 0].max() > 130.0]
    assert sorted(lane.kind for lane in east) == ["driving", "driving"]
    for lane in east:
        assert 3.0 < lane.width_m < 4.0
        along = np.abs(np.interp([30.0, 120.0], *_rising(lane)))
        assert_allclose(along, [1.5, 2.0], atol=0.03)


def _rising(lane: MapLane) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(lane.centreline_m[:, 0])
    return lane.centreline_m[order, 0], lane.centreline_m[order, 1]


def test_turning_lanes_begin_where_the_lane_before_them_ends(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    widens = osm.node(-50.0, 0.0)
    osm.road([(-150.0, 0.0), widens], width="6")
    osm.road(
        [widens, middle], turn__lanes__forward="left|through", lanes="3", width="9"
    )
    osm.road([middle, (100.0, 0.0)])
    osm.road([(0.0, 100.0), middle, (0.0, -100.0)])
    source = read(osm, tmp_path)
    (junction,) = source.junctions
    west = arms_of(replace(source, lanes=tuple(_with_rest(source))), junction).arms[
        "west"
    ]
    assert [len(west.entry_lanes), len(west.exit_lanes)] == [2, 1]
    for lane in west.entry_lanes:
        assert lane.centreline_m[0, 0] == pytest.approx(-150.0, abs=0.1)


def _with_rest(source: SourceMap) -> list[MapLane]:
    (junction,) = source.junctions
    return [
        (
            lane
            if lane.from_junction or lane.to_junction
            else replace(lane, to_junction=junction.id)
        )
        for lane in source.lanes
    ]


def test_carriageways_lead_on_into_the_road_they_become(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    fork = osm.node(60.0, 0.0)
    osm.road([middle, fork], name="A", width="7")
    osm.road([fork, (80.0, -6.0), (160.0, -6.0)], name="A", oneway="yes")
    osm.road([(160.0, 6.0), (80.0, 6.0), fork], name="A", oneway="yes")
    osm.road([(-80.0, 0.0), middle, (0.0, 80.0)])
    source = read(osm, tmp_path)
    assert len(source.junctions) == 1  # a fork is none
    driving = [lane.centreline_m[:, :2] for lane in source.lanes]
    west_bound = next(line for line in driving if line[0, 0] > 150.0)
    gaps = [np.hypot(*(line[0] - west_bound[-1])) for line in driving]
    assert min(gaps) < 0.01


def test_where_one_lane_becomes_three_at_a_fork_all_stay_on_their_side(tmp_path):
    osm = OsmText()
    south = osm.node(0.0, -7.0)
    north = osm.node(0.0, 7.0)
    fork = osm.node(-60.0, 0.0)
    tags = tags_of("highway=primary; name=A")
    osm.way([(-160.0, 0.0), fork], tags | tags_of("lanes=2"))
    osm.way([fork, (-45.0, -7.0), south], tags | tags_of("oneway=yes; lanes=3"))
    osm.way([north, (-45.0, 7.0), fork], tags | tags_of("oneway=yes; lanes=2"))
    osm.road([(0.0, -80.0), south, north, (0.0, 80.0)])
    source = read(osm, tmp_path, keeps_left=False)
    scene = scene_of(source, source.junctions[0], source.lanes)
    assert not list(lanes_that_cross(scene))
    (one,) = (lane for lane in scene.lanes if lane.centreline_m[0, 0] < -150.0)
    assert one.centreline_m[-1, 1] < -1.0  # to the right of the axis
    begins = [
        np.hypot(*(lane.centreline_m[0] - one.centreline_m[-1])) for lane in scene.lanes
    ]
    assert sum(gap_m < 0.01 for gap_m in begins) == 3


@pytest.mark.parametrize("keeps_left", [False, True])
def test_turn_lanes_are_those_of_the_lanes_from_the_left(keeps_left, tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    marked = {
        "turn__lanes__forward": "left;slight_left|none|through;right",
        "lanes": "4",
    }
    osm.road([(-100.0, 0.0), middle], lanes__forward="3", **marked)
    other = {"turn__lanes__forward": "left|through|right|", "lanes": "3"}
    osm.road([(0.0, 100.0), middle], lanes__forward="2", **other)
    osm.road([middle, (100.0, 0.0)], oneway="-1", turn__lanes="reverse|odd", lanes="2")
    source = read(osm, tmp_path, keeps_left=keeps_left)
    arms = arms_of(source, source.junctions[0]).arms
    left_first = {
        name: [
            lane.turns for lane in arms[name].entry_lanes[:: 1 if keeps_left else -1]
        ]
        for name in ("west", "north", "east")
    }
    assert left_first == {
        "west": [("left", "through"), (), ("through", "right")],
        "north": [(), ()],  # four markings for two lanes
        "east": [("reverse",), ()],
    }
    assert any(
        "turn:lanes has another number" in skipped.why for skipped in source.skipped
    )


def test_two_meetings_too_near_to_be_two_but_too_far_to_be_one_share_the_road(tmp_path):
    osm = OsmText()
    nodes = [osm.node(26.0 * index, 0.0) for index in range(4)]
    osm.road([(-90.0, 0.0), *nodes, (180.0, 0.0)], width="14", lanes="4")
    for index, node in enumerate(nodes):
        osm.road([node, (26.0 * index, 90.0)], width="14", lanes="4")
    source = read(osm, tmp_path)
    assert len(source.junctions) == 4
    check_ends(source)
    for junction in source.junctions:
        assert len(arms_of(source, junction).arms) == 3


def test_a_road_that_only_bends_back_is_no_junction(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    osm.road([(-80.0, 0.0), middle])
    osm.road([middle, (80.0, 3.0)])
    osm.road([middle, (80.0, -3.0)])
    source = read(osm, tmp_path)
    assert not source.junctions
    assert any("fewer than three arms" in skipped.why for skipped in source.skipped)


def test_nodes_that_the_file_does_not_have_cut_roads_short(tmp_path):
    osm = OsmText()
    osm.road([osm.node(0.0, 0.0), osm.node(50.0, 0.0), 999, osm.node(90.0, 0.0)])
    source = read(osm, tmp_path)
    assert np.ptp(source.lanes[0].centreline_m[:, 0]) == pytest.approx(50.0, abs=0.05)
    assert any("nodes are missing" in skipped.why for skipped in source.skipped)


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
        # The road leads away from the junction: cars come against it.
        ("maxspeed:forward=50; maxspeed:backward=30", 30.0),
        ("maxspeed=60; maxspeed:backward=40", 40.0),
        ("maxspeed:forward=50", None),
        ("oneway=-1; maxspeed:backward=30", 30.0),
    ],
)
def test_an_arm_has_the_speed_limit_of_those_who_come(tags, limit_kmh, tmp_path):
    osm = OsmText()
    middle = crossing(osm, bearings=FOUR[1:])
    osm.road([middle, (90.0, 0.0)], **tags_of(tags))
    source = read(osm, tmp_path)
    arms = arms_of(source, source.junctions[0]).arms
    assert {name: arm.speed_limit_kmh for name, arm in arms.items()} == {
        "east": limit_kmh,
        "north": None,
        "west": None,
        "south": None,
    }


def test_the_speed_limit_next_to_the_junction_counts(tmp_path):
    osm = OsmText()
    middle = crossing(osm, bearings=FOUR[1:])
    change = osm.node(60.0, 0.0)
    osm.road([middle, change], maxspeed="30")
    osm.road([change, (200.0, 0.0)], maxspeed="70")
    source = read(osm, tmp_path)
    assert arms_of(source, source.junctions[0]).arms["east"].speed_limit_kmh == 30.0


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
    osm = OsmText()
    middle = osm.node(0.0, 0.0, **tags_of(node))
    for begin, end in (
        ((-150.0, 0.0), middle),
        ((-100.0, -90.0), middle),
        (middle, (150.0, 0.0)),
        (middle, (90.0, 120.0)),
    ):
        osm.road([begin, end], oneway="yes", **tags_of(tags))
    source = read(osm, tmp_path)
    assert bool(source.junctions) == is_junction
    told = [note.why for note in source.skipped]
    assert ("motorways merge or part where nobody walks" in told) == (not is_junction)


PARTS = [((-90.0, 0.0), None), (None, (60.0, 80.0)), (None, (60.0, -80.0))]
CROSSES = [
    ((-90.0, 0.0), None),
    (None, (90.0, 0.0)),
    (None, (0.0, 90.0)),
    ((0.0, -90.0), None),
]


@pytest.mark.parametrize(
    ("kind", "roads", "is_junction"),
    [("trunk", PARTS, False), ("trunk", CROSSES, True), ("primary", PARTS, True)],
)
def test_trunk_roads_merge_only_where_no_ways_cross(kind, roads, is_junction, tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    for begin, end in roads:
        osm.road([begin or middle, end or middle], highway=kind, oneway="yes")
    assert bool(read(osm, tmp_path).junctions) == is_junction
