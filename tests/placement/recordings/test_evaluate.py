"""Recordings judged: APR by hand, matching of boxes, missing files."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused_with

from placement.evaluation import apr
from placement.recordings import (
    evaluate_recording,
    is_longitudinal,
    read_recording,
    recorded_table,
    take_units,
)

BOX = "100 200 140 300"
CROSSING = {
    "speeds": (10.0, 1.5),
    "closing": 10.0,
    "n_frames": 12,
}


@pytest.fixture
def judge(tmp_path_factory, rule):
    """Judges a folder by the study's rule."""

    def run(folder, **options):
        folder_of_run = tmp_path_factory.mktemp("recording")
        written = folder.write(folder_of_run)
        return evaluate_recording(read_recording(written), rule, **options)

    return run


def _one_drive(new_folder, detected, **options):
    """A folder with one drive at a pedestrian who crosses."""
    folder = new_folder()
    folder.drive(3, 0, detected=detected, **(CROSSING | options))
    return folder


def _cyclist(new_folder):
    """A folder with one drive at a cyclist whom nobody finds."""
    return _one_drive(
        new_folder,
        {"0": ()},
        speeds=(10.0, 4.0),
        actor="bycicle",
    )


def test_apr_of_a_small_recording_worked_by_hand(small, judge):
    # Both pedestrians cross: c = v, so cos(angle) = u / (2 v) is about 0. Braking at
    # 7.72 m/s^2, 25 ms after the third detected frame in a row, must set in before -v /
    # 15.44:
    #   drive 1, 10 m/s: before -0.6477 s, so the third frame may be the one at -0.7 s
    #     (onset -0.675), not the one at -0.6 s;
    #   drive 2, 15 m/s: before -0.9715 s: the frame at -1.0 s (onset -0.975), not that
    #     at -0.9 s.
    # drive 1: unit 0 at -0.9 and -0.7, unit 1 at -0.8: neither alone, but together in
    # time.
    #          The car at -1.0, -0.9, -0.8: in time.
    # drive 2: unit 0 at -1.2, -1.1, -1.0: in time. Unit 1 at -1.0, -0.9, -0.8: too
    # late. Car: none.
    result = judge(small)
    axis = result.axis
    speeds_kmh = axis.vut_speed_kmh.tolist()
    weights = axis.weight.tolist()
    starts = axis.run_start.tolist()

    assert axis.run_ids == ("recording/3/36", "recording/3/54")
    assert axis.cases == ("scenario-3-pedestrian",) * 2
    assert axis.approaches == ("recorded",) * 2
    assert axis.weathers == ("recorded",) * 2
    assert speeds_kmh == pytest.approx([36.0, 54.0])
    assert weights == [0.5, 0.5]
    assert axis.last_brake_time_s == pytest.approx(
        [-10.0 / 15.44, -15.0 / 15.44], abs=1e-12
    )
    assert starts == [0, 12, 28]
    assert axis.time_s[[0, 11, 12, 27]] == pytest.approx([-1.1, 0.0, -1.5, 0.0])

    outcomes = {"0": [False, True], "1": [False, False]}

    for unit, is_avoided in outcomes.items():
        assert result.units[unit].is_avoided.tolist() == is_avoided

    assert result.rsu_all.is_avoided.tolist() == [True, True]
    assert result.vut.is_avoided.tolist() == [True, False]
    assert result.vut_and_rsus.is_avoided.tolist() == [True, True]

    verdicts = (*result.units.values(), result.rsu_all, result.vut)
    aprs = [apr(v, axis) for v in verdicts]

    assert aprs == [0.5, 0.0, 1.0, 0.5]
    assert [
        int(v.detected.sum()) for v in (*result.units.values(), result.rsu_all)
    ] == [5, 4, 8]
    assert result.rsu_all.confirmation_time_s == pytest.approx([-0.7, -1.0])
    assert result.rsu_all.onset_time_s == pytest.approx([-0.675, -0.975])


