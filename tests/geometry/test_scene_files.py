import zipfile
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from osm_text import LAT_DEG, LON_DEG, OsmText

from geometry.errors import InputError
from geometry.junction import build_junction
from geometry.notes import Note
from geometry.phrases import Phrase
from geometry.scene import LeadingRoad
from geometry.scene_files import THINGS_FILE, load_scene_folder, pack_scene, save_scene
from geometry.scene_sources import SCENE_FILE, load_scene
from geometry.study_scene import load_study_scene

NOTES = (
    Note(what="way 1", why='too "short"'),
    Note(what="2 masts", why="assumed", kind="sites", site_ids=("lamp-s1", "lamp-s2")),
)

THINGS = tuple(
    replace(thing, is_height_assumed=thing.id == "wall-ne-1")
    for thing in load_study_scene().instances
)
LIMITED = load_study_scene().lanes[0].id
LANES = tuple(
    replace(lane, speed_limit_kmh=50.0) if lane.id == LIMITED else lane
    for lane in load_study_scene().lanes
)
ROADS = (
    LeadingRoad(
        name="A Street",
        point_m=[20.0, 0.0],
        direction=[1.0, 0.0],
        lanes_in=1,
        lanes_out=2,
    ),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene")
    save_scene(
        path,
        replace(
            load_study_scene(), notes=NOTES, instances=THINGS, roads=ROADS, lanes=LANES
        ),
        sources=["a.osm"],
    )
    return path


def changed(folder, tmp_path, old, new):
    """A copy of a scene with some words of its TOML changed."""
    copy = tmp_path / "copy"
    copy.mkdir()
    text = (folder / SCENE_FILE).read_text()
    assert old in text
    (copy / SCENE_FILE).write_text(text.replace(old, new, 1))
    (copy / THINGS_FILE).write_bytes((folder / THINGS_FILE).read_bytes())
    return copy


def test_a_scene_comes_back_as_it_was(folder, tmp_path):
    scene = load_study_scene()
    archive = tmp_path / "scene.zip"
    pack_scene(folder, archive)
    for again in (load_scene_folder(folder), load_scene_folder(archive)):
        assert again.name == scene.name
        assert again.crs == scene.crs
        assert again.instances == THINGS
        ours, theirs = (one.vertices_m[one.triangles] for one in (again, scene))
        assert ours == pytest.approx(theirs, abs=2e-5)
        assert np.array_equal(again.triangle_instance, scene.triangle_instance)
        for one, other in zip(again.lanes, scene.lanes, strict=True):
            assert one.id == other.id
            assert one.kind == other.kind
            assert one.width_m == other.width_m
            assert one.speed_limit_kmh == (50.0 if one.id == LIMITED else None)
            assert one.centreline_m == pytest.approx(other.centreline_m, abs=5e-4)
        for one, other in zip(again.sites, scene.sites, strict=True):
            assert one.id == other.id
            assert one.kind == other.kind
            assert one.use == other.use
            assert one.position_m == pytest.approx(other.position_m, abs=5e-4)
        assert again.crosswalks_m == pytest.approx(scene.crosswalks_m, abs=5e-4)
        assert again.keeps_left is scene.keeps_left


def test_notes_come_back(folder):
    scene = load_scene_folder(folder)
    assert scene.notes == NOTES
    assert [thing.id for thing in scene.instances if thing.is_height_assumed] == [
        "wall-ne-1"
    ]
    assert [(road.name, road.lanes_in) for road in scene.roads] == [("A Street", 1)]


def test_other_programs_see_things_upright(folder):
    meshes = trimesh.load_scene(folder / THINGS_FILE)
    low, high = meshes.bounds
    assert (
        high[1] - low[1] < 30.0
    )  # y is up: the highest building, not the street's length
    assert min(high[0] - low[0], high[2] - low[2]) > 100.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'format = "place-rsus scene"',
            'format = "x"',
            "format: got 'x'; expected 'place-rsus",
        ),
        (
            "version = 1",
            "version = 2",
            "version: got 2; expected 1; import the scene again",
        ),
        (
            "keeps_left = false",
            "keeps_left = 1",
            "keeps_left: got 1; expected true or false",
        ),
        ("+proj=tmerc", "+proj=nothing", "crs: got "),
        ('kind = "driving"', "kind = 3", r"lanes\[0\].kind: got 3"),
        ("width_m = 3.5", "width_m = nan", r"lanes\[0\].width_m: got nan"),
        (
            'class = "ground"',
            'class = "sea"',
            "class_name: got 'sea'; expected one of ground",
        ),
        (
            'id = "ground"',
            'id = "gone"',
            r"things\[0\]: got 'gone'; expected the name of a mesh",
        ),
        ("[[lanes]]", "[[lanes", "expected valid TOML"),
    ],
)
def test_a_wrong_field_is_named(folder, tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        load_scene_folder(changed(folder, tmp_path, old, new))


def moved_sign():
    """A note whose texts have fields."""
    what = Phrase("{kind} {name}", kind=Phrase("sign"), name="4711")
    why = Phrase(
        "it stood inside {kind} {name}: moved {away:.1f} m",
        kind="wall",
        name="3",
        away=2.5,
    )
    return Note(what=what, why=why, kind="sites", site_ids=("4711",))


@pytest.fixture
def with_phrases(tmp_path):
    """Folder of a scene with such a note."""
    folder = tmp_path / "with-phrases"
    folder.mkdir()
    save_scene(folder, replace(load_study_scene(), notes=(moved_sign(),)))
    return folder


def test_notes_come_back_with_what_a_translation_needs(with_phrases):
    (note,) = load_scene_folder(with_phrases).notes
    assert note == moved_sign()
    for read, wrote in ((note.what, moved_sign().what), (note.why, moved_sign().why)):
        assert read.template == wrote.template
        assert read.fields == wrote.fields


def test_a_note_that_was_changed_by_hand_says_what_it_says_now(with_phrases, tmp_path):
    again = changed(
        with_phrases,
        tmp_path,
        'why = "it stood inside wall 3',
        'why = "it is at wall 3',
    )
    (note,) = load_scene_folder(again).notes
    assert note.why == note.why.template == "it is at wall 3: moved 2.5 m"
    assert note.what.template == "{kind} {name}"


@pytest.mark.parametrize(
    "field", ["{away:999999999d}", "{away.__class__}", "{away!r}", "{away[0]}"]
)
def test_a_phrase_of_a_file_formats_nothing_but_plain_values(
    with_phrases, tmp_path, field
):
    again = changed(with_phrases, tmp_path, "{away:.1f}", field)
    with pytest.raises(
        InputError, match=r"skipped\[0\].phrases: got others; expected those of"
    ):
        load_scene_folder(again)


def test_what_is_no_scene_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="got nothing there; expected a scene"):
        load_scene_folder(tmp_path / "gone")
    with pytest.raises(InputError, match=r"got no scene\.toml; expected a folder of"):
        load_scene_folder(tmp_path)
    file = tmp_path / "a.zip"
    file.write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(InputError, match=r"expected a scene: a folder or \.zip file"):
        load_scene_folder(file)
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("../scene.toml", "x")
    with pytest.raises(InputError, match=r"There is no item named 'scene\.toml'"):
        load_scene_folder(file)
    broken = changed(folder, tmp_path, "version = 1", "version = 1")
    data = (broken / THINGS_FILE).read_bytes()
    for content in (b"", b"glTF", data[: len(data) // 2], b"\x00" * 100):
        (broken / THINGS_FILE).write_bytes(content)
        with pytest.raises(InputError, match=r"expected glTF 2\.0"):
            load_scene_folder(broken)
    (broken / THINGS_FILE).unlink()
    with pytest.raises(InputError, match="expected the meshes of the scene"):
        load_scene_folder(broken)


def test_a_bomb_in_an_archive_is_not_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "geometry.scene_files._MAX_BYTES", {SCENE_FILE: 1000, THINGS_FILE: 1000}
    )
    file = tmp_path / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(SCENE_FILE, "#" * 2_000_000)
        archive.writestr(THINGS_FILE, "")
    with pytest.raises(InputError, match="more than 1,000 bytes"):
        load_scene_folder(file)


# From wherever it is


def _two_crossings(folder):
    """A map: four streets that meet at the origin, three that meet 200 m east of it."""
    osm = OsmText()
    west = osm.node(0.0, 0.0)
    east = osm.node(200.0, 0.0)
    osm.road([west, east], name="Link")
    for middle, x_m, ways in (
        (west, 0.0, ((-1, 0), (0, 1), (0, -1))),
        (east, 200.0, ((0, 1), (1, 0))),
    ):
        for along, up in ways:
            osm.road(
                [middle, (x_m + 100.0 * along, 100.0 * up)],
                name=f"{x_m:g} {along} {up}",
            )
    return osm.write(folder)


def test_a_scene_is_loaded_from_wherever_it_is(folder, tmp_path):
    assert load_scene() is load_scene("town05") is load_study_scene()
    archive = tmp_path / "scene.zip"
    pack_scene(folder, archive)
    for path in (folder, str(folder), archive, str(archive)):
        assert load_scene(path).instances == THINGS


@pytest.mark.long
def test_a_junction_of_a_map_is_loaded_by_name_by_place_or_as_the_largest(tmp_path):
    path = _two_crossings(tmp_path)
    packed = tmp_path / "map.zip"
    with zipfile.ZipFile(packed, "w") as archive:
        archive.write(path, "map.osm")
    largest = load_scene(path)
    assert len(build_junction(largest).arms) == 4
    assert largest.sites
    for other in (
        load_scene(str(path), junction="2"),
        load_scene(path, at=(LON_DEG + 0.003, LAT_DEG)),
    ):
        assert len(build_junction(other).arms) == 3
    assert load_scene(packed).lanes[0].id == largest.lanes[0].id
    with pytest.raises(InputError, match="at: got it beside `junction`"):
        load_scene(path, junction="2", at=(LON_DEG, LAT_DEG))


def test_what_is_neither_a_scene_nor_a_map_is_named(tmp_path):
    with pytest.raises(InputError, match="got nothing there; expected a scene"):
        load_scene(tmp_path / "gone.osm")
    text = tmp_path / "notes.txt"
    text.write_text("nothing")
    with pytest.raises(InputError, match=r"notes\.txt: got .*; expected a scene"):
        load_scene(text)
