"""Pictures and point clouds of many frames, drawn by processes.

Each file is written whole or not at all, and what is there already is not drawn again.
"""

import multiprocessing
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError, Unquoted
from geometry.files import read_text, write_atomically
from geometry.lidar import LidarModel
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.weather import pick_weather
from placement.compute import Compute
from placement.evaluator import load_vut_camera
from placement.evaluator.evaluate import UnitKey, build_rng
from placement.evaluator.pictures import vut_camera_pose
from placement.imaging import Picture, PointCloud, build_backdrop, draw_picture
from placement.imaging.materials import Materials, load_materials, vary_materials
from placement.imaging.mesh import build_frame_mesh, scan_mesh
from scenarios.runs import Run

from ..progress import StageProgress, follow_parent
from .render import cloud_bytes, depth_image, instance_image

DRAW = "draw"
"""The stage in which pictures are drawn."""

FORMATS = ("carlancap", "coco")
MASKS, DEPTHS = "instances", "depth"
"""Folders of the pictures other than those in colour."""

_VEHICLE = "car"  # the study's actor type
_MOVING = re.compile(r"vut|(parked|driving)-\d+")  # what a run brings along
_LEAST_VEHICLE_PX = 20  # pixels; of less a vehicle has no label
_TRIES = 3  # of a task whose worker dies

Content = str | bytes | Callable[[BinaryIO], object]


@dataclass(frozen=True, slots=True, eq=False)
class Viewer:
    """A camera of the dataset: a roadside unit, or the VUT's."""

    folder: str
    id: str
    key: UnitKey  # with which the evaluator seeds its random numbers
    pose: Pose | None  # None: on the VUT
    camera: CameraModel


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetWish:
    """Contents of a dataset besides the labels of all frames."""

    format: str = FORMATS[0]  # "carlancap": the study's folders; "coco": pictures and ``coco.json``
    units: str = ""  # ids with commas between, "VUT" among them; empty: all, and the VUT
    every: int = 1  # pictures of every so many frames of a run; labels and motion are of all
    lidar: str = "carla-ncap-lidar"  # model of a LiDAR next to each camera, or "none"
    # masks, depth: pictures of instances and of depths are written, too
    masks: bool = False
    depth: bool = False
    vehicles: bool = False  # vehicles get labels, too, in frames with pictures
    vary: bool = False  # clothes, paints and facades are drawn at random for each run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawTask:
    """Frames that one camera sees in one weather, with the same parked vehicles."""

    out: Path
    scene: Scene
    runs: tuple[Run, ...]
    frames: tuple[tuple[int, int, str], ...]  # index of the run, frame, name of the files
    viewer: Viewer
    lidar: LidarModel | None
    wish: DatasetWish
    seed: int

    def files(self, stem: str) -> dict[str, Path]:
        """Files of a frame, by kind; the picture comes last: where it is, all are."""
        folder, wish = self.viewer.folder, self.wish
        wanted = {
            "cloud": self.lidar is not None and self.out / folder / f"{stem}.bin",
            "masks": wish.masks and self.out / MASKS / folder / f"{stem}.png",
            "depth": wish.depth and self.out / DEPTHS / folder / f"{stem}.png",
            "vehicles": wish.vehicles and self.out / folder / f"{stem}.txt",
            "picture": self.out / folder / f"{stem}.png",
        }
        return {kind: path for kind, path in wanted.items() if path}


def draw_task(task: DrawTask) -> int:
    """Draw what is missing of a task; the number of bytes written.

    Raises OSError: something cannot be written.
    """
    parent = os.getppid()
    draw = _drawer(task)
    n_bytes = 0
    for index, frame, stem in task.frames:
        if os.getppid() != parent:  # whoever asked for it is gone
            break
        files = task.files(stem)
        if files["picture"].exists():
            continue
        run = task.runs[index]
        for kind, content in _contents(*draw(run, frame), files, task, run):
            write_atomically(files[kind], content)
            n_bytes += files[kind].stat().st_size
    return n_bytes


