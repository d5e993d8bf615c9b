"""Layouts in the formats of others, a module per family; ``layout_exports`` has them by name.

This file only says which formats there are, so that the command line can tell without loading any
library.
"""

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["FORMAT_NOTES", "FormatNote"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FormatNote:
    """What a user should know about a format.

    Attributes
    ----------
    content : str
        What is in it, and who reads it, in a few words.
    is_binary : bool
        Whether it is no text and needs a file.
    has_lidars : bool
        Whether LiDARs are in it, too, and not only cameras.
    needs_crs : bool
        Whether the scene must lie somewhere on earth.
    """

    content: str
    is_binary: bool = False
    has_lidars: bool = True
    needs_crs: bool = False


FORMAT_NOTES: Mapping[str, FormatNote] = {
    "json": FormatNote(content="the layout file itself; place-rsus --layout"),
    "csv": FormatNote(content="a row per unit; spreadsheets, pandas"),
    "parquet": FormatNote(content="the same table, typed; pandas, Arrow, DuckDB", is_binary=True),
    "geojson": FormatNote(content="points in WGS 84; QGIS, geopandas, web maps", needs_crs=True),
    "gpkg": FormatNote(
        content="points in the map's own coordinates; QGIS, ArcGIS",
        is_binary=True,
        needs_crs=True,
    ),
    "kml": FormatNote(content="placemarks above ground; Google Earth", needs_crs=True),
    "carla": FormatNote(content="spawn transforms in CARLA's frame; its Python API"),
    "opencv": FormatNote(
        content="K, R, t of cameras, YAML; cv::FileStorage",
        has_lidars=False,
    ),
    "ros": FormatNote(
        content="CameraInfo and transform per camera, YAML; camera_info_manager",
        has_lidars=False,
    ),
    "openlabel": FormatNote(content="coordinate systems and streams, ASAM OpenLABEL 1.0; vcd"),
    "cpm": FormatNote(
        content="sensor information per site, ETSI TS 103 324 as JSON; V2X stacks",
        needs_crs=True,
    ),
}
"""By name, in the order of the help."""
