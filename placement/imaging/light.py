"""Light on surfaces: sun, sky, street lamps and headlights, with shadows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, float_array
from geometry.files import load_toml, take, take_number
from geometry.poses import Pose, body_rotation, to_world
from geometry.raycast import FloatRays, RayCaster
from geometry.scene import Scene
from geometry.weather import Weather

from .materials import Hits

# ---------- street lamps and headlights: where they are and how much light they send in a direction


_WHERE_LAMPS = "lamps.toml"
_AHEAD_M = 0.03  # headlights shine from just before the body


class Lamp(Protocol):
    """A small source of light."""

    @property
    def position_m(self) -> FloatArray:
        """Where it is, (3,), world frame, in metres."""

    @property
    def colour(self) -> FloatArray:
        """Linear red, green, blue, (3,); luminance 1."""

    @property
    def reach_m(self) -> float:
        """Farther away, in metres, its light does not count."""

    @property
    def radius_m(self) -> float:
        """Of the lit area, in metres."""

    def intensity_cd(self, directions: FloatRays) -> FloatRays:
        """Luminous intensity.

        Parameters
        ----------
        directions : (3, n) float32
            Unit, from the lamp; rows east, north, up.

        Returns
        -------
        intensity_cd : (n,) float32
            Candela.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StreetLamp:
    """A lamp that shines straight down, evenly within a cone.

    Attributes
    ----------
    position_m, colour, reach_m, radius_m
        See :class:`Lamp`.
    flux_lm : float
        All its light. [lm]
    inner_deg, outer_deg : float
        Full intensity up to the first angle from straight down, the spill from the second on. [deg]
    spill : float
        Share of the full intensity that goes into all directions.
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
        """Intensity straight down: the flux over the solid angle of the cone and of the spill."""
        inner, outer = self._cosines
        cone = (1.0 - self.spill) * (1.0 - 0.5 * (inner + outer))
        return self.flux_lm / (2.0 * math.pi * (cone + 2.0 * self.spill))

    def intensity_cd(self, directions: FloatRays) -> FloatRays:
        """See :class:`Lamp`."""
        inner, outer = self._cosines
        share: FloatRays = (directions[2] + np.float32(outer)) * np.float32(1.0 / (outer - inner))
        np.clip(share, 0.0, 1.0, out=share)
        share *= share * (3.0 - 2.0 * share)
        share *= np.float32(self.peak_cd * (1.0 - self.spill))
        share += np.float32(self.peak_cd * self.spill)
        return share

    @property
    def _cosines(self) -> tuple[float, float]:
        return math.cos(math.radians(self.inner_deg)), math.cos(math.radians(self.outer_deg))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeadLamp:
    """A low beam.

    Attributes
    ----------
    position_m, colour, reach_m, radius_m
        See :class:`Lamp`.
    R_world_lamp : (3, 3) float
        Columns: ahead, left, up.
    beam : mapping of float
        ``[head_lamp]`` of ``data/lamps.toml``.
    """

    position_m: FloatArray
    colour: FloatArray
    reach_m: float
    radius_m: float
    R_world_lamp: FloatArray
    beam: Mapping[str, float]

    def intensity_cd(self, directions: FloatRays) -> FloatRays:
        """See :class:`Lamp`."""
        beam = self.beam
        ahead, left, up = self.R_world_lamp.T.astype(np.float32) @ directions
        is_ahead = ahead > 0.05
        right_deg = np.degrees(np.arctan2(-left, ahead))
        up_deg = np.degrees(np.arctan2(up, np.hypot(ahead, left)))
        rise_deg = np.clip(
            right_deg * np.float32(math.tan(math.radians(beam["kink_deg"]))),
            0.0,
            beam["kink_max_deg"],
        )
        below_deg = np.float32(beam["cut_off_deg"]) + rise_deg - up_deg
        share = 1.0 / (
            1.0 + np.exp(np.clip(-below_deg / np.float32(beam["softness_deg"]), -30, 30))
        )
        share *= np.exp(-np.maximum(below_deg, 0.0) / np.float32(beam["depth_deg"]))
        share *= np.exp(-0.5 * (right_deg / np.float32(beam["width_deg"])) ** 2)
        above = np.float32(beam["above_cd"])
        intensity: FloatRays = np.where(
            is_ahead, above + np.float32(beam["peak_cd"] - beam["above_cd"]) * share, np.float32(0)
        )
        return intensity


def build_street_lamps(scene: Scene) -> tuple[StreetLamp, ...]:
    """A lamp on every lamp post, on an arm towards the road.

    Parameters
    ----------
    scene : Scene
        The junction.

    Returns
    -------
    lamps : tuple of StreetLamp
        One for each site of kind "lamp post", at the top of its height range.
    """
    table, where = load_lamp_table()["street_lamp"], f"{_WHERE_LAMPS}: street_lamp"
    road = np.concatenate(
        [scene.outline_m, *(_points_along(lane.centreline_m) for lane in scene.lanes)]
    )
    lamps = []
    for site in scene.sites:
        if site.kind != "lamp post":
            continue
        foot, arm = site.position_m[:2], np.zeros(2)
        if len(road):
            to_road = road[np.argmin(np.linalg.norm(road - foot, axis=1))] - foot
            arm = to_road / max(float(np.linalg.norm(to_road)), 1e-9)
        arm_m = take_number(table, "arm_m", where)
        lamps.append(
            StreetLamp(
                position_m=np.append(foot + arm_m * arm, site.height_range_m[1]),
                colour=_colour_lamps(table, where),
                **{
                    key: take_number(table, key, where)
                    for key in ("reach_m", "radius_m", "flux_lm", "inner_deg", "outer_deg", "spill")
                },
            )
        )
    return tuple(lamps)


def build_headlights(vut: Actor, pose: Pose) -> tuple[HeadLamp, ...]:
    """The two low beams of a vehicle.

    Parameters
    ----------
    vut : Actor
        The vehicle.
    pose : Pose
        Its body frame in the world.

    Returns
    -------
    lamps : tuple of HeadLamp
        Left and right.
    """
    table, where = load_lamp_table()["head_lamp"], f"{_WHERE_LAMPS}: head_lamp"
    beam = {key: take_number(table, key, where) for key in table if key != "colour"}
    ahead_m, side_m = 0.5 * vut.length_m + _AHEAD_M, 0.5 * beam["apart_m"]
    places = to_world([[ahead_m, y, beam["height_m"]] for y in (side_m, -side_m)], pose)
    return tuple(
        HeadLamp(
            position_m=place,
            colour=_colour_lamps(table, where),
            reach_m=beam["reach_m"],
            radius_m=beam["radius_m"],
            R_world_lamp=body_rotation(pose.yaw_deg, pose.pitch_deg),
            beam=beam,
        )
        for place in places
    )


@cache
def load_lamp_table() -> dict[str, Any]:
    """``data/lamps.toml`` as it stands."""
    return load_toml(files(__package__) / "data" / _WHERE_LAMPS)


def _points_along(line: FloatArray) -> FloatArray:
    """Points every metre of a line."""
    pieces = [
        start
        + np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(end - start))))[:, None] * (end - start)
        for start, end in pairwise(line)
    ]
    return np.concatenate(pieces)


def _colour_lamps(table: Mapping[str, Any], where: str) -> FloatArray:
    colour = float_array(take(table, "colour", where), (3,), f"{where}.colour")
    unit: FloatArray = colour / (np.array([0.2126, 0.7152, 0.0722]) @ colour)
    return unit


# ---------- the sky: how bright it is where, what it gives to the ground, and what the air adds


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear red, green, blue (ITU-R BT.709)
_EXPONENT = 0.6  # of the sine of the elevation, from horizon to zenith
_WHERE = "lamps.toml: sky"
_FOG_VISIBILITY_M = 1000.0  # below it is fog (WMO-No. 407)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sky:
    """Light from above, without the sun.

    Attributes
    ----------
    horizon_cdpm2, zenith_cdpm2 : (3,) float
        Luminance by colour. [cd/m^2]
    air_cdpm2 : (3,) float
        Luminance of air without end: what distance fades into. [cd/m^2]
    sky_lux, sun_lux : (3,) float
        On level ground, and on what faces the sun. [lx]
    to_sun : (3,) float
        Unit, world frame.
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
        """Luminance of the sky as it is seen through the air.

        Parameters
        ----------
        up : (n,) float32
            Sine of the elevation.

        Returns
        -------
        luminance_cdpm2 : (n, 3) float32
            Linear red, green, blue. [cd/m^2]
        """
        sine = np.maximum(up, np.float32(1e-4))
        share = (sine ** np.float32(_EXPONENT))[:, None]
        horizon, air = self.horizon_cdpm2.astype(np.float32), self.air_cdpm2.astype(np.float32)
        bright = horizon + share * (self.zenith_cdpm2 - self.horizon_cdpm2).astype(np.float32)
        left = np.exp(np.float32(-self.extinction_per_m * self.haze_height_m) / sine)[:, None]
        seen: FloatRays = air + left * (bright - air)
        return seen

    def fade(self, luminance: FloatRays, distance_m: FloatRays) -> None:
        """What the air leaves of luminances (n, 3) after a way (n,), in place.

        References
        ----------
        .. [1] H. Koschmieder, "Theorie der horizontalen Sichtweite", 1924.
        """
        air = self.air_cdpm2.astype(np.float32)
        luminance -= air
        luminance *= np.exp(np.float32(-self.extinction_per_m) * distance_m)[:, None]
        luminance += air


