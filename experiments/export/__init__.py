"""Layouts in the formats of other programs: one module per format, named after it; bytes share one.

To add a format, write a module that has a ``FORMAT`` and list its name here: see ``formats.py``.
"""

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
