"""``place-rsus scene``: import scenes, show them, check them."""

import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from geometry.errors import InputError, Unquoted
from geometry.files import check_target, read_bytes
from geometry.maps.importing import (
    ImportedScene,
    ImportOptions,
    ReadingOptions,
    import_scene,
    read_maps,
)
from geometry.maps.junctions import sort_junctions
from geometry.maps.place_lists import SUFFIXES as LISTS
from geometry.scene import Scene
from geometry.scene_checks import check_scene
from geometry.scene_files import (
    SCENE_FILE,
    has_scene,
    load_scene,
    load_scene_folder,
    pack_scene,
    save_scene,
)
from geometry.study_scene import load_study_scene
from geometry.untrusted_files import MAX_FILE_BYTES
from placement.question import Question, map_options
from scenarios.ways import find_sharp_bends

from ..figures.axes import to_png
from ..figures.city import plot_junctions
from ..figures.scene import plot_scene_plan, plot_scene_view
from ..progress import WRITING, StageProgress
from ..results.folders import check_folder, write_files
from ..results.scenes import (
    SceneCheckResult,
    SceneResult,
    build_junction_record,
    build_scene_result,
)

PLAN_NAME, VIEW_NAME, JUNCTIONS_NAME = "plan.png", "view.png", "junctions.png"
_STUDY = "town05"
IMPORT_VERSION = 2
"""Counts up when the same map gives another scene; older ones in the cache are not taken."""


def run_import(
    files: Sequence[str],
    options: ImportOptions,
    *,
    bbox: str,
    out: Path,
    progress: StageProgress,
) -> SceneResult:
    """Make a scene of map files and write it.

    Parameters
    ----------
    files : sequence of str
        Map files; "town05" alone is the study's junction.
    options : ImportOptions
        What is to be cut out.
    bbox : str
        West, south, east, north with commas between: fetch OpenStreetMap there; empty: do not.
    out : Path
        Folder that gets ``scene.toml``, ``things.glb`` and two pictures, or a .zip file.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        See :func:`geometry.maps.importing.import_scene`; `out` cannot be written, or is a folder
        with other things in it.
    """
    is_zip = out.suffix.lower() == ".zip"
    _check_target(out, is_zip=is_zip)
    progress.kept = f"nothing was written to {out}"
    progress("read", 0, 0)
    with tempfile.TemporaryDirectory() as temporary:
        paths = [Path(name) for name in files]
        if bbox:
            paths.append(_fetch(bbox, Path(temporary) / "bbox.osm"))
        if [str(path) for path in paths] == [_STUDY] and not paths[0].exists():
            imported = None
            scene = load_study_scene()
            result = build_scene_result(scene)
        else:
            imported = import_scene(paths, options)
            scene = imported.scene
            result = _import_result(imported)
    progress(WRITING, 0, 0)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        save_scene(folder, scene, sources=imported.sources if imported else ())
        if is_zip:
            try:
                pack_scene(folder, out)
            except OSError as error:
                raise InputError(
                    "--out", Unquoted(f"{out}: {error.strerror or error}"), "a file to write"
                ) from None
        else:
            contents = {path.name: read_bytes(path) for path in sorted(folder.iterdir())}
            contents |= _pictures(scene)
            # The meshes first: a folder with a scene.toml is whole.
            write_files(out, {**_last(contents, SCENE_FILE)})
    progress.kept = f"the scene is in {out}"
    return replace(result, written=str(out), seconds=progress.finish())


def import_into_cache(
    question: Question, *, cache: Path, progress: StageProgress
) -> tuple[str, SceneResult]:
    """Import a junction of a map unless that was done before, for a command that goes on with it.

    Parameters
    ----------
    question : Question
        Its scene is a map with roads; what it says of the map, see
        :func:`placement.question.map_options`.
    cache : Path
        Folder below which scenes are cached, by what the map and the options are.
    progress : StageProgress
        Is told the stages.

    Returns
    -------
    folder : str
        Where the scene is.
    told : SceneResult
        What it has, and what was left out or assumed.

    Raises
    ------
    InputError
        There is no map, or it has no such junction.
    """
    path, options = Path(question.scene), map_options(question)
    if not question.scene or not path.is_file() or has_scene(path):
        got = question.scene or "the study's junction"
        given = {"keeps_left": "driving-side"}.get(name := next(iter(options)), name)
        raise InputError(f"--{given}", Unquoted(f"it with {got}"), "--scene FILE, a map with roads")
    reading = ReadingOptions(keeps_left=options.pop("keeps_left", None))
    wanted = ImportOptions(**options, reading=reading)
    digest = hashlib.sha256(f"{IMPORT_VERSION}\n{wanted!r}\n".encode())
    listed = Path(wanted.sites)
    for file in (path, *([listed] if listed.suffix.lower() in LISTS else [])):
        content = read_bytes(file, max_bytes=MAX_FILE_BYTES)
        digest.update(f"{file.name}\n".encode() + content)
    folder = cache / "scenes" / digest.hexdigest()[:16]
    if (folder / SCENE_FILE).exists():
        try:
            return str(folder), build_scene_result(load_scene_folder(folder))
        except InputError:
            pass  # damaged: import it again
    folder.mkdir(parents=True, exist_ok=True)
    told = run_import([question.scene], wanted, bbox="", out=folder, progress=progress)
    return str(folder), told


