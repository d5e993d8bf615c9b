"""The proof of a placement, and how far table and evaluator agree."""

import math
from collections.abc import Sequence

from placement.optimiser.problem import Objective
from placement.pipeline import FOUND

from ..language import localized, mark, tr
from ..results.numbers import NOTHING, number, or_nan, percent, points
from ..results.record import StageRecord
from .result import HighestRecord, PlacementResult
from .section import Block, Section, Table, tabulate


def words(result: PlacementResult) -> str:
    """The proof in a sentence without its full stop: figures of the planning model."""
    if result.highest is not None:
        return _with_highest(result, result.highest)
    least = _least(result.stages[0])
    if least:
        return least
    better = best_possible(result)
    n_poses = result.candidates
    if better == 0.0:
        return tr(
            "Proven in the planning model: no choice among {n} candidate poses"
            " prevents more",
            n=n_poses,
        )
    if result.preferred is not None and result.preferred.second == FOUND:
        return tr(
            "In fresh worlds, this choice is better than the one that prevents most"
            " in the planning model. In that model, no choice among {n} candidate"
            " poses prevents more than {bound}",
            n=n_poses,
            bound=percent(result.bound),
        )
    if better is None:
        return tr(
            "Not proven: the best choice among {n} candidate poses found in the time"
            " given",
            n=n_poses,
        )
    return tr(
        "Not proven: in the planning model, a choice among {n} candidate poses may be"
        " at most {points} better",
        n=n_poses,
        points=points(better),
    )


def best_possible(result: PlacementResult) -> float | None:
    """How much better any other choice can be at most, in the planning model.

    As a share of 1: of the highest APR, and of what is kept when a unit fails where
    some APR may be given up for that. 0: proven best; None: no bound is known, or what
    was asked for is not a share.
    """
    if is_proven(result):
        return 0.0
    better = []
    # Units and money are no shares: `_least` says what is known of them.
    for stage in _first_stages(result):
        if not stage.name.startswith("apr") or stage.bound is None:
            return None
        better.append(stage.bound - stage.objective)
    return max([0.0, *better])


def is_proven(result: PlacementResult) -> bool:
    """True if all that an answer begins with is proven."""
    return all(stage.gap == 0.0 for stage in _first_stages(result))


def _first_stages(result: PlacementResult) -> list[StageRecord]:
    """The highest APR, where some of it may be given up, and the first objective."""
    stages = [result.stages[0]]
    if result.highest is not None:
        stages.insert(0, result.highest.stages[0])
    return stages


def _least(first: StageRecord) -> str:
    """How little is needed for what was asked, where that is the first objective."""
    values = {"found": first.objective, "least": or_nan(first.bound)}
    if first.name == "units" and first.gap == 0.0:
        return tr("Proven in the planning model: no choice needs fewer units")
    if first.name == "units":
        return tr(
            "Not proven: in the planning model, at least {least:,.0f} units are"
            " needed; {found:,.0f} were found",
            **values,
        )
    if first.name == "cost_eur" and first.gap == 0.0:
        return tr("Proven in the planning model: no choice costs less")
    if first.name == "cost_eur":
        return tr(
            "Not proven: in the planning model, at least {least:,.0f} EUR are needed;"
            " {found:,.0f} EUR were found",
            **values,
        )
    return ""


def _with_highest(result: PlacementResult, highest: HighestRecord) -> str:
    """The proof where some of the highest APR might be given up."""
    most = highest.stages[0]
    kept = result.stages[0]
    values = {
        "n": result.candidates,
        "most": percent(most.objective),
        "given_up": points(highest.given_up),
    }
    if most.gap == 0.0:
        first = tr(
            "Proven in the planning model: no choice among {n} candidate poses"
            " prevents more than {most}",
            **values,
        )
    else:
        more = or_nan(most.bound) - most.objective
        first = tr(
            "Not proven: in the planning model, the best found among {n} candidate"
            " poses prevents {most}; at most {more} better is possible",
            more=points(more),
            **values,
        )
    if kept.gap == 0.0 and result.failing == "site":
        then = tr(
            "of the choices that prevent at most {given_up} less, none prevents more"
            " when a pole fails",
            **values,
        )
    elif kept.gap == 0.0:
        then = tr(
            "of the choices that prevent at most {given_up} less, none prevents more"
            " when a sensor fails",
            **values,
        )
    else:
        more = or_nan(kept.bound) - kept.objective
        then = tr(
            "of the choices that prevent at most {given_up} less, none can exceed"
            " this one by more than {more} when a sensor fails",
            more=points(more),
            **values,
        )
    return f"{first}; {then}"


def section(result: PlacementResult) -> Section:
    """The optimiser's objectives with their proof."""
    is_open = [label for label, stage in _stages(result) if stage.gap != 0.0]
    proof = tr("Yes: every objective's gap is closed.")
    if is_open:
        names = ", ".join(is_open)
        proof = tr("Partly: all objectives except {names} are proven.", names=names)
    note = tr(
        "Solver: {solver}. The proof holds for the detection table: for the"
        " candidate poses that were tried, on the runs listed below. No other choice"
        " among them exceeds a proven value.",
        solver=tr(result.solver) or NOTHING,
    )
    blocks: list[Block] = [proof, table(result), *conditions(result), note]
    return Section("proof", tr("How good is it, and is that proven?"), blocks)


