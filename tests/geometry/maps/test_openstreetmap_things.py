"""Buildings, walls, trees, poles and crosswalks, from small hand-made files."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from osm_tags import tags_of
from osm_text import OsmText, as_drawn

from geometry.maps.openstreetmap import read_openstreetmap
from geometry.maps.source_map import SourceMap, Thing

SQUARE = [(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0), (10.0, 10.0)]
INNER = [(13.0, 13.0), (17.0, 13.0), (17.0, 17.0), (13.0, 17.0), (13.0, 13.0)]


def read(osm: OsmText, folder: Path, **options: bool) -> SourceMap:
    options = {"keeps_left": False} | options
    return as_drawn(read_openstreetmap(osm.write(folder), **options))


def with_road() -> OsmText:
    osm = OsmText()
    osm.road([(-50.0, 0.0), (50.0, 0.0)], width="6")
    return osm


def volume_m3(thing: Thing) -> float:
    """Of a closed mesh whose triangles run counter-clockwise seen from outside."""
    a, b, c = np.swapaxes(
        (thing.vertices_m - thing.vertices_m.mean(axis=0))[thing.triangles], 0, 1
    )
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0


def is_closed(thing: Thing) -> bool:
    """Every edge is passed once in each direction."""
    points, index = np.unique(thing.vertices_m.round(6), axis=0, return_inverse=True)
    corners = index.reshape(-1)[thing.triangles]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    codes = edges @ [len(points), 1]
    back = edges @ [1, len(points)]
    return bool((np.sort(codes) == np.sort(back)).all())


def heights_m(thing: Thing) -> tuple[float, float]:
    low = thing.vertices_m[:, 2].min()
    high = thing.vertices_m[:, 2].max()
    return round(float(low), 3), round(float(high), 3)


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
    osm = with_road()
    way = osm.way(SQUARE, tags_of("building=yes", tags))
    (thing,) = read(osm, tmp_path).things
    assert thing.id == f"w{way}"
    assert thing.class_name == "building"
    assert heights_m(thing) == heights
    assert thing.is_height_assumed == is_assumed
    assert volume_m3(thing) == pytest.approx(
        100.0 * (heights[1] - heights[0]), rel=0.01
    )
    assert is_closed(thing)


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
    osm = with_road()
    way = osm.way(SQUARE, tags_of("building=yes", tags))
    source = read(osm, tmp_path)
    assert not source.things
    (skipped,) = source.skipped
    assert skipped.what == f"way {way}"
    assert why in skipped.why


@pytest.mark.parametrize(
    ("house", "way", "heights"),
    [
        ("", "highway=residential; width=6; tunnel=building_passage", (4.5, 12.0)),
        ("", "highway=service; width=6; covered=yes; maxheight=3", (3, 12.0)),
        ("", "highway=footway; covered=arcade", (2.5, 12.0)),
        ("historic=city_gate", "highway=residential; width=6", (4.5, 12.0)),
        ("building=gate", "highway=residential; width=6", (4.5, 12.0)),
        ("", "highway=residential; width=6", None),  # the map is wrong: no way through
        ("", "highway=residential; bridge=yes", None),
    ],
)
def test_a_building_begins_above_the_ways_that_lead_through_it(
    house, way, heights, tmp_path
):
    osm = with_road()
    osm.way(SQUARE, tags_of("building=yes; height=12", house))
    osm.way([(0.0, 15.0), (30.0, 15.0)], tags_of(way))
    things = read(osm, tmp_path).things
    over = [thing for thing in things if "over a passage" in thing.id]
    assert [heights_m(thing) for thing in over] == (
        [] if heights is None else [heights]
    )
    on_ground = [thing for thing in things if thing not in over]
    assert [heights_m(thing) for thing in on_ground] == [(0.0, 12.0)] * (
        1 if heights is None else 2
    )
    volume = sum(volume_m3(thing) for thing in things)
    if heights is None:
        assert volume == pytest.approx(1200.0, rel=0.01)
    else:
        if tags_of(way)["highway"] == "footway":
            width_m = 3.0
        else:
            width_m = 6.0
        assert volume == pytest.approx(1200.0 - 10.0 * width_m * heights[0], rel=0.01)


@pytest.mark.parametrize("height", ["tall", "5000", ""])
def test_a_height_that_makes_no_sense_is_told(height, tmp_path):
    osm = with_road()
    osm.way(SQUARE, {"building": "yes", "height": height})
    source = read(osm, tmp_path)
    assert [heights_m(thing) for thing in source.things] == [(0.0, 9.0)]
    assert "height makes no sense" in source.skipped[0].why


def test_a_courtyard_stays_open(tmp_path):
    osm = with_road()
    # The outer ring in two parts, drawn in different directions.
    corners = [osm.node(*point) for point in SQUARE[:4]]
    outer = [osm.way(corners[:3]), osm.way([corners[0], corners[3], corners[2]])]
    inner = osm.way(INNER)
    relation = osm.relation(
        [(outer[0], "outer"), (inner, "inner"), (outer[1], "outer")],
        tags_of("type=multipolygon; building=yes; height=10"),
    )
    (thing,) = read(osm, tmp_path).things
    assert thing.id == f"r{relation}"
    assert volume_m3(thing) == pytest.approx(840.0, rel=0.01)
    assert is_closed(thing)


def test_a_courtyard_of_the_old_kind_stays_open_too(tmp_path):
    osm = with_road()
    outer = osm.way(SQUARE, tags_of("building=yes; height=10"))
    osm.relation(
        [(outer, "outer"), (osm.way(INNER), "inner")], tags_of("type=multipolygon")
    )
    (thing,) = read(osm, tmp_path).things
    assert volume_m3(thing) == pytest.approx(840.0, rel=0.01)


def test_parts_stand_for_their_building(tmp_path):
    osm = with_road()
    osm.way(SQUARE, tags_of("building=yes; height=30"))
    for x, height in ((10.0, "8"), (15.0, "20")):
        ring = [(x, 10.0), (x + 5.0, 10.0), (x + 5.0, 20.0), (x, 20.0), (x, 10.0)]
        osm.way(ring, {"building:part": "yes", "height": height})
    things = read(osm, tmp_path).things
    assert sorted(heights_m(thing) for thing in things) == [(0.0, 8.0), (0.0, 20.0)]


def test_what_few_parts_leave_of_a_building_stands(tmp_path):
    osm = with_road()
    osm.way(SQUARE, tags_of("building=yes; height=10"))
    osm.way(INNER, tags_of("building:part=yes; height=25"))
    things = read(osm, tmp_path).things
    assert sorted(heights_m(thing) for thing in things) == [(0.0, 10.0), (0.0, 25.0)]
    assert sum(volume_m3(thing) for thing in things) == pytest.approx(
        840.0 + 400.0, rel=0.01
    )


def test_an_outline_that_crosses_itself_is_mended_and_one_without_area_told(tmp_path):
    osm = with_road()
    bow = [(10.0, 10.0), (20.0, 20.0), (20.0, 10.0), (10.0, 20.0), (10.0, 10.0)]
    osm.way(bow, tags_of("building=yes; height=10"))
    flat = osm.way(
        [(30.0, 10.0), (40.0, 10.0), (35.0, 10.0), (30.0, 10.0)],
        tags_of("building=yes"),
    )
    missing = osm.way(
        [osm.node(50.0, 10.0), 999, osm.node(60.0, 10.0)], tags_of("building=yes")
    )
    source = read(osm, tmp_path)
    (thing,) = source.things
    assert volume_m3(thing) == pytest.approx(500.0, rel=0.01)
    assert {skipped.what for skipped in source.skipped} == {
        f"way {flat}",
        f"way {missing}",
    }


# ---------------------------------------------------------------- walls and trees


def test_walls_are_as_high_and_thick_as_the_map_says(tmp_path):
    osm = with_road()
    line = [(10.0, 10.0), (30.0, 10.0)]
    osm.way(line, tags_of("barrier=wall; height=3; thickness=0.5"))
    osm.way([(10.0, 20.0), (30.0, 20.0)], tags_of("barrier=hedge"))
    osm.way([(10.0, 30.0), (30.0, 30.0)], tags_of("barrier=fence; fence_type=wood"))
    fence = osm.way([(10.0, 40.0), (30.0, 40.0)], tags_of("barrier=fence"))
    osm.way([(10.0, 50.0), (30.0, 50.0)], tags_of("barrier=kerb"))
    source = read(osm, tmp_path)
    wall, hedge, boards = source.things
    assert [thing.class_name for thing in source.things] == [
        "wall",
        "vegetation",
        "wall",
    ]
    assert volume_m3(wall) == pytest.approx(20.0 * 3.0 * 0.5, rel=0.01)
    assert volume_m3(hedge) == pytest.approx(20.0 * 1.5 * 0.8, rel=0.01)
    assert [wall.is_height_assumed, hedge.is_height_assumed] == [False, True]
    assert heights_m(boards) == (0.0, 1.8)
    assert all(is_closed(thing) for thing in source.things)
    (skipped,) = source.skipped
    assert skipped.what == f"way {fence}"


def test_a_wall_around_a_yard_leaves_the_yard_open(tmp_path):
    osm = with_road()
    osm.way(SQUARE, tags_of("barrier=wall; height=2; thickness=0.2"))
    (wall,) = read(osm, tmp_path).things
    # 10.2 m outside, 9.8 m inside, but for the corner where the line begins and ends.
    assert volume_m3(wall) == pytest.approx(2.0 * (10.2**2 - 9.8**2), rel=0.01)


def test_a_tree_has_a_trunk_and_a_crown(tmp_path):
    osm = with_road()
    node = osm.node(
        10.0, 10.0, natural="tree", height="8", diameter_crown="4", circumference="1"
    )
    (tree,) = read(osm, tmp_path).things
    assert tree.id == f"n{node}"
    assert tree.class_name == "vegetation"
    assert not tree.is_height_assumed
    assert heights_m(tree) == (0.0, 8.0)
    assert np.ptp(tree.vertices_m[:, :2], axis=0).max() == pytest.approx(4.0, abs=0.3)
    trunk = tree.vertices_m[tree.vertices_m[:, 2] < 1.0]
    assert np.hypot(*(trunk[:, :2] - [10.0, 10.0]).T).max() == pytest.approx(
        0.5 / math.pi, abs=0.02
    )
    crown = tree.vertices_m[tree.vertices_m[:, 2] > 2.4]
    assert crown[:, 2].min() == pytest.approx(2.5, abs=0.2)
    assert is_closed(tree)
    assert volume_m3(tree) > 0.0


def test_trees_stand_along_a_row_and_woods_are_told(tmp_path):
    osm = with_road()
    osm.way([(10.0, 10.0), (42.0, 10.0)], tags_of("natural=tree_row"))
    wood = osm.way([(x, y + 50.0) for x, y in SQUARE], tags_of("natural=wood"))
    source = read(osm, tmp_path)
    feet = sorted(thing.vertices_m[:, 0].mean() for thing in source.things)
    assert_allclose(feet, [10.0, 18.0, 26.0, 34.0, 42.0], atol=0.05)
    assert all(thing.is_height_assumed for thing in source.things)
    (skipped,) = source.skipped
    assert skipped.what == f"way {wood}"


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
    osm = OsmText()
    osm.road([(0.0, -80.0), (0.0, 80.0)], width="6")
    osm.road([(200.0, -10.0), (200.0, -80.0)], width="6")  # the one below no bridge
    osm.way([(-50.0, 0.0), (250.0, 0.0)], tags_of("bridge=yes", tags))
    things = read(osm, tmp_path).things
    assert len(things) == (deck is not None)
    if deck is not None:
        width_m, bottom_m = deck
        assert heights_m(things[0]) == (bottom_m, bottom_m + 1.0)
        assert volume_m3(things[0]) == pytest.approx(300.0 * width_m, rel=0.01)
        assert is_closed(things[0])


def test_a_bridge_over_water_is_no_thing_and_one_with_a_junction_near_is_told(tmp_path):
    osm = OsmText()
    bridge = tags_of("bridge=yes; highway=primary")
    osm.way([(0.0, 0.0), (100.0, 0.0)], bridge)
    assert not read(osm, tmp_path).things
    for end_m, n_decks in ((130.0, 0), (300.0, 1)):
        far = OsmText()
        far.road([(50.0, -80.0), (50.0, 80.0)])
        begin = far.node(100.0, 0.0)
        middle = far.node(end_m, 0.0)
        far.way([far.node(0.0, 0.0), begin], bridge)
        far.road([begin, middle, (end_m + 90.0, 0.0)], highway="primary")
        far.road([middle, (end_m, 90.0)])
        source = read(far, tmp_path)
        assert len(source.junctions) == 1
        assert len(source.things) == n_decks
        assert any("deck is left out" in note.why for note in source.skipped) == (
            not n_decks
        )


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
    osm = with_road()
    node = osm.node(10.0, 6.0, **tags_of(tags))
    (pole,) = read(osm, tmp_path).poles
    assert pole.id == f"n{node}"
    assert pole.kind == kind
    assert pole.height_m == height_m
    assert_allclose(pole.position_m, [10.0, 6.0, 0.0], atol=0.02)


def test_lamps_without_a_pole_are_told(tmp_path):
    osm = with_road()
    node = osm.node(10.0, 6.0, highway="street_lamp", support="wall")
    osm.node(20.0, 6.0, man_made="surveillance", camera__mount="wall")
    source = read(osm, tmp_path)
    assert not source.poles
    assert [skipped.what for skipped in source.skipped] == [f"node {node}"]


@pytest.mark.parametrize(
    ("tags", "keeps_left", "north_m"),
    [
        (
            "",
            False,
            [-3.5],
        ),  # cars come from the west: their right kerb is in the south
        ("", True, [3.5]),
        ("traffic_signals:direction=forward", False, [-3.5]),
        ("traffic_signals:direction=backward", False, [3.5]),
        ("traffic_signals:direction=both", False, [-3.5, 3.5]),
    ],
)
def test_a_signal_on_the_road_stands_at_the_kerb_beside_its_stop_line(
    tags, keeps_left, north_m, tmp_path
):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    signal = osm.node(-15.0, 0.0, highway="traffic_signals", **tags_of(tags))
    osm.road([(-80.0, 0.0), signal, middle, (80.0, 0.0)], width="6")
    osm.road([(0.0, -80.0), middle, (0.0, 80.0)], width="6")
    poles = read(osm, tmp_path, keeps_left=keeps_left).poles
    assert {pole.kind for pole in poles} == {"traffic light"}
    feet = sorted(pole.position_m.tolist() for pole in poles)
    assert_allclose(feet, [[-15.0, north, 0.0] for north in north_m], atol=0.05)


def test_signals_where_roads_meet_stand_at_every_arm_by_which_cars_come(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0, highway="traffic_signals")
    osm.road([(-80.0, 0.0), middle, (80.0, 0.0)], width="6")
    osm.road([middle, (0.0, 80.0)], width="6", oneway="yes")  # away only
    poles = read(osm, tmp_path).poles
    feet = sorted(pole.position_m[:2].round(1).tolist() for pole in poles)
    assert_allclose(feet, [[-8.0, -3.5], [8.0, 3.5]], atol=0.6)
    assert len({pole.id for pole in poles}) == 2


def test_crosswalks_lead_over_the_road_and_two_metres_farther(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    crossings = [osm.node(x, 0.0, highway="crossing") for x in (-20.0, -10.0)]
    osm.road([(-80.0, 0.0), *crossings, middle, (80.0, 0.0)], width="6")
    osm.road([(0.0, -80.0), middle, (0.0, 80.0)])
    osm.node(30.0, 30.0, highway="crossing")  # on no road
    # The second one is mapped as a footway too, askew; it is the better line.
    osm.way(
        [osm.node(-11.0, -4.0), crossings[1], osm.node(-9.0, 4.0)],
        tags_of("highway=footway; footway=crossing"),
    )
    osm.way(
        [(40.0, 10.0), (40.0, 20.0)], tags_of("highway=footway; footway=crossing")
    )  # over no road
    lines = read(osm, tmp_path).crosswalks_m
    found = sorted(sorted(line.round(1).tolist()) for line in lines)
    assert_allclose(
        found,
        [[[-20.0, -5.0], [-20.0, 5.0]], [[-11.25, -4.9], [-8.75, 4.9]]],
        atol=0.11,
    )


def test_a_footway_over_two_arms_is_a_crosswalk_over_each(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    osm.road([(-80.0, 0.0), middle, (80.0, 0.0)], width="6")
    osm.road([(0.0, -80.0), middle, (0.0, 80.0)], width="6")
    corner = [
        (10.0, -9.0),
        (10.0, 10.0),
        (-9.0, 10.0),
    ]  # over the eastern and the northern arm
    osm.way(corner, tags_of("highway=footway; footway=crossing"))
    lines = read(osm, tmp_path).crosswalks_m
    found = sorted(np.sort(line, axis=0).round(1).tolist() for line in lines)
    assert_allclose(
        found, [[[-5.0, 10.0], [5.0, 10.0]], [[10.0, -5.0], [10.0, 5.0]]], atol=0.11
    )


def test_two_carriageways_crossed_straight_are_one_crosswalk(tmp_path):
    osm = OsmText()
    for y, along in ((-6.0, 1.0), (6.0, -1.0)):
        osm.road([(-80.0 * along, y), (80.0 * along, y)], width="6", oneway="yes")
    osm.way([(0.0, -15.0), (0.0, 15.0)], tags_of("highway=footway; footway=crossing"))
    # Each half of this one is mapped by itself, to the middle of its carriageway.
    for end in (1.0, 11.0):
        osm.way(
            [(20.0, end), (20.0, 6.0)], tags_of("highway=footway; footway=crossing")
        )
    lines = read(osm, tmp_path).crosswalks_m
    found = sorted(np.sort(line, axis=0).round(1).tolist() for line in lines)
    assert_allclose(
        found, [[[0.0, -11.0], [0.0, 11.0]], [[20.0, 1.0], [20.0, 11.0]]], atol=0.11
    )


def test_a_footway_over_a_bridge_crosses_no_road_below_it(tmp_path):
    osm = OsmText()
    osm.road([(-80.0, 0.0), (80.0, 0.0)], width="6")
    way = tags_of("highway=footway; footway=crossing; bridge=yes; layer=1")
    osm.way([(0.0, -15.0), (0.0, 15.0)], way)
    assert not len(read(osm, tmp_path).crosswalks_m)


def test_crosswalks_nearer_than_three_metres_are_one(tmp_path):
    osm = OsmText()
    crossings = [osm.node(x, 0.0, highway="crossing") for x in (0.0, 2.0, 6.0)]
    osm.road([(-80.0, 0.0), *crossings, (80.0, 0.0)], width="6")
    lines = read(osm, tmp_path).crosswalks_m
    assert_allclose(np.sort(lines[:, 0, 0]), [0.0, 6.0], atol=0.05)
