"""Camera models, and the limits of all sensors and sites.

Camera models have intrinsics, projection and field of view.
"""

import math
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import ArrayLike

from .arrays import BoolArray, FloatArray, freeze
from .errors import InputError, Unquoted, check_field, refuse
from .lenses import BrownConrady, CalibratedCamera, Lens, TsaiRadial
from .phrases import Phrase
from .poses import Pose, camera_rotation
from .tables import read_data

LENS_FIELDS = ("lens", "principal_point", "pixel_aspect", "roll_deg")
SEEN_RAD = 1.5
"""Largest angle off the axis that counts in pictures of lenses: about 86 degrees."""


_N_BORDER = 64
# For what lies between the points that are tried.
_MARGIN = 1.02
_SHARES = Meta(description="[x, y] in widths and heights of the picture")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """A camera: an ideal pinhole, or one with a lens.

    The pinhole has square pixels and its axis in the middle.

    With a lens the field of view is what the picture shows: half a width from the
    principal point is a ray at half of `horizontal_fov_deg`, tangential terms aside.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    width_px, height_px : int
        Resolution. [px]
    horizontal_fov_deg : float
        Full angle across the width, more than 0 and less than 180; of a fisheye
        maybe more. [deg]
    frame_rate_hz : float
        Images per second. [Hz]
    near_m : float
        What is nearer to the lens is not drawn: housing, bracket and pole. [m]
    price_eur : float
        Price of one unit. [EUR]
    fov_range_deg : (float, float) or None
        Least and largest horizontal field of view of a varifocal lens; None:
        the lens is fixed. [deg]
    lens : Lens or None
        How it distorts; None: not at all.
    principal_point : (float, float) or None
        Where the axis meets the picture, in widths and heights of it; None: in
        its middle.
    pixel_aspect : float or None
        Focal length in rows over that in columns; None: 1.
    roll_deg : float or None
        Turn about the axis, clockwise seen from behind; None: 0. [deg]
    """

    name: str
    width_px: int
    height_px: int
    horizontal_fov_deg: float
    frame_rate_hz: float
    near_m: float
    price_eur: float
    fov_range_deg: (
        Annotated[tuple[float, float], Meta(description="[low, high] in degrees")]
        | None
    ) = None
    lens: Lens | None = None
    principal_point: Annotated[tuple[float, float], _SHARES] | None = None
    pixel_aspect: float | None = None
    roll_deg: float | None = None

    def __post_init__(self) -> None:
        check = partial(check_field, self, self.name)
        for field in ("width_px", "height_px"):
            value = getattr(self, field)
            is_count = (
                isinstance(value, int) and not isinstance(value, bool) and value > 0
            )
            check(field, is_count, "a whole number of pixels, > 0")
        limits = load_limits()
        if self.width_px * self.height_px > limits.camera_pixels:
            got = f"{self.width_px} times {self.height_px} pixels"
            refuse(
                f"{self.name}.width_px",
                got,
                Phrase("at most {n:,}", n=limits.camera_pixels),
            )
        most_deg = 180.0
        why = ""
        # A lens may show more than a pinhole can, or less.
        if self.bent is not None:
            most_deg = min(360.0, 2.0 * math.degrees(self.bent.widest_rad))
            if most_deg < 180.0:
                why = ": farther out its lens shows nothing"
            else:
                why = ""
        expected = f"0 < degrees < {most_deg:g}{why}"
        check("horizontal_fov_deg", 0.0 < self.horizontal_fov_deg < most_deg, expected)
        if self.bent is not None:
            shown = self.bent.shown_at(0.5 * math.radians(self.horizontal_fov_deg))
            check(
                "lens",
                math.isfinite(self.bent.angle_of(shown)),
                "terms that it can be drawn with",
            )
        for field, low, high in (
            ("pixel_aspect", 0.5, 2.0),
            ("roll_deg", -180.0, 180.0),
        ):
            value = getattr(self, field)
            check(field, value is None or low <= value <= high, f"{low:g} .. {high:g}")
        if self.principal_point is not None:
            is_inside = all(0.0 <= share <= 1.0 for share in self.principal_point)
            check("principal_point", is_inside, "[x, y] in the picture, 0 .. 1")
        for field in ("frame_rate_hz", "near_m"):
            check(field, 0.0 < getattr(self, field) < math.inf, "a positive number")
        often = (
            f"at least {limits.least_frame_rate_hz:g}: so often all units are taken to"
            " look"
        )
        check("frame_rate_hz", self.frame_rate_hz >= limits.least_frame_rate_hz, often)
        is_price = 0.0 <= self.price_eur <= limits.price_eur
        check("price_eur", is_price, f"euros, 0 to {limits.price_eur:,.0f}")
        if self.fov_range_deg is not None:
            low, high = self.fov_range_deg
            if not 0.0 < low < high < most_deg:
                expected = f"[low, high] in degrees, 0 < low < high < {most_deg:g}"
                raise InputError(f"{self.name}.fov_range_deg", [low, high], expected)
            is_reached = low <= self.horizontal_fov_deg <= high
            expected = f"{low:g} .. {high:g} degrees, its fov_range_deg"
            check("horizontal_fov_deg", is_reached, expected)

    @property
    def bent(self) -> Lens | None:
        """The lens, if one without any distortion would show another field of view."""
        if self.lens in (BrownConrady(), TsaiRadial(kappa=0.0)):
            return None
        return self.lens

    @property
    def is_pinhole(self) -> bool:
        """True if it is an ideal pinhole.

        Its pixels are square, and its axis is level and in the middle.
        """
        is_plain = self.principal_point in (None, (0.5, 0.5)) and self.pixel_aspect in (
            None,
            1.0,
        )
        return is_plain and not self.roll_deg and self.bent is None

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels, in columns."""
        half_rad = math.radians(0.5 * self.horizontal_fov_deg)
        if self.bent is None:
            shown = math.tan(half_rad)
        else:
            shown = self.bent.shown_at(half_rad)
        return 0.5 * self.width_px / shown

    @property
    def middle_px(self) -> tuple[float, float]:
        """Principal point: column and row; the first pixel's middle is at 0.5, 0.5."""
        x, y = self.principal_point or (0.5, 0.5)
        return x * self.width_px, y * self.height_px

    @property
    def vertical_fov_deg(self) -> float:
        """Full angle across the height, in degrees."""
        if not self.is_pinhole:
            rays = picture_rays(self.middle_px[0], [0.0, float(self.height_px)], self)
            return float(np.degrees(_angles_rad(rays, self).sum()))
        return math.degrees(
            2.0 * math.atan(0.5 * self.height_px / self.focal_length_px)
        )

    @property
    def diagonal_fov_deg(self) -> float:
        """Full angle across the diagonal, in degrees.

        The image lies within a cone of this angle.
        """
        if not self.is_pinhole:
            return _widest_fov_deg(self)
        half_diagonal_px = 0.5 * math.hypot(self.width_px, self.height_px)
        return math.degrees(2.0 * math.atan(half_diagonal_px / self.focal_length_px))


