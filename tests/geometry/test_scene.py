import dataclasses
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from strategies import angles_deg, numbers, points_m

from geometry.actors import load_actors
from geometry.errors import InputError
from geometry.poses import Pose, to_world
from geometry.scene import CLASS_NAMES, Instance, Lane, Scene, Site, containing_instance

SITE = {
    "id": "pole",
    "position_m": [1.0, 2.0, 0.0],
    "kind": "lamp post",
    "height_range_m": [4.0, 8.0],
    "capacity_units": 2,
}


def _scene(*bodies) -> Scene:
    """A scene of (class name, vertices, triangles)."""
    first = np.cumsum([0, *(len(vertices) for _, vertices, _ in bodies)])
    empty = (np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    return Scene(
        name="junction",
        vertices_m=np.concatenate([empty[0], *(vertices for _, vertices, _ in bodies)]),
        triangles=np.concatenate(
            [empty[1], *(t + n for (_, _, t), n in zip(bodies, first, strict=False))]
        ),
        triangle_instance=np.repeat(
            np.arange(len(bodies)), [len(t) for _, _, t in bodies]
        ),
        instances=tuple(
            Instance(id=f"body-{index}", class_name=name)
            for index, (name, _, _) in enumerate(bodies)
        ),
        sites=(Site(**SITE),),
        outline_m=np.zeros((0, 2)),
        lanes=(),
        crs="EPSG:25832",
    )


def _box(size_m, pose, class_name="building"):
    mesh = trimesh.creation.box(size_m)
    return (
        class_name,
        to_world(mesh.vertices + [0, 0, 0.5 * size_m[2]], pose),
        mesh.faces,
    )


def _message(function, *arguments, **fields) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments, **fields)
    return str(caught.value)


# Values


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"position_m": [1.0, 2.0]},
            "site pole.position_m: got shape (2,); expected shape (3,)",
        ),
        (
            {"position_m": [1.0, 2.0, math.nan]},
            "site pole.position_m: got [1.0, 2.0, nan]; expected finite numbers",
        ),
        *(
            (
                {"height_range_m": pair},
                (
                    f"site pole.height_range_m: got {pair}; "
                    "expected [low, high] in metres, 0 < low <= high"
                ),
            )
            for pair in ([8.0, 4.0], [0.0, 4.0], [-1.0, 4.0])
        ),
        *(
            (
                {"capacity_units": number},
                (
                    f"site pole.capacity_units: got {number!r}; expected a whole"
                    " number, 1 to 1,000"
                ),
            )
            for number in (0, -1, 1.0, True, "2")
        ),
    ],
)
def test_a_site_says_what_is_wrong(change, message):
    assert _message(Site, **{**SITE, **change}) == message


def test_a_site_may_have_one_height_only():
    site = Site(**{**SITE, "height_range_m": [6.0, 6.0]})
    assert site.height_range_m.tolist() == [6.0, 6.0]
    with pytest.raises(ValueError, match="read-only"):
        site.position_m[0] = 0.0


def test_an_unknown_class_lists_the_known_ones():
    assert (
        _message(Instance, id="house", class_name="hut")
        == "instance house.class_name: got 'hut'; expected one of"
        f" {', '.join(CLASS_NAMES)}"
    )


def test_a_lane_needs_points_of_the_plane():
    assert (
        _message(
            Lane, id="a", kind="driving", width_m=3.0, centreline_m=[[1.0, 2.0, 3.0]]
        )
        == "lane a.centreline_m: got shape (1, 3); expected shape (-1, 2)"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"vertices_m": np.zeros((8, 2))},
            "junction: vertices_m: got shape (8, 2); expected shape (-1, 3)",
        ),
        (
            {"triangles": np.zeros((12, 4))},
            "junction: triangles: got shape (12, 4); expected shape (12, 3)",
        ),
        (
            {"triangles": np.full((12, 3), 8)},
            "junction: triangles: got 8; expected indices from 0 to 7",
        ),
        (
            {"triangles": np.full((12, 3), -1)},
            "junction: triangles: got -1; expected indices from 0 to 7",
        ),
        (
            {"triangle_instance": np.zeros(11)},
            "junction: triangle_instance: got shape (11,); expected shape (12,)",
        ),
        (
            {"triangle_instance": np.ones(12)},
            "junction: triangle_instance: got 1; expected indices from 0 to 0",
        ),
        (
            {"sites": (Site(**SITE),) * 2},
            "junction: sites: got 'pole'; expected every id once",
        ),
        (
            {"instances": (Instance(id="a", class_name="wall"),) * 3},
            "junction: instances: got 'a'; expected every id once",
        ),
        (
            {"outline_m": [[1.0, 2.0, 3.0]]},
            "junction: outline_m: got shape (1, 3); expected shape (-1, 2)",
        ),
    ],
)
def test_a_scene_says_what_is_wrong(change, message):
    scene = _scene(_box([1.0, 1.0, 1.0], Pose(position_m=[0, 0, 0], yaw_deg=0.0)))
    assert _message(dataclasses.replace, scene, **change) == message


