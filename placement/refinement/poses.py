"""Promising poses, old and new, and the placement problem on them."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from geometry.arrays import IntArray
from geometry.catalogue import Sensor
from geometry.lidar import LidarModel
from geometry.poses import wrap_deg
from geometry.sensors import CameraModel

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..layout import Layout
from ..optimiser import Limits, PlacementProblem, ReducedProblem
from ..optimiser.bitsets import values_with_each
from ..optimiser.limits import fitting
from ..setting import Setting
from ..visibility.build import N_POINTS
from ..visibility.casting import build_world, cast_sight
from ..visibility.sensing import Sensing, build_sensing, has_lidar, reach_m
from .proposals import Places

# ---------- poses at hand


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """Poses that are tried together."""

    candidates: tuple[CandidatePose, ...]  # the poses
    # (n,): row of the grid's pose that each one is, or stands in for: it hangs at the same place,
    # and has the same sensor.
    origin: IntArray
    is_new: NDArray[np.bool_]  # (n,): whether it is not in the grid
    packed: NDArray[np.uint8]  # (n, ceil(n_frames / 8)): detection rows

    def __len__(self) -> int:
        return len(self.candidates)

    def plus(self, other: "Bench") -> "Bench":
        """With other poses behind."""
        return Bench(
            candidates=(*self.candidates, *other.candidates),
            origin=np.concatenate([self.origin, other.origin]),
            is_new=np.concatenate([self.is_new, other.is_new]),
            packed=np.concatenate([self.packed, other.packed]),
        )

    def only(self, rows: IntArray) -> "Bench":
        """Some of the poses, in the order given."""
        return Bench(
            candidates=tuple(self.candidates[row] for row in rows),
            origin=self.origin[rows],
            is_new=self.is_new[rows],
            packed=self.packed[rows],
        )

    def problem(self, grid: PlacementProblem) -> PlacementProblem:
        """The grid's problem on these poses; those that are forced must be among them."""
        return replace(
            grid,
            table=DetectionTable(
                pose_ids=tuple(candidate.id for candidate in self.candidates),
                axis=grid.table.axis,
                packed=self.packed,
            ),
            limits=_limits_of(grid.limits, self.origin, self.is_new),
        )


def grid_bench(
    problem: PlacementProblem, candidates: Sequence[CandidatePose], rows: IntArray
) -> Bench:
    """Some poses of a grid."""
    return Bench(
        candidates=tuple(candidates[row] for row in rows),
        origin=np.asarray(rows, dtype=np.int64),
        is_new=np.zeros(len(rows), dtype=bool),
        packed=problem.table.packed[rows],
    )


def add_poses(
    bench: Bench,
    problem: PlacementProblem,
    proposals: Sequence[tuple[int, CandidatePose]],
    *,
    places: Places,
    build_rows: Callable[[Sequence[CandidatePose]], NDArray[np.uint8]],
) -> Bench:
    """A bench with new poses behind those that it has; equal ids mean equal poses.

    `proposals` are poses and the rows of the grid that they stand for.
    """
    known = {candidate.id for candidate in bench.candidates}
    asked = {pose.id: (origin, pose) for origin, pose in proposals if pose.id not in known}
    old = [places.row_of[name] for name in asked if name in places.row_of]
    new = [item for name, item in asked.items() if name not in places.row_of]
    poses = tuple(pose for _, pose in new)
    if old:
        bench = bench.plus(grid_bench(problem, places.candidates, np.array(old)))
    if poses:
        added = Bench(
            candidates=poses,
            origin=np.array([origin for origin, _ in new], dtype=np.int64),
            is_new=np.ones(len(poses), dtype=bool),
            packed=build_rows(poses),
        )
        bench = bench.plus(added)
    return bench


def promising_rows(
    reduced: ReducedProblem, pose_index: Sequence[int], *, n_best: int, n_per_site: int
) -> IntArray:
    """Rows of the full problem's table that stay in the race for a place, ascending.

    For each unit these are the `n_best` poses beside all others, and the `n_per_site` best of each
    site, so that every site stays in the race. The chosen poses and all that are forced are among
    them.
    """
    chosen = np.flatnonzero(np.isin(reduced.pose_index, pose_index))
    found = [np.asarray(pose_index, dtype=np.int64)]
    found.append(reduced.pose_index[reduced.limits.is_forced])
    for position in np.flatnonzero(~reduced.limits.is_forced[chosen]):
        others = np.delete(chosen, position)
        fits = np.flatnonzero(fitting(reduced.limits, others))
        values = values_with_each(reduced, others)[fits]
        best_first = fits[np.lexsort(-values.gains.T[::-1])]
        site = reduced.limits.site_index[best_first]
        first_of_sites = [best_first[site == one][:n_per_site] for one in np.unique(site)]
        found += [reduced.pose_index[rows] for rows in (best_first[:n_best], *first_of_sites)]
    rows: IntArray = np.unique(np.concatenate(found))
    return rows


def _limits_of(limits: Limits, origin: IntArray, is_new: NDArray[np.bool_]) -> Limits:
    part = limits.of_poses(origin)
    return replace(part, is_forced=part.is_forced & ~is_new)


# ---------- detection rows of new poses


