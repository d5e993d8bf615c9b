"""OpenStreetMap files as maps."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...arrays import FloatArray
from ...errors import InputError, Unquoted
from ..local_frame import local_crs, transform
from ..model import Skipped, SourceMap
from .barriers import find_barriers
from .buildings import find_buildings
from .crosswalks import find_crosswalks
from .defaults import DEFAULTS
from .driving_side import find_driving_side
from .elements import Elements, read_elements
from .junctions import find_junctions
from .lanes import build_lanes
from .network import build_network, is_for_cars
from .notes import Notes
from .poles import find_poles
from .trees import find_trees

_WGS84 = "EPSG:4326"


def read_openstreetmap(path: Path, *, keeps_left: bool | None = None) -> SourceMap:
    """Read a file of OpenStreetMap data.

    Parameters
    ----------
    path : Path
        XML (.osm, .osm.gz, .osm.bz2) or PBF (.osm.pbf).
    keeps_left : bool, optional
        Traffic keeps left; by default what the file shows: a tag, roundabouts, carriageways.

    Returns
    -------
    source_map : SourceMap
        In metres around the middle of its roads, heights above the ground. It may have no
        junction.

    Raises
    ------
    InputError
        The file cannot be read, is damaged or too large, or has no road for cars.
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
    notes = Notes()
    side = ""
    if keeps_left is None:
        keeps_left, side = find_driving_side(elements, positions_m)
        side = side or "nothing"
    network = build_network(elements, positions_m, keeps_left=keeps_left, notes=notes)
    if not network.edges:
        raise InputError(str(path), Unquoted("no road with two nodes"), "a map with roads")
    reaches, junctions = find_junctions(network, elements, notes)
    lanes = build_lanes(reaches)
    poles = find_poles(network, reaches, elements, keeps_left=keeps_left, notes=notes)
    crosswalks_m = find_crosswalks(network, elements, notes)
    things = [
        *find_buildings(elements, positions_m, notes),
        *find_barriers(elements, positions_m, notes),
        *find_trees(elements, positions_m, notes),
    ]
    skipped = notes.skipped()
    if side == "nothing":
        assumed = Skipped(
            what="side of the road",
            why="nothing shows it - tag, roundabout, carriageways -: taken to keep right",
        )
        skipped = (assumed, *skipped)
    return SourceMap(
        name=path.name,
        crs=crs,
        source_crs=_WGS84,
        heights="above ground",
        lanes=lanes,
        junctions=tuple(junctions),
        things=tuple(things),
        poles=poles,
        crosswalks_m=crosswalks_m,
        keeps_left=keeps_left,
        skipped=skipped,
    )


def _project(elements: Elements, rows: np.ndarray, path: Path) -> tuple[FloatArray, str]:
    """Metres around the middle of the roads for all nodes, and what they count from."""
    lon_lat = elements.lon_lat_deg[rows]
    low, high = lon_lat.min(axis=0), lon_lat.max(axis=0)
    limit_deg = DEFAULTS["reading"]["max_span_deg"]
    if (high - low).max() > limit_deg:
        raise InputError(
            str(path),
            Unquoted(
                f"roads from latitude {low[1]:g} to {high[1]:g}, "
                f"longitude {low[0]:g} to {high[0]:g}"
            ),
            f"a map of a place, at most {limit_deg:g} degree wide; cut it out first",
        )
    crs = local_crs(0.5 * (low + high), _WGS84, where=str(path))
    # Far from the roads the projection ends; nobody needs what is there.
    is_near = (np.abs(elements.lon_lat_deg - 0.5 * (low + high)) <= 2.0 * limit_deg).all(axis=1)
    positions = np.full((len(is_near), 2), np.inf)
    positions[is_near] = transform(elements.lon_lat_deg[is_near], _WGS84, crs)
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
