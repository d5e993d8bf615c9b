"""Recorded trajectories of road users.

They are read from CSV and SUMO's floating car data.
"""

import logging
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from geometry.actors import pick_actor
from geometry.arrays import FloatArray
from geometry.csv_files import csv_rows, read_csv_text
from geometry.errors import InputError, Unquoted, check_one_of, refuse
from geometry.tables import read_data
from geometry.text_formats import parse_number
from geometry.xml_files import read_xml

_log = logging.getLogger(__name__)
VEHICLE = "vehicle"
"""Class of whatever is replayed as the VUT."""


class _Tracks(Struct, frozen=True, kw_only=True):
    """When samples make up a track; ``data/trajectories.toml`` says more."""

    least_step_s: float
    step_tolerance: float
    max_gap_s: float
    velocity_s: float


class EncounterRules(Struct, frozen=True, kw_only=True):
    """Which pairs of tracks are encounters.

    Units are metres, seconds and metres per second.
    """

    min_vut_mps: float
    min_vru_mps: float
    min_known_s: float
    max_known_s: float
    way_step_m: float


class TrajectoryRules(Struct, frozen=True, kw_only=True):
    """``data/trajectories.toml``."""

    columns: dict[str, list[str]]
    classes: dict[str, list[str]]
    bodies: dict[str, str]
    fastest_mps: dict[str, float]
    time_units_s: dict[str, float]
    tracks: _Tracks
    encounters: EncounterRules


@cache
def load_trajectory_rules() -> TrajectoryRules:
    """How trajectories are read, from ``data/trajectories.toml``."""
    return read_data(__package__, "trajectories.toml", TrajectoryRules)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Where a road user was.

    Attributes
    ----------
    id : str
        Name as in the file.
    class_name : str
        "vehicle", "pedestrian", "cyclist" or "motorcyclist".
    time_s : (n,) float
        Times, n >= 3, ascending, on the recording's clock. [s]
    position_m : (n, 2) float
        Middle of the body, in the recording's frame. [m]
    yaw_deg : (n,) float
        Heading counter-clockwise from x; not a number where the file does not say.
        [deg]
    """

    id: str
    class_name: str
    time_s: FloatArray
    position_m: FloatArray
    yaw_deg: FloatArray

    def __repr__(self) -> str:
        return f"Track({self.id!r}, {self.class_name}, {len(self.time_s)} samples)"

    def at(self, time_s: FloatArray) -> FloatArray:
        """Positions (..., 2) at times, linear between samples.

        Beyond its ends the track stays.
        """
        east, north = (
            np.interp(time_s, self.time_s, axis) for axis in self.position_m.T
        )
        return np.stack([east, north], axis=-1)

    def velocity_mps(self, time_s: FloatArray) -> FloatArray:
        """Mean velocities (..., 2) from a moment before to one after each time."""
        reach_s = load_trajectory_rules().tracks.velocity_s
        before = np.maximum(time_s - reach_s, self.time_s[0])
        after = np.minimum(time_s + reach_s, self.time_s[-1])
        return np.asarray(
            (self.at(after) - self.at(before)) / (after - before)[..., None]
        )


class _Sample(NamedTuple):
    """Where somebody was at one time, as a file has it.

    Its time may be in another unit than seconds, see :func:`_time_unit`.
    """

    # File, and line or element.
    place: str
    id: str
    # For its class.
    word: str
    time_s: float
    x_m: float
    y_m: float
    yaw_deg: float


def read_tracks(
    path: Path,
    *,
    columns: Mapping[str, str] | None = None,
    frame_rate_hz: float | None = None,
    class_name: str = "",
) -> tuple[tuple[Track, ...], int]:
    """Tracks of a file, and how many road users are left out.

    Those are left out that are of other classes, or seen briefly.

    `path`: ``.csv``, or ``.xml`` of SUMO (floating car data). Of CSV
    files: `columns` gives their names by what they hold (id, time, frame, x, y,
    heading, heading_rad, class), in place of those that are recognised, `frame_rate_hz`
    is for those that count frames, and `class_name` for those without classes. Times
    are seconds of any clock, or milliseconds and the like where the column's name says
    so or steps show it, which is logged. Raises
    InputError with file and line, or element: no such format or column, a number is
    missing or not finite, times of a track do not ascend or are not whole steps of the
    file (mixed frame rates), or a track jumps.
    """
    if class_name:
        check_one_of("class", class_name, load_trajectory_rules().classes)
    unit_s: float | None = 1.0
    if path.suffix.lower() == ".csv":
        rows = csv_rows(
            read_csv_text(path), str(path), separators=",;\t", noun="columns"
        )
        _, header = next(rows, ("", []))
        at = _find_columns(path, header, columns or {}, frame_rate_hz)
        if "time" in at:
            unit_s = _named_unit(header[at["time"]])
        samples = _csv_samples(path, rows, header, at, frame_rate_hz, class_name)
    elif path.suffix.lower() == ".xml":
        samples = _xml_samples(path)
    else:
        raise InputError(str(path), path.suffix, ".csv, or .xml of SUMO")
    return _gather(path, samples, unit_s)


def _named_unit(column: str) -> float | None:
    """Unit of times in seconds by the end of a column's name; None: it has none."""
    words = re.findall(r"[^\W_]+", column.lower())
    return load_trajectory_rules().time_units_s.get(words[-1] if words else "")