def conditions(result: PlacementResult) -> list[str]:
    """What the table's rows after the first open one depend on, in a sentence.

    Or none.
    """
    return _conditions(_stages(result))


def table(result: PlacementResult) -> Table:
    """A row per objective, in order."""
    return _table(_stages(result))


def _stages(result: PlacementResult) -> list[tuple[str, StageRecord]]:
    """Objectives by name.

    First the highest APR of any choice, where some may be given up.
    """
    found = [(_label(stage.name, result), stage) for stage in result.stages]
    if result.highest is None:
        return found
    highest = tr("highest APR of any choice")
    return [(highest, result.highest.stages[0]), *found]


def stage_table(stages: Sequence[StageRecord]) -> Table:
    """A row per stage of any certificate."""
    return _table(_labelled(stages))


def stage_conditions(stages: Sequence[StageRecord]) -> list[str]:
    """What the rows of :func:`stage_table` after the first open one depend on.

    Or nothing.
    """
    return _conditions(_labelled(stages))


def _labelled(stages: Sequence[StageRecord]) -> list[tuple[str, StageRecord]]:
    return [(tr(Objective(stage.name).label), stage) for stage in stages]


def _table(stages: Sequence[tuple[str, StageRecord]]) -> Table:
    n_certain = _n_certain(stages)
    return Table(
        caption=tr(
            "Objectives in order: each is optimised without giving up any before it"
        ),
        columns=[
            tr("on the detection table"),
            tr("found"),
            tr("bound"),
            tr("gap"),
            tr("time (s)"),
        ],
        rows=[
            [label, *_stage_row(stage, is_certain=number < n_certain)]
            for number, (label, stage) in enumerate(stages)
        ],
        numeric=range(1, 5),
    )


def _n_certain(stages: Sequence[tuple[str, StageRecord]]) -> int:
    """Stages up to the first open one.

    The bounds of those after it depend on what that holds.
    """
    is_open = [stage.gap != 0.0 for _, stage in stages]
    if True in is_open:
        return is_open.index(True) + 1
    return len(stages)


def _conditions(stages: Sequence[tuple[str, StageRecord]]) -> list[str]:
    n_certain = _n_certain(stages)
    if n_certain == len(stages):
        return []
    name = stages[n_certain - 1][0]
    return [
        tr(
            "{name} is not proven: the rows below it compare only with choices that"
            " are equally good in it, so they show no gap.",
            name=name,
        )
    ]


def _label(name: str, result: PlacementResult) -> str:
    """Name of an objective; what fails is a pole where that was asked."""
    if result.failing == "site":
        return tr(_OF_POLES.get(name, Objective(name).label))
    return tr(Objective(name).label)


_OF_POLES = {
    "apr_survived": mark("APR if the most important poles fail"),
    "apr_one_failed": mark("APR if the most important pole fails"),
}
"""Names of objectives where poles fail."""


def _stage_row(stage: StageRecord, *, is_certain: bool) -> list[str]:
    """Value, bound, gap and seconds.

    Of what is not certain, only whether it is proven.
    """

    def shown(value: float | None) -> str:
        if value is None or not math.isfinite(value):
            return NOTHING
        if stage.name in ("units", "cost_eur"):
            return localized(f"{value:,.2f}".removesuffix(".00"))
        if stage.name.endswith("_s"):
            return f"{number(value, 3)} s"
        return percent(value)

    is_proven = stage.gap == 0.0
    if is_proven:
        gap = tr("proven")
    else:
        gap = tr("open")
    # More than the value itself says nothing as a share of it.
    if not is_proven and is_certain and stage.gap is not None and stage.gap <= 1.0:
        gap = percent(stage.gap)
    if is_certain or is_proven:
        bound = shown(stage.bound)
    else:
        bound = NOTHING
    return [shown(stage.objective), bound, gap, number(stage.seconds, 1)]


def agreement_section(result: PlacementResult) -> Section:
    """How far detection table and evaluator differ."""
    share = result.surrogate_disagreement
    both = tr(
        "For this layout, they disagree on {share} of the runs.",
        share=percent(share),
    )
    if share == 0.0:
        both = tr("For this layout, both agree on every run.")
    text = tr(
        "The layout was chosen on a detection table, which looks at "
        "sample points on the road user's surface. The evaluator renders "
        "every image instead. {both}",
        both=both,
    )
    runs = tabulate(
        tr(
            "Runs rated as avoided by only one of the two, for each unit by itself"
            " and for all fused"
        ),
        result.disagreements,
        {
            tr("run"): lambda entry: entry.run_id,
            tr("unit"): lambda entry: tr(entry.party),
            tr("avoided by the"): lambda entry: (
                tr("table") if entry.on_table else tr("evaluator")
            ),
            tr("frames that differ"): lambda entry: entry.n_frames,
            tr("evaluator's view in the first of these frames"): lambda entry: tr(
                entry.cause
            ),
        },
        numeric=[3],
    )
    none = tr("They also agree on every run for each unit by itself.")
    blocks: list[Block] = [text, runs if result.disagreements else none]
    return Section("models", tr("Do the two models agree?"), blocks)
