"""Files of OpenStreetMap data: formats, damage, sizes, and maps that nobody here
made.
"""

import re
import sys
import types
from collections import Counter

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from osm_drawing import FOUR, assert_lanes_end_at_outlines, drawn_crossing
from osm_text import OsmText, arm_lanes, arms_of

from geometry.errors import InputError, MissingExtraError
from geometry.maps.openstreetmap import fetch_openstreetmap, read_openstreetmap
from geometry.maps.openstreetmap.elements import DEFAULTS
from geometry.maps.source_map import parse_length_m


def small_map():
    """A bit of everything."""
    osm = drawn_crossing(
        "lanes=2; width=10; parking:both=lane; cycleway:right=lane",
        bearings=FOUR[:3],
    )
    house = "building=yes; building:levels=3; min_height=1"
    osm.draw(f"""
        road 0 -60, 0 0: oneway=-1; turn:lanes=left|right; lanes=2
        way 20 20, 30 20, 30 30, 20 30, 20 20: {house}
        way 50 20, 60 20, 60 30, 50 30, 50 20
        way 52 22, 55 22, 55 25, 52 22
    """)
    *_, outer, inner = osm.ids
    osm.relation(
        [(outer, "outer"), (inner, "inner")],
        {"type": "multipolygon", "building": "yes", "height": "9"},
    )
    return osm.draw("""
        way -20 20, -40 25: barrier=wall; height=2
        way -20 40, -40 45: natural=tree_row
        node -20 -20: natural=tree; diameter_crown=4
        node -30 -20: highway=street_lamp; height=8
        node -30 -40: highway=traffic_signals; traffic_signals:direction=both
        node -40 -40: highway=crossing
        road -60 -40, -40 -40, -30 -40, -10 -40: highway=service; layer=1
    """)


SMALL = small_map().text()


def read_text(text, folder, name="map.osm"):
    """The map of a file with a text, or with bytes."""
    if isinstance(text, str):
        text = text.encode()
    path = folder / name
    path.write_bytes(text)
    return read_openstreetmap(path)


# ---------------------------------------------------------------- formats


def ids(items):
    """Ids of items of a map."""
    return [item.id for item in items]


UTF_16 = SMALL.replace('"1.0"?', '"1.0" encoding="UTF-16"?').encode("utf-16")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("map", SMALL),
        ("utf16.osm", UTF_16),
    ],
)
def test_the_content_of_a_file_tells_its_format(name, content, tmp_path):
    plain = read_text(SMALL, tmp_path)
    other = read_text(content, tmp_path, name)

    assert len(plain.things) == 8
    assert len(plain.poles) == 3
    assert len(plain.junctions) == 1
    assert ids(other.lanes) == ids(plain.lanes)

    for one, two in zip(plain.lanes, other.lanes, strict=True):
        assert_array_equal(one.centreline_m, two.centreline_m)


def test_the_map_lies_around_its_roads_and_says_where(tmp_path):
    source = read_text(SMALL, tmp_path)
    assert source.source_crs == "EPSG:4326"
    assert source.heights == "above ground"

    expected = (
        r"\+proj=tmerc \+lat_0=52\.5\d+ \+lon_0=13\.4\d+ \+k=1 \+x_0=0 \+y_0=0"
        r" \+datum=WGS84 \+units=m \+no_defs"
    )
    assert re.fullmatch(expected, source.crs)

    ends = np.concatenate([lane.centreline_m[:, :2] for lane in source.lanes])
    assert_allclose(ends.min(axis=0) + ends.max(axis=0), 0.0, atol=10.0)


def test_ids_are_unique(tmp_path):
    source = read_text(SMALL, tmp_path)
    for items in (source.lanes, source.things, source.poles, source.junctions):
        assert len(set(ids(items))) == len(items)


def with_latitude(text):
    """The small map, in which the first latitude reads otherwise."""
    return re.sub(r'lat="52\.\d+"', text, SMALL, count=1)


NODE = '<node id="1" lat="1" lon="1"/>'
WAY = '<tag k="highway" v="primary"/></way>'


