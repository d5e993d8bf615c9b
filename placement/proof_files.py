"""The proof as files: a certificate, and beside it the whole problem.

``certificate.json`` says what was solved and found, ``instance.npz`` is the problem:
together they are enough to check the claim without the optimiser. They are read, and
checked, by :mod:`placement.verification`.
"""

import hashlib
import json
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from msgspec import Struct, to_builtins
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray, freeze, set_arrays
from geometry.catalogue import Sensor, sensor_kind
from geometry.errors import InputError, refuse
from geometry.scene import Scene
from geometry.sensors import LENS_FIELDS
from geometry.tables import read_data
from geometry.text_formats import load_data
from geometry.writing import write_atomically
from scenarios.aeb import AebRule
from scenarios.positions import AT_ZERO

from .candidates import CandidatePose
from .detection_table import DetectionTable, seeing_share
from .layout import Certificate
from .optimiser import PlacementProblem, PresolveStatistics

Arrays = dict[str, NDArray[Any]]


# ---------- what poses are
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
    for island_m in scene.islands_m:
        add("island", island_m)
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


# ---------- placement problems
INSTANCE_FILE = "instance.npz"
KIND = "place-rsus/placement-problem/1"
"""Kind of a file with a problem alone; raise the number whenever the fields change."""
KIND_WITH_MOUNTS = "place-rsus/placement-problem/2"
"""Kind of a file that also says where and what the poses are, see :class:`Mounts`."""
KINDS = (KIND, KIND_WITH_MOUNTS)


class ArrayField(Struct, frozen=True):
    """An array of the file: its type, its axes, and if it may be missing."""

    dtype: str
    axes: tuple[str, ...] = ()
    is_optional: bool = False


class _Fields(Struct, frozen=True):
    """All arrays by name, from ``data/instance.toml``.

    Some are those of a problem, some those of :class:`Mounts`.
    """

    problem: dict[str, ArrayField]
    mounts: dict[str, ArrayField]


