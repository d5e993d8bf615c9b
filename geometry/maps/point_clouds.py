"""Point clouds (LAS, LAZ) as ground and as solids of voxels upon it.

Points are read a chunk at a time. The lowest ones give the ground; those
above it become voxels, and voxels that touch become one thing.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_fill_holes,
    distance_transform_edt,
    grey_closing,
    grey_opening,
)
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..archives import refuse_bomb
from ..arrays import BoolArray, FloatArray, IntArray
from ..errors import InputError, Unquoted, check_one_of, refuse
from ..notes import Note
from ..opening import open_file, reading
from ..scene import CLASS_NAMES
from .georeferences import Georeference, georeference
from .source_map import MAX_TRIANGLES, SourceMap, Thing, counted

if TYPE_CHECKING:
    from pyproj import CRS


SUFFIXES = (".las", ".laz")
MAX_POINTS = 50_000_000
CHUNK_POINTS = 1_000_000
# LASzip's types of items in a point: their bytes; 0: as many as there are.
_ITEM_BYTES = {0: 0, 6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29, 14: 0}
# Of the types that are packed in layers: how many; 0: one for every byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1, 14: 0}
# Coordinates (n, 3) and LAS classes (n,), 0: none.
Points = tuple[FloatArray, NDArray[np.uint8]]
CELL_M = 1.0
# 4 km x 4 km.
_MAX_CELLS = 16_000_000
# cells; buildings wider than the last are taken for hills.
_WINDOWS = (
    3,
    5,
    9,
    17,
    33,
    65,
    129,
)
_STEP_M = 0.5
# Higher and steeper than this is not ground.
_SLOPE = 0.1
VOXEL_M = 0.25
_MAX_VOXEL_M = 2.0
_MAX_VOXELS = 30_000_000
_MAX_THINGS = 20_000
# Cell of the origin, on every axis.
_MIDDLE = 1 << 19
# Lower points are ground: grass, kerbs, noise.
_GROUND_M = 0.3
# Lower things hide nobody.
_MIN_HEIGHT_M = 0.5
_MIN_VOXELS = 4
# Of 8 in a surface: with fewer, one hole in a hundred is not bridged.
_MIN_NEIGHBOURS = 6.0
_MIN_ROOF_M2 = 10.0
_MIN_FLAT_SHARE = 0.8
# Classes of LAS 1.4: the surface of a point. Others are of the class that the caller
# names.
_GROUND = (2,)
_VEGETATION = (3, 4, 5)
_BUILDING = (6,)
_LEFT_OUT = {
    7: "noise",
    9: "water",
    10: "rail",
    11: "road surface",
    13: "wire",
    14: "wire",
    15: "pylon",
    16: "wire",
    17: "bridge deck",
    18: "noise",
}
# Per axis in a key: 1,048,575 voxels, 262 km of 0.25 m.
_BITS = 20
_MASK = (1 << _BITS) - 1
MAX_VOXELS_PER_AXIS = _MASK - 1
# Of a thing: 10,000 m^2 of roof 30 m above ground, 0.25 m.
MAX_COLUMN_VOXELS = 20_000_000
# Of all things of a file.
MAX_WALL_VOXELS = 100_000_000
# Cells of a cluster's box that is searched for voids.
_MAX_DENSE = 30_000_000


@contextmanager
def open_points(path: Path) -> Iterator[tuple["CRS | None", Iterator[Points]]]:
    """Open a point cloud: yields its CRS, if any, and chunks of points.

    Parameters
    ----------
    path : Path
        A ``.las`` or ``.laz`` file.

    Yields
    ------
    crs : CRS or None
        As the file declares it.
    points : iterator of Points
        Coordinates and classes, a chunk at a time.

    Raises
    ------
    InputError
        The file cannot be read, claims more than 50 million points or more than
        it has bytes for, or is damaged (also while its points are read).
    """
    where = str(path)
    suffix = path.suffix.lower()
    check_one_of(where, suffix, SUFFIXES)
    with reading(path):
        _check_header(path)
        with _las_reader(path) as reader:
            crs = None
            # Whatever a damaged record makes laspy and pyproj raise.
            with suppress(Exception):
                crs = reader.header.parse_crs()
            yield crs, _chunks(reader, where)


# ---------- LAS and LAZ files, through laspy
def _las_reader(path: Path) -> Any:
    """Open a LAS or LAZ file with laspy; InputError: it is none."""
    where = str(path)
    try:
        # One thread: the parallel one of lazrs aborts the process where a chunk table
        # is damaged.
        reader = laspy.open(open_file(path), laz_backend=laspy.LazBackend.Lazrs)
    except OSError:
        raise
    except Exception as error:
        # Laspy raises whatever a damaged header makes it.
        raise InputError(where, Unquoted(_one_line(error)), "a LAS file") from None
    scales = np.array([reader.header.scales, reader.header.offsets], dtype=np.float64)
    if not np.isfinite(scales).all() or (scales[0] == 0.0).any():
        reader.close()
        raise InputError(
            f"{where}: header",
            scales.tolist(),
            "finite scales and offsets",
        )
    return reader


def _check_header(path: Path) -> None:
    """Raise InputError if a header claims more than the file can contain."""
    where = str(path)
    n_bytes = path.stat().st_size
    with open_file(path) as file:
        head = file.read(375)
        if len(head) < 227 or head[:4] != b"LASF":
            refuse(where, "something else", "a LAS file")
        header_bytes, first_point, n_records = struct.unpack_from("<HII", head, 94)
        point_format, point_bytes, n_points = struct.unpack_from("<BHI", head, 104)
        # Version 1.4.
        if head[25] >= 4 and len(head) >= 375:
            first_extended, n_extended, n_points_14 = struct.unpack_from(
                "<QIQ",
                head,
                235,
            )
            n_points = n_points_14 or n_points
            if n_extended and first_extended + 60 * n_extended > n_bytes:
                refuse(where, f"{n_extended:,} extended records", "as many as fit")
        if n_points > MAX_POINTS:
            refuse(
                where,
                f"{n_points:,} points",
                f"at most {MAX_POINTS:,}; thin it out first",
            )
        if not n_points:
            refuse(where, "no points", "points")
        is_inside = header_bytes <= first_point <= n_bytes
        if not is_inside or header_bytes + 54 * n_records > first_point:
            refuse(where, f"{n_records:,} records in its header", "as many as fit")
        claimed = first_point + n_points * point_bytes
        # Packed.
        if point_format & 0xC0:
            file.seek(header_bytes)
            n_layers = _n_layers(file, where, n_records, point_bytes)
            _check_chunks(file, where, first_point, point_bytes, n_layers)
        elif claimed > n_bytes:
            got = f"a header with {n_points:,} points in {n_bytes:,} bytes: cut off"
            refuse(where, got, f"{claimed:,} bytes")
    refuse_bomb(n_points * max(point_bytes, 20), where)


def _n_layers(file: BinaryIO, where: str, n_records: int, point_bytes: int) -> int:
    """Number of layers in which chunks of points are packed; 0: none.

    Parameters
    ----------
    file : BinaryIO
        Open file.
    where : str
        File and element at hand, for messages.
    n_records : int
        Records of the header, of which one describes the packing.
    point_bytes : int
        Bytes of an unpacked point.

    Returns
    -------
    n_layers : int
        Each layer has its size before the chunk.

    Raises
    ------
    InputError
        The points are packed in no known way.
    """
    for _ in range(n_records):
        head = file.read(54)
        if len(head) < 54:
            break
        owner, number, n_bytes = struct.unpack_from("<16sHH", head, 2)
        data = file.read(n_bytes)
        if (
            owner.rstrip(b"\0") != b"laszip encoded"
            or number != 22204
            or len(data) < 34
        ):
            continue
        n_items = struct.unpack_from("<H", data, 32)[0]
        items = [
            struct.unpack_from("<3H", data, at) for at in range(34, len(data) - 5, 6)
        ]
        sizes = [
            size for kind, size, _ in items if _ITEM_BYTES.get(kind, -1) in (0, size)
        ]
        if not 0 < n_items == len(items) == len(sizes) or sum(sizes) != point_bytes:
            refuse(where, "packed points of no known kind", "LASzip")
        if items[0][0] not in _LAYERS:
            return 0
        return sum(_LAYERS.get(kind, 0) or size for kind, size, _ in items)
    refuse(where, "packed points without a LASzip record", "a LAZ file")


def _check_chunks(
    file: BinaryIO,
    where: str,
    first_point: int,
    point_bytes: int,
    n_layers: int,
) -> None:
    """Refuse chunks of packed points that claim more bytes than there are.

    Parameters
    ----------
    file : BinaryIO
        Open file.
    where : str
        File and element at hand, for messages.
    first_point : int
        Byte at which the points begin.
    point_bytes : int
        Bytes of an unpacked point.
    n_layers : int
        See :func:`_n_layers`.
    """
    n_bytes = file.seek(0, 2)
    file.seek(first_point)
    head = file.read(8)
    at = 0
    if len(head) == 8:
        at = struct.unpack("<q", head)[0]
    # Of a file that was written as a stream: in its last eight bytes.
    if at == -1:
        file.seek(-8, 2)
        at = struct.unpack("<q", file.read(8))[0]
    if not first_point < at <= n_bytes - 8:
        refuse(where, "a table of chunks outside the file", "all of it")
    file.seek(at)
    _, n_chunks = struct.unpack("<2I", file.read(8))
    begin = first_point + 8
    while n_layers and begin < at:
        begin += point_bytes + 4
        file.seek(begin)
        sizes = file.read(4 * n_layers)
        begin += len(sizes) + sum(
            struct.unpack(f"<{len(sizes) // 4}I", sizes[: len(sizes) & ~3])
        )
    # A chunk's first point is not packed.
    if n_chunks * point_bytes > n_bytes or begin > at:
        refuse(where, f"{n_chunks:,} chunks of points that claim more bytes", f"{at:,}")


def _chunks(reader: Any, where: str) -> Iterator[Points]:
    """Points of an open LAS file, a chunk at a time."""
    try:
        # No more than the header has.
        for points in reader.chunk_iterator(CHUNK_POINTS):
            xyz = np.stack(
                [np.asarray(points[axis], dtype=np.float64) for axis in "xyz"],
                axis=1,
            )
            yield xyz, np.asarray(points.classification, dtype=np.uint8)
    except (InputError, MemoryError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    # Laspy raises anything, lazrs even others than Exception.
    except BaseException as error:
        raise InputError(
            where,
            Unquoted(_one_line(error)),
            "undamaged points",
        ) from None


def _one_line(error: BaseException) -> str:
    """Type and message of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:150]}"


