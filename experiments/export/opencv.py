"""Cameras of a layout for OpenCV: the YAML of cv::FileStorage."""

from collections.abc import Mapping
from importlib.resources import files

import yaml  # type: ignore[import-untyped]
from scipy.spatial.transform import Rotation

from geometry.calibrations import CalibratedCamera
from geometry.scene import Scene
from placement.layout import Layout

from ..results.tables import page_of
from . import ExportFormat
from .calibration import calibrations, comments, lens_coefficients, plain


def to_opencv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as YAML for ``cv::FileStorage``.

    Comments name LiDARs left out and assumed sites.

    A sequence "cameras", one map per unit - names of units are free, those of nodes are
    not - with id, image_width, image_height, camera_matrix, distortion_coefficients
    (zeros), R (3x3) and t (3x1) from the world to the camera, and rvec (3x1), R as
    ``cv::projectPoints`` takes it. World: east, north, up, metres. Camera: x right, y
    down, z ahead. Pixels: the middle of the first one is (0, 0). Raises InputError if
    there is no camera.
    """
    return opencv_text(
        calibrations(layout, "opencv"), layout.name, comments(layout, scene)
    )


def opencv_text(
    cameras: Mapping[str, CalibratedCamera], name: str, comment: str = ""
) -> str:
    """Calibrations as such a file.

    Fisheyes have `distortion_model` "fisheye", and k1 to k4.
    """
    records = [
        (
            *(one, camera, *lens_coefficients(one, camera)),
            Rotation.from_matrix(camera.R_camera_world).as_rotvec()[:, None],
            camera.translation_m[:, None],
        )
        for one, camera in cameras.items()
    ]
    return page_of(
        files(__package__) / "opencv.yaml.j2",
        **{
            "cameras": records,
            "name": name,
            "comment": comment,
            "yaml": _yaml,
            "plain": plain,
        },
    )


def _yaml(value: str | list[float]) -> str:
    """Text in double quotes, the only ones that FileStorage reads whole.

    Or numbers on a line.
    """
    style = (
        {"default_style": '"'}
        if isinstance(value, str)
        else {"default_flow_style": True}
    )
    text: str = yaml.safe_dump(value, allow_unicode=True, width=float("inf"), **style)
    return text.rstrip("\n")


FORMAT = ExportFormat(
    write=to_opencv,
    has_lidars=False,
)
