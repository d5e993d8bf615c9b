"""Bodies drawn into pixels, against pinholes by hand and rays one by one."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from ray_renderer import build_lens, cast_crops, render_frame
from tiny_cameras import tiny_camera

from geometry.actors import pick_actor
from geometry.poses import Pose
from placement.evaluator.perceive import _place, perceive_frames
from placement.evaluator.pixels import (
    Image,
    build_tree,
    draw,
    find_box,
    find_crop,
)
from placement.evaluator.surroundings import (
    BodyMesh,
    build_body,
    build_surroundings,
)

LEVEL = Pose(position_m=[0.0, 0.0, 0.9], yaw_deg=0.0)
ADULT = build_body(pick_actor("adult", "test").shapes[0])
TINY = tiny_camera(64, 48, fov_deg=100.0)


@pytest.fixture(params=["triangles drawn", "a ray per pixel"])
def look(request, build_run, camera, build_scene):
    """Amodal and visible box of a VRU in one frame, by the evaluator and by its
    oracle.
    """

    def boxes(
        vru,
        vru_pose,
        *,
        walls=(),
        vut_pose=None,
        obstruction=(),
        lens=LEVEL,
        near_m=0.35,
    ):
        if vut_pose is None:
            vut_poses = None
        else:
            vut_poses = [vut_pose]

        surroundings = build_surroundings(
            build_scene(*walls), [build_run(vru, [vru_pose], vut_poses, obstruction)]
        )
        model = replace(camera, near_m=near_m)
        if request.param == "a ray per pixel":
            view = render_frame(surroundings, 0, lens, model)
            return view.amodal_box_px, view.visible_box_px

        evidence = perceive_frames(surroundings, (lens, model))
        return evidence.amodal_px[0], evidence.visible_px[0]

    return boxes


# ---------- boxes of one frame, in closed form


@pytest.mark.parametrize("distance_m", [2.0, 5.0, 12.0, 30.0])
def test_unobstructed_vru_has_the_pinhole_size(look, camera, block, distance_m):
    amodal, visible = look(block, [distance_m, 0.0, 0.0])
    x_min, y_min, x_max, y_max = amodal

    assert (visible == amodal).all()

    scale = camera.focal_length_px / (distance_m - 0.25)
    width_px = min(1.0 * scale, camera.width_px)
    height_px = min(1.8 * scale, camera.height_px)

    assert x_max - x_min == pytest.approx(width_px, abs=1.5)
    assert y_max - y_min == pytest.approx(height_px, abs=1.5)


@pytest.mark.parametrize(
    ("low", "high", "side"),
    [
        # The wall's right edge is ahead: left half hidden.
        ((5.0, 0.0, 0.0), (6.0, 9.0, 9.0), 0),
        ((5.0, -9.0, 0.0), (6.0, 0.0, 9.0), 2),
        ((5.0, -9.0, 0.0), (6.0, 9.0, 0.9), 3),  # its top is as high as the lens
        ((5.0, -9.0, 0.9), (6.0, 9.0, 9.0), 1),
    ],
)
def test_wall_up_to_the_optical_axis_halves_the_box(
    look,
    camera,
    block,
    low,
    high,
    side,
):
    amodal, visible = look(block, [10.0, 0.0, 0.0], walls=[(low, high)])
    expected = amodal.copy()
    expected[side] = 0.5 * (camera.width_px if side % 2 == 0 else camera.height_px)
    off_px = np.abs(visible - expected)

    assert off_px.max() <= 1.0
    assert not (visible == amodal).all()


@pytest.mark.parametrize(
    ("near_m", "is_drawn"),
    [
        (0.35, False),
        (0.2, True),
    ],
)
def test_nothing_is_drawn_nearer_than_the_nearest_distance(
    look, block, near_m, is_drawn
):
    plate = (
        (0.24, -0.05, 0.85),
        (0.26, 0.05, 0.95),
    )
    _, behind_plate = look(
        block,
        [10.0, 0.0, 0.0],
        walls=[plate],
        near_m=near_m,
    )

    assert behind_plate.any() != is_drawn

    (shape,) = block.shapes
    speck = replace(
        shape, vertices_m=shape.vertices_m * [0.04, 0.1, 0.02] + [0.0, 0.0, 0.88]
    )
    small_block = replace(block, shapes=(speck,))
    amodal, _ = look(small_block, [0.3, 0.0, 0.0], near_m=near_m)

    assert amodal.any() == is_drawn


# ---------- any triangles, anywhere

POINTS = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 12), st.just(3), st.just(3)),
    elements=st.floats(-4.0, 4.0, width=16),
)


def _drawn(corners_m, camera, window):
    """Depths of triangles (camera frame) in a window of the image, and the box of their
    pixels.

    Each has a front on either side: of closed bodies, which are drawn, no back is seen.
    """
    image = _image(camera)
    vertices_m = corners_m.reshape(-1, 3)
    points = np.ascontiguousarray(vertices_m.T)
    corners = np.arange(len(vertices_m))
    triangles = corners.reshape(-1, 3)
    turned = triangles[:, ::-1]
    triangles = np.concatenate([triangles, turned])
    n_rows = window[3] - window[1]
    n_columns = window[2] - window[0]
    depth = np.full((n_rows, n_columns), np.inf)
    flat_depth = depth.reshape(-1)
    draw(image, points, triangles, window, flat_depth)
    mesh = BodyMesh(vertices_m=vertices_m, triangles=triangles)
    skin = mesh.skin
    box = find_box(image, skin.vertices_m, skin, window)
    return depth, box


def _image(camera, up_m=0.0):
    """The camera's image, before anything is drawn."""
    return Image(
        camera.focal_length_px,
        camera.width_px,
        camera.height_px,
        camera.near_m,
        up_m,
    )


