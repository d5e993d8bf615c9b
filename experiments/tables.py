"""Results as plain text for a terminal, at most 80 columns wide."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

_WIDTH = 80


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


def _apr_text(columns: dict[str, dict[str, Any]]) -> list[str]:
    cases = next(iter(columns.values()))["by_case"]
    rows = [f"  {'APR':<24} {'all':>8} " + "".join(f"{case:>9} " for case in cases)]
    rows += [
        f"  {_short(name, 24):<24} {_percent(value['all'])} "
        + " ".join(f" {_percent(value['by_case'][case])}" for case in cases)
        for name, value in columns.items()
    ]
    return rows


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
                "these units, fused": evaluation["rsu_all"],
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                "the VUT's camera only": evaluation["vut"],
                "greedy, same number": summary["greedy"]["rsu_all"],
                f"{summary['baseline_name']}, fused": baseline["rsu_all"],
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
                "all units, fused": evaluation["rsu_all"],
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                "the VUT's camera only": evaluation["vut"],
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
                "  and the VUT's camera": evaluation["vut_and_rsus"],
                summary["baseline_name"]: baseline["rsu_all"],
                "  with the VUT's camera": baseline["vut_and_rsus"],
                "the VUT's camera only": evaluation["vut"],
            }
        ),
        *_runs_text("runs gained:", summary["runs_gained"]),
        *_runs_text("runs lost:  ", summary["runs_lost"]),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: report.html and more."]
    return "\n".join(lines)
