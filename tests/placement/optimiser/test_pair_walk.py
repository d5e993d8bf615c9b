"""The walk through pairs beside a unit against all sets, on small tables."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.arrays import IntArray
from placement.optimiser import PlacementProblem, pair_walk, presolve
from placement.optimiser.bitsets import union_apr, unions_of
from placement.optimiser.limits import are_allowed
from placement.optimiser.pair_walk import PairWalk
from placement.optimiser.presolve import ReducedProblem
from placement.optimiser.set_tree import build_links


def all_sets(reduced: ReducedProblem, n_units: int) -> IntArray:
    numbers = np.array(list(combinations(range(reduced.n_poses), n_units)), dtype=np.int64)
    return numbers[are_allowed(reduced.limits, numbers.reshape(-1, n_units))]


def numbered(sets: IntArray) -> IntArray:
    """A number for each set, whatever the order of its poses."""
    return np.sort(sets, axis=1) @ (1000 ** np.arange(sets.shape[1]))


@given(problem=st.from_type(PlacementProblem), place=st.floats(0.0, 1.0), seed=st.integers(0, 99))
def test_a_walk_meets_every_set_that_reaches_the_need(
    problem: PlacementProblem, place: float, seed: int
) -> None:
    problem = replace(problem, limits=replace(problem.limits, budget_units=2 + seed % 2))
    reduced = presolve(problem)
    n_units = reduced.limits.max_units
    if not (2 <= n_units <= 3) or not len(reduced.weight) or reduced.n_poses < n_units:
        return
    sets = all_sets(reduced, n_units)
    if not len(sets):
        return
    # Weights of its own: as where worlds count by how bad they are.
    weight = reduced.weight * np.random.default_rng(seed).uniform(0.0, 2.0, len(reduced.weight))
    reduced = replace(reduced, measure=replace(reduced.measure, weight=weight))
    share = union_apr(reduced, unions_of(reduced, sets))
    need = float(np.quantile(share, place, method="nearest"))
    links = build_links(reduced)
    walk = PairWalk(reduced, links, weight, n_units=n_units, need=need)
    with pytest.MonkeyPatch.context() as patch:
        if seed % 3 == 0:  # as where a class promises much
            patch.setattr(pair_walk, "_FEW_PAIRS", 0)
        parts = [np.empty((0, n_units), dtype=np.int64)]
        for block in walk.blocks(np.inf):
            parts.append(block)
            is_met = np.isin(*(numbered(some) for some in (sets, np.concatenate(parts))))
            assert walk.left_limit >= share[~is_met].max(initial=0.0) - 1e-9  # cut off here
        met = np.concatenate(parts)
    assert walk.is_finished
    assert walk.root_limit >= share.max() - 1e-9
    rest = walk.again(need + 0.5 * (share.max() - need))
    assert sum(map(len, rest.blocks(np.inf))) == (share >= rest.need - 1e-9).sum()
    expected = sorted(tuple(sorted(units)) for units in sets[share >= need - 1e-9].tolist())
    assert sorted(tuple(sorted(units)) for units in met.tolist()) == expected


def test_more_units_than_three_are_refused() -> None:
    with pytest.raises(ValueError, match=r"n_units: got 4; expected 2 \.\. 3"):
        PairWalk(*[None] * 3, n_units=4, need=0.0)  # type: ignore[arg-type]
