"""A dataset for training and testing detectors.

Pictures, point clouds and labels of many runs.

The text files of the folder (labels, motion, perfect detections, manifest) are written
first, whole or not at all; pictures and clouds follow (:mod:`.drawing`). What is there
already is not drawn again: the same call goes on where another one stopped.
"""

import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.calibrations import to_calibrated
from geometry.catalogue import pick_sensor
from geometry.errors import InputError, refuse
from geometry.lidar import LidarModel
from geometry.locks import is_abandoned
from geometry.opening import read_text
from geometry.poses import Pose
from geometry.sensors import CameraModel
from geometry.tables import read_table
from geometry.terrain import on_ground
from geometry.text_formats import parse_json
from geometry.writing import write_atomically
from placement.compute import Compute
from placement.detectors import Evidence, is_matched, load_min_iou
from placement.evaluator import (
    build_surroundings,
    load_vut_camera,
    perceive_frames,
)
from placement.evaluator.evaluate import VUT_KEY, build_rng, unit_key
from placement.evaluator.pictures import VUT_UNIT
from placement.layout import Layout
from placement.question import Question, split_names
from placement.recordings import (
    FrameKey,
    WrittenDrive,
    load_format,
    write_folder,
    write_recording,
)
from placement.recordings.files import json_of, read_labels
from placement.setting import Setting, build_setting
from scenarios.runs import Run

from ..engine.start import EngineWish
from ..export.calibration import refuse_lenses
from ..language import mark
from ..progress import StageProgress
from ..results.record import Record
from .drawing import DEPTHS, DRAW, MASKS, DatasetWish, DrawTask, Viewer, draw_all

MANIFEST = "dataset.json"
_SCHEMA = "place-rsus/dataset/1"
NO_LIDAR = "none"
_COCO_FILE = "coco.json"
# What the VUT meets, by class: its category in COCO, and the study's actor type.
_COCO_CLASSES = {
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
    "motorcyclist": "motorcycle",
    "car": "car",
}
_ACTOR_TYPES = {**_COCO_CLASSES, "cyclist": "bicycle"}
# Drawn by one worker before it gives word.
_TASK_PICTURES = 60
# Of a PNG with sensor noise, as measured by day.
_BYTES_PER_PIXEL = 1.75
_BYTES_PER_POINT = 16
# Of the camera that drives.
_NOWHERE = Pose(position_m=np.zeros(3), yaw_deg=0.0)


class DatasetUnit(Record, frozen=True):
    """A unit of a dataset: its folder, and its camera's calibration as OpenCV has it.

    Attributes
    ----------
    folder : str
        Name of its folder.
    id : str
        Of the unit in its layout, or "VUT".
    width_px, height_px : int
        Size of the pictures.
    camera_matrix : tuple
        K; the middle of the first pixel is (0, 0). [px]
    world_to_camera, translation_m : tuple or None
        R and t, x_camera = R x_world + t; None of the VUT's camera, which drives.
    """

    # Name of its folder.
    folder: str
    # Of the unit in its layout, or "VUT".
    id: str
    # width_px, height_px: size of the pictures
    width_px: int
    height_px: int
    camera_matrix: tuple[
        tuple[float, ...], ...
    ]  # K; the middle of the first pixel is (0, 0). [px]
    # world_to_camera, translation_m: R and t, x_camera = R x_world + t; None of the
    # VUT's camera, which drives
    world_to_camera: tuple[tuple[float, ...], ...] | None
    translation_m: tuple[float, ...] | None


class DatasetDrive(Record, frozen=True):
    """A run as part of a dataset: files of its frames are called SCENARIO_NUMBER.

    Attributes
    ----------
    run : str
        Id.
    weather : str
        Of the run.
    scenario, first_number, frames : int
        Of the names of its files; numbers run on.
    last_brake_time_s : float or None
        Relative to the impact, which is the last frame; None: braking cannot help. [s]
    """

    # Id.
    run: str
    # Of the run.
    weather: str
    # scenario, first_number, frames: of the names of its files; numbers run on
    scenario: int
    first_number: int
    frames: int
    # relative to the impact, which is the last frame; None: braking cannot help. [s]
    last_brake_time_s: float | None

    def pictured(self, every: int) -> range:
        """Frames with pictures: every so many."""
        return range(0, self.frames, every)

    def stem(self, frame: int) -> str:
        """Name of a frame's files, without its ending."""
        return FrameKey(
            self.scenario, self.first_number + frame
        ).file_name.removesuffix(".txt")


