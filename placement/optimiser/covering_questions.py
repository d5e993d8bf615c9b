"""What is asked of a covering instance: a target or a budget, checked; how long to look."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted

from .covering_instance import CoveringInstance

TOLERANCE = 1.0e-9
"""Of sums of weights and of costs, relative to the largest sum there can be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoveringBudget:
    """What may be chosen.

    Attributes
    ----------
    units : int, optional
        At most so many columns; by default any number.
    cost : float, optional
        At most so much money; by default any.
    """

    units: int | None = None
    cost: float | None = None

    def __post_init__(self) -> None:
        if self.units is None and self.cost is None:
            raise InputError("--budget", Unquoted("nothing"), "a number of columns, or money")
        if self.units is not None and self.units < 1:
            raise InputError("--budget", self.units, "a whole number of columns, at least 1")
        if self.cost is not None and not 0.0 <= self.cost < math.inf:
            raise InputError("--budget-cost", self.cost, "an amount of money, at least 0")

    @property
    def money(self) -> float:
        """Most that may be spent, with what sums may be off by; infinite if there is no limit."""
        return math.inf if self.cost is None else self.cost * (1.0 + TOLERANCE)

    def allows(self, cost: ArrayLike) -> bool:
        """Whether columns at these costs may be chosen together."""
        costs = np.asarray(cost, dtype=np.float64)
        return (self.units is None or len(costs) <= self.units) and bool(costs.sum() <= self.money)


def simplify_budget(instance: CoveringInstance, budget: CoveringBudget) -> CoveringBudget:
    """Check that money buys anything; where all columns cost the same, it is a number of them.

    Parameters
    ----------
    instance : CoveringInstance
        What is to be chosen from.
    budget : CoveringBudget
        What was given.

    Returns
    -------
    budget : CoveringBudget
        Allows the same useful columns.

    Raises
    ------
    InputError
        There is less money than the cheapest useful column costs.
    """
    is_useful = np.asarray(instance.covers @ instance.weight) > 0.0
    if budget.cost is None or not is_useful.any():
        return budget
    prices = np.unique(instance.cost[is_useful])
    if prices[0] > budget.money:
        raise InputError(
            "--budget-cost",
            budget.cost,
            f"at least {prices[0]:g}, the least cost of a column that covers anything",
        )
    if len(prices) > 1 or prices[0] == 0.0:
        return budget
    units = int(min(budget.money / prices[0], instance.n_columns))
    return CoveringBudget(units=units if budget.units is None else min(units, budget.units))


def needed_weight(instance: CoveringInstance, target: float | None) -> float | None:
    """Weight that a target asks for.

    Parameters
    ----------
    instance : CoveringInstance
        What is to be covered.
    target : float or None
        Share of the weight of all rows; None: all that can be covered.

    Returns
    -------
    weight : float or None
        None if every row that can be covered is needed.

    Raises
    ------
    InputError
        The target is no share, or all columns together do not reach it.
    """
    if target is None:
        return None
    if not 0.0 <= target <= 1.0:
        raise InputError("--target", target, "max, or a share of the weight, 0 to 1")
    total, coverable = float(instance.weight.sum()), instance.coverable_weight
    needed = (target - TOLERANCE) * total
    if needed > coverable:
        most = math.floor(1.0e6 * coverable / total) / 1.0e6
        raise InputError(
            "--target", target, f"at most {most:g}, the share that all columns together cover"
        )
    least = float(instance.weight[instance.weight > 0.0].min(initial=math.inf))
    if needed > coverable - least:
        return None
    return float(np.ceil(needed)) if is_whole(instance.weight) else max(needed, 0.0)


def is_whole(amounts: FloatArray) -> bool:
    """Whether all are whole numbers, so that their sums are, too."""
    return bool((amounts == np.round(amounts)).all())


def check_effort(*, time_limit_s: float, gap: float) -> None:
    """Check how long to look and how near is near enough.

    Raises
    ------
    InputError
        The time is not positive, or the gap is no share.
    """
    if not time_limit_s > 0.0:
        raise InputError("--time-limit", time_limit_s, "seconds, more than 0")
    if not 0.0 <= gap < 1.0:
        raise InputError("--gap", gap, "a share, 0 <= gap < 1")