def test_a_cyclist_ahead_leaves_the_time_that_shedding_the_closing_speed_takes(
    new_folder, judge
):
    # v = 10, u = 4, c = 6 = v - u: cos = 1. Last moment -6 / 15.44 = -0.3886 s: the
    # third frame may be the one at -0.5 s (onset -0.475), not that at -0.4 s (onset
    # -0.375).
    for frames, is_avoided in (
        ((7, 6, 5), True),
        ((6, 5, 4), False),
    ):
        folder = _one_drive(
            new_folder,
            {"0": frames},
            speeds=(10.0, 4.0),
            closing=6.0,
            actor="bycicle",
        )
        result = judge(folder)

        assert result.axis.cases == ("scenario-3-bicycle",)
        assert result.axis.last_brake_time_s == pytest.approx([-6.0 / 15.44])
        assert result.units["0"].is_avoided.tolist() == [is_avoided]


@pytest.mark.parametrize(
    ("changes", "is_avoided"),
    [
        ({}, True),  # -0.7 + 0.025 <= -0.6477
        ({"latency_s": 0.06}, False),  # -0.64
        ({"n_confirmations": 4}, False),
        ({"n_confirmations": 2, "latency_s": 0.15}, True),  # -0.8 + 0.15
        ({"deceleration_mps2": 7.45}, True),  # last moment -10 / 14.9 = -0.67114
        ({"deceleration_mps2": 7.45, "latency_s": 0.029}, False),  # -0.671
        ({"build_up_s": 0.2}, False),  # about 0.1 s earlier
    ],
)
def test_confirmation_latency_and_braking_are_those_asked_for(
    new_folder, tmp_path, rule, changes, is_avoided
):
    folder = _one_drive(new_folder, {"0": (9, 8, 7)}).write(tmp_path)
    result = evaluate_recording(read_recording(folder), replace(rule, **changes))

    assert result.units["0"].is_avoided.tolist() == [is_avoided]


def test_a_missing_frame_is_not_detected_and_breaks_a_row(new_folder, judge):
    folder = _one_drive(new_folder, {"0": (10, 9, 8, 7)})

    assert judge(folder).units["0"].confirmation_time_s == pytest.approx([-0.8])

    del folder.files["WorldData/3_2.txt"]  # 9 frames before the impact
    folder.files["Eval/3_2.txt"] += f"0 pedestrian {BOX} 1"
    result = judge(folder)

    assert np.isinf(result.units["0"].confirmation_time_s).all()
    assert result.axis.n_frames == 12


def test_a_missing_label_or_eval_file_is_no_detection(new_folder, judge):
    for name in ("0/3_2.txt", "Eval/3_2.txt"):
        folder = _one_drive(new_folder, {"0": (10, 9, 8)})
        del folder.files[name]
        assert judge(folder).units["0"].detected.sum() == 2


@pytest.mark.parametrize(
    ("found", "is_detected"),
    [
        # The label is 40 x 100 px from (100, 200).
        ("pedestrian 100 200 140 300 0.9", True),
        ("pedestrian 100 200 140 250 0.9", False),  # half of it: IoU is 0.5, not more
        ("pedestrian 100 200 140 251 0.9", True),
        ("pedestrian 100 200 180 300 0.9", False),  # twice as wide: 0.5
        ("bycicle 100 200 140 300 0.9", False),
        ("car 100 200 140 300 0.9", False),
    ],
)
def test_a_detection_is_of_the_vrus_class_and_overlaps_its_label_by_more_than_half(
    new_folder, judge, found, is_detected
):
    folder = _one_drive(new_folder, {"0": ()})
    folder.files["Eval/3_4.txt"] = f"0 {found}\n0 pedestrian 900 900 940 1000 0.9"

    expected = [is_detected and frame == 4 for frame in range(12)]

    assert judge(folder).units["0"].detected.tolist() == expected


@pytest.mark.parametrize("word", ["bycicle", "bicycle", "pedestrian"])
def test_a_cyclist_may_be_found_as_bicycle_or_as_rider(new_folder, judge, word):
    folder = _cyclist(new_folder)
    folder.files["Eval/3_4.txt"] = f"0 {word} {BOX} 0.9"

    assert judge(folder).units["0"].detected.sum() == 1


def test_a_riders_own_label_does_not_count(new_folder, judge):
    folder = _cyclist(new_folder)
    folder.add("0/3_4.txt", "pedestrian 100 150 140 220 20")
    folder.files["Eval/3_4.txt"] = "0 pedestrian 100 150 140 220 0.9"

    assert judge(folder).units["0"].detected.sum() == 0


