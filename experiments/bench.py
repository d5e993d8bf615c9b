"""Speed as ratios to named references, measured in one run: ``python -m experiments.bench``.

Absolute times depend on the machine and its load; the ratios depend on them little, because both
sides are measured in turn, in the same process or as the same kind of process.
"""

import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray
from geometry.raycast import FloatRays, Open3dCaster, RayCaster, caster_name
from geometry.scene_files import load_study_scene
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.detection_table import DetectionTable
from placement.evaluator import evaluate_layout
from placement.layout import Layout
from placement.optimiser import PlacementProblem, run_margins_s, solve_placement
from placement.pipeline import build_problem
from placement.setting import Setting
from placement.visibility.build import N_POINTS, build_detection_table
from placement.visibility.casting import (
    World,
    build_world,
    cast_sight,
)
from placement.visibility.obstructions import build_static_mesh, find_obstructions

from .driving import build_setting
from .question import Question
from .study import load_carlancap_layout

_REPEATS = 5
_WORKERS = os.cpu_count() or 1
_N_MOUNTS = 24
_MAX_DISTANCE_M = 60.0
_OWN_CASES = "CPNC-50,CBNA,CBLA"  # the study's: rays and optimiser are measured on their 104 runs


@click.command()
@click.option("--budget", default=3, show_default=True, help="Units of the main job.")
@click.option("--out", type=click.Path(path_type=Path), help="JSON file for the figures.")
def main(budget: int, out: Path | None) -> None:
    """Measure rays, optimiser, growth with the runs, and the whole command."""
    setting = build_setting(Question(cases=_OWN_CASES), load_study_scene())
    candidates = build_candidates(
        setting.scene, load_candidate_grid(), extra=load_carlancap_layout().units
    )
    figures = {
        "processors": os.cpu_count(),
        "rays by": caster_name(),
        **_measure_casting(setting, candidates),
        **_measure_optimiser(setting, candidates, budget),
        **_measure_growth(candidates),
        **_measure_command(budget),
    }
    for name, value in figures.items():
        shown = f"{value:.3g}" if isinstance(value, float) else value
        click.echo(f"{name:<64} {shown}")
    if out is not None:
        out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


# ---------------------------------------------------------------- rays


class _Recorder:
    """A caster that keeps the rays it is asked for."""

    def __init__(self, caster: RayCaster) -> None:
        self._caster = caster
        self.rays: list[tuple[FloatRays, FloatRays]] = []

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        self.rays.append((np.array(origins_m), np.array(vectors_m)))
        return self._caster.is_blocked(origins_m, vectors_m)

    def first_hit(self, origins_m: FloatRays, vectors_m: FloatRays) -> FloatRays:
        return self._caster.first_hit(origins_m, vectors_m)


def _measure_casting(setting: Setting, candidates: tuple[CandidatePose, ...]) -> dict[str, Any]:
    """The table's rays, against the same rays handed to bare Embree in one call per scene."""
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=0)
    mounts = list({tuple(c.pose.position_m): c for c in candidates}.values())[:_N_MOUNTS]

    def cast(cast_world: World, workers: int) -> None:
        with ThreadPoolExecutor(workers) as pool:
            for future in [
                pool.submit(
                    cast_sight,
                    cast_world,
                    mount.pose.position_m,
                    near_m=mount.camera.near_m,
                    max_distance_m=_MAX_DISTANCE_M,
                )
                for mount in mounts
            ]:
                future.result()

    statics = [_Recorder(static) for static in world.static]
    bodies = [_Recorder(body) for body in world.bodies]
    vut = _Recorder(world.vut_body)
    cast(replace(world, static=tuple(statics), bodies=tuple(bodies), vut_body=vut), 1)
    meshes = [
        *(
            (*build_static_mesh(setting.scene, obstruction, world.origin_m), static)
            for obstruction, static in zip(
                find_obstructions(setting.runs).values(), statics, strict=True
            )
        ),
        *(
            (shape.vertices_m, shape.triangles, body)
            for surface, body in zip(world.surfaces, bodies, strict=True)
            for shape in (surface.actor.shapes[surface.shape_index],)
        ),
        (world.vut.shapes[0].vertices_m, world.vut.shapes[0].triangles, vut),
    ]
    bare = [
        _bare_embree(vertices, np.asarray(triangles), recorder.rays)
        for vertices, triangles, recorder in meshes
        if recorder.rays
    ]

    def cast_bare() -> None:
        for run in bare:
            run()

    with threadpool_limits(1):
        ours_s, bare_s = _in_turn(lambda: cast(world, _WORKERS), cast_bare)
        with _one_thread():
            ours_on_one_s, bare_on_one_s = _in_turn(lambda: cast(world, 1), cast_bare)
    n_rays = sum(len(origins) for _, _, recorder in meshes for origins, _ in recorder.rays)
    return {
        "rays cast": n_rays,
        "rays: million per second, ours": n_rays / statistics.median(ours_s) / 1e6,
        "rays: ours / bare Embree, one thread (at most 1.5)": _ratio(ours_on_one_s, bare_on_one_s),
        "rays: ours / bare Embree, all processors": _ratio(ours_s, bare_s),
    }


@contextmanager
def _one_thread() -> Iterator[None]:
    """Open3D on one thread; embreex is so anyway."""
    all_threads, Open3dCaster.n_threads = Open3dCaster.n_threads, 1
    try:
        yield
    finally:
        Open3dCaster.n_threads = all_threads


