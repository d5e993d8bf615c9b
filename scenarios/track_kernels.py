"""Numba kernels of tracks: the filter, frame by frame, and what it foresees.

A state is [east, north, east rate, north rate]. Units are rows, frames lie run after
run along the second axis.
"""

import math

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.kernels import kernel


@kernel
def predict(state: FloatArray, cov: FloatArray, step_s: float, noise: float) -> None:
    """Move a state (4,) and its covariance (4, 4) on by a time, in place.

    Constant velocity: F P F' + Q with F = [[1, t], [0, 1]] and, with the spectral
    density q of the accelerations, Q = q [[t^3 / 3, t^2 / 2], [t^2 / 2, t]].
    """
    for i in range(2):
        state[i] += step_s * state[i + 2]
        for j in range(4):
            cov[i, j] += step_s * cov[i + 2, j]
    for j in range(2):
        for i in range(4):
            cov[i, j] += step_s * cov[i, j + 2]
    for i in range(2):
        cov[i, i] += noise * step_s**3 / 3.0
        cov[i, i + 2] += noise * step_s**2 / 2.0
        cov[i + 2, i] += noise * step_s**2 / 2.0
        cov[i + 2, i + 2] += noise * step_s


@kernel
def update(
    state: FloatArray, cov: FloatArray, place: FloatArray, error: FloatArray
) -> None:
    """Take a measured place (2,) with its error (3,) into a state, in place.

    K = P H' (H P H' + R)^-1 with H = [1, 0]; the 2 x 2 inverse is written out.
    """
    s_ee = cov[0, 0] + error[0]
    s_en = cov[0, 1] + error[1]
    s_nn = cov[1, 1] + error[2]
    determinant = s_ee * s_nn - s_en * s_en
    off_east = place[0] - state[0]
    off_north = place[1] - state[1]
    before = cov[:2].copy()
    for i in range(4):
        p_e = before[0, i]
        p_n = before[1, i]
        gain_east = (p_e * s_nn - p_n * s_en) / determinant
        gain_north = (p_n * s_ee - p_e * s_en) / determinant
        state[i] += gain_east * off_east + gain_north * off_north
        for j in range(4):
            cov[i, j] -= gain_east * before[0, j] + gain_north * before[1, j]


@kernel
def follow(
    time_s: FloatArray,
    run_start: IntArray,
    detected: BoolArray,
    position_m: FloatArray,
    covariance_m2: FloatArray,
    n_confirmations: int,
    memory_s: float,
    noise: float,
    first_speed_variance: float,
    states: FloatArray,
    covariances: FloatArray,
    is_live: BoolArray,
) -> None:
    """Filter all runs; see :func:`scenarios.decision.track`. Fills the last three."""
    state = np.zeros(4)
    cov = np.zeros((4, 4))
    # Over runs, then over the frames of a run, then over units.
    for run in range(len(run_start) - 1):
        is_tracked = False
        is_confirmed = False
        n_in_a_row = 0
        seen_s = 0.0
        for frame in range(run_start[run], run_start[run + 1]):
            now_s = time_s[frame]
            if is_tracked and now_s - seen_s > memory_s:
                is_tracked = False
                is_confirmed = False
            if is_tracked:
                predict(state, cov, now_s - time_s[frame - 1], noise)
            is_seen = False
            for unit in range(detected.shape[0]):
                if not detected[unit, frame]:
                    continue
                is_seen = True
                place = position_m[unit, frame]
                error = covariance_m2[unit, frame]
                if is_tracked:
                    update(state, cov, place, error)
                    continue
                # A new track stands where it was seen.
                is_tracked = True
                state[:2] = place
                state[2:] = 0.0
                cov[:] = 0.0
                cov[0, 0] = error[0]
                cov[0, 1] = error[1]
                cov[1, 0] = error[1]
                cov[1, 1] = error[2]
                cov[2, 2] = first_speed_variance
                cov[3, 3] = first_speed_variance
            if is_seen:
                n_in_a_row += 1
                seen_s = now_s
            else:
                n_in_a_row = 0
            is_confirmed |= n_in_a_row >= n_confirmations
            is_live[frame] = is_tracked and is_confirmed
            states[frame] = state
            covariances[frame] = cov


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
