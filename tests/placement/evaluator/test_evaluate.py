"""Layouts evaluated in the study's runs: who is fused, messages, luck, weathers."""

from dataclasses import replace

import numpy as np
import pytest
from evidences import build_evidence
from refusals import refused_with
from tiny_worlds import unit_at

from geometry.catalogue import pick_sensor
from geometry.errors import InputError
from placement.compute import Compute
from placement.detectors import load_detector
from placement.evaluator import evaluate, perceive
from placement.evaluator.evaluate import (
    evaluate_again,
    evaluate_layout,
    evaluate_layouts,
)
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.surroundings import VutCamera, build_surroundings
from placement.layout import Layout
from placement.setting import Radio
from scenarios.aeb import load_aeb_rule
from scenarios.runs import build_frame_axis

RULE = load_aeb_rule()
LIDAR = pick_sensor("carla-ncap-lidar", "test")
GROUND = (
    (-300.0, -300.0, -1.0),
    (300.0, 300.0, 0.0),
)


@pytest.fixture(scope="module")
def setting(build_setting, build_scene, study_runs):
    """The study's runs in an empty scene."""
    return build_setting(build_scene(), study_runs)


@pytest.fixture(scope="module")
def axis(setting):
    """Frames of the study's runs."""
    return setting.axis


@pytest.fixture
def build_layout(camera):
    """Builds a layout of cameras by their names."""

    def build(*names, x_m=0.0, latencies_s=None, sensor=camera):
        return Layout(
            name="test",
            units=tuple(
                unit_at(
                    name,
                    [x_m + index, 0.0, 7.0],
                    pitch_deg=-20.0,
                    sensor=sensor,
                    latency_s=None if latencies_s is None else latencies_s[index],
                )
                for index, name in enumerate(names)
            ),
        )

    return build


@pytest.fixture
def pretend(monkeypatch, build_layout, setting, axis):
    """Evaluate detections given by hand, one row per unit, instead of those
    rendered.
    """

    def evaluate_rows(
        *unit_rows,
        vut_row=None,
        vut_lidar_row=None,
        latencies_s=None,
        seed=0,
        **changes,
    ):
        rows = np.array(unit_rows, dtype=bool)
        nothing = np.zeros(axis.n_frames, dtype=bool)
        if vut_row is None:
            by_vut = nothing
        else:
            by_vut = vut_row

        def evidence(row, surroundings):
            box_px = [0.0, 0.0, 50.0, 50.0]
            box = np.where(row[:, None], box_px, 0.0)
            return build_evidence(box, draw_index=surroundings.draw_index)

        def from_camera(surroundings, by, *, min_height_px):
            is_of_vut = isinstance(by, VutCamera)
            if is_of_vut:
                row = by_vut
            else:
                x_m = by[0].position_m[0]
                row = rows[round(float(x_m))]
            return evidence(row, surroundings)

        def by_vut_lidar(surroundings, mount, lidar, rng):
            return vut_lidar_row

        monkeypatch.setattr(evaluate, "_VUT_JOBS", 1)  # all frames at once
        monkeypatch.setattr(perceive, "perceive_frames", from_camera)
        monkeypatch.setattr(perceive, "scan_frames", by_vut_lidar)
        numbers = range(len(rows))
        names = [f"unit {index}" for index in numbers]
        return evaluate_layout(
            build_layout(*names, latencies_s=latencies_s),
            replace(setting, **changes),
            compute=Compute(seed=seed),
        )

    return evaluate_rows


def _frames(axis, run_index, *frames):
    """All frames (n_frames,), true in these of one run."""
    row = np.zeros(axis.n_frames, dtype=bool)
    row[axis.run_start[run_index] + np.array(frames, dtype=np.int64)] = True
    return row


def _verdicts(evaluation):
    """Verdicts of an evaluation by party."""
    return {
        "vut": evaluation.vut,
        "rsu_all": evaluation.rsu_all,
        "vut_and_rsus": evaluation.vut_and_rsus,
        **evaluation.units,
        **evaluation.others,
    }


def _is_equal(verdict, other):
    """Are all arrays of two verdicts equal?"""
    return all(
        np.array_equal(getattr(verdict, field), getattr(other, field))
        for field in (
            "detected",
            "confirmation_time_s",
            "onset_time_s",
            "is_avoided",
            "impact_speed_kmh",
        )
    )


# Confirmation and fusion


