"""The placement problem on a detection table, and what a set of poses is worth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import chain, combinations
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, check_one_of, refuse
from geometry.phrases import Phrase
from scenarios.aeb import TIME_TOLERANCE_S, AebRule
from scenarios.confirmation import is_in_time
from scenarios.runs import FrameAxis, live_confirmation_times_s

from ..detection_table import DetectionTable
from .allowed_sets import Limits, cost_eur, is_allowed
from .constants import (
    COST_TOLERANCE_EUR,
    FAR_APART,
    TIES_OF_TIES,
    TOLERANCE,
    are_sums_apart,
    common_step,
)

Goal = Literal["best", "fewest", "cheapest"]


class Objective(StrEnum):
    """Something that a layout is optimised for; its value is its name in JSON."""

    UNITS = "units"
    COST = "cost_eur"
    APR_SURVIVED = "apr_survived"
    APR = "apr"
    APR_ONE_FAILED = "apr_one_failed"
    SMALLEST_MARGIN = "smallest_margin_s"
    MEAN_MARGIN = "mean_margin_s"

    @property
    def label(self) -> Phrase:
        """Name in reports."""
        return _LABELS[self]

    @property
    def unit(self) -> str:
        """Unit of its values; empty for counts and shares."""
        if self is Objective.COST:
            return "EUR"
        if self in (Objective.SMALLEST_MARGIN, Objective.MEAN_MARGIN):
            return "s"
        return ""

    @property
    def is_minimised(self) -> bool:
        """True if less is better."""
        return self in (Objective.UNITS, Objective.COST)

    @property
    def tolerance(self) -> float:
        """Values that differ by no more are equal."""
        if self is Objective.COST:
            return COST_TOLERANCE_EUR
        return TOLERANCE

    def excess(self, value: float, other: float) -> float:
        """By how much a value is better than another one; negative if it is worse.

        >>> Objective.APR.excess(0.75, 0.5), Objective.UNITS.excess(3.0, 2.0)
        (0.25, -1.0)
        """
        if self.is_minimised:
            return other - value
        return value - other

    def better(self, value: float, other: float) -> float:
        """The better one of two values."""
        if self.is_minimised:
            return min(value, other)
        return max(value, other)

    def worse(self, value: float, other: float) -> float:
        """The worse one of two values."""
        if self.is_minimised:
            return max(value, other)
        return min(value, other)


# City pages have their own words for stages: `objectives` in sections.html.j2.
_LABELS = {
    Objective.UNITS: Phrase("units"),
    Objective.COST: Phrase("cost"),
    Objective.APR_SURVIVED: Phrase("APR if the most needed units fail"),
    Objective.APR: Phrase("APR"),
    Objective.APR_ONE_FAILED: Phrase("APR if the most needed unit fails"),
    Objective.SMALLEST_MARGIN: Phrase("smallest time to spare"),
    Objective.MEAN_MARGIN: Phrase("mean time to spare"),
}
VALUE_OBJECTIVES = (
    Objective.APR,
    Objective.APR_ONE_FAILED,
    Objective.SMALLEST_MARGIN,
    Objective.MEAN_MARGIN,
    Objective.COST,
)
"""Objectives by which layouts are compared by default, in this order."""


def objectives_in_order(goal: Goal, *, survive: int) -> tuple[Objective, ...]:
    """Stages of a problem: the goal, the APR that survives failures, the usual ones.

    The cost stands in it once: first where the cheapest layout is asked for, else
    last.

    >>> [str(objective) for objective in objectives_in_order("fewest", survive=1)][:3]
    ['units', 'apr_survived', 'apr']
    """
    goals = {"best": (), "fewest": (Objective.UNITS,), "cheapest": (Objective.COST,)}
    first: tuple[Objective, ...] = goals[goal]
    if survive:
        first = (*first, Objective.APR_SURVIVED)
    usual = [objective for objective in VALUE_OBJECTIVES if objective not in first]
    return (*first, *usual)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measure:
    """Accident prevention ratio of what is avoided.

    With a tail, this is the conditional value at risk [1]_: the mean over the worst
    share, in which one world may count in part.

    Attributes
    ----------
    weight : (n_runs,) float
        Of the runs that can be avoided; what counts weighs 1 in all.
    sample_index : (n_runs,) int
        Sampled world of each run; all 0 where nothing was sampled.
    sample_weight : (n_samples,) float
        What all runs of each world weigh together, also those that nothing avoids.
    tail : float
        Share of the worlds that counts, the worst ones: 1 for the mean,
        1 / n_samples for the worst.

    References
    ----------
    .. [1] R. T. Rockafellar, S. Uryasev, "Optimization of conditional
       value-at-risk", 2000.
    """

    weight: FloatArray
    sample_index: IntArray
    sample_weight: FloatArray
    tail: float = 1.0

    @property
    def is_mean(self) -> bool:
        """True if this is a plain weighted sum of runs."""
        return self.tail == 1.0

    def of(self, is_avoided: BoolArray) -> FloatArray:
        """Ratio of each set of avoided runs: (..., n_runs) -> (...,)."""
        if self.is_mean:
            return is_avoided @ self.weight
        return self.of_worlds(self.by_world(is_avoided))

    def by_world(self, is_avoided: BoolArray) -> FloatArray:
        """Weight of avoided runs in each world: (..., n_runs) -> (..., n_samples)."""
        n_samples = len(self.sample_weight)
        by_sample = np.zeros((*is_avoided.shape[:-1], n_samples))
        for sample in range(n_samples):
            mine = self.sample_index == sample
            by_sample[..., sample] = is_avoided[..., mine] @ self.weight[mine]
        return by_sample

    def of_worlds(self, by_sample: FloatArray) -> FloatArray:
        """Ratio from the weight of avoided runs by world.

        `by_sample` is (..., n_samples), or of all worlds together, (..., 1), for a
        mean. Returns (...,).
        """
        if self.is_mean:
            return np.asarray(by_sample.sum(axis=-1))
        ratio = by_sample / self.sample_weight
        # The worst first, up to the tail.
        order = np.argsort(ratio, axis=-1, kind="stable")
        ends = np.minimum(np.cumsum(self.sample_weight[order], axis=-1), self.tail)
        worst_first = np.take_along_axis(ratio, order, axis=-1)
        counted = np.diff(ends, axis=-1, prepend=0.0) * worst_first
        return np.asarray(counted.sum(axis=-1) / self.tail)

    @property
    def limit(self) -> float:
        """Ratio where all runs that can be avoided are."""
        return float(self.of(np.ones(len(self.weight), dtype=bool)))

    @property
    def tells_runs_apart(self) -> bool:
        """True if a set that avoids more runs never ties with one that avoids fewer.

        The mean over all runs does, if each weighs more than two ties are apart.
        """
        return self.is_mean and bool((self.weight > FAR_APART).all())

    def least_tied(self, value: float) -> float:
        """The least that a set is worth which ties with the one found, worth `value`.

        The one found may be a tie worse than what it was held against, so that it is
        two ties less; `value` itself where ties are equal: where the sums of weights
        are too far apart, or a set that loses any run is worth less.
        """
        least = value - TIES_OF_TIES * TOLERANCE
        if not self.is_mean or not len(self.weight):
            return least
        loses_one = float(self.weight.sum() - self.weight.min())
        is_exact = least > loses_one or are_sums_apart(self.weight)
        if is_exact:
            return value
        return least

    @property
    def step(self) -> float:
        """Step of which all ratios are whole multiples; 0 where that is not known."""
        if self.is_mean:
            return common_step(self.weight)
        return 0.0

    def of_runs(self, runs: IntArray) -> "Measure":
        """Measure where all other runs are out of reach."""
        return replace(
            self, weight=self.weight[runs], sample_index=self.sample_index[runs]
        )


def build_measure(
    weight: FloatArray, sample_index: ArrayLike | None = None, *, tail: float = 1.0
) -> Measure:
    """Measure of runs with weights, (n_runs,), and the sampled world of each, 0, 1, ..

    By default there is one world. Raises InputError unless 0 < tail <= 1, and worlds
    have weight.
    """
    if not 0.0 < tail <= 1.0:
        raise InputError("tail", tail, "a share of the samples, 0 < share <= 1")
    if sample_index is None:
        samples = np.zeros(len(weight))
    else:
        samples = np.array(sample_index)
    samples = samples.astype(np.int64)
    if samples.shape != np.shape(weight) or (samples.size and samples.min() < 0):
        refuse("sample_index", "other samples", "one, from 0, for each run")
    total = np.bincount(samples, weights=weight)
    if not (total > 0.0).all():
        refuse("sample_index", "a sample without weight", "runs in each sample")
    return Measure(
        weight=freeze(np.array(weight, dtype=np.float64)),
        sample_index=freeze(samples),
        sample_weight=freeze(total / total.sum()),
        tail=float(tail),
    )


# ---------- the problem and the value of a set
Fusion = Literal["any", "single"]


class PlacementValue(NamedTuple):
    """What a set of poses is worth: compared from left to right.

    Attributes
    ----------
    apr : float
        Accident prevention ratio, 0..1.
    apr_one_failed : float
        The same when the most painful one of the units fails.
    smallest_margin_s : float
        Of the avoided runs; 0 if there is none. [s]
    mean_margin_s : float
        Of the avoided runs, by their weights; 0 if there is none. [s]
    cost_eur : float
        Units, and sites once; the less the better. [EUR]
    """

    apr: float
    apr_one_failed: float
    smallest_margin_s: float
    mean_margin_s: float
    cost_eur: float

    def of(self, objective: Objective) -> float:
        """Value of one of :data:`placement.optimiser.problem.VALUE_OBJECTIVES`."""
        return float(getattr(self, objective.value))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Floor:
    """An accident prevention ratio that must be reached.

    Attributes
    ----------
    name : str
        Who asks for it, such as "--target", for messages.
    share : float
        The ratio, 0..1.
    is_counted : (n_runs,) bool, optional
        Runs that count, such as those of a case; by default all, by the problem's own
        measure.
    n_failures : int
        It must still be reached when any so many units fail.
    """

    name: str
    share: float
    is_counted: BoolArray | None = None
    n_failures: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise InputError(self.name, self.share, "a share of the runs, 0 to 1")
        if self.n_failures < 0:
            raise InputError(
                "survive", self.n_failures, "units that may fail, at least 0"
            )

    def __repr__(self) -> str:
        return f"Floor({self.name!r}, {self.share:g}, {self.n_failures} failures)"


# Held weakly: it is part of many fingerprints.
@dataclass(frozen=True, slots=True, weakref_slot=True, kw_only=True, eq=False)
class PlacementProblem:
    """Which poses to mount, given what each detects.

    Attributes
    ----------
    table : DetectionTable
        V[c, f].
    limits : Limits
        What may be mounted together.
    fusion : {"any", "single"}
        "any": a frame counts if any unit detects; "single": one unit must confirm
        alone.
    rule : AebRule
        Confirmation and latency.
    floors : tuple of Floor
        What must be reached in any case.
    goal : {"best", "fewest", "cheapest"}
        "fewest", "cheapest": of the sets that reach the floors only those with the
        fewest units, or of the least cost, are looked at; then the best of them.
    survive : int
        If not 0, the APR when so many units fail is the first objective.
    sample_index : (n_runs,) int, optional
        Sampled world of each run.
    tail : float
        See :class:`Measure`: how the APR sums up the sampled worlds.
    seen_by_vut : (n_frames,) bool, optional
        Frames in which the VUT's own sensors detect. They are in every set, also in
        that of no pose, and never fail. None: cars are blind.
    """

    table: DetectionTable
    limits: Limits
    fusion: Fusion
    rule: AebRule
    floors: tuple[Floor, ...] = ()
    goal: Goal = "best"
    survive: int = 0
    sample_index: IntArray | None = None
    tail: float = 1.0
    seen_by_vut: BoolArray | None = None

    def __post_init__(self) -> None:
        n_poses = self.table.n_poses
        if self.limits.n_poses != n_poses:
            refuse("site_index", f"{self.limits.n_poses} poses", f"{n_poses} poses")
        if (self.table.axis.last_brake_time_s == np.inf).any():
            raise InputError("last_brake_time_s", np.inf, "a time, or minus infinity")
        check_one_of("fusion", self.fusion, get_args(Fusion))
        check_one_of("goal", self.goal, get_args(Goal))
        if self.survive < 0:
            raise InputError("survive", self.survive, "units that may fail, at least 0")
        axis = self.table.axis
        if self.seen_by_vut is not None:
            object.__setattr__(
                self, "seen_by_vut", freeze(np.array(self.seen_by_vut, dtype=bool))
            )
        flags = [("seen_by_vut", self.seen_by_vut, axis.n_frames, "frame")]
        flags += [
            (floor.name, floor.is_counted, axis.n_runs, "run") for floor in self.floors
        ]
        for name, flag, size, noun in flags:
            if flag is not None and flag.shape != (size,):
                refuse(name, f"shape {flag.shape}", f"a flag for each {noun}")
        # Checks samples and tail.
        self.measure()

    @property
    def objectives(self) -> tuple[Objective, ...]:
        """Stages in the order in which they are optimised."""
        return objectives_in_order(self.goal, survive=self.survive)

    def detected(self, pose_index: Sequence[int]) -> BoolArray:
        """V[c, f] of some poses, (n, n_frames), the last row that of a seeing VUT."""
        detected = self.table.detected(list(pose_index))
        if self.seen_by_vut is None:
            return detected
        return np.vstack([detected, self.seen_by_vut])

    def measure(self) -> Measure:
        """The accident prevention ratio, as a function of the runs that are avoided."""
        return build_measure(self.table.axis.weight, self.sample_index, tail=self.tail)

    def floor_measure(self, floor: Floor) -> Measure:
        """Measure of a floor: of all runs, or of its own by their weights."""
        if floor.is_counted is None:
            return self.measure()
        weight = np.where(floor.is_counted, self.table.axis.weight, 0.0)
        total = float(weight.sum())
        if total == 0.0:
            refuse(floor.name, "runs without weight", "a run that counts")
        return build_measure(weight / total)

    def __repr__(self) -> str:
        return f"PlacementProblem({self.goal}, {self.limits!r}, fusion {self.fusion!r})"


def is_feasible(problem: PlacementProblem, pose_index: Sequence[int]) -> bool:
    """True if poses are distinct, within all limits, and reach all floors."""
    if not is_allowed(problem.limits, list(pose_index)):
        return False
    return all(
        floor_value(problem, floor, pose_index) >= floor.share - TOLERANCE
        for floor in problem.floors
    )


def floor_value(
    problem: PlacementProblem, floor: Floor, pose_index: Sequence[int]
) -> float:
    """Share of a floor's runs that a set of poses avoids, 0..1."""
    return _left_after_failures(
        problem, problem.floor_measure(floor), pose_index, floor.n_failures
    )


