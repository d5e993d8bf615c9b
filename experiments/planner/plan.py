"""The plan as pure values: variants, every way to change them, undo and redo, and its file."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, count
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import shapely
from msgspec import UNSET, Struct, UnsetType

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.errors import InputError, Unquoted, refuse
from geometry.files import pick, read_table
from geometry.phrases import Phrase
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, Site, containing_instance, road_area
from geometry.sensors import CameraModel, with_fov
from geometry.terrain import ground_height_m
from placement.candidates import CandidatePose, is_ring, load_candidate_grid
from placement.layout import Layout, check_layout, read_layout
from placement.retrofit import free_name

from ..language import mark, tr

MAX_UNITS = 1000
MAX_VARIANTS = 12
_MAX_NAME = 80
MAX_STEPS = 500
"""Steps that can be undone."""
MAX_IMAGE_BYTES = 8_000_000

_DEFAULT_PITCH_DEG = -15.0
_LEVEL_DEG = 0.5  # an axis less steep meets the ground too far away to be aimed at it
_FAR_M = 45.0
_DECIMALS = 6  # of degrees and metres: finer than anybody mounts
_FARTHEST_POLE_M, _SAME_PLACE_M = 500.0, 0.01
_MAX_SIDE_PX = 30_000
_LEAST_APART_PX, _LEAST_APART_M = 2.0, 0.5
_MAX_COORDINATE_M = 1.0e6
_STARTS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg", b"GIF8": "image/gif"}


def check_count(n: int, where: str, most: int) -> None:
    """Raise InputError for more than there may be."""
    if n > most:
        refuse(where, Phrase("{n:,}", n=n), Phrase("at most {n:,}", n=most))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
    """A layout that is being planned, and may be empty; InputError: it has too many units."""

    name: str
    units: tuple[CandidatePose, ...] = ()

    def __post_init__(self) -> None:
        check_count(len(self.units), "units", MAX_UNITS)

    def layout(self, scene: Scene) -> Layout:
        """Layout of a scene; what it has no site for is mounted by itself. InputError: no unit."""
        known = {site.id for site in scene.sites}
        units = [one if one.site_id in known else replace(one, site_id="") for one in self.units]
        return Layout(name=self.name, units=tuple(units), scene_name=scene.name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanState:
    """All variants, which of them is worked on, and the workspace of the scene it is for."""

    variants: tuple[Variant, ...]
    current: int = 0
    workspace: Any = None
    poles: tuple[Site, ...] = ()  # of one's own, beside the scene's sites

    @property
    def variant(self) -> Variant:
        """The one that is worked on."""
        return self.variants[self.current]

    @property
    def is_empty(self) -> bool:
        """True if nothing is mounted in any variant."""
        return not any(variant.units for variant in self.variants)

    def with_units(self, units: Sequence[CandidatePose]) -> "PlanState":
        """The state with other units in the current variant; InputError: too many."""
        return self.with_variant(replace(self.variant, units=tuple(units)))

    def with_variant(self, variant: Variant) -> "PlanState":
        """The state with another variant in place of the one that is worked on."""
        before, after = self.variants[: self.current], self.variants[self.current + 1 :]
        return replace(self, variants=(*before, variant, *after))


# ---------- requests of browsers


class _Request(Struct, tag_field="do", forbid_unknown_fields=True):
    pass


class AddUnit(_Request, tag="add"):
    """Mount a sensor at a site; by default it looks at the middle of the junction.

    A height that the site does not have is brought into its range: what is pasted may be from
    another site.
    """

    site: str
    sensor: str
    yaw_deg: float | None = None
    pitch_deg: float | None = None
    height_m: float | None = None
    fov_deg: float | None = None


class ChangeUnit(_Request, tag="change"):
    """Turn, tilt, raise, zoom, move or exchange a unit; steps of one gesture are undone at once."""

    unit: str
    yaw_deg: float | UnsetType = UNSET
    pitch_deg: float | UnsetType = UNSET
    height_m: float | UnsetType = UNSET
    fov_deg: float | UnsetType = UNSET
    site: str | UnsetType = UNSET
    sensor: str | UnsetType = UNSET
    gesture: str = ""


class RemoveUnit(_Request, tag="remove"):
    """Take a unit down."""

    unit: str


class AddVariant(_Request, tag="add-variant"):
    """Copy the variant that is worked on, and go on with the copy."""

    name: str = ""


class SelectVariant(_Request, tag="select-variant"):
    """Go on with another variant."""

    index: int


class RenameVariant(_Request, tag="rename-variant"):
    """Name the variant that is worked on."""

    name: str


class RemoveVariant(_Request, tag="remove-variant"):
    """Drop the variant that is worked on."""


class Undo(_Request, tag="undo"):
    """Take the last change back."""


class Redo(_Request, tag="redo"):
    """Make the change again that was taken back."""


class PutPole(_Request, tag="pole"):
    """Put a pole of one's own somewhere, or the one that is named, with all that hangs on it."""

    east_m: float
    north_m: float
    site: str = ""


