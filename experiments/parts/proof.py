"""The proof of a placement, and how far detection table and evaluator agree about it."""

import math
from collections.abc import Sequence

from placement.optimiser.problem import Objective
from scenarios.scores import AVOIDED

from ..results.numbers import NOTHING, number, or_nan, percent, points
from ..results.record import StageRecord
from .result import HighestRecord, PlacementResult
from .section import Block, Section, Table, tabulate


def words(result: PlacementResult) -> str:
    """The proof in a sentence without its full stop."""
    stages = result.stages
    among = f"{result.candidates} candidate poses"
    first = stages[0]
    if result.highest is not None:
        return _with_highest(result, result.highest, among)
    of_apr = next(stage for stage in stages if stage.name == "apr")
    within = ""
    if first.name in ("units", "cost_eur"):
        what = "units" if first.name == "units" else "EUR"
        least = "the least"
        if first.gap != 0.0:
            least = f"no choice needs less than {or_nan(first.bound):,.0f}"
        within = f" With {first.objective:,.0f} {what} for what was asked, {least}:"
    if of_apr.gap == 0.0:
        proven = f"Proven on the detection table:{within} no choice among {among}"
        return f"{proven} has a higher {measure_of(result)}"
    return (
        f"The best choice among {among} found in the time given:{within} on the detection table, "
        f"no other can exceed {'an' if result.score == AVOIDED else 'a'} {measure_of(result)} of "
        f"{percent(of_apr.bound)}"
    )


def _with_highest(result: PlacementResult, highest: HighestRecord, among: str) -> str:
    """The proof where some of the highest APR might be given up."""
    measure, failing = measure_of(result), "pole" if result.failing == "site" else "unit"
    (most, kept), given_up = (highest.stages[0], result.stages[0]), points(highest.given_up)
    is_proven = most.gap == 0.0 and kept.gap == 0.0
    begin = "Proven on the detection table:" if is_proven else "Found in the time given:"
    if most.gap == 0.0:
        first = f"no choice among {among} has a higher {measure} than {percent(most.objective)}"
    else:
        first = (
            f"a choice among {among} has an {measure} of {percent(most.objective)}, and none "
            f"exceeds {percent(most.bound)}"
        )
    least = f"with at most {given_up} less"
    more = "" if kept.gap == 0.0 else f" than {percent(kept.bound)}"
    return f"{begin} {first}; of those {least}, none keeps more{more} when a {failing} fails"


def measure_of(result: PlacementResult) -> str:
    """What is optimised: the APR, or the score that was asked for."""
    return "APR" if result.score == AVOIDED else "score"


def section(result: PlacementResult) -> Section:
    """The optimiser's objectives with their proof."""
    is_open = [label for label, stage in _stages(result) if stage.gap != 0.0]
    proof = "Yes: every objective's gap is closed."
    if is_open:
        proof = f"Not in full: proven are all objectives but {', '.join(is_open)}."
    note = (
        f"Solver: {result.solver or NOTHING}. The proof holds for the detection table: for the "
        "candidate poses that were tried, on the runs listed below. What is proven, no other "
        "choice among them exceeds."
    )
    return Section("proof", "How good is it, and is that proven?", [proof, table(result), note])


def table(result: PlacementResult) -> Table:
    """A row per objective, in order."""
    return _table(_stages(result))


def _stages(result: PlacementResult) -> list[tuple[str, StageRecord]]:
    """Objectives by name: first the highest APR of any choice, where some may be given up."""
    found = [(_label(stage.name, result), stage) for stage in result.stages]
    if result.highest is None:
        return found
    return [(f"highest {measure_of(result)} of any choice", result.highest.stages[0]), *found]


def stage_table(stages: Sequence[StageRecord]) -> Table:
    """A row per stage of any certificate."""
    return _table([(Objective(stage.name).label, stage) for stage in stages])


def _table(stages: Sequence[tuple[str, StageRecord]]) -> Table:
    return Table(
        caption="Objectives in order: each is optimised without giving up any before it",
        columns=["on the detection table", "found", "bound", "gap", "time (s)"],
        rows=[[label, *_stage_row(stage)] for label, stage in stages],
        numeric=range(1, 5),
    )


def _label(name: str, result: PlacementResult) -> str:
    """Name of an objective; what fails is a pole where that was asked, a score is named so."""
    label = Objective(name).label.replace("APR", measure_of(result))
    return label.replace(" unit", " pole") if result.failing == "site" else label


def _stage_row(stage: StageRecord) -> list[str]:
    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        if stage.name in ("units", "cost_eur"):
            return f"{value:,.2f}".removesuffix(".00")
        return f"{number(value, 3)} s" if stage.name.endswith("_s") else percent(value)

    gap = "open" if stage.gap is None or not math.isfinite(stage.gap) else percent(stage.gap)
    return [
        shown(stage.objective),
        shown(stage.bound),
        "proven" if stage.gap == 0.0 else gap,
        number(stage.seconds, 1),
    ]


def agreement_section(result: PlacementResult) -> Section:
    """How far detection table and evaluator differ."""
    share = result.surrogate_disagreement
    both = f"They disagree on {percent(share)} of the runs whether this layout avoids it."
    if share == 0.0:
        both = "For this layout both say the same of every run."
    text = (
        "The layout was chosen on a detection table, which looks at sample points on the road "
        f"user's surface. The evaluator renders every image instead. {both}"
    )
    runs = tabulate(
        "Runs that only one of them calls avoided, for each unit by itself and for all fused",
        result.disagreements,
        {
            "run": lambda entry: entry.run_id,
            "unit": lambda entry: entry.party,
            "avoided by the": lambda entry: "table" if entry.on_table else "evaluator",
            "frames that differ": lambda entry: entry.n_frames,
            "what the evaluator sees in the first of them": lambda entry: entry.cause,
        },
        numeric=[3],
    )
    none = "Nor do they differ on any run for any unit by itself."
    blocks: list[Block] = [text, runs if result.disagreements else none]
    return Section("models", "Do the two models agree?", blocks)
