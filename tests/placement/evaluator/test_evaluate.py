from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry.errors import InputError
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.detector import Detector
from placement.evaluator import evaluate
from placement.evaluator.evaluate import evaluate_layout, evaluate_layouts
from placement.evaluator.perceive import Boxes, perceive_from_roadside
from placement.evaluator.surroundings import build_surroundings
from placement.layout import Layout
from scenarios.aeb import has_contact, is_in_time, load_aeb_rule
from scenarios.runs import build_frame_axis

DETECTOR = Detector(min_iou=0.5, min_box_height_px=10.0)
RULE = load_aeb_rule()


@pytest.fixture(scope="module")
def axis(study_runs):
    return build_frame_axis(study_runs, np.full(len(study_runs), 1.0 / len(study_runs)))


@pytest.fixture
def build_layout(camera):
    def build(*names, x_m=0.0):
        return Layout(
            name="test",
            units=tuple(
                CandidatePose(
                    id=name,
                    site_id="",
                    pose=Pose(
                        position_m=np.array([x_m + index, 0.0, 7.0]), yaw_deg=0.0, pitch_deg=-20.0
                    ),
                    camera=camera,
                )
                for index, name in enumerate(names)
            ),
        )

    return build


@pytest.fixture
def pretend(monkeypatch, build_layout, build_scene, study_runs, axis):
    """Evaluate detections given by hand, one row per unit, instead of those rendered."""

    def evaluate_rows(*unit_rows, vut_row=None, rule=RULE):
        rows = np.array(unit_rows, dtype=bool)
        by_vut = np.zeros(axis.n_frames, dtype=bool) if vut_row is None else vut_row

        def boxes(row):
            box = np.where(row[:, None], [0.0, 0.0, 50.0, 50.0], 0.0)
            return Boxes(amodal_px=box, visible_px=box)

        def from_roadside(surroundings, pose, camera, *, min_height_px):
            return boxes(rows[round(float(pose.position_m[0]))])

        def from_vut(surroundings, vut_camera, *, min_height_px):
            return boxes(by_vut)

        monkeypatch.setattr(evaluate, "_VUT_JOBS", 1)  # all frames at once
        monkeypatch.setattr(evaluate, "perceive_from_roadside", from_roadside)
        monkeypatch.setattr(evaluate, "perceive_from_vut", from_vut)
        return evaluate_layout(
            build_layout(*(f"unit {index}" for index in range(len(rows)))),
            build_scene(),
            study_runs,
            axis,
            rule=rule,
            detector=DETECTOR,
        )

    return evaluate_rows


def _frames(axis, run_index, *frames):
    row = np.zeros(axis.n_frames, dtype=bool)
    row[axis.run_start[run_index] + np.array(frames, dtype=np.int64)] = True
    return row


def test_third_consecutive_frame_confirms(pretend, axis):
    two, three = _frames(axis, 0, 1, 2, 4, 5), _frames(axis, 0, 1, 2, 4, 5, 6)
    evaluation = pretend(two, three)
    assert np.isinf(evaluation.units["unit 0"].confirmation_time_s).all()
    assert not evaluation.units["unit 0"].is_avoided.any()
    verdict = evaluation.units["unit 1"]
    assert verdict.confirmation_time_s[0] == axis.time_s[6]
    assert np.isinf(verdict.confirmation_time_s[1:]).all()
    assert verdict.is_avoided.tolist() == [True] + [False] * (axis.n_runs - 1)
    assert (verdict.detected == three).all()


def test_fused_units_confirm_together_what_none_confirms_alone(pretend, axis):
    evaluation = pretend(_frames(axis, 0, 1, 3), _frames(axis, 0, 2), vut_row=_frames(axis, 1, 3))
    assert all(np.isinf(v.confirmation_time_s).all() for v in evaluation.units.values())
    assert evaluation.rsu_all.confirmation_time_s[0] == axis.time_s[3]
    assert evaluation.rsu_all.is_avoided[0]
    assert not evaluation.vut.is_avoided.any()
    assert (evaluation.rsu_all.detected == _frames(axis, 0, 1, 2, 3)).all()


def test_vut_counts_among_the_fused_with_the_units(pretend, axis):
    evaluation = pretend(_frames(axis, 0, 1, 2), vut_row=_frames(axis, 0, 3))
    assert not evaluation.rsu_all.is_avoided.any()
    assert evaluation.vut_and_rsus.is_avoided[0]
    assert (evaluation.vut.detected == _frames(axis, 0, 3)).all()


def test_confirmation_does_not_reach_over_the_border_of_two_runs(pretend, axis):
    border = int(axis.run_start[1])
    row = np.zeros(axis.n_frames, dtype=bool)
    row[border - 2 : border + 2] = True
    evaluation = pretend(row)
    assert np.isinf(evaluation.rsu_all.confirmation_time_s).all()


