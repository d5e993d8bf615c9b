"""Runs as a script that drives them in CARLA and records what a layout's cameras see."""

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import refuse
from geometry.files import Table, load_data, pick
from geometry.frames import to_carla_yaw
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.terrain import on_ground
from placement.detectors import load_detector
from placement.layout import Layout
from placement.recordings.files import load_format
from scenarios.paths import MPS_PER_KMH
from scenarios.runs import Run

from . import ExportFormat
from .calibration import calibrations, refuse_lenses
from .carla import camera_attributes, carla_points

_TABLE = "carla.toml"
_PLACE = "SCENARIO: dict[str, Any] = {}"
_DECIMALS = 6


def to_carla_run(layout: Layout, scene: Scene, run: Run) -> str:
    """Run as a Python script for CARLA: :mod:`.carla_player`, with the run in it.

    It writes a recording (:func:`placement.recordings.read_recording`): cameras of the layout in
    its order, then the VUT's. LiDARs are left out; weather, gait and traffic are not in it. Raises
    InputError if recordings cannot hold it - pictures of another size, somebody who is neither on
    foot nor on a bicycle - or ``data/carla.toml`` has no blueprint of a body.
    """
    source = (files(__package__) / "carla_player.py").read_text(encoding="utf-8")
    scenario = json.dumps(build_scenario(layout, scene, run))
    return source.replace(
        _PLACE, f"SCENARIO: dict[str, Any] = __import__('json').loads({scenario!r})"
    )


def build_scenario(layout: Layout, scene: Scene, run: Run) -> dict[str, Any]:
    """What the script drives; places are x, y, z [m], pitch and yaw [degrees] in CARLA's frame."""
    from placement.evaluator.pictures import vut_camera_pose
    from placement.evaluator.surroundings import load_vut_camera

    form, labels = load_format(), _table("labels")
    if run.road_user not in labels:
        expected = "a run with somebody on foot or on a bicycle, as recordings have"
        refuse("carla-run", f"a road user by {run.road_user}", expected)
    calibrations(layout, "carla-run")  # refuses a layout without cameras
    refuse_lenses(layout, "carla-run")
    cameras: list[dict[str, Any]] = []
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel):
            size_px = unit.sensor.width_px, unit.sensor.height_px
            if size_px != (form.width_px, form.height_px):
                expected = f"{form.width_px} x {form.height_px} px, as recordings have"
                got = f"{size_px[0]} x {size_px[1]} px"
                refuse(f"carla-run: {unit.id}", got, expected)
            cameras.append(_camera(str(len(cameras)), unit.sensor, [unit.pose], scene))
    mount = load_vut_camera()
    poses = [vut_camera_pose(mount, run, frame) for frame in range(len(run.time_s))]
    cameras.append(_camera(form.vut_folder, mount.camera, poses, scene))
    met = run.encounter
    bodies: list[tuple[Actor, FloatArray, ArrayLike]] = [
        (met.vut, run.vut_position_m, run.vut_yaw_deg),
        (met.vru, run.vru_position_m, run.vru_yaw_deg),
        *((one.actor, one.pose.position_m[None, :2], one.pose.yaw_deg) for one in run.obstruction),
    ]
    detector = load_detector()
    return {
        "run": run.id,
        "n_frames": len(run.time_s),
        "frame_rate_hz": form.frame_rate_hz,
        "size_px": [form.width_px, form.height_px],
        "vut_speed_mps": run.vut_speed_kmh * MPS_PER_KMH,
        "vru_speed_mps": run.case.vru_speed_kmh * MPS_PER_KMH,
        "met": labels[run.road_user],
        "rule": {name: getattr(detector, name) for name in ("min_iou", "min_box_height_px")},
        "bodies": [
            {
                "blueprint": pick(_table("blueprints"), actor.name, f"{_TABLE}: blueprints"),
                "places": _places(on_ground(position_m, run.terrain), yaw_deg, 0.0, scene),
            }
            for actor, position_m, yaw_deg in bodies
        ],
        "cameras": cameras,
    }


@cache
def _table(name: str) -> Table:
    table: Table = load_data("experiments", _TABLE)[name]
    return table


def _camera(
    folder: str, camera: CameraModel, poses: Sequence[Pose], scene: Scene
) -> dict[str, Any]:
    position_m = np.array([pose.position_m for pose in poses])
    yaw_deg, pitch_deg = np.array([(pose.yaw_deg, pose.pitch_deg) for pose in poses]).T
    places = _places(position_m, yaw_deg, pitch_deg, scene)
    return {"folder": folder, "attributes": camera_attributes(camera), "places": places}


def _places(
    points_m: FloatArray, yaw_deg: ArrayLike, pitch_deg: ArrayLike, scene: Scene
) -> list[list[float]]:
    turns = np.broadcast_arrays(points_m[:, 0], pitch_deg, to_carla_yaw(yaw_deg))[1:]
    table = np.column_stack([carla_points(points_m, scene), *turns])
    rows: list[list[float]] = (table.round(_DECIMALS) + 0.0).tolist()
    return rows


FORMAT = ExportFormat(
    write=to_carla_run,
    content="script that drives a run and records it; CARLA's Python API",
    drives_run=True,
    has_lidars=False,
)
