"""``place-rsus scene``: import, show and check scenes."""

import hashlib
import shlex
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from geometry.errors import InputError, Unquoted, refuse
from geometry.frames import transform
from geometry.junction import build_junction, street_names
from geometry.maps.importing import (
    ImportOptions,
    ReadingOptions,
    Surveyed,
    import_scene,
    read_maps,
    sort_junctions,
)
from geometry.maps.place_lists import SUFFIXES as LISTS
from geometry.maps.place_lists import list_files
from geometry.maps.source_map import SourceMap
from geometry.notes import Finding, Note
from geometry.opening import MAX_FILE_BYTES, read_bytes
from geometry.scene import Scene
from geometry.scene_checks import check_scene
from geometry.scene_files import load_scene_folder, pack_scene, save_scene
from geometry.scene_sources import SCENE_FILE, has_scene, load_scene
from geometry.study_scene import load_study_scene
from geometry.writing import check_target
from placement.question import Question, map_options
from scenarios.bends import find_sharp_bends

from ..figures.axes import to_png
from ..language import mark
from ..progress import WRITING, StageProgress
from ..results.folders import check_folder, write_files
from ..results.record import Record
from .pictures import junctions_page, plot_scene_plan

PLAN_NAME = "plan.png"
JUNCTIONS_PAGE = "junctions.html"
_STUDY = "town05"
# A millimetre.
_DIGITS = 3
IMPORT_VERSION = 3
"""Counts up when the same map gives another scene: older ones are not taken."""


class ArmRecord(Record, frozen=True, kw_only=True):
    """An arm of a junction."""

    name: str
    lanes_in: int
    lanes_out: int
    parking_lanes: int
    bus_lanes: int = 0


class JunctionRecord(Record, frozen=True, kw_only=True):
    """A junction; x_m and y_m are in the map's system.

    In degrees where that has degrees.

    Signals are poles with traffic lights; they and crossings lie within 15 m of the
    outline.
    """

    id: str
    name: str
    x_m: float
    y_m: float
    arms: int
    lanes: int
    signals: int | UnsetType = UNSET
    crossings: int | UnsetType = UNSET
    arm_list: tuple[ArmRecord, ...] | UnsetType = UNSET
    arm_names: tuple[str, ...] | UnsetType = UNSET


class SiteRecord(Record, frozen=True, kw_only=True):
    """A site of a scene."""

    id: str
    kind: str
    x_m: float
    y_m: float
    height_range_m: tuple[float, ...]
    capacity_units: int
    use: str


class SceneResult(Record, frozen=True, kw_only=True):
    """Contents of a scene or a map.

    Fields of a scene alone, or an import alone, may be UNSET.
    """

    name: str
    junctions: tuple[JunctionRecord, ...]
    buildings: int
    things: int
    sites: int
    site_list: tuple[SiteRecord, ...] | UnsetType = UNSET
    crosswalks: int
    keeps_left: bool
    skipped: tuple[Note, ...]
    crs: str | None
    world_crs: str | UnsetType | None = UNSET
    other_junctions: int | UnsetType = UNSET
    assumed_heights: int | UnsetType = UNSET
    written: str | UnsetType = UNSET
    seconds: dict[str, float] | UnsetType = UNSET


class SceneCheckResult(Record, frozen=True, kw_only=True):
    """Faults of a scene; sound: no error among them."""

    name: str
    is_sound: bool
    findings: tuple[Finding, ...]


