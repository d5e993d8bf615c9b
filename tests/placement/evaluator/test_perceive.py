from dataclasses import replace

import numpy as np
import pytest
from ray_renderer import VRU, render_frame

from geometry.actors import MovingActor, PlacedActor, pick_actor
from geometry.catalogue import pick_camera
from geometry.errors import InputError
from geometry.poses import Pose, to_world
from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.surroundings import VutCamera, build_surroundings, find_sights

HOUSES = (
    ((8.0, 8.0, 0.0), (16.0, 16.0, 6.0)),
    ((-16.0, 7.0, 0.0), (-9.0, 14.0, 5.0)),
    ((9.0, -15.0, 0.0), (18.0, -9.0, 4.0)),
    ((2.0, -12.0, 0.0), (2.3, -6.0, 1.2)),  # a low wall
    ((-40.0, -40.0, -1.0), (40.0, 40.0, 0.0)),  # the ground
)
N_FRAMES = 90  # of the three runs below
MOUNTS = (
    Pose(position_m=np.array([-7.0, -7.0, 6.0]), yaw_deg=45.0, pitch_deg=-30.0),
    Pose(position_m=np.array([6.5, 6.5, 7.0]), yaw_deg=-135.0, pitch_deg=-35.0),
    Pose(position_m=np.array([0.0, -14.0, 2.5]), yaw_deg=95.0, pitch_deg=-10.0),
)