class RemovePole(_Request, tag="remove-pole"):
    """Take a pole of one's own away that carries nothing."""

    site: str


_OfUnits = AddUnit | ChangeUnit | RemoveUnit | PutPole | RemovePole
Change = _OfUnits | AddVariant | SelectVariant | RenameVariant | RemoveVariant


class Ask(_Request, tag="ask"):
    """Ask the optimiser: "next", "complete" to `units`, "re-aim", "cheapest", "why-not" `site`."""

    request: str
    units: int = 0
    site: str = ""


class Revert(_Request, tag="revert"):
    """Take a gesture back that is given up, as if it had not been begun."""

    gesture: str


class Cancel(_Request, tag="cancel"):
    """Let the optimiser stop."""


class CancelOpening(_Request, tag="cancel-opening"):
    """Let no other scene be opened that is being read or made."""


class TakeProposal(_Request, tag="take"):
    """Take a proposal over, in place of what is worked on or as a further variant."""

    number: int
    as_variant: bool = False


class DropProposal(_Request, tag="drop"):
    """Drop a proposal."""

    number: int


class ShowCoverage(_Request, tag="coverage"):
    """Show or hide pixel density and blind spots on the road."""

    is_shown: bool


class ChooseSensors(_Request, tag="sensors"):
    """Models that the optimiser may mount; none: the default grid's."""

    names: list[str]


class ChangeQuestion(_Request, tag="question"):
    """Drive other cases, or see and judge them otherwise; what is not given stays as it is."""

    cases: str | UnsetType = UNSET
    weather: str | UnsetType = UNSET
    detector: str | UnsetType = UNSET
    weights: str | UnsetType = UNSET
    cars: str | UnsetType = UNSET
    vam_rate: float | UnsetType = UNSET


_Other = (
    ChangeQuestion
    | Ask
    | Cancel
    | CancelOpening
    | TakeProposal
    | DropProposal
    | ShowCoverage
    | ChooseSensors
)
Message = Change | Undo | Redo | Revert | _Other
_DECODER = msgspec.json.Decoder(Message)


def read_message(text: bytes) -> Message:
    """A request from its JSON. Raises InputError if it is none of these."""
    try:
        message: Message = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            mark("message"), Unquoted(error), mark("one that the page sends")
        ) from None
    return message


# ---------- changes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stock:
    """The scene with its sites, and the sensor models that can be mounted, by name."""

    scene: Scene
    models: Mapping[str, Sensor]


