"""Numbers below which a difference means nothing, and the reason for each.

Two kinds must not be mixed up. A tie says which values are equal, which is part of what "best"
means. What rounding or a solver may err by says how far a computed bound can be believed: it proves
a value only if no other value can lie in between.
"""

import numpy as np

from geometry.arrays import FloatArray

TOLERANCE = 1.0e-9
"""Shares and times that differ by no more count as equal: they carry rounding noise."""
COST_TOLERANCE_EUR = 1.0e-6
"""Sums of prices that differ by no more are equal."""
ROUNDING = 1.0e-9
"""Relative: sums of float64 values in another order, and exchanges that gain no more than that."""
ROUNDING_SINGLE = 2.0e-6
"""Relative: sums of values that were rounded to float32, 6e-8 each, err by less."""
SOLVER_TOLERANCE = 1.0e-6
"""HiGHS meets rows, whole numbers and gaps up to this, relative to the sums it is handed."""
SOLVER_SUM = 1.0e4
"""What an objective's coefficients are scaled to in sum: HiGHS's tolerances are absolute."""
HELD_SLACK = 1.0e-3
"""Of the mean weight: rows that hold an earlier stage are relaxed by it, well above HiGHS's own
tolerance. Asking for a sum to the last digit made it call feasible problems infeasible. Answers are
checked exactly anyway."""
TINY = 1.0e-300
"""Keeps a sum of nothing from being divided by."""
MOST_STEPS = 1.0e5
"""A step between values is told from a solver's error where no value is more steps than this."""


def common_step(amounts: FloatArray) -> float:
    """What non-negative amounts are whole multiples of: the least of them; 0 where they are not.

    Nor is there a step where the amounts sum up to more than :data:`MOST_STEPS` of it.

    Examples
    --------
    >>> common_step(np.array([0.25, 0.0, 0.75])), common_step(np.array([0.25, 0.6]))
    (0.25, 0.0)
    """
    positive = amounts[amounts > 0.0]
    if not len(positive) or positive.sum() > MOST_STEPS * positive.min():
        return 0.0
    count = positive / positive.min()
    is_whole = np.abs(count - count.round()) <= ROUNDING * count
    return float(positive.min()) if is_whole.all() else 0.0


def settle(value: float, bound: float, limit: float, *, step: float = 0.0) -> float:
    """Upper bound of a stage from what a solver says; `limit` holds without it.

    All possible values are whole multiples of `step`, where that is not 0: then a bound proves the
    value that it exceeds by less than a step. Else it proves the value that it equals.
    """
    error = SOLVER_TOLERANCE * max(1.0, abs(value))
    if bound < value - error:
        return limit  # the solver errs: a set with this value is at hand
    return value if bound <= value + max(TOLERANCE, step - error) else min(limit, bound)
