"""Look of surfaces: albedo, gloss and patterns of ground, houses and bodies."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, float_array
from geometry.errors import InputError
from geometry.raycast import FloatRays
from geometry.tables import read_table
from geometry.text_formats import load_data

from .ground import PAINT, ROAD, SKY, GroundMap, grain_at, soft_noise_at
from .mesh import Index, PictureThing

_WHERE = "materials.toml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Materials:
    """Albedos, paints and patterns of ``data/materials.toml``.

    Colours are linear red, green, blue.

    Attributes
    ----------
    albedo : mapping of str to (3,) float32
        Share of light that each surface sends back.
    clothes : mapping of str to (2, 3) float32
        Albedo of top and legs of each body.
    vut_paint, car_paint : (3,) float32
        Albedo of the VUT, and of the car that it meets.
    parked_paints : (n, 3) float32
        Albedos that parked vehicles take in turn.
    markings, pattern, gloss : mapping of str to float
        Tables of the file.
    lit_window_colour : (3,) float32
        Colour of windows with light behind them.
    """

    albedo: Mapping[str, FloatRays]
    clothes: Mapping[str, FloatRays]
    vut_paint: FloatRays
    car_paint: FloatRays
    parked_paints: FloatRays
    markings: Mapping[str, float]
    pattern: Mapping[str, float]
    gloss: Mapping[str, float]
    lit_window_colour: FloatRays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hits:
    """Points at which rays have met triangles.

    Attributes
    ----------
    points_m : (n, 3) float32
        World frame. [m]
    normals : (n, 3) float32
        Unit normals, on the side from which the ray came.
    thing : (n,) int32
        Index of the thing.
    pixel_m : (n,) float32
        Size of a pixel on the surface, the mean of its two sides. [m]
    """

    points_m: FloatRays
    normals: FloatRays
    thing: Index
    pixel_m: FloatRays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coat:
    """Albedo and gloss of surfaces; written to in parts.

    Attributes
    ----------
    albedo : (n, 3) float32
        Share sent back evenly in all directions.
    mirror : (n,) float32
        Share mirrored head-on; 0 is dull.
    rough : (n,) float32
        How much a mirrored ray of unit length is bent up or down.
    glow : (n, 3) float32
        Luminance of its own. [cd/m^2]
    """

    albedo: FloatRays
    mirror: FloatRays
    rough: FloatRays
    glow: FloatRays


def blank_coat(n_hits: int) -> Coat:
    """A black, dull, dark coat."""
    return Coat(
        albedo=np.zeros((n_hits, 3), dtype=np.float32),
        mirror=np.zeros(n_hits, dtype=np.float32),
        rough=np.zeros(n_hits, dtype=np.float32),
        glow=np.zeros((n_hits, 3), dtype=np.float32),
    )


def cover(distance_m: FloatRays, pixel_m: FloatRays) -> FloatRays:
    """Share of each pixel that lies inside an edge.

    Parameters
    ----------
    distance_m : (n,) float32
        From the edge to the middle of the pixel, negative inside. [m]
    pixel_m : (n,) float32
        Size of the pixel. [m]

    Returns
    -------
    share : (n,) float32
        0 to 1.
    """
    return np.asarray(np.clip(np.float32(0.5) - distance_m / pixel_m, 0.0, 1.0))


def blend(under: FloatRays, over: FloatRays, share: FloatRays) -> None:
    """Lay a colour over others, in place.

    Parameters
    ----------
    under : (n, 3) float32
        Colours below; written.
    over : (3,) or (n, 3) float32
        Colour on top.
    share : (n,) float32
        How much of it is laid on.
    """
    under += share[:, None] * (over - under)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Things:
    """Things as arrays, one row each.

    Attributes
    ----------
    middle_m : (n, 3) float32
        Foot of the middle, world frame. [m]
    size_m : (n, 3) float32
        Length, width, height. [m]
    ahead : (n, 2) float32
        Cosine and sine of the yaw.
    axles_m : (n, 2) float32
        Front and rear axle of vehicles, ahead of the middle. [m]
    colours : (n, 2, 3) float32
        Albedo of top and legs, or twice the paint.
    mean_albedo : (n, 3) float32
        Albedo as seen in a blurred mirror.
    """

    middle_m: FloatRays
    size_m: FloatRays
    ahead: FloatRays
    axles_m: FloatRays
    colours: FloatRays
    mean_albedo: FloatRays


def build_things(things: tuple[PictureThing, ...], materials: Materials) -> Things:
    """Lay things out as arrays; parked vehicles take the paints in turn."""
    yaw = np.radians([thing.pose.yaw_deg for thing in things])
    colours = np.stack(
        [_colours(n, thing, materials) for n, thing in enumerate(things)]
    )
    return Things(
        middle_m=np.array(
            [thing.pose.position_m for thing in things], dtype=np.float32
        ),
        size_m=np.array([thing.size_m for thing in things], dtype=np.float32),
        ahead=np.stack([np.cos(yaw), np.sin(yaw)], axis=1).astype(np.float32),
        axles_m=np.array([_axles(thing) for thing in things], dtype=np.float32),
        colours=colours,
        mean_albedo=colours.mean(axis=1),
    )


def _axles(thing: PictureThing) -> tuple[float, float]:
    """Front and rear axle of a thing, ahead of its middle, in metres.

    Of things without a wheelbase each is 0.3 of the length from the middle.
    """
    actor = thing.actor
    if actor is not None and actor.wheelbase_m > 0.0:
        front_m = actor.front_axle_ahead_m
        return front_m, front_m - actor.wheelbase_m
    length_m = float(thing.size_m[0])
    return 0.3 * length_m, -0.3 * length_m


def _colours(number: int, thing: PictureThing, materials: Materials) -> FloatRays:
    """Albedo of top and legs of a thing, (2, 3); twice the same if it has one colour.

    Parameters
    ----------
    number : int
        The thing's number, by which parked vehicles take the paints in turn.
    """
    kind = thing.class_name
    if thing.name == "vut":
        return np.stack([materials.vut_paint] * 2)
    if kind == "car":
        return np.stack([materials.car_paint] * 2)
    if kind in ("parked vehicle", "vehicle"):
        paint = materials.parked_paints[number % len(materials.parked_paints)]
        return np.stack([paint] * 2)
    if kind in ("pedestrian", "cyclist", "motorcyclist"):
        # Clothes of this very actor, or else of anyone of its class.
        fallback = kind
        if kind == "pedestrian":
            fallback = "adult"
        name = ""
        if thing.actor is not None:
            name = thing.actor.name
        return materials.clothes.get(name, materials.clothes[fallback])
    surface = {"ground": "asphalt", "building": "facade"}.get(kind, kind)
    albedo = materials.albedo[surface.replace(" ", "-")]
    return np.stack([albedo] * 2)


@cache
def load_materials() -> Materials:
    """Materials of ``data/materials.toml``.

    Raises
    ------
    InputError
        An albedo is not a share, 0 to 1.
    """
    table = load_data(__package__, _WHERE)
    paints = table["paints"]
    pattern = dict(table["pattern"])
    colour = pattern.pop("lit_window_colour")
    albedo = {
        name: _albedo(entry["albedo"], (3,), name)
        for name, entry in table["surfaces"].items()
    }
    clothes = {}
    for name, entry in table["clothes"].items():
        top_and_legs = [entry["top"], entry["legs"]]
        clothes[name] = _albedo(top_and_legs, (2, 3), f"clothes.{name}")
    return Materials(
        albedo=albedo,
        clothes=clothes,
        vut_paint=_albedo(paints["vut"], (3,), "paints.vut"),
        car_paint=_albedo(paints["car"], (3,), "paints.car"),
        parked_paints=_albedo(paints["parked"], (-1, 3), "paints.parked"),
        markings=read_table(table["markings"], dict[str, float], f"{_WHERE}: markings"),
        pattern=read_table(pattern, dict[str, float], f"{_WHERE}: pattern"),
        gloss=read_table(table["gloss"], dict[str, float], f"{_WHERE}: gloss"),
        lit_window_colour=_albedo(colour, (3,), "pattern.lit_window_colour"),
    )


def vary_materials(materials: Materials, rng: np.random.Generator) -> Materials:
    """Materials with clothes, skins, paints and facades drawn at random.

    Clothes and paints have any hue, little colour as often as much, and a lightness
    from black to white. Hair and skin run from the darkest to the lightest that
    people have. All other surfaces keep their hue and are up to a half lighter or
    darker.
    """
    lights = {name: rng.uniform(0.6, 1.5) for name in materials.albedo}
    albedo = {
        name: value * np.float32(lights[name])
        for name, value in materials.albedo.items()
    }
    skin = materials.albedo["skin"]
    hair = materials.albedo["hair"]
    albedo["skin"] = skin * np.float32(rng.uniform(0.2, 1.4))
    albedo["hair"] = hair * np.float32(np.exp(rng.uniform(-0.7, 2.2)))
    albedo["facade"] = _any_colours(1, rng)[0] * np.float32(0.6) + np.float32(0.1)
    for name in ("bicycle", "helmet", "shoes"):
        albedo[name] = _any_colours(1, rng)[0]
    return replace(
        materials,
        albedo={name: np.clip(value, 0.01, 0.9) for name, value in albedo.items()},
        clothes={name: _any_colours(2, rng) for name in materials.clothes},
        vut_paint=_any_colours(1, rng)[0],
        parked_paints=_any_colours(len(materials.parked_paints), rng),
        car_paint=_any_colours(1, rng)[0],
    )


def _any_colours(n_colours: int, rng: np.random.Generator) -> FloatRays:
    """Albedos (n, 3) of cloth and paint: from black to white, from grey to bright."""
    hue = rng.uniform(0.0, 2.0 * np.pi, (n_colours, 1)) + np.array([0.0, 2.1, 4.2])
    colour = 1.0 + rng.beta(0.7, 1.0, (n_colours, 1)) * np.cos(hue)
    light = np.exp(rng.uniform(np.log(0.02), np.log(0.7), (n_colours, 1)))
    return np.asarray(np.clip(light * colour, 0.01, 0.85).astype(np.float32))


def _albedo(values: Any, shape: tuple[int, ...], name: str) -> FloatRays:
    """Read albedos of a shape; InputError unless all are shares, 0 to 1."""
    where = f"{_WHERE}: {name}"
    array = float_array(values, shape, where).astype(np.float32)
    if not ((array >= 0.0) & (array <= 1.0)).all():
        raise InputError(where, values, "shares, 0 .. 1")
    return array


# ---------- ground, houses, walls and posts: patterns by position in the world
# Texels of the grain, coarsest and finest.
_GRAIN_PER_M = (48.0, 384.0)
# Size of the patches' texels.
_PATCH_M = 0.06
# Texels of noise per window.
_TEXELS = np.float32(2.7)


def coat_ground(
    hits: Hits, ground: GroundMap, materials: Materials, *, wetness: float
) -> tuple[Coat, FloatRays]:
    """Coat of the road plane: road, paint, kerb, pavement, grass.

    Parameters
    ----------
    hits : Hits
        n points on the ground.
    ground : GroundMap
        Distances to road and paint, skylight and noise.
    materials : Materials
        Albedos, patterns, gloss.
    wetness : float
        Of the weather, 0 to 1.

    Returns
    -------
    coat : Coat
        Of the n points.
    sky_share : (n,) float32
        Share of the skylight that reaches them.
    """
    east = np.ascontiguousarray(hits.points_m[:, 0])
    north = hits.points_m[:, 1].copy()
    layers = ground.sample(east, north)
    road = layers[:, ROAD]
    pixel = hits.pixel_m
    # About a texel per pixel; noise finer than a pixel would sparkle.
    per_m = np.clip(np.exp2(np.floor(-np.log2(pixel))), *_GRAIN_PER_M).astype(
        np.float32
    )
    grain = grain_at(ground.grain, east, north, per_m)
    # What is finer than a pixel fades.
    grain *= np.minimum(np.float32(1.0 / _GRAIN_PER_M[0]) / pixel, 1.0)
    patches = soft_noise_at(ground.patches, east, north, texel_m=_PATCH_M)
    albedo = materials.albedo
    pattern = materials.pattern
    colour = np.empty((len(east), 3), dtype=np.float32)
    colour[...] = albedo["asphalt"]
    # Paint on the road, worn in patches.
    worn = np.clip(0.5 + 0.4 * patches, 0.0, 1.0)
    wear = 1.0 - np.float32(materials.markings["wear"]) * worn
    painted = np.flatnonzero(layers[:, PAINT] < pixel)
    share = cover(layers[painted, PAINT], pixel[painted]) * wear[painted]
    under = colour[painted]
    blend(under, albedo["paint"], share)
    colour[painted] = under
    # Off the road: kerb, then pavement of slabs, then grass.
    off = np.flatnonzero(road > -pixel)
    if len(off):
        at = road[off]
        size = pixel[off]
        spot = colour[off]
        blend(spot, albedo["kerb"], 1.0 - cover(at, size))
        beyond_kerb = at - np.float32(pattern["kerb_m"])
        blend(spot, albedo["pavement"], 1.0 - cover(beyond_kerb, size))
        joints = _joints(east[off], north[off], pattern["slab_m"], size)
        spot *= 1.0 - 0.25 * (joints * (at > pattern["kerb_m"]))[:, None]
        beyond_pavement = at - np.float32(pattern["pavement_m"])
        verge = 1.0 - cover(beyond_pavement, size + np.float32(0.1))
        grass = albedo["verge"] * (1.0 + 0.25 * patches[off, None])
        blend(spot, grass, verge)
        colour[off] = spot
    # Uneven brightness everywhere; what is wet is darker.
    uneven = 1.0 + np.float32(0.07) * patches + np.float32(0.10) * grain
    colour *= uneven.clip(0.5, 1.6)[:, None]
    colour *= np.float32(1.0 - wetness * materials.gloss["wet_darkening"])
    # Puddles: water lies where the patches are low.
    water = np.clip(1.2 - 0.5 * patches, 0.2, 2.0)
    ripples = patches + 0.5 * grain
    coat = Coat(
        albedo=colour,
        mirror=np.float32(wetness * materials.gloss["water"]) * water,
        rough=np.float32(materials.gloss["wet_roughness"]) * ripples,
        glow=np.zeros_like(colour),
    )
    return coat, layers[:, SKY]


def _joints(
    u: FloatRays, v: FloatRays, pitch_m: float, pixel_m: FloatRays
) -> FloatRays:
    """Share of each pixel that is joint in a square grid.

    Parameters
    ----------
    u, v : (n,) float32
        Position on the surface. [m]
    pitch_m : float
        Side of the squares. [m]
    pixel_m : (n,) float32
        Size of the pixels. [m]
    """
    half = np.float32(0.006)
    share = np.zeros_like(u)
    for axis in (u, v):
        away = np.abs(axis / np.float32(pitch_m) - np.rint(axis / np.float32(pitch_m)))
        distance = away * np.float32(pitch_m) - half
        # A joint narrower than a pixel darkens it by its width only.
        share += cover(distance, pixel_m) * np.minimum(2.0 * half / pixel_m, 1.0)
    return np.minimum(share, 1.0)


def coat_facade(
    hits: Hits, ground: GroundMap, materials: Materials, *, has_lamps: bool
) -> Coat:
    """Coat of houses: storeys of windows over a plinth.

    With `has_lamps` some windows are lit.
    """
    along, up = _wall_coordinates(hits)
    pattern = materials.pattern
    albedo = materials.albedo
    pixel = hits.pixel_m
    dirt = soft_noise_at(ground.patches, along, up, texel_m=0.04)
    coat = _plain(albedo["facade"], 1.0 + 0.035 * dirt)
    blend(coat.albedo, albedo["plinth"], cover(up - 0.6, pixel))
    # Position in the grid of windows, from the middle of one and from its floor.
    column = np.floor(along / np.float32(pattern["window_pitch_m"]))
    storey = np.floor(up / np.float32(pattern["storey_m"]))
    across = along - (column + np.float32(0.5)) * np.float32(pattern["window_pitch_m"])
    above = up - storey * np.float32(pattern["storey_m"])
    sill = pattern["window_sill_m"]
    top = pattern["window_top_m"]
    # Distance from the edge of the window, negative inside; roofs have no windows.
    beside = np.abs(across) - np.float32(0.5 * pattern["window_width_m"])
    middle_m = np.float32(0.5 * (sill + top))
    over = np.abs(above - middle_m) - np.float32(0.5 * (top - sill))
    edge = np.maximum(beside, over)
    is_wall = np.abs(hits.normals[:, 2]) < 0.5
    away: FloatRays = np.where(is_wall, edge, np.float32(9.0)).astype(np.float32)
    blend(coat.albedo, albedo["frame"], cover(away - np.float32(0.07), pixel))
    glass: FloatRays = np.maximum(away, np.float32(0.03) - np.abs(across))
    share = cover(glass, pixel)
    blend(coat.albedo, albedo["pane"], share)
    coat.mirror[...] = share * np.float32(materials.gloss["pane"])
    if has_lamps:
        # One value of noise per window.
        texels = np.full_like(along, _TEXELS)
        chance = grain_at(ground.grain, column + 7.0 * storey, storey, texels)
        limit = NormalDist().inv_cdf(1.0 - pattern["lit_window_share"])
        is_lit = chance > np.float32(limit)
        light = materials.lit_window_colour * np.float32(pattern["lit_window_cdpm2"])
        coat.glow[...] = (share * is_lit)[:, None] * light
    return coat


def coat_wall(hits: Hits, ground: GroundMap, materials: Materials) -> Coat:
    """Coat of walls: concrete panels with a coping."""
    along, up = _wall_coordinates(hits)
    pitch = np.float32(materials.pattern["wall_panel_m"])
    dirt = soft_noise_at(ground.patches, along, up, texel_m=0.03)
    coat = _plain(materials.albedo["wall"], 1.0 + 0.10 * dirt)
    # Joints between the panels, fainter where they are narrower than a pixel.
    away = np.abs(along / pitch - np.rint(along / pitch)) * pitch - np.float32(0.012)
    thin = np.minimum(np.float32(0.024) / hits.pixel_m, 1.0)
    coat.albedo[...] *= 1.0 - 0.45 * (cover(away, hits.pixel_m) * thin)[:, None]
    is_top = (np.abs(hits.normals[:, 2]) > 0.5).astype(np.float32)
    blend(coat.albedo, materials.albedo["coping"], is_top)
    return coat


def coat_plain(hits: Hits, ground: GroundMap, albedo: FloatRays) -> Coat:
    """Coat of posts and plants: one colour with a little dirt."""
    along, up = _wall_coordinates(hits)
    dirt = soft_noise_at(ground.patches, along, up, texel_m=0.05)
    return _plain(albedo, 1.0 + 0.06 * dirt)


def _plain(albedo: FloatRays, factor: FloatRays) -> Coat:
    """A dull coat of one colour times a factor (n,), clipped to 0.5 to 1.5."""
    coat = blank_coat(len(factor))
    coat.albedo[...] = np.clip(factor, 0.5, 1.5)[:, None] * albedo
    return coat


def _wall_coordinates(hits: Hits) -> tuple[FloatRays, FloatRays]:
    """Coordinates along an upright face, and up, (n,) each, in metres."""
    normals = hits.normals
    points = hits.points_m
    level: FloatRays = np.sqrt(
        normals[:, 0] * normals[:, 0] + normals[:, 1] * normals[:, 1]
    )
    np.maximum(level, np.float32(1e-6), out=level)
    along: FloatRays = points[:, 1] * normals[:, 0] - points[:, 0] * normals[:, 1]
    along /= level
    return along, points[:, 2].copy()


# ---------- vehicles and people: colours by position in their own frames
# Radius of ordinary tyres.
_WHEEL_M = 0.335
_RIM_SHARE = 0.60


def coat_vehicle(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Coat of vehicles: lacquer, glass, wheels, lamps, plates.

    Parts are found by the position in the vehicle's own frame, most of them by
    shares of its length, width and height.
    """
    x, y, z, facing = _into_body(hits, things)
    length, width, height = things.size_m[hits.thing].T
    side = np.abs(y)
    front = facing[:, 0] > 0.3
    rear = facing[:, 0] < -0.3
    is_upright = facing[:, 2] < 0.84
    level = z / height
    is_van = height > 1.8
    coat = _dressed(hits, things)
    coat.mirror[...] = materials.gloss["lacquer"]
    is_side = np.abs(facing[:, 1]) > 0.6
    pane_low = np.where(is_van, np.float32(0.60), np.float32(0.675))
    pane = is_upright & (level > pane_low) & (level < 0.925)
    # At the sides: pillars, and a van's closed rear; ahead and behind: a frame of
    # lacquer.
    pillar = np.abs(x + np.float32(0.06) * length) < 0.05
    closed = is_van & (x < 0.16 * length)
    pane &= np.where(is_side, ~(pillar | closed), side < 0.385 * width)
    pane &= is_side | front | (rear & ~is_van)
    # Lamps, plates and grille, by shares of the vehicle's size.
    head = (
        front
        & (x > 0.36 * length)
        & (side > 0.26 * width)
        & (level > 0.40)
        & (level < 0.50)
    )
    tail = (
        rear
        & (x < -0.4 * length)
        & (side > 0.30 * width)
        & (level > 0.47)
        & (level < 0.62)
    )
    is_dull = level < 0.155
    grille = front & (side < 0.30 * width) & (level > 0.22) & (level < 0.40)
    plate = (front | rear) & (side < 0.26) & (level > 0.27) & (level < 0.345)
    _paint(coat, materials, pane=pane, trim=is_dull | grille, plate=plate)
    _paint(coat, materials, head_lamp=head, tail_lamp=tail)
    for axle in things.axles_m[hits.thing].T:
        from_hub = np.hypot(x - axle, z - np.float32(_WHEEL_M))
        is_wheel = (from_hub < _WHEEL_M + 0.012) & (side > 0.5 * width - 0.32)
        is_rim = is_wheel & (from_hub < _RIM_SHARE * _WHEEL_M)
        _paint(coat, materials, tyre=is_wheel, rim=is_rim)
        is_dull |= is_wheel
    coat.mirror[is_dull] = 0.0
    return coat


