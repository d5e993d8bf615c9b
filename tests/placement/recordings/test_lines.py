"""Lines of labels, detections and world data, and which are refused."""

import pytest

from geometry.errors import InputError
from placement.recordings.files import (
    Detection,
    Label,
    RecordedWorld,
    load_format,
    read_detections,
    read_labels,
    read_world,
)

FORM = load_format()
TYPES = "pedestrian, bycicle, bicycle, car, motorcycle, truck, van, bus, train"
LABEL = "6 fields: actor_type min_x min_y max_x max_y dist"
EVAL = "7 fields: cam_index actor_type min_x min_y max_x max_y confidence"
WORLD = "dist car_speed vru_speed, once or repeated exactly"


def _refusal(read, path, content):
    """Words in which a file is refused, F for its path."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read(path, FORM)
    return str(caught.value).replace(str(path), "F")


def test_labels_are_read_in_both_spellings_and_empty_lines_are_nothing(tmp_path):
    path = tmp_path / "3_0.txt"
    path.write_text("bycicle 1 2 3 4.5 6\n\n  bicycle -1e1 2 3 4 0\ncar 1 1 1 1 1\n")

    expected = (
        [
            Label("bicycle", (1.0, 2.0, 3.0, 4.5), 6.0),
            Label("bicycle", (-10.0, 2.0, 3.0, 4.0), 0.0),
            Label("other", (1.0, 1.0, 1.0, 1.0), 1.0),
        ],
        0,
    )

    assert read_labels(path, FORM) == expected


def test_an_empty_label_file_holds_nothing(tmp_path):
    path = tmp_path / "3_0.txt"
    path.write_text("")

    assert read_labels(path, FORM) == ([], 0)


def test_lines_of_a_file_written_twice_count_once(tmp_path):
    path = tmp_path / "3_0.txt"
    path.write_text(2 * "car 1 2 3 4 5\npedestrian 1 2 3 4 5\n")

    labels, n_repeated = read_labels(path, FORM)

    assert [label.class_name for label in labels] == ["other", "pedestrian"]
    assert n_repeated == 2


def test_detections_keep_their_unit_and_line(tmp_path):
    path = tmp_path / "3_0.txt"
    path.write_text("\n-1 pedestrian 1 2 3 4 0.5\ncar bycicle 1 2 3 4 1\n")

    expected = (
        [
            Detection(
                "-1",
                "pedestrian",
                (1.0, 2.0, 3.0, 4.0),
                0.5,
                2,
            ),
            Detection("car", "bicycle", (1.0, 2.0, 3.0, 4.0), 1.0, 3),
        ],
        0,
    )

    assert read_detections(path, FORM) == expected


@pytest.mark.parametrize(
    ("text", "n_repeated"),
    [
        ("12.5 5.5 1.25", 0),
        (" 12.5  5.5 1.25 \n", 0),
        ("12.5 5.5 1.2512.5 5.5 1.25", 1),  # the generator, run twice
        ("12.5 5.5 1.2512.5 5.5 1.2512.5 5.5 1.25", 2),
        ("12.5 5.5 1.25\n12.5 5.5 1.25\n", 1),
    ],
)
def test_world_data_may_stand_there_several_times(tmp_path, text, n_repeated):
    path = tmp_path / "3_0.txt"
    path.write_text(text)

    assert read_world(path, FORM) == (RecordedWorld(12.5, 5.5, 1.25), n_repeated)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("car 1 2 3 4", f"F:1: got 5 fields; expected {LABEL}"),
        # CARLA's empty base type.
        (" 1 2 3 4 5", f"F:1: got 5 fields; expected {LABEL}"),
        ("\n\ntram 1 2 3 4 5", f"F:3: actor_type: got 'tram'; expected one of {TYPES}"),
        ("car nan 2 3 4 5", "F:1: min_x: got 'nan'; expected a finite number"),
        ("car 1 2 1_0 4 5", "F:1: max_x: got '1_0'; expected a finite number"),
        (
            "car 3 2 1 4 5",
            "F:1: box: got 3 2 1 4; expected min_x <= max_x and min_y <= max_y",
        ),
        (
            b"\xff",
            (
                "F: got 'utf-8' codec can't decode byte 0xff in position 0: invalid"
                " start byte; expected text in UTF-8"
            ),
        ),
    ],
)
def test_a_wrong_label_is_named_with_its_line_and_field(tmp_path, content, message):
    assert _refusal(read_labels, tmp_path / "3_0.txt", content) == message


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("0 car 1 2 3 4", f"F:1: got 6 fields; expected {EVAL}"),
        (
            "0 person 1 2 3 4 1",
            f"F:1: actor_type: got 'person'; expected one of {TYPES}",
        ),
        ("0 car 1 2 3 nan 1", "F:1: max_y: got 'nan'; expected a finite number"),
        (
            "0 car 1 2 3 4 1.5",
            "F:1: confidence: got '1.5'; expected a finite number, 0 .. 1",
        ),
        (
            "0 car 1 2 3 4 nan",
            "F:1: confidence: got 'nan'; expected a finite number, 0 .. 1",
        ),
    ],
)
def test_a_wrong_detection_is_named_with_its_line_and_field(tmp_path, content, message):
    assert _refusal(read_detections, tmp_path / "3_0.txt", content) == message


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", f"F:1: got ''; expected {WORLD}"),
        # Two recordings in one folder whose distances differ: which one is which cannot
        # be told.
        ("12.5 5 112.4 5 1", f"F:1: got '12.5 5 112.4 5 1'; expected {WORLD}"),
        ("12 5 1\n12 5 2", f"F:1: got '12 5 1\\n12 5 2'; expected {WORLD}"),
        ("12 0 1", "F:1: car_speed: got 0.0; expected m/s, more than 0"),
        ("12 5 -1", "F:1: vru_speed: got '-1'; expected a finite number, at least 0"),
    ],
)
def test_wrong_world_data_is_named(tmp_path, content, message):
    assert _refusal(read_world, tmp_path / "3_0.txt", content) == message


def test_a_folder_in_place_of_a_file_is_named(tmp_path):
    with pytest.raises(
        InputError, match="got Is a directory; expected a readable file"
    ):
        read_labels(tmp_path, FORM)