def document(*elements):
    """A file of these elements."""
    return f'<osm version="0.6">{"".join(elements)}</osm>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got something else; expected OpenStreetMap data, XML or PBF"),
        ("<gpx></gpx>", "got Unknown top-level element: gpx"),
        (SMALL[:500], "got XML parsing error at line 7"),
        (SMALL.replace('version="0.6"', ""), "without version"),
        (SMALL.replace('id="2"', 'id="two"'), "got illegal id: 'two'"),
        (with_latitude('lat="north"'), "coordinate: 'north'"),
        (
            with_latitude('lat="95"'),
            "map.osm: node 1: got latitude 95.0, longitude 13.4; expected latitude"
            " -90..90 and longitude -180..180",
        ),
        (with_latitude(""), "node 1: got no coordinates"),
        (with_latitude('lat="50"'), "got roads from latitude 50 to 52."),
        (document(), "got no nodes; expected a map with roads"),
        (document(NODE), "got no road for cars; expected a map with roads"),
        (
            '<!DOCTYPE osm [<!ENTITY a "aaaaaaaa">]>' + SMALL.partition("\n")[2],
            "XML entities are not supported",
        ),
        (
            document(NODE, '<way id="1"><nd ref="1"/><nd ref="1"/>', WAY),
            "got no road with two nodes; expected a map with roads",
        ),
        (SMALL.replace("Street 0", "S" * 70_000), "too long"),
    ],
)
def test_what_is_no_map_is_told_in_one_line(text, message, tmp_path):
    with pytest.raises(InputError) as caught:
        read_text(text, tmp_path)

    told = str(caught.value)
    assert message in told
    assert told.startswith(str(tmp_path / "map.osm"))
    assert "\n" not in told


def test_too_many_elements_are_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(DEFAULTS["reading"], "max_nodes", 20)
    with pytest.raises(InputError, match="more than 20 elements; expected fewer"):
        read_text(SMALL, tmp_path)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_openstreetmap(tmp_path / "none.osm")
    with pytest.raises(InputError, match="expected a readable file"):
        read_openstreetmap(tmp_path)


def test_what_was_deleted_is_not_there(tmp_path):
    text = SMALL.replace('<way id="3"', '<way id="3" visible="false"')
    assert text != SMALL

    source = read_text(text, tmp_path)
    assert len(source.lanes) < len(read_text(SMALL, tmp_path).lanes)


def test_of_a_node_that_comes_twice_the_last_counts(tmp_path):
    again = '<node id="2" lat="1.5" lon="1"/><node id="2" lat="1.001" lon="1"/>'
    text = document(NODE, again, '<way id="1"><nd ref="1"/><nd ref="2"/>', WAY)
    lane = read_text(text, tmp_path).lanes[0]

    assert np.ptp(lane.centreline_m[:, 1]) == pytest.approx(110.6, abs=0.1)


def test_elements_may_come_in_any_order(tmp_path):
    head, *elements, tail = SMALL.strip().split("\n")[1:]
    backwards = "\n".join([head, *elements[::-1], tail])
    source = read_text(SMALL, tmp_path)
    other = read_text(backwards, tmp_path)

    assert set(ids(source.things)) == set(ids(other.things))
    for one, two in zip(source.junctions, other.junctions, strict=True):
        assert one.id == two.id
        assert one.name == two.name
        area_m2 = shapely.Polygon(one.outline_m).area
        other_m2 = shapely.Polygon(two.outline_m).area
        assert area_m2 == pytest.approx(other_m2, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "length_m"),
    [
        ("3", 3.0),
        (" 3.5m ", 3.5),
        ("3,5", 3.5),
        ("350 cm", 3.5),
        ("2.5-3.5", 3.0),
        ("3;4", 3.5),
        ("~4", 4.0),
        ("10'", 3.048),
        ("10 ft.", 3.048),
        ("6'6\"", 1.9812),
        ("12 in", 0.3048),
    ],
)
def test_lengths_are_understood_as_people_write_them(text, length_m):
    assert parse_length_m(text) == pytest.approx(length_m)


@pytest.mark.parametrize(
    "text",
    ["", "m", "wide", "-3", "3 parsecs", "1e9", "nan", "3..", "٣", "9" * 50],
)
def test_what_is_no_length_is_none(text):
    assert parse_length_m(text) is None


# ---------------------------------------------------------------- fuzzing

