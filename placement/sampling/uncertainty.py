"""Everything that is uncertain, read from TOML.

Mounting errors, traffic, misses, lost messages and latencies are.
"""

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np

from geometry.actors import Actor, read_body
from geometry.arrays import FloatArray, float_array
from geometry.errors import InputError, check_one_of, located, refuse
from geometry.scene import Scene
from geometry.tables import Table, pick, says, take, take_list, take_number, take_text
from geometry.text_formats import load_data, load_toml
from scenarios.cases import load_cases

from ..compute import check_whole
from ..latency import LatencyBudget, load_latency_budget
from ..question import Question
from .driving import MovingTraffic, load_traffic

_T = TypeVar("_T")

# ---------- kinds of uncertainty
_SPEEDS = ("pedestrian_kmh", "cyclist_kmh", "motorcyclist_kmh", "car_kmh")
# Pairs of road users' limits: the unit, and the most that can be.
_REACH = dict.fromkeys(_SPEEDS, ("km/h", 50.0)) | {
    "heading_deg": ("degrees", 45.0),
    "path_m": ("m", 2.0),
}
_WAYS = ("heading_deg", "path_m")
_SUM_TOLERANCE = 1.0e-6
# Name of the kind of vehicle that waits in bus lanes.
_BUS = "bus"
# Standard deviations from a uniform distribution's mean to its end.
_UNIFORM_REACH = np.sqrt(3.0)


def _up_to(
    most: float, unit: str = "", *, default: Any = 0.0, least: float = 0.0
) -> Any:
    """Field of a number from `least` to `most`.

    The limits are checked by :func:`_check_numbers`.
    """
    return field(default=default, metadata={"limits": (least, most, unit)})


def _check_numbers(value: Any) -> None:
    """Raise InputError for a number beyond its field's limits."""
    for one in fields(value):
        if one.metadata:
            _check_range(one.name, getattr(value, one.name), *one.metadata["limits"])


def _check_range(name: str, value: Any, least: float, most: float, unit: str) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and least <= value <= most):
        raise InputError(name, value, f"{least:g} to {most:g} {unit}".rstrip())


