"""The result of a placement, an evaluation or a comparison: what ``summary.json`` holds."""

import dataclasses
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from msgspec import UNSET, Meta, UnsetType
from msgspec.structs import asdict as fields_of
from msgspec.structs import replace

from geometry.arrays import BoolArray
from geometry.notes import assumptions
from placement import optimiser
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.evaluation import (
    Evaluation,
)
from placement.explain.agreement import find_disagreements
from placement.explain.sensitivity import Sensitivity
from placement.optimiser import Failing, placement_value, run_margins_s
from placement.pipeline import Placement
from placement.setting import Setting

from .alternatives import (
    ByRunsRecord,
    FrontRunnersRecord,
    HeavyRunRecord,
    StandingRecord,
    SturdierRecord,
    build_heavy_records,
)
from .baselines import BaselinesRecord, ExchangeRecord, NextUnitRecord, StudyCasesRecord
from .dangers import DangersRecord, avoided_runs, build_dangers_record
from .drives import RefusalRecord, build_drives_record, versions
from .evaluations import (
    ComparedRecord,
    DifferenceRecord,
    EvaluationRecord,
    GreedyLayoutRecord,
    build_compared_record,
    build_difference_records,
    build_evaluation_record,
    price_eur,
)
from .explanations import (
    ExplainedRecord,
    PrivateGroundRecord,
)
from .fronts import FrontRecord, RefinementRecord
from .record import (
    NoteRecord,
    Record,
    RunId,
    Share,
    StageRecord,
    UnitRecord,
    build_stage_records,
    build_unit_records,
    says,
)
from .sampled_worlds import SampledRecord


class DisagreementRecord(Record, frozen=True, kw_only=True):
    """A run that either detection table or evaluator calls avoided."""

    party: Annotated[str, says('Id of a unit by itself, or "all, fused".')]
    run_id: Annotated[RunId, says("Which run.")]
    on_table: Annotated[
        bool, says("Whether the detection table calls it avoided; the evaluator says the opposite.")
    ]
    n_frames: Annotated[int, says("Frames before the last moment in which they differ.", ge=0)]
    cause: Annotated[str, says("What the evaluator sees in the first of them, in words.")]


