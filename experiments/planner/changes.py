"""Every way in which a request changes a plan: a new state, or an error that says why not."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import UNSET

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.errors import InputError, refuse
from geometry.phrases import Phrase
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, Site
from geometry.sensors import CameraModel, with_fov
from geometry.tables import pick
from geometry.terrain import ground_height_m
from placement.candidates import CandidatePose, is_ring, load_candidate_grid
from placement.retrofit import free_name

from ..language import mark, tr
from .plan import (
    PlanState,
    Variant,
    add_variant,
    begin_history,
    check_finite,
    printable_name,
)
from .poles import put_pole, remove_pole
from .requests import (
    AddUnit,
    AddVariant,
    Change,
    ChangeUnit,
    PutPole,
    RemovePole,
    RemoveUnit,
    RemoveVariant,
    RenameVariant,
    SelectVariant,
)

_DEFAULT_PITCH_DEG = -15.0
# An axis less steep meets the ground too far away to be aimed at it
_LEVEL_DEG = 0.5
_FAR_M = 45.0
# Of degrees and metres: finer than anybody mounts
_DECIMALS = 6
# Above the ground, where a unit has no site
_LOWEST_M = 0.5
_HIGHEST_M = 50.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stock:
    """What a change may use.

    Attributes
    ----------
    scene : Scene
        The scene with its sites, those of one's own among them.
    models : mapping of str to Sensor
        Sensor models that can be mounted, by name.
    """

    scene: Scene
    models: Mapping[str, Sensor]


def change_state(state: PlanState, change: Change, stock: Stock) -> PlanState:
    """State of the plan after a change.

    Parameters
    ----------
    state : PlanState
        Before it.
    change : Change
        The request of a browser.
    stock : Stock
        Sites and sensor models that may be used.

    Returns
    -------
    PlanState
        Another one; `state` stays as it is.

    Raises
    ------
    InputError
        There is no such unit, site, sensor or variant; a site is full or forbidden; or
        a number is none that can be mounted.
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
            return put_pole(state, change, stock.scene)
        case RemovePole(site=name):
            return remove_pole(state, name)
        case AddVariant(name=name):
            if not name:
                taken = {each.name for each in state.variants}
                name = free_name(taken, tr("Variant") + " ")
            return add_variant(state, Variant(name=name, units=units))
        case SelectVariant(index=index):
            if not 0 <= index < len(state.variants):
                raise InputError(
                    mark("variant"), index, f"0 to {len(state.variants) - 1}"
                )
            return replace(state, current=index)
        case RenameVariant(name=name):
            return _rename_variant(state, printable_name(name))
        case RemoveVariant():
            return _remove_variant(state)


def _rename_variant(state: PlanState, name: str) -> PlanState:
    """The state with another name for the current variant; InputError: it is taken."""
    for variant in state.variants:
        if variant is not state.variant and variant.name == name:
            raise InputError(
                mark("name"), name, mark("a name that no other variant has")
            )
    renamed = replace(state.variant, name=name)
    return state.with_variant(renamed)


def _remove_variant(state: PlanState) -> PlanState:
    """The state without the current variant; InputError: it is the last one."""
    if len(state.variants) == 1:
        expected = mark("another one: the last one stays")
        raise InputError(mark("variant"), state.variant.name, expected)
    others = tuple(each for each in state.variants if each is not state.variant)
    current = min(state.current, len(others) - 1)
    return replace(state, variants=others, current=current)


def _add_unit(state: PlanState, change: AddUnit, stock: Stock) -> PlanState:
    """The state with one more unit in the current variant; see :class:`AddUnit`."""
    units = state.variant.units
    scene = stock.scene
    site = _free_site(change.site, units, scene)
    sensor = pick(stock.models, change.sensor, mark("sensor"))
    if change.fov_deg is not None:
        sensor = _with_lens(sensor, change.fov_deg)
    # A height that the site does not have is brought into its range.
    wanted_m = change.height_m
    if wanted_m is None:
        wanted_m = load_candidate_grid().heights_m.max()
    low_m, high_m = site.height_range_m
    wanted_m = check_finite(mark("height"), wanted_m)
    height_m = float(np.clip(wanted_m, low_m, high_m))
    yaw_deg = change.yaw_deg
    if yaw_deg is None:
        yaw_deg = _towards_middle_deg(site, scene)
    pitch_deg = change.pitch_deg
    if pitch_deg is None:
        pitch_deg = _default_pitch_deg(sensor)
    pose = Pose(
        position_m=site.position_m + [0.0, 0.0, height_m],
        yaw_deg=_yaw(yaw_deg),
        pitch_deg=_pitch(pitch_deg),
    )
    name = free_name({unit.id for unit in units})
    unit = CandidatePose(id=name, site_id=site.id, pose=pose, sensor=sensor)
    return state.with_units([*units, unit])


