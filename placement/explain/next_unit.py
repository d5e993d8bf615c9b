"""The unit that would gain most beside those of a layout, whatever the budget."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..optimiser import PlacementProblem, ReducedProblem, apr
from ..optimiser.bitsets import avoided_with_each
from ..optimiser.limits import fitting


@dataclass(frozen=True, slots=True, kw_only=True)
class NextUnit:
    """One further unit beside a layout, on the detection table.

    Attributes
    ----------
    pose_index : int
        Row of the table.
    apr : float
        Accident prevention ratio with it, 0..1.
    """

    pose_index: int
    apr: float


def find_next_unit(
    problem: PlacementProblem, reduced: ReducedProblem, pose_index: Sequence[int]
) -> NextUnit | None:
    """The pose whose APR together with a layout is the highest, as greedy choice would go on.

    Budgets do not count: it is what one more unit buys. Sites, rivals and wishes do. Another layout
    of as many units may be better still.

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
        None where no pose fits beside the layout.
    """
    units = np.flatnonzero(np.isin(reduced.pose_index, pose_index))
    limits = replace(reduced.limits, budget_units=None, budget_eur=None)
    free = np.flatnonzero(fitting(limits, units))
    if not len(free):
        return None
    ratios = reduced.measure.of(avoided_with_each(reduced, units)[free])
    row = int(reduced.pose_index[free[int(ratios.argmax())]])
    return NextUnit(pose_index=row, apr=apr(problem, [*pose_index, row]))
