"""What is loaded by its name, and names that nothing has."""

import pytest
from refusals import refused_with

from geometry import scene_sources
from geometry.maps import importing
from geometry.registry import load_entry, pick_entry


def test_an_entry_is_the_attribute_of_its_module():
    assert load_entry("math:hypot")(3.0, 4.0) == 5.0


def test_an_unknown_name_is_refused_with_the_known_ones():
    with refused_with("m: got 'width'; expected one of length, size"):
        pick_entry({"length": "math:hypot", "size": "os:fstat"}, "width", where="m")


@pytest.mark.parametrize("name", [*scene_sources.READERS, *importing.READERS])
def test_every_reader_of_scenes_and_maps_loads(name):
    for entries in (scene_sources.READERS, importing.READERS):
        if name in entries:
            assert callable(load_entry(entries[name]))