def _cast(corners_m, camera, window):
    """The same by rays in double precision, triangle by triangle [Moeller, Trumbore
    1997].
    """
    column_range = np.arange(window[0], window[2])
    row_range = np.arange(window[1], window[3])
    columns, rows = np.meshgrid(column_range, row_range, indexing="xy")
    ways = np.stack(
        [
            (columns + 0.5 - 0.5 * camera.width_px) / camera.focal_length_px,
            (rows + 0.5 - 0.5 * camera.height_px) / camera.focal_length_px,
            np.ones(columns.shape),
        ],
        axis=-1,
    )
    nearest = np.full(columns.shape, np.inf)
    is_sure = np.ones(columns.shape, dtype=bool)  # not within rounding of an edge

    for a, b, c in corners_m:
        across = np.cross(ways, c - a)
        scale = across @ (b - a)
        with np.errstate(all="ignore"):  # triangles without area: not sure
            u = across @ -a / scale
            turned = np.cross(-a, b - a)
            v = ways @ turned / scale
            along = np.dot(c - a, turned)
            depth = along / scale
            stretch = np.linalg.norm(ways, axis=-1)
            distance = depth * stretch
            is_hit = (
                (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance >= camera.near_m)
            )
            nearer = np.minimum(nearest, depth)
            nearest = np.where(is_hit, nearer, nearest)
            margin = np.min(
                np.abs([u, v, 1.0 - u - v, distance - camera.near_m]), axis=0
            )
            steepness = np.abs(scale)
            is_sure &= (margin > 1.0e-6) & (steepness > 1.0e-9)

    return nearest, is_sure


@pytest.mark.long
@given(
    corners_m=POINTS,
    window=st.sampled_from(
        [
            (0, 0, 64, 48),
            (10, 5, 40, 30),
            (63, 47, 64, 48),
        ]
    ),
)
def test_triangles_anywhere_are_drawn_as_rays_meet_them(corners_m, window):
    """Also those that reach behind the lens, and through the distance at which drawing
    starts.
    """
    depth, box = _drawn(corners_m, TINY, window)
    expected, is_sure = _cast(corners_m, TINY, window)

    assert np.allclose(depth[is_sure], expected[is_sure], rtol=1e-6)

    is_drawn = np.isfinite(depth)
    rows, columns = np.nonzero(is_drawn)
    if len(rows) == 0:
        assert box == (0, 0, 0, 0)
    else:
        assert box == (
            window[0] + columns.min(),
            window[1] + rows.min(),
            window[0] + columns.max() + 1,
            window[1] + rows.max() + 1,
        )


@given(corners_m=POINTS, n_copies=st.integers(1, 40))
def test_tree_holds_every_triangle_once_and_each_box_its_own(corners_m, n_copies):
    corners = np.tile(corners_m, (n_copies, 1, 1))
    rows = corners.reshape(-1, 9)
    expected = sorted(map(tuple, rows))

    tree = build_tree(corners)
    held = tree.corners_m.reshape(-1, 9)
    found = sorted(map(tuple, held))

    assert found == expected

    ranges = zip(tree.start, tree.end, strict=True)
    for node, (start, end) in enumerate(ranges):
        corners_there = tree.corners_m[start:end]
        own = corners_there.reshape(-1, 3)
        lowest_m = own.min(axis=0)
        highest_m = own.max(axis=0)

        assert (tree.low_m[node] == lowest_m).all()
        assert (tree.high_m[node] == highest_m).all()

        second = tree.second[node]
        if second >= 0:
            assert tree.start[node + 1] == start
            assert tree.end[node + 1] == tree.start[second]
            assert tree.end[second] == end

    assert tree.start[0] == 0
    assert tree.end[0] == n_copies * len(corners_m)


