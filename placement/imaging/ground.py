"""The road plane as a map: how far it is to road and paint, how much sky is left, and noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import FloatArray
from geometry.raycast import FloatRays
from geometry.scene import Scene

from .markings import build_markings, build_road
from .mesh import Thing
from .rectangles import polygon_distance, rectangle_distance

ROAD, PAINT, SKY = 0, 1, 2  # layers of a map

_STEP_M = 0.1
_ROAD_REACH_M = 4.5  # distances are kept up to here
_PAINT_REACH_M = 0.4
_SHADE_REACH_M = 12.0
_CLEARANCE_M = 0.18  # of vehicles above the road: light gets in below them
_SHADERS = ("building", "wall", "vegetation", "parked vehicle", "vehicle", "pedestrian", "cyclist")
_NOISE_SIZE = 1024  # texels; a power of two
_NOISE_SEED = 5  # the road looks the same in every picture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundMap:
    """Layers over the road plane; beyond the edge they go on as they are there.

    Attributes
    ----------
    origin_m : (2,) float
        Middle of the first texel. World frame. [m]
    layers : (n_north, n_east, 3) float32
        Signed distances to the road's and the paint's edge, negative inside [m]; share of the
        sky's light that what stands around leaves, 0 .. 1.
    grain, patches : (1024 * 1024,) float32
        Noise without mean, spread about 1: of single texels, and soft.
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
        values : (n, 3) float32
            See `layers`.
        """
        n_north, n_east = self.layers.shape[:2]
        x = np.clip(
            (east_m - np.float32(self.origin_m[0])) / np.float32(_STEP_M), 0, n_east - 1.001
        )
        y = np.clip(
            (north_m - np.float32(self.origin_m[1])) / np.float32(_STEP_M), 0, n_north - 1.001
        )
        column, row = x.astype(np.int32), y.astype(np.int32)
        x -= column
        y -= row
        flat = self.layers.reshape(-1, 3)
        first = row * np.int32(n_east) + column
        x, y = x[:, None], y[:, None]
        low: FloatRays = flat.take(first, axis=0)
        low += x * (flat.take(first + 1, axis=0) - low)
        high = flat.take(first + np.int32(n_east), axis=0)
        high += x * (flat.take(first + np.int32(n_east + 1), axis=0) - high)
        high -= low
        high *= y
        low += high
        return low


def build_ground_map(
    scene: Scene, things: Sequence[Thing], marks: Mapping[str, float]
) -> GroundMap:
    """Draw the map of a scene.

    Parameters
    ----------
    scene : Scene
        Lanes, outline, crosswalks.
    things : sequence of Thing
        What stands still and takes light from the sky.
    marks : mapping
        ``[markings]`` of ``data/materials.toml``.

    Returns
    -------
    ground : GroundMap
        As large as the lanes and the outline.
    """
    corners = np.concatenate([scene.outline_m, *(lane.centreline_m for lane in scene.lanes)])
    if not len(corners):
        corners = np.zeros((1, 2))
    low, high = corners.min(axis=0), corners.max(axis=0)
    n_east, n_north = (np.ceil((high - low) / _STEP_M).astype(int) + 2).tolist()
    layers = np.empty((n_north, n_east, 3), dtype=np.float32)
    layers[...] = [_ROAD_REACH_M, _PAINT_REACH_M, 1.0]
    ground = GroundMap(
        origin_m=low, layers=layers, grain=_noise(0.0, sigma=1), patches=_noise(1.1, sigma=0)
    )
    for rectangle in build_road(scene):
        _keep_least(ground, ROAD, rectangle, _ROAD_REACH_M)
    if len(scene.outline_m):
        window, points = _window(ground, scene.outline_m, _ROAD_REACH_M)
        kept = layers[*window, ROAD]
        kept[...] = np.minimum(kept, polygon_distance(points, scene.outline_m))
    for rectangle in build_markings(scene, marks):
        _keep_least(ground, PAINT, rectangle, _PAINT_REACH_M)
    # Paint is on the road only.
    layers[..., PAINT] = np.maximum(layers[..., PAINT], layers[..., ROAD])
    for thing in things:
        if thing.class_name in _SHADERS:
            rectangle = thing_rectangle(thing)
            window, points = _window(ground, _corners(rectangle), _SHADE_REACH_M)
            distance = rectangle_distance(points, rectangle)
            layers[*window, SKY] *= sky_left(distance, thing)
    return ground


def thing_rectangle(thing: Thing) -> FloatArray:
    """Footprint of a thing, as for :func:`placement.imaging.rectangles.rectangle_distance`."""
    east, north, _ = thing.pose.position_m.tolist()
    half_length, half_width = (0.5 * thing.size_m[:2]).tolist()
    return np.array([east, north, np.radians(thing.pose.yaw_deg), half_length, half_width])


def sky_left(distance_m: FloatArray, thing: Thing) -> FloatRays:
    """Share of the sky's light that a thing leaves to the ground around and below it.

    Parameters
    ----------
    distance_m : (...) float
        Signed, from its footprint's edge. [m]
    thing : Thing
        What stands there.

    Returns
    -------
    share : (...) float32
        0 .. 1.

    References
    ----------
    .. [1] J. Howell, "A catalog of radiation configuration factors": from level ground to an
       upright plane of height h at distance x: (1 - x / sqrt(x^2 + h^2)) / 2.
    """
    height = float(thing.size_m[2])
    # A plane without end takes more than a body of this length does.
    outside = np.maximum(distance_m, 0.0)
    length = float(thing.size_m[:2].max())
    seen = length / np.hypot(length, 2.0 * outside)
    share = 1.0 - 0.5 * seen * (1.0 - outside / np.hypot(outside, height))
    below = 0.5 * np.exp(np.minimum(distance_m, 0.0) / _CLEARANCE_M)
    left: FloatRays = np.where(distance_m > 0.0, share, np.maximum(below, 0.08)).astype(np.float32)
    return left


def grain_at(noise: FloatRays, east: FloatRays, north: FloatRays, per_m: FloatRays) -> FloatRays:
    """Values of a noise at points, the same on every tile.

    Parameters
    ----------
    noise : (1024 * 1024,) float32
        Of :class:`GroundMap`.
    east, north : (n,) float32
        Points on a plane. [m]
    per_m : (n,) float32
        Texels per metre.

    Returns
    -------
    values : (n,) float32
        Of the nearest texel.
    """
    mask = np.int32(_NOISE_SIZE - 1)
    column = np.floor(east * per_m).astype(np.int32) & mask
    row = np.floor(north * per_m).astype(np.int32) & mask
    values: FloatRays = noise.take(row * np.int32(_NOISE_SIZE) + column)
    return values


def soft_noise_at(
    noise: FloatRays, east: FloatRays, north: FloatRays, *, texel_m: float
) -> FloatRays:
    """Values of a noise at points, linear between texels.

    Parameters
    ----------
    noise, east, north
        As for :func:`grain_at`.
    texel_m : float
        Size of a texel. [m]

    Returns
    -------
    values : (n,) float32
        The same on every tile.
    """
    mask, size = np.int32(_NOISE_SIZE - 1), np.int32(_NOISE_SIZE)
    x, y = east * np.float32(1.0 / texel_m), north * np.float32(1.0 / texel_m)
    left, low = np.floor(x), np.floor(y)
    x -= left
    y -= low
    column, row = left.astype(np.int32) & mask, low.astype(np.int32) & mask
    right, above = (column + np.int32(1)) & mask, ((row + np.int32(1)) & mask) * size
    row *= size
    below: FloatRays = noise.take(row + column)
    below += x * (noise.take(row + right) - below)
    upper: FloatRays = noise.take(above + column)
    upper += x * (noise.take(above + right) - upper)
    upper -= below
    upper *= y
    below += upper
    return below


def _noise(exponent: float, *, sigma: int) -> FloatRays:
    """Periodic noise whose amplitude falls with frequency, made by filtering white noise."""
    white = np.random.default_rng([_NOISE_SEED, sigma]).standard_normal((_NOISE_SIZE, _NOISE_SIZE))
    frequency = np.fft.fftfreq(_NOISE_SIZE)
    radius = np.hypot(frequency[:, None], frequency[: _NOISE_SIZE // 2 + 1])
    radius[0, 0] = np.inf
    amplitude = np.maximum(radius, 4.0 / _NOISE_SIZE) ** -exponent
    amplitude[0, 0] = 0.0
    field = np.fft.irfft2(np.fft.rfft2(white) * amplitude, s=white.shape)
    scaled: FloatRays = (field / field.std()).astype(np.float32).ravel()
    return scaled


def _keep_least(ground: GroundMap, layer: int, rectangle: FloatArray, reach_m: float) -> None:
    window, points = _window(ground, _corners(rectangle), reach_m)
    kept = ground.layers[*window, layer]
    kept[...] = np.minimum(kept, rectangle_distance(points, rectangle))


def _corners(rectangle: FloatArray) -> FloatArray:
    east, north, yaw, half_length, half_width = rectangle.tolist()
    ahead = half_length * np.array([np.cos(yaw), np.sin(yaw)])
    left = half_width * np.array([-np.sin(yaw), np.cos(yaw)])
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    corners: FloatArray = [east, north] + signs[:, :1] * ahead + signs[:, 1:] * left
    return corners


def _window(
    ground: GroundMap, corners_m: FloatArray, reach_m: float
) -> tuple[tuple[slice, slice], FloatArray]:
    """Part of a map around corners, and the middles of its texels, (.., .., 2)."""
    low = np.floor((corners_m.min(axis=0) - reach_m - ground.origin_m) / _STEP_M).astype(int)
    high = np.ceil((corners_m.max(axis=0) + reach_m - ground.origin_m) / _STEP_M).astype(int)
    n_north, n_east = ground.layers.shape[:2]
    columns = slice(max(0, low[0]), max(0, min(n_east, high[0] + 1)))
    rows = slice(max(0, low[1]), max(0, min(n_north, high[1] + 1)))
    east = ground.origin_m[0] + _STEP_M * np.arange(columns.start, max(columns.start, columns.stop))
    north = ground.origin_m[1] + _STEP_M * np.arange(rows.start, max(rows.start, rows.stop))
    return (rows, columns), np.stack(np.meshgrid(east, north), axis=-1)
