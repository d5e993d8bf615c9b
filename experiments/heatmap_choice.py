"""Which runs have a heatmap, and which units a row in it."""

from collections.abc import Sequence

import numpy as np

from geometry.errors import InputError
from placement.evaluation import Evaluation
from placement.setting import Setting

from .verdict_tables import margin_s

_STUDY_HEATMAPS = ("CPNC-50/east/55", "CBNA/east/60", "CBLA/east/50")
_MAX_HEATMAPS = 3
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


def pick_heatmap_runs(setting: Setting, evaluation: Evaluation) -> tuple[str, ...]:
    """Runs whose heatmaps are worth drawing.

    Parameters
    ----------
    setting : Setting
        Runs and braking rule.
    evaluation : Evaluation
        Of the layout that is reported.

    Returns
    -------
    run_ids : tuple of str
        At most three, of different cases: the study's own, at the speeds at which it shows them
        or near, where they are driven; then of the hardest other cases the run that counts and
        has the least time to spare.
    """
    axis = evaluation.axis
    picked = {
        axis.cases[axis.run_ids.index(run_id)]: run_id
        for run_id in _STUDY_HEATMAPS
        if run_id in axis.run_ids
    }
    margin = margin_s(evaluation.rsu_all, axis)
    for index in np.argsort(margin, kind="stable"):
        if axis.weight[index] > 0.0:
            picked.setdefault(axis.cases[index], axis.run_ids[index])
    return tuple(picked.values())[:_MAX_HEATMAPS]


def heatmap_indices(evaluation: Evaluation, setting: Setting, run_ids: Sequence[str]) -> list[int]:
    """Indices of runs by their ids; none: those of :func:`pick_heatmap_runs`."""
    axis = evaluation.axis
    for run_id in run_ids:
        if run_id not in axis.run_ids:
            raise InputError("heatmap run", run_id, "the id of a run")
    return [
        axis.run_ids.index(run_id) for run_id in run_ids or pick_heatmap_runs(setting, evaluation)
    ]
