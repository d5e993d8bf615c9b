"""Failures: what a layout still achieves when one of its units fails (N-1), or two of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geometry.arrays import FloatArray
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, onset_times_s

from ..evaluation import Evaluation, earliest_arrival_s, leave_each_out

MAX_PAIR_UNITS = 12
"""For layouts with more units, only single failures are evaluated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """What a layout achieves without some of its units.

    Attributes
    ----------
    unit_ids : tuple of str
        The units that fail.
    apr : float
        Accident prevention ratio of the others, fused, 0 .. 1; 0 where there are no others.
    smallest_margin_s : float
        Of the runs with weight that the others still avoid, the least time from the onset of
        braking to the last moment; NaN where they avoid none. [s]
    lost_run_ids : tuple of str
        Runs with weight that all units together avoid and the others do not, those with the
        highest speed first.
    """

    unit_ids: tuple[str, ...]
    apr: float
    smallest_margin_s: float
    lost_run_ids: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Failures:
    """All evaluated failures of a layout, the worst first.

    Attributes
    ----------
    none_failed : Failure
        Of all units together.
    one_failed : tuple of Failure
        One for each unit.
    two_failed : tuple of Failure
        One for each pair; empty for a layout of one unit or of more than ``MAX_PAIR_UNITS``.
    """

    none_failed: Failure
    one_failed: tuple[Failure, ...]
    two_failed: tuple[Failure, ...]


def find_failures(evaluation: Evaluation, rule: AebRule) -> Failures:
    """What a layout achieves when each of its units fails, and each pair.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout; only its units' detected frames are used.
    rule : AebRule
        Confirmation and latency.

    Returns
    -------
    failures : Failures
        The worst first: the lowest APR, then the smallest margin, then the layout's order.

    Notes
    -----
    In each frame any remaining unit may be the one that detects. The smallest APR of
    `one_failed` is :func:`placement.evaluation.apr_one_failed`.
    """
    axis, units = evaluation.axis, evaluation.layout.units
    ids = [unit.id for unit in units]
    arrivals_s = np.stack(
        [
            earliest_arrival_s([(evaluation.units[unit.id].detected, unit.latency(rule))], axis)
            for unit in units
        ]
    )
    earliest_s, without = leave_each_out(arrivals_s)
    whole = _onset_s(earliest_s, axis, rule)
    pairs: list[tuple[int, ...]] = []
    if len(units) <= MAX_PAIR_UNITS:
        pairs = [*combinations(range(len(units)), 2)]

    def describe(failed: tuple[int, ...], onset_s: FloatArray) -> Failure:
        return _failure(tuple(ids[index] for index in failed), onset_s, whole, axis)

    return Failures(
        none_failed=describe((), whole),
        one_failed=_worst_first(
            [
                describe(
                    (index,), whole if other_s is earliest_s else _onset_s(other_s, axis, rule)
                )
                for index, other_s in enumerate(without)
            ]
        ),
        two_failed=_worst_first(
            [
                describe(
                    pair,
                    _onset_s(
                        np.delete(arrivals_s, pair, axis=0).min(axis=0, initial=np.inf), axis, rule
                    ),
                )
                for pair in pairs
            ]
        ),
    )


def _onset_s(arrival_s: FloatArray, axis: FrameAxis, rule: AebRule) -> FloatArray:
    _, onset = onset_times_s(arrival_s, axis, n_confirmations=rule.n_confirmations)
    return onset


def _failure(
    unit_ids: tuple[str, ...], onset_s: FloatArray, whole_s: FloatArray, axis: FrameAxis
) -> Failure:
    counts = axis.weight > 0.0
    avoided, avoided_by_all = (
        is_in_time(onset, axis.last_brake_time_s, latency_s=0.0) for onset in (onset_s, whole_s)
    )
    margin = (axis.last_brake_time_s - onset_s)[avoided & counts]
    lost = np.flatnonzero(avoided_by_all & ~avoided & counts)
    fastest_first = lost[np.argsort(-axis.vut_speed_kmh[lost], kind="stable")]
    return Failure(
        unit_ids=unit_ids,
        apr=weight_share(avoided, axis.weight),
        smallest_margin_s=float(margin.min()) if len(margin) else math.nan,
        lost_run_ids=tuple(axis.run_ids[index] for index in fastest_first),
    )


def _worst_first(failures: Sequence[Failure]) -> tuple[Failure, ...]:
    def key(failure: Failure) -> tuple[float, float]:
        margin_s = failure.smallest_margin_s
        return failure.apr, -math.inf if math.isnan(margin_s) else margin_s

    return tuple(sorted(failures, key=key))