def test_fused_units_confirm_together_what_none_confirms_alone(pretend, axis):
    vut_row = _frames(axis, 1, 3)
    first_row = _frames(axis, 0, 1, 3)
    second_row = _frames(axis, 0, 2)
    evaluation = pretend(first_row, second_row, vut_row=vut_row)

    for v in evaluation.units.values():
        is_never = np.isinf(v.confirmation_time_s)
        assert is_never.all()

    found_s = evaluation.rsu_all.confirmation_time_s[0]
    expected = _frames(axis, 0, 1, 2, 3)

    assert found_s == axis.time_s[3]
    assert evaluation.rsu_all.is_avoided[0]
    assert not evaluation.vut.is_avoided.any()
    assert (evaluation.rsu_all.detected == expected).all()


def test_vut_counts_among_the_fused_with_the_units(pretend, axis):
    vut_row = _frames(axis, 0, 3)
    row = _frames(axis, 0, 1, 2)
    evaluation = pretend(row, vut_row=vut_row)
    expected_by_vut = _frames(axis, 0, 3)

    assert not evaluation.rsu_all.is_avoided.any()
    assert evaluation.vut_and_rsus.is_avoided[0]
    assert (evaluation.vut.detected == expected_by_vut).all()


# Radio


def test_without_any_message_the_vut_is_left_alone(pretend, axis):
    row = _frames(axis, 0, *range(9))
    by_vut = _frames(axis, 1, *range(4, 9))
    lost = pretend(
        row,
        row,
        vut_row=by_vut,
        radio=Radio(packet_loss=1.0),
    )
    none_lost = pretend(
        row,
        row,
        vut_row=by_vut,
        radio=Radio(packet_loss=0.0),
        seed=5,
    )
    plain = pretend(row, row, vut_row=by_vut)

    assert not lost.rsu_all.detected.any()
    for unit in lost.units.values():
        assert not unit.detected.any()

    assert _is_equal(lost.vut, plain.vut)
    assert _is_equal(lost.vut_and_rsus, plain.vut)

    for name, verdict in _verdicts(plain).items():
        assert _is_equal(_verdicts(none_lost)[name], verdict)


def test_messages_are_lost_as_often_as_said_and_unit_by_unit(pretend, axis):
    row = np.ones(axis.n_frames, dtype=bool)
    links = Radio(packet_loss=0.3)
    two = pretend(row, row, vut_row=row, radio=links)
    one = pretend(row, radio=links)
    verdicts = two.units.values()
    a, b = (unit.detected for unit in verdicts)
    n = axis.n_frames

    both = a & b

    # Five standard deviations of a binomial distribution.
    for share, mean in (
        (a.mean(), 0.7),
        (b.mean(), 0.7),
        (both.mean(), 0.49),
    ):
        variance = mean * (1.0 - mean) / n
        assert share == pytest.approx(mean, abs=5.0 * np.sqrt(variance))

    is_either = two.rsu_all.detected == (a | b)
    is_as_before = one.units["unit 0"].detected == a

    assert is_either.all()
    assert two.vut.detected.all()
    assert two.vut_and_rsus.detected.all()
    # Luck is a unit's own: whatever else is in the layout, but for the seed.
    assert is_as_before.all()

    again = pretend(row, radio=links, seed=1)
    other = again.units["unit 0"].detected

    assert (other != a).any()


def test_road_users_that_announce_themselves_are_a_source_of_their_own(pretend, axis):
    by_unit = _frames(axis, 0, 1, 2, 3)
    nothing = np.zeros(axis.n_frames, dtype=bool)
    radio = Radio(vam_rate=0.0)
    nobody = pretend(by_unit, radio=radio)

    assert nobody.others == {}

    every_vam = Radio(vam_rate=1.0)
    all_equipped = pretend(by_unit, radio=every_vam)
    sources = list(all_equipped.others)

    assert sources == ["vam", "all_sources"]

    vam = all_equipped.others["vam"]

    assert vam.detected.all()

    expected = [
        axis.time_s[start + 2] + RULE.latency_s for start in axis.run_start[:-1]
    ]

    assert vam.onset_time_s.tolist() == expected
    assert _is_equal(all_equipped.rsu_all, pretend(by_unit).rsu_all)

    some = pretend(
        by_unit,
        vut_row=nothing,
        radio=Radio(vam_rate=0.5),
        seed=3,
    )
    both = some.others["vam"].detected | some.vut_and_rsus.detected
    is_both = some.others["all_sources"].detected == both
    is_no_worse = some.others["all_sources"].is_avoided >= some.rsu_all.is_avoided

    assert is_both.all()
    assert is_no_worse.all()


# The VUT's own sensors


@pytest.mark.parametrize(
    ("sensors", "expected"),
    [
        (("camera",), [1, 2]),
        (("lidar",), [2, 3]),
        (("camera", "lidar"), [1, 2, 3]),
        (("lidar", "camera"), [1, 2, 3]),
    ],
)
def test_the_vut_looks_with_what_it_has(pretend, axis, sensors, expected):
    evaluation = pretend(
        np.zeros(axis.n_frames, dtype=bool),
        vut_row=_frames(axis, 0, 1, 2),
        vut_lidar_row=_frames(axis, 0, 2, 3),
        vut_sensors=sensors,
    )
    frames = _frames(axis, 0, *expected)
    is_avoided = evaluation.vut.is_avoided[0]

    assert (evaluation.vut.detected == frames).all()
    assert is_avoided == (len(expected) == 3)


