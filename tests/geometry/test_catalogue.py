import pytest

from geometry.catalogue import load_cameras, pick_camera
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
