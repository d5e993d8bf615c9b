"""Places in words."""

import numpy as np
import pytest
from osm_text import OsmText

from geometry.junction import street_names, whereabouts
from geometry.maps.importing import ImportOptions, import_scene
from geometry.study_scene import load_study_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The scene of a crossing of two named streets and one without a name."""
    osm = OsmText()
    middle = osm.node(0.0, 0.0)
    for east, north, name in (
        (1, 0, "Mill Lane"),
        (-1, 0, "Mill Lane"),
        (0, 1, "High Street"),
    ):
        osm.road([(90.0 * east, 90.0 * north), middle], name=name)

    osm.road([(0.0, -90.0), middle])
    return import_scene(
        [osm.write(tmp_path_factory.mktemp("map"))], ImportOptions()
    ).scene


def test_streets_of_arms_without_a_name_are_left_out(scene):
    assert street_names(scene) == {
        "east": "Mill Lane",
        "north": "High Street",
        "west": "Mill Lane",
    }
    assert street_names(load_study_scene()) == {}


def test_corners_and_arms_are_told_with_their_streets(scene):
    places = np.array(
        [
            [-6.0, 6.0],
            [6.0, -6.0],
            [50.0, 4.0],
            [4.0, -50.0],
        ]
    )
    corner, other, along, unnamed = whereabouts(scene, places)

    assert corner == "north-west corner, High Street / Mill Lane"
    assert other == "south-east corner, Mill Lane"
    assert along.startswith("east arm, Mill Lane, ")
    assert unnamed.startswith("south arm, ")
    assert unnamed.endswith(" m out")


def test_a_corner_is_named_by_the_arms_on_either_side_wherever_on_it_a_pole_stands(
    scene,
):
    north_west = [
        [-3.5, 9.0],
        [-9.0, 3.5],
        [-8.0, 8.0],
    ]
    assert {words.split(",")[0] for words in whereabouts(scene, north_west)} == {
        "north-west corner"
    }
