"""Layouts in the formats of other programs: one module per format, named after it; some share one.

To add one, write a module that has a ``FORMAT``, an :class:`ExportFormat`, and list its
name here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from geometry.errors import MissingExtraError

FORMAT_NAMES = (
    "json",
    "csv",
    "parquet",
    "geojson",
    "gpkg",
    "kml",
    "dxf",
    "carla",
    "opencv",
    "ros",
    "cpm",
    "cpm-uper",
    "mcap",
    "opendrive",
)
"""In the order of the help."""

_SHARED = {
    "csv": ("table", "CSV"),
    "parquet": ("table", "PARQUET"),
    "cpm-uper": ("uper", "FORMAT"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportFormat:
    """A format: how a layout is written, and what a user should know about it."""

    write: Callable[
        ..., str | bytes
    ]  # a layout and its scene to the content of the file
    content: str  # what the file holds, and who reads it, in a few words
    is_binary: bool = False  # it is not text and needs a file
    has_lidars: bool = True  # LiDARs are in it, too, and not only cameras
    shows_runs: bool = False  # `write` takes a :class:`.watched.WatchedRun`, too
    options: tuple[str, ...] = ()  # names of further arguments of `write`
    # a sentence about the content that was written
    told: Callable[[bytes], str] | None = None


def load_format(name: str) -> ExportFormat:
    """A format by its name, one of ``FORMAT_NAMES``."""
    module, attribute = _SHARED.get(name, (name, "FORMAT"))
    found: ExportFormat = getattr(import_module(f".{module}", __name__), attribute)
    return found


def load_extra(module: str, needs: str, extra: str) -> Any:
    """An optional library's module. MissingExtraError says what `needs` which package."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtraError(f"{needs}: pip install place-rsus[{extra}]") from None


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader(__name__, "")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined)


def xml_text(template: str, *, namespace: str = "", **values: Any) -> str:
    """XML document of a template of this folder, indented; texts in it are escaped."""
    import xml.etree.ElementTree as ET

    root = ET.fromstring(_templates().get_template(template).render(values))
    for element in root.iter():
        if not len(element) and not (element.text or "").strip():
            element.text = None  # blanks of the template, where nothing was filled in
    if namespace:
        root.set("xmlns", namespace)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
