"""``place-rsus sheet``: the mounting sheet of a layout."""

from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress, load_one_layout, print_result, warn_of_slow_rays
from .latency import latency_budget_options
from .options import (
    SectionedCommand,
    json_option,
    layout_option,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus sheet --layout mine.json --scene scene --out mounting.pdf --json""",
)
@layout_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="PDF file to write.")
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@click.pass_obj
def sheet(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    out: Path,
    question: Question,
    as_json: bool,
    quiet: bool,
    seed: int,
    workers: int,
) -> None:
    """Write a PDF for whoever mounts the units: a page each.

    Where, how high, where it looks in words and degrees, what it will see (rendered), a plan, the
    nearest landmarks, and how many degrees and centimetres it may be off before a run is lost.
    """
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    warn_of_slow_rays()
    from ..jobs.sheet import run_sheet, sheet_text

    compute = Compute(seed=seed, workers=workers, progress=progress)
    summary = run_sheet(question, layout=layout, out=out, compute=compute, progress=progress)
    print_result(summary, progress, as_json, lambda: sheet_text(summary))
