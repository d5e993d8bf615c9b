"""Detectors by name and from users' tables, and what their files say wrongly."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from evidences import build_evidence
from numpy.random import default_rng

from geometry.errors import InputError
from geometry.text_formats import load_toml
from placement.detectors import (
    DETECTOR_NAMES,
    VRU_CLASSES,
    load_detector,
    load_planning_detector,
)
from placement.detectors.evidence import Interval
from placement.detectors.geometric import GeometricDetector
from placement.detectors.response import ResponseDetector

OURS = (files("placement.detectors") / "data" / "detectors.toml").read_text(
    encoding="utf-8"
)
TABLE = """# A user's own response.

[response]
seen_share = [0.0, 0.5, 1.0]
recall = [0.0, 0.6, 0.9]
height_half_px = 30
height_steepness = 2.5
min_box_height_px = 15.0
pedestrian = 1.0
child = 0.9
cyclist = 0.8
cyclist_end_on = 0.7
contrast_half = 0.2
contrast_steepness = 1.5
box_noise_share = 0.0
frame_correlation = 0.25
plan_probability = 0.6
"""


@pytest.fixture
def write(tmp_path):
    """Writes a text to a file of its own; returns the path."""

    def write_file(text, name="mine.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write_file


def _message(name, **options):
    """Words in which a detector is refused."""
    with pytest.raises(InputError) as caught:
        load_detector(str(name), **options)
    return str(caught.value)


def test_detectors_are_found_by_name():
    assert DETECTOR_NAMES == (
        "geometric",
        "response",
        "pole-2015",
        "car-2019",
        "cnn-table",
        "cnn",
    )
    assert isinstance(load_detector("geometric"), GeometricDetector)
    assert isinstance(load_detector("response"), ResponseDetector)
    assert load_detector() is load_detector("geometric")

    for name in DETECTOR_NAMES[:-1]:
        assert load_detector(name).name == name
        assert load_detector(name) is load_planning_detector(name)


KNOWN = (
    "expected geometric, response, pole-2015, car-2019, cnn-table, cnn,"
    " pointrcnn-2019, a .toml file with a response table, or an .onnx file"
)


def test_an_unknown_name_lists_the_known_ones():
    message = _message("best", where="--detector")
    assert message == f"--detector: got 'best'; {KNOWN}"


@pytest.mark.parametrize(
    "name", ["mine.json", "mine.tom", "toml", ".toml", "mine.onnx.txt"]
)
def test_a_file_of_another_kind_is_refused_even_if_it_is_there(write, name):
    path = write(TABLE, name)
    assert _message(path) == f"detector: got {str(path)!r}; {KNOWN}"


def test_a_users_table_is_read_number_by_number(write):
    detector = load_detector(str(write(TABLE)))

    assert isinstance(detector, ResponseDetector)
    assert detector.name == "mine.toml"
    assert detector.seen_share.tolist() == [0.0, 0.5, 1.0]
    assert detector.recall.tolist() == [0.0, 0.6, 0.9]
    assert detector.class_factor.tolist() == [1.0, 0.9, 0.8, 1.0, 1.0]
    # A table of before these classes has the built-in factors.
    assert detector.assumed == ("motorcyclist", "car")
    assert detector.height_half_px == 30.0
    assert detector.height_steepness == 2.5
    assert detector.min_box_height_px == 15.0
    assert detector.cyclist_end_on == 0.7
    assert detector.contrast_half == 0.2
    assert detector.contrast_steepness == 1.5
    assert detector.box_noise_share == 0.0
    assert detector.frame_correlation == 0.25
    assert detector.plan_probability == 0.6
    assert "The response model mine.toml" in detector.description


def test_what_a_table_assumes_is_said(write):
    measured = TABLE.replace(
        "cyclist = 0.8", "cyclist = 0.8\nmotorcyclist = 0.75\ncar = 0.7"
    )
    detector = load_detector(str(write(measured)))

    assert detector.class_factor.tolist() == [1.0, 0.9, 0.8, 0.75, 0.7]
    assert detector.assumed == ()
    assert "assumed" not in detector.description

    marked = measured.replace("car = 0.7", 'car = 0.7\nassumed = ["car", "child"]')
    detector = load_detector(str(write(marked, "marked.toml")))

    assert detector.assumed == ("child", "car")

    words = (
        " Assumed, not measured: how well the detector finds child (factor 0.9) and "
        "car (factor 0.7)."
    )

    assert words in detector.description
    assert detector.assumed_words(["car"]).startswith(
        "Assumed, not measured: how well the detector finds car (factor 0.7)."
    )
    assert detector.assumed_words(["pedestrian"]) == ""


def test_our_own_file_is_one_that_a_user_may_change(write):
    mine = load_detector(str(write(OURS)))
    expected = load_planning_detector("response").fingerprint()

    assert isinstance(mine, ResponseDetector)
    assert mine.fingerprint() == expected

    changed = load_detector(
        str(write(OURS.replace("cyclist_end_on = 0.9", "cyclist_end_on = 1")))
    )

    assert isinstance(changed, ResponseDetector)
    assert changed.cyclist_end_on == 1.0
    assert np.array_equal(changed.recall, mine.recall)


@pytest.mark.parametrize(
    ("line", "wrong", "message"),
    [
        (
            "recall = [0.0, 0.6, 0.9]",
            "recall = [0.0, 1.2, 0.9]",
            ":5: recall: got 1.2; expected ",
        ),
        (
            "recall = [0.0, 0.6, 0.9]",
            "recall = [0.0, 0.9]",
            ":5: recall: got shape (2,); expected",
        ),
        (
            "recall = [0.0, 0.6, 0.9]",
            "recall = 0.9",
            ":5: recall: got 0.9; expected a li",
        ),
        (
            "cyclist = 0.8",
            'cyclist = 0.8\nassumed = ["tram"]',
            ":12: assumed: got 'tram'; expected one of pedestrian, child, cyclist, m",
        ),
        (
            "seen_share = [0.0, 0.5, 1.0]",
            "seen_share = [0.0, 1.0, 0.5]",
            (
                ":4: seen_share: got [0.0, 1.0, 0.5]; expected shares that ascend from"
                " 0 to 1"
            ),
        ),
        (
            "height_half_px = 30",
            "height_half_px = 0",
            ":6: height_half_px: got 0.0; expected a number, > 0",
        ),
        (
            "plan_probability = 0.6",
            "  plan_probability=1.01 # indented",
            ":17: plan_probability: got 1.01; expected 0 .. 1",
        ),
        (
            "child = 0.9",
            "child = true",
            ":10: child: got True; expected a finite number",
        ),
        ("child = 0.9\n", "", ":3: child: got nothing; expected a value"),
        (
            TABLE[TABLE.index("[response]") :],
            "response = 3",
            ": got no table [response]; expected a table",
        ),
        (
            "[response]",
            "[response",
            (
                ": got Expected ']' at the end of a table declaration (at line 3,"
                " column 10); expected valid TOML in UTF-8"
            ),
        ),
    ],
)
def test_a_table_that_cannot_be_used_names_file_line_and_field(
    write, line, wrong, message
):
    assert line in TABLE

    path = write(TABLE.replace(line, wrong))
    found = _message(path)

    assert found.startswith(f"{path}{message}")
    assert "\n" not in found
    assert "expected" in found


def test_a_table_may_tell_how_often_nothing_is_confirmed(write):
    silent = load_detector(str(write(TABLE)))

    assert silent.false_tracks_per_hour is None
    assert "false tracks" not in silent.description

    rate = "\n[false_tracks_per_hour]\nvalue = 12.5\nlow = 3\nhigh = 31\n"
    told = load_detector(str(write(TABLE + rate)))
    expected = Interval(12.5, 3.0, 31.0)

    assert told.false_tracks_per_hour == expected
    assert "confirms 12.5 false tracks per hour (95 %: 3 to 31)" in told.description
    # What it plans with is the same.
    assert told.fingerprint() == silent.fingerprint()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("value = 1\nlow = 2\nhigh = 3", "expected 0 <= low <= value <= high"),
        ("value = 1\nlow = 0", "high"),
        ("value = 'often'\nlow = 0\nhigh = 2", "value"),
    ],
)
def test_a_rate_that_cannot_be_used_is_named(write, wrong, message):
    path = write(f"{TABLE}\n[false_tracks_per_hour]\n{wrong}\n")
    found = _message(path)

    assert "false_tracks_per_hour" in found
    assert message in found
    assert "\n" not in found


def test_the_line_is_that_of_the_response_where_another_table_has_the_same_key(write):
    """Our own file has a least height in three tables."""
    path = write(
        OURS.replace("min_box_height_px = 12.0", "min_box_height_px = -1.0", 1)
    )
    lines = OURS.splitlines()
    (number,) = [
        index
        for index, text in enumerate(lines, start=1)
        if text.startswith("min_box_height_px = 12.0 # nothing below")
    ]

    words = "min_box_height_px: got -1.0; expected a number, > 0"

    assert _message(path) == f"{path}:{number}: {words}"


def test_a_file_that_is_not_there_or_not_text_is_named(tmp_path):
    gone = tmp_path / "gone.toml"
    words = "got No such file or directory; expected a readable file"

    assert _message(gone) == f"{gone}: {words}"

    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe")
    network = tmp_path / "gone.onnx"

    assert _message(path).startswith(
        f"{path}: got 'utf-8' codec can't decode byte 0xff"
    )
    assert _message(network).startswith(f"{network}: got no such file")


@pytest.mark.parametrize(
    ("name", "height_px", "seen_share", "found"),
    [  # results/reality.md: share found, 95 % by tracks
        ("pole-2015", 80.0, 1.0, (0.73, 0.86)),
        ("pole-2015", 80.0, 0.78, (0.26, 0.56)),
        ("pole-2015", 57.0, 1.0, (0.13, 1.0)),
        ("car-2019", 80.0, 1.0, (0.77, 0.91)),
        ("car-2019", 80.0, 0.25, (0.05, 0.37)),
    ],
)
def test_tables_of_real_recordings_find_as_many_as_was_measured(
    name, height_px, seen_share, found
):
    detector = load_planning_detector(name)
    box = [[0.0, 0.0, 0.4 * height_px, height_px]]

    (probability,) = detector.probability(build_evidence(box, visible_share=seen_share))

    assert found[0] <= probability <= found[1]
    assert detector.assumed == ("child", "cyclist", "motorcyclist", "car")
    assert detector.false_tracks_per_hour.low > 100.0


def test_what_the_lidars_table_holds_is_a_share_with_its_interval():
    table = load_toml(files("placement.detectors") / "data" / "pointrcnn-2019.toml")
    for name in ("pedestrian", "cyclist"):
        of = table[name]
        shares = np.array([of["recall_low"], of["recall"], of["recall_high"]])

        assert (np.diff(shares, axis=0) >= 0.0).all()
        assert ((shares >= 0.0) & (shares <= 1.0)).all()
        assert (np.array(of["frames"]) >= of["tracks"]).all()


def test_a_lidars_table_stands_behind_a_cameras():
    both = load_detector("pole-2015+pointrcnn-2019")
    camera = load_detector("pole-2015")
    expected = camera.recall.tolist()

    assert both.name == "pole-2015+pointrcnn-2019"
    assert both.lidar.name == "pointrcnn-2019"
    assert both.recall.tolist() == expected
    assert both.fingerprint() == (*camera.fingerprint(), both.lidar)

    alone = load_detector("pointrcnn-2019")

    assert alone.name == "geometric+pointrcnn-2019"
    assert replace(alone, lidar=None, name="geometric") == load_detector()

    for name in ("pole-2015+car-2019", "+pole-2015", "pole+pointrcnn-2019"):
        with pytest.raises(
            InputError, match=r"car-2019, cnn-table, cnn, pointrcnn-2019, a \.toml"
        ):
            load_detector(name)


def test_what_is_found_in_points_is_drawn_with_the_tables_shares_and_correlation():
    table = load_detector("pointrcnn-2019").lidar
    classes = np.repeat([0, VRU_CLASSES.index("cyclist")], 20_000)
    distance = np.repeat([15.0, 25.0, 15.0, 45.0], 10_000)
    found = table.detect(
        distance,
        classes,
        np.arange(40_000),
        default_rng(1),
    )
    shares = found.reshape(4, -1).mean(axis=1)

    assert shares == pytest.approx([0.756, 0.545, 0.936, 0.667], abs=0.03)

    # A miss follows a miss more often than not, as in the recording (phi 0.66).
    first = found[:10_000]

    assert 0.45 < np.corrcoef(first[1:], first[:-1])[0, 1] < 0.7
    # The table counts pedestrians nearer than 26 m, and all cyclists.
    assert table.is_expected(np.array([25.0, 26.0]), np.zeros(2, int)).tolist() == [
        True,
        False,
    ]
    assert table.is_expected(distance[20_000:], classes[20_000:]).all()

    weathers = table.detect(
        distance[:2],
        classes[:2],
        np.zeros(2, int),
        default_rng(1),
    )

    assert weathers[0] == weathers[1]


def test_a_table_says_which_of_its_figures_are_measured(write):
    """So do the built-in ones; a file without the list does not say."""
    of_response = (
        "4 of the 14 values of response are measured; assumed: child, cyclist,"
        " motorcyclist, car, height_half_px, height_steepness, min_box_height_px,"
        " contrast_half, contrast_steepness, cyclist_end_on."
    )

    assert load_detector("response").figures_words == of_response
    assert load_detector("pole-2015").figures_words.startswith(
        "7 of the 14 values of pole-2015 are measured; assumed: child, cyclist,"
        " motorcyclist, car,"
    )

    unlisted = load_detector(str(write(TABLE))).figures_words
    path = write(TABLE + 'assumed_figures = ["recall"]\n')
    listed = load_detector(str(path)).figures_words
    wrong = _message(write(TABLE + 'assumed_figures = ["x"]\n'))

    assert unlisted == "mine.toml does not say which of its values are measured."
    assert (
        "11 of the 14 values of mine.toml are measured; assumed: recall, "
        "motorcyclist, car."
    ) in listed
    assert (
        "mine.toml:18: assumed_figures: got 'x'; expected one of recall, pedestrian"
    ) in wrong


def test_what_response_has_from_recordings_is_the_middle_of_their_tables():
    response, *tables = map(load_detector, ("response", "pole-2015", "car-2019"))
    for name, digits in (
        ("frame_correlation", 2),
        ("box_noise_share", 2),
    ):
        middle = np.mean([getattr(one, name) for one in tables])
        assert getattr(response, name) == pytest.approx(
            middle, abs=0.51 * 10.0**-digits
        )
