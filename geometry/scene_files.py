"""Scenes from disk and to it, as folders and archives.

A scene's folder has ``scene.toml`` for people (name, coordinate reference systems,
lanes, crosswalks, outline, sites, the list of things and what the import left out) and
``things.glb`` for every 3-D viewer: glTF 2.0 with one mesh per thing, under its id. The
TOML is in the world frame, east, north, up in metres; the mesh file in glTF's own, y
up.
"""

import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from msgspec import Struct, structs

from .archives import refuse_bomb
from .arrays import FloatArray, Point2, Points2
from .errors import InputError, Unquoted, refuse
from .frames import check_crs, from_gltf_points, to_gltf_points
from .gltf import check_gltf, mesh_resolver
from .notes import Kind, Note
from .opening import check_file, open_file, reading
from .phrases import Phrase, pack_phrase, unpack_phrase
from .scene import Instance, Lane, LeadingRoad, Scene, Site, join_bodies
from .scene_sources import SCENE_FILE
from .study_scene import CrosswalkEntry, crosswalk_lines
from .tables import Text, read_table
from .text_formats import MAX_TOML_BYTES, load_toml
from .writing import open_new, write_atomically

FORMAT = "place-rsus scene"
VERSION = 1
THINGS_FILE = "things.glb"
# Five million triangles.
_MAX_BYTES = {
    SCENE_FILE: MAX_TOML_BYTES,
    THINGS_FILE: 300_000_000,
}
_MILLIMETRES = 3
_HEAD = """\
# A junction for place-rsus: place-rsus --scene THIS_FOLDER --budget 3
# East, north and height above the road in metres. \
Things are meshes in things.glb, under their ids.
# To change by hand: sites (where sensors may hang), crosswalks, lanes.
"""
_LANE_FIELDS = ["id", "kind", "width_m", "centreline_m"]
_SITE_FIELDS = [
    "id",
    "kind",
    "position_m",
    "height_range_m",
    "capacity_units",
    "cost_eur",
    "use",
]
_ROAD_FIELDS = ["name", "point_m", "direction", "lanes_in", "lanes_out"]


class _Thing(Struct, frozen=True, kw_only=True, rename={"class_name": "class"}):
    id: Text
    class_name: Text
    is_height_assumed: bool = False


class _SavedNote(Struct, frozen=True, kw_only=True):
    """A note, with the phrases that its texts were made of, if any."""

    what: Text
    why: Text
    kind: Kind = "left out"
    site_ids: tuple[Text, ...] = ()
    phrases: tuple[Any, ...] = ()


class _FolderScene(Struct, frozen=True, kw_only=True):
    name: Text
    crs: str
    source_crs: str
    source_origin_m: Point2
    zero_height_m: float | None = None
    keeps_left: bool
    road_network: str = ""
    outline_m: Points2
    lanes: tuple[Lane, ...]
    crosswalks: tuple[CrosswalkEntry, ...]
    sites: tuple[Site, ...]
    things: tuple[_Thing, ...]
    skipped: tuple[_SavedNote, ...]
    roads: tuple[LeadingRoad, ...] = ()
    islands_m: tuple[Points2, ...] = ()


def save_scene(
    folder: str | Path, scene: Scene, *, sources: Sequence[str] = ()
) -> None:
    """Write ``scene.toml`` and ``things.glb`` into a folder that exists.

    ``scene.toml`` is exact to a millimetre. `sources` are names of the files
    that the scene was made from.

    Raises
    ------
    OSError
        The system refuses to write.
    """
    import tomlkit

    folder = Path(folder)
    table = {
        "format": FORMAT,
        "version": VERSION,
        "name": scene.name,
        "crs": scene.crs,
        "source_crs": scene.source_crs,
        "source_origin_m": scene.source_origin_m.tolist(),
        **(
            {}
            if scene.zero_height_m is None
            else {"zero_height_m": scene.zero_height_m}
        ),
        "keeps_left": scene.keeps_left,
        "road_network": scene.road_network,
        "sources": list(sources),
        "outline_m": _rounded(scene.outline_m),
        **_island_entries(scene),
        "lanes": [
            _entry(lane, *_LANE_FIELDS)
            | (
                {"speed_limit_kmh": lane.speed_limit_kmh}
                if lane.speed_limit_kmh
                else {}
            )
            | ({"turns": list(lane.turns)} if lane.turns else {})
            | ({"closed_to": list(lane.closed_to)} if lane.closed_to else {})
            for lane in scene.lanes
        ],
        "crosswalks": [{"ends_m": _rounded(line)} for line in scene.crosswalks_m],
        "sites": [_site_entry(site) for site in scene.sites],
        "things": [
            {"id": thing.id, "class": thing.class_name}
            | ({"is_height_assumed": True} if thing.is_height_assumed else {})
            for thing in scene.instances
        ],
        "skipped": [_note_entry(note) for note in scene.notes],
        "roads": [_entry(road, *_ROAD_FIELDS) for road in scene.roads],
    }
    # The file with the meshes comes first: a folder without scene.toml is no scene.
    text = _HEAD + tomlkit.dumps(table)
    write_atomically(folder / THINGS_FILE, _to_glb(scene))
    write_atomically(folder / SCENE_FILE, text)


