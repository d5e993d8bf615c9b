"""Pictures and point clouds as files: of one frame, and of many, drawn by processes.

Each file is written whole or not at all, and what is there already is not drawn again.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from platform import node
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from geometry.catalogue import Sensor
from geometry.errors import InputError, Unquoted
from geometry.image_boxes import mask_box
from geometry.lidar import LidarModel
from geometry.opening import read_text
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.weather import pick_weather
from geometry.writing import check_target, write_atomically
from placement.compute import Compute
from placement.evaluator import load_vut_camera
from placement.evaluator.evaluate import UnitKey, build_rng
from placement.evaluator.pictures import vut_camera_pose
from placement.imaging import PointCloud, RenderedPicture, build_backdrop, draw_picture
from placement.imaging.materials import Materials, load_materials, vary_materials
from placement.imaging.mesh import build_frame_mesh, scan_mesh
from scenarios.runs import Run

from ..engine.start import EngineWish, start_engine
from ..engine.tasks import TRIES, WorkerDiedError, map_tasks
from ..language import mark
from ..progress import StageProgress

DRAW = mark("draw")
"""The stage in which pictures are drawn."""

FORMATS = ("carlancap", "coco")
MASKS = "instances"
DEPTHS = "depth"
"""Folders of the pictures other than those in colour."""

# The study's actor type.
_VEHICLE = "car"
# What a run brings along.
_MOVING = re.compile(r"vut|(parked|driving)-\d+")
# Pixels; of less a vehicle has no label.
_LEAST_VEHICLE_PX = 20

Content = str | bytes | Callable[[BinaryIO], object]


@dataclass(frozen=True, slots=True, eq=False)
class Viewer:
    """A camera of the dataset: a roadside unit, or the VUT's."""

    folder: str
    id: str
    # With which the evaluator seeds its random numbers.
    key: UnitKey
    # None: on the VUT.
    pose: Pose | None
    camera: CameraModel


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetWish:
    """Contents of a dataset besides the labels of all frames."""

    # "carlancap": the study's folders; "coco": pictures and ``coco.json``.
    format: str = FORMATS[0]
    # ids with commas between, "VUT" among them; empty: all, and the VUT
    units: str = ""
    # pictures of every so many frames of a run; labels and motion are of all
    every: int = 1
    # Model of a LiDAR next to each camera, or "none".
    lidar: str = "carla-ncap-lidar"
    # masks, depth: pictures of instances and of depths are written, too
    masks: bool = False
    depth: bool = False
    # Vehicles get labels, too, in frames with pictures.
    vehicles: bool = False
    # Clothes, paints and facades are drawn at random for each run.
    vary: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawTask:
    """Frames that one camera sees in one weather, with the same parked vehicles."""

    out: Path
    # Index of the run, frame, name of the files.
    frames: tuple[tuple[int, int, str], ...]
    viewer: Viewer
    lidar: LidarModel | None
    wish: DatasetWish
    seed: int

    def path(self, kind: str, stem: str) -> Path:
        """File of a frame: "cloud", "masks", "depth", "vehicles" or "picture"."""
        folder = {"masks": MASKS, "depth": DEPTHS}.get(kind, "")
        suffix = {"cloud": ".bin", "vehicles": ".txt"}.get(kind, ".png")
        return self.out / folder / self.viewer.folder / f"{stem}{suffix}"


def draw_task(scene: Scene, runs: Sequence[Run], task: DrawTask) -> int:
    """Draw what is missing of a task; the number of bytes written.

    Raises OSError: something cannot be written; InputError: the folder is not there, on
    another machine.
    """
    if not task.out.is_dir():
        got = f"{task.out}, which a worker on {node()} does not see"
        raise InputError("--out", Unquoted(got), "a folder that all workers see")
    draw = _drawer(scene, runs[task.frames[0][0]], task)
    n_bytes = 0
    for index, frame, stem in task.frames:
        if task.path("picture", stem).exists():
            continue
        run = runs[index]
        seen = draw(run, frame)
        for kind, content in _contents(*seen, scene, task, run, stem):
            path = task.path(kind, stem)
            write_atomically(path, content)
            n_bytes += path.stat().st_size
    return n_bytes


