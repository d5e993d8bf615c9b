"""Fronts that are asked for by themselves.

What each further unit, or more money, buys.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.phrases import Phrase
from geometry.scene_sources import load_scene
from placement.compute import Compute
from placement.optimiser import PlacementValue
from placement.optimiser.cost_front import cost_front
from placement.optimiser.front import FrontPoint, pareto_front
from placement.pipeline import assemble
from placement.question import Question
from placement.wishes import assumed_prices, load_prices

from ..export.json import to_json_text
from ..figures.axes import to_png
from ..language import mark, tr
from ..parts.front import FrontRecord, describe_front, stage_of
from ..parts.front_curves import plot_front
from ..progress import StageProgress
from ..results.drives import RefusalRecord, build_drives_record, versions
from ..results.folders import expect_files, save_files
from ..results.record import Share
from ..results.tables import records_csv

CSV_NAME = "pareto.csv"
JSON_NAME = "pareto.json"
PNG_NAME = "pareto.png"


class FrontResult(FrontRecord, frozen=True, kw_only=True):
    """A front with its question: ``pareto.json``, and what ``--json`` prints."""

    command: str
    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    detector: str
    vut_sensors: tuple[str, ...]
    cars: Share = 0.0
    packet_loss: Share
    vam_rate: Share
    track_memory_s: float | None = None
    not_driven: tuple[RefusalRecord, ...]
    possible_runs: int
    driven: tuple[str, ...]
    without_effect: tuple[str, ...] = ()
    seconds: dict[str, float]
    versions: dict[str, str]


def run_pareto(
    question: Question,
    *,
    by: str,
    max_units: int,
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> FrontResult:
    """Find what each further unit, or more money, buys.

    Write it to `out` if asked to.

    Parameters
    ----------
    question : Question
        What is driven.
    question : Question
        What is asked beside the number of units, and how it is looked for: its time is
        for all points together.
    by : {"units", "cost"}
        See :class:`placement.optimiser.front.Front`.
    max_units : int
        Most units, beside those that are kept.
    out : Path, optional
        Folder that gets ``pareto.csv``, ``pareto.json`` and ``pareto.png``; what else
        it holds stays.
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
    expect_files(out, progress)
    plan = assemble(replace(question, budget=max_units), scene=scene, compute=compute)
    if by == "cost" and question.site_cost_eur is None:
        prices = load_prices()
    else:
        prices = None
    plan = replace(plan, wishes=replace(plan.wishes, prices=prices))
    problem, n_kept = plan.problem, len(plan.wishes.existing)
    progress(mark("front"), 0, 0)

    def tell(point: FrontPoint) -> None:
        stage = Phrase(
            "front: {n} of {n_all} units",
            n=point.units,
            n_all=problem.limits.budget_units,
        )
        if by == "cost":
            stage = Phrase("front: {price:,.0f} EUR", price=point.value.cost_eur)
        progress(stage, 0, 0)

    find = cost_front
    if by == "units":
        most = problem.limits.budget_units
        # That was asked for.
        assert most is not None
        find = partial(pareto_front, max_units=most, min_units=max(n_kept, 1))
    front = find(problem, effort=plan.effort, on_point=tell)
    result = FrontResult(
        **fields_of(describe_front(front, problem, plan.candidates, n_kept=n_kept)),
        command=command,
        **fields_of(build_drives_record(plan.setting)),
        seconds={},
        versions=versions(),
    )
    if prices is not None:
        assumed = assumed_prices(prices, scene.sites)
        result = replace_fields(
            result, sentences=(*result.sentences, *map(tr, assumed))
        )

    def files(done: FrontResult) -> dict[str, str | bytes]:
        drawn = to_png(plot_front(done))
        tables = {
            CSV_NAME: records_csv(front_rows(done)),
            JSON_NAME: to_json_text(done),
        }
        return {**tables, PNG_NAME: drawn}

    return save_files(result, out, progress, files)


def front_rows(front: FrontRecord) -> list[dict[str, object]]:
    """A row per point; the bound of what was not optimised is missing."""
    rows = []
    for point in front.points:
        row: dict[str, object] = {"units": point.units}
        for name in PlacementValue._fields:
            stage = stage_of(point, name)
            row |= {name: getattr(point, name), f"{name}_bound": stage and stage.bound}
        rows.append(
            row | {"is_proven": point.is_proven, "poses": " ".join(point.pose_ids)}
        )
    return rows
