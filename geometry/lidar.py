"""LiDAR models: scan pattern, and which pulses come back."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike

from .arrays import FloatArray
from .errors import check_field
from .sensors import load_limits
from .tables import Table, read_table, read_tables
from .text_formats import load_data

_FILE = "lidars.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarModel:
    """A LiDAR on a fixed base, which takes a whole frame at one instant.

    Its lines and columns are at equal steps of angle.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    horizontal_fov_deg : float
        Full angle, more than 0 and up to 360: then it scans all round. [deg]
    vertical_fov_deg : float
        Full angle, as much up as down; more than 0 and less than 180. [deg]
    n_lines : int
        Scan lines, one above the other.
    points_per_second : float
        Pulses, whether they come back or not. [1/s]
    frame_rate_hz : float
        Scans per second. [Hz]
    range_m : float
        Nothing farther is reported. [m]
    reference_range_m, reference_reflectivity, reference_probability : float
        A surface of this reflectivity, met squarely in clear air at this distance,
        sends a pulse back with this probability. [m]
    threshold_width : float
        Of the logistic step between no return and return, in the logarithm of the
        signal.
    wavelength_nm : float
        Of the laser. [nm]
    range_noise_m : float
        One standard deviation. [m]
    near_m : float
        Nothing nearer is reported. [m]
    price_eur : float
        Price of one unit. [EUR]
    """

    name: str
    horizontal_fov_deg: float
    vertical_fov_deg: float
    n_lines: int
    points_per_second: float
    frame_rate_hz: float
    range_m: float
    reference_range_m: float
    reference_reflectivity: float
    reference_probability: float
    threshold_width: float
    wavelength_nm: float
    range_noise_m: float
    near_m: float
    price_eur: float

    def __post_init__(self) -> None:
        check = partial(check_field, self, self.name)
        check(
            "horizontal_fov_deg",
            0.0 < self.horizontal_fov_deg <= 360.0,
            "0 < degrees <= 360",
        )
        check(
            "vertical_fov_deg", 0.0 < self.vertical_fov_deg < 180.0, "0 < degrees < 180"
        )
        is_count = isinstance(self.n_lines, int) and not isinstance(self.n_lines, bool)
        check("n_lines", is_count and self.n_lines > 0, "a whole number of lines, > 0")
        for field in (
            *("points_per_second", "frame_rate_hz", "range_m", "reference_range_m"),
            *("threshold_width", "wavelength_nm", "near_m"),
        ):
            check(field, 0.0 < getattr(self, field) < math.inf, "a positive number")
        check(
            "range_noise_m",
            0.0 <= self.range_noise_m < math.inf,
            "a number, at least 0",
        )
        limits = load_limits()
        often = (
            f"at least {limits.least_frame_rate_hz:g}: so often all units are taken to"
            " look"
        )
        check("frame_rate_hz", self.frame_rate_hz >= limits.least_frame_rate_hz, often)
        is_price = 0.0 <= self.price_eur <= limits.price_eur
        check("price_eur", is_price, f"euros, 0 to {limits.price_eur:,.0f}")
        check("near_m", self.near_m < self.range_m, "metres, less than range_m")
        is_share = 0.0 < self.reference_reflectivity <= 1.0
        check("reference_reflectivity", is_share, "0 < share <= 1")
        is_likely = 0.0 < self.reference_probability < 1.0
        check("reference_probability", is_likely, "0 < probability < 1")
        # So many rays are cast for each frame.
        per_frame = self.points_per_second / self.frame_rate_hz
        most = limits.lidar_points_per_frame
        check(
            "points_per_second", per_frame <= most, f"at most {most:,} points per frame"
        )
        check(
            "points_per_second",
            self.n_columns > 0,
            "a point per line and frame or more",
        )

    @property
    def n_columns(self) -> int:
        """Points per line and frame."""
        return round(self.points_per_second / self.frame_rate_hz) // self.n_lines

    @property
    def scans_all_round(self) -> bool:
        """True if its columns close to a ring.

        Then no azimuth is left out, and none is an edge.
        """
        return self.horizontal_fov_deg == 360.0

    @property
    def diagonal_fov_deg(self) -> float:
        """Full angle of the cone around the axis in which all beams lie, in degrees.

        Up to 180 degrees the corners are farthest from the axis, beyond them the ends
        of the middle line: behind the sensor elevation leads back to the axis.
        """
        half_width = math.radians(0.5 * self.horizontal_fov_deg)
        corner = math.cos(half_width) * math.cos(
            math.radians(0.5 * self.vertical_fov_deg)
        )
        return 2.0 * math.degrees(max(math.acos(corner), half_width))


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarDetection:
    """What it takes to find a road user in a point cloud, by class.

    `min_points` has the points in one frame of a "pedestrian", "child" and "cyclist",
    `reflectivity` the share of the light that comes back diffusely, 0 .. 1.
    """

    min_points: Mapping[str, int]
    reflectivity: Mapping[str, float]


def beam_directions(lidar: LidarModel) -> FloatArray:
    """Unit vectors of one frame's beams, (n_lines, n_columns, 3), in the body frame.

    From the lowest line up, from right to left; x ahead, y left, z up. Each beam is in
    the middle of its cell of azimuth and elevation: at 360 degrees the columns stand
    evenly on the circle, and the seam is straight behind.
    """
    elevation = np.radians(_cell_centres(lidar.vertical_fov_deg, lidar.n_lines))[
        :, None
    ]
    azimuth = np.radians(_cell_centres(lidar.horizontal_fov_deg, lidar.n_columns))[
        None, :
    ]
    level = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), (lidar.n_lines, lidar.n_columns))
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), up], -1)


def beams_per_steradian(lidar: LidarModel, elevation_deg: ArrayLike) -> FloatArray:
    """Density of beams in a direction, in 1/sr.

    There is one beam per cell of azimuth and elevation.
    """
    azimuth_step = math.radians(lidar.horizontal_fov_deg / lidar.n_columns)
    elevation_step = math.radians(lidar.vertical_fov_deg / lidar.n_lines)
    level = np.cos(np.radians(np.asarray(elevation_deg, dtype=np.float64)))
    return 1.0 / (azimuth_step * elevation_step * level)


def return_probability(
    lidar: LidarModel,
    distance_m: ArrayLike,
    *,
    reflectivity: ArrayLike,
    incidence_cos: ArrayLike,
    extinction_per_m: ArrayLike,
) -> FloatArray:
    """Probability that a pulse which hits something is reported.

    The pulse must come back strong enough. The probability is
    `reference_probability` where the signal is that of the reference, and 0 outside
    `near_m` .. `range_m`. All arrays broadcast.

    Parameters
    ----------
    lidar : LidarModel
        The sensor.
    distance_m : (...) float
        Distance of the surface. [m]
    reflectivity : (...) float
        Share of the light that the surface sends back diffusely, 0 .. 1.
    incidence_cos : (...) float
        Cosine of the angle between beam and surface normal.
    extinction_per_m : (...) float
        Extinction of the air, one way. [1/m]

    References
    ----------
    .. [1] R. Rasshofer et al., "Influences of weather phenomena on automotive laser
       radar systems", 2011: LiDAR equation for a diffuse target larger than the beam.
    """
    from scipy.special import expit, logit

    distance = np.asarray(distance_m, dtype=np.float64)
    is_inside = (distance >= lidar.near_m) & (distance <= lidar.range_m)
    # Outside of the range any distance will do: the result there is 0.
    distance = np.where(is_inside, distance, lidar.reference_range_m)
    share = np.asarray(reflectivity, dtype=np.float64) * np.asarray(
        incidence_cos, dtype=np.float64
    )
    # Grazing or black: no signal, logarithm -inf.
    with np.errstate(divide="ignore"):
        spread = 2.0 * np.log(lidar.reference_range_m / distance)
        air = 2.0 * np.asarray(extinction_per_m, dtype=np.float64) * distance
        log_signal = np.log(share / lidar.reference_reflectivity) + spread - air
    step = expit(
        log_signal / lidar.threshold_width + logit(lidar.reference_probability)
    )
    return np.where(is_inside, step, 0.0)


def noisy_ranges(
    lidar: LidarModel, distance_m: ArrayLike, rng: np.random.Generator
) -> FloatArray:
    """Distances as the LiDAR reports them: with normal noise of `range_noise_m`."""
    distance = np.asarray(distance_m, dtype=np.float64)
    return distance + lidar.range_noise_m * rng.standard_normal(distance.shape)


@dataclass(frozen=True, slots=True, kw_only=True)
class _DetectionEntry:
    """A class of road users in ``data/lidars.toml``."""

    min_points: Annotated[int, Meta(ge=1, description="a whole number of points, > 0")]
    reflectivity: Annotated[float, Meta(gt=0.0, le=1.0, description="0 < share <= 1")]


@cache
def _load_file() -> Table:
    return load_data(__package__, _FILE)


@cache
def load_lidars() -> dict[str, LidarModel]:
    """All LiDAR models of the catalogue, by name, from ``data/lidars.toml``."""
    return read_tables(_load_file()["lidars"], LidarModel, _FILE)


@cache
def load_lidar_detection() -> LidarDetection:
    """Rule of detection in point clouds, from ``data/lidars.toml``."""
    return _read_detection(_load_file()["detection"])


def _read_detection(table: Table) -> LidarDetection:
    """Rule of detection from a table with an entry for each class."""
    entries = read_tables(table, _DetectionEntry, f"{_FILE}: detection")
    return LidarDetection(
        min_points={name: entry.min_points for name, entry in entries.items()},
        reflectivity={name: entry.reflectivity for name, entry in entries.items()},
    )


@cache
def load_surface_reflectivity() -> dict[str, float]:
    """Diffuse reflectivity of everything except VRUs, by class name.

    It is read from ``data/lidars.toml``.
    """
    return read_table(_load_file()["surfaces"], dict[str, float], f"{_FILE}: surfaces")


def _cell_centres(extent: float, n_cells: int) -> FloatArray:
    """Middles of equal cells, symmetric about 0, (n_cells,)."""
    return ((np.arange(n_cells) + 0.5) / n_cells - 0.5) * extent
