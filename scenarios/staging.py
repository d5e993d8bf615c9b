"""Setting up a run: who moves how, past what, before anybody brakes.

The rules for it are here, too.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from geometry.actors import Actor, PlacedActor, footprint_sizes
from geometry.arrays import FloatArray
from geometry.footprints import gaps_between
from geometry.junction import Line
from geometry.phrases import Phrase
from geometry.poses import Pose
from geometry.tables import Table, read_table
from geometry.text_formats import load_data

from .cases import Case
from .encounters import Encounter
from .paths import MPS_PER_KMH, NORTH_TO_SOUTH, Motion, MovedPath, Path

_SCAN_STEP_M = 0.1
_NEVER_PARALLEL = 1.0e-6
_MEETS_M = 1.0e-6
_MAX_STEPS = 60
DO_NOT_MEET = Phrase("the paths of the VUT and the VRU do not meet")


class CannotCarryError(Exception):
    """A case cannot be laid on an approach; `why` says why not."""

    def __init__(self, why: Phrase) -> None:
        super().__init__(why)
        self.why = why


class NoRoadError(CannotCarryError):
    """The junction has no road for a case.

    From that approach the case is not possible at all.
    """


class NoKerbError(NoRoadError):
    """A case's parked bodies would stand where everything is driven on.

    No kerb lies next to the lane.
    """


class TooFastError(NoRoadError):
    """A way bends so sharply that nobody drives it at the speed.

    It is the VUT's way, or its target's.
    """

    def __init__(self, limit_mps2: float, allowed_kmh: int, *, is_target: bool) -> None:
        self.allowed_kmh = allowed_kmh
        why = Phrase(
            "the lanes curve: a lateral acceleration of {limit:g} m/s^2 allows"
            " {speed} km/h there",
            limit=limit_mps2,
            speed=allowed_kmh,
        )
        if is_target:
            why = Phrase(
                "the lanes curve: a lateral acceleration of {limit:g} m/s^2 allows"
                " the target {speed} km/h there",
                limit=limit_mps2,
                speed=allowed_kmh,
            )
        super().__init__(why)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Staging:
    """A run without its frames.

    Attributes
    ----------
    encounter : Encounter
        Its impact is at time 0.
    obstruction : tuple of PlacedActor
        Parked bodies, or a wall, of this run only.
    aside, back : (2,) float
        Unit vectors in which the obstruction may give way to what stands there: away
        from whom it stands beside, and away from where the ways cross; zero without
        one.
    max_aside_m : float
        How far it may be moved aside. [m]
    """

    encounter: Encounter
    obstruction: tuple[PlacedActor, ...]
    aside: FloatArray = field(default_factory=lambda: np.zeros(2))
    back: FloatArray = field(default_factory=lambda: np.zeros(2))
    max_aside_m: float = 0.0


def find_meeting(
    case: Case,
    *,
    vut: Actor,
    vut_path: Path,
    vru_line: Line,
    search_m: tuple[float, float],
) -> tuple[float, float]:
    """Distances of both bodies when they meet at the impact position.

    They are those of the VUT's and the VRU's middle.

    Along the VUT's path, and along the VRU's line from its point. Front: the VRU's
    point is `impact_percent` across the VUT's width, and the VUT's front has just
    reached the VRU's box. Side: the point is on the VUT's side. `search_m` are the
    first and the last distance along the VUT's path to look at. Raises
    CannotCarryError: the VUT's path does not lead there.
    """
    from scipy.optimize import brentq

    if case.impact_face == "side":
        gap = _gap_to_side
    else:
        gap = _gap_to_front
    distances = np.arange(search_m[0], search_m[1] + _SCAN_STEP_M, _SCAN_STEP_M)
    gaps, _ = gap(case, vut, vut_path, vru_line, distances)
    # Where the gap closes first, between two looks.
    closes = np.flatnonzero((gaps[:-1] > 0.0) & (gaps[1:] <= 0.0))
    if len(closes) == 0:
        raise CannotCarryError(DO_NOT_MEET)
    first = int(closes[0])

    def gap_at(distance_m: float) -> float:
        return float(gap(case, vut, vut_path, vru_line, np.array([distance_m]))[0][0])

    vut_distance_m = float(
        brentq(gap_at, distances[first], distances[first + 1], xtol=1.0e-10)
    )
    _, vru_distance = gap(case, vut, vut_path, vru_line, np.array([vut_distance_m]))
    return vut_distance_m, float(vru_distance[0])


def find_crossing(
    vut: Actor, vut_path: Path, vru_tangent: Callable[[float], Line], search_m: float
) -> tuple[float, float]:
    """Where a turning VUT's front axle crosses a target's way.

    Returned are the distance along the VUT's path and the station of the way.

    `vru_tangent`: the straight line that touches the target's way at a station,
    with its point there. `search_m`: the last distance along the VUT's path to look
    at.

    Raises
    ------
    CannotCarryError
        They do not cross.
    """
    from scipy.optimize import brentq

    distances = np.arange(0.0, search_m + _SCAN_STEP_M, _SCAN_STEP_M)
    station_m = 0.0
    for _ in range(_MAX_STEPS):
        line = vru_tangent(station_m)

        def left_of_it_m(distance_m: float, line: Line = line) -> float:
            return float(line.coordinates(_front_axle_m(vut, vut_path, distance_m))[1])

        # From the left of the target's way, where it meets traffic, to its right.
        left = line.coordinates(_front_axle_m(vut, vut_path, distances))[:, 1]
        crosses = np.flatnonzero((left[:-1] > 0.0) & (left[1:] <= 0.0))
        if not len(crosses):
            break
        first = int(crosses[0])
        distance_m = float(brentq(left_of_it_m, distances[first], distances[first + 1]))
        ahead_m = float(line.coordinates(_front_axle_m(vut, vut_path, distance_m))[0])
        station_m += ahead_m
        if abs(ahead_m) < _MEETS_M:
            return distance_m, station_m
    raise CannotCarryError(Phrase("the paths of the VUT and the target do not cross"))


def _front_axle_m(vut: Actor, path: Path, distance_m: ArrayLike) -> FloatArray:
    """Middle of a vehicle's front axle after distances, (..., 2)."""
    middle, yaw_deg = path.at(distance_m)
    return np.asarray(middle + vut.front_axle_ahead_m * _axes(yaw_deg)[0])


