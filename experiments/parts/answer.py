"""The answer of a placement, an evaluation or a comparison.

Its title, and its few sentences.
"""

from collections.abc import Mapping, Sequence

from geometry.junction import street_names
from placement.detectors.registry import is_drawn
from placement.evaluation import Evaluation
from placement.question import N_JUDGED
from placement.setting import Setting

from ..language import tr, trn
from ..results.numbers import capital, joined, percent, points
from . import added, comparison, dangers, proof
from .accidents import count_sensors
from .alternatives import doubt_sentences, recommended_sentences
from .explanation import next_unit_sentence, refinement_sentences
from .result import ComparisonResult, PlacementResult, Result
from .sampled_worlds import (
    overtaken_sentences,
    preferred_sentences,
    uncertainty_sentences,
)
from .units import private_ground_sentence


def title(
    result: Result, setting: Setting, evaluations: Mapping[str, Evaluation]
) -> str:
    """Heading: the question that a result answers."""
    named = " / ".join(street_names(setting.scene).values())
    streets = dict.fromkeys(filter(None, named.split(" / ")))
    place = " / ".join(streets) or setting.scene.name
    if isinstance(result, PlacementResult):
        subject = next(iter(evaluations.values()))
        sensors = count_sensors(subject.layout)
        return tr("Where to mount {sensors} at {place}", sensors=sensors, place=place)
    if len(evaluations) > 1:
        names = tr(" and ").join(evaluations)
        return tr(
            "Roadside sensors at {place}: {names} compared", place=place, names=names
        )
    name = next(iter(evaluations))
    return tr("Roadside sensors at {place}: {name}", place=place, name=name)


def lead(result: Result) -> str:
    """The first sentence of an answer, without codes.

    What units prevent, and what cars do alone.

    With fusion "single" runs are counted: a unit has to confirm by itself.
    """
    found = result.evaluation
    layout = result.layout
    share = percent(found.judged.all)
    if result.fusion == "single":
        n_avoided = result.runs - result.dangers.not_avoided
        share = tr("{n} of {all}", n=n_avoided, all=result.runs)
    values = {
        "mounted": _mounted(result),
        "share": share,
        "best": _best(result) if isinstance(result, PlacementResult) else "",
        "own": percent(found.vut.all),
    }
    if result.cars == 1.0:
        return trn(
            "{mounted} together with cars that see for themselves prevents "
            "{share} of the simulated collisions, by telling cars when to "
            "brake{best}. The cars' own sensors alone prevent {own}.",
            "{mounted} together with cars that see for themselves prevent "
            "{share} of the simulated collisions, by telling cars when to "
            "brake{best}. The cars' own sensors alone prevent {own}.",
            len(layout),
            **values,
        )
    return trn(
        "{mounted} prevents {share} of the simulated collisions, by "
        "telling cars when to brake{best}. The cars' own sensors alone "
        "prevent {own}, both together {both}.",
        "{mounted} prevent {share} of the simulated collisions, by "
        "telling cars when to brake{best}. The cars' own sensors alone "
        "prevent {own}, both together {both}.",
        len(layout),
        both=percent(found.vut_and_rsus.all),
        **values,
    )


def _mounted(result: Result) -> str:
    """How many units on how many poles, small numbers as words."""
    n_lidars = sum(bool(unit.lidar) for unit in result.layout)
    n_cameras = len(result.layout) - n_lidars
    n_poles = len({unit.site or unit.id for unit in result.layout})
    cameras = trn("one camera", "{count} cameras", n_cameras, count=_spelled(n_cameras))
    lidars = trn("one LiDAR", "{count} LiDARs", n_lidars, count=_spelled(n_lidars))
    units = [words for n, words in ((n_cameras, cameras), (n_lidars, lidars)) if n]
    poles = trn("one pole", "{count} poles", n_poles, count=_spelled(n_poles))
    return capital(tr("{units} on {poles}", units=joined(units), poles=poles))


def _best(result: PlacementResult) -> str:
    """What is known of other choices, as the end of a sentence."""
    highest = result.highest
    if highest is None or highest.compared is None:
        is_best = (
            result.goal == "best"
            and result.stages[0].name == "apr"
            and is_proven(result)
        )
        is_best &= result.sampled is None
        if is_best:
            return tr(", and no other choice prevents more")
        return ""
    other = highest.compared.evaluation
    values = {
        "left": percent(result.evaluation.apr_without_worst_unit),
        "most": percent(other.judged.all),
        "others_left": percent(other.apr_without_worst_unit),
        "given_up": points(highest.given_up),
    }
    if highest.stages[0].gap == 0.0:
        return tr(
            ", and {left} if one of them fails. The most that any choice "
            "prevents is {most}, but only {others_left} if one fails: to keep "
            "more then, up to {given_up} is given up",
            **values,
        )
    return tr(
        ", and {left} if one of them fails. The most that was found is "
        "{most}, but only {others_left} if one fails: to keep more then, "
        "up to {given_up} is given up",
        **values,
    )


