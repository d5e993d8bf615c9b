"""Benchmark of the evaluator's pixels and LiDAR beams against bare Embree, and of pictures."""

import os
import statistics
import time
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.catalogue import Sensor, load_cameras
from geometry.lidar import load_lidars
from geometry.weather import load_weathers
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.evaluator import build_surroundings, perceive_from_roadside
from placement.evaluator.render import Solid
from placement.imaging import build_backdrop, draw_picture
from placement.setting import Setting
from placement.visibility import build_detection_table
from placement.visibility.casting import build_static_mesh, find_obstructions
from scenarios.runs import Run

from ..study.layout import load_carlancap_layout
from .rays import REPEATS, Figures, Recorder, bare_embree, in_turn, one_thread, ratio

_N_UNITS = 2
_WORKERS = os.cpu_count() or 1


def measure_perception(setting: Setting) -> Figures:
    """Figures of the evaluator, of LiDAR tables, and of pictures."""
    return _measure_pixels(setting) | _measure_lidar(setting) | _measure_pictures(setting.runs)


def _measure_pixels(setting: Setting) -> Figures:
    """The evaluator's rays for some of the study's cameras, against the same rays bare."""
    camera = load_cameras()["carla-ncap-rgb"]
    poses = [unit.pose for unit in load_carlancap_layout().units[:_N_UNITS]]
    min_height_px = load_planning_detector().min_box_height_px
    surroundings = build_surroundings(setting.scene, setting.runs)

    def record(solid: Solid) -> Solid:
        return replace(solid, caster=Recorder(solid.caster))

    recording = replace(
        surroundings,
        statics=tuple(map(record, surroundings.statics)),
        vrus=tuple(map(record, surroundings.vrus)),
        vut=record(surroundings.vut),
    )

    def perceive(world: Any) -> None:
        for pose in poses:
            perceive_from_roadside(world, pose, camera, min_height_px=min_height_px)

    perceive(recording)
    origin = np.append(surroundings.static_poses[0, :2], 0.0)
    vrus = dict.fromkeys(
        (run.encounter.vru, int(index)) for run in setting.runs for index in run.vru_shape
    )
    bodies = [*(actor.shapes[index] for actor, index in vrus), surroundings.vut_actor.shapes[0]]
    meshes = [
        *(
            build_static_mesh(setting.scene, obstruction, origin)
            for obstruction in find_obstructions(setting.runs).values()
        ),
        *((shape.vertices_m, shape.triangles) for shape in bodies),
    ]
    solids = [*recording.statics, *recording.vrus, recording.vut]
    bare = [
        bare_embree(vertices, np.asarray(triangles), solid.caster.rays, query="first hit")
        for (vertices, triangles), solid in zip(meshes, solids, strict=True)
        if isinstance(solid.caster, Recorder) and solid.caster.rays
    ]

    def cast_bare() -> None:
        for cast in bare:
            cast()

    with threadpool_limits(1), one_thread():
        ours_s, bare_s = in_turn(lambda: perceive(surroundings), cast_bare)
    n_rays = sum(
        len(origins)
        for solid in solids
        if isinstance(solid.caster, Recorder)
        for origins, _ in solid.caster.rays
    )
    return {
        "evaluator: rays cast": n_rays,
        "evaluator: pixels per second, ours / bare Embree (at least 0.5)": 1.0
        / ratio(ours_s, bare_s),
    }


def _measure_lidar(setting: Setting) -> Figures:
    """A table of LiDARs against one of cameras at the same mounts: the rays are the same."""
    mounts = load_carlancap_layout().units

    def build(sensor: Sensor) -> None:
        poses: list[CandidatePose] = [replace(unit, sensor=sensor) for unit in mounts]
        build_detection_table(
            setting.scene,
            poses,
            setting.runs,
            setting.axis,
            detector=setting.planner,
            compute=Compute(workers=_WORKERS),
        )

    lidar, camera = load_lidars()["carla-ncap-lidar"], load_cameras()["carla-ncap-rgb"]
    return {
        "table: LiDARs / cameras at the same mounts": ratio(
            *in_turn(lambda: build(lidar), lambda: build(camera))
        )
    }


def _measure_pictures(runs: tuple[Run, ...]) -> Figures:
    """Seconds per picture of 1920 x 1080 pixels, by weather."""
    from geometry.scene_files import load_study_scene

    unit = load_carlancap_layout().units[3]
    backdrop = build_backdrop(load_study_scene(), runs[0].obstruction)
    figures: Figures = {}
    for name, weather in load_weathers().items():
        seconds = []
        for _ in range(REPEATS):
            began_s = time.perf_counter()
            draw_picture(
                backdrop,
                runs[0],
                -10 % len(runs[0].time_s),
                unit.pose,
                load_cameras()["carla-ncap-rgb"],
                weather=weather,
                compute=Compute(workers=_WORKERS),
            )
            seconds.append(time.perf_counter() - began_s)
        figures[f"picture: seconds, {name} (about 1)"] = statistics.median(seconds)
    return figures
