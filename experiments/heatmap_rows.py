"""Which units have a row in a heatmap."""

from collections.abc import Sequence

from placement.evaluation import Evaluation

MAX_HEATMAP_UNITS = 24
"""Rows of a heatmap that units have: of more, those that confirm first."""


def units_in_heatmap(evaluation: Evaluation, run_indices: Sequence[int]) -> list[str]:
    """Ids of the units that have a row in a heatmap of runs.

    Parameters
    ----------
    evaluation : Evaluation
        Of a layout.
    run_indices : sequence of int
        The runs.

    Returns
    -------
    unit_ids : list of str
        All, in the layout's order; or, of more than ``MAX_HEATMAP_UNITS``, so many: those that
        confirm first in any of the runs, and then those that detect in the most frames.
    """
    units = evaluation.units
    if len(units) <= MAX_HEATMAP_UNITS:
        return list(units)

    def rank(unit_id: str) -> tuple[float, int]:
        verdict = units[unit_id]
        frames = [verdict.detected[evaluation.axis.frames_of(index)] for index in run_indices]
        return (
            float(min(verdict.confirmation_time_s[index] for index in run_indices)),
            -sum(int(detected.sum()) for detected in frames),
        )

    return sorted(units, key=rank)[:MAX_HEATMAP_UNITS]
