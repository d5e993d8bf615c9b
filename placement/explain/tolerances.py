"""Tolerances of mounting: by how much a unit may be off before a run is lost, and what then is."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.poses import Pose, wrap_deg

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import detected_frames
from .sensitivity import Outcome, Watched, find_outcome, runs_lost

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
    """What the usual errors of mounting cost a layout, one unit and one error at a time."""
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
    """Outcomes with one unit off, by its number, what is off and by how much."""

    setting: Setting
    units: Sequence[CandidatePose]
    steps: Steps
    planned: Outcome
    outcomes: Mapping[tuple[int, Kind, float], Outcome]

    def error(self, number: int, kind: Kind, step: float) -> MountingError:
        outcome = self.outcomes[number, kind, step]
        run_ids = self.setting.axis.run_ids
        lost = tuple(run_ids[run] for run in runs_lost(self.planned, outcome))
        return MountingError(
            unit_id=self.units[number].id, kind=kind, step=step, apr=outcome.apr, lost_run_ids=lost
        )

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
            if runs_lost(self.planned, self.outcomes[number, kind, sign * step]):
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
            [(unit, setting.planner) for unit in everyone],
            pool=pool,
            compute=compute.within(STAGE),
        )
    as_planned = Watched(
        units=tuple(units),
        detected=frames[: len(units)],
        axis=setting.axis,
        rule=setting.rule,
        fusion=fusion,
    )

    def outcome(number: int, row: int) -> Outcome:
        detected = as_planned.detected.copy()
        detected[number] = frames[row]
        return find_outcome(replace(as_planned, detected=detected))

    return _Errors(
        setting=setting,
        units=units,
        steps=steps,
        planned=find_outcome(as_planned),
        outcomes={key: outcome(key[0], row) for row, key in enumerate(keys, start=len(units))},
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
