"""The formats in which a layout can be exported, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module

from geometry.errors import InputError
from geometry.scene_files import load_scene
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.layout import Layout, check_layout


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportFormat:
    """A format: how a layout is written, and what a user should know about it."""

    write: Callable[..., str | bytes]  # a layout and its scene to the content of the file
    content: str  # what the file holds, and who reads it, in a few words
    is_binary: bool = False  # it is not text and needs a file
    has_lidars: bool = True  # LiDARs are in it, too, and not only cameras
    shows_runs: bool = False  # `write` takes a :class:`.watched.WatchedRun`, too
    drives_run: bool = False  # `write` needs a run, by itself, and not what units detect in it
    has_units: bool = True  # else `write` takes the run and its scene, and no layout
    options: tuple[str, ...] = ()  # names of further arguments of `write`
    told: Callable[[bytes], str] | None = None  # a sentence about the content that was written


def load_format(name: str) -> ExportFormat:
    """A format by its name, one of ``FORMAT_NAMES``."""
    found: ExportFormat = import_module(f".{name.replace('-', '_')}", __package__).FORMAT
    return found


def export_layout(
    layout: Layout | None,
    format_name: str,
    *,
    scene_path: str = "",
    run_id: str = "",
    compute: Compute = DEFAULT_COMPUTE,
    options: Mapping[str, str | float] | None = None,
) -> str | bytes:
    """Content of a layout's file for another program.

    `format_name` is one of ``FORMAT_NAMES``, `options` are its own. `scene_path`: folder or .zip
    file of the layout's scene; empty: the study's junction. `run_id`: a run to show as the units
    see it; empty: none. Formats of a run alone take no layout. Raises InputError: the layout does
    not fit the scene, or the format needs a place on earth, shows no runs, or lacks an option.
    """
    chosen = load_format(format_name)
    if chosen.drives_run and not run_id:
        raise InputError("--run", run_id, f"a run: {format_name} shows nothing else")
    if layout is not None and not chosen.has_units:
        raise InputError("--layout", layout.name, f"none: {format_name} has no units")
    if run_id and not (chosen.shows_runs or chosen.drives_run):
        raise InputError("--run", run_id, f"none: {format_name} shows no runs")
    given = options or {}
    for name, value in given.items():
        if name not in chosen.options:
            raise InputError(
                f"--{name.replace('_', '-')}", value, f"none: {format_name} has no such option"
            )
    scene = load_scene(scene_path)
    if layout is not None:
        check_layout(layout, scene)
    if not run_id:
        return chosen.write(layout, scene, **given)
    from .watched import find_run, watch_run

    if layout is None:
        return chosen.write(find_run(run_id, scene), scene, **given)
    if chosen.drives_run:
        return chosen.write(layout, scene, find_run(run_id, scene), **given)
    return chosen.write(layout, scene, watch_run(layout, scene, run_id, compute=compute), **given)
