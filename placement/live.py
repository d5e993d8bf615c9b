"""Detections of units while somebody moves them: rays are cached, points projected again.

Rays depend on a sensor's place, not on where it looks: they are cast once per mount
position. Rows are those of :func:`placement.visibility.build_detection_table`.
"""

from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray
from geometry.lidar import LidarModel
from scenarios.runs import find_onsets

from .candidates import CandidatePose
from .compute import DEFAULT_COMPUTE, Compute, one_blas_thread
from .evaluation import Verdict, earliest_arrival_s
from .evaluator.evaluate import unit_key
from .setting import Setting
from .visibility.build import N_POINTS
from .visibility.casting import World, build_world, cast_sight
from .visibility.sensing import Sensing, build_sensing, reach_m

MAX_MOUNTS = 64  # mount positions whose rays are cached: some megabytes each

MAX_ROWS = 4096  # poses whose frames are cached: some kilobytes each

_Key = tuple[object, ...]
_T = TypeVar("_T")


class LiveTable:
    """Rows of a detection table, made when they are asked for; not for several threads at once.

    `compute` has the seed of a table with the same rows; up to `max_mounts` positions
    are cached.
    """

    def __init__(
        self,
        setting: Setting,
        *,
        compute: Compute = DEFAULT_COMPUTE,
        max_mounts: int = MAX_MOUNTS,
    ) -> None:
        self._setting = setting
        self._compute = compute
        self._max_mounts = max_mounts
        self._world: World | None = None
        self._mounts: OrderedDict[_Key, tuple[Sensing, float]] = (
            OrderedDict()
        )  # and their reach
        self._rows: OrderedDict[_Key, NDArray[np.uint8]] = OrderedDict()
        self.n_casts = 0

    def detected(self, units: Sequence[CandidatePose]) -> BoolArray:
        """Frames in which units detect the VRU, (n_units, n_frames) bool."""
        n_frames = self._setting.axis.n_frames
        bits = np.unpackbits(
            self.packed(units), axis=1, count=n_frames, bitorder="little"
        )
        return bits.astype(bool)

    def packed(self, units: Sequence[CandidatePose]) -> NDArray[np.uint8]:
        """The same as bits, lowest first, (n_units, ceil(n_frames / 8))."""
        packed = np.zeros(
            (len(units), -(-self._setting.axis.n_frames // 8)), dtype=np.uint8
        )
        missing: dict[_Key, list[int]] = {}
        for row, unit in enumerate(units):
            known = self._rows.get(unit_key(unit))
            if known is None:
                sensor = unit.sensor
                place = unit.pose.position_m.tolist()
                key = (
                    *place,
                    sensor.near_m,
                    isinstance(sensor, LidarModel),
                )  # of all rays
                missing.setdefault(key, []).append(row)
            else:
                self._rows.move_to_end(unit_key(unit))
                packed[row] = known
        if not missing:
            return packed
        keys = list(missing)
        if self._world is None:
            setting = self._setting
            compute = self._compute
            self._world = build_world(
                setting.scene,
                setting.runs,
                n_points=N_POINTS,
                seed=compute.seed,
                rays=compute.rays,
            )

        def fill(key: _Key) -> tuple[Sensing, float]:
            alike = [units[row] for row in missing[key]]
            known = self._sensing(key, alike)
            packed[missing[key]] = known[0].packed(alike)
            return known

        with one_blas_thread(), ThreadPoolExecutor(self._compute.workers) as pool:
            for start in range(0, len(keys), self._max_mounts):
                part = keys[start : start + self._max_mounts]
                mounts = list(pool.map(fill, part))  # all, before any is given up
                for key, mount in zip(part, mounts, strict=True):
                    self.n_casts += self._mounts.get(key) is not mount
                    _put(self._mounts, key, mount, most=self._max_mounts)
        for rows in missing.values():
            for row in rows:
                _put(
                    self._rows, unit_key(units[row]), packed[row].copy(), most=MAX_ROWS
                )
        return packed

    def _sensing(
        self, key: _Key, units: Sequence[CandidatePose]
    ) -> tuple[Sensing, float]:
        """View from the mount of units in every direction, as far as they reach, and how far."""
        assert self._world is not None
        detector = self._setting.table_detector
        needed_m = max(reach_m(unit.sensor, detector, self._world) for unit in units)
        if key in self._mounts and self._mounts[key][1] >= needed_m:
            return self._mounts[key]
        position_m = units[0].pose.position_m
        sensor = units[0].sensor
        sight = cast_sight(
            self._world,
            position_m,
            near_m=sensor.near_m,
            max_distance_m=needed_m,
            for_lidar=isinstance(sensor, LidarModel),
        )
        return build_sensing(self._world, sight, position_m, detector), needed_m


def _put(cached: OrderedDict[_Key, _T], key: _Key, value: _T, *, most: int) -> None:
    """Cache a value as the newest one; the oldest is given up where there are too many."""
    cached[key] = value
    cached.move_to_end(key)
    if len(cached) > most:
        cached.popitem(last=False)


def table_verdict(
    units: Sequence[CandidatePose],
    detected: BoolArray,
    setting: Setting,
    *,
    with_vut: bool = False,
) -> Verdict:
    """Verdict on all units together by the detection table, and on the VUT if asked for.

    `detected`, (n_units, n_frames) bool, is that of :meth:`LiveTable.detected`; the
    VUT's is the setting's. As for the optimiser, a run is avoided if a confirmed track
    is alive at the last moment.
    """
    axis = setting.axis
    rule = setting.rule
    parties = [
        (row, unit.latency(rule)) for unit, row in zip(units, detected, strict=True)
    ]
    if with_vut and setting.seen_by_vut is not None:
        parties.append((setting.seen_by_vut, rule.latency_s))
    arrival = earliest_arrival_s(parties, axis)
    onsets = find_onsets(arrival, axis, rule=rule)
    return Verdict(
        detected=np.isfinite(arrival),
        confirmation_time_s=onsets.confirmation_s,
        onset_time_s=onsets.onset_s,
        is_avoided=onsets.is_in_time,
    )
