"""One thing changed at a time, by the path of its fields."""

from dataclasses import replace
from typing import Any


def changed(thing: Any, path: str, value: Any) -> Any:
    """A copy with another value at the end of a path of fields.

    Of a sequence, its first item is changed. A function makes the value of the old one.
    """
    if isinstance(thing, (list, tuple)):
        return (changed(thing[0], path, value), *thing[1:])
    name, _, rest = path.partition(".")
    old = thing[name] if isinstance(thing, dict) else getattr(thing, name)
    if rest:
        new = changed(old, rest, value)
    elif callable(value):
        new = value(old)
    else:
        new = value
    if isinstance(thing, dict):
        return thing | {name: new}
    return replace(thing, **{name: new})
