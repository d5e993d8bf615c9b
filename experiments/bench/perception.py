"""Benchmark of the evaluator, of its pixels against bare Embree, of LiDARs, and of pictures."""

import os
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor, load_cameras
from geometry.lidar import load_lidars
from geometry.poses import Pose, body_rotation
from geometry.raycast import FloatRays
from geometry.sensors import CameraModel, pixel_rays
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.detectors import load_planning_detector
from placement.evaluator import build_surroundings, evaluate_layout, perceive_from_roadside
from placement.imaging import build_backdrop, draw_picture
from placement.layout import Layout, load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting
from placement.visibility import build_detection_table
from scenarios.runs import Run

from .rays import REPEATS, Figures, bare_embree, in_turn, one_thread, ratio

_N_UNITS = 2
_N_OTHERS = 6  # three found, three of the greedy layout
_EVERY = 10  # sights: the rays of all would need gigabytes
_WORKERS = os.cpu_count() or 1


def measure_perception(setting: Setting) -> Figures:
    """Figures of the evaluator, of LiDAR tables, and of pictures."""
    return (
        _measure_evaluation()
        | _measure_pixels(setting)
        | _measure_lidar(setting)
        | _measure_pictures(setting.runs)
    )


def _measure_evaluation() -> Figures:
    """The default runs from as many poses as found, greedy and the study's layout have, and VUT."""
    scene = load_study_scene()
    setting = build_setting(Question(), scene)
    study = load_carlancap_layout()
    others = build_candidates(setting.scene, load_candidate_grid(), extra=())
    units = (*study.units, *others[:: -(-len(others) // _N_OTHERS)])
    layout = Layout(name="bench", units=units)
    seconds, processor_s = [], []
    for repeat in range(REPEATS + 1):
        began_s, began_processor_s = time.perf_counter(), time.process_time()
        evaluate_layout(layout, setting, compute=Compute(workers=_WORKERS))
        if repeat > 0:  # the first one may compile
            seconds.append(time.perf_counter() - began_s)
            processor_s.append(time.process_time() - began_processor_s)
    name = f"evaluator: {len(setting.runs)} runs, {len(units)} cameras and VUT"
    return {
        f"{name}: seconds (at most 5)": statistics.median(seconds),
        f"{name}: processor seconds": statistics.median(processor_s),
    }


def _measure_pixels(setting: Setting) -> Figures:
    """The evaluator against bare Embree, one ray for each pixel of the VRUs' boxes."""
    camera = load_cameras()["carla-ncap-rgb"]
    poses = [unit.pose for unit in load_carlancap_layout().units[:_N_UNITS]]
    min_height_px = load_planning_detector().min_box_height_px
    whole = build_surroundings(setting.scene, setting.runs)
    _, first = np.unique(whole.sight_index, return_index=True)
    surroundings = whole.take(first[::_EVERY])

    def perceive() -> list[FloatArray]:
        return [
            perceive_from_roadside(
                surroundings, pose, camera, min_height_px=min_height_px
            ).amodal_px
            for pose in poses
        ]

    rays: dict[int, list[tuple[FloatRays, FloatRays]]] = {}
    for pose, boxes_px in zip(poses, perceive(), strict=True):
        for frame, box_px in enumerate(boxes_px.astype(np.int64).tolist()):
            rays.setdefault(int(surroundings.vru_index[frame]), []).append(
                _box_rays(box_px, pose, camera, surroundings.vru_poses[frame])
            )
    bare = []
    for index, parts in rays.items():
        origins, ways = (np.concatenate(part) for part in zip(*parts, strict=True))
        (mesh,) = surroundings.vrus[index].meshes
        bare.append(
            bare_embree(mesh.vertices_m, mesh.triangles, [(origins, ways)], query="first hit")
        )

    def cast_bare() -> None:
        for cast in bare:
            cast()

    with threadpool_limits(1), one_thread():
        ours_s, bare_s = in_turn(perceive, cast_bare)
    return {
        "evaluator: pixels of the VRUs' boxes": sum(
            len(origins) for parts in rays.values() for origins, _ in parts
        ),
        "evaluator: time / bare Embree's, one ray for each of the pixels (below 1)": ratio(
            ours_s, bare_s
        ),
    }


def _box_rays(
    box_px: Sequence[int], pose: Pose, camera: CameraModel, vru_pose: FloatArray
) -> tuple[FloatRays, FloatRays]:
    """Rays through the pixels of a box, in the VRU's body frame: origins and vectors, (n, 3)."""
    x_min, y_min, x_max, y_max = box_px
    columns, rows = np.meshgrid(np.arange(x_min, x_max), np.arange(y_min, y_max))
    to_world = body_rotation(vru_pose[2])
    ways = pixel_rays(columns.ravel(), rows.ravel(), pose, camera) @ to_world
    origin = (pose.position_m - vru_pose[[0, 1, 3]]) @ to_world
    return np.tile(origin, (len(ways), 1)).astype(np.float32), ways.astype(np.float32)


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
            detector=setting.table_detector,
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
