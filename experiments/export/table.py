"""Layouts as tables: CSV, and Apache Parquet."""

import io

from geometry.scene import Scene
from placement.layout import Layout

from ..results.tables import records_csv
from . import ExportFormat
from .places import longitude_latitude, placed_records, positions_m


def to_csv(layout: Layout, scene: Scene | None = None) -> str:
    """Layout as CSV: one row per unit, in full precision.

    See :func:`placed_records`.
    """
    return records_csv(placed_records(layout, scene))


def to_parquet(layout: Layout, scene: Scene) -> bytes:
    """Layout as Apache Parquet.

    As CSV, and with a crs longitude_deg and latitude_deg.
    """
    import pandas as pd

    table = pd.DataFrame(placed_records(layout, scene))
    if scene.crs:
        lon_lat_deg = longitude_latitude(positions_m(layout), scene.crs)
        table = table.assign(
            longitude_deg=lon_lat_deg[:, 0], latitude_deg=lon_lat_deg[:, 1]
        )
    file = io.BytesIO()
    table.to_parquet(file, index=False)
    return file.getvalue()


CSV = ExportFormat(
    write=to_csv,
)
PARQUET = ExportFormat(
    write=to_parquet,
)
