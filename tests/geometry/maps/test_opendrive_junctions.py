"""Junctions: outlines, what ends there, names."""

import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose
from opendrive_text import (
    arms_of,
    crossing,
    cubic,
    document,
    geometry,
    lane,
    read_text,
    road,
    section,
    to_junction,
    to_road,
)

COMPASS = ("east", "north", "west", "south")


def off_outline_m(source):
    """How far a driving lane ends from the outline of its junction, at most."""
    rings = {
        one.id: shapely.Polygon(one.outline_m).exterior for one in source.junctions
    }
    away_m = []
    for one in source.lanes:
        if one.kind != "driving":
            continue
        for junction, tip in ((one.from_junction, 0), (one.to_junction, -1)):
            if junction:
                point = shapely.Point(one.centreline_m[tip, :2])
                away_m.append(rings[junction].distance(point))

    return max(away_m)


def ends_of(source):
    """Junctions from which lanes come and to which they lead, by their ids."""
    return {one.id: (one.from_junction, one.to_junction) for one in source.lanes}


def straight(name, x, y=0.0, *, length, **more):
    """A straight road that begins at a place, east unless told otherwise."""
    plan = geometry(x=x, y=y, hdg=more.pop("hdg", 0.0), length=length)
    return road(name, plan=plan, length=length, **more)


def test_a_curved_connecting_road_is_a_lane_on_its_circle(tmp_path):
    radius_m = 9.0
    length_m = 4.5 * np.pi
    curve = geometry(f'<arc curvature="{1.0 / radius_m}"/>', length=length_m)
    turn = road(
        "20",
        plan=curve,
        length=length_m,
        junction="9",
        sections=section(right=[lane(-1, width=3.0), lane(-2, "sidewalk")]),
    )
    widening = lane(-1, width=cubic("width", 0.0, 0.0, 0.2))
    widens = straight(
        "21",
        0.0,
        40.0,
        length=20.0,
        junction="9",
        sections=section(right=[widening]),
    )
    source = read_text(tmp_path, document(crossing(), turn, widens))
    # The lane 21/-1 begins without a width: it does not lead from end to end.
    ids = [one.id for one in source.connections]

    assert ids == ["11/1", "11/-1", "12/1", "12/-1", "20/-1"]
    assert not set(ids) & {one.id for one in source.lanes}

    found = source.connections[-1]
    assert found.from_junction == "9"
    assert found.to_junction == "9"
    assert found.width_m == pytest.approx(3.0)

    points = found.centreline_m[:, :2]
    middles = 0.5 * (points[1:] + points[:-1])

    for places, most_m in ((points, 1.0e-9), (middles, 0.003)):
        off_m = np.abs(
            np.linalg.norm(places - [0.0, radius_m], axis=-1) - (radius_m + 1.5)
        )
        assert off_m.max() <= most_m
    assert points[0] == pytest.approx([0.0, -1.5])
    assert points[-1] == pytest.approx([radius_m + 1.5, radius_m])


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_two_streets_that_cross_make_four_arms(tmp_path, rule):
    source = read_text(tmp_path, document(crossing(rule=rule)))
    (junction,) = source.junctions

    assert junction.name == "East Street / North Street"

    # A cross of two strips 7 m wide and 20 m long.
    area_m2 = shapely.Polygon(junction.outline_m).area
    assert area_m2 == pytest.approx(2 * 140 - 49, rel=1e-2)
    assert arms_of(source, junction) == dict.fromkeys(COMPASS, (1, 1))

    # Roads lead away from the junction.
    into = "1"
    out_of = "-1"
    if rule == "LHT":
        into = "-1"
        out_of = "1"

    expected = {}
    for number in "1234":
        expected[f"{number}/{into}"] = ("", "9")
        expected[f"{number}/{out_of}"] = ("9", "")

    assert ends_of(source) == expected


def test_the_outline_is_where_the_lanes_of_the_arms_end(tmp_path):
    plain = read_text(tmp_path, document(crossing()))
    assert off_outline_m(plain) < 0.1


def test_holes_are_filled_and_the_largest_part_counts(tmp_path):
    plan = np.array(
        [
            [20.0, 0.0, 0.0],
            [60.0, 0.0, 90.0],
            [60.0, 40.0, 180.0],
            [20.0, 40.0, 270.0],
            [500.0, 0.0, 0.0],
        ]
    )
    ring = ""
    for number, (x, y, angle_deg) in enumerate(plan):
        hdg = np.radians(angle_deg)
        ring += straight(str(number), x, y, hdg=hdg, length=40.0, junction="9")

    source = read_text(tmp_path, document(ring, '<junction id="9" name="ring"/>'))
    (junction,) = source.junctions

    assert junction.outline_m[:, 0].max() < 100.0

    shape = shapely.Polygon(junction.outline_m)
    assert shape.contains(shapely.Point(40.0, 20.0))
    assert junction.name == "ring"


