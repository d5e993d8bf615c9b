"""Speed as ratios to named references, measured in one run.

``python -m experiments.bench``.

Absolute times depend on the machine and its load; the ratios depend on them little,
because both sides are measured in turn. Each part runs in a process of its own, and is
ended when its time is up.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray
from geometry.raycast import FloatRays, Open3dCaster, RayCaster, caster_name
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.layout import Layout, load_carlancap_layout
from placement.optimiser import (
    Effort,
    PlacementProblem,
    presolve,
    run_margins_s,
    solve_placement,
)
from placement.optimiser.problem import Fusion
from placement.question import Question
from placement.setting import Setting, build_setting
from placement.visibility.build import N_POINTS, build_detection_table
from placement.visibility.casting import World, build_world, cast_sight
from placement.wishes import Wishes, build_problem

from .main_job import measure_main_job

Figures = dict[str, float | str | None]
"""Measured figures by their names."""
Rays = tuple[FloatRays, FloatRays]
"""Origins and vectors, (n, 3) float32 each."""
Calls = list[tuple[Callable[..., object], Any]]

_REPEATS = 5
_WORKERS = os.cpu_count() or 1
# The study's: rays are measured on their 104 runs.
_OWN_CASES = "CPNC-50,CBNA,CBLA"
# Set in the processes that measure.
_INSIDE = "PLACE_RSUS_BENCH_PART"
_N_MOUNTS = 24
_MAX_DISTANCE_M = 60.0
# Of which the table's verdicts are counted.
_EVERY_MOUNT = 4
# Cameras, with the study's twelve.
_N_OTHERS = 6
_TRACK_MEMORIES_S = (np.inf, 1.0)
_BUDGET_TIME_S = 20.0


def seconds_of(*works: Callable[[], object], repeats: int = _REPEATS) -> FloatArray:
    """Seconds (n_works, n_repeats) of works in turn.

    Each runs once before, which does not count.
    """
    seconds = np.zeros((len(works), repeats + 1))
    for repeat in range(repeats + 1):
        for row, work in enumerate(works):
            began_s = time.perf_counter()
            work()
            seconds[row, repeat] = time.perf_counter() - began_s
    return seconds[:, 1:]


def ratio(
    ours: Callable[[], object], theirs: Callable[[], object], **options: int
) -> float:
    """Median of the ratios of their seconds, pair by pair."""
    ours_s, theirs_s = seconds_of(ours, theirs, **options)
    return float(np.median(ours_s / theirs_s))


@cache
def _setting(cases: str = "") -> Setting:
    if cases:
        question = Question(cases=cases, along_arms="0")
    else:
        question = Question()
    return build_setting(question, load_study_scene())


@cache
def _candidates() -> tuple[CandidatePose, ...]:
    grid = load_candidate_grid()
    study = load_carlancap_layout()
    return build_candidates(load_study_scene(), grid, extra=study.units)


def bare_embree(
    vertices_m: FloatArray, triangles: Any, rays: Sequence[Rays]
) -> Callable[[], object]:
    """The library's own query of all rays in one call.

    Everything that can be is prepared before.
    """
    origins, vectors = (np.concatenate(part) for part in zip(*rays, strict=True))
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32)
    if caster_name() == "open3d":
        import open3d

        scene = open3d.t.geometry.RaycastingScene()
        to_tensor: Any = open3d.core.Tensor
        scene.add_triangles(to_tensor(vertices), to_tensor(triangles.astype(np.uint32)))
        tensor = to_tensor(np.hstack([origins, vectors]))
        threads = Open3dCaster.n_threads
        return lambda: scene.test_occlusions(
            tensor, tnear=0.0, tfar=1.0, nthreads=threads
        )
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    embree = EmbreeScene()
    mesh = TriangleMesh(embree, vertices, triangles.astype(np.int32))
    ends = np.ones(len(origins), dtype=np.float32)
    return lambda: (mesh, embree.run(origins, vectors, dists=ends, query="OCCLUDED"))


def _recorder(caster: RayCaster, calls: list[Calls]) -> Any:
    """A caster that records the rays it is asked for, and the calls by mount."""
    rays: list[Rays] = []

    def is_blocked(origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        rays.append((np.array(origins_m), np.array(vectors_m)))
        calls[-1].append((caster.is_blocked, rays[-1]))
        return caster.is_blocked(origins_m, vectors_m)

    return SimpleNamespace(is_blocked=is_blocked, rays=rays)


def measure_casting() -> Figures:
    """Number of the table's rays, and their time against bare Embree.

    Ours are cast as when the table is built; bare Embree gets them in one call per
    scene and thread.
    """
    setting = _setting(_OWN_CASES)
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=0)
    mounts = list({tuple(c.pose.position_m): c for c in _candidates()}.values())[
        :_N_MOUNTS
    ]
    of_mounts: list[Calls] = []
    cast_to = _record(world, setting, mounts, of_mounts)

    def in_order(calls: Calls) -> None:
        for call, given in calls:
            call(*given)

    def against_bare(n_threads: int) -> float:
        ours: Calls = [(in_order, (calls,)) for calls in of_mounts]
        theirs: Calls = [
            (bare_embree(vertices, np.asarray(triangles), [part]), ())
            for vertices, triangles, recorder in cast_to
            for part in _split(recorder.rays, n_threads)
        ]
        return ratio(
            *(partial(_run_together, calls, n_threads) for calls in (ours, theirs))
        )

    with threadpool_limits(1):
        ratios = {
            n_threads: against_bare(n_threads)
            for n_threads in dict.fromkeys((1, _WORKERS))
        }
    n_rays = sum(
        len(origins) for *_, recorder in cast_to for origins, _ in recorder.rays
    )
    n_views = sum(
        int((_distance_m(world, one) <= _MAX_DISTANCE_M).sum()) for one in mounts
    )
    n_points = n_views * world.views.axes_m.shape[2]
    return {
        "rays cast": n_rays,
        "rays: cast / points looked at (before 1.57; at most 0.52)": n_rays / n_points,
        "rays: casting / bare Embree, one thread (at most 1.2)": ratios[1],
        "rays: casting / bare Embree, all processors (at most 1.2)": ratios[_WORKERS],
    }


def _record(
    world: World, setting: Setting, mounts: Sequence[CandidatePose], calls: list[Calls]
) -> list[tuple[FloatArray, Any, Any]]:
    """Cast from all mounts with recorders.

    Meshes of the world with those that were asked.
    """
    scene = _recorder(world.shared.caster, calls)
    parked = [_recorder(caster, calls) for caster in world.standing.casters]
    bodies = [_recorder(body, calls) for body in world.shared.bodies]
    vut = _recorder(world.vehicles.casters[0], calls)
    recording = replace(
        world,
        shared=replace(world.shared, caster=scene, bodies=tuple(bodies)),
        standing=replace(world.standing, casters=tuple(parked)),
        vehicles=replace(world.vehicles, casters=(vut,)),
    )
    for mount in mounts:
        calls.append([])
        near_m = mount.sensor.near_m
        reach_m = _MAX_DISTANCE_M
        at_m = mount.pose.position_m
        cast_sight(
            recording, at_m, near_m=near_m, max_distance_m=reach_m, for_lidar=False
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
    """All rays in as many parts, each in one piece."""
    origins, vectors = (np.concatenate(part) for part in zip(*rays, strict=True))
    yield from zip(
        np.array_split(origins, n_parts), np.array_split(vectors, n_parts), strict=True
    )


def _run_together(calls: Calls, n_threads: int) -> None:
    with ThreadPoolExecutor(n_threads) as pool:
        for done in [pool.submit(call, *given) for call, given in calls]:
            done.result()


def measure_table() -> Figures:
    """Verdicts of the table per second, over the whole build for some mounts."""
    setting, candidates = _setting(), _candidates()
    positions = list(dict.fromkeys(tuple(c.pose.position_m) for c in candidates))[
        ::_EVERY_MOUNT
    ]
    some = [c for c in candidates if tuple(c.pose.position_m) in set(positions)]
    seconds = float(np.median(seconds_of(lambda: _table(setting, some, Compute()))))
    per_second = len(some) * setting.axis.n_frames / seconds
    return {
        "table: million verdicts per second (before 3.4; at least 30)": per_second / 1e6
    }


def _table(
    setting: Setting, candidates: Sequence[CandidatePose], compute: Compute
) -> Any:
    world = (setting.scene, candidates, setting.runs, setting.axis)
    return build_detection_table(
        *world, detector=setting.table_detector, compute=compute
    )


def measure_evaluation() -> Figures:
    """The default runs, seen from as many poses as three layouts and the VUT.

    The layouts are the one found, the greedy one and the study's.
    """
    setting = _setting()
    others = build_candidates(setting.scene, load_candidate_grid(), extra=())
    units = (*load_carlancap_layout().units, *others[:: -(-len(others) // _N_OTHERS)])
    layout, compute = Layout(name="bench", units=units), Compute(workers=_WORKERS)
    seconds = seconds_of(lambda: evaluate_layout(layout, setting, compute=compute))
    name = f"evaluator: {len(setting.runs)} runs, {len(units)} cameras and VUT"
    return {f"{name}: seconds (at most 5)": float(np.median(seconds))}


def _problem(budget: int, fusion: Fusion = "any") -> PlacementProblem:
    """The question of so many units, on a table that is built for it."""
    setting = _setting()
    candidates = _candidates()
    table = _table(setting, candidates, Compute(workers=_WORKERS))
    wishes = Wishes(budget_units=budget)
    return build_problem(setting, candidates, table, wishes=wishes, fusion=fusion)


def measure_optimiser(budget: int) -> Figures:
    """Presolve, and all stages for growing budgets."""
    problem = _problem(budget)
    axis = problem.table.axis
    began_s = time.perf_counter()
    presolve(problem)
    size = f"{problem.table.n_poses} x {axis.n_runs} x {axis.n_frames}"
    return {
        "optimiser: poses x runs x frames": size,
        "optimiser: seconds, presolve": time.perf_counter() - began_s,
        **measure_budgets(problem),
    }


def measure_budgets(
    problem: PlacementProblem, *, units: Sequence[int] = (2, 3, 4, 5)
) -> Figures:
    """Presolve and all stages for growing budgets.

    Once with tracks that live on, once with tracks that end.
    """
    figures: Figures = {}
    for memory_s in _TRACK_MEMORIES_S:
        rule = replace(problem.rule, track_memory_s=memory_s)
        for budget in units:
            limits = replace(problem.limits, budget_units=budget)
            asked = replace(problem, rule=rule, limits=limits)
            began_s = time.perf_counter()
            solution = solve_placement(
                asked, effort=Effort(time_limit_s=_BUDGET_TIME_S)
            )
            name = f"optimiser: track memory {memory_s:g} s, K = {budget}"
            figures[f"{name}: seconds, presolve and all stages"] = (
                time.perf_counter() - began_s
            )
            figures[f"{name}: proven"] = solution.certificate.is_proven
    return figures


def measure_single(budget: int) -> Figures:
    """All stages where each unit confirms alone.

    Compared with maximal covering by HiGHS alone.
    """
    single = _problem(budget, fusion="single")
    # A[c, r]: pose c avoids run r by itself.
    poses = range(single.table.n_poses)
    covers = np.stack([np.isfinite(run_margins_s(single, [pose])) for pose in poses])
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    # HiGHS takes minutes.
    found = ratio(ours, direct, repeats=1)
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {"optimiser: all stages, single / bare HiGHS, APR only": found}


def _solve_mclp(covers: BoolArray, problem: PlacementProblem) -> float:
    """Maximal covering by SciPy's HiGHS without any presolve of ours.

    Returns the APR.
    """
    n_poses, n_runs = covers.shape
    weight = problem.table.axis.weight
    chosen = np.concatenate([np.ones(n_poses), np.zeros(n_runs)])
    cover = np.hstack([-covers.T.astype(float), np.eye(n_runs)])
    most = LinearConstraint(chosen, ub=float(problem.limits.max_units))
    result = milp(
        -np.concatenate([np.zeros(n_poses), weight]),
        integrality=chosen,
        bounds=Bounds(0.0, 1.0),
        constraints=[most, LinearConstraint(cover, ub=0.0)],
    )
    solution: Any = result.x
    return float(solution[n_poses:] @ weight)


PARTS: dict[str, Callable[[int], Figures]] = {
    "main-job": measure_main_job,
    "rays": lambda _: measure_casting(),
    "table": lambda _: measure_table(),
    "evaluator": lambda _: measure_evaluation(),
    "optimiser": measure_optimiser,
    "single": measure_single,
}
"""Functions of the budget of units that measure, by name."""


def run_part(name: str, *, budget: int, limit_s: float) -> Figures:
    """Figures of a part, measured in a process of its own.

    The process ends when its time is up.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figures.json"
        words = [name, "--budget", str(budget), "--out", str(path)]
        began_s = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "experiments.bench", *words],
            env=os.environ | {_INSIDE: name},
            start_new_session=True,
        )
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return {f"{name}: ended after so many seconds, not finished": limit_s}
        finally:
            # With all that it has started.
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        if code:
            raise click.ClickException(f"{name}: ended with exit code {code}")
        figures: Figures = json.loads(path.read_text(encoding="utf-8"))
    return figures | {f"{name}: seconds to measure": time.perf_counter() - began_s}