def run_margins_s(problem: PlacementProblem, pose_index: Sequence[int]) -> FloatArray:
    """Last brake time - (confirmation + latency) of every run, (n_runs,).

    It is that of the track that is alive at the last moment; minus infinity if
    there is none. Limits do not matter. No poses at all are what the VUT detects by
    itself, if it sees. [s]
    """
    axis = problem.table.axis
    rule = problem.rule
    detected = problem.detected(pose_index)
    if len(detected) == 0:
        return np.full(axis.n_runs, -np.inf)
    if problem.fusion == "any":
        detected = np.logical_or.reduce(detected, axis=0, keepdims=True)
    confirmed = live_confirmation_times_s(detected, axis, rule=rule).min(axis=0)
    in_time = np.isfinite(confirmed)
    margin = np.full(axis.n_runs, -np.inf)
    margin[in_time] = axis.last_brake_time_s[in_time] - (
        confirmed[in_time] + rule.latency_s
    )
    return margin


def apr(problem: PlacementProblem, pose_index: Sequence[int]) -> float:
    """Accident prevention ratio of a set of poses, 0..1."""
    return float(problem.measure().of(run_margins_s(problem, pose_index) > -np.inf))


def apr_one_failed(problem: PlacementProblem, pose_index: Sequence[int]) -> float:
    """Smallest APR that is left when one of the poses fails, 0..1."""
    return apr_failed(problem, pose_index, 1)


