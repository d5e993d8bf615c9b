"""Sensitivity of a layout to wrong assumptions, and its tolerances of mounting."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from importlib.resources import files
from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, says, take_list, take_number
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, containing_instance
from scenarios.aeb import TIME_TOLERANCE_S, AebRule, is_in_time, last_brake_time_s
from scenarios.runs import FrameAxis, find_onsets
from scenarios.weights import weight_share

from ..cache import CachedArrays, Fingerprints
from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..detectors import GeometricDetector, PlanningDetector, ResponseDetector
from ..evaluation import earliest_arrival_s, leave_each_out, mix
from ..evaluator import with_sight
from ..latency import REASONS, refuse_unknown, take_reason
from ..layout import Layout
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import Look, detected_frames

# ---------- assumptions: what is varied, and to which values


STAGE = "what if"
_FILE = "sensitivity.toml"

# Name to smallest and largest value that can be varied to.
RANGES: Mapping[str, tuple[float, float]] = {
    "latency_s": (0.0, 10.0),
    "n_confirmations": (1.0, 100.0),
    "track_memory_s": (0.1, math.inf),
    "deceleration_mps2": (0.1, 20.0),
    "packet_loss": (0.0, 1.0),
    "min_box_height_share": (0.01, 100.0),
    "min_iou": (0.0, 0.99),
    "yaw_deg": (-180.0, 180.0),
    "pitch_deg": (-90.0, 90.0),
    "height_m": (-10.0, 10.0),
    "position_m": (-10.0, 10.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Assumption:
    """Something that a plan takes for granted."""

    name: str  # one of RANGES; its ending states the unit
    values: tuple[float, ...]  # alternatives, ascending, at least one
    reason: str  # where these come from, or why they are likely
    is_ours: bool  # the reason is an assumption of this project, not a source


@cache
def load_assumptions() -> tuple[Assumption, ...]:
    """Everything that is varied, from ``data/sensitivity.toml``."""
    return read_assumptions(load_toml(files("placement") / "data" / _FILE), _FILE)


def read_assumptions(document: Table, where: str) -> tuple[Assumption, ...]:
    """Assumptions of a document: tables by the names of ``RANGES``.

    Each has ``values`` and either ``source`` or ``assumption``.
    """
    return tuple(_read(name, table, f"{where}: {name}") for name, table in document.items())


def _read(name: str, table: Any, where: str) -> Assumption:
    if name not in RANGES:
        raise InputError(where, Unquoted("an unknown assumption"), "one of " + ", ".join(RANGES))
    if not isinstance(table, dict):
        raise InputError(where, table, "a table with values")
    refuse_unknown(table, ("values", *REASONS), where)
    low, high = RANGES[name]
    values = []
    for index, _ in enumerate(entries := take_list(table, "values", where)):
        here = f"{where}.values[{index}]"
        is_endless = high == entries[index] == math.inf
        value = high if is_endless else take_number({"value": entries[index]}, "value", here)
        if not low <= value <= high:
            raise InputError(here, value, f"{low:g} to {high:g}")
        if name == "n_confirmations" and not value.is_integer():
            raise InputError(here, value, "a whole number of frames")
        values.append(value)
    if not values:
        raise InputError(f"{where}.values", Unquoted("none"), "at least one")
    reason, is_ours = take_reason(table, where)
    return Assumption(name=name, values=tuple(sorted(set(values))), reason=reason, is_ours=is_ours)


# ---------- outcomes: what a layout achieves by the frames that its units detect


SURE = 0.99
"""Where messages are lost by chance, a run avoided with a lower probability counts as lost."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Watched:
    """Units, the frames that they detect, and how these are judged."""

    # at least one. A unit with a latency of its own keeps it, whatever the rule says.
    units: tuple[CandidatePose, ...]
    detected: BoolArray  # (n_units, n_frames): by each of them
    axis: FrameAxis  # runs and frames
    rule: AebRule  # confirmation and latency
    # {"any", "single"}: "any": a frame counts if any unit detects; "single": one unit must confirm
    # alone
    fusion: Fusion = "any"
    # (n_frames,): frames in which the VUT's own sensors detect, where it sees; it never fails
    seen_by_vut: BoolArray | None = None
    cars: float = 1.0  # share of the VUTs that see then


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """Value of a layout."""

    apr: Annotated[
        float | None,
        says(
            "Accident prevention ratio; where messages are lost by chance, its expectation. "
            "None: no run has weight."
        ),
    ]
    apr_one_failed: Annotated[
        float | None, says("APR if the unit that is needed most fails; 0 for a single unit.")
    ]
    smallest_margin_s: Annotated[
        float | None,
        says(
            "Smallest time to spare of the avoided runs with weight, in seconds; None where "
            "there is none, or where messages are lost by chance."
        ),
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """Value of a layout, and the runs that it avoids."""

    worth: Worth
    # (n_runs,): probability that each run is avoided: 0 or 1 unless messages are lost by chance
    avoided_share: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "avoided_share", freeze(self.avoided_share))


