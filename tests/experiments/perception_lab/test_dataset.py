"""The command `dataset`: what it writes, that it goes on where it stopped, and what it
refuses.
"""

import json
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_results import late_refusal, output
from json_files import read_json
from kept_backdrops import kept_backdrop
from met_cases import MET_CASES
from PIL import Image

from experiments.export.json import to_json
from experiments.perception_lab import drawing as job
from geometry.errors import InputError
from geometry.sensors import CameraModel
from placement.layout import load_carlancap_layout

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


@pytest.fixture
def dataset(run, tmp_path, monkeypatch):
    """The command, for two small cameras of the study: exit code, stdout, stderr."""
    monkeypatch.setattr(job, "build_backdrop", kept_backdrop)
    study = load_carlancap_layout()
    small = CameraModel(
        name="small",
        width_px=320,
        height_px=180,
        horizontal_fov_deg=90.0,
        frame_rate_hz=10.0,
        near_m=0.1,
        price_eur=0.0,
    )
    by_id = {unit.id: unit for unit in study.units}
    half = replace(small, name="half", width_px=960, height_px=540)
    sharp = tuple(replace(by_id[name], sensor=half) for name in ("RSU2", "RSU8"))
    (tmp_path / "sharp.json").write_text(to_json(replace(study, units=sharp)))
    units = tuple(replace(by_id[name], sensor=small) for name in ("RSU3", "RSU8"))
    (tmp_path / "two.json").write_text(to_json(replace(study, units=units)))

    def run_dataset(
        *more, out="data", every=40, layout="two.json", units="RSU3,RSU8", asked=ASKED
    ):
        return run(
            "dataset --layout",
            tmp_path / layout,
            *asked,
            "--units",
            units,
            "--every",
            every,
            "--workers 1 --out",
            out,
            *more,
        )

    return run_dataset


@pytest.fixture(scope="module")
def drawn_once(tmp_path_factory):
    """Where a dataset is, once it is drawn."""
    return tmp_path_factory.mktemp("drawn") / "data"


@pytest.fixture
def drawn(dataset, drawn_once):
    """The dataset without clouds, which several tests begin with: in the folder
    `data`.
    """
    if not drawn_once.exists():
        output(dataset("--lidar", "none", out=drawn_once))
    shutil.copytree(drawn_once, "data")
    return drawn_once


