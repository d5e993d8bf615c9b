"""A layout in every format that other programs read, by the format's name."""

from collections.abc import Callable, Mapping

from geometry.scene import Scene
from geometry.scene_files import load_scene
from placement.layout import Layout, check_layout

from . import FORMAT_NOTES
from .calibration import lidar_ids
from .carla import to_carla
from .collective_perception import to_cpm
from .geojson import to_geojson, to_geopackage
from .json import to_json
from .kml import to_kml
from .opencv import to_opencv
from .openlabel import to_openlabel
from .ros import to_ros
from .tables import to_csv, to_parquet

FORMATS: Mapping[str, Callable[[Layout, Scene], str | bytes]] = {
    "json": lambda layout, scene: to_json(layout),
    "csv": to_csv,
    "parquet": to_parquet,
    "geojson": lambda layout, scene: to_geojson(layout, scene.crs, scene),
    "gpkg": to_geopackage,
    "kml": to_kml,
    "carla": lambda layout, scene: to_carla(layout),
    "opencv": lambda layout, scene: to_opencv(layout),
    "ros": lambda layout, scene: to_ros(layout),
    "openlabel": lambda layout, scene: to_openlabel(layout),
    "cpm": to_cpm,
}
"""By name: layout and its scene to text, or to bytes; see ``export_formats.FORMAT_NOTES``."""


def export_layout(layout: Layout, format_name: str, *, scene_path: str = "") -> str | bytes:
    """A layout for another program.

    Parameters
    ----------
    layout : Layout
        What to write.
    format_name : str
        One of ``FORMATS``.
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
    return FORMATS[format_name](layout, scene)


def left_out(layout: Layout, format_name: str) -> list[str]:
    """Units that a format has no words for: LiDARs where it is about cameras."""
    return [] if FORMAT_NOTES[format_name].has_lidars else lidar_ids(layout)
