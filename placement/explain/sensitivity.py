"""What becomes of a layout if an assumption is wrong: one at a time, all others as planned."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from itertools import chain
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import (
    Table,
    load_toml,
    take_list,
    take_number,
    take_text,
)
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, containing_instance
from scenarios.aeb import AebRule, last_brake_time_s

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..detectors import GeometricDetector, PlanningDetector, ResponseDetector
from ..layout import Layout
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import Look, detected_frames
from .outcomes import (
    Outcome,
    Watched,
    find_expected_outcome,
    find_outcome,
    runs_lost,
)

# ---------- what a layout's numbers rest on, and what else each of it might be: from a TOML file


STAGE = "what if"
_FILE = "sensitivity.toml"
_REASONS = ("source", "assumption")

# Name to smallest and largest value that can be varied to.
RANGES: Mapping[str, tuple[float, float]] = {
    "latency_s": (0.0, 10.0),
    "n_confirmations": (1.0, 100.0),
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
    """Something that a plan takes for granted.

    Attributes
    ----------
    name : str
        One of ``RANGES``; its ending tells the unit.
    values : tuple of float
        What it might be instead, ascending, at least one.
    reason : str
        Where these come from, or why they are likely.
    is_ours : bool
        Whether the reason is an assumption of this project, not a source.
    """

    name: str
    values: tuple[float, ...]
    reason: str
    is_ours: bool


@cache
def load_assumptions() -> tuple[Assumption, ...]:
    """All that is varied, from ``data/sensitivity.toml``."""
    return read_assumptions(load_toml(files("placement") / "data" / _FILE), _FILE)


def read_assumptions(document: Table, where: str) -> tuple[Assumption, ...]:
    """Assumptions of a document.

    Parameters
    ----------
    document : mapping
        Tables by the names of ``RANGES``, each with ``values`` and either ``source`` or
        ``assumption``.
    where : str
        Its name, for error messages.

    Raises
    ------
    InputError
        An unknown name or key, no value, or one that cannot be.
    """
    return tuple(_read(name, table, f"{where}: {name}") for name, table in document.items())


def _read(name: str, table: Any, where: str) -> Assumption:
    if name not in RANGES:
        raise InputError(where, Unquoted("an unknown assumption"), "one of " + ", ".join(RANGES))
    if not isinstance(table, dict):
        raise InputError(where, table, "a table with values")
    known = ("values", *_REASONS)
    for key in table:
        if key not in known:
            raise InputError(f"{where}.{key}", Unquoted("an unknown key"), ", ".join(known))
    low, high = RANGES[name]
    values = []
    for index, _ in enumerate(entries := take_list(table, "values", where)):
        here = f"{where}.values[{index}]"
        value = take_number({"value": entries[index]}, "value", here)
        if not low <= value <= high:
            raise InputError(here, value, f"{low:g} to {high:g}")
        if name == "n_confirmations" and not value.is_integer():
            raise InputError(here, value, "a whole number of frames")
        values.append(value)
    if not values:
        raise InputError(f"{where}.values", Unquoted("none"), "at least one")
    reasons = [key for key in _REASONS if key in table]
    if len(reasons) != 1:
        got = " and ".join(reasons) or "neither"
        raise InputError(where, Unquoted(got), "either source or assumption")
    return Assumption(
        name=name,
        values=tuple(sorted(set(values))),
        reason=take_text(table, reasons[0], where),
        is_ours=reasons == ["assumption"],
    )


# ---------- what becomes of a layout if an assumption is wrong


MAX_LOOKED_FROM = 30
"""Of layouts with more units, what needs new looks at the scene is left out."""
_LOWEST_M = 0.1
_MOUNTING = ("yaw_deg", "pitch_deg", "height_m", "position_m")
_DETECTOR = ("min_box_height_share", "min_iou")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Varied:
    """A value that an assumption may have instead, and what comes of it.

    Attributes
    ----------
    value : float
        In the unit of the assumption's name.
    outcome : Outcome
        Of the layout.
    lost_runs : tuple of str
        Ids of the runs that the layout avoids as planned, and now no longer; where chance decides,
        with a probability below :data:`placement.explain.outcomes.SURE`.
    unmoved : tuple of str
        Ids of units that had to stay where they are: there they would be inside something.
    """

    value: float
    outcome: Outcome
    lost_runs: tuple[str, ...]
    unmoved: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """What one assumption decides.

    Attributes
    ----------
    assumption : Assumption
        What is varied, and why so far.
    planned_value : float or None
        What the plan assumes; None where the question does not arise. 0 for what is off by
        something.
    planned : Outcome
        The layout as planned: the same for all assumptions.
    varied : tuple of Varied
        By ascending values; none if it is left out.
    left_out : str
        Why it was not varied; empty if it was.
    """

    assumption: Assumption
    planned_value: float | None
    planned: Outcome
    varied: tuple[Varied, ...]
    left_out: str = ""


def find_sensitivity(
    setting: Setting,
    layout: Layout,
    *,
    fusion: Fusion = "any",
    assumptions: Sequence[Assumption] | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> tuple[Sensitivity, ...]:
    """How much of a layout's worth hangs on each assumption.

    Parameters
    ----------
    setting : Setting
        Scene, runs, braking rule, planning detector.
    layout : Layout
        The units.
    fusion : {"any", "single"}
        See :class:`placement.explain.outcomes.Watched`.
    assumptions : sequence of Assumption, optional
        What to vary; by default ``data/sensitivity.toml``.
    compute : Compute
        Progress is told how many poses the scene was looked at from.

    Returns
    -------
    sensitivities : tuple of Sensitivity
        In the order of the assumptions. All by the detection table's rules: as planned they say
        what the table says of the layout.

    Notes
    -----
    Latency, confirmations, losses and braking leave the detected frames as they are; only frames
    under another detector or from other poses are looked for anew. Mounting errors are common to
    all units: each is turned, lifted or moved alike, which hits a layout harder than errors that
    fall this way and that. Frames stay where they are on the run, also where their phase was
    chosen by the last brake time.
    """
    assumptions = load_assumptions() if assumptions is None else assumptions
    units, rule = layout.units, setting.rule
    is_large = len(units) > MAX_LOOKED_FROM
    values = {one.name: _new_values(one, setting) for one in assumptions}
    asked = [(name, value) for name in (*_MOUNTING, *_DETECTOR) for value in values.get(name, ())]
    looks = {} if is_large else {key: _looks_at(units, *key, setting) for key in asked}
    compute.progress(STAGE, 0, 0)
    with threadpool_limits(1), ThreadPoolExecutor(compute.workers) as pool:
        try:
            last_brake_s = {
                value: pool.submit(
                    _last_brake_times_s, setting, replace(rule, deceleration_mps2=value)
                )
                for value in values.get("deceleration_mps2", ())
            }
            frames = detected_frames(
                setting,
                [*((unit, setting.planner) for unit in units), *chain(*looks.values())],
                pool=pool,
                compute=compute.within(STAGE),
            )
            axes = {
                value: replace(setting.axis, last_brake_time_s=found.result())
                for value, found in last_brake_s.items()
            }
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    as_planned, *others = (
        Watched(units=units, detected=part, axis=setting.axis, rule=rule, fusion=fusion)
        for part in frames.reshape(-1, len(units), setting.axis.n_frames)
    )
    looked = dict(zip(looks, others, strict=True))
    planned = find_outcome(as_planned)

    def outcome(name: str, value: float) -> Outcome:
        if (name, value) in looked:
            return find_outcome(looked[name, value])
        if name == "packet_loss":
            return find_expected_outcome(as_planned, packet_loss=value)
        if name == "deceleration_mps2":
            return find_outcome(replace(as_planned, axis=axes[value]))
        changed: Any = int(value) if name == "n_confirmations" else value
        return find_outcome(replace(as_planned, rule=replace(rule, **{name: changed})))

    def vary(name: str, value: float) -> Varied:
        found = outcome(name, value)
        moved = zip(units, looks[name, value], strict=True) if name in _MOUNTING else ()
        return Varied(
            value=value,
            outcome=found,
            lost_runs=tuple(setting.axis.run_ids[run] for run in runs_lost(planned, found)),
            unmoved=tuple(unit.id for unit, (new, _) in moved if new is unit),
        )

    def sensitivity(one: Assumption) -> Sensitivity:
        left_out = ""
        if not values[one.name]:
            left_out = "the plan has no such limit, or no other value"
        elif is_large and one.name in (*_MOUNTING, *_DETECTOR):
            left_out = f"not looked at for layouts of more than {MAX_LOOKED_FROM} units"
        return Sensitivity(
            assumption=one,
            planned_value=_planned_value(one.name, setting),
            planned=planned,
            varied=() if left_out else tuple(vary(one.name, value) for value in values[one.name]),
            left_out=left_out,
        )

    return tuple(sensitivity(one) for one in assumptions)


# ---------------------------------------------------------------- what is varied


def _planned_value(name: str, setting: Setting) -> float | None:
    """What the plan assumes; None where the question does not arise."""
    rule, planner = setting.rule, setting.planner
    if name in ("latency_s", "n_confirmations", "deceleration_mps2"):
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


def _last_brake_times_s(setting: Setting, rule: AebRule) -> FloatArray:
    """Last brake time of every run, (n_runs,); runs that differ by weather alone share it."""
    encounters = {id(run.encounter): run.encounter for run in setting.runs}
    last_s = {key: last_brake_time_s(encounter, rule) for key, encounter in encounters.items()}
    return np.array([last_s[id(run.encounter)] for run in setting.runs])


def _looks_at(
    units: Sequence[CandidatePose], name: str, value: float, setting: Setting
) -> list[Look]:
    """All units off by something, or under another detector."""
    if name in _MOUNTING:
        return [(_off(unit, name, value, setting.scene), setting.planner) for unit in units]
    return [(unit, _with(setting.planner, name, value)) for unit in units]


def _off(unit: CandidatePose, name: str, value: float, scene: Scene) -> CandidatePose:
    """A unit that hangs wrong, at no site; the unit itself if it would be inside something."""
    pose = unit.pose
    position, yaw_deg, pitch_deg = pose.position_m, pose.yaw_deg, pose.pitch_deg
    if name == "yaw_deg":
        yaw_deg = float(wrap_deg(yaw_deg + value))
    elif name == "pitch_deg":
        pitch_deg = float(np.clip(pitch_deg + value, -90.0, 90.0))
    elif name == "height_m":
        position = position + [0.0, 0.0, value]
    else:
        yaw = math.radians(yaw_deg)
        position = position + value * np.array([math.cos(yaw), math.sin(yaw), 0.0])
    if position is not pose.position_m and (
        position[2] < _LOWEST_M or containing_instance(scene, position) is not None
    ):
        return unit
    moved = Pose(position_m=position, yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    return replace(unit, site_id="", pose=moved)
