"""Refusal of files whose content all lies somewhere else than the map's roads."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray
from ..errors import refuse
from ..frames import WGS84, parse_crs, transform
from .source_map import SourceMap

# Tiles of a city are nearer to its roads.
_ELSEWHERE_M = 20_000.0
# Significant digits of distances.
_DIGITS = 2


def check_maps_lie_here(sources: Sequence[SourceMap]) -> None:
    """Raise InputError if all content of a map lies far from the roads of the others.

    Parameters
    ----------
    sources : sequence of SourceMap
        Maps; at least one has lanes.
    """
    roads = [_road_extent(source) for source in sources if source.lanes]
    for source in sources:
        if source.lanes:
            continue
        things = [thing.vertices_m[:1, :2] for thing in source.things]
        poles = [pole.position_m[None, :2] for pole in source.poles]
        crosswalks = source.crosswalks_m.reshape(-1, 2)
        for noun, places in (
            ("things", [one for one in things if len(one)]),
            ("poles", poles),
            ("crosswalks", [crosswalks]),
            ("points of the ground", [source.ground_m[:, :2]]),
        ):
            points_m = np.concatenate([np.empty((0, 2)), *places])
            if len(points_m):
                what = f"all {len(points_m):,} {noun} of {source.name}"
                _check_points(points_m, source, roads, what)


class _RoadExtent(NamedTuple):
    """Where the roads of a map lie: the middle, how far they reach, and in what."""

    middle_m: FloatArray
    reach_m: float
    crs: str


def _road_extent(source: SourceMap) -> _RoadExtent:
    """Extent of the lanes of a map that has some."""
    lines_m = np.concatenate([lane.centreline_m[:, :2] for lane in source.lanes])
    low_m = lines_m.min(axis=0)
    high_m = lines_m.max(axis=0)
    reach_m = 0.5 * float(np.hypot(*(high_m - low_m)))
    return _RoadExtent(0.5 * (low_m + high_m), reach_m, source.crs)


def _check_points(
    points_m: FloatArray, source: SourceMap, roads: Sequence[_RoadExtent], what: str
) -> None:
    """Raise InputError if points of a map all lie more than 20 km from all roads.

    Parameters
    ----------
    points_m : (n, 2) float
        At least one point. [m]
    source : SourceMap
        Their map.
    roads : sequence of _RoadExtent
        Where roads lie.
    what : str
        The points, in words.
    """
    away_m = min(_away_m(points_m, source.crs, one) for one in roads)
    if away_m <= _ELSEWHERE_M:
        return
    own_crs = source.source_crs or source.crs
    hint = "coordinates of another place, or of another reference system?"
    if own_crs:
        swapped = transform(points_m, source.crs or own_crs, own_crs)[:, ::-1]
        if min(_away_m(swapped, own_crs, one) for one in roads) <= _ELSEWHERE_M:
            hint = "easting and northing swapped?"
            if parse_crs(own_crs).is_geographic:
                hint = "latitude and longitude swapped?"
    elif any(one.crs for one in roads):
        hint = "it names no coordinate reference system, such as EPSG:25832"
    far = "elsewhere on earth"
    if np.isfinite(away_m):
        away_km = float(f"{away_m / 1000.0:.{_DIGITS}g}")
        far = f"{away_km:,.0f} km away"
    expected = "a file of the place that the roads are in"
    refuse(source.name, f"{what} lie {far}: {hint}", expected)


def _away_m(points: FloatArray, crs: str, roads: _RoadExtent) -> float:
    """Distance of the nearest point from the middle of some roads, less their reach.

    Parameters
    ----------
    points : (n, 2) float
        In metres or degrees, as `crs` has them.
    crs : str
        Their reference system; empty: that of the roads.
    roads : _RoadExtent
        Where they lie.

    Returns
    -------
    away_m : float
        Infinite: no point has a place on earth, or the two cannot be compared. [m]
    """
    from pyproj import Geod

    if not roads.crs:
        # Where one has a place on earth and the other has not, others say so.
        if crs:
            return 0.0
        return float(np.hypot(*(points - roads.middle_m).T).min()) - roads.reach_m
    lon_lat = transform(points, crs or roads.crs, WGS84)
    is_there = np.isfinite(lon_lat).all(axis=1) & (np.abs(lon_lat[:, 1]) <= 90.0)
    if not is_there.any():
        return float("inf")
    lon_lat = lon_lat[is_there]
    here_deg = transform(roads.middle_m[None], roads.crs, WGS84)
    here = np.broadcast_to(here_deg, lon_lat.shape)
    _, _, distances_m = Geod(ellps="WGS84").inv(*lon_lat.T, *here.T)
    return float(np.min(distances_m)) - roads.reach_m
