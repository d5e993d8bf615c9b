"""What an import assumes stays with the scene, on disk, too."""

from osm_drawing import FOUR, drawn_crossing
from osm_text import LAT_DEG, LON_DEG, OsmText

from geometry.maps.importing import ImportOptions, import_scene
from geometry.notes import Note, assumed_sites, assumptions
from geometry.scene_files import load_scene_folder, save_scene


def bare_map(tmp_path):
    """Two crossings without poles or buildings, nothing that shows the side of the
    road.
    """
    osm = drawn_crossing("highway=residential")
    middle = osm.node(340.0, 0.0)
    osm.road([(300.0, 0.0), middle, (380.0, 0.0)])
    osm.road([(340.0, -40.0), middle])
    return osm.write(tmp_path)


def test_a_bare_map_tells_all_that_was_assumed(tmp_path):
    scene = import_scene([bare_map(tmp_path)], ImportOptions()).scene
    told = [(note.kind, note.what) for note in assumptions(scene.notes)]

    assert told[:3] == [
        ("junction", "1 other junctions of map.osm"),
        ("side of the road", "side of the road"),
        ("sites", f"{len(scene.sites)} sites at the kerb"),
    ]
    assert ("buildings", "buildings") in told
    assert set(assumed_sites(scene.notes)) == {site.id for site in scene.sites}


def test_signals_on_the_road_are_assumed_poles(tmp_path):
    osm = OsmText()
    middle = osm.node(0.0, 0.0, highway="traffic_signals")
    for east, north in FOUR:
        osm.road([(80.0 * east, 80.0 * north), middle], oneway="yes")

    osm.node(20.0, 20.0, man_made="pole")
    scene = import_scene([osm.write(tmp_path)], ImportOptions()).scene
    assumed = assumed_sites(scene.notes)
    lights = {site.id for site in scene.sites if site.kind == "traffic light"}

    assert len(lights) == 4
    assert set(assumed) == lights
    assert all("4 poles at the kerbs are assumed" in why for why in assumed.values())


def test_assumptions_are_kept_on_disk(tmp_path):
    imported = import_scene([bare_map(tmp_path)], ImportOptions())
    folder = tmp_path / "scene"
    folder.mkdir()
    save_scene(folder, imported.scene)

    assert load_scene_folder(folder).notes == imported.scene.notes


def test_listed_sites_are_not_assumed(tmp_path):
    poles = tmp_path / "poles.csv"
    poles.write_text(f"id,lat,lon,kind\na,{LAT_DEG + 1e-4},{LON_DEG + 2e-4},kerb\n")
    scene = import_scene([bare_map(tmp_path)], ImportOptions(sites=str(poles))).scene

    assert not assumed_sites(scene.notes)


def test_a_note_reads_as_one_line():
    assert str(Note(what="way 1", why="no road")) == "way 1: no road"
