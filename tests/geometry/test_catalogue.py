"""The catalogue of sensors, and sensors of one's own."""

import json
from dataclasses import replace

import numpy as np
import pytest
from refusals import refused_with

from geometry.catalogue import (
    load_cameras,
    load_catalogue,
    own_sensor_record,
    pick_camera,
    read_sensor,
)
from geometry.errors import InputError
from geometry.lenses import BrownConrady
from geometry.sensors import CameraModel
from placement.fingerprints import Fingerprints
from placement.packing import from_bytes, to_bytes


@pytest.mark.parametrize(
    ("name", "horizontal_fov_deg"),
    # CarlaNCAP study: 110 deg in the table of sensors, 90 deg in the text and the
    # released code.
    [
        ("carla-ncap-rgb", 110.0),
        ("carla-ncap-rgb-90", 90.0),
    ],
)
def test_the_studys_camera_is_in_the_catalogue(name, horizontal_fov_deg):
    camera = pick_camera(name, "test")
    assert camera.name == name
    assert camera.width_px == 1920
    assert camera.height_px == 1080
    assert camera.frame_rate_hz == 10.0
    assert camera.horizontal_fov_deg == horizontal_fov_deg


def test_unknown_camera_lists_the_known_ones():
    known = ", ".join(sorted(load_cameras()))
    assert "carla-ncap-rgb" in known
    with refused_with(f"--camera: got 'periscope'; expected one of {known}"):
        pick_camera("periscope", "--camera")


ENTRY = {
    "width_px": 1920,
    "height_px": 1080,
    "horizontal_fov_deg": 60,
    "frame_rate_hz": 10,
    "near_m": 0.5,
    "price_eur": 1,
}


def test_only_a_varifocal_camera_has_a_range_of_fields_of_view():
    assert load_cameras()["carla-ncap-rgb"].fov_range_deg is None
    assert load_cameras()["varifocal-1080p"].fov_range_deg == (26.2, 89.6)
    assert read_sensor("a", ENTRY, "camera", "f.toml").fov_range_deg is None

    zoom = read_sensor("a", {**ENTRY, "fov_range_deg": [30, 60]}, "camera", "f.toml")
    assert zoom.fov_range_deg == (30.0, 60.0)
    assert isinstance(zoom.fov_range_deg[0], float)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (60, "f.toml: a.fov_range_deg: got 60; expected [low, high] in degrees"),
        ([30], "f.toml: a.fov_range_deg: got [30]; expected [low, high] in degrees"),
        (["x", 60], "f.toml: a.fov_range_deg[0]: got 'x'; expected a finite number"),
        (
            [60, 30],
            (
                "a.fov_range_deg: got [60.0, 30.0]; expected [low, high] in degrees, 0"
                " < low <"
            ),
        ),
    ],
)
def test_a_range_that_cannot_be_is_refused(value, message):
    with pytest.raises(InputError) as caught:
        read_sensor("a", {**ENTRY, "fov_range_deg": value}, "camera", "f.toml")
    assert str(caught.value).startswith(message)


OWN = """
[cameras.mine]
source = "my data sheet"
width_px = 1280
height_px = 720
horizontal_fov_deg = 60.0
frame_rate_hz = 10.0
near_m = 0.5
price_eur = 700.0
"""


