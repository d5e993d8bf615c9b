"""Parts of a result that put it in doubt: heavy runs, other priorities, the evaluator, mounting."""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, UnsetType

from placement.candidates import CandidatePose
from placement.explain.alternatives import ByRuns, Sturdier
from placement.explain.front_runners import EQUAL_APR, Deciding, FrontRunner
from placement.explain.tolerances import Standing
from scenarios.runs import FrameAxis

from .record import Record, RunId, Share, UnitRecord, build_unit_records, says

HEAVY_SHARE = 0.02
"""A run that counts more is named."""

LEAST_KEPT, MOST_GIVEN_UP = 0.05, 0.03
"""A sturdier layout is offered where it keeps at least so much more for less APR than this."""


class HeavyRunRecord(Record, frozen=True, kw_only=True):
    """A run that counts much."""

    run: Annotated[RunId, says("Which run.")]
    share: Annotated[Share, says("Its part of the weight of all runs.")]


class ByRunsRecord(Record, frozen=True, kw_only=True):
    """The best layout if every run counted the same, on the detection table."""

    units: Annotated[tuple[str, ...], says("Names of the candidate poses.")]
    runs_avoided: Annotated[int, says("Runs that it avoids.", ge=0)]
    runs_avoided_here: Annotated[
        int, says("Runs that the layout found avoids (with --refine: before that).", ge=0)
    ]
    is_proven: Annotated[bool, says("Whether no layout is proven to avoid more.")]


class SturdierRecord(Record, frozen=True, kw_only=True):
    """What --survive 1 gives, on the detection table."""

    units: Annotated[tuple[str, ...], says("Names of the candidate poses.")]
    apr: Annotated[Share, says("Its APR.")]
    apr_one_failed: Annotated[Share, says("Its APR if the unit that is needed most fails.")]
    apr_here: Annotated[Share, says("APR of the layout found (with --refine: before that).")]
    apr_one_failed_here: Annotated[Share, says("The same if the unit needed most fails.")]


class StandingRecord(Record, frozen=True, kw_only=True):
    """What errors of mounting cost, one unit and one error at a time, on the detection table."""

    aim_deg: Annotated[
        float,
        says("A unit may be turned or tilted by so much and no run is lost, in degrees; up to 2."),
    ]
    height_m: Annotated[
        float, says("A unit may be raised or lowered by so much, in metres; up to 0.05.")
    ]
    unit: Annotated[str, says("Id of the unit whose error of 1 degree or 5 cm costs most.")]
    error: Annotated[
        Literal["yaw", "pitch", "height"],
        says("Turned counter-clockwise, tilted up, or raised ..."),
    ]
    step: Annotated[float, says("... by so much: degrees, or metres.")]
    apr: Annotated[Share, says("APR that is then left.")]
    lost_runs: Annotated[tuple[RunId, ...], says("Runs that are then lost.")]


class FrontRunnerRecord(Record, frozen=True, kw_only=True):
    """A layout that leads on the detection table, by the evaluator."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.", min_length=1)]
    apr: Annotated[Share, says("APR.")]
    apr_one_failed: Annotated[
        Share, says("APR if the unit that is needed most fails; 0 for a single unit.")
    ]
    mounting: (
        Annotated[StandingRecord, says("What errors of mounting cost; missing: not asked for.")]
        | UnsetType
    ) = UNSET


class FrontRunnersRecord(Record, frozen=True, kw_only=True):
    """The layout found and others, judged by the evaluator."""

    recommended: Annotated[
        str, says("Name of one of them; recommended.json has it if it is not the layout found.")
    ]
    decided_by: Annotated[
        Literal["apr", "apr_one_failed", "mounting", "order"],
        says("What the layout found was passed over for; order: it is the one recommended."),
    ]
    equal_within: Annotated[Share, says("Shares that differ by no more count as equal.")]
    layouts: Annotated[
        tuple[FrontRunnerRecord, ...], says("The layout found comes first.", min_length=2)
    ]


def build_heavy_records(axis: FrameAxis) -> tuple[HeavyRunRecord, ...]:
    """Runs that count more than others and more than 2 %, to a tenth; the heaviest first."""
    share = axis.weight / axis.weight.sum()
    is_heavy = (np.round(share, 3) > HEAVY_SHARE) & (np.ptp(share) > 1.0e-9)
    rows = np.flatnonzero(is_heavy)
    return tuple(
        HeavyRunRecord(run=axis.run_ids[row], share=float(share[row]))
        for row in rows[np.argsort(-share[rows], kind="stable")]
    )


def build_by_runs_record(found: ByRuns, candidates: Sequence[CandidatePose]) -> ByRunsRecord:
    """A layout by runs, with its poses by name."""
    return ByRunsRecord(
        units=tuple(candidates[row].id for row in found.pose_index),
        runs_avoided=found.n_avoided,
        runs_avoided_here=found.n_avoided_here,
        is_proven=found.is_proven,
    )


def build_sturdier_record(
    found: Sturdier, candidates: Sequence[CandidatePose]
) -> SturdierRecord | UnsetType:
    """A sturdier layout; UNSET where it costs too much or keeps too little more."""
    there, here = found.value, found.value_here
    is_worth_it = (
        here.apr - there.apr < MOST_GIVEN_UP
        and there.apr_one_failed - here.apr_one_failed >= LEAST_KEPT
    )
    if not is_worth_it:
        return UNSET
    return SturdierRecord(
        units=tuple(candidates[row].id for row in found.pose_index),
        apr=there.apr,
        apr_one_failed=there.apr_one_failed,
        apr_here=here.apr,
        apr_one_failed_here=here.apr_one_failed,
    )


def build_standing_record(found: Standing) -> StandingRecord:
    """What errors of mounting cost."""
    worst = found.worst
    return StandingRecord(
        aim_deg=found.aim_deg,
        height_m=found.height_m,
        unit=worst.unit_id,
        error=worst.kind,
        step=worst.step,
        apr=worst.apr,
        lost_runs=worst.lost_run_ids,
    )


def build_front_runners_record(
    runners: Sequence[FrontRunner],
    standings: Sequence[Standing | None],
    *,
    recommended: int,
    decided_by: Deciding,
) -> FrontRunnersRecord:
    """Layouts that lead, and which of them is recommended."""
    return FrontRunnersRecord(
        recommended=runners[recommended].layout.name,
        decided_by=decided_by,
        equal_within=EQUAL_APR,
        layouts=tuple(
            FrontRunnerRecord(
                name=one.layout.name,
                layout=build_unit_records(one.layout),
                apr=one.apr,
                apr_one_failed=one.apr_one_failed,
                mounting=UNSET if standing is None else build_standing_record(standing),
            )
            for one, standing in zip(runners, standings, strict=True)
        ),
    )
