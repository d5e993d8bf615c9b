"""Layouts as map features: GeoJSON and GeoPackage."""

import io

from geometry.scene import Scene
from placement.layout import Layout

from .json import to_json_text
from .places import (
    longitude_latitude,
    map_positions,
    placed_records,
    positions_m,
    require_crs,
)

_LAYER = "units"


def to_geojson(layout: Layout, crs: str, scene: Scene | None = None) -> str:
    """Layout as GeoJSON: points in WGS 84, with the fields of the layout as properties.

    Parameters
    ----------
    layout : Layout
        What to write.
    crs : str
        Coordinate reference system of the world frame, for pyproj.
    scene : Scene, optional
        See :func:`experiments.export.places.placed_records`.

    Returns
    -------
    text : str
        A FeatureCollection. Coordinates are longitude, latitude [deg] and the height above the
        road [m]; x_m and y_m among the properties stay in the world frame.

    Raises
    ------
    InputError
        pyproj does not know `crs`, or the layout lies outside of where it is defined.

    References
    ----------
    .. [1] RFC 7946, "The GeoJSON Format", sections 3.1.1 (positions) and 4 (WGS 84).
    """
    require_crs(crs, "geojson")
    features = [
        {
            "type": "Feature",
            "id": record["id"],
            "geometry": {
                "type": "Point",
                "coordinates": [float(longitude), float(latitude), record["z_m"]],
            },
            "properties": record,
        }
        for record, (longitude, latitude) in zip(
            placed_records(layout, scene),
            longitude_latitude(positions_m(layout), crs),
            strict=True,
        )
    ]
    return to_json_text({"type": "FeatureCollection", "name": layout.name, "features": features})


def to_geopackage(layout: Layout, scene: Scene) -> bytes:
    """Layout as a GeoPackage: points in the coordinates of the map that the scene was made from.

    Parameters
    ----------
    layout : Layout
        What to write.
    scene : Scene
        Where it hangs.

    Returns
    -------
    content : bytes
        A SQLite database with the layer "units": points with the height above the road as z, and
        the fields of the layout; x_m and y_m among them stay in the world frame.

    Raises
    ------
    InputError
        The scene has no crs, or one that pyproj does not know.

    References
    ----------
    .. [1] OGC 12-128, "GeoPackage Encoding Standard".
    """
    import geopandas as gpd
    import pyogrio

    require_crs(scene.crs, "gpkg")
    longitude_latitude(positions_m(layout), scene.crs)  # refuses what lies nowhere
    position = map_positions(layout, scene)
    records = placed_records(layout, scene)
    points = gpd.points_from_xy(
        position[:, 0], position[:, 1], z=[record["z_m"] for record in records]
    )
    table = gpd.GeoDataFrame(records, geometry=points, crs=scene.source_crs or scene.crs)
    file = io.BytesIO()
    pyogrio.write_dataframe(table, file, layer=_LAYER, driver="GPKG", geometry_type="Point Z")
    return file.getvalue()
