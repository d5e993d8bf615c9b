"""Results as plain text for a terminal, at most 80 columns wide."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_WIDTH = 80
_COLUMN = 13


def _percent(ratio: float) -> str:
    return f"{100.0 * ratio:6.1f} %"


def _short(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _units_text(units: list[dict[str, Any]]) -> list[str]:
    rows = [f"  {'unit':<6} {'site':<11} {'x m':>8} {'y m':>8} {'z m':>6} {'yaw':>7} {'pitch':>7}"]
    rows += [
        f"  {_short(unit['id'], 6):<6} {_short(unit['site'] or '-', 11):<11} "
        f"{unit['x_m']:8.2f} {unit['y_m']:8.2f} {unit['z_m']:6.2f} "
        f"{unit['yaw_deg']:7.1f} {unit['pitch_deg']:7.1f}"
        for unit in units
    ]
    return rows


def _apr_text(parties: dict[str, dict[str, Any]]) -> list[str]:
    """APR by case: a row per case, a column per party, as many columns as fit side by side."""
    cases = list(next(iter(parties.values()))["by_case"])
    first = max(len("all runs"), *map(len, cases)) + 4
    per_block = max(1, (_WIDTH - first) // _COLUMN)
    names = list(parties)
    rows = []
    for start in range(0, len(names), per_block):
        block = names[start : start + per_block]
        heads = [textwrap.wrap(name, _COLUMN - 1, break_on_hyphens=False) for name in block]
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
            rows.append(f"{left:<{first}}" + "".join(f"{word:>{_COLUMN}}" for word in words))
        for case in ("", *cases):
            values = [
                parties[name]["by_case"][case] if case else parties[name]["all"] for name in block
            ]
            rows.append(
                f"  {case or 'all runs':<{first - 2}}"
                + "".join(f"{_percent(value).strip():>{_COLUMN}}" for value in values)
            )
    return [row.rstrip() for row in rows]


def placement_table(summary: dict[str, Any], out: Path) -> str:
    """The main job's result: units, proof, APR of all parties."""
    stages = {stage["name"]: stage for stage in summary["stages"]}
    names = {
        "apr": ("accidents prevented", _percent),
        "apr_one_failed": ("if the worst one fails", _percent),
        "smallest_margin_s": ("smallest margin", lambda value: f"{value:6.3f} s"),
        "mean_margin_s": ("mean margin", lambda value: f"{value:6.3f} s"),
    }
    evaluation, baseline = summary["evaluation"], summary["baseline"]
    lines = [
        f"Best {len(summary['layout'])} of {summary['candidates']} poses on {summary['runs']} runs "
        f"(fusion {summary['fusion']}):",
        *_units_text(summary["layout"]),
        "",
        f"  {'on the detection table':<24} {'found':>9} {'bound':>9} {'gap':>8}",
    ]
    for key, (words, show) in names.items():
        stage = stages[key]
        gap = "proven" if stage["gap"] == 0.0 else f"{100.0 * stage['gap']:.2f} %"
        lines.append(
            f"  {words:<24} {show(stage['objective']):>9} {show(stage['bound']):>9} {gap:>8}"
        )
    lines += [
        "",
        "Evaluated by full perception and emergency braking:",
        *_apr_text(
            {
                "these, fused": evaluation["rsu_all"],
                "and VUT's camera": evaluation["vut_and_rsus"],
                "VUT's camera only": evaluation["vut"],
                "greedy, fused": summary["greedy"]["rsu_all"],
                f"{summary['baseline_name']} fused": baseline["rsu_all"],
            }
        ),
        "",
        f"Table and evaluator disagree on {_percent(summary['surrogate_disagreement']).strip()} "
        "of the runs.",
        f"Written to {out}: report.html and more.",
    ]
    return "\n".join(lines)


def evaluation_table(summary: dict[str, Any], out: Path | None) -> str:
    """One layout's result: units and the APR of each."""
    evaluation = summary["evaluation"]
    lines = [
        f"{summary['name']} on {summary['runs']} runs:",
        *_units_text(summary["layout"]),
        "",
        *_apr_text(
            {
                **evaluation["units"],
                "all, fused": evaluation["rsu_all"],
                "and VUT's camera": evaluation["vut_and_rsus"],
                "VUT's camera only": evaluation["vut"],
            }
        ),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)


def _runs_text(words: str, runs: Sequence[str]) -> list[str]:
    return textwrap.wrap(
        ", ".join(runs) or "none",
        _WIDTH,
        initial_indent=f"  {words} ",
        subsequent_indent=" " * (len(words) + 3),
        break_on_hyphens=False,
    )


def comparison_table(summary: dict[str, Any], out: Path | None) -> str:
    """Two layouts' results side by side, and the runs in which they differ."""
    evaluation, baseline = summary["evaluation"], summary["baseline"]
    lines = [
        f"{summary['name']} against {summary['baseline_name']} on {summary['runs']} runs:",
        *_apr_text(
            {
                summary["name"]: evaluation["rsu_all"],
                f"{summary['name']} and VUT": evaluation["vut_and_rsus"],
                summary["baseline_name"]: baseline["rsu_all"],
                f"{summary['baseline_name']} and VUT": baseline["vut_and_rsus"],
                "VUT's camera only": evaluation["vut"],
            }
        ),
        *_runs_text("runs gained:", summary["runs_gained"]),
        *_runs_text("runs lost:  ", summary["runs_lost"]),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)
