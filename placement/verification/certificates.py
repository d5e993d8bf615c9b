"""``certificate.json``: what was solved, what was found, and how good it is said to be.

Beside it lies ``instance.npz``, the whole problem: together they are enough to check the claim
without the optimiser, see :mod:`placement.verification.verify`. It is compressed and holds no
Python objects, so that any program can read it: numpy's arrays under the names in ``_FIELDS``.
What may be missing is missing where it is None.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError, Unquoted
from geometry.files import (
    MAX_TEXT_BYTES,
    check_file,
    take,
    take_list,
    take_number,
    take_text,
    write_atomically,
)
from geometry.untrusted_files import MAX_UNPACKED_BYTES, unpacked_bytes
from scenarios.aeb import AebRule
from scenarios.positions import AT_ZERO
from scenarios.runs import FrameAxis

from ..detection_table import DetectionTable
from ..layout import Certificate, Stage
from ..optimiser import Floor, Fusion, Goal, Limits, PlacementProblem, PresolveStatistics
from ..optimiser.objectives import Objective

SCHEMA = "place-rsus/certificate/1"
CERTIFICATE_FILE = "certificate.json"
INSTANCE_FILE = "instance.npz"

_FORMULAS: Mapping[Objective, str] = {
    Objective.UNITS: "least sum_c x_c: the number of units",
    Objective.COST: "least sum_c price_c x_c + sum_s price_s u_s, u_s = 1 if site s carries a unit",
    Objective.APR_SURVIVED: "most of what is left of the APR when any `survive` of the units fail",
    Objective.APR: "most A(avoided): sum_r w_r a_r over the runs; with a tail, its mean over the "
    "worst share `tail` of the sampled worlds (conditional value at risk)",
    Objective.APR_ONE_FAILED: "most of min over the chosen c of the APR without c",
    Objective.SMALLEST_MARGIN: "largest min over the avoided runs with weight of last brake time - "
    "(confirmation + latency)",
    Objective.MEAN_MARGIN: "largest sum_r w_r a_r margin_r / sum_r w_r a_r",
}
_FUSIONS: Mapping[str, str] = {
    "any": "frame f is seen if a chosen pose detects in it: y_f <= sum_c V[c,f] x_c",
    "single": "one chosen pose must detect in all frames of the window by itself",
}
_AVOIDED = (
    "a_r = 1 if a window of n frames in a row of run r is seen and the time of its last frame "
    "+ latency <= last brake time of r"
)
_ALIVE = (
    "; and if from then on until last brake time - latency no longer than track_memory_s passes "
    "without a frame that is seen"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredCertificate:
    """What a ``certificate.json`` claims, read and checked for form only."""

    sha256: str  # hash of the problem, see :func:`problem_hash`
    model: Mapping[str, Any]  # what :func:`model_of` says, and the names of the "stages" in order
    pose_index: tuple[int, ...]  # rows of the detection table
    pose_ids: tuple[str, ...]  # their names there
    units: tuple[Mapping[str, Any], ...]  # as ``layout.json`` has them
    stages: tuple[Stage, ...]  # objectives in order, each with what is claimed of it
    is_proven: tuple[bool, ...]  # whether each stage is claimed to be optimal
    all_proven: bool  # whether the layout is
    solver: str  # name and version of what the proof rests on
    presolve: Mapping[str, tuple[int, int]]  # sizes before and after

    def __repr__(self) -> str:
        return f"StoredCertificate({list(self.pose_ids)}, {self.solver!r})"


def build_certificate(
    problem: PlacementProblem,
    certificate: Certificate,
    *,
    pose_index: Sequence[int],
    units: Sequence[Mapping[str, Any]],
    presolve: PresolveStatistics,
    seconds: Mapping[str, float],
    versions: Mapping[str, str],
) -> dict[str, Any]:
    """The document that ``certificate.json`` holds; an infinite gap is None in it.

    `units` are the units as the layout's file has them, and `pose_index` their rows of the
    detection table in the same order. `seconds` says how long the steps took, `versions` which
    programs the numbers depend on.
    """
    axis = problem.table.axis
    return {
        "schema": SCHEMA,
        "instance": {
            "file": INSTANCE_FILE,
            "kind": KIND,
            "sha256": problem_hash(problem),
            "n_poses": problem.table.n_poses,
            "n_sites": problem.limits.n_sites,
            "n_runs": axis.n_runs,
            "n_frames": axis.n_frames,
        },
        "model": {
            **model_of(problem),
            "stages": [stage.name for stage in certificate.stages],
            "in_words": {
                "fusion": _FUSIONS[problem.fusion],
                "avoided": _AVOIDED + ("" if _is_never_lost(problem.rule) else _ALIVE),
                **{stage.name: _FORMULAS[Objective(stage.name)] for stage in certificate.stages},
            },
        },
        "layout": [
            {"row": int(row), "pose": problem.table.pose_ids[row], "unit": dict(unit)}
            for row, unit in zip(pose_index, units, strict=True)
        ],
        "stages": [
            {
                **asdict(stage),
                "gap": stage.gap if math.isfinite(stage.gap) else None,  # JSON has no infinity
                "is_proven": stage.gap == 0.0,
            }
            for stage in certificate.stages
        ],
        "is_proven": certificate.is_proven,
        "solver": certificate.solver,
        "presolve": {name: list(sizes) for name, sizes in asdict(presolve).items()},
        "seconds": dict(seconds),
        "versions": dict(versions),
    }


def save_certificate(folder: Path, document: Mapping[str, Any], problem: PlacementProblem) -> None:
    """Write ``certificate.json`` and ``instance.npz`` into a folder that exists.

    `document` is that of :func:`build_certificate`. Raises OSError if the folder cannot be written
    to.
    """
    save_problem(folder / INSTANCE_FILE, problem)
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(folder / CERTIFICATE_FILE, lambda file: file.write(text.encode()))


def load_certificate(path: Path) -> StoredCertificate:
    """Read a ``certificate.json``; whether its claims are true is not looked at.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    stored : StoredCertificate
        What it claims.

    Raises
    ------
    InputError
        The file cannot be read, is no certificate, or a field is missing or not of its kind.
    """
    where = str(path)
    check_file(path, max_bytes=MAX_TEXT_BYTES)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
    except RecursionError:
        raise InputError(where, Unquoted("JSON nested too deep"), "a certificate") from None
    except ValueError as error:  # no JSON, no UTF-8, or a number of thousands of digits
        raise InputError(where, Unquoted(error), "JSON in UTF-8") from None
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else Unquoted("no object")
        raise InputError(f"{where}: schema", got, SCHEMA)
    instance = _take_table(document, "instance", where)
    presolve = _take_table(document, "presolve", where)
    units = _take_objects(document, "layout", where)
    stages = _take_objects(document, "stages", where)
    return StoredCertificate(
        sha256=take_text(instance, "sha256", f"{where}: instance"),
        model=_take_table(document, "model", where),
        pose_index=tuple(_take_count(unit, "row", here) for here, unit in units),
        pose_ids=tuple(take_text(unit, "pose", here) for here, unit in units),
        units=tuple(_take_table(unit, "unit", here) for here, unit in units),
        stages=tuple(_read_stage(stage, here) for here, stage in stages),
        is_proven=tuple(_take_flag(stage, "is_proven", here) for here, stage in stages),
        all_proven=_take_flag(document, "is_proven", where),
        solver=take_text(document, "solver", where),
        presolve={
            field.name: _take_pair(presolve, field.name, f"{where}: presolve")
            for field in fields(PresolveStatistics)
        },
    )


def model_of(problem: PlacementProblem) -> dict[str, Any]:
    """What a problem asks, and within which limits, as plain values for JSON."""
    axis, limits, samples = problem.table.axis, problem.limits, problem.sample_index
    return {
        "fusion": problem.fusion,
        "goal": problem.goal,
        "survive": problem.survive,
        "tail": problem.tail,
        "n_samples": 0 if samples is None else int(samples.max()) + 1,
        "limits": {
            "budget_units": limits.budget_units,
            "budget_eur": limits.budget_eur,
            "n_forced_units": int(limits.is_forced.sum()),
            "n_forbidden_units": int(limits.is_forbidden.sum()),
            "n_forced_sites": int(limits.is_forced_site.sum()),
            "n_rival_pairs": len(limits.rivals),
        },
        "floors": [
            {
                "name": floor.name,
                "apr": float(floor.share),
                "n_failures": floor.n_failures,
                "n_runs": axis.n_runs if floor.is_counted is None else int(floor.is_counted.sum()),
            }
            for floor in problem.floors
        ],
        "rule": {
            name: value
            for name, value in asdict(problem.rule).items()
            # Left out where it means nothing: JSON has no infinity.
            if name != "track_memory_s" or not _is_never_lost(problem.rule)
        },
    }


def _take_table(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    value = take(table, key, where)
    if not isinstance(value, dict):
        raise InputError(f"{where}.{key}", value, "an object")
    return value


def _take_objects(
    table: Mapping[str, Any], key: str, where: str
) -> list[tuple[str, Mapping[str, Any]]]:
    """Objects of a list that is not empty, and where each stands."""
    values = take_list(table, key, where)
    if not values:
        raise InputError(f"{where}.{key}", values, "at least one")
    objects: list[tuple[str, Mapping[str, Any]]] = []
    for index, value in enumerate(values):
        here = f"{where}.{key}[{index}]"
        if not isinstance(value, dict):
            raise InputError(here, value, "an object")
        objects.append((here, value))
    return objects


def _take_flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    value = take(table, key, where)
    if not isinstance(value, bool):
        raise InputError(f"{where}.{key}", value, "true or false")
    return value


def _take_count(table: Mapping[str, Any], key: str, where: str) -> int:
    return _count(take(table, key, where), f"{where}.{key}")


def _take_pair(table: Mapping[str, Any], key: str, where: str) -> tuple[int, int]:
    values = take_list(table, key, where)
    if len(values) != 2:
        raise InputError(f"{where}.{key}", values, "two numbers: before, after")
    before, after = (_count(value, f"{where}.{key}") for value in values)
    return before, after


def _count(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise InputError(where, value, "a whole number, at least 0")
    return value


def _read_stage(table: Mapping[str, Any], where: str) -> Stage:
    has_gap = take(table, "gap", where) is not None
    return Stage(
        name=take_text(table, "name", where),
        objective=take_number(table, "objective", where),
        bound=take_number(table, "bound", where),
        gap=take_number(table, "gap", where) if has_gap else math.inf,
        seconds=take_number(table, "seconds", where),
    )


# ---------- the problem as a file


KIND = "place-rsus/placement-problem/1"
"""What such a file says it holds; raise the number whenever the fields change."""

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


def save_problem(path: Path, problem: PlacementProblem) -> None:
    """Write a problem, whole or not at all; the same problem always makes the same file.

    Raises InputError if a name ends with a null character, which numpy's text cannot hold, and
    OSError if the file cannot be written.
    """
    arrays = _to_arrays(problem)
    write_atomically(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))


def load_problem(path: Path) -> PlacementProblem:
    """Read a problem, checked field by field.

    Parameters
    ----------
    path : Path
        Written by :func:`save_problem`, or by others in the same form.

    Returns
    -------
    problem : PlacementProblem
        With the hash of the one that was written.

    Raises
    ------
    InputError
        The file is missing, damaged or of another kind; a field is missing, unknown, or has
        another type or shape; or the values contradict each other.
    """
    with _archive(path) as archive:
        kind = _read_kind(archive, str(path))
        if kind != KIND:
            raise InputError(f"{path}: kind", kind, KIND)
        unknown = sorted(set(archive.files) - set(_FIELDS))
        if unknown:
            raise InputError(f"{path}: {unknown[0]}", Unquoted("a field"), "none of this name")
        arrays = {name: _read(archive, name, str(path)) for name in archive.files}
    _check_fields(arrays, str(path))
    try:
        return _from_arrays(arrays)
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.got, error.expected) from None


def instance_kind(path: Path) -> str:
    """What an instance file says it holds, such as :data:`KIND`.

    Raises InputError: it is no ``.npz``, or does not say.
    """
    with _archive(path) as archive:
        return _read_kind(archive, str(path))


def problem_hash(problem: PlacementProblem) -> str:
    """SHA-256 of a problem, 64 hexadecimal digits.

    It is taken over the names, types, shapes and bytes (little-endian) of the fields in
    alphabetical order; texts are taken as JSON.
    """
    digest = hashlib.sha256()
    for name, array in sorted(_to_arrays(problem).items()):
        if array.dtype.kind == "U":
            type_name, content = "str", json.dumps(array.tolist()).encode()
        else:
            # Adding zero turns -0.0, which equals 0.0, into it.
            values = array + 0.0 if array.dtype.kind == "f" else array
            type_name = values.dtype.name
            content = values.astype(values.dtype.newbyteorder("<")).tobytes()
        digest.update(f"{name}\0{type_name}\0{array.shape}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def _is_never_lost(rule: AebRule) -> bool:
    """Whether a confirmed track lives for ever."""
    return rule.track_memory_s == math.inf


def _to_arrays(problem: PlacementProblem) -> Arrays:
    table, axis, limits, rule = problem.table, problem.table.axis, problem.limits, problem.rule
    floors = problem.floors
    counted = [
        np.ones(axis.n_runs, dtype=bool) if floor.is_counted is None else floor.is_counted
        for floor in floors
    ]
    values = {
        "kind": KIND,
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
    if _is_never_lost(rule):
        values["track_memory_s"] = None
    if set(axis.positions) == {AT_ZERO.name}:
        del values["positions"]  # the same file, and hash, as before there were others
    arrays = {
        name: np.array(value, dtype=_FIELDS[name].dtype)
        for name, value in values.items()
        if value is not None
    }
    for name, array in arrays.items():
        if array.dtype.kind == "U" and array.ndim and array.tolist() != list(values[name]):
            raise InputError(name, list(values[name]), "names without a null character at the end")
    return arrays


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
    packed: NDArray[np.uint8] = table.packed.copy()
    n_last = table.axis.n_frames % 8
    if n_last:
        packed[:, -1] &= np.uint8((1 << n_last) - 1)
    return packed


@contextmanager
def _archive(path: Path) -> Iterator[np.lib.npyio.NpzFile]:
    """An archive that says what kind it is; whatever is wrong with it is an InputError."""
    check_file(path)
    try:
        # Not np.load(): it takes whatever is no archive for a pickle, and says so.
        with path.open("rb") as file, np.lib.npyio.NpzFile(file, allow_pickle=False) as archive:
            if "kind" not in archive.files:
                raise InputError(f"{path}: kind", Unquoted("nothing"), f"a text such as {KIND}")
            assert archive.zip is not None  # it is open
            unpacked_bytes(archive.zip, str(path), max_bytes=MAX_UNPACKED_BYTES)
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
        array: NDArray[Any] = archive[name]
    except Exception as error:
        raise _damaged(f"{where}: {name}", error) from None
    return array


def _read_kind(archive: np.lib.npyio.NpzFile, where: str) -> str:
    kind = _read(archive, "kind", where)
    if kind.dtype.kind != "U" or kind.shape != ():
        raise InputError(f"{where}: kind", Unquoted("no text"), f"a text such as {KIND}")
    return str(kind)


def _damaged(where: str, error: Exception) -> InputError:
    reason = " ".join(str(error).split()) or type(error).__name__
    return InputError(where, Unquoted(reason), "an undamaged instance file (.npz)")


def _check_fields(arrays: Arrays, where: str) -> None:
    """Whether all fields are there, of their types, and agree about what their axes count."""
    sizes: dict[str, int] = {"2": 2}
    for name, field in _FIELDS.items():
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
