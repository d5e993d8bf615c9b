"""Exports mark units at sites that are assumed."""

from dataclasses import replace

import pytest

from experiments.export import load_format
from geometry.notes import Note
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout


@pytest.mark.parametrize(
    "name", ["json", "csv", "geojson", "kml", "carla", "ros", "opencv"]
)
def test_assumed_sites_are_told_in_the_file(name):
    layout = load_carlancap_layout()
    study = load_study_scene()
    site = layout.units[0].site_id
    note = Note(what="a mast", why="no mast in the map", kind="sites", site_ids=(site,))
    write = load_format(name).write
    text = str(write(layout, replace(study, notes=(note,))))
    n_units = sum(unit.site_id == site for unit in layout.units)
    assert text.count("no mast in the map") == n_units
    assert "assumed" not in str(write(layout, study))
