"""The part of a result about where it is still dangerous: runs that nobody avoids, by group."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation
from scenarios.runs import FrameAxis

from .record import Record, says
from .tables import RunGroup, groups_by_case, groups_by_position


class DangerGroupRecord(Record, frozen=True, kw_only=True):
    """Some runs that are alike, and how many of them are not avoided."""

    name: Annotated[str, says("Of the case, or of the position along the arms.")]
    runs: Annotated[int, says("How many runs.", ge=1)]
    not_avoided: Annotated[int, says("How many of them are not avoided.", ge=0)]


class DangersRecord(Record, frozen=True, kw_only=True):
    """Runs that the units of the layout do not avoid, by the evaluator."""

    not_avoided: Annotated[int, says("How many of all runs.", ge=0)]
    by_case: Annotated[
        tuple[DangerGroupRecord, ...], says("The same by case, the largest share left first.")
    ]
    by_position: Annotated[
        tuple[DangerGroupRecord, ...],
        says("By position along the arms, in the same order; empty where there is but one."),
    ]


def avoided_runs(evaluation: Evaluation, fusion: str) -> BoolArray:
    """Runs that the units of a layout avoid, (n_runs,) bool, as they were chosen to.

    With fusion "single" some unit has to confirm by itself; else any may detect in each frame.
    """
    if fusion != "single":
        return evaluation.rsu_all.is_avoided
    alone: BoolArray = np.any([unit.is_avoided for unit in evaluation.units.values()], axis=0)
    return alone


def build_dangers_record(is_avoided: BoolArray, axis: FrameAxis) -> DangersRecord:
    """Runs that are left, counted by case and position; weights do not matter."""
    positions = groups_by_position(axis)
    return DangersRecord(
        not_avoided=int((~is_avoided).sum()),
        by_case=_groups(groups_by_case(axis), is_avoided),
        by_position=_groups(positions, is_avoided) if len(positions) > 1 else (),
    )


def _groups(groups: Sequence[RunGroup], is_avoided: BoolArray) -> tuple[DangerGroupRecord, ...]:
    records = [
        DangerGroupRecord(
            name=name, runs=int(mask.sum()), not_avoided=int((mask & ~is_avoided).sum())
        )
        for name, mask in groups
    ]
    # Stable: of equal shares the first group comes first.
    return tuple(sorted(records, key=lambda group: -group.not_avoided / group.runs))
