"""The three results that ``summary.json`` may hold.

A placement, an evaluation, a comparison.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from msgspec import Meta
from msgspec.structs import asdict

from geometry.arrays import BoolArray
from geometry.notes import Note, assumptions
from placement import optimiser
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.evaluation import Evaluation
from placement.explain.agreement import Disagreement, find_disagreements
from placement.explain.alternatives import ByRuns
from placement.explain.contributions import NextUnit
from placement.explain.tolerances import Standing
from placement.located_choice import LocatedChoice
from placement.optimiser import Failing, placement_value, run_margins_s
from placement.pipeline import Placement
from placement.setting import Setting

from ..results.drives import DrivesRecord, build_drives_record, versions
from ..results.record import (
    EvaluationRecord,
    Record,
    Share,
    StageRecord,
    UnitRecord,
    build_evaluation_record,
    build_stage_records,
    build_unit_records,
    price_eur,
    says,
)
from .accidents import case_titles, is_weighted
from .added import Added, build_added
from .alternatives import FrontRunners, HeavyRun, find_heavy_runs
from .baselines import Baselines
from .comparison import Compared, Difference, build_compared
from .dangers import Dangers, avoided_runs, build_dangers
from .decision import AimsRecord, DecisionRecord
from .explanation import ExplainedRecord, RefinementRecord
from .front import FrontRecord
from .road_users import RoadUserGroups, build_road_users
from .sampled_worlds import SampledPairRecord, SampledRecord, build_pair_record
from .study_cases import StudyCases
from .units import PrivateGroundRecord


class AskedRecord(Record, frozen=True, kw_only=True):
    """What was asked: enough for `verify --deep` to make the result anew."""

    command: Annotated[str, says("The command line, as a shell takes it.")]
    question: Annotated[
        dict[str, str | int | float | bool],
        says("What differs from the defaults, by the keys of a question file."),
    ]
    seed: Annotated[int, says("Of all that is left to chance.", ge=0)]
    rays: Annotated[str, says("Library that casts rays: --rays.")]
    language: Annotated[str, says("Of the report.")]


class Answer(DrivesRecord, frozen=True, kw_only=True, tag_field="schema"):
    """Head of all three: a layout by the evaluator, and what was driven.

    A result is summary.json of a result folder, and what --json prints. Shares are 0 to
    1. Names end in their unit; no ending: no unit. Parts that nobody asked for are
    null.
    """

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[
        tuple[UnitRecord, ...], says("Units of the layout.", min_length=1)
    ]
    cost_eur: Annotated[
        float, says("The units by the catalogue, without poles, in EUR.", ge=0)
    ]
    existing: Annotated[
        tuple[str, ...], says("Ids of units that are mounted already (--keep).")
    ] = ()
    sensors_eur: Annotated[
        float | None, says("Sensors to buy, in EUR; null: a price is unknown.")
    ] = None
    sites_eur: Annotated[
        float | None, says("Sites made ready, in EUR; null: unknown.")
    ] = None
    assumed_prices: Annotated[
        tuple[str, ...], says("Of sites without a price, in words.")
    ] = ()
    fusion: Annotated[
        Literal["any", "single"],
        says(
            "any: in each frame any unit may detect; single: one unit has to confirm by"
            " itself."
        ),
    ]
    runs: Annotated[int, says("Runs that every layout was evaluated on.", ge=1)]
    is_weighted: Annotated[bool, says("Some runs count more than others.")] = False
    apr: Annotated[
        Share | None, says("Of a placement on the table, else by the evaluator.")
    ]
    assumptions: Annotated[
        tuple[Note, ...], says("What the map leaves open; worst first.")
    ] = ()
    evaluation: Annotated[EvaluationRecord, says("The layout by the evaluator.")]
    dangers: Annotated[
        Dangers, says("Runs that it does not avoid, by the evaluator, and where.")
    ]
    added: Annotated[
        Added | None,
        says(
            "What the units add to a vehicle that sees, by the evaluator, whatever"
            " --cars says."
        ),
    ] = None
    heavy_runs: Annotated[
        tuple[HeavyRun, ...],
        says(
            "Runs that count more than 2 % of the APR, and more than others; the"
            " heaviest first."
        ),
    ] = ()
    road_users: Annotated[
        RoadUserGroups | None, says("By the road user that is met.")
    ] = None
    study_cases: Annotated[
        StudyCases | None,
        says(
            "The layouts on the study's cases; null where these are asked about, or"
            " cannot be."
        ),
    ] = None
    decision: Annotated[
        DecisionRecord | None,
        says("The layouts by what a car decides; only with --decision."),
    ] = None
    aims: Annotated[
        AimsRecord | None,
        says("What the aims decide; null where a share of the cars sees."),
    ] = None
    private_ground: Annotated[
        PrivateGroundRecord | None, says("Only with --no-look.")
    ] = None
    seconds: Annotated[
        dict[str, Annotated[float, Meta(ge=0)]], says("Of each step, in seconds.")
    ]
    versions: Annotated[
        dict[str, str], says("Of the programs that the numbers depend on.")
    ]
    asked: Annotated[
        AskedRecord | None, says("What was asked; null where no folder was written.")
    ] = None


class HighestRecord(Record, frozen=True, kw_only=True):
    """The layout of the highest APR, where some of it might be given up.

    That is to bear a failure.
    """

    given_up: Annotated[float, says("APR that might be given up, 0..1.")]
    stages: Annotated[tuple[StageRecord, ...], says("The proof of the highest APR.")]
    compared: Annotated[
        Compared | None, says("By the evaluator; null: it is the one chosen.")
    ]


class PlacementResult(Answer, frozen=True, kw_only=True, tag="place-rsus/placement/2"):
    """The best layout found, with its proof, and what to compare it with."""

    goal: Annotated[
        Literal["best", "fewest", "cheapest"],
        says(
            "What was optimised: most accidents prevented, fewest units, or least"
            " money."
        ),
    ]
    budget: Annotated[
        Annotated[int, Meta(ge=0)] | None,
        says("Most units that were allowed; null: not limited."),
    ]
    candidates: Annotated[int, says("Candidate poses to choose from.", ge=1)]
    presolve: Annotated[str, says("What dropped out before solving, in words.")]
    stages: Annotated[
        tuple[StageRecord, ...], says("Objectives in order, proven.", min_length=1)
    ]
    solver: Annotated[str, says("What the proof rests on: name and version.")]
    bound: Annotated[
        float | None, says("APR on the table that no layout exceeds; null: unknown.")
    ]
    gap: Annotated[
        float | None, says("(bound - apr) / apr; 0: proven; null: infinite, unknown.")
    ]
    spent_eur: Annotated[float, says("Units, and sites once, as optimised, in EUR.")]
    apr_without_worst_unit: Annotated[
        Share, says("On the table, without the most needed unit.")
    ]
    apr_without_worst_site: Annotated[
        Share | None, says("The same of poles; null: none shared.")
    ]
    failing: Annotated[
        Literal["unit", "site"],
        says(
            "What fails at once where the optimiser asks: units, or poles (--survive"
            " site)."
        ),
    ]
    highest: Annotated[
        HighestRecord | None,
        says("The highest APR of any layout; null where none of it might be given up."),
    ] = None
    greedy: Annotated[Compared, says("Units chosen one by one, for comparison.")]
    baseline: Annotated[
        Compared | None, says("The study's layout; null at other junctions.")
    ]
    surrogate_disagreement: Annotated[
        Share, says("Of the runs: table and evaluator disagree.")
    ]
    disagreements: Annotated[
        tuple[Disagreement, ...], says("These runs, and why they disagree.")
    ]
    explained: Annotated[ExplainedRecord, says("What the units miss, and why.")]
    front: Annotated[
        FrontRecord | None, says("Best layouts of smaller sizes; may be null.")
    ] = None
    next_unit: Annotated[
        NextUnit | None,
        says(
            "What one more unit gains on the table, by greedy choice; null where none"
            " fits."
        ),
    ] = None
    baselines: Annotated[
        Baselines, says("Random layouts and an expert's rule of as many units.")
    ]
    by_runs: Annotated[
        ByRuns | None, says("Whether it is so if all runs count alike.")
    ] = None
    mounting: Annotated[Standing | None, says("What errors of mounting cost.")] = None
    front_runners: Annotated[
        FrontRunners | None, says("What the evaluator recommends.")
    ] = None
    located: Annotated[
        LocatedChoice | None, says("How it was chosen; only with --located.")
    ] = None
    refinement: Annotated[
        RefinementRecord | None, says("Gain by turning; --refine.")
    ] = None
    preferred: Annotated[
        SampledPairRecord | None,
        says(
            "Layout taken, of that found and greedy choice's, and the other; null: not"
            " asked."
        ),
    ] = None
    sampled: Annotated[SampledRecord | None, says("Only with --samples.")] = None
    cheaper: Annotated[
        str, says("What cheaper sites would give, in words; empty: not known.")
    ] = ""


class EvaluationResult(
    Answer, frozen=True, kw_only=True, tag="place-rsus/evaluation/2"
):
    """One layout by the evaluator."""

    baselines: ClassVar[None] = None
    sampled: ClassVar[None] = None


class ComparisonResult(
    Answer, frozen=True, kw_only=True, tag="place-rsus/comparison/2"
):
    """A layout against others on the same runs."""

    compared: Annotated[tuple[Compared, ...], says("The other layouts.", min_length=1)]
    differences: Annotated[tuple[Difference, ...], says("For any two of the layouts.")]
    baselines: Annotated[
        Baselines | None, says("As the first layout; null: no room.")
    ] = None
    sampled: Annotated[SampledRecord | None, says("Only with --samples.")] = None


Result = PlacementResult | EvaluationResult | ComparisonResult
KINDS: Mapping[str, type[Result]] = {
    "place-rsus/placement/2": PlacementResult,
    "place-rsus/evaluation/2": EvaluationResult,
    "place-rsus/comparison/2": ComparisonResult,
}


def build_answer(
    setting: Setting, evaluation: Evaluation, others: Mapping[str, Evaluation]
) -> dict[str, Any]:
    """Fields of an :class:`Answer` that follow from layouts by the evaluator."""
    evaluated = build_evaluation_record(evaluation, setting.rule)
    return {
        "name": evaluation.layout.name,
        "layout": build_unit_records(evaluation.layout, setting.scene),
        "cost_eur": price_eur(evaluation),
        "fusion": "any",
        "runs": evaluation.axis.n_runs,
        "is_weighted": is_weighted(evaluation.axis),
        "apr": evaluated.judged.all,
        "assumptions": assumptions(setting.scene.notes),
        "evaluation": evaluated,
        "dangers": build_dangers(
            evaluation.headline.is_avoided,
            evaluation.axis,
            titles=case_titles(setting.runs),
        ),
        "added": build_added(setting, evaluation),
        "heavy_runs": find_heavy_runs(evaluation.axis),
        "road_users": build_road_users(
            setting, {evaluation.layout.name: evaluation} | {**others}
        ),
        "seconds": {},
        "versions": versions(),
        **asdict(build_drives_record(setting)),
    }


def build_placement_result(
    placement: Placement,
    setting: Setting,
    *,
    found: Evaluation,
    greedy: Evaluation,
    baseline: Evaluation | None,
    highest: Evaluation | None = None,
    compute: Compute = DEFAULT_COMPUTE,
    **parts: Any,
) -> PlacementResult:
    """A placement by the optimiser and by the evaluator.

    `parts` are further parts of it, by name.
    """
    certificate = placement.certificate
    problem = placement.problem
    limits = problem.limits
    rule = setting.rule
    value = placement_value(problem, placement.pose_index)
    failures = [
        replace(problem, limits=replace(limits, failing=what))
        for what in get_args(Failing)
    ]
    units_fail, sites_fail = (
        round(optimiser.apr_one_failed(asked, placement.pose_index), 12)
        for asked in failures
    )
    n_sites = len(np.unique(limits.site_index[list(placement.pose_index)]))
    apr_stage = next(
        (stage for stage in certificate.stages if stage.name == "apr"), None
    )
    others = {} if baseline is None else {baseline.layout.name: baseline}
    answer = build_answer(setting, found, others) | {
        "fusion": problem.fusion,
        # Without what summing up many weights leaves over.
        "apr": round(value.apr, 12),
        "dangers": build_dangers(
            avoided_runs(found, problem.fusion),
            found.axis,
            titles=case_titles(setting.runs),
        ),
        "added": build_added(setting, found, fusion=problem.fusion),
    }
    return PlacementResult(
        **answer,
        highest=(
            None
            if placement.highest is None
            else HighestRecord(
                given_up=placement.highest.given_up,
                stages=build_stage_records(placement.highest.certificate)[:2],
                compared=(
                    None if highest is None else build_compared(found, highest, rule)
                ),
            )
        ),
        goal=problem.goal,
        budget=limits.budget_units,
        candidates=problem.table.n_poses,
        presolve=str(placement.presolve),
        stages=build_stage_records(certificate),
        solver=certificate.solver,
        bound=None if apr_stage is None else round(apr_stage.bound, 12),
        gap=None if apr_stage is None else apr_stage.gap,
        spent_eur=value.cost_eur,
        apr_without_worst_unit=units_fail,
        apr_without_worst_site=(
            sites_fail if n_sites < len(placement.pose_index) else None
        ),
        failing=limits.failing,
        greedy=build_compared(found, greedy, rule),
        baseline=None if baseline is None else build_compared(found, baseline, rule),
        located=placement.located,
        preferred=placement.preferred and build_pair_record(*placement.preferred),
        surrogate_disagreement=float(np.mean(disagreeing_runs(placement, found))),
        disagreements=find_disagreements(
            setting,
            placement.nominal.table,
            found,
            placement.nominal_index,
            compute=compute,
        ),
        **parts,
    )


def disagreeing_runs(placement: Placement, evaluation: Evaluation) -> BoolArray:
    """Runs (n_runs,) on which table and evaluator disagree.

    Under the placement's fusion.
    """
    on_table = np.isfinite(run_margins_s(placement.nominal, placement.nominal_index))
    disagrees: BoolArray = on_table != avoided_runs(
        evaluation, placement.problem.fusion
    )
    return disagrees
