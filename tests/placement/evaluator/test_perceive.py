"""Boxes and shares that are perceived, against a ray for every pixel."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from placed_bodies import parked_at, poses_within
from ray_renderer import VRU, render_frame

from geometry.actors import MovingActor, pick_actor
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.surroundings import build_surroundings, find_sights

HOUSES = (
    ((8.0, 8.0, 0.0), (16.0, 16.0, 6.0)),
    ((-16.0, 7.0, 0.0), (-9.0, 14.0, 5.0)),
    ((9.0, -15.0, 0.0), (18.0, -9.0, 4.0)),
    ((2.0, -12.0, 0.0), (2.3, -6.0, 1.2)),  # a low wall
    ((-40.0, -40.0, -1.0), (40.0, 40.0, 0.0)),  # the ground
)
N_FRAMES = 90  # of the three runs below
MOUNTS = (
    Pose(position_m=[-7.0, -7.0, 6.0], yaw_deg=45.0, pitch_deg=-30.0),
    Pose(position_m=[6.5, 6.5, 7.0], yaw_deg=-135.0, pitch_deg=-35.0),
    Pose(position_m=[0.0, -14.0, 2.5], yaw_deg=95.0, pitch_deg=-10.0),
)


def _random_runs(build_run, rng, n_frames=N_FRAMES // 3):
    """An adult and a cyclist on their way among cars; some of their poses repeat."""
    car = parked_at("parked-car-small", 3.0, 3.0, 10.0)
    runs = []
    for name, obstruction in (
        ("adult", ()),
        ("cyclist", ()),
        ("adult", (car,)),
    ):
        vru = poses_within(rng, n_frames, 7.0)
        vru[n_frames // 2 :] = vru[: n_frames // 2]
        vut = poses_within(rng, n_frames, 9.0)
        run = build_run(
            pick_actor(name, "test"),
            vru,
            vut,
            obstruction,
        )
        runs.append(run)

    # Two vans and a car drive by in the second run; the car only in its first half.
    driving = []
    for kind, n_there in (
        ("parked-van", n_frames),
        ("parked-car-large", n_frames // 2),
    ) * 2:
        position = rng.uniform(-6.0, 6.0, (n_frames, 2))
        position[n_there:] = np.nan
        driving.append(
            MovingActor(
                actor=pick_actor(kind, "test"),
                position_m=position,
                yaw_deg=rng.uniform(-180.0, 180.0, n_frames),
            )
        )

    traffic = tuple(driving[:3])
    runs[1] = replace(runs[1], traffic=traffic)
    return runs


@pytest.fixture(scope="module")
def surroundings(build_scene, build_run):
    """Random runs among houses."""
    return build_surroundings(
        build_scene(*HOUSES), _random_runs(build_run, np.random.default_rng(7))
    )


@pytest.mark.long
@pytest.mark.parametrize("mount", MOUNTS)
def test_roadside_boxes_equal_the_plain_render_of_every_frame(
    surroundings, camera, mount
):
    boxes = perceive_frames(surroundings, (mount, camera))
    n_hidden_by_vut = 0

    for frame in range(0, N_FRAMES, 2):
        view = render_frame(surroundings, frame, mount, camera)
        free = render_frame(
            surroundings,
            frame,
            mount,
            camera,
            with_vut=False,
        )
        is_amodal_equal = boxes.amodal_px[frame] == view.amodal_box_px
        is_visible_equal = boxes.visible_px[frame] == view.visible_box_px

        assert is_amodal_equal.all()
        assert is_visible_equal.all()

        n_hidden_by_vut += (view.visible_box_px != free.visible_box_px).any()

    # Worth its while only if the VUT hides something somewhere.
    assert n_hidden_by_vut


STUDY_POSES = (  # two of the study's RSUs
    Pose(position_m=[-138.94, -11.56, 7.97], yaw_deg=44.5, pitch_deg=-34.3),
    Pose(position_m=[-138.94, -11.56, 7.97], yaw_deg=20.0, pitch_deg=-12.0),
)


@pytest.mark.long
@pytest.mark.parametrize("pose", STUDY_POSES)
def test_boxes_and_shares_in_the_study_are_those_of_a_ray_per_pixel(study_runs, pose):
    """Every body and obstruction at full resolution, in frames all through the runs."""
    camera = pick_camera("carla-ncap-rgb", "test")
    size_px = np.array([camera.width_px, camera.height_px])
    every = build_surroundings(load_study_scene(), study_runs)
    n_frames = len(every.vru_poses)
    surroundings = every.take(np.arange(0, n_frames, 5))

    evidence = perceive_frames(surroundings, (pose, camera))
    is_shown = evidence.amodal_px.any(axis=1)
    frames = np.flatnonzero(is_shown)

    assert len(frames) > 20

    for frame in frames.tolist():
        amodal_px = evidence.amodal_px[frame]
        low_corner = np.maximum(amodal_px[:2] - 5, 0)
        low_px = low_corner.astype(int)
        high_corner = np.minimum(amodal_px[2:] + 5, size_px)
        high_px = high_corner.astype(int)
        crop_px = (*low_px.tolist(), *high_px.tolist())
        view = render_frame(
            surroundings,
            frame,
            pose,
            camera,
            crop_px=crop_px,
        )
        n_visible = (view.instance == VRU).sum()
        n_amodal = view.amodal_mask.sum()
        share = n_visible / n_amodal
        amodal_off = np.abs(amodal_px - view.amodal_box_px)
        visible_off = evidence.visible_px[frame] - view.visible_box_px

        assert amodal_off.max() <= 1.0
        assert np.abs(visible_off).max() <= 1.0
        assert evidence.visible_share[frame] == pytest.approx(share, abs=0.01)

    is_hidden = evidence.visible_share[frames] < 1.0

    assert is_hidden.any()


def test_sights_are_equal_where_all_but_the_vut_is_at_the_same_place():
    static_index = np.array([1, 0, 0, 0, 1])
    vru_index = np.array([0, 0, 1, 0, 0])
    static_poses = np.tile([3.0, -1.0, 0.0], (5, 1))
    vru_poses = np.tile([1.0, 2.0, 90.0], (5, 1))
    vru_poses[4, 0] += 1e-8
    vru_poses[3, 1] += 1e-5

    sights = find_sights(
        static_index,
        vru_index,
        static_poses,
        vru_poses,
    )

    assert sights[1] < sights[3] < sights[2] < sights[0]
    assert sights[0] == sights[4]


def test_equal_obstructions_are_one_static_world(build_scene, build_run, block):
    van = parked_at("parked-van", 3.0, 2.0, 5.0)
    here = (van,)
    van_again = parked_at("parked-van", 3.0, 2.0, 5.0)
    again = (van_again,)
    van_elsewhere = parked_at("parked-van", 3.5, 2.0, 5.0)
    elsewhere = (van_elsewhere,)
    runs = [
        build_run(block, [[9.0, 0.0, 0.0]], obstruction=obstruction)
        for obstruction in (here, (), again, elsewhere)
    ]

    surroundings = build_surroundings(build_scene(), runs)

    assert len(surroundings.statics) == 3
    assert surroundings.static_index.tolist() == [0, 1, 0, 2]


def test_too_low_vrus_are_left_out_and_all_others_unchanged(surroundings, camera):
    every = perceive_frames(surroundings, (MOUNTS[0], camera))

    high = perceive_frames(surroundings, (MOUNTS[0], camera), min_height_px=25.0)
    height_px = every.amodal_px[:, 3] - every.amodal_px[:, 1]
    is_high = height_px >= 25.0
    is_amodal_equal = high.amodal_px[is_high] == every.amodal_px[is_high]
    is_visible_equal = high.visible_px[is_high] == every.visible_px[is_high]
    lowest = high.visible_px[height_px < 18.0]

    assert is_high.any()
    assert not is_high.all()
    assert is_amodal_equal.all()
    assert is_visible_equal.all()
    assert not lowest.any()


def test_two_vuts_are_refused(build_scene, build_run, block):
    run = build_run(block, [[0.0, 0.0, 0.0]])
    other = changed(run, "encounter.vut", block)

    with pytest.raises(
        InputError, match=r"runs: VUT: got .*; expected the same vehicle"
    ):
        build_surroundings(build_scene(), [run, other])
