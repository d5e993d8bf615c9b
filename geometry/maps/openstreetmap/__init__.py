"""Maps from OpenStreetMap: a file of its data in, lanes, junctions, buildings and poles out."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import ArrayLike

from ...arrays import FloatArray, float_array
from ...errors import InputError, MissingExtraError, Unquoted
from ...files import write_atomically
from ...notes import Note
from ..georeferences import WGS84, local_crs, transform
from ..source_map import Omissions, SourceMap
from .buildings import find_bridges, find_buildings
from .elements import DEFAULTS, Elements, Way, parse_length_m, read_elements
from .junctions import find_junctions
from .lane_lines import build_lanes
from .lanes import is_oneway, runs_backward
from .network import build_network, is_for_cars, known_runs
from .things import find_barriers, find_crosswalks, find_poles, find_trees

__all__ = ["fetch_openstreetmap", "read_openstreetmap"]


_CLEAR = 0.8  # of all that shows a side
_CARRIAGEWAYS_M = (3.0, 30.0)  # apart


def find_driving_side(elements: Elements, positions_m: FloatArray) -> tuple[bool, str]:
    """True if traffic keeps left, and what shows it (empty: nothing, it is assumed).

    Evidence is the tag, the driving direction in roundabouts, or the side of a street's other
    carriageway. `positions_m` (n, 2) are those of the nodes.
    """
    ways = [way for way in elements.ways if is_for_cars(way.tags)]
    sides = Counter(way.tags.get("driving_side") for way in ways)
    if sides["left"] or sides["right"]:
        return sides["left"] > sides["right"], "its tag"
    for votes, how in (
        (_roundabouts(ways, positions_m), "roundabouts"),
        (_carriageways(ways, positions_m), "carriageways"),
    ):
        n_votes = sum(votes.values())
        for keeps_left in (True, False):
            if n_votes and votes[keeps_left] >= _CLEAR * n_votes:
                return keeps_left, how
    return False, ""


def _points(way: Way, positions_m: FloatArray) -> list[FloatArray]:
    step = -1 if runs_backward(way.tags) else 1
    return [positions_m[rows[::step]] for rows in known_runs(way.rows, positions_m)]


def _roundabouts(ways: list[Way], positions_m: FloatArray) -> Counter[bool]:
    """Votes of roundabouts: driven clockwise if traffic keeps left; parts of a ring count too."""
    votes: Counter[bool] = Counter()
    for way in ways:
        if way.tags.get("junction") not in ("roundabout", "circular"):
            continue
        for points in _points(way, positions_m):
            if len(points) >= 3:
                steps = np.diff(points, axis=0)
                bend = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
                if abs(bend.sum()) > 1e-6:
                    votes[bool(bend.sum() < 0.0)] += 1
    return votes


def _carriageways(ways: list[Way], positions_m: FloatArray) -> Counter[bool]:
    """Votes of streets: the other carriageway lies on the right if traffic keeps left."""
    votes: Counter[bool] = Counter()
    segments_m: list[FloatArray] = []
    names: list[str] = []
    for way in ways:
        name = way.tags.get("name") or way.tags.get("ref")
        if name and is_oneway(way.tags) and way.tags.get("junction") is None:
            for points in _points(way, positions_m):
                segments_m.append(np.stack([points[:-1], points[1:]], axis=1))
                names += [name] * (len(points) - 1)
    if not names:
        return votes
    lines = np.concatenate(segments_m)
    begin, end = lines[:, 0], lines[:, 1]
    middle, step = 0.5 * (begin + end), end - begin
    step /= np.hypot(*step.T)[:, None]
    tree = shapely.STRtree(shapely.linestrings(lines))
    low_m, high_m = _CARRIAGEWAYS_M
    one, other = tree.query(shapely.points(middle), predicate="dwithin", distance=high_m)
    is_opposite = np.einsum("ij,ij->i", step[one], step[other]) < -0.95
    one, other = one[is_opposite], other[is_opposite]
    apart = middle[other] - middle[one]
    across = step[one, 0] * apart[:, 1] - step[one, 1] * apart[:, 0]  # > 0: on the left
    is_beside = (np.abs(across) >= low_m) & (np.abs(across) <= high_m)
    for index in np.flatnonzero(is_beside):
        if names[one[index]] == names[other[index]]:
            votes[bool(across[index] < 0.0)] += 1
    return votes


# ---------- files
def read_openstreetmap(path: Path, *, keeps_left: bool | None = None) -> SourceMap:
    """Read a file of OpenStreetMap data.

    Coordinates are metres around the middle of the roads, heights are above the ground; there may
    be no junction. Raises InputError: the file cannot be read, is damaged or too large, or has no
    road for cars. `path`: XML (.osm, .osm.gz, .osm.bz2) or PBF (.osm.pbf). `keeps_left`: traffic
    keeps left; by default what the file shows: a tag, roundabouts, carriageways.
    """
    elements = read_elements(path)
    roads = [way for way in elements.ways if is_for_cars(way.tags)]
    rows = np.unique(np.concatenate([way.rows for way in roads])) if roads else np.empty(0, int)
    rows = rows[rows >= 0]
    if not len(rows):
        found = "no road for cars" if len(elements.node_ids) else "no nodes"
        raise InputError(str(path), Unquoted(found), "a map with roads")
    positions_m, crs = _project(elements, rows, path)
    elements = _near(elements, positions_m)
    omissions, side = Omissions(), "given"
    if keeps_left is None:
        keeps_left, side = find_driving_side(elements, positions_m)
    network = build_network(elements, positions_m, keeps_left=keeps_left, omissions=omissions)
    if not network.edges:
        raise InputError(str(path), Unquoted("no road with two nodes"), "a map with roads")
    reaches, junctions = find_junctions(network, elements, omissions)
    lanes = build_lanes(reaches)
    poles = find_poles(network, reaches, elements, keeps_left=keeps_left, omissions=omissions)
    crosswalks_m = find_crosswalks(network, elements, omissions)
    things = [
        *find_buildings(network, elements, omissions),
        *find_bridges(network, reaches, elements, omissions),
        *find_barriers(elements, positions_m, omissions),
        *find_trees(elements, positions_m, omissions),
    ]
    skipped = omissions.listed()
    if not side:
        why = "no tag, roundabout or pair of carriageways shows it: taken to keep right"
        skipped = (Note(what="side of the road", why=why, kind="side of the road"), *skipped)
    return SourceMap(
        name=path.name,
        crs=crs,
        source_crs=WGS84,
        heights="above ground",
        lanes=lanes,
        junctions=tuple(junctions),
        things=tuple(things),
        poles=poles,
        crosswalks_m=crosswalks_m,
        ground_m=_heights(elements, rows, positions_m),
        keeps_left=keeps_left,
        skipped=skipped,
    )


def _heights(elements: Elements, rows: np.ndarray, positions_m: FloatArray) -> FloatArray:
    """Nodes of roads that say how high above the sea they lie, (n, 3), in metres."""
    found = [
        (*positions_m[row], height_m)
        for row in rows.tolist()
        if (height_m := parse_length_m(elements.node_tags.get(row, {}).get("ele", ""))) is not None
    ]
    return np.array(found).reshape(-1, 3)


def _project(elements: Elements, rows: np.ndarray, path: Path) -> tuple[FloatArray, str]:
    """Positions of all nodes in metres around the middle of the roads, and their CRS."""
    lon_lat = elements.lon_lat_deg[rows]
    low, high = lon_lat.min(axis=0), lon_lat.max(axis=0)
    limit_deg = DEFAULTS["reading"]["max_span_deg"]
    if (high - low).max() > limit_deg:
        place = f"latitude {low[1]:g} to {high[1]:g}, longitude {low[0]:g} to {high[0]:g}"
        expected = f"a map of a place, at most {limit_deg:g} degree wide; cut it out first"
        raise InputError(str(path), Unquoted(f"roads from {place}"), expected)
    crs = local_crs(0.5 * (low + high), WGS84, where=str(path))
    # Far from the roads the projection ends, and nothing is needed there.
    is_near = (np.abs(elements.lon_lat_deg - 0.5 * (low + high)) <= 2.0 * limit_deg).all(axis=1)
    positions = np.full((len(is_near), 2), np.inf)
    positions[is_near] = transform(elements.lon_lat_deg[is_near], WGS84, crs)
    return positions, crs


def _near(elements: Elements, positions_m: FloatArray) -> Elements:
    """Elements without nodes that have no place."""
    is_there = np.isfinite(positions_m).all(axis=1)
    if is_there.all():
        return elements
    is_there = np.append(is_there, False)  # row -1: a node that the file does not have
    return replace(
        elements,
        node_tags={row: tags for row, tags in elements.node_tags.items() if is_there[row]},
        ways=tuple(
            replace(way, rows=np.where(is_there[way.rows], way.rows, -1)) for way in elements.ways
        ),
    )


# ---------- a public server
def fetch_openstreetmap(bbox: ArrayLike, path: Path) -> None:
    """Fetch all OpenStreetMap data within a box, by the Overpass API.

    `bbox` (4,): west, south, east, north. WGS 84. `path`: file to write, as XML; its folder must
    exist. Raises InputError: the box is not valid or too large; or the server does not answer with
    a map. MissingExtraError: the package for requests over the network is not installed.
    """
    west, south, east, north = box = float_array(bbox, (4,), "bbox")
    online = DEFAULTS["online"]
    size_deg = np.array([east - west, north - south])
    if not ((size_deg > 0.0).all() and (np.abs(box) <= [180.0, 90.0, 180.0, 90.0]).all()):
        raise InputError("bbox", box.tolist(), "west, south, east, north in degrees")
    if size_deg.max() > online["max_size_deg"]:
        raise InputError("bbox", box.tolist(), f"at most {online['max_size_deg']} degrees wide")
    try:
        import requests
    except ImportError:
        raise MissingExtraError(
            "fetching a map needs requests: pip install place-rsus[online] "
            "(in a checkout: uv run --extra online place-rsus ..)"
        ) from None
    timeout_s = online["timeout_s"]
    query = (
        f"[out:xml][timeout:{timeout_s}];nwr({south:.7f},{west:.7f},{north:.7f},{east:.7f});"
        "(._;>;);out body;"
    )
    try:
        answer = requests.post(online["url"], data={"data": query}, timeout=timeout_s)
        answer.raise_for_status()
    except requests.RequestException as error:
        raise InputError(online["url"], Unquoted(error), "a server that answers") from None
    if b"<osm" not in answer.content[:1000]:
        raise InputError(online["url"], Unquoted("no map"), "OpenStreetMap data as XML")
    write_atomically(path, answer.content)
