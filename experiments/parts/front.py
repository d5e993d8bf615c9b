"""The front: what each further unit, or more money, buys, and its proof."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from msgspec import UnsetType
from msgspec.structs import asdict as fields_of
from msgspec.structs import replace as replace_fields

from geometry.arrays import FloatArray
from geometry.scene_files import load_scene
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.detection_table import plain_axis
from placement.optimiser import PlacementProblem, PlacementValue, apr_one_failed
from placement.optimiser.front import Front, FrontPoint, StageChoice, cost_front, pareto_front
from placement.optimiser.presolve import PresolveStatistics
from placement.optimiser.steering import COST_TOLERANCE_EUR, TOLERANCE
from placement.pipeline import Assembly, assemble, pick_layout
from placement.question import Question
from placement.wishes import assumed_prices, load_prices

from ..export.json import to_json_text
from ..figures.axes import BLUE, VERMILION, WIDTH_IN, Style, finish_axes, new_figure, to_png
from ..progress import WRITING, StageProgress
from ..results.drives import RefusalRecord, build_drives_record, versions
from ..results.folders import check_folder, write_files
from ..results.numbers import NOTHING, euros, number, percent, points
from ..results.record import (
    LayoutValueRecord,
    Record,
    Share,
    StageRecord,
    UnitRecord,
    build_stage_records,
    build_unit_records,
    says,
)
from ..results.tables import csv_text
from .section import Block, Bullets, Section, Table, build_picture


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
    pose_ids: Annotated[tuple[str, ...], says("Names of the candidate poses, in the same order.")]


class FrontRecord(Record, frozen=True, kw_only=True):
    """The best layout of each smaller size, and the gain of each unit."""

    by: Annotated[Literal["units", "cost"], says("What there is more and more of.")]
    optimised: Annotated[
        Literal["first", "all"],
        says("first: APR, and APR if a unit fails; all: margins and cost, too."),
    ]
    candidates: Annotated[int, says("Candidate poses.", ge=0)]
    runs: Annotated[int, says("Runs on the detection table, in all sampled worlds together.", ge=0)]
    fusion: Annotated[Literal["any", "single"], says("As at the top.")]
    kept: Annotated[int, says("Units that are mounted already.", ge=0)]
    settled: Annotated[
        float | None, says("Units, or EUR, from which on nothing grows; null: unknown.")
    ]
    is_proven: Annotated[bool, says("Whether every point is.")]
    presolve: Annotated[
        PresolveStatistics | None, says("Once for all points; null: each was solved by itself.")
    ]
    refused: Annotated[tuple[RefusedSizeRecord, ...], says("Sizes that cannot be.")]
    points: Annotated[tuple[FrontPointRecord, ...], says("In ascending order.")]
    sentences: Annotated[tuple[str, ...], says("What each unit buys, in words.")]


def _point(point: FrontPoint, candidates: Sequence[CandidatePose]) -> FrontPointRecord:
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


if TYPE_CHECKING:
    import pandas as pd

_VALUES = PlacementValue._fields
_SHARES = ("apr", "apr_one_failed")
_COLUMNS = {
    "apr": "APR",
    "apr_one_failed": "APR if the most needed unit fails",
    "smallest_margin_s": "smallest time to spare (s)",
    "mean_margin_s": "mean time to spare (s)",
    "cost_eur": "cost (EUR)",
}


def _stage(point: FrontPointRecord, name: str) -> StageRecord | None:
    """The stage of a name; None if it was not optimised."""
    return next((stage for stage in point.stages if stage.name == name), None)


# ---------- rows, proof, and the section of the report


def front_rows(front: FrontRecord) -> list[list[str]]:
    """A row for each point: units, values of the layout, and whether more is ruled out."""
    return [
        [
            str(point.units),
            *(_shown(name, getattr(point, name)) for name in _VALUES),
            _proof(point),
        ]
        for point in front.points
    ]


def _shown(name: str, value: float) -> str:
    if name in _SHARES:
        return percent(value)
    return f"{value:,.0f}" if name == "cost_eur" else number(value, 3)


def _proof(point: FrontPointRecord) -> str:
    if point.is_proven:
        return "proven"
    stage = next(stage for stage in point.stages if stage.gap != 0.0)
    what = _COLUMNS.get(stage.name, stage.name)
    if stage.bound is None or not math.isfinite(stage.bound):
        return f"open: nothing is proven of the {what}"
    more = "less" if stage.name == "cost_eur" else "more"
    bound = _precise(stage.bound) if stage.name in _SHARES else number(stage.bound, 3)
    return f"open: {what} no {more} than {bound}"


def proof_sentences(front: FrontRecord) -> list[str]:
    """Sentences on the proof of a front."""
    n_points, n_proven = len(front.points), sum(point.is_proven for point in front.points)
    objectives = (
        "in APR, then in what is left when the most needed unit fails, then in time to spare and "
        "cost"
        if front.optimised == "all"
        else "in APR, then in what is left when the most needed unit fails"
    )
    among = "no other choice among the candidate poses is better on the detection table"
    allowed = "units" if front.by == "units" else "money"
    if n_points == 1:
        first = (
            f"Proven: {among}, {objectives}."
            if n_proven
            else f"Not proven: another choice may be better, {objectives}."
        )
    elif n_proven == n_points:
        first = f"All {n_points} points are proven: with as many {allowed}, {among}, {objectives}."
    elif n_proven:
        first = (
            f"{n_proven} of {n_points} points are proven: with as many {allowed}, {among}, "
            f"{objectives}. Of the others the table says what is still open."
        )
    else:
        first = (
            f"None of the {n_points} points is proven: of each the table says what is still open."
        )
    sentences = [first]
    if front.settled is not None and front.by == "units":
        sentences.append(f"Proven, too: from {front.settled:g} units on nothing grows any more.")
    return sentences


def front_section(front: FrontRecord | UnsetType | None) -> Section | None:
    """Gains of each unit; None where the best was not what was asked for."""
    if not front:
        return None
    rows, proof = front_rows(front), " ".join(proof_sentences(front))
    picture = build_picture(
        plot_front(front),
        title="What each further unit buys",
        caption="Every point is the best layout found for as many units; open markers and "
        f"bars: what is not yet ruled out. {proof}",
        alt="Curves over the number of units. "
        + "; ".join(
            f"{row[0]}: APR {row[1]}, {row[2]} if one fails, {row[3]} s to spare, {row[6]}"
            for row in rows
        )
        + ".",
    )
    table = Table(
        caption="The best layout for each number of units",
        columns=["units", *(_COLUMNS[name] for name in _VALUES), "proof"],
        rows=rows,
        numeric=range(1, 6),
    )
    poses = Table(
        caption="Candidate poses of each point, and their sites",
        columns=["units", "poses", "sites"],
        rows=[
            [
                str(point.units),
                _listed(point.pose_ids),
                _listed([unit.site or NOTHING for unit in point.layout]),
            ]
            for point in front.points
        ],
        summary="Which poses",
    )
    proof += (
        " Each number of units has the best layout of its own; the units of one are not always "
        "among those of the next."
    )
    blocks: list[Block] = [Bullets(front.sentences), picture, table, proof, poses]
    return Section("front", "What each unit buys", blocks)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or NOTHING


# ---------- what each further unit, or more money, buys


_ORDINALS = (
    *("zeroth", "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth"),
    *("ninth", "tenth", "eleventh", "twelfth"),
)

PoleFailed = Callable[[FrontPoint], float]


def describe_units(
    front: Front, *, n_kept: int = 0, pole_failed: PoleFailed | None = None
) -> list[str]:
    """Sentences on the gain of each further unit.

    A sentence for the first point, one for each that differs from the one before, one for what
    follows; such as "The second unit adds no APR; the layout then survives any single failure."
    `n_kept` units are mounted already, and count. `pole_failed` gives the APR that is left of a
    point when the worst pole fails with all its units; without it only units fail.
    """
    points = front.points
    sentences = [_first_units(points[0], n_kept)]
    idle: list[int] = []
    for before, point in pairwise(points):
        if front.settled is not None and point.units > front.settled:
            break
        bought = _bought(before, point, front, pole_failed)
        if not bought:
            idle.append(point.units)
            continue
        sentences += _idle(idle)
        idle = []
        sentences.append(f"The {_ordinal(point.units)} unit {bought}{_doubt(point, front)}.")
    sentences += _idle(idle, is_proven=front.is_proven)
    if front.settled is not None:
        sentences.append(_nothing_grows(front, f"From K = {front.settled:g} on nothing grows"))
    for units, why in front.refused:
        sentences.append(f"With {units} the wishes cannot be met: {why}.")
    return sentences


def describe_money(front: Front, *, pole_failed: PoleFailed | None = None) -> list[str]:
    """Sentences on the gain of more money: one for every point, and one for what follows."""
    first = front.points[0]
    sentences = [
        f"{euros(first.value.cost_eur)} buy an APR of {percent(first.value.apr)}"
        f"{_left(first)}{_doubt(first, front)}."
    ]
    for before, point in pairwise(front.points):
        more = point.value.cost_eur - before.value.cost_eur
        verbs = _bought(before, point, front, pole_failed, many=True)
        sentences.append(
            f"{euros(more)} more ({euros(point.value.cost_eur)} in all) {verbs}"
            f"{_doubt(point, front)}."
        )
    if front.settled is not None:
        sentences.append(_nothing_grows(front, f"Beyond {euros(front.settled)} nothing grows"))
    return sentences


def _first_units(point: FrontPoint, n_kept: int) -> str:
    number = point.units
    if n_kept and number == n_kept:
        who = f"The {number} existing units reach" if number > 1 else "The existing unit reaches"
    elif number == 1:
        who = "The first unit reaches"
    else:
        who = f"The first {number} units reach"
    doubt = ""
    stage = point.stage("apr")
    if stage is not None and stage.gap != 0.0:
        doubt = f" (proven is only: no more than {_precise(stage.bound)})"
    return f"{who} an APR of {percent(point.value.apr)}{_left(point)}{doubt}."


def _left(point: FrontPoint) -> str:
    value = point.value
    if len(point.pose_index) == 1 or value.apr <= TOLERANCE:
        return ""
    if value.apr_one_failed >= value.apr - TOLERANCE:
        return ", whichever single one fails"
    return f", {percent(value.apr_one_failed)} when the most needed one fails"


def _bought(
    before: FrontPoint,
    point: FrontPoint,
    front: Front,
    pole_failed: PoleFailed | None,
    *,
    many: bool = False,
) -> str:
    """Gains of a point over the one before, as verbs and objects; empty if nothing."""
    old, new = before.value, point.value
    s = "" if many else "s"
    clauses = []
    gain = new.apr - old.apr
    if gain > TOLERANCE:
        clauses.append(f"add{s} {points(gain)} of APR ({percent(new.apr)})")
    kept = new.apr_one_failed - old.apr_one_failed
    if kept > TOLERANCE and new.apr_one_failed >= new.apr - TOLERANCE:
        clauses.append(f"the layout then survives {_survived(point, pole_failed)}")
    elif abs(kept) > TOLERANCE:
        less = "only " if kept < 0.0 else ""
        not_before = f", not {percent(old.apr_one_failed)}" if len(before.pose_index) > 1 else ""
        clauses.append(
            f"{less}{percent(new.apr_one_failed)} are then left when any one unit fails{not_before}"
        )
    if front.stages == "all" and abs(gain) <= TOLERANCE:
        clauses += _time_bought(before, point, s)
    if not clauses:
        return ""
    if gain <= TOLERANCE and not clauses[0].startswith(("buy", "save", "cost")):
        clauses.insert(0, f"add{s} no APR")
    return "; ".join(clauses)


def _survived(point: FrontPoint, pole_failed: PoleFailed | None) -> str:
    """Failures that a layout survives which loses nothing with any one unit."""
    left = None if pole_failed is None else pole_failed(point)
    if left is None:
        return "the failure of any one unit"
    if left >= point.value.apr - TOLERANCE:
        return "any single failure"
    return f"the failure of any one unit, but not that of a pole ({percent(left)} are then left)"


def _time_bought(before: FrontPoint, point: FrontPoint, s: str) -> list[str]:
    """Gains in time to spare, of two points with the same APR."""
    old, new = before.value, point.value
    parts = []
    for gain, where in (
        (new.smallest_margin_s - old.smallest_margin_s, "time to spare in the tightest run"),
        (new.mean_margin_s - old.mean_margin_s, "mean time to spare"),
    ):
        if gain > TOLERANCE:
            parts.append(f"{_seconds(gain)} of {where}")
    if parts:
        return [f"buy{s} " + " and ".join(parts)]
    saved = old.cost_eur - new.cost_eur
    is_same = all(abs(a - b) <= TOLERANCE for a, b in zip(old[:-1], new[:-1], strict=True))
    return [f"save{s} {euros(saved)}"] if is_same and saved > COST_TOLERANCE_EUR else []


def _doubt(point: FrontPoint, front: Front) -> str:
    """Open bounds of a point, in brackets."""
    for stage in point.certificate.stages:
        if stage.gap == 0.0:
            continue
        if stage.name == "cost_eur":
            if front.by == "cost":
                return f" (proven is only: not for less than {euros(stage.bound)})"
            return " (not proven: as good for less)"
        what = {"apr": "the APR", "apr_one_failed": "what is left when one fails"}.get(stage.name)
        if what is not None:
            return f" (proven is only: {what} is no more than {_precise(stage.bound)})"
        return f" (proven is only: no more than {_seconds(stage.bound)})"
    return ""


def _idle(units: Sequence[int], *, is_proven: bool = True) -> list[str]:
    """Units that add nothing, in a sentence; none where there are none."""
    if not units:
        return []
    if len(units) == 1:
        text = f"The {_ordinal(units[0])} unit adds nothing"
    else:
        joint = "and" if len(units) == 2 else "to"
        text = f"The {_ordinal(units[0])} {joint} {_ordinal(units[-1])} unit add nothing"
    return [text + ("." if is_proven else ", as far as was found: that is not proven.")]


def _nothing_grows(front: Front, words: str) -> str:
    if front.stages == "all":
        return f"{words}: no layout of any size is better."
    return (
        f"{words}: no layout of any size avoids more, or keeps more when one unit fails. "
        "Time to spare was not optimised."
    )


def _precise(share: float) -> str:
    return f"{100.0 * share:.2f} %"


def _ordinal(number: int) -> str:
    if number < len(_ORDINALS):
        return _ORDINALS[number]
    if number % 100 in (11, 12, 13):
        return f"{number}th"
    return f"{number}{ {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th') }"


def _seconds(time_s: float) -> str:
    return f"{time_s:.2f} s" if time_s >= 0.01 else f"{time_s:.1g} s"


# ---------- the job, and the table


CSV_NAME, JSON_NAME, PNG_NAME = "pareto.csv", "pareto.json", "pareto.png"


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
    all_stages: bool,
    out: Path | None,
    compute: Compute,
    command: str,
    progress: StageProgress,
) -> FrontResult:
    """Find what each further unit, or more money, buys; write it to `out` if asked to.

    The question's time is for all points together; `max_units` are next to existing ones, and
    `all_stages` optimises margins and cost, too. Raises InputError if a wish cannot be met, or
    `out` cannot be written.
    """
    scene = load_scene(question.scene)
    if out is not None:
        check_folder(out)
        progress.kept = f"nothing was written to {out}"
    plan = assemble(replace(question, budget=max_units), scene=scene, compute=compute)
    prices = load_prices() if by == "cost" and question.site_cost_eur is None else None
    plan = replace(plan, wishes=replace(plan.wishes, prices=prices))
    setting, problem = plan.setting, plan.problem
    progress("front", 0, 0)
    n_kept = len(plan.wishes.existing)
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
        assumed = assumed_prices(prices, scene.sites)
        result = replace_fields(result, sentences=(*result.sentences, *assumed))
    if out is None:
        return replace_fields(result, seconds=progress.finish())
    progress(WRITING, 0, 0)
    csv = csv_text(front_table(result))
    png = to_png(plot_front(result))
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
    plan: Assembly,
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
    """A front with the units of every point, and what each unit, or more money, buys.

    `candidates` are the rows of the problem's table; `n_kept` units are mounted already.
    """
    by_pole = replace(problem, limits=replace(problem.limits, failing="site"))

    def pole_failed(point: FrontPoint) -> float:
        return apr_one_failed(by_pole, point.pose_index)

    if front.by == "units":
        sentences = describe_units(front, n_kept=n_kept, pole_failed=pole_failed)
    else:
        sentences = describe_money(front, pole_failed=pole_failed)
    return FrontRecord(
        by=front.by,
        optimised=front.stages,
        candidates=problem.table.n_poses,
        runs=plain_axis(problem.table.axis).n_runs,
        fusion=problem.fusion,
        kept=n_kept,
        settled=front.settled,
        is_proven=front.is_proven,
        presolve=front.presolve,
        refused=tuple(RefusedSizeRecord(units=units, reason=why) for units, why in front.refused),
        points=tuple(_point(point, candidates) for point in front.points),
        sentences=tuple(sentences),
    )


def front_table(front: FrontRecord) -> "pd.DataFrame":
    """A row per point: units, apr, apr_bound and so on, is_proven, and ids of poses.

    The bound of what was not optimised is missing.
    """
    rows = []
    for point in front.points:
        row: dict[str, object] = {"units": point.units}
        for name in _VALUES:
            stage = _stage(point, name)
            row |= {name: getattr(point, name), f"{name}_bound": stage and stage.bound}
        row["is_proven"] = point.is_proven
        row["poses"] = " ".join(point.pose_ids)
        rows.append(row)
    import pandas as pd

    return pd.DataFrame(rows)


# ---------- the figure


_SETTLED = "#ececec"
_X_LABELS = {"units": "units", "cost": "cost (EUR)"}
# Told apart by marker and dashes as well as by colour.
_CURVES: dict[str, Style] = {
    "apr": {"label": "APR", "color": BLUE, "marker": "o", "linestyle": "-"},
    "apr_one_failed": {
        "label": "APR when the most needed unit fails",
        "color": VERMILION,
        "marker": "s",
        "linestyle": (0, (4, 2)),
    },
}
_TIMES: dict[str, Style] = {
    "smallest_margin_s": {"label": "smallest", "color": BLUE, "marker": "o", "linestyle": "-"},
    "mean_margin_s": {
        "label": "mean",
        "color": VERMILION,
        "marker": "s",
        "linestyle": (0, (4, 2)),
    },
}


def plot_front(front: FrontRecord) -> Axes:
    """APR and APR when one unit fails against units or euros; times to spare where optimised.

    The axes are those of the shares; the times have axes below. Filled markers are layouts found.
    Open ones are bounds that no layout exceeds, where they are higher; a bar spans the gap. Where
    nothing grows any more, the ground is grey.
    """
    has_times = front.optimised == "all"
    figure = new_figure(WIDTH_IN, 4.9 if has_times else 3.4)
    panels = figure.subplots(
        2 if has_times else 1, 1, sharex=True, squeeze=False, height_ratios=[3, 2][: 1 + has_times]
    )[:, 0]
    shares: Axes = panels[0]
    handles = _draw(shares, front, _CURVES, scale=100.0)
    shares.set_ylabel("share of the runs avoided (%)", fontsize=8)
    shares.set_ylim(-4.0, 104.0)
    if has_times:
        times = _draw(panels[1], front, _TIMES, scale=1.0)
        panels[1].set_ylabel("time to spare (s)", fontsize=8)
        panels[1].set_ylim(bottom=min(0.0, panels[1].get_ylim()[0]))
        panels[1].legend(handles=times[:2], fontsize=8, frameon=False, loc="best")
    panels[-1].set_xlabel(_X_LABELS[front.by], fontsize=8)
    figure.legend(
        handles=[*handles, *_shades(front)],
        loc="outside upper center",
        ncols=2,
        fontsize=8,
        frameon=False,
    )
    return shares


def _draw(axes: Axes, front: FrontRecord, curves: dict[str, Style], *, scale: float) -> list[Any]:
    """Draw curves; returns the entries of the legend."""
    x = _positions(front)
    steps = "steps-post" if front.by == "cost" else "default"
    end = _right_end(x, front.by)
    handles: list[Any] = []
    if front.settled is not None:
        axes.axvspan(front.settled, end, color=_SETTLED, zorder=0, lw=0, gid="settled")
    for order, (name, style) in enumerate(curves.items()):
        values = scale * np.array([getattr(point, name) for point in front.points])
        bounds = scale * np.array(_bounds(front, name))
        is_open = bounds > values + 1.0e-9 * scale
        # The later curve's markers are smaller: where both coincide, both are seen.
        size = 8.0 - 3.0 * order
        drawn = {"color": style["color"], "linestyle": style["linestyle"]}
        line_x, line_y = x, values
        if front.by == "cost":  # the last layout is the best for more money, too
            line_x, line_y = np.append(x, end), np.append(values, values[-1])
        axes.plot(line_x, line_y, drawstyle=steps, lw=1.6, zorder=2 + order, **drawn)
        axes.plot(
            x,
            values,
            linestyle="none",
            marker=style["marker"],
            ms=size,
            mfc=style["color"],
            mec="white",
            mew=0.6,
            zorder=4 + order,
            gid=name,
        )
        if is_open.any():
            axes.vlines(
                x[is_open],
                values[is_open],
                bounds[is_open],
                color=style["color"],
                lw=7.0,
                alpha=0.3,
            )
            axes.plot(
                x[is_open],
                bounds[is_open],
                linestyle="none",
                marker=style["marker"],
                ms=size + 4.0,
                mfc="none",
                mec=style["color"],
                mew=1.4,
                zorder=8 + order,
                gid=f"{name} bound",
            )
        handles.append(
            Line2D([], [], marker=style["marker"], ms=size, label=style["label"], lw=1.6, **drawn)
        )
    if front.by == "units":
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(_left_end(x, front.by), end)
    finish_axes(axes, grid="y")
    return handles


def _shades(front: FrontRecord) -> list[Any]:
    """Entries of the legend for what is open, and for where nothing grows."""
    entries: list[Any] = []
    if not front.is_proven:
        style: Style = {"mfc": "none", "mec": "black", "mew": 1.4, "ms": 9.0}
        words = "open: bound that no layout exceeds"
        entries.append(Line2D([], [], linestyle="none", marker="o", label=words, **style))
    if front.settled is not None:
        entries.append(Patch(facecolor=_SETTLED, label="nothing grows any more: proven"))
    return entries


def _positions(front: FrontRecord) -> FloatArray:
    if front.by == "units":
        return np.array([float(point.units) for point in front.points])
    return np.array([point.cost_eur for point in front.points])


def _bounds(front: FrontRecord, name: str) -> Sequence[float]:
    """Bounds of a stage; the value itself where it was not optimised."""
    stages = [(point, _stage(point, name)) for point in front.points]
    return [
        getattr(point, name)
        if stage is None
        else (math.inf if stage.bound is None else stage.bound)
        for point, stage in stages
    ]


def _left_end(x: FloatArray, by: str) -> float:
    return float(x[0]) - 0.4 if by == "units" else 0.0 - 0.02 * _right_end(x, by)


def _right_end(x: FloatArray, by: str) -> float:
    return float(x[-1]) + 0.4 if by == "units" else 1.15 * max(float(x[-1]), 1.0)
