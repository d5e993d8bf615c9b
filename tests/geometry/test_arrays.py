"""Arrays of values: copied, read-only, of the right shape."""

import numpy as np
import pytest
from refusals import refused_with

from geometry.arrays import float_array, freeze
from geometry.errors import InputError


def test_float_array_is_a_read_only_copy():
    source = np.array([1.0, 2.0])
    array = float_array(source, (2,), "a")
    source[0] = 9.0

    assert array.tolist() == [1.0, 2.0]

    with pytest.raises(ValueError, match="read-only"):
        array[0] = 5.0


def test_minus_one_allows_any_length_but_only_there():
    assert float_array(np.zeros((0, 3)), (-1, 3), "a").shape == (0, 3)
    assert float_array(np.zeros((7, 3)), (-1, 3), "a").shape == (7, 3)
    with pytest.raises(InputError):
        float_array(np.zeros((7, 2)), (-1, 3), "a")


@pytest.mark.parametrize(
    ("values", "shape", "message"),
    [
        ([1, 2], (3,), "p: got shape (2,); expected shape (3,)"),
        (5.0, (1,), "p: got shape (); expected shape (1,)"),
        ([1.0, float("nan")], (2,), "p: got [1.0, nan]; expected finite numbers"),
        ([1.0, float("inf")], (2,), "p: got [1.0, inf]; expected finite numbers"),
        (["a", "b"], (2,), "p: got ['a', 'b']; expected numbers of shape (2,)"),
        (
            [[1.0], [1.0, 2.0]],
            (2, 2),
            "p: got [[1.0], [1.0, 2.0]]; expected numbers of shape (2, 2)",
        ),
        ({"x": 1}, (2,), "p: got {'x': 1}; expected numbers of shape (2,)"),
    ],
)
def test_float_array_says_what_is_wrong(values, shape, message):
    with refused_with(message):
        float_array(values, shape, "p")


def test_freeze_shares_memory_and_cannot_be_written_through():
    array = np.zeros(3)
    view = freeze(array)

    assert np.shares_memory(array, view)

    with pytest.raises(ValueError, match="read-only"):
        view[0] = 1.0

    array[0] = 1.0  # the owner still can
