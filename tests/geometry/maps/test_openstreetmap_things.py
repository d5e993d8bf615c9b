"""Buildings, walls, trees, poles and crosswalks, from small hand-made files."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from osm_drawing import drawn, read_drawing

from geometry.maps import source_map
from geometry.maps.source_map import is_closed

SQUARE = "10 10, 20 10, 20 20, 10 20, 10 10"
INNER = "13 13, 17 13, 17 17, 13 17, 13 13"
ROAD = "road -50 0, 50 0: width=6"
ACROSS = """
    road -80 0, 0 0, 80 0: width=6
    road 0 -80, 0 0, 0 80: width=6
"""
CROSSING = "highway=footway; footway=crossing"


def read(osm, folder, *, keeps_left=False):
    """The map of a drawing."""
    return read_drawing(osm, folder, keeps_left=keeps_left)


def beside_road(text):
    """A drawing of what lies beside a road of 100 m that leads east."""
    return drawn(ROAD).draw(text)


def volume_m3(thing):
    """Volume of a thing, less than 0 where its triangles look inwards."""
    return source_map.volume_m3(thing.vertices_m, thing.triangles)


def heights_m(thing):
    """Heights of a thing's lowest and its highest point."""
    heights = thing.vertices_m[:, 2]
    return round(float(heights.min()), 3), round(float(heights.max()), 3)


def straight_lines(lines_m):
    """West, south, east and north of lines that lead straight east or north; sorted."""
    lines = [np.sort(line, axis=0).round(1).reshape(4) for line in lines_m]
    return sorted(line.tolist() for line in lines)


# ---------------------------------------------------------------- buildings


@pytest.mark.parametrize(
    ("tags", "heights", "is_assumed"),
    [
        ("height=12", (0.0, 12.0), False),
        ("height=12,5 m; building:levels=9", (0.0, 12.5), False),
        ("building:levels=4", (0.0, 12.0), False),
        ("building:levels=4; roof:levels=1", (0.0, 15.0), False),
        ("building:levels=4; roof:height=2", (0.0, 14.0), False),
        ("building:levels=0; roof:levels=2", (0.0, 6.0), False),
        ("height=20; min_height=5", (5.0, 20.0), False),
        ("building:levels=6; building:min_level=2", (6.0, 18.0), False),
        ("", (0.0, 9.0), True),
        ("building=garage", (0.0, 2.5), True),
        ("min_height=10", (10.0, 13.0), True),
        ("building=roof; min_height=4; height=5", (4.0, 5.0), False),
        ("building=roof; height=6", (5.5, 6.0), True),
        ("building=roof", (4.5, 5.0), True),
        ("building=carport", (2.2, 2.7), True),
        ("layer=1", (4.5, 9.0), True),
        ("layer=1; height=12", (4.5, 12.0), True),
        ("layer=2; building:levels=4", (9.0, 12.0), True),
        ("layer=1; min_height=6; height=9", (6.0, 9.0), False),
    ],
)
def test_tags_say_how_high_a_building_is(tags, heights, is_assumed, tmp_path):
    osm = beside_road(f"way {SQUARE}: building=yes; {tags}")
    (thing,) = read(osm, tmp_path).things

    assert thing.id == f"w{osm.ids[-1]}"
    assert thing.class_name == "building"

    bottom_m, top_m = heights
    assert heights_m(thing) == (bottom_m, top_m)
    assert thing.is_height_assumed == is_assumed
    assert volume_m3(thing) == pytest.approx(100.0 * (top_m - bottom_m), rel=0.01)
    assert is_closed(thing.triangles)


@pytest.mark.parametrize(
    ("tags", "why"),
    [
        ("height=3; min_height=3", "not above its floor"),
        ("building=construction", "not built yet"),
        ("location=underground", "below the ground"),
        ("layer=-1", "below the ground"),
    ],
)
def test_what_does_not_stand_there_is_told(tags, why, tmp_path):
    osm = beside_road(f"way {SQUARE}: building=yes; {tags}")
    source = read(osm, tmp_path)

    assert not source.things

    (skipped,) = source.skipped
    assert skipped.what == f"way {osm.ids[-1]}"
    assert why in skipped.why