# ---------- ground
class LowestPoints:
    """Lowest point of every square metre, collected a chunk at a time."""

    def __init__(self) -> None:
        self._cells: IntArray = np.empty((0, 2), dtype=np.int64)
        self._z_m: FloatArray = np.empty(0)

    def add(self, points_m: FloatArray) -> None:
        """Add points, (n, 3), in metres."""
        if not len(points_m):
            return
        cells = np.concatenate(
            [self._cells, np.floor(points_m[:, :2] / CELL_M).astype(np.int64)]
        )
        z_m = np.concatenate([self._z_m, points_m[:, 2]])
        # Sorted by cell and then by height, the first point of each cell is the lowest.
        order = np.lexsort((z_m, cells[:, 1], cells[:, 0]))
        cells = cells[order]
        z_m = z_m[order]
        is_first = np.ones(len(cells), dtype=np.bool_)
        is_first[1:] = (cells[1:] != cells[:-1]).any(axis=1)
        self._cells = cells[is_first]
        self._z_m = z_m[is_first]

    def __len__(self) -> int:
        return len(self._z_m)

    def grid(self, where: str) -> tuple[IntArray, FloatArray]:
        """Grid of the lowest points.

        Parameters
        ----------
        where : str
            File and element at hand, for messages.

        Returns
        -------
        first : (2,) int
            Indices of the first cell.
        heights_m : (n, m) float
            Lowest point of each cell; NaN: none. [m]

        Raises
        ------
        InputError
            The points cover too large an area.
        """
        low = self._cells.min(axis=0)
        shape = self._cells.max(axis=0) - low + 1
        if np.prod(shape.astype(np.float64)) > _MAX_CELLS:
            size = " x ".join(f"{length * CELL_M / 1000.0:.1f} km" for length in shape)
            refuse(where, f"points over {size}", "at most 16 km2; cut them out first")
        heights = np.full(tuple(shape), np.nan)
        heights[tuple((self._cells - low).T)] = self._z_m
        return low, heights


