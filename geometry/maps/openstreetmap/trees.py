"""Trees as solids: a trunk and a crown."""

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ...arrays import FloatArray
from ..model import Thing
from .defaults import DEFAULTS
from .elements import Elements, Tags
from .network import known_runs
from .notes import Notes
from .tags import parse_length_m

_WOODS = (
    ("natural", "wood"),
    ("natural", "scrub"),
    ("landuse", "forest"),
)
_TRUNK_SIDES = 8


def find_trees(elements: Elements, positions_m: FloatArray, notes: Notes) -> Iterator[Thing]:
    """Trees of a file.

    Parameters
    ----------
    elements : Elements
        What the file has.
    positions_m : (n, 2) float
        Of its nodes. [m]
    notes : Notes
        Told of woods, whose trees nobody mapped.

    Yields
    ------
    tree : Thing
        An upright trunk and an ellipsoid as its crown, each closed.
    """
    for row, tags in elements.node_tags.items():
        if tags.get("natural") == "tree":
            element = f"node {int(elements.node_ids[row])}"
            name = f"n{int(elements.node_ids[row])}"
            yield _tree(name, positions_m[row], tags, element, notes)
    for way in elements.ways:
        element = f"way {way.id}"
        if way.tags.get("natural") == "tree_row":
            number = 0
            for rows in known_runs(way.rows, positions_m):
                for foot in _along(positions_m[rows]):
                    yield _tree(f"w{way.id} tree {number}", foot, way.tags, element, notes)
                    number += 1
        _note_wood(way.tags, element, notes)
    for relation in elements.relations:
        _note_wood(relation.tags, f"relation {relation.id}", notes)


def _note_wood(tags: Tags, element: str, notes: Notes) -> None:
    if any(tags.get(key) == value for key, value in _WOODS):
        notes.add("woods", element, "nothing says where in it trees and bushes stand")


def _along(line_m: FloatArray) -> FloatArray:
    """Where the trees of a row stand, evenly from its begin to its end, (n, 2)."""
    usual = DEFAULTS["tree"]
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(line_m, axis=0).T)))
    n_trees = min(round(float(along[-1]) / usual["row_spacing_m"]) + 1, usual["max_in_row"])
    stations = np.linspace(0.0, along[-1], max(n_trees, 2))
    feet: FloatArray = np.column_stack(
        [np.interp(stations, along, line_m[:, axis]) for axis in (0, 1)]
    )
    return feet


def _tree(name: str, foot_m: FloatArray, tags: Tags, element: str, notes: Notes) -> Thing:
    usual = DEFAULTS["tree"]

    def size_m(keys: tuple[str, ...], highest_m: float, usual_m: float) -> tuple[float, bool]:
        for key in keys:
            if key in tags:
                size = parse_length_m(tags[key])
                if size is not None and 0.05 <= size <= highest_m:
                    return size, False
                notes.add("trees", element, f"{key} makes no sense; the usual one taken")
        return usual_m, True

    height_m, is_assumed = size_m(
        ("height", "est_height"), usual["max_height_m"], usual["height_m"]
    )
    crown_m, _ = size_m(("diameter_crown",), usual["max_crown_m"], usual["crown_diameter_m"])
    girth_m, has_no_girth = size_m(("circumference",), np.pi * usual["max_trunk_m"], 0.0)
    trunk_m = usual["trunk_diameter_m"] if has_no_girth else girth_m / np.pi
    trunk_m = min(trunk_m, crown_m)
    base_m = min(usual["crown_base_m"], usual["crown_base_share"] * height_m)
    sphere, sphere_faces = _sphere()
    middle_m = 0.5 * (base_m + height_m)
    crown = sphere * [0.5 * crown_m, 0.5 * crown_m, height_m - middle_m] + [0.0, 0.0, middle_m]
    prism, prism_faces = _prism()
    trunk = prism * [0.5 * trunk_m, 0.5 * trunk_m, middle_m]
    return Thing(
        id=name,
        class_name="vegetation",
        vertices_m=np.concatenate([trunk, crown]) + np.append(foot_m, 0.0),
        triangles=np.concatenate([prism_faces, sphere_faces + len(prism)]),
        is_height_assumed=is_assumed,
    )


@cache
def _sphere() -> tuple[FloatArray, NDArray[np.int32]]:
    """A ball of radius 1 from 80 triangles."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(ball.vertices, dtype=np.float64), np.asarray(ball.faces, dtype=np.int32)


@cache
def _prism() -> tuple[FloatArray, NDArray[np.int32]]:
    """A trunk of radius 1 from height 0 to 1."""
    import trimesh

    prism = trimesh.creation.cylinder(
        radius=1.0, segment=[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], sections=_TRUNK_SIDES
    )
    return np.asarray(prism.vertices, dtype=np.float64), np.asarray(prism.faces, dtype=np.int32)
