"""What formats carry of a lens, and what they say where they cannot."""

import numpy as np
import pytest

from experiments.export.calibration import calibrations
from experiments.export.carla import to_carla
from experiments.export.opencv import to_opencv
from geometry.catalogue import read_sensor
from geometry.errors import InputError
from geometry.lenses import BrownConrady
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.layout import Layout

FIELDS = {
    "width_px": 1920,
    "height_px": 1080,
    "horizontal_fov_deg": 90.0,
    "frame_rate_hz": 10.0,
    "near_m": 0.1,
    "price_eur": 0.0,
}


def layout_with(**fields):
    """A layout of one camera with some fields."""
    camera = read_sensor("mine", FIELDS | fields, "camera", "test")
    pose = Pose(
        position_m=np.array([1.0, 2.0, 6.0]),
        yaw_deg=30.0,
        pitch_deg=-20.0,
    )
    unit = CandidatePose(
        id="north",
        site_id="",
        pose=pose,
        sensor=camera,
    )
    return Layout(name="one", units=(unit,))


@pytest.mark.parametrize(
    "lens",
    [
        {"model": "fisheye", "k1": -0.02},
        {"model": "tsai", "kappa": 0.1},
    ],
)
def test_carla_refuses_a_lens_in_one_line(lens):
    """Its cameras are ideal pinholes."""
    layout = layout_with(lens=lens)
    what = (
        "got north, whose lens, principal point or roll it cannot carry; expected ideal"
        " pinholes"
    )
    with pytest.raises(InputError, match=f"carla: {what}"):
        to_carla(layout)


def test_tsais_lens_is_refused_by_opencv():
    """OpenCV's terms distort the other way round."""
    layout = layout_with(lens={"model": "tsai", "kappa": 0.1})

    with pytest.raises(InputError, match="north: lens: got Tsai's radial term"):
        to_opencv(layout)


def test_a_calibration_has_principal_point_aspect_and_roll():
    """Shares of the picture become pixels, counted from the first pixel's centre."""
    layout = layout_with(
        principal_point=[0.55, 0.45],
        pixel_aspect=1.02,
        roll_deg=90.0,
    )
    (found,) = calibrations(layout, "opencv").values()
    focal = 960.0
    expected = [
        [focal, 0, 0.55 * 1920 - 0.5],
        [0, 1.02 * focal, 0.45 * 1080 - 0.5],
        [0, 0, 1],
    ]

    assert pytest.approx(np.array(expected)) == found.K
    assert found.lens == BrownConrady()

    # Turned clockwise by a right angle, its right is what was down.
    (level,) = calibrations(layout_with(), "opencv").values()
    right, down, _ = found.R_camera_world
    level_right, level_down, _ = level.R_camera_world

    assert right == pytest.approx(level_down)
    assert down == pytest.approx(-level_right)
    assert level.K[0, 2] == 959.5
