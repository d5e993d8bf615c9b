"""What each further unit, or more money, buys: in plain sentences, from a front of layouts."""

from collections.abc import Sequence
from itertools import pairwise

from placement.optimiser.front import Front, FrontPoint
from placement.optimiser.limits import COST_TOLERANCE_EUR
from placement.optimiser.problem import TOLERANCE

from .tables import percent

_ORDINALS = (
    *("zeroth", "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth"),
    *("ninth", "tenth", "eleventh", "twelfth"),
)


def describe_units(front: Front, *, n_kept: int = 0) -> list[str]:
    """What each further unit buys.

    Parameters
    ----------
    front : Front
        By units.
    n_kept : int
        Units that hang there already, and count.

    Returns
    -------
    sentences : list of str
        One for the first point, one for each that differs from the one before, one for what
        follows.

    Examples
    --------
    Of the default question: "The first unit reaches an APR of 100.0 %.", "The second unit adds no
    APR; the layout then survives any single failure.", "From K = 2 on nothing grows, ..".
    """
    points = front.points
    sentences = [_first_units(points[0], n_kept)]
    idle: list[int] = []
    for before, point in pairwise(points):
        if front.settled is not None and point.units > front.settled:
            break
        bought = _bought(before, point, front)
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


def describe_money(front: Front) -> list[str]:
    """What more money buys.

    Parameters
    ----------
    front : Front
        By cost.

    Returns
    -------
    sentences : list of str
        One for every point, and one for what follows.
    """
    first = front.points[0]
    sentences = [
        f"{_euros(first.value.cost_eur)} buy an APR of {percent(first.value.apr)}"
        f"{_left(first)}{_doubt(first, front)}."
    ]
    for before, point in pairwise(front.points):
        more = point.value.cost_eur - before.value.cost_eur
        verbs = _bought(before, point, front, many=True)
        sentences.append(
            f"{_euros(more)} more ({_euros(point.value.cost_eur)} in all) {verbs}"
            f"{_doubt(point, front)}."
        )
    if front.settled is not None:
        sentences.append(_nothing_grows(front, f"Beyond {_euros(front.settled)} nothing grows"))
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


def _bought(before: FrontPoint, point: FrontPoint, front: Front, *, many: bool = False) -> str:
    """What one point has that the one before has not, as verbs and objects; empty if nothing."""
    old, new = before.value, point.value
    s = "" if many else "s"
    clauses = []
    gain = new.apr - old.apr
    if gain > TOLERANCE:
        clauses.append(f"add{s} {100.0 * gain:.1f} points of APR ({percent(new.apr)})")
    kept = new.apr_one_failed - old.apr_one_failed
    if kept > TOLERANCE and new.apr_one_failed >= new.apr - TOLERANCE:
        clauses.append("the layout then survives any single failure")
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
    return [f"save{s} {_euros(saved)}"] if is_same and saved > COST_TOLERANCE_EUR else []


def _doubt(point: FrontPoint, front: Front) -> str:
    """What is not proven of a point, in brackets."""
    for stage in point.certificate.stages:
        if stage.gap == 0.0:
            continue
        if stage.name == "cost_eur":
            if front.by == "cost":
                return f" (proven is only: not for less than {_euros(stage.bound)})"
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


def _euros(amount: float) -> str:
    return f"{amount:,.0f} EUR"


def _seconds(time_s: float) -> str:
    return f"{time_s:.2f} s" if time_s >= 0.01 else f"{time_s:.1g} s"