def _of_cars(watched: Watched, outcome: Callable[[Watched], Outcome]) -> Outcome:
    """Outcome by the share of the VUTs that see; its smallest margin is that of both."""
    blind = outcome(replace(watched, seen_by_vut=None))
    seeing = outcome(replace(watched, cars=1.0))
    one, other = blind.worth, seeing.worth

    def ratio(of_blind: float | None, of_seeing: float | None) -> float | None:
        if of_blind is None or of_seeing is None:
            return None
        return mix(of_blind, of_seeing, watched.cars)

    margins_s = [w.smallest_margin_s for w in (one, other) if w.smallest_margin_s is not None]
    share = watched.cars * seeing.avoided_share + (1.0 - watched.cars) * blind.avoided_share
    worth = Worth(
        apr=ratio(one.apr, other.apr),
        apr_one_failed=ratio(one.apr_one_failed, other.apr_one_failed),
        smallest_margin_s=min(margins_s, default=None),
    )
    return Outcome(worth=worth, avoided_share=share)


def find_outcome(watched: Watched) -> Outcome:
    """Outcome of units when every message arrives."""
    if watched.seen_by_vut is not None and watched.cars < 1.0:
        return _of_cars(watched, find_outcome)
    axis, rule = watched.axis, watched.rule
    own_s = np.inf if watched.seen_by_vut is None else _own_s(watched)
    arrival_s = np.where(watched.detected, axis.time_s + _latencies_s(watched)[:, None], np.inf)

    left: Iterator[FloatArray]  # with each unit failed in turn

    def onset_s(arrival: FloatArray) -> FloatArray:
        return find_onsets(arrival, axis, rule=rule).onset_s

    if watched.fusion == "any":
        earliest_s, without = leave_each_out(arrival_s)
        onset = onset_s(np.minimum(earliest_s, own_s))
        left = (
            onset if other is earliest_s else onset_s(np.minimum(other, own_s)) for other in without
        )
    else:
        onset, without = leave_each_out(np.stack([onset_s(arrival) for arrival in arrival_s]))
        own_onset_s = np.inf if watched.seen_by_vut is None else onset_s(np.asarray(own_s))
        onset = np.minimum(onset, own_onset_s)
        left = (np.minimum(other, own_onset_s) for other in without)
    is_avoided = is_in_time(onset, axis.last_brake_time_s, latency_s=0.0)
    apr = weight_share(is_avoided, axis.weight)
    shares = [
        weight_share(is_in_time(other, axis.last_brake_time_s, latency_s=0.0), axis.weight)
        for other in left
    ]
    counts = is_avoided & (axis.weight > 0.0)
    margin = axis.last_brake_time_s[counts] - onset[counts]
    worth = Worth(
        apr=apr,
        apr_one_failed=0.0 if _leaves_nothing(watched) else min([apr, *shares]),
        smallest_margin_s=float(margin.min()) if counts.any() else None,
    )
    return Outcome(worth=worth, avoided_share=is_avoided.astype(np.float64))


