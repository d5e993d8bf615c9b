"""Where the poses of a problem hang and what is mounted there: what their names stand for.

A problem knows its poses by name and by what they detect. For whoever checks a result, the file of
a problem also has each pose's site, position, direction and sensor model with all of its fields,
and the hash of the scene. Then a layout that shows another camera, or one that hangs elsewhere, is
found out.
"""

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray, float_array, freeze
from geometry.catalogue import SENSOR_KINDS, Sensor, read_sensor, sensor_kind
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene
from geometry.sensors import CameraModel

from ..candidates import CandidatePose

FIELDS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "mount_site": ("str", ("poses",)),
    "mount_position_m": ("float64", ("poses", "3")),
    "mount_yaw_deg": ("float64", ("poses",)),
    "mount_pitch_deg": ("float64", ("poses",)),
    "mount_latency_s": ("float64", ("poses",)),  # NaN: that of the rule
    "mount_sensor": ("int64", ("poses",)),  # row of sensors
    "sensors": ("str", ("sensors",)),  # JSON of a model's fields, with name and kind
    "scene_name": ("str", ()),
    "scene_sha256": ("str", ()),
}
"""Arrays of the file: types, and what their axes count. All of them are there, or none."""

TOLERANCE = 1.0e-9
"""Metres and degrees that differ by no more are equal."""

