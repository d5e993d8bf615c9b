"""Ground that is not flat."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused_with

from geometry.maps.relief import fit_terrain
from geometry.scene import Instance
from geometry.scene_checks import check_scene
from geometry.scene_sources import load_scene
from geometry.terrain import Terrain, ground_height_m, terrain_of
from scenarios.cases import select_cases
from scenarios.runs import build_runs


def on_terrain(scene, terrain):
    """A scene whose ground is a terrain; all else is lifted as a whole, thing by
    thing.
    """
    vertices, triangles = terrain.mesh()
    things = [Instance(id="ground", class_name="ground")]
    parts = [vertices]
    faces = [triangles]
    owner = [np.zeros(len(triangles))]
    start = len(vertices)

    for index, thing in enumerate(scene.instances):
        if thing.class_name == "ground":
            continue
        own = scene.triangles[scene.triangle_instance == index]
        used, place = np.unique(own, return_inverse=True)
        points = scene.vertices_m[used].copy()
        ground_m = terrain.at(points[:, :2])
        points[:, 2] += ground_m.min()
        parts.append(points)
        faces.append(place.reshape(-1, 3) + start)
        owner.append(np.full(len(own), len(things)))
        things.append(thing)
        start += len(points)

    sites = []
    for site in scene.sites:
        up = [0.0, 0.0, terrain.at(site.position_m[:2])]
        sites.append(replace(site, position_m=site.position_m + up))

    return replace(
        scene,
        vertices_m=np.concatenate(parts),
        triangles=np.concatenate(faces),
        triangle_instance=np.concatenate(owner),
        instances=tuple(things),
        sites=tuple(sites),
    )


def grid(height_of, *, half_m=200.0, step_m=10.0):
    """A terrain from a function of east and north."""
    line = np.arange(-half_m, half_m + 1.0e-9, step_m)
    east, north = np.meshgrid(line, line)
    return Terrain(east_m=line, north_m=line, height_m=height_of(east, north))


@given(st.integers(0, 2**32 - 1))
def test_heights_are_those_of_the_mesh(seed):
    """At random places of each triangle, all of which face up."""
    rng = np.random.default_rng(seed)
    east_steps_m = rng.uniform(0.5, 3.0, 4)
    north_steps_m = rng.uniform(0.5, 3.0, 3)
    terrain = Terrain(
        east_m=np.cumsum(east_steps_m),
        north_m=np.cumsum(north_steps_m),
        height_m=rng.normal(size=(3, 4)),
    )
    vertices, triangles = terrain.mesh()
    corners = vertices[triangles]
    share = rng.dirichlet(np.ones(3), len(triangles))
    points = np.einsum("nk,nkj->nj", share, corners)

    found_m = terrain.at(points[:, :2])

    assert_allclose(found_m, points[:, 2], atol=1e-9)

    a, b, c = np.swapaxes(corners, 0, 1)
    normals = np.cross(b - a, c - a)

    assert (normals[:, 2] > 0.0).all()


def test_beyond_the_grid_heights_are_those_of_its_edge():
    slope = grid(lambda east, north: 0.05 * east, half_m=10.0)
    beyond = [
        [50.0, 3.0],
        [-50.0, 90.0],
    ]
    assert_allclose(slope.at(beyond), [0.5, -0.5])


def test_terrain_of_a_scene_is_that_of_its_ground():
    """It is read from the mesh, in which nothing says that it is a grid."""
    terrain = grid(lambda east, north: 0.05 * east - 0.02 * north)
    scene = on_terrain(load_scene(), terrain)
    found = terrain_of(scene)

    height_m = ground_height_m(scene, [[20.0, 10.0]])

    assert_array_equal(found.height_m, terrain.height_m)
    assert_allclose(height_m, [0.05 * 20.0 - 0.02 * 10.0])


def test_a_plane_at_zero_is_no_terrain():
    scene = load_scene()
    level = grid(lambda east, north: 0.0 * east)

    laid = on_terrain(scene, level)

    assert terrain_of(scene) is None
    assert terrain_of(laid) is None


def test_ground_that_is_no_grid_is_refused():
    """One corner is moved."""
    scene = load_scene()
    vertices = scene.vertices_m.copy()
    ground = scene.triangles[scene.triangle_instance == 0][0, 0]

    assert scene.instances[0].class_name == "ground"

    vertices[ground] += [1.0, 2.0, 3.0]
    with refused_with(
        "town05: ground: got 4 nodes that are no grid; expected a plane z = 0, or"
        " heights on a grid, as imported scenes have them"
    ):
        terrain_of(replace(scene, vertices_m=vertices))


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_fit_of_points_on_a_plane_is_that_plane(a, b):
    rng = np.random.default_rng(0)
    scattered = rng.uniform(-120.0, 120.0, size=(2000, 2))
    corners = [
        [-120.0, -120.0],
        [-120.0, 120.0],
        [120.0, -120.0],
        [120.0, 120.0],
    ]
    flat = np.concatenate([scattered, corners])
    heights_m = flat @ [a, b]
    points = np.column_stack([flat, heights_m])
    terrain = fit_terrain(points, half_m=100.0, step_m=4.0)
    inside = rng.uniform(-99.0, 99.0, size=(500, 2))
    found_m = terrain.at(inside)
    expected_m = inside @ [a, b]

    assert_allclose(found_m, expected_m, atol=2e-3)


def test_fit_of_points_on_a_line_is_that_of_the_nearest():
    """To the side of the line, the ground is as high as its nearest point."""
    points = np.outer(np.arange(-50.0, 51.0), [1.0, 0.0, 0.1])
    terrain = fit_terrain(points, half_m=20.0, step_m=2.0)

    assert terrain.at([10.0, 15.0]) == pytest.approx(1.0, abs=0.06)

    beyond = np.array([[30.0, 0.0, 4.0]])
    level = fit_terrain(beyond, half_m=20.0, step_m=2.0)

    assert (level.height_m == 4.0).all()


def test_a_check_on_a_slope_finds_what_does_not_stand_on_it():
    """Heights count from the ground below, not from zero."""
    slope = grid(lambda east, north: 0.02 * east)
    scene = on_terrain(load_scene(), slope)
    known = check_scene(load_scene())

    assert check_scene(scene) == known

    first, *others = scene.sites
    high = replace(first, position_m=first.position_m + [0.0, 0.0, 1.4])
    findings = check_scene(replace(scene, sites=(high, *others)))
    (found,) = [one for one in findings if one not in known]

    assert found.level == "error"
    assert found.what == f"site {first.id}"
    assert found.why == "its foot is 1.4 m above the ground"


def test_runs_on_a_slope_are_those_of_the_plane_with_parked_cars_on_the_ground(
    actors, rule
):
    scene = load_scene()
    terrain = grid(lambda east, north: 0.04 * (east - 100.0), half_m=400.0)
    slope = on_terrain(scene, terrain)
    cases = select_cases("CPNCO-50,CBNA", speeds="20").cases
    flat, _ = build_runs(
        scene,
        cases,
        vut=actors["vut"],
        rule=rule,
    )
    sloped, _ = build_runs(
        slope,
        cases,
        vut=actors["vut"],
        rule=rule,
    )

    assert [run.id for run in sloped] == [run.id for run in flat]

    for one, other in zip(flat, sloped, strict=True):
        assert other.last_brake_time_s == one.last_brake_time_s
        assert_array_equal(other.vru_position_m, one.vru_position_m)
        for body, raised in zip(one.obstruction, other.obstruction, strict=True):
            up_m = 0.04 * (body.pose.position_m[0] - 100.0)
            expected = body.pose.position_m + [0.0, 0.0, up_m]
            assert_allclose(raised.pose.position_m, expected, atol=1e-9)

    assert any(run.obstruction for run in sloped)
