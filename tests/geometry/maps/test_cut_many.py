"""Scenes out of maps that are read once are those out of whole maps."""

from dataclasses import fields, replace

import numpy as np
import pytest
from city_maps import write_city

from geometry.maps.cut import Neighbourhoods
from geometry.maps.importing import (
    ImportOptions,
    ReadingOptions,
    cut_scene,
    import_scene,
    read_maps,
)
from geometry.notes import assumptions


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A real town, of which every junction is cut out."""
    return write_city(tmp_path_factory.mktemp("city"))


def same(one, other):
    """Whether two values hold the same, whatever arrays they hold."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(
            same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)
        )
    return one == other


@pytest.mark.long
def test_a_junctions_surroundings_make_the_scene_of_the_whole_map(city):
    maps, junctions = read_maps([city], ReadingOptions())
    around = Neighbourhoods(maps, radius_m=80.0)

    assert len(junctions) == 3
    for one in junctions:
        options = ImportOptions(junction=one.junction.id)
        part = around.around(one.junction)

        assert len(part[0].lanes) < len(maps[0].lanes)
        assert len(part[0].things) < len(maps[0].things)

        whole = import_scene([city], options)
        cut = cut_scene(part, one, options)
        known, told = (
            replace(scene, notes=assumptions(scene.notes))
            for scene in (whole.scene, cut.scene)
        )

        assert same(told, known)
        assert cut.scene.roads


@pytest.mark.long
def test_lanes_through_other_junctions_come_along(real_input):
    maps, junctions = read_maps(
        [real_input("opendrive/multi_intersections.xodr")], ReadingOptions()
    )
    part = Neighbourhoods(maps, radius_m=40.0).around(junctions[0].junction)

    assert len(part[0].connections) < len(maps[0].connections)
    assert len(part[0].junctions) < len(maps[0].junctions)

    options = ImportOptions(sites="kerb:15", radius_m=40.0)
    cut, whole = (
        cut_scene(source, junctions[0], options).scene for source in (part, maps)
    )

    assert same(
        *(replace(scene, notes=assumptions(scene.notes)) for scene in (cut, whole))
    )
