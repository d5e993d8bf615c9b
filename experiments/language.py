"""The language of answers: terminal, report, page and sheet say each sentence through here.

A sentence stands in the code in English, whole, with names in braces for what is put
in: it is the key under which catalogues (``languages/de/*.po``, gettext's format) have
its translation. Keys of JSON, names of files, the help of commands and their errors are
English always; what the planner's page is refused is not.
"""

import re
import string
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from geometry.text_formats import load_data

LANGUAGES = ("en", "de")
_SWAPPED = str.maketrans(".,", ",.")
_SENTENCES = re.compile(r"(?<=\.) (?=[A-Z])")
_NUMBER = re.compile(r"[-+\N{MINUS SIGN}]?[\d,]+(\.\d+)?")


class _GermanNumbers(string.Formatter):
    """Puts numbers in with a decimal comma, and points between thousands."""

    def format_field(self, value: Any, format_spec: str) -> str:
        text = format(value, format_spec)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number:
            return text.translate(_SWAPPED)
        return text


class Messages:
    """A catalogue of messages, and of those that have a form for one and one for many.

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
    for path in sorted(
        files("experiments").joinpath("languages", code).iterdir(), key=str
    ):
        if path.name.endswith(".po"):
            with path.open("rb") as file:
                for entry in read_po(file):
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
    """Speak a language for a block; with `messages` from another catalogue (tests)."""
    before = _Current.code, _Current.messages
    set_language(code)
    _Current.messages = messages or _Current.messages
    try:
        yield
    finally:
        _Current.code, _Current.messages = before


def tr(message: str, /, **values: Any) -> str:
    """A message in the language that is spoken, with values in place of the names in braces.

    Numbers among the values are written as the language does, "{share:.1f}" as 0.5 or
    0,5.

    Examples
    --------
    >>> tr("{n:,} runs", n=1200)
    '1,200 runs'
    """
    return _filled(_Current.messages.find(message), values)


def trn(one: str, many: str, n: int, /, **values: Any) -> str:
    """A message that depends on a number, which it may show as {n}.

    Examples
    --------
    >>> trn("{n} run", "{n} runs", 1), trn("{n} run", "{n} runs", 2)
    ('1 run', '2 runs')
    """
    return _filled(_Current.messages.find_plural(one, many, n), {"n": n, **values})


def say(key: str, n: int | None = None, /, **values: Any) -> str:
    """A longer text, of ``data/texts.toml``: as ``tr`` says it, or with a number as ``trn``.

    Examples
    --------
    >>> say("terminal.more_reasons", 2)
    "and 2 more reasons in the report's list"
    """
    part, _, name = key.partition(".")
    text = _texts()[part][name]
    if n is None:
        return tr(text, **values)
    return trn(text[0], text[1], n, **values)


@cache
def _texts() -> dict[str, Any]:
    return load_data("experiments", "texts.toml")


def listed(name: str) -> list[str]:
    """Texts that belong together, of ``data/lists.toml``: most are heads of a table's columns."""
    return [tr(text) for text in _lists()[name]]


@cache
def _lists() -> dict[str, list[str]]:
    return load_data("experiments", "lists.toml")


def words_of(messages: Iterable[tuple[str, str]]) -> dict[str, str]:
    """What scripts say: translations of messages by themselves, for one and many where both are.

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
    """A message that is translated where it is used, by ``tr(MESSAGE)``: for constants."""
    return message


def said(text: str) -> str:
    """A text of a package below, such as a note on a map, in the language that is spoken.

    Those packages know no languages: ``data/said_below.toml`` has what they say. Any
    other text stays as it is.

    Examples
    --------
    >>> said("none in the map")
    'none in the map'
    """
    if _Current.code == "en":
        return text
    return " ".join(_said(sentence) for sentence in _SENTENCES.split(text))


def _said(sentence: str) -> str:
    if _NUMBER.fullmatch(sentence):
        return localized(sentence)
    for message, pattern in _said_below().items():
        found = pattern.fullmatch(sentence)
        if found:
            return tr(
                message,
                **{name: _said(part) for name, part in found.groupdict().items()},
            )
    return sentence


@cache
def _said_below() -> dict[str, re.Pattern[str]]:
    """Messages of the packages below, and what a text with values in place of names is like."""
    return {
        message: re.compile(
            "".join(
                re.escape(words) + (f"(?P<{name}>.+?)" if name else "")
                for words, name, _, _ in string.Formatter().parse(message)
            )
        )
        for message in load_data("experiments", "said_below.toml")["messages"]
    }


def localized(number: str) -> str:
    """A number that has been written as English does, as the language that is spoken does."""
    if _Current.code == "en":
        return number
    return number.translate(_SWAPPED)


def _filled(message: str, values: Mapping[str, Any]) -> str:
    if not values:
        return message
    if _Current.code == "en":
        return message.format(**values)
    return _GermanNumbers().vformat(message, (), values)
