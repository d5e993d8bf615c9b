"""Results as plain text for a terminal, at most 80 columns wide."""

import math
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .numbers import percent

_WIDTH = 80
_COLUMN, _NARROWEST, _WIDEST = 13, 9, 20


_MAX_ID_WIDTH = 22
_MAX_DISAGREEMENTS = 5
_MAX_UNITS = 24
_TOGETHER = "fused: in each frame, any of the units may detect"


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _units_text(units: list[dict[str, Any]]) -> list[str]:
    # Ids are the heads of columns further down: they are cut only where they must be.
    width = min(max(6, *(len(unit["id"]) for unit in units)), _MAX_ID_WIDTH)
    rows = [
        f"  {'unit':<{width}} {'site':<11} {'x m':>8} {'y m':>8} {'z m':>6} {'yaw':>7} {'pitch':>7}"
    ]
    rows += [
        f"  {_short(unit['id'], width):<{width}} {_short(unit['site'] or '-', 11):<11} "
        f"{unit['x_m']:8.2f} {unit['y_m']:8.2f} {unit['z_m']:6.2f} "
        f"{unit['yaw_deg']:7.1f} {unit['pitch_deg']:7.1f}"
        for unit in units
    ]
    return rows


def _apr_text(parties: dict[str, dict[str, Any]]) -> list[str]:
    """APR by case: a row per case, a column per party, as many columns as fit side by side."""
    cases = list(next(iter(parties.values()))["by_case"])
    first = max(len("all runs"), *map(len, cases)) + 4
    names = list(parties)
    column = _column_width(names, _WIDTH - first)
    per_block = max(1, (_WIDTH - first) // column)
    rows = []
    for start in range(0, len(names), per_block):
        block = names[start : start + per_block]
        heads = [textwrap.wrap(name, column - 1, break_on_hyphens=False) for name in block]
        height = max(map(len, heads))
        if start:
            rows.append("")
        for line in range(height):
            # Words end on the last line of the head.
            words = [
                head[line - height + len(head)] if line >= height - len(head) else ""
                for head in heads
            ]
            left = "  APR" if line == height - 1 else ""
            rows.append(f"{left:<{first}}" + "".join(f"{word:>{column}}" for word in words))
        for case in ("", *cases):
            values = [
                parties[name]["by_case"][case] if case else parties[name]["all"] for name in block
            ]
            rows.append(
                f"  {case or 'all runs':<{first - 2}}"
                + "".join(f"{percent(value):>{column}}" for value in values)
            )
    return [row.rstrip() for row in rows]


def _column_width(names: Sequence[str], width: int) -> int:
    """The widest column that needs the fewest blocks and breaks no word that it need not break."""
    longest = max(len(word) for name in names for word in name.split())
    if _COLUMN <= longest < _WIDEST:
        return longest + 1
    widths = range(_COLUMN, max(_NARROWEST, min(longest + 1, _COLUMN)) - 1, -1)
    return min(widths, key=lambda column: math.ceil(len(names) / max(1, width // column)))


def _gap(gap: float) -> str:
    return f"{100.0 * gap:.2f} %" if math.isfinite(gap) else "open"


def _explained(*heads: str) -> list[str]:
    return textwrap.wrap(
        "; ".join(heads) + ".", _WIDTH, initial_indent="  ", subsequent_indent="  "
    )


def _seconds(value: float) -> str:
    return f"{value:6.3f} s"


_OBJECTIVES: dict[str, tuple[str, Callable[[float], str]]] = {
    "units": ("units", "{:.0f}".format),
    "apr_survived": ("if the worst ones fail", percent),
    "apr": ("accidents prevented", percent),
    "apr_one_failed": ("if the worst one fails", percent),
    "smallest_margin_s": ("smallest margin", _seconds),
    "mean_margin_s": ("mean margin", _seconds),
    "cost_eur": ("cost, EUR", "{:,.0f}".format),
    "weighted": ("weighted sum", "{:.4f}".format),
}


def placement_table(summary: dict[str, Any], out: Path) -> str:
    """The main job's result: units, proof, APR of all parties."""
    evaluation, baseline = summary["evaluation"], summary["baseline"]
    lines = [
        f"Best {len(summary['layout'])} of {summary['candidates']} poses on {summary['runs']} runs "
        f"(fusion {summary['fusion']}):",
        *_units_text(summary["layout"]),
        _cost_text(summary),
        "",
        f"  {'on the detection table':<24} {'found':>9} {'bound':>9} {'gap':>8}",
    ]
    for stage in summary["stages"]:
        words, show = _OBJECTIVES[stage["name"]]
        gap = "proven" if stage["gap"] == 0.0 else _gap(stage["gap"])
        lines.append(
            f"  {words:<24} {show(stage['objective']):>9} {show(stage['bound']):>9} {gap:>8}"
        )
    lines += [
        "",
        "Evaluated by full perception and emergency braking:",
        *_apr_text(
            {
                "these, fused": evaluation["rsu_all"],
                "with the VUT": evaluation["vut_and_rsus"],
                "VUT alone": evaluation["vut"],
                "greedy, fused": summary["greedy"]["rsu_all"],
                **({f"{summary['baseline_name']} fused": baseline["rsu_all"]} if baseline else {}),
                **_announced(evaluation),
            }
        ),
        *_explained(_TOGETHER, "greedy: units chosen one by one"),
        "",
        f"Table and evaluator disagree on {percent(summary['surrogate_disagreement'])} "
        "of the runs.",
        *_disagreements(summary["disagreements"]),
        f"Written to {out}: report.html and more.",
    ]
    return "\n".join(lines)


def _cost_text(summary: dict[str, Any]) -> str:
    return f"  sensors: {summary['cost_eur']:,.0f} EUR by the catalogue, without poles or mounting"


def _announced(evaluation: dict[str, Any]) -> dict[str, Any]:
    """Columns for road users who announce themselves, where there are any."""
    words = {"vam": "VAM alone", "all_sources": "all and VAM"}
    return {words[key]: evaluation[key] for key in words if key in evaluation}


def _disagreements(disagreements: list[dict[str, Any]]) -> list[str]:
    """One entry per unit and run that they see differently, the first few."""
    lines = []
    for entry in disagreements[:_MAX_DISAGREEMENTS]:
        verdict = "table avoids" if entry["on_table"] else "evaluator avoids"
        lines += textwrap.wrap(
            f"{entry['party']} in {entry['run_id']}: only the {verdict}; {entry['cause']}",
            _WIDTH,
            initial_indent="  ",
            subsequent_indent="    ",
        )
    n_left = len(disagreements) - _MAX_DISAGREEMENTS
    return lines + ([f"  and {n_left} more in summary.json"] if n_left > 0 else [])


def evaluation_table(summary: dict[str, Any], out: Path | None) -> str:
    """One layout's result: units and the APR of each; of many units, those of the highest APR."""
    evaluation = summary["evaluation"]
    units = dict(
        sorted(evaluation["units"].items(), key=lambda item: item[1]["all"], reverse=True)
        if len(evaluation["units"]) > _MAX_UNITS
        else evaluation["units"].items()
    )
    shown = dict([*units.items()][:_MAX_UNITS])
    lines = [
        *textwrap.wrap(f"{summary['name']} on {summary['runs']} runs:", _WIDTH),
        *_units_text([unit for unit in summary["layout"] if unit["id"] in shown]),
        *_left_out(len(units) - len(shown), out),
        _cost_text(summary),
        "",
        *_apr_text(
            {
                **shown,
                "all, fused": evaluation["rsu_all"],
                "with the VUT": evaluation["vut_and_rsus"],
                "VUT alone": evaluation["vut"],
                **_announced(evaluation),
            }
        ),
        *_explained("each unit by itself", _TOGETHER),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)


def _left_out(n_left: int, out: Path | None) -> list[str]:
    if not n_left:
        return []
    place = "apr.csv" if out is not None else "apr.csv with --out"
    return [f"  and {n_left} more units, none of a higher APR by itself: in {place}"]


def _runs_text(words: str, runs: Sequence[str]) -> list[str]:
    return textwrap.wrap(
        ", ".join(runs) or "none",
        _WIDTH,
        initial_indent=f"  {words} ",
        subsequent_indent=" " * (len(words) + 3),
        break_on_hyphens=False,
    )


def comparison_table(summary: dict[str, Any], out: Path | None) -> str:
    """Layouts' results side by side, and the runs in which the first differs from each other."""
    evaluation, others = summary["evaluation"], summary["compared"]
    parties = {
        summary["name"]: evaluation["rsu_all"],
        f"{summary['name']} and VUT": evaluation["vut_and_rsus"],
    }
    for other in others:
        parties[other["name"]] = other["evaluation"]["rsu_all"]
        parties[f"{other['name']} and VUT"] = other["evaluation"]["vut_and_rsus"]
    names = ", ".join(other["name"] for other in others)
    lines = [
        *textwrap.wrap(f"{summary['name']} against {names} on {summary['runs']} runs:", _WIDTH),
        *_apr_text(parties | {"VUT alone": evaluation["vut"]}),
        *_explained("each layout's units are " + _TOGETHER),
    ]
    for other in others:
        over = f" over {other['name']}" if len(others) > 1 else ""
        lines += [
            *_runs_text(f"runs gained{over}:", other["runs_gained"]),
            *_runs_text(f"runs lost{over}:".ljust(len(f"runs gained{over}:")), other["runs_lost"]),
        ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)