def _drawer(
    scene: Scene, first: Run, task: DrawTask
) -> Callable[[Run, int], tuple[RenderedPicture, PointCloud | None]]:
    """A function that draws and scans a frame.

    From the VUT anew, at the roadside onto a still.
    """
    # loads the compiler
    from placement.imaging.stills import Still, draw_onto, draw_still, scan_onto

    pose = task.viewer.pose
    lidar = task.lidar
    compute = Compute(seed=task.seed, workers=1)
    weather = pick_weather(first.weather, "weather")
    backdrop = build_backdrop(scene, first.obstruction)
    # The last one.
    stills: dict[str, Still] = {}

    def materials(run: Run) -> Materials | None:
        """One and the same for all cameras and weathers."""
        if not task.wish.vary:
            return None
        encounter = run.id.removesuffix(f"/{run.weather}")
        return vary_materials(load_materials(), build_rng(task.seed, "look", encounter))

    def draw_at_roadside(
        run: Run, frame: int
    ) -> tuple[RenderedPicture, PointCloud | None]:
        assert pose is not None
        if task.wish.vary:
            look = run.id
        else:
            look = ""
        if look not in stills:
            stills.clear()
            stills[look] = draw_still(
                backdrop,
                pose,
                task.viewer.camera,
                weather=weather,
                materials=materials(run),
                compute=compute,
            )
        picture = draw_onto(stills[look], run, frame, compute=compute)
        if lidar is None:
            return picture, None
        return picture, scan_onto(stills[look], run, frame, lidar, seed=task.seed)

    def draw_from_vut(
        run: Run, frame: int
    ) -> tuple[RenderedPicture, PointCloud | None]:
        at = vut_camera_pose(load_vut_camera(), run, frame)
        picture = draw_picture(
            backdrop,
            run,
            frame,
            at,
            task.viewer.camera,
            weather=weather,
            with_vut=False,
            materials=materials(run),
            compute=compute,
        )
        if lidar is None:
            return picture, None
        mesh = build_frame_mesh(
            backdrop.mesh, run, frame, at.position_m, with_vut=False
        )
        return picture, scan_mesh(mesh, run, at, lidar, weather=weather, seed=task.seed)

    if pose is None:
        return draw_from_vut
    return draw_at_roadside


def _contents(
    picture: RenderedPicture,
    cloud: PointCloud | None,
    scene: Scene,
    task: DrawTask,
    run: Run,
    stem: str,
) -> Iterator[tuple[str, Content]]:
    """Contents of the files of a frame, by kind.

    The picture comes last: where it is, all are.
    """
    if cloud is not None:
        yield "cloud", cloud_bytes(cloud)
    if task.wish.masks:
        yield "masks", _png(instance_image(picture))
    if task.wish.depth:
        yield "depth", _png(depth_image(picture))
    if task.wish.vehicles:
        yield (
            "vehicles",
            _with_vehicles(task.path("vehicles", stem), picture, scene, task, run),
        )
    yield "picture", _png(picture.rgb)


def _with_vehicles(
    path: Path, picture: RenderedPicture, scene: Scene, task: DrawTask, run: Run
) -> str:
    """Lines of a label file, and one for each vehicle of which enough is seen."""
    if path.exists():
        lines = read_text(path, "labels").splitlines()
    else:
        lines = []
    lines = [line for line in lines if not line.startswith(f"{_VEHICLE} ")]
    known = {one.id for one in scene.instances if "vehicle" in one.class_name}
    if task.wish.format == FORMATS[0] and run.encounter.vru.class_name == _VEHICLE:
        # Whose line was taken away with the others'.
        known.add("vru")
    camera = task.viewer.camera
    for index in np.unique(picture.instance[picture.instance >= 0]).tolist():
        name = picture.names[index]
        rows, columns = np.nonzero(picture.instance == index)
        if (
            not (name in known or _MOVING.fullmatch(name))
            or len(rows) < _LEAST_VEHICLE_PX
        ):
            continue
        offsets = np.hypot(
            columns + 0.5 - 0.5 * camera.width_px, rows + 0.5 - 0.5 * camera.height_px
        )
        away_m = picture.depth_m[rows, columns] * np.hypot(
            1.0, offsets / camera.focal_length_px
        )
        box = (
            columns.min(),
            rows.min(),
            columns.max() + 1,
            rows.max() + 1,
            away_m.mean(),
        )
        lines.append(f"{_VEHICLE} {' '.join(str(float(number)) for number in box)}")
    return "".join(f"{line}\n" for line in lines)


def _image(pixels: NDArray[Any], **options: Any) -> Content:
    from PIL import Image

    return lambda file: Image.fromarray(pixels).save(file, **options)


def _png(pixels: NDArray[Any]) -> Content:
    # Noise does not shrink: more effort makes files 7 % smaller in three times the
    # time.
    return _image(pixels, format="PNG", compress_level=1)


def draw_all(
    scene: Scene,
    runs: Sequence[Run],
    tasks: Sequence[DrawTask],
    engine: EngineWish,
    progress: StageProgress,
    tell: Callable[[str], None],
) -> int:
    """Draw all tasks, wherever they run.

    Those of workers that die again. Bytes written.
    """
    n_all = sum(len(task.frames) for task in tasks)
    n_drawn = 0
    n_bytes = 0
    progress(DRAW, 0, n_all)
    try:
        with start_engine(engine, n_tasks=len(tasks), tell=tell) as started:
            for task, size in map_tasks(
                draw_task, tasks, engine=started, shared=(scene, runs)
            ):
                n_drawn += len(task.frames)
                n_bytes += size
                progress(DRAW, n_drawn, n_all)
    except WorkerDiedError:
        got = f"a process that was killed, {TRIES} times"
        expected = "enough memory for each: fewer workers"
        raise InputError("--workers", Unquoted(got), expected) from None
    return n_bytes


COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")
CLOUD_SUFFIXES = (".ply", ".bin")
_JPEG_QUALITY = 85
# What 16 bits hold.
_MAX_CM = 65535


def suffixes_of(sensor: Sensor) -> tuple[str, ...]:
    """Endings of files that show what a sensor sees, the usual one first."""
    if isinstance(sensor, LidarModel):
        return CLOUD_SUFFIXES
    return COLOUR_SUFFIXES


def check_path(path: Path, sensor: Sensor) -> None:
    """Refuse a file name that ends in none of :func:`suffixes_of`.

    Or is no regular file's.
    """
    known = suffixes_of(sensor)
    if path.suffix.lower() not in known:
        raise InputError("--out", str(path), "a name that ends in " + ", ".join(known))
    check_target(path)


def save(path: Path, seen: RenderedPicture | PointCloud) -> tuple[Path, ...]:
    """Write a picture or a point cloud, each file whole or not at all.

    Returns their paths.

    A cloud is ".ply", points in the LiDAR's frame with a colour for each thing, or
    ".bin", float32 x, y, z, intensity, as the study releases them. A picture's colours
    are ".png", or ".jpg" for a smaller file; "..-instances.png" has a colour for each
    thing; "..-depth.png" has 16 bits, centimetres, 0 where nothing is hit.
    """
    if isinstance(seen, PointCloud):
        import trimesh

        content = cloud_bytes(seen)
        if path.suffix.lower() != ".bin":
            colours = instance_colours(seen.names)[seen.instance]
            content = trimesh.PointCloud(seen.points_m, colours).export(file_type="ply")
        write_atomically(path, content)
        return (path,)
    form: dict[str, Any] = {"format": "PNG"}
    if path.suffix.lower() != ".png":
        form = {"format": "JPEG", "quality": _JPEG_QUALITY}
    images = {
        path: _image(seen.rgb, **form),
        path.with_name(f"{path.stem}-instances.png"): _image(
            instance_image(seen), format="PNG"
        ),
        path.with_name(f"{path.stem}-depth.png"): _image(
            depth_image(seen), format="PNG"
        ),
    }
    for file, image in images.items():
        write_atomically(file, image)
    return tuple(images)


def cloud_bytes(cloud: PointCloud) -> bytes:
    """A point cloud as the study releases them: float32 x, y, z, intensity."""
    return np.column_stack([cloud.points_m, cloud.intensity]).astype("<f4").tobytes()


def instance_image(picture: RenderedPicture) -> NDArray[np.uint8]:
    """A colour for each thing, (h, w, 3)."""
    return instance_colours(picture.names)[picture.instance]


def depth_image(picture: RenderedPicture) -> NDArray[np.uint16]:
    """Depths in centimetres, 0 where nothing is hit, (h, w)."""
    centimetres = np.where(np.isfinite(picture.depth_m), picture.depth_m * 100.0, 0.0)
    return np.clip(np.rint(centimetres), 0, _MAX_CM).astype(np.uint16)


def instance_colours(names: tuple[str, ...]) -> NDArray[np.uint8]:
    """Colours of things that differ in hue and in lightness.

    Parameters
    ----------
    names : tuple of str
        Of the things.

    Returns
    -------
    colours : (n + 1, 3) uint8
        sRGB; the VRU's is the lightest; the last one, for sky, is black.
    """
    import colorsys

    # multiples of it fill a circle evenly, however many there are
    golden = 0.6180339887498949
    colours = []
    for index, name in enumerate(names):
        if name == "vru":
            colours.append((1.0, 1.0, 0.2))
        elif name == "vut":
            colours.append((1.0, 0.45, 0.45))
        else:
            lightness = 0.2 + 0.45 * (index * golden * golden % 1.0)
            colours.append(colorsys.hls_to_rgb(index * golden % 1.0, lightness, 0.6))
    colours.append((0.0, 0.0, 0.0))
    return np.rint(255.0 * np.array(colours)).astype(np.uint8)


def vru_sentence(seen: RenderedPicture | PointCloud) -> str:
    """A sentence that says if, and where, the VRU is in view."""
    is_vru = seen.instance == seen.names.index("vru")
    if isinstance(seen, PointCloud):
        return f"VRU: {int(is_vru.sum())} of {len(is_vru)} points."
    box = mask_box(is_vru)
    if not box.any():
        return "VRU: not in view."
    x_min, y_min, x_max, y_max = box.astype(int).tolist()
    return (
        f"VRU: in view, visible box x {x_min} to {x_max}, y {y_min} to {y_max} px "
        f"({x_max - x_min} x {y_max - y_min})."
    )