def fill_gaps(heights_m: FloatArray) -> FloatArray:
    """Heights with gaps filled from the nearest cell that has one.

    Parameters
    ----------
    heights_m : (n, m) float
        NaN: none. [m]

    Returns
    -------
    filled_m : (n, m) float
        Without gaps, unless there is no height at all. [m]
    """
    if not np.isnan(heights_m).any():
        return heights_m
    _, nearest = distance_transform_edt(np.isnan(heights_m), return_indices=True)
    return np.asarray(heights_m[tuple(nearest)])


def filter_ground(heights_m: FloatArray) -> FloatArray:
    """Ground under the lowest points of cells.

    A surface is opened with growing windows. A cell that an opening lowers by
    more than the ground could rise within half the window carries something,
    and gets the height of the nearest ground. Part of a house that is lower
    than the ground behind it is taken for ground.

    Parameters
    ----------
    heights_m : (n, m) float
        Lowest point of each cell; NaN: none. [m]

    Returns
    -------
    ground_m : (n, m) float
        Without gaps. [m]

    References
    ----------
    .. [1] K. Zhang et al., "A progressive morphological filter for removing nonground
       measurements
       from airborne lidar data", 2003.
    """
    surface = fill_gaps(heights_m)
    if min(surface.shape) >= 5:
        # Single points below the ground.
        closed = grey_closing(surface, size=(3, 3))
        surface = np.where(closed - surface > 2.0 * _STEP_M, closed, surface)
    is_ground = np.ones(surface.shape, dtype=np.bool_)
    opened = surface
    last = 1
    for window in _WINDOWS:
        if last >= max(surface.shape):
            break
        lower = grey_opening(opened, size=(window, window), mode="nearest")
        is_ground &= opened - lower <= _STEP_M + 0.5 * _SLOPE * (window - last) * CELL_M
        opened = lower
        last = window
    if not is_ground.any():
        return opened
    return fill_gaps(np.where(is_ground, surface, np.nan))


