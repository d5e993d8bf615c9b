"""The parts of a result to compare with: random layouts, an expert's rule, the study's cases."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, UnsetType

from geometry.arrays import FloatArray
from geometry.catalogue import sensor_kind
from placement.baselines import RandomLayouts
from placement.candidates import CandidatePose
from placement.evaluation import Evaluation, Verdict, apr, apr_by_case, apr_by_position
from placement.explain import OtherSensors
from placement.layout import Layout
from placement.optimiser import apr as table_apr
from placement.pipeline import Placement
from placement.sampling.out_of_sample import estimate_mean
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


class ExchangeRecord(Record, frozen=True, kw_only=True):
    """Another sensor model in place of those of the layout, on the detection table."""

    model: Annotated[str, says("Name in the catalogue.", min_length=1)]
    kind: Annotated[Literal["camera", "lidar"], says("What it is.")]
    unit: Annotated[str, says("Id of the unit for which it does most.", min_length=1)]
    horizontal_fov_deg: Annotated[
        float, says("Its field of view there, in degrees; a varifocal lens is tried at several.")
    ]
    yaw_deg: Annotated[float, says("Where that unit then looks, in degrees.")]
    pitch_deg: Annotated[float, says("In degrees, positive up.")]
    apr: Annotated[Share, says("APR with that unit exchanged alone and turned for the most.")]
    gain: Annotated[float, says("By how much that is higher than without; negative: lower.")]
    extra_eur: Annotated[
        float, says("Price by the catalogue less that of what it takes the place of, in EUR.")
    ]
    all_units: Annotated[int, says("How many units can be exchanged.", ge=1)]
    apr_all: Annotated[Share, says("APR with all of them exchanged, each turned for the most.")]
    apr_as_they_hang: Annotated[Share, says("APR with all of them exchanged and none turned.")]
    extra_all_eur: Annotated[float, says("What that costs more, in EUR.")]


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


def build_exchange_records(layout: Layout, found: OtherSensors) -> tuple[ExchangeRecord, ...]:
    """What other models at the mounts of a layout would gain, and what they cost more."""
    return tuple(
        ExchangeRecord(
            model=other.sensor.name,
            kind="lidar" if sensor_kind(other.sensor) == "lidar" else "camera",
            unit=other.one.id,
            horizontal_fov_deg=other.one.sensor.horizontal_fov_deg,
            yaw_deg=round(other.one.pose.yaw_deg, 6),
            pitch_deg=round(other.one.pose.pitch_deg, 6),
            apr=round(other.apr_one, 12),
            gain=round(other.apr_one - found.apr, 12),
            extra_eur=other.sensor.price_eur - layout.units[other.unit_index].sensor.price_eur,
            all_units=len(other.all),
            apr_all=round(other.apr_all, 12),
            apr_as_they_hang=round(other.apr_as_they_hang, 12),
            extra_all_eur=sum(
                other.sensor.price_eur - unit.sensor.price_eur
                for unit in layout.units
                if unit.id in {pose.id for pose in other.all}
            ),
        )
        for other in found.models
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
