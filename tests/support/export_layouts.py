"""Layouts and scenes that exports are tried on."""

from dataclasses import replace

import numpy as np

from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.poses import Pose
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.layout import Layout

AWKWARD = (
    'pole, "1"',
    "Laternenmast Ü/ß",
    "<script>alert('&')</script>",
    "x: [1] # - y",
    "123",
    "信号",
)
MAP_CRS = "EPSG:25832"


def map_scene() -> Scene:
    """The study's junction as if it had been made from a map in UTM."""
    return replace(load_study_scene(), source_crs=MAP_CRS)


def placeless_scene() -> Scene:
    """The study's junction as if nobody knew where it is."""
    return replace(load_study_scene(), crs="")


def unit(index: int, name: str, kind: str = "camera") -> CandidatePose:
    """A unit over the middle of the junction; no number is a short decimal."""
    rng = np.random.default_rng(index)
    return CandidatePose(
        id=name,
        site_id=f"site & {index // 3}",
        pose=Pose(
            position_m=rng.uniform([-132.0, -5.0, 5.0], [-121.0, 5.0, 9.0]),
            yaw_deg=float(rng.uniform(-180.0, 180.0)),
            pitch_deg=float(rng.uniform(-60.0, 10.0)),
        ),
        sensor=(
            load_lidars()["carla-ncap-lidar"]
            if kind == "lidar"
            else load_cameras()[
                "carla-ncap-rgb" if index % 2 else "basler-aca1920-50gc-8mm"
            ]
        ),
    )


def awkward_layout() -> Layout:
    """Names that quoting must survive, two LiDARs, a latency, a turned lens, an own
    camera.
    """
    units = [unit(index, name) for index, name in enumerate(AWKWARD)]
    varifocal = load_cameras()["varifocal-1080p"]
    units += [
        replace(unit(10, "lidar ä", "lidar"), latency_s=0.1),
        unit(11, "lidar b", "lidar"),
        replace(
            unit(12, "zoomed"),
            sensor=replace(varifocal, horizontal_fov_deg=100.0 / 3.0),
        ),
        replace(
            unit(13, "own"),
            sensor=replace(varifocal, name='my "own", camera', width_px=641),
        ),
    ]
    return Layout(
        name='all, "of" <them> & Ä',
        units=tuple(units),
        scene_name="town05",
    )


def large_layout() -> Layout:
    """Two hundred units."""
    return Layout(
        name="large",
        units=tuple(unit(index, f"unit {index} ü") for index in range(200)),
    )


def level_layout(
    yaw_deg: float,
    pitch_deg: float = 0.0,
    *,
    kind: str = "camera",
) -> Layout:
    """One unit 6 m above the origin."""
    one = unit(1, "one", kind)
    pose = Pose(
        position_m=[0.0, 0.0, 6.0],
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    return Layout(
        name="one",
        units=(
            replace(
                one,
                pose=pose,
                site_id="",
            ),
        ),
    )
