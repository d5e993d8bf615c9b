"""Cameras of a layout for ROS: CameraInfo and static transforms."""

import re

import numpy as np

from geometry.arrays import FloatArray
from placement.layout import Layout

from .calibration import (
    N_DISTORTION,
    Calibration,
    calibrations,
    lidar_ids,
    optical_quaternion,
    plain,
)
from .yaml_text import (
    left_out_comment,
    yaml_number,
    yaml_numbers,
    yaml_text,
)

WORLD_FRAME = "map"
"""REP 105's name of a world-fixed frame: x east, y north, z up."""


def to_ros(layout: Layout) -> str:
    """Layout as YAML: one document per camera; LiDARs are left out, a comment names them.

    Parameters
    ----------
    layout : Layout
        What to write.

    Returns
    -------
    text : str
        Documents with the fields that ``camera_calibration_parsers`` reads - it takes the first
        document of a file -, the unit's id, and under static_transform what
        ``geometry_msgs/TransformStamped`` holds: from "map" (x east, y north, z up) to the
        camera's optical frame (x right, y down, z ahead).

    Raises
    ------
    InputError
        There is no camera.

    References
    ----------
    .. [1] sensor_msgs/CameraInfo; REP 103 (optical frames), REP 105 (map).
    """
    cameras = calibrations(layout, "ros")
    documents = [
        "\n".join(["---", *_camera_lines(calibration, name)])
        for calibration, name in zip(cameras, camera_names(cameras), strict=True)
    ]
    return "\n".join([*left_out_comment(lidar_ids(layout)), *documents]) + "\n"


def camera_names(cameras: list[Calibration]) -> list[str]:
    """Names that ROS allows, each once: letters, digits, underscores, a letter first."""
    names: list[str] = []
    for camera in cameras:
        word = re.sub(r"[^A-Za-z0-9]+", "_", camera.id).strip("_").lower()
        stem = word if word[:1].isalpha() else f"rsu_{word}".rstrip("_")
        name, number = stem, 2
        while name in names:
            name, number = f"{stem}_{number}", number + 1
        names.append(name)
    return names


def _camera_lines(calibration: Calibration, name: str) -> list[str]:
    projection = np.column_stack([calibration.camera_matrix, np.zeros(3)])
    return [
        f"unit: {yaml_text(calibration.id)}",
        f"image_width: {calibration.width_px}",
        f"image_height: {calibration.height_px}",
        f"camera_name: {name}",
        *_matrix_lines("camera_matrix", calibration.camera_matrix),
        "distortion_model: plumb_bob",
        *_matrix_lines("distortion_coefficients", np.zeros((1, N_DISTORTION))),
        *_matrix_lines("rectification_matrix", np.eye(3)),
        *_matrix_lines("projection_matrix", projection),
        "static_transform:",
        "  header:",
        f"    frame_id: {WORLD_FRAME}",
        f"  child_frame_id: {name}_optical_frame",
        "  transform:",
        "    translation:",
        *_component_lines("xyz", plain(calibration.pose.position_m)),
        "    rotation:",
        *_component_lines("xyzw", optical_quaternion(calibration.pose)),
    ]


def _matrix_lines(name: str, matrix: FloatArray) -> list[str]:
    rows, cols = matrix.shape
    return [
        f"{name}:",
        f"  rows: {rows}",
        f"  cols: {cols}",
        f"  data: {yaml_numbers(plain(matrix))}",
    ]


def _component_lines(names: str, values: list[float]) -> list[str]:
    # A bare y is a boolean in YAML 1.1.
    return [
        f'      "{name}": {yaml_number(value)}' for name, value in zip(names, values, strict=True)
    ]
