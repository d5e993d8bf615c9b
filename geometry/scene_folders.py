"""Scenes to and from a folder: ``scene.toml`` for people, ``things.glb`` for every 3-D viewer.

``scene.toml`` has name, coordinate reference systems, lanes, crosswalks, outline, sites, the list
of things and what the import left out; ``things.glb`` is glTF 2.0 with one mesh per thing, under
its id. World frame in the TOML: east, north, up in metres; glTF's own (y up) in the mesh file.
"""

import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from .arrays import FloatArray, float_array
from .errors import InputError, Unquoted
from .files import (
    Table,
    load_toml,
    take,
    take_list,
    take_number,
    take_text,
    write_atomically,
)
from .frames import from_gltf_points, to_gltf_points
from .scene import (
    Instance,
    Lane,
    Scene,
    Site,
)
from .scene_files import load_study_scene

FORMAT, VERSION = "place-rsus scene", 1
SCENE_FILE, THINGS_FILE = "scene.toml", "things.glb"
_MAX_BYTES = {SCENE_FILE: 100_000_000, THINGS_FILE: 1_000_000_000}
_MILLIMETRES = 3
_HEAD = """\
# A junction for place-rsus: place-rsus --scene THIS_FOLDER --budget 3
# East, north and height above the road in metres. Things are meshes in things.glb, under their ids.
# To change by hand: sites (where sensors may hang), crosswalks, lanes.
"""


def save_scene(
    folder: Path,
    scene: Scene,
    *,
    sources: Sequence[str] = (),
    skipped: Sequence[tuple[str, str]] = (),
    assumed_heights: Sequence[str] = (),
) -> None:
    """Write a scene.

    Parameters
    ----------
    folder : Path
        It must exist; its ``scene.toml`` and ``things.glb`` are replaced.
    scene : Scene
        What to write; coordinates are rounded to a millimetre, meshes to single precision.
    sources : sequence of str
        Names of the files that it was made from.
    skipped : sequence of (str, str)
        What of them was left out, and why.
    assumed_heights : sequence of str
        Ids of things whose heights the sources do not say.

    Raises
    ------
    OSError
        The folder cannot be written to.
    """
    import tomlkit

    table = {
        "format": FORMAT,
        "version": VERSION,
        "name": scene.name,
        "crs": scene.crs,
        "source_crs": scene.source_crs,
        "source_origin_m": scene.source_origin_m.tolist(),
        "keeps_left": scene.keeps_left,
        "road_network": scene.road_network,
        "sources": list(sources),
        "outline_m": _rounded(scene.outline_m),
        "lanes": [
            {
                "id": lane.id,
                "kind": lane.kind,
                "width_m": round(lane.width_m, _MILLIMETRES),
                "centreline_m": _rounded(lane.centreline_m),
            }
            for lane in scene.lanes
        ],
        "crosswalks": [{"ends_m": _rounded(line)} for line in scene.crosswalks_m],
        "sites": [
            {
                "id": site.id,
                "kind": site.kind,
                "position_m": _rounded(site.position_m),
                "height_range_m": _rounded(site.height_range_m),
                "capacity_units": site.capacity_units,
                "cost_eur": site.cost_eur,
                "use": site.use,
            }
            for site in scene.sites
        ],
        "things": [
            {"id": thing.id, "class": thing.class_name}
            | ({"is_height_assumed": True} if thing.id in assumed_heights else {})
            for thing in scene.instances
        ],
        "skipped": [{"what": what, "why": why} for what, why in skipped],
    }
    text = _HEAD + tomlkit.dumps(table)
    glb = _to_glb(scene)
    write_atomically(folder / THINGS_FILE, lambda file: file.write(glb))
    write_atomically(folder / SCENE_FILE, lambda file: file.write(text.encode()))


def find_scene(path: str) -> Scene:
    """A scene from where ``scene import`` has written it; no path: the study's junction.

    Raises
    ------
    InputError
        There is no scene.
    """
    return load_scene_folder(Path(path)) if path else load_study_scene()


