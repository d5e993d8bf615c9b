"""From luminances to an image: edges, glare, drops, exposure, noise, sRGB."""

import math
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray
from geometry.poses import Pose
from geometry.raycast import FloatRays, RayCaster
from geometry.sensors import CameraModel, project_points
from geometry.tables import read_data, take_number
from geometry.weather import Weather

from .light import LUMINANCE, Lamp, Sky, load_lamp_table

# Neighbours that differ by more of their mean are an edge.
_CONTRAST = 0.35


def find_edges(radiance: FloatRays) -> BoolArray:
    """Mask of pixels that differ much from a neighbour, and need more rays.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image; green counts. [cd/m^2]

    Returns
    -------
    is_edge : (h, w) bool
    """
    green = radiance[..., 1]
    contrast = np.float32(0.5 * _CONTRAST)
    is_edge = np.zeros(green.shape, dtype=np.bool_)
    for lines, edges in ((green, is_edge), (green.T, is_edge.T)):
        here = lines[:-1]
        below = lines[1:]
        differs = np.abs(here - below) > contrast * (here + below)
        edges[:-1] |= differs
        edges[1:] |= differs
    return is_edge


_SAMPLE = 4
# Steps of the curve from linear light to sRGB, over 0 .. _BRIGHTEST.
_STEPS = 8192
_BRIGHTEST = 4.0


@cache
def load_imager() -> Mapping[str, float]:
    """Figures of the imager, from ``data/imager.toml``."""
    return read_data(__package__, "imager.toml", dict[str, float])


def white_luminance(
    radiance: FloatRays, imager: Mapping[str, float], *, every: int = _SAMPLE
) -> float:
    """Luminance that the exposure of an image makes white.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image. [cd/m^2]
    imager : mapping of str to float
        ``data/imager.toml``.
    every : int
        Every how many pixels along each side are looked at.

    Returns
    -------
    white_cdpm2 : float
        The mean of logarithms over the key, but no less than the longest exposure
        allows. [cd/m^2]

    References
    ----------
    E. Reinhard et al., "Photographic tone reproduction for digital images", 2002: the
    key.
    """
    luminance = radiance[::every, ::every] @ LUMINANCE.astype(np.float32)
    mean = float(np.exp(np.log(np.maximum(luminance, np.float32(1e-4))).mean()))
    return max(mean / imager["key"], imager["white_cdpm2_least"])


