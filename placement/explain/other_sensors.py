"""Other sensor models at the mounts of a layout: what a longer lens would buy."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.catalogue import Sensor, load_cameras
from geometry.poses import Pose, wrap_deg
from geometry.sensors import CameraModel, with_fov
from scenarios.runs import live_confirmation_times_s
from scenarios.weights import weight_share

from ..candidates import CandidatePose, is_turn_useless
from ..compute import DEFAULT_COMPUTE, Compute
from ..evaluator import with_sight
from ..optimiser.problem import Fusion
from ..setting import Setting
from ..visibility.build import detected_frames

STAGE = "other lenses"
TURNS_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0)
"""By how much a unit with another lens is turned: as it is mounted first. [deg]"""
N_ZOOMS = 3  # settings of a varifocal lens, in equal ratios
_LEVEL_DEG = 0.0  # no lens is tilted up: there is nobody in the sky


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherSensor:
    """One model in place of the sensors of a layout, on the detection table."""

    sensor: Sensor  # the model; a varifocal lens as the catalogue has it
    unit_index: int  # the unit for which it does most
    one: CandidatePose  # that unit with it, turned for the most
    apr_one: float  # accident prevention ratio with that unit exchanged alone, 0..1
    # all units that may be exchanged with it, turned one after the other, each for the most
    all: tuple[CandidatePose, ...]
    apr_all: float  # accident prevention ratio with these
    # accident prevention ratio with all exchanged and none turned; of a varifocal lens at its
    # widest
    apr_not_turned: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherSensors:
    """Other models at the mounts of a layout."""

    apr: float  # accident prevention ratio of the layout as it is, on the same table
    models: tuple[OtherSensor, ...]  # the model that gains most in place of one unit first


def find_other_sensors(
    setting: Setting,
    units: Sequence[CandidatePose],
    *,
    models: Collection[Sensor] | None = None,
    kept: Collection[str] = (),
    fusion: Fusion = "any",
    may_look: Callable[[Sequence[CandidatePose]], BoolArray] | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> OtherSensors | None:
    """Exchange the sensors of a layout for other models, by the rules of the detection table.

    Each unit is turned by up to 45 degrees in steps of 15 and tilted so that either the middle of
    the picture or its upper edge stays where it was, which is where the far end of an arm is; a
    varifocal lens is tried at three settings. Mounts stay, and units whose ids are `kept` stay as
    they are. `models` are by default the cameras of the catalogue; a LiDAR takes a second or two of
    processor time for each mount. `may_look` says which poses may be used, (n,) bool. `compute` has
    the seed of the layout's table. None where no unit may be exchanged, or there is no other model.
    """
    asked = load_cameras().values() if models is None else models
    looks, owner, model = _looks(units, asked, kept)
    if may_look is not None and looks:
        free = np.flatnonzero(may_look(looks))
        looks, owner, model = [looks[row] for row in free], owner[free], model[free]
    if not looks:
        return None
    setting = with_sight(setting, compute=compute)
    everyone = [(pose, setting.table_detector) for pose in (*units, *looks)]
    frames = detected_frames(setting, everyone, stage=STAGE, compute=compute)
    bench = _Bench(setting, frames[: len(units)], frames[len(units) :], fusion)
    found = []
    for name in dict.fromkeys(model.tolist()):
        rows = np.flatnonzero(model == name)
        by_unit = {unit: rows[owner[rows] == unit] for unit in np.unique(owner[rows]).tolist()}
        found.append(_exchange(bench, looks, by_unit, asked, name))
    found.sort(key=lambda one: (-one.apr_one, -one.apr_all, one.sensor.price_eur, one.sensor.name))
    return OtherSensors(apr=float(bench.apr({})[0]), models=tuple(found))


def _looks(
    units: Sequence[CandidatePose], models: Iterable[Sensor], kept: Collection[str]
) -> tuple[list[CandidatePose], IntArray, NDArray[np.object_]]:
    """Poses to try, the first of each unit and model not turned; their units and models."""
    looks, owner, names = [], [], []
    for sensor in models:
        for index, unit in enumerate(units):
            if unit.id in kept or sensor.name == unit.sensor.name:
                continue
            for lens in _settings(sensor):
                for pose in _poses(unit, lens):
                    looks.append(replace(unit, pose=pose, sensor=lens))
                    owner.append(index)
                    names.append(sensor.name)
    return looks, np.array(owner, dtype=np.int64), np.array(names, dtype=object)


def _settings(sensor: Sensor) -> list[Sensor]:
    """A model as it is tried: a varifocal lens at several fields of view, the widest first."""
    if not isinstance(sensor, CameraModel) or sensor.fov_range_deg is None:
        return [sensor]
    low, high = sensor.fov_range_deg
    fovs_deg = np.geomspace(high, low, N_ZOOMS).round(1).clip(low, high).tolist()
    return [with_fov(sensor, fov_deg, "fov_range_deg") for fov_deg in fovs_deg]


def _poses(unit: CandidatePose, sensor: Sensor) -> list[Pose]:
    """Poses to try of a unit with another sensor, the one that is mounted first."""
    pose = unit.pose
    raised_deg = pose.pitch_deg + 0.5 * (unit.sensor.vertical_fov_deg - sensor.vertical_fov_deg)
    raised_deg = max(pose.pitch_deg, min(raised_deg, _LEVEL_DEG))
    poses = []
    for pitch_deg in dict.fromkeys((pose.pitch_deg, raised_deg)):
        turns_deg = (0.0,) if is_turn_useless(sensor, pitch_deg=pitch_deg) else TURNS_DEG
        poses += [
            Pose(
                position_m=pose.position_m,
                yaw_deg=float(wrap_deg(pose.yaw_deg + turn_deg)),
                pitch_deg=pitch_deg,
            )
            for turn_deg in turns_deg
        ]
    return poses


def _exchange(
    bench: "_Bench",
    looks: Sequence[CandidatePose],
    by_unit: dict[int, IntArray],
    models: Iterable[Sensor],
    name: str,
) -> OtherSensor:
    """One model in place of one unit, and of all."""
    alone = {unit: bench.apr({unit: rows}) for unit, rows in by_unit.items()}
    unit = max(alone, key=lambda one: float(alone[one].max()))
    chosen = {one: rows[:1] for one, rows in by_unit.items()}
    not_turned = float(bench.apr(chosen)[0])
    best = not_turned
    for one, rows in by_unit.items():
        ratios = bench.apr({**chosen, one: rows})
        if float(ratios.max()) > best:
            best, at = float(ratios.max()), int(ratios.argmax())
            chosen[one] = rows[at : at + 1]
    return OtherSensor(
        sensor=next(sensor for sensor in models if sensor.name == name),
        unit_index=unit,
        one=looks[int(by_unit[unit][alone[unit].argmax()])],
        apr_one=float(alone[unit].max()),
        all=tuple(looks[int(rows[0])] for rows in chosen.values()),
        apr_all=best,
        apr_not_turned=not_turned,
    )


class _Bench:
    """The layout and all poses that are tried, and how they are judged."""

    def __init__(
        self, setting: Setting, units: BoolArray, looks: BoolArray, fusion: Fusion
    ) -> None:
        self.setting = setting
        self.is_fused = fusion == "any"
        # What counts of each alone: frames that are detected, or runs that are avoided.
        self.units = units if self.is_fused else self._avoided(units)
        self.looks = looks if self.is_fused else self._avoided(looks)
        seen = setting.seen_by_vut
        if seen is None:
            seen = np.zeros(setting.axis.n_frames, dtype=bool)
        self.vut = seen if self.is_fused else self._avoided(seen[None, :])[0]

    def apr(self, exchanged: Mapping[int, IntArray]) -> FloatArray:
        """APR with units exchanged, each for one pose or, at most one of them, for each of some."""
        others = [index for index in range(len(self.units)) if index not in exchanged]
        together = np.logical_or.reduce(self.units[others], axis=0, keepdims=True)
        for rows in exchanged.values():
            together = together | self.looks[rows]
        cars = self.setting.cars
        blind = self._shares(together) if cars < 1.0 else np.zeros(len(together))
        seeing = self._shares(together | self.vut) if cars else blind
        return cars * seeing + (1.0 - cars) * blind if cars else blind

    def _shares(self, together: BoolArray) -> FloatArray:
        avoided = self._avoided(together) if self.is_fused else together
        return np.array([weight_share(row, self.setting.axis.weight) for row in avoided])

    def _avoided(self, detected: BoolArray) -> BoolArray:
        times_s = live_confirmation_times_s(detected, self.setting.axis, rule=self.setting.rule)
        return np.isfinite(times_s)
