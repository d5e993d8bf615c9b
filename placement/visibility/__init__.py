"""Candidates + runs -> detection table.

``casting`` spreads points over each VRU and sends rays to them from every mount
position, ``sensing`` projects the points that the rays reach into the sensors of the
position, ``build`` makes the table of all positions and keeps it on disk.
"""

from .build import build_detection_table, load_table, save_table, table_fingerprint

__all__ = ["build_detection_table", "load_table", "save_table", "table_fingerprint"]