def _towards_middle_deg(site: Site, scene: Scene) -> float:
    """Yaw from a site to the middle of the junction; 0 from the middle itself."""
    middle_m = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    east, north = middle_m - site.position_m[:2]
    return math.degrees(math.atan2(north, east))


def _default_pitch_deg(sensor: Sensor) -> float:
    """Pitch of a sensor that is mounted anew; what scans all round is level."""
    if is_ring(sensor):
        return 0.0
    return _DEFAULT_PITCH_DEG


def first_units(stock: Stock, sensor: str) -> tuple[CandidatePose, ...]:
    """A unit alone, at the first site that may carry one.

    Parameters
    ----------
    stock : Stock
        Sites and sensor models.
    sensor : str
        Name of the model.

    Returns
    -------
    tuple of CandidatePose
        One unit; none where there is no such site.
    """
    free = [site.id for site in stock.scene.sites if site.use != "forbidden"]
    if not free:
        return ()
    empty = begin_history(()).state
    change = AddUnit(site=free[0], sensor=sensor)
    return _add_unit(empty, change, stock).variant.units


def _change_unit(state: PlanState, change: ChangeUnit, stock: Stock) -> PlanState:
    """The state with one unit changed; see :class:`ChangeUnit`.

    A sensor comes first, since its lens may be changed in the same request; then the
    site, since heights are those of the new one; then what is said of the pose.
    """
    units = state.variant.units
    scene = stock.scene
    index = _find(units, change.unit)
    unit = units[index]
    pose = unit.pose
    sensor = unit.sensor
    site_id = unit.site_id
    if change.sensor is not UNSET:
        sensor = pick(stock.models, change.sensor, mark("sensor"))
        # The old tilt means nothing to what scans all round, and the other way round.
        if is_ring(sensor) != is_ring(unit.sensor):
            pose = replace(pose, pitch_deg=_default_pitch_deg(sensor))
    if change.fov_deg is not UNSET:
        sensor = _with_lens(sensor, change.fov_deg)
    if change.site is not UNSET and change.site != site_id:
        # It does not take a place at the new site from itself.
        others = [other for other in units if other is not unit]
        site = _free_site(change.site, others, scene)
        ground_m = float(ground_height_m(scene, pose.position_m[:2]))
        low_m, high_m = site.height_range_m
        above_m = float(np.clip(pose.position_m[2] - ground_m, low_m, high_m))
        pose = _moved(pose, site.position_m + [0.0, 0.0, above_m], sensor, scene)
        site_id = site.id
    if change.height_m is not UNSET:
        height_m = check_finite(mark("height"), change.height_m)
        pose = _raised(pose, site_id, height_m, scene)
    if change.yaw_deg is not UNSET:
        pose = replace(pose, yaw_deg=_yaw(change.yaw_deg))
    if change.pitch_deg is not UNSET:
        pose = replace(pose, pitch_deg=_pitch(change.pitch_deg))
    changed = replace(unit, site_id=site_id, pose=pose, sensor=sensor)
    return state.with_units([*units[:index], changed, *units[index + 1 :]])


def _with_lens(sensor: Sensor, fov_deg: float) -> CameraModel:
    """A camera with another horizontal angle of view; InputError: no camera, or not in range."""
    if not isinstance(sensor, CameraModel):
        expected = mark("nothing: only cameras have lenses")
        raise InputError(mark("lens"), fov_deg, expected)
    lens = mark("lens")
    return with_fov(sensor, check_finite(lens, fov_deg), lens)