def apr_failed(
    problem: PlacementProblem, pose_index: Sequence[int], n_failures: int
) -> float:
    """Smallest APR that is left when so many of the poses fail, 0..1."""
    return _left_after_failures(problem, problem.measure(), pose_index, n_failures)


def _left_after_failures(
    problem: PlacementProblem,
    measure: Measure,
    pose_index: Sequence[int],
    n_failures: int,
) -> float:
    """Smallest value that is left when so many units, or sites, fail."""
    site_of = problem.limits.site_index
    at_once: dict[int, list[int]] = {}
    for pose in pose_index:
        if problem.limits.failing == "unit":
            key = pose
        else:
            key = int(site_of[pose])
        at_once.setdefault(key, []).append(pose)
    n_left = max(len(at_once) - n_failures, 0)
    smallest = np.inf
    for groups in combinations(at_once.values(), n_left):
        left = list(chain.from_iterable(groups))
        is_avoided = run_margins_s(problem, left) > -np.inf
        smallest = min(smallest, float(measure.of(is_avoided)))
    return smallest


def placement_value(
    problem: PlacementProblem, pose_index: Sequence[int]
) -> PlacementValue:
    """Value of a set of poses; runs without weight do not count."""
    weight = problem.table.axis.weight
    margin = run_margins_s(problem, pose_index)
    counts = (margin > -np.inf) & (weight > 0.0)
    cost = cost_eur(problem.limits, pose_index)
    if not counts.any():
        return PlacementValue(0.0, 0.0, 0.0, 0.0, cost)
    return PlacementValue(
        apr=float(problem.measure().of(counts)),
        apr_one_failed=apr_one_failed(problem, pose_index),
        smallest_margin_s=float(margin[counts].min()),
        mean_margin_s=float(np.average(margin[counts], weights=weight[counts])),
        cost_eur=cost,
    )


