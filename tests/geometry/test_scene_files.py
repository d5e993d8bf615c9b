"""Scenes in folders and archives, and what is loaded from them."""

import zipfile
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from osm_drawing import drawn
from osm_text import LAT_DEG, LON_DEG

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
    Note(
        what="2 masts",
        why="assumed",
        kind="sites",
        site_ids=("lamp-s1", "lamp-s2"),
    ),
)

STUDY = load_study_scene()
THINGS = tuple(
    replace(thing, is_height_assumed=thing.id == "wall-ne-1")
    for thing in STUDY.instances
)
LIMITED = replace(STUDY.lanes[0], speed_limit_kmh=50.0)
ROAD = LeadingRoad(
    name="A Street",
    point_m=[20.0, 0.0],
    direction=[1.0, 0.0],
    lanes_in=1,
    lanes_out=2,
)
SCENE = replace(
    STUDY,
    notes=NOTES,
    instances=THINGS,
    roads=(ROAD,),
    lanes=(LIMITED, *STUDY.lanes[1:]),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the scene."""
    path = tmp_path_factory.mktemp("scene")
    save_scene(path, SCENE, sources=["a.osm"])
    return path


@pytest.fixture
def archive(folder, tmp_path):
    """The same as an archive."""
    path = tmp_path / "scene.zip"
    pack_scene(folder, path)
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


def assert_same(one, other, *names):
    """Fields of two values are equal."""
    for name in names:
        assert getattr(one, name) == getattr(other, name)


def test_a_scene_comes_back_as_it_was(folder, archive):
    for again in (load_scene_folder(folder), load_scene_folder(archive)):
        assert_same(again, SCENE, "name", "crs", "instances", "keeps_left")

        ours = again.vertices_m[again.triangles]
        theirs = SCENE.vertices_m[SCENE.triangles]

        assert ours == pytest.approx(theirs, abs=2e-5)
        assert np.array_equal(again.triangle_instance, SCENE.triangle_instance)
        for one, other in zip(again.lanes, SCENE.lanes, strict=True):
            assert_same(one, other, "id", "kind", "width_m", "speed_limit_kmh")
            assert one.centreline_m == pytest.approx(other.centreline_m, abs=5e-4)
        for one, other in zip(again.sites, SCENE.sites, strict=True):
            assert_same(one, other, "id", "kind", "use")
            assert one.position_m == pytest.approx(other.position_m, abs=5e-4)
        assert again.crosswalks_m == pytest.approx(SCENE.crosswalks_m, abs=5e-4)


def test_notes_and_roads_come_back(folder):
    scene = load_scene_folder(folder)
    assert scene.notes == NOTES

    (road,) = scene.roads
    assert_same(road, ROAD, "name", "lanes_in")


def test_other_programs_see_things_upright(folder):
    meshes = trimesh.load_scene(folder / THINGS_FILE)
    # y is up: the highest building, not the street's length.
    x, y, z = np.ptp(meshes.bounds, axis=0)

    assert y < 30.0
    assert min(x, z) > 100.0


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
    return Note(
        what=what,
        why=why,
        kind="sites",
        site_ids=("4711",),
    )


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
    stood = 'why = "it stood inside wall 3'
    again = changed(with_phrases, tmp_path, stood, 'why = "it is at wall 3')
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
    told = r"skipped\[0\].phrases: got others; expected those of"
    with pytest.raises(InputError, match=told):
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
    limits = {SCENE_FILE: 1000, THINGS_FILE: 1000}
    monkeypatch.setattr("geometry.scene_files._MAX_BYTES", limits)
    file = tmp_path / "bomb.zip"

    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(SCENE_FILE, "#" * 2_000_000)
        archive.writestr(THINGS_FILE, "")

    with pytest.raises(InputError, match="more than 1,000 bytes"):
        load_scene_folder(file)


# From wherever it is


# Four streets that meet at the origin, three that meet 200 m east of it.
TWO_CROSSINGS = """
    node 0 0:
    node 200 0:
    road 0 0, 200 0: name=Link
    road 0 0, -100 0: name=0 -1 0
    road 0 0, 0 100: name=0 0 1
    road 0 0, 0 -100: name=0 0 -1
    road 200 0, 200 100: name=200 0 1
    road 200 0, 300 0: name=200 1 0
"""


def test_a_scene_is_loaded_from_wherever_it_is(folder, archive):
    assert load_scene() is load_scene("town05") is STUDY
    for path in (folder, str(folder), archive, str(archive)):
        assert load_scene(path).instances == THINGS


@pytest.mark.long
def test_a_junction_of_a_map_is_loaded_by_name_by_place_or_as_the_largest(tmp_path):
    path = drawn(TWO_CROSSINGS).write(tmp_path)
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
