"""Layouts as GeoJSON."""

from collections.abc import Sequence
from typing import Any

from geometry.scene import Scene
from placement.layout import Layout

from .formats import ExportFormat
from .json import to_json_text
from .places import longitude_latitude, placed_records, positions_m, require_crs
from .views import View, find_views, moved


def to_geojson(
    layout: Layout, crs: str, scene: Scene | None = None, *, views: Sequence[View] = ()
) -> str:
    """Layout as GeoJSON: points in WGS 84, with the fields of the layout as properties.

    A FeatureCollection. Coordinates are longitude, latitude [deg] and the height [m]: that of the
    map where the ground is not flat and the map tells it, else above the road. x_m and y_m among
    the properties stay in the world frame. Views are further features, multipolygons.
    Raises InputError if pyproj does not know `crs`, or the
    layout lies outside of where it is defined.

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
                "coordinates": [
                    float(longitude),
                    float(latitude),
                    record.get("map_z", record["z_m"]),
                ],
            },
            "properties": record,
        }
        for record, (longitude, latitude) in zip(
            placed_records(layout, scene),
            longitude_latitude(positions_m(layout), crs),
            strict=True,
        )
    ]
    features += [_view_feature(view, crs) for view in views]
    return to_json_text({"type": "FeatureCollection", "name": layout.name, "features": features})


def _view_feature(view: View, crs: str) -> dict[str, Any]:
    area = moved(view, lambda points_m: longitude_latitude(points_m, crs)).area
    record = view.record()
    return {
        "type": "Feature",
        "id": record["id"],
        "geometry": area.__geo_interface__,
        "properties": record,
    }


def _write(layout: Layout, scene: Scene, *, views: bool = False) -> str:
    require_crs(scene.crs, "geojson")
    shown = find_views(layout, scene) if views else []
    return to_geojson(layout, scene.crs, scene, views=shown)


FORMAT = ExportFormat(
    write=_write,
    content="points in WGS 84; QGIS, geopandas, web maps",
    needs_crs=True,
    options=("views",),
)
