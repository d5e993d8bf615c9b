"""Maps from OpenStreetMap: a file of its data in, lanes, junctions, buildings and poles out."""

from .reader import fetch_openstreetmap, read_openstreetmap

__all__ = ["fetch_openstreetmap", "read_openstreetmap"]
