"""Points from files of any kind, a piece at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, Unquoted
from .las_files import Points, open_las
from .pcd_files import pcd_points

if TYPE_CHECKING:
    from pyproj import CRS

SUFFIXES = (".las", ".laz", ".pcd")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointFile:
    """An open file with points.

    Attributes
    ----------
    crs : CRS, optional
        That of its header.
    chunks : iterator of ((n, 3) float, (n,) uint8)
        Coordinates, and classification as LAS has it (0: none).
    """

    crs: "CRS | None"
    chunks: Iterator[Points]


@contextmanager
def open_points(path: Path) -> Iterator[PointFile]:
    """Open a point cloud.

    Parameters
    ----------
    path : Path
        ``.las``, ``.laz`` or ``.pcd``.

    Raises
    ------
    InputError
        The file cannot be read, claims more than 50 million points or more than it has bytes for,
        or is damaged: also while its points are taken.
    """
    where = str(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(where, suffix, "one of " + ", ".join(SUFFIXES))
    try:
        if suffix == ".pcd":
            with path.open("rb") as file:
                yield PointFile(crs=None, chunks=pcd_points(file, where))
        else:
            with open_las(path) as (crs, chunks):
                yield PointFile(crs=crs, chunks=chunks)
    except OSError as error:
        raise InputError(where, Unquoted(error.strerror or error), "a readable file") from None
