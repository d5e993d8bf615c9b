"""Speed of the table, its rays against bare Embree, the evaluator, and the optimiser."""

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.raycast import FloatRays, Open3dCaster, RayCaster, caster_name
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.detection_table import DetectionTable
from placement.evaluator import evaluate_layout
from placement.layout import Layout, load_carlancap_layout
from placement.optimiser import Effort, PlacementProblem, presolve, run_margins_s, solve_placement
from placement.optimiser.problem import Fusion
from placement.setting import Setting
from placement.visibility.build import N_POINTS, build_detection_table
from placement.visibility.casting import World, build_world, cast_sight
from placement.wishes import Wishes, build_problem

REPEATS = 5
WORKERS = os.cpu_count() or 1
Figures = dict[str, float | str | None]
"""Measured figures by their names."""
Rays = tuple[FloatRays, FloatRays]
"""Origins and vectors, (n, 3) float32 each."""
Calls = list[tuple[Callable[..., object], Any]]

_N_MOUNTS = 24
_MAX_DISTANCE_M = 60.0
_EVERY_MOUNT = 4  # of which the table's verdicts are counted
_N_OTHERS = 6  # cameras, with the study's twelve


def in_turn(
    ours: Callable[[], object], theirs: Callable[[], object], *, repeats: int = REPEATS
) -> tuple[list[float], ...]:
    """Seconds of both, A B A B .., after one run of each that does not count."""
    seconds: tuple[list[float], list[float]] = ([], [])
    for repeat in range(repeats + 1):
        for each, work in zip(seconds, (ours, theirs), strict=True):
            began_s = time.perf_counter()
            work()
            if repeat > 0:
                each.append(time.perf_counter() - began_s)
    return seconds


def ratio(ours_s: list[float], theirs_s: list[float]) -> float:
    """Median of the ratios pair by pair."""
    return statistics.median(a / b for a, b in zip(ours_s, theirs_s, strict=True))


def bare_embree(
    vertices_m: FloatArray, triangles: Any, rays: Sequence[Rays]
) -> Callable[[], object]:
    """The library's own query of all rays in one call, with everything prepared that can be."""
    origins, vectors = (np.concatenate(part) for part in zip(*rays, strict=True))
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32)
    if caster_name() == "open3d":
        import open3d

        scene = open3d.t.geometry.RaycastingScene()
        to_tensor: Any = open3d.core.Tensor
        scene.add_triangles(to_tensor(vertices), to_tensor(triangles.astype(np.uint32)))
        tensor = to_tensor(np.hstack([origins, vectors]))
        return lambda: scene.test_occlusions(
            tensor, tnear=0.0, tfar=1.0, nthreads=Open3dCaster.n_threads
        )
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    embree = EmbreeScene()
    mesh = TriangleMesh(embree, vertices, triangles.astype(np.int32))
    ends = np.ones(len(origins), dtype=np.float32)
    return lambda: (mesh, embree.run(origins, vectors, dists=ends, query="OCCLUDED"))


# ---------- the detection table


class _Recorder:
    """A caster that records the rays it is asked for, and the calls by mount."""

    def __init__(self, caster: RayCaster, calls: list[Calls]) -> None:
        self.caster, self.calls = caster, calls
        self.rays: list[Rays] = []

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        self.rays.append((np.array(origins_m), np.array(vectors_m)))
        self.calls[-1].append((self.caster.is_blocked, self.rays[-1]))
        return self.caster.is_blocked(origins_m, vectors_m)

    def first_hit(self, origins_m: FloatRays, vectors_m: FloatRays) -> FloatRays:
        self.rays.append((np.array(origins_m), np.array(vectors_m)))
        return self.caster.first_hit(origins_m, vectors_m)

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        return self.caster.first_triangle(origins_m, vectors_m)