def find_expected_outcome(watched: Watched, *, packet_loss: float) -> Outcome:
    """Average outcome of units when messages are lost: exact, not drawn.

    `packet_loss` is the probability that the message of a unit on a frame does not arrive, each
    independently. The APR with one unit failed is the smallest expectation.

    A frame is known with probability 1 - loss^k where k units report it by the last brake time.
    What the VUT knows is then a Markov chain along the run: either so many known frames in a row
    that are not yet n, or a track and the frame that it was last seen in. The run is avoided if
    there is a track at the end that is not older than its memory at the last moment.
    """
    if watched.seen_by_vut is not None and watched.cars < 1.0:
        return _of_cars(watched, partial(find_expected_outcome, packet_loss=packet_loss))
    axis, rule = watched.axis, watched.rule
    last_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    reported = watched.detected & is_in_time(
        axis.time_s + _latencies_s(watched)[:, None], last_s, latency_s=0.0
    )
    # What the VUT sees itself needs no message.
    sees = np.zeros(axis.n_frames, dtype=bool)
    if watched.seen_by_vut is not None:
        sees = is_in_time(_own_s(watched), last_s, latency_s=0.0)

    def confirmed(n_units: IntArray, sees: BoolArray | None = None) -> FloatArray:
        known: FloatArray = 1.0 - packet_loss ** n_units.astype(np.float64)
        return _probability_of_track(
            known if sees is None else np.where(sees, 1.0, known), axis, rule
        )

    if watched.fusion == "any":
        total = reported.sum(axis=0)
        avoided = confirmed(total, sees)
        left = (confirmed(total - own, sees) for own in reported if own.any())
    else:
        missed = 1.0 - np.stack([confirmed(own.astype(np.int64)) for own in reported])
        by_vut = 1.0 - _probability_of_track(sees.astype(np.float64), axis, rule)
        avoided = 1.0 - missed.prod(axis=0) * by_vut
        others = (np.delete(missed, unit, axis=0) for unit in range(len(missed)))
        left = (1.0 - other.prod(axis=0) * by_vut for other in others)
    weight = axis.weight / axis.weight.sum()
    apr = float(avoided @ weight)
    worth = Worth(
        apr=apr,
        apr_one_failed=0.0
        if _leaves_nothing(watched)
        else min([apr, *(float(share @ weight) for share in left)]),
        smallest_margin_s=None,
    )
    return Outcome(worth=worth, avoided_share=avoided)


def _leaves_nothing(watched: Watched) -> bool:
    """Nobody is left when a unit fails."""
    return len(watched.units) == 1 and watched.seen_by_vut is None


def _own_s(watched: Watched) -> FloatArray:
    """When the VUT knows what its own sensors detect in each frame, (n_frames,) in s."""
    assert watched.seen_by_vut is not None
    return earliest_arrival_s([(watched.seen_by_vut, watched.rule.latency_s)], watched.axis)


def _latencies_s(watched: Watched) -> FloatArray:
    return np.array([unit.latency(watched.rule) for unit in watched.units])


def _probability_of_track(known: FloatArray, axis: FrameAxis, rule: AebRule) -> FloatArray:
    """Probability that a track of each run is alive at its last moment, (n_runs,)."""
    lengths, n_row = np.diff(axis.run_start), rule.n_confirmations
    is_frame = np.arange(lengths.max()) < lengths[:, None]
    known_by_run, time_s = np.zeros(is_frame.shape), np.zeros(is_frame.shape)
    known_by_run[is_frame], time_s[is_frame] = known, axis.time_s
    memory_s = rule.track_memory_s + TIME_TOLERANCE_S
    # No track: columns are the number of known frames in a row up to here.
    row = np.zeros((len(lengths), n_row))
    row[:, 0] = 1.0
    # A track: columns are the frame in which it was last seen. It may be too old by now.
    track = np.zeros(is_frame.shape)
    for frame in range(1 + int(np.flatnonzero(known_by_run.any(axis=0)).max(initial=-1))):
        p = known_by_run[:, frame]
        is_held = time_s[:, [frame]] - time_s[:, :frame] <= memory_s
        held = (track[:, :frame] * is_held).sum(axis=1)
        lost = (track[:, :frame] * ~is_held).sum(axis=1)
        longer = row.copy()
        longer[:, 0] += lost
        track[:, :frame] *= (1.0 - p)[:, None]
        track[:, frame] = (held + longer[:, -1]) * p
        row[:, 0] = row.sum(axis=1) * (1.0 - p)
        row[:, 1:] = longer[:, :-1] * p[:, None]
    until_s = axis.last_brake_time_s - rule.latency_s
    lives = until_s[:, None] - time_s <= memory_s
    probability: FloatArray = np.minimum((track * lives).sum(axis=1), 1.0)
    return probability


