"""Contributions of units: what is left without some, or with one more."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Annotated

import numpy as np

from geometry.arrays import FloatArray
from geometry.tables import says
from scenarios.aeb import AebRule
from scenarios.runs import find_onsets
from scenarios.weights import weight_share

from ..evaluation import (
    Evaluation,
    earliest_arrival_s,
    leave_each_out,
    unit_arrivals_s,
    units_by_site,
)
from ..optimiser import (
    PlacementProblem,
    ReducedProblem,
    apr,
)
from ..optimiser.allowed_sets import fitting
from ..optimiser.bitsets import avoided_with_each

# ---------- failures of units and poles (N-1, N-2)
# For layouts with more units, only single failures are evaluated.
MAX_PAIR_UNITS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """The achievement of a layout without some of its units.

    Attributes
    ----------
    unit_ids : tuple of str
        The units that fail.
    apr : float
        Accident prevention ratio of the others, fused, 0 .. 1; 0 where there are no
        others.
    smallest_margin_s : float
        Of the runs with weight that the others still avoid, the least time from the
        onset of braking to the last moment; NaN where they avoid none. [s]
    lost_run_ids : tuple of str
        Runs with weight that all units together avoid and the others do not, those with
        the highest speed first.
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
        One for each pair; empty for a layout of one unit or of more than
        ``MAX_PAIR_UNITS``.
    site_failed : tuple of Failure
        One for each site: power or a crash takes all of its units at once.
    """

    none_failed: Failure
    one_failed: tuple[Failure, ...]
    two_failed: tuple[Failure, ...]
    site_failed: tuple[Failure, ...] = ()


def find_failures(evaluation: Evaluation, rule: AebRule) -> Failures:
    """Evaluate the failure of each unit, each pair, and each site.

    In each frame any remaining unit may be the one that detects, and the VUT where
    every VUT sees. The worst comes first: the lowest APR, then the smallest margin,
    then the layout's order.
    """
    axis = evaluation.axis
    units = evaluation.layout.units
    # Arrivals of every unit, and of a VUT that sees.
    arrivals_s = unit_arrivals_s(evaluation, rule)
    if evaluation.cars == 1.0:
        own = [(evaluation.vut.detected, rule.latency_s)]
    else:
        own = []
    own_s = earliest_arrival_s(own, axis)
    earliest_s, without = leave_each_out(arrivals_s)
    pairs = combinations(range(len(units)), 2) if len(units) <= MAX_PAIR_UNITS else ()
    counts = axis.weight > 0.0

    avoided_by_all = find_onsets(
        np.minimum(earliest_s, own_s), axis, rule=rule
    ).is_in_time

    def failure(
        failed: tuple[int, ...], arrival_s: FloatArray, site_id: str = ""
    ) -> Failure:
        """Achievement of the units that are left when some fail."""
        onsets = find_onsets(np.minimum(arrival_s, own_s), axis, rule=rule)
        avoided = onsets.is_in_time
        # Margins and losses count runs with weight only.
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

    def several(failed: tuple[int, ...], site_id: str = "") -> Failure:
        left_s = np.delete(arrivals_s, failed, axis=0).min(axis=0, initial=np.inf)
        return failure(failed, left_s, site_id)

    sites = units_by_site(evaluation.layout).items()
    return Failures(
        none_failed=failure((), earliest_s),
        one_failed=_worst_first(
            failure((unit,), left) for unit, left in enumerate(without)
        ),
        two_failed=_worst_first(several(pair) for pair in pairs),
        site_failed=_worst_first(
            several(tuple(failed), site_id) for site_id, failed in sites
        ),
    )


def _worst_first(failures: Iterable[Failure]) -> tuple[Failure, ...]:
    """Failures by APR, then by smallest margin, the worst first."""

    def key(failure: Failure) -> tuple[float, float]:
        margin_s = failure.smallest_margin_s
        if math.isnan(margin_s):
            margin_s = -math.inf
        return failure.apr, margin_s

    return tuple(sorted(failures, key=key))


# ---------- one more unit
@dataclass(frozen=True, slots=True, kw_only=True)
class NextUnit:
    """The further unit that greedy choice would add.

    Budgets do not count; values are those of the detection table.
    """

    pose: Annotated[str, says("Id of the candidate pose.")]
    apr: Annotated[float, says("Accident prevention ratio with it, 0..1.")]
    gain: Annotated[float, says("How much higher that is than without.")]


def find_next_unit(
    problem: PlacementProblem, reduced: ReducedProblem, pose_index: Sequence[int]
) -> NextUnit | None:
    """The pose with which a layout has the highest APR.

    It is the one that greedy choice would add next. Budgets do not count: it is
    what one more unit buys. Sites, rivals and wishes do. Another layout of as many
    units may be better still.

    Parameters
    ----------
    problem : PlacementProblem
        With the detection table.
    reduced : ReducedProblem
        What presolve left of it. Poses that fell out see no more than others that are
        left.
    pose_index : sequence of int
        Rows of the table, all among those left.

    Returns
    -------
    next_unit : NextUnit or None
        None where no pose fits next to the layout.
    """
    units = np.flatnonzero(np.isin(reduced.pose_index, pose_index))
    limits = replace(reduced.limits, budget_units=None, budget_eur=None)
    # Poses that fit next to the layout, whatever they cost.
    free = np.flatnonzero(fitting(limits, units))
    if not len(free):
        return None
    ratios = reduced.measure.of(avoided_with_each(reduced, units)[free])
    row = int(reduced.pose_index[free[int(ratios.argmax())]])
    with_it = apr(problem, [*pose_index, row])
    gain = with_it - apr(problem, pose_index)
    return NextUnit(pose=problem.table.pose_ids[row], apr=with_it, gain=gain)