def with_fov(camera: CameraModel, fov_deg: float, where: str) -> CameraModel:
    """A camera with its varifocal lens set to another horizontal field of view.

    Raises
    ------
    InputError
        The lens is fixed at another field of view, or does not reach this one; `where`
        says what asks for it.
    """
    if fov_deg == camera.horizontal_fov_deg:
        return camera
    if camera.fov_range_deg is None:
        expected = Phrase(
            "{angle:g} degrees: {camera} has a fixed lens",
            angle=camera.horizontal_fov_deg,
            camera=camera.name,
        )
        raise InputError(where, fov_deg, expected)
    low, high = camera.fov_range_deg
    if not low <= fov_deg <= high:
        raise InputError(
            where,
            fov_deg,
            Phrase(
                "{low:g} .. {high:g} degrees, the lens of {camera}",
                low=low,
                high=high,
                camera=camera.name,
            ),
        )
    return replace(camera, horizontal_fov_deg=float(fov_deg))


def with_width(camera: CameraModel, width_px: int) -> CameraModel:
    """A camera that sees the same with so many columns, and rows to match."""
    height_px = round(camera.height_px * width_px / camera.width_px)
    return replace(camera, width_px=width_px, height_px=height_px)


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


def shown_points(at_depth_1: FloatArray, camera: CameraModel) -> FloatArray:
    """Columns and rows (n, 2) of points (n, 2) seen through the lens.

    The points are at depth 1 in the picture's axes.

    Beyond what is shown they lie straight on, as seen from the principal point: so
    boxes around bodies grow with them. :func:`is_shown` tells which these are.
    """
    lens = camera.lens or BrownConrady()
    points = at_depth_1 @ roll_axes(camera)
    radius = np.hypot(points[:, 0], points[:, 1])
    with np.errstate(invalid="ignore"):
        # Points beyond the reach are shown at the reach, and moved out again.
        beyond = np.maximum(1.0, radius / (_reach(camera) * (1.0 - 1.0e-12)))[:, None]
        shown = lens.distort(points / beyond) * beyond
    scale = camera.focal_length_px * np.array([1.0, camera.pixel_aspect or 1.0])
    return np.asarray(shown * scale + camera.middle_px)