# ---------- things
def read_point_cloud(path: Path, *, class_name: str = "building") -> SourceMap:
    """Read a point cloud as things that hide what is behind them.

    Ground is removed: class 2, or else by a filter. The other points become
    voxels of 0.25 m, doubled up to 2 m until those of a thin scan touch; voxels
    that touch become one thing. A voxel hides exactly where there is a point,
    while a fitted surface closes gateways or stays open where a scan is thin.
    Gaps of one voxel are bridged, enclosed voids filled, and roofs seen only
    from the air filled to the ground. PCD is in metres, z up.

    Parameters
    ----------
    path : Path
        A ``.las`` or ``.laz`` file.
    class_name : str
        Class of points that do not have one in the file.

    Returns
    -------
    source : SourceMap
        Things, and points of the ground.

    Raises
    ------
    InputError
        The file is damaged or too large, or only ground is left.
    """
    where = str(path)
    check_one_of("class_name", class_name, CLASS_NAMES)
    # Collect voxels and lowest points a chunk at a time.
    scan = _Scan(where=where)
    with open_points(path) as (crs, chunks):
        for points, classes in chunks:
            if not np.isfinite(points).all():
                refuse(where, "a coordinate that is not finite", "numbers")
            if not len(points):
                continue
            if scan.place is None:
                corners = np.array(
                    [points[:, :2].min(axis=0), points[:, :2].max(axis=0)]
                )
                scan.place = georeference(corners, crs, where=where)
            scan.add(scan.place.to_metres(points, where), classes, class_name)
    if scan.place is None:
        refuse(where, "no points", "points")
    heights, voxel_m, notes = _above_ground(scan)
    things, small = _things(heights, voxel_m, scan, class_name)
    if not things and not len(scan.lowest_ground):
        refuse(where, "only ground", "points on something above the ground")
    notes += counted(scan.left_out, "points of a class that hides nothing here")
    if small:
        why = f"less than {_MIN_VOXELS} voxels, or below {_MIN_HEIGHT_M} m"
        notes.append(Note(f"{small} clusters of points", why))
    return SourceMap(
        name=path.name,
        crs=scan.place.crs,
        source_crs=scan.place.source_crs,
        things=tuple(things),
        ground_m=scan.ground_m(),
        skipped=(*scan.place.notes, *notes),
    )


