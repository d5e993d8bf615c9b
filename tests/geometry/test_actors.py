"""Bodies of road users and parked cars: sizes, meshes, gaits."""

import dataclasses
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from hypothesis import given
from refusals import refused_with
from strategies import numbers

from geometry.actors import (
    Actor,
    PlacedActor,
    Shape,
    fingerprint,
    load_actors,
    pick_actor,
    read_actors,
)
from geometry.poses import Pose
from geometry.raycast import build_caster
from geometry.text_formats import load_toml

DATA = files("geometry") / "data"
NAMES = tuple(load_actors())
WHEELED = [name for name in NAMES if load_actors()[name].wheelbase_m > 0.0]
MOVING = [name for name in NAMES if name not in WHEELED]
SHAPES = []
for actor_name, named_actor in load_actors().items():
    SHAPES += [(actor_name, index) for index in range(len(named_actor.shapes))]


def mesh_of(shape):
    """The mesh of a shape as it is."""
    return trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)


def depth_m(shape, side):
    """Depth of the body seen from the left (1) or the right (-1), by parallel rays 1 cm
    apart.
    """
    ahead, up = np.meshgrid(np.arange(-2.495, 2.5, 0.01), np.arange(0.005, 2.0, 0.01))
    beside = np.full(ahead.size, 5.0 * side)
    origins = np.column_stack([ahead.ravel(), beside, up.ravel()]).astype(np.float32)
    vectors = np.zeros_like(origins)
    vectors[:, 1] = -10.0 * side
    caster = build_caster(shape.vertices_m, shape.triangles, library="embree")
    share, _ = caster.first_triangle(origins, vectors)
    return 10.0 * share


def assert_same_but_for_edges(one_m, other_m):
    """Small triangles are merged with a tolerance of 2 mm; at the outline it decides on
    a hit.
    """
    is_hit = np.isfinite(one_m)
    is_other = np.isfinite(other_m)
    assert (is_hit != is_other).sum() < 0.02 * is_hit.sum()
    both = is_hit & is_other
    assert (np.abs(one_m[both] - other_m[both]) > 5e-3).mean() < 0.04


# Boxes


@pytest.mark.parametrize("name", NAMES)
def test_all_shapes_together_fill_exactly_the_declared_box(name):
    actor = load_actors()[name]
    vertices = np.concatenate([shape.vertices_m for shape in actor.shapes])
    half = [0.5 * actor.length_m, 0.5 * actor.width_m]

    assert vertices.min(axis=0) == pytest.approx([-half[0], -half[1], 0.0], abs=1e-6)
    assert vertices.max(axis=0) == pytest.approx([*half, actor.height_m], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "size_m"),
    [
        ("vut", (4.892, 1.836, 1.51)),
        ("parked-car-small", (4.316, 1.79, 1.48)),  # Euro NCAP AEB/LSS VRU v4.5.1
        ("parked-car-large", (4.418, 1.82, 1.533)),  # Euro NCAP AEB/LSS VRU v4.5.1
        ("adult", (0.6, 0.5, 1.8)),  # ISO 19206-2
        ("child", (0.711, 0.298, 1.154)),  # ISO 19206-2
        ("cyclist", (1.89, 0.5, 1.8)),  # ISO 19206-4; height with rider assumed
        ("car", (4.023, 1.712, 1.427)),  # Euro NCAP's global vehicle target
        ("motorcyclist", (2.08, 0.79, 1.7)),  # Euro NCAP; height with rider assumed
    ],
)
def test_boxes_are_those_of_their_sources(name, size_m):
    actor = load_actors()[name]
    assert (actor.length_m, actor.width_m, actor.height_m) == size_m


@pytest.mark.parametrize(
    ("name", "ahead_m"),
    [
        ("adult", 0.3 - 0.36),
        ("child", 0.3555 - 0.396),
        ("cyclist", 0.945 - 0.93),
        ("vut", 0.0),
        ("car", 4.023 / 4.0),  # of crossings: a quarter of the length behind the front
        ("motorcyclist", 0.0),
    ],
)
def test_reference_points_are_as_far_behind_the_box_front_as_the_protocol_says(
    name, ahead_m
):
    assert load_actors()[name].reference_ahead_m == pytest.approx(ahead_m)


# Meshes


@pytest.mark.parametrize(("name", "index"), SHAPES)
def test_every_shape_is_one_closed_mesh_on_the_road_that_faces_outwards(name, index):
    shape = load_actors()[name].shapes[index]
    mesh = mesh_of(shape)

    assert shape.vertices_m[:, 2].min() == 0.0
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    assert len(mesh.split(only_watertight=False)) == 1
    # Every vertex belongs to a triangle with area.
    assert set(shape.triangles.ravel().tolist()) == set(range(len(shape.vertices_m)))
    assert (mesh.area_faces > 0.0).all()