KEYS = [
    "lanes",
    "lanes:forward",
    "lanes:backward",
    "lanes:both_ways",
    "width",
    "width:lanes",
    "turn:lanes",
    "oneway",
    "parking:left",
    "parking:both:orientation",
    "cycleway",
    "sidewalk",
    "junction",
    "layer",
    "bridge",
    "highway",
    "service",
    "name",
]
VALUES = [
    "",
    "0",
    "-1",
    "-3",
    "1",
    "2",
    "3",
    "5",
    "2.5|3",
    "3|4|",
    "12'3\"",
    "99999999999",
    "1e308",
    "NaN",
    "🙂",
    "yes",
    "no",
    "left",
    "both",
    "lane",
    "track",
    "separate",
    "roundabout",
    "primary_link",
    "service",
    "motorway",
]
TAGS = st.dictionaries(
    st.sampled_from(KEYS),
    st.sampled_from(VALUES),
)


@pytest.mark.long
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(tags=TAGS, seed=st.integers(0, 10**6))
def test_roads_that_lie_anyhow_are_read(tags, seed, tmp_path):
    rng = np.random.default_rng(seed)
    osm = OsmText()
    nodes = [osm.node(*rng.uniform(-60.0, 60.0, 2)) for _ in range(12)]

    for way in range(7):
        picked = rng.integers(0, 12, rng.integers(1, 6))
        told = {"highway": "residential"}
        if way % 2:
            told |= tags
        osm.way([nodes[index] for index in picked], told)
    path = osm.write(tmp_path, "any.osm")

    refusal = ""
    try:
        source = read_openstreetmap(path)
    except InputError as error:
        refusal = str(error)

    if refusal:
        assert "expected a map with roads" in refusal
        return

    known = {"", *ids(source.junctions)}
    for lane in source.lanes:
        assert {lane.from_junction, lane.to_junction} <= known
    assert len(set(ids(source.lanes))) == len(source.lanes)


@pytest.fixture(scope="module")
def small_pbf(tmp_path_factory):
    """The small map as PBF, not packed, so that changed bytes matter."""
    import osmium

    folder = tmp_path_factory.mktemp("pbf")
    text = folder / "map.osm"
    text.write_text(SMALL)
    binary = folder / "map.osm.pbf"
    target = osmium.io.File(str(binary), "pbf,pbf_compression=none")

    with osmium.SimpleWriter(target) as writer:
        for element in osmium.FileProcessor(str(text)):
            writer.add(element)
    return binary.read_bytes()


def test_pbf_is_the_same_map(small_pbf, tmp_path):
    one = read_text(SMALL, tmp_path)
    two = read_text(small_pbf, tmp_path, "map.osm.pbf")

    assert ids(one.lanes) == ids(two.lanes)
    assert ids(one.things) == ids(two.things)


def test_a_zero_byte_in_a_text_never_reaches_osmium(small_pbf, tmp_path):
    # It would read on behind its memory, and the process would end there.
    broken = small_pbf.replace(b"residential", b"resi\0ential")
    with pytest.raises(InputError, match="a zero byte in a text"):
        read_text(broken, tmp_path, "map.osm.pbf")


def test_pbf_is_read_up_to_a_limit(small_pbf, tmp_path, monkeypatch):
    monkeypatch.setitem(DEFAULTS["reading"], "max_unpacked_bytes", 1000)
    with pytest.raises(InputError, match="more than 1,000 bytes when unpacked"):
        read_text(small_pbf, tmp_path, "map.osm.pbf")


# ---------------------------------------------------- maps that nobody here made


def arm_counts(source):
    """How many junctions have each number of arms, three or more."""
    assert_lanes_end_at_outlines(source)
    counts = Counter(len(arm_lanes(source, one)) for one in source.junctions)
    assert min(counts) >= 3
    return counts


