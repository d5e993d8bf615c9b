"""Two bodies that move towards one another.

How far apart they are, and when they first touch.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from math import dist, isfinite
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from geometry.actors import Actor, footprint_sizes
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted, check_field
from geometry.footprints import FootprintSizes, gaps_between

from .courses import follow_way
from .paths import CoursePath, Motion

# Contacts later than this are not looked for.
_LONGEST_S = 600.0
_FIRST_STEP_S = 0.25
_STEP_GROWTH = 0.05
_CONTACT_TOLERANCE_S = 1.0e-7
# Nearer is contact: cells in which the bodies move less are not divided.
GRAZING_M = 1.0e-7
# Of a cell along one time; many where there is one time only, so that few looks do.
_N_PARTS = 8
_N_PARTS_OF_ONE_TIME = 64
# Cells of one search to divide in one go.
_N_TOGETHER = 1024


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class Encounter:
    """Two bodies on collision course: without braking they first touch at time 0.

    Attributes
    ----------
    vut, vru : Actor
        The bodies; only their footprints count here.
    vut_motion, vru_motion : Motion
        Without braking; the VUT is up to speed when it sets off. Paths are those of the
        middle of the footprint.
    """

    vut: Actor
    vut_motion: Motion
    vru: Actor
    vru_motion: Motion
    _sizes: FootprintSizes = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check = partial(check_field, vut := self.vut_motion, "encounter.vut_motion")
        is_steady = vut.acceleration_distance_m == 0.0
        check(
            "acceleration_distance_m",
            is_steady,
            "0: the VUT is up to speed when it sets off",
        )
        check("speed_mps", vut.speed_mps != 0.0, "> 0: the VUT drives")
        object.__setattr__(self, "_sizes", footprint_sizes(self.vut, self.vru))

    def separation_m(
        self, vut_distance_m: FloatArray, vru_distance_m: FloatArray
    ) -> FloatArray:
        """Separation of the footprints after distances along their paths.

        The distances broadcast.

        Zero or less means that they touch; see
        :func:`geometry.footprints.footprint_separation`.
        """
        separation: FloatArray = self.gaps_m(vut_distance_m, vru_distance_m).max(axis=0)
        return separation

    def gaps_m(
        self, vut_distance_m: FloatArray, vru_distance_m: FloatArray
    ) -> FloatArray:
        """Gaps along the four normals, (4, ...).

        See :func:`geometry.footprints.gaps_between`.
        """
        vut_position, vut_yaw = self.vut_motion.path.at(vut_distance_m)
        vru_position, vru_yaw = self.vru_motion.path.at(vru_distance_m)
        return gaps_between(
            vru_position - vut_position, vut_yaw, vru_yaw, sizes=self._sizes
        )

    @property
    def vut_reach(self) -> float:
        """How far any point of the VUT may move while it drives a metre."""
        return 1.0 + self.vut_motion.path.max_turn_rad_per_m * _half_diagonal_m(
            self.vut
        )

    @property
    def vru_reach(self) -> float:
        """How far any point of the VRU may move while it moves on by a metre."""
        return 1.0 + self.vru_motion.path.max_turn_rad_per_m * _half_diagonal_m(
            self.vru
        )

    @property
    def near_m(self) -> float:
        """Separation up to which :meth:`max_gap_bend_mps2` holds, in metres."""
        return _half_diagonal_m(self.vut) + _half_diagonal_m(self.vru)

    @property
    def small_m(self) -> float:
        """Largest move in which neither body gets past the other, in metres."""
        return 0.25 * sum(
            min(body.length_m, body.width_m) for body in (self.vut, self.vru)
        )

    def max_gap_bend_mps2(self, deceleration_mps2: float) -> float:
        """Bound of the second time derivative of the gaps, in m/s^2.

        It holds for :meth:`gaps_m` while the bodies are near.

        `deceleration_mps2` is the most that the VUT brakes with.

        A gap is n . d - r: d from middle to middle, the normal n turns with its body,
        the reach r of both bodies along n depends on the angle between them. Near means
        that d is at most three times the half diagonals of both together, and r once.
        """
        bend = speed = turning = turning_change = 0.0
        for motion, acceleration_mps2 in (
            (self.vut_motion, deceleration_mps2),
            (self.vru_motion, self.vru_motion.acceleration_mps2),
        ):
            turn = motion.path.max_turn_rad_per_m
            v = motion.speed_mps
            bend += acceleration_mps2 + 3.0 * turn * v**2
            speed += v
            turning += turn * v
            change = motion.path.max_turn_change_rad_per_m2
            turning_change += change * v**2 + turn * acceleration_mps2
        return (
            bend
            + 2.0 * turning * speed
            + (turning_change + turning**2) * 4.0 * self.near_m
        )


def gaps_of_each(
    encounters: Sequence[Encounter],
    which: IntArray,
    driving_s: FloatArray,
    braked_m: FloatArray,
    times_s: FloatArray,
) -> FloatArray:
    """Gaps of several encounters side by side, see :meth:`Encounter.gaps_m`.

    Only the paths are asked one by one: numpy takes hardly longer for the gaps of many
    than for those of one.

    Parameters
    ----------
    encounters : sequence of Encounter
        What is looked at.
    which : (n,) int
        Encounter of each column, ascending.
    driving_s : (k, n) float
        Times up to which the VUT drives without braking. [s]
    braked_m : (k, n) float
        How far it drives on from there. [m]
    times_s : (k, n) float
        Times at which the VRU is looked at. [s]

    Returns
    -------
    gaps_m : (4, k, n) float
    """
    offset_m = np.empty((*times_s.shape, 2))
    vut_yaw_deg = np.empty(times_s.shape)
    vru_yaw_deg = np.empty(times_s.shape)
    ends = np.searchsorted(which, np.arange(len(encounters) + 1)).tolist()
    for encounter, (begin, end) in zip(encounters, pairwise(ends), strict=True):
        if begin == end:
            continue
        part = slice(begin, end)
        vut = encounter.vut_motion
        vru = encounter.vru_motion
        vut_m = vut.distance_m(driving_s[:, part]) + braked_m[:, part]
        vut_position, vut_yaw_deg[:, part] = vut.path.at(vut_m)
        vru_m = vru.distance_m(times_s[:, part])
        vru_position, vru_yaw_deg[:, part] = vru.path.at(vru_m)
        offset_m[:, part] = vru_position - vut_position
    vuts = [encounter.vut for encounter in encounters]
    vrus = [encounter.vru for encounter in encounters]
    sizes = FootprintSizes(
        length_a_m=np.array([body.length_m for body in vuts])[which],
        width_a_m=np.array([body.width_m for body in vuts])[which],
        length_b_m=np.array([body.length_m for body in vrus])[which],
        width_b_m=np.array([body.width_m for body in vrus])[which],
    )
    return gaps_between(offset_m, vut_yaw_deg, vru_yaw_deg, sizes=sizes)


def first_contact_s(encounter: Encounter) -> float:
    """Time at which the bodies first touch without braking, in s.

    It is exact to 0.1 us. Infinite: they do not touch within ten minutes.
    """
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    speed = encounter.vut_reach * vut.speed_mps + encounter.vru_reach * vru.speed_mps

    def measure(cells: Cells) -> Measures:
        time = cells.first_s
        moves = speed * cells.half_first_s
        separation = encounter.separation_m(vut.distance_m(time), vru.distance_m(time))
        may_touch = separation <= moves
        touches = (separation <= 0.0) | (may_touch & (moves <= GRAZING_M))
        by_first = np.ones(len(time), dtype=bool)
        return Measures(
            may_touch=may_touch, touches=touches, is_cut_along_first=by_first
        )

    # The further in the future, the longer the looks: bodies that part are far apart by
    # then.
    n_cells = (
        int(
            np.log1p(_LONGEST_S * _STEP_GROWTH / _FIRST_STEP_S) / np.log1p(_STEP_GROWTH)
        )
        + 1
    )
    after_s = np.expm1(np.arange(n_cells + 1) * np.log1p(_STEP_GROWTH))
    edges = min(vut.start_time_s, vru.start_time_s) + after_s * (
        _FIRST_STEP_S / _STEP_GROWTH
    )
    # One time alone: the cells are flat in the second one.
    middle: FloatArray = 0.5 * (edges[1:] + edges[:-1])
    half = 0.5 * np.diff(edges)
    nothing = np.zeros(n_cells)
    cells = Cells(
        search=np.zeros(n_cells, dtype=np.int64),
        first_s=middle,
        second_s=nothing,
        half_first_s=half,
        half_second_s=nothing,
    )
    _, touch_s = find_first_touches(
        cells,
        measure,
        n_searches=1,
        tolerance_s=_CONTACT_TOLERANCE_S,
        n_parts=_N_PARTS_OF_ONE_TIME,
    )
    return float(touch_s[0])


class Cells(NamedTuple):
    """Rectangles in the plane of two times, each of one of several searches.

    The middle of each and half its size, (n,) each. `search` is the number of the
    search that it belongs to, ascending.
    """

    search: IntArray
    first_s: FloatArray
    second_s: FloatArray
    half_first_s: FloatArray
    half_second_s: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measures:
    """What is known of cells, (n,) each.

    Attributes
    ----------
    may_touch : (n,) bool
        False: there is no contact anywhere in the cell.
    touches : (n,) bool
        True: there is one at the middle of its first time.
    is_cut_along_first : (n,) bool
        Along which time to divide it: where more is unknown.
    """

    may_touch: BoolArray
    touches: BoolArray
    is_cut_along_first: BoolArray


def find_first_touches(
    cells: Cells,
    measure: Callable[[Cells], Measures],
    *,
    n_searches: int,
    tolerance_s: float,
    n_parts: int = _N_PARTS,
) -> tuple[FloatArray, FloatArray]:
    """Smallest first time at which there is a contact, between two limits.

    There is no contact before the first limit and one at the second, which are at most
    `tolerance_s` apart; both are infinite if there is none. `cells` cover everything to
    be looked at, and `measure` must say of all small ones, by ``GRAZING_M``, that they
    do or do not touch: else the search might not end.

    Branch and bound: a cell whose bodies are further apart than they can move within it
    holds no contact, so nothing is overlooked between two looks. The others are
    divided, the earliest first. Searches do not depend on one another: they go on side
    by side because `measure` takes hardly longer for many cells than for a few.

    Returns
    -------
    safe_s, touch_s : (n_searches,) float
        The limits of each search.
    """
    touch_s = np.full(n_searches, np.inf)
    safe_s = np.full(n_searches, np.inf)
    pool = _look(np.stack(cells[1:]), cells.search, measure, touch_s)
    while len(pool.search) > 0:
        earliest_s = np.full(n_searches, np.inf)
        np.minimum.at(earliest_s, pool.search, pool.begin_s)
        goes_on = earliest_s < touch_s - tolerance_s
        is_pending = goes_on[pool.search]
        if not is_pending.all():
            ended = pool.search[~is_pending]
            safe_s[ended] = earliest_s[ended]
            pool = pool.take(is_pending)
            continue
        # Only the earliest cells are divided; the others wait.
        waiting = None
        if np.bincount(pool.search).max() > _N_TOGETHER:
            is_early = _are_earliest(pool)
            waiting = pool.take(~is_early)
            pool = pool.take(is_early)
        search = pool.search.repeat(n_parts)
        pool = _look(_divide(pool, n_parts), search, measure, touch_s)
        if waiting is not None:
            waiting = waiting.take(waiting.begin_s < touch_s[waiting.search])
            pool = pool.joined(waiting)
    # A search that ran out of cells has no contact, or its limits are the same.
    return np.minimum(safe_s, touch_s), touch_s


class _Pool(NamedTuple):
    """Cells that may hold an earlier contact than is known, in the order of searches.

    Attributes
    ----------
    search : (n,) int
        Search of each, ascending.
    rows : (5, n) float
        Middles along both times, half sizes along both, and 1 where a cell is cut
        along the first time.
    """

    search: IntArray
    rows: FloatArray

    @property
    def begin_s(self) -> FloatArray:
        """First times at which the cells begin, (n,)."""
        begin_s: FloatArray = self.rows[0] - self.rows[2]
        return begin_s

    def take(self, is_taken: BoolArray) -> "_Pool":
        """Some of the cells."""
        return _Pool(self.search[is_taken], self.rows[:, is_taken])

    def joined(self, other: "_Pool") -> "_Pool":
        """These cells and others, by their searches."""
        search = np.concatenate([self.search, other.search])
        order = np.argsort(search, kind="stable")
        rows = np.concatenate([self.rows, other.rows], axis=1)
        return _Pool(search[order], rows[:, order])


def _are_earliest(pool: _Pool) -> BoolArray:
    """Which cells are among the earliest of their search, at most ``_N_TOGETHER``."""
    order = np.lexsort((pool.begin_s, pool.search))
    first = np.searchsorted(pool.search, pool.search)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - first
    return rank < _N_TOGETHER


def _divide(pool: _Pool, n_parts: int) -> FloatArray:
    """Cut each cell into equal parts: middles and half sizes, (4, n * n_parts)."""
    middle = pool.rows[:2]
    half = pool.rows[2:4]
    by_first = pool.rows[4] > 0.0
    is_cut = np.stack([by_first, ~by_first])
    at = (2.0 * np.arange(n_parts) + 1.0) / n_parts - 1.0
    middles = middle[:, :, None] + np.where(is_cut, half, 0.0)[:, :, None] * at
    halves = np.where(is_cut, half / n_parts, half).repeat(n_parts, axis=1)
    return np.concatenate([middles.reshape(2, -1), halves])


def _look(
    rows: FloatArray,
    search: IntArray,
    measure: Callable[[Cells], Measures],
    touch_s: FloatArray,
) -> _Pool:
    """Cells that may hold an earlier contact; lowers `touch_s`, (n_searches,).

    `rows` (4, n) are middles and half sizes.
    """
    seen = measure(Cells(search, *rows))
    middle = rows[0]
    if seen.touches.any():
        np.minimum.at(touch_s, search[seen.touches], middle[seen.touches])
    kept = seen.may_touch & (middle - rows[2] < touch_s[search])
    every = _Pool(search, np.concatenate([rows, seen.is_cut_along_first[None, :]]))
    return every.take(kept)


def _half_diagonal_m(body: Actor) -> float:
    """Half the diagonal of a body's footprint, in metres."""
    return 0.5 * float(np.hypot(body.length_m, body.width_m))


