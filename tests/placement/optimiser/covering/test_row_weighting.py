import numpy as np
import pytest
import scipy.sparse as sp
from covering_oracle import EverySet, instances, steiner_instance
from hypothesis import assume, given
from hypothesis import strategies as st

from placement.optimiser.covering.instance import CoveringInstance, build_covering_instance
from placement.optimiser.covering.kernels import N_CHOSEN, N_UNCOVERED
from placement.optimiser.covering.row_weighting import RowWeighting, lagrangian_bound


@st.composite
def full_covers(draw):
    """Instances whose rows all have a column, and whose columns cost something."""
    instance = draw(instances())
    is_covered = np.unique(instance.covers.indices)
    assume(len(is_covered) > 0)
    return CoveringInstance(
        covers=instance.covers[:, is_covered],
        cost=np.maximum(instance.cost, 0.5),
        weight=np.ones(len(is_covered)),
    )


def least_cost(instance):
    return EverySet(instance).least_cost(instance.coverable_weight)


def search(instance, n_slices=5, work=2_000, seed=1):
    found = RowWeighting(instance.covers, instance.cost, seed=seed)
    while np.isinf(found.cost) or found.work < n_slices * work:
        found.go_on(work)
    return found


@given(instance=full_covers())
def test_the_search_finds_the_optimum_of_small_instances(instance):
    found = search(instance)
    assert instance.covered_weight(found.best) == instance.n_rows
    assert found.cost == pytest.approx(instance.cost[found.best].sum())
    assert found.cost == pytest.approx(least_cost(instance))


@given(instance=full_covers(), work=st.integers(1, 300), seed=st.integers(0, 5))
def test_what_the_search_keeps_up_to_date_is_what_it_would_be_counted_anew(instance, work, seed):
    found = search(instance, n_slices=1, work=work, seed=seed)
    state, covers = found._state, instance.covers.toarray()
    chosen = np.sort(state.chosen[: state.counters[N_CHOSEN]])
    times = covers[chosen].sum(axis=0)
    np.testing.assert_array_equal(state.times, times)
    np.testing.assert_array_equal(np.flatnonzero(state.place >= 0), chosen)
    uncovered = np.sort(state.uncovered[: state.counters[N_UNCOVERED]])
    np.testing.assert_array_equal(uncovered, np.flatnonzero(times == 0))
    np.testing.assert_array_equal(np.flatnonzero(state.uncovered_place >= 0), uncovered)
    for column, rows in enumerate(covers):
        counts = times == 1 if column in chosen else times == 0
        assert state.score[column] == state.weight[rows & counts].sum()
    for row in np.flatnonzero(times == 1):
        assert covers[state.holder[row], row]
        assert state.holder[row] in chosen


@given(instance=full_covers(), excess=st.floats(0.0, 2.0))
def test_prices_of_rows_bound_every_cover_and_every_cover_with_a_column(instance, excess):
    optimum = least_cost(instance)
    relaxed = lagrangian_bound(
        instance.covers, instance.cost, known_cost=optimum + excess, time_limit_s=60.0
    )
    assert relaxed.bound <= optimum + 1e-9
    every = EverySet(instance)
    is_cover = every.covered >= instance.n_rows
    for column in range(instance.n_columns):
        has_it = np.array([column in columns for columns in every.sets])
        least = every.cost[is_cover & has_it].min()
        assert relaxed.bound + relaxed.reduced_cost[column] <= least + 1e-9


def test_the_bound_comes_near_that_of_the_linear_program():
    # Each of 7 lines of the Fano plane has 3 of 7 points: a third of each point covers all of them.
    lines = [(0, 1, 2), (0, 3, 4), (0, 5, 6), (1, 3, 5), (1, 4, 6), (2, 3, 6), (2, 4, 5)]
    covers = np.zeros((7, 7), dtype=bool)
    for row, points in enumerate(lines):
        covers[list(points), row] = True
    instance = build_covering_instance(covers)
    relaxed = lagrangian_bound(instance.covers, instance.cost, known_cost=3.0, time_limit_s=60.0)
    assert relaxed.bound == pytest.approx(7.0 / 3.0, rel=1e-3)
    assert least_cost(instance) == search(instance).cost == 3.0


@pytest.mark.parametrize(("n_points", "least"), [(9, 5), (27, 18), (81, 61), (243, 198)])
def test_least_covers_of_steiner_triples_are_found(n_points, least):
    # Optima: Fulkerson et al. 1974; Mannino, Sassano 1995 (81); Ostrowski et al. 2011 (243).
    found = search(steiner_instance(n_points), n_slices=4, work=10_000_000)
    assert found.cost == least


def random_instance(seed, n_columns=120, n_rows=200, share=0.05):
    rng = np.random.default_rng(seed)
    covers = rng.random((n_columns, n_rows)) < share
    covers[rng.integers(0, n_columns, n_rows), np.arange(n_rows)] = True
    return build_covering_instance(covers, cost=rng.integers(1, 9, n_columns))


def test_a_seed_makes_the_search_repeat_itself():
    instance = random_instance(1)
    first, again = (search(instance, n_slices=20, work=50_000) for _ in range(2))
    np.testing.assert_array_equal(first.best, again.best)
    assert first.cost == again.cost
    other = search(instance, n_slices=20, work=50_000, seed=2)
    assert other.cost == pytest.approx(first.cost, rel=0.05)


def test_more_work_never_makes_the_best_cover_dearer():
    found = RowWeighting(*(lambda each: (each.covers, each.cost))(random_instance(2)))
    costs = []
    for _ in range(40):
        found.go_on(5_000)
        costs.append(found.cost)
    assert costs == sorted(costs, reverse=True)
    assert np.isfinite(costs[-1])
    assert costs[-1] < max(cost for cost in costs if np.isfinite(cost))


def test_one_column_that_covers_all_is_the_end_of_the_search():
    found = search(build_covering_instance(sp.csr_array(np.ones((1, 5)))))
    assert (list(found.best), found.cost) == ([0], 1.0)
