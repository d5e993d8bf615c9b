"""LiDARs: their beams, what comes back of them, and what detection asks for."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from refusals import refused_with
from scipy.integrate import quad
from strategies import numbers

from geometry import lidar as lidar_module
from geometry.lidar import (
    beam_directions,
    beams_per_steradian,
    load_lidar_detection,
    load_lidars,
    noisy_ranges,
    return_probability,
)

STUDY = load_lidars()["carla-ncap-lidar"]
RING = load_lidars()["ouster-os1-128"]
SQUARE_CLEAR = {"reflectivity": 0.1, "incidence_cos": 1.0, "extinction_per_m": 0.0}


@st.composite
def lidars(draw):
    """LiDARs of any field of view and few beams."""
    n_lines = draw(st.integers(1, 30))
    return replace(
        STUDY,
        horizontal_fov_deg=draw(numbers(1.0, 360.0) | st.just(360.0)),
        vertical_fov_deg=draw(numbers(1.0, 179.0)),
        n_lines=n_lines,
        points_per_second=10.0 * draw(st.integers(n_lines, 30 * n_lines)),
    )


def angles_deg(directions):
    """Azimuths and elevations of directions (..., 3)."""
    x, y, z = np.moveaxis(directions, -1, 0)
    azimuth = np.degrees(np.arctan2(y, x))
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    return azimuth, elevation


def probability_at(distance_m, lidar=STUDY, **changes):
    """Probability of a return from a black wall in clear air."""
    return return_probability(lidar, distance_m, **(SQUARE_CLEAR | changes))


def test_the_studys_lidar_is_that_of_its_table_of_sensors():
    # CarlaNCAP study, table of sensors.
    assert STUDY.horizontal_fov_deg == 72.0
    assert STUDY.vertical_fov_deg == 30.0
    assert STUDY.n_lines == 52
    assert STUDY.frame_rate_hz == 10.0
    assert STUDY.range_m == 250.0
    assert STUDY.points_per_second == 90_000.0
    assert STUDY.n_columns == 173  # 9000 points per frame on 52 lines, rounded down


def test_the_ring_is_that_of_its_data_sheet():
    # Ouster, OS1, first edition; 1024 of its columns.
    assert RING.horizontal_fov_deg == 360.0
    assert RING.vertical_fov_deg == 45.0
    assert RING.n_lines == 128
    assert RING.n_columns == 1024
    assert RING.frame_rate_hz == 10.0
    assert RING.reference_range_m == 40.0
    assert RING.reference_reflectivity == 0.1

    # Its two ranges agree with the LiDAR equation: 120 m on 80 %.
    bright = probability_at(120.0, RING, reflectivity=0.8)
    assert bright == pytest.approx(0.76, abs=0.01)


@given(lidars())
def test_no_more_beams_than_points_and_less_than_a_column_is_left_over(lidar):
    n_points = lidar.points_per_second / lidar.frame_rate_hz
    n_beams = lidar.n_lines * lidar.n_columns
    assert n_beams <= n_points + 1e-6 < n_beams + lidar.n_lines + 1e-3


@given(lidars())
def test_beams_are_unit_vectors_in_the_middle_of_equal_cells(lidar):
    directions = beam_directions(lidar)
    assert directions.shape == (lidar.n_lines, lidar.n_columns, 3)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(1.0, abs=1e-12)

    azimuth, elevation = angles_deg(directions)
    for angles, fov_deg, count in (
        (azimuth, lidar.horizontal_fov_deg, lidar.n_columns),
        (elevation.T, lidar.vertical_fov_deg, lidar.n_lines),
    ):
        step = fov_deg / count
        expected = -0.5 * fov_deg + step * (np.arange(count) + 0.5)
        assert_allclose(angles, np.broadcast_to(expected, angles.shape), atol=1e-9)


def test_beams_go_from_the_lowest_line_up_and_from_right_to_left():
    x, y, z = np.moveaxis(beam_directions(STUDY), -1, 0)
    assert y[0, 0] < 0.0 < y[0, -1]
    assert z[0, 0] < 0.0 < z[-1, 0]
    assert (x > 0.0).all()


@given(lidars())
def test_the_diagonal_cone_touches_the_field_of_view_and_holds_every_beam(lidar):
    """It touches where x is least on the border: at a corner, or behind at the ends of
    a line.
    """
    half_width = math.radians(0.5 * lidar.horizontal_fov_deg)
    half_height = math.radians(0.5 * lidar.vertical_fov_deg)
    elevations = np.linspace(-half_height, half_height, 201)
    limit = math.cos(math.radians(0.5 * lidar.diagonal_fov_deg))
    on_border = np.cos(elevations) * math.cos(half_width)

    assert limit == pytest.approx(on_border.min(), abs=1e-9)
    assert (beam_directions(lidar)[..., 0] >= limit - 1e-9).all()


def test_all_is_inside_the_cone_of_a_lidar_that_scans_all_round():
    assert RING.scans_all_round
    assert RING.diagonal_fov_deg == 360.0
    assert not replace(RING, horizontal_fov_deg=359.9).scans_all_round
    assert replace(RING, horizontal_fov_deg=200.0).diagonal_fov_deg == 200.0


@given(lidars(), st.integers(-40, 40))
def test_a_ring_turned_by_whole_columns_has_the_same_beams(lidar, n_columns):
    """Evenly all round, and none twice at the seam."""
    ring = replace(lidar, horizontal_fov_deg=360.0)
    beams = beam_directions(ring)
    turn = 2.0 * math.pi * n_columns / ring.n_columns
    cosine = math.cos(turn)
    sine = math.sin(turn)
    rotation = [
        [cosine, sine, 0.0],
        [-sine, cosine, 0.0],
        [0.0, 0.0, 1.0],
    ]
    turned = beams @ np.array(rotation)

    assert_allclose(turned, np.roll(beams, -n_columns, axis=1), atol=1e-12)

    (azimuth,), _ = angles_deg(beams[:1])
    azimuth = np.sort(azimuth)
    steps = np.diff(np.append(azimuth, azimuth[0] + 360.0))

    assert_allclose(steps, 360.0 / ring.n_columns, atol=1e-9)


@given(lidars())
def test_the_density_of_beams_sums_up_to_their_number(lidar):
    half_width = math.radians(0.5 * lidar.horizontal_fov_deg)
    half_height = math.radians(0.5 * lidar.vertical_fov_deg)

    def per_elevation(angle):
        density = float(beams_per_steradian(lidar, math.degrees(angle)))
        return density * math.cos(angle)

    per_azimuth, _ = quad(per_elevation, -half_height, half_height)
    n_beams = lidar.n_lines * lidar.n_columns

    assert 2.0 * half_width * per_azimuth == pytest.approx(n_beams, rel=1e-9)


def test_the_reference_target_comes_back_with_the_reference_probability():
    probability = probability_at(STUDY.reference_range_m)
    assert probability == pytest.approx(STUDY.reference_probability)
    assert STUDY.reference_probability == 0.9


@given(
    numbers(10.0, 240.0),
    numbers(0.01, 1.0),
    numbers(0.05, 1.0),
    numbers(0.0, 0.02),
    lidars(),
)
def test_the_log_odds_follow_the_lidar_equation(
    distance, reflectivity, cosine, extinction, lidar
):
    probability = return_probability(
        lidar,
        distance,
        reflectivity=reflectivity,
        incidence_cos=cosine,
        extinction_per_m=extinction,
    )
    left = math.exp(-2.0 * extinction * distance)
    signal = reflectivity * cosine / distance**2 * left
    reference = lidar.reference_reflectivity / lidar.reference_range_m**2
    odds = math.log(9.0) + math.log(signal / reference) / lidar.threshold_width
    if odds > -700.0:
        expected = 1.0 / (1.0 + math.exp(-odds))
    else:
        expected = 0.0

    assert probability == pytest.approx(expected, rel=1e-9, abs=1e-300)


def test_a_pulse_along_the_surface_or_on_black_is_lost():
    assert probability_at(10.0, incidence_cos=0.0) == 0.0
    assert probability_at(10.0, reflectivity=0.0) == 0.0


def test_noise_has_the_spread_of_the_model_and_is_seeded():
    distance = np.full((200, 200), 40.0)
    noisy = noisy_ranges(STUDY, distance, np.random.default_rng(1))

    assert noisy.shape == distance.shape

    error = noisy - distance
    assert error.mean() == pytest.approx(0.0, abs=4.0 * STUDY.range_noise_m / 200.0)
    assert error.std() == pytest.approx(STUDY.range_noise_m, rel=0.02)

    again = noisy_ranges(STUDY, distance, np.random.default_rng(1))
    assert (again == noisy).all()


def test_detection_asks_for_points_of_every_class_of_road_user():
    detection = load_lidar_detection()
    assert set(detection.min_points) == set(detection.reflectivity)

    # Blickfeld's default for clusters; MMDetection3D for pedestrians and cyclists.
    classes = ("pedestrian", "child", "cyclist", "motorcyclist", "car")
    assert detection.min_points == dict.fromkeys(classes, 10)
    assert all(0.0 < share <= 1.0 for share in detection.reflectivity.values())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"horizontal_fov_deg": 360.1},
            "horizontal_fov_deg: got 360.1; expected 0 < degrees <= 360",
        ),
        (
            {"horizontal_fov_deg": 0.0},
            "horizontal_fov_deg: got 0.0; expected 0 < degrees <= 360",
        ),
        (
            {"vertical_fov_deg": 180.0},
            "vertical_fov_deg: got 180.0; expected 0 < degrees < 180",
        ),
        (
            {"vertical_fov_deg": math.nan},
            "vertical_fov_deg: got nan; expected 0 < degrees < 180",
        ),
        ({"n_lines": 0}, "n_lines: got 0; expected a whole number of lines, > 0"),
        ({"n_lines": 2.0}, "n_lines: got 2.0; expected a whole number of lines, > 0"),
        ({"n_lines": True}, "n_lines: got True; expected a whole number of lines, > 0"),
        ({"range_m": math.inf}, "range_m: got inf; expected a positive number"),
        ({"near_m": 0.0}, "near_m: got 0.0; expected a positive number"),
        ({"near_m": 300.0}, "near_m: got 300.0; expected metres, less than range_m"),
        ({"frame_rate_hz": 0.0}, "frame_rate_hz: got 0.0; expected a positive number"),
        (
            {"frame_rate_hz": 5.0},
            (
                "frame_rate_hz: got 5.0; expected at least 10: so often all "
                "units are taken to look"
            ),
        ),
        (
            {"range_noise_m": -0.1},
            "range_noise_m: got -0.1; expected a number, at least 0",
        ),
        (
            {"price_eur": math.nan},
            "price_eur: got nan; expected euros, 0 to 1,000,000,000",
        ),
        (
            {"reference_reflectivity": 1.5},
            "reference_reflectivity: got 1.5; expected 0 < share <= 1",
        ),
        (
            {"reference_probability": 1.0},
            "reference_probability: got 1.0; expected 0 < probability < 1",
        ),
        (
            {"points_per_second": 500.0},
            (
                "points_per_second: got 500.0; expected a point per line and "
                "frame or more"
            ),
        ),
    ],
)
def test_lidar_model_says_what_is_wrong(change, message):
    with refused_with(f"cube.{message}"):
        replace(STUDY, name="cube", **change)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            {"min_points": 0, "reflectivity": 0.1},
            "min_points: got 0; expected a whole number of points, > 0",
        ),
        (
            {"min_points": 2.5, "reflectivity": 0.1},
            "min_points: got 2.5; expected a whole number of points, > 0",
        ),
        (
            {"min_points": 3, "reflectivity": 2.0},
            "reflectivity: got 2.0; expected 0 < share <= 1",
        ),
        ({"min_points": 3}, "reflectivity: got nothing; expected a value"),
    ],
)
def test_the_detection_table_says_what_is_wrong(entry, message):
    with refused_with(f"lidars.toml: detection.child.{message}"):
        lidar_module._read_detection({"child": entry})
