"""Made-up recordings, drawn by this project's own camera, body and response table."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.special import ndtr

from experiments.study.reality import __main__ as command
from experiments.study.reality import places, report, response
from experiments.study.reality.projection import (
    body_boxes,
    nearest_pinhole,
    pets_tracks,
    tilted,
)
from geometry.calibrations import project_distorted, read_opencv_camera, read_tsai
from geometry.image_boxes import box_height_px
from geometry.lenses import TsaiRadial
from geometry.sensors import project_points
from geometry.text_formats import load_toml
from placement.detectors import load_detector
from placement.detectors.evidence import linked_noise
from placement.recordings.formats import read_wildtrack

TSAI = (  # 7 m above the road, looking along it
    '<Camera><Geometry width="768" height="576" dpx="5e-3" dpy="5e-3"/><Intrinsic'
    ' focal="5.5" kappa1="5e-3" cx="380" cy="290" sx="1.05"/><Extrinsic tx="0"'
    ' ty="6500" tz="2600" rx="1.9" ry="0" rz="0"/></Camera>'
)
N_PEOPLE = 10
N_FRAMES = 60


def put(path, text):
    """Write a file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def pets(folder, rng):
    """People who walk across; a detector that finds what the table "response" says."""
    data = folder / "OpenTraj/datasets/PETS-2009/data"
    put(data / "calibration/View_001.xml", TSAI)
    camera = read_tsai(data / "calibration/View_001.xml")
    frames = np.arange(N_FRAMES)
    frame_texts = [[] for _ in frames]
    found = []
    table = load_detector("response")
    for person in range(N_PEOPLE):
        far = 12.0 + 2.0 * person
        way = (-1.0) ** person
        aside = way * (-2.0 + 0.1 * frames)
        foot = np.zeros((N_FRAMES, 3))
        foot[:, 0] = aside
        foot[:, 1] = far
        if way > 0:
            heading = np.zeros(N_FRAMES)
        else:
            heading = np.full(N_FRAMES, 180.0)
        walked = (0.1 * frames / 1.4 * 8).round().astype(int)
        boxes = body_boxes(
            foot,
            heading,
            walked,
            lambda p: project_distorted(p, camera),
        )
        height = box_height_px(boxes)
        draws = linked_noise(frames, table.frame_correlation, rng)
        smallness = table.height_half_px / height
        chance = 0.924 / (1.0 + smallness**table.height_steepness)
        is_found = ndtr(draws) < chance

        for frame, box in enumerate(boxes):
            x_min, y_min, x_max, y_max = box
            x = 0.5 * (x_min + x_max)
            y = 0.5 * (y_min + y_max)
            w = x_max - x_min
            h = y_max - y_min
            frame_texts[frame].append(
                f'<object id="{person}"><box h="{h}" w="{w}" xc="{x}"'
                f' yc="{y}"/></object>'
            )
            if is_found[frame]:
                number = frame + 1
                line = f"{number},-1,{x_min},{y_min},{w},{h},0.9,-1,-1,-1"
                found.append((number, line))

    text = ""
    for n, objects in enumerate(frame_texts):
        listed = "".join(objects)
        text += f'<frame number="{n}"><objectlist>{listed}</objectlist></frame>'

    put(data / "annotations/PETS2009-S2L1.xml", f"<dataset>{text}</dataset>")
    lines = "\n".join(text for _, text in sorted(found))
    put(folder / "sort/data/train/PETS09-S2L1/det/det.txt", lines)