class DatasetRecord(Record, frozen=True):
    """``dataset.json``: what a dataset holds.

    A folder with another one is not added to.

    Attributes
    ----------
    schema : str
        Name and version of the file's format.
    format : str
        One of ``FORMATS``.
    scene : str
        Name of the junction.
    detector : str
        Whose detections are in ``Eval``.
    every : int
        Pictures are of every so many frames of a run.
    lidar : str
        Model of the LiDAR beside each camera; "none" for none.
    masks, depth : bool
        Whether there are pictures of instances and of depths.
    vehicles : bool
        Whether vehicles have labels, too, in frames with pictures.
    vary : bool
        Whether clothes, paints and facades are others in each run.
    seed : int
        Of noise, of what is left to chance.
    units, drives : tuple
        Who looks, and at what.
    """

    # Name and version of the file's format.
    schema: str
    # One of ``FORMATS``.
    format: str
    # Name of the junction.
    scene: str
    # Whose detections are in ``Eval``.
    detector: str
    # Pictures are of every so many frames of a run.
    every: int
    # Model of the LiDAR next to each camera; "none" for none.
    lidar: str
    # masks, depth: there are pictures of instances and of depths
    masks: bool
    depth: bool
    # Vehicles have labels, too, in frames with pictures.
    vehicles: bool
    # Clothes, paints and facades are others in each run.
    vary: bool
    # Of noise, of what is left to chance.
    seed: int
    # units, drives: who looks, and at what
    units: tuple[DatasetUnit, ...]
    drives: tuple[DatasetDrive, ...]


class DatasetSummary(Record, frozen=True):
    """What a call has done.

    Attributes
    ----------
    folder : str
        Where the dataset is.
    pictures, drawn : int
        In it, and of these drawn by this call.
    frames, runs, units : int
        Of the dataset.
    size_bytes : int
        Of pictures and clouds drawn by this call.
    seconds : float
        For drawing.
    """

    # Where the dataset is.
    folder: str
    # pictures, drawn: in it, and of these drawn by this call
    pictures: int
    drawn: int
    # frames, runs, units: of the dataset
    frames: int
    runs: int
    units: int
    # Of pictures and clouds drawn by this call.
    size_bytes: int
    # For drawing.
    seconds: float


def load_manifest(path: Path) -> DatasetRecord:
    """Read ``dataset.json``; InputError if it is something else."""
    return read_table(json_of(path), DatasetRecord, str(path))


def run_dataset(
    question: Question,
    *,
    layout: Layout,
    wish: DatasetWish,
    out: Path,
    engine: EngineWish,
    compute: Compute,
    progress: StageProgress,
    tell: Callable[[str], None],
) -> DatasetSummary:
    """Write a dataset, or go on with one.

    Parameters
    ----------
    question : Question
        What is driven, and the detector whose detections are written.
    layout : Layout
        Whose cameras look.
    wish : DatasetWish
        What is written.
    out : Path
        Folder: new, empty, or of the same dataset.
    engine : EngineWish
        Where pictures are drawn; workers elsewhere see the folder, too.
    compute : Compute
        Seed.
    progress : StageProgress
        Is told the stages.
    tell : callable
        Is told, before anything is drawn, how much it will be.

    Raises
    ------
    InputError
        The layout has no such units, or LiDARs among them; the folder holds something
        else; the scheduler does not answer.
    OSError
        The disk is full: what is drawn stays.
    """
    if wish.lidar == NO_LIDAR:
        lidar = None
    else:
        lidar = pick_sensor(wish.lidar, "--lidar", kind="lidar")
    assert lidar is None or isinstance(lidar, LidarModel)
    viewers = _pick_viewers(layout, wish.units)
    progress(mark("lay the runs"), 0, 0)
    setting = build_setting(question, compute=compute)
    record = _build_record(setting, layout, viewers, wish, compute.seed)
    if not _is_begun(out, record):
        _write_texts(out, setting, viewers, record, compute, progress)
    progress.kept = (
        f"the dataset in {out} is not complete; the same command goes on with it"
    )
    tasks = list(_tasks(out, setting, viewers, record, wish, lidar))
    n_each = sum(len(drive.pictured(record.every)) for drive in record.drives)
    n_pictures = n_each * len(viewers)
    n_missing = sum(len(task.frames) for task in tasks)
    tell(_size_sentence(n_pictures, n_missing, out, tasks, lidar))
    n_bytes = draw_all(setting.scene, setting.runs, tasks, engine, progress, tell)
    # Of workers that were killed while they wrote.
    for left in out.rglob(".*.tmp"):
        if is_abandoned(left, min_age_s=0.0):
            left.unlink(missing_ok=True)
    if record.vehicles and record.format == "coco":
        _add_vehicles(out)
    progress.kept = f"the dataset is in {out}"
    seconds = progress.finish()
    return DatasetSummary(
        folder=str(out),
        pictures=n_pictures,
        drawn=n_missing,
        frames=setting.axis.n_frames,
        runs=len(setting.runs),
        units=len(viewers),
        size_bytes=n_bytes,
        seconds=seconds.get(DRAW, 0.0),
    )


