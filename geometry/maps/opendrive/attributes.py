"""Attributes of XML elements as numbers and words, checked."""

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from ...errors import InputError, Unquoted

MAX_MAGNITUDE = 1.0e12  # beyond it cubes of arc lengths leave what floats can hold
MAX_SIZE_M = 1.0e4
_UNSET = ("", "none", "undefined", "nan")  # what exporters write where they know nothing


def take_number(element: Element, key: str, where: str) -> float:
    """Finite number of an attribute that must be there.

    Parameters
    ----------
    element : Element
        Who has it.
    key : str
        Its name.
    where : str
        File and element, for messages: "Town.xodr: road 5 geometry[2]".

    Returns
    -------
    value : float
        At most ``MAX_MAGNITUDE`` in size.

    Raises
    ------
    InputError
        It is missing, no number, or not finite.
    """
    text = element.get(key)
    if text is None:
        raise InputError(f"{where}.{key}", Unquoted("nothing"), "a number")
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where}.{key}", text, "a number") from None
    if not (math.isfinite(value) and abs(value) <= MAX_MAGNITUDE):
        raise InputError(
            f"{where}.{key}", value, f"a finite number, at most {MAX_MAGNITUDE:g} in size"
        )
    return value


def take_number_or(element: Element, key: str, where: str, default: float) -> float:
    """Finite number of an attribute, or what holds where it is missing or left open."""
    value = take_number_if_any(element, key, where)
    return default if value is None else value


def take_number_if_any(element: Element, key: str, where: str) -> float | None:
    """Finite number of an attribute, or None where it is missing or left open."""
    if element.get(key, "").strip().lower() in _UNSET:
        return None
    return take_number(element, key, where)


def take_size(element: Element, key: str, where: str) -> float | None:
    """A length, width, height or radius; None where it is missing, left open or not above 0.

    Raises
    ------
    InputError
        It is no finite number, or larger than anything beside a road.
    """
    value = take_number_if_any(element, key, where)
    if value is not None and value > MAX_SIZE_M:
        raise InputError(f"{where}.{key}", value, f"metres, at most {MAX_SIZE_M:g}")
    return value if value is not None and value > 0.0 else None


def take_id(element: Element, where: str) -> str:
    """Attribute id, which must be there.

    Raises
    ------
    InputError
        It is missing or empty.
    """
    text = element.get("id", "").strip()
    if not text:
        raise InputError(f"{where}.id", Unquoted("nothing"), "an id")
    return text


def numbered(parent: Element | None, tag: str, where: str) -> Iterator[tuple[Element, str]]:
    """Children of one kind and where they stand: "Town.xodr: road 5 geometry[2]"."""
    for index, child in enumerate([] if parent is None else parent.findall(tag)):
        yield child, f"{where} {tag}[{index}]"
