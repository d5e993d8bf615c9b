"""The reduced problem in which no pose has made room for another one."""

from dataclasses import replace

import numpy as np

from ..optimiser import Limits, PlacementProblem, ReducedProblem, presolve


def presolve_undominated(problem: PlacementProblem) -> ReducedProblem:
    """The reduced problem with every pose that detects anything that counts, dominated or not.

    Where every site carries as many units as there are poses, and any number may be mounted, no
    pose stands in another one's way: presolve drops only poses that detect nothing.
    """
    limits = problem.limits
    unusable = limits.is_forbidden | (limits.site_capacity[limits.site_index] == 0)
    free = Limits(
        site_index=limits.site_index,
        site_capacity=np.full(limits.n_sites, limits.n_poses),
        unit_cost_eur=limits.unit_cost_eur,
        site_cost_eur=limits.site_cost_eur,
        is_forced=limits.is_forced,
        is_forbidden=unusable,
        is_forced_site=limits.is_forced_site,
    )
    reduced = presolve(replace(problem, limits=free))
    return replace(reduced, limits=limits.of_poses(reduced.pose_index))
