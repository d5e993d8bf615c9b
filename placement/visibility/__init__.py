"""Candidates + runs -> detection table.

``surface`` spreads points over a VRU, ``obstructions`` tells apart what stands in some runs only,
``casting`` sends rays from each mount position to the points, ``build`` projects what the rays
reach into every camera of the position, ``cache`` keeps the table.
"""

from .build import build_detection_table
from .cache import load_table, save_table, table_fingerprint

__all__ = ["build_detection_table", "load_table", "save_table", "table_fingerprint"]
