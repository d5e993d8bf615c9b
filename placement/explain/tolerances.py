"""Tolerances of mounting: by how much a unit may be off before a run is lost, and what then is."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray
from geometry.poses import Pose, wrap_deg
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import detected_frames

STAGE = "tolerances"
TURNS_DEG = (0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)
LIFTS_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)

Kind = Literal["yaw", "pitch", "height"]
Steps = Mapping[Kind, tuple[float, ...]]
STEPS: Steps = {"yaw": TURNS_DEG, "pitch": TURNS_DEG, "height": LIFTS_M}

USUAL_DEG, USUAL_M = 1.0, 0.05
"""Errors of a careful mounting: half a bubble of a spirit level, the play of a clamp."""

_QUICK_STEPS: Steps = {
    "yaw": (0.5, USUAL_DEG, 2.0),
    "pitch": (0.5, USUAL_DEG, 2.0),
    "height": (USUAL_M,),
}
_USUAL: Mapping[Kind, float] = {"yaw": USUAL_DEG, "pitch": USUAL_DEG, "height": USUAL_M}

MAX_UNITS = 30
"""Of larger layouts nobody asks what a usual error loses: one look for each takes too long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """By how much one unit may be off if all others are mounted as planned.

    Attributes
    ----------
    unit_id : str
        The unit.
    yaw_deg, pitch_deg : (float, float)
        Clockwise (right) and counter-clockwise (left); down and up: the largest of the tried turns
        up to which every run that the layout avoids is still avoided; 0: not even the smallest.
        [deg]
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
    """One unit that is off, all others as planned.

    Attributes
    ----------
    unit_id : str
        The unit.
    kind : {"yaw", "pitch", "height"}
        Turned counter-clockwise, tilted up, or raised ...
    step : float
        ... by so much. [deg, m]
    apr : float
        Accident prevention ratio that is left, 0..1.
    lost_run_ids : tuple of str
        Runs that are avoided as planned and then no longer.
    """

    unit_id: str
    kind: Kind
    step: float
    apr: float
    lost_run_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Bearing of usual errors of mounting, on the detection table.

    Attributes
    ----------
    aim_deg : float
        Any one unit may be turned or tilted by so much and no run is lost; 0: not even by the
        smallest step tried. The largest step tried is 2 degrees. [deg]
    height_m : float
        Or raised or lowered by so much; the only step tried is the usual one. [m]
    worst : MountingError
        Of the usual errors the one that leaves the least.
    """

    aim_deg: float
    height_m: float
    worst: MountingError


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
    planned: BoolArray  # (n_runs,)
    avoided: Mapping[tuple[int, Kind, float], BoolArray]  # (n_runs,) each

    def error(self, number: int, kind: Kind, step: float) -> MountingError:
        axis = self.setting.axis
        return MountingError(
            unit_id=self.units[number].id,
            kind=kind,
            step=step,
            apr=weight_share(self.avoided[number, kind, step], axis.weight),
            lost_run_ids=tuple(axis.run_ids[run] for run in self._lost(number, kind, step)),
        )

    def _lost(self, number: int, kind: Kind, step: float) -> list[int]:
        lost: list[int] = np.flatnonzero(self.planned & ~self.avoided[number, kind, step]).tolist()
        return lost

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

    def _both(self, number: int, kind: Kind) -> tuple[float, float]:
        return self._last_good(number, kind, -1), self._last_good(number, kind, 1)

    def _last_good(self, number: int, kind: Kind, sign: int) -> float:
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
    keys = [
        (number, kind, sign * step)
        for number in range(len(units))
        for kind, sizes in steps.items()
        for step in sizes
        for sign in (-1, 1)
    ]
    everyone = [*units, *(_moved(units[number], kind, step) for number, kind, step in keys)]
    compute.progress(STAGE, 0, 0)
    with threadpool_limits(1), ThreadPoolExecutor(compute.workers) as pool:
        frames = detected_frames(
            setting,
            [(unit, setting.table_detector) for unit in everyone],
            pool=pool,
            compute=compute.within(STAGE),
        )
    arrival_s = np.stack(
        [
            np.where(row, setting.axis.time_s + unit.latency(setting.rule), np.inf)
            for row, unit in zip(
                frames, [*units, *(units[number] for number, _, _ in keys)], strict=True
            )
        ]
    )

    def avoided(rows: Sequence[int]) -> BoolArray:
        parties = arrival_s[rows]
        if fusion == "any":
            parties = parties.min(axis=0, keepdims=True)
        in_time = [
            find_onsets(party, setting.axis, rule=setting.rule).is_in_time for party in parties
        ]
        is_avoided: BoolArray = np.any(in_time, axis=0)
        return is_avoided

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


def _moved(unit: CandidatePose, kind: Kind, step: float) -> CandidatePose:
    """The unit, off by one error; at no site: it is mounted wrongly, not somewhere else."""
    pose = unit.pose
    position = pose.position_m + [0.0, 0.0, step if kind == "height" else 0.0]
    yaw_deg = float(wrap_deg(pose.yaw_deg + (step if kind == "yaw" else 0.0)))
    pitch_deg = float(np.clip(pose.pitch_deg + (step if kind == "pitch" else 0.0), -90.0, 90.0))
    moved = Pose(
        position_m=np.maximum(position, [-np.inf, -np.inf, 0.1]),
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    return replace(unit, site_id="", pose=moved)
