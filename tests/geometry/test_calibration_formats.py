"""Fisheyes of OpenCV's sample, and calibrations that are not read."""

import numpy as np
import pytest

from geometry.calibrations import calibrated_sensor, read_cameras
from geometry.errors import InputError
from geometry.lenses import BrownConrady, Fisheye
from placement.layout import load_layout

OPENCV = """\
%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024"
image_width: 1920
image_height: 1080
flags: 6
SWITCH
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 960., 0., 500., 540., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 4
   cols: 1
   dt: d
   data: [ 0., 0., 0., 0. ]
avg_reprojection_error: 0.3
"""
XML = """\
<?xml version="1.0"?>
<opencv_storage><image_width>1920</image_width><image_height>1080</image_height>
SWITCH
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>500. 0. 960. 0. 500. 540. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>4</rows><cols>1</cols>
<dt>d</dt><data>0. 0. 0. 0.</data></distortion_coefficients></opencv_storage>
"""


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        ("yml", OPENCV.replace("SWITCH", "fisheye_model: 1")),
        ("yml", OPENCV.replace("SWITCH", "Fisheye_Model: 1")),
        ("xml", XML.replace("SWITCH", "<fisheye_model>1</fisheye_model>")),
    ],
)
def test_the_fisheye_of_opencvs_sample_is_equidistant(tmp_path, suffix, text):
    path = tmp_path / f"camera.{suffix}"
    path.write_text(text)
    (camera,) = read_cameras(path).values()

    assert camera.lens == Fisheye(
        k1=0.0,
        k2=0.0,
        k3=0.0,
        k4=0.0,
    )

    model, _ = calibrated_sensor("camera", camera)
    # Of an equidistant lens the radius in focal lengths is the angle: 960 / 500 rad.
    assert model.horizontal_fov_deg == pytest.approx(2.0 * np.degrees(960.0 / 500.0))


@pytest.mark.parametrize("switch", ["", "fisheye_model: 0", "lens_model: PINHOLE"])
def test_without_the_switch_it_is_brown_conrady(tmp_path, switch):
    path = tmp_path / "camera.yml"
    text = OPENCV.replace("SWITCH", switch)
    path.write_text(text)
    (camera,) = read_cameras(path).values()

    assert camera.lens == BrownConrady()

    # As old samples of OpenCV have written it.
    for key in ("camera_matrix", "distortion_coefficients"):
        text = text.replace(key, key.title())
    path.write_text(text.replace("image_width", "image_Width"))

    assert read_cameras(path)["camera"].fx_px == 500.0


@pytest.mark.parametrize(
    ("switch", "words"),
    [
        ("fisheye_model: 2", "fisheye_model: got 2.0; expected 0 or 1"),
        (
            "fisheye_model: 1\ndistortion_model: plumb_bob",
            "one lens: fisheye_model is 1, distortion_model is plumb_bob",
        ),
        ("camera_model: omni", "camera_model: got 'omni'; expected pinhole"),
        ("xi: 1.2", "got a calibration of cv::omnidir; expected"),
        ("distortion_model: fov", "distortion_model: got 'fov'; expected plumb_bob"),
    ],
)
def test_no_other_lens_is_taken_for_brown_conradys(tmp_path, switch, words):
    path = tmp_path / "camera.yml"
    path.write_text(OPENCV.replace("SWITCH", switch))

    with pytest.raises(InputError) as caught:
        read_cameras(path)
    assert words in str(caught.value)


