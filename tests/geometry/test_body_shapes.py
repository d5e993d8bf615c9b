import sys
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from refusals import refused_with

from geometry import body_shapes
from geometry.actors import load_actors, read_actors
from geometry.body_shapes import build_shapes, save_shapes
from geometry.errors import InputError, MissingExtraError
from geometry.text_formats import load_toml

TABLE = load_toml(files("geometry") / "data" / "actors.toml")


@pytest.fixture
def library():
    return pytest.importorskip("manifold3d")


def _entry(**changes):
    """A ball on a pole, 1 x 1 x 2 m."""
    pole = {"spheres": [[0, 0, 0.0, 0], [0.1, 0, 0, 0], [0, 0.1, 0, 0], [0, 0, 1.5, 0]]}
    ball = {"spheres": [[0, 0, 1.5, 0.5]]}
    return {
        "class_name": "pedestrian",
        "length_m": 1.0,
        "width_m": 1.0,
        "height_m": 2.0,
        "parts": [pole, ball],
        **changes,
    }


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["child", *(pytest.param(name, marks=pytest.mark.long) for name in TABLE)]
)
def test_building_again_gives_the_shapes_on_disk(library, name):
    built = build_shapes(TABLE[name], name)
    kept = load_actors()[name].shapes
    assert len(built) == len(kept)
    for one, other in zip(built, kept, strict=True):
        meshes = [
            trimesh.Trimesh(s.vertices_m, s.triangles, process=False)
            for s in (one, other)
        ]
        assert np.allclose(meshes[0].bounds, meshes[1].bounds, atol=1e-6)
        # Not vertex by vertex: the last bits may differ from one processor to the next.
        assert meshes[0].volume == pytest.approx(meshes[1].volume, rel=1e-4)
        assert meshes[0].area == pytest.approx(meshes[1].area, rel=1e-4)


@pytest.mark.long
def test_what_is_saved_is_what_is_read(library, tmp_path):
    table = {name: TABLE[name] for name in ("child",)}
    save_shapes(tmp_path / "actors.npz", table)
    actors = read_actors(table, tmp_path / "actors.npz")
    assert list(actors) == ["child"]
    for name, actor in actors.items():
        for one, other in zip(
            actor.shapes, build_shapes(TABLE[name], name), strict=True
        ):
            assert np.array_equal(one.vertices_m, other.vertices_m)
            assert np.array_equal(one.triangles, other.triangles)


def test_parts_that_overlap_become_one_closed_mesh(library):
    (shape,) = build_shapes(_entry(), "test")
    mesh = trimesh.Trimesh(shape.vertices_m, shape.triangles, process=False)
    assert mesh.is_watertight
    assert np.allclose(mesh.bounds, [[-0.5, -0.5, 0.0], [0.5, 0.5, 2.0]], atol=1e-6)
    assert len(mesh.split()) == 1


def test_a_part_that_is_cut_away_leaves_less(library):
    hole = {
        "cut": True,
        "wheel": {"centre": [0.15, 0.0, 1.65], "radius": 0.1, "width": 2.0},
    }
    plain, drilled = (
        build_shapes(_entry(parts=[*_entry()["parts"], *more]), "test")[0]
        for more in ([], [hole])
    )
    volumes = [
        trimesh.Trimesh(s.vertices_m, s.triangles).volume for s in (plain, drilled)
    ]
    assert volumes[0] - volumes[1] == pytest.approx(np.pi * 0.1**2 * 0.88, rel=0.1)
    # Right through: a ray along the hole meets nothing.
    assert trimesh.Trimesh(drilled.vertices_m, drilled.triangles).euler_number == 0


def test_pedalling_feet_stay_on_their_pedals():
    entry = TABLE["cyclist"]
    turns = body_shapes._take_turns(entry, "cyclist")
    for index in range(8):
        frames = body_shapes._bone_frames(entry, turns, index, "cyclist")
        for side in (-1.0, 1.0):
            rotation, shaft = frames["crank", side]
            pedal = shaft + rotation @ [0.0, 0.0, -0.17]
            rotation, ankle = frames["foot", side]
            held = ankle + rotation @ [0.12, 0.0, -0.08]
            assert held[[0, 2]] == pytest.approx(pedal[[0, 2]], abs=1e-9)


def test_a_turn_of_the_crank_goes_forwards_over_the_top():
    entry = TABLE["cyclist"]
    turns = body_shapes._take_turns(entry, "cyclist")
    heights = []
    ahead = []
    for index in range(8):
        rotation, _ = body_shapes._bone_frames(entry, turns, index, "cyclist")[
            "crank", -1.0
        ]
        x, _, z = rotation @ [0.0, 0.0, -1.0]
        ahead.append(x)
        heights.append(z)
    angle = np.unwrap(np.arctan2(heights, ahead))
    assert np.diff(angle) == pytest.approx(
        -np.pi / 4.0
    )  # clockwise, seen from the right


def test_a_bone_hangs_on_the_bone_before_it_and_the_left_follows_the_right():
    entry = {
        "bones": {
            "upper": {"on": "body", "joint_m": [0.0, 0.1, 1.0], "turn": "a"},
            "lower": {"on": "upper", "joint_m": [0.0, 0.0, -0.5], "turn": "b"},
        }
    }
    turns = {"a": np.array([90.0, 0, 0, 0, -90, 0, 0, 0]), "b": np.zeros(8)}
    frames = body_shapes._bone_frames(entry, turns, 0, "test")
    assert frames["lower", -1.0][1] == pytest.approx(
        [0.5, -0.1, 1.0]
    )  # raised forwards
    assert frames["lower", 1.0][1] == pytest.approx(
        [-0.5, 0.1, 1.0]
    )  # half a cycle behind


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"length_m": 1.2},
            "ball: got 1.200 x ahead to fit the box; expected outlines near",
        ),
        ({"parts": []}, "ball: got 0 pieces; expected parts that touch"),
        (
            {"parts": [*_entry()["parts"], {"spheres": [[0, 0, 5.0, 0.5]]}]},
            "ball: got 2 pieces; expected parts that touch",
        ),
        (
            {"parts": [{"cube": 1}]},
            "ball.parts[0]: got ['cube']; expected spheres, ring or wheel",
        ),
        (
            {"parts": [{"on": "tail", "spheres": [[0, 0, 0, 1]]}]},
            "ball.parts[0].on: got 'tail'; expected one of body",
        ),
        (
            {"turns_deg": {"hip": [1.0]}},
            "ball.turns_deg.hip: got shape (1,); expected shape (8,)",
        ),
        (
            {"bones": {"leg": {"on": "body", "joint_m": [0, 0, 0], "turn": "knee"}}},
            "ball.bones.leg.turn: got 'knee'; expected one of ",
        ),
    ],
)
def test_a_wrong_description_says_where(library, changes, message):
    with pytest.raises(InputError) as caught:
        build_shapes(_entry(**changes), "ball")
    assert str(caught.value).startswith(message)


def test_legs_that_are_too_short_for_the_pedals_are_refused():
    pedalling = {**TABLE["cyclist"]["pedalling"], "shin_m": 0.3}
    with refused_with(
        "cyclist.pedalling: got a foot that does not reach its pedal; expected"
        " longer legs"
    ):
        build_shapes({**TABLE["cyclist"], "pedalling": pedalling}, "cyclist")


def test_building_without_manifold3d_names_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "manifold3d", None)
    body_shapes._manifold3d.cache_clear()
    with pytest.raises(MissingExtraError, match="pip install manifold3d"):
        build_shapes(_entry(), "ball")
    body_shapes._manifold3d.cache_clear()