def _pick_viewers(layout: Layout, names: str) -> tuple[Viewer, ...]:
    """Cameras by name; folders count the layout's units from 0, as the study does."""
    form = load_format()
    mount = load_vut_camera()
    known = {
        unit.id: Viewer(str(number), unit.id, unit_key(unit), unit.pose, unit.sensor)
        for number, unit in enumerate(layout.units)
        if isinstance(unit.sensor, CameraModel)
    }
    known[VUT_UNIT] = Viewer(form.vut_folder, VUT_UNIT, VUT_KEY, None, mount.camera)
    if not names:
        return tuple(known.values())
    wanted = split_names(names, "--units")
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise InputError(
            "--units", unknown[0], "cameras of the layout: " + ", ".join(known)
        )
    return tuple(known[name] for name in wanted)


def _build_record(
    setting: Setting,
    layout: Layout,
    viewers: Sequence[Viewer],
    wish: DatasetWish,
    seed: int,
) -> DatasetRecord:
    # Its records have no place for them.
    refuse_lenses(layout, "dataset")
    units = [
        DatasetUnit(
            folder=viewer.folder,
            id=viewer.id,
            width_px=viewer.camera.width_px,
            height_px=viewer.camera.height_px,
            camera_matrix=_rows(found.K),
            world_to_camera=(
                None if viewer.pose is None else _rows(found.R_camera_world)
            ),
            translation_m=(
                None if viewer.pose is None else tuple(found.translation_m.tolist())
            ),
        )
        for viewer in viewers
        for found in [to_calibrated(viewer.camera, viewer.pose or _NOWHERE)]
    ]
    scenario: dict[tuple[str, ...], int] = {}
    numbers = itertools.accumulate((len(run.time_s) for run in setting.runs), initial=0)
    drives = [
        DatasetDrive(
            run=run.id,
            weather=run.weather,
            scenario=scenario.setdefault(
                (run.case.name, run.approach, run.position, run.weather), len(scenario)
            ),
            first_number=first,
            frames=len(run.time_s),
            last_brake_time_s=last if np.isfinite(last) else None,
        )
        for run, first, last in zip(
            setting.runs, numbers, setting.axis.last_brake_time_s.tolist(), strict=False
        )
    ]
    return DatasetRecord(
        schema=_SCHEMA,
        scene=setting.scene.name,
        detector=setting.detector.name,
        seed=seed,
        drives=tuple(drives),
        **(asdict(wish) | {"units": tuple(units)}),
    )


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, matrix.tolist()))


def _is_begun(out: Path, record: DatasetRecord) -> bool:
    """True if a folder holds this dataset or a part of it.

    InputError if it holds another one.
    """
    if not (out / MANIFEST).exists():
        return False
    found = load_manifest(out / MANIFEST)
    for name in DatasetRecord.__struct_fields__:
        other = getattr(found, name)
        if other != getattr(record, name):
            if isinstance(other, tuple):
                what = f"other {name}"
            else:
                what = f"{name} {other}"
            refuse(
                "--out",
                f"{out}, a dataset with {what}",
                "a new folder, or the same dataset",
            )
    return True


