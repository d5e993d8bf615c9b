"""Emergency braking of the VUT, and its last moment.

How the VUT brakes, when braking is too late, and what it leaves of the speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray, IntArray
from geometry.errors import check_field
from geometry.tables import Table, read_table
from geometry.text_formats import load_data

from .encounters import (
    GRAZING_M,
    Cells,
    Encounter,
    Measures,
    find_first_touches,
    gaps_of_each,
)

TIME_TOLERANCE_S = 1.0e-9
"""Frames lie on multiples of 0.1 s, which binary numbers only approach."""


# ---------- how the VUT brakes
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
    track_memory_s : float
        A confirmed VRU stays known for so long without being detected; infinite: for
        ever, as the study reads it. [s]
    """

    deceleration_mps2: float
    latency_s: float
    n_confirmations: int
    frame_rate_hz: float
    build_up_s: float = 0.0
    track_memory_s: float = math.inf

    def __post_init__(self) -> None:
        check = partial(check_field, self, "aeb")
        check("frame_rate_hz", 0.0 < self.frame_rate_hz < math.inf, "a positive number")
        # None of them may be NaN.
        for field, (low, high) in _load_limits().items():
            check(
                field,
                low <= getattr(self, field) <= high,
                f"a number, {low:g} to {high:g}",
            )
        n_frames = self.n_confirmations
        is_whole = isinstance(n_frames, int) and not isinstance(n_frames, bool)
        check("n_confirmations", is_whole, "a whole number")
        frame_s = 1.0 / self.frame_rate_hz
        expected = f"seconds, at least {frame_s:g} (from one frame to the next), or inf"
        check(
            "track_memory_s",
            self.track_memory_s >= frame_s - TIME_TOLERANCE_S,
            expected,
        )


@cache
def load_aeb_rule() -> AebRule:
    """The study's rule, from ``data/aeb.toml``: a confirmed track is never lost."""
    return read_table(_load_tables()["study"], AebRule, "aeb.toml: study")


@cache
def load_track_memory_s() -> float:
    """Time for which a track lives without detections, in seconds.

    It holds where tracks are not the study's.
    """
    return float(_load_tables()["live_tracks"]["track_memory_s"])


@cache
def _load_limits() -> dict[str, tuple[float, float]]:
    """Least and most of the fields of a rule."""
    return read_table(
        _load_tables()["limits"], dict[str, tuple[float, float]], "aeb.toml: limits"
    )


def _load_tables() -> Table:
    return load_data(__package__, "aeb.toml")


def standstill_time_s(speed_mps: ArrayLike, *, rule: AebRule) -> FloatArray:
    """Time in seconds from the onset of braking to standstill.

    v / a + b / 2 with deceleration a and build-up b; within the build-up sqrt(2 v b /
    a).
    """
    full_s = np.asarray(speed_mps, dtype=np.float64) / rule.deceleration_mps2
    return np.where(
        full_s < 0.5 * rule.build_up_s,
        np.sqrt(2.0 * full_s * rule.build_up_s),
        full_s + 0.5 * rule.build_up_s,
    )


def braking_speed_mps(
    time_s: ArrayLike, *, speed_mps: ArrayLike, rule: AebRule
) -> FloatArray:
    """Speed left at a time since the onset of braking; 0 from standstill on."""
    rising, full = _phases(np.asarray(time_s, dtype=np.float64), rule)
    if rule.build_up_s == 0.0:
        braked_s = full
    else:
        braked_s = full + 0.5 * rising**2 / rule.build_up_s
    lost_mps = rule.deceleration_mps2 * braked_s
    return np.maximum(0.0, np.asarray(speed_mps, dtype=np.float64) - lost_mps)


def braking_distance_m(
    time_s: ArrayLike, *, speed_mps: ArrayLike, rule: AebRule
) -> FloatArray:
    """Distance covered since the onset of braking, in metres.

    After standstill it stays the same.

    With deceleration a and build-up b it is v t - a t^3 / (6 b) during the build-up
    and, r after its end, v t - a (b^2 / 6 + b r / 2 + r^2 / 2), until standstill.

    >>> from dataclasses import replace
    >>> rule = replace(load_aeb_rule(), deceleration_mps2=8.0)
    >>> float(braking_distance_m(10.0, speed_mps=20.0, rule=rule))
    25.0
    """
    speed = np.asarray(speed_mps, dtype=np.float64)
    time = np.minimum(
        np.asarray(time_s, dtype=np.float64), standstill_time_s(speed, rule=rule)
    )
    rising, full = _phases(time, rule)
    lost = 0.5 * full**2
    if rule.build_up_s > 0.0:
        lost = lost + rising**3 / (6.0 * rule.build_up_s) + 0.5 * rule.build_up_s * full
    return speed * time - rule.deceleration_mps2 * lost


