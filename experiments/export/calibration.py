"""Cameras of a layout as the field of computer vision writes them down: K, R, t."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.errors import InputError, Unquoted
from geometry.lenses import BrownConrady, CalibratedCamera, Fisheye, Lens
from geometry.notes import assumed_sites
from geometry.poses import Pose, body_rotation, camera_rotation
from geometry.scene import Scene
from geometry.sensors import CameraModel
from placement.layout import Layout

N_DISTORTION = 5
"""Coefficients of the plumb-bob model: k1, k2, p1, p2, k3; an ideal pinhole has zeros."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """One camera's calibration.

    Attributes
    ----------
    id : str
        Of the unit.
    width_px, height_px : int
        Size of the image.
    camera_matrix : (3, 3) float
        K: focal lengths and principal point. The middle of the first pixel is (0, 0). [px]
    world_to_camera : (3, 3) float
        R: from the world (east, north, up) to the camera (x right, y down, z ahead).
    translation_m : (3,) float
        t: where the world's origin is for the camera, so that x_camera = R x_world + t. [m]
    position_m : (3,) float
        Of the lens. World frame. [m]
    lens : Lens
        How it distorts; by default not at all.
    """

    id: str
    width_px: int
    height_px: int
    camera_matrix: FloatArray
    world_to_camera: FloatArray
    translation_m: FloatArray
    position_m: FloatArray
    lens: Lens = field(default_factory=BrownConrady)


def of_calibrated(name: str, camera: CalibratedCamera) -> Calibration:
    """Calibration of a camera that was read."""
    rotation = camera.R_camera_world
    return Calibration(
        id=name,
        width_px=camera.width_px,
        height_px=camera.height_px,
        camera_matrix=np.array(
            [
                [camera.fx_px, 0.0, camera.cx_px],
                [0.0, camera.fy_px, camera.cy_px],
                [0.0, 0.0, 1.0],
            ]
        ),
        world_to_camera=rotation,
        translation_m=-rotation @ camera.position_m,
        position_m=camera.position_m,
        lens=camera.lens,
    )


def lens_coefficients(camera: Calibration) -> tuple[bool, FloatArray]:
    """Whether the lens is a fisheye, and its coefficients as OpenCV orders them, (1, n).

    Raises InputError for Tsai's, which neither of OpenCV's models is.
    """
    lens = camera.lens
    if isinstance(lens, BrownConrady):
        return False, np.array([[lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]])
    if isinstance(lens, Fisheye):
        return True, np.array([[lens.k1, lens.k2, lens.k3, lens.k4]])
    expected = "Brown-Conrady's or a fisheye: the other way round is not of the same form"
    raise InputError(f"{camera.id}: lens", Unquoted("Tsai's radial term"), expected)


def calibrations(layout: Layout, format_name: str) -> list[Calibration]:
    """Calibrations of a layout's cameras; its LiDARs are left out.

    If there is no camera, raises InputError that names the format.

    References
    ----------
    .. [1] OpenCV, "Camera Calibration and 3D Reconstruction": s p = K (R x + t).
    """
    found = []
    for unit in layout.units:
        if not isinstance(unit.sensor, CameraModel):
            continue
        rotation = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg).T
        found.append(
            Calibration(
                id=unit.id,
                width_px=unit.sensor.width_px,
                height_px=unit.sensor.height_px,
                camera_matrix=camera_matrix(unit.sensor),
                world_to_camera=rotation,
                translation_m=rotation @ (np.zeros(3) - unit.pose.position_m),
                position_m=unit.pose.position_m,
            )
        )
    if not found:
        raise InputError(format_name, Unquoted("a layout of LiDARs only"), "at least one camera")
    return found


def lidar_ids(layout: Layout) -> list[str]:
    """Units that are no cameras."""
    return [unit.id for unit in layout.units if not isinstance(unit.sensor, CameraModel)]


def comments(layout: Layout, scene: Scene | None) -> str:
    """Comment lines of YAML: units that are no cameras, and those at sites that are assumed."""
    named = ", ".join(lidar_ids(layout))
    doubts = {} if scene is None else assumed_sites(scene.notes)
    return "".join(
        [
            f"# Left out, for they are no cameras: {named}\n" if named else "",
            *(
                f"# {unit.id}: assumed: {doubts[unit.site_id]}\n"
                for unit in layout.units
                if unit.site_id in doubts
            ),
        ]
    )


def camera_matrix(camera: CameraModel) -> FloatArray:
    """K of a camera, (3, 3), in pixels whose middles are whole numbers, as OpenCV counts them.

    :func:`geometry.sensors.project_points` has the middle of the first pixel at (0.5, 0.5), so that
    the principal point is half a pixel farther there.
    """
    focal_px = camera.focal_length_px
    return np.array(
        [
            [focal_px, 0.0, 0.5 * (camera.width_px - 1)],
            [0.0, focal_px, 0.5 * (camera.height_px - 1)],
            [0.0, 0.0, 1.0],
        ]
    )


def optical_quaternion(pose: Pose) -> list[float]:
    """Rotation from the camera (x right, y down, z ahead) to the world: x, y, z, w."""
    return quaternion(camera_rotation(pose.yaw_deg, pose.pitch_deg))


def sensor_quaternion(pose: Pose, sensor: Sensor) -> list[float]:
    """Rotation from a sensor's own frame to the world: x, y, z, w.

    A camera's own frame is x right, y down, z ahead; a LiDAR's x ahead, y left, z up.
    """
    if isinstance(sensor, CameraModel):
        return optical_quaternion(pose)
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