@pytest.mark.parametrize(
    ("house", "way", "width_m", "bottom_m"),
    [
        ("", "highway=residential; width=6; tunnel=building_passage", 6.0, 4.5),
        ("", "highway=service; width=6; covered=yes; maxheight=3", 6.0, 3.0),
        ("", "highway=footway; covered=arcade", 3.0, 2.5),
        ("historic=city_gate", "highway=residential; width=6", 6.0, 4.5),
        ("building=gate", "highway=residential; width=6", 6.0, 4.5),
    ],
)
def test_a_building_begins_above_the_ways_that_lead_through_it(
    house, way, width_m, bottom_m, tmp_path
):
    osm = beside_road(f"""
        way {SQUARE}: building=yes; height=12; {house}
        way 0 15, 30 15: {way}
    """)
    things = read(osm, tmp_path).things
    (over,) = (thing for thing in things if "over a passage" in thing.id)

    assert heights_m(over) == (bottom_m, 12.0)

    on_ground = [heights_m(thing) for thing in things if thing is not over]
    assert on_ground == [(0.0, 12.0)] * 2

    volume = sum(volume_m3(thing) for thing in things)
    assert volume == pytest.approx(1200.0 - 10.0 * width_m * bottom_m, rel=0.01)


# The map is wrong, or the way leads over the house: there is no way through.
@pytest.mark.parametrize("way", ["width=6", "bridge=yes"])
def test_a_building_stays_whole_where_no_way_leads_through_it(way, tmp_path):
    osm = beside_road(f"""
        way {SQUARE}: building=yes; height=12
        road 0 15, 30 15: {way}
    """)
    things = read(osm, tmp_path).things
    house = things[0]

    assert len(things) == 1
    assert "over a passage" not in house.id
    assert heights_m(house) == (0.0, 12.0)
    assert volume_m3(house) == pytest.approx(1200.0, rel=0.01)


@pytest.mark.parametrize("height", ["tall", "5000", ""])
def test_a_height_that_makes_no_sense_is_told(height, tmp_path):
    osm = beside_road(f"way {SQUARE}: building=yes; height={height}")
    source = read(osm, tmp_path)

    assert [heights_m(thing) for thing in source.things] == [(0.0, 9.0)]
    assert "height makes no sense" in source.skipped[0].why


# The outer ring in two parts, drawn in different directions, with the tags at the
# relation; and, as maps had it once, at the one outer way.
@pytest.mark.parametrize(
    ("outer", "outer_tags", "tags"),
    [
        (
            ("10 10, 20 10, 20 20", "10 10, 10 20, 20 20"),
            "",
            {"building": "yes", "height": "10"},
        ),
        ((SQUARE,), "building=yes; height=10", {}),
    ],
)
def test_a_courtyard_stays_open(outer, outer_tags, tags, tmp_path):
    osm = drawn(ROAD)
    for ring in outer:
        osm.draw(f"way {ring}: {outer_tags}")

    osm.draw(f"way {INNER}")
    *outer_ids, inner_id = osm.ids[1:]
    members = [(inner_id, "inner")]
    members += [(way, "outer") for way in outer_ids]
    relation = osm.relation(members, {"type": "multipolygon"} | tags)
    (thing,) = read(osm, tmp_path).things

    if tags:
        assert thing.id == f"r{relation}"
    assert volume_m3(thing) == pytest.approx(840.0, rel=0.01)
    assert is_closed(thing.triangles)


def test_parts_stand_for_their_building(tmp_path):
    osm = beside_road(f"""
        way {SQUARE}: building=yes; height=30
        way 10 10, 15 10, 15 20, 10 20, 10 10: building:part=yes; height=8
        way 15 10, 20 10, 20 20, 15 20, 15 10: building:part=yes; height=20
    """)
    things = read(osm, tmp_path).things
    assert sorted(map(heights_m, things)) == [(0.0, 8.0), (0.0, 20.0)]


def test_what_few_parts_leave_of_a_building_stands(tmp_path):
    osm = beside_road(f"""
        way {SQUARE}: building=yes; height=10
        way {INNER}: building:part=yes; height=25
    """)
    things = read(osm, tmp_path).things

    assert sorted(map(heights_m, things)) == [(0.0, 10.0), (0.0, 25.0)]

    volume = sum(map(volume_m3, things))
    assert volume == pytest.approx(840.0 + 400.0, rel=0.01)


