"""Registry of detectors, by name or by the suffix of a file."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, cast

from geometry.errors import InputError
from geometry.registry import load_entry

from .evidence import Detector, PlanningDetector

_GEOMETRIC = "placement.detectors.geometric:load_geometric"
_TABLE = "placement.detectors.response:load_table"
_TABLE_FILE = "placement.detectors.response:load_response_file"
_LIDAR_TABLE = "placement.detectors.response:load_lidar_table"
DETECTORS = {
    "geometric": _GEOMETRIC,
    "response": _TABLE,
    "pole-2015": _TABLE,
    "car-2019": _TABLE,
    "cnn-table": _TABLE,
    "cnn": "placement.detectors.network:load_shipped_network",
}
"""Detectors of cameras by name; each entry is a :class:`DetectorEntry`."""
DETECTOR_FILES = {
    ".toml": _TABLE_FILE,
    ".onnx": "placement.detectors.network:load_network_file",
}
"""Detectors of cameras by the suffix of a user's file: a :class:`DetectorFileEntry`."""
LIDAR_TABLES = {"pointrcnn-2019": _LIDAR_TABLE}
"""Tables of what LiDARs find, by name; each entry takes the name."""

DETECTOR_NAMES = tuple(DETECTORS)
"""Of cameras; ``LIDAR_NAMES`` may follow any of them, or a file, behind a plus sign."""
LIDAR_NAMES = tuple(LIDAR_TABLES)


class DetectorEntry(Protocol):
    """What makes the built-in detector of a name."""

    def __call__(self, name: str) -> Detector:
        """Load it. Raises MissingExtraError: a library that it needs is missing."""


class DetectorFileEntry(Protocol):
    """What makes a detector of a user's file."""

    def __call__(self, path: Path) -> Detector:
        """Read it. Raises InputError: the file cannot be used."""


def load_detector(name: str = "geometric", *, where: str = "detector") -> Detector:
    """Load a detector by name or file.

    Parameters
    ----------
    name : str
        One of ``DETECTOR_NAMES``; a ``.toml`` file with a table ``[response]`` as in
        ``data/detectors.toml``; or an ``.onnx`` file. One of ``LIDAR_NAMES`` behind a
        plus sign says what LiDARs find; alone, cameras go by the first of
        ``DETECTOR_NAMES``.
    where : str
        Names the option in messages.

    Raises
    ------
    InputError
        The name is unknown, or the file cannot be used.
    MissingExtraError
        "cnn" or an ONNX file without onnxruntime.
    """
    cameras, _, lidars = name.rpartition("+")
    if lidars in LIDAR_TABLES:
        found = load_detector(cameras or DETECTOR_NAMES[0], where=where)
        # Detectors of cameras are dataclasses, which the protocol does not say.
        named = cast(Any, found)
        table = load_entry(LIDAR_TABLES[lidars])(lidars)
        both: Detector = replace(named, name=f"{found.name}+{lidars}", lidar=table)
        return both
    if name in DETECTORS:
        by_name: DetectorEntry = load_entry(DETECTORS[name])
        return by_name(name)
    path = Path(name)
    if path.suffix in DETECTOR_FILES:
        of_file: DetectorFileEntry = load_entry(DETECTOR_FILES[path.suffix])
        return of_file(path)
    known = ", ".join((*DETECTOR_NAMES, *LIDAR_NAMES))
    raise InputError(
        where, name, f"{known}, a .toml file with a response table, or an .onnx file"
    )


def load_planning_detector(name: str = "geometric") -> PlanningDetector:
    """Built-in detector of any name but "cnn"."""
    return cast(PlanningDetector, load_detector(name))


def is_drawn(name: str) -> bool:
    """True if a detector finds people with a probability, not by a rule.

    Parameters
    ----------
    name : str
        As :func:`load_detector` takes it.

    Examples
    --------
    >>> is_drawn("response"), is_drawn("geometric+pointrcnn-2019"), is_drawn("cnn")
    (True, True, False)
    """
    last = name.rpartition("+")[2]
    if last in LIDAR_TABLES:
        return True
    place = DETECTORS.get(last) or DETECTOR_FILES.get(Path(last).suffix)
    return place in (_TABLE, _TABLE_FILE)
