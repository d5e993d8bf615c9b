"""Means, intervals and tails of APRs over worlds."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from refusals import refused_with

from geometry.errors import InputError
from placement.sampling.out_of_sample import cvar, estimate_mean, resampled_cvar

shares = st.lists(st.floats(0.0, 1.0, allow_subnormal=False), min_size=1, max_size=12)


@given(shares, st.integers(1, 40), st.integers(1, 40))
def test_cvar_is_the_mean_of_the_worst_of_many_equal_parts(samples, a, b):
    """Every sample cut into equal parts, so that the tail is a whole number of them."""
    count, of = sorted((a, b))
    # Of one sample, n_samples * of parts; the tail is count / of.
    n_parts = len(samples) * of
    tail_parts = count * len(samples) * len(samples)
    repeated = np.repeat(samples, n_parts)
    parts = np.sort(repeated)
    n_worst = max(tail_parts, n_parts)
    worst = parts[:n_worst]
    expected = worst.mean()
    found = cvar(samples, count / of)

    assert found == pytest.approx(expected, abs=1e-9)


@given(shares, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_cvar_grows_with_the_tail_from_the_worst_to_the_mean(samples, a, b):
    small, large = sorted((a, b))
    expected = np.mean(samples)
    of_small = cvar(samples, small)
    of_large = cvar(samples, large)
    whole = cvar(samples, 1.0)

    assert of_small <= of_large + 1e-12
    assert cvar(samples, 0.0) == min(samples)
    assert whole == pytest.approx(expected)


def test_nothing_has_no_mean():
    with refused_with("samples: got none; expected at least one"):
        estimate_mean([])


# Mean and interval


def test_the_interval_is_students():
    """By hand: mean 0.5, deviation 0.1, t(3 degrees of freedom, 97.5 %) = 3.182446."""
    estimate = estimate_mean(
        [0.4, 0.6, 0.5 - 0.05 * math.sqrt(2.0), 0.5 + 0.05 * math.sqrt(2.0)]
    )

    assert estimate.mean == pytest.approx(0.5)
    assert estimate.standard_error == pytest.approx(0.1 / 2.0)
    assert estimate.low == pytest.approx(0.5 - 3.182446 * 0.05, abs=1e-6)
    assert estimate.high == pytest.approx(0.5 + 3.182446 * 0.05, abs=1e-6)
    assert estimate.method == "95 % interval: Student's t, 4 samples"


def test_without_spread_a_few_worlds_may_still_differ():
    """None of 30 differs: so says chance in 1 of 20 cases if 9.5 % of all worlds do."""
    estimate = estimate_mean([1.0] * 30)

    assert estimate.mean == 1.0
    assert estimate.standard_error == 0.0
    assert estimate.high == 1.0
    assert estimate.low**30 == pytest.approx(0.05)
    assert estimate.method == "95 % interval: no spread in 30 samples, rule of three"

    (half,) = [estimate_mean([0.5] * 30)]

    assert half.low == pytest.approx(0.5 * estimate.low)
    assert half.high == pytest.approx(1.0 - 0.5 * estimate.low)

    one = estimate_mean([0.5])

    assert math.isnan(one.standard_error)
    assert one.low == pytest.approx(0.025)
    assert one.high == pytest.approx(0.975)


def test_the_interval_holds_the_mean_where_most_samples_are_equal():
    """One world in fifty is bad: two thirds of all draws of 20 show none of them."""
    rng = default_rng(7)

    estimates = [
        estimate_mean(1.0 - 0.8 * (rng.random(20) < 0.02)) for _ in range(1500)
    ]
    truth = 1.0 - 0.8 * 0.02
    is_within = [e.low <= truth <= e.high for e in estimates]
    coverage = np.mean(is_within)

    assert coverage >= 0.95

    by_t_alone = [e.low <= truth <= e.high for e in estimates if "Student" in e.method]

    # Without the rule of three most would miss.
    assert 0.2 < len(by_t_alone) / 1500 < 0.5


@given(st.lists(st.floats(0.0, 1.0, allow_subnormal=False), min_size=2, max_size=30))
def test_the_interval_is_around_the_mean_and_within_bounds(samples):
    estimate = estimate_mean(samples)
    assert 0.0 <= estimate.low <= estimate.mean <= estimate.high <= 1.0


@pytest.mark.parametrize("bad", [[1.2], [-0.1, 0.5], [math.nan]])
def test_what_is_no_ratio_has_no_interval(bad):
    with pytest.raises(InputError):
        estimate_mean(bad)


def test_the_error_of_a_tail_is_that_of_fresh_worlds():
    rng = default_rng(3)
    samples = rng.beta(20.0, 2.0, size=(2, 80))

    resampled = resampled_cvar(samples, 0.25)

    assert resampled.shape == (2, 1000)

    fresh = [cvar(rng.beta(20.0, 2.0, size=80), 0.25) for _ in range(2000)]
    resampled_error = resampled[0].std()
    spread = np.std(fresh)

    assert resampled_error == pytest.approx(spread, rel=0.35)

    # Both layouts have the same worlds: one that is always better is so in every draw.
    shifted = [samples[0] + 0.0, samples[0] - 0.01]
    better = resampled_cvar(shifted, 0.25)

    expected = np.full(1000, 0.01)
    difference = better[0] - better[1]

    assert difference == pytest.approx(expected)
