"""Traffic conflicts of recorded tracks, and how they are replayed.

A conflict is a pair of tracks that nearly met.

A pair is an encounter if its least time to collision is short: the two would touch that
soon if nobody changed speed or direction. It is replayed with both on their recorded
ways up to that moment and straight on from there, each at its speed of that moment:
what would have happened if nobody had reacted. A pair that only passes near is replayed
so that both are at the same time where their ways cross: the post-encroachment time is
taken out.

References
----------
.. [1] J. C. Hayward, "Near-miss determination through use of a scale of danger", 1972.
.. [2] C. Hyden, "The development of a method for traffic safety evaluation: the Swedish
   Traffic
   Conflicts Technique", 1987.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike

from geometry.actors import Actor, footprint_sizes, pick_actor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.footprints import FootprintSizes, gaps_between
from geometry.lines import along_m

from .encounters import RecordedEncounter, RecordedWay, first_contact_s
from .paths import MPS_PER_KMH
from .trajectories import VEHICLE, Track, load_trajectory_rules

_MILLIMETRES = 3


def time_to_collision_s(
    offset_m: ArrayLike,
    closing_mps: ArrayLike,
    yaw_a_deg: ArrayLike,
    yaw_b_deg: ArrayLike,
    *,
    sizes: FootprintSizes,
) -> FloatArray:
    """Time in seconds until two rectangles touch that move straight on without turning.

    0 where they touch already, infinite where they never will. `offset_m` (..., 2)
    leads from the middle of a to that of b, and changes by `closing_mps` (..., 2) a
    second. Exact: along each of the sides' four normals they overlap from one time to
    another, and they touch while they overlap along all of them.

    >>> car = {"length_a_m": 4.0, "width_a_m": 2.0}
    >>> sizes = FootprintSizes(**car, length_b_m=1.0, width_b_m=1.0)
    >>> offset_m = [12.5, 0.0]
    >>> closing_mps = [-5.0, 0.0]
    >>> found_s = time_to_collision_s(offset_m, closing_mps, 0.0, 90.0, sizes=sizes)
    >>> float(found_s.round(9))
    2.0
    """
    offset = np.asarray(offset_m, dtype=float)
    closing = np.asarray(closing_mps, dtype=float)
    yaws = [np.radians(np.asarray(yaw, dtype=float)) for yaw in (yaw_a_deg, yaw_b_deg)]
    gaps = gaps_between(offset, yaw_a_deg, yaw_b_deg, sizes=sizes)
    first = np.full(gaps.shape[1:], -np.inf)
    last = np.full(gaps.shape[1:], np.inf)
    turns = [yaw + turn for yaw in yaws for turn in (0.0, 0.5 * np.pi)]
    normals = [(np.cos(turn), np.sin(turn)) for turn in turns]
    # When the bodies begin and cease to overlap along each normal.
    for gap, (east, north) in zip(gaps, normals, strict=True):
        apart = offset[..., 0] * east + offset[..., 1] * north
        speed = closing[..., 0] * east + closing[..., 1] * north
        reach = np.abs(apart) - gap
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ends = np.stack([(-reach - apart) / speed, (reach - apart) / speed])
        still = np.where(gap <= 0.0, np.inf, -np.inf)
        first = np.maximum(first, np.where(speed == 0.0, -still, ends.min(axis=0)))
        last = np.minimum(last, np.where(speed == 0.0, still, ends.max(axis=0)))
    meets = (first <= last) & (last >= 0.0)
    return np.asarray(np.where(meets, np.maximum(first, 0.0), np.inf))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundEncounter:
    """A pair of tracks and its replay.

    Attributes
    ----------
    vehicle, vru : Track
        The two recorded tracks.
    actor : Actor
        Body that stands for the VRU.
    ttc_s : float
        Least time to collision; infinite: they are never on collision course. [s]
    gap_m : float
        Least gap between their bodies. [m]
    moment_s : float
        Moment to which the speeds belong, on the recording's clock. [s]
    vut_speed_kmh, vru_speed_kmh : float
        Speeds at that moment. [km/h]
    recorded : RecordedEncounter
        How the pair is replayed.
    """

    vehicle: Track
    vru: Track
    actor: Actor
    ttc_s: float
    gap_m: float
    moment_s: float
    vut_speed_kmh: float
    vru_speed_kmh: float
    recorded: RecordedEncounter


def find_encounters(
    tracks: Sequence[Track], *, ttc_s: float | None, within_m: float | None = None
) -> tuple[tuple[FoundEncounter, ...], Counter[str]]:
    """Pairs of a vehicle and a VRU that come near one another.

    The second result says why others are left out.

    `tracks` are on one clock, in one frame. Pairs count whose least time to collision
    is at most `ttc_s`, and others whose bodies come at most so near, `within_m`.
    Returned by vehicle, then by VRU, in the order of `tracks`; and how many cannot be
    replayed, by reasons.

    Bodies are the VUT's and those of ``geometry/data/actors.toml``, turned the way in
    which they move. The least time to collision is looked for while the vehicle drives
    forwards, and until the bodies first touch: those who walk beside a car are thinner
    than these boxes.
    """
    bodies = load_trajectory_rules().bodies
    found = []
    left_out = Counter[str]()
    for vehicle in tracks:
        for vru in tracks:
            if vehicle.class_name != VEHICLE or vru.class_name not in bodies:
                continue
            actor = pick_actor(bodies[vru.class_name], "bodies")
            one = _replay(vehicle, vru, actor, ttc_s, within_m)
            if isinstance(one, FoundEncounter):
                found.append(one)
            elif one:
                left_out[one] += 1
    return tuple(found), left_out


def _replay(
    vehicle: Track,
    vru: Track,
    actor: Actor,
    ttc_limit_s: float | None,
    within_m: float | None,
) -> FoundEncounter | str:
    """The encounter of a pair, or why it is left out.

    The reason is empty where the pair does not come near.
    """
    rules = load_trajectory_rules().encounters
    vut = pick_actor("vut", "vut")
    is_common = (vehicle.time_s >= vru.time_s[0]) & (vehicle.time_s <= vru.time_s[-1])
    time = vehicle.time_s[is_common]
    if len(time) == 0:
        return ""
    sizes = footprint_sizes(vut, actor)
    offset = vru.at(time) - vehicle.at(time)
    speeds = [np.hypot(*track.velocity_mps(time).T) for track in (vehicle, vru)]
    yaws = [_yaw_deg(track, time) for track in (vehicle, vru)]
    gap = gaps_between(offset, *yaws, sizes=sizes).max(axis=0)
    untouched = np.logical_and.accumulate(gap > 0.0)
    counts = (
        untouched
        & (speeds[0] >= rules.min_vut_mps)
        & _is_forward(vehicle, time, yaws[0])
    )
    if not counts.any():
        return ""
    closing = vru.velocity_mps(time) - vehicle.velocity_mps(time)
    # Only moments count at which the vehicle drives forwards and nobody has been hit.
    ttc = np.where(
        counts, time_to_collision_s(offset, closing, *yaws, sizes=sizes), np.inf
    )
    at = int(ttc.argmin())
    least_m = float(gap[counts].min())
    if ttc_limit_s is not None and ttc[at] <= ttc_limit_s:
        moments = (time[at], time[at])
        ends_s = (-float(ttc[at]),) * 2
    elif within_m is not None and least_m <= within_m:
        crossing = _crossing_s(vehicle, vru, time)
        if crossing is None:
            return "their ways do not cross"
        speed_mps = _speed(vehicle, crossing[0])
        if speed_mps < rules.min_vut_mps:
            return "the car is slower than walking where their ways cross"
        # The VUT's front and the middle of the VRU are there together.
        moments = crossing
        ends_s = (0.5 * vut.length_m / speed_mps, 0.0)
    else:
        return ""
    seen_s = min(moments) - float(time[0])
    ways = []
    own = []
    for track, moment, end_s in zip((vehicle, vru), moments, ends_s, strict=True):
        ways.append(_way(track, moment, float(time[0]), end_s))
        own.append(round(_speed(track, moment) / MPS_PER_KMH, 1))
    if own[1] * MPS_PER_KMH < rules.min_vru_mps:
        own[1] = 0.0
    known_s = min(seen_s + max(0.0, -ends_s[0]), rules.max_known_s)
    if known_s < rules.min_known_s:
        return f"both are recorded for less than {rules.min_known_s:g} s before"
    recorded = RecordedEncounter(
        vut=ways[0], vru=ways[1], known_s=round(known_s, _MILLIMETRES)
    )
    driven = recorded.as_recorded(
        vut=vut,
        vut_speed_mps=own[0] * MPS_PER_KMH,
        vru=actor,
        vru_speed_mps=own[1] * MPS_PER_KMH,
    )
    # At constant speeds the contact may come a little early or late.
    early_s = first_contact_s(driven)
    if not abs(early_s) <= rules.min_known_s:
        return "at the speeds of that moment they would not meet there"
    shifted = [replace(way, end_s=round(way.end_s - early_s, 6)) for way in ways]
    return FoundEncounter(
        vehicle=vehicle,
        vru=vru,
        actor=actor,
        ttc_s=float(ttc[at]),
        gap_m=least_m,
        moment_s=float(moments[0]),
        vut_speed_kmh=own[0],
        vru_speed_kmh=own[1],
        recorded=replace(recorded, vut=shifted[0], vru=shifted[1]),
    )


def _speed(track: Track, moment_s: float) -> float:
    """Speed of a track at a moment, in m/s."""
    return float(np.hypot(*track.velocity_mps(np.array(moment_s))))


def _yaw_deg(track: Track, time_s: FloatArray) -> FloatArray:
    """Directions of motion; of who stands, the last one, or else the first one.

    Of who never moves, the file's headings; 0 where it has none.
    """
    east, north = track.velocity_mps(time_s).T
    yaw = np.degrees(np.arctan2(north, east))
    moves = np.hypot(east, north) >= load_trajectory_rules().encounters.min_vru_mps
    if not moves.any():
        return np.nan_to_num(track.yaw_deg[np.searchsorted(track.time_s, time_s)])
    last = np.maximum.accumulate(np.where(moves, np.arange(len(yaw)), -1))
    return np.asarray(yaw[np.where(last < 0, int(moves.argmax()), last)])


def _is_forward(vehicle: Track, time_s: FloatArray, yaw_deg: FloatArray) -> BoolArray:
    """False while a vehicle whose heading is known reverses."""
    index = np.searchsorted(vehicle.time_s, time_s)
    off: FloatArray = np.radians(vehicle.yaw_deg[index] - yaw_deg)
    return ~(np.cos(off) < 0.0)


def _crossing_s(a: Track, b: Track, time_s: FloatArray) -> tuple[float, float] | None:
    """When each is where their ways cross, there where these times are least apart."""
    ways = [track.at(time_s) for track in (a, b)]
    lines = [shapely.LineString(way) for way in ways]
    points = shapely.get_coordinates(shapely.intersection(*lines))
    if not len(points):
        return None
    at_m = [line.project(shapely.points(points)) for line in lines]
    pairs = zip(at_m, map(along_m, ways), strict=True)
    passed = np.array([np.interp(at, along, time_s) for at, along in pairs])
    first, second = passed[:, np.abs(passed[0] - passed[1]).argmin()].tolist()
    return first, second


def _way(track: Track, moment_s: float, first_s: float, end_s: float) -> RecordedWay:
    """A track's way up to a moment.

    Its points are so far apart that swaying does not count.
    """
    rules = load_trajectory_rules().encounters
    first_s = max(first_s, moment_s - rules.max_known_s)
    time = track.time_s[(track.time_s >= first_s) & (track.time_s < moment_s)]
    end = track.at(np.array(moment_s))
    yaw_deg = float(_yaw_deg(track, np.append(time, moment_s))[-1])
    points = [end]
    # Backwards from the moment: its place is part of the way in any case.
    for point in track.at(time)[::-1]:
        if np.hypot(*(point - points[-1])) >= rules.way_step_m:
            points.append(point)
    if len(points) == 1:
        ahead = np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))])
        points.append(end - rules.way_step_m * ahead)
    rounded = np.round(points[::-1], _MILLIMETRES).tolist()
    points_m = tuple((east, north) for east, north in rounded)
    return RecordedWay(
        points_m=points_m, yaw_deg=round(yaw_deg, _MILLIMETRES), end_s=end_s
    )


def cases_text(found: Sequence[FoundEncounter], *, name: str, source: str) -> str:
    """Encounters as a TOML file of cases.

    Each is a case of kind "recorded" with the name NAME-VEHICLE-VRU, once.

    Raises
    ------
    InputError
        A name occurs twice.
    """
    import tomlkit

    table: dict[str, Any] = {}
    for one in found:
        case = re.sub(r"[^\w.-]", "_", f"{name}-{one.vehicle.id}-{one.vru.id}")
        if case in table:
            raise InputError(
                "ids", case, "every vehicle and every road user once in all files"
            )
        near = f"time to collision {one.ttc_s:.2f} s"
        if not np.isfinite(one.ttc_s):
            near = f"{one.gap_m:.2f} m apart"
        table[case] = {
            "kind": "recorded",
            "title": f"{one.vru.class_name} recorded at {one.moment_s:.2f} s, {near}",
            "source": source,
            "vru": one.actor.name,
            "vut_speed_kmh": one.vut_speed_kmh,
            "vru_speed_kmh": one.vru_speed_kmh,
            "known_s": one.recorded.known_s,
            "vut_way": asdict(one.recorded.vut),
            "vru_way": asdict(one.recorded.vru),
        }
    return tomlkit.dumps(table)
