"""Cameras of recordings: OpenCV's and Tsai's XML, and KITTI's text files."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.lenses import BrownConrady, CalibratedCamera, Lens, TsaiRadial
from geometry.opening import read_text
from geometry.xml_files import read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_CM = 0.01
_MM = 1.0e-3
_MOST = 1.0e9
_Size = tuple[int, int]


def _xml_record(root: "Element") -> dict[str, Any]:
    """Elements of OpenCV's XML, by name.

    A matrix becomes a map of its data, every other element its text.
    """
    found = {}
    for one in root:
        data = one.find("data")
        words = (one.text or "").strip() if data is None else (data.text or "").split()
        found[one.tag] = words if data is None else {"data": words}
    return found


def _calibrated(
    where: str,
    name: str,
    K: FloatArray,
    size_px: _Size,
    rotation: FloatArray,
    position_m: FloatArray,
    lens: Lens,
) -> CalibratedCamera:
    """A camera with a matrix (3, 3) of this name; errors name the file."""
    if not np.array_equal(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1]):
        raise InputError(f"{where}: {name}", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
    fx_px, cx_px, fy_px, cy_px = K[[0, 0, 1, 1], [0, 2, 1, 2]].tolist()
    try:
        return CalibratedCamera(
            width_px=size_px[0],
            height_px=size_px[1],
            fx_px=fx_px,
            fy_px=fy_px,
            cx_px=cx_px,
            cy_px=cy_px,
            R_camera_world=rotation,
            position_m=position_m,
            lens=lens,
        )
    except InputError as error:
        field = error.where.removeprefix("camera: ")
        raise InputError(f"{where}: {field}", error.got, error.expected) from None


def _numbers(record: Mapping[str, Any], key: str, count: int, where: str) -> FloatArray:
    """Numbers (count,) of a field.

    A text, words, or a map with words as "data".

    Raises
    ------
    InputError
        The field is missing, or has another number of finite numbers.
    """
    value: Any = record.get(key)
    if isinstance(value, Mapping):
        value = value["data"]
    if isinstance(value, str):
        value = value.split()
    try:
        numbers = np.array([float(word) for word in value or ()])
    except ValueError:
        numbers = np.full(0, np.nan)
    if len(numbers) != count or not (abs(numbers) < _MOST).all():
        raise InputError(f"{where}: {key}", value, f"{count} finite numbers")
    return numbers


def read_opencv_camera(
    intrinsic: Path, extrinsic: Path, size_px: _Size
) -> CalibratedCamera:
    """Camera of OpenCV's XML: intrinsics in one file, pose in another.

    `intrinsic` has the matrix and the distortion, `extrinsic` has rvec and
    tvec; tvec is in centimetres.

    Raises
    ------
    InputError
        Numbers are missing or no camera's.
    """
    what = "a calibration of OpenCV"
    pose = _xml_record(read_xml(extrinsic, expected=what))
    turn = _numbers(pose, "rvec", 3, str(extrinsic))
    shift_cm = _numbers(pose, "tvec", 3, str(extrinsic))
    R = Rotation.from_rotvec(turn).as_matrix()
    record = _xml_record(read_xml(intrinsic, expected=what))
    where = str(intrinsic)
    K = _numbers(record, "camera_matrix", 9, where).reshape(3, 3)
    terms = _numbers(record, "distortion_coefficients", 5, where).tolist()
    k1, k2, p1, p2, k3 = terms
    lens = BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
    position_m = -R.T @ (_CM * shift_cm)
    return _calibrated(where, "camera_matrix", K, size_px, R, position_m, lens)


def read_kitti_camera(path: Path, size_px: _Size) -> CalibratedCamera:
    """A camera of a calibration file, in the frame of the rectified camera 0.

    The file does not say how large the pictures are.

    Raises
    ------
    InputError
        The matrix is missing, or is no camera's.
    """
    for row, text in enumerate(read_text(path, "text").splitlines(), start=1):
        words = text.split()
        if words and words[0].rstrip(":") == "P2":
            where = f"{path}:{row}"
            K, shift = np.split(
                _numbers({"P2": words[1:]}, "P2", 12, where).reshape(3, 4), [3], 1
            )
            # Of a projection matrix [K | K t] the camera stands at -t.
            if not (np.diag(K) > 1.0e-3).all():
                raise InputError(f"{where}: P2", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
            position_m = np.asarray(-np.linalg.solve(K, shift[:, 0]), dtype=np.float64)
            return _calibrated(
                where, "P2", K, size_px, np.eye(3), position_m, BrownConrady()
            )
    raise InputError(str(path), Unquoted("no P2"), "a line P2: with 12 numbers")


_TSAI = {
    "Geometry": ("width", "height", "dpx", "dpy"),
    "Intrinsic": ("focal", "kappa1", "cx", "cy", "sx"),
    "Extrinsic": ("tx", "ty", "tz", "rx", "ry", "rz"),
}


def read_tsai(path: Path) -> CalibratedCamera:
    """A camera of Tsai's calibration in XML.

    Lengths in the file are millimetres.

    Raises
    ------
    InputError
        Something is missing or impossible.
    """
    root = read_xml(path, expected="a Tsai calibration")
    v: dict[str, float] = {}
    for tag, names in _TSAI.items():
        element = root.find(tag)
        if element is None:
            expected = f"<{tag} {'= '.join(names)}=>"
            raise InputError(f"{path}: {tag}", Unquoted("nothing"), expected)
        for name in names:
            v[name] = float(_numbers(element.attrib, name, 1, f"{path}: {tag}")[0])
    for name in ("dpx", "dpy", "focal", "sx"):
        if not v[name] > 1.0e-9:
            raise InputError(f"{path}: {name}", v[name], "more than 0")
    fx = v["focal"] * v["sx"] / v["dpx"]
    fy = v["focal"] / v["dpy"]
    K = np.array(
        [
            [fx, 0.0, v["cx"]],
            [0.0, fy, v["cy"]],
            [0.0, 0.0, 1.0],
        ]
    )
    # Tsai's rotation leads from the world to the camera, as R_camera_world does.
    R = Rotation.from_euler("xyz", [v["rx"], v["ry"], v["rz"]]).as_matrix()
    shift_mm = np.array([v["tx"], v["ty"], v["tz"]])
    position_m = -R.T @ (_MM * shift_mm)
    lens = TsaiRadial(kappa=v["kappa1"] * v["focal"] ** 2)
    size_px = (round(v["width"]), round(v["height"]))
    return _calibrated(str(path), "Intrinsic", K, size_px, R, position_m, lens)
