"""Layouts (what is mounted) and certificates (how good they are proven to be)."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import numpy as np
from msgspec import Meta, Struct

from geometry.arrays import Point3
from geometry.calibration_formats import (
    refuse_unread_calibration,
    refuse_unread_suffix,
)
from geometry.catalogue import (
    SENSOR_KINDS,
    Sensor,
    load_cameras,
    pick_camera,
    pick_sensor,
    read_sensor,
    sensor_kind,
)
from geometry.errors import InputError, check_name, refuse
from geometry.frames import from_carla_pose
from geometry.opening import read_text
from geometry.phrases import Phrase
from geometry.poses import Pose
from geometry.registry import load_entry
from geometry.scene import Scene, containing_instance
from geometry.sensors import CameraModel, with_fov
from geometry.study_scene import load_study_scene
from geometry.tables import Text, read_table
from geometry.text_formats import load_data, parse_json

from .candidates import CandidatePose, above_ground, own_models
from .compute import check_distinct
from .question import BASELINE_NAME

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = "place-rsus/layout/1"
RESULT_SCHEMAS = tuple(
    f"place-rsus/{kind}/2" for kind in ("placement", "evaluation", "comparison")
)
"""Of summary.json, which has the layout in the same words."""
# Written files have whole millimetres.
_SAME_PLACE_M = 0.01

READERS = {
    ".csv": "placement.foreign_layouts:read_list",
    ".xml": "placement.foreign_layouts:read_calibrations",
    ".yaml": "placement.foreign_layouts:read_calibrations",
    ".yml": "placement.foreign_layouts:read_calibrations",
}
"""Registry of the readers of layouts, by the suffix of the file; all else is JSON.

Each is a :class:`LayoutReader`.
"""
LISTED_UNITS = "placement.foreign_layouts:records_of_list"
"""What makes units of a layout file out of units as people write them."""

RESERVED_IDS = ("vut", "rsu_all", "vut_and_rsus", "vam", "all_sources")
"""Names of the sensing parties that are no unit: no unit may be called so."""

# From a scene's middle; beyond, a unit or a frame has been mixed up.
_MAX_DISTANCE_M = 1000.0
# Of a unit from the pole that carries it: a bracket's length.
_AT_SITE_M = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Units that are mounted together.

    Attributes
    ----------
    name : str
        Name of the layout.
    units : tuple of CandidatePose
        The units; ids are unique.
    scene_name : str
        Where it was made for; empty: unknown.
    """

    name: str
    units: tuple[CandidatePose, ...]
    scene_name: str = ""

    def __post_init__(self) -> None:
        if not self.units:
            refuse(f"layout {self.name}", "no unit", "at least one unit")
        ids = [unit.id for unit in self.units]
        where = f"layout {self.name}: id"
        check_distinct(where, ids, "every id once")
        words = (
            word
            for unit in self.units
            for word in (unit.id, unit.sensor.name, unit.site_id)
        )
        for text in (self.name, *words):
            check_name(text, "layout: name or id")
        for name in ids:
            if name in RESERVED_IDS:
                meant = ", ".join(RESERVED_IDS)
                expected = f"another name: {meant} mean other sensing parties"
                raise InputError(where, name, expected)

    def __repr__(self) -> str:
        return f"Layout({self.name!r}, {[unit.id for unit in self.units]})"

    def __str__(self) -> str:
        return (
            f"{self.name}:"
            f" {len(self.units)} units\n{self.to_frame().round(2).to_string()}"
        )

    def _repr_html_(self) -> str:
        return str(self.to_frame().round(2).to_html())

    def to_frame(self) -> "pd.DataFrame":
        """The units as a table with a row for each, under its id.

        Columns are those of :func:`layout_records`.
        """
        # Takes longer to load than all else here.
        import pandas as pd

        return pd.DataFrame(layout_records(self)).set_index("id")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One of the objectives, which are optimised in order.

    Each stage holds the values of those before it.

    Attributes
    ----------
    name : str
        "apr", "apr_one_failed", "smallest_margin_s" or "mean_margin_s".
    objective, bound : float
        Value of the layout, and what no layout can exceed.
    gap : float
        (bound - objective) / abs(objective) as HiGHS defines it; 0 = proven optimal.
    seconds : float
        Time spent. [s]
    """

    name: str
    objective: float
    bound: float
    gap: float
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Certificate:
    """How good a layout is proven to be, on the detection table.

    Attributes
    ----------
    stages : tuple of Stage
        In order; the first is the APR.
    solver : str
        Name and version.
    """

    # : in order.
    stages: tuple[Stage, ...]
    # : name and version.
    solver: Phrase

    @property
    def is_proven(self) -> bool:
        """True if every stage's gap is closed."""
        return all(stage.gap == 0.0 for stage in self.stages)

    def __str__(self) -> str:
        return f"{self.to_frame().to_string()}\nby {self.solver}"

    def _repr_html_(self) -> str:
        return str(self.to_frame().to_html())

    def to_frame(self) -> "pd.DataFrame":
        """The stages as a table with a row for each, under its name.

        Columns are objective, bound, gap and seconds.
        """
        import pandas as pd

        return pd.DataFrame([asdict(stage) for stage in self.stages]).set_index("name")


