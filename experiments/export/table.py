"""Layouts as tables: CSV."""

from geometry.scene import Scene
from placement.layout import Layout

from ..results.tables import csv_text
from . import ExportFormat
from .places import placed_records


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as CSV: one row per unit, in full precision.

    See :func:`placed_records`.
    """
    # Takes longer to load than all other formats.
    import pandas as pd

    return csv_text(pd.DataFrame(placed_records(layout, scene)))


FORMAT = ExportFormat(write=to_csv, content="a row per unit; spreadsheets, pandas")
