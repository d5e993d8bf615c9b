"""The unit that would gain most next to those of a layout, whatever the budget."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..optimiser import PlacementProblem, ReducedProblem, apr
from ..optimiser.bitsets import avoided_with_each
from ..optimiser.limits import fitting


@dataclass(frozen=True, slots=True, kw_only=True)
class NextUnit:
    """The further unit that greedy choice would add, budgets aside, on the detection table.

    Attributes
    ----------
    pose : str
        Id of the candidate pose.
    apr : float
        Accident prevention ratio with it, 0..1.
    gain : float
        How much higher that is than without.
    """

    pose: str
    apr: float
    gain: float


def find_next_unit(
    problem: PlacementProblem, reduced: ReducedProblem, pose_index: Sequence[int]
) -> NextUnit | None:
    """The pose whose APR together with a layout is the highest, as greedy choice would go on.

    Budgets do not count: this is what one more unit buys. Sites, rivals and wishes do. Another
    layout of as many units may be better still.

    Parameters
    ----------
    problem : PlacementProblem
        With the detection table.
    reduced : ReducedProblem
        What presolve left of it. Poses that fell out see no more than others that are left.
    pose_index : sequence of int
        Rows of the table, all among those left.

    Returns
    -------
    next_unit : NextUnit or None
        None where no further pose fits.
    """
    units = np.flatnonzero(np.isin(reduced.pose_index, pose_index))
    limits = replace(reduced.limits, budget_units=None, budget_eur=None)
    free = np.flatnonzero(fitting(limits, units))
    if not len(free):
        return None
    ratios = reduced.measure.of(avoided_with_each(reduced, units)[free])
    row = int(reduced.pose_index[free[int(ratios.argmax())]])
    with_it = apr(problem, [*pose_index, row])
    gain = with_it - apr(problem, pose_index)
    return NextUnit(pose=problem.table.pose_ids[row], apr=with_it, gain=gain)
