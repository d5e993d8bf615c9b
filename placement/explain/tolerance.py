"""Tolerance of mounting: by how much a unit may be off before a run is lost."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import BoolArray
from geometry.poses import Pose, wrap_deg

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute
from ..optimiser import PlacementProblem, run_margins_s
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility import build_detection_table
from ..wishes import Wishes, build_problem

TURNS_DEG = (0.5, 1.0, 2.0, 3.0, 5.0, 7.5, 10.0, 15.0)
LIFTS_M = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)
STEPS = {"yaw": TURNS_DEG, "pitch": TURNS_DEG, "height": LIFTS_M}


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
    variants = [variant for unit in units for variant in _variants(unit)]
    everyone = [*units, *variants]
    table = build_detection_table(
        setting.scene,
        everyone,
        setting.runs,
        setting.axis,
        detector=setting.planner,
        compute=compute.within("tolerances"),
    )
    wishes = Wishes(budget_units=1, kept=tuple(unit.id for unit in units))
    problem = build_problem(setting, everyone, table, wishes=wishes, fusion=fusion)
    rows = {candidate.id: row for row, candidate in enumerate(everyone)}
    planned = _avoided(problem, range(len(units)))

    def last_good(number: int, kind: str, sign: int) -> float:
        """The largest step before the first one that loses a run."""
        good = 0.0
        for step in STEPS[kind]:
            row = rows[_name(units[number], kind, sign * step)]
            chosen = [row if index == number else index for index in range(len(units))]
            if (planned & ~_avoided(problem, chosen)).any():
                break
            good = step
        return good

    return tuple(
        Tolerance(
            unit_id=unit.id,
            yaw_deg=(last_good(number, "yaw", -1), last_good(number, "yaw", 1)),
            pitch_deg=(last_good(number, "pitch", -1), last_good(number, "pitch", 1)),
            height_m=(last_good(number, "height", -1), last_good(number, "height", 1)),
        )
        for number, unit in enumerate(units)
    )


def _avoided(problem: PlacementProblem, chosen: Sequence[int]) -> BoolArray:
    """Runs that poses avoid, (n_runs,)."""
    is_avoided: BoolArray = run_margins_s(problem, list(chosen)) > -np.inf
    return is_avoided


def _variants(unit: CandidatePose) -> list[CandidatePose]:
    """The unit with every error of mounting that is tried."""
    pose = unit.pose
    found = []
    for kind, steps in STEPS.items():
        for size in steps:
            for step in (-size, size):
                position = pose.position_m + [0.0, 0.0, step if kind == "height" else 0.0]
                yaw = float(wrap_deg(pose.yaw_deg + (step if kind == "yaw" else 0.0)))
                pitch = float(np.clip(pose.pitch_deg + (step if kind == "pitch" else 0.0), -90, 90))
                moved = Pose(
                    position_m=np.maximum(position, [-np.inf, -np.inf, 0.1]),
                    yaw_deg=yaw,
                    pitch_deg=pitch,
                )
                # At no site: it is mounted wrongly, not somewhere else.
                found.append(replace(unit, id=_name(unit, kind, step), site_id="", pose=moved))
    return found


def _name(unit: CandidatePose, kind: str, step: float) -> str:
    return f"{unit.id} {kind} {step:+g}"
