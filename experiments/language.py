"""The language of answers.

Terminal, report, page and sheet say each sentence through here.

A sentence stands in the code in English, whole, with names in braces for what is put
in: it is the key under which catalogues (``languages/de/*.po``, gettext's format) have
its translation. ``tr`` and ``trn`` take it where it is said, ``mark`` where it is a
constant. The packages below know no languages: they return a
:class:`geometry.phrases.Phrase`, which ``tr`` takes too. Keys of JSON, names of files,
the help of commands and their errors are English always; what the planner's page is
refused is not.
"""

import string
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from geometry.errors import InputError
from geometry.phrases import Phrase

_FOLDER = files("experiments").joinpath("languages")
LANGUAGES = ("en", *sorted(one.name for one in _FOLDER.iterdir() if one.is_dir()))
"""Languages that can be spoken: English, and each that has a folder of catalogues."""
_SWAPPED = str.maketrans(".,", ",.")


class _GermanNumbers(string.Formatter):
    """Puts numbers in with a decimal comma, and points between thousands."""

    def format_field(self, value: Any, format_spec: str) -> str:
        text = format(value, format_spec)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number:
            return text.translate(_SWAPPED)
        return text


class Messages:
    """A catalogue of messages, and of those with a plural form.

    `found` has their translations by the English text, of two forms by the first; a
    message that it does not have stays English.
    """

    def __init__(
        self, found: Mapping[str, str | tuple[str, ...]] = MappingProxyType({})
    ) -> None:
        self._found = found

    def find(self, message: str) -> str:
        """The translation of a message."""
        found = self._found.get(message)
        if isinstance(found, str) and found:
            return found
        return message

    def find_plural(self, one: str, many: str, count: int) -> str:
        """The form that a count asks for."""
        found = self._found.get(one)
        if isinstance(found, tuple) and all(found):
            forms = found
        else:
            forms = (one, many)
        return forms[count != 1]


@cache
def _catalogue(code: str) -> Messages:
    if code == "en":
        return Messages()
    from babel.messages.pofile import read_po

    translated: dict[str, str | tuple[str, ...]] = {}
    for path in sorted(_FOLDER.joinpath(code).iterdir(), key=str):
        if path.name.endswith(".po"):
            with path.open("rb") as file:
                for entry in read_po(file):
                    # The head of the file.
                    if not entry.id:
                        continue
                    if isinstance(entry.id, str):
                        key = entry.id
                    else:
                        key = entry.id[0]
                    text = entry.string
                    if isinstance(text, str):
                        translated[key] = text
                    else:
                        translated[key] = tuple(text or ())
    return Messages(translated)


class _Current:
    code = "en"
    messages = Messages()


def language() -> str:
    """The language that is spoken now, such as "en"."""
    return _Current.code


def set_language(code: str) -> None:
    """Speak one of LANGUAGES in this process from now on."""
    _Current.messages = _catalogue(code)
    _Current.code = code


@contextmanager
def speaking(code: str, messages: Messages | None = None) -> Iterator[None]:
    """Speak a language for a block.

    With `messages` from another catalogue (tests).
    """
    before = _Current.code, _Current.messages
    set_language(code)
    _Current.messages = messages or _Current.messages
    try:
        yield
    finally:
        _Current.code, _Current.messages = before


def tr(message: str, /, **values: Any) -> str:
    """A message in the language that is spoken, with its values filled in.

    They take the places of the names in braces.

    Numbers among the values are written as the language does, "{share:.1f}" as 0.5 or
    0,5. A phrase brings its own values; phrases among the values are translated too. A
    message that the language does not have, such as the name of a file, stays as it is.

    Examples
    --------
    >>> tr("{n:,} runs", n=1200)
    '1,200 runs'
    >>> tr(Phrase("lane {lane} bends", lane=4))
    'lane 4 bends'
    """
    if isinstance(message, Phrase):
        values = message.fields
        message = message.template
    return _filled(_Current.messages.find(message), values)


def tr_error(error: Exception) -> str:
    """What an error says, such as what a user gave is refused for."""
    if not isinstance(error, InputError):
        return str(error)
    words = {
        name: tr(value) if isinstance(value, str) else value
        for name, value in error.words.fields.items()
    }
    return tr(error.words.template, **words)


def trn(one: str, many: str, n: int, /, **values: Any) -> str:
    """A message that depends on a number, which it may show as {n}.

    Examples
    --------
    >>> trn("{n} run", "{n} runs", 1), trn("{n} run", "{n} runs", 2)
    ('1 run', '2 runs')
    """
    return _filled(_Current.messages.find_plural(one, many, n), {"n": n, **values})


def words_of(messages: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Translations of what scripts say, by message.

    For one and for many where both are.

    Each message is a pair of its form for one, empty where it has no other, and that
    for many.
    """
    find = _Current.messages.find
    plural = _Current.messages.find_plural
    ones = {one: plural(one, many, 1) for one, many in messages if one}
    return ones | {
        many: plural(one, many, 2) if one else find(many) for one, many in messages
    }


def mark(message: str) -> str:
    """A message that is translated where it is used, by ``tr(MESSAGE)``.

    For constants.
    """
    return message


def localized(number: str) -> str:
    """A number written in English, as the language that is spoken does."""
    if _Current.code == "en":
        return number
    return number.translate(_SWAPPED)


def _filled(message: str, values: Mapping[str, Any]) -> str:
    if not values:
        return message
    said = {name: _translated(value) for name, value in values.items()}
    if _Current.code == "en":
        return message.format(**said)
    return _GermanNumbers().vformat(message, (), said)


def _translated(value: Any) -> Any:
    if isinstance(value, Phrase):
        return tr(value)
    return value
