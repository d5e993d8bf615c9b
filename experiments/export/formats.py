"""The formats in which a layout can be exported, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from geometry.scene import Scene
from geometry.scene_files import load_scene
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
    """

    write: Callable[[Layout, Scene], str | bytes]
    content: str
    is_binary: bool = False
    has_lidars: bool = True
    needs_crs: bool = False


def load_format(name: str) -> ExportFormat:
    """A format by its name, one of ``FORMAT_NAMES``."""
    found: ExportFormat = import_module(f".{name}", __package__).FORMAT
    return found


def export_layout(layout: Layout, format_name: str, *, scene_path: str = "") -> str | bytes:
    """A layout for another program.

    Parameters
    ----------
    layout : Layout
        What to write.
    format_name : str
        One of ``FORMAT_NAMES``.
    scene_path : str
        Folder or .zip file of its scene; empty: the study's junction.

    Returns
    -------
    content : str or bytes
        Of the file.

    Raises
    ------
    InputError
        The layout does not fit the scene, or the format needs a place on earth.
    """
    scene = load_scene(scene_path)
    check_layout(layout, scene)
    return load_format(format_name).write(layout, scene)
