"""A layout by the evaluator: APR of every sensing party, as it is written."""

from typing import Annotated

from msgspec import field

from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_by_case,
    apr_by_position,
    apr_one_failed,
    apr_one_site_failed,
    mean_impact_speed_kmh,
    score,
    units_by_site,
)
from scenarios.aeb import AebRule

from .record import Record, Share, says


class PartyAprRecord(Record, frozen=True, kw_only=True):
    """Accident prevention ratio of a sensing party."""

    all: Annotated[Share | None, says("APR over all runs, by weight.")]
    by_case: Annotated[
        dict[str, Share | None],
        says("APR of each case, by its name; null where no run of it has weight."),
    ]
    by_position: Annotated[
        dict[str, Share | None],
        says(
            "APR of each position along the arms, by its name, such as 0, -15 or +15; null where "
            "no run there has weight. Nothing in results of recordings."
        ),
    ] = field(default_factory=dict)
    mean_impact_speed_kmh: Annotated[
        float | None,
        says(
            "Mean of the VUT's speed at contact over all runs, by weight; avoided runs count 0. In "
            "km/h; null where nobody braked bodies, as in results of recordings."
        ),
    ] = None
    score: Annotated[
        Share | None,
        says("What the runs count by the speeds at contact; only with --score rating-2026."),
    ] = None


class EvaluationRecord(Record, frozen=True, kw_only=True):
    """A layout by the evaluator: full perception and emergency braking."""

    vut: Annotated[PartyAprRecord, says("The vehicle under test by itself.")]
    rsu_all: Annotated[
        PartyAprRecord, says("All units together: in each frame, any of them may detect.")
    ]
    vut_and_rsus: Annotated[
        PartyAprRecord, says("All units and the vehicle's own sensors together.")
    ]
    units: Annotated[dict[str, PartyAprRecord], says("Each unit by itself, by its id.")]
    vam: Annotated[
        PartyAprRecord | None,
        says("Road users that announce themselves; null where there are no such messages."),
    ] = None
    all_sources: Annotated[
        PartyAprRecord | None,
        says("Units, vehicle and announcements together; null where there are no such messages."),
    ] = None
    apr_without_worst_unit: Annotated[
        Share | None, says("APR of all units together if the one that is needed most fails.")
    ]
    apr_without_worst_site: Annotated[
        Share | None,
        says(
            "APR of all units together if the pole that is needed most fails with all its "
            "units; null where no pole carries several."
        ),
    ] = None


def build_evaluation_record(evaluation: Evaluation, rule: AebRule) -> EvaluationRecord:
    """APR of every sensing party, over all runs and by case."""
    axis = evaluation.axis

    def ratios(verdict: Verdict) -> PartyAprRecord:
        return PartyAprRecord(
            all=apr(verdict, axis),
            by_case={**apr_by_case(verdict, axis)},
            by_position={**apr_by_position(verdict, axis)},
            mean_impact_speed_kmh=mean_impact_speed_kmh(verdict, axis),
            score=None if evaluation.levels is None else score(verdict, axis, evaluation.levels),
        )

    return EvaluationRecord(
        vut=ratios(evaluation.vut),
        rsu_all=ratios(evaluation.rsu_all),
        vut_and_rsus=ratios(evaluation.vut_and_rsus),
        units={name: ratios(verdict) for name, verdict in evaluation.units.items()},
        **{name: ratios(verdict) for name, verdict in evaluation.others.items()},
        apr_without_worst_unit=apr_one_failed(evaluation, rule),
        apr_without_worst_site=(
            apr_one_site_failed(evaluation, rule)
            if any(len(units) > 1 for units in units_by_site(evaluation.layout).values())
            else None
        ),
    )


def price_eur(evaluation: Evaluation) -> float:
    """Price of the units of a layout by the catalogue, in EUR."""
    return sum(unit.sensor.price_eur for unit in evaluation.layout.units)
