"""``place-rsus pareto``: what each further unit, or more money, buys."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from ..results.numbers import cars_words, or_nan, percent
from .options import (
    ASKED,
    JUDGED,
    MOUNTED,
    Decorator,
    SectionedCommand,
    fields_in,
    folder_option,
    job_options,
    option,
    question_options,
)
from .running import begin, command_line, print_result
from .terminal import driven_lines, sentences, table

if TYPE_CHECKING:
    from ..parts.front import FrontPointRecord, FrontResult

_TIME_LIMIT_S = 60.0
# Several layouts are looked for: each in nominal conditions, on the grid.
_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
# A front has every APR and every number of units: what asks for one of them has no place here.
_ASKED = fields_in(ASKED, MOUNTED, but=("budget", "target", "least", "survive"))


def front_options(*asked: str) -> Decorator:
    """Options of a question for commands that look for several layouts, each with its own time."""
    defaults = {"time_limit_s": _TIME_LIMIT_S}
    return question_options(*asked, *_SOUGHT, *JUDGED, defaults=defaults)


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus pareto --max 8                        what each further unit buys
  place-rsus pareto --max 4 --all-stages           time to spare, too
  place-rsus pareto --by cost --site-cost 2000     what more money buys
  place-rsus pareto --keep carlancap-12 --max 3    what more units buy there
  place-rsus pareto --max 5 --out results/pareto --json""",
)
@option(
    "--max",
    "max_units",
    type=click.IntRange(min=1),
    metavar="N",
    expected="a whole number of units, at least 1",
    default=8,
    show_default=True,
    help="Most units, beside those of --keep.",
)
@option(
    "--by",
    type=click.Choice(("units", "cost")),
    default="units",
    show_default=True,
    help="What there is more and more of: units, or money for units and sites.",
)
@option(
    "--all-stages",
    is_flag=True,
    help="Optimise time to spare and cost, too, not only the APR with and without a failure.",
)
@folder_option("pareto.csv, pareto.json and pareto.png")
@front_options(*_ASKED)
@job_options(has_cache=True)
@click.pass_obj
def pareto(
    progress: StageProgress,
    *,
    max_units: int,
    by: str,
    all_stages: bool,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """What each further unit, or more money, buys: the best layouts, each with its proof.

    For 1, 2, 3 .. units, or from the cheapest useful layout upwards: the highest share of
    accidents prevented (APR), and the highest that is left when any one unit fails.
    """
    question = begin(progress, question, quiet=quiet)
    from ..parts.front import run_pareto

    summary = run_pareto(
        question,
        by=by,
        max_units=max_units,
        all_stages=all_stages,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: front_text(summary, out))


_ONE_FAILS = "One fails: APR that is left when the most needed unit fails"
_NOTES = {
    ("units", True): f"{_ONE_FAILS}; smallest, mean: time to spare in the runs avoided.",
    ("units", False): "* of this layout; not optimised: --all-stages does. "
    f"{_ONE_FAILS}; smallest, mean: time to spare in the runs avoided.",
    ("cost", False): "* of this layout; not optimised: --all-stages does. "
    f"{_ONE_FAILS}; each EUR is the least that buys this.",
}
_NOTES["cost", True] = _NOTES["units", True]


def front_text(summary: "FrontResult", out: Path | None) -> str:
    """A front: a row per layout, and what each unit, or more money, buys."""
    by, is_all = summary.by, summary.optimised == "all"
    star = "" if is_all else "*"
    rows = [
        [
            str(point.units),
            percent(point.apr),
            percent(point.apr_one_failed),
            f"{point.smallest_margin_s:.3f} s",
            f"{point.mean_margin_s:.3f} s",
            f"{point.cost_eur:,.0f}",
            _proof(point),
        ]
        for point in summary.points
    ]
    eur = "EUR" + star if by == "units" else "EUR"
    heads = ["units", "APR", "one fails", "smallest" + star, "mean" + star, eur, "proof"]
    buys = "money buys" if by == "cost" else "units buy"
    lines = [
        *driven_lines(summary.driven, summary.without_effect),
        *sentences(
            f"The best of {summary.candidates} poses on {summary.runs} runs (fusion "
            f"{summary.fusion}{cars_words(summary.cars)}), and what more {buys}:"
        ),
        "",
        *table(heads, rows, n_left=0),
        *sentences(_NOTES[by, is_all], indent=2, hanging=2),
        "",
        *sentences(*summary.sentences, indent=2, hanging=2),
    ]
    if out is not None:
        lines += ["", f"Written to {out}: pareto.csv, pareto.json and pareto.png."]
    return "\n".join(lines)


def _proof(point: "FrontPointRecord") -> str:
    if point.is_proven:
        return "proven"
    stage = next(stage for stage in point.stages if stage.gap != 0.0)
    name, bound = stage.name, or_nan(stage.bound)
    what = {"apr": "APR", "apr_one_failed": "left", "cost_eur": "EUR"}.get(name, "s")
    if name.startswith("apr"):
        shown = f"{100.0 * bound:.2f} %"
    else:
        shown = f"{bound:,.0f}" if bound >= 100.0 else f"{bound:.3f}"
    return f"{what} {'>=' if name == 'cost_eur' else '<='} {shown}"
