"""``place-rsus compare``: any number of layouts on the same runs."""

from pathlib import Path
from typing import Any

import click

from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    SectionedCommand,
    compute_options,
    json_option,
    option,
    question_options,
    quiet_option,
)
from .running import begin, command_line, print_result


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus compare a.json b.json c.json --report results/abc
  place-rsus compare a.json b.json --samples 60     is the difference sure?""",
)
@click.argument("layouts", nargs=-1, metavar="LAYOUT...")
@option("--layout", "more_layouts", multiple=True, help="The same as an argument.")
@option(
    "--report",
    "--out",
    "out",
    type=click.Path(path_type=Path),
    help="Folder for a report; else none.",
)
@question_options("samples", "uncertainty", "no_look", *JUDGED)
@json_option
@quiet_option
@compute_options()
@click.pass_obj
def compare(
    progress: StageProgress,
    *,
    layouts: tuple[str, ...],
    more_layouts: tuple[str, ...],
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Any,
) -> None:
    """Compare layouts on the same runs: the first against each of the others.

    A layout is carlancap-12 or a layout file, such as layout.json in a folder of results. With
    --samples, differences have a 95 % interval.
    """
    names = (*layouts, *more_layouts)
    if len(names) < 2:
        given = "one layout" if names else "nothing"
        raise click.UsageError(f"LAYOUT: got {given}; expected two layouts or more")
    from ..study.layout import find_layout

    found = [find_layout(name, "LAYOUT") for name in names]
    begin(progress, quiet=quiet)
    from ..jobs import placement

    summary = placement.run_comparison(
        question,
        layouts=found,
        samples=question.samples,
        uncertainty=question.uncertainty,
        no_look=question.no_look,
        out=out,
        **compute,
        command=command_line(),
        progress=progress,
    )
    print_result(
        summary, progress, as_json, lambda: with_additions(summary, comparison_table(summary, out))
    )
