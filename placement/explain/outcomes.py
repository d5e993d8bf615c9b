"""What a layout's detected frames come to: share avoided, without any one unit, time to spare."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    freeze,
)
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, confirmation_times_s, onset_times_s

from ..candidates import CandidatePose
from ..evaluation import leave_each_out
from ..optimiser import PlacementProblem, run_margins_s
from ..optimiser.bitsets import SetValues
from ..optimiser.objectives import TOLERANCE, VALUE_OBJECTIVES
from ..optimiser.problem import Fusion

# ---------- what a layout's detected frames come to


SURE = 0.99
"""A run that chance decides counts as lost where it is avoided with a lower probability."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Watched:
    """Units, what they detect, and how that is judged.

    Attributes
    ----------
    units : tuple of CandidatePose
        At least one. One with a latency of its own keeps it, whatever the rule says.
    detected : (n_units, n_frames) bool
        By each of them.
    axis : FrameAxis
        Runs and frames.
    rule : AebRule
        Confirmation and latency.
    fusion : {"any", "single"}
        "any": a frame counts if any unit detects; "single": one unit must confirm alone.
    """

    units: tuple[CandidatePose, ...]
    detected: BoolArray
    axis: FrameAxis
    rule: AebRule
    fusion: Fusion = "any"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """What a layout is worth.

    Attributes
    ----------
    apr : float
        Accident prevention ratio; where messages are lost by chance, expected. 0 .. 1
    apr_one_failed : float
        What is left of it when the most needed unit fails; 0 of a single unit. 0 .. 1
    smallest_margin_s : float or None
        Least time to spare in the runs that are avoided and count; None where there is none, or
        where chance decides. [s]
    avoided_share : (n_runs,) float
        Probability that each run is avoided: 0 or 1 unless chance decides.
    """

    apr: float
    apr_one_failed: float
    smallest_margin_s: float | None
    avoided_share: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "avoided_share", freeze(self.avoided_share))


def find_outcome(watched: Watched) -> Outcome:
    """What units achieve when every message arrives.

    Parameters
    ----------
    watched : Watched
        Units and frames.
    """
    axis, rule = watched.axis, watched.rule
    arrival_s = np.where(watched.detected, axis.time_s + _latencies_s(watched)[:, None], np.inf)

    left: Iterator[FloatArray]

    def onset_s(arrival: FloatArray) -> FloatArray:
        return onset_times_s(arrival, axis, n_confirmations=rule.n_confirmations)[1]

    if watched.fusion == "any":
        earliest_s, without = leave_each_out(arrival_s)
        onset = onset_s(earliest_s)
        left = (onset if other is earliest_s else onset_s(other) for other in without)
    else:
        onset, left = leave_each_out(np.stack([onset_s(arrival) for arrival in arrival_s]))
    is_avoided = is_in_time(onset, axis.last_brake_time_s, latency_s=0.0)
    apr = weight_share(is_avoided, axis.weight)
    shares = [
        weight_share(is_in_time(other, axis.last_brake_time_s, latency_s=0.0), axis.weight)
        for other in left
    ]
    counts = is_avoided & (axis.weight > 0.0)
    margin = axis.last_brake_time_s[counts] - onset[counts]
    return Outcome(
        apr=apr,
        apr_one_failed=0.0 if len(watched.units) == 1 else min([apr, *shares]),
        smallest_margin_s=float(margin.min()) if counts.any() else None,
        avoided_share=is_avoided.astype(np.float64),
    )


def find_expected_outcome(watched: Watched, *, packet_loss: float) -> Outcome:
    """What units achieve on average when messages are lost, each by itself: exact, not drawn.

    Parameters
    ----------
    watched : Watched
        Units and frames.
    packet_loss : float
        Probability that the message of a unit on a frame does not arrive. 0 .. 1

    Returns
    -------
    outcome : Outcome
        Expected shares. That of the most needed unit is the smallest expectation.

    Notes
    -----
    A run is avoided if messages of n consecutive frames arrive by its last brake time. Frames are
    known independently of one another, with probability 1 - loss^k where k units tell of it in
    time; the number of known frames in a row is then a Markov chain along the run, in which n
    absorbs.
    """
    axis = watched.axis
    last_s = axis.last_brake_time_s.repeat(np.diff(axis.run_start))
    tells = watched.detected & is_in_time(
        axis.time_s + _latencies_s(watched)[:, None], last_s, latency_s=0.0
    )
    n_confirmations = watched.rule.n_confirmations

    def confirmed(n_told: IntArray) -> FloatArray:
        known: FloatArray = 1.0 - packet_loss ** n_told.astype(np.float64)
        return _probability_of_row(known, axis, n_confirmations)

    if watched.fusion == "any":
        total = tells.sum(axis=0)
        avoided = confirmed(total)
        left = (confirmed(total - own) for own in tells if own.any())
    else:
        missed = 1.0 - np.stack([confirmed(own.astype(np.int64)) for own in tells])
        avoided = 1.0 - missed.prod(axis=0)
        others = (np.delete(missed, unit, axis=0) for unit in range(len(missed)))
        left = (1.0 - other.prod(axis=0) for other in others)
    weight = axis.weight / axis.weight.sum()
    apr = float(avoided @ weight)
    return Outcome(
        apr=apr,
        apr_one_failed=0.0
        if len(watched.units) == 1
        else min([apr, *(float(share @ weight) for share in left)]),
        smallest_margin_s=None,
        avoided_share=avoided,
    )


