from dataclasses import replace

import numpy as np
import pytest

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.detectors import load_detector, load_planning_detector
from placement.explain import sensitivity as brakes_module
from placement.explain.sensitivity import (
    MAX_LOOKED_FROM,
    RANGES,
    SURE,
    Assumption,
    find_sensitivity,
    load_assumptions,
    prepare_sensitivity,
    read_assumptions,
)
from placement.layout import Layout
from placement.optimiser import placement_value
from placement.setting import Setting
from placement.visibility import build as build_module
from placement.visibility import build_detection_table
from placement.visibility.build import detected_frames
from placement.wishes import Wishes, build_problem
from scenarios.cases import pick_cases
from scenarios.runs import build_frame_axis, build_runs
from scenarios.weights import weight_per_run

CAMERA = load_cameras()["carla-ncap-rgb-90"]
WAYS = ("CBNA/east/60", "CPNC-50/east/55", "CPNC-50/west/60", "CBNA/south/60", "CBLA/east/25")


def setting_of(runs, rule):
    few = tuple(run for run in runs if run.id in WAYS)
    return Setting(
        scene=load_study_scene(),
        runs=few,
        axis=build_frame_axis(few, weight_per_run(few)),
        rule=rule,
        detector=load_detector(),
        table_detector=load_planning_detector(),
    )


@pytest.fixture(scope="module")
def setting(runs, rule):
    return setting_of(runs, rule)


def unit(name, x, y, yaw_deg, pitch_deg=-30.0):
    pose = Pose(position_m=np.array([x, y, 6.0]), yaw_deg=yaw_deg, pitch_deg=pitch_deg)
    return CandidatePose(id=name, site_id="", pose=pose, sensor=CAMERA)


@pytest.fixture(scope="module")
def layout():
    return Layout(
        name="two",
        units=(unit("a", -115.4, 8.85, -135.0), unit("b", -115.4, 8.85, -45.0)),
    )


@pytest.fixture(scope="module")
def found(setting, layout):
    return find_sensitivity(setting, layout)


def value_of(setting, units):
    """What the detection table says of units, by the functions that the optimiser uses."""
    table = build_detection_table(
        setting.scene, units, setting.runs, setting.axis, detector=setting.table_detector
    )
    wishes = Wishes(budget_units=len(units), existing=tuple(one.id for one in units[1:]))
    problem = build_problem(setting, units, table, wishes=wishes)
    return placement_value(problem, range(len(units)))


def assert_same(outcome, value):
    assert outcome.apr == pytest.approx(value.apr)
    assert outcome.apr_one_failed == pytest.approx(value.apr_one_failed)
    assert (outcome.smallest_margin_s or 0.0) == pytest.approx(value.smallest_margin_s)


def varied_of(found, name):
    """All values of an assumption."""
    return next(one.varied for one in found.assumptions if one.name == name)


def outcome_at(found, name, value):
    (varied,) = (one for one in varied_of(found, name) if one.value == value)
    return varied


def test_as_planned_it_is_what_the_table_says(setting, layout, found):
    value = value_of(setting, layout.units)
    assert 0.0 < value.apr < 1.0  # else there is little to see
    assert_same(found.planned, value)
    assert {one.left_out for one in found.assumptions} == {""}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("latency_s", 0.5),
        ("n_confirmations", 1.0),
        ("n_confirmations", 5.0),
        ("track_memory_s", 0.5),
        ("track_memory_s", 2.0),
    ],
)
def test_another_rule_is_that_rule(setting, layout, found, name, value):
    given = int(value) if name == "n_confirmations" else value
    changed = replace(setting, rule=replace(setting.rule, **{name: given}))
    assert_same(outcome_at(found, name, value), value_of(changed, layout.units))


@pytest.mark.parametrize("deceleration", [5.0, 9.0])
def test_other_brakes_are_as_if_the_runs_were_built_with_them(
    setting, layout, found, actors, rule, deceleration
):
    changed = replace(rule, deceleration_mps2=deceleration)
    cases = pick_cases("CPNC-50,CBNA,CBLA", "cases")
    # Of each case only what is asked for is laid anew.
    cases = [
        replace(
            case,
            vut_speeds_kmh=tuple(
                dict.fromkeys(
                    float(way.split("/")[2]) for way in WAYS if way.split("/")[0] == case.name
                )
            ),
        )
        for case in cases
    ]
    runs, _ = build_runs(load_study_scene(), cases, vut=actors["vut"], rule=changed)
    anew = setting_of(runs, changed)
    assert sorted(run.id for run in anew.runs) == sorted(run.id for run in setting.runs)
    assert_same(outcome_at(found, "deceleration_mps2", deceleration), value_of(anew, layout.units))


