"""Parts of a result that explain it: contributions, missed runs, sensitivity, private areas."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, cast

import numpy as np

from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.explain import (
    Contribution,
    Pool,
    Rescue,
    Unavoided,
    find_contributions,
    find_unavoided,
)
from placement.explain.pool import sites_in_order
from placement.optimiser import PlacementProblem
from placement.pipeline import Placement
from placement.private_ground import PrivateGround, private_shares
from placement.setting import Setting

from .record import LayoutValueRecord, Record, RunId, Share, StageName, says


class RescueRecord(Record, frozen=True, kw_only=True):
    """A candidate that would save a run as a further unit."""

    unit: Annotated[str, says("Name of the candidate pose.")]
    site: Annotated[str, says("Its site.")]
    distance_m: Annotated[
        float, says("From the nearest unit, in metres; 0: at the same mount.", ge=0)
    ]
    margin_s: Annotated[float, says("Time to spare that it leaves, in seconds.")]


class MissedReasonRecord(Record, frozen=True, kw_only=True):
    """Why that unit does not detect the road user."""

    cause: Annotated[
        Literal["hidden", "out of view", "cut off", "too dark", "too far", "otherwise"],
        says("What is in the way, or missing."),
    ]
    thing: Annotated[str, says("What hides the road user; empty for other causes.")]
    frames: Annotated[int, says("In how many frames.", ge=1)]


class MissedRunRecord(Record, frozen=True, kw_only=True):
    """A run with weight that is not avoided in the world as planned, on the detection table."""

    run: Annotated[RunId, says("Which run.")]
    outcome: Annotated[
        Literal["hopeless", "never seen", "never confirmed", "lost again", "too late"],
        says(
            "hopeless: no frame comes early enough, whoever looks; else what the units achieve. "
            "lost again: confirmed, but the track was not alive at the last moment."
        ),
    ]
    late_s: Annotated[
        float | None, says("By how much braking sets in too late, in seconds; null: never.")
    ]
    frames_in_time: Annotated[int, says("Frames from which braking in time could follow.", ge=0)]
    frames_seen: Annotated[
        int, says("Of these, those in which a unit detects the road user.", ge=0)
    ]
    unit: Annotated[
        str,
        says("Id of the unit that is told of: the nearest that looks there; empty if hopeless."),
    ]
    reasons: Annotated[tuple[MissedReasonRecord, ...], says("The most frequent one first.")]
    rescue: Annotated[
        RescueRecord | None,
        says(
            "Nearest candidate that would save the run as a further unit; null: none, or nobody "
            "looked, as where worlds are sampled."
        ),
    ]


class ContributionRecord(Record, frozen=True, kw_only=True):
    """What a unit adds to the others, on the detection table."""

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


class PooledLayoutRecord(Record, frozen=True, kw_only=True):
    """A layout of candidates."""

    units: Annotated[tuple[str, ...], says("Names of the candidate poses.")]
    objective: Annotated[
        float, says("Value in the first stage, in the unit that its name ends in.")
    ]
    apr: Annotated[Share, says("APR on the detection table.")]
    apr_one_failed: Annotated[Share, says("APR if the unit that is needed most fails.")]
    smallest_margin_s: Annotated[
        float,
        says("Smallest time to spare of the avoided runs, in seconds; 0 where there is none."),
    ]
    mean_margin_s: Annotated[
        float,
        says(
            "Mean time to spare of the avoided runs by weight, in seconds; 0 where there is none."
        ),
    ]
    cost_eur: Annotated[float, says("Units, and sites once, in EUR.")]


class SiteShareRecord(Record, frozen=True, kw_only=True):
    """How often a site carries a unit."""

    site: Annotated[str, says("Name of the site.")]
    share: Annotated[Share, says("Of the layouts found.")]


class PoseShareRecord(Record, frozen=True, kw_only=True):
    """How often a pose is chosen."""

    unit: Annotated[str, says("Name of the candidate pose.")]
    share: Annotated[Share, says("Of the layouts found.")]


class PoolRecord(Record, frozen=True, kw_only=True):
    """Layouts that are as good in the first stage."""

    stage: Annotated[StageName, says("The first stage.")]
    is_complete: Annotated[
        bool,
        says("Whether all choices were gone through; else one unit was exchanged for another."),
    ]
    within: Annotated[int, says("How many were found.", ge=1)]
    sets: Annotated[tuple[PooledLayoutRecord, ...], says("The best ones, the best first.")]
    sites: Annotated[tuple[SiteShareRecord, ...], says("Sites, the most frequent first.")]
    poses: Annotated[tuple[PoseShareRecord, ...], says("Candidate poses, the most frequent first.")]


class ExplainedRecord(Record, frozen=True, kw_only=True):
    """Why these units, what they miss, what else would do; on the detection table.

    Runs of weight 0 are in no list.
    """

    contributions: Annotated[tuple[ContributionRecord, ...], says("One for each unit.")]
    not_avoided: Annotated[
        tuple[MissedRunRecord, ...], says("Runs that are not avoided, in the order of the runs.")
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
    """What cameras see of areas that they must not look into."""

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
    """What a placement rests on.

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
        not_avoided=tuple(_missed_run(entry, names) for entry in missed),
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


def _missed_run(entry: Unavoided, names: Mapping[str, str]) -> MissedRunRecord:
    return MissedRunRecord(
        run=entry.run_id,
        outcome=entry.outcome,
        late_s=entry.late_s if math.isfinite(entry.late_s) else None,
        frames_in_time=entry.n_frames,
        frames_seen=entry.n_seen,
        unit=names.get(entry.unit_id, entry.unit_id),
        reasons=tuple(
            MissedReasonRecord(cause=reason.cause, thing=reason.thing, frames=reason.n_frames)
            for reason in entry.reasons
        ),
        rescue=None if entry.rescue is None else _rescue(entry.rescue),
    )


def _rescue(rescue: Rescue) -> RescueRecord:
    return RescueRecord(
        unit=rescue.pose_id,
        site=rescue.site_id,
        distance_m=rescue.distance_m,
        margin_s=rescue.margin_s,
    )


def _pool(problem: PlacementProblem, candidates: Sequence[CandidatePose], pool: Pool) -> PoolRecord:
    ids = problem.table.pose_ids
    names = {
        int(site): candidate.site_id or candidate.id
        for site, candidate in zip(problem.limits.site_index, candidates, strict=True)
    }
    frequent = np.argsort(-pool.pose_share, kind="stable")
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
        sites=tuple(
            SiteShareRecord(site=names[site], share=float(pool.site_share[site]))
            for site in sites_in_order(pool).tolist()
        ),
        poses=tuple(
            PoseShareRecord(unit=ids[pose], share=float(pool.pose_share[pose]))
            for pose in frequent.tolist()
            if pool.pose_share[pose] > 0.0
        ),
    )


# ---------- private ground


def build_private_ground_record(
    units: Sequence[CandidatePose], scene: Scene, ground: PrivateGround
) -> PrivateGroundRecord:
    """What units see of private ground."""
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
