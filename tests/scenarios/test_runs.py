import copy
import dataclasses
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from geometry.actors import PlacedActor
from geometry.errors import InputError
from geometry.footprints import footprint_corners, footprint_separation
from geometry.frames import to_carla_points, to_carla_yaw
from scenarios import runs as runs_module
from scenarios.exposure import weight_per_run
from scenarios.runs import FrameAxis, build_frame_axis, build_runs

GOLDEN = tomllib.loads(
    (Path(__file__).parents[1] / "golden" / "carla_ncap_runs.toml").read_text(encoding="utf-8")
)["runs"]
VRU_NAMES = {"bicycle": "cyclist", "pedestrian": "adult"}


def _placement(placements, golden):
    (found,) = (
        placement
        for placement in placements
        if (placement.case.name, placement.approach) == (golden["case"], golden["approach_from"])
    )
    return found


def _runs_of(runs, placement):
    return [run for run in runs if (run.case, run.approach) == (placement.case, placement.approach)]


def _separation(encounter, time_s):
    corners = []
    for body, motion in (
        (encounter.vut, encounter.vut_motion),
        (encounter.vru, encounter.vru_motion),
    ):
        position, yaw = motion.path.at(motion.distance_m(time_s))
        corners.append(
            footprint_corners(position, yaw, length_m=body.length_m, width_m=body.width_m)
        )
    return footprint_separation(*corners)


def _vru_in_vut_frame(encounter):
    """Middle of the VRU at time 0, ahead and to the left of the middle of the VUT."""
    vut, _ = encounter.vut_motion.path.at(encounter.vut_motion.distance_m(0.0))
    vru, _ = encounter.vru_motion.path.at(encounter.vru_motion.distance_m(0.0))
    ahead = encounter.vut_motion.path.direction
    return (vru - vut) @ ahead, (vru - vut) @ np.array([-ahead[1], ahead[0]])


# The study's ten placements


def test_all_ten_published_placements_are_there():
    assert [golden["index"] for golden in GOLDEN] == list(range(10))


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: str(golden["index"]))
def test_published_starts_and_directions_are_the_generators(placements, golden):
    placement = _placement(placements, golden)
    assert placement.case.vru.name == VRU_NAMES[golden["vru"]]
    assert placement.case.vru_speed_kmh == golden["vru_speed_kmh"]
    for path, body in ((placement.vut_path, "vut"), (placement.vru_path, "vru")):
        assert to_carla_points(path.start_m).tolist() == golden[f"{body}_start"]
        assert to_carla_yaw(path.yaw_deg) % 360.0 == golden[f"{body}_yaw_deg"]


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: str(golden["index"]))
def test_published_vrus_are_at_the_collision_point_at_the_impact(placements, runs, golden):
    collision = np.array(golden["collision_point"])
    if golden["index"] == 5:
        # The generator's point lies 3 m beside the line on which its own cyclist rides, so that
        # the cyclist never reaches it. Ours meet where the two paths cross.
        assert collision[1] == pytest.approx(golden["vru_start"][1] - 3.0)
        collision[1] = golden["vru_start"][1]
    drives = _runs_of(runs, _placement(placements, golden))
    travel_s = math.dist(collision, golden["vru_start"]) / (golden["vru_speed_kmh"] / 3.6)
    assert len(drives) >= 8
    for run in drives:
        assert to_carla_points(run.vru_position_m[-1]) == pytest.approx(collision, abs=1e-6)
        assert run.encounter.vru_motion.start_time_s == pytest.approx(-travel_s, abs=1e-6)


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: str(golden["index"]))
def test_published_vuts_drive_over_the_collision_point(placements, golden):
    path = _placement(placements, golden).vut_path
    start, collision = np.array(golden["vut_start"]), np.array(golden["collision_point"])
    nearest, _ = path.at(math.dist(start, collision))
    assert to_carla_points(nearest) == pytest.approx(collision, abs=1e-6)


def test_the_study_junction_has_104_runs_with_unique_ids(runs):
    by_case = {
        name: sum(run.case.name == name for run in runs) for name in ("CPNC-50", "CBNA", "CBLA")
    }
    assert by_case == {"CPNC-50": 36, "CBNA": 36, "CBLA": 32}
    assert len(runs) == 104
    assert len({run.id for run in runs}) == 104
    assert "CPNC-50/east/20" in {run.id for run in runs}


# Every run