def build_sky(weather: Weather) -> Sky:
    """The sky of a weather.

    Parameters
    ----------
    weather : Weather
        Sun, sky, air.

    Returns
    -------
    sky : Sky
        Scaled so that level ground gets ``weather.sky_lux``.
    """
    table = take(load_lamp_table(), "sky", "lamps.toml")
    if weather.sun_lux > 0.0:
        zenith, horizon, kind = (
            _colour(table, "clear_zenith"),
            _colour(table, "clear_horizon"),
            "clear",
        )
        horizon = horizon * take_number(table, "clear_horizon_to_zenith", _WHERE)
    elif weather.has_lamps:
        zenith, horizon, kind = (
            _colour(table, "night_zenith"),
            _colour(table, "night_horizon"),
            "clear",
        )
        horizon = horizon * take_number(table, "clear_horizon_to_zenith", _WHERE)
    else:
        zenith, kind = _colour(table, "overcast"), "overcast"
        horizon = zenith * take_number(table, "overcast_horizon_to_zenith", _WHERE)
    if weather.visibility_m < _FOG_VISIBILITY_M:
        kind = "fog"
    # Of horizon + (zenith - horizon) sin^n: the integral of its cosine over the half sphere.
    level = 2.0 * np.pi * (horizon / 2.0 + (zenith - horizon) / (2.0 + _EXPONENT))
    scale = weather.sky_lux / float(LUMINANCE @ level)
    elevation, yaw = np.radians([weather.sun_elevation_deg, weather.sun_yaw_deg])
    return Sky(
        horizon_cdpm2=scale * horizon,
        zenith_cdpm2=scale * zenith,
        air_cdpm2=scale * horizon,  # the sky at the horizon is nothing but air
        sky_lux=scale * level,
        sun_lux=weather.sun_lux * _colour(table, "sun"),
        to_sun=np.array(
            [
                np.cos(elevation) * np.cos(yaw),
                np.cos(elevation) * np.sin(yaw),
                np.sin(elevation),
            ]
        ),
        haze_height_m=take_number(
            take(table, "haze_height_m", _WHERE), kind, f"{_WHERE}.haze_height_m"
        ),
        extinction_per_m=weather.extinction_per_m,
    )


def _colour(table: Mapping[str, object], key: str) -> FloatArray:
    """A colour whose luminance is 1."""
    colour = float_array(take(table, key, _WHERE), (3,), f"{_WHERE}.{key}")
    unit: FloatArray = colour / (LUMINANCE @ colour)
    return unit


# ---------- illuminance of what rays have met


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
