"""Files: TOML into checked values, results whole or not at all, folders that are believed."""

import atexit
import csv
import errno
import glob
import io
import json
import math
import os
import re
import shutil
import stat
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import (
    Annotated,
    Any,
    BinaryIO,
    Literal,
    Protocol,
    TypeVar,
    get_args,
    get_origin,
)

import msgspec

from .errors import InputError, Unquoted, refuse

Table = Mapping[str, Any]
# Of a field that must not be empty.
Text = Annotated[str, msgspec.Meta(min_length=1)]
_T = TypeVar("_T")
# Of JSON or CSV that is read as a whole.
MAX_TEXT_BYTES = 300_000_000
# Python's reader takes half a second per million.
MAX_TOML_BYTES = 20_000_000
_PLACE = re.compile(r" - at `(key in )?\$(?P<path>.*)`$")
_STEP = re.compile(r"\.(\w+)|\[(\d+|\.\.\.)\]")
# A process may have made it and not locked it yet.
_YOUNG_S = 60.0


# ---------- the door: every file of a user's is opened, read and written by these functions
def check_file(path: Path, *, max_bytes: int | None = None) -> None:
    """Raise InputError unless a path is a regular file of a fair size.

    `max_bytes` is the most that may be read as a whole.

    A pipe or a device could keep its reader waiting for ever. A file that does not
    exist, or may not be looked at, is left to whoever opens it.
    """
    try:
        found = path.stat()
    except (OSError, ValueError):
        # ValueError: a zero byte in the name.
        return
    if not stat.S_ISDIR(found.st_mode):
        _check_found(found, str(path), max_bytes)


def _check_found(found: os.stat_result, where: str, max_bytes: int | None) -> None:
    if not stat.S_ISREG(found.st_mode):
        refuse(where, _kind(found.st_mode), "a regular file")
    if max_bytes is not None and found.st_size > max_bytes:
        refuse(
            where,
            f"{found.st_size:,} bytes",
            f"at most {max_bytes:,}; cut it out first",
        )


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "folder", stat.S_IFLNK: "link", stat.S_IFIFO: "pipe"}
    return "a " + (kinds | {stat.S_IFSOCK: "socket"}).get(stat.S_IFMT(mode), "device")


