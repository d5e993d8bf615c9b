"""Refinement: poses between those of the grid.

The units of a layout are turned, tilted, zoomed and lifted.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, product

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray
from geometry.clock import now_s
from geometry.errors import InputError, refuse
from geometry.phrases import Phrase
from geometry.poses import Pose, wrap_deg
from geometry.scene import Scene, Site, containing_instance
from geometry.sensors import CameraModel, with_fov

from .candidates import CandidatePose, is_turn_useless
from .compute import DEFAULT_COMPUTE, Compute
from .detection_table import DetectionTable
from .layout import Certificate, Layout
from .live import LiveTable
from .optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    Solution,
    is_feasible,
    presolve,
    solve_placement,
)
from .optimiser.problem import Objective, improves, objective_values
from .optimiser.solve import build_stage
from .pipeline import Placement
from .setting import Setting


def certify(
    values: Mapping[Objective, float], certificate: Certificate, solver: Phrase
) -> Certificate:
    """Certificate of a set that is as good as another's layout or better.

    It has the bounds of that certificate. A bound holds for all sets that are as
    good in the stages before as the certificate's layout, and so for those that are
    as good as this one. `solver` is the new certificate's text about it.
    """
    # Each stage has the new value and the proven bound.
    stages = (
        build_stage(name, value, proven.bound, proven.seconds)
        for (name, value), proven in zip(
            values.items(), certificate.stages, strict=True
        )
    )
    return Certificate(stages=tuple(stages), solver=solver)


# ---------- places, and the steps from one pose to its neighbours
# Of metres and degrees: finer than anyone mounts.
_DIGITS = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovablePlaces:
    """Where poses of a grid may be moved to.

    Attributes
    ----------
    scene : Scene
        Its sites say how high.
    candidates : tuple of CandidatePose
        The grid.
    is_free : (n,) bool
        Which of them stand for poses that may be chosen: not forbidden, and not
        existing.
    row_of : mapping of str to int
        Row of every id.
    """

    scene: Scene
    candidates: tuple[CandidatePose, ...]
    is_free: BoolArray
    row_of: Mapping[str, int]

    def height_range_m(self, origin: int) -> tuple[float, float]:
        """Lowest and highest position for a row of the grid.

        They are heights in the world frame, in metres.
        """
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


def build_places(
    scene: Scene, candidates: Sequence[CandidatePose], limits: Limits
) -> MovablePlaces:
    """Where poses may be moved to under limits."""
    return MovablePlaces(
        scene=scene,
        candidates=tuple(candidates),
        is_free=~(limits.is_forced | limits.is_forbidden),
        row_of={candidate.id: row for row, candidate in enumerate(candidates)},
    )


def moved(
    places: MovablePlaces,
    origin: int,
    *,
    height_m: float,
    yaw_deg: float,
    pitch_deg: float,
    fov_deg: float | None = None,
) -> CandidatePose | None:
    """Pose of a row of the grid, moved and turned.

    None if it would be inside something. Height, pitch and field of view (by
    default the grid's) are brought into their ranges. The pose's id says where it
    is mounted and how it looks.
    """
    # Height, angles and field of view are rounded and brought into their ranges.
    grid = places.candidates[origin]
    low_m, high_m = places.height_range_m(origin)
    height_m = float(np.clip(round(height_m, _DIGITS), low_m, high_m))
    yaw_deg = round(float(wrap_deg(round(yaw_deg, _DIGITS))), _DIGITS)
    pitch_deg = float(np.clip(round(pitch_deg, _DIGITS), -90.0, 90.0))
    position_m = np.append(grid.pose.position_m[:2], height_m)
    is_old = height_m == grid.pose.position_m[2]
    if not is_old and containing_instance(places.scene, position_m) is not None:
        return None
    sensor = grid.sensor
    lens = ""
    if isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None:
        if fov_deg is None:
            asked = sensor.horizontal_fov_deg
        else:
            asked = fov_deg
        fov_deg = float(np.clip(round(asked, _DIGITS), *sensor.fov_range_deg))
        sensor = with_fov(sensor, fov_deg, grid.id)
        lens = f"/{fov_deg:g}"
    # As the grid names its poses: the same name is the same pose.
    site = places.site_of(origin)
    is_of_grid = site is not None and grid.id.startswith(f"{site.id}/")
    if is_of_grid:
        name = grid.site_id
    else:
        name = grid.id
    if site is None:
        above_m = height_m
    else:
        above_m = height_m - float(site.position_m[2])
    return replace(
        grid,
        id=f"{name}/{above_m:g}m/{yaw_deg:g}/{pitch_deg:g}/{sensor.name}{lens}",
        pose=Pose(position_m=position_m, yaw_deg=yaw_deg, pitch_deg=pitch_deg),
        sensor=sensor,
    )


STEPS_DEG = (128.0, 64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 0.5)
"""Of yaw and pitch; and, in per cent, of the field of view of a varifocal lens."""


def _turned(
    unit: CandidatePose, origin: int, places: MovablePlaces
) -> list[CandidatePose]:
    """Neighbours of a pose in yaw, pitch and zoom, each id once."""
    sensor = unit.sensor
    has_zoom = isinstance(sensor, CameraModel) and sensor.fov_range_deg is not None
    poses = []
    # All steps in yaw and pitch; a zoom changes neither.
    for step_deg, turn_sign, tilt_sign, zoom_sign in product(
        STEPS_DEG, *[(-1, 0, 1)] * 3
    ):
        if zoom_sign and (turn_sign or tilt_sign or not has_zoom):
            continue
        pitch_deg = unit.pose.pitch_deg + tilt_sign * step_deg
        if turn_sign and is_turn_useless(sensor, pitch_deg=pitch_deg):
            continue
        turn = {
            "yaw_deg": unit.pose.yaw_deg + turn_sign * step_deg,
            "pitch_deg": pitch_deg,
        }
        fov_deg = np.exp(0.01 * step_deg * zoom_sign) * sensor.horizontal_fov_deg
        poses.append(
            moved(places, origin, **_as_it_is(unit) | turn | {"fov_deg": fov_deg})
        )
    return _others(poses, unit)


# Of the height: each costs rays of its own.
LIFTS_M = (1.0, 0.5, 0.25, 0.1)


def _lifted(
    unit: CandidatePose, origin: int, places: MovablePlaces
) -> list[CandidatePose]:
    """The same pose higher and lower on its site, each id once."""
    # Everything but the height stays.
    own = _as_it_is(unit)
    lifts_m = (sign * size_m for size_m in LIFTS_M for sign in (-1.0, 1.0))
    heights_m = (own["height_m"] + lift_m for lift_m in lifts_m)
    poses = [
        moved(places, origin, **own | {"height_m": height_m}) for height_m in heights_m
    ]
    return _others(poses, unit)


def _as_it_is(unit: CandidatePose) -> dict[str, float]:
    """How a unit is mounted and looks, as :func:`moved` takes it."""
    return {
        "height_m": float(unit.pose.position_m[2]),
        "yaw_deg": unit.pose.yaw_deg,
        "pitch_deg": unit.pose.pitch_deg,
        "fov_deg": unit.sensor.horizontal_fov_deg,
    }


def _others(
    poses: Iterable[CandidatePose | None], unit: CandidatePose
) -> list[CandidatePose]:
    """Poses that are not the unit itself, each id once."""
    return [
        *{
            one.id: one for one in poses if one is not None and one.id != unit.id
        }.values()
    ]


# ---------- the search
# Whose rays are cached, some ten megabytes each at the study's junction.
_MAX_MOUNTS = 16
# Of the time: for the whole grid, when the search is over.
_PROOF_SHARE = 0.4
_LEAST_SOLVER_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tried:
    """A pose at hand.

    Attributes
    ----------
    candidate : CandidatePose
        The pose.
    origin : int
        Row of the grid's pose that it is, or stands in for: same place, same
        sensor.
    packed : (ceil(n_frames / 8),) uint8
        Its row of a detection table.
    """

    candidate: CandidatePose
    origin: int
    packed: NDArray[np.uint8]


class _Search:
    """Looks for better poses of the units of a placement, at their places."""

    def __init__(
        self,
        setting: Setting,
        placement: Placement,
        candidates: Sequence[CandidatePose],
        *,
        compute: Compute,
        end_s: float,
    ) -> None:
        self.grid = placement.problem
        self.places = build_places(setting.scene, candidates, self.grid.limits)
        self.live = LiveTable(setting, compute=compute, max_mounts=_MAX_MOUNTS)
        self.end_s = end_s
        # Poses that are not of the grid, by id.
        self.new: dict[str, _Tried] = {}
        self.units = [self._of_grid(row) for row in placement.pose_index]
        self.values = objective_values(self.grid, placement.pose_index)

    def turn(self) -> None:
        """Compass search over yaw, pitch and field of view, then height, unit by unit.

        In the end no step of any unit alone improves the set, unless time was up. All
        steps are tried at once in place of a shrinking one (Kolda, Lewis, Torczon,
        "Optimization by direct search", SIAM Review 45, 2003, section 3): what a set is
        worth is a step function here, so that a larger step may improve where smaller
        ones change nothing.
        """
        position = 0
        n_settled = 0
        # Go round the units until none improves, or the time is up.
        while n_settled < len(self.units) and now_s() < self.end_s:
            unit = self.units[position]
            if self.places.is_free[unit.origin] and any(
                self._take_best(
                    position, steps(unit.candidate, unit.origin, self.places)
                )
                for steps in (_turned, _lifted)
            ):
                n_settled = 0
            else:
                n_settled += 1
                position = (position + 1) % len(self.units)

    def _take_best(self, position: int, poses: Sequence[CandidatePose]) -> bool:
        """Exchange one unit for the best of some poses; whether that improves."""
        # The other units stay; each trial joins them in turn.
        others = [unit for index, unit in enumerate(self.units) if index != position]
        taken = {unit.candidate.id for unit in others}
        tried = self._look(
            self.units[position].origin,
            [pose for pose in poses if pose.id not in taken],
        )
        # Only those in question: a problem on the whole grid takes longer to put
        # together.
        problem = self._problem([*others, *tried])
        is_better = False
        for index, one in enumerate(tried, start=len(others)):
            rows = [*range(len(others)), index]
            values = objective_values(problem, rows)
            if improves(values, self.values) and is_feasible(problem, rows):
                self.units[position] = one
                self.values = values
                is_better = True
        return is_better

    def _look(self, origin: int, poses: Sequence[CandidatePose]) -> list[_Tried]:
        """Poses with their rows, from the grid or computed anew."""
        row_of = self.places.row_of
        # Rows of the table for poses that are new.
        unknown = [
            pose for pose in poses if pose.id not in row_of and pose.id not in self.new
        ]
        if unknown:
            for pose, packed in zip(unknown, self.live.packed(unknown), strict=True):
                self.new[pose.id] = _Tried(candidate=pose, origin=origin, packed=packed)
        return [
            self._of_grid(row_of[pose.id]) if pose.id in row_of else self.new[pose.id]
            for pose in poses
        ]

    def _of_grid(self, row: int) -> _Tried:
        """Pose of a row of the grid, with its row of the table."""
        return _Tried(
            candidate=self.places.candidates[row],
            origin=row,
            packed=self.grid.table.packed[row],
        )

    def _problem(self, poses: Iterable[_Tried]) -> PlacementProblem:
        """The grid's problem on some poses, which include the forced ones."""
        poses = list(poses)
        # A new pose has the limits of the grid's pose that it stands in for.
        limits = self.grid.limits.of_poses(
            np.array([one.origin for one in poses], dtype=np.int64)
        )
        is_new = np.array([one.candidate.id not in self.places.row_of for one in poses])
        table = DetectionTable(
            pose_ids=tuple(one.candidate.id for one in poses),
            axis=self.grid.table.axis,
            packed=np.stack([one.packed for one in poses]),
        )
        limits = replace(limits, is_forced=limits.is_forced & ~is_new)
        return replace(self.grid, table=table, limits=limits)

    def prove(
        self, placement: Placement, solver: Effort, *, end_s: float
    ) -> "tuple[Placement, tuple[CandidatePose, ...], tuple[Move, ...]] | None":
        """Best set among the grid and all new poses, with bounds and moves.

        None where nothing could be said in time of how good it is.
        """
        # Solve the problem on the grid and on all poses tried.
        everyone = [
            *map(self._of_grid, range(self.grid.table.n_poses)),
            *self.new.values(),
        ]
        problem = self._problem(everyone)
        row_of = {name: row for row, name in enumerate(problem.table.pose_ids)}
        rows = [row_of[unit.candidate.id] for unit in self.units]
        limit_s = min(max(end_s - now_s(), _LEAST_SOLVER_S), solver.time_limit_s)
        try:
            solution: Solution = solve_placement(
                problem, effort=replace(solver, time_limit_s=limit_s)
            )
        except InputError:
            # the set at hand meets all wishes, but time was too short to find one
            return None
        # The optimiser may find a better set than the steps did.
        found = objective_values(problem, solution.pose_index)
        if improves(found, self.values) and is_feasible(problem, solution.pose_index):
            rows = list(solution.pose_index)
            self.values = found
        candidates = tuple(one.candidate for one in everyone)
        rows = sorted(rows)
        poses = [candidates[row] for row in rows]
        layout, moves = rename(
            placement.layout,
            poses,
            named=[candidate.id for candidate in self.places.candidates],
            name=f"refined-{len(rows)}",
        )
        in_order = (
            new
            for _, new in pair_units(placement.layout.units, poses)
            if new is not None
        )
        # As the layout has its units.
        pose_index = tuple(rows[new] for new in in_order)
        # The certificate says on which poses it rests.
        certificate = certify(
            self.values,
            solution.certificate,
            Phrase(
                "{solver}, over {n} grid candidates and {n_tried} further poses tried",
                solver=solution.certificate.solver,
                n=self.grid.table.n_poses,
                n_tried=len(self.new),
            ),
        )
        refined = replace(
            placement,
            layout=layout,
            certificate=certificate,
            presolve=presolve(problem).statistics,
            problem=problem,
            presolved=None,
            pose_index=pose_index,
            nominal=problem,
            nominal_index=pose_index,
            # Between the poses of the grid there are ever more.
            next_unit=None,
        )
        return refined, candidates, moves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refinement:
    """A layout, and what it was before.

    Attributes
    ----------
    unrefined : Placement
        The one given: its certificate is about the grid alone.
    placement : Placement
        The refined one: its problem's table has the poses tried behind those of
        the grid, and the bounds of its certificate are about these, not about
        all poses in between. The one given, where nothing better was found.
    candidates : tuple of CandidatePose
        The rows of that table.
    before, after : mapping of Objective to float
        In the order of the problem's stages; `after` is `before` or better.
    moves : tuple of Move
        What became of each unit; empty where nothing better was found.
    n_tried : int
        New poses whose detections were computed.
    seconds : float
        Time spent. [s]
    """

    unrefined: Placement
    placement: Placement
    candidates: tuple[CandidatePose, ...]
    before: Mapping[Objective, float]
    after: Mapping[Objective, float]
    moves: "tuple[Move, ...]"
    n_tried: int
    seconds: float

    @property
    def is_improved(self) -> bool:
        """True if a better layout was found."""
        return bool(self.moves)


def refine(
    setting: Setting,
    placement: Placement,
    candidates: Sequence[CandidatePose],
    *,
    time_limit_s: float = 60.0,
    solver: Effort | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Refinement:
    """Look for a better layout between the poses of a grid.

    Units of the placement that are not forced are turned, tilted, zoomed and lifted in
    small steps where they are, until no step of one unit improves anything; then the
    problem is solved again on the grid, whose `candidates` are the rows of the
    placement's table, and all poses tried. Six tenths of `time_limit_s` are for the
    steps, the rest for the proof; results are the same again only where it is not
    reached. `solver` is the optimiser's effort; `compute` has the table's seed. The
    result is never worse. Raises InputError: the table is not that of the candidates,
    or of sampled worlds; the time is not positive.
    """
    if not time_limit_s > 0.0:
        raise InputError("time_limit_s", time_limit_s, "seconds, more than 0")
    started_s = now_s()
    table = placement.problem.table
    if table.pose_ids != tuple(candidate.id for candidate in candidates):
        refuse("candidates", "other poses", "the rows of the placement's table")
    if table.axis.run_ids != setting.axis.run_ids:
        refuse("refine", "a table of sampled worlds", "a table of the runs as planned")
    # Steps first; the proof has the rest of the time.
    search = _Search(
        setting,
        placement,
        candidates,
        compute=compute,
        end_s=started_s + (1.0 - _PROOF_SHARE) * time_limit_s,
    )
    before = search.values
    compute.progress(Phrase("refine: steps"), 0, 0)
    search.turn()
    proven = None
    after = before
    if improves(search.values, before):
        compute.progress(Phrase("refine: proof"), 0, 0)
        if solver is None:
            effort = Effort()
        else:
            effort = solver
        proven = search.prove(placement, effort, end_s=started_s + time_limit_s)
    if proven is not None:
        after = search.values
    refined, all_candidates, moves = proven or (placement, tuple(candidates), ())
    return Refinement(
        unrefined=placement,
        placement=refined,
        candidates=all_candidates,
        before=before,
        after=after,
        moves=moves,
        n_tried=len(search.new),
        seconds=now_s() - started_s,
    )


# ---------- moves
_SAME_PLACE_M = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Move:
    """One unit before and after.

    Attributes
    ----------
    before : CandidatePose, optional
        None: the unit is new.
    after : CandidatePose, optional
        None: the unit is gone.
    """

    before: CandidatePose | None
    after: CandidatePose | None

    @property
    def is_same_place(self) -> bool:
        """True if the same sensor is still at the same place, maybe higher or lower."""
        before = self.before
        after = self.after
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
    """True if two poses are of one sensor model at one place.

    Heights do not matter.
    """
    away_m = one.pose.position_m[:2] - other.pose.position_m[:2]
    return one.sensor.name == other.sensor.name and bool(
        np.hypot(*away_m) <= _SAME_PLACE_M
    )


def pair_units(
    before: Sequence[CandidatePose], after: Sequence[CandidatePose]
) -> list[tuple[int | None, int | None]]:
    """Pairs of a unit of a layout and the pose of another one that took its place.

    Those that look most alike go together. Every index stands in them once: the old
    units in their order, then what is new.
    """

    def distance_deg(one: CandidatePose, other: CandidatePose) -> float:
        turn = float(wrap_deg(one.pose.yaw_deg - other.pose.yaw_deg))
        return abs(turn) + abs(one.pose.pitch_deg - other.pose.pitch_deg)

    # The pairs that look most alike are taken first.
    distances = sorted(
        (distance_deg(one, other), old, new)
        for old, one in enumerate(before)
        for new, other in enumerate(after)
        if is_same_place(one, other)
    )
    new_of: dict[int, int] = {}
    for _, old, new in distances:
        if old not in new_of and new not in new_of.values():
            new_of[old] = new
    left = [(None, new) for new in range(len(after)) if new not in new_of.values()]
    return [*((old, new_of.get(old)) for old in range(len(before))), *left]


def rename(
    before: Layout, poses: Sequence[CandidatePose], *, named: Sequence[str], name: str
) -> tuple[Layout, tuple[Move, ...]]:
    """Name the poses of a new layout, and list what moved.

    Units that stay in place keep their names. Names of `named` mean one pose and no
    other, such as those of an existing layout. Units come in the order of `before`,
    new ones behind; the moves leave out units that stayed as they were.
    """
    taken = {unit.id for unit in before.units}
    free = (name for name in map("U{}".format, count(1)) if name not in taken)
    moves = []
    # A unit that stays in place keeps its name.
    for old, new in pair_units(before.units, poses):
        if old is None:
            unit = None
        else:
            unit = before.units[old]
        if new is None:
            moves.append(Move(before=unit, after=None))
            continue
        keeps_name = unit is not None and (
            unit.id not in named or unit.id == poses[new].id
        )
        if unit is not None and keeps_name:
            unit_id = unit.id
        else:
            unit_id = next(free)
        moves.append(Move(before=unit, after=replace(poses[new], id=unit_id)))
    units = tuple(move.after for move in moves if move.after is not None)
    # Units that did not move at all are left out of the moves.
    changed = (
        move
        for move in moves
        if not move.is_same_place
        or any((move.turn_deg, move.tilt_deg, move.lift_m, move.zoom_deg))
    )
    return Layout(name=name, units=units), tuple(changed)
