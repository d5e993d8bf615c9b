"""What an object or a signal is, from its type and its name."""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from xml.etree.ElementTree import Element

from .tables import load_facts

_MAX_CHARACTERS = 100  # of a name that is looked at
_MAX_WORDS = 3  # that are read as one
_SAYS_NOTHING = ("", "none", "obstacle", "unknown", "undefined", "object", "other", "misc")
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def object_kind(element: Element) -> str | None:
    """Kind of an object; None: none that matters here.

    Returns
    -------
    kind : str or None
        "crosswalk", "parking space", "tree", "vegetation", "building", "wall", "parked vehicle", or
        one of ``POLE_KINDS``; "obstacle" where the standard's type says no more than that.
    """
    object_type, name = element.get("type", ""), element.get("name", "")
    if has_word((object_type, name), load_facts()["flat"]["words"]):
        return None
    if element.find("parkingSpace") is not None:
        return "parking space"
    plain = "".join(words(object_type))
    for kind, types in load_facts()["object_types"].items():
        if plain in types and element.get("dynamic", "no") != "yes":
            return str(kind)
    for text in (
        (object_type,) if plain not in _SAYS_NOTHING else (name, element.get("subtype", ""))
    ):
        for kind, listed in load_facts()["object_words"].items():
            if has_word((text,), listed):
                return str(kind)
    return "obstacle" if plain == "obstacle" else None


def signal_kind(element: Element) -> str | None:
    """Kind of a signal.

    Returns
    -------
    kind : str or None
        "traffic light", "crosswalk" (painted), "sign"; None: other paint.
    """
    facts = load_facts()["signals"]
    texts = (element.get("name", ""), element.get("type", ""), element.get("subtype", ""))
    number = element.get("type", "").strip()
    is_dynamic = element.get("dynamic", "no").strip().lower() in ("yes", "true", "1")
    if number in facts["crosswalk_types"] and not is_dynamic:
        return "crosswalk"
    if has_word(texts, facts["painted_words"]):
        return None
    if (is_dynamic and number in facts["light_types"]) or has_word(texts, facts["light_words"]):
        return "traffic light"
    return "sign"


def words(text: str) -> list[str]:
    """Words of a name, written small: "streetLamp_3" has street and lamp."""
    return [word.lower() for word in _WORD.findall(text[:_MAX_CHARACTERS])]


def has_word(texts: Iterable[str], wanted: Sequence[str]) -> bool:
    """One of the texts has a word of the list, or several that together are one."""
    return any(phrase in wanted for text in texts for phrase in _phrases(text))


@lru_cache(maxsize=4096)
def _phrases(text: str) -> frozenset[str]:
    found = words(text)
    return frozenset(
        "".join(found[begin:end]).removesuffix(plural)
        for begin in range(len(found))
        for end in range(begin + 1, min(begin + _MAX_WORDS, len(found)) + 1)
        for plural in ("", "s")
    )
