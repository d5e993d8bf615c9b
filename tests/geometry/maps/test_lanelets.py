"""Maps of lanelets: a crossing drawn here, as Lanelet2 and as CommonRoad."""

import re

import numpy as np
import pytest
from lanelet_text import HALF_M, WIDTH_M, commonroad, crossing, lanelet2
from numpy.testing import assert_allclose, assert_array_equal
from osm_tags import tags_of
from pyproj import Transformer

from geometry.errors import InputError
from geometry.maps.importing import (
    ImportOptions,
    import_scene,
    read_map,
    survey_junctions,
)


def read(tmp_path, text, name="map.osm"):
    """The map of a file with a text."""
    path = tmp_path / name
    path.write_text(text)
    return read_map(path)


def test_a_crossing_has_its_arms_lanes_and_ways_through(tmp_path):
    source = read(tmp_path, lanelet2(crossing(), {"speed_limit": "30 mph"}))
    (one,) = survey_junctions(source)

    assert set(one.arms) == {"north", "east", "south", "west"}
    assert one.n_lanes == 8
    assert one.n_driven == 4
    assert len(source.connections) == 4
    assert not source.keeps_left
    # The union of two strips, 16 m long and 6 m wide, reaches 8 m from the middle each
    # way.
    assert np.abs(one.junction.outline_m).max() == pytest.approx(HALF_M, abs=0.1)
    assert one.junction.position_m == pytest.approx([0.0, 0.0], abs=0.1)
    for lane in source.lanes:
        assert lane.width_m == pytest.approx(WIDTH_M)
        assert lane.speed_limit_kmh == pytest.approx(30 * 1.609344)
        (along,) = np.flatnonzero(np.ptp(lane.centreline_m[:, :2], axis=0) > 1.0)
        assert np.abs(lane.centreline_m[:, 1 - along]) == pytest.approx(WIDTH_M / 2.0)


def test_commonroad_says_the_same(tmp_path):
    ours = read(tmp_path, lanelet2(crossing()), "a.osm")
    theirs = read(tmp_path, commonroad(crossing()), "a.xml")

    for one, other in zip(ours.lanes, theirs.lanes, strict=True):
        assert_array_equal(one.centreline_m, other.centreline_m)
        assert one.from_junction == other.from_junction
        assert one.to_junction == other.to_junction
    assert_array_equal(ours.junctions[0].outline_m, theirs.junctions[0].outline_m)


def test_the_side_of_the_road_is_seen(tmp_path):
    assert read(tmp_path, lanelet2(crossing(keeps_left=True))).keeps_left


def test_a_lanelet_with_exchanged_sides_is_turned_and_told(tmp_path):
    lanes = crossing()
    lanes["in2"] = lanes["in2"][::-1]
    source = read(tmp_path, lanelet2(lanes))
    right = read(tmp_path, lanelet2(crossing()))

    assert len(source.lanes) == 8

    for one, other in zip(source.lanes, right.lanes, strict=True):
        assert_allclose(one.centreline_m, other.centreline_m)
    assert any("exchanged" in note.why for note in source.skipped)


def test_both_ways_of_a_lanelet_are_lanes(tmp_path):
    lanes = {"road": ([(0.0, 2.0), (50.0, 2.0)], [(0.0, -2.0), (50.0, -2.0)])}
    assert len(read(tmp_path, lanelet2(lanes)).lanes) == 1

    one, back = read(tmp_path, lanelet2(lanes, {"one_way": "no"})).lanes
    assert_allclose(one.centreline_m, back.centreline_m[::-1])


def test_crosswalks_lights_and_houses_are_there(tmp_path):
    lanes = crossing() | {
        "zebra": ([(-12.0, -5.0), (-12.0, 5.0)], [(-9.0, -5.0), (-9.0, 5.0)])
    }
    more = ""
    refs = ""
    corners = [
        (20.0, 20.0),
        (30.0, 20.0),
        (30.0, 35.0),
        (20.0, 35.0),
        (20.0, 20.0),
    ]

    for number, (x, y) in enumerate(corners, 900):
        more += (
            f"<node id='{number}' lat='50' lon='8'><tag k='local_x' v='{x}'/>"
            f"<tag k='local_y' v='{y}'/></node>"
        )
        refs += f"<nd ref='{number}'/>"
    more += (
        f"<way id='900'>{refs}</way><way id='901'><nd ref='900'/><nd ref='901'/>"
        "<tag k='type' v='traffic_light'/></way><relation id='900'>"
        "<member type='way' ref='900' role='outer'/><tag k='type' v='multipolygon'/>"
        "<tag k='subtype' v='building'/></relation>"
    )
    source = read(tmp_path, lanelet2(lanes, more=more))
    walk = np.sort(source.crosswalks_m[0], axis=0)

    assert walk.tolist() == [[-10.5, -5.0], [-10.5, 5.0]]

    (pole,) = source.poles
    assert pole.kind == "traffic light"
    assert pole.position_m.tolist() == [25.0, 20.0, 0.0]

    (house,) = source.things
    assert np.ptp(house.vertices_m[:, :2], axis=0).tolist() == [10.0, 15.0]
    assert house.is_height_assumed


