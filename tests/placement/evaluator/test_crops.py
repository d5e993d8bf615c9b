"""Crops around road users: what is shown to networks that look at crops."""

from dataclasses import replace

import numpy as np
import pytest
from kept_backdrops import CORNER, kept_backdrop
from placed_bodies import ahead_of
from short_runs import cut_run

from geometry.image_boxes import box_height_px
from geometry.study_scene import load_study_scene
from geometry.weather import pick_weather
from placement.detectors import is_matched, load_detector, load_min_iou
from placement.evaluator import build_surroundings, load_vut_camera
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.pictures import RenderedPictures
from placement.imaging.picture import Window
from placement.imaging.stills import window_around


@pytest.fixture(autouse=True)
def backdrops(monkeypatch):
    """What stands still is prepared once for the pictures of all tests."""
    monkeypatch.setattr("placement.imaging.picture.build_backdrop", kept_backdrop)
    monkeypatch.setattr("placement.evaluator.pictures.build_backdrop", kept_backdrop)


@pytest.fixture(scope="module")
def scene():
    """The study's junction."""
    return load_study_scene()


@pytest.fixture(scope="module")
def last_frames(runs):
    """A run by name, cut to what happens right before the impact."""
    by_name = {run.id: run for run in runs}

    def cut(name, n_frames=3):
        run = by_name[name]
        last = slice(-n_frames, None)
        return cut_run(run, last)

    return cut


@pytest.fixture(scope="module")
def seen(scene, camera):
    """Crops, pictures and evidence of frames from the roadside or from the VUT."""

    def look(runs, *, from_vut=False, camera=camera):
        source = RenderedPictures(scene, runs, seed=3)
        surroundings = build_surroundings(scene, runs)
        if from_vut:
            mount = replace(load_vut_camera(), camera=camera)
            evidence = perceive_frames(surroundings, mount)
            return (
                source.crops(mount, evidence.amodal_px),
                source.pictures(mount),
                evidence,
            )

        evidence = perceive_frames(surroundings, (CORNER, camera))
        crops = source.crops((CORNER, camera), evidence.amodal_px)
        pictures = source.pictures((CORNER, camera))
        return crops, pictures, evidence

    return look


def alone(crops, frame):
    """The crop of a frame, drawn by itself."""
    ((_, crop),) = crops.draw_all([frame])
    return crop


@pytest.fixture(scope="module")
def larger(camera):
    """The camera with four times the pixels each way."""
    return replace(camera, width_px=4 * camera.width_px, height_px=4 * camera.height_px)


def test_a_window_has_the_box_in_its_middle_but_stays_in_the_image(larger):
    box_px = np.array([500.0, 400.0, 520.0, 450.0])
    inside = window_around(box_px, larger, side_px=96)

    assert inside == Window(462, 377, 96, 96)

    corner = np.array([larger.width_px - 9.0, 0.0, larger.width_px, 30.0])

    expected = Window(larger.width_px - 96, 0, 96, 96)
    found = window_around(corner, larger, side_px=96)

    assert found == expected


@pytest.mark.long
@pytest.mark.parametrize("weather", ["day", "night"])
def test_a_crop_is_that_part_of_the_whole_picture(last_frames, seen, larger, weather):
    run_by_day = last_frames("CPNC-50/west/30", 1)
    run = replace(run_by_day, weather=weather)
    crops, picture, evidence = seen([run], camera=larger)
    crop = alone(crops, 0)

    assert crop.scale == 1.0

    side = len(crop.pixels)
    whole_px = np.array([[0.0, 0.0, side, side]])
    image_px = crop.to_image(whole_px)
    left, top, right, bottom = image_px[0].astype(int)
    box = evidence.amodal_px[0]

    assert left <= box[0] < box[2] <= right
    assert top <= box[1] < box[3] <= bottom

    part_px = picture(0)[top:bottom, left:right]
    part = part_px.astype(float)
    crop_px = crop.pixels.astype(float)
    difference = crop_px - part
    off = np.abs(difference)
    crop_values = crop.pixels.ravel()
    part_values = part.ravel()
    correlation = np.corrcoef(crop_values, part_values)

    # Noise is drawn anew, and the exposure is set by fewer pixels.
    assert off.mean() < 6.0
    assert correlation[0, 1] > 0.97


