"""Read calibrated cameras from the usual calibration files.

These are the YAML files of OpenCV and ROS, the XML files of OpenCV and Tsai,
and KITTI's text files.

Where a file does not say where a camera stands, it is at the origin and looks along z.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from .arrays import FloatArray
from .errors import InputError, Unquoted
from .lenses import BrownConrady, CalibratedCamera, Fisheye, Lens, TsaiRadial
from .opening import read_text
from .xml_files import read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_CM = 0.01
_MM = 1.0e-3
_FISHEYES = ("fisheye", "equidistant")
_MOST = 1.0e9
_Size = tuple[int, int]


def read_cameras(
    path: Path, *, size_px: _Size | None = None
) -> dict[str, CalibratedCamera]:
    """Cameras by name; the content says which format it is.

    `size_px` is the width and height of pictures, which KITTI's and some of
    OpenCV's files do not tell.

    Raises
    ------
    InputError
        Nothing of it can be read, a number is missing or impossible, or the
        lens is of another model than Brown-Conrady's, OpenCV's fisheye and
        Tsai's.
    """
    text = read_text(path, "text")
    # XML is OpenCV's or Tsai's; the root element tells which.
    if text.lstrip().startswith("<"):
        root = read_xml(path, expected="a calibration of OpenCV or Tsai")
        if root.tag != "opencv_storage":
            return {path.stem: read_tsai(path)}
        return {path.stem: _camera(_xml_record(root), str(path), size_px)}
    # Of the text formats only KITTI's has no such key.
    if "camera_matrix" not in text:
        return {path.stem: read_kitti_camera(path, _size(size_px, str(path)))}
    records: list[tuple[str, Mapping[str, Any]]] = []
    for document in _yaml_documents(text, path):
        for one in document.get("cameras", [document]):
            if not isinstance(one, Mapping):
                raise InputError(f"{path}: cameras", one, "maps with camera_matrix")
            name = one.get("unit", one.get("id", one.get("camera_name", path.stem)))
            records.append((str(name), one))
    names = [name for name, _ in records]
    if not names or len(set(names)) < len(names):
        if names:
            got = f"cameras {', '.join(names)}"
        else:
            got = "no camera"
        raise InputError(
            str(path), Unquoted(got), "at least one, each with a name of its own"
        )
    return {name: _camera(one, f"{path}: {name}", size_px) for name, one in records}


def _yaml_documents(text: str, path: Path) -> list[Mapping[str, Any]]:
    """Documents of a YAML file, each a map.

    Raises
    ------
    InputError
        The text is no YAML, or a document is no map.
    """
    import yaml  # type: ignore[import-untyped]

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """Also reads OpenCV's matrices, as maps."""

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, True),
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
            raise InputError(
                str(path), Unquoted("no map"), "a calibration of OpenCV or ROS"
            )
    return found


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


def _camera(
    record: Mapping[str, Any], where: str, size_px: _Size | None
) -> CalibratedCamera:
    """A camera of OpenCV's or ROS's fields."""
    K = _numbers(record, "camera_matrix", (9,), where).reshape(3, 3)
    size_px = _size(size_px, where, record)
    rotation, position = _stand(record, where)
    return _calibrated(
        where, "camera_matrix", K, size_px, rotation, position, _lens(record, where)
    )


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


def _size(
    size_px: _Size | None, where: str, record: Mapping[str, Any] | None = None
) -> _Size:
    """Width and height of pictures, from the file or else from the user.

    Raises
    ------
    InputError
        Neither says it.
    """
    if record is not None and "image_width" in record:
        width_px = _whole(record, "image_width", where)
        height_px = _whole(record, "image_height", where)
        return width_px, height_px
    if size_px is None:
        raise InputError(
            where, Unquoted("no size of pictures"), "their width and height as well"
        )
    return size_px


def _whole(record: Mapping[str, Any], key: str, where: str) -> int:
    """Whole number of a field, or InputError."""
    (value,) = _numbers(record, key, (1,), where).tolist()
    if value != round(value):
        raise InputError(f"{where}: {key}", value, "a whole number")
    return int(value)


def _lens(record: Mapping[str, Any], where: str) -> Lens:
    """Lens of OpenCV's coefficients: 4, 5 or 8, of which the last three are zero."""
    terms = _numbers(record, "distortion_coefficients", (4, 5, 8), where).tolist()
    model = record.get("distortion_model", "plumb_bob")
    if model in _FISHEYES and len(terms) == 4:
        return Fisheye(k1=terms[0], k2=terms[1], k3=terms[2], k4=terms[3])
    if model not in ("plumb_bob", "rational_polynomial") or any(terms[5:]):
        if model in _FISHEYES:
            got = f"{model} with {len(terms)} terms"
        else:
            got = model
        expected = "plumb_bob, or 4 terms of fisheye or equidistant"
        raise InputError(f"{where}: distortion_model", got, expected)
    k1, k2, p1, p2, k3 = (*terms, 0.0)[:5]
    return BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _stand(record: Mapping[str, Any], where: str) -> tuple[FloatArray, FloatArray]:
    """Rotation from the world to the camera, and the camera's position.

    The rotation is (3, 3), the position (3,) in the world frame, in metres.

    Raises
    ------
    InputError
        A number is missing, or the quaternion is not of length 1.
    """
    transform = record.get("static_transform")
    if isinstance(transform, Mapping):
        inner = transform.get("transform")
        if isinstance(inner, Mapping):
            parts = inner
        else:
            parts = {}
        position = _numbers(parts, "translation", (3,), where)
        turn = _numbers(parts, "rotation", (4,), where)
        # scipy would normalise any quaternion without a word.
        if not np.isclose(np.linalg.norm(turn), 1.0, atol=1.0e-3):
            raise InputError(
                f"{where}: rotation", turn.tolist(), "a quaternion of length 1"
            )
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
    if isinstance(value, str) and len(counts) == 1:
        value = value.split()
    if isinstance(value, Mapping):
        if "data" in value:
            value = value["data"]
        else:
            value = [*value.values()]
    listed: list[Any] = value if isinstance(value, list) else [value]
    try:
        # A list in a list is none.
        numbers = np.array([float(one) for one in listed])
    except (TypeError, ValueError):
        numbers = np.full(0, np.nan)
    if len(numbers) not in counts or not (abs(numbers) < _MOST).all():
        count = " or ".join(map(str, counts))
        got = Unquoted(
            "nothing" if value is None else f"{len(listed)} of another kind or size"
        )
        raise InputError(f"{where}: {key}", got, f"{count} finite numbers")
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
    turn = _numbers(pose, "rvec", (3,), str(extrinsic))
    shift_cm = _numbers(pose, "tvec", (3,), str(extrinsic))
    R = Rotation.from_rotvec(turn).as_matrix()
    # The same fields as in a file that has everything in it.
    record = _xml_record(read_xml(intrinsic, expected=what))
    width_px, height_px = size_px
    record["image_width"] = width_px
    record["image_height"] = height_px
    record["R"] = R.ravel().tolist()
    record["t"] = (_CM * shift_cm).tolist()
    return _camera(record, str(intrinsic), None)


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
                _numbers({"P2": words[1:]}, "P2", (12,), where).reshape(3, 4), [3], 1
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
    """A camera of Tsai's calibration in XML; lengths in the file are millimetres.

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
            v[name] = float(_numbers(element.attrib, name, (1,), f"{path}: {tag}")[0])
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
    width_px = _whole(v, "width", str(path))
    height_px = _whole(v, "height", str(path))
    size_px = (width_px, height_px)
    return _calibrated(str(path), "Intrinsic", K, size_px, R, position_m, lens)
