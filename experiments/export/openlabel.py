"""Layouts as ASAM OpenLABEL: coordinate systems and streams, for annotations to refer to."""

from dataclasses import asdict

import numpy as np

from geometry.errors import refuse
from geometry.lenses import BrownConrady
from geometry.sensors import CameraModel, to_calibrated
from placement.candidates import CandidatePose
from placement.layout import Layout

from . import ExportFormat
from .calibration import lens_coefficients, plain, sensor_quaternion
from .json import to_json_text

SCHEMA_VERSION = "1.0.0"


def to_openlabel(layout: Layout) -> str:
    """Layout as an OpenLABEL document without annotations.

    A coordinate system for the world (x east, y north, z up, metres) and one per unit, with its
    pose as quaternion (x, y, z, w) and translation from the unit to the world; and a stream per
    unit of the same name. A camera's frame is x right, y down, z ahead, its stream has
    intrinsics_pinhole (the middle of the first pixel is (0, 0)); a LiDAR's frame is x ahead, y
    left, z up, its stream has the scan pattern in intrinsics_custom. Its uri is empty: nothing has
    been recorded.

    References
    ----------
    .. [1] ASAM OpenLABEL 1.0.0, coordinate systems and streams, and its JSON schema:
       pose_wrt_parent takes points of the child to the parent.
    """
    ids = [unit.id for unit in layout.units]
    world = "world"
    while world in ids:  # a unit may be called so, too
        world += "_cs"
    systems: dict[str, object] = {world: {"type": "scene_cs", "parent": "", "children": ids}}
    for unit in layout.units:
        pose = {
            "quaternion": sensor_quaternion(unit.pose, unit.sensor),
            "translation": plain(unit.pose.position_m),
        }
        systems[unit.id] = {
            **{"type": "sensor_cs", "parent": world, "children": []},
            "pose_wrt_parent": pose,
        }
    return to_json_text(
        {
            "openlabel": {
                "metadata": {"schema_version": SCHEMA_VERSION, "name": layout.name},
                "coordinate_systems": systems,
                "streams": {unit.id: _stream(unit) for unit in layout.units},
            }
        }
    )


def _stream(unit: CandidatePose) -> dict[str, object]:
    sensor = unit.sensor
    kind = "lidar"
    properties: dict[str, object] = {"intrinsics_custom": asdict(sensor)}
    if isinstance(sensor, CameraModel):
        kind, calibrated = "camera", to_calibrated(sensor, unit.pose)
        projection = plain(np.column_stack([calibrated.K, np.zeros(3)]))
        if not isinstance(calibrated.lens, BrownConrady):
            got = f"{unit.id}, whose lens is of another kind"
            refuse("openlabel", got, "pinholes, or lenses of Brown and Conrady")
        distortion = plain(lens_coefficients(unit.id, calibrated)[1])
        properties = {
            "intrinsics_pinhole": {
                "width_px": sensor.width_px,
                "height_px": sensor.height_px,
                "camera_matrix": projection,
                "distortion_coeffs": distortion,
                # What the standard's examples and vcd call the same; its schema allows both.
                "camera_matrix_3x4": projection,
                "distortion_coeffs_1xN": distortion,
            }
        }
    return {
        **{"type": kind, "description": sensor.name, "uri": ""},
        "stream_properties": properties,
    }


FORMAT = ExportFormat(
    write=lambda layout, _scene: to_openlabel(layout),
    content="coordinate systems and streams, ASAM OpenLABEL 1.0; vcd",
)
