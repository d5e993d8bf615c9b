"""The numbers of a result as one plain object: what ``--json`` prints and the report shows."""

import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

from geometry.raycast import caster_name
from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_by_case,
    apr_one_failed,
)
from placement.explain.agreement import find_disagreements
from placement.layout import RESULT_SCHEMA, layout_records
from placement.optimiser import placement_value, run_margins_s
from placement.pipeline import Placement
from placement.setting import Setting
from scenarios.aeb import AebRule

_PACKAGES = ("cvxpy", "highspy", "numpy", "scipy", "trimesh")
_RAY_PACKAGES = {"open3d": ("open3d-cpu", "open3d"), "embreex": ("embreex",)}


def summarise_evaluation(evaluation: Evaluation, rule: AebRule) -> dict[str, Any]:
    """APR of every sensing party, over all runs and by case.

    Parameters
    ----------
    evaluation : Evaluation
        Verdicts.
    rule : AebRule
        Confirmation and latency.

    Returns
    -------
    summary : dict
        ``{"vut": {"all": p, "by_case": {case: p}}, "rsu_all", "vut_and_rsus", "units": {id: ..},
        "apr_without_worst_unit": p}``, and "vam" and "all_sources" where road users announce
        themselves.
    """

    def ratios(verdict: Verdict) -> dict[str, Any]:
        axis = evaluation.axis
        return {"all": apr(verdict, axis), "by_case": apr_by_case(verdict, axis)}

    return {
        "vut": ratios(evaluation.vut),
        "rsu_all": ratios(evaluation.rsu_all),
        "vut_and_rsus": ratios(evaluation.vut_and_rsus),
        "units": {name: ratios(verdict) for name, verdict in evaluation.units.items()},
        **{name: ratios(verdict) for name, verdict in evaluation.others.items()},
        "apr_without_worst_unit": apr_one_failed(evaluation, rule),
    }


def summarise_placement(
    placement: Placement,
    setting: Setting,
    *,
    found: Evaluation,
    greedy: Evaluation,
    baseline: Evaluation | None,
) -> dict[str, Any]:
    """The main job's result.

    Parameters
    ----------
    placement : Placement
        What the optimiser found.
    setting : Setting
        What it was found in.
    found, greedy : Evaluation
        Of the layout found and the greedy one.
    baseline : Evaluation or None
        Of the study's, where it is at its junction.

    Returns
    -------
    summary : dict
        Ready for JSON; ratios are 0 .. 1.
    """
    certificate, problem = placement.certificate, placement.problem
    rule = problem.rule
    value = placement_value(problem, placement.pose_index)
    by_name = {stage.name: stage for stage in certificate.stages}
    apr_stage = by_name.get("apr")  # none where a weighted sum was asked for
    return {
        **summarise_layout(found, rule),
        "budget": problem.limits.budget_units,
        "fusion": problem.fusion,
        "goal": problem.goal,
        "candidates": problem.table.n_poses,
        "presolve": str(placement.presolve),
        "apr": _settled(value.apr),
        "bound": None if apr_stage is None else _settled(apr_stage.bound),
        "gap": None if apr_stage is None else apr_stage.gap,
        "apr_without_worst_unit": _settled(value.apr_one_failed),
        "spent_eur": value.cost_eur,
        "stages": [
            {
                "name": stage.name,
                "objective": stage.objective,
                "bound": stage.bound,
                "gap": stage.gap,
                "seconds": stage.seconds,
            }
            for stage in certificate.stages
        ],
        "solver": certificate.solver,
        "baseline_name": None if baseline is None else baseline.layout.name,
        "baseline": None if baseline is None else summarise_evaluation(baseline, rule),
        "greedy": {
            "layout": layout_records(greedy.layout),
            **summarise_evaluation(greedy, rule),
        },
        "surrogate_disagreement": float(np.mean(disagreeing_runs(placement, found))),
        "disagreements": [
            asdict(disagreement)
            for disagreement in find_disagreements(
                setting, placement.nominal.table, found, placement.nominal_index
            )
        ],
    }


def _settled(value: float) -> float:
    """Without what summing up many weights leaves over: all of them are 1."""
    return round(value, 12)


