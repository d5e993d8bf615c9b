"""Ramps and slip roads: lanes that begin beside the road that they leave."""

import numpy as np
import pytest
import shapely
from osm_drawing import drawn
from osm_text import as_drawn

from geometry.maps.importing import ImportOptions, import_scene, read_map

WIDTH_M = 3.25
ROAD = "highway=secondary; name=North Way; maxspeed=50"
TWO = "oneway=yes; lanes=2"
THREE = "oneway=yes; lanes=3"


def crossing(*, parts, link_lanes=1, side=-1, is_merge=False):
    """A road from north to south through a signal, with a slip road beside it.

    Parameters
    ----------
    parts : list of (list of float, str)
        The road's places north of the origin, and its tags, from north to south. Places
        are the signal at 0, where the slip road leaves or joins, and others. [m]
    link_lanes : int
        Of the slip road.
    side : int
        -1: it lies west of the road, 1: east.
    is_merge : bool
        It comes from the crossing road and joins the road 70 m south of it; else it
        leaves the road 70 m north.
    """
    osm = drawn("node 0 0: highway=traffic_signals")
    for places, tags in parts:
        points = ", ".join(f"0 {north_m}" for north_m in places)
        osm.draw(f"way {points}: {ROAD}; {tags}")

    corner = f"{45 * side} 0"
    link = [corner, f"{30 * side} -15", f"{10 * side} -40", "0 -70"]
    if not is_merge:
        link = ["0 70", f"{10 * side} 40", f"{30 * side} 15", corner]
    west = "-150 0, 0 0"
    east = f"0 0, {corner}, 150 0"
    if side < 0:
        west = f"-150 0, {corner}, 0 0"
        east = "0 0, 150 0"
    return osm.draw(f"""
        way {west}: highway=secondary; name=East Way; lanes=2
        way {east}: highway=secondary; name=East Way; lanes=2
        way {", ".join(link)}: highway=secondary_link; oneway=yes; lanes={link_lanes}
    """)


WHOLE = [160, 70, 0, -160]
# Each with half the width of the road where the slip lane begins. [m]
KINDS = {
    "plain": ({"parts": [(WHOLE, TWO)]}, WIDTH_M),
    "widened": (
        {"parts": [([160, 76], TWO), ([76, 70, 0, -160], THREE)]},
        1.5 * WIDTH_M,
    ),
    "two lanes of its own": ({"parts": [(WHOLE, TWO)], "link_lanes": 2}, WIDTH_M),
    "to the left": ({"parts": [(WHOLE, TWO)], "side": 1}, WIDTH_M),
    "of a road with both directions": ({"parts": [(WHOLE, "lanes=2")]}, WIDTH_M),
    "that joins": ({"parts": [([160, 0, -70, -160], TWO)], "is_merge": True}, WIDTH_M),
}


@pytest.fixture(params=KINDS)
def slip(request, tmp_path):
    """A map with a slip lane, what it was made of, and half the width of its road."""
    made, half_m = KINDS[request.param]
    path = crossing(**made).write(tmp_path, "slip.osm")
    return as_drawn(read_map(path)), made, half_m


def driving(source, road_class=""):
    """Driving lanes, of one class or all."""
    lanes = [lane for lane in source.lanes if lane.kind == "driving"]
    return [lane for lane in lanes if road_class in ("", lane.road_class)]


def slip_lanes(source):
    """Lanes of the slip road."""
    return driving(source, "secondary_link")


def test_a_slip_lane_begins_beside_the_lane_next_to_it(slip):
    source, made, half_m = slip
    lanes = slip_lanes(source)

    assert len(lanes) == made.get("link_lanes", 1)

    tips = []
    for lane in lanes:
        x = lane.centreline_m[:, 0] * made.get("side", -1)
        if made.get("is_merge"):
            tips.append(x[-1])
        else:
            tips.append(x[0])

    expected = [half_m + (number + 0.5) * WIDTH_M for number in range(len(lanes))]

    assert sorted(tips) == pytest.approx(expected, abs=0.05)


def test_a_slip_lane_never_lies_on_the_road_that_it_leaves(slip):
    source, *_ = slip
    for lane in slip_lanes(source):
        line = shapely.LineString(lane.centreline_m[:, :2])
        for other in driving(source, "secondary"):
            points = other.centreline_m[:, :2]
            if np.ptp(points[:, 0]) < 10.0:
                away_m = line.distance(shapely.LineString(points))
                assert away_m > WIDTH_M - 0.05


def test_the_roads_lanes_go_on_past_the_slip_lane(slip):
    source, *_ = slip
    ends = []

    for lane in driving(source, "secondary"):
        line = lane.centreline_m[:, :2]
        if np.ptp(line[:, 0]) > 10.0:
            continue
        # They stay on the road, and go on where they end at no junction.
        assert np.abs(line[:, 0]).max() < 5.0
        if not lane.to_junction and abs(line[-1, 1]) < 150.0:
            ends.append(line[-1])

    begins = [lane.centreline_m[0, :2] for lane in driving(source)]
    for end in ends:
        assert min(np.linalg.norm(begin - end) for begin in begins) < 1e-6


def test_no_note_says_that_the_map_ends_where_the_slip_lane_begins(slip, tmp_path):
    scene = import_scene([tmp_path / "slip.osm"], ImportOptions()).scene
    assert not [note for note in scene.notes if "no farther" in str(note.why)]


def test_a_lane_that_ends_goes_on_into_the_slip_lane(tmp_path):
    osm = crossing(parts=[([160, 70], THREE), ([70, 0, -160], TWO)])
    source = as_drawn(read_map(osm.write(tmp_path)))
    (slip,) = slip_lanes(source)
    before = [
        lane.centreline_m for lane in driving(source) if lane.centreline_m[0, 1] > 150.0
    ]
    kerb, *others = (line[-1] for line in sorted(before, key=lambda line: line[0, 0]))

    assert slip.centreline_m[0, :2] == pytest.approx(kerb[:2], abs=1e-6)

    after = [lane.centreline_m for lane in driving(source) if lane.to_junction]
    begins = sorted(line[0, 0] for line in after if np.ptp(line[:, 0]) < 3.0)

    assert begins == pytest.approx([end[0] for end in others], abs=1e-6)


def test_roads_that_both_lead_away_do_not_follow_each_other(tmp_path):
    osm = drawn(f"""
        way 0 0, 0 100: {ROAD}; oneway=yes; lanes=1
        way 0 0, 0 -100: {ROAD}; oneway=yes; lanes=1
    """)
    source = read_map(osm.write(tmp_path))
    assert len(driving(source)) == 2


@pytest.mark.parametrize(
    ("road_class", "n_lanes"),
    [
        ("secondary", 2),
        ("secondary_link", 4),
    ],
)
def test_a_ramp_does_not_go_on_round_a_sharp_corner(road_class, n_lanes, tmp_path):
    osm = drawn(f"""
        way -100 0, 0 0: {ROAD}; lanes=2
        way 0 0, -50 87: highway={road_class}; lanes=2
    """)
    source = read_map(osm.write(tmp_path))
    assert len(driving(source)) == n_lanes
