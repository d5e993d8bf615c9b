"""Tiny worlds by hand: scenes, runs frame by frame, units, settings, tables."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from geometry.actors import Actor, Shape, load_actors
from geometry.arrays import FloatArray
from geometry.catalogue import load_cameras
from geometry.lidar import LidarModel
from geometry.poses import Pose
from geometry.scene import Instance, Scene, Site
from geometry.sensors import CameraModel
from geometry.study_scene import load_study_scene
from placement.candidates import CandidateGrid, CandidatePose, build_candidates
from placement.detection_table import DetectionTable
from placement.detectors import load_detector, load_planning_detector
from placement.setting import Setting
from placement.visibility import build_detection_table
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases
from scenarios.encounters import Encounter
from scenarios.paths import Motion, StraightPath
from scenarios.runs import FrameAxis, Run, build_frame_axis
from scenarios.weights import weight_per_run

Box = tuple[Sequence[float], Sequence[float]]
"""Lowest and highest corner. [m]"""
FAR = (-390.0, -390.0, 0.0)
"""Where the VUT is in nobody's way: east, north, yaw. [m, m, deg]"""
WALLS = (
    ((4, -6, 0), (4.3, 1, 2.2)),
    ((-9, 3, 0), (-2, 3.4, 1.2)),
    ((8, -9, 0), (12, -5, 6)),
)
"""Boxes that reach from beside a road user to far above it, and a low one."""


def scene_of_boxes(
    *boxes: Box,
    ground_m: float = 60.0,
    classes: Sequence[str] = (),
    sites: Sequence[Site] = (),
) -> Scene:
    """Flat ground that reaches so far from the origin, and boxes.

    Boxes are walls unless their classes are told. Without a reach there is no ground,
    but a square far below the road: a scene has a mesh even where nothing stands.
    """
    vertices = [_ground(ground_m)]
    faces = [np.array([[0, 1, 2], [0, 2, 3]])]
    if ground_m > 0.0:
        instances = [Instance(id="ground", class_name="ground")]
    else:
        instances = [Instance(id="base", class_name="building")]

    for number, box in enumerate(boxes):
        mesh = trimesh.creation.box(bounds=np.array(box, dtype=float))
        faces.append(mesh.faces + sum(map(len, vertices)))
        vertices.append(mesh.vertices)
        class_name = classes[number] if classes else "wall"
        instances.append(Instance(id=f"{class_name}-{number}", class_name=class_name))

    return Scene(
        name="test",
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(faces),
        triangle_instance=np.repeat(np.arange(len(faces)), list(map(len, faces))),
        instances=tuple(instances),
        sites=tuple(sites),
        outline_m=np.array(
            [
                [-5.0, -5.0],
                [5.0, -5.0],
                [5.0, 5.0],
                [-5.0, 5.0],
            ]
        ),
        lanes=(),
        crs="EPSG:32633",
    )


def _ground(reach_m: float) -> FloatArray:
    """Corners of a square on the road, or of one far below it without a reach."""
    if reach_m > 0.0:
        return reach_m * np.array(
            [
                [-1.0, -1, 0],
                [1, -1, 0],
                [1, 1, 0],
                [-1, 1, 0],
            ]
        )
    return np.array(
        [
            [0.0, 0, -9],
            [1, 0, -9],
            [1, 1, -9],
            [0, 1, -9],
        ]
    )


def block_actor(
    size_m: Sequence[float] = (0.5, 1.0, 1.8), name: str = "block"
) -> Actor:
    """A box that stands on the road: length, width, height."""
    length_m, width_m, height_m = size_m
    mesh = trimesh.creation.box(size_m)
    vertices_m = np.array(mesh.vertices) + [0.0, 0.0, 0.5 * height_m]
    return Actor(
        name=name,
        class_name="pedestrian",
        length_m=length_m,
        width_m=width_m,
        height_m=height_m,
        shapes=(Shape(vertices_m=vertices_m, triangles=np.array(mesh.faces)),),
    )


def run_of_frames(
    vru_poses: ArrayLike,
    vut_poses: ArrayLike | None = None,
    *,
    vru: str | Actor = "adult",
    obstruction: Sequence[Any] = (),
    name: str = "test",
    shapes: ArrayLike | None = None,
    weather: str = "day",
    last_brake_time_s: float = 0.0,
) -> Run:
    """A run whose frames are given: east, north, yaw of both bodies, (n, 3).

    The motions of the encounter are of no account. Unless told otherwise the VRU runs
    through its shapes, one per frame.
    """
    actors = load_actors()
    body = actors[vru] if isinstance(vru, str) else vru
    vru_array = np.array(vru_poses, dtype=float).reshape(-1, 3)
    n_frames = len(vru_array)
    placed = FAR if vut_poses is None else vut_poses
    vut_array = np.broadcast_to(np.array(placed, dtype=float), (n_frames, 3))
    motion = Motion(
        path=StraightPath(start_m=np.zeros(2), yaw_deg=0.0),
        speed_mps=1.0,
        start_time_s=0.0,
    )
    shown = np.arange(n_frames) if shapes is None else shapes
    return Run(
        id=name,
        case=load_cases()["CPNC-50"],
        approach="east",
        weather=weather,
        vut_speed_kmh=20.0,
        encounter=Encounter(
            vut=actors["vut"],
            vut_motion=motion,
            vru=body,
            vru_motion=motion,
        ),
        time_s=np.arange(1.0 - n_frames, 1.0) / 10.0,
        vut_position_m=vut_array[:, :2],
        vut_yaw_deg=vut_array[:, 2],
        vru_position_m=vru_array[:, :2],
        vru_yaw_deg=vru_array[:, 2],
        vru_shape=np.broadcast_to(shown, n_frames) % len(body.shapes),
        obstruction=tuple(obstruction),
        last_brake_time_s=last_brake_time_s,
    )


