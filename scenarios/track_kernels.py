"""Numba kernels of tracks: what they foresee.

A state is [east, north, east rate, north rate].
"""

import math

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel


@kernel
def mass_between(low: float, high: float, variance: float) -> float:
    """Probability that a normal number of mean 0 lies between two limits."""
    if variance < 1.0e-18:
        if low <= 0.0 <= high:
            return 1.0
        return 0.0
    scale = 1.0 / math.sqrt(2.0 * variance)
    return 0.5 * (math.erf(high * scale) - math.erf(low * scale))


@kernel
def overlap_at(
    state: FloatArray,
    cov: FloatArray,
    ahead_s: float,
    noise: float,
    car: FloatArray,
    car_variance: FloatArray,
    half_vut: FloatArray,
    half_vru: FloatArray,
) -> float:
    """Probability that footprints overlap after a time, the car at `car` (3,)."""
    cos = math.cos(car[2])
    sin = math.sin(car[2])
    added = noise * ahead_s**3 / 3.0
    # Covariance of the foreseen place: east-east, east-north, north-north.
    ee = cov[0, 0] + 2.0 * ahead_s * cov[0, 2] + ahead_s**2 * cov[2, 2] + added
    en = cov[0, 1] + ahead_s * (cov[0, 3] + cov[1, 2]) + ahead_s**2 * cov[2, 3]
    nn = cov[1, 1] + 2.0 * ahead_s * cov[1, 3] + ahead_s**2 * cov[3, 3] + added
    along_variance = cos * cos * ee + 2.0 * cos * sin * en + sin * sin * nn
    across_variance = sin * sin * ee - 2.0 * cos * sin * en + cos * cos * nn
    east = state[0] + ahead_s * state[2] - car[0]
    north = state[1] + ahead_s * state[3] - car[1]
    along = cos * east + sin * north
    across = cos * north - sin * east
    # The road user's extent, which looks to where its track moves.
    turned = math.atan2(state[3], state[2]) - car[2]
    ahead = abs(math.cos(turned))
    aside = abs(math.sin(turned))
    half_length = half_vut[0] + ahead * half_vru[0] + aside * half_vru[1]
    half_width = half_vut[1] + aside * half_vru[0] + ahead * half_vru[1]
    beside = mass_between(
        -half_width - across, half_width - across, across_variance + car_variance[1]
    )
    return beside * mass_between(
        -half_length - along, half_length - along, along_variance + car_variance[0]
    )


@kernel
def foresee(
    time_s: FloatArray,
    run_start: IntArray,
    states: FloatArray,
    covariances: FloatArray,
    is_live: BoolArray,
    car_places: FloatArray,
    car_start: IntArray,
    time_to_stop_s: FloatArray,
    reserves_s: FloatArray,
    noise: float,
    car_variance: FloatArray,
    half_vut: FloatArray,
    half_vru: FloatArray,
    step_s: float,
    found: FloatArray,
) -> None:
    """Look ahead; see :func:`scenarios.decision.overlap_probability`. Fills `found`."""
    car = np.empty(3)
    # Over runs, frames, and reserves: each goes on where the shorter one ended.
    for run in range(len(run_start) - 1):
        begin = run_start[run]
        for frame in range(begin, run_start[run + 1]):
            if not is_live[frame]:
                continue
            step = 0
            largest = 0.0
            for which in range(len(reserves_s)):
                end_s = time_to_stop_s[run] + reserves_s[which]
                is_last = False
                while not is_last:
                    ahead_s = step * step_s
                    is_last = ahead_s >= end_s
                    if is_last:
                        ahead_s = end_s
                    # The car's place then, between two points of its way.
                    point = (time_s[frame] - time_s[begin] + ahead_s) / step_s
                    before = car_start[run] + int(point)
                    before = min(before, car_start[run + 1] - 2)
                    share = point - (before - car_start[run])
                    for i in range(3):
                        car[i] = (1.0 - share) * car_places[before, i]
                        car[i] += share * car_places[before + 1, i]
                    probability = overlap_at(
                        states[frame],
                        covariances[frame],
                        ahead_s,
                        noise,
                        car,
                        car_variance,
                        half_vut,
                        half_vru[run],
                    )
                    if is_last:
                        # The end of one reserve is none of the steps of another.
                        found[which, frame] = max(largest, probability)
                    else:
                        largest = max(largest, probability)
                        step += 1
