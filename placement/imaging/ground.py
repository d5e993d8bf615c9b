"""The road plane: lanes, markings, and a map of it.

The map holds distances to road and paint, the share of skylight, and noise.
Rectangles (n, 5) stand for lanes and markings: east and north of the middle, yaw in
radians, half length, half width.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain, pairwise

import numpy as np
import shapely

from geometry.arrays import FloatArray
from geometry.lines import along_m
from geometry.raycast import FloatRays
from geometry.scene import Lane, Scene

from .mesh import PictureThing, build_scene_mesh

# ---------- lanes and markings
# How far beyond a lane's edge its neighbour is looked for.
_NEIGHBOUR_M = 0.4
# A lane that ends so near the junction's outline ends at a stop line.
_MOUTH_M = 2.5
_OVERLAP_M = 0.06


def build_road(scene: Scene) -> FloatArray:
    """Rectangles that together cover all lanes.

    What the junction's outline encloses is road, too, but is no rectangle.

    Returns
    -------
    rectangles : (n, 5) float
        [m], [rad]
    """
    rectangles: list[list[float]] = []
    for lane in scene.lanes:
        line = lane.centreline_m
        width_m = lane.width_m + 2.0 * _OVERLAP_M
        rectangles += _strip(line, 0.0, width_m, _solid(line))
    return np.array(rectangles, dtype=np.float64).reshape(-1, 5)


def build_markings(scene: Scene, marks: Mapping[str, float]) -> FloatArray:
    """Rectangles that are painted: lane lines, stop lines, zebra crossings.

    Parameters
    ----------
    scene : Scene
        Its lanes, outline and crosswalks.
    marks : mapping of str to float
        ``[markings]`` of ``data/materials.toml``.

    Returns
    -------
    rectangles : (n, 5) float
        [m], [rad]
    """
    parts = (
        _lane_lines(scene, marks),
        _stop_lines(scene, marks),
        _zebras(scene, marks),
    )
    return np.array(list(chain(*parts)), dtype=np.float64).reshape(-1, 5)


def _lane_lines(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    """Rectangles of the lines between lanes, both sides of every lane."""
    for lane in scene.lanes:
        if lane.kind not in ("driving", "bus"):
            continue
        line = lane.centreline_m
        # Left side, then right side.
        for side in (1.0, -1.0):
            offset_m = side * 0.5 * lane.width_m
            neighbour, is_along = _neighbour(scene, lane, side)
            if neighbour is None:
                continue
            if neighbour.kind == "parking":
                dashes = _dashes(line, marks["parking_dash_m"], marks["parking_gap_m"])
            elif is_along:
                if side < 0.0:
                    # Drawn by the lane on the other side.
                    continue
                dashes = _dashes(line, marks["dash_m"], marks["gap_m"])
            else:
                # Oncoming: each draws its line of two.
                offset_m -= side * 0.5 * marks["double_line_apart_m"]
                dashes = _solid(line)
            yield from _strip(line, offset_m, marks["line_width_m"], dashes)


def _neighbour(scene: Scene, lane: Lane, side: float) -> tuple[Lane | None, bool]:
    """The neighbour of a lane at its middle, on one side.

    Parameters
    ----------
    scene : Scene
        All lanes.
    lane : Lane
        One of them.
    side : float
        1 for left, -1 for right.

    Returns
    -------
    neighbour : Lane or None
        None if there is none.
    is_along : bool
        It leads the same way.
    """
    at_m = 0.5 * along_m(lane.centreline_m)[-1]
    point, ahead = _at(
        lane.centreline_m, at_m, side * (0.5 * lane.width_m + _NEIGHBOUR_M)
    )
    for other in scene.lanes:
        if other is lane:
            continue
        starts = other.centreline_m[:-1]
        steps = np.diff(other.centreline_m, axis=0)
        length2 = np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-12)
        share = np.clip(
            np.einsum("ij,ij->i", point - starts, steps) / length2, 0.0, 1.0
        )
        distance = np.linalg.norm(starts + share[:, None] * steps - point, axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] < 0.5 * other.width_m:
            return other, bool(steps[nearest] @ ahead > 0.0)
    return None, False


def _stop_lines(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    """Rectangles of stop lines: where driving lanes end at the junction."""
    if not len(scene.outline_m):
        return
    for lane in scene.lanes:
        end_m = along_m(lane.centreline_m)[-1] - 0.5 * marks["stop_line_m"]
        point, ahead = _at(lane.centreline_m, end_m, 0.0)
        if (
            lane.kind == "driving"
            and polygon_distance(point, scene.outline_m) < _MOUTH_M
        ):
            half_width_m = 0.5 * lane.width_m - 0.15
            yield _rectangle(point, ahead, 0.5 * marks["stop_line_m"], half_width_m)


def _zebras(scene: Scene, marks: Mapping[str, float]) -> Iterator[list[float]]:
    """Rectangles of the bars of zebra crossings."""
    pitch_m = marks["zebra_bar_m"] + marks["zebra_gap_m"]
    for start, end in scene.crosswalks_m:
        length_m = float(np.linalg.norm(end - start))
        ahead = (end - start) / length_m
        n_bars = int(length_m / pitch_m)
        first_m = 0.5 * (length_m - (n_bars - 1) * pitch_m)
        for bar in range(n_bars):
            middle = start + (first_m + bar * pitch_m) * ahead
            half_sides = 0.5 * marks["zebra_bar_m"], 0.5 * marks["zebra_length_m"]
            yield _rectangle(middle, ahead, *half_sides)


def _rectangle(
    middle: FloatArray, ahead: FloatArray, half_length: float, half_width: float
) -> list[float]:
    """A rectangle (5,) around a middle (2,), along a unit vector (2,)."""
    return [
        *middle.tolist(),
        float(np.arctan2(ahead[1], ahead[0])),
        half_length,
        half_width,
    ]


def _at(
    line: FloatArray, length_m: float, offset_m: float
) -> tuple[FloatArray, FloatArray]:
    """Point at an offset from a line, and the line's direction there.

    Parameters
    ----------
    line : (n, 2) float
        Points of the line. [m]
    length_m : float
        Distance along it. [m]
    offset_m : float
        To the left of it. [m]

    Returns
    -------
    point : (2,) float
        [m]
    ahead : (2,) float
        Unit vector.
    """
    lengths = along_m(line)
    piece = int(np.clip(np.searchsorted(lengths, length_m) - 1, 0, len(line) - 2))
    step = line[piece + 1] - line[piece]
    # The point is there twice: take the nearest step that is not zero.
    if not step.any():
        steps = np.diff(line, axis=0)
        other = np.flatnonzero(steps.any(axis=1))
        step = steps[other[np.argmin(np.abs(other - piece))]]
    ahead = step / np.linalg.norm(step)
    left = np.array([-ahead[1], ahead[0]])
    return line[piece] + (length_m - lengths[piece]) * ahead + offset_m * left, ahead


def _solid(line: FloatArray) -> list[tuple[float, float]]:
    """Begin and end of each piece of a solid line, along it, in metres."""
    lengths = along_m(line).tolist()
    return [(start - _OVERLAP_M, end + _OVERLAP_M) for start, end in pairwise(lengths)]


def _dashes(line: FloatArray, dash_m: float, gap_m: float) -> list[tuple[float, float]]:
    """Begin and end of each dash of a broken line, along it, in metres."""
    starts = np.arange(0.5 * gap_m, along_m(line)[-1] - dash_m, dash_m + gap_m)
    return [(start, start + dash_m) for start in starts.tolist()]


def _strip(
    line: FloatArray, offset_m: float, width_m: float, dashes: list[tuple[float, float]]
) -> Iterator[list[float]]:
    """Rectangles of the pieces of a strip along a line.

    Parameters
    ----------
    line : (n, 2) float
        Points of the line. [m]
    offset_m, width_m : float
        How far left of the line the strip lies, and how wide it is. [m]
    dashes : list of (float, float)
        Begin and end of each piece along the line. [m]
    """
    for start_m, end_m in dashes:
        middle, ahead = _at(line, 0.5 * (start_m + end_m), offset_m)
        yield _rectangle(middle, ahead, 0.5 * (end_m - start_m), 0.5 * width_m)


# ---------- the map
# Layers of a map.
ROAD = 0
PAINT = 1
SKY = 2

_STEP_M = 0.1
# Distances are stored up to here.
_ROAD_REACH_M = 4.5
_PAINT_REACH_M = 0.4
_SHADE_REACH_M = 12.0
# Height of vehicles above the road: light gets in below them.
_CLEARANCE_M = 0.18
_ON_ROAD = ("parked vehicle", "vehicle", "pedestrian", "cyclist", "motorcyclist", "car")
_SHADERS = ("building", "wall", "vegetation", *_ON_ROAD)
# Texels along a side of the noise; a power of two.
_NOISE_SIZE = 1024
# The road looks the same in every picture.
_NOISE_SEED = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundMap:
    """Layers over the road plane; beyond the map's edge the values there go on.

    Attributes
    ----------
    origin_m : (2,) float
        Middle of the first texel, world frame. [m]
    layers : (n_north, n_east, 3) float32
        Distance to the edge of the road and of paint, negative inside [m]; share of
        the sky's light that surrounding things leave, 0 to 1.
    grain : (1024 * 1024,) float32
        Noise of single texels, with mean 0 and a standard deviation of about 1.
    patches : (1024 * 1024,) float32
        The same, but soft.
    """

    origin_m: FloatArray
    layers: FloatRays
    grain: FloatRays
    patches: FloatRays

    def sample(self, east_m: FloatRays, north_m: FloatRays) -> FloatRays:
        """Layers at points, linear between texels.

        Parameters
        ----------
        east_m, north_m : (n,) float32
            World frame. [m]

        Returns
        -------
        layers : (n, 3) float32
            As in `layers`.
        """
        n_north, n_east = self.layers.shape[:2]
        # Position in texels, as far as the map goes.
        x = (east_m - np.float32(self.origin_m[0])) / np.float32(_STEP_M)
        y = (north_m - np.float32(self.origin_m[1])) / np.float32(_STEP_M)
        x = np.clip(x, 0, n_east - 1.001)
        y = np.clip(y, 0, n_north - 1.001)
        column = x.astype(np.int32)
        row = y.astype(np.int32)
        x -= column
        y -= row
        flat = self.layers.reshape(-1, 3)
        first = row * np.int32(n_east) + column
        x = x[:, None]
        y = y[:, None]
        # Between the two texels of the lower row, of the upper row, then of both.
        low: FloatRays = flat.take(first, axis=0)
        low += x * (flat.take(first + 1, axis=0) - low)
        high = flat.take(first + np.int32(n_east), axis=0)
        high += x * (flat.take(first + np.int32(n_east + 1), axis=0) - high)
        high -= low
        high *= y
        low += high
        return low


def build_ground_map(
    scene: Scene, parked: Sequence[PictureThing], marks: Mapping[str, float]
) -> GroundMap:
    """Draw the map of a scene, as large as its lanes and outline.

    Parameters
    ----------
    scene : Scene
        Its things take light from the sky.
    parked : sequence of PictureThing
        Parked vehicles, which take light, too.
    marks : mapping of str to float
        ``[markings]`` of ``data/materials.toml``.
    """
    origin_m, layers = _scene_layers(scene, tuple(marks.items()))
    layers = layers.copy()
    _shade(origin_m, layers, parked)
    return GroundMap(
        origin_m=origin_m,
        layers=layers,
        grain=_noise(0.0, sigma=1),
        patches=_noise(1.1, sigma=0),
    )


def _shade(
    origin_m: FloatArray, layers: FloatRays, things: Sequence[PictureThing]
) -> None:
    """Reduce the light from the sky around things, in the layers of a map."""
    for thing in things:
        if thing.class_name in _SHADERS:
            yaw = np.radians(thing.pose.yaw_deg)
            half_size_m = 0.5 * thing.size_m[:2]
            rectangle = np.array([*thing.pose.position_m[:2], yaw, *half_size_m])
            corners = _corners(rectangle)
            window, points = _window(origin_m, layers, corners, _SHADE_REACH_M)
            distance = rectangle_distance(points, rectangle)
            layers[*window, SKY] *= sky_left(distance, thing)


# Cached, since pictures of a scene differ only in what parks there.
@lru_cache(maxsize=1)
def _scene_layers(
    scene: Scene, marks: tuple[tuple[str, float], ...]
) -> tuple[FloatArray, FloatRays]:
    """Origin and layers of a scene's map without parked vehicles, read-only.

    Parameters
    ----------
    scene : Scene
        Lanes, outline and things.
    marks : tuple of (str, float)
        ``[markings]`` of ``data/materials.toml``, as the cache needs them.

    Returns
    -------
    origin_m : (2,) float
        [m]
    layers : (n_north, n_east, 3) float32
        As in :class:`GroundMap`.
    """
    corners = np.concatenate(
        [scene.outline_m, *(lane.centreline_m for lane in scene.lanes)]
    )
    if not len(corners):
        corners = np.zeros((1, 2))
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    n_east, n_north = (np.ceil((high - low) / _STEP_M).astype(int) + 2).tolist()
    layers = np.empty((n_north, n_east, 3), dtype=np.float32)
    layers[...] = [_ROAD_REACH_M, _PAINT_REACH_M, 1.0]

    def keep_least(layer: int, rectangle: FloatArray, reach_m: float) -> None:
        window, points = _window(low, layers, _corners(rectangle), reach_m)
        stored = layers[*window, layer]
        stored[...] = np.minimum(stored, rectangle_distance(points, rectangle))

    # Each layer holds the distance to the nearest of its rectangles.
    for rectangle in build_road(scene):
        keep_least(ROAD, rectangle, _ROAD_REACH_M)
    if len(scene.outline_m):
        window, points = _window(low, layers, scene.outline_m, _ROAD_REACH_M)
        stored = layers[*window, ROAD]
        off_m = polygon_distance(points, scene.outline_m)
        # On an island the road is as far as its kerb.
        for island_m in scene.islands_m:
            off_m = np.maximum(off_m, -polygon_distance(points, island_m))
        stored[...] = np.minimum(stored, off_m)
    for rectangle in build_markings(scene, dict(marks)):
        keep_least(PAINT, rectangle, _PAINT_REACH_M)
    # Paint is on the road only.
    layers[..., PAINT] = np.maximum(layers[..., PAINT], layers[..., ROAD])
    _shade(low, layers, build_scene_mesh(scene).things)
    layers.setflags(write=False)
    return low, layers


def sky_left(distance_m: FloatArray, thing: PictureThing) -> FloatRays:
    """Share of the sky's light that a thing leaves to the ground around it.

    Parameters
    ----------
    distance_m : (...) float
        From the edge of the thing's footprint, negative below it. [m]
    thing : PictureThing
        Its size counts.

    Returns
    -------
    share : (...) float32
        0 to 1.

    References
    ----------
    J. Howell, "A catalog of radiation configuration factors": from level ground to an
    upright plane of height h at distance x, (1 - x / sqrt(x^2 + h^2)) / 2.
    """
    height = float(thing.size_m[2])
    # A plane without end takes more than a body of this length does.
    outside = np.maximum(distance_m, 0.0)
    length = float(thing.size_m[:2].max())
    seen = length / np.hypot(length, 2.0 * outside)
    share = 1.0 - 0.5 * seen * (1.0 - outside / np.hypot(outside, height))
    below = 0.5 * np.exp(np.minimum(distance_m, 0.0) / _CLEARANCE_M)
    return np.where(distance_m > 0.0, share, np.maximum(below, 0.08)).astype(np.float32)


def grain_at(
    noise: FloatRays, east: FloatRays, north: FloatRays, per_m: FloatRays
) -> FloatRays:
    """Noise at points of a plane, from the nearest texel.

    The noise repeats like tiles.

    Parameters
    ----------
    noise : (1024 * 1024,) float32
        `grain` or `patches` of a :class:`GroundMap`.
    east, north : (n,) float32
        Points of the plane. [m]
    per_m : (n,) float32
        How many texels make a metre.

    Returns
    -------
    noise : (n,) float32
    """
    mask = np.int32(_NOISE_SIZE - 1)
    column = np.floor(east * per_m).astype(np.int32) & mask
    row = np.floor(north * per_m).astype(np.int32) & mask
    return np.asarray(noise.take(row * np.int32(_NOISE_SIZE) + column))


def soft_noise_at(
    noise: FloatRays, east: FloatRays, north: FloatRays, *, texel_m: float
) -> FloatRays:
    """Noise at points of a plane, linear between texels of one size.

    Parameters and result as in :func:`grain_at`; `texel_m` is the size. [m]
    """
    mask = np.int32(_NOISE_SIZE - 1)
    size = np.int32(_NOISE_SIZE)
    x = east * np.float32(1.0 / texel_m)
    y = north * np.float32(1.0 / texel_m)
    left = np.floor(x)
    low = np.floor(y)
    x -= left
    y -= low
    column = left.astype(np.int32) & mask
    row = low.astype(np.int32) & mask
    right = (column + np.int32(1)) & mask
    above = ((row + np.int32(1)) & mask) * size
    row *= size
    below: FloatRays = noise.take(row + column)
    below += x * (noise.take(row + right) - below)
    upper: FloatRays = noise.take(above + column)
    upper += x * (noise.take(above + right) - upper)
    upper -= below
    upper *= y
    below += upper
    return below


@cache
def _noise(exponent: float, *, sigma: int) -> FloatRays:
    """Periodic noise whose amplitude falls with frequency, (1024 * 1024,).

    White noise is filtered in the frequency domain.

    Parameters
    ----------
    exponent : float
        The amplitude falls with this power of the frequency; 0 leaves it white.
    sigma : int
        Part of the seed.
    """
    white = np.random.default_rng([_NOISE_SEED, sigma]).standard_normal(
        (_NOISE_SIZE, _NOISE_SIZE)
    )
    frequency = np.fft.fftfreq(_NOISE_SIZE)
    radius = np.hypot(frequency[:, None], frequency[: _NOISE_SIZE // 2 + 1])
    radius[0, 0] = np.inf
    amplitude = np.maximum(radius, 4.0 / _NOISE_SIZE) ** -exponent
    amplitude[0, 0] = 0.0
    field = np.fft.irfft2(np.fft.rfft2(white) * amplitude, s=white.shape)
    scaled: FloatRays = (field / field.std()).astype(np.float32).ravel()
    scaled.setflags(write=False)
    return scaled


def _corners(rectangle: FloatArray) -> FloatArray:
    """Corners of a rectangle (5,), (4, 2), in metres."""
    east, north, yaw, half_length, half_width = rectangle.tolist()
    ahead = half_length * np.array([np.cos(yaw), np.sin(yaw)])
    left = half_width * np.array([-np.sin(yaw), np.cos(yaw)])
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray([east, north] + signs[:, :1] * ahead + signs[:, 1:] * left)


def _window(
    origin_m: FloatArray, layers: FloatRays, corners_m: FloatArray, reach_m: float
) -> tuple[tuple[slice, slice], FloatArray]:
    """Part of a map around corners, and the middles of its texels.

    Parameters
    ----------
    origin_m : (2,) float
        Of the map. [m]
    layers : (n_north, n_east, 3) float32
        Gives the size of the map.
    corners_m : (n, 2) float
        Points that the part holds. [m]
    reach_m : float
        How far beyond them it reaches. [m]

    Returns
    -------
    window : (slice, slice)
        Rows and columns.
    points : (n_rows, n_columns, 2) float
        East and north of the texels. [m]
    """
    low = np.floor((corners_m.min(axis=0) - reach_m - origin_m) / _STEP_M).astype(int)
    high = np.ceil((corners_m.max(axis=0) + reach_m - origin_m) / _STEP_M).astype(int)
    n_north, n_east = layers.shape[:2]
    columns = slice(max(0, low[0]), max(0, min(n_east, high[0] + 1)))
    rows = slice(max(0, low[1]), max(0, min(n_north, high[1] + 1)))
    east = origin_m[0] + _STEP_M * np.arange(n_east)[columns]
    north = origin_m[1] + _STEP_M * np.arange(n_north)[rows]
    return (rows, columns), np.stack(np.meshgrid(east, north), axis=-1)


# ---------- distances on the road plane
def rectangle_distance(points_m: FloatArray, rectangle: FloatArray) -> FloatArray:
    """Distance from the edge of a rectangle, negative inside.

    Parameters
    ----------
    points_m : (..., 2) float
        [m]
    rectangle : (5,) float
        East and north of the middle, yaw in radians, half length, half width. [m]

    Returns
    -------
    distance_m : (...) float
        [m]

    Examples
    --------
    >>> points = np.array([[0.0, 0.0], [5.0, 5.0]])
    >>> rectangle_distance(points, np.array([0.0, 0.0, 0.0, 2.0, 1.0]))
    array([-1.,  5.])
    """
    east, north, yaw, half_length, half_width = rectangle.tolist()
    x = points_m[..., 0] - east
    y = points_m[..., 1] - north
    along = np.abs(x * np.cos(yaw) + y * np.sin(yaw)) - half_length
    across = np.abs(y * np.cos(yaw) - x * np.sin(yaw)) - half_width
    outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0))


def polygon_distance(points_m: FloatArray, polygon_m: FloatArray) -> FloatArray:
    """Distance of points (..., 2) from the edge of a polygon, negative inside.

    Parameters
    ----------
    points_m : (..., 2) float
        [m]
    polygon_m : (n, 2) float
        Corners. [m]

    Returns
    -------
    distance_m : (...) float
        [m]
    """
    polygon = shapely.Polygon(polygon_m)
    shapely.prepare(polygon)
    distance = shapely.distance(shapely.points(points_m), polygon.exterior)
    is_inside = shapely.contains_xy(polygon, points_m[..., 0], points_m[..., 1])
    return np.asarray(np.where(is_inside, -distance, distance))
