"""Camera models: intrinsics, projection, field of view; and the limits of all sensors and sites."""

import math
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.resources import files
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import ArrayLike

from .arrays import FloatArray
from .errors import InputError, check_field, refuse
from .files import load_toml, read_table
from .poses import Pose, camera_rotation


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """An ideal pinhole camera with square pixels and a centred principal point."""

    name: str  #: in the catalogue
    width_px: int
    height_px: int
    horizontal_fov_deg: float  #: full angle across the width, more than 0 and less than 180
    frame_rate_hz: float  #: images per second
    near_m: float  #: what is nearer to the lens is not drawn: housing, bracket and pole
    price_eur: float  #: of one unit
    #: least and largest horizontal field of view of a varifocal lens; None: the lens is fixed
    fov_range_deg: (
        Annotated[tuple[float, float], Meta(description="[low, high] in degrees")] | None
    ) = None

    def __post_init__(self) -> None:
        check = partial(check_field, self, self.name)
        for field in ("width_px", "height_px"):
            value = getattr(self, field)
            is_count = isinstance(value, int) and not isinstance(value, bool) and value > 0
            check(field, is_count, "a whole number of pixels, > 0")
        limits = load_limits()
        if self.width_px * self.height_px > limits.camera_pixels:
            got = f"{self.width_px} times {self.height_px} pixels"
            refuse(f"{self.name}.width_px", got, f"at most {limits.camera_pixels:,}")
        check("horizontal_fov_deg", 0.0 < self.horizontal_fov_deg < 180.0, "0 < degrees < 180")
        for field in ("frame_rate_hz", "near_m"):
            check(field, 0.0 < getattr(self, field) < math.inf, "a positive number")
        is_price = 0.0 <= self.price_eur <= limits.price_eur
        check("price_eur", is_price, f"euros, 0 to {limits.price_eur:,.0f}")
        if self.fov_range_deg is not None:
            low, high = self.fov_range_deg
            if not 0.0 < low < high < 180.0:
                expected = "[low, high] in degrees, 0 < low < high < 180"
                raise InputError(f"{self.name}.fov_range_deg", [low, high], expected)
            is_reached = low <= self.horizontal_fov_deg <= high
            expected = f"{low:g} .. {high:g} degrees, its fov_range_deg"
            check("horizontal_fov_deg", is_reached, expected)

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.width_px / math.tan(math.radians(0.5 * self.horizontal_fov_deg))

    @property
    def vertical_fov_deg(self) -> float:
        """Full angle across the height, in degrees."""
        return math.degrees(2.0 * math.atan(0.5 * self.height_px / self.focal_length_px))

    @property
    def diagonal_fov_deg(self) -> float:
        """Full angle across the diagonal, in degrees: the image lies within this cone."""
        half_diagonal_px = 0.5 * math.hypot(self.width_px, self.height_px)
        return math.degrees(2.0 * math.atan(half_diagonal_px / self.focal_length_px))


def with_fov(camera: CameraModel, fov_deg: float, where: str) -> CameraModel:
    """A camera with its varifocal lens at another field of view; InputError: out of its reach."""
    if fov_deg == camera.horizontal_fov_deg:
        return camera
    if camera.fov_range_deg is None:
        expected = f"{camera.horizontal_fov_deg:g} degrees: {camera.name} has a fixed lens"
        raise InputError(where, fov_deg, expected)
    low, high = camera.fov_range_deg
    if not low <= fov_deg <= high:
        raise InputError(where, fov_deg, f"{low:g} .. {high:g} degrees, the lens of {camera.name}")
    return replace(camera, horizontal_fov_deg=float(fov_deg))


def project_points(points_m: ArrayLike, pose: Pose, camera: CameraModel) -> FloatArray:
    """Columns and rows [px] and depths [m] of points (n, 3) in an image; NaN behind the camera."""
    offsets = np.asarray(points_m, dtype=np.float64) - pose.position_m
    in_camera = offsets @ camera_rotation(pose.yaw_deg, pose.pitch_deg)
    depth = in_camera[:, 2]
    safe = np.where(depth > 0.0, depth, np.nan)
    return np.stack(
        [
            0.5 * camera.width_px + camera.focal_length_px * in_camera[:, 0] / safe,
            0.5 * camera.height_px + camera.focal_length_px * in_camera[:, 1] / safe,
            depth,
        ],
        axis=1,
    )


def pixel_rays(
    columns_px: ArrayLike, rows_px: ArrayLike, pose: Pose, camera: CameraModel
) -> FloatArray:
    """Directions (n, 3) through pixels' centres, world frame; 1 along the optical axis."""
    columns = np.asarray(columns_px, dtype=np.float64) + 0.5
    rows = np.asarray(rows_px, dtype=np.float64) + 0.5
    in_camera = np.stack(
        [
            (columns - 0.5 * camera.width_px) / camera.focal_length_px,
            (rows - 0.5 * camera.height_px) / camera.focal_length_px,
            np.ones_like(columns),
        ],
        axis=1,
    )
    return in_camera @ camera_rotation(pose.yaw_deg, pose.pitch_deg).T


# ---------- largest values of sensors and sites
class _Limits(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    camera_pixels: int
    lidar_points_per_frame: int
    price_eur: float
    capacity_units: int


@cache
def load_limits() -> _Limits:
    """All of them."""
    name = "limits.toml"
    return read_table(load_toml(files(__package__) / "data" / name), _Limits, name)
