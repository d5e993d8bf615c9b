"""Pictures of frames, and boxes that are found in them."""

from dataclasses import replace

import numpy as np
import pytest
from kept_backdrops import CORNER, kept_backdrop
from numpy.testing import assert_allclose
from short_runs import cut_run

from geometry.image_boxes import iou
from geometry.study_scene import load_study_scene
from geometry.weather import pick_weather
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.detectors import load_detector
from placement.evaluator.evaluate import evaluate_layout
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.pictures import RenderedPictures, vut_camera_pose
from placement.evaluator.surroundings import build_surroundings, load_vut_camera
from placement.imaging import build_backdrop, draw_picture
from placement.layout import Layout

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import parser  # noqa: E402

PEDESTRIAN = "CPNC-50/west/30"
CYCLIST = "CBLA/west/25"
N_FRAMES = 5


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
    """Runs by name, cut to what happens right before the impact."""
    by_name = {run.id: run for run in runs}

    def cut(*names, n_frames=N_FRAMES):
        return [cut_run(by_name[name], slice(-n_frames, None)) for name in names]

    return cut


@pytest.fixture
def evaluate(tmp_path, build_setting, scene, camera):
    """Detected frames of one RSU and of the VUT, when a network looks from both."""

    def evaluate_with(model, runs):
        onnx.save(model, tmp_path / "x.onnx")
        detector = load_detector(str(tmp_path / "x.onnx"))
        setting = build_setting(
            scene,
            runs,
            detector=detector,
            vut_camera=camera,
        )
        unit = CandidatePose(
            id="rsu",
            site_id="",
            pose=CORNER,
            sensor=camera,
        )
        evaluation = evaluate_layout(Layout(name="test", units=(unit,)), setting)
        return evaluation.units["rsu"].detected, evaluation.vut.detected

    return evaluate_with


@pytest.fixture
def visible(scene, camera):
    """Visible boxes from the RSU and from the VUT."""

    def boxes_of(runs):
        surroundings = build_surroundings(scene, runs)
        mount = replace(load_vut_camera(), camera=camera)
        return (
            perceive_frames(surroundings, (CORNER, camera)).visible_px,
            perceive_frames(surroundings, mount).visible_px,
        )

    return boxes_of


def build_network(box):
    """Torchvision's outputs: always a person in the same box."""
    corners = ", ".join(f"{float(corner)!r}" for corner in box)
    return parser.parse_model(
        f"""<ir_version: 9, opset_import: ["": 17]>
        tiny (float[batch, 3, height, width] images)
        => (float[] boxes, int64[] labels, float[] scores)
        <float[1, 4] box = {{{corners}}}, int64[1] person = {{1}},
        float[1] sure = {{0.75}}> {{
            boxes = Identity(box)
            labels = Identity(person)
            scores = Identity(sure)
        }}"""
    )


def render(scene, run, frame, pose, camera, **options):
    """The picture of one frame in the weather of its run."""
    weather = pick_weather(run.weather, "test")
    backdrop = build_backdrop(scene, run.obstruction)
    return draw_picture(
        backdrop, run, frame, pose, camera, weather=weather, **options
    ).rgb


# Networks.


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "unit"),
    [
        (PEDESTRIAN, 0),
        (CYCLIST, 1),
    ],
)
def test_one_box_is_matched_in_the_frames_whose_visible_box_it_overlaps_by_half(
    name, unit, last_frames, visible, evaluate
):
    runs = last_frames(name)
    boxes = visible(runs)
    box = boxes[unit][0]

    expected = [iou(seen, box) > 0.5 for seen in boxes]

    assert 1 < expected[unit].sum() < N_FRAMES

    detected = evaluate(build_network(box), runs)

    assert [frames.tolist() for frames in detected] == [
        frames.tolist() for frames in expected
    ]


# Pictures.


@pytest.fixture(scope="module")
def tiny(camera):
    """The camera with 160 by 90 pixels."""
    return replace(camera, width_px=160, height_px=90)


@pytest.mark.long
def test_pictures_are_those_of_the_run_and_frame_that_lie_at_an_index(
    last_frames, scene, tiny
):
    first, second = last_frames(PEDESTRIAN, CYCLIST)
    second = replace(second, weather="night", obstruction=())
    source = RenderedPictures(scene, [first, second], seed=5)
    mount = replace(load_vut_camera(), camera=tiny)

    for index, run, frame in (
        (N_FRAMES - 1, first, N_FRAMES - 1),
        (N_FRAMES, second, 0),
        (2 * N_FRAMES - 1, second, N_FRAMES - 1),
    ):
        by_rsu = render(
            scene,
            run,
            frame,
            CORNER,
            tiny,
            compute=Compute(seed=5),
        )

        assert np.array_equal(source.pictures((CORNER, tiny))(index), by_rsu)

        pose = vut_camera_pose(mount, run, frame)
        by_vut = render(
            scene,
            run,
            frame,
            pose,
            tiny,
            compute=Compute(seed=5),
            with_vut=False,
        )

        assert np.array_equal(source.pictures(mount)(index), by_vut)


@pytest.mark.long
def test_each_run_is_drawn_behind_its_own_obstruction(last_frames, scene, tiny):
    (hidden,) = last_frames(PEDESTRIAN, n_frames=1)
    free = replace(hidden, obstruction=())

    picture = RenderedPictures(scene, [hidden, free, hidden], seed=0).pictures(
        (CORNER, tiny)
    )

    assert np.array_equal(picture(0), picture(2))
    assert not np.array_equal(picture(0), picture(1))


def test_the_vuts_camera_goes_and_turns_with_it(last_frames, tiny):
    (run,) = last_frames(CYCLIST)
    mount = replace(load_vut_camera(), camera=tiny)
    on_vut = mount.pose_on(run.encounter.vut)
    ahead_m, left_m, up_m = on_vut.position_m

    for frame in (0, N_FRAMES - 1):
        yaw = np.radians(run.vut_yaw_deg[frame])
        along = np.array([np.cos(yaw), np.sin(yaw)])
        across = np.array([-np.sin(yaw), np.cos(yaw)])
        expected = run.vut_position_m[frame] + ahead_m * along + left_m * across

        pose = vut_camera_pose(mount, run, frame)

        assert_allclose(pose.position_m, [*expected, up_m], atol=1e-9)
        assert pose.yaw_deg == run.vut_yaw_deg[frame] + on_vut.yaw_deg
        assert pose.pitch_deg == on_vut.pitch_deg