def test_without_braking_every_run_first_touches_at_time_0(runs):
    for run in runs:
        before = _separation(run.encounter, np.linspace(-25.0, -1e-3, 5001))
        at, after = _separation(run.encounter, np.array([0.0, 1e-3]))
        assert (before > 0.0).all(), run.id
        assert at == pytest.approx(0.0, abs=1e-9), run.id
        assert after < 0.0, run.id


def test_the_middle_of_the_vru_meets_the_middle_of_the_vuts_front(runs):
    for run in runs:
        vru = run.case.vru
        depth_m = vru.width_m if run.case.kind == "crossing" else vru.length_m
        ahead_m, left_m = _vru_in_vut_frame(run.encounter)
        assert ahead_m == pytest.approx(0.5 * (run.encounter.vut.length_m + depth_m), abs=1e-6)
        assert left_m == pytest.approx(0.0, abs=0.05), (
            run.id
        )  # CARLA's lanes are not quite straight


@pytest.mark.parametrize("impact_percent", [0.0, 25.0, 50.0, 75.0, 100.0])
def test_a_crossing_vru_is_met_at_the_stated_share_of_the_vuts_width(
    placements, actors, rule, impact_percent
):
    for placement in placements:
        if placement.case.kind != "crossing":
            continue
        case = dataclasses.replace(
            placement.case, impact_percent=impact_percent, vut_speeds_kmh=(40.0,)
        )
        (run,) = build_runs(
            [dataclasses.replace(placement, case=case)], vut=actors["vut"], rule=rule
        )
        _, left_m = _vru_in_vut_frame(run.encounter)
        right_edge_m = -0.5 * actors["vut"].width_m
        assert left_m == pytest.approx(
            right_edge_m + actors["vut"].width_m * impact_percent / 100.0, abs=1e-9
        )
        assert _separation(run.encounter, np.array([-1e-3]))[0] > 0.0
        assert _separation(run.encounter, np.array([0.0]))[0] == pytest.approx(0.0, abs=1e-9)


def test_frames_lie_on_the_10_hz_grid_and_end_at_the_impact(runs):
    for run in runs:
        n_frames = len(run.time_s)
        assert run.time_s.tolist() == [step / 10.0 for step in range(1 - n_frames, 1)]
        assert run.time_s[-1] == 0.0
        # All of the drive: one frame more would be before anybody sets off.
        first_s = min(run.encounter.vut_motion.start_time_s, run.encounter.vru_motion.start_time_s)
        assert run.time_s[0] >= first_s - 1e-6
        assert run.time_s[0] - 0.1 < first_s


def test_a_drive_of_whole_frames_keeps_its_first_frame(placements, actors, rule):
    # k / 10 s are not exact in binary: neither may rounding lose a frame, nor add one.
    placement = next(p for p in placements if p.case.kind == "longitudinal")
    case = dataclasses.replace(placement.case, vut_speeds_kmh=(30.0,))
    for n_steps in range(60, 160, 7):
        vru_m = n_steps / rule.frame_rate_hz * case.vru_speed_kmh / 3.6
        whole = dataclasses.replace(placement, case=case, vru_meeting_m=vru_m, vut_meeting_m=20.0)
        (run,) = build_runs([whole], vut=actors["vut"], rule=rule)
        assert len(run.time_s) == n_steps + 1
        assert run.vru_position_m[0] == pytest.approx(placement.vru_path.start_m, abs=1e-9)


def test_bodies_stand_at_their_start_before_they_set_off_and_then_keep_their_speed(runs):
    for run in runs:
        for motion, position, yaw in (
            (run.encounter.vut_motion, run.vut_position_m, run.vut_yaw_deg),
            (run.encounter.vru_motion, run.vru_position_m, run.vru_yaw_deg),
        ):
            waits = run.time_s <= motion.start_time_s
            assert (position[waits] == motion.path.start_m).all()
            steps = np.linalg.norm(np.diff(position[~waits], axis=0), axis=1)
            assert steps == pytest.approx(motion.speed_mps * 0.1, abs=1e-9)
            assert (yaw == motion.path.yaw_deg).all()
        assert run.encounter.vut_motion.speed_mps == pytest.approx(run.vut_speed_kmh / 3.6)
    assert any((run.time_s <= run.encounter.vut_motion.start_time_s).any() for run in runs)
    assert any((run.time_s <= run.encounter.vru_motion.start_time_s).any() for run in runs)


def test_the_vru_pose_depends_on_the_time_to_impact_only(placements, runs):
    for placement in placements:
        drives = _runs_of(runs, placement)
        shortest = min(len(run.time_s) for run in drives)
        first = drives[0].vru_position_m[-shortest:]
        assert shortest > 10
        for run in drives[1:]:
            assert np.array_equal(run.vru_position_m[-shortest:], first)
            assert np.array_equal(run.vru_yaw_deg[-shortest:], drives[0].vru_yaw_deg[-shortest:])


