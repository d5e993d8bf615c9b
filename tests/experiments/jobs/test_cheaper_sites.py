"""What cheaper sites would give, against all exchanges of a unit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from experiments.jobs import cheaper_sites
from placement.optimiser import (
    is_feasible,
    placement_value,
    presolve,
    solve_placement,
)


def prices_of(problem, seed):
    """Sites of any price, some of them alike; sensors of 1,500 EUR."""
    rng = np.random.default_rng(seed)
    limits = problem.limits
    return cheaper_sites._Prices(
        sensor_eur=np.full(problem.table.n_poses, 1500.0),
        site_eur=rng.choice([0.0, 1000.0, 300_000.0], limits.n_sites),
        site_of=limits.site_index,
    )


def is_worth_it(problem, prices, before, after):
    """True if an exchange saves enough for what it loses."""
    saved_eur = prices.of(before) - prices.of(after)
    was = placement_value(problem, before)
    now = placement_value(problem, after)
    lost = max(was.apr - now.apr, was.apr_one_failed - now.apr_one_failed)
    return saved_eur >= 500.0 and lost < 0.002 * saved_eur / 1000.0


@given(problems(), st.integers(0, 2**32 - 1))
def test_what_is_found_is_worth_it_and_is_missed_only_where_presolve_dropped_it(
    problem, seed
):
    chosen = tuple(solve_placement(problem).pose_index)
    prices = prices_of(problem, seed)
    reduced = presolve(problem)
    found = cheaper_sites.find_cheaper(problem, reduced, chosen, prices)
    exchanges = [
        (*chosen[:place], int(row), *chosen[place + 1 :])
        for place in range(len(chosen))
        for row in reduced.pose_index
    ]
    good = [
        after
        for after in exchanges
        if is_feasible(problem, after) and is_worth_it(problem, prices, chosen, after)
    ]
    if found == chosen:
        assert not good or problem.fusion == "single"
        return
    assert is_feasible(problem, found)
    assert is_worth_it(problem, prices, chosen, found)
