"""What each camera will see.

A picture, rendered as a road user comes to the middle of it.
"""

import base64
import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.scene import Scene
from geometry.sensors import CameraModel, with_width
from placement.candidates import CandidatePose, above_ground
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.evaluator.picture_sources import (
    PictureSource,
    build_picture_source,
    to_jpeg,
)
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..figures.axes import unit_labels
from ..language import tr
from ..results.cached import cached_part
from .accidents import case_title
from .section import Picture, Pictures

_WIDTH_IN = 3.2
_WIDTH_PX = 512
# Of more, none is drawn: a first screen has no room for them.
_MOST_CAMERAS = 4


def camera_views(
    setting: Setting, layout: Layout, *, cache_folder: Path | None = None
) -> Pictures:
    """A picture of each camera of a layout, if they are few."""
    cameras = [unit for unit in layout.units if isinstance(unit.sensor, CameraModel)]
    if len(cameras) > _MOST_CAMERAS:
        return ()
    labels = unit_labels(layout)
    return cached_part(
        cache_folder,
        "cameras",
        lambda: tuple(_view(unit, labels[unit.id], setting) for unit in cameras),
        kind=Pictures,
        made_from=(setting.scene, setting.runs, cameras, labels),
    )


def _view(unit: CandidatePose, label: str, setting: Setting) -> Picture:
    assert isinstance(unit.sensor, CameraModel)
    small = with_width(unit.sensor, _WIDTH_PX)
    rgb, run, time_s = draw_view(replace(unit, sensor=small), setting)
    title = tr("{unit}: expected view", unit=label)
    values = {"what": case_title(run.case), "time": abs(time_s), "unit": label}
    return Picture(
        title=title,
        caption=tr(
            "Rendered from the map. {what}, {time:.1f} s before the collision.",
            **values,
        ),
        alt=tr(
            "Rendered picture of camera {unit} at {site}: {what}, {time:.1f} "
            "s before the collision.",
            site=unit.site_id or tr("its mount"),
            **values,
        ),
        image=base64.b64encode(to_jpeg(rgb)).decode(),
        format="jpeg",
        width_px=_WIDTH_PX,
        height_px=small.height_px,
        width_in=_WIDTH_IN,
    )


def draw_view(
    unit: CandidatePose, setting: Setting, *, compute: Compute = DEFAULT_COMPUTE
) -> tuple[NDArray[np.uint8], Run, float]:
    """Image (h, w, 3) of a camera, the run that it shows, and its time.

    In seconds; the impact is at 0.

    The road user is nearest to where the middle of the image meets the road.
    """
    assert isinstance(unit.sensor, CameraModel)
    run, frame = nearest_frame(unit, setting)
    source = _pictures_of(
        setting.scene, run, seed=compute.seed, workers=compute.workers
    )
    rgb = source.pictures((unit.pose, unit.sensor))(frame)
    return rgb, run, float(run.time_s[frame])


# Several cameras often show the same run.
@lru_cache(maxsize=2)
def _pictures_of(scene: Scene, run: Run, *, seed: int, workers: int) -> PictureSource:
    return build_picture_source(scene, [run], seed=seed, workers=workers)


def nearest_frame(unit: CandidatePose, setting: Setting) -> tuple[Run, int]:
    """Run and frame in which a road user is nearest to a camera's aim."""
    yaw = math.radians(unit.pose.yaw_deg)
    tilt = math.radians(max(-unit.pose.pitch_deg, 10.0))
    reach_m = above_ground(unit, setting.scene).pose.position_m[2] / math.tan(tilt)
    aim_m = unit.pose.position_m[:2] + reach_m * np.array(
        [math.cos(yaw), math.sin(yaw)]
    )
    away_m = [np.hypot(*(run.vru_position_m - aim_m).T) for run in setting.runs]
    nearest = int(np.argmin([distance_m.min() for distance_m in away_m]))
    return setting.runs[nearest], int(np.argmin(away_m[nearest]))
