"""Maps from OpenStreetMap: a file of its data in, lanes, junctions, buildings and poles out."""

from .online import fetch_openstreetmap
from .reader import read_openstreetmap

__all__ = ["fetch_openstreetmap", "read_openstreetmap"]