def _files(folder):
    """Contents of all files of a folder, by name."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


@pytest.mark.long
def test_pictures_clouds_labels_and_a_manifest_are_written(dataset):
    out = output(dataset("--masks", "--depth", "--json"))
    summary = json.loads(out)
    manifest = read_json(Path("data/dataset.json"))
    frames = [drive["frames"] for drive in manifest["drives"]]
    n_each = sum(len(range(0, n, 40)) for n in frames)

    assert summary["pictures"] == 2 * n_each
    assert summary["drawn"] == 2 * n_each
    assert summary["frames"] == sum(frames)
    assert [unit["id"] for unit in manifest["units"]] == ["RSU3", "RSU8"]
    for folder in ("0", "1"):
        assert len(list(Path("data", folder).glob("*.png"))) == n_each
        assert len(list(Path("data", folder).glob("*.bin"))) == n_each
        assert len(list(Path("data", folder).glob("*.txt"))) == sum(frames)
        assert len(list(Path("data/depth", folder).glob("*.png"))) == n_each

    with (
        Image.open("data/0/0_0.png") as picture,
        Image.open("data/instances/0/0_0.png") as masks,
    ):
        assert picture.size == masks.size == (320, 180)
    cloud = np.fromfile("data/0/0_0.bin", dtype="<f4").reshape(-1, 4)

    assert np.isfinite(cloud).all()
    assert len(cloud) > 1000


@pytest.mark.long
def test_a_calibration_projects_the_vru_into_its_label(dataset):
    from geometry.study_scene import load_study_scene
    from placement.question import Question
    from placement.setting import build_setting

    assert dataset("--lidar", "none", every=10**6)[0] == 0

    manifest = read_json(Path("data/dataset.json"))
    setting = build_setting(
        Question(
            cases="CPNC-50",
            approaches="east",
            speeds="40",
            along_arms="0",
        ),
        load_study_scene(),
    )
    unit = manifest["units"][0]
    n_seen = 0
    for run, drive in zip(setting.runs, manifest["drives"], strict=True):
        for frame in range(drive["frames"]):
            number = drive["first_number"] + frame
            text = Path(f"data/0/{drive['scenario']}_{number}.txt").read_text().split()
            if not text:
                continue
            middle = np.append(
                run.vru_position_m[frame], 0.5 * run.encounter.vru.height_m
            )
            seen = np.array(unit["camera_matrix"]) @ (
                np.array(unit["world_to_camera"]) @ middle + unit["translation_m"]
            )
            x, y = seen[:2] / seen[2]
            x_min, y_min, x_max, y_max = map(float, text[1:5])
            slack = 2.0 + 0.5 * (x_max - x_min)  # parts may be hidden, or cut off

            assert x_min - slack < x < x_max + slack
            assert y_min - (y_max - y_min) - 2.0 < y < y_max + (y_max - y_min) + 2.0

            n_seen += 1

    assert n_seen > 10


# Quickly: test_a_calibration_projects_the_vru_into_its_label
@pytest.mark.long
def test_read_back_it_gives_the_evaluators_verdicts(dataset, run, tmp_path):
    seen = dataset(
        "--lidar", "none", every=10**6, layout="sharp.json", units="RSU2,RSU8"
    )
    assert seen[0] == 0

    recorded = json.loads(run("evaluate --recording data --json")[1])
    judged = json.loads(
        run(
            "evaluate --layout",
            tmp_path / "sharp.json",
            *ASKED,
            "--track-memory inf --json",
        )[1]
    )
    told = {
        name: party["all"] for name, party in recorded["evaluation"]["units"].items()
    }
    known = {
        name: party["all"] for name, party in judged["evaluation"]["units"].items()
    }

    assert list(told.values()) == list(known.values())
    assert (
        recorded["evaluation"]["rsu_all"]["all"]
        == judged["evaluation"]["rsu_all"]["all"]
    )
    assert any(told.values())


@pytest.mark.long
def test_coco_is_read_by_its_own_library(dataset, capsys):
    coco = pytest.importorskip("pycocotools.coco")
    assert dataset("--format", "coco", "--lidar", "none")[0] == 0

    labels = coco.COCO("data/coco.json")
    images = labels.loadImgs(labels.getImgIds())

    assert all(Path("data", image["file_name"]).exists() for image in images)
    assert {category["name"] for category in labels.loadCats(labels.getCatIds())} == {
        *("pedestrian", "cyclist", "motorcycle", "car")
    }

    for found in labels.loadAnns(labels.getAnnIds()):
        x, y, width, height = found["bbox"]
        assert 0 <= x < x + width <= 320
        assert 0 <= y < y + height <= 180
    assert labels.getAnnIds()
    assert not list(Path("data").rglob("*.txt"))


def _labels(path):
    """Labels in a file, as words."""
    return [line.split() for line in path.read_text().splitlines()]


def _cars(path):
    """Labels of cars in a file, as words."""
    return [label for label in _labels(path) if label[0] == "car"]


def _reaches_all_sides(mask):
    """True if something of a mask, (h, w), is on each side of it."""
    sides = (mask[0], mask[-1], mask[:, 0], mask[:, -1])
    return all(side.any() for side in sides)


# Quickly: test_vehicles_are_in_coco_once
@pytest.mark.long
def test_vehicles_are_labelled_where_they_are_seen(dataset, run):
    output(dataset("--lidar", "none", "--masks", "--vehicles", every=20))
    pictures = sorted(Path("data").glob("[01]/*.png"))
    n_cars = 0
    for picture in pictures:
        with Image.open(Path("data/instances") / picture.relative_to("data")) as masks:
            pixels = np.asarray(masks).astype(int)
        for _, *box, distance_m in _cars(picture.with_suffix(".txt")):
            x_min, y_min, x_max, y_max = (int(float(side)) for side in box)
            part = pixels[y_min:y_max, x_min:x_max]
            colours, counts = np.unique(part.reshape(-1, 3), axis=0, return_counts=True)

            masks = [(part == colour).all(axis=2) for colour in colours[counts >= 20]]

            # Some colour in the box reaches all of its sides: that of the vehicle.
            assert any(_reaches_all_sides(mask) for mask in masks)
            assert 2.0 < float(distance_m) < 200.0

            n_cars += 1

    assert n_cars > len(pictures) // 4

    # Frames without pictures have none, and what reads the folder is not confused.
    others = [
        path
        for path in Path("data").glob("[01]/*.txt")
        if not path.with_suffix(".png").exists()
    ]
    assert others
    assert not any(_cars(path) for path in others)
    assert run("evaluate --recording data --json")[0] == 0

    # A picture that is missing is drawn again; nothing is labelled twice.
    before = _files("data")
    pictures[-1].unlink()

    assert dataset("--lidar", "none", "--masks", "--vehicles", every=20)[0] == 0
    assert _files("data") == before


@pytest.mark.long
def test_vehicles_are_in_coco_once(dataset):
    asked = ("--format", "coco", "--lidar", "none", "--vehicles")
    assert dataset(*asked)[0] == 0

    coco = read_json(Path("data/coco.json"))
    assert [category["name"] for category in coco["categories"]][-1] == "vehicle"

    cars = [one for one in coco["annotations"] if one["category_id"] == 5]
    assert (
        len(cars)
        == sum(len(_cars(path)) for path in Path("data").glob("[01]/*.txt"))
        > 0
    )

    ids = [one["id"] for one in coco["annotations"]]
    assert len(set(ids)) == len(ids)

    before = _files("data")
    assert dataset(*asked)[0] == 0
    assert _files("data") == before


MET = (
    *(
        "--cases",
        str(MET_CASES),
        "--protect",
        "all",
        "--approaches",
        "east",
        "--along-arms",
        "0",
    ),
)
KINDS = {"MEET-CAR": "car", "MEET-MOTORCYCLE": "motorcycle"}


# Quickly: test_vehicles_are_in_coco_once
@pytest.mark.long
def test_a_car_and_a_motorcyclist_are_labelled_as_such(dataset):
    """In the study's folders once, with vehicles and without; read back, none of them
    is a VRU.
    """
    asked = ("--lidar", "none", "--masks")
    assert dataset(*asked, asked=MET, out="plain")[0] == 0
    assert dataset(*asked, "--vehicles", asked=MET, out="all")[0] == 0

    manifest = read_json(Path("plain/dataset.json"))
    seen = dict.fromkeys(KINDS.values(), 0)
    for drive in manifest["drives"]:
        kind = KINDS[drive["run"].split("/")[0]]
        for frame in range(drive["frames"]):
            stem = f"{drive['scenario']}_{drive['first_number'] + frame}"
            for folder in ("0", "1"):
                plain = _labels(Path("plain", folder, f"{stem}.txt"))
                whole = _labels(Path("all", folder, f"{stem}.txt"))

                assert [label[0] for label in plain] == [kind] * len(plain)
                assert len(plain) <= 1

                seen[kind] += len(plain)
                others = [label for label in whole if label[0] != "car"]
                assert others == (plain if kind == "motorcycle" else [])

                is_drawn = Path("all", folder, f"{stem}.png").exists()
                if plain and kind == "car" and is_drawn:
                    # Anew, from the picture's own pixels.
                    box = np.array(plain[0][1:5], dtype=float)
                    near = [
                        np.abs(np.array(one[1:5], dtype=float) - box).max()
                        for one in whole
                    ]
                    assert sum(distance <= 2.0 for distance in near) == 1

    assert min(seen.values()) > 5


# Quickly: test_pictures_clouds_labels_and_a_manifest_are_written
@pytest.mark.long
@pytest.mark.usefixtures("drawn")
def test_varied_looks_differ_from_run_to_run_but_not_from_call_to_call(dataset):
    for out in ("one", "two"):
        output(dataset("--lidar", "none", "--vary", out=out))
    assert _files("one") == _files("two")

    plain = _files("data")
    varied = _files("one")
    assert plain.keys() == varied.keys()

    pictures = [name for name in plain if name.endswith(".png")]
    assert all(plain[name] != varied[name] for name in pictures)

    labels = [name for name in plain if name.endswith(".txt")]
    assert all(plain[name] == varied[name] for name in labels)


@pytest.mark.long
def test_it_goes_on_where_it_stopped_and_writes_nothing_twice(dataset, drawn):
    whole = _files("data")
    pictures = sorted(name for name in whole if name.endswith(".png"))
    lost = pictures[1::2]
    for name in lost:
        Path("data", name).unlink()
    half = Path("data", lost[0])  # its writer was killed a moment ago
    half.with_name(f".{half.name}.x1.tmp").write_bytes(b"half")
    stamps = {name: Path("data", name).stat().st_mtime_ns for name in pictures[::2]}
    code, out, err = dataset("--lidar", "none", "--json")

    assert code == 0
    assert json.loads(out)["drawn"] == len(lost)
    assert f"{len(pictures) - len(lost)} are there already" in err
    assert _files("data") == whole
    assert {name: Path("data", name).stat().st_mtime_ns for name in stamps} == stamps


# Quickly: test_it_goes_on_where_it_stopped_and_writes_nothing_twice
@pytest.mark.long
def test_processes_draw_the_same_and_for_one_that_dies_another(
    dataset, drawn, monkeypatch, tmp_path
):
    # A process that finds the file dies, once.
    mark = tmp_path / "die"
    mark.write_text("")
    monkeypatch.setattr(job, "draw_task", _die_once)
    monkeypatch.setenv("PLACE_RSUS_TEST_MARK", str(mark))
    output(dataset("--lidar", "none", "--workers", 2, out="other"))

    assert not mark.exists()
    assert _files("other") == _files(drawn)


def _die_once(scene, runs, task):
    """Draws as usual, but ends its process if a marked file is there."""
    mark = Path(os.environ["PLACE_RSUS_TEST_MARK"])
    if mark.exists():
        mark.unlink(missing_ok=True)
        os.kill(os.getpid(), signal.SIGKILL)
    return _draw_task(scene, runs, task)


_draw_task = job.draw_task


# Quickly: tests/experiments/engine, and below what a worker says
def test_a_folder_that_a_worker_does_not_see_is_one_line(tmp_path):
    fields = dict.fromkeys(("frames", "viewer", "lidar", "wish", "seed"), ())
    task = job.DrawTask(out=tmp_path / "elsewhere", **fields)
    said = r"--out: got .*elsewhere, which a worker on .* does not see; expected a fold"

    with pytest.raises(InputError, match=said):
        _draw_task(None, (), task)


@pytest.mark.long
def test_a_full_disk_stops_it_and_leaves_what_is_drawn(dataset, monkeypatch):
    n_written = 0
    write = job.write_atomically

    def fill(path, content):
        nonlocal n_written
        n_written += 1
        if n_written > 2:
            raise OSError(28, "No space left on device", str(path))
        write(path, content)

    monkeypatch.setattr(job, "write_atomically", fill)
    line = late_refusal(dataset("--lidar", "none"))

    assert "No space left on device" in line
    assert len(list(Path("data").rglob("*.png"))) == 2


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            ("--units", "RSU2"),
            "--units: got 'RSU2'; expected cameras of the layout: RSU3, RSU8, VUT",
        ),
        (("--every", "0"), "--every: got '0'; expected a number of frames, at least 1"),
        (("--lidar", "radar"), "--lidar: got 'radar'; expected one of"),
        (("--detector", "net.onnx"), "net.onnx"),
    ],
)
def test_what_cannot_be_written_is_said_in_a_line(dataset, more, message):
    line = late_refusal(dataset(*more))
    assert message in line
    assert not Path("data").exists()


@pytest.mark.long
@pytest.mark.usefixtures("drawn")
def test_a_folder_of_another_dataset_or_of_something_else_is_left_alone(dataset):
    before = _files("data")
    code, _, err = dataset("--lidar", "none", "--seed", 1)

    assert code == 2
    assert (
        err.splitlines()[-1]
        == "place-rsus: --out: got data, a dataset with seed 0; expected a new folder,"
        " or the same dataset"
    )
    assert _files("data") == before

    Path("mine").mkdir()
    Path("mine/letter.txt").write_text("mine")
    code, _, err = dataset("--lidar", "none", out="mine")

    assert code == 2
    assert _files("mine") == {"letter.txt": b"mine"}
    assert "a folder that is not empty" in err.splitlines()[-1]
