"""Labelled crops of pictures, to train and test a detector.

They are drawn at the junctions of many maps.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray, IntArray
from geometry.errors import refuse
from geometry.image_boxes import mask_box
from geometry.maps.importing import ImportOptions, import_scene
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.scene_sources import load_scene
from geometry.sensors import CameraModel, project_points
from geometry.weather import Weather, pick_weather
from placement.detectors.evidence import VRU_CLASSES, vru_class
from placement.evaluator import load_vut_camera
from placement.evaluator.pictures import vut_camera_pose
from placement.imaging import Backdrop, build_backdrop
from placement.imaging.materials import load_materials, vary_materials
from placement.imaging.mesh import FrameMesh, build_moving_meshes, place_mesh
from placement.imaging.picture import RenderedPicture, Window
from placement.imaging.stills import draw_crop, silhouette
from placement.question import Question
from placement.setting import Setting, build_setting
from scenarios.runs import Run

CROP_PX = 160
"""Side of a crop."""

_CASES = "all"
WEATHERS = ("day", "night", "rain")
"""By number."""

_WEATHER_SHARES = (0.5, 0.25, 0.25)
_FOV_DEG = (18.0, 110.0)
# Above the ground of a site.
_MOUNT_M = (3.5, 8.0)
# Of crops in which it is hidden.
_HIDDEN_KEPT = 0.3
# Crops by a camera before another one looks.
_PER_POSE = 6
_SIZE_PX = (1920, 1080)
_TRIES = 30
TRAINED = ("pedestrian", "child", "cyclist")
"""Those of ``VRU_CLASSES`` that the network is trained to find."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing:
    """Contents of crops: those to train with, by default."""

    # Of road users, even on a logarithmic scale.
    height_px: tuple[float, float] = (
        11.0,
        125.0,
    )
    # Width, height.
    crop_px: tuple[int, int] = (CROP_PX, CROP_PX)
    # Crops that are not around the road user; in others it may be hidden.
    empty_share: float = 0.12
    # Crops from the VUT's camera.
    vut_share: float = 0.2
    kinds: tuple[str, ...] = TRAINED
    weathers: tuple[str, ...] = WEATHERS
    # Share of crops with other clothes, paints and facades.
    varied: float = 0.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledCrops:
    """Crops with at most one road user each, arrays with a row for each."""

    # (n, CROP_PX, CROP_PX, 3).
    rgb: NDArray[np.uint8]
    # (n, 4): of the visible part, inside the crop; zeros where there is none
    box_px: FloatArray
    # (n,): of the whole road user, hidden parts too; 0 where there is none
    height_px: FloatArray
    visible_share: (
        # (n,): of the pixels that the whole road user covers in the crop.
        FloatArray
    )
    # (n,), into ``VRU_CLASSES``; -1 where there is none.
    vru_class: IntArray
    # (n,), 0 day, 1 night, 2 rain.
    weather: IntArray

    def __len__(self) -> int:
        return len(self.rgb)


def draw_crops(scene: Scene, n_crops: int, *, seed: int) -> LabelledCrops:
    """Draw crops at a junction.

    Half of them with varied colours, a fourth of them empty.
    """
    setting = build_setting(Question(cases=_CASES), scene)
    looks = look_around(setting, Framing(), np.random.default_rng(seed))
    found = list(islice(looks, n_crops))
    return LabelledCrops(
        **{name: np.stack([row[name] for row in found]) for name in found[0]}
    )


def load_junction(name: str) -> Scene:
    """A junction out of a map's file, or the study's, "town05"."""
    if name == "town05":
        return load_scene()
    return import_scene([Path(name)], ImportOptions()).scene


def join_crops(parts: Sequence[LabelledCrops]) -> LabelledCrops:
    """Crops of several drawings in one."""
    of = {
        name: [getattr(part, name) for part in parts]
        for name in LabelledCrops.__slots__
    }
    return LabelledCrops(
        **{name: np.concatenate(values) for name, values in of.items()}
    )


