"""Latency from a frame to the onset of braking: budgets, and APR by the total latency."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, take_list, take_number, take_text
from scenarios.aeb import (
    TIME_TOLERANCE_S,
    AebRule,
    confirmation_mask,
    held_frames,
    is_in_time,
)
from scenarios.runs import FrameAxis
from scenarios.scores import Levels
from scenarios.weights import weight_share

from .evaluation import Evaluation

# ---------- budgets: what passes between a frame and the onset of braking, part by part


DEFAULT_LATENCY_BUDGET = "study"
MAX_LATENCY_S = 10.0
"""Longer than any run: a larger number is probably in milliseconds."""

_MAX_RANGES = 8  # the distribution of their sum has 2^n terms
_FILE = "latency.toml"
_FIXED, _RANGE, REASONS = ("fixed_s",), ("low_s", "high_s"), ("source", "assumption")


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
        """True if it always takes the same time."""
        return self.low_s == self.high_s


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyBudget:
    """Parts that add up, each independent of the others."""

    name: str  # name
    parts: tuple[LatencyPart, ...]  # in the order in which they happen; names are unique

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
        refuse_unknown(table, ("parts",), where)
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
    refuse_unknown(entry, ("name", *_FIXED, *_RANGE, *REASONS), name)
    if not any(key in entry for key in (*_FIXED, *_RANGE)):
        raise InputError(name, Unquoted("no time"), "fixed_s, or low_s and high_s")
    ends = _FIXED * 2 if "fixed_s" in entry else _RANGE
    for key in _RANGE:
        if key in entry and key not in ends:
            raise InputError(f"{name}.{key}", Unquoted("it beside fixed_s"), "one of them")
    low_s, high_s = (take_number(entry, key, name) for key in ends)
    if "fixed_s" in entry and not 0.0 <= low_s <= MAX_LATENCY_S:
        raise InputError(f"{name}.fixed_s", low_s, f"0 to {MAX_LATENCY_S:g} seconds")
    source, is_ours = take_reason(entry, name)
    return LatencyPart(name=name, low_s=low_s, high_s=high_s, source=source, is_assumption=is_ours)


def take_reason(table: Table, where: str) -> tuple[str, bool]:
    """Where the numbers of a table come from, and whether that is an assumption of this project."""
    reasons = [key for key in REASONS if key in table]
    if len(reasons) != 1:
        got = " and ".join(reasons) or "neither"
        raise InputError(where, Unquoted(got), "either source or assumption")
    return take_text(table, reasons[0], where), reasons == ["assumption"]


def refuse_unknown(table: Table, known: tuple[str, ...], where: str) -> None:
    """Raise InputError for a key that is not known."""
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
    """The effect of latency on one sensing party.

    A run is avoided with latencies of some intervals. The shorter the latency, the more messages
    arrive; but the later is also the last moment at which a track must be alive. So a run may be
    avoided with a longer latency and not with a shorter one, if tracks do not live for ever.
    """

    # first_latency_s, last_latency_s: (n_intervals,): between these, both included, a run is
    # avoided; those of a run do not overlap. First: at most 0, or minus infinity, where every
    # shorter latency will do, too. Last: negative where even no latency is too much, infinite where
    # any will do. [s]
    first_latency_s: FloatArray
    last_latency_s: FloatArray
    run_index: IntArray  # (n_intervals,): whose interval. A run that no latency avoids has none
    weight: FloatArray  # (n_runs,): of the runs; with a score, of their levels

    def __post_init__(self) -> None:
        for name in ("first_latency_s", "last_latency_s", "run_index", "weight"):
            object.__setattr__(self, name, freeze(getattr(self, name)))

    def apr(self, latency_s: ArrayLike) -> FloatArray:
        """Accident prevention ratio (...,) if every message takes `latency_s` (...,)."""
        latencies = np.asarray(latency_s, dtype=np.float64)
        ratios = []
        for latency in latencies.ravel().tolist():
            holds = is_in_time(self.first_latency_s, latency, latency_s=0.0)
            holds &= is_in_time(0.0, self.last_latency_s, latency_s=latency)
            is_avoided = np.zeros(len(self.weight), dtype=bool)
            is_avoided[self.run_index[holds]] = True
            ratios.append(weight_share(is_avoided, self.weight))
        return np.array(ratios).reshape(latencies.shape)

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """The whole curve: limits (n_steps,) in seconds, ascending, and APR (n_steps,).

        Value i holds for the latencies between limit i - 1 - 0 for the first one - and limit i; the
        last limit is infinite. At a limit itself the higher of the two values holds: that of the
        left where the curve falls, that of the right where it rises, and if runs are lost and won
        at once, more than either.
        """
        # What is just in time with no latency counts, and its step is at 0.
        counts = (self.weight[self.run_index] > 0.0) & is_in_time(
            0.0, self.last_latency_s, latency_s=0.0
        )
        runs = self.run_index[counts]
        first, last = (
            np.maximum(ends[counts], 0.0).round(_DECIMALS)
            for ends in (self.first_latency_s, self.last_latency_s)
        )
        limits = np.unique(np.concatenate([first[first > 0.0], last, [np.inf]]))
        apr = np.empty(len(limits))
        for step, (above_s, until_s) in enumerate(pairwise([0.0, *limits.tolist()])):
            is_avoided = np.zeros(len(self.weight), dtype=bool)
            is_avoided[runs[(first <= above_s) & (last >= until_s)]] = True
            apr[step] = weight_share(is_avoided, self.weight)
        changes = np.append(np.abs(np.diff(apr)) > _SAME_SHARE, True)
        return limits[changes], apr[changes]

    def longest_latency_s(self, apr: float) -> float:
        """Longest latency up to which, from none on, the APR is at least `apr`, in seconds.

        Infinite: the APR never falls below; minus infinity: it is lower even without latency.
        """
        until, ratios = self.steps()
        falls = ratios < apr - _SAME_SHARE
        if not falls.any():
            return math.inf
        step = int(np.argmax(falls))
        return float(until[step - 1]) if step else -math.inf

    def expected_apr(self, budget: LatencyBudget) -> float:
        """Expected accident prevention ratio if the latency follows a budget; exact, not drawn.

        sum over the intervals of w_r P(first <= latency <= last) / sum of w_r; NaN if there is no
        weight. All messages of a run take equally long, whoever sends them: frames and CPM
        generation are periodic, so that their phase does not change.
        """
        total = math.fsum(self.weight)
        if total <= 0.0:
            return math.nan
        # What is shorter than the first by more than the tolerance is too short.
        is_fixed = budget.best_s == budget.worst_s
        too_short_s = self.first_latency_s - 2.0 * TIME_TOLERANCE_S * is_fixed
        shares = budget.share_within(self.last_latency_s) - budget.share_within(too_short_s)
        return math.fsum(self.weight[self.run_index] * np.maximum(shares, 0.0)) / total


_SAME_SHARE = 1.0e-12  # ratios of rounded sums


def apr_by_latency(
    evaluation: Evaluation, rule: AebRule, *, vut_latency_s: float | None = None
) -> dict[str, LatencyCurve]:
    """How the APR of every sensing party depends on the latency from a frame to braking.

    Detected frames do not depend on it, so one evaluation is enough; the rule's latency does not
    count. The VUT's own sensors wait for no message: `vut_latency_s` [s]; by default they take as
    long as all others, as in the study.

    Keys are "vut", each unit's id, "rsu_all", "vut_and_rsus" and so on. At latency L a curve says
    what an evaluation with ``replace(rule, latency_s=L)`` does by the last brake time: a unit with
    a latency of its own keeps it at every L. Fused parties mix both kinds frame by frame. Of an
    evaluation with levels it is the score by the last onset of each level: the levels stand in
    place of the runs. Raises InputError if `vut_latency_s` is negative or not finite.
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
    axis, levels = evaluation.axis, evaluation.levels
    return {name: _build_curve(fused, axis, rule, levels) for name, fused in parties.items()}


