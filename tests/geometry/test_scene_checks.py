"""Faults of scenes that are found, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from junctions import LANE_M, MOUTH_M, protocol_scene
from scenario_lanes import build_lane

from geometry.scene import Instance, Site, thing_footprint
from geometry.scene_checks import check_scene
from geometry.study_scene import load_study_scene

POLE = Site(
    id="pole",
    position_m=[15.0, 15.0, 0.0],
    kind="lamp post",
    height_range_m=[4.0, 8.0],
    capacity_units=1,
)


def with_things(*meshes, class_name="building", sites=(POLE,)):
    """Euro NCAP's junction with things a, b and so on, and a site in the open."""
    scene = protocol_scene(crosswalks_m=[[[14.0, -6.0], [14.0, 6.0]]])
    vertices = [scene.vertices_m]
    triangles = [scene.triangles]
    index = [scene.triangle_instance]
    instances = list(scene.instances)

    for name, mesh in zip("ab", meshes, strict=False):
        triangles.append(np.asarray(mesh.faces) + sum(map(len, vertices)))
        vertices.append(np.asarray(mesh.vertices))
        index.append(np.full(len(mesh.faces), len(instances)))
        instances.append(Instance(id=name, class_name=class_name))

    return replace(
        scene,
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        triangle_instance=np.concatenate(index),
        instances=tuple(instances),
        sites=sites,
    )


def box(x, y, *, bottom_m=0.0):
    """A box of 6 m by 6 m, 5 m high."""
    mesh = trimesh.creation.box([6.0, 6.0, 5.0])
    mesh.apply_translation([x, y, bottom_m + 2.5])
    return mesh


def without(mesh, up):
    """A mesh without the faces that look up (1) or down (-1)."""
    keep = mesh.face_normals[:, 2] * up < 0.9
    return trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)


def findings_of(scene):
    """What is found in a scene, a line each."""
    return [f"{found.what}: {found.why}" for found in check_scene(scene)]


@pytest.mark.parametrize(
    "scene",
    [
        with_things(box(30, 30)),
        with_things(without(box(30, 30), -1)),  # no floor
        with_things(box(30, 30), box(36, 30)),
        with_things(box(30, 2.0, bottom_m=3.0), class_name="vegetation"),
    ],
)
def test_in_a_sound_scene_nothing_is_found(scene):
    assert not findings_of(scene)


@pytest.mark.parametrize(
    ("meshes", "told"),
    [
        ([without(box(30, 30), 1)], "a: its surface has holes"),
        ([box(30, 30, bottom_m=1.5)], "a: it begins more than 0.5 m above"),
        ([box(30, 2.0, bottom_m=3.0)], "a: it begins 2 m above the ground or"),
        ([box(30, 30, bottom_m=-4.0)], "a: it is below the road, or begins"),
        ([box(30, 2.0)], "a: it stands on a lane or in the junction"),
        ([box(30, 30), box(33, 30)], "a and b: they over"),
    ],
)
def test_what_may_be_wrong_is_found_and_nothing_else(meshes, told):
    (line,) = findings_of(with_things(*meshes))
    assert line.startswith(told)


def test_a_house_around_a_site_is_found():
    lines = findings_of(with_things(box(15, 15)))
    # The house reaches into the junction, too.
    (line,) = [one for one in lines if "lane" not in one]
    assert line.startswith("site pole: its mount at 4 m is inside building a")


def test_triangles_that_face_inwards_are_told():
    mesh = box(30, 30)
    mesh.invert()
    (finding,) = check_scene(with_things(mesh))

    assert finding.why == "its triangles face inwards"


def test_no_sites_and_no_way_in_are_errors():
    (finding,) = check_scene(with_things(sites=()))
    assert finding.level == "error"
    assert finding.what == "sites"

    scene = with_things()
    (finding,) = check_scene(replace(scene, outline_m=scene.outline_m + 100.0))

    assert finding.level == "error"
    assert finding.why == "no lane ends at the junction's outline"


def test_assumed_heights_are_told_with_few_names():
    scene = load_study_scene()
    things = [replace(thing, is_height_assumed=True) for thing in scene.instances[:9]]
    (finding,) = check_scene(replace(scene, instances=(*things, *scene.instances[9:])))

    names = sorted(thing.id for thing in things)

    assert finding.what == f"{', '.join(names[:6])} and 3 more"


def test_a_footprint_is_what_a_thing_covers_from_above():
    ring = trimesh.creation.annulus(
        r_min=2.0,
        r_max=5.0,
        height=3.0,
        sections=64,
    )
    ring.apply_translation([30.0, 30.0, 1.5])
    scene = with_things(ring)
    footprint = thing_footprint(scene, len(scene.instances) - 1)

    assert footprint.area == pytest.approx(np.pi * 21.0, rel=0.01)
    assert len(footprint.interiors) == 1


def test_a_lane_that_leads_over_the_opposite_carriageway_is_found():
    scene = protocol_scene()
    y_m = 0.5 * LANE_M
    line = [
        [-60.0, y_m + 1.0],
        [-40.0, y_m - 1.0],
        [-MOUTH_M, -y_m],
    ]
    wrong = replace(scene, lanes=(*scene.lanes, build_lane("over", line)))

    assert not opposite(scene)

    (found,) = opposite(wrong)

    assert found.level == "warning"
    assert found.what == "west-out-0 and over"


def opposite(scene):
    """What is found about lanes of opposite directions."""
    return [one for one in check_scene(scene) if "opposite directions" in one.why]
