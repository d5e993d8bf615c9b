"""Pictures of frames: instances and depths by rays, light by day and night."""

from dataclasses import replace

import numpy as np
import pytest
from camera_rays import pixel_rays
from kept_backdrops import CORNER
from ray_renderer import render_frame

from geometry.actors import MovingActor, pick_actor
from geometry.image_boxes import mask_box
from geometry.poses import Pose
from geometry.scene import Site
from geometry.study_scene import load_study_scene
from geometry.weather import load_weathers
from placement.compute import Compute
from placement.evaluator.surroundings import build_surroundings
from placement.imaging import build_backdrop, draw_picture

# Near the study's RSU3.
ABOVE = Pose(position_m=[0.0, -12.0, 9.0], yaw_deg=90.0, pitch_deg=-40.0)


def render_picture(scene, run, *args, **options):
    """The picture of one frame of a run."""
    return draw_picture(build_backdrop(scene, run.obstruction), run, *args, **options)


@pytest.fixture
def draw(backdrop, study_run, small):
    """Draws a frame of the study's run in a weather."""

    def draw_frame(weather, **options):
        frame = len(study_run.time_s) - 1 - 5
        return draw_picture(
            backdrop,
            study_run,
            frame,
            CORNER,
            small,
            weather=load_weathers()[weather],
            **options,
        )

    return draw_frame


@pytest.mark.long
@pytest.mark.parametrize("weather", ["night", "rain"])
def test_the_same_seed_gives_the_same_picture_whatever_the_threads(draw, weather):
    one = draw(weather, compute=Compute(seed=3))
    same = draw(weather, compute=Compute(seed=3, workers=2))
    other = draw(weather, compute=Compute(seed=4))

    assert np.array_equal(one.rgb, same.rgb)
    assert not np.array_equal(one.rgb, other.rgb)
    assert np.array_equal(one.instance, other.instance)
    assert np.array_equal(one.depth_m, other.depth_m)


def test_rough_edges_are_all_that_a_quick_picture_has(draw):
    smooth = draw("day")
    rough = draw("day", is_smooth=False)

    assert np.array_equal(smooth.instance, rough.instance)
    assert np.array_equal(smooth.depth_m, rough.depth_m)

    differs = np.abs(smooth.rgb.astype(int) - rough.rgb).max(axis=2) > 8
    light = rough.rgb.astype(int).sum(axis=2)
    steps = sum(np.abs(np.diff(light, axis=axis, append=0)) for axis in (0, 1))

    assert 0.001 < differs.mean() < 0.3
    assert steps[differs].mean() > 3.0 * steps[~differs].mean()


def test_a_picture_has_the_sensors_size_and_the_declared_types(draw, small):
    picture = draw("day")
    shape = (small.height_px, small.width_px)

    assert picture.rgb.shape == (*shape, 3)
    assert picture.rgb.dtype == np.uint8
    assert picture.instance.shape == shape
    assert picture.instance.dtype == np.int32
    assert picture.depth_m.shape == shape
    assert picture.depth_m.dtype == np.float32
    assert np.array_equal(picture.instance == -1, np.isinf(picture.depth_m))
    assert picture.instance.max() < len(picture.names)
    assert picture.names[-2:] == ("vut", "vru")
    assert {"ground", "building-ne", "parked-1"} <= set(picture.names)


@pytest.mark.long
@pytest.mark.parametrize("back", [0, 5, 12])
@pytest.mark.parametrize("with_vut", [True, False])
def test_instances_and_depths_are_those_of_one_ray_per_body_and_pixel(
    backdrop, study_run, small, back, with_vut
):
    camera = replace(small, width_px=960, height_px=540)
    frame = len(study_run.time_s) - 1 - back
    view = render_frame(
        build_surroundings(load_study_scene(), [study_run]),
        frame,
        CORNER,
        camera,
        with_vut=with_vut,
    )

    picture = draw_picture(
        backdrop,
        study_run,
        frame,
        CORNER,
        camera,
        weather=load_weathers()["day"],
        with_vut=with_vut,
    )

    assert ("vut" in picture.names) == with_vut

    vru = picture.instance == picture.names.index("vru")

    box = mask_box(vru)

    assert box.any()
    # The other one casts each body in its own frame: rays along an edge may go either
    # way.
    assert box == pytest.approx(view.visible_box_px, abs=1.0)

    is_same = np.isclose(picture.depth_m, view.depth_m, rtol=1e-4)

    assert is_same.mean() > 0.9995