@pytest.mark.long
def test_neukolln(real_input):
    source = read_openstreetmap(real_input("osm/neukolln.osm"))
    assert not source.keeps_left

    poles = Counter(pole.kind for pole in source.poles)
    assert poles["lamp post"] == 52
    assert poles["traffic light"] == 5

    classes = Counter(thing.class_name for thing in source.things)
    # 210 in the file; the outlines of those with parts and what is being built are not
    # here, and two are in three for the passages that lead through them
    assert classes["building"] == 192
    assert classes["vegetation"] == 145 + 8  # trees and hedges
    assert len(source.crosswalks_m) == 18
    assert arm_counts(source) == {3: 5, 4: 1}

    busiest = next(one for one in source.junctions if one.id == "n27554990")
    assert busiest.name == "Karl-Marx-Straße / Karl-Marx-Platz / Thomasstraße"
    assert arm_lanes(source, busiest) == {
        "east": (1, 0),
        "north": (1, 1),
        "west": (1, 1),
        "south": (2, 1),
    }


def test_seattle(real_input):
    source = read_openstreetmap(real_input("osm/seattle_triangle.osm"))
    assert arm_counts(source) == {6: 1}
    assert source.junctions[0].name == "8th Avenue / Westlake Avenue / Lenora Street"
    assert {pole.kind for pole in source.poles} == {"traffic light"}
    assert {thing.class_name for thing in source.things} == {"building"}


@pytest.mark.long  # smaller ones, quickly: test_neukolln, test_pbf_is_the_same_map
def test_town_in_pbf(real_input):
    source = read_openstreetmap(real_input("osm/test.osm.pbf"))
    # Two more have roads that the cut-out clips to stubs.
    assert arm_counts(source).total() == 109
    assert sum(thing.class_name == "building" for thing in source.things) == 2174

    bridges = [lane for lane in source.lanes if lane.centreline_m[:, 2].max() > 4.0]
    assert bridges  # over the motorway
    assert len(source.skipped) < 20


# ---------------------------------------------------------------- online


BBOX = (13.39, 52.49, 13.41, 52.51)


def answer_with(monkeypatch, content):
    """Answer every request with a content, or with an error; the questions asked."""
    asked = []

    def raise_for_status():
        if not content:
            raise OSError("503")

    def post(url, *, data, timeout):
        assert url.startswith("https://")
        assert timeout > 0.0
        asked.append(data["data"])
        return types.SimpleNamespace(content=content, raise_for_status=raise_for_status)

    requests = types.SimpleNamespace(post=post, RequestException=OSError)
    monkeypatch.setitem(sys.modules, "requests", requests)
    return asked


def test_a_fetched_map_can_be_read(tmp_path, monkeypatch):
    asked = answer_with(monkeypatch, SMALL.encode())
    path = tmp_path / "map.osm"
    fetch_openstreetmap(BBOX, path)

    assert "(52.4900000,13.3900000,52.5100000,13.4100000)" in asked[0]
    assert len(read_openstreetmap(path).junctions) == 1


@pytest.mark.parametrize("content", [b"", b"<html>busy</html>"])
def test_a_server_that_does_not_answer_with_a_map_leaves_no_file(
    content, tmp_path, monkeypatch
):
    answer_with(monkeypatch, content)
    with pytest.raises(InputError, match="https://"):
        fetch_openstreetmap(BBOX, tmp_path / "map.osm")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "bbox",
    [
        (13.41, 52.49, 13.39, 52.51),
        (13.0, 52.0, 13.5, 52.1),
        (179.99, 0.0, 180.01, 0.1),
        (1.0, 2.0),
    ],
)
def test_a_box_that_is_none_is_refused(bbox, tmp_path):
    with pytest.raises(InputError, match="bbox"):
        fetch_openstreetmap(bbox, tmp_path / "map.osm")


def test_the_extra_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "requests", None)
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[online\]"):
        fetch_openstreetmap(BBOX, tmp_path / "map.osm")


def test_garching(real_input):
    source = read_openstreetmap(real_input("osm/garching_intersection.osm"))
    lines = source.crosswalks_m

    assert len(lines) == 5  # one way is an L over two arms
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1).max() < 10.1

    busiest = max(source.junctions, key=lambda junction: len(junction.roads))
    for arm in arms_of(source, busiest).arms.values():
        # Each is crossed square to its lanes.
        if arm.lanes_in:
            line = arm.lanes_in[0].centreline_m
            ahead = line[-1] - line[-2]
        else:
            line = arm.lanes_out[0].centreline_m
            ahead = line[1] - line[0]
        cosine = ahead @ arm.crosswalk.direction / np.linalg.norm(ahead)
        assert abs(cosine) < 0.3
