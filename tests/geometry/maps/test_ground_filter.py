"""The ground below what a point cloud or a raster shows of surfaces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.errors import InputError
from geometry.maps.point_clouds import LowestPoints, fill_gaps, filter_ground


@given(
    st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=1, max_size=60),
    st.integers(0, 60),
)
def test_lowest_points_are_those_of_a_loop_however_they_come(points, cut):
    array = np.array(points)
    lowest = LowestPoints()
    lowest.add(array[:cut])
    lowest.add(array[cut:])
    low, heights = lowest.grid("f")

    truth = {}
    for x, y, z in points:
        cell = (np.floor(x), np.floor(y))
        truth[cell] = min(z, truth.get(cell, np.inf))

    found = {}
    for index in np.argwhere(~np.isnan(heights)):
        cell = index + low
        found[tuple(cell)] = heights[tuple(index)]

    assert found == truth


def test_gaps_take_the_nearest_height():
    heights = np.array([[1.0, np.nan, np.nan, np.nan, 9.0]])
    assert fill_gaps(heights)[0, [0, 1, 3, 4]].tolist() == [1.0, 1.0, 9.0, 9.0]


@given(
    rise=st.floats(-1.0, 1.0),
    size=st.integers(12, 60),
    height=st.floats(3.5, 40.0),
    noise=st.floats(0.0, 0.1),
)
def test_houses_are_taken_off_sloping_ground(rise, size, height, noise):
    slope = rise / size  # no house that the ground behind it overtops
    x = np.arange(150.0)[:, None] + np.zeros((1, 120))
    ground = slope * x
    bumps = noise * np.random.default_rng(0).uniform(-1, 1, ground.shape)
    house = np.zeros(ground.shape, dtype=bool)
    house[40 : 40 + size, 30 : 30 + size] = True
    found = filter_ground(ground + bumps + height * house)
    off_m = np.abs(found - ground)

    assert off_m[~house].max() < 0.5
    # Under the house the nearest ground is half a house away.
    assert off_m[house].max() < 0.5 + abs(slope) * (0.5 * size + 2)


def test_single_points_below_the_ground_are_not_ground():
    surface = np.zeros((40, 40))
    surface[20, 20] = -15.0
    assert (filter_ground(surface) == 0.0).all()


def test_points_from_all_over_the_country_are_refused():
    lowest = LowestPoints()
    lowest.add(np.array([[0.0, 0.0, 0.0], [90_000.0, 90_000.0, 0.0]]))
    with pytest.raises(InputError, match=r"90\.0 km"):
        lowest.grid("f")
