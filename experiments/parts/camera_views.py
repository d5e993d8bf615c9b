"""What each camera will see.

A picture, rendered as a road user comes to the middle of it.
"""

import base64
import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geometry.errors import InputError
from geometry.scene import Scene
from geometry.sensors import CameraModel, with_width
from geometry.tables import pick
from geometry.weather import pick_weather
from placement.candidates import CandidatePose, above_ground
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.imaging import Backdrop, build_backdrop, draw_picture, to_jpeg
from placement.imaging import Picture as FramePicture
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..figures.axes import unit_labels
from ..language import tr
from .accidents import case_title
from .section import Picture

_WIDTH_IN = 3.2
_WIDTH_PX = 512
# Of more, none is drawn: a first screen has no room for them.
_MOST_CAMERAS = 4


def camera_views(setting: Setting, layout: Layout) -> list[Picture]:
    """A picture of each camera of a layout, if they are few."""
    cameras = [unit for unit in layout.units if isinstance(unit.sensor, CameraModel)]
    if len(cameras) > _MOST_CAMERAS:
        return []
    labels = unit_labels(layout)
    return [_view(unit, labels[unit.id], setting) for unit in cameras]


def _view(unit: CandidatePose, label: str, setting: Setting) -> Picture:
    assert isinstance(unit.sensor, CameraModel)
    small = with_width(unit.sensor, _WIDTH_PX)
    rgb, run, time_s = draw_view(replace(unit, sensor=small), setting)
    title = tr("{unit}: what it will see", unit=label)
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
    run, frame = _nearest_frame(unit, setting)
    return _draw(unit, setting, run, frame, compute).rgb, run, float(run.time_s[frame])


def _draw(
    unit: CandidatePose,
    setting: Setting,
    run: Run,
    frame: int,
    compute: Compute,
    *,
    is_smooth: bool = True,
) -> FramePicture:
    assert isinstance(unit.sensor, CameraModel)
    return draw_picture(
        _backdrop(setting.scene, run),
        run,
        frame,
        unit.pose,
        unit.sensor,
        weather=pick_weather(run.weather, "weather"),
        is_smooth=is_smooth,
        compute=compute,
    )


# While a camera is aimed the run stays the same.
@lru_cache(maxsize=2)
def _backdrop(scene: Scene, run: Run) -> Backdrop:
    return build_backdrop(scene, run.obstruction)


def _nearest_frame(unit: CandidatePose, setting: Setting) -> tuple[Run, int]:
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


def live_picture(
    unit: CandidatePose,
    setting: Setting,
    *,
    run_id: str,
    frame: int,
    width_px: int,
    is_smooth: bool,
    compute: Compute,
) -> dict[str, Any]:
    """What a camera sees in a frame of a run, for the planner's page.

    Without a run, it is one whose road user is near the camera's aim. While it is
    turned, edges need not be smooth. "image" is a JPEG in base64, "box" where the road
    user is seen: left, top, right, bottom as shares of the sides, or None. Raises
    InputError: it is no camera, there is no such run or frame.
    """
    if not isinstance(unit.sensor, CameraModel):
        raise InputError("unit", unit.id, "a camera: a LiDAR takes no picture")
    if run_id:
        # Loads the compiler.
        from placement.evaluator.pictures import find_frame

        run = pick({run.id: run for run in setting.runs}, run_id, "run")
        frame = find_frame(run, frame)
    else:
        run, frame = _nearest_frame(unit, setting)
    small = replace(unit, sensor=with_width(unit.sensor, width_px))
    picture = _draw(small, setting, run, frame, compute, is_smooth=is_smooth)
    height_px, width_px, _ = picture.rgb.shape
    rows, columns = np.nonzero(picture.instance == picture.names.index("vru"))
    box = None
    if len(rows):
        low = columns.min() / width_px, rows.min() / height_px
        high = (columns.max() + 1) / width_px, (rows.max() + 1) / height_px
        box = [float(edge) for edge in (*low, *high)]
    return {
        **{"run": run.id, "frame": frame, "timeS": float(run.time_s[frame])},
        "image": base64.b64encode(to_jpeg(picture.rgb)).decode(),
        "size": [width_px, height_px],
        "box": box,
    }
