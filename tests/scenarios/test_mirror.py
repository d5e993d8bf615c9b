"""Where traffic keeps left, all is as in a mirror."""

from dataclasses import replace

import numpy as np
import pytest
from junctions import build_scene, lanes_of, protocol_scene
from numpy.testing import assert_allclose

from geometry.actors import pick_actor
from geometry.junction import build_junction, mirrored
from scenarios.aeb import load_aeb_rule
from scenarios.cases import select_cases
from scenarios.runs import build_runs

FLIP = np.array([1.0, -1.0])
FLIP_IN_SPACE = np.array([1.0, -1.0, 1.0])
OTHER_SIDE = {
    "east": "east",
    "north": "south",
    "west": "west",
    "south": "north",
}


def left_handed(scene):
    """The same junction in a mirror that swaps north and south."""
    lanes = []
    for lane in scene.lanes:
        lanes.append(replace(lane, centreline_m=lane.centreline_m * FLIP))

    return replace(
        scene,
        vertices_m=scene.vertices_m * FLIP_IN_SPACE,
        triangles=scene.triangles[:, ::-1],
        outline_m=scene.outline_m * FLIP,
        lanes=tuple(lanes),
        crosswalks_m=scene.crosswalks_m * FLIP,
        keeps_left=True,
    )


def drive(scene, cases="study,protocol-4.5.1,protocol-2026", speeds="20,50"):
    """Runs of cases, and what is refused."""
    # Not "all", where impact points take turns, in another order of the arms.
    chosen = select_cases(cases, speeds=speeds).cases
    vut = pick_actor("vut", "vut")
    return build_runs(
        scene,
        chosen,
        vut=vut,
        rule=load_aeb_rule(),
    )


def assert_mirrored(found_m, positions_m):
    """Positions are those of the other side."""
    assert_allclose(
        found_m,
        positions_m * FLIP,
        rtol=0.0,
        atol=1e-6,
    )


def assert_turned_back(found_deg, yaws_deg):
    """Each yaw is the negative of the other, but for full turns."""
    turn = np.radians(found_deg + yaws_deg)
    assert_allclose(
        np.cos(turn),
        1.0,
        rtol=0.0,
        atol=1e-6,
    )


@pytest.mark.long
def test_where_traffic_keeps_left_every_run_is_the_mirror_image_of_one_on_the_right():
    """Every run has one twin, from the arm that the mirror swaps with its own."""
    corner = ("corner", 18.0, 18.0, 6.0, 6.0, 3.0)
    scene = protocol_scene(boxes=[corner], crosswalks_m=[[[14.0, -6.0], [14.0, 6.0]]])
    right, refused = drive(scene)
    left, refused_left = drive(left_handed(scene))

    assert len(right) > 100
    assert {run.case.kind for run in right} == {"crossing", "longitudinal", "turning"}
    assert len(refused) == len(refused_left)

    ours = {run.id: run for run in left}
    for run in right:
        other_side = f"/{OTHER_SIDE[run.approach]}/"
        twin = ours.pop(run.id.replace(f"/{run.approach}/", other_side))

        assert twin.last_brake_time_s == pytest.approx(run.last_brake_time_s, abs=1e-6)
        assert_mirrored(twin.vut_position_m, run.vut_position_m)
        assert_mirrored(twin.vru_position_m, run.vru_position_m)
        assert_turned_back(twin.vut_yaw_deg, run.vut_yaw_deg)
        assert_turned_back(twin.vru_yaw_deg, run.vru_yaw_deg)
        for one, other in zip(run.obstruction, twin.obstruction, strict=True):
            there_m = one.pose.position_m * FLIP_IN_SPACE
            assert other.actor is one.actor
            assert other.pose.position_m == pytest.approx(there_m, abs=1e-6)

    assert not ours


@pytest.mark.long
@pytest.mark.parametrize("change", [replace, left_handed])
def test_titles_say_to_which_side_the_vut_turns(change):
    """Near and far side are right and left, or left and right."""
    names = {"CPTAfs-50", "CBTAfs-side", "CPTAns-50", "CBTAns-0"}
    runs, _ = drive(change(protocol_scene()), ",".join(names), "10")

    assert {run.case.name for run in runs} == names

    for run in runs:
        turned_deg = (run.vut_yaw_deg[-1] - run.vut_yaw_deg[0] + 180.0) % 360.0 - 180.0
        if turned_deg > 5.0:
            side = "left"
            other = "right"
        else:
            side = "right"
            other = "left"

        assert abs(turned_deg) > 5.0
        assert f"turns {side}" in run.case.title
        assert other not in run.case.title


def test_a_junction_in_two_mirrors_is_itself_again():
    """Lanes in and out, and crosswalks, arm by arm."""
    junction = build_junction(build_scene(lanes_of("a", 10.0, n_lanes=2)))
    twice = mirrored(mirrored(junction))

    assert mirrored(junction).keeps_left
    assert not twice.keeps_left

    for name, arm in twice.arms.items():
        was = junction.arms[name]
        assert arm.crosswalk.point_m == pytest.approx(was.crosswalk.point_m)
        assert arm.crosswalk.direction == pytest.approx(was.crosswalk.direction)
        for one, other in zip(arm.lanes_in, was.lanes_in, strict=True):
            assert one.centreline_m == pytest.approx(other.centreline_m)
