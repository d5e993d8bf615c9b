"""Runs: cases, driven from an approach at a speed.

A run lies on a grid of frames that ends at the impact.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from shapely import LineString, Point

from geometry.actors import Actor, MovingActor, PlacedActor
from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, freeze
from geometry.errors import InputError, Unquoted, check_one_of
from geometry.junction import Junction, build_junction, mirrored
from geometry.phrases import Phrase
from geometry.scene import Scene
from geometry.terrain import Terrain, set_down, terrain_of
from geometry.weather import load_weathers

from .aeb import AebRule, last_brake_times_s
from .cases import Case, at_vru_speed, worded_for
from .confirmation import confirmation_mask, held_frames, is_in_time
from .encounters import Encounter, RecordedEncounter
from .obstructions import make_room
from .paths import MPS_PER_KMH
from .positions import (
    AT_ZERO,
    Position,
    is_bound,
    positions_of,
    read_position,
    spread_speeds,
)
from .protocol import stage_by_protocol
from .published import find_placement, stage_published
from .staging import (
    CannotCarryError,
    NoRoadError,
    Staging,
    is_vehicle,
    load_way_rules,
    mirror_staging,
)

WEATHERS = tuple(load_weathers())
# Of a frame.
_GRID_TOLERANCE = 1.0e-6
# Detections of so many sets of poses are looked at in one go.
_ROWS_TOGETHER = 64


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class Run:
    """One drive.

    Attributes
    ----------
    id : str
        "case/approach/speed", by day; else "case/approach/speed/weather". At other
        positions than 0 the position stands behind the approach:
        "case/approach-15/speed". Where the case has several speeds of whoever is
        met, both: "case/approach/30x50".
    case : Case
        What is driven, with the speed of whoever is met in this run.
    approach : str
        The arm from which the VUT comes.
    position : str
        Where along its way, see :class:`scenarios.positions.Position`: "0", "-15",
        "+0", "+15".
    weather : str
        One of ``WEATHERS``.
    vut_speed_kmh : float
        Constant. [km/h]
    encounter : Encounter
        Bodies and motions without braking.
    time_s : (n_frames,) float
        Times of the frames, ascending, relative to the impact; the last one is 0, or at
        most one frame before. [s]
    vut_position_m, vru_position_m : (n_frames, 2) float
        Middles of the footprints. World frame. [m]
    vut_yaw_deg, vru_yaw_deg : (n_frames,) float
        Headings. [deg]
    vru_shape : (n_frames,) int
        Which shape of its gait the VRU has.
    obstruction : tuple of PlacedActor
        Parked bodies of this run.
    last_brake_time_s : float
        Latest onset of braking that avoids. [s]
    traffic : tuple of MovingActor
        Vehicles that drive by, frame by frame; nobody touches VUT or VRU before the
        impact.
    terrain : Terrain or None
        The ground on which all of them stand; None: the plane z = 0.
    """

    id: str
    case: Case
    approach: str
    weather: str
    vut_speed_kmh: float
    encounter: Encounter
    time_s: FloatArray
    vut_position_m: FloatArray
    vut_yaw_deg: FloatArray
    vru_position_m: FloatArray
    vru_yaw_deg: FloatArray
    vru_shape: IntArray
    obstruction: tuple[PlacedActor, ...]
    last_brake_time_s: float
    position: str = AT_ZERO.name
    traffic: tuple[MovingActor, ...] = ()
    terrain: Terrain | None = None

    def __post_init__(self) -> None:
        for body in self.traffic:
            if len(body.yaw_deg) != len(self.time_s):
                got = Unquoted(f"{len(body.yaw_deg)} frames")
                expected = f"{len(self.time_s)}, as many as the run has"
                raise InputError(f"run {self.id}: traffic", got, expected)

    def __repr__(self) -> str:
        return f"Run({self.id!r}, {len(self.time_s)} frames)"

    @property
    def road_user(self) -> str:
        """Group of the road user that is met: on foot, bicycle, motorcycle or car."""
        return self.case.road_user


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class FrameAxis:
    """All frames of some runs, laid end to end.

    They are the second axis of every detection array.

    Attributes
    ----------
    run_ids, cases, approaches, weathers : tuple of str
        Per run.
    positions : tuple of str
        Per run, see :attr:`Run.position`; nothing given stands for "0" in every run.
    vut_speed_kmh, weight, last_brake_time_s : (n_runs,) float
        Per run; weights sum to 1. [km/h], share, [s]
    run_start : (n_runs + 1,) int
        Frames of run r are run_start[r] .. run_start[r + 1] - 1.
    time_s : (n_frames,) float
        Relative to the impact. [s]
    """

    run_ids: tuple[str, ...]
    cases: tuple[str, ...]
    approaches: tuple[str, ...]
    weathers: tuple[str, ...]
    vut_speed_kmh: FloatArray
    weight: FloatArray
    last_brake_time_s: FloatArray
    run_start: IntArray
    time_s: FloatArray
    positions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n_runs = len(self.run_ids)
        object.__setattr__(
            self, "positions", self.positions or (AT_ZERO.name,) * n_runs
        )
        if len(self.positions) != n_runs:
            got = Unquoted(f"{len(self.positions)} positions")
            raise InputError("positions", got, f"one per run, {n_runs}")
        for name in set(self.positions):
            if read_position(name, "positions").name != name:
                raise InputError(
                    "positions", name, "a position by its name, such as 0, -15, +15"
                )
        for field in ("vut_speed_kmh", "weight"):
            object.__setattr__(
                self, field, float_array(getattr(self, field), (n_runs,), field)
            )
        if (self.weight < 0.0).any() or not np.isclose(self.weight.sum(), 1.0):
            raise InputError(
                "weight", self.weight.tolist(), "shares >= 0 that sum to 1"
            )
        # May be -inf.
        last_brake = np.array(self.last_brake_time_s, dtype=np.float64)
        if last_brake.shape != (n_runs,) or np.isnan(last_brake).any():
            raise InputError(
                "last_brake_time_s", last_brake.tolist(), "one time per run"
            )
        object.__setattr__(self, "last_brake_time_s", freeze(last_brake))
        run_start = np.array(self.run_start, dtype=np.int64)
        object.__setattr__(self, "run_start", freeze(run_start))
        object.__setattr__(self, "time_s", float_array(self.time_s, (-1,), "time_s"))
        if (
            run_start.shape != (n_runs + 1,)
            or run_start[0] != 0
            or (np.diff(run_start) < 1).any()
        ):
            raise InputError(
                "run_start", run_start.tolist(), "0 and ascending, one more than runs"
            )
        if run_start[-1] != len(self.time_s):
            raise InputError(
                "time_s", Unquoted(f"{len(self.time_s)} frames"), str(run_start[-1])
            )
        falls = np.diff(self.time_s) <= 0.0
        # From one run to the next.
        falls[run_start[1:-1] - 1] = False
        if falls.any():
            late, early = self.time_s[np.argmax(falls) :][:2].tolist()
            got = Unquoted(f"{late} before {early}")
            raise InputError("time_s", got, "times that ascend within a run")

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.run_ids)

    @property
    def n_frames(self) -> int:
        """Number of frames of all runs."""
        return len(self.time_s)

    def frames_of(self, run_index: int) -> slice:
        """Frames of a run, as a slice."""
        return slice(int(self.run_start[run_index]), int(self.run_start[run_index + 1]))


def frames_at(encounter: Encounter, time_s: FloatArray) -> dict[str, Any]:
    """Fields of a :class:`Run` that its frames decide, at times (n_frames,) in s."""
    vut = encounter.vut_motion
    vru = encounter.vru_motion
    vut_position_m, vut_yaw_deg = vut.path.at(vut.distance_m(time_s))
    vru_distance_m = vru.distance_m(time_s)
    vru_position_m, vru_yaw_deg = vru.path.at(vru_distance_m)
    return {
        "time_s": freeze(time_s),
        "vut_position_m": freeze(vut_position_m),
        "vut_yaw_deg": freeze(vut_yaw_deg),
        "vru_position_m": freeze(vru_position_m),
        "vru_yaw_deg": freeze(vru_yaw_deg),
        "vru_shape": freeze(encounter.vru.shape_index(vru_distance_m)),
    }


def build_frame_axis(runs: Sequence[Run], weight: FloatArray) -> FrameAxis:
    """Lay the frames of runs end to end, with weights (n_runs,) that sum to 1.

    Raises
    ------
    InputError
        There is no run, or the weights do not fit.
    """
    if not runs:
        raise InputError("runs", Unquoted("none"), "at least one run")
    return FrameAxis(
        run_ids=tuple(run.id for run in runs),
        cases=tuple(run.case.name for run in runs),
        approaches=tuple(run.approach for run in runs),
        positions=tuple(run.position for run in runs),
        weathers=tuple(run.weather for run in runs),
        vut_speed_kmh=np.array([run.vut_speed_kmh for run in runs]),
        weight=weight,
        last_brake_time_s=np.array([run.last_brake_time_s for run in runs]),
        run_start=np.concatenate([[0], np.cumsum([len(run.time_s) for run in runs])]),
        time_s=np.concatenate([run.time_s for run in runs]),
    )


def live_confirmation_times_s(
    detected: BoolArray, axis: FrameAxis, *, rule: AebRule
) -> FloatArray:
    """Time at which each run's live track was confirmed, in seconds.

    It is the track that is alive at the run's last moment.

    (..., n_frames) detections -> (..., n_runs); infinite where none is: the run is not
    avoided. The last moment is the last brake time less the rule's latency. No track
    reaches from one run into the next; see
    :func:`scenarios.confirmation.live_confirmation_time_s`.
    """
    last_brake_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    counts = np.asarray(is_in_time(axis.time_s, last_brake_s, latency_s=rule.latency_s))
    is_whole = _is_within_run(axis, rule.n_confirmations)
    rows = detected.reshape(-1, axis.n_frames)
    found = np.empty((len(rows), axis.n_runs))
    for start in range(0, len(rows), _ROWS_TOGETHER):
        # Messages that come after the last moment do not count.
        block = rows[start : start + _ROWS_TOGETHER] & counts
        live = confirmation_mask(block, n_confirmations=rule.n_confirmations) & is_whole
        live &= _held(block, axis, rule)
        found[start : start + _ROWS_TOGETHER] = _earliest(
            np.where(live, axis.time_s, np.inf), axis
        )
    return found.reshape(*detected.shape[:-1], axis.n_runs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Onsets:
    """From messages to braking, (n_runs,) each.

    Attributes
    ----------
    confirmation_s : (n_runs,) float
        When the track for which the VUT brakes was confirmed. Where no track is alive
        at the last moment: when one is confirmed too late, or else the first that was
        lost again; infinite if none is ever confirmed. [s]
    onset_s : (n_runs,) float
        When the VUT knows of that confirmation, so that braking may set in; infinite if
        no track is confirmed, or the only ones were lost before the last moment. [s]
    is_in_time : (n_runs,) bool
        A confirmed track is alive at the last moment, and its messages have arrived.
    """

    confirmation_s: FloatArray
    onset_s: FloatArray
    is_in_time: BoolArray


def find_onsets(arrival_s: FloatArray, axis: FrameAxis, *, rule: AebRule) -> Onsets:
    """When the VRU of each run is confirmed, and when the VUT knows.

    Messages may take their time.

    `arrival_s` (n_frames,): when the VUT knows of a detection made in each frame;
    infinite where there is none. A message that arrives after the last brake time does
    not count; the age of a track is taken at the last brake time less the rule's
    latency, also where messages take another time.
    """
    n_frames = np.diff(axis.run_start)
    last_brake_s = axis.last_brake_time_s.repeat(n_frames)
    # When the VUT knows of the window of frames that ends in each one, (n_frames,).
    known_s = np.full(axis.n_frames, np.inf)
    if axis.n_frames >= rule.n_confirmations:
        windows = np.lib.stride_tricks.sliding_window_view(
            arrival_s, rule.n_confirmations
        )
        known_s[rule.n_confirmations - 1 :] = windows.max(axis=1)
    known_s[~_is_within_run(axis, rule.n_confirmations)] = np.inf
    is_known = np.asarray(is_in_time(known_s, last_brake_s, latency_s=0.0))
    arrives = np.asarray(is_in_time(arrival_s, last_brake_s, latency_s=0.0))
    is_live = is_known & _held(arrives, axis, rule)
    live_s = _earliest(np.where(is_live, known_s, np.inf), axis)
    late_s = _earliest(np.where(is_known, np.inf, known_s), axis)
    has_live = np.isfinite(live_s)
    onset_s = np.where(has_live, live_s, late_s)
    # The window that is known first; a track that was lost sets nothing in motion.
    is_first = np.where(
        np.isfinite(onset_s).repeat(n_frames),
        (known_s == onset_s.repeat(n_frames)) & (is_live | ~has_live.repeat(n_frames)),
        np.isfinite(known_s),
    )
    confirmation_s = _earliest(np.where(is_first, axis.time_s, np.inf), axis)
    return Onsets(confirmation_s=confirmation_s, onset_s=onset_s, is_in_time=has_live)


def _is_within_run(axis: FrameAxis, n_frames: int) -> BoolArray:
    """True if a frame and those before it are of one run, (n_frames,).

    They are `n_frames` in all.
    """
    start = axis.run_start[:-1].repeat(np.diff(axis.run_start))
    return np.arange(axis.n_frames) - start >= n_frames - 1


def _held(detected: BoolArray, axis: FrameAxis, rule: AebRule) -> BoolArray:
    """Detected frames since which a track lives to the run's last moment.

    The run is that of the frame.
    """
    n_frames = np.diff(axis.run_start)
    return held_frames(
        detected,
        axis.time_s,
        until_s=(axis.last_brake_time_s - rule.latency_s).repeat(n_frames),
        memory_s=rule.track_memory_s,
        last_frame=(axis.run_start[1:] - 1).repeat(n_frames),
    )


def _earliest(times_s: FloatArray, axis: FrameAxis) -> FloatArray:
    """Smallest time of each run: (..., n_frames) -> (..., n_runs)."""
    return np.minimum.reduceat(times_s, axis.run_start[:-1], axis=-1)


LeftOut = Literal["", "unprotected", "not laid", "speeds"]
"""Why a case is left out whatever the junction; empty: it is not."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refusal:
    """A case that an approach does not carry at some speeds, and the reason.

    Attributes
    ----------
    case : Case
        What is not driven.
    approach : str
        The arm from which the VUT would come.
    speeds_kmh : tuple of float
        Speeds of the VUT, one for each run. [km/h]
    reason : str
        Why, in words.
    is_possible : bool
        The junction has the roads that the case needs, and it has the speeds
        asked for: what is missing is room.
    limit_kmh : float or None
        The map's speed limit, where the speeds are above it; else None. [km/h]
    position : str
        Where along the VUT's way.
    vru_speeds_kmh : tuple of float
        Speeds of whoever is met that go with `speeds_kmh`; empty where the case
        has one. [km/h]
    left_out : LeftOut
        Why it is not the junction's doing: whoever is met is not to be
        protected, the case is laid nowhere, or none of its speeds was asked
        for. Empty: the junction does not carry it.
    """

    case: Case
    approach: str
    speeds_kmh: tuple[float, ...]
    # : Why, in words.
    reason: Phrase
    # : The junction has the roads that the case needs, and it has the speeds asked for:
    # what is : missing is room.
    is_possible: bool = True
    limit_kmh: float | None = None
    position: str = AT_ZERO.name
    vru_speeds_kmh: tuple[float, ...] = ()
    left_out: LeftOut = ""

    @property
    def speeds_text(self) -> str:
        """Speeds in words, such as "30, 35" or "30x50, 30x60"."""
        if not self.vru_speeds_kmh:
            return ", ".join(f"{speed:g}" for speed in self.speeds_kmh)
        pairs = zip(self.speeds_kmh, self.vru_speeds_kmh, strict=True)
        return ", ".join(f"{vut:g}x{vru:g}" for vut, vru in pairs)