def _random_runs(build_run, rng, n_frames=N_FRAMES // 3):
    """An adult and a cyclist on their way among cars; some of their poses repeat."""
    car = PlacedActor(
        actor=pick_actor("parked-car-small", "test"),
        pose=Pose(position_m=np.array([3.0, 3.0, 0.0]), yaw_deg=10.0),
    )
    runs = []
    for name, obstruction in (("adult", ()), ("cyclist", ()), ("adult", (car,))):
        vru = np.column_stack(
            [
                rng.uniform(-7.0, 7.0, (n_frames, 2)),
                rng.uniform(-180.0, 180.0, n_frames),
            ]
        )
        vru[n_frames // 2 :] = vru[: n_frames // 2]
        vut = np.column_stack(
            [
                rng.uniform(-9.0, 9.0, (n_frames, 2)),
                rng.uniform(-180.0, 180.0, n_frames),
            ]
        )
        runs.append(build_run(pick_actor(name, "test"), vru, vut, obstruction))
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
    runs[1] = replace(runs[1], traffic=tuple(driving[:3]))
    return runs


def _rotated(pose, degrees, shift_m):
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    x, y, z = pose.position_m
    return Pose(
        position_m=np.array(
            [cos * x - sin * y + shift_m[0], sin * x + cos * y + shift_m[1], z]
        ),
        yaw_deg=pose.yaw_deg + degrees,
        pitch_deg=pose.pitch_deg,
    )


@pytest.fixture(scope="module")
def surroundings(build_scene, build_run):
    return build_surroundings(
        build_scene(*HOUSES), _random_runs(build_run, np.random.default_rng(7))
    )


@pytest.mark.parametrize(
    "mount",
    [MOUNTS[0], *(pytest.param(one, marks=pytest.mark.long) for one in MOUNTS[1:])],
)
def test_roadside_boxes_equal_the_plain_render_of_every_frame(
    surroundings, camera, mount
):
    boxes = perceive_frames(surroundings, (mount, camera))
    views = [
        render_frame(surroundings, frame, mount, camera) for frame in range(N_FRAMES)
    ]
    assert (boxes.amodal_px == [view.amodal_box_px for view in views]).all()
    assert (boxes.visible_px == [view.visible_box_px for view in views]).all()
    # Worth its while only if the VUT hides something somewhere.
    assert any(
        (boxes.visible_px[frame] != view.visible_box_px).any()
        for frame in range(N_FRAMES)
        for view in [render_frame(surroundings, frame, mount, camera, with_vut=False)]
    )


def test_vut_boxes_equal_the_plain_render_from_where_its_camera_is(
    surroundings, camera, vut
):
    vut_camera = VutCamera(
        camera=camera, ahead_per_half_length=0.8, up_per_half_height=1.3
    )
    boxes = perceive_frames(surroundings, vut_camera)
    mount = vut_camera.pose_on(vut)
    n_seen = 0
    for frame, (x, y, yaw, _) in enumerate(surroundings.vut_poses):
        pose = _rotated(mount, yaw, (x, y))
        view = render_frame(surroundings, frame, pose, camera, with_vut=False)
        assert np.abs(boxes.amodal_px[frame] - view.amodal_box_px).max() <= 1.0
        assert np.abs(boxes.visible_px[frame] - view.visible_box_px).max() <= 1.0
        n_seen += view.visible_box_px.any()
    assert n_seen >= 10


STUDY_POSES = (  # two of the study's RSUs
    Pose(position_m=np.array([-138.94, -11.56, 7.97]), yaw_deg=44.5, pitch_deg=-34.3),
    Pose(position_m=np.array([-138.94, -11.56, 7.97]), yaw_deg=20.0, pitch_deg=-12.0),
)


@pytest.mark.parametrize("pose", STUDY_POSES)
def test_boxes_and_shares_in_the_study_are_those_of_a_ray_per_pixel(study_runs, pose):
    """Every body and obstruction at full resolution, in frames all through the runs."""
    camera = pick_camera("carla-ncap-rgb", "test")
    surroundings = build_surroundings(load_study_scene(), study_runs)
    surroundings = surroundings.take(np.arange(0, len(surroundings.vru_poses), 5))
    evidence = perceive_frames(surroundings, (pose, camera))
    frames = np.flatnonzero(evidence.amodal_px.any(axis=1))
    assert len(frames) > 20
    for frame in frames.tolist():
        x_min, y_min, x_max, y_max = evidence.amodal_px[frame].astype(int).tolist()
        crop_px = (
            max(x_min - 5, 0),
            max(y_min - 5, 0),
            min(x_max + 5, camera.width_px),
            min(y_max + 5, camera.height_px),
        )
        view = render_frame(surroundings, frame, pose, camera, crop_px=crop_px)
        assert np.abs(evidence.amodal_px[frame] - view.amodal_box_px).max() <= 1.0
        assert np.abs(evidence.visible_px[frame] - view.visible_box_px).max() <= 1.0
        share = (view.instance == VRU).sum() / view.amodal_mask.sum()
        assert evidence.visible_share[frame] == pytest.approx(share, abs=0.01)
    assert (evidence.visible_share[frames] < 1.0).any()


def test_frames_taken_one_by_one_give_the_same_boxes(surroundings, camera):
    together = perceive_frames(surroundings, (MOUNTS[0], camera))
    for frame in range(0, N_FRAMES, 7):
        alone = perceive_frames(
            surroundings.take(np.array([frame])), (MOUNTS[0], camera)
        )
        assert np.array_equal(alone.amodal_px[0], together.amodal_px[frame])
        assert np.array_equal(alone.visible_px[0], together.visible_px[frame])
        assert alone.visible_share[0] == together.visible_share[frame]


def test_sights_are_equal_where_all_but_the_vut_is_at_the_same_place():
    static_index = np.array([1, 0, 0, 0, 1])
    vru_index = np.array([0, 0, 1, 0, 0])
    static_poses = np.tile([3.0, -1.0, 0.0], (5, 1))
    vru_poses = np.tile([1.0, 2.0, 90.0], (5, 1))
    vru_poses[4, 0] += 1e-8
    vru_poses[3, 1] += 1e-5
    sights = find_sights(static_index, vru_index, static_poses, vru_poses)
    assert np.unique(sights[[1, 3, 2, 0]], return_inverse=True)[1].tolist() == [
        0,
        1,
        2,
        3,
    ]
    assert sights[0] == sights[4]


def test_obstruction_hides_in_its_own_run_only(build_scene, build_run, camera, block):
    wall = PlacedActor(
        actor=pick_actor("parked-car-large", "test"),
        pose=Pose(position_m=np.array([5.0, 0.0, 0.0]), yaw_deg=90.0),
    )
    runs = [
        build_run(block, [[9.0, 0.0, 0.0]]),
        build_run(block, [[9.0, 0.0, 0.0]], obstruction=(wall,)),
    ]
    boxes = perceive_frames(
        build_surroundings(build_scene(), runs),
        (Pose(position_m=np.array([0.0, 0.0, 1.0]), yaw_deg=0.0), camera),
    )
    assert (boxes.amodal_px[0] == boxes.amodal_px[1]).all()
    assert (boxes.visible_px[0] == boxes.amodal_px[0]).all()
    assert boxes.visible_px[1, 3] < boxes.amodal_px[1, 3]


def test_each_frame_shows_its_own_shape(build_scene, build_run, camera):
    """Seen from the side, the gait's own widths: the same place, one frame per
    shape.
    """
    adult = pick_actor("adult", "test")
    run = build_run(adult, [[8.0, 0.0, 90.0]] * len(adult.shapes))
    surroundings = build_surroundings(build_scene(), [run])
    assert len(surroundings.vrus) == len(adult.shapes)
    mount = Pose(position_m=np.array([0.0, 0.0, 1.0]), yaw_deg=0.0)
    boxes = perceive_frames(surroundings, (mount, camera))
    here = Pose(position_m=np.array([8.0, 0.0, 0.0]), yaw_deg=90.0)
    for box, shape in zip(boxes.amodal_px, adult.shapes, strict=True):
        pixels = project_points(to_world(shape.vertices_m, here), mount, camera)[:, :2]
        assert np.abs(box - [*pixels.min(axis=0), *pixels.max(axis=0)]).max() <= 1.0
    width_px = boxes.amodal_px[:, 2] - boxes.amodal_px[:, 0]
    assert width_px.max() > 1.5 * width_px.min()


def test_equal_obstructions_are_one_static_world(build_scene, build_run, block):
    def park(x_m):
        pose = Pose(position_m=np.array([x_m, 2.0, 0.0]), yaw_deg=5.0)
        return (PlacedActor(actor=pick_actor("parked-van", "test"), pose=pose),)

    runs = [
        build_run(block, [[9.0, 0.0, 0.0]], obstruction=obstruction)
        for obstruction in (park(3.0), (), park(3.0), park(3.5))
    ]
    surroundings = build_surroundings(build_scene(), runs)
    assert len(surroundings.statics) == 3
    assert surroundings.static_index.tolist() == [0, 1, 0, 2]


def test_vru_ahead_of_the_vut_is_in_the_middle_of_its_image(
    build_scene, build_run, camera, block
):
    vut_camera = VutCamera(
        camera=camera, ahead_per_half_length=0.8, up_per_half_height=1.3
    )
    yaw_deg = np.array([0.0, 77.0, -160.0])
    ahead = np.column_stack([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))])
    vut_poses = np.column_stack([[3.0, -20.0, 40.0], [5.0, 1.0, -6.0], yaw_deg])
    vru_poses = np.column_stack([vut_poses[:, :2] + 12.0 * ahead, yaw_deg])
    surroundings = build_surroundings(
        build_scene(), [build_run(block, vru_poses, vut_poses)]
    )
    boxes = perceive_frames(surroundings, vut_camera)
    lens_distance_m = 12.0 - 0.8 * 2.446 - 0.25
    height_px = camera.focal_length_px * 1.8 / lens_distance_m
    assert np.allclose(boxes.amodal_px[:, [0, 2]].mean(axis=1), 160.0, atol=1.0)
    assert np.allclose(
        boxes.amodal_px[:, 3] - boxes.amodal_px[:, 1], height_px, atol=1.5
    )
    below_px = camera.focal_length_px * 1.3 * 0.755 / lens_distance_m
    assert np.allclose(boxes.amodal_px[:, 3], 90.0 + below_px, atol=1.5)
    assert (boxes.visible_px == boxes.amodal_px).all()


