"""Build the shapes of bodies: ``python -m geometry.body_shapes``.

The input is ``data/actors.toml``.

A body is a few bones that turn about the axis from right to left, and the union of
simple solids fixed to them. The result is kept in ``data/actors.npz``, so that only
this build needs manifold3d.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .actors import Shape, fingerprint
from .arrays import FloatArray, float_array
from .errors import InputError, MissingExtraError, refuse
from .tables import Table, pick, take, take_list, take_number, take_text
from .text_formats import load_toml
from .writing import write_atomically

DATA = Path(__file__).parent / "data"
# Per cycle of a gait.
_N_SHAPES = 8
# Radius below which a sphere's 12 vertices do; thicker ones have 42.
_THIN_M = 0.03
# Of a wheel.
_SECTIONS = 24
_TYRE_SECTIONS = 8
# Of the surface, when small triangles are merged.
_TOLERANCE_M = 2.0e-3
# The bone that nothing turns: trunk, frame of a bicycle, car.
_BODY = "body"
# Of a bone, in the frame of the body: rotation and joint.
_Frame = tuple[FloatArray, FloatArray]
_SIDES = (-1.0, 1.0)
_MAX_STRETCH = 0.04


def build_shapes(entry: Table, where: str) -> tuple[Shape, ...]:
    """Shapes of a body of ``data/actors.toml`` over one cycle of its gait.

    Each stands on the road, and together they fill exactly the body's box.

    Raises
    ------
    InputError
        The description is wrong; `where` names the body.
    MissingExtraError
        manifold3d is not installed.
    """
    turns_deg = _take_turns(entry, where)
    if turns_deg:
        n_shapes = _N_SHAPES
    else:
        n_shapes = 1
    meshes = [_build_mesh(entry, turns_deg, index, where) for index in range(n_shapes)]
    # The lowest point of each shape is on the road.
    for vertices, _ in meshes:
        vertices[:, 2] -= vertices[:, 2].min()
    fit = _fit_to_box(
        np.concatenate([vertices for vertices, _ in meshes]), entry, where
    )
    return tuple(
        Shape(vertices_m=fit(vertices).astype(np.float32), triangles=triangles)
        for vertices, triangles in meshes
    )


def save_shapes(path: Path, table: Table) -> None:
    """Build and save the shapes of a catalogue.

    :func:`geometry.actors.read_actors` reads the file.

    Raises
    ------
    InputError
        A body is described wrongly.
    MissingExtraError
        manifold3d is not installed.
    """
    arrays: dict[str, Any] = {"fingerprint": np.array(fingerprint(table))}
    for name, entry in table.items():
        shapes = build_shapes(entry, f"actors.toml: {name}")
        arrays[f"{name}/n_shapes"] = np.array(len(shapes))
        for index, shape in enumerate(shapes):
            kind = np.uint16 if len(shape.vertices_m) < 1 << 16 else np.uint32
            arrays[f"{name}/{index}/vertices_m"] = shape.vertices_m.astype(np.float32)
            arrays[f"{name}/{index}/triangles"] = shape.triangles.astype(kind)
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def main() -> None:
    """Build ``data/actors.npz`` from ``data/actors.toml``."""
    save_shapes(DATA / "actors.npz", load_toml(DATA / "actors.toml"))


# ---------- gait
def _take_turns(entry: Table, where: str) -> dict[str, FloatArray]:
    """Angles of the right side's joints, by name, in degrees.

    Each array has one angle per instant, (n_shapes,). Positive angles turn
    forwards.
    """
    turns: dict[str, FloatArray] = {
        name: float_array(row, (_N_SHAPES,), f"{where}.turns_deg.{name}")
        for name, row in entry.get("turns_deg", {}).items()
    }
    if "pedalling" in entry:
        turns |= _pedal(take(entry, "pedalling", where), f"{where}.pedalling")
    return turns


def _pedal(entry: Table, where: str) -> dict[str, FloatArray]:
    """Angles of a leg whose foot stays on the pedal, in degrees.

    The leg is two bars from hip to ankle; the knee bends forwards.

    Raises
    ------
    InputError
        The foot does not reach its pedal.
    """
    points = ("crank_shaft_m", "hip_m", "ankle_from_pedal_m")
    shaft, hip, from_pedal = (
        float_array(take_list(entry, key, where), (2,), f"{where}.{key}")
        for key in points
    )
    lengths = ("crank_m", "thigh_m", "shin_m")
    crank_m, thigh_m, shin_m = (take_number(entry, key, where) for key in lengths)
    foot_deg = take_number(entry, "foot_deg", where)
    first_deg = take_number(entry, "first_crank_deg", where)
    crank_deg: FloatArray = first_deg - np.linspace(
        0.0, 360.0, _N_SHAPES, endpoint=False
    )
    # The foot keeps its angle; the pedal turns around the crank shaft.
    ankle = (
        shaft
        + crank_m * _hanging(crank_deg)
        + _turn_deg(foot_deg)[::2, ::2] @ from_pedal
    )
    reach = np.hypot(*(ankle - hip).T)
    if (reach >= thigh_m + shin_m).any() or (reach <= abs(thigh_m - shin_m)).any():
        refuse(where, "a foot that does not reach its pedal", "longer legs")
    # Law of cosines; the knee bends forwards.
    at_hip = np.arccos((thigh_m**2 + reach**2 - shin_m**2) / (2.0 * thigh_m * reach))
    thigh_deg = _angle_deg(ankle - hip) + np.degrees(at_hip)
    shin_deg = _angle_deg(ankle - hip - thigh_m * _hanging(thigh_deg))
    return {
        "crank": crank_deg,
        "hip": thigh_deg,
        "knee": shin_deg - thigh_deg,
        "ankle": foot_deg - shin_deg,
    }


def _hanging(angle_deg: FloatArray) -> FloatArray:
    """Ahead and up, (n, 2), of a bar of length 1.

    At 0 degrees the bar hangs down; positive angles turn it forwards.
    """
    angle = np.radians(angle_deg)
    return np.stack([np.sin(angle), -np.cos(angle)], axis=-1)


def _angle_deg(bar: FloatArray) -> FloatArray:
    """The angle that :func:`_hanging` takes, of bars (n, 2) of any length."""
    return np.degrees(np.arctan2(bar[:, 0], -bar[:, 1]))


def _turn_deg(angle_deg: float) -> FloatArray:
    """Rotation about the axis from left to right, (3, 3).

    A positive angle turns what hangs forwards.
    """
    cos = np.cos(np.radians(angle_deg))
    sin = np.sin(np.radians(angle_deg))
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def _bone_frames(
    entry: Table, turns_deg: Mapping[str, FloatArray], index: int, where: str
) -> dict[tuple[str, float], _Frame]:
    """Frame of each bone on the left (1.0) and on the right (-1.0) at one instant."""
    frames: dict[tuple[str, float], _Frame] = {
        (_BODY, side): (np.eye(3), np.zeros(3)) for side in _SIDES
    }
    for name, bone in entry.get("bones", {}).items():
        here = f"{where}.bones.{name}"
        turn = pick(turns_deg, take_text(bone, "turn", here), f"{here}.turn")
        joint = float_array(take_list(bone, "joint_m", here), (3,), f"{here}.joint_m")
        for side in _SIDES:
            known = {
                bone_name: frame
                for (bone_name, at), frame in frames.items()
                if at == side
            }
            rotation, origin = pick(known, take_text(bone, "on", here), f"{here}.on")
            # The left side does what the right side did half a cycle ago.
            angle_deg = turn[
                index if side < 0.0 else (index + _N_SHAPES // 2) % _N_SHAPES
            ]
            place = origin + rotation @ (joint * [1.0, side, 1.0])
            frames[name, side] = rotation @ _turn_deg(float(angle_deg)), place
    return frames


# ---------- solids
def _build_mesh(
    entry: Table, turns_deg: Mapping[str, FloatArray], index: int, where: str
) -> tuple[FloatArray, NDArray[np.int32]]:
    """One closed mesh of all parts at one instant: vertices and triangles."""
    frames = _bone_frames(entry, turns_deg, index, where)
    library = _manifold3d()
    # Parts are put together in the order of the file: later ones may cut earlier
    # ones.
    body = library.Manifold()
    for number, part in enumerate(take_list(entry, "parts", where)):
        solids = list(_place_part(part, frames, f"{where}.parts[{number}]"))
        if part.get("cut", False):
            operation = library.OpType.Subtract
        else:
            operation = library.OpType.Add
        body = library.Manifold.batch_boolean([body, *solids], operation)
    pieces = body.simplify(_TOLERANCE_M).decompose()
    # The rest are hollows inside.
    outside = [piece for piece in pieces if piece.volume() > 0.0]
    if len(outside) != 1:
        refuse(where, f"{len(outside)} pieces", "parts that touch")
    mesh = outside[0].to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(
        mesh.tri_verts, dtype=np.int32
    )


def _place_part(
    part: Table, frames: Mapping[tuple[str, float], _Frame], where: str
) -> Iterator[Any]:
    """Solids of one part: one, or one on each side."""
    on = part.get("on", _BODY)
    known = {bone: bone for bone, _ in frames}
    is_twice = pick(known, on, f"{where}.on") != _BODY or part.get("mirror", False)
    vertices, triangles = _solid(part, where)
    for side in _SIDES if is_twice else (1.0,):
        rotation, origin = frames[on, side]
        placed = (vertices * [1.0, side, 1.0]) @ rotation.T + origin
        library = _manifold3d()
        # a mirror turns them inside out
        if side > 0.0:
            faces = triangles
        else:
            faces = triangles[:, ::-1]
        mesh = library.Mesh64(vert_properties=placed, tri_verts=faces.astype(np.uint64))
        yield library.Manifold(mesh)


def _solid(part: Table, where: str) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices and triangles of one part in the frame of its bone."""
    import trimesh

    if "spheres" in part:
        spheres = float_array(
            take_list(part, "spheres", where), (-1, 4), f"{where}.spheres"
        )
        is_thin = bool(spheres[:, 3].max() < _THIN_M)
        ball = trimesh.creation.icosphere(subdivisions=0 if is_thin else 1).vertices
        points = spheres[:, None, :3] + spheres[:, None, 3:] * ball
        mesh = trimesh.convex.convex_hull(points.reshape(-1, 3))
        return np.array(mesh.vertices), np.array(mesh.faces)
    if "ring" in part:
        kind = "ring"
    else:
        kind = "wheel"
    if kind not in part:
        raise InputError(where, sorted(part), "spheres, ring or wheel")
    wheel = part[kind]
    where = f"{where}.{kind}"
    radius_m = take_number(wheel, "radius", where)
    if kind == "ring":
        tyre_m = take_number(wheel, "tyre", where)
        mesh = trimesh.creation.torus(
            radius_m - tyre_m, tyre_m, _SECTIONS, _TYRE_SECTIONS
        )
    else:
        width_m = take_number(wheel, "width", where)
        mesh = trimesh.creation.cylinder(
            radius=radius_m, height=width_m, sections=_SECTIONS
        )
    # trimesh lays wheels flat; these stand, axle along y.
    mesh.apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 2.0, [1.0, 0.0, 0.0])
    )
    centre = float_array(take_list(wheel, "centre", where), (3,), f"{where}.centre")
    return np.array(mesh.vertices) + centre, np.array(mesh.faces)


