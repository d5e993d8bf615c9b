"""Named weathers: light, and what the air takes from contrast and from laser pulses."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from .arrays import FloatArray
from .errors import check_field
from .tables import pick, read_tables
from .text_formats import load_data

CONTRAST_AT_VISIBILITY = 0.05
"""Contrast that remains at the visibility (meteorological optical range, WMO-No. 8)."""
_DB_PER_NEPER = 10.0 / math.log(10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Weather:
    """Light and air.

    Attributes
    ----------
    name : str
        "day", "night", "rain" or "fog".
    visibility_m : float
        Meteorological optical range of haze and fog, without rain. [m]
    rain_rate_mmph : float
        Rain. [mm/h]
    sun_elevation_deg, sun_yaw_deg : float
        Where the sun stands: above the horizon, counter-clockwise from east. [deg]
    sun_lux, sky_lux : float
        On a surface that faces the sun, and on level ground from the sky. [lx]
    has_lamps : bool
        Street lamps and headlights are on.
    contrast : float
        Of a VRU against what is behind it, before the air takes its part; 1 in full
        daylight.
    wetness : float
        How much of a mirror the road is, 0 .. 1.
    """

    name: str
    visibility_m: float
    rain_rate_mmph: float
    sun_elevation_deg: float
    sun_yaw_deg: float
    sun_lux: float
    sky_lux: float
    has_lamps: bool
    contrast: float
    wetness: float

    def __post_init__(self) -> None:
        for field, is_valid, expected in (
            ("visibility_m", self.visibility_m > 0.0, "metres, > 0"),
            ("rain_rate_mmph", self.rain_rate_mmph >= 0.0, "mm/h, at least 0"),
            (
                "sun_elevation_deg",
                abs(self.sun_elevation_deg) <= 90.0,
                "-90 .. 90 degrees",
            ),
            ("sun_lux", self.sun_lux >= 0.0, "lux, at least 0"),
            ("sky_lux", self.sky_lux >= 0.0, "lux, at least 0"),
            ("has_lamps", isinstance(self.has_lamps, bool), "true or false"),
            ("contrast", 0.0 < self.contrast <= 1.0, "0 < contrast <= 1"),
            ("wetness", 0.0 <= self.wetness <= 1.0, "0 .. 1"),
        ):
            check_field(self, f"weather {self.name}", field, is_valid, expected)

    @property
    def level_lux(self) -> float:
        """Daylight on level ground, in lux."""
        height = max(0.0, math.sin(math.radians(self.sun_elevation_deg)))
        return self.sun_lux * height + self.sky_lux

    @property
    def extinction_per_m(self) -> float:
        """Share of visible light lost per metre, by Beer and Lambert.

        References
        ----------
        .. [1] H. Koschmieder, "Theorie der horizontalen Sichtweite", 1924: -ln(0.05) /
           visibility.
        """
        return -math.log(CONTRAST_AT_VISIBILITY) / self.visibility_m + self._rain_per_m

    def transmission(self, distance_m: ArrayLike) -> FloatArray:
        """Share of light, and of contrast, that remains after a distance.

        >>> fog = load_weathers()["fog"]
        >>> float(fog.transmission(fog.visibility_m).round(12))
        0.05
        """
        return np.exp(-self.extinction_per_m * np.asarray(distance_m, dtype=np.float64))

    def lidar_extinction_per_m(self, wavelength_nm: float) -> float:
        """Share of a laser pulse that rain and haze take per metre, one way.

        With the exponent of I. Kim et al., "Comparison of laser beam propagation at 785
        nm and 1550 nm in fog and haze for optical wireless communications", 2001.
        """
        # Visibility is defined for green light.
        scale = (wavelength_nm / 550.0) ** -_kim_exponent(self.visibility_m)
        haze_per_m = -math.log(CONTRAST_AT_VISIBILITY) / self.visibility_m
        return float(haze_per_m * scale + self._rain_per_m)

    @property
    def _rain_per_m(self) -> float:
        """Extinction by rain per metre.

        Drops are large against any wavelength used here, so that all lose the
        same (ITU-R P.1814).
        """
        return float(1.076 * self.rain_rate_mmph**0.67 / _DB_PER_NEPER / 1000.0)


def _kim_exponent(visibility_m: float) -> float:
    """How much less long waves lose in haze; nothing in fog."""
    visibility_km = visibility_m / 1000.0
    if visibility_km > 50.0:
        return 1.6
    if visibility_km > 6.0:
        return 1.3
    if visibility_km > 1.0:
        return 0.16 * visibility_km + 0.34
    return max(0.0, visibility_km - 0.5)


@cache
def load_weathers() -> dict[str, Weather]:
    """All weathers, by name, from ``data/weather.toml``."""
    table = load_data(__package__, "weather.toml")
    return read_tables(table, Weather, "weather.toml")


def pick_weather(name: str, where: str) -> Weather:
    """Weather by name; the error about an unknown one lists the known ones."""
    return pick(load_weathers(), name, where)
