"""Layouts that lose next to nothing and cost less: one sentence below the answer.

Money is the last objective, so that a dearer pole that gains a tenth of a point is
taken. Cheaper ones are found by exchanging units one by one on the detection table: at
once, and without a proof.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from geometry.arrays import FloatArray, IntArray
from placement.cache import cached_value
from placement.optimiser import (
    PlacementProblem,
    PlacementValue,
    ReducedProblem,
    is_feasible,
    placement_value,
)
from placement.optimiser.bitsets import shares_with_each
from placement.optimiser.solve import units_of
from placement.wishes import site_price_eur

from ..language import tr
from ..results.numbers import euros, joined, percent
from .search import FoundLayout
from .solve import GIVEN_UP

LOSS_PER_EUR = 0.002 / 1000.0
"""A cheaper layout is named if each 1,000 EUR that it saves cost less than 0.2 points
of the APR, and of what is left when a unit fails.
"""
LEAST_SAVED_EUR = 500.0
# The cheapest exchanges of a unit that are looked at closely: each takes a millisecond.
_MOST_TRIED = 60


class _Prices(NamedTuple):
    """What poses cost: each sensor, and each site once, in euros."""

    sensor_eur: FloatArray  # (n_poses,); 0 of those that exist
    site_eur: FloatArray  # (n_sites,); 0 of those that carry existing units
    site_of: IntArray  # (n_poses,): the site of each pose

    def of(self, poses: Sequence[int]) -> float:
        """Cost of a set of poses."""
        rows = np.asarray(poses, dtype=np.int64)
        sites = np.unique(self.site_of[rows])
        return float(self.sensor_eur[rows].sum() + self.site_eur[sites].sum())


def cheaper_sentence(found: FoundLayout) -> str:
    """What cheaper sites would give, in words; empty where that is not known.

    Of a layout that is sought for its APR, in one world, as it was found on the grid.
    """
    placement = found.placement
    problem = placement.problem
    is_asked = (
        problem.goal == "best"
        and problem.fusion == "any"
        and problem.sample_index is None
        and found.refinement is None
        and placement.presolved is not None
    )
    if not is_asked:
        return ""
    # The least APR is that of the highest: a layout may be worth less for the money.
    floors = tuple(floor for floor in problem.floors if floor.name != GIVEN_UP)
    problem = replace(problem, floors=floors)
    prices = _prices(found)
    # As it was solved: to presolve it anew takes longer than all else here.
    reduce = placement.presolved
    assert reduce is not None
    chosen = placement.pose_index
    after = cached_value(
        found.job.compute.cache_folder,
        "cheaper",
        lambda: find_cheaper(problem, reduce(), chosen, prices),
        kind=tuple[int, ...],
        made_from=(problem, chosen, prices),
    )
    if after == chosen:
        return ""
    value = placement_value(problem, after)
    moved = [
        tr("{unit} at {site}", unit=unit.id, site=found.poses[row].site_id)
        for unit, row in zip(placement.layout.units, after, strict=True)
        if row not in chosen
    ]
    return tr(
        "Cheaper sites would give {apr}, and {left} if one sensor fails, for {saved}"
        " less: {units} (planning model; found, not proven).",
        apr=percent(value.apr),
        left=percent(value.apr_one_failed),
        saved=euros(prices.of(chosen) - prices.of(after)),
        units=joined(moved),
    )


def find_cheaper(
    problem: PlacementProblem,
    reduced: ReducedProblem,
    chosen: tuple[int, ...],
    prices: _Prices,
) -> tuple[int, ...]:
    """Poses that save money and lose next to nothing, unit by unit as `chosen`.

    Unit after unit is exchanged for the pose that saves most, as long as the whole of
    what is saved is worth it. Limits and floors of the problem hold. `chosen` itself
    where no exchange is. Only poses of the reduced problem are tried.
    """
    best = placement_value(problem, chosen)
    cost_eur = prices.of(chosen)
    now = chosen
    for place, row in enumerate(chosen):
        # What exists is paid, and stays.
        if problem.limits.is_forced[row]:
            continue
        others = [*now[:place], *now[place + 1 :]]
        share = shares_with_each(reduced, units_of(reduced, np.array(others)))
        rows = reduced.pose_index
        sites = prices.site_of[rows]
        is_paid = np.isin(sites, prices.site_of[others])
        site_eur = np.where(is_paid, 0.0, prices.site_eur[sites])
        saved_eur = cost_eur - prices.of(others) - prices.sensor_eur[rows] - site_eur
        lost = best.apr - share
        is_worth_it = (saved_eur >= LEAST_SAVED_EUR) & (lost < LOSS_PER_EUR * saved_eur)
        is_worth_it &= saved_eur > cost_eur - prices.of(now)
        # What saves most first, and of that what loses least.
        order = np.lexsort((lost, -saved_eur))
        for index in order[is_worth_it[order]][:_MOST_TRIED].tolist():
            after = (*now[:place], int(rows[index]), *now[place + 1 :])
            if is_feasible(problem, after) and _keeps(
                placement_value(problem, after), best, saved_eur[index]
            ):
                now = after
                break
    return now


def _keeps(value: PlacementValue, best: PlacementValue, saved_eur: float) -> bool:
    """True if little enough is lost for the money, also when a unit fails."""
    lost = max(best.apr - value.apr, best.apr_one_failed - value.apr_one_failed)
    return lost < LOSS_PER_EUR * saved_eur


def _prices(found: FoundLayout) -> _Prices:
    """Prices of all poses: what sites say, or else what is assumed of their kind."""
    limits = found.placement.problem.limits
    site_cost_eur = found.job.question.site_cost_eur
    prices_eur = {
        site.id: site_price_eur(site, site_cost_eur) for site in found.job.scene.sites
    }
    # A mount of its own costs what was asked for all.
    own_eur = site_cost_eur or 0.0
    sensor_eur = np.array([pose.sensor.price_eur for pose in found.poses])
    sensor_eur[limits.is_forced] = 0.0
    site_eur = np.zeros(limits.n_sites)
    site_eur[limits.site_index] = [
        prices_eur.get(pose.site_id, own_eur) for pose in found.poses
    ]
    site_eur[limits.site_index[limits.is_forced]] = 0.0
    return _Prices(sensor_eur=sensor_eur, site_eur=site_eur, site_of=limits.site_index)