def build_runs(
    scene: Scene,
    cases: Iterable[Case],
    *,
    vut: Actor,
    rule: AebRule,
    approaches: Sequence[str] | None = None,
    weathers: Sequence[str] = ("day",),
    positions: Sequence[Position] = (AT_ZERO,),
    is_spread: bool = True,
    keeps_limits: bool = True,
    known: Iterable[Run] = (),
) -> tuple[tuple[Run, ...], tuple[Refusal, ...]]:
    """Lay cases on every approach of a scene's junction, at the speeds that each says.

    Where the study's own start and collision points are known for a case, they are
    taken; all else follows the rules of the protocol. `approaches` are arms from which
    the VUT comes, by default all; every run is driven once in each of the `weathers`,
    words of ``WEATHERS``. `positions` lie along the arms; cases that are bound to the
    junction have one place. If `is_spread`, positions other than 0 take turns with the
    speeds, see :func:`scenarios.positions.spread_speeds`; else each drives all. If it
    `keeps_limits`, nothing is driven faster than the speed limit of the lanes by which
    the VUT comes, as far as the scene has one, and vehicles that it meets no faster
    than that of any road of the junction. `known` are runs that were laid before on the
    same scene, by a rule of the same frames and braking: those that come up again are
    taken.

    Returns runs in the order of cases, approaches, positions, speeds, weathers; and
    what could not be laid, and why.

    Raises
    ------
    InputError
        The junction has no such approach, or there is no such weather.
    """
    junction = build_junction(scene)
    for word in approaches or ():
        check_one_of("approach", word, junction.arms)
    for word in weathers:
        check_one_of("weather", word, WEATHERS)
    if junction.keeps_left:
        right_hand = mirrored(junction)
    else:
        right_hand = junction
    known_by_id = {run.id: run for run in known}
    laid: list[Run | _Staged] = []
    refusals: list[Refusal] = []
    for case in (worded_for(case, keeps_left=junction.keeps_left) for case in cases):
        for approach in dict.fromkeys(approaches or junction.arms):
            if case.not_laid:
                refusals.append(
                    left_out_case(case, approach, Phrase(case.not_laid), "not laid")
                )
                continue
            if (
                case.recorded is not None
                and approach != nearest_arm(case.recorded, junction)[0]
            ):
                continue
            for number, position in enumerate(positions_of(case, positions)):
                turn = tuple(junction.arms).index(approach) + number
                # So it was driven.
                keeps = keeps_limits and case.recorded is None
                drive = _Drive(
                    case=case,
                    scene=scene,
                    right_hand=right_hand,
                    approach=approach,
                    position=position,
                    limit_kmh=(
                        junction.arms[approach].speed_limit_kmh if keeps else None
                    ),
                    target_limit_kmh=_highest_limit_kmh(junction) if keeps else None,
                    vut=vut,
                    rule=rule,
                    known=known_by_id,
                )
                runs, refused = drive.lay(turn if is_spread else None)
                laid += runs
                refusals += refused
    return _in_weathers(_build_all(laid, rule), weathers), tuple(refusals)


