"""Recordings in the formats of others, made up line by line; readers.py has whole
ones.
"""

import numpy as np
import pytest
from readers import READERS

from geometry.calibrations import (
    project_distorted,
    read_kitti_camera,
    read_opencv_camera,
    read_tsai,
)
from geometry.errors import InputError
from placement.recordings import find_format, read_recording
from placement.recordings.formats import IGNORE, read_boxes, read_wildtrack


def put(tmp_path, reader, kind):
    """A small file of a kind, written; returns its path."""
    entry, files = READERS[reader].seeds()[kind]
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path / entry


def refused(read, path, text=None):
    """Words in which a reader refuses a file, F for its path."""
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError) as caught:
        read(path)
    return str(caught.value).replace(str(path), "F")


def test_cvml_has_middles_and_sizes_of_boxes(tmp_path):
    found = read_boxes(put(tmp_path, "recorded boxes", "cvml"))

    assert found.frame.tolist() == [0, 1, 2]
    assert found.box_px[1].tolist() == [86.0, 50.0, 116.0, 130.0]
    assert found.track.tolist() == [1, 1, 1]
    assert found.class_name == ("pedestrian",) * 3


def test_mot_counts_frames_from_one_and_tells_annotations_by_their_ids(tmp_path):
    given = read_boxes(put(tmp_path, "recorded boxes", "mot gt"))

    assert given.frame.tolist() == [0, 1]
    assert given.box_px[0].tolist() == [10.0, 20.0, 40.0, 60.0]
    assert given.class_name == ("pedestrian", IGNORE)  # its flag is 0
    assert given.seen_share.tolist() == [0.5, 0.5]
    assert np.isnan(given.score).all()

    found = read_boxes(put(tmp_path, "recorded boxes", "mot det"))

    assert found.track.tolist() == [-1, -1]
    assert found.score.tolist() == [0.9, 0.1]


def test_kitti_labels_and_detectors_are_told_by_their_fields(tmp_path):
    given = read_boxes(put(tmp_path, "recorded boxes", "kitti"))

    assert given.class_name == (IGNORE, "pedestrian", "pedestrian")
    assert given.track.tolist() == [-1, 2, 2]
    assert given.hidden_level.tolist() == [-1, 1, -1]
    assert given.position_m[1].tolist() == [6.3, 1.6, 8.4]

    found = read_boxes(put(tmp_path, "recorded boxes", "rrc"))

    assert found.frame.tolist() == [0, 4]
    assert found.score.tolist() == [0.73, 0.5]

    found = read_boxes(put(tmp_path, "recorded boxes", "pointrcnn"))

    assert found.class_name == ("cyclist",)
    assert found.position_m.tolist() == [[1.6, 1.6, 5.7]]


def test_wildtrack_has_a_value_for_each_view(tmp_path):
    views = read_wildtrack(put(tmp_path, "recorded boxes", "wildtrack"))

    assert len(views) == 7

    expected = [[0, 1, 2]] * 7

    assert [view.frame.tolist() for view in views] == expected
    assert views[0].box_px.tolist() == [[0.0] * 4] * 3  # not in view
    assert views[3].box_px[0].tolist() == [10.0, 20.0, 30.0, 40.0]

    row, column = divmod(456826, 480)
    x = -3.0 + 0.025 * column
    y = -9.0 + 0.025 * row

    assert views[0].position_m[0] == pytest.approx([x, y, 0.0])


def test_a_tsai_camera_stands_where_its_rotation_and_shift_say(tmp_path):
    camera = read_tsai(put(tmp_path, "recorded calibrations", "tsai"))
    shift_m = camera.R_camera_world @ -camera.position_m

    assert shift_m == pytest.approx([0.828, -3.175, 35.469])
    assert camera.fx_px == pytest.approx(5.5 * 1.09 / 5e-3)
    assert np.linalg.det(camera.R_camera_world) == pytest.approx(1.0)

    # The world's origin is at the shift: its undistorted place follows without any
    # rotation.
    u = np.array([0.828, -3.175]) / 35.469

    (shown,) = project_distorted([[0.0, 0.0, 0.0]], camera)
    x = (shown[:2] - [324.0, 282.0]) / [camera.fx_px, camera.fy_px]

    assert x * (1.0 + 5e-3 * 5.5**2 * (x @ x)) == pytest.approx(u, abs=1e-9)


