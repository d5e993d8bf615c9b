"""A city as GeoPackage: all units, and all junctions with what they get."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geometry.files import read_bytes

from ..results.city import CityJunctionRecord

UNITS, JUNCTIONS = "units", "junctions"


def to_city_geopackage(
    units: Sequence[Mapping[str, Any]], junctions: Sequence[CityJunctionRecord], *, crs: str
) -> bytes:
    """Layers "units" (points with height) and "junctions" in the coordinates of the map.

    Parameters
    ----------
    units : sequence of mapping
        As :func:`experiments.export.places.placed_records` makes them; may be of maps with other
        reference systems.
    junctions : sequence of CityJunctionRecord
        All of them, also those that get nothing.
    crs : str
        Of the layers.

    References
    ----------
    .. [1] OGC 12-128, "GeoPackage Encoding Standard".
    """
    import geopandas as gpd
    import pandas as pd
    import pyogrio

    from geometry.maps.georeferences import transform

    rows = [
        {
            name: getattr(one, name)
            for name in (
                *("id", "name", "map", "weight", "district", "units", "cost_eur", "year"),
                *("apr_before", "apr", "apr_one_failed", "gain", "reason"),
            )
        }
        for one in junctions
    ]
    table = gpd.GeoDataFrame(
        pd.DataFrame(rows),
        geometry=gpd.points_from_xy([one.x for one in junctions], [one.y for one in junctions]),
        crs=crs,
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "city.gpkg"
        pyogrio.write_dataframe(table, path, layer=JUNCTIONS, driver="GPKG", geometry_type="Point")
        if units:
            places = [
                transform([unit["map_x"], unit["map_y"]], unit["map_crs"], crs)
                if unit["map_crs"] != crs
                else (unit["map_x"], unit["map_y"])
                for unit in units
            ]
            points = gpd.points_from_xy(
                [place[0] for place in places],
                [place[1] for place in places],
                z=[unit.get("map_z", unit["z_m"]) for unit in units],
            )
            pyogrio.write_dataframe(
                gpd.GeoDataFrame(pd.DataFrame(units), geometry=points, crs=crs),
                path,
                layer=UNITS,
                driver="GPKG",
                geometry_type="Point Z",
                append=True,
            )
        return read_bytes(path)
