"""``place-rsus pareto``: what each further unit, or more money, buys."""

from collections.abc import Sequence
from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import (
    StageProgress,
    cache_folder,
    command_line,
    print_result,
    warn_of_slow_rays,
)
from .latency import latency_budget_options
from .options import (
    OneOf,
    SectionedCommand,
    WholeNumber,
    cache_option,
    json_option,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)
from .planning import planning_options

_TIME_LIMIT_S = 60.0
# A front has every APR and every number of units: what asks for one of them has no place here.
_NOT_ASKED = ("budget", "target", "least", "survive", "stage_weights")


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
@click.option(
    "--max",
    "max_units",
    type=WholeNumber(1, "a whole number of units"),
    default=8,
    show_default=True,
    help="Most units, beside those of --keep.",
)
@click.option(
    "--by",
    type=OneOf(("units", "cost")),
    default="units",
    show_default=True,
    help="What there is more and more of: units, or money for units and sites.",
)
@click.option(
    "--all-stages",
    is_flag=True,
    help="Optimise time to spare and cost, too, not only the APR with and without a failure.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for pareto.csv, pareto.json and pareto.png; else none.",
)
@planning_options(has_samples=False)
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@cache_option
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
    seed: int,
    workers: int,
    uses_cache: bool,
) -> None:
    """What each further unit, or more money, buys: the best layouts, each with its proof.

    For 1, 2, 3 .. units, or from the cheapest useful layout upwards: the highest share of
    accidents prevented (APR), and the highest that is left when any one unit fails.
    """
    progress.start(quiet=quiet)
    from ..jobs.pareto import front_text, run_pareto

    warn_of_slow_rays()
    summary = run_pareto(
        question,
        by=by,
        max_units=max_units,
        all_stages=all_stages,
        out=out,
        compute=Compute(
            seed=seed,
            workers=workers,
            cache_folder=cache_folder() if uses_cache else None,
            progress=progress,
        ),
        command=command_line(),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: front_text(summary, out))


def leave_out(command: click.Command, names: Sequence[str], *, time_limit_s: float) -> None:
    """Take options from a command that shares them with others, and set its time.

    Parameters
    ----------
    command : Command
        It gets the default of what is left out.
    names : sequence of str
        Of the parameters.
    time_limit_s : float
        Default of ``--time-limit``. [s]
    """
    command.params = [param for param in command.params if param.name not in names]
    for param in command.params:
        if param.name == "time_limit_s":
            param.default = time_limit_s


leave_out(pareto, _NOT_ASKED, time_limit_s=_TIME_LIMIT_S)
