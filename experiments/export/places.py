"""Places of a layout's units on earth and in the map."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, refuse
from geometry.frames import parse_crs, to_geographic, transform
from geometry.junction import compass_bearing_deg
from geometry.notes import assumed_sites
from geometry.scene import Scene
from geometry.terrain import terrain_of
from placement.candidates import CandidatePose, above_ground
from placement.layout import Layout, layout_records


def positions_m(layout: Layout) -> FloatArray:
    """Positions of the units in metres, world frame, (n_units, 3)."""
    return np.array([unit.pose.position_m for unit in layout.units])


def surveyed_positions_m(units: Sequence[CandidatePose], scene: Scene) -> FloatArray:
    """Positions of units in metres, world frame, (n_units, 3), for who mounts them.

    They are those of the units but for surveyed poles that the model has elsewhere:
    beside a wall that the map has on the pole.
    """
    moved_m = {
        site.id: site.surveyed_m - site.position_m[:2]
        for site in scene.sites
        if site.surveyed_m is not None
    }
    positions = np.array([unit.pose.position_m for unit in units]).reshape(-1, 3)
    for index, unit in enumerate(units):
        if unit.site_id in moved_m:
            positions[index, :2] += moved_m[unit.site_id]
    return positions


def placed_records(layout: Layout, scene: Scene | None) -> list[dict[str, Any]]:
    """Units as records, with their place in the map that a scene was made from.

    As :func:`placement.layout.layout_records`; in addition map_x, map_y (longitude and
    latitude where the map has degrees) and map_crs, which is empty if the map does not
    say where on earth it lies. Where the ground is not flat, height_m is that above the
    ground below the unit, and map_z that of the map. Where sites are assumed, "assumed"
    says what, and is empty for the others.
    """
    records = layout_records(layout)
    doubts = {} if scene is None else assumed_sites(scene.notes)
    if any(unit.site_id in doubts for unit in layout.units):
        records = [
            record | {"assumed": doubts.get(record["site"], "")} for record in records
        ]
    if scene is not None and terrain_of(scene) is not None:
        zero_m = scene.zero_height_m
        records = [
            record
            | {"height_m": round(above_ground(unit, scene).pose.position_m.item(2), 3)}
            | ({} if zero_m is None else {"map_z": round(record["z_m"] + zero_m, 3)})
            for record, unit in zip(records, layout.units, strict=True)
        ]
    if scene is None or not (scene.source_crs or scene.source_origin_m.any()):
        return records
    points_m = surveyed_positions_m(layout.units, scene)[:, :2]
    if scene.crs:
        position = map_points(points_m, scene)
    else:
        position = points_m + scene.source_origin_m
    return [
        record | {"map_x": float(x), "map_y": float(y), "map_crs": scene.source_crs}
        for record, (x, y) in zip(records, position, strict=True)
    ]


def drawn_records(layout: Layout, scene: Scene | None) -> list[dict[str, Any]]:
    """As :func:`placed_records`, with bearing_deg clockwise from north.

    For programs that draw maps. Tables of layouts have the yaw alone: they are read
    back, and two directions of one unit could contradict each other.
    """
    return [
        record | {"bearing_deg": compass_bearing_deg(record["yaw_deg"])}
        for record in placed_records(layout, scene)
    ]


def map_points(points_m: FloatArray, scene: Scene) -> FloatArray:
    """Points of the world frame, (n, 2), in the map's ``source_crs``.

    Or else ``crs``.
    """
    if not scene.source_crs:
        return points_m
    return transform(points_m, scene.crs, scene.source_crs)


def metric_points(points_m: FloatArray, scene: Scene) -> FloatArray:
    """Points of the world frame, (n, 2), in the map's coordinates.

    Where these are in metres.
    """
    if not scene.crs:
        return points_m + scene.source_origin_m
    if scene.source_crs and parse_crs(scene.source_crs).is_geographic:
        return points_m
    return map_points(points_m, scene)


def require_crs(crs: str, format_name: str) -> None:
    """Raise InputError for a scene that does not say where on earth it lies."""
    if not crs:
        refuse(
            format_name, "a scene without crs", "one that says where on earth it lies"
        )


def longitude_latitude(points_m: FloatArray, crs: str) -> FloatArray:
    """Points of the world frame, (n, 2) or (n, 3), in WGS 84.

    Longitude, latitude, (n, 2) degrees.

    Raises InputError if pyproj does not know `crs`, or they lie outside of where it is
    defined.
    """
    from pyproj.exceptions import CRSError, ProjError

    try:
        lon_lat_deg = to_geographic(points_m, crs)
    except (CRSError, ProjError):
        raise InputError(
            "crs", crs, "a coordinate reference system that pyproj knows"
        ) from None
    if not np.isfinite(lon_lat_deg).all():
        raise InputError(
            "crs", crs, "a coordinate reference system that contains the layout"
        )
    return lon_lat_deg


class SeenArea(Protocol):
    """Area that a camera sees, or road that none sees; see :class:`.views.View`."""

    @property
    def area(self) -> Any:
        """Shapely's polygons without overlap."""

    def record(self) -> dict[str, Any]:
        """Fields of it in a table."""


class AreaFinder(Protocol):
    """What finds the areas that cameras see, such as :func:`.views.find_views`."""

    def __call__(
        self, layout: Layout, scene: Scene, move: Callable[[FloatArray], FloatArray]
    ) -> Sequence[SeenArea]:
        """Areas in the coordinates to which `move` takes points of the world frame."""
