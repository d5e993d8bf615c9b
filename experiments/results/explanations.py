"""Explanations as results have them: contributions, missed runs, the pool; private ground."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, cast

import numpy as np

from geometry.arrays import FloatArray
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.explain import (
    Contribution,
    Pool,
    Unavoided,
    find_contributions,
    find_unavoided,
)
from placement.ground import PrivateGround, private_shares
from placement.optimiser import PlacementProblem
from placement.pipeline import Placement
from placement.setting import Setting

from .record import LayoutValueRecord, Record, RunId, Share, StageName, says


class ContributionRecord(Record, frozen=True, kw_only=True):
    """Contribution of a unit to the others, on the detection table."""

    unit: Annotated[str, says("Id in the layout.")]
    only_runs: Annotated[
        tuple[RunId, ...],
        says(
            "Runs with weight that are avoided with it and not without it; where worlds are "
            "sampled with # and the number of the world behind the name."
        ),
    ]
    marginal_apr: Annotated[Share, says("APR of all less that of the others.")]
    first_share: Annotated[Share, says("Its part in the first confirmations, by weight.")]
    mean_delay_s: Annotated[
        float,
        says(
            "By how much later what the others avoid, too, is confirmed without it: mean by "
            "weight, in seconds."
        ),
    ]
    max_delay_s: Annotated[float, says("The most of it in any run, in seconds.")]
    without: Annotated[LayoutValueRecord, says("What the others are worth.")]


class PooledLayoutRecord(LayoutValueRecord, frozen=True, kw_only=True):
    """A layout of candidates."""

    units: Annotated[tuple[str, ...], says("Names of the candidate poses.")]
    objective: Annotated[
        float, says("Value in the first stage, in the unit that its name ends in.")
    ]


class PoolRecord(Record, frozen=True, kw_only=True):
    """Layouts that are as good in the first stage."""

    stage: Annotated[StageName, says("The first stage.")]
    is_complete: Annotated[
        bool,
        says("Whether all choices were gone through; else one unit was exchanged for another."),
    ]
    within: Annotated[int, says("How many were found.", ge=1)]
    sets: Annotated[tuple[PooledLayoutRecord, ...], says("The best ones, the best first.")]
    sites: Annotated[
        dict[str, Share], says("Share of the layouts with a unit at a site, the largest first.")
    ]
    poses: Annotated[
        dict[str, Share], says("Share of the layouts with a candidate pose, the largest first.")
    ]


class ExplainedRecord(Record, frozen=True, kw_only=True):
    """Reasons for these units, runs that they miss, layouts as good; on the detection table.

    Runs of weight 0 are in no list.
    """

    contributions: Annotated[tuple[ContributionRecord, ...], says("One for each unit.")]
    not_avoided: Annotated[
        tuple[Unavoided, ...], says("Runs that are not avoided, in the order of the runs.")
    ]
    runs_without_weight: Annotated[
        int, says("How many runs have weight 0, and are left out.", ge=0)
    ]
    pool: Annotated[PoolRecord | None, says("Layouts as good; null unless asked for with --pool.")]


class PrivateAreaRecord(Record, frozen=True, kw_only=True):
    """An area."""

    name: Annotated[str, says("Name in the file.")]
    area_m2: Annotated[float, says("Size, in square metres.", ge=0)]


class PrivateGroundRecord(Record, frozen=True, kw_only=True):
    """Views of cameras into areas that they must not look into."""

    areas: Annotated[tuple[PrivateAreaRecord, ...], says("The areas.")]
    units: Annotated[dict[str, dict[str, Share]], says("Of each unit, by its id.")]


# ---------- explanations


def build_explained_record(
    placement: Placement,
    setting: Setting,
    candidates: Sequence[CandidatePose],
    *,
    pool: Pool | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> ExplainedRecord:
    """Explanation of a placement.

    Runs that are not avoided are those of the world as planned; where worlds were sampled, nobody
    looks for what would save them.

    Parameters
    ----------
    candidates : sequence of CandidatePose
        Rows of the placement's table: a refinement's own, if there was one.
    pool : Pool, optional
        Other layouts that are as good, where they were asked for.
    compute : Compute
        With the seed of the table.
    """
    problem, chosen = placement.problem, placement.pose_index
    names = {
        problem.table.pose_ids[pose]: unit.id
        for pose, unit in zip(chosen, placement.layout.units, strict=True)
    }
    if placement.nominal is problem:
        missed = find_unavoided(setting, problem, candidates, chosen, compute=compute)
    else:
        missed = find_unavoided(
            setting,
            placement.nominal,
            [candidates[pose] for pose in chosen],
            placement.nominal_index,
            compute=compute,
        )
    return ExplainedRecord(
        contributions=tuple(
            _contribution(problem, part, names) for part in find_contributions(problem, chosen)
        ),
        not_avoided=tuple(
            replace(entry, unit=names.get(entry.unit, entry.unit)) for entry in missed
        ),
        runs_without_weight=int((placement.nominal.table.axis.weight == 0.0).sum()),
        pool=None if pool is None else _pool(problem, candidates, pool),
    )


def _contribution(
    problem: PlacementProblem, part: Contribution, names: Mapping[str, str]
) -> ContributionRecord:
    table = problem.table
    return ContributionRecord(
        unit=names[table.pose_ids[part.pose_index]],
        only_runs=tuple(table.axis.run_ids[run] for run in part.only_runs.tolist()),
        marginal_apr=part.marginal_apr,
        first_share=part.first_share,
        mean_delay_s=part.mean_delay_s,
        max_delay_s=part.max_delay_s,
        without=LayoutValueRecord(**part.without._asdict()),
    )


def _pool(problem: PlacementProblem, candidates: Sequence[CandidatePose], pool: Pool) -> PoolRecord:
    ids = problem.table.pose_ids
    names = {
        int(site): candidate.site_id or candidate.id
        for site, candidate in zip(problem.limits.site_index, candidates, strict=True)
    }
    return PoolRecord(
        stage=cast(StageName, pool.stage),
        is_complete=pool.scope == "all",
        within=pool.n_within,
        sets=tuple(
            PooledLayoutRecord(
                units=tuple(ids[pose] for pose in entry.pose_index),
                objective=entry.objective,
                **entry.value._asdict(),
            )
            for entry in pool.sets
        ),
        sites={names[site]: float(pool.site_share[site]) for site in _frequent(pool.site_share)},
        poses={ids[pose]: float(pool.pose_share[pose]) for pose in _frequent(pool.pose_share)},
    )


def _frequent(share: FloatArray) -> list[int]:
    """Indices of positive shares, the largest first."""
    order = np.argsort(-share, kind="stable")
    indices: list[int] = order[share[order] > 0.0].tolist()
    return indices


# ---------- private ground


def build_private_ground_record(
    units: Sequence[CandidatePose], scene: Scene, ground: PrivateGround
) -> PrivateGroundRecord:
    """Shares of private ground that units see."""
    shares = private_shares(scene, units, ground)
    return PrivateGroundRecord(
        areas=tuple(
            PrivateAreaRecord(name=name, area_m2=float(area))
            for name, area in zip(ground.names, ground.area_m2, strict=True)
        ),
        units={
            unit.id: dict(zip(ground.names, row.tolist(), strict=True))
            for unit, row in zip(units, shares, strict=True)
        },
    )