RowBuilder = Callable[[Sequence[CandidatePose]], NDArray[np.uint8]]
"""Packed rows of candidate poses on the frame axis of a problem, (n_poses, ceil(n_frames / 8))."""

_KEPT_MOUNTS = 16  # some ten megabytes each at the study's junction


class RayRows:
    """Rows of candidate poses at mounts that are remembered.

    The rows are those of :func:`placement.visibility.build_detection_table`. What takes its time
    there, and is spared here when a mount comes again, are the rays: another direction or field of
    view only projects the points that they reach.
    """

    def __init__(self, setting: Setting, *, seed: int = 0, workers: int = 1) -> None:
        self.detector = setting.table_detector
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
            packed[row] = sensing.packed([candidates[row]])[0]

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
        sight = cast_sight(
            self.world,
            position_m,
            near_m=near_m,
            max_distance_m=needed_m,
            for_lidar=has_lidar(candidates),
        )
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
    is_lidar = isinstance(candidate.sensor, LidarModel)
    return (*candidate.pose.position_m.tolist(), candidate.sensor.near_m, is_lidar)


# ---------- moves


_SAME_PLACE_M = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Move:
    """One unit before and after."""

    before: CandidatePose | None  # None: the unit is new
    after: CandidatePose | None  # None: the unit is gone

    @property
    def is_same_place(self) -> bool:
        """Whether the same sensor still hangs at the same place, maybe higher or lower."""
        before, after = self.before, self.after
        return before is not None and after is not None and is_same_place(before, after)

    @property
    def _both(self) -> tuple[CandidatePose, CandidatePose]:
        """The unit before and after, where it is neither new nor gone."""
        assert self.before is not None
        assert self.after is not None
        return self.before, self.after

    @property
    def turn_deg(self) -> float:
        """Change of the yaw, counter-clockwise."""
        before, after = self._both
        return float(wrap_deg(after.pose.yaw_deg - before.pose.yaw_deg))

    @property
    def tilt_deg(self) -> float:
        """Change of the pitch, up."""
        before, after = self._both
        return after.pose.pitch_deg - before.pose.pitch_deg

    @property
    def lift_m(self) -> float:
        """Change of the height, up."""
        before, after = self._both
        return float(after.pose.position_m[2] - before.pose.position_m[2])

    @property
    def zoom_deg(self) -> float:
        """Change of the horizontal field of view; 0 for what has no lens."""
        old, new = (unit.sensor for unit in self._both)
        if not isinstance(old, CameraModel) or not isinstance(new, CameraModel):
            return 0.0
        return new.horizontal_fov_deg - old.horizontal_fov_deg


def is_same_place(one: CandidatePose, other: CandidatePose) -> bool:
    """Whether two poses are of one sensor model at one place, whatever their heights."""
    away_m = one.pose.position_m[:2] - other.pose.position_m[:2]
    return one.sensor.name == other.sensor.name and bool(np.hypot(*away_m) <= _SAME_PLACE_M)


def pair_units(
    before: Sequence[CandidatePose], after: Sequence[CandidatePose]
) -> list[tuple[int | None, int | None]]:
    """Pairs of a unit of a layout and the pose of another one that took its place.

    Every index stands in them once: the old units in their order, then what is new.
    """
    distances = sorted(
        (_distance_deg(one, other), old, new)
        for old, one in enumerate(before)
        for new, other in enumerate(after)
        if is_same_place(one, other)
    )
    new_of: dict[int, int] = {}
    for _, old, new in distances:
        if old not in new_of and new not in new_of.values():
            new_of[old] = new
    pairs: list[tuple[int | None, int | None]] = [
        (old, new_of.get(old)) for old in range(len(before))
    ]
    return pairs + [(None, new) for new in range(len(after)) if new not in new_of.values()]


def rename(
    before: Layout, poses: Sequence[CandidatePose], *, named: Sequence[str], name: str
) -> tuple[Layout, tuple[Move, ...]]:
    """A layout of the poses, whose units keep their names where they stay in place, and the moves.

    `before` has the names that are kept. `named` are names that mean one pose and no other, such as
    those of an existing layout: another pose gets another name. The units come in the order of the
    old ones, new ones behind; the moves leave out units that stayed as they were.
    """
    taken = {unit.id for unit in before.units}
    free = (unit_id for unit_id in (f"U{n}" for n in count(1)) if unit_id not in taken)
    moves = []
    for old, new in pair_units(before.units, poses):
        unit = None if old is None else before.units[old]
        if new is None:
            moves.append(Move(before=unit, after=None))
            continue
        keeps_name = unit is not None and (unit.id not in named or unit.id == poses[new].id)
        unit_id = unit.id if unit is not None and keeps_name else next(free)
        moves.append(Move(before=unit, after=replace(poses[new], id=unit_id)))
    units = tuple(move.after for move in moves if move.after is not None)
    return Layout(name=name, units=units), tuple(m for m in moves if not _is_unchanged(m))


def _distance_deg(one: CandidatePose, other: CandidatePose) -> float:
    turn = float(wrap_deg(one.pose.yaw_deg - other.pose.yaw_deg))
    return abs(turn) + abs(one.pose.pitch_deg - other.pose.pitch_deg)


def _is_unchanged(move: Move) -> bool:
    return move.is_same_place and not any(
        (move.turn_deg, move.tilt_deg, move.lift_m, move.zoom_deg)
    )