def _time_unit(path: Path, step: float) -> float:
    """Unit of times in seconds by the file's step, which is told if it is none."""
    rules = load_trajectory_rules()
    if step <= rules.tracks.max_gap_s:
        return 1.0
    for name, unit_s in rules.time_units_s.items():
        step_s = unit_s * step
        if rules.tracks.least_step_s <= step_s <= rules.tracks.max_gap_s:
            _log.warning("%s: times read as %s, in steps of %g s", path, name, step_s)
            return unit_s
    return 1.0


def _gather(
    path: Path, samples: Iterator[_Sample], unit_s: float | None
) -> tuple[tuple[Track, ...], int]:
    """Tracks of samples, and how many road users are left out.

    `unit_s` is the unit of their times; None: the steps show it.
    """
    rules = load_trajectory_rules()
    by_word = {word: name for name, words in rules.classes.items() for word in words}
    tracks: dict[str, list[_Sample]] = {}
    # In messages about times before their unit is known.
    told_s = unit_s or 1.0
    for sample in samples:
        before = tracks.setdefault(sample.id, [])
        if before and not sample.time_s > before[-1].time_s:
            here_s = told_s * sample.time_s
            got = Unquoted(f"{here_s:.12g} s after {told_s * before[-1].time_s:.12g} s")
            raise InputError(
                f"{sample.place}: time", got, f"times of {sample.id} that ascend"
            )
        before.append(sample)
    if not tracks:
        raise InputError(str(path), Unquoted("nobody"), "trajectories of road users")
    known = {name: by_word.get(own[0].word.lower(), "") for name, own in tracks.items()}
    steps = [np.diff([sample.time_s for sample in own]) for own in tracks.values()]
    every = np.concatenate(steps)
    if len(every):
        step_s = float(np.median(every))
    else:
        step_s = 1.0
    if unit_s is None:
        unit_s = _time_unit(path, step_s)
    step_s *= unit_s
    found = []
    n_left_out = 0
    for (name, own), raw in zip(tracks.items(), steps, strict=True):
        if not known[name]:
            n_left_out += 1
            continue
        dt = unit_s * raw
        _check(own, dt, step_s, rules.fastest_mps[known[name]])
        # A long gap ends a track and begins another.
        cuts = np.flatnonzero(dt > rules.tracks.max_gap_s) + 1
        parts = np.split(np.array([row[3:] for row in own]), cuts)
        for number, part in enumerate(parts, start=1):
            if len(part) < _FEWEST:
                n_left_out += 1
                continue
            track = Track(
                id=name if len(parts) == 1 else f"{name}.{number}",
                class_name=known[name],
                time_s=unit_s * part[:, 0],
                position_m=part[:, 1:3],
                yaw_deg=part[:, 3],
            )
            found.append(track)
    return tuple(found), n_left_out


# Samples of a track.
_FEWEST = 3


def _check(
    own: Sequence[_Sample], dt: FloatArray, step_s: float, fastest_mps: float
) -> None:
    """Raise InputError at the first sample that is wrong.

    It is off the file's steps, or has jumped.
    """
    # Steps that are no whole multiple of the file's step.
    off = np.abs(dt / step_s - np.maximum(np.rint(dt / step_s), 1.0))
    bad = np.flatnonzero(off > load_trajectory_rules().tracks.step_tolerance)
    if len(bad):
        sample = own[bad[0] + 1]
        got = Unquoted(f"{dt[bad[0]]:g} s after the one before")
        expected = f"steps of {step_s:g} s, as in most of the file: one frame rate"
        raise InputError(f"{sample.place}: time", got, expected)
    if len(own) > 1:
        moved = np.hypot(*np.diff([row[4:6] for row in own], axis=0).T)
    else:
        moved = dt
    jumps = np.flatnonzero(moved > fastest_mps * dt)
    if len(jumps):
        sample = own[jumps[0] + 1]
        first = jumps[0]
        got = Unquoted(f"{moved[first]:.1f} m in {dt[first]:g} s")
        expected = f"a track of {sample.id} without jumps, at most {fastest_mps:g} m/s"
        raise InputError(sample.place, got, expected)


