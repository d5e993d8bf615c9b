"""Scenes and what they are made of; inside of which body a point lies."""

import dataclasses

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


def scene_of(*bodies):
    """A scene of (class name, vertices, triangles)."""
    vertices = [np.zeros((0, 3))]
    triangles = [np.zeros((0, 3), dtype=int)]

    instances = []
    owner = []
    for index, (class_name, points, faces) in enumerate(bodies):
        triangles.append(faces + sum(map(len, vertices)))
        vertices.append(points)
        owner += [index] * len(faces)
        instances.append(Instance(id=f"body-{index}", class_name=class_name))

    return Scene(
        name="junction",
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        triangle_instance=np.array(owner, dtype=int),
        instances=tuple(instances),
        sites=(Site(**SITE),),
        outline_m=np.zeros((0, 2)),
        lanes=(),
        crs="EPSG:25832",
    )


def box(size_m, *, at=(0.0, 0.0, 0.0), yaw_deg=0.0, class_name="building"):
    """A box that stands at a place."""
    mesh = trimesh.creation.box(size_m)
    pose = Pose(position_m=at, yaw_deg=yaw_deg)
    vertices = to_world(mesh.vertices + [0, 0, 0.5 * size_m[2]], pose)
    return class_name, vertices, mesh.faces


CUBE = scene_of(box([1.0, 1.0, 1.0]))


