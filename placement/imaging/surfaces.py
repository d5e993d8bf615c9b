"""Patterns by position: what a spot of ground, facade, wall or post looks like."""

import numpy as np

from geometry.raycast import FloatRays

from .ground import PAINT, ROAD, SKY, GroundMap, grain_at, soft_noise_at
from .materials import Coat, Hits, Materials, blank_coat, blend, cover

_GRAIN_PER_M = (48.0, 384.0)  # texels of the grain, coarsest and finest
_PATCH_M = 0.06  # size of the patches' texels
_TEXELS = np.float32(2.7)  # of noise per window


def coat_ground(
    hits: Hits, ground: GroundMap, materials: Materials, *, wetness: float
) -> tuple[Coat, FloatRays]:
    """Road, paint, kerb, pavement, grass.

    Parameters
    ----------
    hits : Hits
        On the ground.
    ground : GroundMap
        Where road and paint are.
    materials : Materials
        What they look like.
    wetness : float
        Of the weather, 0 .. 1.

    Returns
    -------
    coat : Coat
        Of the hits.
    sky_share : (n,) float32
        Share of the sky's light that what stands around leaves.
    """
    east, north = np.ascontiguousarray(hits.points_m[:, 0]), hits.points_m[:, 1].copy()
    layers = ground.sample(east, north)
    road, pixel = layers[:, ROAD], hits.pixel_m
    # About a texel per pixel; noise finer than a pixel would sparkle.
    per_m = np.clip(np.exp2(np.floor(-np.log2(pixel))), *_GRAIN_PER_M).astype(np.float32)
    grain = grain_at(ground.grain, east, north, per_m)
    grain *= np.minimum(np.float32(1.0 / _GRAIN_PER_M[0]) / pixel, 1.0)
    patches = soft_noise_at(ground.patches, east, north, texel_m=_PATCH_M)
    albedo, pattern = materials.albedo, materials.pattern
    colour = np.empty((len(east), 3), dtype=np.float32)
    colour[...] = albedo["asphalt"]
    wear = 1.0 - np.float32(materials.markings["wear"]) * np.clip(0.5 + 0.4 * patches, 0.0, 1.0)
    painted = np.flatnonzero(layers[:, PAINT] < pixel)
    share = cover(layers[painted, PAINT], pixel[painted]) * wear[painted]
    under = colour[painted]
    blend(under, albedo["paint"], share)
    colour[painted] = under
    beside = np.flatnonzero(road > -pixel)
    if len(beside):
        at, size = road[beside], pixel[beside]
        spot = colour[beside]
        blend(spot, albedo["kerb"], 1.0 - cover(at, size))
        blend(spot, albedo["pavement"], 1.0 - cover(at - np.float32(pattern["kerb_m"]), size))
        joints = _joints(east[beside], north[beside], pattern["slab_m"], size)
        spot *= 1.0 - 0.25 * (joints * (at > pattern["kerb_m"]))[:, None]
        verge = 1.0 - cover(at - np.float32(pattern["pavement_m"]), size + np.float32(0.1))
        blend(spot, albedo["verge"] * (1.0 + 0.25 * patches[beside, None]), verge)
        colour[beside] = spot
    colour *= (1.0 + np.float32(0.07) * patches + np.float32(0.10) * grain).clip(0.5, 1.6)[:, None]
    colour *= np.float32(1.0 - wetness * materials.gloss["wet_darkening"])
    coat = Coat(
        albedo=colour,
        # Puddles: water lies where the patches are low.
        mirror=np.float32(wetness * materials.gloss["water"])
        * np.clip(1.2 - 0.5 * patches, 0.2, 2.0),
        rough=np.float32(materials.gloss["wet_roughness"]) * (patches + 0.5 * grain),
        glow=np.zeros_like(colour),
    )
    return coat, layers[:, SKY]


def _joints(u: FloatRays, v: FloatRays, pitch_m: float, pixel_m: FloatRays) -> FloatRays:
    """Share of each pixel that is joint in a square grid."""
    half = np.float32(0.006)
    share = np.zeros_like(u)
    for axis in (u, v):
        away = np.abs(axis / np.float32(pitch_m) - np.rint(axis / np.float32(pitch_m)))
        distance = away * np.float32(pitch_m) - half
        # A joint narrower than a pixel darkens it by its width only.
        share += cover(distance, pixel_m) * np.minimum(2.0 * half / pixel_m, 1.0)
    return np.minimum(share, 1.0)


