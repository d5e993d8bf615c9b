"""APR against latency as plain text for a terminal."""

import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .tables import percent

_WIDTH, _FIRST, _COLUMN = 80, 26, 15
_COLUMNS = {"rsu_all": "RSUs, fused", "vut_and_rsus": "VUT and RSUs", "vut": "VUT alone"}
_OTHERS = {"vam": "VAM alone", "all_sources": "all and VAM"}
_NOTE = (
    "expected: over all latencies of the budget, not at the mean one; fused: in each frame, any of "
    "the units may detect. A run counts as avoided if its last moment to brake is not over."
)


def latency_text(summary: Mapping[str, Any], out: Path | None) -> str:
    """The result of :func:`experiments.latency_jobs.run_latency` for a terminal."""
    parties, budget = summary["parties"], summary["budget"]
    heads = [f"{head:>{_COLUMN}}" for head in _COLUMNS.values()]
    lines = [
        *textwrap.wrap(f"{summary['name']} on {summary['runs']} runs:", _WIDTH),
        f"{'  APR at a latency of':<{_FIRST}}" + "".join(heads),
    ]
    for index, entry in enumerate(parties["rsu_all"]["at"]):
        values = [percent(parties[name]["at"][index]["apr"]) for name in _COLUMNS]
        lines.append(_row(_ms(entry["latency_s"]), values))
    lines += ["", "  longest latency that leaves an APR of"]
    for index, entry in enumerate(parties["rsu_all"]["longest"]):
        values = [_longest(parties[name]["longest"][index]["latency_s"]) for name in _COLUMNS]
        lines.append(_row(f"{100.0 * entry['apr']:g} %", values))
    lines += ["", *_budget_text(budget), "", *_parties_text(parties)]
    notes = _NOTE + _own_latencies(summary)
    lines += textwrap.wrap(
        notes, _WIDTH, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False
    )
    if out is not None:
        lines += ["", f"Written to {out}: latency.csv and latency.png."]
    return "\n".join(lines)


def _row(first: str, values: Sequence[str]) -> str:
    return f"{first:>{_FIRST - 8}}" + " " * 8 + "".join(f"{value:>{_COLUMN}}" for value in values)


def _ms(latency_s: float) -> str:
    return f"{1000.0 * latency_s:.4g} ms"


def _longest(latency_s: float) -> str:
    if math.isinf(latency_s):
        return "any" if latency_s > 0.0 else "none"
    # Rounded down: with what is printed the APR still holds.
    return f"{math.floor(10000.0 * latency_s + 1.0e-5) / 10.0:.1f} ms"


def _budget_text(budget: Mapping[str, Any]) -> list[str]:
    lines = [f"{'  latency budget ' + budget['name']:<36}{'least':>10}{'mean':>10}{'most':>10}"]
    for part in budget["parts"]:
        mean_s = 0.5 * (part["low_s"] + part["high_s"])
        mark = "  (assumption)" if part["is_assumption"] else ""
        lines.append(_budget_row(part["name"], part["low_s"], mean_s, part["high_s"]) + mark)
    if len(budget["parts"]) > 1:
        total = (budget["best_s"], budget["mean_s"], budget["worst_s"])
        lines.append(_budget_row("all together", *total))
    return lines


def _budget_row(name: str, *times_s: float) -> str:
    short = name if len(name) <= 31 else name[:30] + "\N{HORIZONTAL ELLIPSIS}"
    return f"    {short:<32}" + "".join(f"{_ms(time_s):>10}" for time_s in times_s)


def _parties_text(parties: Mapping[str, Any]) -> list[str]:
    names = {
        **_COLUMNS,
        **{name: name for name in parties if name not in (*_COLUMNS, *_OTHERS)},
        **{name: words for name, words in _OTHERS.items() if name in parties},
    }
    lines = [
        f"{'  APR within the budget':<{_FIRST}}"
        f"{'expected':>{_COLUMN}}{'at the mean':>{_COLUMN}}{'at the worst':>{_COLUMN}}"
    ]
    for name, words in names.items():
        short = words if len(words) <= 21 else words[:20] + "\N{HORIZONTAL ELLIPSIS}"
        values = [percent(parties[name][key]) for key in ("expected", "at_mean", "at_worst")]
        lines.append(
            f"    {short:<{_FIRST - 4}}" + "".join(f"{value:>{_COLUMN}}" for value in values)
        )
    return lines


def _own_latencies(summary: Mapping[str, Any]) -> str:
    own = {unit["id"]: unit["latency_s"] for unit in summary["layout"] if "latency_s" in unit}
    if summary["vut_latency_s"] is not None:
        own["the VUT"] = summary["vut_latency_s"]
    note = "" if "the VUT" in own else " The VUT's own sensors take as long; see --vut-latency."
    if not own:
        return note
    words = ", ".join(f"{name} {_ms(latency_s)}" for name, latency_s in own.items())
    return f"{note} Kept at every latency, as their own: {words}."