def _write_texts(
    out: Path,
    setting: Setting,
    viewers: Sequence[Viewer],
    record: DatasetRecord,
    compute: Compute,
    progress: StageProgress,
) -> None:
    """Begin a dataset: all its text files."""
    evidence = {}
    surroundings = build_surroundings(setting.scene, setting.runs)
    for n_done, viewer in enumerate(viewers):
        progress(mark("label"), n_done, len(viewers))
        if viewer.pose is None:
            fixed = None
        else:
            fixed = (viewer.pose, viewer.camera)
        evidence[viewer.folder] = perceive_frames(
            surroundings, fixed or load_vut_camera()
        )
    progress(mark("write labels"), 0, 0)
    out.parent.mkdir(parents=True, exist_ok=True)
    also = {MANIFEST: msgspec.json.format(msgspec.json.encode(record)).decode() + "\n"}
    folders = [
        f"{kind}/{viewer.folder}"
        for kind, is_wanted in ((MASKS, record.masks), (DEPTHS, record.depth))
        for viewer in viewers
        if is_wanted
    ]
    if record.format == "coco":
        also[_COCO_FILE] = json.dumps(_coco(setting, viewers, record, evidence))
        write_folder(out, also.items(), folders=[viewer.folder for viewer in viewers])
    else:
        detected = {
            viewer.folder: _detected(
                setting, viewer, evidence[viewer.folder], compute.seed
            )
            for viewer in viewers
        }
        drives = _drives(setting, viewers, record, evidence, detected)
        write_recording(out, drives, n_reset_frames=0, also=also)
    for name in folders:
        (out / name).mkdir(parents=True, exist_ok=True)


def _detected(
    setting: Setting, viewer: Viewer, evidence: Evidence, seed: int
) -> BoolArray:
    """Frames in which the question's detector finds the VRU.

    As the evaluator has it.
    """
    detector = setting.detector
    if detector.needs_pictures:
        raise InputError(
            "--detector",
            detector.name,
            "one that needs no pictures: box or response, or a table",
        )
    found = detector.detect(evidence, build_rng(seed, viewer.key))
    return is_matched(found, evidence.visible_px, min_iou=load_min_iou())


def _drives(
    setting: Setting,
    viewers: Sequence[Viewer],
    record: DatasetRecord,
    evidence: Mapping[str, Evidence],
    detected: Mapping[str, BoolArray],
) -> list[WrittenDrive]:
    drives = []
    for index, (run, drive) in enumerate(zip(setting.runs, record.drives, strict=True)):
        frames = setting.axis.frames_of(index)
        apart = np.linalg.norm(run.vut_position_m - run.vru_position_m, axis=1)
        labels = {
            viewer.folder: evidence[viewer.folder].visible_px[frames]
            for viewer in viewers
        }
        drives.append(
            WrittenDrive(
                scenario=drive.scenario,
                vru_class=_ACTOR_TYPES[run.encounter.vru.class_name],
                vut_speed_mps=run.encounter.vut_motion.speed_mps,
                vru_speed_mps=run.encounter.vru_motion.speed_mps,
                distance_m=apart,
                labels_px=labels,
                detections_px={
                    name: boxes * detected[name][frames, None]
                    for name, boxes in labels.items()
                },
                label_distance_m={
                    viewer.folder: (
                        apart if viewer.pose is None else _away(run, viewer.pose)
                    )
                    for viewer in viewers
                },
            )
        )
    return drives


def _away(run: Run, pose: Pose) -> FloatArray:
    feet_m = on_ground(run.vru_position_m, run.terrain)
    distance: FloatArray = np.linalg.norm(feet_m - pose.position_m, axis=1)
    return distance