def _build_all(laid: Sequence["Run | _Staged"], rule: AebRule) -> list[Run]:
    """Runs in their order; the last brake times are found side by side."""
    staged = [one for one in laid if isinstance(one, _Staged)]
    last_s = last_brake_times_s([one.staging.encounter for one in staged], rule)
    times_s = iter(last_s.tolist())
    runs = []
    for one in laid:
        if isinstance(one, _Staged):
            one = one.drive.run(one.case, one.speed_kmh, one.staging, next(times_s))
        runs.append(one)
    return runs


def _in_weathers(runs: Sequence[Run], weathers: Sequence[str]) -> tuple[Run, ...]:
    """Each run once in each weather."""
    return tuple(
        run if one == run.weather else replace(run, id=f"{run.id}/{one}", weather=one)
        for run in runs
        for one in dict.fromkeys(weathers)
    )


def nearest_arm(recorded: RecordedEncounter, junction: Junction) -> tuple[str, float]:
    """The arm at which the VUT's recorded way begins, and how near, in m.

    It is the arm to whose lanes the way begins nearest.
    """
    start = Point(recorded.vut.points_m[0])
    away_m = {
        name: min(
            LineString(lane.centreline_m).distance(start) for lane in arm.lanes_in
        )
        for name, arm in junction.arms.items()
        if arm.lanes_in
    }
    name = min(away_m, key=lambda one: away_m[one], default=next(iter(junction.arms)))
    return name, away_m.get(name, np.inf)


