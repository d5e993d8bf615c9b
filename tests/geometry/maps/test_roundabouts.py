"""Roundabouts: lanes around the ring, the island, and what is refused."""

from itertools import combinations

import numpy as np
import pytest
import shapely
from osm_drawing import drawn

from geometry.errors import InputError
from geometry.junction import CONNECTING
from geometry.maps.importing import ImportOptions, import_scene, read_map
from geometry.scene import area_of, containing_instance, paved_area, road_area
from geometry.scene_checks import check_scene

from ...support.lanelet_text import lanelet2
from ...support.roundabout_maps import (
    lanelet_roundabout,
    opendrive_roundabout,
    roundabout,
)

KINDS = {
    "15 m": {},
    "8 m": {"radius_m": 8.0},
    "80 m": {"radius_m": 80.0},
    "two lanes": {"radius_m": 20.0, "ring_lanes": 2, "arm_lanes": 4},
    "three lanes": {"radius_m": 30.0, "ring_lanes": 3, "arm_lanes": 6},
    "more lanes on the ring": {"radius_m": 20.0, "ring_lanes": 2},
    "more lanes on the arms": {"radius_m": 20.0, "arm_lanes": 4},
    "traffic keeps left": {"keeps_left": True},
    "an oval": {"stretched": 1.6},
    "eight nodes": {"n_nodes": 8},
    "five arms": {"radius_m": 12.0, "arms_deg": (0.0, 70.0, 145.0, 215.0, 290.0)},
    "three arms": {"arms_deg": (0.0, 120.0, 240.0)},
    "splitter islands": {"radius_m": 18.0, "is_split": True},
}


def read(tmp_path, **ring):
    """The map of a roundabout."""
    return read_map(roundabout(**ring).write(tmp_path, "ring.osm"))


@pytest.fixture(scope="module", params=KINDS)
def ring(request, tmp_path_factory):
    """A map with one roundabout, and what it was made of."""
    made = KINDS[request.param]
    return read(tmp_path_factory.mktemp("ring"), **made), made


def test_every_entry_has_a_way_to_all_other_arms(ring):
    source, made = ring
    n_arms = len(made.get("arms_deg", range(4)))
    (junction,) = source.junctions

    assert junction.fault == ""

    ends = {}
    begins = {}
    for lane in source.lanes:
        arm = lane.id.split()[0]
        if lane.to_junction:
            ends[place_of(lane, -1)] = arm
        if lane.from_junction:
            begins[place_of(lane, 0)] = arm

    # From the very end of a lane to the very begin of another one.
    pairs = {
        (ends[place_of(way, 0)], begins[place_of(way, -1)])
        for way in source.connections
    }

    assert len(pairs) == n_arms * (n_arms - 1)
    assert {entry for entry, _ in pairs} == set(ends.values())


def place_of(lane, tip):
    """Where a lane begins (0) or ends (-1), to be compared."""
    return tuple(lane.centreline_m[tip, :2].round(6))


def test_ways_are_continuous_and_on_the_carriageway(ring):
    source, _ = ring
    (junction,) = source.junctions
    paved = paved_area(junction.outline_m, junction.islands_m).buffer(0.3)

    for way in source.connections:
        line = way.centreline_m[:, :2]
        steps = np.diff(line, axis=0)
        east, north = steps.T
        yaw = np.unwrap(np.arctan2(north, east))
        turns = np.diff(yaw)

        assert np.abs(np.degrees(turns)).max() < 15.0
        assert np.linalg.norm(steps, axis=-1).max() < 25.0
        assert paved.contains(shapely.LineString(line).buffer(0.9, cap_style="flat"))


def test_ways_lead_around_the_island_in_the_direction_of_traffic(ring):
    source, made = ring
    (junction,) = source.junctions
    (island,) = junction.islands_m
    middle = island.mean(axis=0)
    sign = 1.0
    if made.get("keeps_left"):
        sign = -1.0

    for way in source.connections:
        east, north = (way.centreline_m[:, :2] - middle).T
        angle = sign * np.degrees(np.unwrap(np.arctan2(north, east)))
        assert angle[-1] - angle[0] > 20.0
        # Rounding the kerb never leads back by much.
        assert (np.maximum.accumulate(angle) - angle).max() < 6.0
        assert not shapely.LineString(way.centreline_m).intersects(area_of(island))


def test_ways_from_one_arm_into_another_do_not_cross(ring):
    source, made = ring
    (island,) = source.junctions[0].islands_m
    middle = shapely.get_coordinates(area_of(island).centroid)[0]

    lines = {}
    for way in source.connections:
        arms = tuple(lane.split()[0] for lane in way.id.split(" to "))
        lines.setdefault(arms, []).append(shapely.LineString(way.centreline_m))

    for ways in lines.values():
        for one, other in combinations(ways, 2):
            # On a lane of the ring that they share, their chords differ.
            met = shapely.get_coordinates(shapely.intersection(one, other))
            if one.crosses(other):
                far_m = np.linalg.norm(met - middle, axis=-1)
                assert far_m == pytest.approx(made["radius_m"], abs=0.1)


@pytest.mark.parametrize("radius_m", [8.0, 15.0, 30.0])
def test_the_middle_of_the_lane_bends_as_the_ring_does(radius_m, tmp_path):
    source = read(tmp_path, radius_m=radius_m)
    (junction,) = source.junctions
    points = np.concatenate([way.centreline_m for way in source.connections])
    far_m = np.linalg.norm(points[:, :2] - junction.position_m, axis=-1)

    assert far_m.min() == pytest.approx(radius_m, abs=0.05)