def build_scene_result(scene: Scene) -> SceneResult:
    """Summary of a scene."""
    junction = build_junction(scene)
    # Rounded as in scene.toml, so that an import and a look at its folder report the
    # same.
    outline = np.round(scene.outline_m, _DIGITS)
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    position = middle + scene.source_origin_m
    if scene.crs:
        position = transform(middle, scene.crs, scene.source_crs or scene.crs)
    arms = tuple(
        ArmRecord(
            name=arm.name,
            lanes_in=len(arm.entry_lanes),
            lanes_out=len(arm.exit_lanes),
            parking_lanes=sum(
                lane.kind == "parking" for lane in (*arm.lanes_in, *arm.lanes_out)
            ),
            bus_lanes=sum(
                lane.kind == "bus" for lane in (*arm.lanes_in, *arm.lanes_out)
            ),
        )
        for arm in junction.arms.values()
    )
    only = JunctionRecord(
        id=scene.name.rpartition("/")[2],
        name=" / ".join(dict.fromkeys(street_names(scene).values())) or scene.name,
        x_m=float(position[0]),
        y_m=float(position[1]),
        arms=len(arms),
        lanes=sum(arm.lanes_in + arm.lanes_out for arm in arms),
        arm_list=arms,
    )
    sites = tuple(
        SiteRecord(
            id=site.id,
            kind=site.kind,
            x_m=round(float(site.position_m[0]), _DIGITS),
            y_m=round(float(site.position_m[1]), _DIGITS),
            height_range_m=tuple(np.round(site.height_range_m, _DIGITS).tolist()),
            capacity_units=site.capacity_units,
            use=site.use,
        )
        for site in scene.sites
    )
    return SceneResult(
        name=scene.name,
        junctions=(only,),
        buildings=sum(thing.class_name == "building" for thing in scene.instances),
        things=sum(thing.class_name != "ground" for thing in scene.instances),
        sites=len(sites),
        site_list=sites,
        crosswalks=len(scene.crosswalks_m),
        keeps_left=scene.keeps_left,
        skipped=scene.notes,
        crs=scene.source_crs or scene.crs or None,
        world_crs=scene.crs or None,
    )


