"""The result of a placement, an evaluation or a comparison: what ``summary.json`` holds."""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import UNSET, Meta, UnsetType

from .explanations import (
    ExplainedRecord,
    PrivateGroundRecord,
    SensitivityRecord,
)
from .fronts import FrontRecord, RefinementRecord
from .record import Record, RunId, Share, StageRecord, UnitRecord, says
from .sampled_worlds import SampledRecord


class PartyAprRecord(Record, frozen=True, kw_only=True):
    """Accident prevention ratio of a sensing party."""

    all: Annotated[Share | None, says("APR over all runs, by weight.")]
    by_case: Annotated[
        dict[str, Share | None],
        says("APR of each case, by its name; null where no run of it has weight."),
    ]


class EvaluationRecord(Record, frozen=True, kw_only=True):
    """A layout by the evaluator: full perception and emergency braking."""

    schema_rules: ClassVar[dict[str, Any]] = {
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


class GreedyLayoutRecord(Record, frozen=True, kw_only=True):
    """Units chosen one by one, by the evaluator."""

    layout: Annotated[tuple[UnitRecord, ...], says("The units.")]
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


class DisagreementRecord(Record, frozen=True, kw_only=True):
    """A run that either detection table or evaluator calls avoided."""

    party: Annotated[str, says('Id of a unit by itself, or "all, fused".')]
    run_id: Annotated[RunId, says("Which run.")]
    on_table: Annotated[
        bool, says("Whether the detection table calls it avoided; the evaluator says the opposite.")
    ]
    n_frames: Annotated[int, says("Frames before the last moment in which they differ.", ge=0)]
    cause: Annotated[str, says("What the evaluator sees in the first of them, in words.")]


class RefusalRecord(Record, frozen=True, kw_only=True):
    """What the scene has no room for."""

    case: Annotated[str, says("Name of the case.")]
    approach: Annotated[str, says("Arm from which the vehicle would come.")]
    speeds_kmh: Annotated[tuple[float, ...], says("Speeds of the vehicle, in km/h.")]
    reason: Annotated[str, says("Why, in words.")]


class ComparedRecord(Record, frozen=True, kw_only=True):
    """Another layout on the same runs."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.")]
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


class Result(Record, frozen=True, kw_only=True):
    """What a placement, an evaluation or a comparison found: summary.json of a result folder, and
    what --json prints. Shares are 0 to 1. Names end in their unit; no ending: no unit.
    """

    schema_rules: ClassVar[dict[str, Any]] = {
        "dependentRequired": {
            "stages": [
                "goal",
                "candidates",
                "presolve",
                "spent_eur",
                "stages",
                "solver",
                "baseline_name",
                "greedy",
                "disagreements",
                "explained",
                "sensitivity",
            ],
            "goal": ["stages"],
            "explained": ["stages"],
            "front": ["stages"],
            "refinement": ["stages"],
            "compared": [
                "baseline_name",
                "baseline_layout",
                "runs_gained",
                "runs_lost",
                "differences",
            ],
            "differences": ["compared"],
            "baseline_layout": ["compared"],
        }
    }
    schema: Annotated[Literal["place-rsus/result/1"], says("Kind and version of this file.")]
    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[
        tuple[UnitRecord, ...],
        says("The units of the layout found, evaluated, or compared with others."),
    ]
    cost_eur: Annotated[
        float, says("Price of the units by the catalogue, in EUR, without poles or mounting.", ge=0)
    ]
    budget: Annotated[
        Annotated[int, Meta(ge=0)] | None,
        says("Most units that were allowed; null: not limited, or nothing was optimised."),
    ]
    fusion: Annotated[
        Literal["any", "single"],
        says("any: in each frame any unit may detect; single: one unit has to confirm by itself."),
    ]
    runs: Annotated[int, says("Runs that every layout was evaluated on.", ge=1)]
    apr: Annotated[
        Share | None,
        says(
            "Accident prevention ratio: on the detection table where something was optimised, else by the evaluator."
        ),
    ]
    bound: Annotated[
        float | None,
        says("APR that no layout can exceed, on the detection table; null: not looked for."),
    ]
    gap: Annotated[
        float | None,
        says("(bound - apr) / apr; 0: proven best; null: infinite, or not looked for."),
    ]
    apr_without_worst_unit: Annotated[
        Share | None, says("APR if the unit that is needed most fails; of the same origin as apr.")
    ]
    evaluation: Annotated[EvaluationRecord, says("The layout by the evaluator.")]
    goal: (
        Annotated[
            Literal["best", "fewest", "cheapest"],
            says("What was optimised: most accidents prevented, fewest units, or least money."),
        ]
        | UnsetType
    ) = UNSET
    candidates: Annotated[int, says("Candidate poses to choose from.", ge=1)] | UnsetType = UNSET
    presolve: Annotated[str, says("What dropped out before solving, in words.")] | UnsetType = UNSET
    spent_eur: (
        Annotated[float, says("Units, and sites once, as the optimiser counts them, in EUR.")]
        | UnsetType
    ) = UNSET
    stages: (
        Annotated[
            tuple[StageRecord, ...], says("Objectives in order, with their proof.", min_length=1)
        ]
        | UnsetType
    ) = UNSET
    solver: Annotated[str, says("What the proof rests on: name and version.")] | UnsetType = UNSET
    baseline_name: (
        Annotated[str | None, says("Name of the layout to compare with; null: none.")] | UnsetType
    ) = UNSET
    baseline_layout: Annotated[tuple[UnitRecord, ...], says("Its units.")] | UnsetType = UNSET
    baseline: Annotated[EvaluationRecord | None, says("That layout by the evaluator; null: none.")]
    runs_gained: (
        Annotated[tuple[RunId, ...], says("Runs that the layout avoids and the baseline does not.")]
        | UnsetType
    ) = UNSET
    runs_lost: (
        Annotated[tuple[RunId, ...], says("Runs that the baseline avoids and the layout does not.")]
        | UnsetType
    ) = UNSET
    greedy: (
        Annotated[GreedyLayoutRecord, says("Units chosen one by one, for comparison.")] | UnsetType
    ) = UNSET
    surrogate_disagreement: Annotated[
        Share | None,
        says(
            "Share of the runs on which detection table and evaluator disagree; null: nothing was optimised."
        ),
    ]
    disagreements: (
        Annotated[tuple[DisagreementRecord, ...], says("The runs on which they disagree, and why.")]
        | UnsetType
    ) = UNSET
    cases: Annotated[tuple[str, ...], says("Names of the cases that were driven.")]
    weathers: Annotated[tuple[str, ...], says("Weathers that were driven in.")]
    not_driven: Annotated[
        tuple[RefusalRecord, ...], says("What was asked for and has no room in the scene.")
    ]
    detector: Annotated[str, says("What detects: name.")]
    vut_sensors: Annotated[tuple[str, ...], says("Sensors of the vehicle under test.")]
    packet_loss: Annotated[Share, says("Share of the units' messages that get lost.")]
    vam_rate: Annotated[Share, says("Share of the road users that announce themselves.")]
    front: (
        Annotated[
            FrontRecord,
            says(
                "The best layout of each smaller size; missing where something else than the best was asked for."
            ),
        ]
        | UnsetType
    ) = UNSET
    explained: (
        Annotated[ExplainedRecord, says("Why these units, what they miss, what else would do.")]
        | UnsetType
    ) = UNSET
    sensitivity: (
        Annotated[
            SensitivityRecord,
            says(
                "What becomes of the layout if an assumption is wrong; missing where no folder is written."
            ),
        ]
        | UnsetType
    ) = UNSET
    private_ground: (
        Annotated[
            PrivateGroundRecord, says("What cameras see of private ground; only with --no-look.")
        ]
        | UnsetType
    ) = UNSET
    refinement: (
        Annotated[
            RefinementRecord,
            says("What turning units between the poses of the grid changed; only with --refine."),
        ]
        | UnsetType
    ) = UNSET
    sampled: (
        Annotated[SampledRecord, says("APR in sampled worlds; only with --samples.")] | UnsetType
    ) = UNSET
    compared: (
        Annotated[tuple[ComparedRecord, ...], says("The other layouts.", min_length=1)] | UnsetType
    ) = UNSET
    differences: (
        Annotated[tuple[DifferenceRecord, ...], says("For any two of the layouts.")] | UnsetType
    ) = UNSET
    seconds: Annotated[
        dict[str, Annotated[float, Meta(ge=0)]],
        says("Time of each step, by its name, and in total, in seconds."),
    ]
    versions: Annotated[
        dict[str, str], says("Versions of the programs that the numbers depend on, by name.")
    ]
