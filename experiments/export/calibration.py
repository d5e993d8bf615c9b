"""Cameras of a layout as the field of computer vision writes them down.

K, R, t.
"""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import FloatArray
from geometry.calibrations import CalibratedCamera, to_calibrated
from geometry.catalogue import Sensor
from geometry.errors import refuse
from geometry.lenses import BrownConrady, Fisheye
from geometry.notes import assumed_sites
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.sensors import CameraModel
from placement.layout import Layout


def lens_coefficients(name: str, camera: CalibratedCamera) -> tuple[bool, FloatArray]:
    """True for a fisheye, and the coefficients (1, n) in OpenCV's order.

    Raises InputError for Tsai's, which neither of OpenCV's models is.
    """
    lens = camera.lens
    if isinstance(lens, BrownConrady):
        return False, np.array([[lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]])
    if isinstance(lens, Fisheye):
        return True, np.array([[lens.k1, lens.k2, lens.k3, lens.k4]])
    expected = (
        "Brown-Conrady's or a fisheye: the other way round is not of the same form"
    )
    refuse(f"{name}: lens", "Tsai's radial term", expected)


def calibrations(layout: Layout, format_name: str) -> dict[str, CalibratedCamera]:
    """Calibrations of a layout's cameras by id; its LiDARs are left out.

    If there is no camera, raises InputError that names the format.

    References
    ----------
    .. [1] OpenCV, "Camera Calibration and 3D Reconstruction": s p = K (R x + t).
    """
    found = {
        unit.id: to_calibrated(unit.sensor, unit.pose)
        for unit in layout.units
        if isinstance(unit.sensor, CameraModel)
    }
    if not found:
        refuse(format_name, "a layout of LiDARs only", "at least one camera")
    return found


def lidar_ids(layout: Layout) -> list[str]:
    """Units that are no cameras."""
    return [
        unit.id for unit in layout.units if not isinstance(unit.sensor, CameraModel)
    ]


def comments(layout: Layout, scene: Scene | None) -> str:
    """Comment lines of YAML.

    Units that are no cameras, and those at sites that are assumed.
    """
    named = ", ".join(lidar_ids(layout))
    if scene is None:
        doubts = {}
    else:
        doubts = assumed_sites(scene.notes)
    if named:
        left_out = f"# Left out, for they are no cameras: {named}\n"
    else:
        left_out = ""
    assumed = (unit for unit in layout.units if unit.site_id in doubts)
    return left_out + "".join(
        f"# {unit.id}: assumed: {doubts[unit.site_id]}\n" for unit in assumed
    )


def refuse_lenses(layout: Layout, format_name: str) -> None:
    """Raise InputError if a camera of a layout is no pinhole.

    The format has no other.
    """
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel) and not unit.sensor.is_pinhole:
            got = f"{unit.id}, whose lens, principal point or roll it cannot carry"
            refuse(format_name, got, "ideal pinholes; opencv and ros have lenses")


def sensor_quaternion(pose: Pose, sensor: Sensor) -> list[float]:
    """Rotation from a sensor's own frame to the world: x, y, z, w.

    A camera's is x right, y down, z ahead; a LiDAR's x ahead, y left, z up.
    """
    if isinstance(sensor, CameraModel):
        return quaternion(to_calibrated(sensor, pose).R_camera_world.T)
    return quaternion(body_rotation(pose.yaw_deg, pose.pitch_deg))


def plain(values: FloatArray) -> list[float]:
    """Row by row, without minus zeros."""
    numbers: Sequence[float] = (np.asarray(values) + 0.0).ravel().tolist()
    return list(numbers)


def quaternion(rotation: FloatArray) -> list[float]:
    """A rotation (3, 3) as x, y, z, w with w >= 0."""
    # q and -q are the same rotation; w >= 0 makes it one.
    from scipy.spatial.transform import Rotation

    return plain(Rotation.from_matrix(rotation).as_quat(canonical=True))