def kitti(folder, rng):
    """Two sequences of people and cyclists, each found in seven or eight of ten
    frames.
    """
    data = folder / "OpenTraj/datasets/KITTI/data"
    for sequence in (0, 16):
        labels = []
        points = {"Pedestrian": [], "Cyclist": []}
        pictures = []
        for frame in range(50):
            for track in range(8):
                if track < 4:
                    kind = "Pedestrian"
                else:
                    kind = "Cyclist"
                far = 8.0 + 3.0 * track + 0.02 * frame
                top = 173 - 180 / far
                left = 150 * track + 20
                right = left + 300 / far
                bottom = top + 1300 / far
                box = f"{left} {top:.1f} {right:.1f} {bottom:.1f}"
                level = track % 3
                labels.append(
                    f"{frame} {track} {kind} 0 {level} 0 {box} 1.8 0.5 0.5"
                    f" {track - 3} 1.6 {far} 0"
                )
                commas = box.replace(" ", ",")
                if kind == "Pedestrian":
                    number = 1
                else:
                    number = 3
                if rng.random() < 0.75:
                    where = f"{track - 3},1.6,{far}"
                    points[kind].append(
                        f"{frame},{number},{commas},2.0,1.8,0.5,0.5,{where},0,0"
                    )
                if kind == "Pedestrian" and rng.random() < 0.8:
                    pictures.append(f"{frame},{commas},0.9")
        name = f"{sequence:04d}.txt"
        put(data / "label" / name, "\n".join(labels))
        put(data / "calib" / name, "P2: 721.5 0 609.5 0 0 721.5 172.8 0 0 0 1 0\n")
        put(data / "oxts" / name, "0 0 0 0 0 0 0 0 0\n" * 50)
        rrc = folder / "DeepFusionMOT/data/detections/2D/rrc/training/Pedestrian"
        put(rrc / name, "\n".join(pictures))
        for kind, lines in points.items():
            path = folder / f"AB3DMOT/data/KITTI/detection/pointrcnn_{kind}_val" / name
            put(path, "\n".join(lines))


