"""Pictures of a camera that somebody aims: what it sees in a frame of a run."""

import base64
from functools import lru_cache
from typing import Any

import numpy as np

from geometry.errors import InputError
from geometry.scene import Scene
from geometry.sensors import CameraModel, with_width
from geometry.tables import pick
from geometry.weather import pick_weather
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.evaluator.picture_sources import to_jpeg
from placement.imaging import Backdrop, build_backdrop, draw_picture
from placement.setting import Setting
from scenarios.runs import Run

from ..language import mark
from ..parts.camera_views import nearest_frame


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
    """What a camera sees in a frame of a run, for a page on which it is being aimed.

    Without a run, it is one whose road user is near the camera's aim. While it is
    turned, edges need not be smooth. "image" is a JPEG in base64, "box" where the road
    user is seen: left, top, right, bottom as shares of the sides, or None. Raises
    InputError: it is no camera, there is no such run or frame.
    """
    if not isinstance(unit.sensor, CameraModel):
        expected = mark("a camera: a LiDAR takes no picture")
        raise InputError(mark("unit"), unit.id, expected)
    if run_id:
        # Loads the compiler.
        from placement.evaluator.pictures import find_frame

        run = pick({run.id: run for run in setting.runs}, run_id, "run")
        frame = find_frame(run, frame)
    else:
        run, frame = nearest_frame(unit, setting)
    picture = draw_picture(
        _backdrop(setting.scene, run),
        run,
        frame,
        unit.pose,
        with_width(unit.sensor, width_px),
        weather=pick_weather(run.weather, "weather"),
        is_smooth=is_smooth,
        compute=compute,
    )
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


# While a camera is aimed the run stays the same.
@lru_cache(maxsize=2)
def _backdrop(scene: Scene, run: Run) -> Backdrop:
    return build_backdrop(scene, run.obstruction)
