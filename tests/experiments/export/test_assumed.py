"""Exports mark units at sites that are assumed."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.export import load_format
from experiments.export.places import positions_m, surveyed_positions_m
from geometry.notes import Note
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout


@pytest.mark.parametrize(
    "name", ["json", "csv", "geojson", "kml", "carla", "ros", "opencv"]
)
def test_assumed_sites_are_told_in_the_file(name):
    """Once for each unit there, and never for others."""
    layout = load_carlancap_layout()
    study = load_study_scene()
    site = layout.units[0].site_id
    note = Note(
        what="a mast",
        why="no mast in the map",
        kind="sites",
        site_ids=(site,),
    )
    noted = replace(study, notes=(note,))
    write = load_format(name).write
    text = str(write(layout, noted))
    without = str(write(layout, study))
    n_units = sum(unit.site_id == site for unit in layout.units)

    assert text.count(note.why) == n_units
    assert "assumed" not in without


def test_who_mounts_a_unit_on_a_surveyed_pole_gets_its_surveyed_place():
    """East and north are surveyed; the height is the model's."""
    scene = load_study_scene()
    layout = load_carlancap_layout()
    carried = {unit.site_id for unit in layout.units}
    moved_m = np.array([0.3, -0.4])
    sites = []
    for site in scene.sites:
        if site.id in carried:
            site = replace(site, surveyed_m=site.position_m[:2] + moved_m)
        sites.append(site)

    measured = replace(scene, sites=tuple(sites))
    surveyed = surveyed_positions_m(layout.units, measured)
    unmeasured = surveyed_positions_m(layout.units, scene)
    model = positions_m(layout)

    assert surveyed[:, :2] == pytest.approx(model[:, :2] + moved_m)
    assert surveyed[:, 2].tolist() == model[:, 2].tolist()
    assert unmeasured.tolist() == model.tolist()