def runs_lost(planned: Outcome, outcome: Outcome) -> list[int]:
    """Indices of runs avoided as planned, and then with a probability below ``SURE``."""
    lost = (planned.avoided_share >= SURE) & (outcome.avoided_share < SURE)
    return np.flatnonzero(lost).tolist()


# ---------- sensitivity


MAX_LOOKED_FROM = 30
"""For layouts with more units, variations that need new looks at the scene are left out."""
_LOWEST_M = 0.1
_MOUNTING = ("yaw_deg", "pitch_deg", "height_m", "position_m")
_DETECTOR = ("min_box_height_share", "min_iou")


@dataclass(frozen=True, slots=True, kw_only=True)
class Varied(Worth):
    """A value that an assumption may have instead, and the layout's worth with it."""

    value: Annotated[
        float | None, says("In the unit of the assumption's name; None: infinite, for ever.")
    ]
    lost_runs: Annotated[
        tuple[str, ...],
        says(
            "Runs that are avoided as planned, and then no longer; where messages are lost "
            "by chance, with a probability below ``SURE``."
        ),
    ]
    unmoved: Annotated[
        tuple[str, ...],
        says("Ids of units that stayed where they are: there they would be inside something."),
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class VariedAssumption:
    """Effect of one assumption."""

    name: Annotated[str, says("Which; its ending states the unit.")]
    planned_value: Annotated[
        float | None,
        says(
            "Value of the plan, 0 for errors of mounting; None where the question does not "
            "arise, and where it is infinite: tracks that live for ever."
        ),
    ]
    reason: Annotated[str, says("Why it is varied so far.")]
    is_ours: Annotated[bool, says("Whether that is an assumption of this project, not a source.")]
    left_out: Annotated[str, says("Why it was not varied; empty if it was.")]
    varied: Annotated[tuple[Varied, ...], says("By ascending value; empty if left out.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Worth of a layout if an assumption is wrong: one at a time."""

    planned: Annotated[Worth, says("As planned.")]
    assumptions: Annotated[tuple[VariedAssumption, ...], says("One for each assumption.")]


def find_sensitivity(
    setting: Setting,
    layout: Layout,
    *,
    fusion: Fusion = "any",
    assumptions: Sequence[Assumption] | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Sensitivity:
    """Sensitivity of a layout to each assumption (``data/sensitivity.toml``).

    All is judged by the detection table's rules. Latency, confirmations, losses and braking leave
    the detected frames as they are; only frames under another detector or from other poses are
    detected anew, and what the VUT's own sensors detect stays. Mounting errors are common to all
    units: each is turned, lifted or moved alike, which hits a layout harder than independent errors
    would. Progress counts the poses from which the scene was looked at.
    """
    assumptions = load_assumptions() if assumptions is None else assumptions
    setting = with_sight(setting, compute=compute)
    units = layout.units
    is_large = len(units) > MAX_LOOKED_FROM
    values = {one.name: _new_values(one, setting) for one in assumptions}
    asked = [(name, value) for name in (*_MOUNTING, *_DETECTOR) for value in values.get(name, ())]
    looks = {} if is_large else {key: _looks_at(units, *key, setting) for key in asked}
    everyone = [*((unit, setting.table_detector) for unit in units), *chain(*looks.values())]
    with ThreadPoolExecutor(1) as pool:  # encounters are braked while rays are cast
        braking = values.get("deceleration_mps2", ())
        brakes = pool.submit(find_last_brake_times, setting, braking, compute=compute)
        frames = detected_frames(setting, everyone, stage=STAGE, compute=compute)
        axes = {
            value: replace(setting.axis, last_brake_time_s=last_s)
            for value, last_s in brakes.result().items()
        }
    as_planned, *others = (
        Watched(
            units=units,
            detected=part,
            axis=setting.axis,
            rule=setting.rule,
            fusion=fusion,
            seen_by_vut=setting.seen_by_vut,
            cars=setting.cars,
        )
        for part in frames.reshape(-1, len(units), setting.axis.n_frames)
    )
    looked = dict(zip(looks, others, strict=True))
    planned = find_outcome(as_planned)

    def vary(name: str, value: float) -> Varied:
        if (name, value) in looked:
            found = find_outcome(looked[name, value])
        elif name == "deceleration_mps2":
            found = find_outcome(replace(as_planned, axis=axes[value]))
        else:
            found = _find_outcome_under(as_planned, name, value)
        moved = zip(units, looks[name, value], strict=True) if name in _MOUNTING else ()
        return Varied(
            **asdict(found.worth),
            value=_finite(value),
            lost_runs=tuple(setting.axis.run_ids[run] for run in runs_lost(planned, found)),
            unmoved=tuple(unit.id for unit, (new, _) in moved if new is unit),
        )

    def vary_all(one: Assumption) -> VariedAssumption:
        left_out = ""
        if not values[one.name]:
            left_out = "the plan has no such limit, or no other value"
        elif is_large and one.name in (*_MOUNTING, *_DETECTOR):
            left_out = f"not looked at for layouts of more than {MAX_LOOKED_FROM} units"
        return VariedAssumption(
            name=one.name,
            planned_value=_finite(_planned_value(one.name, setting)),
            reason=one.reason,
            is_ours=one.is_ours,
            left_out=left_out,
            varied=() if left_out else tuple(vary(one.name, value) for value in values[one.name]),
        )

    return Sensitivity(
        planned=planned.worth, assumptions=tuple(vary_all(one) for one in assumptions)
    )


def _find_outcome_under(watched: Watched, name: str, value: float) -> Outcome:
    """Outcome with another loss of messages, latency or rule of confirmation."""
    if name == "packet_loss":
        return find_expected_outcome(watched, packet_loss=value)
    changed: Any = int(value) if name == "n_confirmations" else value
    return find_outcome(replace(watched, rule=replace(watched.rule, **{name: changed})))


def _finite(value: float | None) -> float | None:
    return None if value is None or math.isinf(value) else value


# ---------- other brakes


_BRAKING = "place-rsus/braking/1"  # raise it whenever the same encounters give other brake times


def find_last_brake_times(
    setting: Setting, decelerations_mps2: Sequence[float], *, compute: Compute
) -> dict[float, FloatArray]:
    """Last brake time of every run, (n_runs,) each, by the deceleration [s]; cached."""
    if not decelerations_mps2:
        return {}
    hashes = Fingerprints()
    rules = {value: replace(setting.rule, deceleration_mps2=value) for value in decelerations_mps2}
    names = {value: hashes.of(rule) for value, rule in rules.items()}
    fingerprint = ""
    if compute.cache_folder is not None:
        fingerprint = hashes.of(_BRAKING, [run.encounter for run in setting.runs])
    kept = CachedArrays(compute.cache_folder, "braking", kind=_BRAKING, fingerprint=fingerprint)
    kept.add(
        {
            name: _last_brake_times_s(setting, rules[value])
            for value, name in names.items()
            if name not in kept.arrays
        }
    )
    return {value: kept.arrays[name] for value, name in names.items()}


def _last_brake_times_s(setting: Setting, rule: AebRule) -> FloatArray:
    """Of every run, (n_runs,); runs that differ by weather alone share it."""
    encounters = {id(run.encounter): run.encounter for run in setting.runs}
    last_s = {key: last_brake_time_s(encounter, rule) for key, encounter in encounters.items()}
    return np.array([last_s[id(run.encounter)] for run in setting.runs])


# ---------- values, poses and detectors that are not the plan's


def _planned_value(name: str, setting: Setting) -> float | None:
    """The value that the plan assumes; None where the assumption does not apply."""
    rule, planner = setting.rule, setting.table_detector
    if name in ("latency_s", "n_confirmations", "track_memory_s", "deceleration_mps2"):
        return float(getattr(rule, name))
    if name == "min_iou":
        return planner.min_iou if isinstance(planner, GeometricDetector) else None
    if name == "min_box_height_share":
        return 1.0 if planner.min_box_height_px > 0.0 else None
    return 0.0


def _new_values(assumption: Assumption, setting: Setting) -> list[float]:
    """Values that are not the plan's own; none where the question does not arise."""
    planned = _planned_value(assumption.name, setting)
    if planned is None:
        return []
    return [value for value in assumption.values if not math.isclose(value, planned)]


def _with(detector: PlanningDetector, name: str, value: float) -> PlanningDetector:
    if name == "min_iou":
        assert isinstance(detector, GeometricDetector)  # else it has no planned value
        return replace(detector, min_iou=value)
    if not isinstance(detector, GeometricDetector | ResponseDetector):
        raise TypeError(f"a planning detector of an unknown kind: {detector!r}")
    return replace(detector, min_box_height_px=value * detector.min_box_height_px)


def prepare_sensitivity(setting: Setting, *, compute: Compute = DEFAULT_COMPUTE) -> None:
    """Keep for :func:`find_sensitivity` what it needs whatever the layout, where anything is kept.

    That is half of its work.
    """
    if compute.cache_folder is not None:
        for one in load_assumptions():
            if one.name == "deceleration_mps2":
                find_last_brake_times(setting, _new_values(one, setting), compute=compute)


def _looks_at(
    units: Sequence[CandidatePose], name: str, value: float, setting: Setting
) -> list[Look]:
    """All units with one error of mounting, or under another detector."""
    if name in _MOUNTING:
        return [(_off(unit, name, value, setting.scene), setting.table_detector) for unit in units]
    return [(unit, _with(setting.table_detector, name, value)) for unit in units]


def _off(unit: CandidatePose, name: str, value: float, scene: Scene) -> CandidatePose:
    """A unit mounted wrongly, at no site; the unit itself if it would be inside something."""
    if name in ("yaw_deg", "pitch_deg"):
        is_yaw = name == "yaw_deg"
        return _mounted(unit, yaw_deg=value * is_yaw, pitch_deg=value * (not is_yaw))
    yaw = math.radians(unit.pose.yaw_deg)
    ahead = [0.0, 0.0, 1.0] if name == "height_m" else [math.cos(yaw), math.sin(yaw), 0.0]
    position_m = unit.pose.position_m + value * np.array(ahead)
    if position_m[2] < _LOWEST_M or containing_instance(scene, position_m) is not None:
        return unit
    return _mounted(unit, position_m=position_m)


def _mounted(
    unit: CandidatePose,
    *,
    position_m: FloatArray | None = None,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
) -> CandidatePose:
    """A unit at another place, or turned; at no site: it is mounted wrongly."""
    pose = Pose(
        position_m=unit.pose.position_m if position_m is None else position_m,
        yaw_deg=float(wrap_deg(unit.pose.yaw_deg + yaw_deg)),
        pitch_deg=float(np.clip(unit.pose.pitch_deg + pitch_deg, -90.0, 90.0)),
    )
    return replace(unit, site_id="", pose=pose)


# ---------- tolerances: by how much one unit may be off before a run is lost, and what then is


TOLERANCES = "tolerances"
TURNS_DEG = (0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)
LIFTS_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)

ErrorKind = Literal["yaw", "pitch", "height"]
Steps = Mapping[ErrorKind, tuple[float, ...]]
STEPS: Steps = {"yaw": TURNS_DEG, "pitch": TURNS_DEG, "height": LIFTS_M}

USUAL_DEG, USUAL_M = 1.0, 0.05
"""Errors of a careful mounting: half a bubble of a spirit level, the play of a clamp."""

_QUICK_STEPS: Steps = {
    "yaw": (0.5, USUAL_DEG, 2.0),
    "pitch": (0.5, USUAL_DEG, 2.0),
    "height": (USUAL_M,),
}
_USUAL: Mapping[ErrorKind, float] = {"yaw": USUAL_DEG, "pitch": USUAL_DEG, "height": USUAL_M}

MAX_UNITS = 30
"""Of larger layouts nobody asks what a usual error loses: one look for each takes too long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """By how much one unit may be off if all others are mounted as planned."""

    unit_id: str  # the unit
    # yaw_deg, pitch_deg: clockwise (right) and counter-clockwise (left); down and up: the
    # largest of the tried turns up to which every run that the layout avoids is still
    # avoided; 0: not even the smallest. [deg]
    yaw_deg: tuple[float, float]
    pitch_deg: tuple[float, float]
    height_m: tuple[float, float]  # lower and higher, the same. [m]


def find_tolerances(
    setting: Setting,
    units: Sequence[CandidatePose],
    *,
    fusion: Fusion = "any",
    compute: Compute = DEFAULT_COMPUTE,
) -> tuple[Tolerance, ...]:
    """By how much each unit of a layout may be off; `compute` has the seed of the layout's table.

    One thing is off at a time: a unit that is turned and too low at once may lose a run within both
    tolerances.
    """
    return _find_errors(setting, units, STEPS, fusion=fusion, compute=compute).tolerances()


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingError:
    """One unit that is off, all others as planned."""

    unit_id: Annotated[str, says("The unit.")]
    kind: Annotated[ErrorKind, says("Turned counter-clockwise, tilted up, or raised ...")]
    step: Annotated[float, says("... by so much. [deg, m].")]
    apr: Annotated[float, says("Accident prevention ratio that is left, 0..1.")]
    lost_run_ids: Annotated[
        tuple[str, ...], says("Runs that are avoided as planned and then no longer.")
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Bearing of usual errors of mounting, on the detection table."""

    aim_deg: Annotated[
        float,
        says(
            "Any one unit may be turned or tilted by so much and no run is lost; 0: not "
            "even by the smallest step tried. The largest step tried is 2 degrees, in "
            "degrees."
        ),
    ]
    height_m: Annotated[
        float,
        says("Or raised or lowered by so much; the only step tried is the usual one, in metres."),
    ]
    worst: Annotated[MountingError, says("Of the usual errors the one that leaves the least.")]


def find_standing(
    setting: Setting,
    units: Sequence[CandidatePose],
    *,
    fusion: Fusion = "any",
    compute: Compute = DEFAULT_COMPUTE,
) -> Standing:
    """Cost of the usual errors of mounting, one unit and one error at a time."""
    errors = _find_errors(setting, units, _QUICK_STEPS, fusion=fusion, compute=compute)
    found = errors.tolerances()
    usual = [
        errors.error(number, kind, sign * _USUAL[kind])
        for number in range(len(units))
        for kind in _USUAL
        for sign in (-1, 1)
    ]
    return Standing(
        aim_deg=min(min(*one.yaw_deg, *one.pitch_deg) for one in found),
        height_m=min(min(one.height_m) for one in found),
        worst=min(usual, key=lambda one: (one.apr, -len(one.lost_run_ids))),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Errors:
    """Runs that are avoided with one unit off, by its number, what is off and by how much."""

    setting: Setting
    units: Sequence[CandidatePose]
    steps: Steps
    # (2, n_runs) each: by VUTs that do not see, and that do
    planned: BoolArray
    avoided: Mapping[tuple[int, ErrorKind, float], BoolArray]

    def error(self, number: int, kind: ErrorKind, step: float) -> MountingError:
        axis, cars = self.setting.axis, self.setting.cars
        blind, seeing = (
            weight_share(part, axis.weight) for part in self.avoided[number, kind, step]
        )
        lost = self._lost(number, kind, step)
        return MountingError(
            unit_id=self.units[number].id,
            kind=kind,
            step=step,
            apr=mix(blind, seeing, cars),
            lost_run_ids=tuple(axis.run_ids[run] for run in lost),
        )

    def _lost(self, number: int, kind: ErrorKind, step: float) -> list[int]:
        is_lost = self.planned & ~self.avoided[number, kind, step]
        cars = self.setting.cars
        is_driven = np.array([cars < 1.0, cars > 0.0])  # by cars that do not see, and that do
        return np.flatnonzero(is_lost[is_driven].any(axis=0)).tolist()

    def tolerances(self) -> tuple[Tolerance, ...]:
        return tuple(
            Tolerance(
                unit_id=unit.id,
                yaw_deg=self._both(number, "yaw"),
                pitch_deg=self._both(number, "pitch"),
                height_m=self._both(number, "height"),
            )
            for number, unit in enumerate(self.units)
        )

    def _both(self, number: int, kind: ErrorKind) -> tuple[float, float]:
        return self._last_good(number, kind, -1), self._last_good(number, kind, 1)

    def _last_good(self, number: int, kind: ErrorKind, sign: int) -> float:
        """The largest step before the first one that loses a run."""
        good = 0.0
        for step in self.steps[kind]:
            if self._lost(number, kind, sign * step):
                break
            good = step
        return good


def _find_errors(
    setting: Setting,
    units: Sequence[CandidatePose],
    steps: Steps,
    *,
    fusion: Fusion,
    compute: Compute,
) -> _Errors:
    setting = with_sight(setting, compute=compute)
    keys = [
        (number, kind, sign * step)
        for number in range(len(units))
        for kind, sizes in steps.items()
        for step in sizes
        for sign in (-1, 1)
    ]
    everyone = [*units, *(_off_by(units[number], kind, step) for number, kind, step in keys)]
    looks = [(unit, setting.table_detector) for unit in everyone]
    frames = detected_frames(setting, looks, stage=TOLERANCES, compute=compute)
    axis, rule, seen = setting.axis, setting.rule, setting.seen_by_vut
    latency_s = np.array([unit.latency(rule) for unit in everyone])
    arrival_s = np.where(frames, axis.time_s + latency_s[:, None], np.inf)
    own_s = None if seen is None else earliest_arrival_s([(seen, rule.latency_s)], axis)

    def in_time(parties: FloatArray) -> BoolArray:
        if fusion == "any":
            parties = parties.min(axis=0, keepdims=True)
        each = [find_onsets(party, axis, rule=rule).is_in_time for party in parties]
        is_avoided: BoolArray = np.any(each, axis=0)
        return is_avoided

    def avoided(rows: Sequence[int]) -> BoolArray:
        blind = in_time(arrival_s[rows])
        seeing = blind if own_s is None else in_time(np.vstack([arrival_s[rows], own_s]))
        return np.stack([blind, seeing])

    numbers = list(range(len(units)))
    return _Errors(
        setting=setting,
        units=units,
        steps=steps,
        planned=avoided(numbers),
        avoided={
            key: avoided([row if number == key[0] else number for number in numbers])
            for row, key in enumerate(keys, start=len(units))
        },
    )


def _off_by(unit: CandidatePose, kind: ErrorKind, step: float) -> CandidatePose:
    """The unit, off by one error; never below the road."""
    if kind == "height":
        east, north, up = unit.pose.position_m
        return _mounted(unit, position_m=np.array([east, north, max(up + step, _LOWEST_M)]))
    return _mounted(unit, yaw_deg=step * (kind == "yaw"), pitch_deg=step * (kind == "pitch"))
