"""Benchmark of the detection table's rays against bare Embree."""

import os
import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.raycast import (
    FloatRays,
    Open3dCaster,
    RayCaster,
    caster_name,
)
from placement.candidates import CandidatePose
from placement.setting import Setting
from placement.visibility.build import N_POINTS, build_detection_table
from placement.visibility.casting import World, build_world, cast_sight

REPEATS = 5
Figures = dict[str, float | str | None]
"""What is measured, by its name."""


def in_turn(
    ours: Callable[[], object], theirs: Callable[[], object], *, repeats: int = REPEATS
) -> tuple[list[float], ...]:
    """Seconds of both, A B A B .., after one run of each that does not count."""
    seconds: tuple[list[float], list[float]] = ([], [])
    for repeat in range(repeats + 1):
        for kept, work in zip(seconds, (ours, theirs), strict=True):
            began_s = time.perf_counter()
            work()
            if repeat > 0:
                kept.append(time.perf_counter() - began_s)
    return seconds


def ratio(ours_s: list[float], theirs_s: list[float]) -> float:
    """Median of the ratios pair by pair."""
    return statistics.median(a / b for a, b in zip(ours_s, theirs_s, strict=True))


N_MOUNTS = 24
_WORKERS = os.cpu_count() or 1
_MAX_DISTANCE_M = 60.0
_EVERY_MOUNT = 4  # of which the table's verdicts are counted


Calls = list[tuple[Callable[..., object], Any]]


class Recorder:
    """A caster that keeps the rays it is asked for, and notes the call in the last list of some."""

    def __init__(self, caster: RayCaster, calls: list[Calls]) -> None:
        self.caster, self.calls = caster, calls
        self.rays: list[tuple[FloatRays, FloatRays]] = []

    def is_blocked(self, origins_m: FloatRays, vectors_m: FloatRays) -> BoolArray:
        """See :class:`geometry.raycast.RayCaster`."""
        self.rays.append((np.array(origins_m), np.array(vectors_m)))
        self.calls[-1].append((self.caster.is_blocked, self.rays[-1]))
        return self.caster.is_blocked(origins_m, vectors_m)

    def first_hit(self, origins_m: FloatRays, vectors_m: FloatRays) -> FloatRays:
        """See :class:`geometry.raycast.RayCaster`."""
        self.rays.append((np.array(origins_m), np.array(vectors_m)))
        return self.caster.first_hit(origins_m, vectors_m)

    def first_triangle(
        self, origins_m: FloatRays, vectors_m: FloatRays
    ) -> tuple[FloatRays, IntArray]:
        """See :class:`geometry.raycast.RayCaster`."""
        return self.caster.first_triangle(origins_m, vectors_m)


def measure_casting(setting: Setting, candidates: tuple[CandidatePose, ...]) -> Figures:
    """The table's rays: how many are cast, and how long that takes beside bare Embree.

    Ours are cast as when the table is built, all of one mount in one thread. Bare Embree gets the
    same rays in one call per scene and thread, with everything prepared.
    """
    world = build_world(setting.scene, setting.runs, n_points=N_POINTS, seed=0)
    mounts = list({tuple(c.pose.position_m): c for c in candidates}.values())[:N_MOUNTS]

    of_mounts: list[Calls] = []

    def cast(cast_world: World) -> None:
        for mount in mounts:
            of_mounts.append([])
            cast_sight(
                cast_world,
                mount.pose.position_m,
                near_m=mount.sensor.near_m,
                max_distance_m=_MAX_DISTANCE_M,
                for_lidar=False,
            )

    scene = Recorder(world.lasting.caster, of_mounts)
    parked = [Recorder(caster, of_mounts) for caster in world.standing.casters]
    bodies = [Recorder(body, of_mounts) for body in world.lasting.bodies]
    vut = Recorder(world.vehicles.casters[0], of_mounts)
    vehicles = replace(world.vehicles, casters=(vut,))
    vut_shape = world.vehicles.actors[0].shapes[0]
    standing = replace(world.standing, casters=tuple(parked))
    lasting = replace(world.lasting, caster=scene, bodies=tuple(bodies))
    cast(replace(world, lasting=lasting, standing=standing, vehicles=vehicles))
    meshes = [
        (setting.scene.vertices_m - world.origin_m, setting.scene.triangles, scene),
        *(
            (shape.vertices_m, shape.triangles, body)
            for shape, body in zip(world.standing.shapes, parked, strict=True)
        ),
        *(
            (shape.vertices_m, shape.triangles, body)
            for surface, body in zip(world.surfaces, bodies, strict=True)
            for shape in (surface.actor.shapes[surface.shape_index],)
        ),
        (vut_shape.vertices_m, vut_shape.triangles, vut),
    ]
    cast_to = [mesh for mesh in meshes if mesh[2].rays]
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
            for n_threads in dict.fromkeys((1, _WORKERS))
        }
        sight_s, bare_s = in_turn(
            lambda: cast(world),
            _together(
                [(bare_embree(v, np.asarray(t), recorder.rays), ()) for v, t, recorder in cast_to],
                1,
            ),
        )
    n_rays = sum(len(origins) for *_, recorder in meshes for origins, _ in recorder.rays)
    n_points = (
        sum(
            int((np.linalg.norm(_from_mount(world, mount), axis=1) <= _MAX_DISTANCE_M).sum())
            for mount in mounts
        )
        * world.views.axes_m.shape[2]
    )
    return {
        "rays cast": n_rays,
        "rays: cast / points looked at (before 1.57; at most 0.52)": n_rays / n_points,
        "rays: million per second, all processors": n_rays
        / statistics.median(seconds[_WORKERS][0])
        / 1e6,
        "rays: casting / bare Embree, one thread (at most 1.2)": ratio(*seconds[1]),
        "rays: casting / bare Embree, all processors (at most 1.2)": ratio(*seconds[_WORKERS]),
        "rays: with all that spares them / bare Embree, one thread": ratio(sight_s, bare_s),
    }


