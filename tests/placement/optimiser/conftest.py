from collections.abc import Callable, Iterable
from itertools import combinations

import numpy as np
import pytest
from hypothesis import strategies as st
from problems import problems

from placement.optimiser import (
    PlacementProblem,
    PlacementValue,
    is_better,
    is_feasible,
    placement_value,
)

st.register_type_strategy(PlacementProblem, problems())


def _best_value(problem: PlacementProblem, poses: Iterable[int]) -> PlacementValue:
    best = PlacementValue(0.0, 0.0, 0.0, 0.0, np.inf)
    choice = list(poses)
    for n_units in range(1, problem.limits.max_units + 1):
        for units in combinations(choice, n_units):
            if is_feasible(problem, units):
                value = placement_value(problem, units)
                if is_better(value, best):
                    best = value
    return best


@pytest.fixture(scope="session")
def best_value() -> Callable[[PlacementProblem, Iterable[int]], PlacementValue]:
    """Brute force: best value of all feasible layouts, of any size, among some
    poses.
    """
    return _best_value
