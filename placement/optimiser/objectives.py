"""The objectives of a placement: what they are called, which way is better, and what is a tie.

The search, the certificate, the report and the verification all use these names. In JSON an
objective is its value, such as "apr_one_failed".
"""

from enum import StrEnum
from typing import Literal

from .steering import COST_TOLERANCE_EUR, TOLERANCE

Goal = Literal["best", "fewest", "cheapest"]


class Objective(StrEnum):
    """Something that a layout is optimised for; its value is its name in JSON."""

    UNITS = "units"
    COST = "cost_eur"
    APR_SURVIVED = "apr_survived"
    APR = "apr"
    APR_ONE_FAILED = "apr_one_failed"
    SMALLEST_MARGIN = "smallest_margin_s"
    MEAN_MARGIN = "mean_margin_s"

    @property
    def label(self) -> str:
        """Name in reports."""
        return _LABELS[self]

    @property
    def unit(self) -> str:
        """Unit of its values; empty for counts and shares."""
        if self is Objective.COST:
            return "EUR"
        return "s" if self in (Objective.SMALLEST_MARGIN, Objective.MEAN_MARGIN) else ""

    @property
    def is_minimised(self) -> bool:
        """True if less is better."""
        return self in (Objective.UNITS, Objective.COST)

    @property
    def tolerance(self) -> float:
        """Values that differ by no more are equal."""
        return COST_TOLERANCE_EUR if self is Objective.COST else TOLERANCE

    def excess(self, value: float, other: float) -> float:
        """By how much a value is better than another one; negative if it is worse.

        Examples
        --------
        >>> Objective.APR.excess(0.75, 0.5), Objective.UNITS.excess(3.0, 2.0)
        (0.25, -1.0)
        """
        return other - value if self.is_minimised else value - other

    def is_better(self, value: float, other: float) -> bool:
        """True if a value is better than another one by more than rounding noise."""
        return self.excess(value, other) > self.tolerance

    def better(self, value: float, other: float) -> float:
        """The better one of two values."""
        return min(value, other) if self.is_minimised else max(value, other)

    def worse(self, value: float, other: float) -> float:
        """The worse one of two values."""
        return max(value, other) if self.is_minimised else min(value, other)


_LABELS = {
    Objective.UNITS: "units",
    Objective.COST: "cost",
    Objective.APR_SURVIVED: "APR if the most needed units fail",
    Objective.APR: "APR",
    Objective.APR_ONE_FAILED: "APR if the most needed unit fails",
    Objective.SMALLEST_MARGIN: "smallest time to spare",
    Objective.MEAN_MARGIN: "mean time to spare",
}
VALUE_OBJECTIVES = (
    Objective.APR,
    Objective.APR_ONE_FAILED,
    Objective.SMALLEST_MARGIN,
    Objective.MEAN_MARGIN,
    Objective.COST,
)
"""Objectives by which layouts are compared by default, in this order."""


def objectives_in_order(goal: Goal, *, survive: int) -> tuple[Objective, ...]:
    """Stages of a problem: the goal, then the APR that survives failures, then the usual ones.

    The cost stands in it once: first where the cheapest layout is asked for, else last.

    Examples
    --------
    >>> [str(objective) for objective in objectives_in_order("fewest", survive=1)][:3]
    ['units', 'apr_survived', 'apr']
    """
    goals = {"best": (), "fewest": (Objective.UNITS,), "cheapest": (Objective.COST,)}
    first: tuple[Objective, ...] = goals[goal]
    if survive:
        first = (*first, Objective.APR_SURVIVED)
    return (*first, *(objective for objective in VALUE_OBJECTIVES if objective not in first))
