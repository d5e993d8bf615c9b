"""The same roundabout as OpenStreetMap, OpenDRIVE and Lanelet2: the same runs."""

from collections import Counter
from dataclasses import replace

import pytest
import shapely
from case_speeds import at_first_speed

from geometry.maps.importing import ImportOptions, import_scene
from scenarios.cases import load_cases
from scenarios.positions import build_positions
from scenarios.runs import build_runs

from ..support.lanelet_text import lanelet2
from ..support.roundabout_maps import (
    lanelet_roundabout,
    opendrive_roundabout,
    roundabout,
)

pytestmark = pytest.mark.long
TEXTS = {
    "ring.xodr": lambda: opendrive_roundabout(is_one_junction=True),
    "lanelets.osm": lambda: lanelet2(lanelet_roundabout()),
    "ring.osm": lambda: roundabout().text(),
}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Scene of each format, without the speed limits that one of them has."""
    folder = tmp_path_factory.mktemp("rings")
    found = {}
    for name, text in TEXTS.items():
        path = folder / name
        path.write_text(text())
        scene = import_scene([path], ImportOptions()).scene
        lanes = tuple(replace(lane, speed_limit_kmh=None) for lane in scene.lanes)
        found[name] = replace(scene, lanes=lanes)

    return found


@pytest.fixture(scope="module")
def runs(scenes, actors, rule):
    """Runs of every case on each scene, at the first speed of each case."""
    cases = [at_first_speed(case) for case in load_cases().values()]
    positions = build_positions([0.0, 15.0])

    found = {}
    for name, scene in scenes.items():
        laid, _ = build_runs(
            scene,
            cases,
            vut=actors["vut"],
            rule=rule,
            positions=positions,
        )
        found[name] = laid

    return found


@pytest.mark.parametrize("name", ["lanelets.osm", "ring.osm"])
def test_formats_differ_by_one_run_in_twenty_at_most(runs, name):
    by_case = Counter(run.case.name for run in runs["ring.xodr"])
    others = Counter(run.case.name for run in runs[name])

    assert others.total() == pytest.approx(by_case.total(), rel=0.05)
    assert by_case.keys() == others.keys()


@pytest.mark.parametrize("name", TEXTS)
def test_nobody_drives_over_the_island(runs, scenes, name):
    (island_m,) = scenes[name].islands_m
    island = shapely.Polygon(island_m).buffer(-0.5)
    for run in runs[name]:
        assert not shapely.LineString(run.vut_position_m).intersects(island)
