"""Assumed poles stand beside every way; mapped ones stay where they are."""

import pytest
import shapely
from osm_drawing import drawn

from geometry.maps.importing import ImportOptions, ReadingOptions, import_scene
from geometry.notes import assumed_sites

# Along the south of the road that leads west, whose kerb lies at -2.75 m; one of its
# nodes lies 20 m before the mouth.
WAY = "-100 -4, -20 -4, -0.5 -4"


def scene_of(osm, folder, sites="auto"):
    """The scene of a drawing."""
    reading = ReadingOptions(keeps_left=False)
    options = ImportOptions(sites=sites, reading=reading)
    return import_scene([osm.write(folder)], options).scene


def crossing(text):
    """A drawing of a crossing with signals, and of what lies there, too."""
    osm = drawn("node 0 0: highway=traffic_signals")
    for street, end in enumerate(("100 0", "0 100", "-100 0", "0 -100")):
        osm.draw(f"road 0 0, {end}: name=Street {street}")
    return osm.draw(text)


def clearance_m(scene, site):
    """Distance of a site from the middle of the way."""
    way = shapely.LineString([(-100.0, -4.0), (-0.5, -4.0)])
    middle = scene.outline_m.mean(axis=0)  # (0, 0) of the drawing
    return way.distance(shapely.Point(site.position_m[:2] - middle))


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
    osm = crossing(f"way {WAY}: {tags}")
    scene = scene_of(osm, tmp_path, sites)
    assumed = assumed_sites(scene.notes)
    west = [site for site in scene.sites if site.position_m[0] < -3.0]

    assert len(west) >= 2
    for site in west:
        assert site.id in assumed
        assert clearance_m(scene, site) >= half_m + 0.2


@pytest.mark.parametrize(
    "tags", ["highway=cycleway; layer=1; bridge=yes", "highway=pedestrian; area=yes"]
)
def test_bridges_and_squares_leave_poles_where_they_are(tags, tmp_path):
    scene = scene_of(crossing(f"way {WAY}: {tags}"), tmp_path)
    plain = scene_of(crossing(""), tmp_path)
    places = [site.position_m.tolist() for site in scene.sites]

    assert places == [site.position_m.tolist() for site in plain.sites]


@pytest.mark.parametrize(
    "tag", ["highway=traffic_signals", "traffic_sign=DE:240", "highway=street_lamp"]
)
def test_what_is_a_node_of_a_way_is_an_assumed_pole_beside_it(tag, tmp_path):
    osm = crossing(f"""
        node -20 -4: {tag}
        way {WAY}: highway=cycleway; width=2
    """)
    scene = scene_of(osm, tmp_path, "map")
    (site,) = (one for one in scene.sites if one.id == f"n{osm.nodes[-20, -4]}")
    why = str(assumed_sites(scene.notes)[site.id])

    assert "mapped on a way: a pole beside it is assumed" in why
    assert "moved 1.2 m beside it" in why or "moved 1.3 m beside it" in why
    assert clearance_m(scene, site) == pytest.approx(1.25, abs=0.1)


def test_a_lamp_mapped_beside_a_footway_stays_and_is_surveyed(tmp_path):
    """Its own place counts, although half the usual width covers it."""
    osm = crossing(f"""
        way {WAY}: highway=footway
        node -30 -4.6: highway=street_lamp
    """)
    scene = scene_of(osm, tmp_path, "map")
    (site,) = (one for one in scene.sites if one.id == f"n{osm.ids[-1]}")

    assert site.id not in assumed_sites(scene.notes)
    assert clearance_m(scene, site) == pytest.approx(0.6, abs=0.05)


def test_a_senseless_width_of_a_way_is_told(tmp_path):
    scene = scene_of(crossing(f"way {WAY}: highway=cycleway; width=broad"), tmp_path)
    assert any("width makes no sense" in str(note.why) for note in scene.notes)
