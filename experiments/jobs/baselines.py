"""Baselines that layouts are compared with: random ones, and an expert's rule of thumb."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from placement.baselines import Baselines, RandomLayouts, judge_proposals, propose
from placement.candidates import CandidatePose, build_candidates, load_candidate_grid
from placement.compute import Compute
from placement.evaluation import Evaluation, apr_one_failed
from placement.layout import Layout
from placement.optimiser import apr
from placement.pipeline import Assembly, Placement, pick_layout
from placement.setting import Setting
from placement.wishes import Wishes

from ..results.baselines import BaselinesRecord, build_expert_record, build_random_record

STAGE = "baselines"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Random layouts and an expert's on the detection table.

    Attributes
    ----------
    random : RandomLayouts, optional
        None where no random layout is within the limits.
    expert : Layout, optional
        None where the rule of thumb is not within the limits.
    corners : tuple of str
        Corners at which it has a camera, in the order of choice.
    expert_on_table : float
        Its APR, 0..1.
    """

    random: RandomLayouts | None
    expert: Layout | None
    corners: tuple[str, ...]
    expert_on_table: float


def compare_placement(
    placement: Placement, candidates: Sequence[CandidatePose], setting: Setting, *, seed: int
) -> Comparison:
    """Baselines of as many units as a layout found, within its limits, on its detection table."""
    problem = placement.problem
    proposals = propose(
        problem.limits,
        candidates,
        setting.scene,
        n_units=len(placement.pose_index),
        rng=np.random.default_rng(seed),
    )
    found = judge_proposals(problem, proposals)
    on_table = apr(problem, found.expert) if found.expert else 0.0
    return _comparison(found, candidates, on_table)


def compare_layout(layout: Layout, setting: Setting, *, compute: Compute) -> Comparison | None:
    """Baselines of as many units as a given layout, of its sensors, within what the sites carry.

    None where the scene's sites cannot carry as many. A detection table is built of the poses drawn
    alone.
    """
    scene, n_units = setting.scene, len(layout.units)
    if sum(site.capacity_units for site in scene.sites if site.use != "forbidden") < n_units:
        return None
    sensors = {unit.sensor: None for unit in layout.units}
    grid = replace(load_candidate_grid(), sensors=tuple(sensors))
    candidates = build_candidates(scene, grid)
    wishes = Wishes(budget_units=n_units)
    proposals = propose(
        Assembly(setting=setting, candidates=candidates, wishes=wishes).limits,
        candidates,
        scene,
        n_units=n_units,
        rng=np.random.default_rng(compute.seed),
    )
    rows = proposals.rows
    if not rows:
        return None
    compute.progress(STAGE, 0, 0)
    drawn = [candidates[row] for row in rows]
    problem = Assembly(
        setting=setting, candidates=drawn, wishes=wishes, compute=compute.within(STAGE)
    ).problem
    found = judge_proposals(problem, proposals.among(rows))
    on_table = apr(problem, found.expert) if found.expert else 0.0
    return _comparison(found, drawn, on_table)


def build_baselines_record(
    comparison: Comparison, expert: Evaluation | None, setting: Setting
) -> BaselinesRecord:
    """What baselines prevent: the expert's layout by the evaluator, too."""
    return BaselinesRecord(
        random=None if comparison.random is None else build_random_record(comparison.random),
        expert=None
        if expert is None
        else build_expert_record(
            expert,
            corners=comparison.corners,
            on_table=comparison.expert_on_table,
            apr_without_worst_unit=apr_one_failed(expert, setting.rule),
        ),
    )


def _comparison(
    found: Baselines, candidates: Sequence[CandidatePose], on_table: float
) -> Comparison:
    rows = found.expert
    return Comparison(
        random=found.random,
        expert=pick_layout(candidates, rows, f"expert-{len(rows)}") if rows else None,
        corners=found.corners,
        expert_on_table=on_table,
    )
