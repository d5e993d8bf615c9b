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
    """A format: how a layout is written, and what a user should know about it.

    Attributes
    ----------
    write : callable
        A layout and its scene to the content of the file.
    content : str
        What the file holds, and who reads it, in a few words.
    is_binary : bool
        Whether it is not text and needs a file.
    has_lidars : bool
        Whether LiDARs are in it, too, and not only cameras.
    needs_crs : bool
        Whether the scene has to say where on earth it lies.
    shows_runs : bool
        Whether `write` takes a :class:`.watched.WatchedRun`, too.
    options : tuple of str
        Names of further arguments of `write`.
    told : callable, optional
        A sentence about the content that was written.
    """

    write: Callable[..., str | bytes]
    content: str
    is_binary: bool = False
    has_lidars: bool = True
    needs_crs: bool = False
    shows_runs: bool = False
    options: tuple[str, ...] = ()
    told: Callable[[bytes], str] | None = None


def load_format(name: str) -> ExportFormat:
    """A format by its name, one of ``FORMAT_NAMES``."""
    found: ExportFormat = import_module(f".{name.replace('-', '_')}", __package__).FORMAT
    return found


def export_layout(
    layout: Layout,
    format_name: str,
    *,
    scene_path: str = "",
    run_id: str = "",
    compute: Compute = DEFAULT_COMPUTE,
    options: Mapping[str, str | bool] | None = None,
) -> str | bytes:
    """A layout for another program.

    Parameters
    ----------
    layout : Layout
        What to write.
    format_name : str
        One of ``FORMAT_NAMES``.
    scene_path : str
        Folder or .zip file of its scene; empty: the study's junction.
    run_id : str
        Run to show as the layout's units see it; empty: none.
    compute : Compute
        How the run is watched.
    options : mapping, optional
        Of the format: its ``ExportFormat.options``.

    Returns
    -------
    content : str or bytes
        Of the file.

    Raises
    ------
    InputError
        The layout does not fit the scene, or the format needs a place on earth, shows no runs, or
        lacks an option.
    """
    chosen = load_format(format_name)
    if run_id and not chosen.shows_runs:
        raise InputError("--run", run_id, f"none: {format_name} shows no runs")
    given = options or {}
    for name, value in given.items():
        if name not in chosen.options:
            raise InputError(f"--{name}", value, f"none: {format_name} has no such option")
    scene = load_scene(scene_path)
    check_layout(layout, scene)
    if not run_id:
        return chosen.write(layout, scene, **given)
    from .watched import watch_run

    return chosen.write(layout, scene, watch_run(layout, scene, run_id, compute=compute), **given)