def test_unknown_sensors_of_the_vut_and_shares_beyond_one_are_named(setting):
    with refused_with(
        "vut_sensors: got 'radar'; expected one or more of camera, lidar"
    ):
        replace(setting, vut_sensors=("camera", "radar"))

    with pytest.raises(
        InputError, match="vut_sensors: got 'none'; expected one or more of"
    ):
        replace(setting, vut_sensors=())

    with pytest.raises(InputError, match=r"packet_loss: got 1\.1; expected 0 \.\. 1"):
        Radio(packet_loss=1.1)

    with pytest.raises(InputError, match=r"vam_rate: got nan; expected 0 \.\. 1"):
        Radio(vam_rate=float("nan"))


# Real frames


@pytest.fixture
def real(build_setting, build_scene, study_runs):
    """The study's runs on a plain, and where to stand near their first impact."""
    middle = study_runs[0].vru_position_m[-1]
    east_m = float(middle[0])
    return build_setting(build_scene(GROUND), study_runs), east_m - 12.0


def test_threads_and_company_do_not_change_a_verdict(build_layout, real, study_runs):
    setting, x_m = real
    a = build_layout("a", "b", x_m=x_m)
    b = build_layout("c", x_m=x_m)  # stands where "a" stands
    n_done = []
    together = evaluate_layouts(
        [a, b],
        setting,
        compute=Compute(
            workers=2, progress=lambda stage, done, total: n_done.append((done, total))
        ),
    )

    alone = evaluate_layout(b, setting)

    # Two different poses, and the VUT in four parts.
    expected = [(0, 0), *((done, 6) for done in range(1, 7))]
    of_first = together[0].units["a"]
    of_second = together[1].units["c"]

    assert n_done == expected
    assert (of_first.detected == of_second.detected).all()

    for name in ("vut", "rsu_all", "vut_and_rsus"):
        verdict = getattr(together[1], name)
        of_both = verdict.detected
        of_one = getattr(alone, name).detected

        assert (of_both == of_one).all()

    evidence = perceive_frames(
        build_surroundings(setting.scene, study_runs),
        (b.units[0].pose, b.units[0].sensor),
    )
    expected_c = setting.detector.is_expected(evidence)
    ids = [unit.id for unit in together[0].layout.units]
    unit_names = list(together[0].units)

    assert (alone.units["c"].detected == expected_c).all()
    assert ids == unit_names


@pytest.mark.long
def test_luck_depends_on_the_seed_and_on_nothing_else(build_layout, real):
    setting, x_m = real
    setting = replace(
        setting,
        detector=load_detector("response"),
        radio=Radio(packet_loss=0.2, vam_rate=0.5),
        vut_sensors=("camera", "lidar"),
    )
    cameras = build_layout("a", "b", x_m=x_m)
    lidars = build_layout("l", x_m=x_m, sensor=LIDAR)

    units = (*lidars.units, *cameras.units)
    mixed = Layout(name="mixed", units=units)
    compute = Compute(seed=7, workers=2)
    whole = evaluate_layout(mixed, setting, compute=compute)

    compute_7 = Compute(seed=7)
    parts = evaluate_layouts([cameras, lidars], setting, compute=compute_7)

    for part in parts:
        for name, verdict in part.units.items():
            assert verdict.detected.any()
            assert _is_equal(verdict, whole.units[name])
        assert _is_equal(part.vut, whole.vut)
        assert _is_equal(part.others["vam"], whole.others["vam"])

    compute_8 = Compute(seed=8)
    other = evaluate_layout(mixed, setting, compute=compute_8)

    for name in ("a", "b", "l"):
        differs = other.units[name].detected != whole.units[name].detected
        assert differs.any()

    vut_differs = other.vut.detected != whole.vut.detected

    assert vut_differs.any()


def test_a_lidars_table_finds_some_of_those_with_enough_points(build_layout, real):
    setting, x_m = real
    setting = replace(setting, vut_sensors=("camera", "lidar"))
    layout = build_layout("l", "m", x_m=x_m, sensor=LIDAR)
    by_points = evaluate_layout(layout, setting)

    drawn = evaluate_layout(
        layout, replace(setting, detector=load_detector("pointrcnn-2019"))
    )

    for name, verdict in by_points.units.items():
        found = drawn.units[name].detected[verdict.detected]
        is_known = drawn.units[name].detected <= verdict.detected

        assert is_known.all()
        assert 0.8 < found.mean() < 1.0  # cyclists

    differ = drawn.units["l"].detected != drawn.units["m"].detected
    is_fewer = drawn.vut.detected < by_points.vut.detected

    assert differ.any()
    assert is_fewer.any()