def measure_casting(setting: Setting, candidates: Sequence[CandidatePose]) -> Figures:
    """Number of the table's rays, and their time against bare Embree.

    Ours are cast as when the table is built; bare Embree gets them in one call per scene and
    thread.
    """
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=0)
    mounts = list({tuple(c.pose.position_m): c for c in candidates}.values())[:_N_MOUNTS]
    of_mounts: list[Calls] = []
    cast_to = _record(world, setting, mounts, of_mounts)
    with threadpool_limits(1):
        seconds = {
            n_threads: in_turn(
                _together([(_in_order, (calls,)) for calls in of_mounts], n_threads),
                _together(
                    [
                        (bare_embree(vertices, np.asarray(triangles), [part]), ())
                        for vertices, triangles, recorder in cast_to
                        for part in _split(recorder.rays, n_threads)
                    ],
                    n_threads,
                ),
            )
            for n_threads in dict.fromkeys((1, WORKERS))
        }
    n_rays = sum(len(origins) for *_, recorder in cast_to for origins, _ in recorder.rays)
    n_views = sum(int((_distance_m(world, one) <= _MAX_DISTANCE_M).sum()) for one in mounts)
    n_points = n_views * world.views.axes_m.shape[2]
    return {
        "rays cast": n_rays,
        "rays: cast / points looked at (before 1.57; at most 0.52)": n_rays / n_points,
        "rays: casting / bare Embree, one thread (at most 1.2)": ratio(*seconds[1]),
        "rays: casting / bare Embree, all processors (at most 1.2)": ratio(*seconds[WORKERS]),
    }


def _record(
    world: World, setting: Setting, mounts: Sequence[CandidatePose], calls: list[Calls]
) -> list[tuple[FloatArray, Any, _Recorder]]:
    """Cast from all mounts with recorders; meshes of the world with those that were asked."""
    scene = _Recorder(world.shared.caster, calls)
    parked = [_Recorder(caster, calls) for caster in world.standing.casters]
    bodies = [_Recorder(body, calls) for body in world.shared.bodies]
    vut = _Recorder(world.vehicles.casters[0], calls)
    recording = replace(
        world,
        shared=replace(world.shared, caster=scene, bodies=tuple(bodies)),
        standing=replace(world.standing, casters=tuple(parked)),
        vehicles=replace(world.vehicles, casters=(vut,)),
    )
    for mount in mounts:
        calls.append([])
        cast_sight(
            recording,
            mount.pose.position_m,
            near_m=mount.sensor.near_m,
            max_distance_m=_MAX_DISTANCE_M,
            for_lidar=False,
        )
    shapes = [
        *zip((actor.shapes[0] for actor in world.standing.actors), parked, strict=True),
        *(
            (surface.actor.shapes[surface.shape_index], body)
            for surface, body in zip(world.surfaces, bodies, strict=True)
        ),
        (world.vehicles.actors[0].shapes[0], vut),
    ]
    meshes = [
        (setting.scene.vertices_m - world.origin_m, setting.scene.triangles, scene),
        *((shape.vertices_m, shape.triangles, recorder) for shape, recorder in shapes),
    ]
    return [mesh for mesh in meshes if mesh[2].rays]


def _distance_m(world: World, mount: CandidatePose) -> FloatArray:
    """From a mount to the middle of each view's footprint, (n_views,)."""
    offset_m = mount.pose.position_m - world.origin_m
    ground_m = world.views.position_m - offset_m[:2]
    to_view_m = np.column_stack([ground_m, offset_m[2] - world.views.up_m])
    distance_m: FloatArray = np.linalg.norm(to_view_m, axis=1)
    return distance_m


def _split(rays: Sequence[Rays], n_parts: int) -> Iterator[Rays]:
    origins, vectors = (np.concatenate(part) for part in zip(*rays, strict=True))
    yield from zip(np.array_split(origins, n_parts), np.array_split(vectors, n_parts), strict=True)


def _in_order(calls: Calls) -> None:
    for call, given in calls:
        call(*given)


def _together(calls: Calls, n_threads: int) -> Callable[[], None]:
    """All calls, on some threads."""

    def run() -> None:
        with ThreadPoolExecutor(n_threads) as pool:
            for done in [pool.submit(call, *given) for call, given in calls]:
                done.result()

    return run