# ---------- recorded encounters, replayed on the ways that were taken
_LONGEST_WAY_M = 1000.0
# Of a contact before the impact: more is another impact, somewhere else.
_MAX_EARLY_S = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedWay:
    """A way as it was taken, and when.

    Attributes
    ----------
    points_m : tuple of (float, float)
        Points of the middle of the body, which goes straight on before and
        after them. World frame. [m]
    yaw_deg : float
        Direction in which it goes straight on. [deg]
    end_s : float
        Time at which the body is at the last point; the impact is at 0. [s]
    """

    points_m: Annotated[tuple[tuple[float, float], ...], Meta(min_length=2)]
    yaw_deg: float
    end_s: Annotated[float, Meta(ge=-60.0, le=60.0)]

    def __post_init__(self) -> None:
        length_m = sum(dist(*ends) for ends in pairwise(self.points_m))
        if not 0.0 < length_m <= _LONGEST_WAY_M or not isfinite(self.yaw_deg):
            got = Unquoted(f"{length_m:g} m towards {self.yaw_deg:g} degrees")
            raise InputError(
                "", got, f"a way of at most {_LONGEST_WAY_M:g} m with a direction"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedEncounter:
    """Two recorded ways that lead to an impact at time 0 if nobody reacts.

    Attributes
    ----------
    vut, vru : RecordedWay
        The two ways.
    known_s : float
        Both are recorded for so long before the impact. [s]
    """

    vut: RecordedWay
    vru: RecordedWay
    known_s: float

    def as_recorded(
        self, *, vut: Actor, vut_speed_mps: float, vru: Actor, vru_speed_mps: float
    ) -> Encounter:
        """The bodies on their ways at constant speeds.

        They are there at the times that the ways say.
        """
        return Encounter(
            vut=vut,
            vut_motion=_motion(self.vut, vut_speed_mps, self.known_s),
            vru=vru,
            vru_motion=_motion(self.vru, vru_speed_mps, self.known_s),
        )

    def encounter(
        self, *, vut: Actor, vut_speed_mps: float, vru: Actor, vru_speed_mps: float
    ) -> Encounter | None:
        """The same with the impact at time 0; None: they do not touch about then."""
        found = self.as_recorded(
            vut=vut, vut_speed_mps=vut_speed_mps, vru=vru, vru_speed_mps=vru_speed_mps
        )
        early_s = first_contact_s(found)
        if not abs(early_s) <= _MAX_EARLY_S:
            return None

        def later(motion: Motion) -> Motion:
            return replace(motion, start_time_s=motion.start_time_s - early_s)

        vut_motion = later(found.vut_motion)
        vru_motion = later(found.vru_motion)
        return replace(found, vut_motion=vut_motion, vru_motion=vru_motion)


def _motion(way: RecordedWay, speed_mps: float, known_s: float) -> Motion:
    """Motion along a recorded way at a constant speed."""
    course = follow_way(way.points_m, way.yaw_deg)
    if speed_mps > 0.0:
        start_m = course.station_of(way.points_m[0])
    else:
        start_m = 0.0
    if speed_mps > 0.0:
        start_s = way.end_s + start_m / speed_mps
    else:
        start_s = -known_s
    path = CoursePath(course=course, start_m=start_m)
    return Motion(path=path, speed_mps=speed_mps, start_time_s=start_s)