def _junction_record(surveyed: Surveyed) -> JunctionRecord:
    x_m, y_m = surveyed.position.tolist()
    return JunctionRecord(
        id=surveyed.junction.id,
        name=surveyed.junction.name,
        x_m=x_m,
        y_m=y_m,
        arms=len(surveyed.arms),
        lanes=surveyed.n_lanes,
        signals=surveyed.n_signals,
        crossings=surveyed.n_crossings,
        arm_names=tuple(surveyed.arms),
    )


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
        West, south, east, north with commas between: fetch OpenStreetMap there; empty:
        do not.
    out : Path
        Folder that gets ``scene.toml``, ``things.glb`` and two pictures, or a .zip
        file.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        See :func:`geometry.maps.importing.import_scene`; `out` cannot be written, or is
        a folder with other things in it.
    """
    is_zip = out.suffix.lower() == ".zip"
    _check_target(out, is_zip=is_zip)
    progress.kept = f"nothing was written to {out}"
    progress(mark("read"), 0, 0)
    with tempfile.TemporaryDirectory() as temporary:
        paths = [Path(name) for name in files]
        if bbox:
            paths.append(_fetch(bbox, Path(temporary) / "bbox.osm"))
        if [str(path) for path in paths] == [_STUDY] and not paths[0].exists():
            scene = load_study_scene()
            sources = tuple[str, ...]()
            result = build_scene_result(scene)
        else:
            imported = import_scene(paths, options, progress=progress)
            scene = imported.scene
            sources = imported.sources
            result = build_scene_result(scene)
            only = result.junctions[0]
            chosen = imported.chosen.junction
            result = replace(
                result,
                junctions=(replace(only, id=chosen.id, name=chosen.name),),
                other_junctions=len(imported.junctions) - 1,
                assumed_heights=sum(
                    thing.is_height_assumed for thing in scene.instances
                ),
            )
    progress(WRITING, 0, 0)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        save_scene(folder, scene, sources=sources)
        if is_zip:
            try:
                pack_scene(folder, out)
            except OSError as error:
                raise InputError(
                    "--out",
                    Unquoted(f"{out}: {error.strerror or error}"),
                    "a file to write",
                ) from None
        else:
            contents = {
                path.name: read_bytes(path) for path in sorted(folder.iterdir())
            }
            contents |= _pictures(scene)
            # Last: where it is, all is.
            contents[SCENE_FILE] = contents.pop(SCENE_FILE)
            write_files(out, contents)
    progress.kept = f"the scene is in {out}"
    return replace(result, written=str(out), seconds=progress.finish())


def _check_target(out: Path, *, is_zip: bool) -> None:
    """Refuse a target that cannot be written or is not ours.

    Before anything is computed.
    """
    if is_zip:
        if out.is_dir():
            refuse("--out", f"{out}, a folder", "a file to write")
        check_target(out)
        check_folder(out.parent)
        return
    if out.exists() and not out.is_dir():
        refuse("--out", f"{out}, a file", "a folder, or a .zip file")
    if out.is_dir() and any(out.iterdir()) and not (out / SCENE_FILE).exists():
        refuse(
            "--out", f"{out}, which holds other things", "a new folder, or a scene's"
        )
    check_folder(out)


def _pictures(scene: Scene) -> dict[str, bytes]:
    return {PLAN_NAME: to_png(plot_scene_plan(scene))}


def _fetch(bbox: str, path: Path) -> Path:
    words = bbox.split(",")
    try:
        west, south, east, north = (float(word) for word in words)
    except ValueError:
        raise InputError("--bbox", bbox, "west,south,east,north in degrees") from None
    if not (-180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0):
        raise InputError(
            "--bbox", bbox, "west,south,east,north in degrees, in this order"
        )
    from geometry.maps.openstreetmap import fetch_openstreetmap

    fetch_openstreetmap((west, south, east, north), path)
    return path


def import_into_cache(
    question: Question, *, cache: Path, progress: StageProgress
) -> tuple[str, SceneResult]:
    """Folder and summary of a map's junction.

    It is imported below `cache` unless it was before.
    """
    path = Path(question.scene)
    options = map_options(question)
    if not question.scene or not path.is_file() or has_scene(path):
        got = question.scene or "the study's junction"
        given = {"keeps_left": "driving-side"}.get(name := next(iter(options)), name)
        refuse(f"--{given}", f"it with {got}", "--scene FILE, a map with roads")
    reading = ReadingOptions(keeps_left=options.pop("keeps_left", None))
    wanted = ImportOptions(**options, reading=reading)
    digest = hashlib.sha256(f"{IMPORT_VERSION}\n{wanted!r}\n".encode())
    files = [path]
    if Path(wanted.sites).suffix.lower() in LISTS:
        files += list_files(Path(wanted.sites))
    for file in files:
        content = read_bytes(file, max_bytes=MAX_FILE_BYTES)
        digest.update(f"{file.name}\n".encode() + content)
    folder = cache / "scenes" / digest.hexdigest()[:16]
    if (folder / SCENE_FILE).exists():
        try:
            return str(folder), build_scene_result(load_scene_folder(folder))
        except InputError:
            # Damaged: import it again.
            pass
    folder.mkdir(parents=True, exist_ok=True)
    return str(folder), run_import(
        [question.scene], wanted, bbox="", out=folder, progress=progress
    )


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
        Folder for pictures of a scene.
    progress : StageProgress
        Is told the stages.
    sort : str
        Order of the junctions of a map, see
        :func:`geometry.maps.junctions.sort_junctions`.

    Raises
    ------
    InputError
        A file cannot be read; pictures of a map are asked for, of which nothing is cut
        out yet.
    """
    if out is not None:
        check_folder(out)
    progress(mark("read"), 0, 0)
    if paths and not (len(paths) == 1 and has_scene(Path(paths[0]))):
        given = [Path(path) for path in paths]
        maps, junctions = read_maps(given, reading, progress=progress)
        roads = maps[0]
        listed = sort_junctions(junctions, sort)
        if out is not None and not listed:
            refuse(roads.name, "no junction", "a map in which roads meet")
        things = [thing for source in maps for thing in source.things]
        result = SceneResult(
            name=roads.name,
            junctions=tuple(_junction_record(one) for one in listed),
            buildings=sum(thing.class_name == "building" for thing in things),
            things=len(things),
            sites=sum(len(source.poles) for source in maps),
            crosswalks=sum(len(source.crosswalks_m) for source in maps),
            keeps_left=roads.keeps_left,
            skipped=tuple(skip for source in maps for skip in source.skipped),
            crs=roads.source_crs or roads.crs or None,
        )
        command = f"place-rsus scene import {shlex.join(map(str, paths))}"
        if reading.staggered_m:
            command += f" --staggered {reading.staggered_m:g}"
        else:
            command += ""
        draw = partial(_pictures_of_map, maps, listed, command)
    else:
        scene = load_scene(paths[0] if paths else "")
        result = build_scene_result(scene)
        draw = partial(_pictures, scene)
    if out is None:
        return result
    progress(WRITING, 0, 0)
    write_files(out, draw())
    return replace(result, written=str(out))


def _pictures_of_map(
    maps: Sequence[SourceMap], listed: Sequence[Surveyed], command: str
) -> dict[str, bytes]:
    page = junctions_page(maps, listed, command=f"{command} --junction")
    return {JUNCTIONS_PAGE: page.encode()}


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
    progress(mark("check"), 0, 0)
    scene = load_scene(path)
    findings = (*check_scene(scene), *find_sharp_bends(scene))
    is_sound = all(finding.level != "error" for finding in findings)
    return SceneCheckResult(name=scene.name, is_sound=is_sound, findings=findings)