_OF_GRID = re.compile(
    r"(?P<site>.+)/(?P<height>[^/]+)m/(?P<yaw>[^/]+)/(?P<pitch>[^/]+)/(?P<sensor>.+)"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounts:
    """Site, pose and sensor of each row of a problem's table, and the scene that it was made in.

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
        n_poses = len(self.sites)
        for name, shape in (
            ("position_m", (n_poses, 3)),
            ("yaw_deg", (n_poses,)),
            ("pitch_deg", (n_poses,)),
        ):
            values = float_array(getattr(self, name), shape, f"mount_{name}")
            object.__setattr__(self, name, values)
        for name, kind in (("latency_s", np.float64), ("sensor_index", np.int64)):
            array = np.array(getattr(self, name), dtype=kind)
            if array.shape != (n_poses,):
                raise InputError(f"mount_{name}", Unquoted(f"shape {array.shape}"), f"({n_poses},)")
            object.__setattr__(self, name, freeze(array))
        outside = (self.sensor_index < 0) | (self.sensor_index >= len(self.sensors))
        if outside.any():
            where = "mount_sensor"
            raise InputError(where, int(self.sensor_index[outside][0]), "a row of sensors")

    @property
    def n_poses(self) -> int:
        """Number of poses."""
        return len(self.sites)

    def __repr__(self) -> str:
        return f"Mounts({self.n_poses} poses in {self.scene_name!r})"

    def differences(self, row: int, unit: CandidatePose) -> list[str]:
        """What of a unit is not as the pose of a row has it, in words; its name does not count."""
        found = []
        if unit.site_id != self.sites[row]:
            found.append(f"site {unit.site_id or 'none'}, not {self.sites[row] or 'none'}")
        x, y, z = unit.pose.position_m.tolist()
        expected_m = self.position_m[row].tolist()
        shown: dict[str, tuple[float, float]] = {
            name: (got, wanted)
            for name, got, wanted in zip(("x_m", "y_m", "z_m"), (x, y, z), expected_m, strict=True)
        }
        shown["yaw_deg"] = unit.pose.yaw_deg, float(self.yaw_deg[row])
        shown["pitch_deg"] = unit.pose.pitch_deg, float(self.pitch_deg[row])
        own = math.nan if unit.latency_s is None else unit.latency_s
        shown["latency_s"] = own, float(self.latency_s[row])
        for name, (got, wanted) in shown.items():
            same = math.isnan(got) and math.isnan(wanted)
            if not (same or abs(got - wanted) <= TOLERANCE):
                found.append(f"{name} {got:.9g}, not {wanted:.9g}")
        sensor = self.sensors[int(self.sensor_index[row])]
        if unit.sensor != sensor:
            found += _sensor_differences(unit.sensor, sensor)
        return found

    def misnamed(
        self, pose_ids: Sequence[str], feet_m: Mapping[str, FloatArray] | None = None
    ) -> str:
        """The first pose of the grid whose name does not say where it hangs, in words; or nothing.

        Names of the grid tell site, height, yaw, pitch and sensor. All poses of a site hang one
        above the other, as far apart as their names say; above the site, if `feet_m` tells where
        sites are.
        """
        sites, foot_m = set(self.sites), dict(feet_m or {})
        for row, name in enumerate(pose_ids):
            parts = _OF_GRID.fullmatch(name)
            if parts is None or parts["site"] not in sites:
                continue  # a unit with a name of its own
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
                return f"{name} does not hang where the others of {self.sites[row]} do"
        return ""


def _name_with_lens(sensor: Sensor) -> str:
    """How names of poses end: some tell where a lens is set."""
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
    """What the names of candidate poses stand for; they are the rows of a table."""
    sensors = {candidate.sensor: 0 for candidate in candidates}
    sensors = {sensor: row for row, sensor in enumerate(sensors)}
    return Mounts(
        sites=tuple(candidate.site_id for candidate in candidates),
        position_m=np.array([candidate.pose.position_m for candidate in candidates]),
        yaw_deg=np.array([candidate.pose.yaw_deg for candidate in candidates]),
        pitch_deg=np.array([candidate.pose.pitch_deg for candidate in candidates]),
        latency_s=np.array(
            [math.nan if one.latency_s is None else one.latency_s for one in candidates]
        ),
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
        values = array + 0.0 if array.dtype.kind == "f" else array  # no -0.0, which equals 0.0
        digest.update(f"{name}\0{values.dtype.name}\0{values.shape}\0".encode())
        digest.update(values.astype(values.dtype.newbyteorder("<")).tobytes())

    for name in ("vertices_m", "triangles", "triangle_instance", "outline_m", "crosswalks_m"):
        add(name, getattr(scene, name))
    add("source_origin_m", scene.source_origin_m)
    for lane in scene.lanes:
        add("lane", lane.centreline_m)
    for site in scene.sites:
        add("site", np.concatenate([site.position_m, site.height_range_m]))
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
    limits = {lane.id: lane.speed_limit_kmh for lane in scene.lanes if lane.speed_limit_kmh}
    if limits:
        words["speed_limits"] = limits
    if scene.zero_height_m is not None:  # else as before scenes told it
        words["zero_height_m"] = scene.zero_height_m
    digest.update(json.dumps(words).encode())
    return digest.hexdigest()


# ---------- as arrays of a file


def to_arrays(mounts: Mounts) -> dict[str, NDArray[Any]]:
    """The arrays of :data:`FIELDS`."""
    values: dict[str, Any] = {
        "mount_site": mounts.sites,
        "mount_position_m": mounts.position_m,
        "mount_yaw_deg": mounts.yaw_deg,
        "mount_pitch_deg": mounts.pitch_deg,
        "mount_latency_s": mounts.latency_s,
        "mount_sensor": mounts.sensor_index,
        "sensors": [
            json.dumps({"kind": sensor_kind(sensor), **asdict(sensor)}) for sensor in mounts.sensors
        ],
        "scene_name": mounts.scene_name,
        "scene_sha256": mounts.scene_sha256,
    }
    return {name: np.array(value, dtype=FIELDS[name][0]) for name, value in values.items()}


def from_arrays(arrays: Mapping[str, NDArray[Any]]) -> Mounts:
    """Mounts from the arrays of :data:`FIELDS`, whose types and axes have been checked.

    Raises InputError: a sensor is none, or a row of it is not there.
    """
    return Mounts(
        sites=tuple(arrays["mount_site"].tolist()),
        position_m=arrays["mount_position_m"],
        yaw_deg=arrays["mount_yaw_deg"],
        pitch_deg=arrays["mount_pitch_deg"],
        latency_s=arrays["mount_latency_s"],
        sensor_index=arrays["mount_sensor"],
        sensors=tuple(_read_sensor(text) for text in arrays["sensors"].tolist()),
        scene_name=str(arrays["scene_name"]),
        scene_sha256=str(arrays["scene_sha256"]),
    )


def _read_sensor(text: str) -> Sensor:
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("sensors", text, "JSON of a sensor model") from None
    if not isinstance(fields, dict) or fields.get("kind") not in SENSOR_KINDS:
        raise InputError("sensors", text, "a sensor model with its kind")
    kind, name = fields.pop("kind"), fields.pop("name", None)
    if not isinstance(name, str):
        raise InputError("sensors", text, "a sensor model with its name")
    return read_sensor(name, fields, kind, "sensors")
