"""Cuts: inequalities in x alone that every acceptable set of poses meets.

What we ask of a set (runs avoided early enough, also when units fail) is monotone: if a set fails
it, so does every subset. Let U be a set of poses that fails. An acceptable set then has a pose
outside U; and if what is asked must also hold with any n units lost, it has n + 1 outside U -
with fewer, losing those would leave a subset of U. The larger U, the stronger.
"""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray

from .bitsets import union_margins_s, unions_of
from .model import Cut, entering_poses, last_links
from .presolve import ReducedProblem, WordArray
from .problem import TOLERANCE
from .requirements import Requirement

Fails = Callable[[WordArray], BoolArray]


def first_cuts(reduced: ReducedProblem, requirement: Requirement) -> list[Cut]:
    """Cuts that hold from the start: enough units must see stabbing frames of every run.

    Only where no run may be lost with any unit.
    """
    if not (requirement.needs_all and requirement.n_failures):
        return []
    counted = np.flatnonzero(requirement.measure.weight > 0.0)
    links = last_links(reduced, min_margin_s=requirement.min_margin_s)[counted]
    cuts = []
    for phase in range(reduced.window_frames.shape[1]):
        enters = entering_poses(reduced, phase).toarray() > 0.0
        for link in np.unique(links[links >= 0]):
            start = reduced.chain_start[np.searchsorted(reduced.chain_start, link, "right") - 1]
            cuts.append(
                Cut(
                    is_counted=np.logical_or.reduce(enters[start : link + 1], axis=0),
                    n_units=requirement.n_failures + 1,
                )
            )
    return cuts


def violated_cuts(
    reduced: ReducedProblem, units: IntArray, requirements: Sequence[Requirement]
) -> list[Cut]:
    """Cuts that a set of poses violates; none if and only if it meets all requirements."""
    cuts = []
    for requirement in requirements:
        fails = _fails_requirement(reduced, requirement)
        n_units = requirement.n_failures + 1
        n_left = max(len(units) - requirement.n_failures, 0)
        for left in combinations(units, n_left):
            union = unions_of(reduced, np.array(left, dtype=np.int64)[None, :])[0]
            if not fails(union[None, :])[0]:
                continue
            if requirement.needs_all:
                cuts += [
                    _cut(reduced, union, _fails_run(reduced, run, requirement), n_units=n_units)
                    for run in _lost_runs(reduced, union, requirement)
                ]
            else:
                cuts.append(_cut(reduced, union, fails, n_units=n_units))
    return cuts


def _lost_runs(reduced: ReducedProblem, union: WordArray, requirement: Requirement) -> list[int]:
    """Of every chain, the lost run with the fewest windows: the hardest to avoid."""
    margin = union_margins_s(reduced, union[None, :])[0]
    is_lost = ~_in_time(margin, requirement) & (requirement.measure.weight > 0.0)
    last = last_links(reduced, min_margin_s=requirement.min_margin_s)
    hardest = []
    for chain in np.unique(reduced.run_chain[is_lost]):
        runs = np.flatnonzero(is_lost & (reduced.run_chain == chain))
        hardest.append(int(runs[np.argmin(last[runs])]))
    return hardest


def _in_time(margin: FloatArray, requirement: Requirement) -> BoolArray:
    in_time: BoolArray = (margin > -np.inf) & (margin >= requirement.min_margin_s - TOLERANCE)
    return in_time


def _fails_requirement(reduced: ReducedProblem, requirement: Requirement) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        reached = requirement.reached(union_margins_s(reduced, unions))
        result: BoolArray = reached < requirement.least - TOLERANCE
        return result

    return fails


def _fails_run(reduced: ReducedProblem, run: int, requirement: Requirement) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        return ~_in_time(union_margins_s(reduced, unions)[:, run], requirement)

    return fails


def _cut(reduced: ReducedProblem, union: WordArray, fails: Fails, *, n_units: int) -> Cut:
    """Cut from a set that fails, enlarged until every further pose would end that."""
    words = reduced.words
    waiting = np.flatnonzero((words & ~union).any(axis=1))
    while len(waiting) > 0:
        waiting = waiting[fails(union | words[waiting])]
        # Those that add least come first: more of them fit in.
        n_new = np.bitwise_count(words[waiting] & ~union).sum(axis=1, dtype=np.int64)
        waiting = waiting[np.argsort(n_new, kind="stable")]
        grown = np.bitwise_or.accumulate(words[waiting], axis=0) | union
        n_fit = int(fails(grown).sum())
        if n_fit > 0:
            union = grown[n_fit - 1]
        waiting = waiting[n_fit:]
    outside: BoolArray = np.logical_or.reduce((words & ~union) != 0, axis=1)
    return Cut(is_counted=outside, n_units=n_units)