def change_state(state: PlanState, change: Change, stock: Stock) -> PlanState:
    """The state after a change.

    Raises InputError: there is no such unit, site, sensor or variant; a site is full or forbidden;
    a number is not one that can be mounted.
    """
    units = state.variant.units
    match change:
        case AddUnit():
            return _add_unit(state, change, stock)
        case ChangeUnit():
            return _change_unit(state, change, stock)
        case RemoveUnit(unit=name):
            index = _find(units, name)
            return state.with_units([*units[:index], *units[index + 1 :]])
        case PutPole():
            return _put_pole(state, change, stock.scene)
        case RemovePole(site=name):
            return _remove_pole(state, name)
        case AddVariant(name=name):
            name = name or free_name({each.name for each in state.variants}, tr("Variant") + " ")
            return add_variant(state, Variant(name=name, units=units))
        case SelectVariant(index=index):
            if not 0 <= index < len(state.variants):
                raise InputError(mark("variant"), index, f"0 to {len(state.variants) - 1}")
            return replace(state, current=index)
        case RenameVariant(name=name):
            name = _printable(name)
            if any(each.name == name for each in state.variants if each is not state.variant):
                raise InputError(mark("name"), name, mark("a name that no other variant has"))
            return state.with_variant(replace(state.variant, name=name))
        case RemoveVariant():
            if len(state.variants) == 1:
                raise InputError(
                    mark("variant"), state.variant.name, mark("another one: the last one stays")
                )
            variants = tuple(each for each in state.variants if each is not state.variant)
            return replace(state, variants=variants, current=min(state.current, len(variants) - 1))


def _add_unit(state: PlanState, change: AddUnit, stock: Stock) -> PlanState:
    units, scene = state.variant.units, stock.scene
    site = _free_site(change.site, units, scene)
    sensor = pick(stock.models, change.sensor, mark("sensor"))
    if change.fov_deg is not None:
        sensor = _with_lens(sensor, change.fov_deg)
    wanted_m = load_candidate_grid().heights_m.max() if change.height_m is None else change.height_m
    height_m = float(np.clip(_finite(mark("height"), wanted_m), *site.height_range_m))
    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    east, north = middle - site.position_m[:2]
    towards_deg = math.degrees(math.atan2(north, east)) if east or north else 0.0
    pitch_deg = 0.0 if is_ring(sensor) else _DEFAULT_PITCH_DEG
    unit = CandidatePose(
        id=free_name({unit.id for unit in units}),
        site_id=site.id,
        pose=Pose(
            position_m=site.position_m + [0.0, 0.0, height_m],
            yaw_deg=_yaw(towards_deg if change.yaw_deg is None else change.yaw_deg),
            pitch_deg=_pitch(pitch_deg if change.pitch_deg is None else change.pitch_deg),
        ),
        sensor=sensor,
    )
    return state.with_units([*units, unit])


def first_units(stock: Stock, sensor: str) -> tuple[CandidatePose, ...]:
    """A unit alone at the first site that may carry one; none where there is no such site."""
    free = [site.id for site in stock.scene.sites if site.use != "forbidden"]
    if not free:
        return ()
    empty = begin_history(()).state
    return _add_unit(empty, AddUnit(site=free[0], sensor=sensor), stock).variant.units


def _change_unit(state: PlanState, change: ChangeUnit, stock: Stock) -> PlanState:
    units, scene = state.variant.units, stock.scene
    index = _find(units, change.unit)
    unit = units[index]
    pose, sensor, site_id = unit.pose, unit.sensor, unit.site_id
    if change.sensor is not UNSET:
        sensor = pick(stock.models, change.sensor, mark("sensor"))
        if is_ring(sensor) != is_ring(unit.sensor):  # what scans all round is level by default
            pose = replace(pose, pitch_deg=0.0 if is_ring(sensor) else _DEFAULT_PITCH_DEG)
    if change.fov_deg is not UNSET:
        sensor = _with_lens(sensor, change.fov_deg)
    if change.site is not UNSET and change.site != site_id:
        site = _free_site(change.site, [other for other in units if other is not unit], scene)
        ground_m = float(ground_height_m(scene, pose.position_m[:2]))
        above_m = float(np.clip(pose.position_m[2] - ground_m, *site.height_range_m))
        pose = _moved(pose, site.position_m + [0.0, 0.0, above_m], sensor, scene)
        site_id = site.id
    if change.height_m is not UNSET:
        pose = _raised(pose, site_id, _finite(mark("height"), change.height_m), scene)
    if change.yaw_deg is not UNSET:
        pose = replace(pose, yaw_deg=_yaw(change.yaw_deg))
    if change.pitch_deg is not UNSET:
        pose = replace(pose, pitch_deg=_pitch(change.pitch_deg))
    changed = replace(unit, site_id=site_id, pose=pose, sensor=sensor)
    return state.with_units([*units[:index], changed, *units[index + 1 :]])


