"""Layouts by the evaluator, one by one and against one another, as they are written."""

from collections.abc import Mapping
from itertools import combinations
from typing import Annotated, ClassVar

import numpy as np
from msgspec import UNSET, UnsetType, field

from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_by_case,
    apr_by_position,
    apr_one_failed,
    apr_one_site_failed,
    units_by_site,
)
from scenarios.aeb import AebRule

from .explanations import PrivateGroundRecord
from .record import Record, RunId, Share, UnitRecord, build_unit_records, says


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
            "no run there has weight. Nothing in older results, and in those of recordings."
        ),
    ] = field(default_factory=dict)


class EvaluationRecord(Record, frozen=True, kw_only=True):
    """A layout by the evaluator: full perception and emergency braking."""

    schema_rules: ClassVar[dict[str, object]] = {
        "dependentRequired": {"vam": ["all_sources"], "all_sources": ["vam"]}
    }
    vut: Annotated[PartyAprRecord, says("The vehicle under test by itself.")]
    rsu_all: Annotated[
        PartyAprRecord, says("All units together: in each frame, any of them may detect.")
    ]
    vut_and_rsus: Annotated[
        PartyAprRecord, says("All units and the vehicle's own sensors together.")
    ]
    units: Annotated[dict[str, PartyAprRecord], says("Each unit by itself, by its id.")]
    vam: (
        Annotated[
            PartyAprRecord,
            says("Road users that announce themselves; only where there are such messages."),
        ]
        | UnsetType
    ) = UNSET
    all_sources: (
        Annotated[
            PartyAprRecord,
            says("Units, vehicle and announcements together; only where there are such messages."),
        ]
        | UnsetType
    ) = UNSET
    apr_without_worst_unit: Annotated[
        Share | None, says("APR of all units together if the one that is needed most fails.")
    ]
    apr_without_worst_site: (
        Annotated[
            Share,
            says(
                "APR of all units together if the pole that is needed most fails with all its "
                "units; only where a pole carries several."
            ),
        ]
        | UnsetType
    ) = UNSET


class GreedyLayoutRecord(EvaluationRecord, frozen=True, kw_only=True):
    """Units chosen one by one, by the evaluator."""

    layout: Annotated[tuple[UnitRecord, ...], says("The units.", min_length=1)]


class ComparedRecord(Record, frozen=True, kw_only=True):
    """Another layout on the same runs."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.", min_length=1)]
    cost_eur: Annotated[
        float, says("Price of its units by the catalogue, in EUR, without poles or mounting.", ge=0)
    ]
    evaluation: Annotated[EvaluationRecord, says("By the evaluator.")]
    runs_gained: Annotated[
        tuple[RunId, ...], says("Runs that the first layout avoids and this one does not.")
    ]
    runs_lost: Annotated[
        tuple[RunId, ...], says("Runs that this one avoids and the first one does not.")
    ]
    private_ground: (
        Annotated[
            PrivateGroundRecord,
            says("What its cameras see of private ground; only with --no-look."),
        ]
        | UnsetType
    ) = UNSET


class DifferenceRecord(Record, frozen=True, kw_only=True):
    """Runs that only one of two layouts avoids, all units of each together."""

    first: Annotated[str, says("Name of the one layout.")]
    second: Annotated[str, says("Name of the other one.")]
    only_first: Annotated[tuple[RunId, ...], says("Avoided by the first one alone.")]
    only_second: Annotated[tuple[RunId, ...], says("Avoided by the second one alone.")]


def build_evaluation_record(evaluation: Evaluation, rule: AebRule) -> EvaluationRecord:
    """APR of every sensing party, over all runs and by case."""
    axis = evaluation.axis

    def ratios(verdict: Verdict) -> PartyAprRecord:
        return PartyAprRecord(
            all=apr(verdict, axis),
            by_case={**apr_by_case(verdict, axis)},
            by_position={**apr_by_position(verdict, axis)},
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
            else UNSET
        ),
    )


def build_difference_records(evaluations: Mapping[str, Evaluation]) -> tuple[DifferenceRecord, ...]:
    """Which runs only one of two layouts avoids, for any two; evaluations by display name."""
    return tuple(
        DifferenceRecord(
            first=name,
            second=other_name,
            only_first=_only_first(one, other),
            only_second=_only_first(other, one),
        )
        for (name, one), (other_name, other) in combinations(evaluations.items(), 2)
    )


def build_compared_record(
    subject: Evaluation,
    other: Evaluation,
    rule: AebRule,
    private_ground: PrivateGroundRecord | UnsetType,
) -> ComparedRecord:
    """Another layout beside the first one, on the same runs."""
    return ComparedRecord(
        name=other.layout.name,
        layout=build_unit_records(other.layout),
        cost_eur=price_eur(other),
        evaluation=build_evaluation_record(other, rule),
        runs_gained=_only_first(subject, other),
        runs_lost=_only_first(other, subject),
        private_ground=private_ground,
    )


def _only_first(one: Evaluation, other: Evaluation) -> tuple[str, ...]:
    """Runs that the first of two layouts avoids and the second one does not."""
    runs = np.array(one.axis.run_ids)
    return tuple(runs[one.rsu_all.is_avoided & ~other.rsu_all.is_avoided].tolist())


def price_eur(evaluation: Evaluation) -> float:
    """What the units of a layout cost by the catalogue, in EUR."""
    return sum(unit.sensor.price_eur for unit in evaluation.layout.units)
