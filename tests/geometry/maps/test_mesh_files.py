"""Things out of meshes: glTF, OBJ, PLY and STL."""

import json
import struct

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from geometry.errors import InputError
from geometry.maps import mesh_files
from geometry.maps.mesh_files import UNITS_M, UP_AXES, read_mesh
from geometry.maps.source_map import volume_m3

FORMATS = ["obj", "ply", "stl"]


def box(size, foot):
    """A box that stands on a place."""
    solid = trimesh.creation.box(size)
    solid.apply_translation(np.array(foot) + [0.0, 0.0, 0.5 * size[2]])
    return solid


def street():
    """A scene with four things."""
    scene = trimesh.Scene()
    for name, solid in (
        ("House_1", box((10, 8, 6), (0, 0, 0))),
        ("garden wall", box((10, 0.5, 2), (20, 0, 0))),
        ("Tree.003", box((2, 2, 5), (30, 3, 0))),
        ("thing", box((1, 1, 1), (40, 3, 0))),
    ):
        scene.add_geometry(solid, node_name=name, geom_name=name)
    return scene


def up_is_y(scene):
    """The scene as glTF has it, with the y axis up."""
    turned = scene.copy()
    rotation = trimesh.transformations.rotation_matrix(-0.5 * np.pi, [1, 0, 0])
    turned.apply_transform(rotation)
    return turned


def volume(thing):
    """Volume of a thing. [m3]"""
    return volume_m3(thing.vertices_m, thing.triangles)


def write_gltf(tmp_path, **changes):
    """A file of glTF with one triangle."""
    data = struct.pack("<9f", 0, 0, 0, 5, 0, 0, 0, 5, 0)
    vertices = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    (tmp_path / "a.bin").write_bytes(data)
    table = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "sheet"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [vertices],
        "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        "buffers": [{"byteLength": len(data), "uri": "a.bin"}],
    }
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(table | changes))
    return path


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_needs_no_words_about_unit_and_axis(tmp_path, suffix):
    up_is_y(street()).export(tmp_path / f"a.{suffix}")
    source = read_mesh(tmp_path / f"a.{suffix}")

    assert {thing.id: thing.class_name for thing in source.things} == {
        "House_1": "building",
        "garden wall": "wall",
        "Tree.003": "vegetation",
        "thing": "building",
    }

    house = next(thing for thing in source.things if thing.id == "House_1")
    assert volume(house) == pytest.approx(480.0, rel=1e-5)
    assert_allclose(house.vertices_m.min(axis=0), [-5, -4, 0], atol=1e-5)
    assert_allclose(house.vertices_m.max(axis=0), [5, 4, 6], atol=1e-5)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    ("unit", "up"),
    [
        ("m", "z"),
        ("cm", "z"),
        ("ft", "-x"),
    ],
)
def test_other_formats_are_read_in_the_unit_and_axis_that_are_named(
    tmp_path, suffix, unit, up
):
    path = tmp_path / f"a.{suffix}"
    street().to_geometry().export(path)
    source = read_mesh(path, unit=unit, up=up)
    total = sum(volume(thing) for thing in source.things)

    expected = (480.0 + 10.0 + 20.0 + 1.0) * UNITS_M[unit] ** 3
    assert total == pytest.approx(expected, rel=1e-5)


def test_objects_of_an_obj_file_are_things(tmp_path):
    street().export(tmp_path / "a.obj")
    source = read_mesh(tmp_path / "a.obj", unit="m", up="z")
    ids = {thing.id for thing in source.things}

    assert ids == {"House_1", "garden wall", "Tree.003", "thing"}
    assert len(source.things) == 4


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize("said", [{}, {"unit": "m"}, {"up": "z"}])
def test_formats_without_a_standard_need_words(tmp_path, suffix, said):
    path = tmp_path / f"a.{suffix}"
    street().to_geometry().export(path)
    with pytest.raises(InputError, match="`unit` and `up`"):
        read_mesh(path, **said)


@pytest.mark.parametrize("up", list(UP_AXES))
def test_axes_are_rotations_that_lift_the_named_one(up):
    rows = np.array(UP_AXES[up], dtype=float)
    assert np.linalg.det(rows) == 1.0

    axis = np.eye(3)["xyz".index(up[-1])]
    if up.startswith("-"):
        axis = -axis

    assert (rows @ axis).tolist() == [0.0, 0.0, 1.0]


