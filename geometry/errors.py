"""Errors that a user can mend: one line each, no traceback, exit code 2."""

_MAX_CHARACTERS = 200  # of a value in a message


class InputError(ValueError):
    """Something the user gave is not what is expected.

    Parameters
    ----------
    where : str
        File, field or option, as precisely as known.
    got : object
        The offending value.
    expected : str
        What would have been accepted.

    Examples
    --------
    >>> str(InputError("--budget", 0, "a whole number of units, at least 1"))
    '--budget: got 0; expected a whole number of units, at least 1'
    """

    def __init__(self, where: str, got: object, expected: str) -> None:
        self.where = where
        self.got = got
        self.expected = expected
        shown = got if isinstance(got, Unquoted) else _shorten(got)
        super().__init__(f"{where}: got {shown}; expected {expected}")


class Unquoted(str):
    """Words about a value, shown without quotes in an :class:`InputError`."""

    __slots__ = ()


class MissingExtraError(RuntimeError):
    """An optional package is needed that is not installed."""


def _shorten(got: object) -> str:
    """A value as Python writes it, cut off where it would fill more than a line or two."""
    try:
        text = repr(got)
    except ValueError:  # Python refuses to write integers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= _MAX_CHARACTERS else f"{text[:_MAX_CHARACTERS]}.."
