"""Cuts: inequalities in x alone that every acceptable set of poses meets.

What we ask of a set (runs avoided early enough, also when a unit fails) is monotone: if a set fails
it, so does every subset. Let U be a set of poses that fails. An acceptable set then has a pose
outside U; and if what is asked must also hold with any one unit lost, it has two outside U -
with one, losing that one would leave a subset of U. The larger U, the stronger.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, IntArray

from .bitsets import union_margins_s, unions_of
from .model import Cut, entering_poses, last_links
from .presolve import ReducedProblem, WordArray
from .problem import TOLERANCE

Fails = Callable[[WordArray], BoolArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Demand:
    """What a set of poses must reach.

    Attributes
    ----------
    apr : float
        Weight of the runs avoided with at least the margin.
    min_margin_s : float
        See `apr`; minus infinity: just avoided. [s]
    apr_one_failed : float
        Weight of the runs still avoided when any one unit fails.
    """

    apr: float = 0.0
    min_margin_s: float = -np.inf
    apr_one_failed: float = 0.0


def first_cuts(reduced: ReducedProblem, demand: Demand) -> list[Cut]:
    """Cuts that hold from the start: two units must see stabbing frames of every run.

    Only where no run may be lost with any unit.
    """
    if not _needs_all(reduced, demand.apr_one_failed):
        return []
    cuts = []
    for phase in range(reduced.window_frames.shape[1]):
        enters = entering_poses(reduced, phase).toarray() > 0.0
        for link in np.unique(last_links(reduced)):
            start = reduced.chain_start[np.searchsorted(reduced.chain_start, link, "right") - 1]
            cuts.append(
                Cut(is_counted=np.logical_or.reduce(enters[start : link + 1], axis=0), n_units=2)
            )
    return cuts


def violated_cuts(reduced: ReducedProblem, units: IntArray, demand: Demand) -> list[Cut]:
    """Cuts that a set of poses violates; none if and only if it meets the demand."""
    cuts = []
    union = unions_of(reduced, units[None, :])[0]
    fails = _fails_share(reduced, demand.apr, demand.min_margin_s)
    if fails(union[None, :])[0]:
        cuts.append(_cut(reduced, union, fails, n_units=1))
    fails = _fails_share(reduced, demand.apr_one_failed, -np.inf)
    for failed in range(len(units)):
        union = unions_of(reduced, np.delete(units, failed)[None, :])[0]
        if not fails(union[None, :])[0]:
            continue
        if _needs_all(reduced, demand.apr_one_failed):
            lost = union_margins_s(reduced, union[None, :])[0] == -np.inf
            # Of the runs of a chain, the one with the fewest windows is the hardest to avoid.
            for chain in np.unique(reduced.run_chain[lost]):
                runs = np.flatnonzero(lost & (reduced.run_chain == chain))
                run = runs[np.argmin(last_links(reduced)[runs])]
                cuts.append(_cut(reduced, union, _fails_run(reduced, run), n_units=2))
        else:
            cuts.append(_cut(reduced, union, fails, n_units=2))
    return cuts


def _needs_all(reduced: ReducedProblem, share: float) -> bool:
    """Whether a share of the weight can only be reached by avoiding all runs."""
    return bool(share > reduced.weight.sum() - reduced.weight.min(initial=1.0) / 2.0)


def _fails_share(reduced: ReducedProblem, share: float, min_margin_s: float) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        margin = union_margins_s(reduced, unions)
        in_time = (margin > -np.inf) & (margin >= min_margin_s - TOLERANCE)
        result: BoolArray = in_time @ reduced.weight < share - TOLERANCE
        return result

    return fails


def _fails_run(reduced: ReducedProblem, run: int) -> Fails:
    def fails(unions: WordArray) -> BoolArray:
        result: BoolArray = union_margins_s(reduced, unions)[:, run] == -np.inf
        return result

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
