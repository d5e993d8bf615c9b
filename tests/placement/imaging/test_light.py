"""Light of sun, sky and lamps on surfaces, against photometry by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from placed_bodies import ahead_of

from geometry.actors import pick_actor
from geometry.poses import Pose
from geometry.raycast import build_caster
from geometry.weather import load_weathers
from placement.imaging.light import (
    LUMINANCE,
    StreetLamp,
    build_headlights,
    build_sky,
    illuminance,
)
from placement.imaging.materials import Hits

NOTHING = build_caster(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
HERE = np.zeros(3, dtype=np.float32)


def _hits(points, normals):
    """Points on surfaces with normals."""
    points = np.array(points, dtype=np.float32)
    thing = np.zeros(len(points), dtype=np.int32)
    pixel_m = np.ones(len(points), dtype=np.float32)
    return Hits(
        points_m=points,
        normals=np.array(normals, dtype=np.float32),
        thing=thing,
        pixel_m=pixel_m,
    )


def _lux(hits, weather, *, lamps=(), caster=NOTHING, **options):
    """Illuminance at points. [lx]"""
    light = illuminance(
        hits,
        caster=caster,
        origin_m=HERE,
        sky=build_sky(weather),
        lamps=lamps,
        **options,
    )
    return light @ LUMINANCE


def _lamp(**changes):
    """A lamp 8 m high."""
    fields = {
        "position_m": np.array([0.0, 0.0, 8.0]),
        "colour": np.ones(3),
        "reach_m": 100.0,
        "radius_m": 0.2,
        "flux_lm": 9000.0,
        "inner_deg": 60.0,
        "outer_deg": 80.0,
        "spill": 0.0,
    }
    return StreetLamp(**(fields | changes))


def _sunny(elevation_deg, yaw_deg):
    """80,000 lx from the sun, and none from the sky."""
    return replace(
        load_weathers()["day"],
        sun_lux=80000.0,
        sky_lux=0.0,
        sun_elevation_deg=elevation_deg,
        sun_yaw_deg=yaw_deg,
    )


DARK = replace(load_weathers()["day"], sun_lux=0.0, sky_lux=0.0)
UP = [0.0, 0.0, 1.0]
SQUARE = [[0, 1, 2], [0, 2, 3]]
"""Triangles of four corners in turn."""


@given(elevation_deg=st.floats(1.0, 89.0), yaw_deg=st.floats(-180.0, 180.0))
def test_a_wall_that_faces_the_sun_gets_its_light_by_the_cosine(elevation_deg, yaw_deg):
    elevation = np.radians(elevation_deg)
    towards = np.append(ahead_of(yaw_deg), 0.0)
    normals = [
        towards,
        UP,
        -towards,
    ]

    hits = _hits(np.zeros((3, 3)), normals)
    weather = _sunny(elevation_deg, yaw_deg)
    lux = _lux(hits, weather)
    towards_sun = [np.cos(elevation), np.sin(elevation), 0.0]
    expected = 80000.0 * np.array(towards_sun)

    assert lux == pytest.approx(expected, rel=1e-4, abs=0.1)


@pytest.mark.parametrize("name", sorted(load_weathers()))
def test_level_ground_gets_the_skys_light_and_what_faces_down_what_the_ground_sends(
    name,
):
    weather = replace(load_weathers()[name], sun_lux=0.0)
    normals = [
        UP,
        [1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
    ]

    hits = _hits(np.zeros((3, 3)), normals)
    lux = _lux(hits, weather, ground_albedo=0.2)
    share = np.array([1.0, 0.6, 0.2])
    expected = weather.sky_lux * share

    assert lux == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("name", sorted(load_weathers()))
def test_the_skys_luminance_adds_up_to_its_illuminance(name):
    weather = replace(load_weathers()[name], visibility_m=1.0e12, rain_rate_mmph=0.0)
    edges = np.linspace(0.0, 1.0, 20_001)
    sums = edges[1:] + edges[:-1]
    sine = 0.5 * sums

    heights = sine.astype(np.float32)
    colour = build_sky(weather).luminance(heights)
    luminance = colour @ LUMINANCE
    total = (luminance * sine).sum()
    step = edges[1] - edges[0]
    lux = 2.0 * np.pi * total * step

    assert lux == pytest.approx(weather.sky_lux, rel=1e-3)


@pytest.mark.parametrize("name", ["day", "rain", "fog"])
def test_at_the_visibility_five_per_cent_of_contrast_are_left(name):
    weather = replace(load_weathers()[name], rain_rate_mmph=0.0)
    sky = build_sky(weather)
    black = np.zeros((1, 3), np.float32)
    white = np.full((1, 3), 1000.0, np.float32)
    way = np.array([weather.visibility_m], dtype=np.float32)
    for luminance in (black, white):
        sky.fade(luminance, way)

    expected = 0.95 * sky.air_cdpm2[None]

    assert white - black == pytest.approx(0.05 * 1000.0, rel=1e-3)
    assert black == pytest.approx(expected, rel=1e-3)


def test_a_wall_throws_a_shadow_as_long_as_the_sun_is_low():
    corners = [
        [0, -9, 0],
        [0, 9, 0],
        [0, 9, 2],
        [0, -9, 2],
    ]
    wall = build_caster(corners, SQUARE)
    points = [
        [1.9, 0, 0],
        [2.1, 0, 0],
        [-1, 0, 0],
    ]

    hits = _hits(points, [UP] * 3)
    weather = _sunny(45.0, 180.0)
    lux = _lux(hits, weather, caster=wall)
    lit = 80000.0 * np.sqrt(0.5)

    assert lux == pytest.approx([0.0, lit, lit], rel=1e-4)


@given(aside_m=st.floats(0.0, 12.0))
def test_a_lamps_light_falls_with_the_square_and_the_cosine(aside_m):
    lamp = _lamp()
    hits = _hits([[aside_m, 0.0, 0.0]], [UP])

    lux = _lux(hits, DARK, lamps=[lamp])
    # Within the cone: I cos^3 / h^2.
    distance_m = np.hypot(8.0, aside_m)
    cosine = 8.0 / distance_m
    expected = lamp.peak_cd * cosine**3 / 8.0**2

    assert lux == pytest.approx([expected], rel=1e-3)


def test_what_stands_before_a_lamp_takes_its_light():
    corners = [
        [-1, -1, 4],
        [1, -1, 4],
        [1, 1, 4],
        [-1, 1, 4],
    ]
    plate = build_caster(corners, SQUARE)

    hits = _hits([[1.9, 0, 0], [2.1, 0, 0]], [UP] * 2)

    free = _lux(hits, DARK, lamps=[_lamp()])
    behind = _lux(hits, DARK, lamps=[_lamp()], caster=plate)

    assert behind == pytest.approx([0.0, free[1]])


@pytest.mark.parametrize("spill", [0.0, 0.1])
def test_a_street_lamp_sends_out_its_flux(spill):
    cosine = np.linspace(-1.0, 1.0, 40_001)
    sums = cosine[1:] + cosine[:-1]
    middle = 0.5 * sums
    sine = np.sqrt(1.0 - middle**2)
    across = np.zeros_like(middle)
    down = np.stack([sine, across, -middle])

    lamp = _lamp(spill=spill)
    downwards = down.astype(np.float32)
    intensity = lamp.intensity_cd(downwards)
    total = intensity.sum()
    step = cosine[1] - cosine[0]
    flux = 2.0 * np.pi * total * step

    assert flux == pytest.approx(9000.0, rel=1e-3)


@pytest.mark.parametrize("keeps_left", [False, True])
def test_a_low_beam_keeps_to_the_regulations_limits(keeps_left):
    pose = Pose(position_m=[0.0, 0.0, 0.0], yaw_deg=0.0)
    vut = pick_actor("vut", "vut")
    lamp, _ = build_headlights(vut, pose, keeps_left=keeps_left)

    def candela(to_kerb_deg, up_deg):
        left_deg = -to_kerb_deg
        if keeps_left:
            left_deg = to_kerb_deg

        up = np.radians(up_deg)
        level = np.cos(up)
        rise = np.sin(up)
        way = np.append(level * ahead_of(left_deg), rise)
        ways = way.astype(np.float32)[:, None]
        candela_found = lamp.intensity_cd(ways)
        return float(candela_found[0])

    assert candela(-3.43, 0.57) <= 350.0  # B50L: oncoming drivers
    assert candela(1.15, -0.57) >= 10_100.0  # 75R
    assert candela(180.0, 0.0) == 0.0