def test_a_kitti_camera_projects_as_its_matrix(tmp_path):
    path = put(tmp_path, "recorded calibrations", "kitti")
    camera = read_kitti_camera(path, (1242, 375))
    P = np.array([721.5, 0, 609.5, 44.8, 0, 721.5, 172.8, 0.2, 0, 0, 1, 0.003]).reshape(
        3, 4
    )
    u, v, w = P @ [2.0, 1.0, 15.0, 1.0]

    (shown,) = project_distorted([[2.0, 1.0, 15.0]], camera)

    assert shown.tolist() == pytest.approx([u / w, v / w, w])


def test_an_opencv_camera_agrees_with_opencv(tmp_path):
    import cv2

    path = put(tmp_path, "recorded calibrations", "opencv")
    camera = read_opencv_camera(path, tmp_path / "extrinsic.xml", (1920, 1080))
    turn = np.array([1.7, 0.4, -0.3])
    shift = np.array([-5.25, 0.45, 9.86])
    k = np.array(
        [
            [1743.0, 0, 934],
            [0, 1735, 444],
            [0, 0, 1],
        ]
    )
    d = [-0.4, 0.6, 0.008, 0.001, -0.6]
    points = np.array([[5.0, 1.0, 0.0], [6.0, 2.0, 1.0]])
    theirs, _ = cv2.projectPoints(points, turn, shift, k, np.array(d))

    assert project_distorted(points, camera)[:, :2] == pytest.approx(
        theirs[:, 0], rel=1e-9
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "1,-1,1,2,3,4,0.5,-1,-1,-1\n2,-1,1,2",
            "F:2: got 4 fields; expected 7 to 10 fields",
        ),
        (
            "5,-1,1,2,3,4,0.5\n4,-1,1,2,3,4,0.5",
            "F:2: got frame 3; expected frames in order",
        ),
        (
            "1,1,1,2,3,4,1\n1,1,1,2,3,4,1",
            "F:2: got frame 0; expected frames of track 1, once each",
        ),
        (
            "1,-1,1,2,-3,4,0.5",
            "F:1: box: got -3 x 4 px; expected a width and a height, at least 0",
        ),
        ("1.5,-1,1,2,3,4,0.5", "F:1: frame: got '1.5'; expected a whole number"),
        ("1,2,1,2,3,4,0.5", "F:1: conf: got 0.5; expected 0 or 1 where there is an id"),
        (
            "1,2",
            (
                "F:1: got 2 fields; expected the study's folder, or one of CVML, MOT"
                " challenge"
            ),
        ),
        (
            "0 1 Car 0 0 0 1 2 3",
            "F:1: got 9 fields; expected 17 fields: frame track type",
        ),
        ("3,1,2,3,4,1.5", "F:1: score: got '1.5'; expected a finite number, 0 .. 1"),
    ],
)
def test_a_wrong_line_is_told_with_its_number(text, words, tmp_path):
    assert refused(read_boxes, tmp_path / "a.txt", text).startswith(words)


def cvml(*frames, box='h="8" w="3" xc="1" yc="9"'):
    """A CVML file with a box in each of these frames."""
    parts = (
        f'<frame number="{n}"><objectlist><object id="1"><box'
        f" {box}/></object></objectlist></frame>"
        for n in frames
    )
    return "<dataset>" + "".join(parts) + "</dataset>"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            cvml(0, 1, 2)[:-40],
            "F: got no element found: line 1, column 300; expected CVML",
        ),
        (
            cvml(0, 2, 1),
            "F: frame 1: got 1; expected 4 after frame 2: frames in order, all as far",
        ),
        (
            cvml(3, box='h="8" xc="1" yc="9"'),
            "F: frame 3, object 1: w: got nothing; expected a",
        ),
        (cvml(3, 3), "F: frame 3: got 3; expected 4 after frame 3: frames in order"),
        ("<osm/>", "F: got 'osm'; expected CVML: an element <dataset> with frames"),
    ],
)
def test_wrong_xml_is_told_with_its_frame(text, words, tmp_path):
    assert refused(read_boxes, tmp_path / "a.xml", text).startswith(words)