def open_file(path: Path, *, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading.

    Raises
    ------
    InputError
        It is no regular file, is too large, or cannot be opened.
    """
    # To open a device may already do something.
    check_file(path, max_bytes=max_bytes)

    # Without waiting for who would write into a pipe.
    def at_once(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    try:
        file = open(path, "rb", opener=at_once)  # noqa: SIM115 - Path has no opener
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), Unquoted(reason), "a readable file") from None
    try:
        _check_found(os.fstat(file.fileno()), str(path), max_bytes)
    except InputError:
        file.close()
        raise
    return file


def read_bytes(path: Path, *, max_bytes: int = MAX_TEXT_BYTES) -> bytes:
    """Content of a file; raises InputError as :func:`open_file` does."""
    with open_file(path, max_bytes=max_bytes) as file, reading(path):
        return file.read() or b""


@contextmanager
def reading(
    path: Path | str, expected: str = "", *damage: type[BaseException]
) -> Iterator[None]:
    """Raise InputError in place of errors of the system and of readers.

    `damage` are the exceptions that readers raise about damaged content;
    `expected` is what the message says then.
    """
    try:
        yield
    except InputError:
        raise
    except damage as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())[:200]
        raise InputError(
            str(path), Unquoted(reason or type(error).__name__), expected
        ) from None
    except OSError as error:
        raise InputError(
            str(path), Unquoted(error.strerror or error), "a readable file"
        ) from None


def read_text(path: Path, kind: str, *, max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Text of a UTF-8 file.

    `kind` is the kind of text that it holds, such as "JSON".

    Raises
    ------
    InputError
        As :func:`read_bytes`, or the text is not UTF-8.
    """
    try:
        return read_bytes(path, max_bytes=max_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(str(path), Unquoted(error), f"{kind} in UTF-8") from None


def csv_rows(
    text: str, where: str, *, separators: str = ",", noun: str = "fields"
) -> Iterator[tuple[str, list[str]]]:
    """Rows of CSV without empty ones: file and line, and the cells.

    The header comes first. Spaces around cells are removed.

    The first line says which of the separators it is. Raises InputError: it is no CSV,
    or a row has other numbers of cells than the header; `noun` is what the message
    calls these.
    """
    separator = max(separators, key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    n_cells = 0
    try:
        for row in reader:
            here = f"{where}: line {reader.line_num}"
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            n_cells = n_cells or len(cells)
            if len(cells) != n_cells:
                refuse(here, f"{len(cells)} {noun}", f"{n_cells}")
            yield here, cells
    except csv.Error as error:
        raise InputError(
            f"{where}: line {reader.line_num}", Unquoted(error), "a CSV file"
        ) from None


def open_new(path: Path) -> BinaryIO:
    """Create a file for writing in a folder of this program's own.

    Raises
    ------
    OSError
        The file is there already.
    """
    return path.open("xb")


def write_new(path: Path, text: str) -> None:
    """Write the text of a file that is not there yet, see :func:`open_new`."""
    with open_new(path) as file:
        file.write(text.encode())


def check_target(path: Path) -> None:
    """Raise InputError if a name belongs to anything but a regular file.

    A regular file is replaced.
    """
    if what := _obstacle(path):
        refuse(str(path), what, "a regular file's name, or one that is free")


def _obstacle(path: Path) -> str:
    """Kind of what has a name already, if it is in the way.

    Empty for a regular file, for a folder and for a free name.
    """
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError):
        return ""
    if stat.S_ISREG(mode) or stat.S_ISDIR(mode):
        return ""
    if stat.S_ISLNK(mode):
        with suppress(OSError):
            return f"a link to {path.readlink()}"
    return _kind(mode)


def write_atomically(
    path: Path,
    content: bytes | str | Callable[[BinaryIO], object],
    *,
    is_private: bool = False,
) -> None:
    """Write a file whole or not at all, under its name in a folder.

    The content goes to a temporary file in the same folder, which must exist;
    that file is then moved into place.

    Temporary files that a killed process left are removed. A callable writes the
    content to an open file; whatever it raises leaves `path` as it was. A private file
    is for this user alone. Raises OSError: something is in the way, see
    :func:`check_target`, or the system says no.
    """
    if what := _obstacle(path):
        raise FileExistsError(errno.EEXIST, f"{what}, no regular file", str(path))
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        if is_abandoned(left):
            left.unlink(missing_ok=True)
    handle, temporary = tempfile.mkstemp(
        prefix=f".{path.name}.", suffix=".tmp", dir=path.parent
    )
    try:
        with os.fdopen(handle, "wb") as file, lock_while_alive(Path(temporary)):
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        if not is_private:
            # As mkstemp makes files; a result is as readable as any other new file.
            mask = os.umask(0)
            os.umask(mask)
            Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


# ---------- TOML
def load_toml(source: Path | Traversable) -> dict[str, Any]:
    """Read a TOML file, or a data file of a package, as a whole.

    Raises
    ------
    InputError
        The file cannot be read, is larger than 20 MB, or is not TOML.
    """
    if isinstance(source, Path):
        text = read_text(source, "valid TOML", max_bytes=MAX_TOML_BYTES)
    else:
        text = source.read_text(encoding="utf-8")
    return parse_toml(text, str(source))


def load_data(package: str, name: str) -> dict[str, Any]:
    """Tables of a file in the folder ``data`` of one of this program's packages."""
    return load_toml(files(package) / "data" / name)


def read_data(package: str, name: str, kind: type[_T]) -> _T:
    """Value of such a file, see :func:`load_data` and :func:`read_table`."""
    return read_table(load_data(package, name), kind, name)


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Read TOML from a text.

    Raises
    ------
    InputError
        The text is not valid TOML; the message names `where`.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError(
            where, Unquoted("tables nested too deeply"), "valid TOML"
        ) from None
    except ValueError as error:
        # Also that of a number with thousands of digits.
        raise InputError(where, Unquoted(error), "valid TOML in UTF-8") from None


class _RepeatedKeyError(ValueError):
    """An object of a JSON text has a key twice."""


def parse_json(text: str | bytes, where: str, what: str) -> Any:
    """JSON as plain values; the only reader of JSON that others have written.

    An object with a key twice is refused: programs differ in which of the two values
    they take, so that such a file says one thing to the program that checks it and
    another to the next one.

    Parameters
    ----------
    text : str or bytes
        The whole document; bytes are UTF-8.
    where : str
        The file, for messages.
    what : str
        What is expected, for the message about JSON that is nested too deep.

    Raises
    ------
    InputError
        The text is no JSON in UTF-8, is nested too deep, or has a key twice.
    """
    try:
        if isinstance(text, bytes):
            text = text.decode("utf-8-sig")
        return json.loads(text, object_pairs_hook=_object_of)
    except RecursionError:
        raise InputError(where, Unquoted("JSON nested too deep"), what) from None
    except _RepeatedKeyError as error:
        raise InputError(
            where, Unquoted(error), "every key of an object once"
        ) from None
    except ValueError as error:
        # No JSON, no UTF-8, or a number of thousands of digits.
        raise InputError(where, Unquoted(error), "JSON in UTF-8") from None


def _object_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of its keys and values.

    Raises
    ------
    _RepeatedKeyError
        It has a key twice.
    """
    found = dict(pairs)
    if len(found) < len(pairs):
        seen: set[str] = set()
        for key, _ in pairs:
            if key in seen:
                raise _RepeatedKeyError(f"the key {json.dumps(key[:60])} twice")
            seen.add(key)
    return found


def float_of(value: Any) -> float:
    """The number that a value or a word is; NaN if it is none."""
    try:
        if isinstance(value, bool):
            return math.nan
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def parse_number(
    word: str, where: str, *, least: float = -math.inf, most: float = math.inf
) -> float:
    """The finite number that a word of a file is.

    `where` is the word's file, line and field.

    Raises
    ------
    InputError
        The word is no finite number, or outside `least` .. `most`.
    """
    # float() would also take 1_0 and other scripts' digits.
    if word.isascii() and "_" not in word:
        value = float_of(word)
    else:
        value = math.nan
    if not (math.isfinite(value) and least <= value <= most):
        if least == -math.inf:
            limits = ""
        else:
            limits = f", at least {least:g}"
        if most != math.inf:
            limits = f", {least:g} .. {most:g}"
        raise InputError(where, word, f"a finite number{limits}")
    return value


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


def _check_finite(value: object, where: str) -> None:
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
    if isinstance(cause, InputError) and cause.where:
        return cause
    place = _PLACE.search(message)
    if place:
        path = place["path"]
    else:
        path = ""
    value = table
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


# ---------- temporary files and folders: whose process is alive?
@contextmanager
def lock_while_alive(path: Path) -> Iterator[None]:
    """Lock a file or folder until the block or the process ends.

    The system lifts the lock when the process ends, however it ends.

    Where the system has no such locks, :func:`is_abandoned` never holds.
    """
    try:
        import fcntl
    except ImportError:
        # Windows.
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some network file systems have no locks.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def is_abandoned(path: Path, *, min_age_s: float = _YOUNG_S) -> bool:
    """True if no living process holds a temporary file or folder.

    False where that is not known, and for `min_age_s` after the last change:
    its process may not have locked it yet.
    """
    try:
        import fcntl

        if time.time() - path.stat().st_mtime < min_age_s:
            return False
        handle = os.open(path, os.O_RDONLY)
    except (ImportError, OSError):
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    else:
        return True
    finally:
        os.close(handle)


# ---------- folders whose content is believed
def user_cache_folder() -> Path:
    """The program's folder in the user's cache.

    A relative XDG_CACHE_HOME does not count.
    """
    from platformdirs import user_cache_path

    folder = user_cache_path("place-rsus")
    # As the XDG base directory specification demands.
    if folder.is_absolute():
        return folder
    return Path.home() / ".cache" / "place-rsus"


def trouble_with(folder: Path) -> str:
    """Make a folder where it is missing; say why it is not to be trusted.

    Empty if the folder can hold what is believed.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        return f"cannot be made ({error.strerror or error})"
    if not os.access(folder, os.W_OK | os.X_OK):
        return "cannot be written to"
    if writable_by_others(folder):
        return "can be written to by other users"
    return ""


@cache
def private_temporary_folder() -> Path:
    """A temporary folder of this user alone.

    It is the same in every call if it can be, otherwise a new one.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"
    folder = Path(tempfile.gettempdir()) / f"place-rsus-{user}"
    if not trouble_with(folder):
        return folder
    folder = Path(tempfile.mkdtemp(prefix="place-rsus-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def writable_by_others(path: Path) -> bool:
    """True if other users may change a file or folder, or put another one in its place.

    Every folder on the way, behind all links, is judged by owner and rights. A user's
    own group without other members is nobody else; root may do anything. False where
    there are no such rights, or no such file.
    """
    # Windows.
    if not hasattr(os, "getuid"):
        return False
    try:
        real = path.resolve(strict=True)
    except OSError:
        return False
    return any(
        _is_open(place.stat(), is_last=place == real) for place in (real, *real.parents)
    )


def _is_open(found: os.stat_result, *, is_last: bool) -> bool:
    import grp
    import pwd

    if found.st_uid not in (os.getuid(), 0):
        return True
    # What lies in a folder like /tmp can be moved by its owner alone.
    if found.st_mode & stat.S_ISVTX and not is_last:
        return False
    if (
        found.st_mode & stat.S_IWOTH
        or not found.st_mode & stat.S_IWGRP
        or found.st_gid == 0
    ):
        return bool(found.st_mode & stat.S_IWOTH)
    try:
        owner = pwd.getpwuid(found.st_uid).pw_name
        group = grp.getgrgid(found.st_gid)
    except KeyError:
        return True
    return group.gr_name != owner or bool(set(group.gr_mem) - {owner})


def open_own(path: Path) -> BinaryIO:
    """Open a file that this user or root alone can have written.

    Raises
    ------
    PermissionError
        Somebody else may have written it.
    OSError
        The file cannot be opened.
    """
    file = path.open("rb")
    # What is judged is what is read.
    found = os.fstat(file.fileno())
    if hasattr(os, "getuid") and _is_open(found, is_last=True):
        file.close()
        raise PermissionError(
            errno.EPERM, "another user may have written it", str(path)
        )
    return file


# ---------- progress
class Progress(Protocol):
    """A function that is called as a computation progresses."""

    def __call__(self, stage: str, done: int, total: int, /) -> None:
        """Take note of the stage that runs, and of its steps done and all.

        0 of 0: their number is not known.
        """


def silent(stage: str, done: int, total: int, /) -> None:
    """Progress that is shown nowhere."""


def counted(
    items: Iterable[_T], stage: str, total: int, progress: Progress
) -> Iterator[_T]:
    """Items of a stage, told one by one; `total` may be an estimate of their number."""
    for done, item in enumerate(items, start=1):
        progress(stage, min(done, total), total)
        yield item
