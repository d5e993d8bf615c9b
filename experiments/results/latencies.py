"""The result of a latency sweep: every sensing party's APR against latency."""

from collections.abc import Iterable

from placement.latency import LatencyBudget, LatencyCurve, LatencyPart

from .drives import RefusalRecord
from .record import Record, UnitRecord

SHOWN_LATENCIES_S = (0.0, 0.025, 0.05, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
APR_LEVELS = (1.0, 0.95, 0.9)


class LatencyBudgetRecord(Record, frozen=True, kw_only=True):
    """A distribution of latencies, the sum of its parts."""

    name: str
    best_s: float
    mean_s: float
    worst_s: float
    parts: tuple[LatencyPart, ...]


class LongestLatencyRecord(Record, frozen=True, kw_only=True):
    """Up to which latency an APR is kept: infinite if it never falls below.

    Minus infinity if it is less with none; in JSON both are null, and "is_reached" tells them
    apart.
    """

    apr: float
    latency_s: float
    is_reached: bool


class StepRecord(Record, frozen=True, kw_only=True):
    """APR up to a latency."""

    until_s: float
    apr: float


class AprAtRecord(Record, frozen=True, kw_only=True):
    """APR at a latency."""

    latency_s: float
    apr: float


class LatencyCurveRecord(Record, frozen=True, kw_only=True):
    """A party's APR: over all latencies of the budget, at its mean and worst, and every step."""

    expected: float
    at_mean: float
    at_worst: float
    longest: tuple[LongestLatencyRecord, ...]
    steps: tuple[StepRecord, ...]
    at: tuple[AprAtRecord, ...]


class LatencyResult(Record, frozen=True, kw_only=True):
    """A layout's APR against latency, by sensing party: what ``--json`` prints."""

    name: str
    layout: tuple[UnitRecord, ...]
    runs: int
    budget: LatencyBudgetRecord
    max_latency_s: float
    parties: dict[str, LatencyCurveRecord]
    vut_latency_s: float | None
    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    detector: str
    vut_sensors: tuple[str, ...]
    packet_loss: float
    vam_rate: float
    track_memory_s: float | None = None
    not_driven: tuple[RefusalRecord, ...]
    possible_runs: int
    driven: tuple[str, ...]
    without_effect: tuple[str, ...] = ()
    seconds: dict[str, float]
    versions: dict[str, str]


def build_budget_record(budget: LatencyBudget) -> LatencyBudgetRecord:
    """A latency budget with its least, mean and most."""
    return LatencyBudgetRecord(
        name=budget.name,
        best_s=budget.best_s,
        mean_s=budget.mean_s,
        worst_s=budget.worst_s,
        parts=tuple(budget.parts),
    )


def build_curve_record(
    curve: LatencyCurve, budget: LatencyBudget, max_latency_s: float
) -> LatencyCurveRecord:
    """A curve, with some round latencies up to `max_latency_s`."""
    longest = [(level, curve.longest_latency_s(level)) for level in APR_LEVELS]
    shown_s = [latency_s for latency_s in SHOWN_LATENCIES_S if latency_s <= max_latency_s]
    return LatencyCurveRecord(
        expected=curve.expected_apr(budget),
        at_mean=float(curve.apr(budget.mean_s)),
        at_worst=float(curve.apr(budget.worst_s)),
        longest=tuple(
            LongestLatencyRecord(apr=level, latency_s=latency_s, is_reached=latency_s >= 0.0)
            for level, latency_s in longest
        ),
        steps=tuple(
            StepRecord(until_s=until_s, apr=apr) for until_s, apr in _pairs(*curve.steps())
        ),
        at=tuple(
            AprAtRecord(latency_s=latency_s, apr=apr)
            for latency_s, apr in _pairs(shown_s, curve.apr(shown_s))
        ),
    )


def _pairs(ones: Iterable[float], others: Iterable[float]) -> list[tuple[float, float]]:
    return [(float(one), float(other)) for one, other in zip(ones, others, strict=True)]
