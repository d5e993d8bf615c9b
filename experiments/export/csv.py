"""Layouts as CSV tables."""

from geometry.scene import Scene
from placement.layout import Layout

from .formats import ExportFormat
from .places import placed_records


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as CSV: one row per unit, in full precision; see :func:`placed_records`."""
    import pandas as pd  # takes longer to load than all other formats

    records = placed_records(layout, scene)
    text: str = pd.DataFrame(records).to_csv(index=False, lineterminator="\n")
    return text


FORMAT = ExportFormat(write=to_csv, content="a row per unit; spreadsheets, pandas")
