"""The VUT's own camera: which model, and where on the vehicle; its LiDAR at the same place."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from geometry.actors import Actor
from geometry.catalogue import pick_camera
from geometry.lidar import LidarModel, load_lidars
from geometry.poses import Pose
from geometry.sensors import CameraModel
from geometry.toml_files import load_toml, pick, take_number, take_text


@dataclass(frozen=True, slots=True, kw_only=True)
class VutCamera:
    """A camera on the VUT, level and facing ahead.

    Attributes
    ----------
    camera : CameraModel
        What is mounted.
    ahead_per_half_length : float
        Distance ahead of the VUT's middle, as a share of half its length.
    up_per_half_height : float
        Height above the road, as a share of half the VUT's height.
    """

    camera: CameraModel
    ahead_per_half_length: float
    up_per_half_height: float

    def pose_on(self, vut: Actor) -> Pose:
        """Where it is in the body frame of a vehicle.

        Parameters
        ----------
        vut : Actor
            The vehicle.

        Returns
        -------
        pose : Pose
            Body frame of `vut`.
        """
        ahead_m = self.ahead_per_half_length * 0.5 * vut.length_m
        up_m = self.up_per_half_height * 0.5 * vut.height_m
        return Pose(position_m=np.array([ahead_m, 0.0, up_m]), yaw_deg=0.0)


@cache
def load_vut_camera() -> VutCamera:
    """The study's camera, from ``data/vut_camera.toml``."""
    where = "vut_camera.toml"
    table = load_toml(files("placement") / "data" / where)
    return VutCamera(
        camera=pick_camera(take_text(table, "camera", where), f"{where}: camera"),
        ahead_per_half_length=take_number(table, "ahead_per_half_length", where),
        up_per_half_height=take_number(table, "up_per_half_height", where),
    )


@cache
def load_vut_lidar() -> LidarModel:
    """The study's LiDAR, at the camera's place, from ``data/vut_camera.toml``."""
    where = "vut_camera.toml"
    table = load_toml(files("placement") / "data" / where)
    lidar: LidarModel = pick(load_lidars(), take_text(table, "lidar", where), f"{where}: lidar")
    return lidar