def _axes(yaw_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors ahead and to the left, (..., 2) each."""
    cosine = np.cos(np.radians(yaw_deg))
    sine = np.sin(np.radians(yaw_deg))
    return np.stack([cosine, sine], axis=-1), np.stack([-sine, cosine], axis=-1)


def impact_offset_m(case: Case, vut: Actor) -> float:
    """Where a VRU meets the VUT's front: metres to the left of the VUT's centreline."""
    return vut.width_m * (case.impact_percent - 50.0) / 100.0


def _gap_to_front(
    case: Case, vut: Actor, vut_path: Path, vru_line: Line, distance_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Separation at the impact position, and where the VRU then is.

    The VRU's point is at the impact position then.
    """
    position, yaw_deg = vut_path.at(distance_m)
    ahead, left = _axes(yaw_deg)
    across = left @ vru_line.direction
    across = np.where(np.abs(across) < _NEVER_PARALLEL, _NEVER_PARALLEL, across)
    offset = ((vru_line.point_m - position) * left).sum(axis=-1)
    along = (impact_offset_m(case, vut) - offset) / across - case.vru_reference_m
    middle = vru_line.point_m + along[:, None] * vru_line.direction
    is_ahead = ((middle - position) * ahead).sum(axis=-1)
    gaps = gaps_between(
        middle - position,
        yaw_deg,
        vru_line.yaw_deg,
        sizes=footprint_sizes(vut, case.vru),
    )
    return np.where(is_ahead > 0.0, gaps.max(axis=0), np.inf), along


def _gap_to_side(
    case: Case, vut: Actor, vut_path: Path, vru_line: Line, distance_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distance of the impact position from the VRU's line, and along it.

    The impact position is on the VUT's side.
    """
    position, yaw_deg = vut_path.at(distance_m)
    ahead, left = _axes(yaw_deg)
    ahead_m = (case.impact_percent / 100.0 - 0.5) * vut.length_m
    is_left = "far" in (case.turn, case.vru_side)
    left_m = 0.5 * vut.width_m * (1.0 if is_left else -1.0)
    coordinates = vru_line.coordinates(position + ahead_m * ahead + left_m * left)
    # Positive until the VUT gets to the line: coming from its right, if it turns left
    # next to a VRU that goes the same way, or drives straight on to one from the left.
    is_from_right = is_left == (case.vru_direction in ("same", ""))
    if is_from_right:
        gap = -coordinates[:, 1]
    else:
        gap = coordinates[:, 1]
    return gap, coordinates[:, 0] - case.vru_reference_m


# ---------- the first staging that can be driven
_BEND_STEP_M = 0.25
# Bends are taken over a metre: courses are smooth over at least two.
_BEND_STEPS = 4
_ROUND_KMH = 5


def lateral_mps2(motion: Motion, body: Actor) -> float:
    """Largest sideways acceleration up to the impact, in m/s^2.

    It is that of a vehicle's front axle.

    From a car's length before the start: its rear axle still turns into what the front
    has passed.
    """
    distance = np.arange(-body.length_m, float(motion.distance_m(0.0)), _BEND_STEP_M)
    steps = np.diff(_front_axle_m(body, motion.path, distance), axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    # Change of heading over a metre, by front axle.
    turned = np.abs(heading[_BEND_STEPS:] - heading[:-_BEND_STEPS]).max()
    return float(motion.speed_mps**2 * turned / (_BEND_STEPS * _BEND_STEP_M))


Settle = Callable[[Staging], Staging]


def first_that_fits(lays: Iterable[Callable[[], Staging]], settle: Settle) -> Staging:
    """The first of some stagings that a car can drive, settled where it has room.

    Each of `lays` returns a staging or raises CannotCarryError, `settle` makes room for
    it: where there is no kerb the next one is tried. Raises the error of the one that
    came farthest: none fits.
    """
    errors: list[CannotCarryError] = []
    for lay in lays:
        try:
            staging = lay()
            _check_bends(staging.encounter)
        except CannotCarryError as error:
            errors.append(error)
            continue
        try:
            return settle(staging)
        except NoKerbError as error:
            errors.append(error)
    no_kerb = [error for error in errors if isinstance(error, NoKerbError)]
    too_fast = [error for error in errors if isinstance(error, TooFastError)]
    if not no_kerb and too_fast:
        raise max(too_fast, key=lambda error: error.allowed_kmh)
    raise (no_kerb or errors[::-1])[0]


def _check_bends(encounter: Encounter) -> None:
    """Raise TooFastError if a vehicle cannot take a bend at its speed."""
    limit_mps2 = load_way_rules().max_lateral_mps2
    driven = [(encounter.vut_motion, encounter.vut)]
    if is_vehicle(encounter.vru):
        driven.append((encounter.vru_motion, encounter.vru))
    for motion, body in driven:
        reached_mps2 = lateral_mps2(motion, body)
        if reached_mps2 > limit_mps2:
            speed_mps = motion.speed_mps * np.sqrt(limit_mps2 / reached_mps2)
            allowed_kmh = _ROUND_KMH * int(speed_mps / MPS_PER_KMH / _ROUND_KMH)
            raise TooFastError(
                limit_mps2, allowed_kmh, is_target=body is not encounter.vut
            )


def is_vehicle(body: Actor) -> bool:
    """True if a body drives in lanes and steers an axle: a car or a motorcycle."""
    return body.wheelbase_m > 0.0


# ---------- stagings in a mirror, for traffic that keeps left
def mirror_staging(staging: Staging) -> Staging:
    """A staging in a mirror that swaps north and south.

    The bodies are no mirror images: a pedestrian sets off with the same foot, and the
    driver's side of a parked car stays.
    """
    encounter = staging.encounter

    def in_mirror(motion: Motion) -> Motion:
        return replace(motion, path=MovedPath(path=motion.path, is_mirrored=True))

    def turned_over(pose: Pose) -> Pose:
        position_m = pose.position_m * [1.0, -1.0, 1.0]
        return replace(pose, position_m=position_m, yaw_deg=-pose.yaw_deg)

    vut_motion = in_mirror(encounter.vut_motion)
    vru_motion = in_mirror(encounter.vru_motion)
    obstruction = (
        replace(one, pose=turned_over(one.pose)) for one in staging.obstruction
    )
    return replace(
        staging,
        encounter=replace(encounter, vut_motion=vut_motion, vru_motion=vru_motion),
        obstruction=tuple(obstruction),
        aside=staging.aside * NORTH_TO_SOUTH,
        back=staging.back * NORTH_TO_SOUTH,
    )


# ---------- rules where the protocol speaks of its own test track
@dataclass(frozen=True, slots=True, kw_only=True)
class WayRules:
    """Ways of the VUT and the VRU."""

    start_before_curve_s: float
    max_lane_bend_m: float
    max_lateral_mps2: float
    town_kmh: float
    max_ease_aside_m: float
    max_kerb_step_m: float
    max_skew_deg: float
    max_turn_skew_deg: float
    cyclist_inside_kerb_m: float
    ring_edge_m: float
    max_recorded_away_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstructionRules:
    """How far parked cars and walls give way.

    They give way to what stands where the protocol has them.

    Attributes
    ----------
    max_aside_m : dict[str, float]
        Largest move aside, by the kind of the obstruction. [m]
    max_nearer_m, max_back_m, step_m, max_before_m, island_m : float
        As the comments in ``data/laying.toml`` say. [m]
    max_island_skew_deg : float
        As the comments there say. [deg]
    """

    max_aside_m: dict[str, float]
    max_nearer_m: float
    max_back_m: float
    step_m: float
    max_before_m: float
    island_m: float
    max_island_skew_deg: float


@cache
def load_way_rules() -> WayRules:
    """Rules of ways."""
    return read_table(_load_table("ways"), WayRules, "laying.toml: ways")


@cache
def load_obstruction_rules() -> ObstructionRules:
    """Rules of obstructions."""
    return read_table(
        _load_table("obstructions"), ObstructionRules, "laying.toml: obstructions"
    )


def _load_table(name: str) -> Table:
    table: Table = load_data(__package__, "laying.toml")[name]
    return table
