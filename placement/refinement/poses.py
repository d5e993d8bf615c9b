"""Promising poses, old and new, and the placement problem on them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, Site, containing_instance
from geometry.sensors import CameraModel, with_fov
from geometry.terrain import on_ground
from scenarios.runs import FrameAxis, Run

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..layout import Layout
from ..optimiser import Limits, PlacementProblem, ReducedProblem, run_margins_s
from ..optimiser.bitsets import values_with_each
from ..optimiser.limits import fitting

# ---------- weak spots


LOOK_BACK_S = 2.0
"""Frames so long before the deadline, or before the confirmation so far, are worth seeing."""
_SMALL_SHARE = 0.1  # of the avoided runs, those with the smallest margins


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WeakSpots:
    """Frames that are worth seeing better."""

    frame_index: IntArray  # (n,): frames of the axis
    # (n,): how often each is to be aimed at; they sum to 1, or there is no frame at all.
    probability: FloatArray
    vru_m: FloatArray  # (n, 3): middle of the VRU's body [m]


def find_weak_spots(
    problem: PlacementProblem, pose_index: Sequence[int], runs: Sequence[Run]
) -> WeakSpots:
    """Frames in which a layout should see more.

    `runs`: those of the table's axis; the axis may repeat them, world after world. Returns: of the
    runs that are not avoided; of those that are lost when one unit fails; of those with the
    smallest margins; and of all: each of these groups, where it is not empty, is aimed at as often
    as the others, and within it each run by its weight.
    """
    axis, rule = problem.table.axis, problem.rule
    counts = (axis.weight > 0.0) & np.isfinite(axis.last_brake_time_s)
    margin = run_margins_s(problem, pose_index)
    latest_s = axis.last_brake_time_s - rule.latency_s - np.where(np.isfinite(margin), margin, 0.0)
    n_frames = np.diff(axis.run_start)
    frame_run = np.repeat(np.arange(axis.n_runs), n_frames)
    before_s = latest_s[frame_run] - axis.time_s
    is_near = (before_s >= 0.0) & (before_s <= LOOK_BACK_S)
    probability = np.zeros(axis.n_frames)
    groups = [group & counts for group in _weak_runs(problem, pose_index, margin)]
    for group in groups:
        frames = np.flatnonzero(is_near & group[frame_run])
        share = axis.weight / np.maximum(np.bincount(frame_run[frames], minlength=axis.n_runs), 1)
        if len(frames):
            part = share[frame_run[frames]]
            probability[frames] += part / part.sum()
    frames = np.flatnonzero(probability)
    return WeakSpots(
        frame_index=frames,
        probability=probability[frames] / max(probability.sum(), 1.0e-300),
        vru_m=_vru_positions_m(runs, axis, frame_run)[frames],
    )


def _weak_runs(
    problem: PlacementProblem, pose_index: Sequence[int], margin: FloatArray
) -> list[BoolArray]:
    """Runs of each group, (n_runs,) each."""
    is_avoided = margin > -np.inf
    is_lost = np.zeros_like(is_avoided)
    for unit in range(len(pose_index)):
        left = [pose for position, pose in enumerate(pose_index) if position != unit]
        is_lost |= is_avoided & ~(run_margins_s(problem, left) > -np.inf)
    groups = [~is_avoided, is_lost, np.ones_like(is_lost)]
    counts = is_avoided & (problem.table.axis.weight > 0.0)
    if counts.any():
        groups.append(is_avoided & (margin <= np.quantile(margin[counts], _SMALL_SHARE)))
    return groups


def _vru_positions_m(runs: Sequence[Run], axis: FrameAxis, frame_run: IntArray) -> FloatArray:
    """Middle of the VRU's body in every frame, (n_frames, 3)."""
    ground = np.concatenate([on_ground(run.vru_position_m, run.terrain) for run in runs])
    heights = [0.5 * run.encounter.vru.height_m for run in runs]
    height = np.repeat(heights, [len(run.time_s) for run in runs])
    ground[:, 2] += height
    return np.tile(ground, (axis.n_frames // len(ground), 1))


# ---------- new poses: around the chosen ones, and aimed at what they see too late


_DIGITS = 2  # of metres and degrees: finer than anyone mounts
_N_HEIGHTS = 2  # new ones per unit and round, in addition to its own
_N_AT_OWN_HEIGHTS = 96  # per round, of all units: they need no new rays
_PER_NEW_HEIGHT = 12
_N_AIMED_MOUNTS = 4  # per round
_PER_AIMED_MOUNT = 8
_LARGEST_TURN_DEG = 16.0
_LARGEST_LIFT_M = 2.0
_LARGEST_LOG_ZOOM = 0.4
_N_HALVINGS = 5  # the smallest steps are so many times halved
_N_LIFT_HALVINGS = 3  # heights cost new rays: no steps of a few centimetres
_AIM_SD_DEG = 8.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Where poses of a grid may be moved to."""

    scene: Scene  # its sites say how high
    candidates: tuple[CandidatePose, ...]  # the grid
    # (n,): which of them stand for poses that may be chosen: not forbidden, and not existing.
    is_free: BoolArray
    site_index: IntArray  # (n,): equal for poses of one site
    row_of: Mapping[str, int]  # row of every id

    def height_range_m(self, origin: int) -> tuple[float, float]:
        """Lowest and highest position for a row of the grid, in the world frame, in metres."""
        pose = self.candidates[origin]
        own_m = float(pose.pose.position_m[2])
        site = self.site_of(origin)
        if site is None:
            return own_m, own_m
        low_m, high_m = site.position_m[2] + site.height_range_m
        return min(float(low_m), own_m), max(float(high_m), own_m)

    def site_of(self, origin: int) -> Site | None:
        """Site of the scene that carries a grid's pose, if there is one."""
        name = self.candidates[origin].site_id
        return next((site for site in self.scene.sites if site.id == name), None)


def build_places(scene: Scene, candidates: Sequence[CandidatePose], limits: Limits) -> Places:
    """Where poses may be moved to under limits."""
    return Places(
        scene=scene,
        candidates=tuple(candidates),
        is_free=~(limits.is_forced | limits.is_forbidden),
        site_index=limits.site_index,
        row_of={candidate.id: row for row, candidate in enumerate(candidates)},
    )


def moved(
    places: Places,
    origin: int,
    *,
    height_m: float,
    yaw_deg: float,
    pitch_deg: float,
    fov_deg: float | None = None,
) -> CandidatePose | None:
    """Replacement for a row of the grid, moved and turned; None if it would be inside something.

    The height is brought into the site's range, the pitch into -90 .. 90 degrees, and the field of
    view into the range of a varifocal lens; it is that of the grid by default. The pose's id says
    where it is mounted and how it looks.
    """
    grid = places.candidates[origin]
    low_m, high_m = places.height_range_m(origin)
    height_m = float(np.clip(round(height_m, _DIGITS), low_m, high_m))
    yaw_deg = round(float(wrap_deg(round(yaw_deg, _DIGITS))), _DIGITS)
    pitch_deg = float(np.clip(round(pitch_deg, _DIGITS), -90.0, 90.0))
    position_m = np.append(grid.pose.position_m[:2], height_m)
    is_old = height_m == grid.pose.position_m[2]
    if not is_old and containing_instance(places.scene, position_m) is not None:
        return None
    sensor, lens = grid.sensor, ""
    if isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None:
        asked = sensor.horizontal_fov_deg if fov_deg is None else fov_deg
        fov_deg = float(np.clip(round(asked, _DIGITS), *sensor.fov_range_deg))
        sensor, lens = with_fov(sensor, fov_deg, grid.id), f"/{fov_deg:g}"
    # As the grid names its poses: the same name is the same pose.
    site = places.site_of(origin)
    is_of_grid = site is not None and grid.id.startswith(f"{site.id}/")
    name = grid.site_id if is_of_grid else grid.id
    above_m = height_m if site is None else height_m - float(site.position_m[2])
    return replace(
        grid,
        id=f"{name}/{above_m:g}m/{yaw_deg:g}/{pitch_deg:g}/{sensor.name}{lens}",
        pose=Pose(position_m=position_m, yaw_deg=yaw_deg, pitch_deg=pitch_deg),
        sensor=sensor,
    )


def around(
    places: Places,
    chosen: Sequence[tuple[int, CandidatePose]],
    rng: np.random.Generator,
    *,
    spread: float,
) -> list[tuple[int, CandidatePose]]:
    """Poses around the chosen ones, with the rows of the grid that they stand for.

    `chosen` has the row of the grid that each chosen unit stands for, and the unit; only free ones
    are moved. All steps are multiplied by `spread`, which is 1 at first and less in later rounds.
    """
    found = []
    free = [(origin, unit) for origin, unit in chosen if places.is_free[origin]]
    for origin, unit in free:
        own_m = float(unit.pose.position_m[2])
        heights_m = [own_m] * max(_N_AT_OWN_HEIGHTS // len(free), _PER_NEW_HEIGHT)
        if np.ptp(places.height_range_m(origin)) > 0.0:
            lifts_m = _steps(rng, _N_HEIGHTS, spread * _LARGEST_LIFT_M, _N_LIFT_HALVINGS)
            heights_m += np.repeat(own_m + lifts_m, _PER_NEW_HEIGHT).tolist()
        turns_deg, tilts_deg = _steps(rng, (2, len(heights_m)), spread * _LARGEST_TURN_DEG)
        zooms = np.exp(_steps(rng, len(heights_m), spread * _LARGEST_LOG_ZOOM))
        follows = rng.uniform(size=len(heights_m))
        for height_m, turn_deg, tilt_deg, zoom, follow in zip(
            heights_m, turns_deg, tilts_deg, zooms, follows, strict=True
        ):
            pitch_deg = unit.pose.pitch_deg
            # Between the same pitch and the same point of the road in the middle of the image.
            same_point_deg = _pitch_to_same_point_deg(places, origin, unit, height_m)
            pose = moved(
                places,
                origin,
                height_m=height_m,
                yaw_deg=unit.pose.yaw_deg + turn_deg,
                pitch_deg=pitch_deg + follow * (same_point_deg - pitch_deg) + tilt_deg,
                fov_deg=zoom * unit.sensor.horizontal_fov_deg,
            )
            found.append((origin, pose))
    return [(origin, pose) for origin, pose in found if pose is not None]


def aimed(
    places: Places, table: DetectionTable, spots: WeakSpots, rng: np.random.Generator
) -> list[tuple[int, CandidatePose]]:
    """Poses that are aimed at weak spots, with the rows of the grid that they stand for.

    A site from which some pose of the grid's table sees a spot is preferred to one from which none
    does.
    """
    free = np.flatnonzero(places.is_free)
    found: list[tuple[int, CandidatePose | None]] = []
    if not len(spots.frame_index) or not len(free):
        return []
    for first in rng.choice(len(spots.frame_index), size=_N_AIMED_MOUNTS, p=spots.probability):
        frame = spots.frame_index[first]
        sees = (table.packed[free, frame // 8] >> (frame % 8)) & 1 == 1
        sites = np.unique(places.site_index[free[sees] if sees.any() else free])
        of_site = free[places.site_index[free] == rng.choice(sites)]
        origin = int(rng.choice(of_site))
        height_m = rng.uniform(*places.height_range_m(origin))
        others = rng.choice(len(spots.frame_index), size=_PER_AIMED_MOUNT - 1, p=spots.probability)
        for spot in (first, *others):
            position_m = np.append(places.candidates[origin].pose.position_m[:2], height_m)
            yaw_deg, pitch_deg = _direction_deg(spots.vru_m[spot] - position_m)
            aside_deg, above_deg = rng.normal(0.0, _AIM_SD_DEG, 2)
            pose = moved(
                places,
                origin,
                height_m=height_m,
                yaw_deg=yaw_deg + aside_deg,
                pitch_deg=pitch_deg + above_deg,
                fov_deg=_any_fov_deg(places.candidates[origin], rng),
            )
            found.append((origin, pose))
    return [(origin, pose) for origin, pose in found if pose is not None]


def _direction_deg(offset_m: FloatArray) -> tuple[float, float]:
    """Yaw and pitch of a direction."""
    east, north, up = offset_m
    yaw_deg = np.degrees(np.arctan2(north, east))
    return float(yaw_deg), float(np.degrees(np.arctan2(up, np.hypot(east, north))))


def _steps(
    rng: np.random.Generator,
    shape: int | tuple[int, ...],
    largest: float,
    n_halvings: int = _N_HALVINGS,
) -> FloatArray:
    """Normal steps of all sizes: standard deviations are `largest`, halved up to so many times.

    A set of poses that is as good in the first stages may be a narrow ridge: some degrees long in
    yaw, one in pitch. Steps of one size would hardly ever stay on it.
    """
    scale = largest * 0.5 ** rng.uniform(0.0, n_halvings, shape)
    return scale * rng.standard_normal(shape)


def _pitch_to_same_point_deg(
    places: Places, origin: int, unit: CandidatePose, height_m: float
) -> float:
    """Pitch at which a unit at another height looks at the same point of the road."""
    site = places.site_of(origin)
    pitch_deg = unit.pose.pitch_deg
    if site is None or not -90.0 < pitch_deg < 0.0:
        return pitch_deg
    old_m, new_m = (z - float(site.position_m[2]) for z in (unit.pose.position_m[2], height_m))
    return float(np.degrees(np.arctan(np.tan(np.radians(pitch_deg)) * max(new_m, 0.0) / old_m)))


def _any_fov_deg(grid: CandidatePose, rng: np.random.Generator) -> float | None:
    sensor = grid.sensor
    if not isinstance(sensor, CameraModel) or sensor.fov_range_deg is None:
        return None
    return float(np.exp(rng.uniform(*np.log(sensor.fov_range_deg))))


# ---------- poses at hand


RowBuilder = Callable[[Sequence[CandidatePose]], NDArray[np.uint8]]
"""Packed rows of candidate poses on the frame axis of a problem, (n_poses, ceil(n_frames / 8))."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bench:
    """Poses that are tried together."""

    candidates: tuple[CandidatePose, ...]  # the poses
    # (n,): row of the grid's pose that each one is, or stands in for: it is at the same place,
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
    build_rows: RowBuilder,
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

    For each unit these are the `n_best` poses next to all others, and the `n_per_site` best of each
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
    return np.unique(np.concatenate(found))


def _limits_of(limits: Limits, origin: IntArray, is_new: NDArray[np.bool_]) -> Limits:
    part = limits.of_poses(origin)
    return replace(part, is_forced=part.is_forced & ~is_new)


# ---------- moves


_SAME_PLACE_M = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Move:
    """One unit before and after."""

    before: CandidatePose | None  # None: the unit is new
    after: CandidatePose | None  # None: the unit is gone

    @property
    def is_same_place(self) -> bool:
        """True if the same sensor is still at the same place, maybe higher or lower."""
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
    """True if two poses are of one sensor model at one place, whatever their heights."""
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

    `before` has the names that stay. `named` are names that mean one pose and no other, such as
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
