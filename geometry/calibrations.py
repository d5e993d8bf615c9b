"""Read calibrated cameras from the usual calibration files.

These are the YAML files of OpenCV and ROS, the XML files of OpenCV and Tsai,
and KITTI's text files.

Where a file does not say where a camera stands, it is at the origin and looks along z.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike

from .arrays import FloatArray, set_arrays
from .calibration_formats import refuse_unread_calibration, refuse_unread_suffix
from .errors import InputError, Unquoted, refuse
from .lenses import BrownConrady, Fisheye, Lens, TsaiRadial
from .opening import read_text
from .poses import Pose, camera_rotation
from .sensors import CameraModel, rolled
from .tables import read_data
from .xml_files import read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_CM = 0.01
_MM = 1.0e-3
_FISHEYES = ("fisheye", "equidistant")
_PINHOLES = ("plumb_bob", "rational_polynomial")
# Keys by which files of others name a camera's model, and values that are a pinhole's.
_MODEL_KEYS = ("camera_model", "model_type", "projection_model", "lens_model")
_PINHOLE_WORDS = ("pinhole", "perspective", "frame", "opencv")
# Old files of OpenCV's sample have them with other capitals: Camera_Matrix.
_OPENCV_KEYS = (
    "camera_matrix",
    "distortion_coefficients",
    "distortion_model",
    "fisheye_model",
    "image_width",
    "image_height",
)
_MOST = 1.0e9
_Size = tuple[int, int]


# ---------- cameras of calibrations
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibratedCamera:
    """A camera as its calibration file has it.

    A point p of the world is at R (p - position) in the camera's frame.

    A point's column is cx + fx x, its row cy + fy y, with x and y at depth 1 as
    the lens shows them.

    Attributes
    ----------
    width_px, height_px : int
        Size of its pictures. [px]
    fx_px, fy_px, cx_px, cy_px : float
        Focal lengths and principal point. [px]
    R_camera_world : (3, 3) float
        Rotation from the world to the camera (x right, y down, z ahead).
    position_m : (3,) float
        Position of the lens, world frame. [m]
    lens : Lens
        How it distorts.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    R_camera_world: FloatArray
    position_m: FloatArray
    lens: Lens = field(default_factory=BrownConrady)

    def __post_init__(self) -> None:
        set_arrays(self, "camera: ", R_camera_world=(3, 3), position_m=(3,))
        for name in ("width_px", "height_px", "fx_px", "fy_px"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"camera: {name}", getattr(self, name), "pixels, > 0")
        R = self.R_camera_world
        if not (
            np.allclose(R @ R.T, np.eye(3), atol=1.0e-3) and np.linalg.det(R) > 0.0
        ):
            raise InputError("camera: R_camera_world", R.tolist(), "a rotation")

    @property
    def K(self) -> FloatArray:
        """Camera matrix with focal lengths and principal point, (3, 3).

        The middle of the first pixel is (0, 0).
        """
        rows = [
            [self.fx_px, 0.0, self.cx_px],
            [0.0, self.fy_px, self.cy_px],
            [0.0, 0.0, 1.0],
        ]
        return np.array(rows)

    @property
    def translation_m(self) -> FloatArray:
        """The world's origin as the camera sees it, (3,), in metres.

        It is t in x_camera = R x_world + t.
        """
        return self.R_camera_world @ (np.zeros(3) - self.position_m)


def ground_points(pixels_px: ArrayLike, camera: CalibratedCamera) -> FloatArray:
    """Points (n, 3) of the plane z = 0 at pixels; NaN above the horizon."""
    middle = np.array([camera.cx_px, camera.cy_px])
    focal = np.array([camera.fx_px, camera.fy_px])
    at_depth_1 = camera.lens.undistort(
        (np.asarray(pixels_px, dtype=np.float64) - middle) / focal
    )
    rays = (
        np.column_stack([at_depth_1, np.ones(len(at_depth_1))]) @ camera.R_camera_world
    )
    # Rays that lead towards the plane z = 0.
    is_below = rays[:, 2] * camera.position_m[2] < 0.0
    far = -camera.position_m[2] / np.where(is_below, rays[:, 2], np.nan)
    return np.asarray(camera.position_m + far[:, None] * rays)


def project_distorted(points_m: ArrayLike, camera: CalibratedCamera) -> FloatArray:
    """Project points (n, 3) of the world frame into the image of a calibrated camera.

    As ``cv::projectPoints`` and ``cv::fisheye`` of OpenCV.

    Returns
    -------
    projected : (n, 3) float
        Column and row in the calibration's pixels, and depth along the optical
        axis in metres. Column and row are NaN where the depth is not positive,
        or where the lens shows no such point.
    """
    offsets = np.asarray(points_m, dtype=np.float64) - camera.position_m
    in_camera = offsets @ camera.R_camera_world.T
    depth = in_camera[:, 2]
    # What is behind the camera is not shown.
    at_depth_1 = in_camera[:, :2] / np.where(depth > 0.0, depth, np.nan)[:, None]
    shown = camera.lens.distort(at_depth_1)
    column = camera.cx_px + camera.fx_px * shown[:, 0]
    row = camera.cy_px + camera.fy_px * shown[:, 1]
    return np.stack([column, row, depth], axis=1)


