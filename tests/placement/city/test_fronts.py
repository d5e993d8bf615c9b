"""Fronts of one junction against all layouts there are, with any prices and with kept
units.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from problems import problems, random_problem

from placement.city import fronts
from placement.city.fronts import value_at
from placement.city.junction import find_front
from placement.detection_table import pack_table
from placement.optimiser import Effort, Limits, PlacementProblem, apr, presolve
from placement.optimiser.allowed_sets import cost_eur, is_allowed
from placement.optimiser.solve import of_pool

TOLERANCE = 1.0e-9


@st.composite
def junctions(draw):
    """A problem whose sites are paid once, at equal or at different prices; a unit may
    hang.
    """
    problem = draw(problems())
    seeds = st.integers(0, 2**32 - 1)
    seed = draw(seeds)
    rng = default_rng(seed)
    limits = problem.limits
    site_cost = np.full(limits.n_sites, 7060.0)
    if draw(st.booleans()):
        site_cost = rng.choice([0.0, 2540.0, 7060.0], limits.n_sites)

    limits = replace(limits, site_cost_eur=site_cost)
    is_forced = np.zeros(limits.n_poses, dtype=bool)
    if draw(st.booleans()) and limits.max_units > 1:
        is_forced[rng.integers(limits.n_poses)] = True
        at = limits.site_index[is_forced]
        unit_cost_eur = np.where(is_forced, 0.0, limits.unit_cost_eur)
        limits = replace(
            limits,
            is_forced=is_forced,
            unit_cost_eur=unit_cost_eur,
            site_cost_eur=np.where(
                np.isin(np.arange(limits.n_sites), at), 0.0, site_cost
            ),
        )

    return replace(problem, limits=limits)


@pytest.mark.long
@given(junctions(), st.sampled_from([12_000, 3]))
def test_no_layout_exceeds_the_front_of_a_junction(problem, max_sets):
    limits = problem.limits
    with pytest.MonkeyPatch.context() as patch:
        # Few: poses that see alike go together.
        patch.setattr(fronts, "_MAX_SETS", max_sets)
        front, layouts = find_front(
            problem,
            effort=lambda: Effort(time_limit_s=60.0),
            begin=lambda step: None,
        )

    forced_poses = np.flatnonzero(limits.is_forced)
    forced = set(forced_poses.tolist())
    best = {}
    fewest = max(len(forced), 1)
    for n_units in range(fewest, limits.budget_units + 1):
        for chosen in combinations(range(limits.n_poses), n_units):
            if not (forced <= set(chosen) and is_allowed(limits, chosen)):
                continue
            reached = apr(problem, chosen)
            price = cost_eur(limits, chosen)
            n_new = n_units - len(forced)
            best[n_new] = max(best.get(n_new, 0.0), reached)
            best_by_units = value_at(front.by_units, n_new)
            best_by_cost = value_at(front.by_cost, price)

            assert reached <= best_by_units + TOLERANCE
            assert reached <= best_by_cost + TOLERANCE

    for point, layout in zip(front.points, layouts, strict=True):
        n_added = len(layout) - len(forced)

        assert forced <= set(layout)
        assert point.units == n_added

        if layout:
            expected_apr = apr(problem, layout)
            expected_eur = cost_eur(limits, layout)
            assert is_allowed(limits, layout)
            assert point.apr == pytest.approx(expected_apr)
            assert point.cost_eur == pytest.approx(expected_eur)

    # By units, the points are the best there are.
    for n_new, most in best.items():
        found = max(point.apr for point in front.points if point.units <= n_new)
        most_until = max(best[n] for n in best if n <= n_new)
        of_front = value_at(front.by_units, n_new)

        assert found == pytest.approx(most_until)
        assert of_front >= most - TOLERANCE


def many_poses(rng):
    """Two sites with room for two units each, and ten poses at each."""
    problem = next(
        found
        for number in range(100)
        if (found := random_problem(default_rng([1, number]))).table.axis.n_frames > 20
    )
    axis = problem.table.axis
    drawn = rng.random((20, axis.n_frames))
    detected = drawn < 0.3
    limits = Limits(
        site_index=np.arange(20) % 2,
        site_capacity=[2, 2],
        budget_units=4,
        unit_cost_eur=np.full(20, 1500.0),
        site_cost_eur=np.full(2, 7060.0),
    )
    names = map(str, range(20))
    pose_ids = tuple(names)
    table = pack_table(pose_ids, axis, detected)
    rule = replace(problem.rule, n_confirmations=2, track_memory_s=0.3)
    return PlacementProblem(
        table=table,
        limits=limits,
        fusion="any",
        rule=rule,
    )


def test_poses_that_see_alike_still_give_a_layout_for_each_number_of_sites():
    problem = many_poses(default_rng(1))
    reduced = presolve(problem)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fronts, "_MAX_SETS", 3)
        bounds, layouts, are_best = fronts._front_of_full_sites(
            problem,
            reduced,
            fronts.rooms_of(problem.limits),
            max_sites=2,
            effort=Effort,
        )

    assert not are_best
    assert sorted(layouts) == [1, 2]

    for n_sites, layout in layouts.items():
        reached = apr(problem, layout)

        assert len(layout) == 2 * n_sites
        assert is_allowed(problem.limits, layout)
        assert reached <= bounds[n_sites - 1] + TOLERANCE


@pytest.mark.long
def test_a_front_is_no_worse_than_that_of_few_of_its_poses():
    problem = many_poses(default_rng(2))
    first = np.array([0, 1, 2, 3, 10, 11, 12, 13])
    ask = {"effort": lambda: Effort(time_limit_s=60.0), "begin": lambda step: None}
    first_poses = of_pool(problem, first)
    few, _ = find_front(first_poses, **ask)

    def finds_nothing(part, **options):
        found = fronts.front_by_sites(part, **options)
        if part.limits.n_poses == len(first):
            return found
        return replace(found, layouts=())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("placement.city.junction.front_by_sites", finds_nothing)
        front, layouts = find_front(problem, **ask, first=first)

    for point in few.points:
        assert any(
            other.units <= point.units
            and other.cost_eur <= point.cost_eur + TOLERANCE
            and other.apr >= point.apr - TOLERANCE
            for other in front.points
        )

    for layout in layouts[1:]:
        assert is_allowed(problem.limits, layout)
