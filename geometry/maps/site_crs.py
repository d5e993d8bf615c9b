"""Reference system of a list of sites that does not say which one it is in."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from ..arrays import FloatArray
from ..errors import InputError, refuse
from ..frames import WGS84, transform
from ..notes import Note
from ..phrases import Phrase
from ..text_formats import load_data
from .place_lists import SiteRows, crs_words, read_number
from .source_map import SourceMap

_LEFT_OUT: list[str] = load_data("geometry.maps", "words.toml")["places"]["crs"][
    "left_out"
]
# Around the lanes of a map.
_MARGIN_M = 100.0
# No datum in use differs more from another (a few hundred metres).
_DATUM_DEG = 0.1
# Systems that differ less are one: what leads from datum to datum is no more exact.
_SAME_M = 5.0
# Poles of streets stand as near to a lane's middle ...
_NEAR_M = 20.0
# ... and so do at least as many of a list.
_NEAR_SHARE = 0.8
_MAX_LISTED = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _CrsTrial:
    """A reference system that may be the list's, and where the sites are then."""

    code: str
    points_m: FloatArray


def find_sites_crs(listed: SiteRows, roads: SourceMap) -> tuple[str, tuple[Note, ...]]:
    """Reference system of x and y of a list that declares none.

    Coordinates that lie on the map as they are, are in the map's own system. Else
    the projected systems of https://epsg.org in use at the place are tried; one is
    taken if it alone puts sites on the map, and where several do, if it alone puts
    four of five of them within 20 m of a lane.

    Parameters
    ----------
    listed : SiteRows
        Rows of the list.
    roads : SourceMap
        Map with the roads.

    Returns
    -------
    crs : str
        Empty: that of the map.
    notes : tuple of Note
        Tells the system that was taken.

    Raises
    ------
    InputError
        No system, or none alone, puts sites on the map.
    """
    if listed.crs or not roads.crs or not roads.lanes:
        return "", ()
    points = _points_of(listed)
    if not len(points):
        return "", ()
    corners = np.concatenate([lane.centreline_m for lane in roads.lanes])[:, :2]
    low = corners.min(axis=0) - _MARGIN_M
    high = corners.max(axis=0) + _MARGIN_M
    if _is_within(points, low, high).any():
        return "", ()
    trials = []
    box_deg = transform(np.array([low, high]), roads.crs, WGS84)
    for code in _systems_at(box_deg.mean(axis=0)):
        if not _may_fit(code, points, box_deg):
            continue
        try:
            moved = transform(points, code, roads.crs)
        except InputError:
            # No way between the two is known.
            continue
        if _is_within(moved, low, high).any():
            trials.append(_CrsTrial(code=code, points_m=moved))
    where = f"{listed.path}: x and y"
    first = ", ".join(f"{number:.2f}" for number in points[0])
    if not trials:
        expected = (
            f"places on the map {roads.name}, in its coordinates, or `sites_crs` with"
            " the reference system that they are in: none in use there fits"
        )
        refuse(where, first, expected)
    found = _apart(trials)
    if len(found) > 1:
        near = _along_lanes(found, roads, low, high)
        if len(near) != 1:
            several = near or found
            names = ", ".join(crs_words(one.code) for one in several[:_MAX_LISTED])
            expected = f"`sites_crs` with the one that they are in: {names} would fit"
            refuse(where, first, expected)
        found = near
    chosen = found[0]
    why = Phrase(
        "taken as {crs}: no other reference system in use there fits the map",
        crs=crs_words(chosen.code),
    )
    note = Note(
        Phrase("coordinates in {name}", name=listed.path.name), why, kind="sites"
    )
    return chosen.code, (note,)


def _points_of(listed: SiteRows) -> FloatArray:
    """Places of the rows that have x and y, and no latitude, (n, 2)."""
    points = []
    for where, values in listed.rows:
        if values.get("lat") not in (None, ""):
            continue
        try:
            pair = [read_number(values, name, where) for name in ("x", "y")]
        except InputError:
            # It is told with the other faults of the file.
            continue
        if None not in pair:
            points.append(pair)
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def _is_within(points: FloatArray, low: FloatArray, high: FloatArray) -> Any:
    """True for points in a box, (n,); points that are not finite are outside."""
    return ((points >= low) & (points <= high)).all(axis=1)


def _may_fit(code: str, points: FloatArray, box_deg: FloatArray) -> bool:
    """True if points lie near a map by a system's own datum, which is quick to ask.

    `box_deg` has the longitude and latitude of two corners, (2, 2).
    """
    from pyproj import Proj

    x, y = points.T
    lonlat = np.stack(Proj(code)(x, y, inverse=True), axis=-1)
    low = box_deg.min(axis=0) - _DATUM_DEG
    high = box_deg.max(axis=0) + _DATUM_DEG
    return bool(_is_within(lonlat, low, high).any())


def _systems_at(lonlat_deg: FloatArray) -> list[str]:
    """Codes of the projected systems in use at a place.

    Of systems that are the same but for their names, the best known one comes first:
    that with the shortest name, then that of the smallest area.
    """
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    lon, lat = lonlat_deg.tolist()
    found = query_crs_info(
        auth_name="EPSG",
        pj_types=PJType.PROJECTED_CRS,
        area_of_interest=AreaOfInterest(lon, lat, lon, lat),
        contains=True,
    )
    ranked = {}
    for one in found:
        if one.deprecated or any(word in one.name for word in _LEFT_OUT):
            continue
        if one.area_of_use is None:
            continue
        west, south, east, north = one.area_of_use.bounds
        size = (east - west) % 360.0 * (north - south)
        ranked[one.code] = (len(one.name), size, int(one.code))
    return [f"EPSG:{code}" for code in sorted(ranked, key=ranked.__getitem__)]


def _apart(trials: list[_CrsTrial]) -> list[_CrsTrial]:
    """The first of each group of trials that puts the sites at the same places."""
    found: list[_CrsTrial] = []
    for trial in trials:
        for other in found:
            away_m = np.hypot(*(trial.points_m - other.points_m).T)
            if np.median(away_m) <= _SAME_M:
                break
        else:
            found.append(trial)
    return found


def _along_lanes(
    trials: list[_CrsTrial], roads: SourceMap, low: FloatArray, high: FloatArray
) -> list[_CrsTrial]:
    """Trials that put about as many sites on the map as any, most of them near lanes.

    `low` and `high` are corners of the map's box. [m]
    """
    lines = [shapely.linestrings(lane.centreline_m[:, :2]) for lane in roads.lanes]
    tree = shapely.STRtree(lines)
    inside = [one.points_m[_is_within(one.points_m, low, high)] for one in trials]
    most = max(map(len, inside))
    found = []
    for trial, points in zip(trials, inside, strict=True):
        pairs = tree.query(
            shapely.points(points), predicate="dwithin", distance=_NEAR_M
        )
        n_near = len(np.unique(pairs[0]))
        if len(points) >= _NEAR_SHARE * most and n_near >= _NEAR_SHARE * len(points):
            found.append(trial)
    return found
