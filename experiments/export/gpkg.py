"""Layouts as GeoPackage."""

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .places import (
    AreaFinder,
    drawn_records,
    longitude_latitude,
    map_points,
    positions_m,
    require_crs,
)


def geopackage(
    layers: Iterable[tuple[str, str, list[dict[str, Any]], Any]], crs: str
) -> bytes:
    """Layers of one database: name, kind of geometry (empty.

    Areas), records and their places.

    References
    ----------
    .. [1] OGC 12-128, "GeoPackage Encoding Standard".
    """
    import geopandas as gpd
    import pyogrio

    # Layers can be added to files alone.
    with TemporaryDirectory() as folder:
        path = Path(folder) / "layers.gpkg"
        for name, kind, records, shapes in layers:
            pyogrio.write_dataframe(
                gpd.GeoDataFrame(records, geometry=shapes, crs=crs),
                path,
                name,
                "GPKG",
                geometry_type=kind or None,
                promote_to_multi=not kind,
                append=path.exists(),
            )
        return path.read_bytes()


def to_geopackage(
    layout: Layout, scene: Scene, *, views: AreaFinder | None = None
) -> bytes:
    """Layout as a GeoPackage.

    Points in the coordinates of the map that the scene was made from.

    A SQLite database with the layer "units": points with the height as z (that of the
    map where the ground is not flat and the map tells it, else above the road), and the
    fields of the layout; x_m and y_m among them stay in the world frame. With `views`
    also the layer "views": see :func:`.views.find_views`. Raises InputError if the
    scene has no crs, or one that pyproj does not know.
    """
    import geopandas as gpd

    require_crs(scene.crs, "gpkg")
    # Refuses what lies nowhere.
    longitude_latitude(positions_m(layout), scene.crs)
    position = map_points(positions_m(layout)[:, :2], scene)
    records = drawn_records(layout, scene)
    points = gpd.points_from_xy(
        position[:, 0],
        position[:, 1],
        z=[record.get("map_z", record["z_m"]) for record in records],
    )
    layers = [("units", "Point Z", records, points)]
    if views is not None:
        found = views(layout, scene, partial(map_points, scene=scene))
        layers.append(
            ("views", "", [one.record() for one in found], [one.area for one in found])
        )
    return geopackage(layers, scene.source_crs or scene.crs)


FORMAT = ExportFormat(
    write=to_geopackage,
    options=("views",),
)
