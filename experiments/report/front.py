"""The front that ends with the layout of a report: what each further unit buys, and its proof."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from msgspec import UnsetType

from placement.layout import Certificate, Stage
from placement.optimiser import PlacementValue
from placement.optimiser.front import Front, FrontPoint
from placement.optimiser.steering import COST_TOLERANCE_EUR, TOLERANCE

from ..figures.front import plot_front
from ..results.fronts import FrontPointRecord, FrontRecord
from ..results.numbers import NOTHING, euros, number, percent, points
from .section import Block, Bullets, Section, Table, build_picture

_VALUES = PlacementValue._fields
_SHARES = ("apr", "apr_one_failed")
_COLUMNS = {
    "apr": "APR",
    "apr_one_failed": "APR if the most needed unit fails",
    "smallest_margin_s": "smallest time to spare (s)",
    "mean_margin_s": "mean time to spare (s)",
    "cost_eur": "cost (EUR)",
}


def read_front(record: FrontRecord) -> Front:
    """A front from its record, without the rows of the detection table."""
    return Front(
        by=record.by,
        points=tuple(_read_point(point) for point in record.points),
        stages=record.optimised,
        settled=record.settled,
        refused=tuple((entry.units, entry.reason) for entry in record.refused),
        presolve=None,
    )


def _read_point(point: FrontPointRecord) -> FrontPoint:
    return FrontPoint(
        units=point.units,
        pose_index=tuple(range(len(point.pose_ids))),
        value=PlacementValue(*(getattr(point, name) for name in _VALUES)),
        certificate=Certificate(
            stages=tuple(
                Stage(
                    name=stage.name,
                    objective=stage.objective,
                    bound=_known(stage.bound),
                    gap=_known(stage.gap),
                    seconds=stage.seconds,
                )
                for stage in point.stages
            ),
            solver=point.solver,
        ),
    )


def _known(value: float | None) -> float:
    """JSON has no infinity: it writes null."""
    return math.inf if value is None else value


def front_rows(front: Front) -> list[list[str]]:
    """A row for each point: what its layout is worth, and whether more is ruled out.

    Units; the fields of :class:`placement.optimiser.PlacementValue`; the proof.
    """
    return [
        [
            str(point.units),
            *(_shown(name, getattr(point.value, name)) for name in _VALUES),
            _proof(point, front),
        ]
        for point in front.points
    ]


def _shown(name: str, value: float) -> str:
    if name in _SHARES:
        return percent(value)
    return f"{value:,.0f}" if name == "cost_eur" else number(value, 3)


def _proof(point: FrontPoint, front: Front) -> str:
    if point.is_proven:
        return "proven"
    stage = next(stage for stage in point.certificate.stages if stage.gap != 0.0)
    what = _COLUMNS.get(stage.name, stage.name)
    if not math.isfinite(stage.bound):
        return f"open: nothing is proven of the {what}"
    more = "less" if stage.name == "cost_eur" else "more"
    bound = f"{100.0 * stage.bound:.2f} %" if stage.name in _SHARES else number(stage.bound, 3)
    return f"open: {what} no {more} than {bound}"


def proof_sentences(front: Front) -> list[str]:
    """What is proven of a front, and what is not."""
    n_points, n_proven = len(front.points), sum(point.is_proven for point in front.points)
    objectives = (
        "in APR, then in what is left when the most needed unit fails, then in time to spare and "
        "cost"
        if front.stages == "all"
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


def front_section(record: FrontRecord | UnsetType) -> Section | None:
    """What each unit buys; None where the best was not what was asked for."""
    if not record:
        return None
    front = read_front(record)
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
            for point in record.points
        ],
        summary="Which poses",
    )
    proof += (
        " Each number of units has the best layout of its own; the units of one are not always "
        "among those of the next."
    )
    blocks: list[Block] = [Bullets(record.sentences), picture, table, proof, poses]
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
    """What each further unit buys.

    A sentence for the first point, one for each that differs from the one before, one for what
    follows; such as "The second unit adds no APR; the layout then survives any single failure."
    `n_kept` units hang there already, and count. `pole_failed` gives the APR that is left of a
    point when the worst pole fails with all its units; without it only units are told of.
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
    """What more money buys: a sentence for every point, and one for what follows."""
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
        who = f"The {number} that hang there reach" if number > 1 else "What hangs there reaches"
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
    """What one point has that the one before has not, as verbs and objects; empty if nothing."""
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
    """What may fail of a layout that loses nothing with any one unit: poles carry several."""
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
    """What is not proven of a point, in brackets."""
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
