"""Cameras of a layout for ROS: CameraInfo and static transforms."""

import re
from collections.abc import Iterable, Mapping

import numpy as np
import yaml  # type: ignore[import-untyped]

from geometry.arrays import FloatArray
from geometry.calibrations import CalibratedCamera
from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .calibration import calibrations, comments, lens_coefficients, plain, quaternion

WORLD_FRAME = "map"
"""REP 105's name of a world-fixed frame: x east, y north, z up."""


def to_ros(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as YAML: one document per camera.

    Comments name LiDARs left out and assumed sites.

    A document has the fields that ``camera_calibration_parsers`` reads - it takes the
    first document of a file -, the unit's id, and under static_transform what
    ``geometry_msgs/TransformStamped`` holds: from "map" (x east, y north, z up) to the
    camera's optical frame (x right, y down, z ahead). Raises InputError if there is no
    camera.

    References
    ----------
    .. [1] sensor_msgs/CameraInfo; REP 103 (optical frames), REP 105 (map).
    """
    return ros_text(calibrations(layout, "ros"), comments(layout, scene))


def ros_text(cameras: Mapping[str, CalibratedCamera], comment: str = "") -> str:
    """Calibrations as such documents; a fisheye's model is "equidistant"."""
    documents = [
        _camera_record(unit, camera, name)
        for (unit, camera), name in zip(
            cameras.items(), camera_names(cameras), strict=True
        )
    ]
    text: str = yaml.safe_dump_all(
        documents,
        allow_unicode=True,
        sort_keys=False,
        explicit_start=True,
        default_flow_style=None,  # numbers of a list on one line
        width=float("inf"),
    )
    return comment + text


def camera_names(units: Iterable[str]) -> list[str]:
    """Names that ROS allows, each once.

    Letters, digits, underscores, a letter first.
    """
    names: list[str] = []
    for unit in units:
        word = re.sub(r"[^A-Za-z0-9]+", "_", unit).strip("_").lower()
        if word[:1].isalpha():
            stem = word
        else:
            stem = f"rsu_{word}".rstrip("_")
        name = stem
        number = 2
        while name in names:
            name = f"{stem}_{number}"
            number = number + 1
        names.append(name)
    return names


def _camera_record(unit: str, camera: CalibratedCamera, name: str) -> dict[str, object]:
    projection = np.column_stack([camera.K, np.zeros(3)])
    translation = dict(zip("xyz", plain(camera.position_m), strict=True))
    rotation = dict(zip("xyzw", quaternion(camera.R_camera_world.T), strict=True))
    is_fisheye, coefficients = lens_coefficients(unit, camera)
    return {
        "unit": unit,
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "camera_name": name,
        "camera_matrix": _matrix_record(camera.K),
        "distortion_model": "equidistant" if is_fisheye else "plumb_bob",
        "distortion_coefficients": _matrix_record(coefficients),
        "rectification_matrix": _matrix_record(np.eye(3)),
        "projection_matrix": _matrix_record(projection),
        "static_transform": {
            "header": {"frame_id": WORLD_FRAME},
            "child_frame_id": f"{name}_optical_frame",
            "transform": {"translation": translation, "rotation": rotation},
        },
    }


def _matrix_record(matrix: FloatArray) -> dict[str, object]:
    rows, cols = matrix.shape
    return {"rows": rows, "cols": cols, "data": plain(matrix)}


FORMAT = ExportFormat(
    write=to_ros,
    has_lidars=False,
)
