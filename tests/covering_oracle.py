"""Small covering instances, and what all their sets of columns cover and cost."""

import itertools

import numpy as np
from hypothesis import strategies as st

from placement.covering import CoveringInstance, build_covering_instance

AMOUNTS = (
    st.just(1.0),
    st.integers(0, 4).map(float),
    st.floats(0.01, 3.0, allow_subnormal=False),
)


@st.composite
def instances(draw, max_columns: int = 7, max_rows: int = 8) -> CoveringInstance:
    """Instances with unit, whole or any costs."""
    n_columns = draw(st.integers(0, max_columns))
    n_rows = draw(st.integers(0, max_rows))
    rows = st.sets(st.integers(0, n_rows - 1)) if n_rows else st.just(set())
    covers = np.zeros((n_columns, n_rows), dtype=bool)
    for column in range(n_columns):
        covers[column, list(draw(rows))] = True
    amounts = st.lists(draw(st.sampled_from(AMOUNTS)), min_size=n_columns, max_size=n_columns)
    return build_covering_instance(covers, cost=draw(amounts))


class EverySet:
    """All sets of columns of an instance.

    Attributes
    ----------
    size, cost, covered : (n_sets,) float
        Columns, what they cost, how many rows they cover.
    """

    def __init__(self, instance: CoveringInstance) -> None:
        covers = instance.covers.toarray()
        self.sets = [
            np.array(columns, dtype=np.int64)
            for size in range(instance.n_columns + 1)
            for columns in itertools.combinations(range(instance.n_columns), size)
        ]
        self.size = np.array([len(columns) for columns in self.sets])
        self.cost = np.array([instance.cost[columns].sum() for columns in self.sets])
        self.covered = np.array([covers[columns].any(axis=0).sum() for columns in self.sets])

    def least_cost(self, needed: float) -> float:
        """Least cost of a set that covers so much."""
        return float(self.cost[self.covered >= needed - 1.0e-9].min())

    def most_covered(self, units: float = np.inf, money: float = np.inf) -> float:
        """Most rows of a set within a budget."""
        is_allowed = (self.size <= units) & (self.cost <= money + 1.0e-9)
        return float(self.covered[is_allowed].max())
