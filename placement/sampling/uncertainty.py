"""Uncertainty: mounting errors, traffic, misses, lost messages, latencies; read from TOML."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, take, take_list, take_number, take_text
from geometry.scene import Scene

from ..latency import LatencyBudget, load_latency_budget
from ..question import Question
from .bodies import read_body
from .moving import MovingTraffic, load_traffic

# ---------- kinds of uncertainty


DISTRIBUTIONS = ("gamma", "uniform")
DRAWN_PER = ("run", "sample")
_MAX_ANGLE_SD_DEG = 30.0
_MAX_HEIGHT_SD_M = 0.5  # a small error: the same poles, the same view
_MAX_LATENCY_S = 10.0
_MAX_LENGTH_M = 1000.0
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VehicleKind:
    """A kind of vehicle that stands beside the road or waits on it."""

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
    """Vehicles that stand at random: parked along the arms, and waiting to enter the junction.

    Attributes
    ----------
    taken_share : float
        Probability that a place in a parking lane is taken. 0 .. 1
    waiting_share, following_share : float
        Probability that somebody waits at the stop line of a lane; then, again and again, that
        another one stands behind. 0 .. 1
    vehicles : tuple of VehicleKind
        What stands there; shares of each use sum to 1.
    free_place_m : float
        Length of a place that stays free. [m]
    parked_gap_m, waiting_gap_m : float
        From bumper to bumper. [m]
    clear_of_mouth_m : float
        No parking nearer to the junction. [m]
    crosswalk_gap_m : float
        From the line on which pedestrians cross an arm to the first bumper that waits. [m]
    along_arm_m : float
        Nobody stands farther from the junction. [m]
    clearance_m : float
        Nobody stands nearer to the way of a VUT or a VRU. [m]
    """

    taken_share: float = 0.0
    waiting_share: float = 0.0
    following_share: float = 0.0
    vehicles: tuple[VehicleKind, ...] = ()
    free_place_m: float = 5.5
    parked_gap_m: float = 0.8
    clear_of_mouth_m: float = 5.0
    waiting_gap_m: float = 2.0
    crosswalk_gap_m: float = 3.0
    along_arm_m: float = 60.0
    clearance_m: float = 0.5

    def __post_init__(self) -> None:
        for name in ("taken_share", "waiting_share", "following_share"):
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
        """Whether nobody stands anywhere."""
        return self.taken_share == 0.0 == self.waiting_share


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
        Probability that the message of one unit in one frame is lost; in place of the setting's.
        0 .. 1
    draws_detections : bool
        Whether a planning detector that gives probabilities is drawn frame by frame.
    traffic : StandingTraffic
        What stands at random.
    moving : MovingTraffic, optional
        What drives by; see :func:`with_moving_traffic`.
    name : str
        What it is called in reports.
    """

    mounting: MountingErrors = field(default_factory=MountingErrors)
    latency: LatencyJitter = field(default_factory=LatencyJitter)
    packet_loss: float = 0.0
    draws_detections: bool = False
    traffic: StandingTraffic = field(default_factory=StandingTraffic)
    moving: MovingTraffic | None = None
    name: str = "none"

    def __post_init__(self) -> None:
        _check_range(self, "packet_loss", 1.0, "")
        if not isinstance(self.draws_detections, bool):
            raise InputError("draws_detections", self.draws_detections, "true or false")

    def __repr__(self) -> str:
        return f"Uncertainty({self.name!r})"


def with_moving_traffic(uncertainty: Uncertainty, moving: MovingTraffic) -> Uncertainty:
    """The same with vehicles that drive by, and none drawn at the stop lines: these wait, too."""
    standing = replace(uncertainty.traffic, waiting_share=0.0, following_share=0.0)
    return replace(uncertainty, moving=moving, traffic=standing)


_LENGTHS = (
    "free_place_m",
    "parked_gap_m",
    "clear_of_mouth_m",
    "waiting_gap_m",
    "crosswalk_gap_m",
    "along_arm_m",
    "clearance_m",
)


def _check_mix(vehicles: Sequence[VehicleKind], use: str) -> None:
    if not vehicles:
        raise InputError("vehicles", Unquoted("none"), "at least one kind of vehicle")
    total = sum(getattr(kind, use) for kind in vehicles)
    if abs(total - 1.0) > _SUM_TOLERANCE:
        raise InputError(
            f"vehicles: {use}", Unquoted(f"a sum of {total:g}"), "shares that sum to 1"
        )


def _check_range(holder: object, name: str, most: float, unit: str) -> None:
    """Check that a field is a number from 0 to a limit."""
    value: Any = getattr(holder, name)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and 0.0 <= value <= most):
        raise InputError(name, value, f"0 to {most:g} {unit}".rstrip())