def coat_facade(hits: Hits, ground: GroundMap, materials: Materials, *, has_lamps: bool) -> Coat:
    """Storeys of windows over a plinth; some are lit where lamps are.

    Parameters
    ----------
    hits : Hits
        On buildings.
    ground : GroundMap
        Has the noise.
    materials : Materials
        What facades look like.
    has_lamps : bool
        Of the weather.

    Returns
    -------
    coat : Coat
        Of the hits.
    """
    along, up = _wall_coordinates(hits)
    pattern, albedo, pixel = materials.pattern, materials.albedo, hits.pixel_m
    dirt = soft_noise_at(ground.patches, along, up, texel_m=0.04)
    coat = _plain(albedo["facade"], 1.0 + 0.035 * dirt)
    blend(coat.albedo, albedo["plinth"], cover(up - 0.6, pixel))
    column = np.floor(along / np.float32(pattern["window_pitch_m"]))
    storey = np.floor(up / np.float32(pattern["storey_m"]))
    across = along - (column + np.float32(0.5)) * np.float32(pattern["window_pitch_m"])
    above = up - storey * np.float32(pattern["storey_m"])
    sill, top = pattern["window_sill_m"], pattern["window_top_m"]
    edge = np.maximum(
        np.abs(across) - np.float32(0.5 * pattern["window_width_m"]),
        np.abs(above - np.float32(0.5 * (sill + top))) - np.float32(0.5 * (top - sill)),
    )
    is_wall = np.abs(hits.normals[:, 2]) < 0.5
    away: FloatRays = np.where(is_wall, edge, np.float32(9.0)).astype(np.float32)
    blend(coat.albedo, albedo["frame"], cover(away - np.float32(0.07), pixel))
    glass: FloatRays = np.maximum(away, np.float32(0.03) - np.abs(across))
    share = cover(glass, pixel)
    blend(coat.albedo, albedo["pane"], share)
    coat.mirror[...] = share * np.float32(materials.gloss["pane"])
    if has_lamps:
        # One value of noise per window.
        chance = grain_at(ground.grain, column + 7.0 * storey, storey, np.full_like(along, _TEXELS))
        is_lit = chance > np.float32(_normal_quantile(1.0 - pattern["lit_window_share"]))
        light = materials.lit_window_colour * np.float32(pattern["lit_window_cdpm2"])
        coat.glow[...] = (share * is_lit)[:, None] * light
    return coat


def coat_wall(hits: Hits, ground: GroundMap, materials: Materials) -> Coat:
    """Concrete panels with a coping."""
    along, up = _wall_coordinates(hits)
    pitch = np.float32(materials.pattern["wall_panel_m"])
    dirt = soft_noise_at(ground.patches, along, up, texel_m=0.03)
    coat = _plain(materials.albedo["wall"], 1.0 + 0.10 * dirt)
    away = np.abs(along / pitch - np.rint(along / pitch)) * pitch - np.float32(0.012)
    thin = np.minimum(np.float32(0.024) / hits.pixel_m, 1.0)
    coat.albedo[...] *= 1.0 - 0.45 * (cover(away, hits.pixel_m) * thin)[:, None]
    is_top = (np.abs(hits.normals[:, 2]) > 0.5).astype(np.float32)
    blend(coat.albedo, materials.albedo["coping"], is_top)
    return coat


def coat_plain(hits: Hits, ground: GroundMap, albedo: FloatRays) -> Coat:
    """One colour with a little dirt: posts, plants."""
    along, up = _wall_coordinates(hits)
    return _plain(albedo, 1.0 + 0.06 * soft_noise_at(ground.patches, along, up, texel_m=0.05))


def _plain(albedo: FloatRays, factor: FloatRays) -> Coat:
    coat = blank_coat(len(factor))
    coat.albedo[...] = np.clip(factor, 0.5, 1.5)[:, None] * albedo
    return coat


def _wall_coordinates(hits: Hits) -> tuple[FloatRays, FloatRays]:
    """Along an upright face, and up."""
    normals, points = hits.normals, hits.points_m
    level: FloatRays = np.sqrt(normals[:, 0] * normals[:, 0] + normals[:, 1] * normals[:, 1])
    np.maximum(level, np.float32(1e-6), out=level)
    along: FloatRays = points[:, 1] * normals[:, 0] - points[:, 0] * normals[:, 1]
    along /= level
    return along, points[:, 2].copy()


def _normal_quantile(share: float) -> float:
    from statistics import NormalDist

    return NormalDist().inv_cdf(share)