# ---------- rings that are mapped as a node
@pytest.mark.parametrize(
    ("turn", "keeps_left"),
    [
        ("anticlockwise", 0),
        ("clockwise", 1),
    ],
)
def test_a_mini_roundabout_is_a_small_ring(turn, keeps_left, tmp_path):
    osm = drawn(f"node 0 0: highway=mini_roundabout; direction={turn}")
    for end in ("150 0", "0 150", "-150 15", "0 -150"):
        osm.draw(f"road 0 0, {end}: name=Lane; lanes=2")

    source = read_map(osm.write(tmp_path))

    assert source.keeps_left == bool(keeps_left)

    (junction,) = source.junctions
    assert junction.id == f"n{osm.ids[0]}"
    assert len(junction.islands_m) == 1
    assert len(source.connections) == 12
    assert [note.why for note in source.skipped] == [
        "its ring is not mapped: a usual one is assumed around the node"
    ]


def test_two_mini_roundabouts_side_by_side_stay_two(tmp_path):
    osm = drawn("""
        node 0 0: highway=mini_roundabout
        node 18 0: highway=mini_roundabout
        road -120 0, 0 0
        road 0 0, 18 0
        road 18 0, 150 10
        road 0 0, 0 150
        road 18 0, 20 -150
    """)
    source = read_map(osm.write(tmp_path))

    assert [len(one.islands_m) for one in source.junctions] == [1, 1]
    assert len(source.connections) == 12


# ---------- the island
@pytest.mark.long
def test_the_island_is_no_carriageway_and_carries_poles(tmp_path):
    osm = roundabout()
    lamp = osm.node(2.0, 1.0, highway="street_lamp")
    road = osm.node(0.0, 15.0 + 1e-4, highway="street_lamp")
    building = [osm.node(-5.0, -5.0), osm.node(0.0, -5.0), osm.node(0.0, -1.0)]
    osm.way([*building, building[0]], {"building": "yes", "height": "6"})
    path = osm.write(tmp_path)
    scene = import_scene([path], ImportOptions(sites="map")).scene
    (island,) = scene.islands_m
    sites = {site.id: site.position_m[:2] for site in scene.sites}
    middle = island.mean(axis=0)

    assert np.linalg.norm(sites[f"n{lamp}"] - middle - [2.0, 1.0], axis=-1) < 0.1
    assert not road_area(scene).intersects(shapely.Point(sites[f"n{lamp}"]))

    # What was mapped on the ring stands beside it.
    moved = shapely.Point(sites[f"n{road}"])
    assert not road_area(scene).intersects(moved)
    assert not [one for one in check_scene(scene) if one.level == "error"]

    inside = np.append(middle + [-2.0, -4.0], 1.0)
    assert containing_instance(scene, inside) is not None


def test_ways_around_the_ring_are_lanes_of_the_scene(tmp_path):
    path = roundabout().write(tmp_path)
    scene = import_scene([path], ImportOptions()).scene

    assert sum(lane.kind == CONNECTING for lane in scene.lanes) == 12
    assert not [note for note in scene.notes if "no farther" in str(note.why)]


# ---------- what cannot be laid
@pytest.mark.parametrize(
    ("made", "why"),
    [
        ({"gap": 2}, "a roundabout whose ring is not closed in the map"),
        ({"oneway": "no"}, "a roundabout whose ring is driven both ways"),
        ({"radius_m": 5.0, "ring_lanes": 3}, "a roundabout whose ring leaves no room"),
    ],
)
def test_a_ring_that_cannot_be_laid_is_refused_in_one_line(made, why, tmp_path):
    path = roundabout(**made).write(tmp_path, "ring.osm")
    skipped = read_map(path).skipped
    (note,) = [one for one in skipped if "roundabout" in str(one.why)]

    assert str(note.what) == "junction n1"
    with pytest.raises(InputError, match=f"ring.osm: junction n1: got {why}"):
        import_scene([path], ImportOptions())


def test_a_ring_against_the_side_of_traffic_is_refused(tmp_path):
    path = roundabout(driving_side="left").write(tmp_path)
    with pytest.raises(InputError, match="runs against the side of traffic"):
        import_scene([path], ImportOptions())


# ---------- other formats
@pytest.mark.parametrize("is_one_junction", [True, False])
def test_a_ring_of_opendrive_is_one_junction(is_one_junction, tmp_path):
    path = tmp_path / "ring.xodr"
    path.write_text(opendrive_roundabout(is_one_junction=is_one_junction))
    check_drawn(read_map(path))


def test_a_ring_of_lanelets_is_one_junction(tmp_path):
    path = tmp_path / "ring.osm"
    path.write_text(lanelet2(lanelet_roundabout()))
    check_drawn(read_map(path))


def check_drawn(source):
    """A map has one junction with four arms around an island of 13.5 m."""
    (junction,) = source.junctions
    (island,) = junction.islands_m
    assert area_of(island).area == pytest.approx(np.pi * 13.5**2, rel=0.02)
    assert sum(bool(lane.to_junction) for lane in source.lanes) == 4
    # To the other arms, and where lanes are drawn one by one back again.
    assert len(source.connections) in (12, 16)


def test_a_block_of_one_way_streets_is_no_roundabout(tmp_path):
    osm = drawn("""
        road 0 0, 60 0, 60 60, 0 60, 0 0: oneway=yes
        road 0 0, -90 0
        road 60 0, 60 -90
        road 60 60, 150 60
        road 0 60, 0 150
    """)
    source = read_map(osm.write(tmp_path))

    assert len(source.junctions) == 4
    assert not any(junction.islands_m for junction in source.junctions)
