"""Files of OpenStreetMap data: formats, damage, sizes, and maps that nobody here
made.
"""

import re
import sys
import types
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from osm_text import OsmText, arm_lanes, arms_of, crossing

from geometry.errors import InputError, MissingExtraError
from geometry.junction import distance_to_outline_m
from geometry.maps.openstreetmap import fetch_openstreetmap, read_openstreetmap
from geometry.maps.openstreetmap.elements import DEFAULTS
from geometry.maps.source_map import SourceMap, parse_length_m


def small_map() -> OsmText:
    """A bit of everything."""
    osm = OsmText()
    middle = crossing(
        osm,
        bearings=[(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)],
        lanes="2",
        width="10",
        parking__both="lane",
        cycleway__right="lane",
    )
    osm.road([(0.0, -60.0), middle], oneway="-1", turn__lanes="left|right", lanes="2")
    ring = [(20.0, 20.0), (30.0, 20.0), (30.0, 30.0), (20.0, 30.0), (20.0, 20.0)]
    osm.way(ring, {"building": "yes", "building:levels": "3", "min_height": "1"})
    outer = osm.way([(x + 30.0, y) for x, y in ring])
    inner = osm.way([(52.0, 22.0), (55.0, 22.0), (55.0, 25.0), (52.0, 22.0)])
    osm.relation(
        [(outer, "outer"), (inner, "inner")],
        {"type": "multipolygon", "building": "yes", "height": "9"},
    )
    osm.way([(-20.0, 20.0), (-40.0, 25.0)], {"barrier": "wall", "height": "2"})
    osm.way([(-20.0, 40.0), (-40.0, 45.0)], {"natural": "tree_row"})
    osm.node(-20.0, -20.0, natural="tree", diameter_crown="4")
    osm.node(-30.0, -20.0, highway="street_lamp", height="8")
    signal = osm.node(
        -30.0, -40.0, highway="traffic_signals", traffic_signals__direction="both"
    )
    walk = osm.node(-40.0, -40.0, highway="crossing")
    osm.road(
        [(-60.0, -40.0), walk, signal, (-10.0, -40.0)], highway="service", layer="1"
    )
    return osm


SMALL = small_map().text()


def read_text(text: str | bytes, folder: Path, name: str = "map.osm") -> SourceMap:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_openstreetmap(path)


# ---------------------------------------------------------------- formats


def test_the_content_of_a_file_tells_its_format(tmp_path: Path) -> None:
    plain = read_text(SMALL, tmp_path)
    assert len(plain.things) == 8
    assert len(plain.poles) == 3
    assert len(plain.junctions) == 1
    packed = SMALL.encode()
    for name, content in (
        ("map", packed),  # what it is shows in the file itself
        (
            "utf16.osm",
            SMALL.replace('"1.0"?', '"1.0" encoding="UTF-16"?').encode("utf-16"),
        ),
    ):
        other = read_text(content, tmp_path, name)
        assert [lane.id for lane in other.lanes] == [lane.id for lane in plain.lanes]
        for one, two in zip(plain.lanes, other.lanes, strict=True):
            np.testing.assert_array_equal(one.centreline_m, two.centreline_m)


def test_the_map_lies_around_its_roads_and_says_where(tmp_path):
    source = read_text(SMALL, tmp_path)
    assert source.source_crs == "EPSG:4326"
    assert source.heights == "above ground"
    assert re.fullmatch(
        r"\+proj=tmerc \+lat_0=52\.5\d+ \+lon_0=13\.4\d+ \+k=1 \+x_0=0 \+y_0=0"
        r" \+datum=WGS84 "
        r"\+units=m \+no_defs",
        source.crs,
    )
    ends = np.concatenate([lane.centreline_m[:, :2] for lane in source.lanes])
    np.testing.assert_allclose(ends.min(axis=0) + ends.max(axis=0), 0.0, atol=10.0)


