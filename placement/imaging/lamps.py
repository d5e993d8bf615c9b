"""Street lamps and headlights: where they are and how much light they send in a direction."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, float_array
from geometry.poses import Pose, body_rotation, to_world
from geometry.raycast import FloatRays
from geometry.scene import Scene
from geometry.toml_files import load_toml, take, take_number

_WHERE = "lamps.toml"
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
    table, where = load_lamp_table()["street_lamp"], f"{_WHERE}: street_lamp"
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
                colour=_colour(table, where),
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
    table, where = load_lamp_table()["head_lamp"], f"{_WHERE}: head_lamp"
    beam = {key: take_number(table, key, where) for key in table if key != "colour"}
    ahead_m, side_m = 0.5 * vut.length_m + _AHEAD_M, 0.5 * beam["apart_m"]
    places = to_world([[ahead_m, y, beam["height_m"]] for y in (side_m, -side_m)], pose)
    return tuple(
        HeadLamp(
            position_m=place,
            colour=_colour(table, where),
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
    return load_toml(files(__package__) / "data" / _WHERE)


def _points_along(line: FloatArray) -> FloatArray:
    """Points every metre of a line."""
    pieces = [
        start
        + np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(end - start))))[:, None] * (end - start)
        for start, end in pairwise(line)
    ]
    return np.concatenate(pieces)


def _colour(table: Mapping[str, Any], where: str) -> FloatArray:
    colour = float_array(take(table, "colour", where), (3,), f"{where}.colour")
    unit: FloatArray = colour / (np.array([0.2126, 0.7152, 0.0722]) @ colour)
    return unit
