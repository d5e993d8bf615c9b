"""The front: what each further unit, or more money, buys, and its proof."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from msgspec.structs import replace as replace_fields

from placement.candidates import CandidatePose
from placement.detection_table import plain_axis
from placement.optimiser import PlacementProblem
from placement.optimiser.front import Front, FrontPoint
from placement.optimiser.presolve import PresolveStatistics
from placement.optimiser.problem import apr
from placement.pipeline import pick_layout

from ..figures.axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, new_figure
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
from .section import Block, Bullets, Section, Table, build_picture, tabulate

_HEADS = {
    "apr": "APR",
    "apr_one_failed": mark("one fails"),
    "smallest_margin_s": mark("least"),
}
_HEADS |= {"mean_margin_s": mark("mean"), "cost_eur": "EUR"}
_POINT = ("units", "apr", "gain", "left", "spare", "mean", "cost", "proof")
_SETTLED = "#ececec"
# Told apart by marker and dashes as well as by colour.
_SOLID: Style = {"color": BLUE, "marker": "o", "linestyle": "-"}
_DASHED: Style = {"color": VERMILION, "marker": "s", "linestyle": (0, (4, 2))}
_CURVES: dict[str, Style] = {
    "apr": {"label": mark("APR")} | _SOLID,
    "apr_one_failed": {"label": mark("APR when the most needed unit fails")} | _DASHED,
}
_TIMES: dict[str, Style] = {
    "smallest_margin_s": {"label": mark("smallest")} | _SOLID,
    "mean_margin_s": {"label": mark("mean")} | _DASHED,
}


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
    star = tr("* of this layout; not optimised: --all-stages does.")
    columns = tr(
        "gain: points of APR over the row above; one fails: APR that is "
        "left when the most needed unit fails; least, mean: time to spare "
        "in the runs avoided, in s."
    )
    if front.by == "cost":
        columns = tr(
            "gain: points of APR over the row above; one fails: APR that is "
            "left when the most needed unit fails; least, mean: time to spare "
            "in the runs avoided, in s; each EUR is the least that buys this."
        )
    fewer = mark(
        "Where more units add nothing, a layout has fewer than its row allows."
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
    better = tr("better, in APR, then in what is left when the most needed unit fails")
    if is_all:
        better = tr(
            "better, in APR, then in what is left when the most needed unit "
            "fails, then in time to spare and cost"
        )
    proof = tr(
        "{n} of {n_all} points are proven; of the others another choice "
        "may be {better}: the table says what is open.",
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
            where = tr("From {n:g} units", n=front.settled)
        settled = mark(
            "{where} on nothing grows: no layout of any size avoids more, also when one"
            " unit fails."
        )
        if is_all:
            settled = mark("{where} on nothing grows: no layout of any size is better.")
        sentences.append(tr(settled, where=where))
    return sentences + [
        tr(
            "With {n} the wishes cannot be met: {why}.",
            n=size.units,
            why=tr(size.reason),
        )
        for size in front.refused
    ]


def front_section(front: FrontRecord | None) -> Section | None:
    """Gains of each unit; None where the best was not what was asked for."""
    if front is None:
        return None
    shown = table(front)
    in_words = "; ".join(
        tr(
            "{units}: APR {apr}, {left} if one fails, {spare} s to spare, {proof}",
            **dict(zip(_POINT, map(str, row), strict=True)),
        )
        for row in shown.rows
    )
    picture = build_picture(
        plot_front(front),
        title=tr("What each further unit buys"),
        caption=tr(
            "Every point is the best layout found for as many units; open "
            "markers and bars: what is not yet ruled out."
        ),
        alt=tr("Curves over the number of units. {points}.", points=in_words),
    )
    poses = tabulate(
        tr("Candidate poses of each point, and their sites"),
        front.points,
        {
            tr("units"): lambda point: str(point.units),
            tr("poses"): lambda point: ", ".join(point.pose_ids) or NOTHING,
            tr("sites"): lambda point: (
                ", ".join(one.site or NOTHING for one in point.layout) or NOTHING
            ),
        },
        summary=tr("Which poses"),
    )
    own = tr(
        "Each number of units has the best layout of its own; the units "
        "of one are not always among those of the next."
    )
    note = " ".join([*notes(front), own])
    blocks: list[Block] = [Bullets(front.sentences), picture, shown, note, poses]
    return Section("front", tr("What each unit buys"), blocks)


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


def plot_front(front: FrontRecord) -> Axes:
    """APR and APR when one unit fails against units or euros.

    Times to spare where optimised.

    The axes are those of the shares; the times have axes below. Filled markers are
    layouts found. Open ones are bounds that no layout exceeds, where they are higher; a
    bar spans the gap. Where nothing grows any more, the ground is grey.
    """
    has_times = front.optimised == "all"
    figure = new_figure(WIDTH_IN, 4.9 if has_times else 3.4)
    if has_times:
        ratios = [3, 2]
    else:
        ratios = [3]
    panels = figure.subplots(
        len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios
    )[:, 0]
    shares: Axes = panels[0]
    handles = _draw(shares, front, _CURVES, scale=100.0)
    shares.set_ylabel(tr("share of the runs avoided (%)"), fontsize=8)
    shares.set_ylim(-4.0, 104.0)
    if has_times:
        times = _draw(panels[1], front, _TIMES, scale=1.0)
        panels[1].set_ylabel(tr("time to spare (s)"), fontsize=8)
        panels[1].set_ylim(bottom=min(0.0, panels[1].get_ylim()[0]))
        panels[1].legend(handles=times[:2], fontsize=8, frameon=False, loc="best")
    if front.by == "units":
        x_label = tr("units")
    else:
        x_label = tr("cost (EUR)")
    panels[-1].set_xlabel(x_label, fontsize=8)
    if not front.is_proven:
        style: Style = {
            "mfc": "none",
            "mec": "black",
            "mew": 1.4,
            "ms": 9.0,
            "linestyle": "none",
        }
        label = tr("open: bound that no layout exceeds")
        handles.append(Line2D([], [], marker="o", label=label, **style))
    if front.settled is not None:
        handles.append(
            Patch(facecolor=_SETTLED, label=tr("nothing grows any more: proven"))
        )
    place: Style = {"loc": "outside upper center", "ncols": 2}
    figure.legend(handles=handles, fontsize=8, frameon=False, **place)
    return shares


def _draw(
    axes: Axes, front: FrontRecord, curves: dict[str, Style], *, scale: float
) -> list[Any]:
    """Draw curves; returns the entries of the legend."""
    points = front.points
    by_units = front.by == "units"
    x = np.array(
        [float(point.units) if by_units else point.cost_eur for point in points]
    )
    if by_units:
        end = float(x[-1]) + 0.4
    else:
        end = 1.15 * max(float(x[-1]), 1.0)
    handles: list[Any] = []
    if front.settled is not None:
        axes.axvspan(front.settled, end, color=_SETTLED, zorder=0, lw=0, gid="settled")
    for order, (name, style) in enumerate(curves.items()):
        values = scale * np.array([getattr(point, name) for point in points])
        bounds = scale * np.array([_bound(point, name) for point in points])
        is_open = bounds > values + 1.0e-9 * scale
        # The later curve's markers are smaller: where both coincide, both are seen.
        size = 8.0 - 3.0 * order
        colour = style["color"]
        line: Style = {"color": colour, "linestyle": style["linestyle"], "lw": 1.6}
        mark: Style = {"marker": style["marker"], "linestyle": "none"}
        if by_units:
            axes.plot(x, values, zorder=2 + order, **line)
        else:
            # The last layout is the best for more money, too.
            steps: Style = line | {"drawstyle": "steps-post"}
            axes.plot(
                np.append(x, end),
                np.append(values, values[-1]),
                zorder=2 + order,
                **steps,
            )
        mark |= {"mfc": colour, "mec": "white", "mew": 0.6}
        axes.plot(x, values, ms=size, zorder=4 + order, gid=name, **mark)
        if is_open.any():
            at = x[is_open]
            low = values[is_open]
            high = bounds[is_open]
            axes.vlines(at, low, high, color=colour, lw=7.0, alpha=0.3)
            mark |= {"mfc": "none", "mec": colour, "mew": 1.4, "ms": size + 4.0}
            axes.plot(at, high, zorder=8 + order, gid=f"{name} bound", **mark)
        label = {"marker": style["marker"], "ms": size, "label": tr(style["label"])}
        handles.append(Line2D([], [], **label, **line))
    if by_units:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(float(x[0]) - 0.4 if by_units else -0.02 * end, end)
    finish_axes(axes, grid="y")
    return handles


def _bound(point: FrontPointRecord, name: str) -> float:
    """Bound of a stage; the value itself where it was not optimised."""
    stage = stage_of(point, name)
    if stage is None:
        return float(getattr(point, name))
    if stage.bound is None:
        return math.inf
    return stage.bound
