"""Ramps and slip roads: lanes that begin beside the road that they leave."""

import numpy as np
import pytest
import shapely

from geometry.maps.importing import ImportOptions, import_scene, read_map
from geometry.maps.source_map import MapLane, SourceMap

from ...support.osm_text import OsmText, as_drawn

ROAD = {"highway": "secondary", "name": "North Way", "maxspeed": "50"}
LINK = {"highway": "secondary_link", "oneway": "yes"}
WIDTH_M = 3.25


def crossing(
    *,
    parts: list[tuple[float, dict[str, str]]],
    link_lanes: int = 1,
    side: float = -1.0,
    is_merge: bool = False,
) -> OsmText:
    """A road from north to south through a signal, with a slip road beside it.

    Parameters
    ----------
    parts : list of (float, dict of str to str)
        Where each part of the road begins, from north to south, and its tags. [m]
    link_lanes : int
        Of the slip road.
    side : float
        -1: it lies west of the road, 1: east.
    is_merge : bool
        It comes from the crossing road and joins the road 70 m south of it; else it
        leaves the road 70 m north.
    """
    osm = OsmText()
    signal = osm.node(0.0, 0.0, highway="traffic_signals")
    north = -70.0 if is_merge else 70.0
    fork = osm.node(0.0, north)
    at = {0.0: signal, north: fork}
    ends = [place for place, _ in parts[1:]] + [-160.0]
    for (begin, tags), end in zip(parts, ends, strict=True):
        between = [one for one in at if end < one < begin]
        places = [begin, *sorted(between, reverse=True), end]
        for place in places:
            if place not in at:
                at[place] = osm.node(0.0, place)
        osm.way([at[place] for place in places], ROAD | tags)
    cross = {"highway": "secondary", "name": "East Way", "lanes": "2"}
    corner = osm.node(45.0 * side, 0.0)
    osm.way([(-150.0, 0.0), *([corner] if side < 0 else []), signal], cross)
    osm.way([signal, *([corner] if side > 0 else []), (150.0, 0.0)], cross)
    turn = -1.0 if is_merge else 1.0
    between = [(10.0 * side, 40.0 * turn), (30.0 * side, 15.0 * turn)]
    nodes = [fork, *between, corner]
    if is_merge:
        nodes = nodes[::-1]
    osm.way(nodes, LINK | {"lanes": str(link_lanes)})
    return osm


def one_way(lanes: int, **tags: str) -> dict[str, str]:
    return {"oneway": "yes", "lanes": str(lanes)} | tags


KINDS = {
    "plain": {"parts": [(160.0, one_way(2))]},
    "widened": {"parts": [(160.0, one_way(2)), (76.0, one_way(3))]},
    "two lanes of its own": {"parts": [(160.0, one_way(2))], "link_lanes": 2},
    "to the left": {"parts": [(160.0, one_way(2))], "side": 1.0},
    "of a road with both directions": {"parts": [(160.0, {"lanes": "2"})]},
    "that joins": {"parts": [(160.0, one_way(2))], "is_merge": True},
}


@pytest.fixture(params=KINDS)
def slip(request, tmp_path) -> tuple[SourceMap, dict]:
    made = KINDS[request.param]
    path = crossing(**made).write(tmp_path, "slip.osm")
    return as_drawn(read_map(path)), made


def slip_lanes(source: SourceMap) -> list[MapLane]:
    return [lane for lane in driving(source) if lane.road_class == "secondary_link"]


def driving(source: SourceMap) -> list[MapLane]:
    return [lane for lane in source.lanes if lane.kind == "driving"]


def test_a_slip_lane_begins_beside_the_lane_next_to_it(slip):
    source, made = slip
    lanes = slip_lanes(source)
    assert len(lanes) == made.get("link_lanes", 1)
    side = made.get("side", -1.0)
    n_main = 2
    if made["parts"][-1][1].get("lanes") == "3":
        n_main = 3
    half_m = 0.5 * n_main * WIDTH_M
    if "oneway" not in made["parts"][0][1]:
        half_m = WIDTH_M
    tips = []
    for lane in lanes:
        tip = lane.centreline_m[-1 if made.get("is_merge") else 0]
        tips.append(float(side * tip[0]))
    wanted = [half_m + (number + 0.5) * WIDTH_M for number in range(len(lanes))]
    assert sorted(tips) == pytest.approx(wanted, abs=0.05)


def test_a_slip_lane_never_lies_on_the_road_that_it_leaves(slip):
    source, _ = slip
    road = [
        lane
        for lane in driving(source)
        if lane.road_class == "secondary" and np.ptp(lane.centreline_m[:, 0]) < 10.0
    ]
    for lane in slip_lanes(source):
        line = shapely.LineString(lane.centreline_m[:, :2])
        for other in road:
            away = line.distance(shapely.LineString(other.centreline_m[:, :2]))
            assert away > WIDTH_M - 0.05


def test_the_roads_lanes_go_on_past_the_slip_lane(slip):
    source, _ = slip
    ends = []
    for lane in driving(source):
        line = lane.centreline_m[:, :2]
        if lane.road_class != "secondary" or np.ptp(line[:, 0]) > 10.0:
            continue
        # They stay on the road, and go on where they end at no junction.
        assert np.abs(line[:, 0]).max() < 5.0
        if not lane.to_junction and abs(line[-1, 1]) < 150.0:
            ends.append(line[-1])
    begins = [lane.centreline_m[0, :2] for lane in driving(source)]
    for end in ends:
        assert min(np.hypot(*(begin - end)) for begin in begins) < 1e-6


def test_no_note_says_that_the_map_ends_where_the_slip_lane_begins(slip, tmp_path):
    scene = import_scene([tmp_path / "slip.osm"], ImportOptions()).scene
    assert not [note for note in scene.notes if "no farther" in str(note.why)]


def test_a_lane_that_ends_goes_on_into_the_slip_lane(tmp_path):
    parts = [(160.0, one_way(3)), (70.0, one_way(2))]
    source = as_drawn(read_map(crossing(parts=parts).write(tmp_path)))
    (slip,) = slip_lanes(source)
    before = sorted(
        (lane for lane in driving(source) if lane.centreline_m[0, 1] > 150.0),
        key=lambda lane: lane.centreline_m[0, 0],
    )
    after = [
        lane
        for lane in driving(source)
        if lane.to_junction and np.ptp(lane.centreline_m[:, 0]) < 3.0
    ]
    kerb, *others = (lane.centreline_m[-1, :2] for lane in before)
    assert slip.centreline_m[0, :2] == pytest.approx(kerb, abs=1e-6)
    begins = sorted(lane.centreline_m[0, 0] for lane in after)
    assert begins == pytest.approx([end[0] for end in others], abs=1e-6)


def test_roads_that_both_lead_away_do_not_follow_each_other(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    osm.way([middle, (0.0, 100.0)], ROAD | one_way(1))
    osm.way([middle, (0.0, -100.0)], ROAD | one_way(1))
    source = read_map(osm.write(tmp_path))
    assert len(driving(source)) == 2


@pytest.mark.parametrize(("is_link", "n_lanes"), [(False, 2), (True, 4)])
def test_a_ramp_does_not_go_on_round_a_sharp_corner(is_link, n_lanes, tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    osm.way([(-100.0, 0.0), middle], ROAD | {"lanes": "2"})
    tags = {"highway": "secondary", "lanes": "2"}
    if is_link:
        tags["highway"] = "secondary_link"
    osm.way([middle, (-50.0, 87.0)], tags)
    assert len(driving(read_map(osm.write(tmp_path)))) == n_lanes
