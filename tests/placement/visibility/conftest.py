"""Tiny worlds: boxes for walls, catalogue bodies, runs given frame by frame."""

import numpy as np
import pytest
import trimesh
from short_runs import cut_run

from geometry.actors import load_actors
from geometry.poses import Pose
from geometry.scene import Instance, Scene
from geometry.sensors import CameraModel
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases, select_cases
from scenarios.encounters import Encounter
from scenarios.paths import Motion, StraightPath
from scenarios.runs import Run, build_frame_axis, build_runs
from scenarios.weights import weight_per_run


def _build_scene(*boxes):
    """Ground, and a box from each pair of lowest and highest corner."""
    meshes = [trimesh.creation.box(bounds=np.array(box, dtype=float)) for box in boxes]
    vertices = [np.array([[-60.0, -60, 0], [60, -60, 0], [60, 60, 0], [-60, 60, 0]])]
    faces = [np.array([[0, 1, 2], [0, 2, 3]])]
    for mesh in meshes:
        faces.append(mesh.faces + sum(map(len, vertices)))
        vertices.append(mesh.vertices)
    return Scene(
        name="test",
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(faces),
        triangle_instance=np.repeat(np.arange(len(faces)), list(map(len, faces))),
        instances=(
            Instance(id="ground", class_name="ground"),
            *(Instance(id=f"box-{i}", class_name="wall") for i in range(len(boxes))),
        ),
        sites=(),
        outline_m=np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]),
        lanes=(),
        crs="EPSG:32633",
    )


def _build_run(
    vru_poses, vut_poses=None, *, vru="adult", obstruction=(), name="test", shapes=None
):
    """Frames as given (east, north, yaw); the motions of the encounter are of no
    account.

    Unless told otherwise the VRU runs through its shapes, one per frame.
    """
    vru_array = np.array(vru_poses, dtype=float).reshape(-1, 3)
    far = np.tile([-55.0, 55.0, 0.0], (len(vru_array), 1))
    if vut_poses is None:
        vut_array = far
    else:
        vut_array = np.array(vut_poses, dtype=float).reshape(-1, 3)
    motion = Motion(
        path=StraightPath(start_m=np.zeros(2), yaw_deg=0.0),
        speed_mps=1.0,
        start_time_s=0.0,
    )
    actors = load_actors()
    if shapes is None:
        some = np.arange(len(vru_array))
    else:
        some = np.broadcast_to(shapes, len(vru_array))
    return Run(
        id=name,
        case=load_cases()["CPNC-50"],
        approach="east",
        weather="day",
        vut_speed_kmh=20.0,
        encounter=Encounter(
            vut=actors["vut"], vut_motion=motion, vru=actors[vru], vru_motion=motion
        ),
        time_s=np.arange(1.0 - len(vru_array), 1.0) / 10.0,
        vut_position_m=vut_array[:, :2],
        vut_yaw_deg=vut_array[:, 2],
        vru_position_m=vru_array[:, :2],
        vru_yaw_deg=vru_array[:, 2],
        vru_shape=some % len(actors[vru].shapes),
        obstruction=tuple(obstruction),
        last_brake_time_s=0.0,
    )


@pytest.fixture(scope="session")
def build_scene():
    return _build_scene


@pytest.fixture(scope="session")
def build_run():
    return _build_run


@pytest.fixture(scope="session")
def axis_of():
    def build(runs):
        return build_frame_axis(runs, weight_per_run(runs))

    return build


@pytest.fixture(scope="session")
def small_camera():
    return CameraModel(
        name="small",
        width_px=640,
        height_px=360,
        horizontal_fov_deg=90.0,
        frame_rate_hz=10.0,
        near_m=0.35,
        price_eur=0.0,
    )


@pytest.fixture(scope="session")
def study_runs(actors):
    """Three cases of the study at two speeds, the last four seconds of each."""
    cases = select_cases("CPNC-50,CBNA,CBLA", speeds="30,60").cases
    runs, _ = build_runs(
        load_study_scene(), cases, vut=actors["vut"], rule=load_aeb_rule()
    )
    return tuple(cut_run(run, slice(-40, None)) for run in runs)


@pytest.fixture(scope="session")
def mount(small_camera):
    """A candidate pose; a mount of the camera "small" unless told otherwise."""

    def build(name, position_m, *, yaw_deg=0.0, pitch_deg=0.0, camera=small_camera):
        return CandidatePose(
            id=name,
            site_id="",
            pose=Pose(position_m=position_m, yaw_deg=yaw_deg, pitch_deg=pitch_deg),
            sensor=camera,
        )

    return build