def wildtrack(folder):
    """Three frames of people, whose flags say whether their middle is in the
    picture.
    """
    from scipy.spatial.transform import Rotation

    data = folder / "OpenTraj/datasets/Wild-Track"
    cameras = []
    for view, name in enumerate(
        ("CVLab1", "CVLab2", "CVLab3", "CVLab4", "IDIAP1", "IDIAP2", "IDIAP3")
    ):
        turn = Rotation.from_euler("xz", [-95.0, 50.0 * view], degrees=True)
        shift = turn.apply([-200.0, -300.0, -250.0])
        rvec = " ".join(map(str, turn.as_rotvec()))
        tvec = " ".join(map(str, shift))
        extrinsic = data / "calibrations/extrinsic" / f"extr_{name}.xml"
        text = f"<opencv><rvec>{rvec}</rvec><tvec>{tvec}</tvec></opencv>"
        put(extrinsic, text)
        for kind, terms in (
            ("original", "-0.05 0.01 0 0 0"),
            ("zero", "0 0 0 0 0"),
        ):
            path = data / "calibrations" / f"intrinsic_{kind}" / f"intr_{name}.xml"
            k = "<camera_matrix><data>900 0 960 0 900 540 0 0 1</data></camera_matrix>"
            name_of_d = "distortion_coefficients"
            d = f"<{name_of_d}><data>{terms}</data></{name_of_d}>"
            put(path, f"<opencv_storage>{k}{d}</opencv_storage>")
            if kind == "original":
                cameras.append(read_opencv_camera(path, extrinsic, (1920, 1080)))
    people = []
    for number in range(40):
        # The ground is divided into rows of 480 cells, 25 mm wide.
        row = 40 + 30 * number
        column = 5 + 11 * number
        cell = 480 * row + column
        x = -3.0 + 0.025 * (cell % 480)
        y = -9.0 + 0.025 * (cell // 480)
        views = []
        for view, camera in enumerate(cameras):
            ((column, row, _),) = project_distorted([[x, y, 0.9]], camera)
            inside = 0 <= column < 1920 and 0 <= row < 1080
            names = ("xmin", "ymin", "xmax", "ymax")
            if inside:
                sides = (1, 2, 30, 40)
            else:
                sides = (-1, -1, -1, -1)
            views.append({"viewNum": view} | dict(zip(names, sides, strict=True)))
        people.append({"personID": number, "positionID": cell, "views": views})
    import json

    for frame in (0, 5, 10):
        put(data / "annotations_positions" / f"{frame:08d}.json", json.dumps(people))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three made-up recordings."""
    place = tmp_path_factory.mktemp("recordings")
    rng = np.random.default_rng(3)
    pets(place, rng)
    kitti(place, rng)
    wildtrack(place)
    return place


@pytest.fixture(scope="module", autouse=True)
def two_sequences():
    """Only two sequences of KITTI are there."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (report, response, places):
            patch.setattr(module, "KITTI_SEQUENCES", (0, 16))
        yield


@pytest.fixture(scope="module")
def measured(folder):
    """All that the command measures."""
    return report.measure(folder)


# Quickly: the other tests of this file.
@pytest.mark.long
def test_bodies_that_this_camera_drew_have_the_height_that_it_predicts(measured):
    """The recording was drawn with the camera and bodies that predict it."""
    heights = measured.heights
    spread = np.quantile(heights.ratio, [0.05, 0.5, 0.95])

    assert spread == pytest.approx(1.0, abs=0.02)
    assert abs(heights.tilt_deg.value) <= 0.1


def test_a_camera_without_distortion_and_roll_is_its_nearest_pinhole(folder):
    _, camera = pets_tracks(folder)
    square = replace(
        camera,
        lens=TsaiRadial(kappa=0.0),
        fy_px=camera.fx_px,
        cx_px=0.5 * camera.width_px,
        cy_px=0.5 * camera.height_px,
    )
    pinhole, pose = nearest_pinhole(square)
    points = np.array(
        [
            [0.0, 12.0, 0.0],
            [2.0, 20.0, 1.8],
            [-3.0, 30.0, 0.5],
        ]
    )
    ours = project_points(points, pose, pinhole)
    theirs = project_distorted(points, square)

    assert ours == pytest.approx(theirs, abs=1e-6)


def test_a_camera_tilted_down_shows_the_same_point_higher_up(folder):
    _, camera = pets_tracks(folder)
    points = [[0.0, 15.0, 0.0]]
    ((_, row, _),) = project_distorted(points, camera)
    ((_, tilted_row, _),) = project_distorted(points, tilted(camera, 1.0))

    assert tilted_row < row - 10.0


# Quickly: the other tests of this file.
@pytest.mark.long
def test_flags_by_the_middles_of_bodies_agree_with_the_lens_that_made_them(
    folder, measured
):
    """Without the lens, by a pinhole, some do not."""
    flags = measured.flags
    marks = folder / "OpenTraj/datasets/Wild-Track/annotations_positions"
    by_camera = read_wildtrack(marks)

    assert [flag.agreed for flag in flags] == [1.0] * 7
    assert min(flag.agreed_pinhole for flag in flags) < 1.0
    assert len(by_camera) == 7


# Quickly: the other tests of this file.
@pytest.mark.long
def test_what_was_drawn_is_counted(folder, measured):
    det = folder / "sort/data/train/PETS09-S2L1/det/det.txt"
    n_found = len(det.read_text().splitlines())
    n_shown = N_PEOPLE * N_FRAMES
    watched = measured.pole
    sightings = watched.sightings

    assert int(sightings.is_found.sum()) == n_found
    assert len(sightings) == n_shown

    everybody = response.recall_of(sightings, "all")
    share = n_found / n_shown

    assert everybody.measured.value == pytest.approx(share)

    groups = response.recalls(
        watched,
        watched.distance_m,
        (0.0, 21.0, np.inf),
        "m",
    )
    assert [group.tracks for group in groups] == [5, 5]

    car = measured.car
    levels = set(car.hidden_level.tolist())

    assert levels == {0, 1, 2}
    assert car.halves["sequence"].sum() == 200


def test_phi_is_that_of_two_states_and_their_chances():
    """Phi is the sum of both chances to stay, less 1: 0.9 + 0.6 - 1."""
    rng = np.random.default_rng(1)
    n = 4000
    states = np.empty(n, dtype=bool)
    states[0] = True
    for index in range(1, n):
        if states[index - 1]:
            chance = 0.9  # stays found
        else:
            chance = 1.0 - 0.6  # stays missed
        states[index] = rng.random() < chance

    # An error of zero where something is found, and none where nothing is.
    error = np.where(states, 0.0, np.nan)
    some = response.Sightings(
        height_px=np.full(n, 80.0),
        seen_share=np.ones(n),
        contrast=np.ones(n),
        aspect_deg=np.full(n, 90.0),
        vru_class=np.zeros(n, dtype=np.int64),
        is_found=states,
        box_error=np.column_stack([error] * 4),
        track=np.repeat(np.arange(40), 100),
        frame=np.tile(np.arange(100), 40),
    )
    found = response.phi(some)

    assert found.low <= 0.5 <= found.high
    assert found.value == pytest.approx(0.5, abs=0.06)


@pytest.mark.long
def test_where_detections_are_exact_no_error_is_measured(measured):
    """The prediction is about detectors that err."""
    for band in measured.places:
        assert band.along_m == pytest.approx(0.0, abs=1e-6)
        assert 0.1 < band.predicted_along_m < 2.0


@pytest.mark.parametrize(
    ("right_m", "braked"),
    [(0.0, 1), (6.0, 0)],
)
def test_a_car_brakes_for_nothing_only_where_it_drives(
    tmp_path, monkeypatch, right_m, braked
):
    """A car at 10 m/s east; its camera finds nobody who stands 45 m ahead."""
    monkeypatch.setattr(places, "KITTI_SEQUENCES", (0,))
    data = tmp_path / "OpenTraj/datasets/KITTI/data"
    found = []
    car = []
    for frame in range(40):
        # A degree on the equator has 111,319.5 m.
        car.append(f"0 {frame / 111319.49} 0 0 0 0 0 10 10")
        ahead_m = 45.0 - frame
        if 5 <= frame < 36:
            foot = 172.8 + 721.5 * 1.65 / ahead_m
            middle = 609.5 + 721.5 * right_m / ahead_m
            height = 721.5 * 1.7 / ahead_m
            left = middle - 0.2 * height
            right = middle + 0.2 * height
            top = foot - height
            box = f"{left:.3f},{top:.3f},{right:.3f},{foot:.3f}"
            found.append(f"{frame},{box},0.4")

    label = "0 0 Pedestrian 0 0 0 1 1 20 60 1.8 0.5 0.5 -20 1.6 30 0"
    put(data / "label/0000.txt", label)
    put(data / "calib/0000.txt", "P2: 721.5 0 609.5 0 0 721.5 172.8 0 0 0 1 0\n")
    put(data / "oxts/0000.txt", "\n".join(car))
    rrc = tmp_path / "DeepFusionMOT/data/detections/2D/rrc/training/Pedestrian"
    put(rrc / "0000.txt", "\n".join(found))
    found = places.decide_false_tracks(tmp_path, "car-2019", "pedestrian")

    assert found.braked == braked
    assert found.tracks == 1


# Quickly: the other tests of this file.
@pytest.mark.long
def test_the_command_writes_page_figures_and_tables(
    folder, measured, tmp_path, monkeypatch
):
    monkeypatch.setattr(command, "measure", {folder: measured}.__getitem__)
    result = CliRunner().invoke(
        command.main,
        [
            str(folder),
            "--out",
            str(tmp_path / "out"),
            "--tables",
            str(tmp_path / "tables"),
        ],
    )

    assert result.exit_code == 0, result.output

    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {
        "reality.md",
        "reality_heights.png",
        "reality_recall.png",
        "reality_confirmation.png",
    }

    text = (tmp_path / "out/reality.md").read_text()
    assert text.splitlines()[2].startswith("By more than its 95 % interval, ")

    for name in ("pole-2015.toml", "car-2019.toml"):
        table = load_detector(str(tmp_path / "tables" / name))
        assert table.assumed == ("child", "cyclist", "motorcyclist", "car")

    lidars = load_toml(tmp_path / "tables/pointrcnn-2019.toml")
    assert lidars["pedestrian"]["distance_m"]
    assert lidars["cyclist"]["distance_m"]


def test_a_missing_recording_is_told_in_one_line(tmp_path):
    out = tmp_path / "out"
    arguments = [str(tmp_path), "--out", str(out)]
    result = CliRunner().invoke(command.main, arguments)

    assert result.exit_code == 2
    assert "PETS2009-S2L1.xml: got No such file or directory" in result.output