def read_saved_scene(path: Path, **_: object) -> Scene:
    """Scene of :func:`load_scene_folder`, as a :class:`.scene_sources.SceneReader`."""
    return load_scene_folder(path)


def load_scene_folder(path: Path) -> Scene:
    """Scene that :func:`save_scene` has written into a folder or packed as .zip.

    Raises
    ------
    InputError
        It is no such folder, a field is missing or not of its kind, or the meshes do
        not fit.
    """
    where = f"{path}/{SCENE_FILE}"
    with _as_folder(path) as folder:
        with _named(path):
            table = _read_scene_file(folder, shown=path)
        meshes = _read_glb(folder / THINGS_FILE, shown=f"{path}/{THINGS_FILE}")
    bodies = []
    for index, thing in enumerate(table.things):
        instance = Instance(
            id=thing.id,
            class_name=thing.class_name,
            is_height_assumed=thing.is_height_assumed,
        )
        if thing.id not in meshes:
            expected = f"the name of a mesh in {THINGS_FILE}"
            raise InputError(f"{where}: things[{index}]", thing.id, expected)
        bodies.append((instance, *meshes[thing.id]))
    if not bodies:
        refuse(f"{where}: things", "none", "at least the ground")
    # An unknown reference system would be found out only when results are written.
    for key, crs in (("crs", table.crs), ("source_crs", table.source_crs)):
        check_crs(crs, f"{where}: {key}")
    fields = structs.asdict(table)
    for name in (
        "crosswalks",
        "things",
        "skipped",
    ):
        # These have other forms in a scene.
        del fields[name]
    with _named(path):
        notes = tuple(
            _read_note(note, f"{where}: skipped[{index}]")
            for index, note in enumerate(table.skipped)
        )
        return Scene(
            **fields,
            **join_bodies(bodies),
            crosswalks_m=crosswalk_lines(line.ends_m for line in table.crosswalks),
            notes=notes,
        )


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name the scene's file in refusals that do not name it yet."""
    try:
        yield
    except InputError as error:
        if error.where.startswith(str(path)):
            raise
        where = f"{path}/{SCENE_FILE}: {error.where}"
        raise InputError(where, error.got, error.expected) from None


def _island_entries(scene: Scene) -> dict[str, Any]:
    """Islands of a roundabout as ``scene.toml`` has them; other scenes have none."""
    if not scene.islands_m:
        return {}
    return {"islands_m": [_rounded(island_m) for island_m in scene.islands_m]}


def _note_entry(note: Note) -> dict[str, Any]:
    """A note as ``scene.toml`` has it: English, and phrases to translate."""
    entry: dict[str, Any] = {"what": str(note.what), "why": str(note.why)}
    if note.kind != "left out":
        entry["kind"] = note.kind
    if note.site_ids:
        entry["site_ids"] = list(note.site_ids)
    packed = [pack_phrase(text) for text in (note.what, note.why)]
    if any(isinstance(one, list) for one in packed):
        entry["phrases"] = packed
    return entry


def _read_note(saved: _SavedNote, where: str) -> Note:
    """The note that was saved; texts that were changed by hand since are plain."""
    texts = [Phrase(saved.what), Phrase(saved.why)]
    if saved.phrases:
        try:
            what, why = map(unpack_phrase, saved.phrases)
        except (ValueError, TypeError, KeyError, AttributeError):
            shown = Unquoted("others")
            raise InputError(
                f"{where}.phrases", shown, "those of what and why"
            ) from None
        saved_phrases = zip((what, why), texts, strict=True)
        texts = [phrase if phrase == text else text for phrase, text in saved_phrases]
    what, why = texts
    return Note(what, why, kind=saved.kind, site_ids=saved.site_ids)


def _read_scene_file(folder: Path, *, shown: Path) -> _FolderScene:
    """``scene.toml`` of a folder, with format and version checked first."""
    path = folder / SCENE_FILE
    where = f"{shown}/{SCENE_FILE}"
    if not path.is_file():
        refuse(str(shown), f"no {SCENE_FILE}", "a folder of an imported scene")
    table = load_toml(path)
    for key, wanted, remedy in (
        ("format", FORMAT, ""),
        ("version", VERSION, "; import the scene again"),
    ):
        if table.get(key) != wanted:
            raise InputError(f"{where}: {key}", table.get(key), f"{wanted!r}{remedy}")
    return read_table(table, _FolderScene, where)