def develop(
    radiance: FloatRays,
    white_cdpm2: float,
    imager: Mapping[str, float],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Pixels of an image or of a part of it, with noise, in sRGB.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image. [cd/m^2]
    white_cdpm2 : float
        Luminance that becomes white. [cd/m^2]
    imager : mapping of str to float
        ``data/imager.toml``.
    rng : Generator
        Of the noise.

    Returns
    -------
    rgb : (h, w, 3) uint8
    """
    gain = max(1.0, imager["white_cdpm2_base"] / white_cdpm2)
    # Electrons of a white pixel.
    electrons = imager["full_well_e"] / gain
    noise = rng.standard_normal(radiance.shape, dtype=np.float32)
    light = radiance * np.float32(1.0 / white_cdpm2)
    # Photon noise (variance = mean), and that of the amplifier.
    variance = light * np.float32(1.0 / electrons)
    variance += np.float32((imager["read_noise_e"] / electrons) ** 2)
    level = (light + np.sqrt(variance) * noise) * np.float32(_STEPS / _BRIGHTEST)
    steps = np.clip(level, 0.0, _STEPS - 1).astype(np.int32)
    rgb: NDArray[np.uint8] = _curve(imager["shoulder"])[steps]
    return rgb


@cache
def _curve(shoulder: float) -> NDArray[np.uint8]:
    """Levels of sRGB by linear light in even steps, (n_steps,) uint8.

    Beyond the shoulder highlights bend towards white.

    References
    ----------
    IEC 61966-2-1: the two branches of sRGB.
    """
    light = (np.arange(_STEPS) + 0.5) * (_BRIGHTEST / _STEPS)
    rest = 1.0 - shoulder
    bent = shoulder + rest * (1.0 - np.exp(-(light - shoulder) / rest))
    light = np.where(light > shoulder, bent, light)
    curved = np.where(
        light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055
    )
    return np.clip(np.rint(255.0 * curved), 0, 255).astype(np.uint8)


# ---------- rain and glare
# The housing keeps off nearer drops, and farther ones are too thin to see.
_DROP_RANGE_M = (
    0.8,
    6.0,
)
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
    """Draw lamps that shine into the camera, and the light scattered around them.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image, or a part of it; written. [cd/m^2]
    pose : Pose
        Of the camera.
    camera : CameraModel
        The camera.
    lamps : sequence of Lamp
        Lamps that are on.
    caster : RayCaster
        Tells which lamps are occluded; its origin is at the camera.
    corner_px : (int, int)
        Column and row at which the part begins.

    Notes
    -----
    The glare falls off with the square of the angle, after Stiles and Holladay.
    """
    if not lamps:
        return
    table = load_lamp_table()["glare"]
    where = "lamps.toml: glare"
    share = take_number(table, "share_of_eye", where)
    radius_deg = take_number(table, "radius_deg", where)
    places = np.stack([lamp.position_m for lamp in lamps])
    away = (places - pose.position_m).astype(np.float32)
    blocked = caster.is_blocked(np.zeros_like(away), away * np.float32(0.995))
    per_deg = camera.focal_length_px * np.radians(1.0)
    shown = project_points(places, pose, camera)
    for lamp, place, way, is_hidden in zip(lamps, shown, away, blocked, strict=True):
        column, row, depth = place.tolist()
        # Occluded, too near or behind, or beyond a lens's reach.
        if is_hidden or not depth > camera.near_m or math.isnan(column):
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
    """Part of an image around a point, and squared distances from the point.

    Returns
    -------
    part : (h, w, 3) float32
        A view of the image.
    square : (h, w) float32
        Squared distance of the middle of each pixel. [px^2]
    None
        If no pixel is within reach.
    """
    height, width = image.shape[:2]
    columns = slice(max(0, int(column - reach)), min(width, int(column + reach) + 1))
    rows = slice(max(0, int(row - reach)), min(height, int(row + reach) + 1))
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return None
    across = np.arange(columns.start, columns.stop, dtype=np.float32) + np.float32(
        0.5 - column
    )
    down = np.arange(rows.start, rows.stop, dtype=np.float32) + np.float32(0.5 - row)
    return image[rows, columns], across[None, :] ** 2 + down[:, None] ** 2


def add_rain(
    radiance: FloatRays,
    weather: Weather,
    sky: Sky,
    *,
    focal_px: float,
    pitch_deg: float,
    exposure_s: float,
    rng: np.random.Generator,
) -> None:
    """Draw near drops as streaks, in place; a drop shows the sky.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image, or a part of it; written. [cd/m^2]
    weather : Weather
        Its rain rate counts.
    sky : Sky
        What drops show.
    focal_px : float
        Focal length. [px]
    pitch_deg : float
        Of the camera; a pitched one sees the fall foreshortened. [deg]
    exposure_s : float
        How long a drop is seen. [s]
    rng : Generator
        Of the drops.

    References
    ----------
    .. [1] J. Marshall, W. Palmer, "The distribution of raindrops with size", 1948: per
       volume and diameter 8000 exp(-4.1 R^-0.21 D) / (m^3 mm).
    .. [2] D. Atlas, R. Srivastava, C. Sekhon, "Doppler radar characteristics of
       precipitation at vertical incidence", 1973: speed 9.65 - 10.3 exp(-0.6 D) m/s,
       D in mm.
    .. [3] K. Garg, S. Nayar, "Vision and rain", 2007: a streak is as transparent as the
       time that its drop spends on a pixel is short.
    """
    if weather.rain_rate_mmph == 0.0:
        return
    # How many drops per cubic metre are large enough to see [1].
    slope_per_m = 4100.0 * weather.rain_rate_mmph**-0.21
    share = np.exp(-slope_per_m * _LEAST_DROP_M)
    per_m3 = _MARSHALL_PALMER_PER_M4 / slope_per_m * share
    near, far = _DROP_RANGE_M
    height_px, width_px = radiance.shape[:2]
    area_at_1m = width_px * height_px / focal_px**2
    n_drops = int(rng.poisson(per_m3 * area_at_1m * (far**3 - near**3) / 3.0))
    depth = np.cbrt(rng.uniform(near**3, far**3, n_drops))
    drop_m = _LEAST_DROP_M + rng.exponential(1.0 / slope_per_m, n_drops)
    # How fast they fall [2], how long their streaks are, and how faint [3].
    speed = 9.65 - 10.3 * np.exp(-600.0 * drop_m)
    length_px = speed * exposure_s * np.cos(np.radians(pitch_deg)) * focal_px / depth
    thin_px = np.minimum(drop_m * focal_px / depth, 1.0)
    opacity = np.minimum(drop_m / (speed * exposure_s), 1.0) * thin_px
    column = rng.uniform(0.0, width_px, n_drops)
    row = rng.uniform(-0.1, 1.0, n_drops) * height_px
    _streak(radiance, column, row, length_px, opacity, sky.sky_lux / np.pi)


def _streak(
    radiance: FloatRays,
    column: FloatArray,
    row: FloatArray,
    length_px: FloatArray,
    opacity: FloatArray,
    colour: FloatArray,
) -> None:
    """Blend upright lines into an image, brightest in their middle.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image; written. [cd/m^2]
    column, row : (n,) float
        Upper end of each line. [px]
    length_px : (n,) float
        Its length. [px]
    opacity : (n,) float
        Share of it in its middle.
    colour : (3,) float
        Luminance of all lines. [cd/m^2]
    """
    height, width = radiance.shape[:2]
    # Pixels of all lines, one line after the other.
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
    difference = colour.astype(np.float32) - flat[wet]
    flat[wet] += np.minimum(share[wet], 1.0)[:, None] * difference
