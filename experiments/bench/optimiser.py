"""Speed of the optimiser: against bare HiGHS, against spopt, and on instances of growing size."""

import os
import resource
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.covering.instance import build_covering_instance
from placement.covering.solve import solve_mclp
from placement.detection_table import DetectionTable
from placement.optimiser import (
    Effort,
    Limits,
    PlacementProblem,
    presolve,
    run_margins_s,
    solve_placement,
)
from placement.optimiser.bounds import find_root, polished, run_rows
from placement.optimiser.front import pareto_front
from placement.optimiser.problem import Fusion
from placement.setting import Setting
from placement.visibility.build import build_detection_table
from placement.wishes import Wishes, build_problem
from scenarios.aeb import load_aeb_rule
from scenarios.runs import FrameAxis

from .rays import Figures, in_turn, ratio

# ---------- A made-up placement instance of any size


_ARM_M = 120.0
_KERB_M = 8.0  # of the poles, from the middle of the street
_WIDTH_PX, _MIN_HEIGHT_PX, _VRU_M = 1920, 40, 1.7
_MAX_RANGE_M = 50.0
_ASPECT = 9.0 / 16.0
_DECELERATION_MPS2 = 7.72
_FRAME_RATE_HZ = 10.0
_MISSED_SHARE = 0.03
_PARKED_SHARE = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticSize:
    """How large an instance is; by default 200,000 poses and 50,000 frames.

    Attributes
    ----------
    n_sites : int
        Poles, evenly along both sides of four arms.
    heights_m : tuple of float
        Of each pole. [m]
    n_yaws : int
        Evenly around the circle.
    pitches_deg : tuple of float
        Negative looks down. [deg]
    zooms_deg : tuple of float
        Horizontal fields of view. [deg]
    n_runs, n_frames : int
        Of all runs together; about equally many frames to each.
    """

    n_sites: int = 100
    heights_m: tuple[float, ...] = (5.0, 8.0)
    n_yaws: int = 40
    pitches_deg: tuple[float, ...] = (-4.0, -8.0, -14.0, -22.0, -32.0)
    zooms_deg: tuple[float, ...] = (40.0, 55.0, 70.0, 90.0, 110.0)
    n_runs: int = 1000
    n_frames: int = 50_000

    @property
    def poses_per_mount(self) -> int:
        """Orientations and zooms of one height of one pole."""
        return self.n_yaws * len(self.pitches_deg) * len(self.zooms_deg)

    @property
    def n_poses(self) -> int:
        """Poses of all poles."""
        return self.n_sites * len(self.heights_m) * self.poses_per_mount


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SyntheticInstance:
    """A detection table and its sites.

    Attributes
    ----------
    axis : FrameAxis
        Runs of equal weight.
    packed : (n_poses, ceil(n_frames / 8)) uint8
        V[c, f] as in a :class:`placement.detection_table.DetectionTable`, which copies it.
    site_index : (n_poses,) int
        Pole of every pose.
    site_capacity : (n_sites,) int
        Two units each.
    """

    axis: FrameAxis
    packed: NDArray[np.uint8]
    site_index: IntArray
    site_capacity: IntArray

    def to_table(self) -> DetectionTable:
        """The same as a detection table: needs twice the memory while it is made."""
        ids = tuple(f"pose-{pose}" for pose in range(len(self.packed)))
        return DetectionTable(pose_ids=ids, axis=self.axis, packed=self.packed)

    def __repr__(self) -> str:
        return f"SyntheticInstance({len(self.packed)} poses, {self.axis.n_frames} frames)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Frames:
    """Where VRU and parked van are, frame by frame, (n_frames, 2); metres."""

    vru_m: FloatArray
    van_start_m: FloatArray
    van_end_m: FloatArray
    van_height_m: FloatArray  # (n_frames,), 0: none