@dataclass(slots=True, kw_only=True)
class _Scan:
    """Voxels and lowest points of a scan, collected a chunk at a time.

    Attributes
    ----------
    where : str
        File, for messages.
    place : Georeference or None
        Where the scan lies on earth; None: no point was read.
    origin_m : (3,) float or None
        Corner near the first points, from which voxels are counted. [m]
    keys : dict[str, IntArray]
        Sorted voxels, by kind.
    lowest : LowestPoints
        Lowest points of all classes.
    lowest_ground : LowestPoints
        Lowest points of class 2.
    left_out : Counter[str]
        Numbers of points of classes that hide nothing.
    """

    where: str
    place: Georeference | None = None
    origin_m: FloatArray | None = None
    keys: dict[str, IntArray] = field(default_factory=dict)
    lowest: LowestPoints = field(default_factory=LowestPoints)
    lowest_ground: LowestPoints = field(default_factory=LowestPoints)
    left_out: Counter[str] = field(default_factory=Counter)

    def ground_m(self) -> FloatArray:
        """Lowest point of class 2 in every square metre, at its middle, (n, 3)."""
        if not len(self.lowest_ground):
            return np.empty((0, 3))
        first, height_m = self.lowest_ground.grid(self.where)
        cells = np.argwhere(~np.isnan(height_m))
        east_north_m = (cells + first + 0.5) * CELL_M
        assert self.origin_m is not None
        return self.origin_m + np.column_stack([east_north_m, height_m[tuple(cells.T)]])

    def add(
        self,
        points_m: FloatArray,
        classes: NDArray[np.uint8],
        class_name: str,
    ) -> None:
        """Add a chunk of points.

        Parameters
        ----------
        points_m : (n, 3) float
            In metres, in the map's coordinates. [m]
        classes : (n,) int
            LAS classes; 0: none.
        class_name : str
            Class of things that do not state theirs.
        """
        for number, name in _LEFT_OUT.items():
            if n_points := int((classes == number).sum()):
                self.left_out[name] += n_points
        is_taken = ~np.isin(classes, list(_LEFT_OUT))
        points_m = points_m[is_taken]
        classes = classes[is_taken]
        if not len(points_m):
            return
        if self.origin_m is None:
            self.origin_m = np.floor(points_m.min(axis=0))
        local = points_m - self.origin_m
        if (np.abs(local) > MAX_VOXELS_PER_AXIS // 2 * VOXEL_M).any():
            refuse(self.where, f"points {np.abs(local).max():.3g} m apart", "one place")
        self.lowest.add(local)
        self.lowest_ground.add(local[np.isin(classes, _GROUND)])
        keys = to_keys(np.floor(local / VOXEL_M).astype(np.int64) + _MIDDLE)
        kinds = {
            "vegetation": np.isin(classes, _VEGETATION),
            "roofs": np.isin(classes, _BUILDING),
            class_name: ~np.isin(classes, (*_VEGETATION, *_BUILDING, *_GROUND)),
        }
        for kind, is_kind in kinds.items():
            before = self.keys.get(kind, np.empty(0, dtype=np.int64))
            self.keys[kind] = np.unique(np.concatenate([before, keys[is_kind]]))
        if sum(len(known) for known in self.keys.values()) > _MAX_VOXELS:
            got = f"more than {_MAX_VOXELS:,} voxels of {VOXEL_M} m"
            refuse(self.where, got, "a larger voxel, or fewer points")


def _above_ground(scan: _Scan) -> tuple[dict[str, IntArray], float, list[Note]]:
    """Voxels above the ground by kind, as coarse as the scan asks for.

    Parameters
    ----------
    scan : _Scan
        The scan.

    Returns
    -------
    heights : dict of str to (n,) int
        Voxels with z counted from the ground.
    voxel_m : float
        Their edge. [m]
    notes : list of Note
        Detail that was lost.
    """
    # The ground: points of its class, or else a filter of the lowest ones.
    low, lowest_m = scan.lowest.grid(scan.where)
    if len(scan.lowest_ground):
        ground_m = np.full(lowest_m.shape, np.nan)
        first, known = scan.lowest_ground.grid(scan.where)
        at = first - low
        ground_m[at[0] : at[0] + known.shape[0], at[1] : at[1] + known.shape[1]] = known
        ground_m = fill_gaps(ground_m)
    else:
        ground_m = filter_ground(lowest_m)
    heights: dict[str, IntArray] = {}
    for kind, keys in scan.keys.items():
        kept = to_cells(keys)
        middles_m = (kept - _MIDDLE + 0.5) * VOXEL_M
        cells = np.floor(middles_m[:, :2] / CELL_M).astype(np.int64) - low
        cells = np.clip(cells, 0, np.array(ground_m.shape) - 1)
        above_m = middles_m[:, 2] - ground_m[cells[:, 0], cells[:, 1]]
        kept[:, 2] = np.floor(above_m / VOXEL_M).astype(np.int64) + _MIDDLE
        heights[kind] = np.unique(to_keys(kept[above_m > _GROUND_M]))
    # Solid things decide on the voxel, vegetation only where there is nothing else.
    solid = [
        keys for kind, keys in heights.items() if kind != "vegetation" and len(keys)
    ]
    everything = np.unique(np.concatenate(solid or list(heights.values())))
    voxel_m = VOXEL_M
    # Double the edge until the voxels of a surface touch each other.
    most_m = 0.0
    if len(everything):
        most_m = 0.5 * _MAX_VOXEL_M
    while voxel_m <= most_m and mean_neighbours(everything) < _MIN_NEIGHBOURS:
        voxel_m *= 2.0
        heights = {kind: _coarser(keys) for kind, keys in heights.items()}
        everything = _coarser(everything)
    if voxel_m == VOXEL_M:
        return heights, voxel_m, []
    why = f"points too far apart for voxels of {VOXEL_M:g} m"
    return heights, voxel_m, [Note(f"detail below {voxel_m:g} m", why)]


def _coarser(keys: IntArray) -> IntArray:
    """Voxels of twice the edge that cover the given ones, sorted."""
    return np.unique(to_keys((to_cells(keys) - _MIDDLE) // 2 + _MIDDLE))


def _things(
    heights: dict[str, IntArray],
    voxel_m: float,
    scan: _Scan,
    class_name: str,
) -> tuple[list[Thing], int]:
    """One thing per cluster, and the number of clusters that are too small.

    Parameters
    ----------
    heights : dict[str, IntArray]
        Voxels by kind, with z counted from the ground.
    voxel_m : float
        Edge of a voxel. [m]
    scan : _Scan
        The scan.
    class_name : str
        Class of things that do not state theirs.

    Returns
    -------
    things : list of Thing
        Roofs seen from the air are filled to the ground.
    n_small : int
        Clusters that were left out.

    Raises
    ------
    InputError
        There are too many things or triangles.
    """
    # Clusters of each kind that are large enough.
    found: list[tuple[str, IntArray]] = []
    small = 0
    for kind, keys in heights.items():
        if not len(keys):
            continue
        if kind != "vegetation":
            keys = bridged(keys)
        keys = _stood(keys, voxel_m)
        labels = clusters(keys)
        order = np.argsort(labels, kind="stable")
        for part in np.split(keys[order], np.cumsum(np.bincount(labels))[:-1]):
            top_m = (int((part & _MASK).max()) - _MIDDLE + 1) * voxel_m
            if len(part) < _MIN_VOXELS or top_m < _MIN_HEIGHT_M:
                small += 1
            else:
                found.append((kind, part))
    if len(found) > _MAX_THINGS:
        refuse(
            scan.where,
            f"{len(found):,} things",
            f"at most {_MAX_THINGS:,}; cut it out",
        )
    # The surface of each cluster.
    things: list[Thing] = []
    names: Counter[str] = Counter()
    assert scan.origin_m is not None
    origin_m = np.append(scan.origin_m[:2], 0.0) - _MIDDLE * voxel_m
    n_left = MAX_TRIANGLES
    n_walls = MAX_WALL_VOXELS
    where = scan.where
    for kind, part in found:
        name = kind
        if kind == "roofs":
            name = "building"
        if kind == "roofs" or (
            name == class_name == "building" and _is_roof(part, voxel_m)
        ):
            part = columns_to(part, _MIDDLE, where, n_left=n_walls)
            n_walls -= len(part)
        if kind != "vegetation":
            part = filled(part, _MIDDLE)
        names[name] += 1
        mesh = faces(
            part,
            origin_m=origin_m,
            voxel_m=voxel_m,
            max_triangles=n_left,
            where=where,
        )
        n_left -= len(mesh[1])
        things.append(Thing.of(f"{name} {names[name]}", name, mesh))
    return things, small


def _stood(keys: IntArray, voxel_m: float) -> IntArray:
    """Voxels, and those below them that were taken for ground.

    Columns that begin just above the ground are continued down to it.

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.
    voxel_m : float
        Edge of a voxel. [m]

    Returns
    -------
    keys : (m,) int
        Sorted.
    """
    cells = to_cells(keys)
    columns, start = np.unique(cells[:, :2], axis=0, return_index=True)
    lowest = np.minimum.reduceat(cells[:, 2], start)
    stands = (lowest - _MIDDLE) * voxel_m <= _GROUND_M + voxel_m
    added = [keys]
    for z in range(_MIDDLE, _MIDDLE + int(_GROUND_M / voxel_m) + 2):
        below = columns[stands & (lowest > z)]
        added.append(to_keys(np.column_stack([below, np.full(len(below), z)])))
    return np.unique(np.concatenate(added))


def _is_roof(keys: IntArray, voxel_m: float) -> bool:
    """True for an even patch with nothing below: a roof seen from the air."""
    cells = to_cells(keys)
    columns, start = np.unique(cells[:, :2], axis=0, return_index=True)
    if len(columns) * voxel_m**2 < _MIN_ROOF_M2:
        return False
    top = np.maximum.reduceat(cells[:, 2], start) - _MIDDLE
    hangs = (np.minimum.reduceat(cells[:, 2], start) - _MIDDLE) > 0.5 * top
    is_next = (np.diff(columns[:, 0]) == 0) & (np.diff(columns[:, 1]) == 1)
    is_even = np.abs(np.diff(top)[is_next]) <= 1
    is_flat = len(is_even) > 0 and is_even.mean() > _MIN_FLAT_SHARE
    return bool(hangs.mean() > _MIN_FLAT_SHARE and is_flat)


# ---------- voxels: cubes where there are points
# Differences of keys.
_HALF_OF_NEIGHBOURS = tuple(
    (x << 2 * _BITS) + (y << _BITS) + z
    for x, y, z in product((-1, 0, 1), repeat=3)
    if (x, y, z) > (0, 0, 0)
)


def to_keys(cells: IntArray) -> IntArray:
    """One integer for each cell, in the order of x, y and z.

    Parameters
    ----------
    cells : (n, 3) int
        Indices from 1 to ``MAX_VOXELS_PER_AXIS``.

    Returns
    -------
    keys : (n,) int
        20 bits for each axis.
    """
    return (cells[:, 0] << 2 * _BITS) | (cells[:, 1] << _BITS) | cells[:, 2]


def to_cells(keys: IntArray) -> IntArray:
    """Inverse of :func:`to_keys`."""
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & _MASK, keys & _MASK], axis=1)


def is_in(keys: IntArray, sorted_keys: IntArray) -> BoolArray:
    """True for keys that are among sorted ones, (n,)."""
    if not len(sorted_keys):
        return np.zeros(len(keys), dtype=np.bool_)
    places = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
    return np.asarray(sorted_keys[places] == keys)


def clusters(keys: IntArray) -> IntArray:
    """Cluster of every voxel: voxels that touch are one.

    They touch at a face, an edge or a corner.

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.

    Returns
    -------
    labels : (n,) int
        Numbered in the order of the clusters' first voxels.
    """
    n = len(keys)
    pairs = []
    for step in _HALF_OF_NEIGHBOURS:
        moved = keys + step
        here = np.flatnonzero(is_in(moved, keys))
        pairs.append(np.stack([here, np.searchsorted(keys, moved[here])]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array(
        (np.ones(len(first), dtype=np.bool_), (first, second)),
        shape=(n, n),
    )
    _, labels = connected_components(graph, directed=False)
    return np.asarray(labels, dtype=np.int64)


def bridged(keys: IntArray) -> IntArray:
    """Voxels, and those between two that lie opposite each other, sorted."""
    between = [keys]
    for step in _HALF_OF_NEIGHBOURS:
        between.append(keys[is_in(keys + 2 * step, keys)] + step)
    return np.unique(np.concatenate(between))


def mean_neighbours(keys: IntArray) -> float:
    """Mean number of a voxel's 26 neighbours that exist."""
    n_pairs = sum(int(is_in(keys + step, keys).sum()) for step in _HALF_OF_NEIGHBOURS)
    return 2.0 * n_pairs / max(1, len(keys))


def filled(keys: IntArray, floor: int) -> IntArray:
    """Voxels of one cluster, and the voids that they enclose, sorted.

    The ground closes clusters that stand on it. A cluster whose box is too
    large stays as it is.

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.
    floor : int
        Lowest z above ground.

    Returns
    -------
    keys : (m,) int
        Sorted.
    """
    cells = to_cells(keys)
    low = cells.min(axis=0)
    low[2] = min(low[2], floor)
    shape = cells.max(axis=0) - low + 1
    if np.prod(shape.astype(np.float64)) > _MAX_DENSE:
        return keys
    stands = bool((cells[:, 2] <= floor + 1).any())
    dense = np.zeros(tuple(shape + [0, 0, 1]), dtype=np.bool_)
    dense[tuple((cells - low + [0, 0, 1]).T)] = True
    # The ground closes clusters that stand on it.
    dense[:, :, 0] = stands
    dense = binary_fill_holes(dense)[:, :, 1:]
    return np.sort(to_keys(np.argwhere(dense).astype(np.int64) + low))


def columns_to(
    keys: IntArray,
    floor: int,
    where: str,
    *,
    n_left: int = MAX_WALL_VOXELS,
) -> IntArray:
    """Voxels from the floor to the highest of every column, sorted.

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.
    floor : int
        Lowest z above ground.
    where : str
        File and element at hand, for messages.
    n_left : int
        Voxels that the file's other buildings leave.

    Returns
    -------
    keys : (m,) int
        Sorted.

    Raises
    ------
    InputError
        They are more than any building has, or than all buildings of a file may
        have: heights in another unit, or damaged.
    """
    # Height of each column.
    columns, start = np.unique(keys >> _BITS, return_index=True)
    counts = np.maximum(np.maximum.reduceat(keys & _MASK, start) - floor + 1, 0)
    total = int(counts.sum())
    for n_voxels, most, whose in (
        (total, MAX_COLUMN_VOXELS, "a thing"),
        (MAX_WALL_VOXELS - n_left + total, MAX_WALL_VOXELS, "a file"),
    ):
        if n_voxels > most:
            refuse(
                where,
                f"walls of {n_voxels:,} voxels",
                f"at most {most:,} of {whose}",
            )
    # Ascending, for columns are: one array, and no sorting.
    walls = np.repeat((columns << _BITS) + floor - (np.cumsum(counts) - counts), counts)
    walls += np.arange(total)
    below = keys[(keys & _MASK) < floor]
    if len(below):
        return np.sort(np.concatenate([below, walls]))
    return walls


def faces(
    keys: IntArray,
    *,
    origin_m: FloatArray,
    voxel_m: float,
    max_triangles: int,
    where: str,
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Surface of voxels: rectangles as large as possible.

    Each rectangle is two triangles. The surface is closed, though a rectangle's
    edge may meet several smaller ones.

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.
    origin_m : (3,) float
        Lower corner of cell (0, 0, 0). [m]
    voxel_m : float
        Edge of a voxel. [m]
    max_triangles : int
        Largest number of triangles.
    where : str
        File and element at hand, for messages.

    Returns
    -------
    vertices_m : (k, 3) float
        Without repetitions. [m]
    triangles : (m, 3) int32
        Counter-clockwise seen from outside.

    Raises
    ------
    InputError
        There are more than `max_triangles`.
    """
    # Rectangles of all six directions share their corners.
    quads = np.concatenate(
        [_rectangles(keys, axis, sign) for axis in range(3) for sign in (-1, 1)]
    )
    if 2 * len(quads) > max_triangles:
        refuse(
            where,
            f"{2 * len(quads):,} triangles",
            "a larger voxel, or fewer points",
        )
    unique, inverse = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    index = inverse.reshape(-1, 4)
    triangles = np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]]).astype(
        np.int32
    )
    return origin_m + voxel_m * unique, triangles


def _rectangles(keys: IntArray, axis: int, sign: int) -> IntArray:
    """Corners of the rectangles that face along an axis, (n, 4, 3).

    Parameters
    ----------
    keys : (n,) int
        Voxels, one integer each, sorted and unique.
    axis : int
        0, 1 or 2: x, y or z.
    sign : int
        1 or -1: along the axis or against it.

    Returns
    -------
    corners : (n, 4, 3) int
        Indices of cells, counter-clockwise seen from outside.
    """
    # To the neighbour's key.
    step = sign << (2 - axis) * _BITS
    cells = to_cells(keys[~is_in(keys + step, keys)])
    u, v = [other for other in range(3) if other != axis]
    slab = cells[:, axis]
    a = cells[:, u]
    b = cells[:, v]
    # Runs of faces that follow one another along v, then of equal runs along u.
    (slab, a, b_low), b_last = _runs((slab, a, b))
    (slab, b_low, b_last, a_low), a_last = _runs((slab, b_low, b_last, a))
    a_high = a_last + 1
    b_high = b_last + 1
    plane = slab + (sign > 0)
    quads = np.empty((len(slab), 4, 3), dtype=np.int64)
    quads[:, :, axis] = plane[:, None]
    quads[:, :, u] = np.stack([a_low, a_high, a_high, a_low], axis=1)
    quads[:, :, v] = np.stack([b_low, b_low, b_high, b_high], axis=1)
    # u, v, axis are right-handed for x and z as axes, left-handed for y.
    if (sign > 0) != (axis != 1):
        quads = quads[:, ::-1]
    return quads


def _runs(columns: tuple[IntArray, ...]) -> tuple[tuple[IntArray, ...], IntArray]:
    """Runs of rows whose last column counts on while the others stay.

    Parameters
    ----------
    columns : tuple of (n,) int
        Columns of a table.

    Returns
    -------
    first : tuple of (m,) int
        First row of each run.
    last : (m,) int
        Last value of the last column in each run.
    """
    order = np.lexsort(columns[::-1])
    columns = tuple(column[order] for column in columns)
    goes_on = np.diff(columns[-1]) == 1
    for column in columns[:-1]:
        goes_on &= np.diff(column) == 0
    start = np.flatnonzero(np.append(True, ~goes_on)[: len(order)])
    last = np.append(start[1:], len(order))[: len(start)] - 1
    return tuple(column[start] for column in columns), columns[-1][last]