def _drawer(task: DrawTask) -> Callable[[Run, int], tuple[Picture, PointCloud | None]]:
    """A function that draws and scans a frame: from the VUT anew, at the roadside onto a still."""
    # loads the compiler
    from placement.imaging.stills import Still, draw_onto, draw_still, scan_onto

    first, pose, lidar = task.runs[0], task.viewer.pose, task.lidar
    compute = Compute(seed=task.seed, workers=1)
    weather = pick_weather(first.weather, "weather")
    backdrop = build_backdrop(task.scene, first.obstruction)
    stills: dict[str, Still] = {}  # the last one

    def materials(run: Run) -> Materials | None:
        """One and the same for all cameras and weathers."""
        if not task.wish.vary:
            return None
        encounter = run.id.removesuffix(f"/{run.weather}")
        return vary_materials(load_materials(), build_rng(task.seed, "look", encounter))

    def draw_at_roadside(run: Run, frame: int) -> tuple[Picture, PointCloud | None]:
        assert pose is not None
        look = run.id if task.wish.vary else ""
        if look not in stills:
            stills.clear()
            stills[look] = draw_still(
                *(backdrop, pose, task.viewer.camera),
                weather=weather,
                materials=materials(run),
                compute=compute,
            )
        picture = draw_onto(stills[look], run, frame, compute=compute)
        if lidar is None:
            return picture, None
        return picture, scan_onto(stills[look], run, frame, lidar, seed=task.seed)

    def draw_from_vut(run: Run, frame: int) -> tuple[Picture, PointCloud | None]:
        at = vut_camera_pose(load_vut_camera(), run, frame)
        picture = draw_picture(
            *(backdrop, run, frame, at, task.viewer.camera),
            weather=weather,
            with_vut=False,
            materials=materials(run),
            compute=compute,
        )
        if lidar is None:
            return picture, None
        mesh = build_frame_mesh(backdrop.mesh, run, frame, at.position_m, with_vut=False)
        return picture, scan_mesh(mesh, run, at, lidar, weather=weather, seed=task.seed)

    return draw_from_vut if pose is None else draw_at_roadside


def _contents(
    picture: Picture, cloud: PointCloud | None, files: Mapping[str, Path], task: DrawTask, run: Run
) -> Iterator[tuple[str, Content]]:
    """Contents of the files of a frame, by kind, in the order of :meth:`DrawTask.files`."""
    if cloud is not None:
        yield "cloud", cloud_bytes(cloud)
    if "masks" in files:
        yield "masks", _png(instance_image(picture))
    if "depth" in files:
        yield "depth", _png(depth_image(picture))
    if "vehicles" in files:
        yield "vehicles", _with_vehicles(files["vehicles"], picture, task, run)
    yield "picture", _png(picture.rgb)


def _with_vehicles(path: Path, picture: Picture, task: DrawTask, run: Run) -> str:
    """Lines of a label file, and one for each vehicle of which enough is seen."""
    lines = read_text(path, "labels").splitlines() if path.exists() else []
    lines = [line for line in lines if not line.startswith(f"{_VEHICLE} ")]
    known = {one.id for one in task.scene.instances if "vehicle" in one.class_name}
    if task.wish.format == FORMATS[0] and run.encounter.vru.class_name == _VEHICLE:
        known.add("vru")  # whose line was taken away with the others'
    camera = task.viewer.camera
    for index in np.unique(picture.instance[picture.instance >= 0]).tolist():
        name = picture.names[index]
        rows, columns = np.nonzero(picture.instance == index)
        if not (name in known or _MOVING.fullmatch(name)) or len(rows) < _LEAST_VEHICLE_PX:
            continue
        offsets = np.hypot(
            columns + 0.5 - 0.5 * camera.width_px, rows + 0.5 - 0.5 * camera.height_px
        )
        away_m = picture.depth_m[rows, columns] * np.hypot(1.0, offsets / camera.focal_length_px)
        box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1, away_m.mean())
        lines.append(f"{_VEHICLE} {' '.join(str(float(number)) for number in box)}")
    return "".join(f"{line}\n" for line in lines)


def _png(pixels: NDArray[Any]) -> Content:
    from PIL import Image

    # Noise does not shrink: more effort makes files 7 % smaller in three times the time.
    return lambda file: Image.fromarray(pixels).save(file, format="PNG", compress_level=1)


# ---------- workers


def draw_all(tasks: Sequence[DrawTask], n_workers: int, progress: StageProgress) -> int:
    """Draw all tasks by processes; those of ones that die are drawn again. Bytes written."""
    n_all, n_drawn, n_bytes = sum(len(task.frames) for task in tasks), 0, 0
    progress(DRAW, 0, n_all)

    def note(task: DrawTask, size: int) -> None:
        nonlocal n_drawn, n_bytes
        n_drawn += len(task.frames)
        n_bytes += size
        progress(DRAW, n_drawn, n_all)

    if n_workers == 1:
        for task in tasks:
            note(task, draw_task(task))
        return n_bytes
    left = dict(enumerate(tasks))
    for attempt in range(1, _TRIES + 1):
        executor = ProcessPoolExecutor(
            n_workers,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=follow_parent,
        )
        pending: dict[Future[int], int] = {}
        try:
            pending = {executor.submit(draw_task, task): key for key, task in left.items()}
            for future in as_completed(pending):
                note(left[pending[future]], future.result())
                del left[pending[future]]
            return n_bytes
        except BrokenProcessPool:
            if attempt == _TRIES:
                raise InputError(
                    "--workers",
                    Unquoted(f"a process that was killed, {_TRIES} times"),
                    "enough memory for each: fewer workers",
                ) from None
        finally:
            for future in pending:
                future.cancel()
            executor.shutdown(wait=False)
    return n_bytes