def test_the_height_is_that_of_the_middle(tmp_path):
    text = document(crossing()).replace(
        "<elevationProfile></elevationProfile>",
        '<elevationProfile><elevation s="0" a="7" b="0" c="0"'
        ' d="0"/></elevationProfile>',
    )
    assert read_text(tmp_path, text).junctions[0].height_m == pytest.approx(7.0)


@pytest.mark.parametrize("begin_m", [16.0, 6.0])  # of 10: too far out, inside
def test_an_arm_is_led_on_to_the_outline_or_cut_off_there(tmp_path, begin_m):
    text = document(crossing())
    text = text.replace('x="10.0" y="0.0"', f'x="{begin_m}" y="0.0"')
    source = read_text(tmp_path, text)

    assert arms_of(source, source.junctions[0])["east"] == (1, 1)
    assert off_outline_m(source) <= 1.5


def test_an_arm_far_away_does_not_end_there(tmp_path):
    text = document(crossing()).replace('x="10.0" y="0.0"', 'x="300.0" y="0.0"')
    source = read_text(tmp_path, text)
    ends = ends_of(source)

    assert ends["1/1"] == ends["1/-1"] == ("", "")
    assert [note.what for note in source.skipped] == [
        "2 lanes that end far from their junction, such as "
        "lane 1/1 at junction 9 and lane 1/-1 at junction 9"
    ]


@pytest.mark.parametrize("kind", ["direct", "virtual"])
def test_junctions_without_a_surface_are_noted(tmp_path, kind):
    source = read_text(tmp_path, document(crossing(kind=kind)))
    assert not source.junctions
    assert set(ends_of(source).values()) == {("", "")}
    assert source.skipped[0].what == f"junction 9 ({kind})"


def test_a_junction_without_connecting_roads_is_noted(tmp_path):
    text = document(road(link=to_junction("successor", "9")), '<junction id="9"/>')
    source = read_text(tmp_path, text)

    assert not source.junctions
    assert set(ends_of(source).values()) == {("", "")}
    assert source.skipped[0].why == "it has no connecting road with a driving lane"


def test_links_to_what_there_is_not_are_noted(tmp_path):
    link = to_junction("predecessor", "77") + to_road("successor", "78", "start")
    source = read_text(tmp_path, document(road(link=link)))

    assert [note.what for note in source.skipped] == [
        "2 links to missing roads or junctions, such as road 1, link to junction 77 "
        "and road 1, link to road 78"
    ]
    assert len(source.lanes) == 2


def test_a_road_without_link_ends_where_a_connecting_road_says(tmp_path):
    text = document(crossing()).replace(to_junction("predecessor", "9"), "", 1)
    source = read_text(tmp_path, text)
    assert {one.from_junction + one.to_junction for one in source.lanes} == {"9"}


def test_a_junction_that_only_joins_two_roads_is_one(tmp_path):
    parts = [
        road("1", length=50.0, link=to_junction("successor", "9")),
        straight("2", 60.0, length=50.0, link=to_junction("predecessor", "9")),
        straight("3", 50.0, length=10.0, junction="9"),
        '<junction id="9"/>',
    ]
    source = read_text(tmp_path, document(*parts))
    assert arms_of(source, source.junctions[0]) == {"east": (1, 1), "west": (1, 1)}


def test_a_stub_of_a_road_at_the_mouth_belongs_to_the_road_beyond(tmp_path):
    link = to_junction("predecessor", "9")
    to_east = to_road("successor", "1", "start")
    stub = straight("5", 10.0, length=1.0, link=link + to_east)
    text = document(crossing(), stub)
    changes = (
        (
            'x="10.0" y="0.0" hdg="0.0" length="50.0"',
            'x="11.0" y="0.0" hdg="0.0" length="50.0"',
        ),
        (link, to_road("predecessor", "5", "end")),
        (to_east, to_road("successor", "5", "start")),
    )

    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)

    source = read_text(tmp_path, text)
    assert arms_of(source, source.junctions[0])["east"] == (1, 1)

    lanes = {one.id: one for one in source.lanes}
    assert not {"5/1", "5/-1"} & set(lanes)

    coming = lanes["1/1"]
    ends_m = coming.centreline_m[[0, -1], :2]

    assert_allclose(ends_m, np.array([[61.0, 1.75], [10.0, 1.75]]))
    assert coming.from_junction == ""
    assert coming.to_junction == "9"

    x = lanes["1/-1"].centreline_m[:, 0]
    assert_allclose(x[[0, -1]], [10, 61])
    assert (np.diff(x) > 0).all()