def test_what_lies_in_the_shadow_is_darker(build_plain_scene, study_run, small, day):
    weather = replace(day, sun_elevation_deg=45.0, sun_yaw_deg=180.0)
    scene = build_plain_scene(("wall", [0.0, -20.0, 0.0], [0.2, 20.0, 6.0]))
    picture = render_picture(
        scene,
        study_run,
        0,
        ABOVE,
        small,
        weather=weather,
    )
    ground = picture.instance == picture.names.index("ground")
    rows, columns = np.nonzero(ground)

    rays = pixel_rays(columns, rows, ABOVE, small)
    points = ABOVE.position_m + rays * picture.depth_m[rows, columns, None]
    east = points[:, 0]
    north = points[:, 1]
    near = np.abs(north) < 5.0
    level = picture.rgb[rows, columns].mean(axis=1)
    shaded = level[near & (east > 1.0) & (east < 5.5)]
    lit = level[near & (east > 7.0) & (east < 12.0)]

    assert len(shaded) > 100
    assert len(lit) > 100
    assert np.percentile(shaded, 99) < np.percentile(lit, 1)


@pytest.mark.long
def test_night_without_lamps_is_dark_and_lamps_light_the_road(
    build_plain_scene, study_run, small
):
    night = load_weathers()["night"]
    post = Site(
        id="post",
        position_m=[0.0, 0.0, 0.0],
        kind="lamp post",
        height_range_m=[4.0, 8.0],
        capacity_units=1,
    )

    def mean(sites):
        scene = build_plain_scene(sites=sites)
        picture = render_picture(
            scene,
            study_run,
            0,
            ABOVE,
            small,
            weather=night,
        )
        return picture.rgb[picture.instance >= 0].mean()

    assert mean(()) < 16.0  # of 255
    assert mean((post,)) > 2.0 * mean(())


def test_fog_takes_the_contrast_of_what_is_far(draw):
    clear = draw("day")
    fog = draw("fog")
    far = (clear.depth_m > 40.0) & np.isfinite(clear.depth_m)

    assert far.sum() > 100
    assert fog.rgb[far].std() < 0.4 * clear.rgb[far].std()


def test_no_face_is_black_by_day(draw):
    picture = draw("rain")
    for index in np.unique(picture.instance[picture.instance >= 0]):
        pixels = picture.rgb[picture.instance == index]
        if len(pixels) > 50:
            assert pixels.mean() > 15.0, picture.names[index]


def test_the_vuts_own_camera_sees_its_headlights_not_itself(backdrop, study_run, small):
    frame = 20
    pose = Pose(
        position_m=np.append(study_run.vut_position_m[frame], 1.4),
        yaw_deg=float(study_run.vut_yaw_deg[frame]),
    )

    def mean_below(weather):
        picture = draw_picture(
            backdrop,
            study_run,
            frame,
            pose,
            small,
            weather=weather,
            with_vut=False,
        )
        return picture.rgb[120:, 60:180].mean()

    night = load_weathers()["night"]
    unlit = replace(night, has_lamps=False)

    assert mean_below(night) > 3.0 * mean_below(unlit)


@pytest.mark.long
def test_what_drives_by_is_in_the_picture(backdrop, study_run, small, day):
    vru_m = study_run.vru_position_m[0]
    towards = CORNER.position_m[:2] - vru_m
    towards /= np.linalg.norm(towards)
    n_frames = len(study_run.time_s)
    position_m = np.tile(vru_m + 3.0 * towards, (n_frames, 1))
    position_m[1:] = np.nan
    van = MovingActor(
        actor=pick_actor("parked-van", "test"),
        position_m=position_m,
        yaw_deg=np.zeros(n_frames),
    )
    run = replace(study_run, traffic=(van,))

    first = draw_picture(backdrop, run, 0, CORNER, small, weather=day)
    second = draw_picture(backdrop, run, 1, CORNER, small, weather=day)

    assert first.names[-3:] == ("driving-1", "vut", "vru")
    assert (first.instance == first.names.index("driving-1")).any()
    assert second.names[-2:] == ("vut", "vru")
    assert "driving-1" not in second.names