def test_a_scene_is_read_only_and_short_in_print():
    scene = _scene(_box([1.0, 1.0, 1.0], Pose(position_m=[0, 0, 0], yaw_deg=0.0)))
    assert repr(scene) == "Scene('junction', 12 triangles, 1 instances, 1 sites)"
    for field in ("vertices_m", "triangles", "triangle_instance"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(scene, field)[0] = 0


# Inside of what

sizes_m = st.tuples(*[numbers(0.5, 40.0)] * 3)


@given(
    sizes_m,
    points_m,
    angles_deg,
    st.tuples(*[numbers(-1.5, 1.5)] * 3),
    st.sampled_from(["building", "wall", "vegetation", "parked vehicle"]),
)
def test_a_point_lies_in_a_box_if_it_is_between_all_its_sides(
    size_m, middle_m, yaw_deg, share, class_name
):
    size = np.array(size_m)
    half = 0.5 * np.array(size_m)
    pose = Pose(position_m=middle_m, yaw_deg=yaw_deg)
    scene = _scene(_box(size_m, pose, class_name))
    point = half * share  # relative to the middle of the box
    world = to_world(point + [0, 0, half[2]], pose)
    margin = np.abs(np.abs(point) - half).min()
    if margin < 1e-6 * size.max():
        return
    is_inside = (np.abs(point) < half).all()
    found = containing_instance(scene, world)
    assert (found is not None) == is_inside
    assert not is_inside or found is scene.instances[0]


def test_between_two_bodies_is_open_air_and_in_the_second_one_is_the_second():
    boxes = [
        _box([2.0, 2.0, 2.0], Pose(position_m=[x, 0.0, 0.0], yaw_deg=30.0))
        for x in (-3.0, 3.0)
    ]
    scene = _scene(*boxes)
    assert containing_instance(scene, [0.0, 0.0, 1.0]) is None
    assert containing_instance(scene, [3.0, 0.2, 1.0]) is scene.instances[1]


def test_posts_and_the_ground_hold_nothing():
    for name in ("lamp post", "traffic light", "ground"):
        scene = _scene(
            _box([2.0, 2.0, 2.0], Pose(position_m=[0, 0, 0], yaw_deg=0.0), name)
        )
        assert containing_instance(scene, [0.0, 0.0, 1.0]) is None


def test_a_hollow_that_a_box_around_it_would_fill_is_open_air():
    ell = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, 0], [10, 2, 5]]),
            trimesh.creation.box(bounds=[[0, 2, 0], [2, 10, 5]]),
        ]
    )
    scene = _scene(("building", ell.vertices, ell.faces))
    assert containing_instance(scene, [8.0, 8.0, 2.0]) is None
    assert containing_instance(scene, [8.0, 1.0, 2.0]) is scene.instances[0]
    assert containing_instance(scene, [1.0, 8.0, 2.0]) is scene.instances[0]


def test_a_parked_car_made_of_overlapping_parts_holds_what_is_in_any_of_them():
    (car,) = load_actors()["parked-car-large"].shapes
    scene = _scene(("parked vehicle", car.vertices_m, car.triangles))
    assert containing_instance(scene, [0.0, 0.0, 0.7]) is scene.instances[0]  # body
    assert containing_instance(scene, [-0.5, 0.0, 1.3]) is scene.instances[0]  # cabin
    assert containing_instance(scene, [2.15, 0.0, 1.4]) is None  # above the bonnet
    assert containing_instance(scene, [0.0, 0.0, 0.05]) is None  # below the floor


def test_a_point_must_be_a_point():
    scene = _scene(_box([1.0, 1.0, 1.0], Pose(position_m=[0, 0, 0], yaw_deg=0.0)))
    assert (
        _message(containing_instance, scene, [1.0, 2.0])
        == "position_m: got shape (2,); expected shape (3,)"
    )
