"""What happens when units fail: in sentences and tables."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from placement.evaluation import Evaluation
from placement.explain.contributions import (
    MAX_PAIR_UNITS,
    Failure,
    Failures,
    find_failures,
)
from scenarios.aeb import AebRule

from ..results.numbers import NOTHING, count_runs, number, percent

MAX_ROWS = 12
"""Rows of a table: beyond, only the worst are shown."""

_MAX_RUNS = 4
_MS = 1000.0


def failure_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    """What the failure of any one unit, and of any two, leaves.

    Parameters
    ----------
    failures : Failures
        Of a layout.
    labels : mapping of str to str
        Short names of the units, by id.
    """
    whole, n_units = failures.none_failed, len(failures.one_failed)
    if n_units == 1:
        return [
            f"There is one unit. If it fails, nothing is left of the {percent(whole.apr)} that it "
            "prevents but what the car prevents by itself."
        ]
    return [
        f"All {n_units} units together prevent {percent(whole.apr)}.",
        *_one_sentences(failures, labels),
        *_two_sentences(failures, labels),
    ]


def _one_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    worst, n_units = failures.one_failed[0], len(failures.one_failed)
    n_harmless = sum(not item.lost_run_ids for item in failures.one_failed)
    if n_harmless == n_units:
        text = "Whichever one fails, the others avoid every run that all avoid together"
        least_s = min(item.smallest_margin_s for item in failures.one_failed)
        if math.isnan(least_s):  # there is no such run
            return [f"{text}."]
        return [f"{text}; the least time to spare is then {_ms(least_s)}."]
    text = (
        f"If {_names(worst, labels)} fails, the others still prevent {percent(worst.apr)}; "
        f"{count_runs(len(worst.lost_run_ids))} {_verb(len(worst.lost_run_ids))} lost. "
        "No single failure leaves less."
    )
    if n_harmless:
        text += f" {n_harmless} of the {n_units} units can fail by themselves and no run is lost."
    return [text]


def _two_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    n_units = len(failures.one_failed)
    if not failures.two_failed:
        return [f"Pairs are looked at for up to {MAX_PAIR_UNITS} units; there are {n_units}."]
    if n_units == 2:
        return ["If both fail, only the car itself is left."]
    worst, n_pairs = failures.two_failed[0], len(failures.two_failed)
    n_harmless = sum(not item.lost_run_ids for item in failures.two_failed)
    if n_harmless == n_pairs:
        return ["Any two may fail at once, and no run is lost."]
    return [
        f"Of two that fail at once, {_names(worst, labels)} matter most: {percent(worst.apr)} are "
        f"left. {n_harmless} of the {n_pairs} pairs can fail and no run is lost."
    ]


def failure_table(
    failures: Sequence[Failure], labels: Mapping[str, str], *, n_together: int
) -> dict[str, Any]:
    """A row per failure, the worst first.

    Parameters
    ----------
    failures : sequence of Failure
        Of one unit each, or of two.
    labels : mapping of str to str
        Short names of the units, by id.
    n_together : int
        1 or 2: how many units fail at once.

    Returns
    -------
    table : dict
        Caption, columns and rows, at most ``MAX_ROWS``; the caption says what is left out.
    """
    what, many = ("one unit fails", "units") if n_together == 1 else ("two units fail", "pairs")
    caption = f"If {what}"
    if len(failures) > MAX_ROWS:
        caption += f": the {MAX_ROWS} worst of {len(failures)} {many}"
    return {
        "caption": caption,
        "columns": [
            "fails" if n_together == 1 else "fail",
            "APR of the rest",
            "smallest margin of the rest (ms)",
            "runs lost",
            "which",
        ],
        "rows": [
            [
                _names(item, labels),
                percent(item.apr),
                number(item.smallest_margin_s * _MS, 0),
                str(len(item.lost_run_ids)),
                _first_runs(item.lost_run_ids),
            ]
            for item in failures[:MAX_ROWS]
        ],
    }


def failures_part(
    evaluation: Evaluation, rule: AebRule, labels: Mapping[str, str]
) -> dict[str, Any]:
    """What ``templates/failures.html.j2`` shows.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout that is reported.
    rule : AebRule
        Confirmation and latency.
    labels : mapping of str to str
        Short names of its units, by id.

    Returns
    -------
    part : dict
        Sentences, and tables of single failures and of pairs; none of pairs where they say nothing
        new or are not looked at.
    """
    failures = find_failures(evaluation, rule)
    tables = [failure_table(failures.one_failed, labels, n_together=1)]
    if len(failures.two_failed) > 1:
        tables.append(failure_table(failures.two_failed, labels, n_together=2))
    return {"sentences": failure_sentences(failures, labels), "tables": tables}


def _names(failure: Failure, labels: Mapping[str, str]) -> str:
    return " and ".join(labels.get(unit_id, unit_id) for unit_id in failure.unit_ids)


def _first_runs(run_ids: Sequence[str]) -> str:
    if not run_ids:
        return NOTHING
    listed = ", ".join(run_ids[:_MAX_RUNS])
    n_left = len(run_ids) - _MAX_RUNS
    return f"{listed} and {n_left} more" if n_left > 0 else listed


def _verb(count: int) -> str:
    return "is" if count == 1 else "are"


def _ms(seconds: float) -> str:
    return f"{number(seconds * _MS, 0)}\N{NO-BREAK SPACE}ms"
