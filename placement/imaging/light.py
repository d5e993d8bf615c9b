"""Light on surfaces, from sun, sky and lamps with shadows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, float_array
from geometry.poses import Pose, body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster
from geometry.scene import Scene
from geometry.tables import read_table, take, take_number
from geometry.text_formats import load_data
from geometry.weather import Weather

from .materials import Hits

# Luminance of linear red, green and blue (ITU-R BT.709).
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_FILE = "lamps.toml"
# Headlights shine from just before the body.
_AHEAD_M = 0.03


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetLamp:
    """A lamp that shines straight down, evenly within a cone.

    Attributes
    ----------
    position_m : (3,) float
        World frame. [m]
    colour : (3,) float
        Linear red, green, blue, with a luminance of 1.
    reach_m : float
        Farther away its light does not count. [m]
    radius_m : float
        Of the lit area. [m]
    flux_lm : float
        All its light. [lm]
    inner_deg : float
        Full intensity up to here from straight down. [deg]
    outer_deg : float
        Nothing but the spill from here on. [deg]
    spill : float
        Share of the full intensity that goes in all directions.
    """

    position_m: FloatArray
    colour: FloatArray
    reach_m: float
    radius_m: float
    flux_lm: float
    inner_deg: float
    outer_deg: float
    spill: float

    @property
    def peak_cd(self) -> float:
        """Intensity straight down, in candela.

        The flux over the solid angle of the cone and of the spill.
        """
        inner, outer = self._cosines
        cone = (1.0 - self.spill) * (1.0 - 0.5 * (inner + outer))
        return self.flux_lm / (2.0 * math.pi * (cone + 2.0 * self.spill))

    def intensity_cd(self, directions: FloatRays) -> FloatRays:
        """Luminous intensity along directions.

        Parameters
        ----------
        directions : (3, n) float32
            Unit vectors, world frame.

        Returns
        -------
        intensity : (n,) float32
            [cd]
        """
        inner, outer = self._cosines
        share: FloatRays = (directions[2] + np.float32(outer)) * np.float32(
            1.0 / (outer - inner)
        )
        np.clip(share, 0.0, 1.0, out=share)
        share *= share * (3.0 - 2.0 * share)
        share *= np.float32(self.peak_cd * (1.0 - self.spill))
        share += np.float32(self.peak_cd * self.spill)
        return share

    @property
    def _cosines(self) -> tuple[float, float]:
        """Cosines of the inner and the outer angle."""
        inner = math.cos(math.radians(self.inner_deg))
        outer = math.cos(math.radians(self.outer_deg))
        return inner, outer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeadLamp:
    """A low beam.

    Attributes
    ----------
    position_m, colour, reach_m, radius_m
        As of :class:`StreetLamp`.
    R_world_lamp : (3, 3) float
        Columns ahead, to the oncoming lane, up.
    beam : mapping of str to float
        ``[head_lamp]`` of ``data/lamps.toml``.
    """

    position_m: FloatArray
    colour: FloatArray
    reach_m: float
    radius_m: float
    R_world_lamp: FloatArray
    beam: Mapping[str, float]

    def intensity_cd(self, directions: FloatRays) -> FloatRays:
        """Luminous intensity along directions; see :meth:`StreetLamp.intensity_cd`.

        Below the cut-off, which rises towards the kerb, the intensity falls off
        with the angle down and to either side.
        """
        beam = self.beam
        ahead, aside, up = self.R_world_lamp.T.astype(np.float32) @ directions
        is_ahead = ahead > 0.05
        to_kerb_deg = np.degrees(np.arctan2(-aside, ahead))
        up_deg = np.degrees(np.arctan2(up, np.hypot(ahead, aside)))
        rise_deg = np.clip(
            to_kerb_deg * np.float32(math.tan(math.radians(beam["kink_deg"]))),
            0.0,
            beam["kink_max_deg"],
        )
        below_deg = np.float32(beam["cut_off_deg"]) + rise_deg - up_deg
        # A soft cut-off, then what falls off downwards and to either side.
        above_soft = np.clip(-below_deg / np.float32(beam["softness_deg"]), -30, 30)
        share = 1.0 / (1.0 + np.exp(above_soft))
        share *= np.exp(-np.maximum(below_deg, 0.0) / np.float32(beam["depth_deg"]))
        share *= np.exp(-0.5 * (to_kerb_deg / np.float32(beam["width_deg"])) ** 2)
        above = np.float32(beam["above_cd"])
        intensity = above + np.float32(beam["peak_cd"] - beam["above_cd"]) * share
        return np.where(is_ahead, intensity, np.float32(0))


Lamp = StreetLamp | HeadLamp


def build_street_lamps(scene: Scene) -> tuple[StreetLamp, ...]:
    """Lamps on arms towards the road, one at every site of kind "lamp post"."""
    numbers, colour = _read_lamp("street_lamp")
    arm_m = numbers.pop("arm_m")
    road = np.concatenate(
        [scene.outline_m, *(_points_along(lane.centreline_m) for lane in scene.lanes)]
    )
    lamps = []
    for site in scene.sites:
        if site.kind != "lamp post":
            continue
        foot = site.position_m[:2]
        arm = np.zeros(2)
        if len(road):
            to_road = road[np.argmin(np.linalg.norm(road - foot, axis=1))] - foot
            arm = to_road / max(float(np.linalg.norm(to_road)), 1e-9)
        lamps.append(
            StreetLamp(
                position_m=np.append(foot + arm_m * arm, site.height_range_m[1]),
                colour=colour,
                **numbers,
            )
        )
    return tuple(lamps)


def build_headlights(
    vut: Actor, pose: Pose, *, keeps_left: bool
) -> tuple[HeadLamp, ...]:
    """The two low beams of a vehicle, left and right.

    Parameters
    ----------
    vut : Actor
        The vehicle.
    pose : Pose
        Of its body frame.
    keeps_left : bool
        Traffic keeps left. The beams reach farther along the kerb, which is on the
        side that traffic keeps.
    """
    beam, colour = _read_lamp("head_lamp")
    ahead_m = 0.5 * vut.length_m + _AHEAD_M
    side_m = 0.5 * beam["apart_m"]
    places = to_world([[ahead_m, y, beam["height_m"]] for y in (side_m, -side_m)], pose)
    # The oncoming lane is on the left where traffic keeps right.
    side = 1.0
    if keeps_left:
        side = -1.0
    to_oncoming = np.array([1.0, side, 1.0])
    return tuple(
        HeadLamp(
            position_m=place,
            colour=colour,
            reach_m=beam["reach_m"],
            radius_m=beam["radius_m"],
            R_world_lamp=body_rotation(pose.yaw_deg, pose.pitch_deg) * to_oncoming,
            beam=beam,
        )
        for place in places
    )


@cache
def load_lamp_table() -> dict[str, Any]:
    """Tables of ``data/lamps.toml``."""
    return load_data(__package__, _FILE)


def _points_along(line: FloatArray) -> FloatArray:
    """Points of a line (n, 2), about a metre apart."""
    pieces = []
    for start, end in pairwise(line):
        n_points = max(2, int(np.linalg.norm(end - start)))
        shares = np.linspace(0.0, 1.0, n_points)
        pieces.append(start + shares[:, None] * (end - start))
    return np.concatenate(pieces)


def _read_lamp(name: str) -> tuple[dict[str, float], FloatArray]:
    """Numbers and colour (3,) of a lamp of ``data/lamps.toml``."""
    table = dict(load_lamp_table()[name])
    colour = _colour(table, "colour", f"{_FILE}: {name}")
    del table["colour"]
    return read_table(table, dict[str, float], f"{_FILE}: {name}"), colour


def _colour(table: Mapping[str, object], key: str, where: str) -> FloatArray:
    """A colour (3,), scaled to a luminance of 1."""
    colour = float_array(take(table, key, where), (3,), f"{where}.{key}")
    return colour / (LUMINANCE @ colour)


# ---------- the sky and the air
# Exponent of the sine of the elevation, from horizon to zenith.
_EXPONENT = 0.6
_SKY = f"{_FILE}: sky"
# A lower visibility is fog (WMO-No. 407).
_FOG_VISIBILITY_M = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Light from above, without the sun, and the air.

    Colours are linear red, green, blue.

    Attributes
    ----------
    horizon_cdpm2, zenith_cdpm2 : (3,) float
        Luminance of the sky. [cd/m^2]
    air_cdpm2 : (3,) float
        Luminance of endless air, into which distant things fade. [cd/m^2]
    sky_lux : (3,) float
        Light of the sky on level ground. [lx]
    sun_lux : (3,) float
        Light of the sun on a surface that faces it. [lx]
    to_sun : (3,) float
        Unit vector, world frame.
    haze_height_m : float
        Depth of the layer of air that takes the contrast. [m]
    extinction_per_m : float
        Of the air. [1/m]
    """

    horizon_cdpm2: FloatArray
    zenith_cdpm2: FloatArray
    air_cdpm2: FloatArray
    sky_lux: FloatArray
    sun_lux: FloatArray
    to_sun: FloatArray
    haze_height_m: float
    extinction_per_m: float

    def luminance(self, up: FloatRays) -> FloatRays:
        """Luminance of the sky as seen through the air.

        Parameters
        ----------
        up : (n,) float32
            Sine of the elevation.

        Returns
        -------
        luminance : (n, 3) float32
            [cd/m^2]
        """
        sine = np.maximum(up, np.float32(1e-4))
        share = (sine ** np.float32(_EXPONENT))[:, None]
        horizon = self.horizon_cdpm2.astype(np.float32)
        air = self.air_cdpm2.astype(np.float32)
        bright = horizon + share * (self.zenith_cdpm2 - self.horizon_cdpm2).astype(
            np.float32
        )
        left = np.exp(np.float32(-self.extinction_per_m * self.haze_height_m) / sine)[
            :, None
        ]
        return np.asarray(air + left * (bright - air))

    def fade(self, luminance: FloatRays, distance_m: FloatRays) -> None:
        """Take from luminances what the air takes, in place.

        Parameters
        ----------
        luminance : (n, 3) float32
            Written. [cd/m^2]
        distance_m : (n,) float32
            Length of the way through the air. [m]

        References
        ----------
        H. Koschmieder, "Theorie der horizontalen Sichtweite", 1924.
        """
        air = self.air_cdpm2.astype(np.float32)
        luminance -= air
        luminance *= np.exp(np.float32(-self.extinction_per_m) * distance_m)[:, None]
        luminance += air


