"""Why these poses, what they miss, what else would do: as one plain object."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from placement.candidates import CandidatePose
from placement.explain import (
    Contribution,
    Pool,
    Reason,
    Rescue,
    Unavoided,
    find_contributions,
    find_pool,
    find_unavoided,
)
from placement.explain.pool import sites_in_order
from placement.optimiser import PlacementProblem
from placement.pipeline import Placement
from placement.setting import Setting


def summarise_explanations(
    placement: Placement,
    setting: Setting,
    candidates: Sequence[CandidatePose],
    *,
    n_pool: int = 0,
    tolerance: float = 0.0,
    seed: int = 0,
) -> dict[str, Any]:
    """What a placement rests on.

    Parameters
    ----------
    placement : Placement
        What the optimiser found, refined or not.
    setting : Setting
        What it was found in.
    candidates : sequence of CandidatePose
        Rows of the placement's table: a refinement's own, if there was one.
    n_pool : int
        How many other layouts to list; 0: none are looked for.
    tolerance : float
        See :func:`placement.explain.find_pool`.
    seed : int
        Of the points on the VRUs: that of the table.

    Returns
    -------
    summary : dict
        Ready for JSON; "unit" is one of the layout's, in pool and "rescue" a candidate; ratios
        are 0 .. 1. ``{"contributions": [{"unit", "only_runs": [id],
        "marginal_apr", "first_share", "mean_delay_s", "max_delay_s", "without": {..}}],
        "not_avoided": [{"run", "outcome", "late_s", "frames_in_time", "frames_seen", "unit",
        "reasons": [{"cause", "thing", "frames"}], "rescue": {"unit", "site", "distance_m",
        "margin_s"} or None}], "runs_without_weight": n, "pool": {"stage", "tolerance",
        "is_complete", "within", "sets": [{"units": [id], "objective", "apr", ..}], "sites":
        [{"site", "share"}], "poses": [{"unit", "share"}]} or None}``. Runs that are not avoided are
        those of the world as planned; where worlds were sampled, nobody looks for what would save
        them. Runs of weight 0 are in no list, since no ratio knows them; "runs_without_weight" says
        how many they are. "late_s" is None where braking never sets in.
    """
    problem, chosen = placement.problem, placement.pose_index
    names = {
        problem.table.pose_ids[pose]: unit.id
        for pose, unit in zip(chosen, placement.layout.units, strict=True)
    }
    contributions = find_contributions(problem, chosen)
    if placement.nominal is problem:
        missed = find_unavoided(setting, problem, candidates, chosen, seed=seed)
    else:
        missed = find_unavoided(
            setting,
            placement.nominal,
            [candidates[pose] for pose in chosen],
            placement.nominal_index,
            seed=seed,
        )
    pool = None
    if n_pool:
        pool = find_pool(problem, chosen, n_sets=n_pool, tolerance=tolerance)
    return {
        "contributions": [_contribution_record(problem, part, names) for part in contributions],
        "not_avoided": [_missed_record(entry, names) for entry in missed],
        "runs_without_weight": int((placement.nominal.table.axis.weight == 0.0).sum()),
        "pool": None if pool is None else _pool_record(problem, candidates, pool),
    }


def _contribution_record(
    problem: PlacementProblem, part: Contribution, names: Mapping[str, str]
) -> dict[str, Any]:
    table = problem.table
    return {
        "unit": names[table.pose_ids[part.pose_index]],
        "only_runs": [table.axis.run_ids[run] for run in part.only_runs.tolist()],
        "marginal_apr": part.marginal_apr,
        "first_share": part.first_share,
        "mean_delay_s": part.mean_delay_s,
        "max_delay_s": part.max_delay_s,
        "without": part.without._asdict(),
    }


def _missed_record(entry: Unavoided, names: Mapping[str, str]) -> dict[str, Any]:
    return {
        "run": entry.run_id,
        "outcome": entry.outcome,
        "late_s": entry.late_s if math.isfinite(entry.late_s) else None,
        "frames_in_time": entry.n_frames,
        "frames_seen": entry.n_seen,
        "unit": names.get(entry.unit_id, entry.unit_id),
        "reasons": [_reason_record(reason) for reason in entry.reasons],
        "rescue": None if entry.rescue is None else _rescue_record(entry.rescue),
    }


def _reason_record(reason: Reason) -> dict[str, Any]:
    return {"cause": reason.cause, "thing": reason.thing, "frames": reason.n_frames}


def _rescue_record(rescue: Rescue) -> dict[str, Any]:
    return {
        "unit": rescue.pose_id,
        "site": rescue.site_id,
        "distance_m": rescue.distance_m,
        "margin_s": rescue.margin_s,
    }


def _pool_record(
    problem: PlacementProblem, candidates: Sequence[CandidatePose], pool: Pool
) -> dict[str, Any]:
    ids = problem.table.pose_ids
    sites = problem.limits.site_index
    names = {
        int(site): candidate.site_id or candidate.id
        for site, candidate in zip(sites, candidates, strict=True)
    }
    frequent = np.argsort(-pool.pose_share, kind="stable")
    return {
        "stage": pool.stage,
        "tolerance": pool.tolerance,
        "is_complete": pool.scope == "all",
        "within": pool.n_within,
        "sets": [
            {
                "units": [ids[pose] for pose in entry.pose_index],
                "objective": entry.objective,
                **entry.value._asdict(),
            }
            for entry in pool.sets
        ],
        "sites": [
            {"site": names[site], "share": float(pool.site_share[site])}
            for site in sites_in_order(pool).tolist()
        ],
        "poses": [
            {"unit": ids[pose], "share": float(pool.pose_share[pose])}
            for pose in frequent.tolist()
            if pool.pose_share[pose] > 0.0
        ],
    }