def save_crops(path: Path, crops: LabelledCrops) -> None:
    """Write crops as ``.npz``."""
    np.savez(path, **{name: getattr(crops, name) for name in LabelledCrops.__slots__})


def load_crops(path: Path) -> LabelledCrops:
    """Read crops written by :func:`save_crops`."""
    with np.load(path) as stored:
        return LabelledCrops(**{name: stored[name] for name in LabelledCrops.__slots__})


Backdrops = dict[tuple[object, ...], tuple[Backdrop, FrameMesh]]
"""Standing things, by junction and obstruction."""


def look_around(
    setting: Setting,
    framing: Framing,
    rng: np.random.Generator,
    *,
    backdrops: Backdrops | None = None,
) -> Iterator[dict[str, Any]]:
    """Rows of :class:`LabelledCrops` by one camera after another, without end.

    `backdrops` may be shared with others: what is missing is added. Raises InputError:
    the junction carries no case, or none with such road users.
    """
    runs = [
        run for run in setting.runs if vru_class(run.encounter.vru) in framing.kinds
    ]
    if not runs:
        refuse(setting.scene.name, "no such runs", " or ".join(framing.kinds))
    if backdrops is None:
        known = {}
    else:
        known = backdrops
    while True:
        run = runs[int(rng.integers(len(runs)))]
        key = (setting.scene.name, *(parked.key for parked in run.obstruction))
        if key not in known:
            backdrop = build_backdrop(setting.scene, run.obstruction)
            known[key] = backdrop, place_mesh(backdrop.mesh, np.zeros(3))
        yield from _look(setting.scene, *known[key], run, framing, rng)


def _look(
    scene: Scene,
    backdrop: Backdrop,
    still: FrameMesh,
    run: Run,
    framing: Framing,
    rng: np.random.Generator,
) -> Iterator[dict[str, Any]]:
    """Some crops by one camera that looks at a run."""
    names = framing.weathers
    shares = np.array([_WEATHER_SHARES[WEATHERS.index(name)] for name in names])
    name = names[int(rng.choice(len(names), p=shares / shares.sum()))]
    weather = _varied_weather(pick_weather(name, "weather"), rng)
    is_varied = rng.random() < framing.varied
    if is_varied:
        materials = vary_materials(load_materials(), rng)
    else:
        materials = None
    on_vut = rng.random() < framing.vut_share
    frames = rng.permutation(len(run.time_s))[: 1 if on_vut else _PER_POSE].tolist()
    site = scene.sites[int(rng.integers(len(scene.sites)))]
    mount_m = site.position_m + [0.0, 0.0, rng.uniform(*_MOUNT_M)]
    for frame in frames:
        body_m = build_moving_meshes(run, frame, with_vut=False)[-1].vertices_m
        at_m = mount_m
        if on_vut:
            at_m = vut_camera_pose(load_vut_camera(), run, frame).position_m
        view = _aim(body_m, at_m, framing.height_px, rng)
        if view is None:
            continue
        pose, camera = view
        points = project_points(body_m, pose, camera)
        box_px = np.concatenate([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])
        if not np.isfinite(points).all():
            box_px = np.zeros(4)
        is_empty = rng.random() < framing.empty_share
        window = _pick_window(box_px, framing.crop_px, is_empty=is_empty, rng=rng)
        if window is None:
            continue
        picture = draw_crop(
            backdrop,
            still,
            run,
            frame,
            pose,
            camera,
            window,
            weather=weather,
            with_vut=not on_vut,
            materials=materials,
            seed=int(rng.integers(2**31)),
        )
        whole = silhouette(run, frame, pose, camera, window)
        row = _label(picture, run, int(whole.sum()), float(box_px[3] - box_px[1]))
        if row["vru_class"] < 0 and not is_empty and rng.random() > _HIDDEN_KEPT:
            continue
        row["weather"] = WEATHERS.index(name)
        yield row