def load_scene_folder(path: Path) -> Scene:
    """Read a scene.

    Parameters
    ----------
    path : Path
        A folder that :func:`save_scene` has written, or the same as a .zip file.

    Returns
    -------
    scene : Scene
        As it was, but for rounding.

    Raises
    ------
    InputError
        It is no such folder, a field is missing or not of its kind, or the meshes do not fit.
    """
    with _as_folder(path) as folder:
        table, where = read_scene_table(folder, shown=path), f"{path}/{SCENE_FILE}"
        meshes = _read_glb(folder / THINGS_FILE, shown=f"{path}/{THINGS_FILE}")
    things = list(_tables(table, "things", where))
    instances, vertices, triangles = [], [], []
    for entry, here in things:
        instance = Instance(
            id=take_text(entry, "id", here), class_name=take_text(entry, "class", here)
        )
        if instance.id not in meshes:
            raise InputError(here, instance.id, f"the name of a mesh in {THINGS_FILE}")
        instances.append(instance)
        vertices.append(meshes[instance.id][0])
        triangles.append(meshes[instance.id][1])
    if not instances:
        raise InputError(f"{where}: things", Unquoted("none"), "at least the ground")
    first = np.cumsum([0, *map(len, vertices)])
    crs, source_crs = (_crs(table, key, where) for key in ("crs", "source_crs"))
    keeps_left = take(table, "keeps_left", where)
    if not isinstance(keeps_left, bool):
        raise InputError(f"{where}.keeps_left", keeps_left, "true or false")
    return Scene(
        name=take_text(table, "name", where),
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(
            [faces + start for faces, start in zip(triangles, first[:-1], strict=True)]
        ),
        triangle_instance=np.repeat(np.arange(len(instances)), [len(faces) for faces in triangles]),
        instances=tuple(instances),
        sites=tuple(_read_site(entry, here) for entry, here in _tables(table, "sites", where)),
        outline_m=float_array(take_list(table, "outline_m", where), (-1, 2), f"{where}: outline_m"),
        lanes=tuple(_read_lane(entry, here) for entry, here in _tables(table, "lanes", where)),
        crs=crs,
        crosswalks_m=np.array(
            [
                float_array(take_list(entry, "ends_m", here), (2, 2), f"{here}.ends_m")
                for entry, here in _tables(table, "crosswalks", where)
            ]
        ).reshape(-1, 2, 2),
        road_network=str(table.get("road_network", "")),
        keeps_left=keeps_left,
        source_crs=source_crs,
        source_origin_m=float_array(
            take_list(table, "source_origin_m", where), (2,), f"{where}: source_origin_m"
        ),
    )


def load_notes(path: Path) -> tuple[list[tuple[str, str]], set[str]]:
    """What the import of a scene left out, and the things whose heights were assumed.

    Parameters
    ----------
    path : Path
        As for :func:`load_scene_folder`.

    Returns
    -------
    skipped : list of (str, str)
        What, and why.
    assumed : set of str
        Ids of things.

    Raises
    ------
    InputError
        As :func:`load_scene_folder`.
    """
    with _as_folder(path) as folder:
        table, where = read_scene_table(folder, shown=path), f"{path}/{SCENE_FILE}"
    skipped = [
        (take_text(entry, "what", here), take_text(entry, "why", here))
        for entry, here in _tables(table, "skipped", where)
    ]
    assumed = {
        take_text(entry, "id", here)
        for entry, here in _tables(table, "things", where)
        if entry.get("is_height_assumed") is True
    }
    return skipped, assumed


def read_scene_table(folder: Path, *, shown: Path) -> dict[str, Any]:
    """``scene.toml`` of a folder, with format and version checked.

    Raises
    ------
    InputError
        There is none, or it is of another format or version.
    """
    path = folder / SCENE_FILE
    where = f"{shown}/{SCENE_FILE}"
    if not path.is_file():
        raise InputError(str(shown), Unquoted(f"no {SCENE_FILE}"), "a folder of `scene import`")
    _check_bytes(path, where)
    table = load_toml(path)
    if table.get("format") != FORMAT:
        raise InputError(f"{where}: format", table.get("format"), repr(FORMAT))
    if table.get("version") != VERSION:
        raise InputError(
            f"{where}: version", table.get("version"), f"{VERSION}; import the scene again"
        )
    return table


def pack_scene(folder: Path, archive: Path) -> None:
    """A scene's folder as one .zip file.

    Raises
    ------
    OSError
        It cannot be written.
    """

    def write(file: Any) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
            for name in (SCENE_FILE, THINGS_FILE):
                packed.write(folder / name, name)

    write_atomically(archive, write)