def test_a_crossing_becomes_a_scene(tmp_path):
    path = tmp_path / "map.osm"
    path.write_text(lanelet2(crossing()))
    scene = import_scene([path], ImportOptions(sites="kerb:20")).scene

    assert scene.crs == ""
    assert len(scene.sites) >= 4
    assert sum(lane.kind == "driving" for lane in scene.lanes) == 8


EMPTY_LANELET = (
    "<osm version='0.6'><relation id='1'><tag k='type' v='lanelet'/></relation></osm>"
)
ZEBRA = {"zebra": ([(0.0, 1.0), (9.0, 1.0)], [(0.0, 0.0), (9.0, 0.0)])}
OF_A_POINT = {"road": ([(0.0, 1.0)], [(0.0, 0.0), (9.0, 0.0)])}
OF_A_FAR_POINT = {
    "far": (
        [(0.0, 0.0), (2.0e9, 0.0)],
        [(0.0, -3.0), (30.0, -3.0)],
    ),
}
OF_NO_NUMBERS = {"road": ([(0, "x"), (1, "nan")], [(0, 0), (9, 0)])}


@pytest.mark.parametrize(
    ("text", "name", "told"),
    [
        (EMPTY_LANELET, "a.osm", "no nodes"),
        (lanelet2(ZEBRA), "a.osm", "no lanelet for cars"),
        (lanelet2(OF_A_POINT), "a.osm", "no lanelet for cars"),
        ("<commonRoad/>", "a.xml", "no lanelet for cars"),
        (commonroad(OF_NO_NUMBERS), "a.xml", "no lanelet for cars"),
        (commonroad(OF_A_FAR_POINT), "a.xml", "no lanelet for cars"),
    ],
)
def test_what_is_no_map_is_refused(tmp_path, text, name, told):
    with pytest.raises(InputError, match=told):
        read(tmp_path, text, name)


@pytest.mark.parametrize(
    ("tags", "kind"),
    [
        ("subtype=bus_lane", "bus"),
        ("participant:vehicle:bus=yes; participant:vehicle:taxi=yes", "bus"),
        ("participant:bicycle=yes", "cycling"),
        ("participant:vehicle=yes; participant:bicycle=yes", "driving"),
        ("participant:vehicle=yes; participant:vehicle:car=no", "bus"),
        ("participant:pedestrian=no", "driving"),
    ],
)
def test_who_may_use_a_lanelet_says_its_kind(tags, kind, tmp_path):
    """The first one leads in from the west."""
    road = "<tag k='subtype' v='road'/>"
    known = {"subtype": "road"} | tags_of(tags)
    told = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in known.items())
    text = lanelet2(crossing()).replace(road, told, 1)
    source = read(tmp_path, text)
    kinds = {lane.id: lane.kind for lane in source.lanes}

    assert kinds.pop("1") == kind
    assert set(kinds.values()) == {"driving"}


def test_a_bus_lane_of_commonroad_is_no_way_through_for_cars(tmp_path):
    urban = "<laneletType>urban</laneletType>"
    bus = f"{urban}<laneletType>busLane</laneletType>"
    text = commonroad(crossing()).replace(urban, bus, 1)
    source = read(tmp_path, text, "a.xml")
    (bus,) = (lane for lane in source.lanes if lane.kind == "bus")
    (junction,) = source.junctions

    assert bus.to_junction == junction.id

    (surveyed,) = survey_junctions(source)
    assert surveyed.n_driven == 3


# ---------- Autoware's files


def with_places(text, *, turned_deg=0.0):
    """A map in local coordinates with the latitudes and longitudes that they mean.

    Local (0, 0) lies at 48 degrees north, 11 degrees east; its x axis points
    `turned_deg` north of east.
    """
    to_deg = Transformer.from_crs(
        "+proj=tmerc +lat_0=48 +lon_0=11 +k=1 +datum=WGS84 +units=m", "EPSG:4326"
    )
    angle = np.radians(turned_deg)

    def placed(match):
        x, y = map(float, match.groups())
        east = x * np.cos(angle) - y * np.sin(angle)
        north = x * np.sin(angle) + y * np.cos(angle)
        lat, lon = to_deg.transform(east, north)
        local = f"<tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/>"
        return f"lat='{lat:.9f}' lon='{lon:.9f}'>{local}"

    pattern = (
        r"lat='50' lon='8'><tag k='local_x' v='([-0-9.]+)'/>"
        r"<tag k='local_y' v='([-0-9.]+)'/>"
    )
    return re.sub(pattern, placed, text)


