"""The command `detector fit`: its three sources, what it writes, and what it
refuses.
"""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from command_results import answer, late_refusal, output, refusal
from json_files import read_json, write_json

from experiments.export.json import to_json
from experiments.perception_lab import fit as job
from experiments.perception_lab.dataset import DatasetRecord
from placement.compute import Compute
from placement.detectors import VRU_CLASSES, load_detector
from placement.detectors.network import ImageBoxes, NetworkDetector
from placement.detectors.response import built_in_response
from placement.layout import load_carlancap_layout
from placement.question import Question
from placement.recordings import WrittenDrive, write_recording
from placement.setting import build_setting

N_FRAMES = 60
ASKED = (
    "--cases",
    "CPNC-50",
    "--approaches",
    "east",
    "--speeds",
    "40",
    "--along-arms",
    "0",
)


def _boxes(rng):
    """Boxes (n, 4) of all heights, and whether they are found: half of them at 35
    px.
    """
    height = np.exp(rng.uniform(np.log(15.0), np.log(120.0), N_FRAMES))
    left = rng.uniform(0.0, 900.0, N_FRAMES)
    boxes = np.stack(
        [left, left * 0 + 100.0, left + 0.4 * height, 100.0 + height], axis=1
    )
    return boxes, rng.random(N_FRAMES) < 1.0 / (1.0 + (35.0 / height) ** 4)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording of six drives, seen by two units and the car."""
    folder = tmp_path_factory.mktemp("recorded") / "ncap_data"
    rng = np.random.default_rng(1)
    drives = []
    for scenario in range(6):
        labels = {}
        found = {}
        for unit in ("0", "1", "car"):
            labels[unit], is_found = _boxes(rng)
            found[unit] = labels[unit] * is_found[:, None]
        drives.append(
            WrittenDrive(
                scenario=scenario,
                vru_class="pedestrian",
                vut_speed_mps=10.0,
                vru_speed_mps=1.4,
                distance_m=2.0 + np.arange(N_FRAMES)[::-1],
                labels_px=labels,
                detections_px=found,
                label_distance_m={unit: np.full(N_FRAMES, 20.0) for unit in labels},
            )
        )
    write_recording(folder, drives)
    return folder


@pytest.fixture
def coco(tmp_path):
    """Labels and results of 300 pictures, a false alarm in every third."""
    rng = np.random.default_rng(2)
    images = []
    annotations = []
    results = []
    for run in range(5):
        boxes, is_found = _boxes(rng)
        for frame, (box, found) in enumerate(
            zip(boxes.tolist(), is_found, strict=True)
        ):
            bbox = [box[0], box[1], box[2] - box[0], box[3] - box[1]]
            name = f"0/{run}_{frame}.png"
            images.append(
                {
                    "id": len(images),
                    "run": f"r{run}",
                    "frame": frame,
                    "file_name": name,
                }
            )
            here = {"image_id": images[-1]["id"], "category_id": 1 + run % 2}
            annotations.append(
                {
                    **here,
                    "id": len(annotations),
                    "bbox": bbox,
                    "visible_share": 1.0,
                }
            )
            if found:
                results.append({**here, "bbox": bbox, "score": 0.9})
            results.append({**here, "bbox": bbox, "score": 0.3})
            if frame % 3 == 0:
                results.append(
                    {**here, "bbox": [1500.0, 800.0, 20.0, 50.0], "score": 0.8}
                )
    names = [
        {"id": 1, "name": "pedestrian"},
        {"id": 2, "name": "cyclist"},
    ]
    labels = {"images": images, "annotations": annotations, "categories": names}
    paths = tmp_path / "coco.json", tmp_path / "found.json"
    for path, content in zip(paths, (labels, results), strict=True):
        write_json(path, content)
    return paths


@pytest.mark.long
def test_a_table_fitted_to_a_recording_is_a_detector_and_the_same_in_each_call(
    run, recording
):
    out = output(run("detector fit --recording", recording, "--out mine"))
    assert {path.name for path in Path("mine").iterdir()} == {
        "response.toml",
        "fit.json",
        "calibration.png",
    }

    table = load_detector("mine/response.toml")
    assert table.height_half_px == pytest.approx(35.0, rel=0.15)
    assert table.height_steepness == pytest.approx(4.0, rel=0.3)

    rate = table.false_tracks_per_hour
    assert rate.value == 0.0
    assert rate.low == 0.0
    assert 0.0 < rate.high < 1000.0

    text = " ".join(out.split())
    assert "of 1080 frames with a road user are detected" in text
    assert (
        "Not known from them, and as in the built-in table: share that is seen,"
        " contrast" in text
    )

    told = read_json(Path("mine/fit.json"))
    assert told["table"]["height_half_px"]["value"] == pytest.approx(
        table.height_half_px, rel=1e-5
    )
    assert told["false_alarms"]["alarms"] == 0

    again = run("detector fit --recording", recording, "--json --quiet")[1]
    assert json.loads(again)["table"] == told["table"]


@pytest.mark.parametrize(
    ("wanted", "there", "shares"),
    [
        (10, [9, 9], [5, 5]),
        (10, [2, 9, 9], [2, 4, 4]),
        (10, [1, 2, 3], [1, 2, 3]),
        (0, [4], [0]),
    ],
)
def test_pictures_are_shared_out_evenly(wanted, there, shares):
    assert job._share_out(wanted, there) == shares


@pytest.mark.long
def test_a_table_is_fitted_to_files_of_coco(ask, coco):
    labels, results = coco
    told = ask("detector fit --labels", labels, "--results", results)

    assert told["frames"] == 5 * N_FRAMES
    assert told["found"] == sum(one["score"] == 0.9 for one in read_json(results))
    assert told["tracks"] == 5
    assert told["unknown"] == ["contrast", "aspect"]
    assert told["false_alarms"]["alarms"] == 5 * N_FRAMES // 3
    assert told["false_alarms"]["confirmed"] == 0  # never in two frames in a row
    assert [group["name"] for group in told["groups"]["class"]] == [
        "pedestrian",
        "cyclist",
    ]
    assert list(Path().glob("response.toml")) == []


# Quickly: test_a_table_fitted_to_a_recording_is_a_detector_and_the_same_in_each_call
@pytest.mark.long
def test_a_table_is_fitted_to_tracks_and_detections_of_others(run, tmp_path):
    """Found in all frames but one of five; the correlation is that at 10 Hz."""
    tracks = []
    found = []
    for frame in range(1, 101):
        for track in (1, 2, 3):
            line = f"{200 * track + frame},100,40,{80 + 20 * track}"
            tracks.append(f"{frame},{track},{line},1,1,1")
            if (frame // 2 + track) % 5:
                found.append(f"{frame},-1,{line},0.9,-1,-1,-1")
    labels = tmp_path / "gt.txt"
    results = tmp_path / "det.txt"
    labels.write_text("\n".join(tracks))
    results.write_text("\n".join(found))
    command = ("detector fit --labels", labels, "--results", results, "--json --quiet")
    fits = []
    for more in ((), ("--frame-rate", "5")):
        out = answer(run(*command, *more))
        fits.append(json.loads(out))
    slow = fits[1]
    fast = fits[0]

    assert slow["frames"] == 300
    assert slow["found"] == len(found)
    assert slow["tracks"] == 3
    assert slow["unknown"] == ["contrast", "aspect"]

    correlation = [one["table"]["frame_correlation"]["value"] for one in (fast, slow)]
    assert correlation[1] == pytest.approx(correlation[0] ** 0.5)

    results.write_text("\n".join(found)[:-20])
    line = refusal(run(*command))
    assert f"det.txt:{len(found)}: got 4 fields; expected 7 to 10 fields" in line


def kitti_files(tmp_path):
    """Labels of people and cyclists, and a detector of each file's classes."""
    rng = np.random.default_rng(3)
    body = "1.7 0.6 0.8 1.0 1.5 20.0 0.0"
    labels = []
    people = []
    both = []
    for frame in range(200):
        for track, kind in enumerate(("Pedestrian", "Cyclist")):
            left = 200.0 * track + 100.0
            box = f"{left} 100 {left + 40} {180 + frame % 60}"
            labels.append(f"{frame} {track} {kind} 0 0 0 {box} {body}")
            if rng.random() > 0.1:
                row = f"{box.replace(' ', ',')},0.9"
                number = (1, 3)[track]
                place = body.replace(" ", ",")
                both.append(f"{frame},{number},{box.replace(' ', ',')},3.0,{place},0")
                if track == 0:
                    people.append(f"{frame},{row}")
    paths = [tmp_path / name for name in ("labels.txt", "people.txt", "both.txt")]
    for path, lines in zip(paths, (labels, people, both), strict=True):
        path.write_text("\n".join(lines) + "\n")
    return paths


