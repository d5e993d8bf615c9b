"""The first screen of a report.

One sentence, four figures, and where it is still dangerous.
"""

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
from ..language import mark, tr
from ..results.numbers import NOTHING, euros, joined, number, percent, points
from .accidents import case_title, count_sensors, is_weighted
from .answer import is_proven, lead
from .bill_of_materials import BillOfMaterials, total_eur
from .dangers import DangerGroup, avoided_runs, position_words
from .explanation import causes_and_remedies
from .result import PlacementResult, Result
from .section import Picture

_MOST_DANGERS = 3
_MOST_UNITS = 6


class Card(NamedTuple):
    """A figure with what it means."""

    head: str
    figure: str
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstScreen:
    """What somebody reads who reads nothing else.

    Without codes, and without abbreviations.
    """

    sentence: str
    # What must not be overlooked.
    warnings: tuple[str, ...]
    # What is mounted where, if they are few.
    units: tuple[str, ...]
    cards: tuple[Card, ...]
    dangers: tuple[str, ...]
    plan: Picture
    # Of each camera, if they are few.
    views: tuple[Picture, ...]


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
    """The first screen of a result.

    `warnings` stand between its sentence and its figures.
    """
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
    units = subject.layout.units
    labels = unit_labels(subject.layout)
    if len(units) > _MOST_UNITS:
        return ()
    found = []
    for unit, record in zip(units, result.layout, strict=True):
        names = (record.kind and tr(record.kind), record.site)
        where = " ".join(filter(None, names)) or tr("a mount of its own")
        height_m = float(above_ground(unit, scene).pose.position_m[2])
        height = tr("{height} m high", height=number(height_m, 1))
        parts = (where, record.place and tr(record.place), height, looking_words(unit))
        found.append(f"{labels[unit.id]}: {', '.join(filter(None, parts))}.")
    return tuple(found)


def _prevented(subject: Evaluation, avoided: BoolArray) -> Card:
    axis = subject.axis
    n_avoided = int(avoided.sum())
    n_runs = axis.n_runs
    words = tr("of the simulated collisions: {n} of {all}", n=n_avoided, all=n_runs)
    if is_weighted(axis):
        words = tr(
            "of the simulated collisions, when each kind of them counts by "
            "its weight, as all shares on this page do. Counted one by one, "
            "{n} of {all} are prevented, {share}: some kinds were simulated "
            "more often than others",
            n=n_avoided,
            all=n_runs,
            share=percent(n_avoided / n_runs),
        )
    return Card(tr("Prevented"), percent(weight_share(avoided, axis.weight)), words)


def _if_one_fails(result: Result, subject: Evaluation) -> Card:
    left = result.evaluation.apr_without_worst_unit
    words = tr("are prevented even if the sensor that is needed most is out of order")
    if len(subject.units) == 1 and result.cars < 1.0:
        left = None
        words = tr("there is but one: if it fails, only the car itself is left")
    return Card(tr("If a sensor fails"), percent(left), words)


def _cost(bill: BillOfMaterials, subject: Evaluation) -> Card:
    total = total_eur((*bill.sensors, *bill.sites))
    counted = count_sensors(subject.layout)
    words = tr("to buy {sensors} and to make their poles ready", sensors=counted)
    if bill.assumed:
        words = tr(
            "to buy {sensors} and to make their poles ready; prices of poles are"
            " assumed",
            sensors=counted,
        )
    return Card(tr("Cost"), euros(total), words)


_NO_OTHER = {
    "best": mark("no other choice does better {tried}"),
    "fewest": mark(
        "no other choice reaches what was asked for with fewer sensors {tried}"
    ),
    "cheapest": mark(
        "no other choice reaches what was asked for with less money {tried}"
    ),
}


def _proof(result: Result) -> Card:
    if not isinstance(result, PlacementResult):
        return Card(
            tr("Proof"), NOTHING, tr("this layout was given, and not searched for")
        )
    tried = tr(
        "among {n:,} possible mountings (by a simpler model, for planning)",
        n=result.candidates,
    )
    if is_proven(result):
        if result.highest is None:
            return Card(
                tr("Proof"), tr("proven best"), tr(_NO_OTHER[result.goal], tried=tried)
            )
        given_up = points(result.highest.given_up)
        words = tr(
            "of all choices that prevent nearly as much as can be (up to "
            "{points} less, given up on purpose), none keeps more when a "
            "sensor fails, {tried}",
            points=given_up,
            tried=tried,
        )
        return Card(tr("Proof"), tr("proven"), words)
    if result.bound is None:
        return Card(
            tr("Proof"), tr("none"), tr("the best that was found {tried}", tried=tried)
        )
    words = tr(
        "is the most that any choice could prevent {tried}; it is not proven to be"
        " reached",
        tried=tried,
    )
    return Card(tr("Proof"), percent(result.bound), words)


def _dangers(result: Result, setting: Setting) -> list[str]:
    """Who is still at risk, where, why, and what would help: a sentence each."""
    dangers = result.dangers
    if not dangers.not_avoided:
        return [tr("All simulated collisions are prevented.")]
    cases = {run.case.name: run.case for run in setting.runs}
    titles = {name: case_title(case) for name, case in cases.items()}
    worst = [group for group in dangers.by_case[:_MOST_DANGERS] if group.not_avoided]
    found = [f"{titles.get(one.name, one.name)}: {_left(one)}." for one in worst]
    where = [group for group in dangers.by_position[:2] if group.not_avoided]
    if where:
        places = joined(
            [f"{position_words(group.name)} ({_left(group)})" for group in where]
        )
        found.append(tr("Most of it happens {places}.", places=places))
    if isinstance(result, PlacementResult):
        found += causes_and_remedies(result.explained.not_avoided)[:1]
        if result.next_unit is not None:
            more = points(result.next_unit.gain)
            found.append(
                tr(
                    "One more sensor would prevent {more} more (by the planning"
                    " model).",
                    more=more,
                )
            )
    return found


def _left(group: DangerGroup) -> str:
    return tr("{n} of {all} not prevented", n=group.not_avoided, all=group.runs)
