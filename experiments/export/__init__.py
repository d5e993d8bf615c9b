"""Layouts in the formats of other programs: one module per format, named after it.

To add a format, write a module that has a ``FORMAT`` (see ``formats.py``) and list its name here.
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
"""In the order of the help; each is the name of a module of this package, with _ for -."""