_ALL_FIELDS = read_data("placement", "instance.toml", _Fields)
PROBLEM_FIELDS = _ALL_FIELDS.problem
MOUNT_FIELDS = _ALL_FIELDS.mounts
MOUNT_ATTRIBUTES = {name: name.removeprefix("mount_") for name in MOUNT_FIELDS} | {
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


def _mounts_to_arrays(mounts: Mounts) -> Arrays:
    """The arrays of :data:`MOUNT_FIELDS`."""
    values = {
        name: getattr(mounts, attribute) for name, attribute in MOUNT_ATTRIBUTES.items()
    }
    values["sensors"] = [
        json.dumps(
            {"kind": sensor_kind(sensor), **_fields_of(sensor)}, default=to_builtins
        )
        for sensor in mounts.sensors
    ]
    return {
        name: np.array(value, MOUNT_FIELDS[name].dtype)
        for name, value in values.items()
    }


def _fields_of(sensor: Sensor) -> dict[str, object]:
    """Fields of a model; those of lenses only where it has them."""
    unset = [name for name in LENS_FIELDS if getattr(sensor, name, None) is None]
    return {name: value for name, value in asdict(sensor).items() if name not in unset}


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
        "packed": without_padding(table),
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
            name: getattr(owner, name)
            for name in PROBLEM_FIELDS
            if hasattr(owner, name)
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
        name: np.asarray(value, dtype=PROBLEM_FIELDS[name].dtype)
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


def without_padding(table: DetectionTable) -> NDArray[np.uint8]:
    """The table's bits; those behind the last frame, which mean nothing, are 0."""
    n_last = table.axis.n_frames % 8
    padding = np.uint8(0xFF << n_last & 0xFF if n_last else 0)
    if not table.packed.shape[1] or not (table.packed[:, -1] & padding).any():
        return table.packed
    packed: NDArray[np.uint8] = table.packed.copy()
    packed[:, -1] &= ~padding
    return packed


# ---------- certificates
SCHEMA = "place-rsus/certificate/1"
CERTIFICATE_FILE = "certificate.json"


def build_certificate(
    problem: PlacementProblem,
    certificate: Certificate,
    *,
    pose_index: Sequence[int],
    units: Sequence[Mapping[str, Any]],
    presolve: PresolveStatistics,
    seconds: Mapping[str, float],
    versions: Mapping[str, str],
    mounts: Mounts | None = None,
) -> dict[str, Any]:
    """The document that ``certificate.json`` holds; an infinite gap is None in it.

    `units` are as the layout's file has them, and `pose_index` their rows of the table.
    `versions` says which programs the numbers depend on, `mounts` what the poses are.
    """
    return {
        "schema": SCHEMA,
        "instance": instance_of(problem, mounts),
        "model": {
            **model_of(problem),
            "stages": [stage.name for stage in certificate.stages],
            "in_words": words_of(problem, [stage.name for stage in certificate.stages]),
        },
        "layout": [
            {"row": int(row), "pose": problem.table.pose_ids[row], "unit": dict(unit)}
            for row, unit in zip(pose_index, units, strict=True)
        ],
        "stages": [
            {
                **asdict(stage),
                "gap": (
                    stage.gap if math.isfinite(stage.gap) else None
                ),  # JSON has no infinity
                "is_proven": bool(stage.gap == 0.0),
            }
            for stage in certificate.stages
        ],
        "is_proven": certificate.is_proven,
        "solver": certificate.solver,
        "presolve": {name: list(sizes) for name, sizes in asdict(presolve).items()},
        "seconds": dict(seconds),
        "versions": dict(versions),
    }


def save_certificate(
    folder: Path,
    document: Mapping[str, Any],
    problem: PlacementProblem,
    mounts: Mounts | None = None,
) -> None:
    """Write ``certificate.json`` and ``instance.npz`` into a folder.

    `document` is that of :func:`build_certificate`. Raises OSError if the folder
    cannot be written to.
    """
    save_problem(folder / INSTANCE_FILE, problem, mounts)
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(folder / CERTIFICATE_FILE, text)


def instance_of(problem: PlacementProblem, mounts: Mounts | None) -> dict[str, Any]:
    """Entry of a certificate about the instance file next to it."""
    return {
        "file": INSTANCE_FILE,
        "kind": KIND if mounts is None else KIND_WITH_MOUNTS,
        "sha256": problem_hash(problem, mounts),
        "n_poses": problem.table.n_poses,
        "n_sites": problem.limits.n_sites,
        "n_runs": problem.table.axis.n_runs,
        "n_frames": problem.table.axis.n_frames,
    }


def words_of(problem: PlacementProblem, stages: Sequence[str]) -> dict[str, str]:
    """The model in words.

    It has fusion, what avoided means, and the formula of each stage.
    """
    words = load_data("placement", "certificate.toml")
    formulas = words["formulas"]
    if problem.limits.failing == "site":
        formulas |= words["site_formulas"]
    avoided = words["avoided"]["always"]
    if not is_never_lost(problem.rule):
        avoided += words["avoided"]["and_alive"]
    told = {"fusion": words["fusion"][problem.fusion], "avoided": avoided}
    # Parts of the model that not every problem has.
    if problem.seen_by_vut is not None:
        told["cars"] = words["parts"]["cars"]
    return told | {name: formulas[name] for name in stages}


def cars_of(problem: PlacementProblem) -> float:
    """Share of the VUTs that see in a problem, 0..1."""
    if problem.seen_by_vut is None:
        return 0.0
    return seeing_share(problem.table.axis)


def model_of(problem: PlacementProblem) -> dict[str, Any]:
    """Demands and limits of a problem, as plain values for JSON."""
    axis = problem.table.axis
    limits = problem.limits
    samples = problem.sample_index
    return {
        "fusion": problem.fusion,
        "goal": problem.goal,
        "survive": problem.survive,
        **({} if limits.failing == "unit" else {"failing": limits.failing}),
        "tail": problem.tail,
        **({} if problem.seen_by_vut is None else {"cars": cars_of(problem)}),
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
                "n_runs": (
                    axis.n_runs
                    if floor.is_counted is None
                    else int(floor.is_counted.sum())
                ),
            }
            for floor in problem.floors
        ],
        "rule": {
            name: value
            for name, value in asdict(problem.rule).items()
            # Left out where it means nothing: JSON has no infinity.
            if name != "track_memory_s" or not is_never_lost(problem.rule)
        },
    }