@pytest.mark.long
def test_classes_that_a_detector_does_not_report_stay_assumed(run, tmp_path):
    labels, people, _ = kitti_files(tmp_path)
    fit = ("detector fit --labels", labels, "--results")
    out = answer(run(*fit, people, "--out", tmp_path / "people", "--quiet"))
    words = " ".join(out.split())

    assert "The detector reports no cyclist: 200 labelled frames are left out" in words
    assert "built-in table: contrast, aspect, cyclist." in words

    table = load_detector(str(tmp_path / "people/response.toml"))
    built_in = built_in_response()
    told = read_json(tmp_path / "people/fit.json")

    assert told["frames"] == 200
    assert told["not_reported"] == {"cyclist": 200}
    assert told["false_alarms"]["alarms"] == 0
    # All factors are those of the built-in table but for the pedestrian's.
    assert table.class_factor == pytest.approx(built_in.class_factor, rel=1e-5)
    assert set(table.assumed) == {"child", "cyclist", "motorcyclist", "car"}
    assert "cyclist_end_on" in table.assumed_figures

    text = (tmp_path / "people/response.toml").read_text()
    assert "# Not known from them, and as built in: contrast, aspect, cyclist." in text

    # Who says that it can report them has them fitted.
    fitted = answer(run(*fit, people, "--classes pedestrian,cyclist --json --quiet"))
    assert json.loads(fitted)["not_reported"] == {}
    assert json.loads(fitted)["table"]["cyclist"]["value"] < 0.2

    line = refusal(run(*fit, people, "--classes pedestrian,tram"))
    assert "--classes: got 'tram'; expected one of pedestrian, child, cyclist" in line