def is_shown(at_depth_1: FloatArray, camera: CameraModel) -> BoolArray:
    """True for points (n, 2) at depth 1 that a lens shows.

    The picture is taken to be large enough.
    """
    return np.asarray(np.hypot(at_depth_1[:, 0], at_depth_1[:, 1]) <= _reach(camera))


def project_points(points_m: ArrayLike, pose: Pose, camera: CameraModel) -> FloatArray:
    """Project points (n, 3) of the world frame into the image of a camera.

    Returns
    -------
    projected : (n, 3) float
        Column and row in pixels (the centre of the first pixel is (0.5, 0.5)) and the
        depth along the optical axis in metres; column and row are NaN where the depth
        is not positive.

    References
    ----------
    .. [1] R. Hartley, A. Zisserman, "Multiple View Geometry", section 6.1 (pinhole
       camera).
    """
    offsets = np.asarray(points_m, dtype=np.float64) - pose.position_m
    in_camera = offsets @ camera_rotation(pose.yaw_deg, pose.pitch_deg)
    depth = in_camera[:, 2]
    safe = np.where(depth > 0.0, depth, np.nan)
    if not camera.is_pinhole:
        at_depth_1 = in_camera[:, :2] / safe[:, None]
        shown = shown_points(at_depth_1, camera)
        shown[~is_shown(at_depth_1, camera)] = np.nan
        return np.column_stack([shown, depth])
    middle_px = 0.5 * np.array([camera.width_px, camera.height_px])
    shown = middle_px + camera.focal_length_px * in_camera[:, :2] / safe[:, None]
    return np.column_stack([shown, depth])


def picture_rays(
    columns_px: ArrayLike, rows_px: ArrayLike, camera: CameraModel
) -> FloatArray:
    """Points (n, 2) at depth 1 that points of a picture show.

    They are right and down; NaN where the picture shows none.

    The inverse of :func:`shown_points`.
    """
    lens = camera.lens or BrownConrady()
    scale = camera.focal_length_px * np.array([1.0, camera.pixel_aspect or 1.0])
    shown = (
        np.stack(np.broadcast_arrays(columns_px, rows_px), axis=-1) - camera.middle_px
    ) / scale
    rays = lens.undistort(shown) @ roll_axes(camera).T
    rays[~is_shown(rays, camera)] = np.nan
    return rays