@pytest.mark.parametrize(
    ("name", "change"),
    [("min_iou", {"min_iou": 0.7}), ("min_box_height_share", {"min_box_height_px": 60.0})],
)
def test_another_detector_is_that_detector(setting, layout, found, name, change):
    changed = replace(setting, table_detector=replace(setting.table_detector, **change))
    value = varied_of(found, name)[-1].value
    assert_same(outcome_at(found, name, value), value_of(changed, layout.units))


@pytest.mark.parametrize(
    ("name", "value", "offset_m", "yaw_deg", "pitch_deg"),
    [
        ("yaw_deg", 2.0, [0.0, 0.0, 0.0], 2.0, 0.0),
        ("pitch_deg", -2.0, [0.0, 0.0, 0.0], 0.0, -2.0),
        ("height_m", -0.25, [0.0, 0.0, -0.25], 0.0, 0.0),
    ],
)
def test_all_units_are_off_alike(setting, layout, found, name, value, offset_m, yaw_deg, pitch_deg):
    moved = [
        replace(
            one,
            pose=Pose(
                position_m=one.pose.position_m + offset_m,
                yaw_deg=one.pose.yaw_deg + yaw_deg,
                pitch_deg=one.pose.pitch_deg + pitch_deg,
            ),
        )
        for one in layout.units
    ]
    assert_same(outcome_at(found, name, value), value_of(setting, moved))


def test_moved_ahead_means_where_each_unit_looks(setting, layout, found):
    half = 0.25 / np.sqrt(2.0)
    moved = [
        replace(one, pose=replace(one.pose, position_m=one.pose.position_m + [east, -half, 0.0]))
        for one, east in zip(layout.units, (-half, half), strict=True)
    ]
    assert_same(outcome_at(found, "position_m", 0.25), value_of(setting, moved))


def test_rays_to_what_is_in_view_give_the_rows_of_the_table(setting, layout):
    units = [*layout.units, unit("c", -115.4, 8.85, 170.0, -10.0), layout.units[0]]
    table = build_detection_table(
        setting.scene, units, setting.runs, setting.axis, detector=setting.table_detector
    )
    looks = [(one, setting.table_detector) for one in units]
    frames = detected_frames(setting, looks, stage="looks", compute=Compute())
    assert frames[:2].any(axis=1).all()
    assert (frames == table.detected(slice(None))).all()


def test_what_a_plan_does_not_ask_is_left_out(setting, layout):
    changed = replace(setting, table_detector=load_planning_detector("response"))
    (iou,) = (one for one in load_assumptions() if one.name == "min_iou")
    (one,) = find_sensitivity(changed, layout, assumptions=[iou]).assumptions
    assert (one.planned_value, one.varied) == (None, ())
    assert "no such limit" in one.left_out


def test_the_plans_own_value_drops_out(setting, layout):
    own = [
        Assumption(name=name, values=values, reason="so", is_ours=True)
        for name, values in (
            ("latency_s", (setting.rule.latency_s, 0.2)),
            ("track_memory_s", (1.0, np.inf)),
        )
    ]
    endless = find_sensitivity(setting, layout, assumptions=own)
    latency, memory = endless.assumptions
    assert [varied.value for varied in latency.varied] == [0.2]
    assert [varied.value for varied in memory.varied] == [1.0]
    mortal = replace(setting, rule=replace(setting.rule, track_memory_s=1.0))
    found = find_sensitivity(mortal, layout, assumptions=own[1:])
    (other,) = found.assumptions
    assert [varied.value for varied in other.varied] == [None]
    assert (memory.planned_value, other.planned_value) == (None, 1.0)
    assert other.varied[0].apr == endless.planned.apr
    assert found.planned.apr == memory.varied[0].apr


def test_of_large_layouts_only_what_needs_no_new_look_is_varied(setting):
    units = tuple(
        replace(unit("a", -115.4, 8.85, -135.0 + index), id=f"u{index}")
        for index in range(MAX_LOOKED_FROM + 1)
    )
    seen = []
    found = find_sensitivity(
        setting,
        Layout(name="many", units=units),
        compute=Compute(progress=lambda stage, done, total: seen.append((done, total))),
    )
    left_out = {one.name for one in found.assumptions if one.left_out}
    assert left_out == {
        "min_box_height_share", "min_iou", "yaw_deg", "pitch_deg", "height_m", "position_m",
    }  # fmt: skip
    assert all("30 units" in one.left_out for one in found.assumptions if one.left_out)
    assert seen == [(0, 0), (1, 1)]


