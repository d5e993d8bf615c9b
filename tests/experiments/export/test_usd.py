"""USD stages, read back by USD's own classes."""

import numpy as np
import pytest
from export_layouts import awkward_layout, large_layout

from experiments.export.usd import to_usd
from geometry.sensors import CameraModel, project_points
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout

pxr = pytest.importorskip("pxr", reason="the extra usd is not installed")

SCENE = load_study_scene()


def open_stage(text):
    from pxr import Sdf, Usd

    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(text)
    return Usd.Stage.Open(layer)


def by_id(stage, folder):
    prims = stage.GetPrimAtPath(f"/World/{folder}").GetChildren()
    return {prim.GetAttribute("placeRsus:id").Get(): prim for prim in prims}


@pytest.mark.parametrize("build", [load_carlancap_layout, awkward_layout, large_layout])
def test_cameras_are_ours_to_a_millimetre_and_a_hundredth_of_a_degree(build):
    from pxr import UsdGeom

    layout = build()
    stage = open_stage(to_usd(layout, SCENE))
    prims = by_id(stage, "Units")
    assert list(prims) == [unit.id for unit in layout.units]
    for unit in layout.units:
        if not isinstance(unit.sensor, CameraModel):
            assert prims[unit.id].IsA(UsdGeom.Xform)
            continue
        camera = UsdGeom.Camera(prims[unit.id]).GetCamera()
        frustum = camera.frustum
        np.testing.assert_allclose(frustum.GetPosition(), unit.pose.position_m, atol=1e-3)
        yaw_rad, pitch_rad = np.radians([unit.pose.yaw_deg, unit.pose.pitch_deg])
        ahead = np.array(
            [np.cos(yaw_rad) * np.cos(pitch_rad), np.sin(yaw_rad) * np.cos(pitch_rad),
             np.sin(pitch_rad)]
        )  # fmt: skip
        off = np.linalg.norm(np.cross(ahead, frustum.ComputeViewDirection()))
        assert np.degrees(off) < 0.01
        wide_deg = camera.GetFieldOfView(camera.FOVHorizontal)
        high_deg = camera.GetFieldOfView(camera.FOVVertical)
        assert wide_deg == pytest.approx(unit.sensor.horizontal_fov_deg, abs=0.01)
        assert high_deg == pytest.approx(unit.sensor.vertical_fov_deg, abs=0.01)


def test_a_point_is_in_the_same_place_of_the_picture():
    """USD's own projection against ours, left and right, above and below."""
    from pxr import Gf, UsdGeom

    unit = load_carlancap_layout().units[0]
    stage = open_stage(to_usd(load_carlancap_layout(), SCENE))
    prims = by_id(stage, "Units")
    frustum = UsdGeom.Camera(prims[unit.id]).GetCamera().frustum
    to_picture = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    yaw_rad = np.radians(unit.pose.yaw_deg + np.array([-30.0, 0.0, 20.0]))
    ways = np.stack([12.0 * np.cos(yaw_rad), 12.0 * np.sin(yaw_rad), [-3.0, -5.0, -7.0]], axis=1)
    points_m = unit.pose.position_m + ways
    pixels = project_points(points_m, unit.pose, unit.sensor)
    for point, (x_px, y_px) in zip(points_m, pixels[:, :2], strict=True):
        x, y, _ = to_picture.Transform(Gf.Vec3d(*point.tolist()))
        assert 0.5 * (1.0 + x) * unit.sensor.width_px == pytest.approx(x_px, abs=0.05)
        assert 0.5 * (1.0 - y) * unit.sensor.height_px == pytest.approx(y_px, abs=0.05)


def test_scene_and_poles_stand_where_ours_stand():
    from pxr import Usd, UsdGeom

    stage = open_stage(to_usd(load_carlancap_layout(), SCENE))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    boxes = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_])
    poles = by_id(stage, "Poles")
    for site in SCENE.sites:
        box = boxes.ComputeWorldBound(poles[site.id]).ComputeAlignedRange()
        np.testing.assert_allclose(
            [box.GetMin()[2], box.GetMax()[2]],
            site.position_m[2] + [0.0, site.height_range_m[1]],
            atol=1e-3,
        )
        np.testing.assert_allclose(box.GetMidpoint()[:2], site.position_m[:2], atol=1e-3)
    meshes = by_id(stage, "Scene")
    for index, thing in enumerate(SCENE.instances):
        used = np.unique(SCENE.triangles[SCENE.triangle_instance == index])
        box = boxes.ComputeWorldBound(meshes[thing.id]).ComputeAlignedRange()
        np.testing.assert_allclose(box.GetMin(), SCENE.vertices_m[used].min(axis=0), atol=1e-3)
        np.testing.assert_allclose(box.GetMax(), SCENE.vertices_m[used].max(axis=0), atol=1e-3)
