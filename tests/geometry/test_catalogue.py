import pytest

from geometry.catalogue import load_cameras, pick_camera, read_camera
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
    assert read_camera("a", ENTRY, "f.toml").fov_range_deg is None
    zoom = read_camera("a", {**ENTRY, "fov_range_deg": [30, 60]}, "f.toml")
    assert zoom.fov_range_deg == (30.0, 60.0)
    assert isinstance(zoom.fov_range_deg[0], float)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (60, "f.toml: a.fov_range_deg: got 60; expected a list"),
        ([30], "f.toml: a.fov_range_deg: got [30]; expected [low, high] in degrees"),
        (["x", 60], "f.toml: a.fov_range_deg: got 'x'; expected a finite number"),
        ([60, 30], "a.fov_range_deg: got [60.0, 30.0]; expected [low, high] in degrees, 0 < low <"),
    ],
)
def test_a_range_that_cannot_be_is_refused(value, message):
    with pytest.raises(InputError) as caught:
        read_camera("a", {**ENTRY, "fov_range_deg": value}, "f.toml")
    assert str(caught.value).startswith(message)
