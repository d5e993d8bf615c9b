"""Tiny worlds: boxes for buildings, a block for the VRU, runs given frame by frame."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh

from geometry.actors import (
    Actor,
    Shape,
    pick_actor,
)
from geometry.scene import Instance, Scene
from geometry.sensors import CameraModel
from geometry.study_scene import load_study_scene
from placement.detectors import GeometricDetector
from placement.setting import Setting
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases, select_cases
from scenarios.encounters import Encounter
from scenarios.paths import Motion, StraightPath
from scenarios.runs import Run, build_frame_axis, build_runs
from scenarios.weights import weight_per_run

Box = tuple[Sequence[float], Sequence[float]]  # lowest and highest corner


def _block(name, size_m):
    mesh = trimesh.creation.box(size_m)
    return Actor(
        name=name,
        class_name="pedestrian",
        length_m=size_m[0],
        width_m=size_m[1],
        height_m=size_m[2],
        shapes=(
            Shape(
                vertices_m=mesh.vertices + [0.0, 0.0, 0.5 * size_m[2]],
                triangles=mesh.faces,
            ),
        ),
    )


@pytest.fixture(scope="session")
def block():
    return _block("block", (0.5, 1.0, 1.8))


@pytest.fixture(scope="session")
def vut():
    return pick_actor("vut", "test")


@pytest.fixture(scope="session")
def camera():
    return CameraModel(
        name="small",
        width_px=320,
        height_px=180,
        horizontal_fov_deg=90.0,
        frame_rate_hz=10.0,
        near_m=0.35,
        price_eur=0.0,
    )


@pytest.fixture(scope="session")
def build_scene():
    def build(*boxes):
        meshes = [trimesh.creation.box(bounds=np.array(box)) for box in boxes]
        # One triangle far below the road, so that there is a mesh even without boxes.
        vertices = [np.array([[0.0, 0.0, -9.0], [1.0, 0.0, -9.0], [0.0, 1.0, -9.0]])]
        faces = [np.array([[0, 1, 2]])]
        for mesh in meshes:
            faces.append(mesh.faces + sum(map(len, vertices)))
            vertices.append(mesh.vertices)
        triangles = np.concatenate(faces)
        return Scene(
            name="test",
            vertices_m=np.concatenate(vertices),
            triangles=triangles,
            triangle_instance=np.zeros(len(triangles)),
            instances=(Instance(id="boxes", class_name="building"),),
            sites=(),
            outline_m=np.empty((0, 2)),
            lanes=(),
            crs="EPSG:32633",
        )

    return build


@pytest.fixture(scope="session")
def build_run(vut):
    """Frames as given; the VRU runs through its shapes, one per frame.

    The motions of the encounter are of no account.
    """

    def build(
        vru,
        vru_poses,
        vut_poses=None,
        obstruction=(),
    ):
        vru_array = np.array(vru_poses, dtype=np.float64)
        far = np.tile([-90.0, 90.0, 0.0], (len(vru_array), 1))
        if vut_poses is None:
            vut_array = far
        else:
            vut_array = np.array(vut_poses, dtype=np.float64)
        motion = Motion(
            path=StraightPath(start_m=np.zeros(2), yaw_deg=0.0),
            speed_mps=1.0,
            start_time_s=0.0,
        )
        return Run(
            id="test",
            case=load_cases()["CPNC-50"],
            approach="east",
            weather="day",
            vut_speed_kmh=20.0,
            encounter=Encounter(vut=vut, vut_motion=motion, vru=vru, vru_motion=motion),
            time_s=np.arange(1.0 - len(vru_array), 1.0) / 10.0,
            vut_position_m=vut_array[:, :2],
            vut_yaw_deg=vut_array[:, 2],
            vru_position_m=vru_array[:, :2],
            vru_yaw_deg=vru_array[:, 2],
            vru_shape=np.arange(len(vru_array)) % len(vru.shapes),
            obstruction=obstruction,
            last_brake_time_s=0.0,
        )

    return build


@pytest.fixture(scope="session")
def build_setting():
    """Runs that count alike, a detector that asks for little, no radio that fails."""

    def build(scene, runs, **changes):
        detector = GeometricDetector(min_iou=0.5, min_box_height_px=10.0)
        given = {
            "scene": scene,
            "runs": tuple(runs),
            "axis": build_frame_axis(runs, weight_per_run(runs)),
            "rule": load_aeb_rule(),
            "detector": detector,
            "table_detector": detector,
        }
        return Setting(**{**given, **changes})

    return build


@pytest.fixture(scope="session")
def study_runs(vut):
    """Three runs of the study's cases from one approach each, at two speeds."""
    runs = []
    for name, approach in (("CPNC-50", "north"), ("CBNA", "east"), ("CBLA", "south")):
        cases = select_cases(name, speeds="30,60").cases
        some, _ = build_runs(
            load_study_scene(),
            cases,
            vut=vut,
            rule=load_aeb_rule(),
            approaches=[approach],
        )
        runs += some
    return tuple(runs)
