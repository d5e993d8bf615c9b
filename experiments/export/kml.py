"""Layouts for Google Earth and other globes: KML."""

import xml.etree.ElementTree as ET
from typing import Any

from geometry.errors import InputError
from geometry.frames import to_carla_yaw
from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .places import (
    View,
    find_views,
    longitude_latitude,
    moved,
    placed_records,
    positions_m,
    require_crs,
)

_NAMESPACE = "http://www.opengis.net/kml/2.2"


def to_kml(layout: Layout, scene: Scene, *, views: bool = False) -> str:
    """Layout as KML: a placemark per unit, at its height above ground, with a pole below it.

    An XML document. Every field of the layout is in the placemark's ExtendedData; the placemark's
    camera looks from the unit's place along its optical axis. With `views` also what each camera
    sees, see :func:`.places.find_views`, as polygons on the ground. Raises InputError if
    the scene has no crs, or one that pyproj does not know, or if a name is not printable.

    References
    ----------
    .. [1] OGC 07-147r2, "KML 2.2": Placemark, ExtendedData, and Camera, whose heading is clockwise
       from north and whose tilt counts from straight down.
    """
    require_crs(scene.crs, "kml")
    # Names without a prefix: some readers know no other.
    root = ET.Element("kml", {"xmlns": _NAMESPACE})
    document = ET.SubElement(root, "Document")
    _text(document, "name", layout.name)
    lon_lat_deg = longitude_latitude(positions_m(layout), scene.crs).tolist()
    records = placed_records(layout, scene)
    for unit, record, (longitude, latitude) in zip(layout.units, records, lon_lat_deg, strict=True):
        height_m = record.get("height_m", record["z_m"])
        placemark = ET.SubElement(document, "Placemark")
        _text(placemark, "name", unit.id)
        camera = ET.SubElement(placemark, "Camera")
        _text(camera, "longitude", repr(longitude))
        _text(camera, "latitude", repr(latitude))
        _text(camera, "altitude", repr(height_m))
        _text(camera, "heading", repr(float(to_carla_yaw(unit.pose.yaw_deg) + 90.0) % 360.0))
        _text(camera, "tilt", repr(90.0 + unit.pose.pitch_deg))
        _text(camera, "altitudeMode", "relativeToGround")
        _add_data(placemark, record)
        point = ET.SubElement(placemark, "Point")
        _text(point, "extrude", "1")
        _text(point, "altitudeMode", "relativeToGround")
        _text(point, "coordinates", f"{longitude!r},{latitude!r},{height_m!r}")
    found = find_views(layout, scene) if views else []
    areas = moved(found, lambda points_m: longitude_latitude(points_m, scene.crs))
    for view, there in zip(found, areas, strict=True):
        _add_view(document, view, there.area)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _add_view(document: ET.Element, view: View, area: Any) -> None:
    placemark = ET.SubElement(document, "Placemark")
    record = view.record()
    _text(placemark, "name", record.pop("id"))
    _add_data(placemark, record)
    together = ET.SubElement(placemark, "MultiGeometry")
    for part in getattr(area, "geoms", [area]):
        polygon = ET.SubElement(together, "Polygon")
        rings = [("outerBoundaryIs", part.exterior)]
        rings += [("innerBoundaryIs", ring) for ring in part.interiors]
        for name, ring in rings:
            line = ET.SubElement(ET.SubElement(polygon, name), "LinearRing")
            _text(line, "coordinates", " ".join(f"{x!r},{y!r}" for x, y in ring.coords))


def _add_data(placemark: ET.Element, record: dict[str, Any]) -> None:
    data = ET.SubElement(placemark, "ExtendedData")
    for name, value in record.items():
        _text(ET.SubElement(data, "Data", {"name": name}), "value", str(value))


def _text(parent: ET.Element, name: str, value: str) -> None:
    if not value.isprintable():  # XML has no words for most control characters
        raise InputError(f"kml: {name}", value, "printable text")
    ET.SubElement(parent, name).text = value


FORMAT = ExportFormat(
    write=to_kml,
    content="placemarks above ground; Google Earth",
    options=("views",),
)
