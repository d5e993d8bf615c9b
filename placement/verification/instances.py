"""``instance.npz``: a whole problem as a file that any program can read, and its hash.

It is compressed and holds no Python objects: numpy's arrays under the names in ``_FIELDS``. What
may be missing is missing where it is None. Beside the problem it may have what the poses are, see
:mod:`.mounts`.
"""

import hashlib
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError, Unquoted
from geometry.files import open_file, write_atomically
from geometry.untrusted_files import is_text, unpacked_bytes
from scenarios.aeb import AebRule
from scenarios.positions import AT_ZERO
from scenarios.runs import FrameAxis

from ..detection_table import DetectionTable
from ..memory import check_fits
from ..optimiser import Failing, Floor, Fusion, Goal, Limits, PlacementProblem
from .mounts import FIELDS as MOUNT_FIELDS
from .mounts import Mounts
from .mounts import from_arrays as mounts_from_arrays
from .mounts import to_arrays as mounts_to_arrays

INSTANCE_FILE = "instance.npz"
KIND = "place-rsus/placement-problem/1"
"""What a file says that holds a problem alone; raise the number whenever the fields change."""
KIND_WITH_MOUNTS = "place-rsus/placement-problem/2"
"""What a file says that also has what the poses are, see :mod:`.mounts`."""
KINDS = (KIND, KIND_WITH_MOUNTS)

_UNPACKED_BYTES = 4  # of memory for each byte of a file, unpacked, while it is read and checked
Arrays = dict[str, NDArray[Any]]


class _Field(NamedTuple):
    """An array of the file: its type, what its axes count, whether it may be missing."""

    dtype: str
    axes: tuple[str, ...] = ()
    is_optional: bool = False


_FIELDS: Mapping[str, _Field] = {
    "kind": _Field("str"),
    # The detection table: rows, columns, bits; lowest bit first.
    "pose_ids": _Field("str", ("poses",)),
    "run_ids": _Field("str", ("runs",)),
    "cases": _Field("str", ("runs",)),
    "approaches": _Field("str", ("runs",)),
    "positions": _Field("str", ("runs",), is_optional=True),  # older files: 0 everywhere
    "weathers": _Field("str", ("runs",)),
    "vut_speed_kmh": _Field("float64", ("runs",)),
    "weight": _Field("float64", ("runs",)),
    "last_brake_time_s": _Field("float64", ("runs",)),
    "run_start": _Field("int64", ("run starts",)),
    "time_s": _Field("float64", ("frames",)),
    "packed": _Field("uint8", ("poses", "bytes")),
    # Limits.
    "site_index": _Field("int64", ("poses",)),
    "site_capacity": _Field("int64", ("sites",)),
    "budget_units": _Field("int64", is_optional=True),
    "budget_eur": _Field("float64", is_optional=True),
    "unit_cost_eur": _Field("float64", ("poses",)),
    "site_cost_eur": _Field("float64", ("sites",)),
    "is_forced": _Field("bool", ("poses",)),
    "is_forbidden": _Field("bool", ("poses",)),
    "is_forced_site": _Field("bool", ("sites",)),
    "rivals": _Field("int64", ("pairs", "2")),
    "failing": _Field("str", is_optional=True),  # units where it is missing
    # What is asked.
    "fusion": _Field("str"),
    "goal": _Field("str"),
    "survive": _Field("int64"),
    "sample_index": _Field("int64", ("runs",), is_optional=True),
    "tail": _Field("float64"),
    "floor_names": _Field("str", ("floors",)),
    "floor_shares": _Field("float64", ("floors",)),
    "floor_failures": _Field("int64", ("floors",)),
    "floor_counts_all": _Field("bool", ("floors",)),  # by the problem's own measure
    "floor_is_counted": _Field("bool", ("floors", "runs")),
    # The rule.
    "deceleration_mps2": _Field("float64"),
    "build_up_s": _Field("float64"),
    "latency_s": _Field("float64"),
    "n_confirmations": _Field("int64"),
    "frame_rate_hz": _Field("float64"),
    "track_memory_s": _Field("float64", is_optional=True),  # infinite where it is missing
}