def _with_lens(sensor: Sensor, fov_deg: float) -> CameraModel:
    if not isinstance(sensor, CameraModel):
        raise InputError(mark("lens"), fov_deg, mark("nothing: only cameras have lenses"))
    return with_fov(sensor, _finite(mark("lens"), fov_deg), mark("lens"))


def _moved(pose: Pose, position_m: FloatArray, sensor: Sensor, scene: Scene) -> Pose:
    """A pose at another place that looks at the same point of the ground.

    One whose axis does not meet the ground keeps its tilt and turns to where it looked.
    """
    eye_m = pose.position_m
    up_m = float(eye_m[2] - ground_height_m(scene, eye_m[:2]))
    yaw_deg, pitch_deg = pose.yaw_deg, pose.pitch_deg
    is_tilted = pitch_deg < -_LEVEL_DEG and not is_ring(sensor)
    reach_m = up_m / math.tan(math.radians(-pitch_deg)) if is_tilted else _FAR_M
    yaw = math.radians(yaw_deg)
    target_m = eye_m[:2] + reach_m * np.array([math.cos(yaw), math.sin(yaw)])
    east, north = target_m - position_m[:2]
    if is_tilted:
        above_m = float(position_m[2] - ground_height_m(scene, target_m))
        pitch_deg = -math.degrees(math.atan2(above_m, math.hypot(east, north)))
    if east or north:
        yaw_deg = math.degrees(math.atan2(north, east))
    return Pose(position_m=position_m, yaw_deg=_yaw(yaw_deg), pitch_deg=_pitch(pitch_deg))


def mount_range_m(pose: Pose, site_id: str, scene: Scene) -> tuple[float, float, float]:
    """Height of the foot of a pose's site, or of the ground below it, and heights above it."""
    site = next((site for site in scene.sites if site.id == site_id), None)
    if site is None:
        return float(ground_height_m(scene, pose.position_m[:2])), 0.5, 50.0
    return float(site.position_m[2]), *site.height_range_m.tolist()


def _raised(pose: Pose, site_id: str, height_m: float, scene: Scene) -> Pose:
    """A pose at another height above the foot of its site, or above the ground below it."""
    foot_m, low_m, high_m = mount_range_m(pose, site_id, scene)
    if not low_m - 1.0e-9 <= height_m <= high_m + 1.0e-9:
        expected = Phrase("{low:g} .. {high:g} m, above the ground", low=low_m, high=high_m)
        if site_id:
            expected = Phrase(
                "{low:g} .. {high:g} m, the range of {site}", low=low_m, high=high_m, site=site_id
            )
        raise InputError(mark("height"), height_m, expected)
    east, north = pose.position_m[:2]
    return replace(pose, position_m=np.array([east, north, foot_m + round(height_m, _DECIMALS)]))


def add_variant(state: PlanState, variant: Variant, *, source: str = "") -> PlanState:
    """The state with a further variant, which is worked on from here.

    Where its name is taken, `source`, such as the file's name, is added, and then a number.
    Raises InputError if there are too many, or the name cannot be printed.
    """
    check_count(len(state.variants) + 1, mark("variants"), MAX_VARIANTS)
    names = {each.name for each in state.variants}
    base = _printable(variant.name)
    if base in names and source:
        base = _printable(f"{source}: {base}"[:_MAX_NAME])
    numbered = (f"{base} ({number})" for number in count(2))
    name = next(name for name in chain([base], numbered) if name not in names)
    variants = (*state.variants, replace(variant, name=name))
    return replace(state, variants=variants, current=len(variants) - 1)