# ---------- reading


UNCERTAINTY_NAMES = ("default", "none")
DEFAULT_UNCERTAINTY = UNCERTAINTY_NAMES[0]
_FILE = "uncertainty.toml"
_SECTIONS = ("mounting", "latency", "messages", "detector", "traffic", "vehicles")
_MOUNTING = ("yaw_sd_deg", "pitch_sd_deg", "height_sd_m")
_TRAFFIC = (
    "taken_share",
    "waiting_share",
    "following_share",
    "free_place_m",
    "parked_gap_m",
    "clear_of_mouth_m",
    "waiting_gap_m",
    "crosswalk_gap_m",
    "along_arm_m",
    "clearance_m",
)
_SHARES = ("parked_share", "waiting_share")
_T = TypeVar("_T")


def load_uncertainty(
    name_or_path: str = DEFAULT_UNCERTAINTY, *, where: str = "uncertainty"
) -> Uncertainty:
    """Uncertainty by name ("default", "none"), or a file like ``data/uncertainty.toml``.

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
    """What a question draws in so many sampled worlds of a scene: --uncertainty and --traffic.

    Raises InputError as :func:`load_uncertainty` and :func:`.load_traffic`, or where traffic is
    given and no world is sampled; MissingExtraError where SUMO is asked for and not installed.
    """
    uncertainty = load_uncertainty(question.uncertainty, where="--uncertainty")
    if question.traffic_offset and not question.traffic:
        raise InputError("--traffic-offset", question.traffic_offset, "--traffic FILE beside it")
    if not question.traffic:
        return uncertainty
    if n_samples == 0:
        raise InputError("--traffic", question.traffic, "--samples N beside it: worlds to drive in")
    moving = load_traffic(question.traffic, scene, offset=question.traffic_offset)
    return with_moving_traffic(uncertainty, moving)


@cache
def _load_named(name: str) -> Uncertainty:
    document = load_toml(files("placement") / "data" / _FILE)
    return _read(take(document, name, _FILE), name, f"{_FILE}: {name}.")


def _read(document: Table, name: str, prefix: str) -> Uncertainty:
    _refuse_unknown(document, _SECTIONS, prefix.rstrip(".: "))
    sections = {key: _section(document, key, prefix) for key in _SECTIONS if key != "vehicles"}
    vehicles = _read_vehicles(document, prefix)
    traffic = sections["traffic"]
    where = f"{prefix}traffic"
    fields: dict[str, Any] = {}
    if traffic is not None:
        _refuse_unknown(traffic, _TRAFFIC, where)
        fields = {key: take_number(traffic, key, where) for key in _TRAFFIC}
    elif vehicles:
        raise InputError(f"{prefix}vehicles", Unquoted("no section traffic"), "where they stand")
    return _named(
        prefix,
        lambda: Uncertainty(
            name=name,
            mounting=_read_mounting(sections["mounting"], f"{prefix}mounting"),
            latency=_read_latency(sections["latency"], f"{prefix}latency"),
            packet_loss=_read_loss(sections["messages"], f"{prefix}messages"),
            draws_detections=_read_is_drawn(sections["detector"], f"{prefix}detector"),
            traffic=_named(f"{where}.", lambda: StandingTraffic(vehicles=vehicles, **fields)),
        ),
    )


def _section(document: Table, key: str, prefix: str) -> Table | None:
    table = document.get(key)
    if table is not None and not isinstance(table, dict):
        raise InputError(f"{prefix}{key}", table, f"a section [{key}]")
    return table


def _read_mounting(table: Table | None, where: str) -> MountingErrors:
    if table is None:
        return MountingErrors()
    _refuse_unknown(table, _MOUNTING, where)
    fields = {key: take_number(table, key, where) for key in _MOUNTING}
    return _named(f"{where}.", lambda: MountingErrors(**fields))


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


def _read_loss(table: Table | None, where: str) -> float:
    if table is None:
        return 0.0
    _refuse_unknown(table, ("packet_loss",), where)
    loss = take_number(table, "packet_loss", where)
    if not 0.0 <= loss <= 1.0:
        raise InputError(f"{where}.packet_loss", loss, "0 to 1")
    return loss


def _read_is_drawn(table: Table | None, where: str) -> bool:
    if table is None:
        return False
    _refuse_unknown(table, ("is_drawn",), where)
    is_drawn = take(table, "is_drawn", where)
    if not isinstance(is_drawn, bool):
        raise InputError(f"{where}.is_drawn", is_drawn, "true or false")
    return is_drawn


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


def _refuse_unknown(table: Table, known: tuple[str, ...], where: str) -> None:
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
