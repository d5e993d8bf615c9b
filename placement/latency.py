"""Latency from a frame to the onset of braking: budgets, and APR by the total latency."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, take_list, take_number, take_text
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, onset_times_s

from .evaluation import Evaluation, earliest_arrival_s

# ---------- budgets: what passes between a frame and the onset of braking, part by part


DEFAULT_LATENCY_BUDGET = "study"
MAX_LATENCY_S = 10.0
"""Longer than any run: a larger number is probably in milliseconds."""

_MAX_RANGES = 8  # the distribution of their sum has 2^n terms
_FILE = "latency.toml"
_FIXED, _RANGE, _REASONS = ("fixed_s",), ("low_s", "high_s"), ("source", "assumption")


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyPart:
    """One of the steps that take time."""

    name: str
    # low_s, high_s: anything between is equally likely; a fixed value where they are equal. [s]
    low_s: float
    high_s: float
    source: str  # where the numbers come from, or why they are likely
    is_assumption: bool = False  # whether they are an assumption of this project

    def __post_init__(self) -> None:
        if not (self.name.strip() and self.name.isprintable()):
            raise InputError("name", self.name, "printable text")
        for field in _RANGE:
            if not 0.0 <= getattr(self, field) <= MAX_LATENCY_S:
                raise InputError(
                    f"{self.name}.{field}", getattr(self, field), f"0 to {MAX_LATENCY_S:g} seconds"
                )
        if self.low_s > self.high_s:
            raise InputError(f"{self.name}.high_s", self.high_s, f"at least low_s, {self.low_s}")
        if not self.source.strip():
            raise InputError(f"{self.name}.source", self.source, "text")

    @property
    def is_fixed(self) -> bool:
        """Whether it always takes the same time."""
        return self.low_s == self.high_s


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyBudget:
    """Parts that add up, each independent of the others.

    Attributes
    ----------
    name : str
        Name.
    parts : tuple of LatencyPart
        In the order in which they happen; names are unique.
    """

    name: str
    parts: tuple[LatencyPart, ...]

    def __post_init__(self) -> None:
        where = f"{self.name}.parts"
        if not self.parts:
            raise InputError(where, Unquoted("none"), "at least one")
        names = [part.name for part in self.parts]
        for name in names:
            if names.count(name) > 1:
                raise InputError(where, Unquoted(f"{name!r} twice"), "every name once")
        n_ranges = sum(not part.is_fixed for part in self.parts)
        if n_ranges > _MAX_RANGES:
            raise InputError(where, Unquoted(f"{n_ranges} ranges"), f"at most {_MAX_RANGES}")

    @property
    def best_s(self) -> float:
        """The shortest total, in seconds."""
        return math.fsum(part.low_s for part in self.parts)

    @property
    def mean_s(self) -> float:
        """The total to expect, in seconds."""
        return 0.5 * math.fsum(end for part in self.parts for end in (part.low_s, part.high_s))

    @property
    def worst_s(self) -> float:
        """The longest total, in seconds."""
        return math.fsum(part.high_s for part in self.parts)

    def sample_s(self, rng: np.random.Generator, size: int | tuple[int, ...]) -> FloatArray:
        """Draw totals, (*size), between :attr:`best_s` and :attr:`worst_s`, in seconds."""
        shape = (size,) if isinstance(size, int) else size
        low, high = np.array([(part.low_s, part.high_s) for part in self.parts]).T
        total = rng.uniform(low, high, size=(*shape, len(self.parts))).sum(axis=-1)
        drawn: FloatArray = np.clip(total, self.best_s, self.worst_s)  # sums round
        return drawn

    def share_within(self, latency_s: ArrayLike) -> FloatArray:
        """Probability (...,) that the total is at most `latency_s` (...,); exact, not drawn.

        0 below :attr:`best_s`, 1 from :attr:`worst_s` on, each with the tolerance of
        :func:`scenarios.aeb.is_in_time`. Between, n ranges of widths w_i above the shortest total:
        sum over their subsets S of (-1)^|S| max(0, x - sum of w in S)^n / (n! prod w_i).

        References
        ----------
        .. [1] E. G. Olds, "A note on the convolution of uniform distributions", Annals of
           Mathematical Statistics 23 (1952), 282-285.
        """
        given = np.asarray(latency_s, dtype=np.float64)
        limits = given.ravel()
        share = is_in_time(0.0, limits, latency_s=self.worst_s).astype(np.float64)
        between = (share == 0.0) & is_in_time(0.0, limits, latency_s=self.best_s)
        distinct, index = np.unique(limits[between], return_inverse=True)
        share[between] = self._shares_between(distinct.tolist())[index]
        return share.reshape(given.shape)

    def _shares_between(self, limits_s: list[float]) -> FloatArray:
        """The formula in whole numbers: its terms are large and nearly cancel out."""
        exact = [(Fraction(part.low_s), Fraction(part.high_s)) for part in self.parts]
        above = [Fraction(limit) - sum(low for low, _ in exact) for limit in limits_s]
        widths = [high - low for low, high in exact if high > low]
        unit = math.lcm(*(value.denominator for value in (*above, *widths)))
        terms = {0: 1}  # sum of a subset's widths: how often, with its sign
        for width in widths:
            for sum_of_widths, sign in list(terms.items()):
                longer = sum_of_widths + int(width * unit)
                terms[longer] = terms.get(longer, 0) - sign
        n = len(widths)
        whole = math.factorial(n) * math.prod(int(width * unit) for width in widths)
        shares = [
            Fraction(sum(sign * max(0, int(x * unit) - by) ** n for by, sign in terms.items()))
            / whole
            for x in above
        ]
        return np.array([float(min(max(share, Fraction(0)), Fraction(1))) for share in shares])


def fixed_latency(latency_s: float) -> LatencyBudget:
    """A budget of a single number."""
    part = LatencyPart(name="latency", low_s=latency_s, high_s=latency_s, source="as given")
    return LatencyBudget(name=f"{1000.0 * latency_s:g} ms", parts=(part,))


def load_latency_budget(
    name_or_path: str = DEFAULT_LATENCY_BUDGET, *, where: str = "latency budget"
) -> LatencyBudget:
    """Latency budget by a name of ``data/latency.toml``, or from a TOML file of that layout.

    `where` says what named it, for error messages. Raises InputError if the name is unknown, or the
    file, a part or a field is not what it should be.
    """
    known = load_latency_budgets()
    if name_or_path in known:
        return known[name_or_path]
    path = Path(name_or_path)
    if path.suffix != ".toml":
        names = ", ".join(known)
        raise InputError(where, name_or_path, f"{names}, or a .toml file with a latency budget")
    budgets = _read_budgets(load_toml(path), str(path))
    if len(budgets) != 1:
        got = ", ".join(budgets) or "no budget"
        raise InputError(str(path), Unquoted(got), "one budget: a table such as [mine] with parts")
    return next(iter(budgets.values()))


@cache
def load_latency_budgets() -> Mapping[str, LatencyBudget]:
    """Budgets by name, from ``data/latency.toml``."""
    return _read_budgets(load_toml(files(__package__) / "data" / _FILE), _FILE)


def _read_budgets(document: Table, file: str) -> dict[str, LatencyBudget]:
    budgets = {}
    for name, table in document.items():
        where = f"{file}: {name}"
        if not isinstance(table, dict):
            raise InputError(where, table, "a table with parts")
        _refuse_unknown(table, ("parts",), where)
        parts = []
        for index, entry in enumerate(take_list(table, "parts", where)):
            if not isinstance(entry, dict):
                raise InputError(f"{where}.parts[{index}]", entry, "a table")
            part_name = take_text(entry, "name", f"{where}.parts[{index}]")
            with _errors_name(f"{where}."):
                parts.append(_read_part(entry, part_name))
        with _errors_name(f"{file}: "):
            budgets[name] = LatencyBudget(name=name, parts=tuple(parts))
    return budgets


def _read_part(entry: Table, name: str) -> LatencyPart:
    _refuse_unknown(entry, ("name", *_FIXED, *_RANGE, *_REASONS), name)
    if not any(key in entry for key in (*_FIXED, *_RANGE)):
        raise InputError(name, Unquoted("no time"), "fixed_s, or low_s and high_s")
    ends = _FIXED * 2 if "fixed_s" in entry else _RANGE
    for key in _RANGE:
        if key in entry and key not in ends:
            raise InputError(f"{name}.{key}", Unquoted("it beside fixed_s"), "one of them")
    low_s, high_s = (take_number(entry, key, name) for key in ends)
    if "fixed_s" in entry and not 0.0 <= low_s <= MAX_LATENCY_S:
        raise InputError(f"{name}.fixed_s", low_s, f"0 to {MAX_LATENCY_S:g} seconds")
    reasons = [key for key in _REASONS if key in entry]
    if len(reasons) != 1:
        got = " and ".join(reasons) or "neither"
        raise InputError(name, Unquoted(got), "either source or assumption")
    return LatencyPart(
        name=name,
        low_s=low_s,
        high_s=high_s,
        source=take_text(entry, reasons[0], name),
        is_assumption=reasons == ["assumption"],
    )


def _refuse_unknown(table: Table, known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise InputError(f"{where}.{key}", Unquoted("an unknown key"), ", ".join(known))


@contextmanager
def _errors_name(place: str) -> Iterator[None]:
    """Put the name of a file, or of an entry in it, before the place that an error names."""
    try:
        yield
    except InputError as error:
        raise InputError(place + error.where, error.got, error.expected) from None


# ---------- APR against the total latency


_DECIMALS = 9  # of a second: as fine as the tolerance of is_in_time


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LatencyCurve:
    """The effect of latency on one sensing party."""

    # (n_runs,): longest latency with which each run is still avoided. Negative: with none; minus
    # infinity: never confirmed, or no braking avoids; infinite: with any. [s]
    last_latency_s: FloatArray
    weight: FloatArray  # (n_runs,): of the runs

    def __post_init__(self) -> None:
        for name in ("last_latency_s", "weight"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    def apr(self, latency_s: ArrayLike) -> FloatArray:
        """Accident prevention ratio (...,) if every message takes `latency_s` (...,)."""
        latencies = np.asarray(latency_s, dtype=np.float64)
        ratios = [
            weight_share(is_in_time(0.0, self.last_latency_s, latency_s=latency), self.weight)
            for latency in latencies.ravel().tolist()
        ]
        return np.array(ratios).reshape(latencies.shape)

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """The whole curve: limits (n_steps,) in seconds, ascending, and APR (n_steps,), descending.

        Value i holds for latencies above limit i - 1 - from 0 on for the first one - up to and
        including limit i; the last limit is infinite.
        """
        last = self.last_latency_s[(self.weight > 0.0) & np.isfinite(self.last_latency_s)]
        # What is just in time with no latency counts, and its step is at 0.
        last = np.maximum(last[is_in_time(0.0, last, latency_s=0.0)], 0.0)
        until = np.append(np.unique(last.round(_DECIMALS)), np.inf)
        return until, self.apr(until)

    def longest_latency_s(self, apr: float) -> float:
        """Longest latency with which the APR is at least `apr`, in seconds.

        Infinite: the APR never falls below; minus infinity: it is lower even without latency.
        """
        until, ratios = self.steps()
        holds = ratios >= apr - 1.0e-12  # ratios of rounded sums
        return float(until[holds][-1]) if holds.any() else -math.inf

    def expected_apr(self, budget: LatencyBudget) -> float:
        """Expected accident prevention ratio if the latency follows a budget; exact, not drawn.

        sum of w_r P(latency <= last latency of r) / sum of w_r; NaN if there is no weight. All
        messages of a run take equally long, whoever sends them: frames and CPM generation are
        periodic, so that their phase does not change.
        """
        total = math.fsum(self.weight)
        if total <= 0.0:
            return math.nan
        return math.fsum(self.weight * budget.share_within(self.last_latency_s)) / total


def apr_by_latency(
    evaluation: Evaluation, rule: AebRule, *, vut_latency_s: float | None = None
) -> dict[str, LatencyCurve]:
    """How the APR of every sensing party depends on the latency from a frame to braking.

    Detected frames do not depend on it, so one evaluation is enough; the rule's latency does not
    count. The VUT's own sensors wait for no message: `vut_latency_s` [s]; by default they take as
    long as all others, as in the study.

    Keys are "vut", each unit's id, "rsu_all", "vut_and_rsus" and so on. At latency L a curve says
    what an evaluation with ``replace(rule, latency_s=L)`` does by the last brake time: a unit with
    a latency of its own keeps it at every L, so that its curve is flat. Fused parties mix both
    kinds frame by frame. Raises InputError if `vut_latency_s` is negative or not finite.
    """
    if vut_latency_s is not None and not 0.0 <= vut_latency_s < math.inf:
        raise InputError("vut_latency_s", vut_latency_s, "seconds, at least 0")
    units = {
        unit.id: (evaluation.units[unit.id].detected, unit.latency_s)
        for unit in evaluation.layout.units
    }
    vut = (evaluation.vut.detected, vut_latency_s)
    parties = {
        "vut": [vut],
        **{name: [unit] for name, unit in units.items()},
        "rsu_all": [*units.values()],
        "vut_and_rsus": [*units.values(), vut],
    }
    if "vam" in evaluation.others:
        vam = (evaluation.others["vam"].detected, None)
        parties |= {"vam": [vam], "all_sources": [*units.values(), vut, vam]}
    return {
        name: LatencyCurve(
            last_latency_s=_last_latency_s(fused, evaluation.axis, rule),
            weight=evaluation.axis.weight,
        )
        for name, fused in parties.items()
    }


def _last_latency_s(
    parties: Sequence[tuple[BoolArray, float | None]], axis: FrameAxis, rule: AebRule
) -> FloatArray:
    """Longest latency of parties without their own, with which each run is still avoided.

    A frame that a party with its own latency reports in time costs the others nothing: it counts as
    known at all times. The window that is known first is then the one that leaves most time.
    """
    last_brake_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    frame_s = earliest_arrival_s(
        [(detected, 0.0) for detected, own_s in parties if own_s is None], axis
    )
    for detected, own_s in parties:
        if own_s is not None:
            frame_s[detected & is_in_time(axis.time_s, last_brake_s, latency_s=own_s)] = -np.inf
    _, confirmed_s = onset_times_s(frame_s, axis, n_confirmations=rule.n_confirmations)
    last: FloatArray = axis.last_brake_time_s - confirmed_s
    return last