def test_too_low_vrus_are_left_out_and_all_others_unchanged(surroundings, camera):
    every = perceive_frames(surroundings, (MOUNTS[0], camera))
    high = perceive_frames(surroundings, (MOUNTS[0], camera), min_height_px=25.0)
    height_px = every.amodal_px[:, 3] - every.amodal_px[:, 1]
    is_high = height_px >= 25.0
    assert is_high.any()
    assert not is_high.all()
    assert (high.amodal_px[is_high] == every.amodal_px[is_high]).all()
    assert (high.visible_px[is_high] == every.visible_px[is_high]).all()
    assert not high.visible_px[height_px < 18.0].any()


@pytest.mark.parametrize(
    ("degrees", "shift_m"), [(90.0, (0.0, 0.0)), (37.0, (150.0, -80.0))]
)
def test_boxes_do_not_depend_on_where_north_and_the_origin_are(
    build_scene, build_run, camera, degrees, shift_m
):
    runs = _random_runs(build_run, np.random.default_rng(3), n_frames=20)
    scene = build_scene(*HOUSES)
    turned_scene = _turned_scene(scene, degrees, shift_m)
    turned_runs = [_turned_run(build_run, run, degrees, shift_m) for run in runs]
    vut_camera = VutCamera(
        camera=camera, ahead_per_half_length=0.8, up_per_half_height=1.3
    )
    here = build_surroundings(scene, runs)
    there = build_surroundings(turned_scene, turned_runs)
    pairs = [
        (
            perceive_frames(here, (MOUNTS[1], camera)),
            perceive_frames(there, (_rotated(MOUNTS[1], degrees, shift_m), camera)),
        ),
        (perceive_frames(here, vut_camera), perceive_frames(there, vut_camera)),
    ]
    for a, b in pairs:
        assert np.abs(a.amodal_px - b.amodal_px).max() <= 1.0
        assert np.abs(a.visible_px - b.visible_px).max() <= 1.0


