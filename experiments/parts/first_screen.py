"""The first screen of a report: sentences, figures, and where it is dangerous."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from geometry.arrays import BoolArray
from geometry.scene import Scene
from placement.candidates import above_ground
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.runs import FrameAxis
from scenarios.weights import weight_share

from ..figures.axes import unit_labels
from ..figures.outlines import looking_words
from ..language import mark, tr
from ..results.numbers import NOTHING, euros, joined, number, percent, points
from .accidents import case_title, is_weighted
from .bill_of_materials import BillOfMaterials, left_out_sentence, to_buy, total_eur
from .dangers import DangerGroup, avoided_runs, position_words
from .explanation import causes_and_remedies
from .headline import by_unit, headline, own_sensors
from .proof import best_possible
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

    # The first one says what is prevented, and what is left if a sensor fails.
    sentences: tuple[str, ...]
    # What must not be overlooked.
    warnings: tuple[str, ...]
    # What is mounted where, if they are few.
    units: tuple[str, ...]
    # Of each kind of cars.
    cars: tuple[Card, ...]
    # If a sensor fails, cost, proof.
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

    `warnings` stand between its sentences and its figures.
    """
    return FirstScreen(
        sentences=(*headline(result), *_most_at_risk(result)),
        warnings=tuple(warnings),
        units=_mounted(result, subject, setting.scene),
        cars=tuple(_for_cars(result, subject)),
        cards=(_if_one_fails(result, subject), _cost(bill), _proof(result)),
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
        words = ", ".join(filter(None, parts))
        if record.id in result.existing:
            words = tr("{where}; it is mounted already", where=words)
        found.append(f"{labels[unit.id]}: {words}.")
    return tuple(found)


def _for_cars(result: Result, subject: Evaluation) -> list[Card]:
    """What is prevented for each kind of cars, and what each unit adds for them."""
    found = result.evaluation
    axis = subject.axis
    added = result.added
    avoided = avoided_runs(subject, result.fusion)
    if result.cars:
        avoided = subject.rsu_all.is_avoided
    words = [tr("of the simulated collisions.")]
    units = by_unit(added.alone if added else ())
    if units:
        words.append(f"{units}.")
    words.append(_counted(avoided, axis))
    share = percent(weight_share(avoided, axis.weight))
    # Both kinds of cars have a card of the same size: neither figure hides the other.
    cards = [Card(tr("Cars that rely on the roadside alone"), share, " ".join(words))]
    own = own_sensors(result)
    if not own:
        return cards
    words = [
        tr(
            "of the simulated collisions; {alone} without the roadside.",
            alone=percent(found.vut.all),
        )
    ]
    units = by_unit(added.units if added else ())
    if units:
        words.append(f"{units}.")
    share = percent(found.vut_and_rsus.all)
    cards.append(Card(tr("Cars with {own}", own=own), share, " ".join(words)))
    return cards


def _counted(avoided: BoolArray, axis: FrameAxis) -> str:
    """How many runs that is, where not all count the same."""
    n_avoided = int(avoided.sum())
    if not is_weighted(axis):
        return tr("{n} of {all} runs.", n=n_avoided, all=axis.n_runs)
    return tr(
        "All shares on this page are weighted; without weights, {n} of {all} are"
        " prevented ({share}).",
        n=n_avoided,
        all=axis.n_runs,
        share=percent(n_avoided / axis.n_runs),
    )


def _if_one_fails(result: Result, subject: Evaluation) -> Card:
    left = result.evaluation.apr_without_worst_unit
    words = tr("are still prevented if the most important sensor fails")
    if len(subject.units) == 1 and result.cars < 1.0:
        left = None
        words = tr("there is only one sensor: if it fails, only the car itself remains")
    return Card(tr("If a sensor fails"), percent(left), words)


def _cost(bill: BillOfMaterials) -> Card:
    """What there is to buy, and what is not in the sum."""
    total = total_eur((*bill.sensors, *bill.sites))
    words = [tr("for {things}.", things=to_buy(bill))]
    if bill.assumed:
        words.append(tr("Prices of poles are assumed."))
    words.append(left_out_sentence())
    return Card(tr("Cost"), euros(total), " ".join(words))


_NO_OTHER = {
    "best": mark("no other choice does better {tried}"),
    "fewest": mark("no other choice meets the target with fewer sensors {tried}"),
    "cheapest": mark("no other choice meets the target for less money {tried}"),
}


def _proof(result: Result) -> Card:
    if not isinstance(result, PlacementResult):
        return Card(tr("Proof"), NOTHING, tr("this layout was given, not optimised"))
    tried = tr(
        "among {n:,} possible mountings (in the simpler planning model)",
        n=result.candidates,
    )
    better = best_possible(result)
    if better is None:
        return Card(
            tr("Proof"), tr("none"), tr("the best choice found {tried}", tried=tried)
        )
    if better > 0.0:
        figure = tr("at most {points}", points=points(better))
        words = tr(
            "could be gained by a better choice {tried}; whether one exists is not"
            " proven",
            tried=tried,
        )
        return Card(tr("Proof"), figure, words)
    if result.highest is None:
        words = tr(_NO_OTHER[result.goal], tried=tried)
        return Card(tr("Proof"), tr("proven best"), words)
    words = tr(
        "of all choices within {points} of the maximum, none prevents more when a"
        " sensor fails, {tried}",
        points=points(result.highest.given_up),
        tried=tried,
    )
    return Card(tr("Proof"), tr("proven"), words)


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
        found.append(tr("Most of these collisions happen {places}.", places=places))
    if isinstance(result, PlacementResult):
        found += causes_and_remedies(result.explained.not_avoided)[:1]
        if result.next_unit is not None:
            more = points(result.next_unit.gain)
            found.append(
                tr(
                    "One more sensor prevents {more} more in the planning model.",
                    more=more,
                )
            )
    return found


def _most_at_risk(result: Result) -> list[str]:
    """The case of which most is not prevented, in a sentence; or nothing."""
    worst = [group for group in result.dangers.by_case[:1] if group.not_avoided]
    return [
        tr(
            "Most at risk: {what} ({left}).",
            what=group.title or group.name,
            left=_left(group),
        )
        for group in worst
    ]


def _left(group: DangerGroup) -> str:
    return tr("{n} of {all} not prevented", n=group.not_avoided, all=group.runs)