def _latencies_s(watched: Watched) -> FloatArray:
    return np.array([unit.latency(watched.rule) for unit in watched.units])


def _probability_of_row(known: FloatArray, axis: FrameAxis, n_row: int) -> FloatArray:
    """Probability that so many consecutive frames of each run are known, (n_runs,)."""
    lengths = np.diff(axis.run_start)
    is_frame = np.arange(lengths.max()) < lengths[:, None]
    by_run = np.zeros(is_frame.shape)
    by_run[is_frame] = known
    # By how many frames in a row are known up to here; the last column: it has happened.
    state = np.zeros((len(lengths), n_row + 1))
    state[:, 0] = 1.0
    for p in by_run.T:
        done = state[:, n_row] + state[:, n_row - 1] * p
        state[:, 1:n_row] = state[:, : n_row - 1] * p[:, None]
        state[:, n_row] = done
        state[:, 0] = 1.0 - state[:, 1:].sum(axis=1)
    return state[:, n_row]


def runs_lost(planned: Outcome, outcome: Outcome) -> list[int]:
    """Runs that are avoided as planned, and then with less than ``SURE``: their indices."""
    lost = (planned.avoided_share >= SURE) & (outcome.avoided_share < SURE)
    indices: list[int] = np.flatnonzero(lost).tolist()
    return indices


# ---------- many layouts that differ by one pose, on the detection table itself


_BLOCK_POSES = 512  # tens of megabytes of frames


def best_joining(
    problem: PlacementProblem,
    kept: Sequence[int],
    each: IntArray,
    *,
    price_eur: FloatArray | None = None,
) -> int:
    """Which of some poses is the best to join those that are kept.

    Parameters
    ----------
    problem : PlacementProblem
        Table, rule and measure; limits and floors do not matter.
    kept : sequence of int
        Rows of the table; there may be none.
    each : (n_each,) int
        Rows of the table, of which one joins.
    price_eur : (n_each,) float, optional
        Of each; by default all cost the same. [EUR]

    Returns
    -------
    index : int
        Into `each`: best by APR, then APR when one unit fails, smallest and mean margin, price.
    """
    measure, weight = problem.measure(), problem.table.axis.weight
    margin = margins_joined_s(problem, kept, each)
    is_avoided = (margin > -np.inf) & (weight > 0.0)
    apr = measure.of(is_avoided)
    # Failures are costly to go through: only poses with the best APR need it.
    rows = np.flatnonzero(apr >= apr.max() - TOLERANCE)
    left = np.full(len(rows), float(measure.of(run_margins_s(problem, kept) > -np.inf)))
    for failed in kept:
        others = [pose for pose in kept if pose != failed]
        left_then = margins_joined_s(problem, others, each[rows]) > -np.inf
        left = np.minimum(left, measure.of(left_then))
    margin, is_avoided = margin[rows], is_avoided[rows]
    share = is_avoided @ weight
    values = np.zeros((len(rows), 5))
    values[:, 0] = apr[rows]
    values[:, 1] = left
    some = share > 0.0
    values[some, 2] = np.where(is_avoided, margin, np.inf).min(axis=1)[some]
    values[some, 3] = (np.where(is_avoided, margin, 0.0) @ weight)[some] / share[some]
    if price_eur is not None:
        values[:, 4] = -price_eur[rows]
    gains = np.column_stack([np.zeros(len(rows)), values])
    return int(rows[SetValues(VALUE_OBJECTIVES, gains).best_row()])


def margins_joined_s(problem: PlacementProblem, kept: Sequence[int], each: IntArray) -> FloatArray:
    """Margins of all runs for what is kept together with each pose, (n_each, n_runs).

    As :func:`placement.optimiser.run_margins_s` of each such set. [s]
    """
    axis, rule = problem.table.axis, problem.rule
    beside = problem.table.detected(list(kept))
    together: BoolArray = np.logical_or.reduce(beside, axis=0)
    confirmed = np.empty((len(each), axis.n_runs))
    for start in range(0, len(each), _BLOCK_POSES):
        block = slice(start, start + _BLOCK_POSES)
        detected = problem.table.detected(each[block])
        if problem.fusion == "any":
            detected |= together
        confirmed[block] = confirmation_times_s(
            detected, axis, n_confirmations=rule.n_confirmations
        )
    if problem.fusion == "single" and len(kept):
        alone = confirmation_times_s(beside, axis, n_confirmations=rule.n_confirmations)
        confirmed = np.minimum(confirmed, alone.min(axis=0))
    last_brake = axis.last_brake_time_s
    in_time = np.isfinite(confirmed) & is_in_time(confirmed, last_brake, latency_s=rule.latency_s)
    return np.where(in_time, last_brake - (confirmed + rule.latency_s), -np.inf)
