"""Small questions: two sites of the study's junction, and a tiny junction with a
queue.
"""

from dataclasses import replace

import numpy as np
import pytest
from junctions import ARMS, LANE_M, MOUTH_M, build_scene, lanes_of, turned
from short_runs import cut_run
from tiny_worlds import setting_of, unit_at

from geometry.scene import Lane
from geometry.study_scene import load_study_scene
from placement.candidates import CandidateGrid, build_candidates
from placement.detectors.geometric import GeometricDetector
from placement.sampling.uncertainty import load_uncertainty
from scenarios.cases import load_cases
from scenarios.runs import build_runs

PARKING_M = 2.6
_LAST = 41


@pytest.fixture(scope="session")
def build_setting():
    """Builds settings of few runs."""
    return setting_of


@pytest.fixture(scope="session")
def setting(runs):
    """The last four seconds of three runs at two sites of the study's junction."""
    scene = load_study_scene()
    ids = ("CBNA/east/60", "CPNC-50/south/60", "CBLA/east/50")
    names = ("corner-ne", "mast-w")
    sites = tuple(site for site in scene.sites if site.id in names)
    return setting_of(
        replace(scene, sites=sites),
        [cut_run(run, slice(-_LAST, None)) for run in runs if run.id in ids],
    )


@pytest.fixture(scope="session")
def candidates(setting, camera):
    """Two poses at each site."""
    grid = CandidateGrid(
        heights_m=[6.8],
        yaw_step_deg=180.0,
        pitches_deg=[-25.0],
        sensors=(camera,),
    )
    return build_candidates(setting.scene, grid)


@pytest.fixture(scope="session")
def default():
    """The default uncertainty."""
    return load_uncertainty()


@pytest.fixture(scope="session")
def junction_scene():
    """Four arms at right angles, one lane in and out, parking lanes beside them."""
    lanes = []
    for arm, bearing in ARMS.items():
        lanes += lanes_of(arm, bearing, arm_m=80.0)
        offset_m = LANE_M + 0.5 * PARKING_M
        for name, way in (
            ("in", [[MOUTH_M + 80.0, offset_m], [MOUTH_M, offset_m]]),
            ("out", [[MOUTH_M, -offset_m], [MOUTH_M + 80.0, -offset_m]]),
        ):
            lane = Lane(
                id=f"{arm}-parking-{name}",
                kind="parking",
                width_m=PARKING_M,
                centreline_m=turned(way, bearing),
            )
            lanes.append(lane)

    return build_scene(lanes)


@pytest.fixture(scope="session")
def junction_runs(actors, rule, junction_scene):
    """One straight case from each approach, at its lowest speed."""
    case = load_cases()["CPNA-25"]
    slow = replace(case, vut_speeds_kmh=case.vut_speeds_kmh[:1])
    runs, _ = build_runs(
        junction_scene,
        [slow],
        vut=actors["vut"],
        rule=rule,
    )
    return {run.approach: run for run in runs}


@pytest.fixture(scope="session")
def standing_still(junction_runs):
    """The run from the west, in which the VRU only stands at a place that the test
    chooses.
    """

    def build(position_m, *, n_frames=12, run=None):
        if run is None:
            run = junction_runs["west"]

        frames = {
            name: getattr(run, name)[-n_frames:]
            for name in ("time_s", "vut_yaw_deg", "vru_shape")
        }
        vru_position_m = np.tile(np.asarray(position_m, dtype=float), (n_frames, 1))
        return replace(
            run,
            **frames,
            # The VUT is far away, and hides nothing.
            vut_position_m=np.tile([-60.0, -1.75], (n_frames, 1)),
            vru_position_m=vru_position_m,
            vru_yaw_deg=np.full(n_frames, 90.0),
        )

    return build


@pytest.fixture(scope="session")
def look():
    """A camera of no site that looks along a yaw."""

    return unit_at


@pytest.fixture(scope="session")
def keen():
    """A detector that takes boxes of any size."""
    return GeometricDetector(min_iou=0.5, min_box_height_px=1.0)
