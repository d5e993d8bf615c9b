"""From luminances to an image: edges that need more rays, exposure, noise and sRGB."""

import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray
from geometry.files import load_toml, read_table
from geometry.kernels import kernel
from geometry.raycast import FloatRays

from .light import LUMINANCE

_CONTRAST = 0.35  # between neighbours, of their mean: more is an edge


def find_edges(radiance: FloatRays) -> BoolArray:
    """Pixels (h, w) of an image (h, w, 3) that differ much from a neighbour."""
    is_edge = np.zeros(radiance.shape[:2], dtype=np.bool_)
    _mark_edges(radiance, np.float32(0.5 * _CONTRAST), is_edge)
    return is_edge


_SAMPLE = 4
_STEPS = 8192  # of the curve from linear light to sRGB, over 0 .. _BRIGHTEST
_BRIGHTEST = 4.0


@cache
def load_imager() -> Mapping[str, float]:
    """``data/imager.toml``."""
    return read_table(
        load_toml(files(__package__) / "data" / "imager.toml"), dict[str, float], "imager.toml"
    )


def white_luminance(
    radiance: FloatRays, imager: Mapping[str, float], *, every: int = _SAMPLE
) -> float:
    """Luminance that the exposure of an image (h, w, 3) makes white, in cd/m^2.

    Of the image every so many pixels along each side are looked at.

    The mean of logarithms over the key, but no less than the longest exposure allows.

    References
    ----------
    .. [1] E. Reinhard et al., "Photographic tone reproduction for digital images", 2002: the key.
    """
    luminance = radiance[::every, ::every] @ LUMINANCE.astype(np.float32)
    mean = float(np.exp(np.log(np.maximum(luminance, np.float32(1e-4))).mean()))
    return max(mean / imager["key"], imager["white_cdpm2_least"])


def develop(
    radiance: FloatRays, white_cdpm2: float, imager: Mapping[str, float], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Pixels of an image or of a part of it, (h, w, 3), sRGB.

    `radiance` (h, w, 3) is in cd/m^2; `white_cdpm2` is what becomes white.
    """
    gain = max(1.0, imager["white_cdpm2_base"] / white_cdpm2)
    electrons = imager["full_well_e"] / gain  # at white
    noise = rng.standard_normal(radiance.shape, dtype=np.float32)
    rgb = np.empty(radiance.shape, dtype=np.uint8)
    _expose(
        radiance,
        noise,
        np.float32(1.0 / white_cdpm2),
        np.float32(1.0 / electrons),
        np.float32((imager["read_noise_e"] / electrons) ** 2),
        _curve(imager["shoulder"]),
        rgb,
    )
    return rgb


@cache
def _curve(shoulder: float) -> NDArray[np.uint8]:
    """Levels of sRGB by linear light in steps; beyond the shoulder highlights bend towards white.

    References
    ----------
    .. [1] IEC 61966-2-1: the two branches of sRGB.
    """
    light = (np.arange(_STEPS) + 0.5) * (_BRIGHTEST / _STEPS)
    rest = 1.0 - shoulder
    bent = shoulder + rest * (1.0 - np.exp(-(light - shoulder) / rest))
    light = np.where(light > shoulder, bent, light)
    curved = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.clip(np.rint(255.0 * curved), 0, 255).astype(np.uint8)


@kernel
def _mark_edges(radiance: FloatRays, contrast: np.float32, is_edge: BoolArray) -> None:
    """Mark neighbours whose green differs by more than a share of their sum."""
    height, width = is_edge.shape
    for row in range(height):
        for column in range(width):
            here = radiance[row, column, 1]
            if column + 1 < width:
                beside = radiance[row, column + 1, 1]
                if abs(here - beside) > contrast * (here + beside):
                    is_edge[row, column] = is_edge[row, column + 1] = True
            if row + 1 < height:
                below = radiance[row + 1, column, 1]
                if abs(here - below) > contrast * (here + below):
                    is_edge[row, column] = is_edge[row + 1, column] = True


@kernel
def _expose(
    radiance: FloatRays,
    noise: FloatRays,
    scale: np.float32,
    per_electron: np.float32,
    read: np.float32,
    curve: NDArray[np.uint8],
    rgb: NDArray[np.uint8],
) -> None:
    """Photon noise (variance = mean), that of the amplifier, and the curve to sRGB."""
    steps = np.float32(_STEPS / _BRIGHTEST)
    last = np.float32(_STEPS - 1)
    for row in range(radiance.shape[0]):
        for column in range(radiance.shape[1]):
            for colour in range(3):
                light = radiance[row, column, colour] * scale
                spread = np.float32(math.sqrt(light * per_electron + read))
                level = (light + spread * noise[row, column, colour]) * steps
                level = min(max(level, np.float32(0.0)), last)
                rgb[row, column, colour] = curve[int(level)]
