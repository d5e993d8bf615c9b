"""Maps in the project's own terms: what they hold, and what is refused."""

import pytest

from geometry.errors import InputError
from geometry.maps.source_map import kind_from_name, kind_of_class, thing_defaults
from geometry.scene import CLASS_NAMES


@pytest.mark.parametrize(
    ("name", "class_name"),
    [
        ("House_12", "building"),
        ("gardenWall.001", "wall"),
        ("TREES", "vegetation"),
        ("street lamp", "lamp post"),
        ("traffic-light_3", "traffic light"),
        ("hedge row", "vegetation"),
        ("terrain", "ground"),
    ],
)
def test_names_say_what_things_are(name, class_name):
    assert kind_from_name(name).class_name == class_name


@pytest.mark.parametrize(
    "name", ["", "Wallace", "Carport", "mesh_0", "x" * 10_000, "treetop"]
)
def test_parts_of_words_say_nothing(name):
    assert kind_from_name(name) is None


def test_every_class_has_defaults_and_every_kind_a_size():
    for class_name in CLASS_NAMES:
        assert kind_of_class(class_name).class_name == class_name
    for kind in thing_defaults().kinds:
        assert 0.0 < kind.height_m <= thing_defaults().max_height_m
        assert kind.thickness_m > 0.0


def test_the_defaults_of_a_class_are_those_of_its_namesake():
    assert kind_of_class("wall").kind == "wall"
    assert kind_of_class("vegetation").kind == "vegetation"


def test_unknown_classes_list_the_known_ones():
    with pytest.raises(InputError, match="building"):
        kind_of_class("castle")
