"""Assumed poles stand beside every way; mapped ones stay where they are."""

from pathlib import Path

import numpy as np
import pytest
import shapely
from osm_tags import tags_of
from osm_text import OsmText, crossing

from geometry.maps.importing import ImportOptions, ReadingOptions, import_scene
from geometry.notes import assumed_sites
from geometry.scene import Scene

FOUR = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
# Kerbs of the crossing lie 2.75 m from the middles of its roads.
WAY_M = 4.0


def scene_of(osm: OsmText, folder: Path, sites: str = "auto") -> Scene:
    reading = ReadingOptions(keeps_left=False)
    options = ImportOptions(sites=sites, reading=reading)
    return import_scene([osm.write(folder)], options).scene


def beside_road(*tags: str) -> tuple[OsmText, list[int]]:
    """A crossing with signals, and a way along the south of the road that leads west.

    Returned are the nodes of the way, too: the middle one lies 20 m before the mouth.
    """
    osm = OsmText()
    middle = crossing(osm, bearings=FOUR)
    osm.parts[middle - 1] = osm.parts[middle - 1].replace(
        "></node>", '><tag k="highway" v="traffic_signals"/></node>'
    )
    places = [(-100.0, -WAY_M), (-20.0, -WAY_M), (-0.5, -WAY_M)]
    nodes = [osm.node(*place) for place in places]
    osm.way(nodes, tags_of(*tags))
    return osm, nodes


def clearance_m(scene: Scene, position_m: np.ndarray) -> float:
    """Distance of a place from the middle of the way, in the drawing's own place."""
    way = shapely.LineString([(-100.0, -WAY_M), (-0.5, -WAY_M)])
    middle = scene.outline_m.mean(axis=0)
    return float(way.distance(shapely.Point(position_m[:2] - middle)))


@pytest.mark.parametrize(
    ("tags", "half_m"),
    [
        ("highway=cycleway; width=2", 1.0),
        ("highway=cycleway", 1.0),
        ("highway=footway", 0.9),
        ("highway=path; width=3,5", 1.75),
        ("highway=pedestrian", 1.5),
        ("highway=service; service=driveway", 1.5),
        ("highway=residential; motor_vehicle=no", 1.5),
        ("railway=tram", 1.5),
    ],
)
@pytest.mark.parametrize(
    "sites", ["auto", pytest.param("kerb:5", marks=pytest.mark.long)]
)
def test_assumed_poles_stand_beside_every_way(tags, half_m, sites, tmp_path):
    osm, _ = beside_road(tags)
    scene = scene_of(osm, tmp_path, sites)
    assumed = assumed_sites(scene.notes)
    west = [site for site in scene.sites if site.position_m[0] < -3.0]
    assert len(west) >= 2
    for site in west:
        assert site.id in assumed
        assert clearance_m(scene, site.position_m) >= half_m + 0.2


@pytest.mark.parametrize(
    "tags", ["highway=cycleway; layer=1; bridge=yes", "highway=pedestrian; area=yes"]
)
def test_bridges_and_squares_leave_poles_where_they_are(tags, tmp_path):
    osm, _ = beside_road(tags)
    plain = OsmText()
    plain.parts = osm.parts[:-1]
    places = [
        [site.position_m.tolist() for site in scene_of(one, tmp_path).sites]
        for one in (osm, plain)
    ]
    assert places[0] == places[1]


@pytest.mark.parametrize(
    "kind", ["highway=traffic_signals", "traffic_sign=DE:240", "highway=street_lamp"]
)
def test_what_is_a_node_of_a_way_is_an_assumed_pole_beside_it(kind, tmp_path):
    osm, nodes = beside_road("highway=cycleway; width=2")
    key, value = kind.split("=")
    at = nodes[1] - 1
    tag = f'><tag k="{key}" v="{value}"/></node>'
    osm.parts[at] = osm.parts[at].replace("></node>", tag)
    scene = scene_of(osm, tmp_path, "map")
    (site,) = (one for one in scene.sites if one.id == f"n{nodes[1]}")
    why = str(assumed_sites(scene.notes)[site.id])
    assert "mapped on a way: a pole beside it is assumed" in why
    assert "moved 1.2 m beside it" in why or "moved 1.3 m beside it" in why
    assert clearance_m(scene, site.position_m) == pytest.approx(1.25, abs=0.1)


def test_a_lamp_mapped_beside_a_footway_stays_and_is_surveyed(tmp_path):
    """Its own place counts, although half the usual width covers it."""
    osm, _ = beside_road("highway=footway")
    lamp = osm.node(-30.0, -WAY_M - 0.6, highway="street_lamp")
    scene = scene_of(osm, tmp_path, "map")
    (site,) = (one for one in scene.sites if one.id == f"n{lamp}")
    assert site.id not in assumed_sites(scene.notes)
    assert clearance_m(scene, site.position_m) == pytest.approx(0.6, abs=0.05)


def test_a_senseless_width_of_a_way_is_told(tmp_path):
    osm, _ = beside_road("highway=cycleway; width=broad")
    scene = scene_of(osm, tmp_path)
    assert any("width makes no sense" in str(note.why) for note in scene.notes)