def test_somebodys_own_models_are_read_and_told_apart_from_the_catalogue(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(OWN)
    (camera,) = load_catalogue(path).values()

    assert camera.name == "mine"
    assert camera.width_px == 1280
    assert camera.price_eur == 700.0

    record = own_sensor_record(camera)
    assert read_sensor("mine", record, record["kind"], "a layout") == camera
    assert all(own_sensor_record(model) is None for model in load_cameras().values())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "got no model; expected"),
        ("[radars.x]", "radars: got it; expected"),
        ("cameras = 3", "cameras: got it; expected"),
        ("[cameras]\nx = 3", "x: got 3; expected a table of fields"),
        (OWN.replace("1280", "0"), "width_px: got 0"),
        (OWN.replace("price_eur = 700.0", ""), "price_eur: got nothing"),
        ("[", "valid TOML"),
    ],
)
def test_catalogues_that_cannot_be_are_refused(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_catalogue(path)


def test_real_cameras_have_the_angles_of_their_calibration():
    # fx of the calibrations in tum-traffic-dataset-dev-kit; half the width in pixels
    # over it.
    for name, focal_px in (
        ("basler-aca1920-50gc-8mm", 1400.31),
        ("basler-aca1920-50gc-16mm", 2788.86),
    ):
        camera = load_cameras()[name]
        angle_deg = 2.0 * np.degrees(np.arctan(0.5 * camera.width_px / focal_px))
        assert camera.horizontal_fov_deg == pytest.approx(angle_deg, abs=0.05)


@pytest.mark.parametrize("field", ["k1", "distortion_coefficients"])
def test_a_lens_that_distorts_is_refused_and_not_passed_over(field, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        "[cameras.a]\nwidth_px = 9\nheight_px = 9\nhorizontal_fov_deg = 50.0\nnear_m ="
        f" 0.5\nframe_rate_hz = 10.0\nprice_eur = 1.0\n{field} = 0.1\n"
    )
    with refused_with(
        f"{path}: cameras.a.{field}: got 0.1; expected no such field here, but lens"
        ' = {model = "brown-conrady", k1 = ..}'
    ):
        load_catalogue(path)


LENS = {"model": "fisheye", "k1": -0.02, "k2": 0.003}


def test_a_camera_with_a_lens_is_read_and_written_again(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(
        OWN
        + 'lens = {model = "brown-conrady", k1 = -0.1, p1 = 0.001}\nroll_deg = 2.0\n'
    )
    (camera,) = load_catalogue(path).values()

    assert camera.lens == BrownConrady(k1=-0.1, p1=0.001)
    assert not camera.is_pinhole

    record = own_sensor_record(camera)
    assert record["lens"] == {"model": "brown-conrady", "k1": -0.1, "p1": 0.001}
    assert (
        read_sensor("mine", json.loads(json.dumps(record)), "camera", "a layout")
        == camera
    )
    assert from_bytes(to_bytes(camera), CameraModel) == camera
    assert Fingerprints().of(camera) != Fingerprints().of(replace(camera, lens=None))


def test_a_field_of_view_is_what_a_fisheye_shows():
    camera = read_sensor(
        "a", {**ENTRY, "lens": {"model": "fisheye"}}, "camera", "f.toml"
    )
    # Equidistant: half a width is the focal length times half of the angle.
    assert camera.focal_length_px == pytest.approx(960.0 / np.radians(30.0))
    assert camera.vertical_fov_deg == pytest.approx(60.0 * 1080 / 1920)
    assert camera.diagonal_fov_deg == pytest.approx(60.0 * np.hypot(1920, 1080) / 1920)

    wide = {**ENTRY, "horizontal_fov_deg": 190.0, "lens": {"model": "fisheye"}}
    assert read_sensor("a", wide, "camera", "f").focal_length_px == pytest.approx(
        960 / np.radians(95)
    )

    zero = read_sensor(
        "a", {**ENTRY, "lens": {"model": "tsai", "kappa": 0.0}}, "camera", "f.toml"
    )
    assert zero.is_pinhole
    assert (
        zero.focal_length_px
        == read_sensor("a", ENTRY, "camera", "f.toml").focal_length_px
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"lens": {"model": "pinhole"}},
            (
                "f.toml: a.lens.model: got 'pinhole'; expected one of brown-conrady,"
                " tsai, fisheye"
            ),
        ),
        (
            {"lens": LENS | {"k9": 1}},
            "f.toml: a.lens: got 'k9'; expected one of k1, k2, k3, k4",
        ),
        ({"lens": {"k1": 1.0}}, "f.toml: a.lens.model: got nothing; expected a value"),
        ({"lens": 3}, "f.toml: a.lens: got 3; expected a table"),
        (
            {"lens": {"model": "tsai"}},
            "f.toml: a.lens.kappa: got nothing; expected a value",
        ),
        (
            {"lens": LENS | {"k1": "x"}},
            "f.toml: a.lens.k1: got 'x'; expected a finite number",
        ),
        (
            {"lens": {"model": "fisheye", "k1": -1.5}},
            (
                "a.horizontal_fov_deg: got 60.0; expected 0 < degrees < 54.019: farther"
                " out its lens shows nothing"
            ),
        ),
        (
            {"lens": LENS, "fov_range_deg": [30, 400]},
            (
                "a.fov_range_deg: got [30.0, 400.0]; expected [low, high] in degrees, 0"
                " < low"
            ),
        ),
        (
            {"principal_point": [0.5, 3]},
            "a.principal_point: got (0.5, 3.0); expected [x, y] in",
        ),
        (
            {"principal_point": 3},
            "f.toml: a.principal_point: got 3; expected [x, y] in",
        ),
        ({"pixel_aspect": 0.0}, "a.pixel_aspect: got 0.0; expected 0.5 .. 2"),
        ({"roll_deg": 200.0}, "a.roll_deg: got 200.0; expected -180 .. 180"),
    ],
)
def test_a_lens_that_cannot_be_is_refused_in_one_line(change, message):
    with pytest.raises(InputError) as caught:
        read_sensor("a", {**ENTRY, **change}, "camera", "f.toml")
    assert str(caught.value).startswith(message)