@pytest.mark.parametrize("name", WHEELED)
def test_cars_and_the_motorcyclist_are_symmetric(name):
    (shape,) = load_actors()[name].shapes
    assert_same_but_for_edges(depth_m(shape, -1), depth_m(shape, 1))


@pytest.mark.parametrize("name", WHEELED)
def test_axles_are_under_the_box_and_wheels_stand_below_them(name):
    actor = load_actors()[name]
    (shape,) = actor.shapes
    ahead = shape.vertices_m[shape.vertices_m[:, 2] < 0.01, 0]
    front = ahead[ahead > 0.0]
    rear = ahead[ahead < 0.0]
    rear_axle_m = actor.front_axle_ahead_m - actor.wheelbase_m

    assert front.mean() == pytest.approx(actor.front_axle_ahead_m, abs=0.02)
    assert rear.mean() == pytest.approx(rear_axle_m, abs=0.02)


def test_the_vut_has_the_wheelbase_of_its_source():
    assert load_actors()["vut"].wheelbase_m == 2.85


@pytest.mark.parametrize(
    ("name", "wheelbase_m", "front_m", "rear_m"),
    # Euro NCAP, targets.gvt and targets.motorcycle: from the rear axle to both ends of
    # the box
    [
        ("car", 2.475, 3.3395, 0.6835),
        ("motorcyclist", 1.41, 1.713, 0.367),
    ],
)
def test_axles_of_targets_are_as_far_from_the_box_ends_as_the_source_says(
    name, wheelbase_m, front_m, rear_m
):
    actor = load_actors()[name]
    rear_axle_m = actor.front_axle_ahead_m - actor.wheelbase_m

    assert actor.wheelbase_m == wheelbase_m
    assert 0.5 * actor.length_m - rear_axle_m == pytest.approx(front_m)
    assert 0.5 * actor.length_m + rear_axle_m == pytest.approx(rear_m)


@pytest.mark.parametrize(
    ("name", "low_m3", "high_m3"),
    # A small car fills half of its box or more; a motorcycle of 0.2 t and a rider of 80
    # kg.
    [
        ("car", 5.0, 7.0),
        ("motorcyclist", 0.25, 0.45),
    ],
)
def test_bodies_have_the_volume_of_such_bodies(name, low_m3, high_m3):
    (shape,) = load_actors()[name].shapes
    assert low_m3 < mesh_of(shape).volume < high_m3


# Outlines


@pytest.mark.parametrize(
    ("name", "spread"),
    [
        ("adult", 1.7),
        ("child", 2.0),
    ],
)
def test_walkers_stand_together_at_rest_and_are_widest_a_quarter_of_a_cycle_later(
    name, spread
):
    shapes = load_actors()[name].shapes
    widths_m = np.array([np.ptp(shape.vertices_m[:, 0]) for shape in shapes])

    assert np.argmin(widths_m) % 4 == 0
    assert np.argmax(widths_m) % 4 == 2
    assert widths_m[0] == pytest.approx(widths_m.min(), rel=0.01)
    assert widths_m.max() > spread * widths_m.min()


@pytest.mark.parametrize("name", MOVING)
def test_half_a_cycle_later_the_body_is_its_own_mirror_image(name):
    shapes = load_actors()[name].shapes
    half = len(shapes) // 2
    for now, later in zip(shapes, shapes[half:] + shapes[:half], strict=True):
        assert_same_but_for_edges(depth_m(now, -1), depth_m(later, 1))


# Gait


@pytest.mark.parametrize("name", MOVING)
def test_shapes_follow_one_another_along_the_way(name):
    actor = load_actors()[name]
    n_shapes = len(actor.shapes)
    way_m = actor.cycle_m / n_shapes * np.arange(-n_shapes, 3 * n_shapes)

    for shift in (-0.49, 0.0, 0.49):
        index = actor.shape_index(way_m + shift * actor.cycle_m / n_shapes)
        assert index.tolist() == 4 * list(range(n_shapes))

    assert actor.shape_index(0.0) == 0


@given(numbers(-50.0, 50.0))
def test_a_distance_in_its_last_bits_changes_no_shape(distance_m):
    adult = load_actors()["adult"]
    step_m = adult.cycle_m / len(adult.shapes)
    middle_m = (np.floor(distance_m / step_m) + 0.5) * step_m
    found = adult.shape_index(middle_m + 1e-10 * np.array([-1.0, 0.0, 1.0]))

    assert len(set(found.tolist())) == 1