def test_ids_are_unique(tmp_path):
    source = read_text(SMALL, tmp_path)
    for items in (source.lanes, source.things, source.poles, source.junctions):
        ids = [item.id for item in items]
        assert len(set(ids)) == len(ids)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got something else; expected OpenStreetMap data, XML or PBF"),
        ("<gpx></gpx>", "got Unknown top-level element: gpx"),
        (SMALL[:500], "got XML parsing error at line 7"),
        (SMALL.replace('version="0.6"', ""), "without version"),
        (SMALL.replace('id="2"', 'id="two"'), "got illegal id: 'two'"),
        (
            re.sub(r'lat="52\.\d+"', 'lat="north"', SMALL, count=1),
            "coordinate: 'north'",
        ),
        (
            re.sub(r'lat="52\.\d+"', 'lat="95"', SMALL, count=1),
            (
                "map.osm: node 1: got latitude 95.0, longitude 13.4; expected latitude"
                " -90..90 and longitude -180..180"
            ),
        ),
        (re.sub(r'lat="52\.\d+"', "", SMALL, count=1), "node 1: got no coordinates"),
        (
            re.sub(r'lat="52\.\d+"', 'lat="50"', SMALL, count=1),
            "got roads from latitude 50 to 52.",
        ),
        ('<osm version="0.6"></osm>', "got no nodes; expected a map with roads"),
        (
            '<osm version="0.6"><node id="1" lat="1" lon="1"/></osm>',
            "got no road for cars; expected a map with roads",
        ),
        (
            '<!DOCTYPE osm [<!ENTITY a "aaaaaaaa">]>' + SMALL.partition("\n")[2],
            "XML entities are not supported",
        ),
        (
            (
                '<osm version="0.6"><node id="1" lat="1" lon="1"/><way id="1"><nd'
                ' ref="1"/><nd ref="1"/><tag k="highway" v="primary"/></way></osm>'
            ),
            "got no road with two nodes; expected a map with roads",
        ),
        (SMALL.replace("Street 0", "S" * 70_000), "too long"),
    ],
)
def test_what_is_no_map_is_told_in_one_line(text, message, tmp_path):
    with pytest.raises(InputError) as caught:
        read_text(text, tmp_path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "map.osm"))
    assert "\n" not in str(caught.value)


def test_too_many_elements_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    text = '<osm version="0.6">' + "".join(
        f'<node id="{one}" lat="{lat}" lon="1"/>'
        for one, lat in ((1, 1.0), (2, 1.5), (2, 1.001))
    )
    text += (
        '<way id="1"><nd ref="1"/><nd ref="2"/><tag k="highway"'
        ' v="primary"/></way></osm>'
    )
    lane = read_text(text, tmp_path).lanes[0]
    assert np.ptp(lane.centreline_m[:, 1]) == pytest.approx(110.6, abs=0.1)


def test_elements_may_come_in_any_order(tmp_path):
    head, *elements, tail = SMALL.strip().split("\n")[1:]
    backwards = "\n".join([head, *elements[::-1], tail])
    source = read_text(SMALL, tmp_path)
    other = read_text(backwards, tmp_path)
    assert {thing.id for thing in source.things} == {thing.id for thing in other.things}
    for one, two in zip(source.junctions, other.junctions, strict=True):
        assert one.id == two.id
        assert one.name == two.name
        areas = [_area_m2(junction.outline_m) for junction in (one, two)]
        assert areas[0] == pytest.approx(areas[1], rel=1e-3)


def _area_m2(outline_m: np.ndarray) -> float:
    x, y = outline_m.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def test_lengths_are_understood_as_people_write_them():
    for text, length_m in (
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
    ):
        assert parse_length_m(text) == pytest.approx(length_m), text
    for text in (
        "",
        "m",
        "wide",
        "-3",
        "3 parsecs",
        "1e9",
        "nan",
        "3..",
        "٣",
        "9" * 50,
    ):
        assert parse_length_m(text) is None, text


# ---------------------------------------------------------------- fuzzing

_FUZZ = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
_ODD = [
    "",
    "0",
    "-1",
    "yes",
    "no",
    "1e308",
    "NaN",
    "3|4|",
    "🙂",
    "12'3\"",
    "99999999999",
    "left",
]