def test_closed_solids_that_look_inwards_are_turned(tmp_path):
    solid = box((4, 4, 4), (0, 0, 0))
    solid.invert()
    solid.export(tmp_path / "a.stl")
    (thing,) = read_mesh(tmp_path / "a.stl", unit="m", up="z").things

    assert volume(thing) == pytest.approx(64.0)


def test_mirrored_nodes_still_look_outwards(tmp_path):
    path = write_gltf(tmp_path, nodes=[{"mesh": 0, "name": "a", "scale": [1, -1, 1]}])
    (thing,) = read_mesh(path).things
    a, b, c = thing.vertices_m[thing.triangles[0]]

    # In the file the sheet looks to +z, which is south, whichever way it is mirrored.
    assert np.cross(b - a, c - a)[1] < 0.0


def test_primitives_of_one_node_have_names_that_stay(tmp_path):
    primitives = [{"attributes": {"POSITION": 0}}] * 3
    path = write_gltf(tmp_path, meshes=[{"name": "m", "primitives": primitives}])
    names = [[thing.id for thing in read_mesh(path).things] for _ in range(2)]

    assert names[0] == names[1] == ["sheet", "sheet-2", "sheet-3"]


@pytest.mark.parametrize("unit", ["km", "mm"])
def test_sizes_of_another_unit_are_refused(tmp_path, unit):
    box((40, 40, 6), (0, 0, 0)).export(tmp_path / "a.stl")

    with pytest.raises(InputError, match="another `unit`"):
        read_mesh(tmp_path / "a.stl", unit=unit, up="z")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.obj", "", "no triangles"),
        ("a.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "finite"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "obj"),
        ("a.stl", "solid a\nendsolid a\n", "stl"),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 9999999999\nend_header\n",
            "ply",
        ),
        ("a.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000), "stl"),
        (
            "a.glb",
            b"glTF" + struct.pack("<4I", 2, 100, 4_000_000_000, 0x4E4F534A),
            "glTF",
        ),
        ("a.glb", b"glTF" + struct.pack("<4I", 1, 100, 4, 0x4E4F534A), "version"),
        ("a.gltf", "{", "glTF"),
        ("a.3mf", "", "one of"),
    ],
)
def test_broken_meshes_are_refused_in_one_line(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())

    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path, unit="m", up="z")
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_missing_files_and_unknown_words_are_refused(tmp_path):
    with pytest.raises(InputError, match="readable"):
        read_mesh(tmp_path / "a.glb")
    for wrong in ({"unit": "yard"}, {"up": "w"}, {"class_name": "castle"}):
        with pytest.raises(InputError, match="one of"):
            read_mesh(tmp_path / "a.glb", **wrong)


NODE = {"mesh": 0}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"accessors": [{"componentType": 5126, "count": 10**10, "type": "VEC3"}]},
            "accessors",
        ),
        ({"bufferViews": [{"buffer": 0, "byteLength": -4}]}, "bufferViews"),
        ({"nodes": [NODE | {"children": [1]}, {"children": [0]}]}, "its own ancestor"),
        ({"nodes": [NODE | {"children": [2]}, {"children": [2]}, NODE]}, "two parents"),
        ({"nodes": [NODE | {"children": [7]}]}, "indices of nodes"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "compression"),
        ({"buffers": [{"byteLength": 36, "uri": "../a.bin"}]}, "own folder"),
        (
            {"buffers": [{"byteLength": 36, "uri": "http://example.com/a.bin"}]},
            "own folder",
        ),
        ({"buffers": [{"byteLength": 36, "uri": "b.bin"}]}, "readable"),
        ({"meshes": []}, "gltf"),
    ],
)
def test_gltf_that_claims_or_refers_too_far_is_refused(tmp_path, changes, message):
    assert len(read_mesh(write_gltf(tmp_path)).things) == 1
    with pytest.raises(InputError, match=message):
        read_mesh(write_gltf(tmp_path, **changes))


def test_materials_of_obj_files_are_never_opened(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib ../../etc/passwd\nusemtl x\nv 0 0 0\nv 5 0 0\nv 0 5 0\nf 1 2 3\n"
    )
    assert len(read_mesh(path, unit="m", up="z").things) == 1


def test_too_many_triangles_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mesh_files, "MAX_TRIANGLES", 20)
    up_is_y(street()).export(tmp_path / "a.glb")
    with pytest.raises(InputError, match="more than 20 triangles"):
        read_mesh(tmp_path / "a.glb")
