"""Ground around a junction: heights of maps or of a GeoTIFF raster."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import FloatArray
from ..errors import InputError, MissingExtraError, refuse
from ..frames import transform
from ..notes import Note
from ..opening import open_file, reading
from ..terrain import GRID_DECIMALS, Terrain
from .georeferences import LocalFrame
from .source_map import MapJunction, SourceMap, Thing

# Of the grid.
_STEP_M = 2.0
# Ground that is nowhere higher or lower than this is a plane.
_FLAT_M = 0.1
# Points farther outside have no say.
_BEYOND_M = 50.0
_SAME_LEVEL_M = 2.0
# More than this above the arms' roads is a bridge.
_STEEPEST = 0.08
# A map whose things are this far off counts heights from another zero.
_OTHER_ZERO_M = 3.0
# At most: what is higher above the ground is meant to be there.
_FLOATS_M = 3.0
# The global models; coarser ones know no street.
_COARSEST_M = 30.0
# There must be a height this near to the junction.
_MIDDLE_M = 60.0
_LIMITS_M = (-500.0, 9000.0)
# Around a junction: of 16 cm, 320 m by 320 m.
_MAX_PIXELS = 4_000_000
# GDAL unpacks blocks as a whole, and a mask line by line or whole.
_MAX_BLOCK_BYTES = 100_000_000
_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# GDAL would look at files of any of its formats next to the raster, such as a mask.
_ALONE = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", "GDAL_PAM_ENABLED": "NO"}
_EXPECTED = "a GeoTIFF of heights"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief:
    """Ground around a junction: its middle is at z = 0.

    Attributes
    ----------
    terrain : Terrain or None
        The ground; None: the plane z = 0.
    zero_m : float
        Height of the junction's middle as `source` counts heights. [m]
    roads : SourceMap or None
        Map with the roads; None: the ground is a plane.
    roads_m : Terrain or None
        Ground of the map with the roads, as that counts heights, where another
        source has them. [m]
    notes : tuple of Note
        What was made of the heights.
    """

    terrain: Terrain | None = None
    zero_m: float = 0.0
    roads: SourceMap | None = None
    roads_m: Terrain | None = None
    notes: tuple[Note, ...] = ()

    def at(self, points_m: FloatArray) -> FloatArray:
        """Height of the ground at points (n, 2), in metres."""
        if self.terrain is None:
            return np.zeros(len(points_m))
        return self.terrain.at(points_m)

    def above_m(self, vertices_m: FloatArray) -> FloatArray:
        """Height of vertices (n, 3) above the ground below them, in metres."""
        return vertices_m[:, 2] - self.at(vertices_m[:, :2])

    def lower(
        self,
        source: SourceMap,
        things: Sequence[Thing],
        given_m: float | None,
    ) -> Iterator[tuple[FloatArray, bool]]:
        """Vertices of a map's things with heights from z = 0.

        Where a map counts heights above the ground, walls follow it, and other
        things stand on the lowest ground below them.

        Parameters
        ----------
        source : SourceMap
            The map.
        things : sequence of Thing
            Things of the map.
        given_m : float or None
            Height in the map of the road in the junction's middle; None: not given.
            [m]

        Yields
        ------
        vertices_m : (n, 3) float
            Vertices of each thing, in order. [m]
        is_set_down : bool
            It would have floated above the ground.
        """
        if source.heights == "above ground" and given_m is None:
            for thing in things:
                ground = self.at(thing.vertices_m[:, :2])
                if thing.class_name == "wall":
                    yield _lifted(thing, ground), False
                else:
                    yield _lifted(thing, ground.min()), False
            return
        # Absolute heights: count them from the junction's middle.
        zero_m = self._zero_m(source, things, given_m)
        may_float = given_m is None or self.terrain is not None
        for thing in things:
            vertices = _lifted(thing, -zero_m)
            # The map's own ground is replaced by that of the other source.
            if source is self.roads and self.roads_m is not None:
                middle = vertices[:, :2].mean(axis=0, keepdims=True)
                own_m = self.roads_m.at(middle) - self.roads_m.at(np.zeros(2))
                vertices[:, 2] += self.at(middle) - own_m
            gap_m = float(vertices[:, 2].min() - self.at(vertices[:, :2]).min())
            floats = (
                may_float
                and thing.class_name == "building"
                and _FLAT_M < gap_m <= _FLOATS_M
            )
            down_m = 0.0
            if floats:
                down_m = gap_m
            yield vertices - [0.0, 0.0, down_m], floats

    def _zero_m(
        self,
        source: SourceMap,
        things: Sequence[Thing],
        given_m: float | None,
    ) -> float:
        """Height in a map that becomes z = 0, in metres."""
        if source is self.roads and source.heights == "absolute":
            if self.roads_m is None:
                return self.zero_m
            return float(self.roads_m.at(np.zeros(2)))
        if given_m is not None or not things:
            return given_m or 0.0
        if self.terrain is None:
            return min(float(thing.vertices_m[:, 2].min()) for thing in things)
        # Feet of things above the ground, were heights counted as those of the ground.
        vertices = [thing.vertices_m for thing in things]
        feet_m = [one[:, 2].min() - self.at(one[:, :2]).min() for one in vertices]
        off_m = float(np.median(feet_m) - self.zero_m)
        if abs(off_m) > _OTHER_ZERO_M:
            return self.zero_m + off_m
        return self.zero_m


def _lifted(thing: Thing, up_m: FloatArray | float) -> FloatArray:
    """Vertices of a thing, (n, 3), raised by some metres."""
    heights_m = thing.vertices_m[:, 2] + up_m
    return np.column_stack([thing.vertices_m[:, :2], heights_m])


def find_relief(
    maps: Sequence[SourceMap],
    junction: MapJunction,
    frame: LocalFrame,
    *,
    half_m: float,
) -> Relief:
    """Ground within a square around a junction of the first map.

    Heights are those of the first of the other maps that has some near the
    junction, or of the roads. Roads on bridges, more than 2 m and 8 % off those
    of its arms, have no say.

    Parameters
    ----------
    maps : sequence of SourceMap
        Maps, the one with the roads first.
    junction : MapJunction
        A junction of the first map.
    frame : LocalFrame
        Frame of the scene.
    half_m : float
        Half the edge of the square around the junction. [m]

    Returns
    -------
    relief : Relief
        A plane where nothing tells heights, or all are alike.
    """
    roads = maps[0]
    # Heights of the roads, and those of every other map.
    own = _near(frame.take(roads.ground_m, roads), half_m)
    if roads.heights == "absolute":
        own = _on_level(own, roads, junction, frame)
    found = [
        (other.name, _near(frame.take(other.ground_m, other), half_m))
        for other in maps[1:]
    ]
    found.append((roads.name, own))
    name, points = next((one for one in found if len(one[1])), ("", own))
    if not name:
        return Relief()
    # Count heights from the middle of the junction.
    ground = fit_terrain(points, half_m=half_m, step_m=_STEP_M)
    middle_m = float(ground.at(np.zeros(2)))
    terrain = replace(ground, height_m=ground.height_m - middle_m)
    span_m = float(np.ptp(terrain.height_m))
    if np.abs(terrain.height_m).max() <= _FLAT_M:
        return Relief()
    # Things of the map with the roads count from its own ground.
    is_other = points is not own and roads.heights == "absolute" and len(own) > 0
    roads_m = None
    if is_other:
        roads_m = fit_terrain(own, half_m=half_m, step_m=_STEP_M)
    low_m = terrain.height_m.min()
    high_m = terrain.height_m.max()
    range_m = f"from {low_m:.1f} m to {high_m:.1f} m"
    why = f"ground {range_m} around the junction ({span_m:.1f} m)"
    return Relief(
        terrain=terrain,
        zero_m=middle_m,
        roads=roads,
        roads_m=roads_m,
        notes=(Note(f"heights of {name}", why),),
    )


def _near(points_m: FloatArray, half_m: float) -> FloatArray:
    """Points within a square, and 50 m around it."""
    is_near = (np.abs(points_m[:, :2]) <= half_m + _BEYOND_M).all(axis=1)
    return points_m[is_near]


def _on_level(
    points_m: FloatArray,
    roads: SourceMap,
    junction: MapJunction,
    frame: LocalFrame,
) -> FloatArray:
    """Points that lie about as high as the nearest road to the junction."""
    own = [
        one
        for one in roads.lanes
        if junction.id in (one.from_junction, one.to_junction)
    ]
    arms = [lane.centreline_m for lane in own]
    middle = np.append(junction.position_m, junction.height_m)
    # Points of the roads that lead to the junction.
    level = frame.take(np.concatenate([middle[None], *arms]), roads)
    away_m, nearest = cKDTree(level[:, :2]).query(points_m[:, :2])
    most_m = _SAME_LEVEL_M + _STEEPEST * away_m
    off_m = np.abs(points_m[:, 2] - level[nearest, 2])
    return np.asarray(points_m[off_m <= most_m])


# ---------- heights of the ground from GeoTIFF rasters
def read_elevation(
    path: Path,
    *,
    crs: str,
    middle_m: FloatArray,
    half_m: float,
) -> SourceMap:
    """Read the heights around a place from a raster.

    Parameters
    ----------
    path : Path
        One band of heights in metres, with a coordinate reference system.
    crs : str
        Of `middle_m` and of what is returned; projected, in metres.
    middle_m : (2,) float
        The place. [m]
    half_m : float
        Half the edge of the square around it that is read. [m]

    Returns
    -------
    elevation : Elevation
        Middles of the pixels that have a height.

    Raises
    ------
    InputError
        The raster cannot be read, has no reference system or several bands, lies
        elsewhere, is too coarse, or has no height near the place.
    MissingExtraError
        rasterio is not installed.
    """
    try:
        import rasterio
        from pyproj.exceptions import ProjError
    except ImportError:
        raise MissingExtraError(
            "reading rasters of heights needs rasterio: pip install place-rsus[terrain]"
            " (in a checkout: uv run --extra terrain place-rsus ..)"
        ) from None
    with open_file(path) as file:
        # GDAL goes by content: a text may name an address.
        if not file.read(4).startswith(_MAGIC):
            refuse(str(path), "something else", _EXPECTED)
    if not crs:
        expected = (
            "a map that says where on earth it lies: `crs` says it for one that"
            " does not"
        )
        raise InputError("terrain", str(path), expected)
    with (
        reading(path, _EXPECTED, rasterio.errors.RasterioError, ProjError),
        rasterio.Env(**_ALONE),
        rasterio.open(path, driver="GTiff") as raster,
    ):
        points = _read(raster, str(path), crs, middle_m, half_m)
    return SourceMap(name=path.name, crs=crs, source_crs=crs, ground_m=points)


def _read(
    raster: Any,
    where: str,
    crs: str,
    middle_m: FloatArray,
    half_m: float,
) -> FloatArray:
    """Points of an open raster within a square, (n, 3).

    Parameters
    ----------
    raster : Any
        Data set of rasterio.
    where : str
        File and element at hand, for messages.
    crs : str
        Reference system of the result.
    middle_m : (2,) float
        Middle of the square. [m]
    half_m : float
        Half the edge of the square around the junction. [m]

    Returns
    -------
    points_m : (n, 3) float
        Middles of the pixels that have a height. [m]

    Raises
    ------
    InputError
        See :func:`read_elevation`.
    """
    if raster.count != 1:
        refuse(where, f"{raster.count} bands", "one band, of heights in metres")
    if raster.crs is None:
        refuse(where, "no coordinate reference system", "a raster with one")
    own_crs = raster.crs.to_wkt()
    grid = raster.transform
    if not np.linalg.det([[grid.a, grid.b], [grid.d, grid.e]]):
        refuse(where, "pixels without area", "a raster that lies on the map")
    # Find the pixels that cover the square, by points all over it.
    sides = np.linspace(-half_m, half_m, 9)
    lattice = middle_m + np.stack(np.meshgrid(sides, sides), axis=-1).reshape(-1, 2)
    columns, rows = ~grid @ tuple(transform(lattice, crs, own_crs).T)
    if not (np.isfinite(columns).all() and np.isfinite(rows).all()):
        refuse(where, "another part of the earth", "heights of the junction")
    left, right = _span(columns, raster.width)
    top, bottom = _span(rows, raster.height)
    if left >= right or top >= bottom:
        refuse(where, "a raster that lies elsewhere", "one that covers the junction")
    _check_memory(raster, (right - left) * (bottom - top), where)
    # Middles of these pixels in the coordinates of the map.
    column, row = np.meshgrid(
        np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5
    )
    places = transform(np.stack(grid @ (column, row), axis=-1), own_crs, crs)
    middle = 0.5 * np.array([[left + right], [top + bottom]]) + [
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
    ]
    corners = transform(np.stack(grid @ tuple(middle), axis=-1), own_crs, crs)
    # Edge of a pixel on the ground.
    size_m = np.hypot(*(corners[1:] - corners[0]).T).max()
    if size_m > _COARSEST_M * 1.2:
        refuse(
            where,
            f"pixels of {size_m:.0f} m",
            f"at most {_COARSEST_M:g} m: finer heights",
        )
    band = np.ma.masked_invalid(
        raster.read(1, window=((top, bottom), (left, right)), masked=True)
    )
    # Keep the pixels that have a height that makes sense.
    low_m, high_m = _LIMITS_M
    heights = np.ma.filled(band.astype(np.float64), np.nan)
    is_known = np.isfinite(heights)
    if is_known.any() and not (
        low_m <= heights[is_known].min() <= heights[is_known].max() <= high_m
    ):
        got = f"heights from {heights[is_known].min():g} to {heights[is_known].max():g}"
        refuse(where, got, f"metres above the sea, {low_m:g} to {high_m:g}")
    points = np.column_stack([places[is_known], heights[is_known]])
    away_m = np.hypot(*(points[:, :2] - middle_m).T)
    if not (away_m <= _MIDDLE_M).any():
        refuse(
            where,
            "no heights at the junction",
            f"some within {_MIDDLE_M:g} m of it",
        )
    return points


def _check_memory(raster: Any, n_pixels: int, where: str) -> None:
    """Refuse a raster that takes too much memory around the junction."""
    if n_pixels > _MAX_PIXELS:
        got = f"{n_pixels:,} pixels around the junction"
        refuse(where, got, f"at most {_MAX_PIXELS:,}: a coarser raster")
    # What GDAL unpacks at a time: a block, and perhaps the whole mask.
    rows, columns = raster.block_shapes[0]
    n_bytes = rows * columns * np.dtype(raster.dtypes[0]).itemsize
    if any(flag.name == "per_dataset" for flag in raster.mask_flag_enums[0]):
        n_bytes = max(n_bytes, raster.width * raster.height)
    if n_bytes > _MAX_BLOCK_BYTES:
        got = f"blocks of {n_bytes:,} bytes"
        refuse(where, got, f"at most {_MAX_BLOCK_BYTES:,}: a tiled GeoTIFF")


def _span(values: FloatArray, size: int) -> tuple[int, int]:
    """Range of the pixels that values lie in, with one more on each side."""
    first = int(np.floor(values.min())) - 1
    end = int(np.ceil(values.max())) + 1
    return max(first, 0), min(end, size)


# ---------- terrain from points of the ground
# Along each side.
_MAX_CELLS = 150


def fit_terrain(points_m: FloatArray, *, half_m: float, step_m: float) -> Terrain:
    """Terrain of a square around the origin from points (n, 3) of the ground.

    Linear between the points, by their Delaunay triangulation; beyond them as high as
    the nearest place between them. Lines are `step_m` apart, or farther where there
    would be too many. In metres.
    """
    from scipy.interpolate import NearestNDInterpolator
    from scipy.ndimage import distance_transform_edt

    n_cells = min(int(np.ceil(2.0 * half_m / step_m)), _MAX_CELLS)
    line = np.linspace(-half_m, half_m, n_cells + 1).round(GRID_DECIMALS)
    nodes = np.stack(np.meshgrid(line, line), axis=-1)
    # One point per cell of a grid twice as fine: the mean of those in it.
    # Averages keep the triangulation small and even.
    cell = np.floor(points_m[:, :2] / (0.5 * step_m)).astype(np.int64)
    _, member, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(member.ravel(), column) for column in points_m.T]
    thin: FloatArray = np.stack(sums, axis=1) / count[:, None]
    height = _between(thin, nodes)
    # Points on a line, or a few: the ground next to them is as high.
    if np.isnan(height).all():
        ways = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
        aside = 0.5 * (line[1] - line[0]) * ways
        height = _between((thin[:, None] + 1.5 * aside).reshape(-1, 3), nodes)
    # And none of them in the square.
    if np.isnan(height).all():
        height = NearestNDInterpolator(thin[:, :2], thin[:, 2])(nodes)
    _, nearest = distance_transform_edt(np.isnan(height), return_indices=True)
    filled = height[tuple(nearest)]
    return Terrain(east_m=line, north_m=line, height_m=filled.round(GRID_DECIMALS))


def _between(points_m: FloatArray, nodes_m: FloatArray) -> FloatArray:
    """Heights at nodes (..., 2) between points (n, 3); NaN beyond them."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import QhullError
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(1):
            # Of thousands of 2 x 2 systems: other BLAS threads only spin.
            height: FloatArray = LinearNDInterpolator(points_m[:, :2], points_m[:, 2])(
                nodes_m
            )
    except (QhullError, ValueError):
        # Fewer than three points, or all on a line.
        return np.full(nodes_m.shape[:-1], np.nan)
    return height
