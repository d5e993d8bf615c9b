"""Many sampled worlds in a few numbers: mean with its confidence, and how bad the worst are."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t as student_t

from geometry.arrays import FloatArray, float_array
from geometry.errors import InputError, Unquoted

CONFIDENCE = 0.95
_NO_SPREAD = 1.0e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanEstimate:
    """What is known of a mean from samples.

    Attributes
    ----------
    mean : float
        Of the samples.
    standard_error : float
        Of the mean: standard deviation / sqrt(n); NaN for a single sample.
    low, high : float
        Confidence interval of the true mean.
    method : str
        How the interval was found, in words.
    """

    mean: float
    standard_error: float
    low: float
    high: float
    method: str


def estimate_mean(
    values: ArrayLike, *, confidence: float = CONFIDENCE, bounds: tuple[float, float] = (0.0, 1.0)
) -> MeanEstimate:
    """Mean of independent samples, and between which limits the true mean lies.

    Parameters
    ----------
    values : (n,) float
        Samples of something that lies within `bounds`, at least one.
    confidence : float
        Probability that the interval holds the true mean, 0 .. 1.
    bounds : tuple of float
        Smallest and largest value possible.

    Returns
    -------
    estimate : MeanEstimate
        By Student's t, cut off at the bounds. Where all samples are equal, or there is but one,
        they show no spread to go by: then at most a share q of all worlds differs, since n draws
        in a row would show none of a larger share with a probability below
        (1 - q)^n = 1 - confidence, and these may be as bad or as good as can be.

    Raises
    ------
    InputError
        There is no sample, or one lies outside the bounds.

    References
    ----------
    .. [1] W. S. Gosset ("Student"), "The probable error of a mean", Biometrika 6 (1908).
    .. [2] J. A. Hanley, A. Lippman-Hand, "If nothing goes wrong, is everything all right?", JAMA
       249 (1983): none in n, hence with 95 % confidence at most about 3 / n.

    Examples
    --------
    >>> estimate = estimate_mean([1.0] * 59)
    >>> round(estimate.low, 3), estimate.high
    (0.95, 1.0)
    """
    samples = float_array(values, (-1,), "samples")
    if not 0.0 < confidence < 1.0:
        raise InputError("confidence", confidence, "more than 0, less than 1")
    lowest, highest = bounds
    if len(samples) == 0:
        raise InputError("samples", Unquoted("none"), "at least one")
    if samples.min() < lowest - _NO_SPREAD or samples.max() > highest + _NO_SPREAD:
        raise InputError("samples", samples.tolist(), f"{lowest:g} .. {highest:g}")
    n = len(samples)
    mean = min(max(math.fsum(samples) / n, lowest), highest)
    error = float(samples.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    if np.ptp(samples) <= _NO_SPREAD:
        share = 1.0 - (1.0 - confidence) ** (1.0 / n)
        low, high = mean + share * (lowest - mean), mean + share * (highest - mean)
        method = f"{100.0 * confidence:g} % interval: no spread in {n} samples, rule of three"
    else:
        reach = float(student_t.ppf(0.5 + 0.5 * confidence, n - 1)) * error
        low, high = max(lowest, mean - reach), min(highest, mean + reach)
        method = f"{100.0 * confidence:g} % interval: Student's t, {n} samples"
    return MeanEstimate(mean=mean, standard_error=error, low=low, high=high, method=method)


def cvar(apr_by_sample: ArrayLike, tail: float) -> float:
    """Conditional value at risk: the mean over the worst share of equally likely worlds.

    Parameters
    ----------
    apr_by_sample : (n_samples,) float
        Accident prevention ratio in each world, at least one.
    tail : float
        The worst share that counts, 0 .. 1: 1 is the expectation; up to 1 / n_samples, 0 among
        them, it is the worst world alone. Where the share ends within a world, that one counts in
        part.

    Returns
    -------
    cvar : float
        max over t of t - mean(max(0, t - apr)) / tail.

    Raises
    ------
    InputError
        There is no sample, or the tail is no share.

    References
    ----------
    .. [1] R. T. Rockafellar, S. Uryasev, "Optimization of conditional value-at-risk", Journal of
       Risk 2 (2000).

    Examples
    --------
    >>> cvar([0.5, 1.0, 0.9, 0.7], 0.5)
    0.6
    """
    samples: FloatArray = np.sort(float_array(apr_by_sample, (-1,), "samples"))
    if len(samples) == 0:
        raise InputError("samples", Unquoted("none"), "at least one")
    is_number = isinstance(tail, int | float) and not isinstance(tail, bool)
    if not (is_number and 0.0 <= tail <= 1.0):
        raise InputError("--tail", tail, "a share of the samples, 0 to 1")
    n_counted = max(1.0, tail * len(samples))
    counts = np.clip(n_counted - np.arange(len(samples)), 0.0, 1.0)
    return math.fsum(counts * samples) / n_counted
