"""Detection rows of new poses: rays are cast once per mount position, then only projected."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.catalogue import Sensor

from ..candidates import CandidatePose
from ..setting import Setting
from ..visibility.build import N_POINTS
from ..visibility.casting import build_world, cast_sight
from ..visibility.sensing import Sensing, build_sensing, reach_m

RowBuilder = Callable[[Sequence[CandidatePose]], NDArray[np.uint8]]
"""Packed rows of candidate poses on the frame axis of a problem, (n_poses, ceil(n_frames / 8))."""

_KEPT_MOUNTS = 16  # some ten megabytes each at the study's junction


class RayRows:
    """Rows of candidate poses at mounts that are remembered.

    Parameters
    ----------
    setting : Setting
        Scene, runs and detector.
    seed : int
        Of the points on the VRUs: that of the detection table.
    workers : int
        Threads.

    Notes
    -----
    The rows are those of :func:`placement.visibility.build_detection_table`. What takes its time
    there, and is spared here when a mount comes again, are the rays: another direction or field of
    view only projects the points that they reach.
    """

    def __init__(self, setting: Setting, *, seed: int = 0, workers: int = 1) -> None:
        self.detector = setting.planner
        self.world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=seed)
        self.workers = workers
        self.n_casts = 0
        self._reach_m: dict[Sensor, float] = {}
        self._mounts: OrderedDict[tuple[float, ...], tuple[Sensing, float]] = OrderedDict()

    def __call__(self, candidates: Sequence[CandidatePose]) -> NDArray[np.uint8]:
        """Packed rows, lowest bit first, (n_poses, ceil(n_frames / 8))."""
        n_frames = len(self.world.views.view_of_frame)
        packed = np.zeros((len(candidates), -(-n_frames // 8)), dtype=np.uint8)
        mounts: dict[tuple[float, ...], list[int]] = {}
        for row, candidate in enumerate(candidates):
            mounts.setdefault(_mount_key(candidate), []).append(row)
        keys = list(mounts)

        def project(row: int, sensing: Sensing) -> None:
            packed[row] = np.packbits(sensing.frames(candidates[row]), bitorder="little")

        # One BLAS thread per worker: the matrices are small, and idle BLAS threads spin.
        with threadpool_limits(1), ThreadPoolExecutor(self.workers) as pool:
            for start in range(0, len(keys), _KEPT_MOUNTS):
                part = keys[start : start + _KEPT_MOUNTS]
                sensings = dict(
                    zip(
                        part,
                        pool.map(
                            self._sensing, part, [[candidates[i] for i in mounts[k]] for k in part]
                        ),
                        strict=True,
                    )
                )
                jobs = [
                    pool.submit(project, row, sensing)
                    for key, (sensing, _) in sensings.items()
                    for row in mounts[key]
                ]
                for job in jobs:
                    job.result()
                self._remember(sensings)
        return packed

    def _sensing(
        self, key: tuple[float, ...], candidates: Sequence[CandidatePose]
    ) -> tuple[Sensing, float]:
        """What a mount sees as far as its sensors reach, and how far that is."""
        needed_m = max(self._reach_of(candidate.sensor) for candidate in candidates)
        if key in self._mounts and self._mounts[key][1] >= needed_m:
            return self._mounts[key]
        position_m, near_m = candidates[0].pose.position_m, candidates[0].sensor.near_m
        sight = cast_sight(self.world, position_m, near_m=near_m, max_distance_m=needed_m)
        return build_sensing(self.world, sight, position_m, self.detector), needed_m

    def _reach_of(self, sensor: Sensor) -> float:
        if sensor not in self._reach_m:
            self._reach_m[sensor] = reach_m(sensor, self.detector, self.world)
        return self._reach_m[sensor]

    def _remember(self, sensings: dict[tuple[float, ...], tuple[Sensing, float]]) -> None:
        for key, known in sensings.items():
            self.n_casts += self._mounts.get(key) is not known
            self._mounts[key] = known
            self._mounts.move_to_end(key)
        while len(self._mounts) > _KEPT_MOUNTS:
            self._mounts.popitem(last=False)


def _mount_key(candidate: CandidatePose) -> tuple[float, ...]:
    """Equal for poses that share all rays."""
    return (*candidate.pose.position_m.tolist(), candidate.sensor.near_m)