def test_every_run_can_be_avoided_and_none_at_the_impact(runs):
    for run in runs:
        assert run.time_s[0] < run.last_brake_time_s < 0.0


def test_arrays_of_a_run_are_read_only(runs):
    for field in ("time_s", "vut_position_m", "vut_yaw_deg", "vru_position_m", "vru_yaw_deg"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(runs[0], field)[0] = 0.0


# Placements from TOML

CROSSING = {
    "case": "CPNC-50",
    "approach": "east",
    "vut_start_m": [-50.0, -4.0],
    "vut_yaw_deg": 180.0,
    "vru_start_m": [-110.0, -15.0],
    "vru_yaw_deg": 90.0,
    "collision_point_m": [-110.0, -4.0],
}


def _load(monkeypatch, *entries):
    """What ``load_placements`` makes of a file; nothing is remembered."""
    monkeypatch.setattr(runs_module, "load_toml", lambda source: {"placements": list(entries)})
    return runs_module.load_placements.__wrapped__()


def _changed(**changes):
    entry = copy.deepcopy(CROSSING)
    for key, value in changes.items():
        if value is None:
            del entry[key]
        else:
            entry[key] = value
    return entry


def test_a_placement_carries_its_parked_bodies_into_every_run(monkeypatch, actors, rule):
    parked = {"actor": "parked-car-large", "position_m": [-100.0, -7.0], "yaw_deg": 90.0}
    (placement,) = _load(monkeypatch, _changed(obstruction=[parked]))
    (body,) = placement.obstruction
    assert isinstance(body, PlacedActor)
    assert body.actor is actors["parked-car-large"]
    assert body.pose.position_m.tolist() == [-100.0, 7.0, 0.0]
    assert (body.pose.yaw_deg, body.pose.pitch_deg) == (-90.0, 0.0)
    runs = build_runs([placement], vut=actors["vut"], rule=rule)
    assert len(runs) == 9
    assert all(run.obstruction == (body,) for run in runs)


@pytest.mark.parametrize("vru_yaw_deg", [89.1, 90.9])
def test_a_crossing_may_be_a_degree_out_of_square(monkeypatch, actors, rule, vru_yaw_deg):
    (placement,) = _load(monkeypatch, _changed(vru_yaw_deg=vru_yaw_deg))
    for run in build_runs([placement], vut=actors["vut"], rule=rule):
        assert _separation(run.encounter, np.array([0.0])) == pytest.approx(0.0, abs=0.01)


def test_a_placement_without_parked_bodies_has_none(monkeypatch):
    (placement,) = _load(monkeypatch, CROSSING)
    assert placement.obstruction == ()
    assert placement.vut_meeting_m == pytest.approx(60.0)
    assert placement.vru_meeting_m == pytest.approx(11.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"case": "CPTA"},
            "{0}.case: got 'CPTA'; expected one of CBLA, CBNA, CPNC-50",
        ),
        (
            {"approach": "up"},
            "{0}.approach: got 'up'; expected one of north, east, south, west",
        ),
        ({"vut_start_m": None}, "{0}.vut_start_m: got nothing; expected a value"),
        ({"vru_start_m": [1.0]}, "{0}.vru_start_m: got shape (1,); expected shape (2,)"),
        ({"vut_yaw_deg": "left"}, "{0}.vut_yaw_deg: got 'left'; expected a finite number"),
        (
            {"collision_point_m": [1.0, 2.0, 3.0]},
            "{0}.collision_point_m: got shape (3,); expected shape (2,)",
        ),
        (
            {"vru_yaw_deg": 180.0},
            "{0}: got paths at 0.0 degrees; expected perpendicular paths",
        ),
        (
            {"vru_yaw_deg": 30.0},
            "{0}: got paths at 30.0 degrees; expected perpendicular paths",
        ),
        (
            {"vru_yaw_deg": 91.5},
            "{0}: got paths at 88.5 degrees; expected perpendicular paths",
        ),
        (
            {"collision_point_m": [-110.0, -3.0]},
            "{0}.collision_point_m: got [-110.0, -3.0]; expected a point on the VUT's path",
        ),
        (
            {"vru_yaw_deg": 270.0},
            "{0}: got paths that meet behind a start; expected starts before the meeting point",
        ),
        (
            {"obstruction": [{"actor": "parked-car-large", "position_m": [1.0], "yaw_deg": 0.0}]},
            "{0}.obstruction[0].position_m: got shape (1,); expected shape (2,)",
        ),
    ],
)
def test_placements_say_what_is_wrong(monkeypatch, changes, message):
    with pytest.raises(InputError) as caught:
        _load(monkeypatch, _changed(**changes))
    assert str(caught.value) == message.format("town05_runs.toml: placements[0]")


