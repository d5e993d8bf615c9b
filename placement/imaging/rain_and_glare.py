"""Rain and glare: drops in front of a camera, and the light that lamps scatter in it."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import FloatArray
from geometry.files import take_number
from geometry.poses import Pose
from geometry.raycast import FloatRays, RayCaster
from geometry.sensors import CameraModel, project_points
from geometry.weather import Weather

from .light import Lamp, Sky, load_lamp_table

_DROP_RANGE_M = (0.8, 6.0)  # nearer ones the housing keeps off, farther ones are too thin to see


_LEAST_DROP_M = 1.0e-3


_MARSHALL_PALMER_PER_M4 = 8.0e6


def add_glare(
    radiance: FloatRays,
    pose: Pose,
    camera: CameraModel,
    lamps: Sequence[Lamp],
    caster: RayCaster,
    *,
    corner_px: tuple[int, int] = (0, 0),
) -> None:
    """Draw lamps that shine into the camera, and the light that scatters around them, in place.

    `radiance` is the image (h, w, 3) in cd/m^2, or a part of it that begins at the column and row
    `corner_px`; the caster has its origin at the camera.
    """
    if not lamps:
        return
    table, where = load_lamp_table()["glare"], "lamps.toml: glare"
    share, radius_deg = (take_number(table, key, where) for key in ("share_of_eye", "radius_deg"))
    places = np.stack([lamp.position_m for lamp in lamps])
    away = (places - pose.position_m).astype(np.float32)
    blocked = caster.is_blocked(np.zeros_like(away), away * np.float32(0.995))
    per_deg = camera.focal_length_px * np.radians(1.0)
    for lamp, place, way, is_hidden in zip(
        lamps, project_points(places, pose, camera), away, blocked, strict=True
    ):
        column, row, depth = place.tolist()
        if is_hidden or not depth > camera.near_m:
            continue
        distance = float(np.linalg.norm(way))
        intensity = float(lamp.intensity_cd(-way[:, None] / np.float32(distance))[0])
        reach = radius_deg * per_deg
        window = _window(radiance, column - corner_px[0], row - corner_px[1], reach)
        if window is None or intensity == 0.0:
            continue
        part, square = window
        colour = lamp.colour.astype(np.float32)
        # Stiles and Holladay, fading to nothing at the edge of the window.
        lux = intensity / distance**2
        halo = share * 10.0 * lux / (square / np.float32(per_deg**2) + np.float32(0.02))
        halo *= np.clip(1.0 - square / np.float32(reach**2), 0.0, 1.0)
        part += halo[..., None] * colour
        # The lit disc itself, at least as large as a pixel, with its own light.
        radius = lamp.radius_m * camera.focal_length_px / depth
        drawn = max(radius, 0.7)
        disc = intensity / (np.pi * lamp.radius_m**2) * (radius / drawn) ** 2
        edge = np.clip(drawn + 0.5 - np.sqrt(square), 0.0, 1.0)
        part += (np.float32(disc) * edge)[..., None] * colour


def _window(
    image: FloatRays, column: float, row: float, reach: float
) -> tuple[FloatRays, FloatRays] | None:
    """Part of an image around a point, and the pixels' squared distances from it."""
    height, width = image.shape[:2]
    columns = slice(max(0, int(column - reach)), min(width, int(column + reach) + 1))
    rows = slice(max(0, int(row - reach)), min(height, int(row + reach) + 1))
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return None
    across = np.arange(columns.start, columns.stop, dtype=np.float32) + np.float32(0.5 - column)
    down = np.arange(rows.start, rows.stop, dtype=np.float32) + np.float32(0.5 - row)
    return image[rows, columns], across[None, :] ** 2 + down[:, None] ** 2


def add_rain(
    radiance: FloatRays,
    camera: CameraModel,
    weather: Weather,
    sky: Sky,
    *,
    pitch_deg: float,
    exposure_s: float,
    rng: np.random.Generator,
) -> None:
    """Draw near drops as streaks, in place; a drop shows the sky.

    `radiance` is the image (h, w, 3) in cd/m^2. A pitched camera sees the fall foreshortened.

    References
    ----------
    .. [1] J. Marshall, W. Palmer, "The distribution of raindrops with size", 1948: per volume and
       diameter 8000 exp(-4.1 R^-0.21 D) / (m^3 mm).
    .. [2] D. Atlas, R. Srivastava, C. Sekhon, "Doppler radar characteristics of precipitation at
       vertical incidence", 1973: speed 9.65 - 10.3 exp(-0.6 D) m/s, D in mm.
    .. [3] K. Garg, S. Nayar, "Vision and rain", 2007: a streak is as transparent as the time
       that its drop spends on a pixel is short.
    """
    if weather.rain_rate_mmph == 0.0:
        return
    slope_per_m = 4100.0 * weather.rain_rate_mmph**-0.21
    per_m3 = _MARSHALL_PALMER_PER_M4 / slope_per_m * np.exp(-slope_per_m * _LEAST_DROP_M)
    near, far = _DROP_RANGE_M
    focal = camera.focal_length_px
    area_at_1m = camera.width_px * camera.height_px / focal**2
    n_drops = int(rng.poisson(per_m3 * area_at_1m * (far**3 - near**3) / 3.0))
    depth = np.cbrt(rng.uniform(near**3, far**3, n_drops))
    drop_m = _LEAST_DROP_M + rng.exponential(1.0 / slope_per_m, n_drops)
    speed = 9.65 - 10.3 * np.exp(-600.0 * drop_m)
    length_px = speed * exposure_s * np.cos(np.radians(pitch_deg)) * focal / depth
    width_px = drop_m * focal / depth
    opacity = np.minimum(drop_m / (speed * exposure_s), 1.0) * np.minimum(width_px, 1.0)
    column = rng.uniform(0.0, camera.width_px, n_drops)
    row = rng.uniform(-0.1, 1.0, n_drops) * camera.height_px
    _streak(radiance, column, row, length_px, opacity, sky.sky_lux / np.pi)


def _streak(
    radiance: FloatRays,
    column: FloatArray,
    row: FloatArray,
    length_px: FloatArray,
    opacity: FloatArray,
    colour: FloatArray,
) -> None:
    """Blend upright lines into an image, brightest in their middle."""
    height, width = radiance.shape[:2]
    n_pixels = np.maximum(length_px, 1.0).astype(np.int64)
    first = np.cumsum(n_pixels) - n_pixels
    along = np.arange(int(n_pixels.sum())) - np.repeat(first, n_pixels)
    rows = np.repeat(row.astype(np.int64), n_pixels) + along
    columns = np.repeat(column.astype(np.int64), n_pixels)
    bell = np.sin(np.pi * (along + 0.5) / np.repeat(n_pixels, n_pixels))
    inside = (rows >= 0) & (rows < height)
    share = np.bincount(
        (rows * width + columns)[inside],
        weights=(np.repeat(opacity, n_pixels) * bell)[inside],
        minlength=height * width,
    ).astype(np.float32)
    wet = np.flatnonzero(share)
    flat = radiance.reshape(-1, 3)
    flat[wet] += np.minimum(share[wet], 1.0)[:, None] * (colour.astype(np.float32) - flat[wet])
