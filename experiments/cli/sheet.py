"""``place-rsus sheet``: the mounting sheet of a layout."""

from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    SectionedCommand,
    compute_options,
    json_option,
    layout_option,
    option,
    question_options,
    quiet_option,
)
from .running import begin, load_one_layout, print_result


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus sheet --layout mine.json --scene scene --out mounting.pdf --json""",
)
@layout_option
@option("--out", type=click.Path(path_type=Path), required=True, help="PDF file to write.")
@question_options(*JUDGED)
@json_option
@quiet_option
@compute_options()
@click.pass_obj
def sheet(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    out: Path,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Write a PDF for whoever mounts the units: a page each.

    Where, how high, where it looks in words and degrees, what it will see (rendered), a plan, the
    nearest landmarks, and how many degrees and centimetres it may be off before a run is lost.
    """
    layout = load_one_layout(layout_names)
    begin(progress, quiet=quiet)
    from ..jobs.sheet import run_sheet, sheet_text

    summary = run_sheet(question, layout=layout, out=out, compute=compute, progress=progress)
    print_result(summary, progress, as_json, lambda: sheet_text(summary))