# ---------- files
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
    refuse_unread_suffix(path)
    text = read_text(path, "text")
    # XML is OpenCV's or Tsai's; the root element tells which.
    if text.lstrip().startswith("<"):
        root = read_xml(path, expected="a calibration of OpenCV or Tsai")
        refuse_unread_calibration(text, path)
        if root.tag != "opencv_storage":
            return {path.stem: read_tsai(path)}
        return {path.stem: _camera(_xml_record(root), str(path), size_px)}
    refuse_unread_calibration(text, path)
    # Of the text formats only KITTI's has no such key.
    if "camera_matrix" not in text.lower():
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
    for key, value in [*record.items()]:
        plain = str(key).lower()
        if plain in _OPENCV_KEYS and plain not in record:
            record = {**record, plain: value}
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
    for key in _MODEL_KEYS:
        word = record.get(key, "pinhole")
        if str(word).lower() not in _PINHOLE_WORDS:
            expected = "pinhole; of a fisheye distortion_model: fisheye with four terms"
            raise InputError(f"{where}: {key}", word, expected)
    terms = _numbers(record, "distortion_coefficients", (4, 5, 8), where).tolist()
    model = _distortion_model(record, where)
    if model in _FISHEYES and len(terms) == 4:
        return Fisheye(k1=terms[0], k2=terms[1], k3=terms[2], k4=terms[3])
    expected = "plumb_bob, or 4 terms of fisheye or equidistant"
    if model in _FISHEYES:
        got = f"{model} with {len(terms)} terms"
        raise InputError(f"{where}: distortion_model", got, expected)
    if model not in _PINHOLES:
        raise InputError(f"{where}: distortion_model", model, expected)
    if any(terms[5:]):
        refuse(
            f"{where}: distortion_model",
            "a rational one, whose k4 to k6 are not 0",
            "k1, k2, p1, p2, k3: calibrate without CALIB_RATIONAL_MODEL",
        )
    k1, k2, p1, p2, k3 = (*terms, 0.0)[:5]
    return BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def _distortion_model(record: Mapping[str, Any], where: str) -> str:
    """Model of the lens by its name, or by the switch of OpenCV's own sample.

    ``samples/cpp/tutorial_code/calib3d`` of OpenCV writes "fisheye_model: 1" where it
    has called ``cv::fisheye::calibrate``.
    """
    named = record.get("distortion_model")
    is_fisheye = False
    if "fisheye_model" in record:
        (switch,) = _numbers(record, "fisheye_model", (1,), where).tolist()
        if switch not in (0.0, 1.0):
            raise InputError(f"{where}: fisheye_model", switch, "0 or 1")
        is_fisheye = switch == 1.0
    if named is None:
        return "fisheye" if is_fisheye else "plumb_bob"
    if is_fisheye and named not in _FISHEYES:
        expected = f"one lens: fisheye_model is 1, distortion_model is {named}"
        refuse(f"{where}: fisheye_model", "1", expected)
    return str(named)


def _stand(record: Mapping[str, Any], where: str) -> tuple[FloatArray, FloatArray]:
    """Rotation from the world to the camera, and the camera's position.

    The rotation is (3, 3), the position (3,) in the world frame, in metres.

    Raises
    ------
    InputError
        A number is missing, or the quaternion is not of length 1.
    """
    from scipy.spatial.transform import Rotation

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
    from scipy.spatial.transform import Rotation

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
    from scipy.spatial.transform import Rotation

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


# ---------- sensors of calibrations, and back
class _Assumed(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    frame_rate_hz: float
    near_m: float
    price_eur: float


def calibrated_sensor(name: str, camera: CalibratedCamera) -> tuple[CameraModel, Pose]:
    """Sensor and pose of a calibrated camera.

    ``data/calibrated.toml`` has what the camera's file does not tell.

    Raises
    ------
    InputError
        Half a width from its principal point the lens shows nothing.
    """
    assumed = read_data(__package__, "calibrated.toml", _Assumed)
    # Rows of the rotation are the camera's axes in the world frame.
    right, _, ahead = camera.R_camera_world
    yaw_rad = np.arctan2(ahead[1], ahead[0])
    pitch_rad = np.arcsin(ahead[2].clip(-1, 1))
    yaw_deg, pitch_deg = np.degrees([yaw_rad, pitch_rad])
    level = camera_rotation(yaw_deg, pitch_deg)
    half_rad = camera.lens.angle_of(0.5 * camera.width_px / camera.fx_px)
    if not half_rad > 0.0:
        got = Unquoted("a lens that folds the picture before its edge")
        raise InputError(
            f"{name}: distortion", got, "one that shows half a width from its middle"
        )
    model = CameraModel(
        name=name,
        width_px=camera.width_px,
        height_px=camera.height_px,
        horizontal_fov_deg=math.degrees(2.0 * half_rad),
        lens=camera.lens,
        principal_point=(
            (camera.cx_px + 0.5) / camera.width_px,
            (camera.cy_px + 0.5) / camera.height_px,
        ),
        pixel_aspect=camera.fy_px / camera.fx_px,
        roll_deg=math.degrees(math.atan2(right @ level[:, 1], right @ level[:, 0])),
        frame_rate_hz=assumed.frame_rate_hz,
        near_m=assumed.near_m,
        price_eur=assumed.price_eur,
    )
    pose = Pose(
        position_m=camera.position_m, yaw_deg=float(yaw_deg), pitch_deg=float(pitch_deg)
    )
    return model, pose


def to_calibrated(camera: CameraModel, pose: Pose) -> CalibratedCamera:
    """A camera as calibrations have it, in pixels whose middles are whole numbers.

    :func:`project_points` has the middle of the first pixel at (0.5, 0.5), so that the
    principal point is half a pixel farther there.
    """
    x_px, y_px = camera.middle_px
    return CalibratedCamera(
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.focal_length_px,
        fy_px=camera.focal_length_px * (camera.pixel_aspect or 1.0),
        cx_px=x_px - 0.5,
        cy_px=y_px - 0.5,
        R_camera_world=rolled(camera_rotation(pose.yaw_deg, pose.pitch_deg), camera).T,
        position_m=pose.position_m,
        lens=camera.lens or BrownConrady(),
    )
