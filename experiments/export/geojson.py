"""Layouts as GeoJSON."""

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .json import to_json_text
from .places import longitude_latitude, placed_records, positions_m, require_crs


def to_geojson(layout: Layout, crs: str, scene: Scene | None = None) -> str:
    """Layout as GeoJSON: points in WGS 84 with the layout's fields.

    A FeatureCollection. Coordinates are longitude, latitude [deg] and the height [m]:
    that of the map where the ground is not flat and the map tells it, else above the
    road. x_m and y_m among the properties stay in the world frame. Raises InputError
    if pyproj does not know `crs`, or the layout lies outside of where it is defined.

    References
    ----------
    .. [1] RFC 7946, "The GeoJSON Format", sections 3.1.1 (positions) and 4 (WGS 84).
    """
    require_crs(crs, "geojson")
    features = []
    places = longitude_latitude(positions_m(layout), crs).tolist()
    for record, lon_lat in zip(placed_records(layout, scene), places, strict=True):
        height_m = record.get("map_z", record["z_m"])
        feature = {
            "type": "Feature",
            "id": record["id"],
            "geometry": {"type": "Point", "coordinates": [*lon_lat, height_m]},
            "properties": record,
        }
        features.append(feature)
    return to_json_text(
        {"type": "FeatureCollection", "name": layout.name, "features": features}
    )


def _write(layout: Layout, scene: Scene) -> str:
    return to_geojson(layout, scene.crs, scene)


FORMAT = ExportFormat(
    write=_write,
    content="points in WGS 84; QGIS, geopandas, web maps",
)
