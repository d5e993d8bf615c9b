"""How good a layout can be at best, told from all poses together without choosing any.

Like :mod:`placement.recomputation`, this shares nothing with the optimiser, which it checks.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import IntArray

from .layout import Stage
from .recomputation import (
    EPSILON,
    EPSILON_EUR,
    LEAST_IS_BEST,
    WEIGHTED,
    apr_of_margins,
    costs_eur,
    margins_of_all_s,
)

if TYPE_CHECKING:
    from .optimiser import PlacementProblem


def usable_poses(problem: "PlacementProblem") -> IntArray:
    """Poses that some layout can contain."""
    limits = problem.limits
    has_room = limits.site_capacity[limits.site_index] > 0
    poses: IntArray = np.flatnonzero(has_room & ~limits.is_forbidden)
    return poses


def most_units(problem: "PlacementProblem") -> int:
    """No layout has more units."""
    limits, usable = problem.limits, usable_poses(problem)
    most = sum(
        min(int(limits.site_capacity[site]), int((limits.site_index[usable] == site).sum()))
        for site in np.unique(limits.site_index[usable])
    )
    if limits.budget_units is not None:
        most = min(most, limits.budget_units)
    if limits.budget_eur is not None:
        spent = np.cumsum(np.sort(limits.unit_cost_eur[usable]))
        most = min(most, int((spent <= limits.budget_eur + EPSILON_EUR).sum()))
    return most


def simple_limits(problem: "PlacementProblem", stages: Sequence[Stage]) -> dict[str, float]:
    """What no layout can be better than in each stage, by a look at all poses at once.

    Parameters
    ----------
    problem : PlacementProblem
        Table, rule, limits.
    stages : sequence of Stage
        What is claimed of a layout: limits of later stages are of those as good in earlier ones.

    Returns
    -------
    limits : dict of str to float
        By the name of the stage, also of those that the problem does not have.

    Notes
    -----
    The more poses, the earlier each run is confirmed: all usable poses together avoid every run
    that any layout avoids, with the largest margin. If the layout avoids as much as they do, every
    layout as good as it avoids the very same runs, so that their margins bound it.
    """
    limits, weight = problem.limits, problem.table.axis.weight
    usable = usable_poses(problem)
    margin_s = margins_of_all_s(problem, usable)
    counts = (margin_s > -np.inf) & (weight > 0.0)
    most_apr = float(apr_of_margins(problem, margin_s[None, :])[0])
    smallest_s = mean_s = float(margin_s[counts].max(initial=-np.inf)) if counts.any() else 0.0
    claimed = {stage.name: stage.objective for stage in stages}
    if counts.any() and problem.tail == 1.0 and claimed.get("apr", 0.0) >= most_apr - EPSILON:
        smallest_s = float(margin_s[counts].min())
        mean_s = float(np.average(margin_s[counts], weights=weight[counts]))
    most = most_units(problem)
    forced = np.flatnonzero(limits.is_forced)
    price = limits.unit_cost_eur + limits.site_cost_eur[limits.site_index]
    least_eur = float(price[usable].min(initial=np.inf))
    if len(forced):
        least_eur = float(costs_eur(problem, forced[None, :])[0])
    n_open = int(limits.is_forced_site.sum()) - int(
        limits.is_forced_site[np.unique(limits.site_index[forced])].sum()
    )
    found = {
        "units": float(max(1, len(forced) + n_open)),
        "cost_eur": least_eur,
        "apr": most_apr,
        "apr_survived": most_apr if most > problem.survive else 0.0,
        "apr_one_failed": most_apr if most > 1 else 0.0,
        "smallest_margin_s": smallest_s,
        "mean_margin_s": mean_s,
    }
    if problem.stage_weights is not None:
        found["weighted"] = sum(
            weight * (-found[name] if name in LEAST_IS_BEST else found[name])
            for name, weight in zip(WEIGHTED, problem.stage_weights, strict=True)
        )
    return found