def _moved(pose: Pose, position_m: FloatArray, sensor: Sensor, scene: Scene) -> Pose:
    """A pose at another place that looks at the same point of the ground.

    One whose axis does not meet the ground keeps its tilt, and turns to what lay ahead
    of it as far away as a junction is wide.

    Parameters
    ----------
    pose : Pose
        Before it is moved.
    position_m : ndarray, shape (3,)
        Where it is moved to, in the world frame.
    sensor : Sensor
        What is mounted: one that scans all round has no axis.
    scene : Scene
        Says how high the ground is.
    """
    eye_m = pose.position_m
    up_m = float(eye_m[2] - ground_height_m(scene, eye_m[:2]))
    yaw_deg = pose.yaw_deg
    pitch_deg = pose.pitch_deg
    is_tilted = pitch_deg < -_LEVEL_DEG and not is_ring(sensor)
    reach_m = _FAR_M
    if is_tilted:
        reach_m = up_m / math.tan(math.radians(-pitch_deg))
    # The point of the ground at which the axis ends
    yaw = math.radians(yaw_deg)
    target_m = eye_m[:2] + reach_m * np.array([math.cos(yaw), math.sin(yaw)])
    east, north = target_m - position_m[:2]
    if is_tilted:
        above_m = float(position_m[2] - ground_height_m(scene, target_m))
        pitch_deg = -math.degrees(math.atan2(above_m, math.hypot(east, north)))
    if east or north:
        yaw_deg = math.degrees(math.atan2(north, east))
    return Pose(
        position_m=position_m, yaw_deg=_yaw(yaw_deg), pitch_deg=_pitch(pitch_deg)
    )


def mount_range_m(pose: Pose, site_id: str, scene: Scene) -> tuple[float, float, float]:
    """Where a pose can be mounted above one another.

    Returns
    -------
    foot_m : float
        Height of the foot of its site; without a site, of the ground below the pose.
    low_m, high_m : float
        Least and greatest height above that.
    """
    for site in scene.sites:
        if site.id == site_id:
            low_m, high_m = site.height_range_m.tolist()
            return float(site.position_m[2]), low_m, high_m
    foot_m = float(ground_height_m(scene, pose.position_m[:2]))
    return foot_m, _LOWEST_M, _HIGHEST_M


def _raised(pose: Pose, site_id: str, height_m: float, scene: Scene) -> Pose:
    """A pose at another height above the foot of its site, or above the ground below it.

    Raises InputError if nothing can be mounted at that height.
    """
    foot_m, low_m, high_m = mount_range_m(pose, site_id, scene)
    if not low_m - 1.0e-9 <= height_m <= high_m + 1.0e-9:
        expected = Phrase(
            "{low:g} .. {high:g} m, above the ground", low=low_m, high=high_m
        )
        if site_id:
            expected = Phrase(
                "{low:g} .. {high:g} m, the range of {site}",
                low=low_m,
                high=high_m,
                site=site_id,
            )
        raise InputError(mark("height"), height_m, expected)
    east, north = pose.position_m[:2]
    up_m = foot_m + round(height_m, _DECIMALS)
    return replace(pose, position_m=np.array([east, north, up_m]))


def _find(units: Sequence[CandidatePose], unit_id: str) -> int:
    """Index of a unit; InputError: there is none of that name."""
    ids = [unit.id for unit in units]
    if unit_id not in ids:
        raise InputError(mark("unit"), unit_id, mark("one that is mounted there"))
    return ids.index(unit_id)


def _free_site(site_id: str, units: Sequence[CandidatePose], scene: Scene) -> Site:
    """A site that may carry one more unit than these; InputError: there is none."""
    # Of equal ids the first
    by_id = {site.id: site for site in reversed(scene.sites)}
    site = by_id.get(site_id)
    if site is None:
        expected: str = Phrase("a site of {scene}", scene=scene.name)
        raise InputError(mark("site"), site_id, expected)
    if site.use == "forbidden":
        expected = mark("a site that may carry units: the scene forbids this one")
        raise InputError(mark("site"), site_id, expected)
    # Each unit takes one place.
    n_there = sum(unit.site_id == site_id for unit in units)
    if n_there >= site.capacity_units:
        got = Phrase("one unit more than the {n} there", n=n_there)
        where = Phrase("site {name}", name=site_id)
        refuse(where, got, Phrase("at most {n}", n=site.capacity_units))
    return site


def _yaw(yaw_deg: float) -> float:
    """A yaw between -180 and 180 degrees; InputError: it is not finite."""
    wrapped_deg = float(wrap_deg(check_finite(mark("direction"), yaw_deg)))
    return round(wrapped_deg, _DECIMALS)


def _pitch(pitch_deg: float) -> float:
    """A pitch as it is mounted; InputError: it is none."""
    if not -90.0 <= pitch_deg <= 90.0:
        expected = Phrase("{low} .. {high} degrees", low=-90, high=90)
        raise InputError(mark("tilt"), pitch_deg, expected)
    return round(float(pitch_deg), _DECIMALS)
