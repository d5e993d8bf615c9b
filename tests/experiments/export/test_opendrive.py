"""Roads as OpenDRIVE: read back by our own reader, which knows nothing of the
writer.
"""

import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.export.opendrive import to_opendrive
from geometry.junction import CONNECTING, build_junction
from geometry.maps.importing import read_map, survey_junctions
from geometry.scene import Lane
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout


@pytest.fixture(scope="module")
def scene():
    """The study's junction."""
    return load_study_scene()


def written(tmp_path: Path, scene) -> Path:
    """The study's roads and cameras, as a file."""
    path = tmp_path / "roads.xodr"
    path.write_text(to_opendrive(load_carlancap_layout(), scene))
    return path


def driving(lanes) -> list[np.ndarray]:
    """Centrelines of lanes for driving."""
    return [
        np.asarray(lane.centreline_m)[:, :2] for lane in lanes if lane.kind == "driving"
    ]


def off_m(line: np.ndarray, others: list[np.ndarray]) -> float:
    """Largest distance of a line's points from the nearest of others."""
    from shapely import LineString, Point

    points = [Point(place) for place in line]
    farthest_m = []
    for other in others:
        chain = LineString(other)
        farthest_m.append(max(chain.distance(point) for point in points))

    return min(farthest_m)


def worst_m(lines: list[np.ndarray], others: list[np.ndarray]) -> float:
    """Largest distance of any of several lines from the nearest of others."""
    return max(off_m(line, others) for line in lines)


def with_ways(scene, source):
    """A scene whose map has the ways through the junction that another map has."""
    ways = [
        Lane(
            id=way.id,
            kind=CONNECTING,
            width_m=way.width_m,
            centreline_m=way.centreline_m[:, :2],
        )
        for way in source.connections
    ]
    return replace(scene, lanes=(*scene.lanes, *ways))


@pytest.mark.long
def test_lanes_are_read_back_where_they_are(tmp_path, scene):
    source = read_map(written(tmp_path, scene))
    ours = driving(scene.lanes)
    theirs = driving(source.lanes)

    assert len(ours) == len(theirs)
    assert worst_m(ours, theirs) < 0.01

    (one,) = survey_junctions(source)
    junction = build_junction(scene)

    assert set(one.arms) == set(junction.arms)


@pytest.mark.long
def test_ways_of_the_map_are_read_back_and_none_is_assumed(tmp_path, scene):
    source = read_map(written(tmp_path, scene))
    some = with_ways(scene, replace(source, connections=source.connections[:5]))
    again = read_map(written(tmp_path, some))
    ways = [lane.centreline_m for lane in some.lanes if lane.kind == CONNECTING]
    read = [lane.centreline_m[:, :2] for lane in again.connections]

    assert len(read) == len(ways) == 5
    assert worst_m(ways, read) < 0.05


@pytest.mark.long
def test_a_mirrored_scene_keeps_left(tmp_path, scene):
    flip = np.array([1.0, -1.0])
    lanes = []
    for lane in scene.lanes:
        lanes.append(replace(lane, centreline_m=lane.centreline_m * flip))

    turned = replace(
        scene,
        lanes=tuple(lanes),
        outline_m=scene.outline_m * flip,
        keeps_left=True,
    )
    source = read_map(written(tmp_path, turned))

    assert source.keeps_left

    ours = driving(turned.lanes)
    theirs = driving(source.lanes)

    assert worst_m(ours, theirs) < 0.01


@pytest.mark.long
def test_from_each_lane_a_way_to_each_other_arm_is_assumed(tmp_path, scene):
    arms = build_junction(scene).arms.values()
    source = read_map(written(tmp_path, scene))
    n_entries = sum(len(arm.entry_lanes) for arm in arms)
    n_others = len(arms) - 1

    assert len(source.connections) == n_entries * n_others


@pytest.mark.long
def test_poles_stand_where_the_units_hang(tmp_path, scene):
    """A pole may be read as one, or as a thing that stands there."""
    source = read_map(written(tmp_path, scene))
    read = [pole.position_m[:2] for pole in source.poles]
    for thing in source.things:
        read.append(thing.vertices_m[:, :2].mean(axis=0))

    for unit in load_carlancap_layout().units:
        place = unit.pose.position_m[:2]
        distances_m = np.linalg.norm(np.array(read) - place, axis=1)
        assert distances_m.min() < 0.2


def test_a_lane_that_widens_has_no_step(tmp_path, scene):
    """A way through begins as wide as the lane before it, and ends as wide as the one
    after it.
    """
    first = next(lane for lane in scene.lanes if lane.kind == "driving")
    lanes = []
    for lane in scene.lanes:
        if lane is first:
            lane = replace(lane, width_m=5.0)
        lanes.append(lane)

    widened = replace(scene, lanes=tuple(lanes))
    text = to_opendrive(load_carlancap_layout(), widened)
    # A width begins at a, and grows by b a metre.
    widths = re.findall(r'<width sOffset="0.0" a="([\d.]+)" b="(-?[\d.e-]+)"', text)
    narrows = any(float(a) == 5.0 and float(b) < 0.0 for a, b in widths)
    widens = any(float(b) > 0.0 for _, b in widths)

    assert narrows or widens


def test_a_single_straight_lane_is_a_road(tmp_path):
    line = np.array(
        [
            [-50.0, 0.0],
            [-9.0, 0.0],
        ]
    )
    lane = Lane(
        id="a",
        kind="driving",
        width_m=3.0,
        centreline_m=line,
    )
    scene = load_study_scene()
    square = np.array(
        [
            [-9.0, -9.0],
            [9.0, -9.0],
            [9.0, 9.0],
            [-9.0, 9.0],
        ]
    )
    alone = replace(scene, lanes=(lane,), outline_m=square)
    text = to_opendrive(load_carlancap_layout(), alone)

    assert text.count("<road ") == 1
    assert 'length="41.0"' in text


def test_netconvert_accepts_it(tmp_path, scene):
    """SUMO's converter makes a net of it, in which lanes are connected."""
    programs = Path(sys.executable).parent
    netconvert = shutil.which("netconvert", path=str(programs))
    if netconvert is None:
        pytest.skip("SUMO (extra traffic) is not installed")

    path = written(tmp_path, scene)
    net = tmp_path / "net.xml"
    done = subprocess.run(
        [netconvert, "--opendrive-files", path, "-o", net],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == 0, done.stderr
    assert "Error" not in done.stderr
    assert "<connection " in net.read_text()