def objective_values(
    problem: PlacementProblem, pose_index: Sequence[int]
) -> dict[Objective, float]:
    """Values of a set of poses in all objectives of a problem, in their order."""
    value = placement_value(problem, pose_index)
    values = {objective: value.of(objective) for objective in VALUE_OBJECTIVES}
    values[Objective.UNITS] = float(len(pose_index))
    if problem.survive:
        values[Objective.APR_SURVIVED] = apr_failed(
            problem, pose_index, problem.survive
        )
    return {objective: values[objective] for objective in problem.objectives}


def is_better(value: PlacementValue, other: PlacementValue) -> bool:
    """True if the first difference that exceeds rounding noise favours `value`.

    >>> value = PlacementValue(1.0, 0.5, 0.2, 0.3, 9.0)
    >>> is_better(value, PlacementValue(1.0, 0.5, 0.1, 0.9, 0.0))
    True
    """
    values = {objective: value.of(objective) for objective in VALUE_OBJECTIVES}
    others = {objective: other.of(objective) for objective in VALUE_OBJECTIVES}
    return improves(values, others)


def improves(
    values: Mapping[Objective, float], others: Mapping[Objective, float]
) -> bool:
    """True if the first difference that exceeds rounding noise favours `values`.

    >>> improves({Objective.UNITS: 2.0}, {Objective.UNITS: 3.0})
    True
    """
    for objective, value in values.items():
        excess = objective.excess(value, others[objective])
        if abs(excess) > objective.tolerance:
            return excess > 0.0
    return False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Requirement:
    """A value that must be reached; more poses never reach less of it.

    Attributes
    ----------
    measure : Measure
        What is counted, over the runs of the reduced problem.
    least : float
        In the measure's unit; times seconds where margins are summed.
    min_margin_s : float
        Runs that are avoided with less do not count. [s]
    n_failures : int
        It must still be reached when any so many units fail.
    sums_margins : bool
        True if the weights times the margins count instead of the weights.
    """

    measure: Measure
    least: float
    min_margin_s: float = -np.inf
    n_failures: int = 0
    sums_margins: bool = False

    @property
    def needs_all(self) -> bool:
        """True if only avoiding every run that weighs anything reaches it."""
        weight = self.measure.weight[self.measure.weight > 0.0]
        if self.sums_margins or not self.measure.is_mean or not len(weight):
            return False
        has_ties = weight.min() <= FAR_APART
        return bool(not has_ties and self.least > weight.sum() - weight.min() / 2.0)

    def counts_run(self, margin_s: FloatArray) -> BoolArray:
        """Which runs count, being avoided with so much margin."""
        return (margin_s > -np.inf) & (margin_s >= self.min_margin_s - TOLERANCE)

    def reached(self, margin_s: FloatArray) -> FloatArray:
        """Amount that margins reach: (n_sets, n_runs) -> (n_sets,), failures aside."""
        in_time = self.counts_run(margin_s)
        if self.sums_margins:
            return np.where(in_time, margin_s, 0.0) @ self.measure.weight
        return self.measure.of(in_time)


