"""What can be done about a layout that hangs, as sentences and as a table for a terminal."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .tables import percent

_WIDTH = 80
_FIRST = 34
_MAX_RUNS = 8


def describe_retrofit(summary: Mapping[str, Any]) -> list[str]:
    """The best change of every kind, in sentences.

    Parameters
    ----------
    summary : mapping
        As :func:`experiments.retrofit_jobs.run_retrofit` builds it.
    """
    sentences = [_removal(summary["removals"])]
    if summary["re_aims"]:
        sentences.append(_re_aim(summary["re_aims"][0]))
    sentences.append(_addition(summary["addition"], summary["budget_eur"]))
    if summary["budget_eur"] is not None:
        sentences.append(_combination(summary["combination"], summary["budget_eur"]))
    return sentences


def retrofit_text(summary: Mapping[str, Any], out: Path | None) -> str:
    """The result of :func:`experiments.retrofit_jobs.run_retrofit` for a terminal."""
    before = summary["before"]
    n_units = len(summary["layout"])
    lines = textwrap.wrap(
        f"What to change about {summary['name']} ({n_units} unit{'' if n_units == 1 else 's'}) on "
        f"{summary['runs']} runs, on the detection table (fusion {summary['fusion']}):",
        _WIDTH,
    )
    lines += [
        "",
        f"  {'':<{_FIRST}} {'EUR':>7} {'APR':>8} {'one fails':>10} {'gained':>6} {'lost':>5}",
        _row("as it is", 0.0, before, ("", "")),
    ]
    for head, changes in (
        ("remove", summary["removals"]),
        ("re-aim", summary["re_aims"]),
        ("add", [summary["addition"]]),
        ("together", [summary["combination"]]),
    ):
        known = [change for change in changes if change is not None]
        if known:
            lines.append(f"  {head}:")
        for change in known:
            lines += _rows(change)
    lines.append("")
    for sentence in summary["sentences"]:
        lines += _wrapped(sentence)
    lines += _wrapped(
        "One fails: APR that is left when the most needed unit fails. A visit costs "
        f"{summary['labour']['re_aim_eur']:,.0f} EUR: {summary['labour']['source']}."
    )
    if out is not None:
        lines += ["", f"Written to {out}: retrofit.csv and retrofit.json."]
    return "\n".join(lines)


def _rows(change: Mapping[str, Any]) -> list[str]:
    words = [action["words"] for action in change["actions"]]
    lines = [line for word in words for line in textwrap.wrap(word, _FIRST - 2)]
    runs = (str(len(change["gained"])), str(len(change["lost"])))
    return [
        _row("  " + lines[0], change["price_eur"], change, runs),
        *(f"    {line}" for line in lines[1:]),
    ]


def _row(words: str, price_eur: float, values: Mapping[str, Any], runs: tuple[str, str]) -> str:
    return (
        f"  {words:<{_FIRST}} {price_eur:7,.0f} {percent(values['apr']):>8} "
        f"{percent(values['apr_one_failed']):>10} {runs[0]:>6} {runs[1]:>5}"
    ).rstrip()


def _removal(removals: Sequence[Mapping[str, Any]]) -> str:
    best = removals[0]
    name = best["actions"][0]["unit"]
    if len(removals) == 1:
        return f"{name} is the only unit: without it, only the car itself is left."
    return (
        f"Of all {len(removals)} units, {name} is needed least: without it "
        f"{_lost(best['lost'])}; {percent(best['apr_one_failed'])} are left when one more fails."
    )


def _lost(runs: Sequence[str]) -> str:
    if not runs:
        return "no run is lost"
    verb = "is" if len(runs) == 1 else "are"
    return f"{_runs(runs)} {verb} lost ({_ids(runs)})"


def _re_aim(best: Mapping[str, Any]) -> str:
    what = _all_words(best)
    if not best["is_better"]:
        return (
            f"No re-aim is better than to leave all as it is: of all {best['compared']}, the best "
            f"one would be to {what}."
        )
    return (
        f"The best of {best['compared']} re-aims, for {_euros(best['price_eur'])}: {what}. "
        f"{_effect(best)}"
    )


def _addition(best: Mapping[str, Any] | None, budget_eur: float | None) -> str:
    limit = "" if budget_eur is None else f" within {_euros(budget_eur)}"
    if best is None:
        return f"No unit that can be added{limit} is better than none."
    return (
        f"The best new unit{limit} costs {_euros(best['price_eur'])}: {_all_words(best)}. "
        f"{_effect(best)}{_proof(best)}"
    )


def _combination(best: Mapping[str, Any] | None, budget_eur: float) -> str:
    if best is None:
        return f"Within {_euros(budget_eur)} nothing is better than to leave all as it is."
    return (
        f"The best re-aims and additions together within {_euros(budget_eur)} cost "
        f"{_euros(best['price_eur'])}: {_all_words(best)}. {_effect(best)}{_proof(best)}"
    )


def _all_words(change: Mapping[str, Any]) -> str:
    return "; ".join(action["words"] for action in change["actions"])


def _effect(change: Mapping[str, Any]) -> str:
    parts = []
    if change["gained"]:
        parts.append(f"gains {_runs(change['gained'])} ({_ids(change['gained'])})")
    if change["lost"]:
        parts.append(f"loses {_runs(change['lost'])} ({_ids(change['lost'])})")
    if not parts:
        parts.append("avoids the same runs")
    return (
        f"It {' and '.join(parts)}; APR {percent(change['apr'])}, "
        f"{percent(change['apr_one_failed'])} when one fails, "
        f"{change['mean_margin_s']:.2f} s of mean time to spare."
    )


def _proof(change: Mapping[str, Any]) -> str:
    if change["is_proven"]:
        return " Proven: nothing of its kind is better."
    return " Not proven in the time given."


def _runs(runs: Sequence[str]) -> str:
    return "1 run" if len(runs) == 1 else f"{len(runs)} runs"


def _ids(runs: Sequence[str]) -> str:
    shown = ", ".join(runs[:_MAX_RUNS])
    return shown if len(runs) <= _MAX_RUNS else f"{shown} and {len(runs) - _MAX_RUNS} more"


def _euros(amount: float) -> str:
    return f"{amount:,.0f} EUR"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(
        text, _WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
    )
