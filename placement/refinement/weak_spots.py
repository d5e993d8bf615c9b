"""When a layout sees too little, and where the VRU is then."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from scenarios.runs import FrameAxis, Run

from ..optimiser import PlacementProblem, run_margins_s

LOOK_BACK_S = 2.0
"""Frames so long before the deadline, or before the confirmation so far, are worth seeing."""
_SMALL_SHARE = 0.1  # of the avoided runs, those with the smallest margins


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WeakSpots:
    """Frames that are worth seeing better.

    Attributes
    ----------
    frame_index : (n,) int
        Frames of the axis.
    probability : (n,) float
        How often each is to be aimed at; they sum to 1, or there is no frame at all.
    vru_m : (n, 3) float
        Middle of the VRU's body. [m]
    """

    frame_index: IntArray
    probability: FloatArray
    vru_m: FloatArray

    def __post_init__(self) -> None:
        for field in ("frame_index", "probability", "vru_m"):
            object.__setattr__(self, field, freeze(np.asarray(getattr(self, field))))

    def __len__(self) -> int:
        return len(self.frame_index)


def find_weak_spots(
    problem: PlacementProblem, pose_index: Sequence[int], runs: Sequence[Run]
) -> WeakSpots:
    """Frames in which a layout should see more.

    Parameters
    ----------
    problem : PlacementProblem
        The table and the rule.
    pose_index : sequence of int
        What is mounted.
    runs : sequence of Run
        Those of the table's axis; the axis may repeat them, world after world.

    Returns
    -------
    spots : WeakSpots
        Of the runs that are not avoided; of those that are lost when one unit fails; of those
        with the smallest margins; and of all: each of these groups, where it is not empty, is
        aimed at as often as the others, and within it each run by its weight.
    """
    axis, rule = problem.table.axis, problem.rule
    counts = (axis.weight > 0.0) & np.isfinite(axis.last_brake_time_s)
    margin = run_margins_s(problem, pose_index)
    latest_s = axis.last_brake_time_s - rule.latency_s - np.where(np.isfinite(margin), margin, 0.0)
    n_frames = np.diff(axis.run_start)
    frame_run = np.repeat(np.arange(axis.n_runs), n_frames)
    before_s = latest_s[frame_run] - axis.time_s
    is_near = (before_s >= 0.0) & (before_s <= LOOK_BACK_S)
    probability = np.zeros(axis.n_frames)
    groups = [group & counts for group in _weak_runs(problem, pose_index, margin)]
    for group in groups:
        frames = np.flatnonzero(is_near & group[frame_run])
        share = axis.weight / np.maximum(np.bincount(frame_run[frames], minlength=axis.n_runs), 1)
        if len(frames):
            part = share[frame_run[frames]]
            probability[frames] += part / part.sum()
    frames = np.flatnonzero(probability)
    return WeakSpots(
        frame_index=frames,
        probability=probability[frames] / max(probability.sum(), 1.0e-300),
        vru_m=_vru_positions_m(runs, axis, frame_run)[frames],
    )


def _weak_runs(
    problem: PlacementProblem, pose_index: Sequence[int], margin: FloatArray
) -> list[BoolArray]:
    """Runs of each group, (n_runs,) each."""
    is_avoided = margin > -np.inf
    is_lost = np.zeros_like(is_avoided)
    for unit in range(len(pose_index)):
        left = [pose for position, pose in enumerate(pose_index) if position != unit]
        is_lost |= is_avoided & ~(run_margins_s(problem, left) > -np.inf)
    groups = [~is_avoided, is_lost, np.ones_like(is_lost)]
    counts = is_avoided & (problem.table.axis.weight > 0.0)
    if counts.any():
        groups.append(is_avoided & (margin <= np.quantile(margin[counts], _SMALL_SHARE)))
    return groups


def _vru_positions_m(runs: Sequence[Run], axis: FrameAxis, frame_run: IntArray) -> FloatArray:
    """Middle of the VRU's body in every frame, (n_frames, 3)."""
    ground = np.concatenate([run.vru_position_m for run in runs])
    heights = [0.5 * run.encounter.vru.height_m for run in runs]
    height = np.repeat(heights, [len(run.time_s) for run in runs])
    once = np.column_stack([ground, height])
    return np.tile(once, (axis.n_frames // len(once), 1))
