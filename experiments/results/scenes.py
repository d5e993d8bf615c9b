"""Summaries of scenes and maps: what they contain, and what a check finds."""

import numpy as np
from msgspec import UNSET, UnsetType

from geometry.junction import build_junction
from geometry.maps.georeferences import transform
from geometry.maps.junctions import Surveyed
from geometry.notes import Note
from geometry.scene import Scene
from geometry.scene_checks import Finding
from geometry.whereabouts import street_names

from .record import Record

_DIGITS = 3  # a millimetre


class ArmRecord(Record, frozen=True, kw_only=True):
    """An arm of a junction."""

    name: str
    lanes_in: int
    lanes_out: int
    parking_lanes: int


class JunctionRecord(Record, frozen=True, kw_only=True):
    """A junction; x_m and y_m are in the map's system: in degrees where that has degrees.

    Signals are poles with traffic lights; they and crossings lie within 15 m of the outline.
    """

    id: str
    name: str
    x_m: float
    y_m: float
    arms: int
    lanes: int
    signals: int | UnsetType = UNSET
    crossings: int | UnsetType = UNSET
    arm_list: tuple[ArmRecord, ...] | UnsetType = UNSET
    arm_names: tuple[str, ...] | UnsetType = UNSET


class SiteRecord(Record, frozen=True, kw_only=True):
    """A site of a scene."""

    id: str
    kind: str
    x_m: float
    y_m: float
    height_range_m: tuple[float, ...]
    capacity_units: int
    use: str


class SceneResult(Record, frozen=True, kw_only=True):
    """What a scene, or a map, has. Fields of a scene alone, or of an import alone, may be UNSET."""

    name: str
    junctions: tuple[JunctionRecord, ...]
    buildings: int
    things: int
    sites: int
    site_list: tuple[SiteRecord, ...] | UnsetType = UNSET
    crosswalks: int
    keeps_left: bool
    skipped: tuple[Note, ...]
    crs: str | None
    world_crs: str | UnsetType | None = UNSET
    other_junctions: int | UnsetType = UNSET
    assumed_heights: int | UnsetType = UNSET
    written: str | UnsetType = UNSET
    seconds: dict[str, float] | UnsetType = UNSET


class SceneCheckResult(Record, frozen=True, kw_only=True):
    """What is wrong with a scene; sound: no error."""

    name: str
    is_sound: bool
    findings: tuple[Finding, ...]


def build_scene_result(scene: Scene) -> SceneResult:
    """A scene of one junction."""
    junction = build_junction(scene)
    # Digits as scene.toml has them: an import tells what a look at its result does.
    outline = np.round(scene.outline_m, _DIGITS)
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    position = middle + scene.source_origin_m
    if scene.crs:
        position = transform(middle, scene.crs, scene.source_crs or scene.crs)
    arms = tuple(
        ArmRecord(
            name=arm.name,
            lanes_in=len(arm.entry_lanes),
            lanes_out=len(arm.exit_lanes),
            parking_lanes=sum(lane.kind == "parking" for lane in (*arm.lanes_in, *arm.lanes_out)),
        )
        for arm in junction.arms.values()
    )
    return SceneResult(
        name=scene.name,
        junctions=(
            JunctionRecord(
                id=scene.name.rpartition("/")[2],
                name=" / ".join(dict.fromkeys(street_names(scene).values())) or scene.name,
                x_m=float(position[0]),
                y_m=float(position[1]),
                arms=len(arms),
                lanes=sum(arm.lanes_in + arm.lanes_out for arm in arms),
                arm_list=arms,
            ),
        ),
        buildings=sum(thing.class_name == "building" for thing in scene.instances),
        things=sum(thing.class_name != "ground" for thing in scene.instances),
        sites=len(scene.sites),
        site_list=tuple(
            SiteRecord(
                id=site.id,
                kind=site.kind,
                x_m=round(float(site.position_m[0]), _DIGITS),
                y_m=round(float(site.position_m[1]), _DIGITS),
                height_range_m=tuple(np.round(site.height_range_m, _DIGITS).tolist()),
                capacity_units=site.capacity_units,
                use=site.use,
            )
            for site in scene.sites
        ),
        crosswalks=len(scene.crosswalks_m),
        keeps_left=scene.keeps_left,
        skipped=scene.notes,
        crs=scene.source_crs or scene.crs or None,
        world_crs=scene.crs or None,
    )


def build_junction_record(surveyed: Surveyed) -> JunctionRecord:
    """A junction of a map."""
    return JunctionRecord(
        id=surveyed.junction.id,
        name=surveyed.junction.name,
        x_m=float(surveyed.position[0]),
        y_m=float(surveyed.position[1]),
        arms=len(surveyed.arms),
        lanes=surveyed.n_lanes,
        signals=surveyed.n_signals,
        crossings=surveyed.n_crossings,
        arm_names=tuple(surveyed.arms),
    )
