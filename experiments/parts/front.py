"""The front: what each further unit, or more money, buys, and its proof."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from msgspec.structs import replace as replace_fields

from placement.candidates import CandidatePose
from placement.detection_table import plain_axis
from placement.optimiser import PlacementProblem
from placement.optimiser.front import Front, FrontPoint
from placement.optimiser.presolve import PresolveStatistics
from placement.optimiser.problem import apr
from placement.pipeline import pick_layout

from ..language import localized, mark, tr
from ..results.numbers import NOTHING, euros, number, percent
from ..results.record import (
    LayoutValueRecord,
    Record,
    StageRecord,
    UnitRecord,
    build_stage_records,
    build_unit_records,
    says,
)
from .section import Table

_HEADS = {
    "apr": "APR",
    "apr_one_failed": mark("one fails"),
    "smallest_margin_s": mark("least"),
}
_HEADS |= {"mean_margin_s": mark("mean"), "cost_eur": "EUR"}


class RefusedSizeRecord(Record, frozen=True, kw_only=True):
    """A size with which the wishes cannot be met."""

    units: Annotated[int, says("Units.", ge=0)]
    reason: Annotated[str, says("Why, in words.")]


class FrontPointRecord(LayoutValueRecord, frozen=True, kw_only=True):
    """The best layout of a size."""

    units: Annotated[int, says("Units allowed.", ge=0)]
    is_proven: Annotated[bool, says("Whether the gaps of all stages are closed.")]
    stages: Annotated[tuple[StageRecord, ...], says("What was optimised, in order.")]
    solver: Annotated[str, says("What the proof rests on.")]
    layout: Annotated[tuple[UnitRecord, ...], says("The units.")]
    pose_ids: Annotated[
        tuple[str, ...], says("Names of the candidate poses, in the same order.")
    ]


class FrontRecord(Record, frozen=True, kw_only=True):
    """The best layout of each smaller size, and the gain of each unit."""

    by: Annotated[Literal["units", "cost"], says("What there is more and more of.")]
    optimised: Annotated[
        Literal["first", "all"],
        says("first: APR, and APR if a unit fails; all: also margins, cost."),
    ]
    candidates: Annotated[int, says("Candidate poses.", ge=0)]
    runs: Annotated[
        int, says("Runs on the detection table, in all sampled worlds together.", ge=0)
    ]
    fusion: Annotated[Literal["any", "single"], says("As at the top.")]
    kept: Annotated[int, says("Units that are mounted already.", ge=0)]
    cars_alone: Annotated[
        float, says("APR of the cars' own sensors, without any unit; 0: none.")
    ] = 0.0
    settled: Annotated[
        float | None, says("Units or EUR beyond which nothing grows; or null.")
    ]
    is_proven: Annotated[bool, says("Whether every point is.")]
    presolve: Annotated[
        PresolveStatistics | None, says("For all points; null: each by itself.")
    ]
    refused: Annotated[tuple[RefusedSizeRecord, ...], says("Sizes that cannot be.")]
    points: Annotated[tuple[FrontPointRecord, ...], says("In ascending order.")]
    sentences: Annotated[
        tuple[str, ...], says("What is proven, and where nothing grows.")
    ]


def stage_of(point: FrontPointRecord, name: str) -> StageRecord | None:
    """The stage of a name; None if it was not optimised."""
    return next((stage for stage in point.stages if stage.name == name), None)


def table(front: FrontRecord) -> Table:
    """A row for each point.

    Units, its gain, values of the layout, whether more is ruled out.
    """
    if front.optimised == "all":
        optimised = [*_HEADS]
    else:
        optimised = ["apr", "apr_one_failed"]
    optimised += ["cost_eur"] * (front.by == "cost")
    heads = [tr(head) + "*" * (name not in optimised) for name, head in _HEADS.items()]
    before = [front.cars_alone, *(point.apr for point in front.points)]
    rows = []
    if front.cars_alone > 0.0 and front.points and front.points[0].units > 0:
        alone = percent(front.cars_alone)
        rows.append(["0", alone, *[NOTHING] * 5, tr("the cars alone")])
    for less, point in zip(before, front.points, strict=False):
        gain = number(100.0 * (point.apr - less), 1)
        left = percent(point.apr_one_failed)
        times = [
            number(time_s, 3)
            for time_s in (point.smallest_margin_s, point.mean_margin_s)
        ]
        cost = localized(f"{point.cost_eur:,.0f}")
        proof = _proof(point)
        rows.append(
            [str(point.units), percent(point.apr), gain, left, *times, cost, proof]
        )
    columns = [tr("units"), heads[0], tr("gain"), *heads[1:], tr("proof")]
    by_units = tr("The best layout for each number of units")
    if front.by == "units":
        caption = by_units
    else:
        caption = tr("The best layout for each sum of money")
    return Table(caption=caption, columns=columns, rows=rows, numeric=range(7))


def notes(front: FrontRecord) -> list[str]:
    """How the table is to be read."""
    star = tr("* of this layout, but not optimised.")
    columns = tr(
        "gain: percentage points of APR over the row above; one fails: APR if "
        "the most needed unit fails; least, mean: time to spare in the avoided "
        "runs, in s."
    )
    if front.by == "cost":
        columns = tr(
            "gain: percentage points of APR over the row above; one fails: APR if "
            "the most needed unit fails; least, mean: time to spare in the avoided "
            "runs, in s; EUR: the lowest price of this result."
        )
    fewer = mark(
        "A layout has fewer units than its row allows if more would add nothing."
    )
    is_fewer = any(len(point.layout) < point.units for point in front.points)
    return [f"{star} {columns}" if front.optimised == "first" else columns] + [
        tr(fewer)
    ] * is_fewer


def _proof(point: FrontPointRecord) -> str:
    """What is not ruled out, of the first stage that is open."""
    if point.is_proven:
        return tr("proven")
    stage = next(stage for stage in point.stages if stage.gap != 0.0)
    head = tr(_HEADS.get(stage.name, stage.name))
    if stage.bound is None or not math.isfinite(stage.bound):
        return tr("{value} open", value=head)
    is_share = stage.name in ("apr", "apr_one_failed")
    if is_share:
        bound = number(100.0 * stage.bound, 2) + " %"
    else:
        bound = number(stage.bound, 3)
    return f"{head} {'>=' if stage.name == 'cost_eur' else '<='} {bound}"


def words(front: FrontRecord) -> list[str]:
    """What is proven of a front, and where it ends.

    Where nothing grows any more, and which sizes cannot be.
    """
    n_points = len(front.points)
    n_proven = sum(point.is_proven for point in front.points)
    is_all = front.optimised == "all"
    by_units = front.by == "units"
    better = tr("better (by APR, then by the APR left if the most needed unit fails)")
    if is_all:
        better = tr(
            "better (by APR, then by the APR left if the most needed unit fails, "
            "then by time to spare and cost)"
        )
    proof = tr(
        "{n} of {n_all} points are proven. For the others, another choice may be "
        "{better}; the table shows what is open.",
        n=n_proven,
        n_all=n_points,
        better=better,
    )
    if n_proven == n_points and by_units:
        proof = tr(
            "Proven: for each number of units no other choice among the "
            "candidate poses is {better} (on the detection table).",
            better=better,
        )
    elif n_proven == n_points:
        proof = tr(
            "Proven: for each sum of money no other choice among the "
            "candidate poses is {better} (on the detection table).",
            better=better,
        )
    sentences = [proof]
    if front.settled is not None:
        where = tr("Beyond {price}", price=euros(front.settled))
        if by_units:
            where = tr("From {n:g} units on", n=front.settled)
        settled = mark(
            "{where}, nothing improves: no layout of any size avoids more runs, even "
            "when one unit fails."
        )
        if is_all:
            settled = mark(
                "{where}, nothing improves: no layout of any size is better."
            )
        sentences.append(tr(settled, where=where))
    return sentences + [
        tr(
            "With {n}, the requirements cannot be met: {why}.",
            n=size.units,
            why=tr(size.reason),
        )
        for size in front.refused
    ]


def describe_front(
    front: Front,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    *,
    n_kept: int = 0,
) -> FrontRecord:
    """A front with the units of every point.

    `n_kept` exist. `candidates` are the table's rows.
    """

    def record(point: FrontPoint) -> FrontPointRecord:
        layout = pick_layout(candidates, point.pose_index, f"front-{point.units}")
        return FrontPointRecord(
            units=point.units,
            **point.value._asdict(),
            is_proven=point.is_proven,
            stages=build_stage_records(point.certificate),
            solver=point.certificate.solver,
            layout=build_unit_records(layout),
            pose_ids=tuple(candidates[index].id for index in point.pose_index),
        )

    described = FrontRecord(
        by=front.by,
        optimised=front.stages,
        candidates=problem.table.n_poses,
        runs=plain_axis(problem.table.axis).n_runs,
        fusion=problem.fusion,
        kept=n_kept,
        cars_alone=apr(problem, ()),
        settled=front.settled,
        is_proven=front.is_proven,
        presolve=front.presolve,
        refused=tuple(
            RefusedSizeRecord(units=units, reason=why) for units, why in front.refused
        ),
        points=tuple(record(point) for point in front.points),
        sentences=(),
    )
    return replace_fields(described, sentences=tuple(words(described)))