def test_what_is_missed_by_day_is_missed_at_night_and_in_fog(
    build_layout, build_setting, real
):
    """The same frame has the same luck in every weather: only the weather makes the
    difference.
    """
    setting, x_m = real
    layout = build_layout("a", x_m=x_m)
    runs = [
        replace(run, id=f"{run.id}/{weather}", weather=weather)
        for run in setting.runs
        for weather in ("day", "night", "rain", "fog")
    ]
    question = build_setting(setting.scene, runs, detector=load_detector("response"))

    evaluation = evaluate_layout(layout, question)
    of_weather = np.array(question.axis.weathers).repeat(
        np.diff(question.axis.run_start)
    )

    for verdict in (evaluation.units["a"], evaluation.vut):
        by_day = verdict.detected[of_weather == "day"]
        at_night = verdict.detected[of_weather == "night"]
        in_rain = verdict.detected[of_weather == "rain"]
        in_fog = verdict.detected[of_weather == "fog"]

        assert in_fog.any()

        for other in (at_night, in_rain, in_fog):
            assert (by_day >= other).all()

        assert (in_rain >= at_night).all()  # 0.8 of the contrast, and 0.6
        assert by_day.sum() > in_fog.sum()


def test_interruption_leaves_the_other_units_unseen(monkeypatch, build_layout, setting):
    n_seen = []

    def from_camera(surroundings, by, *, min_height_px):
        if isinstance(by, VutCamera):
            raise KeyboardInterrupt
        n_seen.append(1)
        return build_evidence(
            np.zeros((len(surroundings.vru_poses), 4)),
            draw_index=surroundings.draw_index,
        )

    monkeypatch.setattr(perceive, "perceive_frames", from_camera)
    layout = build_layout(*map(str, range(500)))

    with pytest.raises(KeyboardInterrupt):
        evaluate_layout(layout, setting)

    assert len(n_seen) < 500


def test_wrong_axis_and_workers_are_named(build_layout, setting, study_runs):
    layout = build_layout("a")
    fewer = study_runs[1:]
    weight = np.full(len(fewer), 1 / len(fewer))
    axis = build_frame_axis(fewer, weight)

    for change in ({"axis": axis}, {"runs": fewer}):
        with pytest.raises(
            InputError, match="axis: got frames of other runs; expected the frame axis"
        ):
            evaluate_layout(layout, replace(setting, **change))

    with pytest.raises(
        InputError, match="workers: got 0; expected a whole number, at least 1"
    ):
        evaluate_layout(layout, setting, compute=Compute(workers=0))


@pytest.mark.parametrize(
    ("n_known", "n_looks"),
    [
        (2, 0),
        (1, 3),  # a camera on a pole, and the two parts of the VUT's frames
    ],
    ids=["every run was looked at", "half of the runs are new"],
)
def test_a_layout_is_evaluated_again_without_looking_twice(
    setting, build_layout, monkeypatch, n_known, n_looks
):
    rule = replace(RULE, track_memory_s=0.3, latency_s=0.1)
    runs = setting.runs[:2]
    weight = np.array([0.3, 0.7])
    other = replace(
        setting,
        runs=runs,
        axis=build_frame_axis(runs, weight),
        rule=rule,
    )
    x_m = runs[0].vru_position_m[-1, 0] - 15.0
    layout = build_layout("unit", x_m=x_m)
    expected = evaluate_layout(layout, other)
    known = (setting.runs[2], *runs[:n_known])
    asked = replace(
        setting,
        runs=known,
        axis=build_frame_axis(known, np.full(len(known), 1.0 / len(known))),
    )
    evaluation = evaluate_layout(layout, asked)

    looked_at = []
    look = perceive.perceive_frames

    def counted(surroundings, *given, **options):
        looked_at.append(len(surroundings.draw_index))
        return look(surroundings, *given, **options)

    monkeypatch.setattr(evaluate, "_VUT_JOBS", 2)
    monkeypatch.setattr(perceive, "perceive_frames", counted)

    (again,) = evaluate_again([evaluation], asked, other)

    assert len(looked_at) == n_looks

    n_new_frames = sum(len(run.time_s) for run in runs[n_known:])

    assert sum(looked_at) == 2 * n_new_frames
    assert again.axis is other.axis

    for name, verdict in _verdicts(expected).items():
        assert _is_equal(_verdicts(again)[name], verdict)

    assert expected.rsu_all.detected.any()