def test_classes_that_nobody_labelled_keep_their_place(run, tmp_path):
    labels, _, both = kitti_files(tmp_path)
    fit = ("detector fit --labels", labels, "--results", both, "--json --quiet")
    told = json.loads(answer(run(*fit)))

    assert told["not_reported"] == {}
    assert told["frames"] == 400

    built_in = dict(zip(VRU_CLASSES, built_in_response().class_factor, strict=True))
    best = max(told["table"][name]["value"] for name in ("pedestrian", "cyclist"))
    best_built_in = max(built_in[name] for name in ("pedestrian", "cyclist"))
    for name in ("child", "motorcyclist", "car"):
        value = told["table"][name]["value"]
        assert value / best == pytest.approx(built_in[name] / best_built_in)


def test_confidence_decides_what_counts(run, coco):
    labels, results = coco
    line = late_refusal(
        run(
            "detector fit --labels",
            labels,
            "--results",
            results,
            "--min-confidence 0.2",
        )
    )
    assert (
        "got 300, 300 of them found; expected at least 50, with 5 found and 5 missed"
        in line
    )


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"categories": [{"id": 1, "name": "car"}]},
            "coco.json: categories: got car; expected",
        ),
        (
            {"annotations": [{"image_id": 1, "category_id": 1, "bbox": [0, 0, -1, 1]}]},
            "bbox[2]: got -1",
        ),
        ({"images": 3}, "images: got 3"),
    ],
)
def test_files_of_coco_that_are_wrong_are_refused(run, coco, change, line):
    labels, results = coco
    write_json(labels, read_json(labels) | change)
    line = late_refusal(run("detector fit --labels", labels, "--results", results))

    assert line in line


