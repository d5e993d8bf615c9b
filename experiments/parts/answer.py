"""An answer's title, and the sentences that stand below its headline."""

from collections.abc import Mapping, Sequence

from geometry.junction import street_names
from geometry.registry import load_entry
from placement.detectors.registry import is_drawn
from placement.evaluation import Evaluation
from placement.question import BASELINE_NAME, N_JUDGED
from placement.setting import Setting

from ..language import tr
from . import comparison, dangers, proof
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
        kept = result.existing
        new = [unit for unit in subject.layout.units if unit.id not in kept]
        if not new:
            return tr("What exists at {place}, and what it prevents", place=place)
        sensors = count_sensors(new)
        if kept:
            sensors = tr(
                "{sensors} next to {n} that exist", sensors=sensors, n=len(kept)
            )
        return tr("Where to mount {sensors} at {place}", sensors=sensors, place=place)
    if len(evaluations) > 1:
        names = tr(" and ").join(evaluations)
        return tr(
            "Roadside sensors at {place}: {names} compared", place=place, names=names
        )
    name = next(iter(evaluations))
    return tr("Roadside sensors at {place}: {name}", place=place, name=name)


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
        *dangers.words(result.dangers, result.runs, cars=result.cars),
        *located(result),
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
        *private_views(result),
        *result.driven[:1],
        *result.without_effect,
        *preferred(result),
        *planned_only(result),
    ]


def private_views(result: Result) -> list[str]:
    """What cameras that are there see of private ground."""
    # By name: few results have private ground.
    views: list[str] = load_entry("experiments.parts.existing_views:warnings")(result)
    return views


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
                "This plan treats a detection as certain if its probability is 0.5"
                " or more, and assumes that nothing fails. {n} sampled worlds"
                " decided only between its best layout and the greedy one. --samples"
                " 8 optimises the mean of eight worlds.",
                n=N_JUDGED,
            )
        ]
    return [
        tr(
            "This plan treats a detection as certain if its probability is 0.5 or"
            " more, and assumes that nothing fails. In fresh worlds, a rule of thumb"
            " can do better. --samples 8 optimises the mean of eight worlds."
        )
    ]


def preferred(result: Result) -> list[str]:
    """Other layouts that the evaluator or fresh worlds prefer."""
    found = []
    if isinstance(result, PlacementResult):
        is_proven = any(
            stage.name == "apr" and stage.gap == 0.0 for stage in result.stages
        )
        chosen_in = result.sampled.chosen_in if result.sampled else None
        found = preferred_sentences(result.preferred, chosen_in)
        found += recommended_sentences(result.front_runners, is_proven=is_proven)
    return found + (overtaken_sentences(result.sampled) if result.sampled else [])


def located(result: Result) -> list[str]:
    """How many runs the layouts locate, by how well their aims are known."""
    say = load_entry("experiments.parts.aims:words")
    choice = getattr(result, "located", None)
    return [*say(result.aims, choice, baseline=BASELINE_NAME)]


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
    others = result.compared if isinstance(result, ComparisonResult) else ()
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
    if isinstance(result, PlacementResult) and result.refinement:
        return refinement_sentences(result.refinement)
    return []


def uncertainty(result: Result) -> list[str]:
    """The layout in sampled worlds; nothing where none were asked for."""
    return uncertainty_sentences(result.sampled) if result.sampled else []