KALIBR = """\
cam0:
  camera_model: MODEL
  distortion_coeffs: [-0.01, 0.02, -0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [461.6, 460.3, 362.7, 248.1]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
"""
UNREAD = {
    "a camchain of Kalibr;": ("yaml", KALIBR.replace("MODEL", "pinhole")),
    "Kalibr with an omnidirectional lens": ("yaml", KALIBR.replace("MODEL", "omni")),
    "MEI's model": (
        "yaml",
        "%YAML:1.0\n---\nmodel_type: MEI\ncamera_name: camera\nimage_width: 1280\n"
        "image_height: 800\nmirror_parameters:\n   xi: 1.9\n",
    ),
    "a camera of CamOdoCal": (
        "yaml",
        "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\ncamera_name: camera\n"
        "image_width: 752\nprojection_parameters:\n   k2: 0.1\n   mu: 368.1\n",
    ),
    "a sensor of EuRoC": (
        "yaml",
        "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\nresolution: [752, 480]\n"
        "camera_model: pinhole\nintrinsics: [458.6, 457.2, 367.2, 248.3]\n",
    ),
    "settings of ORB-SLAM": (
        "yaml",
        '%YAML:1.0\nCamera.type: "PinHole"\nCamera.fx: 517.3\nCamera.fy: 516.4\n',
    ),
    "a ROS message": (
        "yaml",
        'header:\n  seq: 1\nheight: 1080\nwidth: 1920\ndistortion_model: "plumb_bob"\n'
        "D: [-0.3, 0.1, 0.0, 0.0, 0.0]\nK: [1400.0, 0.0, 960.0, 0.0, 1400.0, 540.0]\n",
    ),
    "ROS message (sensor_msgs/CameraInfo)": (
        "yaml",
        "height: 1080\nwidth: 1920\ndistortion_model: plumb_bob\nd:\n- -0.3\n- 0.1\n"
        "k:\n- 1400.0\n- 0.0\n",
    ),
    "a stereo calibration of OpenCV": (
        "yml",
        "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 534., 0., 341., 0., 534., 232., 0., 0., 1. ]\n",
    ),
    "OCamCalib's polynomial": (
        "txt",
        "#polynomial coefficients for the DIRECT mapping function (ocam_model.ss)\n"
        "5 -2.4e+02 0.0 1.5e-03\n",
    ),
    "cameras of COLMAP": (
        "txt",
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH\n"
        "1 OPENCV 1920 1080 1400 1400 960 540 0 0 0 0\n",
    ),
    "Bouguet's toolbox": ("m", "fc = [ 657.4 ; 657.8 ];\ncc = [ 302.9 ; 242.6 ];\n"),
    "Agisoft Metashape": (
        "xml",
        "<?xml version='1.0'?><calibration><projection>frame</projection>"
        "<width>1920</width><f>1400</f></calibration>",
    ),
    "calib_cam_to_cam.txt": (
        "txt",
        "calib_time: 09-Jan-2012\nS_02: 1392 512\nP_rect_02: 721.5 0 609.5 44.8\n",
    ),
    "a calibration of Videre": ("ini", "[image]\n\nwidth\n640\n\nheight\n480\n"),
    "a calibration of Basalt": ("json", '{"value0": {"T_imu_cam": [{"px": 0.1}]}}'),
    "transforms of a NeRF": ("json", '{"camera_angle_x": 0.69, "frames": []}'),
    "calibrated sensor of nuScenes": (
        "json",
        '[{"token": "1", "translation": [1, 0, 1.5], "camera_intrinsic": [[1266.4]]}]',
    ),
    "a sensor station's": (
        "json",
        '{"image_width": 1920, "intrinsic_camera_matrix": [[1400, 0, 960]]}',
    ),
    "data of MATLAB": ("mat", "MATLAB 5.0 MAT-file"),
    "arrays of numpy or Python": ("npz", "PK"),
}


@pytest.mark.parametrize("name", UNREAD)
def test_a_calibration_that_is_not_read_is_named_with_what_would_do(tmp_path, name):
    suffix, text = UNREAD[name]
    path = tmp_path / f"camera.{suffix}"
    path.write_text(text)

    with pytest.raises(InputError) as caught:
        load_layout(path)

    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: got ")
    assert name in message
    assert "; expected a calibration in YAML of OpenCV or ROS; of this one " in message


def test_a_layout_that_is_none_is_called_no_calibration(tmp_path):
    path = tmp_path / "layout.json"
    path.write_text('{"units": []}')
    with pytest.raises(InputError, match="no list 'layout'"):
        load_layout(path)
