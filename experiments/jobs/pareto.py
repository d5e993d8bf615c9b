"""The front of a question, for ``place-rsus pareto``: found, and written as table and figure."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.scene_files import load_scene
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.optimiser import PlacementProblem, apr_one_failed
from placement.optimiser.cost_front import cost_front
from placement.optimiser.front import Front, FrontPoint, StageChoice, pareto_front
from placement.pipeline import obtain_table
from placement.planning import Plan, build_plan
from placement.prices import assumed_prices, load_prices
from placement.question import Question
from placement.setting import build_setting
from placement.wishes import build_problem

from ..export.json import to_json_text
from ..figures.axes import to_png
from ..figures.front import plot_front
from ..parts.front import describe_money, describe_units
from ..progress import WRITING, StageProgress
from ..results.csv_text import csv_text
from ..results.drives import build_drives_record, versions
from ..results.folders import check_folder, write_files
from ..results.fronts import FrontRecord, FrontResult, build_front_record

if TYPE_CHECKING:
    import pandas as pd

CSV_NAME, JSON_NAME, PNG_NAME = "pareto.csv", "pareto.json", "pareto.png"
_STAGES = ("apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s", "cost_eur")


def run_pareto(
    question: Question,
    *,
    by: str,
    max_units: int,
    all_stages: bool,
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> FrontResult:
    """Find what each further unit, or more money, buys; write it to `out` if asked to.

    Parameters
    ----------
    question : Question
        What is driven.
    question : Question
        What is asked beside the number of units, and how it is looked for: its time is for all
        points together.
    by : {"units", "cost"}
        See :class:`placement.optimiser.front.Front`.
    max_units : int
        Most units, beside those that are kept.
    all_stages : bool
        Optimise margins and cost, too.
    out : Path, optional
        Folder that gets ``pareto.csv``, ``pareto.json`` and ``pareto.png``; what else it holds
        stays.
    compute : Compute
        Seed, threads, cache; its progress is `progress`.
    command : str
        Command line that makes the result again.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        A wish cannot be met, or `out` cannot be written.
    """
    scene = load_scene(question.scene)
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"
    plan = build_plan(replace(question, budget=1), scene)
    prices = load_prices() if by == "cost" and question.site_cost_eur is None else None
    wishes = replace(plan.wishes, budget_units=max_units, prices=prices)
    progress("setting", 0, 0)
    setting = build_setting(question, scene, compute=compute)
    table = obtain_table(
        setting,
        plan.candidates,
        compute=compute,
    )
    fusion = question.fusion
    problem = build_problem(setting, plan.candidates, table, wishes=wishes, fusion=fusion)
    progress("front", 0, 0)
    n_kept = 0 if plan.kept is None else len(plan.kept.units)
    front = _find_front(
        problem, by=by, all_stages=all_stages, n_kept=n_kept, plan=plan, progress=progress
    )
    result = FrontResult(
        **fields_of(describe_front(front, problem, plan.candidates, n_kept=n_kept)),
        command=command,
        **fields_of(build_drives_record(setting)),
        seconds={},
        versions=versions(),
    )
    if prices is not None:
        told = assumed_prices(prices, scene.sites)
        result = replace_fields(result, sentences=(*result.sentences, *told))
    if out is None:
        return replace_fields(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    csv = csv_text(front_table(front, plan.candidates))
    png = to_png(plot_front(front))
    result = replace_fields(result, seconds=progress.finish())
    json = to_json_text(result)
    write_files(out, {CSV_NAME: csv.encode(), PNG_NAME: png, JSON_NAME: json.encode()})
    progress.kept = f"the results are in {out}"
    return result


def _find_front(
    problem: PlacementProblem,
    *,
    by: str,
    all_stages: bool,
    n_kept: int,
    plan: Plan,
    progress: StageProgress,
) -> Front:
    stages: StageChoice = "all" if all_stages else "first"
    if by == "cost":
        return cost_front(
            problem,
            stages=stages,
            effort=plan.effort,
            on_point=lambda point: progress(f"front: {point.value.cost_eur:,.0f} EUR", 0, 0),
        )
    most = problem.limits.budget_units
    assert most is not None  # that was asked for
    return pareto_front(
        problem,
        max_units=most,
        min_units=max(n_kept, 1),
        stages=stages,
        effort=plan.effort,
        on_point=lambda point: progress(f"front: {point.units} of {most} units", 0, 0),
    )


def describe_front(
    front: Front,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    *,
    n_kept: int = 0,
) -> FrontRecord:
    """A front with the sentences that say what each unit, or more money, buys."""
    by_pole = replace(problem, limits=replace(problem.limits, failing="site"))

    def pole_failed(point: FrontPoint) -> float:
        return apr_one_failed(by_pole, point.pose_index)

    if front.by == "units":
        sentences = describe_units(front, n_kept=n_kept, pole_failed=pole_failed)
    else:
        sentences = describe_money(front, pole_failed=pole_failed)
    return build_front_record(front, problem, candidates, sentences=sentences, n_kept=n_kept)


def front_table(front: Front, candidates: Sequence[CandidatePose]) -> "pd.DataFrame":
    """One row per point.

    Returns
    -------
    table : DataFrame
        Columns units, apr, apr_bound and so on, is_proven, poses: ids with spaces between. The
        bound of what was not optimised is missing.
    """
    rows = []
    for point in front.points:
        row: dict[str, object] = {"units": point.units}
        for name, value in zip(_STAGES, point.value, strict=True):
            stage = point.stage(name)
            row |= {name: value, f"{name}_bound": None if stage is None else stage.bound}
        row["is_proven"] = point.is_proven
        row["poses"] = " ".join(candidates[index].id for index in point.pose_index)
        rows.append(row)
    import pandas as pd

    return pd.DataFrame(rows)
