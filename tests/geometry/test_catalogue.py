import numpy as np
import pytest

from geometry.catalogue import (
    load_cameras,
    load_catalogue,
    own_sensor_record,
    pick_camera,
    read_sensor,
)
from geometry.errors import InputError


@pytest.mark.parametrize(
    ("name", "horizontal_fov_deg"),
    # CarlaNCAP study: 110 deg in the table of sensors, 90 deg in the text and the released code.
    [("carla-ncap-rgb", 110.0), ("carla-ncap-rgb-90", 90.0)],
)
def test_the_studys_camera_is_in_the_catalogue(name, horizontal_fov_deg):
    camera = pick_camera(name, "test")
    assert camera.name == name
    assert (camera.width_px, camera.height_px, camera.frame_rate_hz) == (1920, 1080, 10.0)
    assert camera.horizontal_fov_deg == horizontal_fov_deg


def test_unknown_camera_lists_the_known_ones():
    known = ", ".join(sorted(load_cameras()))
    assert "carla-ncap-rgb" in known
    with pytest.raises(InputError) as caught:
        pick_camera("periscope", "--camera")
    assert str(caught.value) == f"--camera: got 'periscope'; expected one of {known}"


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
        ([60, 30], "a.fov_range_deg: got [60.0, 30.0]; expected [low, high] in degrees, 0 < low <"),
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
    assert (camera.name, camera.width_px, camera.price_eur) == ("mine", 1280, 700.0)
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
    # fx of the calibrations in tum-traffic-dataset-dev-kit; half the width in pixels over it.
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
        "[cameras.a]\nwidth_px = 9\nheight_px = 9\nhorizontal_fov_deg = 50.0\nnear_m = 0.5\n"
        f"frame_rate_hz = 10.0\nprice_eur = 1.0\n{field} = 0.1\n"
    )
    with pytest.raises(InputError) as caught:
        load_catalogue(path)
    assert str(caught.value) == (
        f"{path}: cameras.a.{field}: got 0.1; expected no such field here, but lens = {{model = "
        '"brown-conrady", k1 = ..}'
    )
