"""Layouts for CARLA: what to spawn, and where."""

from geometry.catalogue import Sensor
from geometry.frames import to_carla_points, to_carla_yaw
from geometry.lidar import LidarModel
from geometry.notes import assumed_sites
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.layout import Layout

from .formats import ExportFormat
from .json import to_json_text


def to_carla(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as a JSON list of sensors to spawn in CARLA.

    Per unit: id, blueprint, its attributes as text (as ``ActorBlueprint.set_attribute`` takes them)
    and the transform, and "assumed" where the site is. CARLA's left-handed frame, metres, degrees.
    """
    doubts = {} if scene is None else assumed_sites(scene.notes)
    return to_json_text(
        [
            _carla_record(unit)
            | ({"assumed": doubts[unit.site_id]} if unit.site_id in doubts else {})
            for unit in layout.units
        ]
    )


def _carla_blueprint(sensor: Sensor) -> dict[str, object]:
    tick = {"sensor_tick": str(1.0 / sensor.frame_rate_hz)}
    if isinstance(sensor, LidarModel):
        half_deg = 0.5 * sensor.vertical_fov_deg
        return {
            "blueprint": "sensor.lidar.ray_cast",
            "attributes": {
                "channels": str(sensor.n_lines),
                "range": str(sensor.range_m),
                "points_per_second": str(int(sensor.points_per_second)),
                "rotation_frequency": str(sensor.frame_rate_hz),
                "upper_fov": str(half_deg),
                "lower_fov": str(-half_deg),
                "horizontal_fov": str(sensor.horizontal_fov_deg),
                **tick,
            },
        }
    return {
        "blueprint": "sensor.camera.rgb",
        "attributes": {
            "image_size_x": str(sensor.width_px),
            "image_size_y": str(sensor.height_px),
            "fov": str(sensor.horizontal_fov_deg),
            **tick,
        },
    }


def _carla_record(unit: CandidatePose) -> dict[str, object]:
    pose = unit.pose
    # Adding zero turns -0.0 into 0.0.
    x_m, y_m, z_m = (to_carla_points(pose.position_m) + 0.0).tolist()
    return {
        "id": unit.id,
        **_carla_blueprint(unit.sensor),
        "transform": {
            "location": {"x": x_m, "y": y_m, "z": z_m},
            "rotation": {
                "pitch": pose.pitch_deg,
                "yaw": float(to_carla_yaw(pose.yaw_deg)) + 0.0,
                "roll": 0.0,
            },
        },
    }


FORMAT = ExportFormat(
    write=to_carla,
    content="spawn transforms in CARLA's frame; its Python API",
)