def _find(units: Sequence[CandidatePose], unit_id: str) -> int:
    ids = [unit.id for unit in units]
    if unit_id not in ids:
        raise InputError(mark("unit"), unit_id, mark("one that is mounted there"))
    return ids.index(unit_id)


def _free_site(site_id: str, units: Sequence[CandidatePose], scene: Scene) -> Site:
    """A site that may carry one more unit."""
    site = next((site for site in scene.sites if site.id == site_id), None)
    if site is None:
        raise InputError(mark("site"), site_id, Phrase("a site of {scene}", scene=scene.name))
    if site.use == "forbidden":
        raise InputError(
            mark("site"), site_id, mark("a site that may carry units: the scene forbids this one")
        )
    n_there = sum(unit.site_id == site_id for unit in units)
    if n_there >= site.capacity_units:
        got = Phrase("a unit more than the {n} there", n=n_there)
        refuse(
            Phrase("site {name}", name=site_id), got, Phrase("at most {n}", n=site.capacity_units)
        )
    return site


def _finite(where: str, value: float) -> float:
    if not math.isfinite(value):
        raise InputError(where, value, mark("a finite number"))
    return value


def _yaw(yaw_deg: float) -> float:
    return round(float(wrap_deg(_finite(mark("direction"), yaw_deg))), _DECIMALS)


def _pitch(pitch_deg: float) -> float:
    if not -90.0 <= pitch_deg <= 90.0:
        raise InputError(
            mark("tilt"), pitch_deg, Phrase("{low} .. {high} degrees", low=-90, high=90)
        )
    return round(float(pitch_deg), _DECIMALS)


def _printable(name: str) -> str:
    name = " ".join(name.split())
    if not name or len(name) > _MAX_NAME or not name.isprintable():
        raise InputError(mark("name"), name, Phrase("1 to {n} letters", n=_MAX_NAME))
    return name


# ---------- poles of one's own


class PolePlace(Struct, frozen=True):
    """A pole of one's own in a file; its height and what it carries are as the scene's."""

    id: str
    x_m: float
    y_m: float


@lru_cache(maxsize=8)
def with_poles(scene: Scene, poles: tuple[Site, ...]) -> Scene:
    """A scene with further sites."""
    return replace(scene, sites=(*scene.sites, *poles))


def build_pole(scene: Scene, name: str, place_m: tuple[float, float]) -> Site:
    """A pole as most of a scene's are, at another place.

    Raises InputError: it would stand in something or on the road, too far away, or no pole of the
    scene says what is usual.
    """
    standing = [site for site in scene.sites if site.kind != "mast arm"]
    if not standing:
        refuse(mark("pole"), mark("a scene without any"), mark("one whose poles it can be like"))
    kinds = [(one.kind, *one.height_range_m.tolist(), one.capacity_units) for one in standing]
    usual = standing[kinds.index(max(kinds, key=kinds.count))]
    east_m, north_m = (round(_finite(mark("pole"), value), 2) for value in place_m)
    point, foot_m = shapely.Point(east_m, north_m), np.array([east_m, north_m, 0.0])
    if not shapely.dwithin(point, shapely.Polygon(scene.outline_m), _FARTHEST_POLE_M):
        expected = Phrase("one at most {far:g} m from the junction", far=_FARTHEST_POLE_M)
        refuse(mark("pole"), mark("a place farther away"), expected)
    foot_m[2] = ground_height_m(scene, foot_m[:2])
    if around := containing_instance(scene, foot_m + [0.0, 0.0, 1.0]):
        refuse(
            mark("pole"),
            Phrase("a place inside {kind} {name}", kind=around.class_name, name=around.id),
            mark("one in the open air"),
        )
    if road_area(scene).contains(point):
        refuse(mark("pole"), mark("a place on the carriageway"), mark("one beside it"))
    return replace(usual, id=name, position_m=foot_m, use="free")


