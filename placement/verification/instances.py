"""Placement problems in files, and their hash.

``instance.npz`` holds a whole problem so that any program can read it. It is
compressed and holds no Python objects: numpy's arrays under the names in
``data/instance.toml``. It may also say where and what the poses are, see
:class:`Mounts`.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.archives import unpacked_bytes
from geometry.arrays import FloatArray, is_text
from geometry.catalogue import SENSOR_KINDS, Sensor, read_sensor, sensor_kind
from geometry.errors import InputError, located, refuse
from geometry.opening import open_file, reading
from geometry.sensors import CameraModel
from geometry.text_formats import parse_json
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..memory import check_fits
from ..optimiser import Floor, Limits, PlacementProblem
from ..proof_files import (
    KIND,
    KINDS,
    MOUNT_ATTRIBUTES,
    MOUNT_FIELDS,
    PROBLEM_FIELDS,
    ArrayField,
    Arrays,
    Mounts,
    without_padding,
)

_T = TypeVar("_T")

# Metres and degrees that differ by no more are equal.
TOLERANCE = 1.0e-9

_OF_GRID = re.compile(
    r"(?P<site>.+)/(?P<height>[^/]+)m/(?P<yaw>[^/]+)/(?P<pitch>[^/]+)/(?P<sensor>.+)"
)


def _name_with_lens(sensor: Sensor) -> str:
    """How names of poses end: some say how a lens is set."""
    if isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None:
        return f"{sensor.name}/{sensor.horizontal_fov_deg:g}"
    return sensor.name


def _sensor_differences(got: Sensor, wanted: Sensor) -> list[str]:
    """Fields in which a model is another one, in words."""
    if type(got) is not type(wanted):
        return [f"a {sensor_kind(got)}, not a {sensor_kind(wanted)}"]
    expected = asdict(wanted)
    return [
        f"{wanted.name}.{name} {value}, not {expected[name]}"
        for name, value in asdict(got).items()
        if value != expected[name]
    ]


def mount_differences(mounts: Mounts, row: int, unit: CandidatePose) -> list[str]:
    """Differences of a unit from the pose of a row, in words.

    Its name does not count.
    """
    found = []
    if unit.site_id != mounts.sites[row]:
        found.append(
            f"site {unit.site_id or 'none'}, not {mounts.sites[row] or 'none'}"
        )
    # Numbers are compared up to a tolerance, models field by field.
    names = ("x_m", "y_m", "z_m", "yaw_deg", "pitch_deg", "latency_s")
    if unit.latency_s is None:
        own_s = math.nan
    else:
        own_s = unit.latency_s
    got = (
        *unit.pose.position_m.tolist(),
        unit.pose.yaw_deg,
        unit.pose.pitch_deg,
        own_s,
    )
    rest = (mounts.yaw_deg[row], mounts.pitch_deg[row], mounts.latency_s[row])
    wanted = (*mounts.position_m[row], *rest)
    is_same = np.isclose(got, wanted, rtol=0.0, atol=TOLERANCE, equal_nan=True)
    found += [
        f"{name} {mine:.9g}, not {other:.9g}"
        for name, mine, other, same in zip(names, got, wanted, is_same, strict=True)
        if not same
    ]
    sensor = mounts.sensors[int(mounts.sensor_index[row])]
    if unit.sensor == sensor:
        return found
    return found + _sensor_differences(unit.sensor, sensor)


def misnamed_pose(
    mounts: Mounts,
    pose_ids: Sequence[str],
    feet_m: Mapping[str, FloatArray] | None = None,
) -> str:
    """The first pose of the grid with a wrong name, in words; or nothing.

    Names of the grid have site, height, yaw, pitch and sensor. All poses of a site
    are one above the other, as far apart as their names say; above the site, if
    `feet_m` has the places of sites.
    """
    sites = set(mounts.sites)
    foot_m = dict(feet_m or {})
    # Each part of the name must say what the row has.
    for row, name in enumerate(pose_ids):
        parts = _OF_GRID.fullmatch(name)
        if parts is None or parts["site"] not in sites:
            # A unit with a name of its own.
            continue
        sensor = mounts.sensors[int(mounts.sensor_index[row])]
        for key, value in (
            ("site", mounts.sites[row]),
            ("yaw", f"{mounts.yaw_deg[row]:g}"),
            ("pitch", f"{mounts.pitch_deg[row]:g}"),
        ):
            if parts[key] != value:
                return f"{name} has {key} {value or 'none'}"
        if parts["sensor"] not in (sensor.name, _name_with_lens(sensor)):
            return f"{name} has sensor {_name_with_lens(sensor)}"
        try:
            foot = mounts.position_m[row] - [0.0, 0.0, float(parts["height"])]
        except ValueError:
            return f"{name} has a height that is no number"
        first = foot_m.setdefault(mounts.sites[row], foot)
        # Names have heights to six digits.
        if (np.abs(foot - first) > [TOLERANCE, TOLERANCE, 1.0e-4]).any():
            return f"{name} is not where the others of {mounts.sites[row]} are"
    return ""


# ---------- arrays of a file
def _read_sensor(text: str) -> Sensor:
    """Sensor model of a text in JSON."""
    try:
        given = parse_json(text, "sensors", "a sensor model")
        kind = given.pop("kind")
        name = given.pop("name")
    except (InputError, LookupError, AttributeError, TypeError):
        kind = name = None
    if kind not in SENSOR_KINDS or not isinstance(name, str):
        raise InputError(
            "sensors", text, "JSON of a sensor model with its kind and name"
        )
    return read_sensor(name, given, kind, "sensors")


# ---------- placement problems
_UNDAMAGED = "an undamaged instance file (.npz)"
# Of memory for each byte of a file, unpacked, while it is read and checked.
_UNPACKED_BYTES = 4


class StoredProblem(NamedTuple):
    """Content of an instance file.

    Attributes
    ----------
    problem : PlacementProblem
        The problem.
    mounts : Mounts, optional
        None: the file does not say what the poses are.
    """

    problem: PlacementProblem
    mounts: Mounts | None


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
        The file is missing, damaged or of another kind; a field is missing, unknown, or
        has another type or shape; or the values contradict each other.
    """
    with _archive(path) as archive:
        stored = _read(archive, "kind", str(path))
        if stored.dtype.kind != "U" or stored.shape != ():
            refuse(f"{path}: kind", "no text", f"a text such as {KIND}")
        kind = str(stored)
        if kind not in KINDS:
            raise InputError(f"{path}: kind", kind, " or ".join(KINDS))
        if kind == KIND:
            known = PROBLEM_FIELDS
        else:
            known = {**PROBLEM_FIELDS, **MOUNT_FIELDS}
        # Nothing but known fields may be there.
        unknown = sorted(set(archive.files) - set(known))
        if unknown:
            refuse(f"{path}: {unknown[0]}", "a field", "none of this name")
        arrays = {name: _read(archive, name, str(path)) for name in archive.files}
    _check_fields(arrays, known, str(path))
    mounts = None
    with located(f"{path}: "):
        if known is not PROBLEM_FIELDS:
            of_mounts = {
                attribute: arrays[name] for name, attribute in MOUNT_ATTRIBUTES.items()
            }
            sensors = tuple(_read_sensor(text) for text in arrays["sensors"].tolist())
            mounts = _build(Mounts, of_mounts, sensors=sensors)
        return StoredProblem(_from_arrays(arrays), mounts)