def setting_of(scene: Scene, runs: Sequence[Run], **fields: Any) -> Setting:
    """Runs that count alike, the study's rule and the built-in detectors."""
    built_in: dict[str, Any] = {
        "axis": build_frame_axis(runs, weight_per_run(runs)),
        "rule": load_aeb_rule(),
        "detector": load_detector(),
        "table_detector": load_planning_detector(),
    }
    return Setting(scene=scene, runs=tuple(runs), **(built_in | fields))


def crossing_setting(runs: Sequence[Run], **fields: Any) -> Setting:
    """Two sites of the study's junction, four of its cases and approaches at two
    speeds.
    """
    scene = load_study_scene()
    ways = ("CBNA/east", "CBNA/north", "CPNC-50/east", "CPNC-50/south")
    ids = [f"{way}/{speed}" for way in ways for speed in (40, 60)]
    sites = [site for site in scene.sites if site.id in ("corner-ne", "mast-w")]
    few = [run for run in runs if run.id in ids]
    return setting_of(replace(scene, sites=tuple(sites)), few, **fields)


def crossing_candidates(scene: Scene, camera: CameraModel) -> list[CandidatePose]:
    """A camera at each site of a scene, in six directions."""
    grid = CandidateGrid(
        heights_m=np.array([6.8]),
        yaw_step_deg=60.0,
        pitches_deg=np.array([-25.0]),
        sensors=(camera,),
    )
    return list(build_candidates(scene, grid))


def unit_at(
    name: str,
    position_m: ArrayLike = (0.0, 0.0, 7.0),
    *,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    site_id: str = "",
    sensor: CameraModel | LidarModel | None = None,
    latency_s: float | None = None,
) -> CandidatePose:
    """A unit at a place; the study's camera at no site unless told otherwise."""
    return CandidatePose(
        id=name,
        site_id=site_id,
        pose=Pose(
            position_m=np.array(position_m, dtype=float),
            yaw_deg=yaw_deg,
            pitch_deg=pitch_deg,
        ),
        sensor=sensor or load_cameras()["carla-ncap-rgb"],
        latency_s=latency_s,
    )


def table_of(
    setting: Setting, units: Sequence[CandidatePose], **options: Any
) -> DetectionTable:
    """The detection table of some units in a setting."""
    return build_detection_table(
        setting.scene,
        units,
        setting.runs,
        setting.axis,
        detector=setting.table_detector,
        **options,
    )


def three_runs():
    """Three runs of 3, 5 and 2 frames with weights 1/2, 1/4, 1/4."""
    return FrameAxis(
        run_ids=("A/north/20", "A/north/30", "B/north/20"),
        cases=("A", "A", "B"),
        approaches=("north",) * 3,
        weathers=("day",) * 3,
        vut_speed_kmh=np.array([20.0, 30.0, 20.0]),
        weight=np.array([0.5, 0.25, 0.25]),
        last_brake_time_s=np.array([-0.1, -0.2, -np.inf]),
        run_start=np.array([0, 3, 8, 10]),
        time_s=np.array([-0.2, -0.1, 0.0, -0.4, -0.3, -0.2, -0.1, 0.0, -0.1, 0.0]),
    )


def axis_of_runs(
    run_start: ArrayLike,
    time_s: ArrayLike,
    last_brake_time_s: ArrayLike,
    *,
    weight: ArrayLike | None = None,
    ids: Sequence[str] = (),
) -> FrameAxis:
    """An axis of runs of one case from one approach, which count alike unless told."""
    n_runs = len(np.asarray(run_start)) - 1
    return FrameAxis(
        run_ids=tuple(ids) or tuple(map(str, range(n_runs))),
        cases=("CPNA-50",) * n_runs,
        approaches=("north",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=np.full(n_runs, 30.0),
        weight=np.full(n_runs, 1.0 / n_runs) if weight is None else np.array(weight),
        last_brake_time_s=np.broadcast_to(last_brake_time_s, n_runs),
        run_start=np.array(run_start),
        time_s=np.array(time_s),
    )