def pack_scene(folder: Path, archive: Path) -> None:
    """Write a scene's folder as one .zip file."""

    def write(file: Any) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed:
            for name in (SCENE_FILE, THINGS_FILE):
                packed.write(folder / name, name)

    write_atomically(archive, write)


@contextmanager
def _as_folder(path: Path) -> Iterator[Path]:
    """The folder itself, or a temporary one with what a .zip file holds.

    The temporary folder is there for as long as the block runs.
    """
    if not path.exists():
        refuse(str(path), "nothing there", "a scene: a folder or .zip file")
    if path.is_dir():
        yield path
        return
    with tempfile.TemporaryDirectory() as temporary:
        # RuntimeError: it is encrypted, or packed in a way that Python cannot unpack.
        damage = (
            OSError,
            EOFError,
            ValueError,
            KeyError,
            zipfile.BadZipFile,
            zlib.error,
        )
        with (
            reading(path, "a scene: a folder or .zip file", *damage, RuntimeError),
            open_file(path) as file,
            zipfile.ZipFile(file) as packed,
        ):
            for name, max_bytes in _MAX_BYTES.items():
                with packed.open(name) as member:
                    # Of the archive only these two are read.
                    _unpack(member, Path(temporary) / name, path, max_bytes)
        yield Path(temporary)


def _unpack(member: IO[bytes], target: Path, archive: Path, max_bytes: int) -> None:
    """Write a file of an archive; sizes that the archive states are not trusted."""
    n_bytes = 0
    with open_new(target) as sink:
        while chunk := member.read(1 << 20):
            n_bytes += len(chunk)
            if n_bytes > max_bytes:
                got = f"more than {max_bytes:,} bytes"
                refuse(f"{archive}/{target.name}", got, "a scene of one junction")
            refuse_bomb(n_bytes, str(archive))
            sink.write(chunk)


def _site_entry(site: Site) -> dict[str, Any]:
    """A site as ``scene.toml`` has it."""
    names = [*_SITE_FIELDS]
    if site.surveyed_m is not None:
        names.append("surveyed_m")
    return _entry(site, *names)


def _entry(value: object, *names: str) -> dict[str, Any]:
    """Fields of a value, lengths rounded to a millimetre."""
    fields = {name: getattr(value, name) for name in names}
    return {
        key: _rounded(one) if isinstance(one, np.ndarray) or key.endswith("_m") else one
        for key, one in fields.items()
    }


def _rounded(array: FloatArray) -> Any:
    """Nested lists of an array, rounded to a millimetre."""
    # Adding 0 turns minus zero into zero.
    return (np.round(array, _MILLIMETRES) + 0.0).tolist()


def _to_glb(scene: Scene) -> bytes:
    """Meshes of all things of a scene as a .glb file, y up."""
    import trimesh

    meshes = trimesh.Scene()
    for index, instance in enumerate(scene.instances):
        corners = scene.triangles[scene.triangle_instance == index]
        used, faces = np.unique(corners, return_inverse=True)
        vertices = to_gltf_points(scene.vertices_m[used])
        mesh = trimesh.Trimesh(
            vertices=vertices, faces=faces.reshape(-1, 3), process=False
        )
        meshes.add_geometry(mesh, geom_name=instance.id, node_name=instance.id)
    data: bytes = meshes.export(file_type="glb")
    return data


def _read_glb(path: Path, *, shown: str) -> dict[str, tuple[FloatArray, np.ndarray]]:
    """Vertices (n, 3) and triangles (m, 3) of a .glb file, by name.

    Vertices are in the world frame, in metres. `shown` is the file's name for
    messages.

    Raises
    ------
    InputError
        The file is missing, is no glTF 2, or has vertices that are not finite.
    """
    import trimesh

    if not path.is_file():
        refuse(shown, "nothing there", "the meshes of the scene")
    check_file(path, max_bytes=_MAX_BYTES[THINGS_FILE])
    try:
        # A header that claims more would be given memory.
        check_gltf(path)
        resolver = mesh_resolver(path, where=shown)
        options = {"resolver": resolver, "skip_materials": True, "process": False}
        with open_file(path) as file:
            loaded = trimesh.load_scene(file, file_type="glb", **options)
        meshes = {
            str(name): (
                from_gltf_points(mesh.vertices),
                np.asarray(mesh.faces, dtype=np.int32),
            )
            for name, mesh in loaded.geometry.items()
        }
    except InputError as error:
        where = error.where.replace(str(path), shown)
        raise InputError(
            where, error.got, f"glTF 2.0 (.glb): {error.expected}"
        ) from None
    except Exception as error:
        # Trimesh raises whatever its parts do.
        got = Unquoted(f"{type(error).__name__}: {error}")
        raise InputError(shown, got, "glTF 2.0 (.glb)") from None
    for name, (vertices, _) in meshes.items():
        if not np.isfinite(vertices).all():
            refuse(f"{shown}: {name}", "vertices that are not finite", "metres")
    return meshes