def test_mixed_rates_and_missing_views_of_wildtrack_are_told(tmp_path):
    folder = put(tmp_path, "recorded boxes", "wildtrack")
    text = (folder / "00000010.json").read_text()
    (folder / "00000012.json").write_text(text)

    assert "frame 12; expected numbers all 5 apart: one frame rate" in refused(
        read_wildtrack, folder
    )

    (folder / "00000012.json").rename(folder / "10.json")

    assert "got two files of one frame; expected each frame once" in refused(
        read_wildtrack, folder
    )

    (folder / "10.json").unlink()
    (folder / "00000005.json").write_text(text.replace('"viewNum": 6', '"viewNum": 5'))

    assert "person 1: got 7 views; expected views 0 to 6, once each" in refused(
        read_wildtrack, folder
    )

    (folder / "00000005.json").write_text("[" * 100_000)

    assert "00000005.json: got JSON nested too deep" in refused(read_wildtrack, folder)

    (folder / "00000005.json").write_text(text[:-9])

    assert "00000005.json: got Unterminated string" in refused(read_wildtrack, folder)


def test_calibrations_that_are_cut_off_or_impossible_are_told(tmp_path):
    path = put(tmp_path, "recorded calibrations", "tsai")
    text = path.read_text()

    no_pixels = refused(read_tsai, path, text.replace('dpx="5e-3"', 'dpx="0"'))
    no_place = refused(read_tsai, path, text.replace("Extrinsic", "Other"))

    assert no_pixels == "F: dpx: got 0.0; expected more than 0"
    assert no_place.startswith("F: Extrinsic: got nothing; expected <Extrinsic tx=")

    path = put(tmp_path, "recorded calibrations", "kitti")

    def read(file):
        return read_kitti_camera(file, (1242, 375))

    no_line = refused(read, path, "P0: 1\n")

    assert no_line == "F: got no P2; expected a line P2: with 12 numbers"

    tabs = tmp_path / "tabs.txt"
    tabs.write_text("P2:\t700\t0\t600\t0 0 700 170 0 0 0 1 0\n")

    assert read(tabs).fx_px == 700.0
    assert read(tabs).cy_px == 170.0

    too_few = refused(read, path, "P2: 1 2\n")

    words = "got 2 of another kind or size; expected 12 finite numbers"

    assert too_few == f"F:1: P2: {words}"


def test_a_recording_says_which_format_it_is_in(tmp_path):
    for kind, name in (
        ("cvml", "CVML"),
        ("mot gt", "MOT challenge"),
        ("kitti", "KITTI"),
        ("rrc", "RRC"),
        ("pointrcnn", "PointRCNN"),
        ("wildtrack", "WILDTRACK"),
    ):
        (tmp_path / kind).mkdir()
        path = put(tmp_path / kind, "recorded boxes", kind)

        assert find_format(path) == name

        if path.is_file():  # the name does not count
            assert find_format(path.rename(tmp_path / "file")) == name

    (tmp_path / "mot" / "gt").mkdir(parents=True)
    (tmp_path / "mot" / "gt" / "gt.txt").touch()
    (tmp_path / "study" / "WorldData").mkdir(parents=True)
    (tmp_path / "coco").write_text('{"images": []}')

    assert find_format(tmp_path / "mot") == "MOT challenge's folder"
    assert find_format(tmp_path / "study") == "study"
    assert find_format(tmp_path / "coco") == "COCO"

    known = (
        "CVML, MOT challenge, KITTI, RRC, PointRCNN, MOT challenge's folder, WILDTRACK,"
        " COCO"
    )
    known = f"expected the study's folder, or one of {known}"
    (tmp_path / "none").mkdir()

    empty = refused(find_format, tmp_path / "none")
    two_fields = refused(find_format, tmp_path / "a.txt", "\n1,2")
    without_a_car = refused(read_recording, tmp_path / "coco")
    expected = (
        "expected the study's folder, which has a car that brakes (detector fit reads"
        " others)"
    )

    assert empty == f"F: got a folder without their files; {known}"
    assert two_fields == f"F:1: got 2 fields; {known}"
    assert without_a_car == f"F: got COCO; {expected}"


def test_tracks_that_jump_are_left_out_and_counted(tmp_path):
    path = tmp_path / "gt.txt"
    # 40 px high: 8 heights are 320 px a frame, and twice that over a frame that is
    # missing.
    rows = [
        (1, 1, 0),
        (2, 1, 320),
        (4, 1, 960),
        (1, 2, 0),
        (2, 2, 321),
        (3, 2, 330),
    ]
    path.write_text("".join(f"{f},{t},{x},9,30,40,1\n" for f, t, x in rows))

    found = read_boxes(path)

    assert found.left_out == {"tracks that jump": 1}
    assert found.track.tolist() == [1, 1, 1]
    assert found.take([0, 1]).left_out == found.left_out

    path.write_text("1,-1,0,9,30,40,0.9\n2,-1,900,9,30,40,0.9\n")  # found: of no track

    assert len(read_boxes(path)) == 2
