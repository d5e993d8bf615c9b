"""Layouts for Google Earth and other globes: KML."""

from functools import partial

from geometry.errors import InputError
from geometry.frames import to_carla_yaw
from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat
from .places import (
    AreaFinder,
    drawn_records,
    longitude_latitude,
    positions_m,
    require_crs,
)
from .xml import xml_text


def to_kml(layout: Layout, scene: Scene, *, views: AreaFinder | None = None) -> str:
    """Layout as KML: a placemark per unit, at its height above ground.

    With a pole below it.

    An XML document. Every field of the layout is in the placemark's ExtendedData; the
    placemark's camera looks from the unit's place along its optical axis. With `views`
    also what each camera sees, see :func:`.views.find_views`, as polygons on the
    ground. Raises InputError if the scene has no crs, or one that pyproj does not know,
    or if a name is not printable.

    References
    ----------
    .. [1] OGC 07-147r2, "KML 2.2": Placemark, ExtendedData, and Camera, whose heading
       is clockwise
       from north and whose tilt counts from straight down.
    """
    require_crs(scene.crs, "kml")
    records = drawn_records(layout, scene)
    texts = [
        ("name", layout.name),
        *(field for record in records for field in record.items()),
    ]
    for name, value in texts:
        if (
            isinstance(value, str) and not value.isprintable()
        ):  # XML has no words for most others
            raise InputError(f"kml: {name}", value, "printable text")
    place = partial(longitude_latitude, crs=scene.crs)
    return xml_text(
        "kml.xml.j2",
        namespace="http://www.opengis.net/kml/2.2",
        layout=layout,
        records=records,
        places_deg=longitude_latitude(positions_m(layout), scene.crs).tolist(),
        headings_deg=[
            float(to_carla_yaw(unit.pose.yaw_deg) + 90.0) % 360.0
            for unit in layout.units
        ],
        views=[] if views is None else views(layout, scene, place),
    )


FORMAT = ExportFormat(
    write=to_kml,
    options=("views",),
)