# ---------- CSV
def _csv_samples(
    path: Path,
    rows: Iterator[tuple[str, list[str]]],
    header: list[str],
    at: Mapping[str, int],
    frame_rate_hz: float | None,
    class_name: str,
) -> Iterator[_Sample]:
    """Samples of the rows of a CSV file, whose columns stand at `at`."""
    if "class" not in at and not class_name:
        expected = "a column with the class, or `class`: what all in the file are"
        refuse(f"{path}: line 1", ", ".join(header), expected)
    for place, row in rows:
        value = {
            name: _number(row[index], f"{place}: {header[index]}", _largest(name))
            for name, index in at.items()
            if name not in ("id", "class")
        }
        if "class" in at:
            word = row[at["class"]]
        else:
            word = class_name
        if "time" in at:
            time_s = value["time"]
        else:
            time_s = value["frame"] / (frame_rate_hz or 1.0)
        yaw_deg = value.get("heading", math.degrees(value.get("heading_rad", math.nan)))
        yield _Sample(
            place, row[at["id"]], word, time_s, value["x"], value["y"], yaw_deg
        )


def _find_columns(
    path: Path,
    header: list[str],
    columns: Mapping[str, str],
    frame_rate_hz: float | None,
) -> dict[str, int]:
    """Where in a row each thing stands, by what it is."""
    known = load_trajectory_rules().columns
    where = f"{path}: line 1"
    for name in columns:
        check_one_of("columns", name, known)
    # "Timestamp [ms]" is timestamp_ms.
    lower = ["_".join(re.findall(r"[^\W_]+", name.lower())) for name in header]
    at = {}
    for name, words in known.items():
        if name in columns:
            if columns[name] not in header:
                raise InputError(where, columns[name], "a column: " + ", ".join(header))
            at[name] = header.index(columns[name])
        elif found := [word for word in words if word in lower]:
            at[name] = lower.index(found[0])
    if frame_rate_hz is None:
        at.pop("frame", None)
    else:
        at.pop("time", None)
    for name in ("id", "x", "y"):
        if name not in at:
            expected = f"a column {name}, one of {', '.join(known[name])}, or `columns`"
            raise InputError(where, Unquoted(", ".join(header)), expected)
    if not {"time", "frame"} & set(at):
        expected = "a column time in seconds, or frame with `rate`: frames per second"
        raise InputError(where, Unquoted(", ".join(header)), expected)
    return at


# Of metres: beyond it differences are rounded off.
_LARGEST = 1.0e9
# Of times in any unit: Unix time in nanoseconds is 1.8e18, and exact to 256 of them.
_LATEST = 1.0e19


def _largest(name: str) -> float:
    """Largest number that makes sense in a column."""
    if name == "time":
        return _LATEST
    return _LARGEST


def _number(word: str | None, where: str, largest: float = _LARGEST) -> float:
    """The finite number that a word of a file is."""
    if word is None:
        raise InputError(where, Unquoted("nothing"), "a finite number")
    value = parse_number(word, where)
    if abs(value) > largest:
        raise InputError(where, word, f"a number, at most {largest:g}")
    return value


# ---------- XML
def _xml_samples(path: Path) -> Iterator[_Sample]:
    """Samples of SUMO's floating car data."""
    root = read_xml(path, expected="SUMO's floating car data")
    if root.tag != "fcd-export":
        raise InputError(str(path), root.tag, "an element <fcd-export>")
    length_m = pick_actor("vut", "vut").length_m
    for step in root.iter("timestep"):
        time_s = _number(step.get("time"), f"{path}: timestep: time")
        for thing in step:
            place = f"{path}: timestep {time_s:g}, {thing.tag} {thing.get('id')}"
            x, y, angle = (
                _number(thing.get(k), f"{place}: {k}") for k in ("x", "y", "angle")
            )
            # SUMO's is clockwise from north.
            yaw = math.radians(90.0 - angle)
            word = _sumo_class(thing.tag, thing.get("type") or "")
            # SUMO's point of a vehicle is its front bumper; the VUT's stands there,
            # too.
            if word == VEHICLE:
                back_m = 0.5 * length_m
            else:
                back_m = 0.0
            x = x - back_m * math.cos(yaw)
            y = y - back_m * math.sin(yaw)
            name = f"{thing.get('id')}"
            yield _Sample(place, name, word, time_s, x, y, math.degrees(yaw))


def _sumo_class(tag: str, type_name: str) -> str:
    """Class of a person or vehicle; who has a type of another name is a vehicle."""
    if tag != "vehicle":
        return tag
    words = load_trajectory_rules().classes
    is_known = any(
        type_name.lower() in words[name] for name in ("cyclist", "motorcyclist")
    )
    if is_known:
        return type_name
    return VEHICLE
