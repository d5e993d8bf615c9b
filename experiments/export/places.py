"""Places of a layout's units on earth and in the map, and what its cameras see there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, refuse
from geometry.frames import parse_crs, to_geographic
from geometry.maps.georeferences import transform
from geometry.notes import assumed_sites
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.terrain import terrain_of
from placement.candidates import above_ground
from placement.ground import LOOK_AT_M, REACH_M, GroundSurvey
from placement.layout import Layout, layout_records


def positions_m(layout: Layout) -> FloatArray:
    """Positions of the units in metres, world frame, (n_units, 3)."""
    return np.array([unit.pose.position_m for unit in layout.units])


def placed_records(layout: Layout, scene: Scene | None) -> list[dict[str, Any]]:
    """Units as records, with their place in the map that a scene was made from.

    As :func:`placement.layout.layout_records`; in addition map_x, map_y (longitude and
    latitude where the map has degrees) and map_crs, which is empty if the map does not
    say where on earth it lies. Where the ground is not flat, height_m is that above the
    ground below the unit, and map_z that of the map. Where sites are assumed, "assumed"
    says what, and is empty for the others.
    """
    records = layout_records(layout)
    if scene is None:
        doubts = {}
    else:
        doubts = assumed_sites(scene.notes)
    if any(unit.site_id in doubts for unit in layout.units):
        records = [
            record | {"assumed": doubts.get(record["site"], "")} for record in records
        ]
    if scene is not None and terrain_of(scene) is not None:
        zero_m = scene.zero_height_m
        records = [
            record
            | {
                "height_m": round(
                    float(above_ground(unit, scene).pose.position_m[2]), 3
                )
            }
            | ({} if zero_m is None else {"map_z": round(record["z_m"] + zero_m, 3)})
            for record, unit in zip(records, layout.units, strict=True)
        ]
    if scene is None or not (scene.source_crs or scene.source_origin_m.any()):
        return records
    points_m = positions_m(layout)[:, :2]
    if scene.crs:
        position = map_points(points_m, scene)
    else:
        position = points_m + scene.source_origin_m
    return [
        record | {"map_x": float(x), "map_y": float(y), "map_crs": scene.source_crs}
        for record, (x, y) in zip(records, position, strict=True)
    ]


def map_points(points_m: FloatArray, scene: Scene) -> FloatArray:
    """Points of the world frame, (n, 2), in the map's ``source_crs``, or else ``crs``."""
    if not scene.source_crs:
        return points_m
    return transform(points_m, scene.crs, scene.source_crs)


def metric_points(points_m: FloatArray, scene: Scene) -> FloatArray:
    """Points of the world frame, (n, 2), in the map's coordinates, where these are in metres."""
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
    """Points of the world frame, (n, 2) or (n, 3), in WGS 84: longitude, latitude, (n, 2) degrees.

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


UNSEEN = "unseen"
NOTE = (
    f"squares of 1 m, {LOOK_AT_M:g} m above the road, up to {REACH_M:g} m from the"
    " middle"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Area that a camera sees, or road that no camera sees."""

    unit: str  # its id; empty: what no camera sees
    area: Any  # shapely's polygons without overlap, in any coordinates
    area_m2: float

    def record(self) -> dict[str, Any]:
        """Fields of it in a table."""
        return {
            "id": f"view of {self.unit}" if self.unit else UNSEEN,
            "unit": self.unit,
            "area_m2": self.area_m2,
            "note": NOTE,
        }


def find_views(
    layout: Layout,
    scene: Scene,
    move: Callable[[FloatArray], FloatArray] = np.asarray,
) -> list[View]:
    """Views of a layout's cameras, in its order, then the road that none sees.

    `move` takes points of the world frame, (n, 2), all at once to the coordinates that
    are wanted.
    """
    import shapely

    survey = GroundSurvey(scene)
    missed = survey.is_road.copy()
    masks = {}
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel):
            masks[unit.id] = survey.density(unit) > 0.0
            missed &= ~masks[unit.id]
    masks[""] = missed
    areas = [_outline(mask, survey.east_m, survey.north_m) for mask in masks.values()]
    moved = shapely.transform(np.array(areas, dtype=object), move)
    return [
        View(unit=name, area=there, area_m2=float(area.area))
        for name, area, there in zip(masks, areas, moved, strict=True)
    ]


def _outline(mask: BoolArray, east_m: FloatArray, north_m: FloatArray) -> Any:
    """Union of the cells of a mask, (n_north, n_east)."""
    import shapely

    x_m, y_m = (
        np.append(middles_m - 0.5 * step_m, middles_m[-1] + 0.5 * step_m)
        for middles_m in (east_m, north_m)
        for step_m in [middles_m[1] - middles_m[0]]
    )
    # Of each row its stretches: fewer boxes than cells.
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(steps > 0)
    _, end = np.nonzero(steps < 0)
    stretches = shapely.box(x_m[first], y_m[row], x_m[end], y_m[row + 1])
    return shapely.simplify(shapely.union_all(stretches), 0.0)
