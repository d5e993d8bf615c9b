"""Layouts to compare with that need no optimiser.

Random ones, and an expert's rule of thumb.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from placement import evaluation
from placement.baselines import JudgedBaselines, RandomLayouts, judge_proposals, propose
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.layout import Layout
from placement.optimiser import PlacementProblem
from placement.optimiser import apr as table_apr
from placement.pipeline import Assembly, Placement, pick_layout
from placement.sampling.out_of_sample import estimate_mean
from placement.setting import Setting
from placement.wishes import Wishes
from scenarios.runs import FrameAxis

from ..language import mark, tr
from ..results.cached import cached_part
from ..results.numbers import percent
from ..results.record import Record, UnitRecord, build_unit_records, mixed, says

STAGE = mark("baselines")
_OverWorlds = Annotated[
    float, says("Mean APR over these worlds, and ends of its 95 % interval.")
]
_OverLayouts = Annotated[
    float,
    says(
        "Mean APR; 5 % of them have no higher one than `low`, 5 % no lower than `high`."
    ),
]


class Score(Record, frozen=True, kw_only=True):
    """APR and avoided runs of a sensing party, by the evaluator."""

    name: Annotated[str, says("Of the layout; or who else senses.")]
    units: Annotated[int, says("How many units it has; 0: the vehicle by itself.")]
    runs_avoided: Annotated[int, says("How many.")]
    all: Annotated[float | None, says("APR over all runs, by weight.")]
    by_case: Annotated[
        dict[str, float | None], says("APR of each case; null: no run has weight.")
    ]
    by_position: Annotated[
        dict[str, float | None], says("The same by position along the arms.")
    ]


def build_score(
    name: str, verdict: evaluation.Verdict, axis: FrameAxis, *, n_units: int
) -> Score:
    """APR and avoided runs of a sensing party."""
    return Score(
        name=name,
        units=n_units,
        runs_avoided=int(verdict.is_avoided.sum()),
        all=evaluation.apr(verdict, axis),
        by_case={**evaluation.apr_by_case(verdict, axis)},
        by_position={**evaluation.apr_by_position(verdict, axis)},
    )


class RandomInWorlds(Record, frozen=True, kw_only=True):
    """Mean of random layouts in the worlds that the layout was chosen in."""

    worlds: Annotated[int, says("How many.")]
    mean: _OverWorlds
    low: _OverWorlds
    high: _OverWorlds


class RandomBaseline(Record, frozen=True, kw_only=True):
    """Layouts of candidate poses drawn at random within the limits.

    By the detection table.
    """

    layouts: Annotated[int, says("How many were drawn.")]
    units: Annotated[int, says("Of each.")]
    mean: _OverLayouts
    low: _OverLayouts
    high: _OverLayouts
    in_worlds: Annotated[
        RandomInWorlds | None, says("Over worlds; only with --samples.")
    ] = None


class ExpertBaseline(Record, frozen=True, kw_only=True):
    """A camera per corner of the junction that looks at its middle."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("The units.")]
    corners: Annotated[
        tuple[str, ...], says("Those with a camera, by arms, in order of choice.")
    ]
    cost_eur: Annotated[
        float, says("The units by the catalogue, without poles, in EUR.")
    ]
    on_table: Annotated[float, says("APR on the detection table.")]
    score: Annotated[Score, says("By the evaluator.")]
    apr_without_worst_unit: Annotated[
        float | None, says("APR without the most needed unit.")
    ]