def test_a_road_user_that_would_fill_a_crop_is_drawn_smaller(last_frames, seen, larger):
    run = last_frames("CBLA/west/25", 1)
    crops, _, evidence = seen([run], from_vut=True, camera=larger)
    box = evidence.amodal_px[0]

    crop = alone(crops, 0)
    height_px = box_height_px(box[None])[0]

    assert max(crop.pixels.shape) == 160
    assert crop.scale >= height_px / 160.0 > 1.0

    height, width = crop.pixels.shape[:2]
    whole_px = np.array([[0.0, 0.0, width, height]])
    corners_px = crop.to_image(whole_px)
    whole = corners_px[0]
    starts_before = whole[:2] <= box[:2] + 1.0e-6
    ends_after = whole[2:] >= box[2:] - 1.0e-6

    assert starts_before.all()
    assert ends_after.all()


def test_frames_look_the_same_where_only_a_vut_out_of_sight_has_moved(
    last_frames, seen
):
    run = last_frames("CPNC-50/west/30", 2)
    still = {
        name: np.repeat(getattr(run, name)[:1], 2, axis=0)
        for name in ("vru_position_m", "vru_yaw_deg", "vru_shape")
    }
    shifts_m = [[-400.0, 0.0], [-390.0, 0.0]]
    far = run.vut_position_m[0] + shifts_m
    away = replace(run, **still, vut_position_m=far)

    crops, _, _ = seen([away])
    key = crops.key(0)
    next_key = crops.key(1)

    assert key == next_key

    # At night headlights reach far, and nearby the car itself is seen.
    night = replace(away, weather="night")
    by_night, _, _ = seen([night])
    night_key = by_night.key(0)
    next_night_key = by_night.key(1)

    assert night_key != next_night_key

    vut_position_m = run.vru_position_m.copy()
    at_hand = replace(run, **still, vut_position_m=vut_position_m)
    beside, _, _ = seen([at_hand])
    beside_key = beside.key(0)
    next_beside_key = beside.key(1)

    assert beside_key != next_beside_key


def test_crops_of_the_vuts_camera_are_never_taken_for_one_another(last_frames, seen):
    last = last_frames("CBLA/west/25", 2)
    crops, _, _ = seen([last], from_vut=True)
    key = crops.key(0)
    next_key = crops.key(1)

    assert key != next_key


def test_the_shadow_of_the_vut_belongs_to_it(last_frames, seen):
    # A car beside the crop whose shadow falls into it must be drawn.
    run = last_frames("CPNC-50/west/30", 1)
    weather = pick_weather("day", "test")
    elevation = np.radians(weather.sun_elevation_deg)
    steepness = np.tan(elevation)
    shadow_m = 1.2 / steepness
    beside = run.vru_position_m.copy()
    towards_sun = ahead_of(weather.sun_yaw_deg)
    beside[:, :2] += (2.5 + 0.5 * shadow_m) * towards_sun

    beside_vut = replace(run, vut_position_m=beside)
    near, _, _ = seen([beside_vut])
    key = near.key(0)

    assert key[-1] == 0  # a frame of its own


@pytest.mark.long
def test_the_shipped_network_finds_most_cyclists_that_are_50_px_high(
    runs, seen, larger
):
    pytest.importorskip("onnxruntime")
    by_name = {run.id: run for run in runs}
    run = by_name["CBLA/west/25"]
    last = slice(-14, None)
    some = cut_run(run, last)
    full = replace(larger, width_px=1920, height_px=1080)
    crops, _, evidence = seen([some], camera=full)

    is_high = box_height_px(evidence.visible_px) >= 50.0

    assert is_high.sum() >= 3

    detector = load_detector("cnn")
    shown = replace(evidence, crops=crops)
    rng = np.random.default_rng(0)
    found = detector.detect(shown, rng)

    matched = is_matched(found, evidence.visible_px, min_iou=load_min_iou())

    assert matched[is_high].mean() > 0.6
