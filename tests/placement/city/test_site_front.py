"""Fronts of one junction against all layouts there are, with any prices and with kept units."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems

from placement.city import site_front
from placement.city.fronts import value_at
from placement.city.junction import find_front
from placement.optimiser import Effort, apr
from placement.optimiser.limits import cost_eur, is_allowed

TOLERANCE = 1.0e-9


@st.composite
def junctions(draw):
    """A problem whose sites are paid once, at equal or at different prices; a unit may hang."""
    problem = draw(problems())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    limits = problem.limits
    site_cost = np.full(limits.n_sites, 7060.0)
    if draw(st.booleans()):
        site_cost = rng.choice([0.0, 2540.0, 7060.0], limits.n_sites)
    limits = replace(limits, site_cost_eur=site_cost)
    is_forced = np.zeros(limits.n_poses, dtype=bool)
    if draw(st.booleans()) and limits.max_units > 1:
        is_forced[rng.integers(limits.n_poses)] = True
        at = limits.site_index[is_forced]
        limits = replace(
            limits,
            is_forced=is_forced,
            unit_cost_eur=np.where(is_forced, 0.0, limits.unit_cost_eur),
            site_cost_eur=np.where(np.isin(np.arange(limits.n_sites), at), 0.0, site_cost),
        )
    return replace(problem, limits=limits)


@given(junctions(), st.sampled_from([12_000, 3]))
def test_no_layout_exceeds_the_front_of_a_junction(problem, max_sets):
    limits = problem.limits
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(site_front, "_MAX_SETS", max_sets)  # few: poses that see alike go together
        front, layouts = find_front(
            problem, effort=lambda: Effort(time_limit_s=60.0), begin=lambda step: None
        )
    forced = set(np.flatnonzero(limits.is_forced).tolist())
    best = {}
    for n_units in range(max(len(forced), 1), limits.budget_units + 1):
        for chosen in combinations(range(limits.n_poses), n_units):
            if not (forced <= set(chosen) and is_allowed(limits, chosen)):
                continue
            reached, price = apr(problem, chosen), cost_eur(limits, chosen)
            n_new = n_units - len(forced)
            best[n_new] = max(best.get(n_new, 0.0), reached)
            assert reached <= value_at(front.by_units, n_new) + TOLERANCE
            assert reached <= value_at(front.by_cost, price) + TOLERANCE
    for point, layout in zip(front.points, layouts, strict=True):
        assert forced <= set(layout)
        assert point.units == len(layout) - len(forced)
        if layout:
            assert is_allowed(limits, layout)
            assert point.apr == pytest.approx(apr(problem, layout))
            assert point.cost_eur == pytest.approx(cost_eur(limits, layout))
    # By units, the points are the best there are.
    for n_new, most in best.items():
        found = max(point.apr for point in front.points if point.units <= n_new)
        assert found == pytest.approx(max(best[n] for n in best if n <= n_new))
        assert value_at(front.by_units, n_new) >= most - TOLERANCE
