"""Layouts in the formats of other programs.

One module per format, named after it; some share one.

To add one, write a module that has a ``FORMAT``, an :class:`ExportFormat`, and
list it in ``FORMATS``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from geometry.errors import MissingExtraError
from geometry.registry import load_entry


@dataclass(frozen=True, slots=True, kw_only=True)
class FormatEntry:
    """A format that is loaded when somebody asks for it.

    Attributes
    ----------
    place : str
        "package.module:attribute" of its :class:`ExportFormat`.
    content : str
        What the file holds, and who reads it, in a few words.
    is_binary : bool
        It is not text and needs a file.
    """

    place: str
    content: str
    is_binary: bool = False


FORMATS = {
    "json": FormatEntry(
        place="experiments.export.json:FORMAT",
        content="the layout file itself; place-rsus --layout",
    ),
    "csv": FormatEntry(
        place="experiments.export.csv:FORMAT",
        content="a row per unit; spreadsheets, pandas",
    ),
    "geojson": FormatEntry(
        place="experiments.export.geojson:FORMAT",
        content="points in WGS 84; QGIS, geopandas, web maps",
    ),
    "gpkg": FormatEntry(
        place="experiments.export.gpkg:FORMAT",
        content="points in the map's own coordinates; QGIS, ArcGIS",
        is_binary=True,
    ),
    "kml": FormatEntry(
        place="experiments.export.kml:FORMAT",
        content="placemarks above ground; Google Earth",
    ),
    "dxf": FormatEntry(
        place="experiments.export.dxf:FORMAT",
        content="roads, houses, poles, units, views as layers; CAD; extra: dxf",
    ),
    "carla": FormatEntry(
        place="experiments.export.carla:FORMAT",
        content="spawn transforms in CARLA's frame; its Python API",
    ),
    "opencv": FormatEntry(
        place="experiments.export.opencv:FORMAT",
        content="K, R, t of cameras, YAML; cv::FileStorage",
    ),
    "ros": FormatEntry(
        place="experiments.export.ros:FORMAT",
        content="CameraInfo and transform per camera, YAML; camera_info_manager",
    ),
    "cpm": FormatEntry(
        place="experiments.export.cpm:FORMAT",
        content="messages of each site, ETSI TS 103 324 as JSON; V2X stacks",
    ),
    "cpm-uper": FormatEntry(
        place="experiments.export.uper:FORMAT",
        content="the same messages as bytes (UPER); extra: v2x",
        is_binary=True,
    ),
    "mcap": FormatEntry(
        place="experiments.export.mcap:FORMAT",
        content="scene, bodies, detections; Foxglove; extra: mcap",
        is_binary=True,
    ),
    "opendrive": FormatEntry(
        place="experiments.export.opendrive:FORMAT",
        content="the scene's roads, OpenDRIVE 1.7; the layout's poles beside them",
    ),
}
"""Registry of the formats, in the order of the help."""
FORMAT_NAMES = tuple(FORMATS)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportFormat:
    """A format: how a layout is written, and what a user should know about it."""

    write: Callable[
        ..., str | bytes
    ]  # a layout and its scene to the content of the file
    # LiDARs are in it, too, and not only cameras.
    has_lidars: bool = True
    # `write` takes a :class:`.watched.WatchedRun`, too.
    shows_runs: bool = False
    # Names of further arguments of `write`.
    options: tuple[str, ...] = ()
    # a sentence about the content that was written
    told: Callable[[bytes], str] | None = None


def load_format(name: str) -> ExportFormat:
    """A format by its name, one of ``FORMAT_NAMES``."""
    found: ExportFormat = load_entry(FORMATS[name].place)
    return found


def load_extra(module: str, needs: str, extra: str) -> Any:
    """An optional library's module.

    MissingExtraError says what `needs` which package.
    """
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtraError(f"{needs}: pip install place-rsus[{extra}]") from None
