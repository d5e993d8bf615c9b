"""Layouts as GeoPackage."""

from pathlib import Path
from tempfile import TemporaryDirectory

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .places import (
    find_views,
    longitude_latitude,
    map_points,
    moved,
    placed_records,
    positions_m,
    require_crs,
)

_LAYER = "units"


def to_geopackage(layout: Layout, scene: Scene, *, views: bool = False) -> bytes:
    """Layout as a GeoPackage: points in the coordinates of the map that the scene was made from.

    A SQLite database with the layer "units": points with the height as z (that
    of the map where the ground is not flat and the map tells it, else above the road), and the
    fields of the layout; x_m and y_m among them stay in the world frame. With `views` also the
    layer "views": see :func:`.places.find_views`. Raises InputError if the scene
    has no crs, or one that pyproj does not know.

    References
    ----------
    .. [1] OGC 12-128, "GeoPackage Encoding Standard".
    """
    import geopandas as gpd
    import pyogrio

    require_crs(scene.crs, "gpkg")
    longitude_latitude(positions_m(layout), scene.crs)  # refuses what lies nowhere
    position = map_points(positions_m(layout)[:, :2], scene)
    records = placed_records(layout, scene)
    points = gpd.points_from_xy(
        position[:, 0], position[:, 1], z=[record.get("map_z", record["z_m"]) for record in records]
    )
    table = gpd.GeoDataFrame(records, geometry=points, crs=scene.source_crs or scene.crs)
    with TemporaryDirectory() as folder:  # layers can be added to files alone
        path = Path(folder) / "layout.gpkg"
        pyogrio.write_dataframe(table, path, layer=_LAYER, driver="GPKG", geometry_type="Point Z")
        if views:
            found = find_views(layout, scene)
            shown = moved(found, lambda points_m: map_points(points_m, scene))
            records = [view.record() for view in found]  # areas in square metres
            shapes = [view.area for view in shown]
            areas = gpd.GeoDataFrame(records, geometry=shapes, crs=table.crs)
            pyogrio.write_dataframe(
                areas, path, layer="views", driver="GPKG", promote_to_multi=True
            )
        return path.read_bytes()


FORMAT = ExportFormat(
    write=to_geopackage,
    content="points in the map's own coordinates; QGIS, ArcGIS",
    is_binary=True,
    options=("views",),
)