@pytest.mark.parametrize("content", ["", "[", '[{"image_id": 1}]'])
def test_results_that_are_wrong_are_refused(run, coco, content):
    labels, results = coco
    results.write_text(content)
    line = late_refusal(run("detector fit --labels", labels, "--results", results))

    assert "found.json" in line


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ([], "got no source; expected one of"),
        (["--labels", "b"], "--labels: got it without --results"),
        (["--recording", "nowhere"], "nowhere"),
        (
            ["--layout", "carlancap-12"],
            "--detector: got 'geometric'; expected cnn, or an .onnx",
        ),
        (
            ["--recording", "a", "--pictures", "30"],
            "--pictures: got it without --layout; expected both",
        ),
    ],
)
def test_contradictory_options_are_refused(run, options, line):
    line = late_refusal(run("detector fit", *options))
    assert line in line


def test_a_fit_to_the_detections_that_dataset_writes_is_refused(run, tmp_path):
    made = dict.fromkeys(("every", "seed"), 0)
    made |= dict.fromkeys(("masks", "depth", "vehicles", "vary"), False)
    made |= dict.fromkeys(("schema", "format", "scene", "lidar"), "")
    manifest = DatasetRecord(**made, detector="geometric", units=(), drives=())
    (tmp_path / "Eval").mkdir()
    (tmp_path / "dataset.json").write_bytes(msgspec.json.encode(manifest))
    code, out, err = run("detector fit --recording", tmp_path)

    assert code == 2
    assert out == ""

    line = err.splitlines()[-1]
    assert "dataset.json: got detections of geometric, a built-in rule;" in line
    assert "write them into Eval and take dataset.json away" in line


class _Oracle:
    """Reads from a picture which row it is, and finds the road user in two rows of
    three.
    """

    def __init__(self, boxes_px):
        self.boxes_px = boxes_px

    def detect(self, image):
        view = int(image[0, 0, 0])
        row = int(image[0, 0, 1]) * 256 + int(image[0, 0, 2])
        box = self.boxes_px[view][row]
        if row % 3 and box[3] > box[1]:
            boxes = [box]
        else:
            boxes = []
        return ImageBoxes(
            boxes_px=np.array([*boxes, [1.0, 1.0, 5.0, 9.0]]),
            class_ids=np.zeros(len(boxes) + 1, dtype=int),
            confidence=np.ones(len(boxes) + 1),
            kinds={0: "person"},
        )