@contextmanager
def _as_folder(path: Path) -> Iterator[Path]:
    """The folder itself, or what a .zip file of it holds, for as long as it is needed."""
    if not path.exists():
        raise InputError(str(path), Unquoted("nothing there"), "a scene: a folder or .zip file")
    if path.is_dir():
        yield path
        return
    with tempfile.TemporaryDirectory() as temporary:
        try:
            with zipfile.ZipFile(path) as packed:
                for name, max_bytes in _MAX_BYTES.items():
                    with packed.open(name) as member:  # of the archive only these two are read
                        data = member.read(max_bytes + 1)
                    if len(data) > max_bytes:
                        raise InputError(
                            f"{path}/{name}",
                            Unquoted(f"more than {max_bytes:,} bytes"),
                            "a scene of one junction",
                        )
                    (Path(temporary) / name).write_bytes(data)
        except KeyError as error:
            raise InputError(str(path), Unquoted(error.args[0]), "a scene as .zip") from None
        except (OSError, zipfile.BadZipFile, NotImplementedError, EOFError, ValueError) as error:
            raise InputError(str(path), Unquoted(error), "a scene: a folder or .zip file") from None
        yield Path(temporary)


# ---------------------------------------------------------------- parts


def _rounded(array: FloatArray) -> Any:
    # Adding 0 turns minus zero into zero.
    return (np.round(array, _MILLIMETRES) + 0.0).tolist()


def _tables(table: Table, key: str, where: str) -> Iterator[tuple[Table, str]]:
    for index, entry in enumerate(take_list(table, key, where)):
        here = f"{where}: {key}[{index}]"
        if not isinstance(entry, Mapping):
            raise InputError(here, entry, "a table")
        yield entry, here


def _read_lane(entry: Table, where: str) -> Lane:
    return Lane(
        id=take_text(entry, "id", where),
        kind=take_text(entry, "kind", where),
        width_m=take_number(entry, "width_m", where),
        centreline_m=float_array(
            take_list(entry, "centreline_m", where), (-1, 2), f"{where}.centreline_m"
        ),
    )


def _read_site(entry: Table, where: str) -> Site:
    return Site(
        id=take_text(entry, "id", where),
        position_m=float_array(take_list(entry, "position_m", where), (3,), f"{where}.position_m"),
        kind=take_text(entry, "kind", where),
        height_range_m=float_array(
            take_list(entry, "height_range_m", where), (2,), f"{where}.height_range_m"
        ),
        capacity_units=take(entry, "capacity_units", where),
        cost_eur=take_number(entry, "cost_eur", where) if "cost_eur" in entry else 0.0,
        use=str(entry.get("use", "free")),
    )


def _crs(table: Table, key: str, where: str) -> str:
    """A coordinate reference system that pyproj takes, or none."""
    text = take(table, key, where)
    if not isinstance(text, str):
        raise InputError(f"{where}: {key}", text, "text")
    if text:
        from pyproj import CRS
        from pyproj.exceptions import CRSError

        try:
            CRS.from_user_input(text)
        except CRSError:
            raise InputError(f"{where}: {key}", text, "one that pyproj knows, or none") from None
    return text


def _check_bytes(path: Path, where: str) -> None:
    n_bytes = path.stat().st_size
    if n_bytes > _MAX_BYTES[path.name]:
        raise InputError(
            where, Unquoted(f"{n_bytes:,} bytes"), f"at most {_MAX_BYTES[path.name]:,}"
        )


# ---------------------------------------------------------------- meshes


def _to_glb(scene: Scene) -> bytes:
    import trimesh

    meshes = trimesh.Scene()
    for index, instance in enumerate(scene.instances):
        corners = scene.triangles[scene.triangle_instance == index]
        used, faces = np.unique(corners, return_inverse=True)
        mesh = trimesh.Trimesh(
            vertices=to_gltf_points(scene.vertices_m[used]),
            faces=faces.reshape(-1, 3),
            process=False,
        )
        meshes.add_geometry(mesh, geom_name=instance.id, node_name=instance.id)
    data: bytes = meshes.export(file_type="glb")
    return data


def _read_glb(path: Path, *, shown: str) -> dict[str, tuple[FloatArray, np.ndarray]]:
    import trimesh

    if not path.is_file():
        raise InputError(shown, Unquoted("nothing there"), "the meshes of the scene")
    _check_bytes(path, shown)
    try:
        loaded = trimesh.load_scene(path, file_type="glb", process=False)
        meshes = {
            str(name): (from_gltf_points(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32))
            for name, mesh in loaded.geometry.items()
        }
    except Exception as error:  # trimesh raises whatever its parts do
        raise InputError(
            shown, Unquoted(f"{type(error).__name__}: {error}"), "glTF 2.0 (.glb)"
        ) from None
    for name, (vertices, _) in meshes.items():
        if not np.isfinite(vertices).all():
            raise InputError(f"{shown}: {name}", Unquoted("vertices that are not finite"), "metres")
    return meshes