_MOUNT_FIELDS = {name: _Field(*field) for name, field in MOUNT_FIELDS.items()}


def save_problem(path: Path, problem: PlacementProblem, mounts: Mounts | None = None) -> None:
    """Write a problem, whole or not at all; the same problem always makes the same file.

    Raises InputError if a name ends with a null character, which numpy's text cannot hold, and
    OSError if the file cannot be written.
    """
    arrays = _to_arrays(problem, mounts)
    write_atomically(path, lambda file: _write_arrays(file, arrays))


def _write_arrays(file: BinaryIO, arrays: Arrays) -> None:
    """What numpy's ``savez_compressed`` writes, 6 % larger, in a third of its time."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


class StoredProblem(NamedTuple):
    """What an instance file holds."""

    problem: PlacementProblem
    mounts: Mounts | None  # None: the file does not say what the poses are


def load_problem(path: str | Path) -> PlacementProblem:
    """Read a problem from a file, without what its poses are."""
    return load_stored_problem(Path(path)).problem


def load_stored_problem(path: Path) -> StoredProblem:
    """Read a problem and what its poses are, checked field by field.

    Parameters
    ----------
    path : Path
        Written by :func:`save_problem`, or by others in the same form.

    Returns
    -------
    stored : StoredProblem
        With the hash of the one that was written.

    Raises
    ------
    InputError
        The file is missing, damaged or of another kind; a field is missing, unknown, or has
        another type or shape; or the values contradict each other.
    """
    with _archive(path) as archive:
        kind = _read_kind(archive, str(path))
        if kind not in KINDS:
            raise InputError(f"{path}: kind", kind, " or ".join(KINDS))
        known = _FIELDS if kind == KIND else {**_FIELDS, **_MOUNT_FIELDS}
        unknown = sorted(set(archive.files) - set(known))
        if unknown:
            raise InputError(f"{path}: {unknown[0]}", Unquoted("a field"), "none of this name")
        arrays = {name: _read(archive, name, str(path)) for name in archive.files}
    _check_fields(arrays, known, str(path))
    try:
        mounts = mounts_from_arrays(arrays) if known is not _FIELDS else None
        return StoredProblem(_from_arrays(arrays), mounts)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.got, error.expected) from None


def instance_kind(path: Path) -> str:
    """What an instance file says it holds, such as :data:`KIND`.

    Raises InputError: it is no ``.npz``, or does not say.
    """
    with _archive(path) as archive:
        return _read_kind(archive, str(path))


def problem_hash(problem: PlacementProblem, mounts: Mounts | None = None) -> str:
    """SHA-256 of a problem, and of what its poses are, 64 hexadecimal digits.

    It is taken over the names, types, shapes and bytes (little-endian) of the fields in
    alphabetical order; texts are taken as JSON.
    """
    digest = hashlib.sha256()
    content: bytes | memoryview
    for name, array in sorted(_to_arrays(problem, mounts).items()):
        if array.dtype.kind == "U":
            type_name, content = "str", json.dumps(array.tolist()).encode()
        else:
            # Adding zero turns -0.0, which equals 0.0, into it.
            values = array + 0.0 if array.dtype.kind == "f" else array
            type_name = values.dtype.name
            little = values.astype(values.dtype.newbyteorder("<"), copy=False)
            content = np.ascontiguousarray(little).reshape(-1).view(np.uint8).data
        digest.update(f"{name}\0{type_name}\0{array.shape}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def is_never_lost(rule: AebRule) -> bool:
    """Whether a confirmed track lives for ever."""
    return rule.track_memory_s == math.inf


def _to_arrays(problem: PlacementProblem, mounts: Mounts | None) -> Arrays:
    table, axis, limits, rule = problem.table, problem.table.axis, problem.limits, problem.rule
    floors = problem.floors
    counted = [
        np.ones(axis.n_runs, dtype=bool) if floor.is_counted is None else floor.is_counted
        for floor in floors
    ]
    values = {
        "kind": KIND if mounts is None else KIND_WITH_MOUNTS,
        "pose_ids": table.pose_ids,
        "packed": _without_padding(table),
        "floor_names": [floor.name for floor in floors],
        "floor_shares": [floor.share for floor in floors],
        "floor_failures": [floor.n_failures for floor in floors],
        "floor_counts_all": [floor.is_counted is None for floor in floors],
        "floor_is_counted": np.array(counted, dtype=bool).reshape(len(floors), axis.n_runs),
    }
    for owner in (axis, limits, problem, rule):
        values |= {name: getattr(owner, name) for name in _FIELDS if hasattr(owner, name)}
    if is_never_lost(rule):
        del values["track_memory_s"]
    if limits.failing == "unit":
        del values["failing"]  # the same file, and hash, as before sites could fail
    if set(axis.positions) == {AT_ZERO.name}:
        del values["positions"]  # the same file, and hash, as before there were others
    arrays = {
        name: np.asarray(value, dtype=_FIELDS[name].dtype)
        for name, value in values.items()
        if value is not None
    }
    for name, array in arrays.items():
        if array.dtype.kind == "U" and array.ndim and array.tolist() != list(values[name]):
            raise InputError(name, list(values[name]), "names without a null character at the end")
    return arrays if mounts is None else arrays | mounts_to_arrays(mounts)


def _from_arrays(arrays: Arrays) -> PlacementProblem:
    def texts(name: str) -> tuple[str, ...]:
        return tuple(arrays[name].tolist())

    def number(name: str) -> Any:
        return arrays[name].item() if name in arrays else None

    axis = FrameAxis(
        run_ids=texts("run_ids"),
        cases=texts("cases"),
        approaches=texts("approaches"),
        positions=texts("positions") if "positions" in arrays else (),
        weathers=texts("weathers"),
        vut_speed_kmh=arrays["vut_speed_kmh"],
        weight=arrays["weight"],
        last_brake_time_s=arrays["last_brake_time_s"],
        run_start=arrays["run_start"],
        time_s=arrays["time_s"],
    )
    table = DetectionTable(pose_ids=texts("pose_ids"), axis=axis, packed=arrays["packed"])
    if len(set(table.pose_ids)) < table.n_poses:
        raise InputError("pose_ids", Unquoted("an id twice"), "every id once")
    if not np.array_equal(_without_padding(table), table.packed):
        raise InputError("packed", Unquoted("bits behind the last frame"), "zeros there")
    return PlacementProblem(
        table=table,
        limits=Limits(
            site_index=arrays["site_index"],
            site_capacity=arrays["site_capacity"],
            budget_units=number("budget_units"),
            budget_eur=number("budget_eur"),
            unit_cost_eur=arrays["unit_cost_eur"],
            site_cost_eur=arrays["site_cost_eur"],
            is_forced=arrays["is_forced"],
            is_forbidden=arrays["is_forbidden"],
            is_forced_site=arrays["is_forced_site"],
            rivals=arrays["rivals"],
            failing=cast(Failing, number("failing") or "unit"),
        ),
        fusion=cast(Fusion, number("fusion")),
        rule=AebRule(
            deceleration_mps2=number("deceleration_mps2"),
            build_up_s=number("build_up_s"),
            latency_s=number("latency_s"),
            n_confirmations=number("n_confirmations"),
            frame_rate_hz=number("frame_rate_hz"),
            track_memory_s=number("track_memory_s") if "track_memory_s" in arrays else math.inf,
        ),
        floors=tuple(
            Floor(
                name=name,
                share=share,
                is_counted=None if counts_all else counted,
                n_failures=n_failures,
            )
            for name, share, counts_all, counted, n_failures in zip(
                texts("floor_names"),
                arrays["floor_shares"].tolist(),
                arrays["floor_counts_all"].tolist(),
                arrays["floor_is_counted"],
                arrays["floor_failures"].tolist(),
                strict=True,
            )
        ),
        goal=cast(Goal, number("goal")),
        survive=number("survive"),
        sample_index=arrays.get("sample_index"),
        tail=number("tail"),
    )


def _without_padding(table: DetectionTable) -> NDArray[np.uint8]:
    """The table's bits; those behind the last frame, which mean nothing, are 0."""
    n_last = table.axis.n_frames % 8
    padding = np.uint8(0xFF << n_last & 0xFF if n_last else 0)
    if not table.packed.shape[1] or not (table.packed[:, -1] & padding).any():
        return table.packed
    packed: NDArray[np.uint8] = table.packed.copy()
    packed[:, -1] &= ~padding
    return packed