# ---------- windows that end in time, and what keeps them alive
WordArray = NDArray[np.uint64]


class Chains(NamedTuple):
    """Windows of runs in the order of time, and what keeps them alive, for kernels.

    Runs that go through the same windows, to different ends, share a chain.

    Attributes
    ----------
    window_frames : (n_windows, n_confirmations or 1) int
        Merged frames that each window needs, some perhaps twice.
    window : (n_links,) int
        The windows of all chains, chain after chain.
    start : (n_chains + 1,) int
        Links of chain g are ``start[g] .. start[g + 1] - 1``.
    tail_frame : (n_tails,) int
        Merged frames that a chain's first windows need to be live.
    tail_links : (n_tails,) int
        How many windows those are; falling within each chain.
    tail_start : (n_chains + 1,) int
        Tails of each chain.
    """

    window_frames: IntArray
    window: IntArray
    start: IntArray
    tail_frame: IntArray
    tail_links: IntArray
    tail_start: IntArray


def timely_windows_end(
    axis: FrameAxis, rule: AebRule
) -> tuple[IntArray, IntArray, FloatArray]:
    """Windows of frames in a row that end in time, in runs with weight.

    Returns
    -------
    end : (n_windows,) int
        Last frame of each window.
    run : (n_windows,) int
        Its run.
    margin_s : (n_windows,) float
        Margin that it leaves. [s]
    """
    run = run_of_frames(axis)
    last_brake_s = axis.last_brake_time_s[run]
    counts = (
        (np.arange(axis.n_frames) - axis.run_start[run] >= rule.n_confirmations - 1)
        & is_in_time(axis.time_s, last_brake_s, latency_s=rule.latency_s)
        & (axis.weight[run] > 0.0)
    )
    end = np.flatnonzero(counts)
    return end, run[end], last_brake_s[end] - (axis.time_s[end] + rule.latency_s)


