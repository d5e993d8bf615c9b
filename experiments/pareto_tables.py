"""A front of layouts as plain text for a terminal."""

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .tables import percent

_WIDTH = 80
_STAGES = ("apr", "apr_one_failed", "smallest_margin_s", "mean_margin_s", "cost_eur")


def front_text(summary: Mapping[str, Any], out: Path | None) -> str:
    """The result of :func:`experiments.pareto_jobs.run_pareto` for a terminal."""
    points = summary["points"]
    is_all = summary["optimised"] == "all"
    star = "" if is_all else "*"
    lines = [
        *textwrap.wrap(
            f"The best of {summary['candidates']} poses on {summary['runs']} runs (fusion "
            f"{summary['fusion']}), and what more {_budget(summary['by'])}:",
            _WIDTH,
        ),
        "",
        f"  {'units':>5} {'APR':>9} {'one fails':>10} {'smallest' + star:>10} {'mean' + star:>9} "
        f"{'EUR' + star if summary['by'] == 'units' else 'EUR':>10}  proof",
    ]
    lines += [_row(point) for point in points]
    if not is_all:
        lines += _wrapped(
            "* of this layout; not optimised: --all-stages does. One fails: APR that is left when "
            "the most needed unit fails; smallest, mean: time to spare in the runs avoided."
            if summary["by"] == "units"
            else "* of this layout; not optimised: --all-stages does. One fails: APR that is left "
            "when the most needed unit fails; each EUR is the least that buys this."
        )
    else:
        lines += _wrapped(
            "One fails: APR that is left when the most needed unit fails; smallest, mean: time to "
            "spare in the runs avoided."
        )
    lines.append("")
    for sentence in summary["sentences"]:
        lines += _wrapped(sentence)
    if out is not None:
        lines += ["", f"Written to {out}: pareto.csv, pareto.json and pareto.png."]
    return "\n".join(lines)


def _row(point: Mapping[str, Any]) -> str:
    return (
        f"  {point['units']:>5} {percent(point['apr']):>9} {percent(point['apr_one_failed']):>10} "
        f"{point['smallest_margin_s']:8.3f} s {point['mean_margin_s']:7.3f} s "
        f"{point['cost_eur']:>10,.0f}  {_proof(point)}"
    )


def _proof(point: Mapping[str, Any]) -> str:
    if point["is_proven"]:
        return "proven"
    stage = next(stage for stage in point["stages"] if stage["gap"] != 0.0)
    show = _share if stage["name"].startswith("apr") else _number
    what = {"apr": "APR", "apr_one_failed": "left", "cost_eur": "EUR"}.get(stage["name"], "s")
    sign = ">=" if stage["name"] == "cost_eur" else "<="
    return f"{what} {sign} {show(stage['bound'])}"


def _share(value: float) -> str:
    return f"{100.0 * value:.2f} %"


def _number(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3f}"


def _budget(by: str) -> str:
    return "money buys" if by == "cost" else "units buy"


def _wrapped(text: str) -> list[str]:
    """Lines that keep numbers and their units together."""
    text = re.sub(r"(\d) (%|EUR\b|s\b)", "\\1\0\\2", text)
    lines = textwrap.wrap(
        text, _WIDTH, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
    )
    return [line.replace("\0", " ") for line in lines]
