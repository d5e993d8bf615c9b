"""Pixels on edges, seen by several rays: no stairs along kerbs, roofs and shadows."""

import numpy as np

from geometry.arrays import IntArray
from geometry.raycast import FloatRays

from .shading import Shot, pixel_rays, shade_rays

_CONTRAST = 0.35  # between neighbours, of their mean: more is an edge
# Four points of a square, turned so that no two share a row or a column.
_OFFSETS_PX = ((0.125, 0.375), (-0.375, 0.125), (0.375, -0.125), (-0.125, -0.375))


def find_edges(radiance: FloatRays, tile_px: tuple[int, int]) -> IntArray:
    """Pixels that differ much from one beside or below.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        The image. [cd/m^2]
    tile_px : tuple of int
        Rows and columns of a tile.

    Returns
    -------
    pixels : (n,) int
        Row * w + column, tile by tile.
    """
    green = np.ascontiguousarray(radiance[..., 1])
    is_edge = np.zeros(green.shape, dtype=bool)
    for one, other in (
        (np.s_[:, :-1], np.s_[:, 1:]),
        (np.s_[:-1], np.s_[1:]),
    ):
        a, b = green[one], green[other]
        differs = np.abs(a - b) > np.float32(0.5 * _CONTRAST) * (a + b)
        is_edge[one] |= differs
        is_edge[other] |= differs
    rows, columns = np.nonzero(is_edge)
    order = np.lexsort((columns // tile_px[1], rows // tile_px[0]))
    pixels: IntArray = (rows * green.shape[1] + columns)[order]
    return pixels


def smooth_pixels(shot: Shot, pixels: IntArray, radiance: FloatRays) -> FloatRays:
    """Luminance of pixels as the mean over several rays.

    Parameters
    ----------
    shot : Shot
        What is drawn.
    pixels : (n,) int
        Row * w + column.
    radiance : (n, 3) float32
        What the rays through their middles saw. [cd/m^2]

    Returns
    -------
    mean : (n, 3) float32
        Over these and four rays more. [cd/m^2]
    """
    rows, columns = np.divmod(pixels, shot.camera.width_px)
    ways = [
        pixel_rays(
            shot,
            (columns + (0.5 + across)).astype(np.float32),
            (rows + (0.5 + down)).astype(np.float32),
        )
        for across, down in _OFFSETS_PX
    ]
    more, _, _ = shade_rays(shot, np.concatenate(ways))
    mean: FloatRays = (radiance + more.reshape(len(ways), -1, 3).sum(axis=0)) / (1.0 + len(ways))
    return mean
