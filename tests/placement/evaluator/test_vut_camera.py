"""The VUT's own camera."""

import numpy as np
import pytest

from placement.evaluator.surroundings import load_vut_camera


def test_study_camera_is_where_the_generator_mounts_it(vut):
    vut_camera = load_vut_camera()
    pose = vut_camera.pose_on(vut)

    # ncap.py of the study's release: 0.8 x half length ahead, 1.3 x half height up.
    assert np.allclose(pose.position_m, [0.8 * 2.446, 0.0, 1.3 * 0.755])
    assert pose.yaw_deg == 0.0
    assert pose.pitch_deg == 0.0
    assert vut_camera.camera.width_px == 1920
    assert vut_camera.camera.horizontal_fov_deg == pytest.approx(110.0)
