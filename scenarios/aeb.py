"""Autonomous emergency braking: the rule that optimiser and evaluator share.

Times are relative to the unbraked impact: negative before it.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.footprints import footprint_corners, footprint_separation
from geometry.toml_files import load_toml, take, take_number

from .paths import Motion

_ONSET_STEP_S = 0.05  # first pass over the onsets of braking
_TIME_STEP_S = 0.01  # first pass over the time after the onset
_FINE_STEP_S = 0.001  # a footprint moves 1.7 cm in it at 60 km/h
_BRACKET_POINTS = 17
_REFINEMENTS = 3  # each narrows the bracket sixteenfold: 0.1 s -> 24 microseconds
_TIME_TOLERANCE_S = 1.0e-9  # frames lie on multiples of 0.1 s, which binary numbers only approach


@dataclass(frozen=True, slots=True, kw_only=True)
class AebRule:
    """From detected frames to braking.

    Attributes
    ----------
    deceleration_mps2 : float
        Constant from the onset. [m/s^2]
    latency_s : float
        From the confirming frame to the onset of braking. [s]
    n_confirmations : int
        Consecutive detected frames that confirm a VRU.
    frame_rate_hz : float
        Frames per second. [Hz]
    """

    deceleration_mps2: float
    latency_s: float
    n_confirmations: int
    frame_rate_hz: float

    def __post_init__(self) -> None:
        for field in ("deceleration_mps2", "frame_rate_hz"):
            if not (np.isfinite(getattr(self, field)) and getattr(self, field) > 0.0):
                raise InputError(f"aeb.{field}", getattr(self, field), "a positive number")
        if not (np.isfinite(self.latency_s) and self.latency_s >= 0.0):
            raise InputError("aeb.latency_s", self.latency_s, "seconds, at least 0")
        n_frames = self.n_confirmations
        if not isinstance(n_frames, int) or isinstance(n_frames, bool) or n_frames < 1:
            raise InputError("aeb.n_confirmations", n_frames, "a whole number, >= 1")


@cache
def load_aeb_rule() -> AebRule:
    """The study's rule, from ``data/aeb.toml``."""
    table = load_toml(files(__package__) / "data" / "aeb.toml")
    return AebRule(
        deceleration_mps2=take_number(table, "deceleration_mps2", "aeb.toml"),
        latency_s=take_number(table, "latency_s", "aeb.toml"),
        n_confirmations=take(table, "n_confirmations", "aeb.toml"),
        frame_rate_hz=take_number(table, "frame_rate_hz", "aeb.toml"),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Encounter:
    """Two bodies on collision course: without braking they first touch at time 0.

    Attributes
    ----------
    vut, vru : Actor
        The bodies; only their footprints count here.
    vut_motion, vru_motion : Motion
        Without braking. The path's origin is the middle of the footprint.
    """

    vut: Actor
    vut_motion: Motion
    vru: Actor
    vru_motion: Motion


def braking_distance_m(
    time_s: ArrayLike, *, speed_mps: ArrayLike, deceleration_mps2: float
) -> FloatArray:
    """Distance covered in the time since the onset of braking, until standstill and after.

    Parameters
    ----------
    time_s : (...,) float
        Since the onset, at least 0. [s]
    speed_mps : (...,) float
        At the onset. [m/s]
    deceleration_mps2 : float
        Constant, positive. [m/s^2]

    Returns
    -------
    distance_m : (...,) float
        v t - a t^2 / 2, and v^2 / (2 a) from t = v / a on. [m]

    Examples
    --------
    >>> float(braking_distance_m(10.0, speed_mps=20.0, deceleration_mps2=8.0))
    25.0
    """
    speed = np.asarray(speed_mps, dtype=np.float64)
    braking = np.minimum(np.asarray(time_s, dtype=np.float64), speed / deceleration_mps2)
    distance: FloatArray = speed * braking - 0.5 * deceleration_mps2 * braking**2
    return distance


def smallest_separation_m(
    encounter: Encounter,
    onset_s: ArrayLike,
    *,
    deceleration_mps2: float,
    time_step_s: float = _FINE_STEP_S,
) -> FloatArray:
    """Smallest separation of the footprints from the onset of braking until the VUT stands.

    Parameters
    ----------
    encounter : Encounter
        Who meets whom.
    onset_s : (n,) float
        When braking sets in. Before, the VUT drives as in the encounter. [s]
    deceleration_mps2 : float
        Constant, along the VUT's path. [m/s^2]
    time_step_s : float
        Step at which the separation is looked at. [s]

    Returns
    -------
    separation_m : (n,) float
        Zero or less: they touch. Footprints more than their half diagonals apart count as
        infinitely far.
    """
    onset = np.atleast_1d(np.asarray(onset_s, dtype=np.float64))
    vut, vru = encounter.vut_motion, encounter.vru_motion
    speed = np.where(onset >= vut.start_time_s, vut.speed_mps, 0.0)
    until_standstill_s = vut.speed_mps / deceleration_mps2
    since_onset = np.linspace(0.0, until_standstill_s, int(until_standstill_s / time_step_s) + 2)

    vut_distance = vut.distance_m(onset)[:, None] + braking_distance_m(
        since_onset, speed_mps=speed[:, None], deceleration_mps2=deceleration_mps2
    )
    vut_position, vut_yaw = vut.path.at(vut_distance)
    vru_position, vru_yaw = vru.path.at(vru.distance_m(onset[:, None] + since_onset))

    reach = 0.5 * (
        np.hypot(encounter.vut.length_m, encounter.vut.width_m)
        + np.hypot(encounter.vru.length_m, encounter.vru.width_m)
    )
    between = vut_position - vru_position
    is_near = (between**2).sum(axis=-1) <= reach**2
    separation = np.full(vut_distance.shape, np.inf)
    separation[is_near] = footprint_separation(
        _footprints(encounter.vut, vut_position[is_near], vut_yaw[is_near]),
        _footprints(encounter.vru, vru_position[is_near], vru_yaw[is_near]),
    )
    smallest: FloatArray = separation.min(axis=1)
    return smallest


def last_brake_time_s(encounter: Encounter, *, deceleration_mps2: float) -> float:
    """Latest onset of braking such that it and every earlier one avoids the contact.

    Parameters
    ----------
    encounter : Encounter
        Who meets whom.
    deceleration_mps2 : float
        Constant. [m/s^2]

    Returns
    -------
    last_brake_time_s : float
        At most 0; minus infinity if even braking at the VUT's start does not help. [s]

    Notes
    -----
    Swept, not solved: paths may bend. Onsets are looked at every 0.05 s and the first bracket in
    which contact sets in is narrowed to 24 microseconds.
    """
    start = encounter.vut_motion.start_time_s
    onsets = np.append(np.arange(start, 0.0, _ONSET_STEP_S), 0.0)
    touches = (
        smallest_separation_m(
            encounter, onsets, deceleration_mps2=deceleration_mps2, time_step_s=_TIME_STEP_S
        )
        <= 0.0
    )
    if touches[0]:
        return -np.inf
    if not touches.any():
        return 0.0
    late = int(np.argmax(touches))
    # Two steps back: the finer time step may see a contact that the first pass just missed.
    low, high = onsets[max(late - 2, 0)], onsets[late]
    for _ in range(_REFINEMENTS):
        onsets = np.linspace(low, high, _BRACKET_POINTS)
        touches = (
            smallest_separation_m(encounter, onsets, deceleration_mps2=deceleration_mps2) <= 0.0
        )
        touches[-1] = True  # seen before, perhaps only by the other time step
        late = int(np.argmax(touches))
        low, high = onsets[max(late - 1, 0)], onsets[late]
    return float(low)


def has_contact(encounter: Encounter, onset_s: float, *, deceleration_mps2: float) -> bool:
    """Whether the footprints touch although the VUT brakes from `onset_s` on.

    Parameters
    ----------
    encounter : Encounter
        Who meets whom.
    onset_s : float
        When braking sets in; infinite: never. At or after the impact it is too late. [s]
    deceleration_mps2 : float
        Constant. [m/s^2]

    Returns
    -------
    has_contact : bool
        True: not avoided.
    """
    if onset_s >= 0.0:
        return True
    separation = smallest_separation_m(encounter, onset_s, deceleration_mps2=deceleration_mps2)
    return bool(separation[0] <= 0.0)


def confirmation_mask(detected: ArrayLike, *, n_confirmations: int) -> BoolArray:
    """Frames at which the last `n_confirmations` frames of the run are all detected.

    Parameters
    ----------
    detected : (..., n_frames) bool
        One run.
    n_confirmations : int
        Consecutive frames needed.

    Returns
    -------
    is_confirmed : (..., n_frames) bool
        At the last frame of every complete window.

    Examples
    --------
    >>> confirmation_mask([0, 1, 1, 1, 1, 0], n_confirmations=3).astype(int)
    array([0, 0, 0, 1, 1, 0])
    """
    frames = np.asarray(detected, dtype=bool)
    confirmed = np.zeros_like(frames)
    n_windows = frames.shape[-1] - n_confirmations + 1
    if n_windows > 0:
        complete = np.ones((*frames.shape[:-1], n_windows), dtype=bool)
        for offset in range(n_confirmations):
            complete &= frames[..., offset : offset + n_windows]
        confirmed[..., n_confirmations - 1 :] = complete
    return confirmed


def confirmation_time_s(
    detected: ArrayLike, time_s: ArrayLike, *, n_confirmations: int
) -> FloatArray:
    """When a VRU is first confirmed.

    Parameters
    ----------
    detected : (..., n_frames) bool
        One run.
    time_s : (n_frames,) float
        Times of the frames. [s]
    n_confirmations : int
        Consecutive frames needed.

    Returns
    -------
    confirmation_time_s : (...,) float
        Time of the first window's last frame; infinite if there is none. [s]
    """
    confirmed = confirmation_mask(detected, n_confirmations=n_confirmations)
    first = np.argmax(confirmed, axis=-1)
    times = np.asarray(time_s, dtype=np.float64)
    result: FloatArray = np.where(confirmed.any(axis=-1), times[first], np.inf)
    return result


def is_in_time(
    confirmation_s: ArrayLike, last_brake_s: ArrayLike, *, latency_s: float
) -> BoolArray:
    """Whether braking after a confirmation avoids the impact.

    Parameters
    ----------
    confirmation_s : (...,) float
        When the VRU is confirmed. [s]
    last_brake_s : (...,) float
        Latest onset that avoids. [s]
    latency_s : float
        From confirmation to onset. [s]

    Returns
    -------
    in_time : (...,) bool
        confirmation + latency <= last brake time.
    """
    onset = np.asarray(confirmation_s, dtype=np.float64) + latency_s
    in_time: BoolArray = onset <= np.asarray(last_brake_s, dtype=np.float64) + _TIME_TOLERANCE_S
    return in_time


def _footprints(actor: Actor, position_m: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    return footprint_corners(position_m, yaw_deg, length_m=actor.length_m, width_m=actor.width_m)