def _coco(
    setting: Setting,
    viewers: Sequence[Viewer],
    record: DatasetRecord,
    evidence: Mapping[str, Evidence],
) -> dict[str, Any]:
    """Boxes of what is visible, in the format of COCO's detection data."""
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for viewer, (index, drive) in itertools.product(viewers, enumerate(record.drives)):
        seen = evidence[viewer.folder]
        start = setting.axis.frames_of(index).start
        for frame in drive.pictured(record.every):
            images.append(
                {
                    "id": len(images) + 1,
                    "file_name": f"{viewer.folder}/{drive.stem(frame)}.png",
                    "width": viewer.camera.width_px,
                    "height": viewer.camera.height_px,
                    "run": drive.run,
                    "frame": frame,
                }
            )
            x_min, y_min, x_max, y_max = seen.visible_px[start + frame].tolist()
            if x_max <= x_min or y_max <= y_min:
                continue
            share = np.broadcast_to(seen.visible_share, len(seen))[start + frame]
            category = 1 + [*_COCO_CLASSES].index(
                setting.runs[index].encounter.vru.class_name
            )
            box_px = (x_min, y_min, x_max, y_max)
            annotation = _annotation(
                len(annotations) + 1, len(images), category, box_px
            )
            annotations.append(annotation | {"visible_share": float(share)})
    categories = [
        {"id": number, "name": name}
        for number, name in enumerate(_COCO_CLASSES.values(), 1)
    ]
    return {
        "info": {"description": f"place-rsus dataset of {record.scene}"},
        "images": images,
        "annotations": annotations,
        "categories": categories,
    }


def _annotation(
    number: int,
    image_id: int,
    category_id: int,
    box_px: tuple[float, float, float, float],
) -> dict[str, Any]:
    x_min, y_min, x_max, y_max = box_px
    return {
        "id": number,
        "image_id": image_id,
        "category_id": category_id,
        "bbox": [x_min, y_min, x_max - x_min, y_max - y_min],
        "area": (x_max - x_min) * (y_max - y_min),
        "iscrowd": 0,
    }


def _add_vehicles(out: Path) -> None:
    """Label vehicles in ``coco.json``, once.

    As the text files next to the pictures have them.
    """
    form = load_format()
    path = out / _COCO_FILE
    coco = parse_json(read_text(path, "JSON"), str(path), "labels of pictures")
    number = len(_COCO_CLASSES) + 1
    if any(category["id"] == number for category in coco["categories"]):
        return
    for image in coco["images"]:
        labels, _ = read_labels((out / image["file_name"]).with_suffix(".txt"), form)
        for label in labels:
            numbers = (len(coco["annotations"]) + 1, image["id"], number)
            coco["annotations"].append(_annotation(*numbers, label.box_px))
    coco["categories"].append({"id": number, "name": "vehicle"})
    write_atomically(path, json.dumps(coco))


def _tasks(
    out: Path,
    setting: Setting,
    viewers: Sequence[Viewer],
    record: DatasetRecord,
    wish: DatasetWish,
    lidar: LidarModel | None,
) -> Iterator[DrawTask]:
    """Everything that is still to be drawn, in parts for workers."""
    for viewer in viewers:
        there = {entry.name for entry in os.scandir(out / viewer.folder)}
        groups: dict[tuple[object, ...], list[tuple[int, int, str]]] = {}
        for index, (run, drive) in enumerate(
            zip(setting.runs, record.drives, strict=True)
        ):
            key = (run.weather, *(parked.key for parked in run.obstruction))
            for frame in drive.pictured(record.every):
                stem = drive.stem(frame)
                if f"{stem}.png" not in there:
                    groups.setdefault(key, []).append((index, frame, stem))
        for frames in groups.values():
            for begin in range(0, len(frames), _TASK_PICTURES):
                part = frames[begin : begin + _TASK_PICTURES]
                yield DrawTask(
                    out=out.absolute(),
                    frames=tuple(part),
                    viewer=viewer,
                    lidar=lidar,
                    wish=wish,
                    seed=record.seed,
                )


def _size_sentence(
    n_pictures: int,
    n_missing: int,
    out: Path,
    tasks: Iterable[DrawTask],
    lidar: LidarModel | None,
) -> str:
    n_bytes = 0.0
    for task in tasks:
        camera = task.viewer.camera
        each = _BYTES_PER_PIXEL * camera.width_px * camera.height_px
        if lidar is not None:
            each += _BYTES_PER_POINT * lidar.points_per_second / lidar.frame_rate_hz
        n_bytes += each * len(task.frames)
    free = shutil.disk_usage(out).free
    there = n_pictures - n_missing
    sentence = f"{n_missing:,} pictures are drawn, about {n_bytes / 1e9:.1f} GB"
    if there:
        sentence += f"; {there:,} are there already"
    if n_bytes > free:
        sentence += f". {out} has room for {free / 1e9:.1f} GB only"
    return sentence + "."
