"""Confirmed tracks, which the VUT brakes for.

Consecutive detections confirm a track, memory keeps it, and it must be in time.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray

from .aeb import TIME_TOLERANCE_S, AebRule


def confirmation_mask(detected: ArrayLike, *, n_confirmations: int) -> BoolArray:
    """Frames at which the last `n_confirmations` are all detected.

    All are of one run, (..., n_frames).

    >>> confirmation_mask([0, 1, 1, 1, 1, 0], n_confirmations=3).astype(int)
    array([0, 0, 0, 1, 1, 0])
    """
    frames = np.asarray(detected, dtype=bool)
    confirmed = np.zeros_like(frames)
    n_windows = frames.shape[-1] - n_confirmations + 1
    if n_windows > 0:
        # Windows of consecutive frames in which all are detected.
        complete = np.ones((*frames.shape[:-1], n_windows), dtype=bool)
        for offset in range(n_confirmations):
            complete &= frames[..., offset : offset + n_windows]
        confirmed[..., n_confirmations - 1 :] = complete
    return confirmed


def held_frames(
    detected: ArrayLike,
    time_s: ArrayLike,
    *,
    until_s: ArrayLike,
    memory_s: float,
    last_frame: ArrayLike | None = None,
) -> BoolArray:
    """Detected frames since which the VRU was never lost.

    It is lost if it is out of sight for longer than the memory.

    A track that is confirmed in such a frame is alive at `until_s`: neither between two
    detections from then on, nor from the last one until then, more than `memory_s` have
    passed.

    Parameters
    ----------
    detected : (..., n_frames) bool
        Frames in which the VRU is detected, of those that the VUT knows of when it
        matters.
    time_s : (n_frames,) float
        Ascending within a run. [s]
    until_s : float or (n_frames,) float
        When the track must be alive; the same in all frames of a run. [s]
    memory_s : float
        How long a track lives without detections; may be infinite. [s]
    last_frame : (n_frames,) int, optional
        The last frame of each frame's run; by default all belong to one run.

    Returns
    -------
    held : (..., n_frames) bool
        More detections never make fewer frames held.

    Examples
    --------
    >>> seen = [1, 1, 0, 1, 0, 1]
    >>> time_s = [1, 2, 3, 4, 5, 6]
    >>> held_frames(seen, time_s, until_s=6.5, memory_s=2.0).astype(int)
    array([1, 1, 0, 1, 0, 1])
    >>> held_frames(seen, time_s, until_s=6.5, memory_s=1.0).astype(int)
    array([0, 0, 0, 0, 0, 1])
    """
    seen = np.asarray(detected, dtype=bool)
    times = np.asarray(time_s, dtype=np.float64)
    n_frames = len(times)
    if memory_s == math.inf or n_frames == 0:
        return seen.copy()
    last = np.broadcast_to(
        n_frames - 1 if last_frame is None else last_frame, times.shape
    )
    until = np.broadcast_to(until_s, times.shape)
    # Of the detections of all rows, end to end.
    place = np.flatnonzero(seen)
    frame = place % n_frames
    end = place - frame + last[frame]
    following = np.append(place[1:], seen.size)
    next_s = np.where(following <= end, times[following % n_frames], until[frame])
    lost = np.where(
        next_s - times[frame] > memory_s + TIME_TOLERANCE_S, place, seen.size
    )
    # The next detection after which the track is lost, from each one on.
    first_lost = np.minimum.accumulate(lost[::-1])[::-1]
    held = np.zeros(seen.shape, dtype=bool)
    held.reshape(-1)[place[first_lost > end]] = True
    return held


def live_confirmation_time_s(
    detected: ArrayLike, time_s: ArrayLike, *, until_s: float, rule: AebRule
) -> FloatArray:
    """When the track of one run that is alive at `until_s` was confirmed, in seconds.

    (..., n_frames) detections -> (...,); infinite if no confirmed track is alive then.
    `until_s` is the last brake time less the latency; with an infinite
    ``rule.track_memory_s`` it is the first confirmation up to then: the study's
    reading. More detections never make it later. It decides the avoidance (finite or
    not) and the margin, `until_s` less it.
    """
    times = np.asarray(time_s, dtype=np.float64)
    frames = np.asarray(detected, dtype=bool) & (times <= until_s + TIME_TOLERANCE_S)
    confirmed = confirmation_mask(frames, n_confirmations=rule.n_confirmations)
    confirmed &= held_frames(
        frames, times, until_s=until_s, memory_s=rule.track_memory_s
    )
    result: FloatArray = np.where(confirmed, times, np.inf).min(axis=-1, initial=np.inf)
    return result


def is_in_time(
    confirmation_s: ArrayLike, last_brake_s: ArrayLike, *, latency_s: float
) -> BoolArray:
    """True if braking after a confirmation avoids the contact.

    The confirmation plus the latency must not be later than the last brake
    time.
    """
    onset = np.asarray(confirmation_s, dtype=np.float64) + latency_s
    return onset <= np.asarray(last_brake_s, dtype=np.float64) + TIME_TOLERANCE_S