def _varied_weather(weather: Weather, rng: np.random.Generator) -> Weather:
    light = rng.uniform(0.5, 1.4)
    return replace(
        weather,
        sun_yaw_deg=float(rng.uniform(-180.0, 180.0)),
        sun_elevation_deg=(
            float(rng.uniform(15.0, 65.0))
            if weather.sun_lux > 0.0
            else weather.sun_elevation_deg
        ),
        sun_lux=weather.sun_lux * light,
        sky_lux=weather.sky_lux * light,
    )


def _aim(
    body_m: FloatArray,
    at_m: FloatArray,
    height_px: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Pose, CameraModel] | None:
    """A camera that shows a road user at a height drawn at random.

    Anywhere in its image.
    """
    middle = body_m.mean(axis=0)
    away = middle - at_m
    distance = float(np.linalg.norm(away))
    if not 3.0 < distance < 90.0:
        return None
    height_m = float(np.ptp(body_m[:, 2]))
    wanted_px = math.exp(rng.uniform(*np.log(height_px)))
    tilt = math.atan2(-away[2], math.hypot(away[0], away[1]))
    focal = wanted_px * distance / max(height_m * math.cos(tilt), 0.3)
    fov_deg = 2.0 * math.degrees(math.atan(0.5 * _SIZE_PX[0] / focal))
    if not _FOV_DEG[0] <= fov_deg <= _FOV_DEG[1]:
        return None
    camera = CameraModel(
        name="training",
        width_px=_SIZE_PX[0],
        height_px=_SIZE_PX[1],
        horizontal_fov_deg=fov_deg,
        frame_rate_hz=10.0,
        near_m=0.3,
        price_eur=0.0,
    )
    yaw = math.degrees(math.atan2(away[1], away[0]))
    pitch = -math.degrees(tilt)
    pose = Pose(
        position_m=at_m,
        yaw_deg=yaw + rng.uniform(-0.4, 0.4) * fov_deg,
        pitch_deg=float(
            np.clip(pitch + rng.uniform(-0.3, 0.3) * camera.vertical_fov_deg, -60, 10)
        ),
    )
    return pose, camera


def _pick_window(
    box_px: FloatArray,
    crop_px: tuple[int, int],
    *,
    is_empty: bool,
    rng: np.random.Generator,
) -> Window | None:
    """A crop with the road user's middle in it, or without one."""
    size = np.array(crop_px)
    for _ in range(_TRIES):
        if is_empty:
            corner = np.array(
                [rng.integers(side) for side in np.array(_SIZE_PX) - size]
            )
            if (box_px[2:] < corner).any() or (box_px[:2] > corner + size).any():
                return Window(int(corner[0]), int(corner[1]), *crop_px)
            continue
        middle = 0.5 * (box_px[:2] + box_px[2:])
        corner = np.rint(middle - rng.uniform(0.15, 0.85, 2) * size).astype(int)
        corner = np.clip(corner, 0, np.array(_SIZE_PX) - size)
        if (corner < middle).all() and (middle < corner + size).all():
            return Window(int(corner[0]), int(corner[1]), *crop_px)
    return None


def _label(
    picture: RenderedPicture, run: Run, n_whole: int, height_px: float
) -> dict[str, Any]:
    """Labels of a crop in which a whole road user has `n_whole` pixels."""
    is_vru = picture.instance == len(picture.names) - 1
    n_seen = int(is_vru.sum())
    is_seen = n_seen > 0
    if is_seen:
        kind = VRU_CLASSES.index(vru_class(run.encounter.vru))
    else:
        kind = -1
    return {
        "rgb": picture.rgb,
        "box_px": mask_box(is_vru),
        "height_px": height_px if is_seen else 0.0,
        "visible_share": n_seen / n_whole if n_whole else 0.0,
        "vru_class": kind,
    }