def is_proven(result: PlacementResult) -> bool:
    """True if all that the answer begins with is proven.

    That is the first objective, and the highest APR of which some may be given up.
    """
    first = [result.stages[0], *(result.highest.stages[:1] if result.highest else ())]
    return all(stage.gap == 0.0 for stage in first)


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


def words(result: Result) -> list[str]:
    """What the first screen leaves to say.

    No section says it in so few words.
    """
    sentences: Sequence[str] = ()
    if isinstance(result, PlacementResult):
        further = next_unit_sentence(result.next_unit)
        sentences = (further, proof.words(result))
    elif isinstance(result, ComparisonResult):
        sentences = comparison.words(result.name, result.compared)
    return [
        *added.words(result.added),
        *dangers.words(result.dangers, result.runs, cars=result.cars),
        *(f"{sentence}." for sentence in sentences if sentence),
        *doubts(result),
        *private_ground(result),
        *refinement(result),
        *uncertainty(result),
    ]


def warnings(result: Result) -> list[str]:
    """What must not be overlooked.

    Runs that were not driven, options that did nothing, doubts.
    """
    return [
        *result.driven[:1],
        *result.without_effect,
        *preferred(result),
        *planned_only(result),
    ]


def planned_only(result: Result) -> list[str]:
    """Warning that a layout was chosen as planned, without chance.

    Where a detector finds people by chance.
    """
    if (
        not isinstance(result, PlacementResult)
        or result.sampled
        or not is_drawn(result.detector)
    ):
        return []
    if result.preferred:
        return [
            tr(
                "This plan takes for seen whatever is seen with a probability of "
                "0.5 or more, and nothing is out of order in it. {n} sampled "
                "worlds, where chance decides, chose between its best layout and "
                "greedy choice's, and compared no other: --samples 8 chooses for "
                "the mean of eight worlds.",
                n=N_JUDGED,
            )
        ]
    return [
        tr(
            "This plan takes for seen whatever is seen with a probability of "
            "0.5 or more, and nothing is out of order in it: in fresh worlds "
            "such a choice can be behind a rule of thumb. --samples 8 chooses "
            "for the mean of eight worlds."
        )
    ]


def preferred(result: Result) -> list[str]:
    """Other layouts that the evaluator or fresh worlds prefer."""
    found = []
    if isinstance(result, PlacementResult):
        is_proven = any(
            stage.name == "apr" and stage.gap == 0.0 for stage in result.stages
        )
        if result.sampled:
            chosen_in = result.sampled.chosen_in
        else:
            chosen_in = None
        found = preferred_sentences(result.preferred, chosen_in)
        found += recommended_sentences(result.front_runners, is_proven=is_proven)
    return found + (overtaken_sentences(result.sampled) if result.sampled else [])


def doubts(result: Result) -> list[str]:
    """Sentences about what would change the answer."""
    if not isinstance(result, PlacementResult):
        return doubt_sentences(result.heavy_runs, n_runs=result.runs)
    return doubt_sentences(
        result.heavy_runs, result.by_runs, result.mounting, n_runs=result.runs
    )


def private_ground(result: Result) -> list[str]:
    """Private ground that units see.

    Of each layout where several are compared.
    """
    if result.private_ground is None:
        return []
    if isinstance(result, ComparisonResult):
        others = result.compared
    else:
        others = ()
    return [
        private_ground_sentence(result.private_ground),
        *(
            f"{other.name}: {private_ground_sentence(other.private_ground)}"
            for other in others
            if other.private_ground
        ),
    ]


def refinement(result: Result) -> list[str]:
    """Gains of refinement between the poses of the grid.

    Nothing where not asked for.
    """
    if isinstance(result, PlacementResult):
        refined = result.refinement
    else:
        refined = None
    if refined:
        return refinement_sentences(refined)
    return []


def uncertainty(result: Result) -> list[str]:
    """The layout in sampled worlds; nothing where none were asked for."""
    if result.sampled:
        return uncertainty_sentences(result.sampled)
    return []