def build_synthetic_instance(
    size: SyntheticSize | None = None, *, seed: int = 0, workers: int = 1
) -> SyntheticInstance:
    """Make an instance, pole by pole, directly as bits.

    The default size takes 1.25 GB.
    """
    size = SyntheticSize() if size is None else size
    axis, frames = _drive(size, np.random.default_rng([seed, 0]))
    packed = np.empty((size.n_poses, -(-axis.n_frames // 8)), dtype=np.uint8)
    fill = partial(_fill_mount, packed, size, axis, frames, seed)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, range(size.n_sites * len(size.heights_m))))
    per_site = len(size.heights_m) * size.poses_per_mount
    return SyntheticInstance(
        axis=axis,
        packed=packed,
        site_index=np.repeat(np.arange(size.n_sites), per_site),
        site_capacity=np.full(size.n_sites, 2),
    )


def _drive(size: SyntheticSize, random: np.random.Generator) -> tuple[FrameAxis, _Frames]:
    """Runs that end at an impact on one of the arms."""
    n_runs = size.n_runs
    shares = np.linspace(0, size.n_frames, n_runs + 1).astype(np.int64)
    counts = shares[1:] - shares[:-1]
    spread = random.integers(0, max(1, int(counts.min()) // 3), size=n_runs // 2)
    counts[: 2 * len(spread) : 2] += spread
    counts[1 : 2 * len(spread) : 2] -= spread
    start = np.concatenate([[0], np.cumsum(counts)])
    run = np.repeat(np.arange(n_runs), counts)
    time_s = (np.arange(size.n_frames) - start[1:][run] + 1) / _FRAME_RATE_HZ

    vut_speed_kmh = 5.0 * random.integers(2, 13, size=n_runs).astype(np.float64)
    # In a street's own axes: along it, away from the crossing; and across it, to the left.
    along_m = random.uniform(6.0, 70.0, size=n_runs)
    across_m = random.uniform(-5.0, 5.0, size=n_runs)
    walks_along = random.random(n_runs) < 0.25
    speed_mps = random.uniform(1.0, 4.5, size=n_runs) * random.choice([-1.0, 1.0], size=n_runs)
    velocity = np.where(walks_along, [[1.0], [0.0]], [[0.0], [1.0]]).T * speed_mps[:, None]
    # The van stands beside the lane that the VRU is about to enter.
    van_across_m = np.where(speed_mps > 0.0, across_m - 2.5, across_m + 2.5)
    van_along_m = along_m + random.uniform(1.0, 3.0, size=n_runs)
    van_start = np.column_stack([van_along_m, van_across_m])
    van_end = van_start + np.column_stack([random.uniform(3.0, 7.0, size=n_runs), np.zeros(n_runs)])
    van_height_m = random.uniform(1.4, 3.0, size=n_runs)
    van_height_m[random.random(n_runs) > _PARKED_SHARE] = 0.0

    turn = 0.5 * np.pi * random.integers(0, 4, size=n_runs)
    ahead = np.column_stack([np.cos(turn), np.sin(turn)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])

    def to_world(street_m: FloatArray, index: IntArray) -> FloatArray:
        world_m: FloatArray = street_m[:, :1] * ahead[index] + street_m[:, 1:] * left[index]
        return world_m

    every = np.arange(n_runs)
    impact = np.column_stack([along_m, across_m])
    frames = _Frames(
        vru_m=to_world(impact[run] + velocity[run] * time_s[:, None], run),
        van_start_m=to_world(van_start, every)[run],
        van_end_m=to_world(van_end, every)[run],
        van_height_m=van_height_m[run],
    )
    axis = FrameAxis(
        run_ids=tuple(f"synthetic/{number}" for number in every),
        cases=("synthetic",) * n_runs,
        approaches=("synthetic",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=vut_speed_kmh,
        weight=np.full(n_runs, 1.0 / n_runs),
        last_brake_time_s=-vut_speed_kmh / 3.6 / (2.0 * _DECELERATION_MPS2),
        run_start=start,
        time_s=time_s,
    )
    return axis, frames


def _fill_mount(
    packed: NDArray[np.uint8],
    size: SyntheticSize,
    axis: FrameAxis,
    frames: _Frames,
    seed: int,
    mount: int,
) -> None:
    """Bits of all poses at one height of one pole."""
    site, height = divmod(mount, len(size.heights_m))
    height_m = size.heights_m[height]
    offset_m = frames.vru_m - _pole_m(size, site)
    distance_m = np.hypot(offset_m[:, 0], offset_m[:, 1])
    azimuth_deg = np.degrees(np.arctan2(offset_m[:, 1], offset_m[:, 0]))
    elevation_deg = np.degrees(np.arctan2(0.5 * _VRU_M - height_m, distance_m))
    seen = ~_is_hidden(_pole_m(size, site), height_m, frames)
    seen &= ~_is_grown_over(azimuth_deg, distance_m, np.random.default_rng([seed, 1, site]))
    missed = np.random.default_rng([seed, 2, mount]).random(axis.n_frames) < _MISSED_SHARE
    seen &= ~missed
    n_pitches, n_zooms = len(size.pitches_deg), len(size.zooms_deg)
    rows = np.empty((size.n_yaws, n_pitches, n_zooms, packed.shape[1]), dtype=np.uint8)
    for zoom, fov_deg in enumerate(size.zooms_deg):
        focal_px = 0.5 * _WIDTH_PX / np.tan(np.radians(0.5 * fov_deg))
        half_vertical_deg = np.degrees(np.arctan(_ASPECT * np.tan(np.radians(0.5 * fov_deg))))
        range_m = min(_MAX_RANGE_M, focal_px * _VRU_M / _MIN_HEIGHT_PX)
        is_near = seen & (np.hypot(distance_m, height_m) <= range_m)
        inside = np.stack(
            [
                is_near & (np.abs(elevation_deg - pitch_deg) <= half_vertical_deg)
                for pitch_deg in size.pitches_deg
            ]
        )
        by_pitch = np.packbits(inside, axis=1, bitorder="little")
        for yaw, ahead in enumerate(_aimed(azimuth_deg, 0.5 * fov_deg, size.n_yaws)):
            rows[yaw, :, zoom] = by_pitch & np.packbits(ahead, bitorder="little")
    first = mount * size.poses_per_mount
    packed[first : first + size.poses_per_mount] = rows.reshape(-1, packed.shape[1])


def _pole_m(size: SyntheticSize, site: int) -> FloatArray:
    """Foot of a pole in metres, (2,)."""
    arm, number = site % 4, site // 4
    per_arm = -(-size.n_sites // 4)
    side = _KERB_M if number % 2 else -_KERB_M
    along_m = _KERB_M + (_ARM_M - _KERB_M) * number / max(per_arm - 1, 1)
    turn = 0.5 * np.pi * arm
    return np.array(
        [
            along_m * np.cos(turn) - side * np.sin(turn),
            along_m * np.sin(turn) + side * np.cos(turn),
        ]
    )


def _aimed(azimuth_deg: FloatArray, half_deg: float, n_yaws: int) -> Iterator[BoolArray]:
    """For each yaw, the frames within a half angle of it."""
    for yaw_deg in np.arange(n_yaws) * (360.0 / n_yaws):
        away_deg = np.abs(azimuth_deg - yaw_deg)
        yield np.minimum(away_deg, np.abs(360.0 - away_deg)) <= half_deg


def _is_grown_over(
    azimuth_deg: FloatArray, distance_m: FloatArray, random: np.random.Generator
) -> BoolArray:
    """Whether trees and signs hide a VRU from a pole: a few sectors, each from some distance on."""
    hidden = np.zeros(len(azimuth_deg), dtype=bool)
    for middle_deg in random.uniform(-180.0, 180.0, size=random.integers(3, 8)):
        away_deg = np.abs(azimuth_deg - middle_deg)
        away_deg = np.minimum(away_deg, 360.0 - away_deg)
        beyond_m = random.uniform(10.0, 50.0)
        hidden |= (away_deg <= random.uniform(1.0, 8.0)) & (distance_m >= beyond_m)
    return hidden


def _is_hidden(pole_m: FloatArray, height_m: float, frames: _Frames) -> BoolArray:
    """Whether the parked van of each run stands in the line of sight to the VRU's middle."""
    sight = frames.vru_m - pole_m
    van = frames.van_end_m - frames.van_start_m
    to_van = frames.van_start_m - pole_m
    cross = sight[:, 0] * van[:, 1] - sight[:, 1] * van[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (to_van[:, 0] * van[:, 1] - to_van[:, 1] * van[:, 0]) / cross
        along = (to_van[:, 0] * sight[:, 1] - to_van[:, 1] * sight[:, 0]) / cross
    line_m = height_m + share * (0.5 * _VRU_M - height_m)
    is_met = (share > 0.0) & (share < 1.0) & (along >= 0.0) & (along <= 1.0)
    is_hidden: BoolArray = is_met & (line_m < frames.van_height_m)
    return is_hidden


# ---------- speed of the optimiser


_WORKERS = os.cpu_count() or 1
_FRONT_UNITS = 8
_FRONT_TIME_S, _BUDGET_TIME_S = 60.0, 20.0
_RELAXATION_TIME_S = 60.0
_MCLP_POSES, _MCLP_ROWS, _MCLP_UNITS = 1500, 4000, 3
_MCLP_RADIUS = 0.1  # of the unit square
_TRACK_MEMORIES_S = (np.inf, 1.0)
_BUDGETS = (2, 3, 4, 5)
_LARGE_UNITS, _LARGE_GAP, _LARGE_TIME_S = 6, 0.01, 300.0


def build_bench_problem(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    budget: int,
    *,
    fusion: Fusion = "any",
) -> PlacementProblem:
    """The question of so many units, on a table that is built for it."""
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.planner,
        compute=Compute(workers=_WORKERS),
    )
    wishes = Wishes(budget_units=budget)
    return build_problem(setting, candidates, table, wishes=wishes, fusion=fusion)


def measure_optimiser(problem: PlacementProblem) -> Figures:
    """Presolve and all stages, and fronts."""
    table = problem.table
    began_s = time.perf_counter()
    reduced = presolve(problem)
    presolve_s = time.perf_counter() - began_s
    solution = solve_placement(problem, reduced)
    all_stages_s = time.perf_counter() - began_s
    figures: Figures = {
        "optimiser: poses x runs x frames": f"{table.n_poses} x {table.axis.n_runs} x "
        f"{table.axis.n_frames}",
        "optimiser: presolve": str(solution.presolve),
        "optimiser: seconds, presolve": presolve_s,
        "optimiser: seconds, presolve and all stages (under 10)": all_stages_s,
        "optimiser: all stages proven": solution.certificate.is_proven,
    }
    for stages in ("first", "all"):
        began_s = time.perf_counter()
        front = pareto_front(
            problem,
            max_units=_FRONT_UNITS,
            stages=stages,
            effort=Effort(time_limit_s=_FRONT_TIME_S),
        )
        what = "APR and one failed" if stages == "first" else "all stages"
        name = f"optimiser: front K = 1..{_FRONT_UNITS}, {what}"
        figures[f"{name}: seconds (under 60)"] = time.perf_counter() - began_s
        figures[f"{name}: proven"] = front.is_proven
    return figures | measure_budgets(problem)


def measure_budgets(
    problem: PlacementProblem,
    *,
    units: Sequence[int] = _BUDGETS,
    time_limit_s: float = _BUDGET_TIME_S,
) -> Figures:
    """Presolve and all stages for growing budgets, with tracks that live on and that end."""
    figures: Figures = {}
    for memory_s in _TRACK_MEMORIES_S:
        for budget in units:
            asked = replace(
                problem,
                rule=replace(problem.rule, track_memory_s=memory_s),
                limits=replace(problem.limits, budget_units=budget),
            )
            began_s = time.perf_counter()
            solution = solve_placement(asked, effort=Effort(time_limit_s=time_limit_s))
            name = f"optimiser: track memory {memory_s:g} s, K = {budget}"
            figures[f"{name}: seconds, presolve and all stages"] = time.perf_counter() - began_s
            figures[f"{name}: proven"] = solution.certificate.is_proven
    return figures


def measure_relaxation(problem: PlacementProblem) -> Figures:
    """Bound of the APR by subgradient steps, and with OSQP's multipliers."""
    reduced = presolve(problem)
    effort = Effort(time_limit_s=_RELAXATION_TIME_S)
    value = solve_placement(problem, reduced, effort=effort).certificate.stages[0].objective
    began_s = time.perf_counter()
    root = find_root(reduced, run_rows(reduced), n_units=problem.limits.max_units)
    subgradient_s = time.perf_counter() - began_s
    with_osqp = polished(root)
    osqp_s = time.perf_counter() - began_s
    name = f"relaxation, K = {problem.limits.budget_units}"
    return {
        f"{name}: subgradient, seconds": subgradient_s,
        f"{name}: subgradient, gap %": 100.0 * (root.limit / value - 1.0),
        f"{name}: with OSQP, seconds": osqp_s,
        f"{name}: with OSQP, gap %": 100.0 * (with_osqp.limit / value - 1.0),
    }


def measure_single(single: PlacementProblem) -> Figures:
    """All stages where each unit confirms alone, against maximal covering by HiGHS alone."""
    covers = _covers(single)
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = in_turn(ours, direct, repeats=1)  # HiGHS takes minutes
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {"optimiser: all stages, single / bare HiGHS, APR only": ratio(ours_s, direct_s)}


def _covers(problem: PlacementProblem) -> BoolArray:
    """A[c, r]: whether pose c avoids run r by itself."""
    return np.stack(
        [np.isfinite(run_margins_s(problem, [pose])) for pose in range(problem.table.n_poses)]
    )


def _solve_mclp(covers: BoolArray, problem: PlacementProblem) -> float:
    """Maximal covering by SciPy's HiGHS without any presolve of ours; returns the APR."""
    n_poses, n_runs = covers.shape
    weight = problem.table.axis.weight
    chosen = np.concatenate([np.ones(n_poses), np.zeros(n_runs)])
    cover = np.hstack([-covers.T.astype(float), np.eye(n_runs)])
    result = milp(
        -np.concatenate([np.zeros(n_poses), weight]),
        integrality=chosen,
        bounds=Bounds(0.0, 1.0),
        constraints=[
            LinearConstraint(chosen, ub=float(problem.limits.max_units)),
            LinearConstraint(cover, ub=0.0),
        ],
    )
    solution: Any = result.x
    return float(solution[n_poses:] @ weight)


# ---------------------------------------------------------------- maximal covering


def measure_covering() -> Figures:
    """Maximal covering, model building included, against spopt with CBC on the same instance."""
    name = f"covering: {_MCLP_POSES} x {_MCLP_ROWS}, K = {_MCLP_UNITS}"
    random = np.random.default_rng(0)
    poses, rows = random.random((_MCLP_POSES, 2)), random.random((_MCLP_ROWS, 2))
    distance: FloatArray = np.linalg.norm(poses[:, None] - rows[None], axis=2)
    weight = random.integers(1, 10, _MCLP_ROWS).astype(np.float64)
    began_s = time.perf_counter()
    found = solve_mclp(
        build_covering_instance(distance < _MCLP_RADIUS, weight=weight), budget_units=_MCLP_UNITS
    )
    ours_s = time.perf_counter() - began_s
    figures: Figures = {f"{name}: seconds": ours_s}
    if find_spec("spopt") is None:
        return figures | {f"{name}: spopt with CBC": "not installed: uv run --group bench"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own
        import pulp
        from spopt.locate import MCLP

        began_s = time.perf_counter()
        model = MCLP.from_cost_matrix(
            np.where(distance.T < _MCLP_RADIUS, 0.0, 1.0), weight, 0.5, p_facilities=_MCLP_UNITS
        ).solve(pulp.PULP_CBC_CMD(msg=False))
        theirs_s = time.perf_counter() - began_s
    theirs = float(model.problem.objective.value())
    if not np.isclose(found.objective, theirs):
        raise RuntimeError(f"optima differ: ours {found.objective}, spopt {theirs}")
    return figures | {
        f"{name}: spopt with CBC, seconds": theirs_s,
        f"{name}: spopt / ours": theirs_s / ours_s,
    }


# ---------------------------------------------------------------- a hundred times larger


def measure_large() -> Figures:
    """A made-up instance of 200,000 poses and 50,000 frames."""
    size = SyntheticSize()
    name = f"large: {size.n_poses} x {size.n_frames}, K = {_LARGE_UNITS}"
    began_s = time.perf_counter()
    instance = build_synthetic_instance(size, workers=_WORKERS)
    problem = PlacementProblem(
        table=instance.to_table(),
        limits=Limits(
            site_index=instance.site_index,
            site_capacity=instance.site_capacity,
            budget_units=_LARGE_UNITS,
        ),
        fusion="any",
        rule=load_aeb_rule(),
    )
    built_s = time.perf_counter() - began_s
    began_s = time.perf_counter()
    effort = Effort(time_limit_s=_LARGE_TIME_S, gap=_LARGE_GAP)
    solution = solve_placement(problem, effort=effort)
    first = solution.certificate.stages[0]
    return {
        f"{name}: seconds to make it up": built_s,
        f"{name}: seconds (under 300)": time.perf_counter() - began_s,
        f"{name}: APR": first.objective,
        f"{name}: proven gap, % (at most 1)": 100.0 * first.gap,
        f"{name}: peak memory, GiB (under 6)": (
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        ),
    }
