"""Things from triangle meshes: glTF, OBJ, PLY, STL, OFF through trimesh."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..errors import check_one_of, refuse
from ..gltf import check_gltf, mesh_resolver
from ..opening import MAX_FILE_BYTES, open_file, reading
from ..scene import CLASS_NAMES
from ..text_formats import load_data
from .source_map import (
    MAX_TRIANGLES,
    SourceMap,
    Thing,
    counted,
    is_closed,
    kind_from_name,
    unique_id,
    volume_m3,
)

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")
UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048, "in": 0.0254}
UP_AXES: dict[str, list[list[int]]] = load_data("geometry.maps", "words.toml")[
    "up_axes"
]
_MIN_SIZE_M = 0.1
_MAX_SIZE_M = 20_000.0
_Part = tuple[str, FloatArray, NDArray[np.int32]]


def read_mesh(
    path: Path,
    *,
    unit: str | None = None,
    up: str | None = None,
    class_name: str = "building",
) -> SourceMap:
    """Read a mesh; every named part of it becomes a thing.

    glTF has metres, y up and -z as north; for all other formats unit and up
    axis must be given.

    Parameters
    ----------
    path : Path
        File to read.
    unit : str or None
        One of ``UNITS_M``; None: not given.
    up : str or None
        One of ``UP_AXES``; None: not given.
    class_name : str
        Class of parts whose names do not say wall, tree, lamp or the like.

    Returns
    -------
    source : SourceMap
        Things where the file has them.

    Raises
    ------
    InputError
        The file is damaged; has no triangles, or more than five million; or has a
        size that no junction has.
    """
    where = str(path)
    suffix = path.suffix.lower()
    check_one_of(where, suffix, SUFFIXES)
    check_one_of("class_name", class_name, CLASS_NAMES)
    is_gltf = suffix in (".glb", ".gltf")
    if not is_gltf and (not unit or not up):
        got = f"a mesh format ({suffix}) that does not say its unit and its up axis"
        refuse(where, got, "`unit` and `up`, such as `unit` m `up` z")
    # The units and axes of glTF.
    unit = unit or "m"
    up = up or "y"
    check_one_of("unit", unit, UNITS_M)
    check_one_of("up", up, UP_AXES)
    # One thing for each part, in metres and with z up.
    parts, left_out = _parts(path, is_gltf)
    axes = UNITS_M[unit] * np.array(UP_AXES[up], dtype=np.float64)
    ids: Counter[str] = Counter()
    things = []
    for name, vertices, triangles in parts:
        if _is_solid(vertices, triangles) and volume_m3(vertices, triangles) < 0.0:
            # So that it faces outwards.
            triangles = triangles[:, ::-1]
        its_class = class_name
        kind = kind_from_name(name)
        if kind:
            its_class = kind.class_name
        things.append(
            Thing.of(unique_id(name, ids), its_class, (vertices @ axes.T, triangles))
        )
    _check_size(things, where, unit)
    skipped = tuple(counted(left_out, "no mesh"))
    return SourceMap(name=path.name, crs="", things=tuple(things), skipped=skipped)


def _parts(path: Path, is_gltf: bool) -> tuple[list[_Part], Counter[str]]:
    """Parts of a mesh in the file's frame, and counts of what is no mesh.

    Parameters
    ----------
    path : Path
        File to read.
    is_gltf : bool
        The file is glTF.

    Returns
    -------
    parts : list of (str, (n, 3) float, (m, 3) int32)
        Name, vertices and triangles, sorted by name.
    left_out : Counter of str
        Kinds of geometry that have no triangles.
    """
    import trimesh

    where = str(path)
    suffix = path.suffix.lower()
    options: dict[str, Any] = {"skip_materials": True, "process": False}
    if suffix == ".obj":
        options["split_objects"] = True
    # Only a .gltf has its geometry in files beside it: its buffers.
    resolver = mesh_resolver(path, is_beside=path.suffix.lower() == ".gltf")
    options |= {"resolver": resolver, "skip_materials": True, "process": False}
    n_triangles = 0
    parts: list[_Part] = []
    left_out: Counter[str] = Counter()
    # trimesh's parsers raise whatever a broken file makes them.
    with reading(path, f"a {path.suffix} mesh", Exception):
        if is_gltf:
            check_gltf(path)
        with open_file(path, max_bytes=MAX_FILE_BYTES) as file:
            scene = trimesh.load_scene(
                file,
                file_type=suffix[1:],
                **options,
            )
        # Sorted below: trimesh keeps them in sets.
        for node in scene.graph.nodes_geometry:
            matrix, geometry_name = scene.graph[node]
            geometry = scene.geometry[geometry_name]
            if not isinstance(geometry, trimesh.Trimesh) or not len(geometry.faces):
                left_out[type(geometry).__name__.lower()] += 1
                continue
            # Refuse a mesh as soon as it is too large.
            n_triangles += len(geometry.faces)
            if n_triangles > MAX_TRIANGLES:
                refuse(
                    where,
                    f"more than {MAX_TRIANGLES:,} triangles",
                    "a simpler mesh",
                )
            if geometry.metadata.get("from_gltf_primitive"):
                # Itself named at random.
                node = scene.graph.transforms.parents.get(node, node)
            name = _name(str(node), str(geometry_name), path.stem)
            parts.append(
                (name, *_placed(geometry, np.asarray(matrix), f"{where}: {name}"))
            )
    if not parts:
        refuse(where, "no triangles", "a mesh of triangles")

    def name_and_place(part: _Part) -> tuple[str, list[float]]:
        """Key for sorting: equal names by their first vertex."""
        name, vertices, _ = part
        return name, vertices[0].tolist()

    return sorted(parts, key=name_and_place), left_out


def _placed(
    geometry: Any,
    matrix: FloatArray,
    where: str,
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Vertices and triangles of a geometry at its place in the scene.

    Parameters
    ----------
    geometry : Any
        Mesh of trimesh.
    matrix : (4, 4) float
        Transform from the geometry to the scene.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    vertices : (n, 3) float
        Those that triangles use, in the file's unit.
    triangles : (m, 3) int32
        Reversed if the transform mirrors.

    Raises
    ------
    InputError
        An index or a vertex makes no sense.
    """
    vertices: FloatArray = np.asarray(geometry.vertices, dtype=np.float64)
    faces = np.asarray(geometry.faces, dtype=np.int64)
    # A damaged file may name vertices that it does not have.
    outside = faces[(faces < 0) | (faces >= len(vertices))]
    if len(outside):
        refuse(
            where,
            f"a triangle with vertex {outside[0]}",
            f"0 to {len(vertices) - 1}",
        )
    # Keep only the vertices that triangles use.
    used, triangles = np.unique(faces, return_inverse=True)
    with np.errstate(all="ignore"):
        placed: FloatArray = vertices[used] @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(placed).all():
        refuse(where, "a vertex that is not finite (NaN or infinite)", "finite numbers")
    corners = triangles.reshape(-1, 3).astype(np.int32)
    is_mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
    if is_mirrored:
        corners = corners[:, ::-1]
    return placed, corners


