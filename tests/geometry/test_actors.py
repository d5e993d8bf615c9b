import dataclasses

import numpy as np
import pytest
import trimesh

from geometry.actors import load_actors, pick_actor
from geometry.errors import InputError
from geometry.raycast import build_caster

NAMES = tuple(load_actors())
CARS = [name for name in NAMES if "vehicle" in load_actors()[name].class_name]


def _parts(actor) -> list[trimesh.Trimesh]:
    body = trimesh.Trimesh(actor.vertices_m, actor.triangles, process=False)
    return list(body.split(only_watertight=False))


def _silhouette_m2(actor, axis: int, step_m: float = 0.01) -> float:
    """Area of the outline seen along a horizontal axis, by parallel rays."""
    across = np.arange(-1.5, 1.5, step_m) + 0.5 * step_m
    up = np.arange(0.0, 2.0, step_m) + 0.5 * step_m
    origins = np.zeros((len(across) * len(up), 3), dtype=np.float32)
    grid = np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2)
    origins[:, 1 - axis], origins[:, 2], origins[:, axis] = grid[:, 0], grid[:, 1], -5.0
    vectors = np.zeros_like(origins)
    vectors[:, axis] = 10.0
    caster = build_caster(actor.vertices_m, actor.triangles, library="embreex")
    return float(caster.is_blocked(origins, vectors).sum()) * step_m**2


@pytest.mark.parametrize("name", NAMES)
def test_body_fills_exactly_its_declared_box_and_stands_on_the_road(name):
    actor = load_actors()[name]
    low, high = actor.vertices_m.min(axis=0), actor.vertices_m.max(axis=0)
    half = [0.5 * actor.length_m, 0.5 * actor.width_m]
    assert low == pytest.approx([-half[0], -half[1], 0.0], abs=1e-12)
    assert high == pytest.approx([*half, actor.height_m], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "size_m"),
    [
        ("vut", (4.892, 1.836, 1.510)),  # CarlaNCAP study: half extents 2.446, 0.918, 0.755 m
        ("parked-car-small", (4.316, 1.79, 1.48)),  # Euro NCAP AEB/LSS VRU v4.5.1
        ("parked-car-large", (4.418, 1.82, 1.533)),  # Euro NCAP AEB/LSS VRU v4.5.1
        ("adult", (0.6, 0.5, 1.8)),  # ISO 19206-2
        ("cyclist", (1.89, 0.5, 1.80)),  # ISO 19206-4; height with rider assumed
    ],
)
def test_boxes_are_those_of_their_sources(name, size_m):
    actor = load_actors()[name]
    assert (actor.length_m, actor.width_m, actor.height_m) == size_m


@pytest.mark.parametrize("name", NAMES)
def test_every_part_is_closed_and_its_normals_point_outwards(name):
    parts = _parts(load_actors()[name])
    assert len(parts) > 1
    for part in parts:
        assert part.is_watertight
        assert part.is_winding_consistent
        assert part.volume > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_every_vertex_belongs_to_a_triangle_with_area(name):
    actor = load_actors()[name]
    assert set(actor.triangles.ravel().tolist()) == set(range(len(actor.vertices_m)))
    corners = actor.vertices_m[actor.triangles]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.linalg.norm(doubled, axis=1) > 0.0).all()


@pytest.mark.parametrize("name", CARS)
def test_cars_are_symmetric(name):
    vertices = load_actors()[name].vertices_m
    mirrored = vertices * [1.0, -1.0, 1.0]
    gaps = np.abs(vertices[:, None] - mirrored[None]).max(axis=2).min(axis=1)
    assert gaps.max() < 1e-9


def test_cyclist_is_narrow_from_behind():
    cyclist = load_actors()["cyclist"]
    assert cyclist.width_m < 0.3 * cyclist.length_m
    assert _silhouette_m2(cyclist, 0) < 0.8 * _silhouette_m2(cyclist, 1)


def test_adult_covers_less_than_its_box_but_more_than_a_third_of_it():
    adult = load_actors()["adult"]
    share = _silhouette_m2(adult, 0) / (adult.width_m * adult.height_m)
    assert 1.0 / 3.0 < share < 1.0


@pytest.mark.parametrize(
    ("name", "class_name"),
    [("vut", "vehicle"), ("adult", "pedestrian"), ("cyclist", "cyclist")],
)
def test_bodies_know_their_class(name, class_name):
    assert pick_actor(name, "test").class_name == class_name


def test_arrays_of_a_body_are_read_only(actors):
    for array in (actors["adult"].vertices_m, actors["adult"].triangles):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_unknown_body_lists_the_known_ones():
    with pytest.raises(InputError) as caught:
        pick_actor("unicorn", "cases.toml: X.vru_actor")
    assert str(caught.value) == (
        f"cases.toml: X.vru_actor: got 'unicorn'; expected one of {', '.join(sorted(NAMES))}"
    )


@pytest.mark.parametrize("field", ["length_m", "width_m", "height_m"])
@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_a_body_without_extent_is_refused(actors, field, value):
    with pytest.raises(InputError) as caught:
        dataclasses.replace(actors["adult"], **{field: value})
    assert str(caught.value) == f"actor adult.{field}: got {value}; expected > 0 metres"