def _build_curve(
    parties: Sequence[tuple[BoolArray, float | None]],
    axis: FrameAxis,
    rule: AebRule,
    levels: Levels | None,
) -> LatencyCurve:
    """The curve of parties that are fused, each with a latency of its own or none."""
    last_brake_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    varies, is_known = np.zeros((2, axis.n_frames), dtype=bool)
    for detected, own_s in parties:
        if own_s is None:
            varies |= detected
        else:
            is_known |= detected & is_in_time(axis.time_s, last_brake_s, latency_s=own_s)
    varies &= ~is_known
    of_runs = [
        _intervals_s(varies[frames], is_known[frames], last_brake - axis.time_s[frames], rule)
        if last_brake > -math.inf
        else []
        for run, last_brake in enumerate(axis.last_brake_time_s.tolist())
        for frames in [axis.frames_of(run)]
    ]
    weight = axis.weight
    if levels is not None:
        weight = weight[levels.run_index] * levels.gain
        of_runs = _intervals_of_levels_s(of_runs, parties, axis, rule, levels)
    intervals = [(*ends, index) for index, found in enumerate(of_runs) for ends in found]
    first, last, index = zip(*intervals, strict=True) if intervals else ((), (), ())
    return LatencyCurve(
        first_latency_s=np.array(first, dtype=np.float64),
        last_latency_s=np.array(last, dtype=np.float64),
        run_index=np.array(index, dtype=np.int64),
        weight=weight,
    )


