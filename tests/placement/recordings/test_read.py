"""Folders of recordings: units, drives, and what was left out."""

import numpy as np
import pytest

from geometry.errors import InputError
from placement.recordings import read_recording

BOX = "100 200 140 300"
LAST = "3_57.txt"  # frame of the impact of the second drive


def _refusal(folder):
    """Words in which a folder is refused, F for its path."""
    with pytest.raises(InputError) as caught:
        read_recording(folder)
    return str(caught.value).replace(str(folder), "F")


def test_a_recording_tells_its_units_drives_and_what_was_left_out(small, tmp_path):
    recording = read_recording(small.write(tmp_path))

    assert recording.units == ("0", "1")
    assert recording.has_vut is True
    assert [(d.first_number, d.n_frames, d.vru_class) for d in recording.drives] == [
        (0, 12, "pedestrian"),
        (42, 16, "pedestrian"),
    ]
    assert recording.n_frames == 12 + 30 + 16 + 30
    assert recording.n_missing == 0
    assert recording.skipped == {
        "frames between drives (bodies back at their starts)": 60
    }

    words = f"Recording({tmp_path.name!r}: 2 units, 2 drives, 88 frames)"

    assert repr(recording) == words


def test_units_are_in_the_order_of_their_numbers(small, tmp_path):
    for unit in ("10", "2"):
        small.add(f"{unit}/3_0.txt", f"car {BOX} 5")
    assert read_recording(small.write(tmp_path)).units == ("0", "1", "2", "10")


def test_what_is_left_out_is_counted_by_its_reason(small, tmp_path):
    small.add("0/3_0.txt", f"car {BOX} 5")
    small.add("0/3_0.txt", f"motorcycle {BOX} 5")
    small.add("0/3_1.txt", "pedestrian 2000 200 2100 300 5")  # beyond the right edge
    small.add("0/3_1.txt", "pedestrian -9 200 0 300 5")
    small.add("0/3_1.txt", "pedestrian 100 200 100 300 5")
    small.add("0/3_2.txt", f"pedestrian {BOX} 20.0")  # as in the line before
    small.add("1/3_500.txt", f"pedestrian {BOX} 5")
    small.add("Eval/3_500.txt", f"0 pedestrian {BOX} 1")
    small.add("Eval/3_501.txt", f"0 car {BOX} 1")
    small.files |= {
        "readme.txt": "",
        "0/notes.md": "",
        "0/03_1.txt": "",
        "00/3_1.txt": "",
    }

    assert read_recording(small.write(tmp_path)).skipped == {
        "frames between drives (bodies back at their starts)": 60,
        "labels of other classes": 2,
        "boxes outside the image": 2,
        "boxes without area": 1,
        "lines that repeat others": 1,
        "frames without WorldData": 2,
        "detections of other classes": 1,
        "files and folders with other names": 4,
    }


def test_a_recording_made_twice_into_one_folder_reads_as_once(small, tmp_path):
    once = read_recording(small.write(tmp_path / "once"))
    small.files = {name: 2 * text for name, text in small.files.items()}

    twice = read_recording(small.write(tmp_path / "twice"))
    n_lines = 88 + 3 * 88 + 12  # WorldData, labels, detections
    expected = dict(once.skipped) | {"lines that repeat others": n_lines}

    assert dict(twice.skipped) == expected
    assert twice.labels == once.labels
    assert twice.detections == once.detections

    for a, b in zip(twice.drives, once.drives, strict=True):
        assert np.array_equal(a.distance_m, b.distance_m)


@pytest.mark.parametrize("index", ["car", "12", "-1"])
def test_the_vut_may_be_called_by_its_folder_or_by_an_index(small, tmp_path, index):
    small.files[f"Eval/{LAST}"] = f"{index} pedestrian {BOX} 0.5"

    recording = read_recording(small.write(tmp_path))
    (found,) = recording.detections["car"][(3, 57)]

    assert found.confidence == 0.5


def test_a_unit_folder_12_is_a_unit(small, tmp_path):
    small.add("12/3_0.txt", f"pedestrian {BOX} 5")
    small.files[f"Eval/{LAST}"] = f"12 pedestrian {BOX} 0.5\n-1 pedestrian {BOX} 0.25"

    recording = read_recording(small.write(tmp_path))

    assert recording.detections["12"][(3, 57)][0].confidence == 0.5
    assert recording.detections["car"][(3, 57)][0].confidence == 0.25


def test_a_recording_may_lack_the_vuts_camera(small, tmp_path):
    small.files = {
        name: "" if name.startswith("Eval") else text
        for name, text in small.files.items()
        if not name.startswith("car/")
    }
    assert not read_recording(small.write(tmp_path)).has_vut


def _without(files, part):
    """The files but for those whose name begins so."""
    return {name: text for name, text in files.items() if not name.startswith(part)}


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("WorldData/", "F/WorldData: got nothing; expected a folder with frames"),
        ("Eval/", "F/Eval: got nothing; expected a folder with frames"),
        (
            ("0/", "1/"),
            "F: got no unit; expected a folder named 0, 1 .. for each roadside unit",
        ),
        (
            "1/",
            (
                "F/Eval/3_3.txt:1: cam_index: got '1'; expected a unit that has a"
                " folder: car, 12, -1, 0"
            ),
        ),
    ],
)
def test_a_folder_that_is_missing_is_named(small, tmp_path, part, message):
    small.files = _without(small.files, part)
    assert _refusal(small.write(tmp_path)) == message


@pytest.mark.parametrize("name", ["0", "car", "WorldData", "Eval"])
def test_a_folder_without_a_frame_is_named(small, tmp_path, name):
    small.files = _without(small.files, f"{name}/") | {f"{name}/3_0.png": ""}
    message = f"F/{name}: got no frame; expected files SCENARIO_FRAME.txt"

    assert _refusal(small.write(tmp_path)) == message


def test_a_folder_that_is_not_there_or_no_folder_is_named(tmp_path):
    refused = _refusal(tmp_path / "x")

    assert refused == "F: got No such file or directory; expected a recording"

    (tmp_path / "file").write_text("")

    assert _refusal(tmp_path / "file").startswith(
        "F: got MOT challenge; expected the study's"
    )


def test_a_recording_in_which_nobody_meets_is_refused_with_what_was_left_out(
    small, tmp_path, new_folder
):
    folder = new_folder()
    folder.drive(
        0,
        0,
        speeds=(10.0, 1.0),
        closing=0.0,
        n_frames=5,
        detected={"0": (), "car": ()},
    )
    folder.files["0/9_9.txt"] = ""

    message = (
        "F: got no drive; 1 frames without WorldData, 5 frames of drives in which"
        " nothing approaches; expected frames in which the VUT and a VRU come"
        " together"
    )

    assert _refusal(folder.write(tmp_path)) == message
