"""``place-rsus compare``: any number of layouts on the same runs."""

from pathlib import Path

import click

from placement.question import Question

from ..progress import StageProgress, command_line, print_result, warn_of_slow_rays
from .latency import latency_budget_options
from .options import (
    SectionedCommand,
    WholeNumber,
    json_option,
    no_look_option,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus compare a.json b.json c.json --report results/abc
  place-rsus compare a.json b.json --samples 60     is the difference sure?""",
)
@click.argument("layouts", nargs=-1, metavar="LAYOUT...")
@click.option("--layout", "more_layouts", multiple=True, help="The same as an argument.")
@click.option(
    "--report",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    help="Folder for a report; else none.",
)
@click.option(
    "--samples",
    type=WholeNumber(0, "a number of sampled worlds"),
    default=0,
    help="Compare in so many worlds with mounting errors, traffic, misses and lost messages drawn "
    "at random, too: differences then have a 95 % interval.",
)
@click.option(
    "--uncertainty",
    default="default",
    show_default=True,
    metavar="NAME",
    help="What is drawn: a name, or a .toml file.",
)
@no_look_option("Areas of which the share is told that each camera has in its picture")
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@click.pass_obj
def compare(
    progress: StageProgress,
    *,
    layouts: tuple[str, ...],
    more_layouts: tuple[str, ...],
    samples: int,
    uncertainty: str,
    no_look: str,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    seed: int,
    workers: int,
) -> None:
    """Compare layouts on the same runs: the first against each of the others.

    A layout is carlancap-12 or a layout file, such as layout.json in a folder of results.
    """
    names = (*layouts, *more_layouts)
    if len(names) < 2:
        given = "one layout" if names else "nothing"
        raise click.UsageError(f"LAYOUT: got {given}; expected two layouts or more")
    from ..study.layout import find_layout

    found = [find_layout(name, "LAYOUT") for name in names]
    progress.start(quiet=quiet)
    warn_of_slow_rays()
    from ..jobs import placement
    from ..results.record import to_plain
    from ..results.text import comparison_table
    from .tables import with_additions

    result = placement.run_comparison(
        question,
        layouts=found,
        samples=samples,
        uncertainty=uncertainty,
        no_look=no_look,
        out=out,
        seed=seed,
        workers=workers,
        command=command_line(),
        progress=progress,
    )
    summary = to_plain(result)  # border
    print_result(
        summary, progress, as_json, lambda: with_additions(summary, comparison_table(summary, out))
    )