class Baselines(Record, frozen=True, kw_only=True):
    """Layouts that need no optimiser, within the same limits."""

    random: Annotated[
        RandomBaseline | None, says("Drawn; null: none is within the limits.")
    ]
    expert: Annotated[
        ExpertBaseline | None, says("By rule of thumb; null: it is not possible.")
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposed:
    """Random layouts and an expert's on the detection table."""

    # None: no random layout is within the limits.
    random: RandomLayouts | None
    # None: the rule of thumb is not.
    expert: Layout | None
    # At which it has a camera, in the order of choice.
    corners: tuple[str, ...]
    # Its APR.
    expert_on_table: float


def compare_placement(
    placement: Placement,
    candidates: Sequence[CandidatePose],
    setting: Setting,
    *,
    compute: Compute,
) -> Proposed:
    """Baselines of as many units as a layout found.

    Within its limits, on its detection table.
    """
    problem = placement.problem
    n_units = len(placement.pose_index)
    scene = setting.scene
    seed = compute.seed
    poses = [unit.pose for unit in candidates]

    def find() -> JudgedBaselines:
        rng = np.random.default_rng(seed)
        proposals = propose(problem.limits, candidates, scene, n_units=n_units, rng=rng)
        return judge_proposals(problem, proposals)

    found = cached_part(
        compute.cache_folder,
        "proposed",
        find,
        kind=JudgedBaselines,
        made_from=(
            *(problem, scene, n_units, seed),
            # The problem has the poses' ids, but not where they look.
            np.array([pose.position_m for pose in poses]),
            np.array([(pose.yaw_deg, pose.pitch_deg) for pose in poses]),
        ),
    )
    return _with_layout(problem, found, candidates)


def compare_layout(
    layout: Layout, setting: Setting, *, compute: Compute
) -> Proposed | None:
    """Baselines of as many units as a given layout has, of its sensors.

    Within what the sites carry.

    None where they cannot carry as many. The detection table has the poses drawn alone.
    """
    scene = setting.scene
    n_units = len(layout.units)
    if (
        sum(site.capacity_units for site in scene.sites if site.use != "forbidden")
        < n_units
    ):
        return None
    sensors = {unit.sensor: None for unit in layout.units}
    candidates = build_candidates(
        scene, replace(load_candidate_grid(), sensors=tuple(sensors))
    )
    plan = Assembly(
        setting=setting, candidates=candidates, wishes=Wishes(budget_units=n_units)
    )
    rng = np.random.default_rng(compute.seed)
    proposals = propose(plan.limits, candidates, scene, n_units=n_units, rng=rng)
    rows = proposals.rows
    if not rows:
        return None
    compute.progress(STAGE, 0, 0)
    drawn = [candidates[row] for row in rows]
    problem = replace(plan, candidates=drawn, compute=compute.within(STAGE)).problem
    found = judge_proposals(problem, proposals.among(rows))
    return _with_layout(problem, found, drawn)


def _with_layout(
    problem: PlacementProblem,
    found: JudgedBaselines,
    candidates: Sequence[CandidatePose],
) -> Proposed:
    """Judged proposals, with the expert's layout; candidates are the table's rows."""
    rows = found.expert
    return Proposed(
        random=found.random,
        expert=pick_layout(candidates, rows, f"expert-{len(rows)}") if rows else None,
        corners=found.corners,
        expert_on_table=table_apr(problem, rows) if rows else 0.0,
    )


def build_baselines(
    proposed: Proposed, expert: evaluation.Evaluation | None, setting: Setting
) -> Baselines:
    """Their APR; `expert` is that layout by the evaluator."""
    random = proposed.random
    of_expert = None
    if expert is not None:
        name = expert.layout.name
        units = expert.layout.units
        blind, seeing = (
            build_score(name, verdict, expert.axis, n_units=len(units))
            for verdict in (expert.rsu_all, expert.vut_and_rsus)
        )
        of_expert = ExpertBaseline(
            name=name,
            layout=build_unit_records(expert.layout),
            corners=proposed.corners,
            cost_eur=sum(unit.sensor.price_eur for unit in units),
            on_table=round(proposed.expert_on_table, 12),
            score=mixed(blind, seeing, expert.cars),
            apr_without_worst_unit=evaluation.apr_one_failed(expert, setting.rule),
        )
    return Baselines(
        random=None if random is None else _random(random), expert=of_expert
    )


def _random(layouts: RandomLayouts) -> RandomBaseline:
    """Mean and ends of their APR, without what summing up weights leaves over."""
    by_world = layouts.mean_by_world
    in_worlds = None
    if len(by_world) > 1:
        found = estimate_mean(np.clip(by_world, 0.0, 1.0))
        ends = {"low": found.low, "high": found.high}
        in_worlds = RandomInWorlds(worlds=len(by_world), mean=found.mean, **ends)
    return RandomBaseline(
        layouts=len(layouts.apr),
        units=layouts.n_units,
        mean=round(layouts.mean, 12),
        low=round(layouts.low, 12),
        high=round(layouts.high, 12),
        in_worlds=in_worlds,
    )


def words(found: Baselines | None, *, n_units: int) -> list[str]:
    """How random layouts and the expert's are made, for a report."""
    if found is None:
        return []
    sentences = []
    random = found.random
    expert = found.expert
    if random is not None:
        text = tr(
            "Random: {n} layouts drawn within the same limits and scored on the"
            " detection table; 5 % of them have an APR of at most {low}, 5 % have at"
            " least {high}.",
            n=random.layouts,
            low=percent(random.low),
            high=percent(random.high),
        )
        if random.in_worlds is not None:
            text += " " + tr(
                "In the sampled worlds: {share}.", share=percent(random.in_worlds.mean)
            )
        sentences.append(text)
    if expert is not None:
        corners = ", ".join("/".join(map(tr, one.split("/"))) for one in expert.corners)
        corners = corners or tr("no corner fits")
        if len(expert.layout) != n_units:
            corners = tr("{corners}; not a unit for every corner", corners=corners)
        sentences.append(
            tr(
                "Expert rule: use the site nearest to each corner of the junction"
                " and, there, the pose that looks most directly at the centre. The"
                " corner whose camera prevents the most comes first ({corners}). APR"
                " {share} on the detection table.",
                corners=corners,
                share=percent(expert.on_table),
            )
        )
    return sentences
