"""Lists of cameras with latitudes and compass bearings are layouts like any other."""

import json
import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from small_results import assemble_without_runs

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.frames import WGS84, transform
from geometry.study_scene import load_study_scene
from placement.layout import find_layout, load_layout
from placement.question import Question
from placement.wishes import build_limits

CRS = "EPSG:32633"
HEAD = "Name;Mast;Breite (°);Länge (°);Höhe [m];Azimut (°);Neigung;Modell;Baujahr\n"


@pytest.fixture(scope="module")
def scene():
    """The study's junction with coordinates on the earth."""
    study = load_study_scene()
    return replace(study, name="here", crs=CRS, source_crs=WGS84)


@pytest.fixture(scope="module")
def row(scene):
    """A camera at the first site, in degrees: at 6.5 m, looking to the south-east, 20
    deg down.
    """
    lon_deg, lat_deg = transform(scene.sites[0].position_m[:2], CRS, WGS84)
    degrees = f"{lat_deg:.9f};{lon_deg:.9f}".replace(".", ",")
    return f"C1;{scene.sites[0].id};{degrees};6,5;135;20;carla-ncap-rgb;2019\n"


def test_a_list_in_degrees_with_bearings_and_decimal_commas(
    tmp_path, scene, row, caplog
):
    path = tmp_path / "cameras.csv"
    path.write_text(HEAD + row, encoding="utf-8")
    with caplog.at_level(logging.WARNING):
        (unit,) = load_layout(path, scene=scene).units

    assert unit.id == "C1"
    assert unit.site_id == scene.sites[0].id
    assert unit.pose.position_m == pytest.approx(
        [*scene.sites[0].position_m[:2], 6.5], abs=0.01
    )
    assert unit.pose.yaw_deg == -45.0
    assert unit.pose.pitch_deg == -20.0
    assert [one.message for one in caplog.records] == [
        f"{path}: columns that are not known, and not read: Baujahr"
    ]

    with pytest.raises(InputError, match="expected a layout file of place-rsus here"):
        load_layout(path)


def test_json_by_hand_stands_at_its_site_and_takes_models_of_a_file(tmp_path, scene):
    models = tmp_path / "mine.toml"
    model = load_cameras()["carla-ncap-rgb"]
    models.write_text(
        "[cameras.mine]\nsource = 'mine'\nprice_eur = 9\nwidth_px = 640\nheight_px ="
        " 480\nnear_m = 0.1\nhorizontal_fov_deg = 70.0\nframe_rate_hz ="
        f" {model.frame_rate_hz}\n"
    )
    path = tmp_path / "kept.json"
    units = [
        {
            "id": f"C{i}",
            "site": site.id,
            "height": 6,
            "bearing": 0,
            "tilt": 5,
            "model": "mine",
        }
        for i, site in enumerate(scene.sites[:2])
    ]
    path.write_text(json.dumps({"layout": units}))

    layout = find_layout(
        str(path),
        "--keep",
        scene=scene,
        sensors=str(models),
    )

    assert [unit.pose.yaw_deg for unit in layout.units] == [90.0, 90.0]
    assert {unit.sensor.width_px for unit in layout.units} == {640}

    feet = [site.position_m[:2] for site in scene.sites[:2]]
    expected = np.array(feet)

    assert np.array(
        [unit.pose.position_m[:2] for unit in layout.units]
    ) == pytest.approx(expected)

    plan = assemble_without_runs(
        Question(budget=1, keep=str(path), sensors=str(models)), scene
    )

    assert plan.wishes.existing == ("C0", "C1")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("carla-ncap-rgb", "cam-9", r"line 2: model: got 'cam-9'; expected one of"),
        ("C1;", ";", r"line 2: id: got nothing"),
        (
            "135;",
            ";",
            r"line 2: yaw: got nothing; expected a number, or bearing in its place",
        ),
        (";6,5;", ";high;", r"line 2: height: got 'high'"),
        ("C1;", "C1;nowhere", r"line 2: site: got 'nowhere"),
    ],
)
def test_wrong_names_and_numbers_are_refused(tmp_path, scene, row, old, new, message):
    path = tmp_path / "cameras.csv"
    path.write_text(HEAD + row.replace(old, new, 1), encoding="utf-8")

    with pytest.raises(InputError, match=re.escape(message)):
        load_layout(path, scene=scene)


@pytest.mark.long
@pytest.mark.parametrize(
    ("away_m", "hangs"),
    [
        (0.0, True),
        (0.45, True),
        (0.6, False),
    ],
)
def test_an_existing_camera_at_a_pole_hangs_on_it(tmp_path, scene, row, away_m, hangs):
    pole = scene.sites[0]
    place_m = pole.position_m[:2] + [0.0, away_m]

    lon_deg, lat_deg = transform(place_m, CRS, WGS84)
    path = tmp_path / "cameras.csv"
    path.write_text(
        HEAD + f"C1;;{lat_deg:.9f};{lon_deg:.9f};6,5;135;20;carla-ncap-rgb;2019\n",
        encoding="utf-8",
    )
    plan = assemble_without_runs(Question(budget=1, keep=str(path)), scene)
    (unit,) = plan.existing.units

    assert unit.site_id == (pole.id if hangs else "")

    # The pole has been made ready, and has room for less.
    limits = build_limits(plan.wishes, scene, plan.candidates)
    (own,) = np.flatnonzero(limits.is_forced)
    at = limits.site_index[own]
    mates = [
        plan.candidates[i].site_id for i in np.flatnonzero(limits.site_index == at)
    ]

    assert set(mates) == {unit.site_id}
    assert (len(mates) > 1) == hangs

    if hangs:
        assert limits.site_capacity[at] == pole.capacity_units
        assert limits.site_cost_eur[at] == 0.0
