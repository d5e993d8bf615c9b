"""Small instances of weighted best-of coverage, and their best sets by going through all."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from hypothesis import strategies as st

from placement.optimiser.bounds import Coverage, Supply


@st.composite
def coverages(
    draw: st.DrawFn, max_poses: int = 9, max_units: int = 4, *, has_money: bool | None = None
) -> Coverage:
    """Any values, among them 0 and 1 alone; sites with room for one or two; with money or without.

    Sizes are Hypothesis's, what stands in the tables is random.
    """
    n_poses = draw(st.integers(1, max_poses))
    n_rows = draw(st.integers(1, 6))
    n_sites = draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = random.random((n_poses, n_rows))
    values[random.random(values.shape) < draw(st.sampled_from([0.0, 0.3, 0.7]))] = 0.0
    if draw(st.booleans()):
        values = np.ceil(values)
    with_money = draw(st.booleans()) if has_money is None else has_money
    return Coverage(
        values=values.astype(draw(st.sampled_from([np.float32, np.float64]))),
        supply=Supply(
            max_units=draw(st.integers(1, max_units)),
            site_index=random.integers(0, n_sites, n_poses),
            site_capacity=random.integers(1, 3, n_sites),
            unit_cost_eur=random.integers(0, 5, n_poses) if with_money else None,
            site_cost_eur=random.integers(0, 3, n_sites) if with_money else None,
            budget_eur=float(random.integers(0, 10)) if with_money else np.inf,
        ),
        reached=random.random(n_rows) * draw(st.sampled_from([0.0, 0.5])),
    )


def feasible_sets(coverage: Coverage) -> Iterator[list[int]]:
    """All sets of poses within units, sites and money, the empty one among them."""
    supply = coverage.supply
    for n_units in range(min(supply.max_units, coverage.n_poses) + 1):
        for units in combinations(range(coverage.n_poses), n_units):
            poses = list(units)
            sites = [int(supply.site_index[pose]) for pose in poses]
            cost = sum(supply.unit_cost_eur[poses]) + sum(supply.site_cost_eur[list(set(sites))])
            has_room = all(sites.count(site) <= supply.site_capacity[site] for site in sites)
            if has_room and cost <= supply.budget_eur + 1e-6:
                yield poses


def value_of(coverage: Coverage, poses: list[int]) -> float:
    """f of a set, row by row."""
    total = 0.0
    for row in range(coverage.n_rows):
        reached = [float(coverage.values[pose, row]) for pose in poses]
        total += max([float(coverage.floor[row]), *reached])
    return total


def best_value(coverage: Coverage) -> float:
    """The most that a feasible set is worth."""
    return max(value_of(coverage, poses) for poses in feasible_sets(coverage))
