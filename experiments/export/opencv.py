"""Cameras of a layout for OpenCV: the YAML of cv::FileStorage."""

import numpy as np

from geometry.arrays import FloatArray
from placement.layout import Layout

from .calibration import (
    N_DISTORTION,
    Calibration,
    calibrations,
    lidar_ids,
    plain,
)
from .yaml_text import left_out_comment, yaml_numbers, yaml_text


def to_opencv(layout: Layout) -> str:
    """Layout as a YAML file for ``cv::FileStorage``; LiDARs are left out, a comment names them.

    Parameters
    ----------
    layout : Layout
        What to write.

    Returns
    -------
    text : str
        A sequence "cameras", one map per unit - names of units are free, those of nodes are not -
        with id, image_width, image_height, camera_matrix, distortion_coefficients (zeros), R (3x3)
        and t (3x1) from the world to the camera, and rvec (3x1), R as ``cv::projectPoints`` takes
        it. World: east, north, up, metres. Camera: x right, y down, z ahead. Pixels: the middle of
        the first one is (0, 0).

    Raises
    ------
    InputError
        There is no camera.
    """
    # The format's own first lines: FileStorage tells YAML from XML and JSON by them.
    lines = ["%YAML:1.0", "---", *left_out_comment(lidar_ids(layout))]
    lines += [f"layout: {yaml_text(layout.name)}", "cameras:"]
    for calibration in calibrations(layout, "opencv"):
        lines += _camera_lines(calibration)
    return "\n".join(lines) + "\n"


def _camera_lines(calibration: Calibration) -> list[str]:
    from scipy.spatial.transform import Rotation

    lines = [
        f"id: {yaml_text(calibration.id)}",
        f"image_width: {calibration.width_px}",
        f"image_height: {calibration.height_px}",
    ]
    for name, matrix in (
        ("camera_matrix", calibration.camera_matrix),
        ("distortion_coefficients", np.zeros((1, N_DISTORTION))),
        ("R", calibration.world_to_camera),
        ("rvec", Rotation.from_matrix(calibration.world_to_camera).as_rotvec()[:, None]),
        ("t", calibration.translation_m[:, None]),
    ):
        lines += _matrix_lines(name, matrix)
    return ["   -", *(f"      {line}" for line in lines)]


def _matrix_lines(name: str, matrix: FloatArray) -> list[str]:
    return [
        f"{name}: !!opencv-matrix",
        f"   rows: {matrix.shape[0]}",
        f"   cols: {matrix.shape[1]}",
        "   dt: d",
        f"   data: {yaml_numbers(plain(matrix))}",
    ]
