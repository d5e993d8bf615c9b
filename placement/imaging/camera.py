"""From luminance to pixels: exposure, noise, highlights, sRGB."""

from collections.abc import Mapping
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from geometry.files import load_toml, take_number
from geometry.raycast import FloatRays

from .light import LUMINANCE

# ---------- from luminance to pixels: exposure, noise, highlights, sRGB


_SAMPLE = 4  # every so many pixels are looked at for the exposure
_STEPS = 8192  # of the curve from linear light to sRGB, over 0 .. _BRIGHTEST
_BRIGHTEST = 4.0


@cache
def load_imager() -> Mapping[str, float]:
    """``data/imager.toml``."""
    where = "imager.toml"
    table = load_toml(files(__package__) / "data" / where)
    return {key: take_number(table, key, where) for key in table}


def white_luminance(radiance: FloatRays, imager: Mapping[str, float]) -> float:
    """Luminance that the exposure makes white.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image; linear red, green, blue. [cd/m^2]
    imager : mapping of float
        ``data/imager.toml``.

    Returns
    -------
    white_cdpm2 : float
        Mean of logarithms over the key, but no less than the longest exposure allows. [cd/m^2]

    References
    ----------
    .. [1] E. Reinhard et al., "Photographic tone reproduction for digital images", 2002: the key.
    """
    luminance = radiance[::_SAMPLE, ::_SAMPLE] @ LUMINANCE.astype(np.float32)
    mean = float(np.exp(np.log(np.maximum(luminance, np.float32(1e-4))).mean()))
    return max(mean / imager["key"], imager["white_cdpm2_least"])


def develop(
    radiance: FloatRays, white_cdpm2: float, imager: Mapping[str, float], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Pixels of an image, or of some rows.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        Linear red, green, blue; written over. [cd/m^2]
    white_cdpm2 : float
        What becomes white. [cd/m^2]
    imager : mapping of float
        ``data/imager.toml``.
    rng : Generator
        Of the noise.

    Returns
    -------
    rgb : (h, w, 3) uint8
        sRGB.
    """
    radiance *= np.float32(1.0 / white_cdpm2)
    gain = max(1.0, imager["white_cdpm2_base"] / white_cdpm2)
    electrons = imager["full_well_e"] / gain  # at white
    # Photons come by chance (variance = mean), the amplifier adds its own.
    spread = radiance * np.float32(1.0 / electrons)
    spread += np.float32((imager["read_noise_e"] / electrons) ** 2)
    np.sqrt(spread, out=spread)
    spread *= rng.standard_normal(radiance.shape, dtype=np.float32)
    radiance += spread
    radiance *= np.float32(_STEPS / _BRIGHTEST)
    np.clip(radiance, 0, _STEPS - 1, out=radiance)
    rgb: NDArray[np.uint8] = _curve(imager["shoulder"]).take(radiance.astype(np.int16))
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
