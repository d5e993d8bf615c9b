"""Tracks of road users: a Kalman filter of constant velocity over reported places.

All runs are filtered at once, frame by frame, so that numpy does the work: a kernel
would take twelve seconds to compile, on every new machine, for what costs less than a
second here.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .aeb import TIME_TOLERANCE_S, AebRule


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """The fused track of each run's road user, after each frame.

    Attributes
    ----------
    state : (n_worlds, n_frames, 4) float
        East, north and their rates, in worlds of other errors. World frame.
        [m], [m/s]
    covariance : (n_frames, 4, 4) float
        Of the state: the same in all worlds.
    is_live : (n_frames,) bool
        A confirmed track is alive; elsewhere the numbers above mean nothing.
    """

    state: FloatArray
    covariance: FloatArray
    is_live: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filtered:
    """All runs after their frames of one step; those that have ended stand still.

    Attributes
    ----------
    frame : (n_runs,) int
        The frames.
    goes_on : (n_runs,) bool
        False for runs that have ended before.
    state : (n_worlds, 4, n_runs) float
        As that of :class:`Tracks`. It is changed by the next step.
    covariance : (4, 4, n_runs) float
        Of the state; also changed by the next step.
    is_live : (n_runs,) bool
        A confirmed track is alive.
    """

    frame: IntArray
    goes_on: BoolArray
    state: FloatArray
    covariance: FloatArray
    is_live: BoolArray


def follow(
    detected: BoolArray,
    position_m: FloatArray,
    covariance_m2: FloatArray,
    time_s: FloatArray,
    run_start: IntArray,
    *,
    aeb: AebRule,
    acceleration_noise_m2ps3: float,
    first_speed_sd_mps: float,
) -> Iterator[Filtered]:
    """Follow each run's road user by a Kalman filter of constant velocity.

    Units are fused by their covariances, one after the other. A track is confirmed by
    consecutive frames in which any unit detects, and lost after the track memory.

    Parameters
    ----------
    detected : (n_units, n_frames) bool
        Who detects when.
    position_m : (n_worlds, n_units, n_frames, 2) float
        Reported east and north; not read where nothing is detected. Without a world,
        only covariances are found. [m]
    covariance_m2 : (n_units, n_frames, 3) float
        Variance of east, covariance, variance of north. [m^2]
    time_s : (n_frames,) float
        Ascending in each run. [s]
    run_start : (n_runs + 1,) int
        Frames of run r are run_start[r] .. run_start[r + 1] - 1, at least one.
    aeb : AebRule
        Confirmation and memory.
    acceleration_noise_m2ps3 : float
        Spectral density of road users' accelerations. [m^2/s^3]
    first_speed_sd_mps : float
        Of a new track's speed in each direction. [m/s]

    Yields
    ------
    filtered : Filtered
        After the first frames of all runs, after their second ones, and so on.

    References
    ----------
    .. [1] Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to
       Tracking and Navigation", 2001, 6.2.2: continuous white noise acceleration.
    """
    n_runs = len(run_start) - 1
    lengths = np.diff(run_start)
    memory_s = aeb.track_memory_s + TIME_TOLERANCE_S
    first_speed_variance = first_speed_sd_mps**2
    state = np.zeros((len(position_m), 4, n_runs))
    cov = np.zeros((4, 4, n_runs))
    is_tracked = np.zeros(n_runs, dtype=bool)
    is_confirmed = np.zeros(n_runs, dtype=bool)
    n_in_a_row = np.zeros(n_runs, dtype=np.int64)
    seen_s = np.full(n_runs, -np.inf)
    before_s = time_s[run_start[:-1]]
    for step in range(int(lengths.max(initial=0))):
        goes_on = step < lengths
        # The last frame again where a run has ended: no time passes there.
        frame = run_start[:-1] + np.minimum(step, lengths - 1)
        now_s = time_s[frame]
        is_tracked = is_tracked & (now_s - seen_s <= memory_s)
        is_confirmed &= is_tracked
        _predict(state, cov, now_s - before_s, acceleration_noise_m2ps3)
        before_s = now_s
        is_seen = np.zeros(n_runs, dtype=bool)
        sees = detected[:, frame] & goes_on
        for unit in np.flatnonzero(sees.any(axis=1)):
            place_m = position_m[:, unit, frame]
            error = covariance_m2[unit, frame].T
            _update(state, cov, place_m, error, sees[unit] & is_tracked)
            begins = sees[unit] & ~is_tracked
            if begins.any():
                # A new track stands where it was seen.
                state[:, :, begins] = 0.0
                state[:, 0, begins] = place_m[:, begins, 0]
                state[:, 1, begins] = place_m[:, begins, 1]
                cov[:, :, begins] = 0.0
                cov[0, 0, begins] = error[0, begins]
                cov[0, 1, begins] = error[1, begins]
                cov[1, 0, begins] = error[1, begins]
                cov[1, 1, begins] = error[2, begins]
                cov[2, 2, begins] = first_speed_variance
                cov[3, 3, begins] = first_speed_variance
                is_tracked = is_tracked | begins
            is_seen |= sees[unit]
        # Runs that have ended keep their count: nothing confirms them any more.
        n_in_a_row = np.where(goes_on & ~is_seen, 0, n_in_a_row + is_seen)
        seen_s = np.where(is_seen, now_s, seen_s)
        is_confirmed |= n_in_a_row >= aeb.n_confirmations
        yield Filtered(
            frame=frame,
            goes_on=goes_on,
            state=state,
            covariance=cov,
            is_live=is_tracked & is_confirmed,
        )


def collect(steps: Iterable[Filtered], *, n_frames: int, n_worlds: int) -> Tracks:
    """Tracks after each frame, of what :func:`follow` yields."""
    state = np.zeros((n_worlds, n_frames, 4))
    covariance = np.zeros((n_frames, 4, 4))
    is_live = np.zeros(n_frames, dtype=bool)
    for step in steps:
        runs = np.flatnonzero(step.goes_on)
        frame = step.frame[runs]
        state[:, frame] = step.state[:, :, runs].transpose(0, 2, 1)
        covariance[frame] = step.covariance[:, :, runs].transpose(2, 0, 1)
        is_live[frame] = step.is_live[runs]
    return Tracks(state=state, covariance=covariance, is_live=is_live)


def _predict(
    state: FloatArray, cov: FloatArray, step_s: FloatArray, noise: float
) -> None:
    """Move states (.., 4, n_runs) and covariances (4, 4, n_runs) on, in place.

    Constant velocity: F P F' + Q with F = [[1, t], [0, 1]] and, with the spectral
    density q of the accelerations, Q = q [[t^3 / 3, t^2 / 2], [t^2 / 2, t]].
    """
    state[:, :2] += step_s * state[:, 2:]
    cov[:2] += step_s * cov[2:]
    cov[:, :2] += step_s * cov[:, 2:]
    for i in range(2):
        cov[i, i] += noise * step_s**3 / 3.0
        cov[i, i + 2] += noise * step_s**2 / 2.0
        cov[i + 2, i] += noise * step_s**2 / 2.0
        cov[i + 2, i + 2] += noise * step_s


def _update(
    state: FloatArray,
    cov: FloatArray,
    place_m: FloatArray,
    error: FloatArray,
    counts: BoolArray,
) -> None:
    """Take measured places (n_worlds, n_runs, 2) with errors (3, n_runs) in, in place.

    K = P H' (H P H' + R)^-1 with H = [1, 0]; the 2 x 2 inverse is written out. Runs
    that do not count get a gain of 0.
    """
    s_ee = cov[0, 0] + error[0]
    s_en = cov[0, 1] + error[1]
    s_nn = cov[1, 1] + error[2]
    determinant = s_ee * s_nn - s_en * s_en
    # A gain of 0 leaves a run that does not count as it is.
    scale = np.divide(1.0, determinant, out=np.zeros_like(s_ee), where=counts)
    # Rows are read while they are written.
    before = cov[:2].copy()
    gain_east = (before[0] * s_nn - before[1] * s_en) * scale
    gain_north = (before[1] * s_ee - before[0] * s_en) * scale
    cov -= gain_east[:, None] * before[0] + gain_north[:, None] * before[1]
    off_m = place_m.transpose(0, 2, 1) - state[:, :2]
    state += gain_east * off_m[:, :1] + gain_north * off_m[:, 1:]
