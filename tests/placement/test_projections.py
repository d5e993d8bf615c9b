"""Projections that are registered."""

import pytest

from geometry.registry import load_entry
from placement.evaluator import perceive
from placement.visibility import sensing


@pytest.mark.parametrize("entries", [perceive.PROJECTIONS, sensing.PROJECTIONS])
def test_every_projection_loads(entries):
    assert set(entries) == {"pinhole", "lens"}

    loaded = {load_entry(place) for place in entries.values()}

    assert len(loaded) == 2
    assert all(map(callable, loaded))
