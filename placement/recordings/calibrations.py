"""Calibrated cameras of a file: OpenCV's and ROS's YAML, OpenCV's and Tsai's XML, KITTI's text.

Where a file does not say where a camera stands, it is at the origin and looks along z.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import read_text
from geometry.lenses import BrownConrady, CalibratedCamera, Fisheye, Lens
from geometry.untrusted_files import read_xml

from .cvml import read_tsai
from .kitti import read_kitti_camera

_FISHEYES = ("fisheye", "equidistant")
_MOST = 1.0e9
_Size = tuple[int, int]


def read_cameras(path: Path, *, size_px: _Size | None = None) -> dict[str, CalibratedCamera]:
    """Cameras by name; the content says which format it is.

    `size_px` is the width and height of pictures, which KITTI's and some of OpenCV's files do not
    tell. Raises InputError: nothing of it can be read, a number is missing or impossible, or the
    lens is of another model than Brown-Conrady's, OpenCV's fisheye and Tsai's.
    """
    text = read_text(path, "text")
    if text.lstrip().startswith("<"):
        root = read_xml(path, expected="a calibration of OpenCV or Tsai")
        if root.tag != "opencv_storage":
            return {path.stem: read_tsai(path)}
        record = {one.tag: _xml_value(one) for one in root}
        return {path.stem: _camera(record, str(path), size_px)}
    if "camera_matrix" not in text:
        width, height = _size(size_px, str(path))
        return {path.stem: read_kitti_camera(path, width_px=width, height_px=height)}
    records: list[tuple[str, Mapping[str, Any]]] = []
    for document in _yaml_documents(text, path):
        for one in document.get("cameras", [document]):
            if not isinstance(one, Mapping):
                raise InputError(f"{path}: cameras", one, "maps with camera_matrix")
            name = one.get("unit", one.get("id", one.get("camera_name", path.stem)))
            records.append((str(name), one))
    return {name: _camera(one, f"{path}: {name}", size_px) for name, one in records}


def _yaml_documents(text: str, path: Path) -> list[Mapping[str, Any]]:
    import yaml  # type: ignore[import-untyped]

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """Also reads OpenCV's matrices, as maps."""

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, True)
    )
    # OpenCV's first line, "%YAML:1.0", is no directive of YAML.
    plain = "\n".join("" if one.startswith("%") else one for one in text.splitlines())
    try:
        found = [one for one in yaml.load_all(plain, Loader) if one is not None]
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        reason = Unquoted(" ".join(str(error).split()))
        raise InputError(str(path), reason, "a calibration in YAML") from None
    for one in found:
        if not isinstance(one, Mapping) or not isinstance(one.get("cameras", []), list):
            raise InputError(str(path), Unquoted("no map"), "a calibration of OpenCV or ROS")
    return found


def _xml_value(element: Any) -> object:
    data = element.find("data")
    return (element.text or "").strip() if data is None else {"data": (data.text or "").split()}


def _camera(record: Mapping[str, Any], where: str, size_px: _Size | None) -> CalibratedCamera:
    K = _numbers(record, "camera_matrix", (9,), where)
    if K[[1, 3, 6, 7]].any() or K[8] != 1.0:
        raise InputError(f"{where}: camera_matrix", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
    fx, cx, fy, cy = K[[0, 2, 4, 5]].tolist()
    width, height = _size(size_px, where, record)
    rotation, position = _stand(record, where)
    try:
        return CalibratedCamera(
            width_px=width,
            height_px=height,
            fx_px=fx,
            fy_px=fy,
            cx_px=cx,
            cy_px=cy,
            R_camera_world=rotation,
            position_m=position,
            lens=_lens(record, where),
        )
    except InputError as error:
        raise InputError(
            f"{where}: {error.where.removeprefix('camera: ')}", error.got, error.expected
        ) from None


def _size(size_px: _Size | None, where: str, record: Mapping[str, Any] | None = None) -> _Size:
    if record is not None and "image_width" in record:
        width, height = (
            int(_numbers(record, f"image_{side}", (1,), where)[0]) for side in ("width", "height")
        )
        return width, height
    if size_px is None:
        raise InputError(where, Unquoted("no size of pictures"), "their width and height as well")
    return size_px


def _lens(record: Mapping[str, Any], where: str) -> Lens:
    """Lens of OpenCV's coefficients: 4, 5 or 8, of which the last three are zero."""
    terms = _numbers(record, "distortion_coefficients", (4, 5, 8), where).tolist()
    model = record.get("distortion_model", "plumb_bob")
    if model in _FISHEYES and len(terms) == 4:
        return Fisheye(k1=terms[0], k2=terms[1], k3=terms[2], k4=terms[3])
    if model not in ("plumb_bob", "rational_polynomial") or any(terms[5:]):
        got = f"{model} with {len(terms)} terms" if model in _FISHEYES else model
        expected = "plumb_bob, or 4 terms of fisheye or equidistant"
        raise InputError(f"{where}: distortion_model", got, expected)
    k1, k2, p1, p2, k3 = (*terms, 0.0)[:5]
    return BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _stand(record: Mapping[str, Any], where: str) -> tuple[FloatArray, FloatArray]:
    """Rotation from the world to the camera, and where it stands in the world, in metres."""
    transform = record.get("static_transform")
    if isinstance(transform, Mapping):
        inner = transform.get("transform")
        parts = inner if isinstance(inner, Mapping) else {}
        position = _numbers(parts, "translation", (3,), where)
        turn = _numbers(parts, "rotation", (4,), where)
        if not np.isclose(np.linalg.norm(turn), 1.0, atol=1.0e-3):
            raise InputError(f"{where}: rotation", turn.tolist(), "a quaternion of length 1")
        return Rotation.from_quat(turn).as_matrix().T, position
    if "R" not in record:
        return np.eye(3), np.zeros(3)
    rotation = _numbers(record, "R", (9,), where).reshape(3, 3)
    return rotation, -rotation.T @ _numbers(record, "t", (3,), where)


def _numbers(
    record: Mapping[str, Any], key: str, counts: tuple[int, ...], where: str
) -> FloatArray:
    """Numbers of a matrix, a list, or a map of them."""
    value: Any = record.get(key)
    if isinstance(value, Mapping):
        value = value["data"] if "data" in value else [*value.values()]
    listed: list[Any] = value if isinstance(value, list) else [value]
    try:
        numbers = np.array([float(one) for one in listed])  # a list in a list is none
    except (TypeError, ValueError):
        numbers = np.full(0, np.nan)
    if len(numbers) not in counts or not (abs(numbers) < _MOST).all():
        count = " or ".join(map(str, counts))
        got = Unquoted("nothing" if value is None else f"{len(listed)} of another kind or size")
        raise InputError(f"{where}: {key}", got, f"{count} finite numbers")
    return numbers
