"""Placement problems in files, and their hash.

``instance.npz`` holds a whole problem so that any program can read it. It is
compressed and holds no Python objects: numpy's arrays under the names in
``data/instance.toml``. It may also say where and what the poses are, see
:class:`Mounts`.
"""

import hashlib
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from msgspec import Struct, to_builtins
from numpy.typing import NDArray

from geometry.archives import unpacked_bytes
from geometry.arrays import FloatArray, IntArray, freeze, is_text, set_arrays
from geometry.catalogue import SENSOR_KINDS, Sensor, read_sensor, sensor_kind
from geometry.errors import InputError, located, refuse
from geometry.opening import open_file, reading
from geometry.scene import Scene
from geometry.sensors import LENS_FIELDS, CameraModel
from geometry.tables import read_data
from geometry.text_formats import parse_json
from geometry.writing import write_atomically
from scenarios.aeb import AebRule
from scenarios.positions import AT_ZERO
from scenarios.runs import FrameAxis

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..memory import check_fits
from ..optimiser import Floor, Limits, PlacementProblem

Arrays = dict[str, NDArray[Any]]
_T = TypeVar("_T")

# Metres and degrees that differ by no more are equal.
TOLERANCE = 1.0e-9

_OF_GRID = re.compile(
    r"(?P<site>.+)/(?P<height>[^/]+)m/(?P<yaw>[^/]+)/(?P<pitch>[^/]+)/(?P<sensor>.+)"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounts:
    """Site, pose and sensor of each row of a problem's table.

    The scene that it was made in is named as well.

    Attributes
    ----------
    sites : tuple of str
        Site of each pose; empty: none.
    position_m : (n_poses, 3) float
        World frame. [m]
    yaw_deg, pitch_deg : (n_poses,) float
        Counter-clockwise from east, positive up. [deg]
    latency_s : (n_poses,) float
        Of its own; NaN: that of the rule. [s]
    sensor_index : (n_poses,) int
        Row of `sensors`.
    sensors : tuple of CameraModel or LidarModel
        Models, complete.
    scene_name, scene_sha256 : str
        Name and :func:`scene_hash` of the scene.
    """

    sites: tuple[str, ...]
    position_m: FloatArray
    yaw_deg: FloatArray
    pitch_deg: FloatArray
    latency_s: FloatArray
    sensor_index: IntArray
    sensors: tuple[Sensor, ...]
    scene_name: str
    scene_sha256: str

    def __post_init__(self) -> None:
        n = len(self.sites)
        set_arrays(self, "mount_", position_m=(n, 3), yaw_deg=(n,), pitch_deg=(n,))
        for name, kind in (("latency_s", np.float64), ("sensor_index", np.int64)):
            array = np.array(getattr(self, name), dtype=kind)
            if array.shape != (n,):
                refuse(f"mount_{name}", f"shape {array.shape}", f"({n},)")
            object.__setattr__(self, name, freeze(array))
        outside = (self.sensor_index < 0) | (self.sensor_index >= len(self.sensors))
        if outside.any():
            got = int(self.sensor_index[outside][0])
            raise InputError("mount_sensor", got, "a row of sensors")

    def differences(self, row: int, unit: CandidatePose) -> list[str]:
        """Differences of a unit from the pose of a row, in words.

        Its name does not count.
        """
        found = []
        if unit.site_id != self.sites[row]:
            found.append(
                f"site {unit.site_id or 'none'}, not {self.sites[row] or 'none'}"
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
        rest = (self.yaw_deg[row], self.pitch_deg[row], self.latency_s[row])
        wanted = (*self.position_m[row], *rest)
        is_same = np.isclose(got, wanted, rtol=0.0, atol=TOLERANCE, equal_nan=True)
        found += [
            f"{name} {mine:.9g}, not {other:.9g}"
            for name, mine, other, same in zip(names, got, wanted, is_same, strict=True)
            if not same
        ]
        sensor = self.sensors[int(self.sensor_index[row])]
        if unit.sensor == sensor:
            return found
        return found + _sensor_differences(unit.sensor, sensor)

    def misnamed(
        self, pose_ids: Sequence[str], feet_m: Mapping[str, FloatArray] | None = None
    ) -> str:
        """The first pose of the grid with a wrong name, in words; or nothing.

        Names of the grid have site, height, yaw, pitch and sensor. All poses of a site
        are one above the other, as far apart as their names say; above the site, if
        `feet_m` has the places of sites.
        """
        sites = set(self.sites)
        foot_m = dict(feet_m or {})
        # Each part of the name must say what the row has.
        for row, name in enumerate(pose_ids):
            parts = _OF_GRID.fullmatch(name)
            if parts is None or parts["site"] not in sites:
                # A unit with a name of its own.
                continue
            sensor = self.sensors[int(self.sensor_index[row])]
            for key, value in (
                ("site", self.sites[row]),
                ("yaw", f"{self.yaw_deg[row]:g}"),
                ("pitch", f"{self.pitch_deg[row]:g}"),
            ):
                if parts[key] != value:
                    return f"{name} has {key} {value or 'none'}"
            if parts["sensor"] not in (sensor.name, _name_with_lens(sensor)):
                return f"{name} has sensor {_name_with_lens(sensor)}"
            try:
                foot = self.position_m[row] - [0.0, 0.0, float(parts["height"])]
            except ValueError:
                return f"{name} has a height that is no number"
            first = foot_m.setdefault(self.sites[row], foot)
            # Names have heights to six digits.
            if (np.abs(foot - first) > [TOLERANCE, TOLERANCE, 1.0e-4]).any():
                return f"{name} is not where the others of {self.sites[row]} are"
        return ""


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


def build_mounts(scene: Scene, candidates: Sequence[CandidatePose]) -> Mounts:
    """Poses behind the names of candidates; they are the rows of a table."""
    sensors = {
        sensor: row
        for row, sensor in enumerate(dict.fromkeys(c.sensor for c in candidates))
    }
    latencies_s = [
        math.nan if one.latency_s is None else one.latency_s for one in candidates
    ]
    return Mounts(
        sites=tuple(candidate.site_id for candidate in candidates),
        position_m=np.array([candidate.pose.position_m for candidate in candidates]),
        yaw_deg=np.array([candidate.pose.yaw_deg for candidate in candidates]),
        pitch_deg=np.array([candidate.pose.pitch_deg for candidate in candidates]),
        latency_s=np.array(latencies_s),
        sensor_index=np.array([sensors[candidate.sensor] for candidate in candidates]),
        sensors=tuple(sensors),
        scene_name=scene.name,
        scene_sha256=scene_hash(scene),
    )


def scene_hash(scene: Scene) -> str:
    """SHA-256 of all that a scene holds, 64 hexadecimal digits.

    Names and words are taken as JSON, arrays by shape and bytes (little-endian).
    """
    digest = hashlib.sha256()

    def add(name: str, array: NDArray[Any]) -> None:
        """Add an array to the digest: name, type, shape and bytes."""
        # no -0.0, which equals 0.0
        if array.dtype.kind == "f":
            values = array + 0.0
        else:
            values = array
        digest.update(f"{name}\0{values.dtype.name}\0{values.shape}\0".encode())
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())

    for name in (
        "vertices_m",
        "triangles",
        "triangle_instance",
        "outline_m",
        "crosswalks_m",
    ):
        add(name, getattr(scene, name))
    add("source_origin_m", scene.source_origin_m)
    for lane in scene.lanes:
        add("lane", lane.centreline_m)
    for site in scene.sites:
        add("site", np.concatenate([site.position_m, site.height_range_m]))
    # Names and words follow as one JSON text.
    words: dict[str, Any] = {
        "name": scene.name,
        "crs": [scene.crs, scene.source_crs],
        "road_network": scene.road_network,
        "keeps_left": scene.keeps_left,
        "instances": [[thing.id, thing.class_name] for thing in scene.instances],
        "lanes": [[lane.id, lane.kind, float(lane.width_m)] for lane in scene.lanes],
        "sites": [
            [site.id, site.kind, site.capacity_units, float(site.cost_eur), site.use]
            for site in scene.sites
        ],
    }
    limits = {
        lane.id: lane.speed_limit_kmh for lane in scene.lanes if lane.speed_limit_kmh
    }
    if limits:
        words["speed_limits"] = limits
    # Else as before scenes had it.
    if scene.zero_height_m is not None:
        words["zero_height_m"] = scene.zero_height_m
    digest.update(json.dumps(words).encode())
    return digest.hexdigest()


# ---------- as arrays of a file
def _mounts_to_arrays(mounts: Mounts) -> Arrays:
    """The arrays of :data:`_MOUNT_FIELDS`."""
    values = {
        name: getattr(mounts, attribute) for name, attribute in _ATTRIBUTES.items()
    }
    values["sensors"] = [
        json.dumps(
            {"kind": sensor_kind(sensor), **_fields_of(sensor)}, default=to_builtins
        )
        for sensor in mounts.sensors
    ]
    return {
        name: np.array(value, _MOUNT_FIELDS[name].dtype)
        for name, value in values.items()
    }


def _fields_of(sensor: Sensor) -> dict[str, object]:
    """Fields of a model; those of lenses only where it has them."""
    unset = [name for name in LENS_FIELDS if getattr(sensor, name, None) is None]
    return {name: value for name, value in asdict(sensor).items() if name not in unset}


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
INSTANCE_FILE = "instance.npz"
KIND = "place-rsus/placement-problem/1"
"""Kind of a file with a problem alone; raise the number whenever the fields change."""
KIND_WITH_MOUNTS = "place-rsus/placement-problem/2"
"""Kind of a file that also says where and what the poses are, see :class:`Mounts`."""
KINDS = (KIND, KIND_WITH_MOUNTS)

_UNDAMAGED = "an undamaged instance file (.npz)"
# Of memory for each byte of a file, unpacked, while it is read and checked.
_UNPACKED_BYTES = 4


class _Field(Struct, frozen=True):
    """An array of the file: its type, its axes, and if it may be missing."""

    dtype: str
    axes: tuple[str, ...] = ()
    is_optional: bool = False


class _Fields(Struct, frozen=True):
    """All arrays by name, from ``data/instance.toml``.

    Some are those of a problem, some those of :class:`Mounts`.
    """

    problem: dict[str, _Field]
    mounts: dict[str, _Field]


_ALL_FIELDS = read_data("placement", "instance.toml", _Fields)
_FIELDS = _ALL_FIELDS.problem
_MOUNT_FIELDS = _ALL_FIELDS.mounts
_ATTRIBUTES = {name: name.removeprefix("mount_") for name in _MOUNT_FIELDS} | {
    "mount_site": "sites",
    "mount_sensor": "sensor_index",
}


def save_problem(
    path: Path, problem: PlacementProblem, mounts: Mounts | None = None
) -> None:
    """Write a problem, whole or not at all.

    The same problem always makes the same file. Raises InputError if a name ends
    with a null character, which numpy's text cannot hold, and OSError if the file
    cannot be written.
    """
    arrays = _to_arrays(problem, mounts)

    # As numpy's savez_compressed: 6 % larger, a third of its time.
    def write(
        file: BinaryIO,
    ) -> None:
        """Write the arrays as an archive."""
        with zipfile.ZipFile(
            file, "w", zipfile.ZIP_DEFLATED, compresslevel=1
        ) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, array, allow_pickle=False)

    write_atomically(path, write)


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
            known = _FIELDS
        else:
            known = {**_FIELDS, **_MOUNT_FIELDS}
        # Nothing but known fields may be there.
        unknown = sorted(set(archive.files) - set(known))
        if unknown:
            refuse(f"{path}: {unknown[0]}", "a field", "none of this name")
        arrays = {name: _read(archive, name, str(path)) for name in archive.files}
    _check_fields(arrays, known, str(path))
    mounts = None
    with located(f"{path}: "):
        if known is not _FIELDS:
            of_mounts = {
                attribute: arrays[name] for name, attribute in _ATTRIBUTES.items()
            }
            sensors = tuple(_read_sensor(text) for text in arrays["sensors"].tolist())
            mounts = _build(Mounts, of_mounts, sensors=sensors)
        return StoredProblem(_from_arrays(arrays), mounts)


