"""The first sentences of an answer: what the sensors prevent, and for which cars.

Every figure here is the evaluator's. The planning model's are told with the proof.
"""

from collections.abc import Iterator, Sequence

from placement.question import BASELINE_NAME

from ..language import mark, tr, trn
from ..results.numbers import in_points, joined, layout_words, percent, points
from ..results.record import EvaluationRecord
from .added import AddedUnit
from .proof import is_proven
from .result import PlacementResult, Result

_LITTLE = 0.01
"""Units that add less together are named: they buy next to nothing. [share]"""
_MOST_LESS = 0.03
_LEAST_MORE = 0.10
"""Another layout is offered that prevents at most so much less, and keeps at least so
much more when a sensor fails. [share]
"""
_MOST_NAMED = 4
_OWN = {
    ("camera",): mark("their own camera"),
    ("lidar",): mark("their own LiDAR"),
    ("camera", "lidar"): mark("their own camera and LiDAR"),
}
"""What cars have on board, by the names of their sensors."""


def headline(result: Result) -> list[str]:
    """The first sentences: what is prevented for both kinds of cars, and at what risk.

    The first one always says what is left if a sensor fails.
    """
    return [
        *_prevented(result),
        *_given_up(result),
        *_keeps_more(result),
        tr("This holds for cars that have a receiver and brake by themselves."),
    ]


def own_sensors(result: Result) -> str:
    """What cars have on board: "their own camera"; empty if nothing."""
    names = tuple(sorted(result.vut_sensors))
    if names not in _OWN:
        return ""
    return tr(_OWN[names])


def _prevented(result: Result) -> Iterator[str]:
    """What the units prevent: for the cars asked about first, then for the others."""
    own = own_sensors(result)
    seeing = _with_own_sensors(result, own)
    # The cars that were asked about come first.
    if result.cars == 1.0:
        yield _prevents(result, tr("For cars with {own}", own=own))
        yield seeing
        yield tr(
            "For cars that rely on the roadside alone, they prevent {share}.",
            share=percent(result.evaluation.rsu_all.all),
        )
    elif result.cars > 0.0:
        share = percent(result.cars)
        cars = tr("Where {share} of the cars have {own}", share=share, own=own)
        yield _prevents(result, cars)
        yield seeing
    else:
        added = result.added.alone if result.added else ()
        cars = tr("For cars that rely on the roadside alone")
        yield _prevents(result, cars)
        units = by_unit(added)
        if units:
            yield tr("Mounted one by one: {units}.", units=units)
        if own:
            yield seeing
    if own and result.cars < 1.0:
        yield from _little_for_seeing(result)


def _prevents(result: Result, cars: str) -> str:
    """Share prevented for some cars, and what is left if a unit fails."""
    n_units = len(result.layout)
    values = {
        "cars": cars,
        "mounted": _mounted(result),
        "share": _share_words(result),
        "left": percent(result.evaluation.apr_without_worst_unit),
    }
    # Nothing is left of a single unit; cars with their own camera still have that.
    if n_units == 1 and result.cars == 0.0:
        return tr(
            "{cars}, {mounted} prevents {share}, and none if this sensor fails.",
            **values,
        )
    return trn(
        "{cars}, {mounted} prevents {share}, and {left} if it fails.",
        "{cars}, {mounted} prevent {share}, and {left} if one sensor fails.",
        n_units,
        **values,
    )


def _share_words(result: Result) -> str:
    """Share of the simulated collisions, and how many runs that is.

    With fusion "single" runs are counted: a unit has to confirm by itself.
    """
    share = result.evaluation.judged.all
    n_avoided = result.runs - result.dangers.not_avoided
    counted = {"n": n_avoided, "all": result.runs}
    # With one unit that must confirm alone, no weighted share is defined.
    if result.fusion == "single":
        return tr("{n} of {all} simulated collisions", **counted)
    if 0.0 < result.cars < 1.0:
        return tr("{share} of the simulated collisions", share=percent(share))
    if result.is_weighted:
        return tr(
            "{share} of the simulated collisions by weight ({n} of {all} runs)",
            share=percent(share),
            **counted,
        )
    return tr(
        "{share} of the simulated collisions ({n} of {all} runs)",
        share=percent(share),
        **counted,
    )


def _with_own_sensors(result: Result, own: str) -> str:
    """What cars prevent alone and with the units, and what each unit adds."""
    found = result.evaluation
    units = by_unit(result.added.units if result.added else ())
    return trn(
        "For cars with {own}, it raises the share from {alone} to {both}{units}.",
        "For cars with {own}, they raise the share from {alone} to {both}{units}.",
        len(result.layout),
        own=own,
        alone=percent(found.vut.all),
        both=percent(found.vut_and_rsus.all),
        units=f": {units}" if units else "",
    )


def by_unit(units: Sequence[AddedUnit]) -> str:
    """What each unit adds, the most useful first: "U1 adds 22.4 points, U2 0.5".

    Empty for fewer than two.
    """
    if len(units) < 2:
        return ""
    first, *rest = units
    named = rest[: _MOST_NAMED - 1]
    others = rest[_MOST_NAMED - 1 :]
    words = [tr("{unit} adds {gain}", unit=first.unit, gain=points(first.gain))]
    words += [f"{one.unit} {in_points(one.gain)}" for one in named]
    if others:
        gain = sum(one.gain for one in others)
        words.append(tr("the other {n} {gain}", n=len(others), gain=in_points(gain)))
    return ", ".join(words)


