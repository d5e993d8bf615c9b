"""Roads that a map closes to pedestrians, cyclists or motorcyclists."""

from dataclasses import replace

import pytest
from opendrive_text import crossing, document, read_text
from osm_tags import tags_of
from osm_text import OsmText

from geometry.maps.openstreetmap import read_openstreetmap
from geometry.scene_files import save_scene
from geometry.scene_sources import load_scene
from geometry.study_scene import load_study_scene


@pytest.mark.parametrize(
    ("tags", "closed_to"),
    [
        ("highway=primary", ()),
        ("highway=motorway", ("on foot", "bicycle")),
        ("highway=motorway_link", ("on foot", "bicycle")),
        ("highway=trunk; motorroad=yes", ("on foot", "bicycle")),
        ("highway=motorway_link; foot=yes; bicycle=yes", ()),
        ("highway=primary; foot=no", ("on foot",)),
        ("highway=primary; bicycle=no", ("bicycle",)),
        ("highway=primary; bicycle=private; motorcycle=no", ("bicycle", "motorcycle")),
        ("highway=primary; foot=no; sidewalk=separate", ()),
        ("highway=primary; foot=no; sidewalk:left=yes", ()),
        ("highway=primary; bicycle=no; cycleway:right=track", ()),
        ("highway=primary; bicycle=use_sidepath; foot=use_sidepath", ()),
        ("highway=primary; sidewalk=no", ()),
        ("highway=trunk; motorroad=yes; oneway=-1", ("on foot", "bicycle")),
    ],
)
def test_tags_say_who_may_not_use_a_road(tags, closed_to, tmp_path):
    osm = OsmText()
    osm.way([(-50.0, 0.0), (50.0, 0.0)], tags_of(tags))
    source = read_openstreetmap(osm.write(tmp_path), keeps_left=False)
    lanes = [one for one in source.lanes if one.kind == "driving"]

    assert lanes
    assert {one.closed_to for one in lanes} == {closed_to}


def test_a_scene_keeps_it(tmp_path):
    scene = load_study_scene()
    first, *others = scene.lanes
    closed = replace(first, closed_to=("on foot", "motorcycle"))
    save_scene(tmp_path, replace(scene, lanes=(closed, *others)))
    loaded = load_scene(tmp_path)

    assert loaded.lanes[0].closed_to == ("on foot", "motorcycle")
    assert {one.closed_to for one in loaded.lanes[1:]} == {()}


def test_a_motorway_of_opendrive_is_closed(tmp_path):
    """The first of four roads that meet."""
    motorway = '<type s="0" type="motorway"/><planView>'
    text = document(crossing()).replace("<planView>", motorway, 1)
    source = read_text(tmp_path, text)
    closed = {one.id.partition("/")[0] for one in source.lanes if one.closed_to}

    assert len(closed) == 1
    assert {one.closed_to for one in source.lanes if one.closed_to} == {
        ("on foot", "bicycle")
    }
