"""Uncertainty: mounting errors, traffic, misses, lost messages, latencies; read from TOML."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, partial
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray, float_array
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, pick, take, take_list, take_number, take_text
from geometry.scene import Scene
from scenarios.cases import load_cases

from ..compute import check_whole
from ..latency import LatencyBudget, load_latency_budget
from ..question import Question
from .bodies import read_body
from .moving import MovingTraffic, load_traffic

# ---------- kinds of uncertainty


_LENGTHS = (
    "free_place_m",
    "parked_gap_m",
    "clear_of_mouth_m",
    "waiting_gap_m",
    "crosswalk_gap_m",
    "along_arm_m",
    "clearance_m",
)
_TRAFFIC = ("taken_share", "waiting_share", "following_share", *_LENGTHS)


DISTRIBUTIONS = ("gamma", "uniform")
DRAWN_PER = ("run", "sample")
SHARED_BY = ("unit", "pole")
_MAX_ANGLE_SD_DEG = 30.0
_MAX_HEIGHT_SD_M = 0.5  # a small error: the same poles, the same view
_MAX_LATENCY_S = 10.0
_MAX_BURST_FRAMES = 1000.0
_MAX_LENGTH_M = 1000.0
_MAX_FASTER_KMH = 50.0
_MAX_NEARER = 0.9
_SPEEDS = ("pedestrian_kmh", "cyclist_kmh", "motorcyclist_kmh", "car_kmh")
_WAYS = {"heading_deg": ("degrees", 45.0), "path_m": ("m", 2.0)}  # units, and the most that can be
_SUM_TOLERANCE = 1.0e-6
_UNIFORM_REACH = np.sqrt(
    3.0
)  # standard deviations from the mean of a uniform distribution to an end


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingErrors:
    """Errors of units after installation.

    Attributes
    ----------
    yaw_sd_deg, pitch_sd_deg : float
        Standard deviation, in degrees; errors are normal, cut off at three of them.
    height_sd_m : float
        Standard deviation, in metres; three values stand for a normal distribution.
    """

    yaw_sd_deg: float = 0.0
    pitch_sd_deg: float = 0.0
    height_sd_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("yaw_sd_deg", "pitch_sd_deg"):
            _check_range(self, name, _MAX_ANGLE_SD_DEG, "degrees")
        _check_range(self, "height_sd_m", _MAX_HEIGHT_SD_M, "metres")


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyJitter:
    """By how much messages take longer than the braking rule says."""

    # {"gamma", "uniform"}: of the time on top of the rule's latency; never negative
    distribution: str = "gamma"
    # mean_s, sd_s: mean and standard deviation; with a deviation of 0 it is always the mean. [s]
    mean_s: float = 0.0
    sd_s: float = 0.0
    drawn_per: str = "run"  # {"run", "sample"}: how often it is drawn
    # in place of all that: totals are drawn from it, and stand in for the rule's latency
    budget: LatencyBudget | None = None

    def __post_init__(self) -> None:
        for name, known in (("distribution", DISTRIBUTIONS), ("drawn_per", DRAWN_PER)):
            if getattr(self, name) not in known:
                raise InputError(name, getattr(self, name), "one of " + ", ".join(known))
        for name in ("mean_s", "sd_s"):
            _check_range(self, name, _MAX_LATENCY_S, "seconds")
        most = np.inf if self.distribution == "gamma" else self.mean_s / _UNIFORM_REACH
        if self.sd_s > most * (1.0 + 1.0e-9) or (self.mean_s == 0.0 and self.sd_s > 0.0):
            raise InputError(
                "sd_s", self.sd_s, f"less spread around a mean of {self.mean_s:g} s: none below 0"
            )
        if self.budget is not None and (self.mean_s, self.sd_s) != (0.0, 0.0):
            raise InputError("budget", self.budget.name, "no mean_s and sd_s beside it")

    def draw_s(self, rng: np.random.Generator, n_runs: int, *, rule_latency_s: float) -> FloatArray:
        """Draw how much longer messages take than by the rule, (n_runs,) in s.

        Negative where a budget's total is shorter than the rule's latency.
        """
        n_draws = n_runs if self.drawn_per == "run" else 1
        if self.budget is not None:
            drawn = self.budget.sample_s(rng, n_draws) - rule_latency_s
        elif self.sd_s == 0.0:
            drawn = np.full(n_draws, self.mean_s)
        elif self.distribution == "uniform":
            reach_s = _UNIFORM_REACH * self.sd_s
            low_s = max(0.0, self.mean_s - reach_s)
            drawn = rng.uniform(low_s, self.mean_s + reach_s, n_draws)
        else:
            scale_s = self.sd_s**2 / self.mean_s
            drawn = rng.gamma(self.mean_s / scale_s, scale_s, n_draws)
        return np.broadcast_to(drawn, (n_runs,)).copy()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outages:
    """How often a unit tells nothing for a whole run.

    Attributes
    ----------
    unit_share, pole_share : float
        Probability, in each run, that a unit is out of order, and that a pole is with all of its
        units. 0 .. 1
    """

    unit_share: float = 0.0
    pole_share: float = 0.0

    def __post_init__(self) -> None:
        for name in ("unit_share", "pole_share"):
            _check_range(self, name, 1.0, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class Blinding:
    """How often a camera sees nothing for a whole run: units' cameras, and the VUT's.

    Attributes
    ----------
    dirty_share : float
        Probability, in each run, that a camera is dirty. 0 .. 1
    low_sun_share : float
        Share of the runs by day with low sun, from a direction that all cameras share. 0 .. 1
    sun_below_deg : float
        Most that low sun stands above the horizon, in degrees.
    dazzled_within_deg : float
        Least angle between a camera's axis and the sun without being dazzled, in degrees.
    """

    dirty_share: float = 0.0
    low_sun_share: float = 0.0
    sun_below_deg: float = 0.0
    dazzled_within_deg: float = 0.0

    def __post_init__(self) -> None:
        for name, most, unit in (
            ("dirty_share", 1.0, ""),
            ("low_sun_share", 1.0, ""),
            ("sun_below_deg", 90.0, "degrees"),
            ("dazzled_within_deg", 180.0, "degrees"),
        ):
            _check_range(self, name, most, unit)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VehicleKind:
    """A kind of vehicle that stands at the roadside or waits on the road."""

    actor: Actor  # its body
    # parked_share, waiting_share: of all that are parked, and of all that wait: so many are of this
    # kind. 0 .. 1
    parked_share: float
    waiting_share: float

    def __post_init__(self) -> None:
        for name in ("parked_share", "waiting_share"):
            _check_range(self, name, 1.0, "")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingTraffic:
    """Vehicles that stand at random: parked along the arms, and waiting to enter the junction."""

    taken_share: float = 0.0  # probability that a place in a parking lane is taken. 0 .. 1
    # waiting_share, following_share: probability that somebody waits at the stop line of a lane;
    # then, again and again, that another one stands behind. 0 .. 1
    waiting_share: float = 0.0
    following_share: float = 0.0
    vehicles: tuple[VehicleKind, ...] = ()  # what stands there; shares of each use sum to 1
    free_place_m: float = 5.5  # length of a place that stays free. [m]
    # parked_gap_m, waiting_gap_m: from bumper to bumper. [m]
    parked_gap_m: float = 0.8
    clear_of_mouth_m: float = 5.0  # no parking nearer to the junction. [m]
    waiting_gap_m: float = 2.0
    # from the line on which pedestrians cross an arm to the first bumper that waits. [m]
    crosswalk_gap_m: float = 3.0
    along_arm_m: float = 60.0  # nobody stands farther from the junction. [m]
    clearance_m: float = 0.5  # nobody stands nearer to the way of a VUT or a VRU. [m]

    def __post_init__(self) -> None:
        for name in _TRAFFIC[:3]:
            _check_range(self, name, 1.0, "")
        for name in _LENGTHS:
            _check_range(self, name, _MAX_LENGTH_M, "metres")
        if self.free_place_m <= 0.0:
            raise InputError("free_place_m", self.free_place_m, "metres, more than 0")
        for name, use in (("taken_share", "parked_share"), ("waiting_share", "waiting_share")):
            if getattr(self, name) > 0.0:
                _check_mix(self.vehicles, use)

    @property
    def is_empty(self) -> bool:
        """True if nobody stands anywhere."""
        return self.taken_share == 0.0 == self.waiting_share


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPeople:
    """Speeds and starts of a class of people.

    Attributes
    ----------
    probability : tuple of float
        Shares of all people, ascending. 0 .. 1
    speed_kmh : tuple of float
        So fast go those who keep moving, at these shares. [km/h]
    start_mps2 : tuple of float
        Mean acceleration of those who start, at these shares. [m/s^2]
    """

    probability: tuple[float, ...]
    speed_kmh: tuple[float, ...]
    start_mps2: tuple[float, ...]

    def __post_init__(self) -> None:
        for name, most in (("probability", 1.0), ("speed_kmh", 50.0), ("start_mps2", 10.0)):
            values = getattr(self, name)
            is_ascending = all(low < high for low, high in pairwise((0.0, *values, most + 1.0e-9)))
            if not (is_ascending and len(values) == len(self.probability) > 1):
                expected = f"at least two that ascend, above 0, up to {most:g}, in each list alike"
                raise InputError(name, list(values), expected)

    def draw(self, rng: np.random.Generator, planned_kmh: float) -> tuple[float, float]:
        """A speed in km/h and an acceleration in m/s^2; a planned speed beyond all stays."""
        speed, start = (
            float(np.interp(rng.random(), self.probability, values))
            for values in (self.speed_kmh, self.start_mps2)
        )
        is_usual = self.speed_kmh[0] <= planned_kmh <= self.speed_kmh[-1]
        return (speed if is_usual else planned_kmh), start


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUsers:
    """How road users may move otherwise than their case says; by default they do not.

    Attributes
    ----------
    pedestrian_kmh, cyclist_kmh, motorcyclist_kmh, car_kmh : (2,) float
        Least and most by which they are faster, in km/h; negative: slower.
    start_nearer_share : float
        Most by which the way from rest to the impact is shorter. 0 .. 1
    heading_deg : dict of (2,) float
        By Euro NCAP's name of a case: least and most by which the way is turned about the impact,
        counter-clockwise where traffic keeps right. [deg]
    path_m : dict of (2,) float
        By Euro NCAP's name of a case: least and most by which the way lies farther to the left of
        whoever takes it. [m]
    measured : dict of MeasuredPeople
        By class: speeds and starts that are drawn in place of those of the case.
    """

    pedestrian_kmh: tuple[float, float] = (0.0, 0.0)
    cyclist_kmh: tuple[float, float] = (0.0, 0.0)
    motorcyclist_kmh: tuple[float, float] = (0.0, 0.0)
    car_kmh: tuple[float, float] = (0.0, 0.0)
    start_nearer_share: float = 0.0
    heading_deg: dict[str, tuple[float, float]] = field(default_factory=dict)
    path_m: dict[str, tuple[float, float]] = field(default_factory=dict)
    measured: dict[str, MeasuredPeople] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (unit, reach) in _WAYS.items():
            for case, limits in getattr(self, name).items():
                if not -reach <= limits[0] <= 0.0 <= limits[1] <= reach:
                    expected = f"[low, high] in {unit}, -{reach:g} to 0 to {reach:g}"
                    raise InputError(f"{name}.{case}", list(limits), expected)
        for name in _SPEEDS:
            low, high = (float(end) for end in getattr(self, name))
            if not -_MAX_FASTER_KMH <= low <= 0.0 <= high <= _MAX_FASTER_KMH:
                most = f"{_MAX_FASTER_KMH:g}"
                raise InputError(name, [low, high], f"[low, high] in km/h, -{most} to 0 to {most}")
        _check_range(self, "start_nearer_share", _MAX_NEARER, "")

    @property
    def are_as_planned(self) -> bool:
        """True if nobody moves otherwise than planned."""
        return self == RoadUsers()

    def speed_kmh(self, class_name: str) -> tuple[float, float]:
        """Least and most by which road users of a class are faster, in km/h."""
        limits: tuple[float, float] = getattr(self, f"{class_name}_kmh")
        return limits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncertainty:
    """All that is uncertain; by default nothing is."""

    mounting: MountingErrors = field(default_factory=MountingErrors)  # how far off units are
    latency: LatencyJitter = field(default_factory=LatencyJitter)  # how long messages take
    # probability that the message of one unit in one frame is lost; in place of the setting's. 0 ..
    # 1
    packet_loss: float = 0.0
    # whether a planning detector that gives probabilities is drawn frame by frame
    draws_detections: bool = False
    # person_share, unit_person_share: of the variance of what decides a frame, what is the same in
    # all frames of a run: for all units, and for one of them. 0 .. 1
    person_share: float = 0.0
    unit_person_share: float = 0.0
    # whether messages get lost lasts so many frames on average, then it is drawn anew; 1: each
    burst_frames: float = 1.0
    loss_shared_by: str = "unit"  # {"unit", "pole"}: who loses the same messages
    outages: Outages = field(default_factory=Outages)  # units out of order
    blinding: Blinding = field(default_factory=Blinding)  # cameras that see nothing
    v2x_share: float = 1.0  # of all cars, those that hear the units. 0 .. 1
    # in worlds to choose in, a run of k times the mean weight is drawn k times, at most so often
    most_draws: int = 1
    traffic: StandingTraffic = field(default_factory=StandingTraffic)  # what stands at random
    road_users: RoadUsers = field(default_factory=RoadUsers)  # how those of the cases move
    moving: MovingTraffic | None = None  # what drives by; see :func:`with_moving_traffic`
    name: str = "none"  # what it is called in reports

    def __post_init__(self) -> None:
        for name in ("packet_loss", "person_share", "v2x_share"):
            _check_range(self, name, 1.0, "")
        _check_range(self, "unit_person_share", 1.0 - self.person_share, "")
        _check_range(self, "burst_frames", _MAX_BURST_FRAMES, "frames", least=1.0)
        check_whole("most_draws", self.most_draws, least=1)
        if self.loss_shared_by not in SHARED_BY:
            raise InputError(
                "loss_shared_by", self.loss_shared_by, "one of " + ", ".join(SHARED_BY)
            )
        if not isinstance(self.draws_detections, bool):
            raise InputError("draws_detections", self.draws_detections, "true or false")

    @property
    def may_fail(self) -> bool:
        """True if units may tell nothing for a whole run."""
        return (self.outages, self.blinding) != (Outages(), Blinding())

    @property
    def draws_anew(self) -> bool:
        """True if chance decides anew each time that a world is looked at."""
        return self.draws_detections or self.packet_loss > 0.0 or self.may_fail

    def __repr__(self) -> str:
        return f"Uncertainty({self.name!r})"


def with_moving_traffic(uncertainty: Uncertainty, moving: MovingTraffic) -> Uncertainty:
    """Uncertainty with vehicles that drive by, which replace those drawn at the stop lines."""
    standing = replace(uncertainty.traffic, waiting_share=0.0, following_share=0.0)
    return replace(uncertainty, moving=moving, traffic=standing)


def _check_mix(vehicles: Sequence[VehicleKind], use: str) -> None:
    if not vehicles:
        raise InputError("vehicles", Unquoted("none"), "at least one kind of vehicle")
    total = sum(getattr(kind, use) for kind in vehicles)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise InputError(
            f"vehicles: {use}", Unquoted(f"a sum of {total:g}"), "shares that sum to 1"
        )


def _check_range(holder: object, name: str, most: float, unit: str, *, least: float = 0.0) -> None:
    """Check that a field is a number from a limit, 0 by default, to another."""
    value: Any = getattr(holder, name)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and least <= value <= most):
        raise InputError(name, value, f"{least:g} to {most:g} {unit}".rstrip())


# ---------- reading


UNCERTAINTY_NAMES = ("default", "robustness", "as-measured", "none")
DEFAULT_UNCERTAINTY = UNCERTAINTY_NAMES[0]
_FILE = "uncertainty.toml"
_SECTIONS = (
    *("mounting", "latency", "messages", "detector", "outages", "blinding", "fleet"),
    *("choosing", "traffic", "vehicles", "road_users", "people"),
)
_AIMED = "aimed"  # mounting errors by how units are aimed
_AS = "as"  # what else is as in one of the names
_MOUNTING = ("yaw_sd_deg", "pitch_sd_deg", "height_sd_m")
_SHARES = ("parked_share", "waiting_share")
# Keys of sections whose values are fields of :class:`Uncertainty` itself; but for the first of a
# section they may be left out.
_FLAT = {
    "messages": ("packet_loss", "burst_frames", "shared_by"),
    "detector": ("is_drawn", "person_share", "unit_person_share"),
    "fleet": ("v2x_share",),
    "choosing": ("most_draws",),
}
_FIELDS = {"is_drawn": "draws_detections", "shared_by": "loss_shared_by"}  # of other names
_TAKEN: dict[str, Callable[..., Any]] = {
    "is_drawn": take,
    "shared_by": take_text,
    "most_draws": take,
}
_PLACES = {_FIELDS.get(key, key): f"{name}.{key}" for name, keys in _FLAT.items() for key in keys}
_T = TypeVar("_T")


def load_uncertainty(
    name_or_path: str = DEFAULT_UNCERTAINTY, *, where: str = "uncertainty"
) -> Uncertainty:
    """Uncertainty by name (``UNCERTAINTY_NAMES``), or a file like ``data/uncertainty.toml``.

    `where` says what named it, for error messages. Raises InputError if the name is unknown, or the
    file or a field is not what it should be.
    """
    if name_or_path in UNCERTAINTY_NAMES:
        return _load_named(name_or_path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        names = ", ".join(UNCERTAINTY_NAMES)
        raise InputError(where, name_or_path, f"{names}, or a .toml file with uncertainties")
    return _read(load_toml(path), path.name, f"{path}: ")


def load_drawn(question: Question, scene: Scene, *, n_samples: int) -> Uncertainty:
    """Uncertainty and traffic that a question draws in so many sampled worlds of a scene.

    Raises InputError as :func:`load_uncertainty` and :func:`.load_traffic`, or where traffic is
    given and no world is sampled; MissingExtraError where SUMO is asked for and not installed.
    """
    uncertainty = load_uncertainty(question.uncertainty, where="uncertainty")
    if not question.traffic:
        return uncertainty
    if n_samples == 0:
        raise InputError("traffic", question.traffic, "`samples` N beside it: worlds to drive in")
    moving = load_traffic(question.traffic, scene)
    return with_moving_traffic(uncertainty, moving)


@cache
def _load_named(name: str) -> Uncertainty:
    document = load_toml(files("placement") / "data" / _FILE)
    return _read(take(document, name, _FILE), name, f"{_FILE}: {name}.")


def _read(document: Table, name: str, prefix: str) -> Uncertainty:
    document = _with_rest(document, prefix)
    _refuse_unknown(document, _SECTIONS, prefix.rstrip(".: "))
    vehicles = _read_vehicles(document, prefix)
    if vehicles and "traffic" not in document:
        raise InputError(f"{prefix}vehicles", Unquoted("no section traffic"), "where they stand")
    street = _numbers(document, "traffic", _TRAFFIC, prefix)
    parts: dict[str, Any] = {
        "mounting": _read_mounting(document, prefix),
        "latency": _read_latency(_section(document, "latency", prefix), f"{prefix}latency"),
        "road_users": replace(
            _read_road_users(document, prefix), measured=_read_people(document, prefix)
        ),
        "traffic": _named(
            f"{prefix}traffic.", partial(StandingTraffic, vehicles=vehicles, **street)
        ),
    }
    for key, kind in (("outages", Outages), ("blinding", Blinding)):
        numbers = _numbers(document, key, [one.name for one in fields(kind)], prefix)
        parts[key] = _named(f"{prefix}{key}.", partial(kind, **numbers))
    parts |= _read_flat(document, prefix)
    try:
        return Uncertainty(name=name, **parts)
    except InputError as error:
        where = prefix + _PLACES.get(error.where, error.where)
        raise InputError(where, error.got, error.expected) from None


def _with_rest(document: Table, prefix: str) -> Table:
    """With the sections of the name that all else is as in."""
    if _AS not in document:
        return document
    other = take_text(document, _AS, prefix.rstrip(".: "))
    shipped = load_toml(files("placement") / "data" / _FILE)
    named = {name: shipped[name] for name in UNCERTAINTY_NAMES}
    given = _with_rest(pick(named, other, f"{prefix}{_AS}"), f"{_FILE}: {other}.")
    return {**given, **{key: document[key] for key in document if key != _AS}}


def _section(document: Table, key: str, prefix: str) -> Table | None:
    table = document.get(key)
    if table is not None and not isinstance(table, dict):
        raise InputError(f"{prefix}{key}", table, f"a section [{key}]")
    return table


def _numbers(document: Table, key: str, names: Sequence[str], prefix: str) -> dict[str, Any]:
    """All numbers of a section; none where it is left out."""
    table = _section(document, key, prefix)
    if table is None:
        return {}
    _refuse_unknown(table, names, f"{prefix}{key}")
    return {name: take_number(table, name, f"{prefix}{key}") for name in names}


def _read_latency(table: Table | None, where: str) -> LatencyJitter:
    if table is None:
        return LatencyJitter()
    if "budget" in table:
        _refuse_unknown(table, ("budget", "drawn_per"), where)
        budget = load_latency_budget(take_text(table, "budget", where), where=f"{where}.budget")
        fields: dict[str, Any] = {"budget": budget}
    else:
        _refuse_unknown(table, ("distribution", "mean_s", "sd_s", "drawn_per"), where)
        fields = {key: take_number(table, key, where) for key in ("mean_s", "sd_s")}
        fields["distribution"] = take_text(table, "distribution", where)
    fields["drawn_per"] = take_text(table, "drawn_per", where)
    return _named(f"{where}.", lambda: LatencyJitter(**fields))


def _read_flat(document: Table, prefix: str) -> dict[str, Any]:
    """Fields of an uncertainty that are no values of their own."""
    values: dict[str, Any] = {}
    for name, keys in _FLAT.items():
        table, where = _section(document, name, prefix), f"{prefix}{name}"
        if table is None:
            continue
        _refuse_unknown(table, keys, where)
        for key in keys:
            if key in table or key == keys[0]:
                values[_FIELDS.get(key, key)] = _TAKEN.get(key, take_number)(table, key, where)
    return values


def _read_mounting(document: Table, prefix: str) -> MountingErrors:
    """Errors that a section says, or the name of how units are aimed."""
    given = document.get("mounting")
    if isinstance(given, str):
        named = load_toml(files("placement") / "data" / _FILE)[_AIMED]
        document = {"mounting": pick(named, given, f"{prefix}mounting")}
    errors = _numbers(document, "mounting", _MOUNTING, prefix)
    return _named(f"{prefix}mounting.", partial(MountingErrors, **errors))


def _read_road_users(document: Table, prefix: str) -> RoadUsers:
    table, where = _section(document, "road_users", prefix), f"{prefix}road_users"
    if table is None:
        return RoadUsers()
    _refuse_unknown(table, (*_SPEEDS, "start_nearer_share", *_WAYS), where)
    limits: dict[str, Any] = {key: _read_limits(table, key, where) for key in _SPEEDS}
    nearer = take_number(table, "start_nearer_share", where)
    known = sorted({case.family for case in load_cases().values()})
    for key in _WAYS:
        by_case = _section(table, key, f"{where}.") or {}
        _refuse_unknown(by_case, known, f"{where}.{key}")
        limits[key] = {name: _read_limits(by_case, name, f"{where}.{key}") for name in by_case}
    return _named(f"{where}.", lambda: RoadUsers(**limits, start_nearer_share=nearer))


def _read_people(document: Table, prefix: str) -> dict[str, MeasuredPeople]:
    table, where = _section(document, "people", prefix), f"{prefix}people"
    if table is None:
        return {}
    _refuse_unknown(table, ("probability", *_PEOPLE), where)
    probability, found = _read_values(table, "probability", where), {}
    for name in _PEOPLE:
        values = _section(table, name, f"{where}.") or {}
        here = f"{where}.{name}"
        _refuse_unknown(values, _MEASURED, here)
        if values:
            lists = {key: _read_values(values, key, here) for key in _MEASURED}
            build = partial(MeasuredPeople, probability=probability, **lists)
            found[name] = _named(f"{here}.", build)
    return found


_PEOPLE = ("pedestrian", "cyclist")
_MEASURED = ("speed_kmh", "start_mps2")


def _read_values(table: Table, key: str, where: str) -> tuple[float, ...]:
    return tuple(float_array(take_list(table, key, where), (-1,), f"{where}.{key}").tolist())


def _read_limits(table: Table, key: str, where: str) -> tuple[float, float]:
    low, high = float_array(take_list(table, key, where), (2,), f"{where}.{key}").tolist()
    return low, high


def _read_vehicles(document: Table, prefix: str) -> tuple[VehicleKind, ...]:
    if "vehicles" not in document:
        return ()
    kinds = []
    for index, entry in enumerate(take_list(document, "vehicles", prefix.rstrip(".: "))):
        where = f"{prefix}vehicles[{index}]"
        if not isinstance(entry, dict):
            raise InputError(where, entry, "a table [[vehicles]]")
        shares = {key: take_number(entry, key, where) for key in _SHARES}
        actor = read_body({key: entry[key] for key in entry if key not in _SHARES}, where)
        kinds.append(_named(f"{where}.", partial(VehicleKind, actor=actor, **shares)))
    return tuple(kinds)


def _refuse_unknown(table: Table, known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(where, key, "one of " + ", ".join(known))


def _named(prefix: str, build: Callable[[], _T]) -> _T:
    """Build a value; what is wrong with it is said with the place where it stands."""
    try:
        return build()
    except InputError as error:
        if error.where.startswith(prefix.rstrip(".: ")):
            raise
        raise InputError(f"{prefix}{error.where}", error.got, error.expected) from None