def summarise_layout(evaluation: Evaluation, rule: AebRule) -> dict[str, Any]:
    """One layout's result: the keys that every command prints.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout.
    rule : AebRule
        Confirmation and latency.

    Returns
    -------
    summary : dict
        What only an optimisation or a comparison tells is None; "seconds" is filled in at the end.
        "apr" and "apr_without_worst_unit" are the evaluator's here, and the detection table's
        where one was optimised on.
    """
    evaluated = summarise_evaluation(evaluation, rule)
    return {
        "schema": RESULT_SCHEMA,
        "name": evaluation.layout.name,
        "layout": layout_records(evaluation.layout),
        "cost_eur": sum(unit.sensor.price_eur for unit in evaluation.layout.units),
        "budget": None,
        "fusion": "any",
        "runs": evaluation.axis.n_runs,
        "apr": apr(evaluation.rsu_all, evaluation.axis),
        "bound": None,
        "gap": None,
        "apr_without_worst_unit": evaluated["apr_without_worst_unit"],
        "evaluation": evaluated,
        "baseline": None,
        "surrogate_disagreement": None,
        "seconds": {},
        "versions": versions(),
    }


def summarise_comparison(
    subject: Evaluation, others: Sequence[Evaluation], rule: AebRule
) -> dict[str, Any]:
    """Layouts on the same runs: the first against each of the others.

    Parameters
    ----------
    subject : Evaluation
        The first one.
    others : sequence of Evaluation
        On the same runs, at least one; the first of them is the baseline.
    rule : AebRule
        Confirmation and latency.

    Returns
    -------
    summary : dict
        The keys of :func:`summarise_layout`; "compared" has for each other one its name, layout,
        evaluation, and the runs that the subject gains and loses against it, those of the baseline
        once more under "baseline_name", "baseline_layout", "baseline", "runs_gained", "runs_lost".
    """
    runs, ours = np.array(subject.axis.run_ids), subject.rsu_all.is_avoided
    compared = [
        {
            "name": other.layout.name,
            "layout": layout_records(other.layout),
            "cost_eur": sum(unit.sensor.price_eur for unit in other.layout.units),
            "evaluation": summarise_evaluation(other, rule),
            "runs_gained": runs[ours & ~other.rsu_all.is_avoided].tolist(),
            "runs_lost": runs[other.rsu_all.is_avoided & ~ours].tolist(),
        }
        for other in others
    ]
    first = compared[0]
    return {
        **summarise_layout(subject, rule),
        "compared": compared,
        "baseline_name": first["name"],
        "baseline_layout": first["layout"],
        "baseline": first["evaluation"],
        "runs_gained": first["runs_gained"],
        "runs_lost": first["runs_lost"],
    }


def summarise_drives(setting: Setting) -> dict[str, Any]:
    """What a result was found on: cases, weathers, perception, and what could not be driven.

    Parameters
    ----------
    setting : Setting
        Runs and refusals.

    Returns
    -------
    summary : dict
        ``{"cases": [..], "weathers": [..], "detector", "vut_sensors": [..], "packet_loss",
        "vam_rate", "not_driven": [{"case", "approach", "speeds_kmh",
        "reason"}]}``
    """
    return {
        "cases": list(dict.fromkeys(setting.axis.cases)),
        "weathers": list(dict.fromkeys(setting.axis.weathers)),
        "detector": setting.detector.name,
        "vut_sensors": list(setting.vut_sensors),
        **asdict(setting.links),
        "not_driven": [
            {
                "case": refusal.case.name,
                "approach": refusal.approach,
                "speeds_kmh": list(refusal.speeds_kmh),
                "reason": refusal.reason,
            }
            for refusal in setting.refusals
        ],
    }


def disagreeing_runs(placement: Placement, evaluation: Evaluation) -> "np.ndarray[Any, Any]":
    """Runs on which detection table and evaluator disagree about the layout found.

    Parameters
    ----------
    placement : Placement
        The layout on the table.
    evaluation : Evaluation
        The same layout by full perception.

    Returns
    -------
    disagrees : (n_runs,) bool
        Under the placement's own fusion.
    """
    on_table = np.isfinite(run_margins_s(placement.nominal, placement.nominal_index))
    if placement.problem.fusion == "any":
        evaluated = evaluation.rsu_all.is_avoided
    else:
        evaluated = np.any([unit.is_avoided for unit in evaluation.units.values()], axis=0)
    disagrees: np.ndarray[Any, Any] = on_table != evaluated
    return disagrees


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    rays = caster_name()
    found = {"place-rsus": version("place-rsus"), "python": platform.python_version()}
    found |= {name: version(name) for name in _PACKAGES}
    for package in _RAY_PACKAGES[rays]:
        try:
            found[f"rays: {rays}"] = version(package)
            break
        except ModuleNotFoundError:
            continue
    return found
