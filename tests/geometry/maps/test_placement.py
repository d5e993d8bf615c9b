"""Roads whose way was drawn beside the middle of the carriageway (`placement`)."""

import numpy as np
import pytest
from osm_drawing import drawn, read_drawing

from geometry.maps.importing import ImportOptions, import_scene
from geometry.maps.openstreetmap.placement import carriageway_left_m

WIDTH_M = 3.25
ROAD = "highway=primary; name=Long Road"
TWO = "oneway=yes; lanes=2"
THREE = "oneway=yes; lanes=3"


def eastward(*parts, crossing_at=1):
    """A road of parts of 100 m from west to east, with a signal at one of its nodes.

    Parts are tags; the road crosses another one there, at (0, 0).
    """
    osm = drawn("node 0 0: highway=traffic_signals")
    for number, tags in enumerate(parts):
        west_m = 100 * (number - crossing_at)
        ends = [f"{west_m} 0", f"{west_m + 100} 0"]
        if "oneway=-1" in tags:
            ends = ends[::-1]
        osm.draw(f"way {', '.join(ends)}: {ROAD}; {tags}")
    return osm.draw("way 0 -150, 0 0, 0 150: highway=primary; name=Short Road; lanes=2")


def along(source):
    """Driving lanes of the road from west to east."""
    lanes = [lane for lane in source.lanes if lane.kind == "driving"]
    return [lane for lane in lanes if np.ptp(lane.centreline_m[:, 0]) > 20.0]


def lefts_at(source, east_m):
    """How far north of the way each lane's middle lies, from north to south. [m]"""
    found = []
    for lane in along(source):
        order = np.argsort(lane.centreline_m[:, 0])
        x, y, _ = lane.centreline_m[order].T
        if x[0] <= east_m <= x[-1]:
            found.append(float(np.interp(east_m, x, y)))
    return sorted(found, reverse=True)


def assert_lefts(source, east_m, *expected_m):
    """Lanes lie so far north of the way, from north to south."""
    assert lefts_at(source, east_m) == pytest.approx(expected_m, abs=0.01)


@pytest.mark.parametrize(
    ("value", "way_from_left"),
    [
        ("left_of:1", 0.0),
        ("middle_of:1", 0.5),
        ("right_of:1", 1.0),
        ("left_of:2", 1.0),
        ("middle_of:2", 1.5),
        ("right_of:2", 2.0),
    ],
)
def test_every_value_names_a_line_of_a_lane(tmp_path, value, way_from_left):
    osm = eastward(f"{TWO}; placement={value}", TWO)
    source = read_drawing(osm, tmp_path)
    first_m = (way_from_left - 0.5) * WIDTH_M

    assert_lefts(source, -50.0, first_m, first_m - WIDTH_M)
    # Without the tag the way is the middle.
    assert_lefts(source, 50.0, 1.625, -1.625)


def test_a_lane_that_opens_at_a_junction_leaves_the_others_where_they_are(tmp_path):
    osm = eastward(f"{TWO}; placement=middle_of:1", f"{THREE}; placement=middle_of:2")
    source = read_drawing(osm, tmp_path)

    assert_lefts(source, -50.0, 0.0, -WIDTH_M)
    assert_lefts(source, 50.0, WIDTH_M, 0.0, -WIDTH_M)


@pytest.mark.parametrize("key", ["placement:forward", "placement:backward"])
def test_the_line_between_the_directions(tmp_path, key):
    two_ways = "lanes=3; lanes:forward=2; lanes:backward=1"
    source = read_drawing(eastward(f"{two_ways}; {key}=left_of:1", two_ways), tmp_path)
    assert_lefts(source, -50.0, 0.5 * WIDTH_M, -0.5 * WIDTH_M, -1.5 * WIDTH_M)


def test_lanes_of_the_other_direction_are_counted_as_it_sees_them(tmp_path):
    osm = eastward("lanes=4; placement:backward=right_of:2", "lanes=4")
    source = read_drawing(osm, tmp_path)
    # The way is the northern kerb: the right edge of their second lane.
    expected_m = [-(number + 0.5) * WIDTH_M for number in range(4)]

    assert_lefts(source, -50.0, *expected_m)


def test_a_road_against_the_order_of_its_nodes(tmp_path):
    backward = "oneway=-1; lanes=2"
    osm = eastward(f"{backward}; placement=left_of:1", backward)

    # Drawn from east to west, driven from west to east.
    assert_lefts(read_drawing(osm, tmp_path), -50.0, -1.625, -4.875)

    # The start of the drawing is the eastern end.
    tips = "placement:start=right_of:2; placement:end=left_of:1"
    source = read_drawing(eastward(f"{backward}; {tips}", backward), tmp_path)

    assert lefts_at(source, -90.0)[0] < 0.0
    assert lefts_at(source, -15.0)[-1] > 0.0


