from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser import PlacementProblem, is_feasible, presolve
from placement.optimiser.bitsets import best_set, set_values
from placement.optimiser.enumeration import best_of_all
from placement.optimiser.objectives import Objective

ANY_PROBLEM = st.from_type(PlacementProblem)


@given(problem=ANY_PROBLEM, data=st.data())
def test_nothing_beats_the_best_of_all(problem: PlacementProblem, data: st.DataObject) -> None:
    reduced = presolve(problem)
    sets = [
        units
        for units in combinations(range(reduced.n_poses), problem.limits.max_units)
        if is_feasible(problem, reduced.pose_index[list(units)].tolist())
    ]
    if problem.limits.max_units == 1 or not sets:
        return
    all_sets = np.array(sets)
    best = set_values(reduced, best_set(reduced, all_sets)[None, :]).gains
    # From any set that loses no APR: the others are not what is asked.
    shares = set_values(reduced, all_sets).of(Objective.APR)
    start = data.draw(st.sampled_from(np.flatnonzero(shares >= shares.max() - 1e-9).tolist()))
    found = best_of_all(
        reduced,
        all_sets[start],
        known=set_values(reduced, all_sets[[start]])[0],
        max_sets=1000,
    )
    assert found is not None
    np.testing.assert_allclose(set_values(reduced, found[None, :]).gains, best, atol=1e-9)


@given(problem=ANY_PROBLEM)
def test_too_many_sets_are_not_begun(problem: PlacementProblem) -> None:
    reduced = presolve(problem)
    units = np.arange(problem.limits.max_units)
    is_small = reduced.n_poses <= problem.limits.max_units
    if not is_small:
        known = set_values(reduced, units[None, :])[0]
        assert best_of_all(reduced, units, known=known, max_sets=1) is None