def _highest_limit_kmh(junction: Junction) -> float | None:
    """Speed limit of the fastest road into the junction, in km/h.

    None if one of the roads has no known limit.
    """
    limits = [arm.speed_limit_kmh for arm in junction.arms.values() if arm.entry_lanes]
    known = [limit for limit in limits if limit is not None]
    if known and len(known) == len(limits):
        return max(known)
    return None


def left_out_case(
    case: Case, approach: str, reason: Phrase, left_out: LeftOut
) -> Refusal:
    """Refusal of a case at all its speeds, whatever the junction looks like."""
    pairs = [
        (vut, vru) for vut in case.vut_speeds_kmh for vru in case.vru_speeds_kmh(vut)
    ]
    return _refusal(
        case, approach, pairs, reason=reason, is_possible=False, left_out=left_out
    )


def _refusal(
    case: Case, approach: str, pairs: Sequence[tuple[float, float]], **fields: Any
) -> Refusal:
    """Refusal of a case at speeds of the VUT and whoever it meets that go together."""
    return Refusal(
        case=case,
        approach=approach,
        speeds_kmh=tuple(vut for vut, _ in pairs),
        vru_speeds_kmh=tuple(vru for _, vru in pairs) if case.pairs_kmh else (),
        **fields,
    )


class _Staged(NamedTuple):
    """A run of a drive that lacks its frames and its last brake time."""

    drive: "_Drive"
    case: Case
    speed_kmh: float
    staging: Staging


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Drive:
    """A case at a place: what its runs at several speeds have in common.

    Attributes
    ----------
    case : Case
        The case.
    scene : Scene
        The scene.
    right_hand : Junction
        The scene's junction, mirrored where traffic keeps left.
    approach : str
        The arm from which the VUT comes.
    position : Position
        Where along its way.
    limit_kmh : float or None
        Nothing faster is driven; None: no limit. [km/h]
    target_limit_kmh : float or None
        The same for vehicles that the VUT meets: the highest limit of all roads
        of the junction. [km/h]
    vut : Actor
        The VUT.
    rule : AebRule
        How it brakes.
    known : mapping of str to Run
        Runs that were laid before, by their ids.
    """

    case: Case
    scene: Scene
    right_hand: Junction
    approach: str
    position: Position
    limit_kmh: float | None
    target_limit_kmh: float | None
    vut: Actor
    rule: AebRule
    known: Mapping[str, Run]

    def lay(self, turn: int | None) -> tuple[list["Run | _Staged"], list[Refusal]]:
        """Runs at ascending speeds by day, and what could not be laid.

        Speeds take turns with the positions from `turn` on; None: all of them are
        driven. Known runs are returned as they are.
        """
        runs: list[Run | _Staged] = []
        reasons: dict[tuple[Phrase, bool], list[tuple[float, float]]] = {}
        too_fast: dict[float, list[tuple[float, float]]] = {}
        for speed_kmh, vru_speed_kmh in self._pairs(turn):
            limit_kmh = self._broken_limit_kmh(speed_kmh, vru_speed_kmh)
            if limit_kmh is not None:
                too_fast.setdefault(limit_kmh, []).append((speed_kmh, vru_speed_kmh))
                continue
            case = at_vru_speed(self.case, vru_speed_kmh)
            known = self.known.get(self._run_id(case, speed_kmh))
            if known is not None and known.case == case:
                runs.append(known)
                continue
            try:
                staging = self._stage(case, speed_kmh)
            except CannotCarryError as error:
                reason = error.why, not isinstance(error, NoRoadError)
                reasons.setdefault(reason, []).append((speed_kmh, vru_speed_kmh))
            else:
                runs.append(_Staged(self, case, speed_kmh, staging))
        limits = {}
        for limit_kmh, pairs in too_fast.items():
            why = Phrase(
                "faster than the speed limit of {limit:g} km/h", limit=limit_kmh
            )
            above = why, False
            # A road that does not exist is missing at every speed.
            missing = next(
                (one for one in reasons if not one[1] and one not in limits), above
            )
            reasons.setdefault(missing, []).extend(pairs)
            limits[above] = limit_kmh
        return runs, [
            _refusal(
                self.case,
                self.approach,
                pairs,
                position=self.position.name,
                reason=reason,
                is_possible=is_possible,
                limit_kmh=limits.get((reason, is_possible)),
            )
            for (reason, is_possible), pairs in reasons.items()
        ]

    def _broken_limit_kmh(self, speed_kmh: float, vru_speed_kmh: float) -> float | None:
        """The speed limit that would be broken, in km/h; None: none.

        The VUT, or a vehicle that it meets, would break it.
        """
        if self.limit_kmh is not None and speed_kmh > self.limit_kmh:
            return self.limit_kmh
        is_faster = (
            self.target_limit_kmh is not None and vru_speed_kmh > self.target_limit_kmh
        )
        if is_faster and is_vehicle(self.case.vru):
            return self.target_limit_kmh
        return None

    def _pairs(self, turn: int | None) -> list[tuple[float, float]]:
        """Speeds of the VUT and of whoever it meets, ascending."""
        case = self.case
        speeds_kmh = case.vut_speeds_kmh
        if turn is not None:
            if is_bound(case):
                points = (0, 1)
            else:
                points = case.impact_turn
            speeds_kmh = spread_speeds(
                speeds_kmh, self.position, turn=turn, impact_turn=points
            )
        return [(vut, vru) for vut in speeds_kmh for vru in case.vru_speeds_kmh(vut)]

    def _stage(self, case: Case, speed_kmh: float) -> Staging:
        """Who moves how at a speed of the VUT, or CannotCarryError."""
        scene = self.scene
        if case.recorded is not None:
            return self._stage_recorded(case, case.recorded, speed_kmh)
        if self.position == AT_ZERO:
            placement = find_placement(scene.name, case, self.approach)
            if placement is not None:
                return stage_published(placement, vut_speed_kmh=speed_kmh, vut=self.vut)

        def settle(staging: Staging) -> Staging:
            return make_room(
                mirror_staging(staging) if scene.keeps_left else staging, scene
            )

        # The protocol's rules are those of traffic that keeps right.
        return stage_by_protocol(
            case,
            self.right_hand,
            self.approach,
            vut_speed_kmh=speed_kmh,
            vut=self.vut,
            position=self.position,
            settle=settle,
        )

    def _stage_recorded(
        self, case: Case, recorded: RecordedEncounter, speed_kmh: float
    ) -> Staging:
        """A recorded encounter at the speeds of the case, or CannotCarryError."""
        _, away_m = nearest_arm(recorded, build_junction(self.scene))
        if away_m > load_way_rules().max_recorded_away_m:
            raise NoRoadError(
                Phrase(
                    "it was recorded {distance:.0f} m from the junction's lanes",
                    distance=away_m,
                )
            )
        encounter = recorded.encounter(
            vut=self.vut,
            vut_speed_mps=speed_kmh * MPS_PER_KMH,
            vru=case.vru,
            vru_speed_mps=case.vru_speed_kmh * MPS_PER_KMH,
        )
        if encounter is None:
            raise CannotCarryError(
                Phrase("at these speeds, the recorded paths do not lead to an impact")
            )
        return Staging(encounter=encounter, obstruction=())

    def _run_id(self, case: Case, speed_kmh: float) -> str:
        """Name of the run by day: case, place and speeds."""
        place = self.approach
        if self.position != AT_ZERO:
            place += self.position.name
        speeds = f"{speed_kmh:g}"
        if case.pairs_kmh:
            speeds += f"x{case.vru_speed_kmh:g}"
        return f"{case.name}/{place}/{speeds}"

    def run(
        self, case: Case, speed_kmh: float, staging: Staging, last_brake_s: float
    ) -> Run:
        """The run of a staging, on its grid of frames."""
        encounter = staging.encounter
        rate_hz = self.rule.frame_rate_hz
        vut = encounter.vut_motion
        vru = encounter.vru_motion
        first_s = min(vut.start_time_s, vru.start_time_s)
        # What was before, nobody knows.
        if case.recorded is not None:
            first_s = -case.recorded.known_s
        # The last frame is at the impact; the first one after both have set off.
        n_steps = int(-first_s * rate_hz + _GRID_TOLERANCE)
        time_s = np.arange(-n_steps, 1) / rate_hz
        return Run(
            id=self._run_id(case, speed_kmh),
            case=case,
            approach=self.approach,
            position=self.position.name,
            weather="day",
            vut_speed_kmh=speed_kmh,
            encounter=encounter,
            **frames_at(encounter, time_s),
            obstruction=set_down(staging.obstruction, self.scene),
            terrain=terrain_of(self.scene),
            last_brake_time_s=last_brake_s,
        )