def test_an_outline_that_crosses_itself_is_mended_and_one_without_area_told(tmp_path):
    osm = beside_road("""
        way 10 10, 20 20, 20 10, 10 20, 10 10: building=yes; height=10
        way 30 10, 40 10, 35 10, 30 10: building=yes
    """)
    flat = osm.ids[-1]
    missing = osm.way([(50.0, 10.0), 999, (60.0, 10.0)], {"building": "yes"})
    source = read(osm, tmp_path)
    (thing,) = source.things

    assert volume_m3(thing) == pytest.approx(500.0, rel=0.01)

    told = {skipped.what for skipped in source.skipped}
    assert told == {f"way {flat}", f"way {missing}"}


# ---------------------------------------------------------------- walls and trees


def test_walls_are_as_high_and_thick_as_the_map_says(tmp_path):
    osm = beside_road("""
        way 10 10, 30 10: barrier=wall; height=3; thickness=0.5
        way 10 20, 30 20: barrier=hedge
        way 10 30, 30 30: barrier=fence; fence_type=wood
        way 10 40, 30 40: barrier=fence
        way 10 50, 30 50: barrier=kerb
    """)
    source = read(osm, tmp_path)
    wall, hedge, boards = source.things
    classes = [thing.class_name for thing in source.things]

    assert classes == ["wall", "vegetation", "wall"]
    assert volume_m3(wall) == pytest.approx(20.0 * 3.0 * 0.5, rel=0.01)
    assert volume_m3(hedge) == pytest.approx(20.0 * 1.5 * 0.8, rel=0.01)
    assert not wall.is_height_assumed
    assert hedge.is_height_assumed
    assert heights_m(boards) == (0.0, 1.8)
    assert all(is_closed(thing.triangles) for thing in source.things)

    (skipped,) = source.skipped
    assert skipped.what == f"way {osm.ids[4]}"  # the fence of no known kind


def test_a_wall_around_a_yard_leaves_the_yard_open(tmp_path):
    osm = beside_road(f"way {SQUARE}: barrier=wall; height=2; thickness=0.2")
    (wall,) = read(osm, tmp_path).things
    # 10.2 m outside, 9.8 m inside, but for the corner where the line begins and ends.
    assert volume_m3(wall) == pytest.approx(2.0 * (10.2**2 - 9.8**2), rel=0.01)


def test_a_tree_has_a_trunk_and_a_crown(tmp_path):
    tags = "natural=tree; height=8; diameter_crown=4; circumference=1"
    osm = beside_road(f"node 10 10: {tags}")
    (tree,) = read(osm, tmp_path).things

    assert tree.id == f"n{osm.ids[-1]}"
    assert tree.class_name == "vegetation"
    assert not tree.is_height_assumed
    assert heights_m(tree) == (0.0, 8.0)
    assert is_closed(tree.triangles)
    assert volume_m3(tree) > 0.0

    points = tree.vertices_m - [10.0, 10.0, 0.0]
    assert np.ptp(points[:, :2], axis=0).max() == pytest.approx(4.0, abs=0.3)

    trunk = points[points[:, 2] < 1.0]
    radius_m = np.hypot(trunk[:, 0], trunk[:, 1]).max()

    assert radius_m == pytest.approx(0.5 / math.pi, abs=0.02)

    crown = points[points[:, 2] > 2.4]
    assert crown[:, 2].min() == pytest.approx(2.5, abs=0.2)


def test_trees_stand_along_a_row_and_woods_are_told(tmp_path):
    osm = beside_road("""
        way 10 10, 42 10: natural=tree_row
        way 10 60, 20 60, 20 70, 10 70, 10 60: natural=wood
    """)
    source = read(osm, tmp_path)
    feet = sorted(thing.vertices_m[:, 0].mean() for thing in source.things)

    assert_allclose(feet, [10.0, 18.0, 26.0, 34.0, 42.0], atol=0.05)
    assert all(thing.is_height_assumed for thing in source.things)

    (skipped,) = source.skipped
    assert skipped.what == f"way {osm.ids[-1]}"


