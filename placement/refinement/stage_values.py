"""What a set of poses is worth in each stage of a problem, in its order."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..layout import Certificate, Stage, relative_gap
from ..optimiser import PlacementProblem, PlacementValue, apr_failed, placement_value
from ..optimiser.limits import COST_TOLERANCE_EUR
from ..optimiser.problem import TOLERANCE

_MINIMISED = ("units", "cost_eur")


class StageValue(NamedTuple):
    """One objective of a set of poses.

    Attributes
    ----------
    name : str
        Name of the stage, as in certificates.
    value : float
        In the stage's own unit; the larger the better, but for "units" and "cost_eur".
    """

    name: str
    value: float


def stage_values(problem: PlacementProblem, pose_index: Sequence[int]) -> tuple[StageValue, ...]:
    """Objectives of a set of poses in the order in which they are optimised.

    Parameters
    ----------
    problem : PlacementProblem
        Its goal, failures to survive and weights decide which stages there are.
    pose_index : sequence of int
        Rows of its table.
    """
    value = placement_value(problem, pose_index)
    stages = []
    if problem.goal == "fewest":
        stages.append(StageValue("units", float(len(pose_index))))
    elif problem.goal == "cheapest":
        stages.append(StageValue("cost_eur", value.cost_eur))
    if problem.survive:
        left = apr_failed(problem, pose_index, problem.survive)
        stages.append(StageValue("apr_survived", left))
    if problem.stage_weights is not None:
        gains = np.dot(problem.stage_weights[:-1], value[:-1])
        weighted = float(gains - problem.stage_weights[-1] * value.cost_eur)
        return (*stages, StageValue("weighted", weighted))
    names = PlacementValue._fields[:-1] if problem.goal == "cheapest" else PlacementValue._fields
    return (*stages, *(StageValue(name, getattr(value, name)) for name in names))


def improves(values: Sequence[StageValue], others: Sequence[StageValue]) -> bool:
    """Whether the first difference that exceeds rounding noise favours `values`.

    Examples
    --------
    >>> improves([StageValue("units", 2.0)], [StageValue("units", 3.0)])
    True
    """
    for mine, theirs in zip(values, others, strict=True):
        tolerance = COST_TOLERANCE_EUR if mine.name == "cost_eur" else TOLERANCE
        if abs(mine.value - theirs.value) > tolerance:
            return (mine.value > theirs.value) != (mine.name in _MINIMISED)
    return False


def certify(values: Sequence[StageValue], certificate: Certificate, solver: str) -> Certificate:
    """The bounds of a certificate, beside a set of poses that is as good as its layout or better.

    Parameters
    ----------
    values : sequence of StageValue
        Of a set within the certificate's problem. A bound holds for all sets that are as good in
        the stages before as the certificate's layout, so for those that are as good as this one.
    certificate : Certificate
        Of that problem.
    solver : str
        What to say of the solver, in its place.
    """
    stages = []
    for own, proven in zip(values, certificate.stages, strict=True):
        closest = min if own.name in _MINIMISED else max
        bound = closest(own.value, proven.bound)
        gap = relative_gap(own.value, bound)
        stages.append(
            Stage(
                name=own.name,
                objective=own.value,
                bound=own.value if gap == 0.0 else bound,
                gap=gap,
                seconds=proven.seconds,
            )
        )
    return Certificate(stages=tuple(stages), solver=solver)
