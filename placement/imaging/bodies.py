"""Vehicles and people: colours by position in the body's own frame."""

import numpy as np

from geometry.raycast import FloatRays

from .materials import Coat, Hits, Materials, Things, blank_coat

_WHEEL_M = 0.335  # radius of ordinary tyres
_RIM_SHARE = 0.60


def coat_vehicle(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Lacquer, glass, wheels, lamps, plates.

    Parameters
    ----------
    hits : Hits
        On vehicles.
    things : Things
        Where they stand.
    materials : Materials
        What they look like.

    Returns
    -------
    coat : Coat
        Of the hits.
    """
    x, y, z, facing = _into_body(hits, things)
    length, width, height = things.size_m[hits.thing].T
    side = np.abs(y)
    front, rear = facing[:, 0] > 0.3, facing[:, 0] < -0.3
    is_upright, level = facing[:, 2] < 0.84, z / height
    is_van = height > 1.8
    albedo = materials.albedo
    coat = blank_coat(len(x))
    coat.albedo[...] = things.colours[hits.thing, 0]
    coat.mirror[...] = materials.gloss["lacquer"]
    is_beside = np.abs(facing[:, 1]) > 0.6
    pane_low = np.where(is_van, np.float32(0.60), np.float32(0.675))
    pane = is_upright & (level > pane_low) & (level < 0.925)
    # Beside: pillars, and a van's closed rear; ahead and behind: a frame of lacquer.
    pillar = np.abs(x + np.float32(0.06) * length) < 0.05
    closed = is_van & (x < 0.16 * length)
    pane &= np.where(is_beside, ~(pillar | closed), side < 0.385 * width)
    pane &= is_beside | front | (rear & ~is_van)
    for name, where in (
        ("pane", pane),
        ("trim", level < 0.155),
        ("trim", front & (side < 0.30 * width) & (level > 0.22) & (level < 0.40)),
        ("plate", (front | rear) & (side < 0.26) & (level > 0.27) & (level < 0.345)),
        (
            "head-lamp",
            front & (x > 0.36 * length) & (side > 0.26 * width) & (level > 0.40) & (level < 0.50),
        ),
        (
            "tail-lamp",
            rear & (x < -0.4 * length) & (side > 0.30 * width) & (level > 0.47) & (level < 0.62),
        ),
    ):
        coat.albedo[where] = albedo[name]
    is_dull = level < 0.155
    for axle in things.axles_m[hits.thing].T:
        from_hub = np.hypot(x - axle, z - np.float32(_WHEEL_M))
        is_wheel = (from_hub < _WHEEL_M + 0.012) & (side > 0.5 * width - 0.32)
        coat.albedo[is_wheel] = albedo["tyre"]
        coat.albedo[is_wheel & (from_hub < _RIM_SHARE * _WHEEL_M)] = albedo["rim"]
        is_dull |= is_wheel
    coat.mirror[is_dull] = 0.0
    return coat


def coat_pedestrian(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Shoes, trousers, top, hands, face, hair: by height."""
    x, y, z, _ = _into_body(hits, things)
    _, width, height = things.size_m[hits.thing].T
    level, albedo = z / height, materials.albedo
    coat = blank_coat(len(x))
    coat.albedo[...] = things.colours[hits.thing, 0]
    is_leg = level < 0.50
    # Arms hang beside the hips: sleeves down to the wrists, then hands.
    is_arm = (np.abs(y) > 0.36 * width) & (level > 0.34)
    coat.albedo[is_leg & ~is_arm] = things.colours[hits.thing, 1][is_leg & ~is_arm]
    coat.albedo[is_arm & (level < 0.435)] = albedo["skin"]
    coat.albedo[level < 0.045] = albedo["shoes"]
    coat.albedo[level > 0.835] = albedo["skin"]
    is_hair = (level > 0.945) | ((level > 0.875) & (x < 0.012 * height))
    coat.albedo[is_hair] = albedo["hair"]
    return coat


def coat_cyclist(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Bicycle, shoes, trousers, top, hands, face, helmet."""
    x, y, z, _ = _into_body(hits, things)
    side, albedo = np.abs(y), materials.albedo
    is_bicycle = (z < 0.86) & ((side < 0.055) | (x > 0.30))
    is_tyre = is_bicycle & (np.minimum(np.abs(x - 0.59), np.abs(x + 0.62)) < 0.37) & (side < 0.03)
    coat = blank_coat(len(x))
    coat.albedo[...] = things.colours[hits.thing, 0]
    is_leg = (z < 1.06) & (x < 0.30)
    coat.albedo[is_leg] = things.colours[hits.thing, 1][is_leg]
    coat.albedo[(z < 0.32) & (side > 0.055)] = albedo["shoes"]
    coat.albedo[is_bicycle] = albedo["bicycle"]
    coat.albedo[is_tyre] = albedo["tyre"]
    coat.albedo[(x > 0.30) & (z > 0.86) & (z < 1.2)] = albedo["bicycle"]
    coat.albedo[(x > 0.30) & (side > 0.165) & (z > 1.04) & (z < 1.2)] = albedo["skin"]
    coat.albedo[z > 1.52] = albedo["skin"]
    coat.albedo[z > 1.695] = albedo["helmet"]
    return coat


def _into_body(hits: Hits, things: Things) -> tuple[FloatRays, FloatRays, FloatRays, FloatRays]:
    """Ahead, left and up in the body's frame, and the normals there."""
    offset = hits.points_m - things.middle_m[hits.thing]
    cos, sin = things.ahead[hits.thing].T
    facing = np.empty_like(hits.normals)
    facing[:, 0] = cos * hits.normals[:, 0] + sin * hits.normals[:, 1]
    facing[:, 1] = cos * hits.normals[:, 1] - sin * hits.normals[:, 0]
    facing[:, 2] = hits.normals[:, 2]
    x = cos * offset[:, 0] + sin * offset[:, 1]
    y = cos * offset[:, 1] - sin * offset[:, 0]
    return x, y, offset[:, 2], facing
