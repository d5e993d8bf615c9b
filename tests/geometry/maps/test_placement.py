"""Roads whose way was drawn beside the middle of the carriageway (`placement`)."""

from pathlib import Path

import numpy as np
import pytest

from geometry.maps.importing import ImportOptions, import_scene, read_map
from geometry.maps.openstreetmap.placement import carriageway_left_m
from geometry.maps.source_map import MapLane, SourceMap

from ...support.osm_text import OsmText, as_drawn

WIDTH_M = 3.25
ROAD = {"highway": "primary", "name": "Long Road", "width:lanes": "3.25"}


def note_nothing(why: str) -> None:
    raise AssertionError(why)


def eastward(parts: list[dict[str, str]], *, crossing_at: int = 1) -> OsmText:
    """A road of parts of 100 m from west to east, with a signal at one of its nodes."""
    osm = OsmText()
    nodes = []
    for number in range(len(parts) + 1):
        tags = {}
        if number == crossing_at:
            tags = {"highway": "traffic_signals"}
        nodes.append(osm.node(100.0 * (number - crossing_at), 0.0, **tags))
    for number, tags in enumerate(parts):
        pair = nodes[number : number + 2]
        if tags.get("oneway") == "-1":
            pair = pair[::-1]
        osm.way(pair, {"highway": "primary", "name": "Long Road"} | tags)
    cross = {"highway": "primary", "name": "Short Road", "lanes": "2"}
    osm.way([(0.0, -150.0), nodes[crossing_at], (0.0, 150.0)], cross)
    return osm


def one_way(n_lanes: int, **tags: str) -> dict[str, str]:
    named = {key.replace("__", ":"): value for key, value in tags.items()}
    return {"oneway": "yes", "lanes": str(n_lanes)} | named


def read(osm: OsmText, folder: Path) -> SourceMap:
    return as_drawn(read_map(osm.write(folder)))


def along(source: SourceMap) -> list[MapLane]:
    """Driving lanes of the road from west to east."""
    lanes = [lane for lane in source.lanes if lane.kind == "driving"]
    return [lane for lane in lanes if np.ptp(lane.centreline_m[:, 0]) > 20.0]


def lefts_at(source: SourceMap, east_m: float) -> list[float]:
    """How far north of the way each lane's middle lies, from north to south."""
    found = []
    for lane in along(source):
        line = lane.centreline_m[np.argsort(lane.centreline_m[:, 0])]
        if line[0, 0] <= east_m <= line[-1, 0]:
            found.append(float(np.interp(east_m, line[:, 0], line[:, 1])))
    return sorted(found, reverse=True)


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
    source = read(
        eastward([one_way(2, placement=value), one_way(2)], crossing_at=1), tmp_path
    )
    wanted = [(way_from_left - 0.5) * WIDTH_M, (way_from_left - 1.5) * WIDTH_M]
    assert lefts_at(source, -50.0) == pytest.approx(wanted, abs=0.01)
    # Without the tag the way is the middle.
    assert lefts_at(source, 50.0) == pytest.approx([1.625, -1.625], abs=0.01)


def test_a_lane_that_opens_at_a_junction_leaves_the_others_where_they_are(tmp_path):
    parts = [one_way(2, placement="middle_of:1"), one_way(3, placement="middle_of:2")]
    source = read(eastward(parts), tmp_path)
    assert lefts_at(source, -50.0) == pytest.approx([0.0, -WIDTH_M], abs=0.01)
    assert lefts_at(source, 50.0) == pytest.approx([WIDTH_M, 0.0, -WIDTH_M], abs=0.01)


@pytest.mark.parametrize(
    "tags",
    [
        {"placement:forward": "left_of:1"},
        {"placement:backward": "left_of:1"},
    ],
)
def test_the_line_between_the_directions(tmp_path, tags):
    two_way = {"lanes": "3", "lanes:forward": "2", "lanes:backward": "1"}
    source = read(eastward([two_way | tags, two_way]), tmp_path)
    wanted = [0.5 * WIDTH_M, -0.5 * WIDTH_M, -1.5 * WIDTH_M]
    assert lefts_at(source, -50.0) == pytest.approx(wanted, abs=0.01)


def test_lanes_of_the_other_direction_are_counted_as_it_sees_them(tmp_path):
    two_way = {"lanes": "4", "placement:backward": "right_of:2"}
    source = read(eastward([two_way, {"lanes": "4"}]), tmp_path)
    # The way is the northern kerb: the right edge of their second lane.
    wanted = [-(number + 0.5) * WIDTH_M for number in range(4)]
    assert lefts_at(source, -50.0) == pytest.approx(wanted, abs=0.01)


def test_a_road_against_the_order_of_its_nodes(tmp_path):
    backward = {"oneway": "-1", "lanes": "2"}
    source = read(eastward([backward | {"placement": "left_of:1"}, backward]), tmp_path)
    # Drawn from east to west, driven from west to east.
    assert lefts_at(source, -50.0) == pytest.approx([-1.625, -4.875], abs=0.01)
    tips = {"placement:start": "right_of:2", "placement:end": "left_of:1"}
    source = read(eastward([backward | tips, backward]), tmp_path)
    # The start of the drawing is the eastern end.
    lefts = lefts_at(source, -90.0)
    assert lefts[0] < 0.0
    assert lefts_at(source, -15.0)[-1] > 0.0