def _is_solid(vertices: FloatArray, triangles: NDArray[np.int32]) -> bool:
    """True for a closed mesh, even if vertices in one place are not shared."""
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    shared = same.reshape(-1)[triangles]
    return is_closed(shared.astype(np.int32))


def _name(node: str, geometry: str, stem: str) -> str:
    """Name of a part: of its node, or of its geometry; else that of the file."""
    for name in (node, geometry):
        if any(letter.isalpha() for letter in name) and name not in (
            "world",
            "geometry_0",
        ):
            if name.lower().startswith(("geometry_", f"{stem.lower()}.")):
                return stem
            return name
    return stem


def _check_size(things: list[Thing], where: str, unit: str) -> None:
    """Refuse a size that only a wrong unit explains."""
    # The box around all things.
    low = np.min([thing.vertices_m.min(axis=0) for thing in things], axis=0)
    high = np.max([thing.vertices_m.max(axis=0) for thing in things], axis=0)
    size_m = float((high - low).max())
    if not _MIN_SIZE_M <= size_m <= _MAX_SIZE_M:
        got = f"a mesh {size_m:.3g} m across, taken in {unit}"
        limits = f"{_MIN_SIZE_M} m to {_MAX_SIZE_M / 1000:.0f} km"
        refuse(where, got, f"{limits}; another `unit` ({', '.join(UNITS_M)})")