def tails_behind(
    axis: FrameAxis, rule: AebRule, end: IntArray, run: IntArray
) -> tuple[IntArray, IntArray]:
    """Frames behind which a track is lost unless one of the next ones is detected.

    Parameters
    ----------
    axis : FrameAxis
        Runs and frames.
    rule : AebRule
        How long a track lives without a detection.
    end, run : (n_windows,) int
        Those of :func:`timely_windows_end`.

    Returns
    -------
    behind : (n_tails,) int
        The frames, ascending. Those from which the memory reaches the last moment
        have no tail.
    last : (n_tails,) int
        The last frame behind each that still comes in time; the frame itself if
        none does.

    Notes
    -----
    A window is live if and only if, from its last frame on, a detection follows
    each of these frames in time. (Of frames that are not detected, that asks no
    more: what comes in time for the one before does.)
    """
    if rule.track_memory_s == np.inf:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    memory_s = rule.track_memory_s + TIME_TOLERANCE_S
    behind = [end[:0]]
    last = [end[:0]]
    of_runs, begin = np.unique(run, return_index=True)
    for of_run, ends in zip(of_runs, np.split(end, begin)[1:], strict=True):
        time_s = axis.time_s[ends]
        until_s = axis.last_brake_time_s[of_run] - rule.latency_s
        ends_too_early = until_s - time_s > memory_s
        behind.append(ends[ends_too_early])
        lost_s = time_s[ends_too_early] + memory_s
        n_before = np.searchsorted(time_s, lost_s, side="right")
        last.append(ends[n_before - 1])
    return np.concatenate(behind), np.concatenate(last)


def run_of_frames(axis: FrameAxis) -> IntArray:
    """Run of each frame, (n_frames,)."""
    return np.repeat(np.arange(axis.n_runs), np.diff(axis.run_start))
