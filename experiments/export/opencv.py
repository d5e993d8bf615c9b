"""Cameras of a layout for OpenCV: the YAML of cv::FileStorage."""

from collections.abc import Mapping

import numpy as np
import yaml  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation

from geometry.arrays import FloatArray
from geometry.lenses import CalibratedCamera
from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .calibration import calibrations, comments, lens_coefficients, plain


def to_opencv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as YAML for ``cv::FileStorage``; comments name LiDARs left out and assumed sites.

    A sequence "cameras", one map per unit - names of units are free, those of nodes are not - with
    id, image_width, image_height, camera_matrix, distortion_coefficients (zeros), R (3x3) and t
    (3x1) from the world to the camera, and rvec (3x1), R as ``cv::projectPoints`` takes it. World:
    east, north, up, metres. Camera: x right, y down, z ahead. Pixels: the middle of the first one
    is (0, 0). Raises InputError if there is no camera.
    """
    return opencv_text(calibrations(layout, "opencv"), layout.name, comments(layout, scene))


def opencv_text(cameras: Mapping[str, CalibratedCamera], name: str, comment: str = "") -> str:
    """Calibrations as such a file; fisheyes have `distortion_model` "fisheye", and k1 to k4."""
    document = {
        "layout": _Quoted(name),
        "cameras": [_camera_record(*one) for one in cameras.items()],
    }
    form = {"allow_unicode": True, "sort_keys": False, "width": float("inf")}
    text: str = yaml.dump(document, Dumper=_Dumper, **form)
    # The format's own first lines: FileStorage tells YAML from XML and JSON by them.
    return "%YAML:1.0\n---\n" + comment + text


def _camera_record(name: str, camera: CalibratedCamera) -> dict[str, object]:
    rotation = camera.R_camera_world
    is_fisheye, coefficients = lens_coefficients(name, camera)
    return {
        "id": _Quoted(name),
        "image_width": camera.width_px,
        "image_height": camera.height_px,
        "camera_matrix": camera.K,
        **({"distortion_model": "fisheye"} if is_fisheye else {}),
        "distortion_coefficients": coefficients,
        "R": rotation,
        "rvec": Rotation.from_matrix(rotation).as_rotvec()[:, None],
        "t": camera.translation_m[:, None],
    }


class _Quoted(str):
    """Text that is written in double quotes, the only ones that FileStorage reads whole."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes arrays as FileStorage's matrices, and indents lists, as FileStorage needs it."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, indentless=False)


def _represent_matrix(dumper: yaml.SafeDumper, matrix: FloatArray) -> yaml.Node:
    rows, cols = matrix.shape
    fields = {"rows": rows, "cols": cols, "dt": "d", "data": plain(matrix)}
    node = dumper.represent_mapping("tag:yaml.org,2002:opencv-matrix", fields, flow_style=False)
    node.value[-1][1].flow_style = True  # the numbers on one line
    return node


def _represent_quoted(dumper: yaml.SafeDumper, text: _Quoted) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:str", str(text), style='"')


_Dumper.add_representer(np.ndarray, _represent_matrix)
_Dumper.add_representer(_Quoted, _represent_quoted)

FORMAT = ExportFormat(
    write=to_opencv,
    content="K, R, t of cameras, YAML; cv::FileStorage",
    has_lidars=False,
)