def _phases(time_s: FloatArray, rule: AebRule) -> tuple[FloatArray, FloatArray]:
    """Seconds of braking while the deceleration rises, and of braking in full."""
    rising = np.minimum(time_s, rule.build_up_s)
    return rising, time_s - rising


# ---------- whether braking helps
# First cells of the search for the last brake time.
_ONSET_STEP_S = 0.25
_ONSET_TOLERANCE_S = 1.0e-5
# Encounters that are searched side by side; more take more memory and no less time.
_ENCOUNTERS_TOGETHER = 64
# A footprint moves 1.7 cm in it at 60 km/h.
_FINE_STEP_S = 0.001
# Each 32 times as fine: to a thirtieth of a microsecond.
_CLOSER_LOOKS = 3
_CLOSER = np.linspace(-1.0, 1.0, 65)
_FIRST_LOOKS = 32
_CONTACT_PARTS = 17
_CONTACT_ROUNDS = 2


def last_brake_time_s(encounter: Encounter, rule: AebRule) -> float:
    """Latest onset of braking such that it and every earlier one avoids the contact.

    It is at most 0, and minus infinity if even braking at the VUT's start does not
    help. An onset 10 microseconds later leads to contact. See
    :func:`last_brake_times_s`, which takes little longer for many encounters.
    """
    return float(last_brake_times_s([encounter], rule)[0])


def last_brake_times_s(encounters: Sequence[Encounter], rule: AebRule) -> FloatArray:
    """Latest onsets of braking such that they and every earlier one avoid the contact.

    Each is at most 0, and minus infinity if even braking at the VUT's start does not
    help.

    Swept, not solved: paths may bend, and contact may set in, vanish and set in again
    with later onsets. The sweep goes over onsets and times at once, coarsely where the
    bodies are far apart; see :func:`scenarios.encounters.find_first_touches`. An onset
    10 microseconds later leads to contact.

    Returns
    -------
    last_s : (n_encounters,) float
        Relative to the impact. [s]
    """
    last_s = np.full(len(encounters), -np.inf)
    # Who stands until the impact cannot brake before it.
    asked = [
        number
        for number, encounter in enumerate(encounters)
        if encounter.vut_motion.start_time_s < 0.0
    ]
    for begin in range(0, len(asked), _ENCOUNTERS_TOGETHER):
        block = asked[begin : begin + _ENCOUNTERS_TOGETHER]
        onsets = _Onsets([encounters[number] for number in block], rule)
        safe_s, _ = find_first_touches(
            onsets.first_cells(),
            onsets.measure,
            n_searches=len(block),
            tolerance_s=_ONSET_TOLERANCE_S,
        )
        is_avoided = safe_s > onsets.start_s
        last_s[block] = np.where(is_avoided, np.minimum(safe_s, 0.0), -np.inf)
    return last_s


