"""Lanes for buses, in all spellings that maps have for them."""

import numpy as np
import pytest
from osm_drawing import drawn, drawn_crossing, read_drawing
from osm_text import arms_of

WORDS = {"driving": "car", "bus": "bus", "cycling": "bicycle"}


def road_from_left(tags, folder, *, keeps_left=False):
    """Lanes across a road that leads east, from its left side to its right; its map.

    "car >" is driven east, "bus <" west.
    """
    osm = drawn(f"road -50 0, 50 0: highway=primary; {tags}")
    source = read_drawing(osm, folder, keeps_left=keeps_left)
    lanes = sorted(source.lanes, key=lambda lane: -lane.centreline_m[:, 1].mean())

    found = []
    for lane in lanes:
        arrow = "<"
        if lane.centreline_m[-1, 0] > lane.centreline_m[0, 0]:
            arrow = ">"
        found.append(f"{WORDS[lane.kind]} {arrow}")

    return ", ".join(found), source


@pytest.mark.parametrize(
    "tags",
    [
        "lanes=4; bus:lanes:forward=yes|designated; vehicle:lanes:forward=yes|no;"
        " bus:lanes:backward=yes|designated; vehicle:lanes:backward=yes|no",
        "lanes=4; psv:lanes:forward=|designated; psv:lanes:backward=|designated",
        "lanes=4; motor_vehicle:lanes:forward=yes|no; bus:lanes:forward=|yes;"
        " motor_vehicle:lanes:backward=yes|no; bus:lanes:backward=|yes",
        "lanes=4; access:lanes:forward=yes|no; taxi:lanes:forward=yes|designated;"
        " access:lanes:backward=yes|no; taxi:lanes:backward=yes|designated",
        "lanes=4; access:lanes:forward=|psv; access:lanes:backward=|bus",
        "bus:lanes:forward=yes|designated; bus:lanes:backward=yes|designated",
        "lanes=4; lanes:psv:forward=1; lanes:psv:backward=1",
        "lanes=4; lanes:bus:forward=1; lanes:bus:backward=1",
        "lanes=4; lanes:bus=2",
        "lanes=4; lanes:psv=2; lanes:bus:forward=1; lanes:bus:backward=1",
        "lanes=4; busway:both=lane",
        "lanes=4; busway=lane",
        "busway:left=lane; busway:right=lane",
        "lanes=4; lanes:forward=2; lanes:backward=2; busway=lane",
    ],
)
def test_every_spelling_of_a_bus_lane_at_both_kerbs(tags, tmp_path):
    found, source = road_from_left(tags, tmp_path)
    assert found == "bus <, car <, car >, bus >"
    assert not source.skipped


@pytest.mark.parametrize(
    ("tags", "expected"),
    [
        ("lanes=3; lanes:forward=2; busway:right=lane", "car <, car >, bus >"),
        ("oneway=yes; lanes=2; lanes:bus=1", "car >, bus >"),
        ("oneway=yes; lanes=2; busway:left=lane", "bus >, car >"),
        (
            (
                "oneway=yes; lanes=3; bus:lanes=designated|yes|yes; "
                "vehicle:lanes=no|yes|yes"
            ),
            "bus >, car >, car >",
        ),
        ("oneway=yes; lanes=2; busway=opposite_lane", "bus <, car >"),
        (
            "oneway=yes; lanes=3; lanes:forward=2; lanes:psv:backward=1",
            "bus <, car >, car >",
        ),
        (
            (
                "oneway=yes; lanes=2; vehicle:lanes=yes|no|no; "
                "bus:lanes=yes|designated|no; bicycle:lanes=no|no|designated"
            ),
            "car >, bus >",
        ),
        (
            ("oneway=yes; lanes=2; access:lanes=yes|yes; bus:lanes=yes|designated"),
            "car >, car >",
        ),
        ("oneway=yes; lanes=2; hov:lanes=designated|yes", "car >, car >"),
        ("oneway=yes; lanes=2; vehicle:lanes=yes|destination", "car >, car >"),
        ("oneway=-1; lanes=2; busway=lane", "bus <, car <"),
    ],
)
def test_where_a_bus_lane_lies_and_who_else_uses_it(tags, expected, tmp_path):
    found, _ = road_from_left(tags, tmp_path)
    assert found == expected


def test_where_traffic_keeps_left_bus_lanes_lie_at_the_left_kerb(tmp_path):
    found, _ = road_from_left("lanes=4; busway=lane", tmp_path, keeps_left=True)
    assert found == "bus >, car >, car <, bus <"


@pytest.mark.parametrize(
    ("tags", "expected", "why"),
    [
        (
            "oneway=yes; lanes=1; busway=lane",
            "car >, bus >",
            "buses have all its lanes",
        ),
        (
            "oneway=yes; lanes=3; bus:lanes=yes|designated",
            "car >, car >, bus >",
            "do not fit their number",
        ),
        ("lanes=3; lanes:psv=1", "car <, car >, bus >", "names no direction"),
    ],
)
def test_what_a_map_leaves_open_of_bus_lanes_is_told(tags, expected, why, tmp_path):
    found, source = road_from_left(tags, tmp_path)
    assert found == expected

    (note,) = source.skipped
    assert why in str(note.why)


def test_a_bus_lane_is_part_of_the_arm_and_no_way_for_cars(tmp_path):
    osm = drawn_crossing("highway=primary; lanes=4; busway=lane")
    source = read_drawing(osm, tmp_path, keeps_left=False)
    (junction,) = source.junctions

    for arm in arms_of(source, junction).arms.values():
        assert [lane.kind for lane in arm.lanes_in] == ["bus", "driving"]
        assert [lane.kind for lane in arm.lanes_out] == ["bus", "driving"]
        assert len(arm.entry_lanes) == len(arm.exit_lanes) == 1

    roads = {(road.lanes_in, road.lanes_out) for road in junction.roads}
    assert roads == {(1, 1)}


def test_where_a_bus_lane_ends_the_lane_of_cars_goes_straight_on(tmp_path):
    """The kerb lane begins at the cars' lane, not at the one for buses."""
    tags = "highway=primary; oneway=yes; lanes=2; name=Long Road"
    but_west = (
        (0.0, 1.0),
        (0.0, -1.0),
        (1.0, 0.0),
    )
    osm = drawn_crossing(bearings=but_west).draw(f"""
        road -150 0, -60 0: {tags}; busway=lane
        road -60 0, 0 0: {tags}
    """)
    source = read_drawing(osm, tmp_path, keeps_left=False)
    (junction,) = source.junctions
    entries = arms_of(source, junction).arms["west"].entry_lanes
    kerb, inner = (lane.centreline_m for lane in entries)
    driving = [lane.centreline_m for lane in source.lanes if lane.kind == "driving"]
    before = next(line for line in driving if line[0, 0] < -140.0)

    # Whole in itself: the lane of cars.
    assert np.ptp(inner[:, 1]) < 0.01
    assert abs(inner[0, 1] - before[-1, 1]) < 0.01
    # The lane at the kerb leaves it where the bus lane has ended.
    assert abs(kerb[0, 1] - before[-1, 1]) < 0.01
    assert kerb[-1, 1] < inner[-1, 1] - 3.0


@pytest.mark.parametrize("value", ["no", "psv", "bus"])
def test_a_street_for_buses_alone_is_no_road_for_cars(value, tmp_path):
    osm = drawn(f"""
        road -50 0, 50 0
        way -50 30, 50 30: highway=unclassified; motor_vehicle={value}; bus=yes
    """)
    assert len(read_drawing(osm, tmp_path).lanes) == 2
