"""Records: frozen values of results, with their JSON and its schema."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, ClassVar, Literal, get_args

import msgspec
import numpy as np
from msgspec import Meta, field
from msgspec.structs import replace

from geometry.junction import whereabouts
from geometry.notes import assumed_sites
from geometry.phrases import Phrase
from geometry.scene import Scene
from geometry.tables import says as says
from geometry.terrain import ground_height_m, terrain_of
from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_by_case,
    apr_by_position,
    apr_one_failed,
    apr_one_site_failed,
    mean_impact_speed_kmh,
    mix,
    units_by_site,
)
from placement.layout import Certificate, Layout, layout_records
from scenarios.aeb import AebRule

Share = Annotated[
    float,
    Meta(
        ge=-1e-9,
        le=1.000000001,
        extra_json_schema={"title": "From 0 to 1, but for rounding."},
    ),
]
RunId = Annotated[str, says("Name of a run, as in runs.parquet.", min_length=1)]
StageName = Literal[
    "units",
    "cost_eur",
    "apr_survived",
    "apr",
    "apr_one_failed",
    "smallest_margin_s",
    "mean_margin_s",
]
"""Objectives, in order: number of units; cost in EUR; APR that is left when any units
fail; APR; APR if the most needed unit fails; smallest and mean time to spare in s."""
StageValues = Annotated[
    dict[StageName, float],
    Meta(extra_json_schema={"propertyNames": {"enum": list(get_args(StageName))}}),
]
"""Value of each stage, in the unit that its name ends in."""


class Record(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of a result.

    Each field says what it is; fields that are UNSET are not written.

    Attributes
    ----------
    schema_rules : mapping
        What the JSON schema says of the keys beside their types, such as "oneOf".
    """

    # Of the JSON schema, about several keys.
    schema_rules: ClassVar[dict[str, object]] = {}


def to_plain(value: object) -> Any:
    """Values and records as JSON has them.

    Numbers that JSON lacks (NaN, infinite) are None.
    """
    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=_plain_value))


def _plain_value(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Phrase):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__}: no plain value")


class UnitRecord(Record, frozen=True, kw_only=True, omit_defaults=True):
    """A mounted sensor, as in layout.json.

    World frame: x east, y north, z up, 0 on the road.
    """

    schema_rules: ClassVar[dict[str, object]] = {
        "oneOf": [{"required": ["camera"]}, {"required": ["lidar"]}]
    }
    id: Annotated[str, says("Name within the layout.", min_length=1)]
    site: Annotated[str, says("Site of the scene; empty: none.")]
    x_m: Annotated[float, says("East, in metres.")]
    y_m: Annotated[float, says("North, in metres.")]
    z_m: Annotated[
        float, says("Above the road (of a slope: in the junction's middle), in metres.")
    ]
    yaw_deg: Annotated[float, says("Counter-clockwise from east, in degrees.")]
    pitch_deg: Annotated[float, says("Positive up, in degrees.", ge=-90, le=90)]
    camera: Annotated[
        str | None, says("Model in catalogue or layout.json; this or lidar.")
    ] = None
    lidar: Annotated[
        str | None, says("Model in catalogue or layout.json; this or camera.")
    ] = None
    fov_deg: Annotated[
        float | None,
        says(
            "Horizontal, to which a varifocal lens is set, in degrees; missing: the"
            " catalogue's."
        ),
    ] = None
    latency_s: Annotated[
        Annotated[float, Meta(ge=0)] | None,
        says("Of this unit, in seconds; missing: that of the rule."),
    ] = None
    height_m: Annotated[
        float | None,
        says("Above the ground below, in metres; missing: z_m, the ground is flat."),
    ] = None
    kind: Annotated[str | None, says("Of the site: lamp post, kerb and so on.")] = None
    place: Annotated[str | None, says("Corner, or arm and street; empty: unknown.")] = (
        None
    )
    assumed: Annotated[
        str | None, says("What is assumed of the site; missing: nothing.")
    ] = None


class StageRecord(Record, frozen=True, kw_only=True):
    """An objective on the detection table.

    They are optimised in order, each holding the last.
    """

    name: Annotated[StageName, says("Which objective.")]
    objective: Annotated[
        float, says("Of the layout found, in the unit that the name ends in.")
    ]
    bound: Annotated[
        float | None, says("What no layout exceeds, or goes below; null: unknown.")
    ]
    gap: Annotated[
        float | None, says("Of the two, over the objective; 0: proven; null: infinite.")
    ]
    seconds: Annotated[float, says("Time spent, in seconds.", ge=0)]


def build_unit_records(
    layout: Layout, scene: Scene | None = None
) -> tuple[UnitRecord, ...]:
    """The units of a layout.

    With a scene also what people call where they are.
    """
    records = tuple(UnitRecord(**unit) for unit in layout_records(layout))
    if scene is None:
        return records
    kinds = {site.id: site.kind for site in scene.sites}
    assumed = assumed_sites(scene.notes)
    feet_m = np.array([unit.pose.position_m[:2] for unit in layout.units])
    places = whereabouts(scene, feet_m)
    heights_m: list[float | None] = [None] * len(records)
    if terrain_of(scene) is not None:
        ground_m = ground_height_m(scene, feet_m).tolist()
        heights_m = [
            round(record.z_m - below_m, 3)
            for record, below_m in zip(records, ground_m, strict=True)
        ]
    return tuple(
        replace(
            record,
            height_m=height_m,
            kind=kinds.get(record.site),
            place=place,
            assumed=assumed.get(record.site),
        )
        for record, height_m, place in zip(records, heights_m, places, strict=True)
    )