def _little_for_seeing(result: Result) -> Iterator[str]:
    """Units that add next to nothing for cars that see, and the question to ask."""
    units = result.added.units if result.added else ()
    little: list[AddedUnit] = []
    # From the least useful unit on, as long as all together add next to nothing.
    for unit in reversed(units):
        if sum(one.gain for one in little) + unit.gain >= _LITTLE:
            break
        little.insert(0, unit)
    if not little or len(units) < 2:
        return
    yield trn(
        "For these cars, {units} adds less than 1 point: --cars see looks for sensors"
        " that help them.",
        "For these cars, {units} together add less than 1 point: --cars see looks for"
        " sensors that help them.",
        len(little),
        units=joined([one.unit for one in little]),
    )


def _given_up(result: Result) -> Iterator[str]:
    """What the choice with the highest planned APR prevents, where it is another one.

    Nothing where the evaluator prefers the layout found in both respects.
    """
    if not isinstance(result, PlacementResult) or result.sampled is not None:
        return
    highest = result.highest
    if highest is None or highest.compared is None:
        is_best = result.goal == "best" and result.stages[0].name == "apr"
        if is_best and is_proven(result):
            yield tr("In the planning model no other choice prevents more: proven.")
        return
    # The evaluator may see no gain where the planning model does.
    other = highest.compared.evaluation
    if (other.judged.all or 0.0) <= (result.evaluation.judged.all or 0.0):
        return
    yield tr(
        "Another layout prevents {most}, but only {left} if one sensor fails; this one"
        " gives up at most {given_up} to keep more (--give-up 0 gives up nothing).",
        most=percent(other.judged.all),
        left=percent(other.apr_without_worst_unit),
        given_up=points(highest.given_up),
    )


def _keeps_more(result: Result) -> Iterator[str]:
    """A layout that prevents little less and keeps much more when a sensor fails.

    And what cheaper sites would give.
    """
    if not isinstance(result, PlacementResult) or result.fusion == "single":
        return
    n_units = len(result.layout)
    found = result.evaluation
    best_name = ""
    # Only a layout that keeps much more is worth a sentence, of those the best one.
    best_left = (found.apr_without_worst_unit or 0.0) + _LEAST_MORE
    best_apr = 0.0
    for name, n_others, apr, left in _others(result):
        is_near = apr >= (found.judged.all or 0.0) - _MOST_LESS
        if n_others <= n_units and is_near and left >= best_left:
            best_name = name
            best_apr = apr
            best_left = left
    if best_name:
        yield tr(
            "Consider {name}: {apr}, and {left} if one sensor fails.",
            name=best_name,
            apr=percent(best_apr),
            left=percent(best_left),
        )
    if result.cheaper:
        yield result.cheaper


def _others(result: PlacementResult) -> Iterator[tuple[str, int, float, float]]:
    """Other layouts by the evaluator: name, units, APR, APR if one unit fails."""

    def of(name: str, n: int, one: EvaluationRecord) -> tuple[str, int, float, float]:
        return name, n, one.judged.all or 0.0, one.apr_without_worst_unit or 0.0

    greedy = result.greedy
    yield of(tr("the greedy layout"), len(greedy.layout), greedy.evaluation)
    if result.baseline is not None:
        name = layout_words(BASELINE_NAME)
        yield of(name, len(result.baseline.layout), result.baseline.evaluation)
    expert = result.baselines.expert
    if expert is not None:
        name = tr("the expert rule's layout")
        apr = expert.score.all or 0.0
        yield name, len(expert.layout), apr, expert.apr_without_worst_unit or 0.0


def _mounted(result: Result) -> str:
    """How many units on how many poles, small numbers as words."""
    n_lidars = sum(bool(unit.lidar) for unit in result.layout)
    n_cameras = len(result.layout) - n_lidars
    n_poles = len({unit.site or unit.id for unit in result.layout})
    cameras = trn("one camera", "{count} cameras", n_cameras, count=_spelled(n_cameras))
    lidars = trn("one LiDAR", "{count} LiDARs", n_lidars, count=_spelled(n_lidars))
    units = [words for n, words in ((n_cameras, cameras), (n_lidars, lidars)) if n]
    poles = trn("one pole", "{count} poles", n_poles, count=_spelled(n_poles))
    sensors = joined(units)
    n_existing = len(result.existing)
    if n_existing:
        sensors = tr("{units} ({n} exist)", units=sensors, n=_spelled(n_existing))
    return tr("{units} on {poles}", units=sensors, poles=poles)


def _spelled(count: int) -> str:
    words = [
        tr("no"),
        tr("one"),
        tr("two"),
        tr("three"),
        tr("four"),
        tr("five"),
        tr("six"),
        tr("seven"),
        tr("eight"),
        tr("nine"),
        tr("ten"),
    ]
    if count < len(words):
        return words[count]
    return str(count)