def test_boxes_are_compared_inside_the_image(new_folder, judge):
    # Inside, the label is 20 x 80 px and the detection too; as written they share a
    # fifth.
    folder = _one_drive(new_folder, {"0": ()})
    folder.files["0/3_4.txt"] = "pedestrian 1900 1000 2000 1400 5"
    folder.files["Eval/3_4.txt"] = "0 pedestrian 1900 1000 1920 1080 0.9"

    assert judge(folder).units["0"].detected.sum() == 1


def test_weak_detections_do_not_count_if_asked_for(small, judge):
    assert judge(small, min_confidence=0.9).rsu_all.detected.sum() == 8
    assert judge(small, min_confidence=0.91).rsu_all.detected.sum() == 0


@pytest.mark.parametrize("confidence", [-0.1, 1.5, float("nan")])
def test_a_confidence_out_of_range_is_refused(small, judge, confidence):
    with refused_with(
        f"min_confidence: got {confidence}; expected a confidence, 0 .. 1"
    ):
        judge(small, min_confidence=confidence)


def test_of_several_pedestrians_a_roadside_unit_must_detect_each(new_folder, judge):
    other = "900 200 940 300"
    folder = _one_drive(new_folder, {"0": (8, 7)})
    folder.add("0/3_3.txt", f"pedestrian {other} 5")  # 8 before the impact
    folder.add("0/3_4.txt", f"pedestrian {other} 5")
    folder.add("Eval/3_4.txt", f"0 pedestrian {other} 0.9")

    result = judge(folder)

    assert result.units["0"].detected.nonzero()[0].tolist() == [4]
    assert result.n_ambiguous == 2


def test_of_several_pedestrians_the_vuts_is_the_one_at_the_recorded_distance(
    new_folder, judge
):
    # Eight frames before the impact the bodies are 10 m apart.
    other = "900 200 940 300"
    for near_m, far_m, n_detected in (
        (9.0, 30.0, 1),
        (30.0, 9.0, 0),
    ):
        folder = _one_drive(new_folder, {"0": (), "car": (8,)})
        folder.files["car/3_3.txt"] = (
            f"pedestrian {BOX} {near_m}\npedestrian {other} {far_m}\n"
        )
        result = judge(folder)

        assert result.vut.detected.sum() == n_detected
        assert result.n_ambiguous == 0


def test_a_vru_that_nobody_ever_sees_is_a_drive_that_is_not_avoided(new_folder, judge):
    folder = _one_drive(new_folder, {"0": (8, 7)})
    folder.files = {
        name: "" if name.startswith("0/") else text
        for name, text in folder.files.items()
    }

    result = judge(folder)

    assert result.axis.cases == ("scenario-3-unseen",)
    assert not result.rsu_all.detected.any()
    assert not result.rsu_all.is_avoided.any()


def test_without_the_vuts_camera_there_is_no_verdict_of_it(new_folder, judge):
    result = judge(_one_drive(new_folder, {"0": (9, 8, 7)}))

    assert result.vut is None
    assert result.vut_and_rsus is None
    assert result.rsu_all.is_avoided.all()


def test_a_speed_that_is_driven_again_gets_a_number(new_folder, judge):
    folder = new_folder()
    number = folder.drive(
        7,
        0,
        detected={"0": ()},
        resets=30,
        **CROSSING,
    )
    folder.drive(7, number, detected={"0": ()}, **CROSSING)

    assert judge(folder).axis.run_ids == ("recording/7/36", "recording/7/36/2")


def test_some_units_are_judged_as_if_only_they_were_recorded(
    small, tmp_path, rule, judge
):
    everything = judge(small)

    some = take_units(everything, ["1"], rule)

    assert list(some.units) == ["1"]
    assert np.array_equal(some.rsu_all.detected, everything.units["1"].detected)
    assert some.vut_and_rsus.is_avoided.tolist() == [True, False]
    assert np.array_equal(some.vut.is_avoided, everything.vut.is_avoided)


def test_the_detection_table_has_a_row_per_unit(small, judge):
    result = judge(small)

    table = recorded_table(result)
    expected = [result.units[unit].detected for unit in ("0", "1")]

    assert table.pose_ids == ("0", "1")
    assert np.array_equal(table.detected([0, 1]), expected)


def test_who_goes_the_vuts_way_is_told(new_folder, tmp_path):
    folder = _one_drive(
        new_folder,
        {"0": ()},
        speeds=(10.0, 4.0),
        closing=6.0,
    )
    (drive,) = read_recording(folder.write(tmp_path)).drives

    assert is_longitudinal(drive)
