import numpy as np
import pytest
from coverages import coverages, feasible_sets
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.bounds import Coverage, Supply

SEED = st.integers(0, 2**32 - 1)


@given(coverages(has_money=False), SEED)
def test_pick_without_money_is_the_best_set(coverage: Coverage, seed: int) -> None:
    worth = np.random.default_rng(seed).normal(size=coverage.n_poses)
    pick = coverage.supply.pick(worth)
    best = max(sum(worth[poses]) for poses in feasible_sets(coverage))
    assert pick.limit == pytest.approx(best)
    assert pick.limit == pytest.approx(worth[pick.poses].sum())
    assert coverage.supply.allows(pick.poses)


@given(coverages(has_money=True), SEED)
def test_pick_with_money_is_a_limit_that_its_own_shares_reach(
    coverage: Coverage, seed: int
) -> None:
    worth = np.random.default_rng(seed).normal(size=coverage.n_poses)
    supply = coverage.supply
    pick = supply.pick(worth)
    best = max(sum(worth[poses]) for poses in feasible_sets(coverage))
    assert pick.limit >= best - 1e-9
    assert pick.limit == pytest.approx(worth[pick.poses] @ pick.shares, abs=1e-6)
    assert supply.prices_eur[pick.poses] @ pick.shares <= supply.budget_eur + 1e-5
    assert pick.shares.sum() <= supply.max_units + 1e-9


@given(coverages(max_units=3), SEED)
def test_pick_with_groups_is_a_limit(coverage: Coverage, seed: int) -> None:
    random = np.random.default_rng(seed)
    worth = random.normal(size=coverage.n_poses)
    at_site = [np.flatnonzero(coverage.supply.site_index == site) for site in range(4)]
    groups = tuple(group[random.random(len(group)) < 0.7] for group in at_site if len(group))
    supply = coverage.supply.with_groups(groups[: random.integers(0, 3)])
    sets = [
        poses
        for poses in feasible_sets(coverage)
        if all(set(group.tolist()) & set(poses) for group in supply.groups)
    ]
    best = max((sum(worth[poses]) for poses in sets), default=-np.inf)
    assert supply.pick(worth).limit >= best - 1e-9
    assert all(supply.allows(np.array(poses, dtype=np.int64)) for poses in sets)


@given(coverages())
def test_what_is_allowed_and_what_can_join_agree_with_all_sets(coverage: Coverage) -> None:
    supply = coverage.supply
    feasible = {tuple(poses) for poses in feasible_sets(coverage)}
    for poses in feasible:
        chosen = np.array(poses, dtype=np.int64)
        can = supply.has_room(chosen)
        for pose in range(coverage.n_poses):
            is_set = pose not in poses and tuple(sorted((*poses, pose))) in feasible
            assert can[pose] == is_set
    pairs = np.column_stack(np.triu_indices(coverage.n_poses, k=1))
    assert supply.allows_each(pairs).tolist() == [
        tuple(pair) in feasible for pair in pairs.tolist()
    ]


def test_site_is_paid_once() -> None:
    supply = Supply(
        max_units=3,
        site_index=np.array([0, 0, 1]),
        site_capacity=np.array([2, 1]),
        unit_cost_eur=np.array([1.0, 2.0, 4.0]),
        site_cost_eur=np.array([10.0, 20.0]),
        budget_eur=13.0,
    )
    assert supply.cost_eur(np.array([0, 1])) == 13.0
    assert supply.has_room(np.array([0])).tolist() == [False, True, False]
    assert supply.prices_eur.tolist() == [6.0, 7.0, 24.0]


def test_costs_are_checked() -> None:
    with pytest.raises(ValueError, match="unit_cost_eur"):
        Supply(
            max_units=1,
            site_index=np.array([0]),
            site_capacity=np.array([1]),
            unit_cost_eur=np.array([-1.0]),
        )