_SD_DEG = "Standard deviation, in degrees; errors are normal, cut off at three of them."
_SD_M = "Standard deviation, in metres; three values stand for a normal distribution."
_OUT = (
    "Probability, in each run, that a unit is out of order, and that a pole is with all"
    " of its"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingErrors:
    """Errors of units after installation.

    Attributes
    ----------
    height_sd_m : float
        Standard deviation of the height; poses at one mount share its error. [m]
    """

    yaw_sd_deg: Annotated[float, says(_SD_DEG)] = _up_to(30.0, "degrees")
    pitch_sd_deg: Annotated[float, says(_SD_DEG)] = _up_to(30.0, "degrees")
    height_sd_m: Annotated[float, says(_SD_M)] = _up_to(0.5, "metres")

    def __post_init__(self) -> None:
        _check_numbers(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyJitter:
    """By how much messages take longer than the braking rule says.

    Attributes
    ----------
    distribution : str
        {"gamma", "uniform"}: of the time on top of the rule's latency; never
        negative.
    mean_s, sd_s : float
        Mean and standard deviation; with a deviation of 0 it is always the
        mean. [s]
    drawn_per : str
        {"run", "sample"}: how often it is drawn.
    budget : LatencyBudget, optional
        In place of all that: totals are drawn from it, and stand in for the
        rule's latency.
    """

    distribution: str = "gamma"
    mean_s: float = _up_to(10.0, "seconds")
    sd_s: float = _up_to(10.0, "seconds")
    drawn_per: str = "run"
    budget: LatencyBudget | None = None

    def __post_init__(self) -> None:
        check_one_of("distribution", self.distribution, ("gamma", "uniform"))
        check_one_of("drawn_per", self.drawn_per, ("run", "sample"))
        _check_numbers(self)
        if self.distribution == "gamma":
            most = np.inf
        else:
            most = self.mean_s / _UNIFORM_REACH
        if self.sd_s > most * (1.0 + 1.0e-9) or (
            self.mean_s == 0.0 and self.sd_s > 0.0
        ):
            expected = f"less spread around a mean of {self.mean_s:g} s: none below 0"
            raise InputError("sd_s", self.sd_s, expected)
        if self.budget is not None and (self.mean_s, self.sd_s) != (0.0, 0.0):
            raise InputError("budget", self.budget.name, "no mean_s and sd_s beside it")

    def draw_s(
        self, rng: np.random.Generator, n_runs: int, *, rule_latency_s: float
    ) -> FloatArray:
        """Draw how much longer messages take than by the rule, (n_runs,) in s.

        Negative where a budget's total is shorter than the rule's latency.
        """
        if self.drawn_per == "run":
            n_draws = n_runs
        else:
            n_draws = 1
        # A budget stands for the whole latency; else the jitter comes on top.
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
    """How often a unit tells nothing for a whole run."""

    unit_share: Annotated[float, says(f"{_OUT} units. 0 .. 1.")] = _up_to(1.0)
    pole_share: Annotated[float, says(f"{_OUT} units. 0 .. 1.")] = _up_to(1.0)

    def __post_init__(self) -> None:
        _check_numbers(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Blinding:
    """Share of runs in which cameras of units and of the VUT are blind.

    A blind camera sees nothing for the whole run.

    Attributes
    ----------
    dirty_share : float
        Probability, in each run, that a camera is dirty. 0 .. 1
    low_sun_share : float
        Share of the runs by day with low sun, from a direction that all cameras share.
        0 .. 1
    sun_below_deg : float
        Most that low sun stands above the horizon, in degrees.
    dazzled_within_deg : float
        Least angle between a camera's axis and the sun without being dazzled, in
        degrees.
    """

    dirty_share: float = _up_to(1.0)
    low_sun_share: float = _up_to(1.0)
    sun_below_deg: float = _up_to(90.0, "degrees")
    dazzled_within_deg: float = _up_to(180.0, "degrees")

    def __post_init__(self) -> None:
        _check_numbers(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VehicleKind:
    """A kind of vehicle: its share of all that are parked, and of all that wait."""

    actor: Actor
    parked_share: float = _up_to(1.0, default=MISSING)
    waiting_share: float = _up_to(1.0, default=MISSING)

    def __post_init__(self) -> None:
        _check_numbers(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingTraffic:
    """Vehicles that stand at random: parked, or waiting to enter.

    Attributes
    ----------
    taken_share : float
        Probability that a place in a parking lane is taken. 0 .. 1
    waiting_share, following_share : float
        Probability that somebody waits at the stop line of a lane; then, again and
        again, that another one stands behind. 0 .. 1
    bus_lane_share : float
        Probability that a bus, the kind of vehicle of that name, waits at the end of a
        bus lane that leads into the junction. 0 .. 1
    vehicles : tuple of VehicleKind
        What stands there; shares of each use sum to 1.
    free_place_m : float
        Length of a place that stays free. [m]
    parked_gap_m, waiting_gap_m : float
        From bumper to bumper. [m]
    clear_of_mouth_m : float
        No parking nearer to the junction. [m]
    crosswalk_gap_m : float
        From the line on which pedestrians cross an arm to the first bumper that waits.
        [m]
    along_arm_m : float
        Nobody stands farther from the junction. [m]
    clearance_m : float
        Nobody stands nearer to the way of a VUT or a VRU. [m]
    """

    taken_share: float = _up_to(1.0)
    waiting_share: float = _up_to(1.0)
    following_share: float = _up_to(1.0)
    bus_lane_share: float = _up_to(1.0)
    free_place_m: float = _up_to(1000.0, "metres", default=5.5)
    parked_gap_m: float = _up_to(1000.0, "metres", default=0.8)
    clear_of_mouth_m: float = _up_to(1000.0, "metres", default=5.0)
    waiting_gap_m: float = _up_to(1000.0, "metres", default=2.0)
    crosswalk_gap_m: float = _up_to(1000.0, "metres", default=3.0)
    along_arm_m: float = _up_to(1000.0, "metres", default=60.0)
    clearance_m: float = _up_to(1000.0, "metres", default=0.5)
    vehicles: tuple[VehicleKind, ...] = ()

    def __post_init__(self) -> None:
        _check_numbers(self)
        if self.free_place_m <= 0.0:
            raise InputError("free_place_m", self.free_place_m, "metres, more than 0")
        for name, use in (
            ("taken_share", "parked_share"),
            ("waiting_share", "waiting_share"),
        ):
            if getattr(self, name) > 0.0:
                self._check_mix(use)
        if self.bus_lane_share > 0.0 and self.bus is None:
            refuse("vehicles", "no bus", f"one named {_BUS}: bus_lane_share > 0")

    def _check_mix(self, use: str) -> None:
        """Raise InputError unless the shares of one use sum to 1."""
        if not self.vehicles:
            refuse("vehicles", "none", "at least one kind of vehicle")
        total = sum(getattr(kind, use) for kind in self.vehicles)
        if abs(total - 1.0) > _SUM_TOLERANCE:
            refuse(f"vehicles: {use}", f"a sum of {total:g}", "shares that sum to 1")

    @property
    def is_empty(self) -> bool:
        """True if nobody stands anywhere."""
        shares = (self.taken_share, self.waiting_share, self.bus_lane_share)
        return not any(shares)

    @property
    def bus(self) -> Actor | None:
        """The bus among the kinds of vehicles; None: there is none."""
        actors = (kind.actor for kind in self.vehicles)
        return next((actor for actor in actors if actor.name == _BUS), None)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPeople:
    """Speeds and starts of a class of people."""

    probability: Annotated[
        tuple[float, ...], says("Shares of all people, ascending. 0 .. 1.")
    ]
    speed_kmh: Annotated[
        tuple[float, ...],
        says("So fast go those who keep moving, at these shares, in km/h."),
    ]
    start_mps2: Annotated[
        tuple[float, ...],
        says("Mean acceleration of those who start, at these shares, in m/s^2."),
    ]

    def __post_init__(self) -> None:
        for name, most in (
            ("probability", 1.0),
            ("speed_kmh", 50.0),
            ("start_mps2", 10.0),
        ):
            values = getattr(self, name)
            is_ascending = all(
                low < high for low, high in pairwise((0.0, *values, most + 1.0e-9))
            )
            if not (is_ascending and len(values) == len(self.probability) > 1):
                expected = (
                    f"at least two that ascend, above 0, up to {most:g}, in each list"
                    " alike"
                )
                raise InputError(name, list(values), expected)

    def draw(self, rng: np.random.Generator, planned_kmh: float) -> tuple[float, float]:
        """Draw a speed in km/h and an acceleration in m/s^2.

        A planned speed beyond all measured ones stays.
        """
        speed, start = (
            float(np.interp(rng.random(), self.probability, values))
            for values in (self.speed_kmh, self.start_mps2)
        )
        is_usual = self.speed_kmh[0] <= planned_kmh <= self.speed_kmh[-1]
        if not is_usual:
            speed = planned_kmh
        return speed, start


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUsers:
    """How road users may deviate from their case.

    By default they do not.

    Attributes
    ----------
    pedestrian_kmh, cyclist_kmh, motorcyclist_kmh, car_kmh : (2,) float
        Least and most by which they are faster, in km/h; negative: slower.
    start_nearer_share : float
        Most by which the way from rest to the impact is shorter. 0 .. 1
    heading_deg : dict of (2,) float
        By Euro NCAP's name of a case: least and most by which the way is turned about
        the impact, counter-clockwise where traffic keeps right. [deg]
    path_m : dict of (2,) float
        By Euro NCAP's name of a case: least and most by which the way lies farther to
        the left of whoever takes it. [m]
    measured : dict of MeasuredPeople
        By class: speeds and starts that are drawn in place of those of the case.
    """

    pedestrian_kmh: tuple[float, float] = (0.0, 0.0)
    cyclist_kmh: tuple[float, float] = (0.0, 0.0)
    motorcyclist_kmh: tuple[float, float] = (0.0, 0.0)
    car_kmh: tuple[float, float] = (0.0, 0.0)
    start_nearer_share: float = _up_to(0.9)
    heading_deg: dict[str, tuple[float, float]] = field(default_factory=dict)
    path_m: dict[str, tuple[float, float]] = field(default_factory=dict)
    measured: dict[str, MeasuredPeople] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Pairs of limits by name; those of ways also by case.
        limits = {name: getattr(self, name) for name in _SPEEDS}
        for way in _WAYS:
            limits |= {
                f"{way}.{case}": pair for case, pair in getattr(self, way).items()
            }
        for name, (low, high) in limits.items():
            unit, reach = _REACH[name.partition(".")[0]]
            if not -reach <= low <= 0.0 <= high <= reach:
                expected = f"[low, high] in {unit}, -{reach:g} to 0 to {reach:g}"
                raise InputError(name, [low, high], expected)
        _check_numbers(self)

    @property
    def are_as_planned(self) -> bool:
        """True if nobody moves otherwise than planned."""
        return self == RoadUsers()

    def speed_kmh(self, class_name: str) -> tuple[float, float]:
        """Least and most by which road users of a class are faster, in km/h."""
        low, high = getattr(self, f"{class_name}_kmh")
        return low, high


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Uncertainty:
    """All that is uncertain; by default nothing is.

    Attributes
    ----------
    mounting : MountingErrors
        How far off units are.
    latency : LatencyJitter
        How long messages take.
    packet_loss : float
        Probability that the message of one unit in one frame is lost; in place
        of the setting's.
    draws_detections : bool
        Whether a planning detector that gives probabilities is drawn frame by
        frame.
    person_share, unit_person_share : float
        Of the variance of what decides a frame, what is the same in all frames
        of a run: for all units, and for one of them.
    burst_frames : float
        Whether messages get lost lasts so many frames on average, then it is
        drawn anew; 1: each.
    loss_shared_by : str
        {"unit", "pole"}: who loses the same messages.
    outages : Outages
        Units out of order.
    blinding : Blinding
        Cameras that see nothing.
    v2x_share : float
        Of all cars, those that hear the units.
    most_draws : int
        In worlds to choose in, a run of k times the mean weight is drawn k
        times, at most so often.
    traffic : StandingTraffic
        What stands at random.
    road_users : RoadUsers
        How those of the cases move.
    moving : MovingTraffic, optional
        What drives by; see :func:`with_moving_traffic`.
    name : str
        What it is called in reports.
    """

    mounting: MountingErrors = field(default_factory=MountingErrors)
    latency: LatencyJitter = field(default_factory=LatencyJitter)
    packet_loss: float = _up_to(1.0)
    draws_detections: bool = False
    person_share: float = _up_to(1.0)
    unit_person_share: float = 0.0
    burst_frames: float = _up_to(1000.0, "frames", default=1.0, least=1.0)
    loss_shared_by: str = "unit"
    outages: Outages = field(default_factory=Outages)
    blinding: Blinding = field(default_factory=Blinding)
    v2x_share: float = _up_to(1.0, default=1.0)
    most_draws: int = 1
    traffic: StandingTraffic = field(default_factory=StandingTraffic)
    road_users: RoadUsers = field(default_factory=RoadUsers)
    moving: MovingTraffic | None = None
    name: str = "none"

    def __post_init__(self) -> None:
        _check_numbers(self)
        most = 1.0 - self.person_share
        _check_range("unit_person_share", self.unit_person_share, 0.0, most, "")
        check_whole("most_draws", self.most_draws, least=1)
        check_one_of("loss_shared_by", self.loss_shared_by, ("unit", "pole"))
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


def with_moving_traffic(uncertainty: Uncertainty, moving: MovingTraffic) -> Uncertainty:
    """Uncertainty with vehicles that drive by.

    They replace the vehicles that wait at the stop lines.
    """
    standing = replace(
        uncertainty.traffic,
        waiting_share=0.0,
        following_share=0.0,
        bus_lane_share=0.0,
    )
    return replace(uncertainty, moving=moving, traffic=standing)


# ---------- reading
UNCERTAINTY_NAMES = ("default", "robustness", "as-measured", "none")
_FILE = "uncertainty.toml"
# Numbers of a section that may be left out.
_OPTIONAL = ("bus_lane_share",)
_SECTIONS = (
    *("mounting", "latency", "messages", "detector", "outages", "blinding", "fleet"),
    *("choosing", "traffic", "vehicles", "road_users", "people"),
)
# What else is as in one of the names.
_AS = "as"
# Sections whose values are fields of :class:`Uncertainty` itself: field and reader of
# each key; but for the first of a section they may be left out.
_Reader = Callable[[Table, str, str], Any]
_FLAT: dict[str, dict[str, tuple[str, _Reader]]] = {
    "messages": {
        "packet_loss": ("packet_loss", take_number),
        "burst_frames": ("burst_frames", take_number),
        "shared_by": ("loss_shared_by", take_text),
    },
    "detector": {
        "is_drawn": ("draws_detections", take),
        "person_share": ("person_share", take_number),
        "unit_person_share": ("unit_person_share", take_number),
    },
    "fleet": {"v2x_share": ("v2x_share", take_number)},
    "choosing": {"most_draws": ("most_draws", take)},
}
_PLACES = {
    name: f"{key}.{k}" for key, keys in _FLAT.items() for k, (name, _) in keys.items()
}
_PEOPLE = ("pedestrian", "cyclist")


def load_uncertainty(
    name_or_path: str = "default", *, where: str = "uncertainty"
) -> Uncertainty:
    """Uncertainty by its name, or from a file.

    Names are ``UNCERTAINTY_NAMES``; a file is laid out as
    ``data/uncertainty.toml``. `where` says what named it, for error messages.
    Raises InputError if the name is unknown, or the file or a field is not what it
    should be.
    """
    if name_or_path in UNCERTAINTY_NAMES:
        return _load_named(name_or_path)
    path = Path(name_or_path)
    if path.suffix != ".toml":
        names = ", ".join(UNCERTAINTY_NAMES)
        raise InputError(
            where, name_or_path, f"{names}, or a .toml file with uncertainties"
        )
    return _read(load_toml(path), path.name, f"{path}: ")


def load_drawn(question: Question, scene: Scene, *, n_samples: int) -> Uncertainty:
    """Uncertainty and traffic of a question, drawn in sampled worlds.

    Raises InputError as :func:`load_uncertainty` and :func:`.load_traffic`, or where
    traffic is given and no world is sampled; MissingExtraError where SUMO is asked for
    and not installed.
    """
    uncertainty = load_uncertainty(question.uncertainty, where="uncertainty")
    if not question.traffic:
        return uncertainty
    if n_samples == 0:
        raise InputError(
            "traffic", question.traffic, "`samples` N beside it: worlds to drive in"
        )
    return with_moving_traffic(uncertainty, load_traffic(question.traffic, scene))


@cache
def _shipped() -> Table:
    return load_data("placement", _FILE)


CALIBRATED = "calibrated"
BY_EYE = "by eye"
"""How units may be aimed: names of :func:`load_aims`."""


@cache
def load_aims() -> dict[str, MountingErrors]:
    """Mounting errors by how units are aimed: "by eye" and "calibrated"."""
    return {
        name: MountingErrors(**table) for name, table in _shipped()["aimed"].items()
    }


@cache
def _load_named(name: str) -> Uncertainty:
    return _read(take(_shipped(), name, _FILE), name, f"{_FILE}: {name}.")


def _read(document: Table, name: str, prefix: str) -> Uncertainty:
    """Uncertainty of a document whose place in messages is `prefix`."""
    with located(prefix):
        document = _with_rest(document)
        _refuse_unknown(document, _SECTIONS, "")
        vehicles = _read_vehicles(document)
        if vehicles and "traffic" not in document:
            refuse("vehicles", "no section traffic", "where they stand")
        # A word in place of the section names how units are aimed.
        mounting = document
        # How units are aimed.
        if isinstance(aimed := document.get("mounting"), str):
            mounting = {"mounting": pick(_shipped()["aimed"], aimed, "mounting")}
        parts: dict[str, Any] = {
            "mounting": _read_numbers(mounting, "mounting", MountingErrors),
            "latency": _read_latency(document),
            "road_users": _read_road_users(document),
            "traffic": _read_numbers(
                document, "traffic", StandingTraffic, vehicles=vehicles
            ),
            "outages": _read_numbers(document, "outages", Outages),
            "blinding": _read_numbers(document, "blinding", Blinding),
        }
        # Sections whose values are fields of the uncertainty itself.
        for key, keys in _FLAT.items():
            table = _section(document, key, tuple(keys)) or {}
            for number, (word, (field_name, read)) in enumerate(keys.items()):
                if word in table or (number == 0 and key in document):
                    parts[field_name] = read(table, word, key)
        try:
            return Uncertainty(name=name, **parts)
        except InputError as error:
            where = _PLACES.get(error.where, error.where)
            raise InputError(where, error.got, error.expected) from None


def _with_rest(document: Table) -> Table:
    """With the sections of the name that all else is as in."""
    if _AS not in document:
        return document
    # The named one may itself refer to another.
    named = {name: _shipped()[name] for name in UNCERTAINTY_NAMES}
    given = _with_rest(pick(named, take_text(document, _AS, ""), _AS))
    return {**given, **{key: document[key] for key in document if key != _AS}}


def _section(
    document: Table, key: str, known: Sequence[str], at: str = ""
) -> Table | None:
    """A section without unknown keys; None where it is left out.

    `at` is the place of its parent.
    """
    table = document.get(key)
    if table is not None:
        if not isinstance(table, dict):
            raise InputError(f"{at}{key}", table, f"a section [{key}]")
        _refuse_unknown(table, known, f"{at}{key}")
    return table


def _read_numbers(
    document: Table, key: str, kind: Callable[..., _T], **more: Any
) -> _T:
    """A value whose numbers a section has, all of them.

    It is the default where the section, or a number of ``_OPTIONAL``, is left out.
    """
    names = [one.name for one in fields(kind) if one.metadata]  # type: ignore[arg-type]
    table = _section(document, key, names)
    if table is None:
        numbers = {}
    else:
        given = [name for name in names if name in table or name not in _OPTIONAL]
        numbers = {name: take_number(table, name, key) for name in given}
    with located(f"{key}."):
        return kind(**numbers, **more)


def _read_latency(document: Table) -> LatencyJitter:
    """Latency jitter of a document."""
    where = "latency"
    has_budget = isinstance(document.get(where), dict) and "budget" in document[where]
    known = ("budget",) if has_budget else ("distribution", "mean_s", "sd_s")
    table = _section(document, where, (*known, "drawn_per"))
    if table is None:
        return LatencyJitter()
    if has_budget:
        budget = load_latency_budget(
            take_text(table, "budget", where), where=f"{where}.budget"
        )
        given: dict[str, Any] = {"budget": budget}
    else:
        given = {key: take_number(table, key, where) for key in ("mean_s", "sd_s")}
        given["distribution"] = take_text(table, "distribution", where)
    given["drawn_per"] = take_text(table, "drawn_per", where)
    with located(f"{where}."):
        return LatencyJitter(**given)


def _read_road_users(document: Table) -> RoadUsers:
    """Deviations of road users of a document, by case."""
    measured = _read_people(document)
    where = "road_users"
    table = _section(document, where, (*_SPEEDS, "start_nearer_share", *_WAYS))
    if table is None:
        return RoadUsers(measured=measured)
    limits: dict[str, Any] = {key: _read_list(table, key, where, 2) for key in _SPEEDS}
    nearer = take_number(table, "start_nearer_share", where)
    # Ways are given by the family of the case.
    known = sorted({case.family for case in load_cases().values()})
    for key in _WAYS:
        by_case = _section(table, key, known, f"{where}.") or {}
        limits[key] = {
            name: _read_list(by_case, name, f"{where}.{key}", 2) for name in by_case
        }
    with located(f"{where}."):
        return RoadUsers(**limits, start_nearer_share=nearer, measured=measured)


def _read_people(document: Table) -> dict[str, MeasuredPeople]:
    """Measured speeds and starts of a document, by class."""
    where = "people"
    keys = ("speed_kmh", "start_mps2")
    table = _section(document, where, ("probability", *_PEOPLE))
    if table is None:
        return {}
    probability = _read_list(table, "probability", where)
    found = {}
    for name in _PEOPLE:
        here = f"{where}.{name}"
        if values := _section(table, name, keys, f"{where}."):
            lists = {key: _read_list(values, key, here) for key in keys}
            with located(f"{here}."):
                found[name] = MeasuredPeople(probability=probability, **lists)
    return found


def _read_list(
    table: Table, key: str, where: str, length: int = -1
) -> tuple[float, ...]:
    """Numbers of a list; `length` -1 stands for any number of them."""
    return tuple(
        float_array(take_list(table, key, where), (length,), f"{where}.{key}").tolist()
    )


def _read_vehicles(document: Table) -> tuple[VehicleKind, ...]:
    """Kinds of vehicles of a document."""
    kinds = []
    names = ("parked_share", "waiting_share")
    for index, entry in enumerate(
        take_list({"vehicles": [], **document}, "vehicles", "")
    ):
        where = f"vehicles[{index}]"
        if not isinstance(entry, dict):
            raise InputError(where, entry, "a table [[vehicles]]")
        shares = {key: take_number(entry, key, where) for key in names}
        actor = read_body(
            {key: entry[key] for key in entry if key not in shares}, where
        )
        with located(f"{where}."):
            kinds.append(VehicleKind(actor=actor, **shares))
    return tuple(kinds)


def _refuse_unknown(table: Table, known: Sequence[str], where: str) -> None:
    for key in table:
        check_one_of(where, key, known)
