"""Sentences that keep what they were made of, to be translated."""

import re
import string
from collections.abc import Callable, Sequence
from typing import Any, Self

# Such as ",.0f".
_SPEC = re.compile(r",?(\.\d)?[fg]?")


class Phrase(str):
    """An English text that keeps its template and the values put in.

    It is that text for everything that reads, compares or writes it. Whoever translates
    takes `template`, which is the key of a translation, and puts translated `fields`
    in. A phrase without fields is a word or sentence that stands by itself. Operations
    of str, such as ``+`` and f-strings, give plain text: to join phrases, put them into
    another one.

    Parameters
    ----------
    template : str
        The text in English, with names of fields in braces, as in ``str.format``.
    **fields : str, int, float or Phrase
        What stands in place of the names. A number is written as the language does; a
        plain text stays as it is; a phrase is translated too.

    Examples
    --------
    >>> thing = Phrase("parked car")
    >>> template = "{thing} stands in the way for {length_m:.1f} m"
    >>> why = Phrase(template, thing=thing, length_m=4)
    >>> why
    'parked car stands in the way for 4.0 m'
    >>> why.fields["thing"].template
    'parked car'
    """

    template: str
    fields: dict[str, Any]

    def __new__(cls, template: str, /, **fields: Any) -> Self:
        """The text of a template with its fields put in."""
        if fields:
            text = template.format(**fields)
        else:
            text = template
        phrase = super().__new__(cls, text)
        phrase.template = template
        phrase.fields = fields
        return phrase

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles keep template and fields."""
        return _build_phrase, (self.template, self.fields)

    def map(self, change: Callable[[str], str]) -> "Phrase":
        """The phrase with each template changed by a function.

        Also those of phrases within.
        """
        fields = {
            name: value.map(change) if isinstance(value, Phrase) else value
            for name, value in self.fields.items()
        }
        return Phrase(change(self.template), **fields)


def join_phrases(texts: Sequence[str], separator: str) -> Phrase:
    """Texts in a row, each to be translated by itself.

    >>> join_phrases([Phrase("it stood inside"), Phrase("moved")], "; ")
    'it stood inside; moved'
    """
    names = [f"text_{number}" for number in range(len(texts))]
    template = separator.join(f"{{{name}}}" for name in names)
    return Phrase(template, **dict(zip(names, texts, strict=True)))


def pack_phrase(text: str) -> Any:
    """A text as files have it: plain, or a phrase's template and fields."""
    if not isinstance(text, Phrase):
        return text
    if not text.fields:
        return text.template
    fields = {
        name: pack_phrase(value) if isinstance(value, str) else value
        for name, value in text.fields.items()
    }
    return [text.template, fields]


def unpack_phrase(packed: Any) -> Phrase:
    """The phrase that was packed; plain text is one without fields.

    Files may be anybody's: a template may have plain names and short formats alone.
    Raises ValueError, TypeError, KeyError or AttributeError: it is none.

    >>> unpack_phrase(pack_phrase(Phrase("lane {lane} bends", lane=Phrase("4")))).fields
    {'lane': '4'}
    """
    if isinstance(packed, str):
        return Phrase(packed)
    template, fields = packed
    for _, name, spec, conversion in string.Formatter().parse(template):
        is_plain = name is None or (name.isidentifier() and not conversion)
        if not is_plain or not _SPEC.fullmatch(spec or ""):
            raise ValueError(f"{template}: a field that is not plain")
    values = {
        name: unpack_phrase(value) if isinstance(value, str | list) else value
        for name, value in fields.items()
    }
    return Phrase(template, **values)


def _build_phrase(template: str, fields: dict[str, Any]) -> Phrase:
    return Phrase(template, **fields)
