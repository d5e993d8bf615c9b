"""The first screen of a report: one sentence, four figures, and where it is still dangerous."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from geometry.arrays import BoolArray
from geometry.scene import Scene
from placement.candidates import above_ground
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.weights import weight_share

from ..figures.axes import unit_labels
from ..figures.plan import looking_words
from ..results.numbers import NOTHING, euros, joined, number, percent, points
from .accidents import case_title, count_sensors, is_weighted
from .answer import is_proven, lead
from .bill_of_materials import BillOfMaterials
from .dangers import DangerGroup, avoided_runs, position_words
from .explanation import causes_and_remedies
from .result import PlacementResult, Result
from .section import Picture

_MOST_DANGERS, _MOST_UNITS = 3, 6
_BEST = {
    "best": "does better",
    "fewest": "reaches what was asked for with fewer sensors",
    "cheapest": "reaches what was asked for with less money",
}


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
    units: tuple[str, ...]  # what is mounted where, if they are few
    cards: tuple[Card, ...]
    dangers: tuple[str, ...]
    plan: Picture
    views: tuple[Picture, ...]  # of each camera, if they are few


def build_first_screen(
    result: Result,
    setting: Setting,
    subject: Evaluation,
    *,
    bill: BillOfMaterials,
    plan: Picture,
    views: Sequence[Picture] = (),
    warnings: Sequence[str] = (),
) -> FirstScreen:
    """The first screen of a result; `warnings` stand between its sentence and its figures."""
    avoided = avoided_runs(subject, result.fusion)
    first = (_prevented(subject, avoided), _if_one_fails(result, subject))
    return FirstScreen(
        sentence=lead(result),
        warnings=tuple(warnings),
        units=_mounted(result, subject, setting.scene),
        cards=(*first, _cost(bill, subject), _proof(result)),
        dangers=tuple(_dangers(result, setting)),
        plan=plan,
        views=tuple(views),
    )


def _mounted(result: Result, subject: Evaluation, scene: Scene) -> tuple[str, ...]:
    """Where each unit is mounted and looks, if they are few."""
    units, labels = subject.layout.units, unit_labels(subject.layout)
    if len(units) > _MOST_UNITS:
        return ()
    found = []
    for unit, record in zip(units, result.layout, strict=True):
        where = " ".join(filter(None, (record.kind, record.site))) or "a mount of its own"
        height_m = float(above_ground(unit, scene).pose.position_m[2])
        parts = (where, record.place, f"{number(height_m, 1)} m high", looking_words(unit))
        found.append(f"{labels[unit.id]}: {', '.join(filter(None, parts))}.")
    return tuple(found)


def _prevented(subject: Evaluation, avoided: BoolArray) -> Card:
    axis = subject.axis
    n_avoided, n_runs = int(avoided.sum()), axis.n_runs
    words = f"of the simulated collisions: {n_avoided} of {n_runs}"
    if is_weighted(axis):
        words += (
            f". Counted one by one that is {percent(n_avoided / n_runs)}; shares on this page are "
            "by weight, as kinds of collisions differ in number"
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
    tried = f"among {result.candidates:,} possible mountings (by a simpler model, for planning)"
    if is_proven(result):
        words = f"no other choice {_BEST[result.goal]} {tried}"
        if result.highest is not None:
            words = (
                f"of all choices that prevent nearly as much as can be (up to "
                f"{points(result.highest.given_up)} less), none keeps more when a sensor fails, "
                f"{tried}"
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
        return ["All simulated collisions are prevented."]
    cases = {run.case.name: run.case for run in setting.runs}
    titles = {name: case_title(case) for name, case in cases.items()}
    worst = [group for group in dangers.by_case[:_MOST_DANGERS] if group.not_avoided]
    found = [f"{titles.get(one.name, one.name)}: {_left(one)}." for one in worst]
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
    return f"{group.not_avoided} of {group.runs} not prevented"