def build_stage_records(certificate: Certificate) -> tuple[StageRecord, ...]:
    """The stages of a certificate, in order."""
    return tuple(StageRecord(**asdict(stage)) for stage in certificate.stages)


class LayoutValueRecord(Record, frozen=True, kw_only=True):
    """Value of units on the detection table."""

    apr: Annotated[Share, says("APR on the detection table.")]
    apr_one_failed: Annotated[Share, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[
        float, says("Least time to spare, in seconds; 0: none.")
    ]
    mean_margin_s: Annotated[float, says("Mean time to spare, in seconds; 0: none.")]
    cost_eur: Annotated[float, says("Units, and sites once, in EUR.")]


class PartyAprRecord(Record, frozen=True, kw_only=True):
    """Accident prevention ratio of a sensing party."""

    all: Annotated[Share | None, says("APR over all runs, by weight.")]
    by_case: Annotated[
        dict[str, Share | None], says("APR of each case; null: no run has weight.")
    ]
    by_position: Annotated[
        dict[str, Share | None],
        says(
            "The same of each position along the arms, such as -15; empty of"
            " recordings."
        ),
    ] = field(default_factory=dict)
    mean_impact_speed_kmh: Annotated[
        float | None,
        says(
            "Of the VUT at contact by weight, avoided runs as 0, in km/h; null of"
            " recordings."
        ),
    ] = None


class EvaluationRecord(Record, frozen=True, kw_only=True):
    """A layout by the evaluator: full perception and emergency braking."""

    vut: Annotated[PartyAprRecord, says("The vehicle under test by itself.")]
    rsu_all: Annotated[
        PartyAprRecord, says("All units: in each frame, any of them may detect.")
    ]
    vut_and_rsus: Annotated[
        PartyAprRecord, says("All units and the vehicle's own sensors.")
    ]
    units: Annotated[dict[str, PartyAprRecord], says("Each unit by itself, by its id.")]
    vam: Annotated[
        PartyAprRecord | None, says("Road users' own messages; null: none.")
    ] = None
    all_sources: Annotated[
        PartyAprRecord | None, says("All together; null: no messages.")
    ] = None
    headline: Annotated[
        PartyAprRecord | None,
        says(
            "What the layout is judged by where cars see (--cars): units and vehicle"
            " together, or with a share of cars that see the weighted sum of that and"
            " rsu_all. Null: rsu_all."
        ),
    ] = None
    apr_without_worst_unit: Annotated[
        Share | None, says("Of all but the most needed unit.")
    ]
    apr_without_worst_site: Annotated[
        Share | None, says("The same of poles, or null.")
    ] = None

    @property
    def judged(self) -> PartyAprRecord:
        """What the layout is judged by."""
        if self.headline is None:
            return self.rsu_all
        return self.headline


def mixed(blind: Any, seeing: Any, cars: float) -> Any:
    """A record whose numbers are weighted by the share of cars that see.

    Counts as for most.
    """
    if cars in (0.0, 1.0):
        if cars:
            return seeing
        return blind
    if isinstance(blind, float):
        return mix(blind, seeing, cars)
    if isinstance(blind, dict):
        return {key: mixed(value, seeing[key], cars) for key, value in blind.items()}
    if not isinstance(blind, Record):
        return blind
    names = blind.__struct_fields__
    return replace(
        blind,
        **{
            name: mixed(getattr(blind, name), getattr(seeing, name), cars)
            for name in names
        },
    )


def build_evaluation_record(evaluation: Evaluation, rule: AebRule) -> EvaluationRecord:
    """APR of every sensing party, over all runs and by case."""
    axis = evaluation.axis

    def ratios(verdict: Verdict) -> PartyAprRecord:
        return PartyAprRecord(
            all=apr(verdict, axis),
            by_case={**apr_by_case(verdict, axis)},
            by_position={**apr_by_position(verdict, axis)},
            mean_impact_speed_kmh=mean_impact_speed_kmh(verdict, axis),
        )

    blind = ratios(evaluation.rsu_all)
    seeing = ratios(evaluation.vut_and_rsus)
    is_shared = any(
        len(units) > 1 for units in units_by_site(evaluation.layout).values()
    )
    return EvaluationRecord(
        vut=ratios(evaluation.vut),
        rsu_all=blind,
        vut_and_rsus=seeing,
        headline=mixed(blind, seeing, evaluation.cars) if evaluation.cars else None,
        units={name: ratios(verdict) for name, verdict in evaluation.units.items()},
        **{name: ratios(verdict) for name, verdict in evaluation.others.items()},
        apr_without_worst_unit=apr_one_failed(evaluation, rule),
        apr_without_worst_site=(
            apr_one_site_failed(evaluation, rule) if is_shared else None
        ),
    )


def price_eur(evaluation: Evaluation) -> float:
    """Price of the units of a layout by the catalogue, in EUR."""
    return sum(unit.sensor.price_eur for unit in evaluation.layout.units)
