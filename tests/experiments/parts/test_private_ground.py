"""Private ground: read from files, seen by cameras, told."""

from dataclasses import replace
from types import SimpleNamespace

import geopandas
import numpy as np
import pytest
from command_results import refusal
from private_garden import write_garden
from shapely import box
from small_results import assemble_without_runs

from experiments.parts import answer, existing_views
from experiments.parts.units import (
    PrivateAreaRecord,
    PrivateGroundRecord,
    build_private_ground_record,
    private_ground_sentence,
)
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.forbidden_views import respects_private_ground
from placement.layout import load_carlancap_layout
from placement.private_ground import load_private_ground, private_shares
from placement.question import Question


@pytest.fixture
def scene():
    return load_study_scene()


@pytest.fixture
def garden(tmp_path):
    return write_garden(tmp_path)


def test_polygons_come_into_the_world_frame(garden, scene):
    ground = load_private_ground(garden, scene)
    assert ground.names == ("garden",)
    assert ground.area_m2 == pytest.approx([20.0], rel=1e-3)

    low = ground.points_m[:, :2].min(axis=0)
    high = ground.points_m[:, :2].max(axis=0)

    assert low == pytest.approx([-109.5, 10.5], abs=0.05)
    assert high == pytest.approx([-100.5, 11.5], abs=0.05)


@pytest.mark.filterwarnings("ignore:'crs' was not provided")
def test_a_map_of_no_known_place_takes_its_own_coordinates(scene, tmp_path):
    lost = replace(scene, crs="", source_origin_m=np.array([1000.0, 2000.0]))
    path = tmp_path / "a.gpkg"
    frame = geopandas.GeoDataFrame(
        {"name": ["a"]}, geometry=[box(1010, 2010, 1020, 2020)]
    )
    frame.to_file(path, driver="GPKG")
    ground = load_private_ground(path, lost)

    assert ground.points_m[:, :2].min(axis=0) == pytest.approx([10.5, 10.5])

    frame.set_crs("EPSG:25832").to_file(tmp_path / "b.gpkg", driver="GPKG")
    with pytest.raises(
        InputError, match="expected a scene that says where on earth it lies"
    ):
        load_private_ground(tmp_path / "b.gpkg", lost)


# Quickly: tests/placement/test_ground.py
@pytest.mark.long
def test_poses_that_look_in_are_no_candidates(garden, scene):
    plan = assemble_without_runs(Question(budget=1, no_look=str(garden)), scene)
    everything = assemble_without_runs(Question(budget=1), scene)

    assert 0 < len(plan.candidates) < len(everything.candidates)
    assert (private_shares(scene, plan.candidates, plan.private_ground) == 0.0).all()

    some = assemble_without_runs(
        Question(budget=1, no_look=str(garden), no_look_share=0.5), scene
    )
    assert len(plan.candidates) < len(some.candidates) <= len(everything.candidates)

    summary = build_private_ground_record(
        plan.candidates[:2], scene, plan.private_ground
    )
    assert (
        private_ground_sentence(summary)
        == "No camera has the private area in its picture."
    )


def test_what_is_seen_is_told_and_too_much_to_ask_is_refused(garden, scene):
    ground = load_private_ground(garden, scene)
    units = load_carlancap_layout().units
    shares = private_shares(scene, units, ground)[:, 0]
    summary = build_private_ground_record(units, scene, ground)
    sentence = private_ground_sentence(summary)

    for unit, share in zip(units, shares, strict=True):
        assert summary.units[unit.id] == {"garden": share}
        assert (f"{unit.id} sees " in sentence) == (share > 0.0)

    watching = [unit for unit, share in zip(units, shares, strict=True) if share > 0.0]
    assert watching
    with pytest.raises(
        InputError, match=r"no_look_share: got 0\.0 %; expected at least 0\."
    ):
        respects_private_ground(private_shares(scene, watching, ground), max_share=0.0)
    with pytest.raises(InputError, match="refine: got it beside `no_look`"):
        assemble_without_runs(
            Question(budget=1, no_look=str(garden), refine=True), scene
        )


def test_what_belongs_to_areas_needs_areas(run):
    option = "--no-look-share"
    line = refusal(run("--budget 1", option, "0.5"))
    assert line.endswith(f"{option}: got it without --no-look; expected both")


@pytest.mark.long
def test_layouts_are_judged_by_what_they_see_of_private_ground(
    garden, run, ask, scene, small_study
):
    asked = ("compare carlancap-12 carlancap-12 --no-look", garden)
    summary = ask(*asked)
    seen = summary["private_ground"]["units"]
    ground = load_private_ground(garden, scene)
    expected = private_shares(scene, load_carlancap_layout().units, ground)[:, 0]

    assert [shares["garden"] for shares in seen.values()] == pytest.approx(expected)
    assert summary["compared"][0]["private_ground"] == summary["private_ground"]

    _, text, _ = run(*asked, "--quiet")
    assert "Warning: private ground is in view: RSU" in text


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "a.geojson"),
        ('{"type": "FeatureCollection", "features": []}', "a.geojson"),
        (
            (
                '{"type": "Feature", "properties": {}, "geometry": {"type": "Point", '
                '"coordinates": [8.0, 49.0]}}'
            ),
            "no polygon",
        ),
    ],
)
def test_files_without_areas_are_refused(scene, tmp_path, content, message):
    path = tmp_path / "a.geojson"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        load_private_ground(path, scene)


def test_what_an_existing_camera_looks_into_is_a_warning_before_all_else(monkeypatch):
    areas = (PrivateAreaRecord(name="garden", area_m2=20.0),)
    seen = {"A": {"garden": 0.25}, "B": {"garden": 0.5}, "C": {"garden": 0.0}}
    ground = PrivateGroundRecord(areas=areas, units=seen)
    result = SimpleNamespace(private_ground=ground, existing=("A", "C"))

    assert existing_views.warnings(result) == [
        "Warning: private ground is in view: B sees 50.0 % of garden, A sees 25.0 %"
        " of garden."
    ]

    # In a placement B was chosen, within --no-look-share.
    monkeypatch.setattr(existing_views, "PlacementResult", SimpleNamespace)
    assert existing_views.warnings(result) == [
        "Warning: an existing camera has private ground in view: A sees 25.0 % of"
        " garden."
    ]

    result.existing = ("C",)
    assert existing_views.warnings(result) == []

    # With the other warnings, above the figures of a report.
    result.existing = ("A",)
    result.driven = ()
    result.without_effect = ()
    monkeypatch.setattr(answer, "preferred", lambda result: [])
    monkeypatch.setattr(answer, "planned_only", lambda result: [])

    assert answer.warnings(result) == existing_views.warnings(result) != []
