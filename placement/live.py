"""Detections of units while somebody moves them: rays are cached, points projected again.

A ray depends on the place of a sensor, not on where it looks: :class:`LiveTable` casts once per
mount position, to every road user whom any direction or zoom could show, and answers every turn,
tilt and zoom from there by the detection table's own kernels. Its rows are those of
:func:`placement.visibility.build_detection_table`.
"""

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel
from geometry.sensors import CameraModel
from scenarios.runs import find_onsets

from .candidates import CandidatePose
from .compute import DEFAULT_COMPUTE, Compute
from .evaluation import Verdict, earliest_arrival_s
from .setting import Setting
from .visibility.build import N_POINTS
from .visibility.casting import World, build_world, cast_sight
from .visibility.sensing import Sensing, build_sensing, reach_m

MAX_MOUNTS = 64
"""Mount positions whose rays are cached: some megabytes each."""

MAX_ROWS = 4096
"""Poses whose frames are cached: some kilobytes each."""

_Key = tuple[object, ...]


class LiveTable:
    """Rows of a detection table, made when they are asked for; not for several threads at once.

    Parameters
    ----------
    setting : Setting
        Scene, runs, and the planning detector.
    compute : Compute
        Its seed and its library of rays; results are those of a table with the same seed.
    """

    def __init__(self, setting: Setting, *, compute: Compute = DEFAULT_COMPUTE) -> None:
        self._setting, self._compute = setting, compute
        self._world: World | None = None
        self._mounts: OrderedDict[_Key, Sensing] = OrderedDict()
        self._rows: OrderedDict[_Key, BoolArray] = OrderedDict()

    @property
    def n_mounts(self) -> int:
        """Number of mount positions whose rays are at hand."""
        return len(self._mounts)

    def detected(self, units: Sequence[CandidatePose]) -> BoolArray:
        """Frames in which units detect the VRU, (n_units, n_frames) bool."""
        frames = np.zeros((len(units), self._setting.axis.n_frames), dtype=bool)
        missing: dict[_Key, list[int]] = {}
        for index, unit in enumerate(units):
            known = self._rows.get(_row_key(unit))
            if known is None:
                missing.setdefault(_mount_key(unit), []).append(index)
            else:
                self._rows.move_to_end(_row_key(unit))
                frames[index] = known
        for rows in missing.values():
            alike = [units[row] for row in rows]
            with threadpool_limits(1):
                bits = self._sensing(alike[0]).packed(alike)
            found = np.unpackbits(bits, axis=1, count=frames.shape[1], bitorder="little")
            frames[rows] = found
            for unit, row in zip(alike, found.astype(bool), strict=True):
                self._rows[_row_key(unit)] = row
        while len(self._rows) > MAX_ROWS:
            self._rows.popitem(last=False)
        return frames

    def _sensing(self, unit: CandidatePose) -> Sensing:
        """View from a unit's mount, in every direction."""
        key = _mount_key(unit)
        if key in self._mounts:
            self._mounts.move_to_end(key)
            return self._mounts[key]
        setting = self._setting
        if self._world is None:
            self._world = build_world(
                setting.scene,
                setting.runs,
                n_points=N_POINTS,
                seed=self._compute.seed,
                rays=self._compute.rays,
            )
        sight = cast_sight(
            self._world,
            unit.pose.position_m,
            near_m=unit.sensor.near_m,
            max_distance_m=reach_m(unit.sensor, setting.table_detector, self._world),
            for_lidar=isinstance(unit.sensor, LidarModel),
        )
        sensing = build_sensing(self._world, sight, unit.pose.position_m, setting.table_detector)
        self._mounts[key] = sensing
        while len(self._mounts) > MAX_MOUNTS:
            self._mounts.popitem(last=False)
        return sensing


def _mount_key(unit: CandidatePose) -> _Key:
    """Equal for units that look from the same place, with any setting of the same lens."""
    return (*unit.pose.position_m.tolist(), _lens_free(unit.sensor))


def _lens_free(sensor: Sensor) -> _Key:
    """Key of a sensor as far as rays depend on it: not how its lens is set."""
    if isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None:
        size = (sensor.width_px, sensor.height_px, sensor.near_m)
        return ("camera", *size, sensor.fov_range_deg)
    return (sensor,)


def _row_key(unit: CandidatePose) -> _Key:
    pose = unit.pose
    return (*pose.position_m.tolist(), pose.yaw_deg, pose.pitch_deg, unit.sensor)


def table_verdict(units: Sequence[CandidatePose], detected: BoolArray, setting: Setting) -> Verdict:
    """Verdict on all units together by the detection table, without the VUT's own sensors.

    `detected`, (n_units, n_frames) bool, is that of :meth:`LiveTable.detected`. The table is read
    as by the optimiser: a run is avoided if a confirmed track is alive at the last moment. The
    evaluator asks pixels and bodies instead.
    """
    axis, rule = setting.axis, setting.rule
    parties = [(row, unit.latency(rule)) for unit, row in zip(units, detected, strict=True)]
    arrival = earliest_arrival_s(parties, axis)
    onsets = find_onsets(arrival, axis, rule=rule)
    return Verdict(
        detected=np.isfinite(arrival),
        confirmation_time_s=onsets.confirmation_s,
        onset_time_s=onsets.onset_s,
        is_avoided=onsets.is_in_time,
    )
