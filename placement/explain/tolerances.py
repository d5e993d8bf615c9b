"""Tolerances of mounting: how far off a unit may be, and what is lost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.phrases import Phrase
from geometry.poses import wrap_deg
from geometry.tables import says
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..evaluation import earliest_arrival_s, mix
from ..evaluator import with_sight
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import detected_frames

TOLERANCES = Phrase("tolerances")
TURNS_DEG = (0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)
LIFTS_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)

ErrorKind = Literal["yaw", "pitch", "height"]
Steps = Mapping[ErrorKind, tuple[float, ...]]
STEPS: Steps = {"yaw": TURNS_DEG, "pitch": TURNS_DEG, "height": LIFTS_M}

USUAL_DEG = 1.0
USUAL_M = 0.05
"""Errors of a careful mounting: half a spirit level's bubble, the play of a clamp."""

_QUICK_STEPS: Steps = {
    "yaw": (0.5, USUAL_DEG, 2.0),
    "pitch": (0.5, USUAL_DEG, 2.0),
    "height": (USUAL_M,),
}
_USUAL: Mapping[ErrorKind, float] = {
    "yaw": USUAL_DEG,
    "pitch": USUAL_DEG,
    "height": USUAL_M,
}

MAX_UNITS = 30
"""Largest layout whose usual errors are evaluated: each unit takes looks of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """By how much one unit may be off if all others are mounted as planned.

    Attributes
    ----------
    unit_id : str
        The unit.
    yaw_deg, pitch_deg : (float, float)
        Clockwise (right) and counter-clockwise (left); down and up: the largest of the
        tried turns up to which every run that the layout avoids is still avoided; 0:
        not even the smallest. [deg]
    height_m : (float, float)
        Lower and higher, the same. [m]
    """

    unit_id: str
    yaw_deg: tuple[float, float]
    pitch_deg: tuple[float, float]
    height_m: tuple[float, float]


def find_tolerances(
    setting: Setting,
    units: Sequence[CandidatePose],
    *,
    compute: Compute = DEFAULT_COMPUTE,
) -> tuple[Tolerance, ...]:
    """By how much each unit of a layout may be off, one thing at a time.

    `compute` has the seed of the layout's table.
    """
    return _find_errors(
        setting, units, STEPS, fusion="any", compute=compute
    ).tolerances()


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingError:
    """One unit that is off, all others as planned."""

    unit_id: Annotated[str, says("The unit.")]
    kind: Annotated[
        ErrorKind, says("Turned counter-clockwise, tilted up, or raised ...")
    ]
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
            "Any one unit may be turned or tilted by so much and no run is lost; 0: not"
            " even by the smallest step tried. The largest step tried is 2 degrees, in"
            " degrees."
        ),
    ]
    height_m: Annotated[
        float,
        says(
            "Or raised or lowered by so much; the only step tried is the usual one, in"
            " metres."
        ),
    ]
    worst: Annotated[
        MountingError, says("Of the usual errors the one that leaves the least.")
    ]


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
    # Usual errors of all units, in both directions.
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
    """Runs that are avoided with one unit off.

    They are by the unit's number, what is off and by how much.

    Attributes
    ----------
    setting : Setting
        Runs, and the share of cars that see.
    units : sequence of CandidatePose
        Units as planned.
    steps : mapping of str to tuple of float
        Sizes of the errors that were tried, by kind.
    planned : (2, n_runs) bool
        By VUTs that do not see, and that do.
    avoided : mapping of (int, str, float) to (2, n_runs) bool
        As `planned`, by number of the unit, kind and step of the error.
    """

    setting: Setting
    units: Sequence[CandidatePose]
    steps: Steps
    planned: BoolArray
    avoided: Mapping[tuple[int, ErrorKind, float], BoolArray]

    def error(self, number: int, kind: ErrorKind, step: float) -> MountingError:
        """The error of one unit: the APR that is left, and the runs lost."""
        axis = self.setting.axis
        avoided = self.avoided[number, kind, step]
        blind, seeing = (weight_share(part, axis.weight) for part in avoided)
        lost = self._lost(number, kind, step)
        return MountingError(
            unit_id=self.units[number].id,
            kind=kind,
            step=step,
            apr=mix(blind, seeing, self.setting.cars),
            lost_run_ids=tuple(axis.run_ids[run] for run in lost),
        )

    def _lost(self, number: int, kind: ErrorKind, step: float) -> list[int]:
        """Runs that are lost with one unit off."""
        is_lost = self.planned & ~self.avoided[number, kind, step]
        cars = self.setting.cars
        # By cars that do not see, and that do.
        is_driven = np.array([cars < 1.0, cars > 0.0])
        return np.flatnonzero(is_lost[is_driven].any(axis=0)).tolist()

    def tolerances(self) -> tuple[Tolerance, ...]:
        """Tolerances of all units."""
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
    """Runs that are avoided with each unit off by each of the steps."""
    setting = with_sight(setting, compute=compute)
    # One pose for every unit, error and step.
    keys = [
        (number, kind, sign * step)
        for number in range(len(units))
        for kind, sizes in steps.items()
        for step in sizes
        for sign in (-1, 1)
    ]
    everyone = [
        *units,
        *(_off_by(units[number], kind, step) for number, kind, step in keys),
    ]
    looks = [(unit, setting.table_detector) for unit in everyone]
    # Detections of all poses at once.
    frames = detected_frames(setting, looks, stage=TOLERANCES, compute=compute)
    axis = setting.axis
    rule = setting.rule
    seen = setting.seen_by_vut
    latency_s = np.array([unit.latency(rule) for unit in everyone])
    arrival_s = np.where(frames, axis.time_s + latency_s[:, None], np.inf)
    if seen is None:
        own_s = None
    else:
        own_s = earliest_arrival_s([(seen, rule.latency_s)], axis)

    def in_time(parties: FloatArray) -> BoolArray:
        if fusion == "any":
            parties = parties.min(axis=0, keepdims=True)
        each = [find_onsets(party, axis, rule=rule).is_in_time for party in parties]
        return np.asarray(np.any(each, axis=0))

    def avoided(rows: Sequence[int]) -> BoolArray:
        """True for runs that some rows avoid, (2, n_runs)."""
        blind = in_time(arrival_s[rows])
        if own_s is None:
            seeing = blind
        else:
            seeing = in_time(np.vstack([arrival_s[rows], own_s]))
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


_LOWEST_M = 0.1


def _off_by(unit: CandidatePose, kind: ErrorKind, step: float) -> CandidatePose:
    """The unit, off by one error, at no site; never below the road."""
    pose = unit.pose
    if kind == "height":
        east, north, up = pose.position_m
        pose = replace(
            pose, position_m=np.array([east, north, max(up + step, _LOWEST_M)])
        )
    elif kind == "yaw":
        pose = replace(pose, yaw_deg=float(wrap_deg(pose.yaw_deg + step)))
    else:
        pose = replace(
            pose, pitch_deg=float(np.clip(pose.pitch_deg + step, -90.0, 90.0))
        )
    return replace(unit, site_id="", pose=pose)