class _Onsets:
    """Onsets of braking in some encounters, and times of contact after them.

    The first time of a cell is an onset, the second one a time; its search is the
    number of the encounter.
    """

    def __init__(self, encounters: Sequence[Encounter], rule: AebRule) -> None:
        """Collect the numbers of all encounters, (n_encounters,) each."""
        self._encounters = encounters
        self._rule = rule
        vuts = [encounter.vut_motion for encounter in encounters]
        vrus = [encounter.vru_motion for encounter in encounters]
        self.start_s = np.array([motion.start_time_s for motion in vuts])
        self._vru_start_s = np.array([motion.start_time_s for motion in vrus])
        self._speed_mps = np.array([motion.speed_mps for motion in vuts])
        self._standstill_s = standstill_time_s(self._speed_mps, rule=rule)
        self._vut_reach = np.array([one.vut_reach for one in encounters])
        vru_reach = np.array([one.vru_reach for one in encounters])
        vru_speed_mps = np.array([motion.speed_mps for motion in vrus])
        self._closing_mps = vru_reach * vru_speed_mps
        self._bend_mps2 = np.array(
            [one.max_gap_bend_mps2(rule.deceleration_mps2) for one in encounters]
        )
        self._near_m = np.array([one.near_m for one in encounters])
        self._small_m = np.array([one.small_m for one in encounters])

    def first_cells(self) -> Cells:
        """Onsets from the start to the impact, times up to standstill."""
        parts = []
        for number, start_s in enumerate(self.start_s.tolist()):
            n_onsets = int(-start_s / _ONSET_STEP_S) + 1
            step_s = -start_s / n_onsets
            onset_s = start_s + step_s * (np.arange(n_onsets) + 0.5)
            n_times = int(self._standstill_s[number] / step_s) + 2
            since_onset_s = step_s * np.arange(n_times)
            time_s = onset_s[:, None] + since_onset_s
            half_s = np.full(time_s.size, 0.5 * step_s)
            parts.append(
                Cells(
                    search=np.full(time_s.size, number),
                    first_s=onset_s.repeat(n_times),
                    second_s=time_s.ravel(),
                    half_first_s=half_s,
                    half_second_s=half_s,
                )
            )
        columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
        return Cells(*columns)

    def measure(self, cells: Cells) -> Measures:
        """Whether the bodies touch in cells, as :func:`find_first_touches` asks."""
        search = cells.search
        onset = cells.first_s
        half_onset = cells.half_first_s
        half_time = cells.half_second_s
        full_speed = self._speed_mps[search]
        standstill = self._standstill_s[search]
        vut_reach = self._vut_reach[search]
        times = np.stack([cells.second_s - half_time, cells.second_s + half_time])
        since_onset = times - onset
        # (4, 2, n).
        gaps = self._gaps_m(search, times, onset, full_speed)
        separation = gaps.max(axis=0)
        # How long it has braked within the cell, at least and at most.
        least_s = since_onset[0] - half_onset
        most_s = since_onset[1] + half_onset
        braking_s = np.maximum(np.stack([least_s, most_s]), 0.0)
        fastest, slowest = braking_speed_mps(
            braking_s, speed_mps=full_speed, rule=self._rule
        )
        speed = vut_reach * fastest + self._closing_mps[search]
        mean = 0.5 * (separation[0] + separation[1])
        # Between its ends a gap sags no deeper than a parabola, while neither body sets
        # off.
        is_near = separation[0] <= self._near_m[search]
        is_smooth = is_near & (speed * half_time <= self._small_m[search])
        for starts_s in (self.start_s, self._vru_start_s):
            set_off_s = starts_s[search]
            is_smooth &= (times[0] >= set_off_s) | (times[1] <= set_off_s)
        bend = self._bend_mps2[search]
        sagging = gaps.min(axis=1).max(axis=0) - 0.5 * bend * half_time**2
        lowest = mean - speed * half_time
        lowest = np.where(is_smooth, np.maximum(lowest, sagging), lowest)
        # A later onset has let the VUT keep the speed that an earlier one has taken
        # since.
        onset_moves = vut_reach * (full_speed - slowest) * half_onset
        may_touch = (lowest <= onset_moves) & (least_s <= standstill)
        counts = (since_onset >= 0.0) & (since_onset <= standstill + TIME_TOLERANCE_S)
        touches = ((separation <= 0.0) & counts).any(axis=0)
        touches |= may_touch & (onset_moves + speed * half_time <= GRAZING_M)
        by_onset = onset_moves >= mean - lowest
        return Measures(
            may_touch=may_touch, touches=touches, is_cut_along_first=by_onset
        )

    def _gaps_m(
        self,
        search: IntArray,
        times_s: FloatArray,
        onset_s: FloatArray,
        speed_mps: FloatArray,
    ) -> FloatArray:
        """Gaps between the bodies at two times of each cell, (4, 2, n)."""
        braking_s = np.maximum(times_s - onset_s, 0.0)
        braked_m = braking_distance_m(braking_s, speed_mps=speed_mps, rule=self._rule)
        # The VUT drives on up to the onset, and brakes from there.
        driving_s = np.minimum(onset_s, times_s)
        return gaps_of_each(self._encounters, search, driving_s, braked_m, times_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contacts:
    """First contacts of the footprints for onsets of braking.

    Each array has the onsets' shape.

    Attributes
    ----------
    time_s : (...,) float
        Time of contact relative to the impact without braking; infinite where
        the footprints never touch. [s]
    speed_mps : (...,) float
        Speed of the VUT then; 0 where they never touch. [m/s]
    """

    time_s: FloatArray
    speed_mps: FloatArray


def find_contacts(encounter: Encounter, onset_s: ArrayLike, rule: AebRule) -> Contacts:
    """First contacts of the footprints if the VUT brakes from onsets on.

    An onset at or after the impact, or none, leaves the VUT its speed.

    Looks every millisecond where the bodies are near enough to touch soon, and closer
    wherever they come nearest in between: no shortcut of :func:`last_brake_time_s` is
    used. The first look at which they touch is narrowed down to 4 microseconds.
    """
    onset = np.asarray(onset_s, dtype=np.float64)
    time_s = np.zeros(onset.shape)
    speed = np.full(onset.shape, encounter.vut_motion.speed_mps)
    is_asked = onset < 0.0
    asked = onset[is_asked]
    before_s, look_s = _contact_looks(encounter, asked, rule)
    # Between the look before and that at the contact, narrowed down.
    row = np.flatnonzero(np.isfinite(look_s))
    share = np.linspace(0.0, 1.0, _CONTACT_PARTS)
    for _ in range(_CONTACT_ROUNDS):
        times = before_s[row, None] + share * (look_s[row] - before_s[row])[:, None]
        touches = _separation_m(encounter, asked[row, None], times, rule) <= 0.0
        touches[:, -1] = True
        first = np.maximum(touches.argmax(axis=1), 1)
        every = np.arange(len(row))
        before_s[row], look_s[row] = times[every, first - 1], times[every, first]
    sets_off = asked >= encounter.vut_motion.start_time_s
    left = braking_speed_mps(
        look_s, speed_mps=encounter.vut_motion.speed_mps, rule=rule
    )
    speed[is_asked] = np.where(np.isfinite(look_s) & sets_off, left, 0.0)
    with np.errstate(invalid="ignore"):
        time_s[is_asked] = np.where(np.isfinite(look_s), asked + look_s, np.inf)
    return Contacts(time_s=time_s, speed_mps=speed)


def _contact_looks(
    encounter: Encounter, onset_s: FloatArray, rule: AebRule
) -> tuple[FloatArray, FloatArray]:
    """Times since the onset just before and at a contact, (n,) each.

    Onsets are before the impact; infinite where there is no contact.
    """
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    closing_mps = (
        encounter.vut_reach * vut.speed_mps + encounter.vru_reach * vru.speed_mps
    )
    # Times since the onset at which to look, until the VUT stands.
    standstill_s = float(standstill_time_s(vut.speed_mps, rule=rule))
    looks = np.linspace(0.0, standstill_s, int(standstill_s / _FINE_STEP_S) + 2)
    step_s = _FINE_STEP_S
    # A look in so many first: what is farther apart there cannot touch before the next
    # one of them.
    apart_m = _separation_m(encounter, onset_s[:, None], looks[::_FIRST_LOOKS], rule)
    is_near = apart_m <= closing_mps * step_s * (_FIRST_LOOKS + 1)
    row, look = np.nonzero(np.repeat(is_near, _FIRST_LOOKS, axis=1)[:, : len(looks)])
    separation = np.full((len(onset_s), len(looks)), np.inf)
    separation[row, look] = _separation_m(encounter, onset_s[row], looks[look], rule)
    before_s, at_s = np.full((2, len(onset_s)), np.inf)
    row, times = np.arange(len(onset_s)), np.broadcast_to(looks, separation.shape)

    def note() -> None:
        touches = separation <= 0.0
        hit = np.flatnonzero(touches.any(axis=1))
        hit = hit[
            np.argsort(times[hit, touches[hit].argmax(axis=1)], kind="stable")[::-1]
        ]
        first = touches[hit].argmax(axis=1)
        at_s[row[hit]] = times[hit, first]
        before_s[row[hit]] = times[hit, np.maximum(first - 1, 0)]

    for _ in range(_CLOSER_LOOKS):
        note()
        around = np.pad(separation, ((0, 0), (1, 1)), constant_values=np.inf)
        is_nearest = (separation < around[:, :-2]) & (separation <= around[:, 2:])
        is_nearest &= (separation <= closing_mps * step_s) & ~np.isfinite(at_s)[
            row, None
        ]
        row = row[np.nonzero(is_nearest)[0]]
        nearest_s = times[is_nearest]
        if not len(row):
            return before_s, at_s
        times = np.clip(nearest_s[:, None] + step_s * _CLOSER, 0.0, standstill_s)
        step_s *= _CLOSER[1] - _CLOSER[0]
        separation = _separation_m(encounter, onset_s[row, None], times, rule)
    note()
    return before_s, at_s


def _separation_m(
    encounter: Encounter, onset_s: ArrayLike, since_onset_s: FloatArray, rule: AebRule
) -> FloatArray:
    """Separation after times since onsets of braking; both broadcast."""
    vut = encounter.vut_motion
    onset = np.asarray(onset_s, dtype=np.float64)
    speed = np.where(onset >= vut.start_time_s, vut.speed_mps, 0.0)
    braked_m = braking_distance_m(since_onset_s, speed_mps=speed, rule=rule)
    vru_m = encounter.vru_motion.distance_m(onset + since_onset_s)
    return encounter.separation_m(vut.distance_m(onset) + braked_m, vru_m)
