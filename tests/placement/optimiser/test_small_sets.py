from itertools import combinations

import numpy as np
import pytest
from coverages import coverages, feasible_sets, value_of
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.bounds import Coverage, Supply
from placement.optimiser.enumeration import best_sets


@given(coverages(max_poses=10, max_units=3), st.floats(0.3, 1.05))
def test_all_sets_above_the_need_are_found(coverage: Coverage, share: float) -> None:
    n_units = coverage.supply.max_units
    values = {
        tuple(poses): value_of(coverage, poses)
        for poses in feasible_sets(coverage)
        if len(poses) == n_units
    }
    need = share * max(values.values(), default=1.0)
    found = best_sets(coverage, need, workers=2)
    assert found is not None
    reached = dict(zip(map(tuple, found.sets.tolist()), found.values.tolist(), strict=True))
    for poses, value in values.items():
        if abs(value - need) > 1e-6:
            assert (poses in reached) == (value > need)
        if poses in reached:
            assert reached[poses] == pytest.approx(value, rel=1e-6)
    assert len(reached) == len(found.sets) <= found.n_looked_at


@given(st.integers(0, 2**32 - 1), st.floats(0.9, 1.0))
def test_triples_among_more_poses_than_a_block_are_all_found(seed: int, share: float) -> None:
    random = np.random.default_rng(seed)
    # A few strong poses and many weak ones: the apexes leave blocks of all shapes over.
    values = random.random((90, 20)) ** random.choice([1, 4, 9], (90, 1))
    supply = Supply(
        max_units=3, site_index=random.integers(0, 20, 90), site_capacity=np.full(20, 2)
    )
    coverage = Coverage(values=values, supply=supply)
    triples = np.array(list(combinations(range(90), 3)))
    worth = values[triples].max(axis=1).sum(axis=1)
    worth[~supply.allows_each(triples)] = -np.inf
    need = share * worth.max()
    found = best_sets(coverage, need)
    assert found is not None
    order = np.lexsort(found.sets.T[::-1])
    np.testing.assert_array_equal(found.sets[order], triples[worth > need])


def test_too_many_triples_are_given_up() -> None:
    coverage = Coverage(
        values=np.ones((10, 2)),
        supply=Supply(max_units=3, site_index=np.arange(10), site_capacity=np.ones(10, np.int64)),
    )
    assert best_sets(coverage, 1.0, max_triples=119) is None
    found = best_sets(coverage, 1.0, max_triples=120)
    assert found is not None
    assert len(found.sets) == 120


def test_more_than_three_units_are_refused() -> None:
    supply = Supply(max_units=4, site_index=np.arange(5), site_capacity=np.ones(5, np.int64))
    with pytest.raises(ValueError, match="4 units"):
        best_sets(Coverage(values=np.ones((5, 2)), supply=supply), 0.0)