# ---------------------------------------------------------------- bridges


@pytest.mark.parametrize(
    ("tags", "deck"),
    [
        ("highway=primary; width=8", (8.0, 4.5)),
        ("highway=primary; width=8; layer=2", (8.0, 9.0)),
        ("highway=footway", (3.0, 4.5)),
        ("railway=rail", (5.0, 4.5)),
        ("railway=abandoned", None),
        ("highway=footway; layer=0; bridge=no", None),
    ],
)
def test_a_bridge_hides_and_is_passed_below(tags, deck, tmp_path):
    # The second road lies below no bridge.
    osm = drawn(f"""
        road 0 -80, 0 80: width=6
        road 200 -10, 200 -80: width=6
        way -50 0, 250 0: bridge=yes; {tags}
    """)
    things = read(osm, tmp_path).things

    assert len(things) == (deck is not None)
    if deck is not None:
        width_m, bottom_m = deck
        assert heights_m(things[0]) == (bottom_m, bottom_m + 1.0)
        assert volume_m3(things[0]) == pytest.approx(300.0 * width_m, rel=0.01)
        assert is_closed(things[0].triangles)


def test_a_bridge_over_water_is_no_thing(tmp_path):
    osm = drawn("way 0 0, 100 0: bridge=yes; highway=primary")
    assert not read(osm, tmp_path).things


@pytest.mark.parametrize(
    ("end_m", "n_decks"),
    [
        (130, 0),
        (300, 1),
    ],
)
def test_a_bridge_with_a_junction_near_is_told(end_m, n_decks, tmp_path):
    osm = drawn(f"""
        road 50 -80, 50 80
        way 0 0, 100 0: bridge=yes; highway=primary
        road 100 0, {end_m} 0, {end_m + 90} 0: highway=primary
        road {end_m} 0, {end_m} 90
    """)
    source = read(osm, tmp_path)

    assert len(source.junctions) == 1
    assert len(source.things) == n_decks

    is_told = any("deck is left out" in note.why for note in source.skipped)
    assert is_told == (not n_decks)


# ---------------------------------------------------------------- poles and crosswalks


@pytest.mark.parametrize(
    ("tags", "kind", "height_m"),
    [
        ("highway=street_lamp; height=9", "lamp post", 9.0),
        ("highway=street_lamp; height=high", "lamp post", None),
        ("highway=traffic_signals", "traffic light", None),
        ("highway=traffic_sign", "sign", None),
        ("traffic_sign=DE:306", "sign", None),
        ("man_made=utility_pole", "pole", None),
        ("man_made=mast; height=12", "pole", 12.0),
        ("man_made=surveillance; camera:mount=pole", "pole", None),
    ],
)
def test_poles_beside_the_road_stand_where_they_are(tags, kind, height_m, tmp_path):
    osm = beside_road(f"node 10 6: {tags}")
    (pole,) = read(osm, tmp_path).poles

    assert pole.id == f"n{osm.ids[-1]}"
    assert pole.kind == kind
    assert pole.height_m == height_m
    assert_allclose(pole.position_m, [10.0, 6.0, 0.0], atol=0.02)


def test_lamps_without_a_pole_are_told(tmp_path):
    osm = beside_road("""
        node 10 6: highway=street_lamp; support=wall
        node 20 6: man_made=surveillance; camera:mount=wall
    """)
    source = read(osm, tmp_path)

    assert not source.poles
    assert [skipped.what for skipped in source.skipped] == [f"node {osm.ids[1]}"]


@pytest.mark.parametrize(
    ("tags", "keeps_left", "north_m"),
    [
        ("", False, [-3.5]),
        ("", True, [3.5]),
        ("traffic_signals:direction=forward", False, [-3.5]),
        ("traffic_signals:direction=backward", False, [3.5]),
        ("traffic_signals:direction=both", False, [-3.5, 3.5]),
    ],
)
def test_a_signal_on_the_road_stands_at_the_kerb_beside_its_stop_line(
    tags, keeps_left, north_m, tmp_path
):
    osm = drawn(f"""
        node -15 0: highway=traffic_signals; {tags}
        road -80 0, -15 0, 0 0, 80 0: width=6
        road 0 -80, 0 0, 0 80: width=6
    """)
    poles = read(osm, tmp_path, keeps_left=keeps_left).poles

    assert {pole.kind for pole in poles} == {"traffic light"}

    feet = sorted(pole.position_m.tolist() for pole in poles)
    assert_allclose(feet, [[-15.0, north, 0.0] for north in north_m], atol=0.05)