def run_show(
    paths: Sequence[str],
    reading: ReadingOptions,
    *,
    out: Path | None,
    progress: StageProgress,
    sort: str = "arms",
) -> SceneResult:
    """Tell what a scene or a map has.

    Parameters
    ----------
    paths : sequence of str
        A scene, or map files; none: the study's junction.
    reading : ReadingOptions
        What map files do not say of themselves.
    out : Path, optional
        Folder for pictures of a scene, or one of all junctions of a map.
    progress : StageProgress
        Is told the stages.
    sort : str
        Order of the junctions of a map, see :func:`geometry.maps.junctions.sort_junctions`.

    Raises
    ------
    InputError
        A file cannot be read; a picture of a map without junctions is asked for.
    """
    if out is not None:
        check_folder(out)
    progress("read", 0, 0)
    if paths and not (len(paths) == 1 and has_scene(Path(paths[0]))):
        maps, junctions = read_maps([Path(path) for path in paths], reading)
        roads = maps[0]
        things = [thing for source in maps for thing in source.things]
        listed = sort_junctions(junctions, sort)
        written: str | UnsetType = UNSET
        if out is not None:
            if not listed:
                raise InputError(roads.name, Unquoted("no junction"), "a map in which roads meet")
            progress(WRITING, 0, 0)
            write_files(out, {JUNCTIONS_NAME: to_png(plot_junctions(maps, listed))})
            written = str(out)
        return SceneResult(
            name=roads.name,
            written=written,
            junctions=tuple(build_junction_record(one) for one in listed),
            buildings=sum(thing.class_name == "building" for thing in things),
            things=len(things),
            sites=sum(len(source.poles) for source in maps),
            crosswalks=sum(len(source.crosswalks_m) for source in maps),
            keeps_left=roads.keeps_left,
            skipped=tuple(skip for source in maps for skip in source.skipped),
            crs=roads.source_crs or roads.crs or None,
        )
    scene = load_scene(paths[0] if paths else "")
    result = build_scene_result(scene)
    if out is None:
        return result
    progress(WRITING, 0, 0)
    write_files(out, _pictures(scene))
    return replace(result, written=str(out))


def run_check(path: str, *, progress: StageProgress) -> SceneCheckResult:
    """Check a scene.

    Parameters
    ----------
    path : str
        Of the scene; empty: the study's junction.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        There is no such scene.
    """
    progress("check", 0, 0)
    scene = load_scene(path)
    findings = [*check_scene(scene), *find_sharp_bends(scene)]
    return SceneCheckResult(
        name=scene.name,
        is_sound=all(finding.level != "error" for finding in findings),
        findings=tuple(findings),
    )


def _import_result(imported: ImportedScene) -> SceneResult:
    """An imported scene; its junction has the id and the name that it has in the map."""
    result = build_scene_result(imported.scene)
    chosen = imported.chosen.junction
    return replace(
        result,
        junctions=(replace(result.junctions[0], id=chosen.id, name=chosen.name),),
        other_junctions=len(imported.junctions) - 1,
        assumed_heights=sum(t.is_height_assumed for t in imported.scene.instances),
    )


def _check_target(out: Path, *, is_zip: bool) -> None:
    """Refuse, before anything is computed, what could not be written or is not ours."""
    if is_zip:
        if out.is_dir():
            raise InputError("--out", Unquoted(f"{out}, a folder"), "a file to write")
        check_target(out)
        check_folder(out.parent)
        return
    if out.exists() and not out.is_dir():
        raise InputError("--out", Unquoted(f"{out}, a file"), "a folder, or a .zip file")
    if out.is_dir() and any(out.iterdir()) and not (out / SCENE_FILE).exists():
        raise InputError(
            "--out", Unquoted(f"{out}, which holds other things"), "a new folder, or a scene's"
        )
    check_folder(out)


def _pictures(scene: Scene) -> dict[str, bytes]:
    return {PLAN_NAME: to_png(plot_scene_plan(scene)), VIEW_NAME: to_png(plot_scene_view(scene))}


def _last(contents: dict[str, bytes], name: str) -> dict[str, bytes]:
    return {key: contents[key] for key in sorted(contents, key=lambda key: key == name)}


def _fetch(bbox: str, path: Path) -> Path:
    words = bbox.split(",")
    try:
        west, south, east, north = (float(word) for word in words)
    except ValueError:
        raise InputError("--bbox", bbox, "west,south,east,north in degrees") from None
    if not (-180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0):
        raise InputError("--bbox", bbox, "west,south,east,north in degrees, in this order")
    from geometry.maps.openstreetmap import fetch_openstreetmap

    fetch_openstreetmap((west, south, east, north), path)
    return path