def test_sidewalks_are_no_part_of_the_surface(tmp_path):
    sides = section(left=[lane(1), lane(2, "sidewalk", width=9.0)], right=[lane(-1)])
    inside = road("3", length=20.0, junction="9", sections=sides)
    parts = [inside, '<junction id="9"/>']
    source = read_text(tmp_path, document(*parts))
    (junction,) = source.junctions

    assert np.abs(junction.outline_m[:, 1]).max() == pytest.approx(3.5, abs=0.1)


@pytest.mark.parametrize("length_m", [2.0e-7, 5.0e-4])
def test_a_road_without_a_length_is_a_joint_between_its_neighbours(tmp_path, length_m):
    def read(before, *more):
        into = to_road("predecessor", before, "end")
        out_of = to_road("successor", "2", "start")
        parts = [
            straight("2", 70.0, length=50.0, link=to_junction("predecessor", "9")),
            straight("3", 50.0, length=20.0, junction="9", link=into + out_of),
            f'<junction id="9"><connection id="0" incomingRoad="{before}"'
            ' connectingRoad="3" contactPoint="start"/></junction>',
        ]
        return read_text(tmp_path, document(*more, *parts))

    into_junction = to_junction("successor", "9")
    plain = read("1", road("1", length=50.0, link=into_junction))
    from_road = to_road("predecessor", "1", "end")
    joint = straight("8", 50.0, length=length_m, link=from_road + into_junction)
    into_joint = to_road("successor", "8", "start")
    joined = read("8", road("1", length=50.0, link=into_joint), joint)

    assert list(ends_of(joined).items()) == list(ends_of(plain).items())
    assert any(one.to_junction == "9" for one in joined.lanes)

    (told,) = joined.skipped
    assert told.what == "road 8"
    assert told.why == "shorter than 1 mm: its neighbours are joined"


@pytest.mark.parametrize(
    ("types", "limit_kmh"),
    [
        ('<type s="0" type="town"><speed max="50" unit="km/h"/></type>', 50.0),
        ('<type s="0" type="town"><speed max="10"/></type>', 36.0),
        ('<type s="0" type="town"><speed max="25" unit="mph"/></type>', 40.2),
        ('<type s="0" type="town"><speed max="no limit"/></type>', None),
        ('<type s="0" type="town"/>', None),
        (
            (
                '<type s="30" type="rural"><speed max="70" '
                'unit="km/h"/></type><type s="0" type="town"><speed max="30" '
                'unit="km/h"/></type>'
            ),
            30.0,
        ),
    ],
)
def test_roads_have_speed_limits_where_they_lead_into_the_junction(
    tmp_path, types, limit_kmh
):
    text = document(crossing()).replace("<planView>", f"{types}<planView>", 1)
    lanes = {lane.id: lane for lane in read_text(tmp_path, text).lanes}

    assert lanes["1/1"].to_junction == "9"
    assert lanes["1/1"].speed_limit_kmh == limit_kmh
    assert lanes["1/-1"].speed_limit_kmh == limit_kmh  # where it leads out
    assert lanes["2/1"].speed_limit_kmh is None


def test_a_lanes_own_speed_limit_is_before_its_roads(tmp_path):
    types = '<type s="0" type="town"><speed max="50" unit="km/h"/></type><planView>'
    own = '<lane id="1" type="driving" ><speed sOffset="0" max="30" unit="km/h"/>'
    text = document(crossing()).replace("<planView>", types, 1)
    text = text.replace('<lane id="1" type="driving" >', own, 1)
    lanes = {lane.id: lane for lane in read_text(tmp_path, text).lanes}

    assert [lanes[name].speed_limit_kmh for name in ("1/1", "1/-1")] == [30.0, 50.0]


@pytest.mark.parametrize(
    ("n_motorways", "sidewalk", "n_junctions"),
    [
        (4, False, 0),
        (4, True, 1),
        (3, False, 1),
    ],
)
def test_where_motorways_meet_is_no_junction(
    tmp_path, n_motorways, sidewalk, n_junctions
):
    motorway = '<type s="0" type="motorway"/><planView>'
    text = document(crossing()).replace("<planView>", motorway, n_motorways)
    if sidewalk:
        text = text.replace("<left>", f"<left>{lane(2, 'sidewalk')}", 1)
    source = read_text(tmp_path, text)

    assert len(source.junctions) == n_junctions
    assert len(source.connections) == 4

    told = ["junction 9"] * (1 - n_junctions)
    assert [note.what for note in source.skipped] == told
