"""Maps from OpenStreetMap: lanes, junctions, buildings, poles and more."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ...arrays import FloatArray, float_array
from ...errors import InputError, MissingExtraError, Unquoted, refuse
from ...frames import WGS84, transform
from ...notes import Note
from ...phrases import Phrase
from ...progress import Progress, counted, silent
from ...writing import write_atomically
from ..georeferences import local_crs
from ..source_map import SourceMap, parse_length_m
from .elements import DEFAULTS, Elements, Way, read_elements
from .junctions import find_junctions
from .lane_counts import is_oneway, runs_backward
from .lane_lines import build_lanes
from .network import build_network, is_for_cars, lines_of
from .paths import find_paths
from .rings import open_mini_roundabouts
from .roundabouts import lay_roundabouts
from .things import (
    find_barriers,
    find_bridges,
    find_buildings,
    find_crosswalks,
    find_poles,
    find_trees,
)

__all__ = ["fetch_openstreetmap", "read_openstreetmap"]
# Of all that shows a side.
_CLEAR = 0.8
# Apart.
_CARRIAGEWAYS_M = (3.0, 30.0)


def find_driving_side(elements: Elements) -> tuple[bool, str]:
    """True if traffic keeps left, and what in the file shows it.

    A tag counts first, then roundabouts, then carriageways side by side.

    Parameters
    ----------
    elements : Elements
        Elements of the file.

    Returns
    -------
    keeps_left : bool
        False if nothing shows the side.
    how : str
        What shows it; empty: nothing, the side is assumed.
    """
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
    """Lines of a way in driving direction, (n, 2) each."""
    step = 1
    if runs_backward(way.tags):
        step = -1
    return [line_m[::step] for line_m in lines_of(way, elements)]


def _roundabouts(ways: list[Way], elements: Elements) -> Counter[bool]:
    """Votes of roundabouts: driven clockwise if traffic keeps left.

    Parts of a ring count, too, and directions of mini-roundabouts.

    Parameters
    ----------
    ways : list of Way
        Roads for cars.
    elements : Elements
        Elements of the file.

    Returns
    -------
    votes : Counter of bool
        True: traffic keeps left.
    """
    votes: Counter[bool] = Counter()
    for tags in elements.node_tags.values():
        if tags.get("highway") == "mini_roundabout":
            turn = tags.get("direction", "")
            votes[True] += turn == "clockwise"
            votes[False] += turn in ("anticlockwise", "counterclockwise")
    for way in ways:
        if way.tags.get("junction") not in ("roundabout", "circular"):
            continue
        for points in _points(way, elements):
            # The sum of the turns between segments tells left from right.
            if len(points) >= 3:
                steps = np.diff(points, axis=0)
                bend = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
                if abs(bend.sum()) > 1e-6:
                    votes[bool(bend.sum() < 0.0)] += 1
    return votes


def _carriageways(ways: list[Way], elements: Elements) -> Counter[bool]:
    """Votes of streets with two carriageways side by side.

    The other carriageway lies on the right if traffic keeps left.

    Parameters
    ----------
    ways : list of Way
        Roads for cars.
    elements : Elements
        Elements of the file.

    Returns
    -------
    votes : Counter of bool
        True: traffic keeps left.
    """
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
    # Pairs of segments that run against each other, side by side.
    lines = np.concatenate(segments_m)
    begin = lines[:, 0]
    end = lines[:, 1]
    middle = 0.5 * (begin + end)
    step = end - begin
    step /= np.hypot(*step.T)[:, None]
    tree = shapely.STRtree(shapely.linestrings(lines))
    low_m, high_m = _CARRIAGEWAYS_M
    one, other = tree.query(
        shapely.points(middle),
        predicate="dwithin",
        distance=high_m,
    )
    is_opposite = np.einsum("ij,ij->i", step[one], step[other]) < -0.95
    one = one[is_opposite]
    other = other[is_opposite]
    apart = middle[other] - middle[one]
    # > 0: on the left.
    across = step[one, 0] * apart[:, 1] - step[one, 1] * apart[:, 0]
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
    """Read a file of OpenStreetMap data, XML or PBF.

    Suffixes are .osm and .osm.pbf. Coordinates are metres
    around the middle of the roads, heights are above the ground.

    Parameters
    ----------
    path : Path
        File to read.
    keeps_left : bool or None
        Traffic keeps left; None: what the file shows.
    staggered_m : float
        Two side roads that meet a road from either side no farther apart than
        this are one junction, as are any roads within 25 m. [m]
    progress : Progress
        Called with what is being done, and how far it is.

    Returns
    -------
    source : SourceMap
        Lanes, junctions, things, poles and crosswalks.

    Raises
    ------
    InputError
        The file is damaged or too large, or has no road.
    """
    elements = read_elements(path)
    roads = [way for way in elements.ways if is_for_cars(way.tags)]
    rows = np.empty(0, int)
    if roads:
        rows = np.unique(np.concatenate([way.rows for way in roads]))
    rows = rows[rows >= 0]
    if not len(rows):
        found = "no nodes"
        if len(elements.node_ids):
            found = "no road for cars"
        refuse(str(path), found, "a map with roads")
    progress(Phrase("read streets"), 0, 0)
    elements, crs = _placed(elements, rows, path)
    # The side of traffic decides where lanes lie, so it comes before the network.
    side = "given"
    if keeps_left is None:
        keeps_left, side = find_driving_side(elements)
    mapped = build_network(elements, keeps_left=keeps_left)
    network = open_mini_roundabouts(mapped)
    if not network.edges:
        refuse(str(path), "no road with two nodes", "a map with roads")
    reaches, candidates, rings = find_junctions(network, staggered_m=staggered_m)
    lanes = build_lanes(reaches)
    junctions, connections = lay_roundabouts(
        rings, candidates, lanes, keeps_left=keeps_left
    )
    for junction in junctions:
        if junction.fault:
            elements.omissions.add(
                "junctions", f"junction {junction.id}", junction.fault
            )
    poles = tuple(find_poles(network, reaches))
    paths = tuple(find_paths(elements))
    crosswalks_m = find_crosswalks(network)
    n_buildings = sum("building" in way.tags for way in elements.ways)
    buildings = counted(
        find_buildings(network), Phrase("read buildings"), n_buildings, progress
    )
    built = (*buildings, *find_bridges(network, reaches))
    things = (*built, *find_barriers(elements), *find_trees(elements))
    skipped = elements.omissions.listed()
    if not side:
        what = Phrase("side of the road")
        why = Phrase(
            "no tag, roundabout or pair of carriageways shows it: right-hand traffic "
            "is assumed"
        )
        skipped = (Note(what, why, kind="side of the road"), *skipped)
    return SourceMap(
        name=path.name,
        crs=crs,
        source_crs=WGS84,
        heights="above ground",
        lanes=lanes,
        connections=tuple(connections),
        junctions=tuple(junctions),
        things=things,
        poles=poles,
        paths=paths,
        crosswalks_m=crosswalks_m,
        ground_m=_heights(elements, rows),
        keeps_left=keeps_left,
        skipped=skipped,
    )


def _heights(elements: Elements, rows: np.ndarray) -> FloatArray:
    """Nodes of roads that say how high they lie, (n, 3), in metres."""
    found = []
    for row in rows.tolist():
        tags = elements.node_tags.get(row, {})
        height_m = parse_length_m(tags.get("ele", ""))
        if height_m is not None:
            found.append((*elements.positions_m[row], height_m))
    return np.array(found).reshape(-1, 3)


def _placed(elements: Elements, rows: np.ndarray, path: Path) -> tuple[Elements, str]:
    """Elements in metres around the middle of the roads, and their CRS.

    Elements far from the roads are taken for missing ones.

    Parameters
    ----------
    elements : Elements
        Elements of the file.
    rows : np.ndarray
        Rows of the nodes of roads.
    path : Path
        File to read.

    Returns
    -------
    elements : Elements
        With positions; infinite for nodes far off.
    crs : str
        Transverse Mercator around the middle of the roads.

    Raises
    ------
    InputError
        The roads span more than a place does.
    """
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
    # Row -1: not in the file.
    is_there = np.append(np.isfinite(positions).all(axis=1), False)
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
    is_on_earth = (np.abs(box) <= [180.0, 90.0, 180.0, 90.0]).all()
    if not ((size_deg > 0.0).all() and is_on_earth):
        raise InputError("bbox", box.tolist(), "west, south, east, north in degrees")
    if size_deg.max() > online["max_size_deg"]:
        raise InputError(
            "bbox",
            box.tolist(),
            f"at most {online['max_size_deg']} degrees wide",
        )
    try:
        import requests
    except ImportError:
        raise MissingExtraError(
            "fetching a map needs requests: pip install place-rsus[online] "
            "(in a checkout: uv run --extra online place-rsus ..)"
        ) from None
    timeout_s = online["timeout_s"]
    corners = f"{south:.7f},{west:.7f},{north:.7f},{east:.7f}"
    query = f"[out:xml][timeout:{timeout_s}];nwr({corners});(._;>;);out body;"
    try:
        answer = requests.post(online["url"], data={"data": query}, timeout=timeout_s)
        answer.raise_for_status()
    except requests.RequestException as error:
        raise InputError(
            online["url"],
            Unquoted(error),
            "a server that answers",
        ) from None
    if b"<osm" not in answer.content[:1000]:
        refuse(online["url"], "no map", "OpenStreetMap data as XML")
    write_atomically(path, answer.content)
