"""Recordings as the simulator writes them, read back and judged."""

import numpy as np
import pytest
from refusals import refused_with

from geometry.errors import InputError
from geometry.image_boxes import box_height_px, iou
from geometry.study_scene import load_study_scene
from placement.evaluator import build_surroundings, load_vut_camera, perceive_frames
from placement.recordings import (
    WrittenDrive,
    evaluate_recording,
    read_recording,
    recorded_table,
    write_recording,
)
from scenarios.runs import build_frame_axis, live_confirmation_times_s
from scenarios.weights import weight_per_run

N_RESETS = 30
MIN_HEIGHT_PX = 25.0


def _drive(n_frames=12, **fields):
    """A drive at a cyclist in one box."""
    box = np.tile([100.0, 200.0, 140.0, 300.0], (n_frames, 1))
    given = {
        "scenario": 3,
        "vru_class": "bicycle",
        "vut_speed_mps": 10.0,
        "vru_speed_mps": 1.5,
        "distance_m": 2.0 + np.arange(n_frames)[::-1],
        "labels_px": {"0": box, "car": box},
        "detections_px": {"0": box, "car": np.zeros_like(box)},
        "label_distance_m": {
            "0": np.full(n_frames, 20.0),
            "car": np.arange(n_frames) + 1.0,
        },
    }
    return WrittenDrive(**(given | fields))


def test_the_files_are_those_of_the_study(tmp_path):
    write_recording(tmp_path / "data", [_drive(3)], n_reset_frames=1)
    files = {
        str(path.relative_to(tmp_path / "data")): path.read_text()
        for path in (tmp_path / "data").rglob("*.txt")
    }
    box = "100.0 200.0 140.0 300.0"

    # The frame after the drive is as its first one.
    for number, distance, car in (
        (0, 4.0, 1.0),
        (1, 3.0, 2.0),
        (2, 2.0, 3.0),
        (3, 4.0, 1.0),
    ):
        assert files.pop(f"WorldData/3_{number}.txt") == f"{distance} 10.0 1.5"
        assert files.pop(f"0/3_{number}.txt") == f"bycicle {box} 20.0\n"
        assert files.pop(f"car/3_{number}.txt") == f"bycicle {box} {car}\n"
        assert files.pop(f"Eval/3_{number}.txt") == f"0 bycicle {box} 1.0\n"

    assert files == {}


def test_frame_numbers_run_on_over_drives(tmp_path):
    write_recording(
        tmp_path / "data", [_drive(), _drive(vut_speed_mps=9.0), _drive(scenario=4)]
    )
    recording = read_recording(tmp_path / "data")

    expected = [
        (3, 0, 12),
        (3, 12 + N_RESETS, 12),
        (4, 2 * (12 + N_RESETS), 12),
    ]

    assert [
        (d.scenario, d.first_number, d.n_frames) for d in recording.drives
    ] == expected
    assert recording.n_frames == 3 * (12 + N_RESETS)


def test_a_folder_that_holds_something_is_left_as_it_was(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/mine").write_text("mine")

    with refused_with(
        f"{tmp_path}/data: got a folder that is not empty; expected a new one"
    ):
        write_recording(tmp_path / "data", [_drive()])

    assert [path.name for path in tmp_path.rglob("*")] == ["data", "mine"]


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "data").mkdir()

    write_recording(tmp_path / "data", [_drive()])

    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert read_recording(tmp_path / "data").units == ("0",)


def test_a_file_in_the_way_is_named(tmp_path):
    (tmp_path / "data").write_text("mine")
    with pytest.raises(
        InputError, match="data: got Not a directory; expected a folder that can"
    ):
        write_recording(tmp_path / "data", [_drive()])

    assert [path.name for path in tmp_path.iterdir()] == ["data"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"vru_class": "tram"},
            (
                "vru_class: got 'tram'; expected one of pedestrian, bicycle,"
                " motorcycle, car"
            ),
        ),
        (
            {"label_distance_m": {"0": np.ones(12)}},
            (
                "label_distance_m: got ['0']; expected the units of labels_px: ['0',"
                " 'car']"
            ),
        ),
        (
            {"label_distance_m": {"0": np.ones(12), "car": np.ones(11)}},
            "label_distance_m[car]: got shape (11,); expected shape (12,)",
        ),
    ],
)
def test_a_drive_that_does_not_fit_together_is_refused(fields, message):
    with refused_with(message):
        _drive(**fields)


