"""Weathers: what they do to sight, and what is told of wrong ones."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with

from geometry.weather import (
    CONTRAST_AT_VISIBILITY,
    Weather,
    load_weathers,
    pick_weather,
)

CLEAR = Weather(
    name="clear",
    visibility_m=20_000.0,
    rain_rate_mmph=0.0,
    sun_elevation_deg=40.0,
    sun_yaw_deg=0.0,
    sun_lux=80_000.0,
    sky_lux=15_000.0,
    has_lamps=False,
    contrast=1.0,
    wetness=0.0,
)
visibilities_m = st.floats(5.0, 100_000.0)
distances_m = st.floats(0.0, 1000.0)


def _db_per_km(extinction_per_m):
    """10 lg of the light that is left after 1 km, as radio engineers count."""
    return -10.0 * math.log10(math.exp(-1000.0 * extinction_per_m))


# The named ones


def test_the_weathers_are_those_of_the_study_and_fog():
    weathers = load_weathers()
    assert list(weathers) == ["day", "night", "rain", "fog"]
    assert all(name == weather.name for name, weather in weathers.items())
    assert pick_weather("fog", "here") is weathers["fog"]
    with refused_with("--weather: got 'snow'; expected one of day, fog, night, rain"):
        pick_weather("snow", "--weather")


def test_weathers_are_what_they_are_called():
    day, night, rain, fog = load_weathers().values()
    assert day.contrast == 1.0
    assert day.wetness == 0.0
    assert not day.has_lamps
    assert [w.name for w in (day, night, rain, fog) if w.rain_rate_mmph > 0.0] == [
        "rain"
    ]
    # WMO-No. 8: fog is a visibility of less than 1 km.
    assert [w.name for w in (day, night, rain, fog) if w.visibility_m < 1000.0] == [
        "fog"
    ]
    # CarlaNCAP, text: by day; at night with street lamps and headlights on.
    assert night.has_lamps
    assert night.sun_elevation_deg < 0.0
    assert night.sun_lux == 0.0
    assert night.sky_lux < 1.0 < rain.sky_lux

    contrast = {
        w.name: w.contrast * w.transmission(60.0) for w in (day, night, rain, fog)
    }
    assert contrast["day"] > contrast["rain"] > contrast["night"] > contrast["fog"]


# Visible light


@given(visibilities_m)
def test_at_the_visibility_5_percent_of_the_contrast_is_left(visibility_m):
    """WMO-No. 8, chapter 9."""
    weather = replace(CLEAR, visibility_m=visibility_m)
    assert CONTRAST_AT_VISIBILITY == 0.05
    assert float(weather.transmission(visibility_m)) == pytest.approx(0.05, rel=1e-9)
    assert weather.extinction_per_m == pytest.approx(2.9957 / visibility_m, rel=1e-4)


@given(visibilities_m, st.floats(0.0, 100.0), distances_m, distances_m)
def test_two_ways_through_the_air_take_what_each_of_them_takes(
    visibility_m, rain, a_m, b_m
):
    weather = replace(CLEAR, visibility_m=visibility_m, rain_rate_mmph=rain)
    first, second, both = weather.transmission([a_m, b_m, a_m + b_m])

    assert both == pytest.approx(first * second, rel=1e-9, abs=1e-300)
    assert float(weather.transmission(0.0)) == 1.0
    assert 0.0 <= both <= min(first, second) <= 1.0


@pytest.mark.parametrize(
    ("rate_mmph", "db_per_km"),
    [
        (0.0, 0.0),
        (1.0, 1.076),
        (10.0, 5.0329),
        (100.0, 23.541),
    ],
)
def test_rain_takes_what_itu_r_p_1814_says(rate_mmph, db_per_km):
    """1.076 R^0.67 dB/km, whatever the wavelength; on top of what haze takes."""
    wet = replace(CLEAR, rain_rate_mmph=rate_mmph)
    taken = wet.extinction_per_m - CLEAR.extinction_per_m

    assert _db_per_km(taken) == pytest.approx(db_per_km, rel=1e-4, abs=1e-12)
    for wavelength_nm in (550.0, 905.0, 1550.0):
        by_laser = wet.lidar_extinction_per_m(
            wavelength_nm
        ) - CLEAR.lidar_extinction_per_m(wavelength_nm)
        assert by_laser == pytest.approx(taken, rel=1e-9, abs=1e-15)


# Lasers


def _exponent(visibility_m, wavelength_nm=905.0):
    """From what is taken back to Kim's exponent: 3.91 or 3.00 / V (lambda / 550
    nm)^-q.
    """
    weather = replace(CLEAR, visibility_m=visibility_m)
    ratio = weather.lidar_extinction_per_m(wavelength_nm) / weather.extinction_per_m
    return -math.log(ratio) / math.log(wavelength_nm / 550.0)


@pytest.mark.parametrize(
    ("visibility_m", "exponent"),
    [
        (50_001.0, 1.6),
        (50_000.0, 1.3),
        (6001.0, 1.3),
        (6000.0, 1.3),  # 0.16 * 6 + 0.34
        (2000.0, 0.66),
        (1001.0, 0.50016),
        (1000.0, 0.5),
        (700.0, 0.2),
        (500.0, 0.0),
        (499.0, 0.0),
        (50.0, 0.0),
    ],
)
@pytest.mark.parametrize("wavelength_nm", [905.0, 1550.0])
def test_haze_takes_less_of_long_waves_by_kims_exponent(
    visibility_m, exponent, wavelength_nm
):
    assert _exponent(visibility_m, wavelength_nm) == pytest.approx(exponent, abs=1e-9)


@given(visibilities_m, st.floats(0.0, 100.0))
def test_visible_light_is_the_reference_of_lasers(visibility_m, rate_mmph):
    weather = replace(CLEAR, visibility_m=visibility_m, rain_rate_mmph=rate_mmph)
    assert weather.lidar_extinction_per_m(550.0) == pytest.approx(
        weather.extinction_per_m
    )
    assert weather.lidar_extinction_per_m(905.0) <= weather.extinction_per_m * (
        1.0 + 1e-12
    )


def test_fog_takes_the_same_of_a_laser_and_of_light():
    fog = load_weathers()["fog"]
    assert fog.lidar_extinction_per_m(905.0) == pytest.approx(fog.extinction_per_m)


# What is wrong


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"visibility_m": 0.0}, "visibility_m: got 0.0; expected metres, > 0"),
        ({"visibility_m": math.nan}, "visibility_m: got nan; expected metres, > 0"),
        (
            {"rain_rate_mmph": -1.0},
            "rain_rate_mmph: got -1.0; expected mm/h, at least 0",
        ),
        (
            {"sun_elevation_deg": 91.0},
            "sun_elevation_deg: got 91.0; expected -90 .. 90 degrees",
        ),
        ({"sun_lux": -1.0}, "sun_lux: got -1.0; expected lux, at least 0"),
        ({"sky_lux": math.nan}, "sky_lux: got nan; expected lux, at least 0"),
        ({"has_lamps": 1.0}, "has_lamps: got 1.0; expected true or false"),
        ({"contrast": 0.0}, "contrast: got 0.0; expected 0 < contrast <= 1"),
        ({"contrast": 1.1}, "contrast: got 1.1; expected 0 < contrast <= 1"),
        ({"wetness": -0.1}, "wetness: got -0.1; expected 0 .. 1"),
    ],
)
def test_a_weather_says_what_is_wrong(change, message):
    with refused_with(f"weather clear.{message}"):
        replace(CLEAR, **change)
