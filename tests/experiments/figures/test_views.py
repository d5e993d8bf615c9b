"""Views on the ground: up to the detector's reach, cut where something hides the
ground.
"""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from experiments.figures.outlines import ground_footprint
from experiments.figures.views import MAX_RANGE_M, GroundViews
from geometry.catalogue import load_cameras
from geometry.lidar import load_lidars
from geometry.poses import Pose
from geometry.raycast import build_caster
from geometry.scene import thing_footprint
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose, is_in_view

CAMERA = load_cameras()["carla-ncap-rgb"]


@pytest.fixture(scope="module")
def views(small_setting):
    """What units see of the ground in the small setting."""
    return GroundViews(small_setting)


def mounted(sensor=CAMERA, *, yaw_deg=90.0, pitch_deg=-12.0, site="corner-sw"):
    """A camera at a site."""
    sites = {each.id: each for each in load_study_scene().sites}
    foot_m = sites[site].position_m
    pose = Pose(
        position_m=foot_m + [0.0, 0.0, 8.0],
        yaw_deg=yaw_deg,
        pitch_deg=pitch_deg,
    )
    return CandidatePose(
        id="U1",
        site_id=site,
        pose=pose,
        sensor=sensor,
    )


def test_a_camera_reaches_as_far_as_the_tallest_road_user_is_high_enough_in_the_image(
    small_setting, views
):
    """In fog, a camera that needs all of the contrast reaches nowhere."""
    detector = small_setting.table_detector
    tallest_m = max(run.encounter.vru.height_m for run in small_setting.runs)

    for fov_deg in (40.0, 70.0, 110.0):
        camera = replace(CAMERA, horizontal_fov_deg=fov_deg)
        tallest_px_m = camera.focal_length_px * tallest_m
        high_enough_m = tallest_px_m / detector.min_box_height_px
        reach_m = min(high_enough_m, MAX_RANGE_M)
        assert views.reach_m(camera) == pytest.approx(reach_m, abs=0.5)

    axis = small_setting.axis
    foggy = replace(
        small_setting,
        table_detector=replace(detector, min_contrast=1.0),
        axis=replace(axis, weathers=("fog",) * axis.n_runs),
    )

    in_fog = GroundViews(foggy)
    lidar = load_lidars()["ouster-os1-128"]

    assert in_fog.reach_m(CAMERA) == 0.0
    assert views.reach_m(lidar) == 120.0


@pytest.mark.parametrize("yaw_deg", [45.0, 180.0, -90.0])
def test_no_view_runs_through_houses(small_setting, views, yaw_deg):
    """The image alone, without rays, would reach into them."""
    footprints = []
    for index, thing in enumerate(small_setting.scene.instances):
        if thing.class_name == "building":
            footprints.append(thing_footprint(small_setting.scene, index))
    # Borders of views may be off by so much.
    houses = shapely.union_all(footprints).buffer(-2.0)

    narrow = replace(CAMERA, horizontal_fov_deg=50.0)
    unit = mounted(narrow, yaw_deg=yaw_deg)
    reach_m = views.reach_m(narrow)
    image = shapely.Polygon(ground_footprint(unit, max_range_m=reach_m))
    view = views.shape(unit)

    assert image.intersection(houses).area > 50.0
    assert view.intersection(houses).area == 0.0


@pytest.mark.parametrize("name", ["camera", *load_lidars()])
def test_a_view_is_what_rays_reach(small_setting, views, name):
    """Random places on the ground are inside of it where a ray arrives."""
    if name == "camera":
        sensor = CAMERA
    else:
        sensor = load_lidars()[name]
    unit = mounted(sensor, pitch_deg=-10.0)
    rng = np.random.default_rng(0)
    eye_m = unit.pose.position_m
    ground_m = eye_m[:2] + rng.uniform(-60.0, 60.0, (4000, 2))
    points_m = np.column_stack([ground_m, np.zeros(4000)])
    away_m = points_m - eye_m

    # Cameras reach so far along their axis, LiDARs along the ground.
    if name == "camera":
        down = np.radians(10.0)
        axis = np.array([0.0, np.cos(down), -np.sin(down)])
        depth_m = away_m @ axis
    else:
        depth_m = np.linalg.norm(away_m[:, :2], axis=-1)
    is_near = depth_m <= views.reach_m(sensor)

    scene = small_setting.scene
    caster = build_caster(scene.vertices_m - eye_m, scene.triangles)
    vectors_m = (away_m + [0.0, 0.0, 1.0]).astype(np.float32)
    is_hidden = caster.is_blocked(0.05 * vectors_m, 0.94 * vectors_m)
    is_seen = is_in_view(unit, points_m) & is_near & ~is_hidden
    shape = views.shape(unit)
    is_drawn = shapely.contains_xy(shape, ground_m)
    is_wrong = is_drawn != is_seen

    assert is_seen.sum() > 100
    # A degree and a metre wide are the borders.
    assert is_wrong.mean() < 0.03
