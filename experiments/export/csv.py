"""A layout as a table: CSV."""

from geometry.scene import Scene
from placement.layout import Layout

from ..results.tables import records_csv
from . import ExportFormat
from .places import placed_records


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Write one row per unit, in full precision.

    See :func:`placed_records`.
    """
    return records_csv(placed_records(layout, scene))


FORMAT = ExportFormat(
    write=to_csv,
)
