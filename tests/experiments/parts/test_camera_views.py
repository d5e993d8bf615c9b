"""Pictures of what cameras will see: few, small, and with a road user in the middle."""

import base64
import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from experiments.parts.camera_views import camera_views, draw_view
from geometry.sensors import project_points
from placement.layout import Layout, load_carlancap_layout


@pytest.fixture(scope="module")
def cameras():
    """Two of the study's cameras with small pictures."""
    units = load_carlancap_layout().units[:2]
    return [
        replace(one, sensor=replace(one.sensor, width_px=160, height_px=90))
        for one in units
    ]


@pytest.mark.long
def test_a_camera_shows_a_road_user_near_the_middle_of_its_picture(
    small_setting, cameras
):
    for unit in cameras:
        rgb, run, time_s = draw_view(unit, small_setting)
        assert rgb.shape == (90, 160, 3)
        assert np.ptp(rgb) > 100
        assert run.id in {one.id for one in small_setting.runs}

        frame = int(np.argmin(abs(run.time_s - time_s)))
        assert run.time_s[frame] == time_s

        feet = np.array([[*run.vru_position_m[frame], 0.0]])
        (at_px,) = project_points(feet, unit.pose, unit.sensor)
        assert (abs(at_px[:2] / (160.0, 90.0) - 0.5) < 0.35).all()


@pytest.mark.long
def test_each_camera_of_few_has_a_small_picture(small_setting, cameras):
    first, other = camera_views(small_setting, Layout(name="two", units=tuple(cameras)))
    image = Image.open(io.BytesIO(base64.b64decode(first.image)))

    assert image.format == "JPEG"
    assert image.size == (first.width_px, first.height_px)
    assert first.width_px * 9 == first.height_px * 16
    assert len(first.image) < 100_000
    assert first.title != other.title
    assert first.caption.endswith(" s before the collision.")


def test_of_many_cameras_there_is_none(small_setting):
    assert camera_views(small_setting, load_carlancap_layout()) == ()