@pytest.mark.parametrize(("late_s", "is_avoided"), [(0.0, True), (0.001, False)])
def test_braking_at_the_last_moment_avoids_and_later_does_not(pretend, axis, late_s, is_avoided):
    row = _frames(axis, 0, 1, 2, 3)
    latency_s = float(axis.last_brake_time_s[0] - axis.time_s[3]) + late_s
    evaluation = pretend(row, rule=replace(RULE, latency_s=latency_s))
    assert evaluation.rsu_all.is_avoided[0] == is_avoided


def test_same_onset_is_judged_run_by_run(pretend, axis):
    middle_s = (axis.last_brake_time_s.min() + axis.last_brake_time_s.max()) / 2.0
    row = axis.time_s >= middle_s - 0.2  # too late for the fast runs only
    verdict = pretend(row).rsu_all
    assert np.ptp(verdict.confirmation_time_s) < 1e-9
    expected = is_in_time(
        verdict.confirmation_time_s, axis.last_brake_time_s, latency_s=RULE.latency_s
    )
    assert (verdict.is_avoided == expected).all()
    assert len(set(expected.tolist())) == 2


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_avoided_is_no_contact_and_agrees_with_the_last_brake_time(study_runs, axis, seed):
    rng = np.random.default_rng(seed)
    row = rng.random(axis.n_frames) < rng.uniform(0.05, 0.5)
    verdict = evaluate._Judge(study_runs, axis, RULE).verdict(row)
    onset_s = verdict.confirmation_time_s + RULE.latency_s
    touches = [
        has_contact(run.encounter, onset, RULE)
        for run, onset in zip(study_runs, onset_s.tolist(), strict=True)
    ]
    assert (verdict.is_avoided == ~np.array(touches)).all()
    in_time = is_in_time(
        verdict.confirmation_time_s, axis.last_brake_time_s, latency_s=RULE.latency_s
    )
    assert (verdict.is_avoided == in_time).all()


def test_threads_and_company_do_not_change_a_verdict(build_layout, build_scene, study_runs, axis):
    middle = study_runs[0].vru_position_m[-1]
    scene = build_scene(((-300.0, -300.0, -1.0), (300.0, 300.0, 0.0)))
    a = build_layout("a", "b", x_m=float(middle[0]) - 12.0)
    b = build_layout("c", x_m=float(middle[0]) - 12.0)  # stands where "a" stands
    n_done = []
    together = evaluate_layouts(
        [a, b],
        scene,
        study_runs,
        axis,
        rule=RULE,
        detector=DETECTOR,
        workers=2,
        on_progress=lambda done, total: n_done.append((done, total)),
    )
    alone = evaluate_layout(b, scene, study_runs, axis, rule=RULE, detector=DETECTOR)
    # Two different poses, and the VUT in four parts.
    assert n_done == [(done, 6) for done in range(1, 7)]
    assert (together[0].units["a"].detected == together[1].units["c"].detected).all()
    for name in ("vut", "rsu_all", "vut_and_rsus"):
        assert (getattr(together[1], name).detected == getattr(alone, name).detected).all()
    boxes = perceive_from_roadside(
        build_surroundings(scene, study_runs), b.units[0].pose, b.units[0].camera
    )
    expected = DETECTOR.is_detected(boxes.visible_px, boxes.amodal_px)
    assert (alone.units["c"].detected == expected).all()
    assert [unit.id for unit in together[0].layout.units] == list(together[0].units)


def test_runs_of_two_frames_are_too_short_to_confirm(build_layout, build_scene, build_run, block):
    run = build_run(block, [[9.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    evaluation = evaluate_layout(
        build_layout("a"),
        build_scene(),
        [run],
        build_frame_axis([run], np.ones(1)),
        rule=RULE,
        detector=DETECTOR,
    )
    assert evaluation.rsu_all.detected.all()
    assert not evaluation.vut_and_rsus.is_avoided.any()


def test_interruption_leaves_the_other_units_unseen(
    monkeypatch, build_layout, build_scene, study_runs, axis
):
    n_seen = []

    def from_roadside(surroundings, pose, camera, *, min_height_px):
        n_seen.append(1)
        nothing = np.zeros((len(surroundings.vru_poses), 4))
        return Boxes(amodal_px=nothing, visible_px=nothing)

    def from_vut(surroundings, vut_camera, *, min_height_px):
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "perceive_from_roadside", from_roadside)
    monkeypatch.setattr(evaluate, "perceive_from_vut", from_vut)
    with pytest.raises(KeyboardInterrupt):
        evaluate_layout(
            build_layout(*map(str, range(500))),
            build_scene(),
            study_runs,
            axis,
            rule=RULE,
            detector=DETECTOR,
        )
    assert len(n_seen) < 500


def test_wrong_axis_and_workers_are_named(build_layout, build_scene, study_runs, axis):
    layout, scene = build_layout("a"), build_scene()
    with pytest.raises(InputError, match="axis: got frames of other runs; expected the frame axis"):
        evaluate_layout(layout, scene, study_runs[1:], axis, rule=RULE, detector=DETECTOR)
    with pytest.raises(InputError, match="workers: got 0; expected a whole number, at least 1"):
        evaluate_layout(layout, scene, study_runs, axis, rule=RULE, detector=DETECTOR, workers=0)