@contextmanager
def _archive(path: Path) -> Iterator[np.lib.npyio.NpzFile]:
    """An archive that says what kind it is; whatever is wrong with it is an InputError."""
    try:
        # Not np.load(): it takes whatever is no archive for a pickle, and says so.
        with open_file(path) as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            if "kind" not in archive.files:
                raise InputError(f"{path}: kind", Unquoted("nothing"), f"a text such as {KIND}")
            assert archive.zip is not None  # it is open
            n_bytes = unpacked_bytes(archive.zip, str(path))
            check_fits(
                str(path),
                f"{n_bytes:,} bytes when unpacked",
                _UNPACKED_BYTES * n_bytes,
                "fewer poses or frames",
            )
            yield archive
    except InputError:
        raise
    except OSError as error:
        reason = error.strerror or error
        raise InputError(str(path), Unquoted(reason), "a readable instance file") from None
    except Exception as error:  # what damaged archives raise has no end: zipfile's, zlib's, ..
        raise _damaged(str(path), error) from None


def _read(archive: np.lib.npyio.NpzFile, name: str, where: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] | bytes = archive[name]
    except Exception as error:
        raise _damaged(f"{where}: {name}", error) from None
    if not isinstance(array, np.ndarray):  # what does not begin as an array comes as bytes
        raise InputError(f"{where}: {name}", Unquoted("no array"), "an array")
    if array.dtype.kind == "U" and not is_text(array):
        raise InputError(f"{where}: {name}", Unquoted("characters that are none"), "texts")
    return array