PLAIN = lanelet2(crossing())
NO_VERSION = ("<osm version='0.6'>", "<osm generator='VMB'><MetaInfo map_version='1'/>")
EMPTY = ("lat='50' lon='8'", "lat='' lon=''")
MISSING = ("lat='50' lon='8'", "")


@pytest.mark.parametrize(
    "text",
    [
        PLAIN.replace(*NO_VERSION),
        PLAIN.replace(*EMPTY),
        PLAIN.replace(*MISSING),
        PLAIN.replace(*NO_VERSION).replace(*EMPTY),
        with_places(PLAIN),
        with_places(PLAIN).replace(*NO_VERSION),
        with_places(PLAIN, turned_deg=30.0),
    ],
)
def test_every_variant_of_a_map_has_the_same_arms_and_lanes(text, tmp_path):
    source = read(tmp_path, text)
    plain = read(tmp_path, PLAIN, "plain.osm")
    (one,) = survey_junctions(source)

    assert len(one.arms) == 4
    assert one.n_lanes == 8
    assert len(source.connections) == 4
    for lane, same in zip(source.lanes, plain.lanes, strict=True):
        # The shape is that of the local coordinates.
        assert_allclose(steps_m(lane), steps_m(same), atol=1e-6)
        assert lane.width_m == pytest.approx(same.width_m, abs=1e-6)


def steps_m(lane):
    """Distances between the points of a lane."""
    return np.linalg.norm(np.diff(lane.centreline_m[:, :2], axis=0), axis=-1)


def test_latitudes_say_where_local_coordinates_lie(tmp_path):
    """A frame that is turned against north by 30 degrees is turned back."""
    source = read(tmp_path, with_places(PLAIN, turned_deg=30.0))
    assert source.source_crs == "EPSG:4326"

    (junction,) = source.junctions
    place = Transformer.from_crs(source.crs, "EPSG:4326", always_xy=True)
    lon_lat = place.transform(*junction.position_m)

    assert lon_lat == pytest.approx((11.0, 48.0), abs=1e-6)

    lane = source.lanes[0].centreline_m[:, :2]
    east, north = lane[-1] - lane[0]

    assert np.degrees(np.arctan2(north, east)) % 90.0 == pytest.approx(30.0, abs=0.01)


def test_latitudes_that_do_not_fit_are_told_and_not_followed(tmp_path):
    source = read(tmp_path, PLAIN)
    assert source.crs == ""

    notes = [str(note) for note in source.skipped]
    expected = (
        "place of map.osm: latitude and longitude do not fit local_x and local_y: not"
        " followed"
    )

    assert expected in notes


@pytest.mark.parametrize(
    ("bounds", "why"),
    [
        (
            ([(30.0, 30.0), (50.0, 30.0)], [(30.0, 30.0), (50.0, 30.0)]),
            "it is 0 m wide and 20 m long",
        ),
        (
            ([(30.0, 30.0), (30.0, 30.01)], [(33.0, 30.0), (33.0, 30.01)]),
            "m wide and 0.01 m long",
        ),
    ],
)
def test_a_lanelet_that_cannot_be_a_lane_is_told_with_its_file(bounds, why, tmp_path):
    source = read(tmp_path, lanelet2(crossing() | {"odd": bounds}))
    assert len(source.lanes) == 8

    (note,) = (note for note in source.skipped if "lanelet" in str(note.what))
    assert str(note.what) == "lanelet 13 of map.osm"
    assert why in str(note.why)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            PLAIN.replace("lat='50'", "lat='95'", 1),
            "node 1: lat: got '95'; expected -90",
        ),
        (PLAIN.replace("lat='50'", "lat='x'", 1), "node 1: lat: got 'x'; expected -90"),
        (
            PLAIN.replace("id='1' lat", "id='a' lat", 1),
            "node: id: got 'a'; expected a w",
        ),
        (re.sub("<tag k='local_.*?/>", "", PLAIN.replace(*EMPTY)), "got no positions"),
        (PLAIN[:-40], "well-formed XML"),
    ],
)
def test_a_broken_map_of_lanelets_is_refused_in_a_line(text, message, tmp_path):
    with pytest.raises(InputError, match=re.escape(message)):
        read(tmp_path, text)