def _from_arrays(arrays: Arrays) -> PlacementProblem:
    """Problem of the arrays of a file."""
    axis = _build(FrameAxis, arrays)
    table = _build(DetectionTable, arrays, axis=axis)
    if len(set(table.pose_ids)) < table.n_poses:
        refuse("pose_ids", "an id twice", "every id once")
    if not np.array_equal(without_padding(table), table.packed):
        refuse("packed", "bits behind the last frame", "zeros there")
    floors = zip(
        *(
            arrays[f"floor_{name}"].tolist()
            for name in ("names", "shares", "counts_all")
        ),
        arrays["floor_is_counted"],
        arrays["floor_failures"].tolist(),
        strict=True,
    )
    return _build(
        PlacementProblem,
        arrays,
        table=table,
        limits=_build(Limits, arrays),
        rule=_build(AebRule, arrays),
        floors=tuple(
            Floor(
                name=name,
                share=share,
                is_counted=None if counts_all else counted,
                n_failures=n_failures,
            )
            for name, share, counts_all, counted, n_failures in floors
        ),
    )


def _build(kind: type[_T], arrays: Arrays, **more: Any) -> _T:
    """A dataclass from the arrays that are called as its fields.

    Texts and numbers become plain values.
    """
    given: dict[str, Any] = {}
    for name in (field.name for field in fields(kind)):  # type: ignore[arg-type]
        if name in arrays:
            array = arrays[name]
            is_plain = array.ndim == 0 or array.dtype.kind == "U"
            if is_plain:
                values = array.tolist()
            else:
                values = array
            if is_plain and array.ndim:
                given[name] = tuple(values)
            else:
                given[name] = values
    return kind(**(given | more))