def _own_pole(state: PlanState, name: str) -> Site:
    return pick({pole.id: pole for pole in state.poles}, name, mark("pole"))


def _put_pole(state: PlanState, change: PutPole, scene: Scene) -> PlanState:
    place_m = change.east_m, change.north_m
    if not change.site:
        name = free_name({site.id for site in scene.sites}, "own-")
        return replace(state, poles=(*state.poles, build_pole(scene, name, place_m)))
    before = _own_pole(state, change.site)
    after = build_pole(scene, before.id, place_m)

    def moved(unit: CandidatePose) -> CandidatePose:
        if unit.site_id != before.id:
            return unit
        at_m = unit.pose.position_m + after.position_m - before.position_m
        return replace(unit, pose=replace(unit.pose, position_m=at_m))

    poles = tuple(after if pole is before else pole for pole in state.poles)
    return replace(_each_unit(state, moved), poles=poles)


def _each_unit(state: PlanState, change: Callable[[CandidatePose], CandidatePose]) -> PlanState:
    """The state with each unit of each variant changed."""
    variants = [replace(one, units=tuple(map(change, one.units))) for one in state.variants]
    return replace(state, variants=tuple(variants))


def _remove_pole(state: PlanState, name: str) -> PlanState:
    pole = _own_pole(state, name)
    for variant in state.variants:
        if unit := next((one for one in variant.units if one.site_id == name), None):
            got = Phrase(
                "{pole}, which carries {unit} of {variant}",
                pole=name,
                unit=unit.id,
                variant=variant.name,
            )
            refuse(mark("pole"), got, mark("one that carries nothing"))
    return replace(state, poles=tuple(one for one in state.poles if one is not pole))


def lay_poles(state: PlanState, places: Sequence[PolePlace], scene: Scene) -> PlanState:
    """The state with the poles of a file, where none is yet, and what hangs on them."""
    for place in places:
        if any(_is_at(pole, (place.x_m, place.y_m)) for pole in state.poles):
            continue
        ids = {site.id for site in (*scene.sites, *state.poles)}
        name = free_name(ids, "own-") if place.id in ids else _printable(place.id)
        pole = build_pole(scene, name, (place.x_m, place.y_m))
        state = replace(state, poles=(*state.poles, pole))

    def hung(unit: CandidatePose) -> CandidatePose:
        there = (pole.id for pole in state.poles if _is_at(pole, unit.pose.position_m))
        return unit if unit.site_id else replace(unit, site_id=next(there, ""))

    return _each_unit(state, hung)


def _is_at(pole: Site, place_m: Any) -> bool:
    return math.dist(pole.position_m[:2], place_m[:2]) < _SAME_PLACE_M


# ---------- undo and redo


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """States in the order in which they came about, and which of them is now."""

    states: tuple[PlanState, ...]
    now: int = 0
    gesture: str = ""  # that the newest step belongs to; empty: none

    @property
    def state(self) -> PlanState:
        """The state that is shown."""
        return self.states[self.now]

    @property
    def can_undo(self) -> bool:
        """True if there is an earlier state."""
        return self.now > 0

    @property
    def can_redo(self) -> bool:
        """True if there is a later state."""
        return self.now + 1 < len(self.states)

    def went_on(self, state: PlanState, *, gesture: str = "") -> "History":
        """One state further; a step of the same gesture as the last one takes its place."""
        is_same = bool(gesture) and gesture == self.gesture and not self.can_redo
        before = self.states[: self.now + (0 if is_same else 1)]
        states = (*before, state)[-MAX_STEPS:]
        return History(states=states, now=len(states) - 1, gesture=gesture)

    def reverted(self, gesture: str) -> "History":
        """Without the newest step, if it belongs to a gesture."""
        if not gesture or gesture != self.gesture or not self.can_undo:
            return self
        return History(states=self.states[:-1], now=self.now - 1)

    def of_newest(self, most: int) -> "History":
        """Without the steps in other than the newest workspaces."""
        last = list(dict.fromkeys(id(state.workspace) for state in reversed(self.states)))[:most]
        states = tuple(state for state in self.states if id(state.workspace) in last)
        return History(states=states, now=len(states) - 1)

    def undone(self) -> "History":
        """One state back, where there is one."""
        return replace(self, now=max(self.now - 1, 0), gesture="")

    def redone(self) -> "History":
        """One state on, where there is one."""
        return replace(self, now=min(self.now + 1, len(self.states) - 1), gesture="")


