"""The sky: how bright it is where, what it gives to the ground, and what the air adds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.arrays import FloatArray, float_array
from geometry.raycast import FloatRays
from geometry.toml_files import take, take_number
from geometry.weather import Weather

from .lamps import load_lamp_table

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear red, green, blue (ITU-R BT.709)
_EXPONENT = 0.6  # of the sine of the elevation, from horizon to zenith
_WHERE = "lamps.toml: sky"
_FOG_VISIBILITY_M = 1000.0  # below it is fog (WMO-No. 407)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Light from above, without the sun.

    Attributes
    ----------
    horizon_cdpm2, zenith_cdpm2 : (3,) float
        Luminance by colour. [cd/m^2]
    air_cdpm2 : (3,) float
        Luminance of air without end: what distance fades into. [cd/m^2]
    sky_lux, sun_lux : (3,) float
        On level ground, and on what faces the sun. [lx]
    to_sun : (3,) float
        Unit, world frame.
    haze_height_m : float
        Depth of the layer of air that takes the contrast. [m]
    extinction_per_m : float
        Of the air. [1/m]
    """

    horizon_cdpm2: FloatArray
    zenith_cdpm2: FloatArray
    air_cdpm2: FloatArray
    sky_lux: FloatArray
    sun_lux: FloatArray
    to_sun: FloatArray
    haze_height_m: float
    extinction_per_m: float

    def luminance(self, up: FloatRays) -> FloatRays:
        """Luminance of the sky as it is seen through the air.

        Parameters
        ----------
        up : (n,) float32
            Sine of the elevation.

        Returns
        -------
        luminance_cdpm2 : (n, 3) float32
            Linear red, green, blue. [cd/m^2]
        """
        sine = np.maximum(up, np.float32(1e-4))
        share = (sine ** np.float32(_EXPONENT))[:, None]
        horizon, air = self.horizon_cdpm2.astype(np.float32), self.air_cdpm2.astype(np.float32)
        bright = horizon + share * (self.zenith_cdpm2 - self.horizon_cdpm2).astype(np.float32)
        left = np.exp(np.float32(-self.extinction_per_m * self.haze_height_m) / sine)[:, None]
        seen: FloatRays = air + left * (bright - air)
        return seen

    def fade(self, luminance: FloatRays, distance_m: FloatRays) -> None:
        """What the air leaves of luminances (n, 3) after a way (n,), in place.

        References
        ----------
        .. [1] H. Koschmieder, "Theorie der horizontalen Sichtweite", 1924.
        """
        air = self.air_cdpm2.astype(np.float32)
        luminance -= air
        luminance *= np.exp(np.float32(-self.extinction_per_m) * distance_m)[:, None]
        luminance += air


def build_sky(weather: Weather) -> Sky:
    """The sky of a weather.

    Parameters
    ----------
    weather : Weather
        Sun, sky, air.

    Returns
    -------
    sky : Sky
        Scaled so that level ground gets ``weather.sky_lux``.
    """
    table = take(load_lamp_table(), "sky", "lamps.toml")
    if weather.sun_lux > 0.0:
        zenith, horizon, kind = (
            _colour(table, "clear_zenith"),
            _colour(table, "clear_horizon"),
            "clear",
        )
        horizon = horizon * take_number(table, "clear_horizon_to_zenith", _WHERE)
    elif weather.has_lamps:
        zenith, horizon, kind = (
            _colour(table, "night_zenith"),
            _colour(table, "night_horizon"),
            "clear",
        )
        horizon = horizon * take_number(table, "clear_horizon_to_zenith", _WHERE)
    else:
        zenith, kind = _colour(table, "overcast"), "overcast"
        horizon = zenith * take_number(table, "overcast_horizon_to_zenith", _WHERE)
    if weather.visibility_m < _FOG_VISIBILITY_M:
        kind = "fog"
    # Of horizon + (zenith - horizon) sin^n: the integral of its cosine over the half sphere.
    level = 2.0 * np.pi * (horizon / 2.0 + (zenith - horizon) / (2.0 + _EXPONENT))
    scale = weather.sky_lux / float(LUMINANCE @ level)
    elevation, yaw = np.radians([weather.sun_elevation_deg, weather.sun_yaw_deg])
    return Sky(
        horizon_cdpm2=scale * horizon,
        zenith_cdpm2=scale * zenith,
        air_cdpm2=scale * horizon,  # the sky at the horizon is nothing but air
        sky_lux=scale * level,
        sun_lux=weather.sun_lux * _colour(table, "sun"),
        to_sun=np.array(
            [
                np.cos(elevation) * np.cos(yaw),
                np.cos(elevation) * np.sin(yaw),
                np.sin(elevation),
            ]
        ),
        haze_height_m=take_number(
            take(table, "haze_height_m", _WHERE), kind, f"{_WHERE}.haze_height_m"
        ),
        extinction_per_m=weather.extinction_per_m,
    )


def _colour(table: Mapping[str, object], key: str) -> FloatArray:
    """A colour whose luminance is 1."""
    colour = float_array(take(table, key, _WHERE), (3,), f"{_WHERE}.{key}")
    unit: FloatArray = colour / (LUMINANCE @ colour)
    return unit
