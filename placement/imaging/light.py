"""Illuminance of what rays have met: sun, sky, what the ground sends up, lamps; with shadows."""

from collections.abc import Sequence

import numpy as np

from geometry.raycast import FloatRays, RayCaster

from .lamps import Lamp
from .materials import Hits
from .sky import Sky

_OFF_SURFACE_M = 4.0e-3  # where rays towards the light start
_SUN_WAY_M = 500.0  # what is farther away throws no shadow here
_SHADOW_SHARE = 0.08  # lamps that give less than this of a point's light throw no shadow there


def illuminance(
    hits: Hits,
    *,
    caster: RayCaster,
    origin_m: FloatRays,
    sky: Sky,
    lamps: Sequence[Lamp],
    sky_share: FloatRays | None = None,
    ground_albedo: float = 0.0,
) -> FloatRays:
    """Light that falls on surfaces.

    Parameters
    ----------
    hits : Hits
        The surfaces.
    caster : RayCaster
        What throws shadows.
    origin_m : (3,) float32
        Of the caster's frame, world frame. [m]
    sky : Sky
        Sun and sky.
    lamps : sequence of Lamp
        Those that are on.
    sky_share : (n,) float32, optional
        Share of the sky that nothing hides; by default all.
    ground_albedo : float
        Of what light comes back from below.

    Returns
    -------
    illuminance_lux : (n, 3) float32
        Linear red, green, blue. [lx]

    References
    ----------
    .. [1] J. H. Lambert, "Photometria", 1760: the cosine, and the inverse square.
    """
    upness = hits.normals[:, 2]
    above = 0.5 + 0.5 * upness
    if sky_share is not None:
        above = above * sky_share
    lux: FloatRays = above[:, None] * sky.sky_lux.astype(np.float32)
    level = sky.sky_lux + max(float(sky.to_sun[2]), 0.0) * sky.sun_lux
    below = np.float32(ground_albedo) * (0.5 - 0.5 * upness)
    starts: FloatRays = hits.points_m - origin_m
    starts += np.float32(_OFF_SURFACE_M) * hits.normals
    if (level > 0.0).any() and not (upness > 0.999).all():
        lux += below[:, None] * level.astype(np.float32)
    if (sky.sun_lux > 0.0).any() and sky.to_sun[2] > 0.0:
        _add_sun(lux, hits, starts, caster, sky)
    if lamps:
        _add_lamps(lux, hits, starts, caster, lamps, below)
    return lux


def _add_sun(lux: FloatRays, hits: Hits, starts: FloatRays, caster: RayCaster, sky: Sky) -> None:
    cosine = hits.normals @ sky.to_sun.astype(np.float32)
    facing = np.flatnonzero(cosine > 0.0)
    way = np.broadcast_to((_SUN_WAY_M * sky.to_sun).astype(np.float32), (len(facing), 3))
    free = facing[~caster.is_blocked(starts[facing], way)]
    lux[free] += cosine[free, None] * sky.sun_lux.astype(np.float32)


def _add_lamps(
    lux: FloatRays,
    hits: Hits,
    starts: FloatRays,
    caster: RayCaster,
    lamps: Sequence[Lamp],
    below: FloatRays,
) -> None:
    """Light of lamps; rays only where a lamp matters."""
    points, normals = np.ascontiguousarray(hits.points_m.T), np.ascontiguousarray(hits.normals.T)
    low, high = points.min(axis=1), points.max(axis=1)
    total = lux[:, 1].copy()
    direct: list[tuple[Lamp, FloatRays]] = []
    by_colour: dict[tuple[float, ...], FloatRays] = {}
    for lamp in lamps:
        position = lamp.position_m.astype(np.float32)
        if np.linalg.norm(position - np.clip(position, low, high)) > lamp.reach_m:
            continue
        away = points - position[:, None]
        square = away[0] * away[0]
        square += away[1] * away[1]
        square += away[2] * away[2]
        away *= 1.0 / np.sqrt(square)
        strength = lamp.intensity_cd(away)
        strength /= square
        strength *= square < np.float32(lamp.reach_m**2)
        # What the ground below would get comes back from it.
        glow = np.minimum(away[2], 0.0)
        glow *= strength
        glow *= below
        cosine = away[0] * normals[0]
        cosine += away[1] * normals[1]
        cosine += away[2] * normals[2]
        strength *= np.maximum(-cosine, 0.0)
        total += strength
        direct.append((lamp, strength))
        by_colour.setdefault(tuple(lamp.colour.tolist()), np.zeros_like(total))[...] -= glow
    total *= np.float32(_SHADOW_SHARE)
    for lamp, strength in direct:
        rays = np.flatnonzero(strength > total)
        way = lamp.position_m.astype(np.float32) - hits.points_m[rays]
        way *= np.float32(0.995)
        strength[rays[caster.is_blocked(starts[rays], way)]] = 0.0
        by_colour[tuple(lamp.colour.tolist())] += strength
    for colour, strength in by_colour.items():
        lux += strength[:, None] * np.array(colour, dtype=np.float32)