def test_a_unit_that_would_be_inside_something_stays(setting, layout):
    low = replace(
        layout.units[0], pose=replace(layout.units[0].pose, position_m=[-115.4, 8.85, 0.2])
    )
    (height,) = (one for one in load_assumptions() if one.name == "height_m")
    (one,) = find_sensitivity(
        setting, Layout(name="low", units=(low, layout.units[1])), assumptions=[height]
    ).assumptions
    assert [varied.unmoved for varied in one.varied] == [("a",), ()]


def test_what_is_lost_of_the_apr_are_the_runs_lost(setting, found):
    weights = dict(zip(setting.axis.run_ids, setting.axis.weight, strict=True))
    for one in found.assumptions:
        for varied in one.varied:
            lost = sum(weights[run] for run in varied.lost_runs) / sum(weights.values())
            assert found.planned.apr - varied.apr <= lost + 1.0 - SURE


GOOD = {"latency_s": {"values": [0.3, 0.0, 0.3], "source": "somewhere"}}


def test_every_assumption_is_varied_and_says_why():
    found = load_assumptions()
    assert {one.name for one in found} == set(RANGES)
    for one in found:
        assert one.reason
        assert list(one.values) == sorted(set(one.values))


def test_values_are_sorted_and_reasons_told_apart():
    (one,) = read_assumptions(GOOD, "mine.toml")
    assert (one.values, one.reason, one.is_ours) == ((0.0, 0.3), "somewhere", False)
    (other,) = read_assumptions({"yaw_deg": {"values": [1], "assumption": "so"}}, "mine.toml")
    assert other.is_ours


@pytest.mark.parametrize(
    ("document", "where"),
    [
        ({"colour": {}}, "mine.toml: colour"),
        ({"latency_s": 3}, "mine.toml: latency_s"),
        ({"latency_s": {"values": [0.1], "source": "a", "more": 1}}, "mine.toml: latency_s.more"),
        ({"latency_s": {"values": [], "source": "a"}}, "mine.toml: latency_s.values"),
        ({"latency_s": {"values": [0.1, -1.0], "source": "a"}}, "mine.toml: latency_s.values[1]"),
        ({"n_confirmations": {"values": [1.5], "source": "a"}}, "n_confirmations.values[0]"),
        ({"packet_loss": {"values": ["all"], "source": "a"}}, "packet_loss.values[0]"),
        ({"latency_s": {"values": [np.inf], "source": "a"}}, "latency_s.values[0]"),
        ({"track_memory_s": {"values": [0.0], "source": "a"}}, "track_memory_s.values[0]"),
        ({"track_memory_s": {"values": [np.nan], "source": "a"}}, "track_memory_s.values[0]"),
        ({"latency_s": {"values": [0.1]}}, "mine.toml: latency_s"),
        ({"latency_s": {"values": [0.1], "source": "a", "assumption": "b"}}, "latency_s"),
    ],
)
def test_what_cannot_be_is_refused_where_it_stands(document, where):
    with pytest.raises(InputError) as caught:
        read_assumptions(document, "mine.toml")
    assert where in caught.value.where


def test_the_second_call_looks_at_nothing_and_says_the_same(
    setting, layout, found, tmp_path, monkeypatch
):
    compute = Compute(workers=1, cache_folder=tmp_path)
    kept = find_sensitivity(setting, layout, compute=compute)

    def never(*_, **__):
        raise AssertionError("looked again")

    monkeypatch.setattr(build_module, "build_world", never)
    monkeypatch.setattr(brakes_module, "last_brake_time_s", never)
    again = find_sensitivity(setting, layout, compute=compute)
    for one in (kept, again):
        assert one == found
    slower = replace(setting, rule=replace(setting.rule, build_up_s=0.3))
    with pytest.raises(AssertionError, match="looked again"):
        find_sensitivity(slower, layout, compute=compute)


def test_brake_times_found_before_the_layout_are_not_found_again(
    setting, layout, found, tmp_path, monkeypatch
):
    compute = Compute(workers=1, cache_folder=tmp_path)
    prepare_sensitivity(setting, compute=compute)

    def never(*_):
        raise AssertionError("braked again")

    monkeypatch.setattr(brakes_module, "last_brake_time_s", never)
    brakes = [one for one in load_assumptions() if one.name == "deceleration_mps2"]
    (again,) = find_sensitivity(setting, layout, assumptions=brakes, compute=compute).assumptions
    assert again.varied == varied_of(found, "deceleration_mps2")
    with pytest.raises(AssertionError, match="braked again"):
        find_sensitivity(setting, layout, assumptions=brakes, compute=Compute(workers=1))
