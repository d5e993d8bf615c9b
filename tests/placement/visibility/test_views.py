"""Views that are kept while there is room."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from placement.visibility import views
from placement.visibility.views import HiddenPoints

N_ROWS = 12
N_POINTS = 19  # points do not fill their bytes

ROWS = st.lists(st.integers(0, N_ROWS - 1), unique=True).map(
    lambda rows: np.array(rows, dtype=int)
)


def _truth(eye):
    """What an eye would see, (n_rows, n_points)."""
    rng = np.random.default_rng(eye)
    return rng.random((N_ROWS, N_POINTS)) < 0.5


@given(st.lists(st.tuples(st.integers(0, 3), ROWS, ROWS), max_size=8))
def test_what_is_kept_is_what_was_found_and_nothing_is_found_twice(asked):
    kept = HiddenPoints(N_ROWS, N_POINTS)
    found = set()
    for eye, rows, foreseen in asked:

        def find(index, eye=eye):
            pairs = {(eye, row) for row in index.tolist()}
            assert not pairs & found

            found.update(pairs)
            return _truth(eye)[index]

        before = set(found)

        assert np.array_equal(
            kept.look(eye, rows, find, foreseen=foreseen), _truth(eye)[rows]
        )

        if {(eye, row) for row in rows.tolist()} <= before:
            assert found == before  # what is foreseen can wait
        else:
            assert {(eye, row) for row in foreseen.tolist()} <= found


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 5), ROWS), max_size=12))
def test_without_room_nothing_is_kept_and_all_is_found(asked):
    most = views._MOST_BYTES
    try:
        views._MOST_BYTES = 2 * N_ROWS * (1 + 3)
        kept = HiddenPoints(N_ROWS, N_POINTS)
    finally:
        views._MOST_BYTES = most

    for eye, rows in asked:
        hidden = kept.look(eye, rows, lambda index, eye=eye: _truth(eye)[index])
        assert np.array_equal(hidden, _truth(eye)[rows])

    eyes = {eye for eye, _ in asked}
    expected = min(2, len(eyes))

    assert len(kept._of_eye) == expected
