"""How the VUT brakes: the rule from detected frames to standstill, and its motion."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.toml_files import load_toml, take, take_number


@dataclass(frozen=True, slots=True, kw_only=True)
class AebRule:
    """From detected frames to braking.

    Attributes
    ----------
    deceleration_mps2 : float
        Constant once it is built up. [m/s^2]
    build_up_s : float
        From the onset the deceleration rises linearly for so long. [s]
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
    build_up_s: float = 0.0

    def __post_init__(self) -> None:
        for field in ("deceleration_mps2", "frame_rate_hz"):
            if not (np.isfinite(getattr(self, field)) and getattr(self, field) > 0.0):
                raise InputError(f"aeb.{field}", getattr(self, field), "a positive number")
        for field in ("latency_s", "build_up_s"):
            if not (np.isfinite(getattr(self, field)) and getattr(self, field) >= 0.0):
                raise InputError(f"aeb.{field}", getattr(self, field), "seconds, at least 0")
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
        build_up_s=take_number(table, "build_up_s", "aeb.toml"),
    )


def standstill_time_s(speed_mps: ArrayLike, *, rule: AebRule) -> FloatArray:
    """Time from the onset of braking to standstill.

    Parameters
    ----------
    speed_mps : (...,) float
        At the onset. [m/s]
    rule : AebRule
        Deceleration a and build-up b.

    Returns
    -------
    time_s : (...,) float
        v / a + b / 2; sqrt(2 v b / a) where that comes within the build-up. [s]
    """
    full_s = np.asarray(speed_mps, dtype=np.float64) / rule.deceleration_mps2
    time: FloatArray = np.where(
        full_s < 0.5 * rule.build_up_s,
        np.sqrt(2.0 * full_s * rule.build_up_s),
        full_s + 0.5 * rule.build_up_s,
    )
    return time


def braking_speed_mps(time_s: ArrayLike, *, speed_mps: ArrayLike, rule: AebRule) -> FloatArray:
    """Speed left after a time since the onset of braking.

    Parameters
    ----------
    time_s : (...,) float
        Since the onset, at least 0. [s]
    speed_mps : (...,) float
        At the onset. [m/s]
    rule : AebRule
        Deceleration and build-up.

    Returns
    -------
    speed_mps : (...,) float
        0 from standstill on. [m/s]
    """
    rising, full = _phases(np.asarray(time_s, dtype=np.float64), rule)
    braked_s = full if rule.build_up_s == 0.0 else full + 0.5 * rising**2 / rule.build_up_s
    lost_mps = rule.deceleration_mps2 * braked_s
    speed: FloatArray = np.maximum(0.0, np.asarray(speed_mps, dtype=np.float64) - lost_mps)
    return speed


def braking_distance_m(time_s: ArrayLike, *, speed_mps: ArrayLike, rule: AebRule) -> FloatArray:
    """Distance covered in the time since the onset of braking, until standstill and after.

    Parameters
    ----------
    time_s : (...,) float
        Since the onset, at least 0. [s]
    speed_mps : (...,) float
        At the onset. [m/s]
    rule : AebRule
        Deceleration a and build-up b.

    Returns
    -------
    distance_m : (...,) float
        v t - a t^3 / (6 b) during the build-up; r after its end
        v t - a (b^2 / 6 + b r / 2 + r^2 / 2), until standstill. [m]

    Examples
    --------
    >>> from dataclasses import replace
    >>> rule = replace(load_aeb_rule(), deceleration_mps2=8.0)
    >>> float(braking_distance_m(10.0, speed_mps=20.0, rule=rule))
    25.0
    """
    speed = np.asarray(speed_mps, dtype=np.float64)
    time = np.minimum(np.asarray(time_s, dtype=np.float64), standstill_time_s(speed, rule=rule))
    rising, full = _phases(time, rule)
    lost = 0.5 * full**2
    if rule.build_up_s > 0.0:
        lost = lost + rising**3 / (6.0 * rule.build_up_s) + 0.5 * rule.build_up_s * full
    distance: FloatArray = speed * time - rule.deceleration_mps2 * lost
    return distance


def _phases(time_s: FloatArray, rule: AebRule) -> tuple[FloatArray, FloatArray]:
    """Seconds of braking while the deceleration rises, and of braking in full."""
    rising = np.minimum(time_s, rule.build_up_s)
    return rising, time_s - rising