@pytest.mark.long
@_FUZZ
@given(
    tags=st.dictionaries(
        st.sampled_from(
            [
                "lanes",
                "lanes:forward",
                "lanes:backward",
                "oneway",
                "width",
                "width:lanes",
                "turn:lanes",
                "parking:left",
                "parking:both:orientation",
                "cycleway",
                "sidewalk",
                "junction",
                "layer",
                "bridge",
                "lanes:both_ways",
                "highway",
                "service",
                "name",
            ]
        ),
        st.sampled_from(
            [
                *_ODD,
                "1",
                "2",
                "3",
                "5",
                "both",
                "lane",
                "track",
                "roundabout",
                "primary_link",
                "service",
                "motorway",
                "2.5|3",
                "-3",
                "separate",
            ]
        ),
    ),
    seed=st.integers(0, 10**6),
)
def test_roads_that_lie_anyhow_are_read(tags, seed, tmp_path):
    rng = np.random.default_rng(seed)
    osm = OsmText()
    nodes = [osm.node(*rng.uniform(-60.0, 60.0, 2)) for _ in range(12)]
    for way in range(7):
        picked = [nodes[index] for index in rng.integers(0, 12, rng.integers(1, 6))]
        osm.way(picked, {"highway": "residential"} | (tags if way % 2 else {}))
    path = osm.write(tmp_path, "any.osm")
    refusal = ""
    try:
        source = read_openstreetmap(path)
    except InputError as error:
        refusal = str(error)
    if refusal:
        assert "expected a map with roads" in refusal
        return
    outlines = {junction.id: junction.outline_m for junction in source.junctions}
    for lane in source.lanes:
        assert {lane.from_junction, lane.to_junction} <= {"", *outlines}
    assert len({lane.id for lane in source.lanes}) == len(source.lanes)


