"""Boxes through lenses: by brute force over every pixel, and against pinholes and the
table.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from lens_cameras import random_camera
from numpy.random import default_rng
from placed_bodies import ahead_of, parked_at, poses_within

from geometry.actors import MovingActor, pick_actor
from geometry.lenses import BrownConrady, Fisheye
from geometry.poses import Pose, camera_rotation
from geometry.sensors import SEEN_RAD, is_shown, project_points
from placement.evaluator.perceive import perceive_frames
from placement.evaluator.surroundings import build_surroundings

HOUSES = (
    ((8.0, 8.0, 0.0), (16.0, 16.0, 6.0)),
    ((-16.0, 7.0, 0.0), (-9.0, 14.0, 5.0)),
    ((2.0, -12.0, 0.0), (2.3, -6.0, 1.2)),  # a low wall
)
MOUNT = Pose(position_m=[-7.0, -7.0, 6.0], yaw_deg=45.0, pitch_deg=-30.0)


def made_runs(build_run, rng, n_frames=24):
    """An adult and a cyclist who jump about, with a car that parks, one that drives and
    the VUT.
    """
    car = parked_at("parked-car-small", 1.0, 1.0, 10.0)
    runs = []
    for name, obstruction in (
        ("adult", (car,)),
        ("cyclist", ()),
    ):
        vru = poses_within(rng, n_frames, 6.0)
        vut = poses_within(rng, n_frames, 6.0)
        driven = poses_within(rng, n_frames, 6.0)
        run = build_run(
            pick_actor(name, "test"),
            vru,
            vut,
            obstruction,
        )
        van = MovingActor(
            actor=pick_actor("parked-van", "test"),
            position_m=driven[:, :2],
            yaw_deg=driven[:, 2],
        )
        runs.append(replace(run, traffic=(van,)))

    return runs


@pytest.fixture(scope="module")
def runs(build_run):
    """Random runs among the houses."""
    return made_runs(build_run, default_rng(7))


@pytest.fixture(scope="module")
def scene(build_scene):
    """Houses around a square."""
    square = np.array(
        [
            [-20.0, -20.0],
            [20.0, -20.0],
            [20.0, 20.0],
            [-20.0, 20.0],
        ]
    )
    among_houses = build_scene(*HOUSES)
    return replace(among_houses, outline_m=square)


@pytest.fixture(scope="module")
def surroundings(scene, runs):
    """The runs in the scene."""
    return build_surroundings(scene, runs)


# ---------- brute force: every pixel, every triangle, rays by OpenCV


def opencv_rays(camera):
    """Rays (h, w, 2) of all pixels by OpenCV's undistortion; NaN where it finds
    none.
    """
    indices = np.indices((camera.height_px, camera.width_px))
    rows, columns = indices + 0.5
    places = np.stack([columns, rows], axis=-1)
    pixels = places.reshape(-1, 1, 2)
    fx = camera.focal_length_px
    x, y = camera.principal_point
    K = np.array(
        [
            [fx, 0.0, x * camera.width_px],
            [0.0, fx * camera.pixel_aspect, y * camera.height_px],
            [0.0, 0.0, 1.0],
        ]
    )
    lens = camera.lens
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-13)
    if isinstance(lens, Fisheye):
        terms = np.array([lens.k1, lens.k2, lens.k3, lens.k4])
        found = cv2.fisheye.undistortPoints(pixels, K, terms, criteria=criteria)[:, 0]
        again = cv2.fisheye.distortPoints(found[:, None], K, terms)[:, 0]
    else:
        terms = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
        found = cv2.undistortPoints(pixels, K, terms, criteria=criteria)[:, 0]
        depth = np.ones(len(found))
        points = np.column_stack([found, depth])
        still = np.zeros(3)
        projected = cv2.projectPoints(points, still, still, K, terms)
        again = projected[0][:, 0]

    # Where projecting again leads elsewhere, nothing was found.
    off_px = np.abs(again - pixels[:, 0])
    is_found = off_px.max(axis=1) < 1e-6
    away = np.hypot(*found.T)
    seen_reach = np.tan(SEEN_RAD)
    furthest = min(lens.reach, seen_reach)
    is_found &= away < furthest
    found[~is_found] = np.nan

    roll = np.radians(camera.roll_deg)
    cos = np.cos(roll)
    sin = np.sin(roll)
    right = cos * found[:, 0] - sin * found[:, 1]
    down = sin * found[:, 0] + cos * found[:, 1]
    level = np.stack([right, down], axis=-1)
    return level.reshape(camera.height_px, camera.width_px, 2)


def depths(ways, near, corners):
    """Depths (n,) at which rays (n, 3), one deep, first meet triangles (m, 3, 3), by
    Cramer.
    """
    first = np.full(len(ways), np.inf)
    lengths = np.linalg.norm(ways, axis=1)[:, None]
    is_ahead = (corners[..., 2] > 0.0).any(axis=1)
    corners = corners[is_ahead]
    n_pairs = len(ways) * len(corners)
    n_parts = 1 + n_pairs // 200_000

    parts = np.array_split(corners, n_parts)
    for a, b, c in (np.moveaxis(part, 1, 0) for part in parts):
        # (ways x (c - a)) . x is ways . ((c - a) x x)
        q = np.cross(-a, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            normals = np.cross(c - a, b - a)
            volume = ways @ normals.T
            shifted = np.cross(c - a, a)
            u = -(ways @ shifted.T) / volume
            v = (ways @ q.T) / volume
            reached = ((c - a) * q).sum(axis=1)
            t = reached / volume
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t * lengths >= near)
        met = np.where(hit, t, np.inf)
        nearest = met.min(axis=1, initial=np.inf)
        first = np.minimum(first, nearest)

    return first


def corners_in_camera(solid, road_pose, pose):
    """Corners (m, 3, 3) of a body at x, y, yaw and height, in the camera's frame."""
    x, y, yaw, up = road_pose
    yaw_rad = np.radians(yaw)
    cos = np.cos(yaw_rad)
    sin = np.sin(yaw_rad)
    turn = np.array(
        [
            [cos, -sin, 0.0],
            [sin, cos, 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    parts = [mesh.vertices_m[mesh.triangles] for mesh in solid.meshes]
    corners = np.concatenate(parts)
    world = corners @ turn.T + [x, y, up]
    R_world_camera = camera_rotation(pose.yaw_deg, pose.pitch_deg)
    return (world - pose.position_m) @ R_world_camera


def others_of(surroundings, frame):
    """Bodies beside the VRU, and where they stand in a frame."""
    static = surroundings.statics[surroundings.static_index[frame]]
    found = [
        (static, surroundings.static_poses[frame]),
        (surroundings.vehicles[0], surroundings.vut_poses[frame]),
    ]
    kinds = surroundings.traffic_index[frame]
    places = surroundings.traffic_poses[frame]
    for kind, place in zip(kinds, places, strict=True):
        found.append((surroundings.vehicles[kind], place))

    return found


def box_of(picture):
    """Box of the pixels that are true; zeros where none is. [px]"""
    rows, columns = np.nonzero(picture)
    if len(rows) == 0:
        return np.zeros(4)
    return np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "seed"),
    [
        ("brown-conrady", 0),
        ("fisheye", 1),
    ],
)
def test_boxes_are_those_of_brute_force(surroundings, camera, model, seed):
    rng = default_rng(seed)
    small_plain = replace(camera, width_px=72, height_px=54)
    small = random_camera(rng, small_plain, model)
    rays = opencv_rays(small)
    lit = np.isfinite(rays[..., 0])
    depth_ahead = np.ones(lit.sum())
    ways = np.column_stack([rays[lit], depth_ahead])
    n_seen = 0
    n_hidden = 0

    evidence = perceive_frames(surroundings, (MOUNT, small))

    for frame in range(0, 48, 2):
        vru = surroundings.vrus[surroundings.vru_index[frame]]
        body = corners_in_camera(vru, surroundings.vru_poses[frame], MOUNT)
        depth = depths(ways, small.near_m, body)
        hit = np.isfinite(depth)
        before = np.full(len(ways), np.inf)
        if hit.any():
            for solid, place in others_of(surroundings, frame):
                corners = corners_in_camera(solid, place, MOUNT)
                nearer = depths(ways[hit], small.near_m, corners)
                before[hit] = np.minimum(before[hit], nearer)

        is_visible = hit & ~(before < depth - 1e-3)
        for name, mask in (
            ("amodal_px", hit),
            ("visible_px", is_visible),
        ):
            picture = np.zeros(lit.shape, dtype=bool)
            picture[lit] = mask
            expected = box_of(picture)
            found = getattr(evidence, name)
            off = np.abs(found[frame] - expected)

            # A middle that rounding puts on either side of an edge moves a side by a
            # pixel.
            assert off.max() <= 1.0

            n_seen += picture.any()
            n_hidden += off.any()

    assert n_seen > 12
    assert n_hidden <= 6


# ---------- pinholes


def test_a_lens_of_zeros_has_the_pinholes_bits(surroundings, camera):
    plain = perceive_frames(surroundings, (MOUNT, camera))
    zero = replace(
        camera,
        lens=BrownConrady(),
        principal_point=(0.5, 0.5),
        pixel_aspect=1.0,
    )

    bent = perceive_frames(surroundings, (MOUNT, zero))

    for name in ("amodal_px", "visible_px", "visible_share", "inside_share"):
        expected = getattr(plain, name)
        found = getattr(bent, name)
        assert np.array_equal(found, expected)


# ---------- table and evaluator


def test_what_lies_beyond_the_fold_is_not_shown(camera):
    lens = Fisheye(k1=-0.2)
    folds = replace(camera, lens=lens, horizontal_fov_deg=110.0)
    ahead = ahead_of([0.0, 70.0, 75.0])
    columns_ahead = [ahead, np.zeros(3)]
    far = 10.0 * np.column_stack(columns_ahead)
    level = Pose(position_m=[0.0, 0.0, 0.0], yaw_deg=0.0)

    projected = project_points(far, level, folds)
    shown = projected[:, 0]
    turn_deg = np.degrees((1.0 / 0.6) ** 0.5)  # angle - 0.2 angle^3 stops rising
    tangent = np.tan(np.radians(73.9))
    before_the_turn = np.array([[tangent, 0.0]])
    is_seen = np.isfinite(shown).tolist()

    assert turn_deg == pytest.approx(73.97, abs=0.01)
    assert is_seen == [True, True, False]
    assert is_shown(before_the_turn, folds).all()