def _intervals_of_levels_s(
    of_runs: Sequence[list[tuple[float, float]]],
    parties: Sequence[tuple[BoolArray, float | None]],
    axis: FrameAxis,
    rule: AebRule,
    levels: Levels,
) -> list[list[tuple[float, float]]]:
    """Latencies with which each level is reached, the longest first.

    A level is reached where its run is avoided, or where a window of frames is known after the last
    moment and by the deadline.
    """
    varies, own_s = np.zeros(axis.n_frames, dtype=bool), np.full(axis.n_frames, np.inf)
    for detected, latency_s in parties:
        if latency_s is None:
            varies |= detected
        else:
            own_s = np.where(detected, np.minimum(own_s, axis.time_s + latency_s), own_s)
    found = []
    for run, deadline_s in zip(levels.run_index.tolist(), levels.deadline_s.tolist(), strict=True):
        intervals, frames = list(of_runs[run]), axis.frames_of(run)
        last_s = float(axis.last_brake_time_s[run])
        if deadline_s > last_s:
            first, last = (
                _longest_by_s(moment_s, varies[frames], own_s[frames], axis.time_s[frames], rule)
                for moment_s in (last_s, deadline_s)
            )
            is_some = (last > first) & (last > -np.inf)
            intervals += zip(first[is_some].tolist(), last[is_some].tolist(), strict=True)
        found.append(_joined(intervals))
    return found


def _longest_by_s(
    moment_s: float, varies: BoolArray, own_s: FloatArray, time_s: FloatArray, rule: AebRule
) -> FloatArray:
    """Longest latency with which each window of frames is known by a moment, in seconds.

    Infinite where messages with a latency of their own suffice, minus infinity where none does.
    """
    waits = own_s > moment_s + TIME_TOLERANCE_S
    last = np.where(waits, np.where(varies, time_s, np.inf), -np.inf)
    if len(last) < rule.n_confirmations:
        return np.empty(0)
    windows = np.lib.stride_tricks.sliding_window_view(last, rule.n_confirmations)
    latest = windows.max(axis=1)
    with np.errstate(invalid="ignore"):  # no moment, and nothing to wait for
        longest = moment_s - latest
    result: FloatArray = np.where(latest == -np.inf, np.inf, longest)
    return result


def _joined(intervals: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Intervals that do not overlap, the longest first."""
    joined: list[tuple[float, float]] = []
    for first, last in sorted(intervals, key=lambda ends: -ends[1]):
        if joined and last >= joined[-1][0] - TIME_TOLERANCE_S:
            joined[-1] = (min(first, joined[-1][0]), joined[-1][1])
        else:
            joined.append((first, last))
    return joined


def _intervals_s(
    varies: BoolArray, is_known: BoolArray, left_s: FloatArray, rule: AebRule
) -> list[tuple[float, float]]:
    """Latencies with which a run is avoided, the longest first.

    All (n_frames,): detected frames whose message takes as long as the latency, those that are
    known in time whatever it is, and the time left from each frame to the last brake time [s].

    With latencies between the times that are left from two of the first kind the known frames are
    the same. Then whether some confirmation is followed by no gap between frames is settled; and
    the track is alive at the last moment if the latency is at least what takes this back to within
    the memory after the last frame. Where the latency falls to the lower of the two times, one more
    frame is known and no track dies: neighbouring intervals join.
    """
    limits = [math.inf, *left_s[varies].tolist(), -math.inf]  # descending
    knows = is_known | (varies & (left_s >= np.array(limits[:-1])[:, None]))
    confirmed = confirmation_mask(knows, n_confirmations=rule.n_confirmations)
    memory_s = rule.track_memory_s
    lives = (confirmed & held_frames(knows, -left_s, until_s=-math.inf, memory_s=memory_s)).any(
        axis=1
    )
    latest_left_s = np.where(knows, left_s, np.inf).min(axis=1)
    intervals: list[tuple[float, float]] = []
    for step in np.flatnonzero(lives).tolist():
        last, below = limits[step], limits[step + 1]
        first = float(latest_left_s[step]) - memory_s
        if first <= below + TIME_TOLERANCE_S:
            first = below
        if first > last:
            continue
        if intervals and intervals[-1][0] == last:
            last = intervals.pop()[1]
        intervals.append((first, last))
    return intervals
