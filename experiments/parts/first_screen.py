"""The first screen of a report: one sentence, four figures, and where it is still dangerous."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.weights import weight_share

from ..results.numbers import NOTHING, euros, joined, percent, points, several
from .accidents import count_sensors, is_weighted
from .bill_of_materials import BillOfMaterials
from .dangers import DangerGroup, avoided_runs, position_words
from .explanation import causes_and_remedies
from .result import PlacementResult, Result
from .section import Picture

_MOST_DANGERS = 3
_BEST = {
    "best": "does better",
    "fewest": "reaches what was asked for with fewer sensors",
    "cheapest": "reaches what was asked for with less money",
}
_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


class Card(NamedTuple):
    """A figure with what it means."""

    head: str
    figure: str
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstScreen:
    """What somebody reads who reads nothing else: without codes, and without abbreviations."""

    sentence: str
    warnings: tuple[str, ...]  # what must not be overlooked
    cards: tuple[Card, ...]
    dangers: tuple[str, ...]
    plan: Picture


def build_first_screen(
    result: Result,
    setting: Setting,
    subject: Evaluation,
    *,
    bill: BillOfMaterials,
    plan: Picture,
    warnings: Sequence[str] = (),
) -> FirstScreen:
    """The first screen of a result; `warnings` stand between its sentence and its figures."""
    avoided = avoided_runs(subject, result.fusion)
    first = (_prevented(subject, avoided), _if_one_fails(result, subject))
    return FirstScreen(
        sentence=_sentence(result, subject, avoided),
        warnings=tuple(warnings),
        cards=(*first, _cost(bill, subject), _proof(result)),
        dangers=tuple(_dangers(result, setting)),
        plan=plan,
    )


def _sentence(result: Result, subject: Evaluation, avoided: BoolArray) -> str:
    """What the layout prevents, and what cars prevent by themselves."""
    axis = subject.axis
    masks = (avoided, subject.vut.is_avoided, subject.vut_and_rsus.is_avoided)
    share, own, together = (percent(weight_share(mask, axis.weight)) for mask in masks)
    n_poles = len({unit.site_id or unit.id for unit in subject.layout.units})
    units = _spelled(count_sensors(subject.layout))
    mounted = f"{_capital(units)} on {_spelled(several(n_poles, 'pole', 'poles'))}"
    verb = "prevents" if len(subject.layout.units) == 1 else "prevent"
    seeing = " together with cars that see for themselves" if result.cars == 1.0 else ""
    is_best = (
        isinstance(result, PlacementResult)
        and (result.sampled, result.goal, result.stages[0].name) == (None, "best", "apr")
        and _is_proven(result)
    )
    best = ", and no other choice prevents more" if is_best else ""
    also = "" if result.cars == 1.0 else f", and {together} if they hear what the sensors see"
    if isinstance(result, PlacementResult) and result.highest and result.highest.compared:
        other = result.highest.compared.evaluation
        most = "any choice prevents" if result.highest.stages[0].gap == 0.0 else "was found"
        best = (
            f", and {percent(result.evaluation.apr_without_worst_unit)} if one of them fails; "
            f"the most that {most} is {percent(other.judged.all)}, but then "
            f"{percent(other.apr_without_worst_unit)} if one fails"
        )
    return (
        f"{mounted}{seeing} {verb} {share} of the collisions that were tried{best}. Cars by "
        f"themselves prevent {own}{also}."
    )


def _is_proven(result: PlacementResult) -> bool:
    """True if the first objective is, and the highest share that might be given up of."""
    first = [result.stages[0], *(result.highest.stages[:1] if result.highest else ())]
    return all(stage.gap == 0.0 for stage in first)


def _spelled(text: str) -> str:
    """A count with its noun, small numbers as words."""
    count, _, noun = text.partition(" ")
    is_small = count.isdigit() and int(count) < len(_SMALL)
    return f"{_SMALL[int(count)]} {noun}" if is_small else text


def _prevented(subject: Evaluation, avoided: BoolArray) -> Card:
    axis = subject.axis
    n_avoided, n_runs = int(avoided.sum()), axis.n_runs
    words = f"of the collisions that were tried: {n_avoided} of {n_runs}"
    if is_weighted(axis):
        words += (
            f". That would be {percent(n_avoided / n_runs)}, but some count more than others: "
            "all shares here are by weight"
        )
    return Card("Prevented", percent(weight_share(avoided, axis.weight)), words)


def _if_one_fails(result: Result, subject: Evaluation) -> Card:
    left = result.evaluation.apr_without_worst_unit
    words = "are prevented even if the sensor that is needed most is out of order"
    if len(subject.units) == 1 and result.cars < 1.0:
        left, words = None, "there is but one: if it fails, only the car itself is left"
    return Card("If a sensor fails", percent(left), words)


def _cost(bill: BillOfMaterials, subject: Evaluation) -> Card:
    sites = bill.sites_eur
    sensors = [item.sum_eur for item in bill.sensors]
    known = [amount for amount in sensors if amount is not None]
    total = None if sites is None or len(known) < len(sensors) else sum(known) + sites
    words = f"to buy {count_sensors(subject.layout)} and to make their poles ready"
    if bill.assumed:
        words += "; prices of poles are assumed"
    return Card("Cost", euros(total), words)


def _proof(result: Result) -> Card:
    if not isinstance(result, PlacementResult):
        words = "this layout was given, and not searched for"
        return Card(head="Proof", figure=NOTHING, words=words)
    tried = f"among {result.candidates:,} possible mountings (by the planning model)"
    if _is_proven(result):
        words = f"no other choice {_BEST[result.goal]} {tried}"
        if result.highest is not None:
            words = (
                f"no other choice keeps more if a sensor fails, unless it prevents over "
                f"{points(result.highest.given_up)} less than the most that can be {tried}"
            )
        return Card(head="Proof", figure="proven best", words=words)
    if result.bound is None:
        return Card(head="Proof", figure="none", words=f"the best that was found {tried}")
    words = f"is the most that any choice could prevent {tried}; it is not proven to be reached"
    return Card(head="Proof", figure=percent(result.bound), words=words)


def _dangers(result: Result, setting: Setting) -> list[str]:
    """Who is still at risk, where, why, and what would help: a sentence each."""
    dangers = result.dangers
    if not dangers.not_avoided:
        return ["Of the collisions that were tried, none is left."]
    cases = {run.case.name: run.case for run in setting.runs}
    titles = {name: case.title.replace("VUT", "car") or name for name, case in cases.items()}
    worst = [group for group in dangers.by_case[:_MOST_DANGERS] if group.not_avoided]
    found = [f"{_capital(titles.get(one.name, one.name))}: {_left(one)}." for one in worst]
    where = [group for group in dangers.by_position[:2] if group.not_avoided]
    if where:
        told = joined([f"{position_words(group.name)} ({_left(group)})" for group in where])
        found.append(f"Most of it happens {told}.")
    if isinstance(result, PlacementResult):
        found += causes_and_remedies(result.explained.not_avoided)[:1]
        if result.next_unit is not None:
            more = points(result.next_unit.gain)
            found.append(f"One more sensor would prevent {more} more (by the planning model).")
    return found


def _left(group: DangerGroup) -> str:
    return f"{group.not_avoided} of {group.runs} left"


def _capital(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"