@pytest.mark.parametrize(
    "between",
    [
        {"placement": "transition"},
        {
            "placement": "transition",
            "placement:start": "middle_of:1",
            "placement:end": "middle_of:2",
        },
        {"placement:start": "middle_of:1", "placement:end": "middle_of:2"},
    ],
)
def test_a_transition_leads_from_one_place_to_the_next(tmp_path, between):
    parts = [
        one_way(2, placement="middle_of:1"),
        one_way(2) | between,
        one_way(2, placement="middle_of:2"),
        one_way(2),
    ]
    source = read(eastward(parts, crossing_at=3), tmp_path)
    assert lefts_at(source, -250.0) == pytest.approx([0.0, -WIDTH_M], abs=0.01)
    assert lefts_at(source, -150.0) == pytest.approx([1.625, -1.625], abs=0.01)
    assert lefts_at(source, -175.0) == pytest.approx([0.8125, -2.4375], abs=0.01)
    assert lefts_at(source, -50.0) == pytest.approx([WIDTH_M, 0.0], abs=0.01)
    for lane in along(source):
        # No lane jumps aside.
        steps = np.abs(np.diff(lane.centreline_m[:, :2], axis=0))
        assert (steps[:, 1] < 0.3 * steps[:, 0] + 1e-6).all()


def test_a_transition_of_a_way_that_a_junction_cuts_goes_on_behind_it(tmp_path):
    osm = OsmText()
    west, east = osm.node(-100.0, 0.0), osm.node(100.0, 0.0)
    signal = osm.node(0.0, 0.0, highway="traffic_signals")
    tips = {"placement:start": "middle_of:1", "placement:end": "middle_of:2"}
    osm.way([west, signal, east], ROAD | one_way(2) | tips)
    osm.way([(0.0, -150.0), signal, (0.0, 150.0)], {"highway": "primary"})
    source = read(osm, tmp_path)
    for east_m in (-80.0, -40.0, 40.0, 80.0):
        left_m = 0.5 * WIDTH_M * east_m / 100.0
        wanted = [left_m + 1.625, left_m - 1.625]
        assert lefts_at(source, east_m) == pytest.approx(wanted, abs=0.02)


@pytest.mark.parametrize(
    ("tags", "said"),
    [
        (one_way(2, placement="middle_of:3"), "placement=middle_of:3 names no lane"),
        (one_way(2, placement="beside:1"), "placement=beside:1 names no lane"),
        ({"lanes": "2", "placement": "left_of:1"}, "must be placement:forward or"),
    ],
)
def test_what_makes_no_sense_is_told(tmp_path, tags, said):
    source = read(eastward([tags, tags]), tmp_path)
    centred = 0.5 * WIDTH_M
    assert lefts_at(source, -50.0) == pytest.approx([centred, -centred], abs=0.01)
    assert any(said in str(skipped.why) for skipped in source.skipped)


def test_surface_and_crosswalk_lie_where_the_lanes_do(tmp_path):
    osm = eastward([one_way(2, placement="left_of:1"), one_way(2)])
    walk = {"highway": "footway", "footway": "crossing"}
    osm.way([(-50.0, 9.0), (-50.0, -9.0)], walk)
    source = read(osm, tmp_path)
    walks = [line for line in source.crosswalks_m if np.abs(line[:, 0] + 50).max() < 1]
    ((north, south),) = [sorted(line[:, 1], reverse=True) for line in walks]
    # As far beyond the kerb at 0 m as beyond that at -6.5 m.
    assert north > 0.0
    assert north == pytest.approx(-6.5 - south, abs=0.01)
    (junction,) = source.junctions
    west = junction.outline_m[junction.outline_m[:, 0] < -6.0]
    assert west[:, 1].mean() < -1.0


def test_poles_stand_beside_the_carriageway_and_not_on_it(tmp_path):
    parts = [one_way(3, placement="left_of:1"), one_way(3, placement="left_of:1")]
    path = eastward(parts).write(tmp_path)
    scene = import_scene([path], ImportOptions(radius_m=80.0)).scene
    assert scene.sites
    for site in scene.sites:
        for lane in scene.lanes:
            away = np.hypot(*(lane.centreline_m[:, :2] - site.position_m[:2]).T)
            assert away.min() > 0.5 * lane.width_m


def test_roundabouts_are_read_as_if_they_had_no_placement():
    said: list[str] = []
    tags = {"highway": "primary", "junction": "roundabout", "placement": "left_of:1"}
    lanes = [("forward", 0, WIDTH_M)]
    assert carriageway_left_m(tags, lanes, 0.5 * WIDTH_M, said.append) == (0.0, 0.0)
    assert said == ["placement is not followed on a roundabout"]


def test_a_road_without_the_tag_stays_in_the_middle():
    lanes = [("forward", 0, WIDTH_M)]
    tags = {"highway": "primary", "oneway": "yes"}
    assert carriageway_left_m(tags, lanes, 1.625, note_nothing) == (0.0, 0.0)
