"""The answer of a placement, an evaluation or a comparison: its title, and its few sentences."""

from collections.abc import Mapping

from geometry.arrays import BoolArray
from geometry.junction import street_names
from placement.detectors.built_in import is_drawn
from placement.evaluation import Evaluation, headline_apr
from placement.setting import Setting
from scenarios.weights import weight_share

from ..results.numbers import capital, percent, several
from . import added, comparison, dangers, proof
from .accidents import count_sensors, is_weighted
from .alternatives import doubt_sentences, recommended_sentences
from .dangers import avoided_runs
from .explanation import next_unit_sentence, refinement_sentences
from .result import ComparisonResult, EvaluationResult, PlacementResult, Result
from .sampled_worlds import overtaken_sentences, preferred_sentences, uncertainty_sentences
from .units import private_ground_sentences

_SMALL = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def title(result: Result, setting: Setting, evaluations: Mapping[str, Evaluation]) -> str:
    """Heading: the question that a placement, an evaluation or a comparison answers."""
    named = " / ".join(street_names(setting.scene).values())
    streets = dict.fromkeys(filter(None, named.split(" / ")))
    place = " / ".join(streets) or setting.scene.name
    if isinstance(result, PlacementResult):
        subject = next(iter(evaluations.values()))
        return f"Where to mount {count_sensors(subject.layout)} at {place}"
    if len(evaluations) > 1:
        return f"Roadside sensors at {place}: {' and '.join(evaluations)} compared"
    return f"Roadside sensors at {place}: {next(iter(evaluations))}"


def lead(result: Result) -> str:
    """The first sentence of an answer, without codes: what units prevent, and what cars do alone.

    With fusion "single" runs are counted: a unit has to confirm by itself.
    """
    found, layout = result.evaluation, result.layout
    n_lidars = sum(bool(unit.lidar) for unit in layout)
    kinds = ((len(layout) - n_lidars, "camera", "cameras"), (n_lidars, "LiDAR", "LiDARs"))
    units = " and ".join(_spelled(several(n, one, many)) for n, one, many in kinds if n)
    n_poles = len({unit.site or unit.id for unit in layout})
    mounted = f"{capital(units)} on {_spelled(several(n_poles, 'pole', 'poles'))}"
    verb = "prevents" if len(layout) == 1 else "prevent"
    seeing = " together with cars that see for themselves" if result.cars == 1.0 else ""
    share = percent(found.judged.all)
    if result.fusion == "single":
        share = f"{result.runs - result.dangers.not_avoided} of {result.runs}"
    best = ""
    if isinstance(result, PlacementResult):
        is_best = result.goal == "best" and result.stages[0].name == "apr" and is_proven(result)
        best = ", and no other choice prevents more" if is_best and result.sampled is None else ""
        if result.highest and result.highest.compared:
            other = result.highest.compared.evaluation
            most = "any choice prevents" if result.highest.stages[0].gap == 0.0 else "was found"
            best = (
                f", and {percent(found.apr_without_worst_unit)} if one of them fails; the most "
                f"that {most} is {percent(other.judged.all)}, but then "
                f"{percent(other.apr_without_worst_unit)} if one fails"
            )
    together = f", both together {percent(found.vut_and_rsus.all)}"
    return (
        f"{mounted}{seeing} {verb} {share} of the simulated collisions, by telling cars when to "
        f"brake{best}. The cars' own sensors alone prevent {percent(found.vut.all)}"
        f"{'' if result.cars == 1.0 else together}."
    )


def is_proven(result: PlacementResult) -> bool:
    """True if the first objective is, and the highest share that might be given up of."""
    first = [result.stages[0], *(result.highest.stages[:1] if result.highest else ())]
    return all(stage.gap == 0.0 for stage in first)


def _spelled(text: str) -> str:
    """A count with its noun, small numbers as words."""
    count, _, noun = text.partition(" ")
    is_small = count.isdigit() and int(count) < len(_SMALL)
    return f"{_SMALL[int(count)]} {noun}" if is_small else text


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
        "This plan takes for seen whatever is seen with a probability of 0.5 or more, and nothing "
        "is out of order in it: in fresh worlds such a choice can be behind a rule of thumb. "
        "--samples 8 chooses for the mean of eight worlds."
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
    verb = "avoids" if len(subject.units) == 1 else "avoid"
    how = ", each by itself," if result.fusion == "single" else ""
    score = _score(avoided_runs(subject, result.fusion), subject)
    further = next_unit_sentence(result.next_unit, proof.measure_of(result))
    last = (further, proof.words(result), *_failures(result, subject))
    return [
        f"{count_sensors(subject.layout)}{how} {verb} {score}; {_of_car(subject)}",
        ". ".join(part for part in last if part),
    ]


def _of_others(result: EvaluationResult | ComparisonResult, subject: Evaluation) -> list[str]:
    name, compared = result.name, result.compared if isinstance(result, ComparisonResult) else ()
    return [
        f"{name} ({count_sensors(subject.layout)}) avoids "
        f"{_score(subject.headline.is_avoided, subject, headline_apr(subject))}; "
        f"{_of_car(subject)}",
        *comparison.words(name, compared),
        *_failures(result, subject),
    ]


def _of_car(subject: Evaluation) -> str:
    return f"the car by itself avoids {_score(subject.vut.is_avoided, subject)}"


def _failures(result: Result, subject: Evaluation) -> list[str]:
    """APR that remains when a unit or a pole fails."""

    def left(apr: float) -> str:
        is_all = apr > 1.0 - 1.0e-9
        return (
            f"the others {'still avoid every run' if is_all else f'reach at least {percent(apr)}'}"
        )

    of_unit = result.evaluation.apr_without_worst_unit
    of_site = result.evaluation.apr_without_worst_site
    failed = []
    if of_unit is not None and len(subject.units) == 1:
        failed.append("If this one unit fails, only the car itself is left")
    elif of_unit is not None:
        failed.append(f"If any one unit fails, {left(of_unit)}")
    if of_site is not None:
        failed.append(f"If any one pole fails with all its units, {left(of_site)}")
    return failed


def _score(is_avoided: BoolArray, evaluation: Evaluation, apr: float | None = None) -> str:
    """Runs and APR; `apr` is that of all cars where only a share of them sees."""
    axis = evaluation.axis
    by_weight = " by weight" if is_weighted(axis) else ""
    share = percent(weight_share(is_avoided, axis.weight))
    of_all = ""
    if apr is not None and 0.0 < evaluation.cars < 1.0:
        of_all = f" in cars that do not see; {percent(apr)} of all"
    return f"{int(is_avoided.sum())} of {axis.n_runs} runs (APR{by_weight} {share}{of_all})"
