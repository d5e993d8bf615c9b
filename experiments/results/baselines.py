"""The parts of a result to compare with: random layouts, an expert's rule, the study's cases."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec import UNSET, UnsetType

from geometry.arrays import FloatArray
from placement.baselines import RandomLayouts
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, apr, apr_by_case, apr_by_position
from placement.layout import Layout
from placement.optimiser import apr as table_apr
from placement.pipeline import Placement
from placement.sampling import estimate_mean
from scenarios.runs import FrameAxis

from .record import Record, Share, UnitRecord, build_unit_records, says


class ScoreRecord(Record, frozen=True, kw_only=True):
    """What a sensing party prevents, by the evaluator."""

    name: Annotated[str, says("Of the layout; or who else senses.")]
    units: Annotated[int, says("How many units it has; 0: the vehicle by itself.", ge=0)]
    runs_avoided: Annotated[int, says("How many.", ge=0)]
    all: Annotated[Share | None, says("APR over all runs, by weight.")]
    by_case: Annotated[
        dict[str, Share | None],
        says("APR of each case, by its name; null where no run of it has weight."),
    ]
    by_position: Annotated[
        dict[str, Share | None],
        says("APR of each position along the arms; null where no run there has weight."),
    ]


class RandomWorldsRecord(Record, frozen=True, kw_only=True):
    """The mean of random layouts over sampled worlds, those that the layout found was chosen in."""

    worlds: Annotated[int, says("How many.", ge=1)]
    mean: Annotated[Share, says("Mean APR of all random layouts over these worlds.")]
    low: Annotated[Share, says("Lower end of the 95 % interval.")]
    high: Annotated[Share, says("Upper end of the 95 % interval.")]


class RandomLayoutsRecord(Record, frozen=True, kw_only=True):
    """Layouts of candidate poses drawn at random within the limits, on the detection table."""

    layouts: Annotated[int, says("How many were drawn.", ge=1)]
    units: Annotated[int, says("Units of each.", ge=1)]
    mean: Annotated[Share, says("Mean APR.")]
    low: Annotated[Share, says("5 % of them have no higher APR.")]
    high: Annotated[Share, says("5 % of them have no lower APR.")]
    in_worlds: (
        Annotated[RandomWorldsRecord, says("The mean over worlds; only with --samples.")]
        | UnsetType
    ) = UNSET


class ExpertLayoutRecord(Record, frozen=True, kw_only=True):
    """A camera per corner of the junction that looks at its middle."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("The units.", min_length=1)]
    corners: Annotated[
        tuple[str, ...],
        says("Corners that have a camera, by the arms beside them, in the order of choice."),
    ]
    cost_eur: Annotated[
        float, says("Price of the units by the catalogue, in EUR, without poles or mounting.", ge=0)
    ]
    on_table: Annotated[Share, says("APR on the detection table.")]
    score: Annotated[ScoreRecord, says("By the evaluator.")]
    apr_without_worst_unit: Annotated[
        Share | None, says("APR by the evaluator if the unit that is needed most fails.")
    ]


class BaselinesRecord(Record, frozen=True, kw_only=True):
    """What anybody would do without an optimiser, within the same limits."""

    random: Annotated[
        RandomLayoutsRecord | None, says("Drawn at random; null: none is within the limits.")
    ]
    expert: Annotated[
        ExpertLayoutRecord | None,
        says("By rule of thumb; null: that is not within the limits, or there are no corners."),
    ]


class NextUnitRecord(Record, frozen=True, kw_only=True):
    """The further unit that greedy choice would add, budgets aside, on the detection table."""

    pose: Annotated[str, says("Id of the candidate pose.", min_length=1)]
    site: Annotated[str, says("Its site; empty: none.")]
    apr: Annotated[Share, says("APR with it.")]
    gain: Annotated[Share, says("How much higher that is.")]


class StudyCasesRecord(Record, frozen=True, kw_only=True):
    """The same layouts on the study's cases, as the study drives and reads them."""

    runs: Annotated[int, says("Runs of these cases.", ge=1)]
    parties: Annotated[
        tuple[ScoreRecord, ...],
        says("The layouts, the first one first, and the vehicle by itself.", min_length=2),
    ]


def build_score_record(
    name: str, verdict: Verdict, axis: FrameAxis, *, n_units: int
) -> ScoreRecord:
    """APR and avoided runs of a sensing party."""
    return ScoreRecord(
        name=name,
        units=n_units,
        runs_avoided=int(verdict.is_avoided.sum()),
        all=apr(verdict, axis),
        by_case={**apr_by_case(verdict, axis)},
        by_position={**apr_by_position(verdict, axis)},
    )


def build_random_record(layouts: RandomLayouts) -> RandomLayoutsRecord:
    """Mean and ends of the APR of random layouts, without what summing up weights leaves over."""
    n_worlds = len(layouts.mean_by_world)
    return RandomLayoutsRecord(
        layouts=len(layouts.apr),
        units=layouts.n_units,
        mean=round(layouts.mean, 12),
        low=round(layouts.low, 12),
        high=round(layouts.high, 12),
        in_worlds=UNSET if n_worlds == 1 else _in_worlds(layouts.mean_by_world),
    )


def _in_worlds(mean_by_world: FloatArray) -> RandomWorldsRecord:
    estimate = estimate_mean(np.clip(mean_by_world, 0.0, 1.0))
    return RandomWorldsRecord(
        worlds=len(mean_by_world), mean=estimate.mean, low=estimate.low, high=estimate.high
    )


def build_expert_record(
    evaluation: Evaluation,
    *,
    corners: Sequence[str],
    on_table: float,
    apr_without_worst_unit: float | None,
) -> ExpertLayoutRecord:
    """The expert's layout, on the detection table and by the evaluator."""
    layout: Layout = evaluation.layout
    return ExpertLayoutRecord(
        name=layout.name,
        layout=build_unit_records(layout),
        corners=tuple(corners),
        cost_eur=sum(unit.sensor.price_eur for unit in layout.units),
        on_table=round(on_table, 12),
        score=build_score_record(
            layout.name, evaluation.rsu_all, evaluation.axis, n_units=len(layout.units)
        ),
        apr_without_worst_unit=apr_without_worst_unit,
    )


def build_next_unit_record(
    placement: Placement, candidates: Sequence[CandidatePose]
) -> NextUnitRecord | None:
    """What one more unit would gain; None where none fits, or that is not known."""
    further = placement.next_unit
    if further is None:
        return None
    unit = candidates[further.pose_index]
    gain = further.apr - table_apr(placement.problem, placement.pose_index)
    return NextUnitRecord(
        pose=unit.id, site=unit.site_id, apr=round(further.apr, 12), gain=round(gain, 12)
    )


def build_study_cases_record(evaluations: Mapping[str, Evaluation]) -> StudyCasesRecord:
    """Layouts by display name on the study's cases, and the VUT by itself."""
    first = next(iter(evaluations.values()))
    layouts = [
        build_score_record(name, item.rsu_all, item.axis, n_units=len(item.layout.units))
        for name, item in evaluations.items()
    ]
    return StudyCasesRecord(
        runs=first.axis.n_runs,
        parties=(*layouts, build_score_record("VUT alone", first.vut, first.axis, n_units=0)),
    )
