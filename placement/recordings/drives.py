"""From the frames of a recording, which run on over many drives, to drives up to the impact."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from scenarios.aeb import AebRule, braking_distance_m

from .files import FrameKey, RecordingFormat, World

# ---------- when braking is too late in a drive of which only distances and target speeds are


def closing_speed_mps(time_s: FloatArray, distance_m: FloatArray) -> float:
    """How fast a distance falls: minus the slope of the straight line through it.

    Parameters
    ----------
    time_s, distance_m : (n,) float
        At least two. [s], [m]

    Returns
    -------
    closing_speed_mps : float
        By least squares. [m/s]

    Examples
    --------
    >>> round(closing_speed_mps(np.array([-0.2, -0.1]), np.array([6.0, 5.5])), 9)
    5.0
    """
    time = time_s - time_s.mean()
    return -float(time @ (distance_m - distance_m.mean()) / (time @ time))


def is_same_direction(
    *,
    vut_speed_mps: float,
    vru_speed_mps: float,
    closing_speed_mps: float,
    form: RecordingFormat,
) -> bool:
    """Whether the VUT catches up with a VRU that goes its way.

    Parameters
    ----------
    vut_speed_mps, vru_speed_mps, closing_speed_mps : float
        v, u and c. [m/s]
    form : RecordingFormat
        Up to which angle the ways count as the same.

    Returns
    -------
    is_same_direction : bool
        False for a VRU that stands, or is as fast as the VUT.
    """
    v, u = vut_speed_mps, vru_speed_mps
    if not 0.0 < u < v:
        return False
    cosine = (v**2 + u**2 - closing_speed_mps**2) / (2.0 * u * v)
    return cosine > math.cos(math.radians(form.max_same_direction_deg))


def last_brake_time_s(
    *, vut_speed_mps: float, vru_speed_mps: float, is_same_direction: bool, rule: AebRule
) -> float:
    """Latest onset of braking that avoids, relative to the impact.

    Parameters
    ----------
    vut_speed_mps, vru_speed_mps : float
        v and u. [m/s]
    is_same_direction : bool
        The VUT must shed v - u only, before the gap to the VRU is closed; otherwise it must stop
        short of the place of the impact.
    rule : AebRule
        How the VUT brakes.

    Returns
    -------
    last_brake_time_s : float
        -(v - u) / (2 a) or -v / (2 a) without build-up. [s]

    Examples
    --------
    >>> from dataclasses import replace
    >>> from scenarios.aeb import load_aeb_rule
    >>> rule = replace(load_aeb_rule(), deceleration_mps2=8.0)
    >>> last_brake_time_s(
    ...     vut_speed_mps=16.0, vru_speed_mps=4.0, is_same_direction=True, rule=rule
    ... )
    -0.75
    """
    shed_mps = vut_speed_mps - vru_speed_mps if is_same_direction else vut_speed_mps
    # Relative to the VRU (or the road) the VUT needs this distance, and covers it unbraked in..
    distance_m = float(braking_distance_m(np.inf, speed_mps=shed_mps, rule=rule))
    return -distance_m / shed_mps


# ---------- from the frames of a recording


RESETS = "frames between drives (bodies back at their starts)"
TOO_SHORT = "frames of drives too short to tell their motion"
NO_APPROACH = "frames of drives in which nothing approaches"
MISFITS = "frames of drives whose distance does not fall as their speeds ask"

UNSEEN = "unseen"
"""Class of a VRU that no unit has a label of."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """Frames of one scenario at one speed, up to the impact.

    Attributes
    ----------
    scenario : int
        Index in the recording.
    vru_class : str
        "pedestrian", "bicycle", or "unseen".
    vut_speed_mps, vru_speed_mps : float
        Target speeds. [m/s]
    closing_speed_mps : float
        At which the distance falls in the last second before the impact. [m/s]
    first_number : int
        Frame number of the first frame; the others follow one by one.
    distance_m : (n_frames,) float
        Between the origins of VUT and VRU; the last one is that of the impact. NaN for a frame that
        is missing. [m]
    """

    scenario: int
    vru_class: str
    vut_speed_mps: float
    vru_speed_mps: float
    closing_speed_mps: float
    first_number: int
    distance_m: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance_m", freeze(self.distance_m))

    @property
    def n_frames(self) -> int:
        """Number of frames, missing ones too."""
        return len(self.distance_m)

    @property
    def n_missing(self) -> int:
        """Number of frames that are missing."""
        return int(np.isnan(self.distance_m).sum())

    @property
    def frames(self) -> tuple[FrameKey, ...]:
        """Keys of all frames."""
        return tuple(
            FrameKey(self.scenario, self.first_number + index) for index in range(self.n_frames)
        )

    def __repr__(self) -> str:
        return f"Drive(scenario {self.scenario}, {self.vru_class}, {self.n_frames} frames)"


def cut_drives(
    world: Mapping[FrameKey, World], form: RecordingFormat
) -> tuple[list[Drive], Counter[str]]:
    """Cut the frames of a recording into drives.

    Within a scenario a drive is a stretch of frames with the same target speeds. Where the distance
    rises by more than these allow, the bodies were put back, and another stretch begins, as where
    many frames are missing. The impact is the frame of the smallest distance; what follows is no
    more part of the drive, nor are frames after a reset in which the bodies still stand.

    Parameters
    ----------
    world : mapping of FrameKey to World
        Frames that are there.
    form : RecordingFormat
        How motion is read.

    Returns
    -------
    drives : list of Drive
        By scenario and frame number; classes are still "unseen".
    left_out : counter of str
        Frames that belong to no drive, by reason: with those of the drives, all of `world`.
    """
    drives: list[Drive] = []
    left_out: Counter[str] = Counter()
    for _, group in groupby(sorted(world), key=lambda key: (key.scenario, *world[key][1:])):
        frames = list(group)
        for part, is_after_reset in _between_resets(frames, world, form):
            result = _drive(part, world, form, is_after_reset=is_after_reset)
            if isinstance(result, Drive):
                drives.append(result)
                left_out[RESETS] += len(part) - (result.n_frames - result.n_missing)
            else:
                left_out[result] += len(part)
    return drives, +left_out


def with_class(drive: Drive, votes: Counter[str]) -> Drive:
    """The drive with the class of VRU that most of its labels have.

    Parameters
    ----------
    drive : Drive
        Which.
    votes : counter of str
        Labels in its frames, by class. A rider may be labelled beside the bicycle: where both are
        as frequent it is a bicycle's drive.
    """
    if not votes:
        return drive
    most = max(votes, key=lambda name: (votes[name], name == "bicycle"))
    return replace(drive, vru_class=most)


def _between_resets(
    frames: list[FrameKey], world: Mapping[FrameKey, World], form: RecordingFormat
) -> Iterator[tuple[list[FrameKey], bool]]:
    """Parts of a stretch, and whether one comes before."""
    distance, numbers = _distances(frames, world), _numbers(frames)
    _, vut_speed, vru_speed = world[frames[0]]
    fastest_m = (vut_speed + vru_speed) * np.diff(numbers) / form.frame_rate_hz
    is_cut = np.diff(distance) > fastest_m + form.jump_m
    is_cut |= np.diff(numbers) > form.max_gap_s * form.frame_rate_hz
    cuts = np.flatnonzero(is_cut) + 1
    bounds = [0, *cuts.tolist(), len(frames)]
    for first, last in pairwise(bounds):
        yield frames[first:last], first > 0


def _drive(
    frames: list[FrameKey],
    world: Mapping[FrameKey, World],
    form: RecordingFormat,
    *,
    is_after_reset: bool,
) -> Drive | str:
    """Drive of a part of a stretch, or why it is none."""
    distance, numbers = _distances(frames, world), _numbers(frames)
    _, vut_speed, vru_speed = world[frames[0]]
    impact = int(np.argmin(distance))
    first = _first_moving(distance, form) if is_after_reset else 0
    n_window = round(form.window_s * form.frame_rate_hz)
    is_near = (numbers >= numbers[impact] - n_window) & (numbers < numbers[impact])
    is_near[:first] = False
    if is_near.sum() + 1 < form.min_frames:
        never_nears = impact <= first and len(frames) >= form.min_frames
        return RESETS if is_after_reset else NO_APPROACH if never_nears else TOO_SHORT
    # Without the frame of the impact: there the bodies have pushed each other already.
    closing = closing_speed_mps(numbers[is_near] / form.frame_rate_hz, distance[is_near])
    if closing < form.min_closing_speed_mps:
        return RESETS if is_after_reset else NO_APPROACH
    slowest, fastest = abs(vut_speed - vru_speed), vut_speed + vru_speed
    tolerance = form.speed_tolerance
    if not (1.0 - tolerance) * slowest <= closing <= (1.0 + tolerance) * fastest:
        return MISFITS
    laid_out = np.full(numbers[impact] - numbers[first] + 1, np.nan)
    laid_out[numbers[first : impact + 1] - numbers[first]] = distance[first : impact + 1]
    return Drive(
        scenario=frames[0].scenario,
        vru_class=UNSEEN,
        vut_speed_mps=vut_speed,
        vru_speed_mps=vru_speed,
        closing_speed_mps=closing,
        first_number=int(numbers[first]),
        distance_m=laid_out,
    )


def _first_moving(distance_m: FloatArray, form: RecordingFormat) -> int:
    """Last frame in which the bodies stand at their starts."""
    has_moved = np.abs(distance_m - distance_m[0]) > form.standing_m
    return int(np.argmax(has_moved)) - 1 if has_moved.any() else len(distance_m) - 1


def _distances(frames: list[FrameKey], world: Mapping[FrameKey, World]) -> FloatArray:
    return np.array([world[key].distance_m for key in frames])


def _numbers(frames: list[FrameKey]) -> IntArray:
    return np.array([key.number for key in frames], dtype=np.int64)