def coat_pedestrian(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Coat of pedestrians by height: shoes, trousers, top, hands, face, hair."""
    x, y, z, _ = _into_body(hits, things)
    _, width, height = things.size_m[hits.thing].T
    level = z / height
    # Arms reach down to the hips: sleeves down to the wrists, then hands.
    is_arm = (np.abs(y) > 0.36 * width) & (level > 0.34)
    coat = _dressed(hits, things, is_leg=(level < 0.50) & ~is_arm)
    is_hair = (level > 0.945) | ((level > 0.875) & (x < 0.012 * height))
    _paint(coat, materials, skin=is_arm & (level < 0.435), shoes=level < 0.045)
    _paint(coat, materials, skin=level > 0.835, hair=is_hair)
    return coat


def coat_cyclist(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Coat of cyclists: bicycle, shoes, trousers, top, hands, face, helmet.

    The limits are metres in the frame of the body, whose size is that of the target.
    """
    x, y, z, _ = _into_body(hits, things)
    side = np.abs(y)
    is_bicycle = (z < 0.86) & ((side < 0.055) | (x > 0.30))
    from_wheel = np.minimum(np.abs(x - 0.59), np.abs(x + 0.62))
    is_tyre = is_bicycle & (from_wheel < 0.37) & (side < 0.03)
    is_grip = (x > 0.30) & (z < 1.2)
    coat = _dressed(hits, things, is_leg=(z < 1.06) & (x < 0.30))
    shoes = (z < 0.32) & (side > 0.055)
    _paint(coat, materials, shoes=shoes, bicycle=is_bicycle, tyre=is_tyre)
    _paint(coat, materials, bicycle=is_grip & (z > 0.86))
    _paint(coat, materials, skin=(is_grip & (side > 0.165) & (z > 1.04)) | (z > 1.52))
    _paint(coat, materials, helmet=z > 1.695)
    return coat


def coat_motorcyclist(hits: Hits, things: Things, materials: Materials) -> Coat:
    """Coat of motorcyclists: machine, boots, trousers, jacket, gloves, helmet.

    The limits are metres in the frame of the body, whose size is that of the target.
    """
    x, y, z, facing = _into_body(hits, things)
    side = np.abs(y)
    # Legs hang outside the engine, from the seat to the foot rests.
    is_rider = ((z > 0.83) & (x < 0.28) & (x > -0.45)) | (z > 1.1)
    is_leg = (side > 0.125) & (x > -0.40) & (x < 0.22) & (z > 0.26)
    is_leg |= is_rider & (z < 0.92)
    is_machine = ~is_rider & ~is_leg
    coat = _dressed(hits, things, is_leg=is_leg)
    tank = (
        is_machine & (z > 0.62) & (z < 0.95) & (x > -0.02) & (x < 0.50) & (side < 0.19)
    )
    # Tank and tail have the colour of the motorcycle.
    is_painted = tank | (is_machine & (z > 0.70) & (z < 0.90) & (x < -0.55))
    is_rear = is_machine & (facing[:, 0] < -0.3) & (x < -0.90)
    is_head = is_machine & (x > 0.55) & (z > 0.72) & (z < 0.96)
    shoes = is_leg & (z < 0.42)
    _paint(
        coat,
        materials,
        shoes=shoes,
        trim=is_machine,
        motorcycle=is_painted,
        head_lamp=is_head,
    )
    _paint(coat, materials, tail_lamp=is_rear & (z > 0.76), plate=is_rear & (z < 0.72))
    for axle in things.axles_m[hits.thing].T:
        from_hub = np.hypot(x - axle, z - np.float32(0.307))
        is_wheel = is_machine & (from_hub < 0.325) & (side < 0.09)
        _paint(coat, materials, tyre=is_wheel, rim=is_wheel & (from_hub < 0.22))
    is_helmet = z > 1.42
    gloves = (x > 0.31) & (side > 0.25) & (z > 0.93) & (z < 1.02)
    visor = is_helmet & (z > 1.49) & (z < 1.60) & (facing[:, 0] > 0.55)
    _paint(coat, materials, shoes=gloves, helmet=is_helmet, pane=visor)
    coat.mirror[is_painted | is_helmet] = materials.gloss["lacquer"]
    return coat


def _dressed(hits: Hits, things: Things, *, is_leg: BoolArray | None = None) -> Coat:
    """A coat in the colours of things: of the top, and of legs where these are.

    Parameters
    ----------
    is_leg : (n,) bool, optional
        Hits on legs.
    """
    coat = blank_coat(len(hits.thing))
    coat.albedo[...] = things.colours[hits.thing, 0]
    if is_leg is not None:
        coat.albedo[is_leg] = things.colours[hits.thing, 1][is_leg]
    return coat


def _paint(coat: Coat, materials: Materials, **parts: BoolArray) -> None:
    """Paint masks of hits, one over the other.

    Parameters
    ----------
    **parts : (n,) bool
        Hits that get the albedo of this name.
    """
    for name, where in parts.items():
        coat.albedo[where] = materials.albedo[name.replace("_", "-")]


def _into_body(
    hits: Hits, things: Things
) -> tuple[FloatRays, FloatRays, FloatRays, FloatRays]:
    """Position and normals of hits in the frames of their things.

    Returns
    -------
    x, y, z : (n,) float32
        Ahead, left and up. [m]
    facing : (n, 3) float32
        Unit normals.
    """
    offset = hits.points_m - things.middle_m[hits.thing]
    cos, sin = things.ahead[hits.thing].T
    facing = np.empty_like(hits.normals)
    facing[:, 0] = cos * hits.normals[:, 0] + sin * hits.normals[:, 1]
    facing[:, 1] = cos * hits.normals[:, 1] - sin * hits.normals[:, 0]
    facing[:, 2] = hits.normals[:, 2]
    x = cos * offset[:, 0] + sin * offset[:, 1]
    y = cos * offset[:, 1] - sin * offset[:, 0]
    return x, y, offset[:, 2], facing
