"""Layouts as stages of OpenUSD: scene, poles and cameras with their lenses."""

import re
from typing import Any

import numpy as np

from geometry.poses import body_rotation, camera_rotation
from geometry.scene import Scene
from geometry.sensors import CameraModel
from placement.layout import Layout

from . import ExportFormat, load_extra
from .calibration import refuse_lenses

_APERTURE_MM = 36.0  # only its ratio to the focal length counts
_FAR_M = 1000.0
_AXES = np.diag([1.0, -1.0, -1.0])  # USD's cameras look along -z, y up
_POLE_RADIUS_M = 0.1


def to_usd(layout: Layout, scene: Scene) -> str:
    """Layout as a USD stage in text (.usda): metres, z up, x east, y north.

    /World/Scene has a mesh per thing, /World/Poles a cylinder per site up to its highest mount,
    /World/Units a Camera per unit - focal length and apertures in tenths of a unit of the stage, so
    that fields of view are ours -, of LiDARs a frame (Xform: x ahead, y left, z up). Ids that USD
    allows no names are in the attribute "placeRsus:id". Not in it: materials, road users. Raises
    MissingExtraError if usd-core is not installed, and InputError for lenses that distort.
    """
    refuse_lenses(layout, "usd")
    usd, geom, gf, sdf = (
        load_extra(f"pxr.{name}", "usd needs usd-core", "usd")
        for name in ("Usd", "UsdGeom", "Gf", "Sdf")
    )
    stage = usd.Stage.CreateInMemory()
    geom.SetStageUpAxis(stage, geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(geom.Xform.Define(stage, "/World").GetPrim())
    taken: set[str] = set()

    def define(kind: Any, folder: str, name: str) -> Any:
        word = "_" + re.sub(r"\W", "_", name, flags=re.ASCII)
        path = f"/World/{folder}/{word}"
        while path in taken:
            path += "_"
        taken.add(path)
        made = kind.Define(stage, path)
        made.GetPrim().CreateAttribute("placeRsus:id", sdf.ValueTypeNames.String).Set(name)
        return made

    def move(made: Any, rotation: Any, position_m: Any) -> None:
        matrix = np.eye(4)
        matrix[:3, :3] = np.asarray(rotation).T  # of row vectors
        matrix[3, :3] = position_m
        made.AddTransformOp().Set(gf.Matrix4d(*matrix.ravel().tolist()))

    for index, thing in enumerate(scene.instances):
        triangles = scene.triangles[scene.triangle_instance == index]
        used, indices = np.unique(triangles, return_inverse=True)
        mesh = define(geom.Mesh, "Scene", thing.id)
        mesh.CreatePointsAttr(scene.vertices_m[used].astype(np.float32))
        mesh.CreateFaceVertexIndicesAttr(indices.ravel().tolist())
        mesh.CreateFaceVertexCountsAttr([3] * len(triangles))
        mesh.CreateSubdivisionSchemeAttr("none")
    for site in scene.sites:
        height_m = float(site.height_range_m[1])
        pole = define(geom.Cylinder, "Poles", site.id)
        pole.CreateRadiusAttr(_POLE_RADIUS_M)
        pole.CreateHeightAttr(height_m)
        move(pole, np.eye(3), site.position_m + [0.0, 0.0, 0.5 * height_m])
    for unit in layout.units:
        rotation = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg)
        if not isinstance(unit.sensor, CameraModel):
            frame = define(geom.Xform, "Units", unit.id)
            move(frame, body_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg), unit.pose.position_m)
            continue
        camera = define(geom.Camera, "Units", unit.id)
        move(camera, rotation @ _AXES, unit.pose.position_m)
        width_px, height_px = unit.sensor.width_px, unit.sensor.height_px
        camera.CreateHorizontalApertureAttr(_APERTURE_MM)
        camera.CreateVerticalApertureAttr(_APERTURE_MM * height_px / width_px)
        camera.CreateFocalLengthAttr(_APERTURE_MM * unit.sensor.focal_length_px / width_px)
        camera.CreateClippingRangeAttr(gf.Vec2f(unit.sensor.near_m, _FAR_M))
    text: str = stage.ExportToString()
    return text


FORMAT = ExportFormat(
    write=to_usd, content="scene, poles, cameras with lenses; Omniverse, Isaac; extra: usd"
)
