"""A wide open place with two poles, and people who walk by."""

import numpy as np
import pytest

from geometry.actors import load_actors
from geometry.scene import Instance, Scene, Site
from geometry.sensors import CameraModel
from placement.candidates import CandidateGrid, build_candidates
from placement.detectors import load_detector, load_planning_detector
from placement.pipeline import Assembly, place
from placement.setting import Setting
from placement.wishes import Wishes
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases
from scenarios.encounters import Encounter
from scenarios.paths import Motion, StraightPath
from scenarios.runs import Run, build_frame_axis
from scenarios.weights import weight_per_run

N_FRAMES = 40
_SIZE_M = 60.0


def _build_scene(*sites):
    """Flat ground and nothing on it; a site from each (id, east, north)."""
    corners = _SIZE_M * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Scene(
        name="meadow",
        vertices_m=corners,
        triangles=np.array([[0, 1, 2], [0, 2, 3]]),
        triangle_instance=np.zeros(2, dtype=int),
        instances=(Instance(id="ground", class_name="ground"),),
        sites=tuple(
            Site(
                id=name,
                position_m=[east, north, 0.0],
                kind="lamp post",
                height_range_m=[4.0, 8.0],
                capacity_units=2,
            )
            for name, east, north in sites
        ),
        outline_m=corners[:, :2],
        lanes=(),
        crs="EPSG:32633",
    )


def _build_walk(name, vru_m, *, last_brake_time_s=-1.0, vru="adult"):
    """Someone at the places given, (n, 2); the VUT is far away, its motion of no
    account.
    """
    vru_m = np.asarray(vru_m, dtype=float)
    n_frames = len(vru_m)
    motion = Motion(
        path=StraightPath(start_m=np.zeros(2), yaw_deg=0.0),
        speed_mps=1.0,
        start_time_s=0.0,
    )
    actors = load_actors()
    return Run(
        id=name,
        case=load_cases()["CPNC-50"],
        approach="east",
        weather="day",
        vut_speed_kmh=20.0,
        encounter=Encounter(
            vut=actors["vut"], vut_motion=motion, vru=actors[vru], vru_motion=motion
        ),
        time_s=np.arange(1.0 - n_frames, 1.0) / 10.0,
        vut_position_m=np.tile([-55.0, 55.0], (n_frames, 1)),
        vut_yaw_deg=np.zeros(n_frames),
        vru_position_m=vru_m,
        vru_yaw_deg=np.zeros(n_frames),
        vru_shape=np.zeros(n_frames, dtype=int),
        obstruction=(),
        last_brake_time_s=last_brake_time_s,
    )


def around_the_pole(radius_m, first_deg, last_deg, n_frames=N_FRAMES):
    """Places on an arc around the origin, (n, 2)."""
    angle = np.radians(np.linspace(first_deg, last_deg, n_frames))
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)])


@pytest.fixture(scope="session")
def arc():
    return around_the_pole


@pytest.fixture(scope="session")
def build_meadow():
    return _build_scene


@pytest.fixture(scope="session")
def build_walk():
    return _build_walk


@pytest.fixture(scope="session")
def narrow_camera():
    return CameraModel(
        name="narrow",
        width_px=640,
        height_px=480,
        horizontal_fov_deg=40.0,
        frame_rate_hz=10.0,
        near_m=0.35,
        price_eur=1000.0,
    )


@pytest.fixture(scope="session")
def build_small_setting():
    def build(scene, walks):
        return Setting(
            scene=scene,
            runs=tuple(walks),
            axis=build_frame_axis(walks, weight_per_run(walks)),
            rule=load_aeb_rule(),
            detector=load_detector(),
            table_detector=load_planning_detector(),
        )

    return build


@pytest.fixture(scope="session")
def meadow(build_meadow, build_walk, build_small_setting):
    """Three walks that no pose of the grid below sees early."""
    scene = build_meadow(("west", 0.0, 0.0), ("east", 34.0, 4.0))
    return build_small_setting(
        scene,
        [
            build_walk("one", around_the_pole(16.0, 75.0, 25.0)),
            build_walk(
                "two", around_the_pole(22.0, 20.0, 68.0), last_brake_time_s=-0.6
            ),
            build_walk(
                "three", around_the_pole(19.0, -30.0, 10.0), last_brake_time_s=-1.4
            ),
        ],
    )


@pytest.fixture(scope="session")
def meadow_grid(meadow, narrow_camera):
    grid = CandidateGrid(
        heights_m=np.array([5.0]),
        yaw_step_deg=45.0,
        pitches_deg=np.array([-15.0]),
        sensors=(narrow_camera,),
    )
    return build_candidates(meadow.scene, grid)


@pytest.fixture(scope="session")
def meadow_placement(meadow, meadow_grid):
    return place(
        Assembly(setting=meadow, candidates=meadow_grid, wishes=Wishes(budget_units=1))
    )