def test_tree_of_centres_that_halve_again_and_again_stays_shallow_enough():
    """A triangle at each power of two: every split in the middle takes off a single
    one.
    """
    corner = np.array(
        [
            [0.0, 0.0, 0.0],
            [1e-300, 0.0, 0.0],
            [0.0, 1e-300, 0.0],
        ]
    )
    corners_m = np.array(
        [corner + [2.0**power, 0.0, 0.0] for power in range(-1000, 1000)]
    )

    tree = build_tree(corners_m)

    first_m = corners_m[:, 0, 0]
    expected = sorted(first_m)
    first_held_m = tree.corners_m[:, 0, 0]

    assert sorted(first_held_m) == expected


# ---------- bodies


@pytest.mark.parametrize("left_m", [-6.0, 6.0])
def test_body_beside_the_lens_is_not_drawn_though_it_reaches_behind(
    camera, block, left_m
):
    body = build_body(block.shapes[0])
    for y_m, expected in (
        (left_m, (0, 0, 0, 0)),
        (0.0, (0, 0, camera.width_px, camera.height_px)),
    ):
        hull = _in_camera(body.hull_m, LEVEL, [0.0, y_m, 0.0, 0.0])
        crop = find_crop(_image(camera), hull, 0.0)

        assert hull[2].min() < 0.0
        assert crop == (expected, 0.0)


@given(
    ahead_m=st.floats(-2.0, 6.0),
    left_m=st.floats(-4.0, 4.0),
    up_m=st.floats(0.1, 4.0),
    yaw_deg=st.floats(-180.0, 180.0),
    pitch_deg=st.floats(-89.0, 30.0),
)
def test_crop_holds_every_pixel_of_the_body(ahead_m, left_m, up_m, yaw_deg, pitch_deg):
    pose = Pose(position_m=[0.0, 0.0, up_m], yaw_deg=0.0, pitch_deg=pitch_deg)
    road_pose = np.array([ahead_m, left_m, yaw_deg, 0.0])
    whole = np.array([[0, 0, TINY.width_px, TINY.height_px]])
    lens = build_lens(pose, TINY)
    crops = cast_crops(lens, ADULT, road_pose[None], whole)
    cast = crops[0]
    picture = cast.reshape(TINY.height_px, TINY.width_px)
    is_hit = np.isfinite(picture)

    (x_min, y_min, x_max, y_max), _ = find_crop(
        _image(TINY), _in_camera(ADULT.hull_m, pose, road_pose), 0.0
    )
    inside = is_hit[y_min:y_max, x_min:x_max]

    assert inside.sum() == is_hit.sum()


def _in_camera(points_m, pose, road_pose):
    """Points (n, 3) of a body in camera coordinates, (3, n). [m]"""
    poses = np.array([road_pose])
    no_height = np.zeros(1)
    placed = _place(pose, poses, no_height)
    turned_m = points_m @ placed.turn[0].T
    in_camera = turned_m + placed.shift[0]
    return np.ascontiguousarray(in_camera.T)


@pytest.mark.parametrize("name", ["adult", "child", "cyclist"])
@pytest.mark.parametrize("distance_m", [1.2, 3.0, 8.0])
def test_bodies_cover_the_pixels_that_rays_hit(name, distance_m, camera):
    """In single precision rays along a silhouette may go either way: some in ten
    thousand.
    """
    actor = pick_actor(name, "test")
    body = build_body(actor.shapes[0])
    (mesh,) = body.meshes
    pose = Pose(position_m=[0.0, 0.0, 1.4], yaw_deg=0.0, pitch_deg=-10.0)
    window = (0, 0, camera.width_px, camera.height_px)
    n_differ = 0
    n_hit = 0
    for yaw_deg in np.linspace(-170.0, 170.0, 7):
        road_pose = np.array([distance_m, 0.3, yaw_deg, 0.0])
        points = _in_camera(mesh.skin.vertices_m.T, pose, road_pose)
        depth = np.full(camera.width_px * camera.height_px, np.inf)

        draw(
            _image(camera, 1.4),
            points,
            mesh.skin.triangles,
            window,
            depth,
        )
        cast = cast_crops(
            build_lens(pose, camera),
            body,
            road_pose[None],
            np.array([window]),
        )[0]
        is_drawn = np.isfinite(depth)
        is_cast = np.isfinite(cast)
        n_differ += (is_drawn != is_cast).sum()
        n_hit += is_cast.sum()
        is_both = is_drawn & is_cast
        ratio = depth[is_both] / cast[is_both]
        is_close = np.abs(ratio - 1.0) < 1e-4

        # Two surfaces may lie one behind the other where an edge is met or missed.
        assert is_close.mean() > 0.999

    assert n_hit > 500
    assert n_differ <= 1e-3 * n_hit
