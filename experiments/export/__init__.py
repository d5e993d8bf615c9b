"""Layouts in the formats of other programs: one module per format, named after it; some share one.

To add one, write a module that has a ``FORMAT``, an :class:`ExportFormat`, and list its name here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

FORMAT_NAMES = (
    "json",
    "csv",
    "parquet",
    "geojson",
    "gpkg",
    "kml",
    "dxf",
    "carla",
    "carla-run",
    "opencv",
    "ros",
    "openlabel",
    "cpm",
    "cpm-uper",
    "vam",
    "vam-uper",
    "mcap",
    "usd",
    "opendrive",
)
"""In the order of the help."""

_SHARED = {
    **{"csv": ("table", "CSV"), "parquet": ("table", "PARQUET")},
    **{"cpm-uper": ("uper", "CPM"), "vam-uper": ("uper", "VAM")},
}


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
    module, attribute = _SHARED.get(name, (name.replace("-", "_"), "FORMAT"))
    found: ExportFormat = getattr(import_module(f".{module}", __name__), attribute)
    return found
