import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from placement.optimiser.covering.presolve import first_equal, supersets

FAMILIES = st.lists(st.frozensets(st.integers(0, 9), min_size=1), max_size=12)


def to_matrix(family, n_members=10):
    matrix = np.zeros((len(family), n_members), dtype=bool)
    for row, members in enumerate(family):
        matrix[row, list(members)] = True
    return sp.csr_array(matrix)


def found(sets, price=None, max_work=np.inf):
    prices = np.zeros(sets.shape[0]) if price is None else np.array(price)
    return {
        (part, int(whole))
        for part, wholes in supersets(sets, prices, max_work=max_work)
        for whole in wholes
    }


@given(family=st.lists(st.frozensets(st.integers(0, 9)), max_size=12))
def test_equal_sets_are_found(family):
    assert list(first_equal(to_matrix(family))) == [family.index(each) for each in family]


@given(family=FAMILIES, prices=st.lists(st.integers(0, 2), min_size=12, max_size=12))
def test_supersets_at_no_higher_price_are_found(family, prices):
    family = list(dict.fromkeys(family))
    expected = {
        (i, j)
        for i, part in enumerate(family)
        for j, whole in enumerate(family)
        if part < whole and prices[j] <= prices[i]
    }
    assert found(to_matrix(family), prices[: len(family)]) == expected


def test_a_signature_with_several_members_to_a_bit_is_only_a_sieve():
    n_members = 64 * 64 + 5
    # The first two have a bit in common with the third's members, not a member.
    family = [{0, 3}, {4096, 3}, {0, 3, 7}, {4096, 3, 9, 4100}]
    assert found(to_matrix(family, n_members)) == {(0, 2), (1, 3)}


def test_the_work_can_be_limited():
    sets = to_matrix([{0}, {0, 1}, {0, 1, 2}])
    assert found(sets, max_work=0) == set()
    assert len(found(sets)) == 3


def test_no_sets_have_no_supersets():
    assert found(sp.csr_array((0, 4))) == set()
    assert found(sp.csr_array((0, 0))) == set()


@pytest.mark.parametrize("n_members", [1, 64, 65, 5000])
def test_random_families_of_any_width(n_members):
    rng = np.random.default_rng(n_members)
    base = rng.random((30, n_members)) < 0.2
    base[:, 0] = True
    family = np.unique(np.vstack([base, base[:15] & base[15:], base[:15] | base[15:]]), axis=0)
    matrix = sp.csr_array(family)
    count = family.astype(int)
    shared = count @ count.T
    size = count.sum(axis=1)
    is_part = (shared == size[:, None]) & (size[:, None] < size)
    assert found(matrix) == set(zip(*map(np.ndarray.tolist, np.nonzero(is_part)), strict=True))