def test_signals_where_roads_meet_stand_at_every_arm_by_which_cars_come(tmp_path):
    # On the second road cars only leave.
    osm = drawn("""
        node 0 0: highway=traffic_signals
        road -80 0, 0 0, 80 0: width=6
        road 0 0, 0 80: width=6; oneway=yes
    """)
    poles = read(osm, tmp_path).poles
    feet = sorted(pole.position_m[:2].round(1).tolist() for pole in poles)

    assert_allclose(feet, np.array([[-8.0, -3.5], [8.0, 3.5]]), atol=0.6)
    assert len({pole.id for pole in poles}) == 2


def test_crosswalks_lead_over_the_road_and_two_metres_farther(tmp_path):
    # The second one is mapped as a footway too, askew; it is the better line. The last
    # two lead over no road.
    osm = drawn(f"""
        node -20 0: highway=crossing
        node -10 0: highway=crossing
        road -80 0, -20 0, -10 0, 0 0, 80 0: width=6
        road 0 -80, 0 0, 0 80
        way -11 -4, -10 0, -9 4: {CROSSING}
        node 30 30: highway=crossing
        way 40 10, 40 20: {CROSSING}
    """)
    lines = read(osm, tmp_path).crosswalks_m
    ends = sorted(sorted(line.round(1).tolist()) for line in lines)
    found = np.reshape(ends, (-1, 4))
    wanted = np.array(
        [
            [-20.0, -5.0, -20.0, 5.0],
            [-11.25, -4.9, -8.75, 4.9],
        ]
    )

    assert_allclose(found, wanted, atol=0.11)


def test_a_footway_over_two_arms_is_a_crosswalk_over_each(tmp_path):
    # Over the eastern and the northern arm.
    osm = drawn(ACROSS).draw(f"way 10 -9, 10 10, -9 10: {CROSSING}")
    lines = read(osm, tmp_path).crosswalks_m
    wanted = np.array(
        [
            [-5.0, 10.0, 5.0, 10.0],
            [10.0, -5.0, 10.0, 5.0],
        ]
    )

    assert_allclose(straight_lines(lines), wanted, atol=0.11)


def test_two_carriageways_crossed_straight_are_one_crosswalk(tmp_path):
    # Each half of the second one is mapped by itself, to the middle of its carriageway.
    osm = drawn(f"""
        road -80 -6, 80 -6: width=6; oneway=yes
        road 80 6, -80 6: width=6; oneway=yes
        way 0 -15, 0 15: {CROSSING}
        way 20 1, 20 6: {CROSSING}
        way 20 11, 20 6: {CROSSING}
    """)
    lines = read(osm, tmp_path).crosswalks_m
    wanted = np.array(
        [
            [0.0, -11.0, 0.0, 11.0],
            [20.0, 1.0, 20.0, 11.0],
        ]
    )

    assert_allclose(straight_lines(lines), wanted, atol=0.11)


def test_a_footway_over_a_bridge_crosses_no_road_below_it(tmp_path):
    osm = drawn(f"""
        road -80 0, 80 0: width=6
        way 0 -15, 0 15: {CROSSING}; bridge=yes; layer=1
    """)
    assert not len(read(osm, tmp_path).crosswalks_m)


def test_crosswalks_nearer_than_three_metres_are_one(tmp_path):
    osm = drawn("""
        node 0 0: highway=crossing
        node 2 0: highway=crossing
        node 6 0: highway=crossing
        road -80 0, 0 0, 2 0, 6 0, 80 0: width=6
    """)
    lines = read(osm, tmp_path).crosswalks_m
    assert_allclose(np.sort(lines[:, 0, 0]), [0.0, 6.0], atol=0.05)