def build_sky(weather: Weather) -> Sky:
    """The sky of a weather, scaled so that level ground gets its `sky_lux`."""
    table = load_lamp_table()["sky"]
    if weather.sun_lux > 0.0 or weather.has_lamps:
        kind = "clear"
        if weather.sun_lux > 0.0:
            hue = "clear"
        else:
            hue = "night"
        zenith = _colour(table, f"{hue}_zenith", _SKY)
        horizon = _colour(table, f"{hue}_horizon", _SKY)
        horizon = horizon * take_number(table, "clear_horizon_to_zenith", _SKY)
    else:
        kind = "overcast"
        zenith = _colour(table, "overcast", _SKY)
        horizon = zenith * take_number(table, "overcast_horizon_to_zenith", _SKY)
    if weather.visibility_m < _FOG_VISIBILITY_M:
        kind = "fog"
    # Of horizon + (zenith - horizon) sin^n: the integral of its cosine over the half
    # sphere.
    level = 2.0 * np.pi * (horizon / 2.0 + (zenith - horizon) / (2.0 + _EXPONENT))
    scale = weather.sky_lux / float(LUMINANCE @ level)
    elevation, yaw = np.radians([weather.sun_elevation_deg, weather.sun_yaw_deg])
    return Sky(
        horizon_cdpm2=scale * horizon,
        zenith_cdpm2=scale * zenith,
        # The sky at the horizon is nothing but air.
        air_cdpm2=scale * horizon,
        sky_lux=scale * level,
        sun_lux=weather.sun_lux * _colour(table, "sun", _SKY),
        to_sun=np.array(
            [
                np.cos(elevation) * np.cos(yaw),
                np.cos(elevation) * np.sin(yaw),
                np.sin(elevation),
            ]
        ),
        haze_height_m=take_number(
            table["haze_height_m"], kind, f"{_SKY}.haze_height_m"
        ),
        extinction_per_m=weather.extinction_per_m,
    )


