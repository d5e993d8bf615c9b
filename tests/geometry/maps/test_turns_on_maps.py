"""Cars that turn at junctions of files that others have made."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import distance_to_chain_m

from geometry.junction import CONNECTING, build_junction
from geometry.maps.cut import build_scene, cut_out
from geometry.maps.importing import survey_junctions
from geometry.maps.opendrive import read_opendrive
from geometry.study_scene import load_study_scene
from placement.question import Question
from placement.setting import build_rule
from scenarios.cases import load_cases
from scenarios.paths import TowedPath
from scenarios.runs import build_runs


def scene_of(path):
    """The scene around the largest junction of a file."""
    source = read_opendrive(path)
    chosen = survey_junctions(source)[0].junction
    around = cut_out([source], chosen, radius_m=80.0)
    return build_scene(around, name="made", source_crs="", sites=(), radius_m=80.0)


@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    [
        "X-Intersection_NCAP",
        "Town03",
        "Town05",
    ],
)
def test_turning_cars_follow_the_connecting_lanes_within_a_centimetre(
    real_input, actors, name
):
    scene = scene_of(real_input(f"opendrive/{name}.xodr"))
    junction = build_junction(scene)

    cases = []
    for case in ("CPTAfs-50", "CPTAns-50"):
        # At higher speeds some ways are too tight.
        slow = replace(load_cases()[case], vut_speeds_kmh=(10.0,))
        cases.append(slow)

    runs, _ = build_runs(scene, cases, vut=actors["vut"], rule=build_rule(Question()))
    followed = set()

    for run in runs:
        path = run.encounter.vut_motion.path
        assert isinstance(path, TowedPath), run.id

        front, _ = path.course.at(np.linspace(0.0, 60.0, 600))
        away_m = {}
        for lane in junction.connections:
            if np.linalg.norm(lane.centreline_m[0] - front[0]) < 0.5:
                off_m = distance_to_chain_m(lane.centreline_m, front)
                away_m[lane.id] = off_m.max()
        nearest = min(away_m, key=away_m.__getitem__)

        assert away_m[nearest] < 0.01, run.id

        followed.add(nearest)

    assert len(followed) == 8  # each way from each of four arms


def test_the_studys_file_has_no_connecting_lanes():
    assert all(lane.kind != CONNECTING for lane in load_study_scene().lanes)