def _fit_to_box(
    vertices: FloatArray, entry: Table, where: str
) -> Callable[[FloatArray], FloatArray]:
    """Stretch of all shapes together to the box, in which the reference point stays."""
    length, width, height = (
        take_number(entry, f"{side}_m", where) for side in ("length", "width", "height")
    )
    reference_m = float(entry.get("reference_ahead_m", 0.0))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    ahead = (0.5 * length - reference_m) / high[0]
    behind = (0.5 * length + reference_m) / -low[0]
    across = width / (high[1] - low[1])
    up = height / high[2]
    factors = {"ahead": ahead, "behind": behind, "across": across, "up": up}
    for name, factor in factors.items():
        if abs(factor - 1.0) > _MAX_STRETCH:
            refuse(
                where, f"{factor:.3f} x {name} to fit the box", "outlines near its size"
            )

    def fit(points: FloatArray) -> FloatArray:
        # Ahead of the reference point and behind it the stretch differs.
        x = points[:, 0] * np.where(points[:, 0] > 0.0, ahead, behind) + reference_m
        y = (points[:, 1] - 0.5 * (low[1] + high[1])) * across
        return np.stack([x, y, points[:, 2] * up], axis=1)

    return fit


@cache
def _manifold3d() -> Any:
    """The module manifold3d, which only this build needs.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        return import_module("manifold3d")
    except ModuleNotFoundError:
        raise MissingExtraError(
            "building shapes needs manifold3d: pip install manifold3d==3.5.4"
        ) from None


if __name__ == "__main__":
    main()