# ---------- light on surfaces
# How far off a surface rays towards the light start.
_OFF_SURFACE_M = 4.0e-3
# Farther things throw no shadow.
_SUN_WAY_M = 500.0
# Lamps that give less than this of a point's light throw no shadow there.
_SHADOW_SHARE = 0.08


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
    """Light that falls on surfaces, by sun, sky and lamps.

    Parameters
    ----------
    hits : Hits
        n points on surfaces.
    caster : RayCaster
        Throws the shadows.
    origin_m : (3,) float32
        Origin of the caster, world frame. [m]
    sky : Sky
        Sky and sun.
    lamps : sequence of Lamp
        Lamps that are on.
    sky_share : (n,) float32, optional
        Share of the sky that nothing occludes; by default all of it.
    ground_albedo : float
        Share of light that comes back from below.

    Returns
    -------
    lux : (n, 3) float32
        Linear red, green, blue. [lx]

    References
    ----------
    J. H. Lambert, "Photometria", 1760: the cosine, and the inverse square.
    """
    upness = hits.normals[:, 2]
    above = 0.5 + 0.5 * upness
    if sky_share is not None:
        above = above * sky_share
    lux: FloatRays = above[:, None] * sky.sky_lux.astype(np.float32)
    level = sky.sky_lux + max(float(sky.to_sun[2]), 0.0) * sky.sun_lux
    below = np.float32(ground_albedo) * (0.5 - 0.5 * upness)
    starts = _off_surfaces(hits, origin_m)
    # Light that comes back from the ground, to all that does not face straight up.
    if (level > 0.0).any() and not (upness > 0.999).all():
        lux += below[:, None] * level.astype(np.float32)
    if (sky.sun_lux > 0.0).any() and sky.to_sun[2] > 0.0:
        cosine = hits.normals @ sky.to_sun.astype(np.float32)
        facing = np.flatnonzero(cosine > 0.0)
        way = np.broadcast_to(
            (_SUN_WAY_M * sky.to_sun).astype(np.float32), (len(facing), 3)
        )
        free = facing[~caster.is_blocked(starts[facing], way)]
        lux[free] += cosine[free, None] * sky.sun_lux.astype(np.float32)
    # Lamps that drive come last: pictures of what stands still are made without them.
    for kind in (StreetLamp, HeadLamp):
        group = [lamp for lamp in lamps if isinstance(lamp, kind)]
        if group:
            _add_lamps(lux, hits, starts, caster, group, below)
    return lux


