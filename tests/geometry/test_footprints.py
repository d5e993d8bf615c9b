"""Rectangles on the road: corners, and how far they are apart."""

import numpy as np
import pytest
from hypothesis import given
from oracles import overlap_area, polygon_area, polygon_distance, rectangle_polygon
from strategies import Rectangle, numbers, rectangles

from geometry.footprints import (
    FootprintSizes,
    footprint_corners,
    footprint_separation,
    gaps_between,
)


def corners_of(rectangle):
    """Corners of a rectangle, (4, 2)."""
    return footprint_corners(
        rectangle.centre_m,
        rectangle.yaw_deg,
        length_m=rectangle.length_m,
        width_m=rectangle.width_m,
    )


def polygon_of(rectangle):
    """The same by the oracle's arithmetic."""
    return rectangle_polygon(
        rectangle.centre_m,
        rectangle.yaw_deg,
        rectangle.length_m,
        rectangle.width_m,
    )


def separation_of(a, b):
    """Separation of two rectangles by their corners."""
    return float(footprint_separation(corners_of(a), corners_of(b)))


def gaps_of(a, b):
    """Gaps between two rectangles from their middles and headings, (4,)."""
    offset = np.subtract(b.centre_m, a.centre_m)
    sizes = FootprintSizes(
        length_a_m=a.length_m,
        width_a_m=a.width_m,
        length_b_m=b.length_m,
        width_b_m=b.width_m,
    )
    return gaps_between(
        offset,
        a.yaw_deg,
        b.yaw_deg,
        sizes=sizes,
    )


@given(rectangles())
def test_corners_go_counter_clockwise_around_the_declared_area(rectangle):
    corners = corners_of(rectangle)
    assert corners.mean(axis=0) == pytest.approx(rectangle.centre_m, abs=1e-12)

    area = polygon_area([tuple(corner) for corner in corners])
    assert area == pytest.approx(rectangle.length_m * rectangle.width_m, rel=1e-9)
    assert corners == pytest.approx(np.array(polygon_of(rectangle)), abs=1e-9)


def test_first_corner_is_front_left():
    north_deg = 90.0
    corners = footprint_corners(
        [10.0, 20.0],
        north_deg,
        length_m=4.0,
        width_m=2.0,
    )
    expected = np.array(
        [
            [9.0, 22.0],
            [9.0, 18.0],
            [11.0, 18.0],
            [11.0, 22.0],
        ]
    )

    assert corners == pytest.approx(expected, abs=1e-12)


@given(rectangles(), rectangles())
def test_separation_is_negative_exactly_where_clipping_finds_a_common_area(a, b):
    separation = separation_of(a, b)
    area = overlap_area(polygon_of(a), polygon_of(b))
    if separation < -1e-6:
        assert area > 0.0
    elif separation > 1e-6:
        assert area == 0.0


@given(rectangles(), rectangles())
def test_separation_of_rectangles_apart_is_between_the_distance_and_its_half(a, b):
    separation = separation_of(a, b)
    if separation > 1e-6:
        distance = polygon_distance(polygon_of(a), polygon_of(b))
        # One of a rectangle's two normals is within 45 degrees of any direction.
        assert distance / np.sqrt(2.0) - 1e-9 <= separation <= distance + 1e-9


@given(
    rectangles(),
    numbers(-8.0, 8.0),
    numbers(-8.0, 8.0),
    numbers(0.2, 6.0),
    numbers(0.2, 6.0),
)
def test_separation_of_parallel_rectangles_is_the_larger_gap(
    a, ahead_m, left_m, length_m, width_m
):
    yaw = np.radians(a.yaw_deg)
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    b = Rectangle(
        centre_m=tuple(np.array(a.centre_m) + rotation @ [ahead_m, left_m]),
        yaw_deg=a.yaw_deg,
        length_m=length_m,
        width_m=width_m,
    )
    expected = max(
        abs(ahead_m) - 0.5 * (a.length_m + length_m),
        abs(left_m) - 0.5 * (a.width_m + width_m),
    )

    assert separation_of(a, b) == pytest.approx(expected, abs=1e-9)


@given(rectangles(), rectangles())
def test_gaps_from_middles_and_headings_are_those_of_the_corners(a, b):
    gaps = gaps_of(a, b)
    assert gaps.max() == pytest.approx(separation_of(a, b), abs=1e-11)

    # Each is what lies between the corners along a normal.
    yaws_deg = [a.yaw_deg, a.yaw_deg + 90.0, b.yaw_deg, b.yaw_deg + 90.0]
    for gap, yaw in zip(gaps, np.radians(yaws_deg), strict=True):
        normal = np.array([np.cos(yaw), np.sin(yaw)])
        on_a = corners_of(a) @ normal
        on_b = corners_of(b) @ normal
        expected = max(on_b.min() - on_a.max(), on_a.min() - on_b.max())
        assert gap == pytest.approx(expected, abs=1e-9)


def test_separation_from_middles_and_headings_broadcasts():
    sizes = FootprintSizes(
        length_a_m=2.0,
        width_a_m=2.0,
        length_b_m=2.0,
        width_b_m=2.0,
    )
    offset = np.stack([np.arange(5.0), np.zeros(5)], axis=-1)
    gaps = gaps_between(
        offset,
        np.zeros((4, 1)),
        90.0,
        sizes=sizes,
    )

    assert gaps.shape == (4, 4, 5)

    separation = gaps.max(axis=0)
    assert separation[3] == pytest.approx([-2.0, -1.0, 0.0, 1.0, 2.0])