def begin_history(variants: Sequence[Variant], workspace: Any = None) -> History:
    """A history of one state with these variants, the first one current; or with an empty one."""
    first = variants[0] if variants else Variant(name=tr("Variant") + " 1")
    state = PlanState(variants=(first,), workspace=workspace)
    for variant in variants[1:]:
        state = add_variant(state, variant)
    return History(states=(replace(state, current=0),))


# ---------- an image below the plan


class LiePoint(Struct, frozen=True, forbid_unknown_fields=True):
    """A place in the image, from its upper left corner, and the same in the world frame."""

    x_px: float
    y_px: float
    east_m: float
    north_m: float


class Lie(Struct, frozen=True, forbid_unknown_fields=True):
    """How an image lies on the plan: its size, and two points."""

    width_px: int
    height_px: int
    points: tuple[LiePoint, LiePoint]


class Background(Struct, frozen=True, forbid_unknown_fields=True):
    """An image, as base64 in a plan's file, and how it lies; nothing here decodes it."""

    lie: Lie
    image: bytes

    @property
    def media_type(self) -> str:
        """Kind of image that browsers draw, by its first bytes; empty: none."""
        if self.image[:4] == b"RIFF" and self.image[8:12] == b"WEBP":
            return "image/webp"
        return next((kind for start, kind in _STARTS.items() if self.image.startswith(start)), "")


def background_message(background: Background | None) -> dict[str, Any]:
    """Message about the image: its address, size and points; an empty address: none."""
    if background is None:
        return {"type": "background", "address": ""}
    lie, points = background.lie, map(msgspec.structs.astuple, background.lie.points)
    # By its number: another one is not taken from a cache.
    address = f"background?{id(background)}"
    size = [lie.width_px, lie.height_px]
    return {"type": "background", "address": address, "size": size, "points": list(points)}


def build_background(content: bytes, lie: bytes, where: str) -> Background:
    """A background from an image and the JSON of its :class:`Lie`.

    Raises InputError if it is none that browsers draw, too large, or the points do not lay it.
    """
    try:
        found = msgspec.json.decode(lie, type=Lie)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            Phrase("{file}: points", file=Phrase(where)),
            Unquoted(error),
            mark("two points of the image"),
        ) from None
    return _checked(Background(lie=found, image=content), where)


def _read_background(record: Any, where: str) -> Background:
    try:
        found = msgspec.convert(record, Background)
    except msgspec.ValidationError as error:
        raise InputError(where, Unquoted(error), mark("an image and how it lies")) from None
    return _checked(found, where)