def problem_hash(problem: PlacementProblem, mounts: Mounts | None = None) -> str:
    """SHA-256 of a problem, and of what its poses are, 64 hexadecimal digits.

    It is taken over the names, types, shapes and bytes (little-endian) of the fields in
    alphabetical order; texts are taken as JSON.
    """
    digest = hashlib.sha256()
    content: bytes | memoryview
    for name, array in sorted(_to_arrays(problem, mounts).items()):
        if array.dtype.kind == "U":
            type_name = "str"
            content = json.dumps(array.tolist()).encode()
        else:
            # Adding zero turns -0.0, which equals 0.0, into it.
            if array.dtype.kind == "f":
                values = array + 0.0
            else:
                values = array
            type_name = values.dtype.name
            little = values.astype(values.dtype.newbyteorder("<"), copy=False)
            content = np.ascontiguousarray(little).reshape(-1).view(np.uint8).data
        digest.update(f"{name}\0{type_name}\0{array.shape}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def is_never_lost(rule: AebRule) -> bool:
    """True if a confirmed track lives for ever."""
    return rule.track_memory_s == math.inf


def _to_arrays(problem: PlacementProblem, mounts: Mounts | None) -> Arrays:
    """Arrays of a problem, by the names of the file's fields."""
    table = problem.table
    axis = table.axis
    limits = problem.limits
    rule = problem.rule
    floors = problem.floors
    # Floors as arrays, one row each.
    counted = [
        (
            np.ones(axis.n_runs, dtype=bool)
            if floor.is_counted is None
            else floor.is_counted
        )
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
        "floor_is_counted": np.array(counted, dtype=bool).reshape(
            len(floors), axis.n_runs
        ),
    }
    # All other fields are attributes of the problem and its parts.
    for owner in (axis, limits, problem, rule):
        values |= {
            name: getattr(owner, name) for name in _FIELDS if hasattr(owner, name)
        }
    if is_never_lost(rule):
        del values["track_memory_s"]
    if limits.failing == "unit":
        # The same file, and hash, as before sites could fail.
        del values["failing"]
    if set(axis.positions) == {AT_ZERO.name}:
        # The same file, and hash, as before there were others.
        del values["positions"]
    arrays = {
        name: np.asarray(value, dtype=_FIELDS[name].dtype)
        for name, value in values.items()
        if value is not None
    }
    # numpy cuts off null characters at the end of a text.
    for name, array in arrays.items():
        if (
            array.dtype.kind == "U"
            and array.ndim
            and array.tolist() != list(values[name])
        ):
            raise InputError(
                name, list(values[name]), "names without a null character at the end"
            )
    if mounts is None:
        return arrays
    return arrays | _mounts_to_arrays(mounts)


def _from_arrays(arrays: Arrays) -> PlacementProblem:
    """Problem of the arrays of a file."""
    axis = _build(FrameAxis, arrays)
    table = _build(DetectionTable, arrays, axis=axis)
    if len(set(table.pose_ids)) < table.n_poses:
        refuse("pose_ids", "an id twice", "every id once")
    if not np.array_equal(_without_padding(table), table.packed):
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


def _check_fields(arrays: Arrays, known: Mapping[str, _Field], where: str) -> None:
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
