"""``place-rsus pareto``: what each further unit, or more money, buys."""

from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from .options import (
    ASKED,
    JUDGED,
    MOUNTED,
    SectionedCommand,
    compute_options,
    fields_in,
    json_option,
    option,
    question_options,
    quiet_option,
)
from .running import begin, command_line, print_result

_TIME_LIMIT_S = 60.0
FRONT_SOUGHT = ("solver", "time_limit_s", "gap", "fusion")
"""Fields of commands that look for several layouts: each in nominal conditions, on the grid."""
# A front has every APR and every number of units: what asks for one of them has no place here.
_ASKED = fields_in(ASKED, MOUNTED, but=("budget", "target", "least", "survive"))


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
@option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for pareto.csv, pareto.json and pareto.png; else none.",
)
@question_options(*_ASKED, *FRONT_SOUGHT, *JUDGED, defaults={"time_limit_s": _TIME_LIMIT_S})
@json_option
@quiet_option
@compute_options(has_cache=True)
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
    begin(progress, quiet=quiet)
    from ..jobs.pareto import front_text, run_pareto

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