# 33 MB each at 1080 rows.
@lru_cache(maxsize=4)
def pixel_grid(camera: CameraModel) -> FloatArray:
    """Points (height, width, 2) at depth 1 that the middles of pixels show.

    NaN where a pixel shows none.
    """
    rows, columns = np.indices((camera.height_px, camera.width_px)).reshape(2, -1) + 0.5
    rays = picture_rays(columns, rows, camera)
    return freeze(rays.reshape(camera.height_px, camera.width_px, 2))


@lru_cache(maxsize=64)
def _widest_fov_deg(camera: CameraModel) -> float:
    """Twice the largest angle off the axis along the picture's edge."""
    steps = np.linspace(0.0, 1.0, _N_BORDER, endpoint=False)
    x = np.concatenate([steps, np.ones(_N_BORDER), 1.0 - steps, np.zeros(_N_BORDER)])
    y = np.roll(x, _N_BORDER)
    rays = picture_rays(x * camera.width_px, y * camera.height_px, camera)
    return float(np.degrees(2.0 * _angles_rad(rays, camera).max()))


@lru_cache(maxsize=64)
def sharpest_px_per_rad(camera: CameraModel) -> float:
    """Most pixels per radian anywhere in the picture of a lens."""
    sides_px = (camera.width_px, camera.height_px)
    x, y = np.meshgrid(*(np.linspace(0.0, side, _N_BORDER) for side in sides_px))
    ways = []
    for column, row in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5)):
        inwards = np.where(x < camera.middle_px[0], column, -column)
        down = np.where(y < camera.middle_px[1], row, -row)
        rays = picture_rays((x + inwards).ravel(), (y + down).ravel(), camera)
        way = np.column_stack([rays, np.ones(len(rays))])
        ways.append(way / np.linalg.norm(way, axis=1, keepdims=True))
    # Change of direction per pixel, in both directions of the picture.
    turns = np.stack([ways[1] - ways[0], ways[2] - ways[0]], axis=2) / 0.5
    turns = turns[np.isfinite(turns).all(axis=(1, 2))]
    return float(_MARGIN / np.linalg.svd(turns, compute_uv=False)[:, 1].min())


def roll_axes(camera: CameraModel) -> FloatArray:
    """Axes that turn a level camera's points into the picture's, (2, 2).

    Points (n, 2) in the axes of a level camera times this matrix are in the
    picture's.
    """
    roll_rad = math.radians(camera.roll_deg or 0.0)
    cos = math.cos(roll_rad)
    sin = math.sin(roll_rad)
    return np.array([[cos, -sin], [sin, cos]])


def rolled(rotation: FloatArray, camera: CameraModel) -> FloatArray:
    """Rotation (3, 3) from the frame of a camera that may be rolled.

    `rotation` is that from the frame of a level one.
    """
    if not camera.roll_deg:
        return rotation
    return np.column_stack([rotation[:, :2] @ roll_axes(camera), rotation[:, 2]])


def _reach(camera: CameraModel) -> float:
    """Radius at depth 1 up to which points of a camera's picture count."""
    if camera.lens is None:
        reach = math.inf
    else:
        reach = camera.lens.reach
    return min(reach, math.tan(SEEN_RAD))


def _angles_rad(rays: FloatArray, camera: CameraModel) -> FloatArray:
    """Angles (n,) of rays off the axis; where there is none, the most that is shown."""
    angle = np.arctan(np.hypot(rays[:, 0], rays[:, 1]))
    return np.where(np.isnan(angle), math.atan(_reach(camera)), angle)


# ---------- largest values of sensors, sites and scenes
class _Limits(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera_pixels: int
    least_frame_rate_hz: float
    lidar_points_per_frame: int
    price_eur: float
    capacity_units: int
    coordinate_m: float
    line_points: int
    lanes: int
    lanes_length_m: float
    lane_width_m: tuple[float, float]
    crosswalks: int
    crosswalk_length_m: float


@cache
def load_limits() -> _Limits:
    """All of them."""
    return read_data(__package__, "limits.toml", _Limits)