@pytest.fixture(scope="module")
def small_pbf(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The small map as PBF, not packed, so that changed bytes matter."""
    import osmium

    folder = tmp_path_factory.mktemp("pbf")
    (folder / "map.osm").write_text(SMALL)
    target = osmium.io.File(str(folder / "map.osm.pbf"), "pbf,pbf_compression=none")
    with osmium.SimpleWriter(target) as writer:
        for element in osmium.FileProcessor(str(folder / "map.osm")):
            writer.add(element)
    return (folder / "map.osm.pbf").read_bytes()


def test_pbf_is_the_same_map(small_pbf, tmp_path):
    one = read_text(SMALL, tmp_path)
    two = read_text(small_pbf, tmp_path, "map.osm.pbf")
    assert [lane.id for lane in one.lanes] == [lane.id for lane in two.lanes]
    assert [thing.id for thing in one.things] == [thing.id for thing in two.things]


def test_a_zero_byte_in_a_text_never_reaches_osmium(small_pbf, tmp_path):
    # It would read on behind its memory, and the process would end there.
    with pytest.raises(InputError, match="a zero byte in a text"):
        read_text(
            small_pbf.replace(b"residential", b"resi\0ential"), tmp_path, "map.osm.pbf"
        )


def test_pbf_is_read_up_to_a_limit(small_pbf, tmp_path, monkeypatch):
    monkeypatch.setitem(DEFAULTS["reading"], "max_unpacked_bytes", 1000)
    with pytest.raises(InputError, match="more than 1,000 bytes when unpacked"):
        read_text(small_pbf, tmp_path, "map.osm.pbf")


# ---------------------------------------------------- maps that nobody here made


def _check(source: SourceMap) -> Counter[int]:
    """Every junction has three arms or more, and lanes end at its outline; counts of
    arms.
    """
    counts: Counter[int] = Counter()
    for junction in source.junctions:
        counts[len(arm_lanes(source, junction))] += 1
        for lane in source.lanes:
            for tip, name in ((0, lane.from_junction), (-1, lane.to_junction)):
                if name == junction.id and lane.kind == "driving":
                    point = lane.centreline_m[tip, :2]
                    assert distance_to_outline_m(point, junction.outline_m) <= 1.0
    assert min(counts) >= 3
    return counts


@pytest.mark.long
def test_neukolln(real_input):
    source = read_openstreetmap(real_input("osm/neukolln.osm"))
    assert not source.keeps_left
    assert Counter(pole.kind for pole in source.poles)["lamp post"] == 52
    assert Counter(pole.kind for pole in source.poles)["traffic light"] == 5
    classes = Counter(thing.class_name for thing in source.things)
    # 210 in the file; the outlines of those with parts and what is being built are not
    # here, and two are in three for the passages that lead through them
    assert classes["building"] == 192
    assert classes["vegetation"] == 145 + 8  # trees and hedges
    assert len(source.crosswalks_m) == 18
    assert _check(source) == {3: 5, 4: 1}
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
    assert _check(source) == {6: 1}
    assert source.junctions[0].name == "8th Avenue / Westlake Avenue / Lenora Street"
    assert {pole.kind for pole in source.poles} == {"traffic light"}
    assert {thing.class_name for thing in source.things} == {"building"}


@pytest.mark.long  # smaller ones, quickly: test_neukolln, test_pbf_is_the_same_map
def test_town_in_pbf(real_input):
    source = read_openstreetmap(real_input("osm/test.osm.pbf"))
    assert (
        len(source.junctions) == 109
    )  # two more have roads that the cut-out clips to stubs
    assert sum(_check(source).values()) == 109
    assert sum(thing.class_name == "building" for thing in source.things) == 2174
    bridges = [lane for lane in source.lanes if lane.centreline_m[:, 2].max() > 4.0]
    assert bridges  # over the motorway
    assert len(source.skipped) < 20


# ---------------------------------------------------------------- online


class _Answer:
    def __init__(self, content: bytes) -> None:
        self.content = content

    def raise_for_status(self) -> None:
        if not self.content:
            raise OSError("503")


def _stub(monkeypatch: pytest.MonkeyPatch, content: bytes) -> list[str]:
    asked: list[str] = []

    def post(url: str, *, data: dict[str, str], timeout: float) -> _Answer:
        assert url.startswith("https://")
        assert timeout > 0.0
        asked.append(data["data"])
        return _Answer(content)

    requests = types.SimpleNamespace(post=post, RequestException=OSError)
    monkeypatch.setitem(sys.modules, "requests", requests)
    return asked


def test_a_fetched_map_can_be_read(tmp_path, monkeypatch):
    asked = _stub(monkeypatch, SMALL.encode())
    path = tmp_path / "map.osm"
    fetch_openstreetmap((13.39, 52.49, 13.41, 52.51), path)
    assert "(52.4900000,13.3900000,52.5100000,13.4100000)" in asked[0]
    assert len(read_openstreetmap(path).junctions) == 1


def test_a_server_that_does_not_answer_with_a_map_leaves_no_file(tmp_path, monkeypatch):
    for content in (b"", b"<html>busy</html>"):
        _stub(monkeypatch, content)
        with pytest.raises(InputError, match="https://"):
            fetch_openstreetmap((13.39, 52.49, 13.41, 52.51), tmp_path / "map.osm")
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
        fetch_openstreetmap((13.39, 52.49, 13.41, 52.51), tmp_path / "map.osm")


def test_garching(real_input):
    source = read_openstreetmap(real_input("osm/garching_intersection.osm"))
    lines = source.crosswalks_m
    assert len(lines) == 5  # one way is an L over two arms
    assert np.hypot(*(lines[:, 1] - lines[:, 0]).T).max() < 10.1
    arms = arms_of(source, max(source.junctions, key=lambda one: len(one.roads))).arms
    for arm in arms.values():  # each is crossed square to its lanes
        lane = (arm.lanes_in or arm.lanes_out)[0]
        along = np.diff(
            lane.centreline_m[-2:] if arm.lanes_in else lane.centreline_m[:2], axis=0
        )
        cosine = abs(float((along @ arm.crosswalk.direction)[0])) / float(
            np.hypot(*along[0])
        )
        assert cosine < 0.3
