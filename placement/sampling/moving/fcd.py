"""Floating car data (FCD) of a traffic model of one's own, as SUMO writes them.

XML (also packed), CSV (also packed) and Parquet, with SUMO's names of columns. Positions are moved
into the scene's world frame by an offset that is given, or by the projection of the SUMO network
in the same folder.
"""

import csv
import io
import logging
import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.frames import parse_crs
from geometry.scene import Scene
from geometry.untrusted_files import open_parquet, open_stream

from .demand import Demand, kind_of
from .trajectories import Trajectories, build_trajectories

ENDINGS = (".xml", ".xml.gz", ".csv", ".csv.gz", ".parquet")
MAX_STEP_S = 1.0
"""Samples farther apart than this are not joined."""
_MAX_BYTES = 4_000_000_000  # read piece by piece: only rows near the junction are stored
_MAX_NEAR_ROWS = 20_000_000
_COLUMNS = ("timestep_time", "vehicle_id", "vehicle_x", "vehicle_y", "vehicle_angle")
_TYPE = "vehicle_type"
_ON_FOOT_OR_CYCLE = ("bicycle", "bike", "ped", "person")  # road users, but no bodies to hide behind
_STEP_TOLERANCE_S = 1.0e-3
_MARGIN_M = 30.0  # beyond the reach: as far as a car drives in a second or two
_log = logging.getLogger(__name__)

