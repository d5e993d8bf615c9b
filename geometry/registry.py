"""Implementations by name: what a name stands for is loaded when it is asked for.

A registry is plain data: a dict from a name, or the suffix of a file, to
"package.module:attribute". A full-text search for the name finds the place, and who
looks it up depends on no implementation.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from .errors import InputError


def load_entry(place: str) -> Any:
    """Load what "package.module:attribute" stands for.

    >>> load_entry("math:hypot")(3.0, 4.0)
    5.0
    """
    module, _, attribute = place.partition(":")
    return getattr(import_module(module), attribute)


def pick_entry(entries: Mapping[str, str], name: str, *, where: str) -> Any:
    """Load the entry of a name.

    Raises InputError, which lists the known names: there is none of that name.

    >>> pick_entry({"length": "math:hypot"}, "width", where="measure")
    Traceback (most recent call last):
    ...
    geometry.errors.InputError: measure: got 'width'; expected one of length
    """
    if name not in entries:
        raise InputError(where, name, "one of " + ", ".join(entries))
    return load_entry(entries[name])
