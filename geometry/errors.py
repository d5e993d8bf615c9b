"""Errors that a user can mend: one line each, no traceback, exit code 2."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

from .phrases import Phrase

# Of a value in a message.
_MAX_CHARACTERS = 200
# Beyond, a value is shown as text.
_MAX_NUMBER = 1.0e15
# characters of our own words, such as a list of all names that exist
_MAX_WORDS = 2_000


class InputError(ValueError):
    """Something the user gave is not what is expected.

    `where`: file, field or argument, as precisely as known: an argument by its name
    alone. `got`: the offending value, or a phrase about it. `expected`: what would have
    been accepted; other arguments stand in backticks. `words` is the whole message, to
    be translated.

    >>> str(InputError("budget", 0, "a whole number of units, at least 1"))
    'budget: got 0; expected a whole number of units, at least 1'
    """

    def __init__(self, where: str, got: object, expected: str) -> None:
        self.where = where
        self.got = got
        self.expected = expected
        self.words = Phrase(
            "{name}: got {got}; expected {expected}",
            name=_one_line(where, 2 * _MAX_CHARACTERS),
            got=_shown(got),
            expected=_one_line(expected, _MAX_WORDS),
        )
        super().__init__(str(self.words))

    def __reduce__(self) -> tuple[Any, ...]:
        """As it was made: it comes from other processes, too."""
        return InputError, (self.where, self.got, self.expected)


def refuse(where: str, words: object, expected: str) -> NoReturn:
    """Raise InputError about something that is told in words, not shown as a value."""
    if not isinstance(words, Phrase):
        words = Unquoted(words)
    raise InputError(where, words, expected)


@contextmanager
def located(prefix: str) -> Iterator[None]:
    """Put a prefix before the place that an InputError names.

    An error with an empty place gets `prefix` alone.

    >>> with located("mine.toml: latency."):
    ...     raise InputError("sd_s", -1, "at least 0")
    Traceback (most recent call last):
    geometry.errors.InputError: mine.toml: latency.sd_s: got -1; expected at least 0
    """
    try:
        yield
    except InputError as error:
        where = f"{prefix}{error.where.removeprefix('.')}".rstrip(".: ")
        raise InputError(where, error.got, error.expected) from None


class Faults:
    """What is wrong with one file, gathered to be told all at once.

    >>> faults = Faults("poles.csv")
    >>> for field in "xy":
    ...     with gathering(faults):
    ...         raise InputError(f"poles.csv: line 2: {field}", "?", "a number")
    >>> try:
    ...     faults.tell()
    ... except InputError as error:
    ...     print(error.expected)  # doctest: +ELLIPSIS
    none: (1) line 2: x: got '?'; expected a number; (2) line 2: y: got '?'; ...
    """

    def __init__(self, where: str) -> None:
        self.where = where
        self.found: list[InputError] = []

    def tell(self) -> None:
        """Raise InputError if there are any; a single one as it is.

        Several make one line, without the name of the file before each.
        """
        if not self.found:
            return
        if len(self.found) == 1:
            raise self.found[0]
        # Rows with the same fault make one entry, with the first of them.
        alike: dict[tuple[str, str], list[InputError]] = {}
        for fault in self.found:
            field = fault.where.rpartition(": ")[2]
            alike.setdefault((field, fault.expected), []).append(fault)
        words: list[str] = []
        n_characters = 0
        for number, group in enumerate(alike.values(), start=1):
            first = group[0]
            where = first.where.removeprefix(self.where).removeprefix(": ")
            got = _shown(first.got)
            text = f"({number}) {where}: got {got}; expected {first.expected}"
            if len(group) > 1:
                text += f", and {len(group) - 1} more of this kind"
            n_characters += len(text) + 2
            # Room for how many more there are.
            if n_characters > _MAX_WORDS - 50:
                words.append(f"and {len(alike) - len(words)} more kinds")
                break
            words.append(text)
        expected = "none: " + "; ".join(words)
        raise InputError(self.where, Unquoted(f"{len(self.found)} faults"), expected)


@contextmanager
def gathering(faults: Faults | None) -> Iterator[None]:
    """Add an InputError to the faults of a file; None: it is raised."""
    try:
        yield
    except InputError as error:
        if faults is None:
            raise
        faults.found.append(error)


def check_one_of(where: str, got: object, known: Collection[str]) -> None:
    """Raise InputError unless a value is one of those known."""
    if got not in known:
        raise InputError(where, got, "one of " + ", ".join(known))


def check_name(name: str, where: str) -> None:
    """Raise InputError if a name has characters that nobody sees, or half of one.

    Line breaks, soft hyphens, spaces of no width or that do not break: two names that
    look the same would be different ones.
    """
    if not name.isprintable():
        raise InputError(where, name, "printable text")


def clean_name(name: str) -> str:
    """A map's name, without characters that nobody sees.

    Its user cannot change it.

    Spaces of other kinds become plain ones; see :func:`check_name` for the names of
    users.

    >>> clean_name("Haupt\u00adstraße\u00a01")
    'Hauptstraße 1'
    """
    if name.isprintable():
        return name
    spaced = (" " if character.isspace() else character for character in name)
    return "".join(character for character in spaced if character.isprintable())


def check_field(
    value: object, where: str, field: str, is_valid: bool, expected: str
) -> None:
    """Raise InputError unless a field of a value is valid; `where` names the value."""
    if not is_valid:
        raise InputError(f"{where}.{field}", getattr(value, field), expected)


class Unquoted(str):
    """Words about a value, shown without quotes in an :class:`InputError`."""

    __slots__ = ()


class MissingExtraError(RuntimeError):
    """An optional package is needed that is not installed."""


def _shown(got: object) -> object:
    """What a message shows of a value.

    Words in one line, a number itself, else as in Python.
    """
    if isinstance(got, Phrase | Unquoted):
        return _one_line(got)
    if type(got) in (int, float) and -_MAX_NUMBER < got < _MAX_NUMBER:  # type: ignore[operator]
        return got
    return _shorten(got)


def _shorten(got: object) -> str:
    """A value as Python writes it, cut off after 200 characters."""
    try:
        text = repr(got)
    except ValueError:
        # Python refuses to write integers of thousands of digits.
        return "a number of thousands of digits"
    if len(text) <= _MAX_CHARACTERS:
        return text
    return f"{text[:_MAX_CHARACTERS]}.."


def _one_line(text: str, max_characters: int = 2 * _MAX_CHARACTERS) -> str:
    """Text that may hold anything, as part of one readable line.

    Such as a file's own names.

    A phrase that is short and printable, as all but odd ones are, stays one.
    """
    # Both ends tell something: a file's folder and its name.
    if len(text) > max_characters:
        half = max_characters // 2
        text = f"{text[:half]}..{text[-half:]}"
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text
    )