def test_mirrored_world_gives_mirrored_boxes(build_scene, build_run, camera, block):
    rng = np.random.default_rng(5)
    flip = np.array([1.0, -1.0, -1.0])
    vru, vut = (
        np.column_stack(
            [rng.uniform(-7.0, 7.0, (20, 2)), rng.uniform(-180.0, 180.0, 20)]
        )
        for _ in range(2)
    )
    mirrored_houses = [
        ((low[0], -high[1], low[2]), (high[0], -low[1], high[2]))
        for low, high in HOUSES
    ]
    mount = MOUNTS[0]
    mirrored_mount = Pose(
        position_m=mount.position_m * [1.0, -1.0, 1.0],
        yaw_deg=-mount.yaw_deg,
        pitch_deg=mount.pitch_deg,
    )
    boxes = perceive_frames(
        build_surroundings(build_scene(*HOUSES), [build_run(block, vru, vut)]),
        (mount, camera),
    )
    mirrored = perceive_frames(
        build_surroundings(
            build_scene(*mirrored_houses), [build_run(block, vru * flip, vut * flip)]
        ),
        (mirrored_mount, camera),
    )
    is_there = boxes.amodal_px.any(axis=1)
    assert is_there.any()
    for a, b in (
        (boxes.amodal_px, mirrored.amodal_px),
        (boxes.visible_px, mirrored.visible_px),
    ):
        flipped = np.column_stack([320.0 - b[:, 2], b[:, 1], 320.0 - b[:, 0], b[:, 3]])
        flipped[~b.any(axis=1)] = 0.0
        assert np.abs(a - flipped).max() <= 1.0


def test_two_vuts_are_refused(build_scene, build_run, block):
    run = build_run(block, [[0.0, 0.0, 0.0]])
    other = replace(run, encounter=replace(run.encounter, vut=block))
    with pytest.raises(
        InputError, match=r"runs: VUT: got .*; expected the same vehicle"
    ):
        build_surroundings(build_scene(), [run, other])


def _turned_scene(scene, degrees, shift_m):
    turned = [
        _rotated(Pose(position_m=vertex, yaw_deg=0.0), degrees, shift_m).position_m
        for vertex in scene.vertices_m
    ]
    return replace(scene, vertices_m=np.array(turned))


def _turned_run(build_run, run, degrees, shift_m):
    def turn(position_m, yaw_deg):
        poses = [
            _rotated(
                Pose(position_m=np.array([x, y, 0.0]), yaw_deg=yaw), degrees, shift_m
            )
            for (x, y), yaw in zip(position_m, yaw_deg, strict=True)
        ]
        return [[*pose.position_m[:2], pose.yaw_deg] for pose in poses]

    def turn_body(body):
        poses = np.array(turn(np.nan_to_num(body.position_m), body.yaw_deg))
        position_m = np.where(body.is_there[:, None], poses[:, :2], np.nan)
        return MovingActor(actor=body.actor, position_m=position_m, yaw_deg=poses[:, 2])

    turned = build_run(
        run.encounter.vru,
        turn(run.vru_position_m, run.vru_yaw_deg),
        turn(run.vut_position_m, run.vut_yaw_deg),
        tuple(
            PlacedActor(actor=body.actor, pose=_rotated(body.pose, degrees, shift_m))
            for body in run.obstruction
        ),
    )
    return replace(turned, traffic=tuple(turn_body(body) for body in run.traffic))