def _read_kind(archive: np.lib.npyio.NpzFile, where: str) -> str:
    kind = _read(archive, "kind", where)
    if kind.dtype.kind != "U" or kind.shape != ():
        raise InputError(f"{where}: kind", Unquoted("no text"), f"a text such as {KIND}")
    return str(kind)


def _damaged(where: str, error: Exception) -> InputError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return InputError(where, Unquoted(reason), "an undamaged instance file (.npz)")


def _check_fields(arrays: Arrays, known: Mapping[str, _Field], where: str) -> None:
    """Whether all fields are there, of their types, and agree about what their axes count."""
    sizes: dict[str, int] = {"2": 2, "3": 3}
    for name, field in known.items():
        if name not in arrays:
            if field.is_optional:
                continue
            raise InputError(f"{where}: {name}", Unquoted("nothing"), "an array")
        array = arrays[name]
        is_text = field.dtype == "str"
        if array.dtype.kind != "U" if is_text else array.dtype != np.dtype(field.dtype):
            raise InputError(f"{where}: {name}", Unquoted(f"type {array.dtype}"), field.dtype)
        if array.ndim != len(field.axes):
            raise InputError(
                f"{where}: {name}",
                Unquoted(f"{array.ndim} axes"),
                f"{len(field.axes)} ({', '.join(field.axes) or 'a single value'})",
            )
        for axis, size in zip(field.axes, array.shape, strict=True):
            if sizes.setdefault(axis, size) != size:
                raise InputError(
                    f"{where}: {name}", Unquoted(f"shape {array.shape}"), f"{sizes[axis]} {axis}"
                )
