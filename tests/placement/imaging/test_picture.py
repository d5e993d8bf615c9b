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
    backdrop = build_backdrop(scene, run.obstruction)
    return draw_picture(backdrop, run, *args, **options)


@pytest.fixture
def draw(backdrop, study_run, small):
    """Draws a frame of the study's run in a weather."""

    def draw_frame(weather, **options):
        n_frames = len(study_run.time_s)
        frame = n_frames - 1 - 5
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
    compute_3 = Compute(seed=3)
    one = draw(weather, compute=compute_3)
    compute = Compute(seed=3, workers=2)
    same = draw(weather, compute=compute)
    compute_4 = Compute(seed=4)
    other = draw(weather, compute=compute_4)
    is_same = np.array_equal(one.rgb, other.rgb)

    assert np.array_equal(one.rgb, same.rgb)
    assert not is_same
    assert np.array_equal(one.instance, other.instance)
    assert np.array_equal(one.depth_m, other.depth_m)


def test_rough_edges_are_all_that_a_quick_picture_has(draw):
    smooth = draw("day")
    rough = draw("day", is_smooth=False)

    assert np.array_equal(smooth.instance, rough.instance)
    assert np.array_equal(smooth.depth_m, rough.depth_m)

    difference = smooth.rgb.astype(int) - rough.rgb
    largest = np.abs(difference).max(axis=2)
    differs = largest > 8
    values = rough.rgb.astype(int)
    light = values.sum(axis=2)
    steps = sum(np.abs(np.diff(light, axis=axis, append=0)) for axis in (0, 1))
    steps_at_edges = steps[differs].mean()
    steps_elsewhere = steps[~differs].mean()

    assert 0.001 < differs.mean() < 0.3
    assert steps_at_edges > 3.0 * steps_elsewhere


def test_a_picture_has_the_sensors_size_and_the_declared_types(draw, small):
    picture = draw("day")
    shape = (small.height_px, small.width_px)
    expected = np.isinf(picture.depth_m)
    highest = picture.instance.max()
    n_names = len(picture.names)
    names = set(picture.names)

    assert picture.rgb.shape == (*shape, 3)
    assert picture.rgb.dtype == np.uint8
    assert picture.instance.shape == shape
    assert picture.instance.dtype == np.int32
    assert picture.depth_m.shape == shape
    assert picture.depth_m.dtype == np.float32
    assert np.array_equal(picture.instance == -1, expected)
    assert highest < n_names
    assert picture.names[-2:] == ("vut", "vru")
    assert {"ground", "building-ne", "parked-1"} <= names


@pytest.mark.long
@pytest.mark.parametrize("back", [0, 5, 12])
@pytest.mark.parametrize("with_vut", [True, False])
def test_instances_and_depths_are_those_of_one_ray_per_body_and_pixel(
    backdrop, study_run, small, back, with_vut
):
    camera = replace(small, width_px=960, height_px=540)
    n_frames = len(study_run.time_s)
    frame = n_frames - 1 - back
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

    vru_index = picture.names.index("vru")
    vru = picture.instance == vru_index

    box = mask_box(vru)

    assert box.any()
    # The other one casts each body in its own frame: rays along an edge may go either
    # way.
    assert box == pytest.approx(view.visible_box_px, abs=1.0)

    is_same = np.isclose(picture.depth_m, view.depth_m, rtol=1e-4)

    assert is_same.mean() > 0.9995


def test_what_lies_in_the_shadow_is_darker(build_plain_scene, study_run, small, day):
    weather = replace(day, sun_elevation_deg=45.0, sun_yaw_deg=180.0)
    wall = ("wall", [0.0, -20.0, 0.0], [0.2, 20.0, 6.0])
    scene = build_plain_scene(wall)
    picture = render_picture(
        scene,
        study_run,
        0,
        ABOVE,
        small,
        weather=weather,
    )
    ground_index = picture.names.index("ground")
    ground = picture.instance == ground_index
    rows, columns = np.nonzero(ground)

    rays = pixel_rays(columns, rows, ABOVE, small)
    ways = rays * picture.depth_m[rows, columns, None]
    points = ABOVE.position_m + ways
    east = points[:, 0]
    north = points[:, 1]
    near = np.abs(north) < 5.0
    colours = picture.rgb[rows, columns]
    level = colours.mean(axis=1)
    in_shadow = near & (east > 1.0) & (east < 5.5)
    shaded = level[in_shadow]
    in_light = near & (east > 7.0) & (east < 12.0)
    lit = level[in_light]
    brightest_shaded = np.percentile(shaded, 99)
    darkest_lit = np.percentile(lit, 1)

    assert len(shaded) > 100
    assert len(lit) > 100
    assert brightest_shaded < darkest_lit


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
        shown = picture.rgb[picture.instance >= 0]
        return shown.mean()

    with_lamp = mean((post,))
    without = mean(())

    assert mean(()) < 16.0  # of 255
    assert with_lamp > 2.0 * without


def test_fog_takes_the_contrast_of_what_is_far(draw):
    clear = draw("day")
    fog = draw("fog")
    is_finite = np.isfinite(clear.depth_m)
    far = (clear.depth_m > 40.0) & is_finite
    fog_contrast = fog.rgb[far].std()
    clear_contrast = clear.rgb[far].std()

    assert far.sum() > 100
    assert fog_contrast < 0.4 * clear_contrast


def test_no_face_is_black_by_day(draw):
    picture = draw("rain")
    shown = picture.instance[picture.instance >= 0]
    for index in np.unique(shown):
        pixels = picture.rgb[picture.instance == index]
        if len(pixels) > 50:
            level = pixels.mean()
            assert level > 15.0, picture.names[index]


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
        part = picture.rgb[120:, 60:180]
        return part.mean()

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
    index = first.names.index("driving-1")
    is_driving = first.instance == index

    assert first.names[-3:] == ("driving-1", "vut", "vru")
    assert is_driving.any()
    assert second.names[-2:] == ("vut", "vru")
    assert "driving-1" not in second.names
