"""Layouts for CARLA: what to spawn, and where."""

from geometry.frames import to_carla_points, to_carla_yaw
from geometry.lidar import LidarModel
from geometry.notes import assumed_sites
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.layout import Layout

from .calibration import refuse_lenses
from .formats import ExportFormat
from .json import to_json_text


def to_carla(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as a JSON list of sensors to spawn in CARLA.

    Per unit: id, blueprint, its attributes as text (as ``ActorBlueprint.set_attribute`` takes them)
    and the transform, and "assumed" where the site is. CARLA's left-handed frame, metres, degrees.
    Raises InputError for lenses that distort: CARLA's own parameters are of another kind.
    """
    refuse_lenses(layout, "carla")
    doubts = {} if scene is None else assumed_sites(scene.notes)
    return to_json_text(
        [
            _carla_record(unit)
            | ({"assumed": doubts[unit.site_id]} if unit.site_id in doubts else {})
            for unit in layout.units
        ]
    )


def _carla_record(unit: CandidatePose) -> dict[str, object]:
    pose, sensor = unit.pose, unit.sensor
    if isinstance(sensor, LidarModel):
        blueprint, half_deg = "sensor.lidar.ray_cast", 0.5 * sensor.vertical_fov_deg
        attributes = {
            "channels": sensor.n_lines,
            "range": sensor.range_m,
            "points_per_second": int(sensor.points_per_second),
            "rotation_frequency": sensor.frame_rate_hz,
            "upper_fov": half_deg,
            "lower_fov": -half_deg,
            "horizontal_fov": sensor.horizontal_fov_deg,
        }
    else:
        blueprint = "sensor.camera.rgb"
        attributes = {
            "image_size_x": sensor.width_px,
            "image_size_y": sensor.height_px,
            "fov": sensor.horizontal_fov_deg,
        }
    attributes["sensor_tick"] = 1.0 / sensor.frame_rate_hz
    # Adding zero turns -0.0 into 0.0.
    place_m = (to_carla_points(pose.position_m) + 0.0).tolist()
    yaw_deg = float(to_carla_yaw(pose.yaw_deg)) + 0.0
    return {
        "id": unit.id,
        "blueprint": blueprint,
        "attributes": {name: str(value) for name, value in attributes.items()},
        "transform": {
            "location": dict(zip("xyz", place_m, strict=True)),
            "rotation": {"pitch": pose.pitch_deg, "yaw": yaw_deg, "roll": 0.0},
        },
    }


FORMAT = ExportFormat(write=to_carla, content="spawn transforms in CARLA's frame; its Python API")