def _bare_embree(
    vertices_m: FloatArray, triangles: Any, rays: list[tuple[FloatRays, FloatRays]]
) -> Callable[[], object]:
    """The library's own occlusion query, with everything prepared that can be."""
    origins = np.concatenate([origin for origin, _ in rays])
    vectors = np.concatenate([vector for _, vector in rays])
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


# ---------------------------------------------------------------- optimiser


def _measure_optimiser(
    setting: Setting, candidates: tuple[CandidatePose, ...], budget: int
) -> dict[str, Any]:
    """All stages of the optimiser; and the maximal covering problem against HiGHS alone."""
    table = build_detection_table(
        setting.scene,
        candidates,
        setting.runs,
        setting.axis,
        detector=setting.detector,
        workers=_WORKERS,
    )
    problem = build_problem(setting, candidates, table, budget_units=budget, fusion="any")
    began_s = time.perf_counter()
    solution = solve_placement(problem)
    all_stages_s = time.perf_counter() - began_s
    single = build_problem(setting, candidates, table, budget_units=budget, fusion="single")
    covers = _covers(single, table)
    best: dict[str, float] = {}

    def ours() -> None:
        best["ours"] = solve_placement(single).certificate.stages[0].objective

    def direct() -> None:
        best["HiGHS"] = _solve_mclp(covers, single)

    ours_s, direct_s = _in_turn(ours, direct)
    if not np.isclose(best["ours"], best["HiGHS"], atol=1e-6):
        raise RuntimeError(f"optima differ: {best}")
    return {
        "optimiser: poses": table.n_poses,
        "optimiser: presolve": str(solution.presolve),
        "optimiser: seconds, all stages, any": all_stages_s,
        "optimiser: proven": solution.certificate.is_proven,
        "optimiser: all stages, single / bare HiGHS, APR only": _ratio(ours_s, direct_s),
    }


def _covers(problem: PlacementProblem, table: DetectionTable) -> BoolArray:
    """A[c, r]: whether pose c avoids run r by itself."""
    return np.stack([np.isfinite(run_margins_s(problem, [pose])) for pose in range(table.n_poses)])


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
            LinearConstraint(chosen, ub=problem.budget_units),
            LinearConstraint(cover, ub=0.0),
        ],
    )
    solution: Any = result.x
    return float(solution[n_poses:] @ weight)


# ---------------------------------------------------------------- more cases


def _measure_growth(candidates: tuple[CandidatePose, ...]) -> dict[str, Any]:
    """Seconds per run of everything but the optimiser, as cases are added."""
    scene = load_study_scene()
    mounts = {tuple(c.pose.position_m) for c in candidates}
    some = set(sorted(mounts)[:: max(1, len(mounts) // _N_MOUNTS)])
    few = [c for c in candidates if tuple(c.pose.position_m) in some]
    layout = Layout(name="three", units=load_carlancap_layout().units[:3])
    figures: dict[str, Any] = {}
    per_run_s = []
    for cases in ("CBLA", _OWN_CASES, "study", "protocol-4.5.1"):
        began_s = time.perf_counter()
        setting = build_setting(Question(cases=cases), scene)
        laid_s = time.perf_counter()
        build_detection_table(
            scene, few, setting.runs, setting.axis, detector=setting.detector, workers=_WORKERS
        )
        evaluate_layout(
            layout,
            scene,
            setting.runs,
            setting.axis,
            rule=setting.rule,
            detector=setting.detector,
            workers=_WORKERS,
        )
        n_runs = len(setting.runs)
        per_run_s.append((time.perf_counter() - began_s) / n_runs)
        name = f"growth: {cases}, {n_runs} runs"
        figures[f"{name}: seconds to lay them"] = laid_s - began_s
        figures[f"{name}: time per run / that of CBLA alone"] = per_run_s[-1] / per_run_s[0]
    return figures


# ---------------------------------------------------------------- whole command


def _measure_command(budget: int) -> dict[str, Any]:
    """The main job cold and warm, its memory, and the start-up."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PLACE_RSUS_CACHE": str(Path(folder) / "cache")}
        job = ["--budget", str(budget), "--quiet", "--out", str(Path(folder) / "out")]
        cold_s = _run_command(job, environment)
        warm_s = _run_command(job, environment)
        peak_kib = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        help_s = statistics.median(_run_command(["--help"], environment) for _ in range(_REPEATS))
    return {
        "command: seconds, cold (under 120)": cold_s,
        "command: seconds, warm": warm_s,
        "command: peak memory, GiB (under 2)": peak_kib / 2**20,
        "command: seconds, --help (under 0.5)": help_s,
    }


def _run_command(arguments: list[str], environment: dict[str, str]) -> float:
    began_s = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "experiments.cli", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    return time.perf_counter() - began_s


# ---------------------------------------------------------------- timing


def _in_turn(ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[list[float], ...]:
    """Seconds of both, A B A B .., after one run of each that does not count."""
    seconds: tuple[list[float], list[float]] = ([], [])
    for repeat in range(_REPEATS + 1):
        for kept, work in zip(seconds, (ours, theirs), strict=True):
            began_s = time.perf_counter()
            work()
            if repeat > 0:
                kept.append(time.perf_counter() - began_s)
    return seconds


def _ratio(ours_s: list[float], theirs_s: list[float]) -> float:
    """Median of the ratios pair by pair."""
    return statistics.median(a / b for a, b in zip(ours_s, theirs_s, strict=True))


if __name__ == "__main__":
    main()
