"""The answer of a placement, an evaluation or a comparison: its title, and its few sentences."""

from collections.abc import Mapping

from geometry.arrays import BoolArray
from geometry.junction import street_names
from placement.detectors.built_in import is_drawn
from placement.evaluation import Evaluation, headline_apr
from placement.question import N_JUDGED
from placement.setting import Setting
from scenarios.weights import weight_share

from ..language import mark, say, tr, trn
from ..results.numbers import capital, joined, percent
from . import added, comparison, dangers, proof
from .accidents import count_sensors, is_weighted
from .alternatives import doubt_sentences, recommended_sentences
from .dangers import avoided_runs
from .explanation import next_unit_sentence, refinement_sentences
from .result import ComparisonResult, EvaluationResult, PlacementResult, Result
from .sampled_worlds import overtaken_sentences, preferred_sentences, uncertainty_sentences
from .units import private_ground_sentences

_SMALL = (
    *(mark("no"), mark("one"), mark("two"), mark("three"), mark("four"), mark("five")),
    *(mark("six"), mark("seven"), mark("eight"), mark("nine"), mark("ten")),
)


def title(result: Result, setting: Setting, evaluations: Mapping[str, Evaluation]) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    named = " / ".join(street_names(setting.scene).values())
    streets = dict.fromkeys(filter(None, named.split(" / ")))
    place = " / ".join(streets) or setting.scene.name
    if isinstance(result, PlacementResult):
        subject = next(iter(evaluations.values()))
        sensors = count_sensors(subject.layout)
        return tr("Where to mount {sensors} at {place}", sensors=sensors, place=place)
    if len(evaluations) > 1:
        names = tr(" and ").join(evaluations)
        return tr("Roadside sensors at {place}: {names} compared", place=place, names=names)
    name = next(iter(evaluations))
    return tr("Roadside sensors at {place}: {name}", place=place, name=name)


def lead(result: Result) -> str:
    """The first sentence of an answer, without codes: what units prevent, and what cars do alone.

    With fusion "single" runs are counted: a unit has to confirm by itself.
    """
    found, layout = result.evaluation, result.layout
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
        return say("answer.lead_of_seeing_cars", len(layout), **values)
    return say("answer.lead", len(layout), both=percent(found.vut_and_rsus.all), **values)


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
        is_best = result.goal == "best" and result.stages[0].name == "apr" and is_proven(result)
        is_best &= result.sampled is None
        return tr(", and no other choice prevents more") if is_best else ""
    other = highest.compared.evaluation
    values = {
        "left": percent(result.evaluation.apr_without_worst_unit),
        "most": percent(other.judged.all),
        "others_left": percent(other.apr_without_worst_unit),
    }
    if highest.stages[0].gap == 0.0:
        return say("answer.most_of_any", **values)
    return say("answer.most_found", **values)


def is_proven(result: PlacementResult) -> bool:
    """True if the first objective is, and the highest share that might be given up of."""
    first = [result.stages[0], *(result.highest.stages[:1] if result.highest else ())]
    return all(stage.gap == 0.0 for stage in first)


def _spelled(count: int) -> str:
    return tr(_SMALL[count]) if count < len(_SMALL) else str(count)


def words(result: Result, shown: Mapping[str, Evaluation]) -> list[str]:
    """The headline of the report; evaluations by display name, the first one is the subject."""
    subject = next(iter(shown.values()))
    sentences = (
        _of_placement(result, subject)
        if isinstance(result, PlacementResult)
        else _of_others(result, subject)
    )
    return [
        *result.driven[:1],
        *result.without_effect,
        *added.words(result.added),
        *dangers.words(result.dangers, result.runs, cars=result.cars),
        *preferred(result),
        *planned_only(result),
        *(f"{sentence}." for sentence in sentences if sentence),
        *doubts(result),
        *private_ground(result),
        *refinement(result),
        *uncertainty(result),
    ]


def warnings(result: Result) -> list[str]:
    """What must not be overlooked: runs that were not driven, options that did nothing, doubts."""
    return [*result.driven[:1], *result.without_effect, *preferred(result), *planned_only(result)]


def planned_only(result: Result) -> list[str]:
    """Warning that a layout was chosen as planned, where a detector finds people by chance."""
    if not isinstance(result, PlacementResult) or result.sampled or not is_drawn(result.detector):
        return []
    return [
        say("answer.planned_decided" if result.preferred else "answer.planned_only", n=N_JUDGED)
    ]


