"""Shapes of bodies, built as the table of actors says."""

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
    """The library that joins bodies; skips where it is not installed."""
    return pytest.importorskip("manifold3d")


def _entry(**changes):
    """A ball on a pole, 1 x 1 x 2 m."""
    pole = {
        "spheres": [
            [0, 0, 0.0, 0],
            [0.1, 0, 0, 0],
            [0, 0.1, 0, 0],
            [0, 0, 1.5, 0],
        ]
    }
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
@pytest.mark.parametrize("name", TABLE)
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