def test_a_network_is_shown_the_frames_that_its_labels_are_of(tmp_path, monkeypatch):
    question = Question(
        cases="CPNC-50",
        approaches="east",
        speeds="40",
        along_arms="0",
    )
    layout = load_carlancap_layout()
    layout = replace(layout, units=layout.units[2:4])
    boxes_px = []
    look = job.perceive_frames

    def perceive(*args, **values):
        evidence = look(*args, **values)
        boxes_px.append(evidence.visible_px)
        return evidence

    monkeypatch.setattr(job, "perceive_frames", perceive)

    class Numbered:
        """Pictures of one pixel: number of the view, and of the row."""

        def __init__(self, *args, **values):
            self.n_views = 0

        def pictures(self, *args):
            view = self.n_views
            self.n_views = self.n_views + 1
            return lambda row: np.array(
                [[[view, row // 256, row % 256]]], dtype=np.uint8
            )

    monkeypatch.setattr(job, "RenderedPictures", Numbered)
    network = NetworkDetector(
        name="net",
        model=_Oracle(boxes_px),
        min_box_height_px=12.0,
        min_confidence=0.5,
    )
    setting = build_setting(question)
    wish = job.FitWish(layout=layout, pictures=90)
    pictures = list(
        job._look(
            setting, layout, network, wish, Compute(workers=1), lambda *told: None
        )
    )

    assert len(pictures) == 90

    seen, alarms = job.gather_sightings(pictures, n_confirmations=3, frame_rate_hz=10.0)
    assert 0.4 < seen.is_found.mean() < 0.9
    np.testing.assert_allclose(seen.box_error[seen.is_found], 0.0)
    assert alarms.alarms == 90  # the same corner in every picture
    assert alarms.confirmed > 0
    assert len(np.unique(seen.track)) == 3


def test_a_network_that_finds_nothing_is_told_in_a_line(run, tmp_path, monkeypatch):
    monkeypatch.setattr(job, "load_detector", lambda *a, **k: network)
    monkeypatch.setattr(
        job.RenderedPictures,
        "_draw",
        lambda self, *a, **k: np.zeros((36, 64, 3), dtype=np.uint8),
    )
    network = NetworkDetector(
        name="net",
        model=_Blind(),
        min_box_height_px=12.0,
        min_confidence=0.5,
    )
    (tmp_path / "two.json").write_text(to_json(load_carlancap_layout()))
    code, _, err = run(
        "detector fit --layout", tmp_path / "two.json", "--pictures 60", *ASKED
    )

    assert code == 2
    assert "0 of them found; expected at least 50, with 5 found" in err.splitlines()[-1]


class _Blind:
    export = SimpleNamespace(kinds={0: "person"})

    def detect(self, image):
        return ImageBoxes(
            boxes_px=np.zeros((0, 4)),
            class_ids=np.zeros(0, dtype=int),
            confidence=np.zeros(0),
            kinds={0: "person"},
        )


# Quickly: test_a_network_is_shown_the_frames_that_its_labels_are_of
@pytest.mark.long
def test_a_network_for_crops_is_shown_crops_and_now_and_then_whole_pictures(
    monkeypatch,
):
    sizes = []

    class Model:
        """Finds a person in the middle of whatever it is shown, and one in a corner."""

        def detect(self, image):
            height, width = image.shape[:2]
            sizes.append((width, height))
            middle = [0.4 * width, 0.3 * height, 0.6 * width, 0.7 * height]
            return ImageBoxes(
                boxes_px=np.array([middle, [0.0, 0.0, 3.0, 6.0]]),
                class_ids=np.zeros(2, dtype=np.int64),
                confidence=np.array([0.9, 0.8]),
                kinds={0: "person"},
            )

    whole_picture = np.zeros((270, 480, 3), dtype=np.uint8)
    monkeypatch.setattr(
        job.RenderedPictures, "pictures", lambda *_: lambda row: whole_picture
    )
    study = load_carlancap_layout()
    camera = replace(study.units[2].sensor, width_px=480, height_px=270)
    layout = replace(study, units=(replace(study.units[2], sensor=camera),))
    question = Question(
        cases="CPNC-50",
        approaches="west",
        speeds="30",
        along_arms="0",
    )
    network = NetworkDetector(
        name="test",
        model=Model(),
        min_box_height_px=12.0,
        min_confidence=0.5,
        looks_at_crops=True,
    )
    setting = build_setting(question)
    pictures = list(
        job._look(
            setting,
            layout,
            network,
            job.FitWish(layout=layout, pictures=30),
            Compute(seed=1),
            lambda *told: None,
        )
    )

    assert len(pictures) == 30
    assert {len(one.label_px) for one in pictures} <= {0, 1}

    whole = [one for one in pictures if one.is_whole]
    assert 0 < len(whole) < len(pictures) // 2

    # Whole, then smaller and smaller.
    halves = [
        (480, 270),
        (240, 135),
        (120, 67),
        (60, 33),
    ]
    assert [sizes.count(size) for size in halves] == [len(whole)] * 4
    assert len(sizes) == 30 + 4 * len(whole)  # a crop of each

    for one in pictures:  # what it finds in the crop lies around the road user
        middle = 0.5 * (one.found_px[0, :2] + one.found_px[0, 2:])
        if len(one.label_px):
            label = one.label_px[0]
        else:
            label = None
        if label is not None and label[0] > 40 and label[2] < 440:
            assert (label[:2] - 20 < middle).all()
            assert (middle < label[2:] + 20).all()