def add_headlights(
    lux: FloatRays,
    hits: Hits,
    headlights: Sequence[HeadLamp],
    *,
    caster: RayCaster,
    origin_m: FloatRays,
    ground_albedo: float,
) -> None:
    """Add the light of headlights to the light that falls on surfaces.

    Parameters
    ----------
    lux : (n, 3) float32
        Light without headlights; written. [lx]
    hits, caster, origin_m, ground_albedo
        As in :func:`illuminance`.
    headlights : sequence of HeadLamp
        Those that are on.
    """
    below = np.float32(ground_albedo) * (0.5 - 0.5 * hits.normals[:, 2])
    _add_lamps(lux, hits, _off_surfaces(hits, origin_m), caster, headlights, below)


def _off_surfaces(hits: Hits, origin_m: FloatRays) -> FloatRays:
    """Points just off surfaces, (n, 3), at which rays towards the light start.

    Relative to an origin (3,), in metres.
    """
    starts: FloatRays = hits.points_m - origin_m
    starts += np.float32(_OFF_SURFACE_M) * hits.normals
    return starts


def _add_lamps(
    lux: FloatRays,
    hits: Hits,
    starts: FloatRays,
    caster: RayCaster,
    lamps: Sequence[Lamp],
    below: FloatRays,
) -> None:
    """Add the light of lamps; shadow rays are cast only where a lamp matters.

    Parameters
    ----------
    lux : (n, 3) float32
        Written. [lx]
    hits : Hits
        n points on surfaces.
    starts : (n, 3) float32
        Where shadow rays start, in the frame of the caster. [m]
    caster : RayCaster
        Throws the shadows.
    lamps : sequence of Lamp
        Lamps that are on.
    below : (n,) float32
        Share of the light on the ground below that comes back to each point.
    """
    points = np.ascontiguousarray(hits.points_m.T)
    normals = np.ascontiguousarray(hits.normals.T)
    low = points.min(axis=1)
    high = points.max(axis=1)
    total = lux[:, 1].copy()
    direct: list[tuple[Lamp, FloatRays]] = []
    by_colour: dict[tuple[float, ...], FloatRays] = {}
    for lamp in lamps:
        position = lamp.position_m.astype(np.float32)
        if np.linalg.norm(position - np.clip(position, low, high)) > lamp.reach_m:
            continue
        away = points - position[:, None]
        square = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
        away *= 1.0 / np.sqrt(square)
        strength = lamp.intensity_cd(away)
        strength /= square
        strength *= square < np.float32(lamp.reach_m**2)
        # Light on the ground below comes back from it.
        glow = np.minimum(away[2], 0.0) * strength * below
        cosine = away[0] * normals[0] + away[1] * normals[1] + away[2] * normals[2]
        strength *= np.maximum(-cosine, 0.0)
        total += strength
        direct.append((lamp, strength))
        colour = tuple(lamp.colour.tolist())
        by_colour.setdefault(colour, np.zeros_like(total))
        by_colour[colour] -= glow
    # Shadows, only of lamps that give enough of the light of a point.
    total *= np.float32(_SHADOW_SHARE)
    for lamp, strength in direct:
        rays = np.flatnonzero(strength > total)
        way = lamp.position_m.astype(np.float32) - hits.points_m[rays]
        way *= np.float32(0.995)
        strength[rays[caster.is_blocked(starts[rays], way)]] = 0.0
        by_colour[tuple(lamp.colour.tolist())] += strength
    for colour, strength in by_colour.items():
        lux += strength[:, None] * np.array(colour, dtype=np.float32)