def preferred(result: Result) -> list[str]:
    """Other layouts that the evaluator or fresh sampled worlds prefer to the one found."""
    if isinstance(result, EvaluationResult):
        return []
    found = []
    if isinstance(result, PlacementResult):
        is_proven = any(stage.name == "apr" and stage.gap == 0.0 for stage in result.stages)
        chosen_in = result.sampled.chosen_in if result.sampled else None
        found = preferred_sentences(result.preferred, chosen_in)
        found += recommended_sentences(result.front_runners, is_proven=is_proven)
    return found + (overtaken_sentences(result.sampled) if result.sampled else [])


def doubts(result: Result) -> list[str]:
    """Sentences about what would change the answer."""
    if not isinstance(result, PlacementResult):
        return doubt_sentences(result.heavy_runs, n_runs=result.runs)
    return doubt_sentences(result.heavy_runs, result.by_runs, result.mounting, n_runs=result.runs)


def private_ground(result: Result) -> list[str]:
    """Private ground that units see; of each layout where several are compared."""
    others = result.compared if isinstance(result, ComparisonResult) else ()
    return private_ground_sentences(
        result.private_ground, {other.name: other.private_ground for other in others}
    )


def refinement(result: Result) -> list[str]:
    """Gains of refinement between the poses of the grid; nothing where not asked for."""
    if not isinstance(result, PlacementResult) or result.refinement is None:
        return []
    return refinement_sentences(result.refinement)


def uncertainty(result: Result) -> list[str]:
    """The layout in sampled worlds; nothing where none were asked for."""
    if isinstance(result, EvaluationResult) or result.sampled is None:
        return []
    return uncertainty_sentences(result.sampled)


def _of_placement(result: PlacementResult, subject: Evaluation) -> list[str]:
    values = {
        "sensors": count_sensors(subject.layout),
        "score": _score(avoided_runs(subject, result.fusion), subject),
        "of_car": _of_car(subject),
    }
    n_units = len(subject.units)
    if result.fusion == "single":
        first = say("answer.avoid_by_themselves", n_units, **values)
    else:
        first = say("answer.avoid", n_units, **values)
    further = next_unit_sentence(result.next_unit, proof.measure_of(result))
    last = (further, proof.words(result), *_failures(result, subject))
    return [first, ". ".join(part for part in last if part)]


def _of_others(result: EvaluationResult | ComparisonResult, subject: Evaluation) -> list[str]:
    name, compared = result.name, result.compared if isinstance(result, ComparisonResult) else ()
    first = tr(
        "{name} ({sensors}) avoids {score}; {of_car}",
        name=name,
        sensors=count_sensors(subject.layout),
        score=_score(subject.headline.is_avoided, subject, headline_apr(subject)),
        of_car=_of_car(subject),
    )
    return [
        first,
        *comparison.words(name, compared),
        *_failures(result, subject),
    ]


def _of_car(subject: Evaluation) -> str:
    score = _score(subject.vut.is_avoided, subject)
    return tr("the car by itself avoids {score}", score=score)


def _failures(result: Result, subject: Evaluation) -> list[str]:
    """APR that remains when a unit or a pole fails."""

    def left(every: str, some: str, apr: float) -> str:
        return tr(every) if apr > 1.0 - 1.0e-9 else tr(some, share=percent(apr))

    of_unit = result.evaluation.apr_without_worst_unit
    of_site = result.evaluation.apr_without_worst_site
    failed = []
    if of_unit is not None and len(subject.units) == 1:
        failed.append(tr("If this one unit fails, only the car itself is left"))
    elif of_unit is not None:
        every = mark("If any one unit fails, the others still avoid every run")
        some = mark("If any one unit fails, the others reach at least {share}")
        failed.append(left(every, some, of_unit))
    if of_site is not None:
        every = mark("If any one pole fails with all its units, the others still avoid every run")
        some = mark("If any one pole fails with all its units, the others reach at least {share}")
        failed.append(left(every, some, of_site))
    return failed


def _score(is_avoided: BoolArray, evaluation: Evaluation, apr: float | None = None) -> str:
    """Runs and APR; `apr` is that of all cars where only a share of them sees."""
    axis = evaluation.axis
    share = percent(weight_share(is_avoided, axis.weight))
    if apr is not None and 0.0 < evaluation.cars < 1.0:
        share = tr("{share} in cars that do not see; {all} of all", share=share, all=percent(apr))
    values = {"avoided": int(is_avoided.sum()), "runs": axis.n_runs, "share": share}
    if is_weighted(axis):
        return tr("{avoided} of {runs} runs (APR by weight {share})", **values)
    return tr("{avoided} of {runs} runs (APR {share})", **values)