def told(function, *arguments, **fields):
    """In which words something is refused."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **fields)
    return str(caught.value)


# Values


LOW_HIGH = "expected [low, high] in metres, 0 < low <= high"
UNITS = "expected a whole number, 1 to 1,000"


@pytest.mark.parametrize(
    ("field", "message", "value"),
    [
        ("position_m", "got shape (2,); expected shape (3,)", [1.0, 2.0]),
        (
            "position_m",
            "got [1.0, 2.0, nan]; expected finite numbers",
            [1.0, 2.0, np.nan],
        ),
        (
            "height_range_m",
            "got [8.0, 4.0]; expected [low, high] in metres, 0 < low <= high",
            [8.0, 4.0],
        ),
        (
            "height_range_m",
            "got [0.0, 4.0]; expected [low, high] in metres, 0 < low <= high",
            [0.0, 4.0],
        ),
        (
            "height_range_m",
            "got [-1.0, 4.0]; expected [low, high] in metres, 0 < low <= high",
            [-1.0, 4.0],
        ),
        ("capacity_units", "got 0; expected a whole number, 1 to 1,000", 0),
        ("capacity_units", "got -1; expected a whole number, 1 to 1,000", -1),
        ("capacity_units", "got 1.0; expected a whole number, 1 to 1,000", 1.0),
        ("capacity_units", "got True; expected a whole number, 1 to 1,000", True),
        ("capacity_units", "got '2'; expected a whole number, 1 to 1,000", "2"),
    ],
)
def test_a_site_says_what_is_wrong(field, message, value):
    assert told(Site, **SITE | {field: value}) == f"site pole.{field}: {message}"


def test_a_site_may_have_one_height_only():
    site = Site(**SITE | {"height_range_m": [6.0, 6.0]})
    assert site.height_range_m.tolist() == [6.0, 6.0]
    with pytest.raises(ValueError, match="read-only"):
        site.position_m[0] = 0.0


def test_an_unknown_class_lists_the_known_ones():
    known = ", ".join(CLASS_NAMES)
    message = told(Instance, id="house", class_name="hut")
    assert message == f"instance house.class_name: got 'hut'; expected one of {known}"


def test_a_lane_needs_points_of_the_plane():
    line = [[1.0, 2.0, 3.0]]
    message = told(
        Lane,
        id="a",
        kind="driving",
        width_m=3.0,
        centreline_m=line,
    )
    assert message == "lane a.centreline_m: got shape (1, 3); expected shape (-1, 2)"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("vertices_m", np.zeros((8, 2)), "got shape (8, 2); expected shape (-1, 3)"),
        ("triangles", np.zeros((12, 4)), "got shape (12, 4); expected shape (12, 3)"),
        ("triangles", np.full((12, 3), 8), "got 8; expected indices from 0 to 7"),
        ("triangles", np.full((12, 3), -1), "got -1; expected indices from 0 to 7"),
        ("triangle_instance", np.zeros(11), "got shape (11,); expected shape (12,)"),
        ("triangle_instance", np.ones(12), "got 1; expected indices from 0 to 0"),
        ("sites", (Site(**SITE),) * 2, "got 'pole'; expected every id once"),
        (
            "instances",
            (Instance(id="a", class_name="wall"),) * 3,
            "got 'a'; expected every id once",
        ),
        ("outline_m", [[1.0, 2.0, 3.0]], "got shape (1, 3); expected shape (-1, 2)"),
    ],
)
def test_a_scene_says_what_is_wrong(field, value, message):
    found = told(dataclasses.replace, CUBE, **{field: value})
    assert found == f"junction: {field}: {message}"


def test_a_scene_is_read_only_and_short_in_print():
    assert repr(CUBE) == "Scene('junction', 12 triangles, 1 instances, 1 sites)"
    for field in ("vertices_m", "triangles", "triangle_instance"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(CUBE, field)[0] = 0


# Inside of what

edges_m = numbers(0.5, 40.0)
sizes_m = st.tuples(edges_m, edges_m, edges_m)
shares = numbers(-1.5, 1.5)


@given(
    sizes_m,
    points_m,
    angles_deg,
    st.tuples(shares, shares, shares),
    st.sampled_from(["building", "wall", "vegetation", "parked vehicle"]),
)
def test_a_point_lies_in_a_box_if_it_is_between_all_its_sides(
    size_m, middle_m, yaw_deg, share, class_name
):
    half = 0.5 * np.array(size_m)
    body = box(
        size_m,
        at=middle_m,
        yaw_deg=yaw_deg,
        class_name=class_name,
    )
    scene = scene_of(body)
    point = half * share  # relative to the middle of the box
    pose = Pose(position_m=middle_m, yaw_deg=yaw_deg)
    world = to_world(point + [0, 0, half[2]], pose)
    margin = np.abs(np.abs(point) - half).min()
    if margin < 1e-6 * max(size_m):
        return
    is_inside = (np.abs(point) < half).all()
    found = containing_instance(scene, world)

    assert (found is not None) == is_inside
    assert not is_inside or found is scene.instances[0]


def test_between_two_bodies_is_open_air_and_in_the_second_one_is_the_second():
    west = box([2.0, 2.0, 2.0], at=[-3.0, 0.0, 0.0], yaw_deg=30.0)
    east = box([2.0, 2.0, 2.0], at=[3.0, 0.0, 0.0], yaw_deg=30.0)
    scene = scene_of(west, east)

    assert containing_instance(scene, [0.0, 0.0, 1.0]) is None
    assert containing_instance(scene, [3.0, 0.2, 1.0]) is scene.instances[1]


@pytest.mark.parametrize("name", ["lamp post", "traffic light", "ground"])
def test_posts_and_the_ground_hold_nothing(name):
    scene = scene_of(box([2.0, 2.0, 2.0], class_name=name))
    assert containing_instance(scene, [0.0, 0.0, 1.0]) is None


def test_a_hollow_that_a_box_around_it_would_fill_is_open_air():
    wing = trimesh.creation.box(bounds=[[0, 0, 0], [10, 2, 5]])
    other = trimesh.creation.box(bounds=[[0, 2, 0], [2, 10, 5]])
    ell = trimesh.util.concatenate([wing, other])
    scene = scene_of(("building", ell.vertices, ell.faces))

    assert containing_instance(scene, [8.0, 8.0, 2.0]) is None
    assert containing_instance(scene, [8.0, 1.0, 2.0]) is scene.instances[0]
    assert containing_instance(scene, [1.0, 8.0, 2.0]) is scene.instances[0]


def test_a_parked_car_made_of_overlapping_parts_holds_what_is_in_any_of_them():
    (car,) = load_actors()["parked-car-large"].shapes
    scene = scene_of(("parked vehicle", car.vertices_m, car.triangles))

    in_body = [0.0, 0.0, 0.7]
    in_cabin = [-0.5, 0.0, 1.3]
    above_bonnet = [2.15, 0.0, 1.4]
    below_floor = [0.0, 0.0, 0.05]

    assert containing_instance(scene, in_body) is scene.instances[0]
    assert containing_instance(scene, in_cabin) is scene.instances[0]
    assert containing_instance(scene, above_bonnet) is None
    assert containing_instance(scene, below_floor) is None


def test_a_point_must_be_a_point():
    message = told(containing_instance, CUBE, [1.0, 2.0])
    assert message == "position_m: got shape (2,); expected shape (3,)"
