"""Front-runners, by the evaluator: which of the layouts that lead on the table to recommend."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scenarios.aeb import AebRule
from scenarios.weights import weight_share

from ..evaluation import Evaluation, apr_one_failed
from ..layout import Layout
from ..optimiser.problem import Fusion

EQUAL_APR = 0.001
"""Front-runners whose shares differ by no more are equal: results print a tenth of a point."""

Deciding = Literal["apr", "apr_one_failed", "mounting", "order"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRunner:
    """A layout that leads on the detection table, by the evaluator.

    Attributes
    ----------
    layout : Layout
        Its units.
    apr, apr_one_failed : float
        All units together, and when the most needed one fails; 0 for a single unit. 0..1
    """

    layout: Layout
    apr: float
    apr_one_failed: float


def build_front_runner(evaluation: Evaluation, rule: AebRule, *, fusion: Fusion) -> FrontRunner:
    """A layout as the evaluator sees it, under the fusion that it was chosen with."""
    axis = evaluation.axis
    if fusion == "any":
        apr = weight_share(evaluation.rsu_all.is_avoided, axis.weight)
        return FrontRunner(
            layout=evaluation.layout, apr=apr, apr_one_failed=apr_one_failed(evaluation, rule)
        )
    alone = np.array([unit.is_avoided for unit in evaluation.units.values()])
    left = [np.delete(alone, unit, axis=0).any(axis=0) for unit in range(len(alone))]
    return FrontRunner(
        layout=evaluation.layout,
        apr=weight_share(alone.any(axis=0), axis.weight),
        apr_one_failed=min(weight_share(mask, axis.weight) for mask in left),
    )


def recommend(
    runners: Sequence[FrontRunner], mounted_wrongly: Callable[[int], float]
) -> tuple[int, Deciding]:
    """Number of the front-runner to recommend, and what the first one was passed over for.

    In this order: APR; APR when the most needed unit fails; APR that a usual error of mounting
    leaves, which `mounted_wrongly` gives by number, asked only for those that are equal so far.
    Differences up to ``EQUAL_APR`` are none. Of equals the first is recommended: "order".
    """
    left = list(range(len(runners)))
    keys: tuple[tuple[Deciding, Callable[[int], float]], ...] = (
        ("apr", lambda number: runners[number].apr),
        ("apr_one_failed", lambda number: runners[number].apr_one_failed),
        ("mounting", mounted_wrongly),
    )
    deciding: Deciding = "order"
    for name, key in keys:
        if len(left) == 1:
            break
        values = {number: key(number) for number in left}
        most = max(values.values())
        had_first = 0 in left
        left = [number for number in left if values[number] >= most - EQUAL_APR]
        if had_first and 0 not in left:
            deciding = name
    return left[0], deciding
