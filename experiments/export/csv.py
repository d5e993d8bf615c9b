"""Layouts as CSV tables."""

from geometry.scene import Scene
from placement.layout import Layout

from ..results.tables import csv_text
from .formats import ExportFormat
from .places import placed_records


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as CSV: one row per unit, in full precision; see :func:`placed_records`."""
    import pandas as pd  # takes longer to load than all other formats

    records = placed_records(layout, scene)
    return csv_text(pd.DataFrame(records))


FORMAT = ExportFormat(write=to_csv, content="a row per unit; spreadsheets, pandas")
