"""Failures of units and poles: what a layout still achieves without them (N-1, N-2)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geometry.arrays import FloatArray
from scenarios.aeb import AebRule
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from ..evaluation import Evaluation, earliest_arrival_s, leave_each_out, units_by_site

MAX_PAIR_UNITS = 12
"""For layouts with more units, only single failures are evaluated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """A layout without some of its units.

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
    site_id : str
        The site that fails with all its units; empty: units fail, their poles stand.
    """

    unit_ids: tuple[str, ...]
    apr: float
    smallest_margin_s: float
    lost_run_ids: tuple[str, ...]
    site_id: str = ""


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
    site_failed : tuple of Failure
        One for each site: power or a crash takes all of its units at once.
    """

    none_failed: Failure
    one_failed: tuple[Failure, ...]
    two_failed: tuple[Failure, ...]
    site_failed: tuple[Failure, ...] = ()


def find_failures(evaluation: Evaluation, rule: AebRule) -> Failures:
    """Evaluate the failure of each unit of a layout, of each pair, and of each site.

    In each frame any remaining unit may be the one that detects. The worst comes first: the lowest
    APR (:func:`placement.evaluation.apr_one_failed` is that of `one_failed`), then the smallest
    margin, then the layout's order.
    """
    axis, units = evaluation.axis, evaluation.layout.units
    arrivals_s = np.stack(
        [
            earliest_arrival_s([(evaluation.units[unit.id].detected, unit.latency(rule))], axis)
            for unit in units
        ]
    )
    earliest_s, without = leave_each_out(arrivals_s)
    pairs = combinations(range(len(units)), 2) if len(units) <= MAX_PAIR_UNITS else ()
    counts = axis.weight > 0.0

    avoided_by_all = find_onsets(earliest_s, axis, rule=rule).is_in_time

    def failure(failed: tuple[int, ...], arrival_s: FloatArray, site_id: str = "") -> Failure:
        onsets = find_onsets(arrival_s, axis, rule=rule)
        avoided = onsets.is_in_time
        margin = (axis.last_brake_time_s - onsets.onset_s)[avoided & counts]
        lost = np.flatnonzero(avoided_by_all & ~avoided & counts)
        fastest_first = lost[np.argsort(-axis.vut_speed_kmh[lost], kind="stable")]
        return Failure(
            unit_ids=tuple(units[index].id for index in failed),
            apr=weight_share(avoided, axis.weight),
            smallest_margin_s=float(margin.min()) if len(margin) else math.nan,
            lost_run_ids=tuple(axis.run_ids[index] for index in fastest_first),
            site_id=site_id,
        )

    def without_units(failed: tuple[int, ...]) -> FloatArray:
        left: FloatArray = np.delete(arrivals_s, failed, axis=0).min(axis=0, initial=np.inf)
        return left

    return Failures(
        none_failed=failure((), earliest_s),
        one_failed=_worst_first([failure((unit,), left) for unit, left in enumerate(without)]),
        two_failed=_worst_first([failure(pair, without_units(pair)) for pair in pairs]),
        site_failed=_worst_first(
            [
                failure(tuple(failed), without_units(tuple(failed)), site_id)
                for site_id, failed in units_by_site(evaluation.layout).items()
            ]
        ),
    )


def _worst_first(failures: Sequence[Failure]) -> tuple[Failure, ...]:
    def key(failure: Failure) -> tuple[float, float]:
        margin_s = failure.smallest_margin_s
        return failure.apr, -math.inf if math.isnan(margin_s) else margin_s

    return tuple(sorted(failures, key=key))