def relative_gap(objective: float, bound: float, *, tolerance: float = 1.0e-9) -> float:
    """Relative distance of objective and bound, as HiGHS defines it.

    It is 0 up to a `tolerance` of the absolute distance.

    >>> relative_gap(0.5, 0.6)
    0.2
    """
    distance = abs(bound - objective)
    if distance <= tolerance:
        return 0.0
    if objective != 0.0:
        return max(round(distance / abs(objective), 12), 1.0e-12)
    return math.inf


def layout_records(layout: Layout) -> list[dict[str, Any]]:
    """Units as plain records.

    Fields are id, site, x_m, y_m, z_m, yaw_deg, pitch_deg, camera or lidar. And
    latency_s of their own, and fov_deg of a lens that is not set as in the
    catalogue.
    """
    return [
        {
            "id": unit.id,
            "site": unit.site_id,
            "x_m": float(unit.pose.position_m[0]),
            "y_m": float(unit.pose.position_m[1]),
            "z_m": float(unit.pose.position_m[2]),
            "yaw_deg": unit.pose.yaw_deg,
            "pitch_deg": unit.pose.pitch_deg,
            sensor_kind(unit.sensor): unit.sensor.name,
            **_lens_record(unit.sensor),
            **({} if unit.latency_s is None else {"latency_s": unit.latency_s}),
        }
        for unit in layout.units
    ]


def _lens_record(sensor: Sensor) -> dict[str, float]:
    """Field of view of a lens that is not set as in the catalogue."""
    if not isinstance(sensor, CameraModel) or sensor.fov_range_deg is None:
        return {}
    model = load_cameras().get(sensor.name)
    if model is not None and model.horizontal_fov_deg == sensor.horizontal_fov_deg:
        return {}
    return {"fov_deg": sensor.horizontal_fov_deg}


class _UnitRecord(Struct, frozen=True, kw_only=True):
    """A unit of a layout file."""

    id: Text
    camera: Text | None = None
    lidar: Text | None = None
    x_m: float
    y_m: float
    z_m: float
    yaw_deg: float
    pitch_deg: Annotated[
        float, Meta(ge=-90.0, le=90.0, description="-90 .. 90 degrees")
    ]
    site: str = ""
    latency_s: (
        Annotated[float, Meta(ge=0.0, description="seconds, at least 0")] | None
    ) = None
    fov_deg: float | None = None


def layout_from_records(
    name: str,
    records: Sequence[Any],
    where: str,
    *,
    sensors: Mapping[str, Sensor] | None = None,
) -> Layout:
    """Layout from plain records as :func:`layout_records` writes them.

    The field "site" may be missing. `sensors` are models in addition to the
    catalogue's. Raises InputError where a field is missing or not of its kind, an
    id is repeated, or a sensor is unknown.
    """
    units = []
    for index, record in enumerate(records):
        here = f"{where}: layout[{index}]"
        if not isinstance(record, Mapping):
            raise InputError(here, record, "an object with the fields of a unit")
        # Fields that the toolkit does not know are ignored.
        known = {
            key: record[key] for key in _UnitRecord.__struct_fields__ if key in record
        }
        unit = read_table(known, _UnitRecord, here)
        # A unit has one sensor: a camera or a LiDAR.
        kinds = [kind for kind in SENSOR_KINDS if getattr(unit, kind) is not None]
        if len(kinds) > 1:
            refuse(here, " and ".join(kinds), "one of them")
        if not kinds:
            refuse(f"{here}.{SENSOR_KINDS[0]}", "nothing", "a value")
        kind = kinds[0]
        model = getattr(unit, kinds[0])
        # Models that the layout brings along go before the catalogue's.
        own = (sensors or {}).get(model)
        sensor = own or pick_sensor(model, f"{here}.{kind}", kind=kind)
        if sensor_kind(sensor) != kind:
            raise InputError(f"{here}.{kind}", model, f"a {kind}")
        if unit.fov_deg is not None:
            if not isinstance(sensor, CameraModel):
                expected = "nothing: only cameras have lenses"
                raise InputError(f"{here}.fov_deg", unit.fov_deg, expected)
            sensor = with_fov(sensor, unit.fov_deg, f"{here}.fov_deg")
        position_m = np.array([unit.x_m, unit.y_m, unit.z_m])
        units.append(
            CandidatePose(
                id=unit.id,
                site_id=unit.site,
                pose=Pose(
                    position_m=position_m,
                    yaw_deg=unit.yaw_deg,
                    pitch_deg=unit.pitch_deg,
                ),
                sensor=sensor,
                latency_s=unit.latency_s,
            )
        )
    return Layout(name=name, units=tuple(units))


