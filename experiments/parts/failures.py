"""Failures of units and poles, in sentences and tables."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from placement.evaluation import Evaluation
from placement.explain.contributions import MAX_PAIR_UNITS, Failure, Failures, find_failures
from scenarios.aeb import AebRule

from ..results.numbers import NOTHING, count_runs, first_of, milliseconds, number, percent
from .section import Section, Table, tabulate

MAX_ROWS = 12
"""Rows of a table: beyond, only the worst are shown."""

_MAX_RUNS = 4


def failure_sentences(failures: Failures, labels: Mapping[str, str]) -> list[str]:
    """APR that remains if one unit, two, or a pole fail; `labels` are names by id."""
    whole, n_units = failures.none_failed, len(failures.one_failed)
    if n_units == 1:
        return [
            f"There is one unit. If it fails, nothing is left of the {percent(whole.apr)} that it "
            "prevents but what the car prevents by itself."
        ]
    return [
        f"All {n_units} units together prevent {percent(whole.apr)}.",
        _if_one_fails(failures, labels),
        _if_two_fail(failures, labels),
        *([_if_a_pole_fails(failures, labels)] if failures.site_failed else []),
    ]


def _if_one_fails(failures: Failures, labels: Mapping[str, str]) -> str:
    worst, n_units = failures.one_failed[0], len(failures.one_failed)
    n_harmless = sum(not item.lost_run_ids for item in failures.one_failed)
    if n_harmless == n_units:
        text = "Whichever one fails, the others avoid every run that all avoid together"
        least_s = min(item.smallest_margin_s for item in failures.one_failed)
        if math.isnan(least_s):  # there is no such run
            return f"{text}."
        return f"{text}; the least time to spare is then {milliseconds(least_s)}."
    text = (
        f"If {_names(worst, labels)} fails, the others still prevent {percent(worst.apr)}; "
        f"{_runs_are(worst)} lost. No single failure leaves less."
    )
    if n_harmless:
        text += f" {n_harmless} of the {n_units} units can fail by themselves and no run is lost."
    return text


def _if_two_fail(failures: Failures, labels: Mapping[str, str]) -> str:
    n_units, pairs = len(failures.one_failed), failures.two_failed
    n_harmless = sum(not item.lost_run_ids for item in pairs)
    if not pairs:
        return f"Pairs are looked at for up to {MAX_PAIR_UNITS} units; there are {n_units}."
    if n_units == 2:
        return "If both fail, only the car itself is left."
    if n_harmless == len(pairs):
        return "Any two may fail at once, and no run is lost."
    return (
        f"Of two that fail at once, {_names(pairs[0], labels)} matter most: "
        f"{percent(pairs[0].apr)} are left. {n_harmless} of the {len(pairs)} pairs can fail and no "
        "run is lost."
    )


def _if_a_pole_fails(failures: Failures, labels: Mapping[str, str]) -> str:
    worst = failures.site_failed[0]
    if all(len(item.unit_ids) == 1 for item in failures.site_failed):
        return "No two units share a pole: a pole that fails takes one unit with it."
    text = "A pole fails with all its units (power, a crash). "
    if not worst.lost_run_ids:
        return f"{text}Whichever one does, no run is lost."
    return (
        f"{text}If that of {_names(worst, labels)} does, {percent(worst.apr)} are left and "
        f"{_runs_are(worst)} lost; no other pole leaves less."
    )


def failure_table(
    failures: Sequence[Failure], labels: Mapping[str, str], *, of: Literal["unit", "pair", "pole"]
) -> Table:
    """A row per failure of a unit, of two, or of a pole, the worst first, ``MAX_ROWS`` at most."""
    what, many, head = {
        "unit": ("one unit fails", " units", "fails"),
        "pair": ("two units fail", " pairs", "fail"),
        "pole": ("one pole fails", "", "its units"),
    }[of]
    caption = f"If {what}"
    if len(failures) > MAX_ROWS:
        caption += f": the {MAX_ROWS} worst of {len(failures)}{many}"
    pole: dict[str, Callable[[Failure], str]] = {"pole": lambda item: item.site_id}
    columns: dict[str, Callable[[Failure], str]] = (pole if of == "pole" else {}) | {
        head: lambda item: _names(item, labels),
        "APR of the rest": lambda item: percent(item.apr),
        "smallest margin of the rest (ms)": lambda item: number(1000.0 * item.smallest_margin_s, 0),
        "runs lost": lambda item: str(len(item.lost_run_ids)),
        "which": lambda item: first_of(item.lost_run_ids, _MAX_RUNS) or NOTHING,
    }
    numeric = range(len(columns) - 4, len(columns) - 1)
    return tabulate(caption, failures[:MAX_ROWS], columns, numeric=numeric)


def failures_section(evaluation: Evaluation, rule: AebRule, labels: Mapping[str, str]) -> Section:
    """What remains if a unit fails, or two, or a pole; `labels` are short names of units by id."""
    failures = find_failures(evaluation, rule)
    tables = [failure_table(failures.one_failed, labels, of="unit")]
    if len(failures.two_failed) > 1:
        tables.append(failure_table(failures.two_failed, labels, of="pair"))
    if any(len(item.unit_ids) > 1 for item in failures.site_failed):
        tables.append(failure_table(failures.site_failed, labels, of="pole"))
    whose = (
        "What the evaluator sees with each unit, and with the car's own sensors, which never fail."
        if evaluation.cars == 1.0
        else "Roadside units only, from what the evaluator sees with each; what the car sees by "
        "itself comes on top."
    )
    note = (
        f"{whose} A run is lost if all units together avoid it and those that are left do "
        "not; the fastest ones are named first."
    )
    sentences = " ".join(failure_sentences(failures, labels))
    return Section("failures", "If a unit or a pole fails", [sentences, *tables, note])


def _names(failure: Failure, labels: Mapping[str, str]) -> str:
    return " and ".join(labels.get(unit_id, unit_id) for unit_id in failure.unit_ids)


def _runs_are(failure: Failure) -> str:
    n_lost = len(failure.lost_run_ids)
    return f"{count_runs(n_lost)} {'is' if n_lost == 1 else 'are'}"