@contextmanager
def _archive(path: Path) -> Iterator[np.lib.npyio.NpzFile]:
    """An open archive that says of what kind it is.

    Whatever is wrong with it raises InputError.
    """
    # What damaged ones raise has no end: zipfile's, ..
    with (
        reading(path, _UNDAMAGED, Exception),
        reading(path, "a readable instance file", OSError),
        open_file(path) as file,
        # Not np.load(): it takes whatever is no archive for a pickle, and says so.
        np.lib.npyio.NpzFile(file, allow_pickle=False) as archive,
    ):
        if "kind" not in archive.files:
            refuse(f"{path}: kind", "nothing", f"a text such as {KIND}")
        # It is open.
        assert archive.zip is not None
        names = archive.zip.namelist()
        if len(set(names)) < len(names):
            # Programs differ in which of the two they read.
            refuse(str(path), "an array twice", "every array once")
        n_bytes = unpacked_bytes(archive.zip, str(path))
        what = f"{n_bytes:,} bytes when unpacked"
        room = _UNPACKED_BYTES * n_bytes
        check_fits(str(path), what, room, "fewer poses or frames")
        yield archive


def _read(archive: np.lib.npyio.NpzFile, name: str, where: str) -> NDArray[Any]:
    """An array of an archive; InputError if it is none, or damaged."""
    with reading(f"{where}: {name}", _UNDAMAGED, Exception):
        array: NDArray[Any] | bytes = archive[name]
    # What does not begin as an array comes as bytes.
    if not isinstance(array, np.ndarray):
        refuse(f"{where}: {name}", "no array", "an array")
    if array.dtype.kind == "U" and not is_text(array):
        refuse(f"{where}: {name}", "characters that are none", "texts")
    return array


def _check_fields(arrays: Arrays, known: Mapping[str, ArrayField], where: str) -> None:
    """Raise InputError unless all fields are there and fit together.

    Types must be right, and shapes agree about what their axes count.
    """
    sizes: dict[str, int] = {"2": 2, "3": 3}
    # Axes with one name must have one length.
    for name, field in known.items():
        if name not in arrays:
            if field.is_optional:
                continue
            refuse(f"{where}: {name}", "nothing", "an array")
        array = arrays[name]
        is_text = field.dtype == "str"
        if array.dtype.kind != "U" if is_text else array.dtype != np.dtype(field.dtype):
            refuse(f"{where}: {name}", f"type {array.dtype}", field.dtype)
        if array.ndim != len(field.axes):
            expected = (
                f"{len(field.axes)} ({', '.join(field.axes) or 'a single value'})"
            )
            refuse(f"{where}: {name}", f"{array.ndim} axes", expected)
        for axis, size in zip(field.axes, array.shape, strict=True):
            if sizes.setdefault(axis, size) != size:
                refuse(
                    f"{where}: {name}", f"shape {array.shape}", f"{sizes[axis]} {axis}"
                )