# Frames of all runs


def test_frame_axis_lays_the_frames_of_runs_end_to_end(runs):
    some = runs[::20]
    axis = build_frame_axis(some, weight_per_run(some))
    assert axis.n_runs == len(some)
    assert axis.n_frames == sum(len(run.time_s) for run in some)
    for index, run in enumerate(some):
        assert np.array_equal(axis.time_s[axis.frames_of(index)], run.time_s)
        assert axis.run_ids[index] == run.id
        assert axis.cases[index] == run.case.name
        assert axis.approaches[index] == run.approach
        assert axis.vut_speed_kmh[index] == run.vut_speed_kmh
        assert axis.last_brake_time_s[index] == run.last_brake_time_s


def test_frame_axis_of_no_run_is_refused():
    with pytest.raises(InputError) as caught:
        build_frame_axis([], np.zeros(0))
    assert str(caught.value) == "runs: got none; expected at least one run"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"weight": [0.5, 0.5]},
            "weight: got shape (2,); expected shape (3,)",
        ),
        (
            {"weight": [0.5, 0.5, 0.5]},
            "weight: got [0.5, 0.5, 0.5]; expected shares >= 0 that sum to 1",
        ),
        (
            {"weight": [1.5, -0.5, 0.0]},
            "weight: got [1.5, -0.5, 0.0]; expected shares >= 0 that sum to 1",
        ),
        (
            {"last_brake_time_s": [0.0, math.nan, 0.0]},
            "last_brake_time_s: got [0.0, nan, 0.0]; expected one time per run",
        ),
        (
            {"last_brake_time_s": [0.0]},
            "last_brake_time_s: got [0.0]; expected one time per run",
        ),
        (
            {"run_start": [0, 3, 3, 10]},
            "run_start: got [0, 3, 3, 10]; expected 0 and ascending, one more than runs",
        ),
        (
            {"run_start": [1, 3, 8, 10]},
            "run_start: got [1, 3, 8, 10]; expected 0 and ascending, one more than runs",
        ),
        (
            {"run_start": [0, 3, 10]},
            "run_start: got [0, 3, 10]; expected 0 and ascending, one more than runs",
        ),
        ({"run_start": [0, 3, 8, 11]}, "time_s: got 10 frames; expected 11"),
        (
            {"time_s": [-0.2, -0.1, 0.0, -0.4, -0.2, -0.3, -0.1, 0.0, -0.1, 0.0]},
            "time_s: got -0.2 before -0.3; expected times that ascend within a run",
        ),
        (
            {"time_s": [-0.2, -0.1, 0.0, -0.4, -0.3, -0.2, -0.1, 0.0, 0.0, 0.0]},
            "time_s: got 0.0 before 0.0; expected times that ascend within a run",
        ),
        (
            {"run_start": [0, 4, 8, 10]},
            "time_s: got 0.0 before -0.4; expected times that ascend within a run",
        ),
        (
            {"vut_speed_kmh": [1.0, math.inf, 2.0]},
            "vut_speed_kmh: got [1.0, inf, 2.0]; expected finite numbers",
        ),
    ],
)
def test_frame_axis_says_what_is_wrong(frame_axis, change, message):
    with pytest.raises(InputError) as caught:
        dataclasses.replace(frame_axis, **change)
    assert str(caught.value) == message


def test_frame_axis_allows_runs_that_nothing_avoids(frame_axis):
    assert isinstance(frame_axis, FrameAxis)
    assert frame_axis.last_brake_time_s[2] == -np.inf
    assert [frame_axis.frames_of(index) for index in range(3)] == [
        slice(0, 3),
        slice(3, 8),
        slice(8, 10),
    ]


def test_a_longitudinal_case_needs_one_heading():
    entry = {
        "case": "CBLA",
        "approach": "east",
        "vut_start_m": [0.0, 0.0],
        "vut_yaw_deg": 180.0,
        "vru_start_m": [-20.0, 0.0],
        "vru_yaw_deg": 90.0,
        "collision_point_m": [-40.0, 0.0],
    }
    with pytest.raises(InputError, match="expected one heading for VUT and VRU"):
        runs_module._build_placement(entry, "runs.toml: placements[0]")
