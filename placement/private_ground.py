"""Private ground, and how much of it cameras have in view.

Private ground are gardens, terraces and window fronts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import refuse
from geometry.frames import check_crs, transform
from geometry.maps.gis_files import read_features
from geometry.raycast import RayCaster, build_caster, is_in_sight
from geometry.scene import Scene
from geometry.terrain import ground_height_m

from .candidates import CandidatePose, depth_in_picture

# Of people who are there; the ground itself may be hidden by a hedge.
EYE_HEIGHT_M = 1.5
_POINT_SPACING_M = 1.0
_MAX_POINTS = 20_000
# Beyond the horizon of every pole: the file is of another place.
_FARTHEST_M = 20_000.0
# Of the world frame: more than twice around the earth.
_MAX_COORDINATE_M = 1.0e8
# Of sensors, from which is known what lies open.
_MAX_PLACES = 64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PrivateGround:
    """Areas that cameras must not look into.

    Attributes
    ----------
    names : tuple of str
        Of the areas.
    points_m : (n, 3) float
        Points all over them, at people's eye height. World frame. [m]
    area_index : (n,) int
        Area of each point.
    area_m2 : (n_areas,) float
        How large they are. [m^2]
    shapes : tuple of Any
        The areas: shapely polygons, world frame, metres.
    """

    names: tuple[str, ...]
    points_m: FloatArray
    area_index: IntArray
    area_m2: FloatArray
    shapes: tuple[Any, ...]

    def shares(self, scene: Scene, candidates: Sequence[CandidatePose]) -> FloatArray:
        """Share of each area that each pose sees, see :func:`private_shares`."""
        return private_shares(scene, candidates, self)


def load_private_ground(path: Path, scene: Scene) -> PrivateGround:
    """Private ground in a scene's world frame, read from a GIS file.

    GeoJSON, GeoPackage and Shapefile are read. A column "name" or "id" names an
    area. Raises InputError if the file cannot be read, has no polygon, is of
    another place, or lies on earth while the scene does not.
    """
    found = read_features(path)
    check_crs(found.crs, f"{path}: crs")
    if found.crs and not scene.crs:
        refuse(
            str(path),
            f"coordinates in {found.crs}",
            "a scene that says where on earth it lies, or coordinates of its map"
            " without a crs",
        )

    def to_world(points: Any) -> Any:
        """Points of the file in the world frame of the scene."""
        if not found.crs:
            if not scene.crs:
                return points - scene.source_origin_m
            return points
        return transform(points, found.crs, scene.crs)

    # Take the polygons; other shapes are left out.
    areas = []
    for number, feature in enumerate(found.features, start=1):
        shape = feature.geometry
        if shape is None or shape.geom_type not in ("Polygon", "MultiPolygon"):
            continue
        name = str(
            feature.values.get("name") or feature.values.get("id") or f"area {number}"
        )
        world = shapely.transform(shapely.force_2d(shape), to_world)
        # make_valid() takes neither what is not finite nor what is beyond any place.
        if not (np.abs(shapely.get_coordinates(world)) < _MAX_COORDINATE_M).all():
            refuse(feature.where, "coordinates that cannot be", "a polygon")
        area = shapely.make_valid(world)
        away_m = float(shapely.distance(area, shapely.MultiPoint(scene.outline_m)))
        if away_m > _FARTHEST_M:
            got = f"an area {away_m / 1000.0:,.0f} km away from the junction"
            refuse(
                feature.where, got, f"areas within {_FARTHEST_M / 1000.0:g} km of it"
            )
        areas.append((name, area))
    if not areas:
        refuse(str(path), "no polygon", "areas that cameras must not look into")
    return build_private_ground(areas)


def build_private_ground(areas: Sequence[tuple[str, Any]]) -> PrivateGround:
    """Points all over areas, one each square metre.

    `areas` are shapely polygons by name; each has one point at least. Raises
    InputError where one is empty, or all together are too large.
    """
    total_m2 = sum(float(shape.area) for _, shape in areas)
    if total_m2 > _MAX_POINTS * _POINT_SPACING_M**2:
        refuse("no_look", f"{total_m2:,.0f} square metres", f"at most {_MAX_POINTS:,}")
    # Points on a square grid inside each area.
    points = []
    index = []
    for number, (name, shape) in enumerate(areas):
        if not shape.area > 0.0:
            refuse(f"no_look: {name}", "no area", "a polygon")
        west, south, east, north = shape.bounds
        x, y = np.meshgrid(
            np.arange(west + 0.5 * _POINT_SPACING_M, east, _POINT_SPACING_M),
            np.arange(south + 0.5 * _POINT_SPACING_M, north, _POINT_SPACING_M),
        )
        inside = shapely.contains_xy(shape, x, y)
        here = np.stack([x[inside], y[inside]], axis=1)
        if not len(here):
            inner = shape.representative_point()
            here = np.array([[inner.x, inner.y]])
        points.append(here)
        index.append(np.full(len(here), number))
    flat = np.concatenate(points)
    return PrivateGround(
        names=tuple(name for name, _ in areas),
        points_m=freeze(np.column_stack([flat, np.full(len(flat), EYE_HEIGHT_M)])),
        area_index=freeze(np.concatenate(index)),
        area_m2=freeze(np.array([float(shape.area) for _, shape in areas])),
        shapes=tuple(shape for _, shape in areas),
    )


class PrivateSight:
    """Private ground in the pictures of poses; not for several threads at once.

    What lies open to a place is looked up once. What parks or drives hides nothing for
    long, and is left out. LiDARs see none.
    """

    def __init__(self, scene: Scene, ground: PrivateGround) -> None:
        self._ground = ground
        self._origin = np.append(scene.outline_m.mean(axis=0), 0.0)
        self._caster: RayCaster = build_caster(
            scene.vertices_m - self._origin, scene.triangles
        )
        self._points_m = ground.points_m.copy()
        self._points_m[:, 2] += ground_height_m(scene, self._points_m[:, :2])
        self._lie_open = lru_cache(_MAX_PLACES)(self._look_from)

    def _look_from(self, *place: float) -> BoolArray:
        """Points that lie open to a place: x, y, z and the near distance."""
        mount_m = np.array(place[:3]) - self._origin
        near_m = place[3]
        return is_in_sight(
            self._caster, mount_m, self._points_m - self._origin, near_m=near_m
        )

    def seen(self, candidate: CandidatePose) -> BoolArray:
        """True for points of the ground that a pose sees, (n_points,) bool.

        It has them in its picture, and nothing hides them.
        """
        in_picture = np.isfinite(depth_in_picture(self._points_m, candidate))
        return self._lie_open(*_place(candidate)) & in_picture

    def shares(self, candidates: Sequence[CandidatePose]) -> FloatArray:
        """Share of each area's points that each pose sees, (n_candidates, n_areas)."""
        n_areas = len(self._ground.names)
        counts = np.bincount(self._ground.area_index, minlength=n_areas)
        share = np.zeros((len(candidates), n_areas))
        # Poses at the same place follow one another, so that rays are cast once.
        for row in sorted(
            range(len(candidates)), key=lambda row: _place(candidates[row])
        ):
            index = self._ground.area_index[self.seen(candidates[row])]
            share[row] = np.bincount(index, minlength=n_areas) / counts
        return share


def private_shares(
    scene: Scene, candidates: Sequence[CandidatePose], ground: PrivateGround
) -> FloatArray:
    """Share of each private area that each pose sees.

    It is (n_candidates, n_areas), 0 .. 1.
    """
    return PrivateSight(scene, ground).shares(candidates)


def _place(candidate: CandidatePose) -> tuple[float, ...]:
    return (*candidate.pose.position_m.tolist(), candidate.sensor.near_m)
