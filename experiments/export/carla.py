"""Layouts for CARLA: what to spawn, and where."""

import numpy as np

from geometry.arrays import FloatArray
from geometry.frames import to_carla_points, to_carla_yaw
from geometry.lidar import LidarModel
from geometry.notes import assumed_sites
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.terrain import terrain_of
from placement.candidates import CandidatePose
from placement.layout import Layout

from . import ExportFormat
from .calibration import refuse_lenses
from .json import to_json_text
from .places import metric_points


def to_carla(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as a JSON list of sensors to spawn in CARLA.

    Per unit: id, blueprint, its attributes as text (as ``ActorBlueprint.set_attribute``
    takes them) and the transform, and "assumed" where the site is. CARLA's left-handed
    frame, metres, degrees, from the zero of the map that the scene was made from, if it
    is in metres. Raises InputError for lenses that distort: CARLA's own parameters are
    of another kind.
    """
    refuse_lenses(layout, "carla")
    if scene is None:
        doubts = {}
    else:
        doubts = assumed_sites(scene.notes)
    return to_json_text(
        [
            _carla_record(unit, scene)
            | ({"assumed": doubts[unit.site_id]} if unit.site_id in doubts else {})
            for unit in layout.units
        ]
    )


def carla_points(points_m: FloatArray, scene: Scene | None) -> FloatArray:
    """Points (n, 3) of the world frame in CARLA's.

    Its zero is that of the scene's map.
    """
    moved_m = np.array(points_m)
    if scene is not None:
        moved_m[:, :2] = metric_points(moved_m[:, :2], scene)
        if terrain_of(scene) is not None:
            moved_m[:, 2] += scene.zero_height_m or 0.0
    # Adding zero turns -0.0 into 0.0.
    return to_carla_points(moved_m) + 0.0


def camera_attributes(sensor: CameraModel) -> dict[str, str]:
    """Attributes of a camera's blueprint; ``sensor_tick`` aside."""
    numbers = {
        "image_size_x": sensor.width_px,
        "image_size_y": sensor.height_px,
        "fov": sensor.horizontal_fov_deg,
    }
    return {name: str(value) for name, value in numbers.items()}


def _carla_record(unit: CandidatePose, scene: Scene | None) -> dict[str, object]:
    pose = unit.pose
    sensor = unit.sensor
    if isinstance(sensor, LidarModel):
        blueprint = "sensor.lidar.ray_cast"
        half_deg = 0.5 * sensor.vertical_fov_deg
        scan = {
            "channels": sensor.n_lines,
            "range": sensor.range_m,
            "points_per_second": int(sensor.points_per_second),
            "rotation_frequency": sensor.frame_rate_hz,
            "upper_fov": half_deg,
            "lower_fov": -half_deg,
            "horizontal_fov": sensor.horizontal_fov_deg,
        }
        attributes = {name: str(value) for name, value in scan.items()}
    else:
        blueprint = "sensor.camera.rgb"
        attributes = camera_attributes(sensor)
    attributes["sensor_tick"] = str(1.0 / sensor.frame_rate_hz)
    (place_m,) = carla_points(pose.position_m[None], scene).tolist()
    yaw_deg = float(to_carla_yaw(pose.yaw_deg)) + 0.0
    return {
        "id": unit.id,
        "blueprint": blueprint,
        "attributes": attributes,
        "transform": {
            "location": dict(zip("xyz", place_m, strict=True)),
            "rotation": {"pitch": pose.pitch_deg, "yaw": yaw_deg, "roll": 0.0},
        },
    }


FORMAT = ExportFormat(
    write=to_carla,
)