def _from_mount(world: World, mount: CandidatePose) -> FloatArray:
    """Way from a mount to the middle of each view's footprint, (n_views, 3)."""
    offset_m = mount.pose.position_m - world.origin_m
    ground_m = world.views.position_m - offset_m[:2]
    return np.column_stack([ground_m, offset_m[2] - world.views.up_m])


def _split(
    rays: list[tuple[FloatRays, FloatRays]], n_parts: int
) -> Iterator[tuple[FloatRays, FloatRays]]:
    """All rays in as many parts, each in one piece."""
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


def measure_table(setting: Setting, candidates: tuple[CandidatePose, ...]) -> Figures:
    """Verdicts of the table per second, over the whole build for some mounts."""
    positions = list(dict.fromkeys(tuple(c.pose.position_m) for c in candidates))[::_EVERY_MOUNT]
    some = [c for c in candidates if tuple(c.pose.position_m) in set(positions)]
    seconds = []
    for repeat in range(REPEATS + 1):
        began_s = time.perf_counter()
        build_detection_table(
            setting.scene, some, setting.runs, setting.axis, detector=setting.table_detector
        )
        if repeat > 0:  # the first one may compile
            seconds.append(time.perf_counter() - began_s)
    n_verdicts = len(some) * setting.axis.n_frames
    return {
        "table: verdicts": n_verdicts,
        "table: million verdicts per second (before 3.4; at least 30)": n_verdicts
        / statistics.median(seconds)
        / 1e6,
    }


@contextmanager
def one_thread() -> Iterator[None]:
    """Open3D on one thread; embreex is so anyway."""
    all_threads, Open3dCaster.n_threads = Open3dCaster.n_threads, 1
    try:
        yield
    finally:
        Open3dCaster.n_threads = all_threads


def bare_embree(
    vertices_m: FloatArray,
    triangles: Any,
    rays: list[tuple[FloatRays, FloatRays]],
    *,
    query: Literal["any hit", "first hit"] = "any hit",
) -> Callable[[], object]:
    """The library's own query, with everything prepared that can be.

    `rays` are pairs of origins and vectors, (n, 3) float32; all are cast in one call.
    """
    origins = np.concatenate([origin for origin, _ in rays])
    vectors = np.concatenate([vector for _, vector in rays])
    vertices = np.ascontiguousarray(vertices_m, dtype=np.float32)
    if caster_name() == "open3d":
        import open3d

        scene = open3d.t.geometry.RaycastingScene()
        to_tensor: Any = open3d.core.Tensor
        scene.add_triangles(to_tensor(vertices), to_tensor(triangles.astype(np.uint32)))
        tensor = to_tensor(np.hstack([origins, vectors]))
        if query == "first hit":
            return lambda: scene.cast_rays(tensor, nthreads=Open3dCaster.n_threads)
        return lambda: scene.test_occlusions(
            tensor, tnear=0.0, tfar=1.0, nthreads=Open3dCaster.n_threads
        )
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    embree = EmbreeScene()
    mesh = TriangleMesh(embree, vertices, triangles.astype(np.int32))
    ends = np.full(len(origins), 1.0 if query == "any hit" else 1.0e6, dtype=np.float32)
    name = "OCCLUDED" if query == "any hit" else "DISTANCE"
    return lambda: (mesh, embree.run(origins, vectors, dists=ends, query=name))