TIPS = "placement:start=middle_of:1; placement:end=middle_of:2"


@pytest.mark.parametrize(
    "between", ["placement=transition", f"placement=transition; {TIPS}", TIPS]
)
def test_a_transition_leads_from_one_place_to_the_next(tmp_path, between):
    osm = eastward(
        f"{TWO}; placement=middle_of:1",
        f"{TWO}; {between}",
        f"{TWO}; placement=middle_of:2",
        TWO,
        crossing_at=3,
    )
    source = read_drawing(osm, tmp_path)

    assert_lefts(source, -250.0, 0.0, -WIDTH_M)
    assert_lefts(source, -150.0, 1.625, -1.625)
    assert_lefts(source, -175.0, 0.8125, -2.4375)
    assert_lefts(source, -50.0, WIDTH_M, 0.0)
    for lane in along(source):
        # No lane jumps aside.
        steps = np.abs(np.diff(lane.centreline_m[:, :2], axis=0))
        assert (steps[:, 1] < 0.3 * steps[:, 0] + 1e-6).all()


def test_a_transition_of_a_way_that_a_junction_cuts_goes_on_behind_it(tmp_path):
    osm = drawn(f"""
        node 0 0: highway=traffic_signals
        way -100 0, 0 0, 100 0: {ROAD}; width:lanes=3.25; {TWO}; {TIPS}
        way 0 -150, 0 0, 0 150: highway=primary
    """)
    source = read_drawing(osm, tmp_path)
    for east_m in (-80.0, -40.0, 40.0, 80.0):
        left_m = 0.5 * WIDTH_M * east_m / 100.0
        expected_m = [left_m + 1.625, left_m - 1.625]
        assert lefts_at(source, east_m) == pytest.approx(expected_m, abs=0.02)


@pytest.mark.parametrize(
    ("tags", "said"),
    [
        (f"{TWO}; placement=middle_of:3", "placement=middle_of:3 names no lane"),
        (f"{TWO}; placement=beside:1", "placement=beside:1 names no lane"),
        ("lanes=2; placement=left_of:1", "must be placement:forward or"),
    ],
)
def test_what_makes_no_sense_is_told(tmp_path, tags, said):
    source = read_drawing(eastward(tags, tags), tmp_path)
    assert_lefts(source, -50.0, 0.5 * WIDTH_M, -0.5 * WIDTH_M)
    assert any(said in str(skipped.why) for skipped in source.skipped)


def test_surface_and_crosswalk_lie_where_the_lanes_do(tmp_path):
    osm = eastward(f"{TWO}; placement=left_of:1", TWO)
    osm.draw("way -50 9, -50 -9: highway=footway; footway=crossing")
    source = read_drawing(osm, tmp_path)
    walks = [line for line in source.crosswalks_m if np.abs(line[:, 0] + 50).max() < 1]
    (walk,) = walks
    south, north = sorted(walk[:, 1])

    # As far beyond the kerb at 0 m as beyond that at -6.5 m.
    assert north > 0.0
    assert north == pytest.approx(-6.5 - south, abs=0.01)

    (junction,) = source.junctions
    west = junction.outline_m[junction.outline_m[:, 0] < -6.0]

    assert west[:, 1].mean() < -1.0


def test_poles_stand_beside_the_carriageway_and_not_on_it(tmp_path):
    tags = f"{THREE}; placement=left_of:1"
    path = eastward(tags, tags).write(tmp_path)
    scene = import_scene([path], ImportOptions(radius_m=80.0)).scene

    assert scene.sites
    for site in scene.sites:
        for lane in scene.lanes:
            away = np.linalg.norm(
                lane.centreline_m[:, :2] - site.position_m[:2], axis=-1
            )
            assert away.min() > 0.5 * lane.width_m


@pytest.mark.parametrize(
    ("tags", "told"),
    [
        (
            {"junction": "roundabout", "placement": "left_of:1"},
            ["placement is not followed on a roundabout"],
        ),
        ({"oneway": "yes"}, []),
    ],
)
def test_roundabouts_and_roads_without_the_tag_stay_in_the_middle(tags, told):
    said = []
    lanes = [("forward", 0, WIDTH_M)]
    road = {"highway": "primary"} | tags
    left_m = carriageway_left_m(road, lanes, 0.5 * WIDTH_M, said.append)

    assert left_m == (0.0, 0.0)
    assert said == told