def test_drives_have_the_same_units_and_there_is_one(tmp_path):
    box = np.zeros((12, 4))
    other = _drive(
        labels_px={"1": box},
        detections_px={"1": box},
        label_distance_m={"1": np.ones(12)},
    )

    for drives, message in (
        ([], "drives: got none; expected at least one"),
        (
            [_drive(), other],
            "units: got ['1']; expected those of the first drive: ['0', 'car']",
        ),
    ):
        with refused_with(message):
            write_recording(tmp_path / "data", drives)


# What the simulator sees, written, read and judged.


@pytest.fixture(scope="module")
def simulated(runs):
    """Three runs of the study, seen by two of its cameras and the VUT's: drives and
    detections.
    """
    from placement.layout import load_carlancap_layout

    few = [
        run
        for run in runs
        if run.id in ("CPNC-50/east/40", "CBNA/east/60", "CBLA/east/50")
    ]
    surroundings = build_surroundings(load_study_scene(), few)
    vut_camera = load_vut_camera()
    by_id = {unit.id: unit for unit in load_carlancap_layout().units}
    boxes = {"car": perceive_frames(surroundings, vut_camera)}
    for folder, unit in (
        ("2", by_id["RSU2"]),
        ("9", by_id["RSU9"]),
    ):
        boxes[folder] = perceive_frames(surroundings, (unit.pose, unit.sensor))

    is_high = {
        name: box_height_px(seen.visible_px) >= MIN_HEIGHT_PX
        for name, seen in boxes.items()
    }
    detected = {
        name: is_high[name] & (iou(seen.visible_px, seen.amodal_px) > 0.5)
        for name, seen in boxes.items()
    }
    axis = build_frame_axis(few, weight_per_run(few))
    drives = []
    for index, run in enumerate(few):
        frames = axis.frames_of(index)
        distance = np.linalg.norm(run.vut_position_m - run.vru_position_m, axis=1)
        drive = WrittenDrive(
            scenario=index,
            vru_class="pedestrian" if run.case.name.startswith("CP") else "bicycle",
            vut_speed_mps=run.encounter.vut_motion.speed_mps,
            vru_speed_mps=run.encounter.vru_motion.speed_mps,
            distance_m=distance,
            labels_px={name: seen.amodal_px[frames] for name, seen in boxes.items()},
            detections_px={
                name: seen.visible_px[frames] * is_high[name][frames, None]
                for name, seen in boxes.items()
            },
            label_distance_m=dict.fromkeys(boxes, distance),
        )
        drives.append(drive)

    return axis, drives, detected


@pytest.mark.long
def test_a_simulated_recording_gives_the_detected_frames_and_verdicts_of_the_simulator(
    simulated, tmp_path, rule
):
    axis, drives, detected = simulated
    write_recording(tmp_path / "data", drives)

    result = evaluate_recording(read_recording(tmp_path / "data"), rule)
    expected = axis.run_start.tolist()

    assert result.axis.run_start.tolist() == expected
    assert result.axis.vut_speed_kmh == pytest.approx(axis.vut_speed_kmh)
    # The impact is the last frame, on the grid of both.
    assert result.axis.time_s == pytest.approx(axis.time_s, abs=1e-9)
    assert any(frames.any() for frames in detected.values())

    parties = {**result.units, "car": result.vut}

    for name, frames in detected.items():
        assert np.array_equal(parties[name].detected, frames)
        avoided = np.isfinite(live_confirmation_times_s(frames, axis, rule=rule))
        assert parties[name].is_avoided.tolist() == avoided.tolist()

    assert np.array_equal(
        recorded_table(result).detected([0, 1]), [detected["2"], detected["9"]]
    )
