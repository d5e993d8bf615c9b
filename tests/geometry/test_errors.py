"""Errors in one line: what was got and what is expected."""

import pytest

from geometry.errors import InputError, Unquoted


def test_input_error_reads_where_got_expected():
    error = InputError(
        "town05.toml: sites[2].height_range_m", [8.0, 5.0], "[low, high]"
    )
    assert (
        str(error)
        == "town05.toml: sites[2].height_range_m: got [8.0, 5.0]; expected [low, high]"
    )
    assert error.where == "town05.toml: sites[2].height_range_m"
    assert error.got == [8.0, 5.0]
    assert error.expected == "[low, high]"


def test_words_about_a_value_stand_without_quotes():
    assert (
        str(InputError("x", Unquoted("nothing"), "a value"))
        == "x: got nothing; expected a value"
    )
    assert (
        str(InputError("x", "nothing", "a value"))
        == "x: got 'nothing'; expected a value"
    )


def test_input_error_is_a_value_error():
    with pytest.raises(ValueError, match="x: got 1; expected 2"):
        raise InputError("x", 1, "2")


def test_a_value_that_is_too_long_is_shortened_in_the_message():
    for got in ("x" * 10_000, 10**3_000, 10**9_000, list(range(10_000))):
        message = str(InputError("here", got, "less"))
        assert len(message) < 300
        assert message.startswith("here: got ")
        assert message.endswith("; expected less")