# One sample: time, vehicle, x, y, angle, type.
_Row = tuple[float, str, float, float, float, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placing:
    """How positions of a file become those of the world."""

    move: Callable[[FloatArray], FloatArray]  # (n, 2) -> (n, 2)
    turn_deg: float = 0.0  # by so much headings turn, counter-clockwise


def load_fcd(
    path: Path, scene: Scene, demand: Demand, *, offset_m: FloatArray | None, reach_m: float
) -> Trajectories:
    """Read a file of floating car data near a scene's junction.

    The demand has bodies for types of vehicles, by the words in their names. `offset_m` (2,) is
    added to x and y of the file; by default as the SUMO network says that lies in the same folder
    (the only .net.xml there), without one nothing. Vehicles must come within `reach_m` of the
    junction's middle; samples a little farther away are read, to be joined to those within.

    Raises InputError if the file cannot be read, is empty, cut off, or has a value that is no
    number, its samples are more than 1 s apart, or no vehicle comes near the junction.
    """
    if not path.name.lower().endswith(ENDINGS):
        raise InputError("traffic", str(path), "sumo, a .toml file of demand, or FCD of SUMO's: "
                         + ", ".join(ENDINGS))  # fmt: skip
    placing = _placing(path, scene, offset_m)
    middle: FloatArray = scene.outline_m.mean(axis=0)
    times: dict[float, None] = {}
    number: dict[str, int] = {}
    types: list[str] = []
    near: list[tuple[float, float, float, float, float]] = []
    nearest_m, n_seen = math.inf, 0
    for block in _blocks(path):
        for row in block:
            times[row[0]] = None
        there = [row for row in block if row[1]]
        if not there:
            continue
        n_seen += len(there)
        numbers = np.array([(row[0], *row[2:5]) for row in there], dtype=np.float64)
        _check_numbers(numbers, there, path)
        moved = placing.move(numbers[:, 1:3])
        away_m = np.hypot(*(moved - middle).T)
        nearest_m = min(nearest_m, float(away_m.min()))
        for index in np.flatnonzero(away_m <= reach_m + _MARGIN_M).tolist():
            name, kind = there[index][1], there[index][5]
            if name not in number:
                number[name] = len(types)
                types.append(kind)
            angle_deg = numbers[index, 3] - placing.turn_deg
            near.append((number[name], numbers[index, 0], *moved[index].tolist(), angle_deg))
        if len(near) > _MAX_NEAR_ROWS:
            raise InputError(str(path), Unquoted(f"more than {_MAX_NEAR_ROWS:,} samples near the "
                             "junction"), "fewer; cut out an hour")  # fmt: skip
    if n_seen == 0:
        raise InputError(str(path), Unquoted("no vehicle at any time"), "vehicles that drive")
    if nearest_m > reach_m:
        got = Unquoted(
            f"no vehicle within {reach_m:g} m of the junction, the nearest {nearest_m:.0f} m away"
        )
        raise InputError(str(path), got, "traffic of this place, or `traffic_offset` EAST,NORTH")
    step_s = _step_s(np.array(sorted(times)), path)
    samples = np.array(near)
    bodies, is_vehicle = _bodies(types, demand, path)
    samples = samples[is_vehicle[samples[:, 0].astype(np.int64)]]
    if len(samples) == 0:
        raise InputError(
            str(path), Unquoted("people and bicycles alone near the junction"), "vehicles"
        )
    return build_trajectories(
        bodies,
        vehicle=samples[:, 0].astype(np.int64),
        time_s=samples[:, 1],
        front_m=samples[:, 2:4],
        angle_deg=samples[:, 4],
        step_s=step_s,
        span_s=(min(times), max(times)),
    )


def _step_s(time_s: FloatArray, path: Path) -> float:
    """The step of a file's clock; raises InputError if it is not steady, or too long."""
    if len(time_s) < 2:
        raise InputError(str(path), Unquoted("one point in time"), "traffic over some time")
    steps = np.diff(time_s)
    step_s = float(steps.min())
    expected = f"steady steps of at most {MAX_STEP_S:g} s"
    if step_s > MAX_STEP_S + _STEP_TOLERANCE_S:
        raise InputError(str(path), Unquoted(f"a step of {step_s:g} s"), expected)
    # Tables have no row for a moment in which nobody drives: whole steps may be missing.
    missing = np.abs(steps - np.round(steps / step_s) * step_s)
    odd = np.flatnonzero(missing > max(_STEP_TOLERANCE_S, 0.01 * step_s))
    if len(odd):
        first = int(odd[0])
        got = f"{steps[first]:g} s after {time_s[first]:g} s, elsewhere {step_s:g} s"
        raise InputError(str(path), Unquoted(got), expected)
    return step_s


def _check_numbers(numbers: FloatArray, rows: list[_Row], path: Path) -> None:
    is_finite = np.isfinite(numbers)
    if not is_finite.all():
        row, column = np.argwhere(~is_finite)[0].tolist()
        name = ("time", "x", "y", "angle")[column]
        raise InputError(
            f"{path}: vehicle {rows[row][1]} at {rows[row][0]:g} s: {name}",
            float(numbers[row, column]),
            "a finite number",
        )


def _bodies(
    types: list[str], demand: Demand, path: Path
) -> tuple[tuple[Actor, ...], NDArray[np.bool_]]:
    """Body of each vehicle by its type, and whether it is one to hide behind."""
    unknown: dict[str, None] = {}
    bodies, is_vehicle = [], []
    for name in types:
        kind = kind_of(demand, name)
        on_foot = kind is None and any(word in name.lower() for word in _ON_FOOT_OR_CYCLE)
        if kind is None and not on_foot:
            unknown[name or "(none)"] = None
        bodies.append((kind or demand.vehicles[0]).actor)
        is_vehicle.append(not on_foot)
    if unknown:
        shown = ", ".join([*unknown][:5]) + (", .." if len(unknown) > 5 else "")
        _log.warning(
            "%s: types of vehicles not known by name (%s) drive as %s",
            path.name, shown, demand.vehicles[0].actor.name,
        )  # fmt: skip
    return tuple(bodies), np.array(is_vehicle, dtype=bool)


# ---------- formats


def _blocks(path: Path) -> Iterator[list[_Row]]:
    """Samples block by block; raises InputError where a file is no FCD, or ends in its middle."""
    name = path.name.lower()
    try:
        if name.endswith(".parquet"):
            yield from _parquet_blocks(path)
        elif name.endswith((".csv", ".csv.gz")):
            yield from _csv_blocks(path)
        else:
            yield from _xml_blocks(path)
    except InputError:
        raise
    except (EOFError, zlib.error):
        raise InputError(str(path), Unquoted("a file that is cut off"), "a whole file") from None
    except OSError as error:  # gzip.BadGzipFile is one
        raise InputError(str(path), Unquoted(error.strerror or error), "a readable file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(str(path), Unquoted(error), "FCD of SUMO's in UTF-8") from None


def _xml_blocks(path: Path) -> Iterator[list[_Row]]:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse

    n_steps = 0
    try:
        with open_stream(path, max_bytes=_MAX_BYTES) as file:
            root = None
            for event, element in iterparse(file, events=("start", "end"), forbid_dtd=True):
                if root is None:
                    root = element
                    if element.tag != "fcd-export":
                        raise InputError(
                            str(path), Unquoted(f"XML with {element.tag}"), "SUMO's fcd-export"
                        )
                if event == "end" and element.tag == "timestep":
                    n_steps += 1
                    yield _xml_rows(element, path)
                    root.clear()
    except DefusedXmlException as error:
        raise InputError(
            str(path), Unquoted(type(error).__name__), "XML without entities"
        ) from None
    except ParseError as error:
        if path.stat().st_size == 0:
            raise InputError(str(path), Unquoted("an empty file"), "SUMO's fcd-export") from None
        got = f"a file that is cut off or damaged after {n_steps} steps ({error})"
        raise InputError(str(path), Unquoted(got), "a whole file") from None


def _xml_rows(element: Any, path: Path) -> list[_Row]:
    time_s = _number(element.get("time"), f"{path}: timestep: time")
    rows: list[_Row] = [(time_s, "", 0.0, 0.0, 0.0, "")]
    for vehicle in element.iter("vehicle"):
        name = vehicle.get("id") or ""
        where = f"{path}: vehicle {name} at {time_s:g} s"
        x, y, angle = (_number(vehicle.get(key), f"{where}: {key}") for key in ("x", "y", "angle"))
        rows.append((time_s, name, x, y, angle, vehicle.get("type") or ""))
    return rows


def _csv_blocks(path: Path) -> Iterator[list[_Row]]:
    with open_stream(path, max_bytes=_MAX_BYTES) as stream:
        file = io.TextIOWrapper(stream, encoding="utf-8-sig", newline="")
        head = file.readline(_MAX_LINE)
        if not head.strip():
            raise InputError(str(path), Unquoted("an empty file"), "columns " + ", ".join(_COLUMNS))
        comma = max(";,\t", key=head.count)
        columns = [column.strip() for column in head.strip().split(comma)]
        place = _places(columns, path)
        block: list[_Row] = []
        for number, cells in enumerate(csv.reader(file, delimiter=comma), start=2):
            if not cells:
                continue
            if len(cells) != len(columns):
                got = f"line {number} with {len(cells)} of {len(columns)} columns"
                raise InputError(str(path), Unquoted(got), "a whole file")
            block.append(_table_row([cells[i] if i >= 0 else "" for i in place], path))
            if len(block) >= _BLOCK:
                yield block
                block = []
        yield block


def _parquet_blocks(path: Path) -> Iterator[list[_Row]]:
    whole = "a whole Parquet file"
    with open_parquet(path, max_bytes=_MAX_BYTES, expected=whole) as file:
        names = file.schema_arrow.names
        place = _places(names, path)
        wanted = [names[i] for i in place if i >= 0]
        for batch in file.iter_batches(batch_size=_BLOCK, columns=wanted):
            columns = [_values(batch.column(name)) for name in wanted]
            if len(wanted) < len(place):
                columns.append([""] * batch.num_rows)
            yield [_table_row(list(cells), path) for cells in zip(*columns, strict=True)]


def _values(column: Any) -> list[Any]:
    """Values of a column; a text that occurs often is one object."""
    if not hasattr(column, "dictionary"):
        values: list[Any] = column.to_pylist()
        return values
    words = column.dictionary.to_pylist()
    return [None if index is None else words[index] for index in column.indices.to_pylist()]


_BLOCK = 65_536
_MAX_LINE = 65_536  # characters


def _places(columns: list[str], path: Path) -> list[int]:
    """Where the columns stand; -1 for a type that is not there."""
    for name in _COLUMNS:
        if name not in columns:
            got = Unquoted("columns " + ", ".join(columns[:12]))
            raise InputError(str(path), got, "SUMO's: " + ", ".join((*_COLUMNS, _TYPE)))
    return [columns.index(name) if name in columns else -1 for name in (*_COLUMNS, _TYPE)]


def _table_row(cells: list[Any], path: Path) -> _Row:
    time_s = _number(cells[0], f"{path}: timestep_time")
    name = "" if cells[1] is None else str(cells[1])
    if not name:
        return (time_s, "", 0.0, 0.0, 0.0, "")
    where = f"{path}: vehicle {name} at {time_s:g} s"
    x, y, angle = (
        _number(cell, f"{where}: {key}")
        for cell, key in zip(cells[2:5], ("x", "y", "angle"), strict=True)
    )
    return (time_s, name, x, y, angle, str(cells[5] or ""))


def _number(text: Any, where: str) -> float:
    """A finite number out of a file."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        raise InputError(where, text, "a finite number") from None
    if not math.isfinite(value):
        raise InputError(where, value, "a finite number")
    return value


# ---------- from the file's coordinates to the world's


def _placing(path: Path, scene: Scene, offset_m: FloatArray | None) -> Placing:
    if offset_m is not None:
        return Placing(move=lambda points: points + offset_m)
    networks = sorted([*path.parent.glob("*.net.xml"), *path.parent.glob("*.net.xml.gz")])
    if len(networks) != 1:
        return Placing(move=lambda points: points)
    return _placing_of_network(networks[0], scene)


def _placing_of_network(network: Path, scene: Scene) -> Placing:
    """From a SUMO network's own frame by the projection that it states, or its offset alone."""
    net_offset, projection = _location(network)
    middle = scene.outline_m.mean(axis=0)
    if projection in ("", "!") or not scene.crs:
        moved_by = -net_offset - scene.source_origin_m
        _log.info("%s: offset %s m", network.name, moved_by.tolist())
        return Placing(move=lambda points: points + moved_by)
    import pyproj

    try:
        to_world = pyproj.Transformer.from_crs(parse_crs(projection), scene.crs, always_xy=True)
        to_map = pyproj.Transformer.from_crs(scene.crs, parse_crs(projection), always_xy=True)
    except pyproj.exceptions.CRSError as error:
        where = f"{network}: projParameter"
        raise InputError(where, Unquoted(error), "a projection that PROJ knows") from None

    def move(points: FloatArray) -> FloatArray:
        return np.column_stack(to_world.transform(*(points - net_offset).T))

    here = np.array(to_map.transform(*middle)) + net_offset
    if not np.isfinite(here).all():
        return Placing(move=move)  # the other end of the world: nobody is near
    east, north = np.diff(move(np.array([here, here + [0.0, 10.0]])), axis=0)[0].tolist()
    return Placing(move=move, turn_deg=math.degrees(math.atan2(north, east)) - 90.0)


def _location(network: Path) -> tuple[FloatArray, str]:
    """Offset (2,) and projection of a SUMO network."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse

    try:
        with open_stream(network, max_bytes=_MAX_BYTES) as file:
            for _, element in iterparse(file, events=("start",), forbid_dtd=True):
                if element.tag == "location":
                    words = (element.get("netOffset") or "").split(",")
                    if len(words) == 2:
                        offset = [_number(word, f"{network}: netOffset") for word in words]
                        return np.array(offset), (element.get("projParameter") or "")
                    break
    except (OSError, EOFError, zlib.error, ParseError, DefusedXmlException) as error:
        raise InputError(str(network), Unquoted(error), "a SUMO network") from None
    raise InputError(str(network), Unquoted("no location with netOffset"), "a SUMO network")
