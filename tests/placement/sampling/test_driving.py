"""Sources of moving traffic."""

import pytest

from geometry.errors import InputError
from geometry.registry import load_entry
from geometry.study_scene import load_study_scene
from placement.sampling.driving import SOURCES, load_traffic


@pytest.mark.parametrize("name", SOURCES)
def test_every_source_of_moving_traffic_loads(name):
    assert callable(load_entry(SOURCES[name]))


@pytest.mark.parametrize("source", ["vissim", "toml", "traffic.xml", ""])
def test_an_unknown_source_is_refused(source):
    with pytest.raises(InputError) as caught:
        load_traffic(source, load_study_scene())

    refusal = str(caught.value)

    assert refusal.endswith("; expected sumo, or a .toml file of demand for it")
    assert refusal.startswith("traffic: got ")