def _checked(background: Background, where: str) -> Background:
    lie, n_bytes = background.lie, len(background.image)
    if n_bytes > MAX_IMAGE_BYTES:
        refuse(where, Phrase("{n:,} bytes", n=n_bytes), Phrase("at most {n:,}", n=MAX_IMAGE_BYTES))
    if not background.media_type:
        refuse(where, mark("another format"), mark("PNG, JPEG, WebP or GIF"))
    if not (1 <= lie.width_px <= _MAX_SIDE_PX and 1 <= lie.height_px <= _MAX_SIDE_PX):
        size = Phrase("{width} by {height} pixels", width=lie.width_px, height=lie.height_px)
        refuse(where, size, Phrase("1 to {n:,} pixels", n=_MAX_SIDE_PX))
    first, second = lie.points
    numbers = [value for point in lie.points for value in msgspec.structs.astuple(point)]
    if not all(math.isfinite(value) and abs(value) <= _MAX_COORDINATE_M for value in numbers):
        raise InputError(
            Phrase("{file}: points", file=Phrase(where)),
            numbers,
            Phrase("numbers up to {n:,.0f}", n=_MAX_COORDINATE_M),
        )
    apart_px = math.hypot(second.x_px - first.x_px, second.y_px - first.y_px)
    apart_m = math.hypot(second.east_m - first.east_m, second.north_m - first.north_m)
    if apart_px < _LEAST_APART_PX or apart_m < _LEAST_APART_M:
        got = Phrase(
            "points {pixels:.1f} px and {metres:.2f} m from each other",
            pixels=apart_px,
            metres=apart_m,
        )
        expected = Phrase(
            "at least {pixels:g} px and {metres:g} m", pixels=_LEAST_APART_PX, metres=_LEAST_APART_M
        )
        refuse(Phrase("{file}: points", file=Phrase(where)), got, expected)
    return background


# ---------- plans as files

SCHEMA = "place-rsus/plan/1"
MAX_PLAN_BYTES = 16_000_000
"""Of a plan's file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Contents of a plan's file; an empty name: of any scene."""

    variants: tuple[Variant, ...]
    scene_name: str = ""
    background: Background | None = None
    poles: tuple[PolePlace, ...] = ()


def check_plan(plan: Plan, scene: Scene) -> None:
    """Raise InputError unless all variants of a plan can be mounted in a scene."""
    for variant in plan.variants:
        if variant.units:
            layout = Layout(name=variant.name, units=variant.units, scene_name=plan.scene_name)
            check_layout(layout, scene)


def read_plan(text: bytes, where: str) -> Plan:
    """A plan from a plan's or a layout's file, named for messages; InputError: it is neither."""
    try:
        document = msgspec.json.decode(text)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise InputError(where, Unquoted(error), mark("a layout or a plan as JSON")) from None
    background = None
    if isinstance(document, dict) and document.get("schema") == SCHEMA:
        variants = _read_variants(document.get("variants"), where)
        if (drawn := document.get("background")) is not None:
            background = _read_background(drawn, f"{where}: background")
    else:
        variants = [_read_variant(document, text, where, Path(where).stem)]
    poles = read_table(document.get("poles", []), list[PolePlace], f"{where}: poles")
    check_count(len(poles), f"{where}: poles", MAX_UNITS)
    return Plan(
        variants=tuple(variants),
        scene_name=str(document.get("scene", "")),
        background=background,
        poles=tuple(poles),
    )


def _read_variants(records: Any, where: str) -> list[Variant]:
    if not isinstance(records, list) or not 1 <= len(records) <= MAX_VARIANTS:
        refuse(
            Phrase("{file}: variants", file=Phrase(where)),
            mark("none"),
            Phrase("a list of 1 to {n}", n=MAX_VARIANTS),
        )
    variants = []
    for index, record in enumerate(records):
        at = f"{where}: variants[{index}]"
        if not isinstance(record, dict):
            raise InputError(at, record, mark("a layout"))
        name = record.get("name")
        if record.get("layout") == [] and isinstance(name, str):
            variants.append(Variant(name=_printable(name)))
        else:
            encoded = msgspec.json.encode(record)
            variants.append(_read_variant(record, encoded, at, f"{index + 1}"))
    return variants


def _read_variant(document: Any, text: bytes, where: str, name: str) -> Variant:
    """A layout as a variant; too many units are refused before they are read."""
    records = document.get("layout") if isinstance(document, dict) else None
    if isinstance(records, list):
        check_count(len(records), f"{where}: units", MAX_UNITS)
    layout = read_layout(text, where=where, name=name)
    return Variant(name=_printable(layout.name), units=layout.units)
