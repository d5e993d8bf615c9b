"""Layouts that locate road users well, among those of nearly the best APR.

Under fusion the located APR is no union of bits: nothing is proven about it. It is the
highest of a pool of layouts, which grows by exchanges.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.phrases import Phrase
from scenarios.decision import DecisionRule, load_decision_rule, located_sd_m

from .candidates import CandidatePose
from .compute import Compute, threads
from .decisions import impact_heading_rad
from .located_choice import LocatedChoice
from .optimiser import PlacementProblem, ReducedProblem, presolve
from .optimiser.allowed_sets import fitting, is_allowed
from .optimiser.bitsets import shares_with_each, union_apr, unions_of
from .optimiser.constants import TOLERANCE
from .optimiser.presolve import ALL_RULES, Rule
from .positions import Feet, aim_sd_deg, build_feet, unit_errors
from .sampling.uncertainty import BY_EYE
from .setting import Setting

STAGE = Phrase("locate")
AIMED = BY_EYE
"""Aims for which layouts are told apart: with good ones most locate alike."""
# Exchanges of one unit that are judged by the filter, those of the best estimates.
_N_JUDGED = 24
# Layouts that are filtered together: enough that numpy's calls cost little.
_IN_A_BATCH = 6
# Before the last moment: what a unit sees then counts in the estimate.
_LAST_S = 1.0
_MOST_JUDGED = 800
"""No exchange is begun once the filter has judged so many layouts: about 60 s on two
cores at the study's junction. A count, so that every machine finds the same.
"""


def find_located(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    problem: PlacementProblem,
    starts: Sequence[Sequence[int]],
    *,
    limit_m: float,
    least_apr: float,
    compute: Compute,
) -> LocatedChoice:
    """Exchange units while more runs are located, from each of some layouts.

    Parameters
    ----------
    setting : Setting
        Runs and rule.
    candidates : sequence of CandidatePose
        Rows of the problem's table.
    problem : PlacementProblem
        Table and limits.
    starts : sequence of sequences of int
        Layouts to begin with, the one that would be chosen otherwise first.
    limit_m : float
        What counts as located. [m]
    least_apr : float
        APR that layouts must keep.
    compute : Compute
        Threads; is told the layouts that were judged.
    """
    # Poses that detect less than others may locate better: none is dominated.
    rules = ALL_RULES - {Rule.DOMINATED_POSES}
    reduced = presolve(problem, workers=compute.workers, rules=rules)
    judge = _Judge(
        setting=setting,
        candidates=candidates,
        problem=problem,
        limit_m=limit_m,
        rule=load_decision_rule(),
        compute=compute,
    )
    estimates = judge.estimates(reduced.pose_index)
    best: tuple[int, ...] = tuple(starts[0])
    (before,) = judge.shares([best])
    for start in dict.fromkeys(tuple(sorted(one)) for one in starts):
        units = np.flatnonzero(np.isin(reduced.pose_index, start))
        if len(units) != len(start) or not _keeps(reduced, units, least_apr):
            continue
        found = _climb(reduced, units, judge, estimates, least_apr)
        if judge.share_of(found) > judge.share_of(best) + TOLERANCE:
            best = found
    return LocatedChoice(
        pose_index=tuple(sorted(best)),
        limit_m=limit_m,
        share=judge.share_of(best),
        share_before=before,
        least_apr=least_apr,
        n_judged=len(judge.known),
    )


def _keeps(reduced: ReducedProblem, units: IntArray, least_apr: float) -> bool:
    """True if a set reaches an APR."""
    share = union_apr(reduced, unions_of(reduced, units[None, :]))
    return float(share[0]) >= least_apr - TOLERANCE


def _climb(
    reduced: ReducedProblem,
    units: IntArray,
    judge: "_Judge",
    estimates: FloatArray,
    least_apr: float,
) -> tuple[int, ...]:
    """The set after exchanges of one unit, each of which locates more runs."""
    place = 0
    idle = 0
    best = tuple(reduced.pose_index[units].tolist())
    judge.shares([best])
    while idle < len(units) and len(judge.known) < _MOST_JUDGED:
        number = place % len(units)
        place += 1
        idle += 1
        if reduced.limits.is_forced[units[number]]:
            continue
        rest = np.delete(units, number)
        keeps = shares_with_each(reduced, rest) >= least_apr - TOLERANCE
        others = np.flatnonzero(fitting(reduced.limits, rest) & keeps)
        # The most promising ones by what all units know of a run at its last moment.
        known = estimates[rest].sum(axis=0)
        expected = judge.expected(known + estimates[others])
        others = others[np.argsort(-expected, kind="stable")[:_N_JUDGED]]
        sets = [np.append(rest, other) for other in others]
        sets = [one for one in sets if is_allowed(reduced.limits, one)]
        rows = [tuple(reduced.pose_index[one].tolist()) for one in sets]
        if not rows:
            continue
        shares = judge.shares(rows)
        which = int(np.argmax(shares))
        if shares[which] > judge.share_of(best) + TOLERANCE:
            units = sets[which]
            best = rows[which]
            idle = 0
    return best


@dataclass(frozen=True, kw_only=True, eq=False)
class _Judge:
    """Located APR of sets of rows of a table; each set is judged once."""

    setting: Setting
    candidates: Sequence[CandidatePose]
    problem: PlacementProblem
    limit_m: float
    rule: DecisionRule
    compute: Compute
    known: dict[tuple[int, ...], float] = field(default_factory=dict)
    _covariance: dict[int, FloatArray] = field(default_factory=dict)

    @cached_property
    def _feet(self) -> Feet:
        return build_feet(self.setting.runs)

    def share_of(self, rows: Iterable[int]) -> float:
        """Located APR of a set that was judged."""
        return self.known[tuple(sorted(rows))]

    def shares(self, sets: Sequence[tuple[int, ...]]) -> list[float]:
        """Located APR of sets."""
        keys = [tuple(sorted(one)) for one in sets]
        new = [one for one in dict.fromkeys(keys) if one not in self.known]
        for row in {row for one in new for row in one}:
            if row not in self._covariance:
                self._covariance[row] = self._covariance_of(row)
        by_size: dict[int, list[tuple[int, ...]]] = defaultdict(list)
        for one in new:
            by_size[len(one)].append(one)
        for sets_of_size in by_size.values():
            batches = [
                sets_of_size[begin : begin + _IN_A_BATCH]
                for begin in range(0, len(sets_of_size), _IN_A_BATCH)
            ]
            with threads(self.compute.workers) as pool:
                shares = pool.map(self._shares_of_batch, batches)
                for batch, found in zip(batches, shares, strict=True):
                    self.known.update(zip(batch, found, strict=True))
        self.compute.progress(STAGE, len(self.known), 0)
        return [self.known[one] for one in keys]

    def expected(self, information: FloatArray) -> FloatArray:
        """Weight of runs that are likely to be located, (n,), for ranking alone."""
        enough = information * self.limit_m**2
        weighed: FloatArray = np.minimum(enough, 1.0) @ self.setting.axis.weight
        return weighed

    def estimates(self, rows: IntArray) -> FloatArray:
        """What each pose knows of runs, (n_poses, n_runs): sums of 1 / m^2.

        It sums over the frames of a run's last second in which the pose detects, across
        the car's heading.
        """
        axis = self.setting.axis
        run = np.repeat(np.arange(axis.n_runs), np.diff(axis.run_start))
        last_s = axis.last_brake_time_s[run] - self.setting.rule.latency_s
        counts = (axis.time_s <= last_s) & (axis.time_s > last_s - _LAST_S)
        frames = np.flatnonzero(counts)
        yaw = np.concatenate([one.vut_yaw_deg for one in self.setting.runs])
        heading = np.radians(yaw[frames])
        east = -np.sin(heading)
        north = np.cos(heading)
        found = np.zeros((len(rows), axis.n_runs))
        for number, row in enumerate(rows.tolist()):
            seen = self.problem.table.detected([row])[0, frames]
            if not seen.any():
                continue
            ee, en, nn = self._covariance_of(row, frames[seen]).T
            e = east[seen]
            n = north[seen]
            across = e * e * ee + 2.0 * e * n * en + n * n * nn
            np.add.at(found[number], run[frames[seen]], 1.0 / across)
        return found

    def _covariance_of(self, row: int, frames: IntArray | None = None) -> FloatArray:
        """Covariances of what a pose reports in all frames, or in some."""
        errors = unit_errors(
            self.candidates[row],
            self.setting.detector,
            self._feet.of(frames),
            rule=self.rule,
            aim_sd_deg=aim_sd_deg(AIMED),
        )
        return errors.covariance_m2()

    def _shares_of_batch(self, sets: Sequence[tuple[int, ...]]) -> list[float]:
        """Located APR of sets of one size, filtered together."""
        table = self.problem.table
        covariances = [[self._covariance[row] for row in rows] for rows in sets]
        sd_m = located_sd_m(
            np.stack([table.detected(list(rows)) for rows in sets]),
            np.array(covariances),
            self.setting.axis,
            impact_heading_rad(self.setting.runs),
            aeb=self.setting.rule,
            rule=self.rule,
        )
        shares: list[float] = (
            (sd_m <= self.limit_m) @ self.setting.axis.weight
        ).tolist()
        return shares
