"""Tables of TOML and JSON files as checked values.

A value's type says what its table must hold: names, kinds, ranges and shapes. What
differs is an InputError that names the file, the field, the value and what is
expected.
"""

import re
import sys
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import msgspec

from .errors import InputError, Unquoted, refuse
from .text_formats import load_data

_T = TypeVar("_T")
Table = Mapping[str, Any]
# Of a field that must not be empty.
Text = Annotated[str, msgspec.Meta(min_length=1)]
_PLACE = re.compile(r" - at `(key in )?\$(?P<path>.*)`$")
_STEP = re.compile(r"\.(\w+)|\[(\d+|\.\.\.)\]")


def says(description: str, **limits: Any) -> msgspec.Meta:
    """Description of a field for the schema, with limits of its value.

    `limits` are those of msgspec: ge, le, min_length.
    """
    return msgspec.Meta(extra={"description": description}, **limits)


def read_table(table: object, kind: type[_T], where: str) -> _T:
    """Convert a table of a TOML or JSON file to a value; numbers are finite.

    `kind`: a frozen dataclass or msgspec.Struct whose fields have the names of the
    table's keys, or a list or tuple of such. Arrays state their shape, as in
    :mod:`geometry.arrays`. Ranges stand in ``Annotated[float, msgspec.Meta(gt=0)]``; a
    description there is what the message says to be expected. Keys that are no field
    are ignored, unless a Struct says ``forbid_unknown_fields``.

    `where`: "sensors.toml", or "sensors.toml: wide" for an entry of it. Raises
    InputError: names the file, the field, the value and what is expected. One that a
    value raises itself with an empty ``where`` is completed.
    """
    _check_finite(table, where)
    try:
        return msgspec.convert(table, kind, dec_hook=_read_array)
    except msgspec.ValidationError as error:
        raise _input_error(error, table, kind, where) from None
    except UnicodeEncodeError as error:
        # JSON can spell half of a surrogate pair.
        raise InputError(where, error.object, "text of whole characters") from None


def read_tables(table: Table, kind: type[_T], where: str) -> dict[str, _T]:
    """Convert a table of named tables; each entry's key is its field ``name``."""
    entries = {}
    for name, entry in table.items():
        here = _join(where, f".{name}")
        if not isinstance(entry, Mapping):
            raise InputError(here, entry, "a table of fields")
        entries[name] = read_table({**entry, "name": name}, kind, here)
    return entries


def read_data(package: str, name: str, kind: type[_T]) -> _T:
    """Value of such a file, see :func:`load_data` and :func:`read_table`."""
    return read_table(load_data(package, name), kind, name)


def _check_finite(value: object, where: str) -> None:
    """Raise InputError at the first number that is not finite."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            _check_finite(item, _join(where, f".{key}"))
    elif isinstance(value, list):
        if any(isinstance(item, Mapping) for item in value):
            for index, item in enumerate(value):
                _check_finite(item, _join(where, f"[{index}]"))
        elif not _is_finite(value):
            raise InputError(where, value, "finite numbers")
    elif not _is_finite(value):
        raise InputError(where, value, "a finite number")


def _is_finite(value: object) -> bool:
    """Whether a number, or each number in a list of lists, is finite."""
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, int | float) or abs(value) <= sys.float_info.max


def _join(where: str, path: str) -> str:
    """A path such as ".sites[2].id" behind the name of a file, or of an entry in it."""
    if ": " in where:
        return f"{where}{path}"
    return f"{where}: {path.removeprefix('.')}"


def _read_array(kind: Any, value: object) -> Any:
    """Convert a list to an array of the shape that its type states; msgspec's hook."""
    # Here: messages and help need no numbers.
    import numpy as np

    from .arrays import float_array

    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError(f"no reader for {kind}")
    axes = get_args(get_args(kind)[0])
    shape = tuple(
        get_args(axis)[0] if get_origin(axis) is Literal else -1 for axis in axes
    )
    if not isinstance(value, list):
        raise InputError("", value, "a list")
    return float_array(value, shape, "")


def _input_error(
    error: msgspec.ValidationError, table: object, kind: Any, where: str
) -> InputError:
    """Error of msgspec in our words.

    msgspec knows the place and the type, but not the value.
    """
    message = str(error)
    cause = error.__cause__
    # Of a field's own check.
    # A value's own check may know the place better.
    if isinstance(cause, InputError) and cause.where:
        return cause
    place = _PLACE.search(message)
    if place:
        path = place["path"]
    else:
        path = ""
    value = table
    # Down the path of the message, through the type and the value at once.
    node = msgspec.inspect.type_info(kind)
    shown = ""
    for step in _STEP.finditer(path):
        node = _step_into(node, step, value)
        # A key of a mapping, which msgspec does not name.
        if step[2] == "...":
            break
        value = value[step[1] or int(step[2])]  # type: ignore[index]
        shown += step[0]
    if shown:
        here = _join(where, shown)
    else:
        here = where
    if isinstance(cause, InputError):
        # Of an array, or of a value that leaves the place to us.
        return InputError(here, cause.got, cause.expected)
    # msgspec quotes the name of the field in its message.
    if missing := re.match(r"Object missing required field `(.*?)`", message):
        return InputError(
            _join(where, f"{shown}.{missing[1]}"), Unquoted("nothing"), "a value"
        )
    if unknown := re.match(r"Object contains unknown field `(.*?)`", message):
        known = ", ".join(
            field.encode_name for field in _plain(_of_tag(node, value)).fields
        )
        return InputError(here, unknown[1], f"one of {known}")
    return InputError(here, value, _expected(node, is_other_type=", got " in message))


