"""The layouts on the study's cases, next to the question that was asked."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated

from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.evaluator import evaluate_again
from placement.layout import find_baseline
from placement.question import BLIND, Question
from placement.setting import Setting
from scenarios.cases import select_cases

from ..language import mark, tr, trn
from ..results.numbers import percent
from ..results.record import Record, says
from .baselines import Score, build_score
from .section import Section, Table

STAGE = mark("study's cases")


class StudyCases(Record, frozen=True, kw_only=True):
    """Layouts on the study's cases, as the study drives and reads them."""

    runs: Annotated[int, says("Runs of these cases.")]
    parties: Annotated[tuple[Score, ...], says("The layouts, then the vehicle alone.")]


def build_study_cases(evaluations: Mapping[str, Evaluation]) -> StudyCases:
    """Layouts by display name on the study's cases, and the VUT by itself."""
    first = next(iter(evaluations.values()))
    layouts = [
        build_score(name, item.rsu_all, item.axis, n_units=len(item.layout.units))
        for name, item in evaluations.items()
    ]
    alone = build_score("VUT alone", first.vut, first.axis, n_units=0)
    return StudyCases(runs=first.axis.n_runs, parties=(*layouts, alone))


def study_question(question: Question) -> Question:
    """A question changed to what the study drives, read as the study does.

    Its cases by day, at the junction alone, all speeds and approaches, each run alike;
    a confirmed track lives for ever, and cars are blind. All else stays as it was asked
    for.
    """
    return replace(
        question,
        cases="study",
        case_range="standard",
        along_arms="",
        speeds="",
        approaches="",
        cars=BLIND,
        weather="day",
        weights="",
        near="",
        accidents_within_m=None,
        track_memory_s=math.inf,
    )


def on_study_cases(
    question: Question,
    asked: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    build: Callable[[Question], Setting],
    compute: Compute,
) -> StudyCases | None:
    """What layouts prevent in the study's cases.

    None where these are what was asked about.

    Parameters
    ----------
    question : Question
        What was asked.
    asked : Setting
        What it led to, and the layouts were evaluated in.
    evaluations : mapping of str to Evaluation
        By display name. Where the same frames were looked at there, nobody looks again.
    build : function of Question
        Setting of a question at the same scene.
    compute : Compute
        Of further evaluations.

    Raises
    ------
    InputError
        No arm of the junction carries any of the study's cases.
    """
    given = {case.name for case in select_cases(question.cases).cases}
    has_cases = {case.name for case in select_cases("study").cases} <= given
    if find_baseline(asked.scene) is None or not has_cases:
        return None
    study = build(study_question(question))
    if is_same_question(asked, study):
        return None
    found = evaluate_again(
        [*evaluations.values()], asked, study, compute=compute.within(STAGE)
    )
    return build_study_cases(dict(zip(evaluations, found, strict=True)))


def is_same_question(one: Setting, other: Setting) -> bool:
    """True if two settings have the same runs, weights and rule.

    The runs may be in any order.
    """
    runs, others = (
        dict(zip(axis.run_ids, axis.weight, strict=True))
        for axis in (one.axis, other.axis)
    )
    return (
        one.rule == other.rule
        and runs.keys() == others.keys()
        and all(math.isclose(runs[name], others[name], rel_tol=1.0e-9) for name in runs)
    )


def section(record: StudyCases | None) -> Section | None:
    """The layouts on the study's cases.

    None where these are what was asked about.
    """
    if record is None:
        return None
    return Section(
        "study-cases",
        tr("On the study's cases"),
        [
            tr(
                "The cases of the CarlaNCAP study under its own rules: by day, each "
                "case at one place, every run with equal weight, and a track that "
                "never expires once confirmed. Everything else is as in the question "
                "above. Computed by the evaluator; layouts were not chosen for these "
                "runs."
            ),
            table(record),
        ],
    )


def table(record: StudyCases) -> Table:
    """APR of each layout and of the car by itself.

    A row for all runs, and for each case.
    """
    cases = list(record.parties[0].by_case)
    return Table(
        caption=trn(
            "APR on the study's {n} run", "APR on the study's {n} runs", record.runs
        ),
        columns=[tr("case"), *(tr(party.name) for party in record.parties)],
        rows=[
            [tr("all runs"), *(percent(one.all) for one in record.parties)],
            [
                tr("runs avoided"),
                *(
                    tr("{n} of {n_all}", n=one.runs_avoided, n_all=record.runs)
                    for one in record.parties
                ),
            ],
            *(
                [case, *(percent(one.by_case[case]) for one in record.parties)]
                for case in cases
            ),
        ],
        numeric=range(1, 1 + len(record.parties)),
    )