def test_what_does_not_move_has_one_shape(actors):
    for name in WHEELED:
        actor = actors[name]
        assert len(actor.shapes) == 1
        assert actor.cycle_m == 0.0
        assert not actor.shape_index(np.linspace(0.0, 9.0, 6)).any()


# Catalogue


@pytest.mark.parametrize(
    ("name", "class_name"),
    [
        ("vut", "vehicle"),
        ("adult", "pedestrian"),
        ("child", "pedestrian"),
        ("cyclist", "cyclist"),
        ("car", "car"),
        ("motorcyclist", "motorcyclist"),
    ],
)
def test_bodies_know_their_class(name, class_name):
    assert pick_actor(name, "test").class_name == class_name


def test_arrays_of_a_shape_are_read_only(actors):
    shape = actors["adult"].shapes[0]
    for array in (shape.vertices_m, shape.triangles):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_unknown_body_lists_the_known_ones():
    with refused_with(
        "cases.toml: X.vru_actor: got 'unicorn'; expected one of"
        f" {', '.join(sorted(NAMES))}"
    ):
        pick_actor("unicorn", "cases.toml: X.vru_actor")


@pytest.mark.parametrize("field", ["length_m", "width_m", "height_m"])
@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_a_body_without_extent_is_refused(actors, field, value):
    with refused_with(f"actor adult.{field}: got {value}; expected > 0 metres"):
        dataclasses.replace(actors["adult"], **{field: value})


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "adult",
            {"shapes": ()},
            "actor adult.shapes: got none; expected at least one shape",
        ),
        (
            "adult",
            {"cycle_m": 0.0},
            (
                "actor adult.cycle_m: got 0.0; expected > 0 metres for several shapes,"
                " 0 for one"
            ),
        ),
        (
            "vut",
            {"cycle_m": 2.0},
            (
                "actor vut.cycle_m: got 2.0; expected > 0 metres for several shapes, 0"
                " for one"
            ),
        ),
        (
            "adult",
            {"cycle_m": float("inf")},
            (
                "actor adult.cycle_m: got inf; expected > 0 metres for several shapes,"
                " 0 for one"
            ),
        ),
    ],
)
def test_a_gait_that_goes_nowhere_is_refused(actors, name, changes, message):
    with refused_with(message):
        dataclasses.replace(actors[name], **changes)


def test_the_key_of_a_placed_body_is_its_content(actors):
    def place(name="vut", x_m=1.0, yaw_deg=0.0):
        pose = Pose(position_m=np.array([x_m, 2.0, 0.0]), yaw_deg=yaw_deg)
        return PlacedActor(actor=actors[name], pose=pose)

    key = place().key
    assert place().key == key
    assert hash(place().key) == hash(key)
    assert place(x_m=0.0).key == place(x_m=-0.0).key

    others = [place(x_m=1.1), place(yaw_deg=1.0), place("parked-van")]
    assert len({key, *(other.key for other in others)}) == 4


def test_an_actor_may_be_made_by_hand():
    box = trimesh.creation.box((1.0, 1.0, 2.0))
    shape = Shape(vertices_m=box.vertices + [0.0, 0.0, 1.0], triangles=box.faces)
    actor = Actor(
        name="box",
        class_name="vehicle",
        length_m=1.0,
        width_m=1.0,
        height_m=2.0,
        shapes=(shape,),
    )

    assert actor.shapes[0].triangles.dtype == np.int32
    assert actor.cycle_m == 0.0
    assert actor.reference_ahead_m == 0.0
    assert actor.wheelbase_m == 0.0


# Shapes on disk


def test_the_shapes_on_disk_belong_to_the_description():
    table = load_toml(DATA / "actors.toml")
    with np.load(str(DATA / "actors.npz")) as stored:
        assert str(stored["fingerprint"]) == fingerprint(table)


def test_shapes_of_another_description_are_refused():
    table = load_toml(DATA / "actors.toml")
    table["adult"]["height_m"] = 1.81
    with refused_with(
        f"{DATA / 'actors.npz'}: got shapes of another actors.toml; "
        "expected shapes built from it: python -m geometry.body_shapes"
    ):
        read_actors(table, DATA / "actors.npz")


def test_missing_shapes_say_how_to_build_them(tmp_path):
    with refused_with(
        f"{tmp_path / 'actors.npz'}: got no such file; "
        "expected shapes built from it: python -m geometry.body_shapes"
    ):
        read_actors({}, tmp_path / "actors.npz")
