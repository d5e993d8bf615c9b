"""Layouts as GeoJSON."""

from collections.abc import Sequence
from functools import partial

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .json import to_json_text
from .places import (
    AreaFinder,
    SeenArea,
    drawn_records,
    longitude_latitude,
    positions_m,
    require_crs,
)


def to_geojson(
    layout: Layout,
    crs: str,
    scene: Scene | None = None,
    *,
    views: Sequence[SeenArea] = (),
) -> str:
    """Layout as GeoJSON: points in WGS 84, with the fields of the layout as properties.

    A FeatureCollection. Coordinates are longitude, latitude [deg] and the height [m]:
    that of the map where the ground is not flat and the map tells it, else above the
    road. x_m and y_m among the properties stay in the world frame. Views, in WGS 84,
    are further features, multipolygons. Raises InputError if pyproj does not know
    `crs`, or the layout lies outside of where it is defined.

    References
    ----------
    .. [1] RFC 7946, "The GeoJSON Format", sections 3.1.1 (positions) and 4 (WGS 84).
    """
    require_crs(crs, "geojson")
    shapes = []
    places = longitude_latitude(positions_m(layout), crs).tolist()
    for record, lon_lat in zip(drawn_records(layout, scene), places, strict=True):
        height_m = record.get("map_z", record["z_m"])
        shapes.append((record, {"type": "Point", "coordinates": [*lon_lat, height_m]}))
    shapes += [(view.record(), view.area.__geo_interface__) for view in views]
    features = [
        {
            "type": "Feature",
            "id": record["id"],
            "geometry": geometry,
            "properties": record,
        }
        for record, geometry in shapes
    ]
    return to_json_text(
        {"type": "FeatureCollection", "name": layout.name, "features": features}
    )


def _write(layout: Layout, scene: Scene, *, views: AreaFinder | None = None) -> str:
    require_crs(scene.crs, "geojson")
    place = partial(longitude_latitude, crs=scene.crs)
    found = () if views is None else views(layout, scene, place)
    return to_geojson(layout, scene.crs, scene, views=found)


FORMAT = ExportFormat(
    write=_write,
    options=("views",),
)
