"""Which runs are worth watching."""

from collections.abc import Sequence

import numpy as np

from geometry.arrays import IntArray
from geometry.errors import InputError
from placement.evaluation import Evaluation

from ..verdict_tables import margin_s

SHOWN_ABOVE = "shown above"
LEAST_TIME = "least time to spare"
NOT_AVOIDED = "not avoided"
ONE_PER_CASE = "one of each case"
ALL_OTHERS = "all others"


def choose_runs(
    evaluation: Evaluation, *, first_runs: Sequence[str] = (), max_runs: int = 24
) -> list[tuple[int, str]]:
    """Runs for the player, and why each is there.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout that is reported.
    first_runs : sequence of str
        Ids of runs that come first; unknown ones are left out.
    max_runs : int
        At most so many.

    Returns
    -------
    chosen : list of pair of int and str
        Index of the run, and one of ``SHOWN_ABOVE``, ``LEAST_TIME``, ``NOT_AVOIDED`` and
        ``ONE_PER_CASE``, in this order. Each of the last three gets a third of what is left, or
        more where the others do not need theirs.

    Raises
    ------
    InputError
        Less than one run is asked for.
    """
    if max_runs < 1:
        raise InputError("max_runs", max_runs, "at least 1")
    axis = evaluation.axis
    index_of = {run_id: index for index, run_id in enumerate(axis.run_ids)}
    chosen = {
        index_of[run_id]: SHOWN_ABOVE for run_id in dict.fromkeys(first_runs) if run_id in index_of
    }
    chosen = dict([*chosen.items()][:max_runs])
    margin = margin_s(evaluation.rsu_all, axis)
    is_avoided = evaluation.rsu_all.is_avoided
    order: IntArray = np.argsort(margin, kind="stable")
    order = order[np.argsort(axis.weight[order] <= 0.0, kind="stable")]  # without weight: last
    missed = _cases_in_turn(order[~is_avoided[order]][::-1], axis.cases)
    groups = {
        LEAST_TIME: [int(index) for index in order[is_avoided[order]]],
        NOT_AVOIDED: missed,
        ONE_PER_CASE: _first_of_each(order, [*zip(axis.cases, axis.weathers, strict=True)]),
    }
    share = -(-(max_runs - len(chosen)) // len(groups))
    for quota in (share, max_runs):
        for group, members in groups.items():
            free = [index for index in members if index not in chosen]
            taken = sum(name == group for name in chosen.values())
            for index in free[: min(quota - taken, max_runs - len(chosen))]:
                chosen[index] = group
    names = [SHOWN_ABOVE, *groups]
    return sorted(chosen.items(), key=lambda item: names.index(item[1]))


def _first_of_each(order: IntArray, kinds: Sequence[object]) -> list[int]:
    """The first run of each kind, kinds as they first appear among all runs."""
    first: dict[object, int] = {}
    for index in order:
        first.setdefault(kinds[index], int(index))
    return [first[kind] for kind in dict.fromkeys(kinds)]


def _cases_in_turn(order: IntArray, cases: Sequence[str]) -> list[int]:
    """Runs so that one of each case comes before the second of any."""
    seen: dict[str, int] = {}
    ranks = []
    for index in order:
        seen[cases[index]] = seen.get(cases[index], 0) + 1
        ranks.append(seen[cases[index]])
    return [int(index) for index in order[np.argsort(ranks, kind="stable")]]