class Result(Record, frozen=True, kw_only=True):
    """What a placement, an evaluation or a comparison found.

    It is summary.json of a result folder, and what --json prints. Shares are 0 to 1. Names end in
    their unit; no ending: no unit.
    """

    schema_rules: ClassVar[dict[str, object]] = {
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
            "next_unit": ["stages"],
            "other_sensors": ["stages"],
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
        says("The units of the layout found, evaluated, or compared with others.", min_length=1),
    ]
    cost_eur: Annotated[
        float, says("Price of the units by the catalogue, in EUR, without poles or mounting.", ge=0)
    ]
    sites_eur: (
        Annotated[
            float,
            says(
                "Making their sites ready: their own prices, or those assumed by kind "
                "(assumed_prices), in EUR; missing: unknown.",
                ge=0,
            ),
        ]
        | UnsetType
    ) = UNSET
    budget: Annotated[
        Annotated[int, Meta(ge=0)] | None,
        says("Most units that were allowed; null: not limited, or nothing was optimised."),
    ]
    fusion: Annotated[
        Literal["any", "single"],
        says("any: in each frame any unit may detect; single: one unit has to confirm by itself."),
    ]
    runs: Annotated[int, says("Runs that every layout was evaluated on.", ge=1)]
    possible_runs: Annotated[
        int,
        says("These, and the runs that the junction has the roads for, but not the room.", ge=1),
    ]
    driven: Annotated[
        tuple[str, ...],
        says(
            "How many of the possible runs are driven, what is missing, and why, in sentences; "
            "empty where nothing is."
        ),
    ]
    apr: Annotated[
        Share | None,
        says(
            "Accident prevention ratio: on the detection table where something was optimised, "
            "else by the evaluator."
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
    apr_without_worst_site: (
        Annotated[
            Share,
            says(
                "APR if the pole that is needed most fails with all its units, on the detection "
                "table; only where a pole carries several."
            ),
        ]
        | UnsetType
    ) = UNSET
    failing: (
        Annotated[
            Literal["site"],
            says("What fails at once where the optimiser asks (--survive site); missing: units."),
        ]
        | UnsetType
    ) = UNSET
    assumptions: Annotated[
        tuple[NoteRecord, ...],
        says("What the map of the junction leaves open and was assumed, what matters most first."),
    ] = ()
    evaluation: Annotated[EvaluationRecord, says("The layout by the evaluator.")]
    baseline: Annotated[EvaluationRecord | None, says("That layout by the evaluator; null: none.")]
    surrogate_disagreement: Annotated[
        Share | None,
        says(
            "Share of the runs on which detection table and evaluator disagree; null: nothing was "
            "optimised."
        ),
    ]
    seconds: Annotated[
        dict[str, Annotated[float, Meta(ge=0)]],
        says("Time of each step, by its name, and in total, in seconds."),
    ]
    versions: Annotated[
        dict[str, str], says("Versions of the programs that the numbers depend on, by name.")
    ]
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
    assumed_prices: (
        Annotated[
            tuple[str, ...],
            says(
                "What is assumed of sites without a price, in sentences: of those used, or of all "
                "where money counts."
            ),
        ]
        | UnsetType
    ) = UNSET
    stages: (
        Annotated[
            tuple[StageRecord, ...], says("Objectives in order, with their proof.", min_length=1)
        ]
        | UnsetType
    ) = UNSET
    solver: Annotated[str, says("What the proof rests on: name and version.")] | UnsetType = UNSET
    compared: (
        Annotated[tuple[ComparedRecord, ...], says("The other layouts.", min_length=1)] | UnsetType
    ) = UNSET
    baseline_name: (
        Annotated[str | None, says("Name of the layout to compare with; null: none.")] | UnsetType
    ) = UNSET
    baseline_layout: (
        Annotated[tuple[UnitRecord, ...], says("Its units.", min_length=1)] | UnsetType
    ) = UNSET
    runs_gained: (
        Annotated[tuple[RunId, ...], says("Runs that the layout avoids and the baseline does not.")]
        | UnsetType
    ) = UNSET
    runs_lost: (
        Annotated[tuple[RunId, ...], says("Runs that the baseline avoids and the layout does not.")]
        | UnsetType
    ) = UNSET
    differences: (
        Annotated[tuple[DifferenceRecord, ...], says("For any two of the layouts.")] | UnsetType
    ) = UNSET
    greedy: (
        Annotated[GreedyLayoutRecord, says("Units chosen one by one, for comparison.")] | UnsetType
    ) = UNSET
    disagreements: (
        Annotated[tuple[DisagreementRecord, ...], says("The runs on which they disagree, and why.")]
        | UnsetType
    ) = UNSET
    cases: Annotated[tuple[str, ...], says("Names of the cases that were driven.")]
    weathers: Annotated[tuple[str, ...], says("Weathers that were driven in.")]
    detector: Annotated[str, says("What detects: name.")]
    vut_sensors: Annotated[tuple[str, ...], says("Sensors of the vehicle under test.")]
    packet_loss: Annotated[Share, says("Share of the units' messages that get lost.")]
    vam_rate: Annotated[Share, says("Share of the road users that announce themselves.")]
    track_memory_s: Annotated[
        float | None,
        says(
            "How long a confirmed track lives without detections, in seconds; null: for ever, as "
            "in results that do not say it."
        ),
    ] = None
    not_driven: Annotated[
        tuple[RefusalRecord, ...], says("What was asked for and has no room in the scene.")
    ]
    explained: (
        Annotated[ExplainedRecord, says("Why these units, what they miss, what else would do.")]
        | UnsetType
    ) = UNSET
    front: (
        Annotated[
            FrontRecord,
            says(
                "The best layout of each smaller size; missing where something else than the best "
                "was asked for."
            ),
        ]
        | UnsetType
    ) = UNSET
    dangers: (
        Annotated[
            DangersRecord,
            says("Runs that the layout does not avoid, by the evaluator, and where they are."),
        ]
        | UnsetType
    ) = UNSET
    next_unit: (
        Annotated[
            NextUnitRecord,
            says(
                "What one more unit would gain on the detection table, chosen greedily, budgets "
                "aside; missing where none fits."
            ),
        ]
        | UnsetType
    ) = UNSET
    other_sensors: (
        Annotated[
            tuple[ExchangeRecord, ...],
            says(
                "Other models at the same mounts, on the detection table, the one that gains most "
                "first; missing where no unit can be exchanged."
            ),
        ]
        | UnsetType
    ) = UNSET
    baselines: (
        Annotated[
            BaselinesRecord,
            says("Random layouts and an expert's rule, with as many units; beside layouts found."),
        ]
        | UnsetType
    ) = UNSET
    study_cases: (
        Annotated[
            StudyCasesRecord,
            says(
                "The same layouts on the study's cases, by the evaluator; missing where these are "
                "what was asked about, or no arm carries them."
            ),
        ]
        | UnsetType
    ) = UNSET
    heavy_runs: Annotated[
        tuple[HeavyRunRecord, ...],
        says("Runs that count more than 2 % of the APR, and more than others; the heaviest first."),
    ] = ()
    by_runs: (
        Annotated[
            ByRunsRecord,
            says("Whether the layout is the best, too, if every run counts the same."),
        ]
        | UnsetType
    ) = UNSET
    sturdier: (
        Annotated[
            SturdierRecord,
            says("What --survive 1 gives; missing where that costs 3 points of APR or more."),
        ]
        | UnsetType
    ) = UNSET
    mounting: Annotated[StandingRecord, says("What errors of mounting cost.")] | UnsetType = UNSET
    front_runners: (
        Annotated[
            FrontRunnersRecord,
            says("Which of the layouts that lead on the table the evaluator recommends."),
        ]
        | UnsetType
    ) = UNSET
    without_effect: Annotated[
        tuple[str, ...], says("What was asked for and changes nothing, in sentences.")
    ] = ()
    sensitivity: (
        Annotated[
            Sensitivity,
            says(
                "Worth of the layout if an assumption is wrong; missing where no folder is written."
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


def build_layout_result(setting: Setting, evaluation: Evaluation) -> Result:
    """One layout by the evaluator: the fields that every result has.

    Those that only an optimisation or a comparison knows are None or UNSET; "seconds" is empty.
    """
    evaluated = build_evaluation_record(evaluation, setting.rule)
    return Result(
        schema="place-rsus/result/1",
        name=evaluation.layout.name,
        layout=build_unit_records(evaluation.layout, setting.scene),
        assumptions=tuple(NoteRecord(**asdict(note)) for note in assumptions(setting.scene.notes)),
        cost_eur=price_eur(evaluation),
        budget=None,
        fusion="any",
        runs=evaluation.axis.n_runs,
        apr=evaluated.rsu_all.all,
        bound=None,
        gap=None,
        apr_without_worst_unit=evaluated.apr_without_worst_unit,
        evaluation=evaluated,
        baseline=None,
        surrogate_disagreement=None,
        seconds={},
        versions=versions(),
        dangers=build_dangers_record(evaluation.rsu_all.is_avoided, evaluation.axis),
        heavy_runs=build_heavy_records(evaluation.axis),
        **fields_of(build_drives_record(setting)),
    )


def build_placement_result(
    placement: Placement,
    setting: Setting,
    *,
    found: Evaluation,
    greedy: Evaluation,
    baseline: Evaluation | None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Result:
    """A placement by the optimiser and by the evaluator, beside the greedy layout and a baseline.

    What explains it ("explained", "front", "sensitivity", ...) is left out.
    """
    certificate, problem = placement.certificate, placement.problem
    rule = problem.rule
    value = placement_value(problem, placement.pose_index)
    limits = problem.limits
    units_fail, sites_fail = (
        optimiser.apr_one_failed(
            dataclasses.replace(problem, limits=dataclasses.replace(limits, failing=what)),
            placement.pose_index,
        )
        for what in get_args(Failing)
    )
    n_sites = len(np.unique(limits.site_index[list(placement.pose_index)]))
    apr_stage = next((stage for stage in certificate.stages if stage.name == "apr"), None)
    return replace(
        build_layout_result(setting, found),
        budget=problem.limits.budget_new_units,
        fusion=problem.fusion,
        dangers=build_dangers_record(avoided_runs(found, problem.fusion), found.axis),
        apr=_without_rounding(value.apr),
        bound=None if apr_stage is None else _without_rounding(apr_stage.bound),
        gap=None if apr_stage is None else apr_stage.gap,
        apr_without_worst_unit=_without_rounding(units_fail),
        apr_without_worst_site=(
            _without_rounding(sites_fail) if n_sites < len(placement.pose_index) else UNSET
        ),
        failing="site" if limits.failing == "site" else UNSET,
        goal=problem.goal,
        candidates=problem.table.n_poses,
        presolve=str(placement.presolve),
        spent_eur=value.cost_eur,
        stages=build_stage_records(certificate),
        solver=certificate.solver,
        baseline_name=None if baseline is None else baseline.layout.name,
        baseline=None if baseline is None else build_evaluation_record(baseline, rule),
        greedy=GreedyLayoutRecord(
            layout=build_unit_records(greedy.layout),
            **fields_of(build_evaluation_record(greedy, rule)),
        ),
        surrogate_disagreement=float(np.mean(disagreeing_runs(placement, found))),
        disagreements=tuple(
            DisagreementRecord(**asdict(disagreement))
            for disagreement in find_disagreements(
                setting, placement.nominal.table, found, placement.nominal_index, compute=compute
            )
        ),
    )


def build_comparison_result(
    setting: Setting,
    subject: Evaluation,
    others: Sequence[Evaluation],
    *,
    private_ground: Sequence[PrivateGroundRecord | UnsetType] = (),
) -> Result:
    """A layout against others on the same runs; the first of the others is the baseline.

    Parameters
    ----------
    others : sequence of Evaluation
        At least one.
    private_ground : sequence, optional
        What each of the others sees of private ground.
    """
    rule = setting.rule
    compared = tuple(
        build_compared_record(subject, other, rule, private)
        for other, private in zip(others, private_ground or [UNSET] * len(others), strict=True)
    )
    first = compared[0]
    return replace(
        build_layout_result(setting, subject),
        compared=compared,
        baseline_name=first.name,
        baseline_layout=first.layout,
        baseline=first.evaluation,
        runs_gained=first.runs_gained,
        runs_lost=first.runs_lost,
        differences=build_difference_records(
            {item.layout.name: item for item in (subject, *others)}
        ),
    )


def disagreeing_runs(placement: Placement, evaluation: Evaluation) -> BoolArray:
    """Runs on which detection table and evaluator disagree about the layout found: (n_runs,) bool.

    Both under the placement's own fusion.
    """
    on_table = np.isfinite(run_margins_s(placement.nominal, placement.nominal_index))
    disagrees: BoolArray = on_table != avoided_runs(evaluation, placement.problem.fusion)
    return disagrees


def _without_rounding(value: float) -> float:
    """Without what summing up many weights leaves over: all of them are 1."""
    return round(value, 12)