class LayoutReader(Protocol):
    """What reads a layout from a file of another form."""

    def __call__(
        self, path: Path, *, scene: Scene | None, sensors: Mapping[str, Sensor]
    ) -> Layout:
        """Read a layout.

        `scene` is where places on earth are; `sensors` are models in addition to the
        catalogue's. Raises InputError if the file cannot be read, or needs a scene.
        """


def load_layout(
    path: str | Path,
    *,
    scene: Scene | None = None,
    sensors: Mapping[str, Sensor] | None = None,
) -> Layout:
    """Load a layout from JSON or CSV.

    JSON is an object with the key "layout", a list of units. Or from calibrations
    of real cameras, YAML or XML; see :mod:`geometry.calibrations`. In a CSV, and in
    JSON written by hand, units may lie at latitudes and longitudes and look along
    compass bearings, see :func:`placement.foreign_layouts.unit_record`: that
    takes the `scene`. `sensors` are models in addition to the catalogue's.
    Raises InputError if the file cannot be read, is of another version, or a field is
    wrong.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in READERS:
        read: LayoutReader = load_entry(READERS[suffix])
        layout = read(path, scene=scene, sensors=sensors or {})
        return at_sites(layout, scene)
    refuse_unread_suffix(path)
    text = read_text(path, "JSON")
    return read_layout(
        text, where=str(path), name=path.stem, scene=scene, sensors=sensors
    )


def read_layout(
    text: str | bytes,
    *,
    where: str,
    name: str,
    scene: Scene | None = None,
    sensors: Mapping[str, Sensor] | None = None,
) -> Layout:
    """Layout from the text of a layout file, see :func:`load_layout`.

    It is called `name` if the text gives it no name.
    """
    try:
        document = parse_json(text, where, "a layout")
    except InputError:
        _refuse_calibration(text, where)
        raise
    known = (SCHEMA, *RESULT_SCHEMAS)
    if isinstance(document, dict) and document.get("schema", SCHEMA) not in known:
        expected = f"{', '.join(known)}, or none of it"
        raise InputError(f"{where}: schema", document["schema"], expected)
    if not isinstance(document, dict) or not isinstance(document.get("layout"), list):
        _refuse_calibration(text, where)
        refuse(where, "no list 'layout'", 'an object {"layout": [units]}')
    # Models in the file come with their own fields.
    own = _read_own_sensors(document.get("sensors", {}), f"{where}: sensors")
    models = {**(sensors or {}), **own}
    called = str(document.get("name", name))
    records = document["layout"]
    if scene is not None:
        convert = load_entry(LISTED_UNITS)
        records = convert(records, where, scene=scene, sensors=models)
    layout = layout_from_records(called, records, where, sensors=models)
    layout = replace(layout, scene_name=str(document.get("scene", "")))
    return at_sites(layout, scene)


def _refuse_calibration(text: str | bytes, where: str) -> None:
    """Raise InputError if what is no layout is a calibration that is not read."""
    if isinstance(text, bytes):
        text = text.decode("utf-8", errors="replace")
    refuse_unread_calibration(text, where)


def at_sites(layout: Layout, scene: Scene | None) -> Layout:
    """The layout, with units that name no site at the site where they are, if any.

    Such as existing cameras on poles of a list: the pole's capacity, failures, price
    and name are theirs, too. A unit is at the nearest site within 0.5 m, seen from
    above; without a scene nothing changes.
    """
    if scene is None or not scene.sites:
        return layout
    names = []
    places = []
    for site in scene.sites:
        names.append(site.id)
        places.append(site.position_m[:2])
        if site.surveyed_m is not None:
            names.append(site.id)
            places.append(site.surveyed_m)
    place_m = np.array(places)
    units = []
    for unit in layout.units:
        if not unit.site_id:
            away_m = np.hypot(*(place_m - unit.pose.position_m[:2]).T)
            nearest = int(away_m.argmin())
            if away_m[nearest] <= _AT_SITE_M:
                unit = replace(unit, site_id=names[nearest])
        units.append(unit)
    if all(one is other for one, other in zip(units, layout.units, strict=True)):
        return layout
    return replace(layout, units=tuple(units))


def _read_own_sensors(records: Any, where: str) -> dict[str, Sensor]:
    """Models that a layout brings along."""
    if not isinstance(records, Mapping):
        raise InputError(where, records, "an object with a model under each name")
    models = {}
    for name, record in records.items():
        if not isinstance(record, Mapping) or record.get("kind") not in SENSOR_KINDS:
            raise InputError(
                f"{where}.{name}", record, 'fields, "kind" camera or lidar'
            )
        models[name] = read_sensor(name, record, record["kind"], where)
    return models


def check_layout(layout: Layout, scene: Scene) -> None:
    """Raise InputError unless a layout is of a scene, not of another one.

    Every unit is in the open air, at a site that exists.
    """
    if layout.scene_name not in ("", scene.name):
        got = f"one made for {layout.scene_name}"
        refuse(
            f"layout {layout.name}",
            got,
            Phrase("one of {scene}, the scene in use", scene=scene.name),
        )
    # Each unit is above the ground, near the scene, in the open, at a known site.
    sites = {site.id for site in scene.sites}
    middle_m = np.append(scene.outline_m.mean(axis=0), 0.0)
    for unit in layout.units:
        where = f"layout {layout.name}: {unit.id}"
        height_m = float(above_ground(unit, scene).pose.position_m[2])
        if height_m <= 0.0:
            raise InputError(f"{where}.z_m", height_m, "a height above the road, > 0 m")
        distance_m = math.dist(unit.pose.position_m, middle_m)
        if distance_m > _MAX_DISTANCE_M:
            expected = f"at most {_MAX_DISTANCE_M:g} m"
            refuse(
                where,
                f"a pose {distance_m:.3g} m from the middle of {scene.name}",
                expected,
            )
        around = containing_instance(scene, unit.pose.position_m)
        if around is not None:
            expected = "a pose in the open air"
            refuse(where, f"a pose inside {around.class_name} {around.id}", expected)
        if unit.site_id and unit.site_id not in sites:
            raise InputError(
                f"{where}.site",
                unit.site_id,
                f"a site of {scene.name}, or an empty text",
            )


def find_existing(
    units: Sequence[CandidatePose], kept: Sequence[CandidatePose]
) -> frozenset[str]:
    """Ids of units that are mounted already: same id and place as one of `kept`."""
    places = {unit.id: unit.pose.position_m for unit in kept}
    return frozenset(
        unit.id
        for unit in units
        if unit.id in places
        and np.allclose(unit.pose.position_m, places[unit.id], atol=_SAME_PLACE_M)
    )


# ---------- layouts by name: a user's files, and the study's
def find_layout(
    name: str | Path,
    option: str = "layout",
    *,
    scene: Scene | None = None,
    sensors: str = "",
) -> Layout:
    """A layout by its name, or from a file.

    The only name is carlancap-12, the study's layout. Raises InputError for
    anything else. A list of units with places on earth takes the `scene`; `sensors`
    are models, as a user lists them, in addition to the catalogue's.
    """
    if str(name) == BASELINE_NAME:
        return load_carlancap_layout()
    if not os.path.lexists(name):
        raise InputError(
            option, str(name), f"{BASELINE_NAME}, or a layout file that exists"
        )
    return load_layout(Path(name), scene=scene, sensors=own_models(sensors))


class _StudyUnit(Struct, frozen=True, kw_only=True):
    """A unit of ``data/carla_ncap_layout.toml``."""

    id: str
    site: str
    position_m: Point3
    yaw_deg: float
    pitch_deg: float


@cache
def load_carlancap_layout() -> Layout:
    """The study's 12 roadside cameras, from ``data/carla_ncap_layout.toml``."""
    where = "carla_ncap_layout.toml"
    table = load_data(__package__, where)
    camera = pick_camera(table["camera"], f"{where}: camera")
    units = tuple(
        CandidatePose(
            id=unit.id,
            site_id=unit.site,
            pose=from_carla_pose(
                position_m=unit.position_m,
                yaw_deg=unit.yaw_deg,
                pitch_deg=unit.pitch_deg,
            ),
            sensor=camera,
        )
        for unit in read_table(table["units"], list[_StudyUnit], where)
    )
    return Layout(name=table["name"], units=units, scene_name=load_study_scene().name)


def find_baseline(scene: Scene) -> Layout | None:
    """The study's layout to compare with, at its junction; else None."""
    study = load_carlancap_layout()
    if scene.name == study.scene_name:
        return study
    return None
