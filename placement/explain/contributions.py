"""Contribution of each unit to a layout, and the achievement of the others when units fail."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from scenarios.aeb import AebRule, live_confirmation_time_s

from ..optimiser import PlacementProblem, PlacementValue, placement_value, run_margins_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contribution:
    """The contribution of one unit of a set, on the detection table.

    Attributes
    ----------
    pose_index : int
        Row of the table.
    only_runs : (n,) int
        Runs with weight that are avoided with it and not without it.
    marginal_apr : float
        APR of the whole set less that of the others, 0..1.
    without : PlacementValue
        What the others are worth.
    mean_delay_s : float
        By how much later, on average by weight, the runs that the others avoid, too, are confirmed
        without it. [s]
    max_delay_s : float
        The most of it in any of these runs. [s]
    first_share : float
        Its part in the confirmations for which the runs that the set avoids are braked for, by
        weight: of the tracks that are alive at the last moment. The parts of all units sum to 1,
        or are 0 where nothing is avoided.
    """

    pose_index: int
    only_runs: IntArray
    marginal_apr: float
    without: PlacementValue
    mean_delay_s: float
    max_delay_s: float
    first_share: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "only_runs", freeze(self.only_runs))


def find_contributions(
    problem: PlacementProblem, pose_index: Sequence[int]
) -> tuple[Contribution, ...]:
    """The contribution of each unit of a set, in order; limits and floors do not matter."""
    poses = list(pose_index)
    value, margin_s = placement_value(problem, poses), run_margins_s(problem, poses)
    shares = first_shares(problem, poses)
    weight = problem.table.axis.weight
    found = []
    for position, pose in enumerate(poses):
        others = poses[:position] + poses[position + 1 :]
        left_s = run_margins_s(problem, others)
        stays = left_s > -np.inf
        counts = stays & (weight > 0.0)
        # Subtracted only where both are times: a run that nobody avoids has no margin.
        delay_s = np.where(counts, margin_s, 0.0) - np.where(counts, left_s, 0.0)
        without = placement_value(problem, others)
        share = float(weight[counts].sum())
        found.append(
            Contribution(
                pose_index=pose,
                only_runs=np.flatnonzero((margin_s > -np.inf) & ~stays & (weight > 0.0)),
                marginal_apr=value.apr - without.apr,
                without=without,
                mean_delay_s=float(delay_s @ weight) / share if share else 0.0,
                max_delay_s=float(delay_s.max(initial=0.0)),
                first_share=float(shares[position]),
            )
        )
    return tuple(found)


def first_shares(problem: PlacementProblem, pose_index: Sequence[int]) -> FloatArray:
    """Parts of units in the confirmations of the runs that they avoid together, (n_units,).

    With fusion "any", each frame of the window that confirms the track which is alive at the last
    moment is shared equally by the units that detect in it; a unit's part is the mean over the
    window's frames. With "single", the units whose live track is confirmed first share the run
    equally. Runs count by weight.
    """
    axis, rule = problem.table.axis, problem.rule
    shares = np.zeros(len(pose_index))
    is_avoided = run_margins_s(problem, pose_index) > -np.inf
    counted = np.flatnonzero(is_avoided & (axis.weight > 0.0))
    if not len(counted):
        return shares
    detected = problem.table.detected(list(pose_index))
    for run in counted:
        frames = axis.frames_of(int(run))
        until_s = float(axis.last_brake_time_s[run]) - rule.latency_s
        parts_of = _parts_of_window if problem.fusion == "any" else _parts_of_firsts
        parts = parts_of(detected[:, frames], axis.time_s[frames], until_s, rule)
        shares += axis.weight[run] * parts
    total: FloatArray = shares / axis.weight[counted].sum()
    return total


def _parts_of_window(
    detected: BoolArray, time_s: FloatArray, until_s: float, rule: AebRule
) -> FloatArray:
    """Of one run that some units avoid together, (n_units, n_frames) -> (n_units,)."""
    together = detected.any(axis=0)
    confirmed_s = float(live_confirmation_time_s(together, time_s, until_s=until_s, rule=rule))
    last = int(np.searchsorted(time_s, confirmed_s))
    window = detected[:, last + 1 - rule.n_confirmations : last + 1]
    parts: FloatArray = (window / window.sum(axis=0)).mean(axis=1)
    return parts


def _parts_of_firsts(
    detected: BoolArray, time_s: FloatArray, until_s: float, rule: AebRule
) -> FloatArray:
    """Of one run that some unit avoids by itself, (n_units, n_frames) -> (n_units,)."""
    confirmed_s = live_confirmation_time_s(detected, time_s, until_s=until_s, rule=rule)
    is_first = confirmed_s == confirmed_s.min()
    parts: FloatArray = is_first / is_first.sum()
    return parts