def _plain(node: Any) -> Any:
    """The type of table that a field of the value names.

    Where only one type is possible, it is that type.
    """
    while isinstance(node, msgspec.inspect.Metadata | msgspec.inspect.UnionType):
        if isinstance(node, msgspec.inspect.Metadata):
            node = node.type
        else:
            node = _members(node)[0]
    return node


def _members(node: msgspec.inspect.UnionType) -> list[Any]:
    """Types of a union except None."""
    return [one for one in node.types if not isinstance(one, msgspec.inspect.NoneType)]


def _of_tag(node: Any, value: Any) -> Any:
    """Values that a type accepts, in words.

    Of a number that is out of range, the words tell the range.
    """
    if not isinstance(node, msgspec.inspect.UnionType) or len(_members(node)) == 1:
        return node
    return next(one for one in _members(node) if one.tag == value[one.tag_field])


def _step_into(node: Any, step: re.Match[str], value: Any) -> Any:
    """Type of a field or of an item of a value."""
    if isinstance(node, msgspec.inspect.UnionType) and len(_members(node)) > 1:
        if step[1] == _members(node)[0].tag_field:
            return msgspec.inspect.LiteralType(tuple(one.tag for one in _members(node)))
        node = _of_tag(node, value)
    node = _plain(node)
    if step[1] is not None:
        return next(field.type for field in node.fields if field.encode_name == step[1])
    if isinstance(node, msgspec.inspect.DictType):
        return node.value_type
    if isinstance(node, msgspec.inspect.TupleType):
        return node.item_types[int(step[2])]
    return node.item_type


def _expected(node: Any, *, is_other_type: bool) -> str:
    """Values that a type accepts, in words; of a number, in which range."""
    if isinstance(node, msgspec.inspect.UnionType):
        node = _members(node)[0]
    if isinstance(node, msgspec.inspect.Metadata):
        description = (node.extra_json_schema or {}).get("description")
        if description:
            return str(description)
    match _plain(node):
        case msgspec.inspect.LiteralType(values=values):
            return "one of " + ", ".join(map(str, values))
        case msgspec.inspect.EnumType(cls=kind):
            return "one of " + ", ".join(str(member.value) for member in kind)
        case msgspec.inspect.FloatType() | msgspec.inspect.IntType() as number:
            is_whole = isinstance(number, msgspec.inspect.IntType)
            signs = {" > ": number.gt, " < ": number.lt}
            signs |= {", at least ": number.ge, ", at most ": number.le}
            known = [
                f"{sign}{most:g}" for sign, most in signs.items() if most is not None
            ]
            if is_other_type:
                limits = ""
            else:
                limits = "".join(known)
            if limits:
                plain = "a number"
            else:
                plain = "a finite number"
            return ("a whole number" if is_whole else plain) + limits
        case msgspec.inspect.StrType():
            return "text"
        case msgspec.inspect.BoolType():
            return "true or false"
        case msgspec.inspect.TupleType(item_types=items):
            return f"a list of {len(items)}"
        case msgspec.inspect.ListType() | msgspec.inspect.VarTupleType():
            return "a list"
        case _:
            return "a table"


def take(table: Table, key: str, where: str, kind: Any = None) -> Any:
    """Value of a key that must be there; of a kind, see :func:`read_table`."""
    if key not in table:
        refuse(f"{where}.{key}", "nothing", "a value")
    if kind is None:
        return table[key]
    return read_table(table[key], kind, f"{where}.{key}")


def take_number(table: Table, key: str, where: str) -> float:
    """Finite number of a key that must be there."""
    return float(take(table, key, where, float))


def take_text(table: Table, key: str, where: str) -> str:
    """Text of a key that must be there."""
    return str(take(table, key, where, Text))


def take_list(table: Table, key: str, where: str) -> list[Any]:
    """List of a key that must be there."""
    return list(take(table, key, where, list))


def pick(known: Mapping[str, _T], name: str, where: str) -> _T:
    """Look a name up; the error about an unknown one lists the known ones."""
    if name not in known:
        raise InputError(where, name, "one of " + ", ".join(sorted(known)))
    return known[name]
