"""Maps from OpenStreetMap: a file of its data in, lanes, junctions, buildings and poles out."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ...arrays import FloatArray, float_array
from ...errors import InputError, MissingExtraError, Unquoted, refuse
from ...notes import Note
from ...progress import Progress, counted, silent
from ...writing import write_atomically
from ..georeferences import WGS84, local_crs, transform
from ..source_map import SourceMap, parse_length_m
from .elements import DEFAULTS, Elements, Way, read_elements
from .junctions import find_junctions
from .lane_lines import build_lanes
from .network import build_network, is_for_cars, is_oneway, lines_of, runs_backward
from .things import (
    find_barriers,
    find_bridges,
    find_buildings,
    find_crosswalks,
    find_poles,
    find_trees,
)

__all__ = ["fetch_openstreetmap", "read_openstreetmap"]
_CLEAR = 0.8  # of all that shows a side
_CARRIAGEWAYS_M = (3.0, 30.0)  # apart


def find_driving_side(elements: Elements) -> tuple[bool, str]:
    """True if traffic keeps left, and what shows it; empty: nothing, it is assumed."""
    ways = [way for way in elements.ways if is_for_cars(way.tags)]
    sides = Counter(way.tags.get("driving_side") for way in ways)
    if sides["left"] or sides["right"]:
        return sides["left"] > sides["right"], "its tag"
    for count, how in ((_roundabouts, "roundabouts"), (_carriageways, "carriageways")):
        votes = count(ways, elements)
        for keeps_left in (True, False):
            if votes.total() and votes[keeps_left] >= _CLEAR * votes.total():
                return keeps_left, how
    return False, ""


def _points(way: Way, elements: Elements) -> list[FloatArray]:
    if runs_backward(way.tags):
        step = -1
    else:
        step = 1
    return [line_m[::step] for line_m in lines_of(way, elements)]


def _roundabouts(ways: list[Way], elements: Elements) -> Counter[bool]:
    """Votes of roundabouts: driven clockwise if traffic keeps left; parts of a ring count too."""
    votes: Counter[bool] = Counter()
    for way in ways:
        if way.tags.get("junction") not in ("roundabout", "circular"):
            continue
        for points in _points(way, elements):
            if len(points) >= 3:
                steps = np.diff(points, axis=0)
                bend = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
                if abs(bend.sum()) > 1e-6:
                    votes[bool(bend.sum() < 0.0)] += 1
    return votes


def _carriageways(ways: list[Way], elements: Elements) -> Counter[bool]:
    """Votes of streets: the other carriageway lies on the right if traffic keeps left."""
    votes: Counter[bool] = Counter()
    segments_m: list[FloatArray] = []
    names: list[str] = []
    for way in ways:
        name = way.tags.get("name") or way.tags.get("ref")
        if name and is_oneway(way.tags) and way.tags.get("junction") is None:
            for points in _points(way, elements):
                segments_m.append(np.stack([points[:-1], points[1:]], axis=1))
                names += [name] * (len(points) - 1)
    if not names:
        return votes
    lines = np.concatenate(segments_m)
    begin = lines[:, 0]
    end = lines[:, 1]
    middle = 0.5 * (begin + end)
    step = end - begin
    step /= np.hypot(*step.T)[:, None]
    tree = shapely.STRtree(shapely.linestrings(lines))
    low_m, high_m = _CARRIAGEWAYS_M
    one, other = tree.query(
        shapely.points(middle), predicate="dwithin", distance=high_m
    )
    is_opposite = np.einsum("ij,ij->i", step[one], step[other]) < -0.95
    one = one[is_opposite]
    other = other[is_opposite]
    apart = middle[other] - middle[one]
    across = step[one, 0] * apart[:, 1] - step[one, 1] * apart[:, 0]  # > 0: on the left
    is_beside = (np.abs(across) >= low_m) & (np.abs(across) <= high_m)
    for index in np.flatnonzero(is_beside):
        if names[one[index]] == names[other[index]]:
            votes[bool(across[index] < 0.0)] += 1
    return votes


# ---------- files
def read_openstreetmap(
    path: Path,
    *,
    keeps_left: bool | None = None,
    staggered_m: float = 0.0,
    progress: Progress = silent,
) -> SourceMap:
    """Read a file of OpenStreetMap data: XML (.osm, .osm.gz, .osm.bz2) or PBF (.osm.pbf).

    Coordinates are metres around the middle of the roads, heights are above the ground.
    `keeps_left`: by default what the file shows. Two side roads that meet a road from
    either side no farther apart than `staggered_m` are one junction, as are any roads
    within 25 m. Raises InputError: it is damaged or too large, or has no road.
    """
    elements = read_elements(path)
    roads = [way for way in elements.ways if is_for_cars(way.tags)]
    if roads:
        rows = np.unique(np.concatenate([way.rows for way in roads]))
    else:
        rows = np.empty(0, int)
    rows = rows[rows >= 0]
    if not len(rows):
        if len(elements.node_ids):
            found = "no road for cars"
        else:
            found = "no nodes"
        refuse(str(path), found, "a map with roads")
    progress("read streets", 0, 0)
    elements, crs = _placed(elements, rows, path)
    side = "given"
    if keeps_left is None:
        keeps_left, side = find_driving_side(elements)
    network = build_network(elements, keeps_left=keeps_left)
    if not network.edges:
        refuse(str(path), "no road with two nodes", "a map with roads")
    reaches, junctions = find_junctions(network, staggered_m=staggered_m)
    lanes = build_lanes(reaches)
    poles = tuple(find_poles(network, reaches))
    crosswalks_m = find_crosswalks(network)
    n_buildings = sum("building" in way.tags for way in elements.ways)
    buildings = counted(
        find_buildings(network), "read buildings", n_buildings, progress
    )
    built = (*buildings, *find_bridges(network, reaches))
    things = (*built, *find_barriers(elements), *find_trees(elements))
    skipped = elements.omissions.listed()
    if not side:
        why = "no tag, roundabout or pair of carriageways shows it: taken to keep right"
        skipped = (Note("side of the road", why, kind="side of the road"), *skipped)
    return SourceMap(
        name=path.name,
        crs=crs,
        source_crs=WGS84,
        heights="above ground",
        lanes=lanes,
        junctions=tuple(junctions),
        things=things,
        poles=poles,
        crosswalks_m=crosswalks_m,
        ground_m=_heights(elements, rows),
        keeps_left=keeps_left,
        skipped=skipped,
    )


def _heights(elements: Elements, rows: np.ndarray) -> FloatArray:
    """Nodes of roads that say how high above the sea they lie, (n, 3), in metres."""
    found = [
        (*elements.positions_m[row], height_m)
        for row in rows.tolist()
        if (height_m := parse_length_m(elements.node_tags.get(row, {}).get("ele", "")))
        is not None
    ]
    return np.array(found).reshape(-1, 3)


def _placed(elements: Elements, rows: np.ndarray, path: Path) -> tuple[Elements, str]:
    """Elements in metres around the middle of the roads but those far off; and their CRS."""
    lon_lat = elements.lon_lat_deg[rows]
    low = lon_lat.min(axis=0)
    high = lon_lat.max(axis=0)
    limit_deg = DEFAULTS["reading"]["max_span_deg"]
    if (high - low).max() > limit_deg:
        place = (
            f"latitude {low[1]:g} to {high[1]:g}, longitude {low[0]:g} to {high[0]:g}"
        )
        expected = (
            f"a map of a place, at most {limit_deg:g} degree wide; cut it out first"
        )
        refuse(str(path), f"roads from {place}", expected)
    crs = local_crs(0.5 * (low + high), WGS84, where=str(path))
    # Far from the roads the projection ends, and nothing is needed there.
    is_near = (
        np.abs(elements.lon_lat_deg - 0.5 * (low + high)) <= 2.0 * limit_deg
    ).all(axis=1)
    positions = np.full((len(is_near), 2), np.inf)
    positions[is_near] = transform(elements.lon_lat_deg[is_near], WGS84, crs)
    elements = replace(elements, positions_m=positions)
    is_there = np.append(
        np.isfinite(positions).all(axis=1), False
    )  # row -1: not in the file
    if is_there[:-1].all():
        return elements, crs
    tags = {row: tags for row, tags in elements.node_tags.items() if is_there[row]}
    ways = (
        replace(way, rows=np.where(is_there[way.rows], way.rows, -1))
        for way in elements.ways
    )
    return replace(elements, node_tags=tags, ways=tuple(ways)), crs


# ---------- a public server
def fetch_openstreetmap(bbox: ArrayLike, path: Path) -> None:
    """Fetch all OpenStreetMap data within a box, by the Overpass API.

    Parameters
    ----------
    bbox : (4,) float
        West, south, east, north. WGS 84. [deg]
    path : Path
        File to write, as XML; its folder must exist.

    Raises
    ------
    InputError
        The box is not valid or too large; or the server does not answer with a map.
    MissingExtraError
        The package for requests over the network is not installed.
    """
    west, south, east, north = box = float_array(bbox, (4,), "bbox")
    online = DEFAULTS["online"]
    size_deg = np.array([east - west, north - south])
    if not (
        (size_deg > 0.0).all() and (np.abs(box) <= [180.0, 90.0, 180.0, 90.0]).all()
    ):
        raise InputError("bbox", box.tolist(), "west, south, east, north in degrees")
    if size_deg.max() > online["max_size_deg"]:
        raise InputError(
            "bbox", box.tolist(), f"at most {online['max_size_deg']} degrees wide"
        )
    try:
        import requests
    except ImportError:
        raise MissingExtraError(
            "fetching a map needs requests: pip install place-rsus[online] "
            "(in a checkout: uv run --extra online place-rsus ..)"
        ) from None
    timeout_s = online["timeout_s"]
    query = (
        f"[out:xml][timeout:{timeout_s}];nwr({south:.7f},{west:.7f},{north:.7f},{east:.7f});(._;>;);out"
        " body;"
    )
    try:
        answer = requests.post(online["url"], data={"data": query}, timeout=timeout_s)
        answer.raise_for_status()
    except requests.RequestException as error:
        raise InputError(
            online["url"], Unquoted(error), "a server that answers"
        ) from None
    if b"<osm" not in answer.content[:1000]:
        refuse(online["url"], "no map", "OpenStreetMap data as XML")
    write_atomically(path, answer.content)