def measure_table(setting: Setting, candidates: Sequence[CandidatePose]) -> Figures:
    """Verdicts of the table per second, over the whole build for some mounts."""
    positions = list(dict.fromkeys(tuple(c.pose.position_m) for c in candidates))[::_EVERY_MOUNT]
    some = [c for c in candidates if tuple(c.pose.position_m) in set(positions)]
    seconds = _seconds(lambda: _table(setting, some, Compute()))
    per_second = len(some) * setting.axis.n_frames / seconds
    return {"table: million verdicts per second (before 3.4; at least 30)": per_second / 1e6}


def _table(
    setting: Setting, candidates: Sequence[CandidatePose], compute: Compute
) -> DetectionTable:
    return build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.table_detector,
        compute=compute,
    )


def _seconds(work: Callable[[], object]) -> float:
    """Median time of some work, after one run that may compile."""
    seconds = []
    for repeat in range(REPEATS + 1):
        began_s = time.perf_counter()
        work()
        if repeat > 0:
            seconds.append(time.perf_counter() - began_s)
    return statistics.median(seconds)


# ---------- the evaluator


def measure_evaluation(setting: Setting) -> Figures:
    """The default runs from as many poses as found, greedy and the study's layout have, and VUT."""
    others = build_candidates(setting.scene, load_candidate_grid(), extra=())
    units = (*load_carlancap_layout().units, *others[:: -(-len(others) // _N_OTHERS)])
    layout = Layout(name="bench", units=units)
    seconds = _seconds(lambda: evaluate_layout(layout, setting, compute=Compute(workers=WORKERS)))
    name = f"evaluator: {len(setting.runs)} runs, {len(units)} cameras and VUT"
    return {f"{name}: seconds (at most 5)": seconds}


# ---------- the optimiser: all stages by budget, and against bare HiGHS


_TRACK_MEMORIES_S = (np.inf, 1.0)
_BUDGETS = (2, 3, 4, 5)
_BUDGET_TIME_S = 20.0


def build_bench_problem(
    setting: Setting, candidates: Sequence[CandidatePose], budget: int, *, fusion: Fusion = "any"
) -> PlacementProblem:
    """The question of so many units, on a table that is built for it."""
    table = _table(setting, candidates, Compute(workers=WORKERS))
    wishes = Wishes(budget_units=budget)
    return build_problem(setting, candidates, table, wishes=wishes, fusion=fusion)


def measure_optimiser(problem: PlacementProblem) -> Figures:
    """Presolve, and all stages for growing budgets."""
    table = problem.table
    began_s = time.perf_counter()
    presolve(problem)
    return {
        "optimiser: poses x runs x frames": f"{table.n_poses} x {table.axis.n_runs} x "
        f"{table.axis.n_frames}",
        "optimiser: seconds, presolve": time.perf_counter() - began_s,
        **measure_budgets(problem),
    }


def measure_budgets(problem: PlacementProblem, *, units: Sequence[int] = _BUDGETS) -> Figures:
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
            solution = solve_placement(asked, effort=Effort(time_limit_s=_BUDGET_TIME_S))
            name = f"optimiser: track memory {memory_s:g} s, K = {budget}"
            figures[f"{name}: seconds, presolve and all stages"] = time.perf_counter() - began_s
            figures[f"{name}: proven"] = solution.certificate.is_proven
    return figures


def measure_single(single: PlacementProblem) -> Figures:
    """All stages where each unit confirms alone, against maximal covering by HiGHS alone."""
    # A[c, r]: pose c avoids run r by itself.
    poses = range(single.table.n_poses)
    covers = np.stack([np.isfinite(run_margins_s(single, [pose])) for pose in poses])
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = in_turn(ours, direct, repeats=1)  # HiGHS takes minutes
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {"optimiser: all stages, single / bare HiGHS, APR only": ratio(ours_s, direct_s)}


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
