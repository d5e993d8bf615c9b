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
from geometry.sensors import CameraModel, rolled
from placement.layout import Layout

N_DISTORTION = 5
"""Coefficients of the plumb-bob model: k1, k2, p1, p2, k3; an ideal pinhole has zeros."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """One camera's calibration."""

    id: str  # of the unit
    width_px: int
    height_px: int
    # (3, 3), K: focal lengths and principal point. The middle of the first pixel is (0, 0). [px]
    camera_matrix: FloatArray
    # (3, 3), R: from the world (east, north, up) to the camera (x right, y down, z ahead)
    world_to_camera: FloatArray
    position_m: FloatArray  # (3,); of the lens. World frame. [m]
    lens: Lens = field(default_factory=BrownConrady)  # how it distorts; by default not at all

    @property
    def translation_m(self) -> FloatArray:
        """t, (3,): the world's origin as the camera sees it; x_camera = R x_world + t. [m]."""
        return self.world_to_camera @ (np.zeros(3) - self.position_m)


def _matrix(focal_x_px: float, focal_y_px: float, x_px: float, y_px: float) -> FloatArray:
    return np.array([[focal_x_px, 0.0, x_px], [0.0, focal_y_px, y_px], [0.0, 0.0, 1.0]])


def of_calibrated(name: str, camera: CalibratedCamera) -> Calibration:
    """Calibration of a camera that was read."""
    return Calibration(
        id=name,
        width_px=camera.width_px,
        height_px=camera.height_px,
        camera_matrix=_matrix(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px),
        world_to_camera=camera.R_camera_world,
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
    found = [
        Calibration(
            id=unit.id,
            width_px=unit.sensor.width_px,
            height_px=unit.sensor.height_px,
            camera_matrix=camera_matrix(unit.sensor),
            world_to_camera=_camera_axes(unit.pose, unit.sensor).T,
            position_m=unit.pose.position_m,
            lens=unit.sensor.lens or BrownConrady(),
        )
        for unit in layout.units
        if isinstance(unit.sensor, CameraModel)
    ]
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
    left_out = f"# Left out, for they are no cameras: {named}\n" if named else ""
    assumed = (unit for unit in layout.units if unit.site_id in doubts)
    return left_out + "".join(f"# {unit.id}: assumed: {doubts[unit.site_id]}\n" for unit in assumed)


def camera_matrix(camera: CameraModel) -> FloatArray:
    """K of a camera, (3, 3), in pixels whose middles are whole numbers, as OpenCV counts them.

    :func:`geometry.sensors.project_points` has the middle of the first pixel at (0.5, 0.5), so that
    the principal point is half a pixel farther there.
    """
    focal_px = camera.focal_length_px
    if not camera.is_pinhole:
        x_px, y_px = camera.middle_px
        aspect = camera.pixel_aspect or 1.0
        return _matrix(focal_px, focal_px * aspect, x_px - 0.5, y_px - 0.5)
    middle_px = 0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)
    return _matrix(focal_px, focal_px, *middle_px)


def _camera_axes(pose: Pose, camera: CameraModel) -> FloatArray:
    """Rotation from a camera's frame to the world, with its roll."""
    rotation = camera_rotation(pose.yaw_deg, pose.pitch_deg)
    if not camera.roll_deg:
        return rotation
    return rolled(rotation, camera)


def refuse_lenses(layout: Layout, format_name: str) -> None:
    """Raise InputError if a camera of a layout is no pinhole: the format has no other."""
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel) and not unit.sensor.is_pinhole:
            got = Unquoted(f"{unit.id}, whose lens, principal point or roll it cannot carry")
            raise InputError(format_name, got, "ideal pinholes; opencv and ros have lenses")


def sensor_quaternion(pose: Pose, sensor: Sensor) -> list[float]:
    """Rotation from a sensor's own frame to the world: x, y, z, w.

    A camera's is x right, y down, z ahead; a LiDAR's x ahead, y left, z up.
    """
    if isinstance(sensor, CameraModel):
        return quaternion(_camera_axes(pose, sensor))
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