@click.command()
@click.argument("parts", nargs=-1, metavar="[PART]...")
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option(
    "--limit",
    default=600.0,
    show_default=True,
    help="Seconds after which a part is ended.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="JSON file for the figures."
)
def main(budget: int, parts: Sequence[str], limit: float, out: Path | None) -> None:
    """Measure parts: main-job, rays, table, evaluator, optimiser, single; or all.

    Figures of parts that are not measured this time stay in the file as they are.
    """
    names = parts or tuple(PARTS)
    for name in names:
        if name not in PARTS:
            raise click.BadParameter(f"{name}: expected some of {', '.join(PARTS)}")
    if os.environ.get(_INSIDE):
        (name,) = names
        assert out is not None
        out.write_text(json.dumps(PARTS[name](budget)), encoding="utf-8")
        return
    figures: dict[str, Figures] = {}
    if out is not None and out.exists():
        before = json.loads(out.read_text(encoding="utf-8"))
        figures = {
            name: before[name] for name in PARTS if isinstance(before.get(name), dict)
        }
    machine: Figures = {"processors": os.cpu_count(), "rays by": caster_name()}
    for name in names:
        click.echo(f"{name} ...", err=True)
        figures[name] = run_part(name, budget=budget, limit_s=limit)
        for figure, value in figures[name].items():
            shown = f"{value:.3g}" if isinstance(value, float) else value
            click.echo(f"{figure:<72} {shown}")
        # After each part, in case a later one is interrupted.
        if out is not None:
            ordered = {
                "machine": machine,
                **{n: figures[n] for n in PARTS if n in figures},
            }
            out.write_text(json.dumps(ordered, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
